//! The slave information memory behind registers 0x0500 to 0x050F.
//!
//! A command keeps the interface busy for some of the segment's time; the word address counts 16-bit words; a read
//! returns eight bytes, or four with some controllers. Where the slave's processor emulates the memory, a command waits
//! for the processor. After a write the memory acknowledges nothing until it has stored the word. While the processor owns the memory (register 0x0501), or the memory is offered to it, commands
//! are refused. Register layout: EEPROM interface of the slave controller's register description.

pub(crate) mod content;
pub(crate) mod esi;
pub(crate) mod sii;
pub(crate) mod windows;

use crate::registers;
use etherpen_ethercat::wire::register as wire;
use etherpen_ethercat::wire::sii::{WORD_CHECKSUM, checksum};

/// First register of the interface.
pub(crate) const BASE: usize = registers::SII_CONFIG;
/// Bytes of the interface.
pub(crate) const LENGTH: usize = 16;
/// Default duration of a read, ns: eight bytes at 400 kHz.
pub(crate) const BUSY_NS: u64 = 300_000;
/// Bytes that pass the wire to the memory in a read.
const READ_BYTES: u64 = 12;
/// Time in which a memory stores a word after the command has ended, ns: an EK1100 (capture of ethercrab's alias address)
/// refused commands up to 2.9 ms after a write and took them from 3.5 ms on.
const STORE_NS: u64 = 3_200_000;

const CONFIG: usize = 0;
const PDI_ACCESS: usize = (wire::SII_PDI_ACCESS - wire::SII_CONFIG) as usize;
const CONTROL: usize = (wire::SII_CONTROL - wire::SII_CONFIG) as usize;
const ADDRESS: usize = (wire::SII_ADDRESS - wire::SII_CONFIG) as usize;
const DATA: usize = (wire::SII_DATA - wire::SII_CONFIG) as usize;

const OFFERED: u8 = 0x01;
const FORCED: u8 = wire::SII_FORCE;
const WRITE_ENABLE: u16 = 0x0001;
const READS_EIGHT_BYTES: u16 = wire::SII_READS_8_BYTES;
const EMULATED: u16 = 0x0020;
const COMMAND_MASK: u16 = 0x0700;
const COMMAND_READ: u16 = wire::SII_READ;
const COMMAND_WRITE: u16 = wire::SII_WRITE;
const COMMAND_RELOAD: u16 = 0x0400;
/// Bits that show a load of the configuration area that failed.
const NOT_LOADED: u16 = wire::SII_CHECKSUM_ERROR | wire::SII_LOADING;
const ERROR_COMMAND: u16 = wire::SII_ACKNOWLEDGE_ERROR;
const ERROR_WRITE_ENABLE: u16 = wire::SII_WRITE_ERROR;
const BUSY: u16 = wire::SII_BUSY;

/// Fault of an information memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SiiFault {
    /// A command never ends.
    Busy,
    /// Every command ends with the acknowledge error.
    Acknowledge,
    /// Every byte is 0xFF.
    Blank,
    /// Every eighth byte has a flipped bit.
    Damaged,
    /// The slave's processor owns the memory until the master takes it by force.
    Owned,
    /// No fault.
    Whole,
}

/// Content and command state of the memory.
#[derive(Clone, Debug)]
pub(crate) struct Eeprom {
    image: Vec<u8>,
    pending: u16,
    begun_ns: u64,
    due_ns: u64,
    /// Time that a read takes.
    busy_ns: u64,
    /// Until when the memory stores the last word.
    stores_until_ns: u64,
    write_enabled: bool,
    fault: SiiFault,
    /// Idle state of the control register.
    flags: u16,
    /// Whether the slave's processor has the memory.
    held: bool,
    /// Whether the checksum of the configuration area was correct when the controller loaded it last.
    is_loaded: bool,
}

impl Eeprom {
    /// A memory whose reads take this long, other commands a part of it; `flags` are the idle state of the control register.
    pub(crate) fn new(image: Vec<u8>, busy_ns: u64, flags: u16) -> Self {
        let mut eeprom = Self {
            image,
            pending: 0,
            begun_ns: 0,
            due_ns: 0,
            busy_ns,
            stores_until_ns: 0,
            write_enabled: false,
            fault: SiiFault::Whole,
            flags,
            held: false,
            is_loaded: false,
        };
        eeprom.is_loaded = eeprom.is_valid();
        eeprom
    }

    /// Register content after power-up.
    pub(crate) fn reset(&mut self, registers: &mut [u8]) {
        self.pending = 0;
        self.write_enabled = false;
        self.held = false;
        self.is_loaded = self.is_valid();
        self.set_status(registers, 0);
        self.own(registers);
    }

