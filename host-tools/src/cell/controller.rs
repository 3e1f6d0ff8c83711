//! The EtherCAT slave controller: registers, process memory and what a passing datagram does to them.
//!
//! Everything happens in place in the passing bytes, as in the silicon: reads put bytes into the datagram, writes
//! take them out, the working counter counts what succeeded. The controller knows no device behind it; the
//! application reaches it through sync managers and the state registers. Register layout: the slave controller's
//! register description (ET1100 as the pattern).

use super::datagram::Datagram;
use super::device::{ClockWidth, Silicon};
use super::eeprom::{self, Eeprom};
use super::fmmu::{self, Fmmu, Overlap, bit, set_bit};
use super::registers as register;
use super::sync_manager::{self, SyncManager};
use etherpen::ethercat::wire::Command;
use etherpen::ethercat::wire::register::WATCHDOG_DIVIDER_100_US;

/// Bytes of register space.
const REGISTER_SPACE: usize = 0x1000;
/// Bytes of register space and process memory.
const MEMORY: usize = 0x3000;
/// Sync managers at most.
const SYNC_MANAGERS: usize = 8;
/// Fieldbus memory management units at most.
const FMMUS: usize = 8;
/// Features: distributed clocks, and 64 bits of them.
const FEATURE_CLOCK: u16 = 0x0004;
const FEATURE_CLOCK_64: u16 = 0x0008;

const _: () = {
    assert!(register::SYNC_MANAGER + SYNC_MANAGERS * sync_manager::BLOCK <= REGISTER_SPACE);
    assert!(register::FMMU + FMMUS * fmmu::BLOCK <= register::SYNC_MANAGER);
};

/// Watchdog base of 100 us and 1000 of them: the defaults after power-up.
const WATCHDOG_DIVIDER_DEFAULT: u16 = WATCHDOG_DIVIDER_100_US;
const WATCHDOG_PROCESS_DATA_DEFAULT: u16 = 1000;
/// Length of the controller's clock tick, nanoseconds.
const CLOCK_TICK_NS: u64 = 40;

/// Registers and memory of one slave controller.
#[derive(Clone, Debug)]
pub(super) struct Controller {
    silicon: Silicon,
    memory: Vec<u8>,
    sync_managers: [SyncManager; SYNC_MANAGERS],
    fmmus: [Option<Fmmu>; FMMUS],
    eeprom: Eeprom,
    al_request: Option<u16>,
}

impl Controller {
    /// A controller after power-up with this content of its information memory.
    pub(super) fn new(silicon: Silicon, image: Vec<u8>) -> Self {
        let mut controller = Self {
            silicon,
            memory: Vec::new(),
            sync_managers: Default::default(),
            fmmus: Default::default(),
            eeprom: Eeprom::new(image),
            al_request: None,
        };
        controller.power_up();
        controller
    }

