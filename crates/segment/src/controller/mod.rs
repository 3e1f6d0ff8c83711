//! The EtherCAT slave controller: registers, process memory and the processing of passing datagrams.
//!
//! Datagrams are processed in place, as in the silicon: reads put bytes into the datagram, writes take bytes out, and
//! the working counter counts the successes. The controller does not know the device behind it; the application uses
//! sync managers and the state registers. Register layout: the slave controller's register description (ET1100 as the
//! pattern).

mod access;
pub(crate) mod clock;
pub(crate) mod datagram;
mod fmmu;
pub(crate) mod silicon;
mod sync_manager;

use crate::eeprom::{self, Eeprom, SiiFault};
use crate::registers as register;
use clock::{DistributedClock, SyncState};
use datagram::Datagram;
use etherpen_ethercat::wire::register::WATCHDOG_DIVIDER_100_US;
use fmmu::Fmmu;
use silicon::Silicon;
use sync_manager::SyncManager;

/// Bytes of register space.
const REGISTER_SPACE: usize = 0x1000;
/// First register that a sync manager can control: the digital outputs of a terminal.
const DIGITAL_OUTPUTS: usize = 0x0F00;
/// Bytes of register space and process memory of the largest controller.
const MEMORY: usize = 0x3000;
/// Most sync managers.
const SYNC_MANAGERS: usize = 8;
/// Most fieldbus memory management units.
const FMMUS: usize = 8;
/// Ports.
pub(crate) const PORTS: usize = 4;
/// Units for which there is register space, existing or not.
const UNITS: usize = 16;

const _: () = {
    assert!(register::SYNC_MANAGER + UNITS * sync_manager::BLOCK <= clock::BASE);
    assert!(register::FMMU + UNITS * fmmu::BLOCK <= register::SYNC_MANAGER);
    assert!(SYNC_MANAGERS <= UNITS && FMMUS <= UNITS);
};

/// Watchdog divider for 100 us, and 1000 of these units: the defaults after power-up.
const WATCHDOG_DIVIDER_DEFAULT: u16 = WATCHDOG_DIVIDER_100_US;
const WATCHDOG_PROCESS_DATA_DEFAULT: u16 = 1000;
/// Size of the receive FIFO after power-up, in the third byte of the data-link control.
const RECEIVE_FIFO_DEFAULT: u8 = 7;
/// Length of the controller's clock tick, nanoseconds.
const CLOCK_TICK_NS: u64 = 40;

/// Configuration of the controller: device emulation.
const DEVICE_EMULATION: u8 = 0x01;
/// Events of the event request register and the datagrams' interrupt field: the data-link status has changed, the
/// application's state has changed, and from this bit on one for each sync manager.
const EVENT_LINK: u16 = 0x0004;
const EVENT_STATE: u16 = 0x0008;
const EVENT_SYNC_MANAGER: u16 = 0x0010;
/// Data-link control, byte 0: frames of other protocols are destroyed; byte 1 is in effect for a second.
const FOREIGN_DESTROYED: u8 = 0x01;
const LOOPS_TEMPORARY: u8 = 0x02;
/// How long a temporary setting of the loops lasts, ns.
const LOOPS_TEMPORARY_NS: u64 = 1_000_000_000;
/// Written one after the other to the reset register, these bytes reset the controller.
const RESET_BYTES: [u8; 3] = *b"RES";
/// Access to the information memory: given to the slave's processor.
const SII_OFFERED: u8 = 0x01;
/// AL control: state and acknowledge.
const AL_CONTROL_MASK: u16 = 0x1F;

/// Word addresses of the fields loaded at power-up: interface control, pulse length, alias.
const WORD_PDI_CONTROL: usize = 0;
const WORD_PULSE_LENGTH: usize = 2;
const WORD_ALIAS: usize = 4;

/// What a port's loop does, two bits a port in byte 1 of the data-link control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LoopSetting {
    /// Open with a link, closed without.
    Auto,
    /// Closed without a link; opens when the setting is written again.
    AutoClose,
    /// Open with or without a link.
    Open,
    /// Closed.
    Closed,
}

