//! One slave of the segment: controller, application, mailbox and drive, stepped together every millisecond.

use crate::application::{AlState, Application, Readiness, code};
use crate::controller::clock::SyncState;
use crate::controller::datagram::Datagram;
use crate::controller::silicon::ClockWidth;
use crate::controller::{Controller, Nature};
use crate::devices::Device;
use crate::devices::kind::SlaveKind;
use crate::drive::servo::Servo;
use crate::drive::{Drive, DriveOptions};
use crate::eeprom::SiiFault;
use crate::faults::kinds::{MailFault, MailStep, Product};
use crate::mailbox::coe::{MailboxServer, object_of};
use crate::mailbox::dictionary::Dictionary;
use crate::mailbox::objects::Objects;
use crate::mailbox::process_data::ProcessData;
use etherpen_ethercat::wire::sii::MailboxWindow;

const MAILBOX_OUT_MANAGER: usize = 0;
const MAILBOX_IN_MANAGER: usize = 1;
/// How long the drive's power stage keeps running without its processor, ms; then it stops the motor.
const POWER_STAGE_WATCHDOG_MS: u64 = 10;
/// Error code of the emergencies of a flood.
const FLOOD_CODE: u16 = 0xFF00;
const OUTPUT_MANAGER: usize = 2;
const INPUT_MANAGER: usize = 3;

/// A slave with its device.
#[derive(Clone, Debug)]
pub(crate) struct Slave {
    controller: Controller,
    application: Application,
    mailbox: MailboxServer,
    dictionary: Dictionary,
    process_data: ProcessData,
    device: Box<dyn Device>,
    /// Remaining time without power, ms; the motor brakes meanwhile.
    unpowered_ms: u64,
    silent_ms: u64,
    unfed_ms: u64,
    width: ClockWidth,
    nature: Nature,
    refusals: Vec<(AlState, u16)>,
    mail_faults: Vec<(MailStep, MailFault)>,
    hung_ms: u64,
    hung_for_ms: u64,
    outputs_received: bool,
    has_outputs: bool,
}

impl Slave {
    /// A slave after power-up.
    pub(crate) fn new(device: Box<dyn Device>, width: ClockWidth, nature: Nature) -> Self {
        let mut silicon = device.silicon();
        if silicon.clock != ClockWidth::None {
            silicon.clock = width;
        }
        let mut slave = Self {
            controller: Controller::new(silicon, device.image(), nature),
            application: Application::default(),
            mailbox: MailboxServer::default(),
            dictionary: device.dictionary(),
            process_data: device.process_data(),
            device,
            unpowered_ms: 0,
            silent_ms: 0,
            unfed_ms: 0,
            width,
            nature,
            refusals: Vec::new(),
            mail_faults: Vec::new(),
            hung_ms: 0,
            hung_for_ms: 0,
            outputs_received: false,
            has_outputs: false,
        };
        slave.show_state();
        slave
    }

    /// Whether frames pass the slave.
    pub(crate) fn is_powered(&self) -> bool {
        self.unpowered_ms == 0
    }

    /// State of the application layer.
    pub(crate) fn state(&self) -> AlState {
        self.application.state()
    }

    /// Code of the last refusal or fallback; 0 without one.
    pub(crate) fn al_status_code(&self) -> u16 {
        self.application.code()
    }

    /// The drive inside, if there is one.
    pub(crate) fn drive(&self) -> Option<&Drive> {
        self.device.servo().map(|servo| &servo.drive)
    }

    /// The drive inside, mutable, if there is one.
    pub(crate) fn drive_mut(&mut self) -> Option<&mut Drive> {
        self.device.servo_mut().map(|servo| &mut servo.drive)
    }

    /// Replaces the slave by another product with this serial number, after power-up; a motor keeps its position.
    pub(crate) fn swap(&mut self, product: Product, serial: u32) {
        let kind = match product {
            Product::Ax2000 => SlaveKind::Ax2000,
            Product::Cia402 => SlaveKind::Cia402,
            Product::Ek1100 => SlaveKind::Ek1100,
        };
        let mut servo = self.device.servo().cloned();
        servo.iter_mut().for_each(Servo::power_up);
        if servo.is_none() && kind.is_drive() {
            servo = Some(Servo::new(&DriveOptions::default(), 0));
        }
        *self = Self::new(kind.device(servo, serial), self.width, self.nature);
    }

