//! One slave of the segment: controller, application, mailbox and drive, and the millisecond that joins them.

use super::application::{AlState, Application, Readiness, code};
use super::coe::MailboxServer;
use super::controller::Controller;
use super::datagram::Datagram;
use super::device::Device;
use super::dictionary::{Dictionary, Objects};
use super::drive::Drive;
use super::process_data::ProcessData;
use etherpen::ethercat::wire::sii::MailboxWindow;

const MAILBOX_OUT_MANAGER: usize = 0;
const MAILBOX_IN_MANAGER: usize = 1;
const OUTPUT_MANAGER: usize = 2;
const INPUT_MANAGER: usize = 3;

/// A slave with its device.
#[derive(Clone, Debug)]
pub(super) struct Slave {
    controller: Controller,
    application: Application,
    mailbox: MailboxServer,
    dictionary: Dictionary,
    process_data: ProcessData,
    device: Box<dyn Device>,
    /// Milliseconds without power still to come; the motor brakes meanwhile.
    unpowered_ms: u64,
    silent_ms: u64,
    stuck_ms: u64,
    unfed_ms: u64,
    outputs_received: bool,
}

impl Slave {
    /// A slave after power-up.
    pub(super) fn new(device: Box<dyn Device>) -> Self {
        let mut slave = Self {
            controller: Controller::new(device.silicon(), device.image()),
            application: Application::default(),
            mailbox: MailboxServer::default(),
            dictionary: device.dictionary(),
            process_data: device.process_data(),
            device,
            unpowered_ms: 0,
            silent_ms: 0,
            stuck_ms: 0,
            unfed_ms: 0,
            outputs_received: false,
        };
        slave.show_state();
        slave
    }

    /// Whether frames get through.
    pub(super) fn is_powered(&self) -> bool {
        self.unpowered_ms == 0
    }

    /// State of the application layer.
    pub(super) fn state(&self) -> AlState {
        self.application.state()
    }

    /// Code of the last refusal or retreat; 0 without one.
    pub(super) fn al_status_code(&self) -> u16 {
        self.application.code()
    }

    /// The drive inside, if there is one.
    pub(super) fn drive(&self) -> Option<&Drive> {
        self.device.drive()
    }

    /// The same, to be changed.
    pub(super) fn drive_mut(&mut self) -> Option<&mut Drive> {
        self.device.drive_mut()
    }

    /// Lets a datagram pass.
    pub(super) fn pass(&mut self, datagram: &mut Datagram) {
        self.controller.pass(datagram);
    }

    /// Shows the links of the ports to the bus.
    pub(super) fn set_links(&mut self, links: u8) {
        self.controller.set_links(links);
    }

    /// Takes the power away for some milliseconds.
    pub(super) fn power_cycle(&mut self, off_ms: u64) {
        self.unpowered_ms = off_ms.max(1);
        self.application = Application::default();
        self.mailbox = MailboxServer::default();
        self.outputs_received = false;
        self.controller.power_up();
        self.device.power_up();
        self.dictionary = self.device.dictionary();
        self.process_data = self.device.process_data();
        self.show_state();
    }

    /// Falls back to SAFEOP with an AL status code.
    pub(super) fn retreat(&mut self, code: u16) {
        self.application.retreat(AlState::SafeOperational, code);
        self.show_state();
    }

    /// Answers no mailbox message for some milliseconds.
    pub(super) fn silence(&mut self, milliseconds: u64) {
        self.silent_ms = milliseconds;
    }

    /// Freezes the resolver for some milliseconds.
    pub(super) fn stick(&mut self, milliseconds: u64) {
        self.stuck_ms = milliseconds;
        self.set_stuck(milliseconds > 0);
    }

    /// One millisecond.
    pub(super) fn step(&mut self) {
        if !self.is_powered() {
            self.unpowered_ms -= 1;
            self.device.step(false);
            return;
        }
        self.controller.step();
        self.serve_mailbox();
        self.watch();
        self.change_state();
        if self.stuck_ms > 0 {
            self.stuck_ms -= 1;
            if self.stuck_ms == 0 {
                self.set_stuck(false);
            }
        }
        let operational = self.take_outputs();
        self.device.step(operational);
    }

    /// Takes the inputs of this millisecond, after every motor has moved.
    pub(super) fn sample(&mut self) {
        if !self.is_powered() {
            return;
        }
        self.device.sample();
        if self.application.state() >= AlState::SafeOperational {
            let inputs = self.process_data.pack(self.device.as_ref());
            self.controller
                .with_sync_manager(INPUT_MANAGER, |manager| manager.put(&inputs));
        }
        while let Some((code, register, detail)) = self.device.take_emergency() {
            if self.application.state() >= AlState::PreOperational {
                self.mailbox.emergency(code, register, detail);
            }
        }
    }