/// Individual properties of a controller.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nature {
    /// Rate error of the crystal, 1e-9; positive if it is fast.
    pub(crate) drift_ppb: i64,
    /// Running time of the clock at the start, ns.
    pub(crate) local_ns: u64,
    /// Duration of a command of the information memory, ns.
    pub(crate) sii_busy_ns: u64,
    /// Time constant in which the clock follows the reference clock, ns.
    pub(crate) lock_ns: i64,
}

impl Default for Nature {
    fn default() -> Self {
        Self {
            drift_ppb: 0,
            local_ns: 0,
            sii_busy_ns: eeprom::BUSY_NS,
            lock_ns: clock::LOCK_NS,
        }
    }
}

/// Registers and memory of one slave controller.
#[derive(Clone, Debug)]
pub(crate) struct Controller {
    silicon: Silicon,
    memory: Vec<u8>,
    sync_managers: [SyncManager; SYNC_MANAGERS],
    fmmus: [Option<Fmmu>; FMMUS],
    eeprom: Eeprom,
    clock: DistributedClock,
    now_ns: u64,
    /// When the present frame comes back to each port.
    back_ns: [Option<u64>; PORTS],
    processor_alive: bool,
    /// Whether it takes no process data.
    deaf: bool,
    /// Whether the data-link status has changed since the bus read it.
    link_event: bool,
    /// Whether the application's state has changed since the bus read it.
    state_event: bool,
    al_request: Option<u16>,
    links: u8,
    /// Ports that have lost their link while their loops close and do not open by themselves.
    kept_closed: u8,
    /// Byte 1 of the data-link control before a temporary setting, and when it is valid again.
    loops_before: Option<(u8, u64)>,
    /// Frames so far; bytes of a reset that were written, and the frame of the last one.
    frames: u64,
    reset: (usize, u64),
}

impl Controller {
    /// A controller after power-up with this information memory.
    pub(crate) fn new(silicon: Silicon, image: Vec<u8>, nature: Nature) -> Self {
        let mut controller = Self {
            silicon,
            memory: Vec::new(),
            sync_managers: Default::default(),
            fmmus: Default::default(),
            eeprom: Eeprom::new(image, nature.sii_busy_ns, silicon.sii_flags),
            clock: DistributedClock::new(silicon.clock, nature, 0),
            now_ns: 0,
            back_ns: [None; PORTS],
            processor_alive: true,
            deaf: false,
            link_event: true,
            state_event: false,
            al_request: None,
            links: 0,
            kept_closed: 0,
            loops_before: None,
            frames: 0,
            reset: (0, 0),
        };
        controller.power_up();
        controller.clock = DistributedClock::new(silicon.clock, nature, nature.local_ns);
        controller
    }

    /// Resets everything volatile.
    pub(crate) fn power_up(&mut self) {
        self.memory.clear();
        self.memory.resize(MEMORY, 0);
        self.sync_managers = Default::default();
        self.fmmus = Default::default();
        self.al_request = None;
        (self.state_event, self.kept_closed, self.loops_before, self.reset) = (false, 0, None, (0, 0));
        self.describe();
        self.store(register::DL_CONTROL, &[FOREIGN_DESTROYED, 0, RECEIVE_FIFO_DEFAULT]);
        self.store(register::WATCHDOG_DIVIDER, &WATCHDOG_DIVIDER_DEFAULT.to_le_bytes());
        self.store(
            register::WATCHDOG_PROCESS_DATA,
            &WATCHDOG_PROCESS_DATA_DEFAULT.to_le_bytes(),
        );
        self.store(register::WATCHDOG_STATUS, &1u16.to_le_bytes());
        if let Some(registers) = self.memory.get_mut(eeprom::BASE..eeprom::BASE + eeprom::LENGTH) {
            self.eeprom.reset(registers);
        }
        if let Some(registers) = self.memory.get_mut(clock::BASE..clock::BASE + clock::LENGTH) {
            self.clock.power_up(registers);
        }
        self.processor_alive = true;
        self.link_event = true;
        self.load_configuration();
        for index in 0..SYNC_MANAGERS {
            self.mirror(index);
        }
    }

    fn describe(&mut self) {
        let silicon = self.silicon;
        self.store(register::TYPE, &silicon.identity);
        let counts = [silicon.fmmus, silicon.sync_managers, silicon.memory_kib, silicon.ports];
        self.store(register::TYPE + silicon.identity.len(), &counts);
        self.store(register::FEATURES, &silicon.feature_register().to_le_bytes());
    }

