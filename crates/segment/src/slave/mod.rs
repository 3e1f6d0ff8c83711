//! One slave of the segment: controller, application, mailbox and device, stepped together every millisecond.
//!
//! A slave with device emulation has no processor: its controller answers state requests at once, and nothing is
//! checked. Faults of a processor mean nothing to it.

mod mail;
pub(crate) mod options;
mod process_image;

use crate::application::{AlState, Application, code};
use crate::controller::clock::SyncState;
use crate::controller::datagram::Datagram;
use crate::controller::silicon::ClockWidth;
use crate::controller::{Controller, Nature, PORTS};
use crate::devices::kind::SlaveKind;
use crate::devices::{Device, ProcessManagers};
use crate::drive::servo::Servo;
use crate::drive::{Drive, DriveOptions};
use crate::eeprom::SiiFault;
use crate::eeprom::sii::Label;
use crate::faults::kinds::{MailFault, MailStep, Manner, Product};
use crate::mailbox::coe::MailboxServer;
use crate::mailbox::dictionary::Dictionary;
use crate::mailbox::foe::FileServer;
use crate::mailbox::process_data::ProcessData;
use options::{PlaceOptions, SlaveOptions};

const MAILBOX_OUT_MANAGER: usize = 0;
const MAILBOX_IN_MANAGER: usize = 1;
/// How long a controller that was reset loads its configuration, ms.
const RESET_MS: u64 = 100;
/// How long the drive's power stage keeps running without its processor, ms; then it stops the motor.
const POWER_STAGE_WATCHDOG_MS: u64 = 10;

/// A slave with its device.
#[derive(Clone, Debug)]
pub(crate) struct Slave {
    controller: Controller,
    application: Application,
    mailbox: MailboxServer,
    dictionary: Dictionary,
    process_data: ProcessData,
    device: Box<dyn Device>,
    managers: ProcessManagers,
    options: SlaveOptions,
    identification: Option<u16>,
    /// A request that the application works on, and the remaining time, ms.
    transition: Option<(u16, u64)>,
    /// Remaining time without power, ms; the motor brakes meanwhile.
    unpowered_ms: u64,
    silent_ms: u64,
    /// Remaining time in which it takes no process data, ms.
    deaf_ms: u64,
    /// Remaining time to the next answer of the mailbox, ms.
    answer_ms: u64,
    unfed_ms: u64,
    width: ClockWidth,
    nature: Nature,
    refusals: Vec<(AlState, u16)>,
    mail_faults: Vec<(MailStep, MailFault)>,
    hung_ms: u64,
    hung_for_ms: u64,
    outputs_received: bool,
    has_outputs: bool,
    /// Whether a SYNC0 pulse came since the last frame or millisecond: then the device takes its outputs and shows its inputs.
    is_pulsed: bool,
    files: FileServer,
    /// Remaining time to the announcement of an Ethernet address, ms.
    announce_ms: Option<u64>,
}

impl Slave {
    /// A slave after power-up, with a clock of this width unless its place or its kind has another.
    pub(crate) fn new(mut device: Box<dyn Device>, place: PlaceOptions, width: ClockWidth, nature: Nature) -> Self {
        place
            .managers
            .iter()
            .for_each(|managers| device.set_managers(*managers));
        let lock_ns = place
            .lock_ms
            .map_or(nature.lock_ns, |ms| 1_000_000 * i64::from(ms.max(1)));
        let nature = Nature { lock_ns, ..nature };
        let mut silicon = device.silicon();
        if let Some(controller) = place.controller.filter(|_| device.is_from_file()) {
            silicon = controller.silicon(&silicon);
        }
        silicon.clock = match (silicon.clock, place.clock) {
            (ClockWidth::Bits64, None) => width,
            (own, Some(width)) if own.has_system_time() => width,
            (own, _) => own,
        };
        if place.ignores_lrw {
            silicon = silicon.without_lrw();
        }
        silicon.takes_pairs |= place.takes_pairs;
        place.serial.iter().for_each(|serial| device.set_serial(*serial));
        if let Some((servo, one_turn)) = device.servo_mut().zip(place.one_turn) {
            servo.drive.count_one_turn(one_turn);
        }
        let mut image = device.image();
        let label = Label {
            alias: place.alias,
            serial: place.serial,
            identifies: place.identification.is_some(),
        };
        label.stick(&mut image);
        let device_writes_in_bootstrap = device.windows().has_bootstrap();
        let mut slave = Self {
            controller: Controller::new(silicon, image, nature),
            application: Application::with_number(place.identification),
            mailbox: MailboxServer::default(),
            dictionary: device.dictionary(),
            process_data: device.process_data(),
            managers: device.process_managers(),
            device,
            options: place.processor,
            identification: place.identification,
            transition: None,
            unpowered_ms: 0,
            silent_ms: 0,
            deaf_ms: 0,
            answer_ms: 0,
            unfed_ms: 0,
            width,
            nature,
            refusals: Vec::new(),
            mail_faults: Vec::new(),
            hung_ms: 0,
            hung_for_ms: 0,
            outputs_received: false,
            has_outputs: false,
            is_pulsed: false,
            files: FileServer::new(place.password, device_writes_in_bootstrap),
            announce_ms: None,
        };
        slave.controller.set_al_status(AlState::Init as u16, 0);
        slave.activate_sync_managers();
        slave.hang(slave.options.boot_ms);
        slave
    }

