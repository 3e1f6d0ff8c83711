//! The slave information memory behind registers 0x0500 to 0x050F.
//!
//! A command takes until the next millisecond of the cell, during which the busy bit is set; the word address counts
//! 16-bit words; reads give eight bytes. Register layout: EEPROM interface of the slave controller's register
//! description.

use super::registers;
use etherpen::ethercat::wire::register as wire;

/// First register of the interface.
pub(super) const BASE: usize = registers::SII_CONFIG;
/// Bytes of the interface.
pub(super) const LENGTH: usize = 16;

const CONTROL: usize = (wire::SII_CONTROL - wire::SII_CONFIG) as usize;
const ADDRESS: usize = (wire::SII_ADDRESS - wire::SII_CONFIG) as usize;
const DATA: usize = (wire::SII_DATA - wire::SII_CONFIG) as usize;

const WRITE_ENABLE: u16 = 0x0001;
const READS_EIGHT_BYTES: u16 = wire::SII_READS_8_BYTES;
const COMMAND_MASK: u16 = 0x0700;
const COMMAND_READ: u16 = wire::SII_READ;
const COMMAND_WRITE: u16 = wire::SII_WRITE;
const COMMAND_RELOAD: u16 = 0x0400;
const ERROR_COMMAND: u16 = wire::SII_ACKNOWLEDGE_ERROR;
const ERROR_WRITE_ENABLE: u16 = wire::SII_WRITE_ERROR;
const BUSY: u16 = wire::SII_BUSY;

/// Content and command state of the memory.
#[derive(Clone, Debug)]
pub(super) struct Eeprom {
    image: Vec<u8>,
    pending: u16,
    write_enabled: bool,
}

impl Eeprom {
    pub(super) fn new(image: Vec<u8>) -> Self {
        Self {
            image,
            pending: 0,
            write_enabled: false,
        }
    }

    /// Register content after power-up.
    pub(super) fn reset(&mut self, registers: &mut [u8]) {
        self.pending = 0;
        self.write_enabled = false;
        set_word(registers, CONTROL, READS_EIGHT_BYTES);
    }

    /// The bus has written the control register.
    pub(super) fn command(&mut self, registers: &mut [u8]) {
        let control = word(registers, CONTROL);
        self.write_enabled = control & WRITE_ENABLE != 0;
        let status = match control & COMMAND_MASK {
            0 => READS_EIGHT_BYTES,
            command @ (COMMAND_READ | COMMAND_WRITE | COMMAND_RELOAD) => {
                self.pending = command;
                READS_EIGHT_BYTES | BUSY | command
            }
            _ => READS_EIGHT_BYTES | ERROR_COMMAND,
        };
        set_word(registers, CONTROL, status);
    }

    /// One millisecond: finishes a command.
    pub(super) fn step(&mut self, registers: &mut [u8]) {
        let command = std::mem::take(&mut self.pending);
        if command == 0 {
            return;
        }
        let start = (u64::from(word(registers, ADDRESS)) | u64::from(word(registers, ADDRESS + 2)) << 16) * 2;
        let start = usize::try_from(start).unwrap_or(usize::MAX);
        let mut status = READS_EIGHT_BYTES;
        match command {
            COMMAND_READ if start < self.image.len() => {
                for (index, target) in registers.iter_mut().skip(DATA).take(8).enumerate() {
                    *target = self.image.get(start + index).copied().unwrap_or(0xFF);
                }
            }
            COMMAND_WRITE if !self.write_enabled => status |= ERROR_WRITE_ENABLE | ERROR_COMMAND,
            COMMAND_WRITE if start + 2 <= self.image.len() => {
                for (target, source) in self
                    .image
                    .iter_mut()
                    .skip(start)
                    .take(2)
                    .zip(registers.iter().skip(DATA))
                {
                    *target = *source;
                }
            }
            COMMAND_RELOAD => {}
            _ => status |= ERROR_COMMAND,
        }
        self.write_enabled = false;
        set_word(registers, CONTROL, status);
    }
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

    fn registers(command: u16, address: u32) -> [u8; LENGTH] {
        let mut registers = [0; LENGTH];
        set_word(&mut registers, CONTROL, command);
        registers[ADDRESS..DATA].copy_from_slice(&address.to_le_bytes());
        registers
    }

    #[test]
    fn a_read_is_busy_for_a_millisecond_and_gives_eight_bytes() {
        let mut eeprom = Eeprom::new((0..64).collect());
        let mut registers = registers(COMMAND_READ, 4);
        eeprom.command(&mut registers);
        assert_eq!(word(&registers, CONTROL) & BUSY, BUSY);
        eeprom.step(&mut registers);
        assert_eq!(word(&registers, CONTROL), READS_EIGHT_BYTES);
        assert_eq!(registers[DATA..], [8, 9, 10, 11, 12, 13, 14, 15]);
    }

    #[test]
    fn a_read_beyond_the_memory_is_a_command_error() {
        let mut eeprom = Eeprom::new(vec![0; 64]);
        for address in [32, u32::MAX] {
            let mut registers = registers(COMMAND_READ, address);
            eeprom.command(&mut registers);
            eeprom.step(&mut registers);
            assert_eq!(word(&registers, CONTROL) & ERROR_COMMAND, ERROR_COMMAND);
        }
    }

    #[test]
    fn a_write_needs_its_enable_bit() {
        let mut eeprom = Eeprom::new(vec![0; 64]);
        for (command, stored) in [(COMMAND_WRITE, 0), (COMMAND_WRITE | WRITE_ENABLE, 0x55)] {
            let mut registers = registers(command, 2);
            registers[DATA] = 0x55;
            eeprom.command(&mut registers);
            eeprom.step(&mut registers);
            assert_eq!(eeprom.image[4], stored);
        }
    }
}
