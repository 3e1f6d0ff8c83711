//! Processing of a passing datagram: addressing, logical mapping, registers, memory and sync managers.
//!
//! Only what exists in the silicon is read and written: units beyond its numbers, registers of a clock that it does not
//! have and memory behind its end leave the working counter alone. An access that reaches one existing byte counts.

use super::*;
use crate::bits::{bit, set_bit};
use etherpen_ethercat::wire::Command;
use fmmu::Overlap;

/// Registers before a write that change what the write does.
#[derive(Clone, Copy, Debug)]
struct Before {
    /// Whether the slave's processor has not read the last state request.
    unread: bool,
    /// Whether the information memory is offered to the slave's processor.
    offered: bool,
    /// Settings of the loops.
    loops: u8,
}

impl Controller {
    /// Reports the present events in the interrupt field of a datagram and processes it.
    pub(crate) fn pass(&mut self, datagram: &mut Datagram) {
        let mask = self.word(register::EVENT_MASK);
        if mask != 0 {
            datagram.report(self.events() & mask);
        }
        self.process(datagram);
    }

    fn process(&mut self, datagram: &mut Datagram) {
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
        if command == Command::Lrw && self.silicon.ignores_lrw {
            return;
        }
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
            if writes && unit.writes && !self.deaf {
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
        let touches = |register: usize| address < register + 2 && address + into.len() > register;
        self.link_event &= !touches(register::DL_STATUS);
        self.state_event &= !touches(register::AL_STATUS);
        if touches(register::EVENT_REQUEST) {
            self.store(register::EVENT_REQUEST, &self.events().to_le_bytes());
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
                None if at < REGISTER_SPACE => self.read_registers(at, part),
                None => self.memory.get(at..at + length).is_some_and(|source| {
                    part.copy_from_slice(source);
                    true
                }),
            };
            done += length;
        }
        success
    }

    /// Reads registers; what does not exist reads as 0. True if any of them exists.
    fn read_registers(&self, start: usize, into: &mut [u8]) -> bool {
        let mut success = false;
        for (at, byte) in (start..).zip(into) {
            let exists = self.exists(at);
            *byte = if exists { self.byte(at) } else { 0 };
            success |= exists;
        }
        success
    }