    /// Whether frames pass the slave.
    pub(crate) fn is_powered(&self) -> bool {
        self.unpowered_ms == 0
    }

    /// State of the application layer.
    pub(crate) fn state(&self) -> AlState {
        if self.is_alone() {
            AlState::from_number(self.controller.al_status()).unwrap_or(AlState::Init)
        } else {
            self.application.state()
        }
    }

    /// Sets what the processor is like, which starts anew.
    pub(crate) fn set_options(&mut self, options: SlaveOptions) {
        self.options = options;
        self.hang(options.boot_ms);
    }

    /// Whether no processor runs the application.
    fn is_alone(&self) -> bool {
        self.controller.is_emulated() || !self.device.has_processor()
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
            Product::Akd => SlaveKind::Akd,
            Product::Ek1100 => SlaveKind::Ek1100,
        };
        let mut servo = self.device.servo().cloned();
        servo.iter_mut().for_each(Servo::power_up);
        if servo.is_none() && kind.is_drive() {
            servo = Some(Servo::new(&DriveOptions::default(), 0));
        }
        let place = PlaceOptions {
            processor: self.options,
            ..PlaceOptions::default()
        };
        *self = Self::new(kind.device(servo, serial), place, self.width, self.nature);
    }

    /// Refuses the next request for a state.
    pub(crate) fn refuse(&mut self, state: AlState, code: u16) {
        self.refusals.push((state, code));
    }

    /// Handles the arrival of a frame that will come back to the ports at `back_ns`. At a SYNC0 pulse before it, the device
    /// takes the outputs of the frames before, and shows its inputs.
    pub(crate) fn begin_frame(&mut self, arrival_ns: u64, back_ns: [Option<u64>; PORTS]) {
        self.controller.begin_frame(arrival_ns, back_ns);
        let runs = self.is_powered() && self.hung_ms == 0 && !self.is_alone();
        if self.controller.take_pulses() > 0 && runs {
            self.has_outputs = self.take_outputs();
            self.put_inputs();
        }
    }

    /// Time to the slave's next SYNC0 pulse, ns; `None` while it generates none, or not at the same place of each millisecond.
    pub(crate) fn pulse_ahead_ns(&self) -> Option<u64> {
        self.controller.pulse_ahead_ns().filter(|_| self.is_powered())
    }

    /// True time up to which the slave's controller has run, ns.
    pub(crate) fn now_ns(&self) -> u64 {
        self.controller.now_ns()
    }

    /// System time of the slave's clock at a true time, ns; `None` without a clock.
    pub(crate) fn system_at_ns(&self, true_ns: u64) -> Option<u64> {
        self.controller.system_at_ns(true_ns)
    }

    /// Counts a damaged frame; `forwarded` if it was damaged before the cable at this slave.
    pub(crate) fn count_damage(&mut self, forwarded: bool) {
        self.controller.count_damage(forwarded);
    }

    /// Sets a fault of the information memory.
    pub(crate) fn set_sii_fault(&mut self, fault: SiiFault) {
        self.controller.set_sii_fault(fault);
    }

    /// Takes no process data for some milliseconds.
    pub(crate) fn deafen(&mut self, milliseconds: u64) {
        self.deaf_ms = milliseconds;
        self.controller.set_deaf(milliseconds > 0);
    }

    /// Stops the slave's processor for some milliseconds; the slave controller continues.
    pub(crate) fn hang(&mut self, milliseconds: u64) {
        if self.is_alone() {
            return;
        }
        (self.hung_ms, self.hung_for_ms) = (milliseconds, 0);
    }

    /// Processes a datagram.
    pub(crate) fn pass(&mut self, datagram: &mut Datagram) {
        self.feed();
        self.controller.pass(datagram);
    }

    /// Whether frames leave and enter through a port.
    pub(crate) fn is_open(&self, port: u8) -> bool {
        self.controller.is_open(port)
    }

    /// Whether frames of other protocols pass.
    pub(crate) fn passes_foreign_frames(&self) -> bool {
        self.controller.passes_foreign_frames()
    }

    /// Changes one of the processor's manners, without a restart.
    pub(crate) fn set_manner(&mut self, manner: Manner) {
        match manner {
            Manner::ReadsSii(reads) => self.options.reads_sii = reads,
            Manner::IgnoresRepeats(ignores) => self.options.ignores_repeats = ignores,
            Manner::Boot(ms) => self.options.boot_ms = ms,
            Manner::Transition(ms) => self.options.transition_ms = ms,
            Manner::Mailbox(ms) => self.options.mailbox_ms = ms,
        }
    }

    /// Sets the link states of the ports.
    pub(crate) fn set_links(&mut self, links: u8) {
        self.controller.set_links(links);
    }

    /// Switches the power off for some milliseconds.
    pub(crate) fn power_cycle(&mut self, off_ms: u64) {
        self.unpowered_ms = off_ms.max(1);
        self.application = Application::with_number(self.identification);
        self.mailbox = MailboxServer::default();
        self.outputs_received = false;
        self.has_outputs = false;
        self.transition = None;
        self.files.end();
        self.announce_ms = None;
        self.answer_ms = 0;
        self.controller.power_up();
        self.hung_ms = 0;
        self.hang(self.options.boot_ms);
        self.device.power_up();
        self.dictionary = self.device.dictionary();
        self.process_data = self.device.process_data();
        self.controller.set_al_status(AlState::Init as u16, 0);
        self.activate_sync_managers();
    }

    /// Falls back to a state with an AL status code, if the present state is higher.
    pub(crate) fn fall(&mut self, state: AlState, code: u16) {
        if self.is_alone() {
            return;
        }
        let before = self.application.state();
        self.application.retreat(state, code);
        self.leave(before);
        self.show_state();
    }

    /// Advances by one millisecond, to a true time.
    pub(crate) fn step(&mut self, now_ns: u64) {
        if self.deaf_ms > 0 {
            self.deafen(self.deaf_ms - 1);
        }
        if !self.is_powered() {
            self.unpowered_ms -= 1;
            self.device.step(false);
            return;
        }
        self.controller.advance(now_ns);
        if self.controller.take_reset() {
            self.power_cycle(RESET_MS);
            return;
        }
        if self.is_alone() {
            self.watch_alone();
            self.device.step(false);
            return;
        }
        self.is_pulsed = self.controller.take_pulses() > 0;
        if self.is_hung() {
            match self.hung_for_ms <= POWER_STAGE_WATCHDOG_MS {
                true => self.device.coast(),
                false => self.device.step(false),
            }
            return;
        }
        self.controller.serve_sii();
        self.serve_mailbox();
        self.watch();
        self.change_state();
        if self.is_pulsed || self.controller.sync_state() == SyncState::Off {
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
        if self.is_alone() {
            return;
        }
        if self.is_pulsed || self.controller.sync_state() != SyncState::Running {
            self.put_inputs();
        }
        while let Some((code, register, detail)) = self.device.take_emergency() {
            if self.application.state() >= AlState::PreOperational {
                self.mailbox.emergency(code, register, detail);
            }
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

    fn change_state(&mut self) {
        let ready = self.readiness();
        let before = self.application.state();
        if let Some(request) = self.next_request() {
            let denied = self
                .refusals
                .iter()
                .position(|(state, code)| self.application.deny(request, *state, *code));
            match denied {
                Some(at) => drop(self.refusals.remove(at)),
                None => self.application.request(request, ready),
            }
        }
        self.application.check(ready);
        self.application.step(ready);
        if !ready.synchronous && self.application.state() == AlState::Operational {
            self.application.retreat(AlState::SafeOperational, code::SYNC_LOST);
        }
        self.leave(before);
        self.show_state();
    }

    /// Drops what belonged to the state before, if the present one is another: in INIT and BOOT the mailbox begins anew.
    fn leave(&mut self, before: AlState) {
        let after = self.application.state();
        if after == before {
            return;
        }
        self.unfed_ms = 0;
        if after < AlState::SafeOperational || before < AlState::SafeOperational {
            self.outputs_received = false;
        }
        if after == AlState::Init || after == AlState::Bootstrap {
            self.mailbox = MailboxServer::default();
            self.files.end();
            self.announce_ms = None;
        }
    }

    /// The state request that is due now: read from the register, and worked on for the time of a transition.
    fn next_request(&mut self) -> Option<u16> {
        let (request, left_ms) = match self.transition.take() {
            Some((request, left_ms)) => (request, left_ms.saturating_sub(1)),
            None => (self.controller.take_al_request()?, self.options.transition_ms),
        };
        let begins = self.options.reads_sii && self.controller.offers_sii() && left_ms == self.options.transition_ms;
        if left_ms == 0 || begins {
            self.controller.hold_sii(begins && left_ms > 0);
        }
        if left_ms > 0 {
            self.transition = Some((request, left_ms));
            return None;
        }
        Some(request)
    }

    fn show_state(&mut self) {
        self.controller
            .set_al_status(self.application.status(), self.application.code_register());
        self.activate_sync_managers();
    }
}