    /// Refuses the next request for a state.
    pub(crate) fn refuse(&mut self, state: AlState, code: u16) {
        self.refusals.push((state, code));
    }

    /// Schedules a fault of a mailbox request.
    pub(crate) fn spoil_mailbox(&mut self, step: MailStep, fault: MailFault) {
        self.mail_faults.push((step, fault));
    }

    /// Handles the arrival of a frame that will come back from the chain behind at `back_ns`; earlier SYNC0 pulses take
    /// effect first.
    pub(crate) fn begin_frame(&mut self, arrival_ns: u64, back_ns: Option<u64>) {
        self.controller.begin_frame(arrival_ns, back_ns);
        self.obey_pulses();
    }

    /// Counts a damaged frame; `forwarded` if it was damaged before the cable at this slave.
    pub(crate) fn count_damage(&mut self, forwarded: bool) {
        self.controller.count_damage(forwarded);
    }

    /// Sets a fault of the information memory.
    pub(crate) fn set_sii_fault(&mut self, fault: SiiFault) {
        self.controller.set_sii_fault(fault);
    }

    /// Stops the slave's processor for some milliseconds; the slave controller continues.
    pub(crate) fn hang(&mut self, milliseconds: u64) {
        (self.hung_ms, self.hung_for_ms) = (milliseconds, 0);
    }

    /// Processes a datagram.
    pub(crate) fn pass(&mut self, datagram: &mut Datagram) {
        self.controller.pass(datagram);
    }

    /// Sets the link states of the ports.
    pub(crate) fn set_links(&mut self, links: u8) {
        self.controller.set_links(links);
    }

    /// Switches the power off for some milliseconds.
    pub(crate) fn power_cycle(&mut self, off_ms: u64) {
        self.unpowered_ms = off_ms.max(1);
        self.application = Application::default();
        self.mailbox = MailboxServer::default();
        self.outputs_received = false;
        self.has_outputs = false;
        self.hung_ms = 0;
        self.controller.power_up();
        self.device.power_up();
        self.dictionary = self.device.dictionary();
        self.process_data = self.device.process_data();
        self.show_state();
    }

    /// Falls back to a state with an AL status code, if the present state is higher.
    pub(crate) fn fall(&mut self, state: AlState, code: u16) {
        self.application.retreat(state, code);
        self.show_state();
    }

    /// Leaves mailbox messages unanswered for some milliseconds.
    pub(crate) fn silence(&mut self, milliseconds: u64) {
        self.silent_ms = milliseconds;
    }

    /// Advances by one millisecond, to a true time.
    pub(crate) fn step(&mut self, now_ns: u64) {
        if !self.is_powered() {
            self.unpowered_ms -= 1;
            self.device.step(false);
            return;
        }
        self.controller.advance(now_ns);
        self.obey_pulses();
        if self.is_hung() {
            match self.hung_for_ms <= POWER_STAGE_WATCHDOG_MS {
                true => self.device.coast(),
                false => self.device.step(false),
            }
            return;
        }
        self.serve_mailbox();
        self.watch();
        self.change_state();
        if self.controller.sync_state() == SyncState::Off {
            self.has_outputs = self.take_outputs();
        }
        let operational = self.has_outputs && self.application.state() == AlState::Operational;
        self.device.step(operational);
    }

    /// Takes the inputs of this millisecond, after every motor has moved.
    pub(crate) fn sample(&mut self) {
        if !self.is_powered() || self.hung_ms > 0 {
            return;
        }
        self.device.sample();
        if self.controller.sync_state() != SyncState::Running {
            self.put_inputs();
        }
        while let Some((code, register, detail)) = self.device.take_emergency() {
            if self.application.state() >= AlState::PreOperational {
                self.mailbox.emergency(code, register, detail);
            }
        }
    }