    /// Takes over the configuration from the information memory, if its checksum was correct.
    fn load_configuration(&mut self) {
        if !self.eeprom.is_loaded() {
            return;
        }
        let words = [WORD_PDI_CONTROL, WORD_PULSE_LENGTH, WORD_ALIAS].map(|at| self.eeprom.word(at));
        let [control, pulse, alias] = words;
        self.store(register::PDI_CONTROL, &control.to_le_bytes());
        self.store(register::STATION_ALIAS, &alias.to_le_bytes());
        if let Some(registers) = self.memory.get_mut(clock::BASE..clock::BASE + clock::LENGTH) {
            DistributedClock::set_pulse_length(registers, pulse);
        }
    }

    /// Whether the silicon alone answers state requests, without a processor: device emulation, from the information
    /// memory.
    pub(crate) fn is_emulated(&self) -> bool {
        self.byte(register::PDI_CONTROL + 1) & DEVICE_EMULATION != 0
    }

    /// Content of the AL status register.
    pub(crate) fn al_status(&self) -> u16 {
        self.word(register::AL_STATUS)
    }

    /// Whether the master lets the slave's processor access the information memory.
    pub(crate) fn offers_sii(&self) -> bool {
        self.byte(register::SII_CONFIG) & SII_OFFERED != 0
    }

    /// Whether the process-data watchdog has expired.
    pub(crate) fn watchdog_expired(&self) -> bool {
        self.byte(register::WATCHDOG_STATUS) & 1 == 0
    }

    /// Puts the inputs of a device without a processor into the memory that the silicon provides for them, and into the
    /// sync manager there.
    pub(crate) fn feed(&mut self, index: usize, start: usize, inputs: &[u8]) {
        if start >= REGISTER_SPACE {
            self.store(start, inputs);
        }
        let here = self
            .sync_managers
            .get(index)
            .is_some_and(|manager| manager.start() == start && manager.is_active());
        if here {
            self.with_sync_manager(index, |manager| manager.feed(inputs));
        }
    }

    /// Advances to a true time of the segment.
    pub(crate) fn advance(&mut self, now_ns: u64) {
        self.now_ns = self.now_ns.max(now_ns);
        self.clock.advance(self.now_ns);
        let reloaded = self
            .memory
            .get_mut(eeprom::BASE..eeprom::BASE + eeprom::LENGTH)
            .is_some_and(|registers| self.eeprom.advance(registers, self.now_ns));
        if reloaded {
            self.load_configuration();
        }
        if let Some((loops, until_ns)) = self.loops_before
            && self.now_ns >= until_ns
        {
            self.loops_before = None;
            self.store(register::DL_CONTROL + 1, &[loops]);
        }
    }

    /// Handles the arrival of a frame that will come back to the ports at `back_ns`.
    pub(crate) fn begin_frame(&mut self, arrival_ns: u64, back_ns: [Option<u64>; PORTS]) {
        self.advance(arrival_ns);
        self.back_ns = back_ns;
        self.frames = self.frames.wrapping_add(1);
    }

    /// The slave's processor carries out a command of an information memory that it emulates.
    pub(crate) fn serve_sii(&mut self) {
        let now_ns = self.now_ns;
        let reloaded = self
            .memory
            .get_mut(eeprom::BASE..eeprom::BASE + eeprom::LENGTH)
            .is_some_and(|registers| self.eeprom.serve(registers, now_ns));
        if reloaded {
            self.load_configuration();
        }
    }

    /// The slave's processor takes the information memory, or gives it back.
    pub(crate) fn hold_sii(&mut self, held: bool) {
        if let Some(registers) = self.memory.get_mut(eeprom::BASE..eeprom::BASE + eeprom::LENGTH) {
            self.eeprom.hold(held, registers);
        }
    }

    /// Whether the slave's processor has the information memory.
    pub(crate) fn holds_sii(&self) -> bool {
        self.eeprom.is_held()
    }

    /// Whether the bus has requested a reset of the controller; returned once.
    pub(crate) fn take_reset(&mut self) -> bool {
        let requested = self.reset.0 >= RESET_BYTES.len();
        if requested {
            self.reset = (0, 0);
        }
        requested
    }

