//! The EtherCAT slave controller: registers, process memory and the processing of passing datagrams.
//!
//! Datagrams are processed in place, as in the silicon: reads put bytes into the datagram, writes take bytes out, and
//! the working counter counts the successes. The controller does not know the device behind it; the application uses
//! sync managers and the state registers. Register layout: the slave controller's register description (ET1100 as the
//! pattern).

pub(crate) mod clock;
pub(crate) mod datagram;
mod fmmu;
pub(crate) mod silicon;
mod sync_manager;

use crate::bits::{bit, set_bit};
use crate::eeprom::{self, Eeprom, SiiFault};
use crate::registers as register;
use clock::{DistributedClock, SyncState};
use datagram::Datagram;
use etherpen_ethercat::wire::Command;
use etherpen_ethercat::wire::register::WATCHDOG_DIVIDER_100_US;
use fmmu::{Fmmu, Overlap};
use silicon::{ClockWidth, Silicon};
use sync_manager::SyncManager;

/// Bytes of register space.
const REGISTER_SPACE: usize = 0x1000;
/// Bytes of register space and process memory.
const MEMORY: usize = 0x3000;
/// Most sync managers.
const SYNC_MANAGERS: usize = 8;
/// Most fieldbus memory management units.
const FMMUS: usize = 8;
/// Features: distributed clocks, and 64-bit distributed clocks.
const FEATURE_CLOCK: u16 = 0x0004;
const FEATURE_CLOCK_64: u16 = 0x0008;

const _: () = {
    assert!(register::SYNC_MANAGER + SYNC_MANAGERS * sync_manager::BLOCK <= REGISTER_SPACE);
    assert!(register::FMMU + FMMUS * fmmu::BLOCK <= register::SYNC_MANAGER);
};

/// Watchdog divider for 100 us, and 1000 of these units: the defaults after power-up.
const WATCHDOG_DIVIDER_DEFAULT: u16 = WATCHDOG_DIVIDER_100_US;
const WATCHDOG_PROCESS_DATA_DEFAULT: u16 = 1000;
/// Length of the controller's clock tick, nanoseconds.
const CLOCK_TICK_NS: u64 = 40;

/// Word addresses of the fields loaded at power-up: interface control, pulse length, alias.
const WORD_PDI_CONTROL: usize = 0;
const WORD_PULSE_LENGTH: usize = 2;
const WORD_ALIAS: usize = 4;

/// Individual properties of a controller.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nature {
    /// Rate error of the crystal, 1e-9; positive if it is fast.
    pub(crate) drift_ppb: i64,
    /// Running time of the clock at the start, ns.
    pub(crate) local_ns: u64,
    /// Duration of a command of the information memory, ns.
    pub(crate) sii_busy_ns: u64,
}