    /// At a SYNC0 pulse the device takes its outputs and shows its inputs.
    fn obey_pulses(&mut self) {
        if self.controller.take_pulses() > 0 && self.is_powered() && self.hung_ms == 0 {
            self.has_outputs = self.take_outputs();
            self.put_inputs();
        }
    }

    /// Whether the processor is stopped in this millisecond; updates its watchdog.
    fn is_hung(&mut self) -> bool {
        if self.hung_ms == 0 {
            return false;
        }
        self.hung_ms -= 1;
        self.hung_for_ms = self.hung_for_ms.saturating_add(1);
        let limit_us = self.controller.processor_watchdog_us();
        let expired = limit_us.is_some_and(|limit_us| self.hung_for_ms * 1000 >= limit_us);
        self.controller.set_processor(self.hung_ms == 0 || !expired);
        self.hung_ms > 0
    }

    fn put_inputs(&mut self) {
        if self.application.state() >= AlState::SafeOperational {
            let inputs = self.process_data.pack(self.device.as_ref());
            self.controller
                .with_sync_manager(INPUT_MANAGER, |manager| manager.put(&inputs));
        }
    }

    /// Passes the outputs to the device; returns false without valid outputs.
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
            self.receive(&message);
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

    /// Answers a mailbox message, with the scripted faults.
    fn receive(&mut self, message: &[u8]) {
        match self.mail_fault(message) {
            Some(MailFault::Silent) => return,
            Some(MailFault::Abort(code)) => return self.mailbox.abort(message, code),
            Some(MailFault::Lost) => self.mailbox.lose_next(),
            Some(MailFault::Counter) => self.mailbox.repeat_counter(),
            Some(MailFault::Flood(count)) => {
                for _ in 0..count {
                    self.mailbox.emergency(FLOOD_CODE, 0, [0; 5]);
                }
            }
            None => {}
        }
        let manager = self.controller.sync_manager(MAILBOX_IN_MANAGER);
        let capacity = manager.map_or(0, |manager| manager.length());
        let mut objects = Objects {
            dictionary: &mut self.dictionary,
            process_data: &mut self.process_data,
            device: self.device.as_mut(),
            state: self.application.state(),
        };
        self.mailbox.receive(message, capacity, &mut objects);
    }

    /// The fault scheduled for this request, returned once; counts down the steps of the others.
    fn mail_fault(&mut self, message: &[u8]) -> Option<MailFault> {
        let object = object_of(message);
        let mut hit = None;
        self.mail_faults.retain_mut(|(step, fault)| {
            let due = match step {
                MailStep::Request(left) => {
                    *left = left.saturating_sub(1);
                    *left == 0
                }
                MailStep::Object(index, sub) => object == Some((*index, *sub)),
            };
            if due && hit.is_none() {
                hit = Some(*fault);
                return false;
            }
            true
        });
        hit
    }

    /// Runs the process-data watchdog in milliseconds of the segment.
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
            let denied = self
                .refusals
                .iter()
                .position(|(state, code)| self.application.deny(request, *state, *code));
            match denied {
                Some(at) => drop(self.refusals.remove(at)),
                None => self.application.request(request, ready),
            }
        }
        self.application.step(ready);
        if !ready.synchronous && self.application.state() == AlState::Operational {
            self.application.retreat(AlState::SafeOperational, code::SYNC_LOST);
        }
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
                let fits = manager.length() == bytes;
                let kind = !manager.is_mailbox() && manager.is_bus_written() == bus_written;
                match manager.is_active() {
                    true => kind && fits,
                    false => bytes == 0,
                }
            })
        };
        let sync = self.controller.sync_state();
        Readiness {
            sync_valid: sync != SyncState::Invalid,
            synchronous: matches!(sync, SyncState::Off | SyncState::Running),
            mailbox: !windows.has_mailbox()
                || is_mailbox(MAILBOX_OUT_MANAGER, windows.mailbox_out, true)
                    && is_mailbox(MAILBOX_IN_MANAGER, windows.mailbox_in, false),
            outputs: is_process_data(OUTPUT_MANAGER, output_bytes, true),
            inputs: is_process_data(INPUT_MANAGER, input_bytes, false),
            outputs_received: self.outputs_received || output_bytes == 0,
        }
    }
}