    /// Takes a byte that the bus has written to the reset register; each has to come in a frame of its own.
    fn write_reset(&mut self, value: u8) {
        let (written, frame) = self.reset;
        let again = written > 0 && frame == self.frames;
        let expected = RESET_BYTES.get(written).filter(|_| !again);
        let written = match value {
            value if expected == Some(&value) => written + 1,
            value if RESET_BYTES.first() == Some(&value) && !again => 1,
            _ => 0,
        };
        self.reset = (written, self.frames);
        self.store(register::RESET, &[written.min(2) as u8]);
    }

    /// Whether frames of other protocols pass the slave.
    pub(crate) fn passes_foreign_frames(&self) -> bool {
        self.byte(register::DL_CONTROL) & FOREIGN_DESTROYED == 0
    }

    /// Whether frames leave and enter through a port.
    pub(crate) fn is_open(&self, port: u8) -> bool {
        let set = |ports: u8| ports >> port & 1 != 0;
        match self.loop_setting(port) {
            LoopSetting::Auto => set(self.links),
            LoopSetting::AutoClose => set(self.links) && !set(self.kept_closed),
            LoopSetting::Open => true,
            LoopSetting::Closed => false,
        }
    }

    fn loop_setting(&self, port: u8) -> LoopSetting {
        match self.byte(register::DL_CONTROL + 1) >> (2 * port) & 3 {
            0 => LoopSetting::Auto,
            1 => LoopSetting::AutoClose,
            2 => LoopSetting::Open,
            _ => LoopSetting::Closed,
        }
    }

    /// The events that the bus may ask for.
    fn events(&self) -> u16 {
        let flag = |set, bit| if set { bit } else { 0 };
        let managers = self.sync_managers.iter().enumerate();
        let managers = managers.filter(|(_, manager)| manager.has_event());
        managers.fold(
            flag(self.link_event, EVENT_LINK) | flag(self.state_event, EVENT_STATE),
            |events, (index, _)| events | EVENT_SYNC_MANAGER << index,
        )
    }

    /// Number of SYNC0 pulses since the last call.
    pub(crate) fn take_pulses(&mut self) -> u64 {
        self.clock.take_pulses()
    }

    /// Time to the next SYNC0 pulse, ns; `None` while none is generated, or not at the same place of each millisecond.
    pub(crate) fn pulse_ahead_ns(&self) -> Option<u64> {
        self.clock.pulse_ahead_ns()
    }

    /// System time of the clock at a true time of the segment, ns; `None` without a clock.
    pub(crate) fn system_at_ns(&self, true_ns: u64) -> Option<u64> {
        self.clock.system_at_ns(true_ns)
    }

    /// True time up to which the controller has run, ns.
    pub(crate) fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// State of the SYNC unit.
    pub(crate) fn sync_state(&self) -> SyncState {
        self.clock.state()
    }

    /// Sets a fault of the information memory.
    pub(crate) fn set_sii_fault(&mut self, fault: SiiFault) {
        if let Some(registers) = self.memory.get_mut(eeprom::BASE..eeprom::BASE + eeprom::LENGTH) {
            self.eeprom.set_fault(fault, registers);
        }
    }

    /// Sets whether it takes no process data: writes to logical addresses have no effect and do not count.
    pub(crate) fn set_deaf(&mut self, deaf: bool) {
        self.deaf = deaf;
    }

    /// Counts a damaged frame at port 0; `forwarded` if it was damaged before the cable at this port.
    pub(crate) fn count_damage(&mut self, forwarded: bool) {
        let counters: &[usize] = match forwarded {
            false => &[register::RECEIVE_ERRORS, register::RECEIVE_ERRORS + 1],
            true => &[register::RECEIVE_ERRORS, register::FORWARDED_ERRORS],
        };
        for counter in counters {
            self.count_up(*counter);
        }
    }

    /// Sets whether the slave's processor is running; counts expiries of its watchdog.
    pub(crate) fn set_processor(&mut self, alive: bool) {
        if self.processor_alive && !alive {
            self.count_up(register::WATCHDOG_PDI_COUNTER);
        }
        self.processor_alive = alive;
    }

    /// Time after which a stopped processor is an error, microseconds; `None` if that watchdog is off.
    pub(crate) fn processor_watchdog_us(&self) -> Option<u64> {
        self.watchdog_time_us(register::WATCHDOG_PDI)
    }

