//! Four drives that are as little as a master accepts: registers, an SII, states that follow at once.
//!
//! They exist so that a master can be brought to OP without a recording; a mailbox and process data they have not.
//! [`answer`] is the segment once all are in OP: it only puts right working counters into a cyclic frame.

use crate::{Case, DRIVES, ProcessData};

/// Where the datagrams of a frame begin.
const FIRST_DATAGRAM: usize = 16;
const HEADER: usize = 10;
/// Registers of one drive, bytes.
const MEMORY: usize = 0x1000;
const SII_BYTES: usize = 256;

/// AL status of a drive in OP.
const OPERATIONAL: u8 = 8;

mod register {
    pub(super) const SUPPORT: usize = 0x0008;
    pub(super) const STATION: usize = 0x0010;
    pub(super) const PORTS: usize = 0x0110;
    pub(super) const AL_CONTROL: usize = 0x0120;
    pub(super) const AL_STATUS: usize = 0x0130;
    pub(super) const SII_CONTROL: usize = 0x0502;
    pub(super) const SII_DATA: usize = 0x0508;
}

/// Numbers of the commands (ETG.1000.4).
mod command {
    pub(super) const APRD: u8 = 1;
    pub(super) const APWR: u8 = 2;
    pub(super) const FPRD: u8 = 4;
    pub(super) const FPWR: u8 = 5;
    pub(super) const BRD: u8 = 7;
    pub(super) const BWR: u8 = 8;
    pub(super) const LRD: u8 = 10;
    pub(super) const LWR: u8 = 11;
    pub(super) const LRW: u8 = 12;
    pub(super) const FRMW: u8 = 14;
}

/// Puts the working counters of a case's drives in OP into a frame, and the AL status where it is asked for.
///
/// # Panics
/// The frame is no chain of datagrams.
pub fn answer(frame: &mut [u8], case: Case) {
    let (drives, data) = (case.drives as u16, case.data);
    frame[6] |= 2;
    let mut at = FIRST_DATAGRAM;
    loop {
        let flags = u16::from_le_bytes([frame[at + 6], frame[at + 7]]);
        let length = flags & 0x07FF;
        // A logical datagram holds one drive's data or the data of all.
        let covered = |one: u16| if length > one { drives } else { 1 };
        let counter = match frame[at] {
            command::LRD => covered(data.inputs),
            command::LWR => covered(data.outputs),
            command::LRW => 3 * covered(data.inputs + data.outputs),
            command::BRD | command::FRMW => drives,
            _ => 1,
        };
        let register = u16::from_le_bytes([frame[at + 4], frame[at + 5]]);
        if matches!(frame[at], command::BRD | command::FPRD) && usize::from(register) == register::AL_STATUS {
            frame[at + HEADER] = OPERATIONAL;
        }
        at += HEADER + usize::from(length);
        frame[at..at + 2].copy_from_slice(&counter.to_le_bytes());
        at += 2;
        if flags & 0x8000 == 0 {
            return;
        }
    }
}

/// The drives while they are brought up.
pub struct Segment {
    drives: [Drive; DRIVES],
    data: ProcessData,
}

impl Segment {
    /// Drives in INIT.
    pub fn new(data: ProcessData) -> Self {
        let mut drives = [const { Drive::new() }; DRIVES];
        for (number, drive) in drives.iter_mut().enumerate() {
            drive.power_up(data, number + 1 < DRIVES);
        }
        Self { drives, data }
    }

    /// Sends a frame through the drives, in place.
    ///
    /// # Panics
    /// The frame is no chain of datagrams.
    pub fn frame(&mut self, frame: &mut [u8]) {
        frame[6] |= 2;
        let mut at = FIRST_DATAGRAM;
        loop {
            let flags = u16::from_le_bytes([frame[at + 6], frame[at + 7]]);
            let end = at + HEADER + usize::from(flags & 0x07FF) + 2;
            self.datagram(&mut frame[at..end]);
            at = end;
            if flags & 0x8000 == 0 {
                return;
            }
        }
    }