    /// Hands the outputs to the device; false where there are none to obey.
    fn take_outputs(&mut self) -> bool {
        if self.application.state() != AlState::Operational {
            return false;
        }
        let manager = self.controller.sync_manager(OUTPUT_MANAGER);
        let Some(outputs) = manager.and_then(|manager| manager.outputs()) else {
            return false;
        };
        self.process_data.unpack(outputs, self.device.as_mut());
        true
    }

    fn set_stuck(&mut self, stuck: bool) {
        if let Some(drive) = self.device.drive_mut() {
            drive.set_stuck(stuck);
        }
    }

    fn serve_mailbox(&mut self) {
        if self.silent_ms > 0 {
            self.silent_ms -= 1;
            return;
        }
        if self.application.state() < AlState::PreOperational {
            return;
        }
        let message = self
            .controller
            .with_sync_manager(MAILBOX_OUT_MANAGER, |manager| manager.take_message());
        if let Some(message) = message {
            let capacity = self
                .controller
                .sync_manager(MAILBOX_IN_MANAGER)
                .map_or(0, |manager| manager.length());
            let mut objects = Objects {
                dictionary: &mut self.dictionary,
                process_data: &mut self.process_data,
                device: self.device.as_mut(),
                state: self.application.state(),
            };
            self.mailbox.receive(&message, capacity, &mut objects);
        }
        let mailbox = &mut self.mailbox;
        self.controller.with_sync_manager(MAILBOX_IN_MANAGER, |manager| {
            if manager.repeat_is_due() {
                if let Some(message) = mailbox.last_sent() {
                    manager.put(message);
                }
                manager.acknowledge_repeat();
            } else if manager.accepts_message()
                && let Some(message) = mailbox.next()
            {
                manager.put(&message);
            }
        });
    }

    /// The process-data watchdog, on the cell's clock.
    fn watch(&mut self) {
        let fed = self
            .controller
            .with_sync_manager(OUTPUT_MANAGER, |manager| manager.look_for_write());
        let watched = self
            .controller
            .sync_manager(OUTPUT_MANAGER)
            .is_some_and(|manager| manager.triggers_watchdog());
        if fed {
            self.outputs_received = self.application.state() >= AlState::SafeOperational;
            self.unfed_ms = 0;
            self.controller.set_watchdog(false);
            return;
        }
        self.unfed_ms = self.unfed_ms.saturating_add(1);
        let expired = watched
            && self.application.state() == AlState::Operational
            && self
                .controller
                .watchdog_us()
                .is_some_and(|limit_us| self.unfed_ms * 1000 >= limit_us);
        if expired {
            self.controller.set_watchdog(true);
            self.application.retreat(AlState::SafeOperational, code::WATCHDOG);
            self.device.cyclic_data_lost();
            self.outputs_received = false;
            self.show_state();
        }
    }

    fn change_state(&mut self) {
        let ready = self.readiness();
        let before = self.application.state();
        if let Some(request) = self.controller.take_al_request() {
            self.application.request(request, ready);
        }
        self.application.step(ready);
        let after = self.application.state();
        if after != before {
            self.unfed_ms = 0;
            if after < AlState::SafeOperational || before < AlState::SafeOperational {
                self.outputs_received = false;
            }
            if after == AlState::Init {
                self.mailbox = MailboxServer::default();
                for manager in [MAILBOX_OUT_MANAGER, MAILBOX_IN_MANAGER] {
                    self.controller.with_sync_manager(manager, |manager| manager.clear());
                }
            }
        }
        self.show_state();
    }

    fn show_state(&mut self) {
        self.controller
            .set_al_status(self.application.status(), self.application.code());
    }

    fn readiness(&self) -> Readiness {
        let (output_bytes, input_bytes) = self.process_data.bytes();
        let windows = self.device.windows();
        let manager = |index| self.controller.sync_manager(index);
        let is_mailbox = |index, window: MailboxWindow, bus_written| {
            manager(index).is_some_and(|manager| {
                manager.is_active()
                    && manager.is_mailbox()
                    && manager.is_bus_written() == bus_written
                    && manager.start() == usize::from(window.start)
                    && manager.length() == usize::from(window.length)
            })
        };
        let is_process_data = |index, bytes: usize, bus_written| {
            manager(index).is_some_and(|manager| {
                (bytes == 0 && !manager.is_active())
                    || (manager.is_active()
                        && !manager.is_mailbox()
                        && manager.is_bus_written() == bus_written
                        && manager.length() == bytes)
            })
        };
        Readiness {
            mailbox: !windows.has_mailbox()
                || is_mailbox(MAILBOX_OUT_MANAGER, windows.mailbox_out, true)
                    && is_mailbox(MAILBOX_IN_MANAGER, windows.mailbox_in, false),
            outputs: is_process_data(OUTPUT_MANAGER, output_bytes, true),
            inputs: is_process_data(INPUT_MANAGER, input_bytes, false),
            outputs_received: self.outputs_received || output_bytes == 0,
        }
    }
}