    /// Whether the silicon has this register.
    fn exists(&self, at: usize) -> bool {
        let silicon = &self.silicon;
        let unit = |start: usize, block: usize| at.checked_sub(start).map(|offset| offset / block);
        let fmmu = unit(register::FMMU, fmmu::BLOCK).filter(|unit| *unit < UNITS);
        let manager = unit(register::SYNC_MANAGER, sync_manager::BLOCK).filter(|unit| *unit < UNITS);
        let clock = at.checked_sub(clock::BASE).filter(|offset| *offset < clock::LENGTH);
        fmmu.is_none_or(|unit| unit < usize::from(silicon.fmmus))
            && manager.is_none_or(|unit| unit < usize::from(silicon.sync_managers))
            && clock.is_none_or(|offset| self.clock.has_register(offset))
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
        let memory_end = self.memory_end();
        let mut end = if at < REGISTER_SPACE {
            REGISTER_SPACE
        } else {
            memory_end
        };
        let mut governor = None;
        for (index, manager) in self.sync_managers.iter().enumerate() {
            if !manager.is_active() || manager.start() < DIGITAL_OUTPUTS || manager.end() > memory_end {
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

    /// First address behind the process memory.
    fn memory_end(&self) -> usize {
        (REGISTER_SPACE + 1024 * usize::from(self.silicon.memory_kib)).min(MEMORY)
    }

    fn write_registers(&mut self, start: usize, data: &[u8]) -> bool {
        if self.silicon.takes_pairs && reaches_beyond_pair(start, data.len()) {
            return false;
        }
        let before = Before {
            unread: self.al_request.is_some() && !self.is_emulated(),
            offered: self.offers_sii(),
            loops: self.byte(register::DL_CONTROL + 1),
        };
        let Before { unread, offered, .. } = before;
        let locked = std::array::from_fn::<bool, SYNC_MANAGERS, _>(|index| {
            let manager = self.sync_managers.get(index);
            manager.is_some_and(|manager| manager.is_enabled())
        });
        let mut success = false;
        for (at, value) in (start..).zip(data) {
            let in_request = (register::AL_CONTROL..register::AL_CONTROL + 2).contains(&at);
            let in_sii = (register::SII_CONTROL..eeprom::BASE + eeprom::LENGTH).contains(&at);
            if in_request && unread || in_sii && offered || !self.exists(at) {
                continue;
            }
            let in_manager = at.wrapping_sub(register::SYNC_MANAGER);
            let is_locked = locked.get(in_manager / sync_manager::BLOCK).copied().unwrap_or(false)
                && in_manager % sync_manager::BLOCK < sync_manager::LOCKED_LENGTH;
            let in_times = (clock::BASE..clock::BASE + clock::TIMES_LENGTH).contains(&at);
            if is_locked || in_times {
                success = true;
            } else if register::is_counter(at) {
                success |= self.store(at, &[0]);
            } else if !register::is_read_only(at) {
                success |= self.store(at, &[*value]);
            }
        }
        self.obey(start, data, before);
        success
    }

    /// Acts on registers that were written.
    fn obey(&mut self, start: usize, data: &[u8], before: Before) {
        let Before { unread, offered, loops } = before;
        let touches = |from: usize, length: usize| start < from + length && from < start + data.len();
        if touches(register::AL_CONTROL, 1) {
            let control = self.word(register::AL_CONTROL);
            if self.is_emulated() {
                self.set_al_status(control & AL_CONTROL_MASK, 0);
            } else if !unread {
                self.al_request = Some(control);
            }
        }
        if let Some(value) = register::RESET.checked_sub(start).and_then(|at| data.get(at)) {
            self.write_reset(*value);
        }
        if touches(register::DL_CONTROL + 1, 1) {
            self.kept_closed = 0;
            let temporary = self.byte(register::DL_CONTROL) & LOOPS_TEMPORARY != 0;
            let kept = self.loops_before.map_or(loops, |(loops, _)| loops);
            self.loops_before = temporary.then(|| (kept, self.now_ns.saturating_add(LOOPS_TEMPORARY_NS)));
            self.set_links(self.links);
        }
        if let Some(registers) = self.memory.get_mut(eeprom::BASE..eeprom::BASE + eeprom::LENGTH) {
            if touches(register::SII_CONFIG, 1) {
                self.eeprom.configure(registers);
            }
            if touches(register::SII_CONTROL, 2) && !offered {
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
                self.configure_sync_manager(index, block);
            }
        }
    }

    /// A sync manager takes its registers. Its memory keeps the last mail, which the bus reads like any other memory
    /// once the sync manager is off.
    fn configure_sync_manager(&mut self, index: usize, block: [u8; sync_manager::BLOCK]) {
        let before = self.sync_managers.get(index);
        let mail = before.and_then(|manager| Some((manager.start(), manager.mail()?.to_vec())));
        self.with_sync_manager(index, |manager| manager.configure(block));
        if let Some((start, mail)) = mail.filter(|(start, _)| *start >= REGISTER_SPACE) {
            self.store(start, &mail);
        }
    }
}

/// Whether an access to FMMUs or sync managers reaches more than two of them.
fn reaches_beyond_pair(start: usize, length: usize) -> bool {
    let units = [
        (register::FMMU, fmmu::BLOCK),
        (register::SYNC_MANAGER, sync_manager::BLOCK),
    ];
    units.into_iter().any(|(first, block)| {
        let offset = start.checked_sub(first).filter(|offset| *offset < UNITS * block);
        offset.is_some_and(|offset| offset % block + length > 2 * block)
    })
}