    /// Whether the controller could load the configuration area, at power-up or by a later command.
    pub(crate) fn is_loaded(&self) -> bool {
        self.is_loaded
    }

    /// The slave's processor takes the memory, or gives it back.
    pub(crate) fn hold(&mut self, held: bool, registers: &mut [u8]) {
        self.held = held;
        self.own(registers);
    }

    /// Whether the slave's processor has the memory.
    pub(crate) fn is_held(&self) -> bool {
        self.held
    }

    /// Sets or clears a fault.
    pub(crate) fn set_fault(&mut self, fault: SiiFault, registers: &mut [u8]) {
        self.fault = fault;
        self.own(registers);
    }

    /// Whether the checksum of the configuration area is correct.
    fn is_valid(&self) -> bool {
        self.byte(2 * usize::from(WORD_CHECKSUM)) == {
            let area: Vec<u8> = (0..2 * usize::from(WORD_CHECKSUM)).map(|at| self.byte(at)).collect();
            checksum(&area)
        }
    }

    /// One word of the memory.
    pub(crate) fn word(&self, at: usize) -> u16 {
        u16::from_le_bytes([self.byte(2 * at), self.byte(2 * at + 1)])
    }

    /// Handles a write to the access registers.
    pub(crate) fn configure(&mut self, registers: &mut [u8]) {
        let config = byte(registers, CONFIG);
        if config & FORCED != 0 {
            self.held = false;
            if self.fault == SiiFault::Owned {
                self.fault = SiiFault::Whole;
            }
        }
        self.own(registers);
    }

    /// Handles a write to the control register.
    pub(crate) fn command(&mut self, registers: &mut [u8], now_ns: u64) {
        let control = word(registers, CONTROL);
        self.write_enabled = control & WRITE_ENABLE != 0;
        let owned = byte(registers, CONFIG) & OFFERED != 0 || byte(registers, PDI_ACCESS) & 1 != 0;
        let status = match control & COMMAND_MASK {
            0 => 0,
            _ if owned => ERROR_COMMAND,
            command @ (COMMAND_READ | COMMAND_WRITE | COMMAND_RELOAD) => {
                self.pending = command;
                self.begun_ns = now_ns;
                // Twelve bytes pass the wire for a read, four for a write, one if the memory does not answer.
                let bytes = match command {
                    _ if now_ns < self.stores_until_ns => 1,
                    COMMAND_WRITE => 4,
                    _ => READ_BYTES,
                };
                self.due_ns = now_ns.saturating_add(self.busy_ns * bytes / READ_BYTES);
                BUSY | command
            }
            _ => ERROR_COMMAND,
        };
        self.set_status(registers, status);
    }

    /// Finishes a command whose time is over, unless the slave's processor has to; returns true after a reload.
    pub(crate) fn advance(&mut self, registers: &mut [u8], now_ns: u64) -> bool {
        self.flags & EMULATED == 0 && self.finish(registers, now_ns)
    }

    /// The slave's processor finishes a command of the memory that it emulates; returns true after a reload.
    pub(crate) fn serve(&mut self, registers: &mut [u8], now_ns: u64) -> bool {
        self.flags & EMULATED != 0 && self.finish(registers, now_ns)
    }

    fn finish(&mut self, registers: &mut [u8], now_ns: u64) -> bool {
        if self.pending == 0 || now_ns < self.due_ns || self.fault == SiiFault::Busy {
            return false;
        }
        let command = std::mem::take(&mut self.pending);
        let start = (u64::from(word(registers, ADDRESS)) | u64::from(word(registers, ADDRESS + 2)) << 16) * 2;
        let start = usize::try_from(start).unwrap_or(usize::MAX);
        let bytes = if self.flags & READS_EIGHT_BYTES != 0 { 8 } else { 4 };
        let mut status = 0;
        match command {
            _ if self.fault == SiiFault::Acknowledge || self.begun_ns < self.stores_until_ns => status = ERROR_COMMAND,
            COMMAND_READ if start < self.image.len() => {
                for (index, target) in registers.iter_mut().skip(DATA).take(bytes).enumerate() {
                    *target = self.byte(start + index);
                }
            }
            COMMAND_WRITE if !self.write_enabled => status = ERROR_WRITE_ENABLE | ERROR_COMMAND,
            COMMAND_WRITE if start + 2 <= self.image.len() => {
                let data = registers.iter().skip(DATA);
                let place = self.image.iter_mut().skip(start).take(2);
                place.zip(data).for_each(|(target, source)| *target = *source);
                if self.flags & EMULATED == 0 {
                    self.stores_until_ns = self.due_ns.saturating_add(STORE_NS);
                }
            }
            COMMAND_RELOAD => self.is_loaded = self.is_valid(),
            _ => status = ERROR_COMMAND,
        }
        self.write_enabled = false;
        self.set_status(registers, status);
        command == COMMAND_RELOAD
    }