impl Default for Nature {
    fn default() -> Self {
        Self {
            drift_ppb: 0,
            local_ns: 0,
            sii_busy_ns: eeprom::BUSY_NS,
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
    back_ns: Option<u64>,
    processor_alive: bool,
    al_request: Option<u16>,
}

impl Controller {
    /// A controller after power-up with this information memory.
    pub(crate) fn new(silicon: Silicon, image: Vec<u8>, nature: Nature) -> Self {
        let mut controller = Self {
            silicon,
            memory: Vec::new(),
            sync_managers: Default::default(),
            fmmus: Default::default(),
            eeprom: Eeprom::new(image, nature.sii_busy_ns),
            clock: DistributedClock::new(silicon.clock, nature.drift_ppb, 0),
            now_ns: 0,
            back_ns: None,
            processor_alive: true,
            al_request: None,
        };
        controller.power_up();
        controller.clock = DistributedClock::new(silicon.clock, nature.drift_ppb, nature.local_ns);
        controller
    }

    /// Resets everything volatile.
    pub(crate) fn power_up(&mut self) {
        self.memory.clear();
        self.memory.resize(MEMORY, 0);
        self.sync_managers = Default::default();
        self.fmmus = Default::default();
        self.al_request = None;
        self.describe();
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
        self.load_configuration();
        for index in 0..SYNC_MANAGERS {
            self.mirror(index);
        }
    }

    fn describe(&mut self) {
        let silicon = self.silicon;
        let features = match silicon.clock {
            ClockWidth::None => 0,
            ClockWidth::Bits32 => FEATURE_CLOCK,
            ClockWidth::Bits64 => FEATURE_CLOCK | FEATURE_CLOCK_64,
        };
        self.store(register::TYPE, &silicon.identity);
        let counts = [silicon.fmmus, silicon.sync_managers, silicon.memory_kib, silicon.ports];
        self.store(register::TYPE + silicon.identity.len(), &counts);
        self.store(register::FEATURES, &u16::to_le_bytes(features));
    }

    /// Loads the configuration from the information memory, if its checksum is correct.
    fn load_configuration(&mut self) {
        if !self.eeprom.is_valid() {
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
    }

    /// Handles the arrival of a frame that will come back from the chain behind at `back_ns`.
    pub(crate) fn begin_frame(&mut self, arrival_ns: u64, back_ns: Option<u64>) {
        self.advance(arrival_ns);
        self.back_ns = back_ns;
    }

    /// Number of SYNC0 pulses since the last call.
    pub(crate) fn take_pulses(&mut self) -> u64 {
        self.clock.take_pulses()
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

    /// Processes a datagram.
    pub(crate) fn pass(&mut self, datagram: &mut Datagram) {
        let command = datagram.command();
        let device = datagram.device();
        if command.counts_position() {
            datagram.set_device(device.wrapping_add(1));
        }
        let addressed = match command {
            Command::Nop => return,
            Command::Lrd | Command::Lwr | Command::Lrw => return self.logical(datagram, command),
            Command::Brd | Command::Bwr | Command::Brw => true,
            Command::Aprd | Command::Apwr | Command::Aprw | Command::Armw => device == 0,
            Command::Fprd | Command::Fpwr | Command::Fprw | Command::Frmw => self.answers_to(device),
        };
        self.physical(datagram, command, addressed);
    }

    /// A state request of the master; returned once.
    pub(crate) fn take_al_request(&mut self) -> Option<u16> {
        self.al_request.take()
    }

    /// Sets the application's state in the registers.
    pub(crate) fn set_al_status(&mut self, status: u16, code: u16) {
        self.store(register::AL_STATUS, &status.to_le_bytes());
        self.store(register::AL_STATUS_CODE, &code.to_le_bytes());
    }

    /// Sets which ports have a link: bit n for port n; counts lost links.
    pub(crate) fn set_links(&mut self, links: u8) {
        let before = self.word(register::DL_STATUS) >> 4;
        let mut status = u16::from(self.eeprom.is_valid()) | u16::from(self.processor_alive) << 1;
        for port in 0..4u16 {
            let linked = u16::from(links) >> port & 1;
            let closed = 1 - linked;
            status |= linked << (4 + port) | closed << (8 + 2 * port) | linked << (9 + 2 * port);
            if before >> port & 1 > linked {
                let counter = register::LOST_LINKS + usize::from(port);
                let count = self.byte(counter).saturating_add(1);
                self.store(counter, &[count]);
            }
        }
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

    fn answers_to(&self, station: u16) -> bool {
        let alias_enabled = self.byte(register::DL_CONTROL + 3) & 1 != 0;
        self.word(register::STATION_ADDRESS) == station
            || (alias_enabled && self.word(register::STATION_ALIAS) == station)
    }

    fn physical(&mut self, datagram: &mut Datagram, command: Command, addressed: bool) {
        let multiple = matches!(command, Command::Armw | Command::Frmw);
        let broadcast = matches!(command, Command::Brd | Command::Brw);
        let reads = command.reads() && addressed;
        let writes = command.writes() && (addressed != multiple);
        if !reads && !writes {
            return;
        }
        let register = usize::from(datagram.register());
        let incoming = datagram.data().to_vec();
        let mut count = 0;
        if reads {
            let mut read = vec![0; incoming.len()];
            if self.read(register, &mut read) {
                count += 1;
                if broadcast {
                    read.iter_mut()
                        .zip(&incoming)
                        .for_each(|(byte, passing)| *byte |= passing);
                }
                datagram.data_mut().copy_from_slice(&read);
            }
        }
        if writes && self.write(register, &incoming) {
            count += if reads { 2 } else { 1 };
        }
        datagram.count(count);
    }

    fn logical(&mut self, datagram: &mut Datagram, command: Command) {
        let (reads, writes) = (command.reads(), command.writes());
        let logical = datagram.logical_address();
        let length = datagram.data().len();
        let incoming = if writes { datagram.data().to_vec() } else { Vec::new() };
        let (mut has_read, mut has_written) = (false, false);
        for unit in self.fmmus.into_iter().flatten() {
            let Some(overlap) = unit.overlap(logical, length) else {
                continue;
            };
            if reads && unit.reads {
                has_read |= self.read_mapped(overlap, datagram.data_mut());
            }
            if writes && unit.writes {
                has_written |= self.write_mapped(overlap, &incoming);
            }
        }
        let written = if reads { 2 } else { 1 };
        datagram.count(u16::from(has_read) + if has_written { written } else { 0 });
    }

    fn read_mapped(&mut self, overlap: Overlap, data: &mut [u8]) -> bool {
        match overlap {
            Overlap::Bytes {
                offset,
                address,
                length,
            } => data
                .get_mut(offset..offset + length)
                .is_some_and(|into| self.read_or_keep(usize::from(address), into)),
            Overlap::Bits {
                offset_bits,
                physical_bits,
                count,
            } => {
                let mut bytes = vec![0; (physical_bits % 8 + count).div_ceil(8)];
                let read = self.read(physical_bits / 8, &mut bytes);
                for index in (0..count).filter(|_| read) {
                    set_bit(data, offset_bits + index, bit(&bytes, physical_bits % 8 + index));
                }
                read
            }
        }
    }

    fn write_mapped(&mut self, overlap: Overlap, data: &[u8]) -> bool {
        match overlap {
            Overlap::Bytes {
                offset,
                address,
                length,
            } => data
                .get(offset..offset + length)
                .is_some_and(|from| self.write(usize::from(address), from)),
            Overlap::Bits {
                offset_bits,
                physical_bits,
                count,
            } => {
                let start = physical_bits / 8;
                let length = (physical_bits % 8 + count).div_ceil(8);
                let Some(present) = self.memory.get(start..start + length) else {
                    return false;
                };
                let mut bytes = present.to_vec();
                for index in 0..count {
                    set_bit(&mut bytes, physical_bits % 8 + index, bit(data, offset_bits + index));
                }
                self.write(start, &bytes)
            }
        }
    }

    /// Reads into a part of a datagram; leaves it unchanged if nothing could be read.
    fn read_or_keep(&mut self, address: usize, into: &mut [u8]) -> bool {
        let mut read = into.to_vec();
        let success = self.read(address, &mut read);
        if success {
            into.copy_from_slice(&read);
        }
        success
    }

    /// Reads registers or memory; true if anything could be read.
    fn read(&mut self, address: usize, into: &mut [u8]) -> bool {
        if address < clock::BASE + clock::LENGTH
            && address + into.len() > clock::BASE
            && let Some(registers) = self.memory.get_mut(clock::BASE..clock::BASE + clock::LENGTH)
        {
            self.clock.show(registers);
        }
        let mut success = false;
        let mut done = 0;
        while let Some((manager, length)) = self.stretch(address + done, into.len() - done) {
            let at = address + done;
            let Some(part) = into.get_mut(done..done + length) else {
                break;
            };
            success |= match manager {
                Some(index) => self.with_sync_manager(index, |manager| manager.bus_read(at - manager.start(), part)),
                None => self.memory.get(at..at + length).is_some_and(|source| {
                    part.copy_from_slice(source);
                    true
                }),
            };
            done += length;
        }
        success
    }

    /// Writes registers or memory; true if anything could be written.
    fn write(&mut self, address: usize, data: &[u8]) -> bool {
        let mut success = false;
        let mut done = 0;
        while let Some((manager, length)) = self.stretch(address + done, data.len() - done) {
            let at = address + done;
            let Some(part) = data.get(done..done + length) else {
                break;
            };
            success |= match manager {
                Some(index) => {
                    let written =
                        self.with_sync_manager(index, |manager| manager.bus_write(at - manager.start(), part));
                    written && self.store(at, part)
                }
                None if at < REGISTER_SPACE => self.write_registers(at, part),
                None => self.store(at, part),
            };
            done += length;
        }
        success
    }

    /// For up to `wanted` bytes at an address: the sync manager that controls the first byte, if any, and the number of
    /// bytes under this control. `None` at the end of the memory or of the request.
    fn stretch(&self, at: usize, wanted: usize) -> Option<(Option<usize>, usize)> {
        let mut end = if at < REGISTER_SPACE { REGISTER_SPACE } else { MEMORY };
        let mut governor = None;
        for (index, manager) in self.sync_managers.iter().enumerate() {
            if !manager.is_active() || manager.start() < REGISTER_SPACE || manager.end() > MEMORY {
                continue;
            }
            if governor.is_none() && (manager.start()..manager.end()).contains(&at) {
                governor = Some(index);
                end = end.min(manager.end());
            } else if manager.start() > at {
                end = end.min(manager.start());
            }
        }
        let length = end.checked_sub(at)?.min(wanted);
        (length > 0).then_some((governor, length))
    }

    fn write_registers(&mut self, start: usize, data: &[u8]) -> bool {
        let touches = |from: usize, length: usize| start < from + length && from < start + data.len();
        let unread = self.al_request.is_some();
        let mut success = false;
        for (offset, value) in data.iter().enumerate() {
            let at = start + offset;
            if unread && (register::AL_CONTROL..register::AL_CONTROL + 2).contains(&at) {
                continue;
            }
            if self.clock.exists() && (clock::BASE..clock::BASE + clock::TIMES_LENGTH).contains(&at) {
                success = true;
            } else if register::is_counter(at) {
                success |= self.store(at, &[0]);
            } else if !register::is_read_only(at) {
                success |= self.store(at, &[*value]);
            }
        }
        if touches(register::AL_CONTROL, 1) && !unread {
            self.al_request = Some(self.word(register::AL_CONTROL));
        }
        if let Some(registers) = self.memory.get_mut(eeprom::BASE..eeprom::BASE + eeprom::LENGTH) {
            if touches(register::SII_CONFIG, 1) {
                self.eeprom.configure(registers);
            }
            if touches(register::SII_CONTROL, 2) {
                self.eeprom.command(registers, self.now_ns);
            }
        }
        if touches(clock::BASE, clock::LENGTH)
            && let Some(registers) = self.memory.get_mut(clock::BASE..clock::BASE + clock::LENGTH)
        {
            // A write may begin before the clock's registers; that part does not belong to the clock.
            let skipped = clock::BASE.saturating_sub(start);
            let data = data.get(skipped..).unwrap_or_default();
            self.clock
                .written(registers, start.saturating_sub(clock::BASE), data, self.back_ns);
        }
        for index in 0..FMMUS {
            let at = register::FMMU + index * fmmu::BLOCK;
            if touches(at, fmmu::BLOCK)
                && let Some(unit) = self.fmmus.get_mut(index)
                && let Some(&block) = self.memory.get(at..).and_then(|rest| rest.first_chunk())
            {
                *unit = Fmmu::from_block(block);
            }
        }
        for index in 0..SYNC_MANAGERS {
            let at = register::SYNC_MANAGER + index * sync_manager::BLOCK;
            if touches(at, sync_manager::BLOCK)
                && let Some(&block) = self.memory.get(at..).and_then(|rest| rest.first_chunk())
            {
                self.with_sync_manager(index, |manager| manager.configure(block));
            }
        }
        success
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
