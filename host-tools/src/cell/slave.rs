//! One slave of the segment: controller, application, mailbox and drive, and the millisecond that joins them.

use super::application::{AlState, Application, Readiness, code};
use super::ax2000::{Ax2000, MAILBOX_IN, MAILBOX_OUT, PROCESS_DATA_BYTES};
use super::coe::MailboxServer;
use super::controller::Controller;
use super::datagram::Datagram;
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
    /// The device behind the controller.
    pub(super) device: Ax2000,
    /// Milliseconds without power still to come; the motor brakes meanwhile.
    unpowered_ms: u64,
    silent_ms: u64,
    stuck_ms: u64,
    unfed_ms: u64,
    outputs_received: bool,
}

impl Slave {
    pub(super) fn new(device: Ax2000) -> Self {
        let mut slave = Self {
            controller: Controller::new(device.image()),
            application: Application::default(),
            mailbox: MailboxServer::default(),
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
        self.device.drive.set_stuck(milliseconds > 0);
    }

    /// One millisecond.
    pub(super) fn step(&mut self) {
        if !self.is_powered() {
            self.unpowered_ms -= 1;
            self.device.drive.step(None);
            return;
        }
        self.controller.step();
        self.serve_mailbox();
        self.watch();
        self.change_state();
        if self.stuck_ms > 0 {
            self.stuck_ms -= 1;
            if self.stuck_ms == 0 {
                self.device.drive.set_stuck(false);
            }
        }
        let operational = self.application.state() == AlState::Operational;
        let outputs: Option<[u8; PROCESS_DATA_BYTES]> = self
            .controller
            .sync_manager(OUTPUT_MANAGER)
            .filter(|_| operational)
            .and_then(|manager| manager.outputs()?.first_chunk().copied());
        let inputs = self.device.step(outputs.as_ref().map(|outputs| outputs.as_slice()));
        if self.application.state() >= AlState::SafeOperational {
            self.controller
                .with_sync_manager(INPUT_MANAGER, |manager| manager.put(&inputs));
        }
        while let Some((code, register, detail)) = self.device.take_emergency() {
            if self.application.state() >= AlState::PreOperational {
                self.mailbox.emergency(code, register, detail);
            }
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
            self.mailbox.receive(&message, capacity, &mut self.device);
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
            self.device.drive.cyclic_data_lost();
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
        self.device.set_state(self.application.state());
        self.controller
            .set_al_status(self.application.status(), self.application.code());
    }

    fn readiness(&self) -> Readiness {
        let (output_bytes, input_bytes) = self.device.process_data_bytes();
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
            mailbox: is_mailbox(MAILBOX_OUT_MANAGER, MAILBOX_OUT, true)
                && is_mailbox(MAILBOX_IN_MANAGER, MAILBOX_IN, false),
            outputs: is_process_data(OUTPUT_MANAGER, output_bytes, true),
            inputs: is_process_data(INPUT_MANAGER, input_bytes, false),
            outputs_received: self.outputs_received || output_bytes == 0,
        }
    }
}