    fn own(&self, registers: &mut [u8]) {
        let owned = self.held || self.fault == SiiFault::Owned;
        set_byte(registers, PDI_ACCESS, u8::from(owned));
    }

    fn byte(&self, at: usize) -> u8 {
        let stored = self.image.get(at).copied().unwrap_or(0xFF);
        match self.fault {
            SiiFault::Blank => 0xFF,
            SiiFault::Damaged if at % 8 == 2 => stored ^ 0x10,
            _ => stored,
        }
    }

    fn set_status(&self, registers: &mut [u8], status: u16) {
        let loaded = if self.is_loaded { 0 } else { NOT_LOADED };
        set_word(registers, CONTROL, self.flags | loaded | status);
    }
}

fn byte(registers: &[u8], at: usize) -> u8 {
    registers.get(at).copied().unwrap_or(0)
}

fn set_byte(registers: &mut [u8], at: usize, value: u8) {
    registers.iter_mut().skip(at).take(1).for_each(|byte| *byte = value);
}

fn word(registers: &[u8], at: usize) -> u16 {
    match registers.get(at..at + 2) {
        Some(&[low, high]) => u16::from_le_bytes([low, high]),
        _ => 0,
    }
}

fn set_word(registers: &mut [u8], at: usize, value: u16) {
    if let Some(target) = registers.get_mut(at..at + 2) {
        target.copy_from_slice(&value.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image() -> Vec<u8> {
        let mut image: Vec<u8> = (0..64).collect();
        image[14] = checksum(&image);
        image
    }

    fn registers(command: u16, address: u32) -> [u8; LENGTH] {
        let mut registers = [0; LENGTH];
        set_word(&mut registers, CONTROL, command);
        registers[ADDRESS..DATA].copy_from_slice(&address.to_le_bytes());
        registers
    }

    fn run(eeprom: &mut Eeprom, registers: &mut [u8]) -> u16 {
        eeprom.command(registers, 0);
        eeprom.advance(registers, BUSY_NS);
        word(registers, CONTROL)
    }

    #[test]
    fn a_read_is_busy_for_its_time_and_gives_eight_bytes() {
        let mut eeprom = Eeprom::new(image(), BUSY_NS, READS_EIGHT_BYTES);
        let mut registers = registers(COMMAND_READ, 4);
        eeprom.command(&mut registers, 1_000);
        eeprom.advance(&mut registers, BUSY_NS);
        assert_eq!(word(&registers, CONTROL) & BUSY, BUSY);
        eeprom.advance(&mut registers, BUSY_NS + 1_000);
        assert_eq!(word(&registers, CONTROL), READS_EIGHT_BYTES);
        assert_eq!(registers[DATA..], image()[8..16]);
    }

    #[test]
    fn a_read_beyond_the_memory_is_a_command_error() {
        let mut eeprom = Eeprom::new(image(), BUSY_NS, READS_EIGHT_BYTES);
        for address in [32, u32::MAX] {
            let mut registers = registers(COMMAND_READ, address);
            assert_eq!(run(&mut eeprom, &mut registers), READS_EIGHT_BYTES | ERROR_COMMAND);
        }
    }

    #[test]
    fn a_write_needs_its_enable_bit() {
        let mut eeprom = Eeprom::new(image(), BUSY_NS, READS_EIGHT_BYTES);
        for (command, stored) in [(COMMAND_WRITE, 40), (COMMAND_WRITE | WRITE_ENABLE, 0x55)] {
            let mut registers = registers(command, 20);
            registers[DATA] = 0x55;
            run(&mut eeprom, &mut registers);
            assert_eq!(eeprom.image[40], stored);
        }
    }

    #[test]
    fn a_memory_that_stores_a_word_acknowledges_nothing_and_one_that_is_emulated_does() {
        for (flags, refuses) in [(READS_EIGHT_BYTES, true), (EMULATED, false)] {
            let mut eeprom = Eeprom::new(image(), BUSY_NS, flags);
            let mut at = |command: u16, now_ns: u64| {
                let mut registers = registers(command, 20);
                eeprom.command(&mut registers, now_ns);
                eeprom.advance(&mut registers, now_ns + BUSY_NS);
                eeprom.serve(&mut registers, now_ns + BUSY_NS);
                word(&registers, CONTROL) & ERROR_COMMAND != 0
            };
            assert!(!at(COMMAND_WRITE | WRITE_ENABLE, 1_000_000));
            assert_eq!(at(COMMAND_READ, 2_000_000), refuses);
            assert_eq!(at(COMMAND_WRITE | WRITE_ENABLE, 3_000_000), refuses);
            assert!(!at(COMMAND_READ, 1_000_000 + BUSY_NS + STORE_NS));
        }
    }

    #[test]
    fn each_fault_shows_and_goes() {
        let mut eeprom = Eeprom::new(image(), BUSY_NS, READS_EIGHT_BYTES);
        for (fault, status, first) in [
            (SiiFault::Busy, READS_EIGHT_BYTES | BUSY | COMMAND_READ, 0),
            (SiiFault::Acknowledge, READS_EIGHT_BYTES | ERROR_COMMAND, 0),
            (SiiFault::Blank, READS_EIGHT_BYTES, 0xFF),
            (SiiFault::Owned, READS_EIGHT_BYTES | ERROR_COMMAND, 0),
            (SiiFault::Damaged, READS_EIGHT_BYTES, 8),
            (SiiFault::Whole, READS_EIGHT_BYTES, 8),
        ] {
            let mut registers = registers(COMMAND_READ, 4);
            eeprom.set_fault(SiiFault::Whole, &mut registers);
            eeprom.reset(&mut registers);
            eeprom.set_fault(fault, &mut registers);
            set_word(&mut registers, CONTROL, COMMAND_READ);
            assert_eq!(run(&mut eeprom, &mut registers), status, "{fault:?}");
            assert_eq!(registers[DATA], first, "{fault:?}");
        }
    }

    #[test]
    fn a_failed_load_shows_until_the_next_one_with_a_whole_memory() {
        let mut eeprom = Eeprom::new(image(), BUSY_NS, READS_EIGHT_BYTES);
        let mut registers = registers(COMMAND_READ, 4);
        eeprom.set_fault(SiiFault::Damaged, &mut registers);
        eeprom.reset(&mut registers);
        assert_eq!(word(&registers, CONTROL), READS_EIGHT_BYTES | NOT_LOADED);
        eeprom.set_fault(SiiFault::Whole, &mut registers);
        for (command, loaded) in [(COMMAND_READ, NOT_LOADED), (COMMAND_RELOAD, 0)] {
            set_word(&mut registers, CONTROL, command);
            assert_eq!(run(&mut eeprom, &mut registers), READS_EIGHT_BYTES | loaded);
        }
    }

    #[test]
    fn a_small_controller_reads_four_bytes() {
        let mut eeprom = Eeprom::new(image(), BUSY_NS, 0x0080);
        let mut registers = registers(COMMAND_READ, 4);
        assert_eq!(run(&mut eeprom, &mut registers), 0x0080);
        assert_eq!(registers[DATA..DATA + 4], image()[8..12]);
        assert_eq!(registers[DATA + 4..], [0; 4]);
    }

    #[test]
    fn an_emulated_memory_waits_for_the_processor() {
        let mut eeprom = Eeprom::new(image(), BUSY_NS, EMULATED);
        let mut registers = registers(COMMAND_READ, 4);
        assert_eq!(run(&mut eeprom, &mut registers), EMULATED | BUSY | COMMAND_READ);
        assert!(!eeprom.serve(&mut registers, BUSY_NS));
        assert_eq!(word(&registers, CONTROL), EMULATED);
        assert_eq!(registers[DATA..DATA + 4], image()[8..12]);
    }

    #[test]
    fn a_memory_that_the_processor_has_is_refused_until_it_is_given_back() {
        let mut eeprom = Eeprom::new(image(), BUSY_NS, READS_EIGHT_BYTES);
        for (held, status) in [(true, READS_EIGHT_BYTES | ERROR_COMMAND), (false, READS_EIGHT_BYTES)] {
            let mut registers = registers(COMMAND_READ, 4);
            eeprom.hold(held, &mut registers);
            assert_eq!(registers[PDI_ACCESS], u8::from(held));
            assert_eq!(run(&mut eeprom, &mut registers), status);
        }
    }

    #[test]
    fn an_owned_memory_is_taken_by_force() {
        let mut eeprom = Eeprom::new(image(), BUSY_NS, READS_EIGHT_BYTES);
        let mut registers = registers(COMMAND_READ, 4);
        eeprom.set_fault(SiiFault::Owned, &mut registers);
        registers[CONFIG] = FORCED;
        eeprom.configure(&mut registers);
        registers[CONFIG] = 0;
        eeprom.configure(&mut registers);
        set_word(&mut registers, CONTROL, COMMAND_READ);
        assert_eq!(run(&mut eeprom, &mut registers), READS_EIGHT_BYTES);
    }
}