    /// Everything volatile back to its reset value.
    pub(super) fn power_up(&mut self) {
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

    /// One millisecond of the controller's own machinery.
    pub(super) fn step(&mut self) {
        if let Some(registers) = self.memory.get_mut(eeprom::BASE..eeprom::BASE + eeprom::LENGTH) {
            self.eeprom.step(registers);
        }
    }

    /// Lets a datagram pass.
    pub(super) fn pass(&mut self, datagram: &mut Datagram) {
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

    /// A state request of the master, once.
    pub(super) fn take_al_request(&mut self) -> Option<u16> {
        self.al_request.take()
    }

    /// Shows the application's state to the bus.
    pub(super) fn set_al_status(&mut self, status: u16, code: u16) {
        self.store(register::AL_STATUS, &status.to_le_bytes());
        self.store(register::AL_STATUS_CODE, &code.to_le_bytes());
    }

    /// Shows which ports have a link: bit n for port n; counts the links that went.
    pub(super) fn set_links(&mut self, links: u8) {
        let before = self.word(register::DL_STATUS) >> 4;
        let mut status: u16 = 0x0001;
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

    /// Shows whether the process-data watchdog has expired; counts expiries.
    pub(super) fn set_watchdog(&mut self, expired: bool) {
        let before = self.byte(register::WATCHDOG_STATUS) & 1 != 0;
        self.store(register::WATCHDOG_STATUS, &[u8::from(!expired)]);
        if expired && before {
            let count = self.byte(register::WATCHDOG_COUNTER).saturating_add(1);
            self.store(register::WATCHDOG_COUNTER, &[count]);
        }
    }

    /// Time after which missing process data are an error, microseconds; nothing if the watchdog is off.
    pub(super) fn watchdog_us(&self) -> Option<u64> {
        let periods = u64::from(self.word(register::WATCHDOG_PROCESS_DATA));
        let ticks = u64::from(self.word(register::WATCHDOG_DIVIDER)) + 2;
        (periods > 0).then(|| periods * ticks * CLOCK_TICK_NS / 1000)
    }

    /// A sync manager; an index that does not exist gives nothing.
    pub(super) fn sync_manager(&self, index: usize) -> Option<&SyncManager> {
        self.sync_managers.get(index)
    }

    /// Works on a sync manager from the application's side and shows its flags to the bus.
    pub(super) fn with_sync_manager<R: Default>(
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

    /// Reads into a part of a datagram, which stays as it is where nothing could be read.
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

    /// Of up to `wanted` bytes at an address: who governs the first, and how many belong to the same; nothing at
    /// the end of what exists or is wanted.
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
        let mut success = false;
        for (offset, value) in data.iter().enumerate() {
            let at = start + offset;
            if register::is_counter(at) {
                success |= self.store(at, &[0]);
            } else if !register::is_read_only(at) {
                success |= self.store(at, &[*value]);
            }
        }
        let touches = |from: usize, length: usize| start < from + length && from < start + data.len();
        if touches(register::AL_CONTROL, 1) {
            self.al_request = Some(self.word(register::AL_CONTROL));
        }
        if touches(register::SII_CONTROL, 2)
            && let Some(registers) = self.memory.get_mut(eeprom::BASE..eeprom::BASE + eeprom::LENGTH)
        {
            self.eeprom.command(registers);
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

    /// Shows a sync manager's flags in its registers.
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
mod tests {
    use super::*;
    use crate::cell::datagram::Datagrams;
    use crate::cell::test_bench::*;

    /// Lets one datagram pass; gives its data and working counter afterwards.
    fn pass(controller: &mut Controller, command: u8, device: u16, register: u16, data: &[u8]) -> (Vec<u8>, u16) {
        let mut frame = frame_of(&[(command, device, register, data)]);
        let mut datagrams = Datagrams::of_frame(&mut frame).expect("a frame");
        controller.pass(&mut datagrams.next().expect("a datagram"));
        content(&frame, data.len())
    }

    fn controller() -> Controller {
        Controller::new(Silicon::ET1100, vec![0; 128])
    }

    #[test]
    fn registers_of_the_controller_itself_are_not_written() {
        let mut controller = controller();
        for register in [0x0000, 0x0004, 0x0110, 0x0130, 0x0134, 0x0440, 0x0805, 0x0807] {
            let before = pass(&mut controller, APRD, 0, register, &[0]).0;
            assert_eq!(pass(&mut controller, APWR, 0, register, &[0xAA]).1, 0, "{register:#x}");
            assert_eq!(
                pass(&mut controller, APRD, 0, register, &[0]).0,
                before,
                "{register:#x}"
            );
        }
    }

    #[test]
    fn error_counters_are_cleared_by_writing() {
        let mut controller = controller();
        for links in [3, 1, 3, 1] {
            controller.set_links(links);
        }
        assert_eq!(pass(&mut controller, APRD, 0, 0x0310, &[0; 4]).0, [0, 2, 0, 0]);
        assert_eq!(pass(&mut controller, APWR, 0, 0x0310, &[9; 4]).1, 1);
        assert_eq!(pass(&mut controller, APRD, 0, 0x0310, &[7; 4]).0, [0; 4]);
    }

    #[test]
    fn memory_ends_and_nothing_is_there_behind_it() {
        let mut controller = controller();
        assert_eq!(pass(&mut controller, APRD, 0, 0x3000, &[7; 4]), (vec![7; 4], 0));
        assert_eq!(pass(&mut controller, APWR, 0, 0xFFFE, &[7; 4]).1, 0);
        assert_eq!(
            pass(&mut controller, APWR, 0, 0x2FFE, &[7; 4]).1,
            1,
            "the part that exists"
        );
    }

    #[test]
    fn the_alias_answers_only_when_it_is_switched_on() {
        let mut controller = controller();
        pass(&mut controller, APWR, 0, 0x0010, &[0x01, 0x10, 0x55, 0x00]);
        assert_eq!(pass(&mut controller, FPRD, 0x1001, 0x0012, &[0; 2]), (vec![0x55, 0], 1));
        assert_eq!(pass(&mut controller, FPRD, 0x0055, 0x0012, &[0; 2]).1, 0);
        pass(&mut controller, APWR, 0, 0x0103, &[1]);
        assert_eq!(pass(&mut controller, FPRD, 0x0055, 0x0012, &[0; 2]).1, 1);
    }

    #[test]
    fn a_read_and_write_counts_three_and_gives_the_old_content() {
        let mut controller = controller();
        assert_eq!(pass(&mut controller, APRW, 0, 0x1000, &[5, 6]), (vec![0, 0], 3));
        assert_eq!(pass(&mut controller, APRW, 0, 0x1000, &[7, 8]), (vec![5, 6], 3));
        assert_eq!(
            pass(&mut controller, BRW, 9, 0x1000, &[0x10, 0]),
            (vec![0x17, 8], 3),
            "or-ed"
        );
        assert_eq!(pass(&mut controller, APRD, 0, 0x1000, &[0; 2]).0, [0x10, 0]);
    }

    #[test]
    fn the_others_write_what_one_reads() {
        let mut controller = controller();
        pass(&mut controller, APWR, 0, 0x1000, &[5]);
        assert_eq!(pass(&mut controller, ARMW, 0, 0x1000, &[9]), (vec![5], 1));
        assert_eq!(pass(&mut controller, ARMW, 1, 0x1000, &[9]), (vec![9], 1));
        assert_eq!(pass(&mut controller, APRD, 0, 0x1000, &[0]).0, [9]);
    }

    #[test]
    fn single_bits_pass_through_a_mapping_and_leave_their_neighbours() {
        let mut controller = controller();
        pass(&mut controller, APWR, 0, 0x1000, &[0xF0, 0x0F]);
        let write = [0, 0, 0, 0, 1, 0, 2, 4, 0x00, 0x10, 3, 2, 1, 0, 0, 0];
        pass(&mut controller, APWR, 0, 0x0600, &write);
        let read = [1, 0, 0, 0, 1, 0, 0, 3, 0x01, 0x10, 2, 1, 1, 0, 0, 0];
        pass(&mut controller, APWR, 0, 0x0610, &read);
        let (data, count) = pass(&mut controller, LRW, 0, 0, &[0b0000_0100, 0xA0]);
        assert_eq!((data, count), (vec![0b0000_0100, 0xA3], 3));
        assert_eq!(pass(&mut controller, APRD, 0, 0x1000, &[0; 2]).0, [0b1100_1000, 0x0F]);
    }

    #[test]
    fn a_mailbox_that_is_written_short_stays_empty() {
        let mut controller = controller();
        pass(&mut controller, APWR, 0, 0x0800, &[0x00, 0x18, 8, 0, 0x26, 0, 1, 0]);
        assert_eq!(pass(&mut controller, APWR, 0, 0x1800, &[1; 7]).1, 1);
        assert_eq!(pass(&mut controller, APRD, 0, 0x0805, &[0]).0[0] & 0x08, 0);
        assert_eq!(pass(&mut controller, APWR, 0, 0x1800, &[1; 8]).1, 1);
        assert_eq!(pass(&mut controller, APRD, 0, 0x0805, &[0]).0[0] & 0x08, 0x08);
        assert_eq!(pass(&mut controller, APWR, 0, 0x1800, &[2; 8]).1, 0);
    }
}