    fn count_up(&mut self, counter: usize) {
        let count = self.byte(counter).saturating_add(1);
        self.store(counter, &[count]);
    }

    /// A state request of the master; returned once.
    pub(crate) fn take_al_request(&mut self) -> Option<u16> {
        self.al_request.take()
    }

    /// Sets the application's state in the registers.
    pub(crate) fn set_al_status(&mut self, status: u16, code: u16) {
        self.state_event |= status != self.al_status() && !self.is_emulated();
        self.store(register::AL_STATUS, &status.to_le_bytes());
        self.store(register::AL_STATUS_CODE, &code.to_le_bytes());
    }

    /// Sets which ports have a link: bit n for port n; counts lost links.
    pub(crate) fn set_links(&mut self, links: u8) {
        let before = self.word(register::DL_STATUS) >> 4;
        self.kept_closed |= self.links & !links;
        self.links = links;
        let has_interface = self.byte(register::PDI_CONTROL) != 0;
        let mut status = u16::from(self.eeprom.is_loaded()) | u16::from(self.processor_alive && has_interface) << 1;
        for port in 0..PORTS as u16 {
            let linked = u16::from(links) >> port & 1;
            let closed = u16::from(!self.is_open(port as u8));
            status |= linked << (4 + port) | closed << (8 + 2 * port) | linked << (9 + 2 * port);
            if before >> port & 1 > linked {
                let counter = register::LOST_LINKS + usize::from(port);
                let count = self.byte(counter).saturating_add(1);
                self.store(counter, &[count]);
            }
        }
        self.link_event |= status != self.word(register::DL_STATUS);
        self.store(register::DL_STATUS, &status.to_le_bytes());
    }

    /// Sets whether the process-data watchdog has expired; counts expiries.
    pub(crate) fn set_watchdog(&mut self, expired: bool) {
        let before = self.byte(register::WATCHDOG_STATUS) & 1 != 0;
        self.store(register::WATCHDOG_STATUS, &[u8::from(!expired)]);
        if expired && before {
            let count = self.byte(register::WATCHDOG_COUNTER).saturating_add(1);
            self.store(register::WATCHDOG_COUNTER, &[count]);
        }
    }

    /// Time after which missing process data are an error, microseconds; `None` if the watchdog is off.
    pub(crate) fn watchdog_us(&self) -> Option<u64> {
        self.watchdog_time_us(register::WATCHDOG_PROCESS_DATA)
    }

    fn watchdog_time_us(&self, register: usize) -> Option<u64> {
        let periods = u64::from(self.word(register));
        let ticks = u64::from(self.word(register::WATCHDOG_DIVIDER)) + 2;
        (periods > 0).then(|| periods * ticks * CLOCK_TICK_NS / 1000)
    }

    /// A sync manager; `None` if the index does not exist.
    pub(crate) fn sync_manager(&self, index: usize) -> Option<&SyncManager> {
        self.sync_managers.get(index)
    }

    /// Accesses a sync manager from the application's side and updates its flags in the registers.
    pub(crate) fn with_sync_manager<R: Default>(
        &mut self,
        index: usize,
        work: impl FnOnce(&mut SyncManager) -> R,
    ) -> R {
        let Some(manager) = self.sync_managers.get_mut(index) else {
            return R::default();
        };
        let result = work(manager);
        self.mirror(index);
        result
    }

    /// Updates a sync manager's flags in its registers.
    fn mirror(&mut self, index: usize) {
        let Some(manager) = self.sync_managers.get(index) else {
            return;
        };
        let (status, pdi) = (manager.status(), manager.pdi_control());
        let at = register::SYNC_MANAGER + index * sync_manager::BLOCK;
        self.store(at + sync_manager::STATUS_OFFSET, &[status]);
        self.store(at + sync_manager::PDI_CONTROL_OFFSET, &[pdi]);
    }

    fn store(&mut self, at: usize, data: &[u8]) -> bool {
        self.memory.get_mut(at..at + data.len()).is_some_and(|target| {
            target.copy_from_slice(data);
            true
        })
    }

    fn byte(&self, at: usize) -> u8 {
        self.memory.get(at).copied().unwrap_or(0)
    }

    fn word(&self, at: usize) -> u16 {
        u16::from_le_bytes([self.byte(at), self.byte(at + 1)])
    }
}

#[cfg(test)]
mod tests;