    fn datagram(&mut self, datagram: &mut [u8]) {
        let (header, rest) = datagram.split_at_mut(HEADER);
        let (data, counter) = rest.split_at_mut(rest.len() - 2);
        let code = header[0];
        if matches!(code, command::LRD | command::LWR | command::LRW) {
            let each = if code == command::LRW { 3 } else { 1 };
            let all = usize::from(self.data.inputs.max(self.data.outputs)) < data.len();
            counter[0] = each * if all { DRIVES as u8 } else { 1 };
            return;
        }
        let device = u16::from_le_bytes([header[2], header[3]]);
        let register = usize::from(u16::from_le_bytes([header[4], header[5]]));
        for (position, drive) in (0_u16..).zip(&mut self.drives) {
            let addressed = match code {
                command::APRD | command::APWR => device.wrapping_add(position) == 0,
                command::BRD | command::BWR => true,
                _ => device == drive.u16_at(register::STATION),
            };
            match code {
                command::APRD | command::FPRD | command::BRD if addressed => drive.read(register, data),
                command::APWR | command::FPWR | command::BWR if addressed => drive.write(register, data),
                command::FRMW => {}
                _ => continue,
            }
            counter[0] += 1;
        }
    }
}

struct Drive {
    memory: [u8; MEMORY],
    sii: [u8; SII_BYTES],
}

impl Drive {
    const fn new() -> Self {
        Self {
            memory: [0; MEMORY],
            sii: [0xFF; SII_BYTES],
        }
    }

    fn power_up(&mut self, data: ProcessData, has_next: bool) {
        // Clocks of 64 bits with all that belongs to them.
        self.memory[register::SUPPORT..][..2].copy_from_slice(&0x010C_u16.to_le_bytes());
        self.memory[register::PORTS] = if has_next { 0x30 } else { 0x10 };
        self.memory[register::AL_STATUS] = 1;
        self.sii[..0x80].fill(0);
        let (inputs, outputs) = (data.inputs as u8, data.outputs as u8);
        let categories: [&[u8]; 4] = [
            // FMMUs: outputs, inputs.
            &[40, 0, 1, 0, 1, 2],
            // Sync managers: start, length, control, status, enable, kind.
            &[
                41, 0, 8, 0, 0, 0x11, outputs, 0, 0x64, 0, 1, 3, 0x40, 0x11, inputs, 0, 0x20, 0, 1, 4,
            ],
            // One object of all inputs in sync manager 1, one of all outputs in sync manager 0.
            &[
                50,
                0,
                8,
                0,
                0,
                0x1A,
                1,
                1,
                0,
                0,
                0,
                0,
                0,
                0x60,
                0,
                0,
                0,
                8 * inputs,
                0,
                0,
            ],
            &[
                51,
                0,
                8,
                0,
                0,
                0x16,
                1,
                0,
                0,
                0,
                0,
                0,
                0,
                0x70,
                0,
                0,
                0,
                8 * outputs,
                0,
                0,
            ],
        ];
        let mut at = 0x80;
        for category in categories {
            self.sii[at..at + category.len()].copy_from_slice(category);
            at += category.len();
        }
    }

    fn u16_at(&self, register: usize) -> u16 {
        u16::from_le_bytes([self.memory[register], self.memory[register + 1]])
    }

    fn read(&self, register: usize, data: &mut [u8]) {
        for (byte, value) in data.iter_mut().zip(&self.memory[register..]) {
            *byte |= value;
        }
    }

    fn write(&mut self, register: usize, data: &[u8]) {
        self.memory[register..][..data.len()].copy_from_slice(data);
        match register {
            register::AL_CONTROL => self.memory[register::AL_STATUS] = data[0] & 0x0F,
            register::SII_CONTROL => {
                let word = usize::from(self.u16_at(register::SII_CONTROL + 2));
                // Not busy, eight bytes at a time.
                self.memory[register::SII_CONTROL..][..2].copy_from_slice(&[0x40, 0]);
                for (number, byte) in self.memory[register::SII_DATA..][..8].iter_mut().enumerate() {
                    *byte = self.sii.get(2 * word + number).copied().unwrap_or(0xFF);
                }
            }
            _ => {}
        }
    }
}
