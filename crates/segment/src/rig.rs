//! A rig for tests of slaves: hand-made frames, one a millisecond, without a master.
//!
//! [`frame_of`] and [`content`] make and read frames. A [`Rig`] sends them and performs the steps of a bring-up; the
//! steps that configure slaves expect four AX2000 in a row. An unexpected answer causes a panic.

use crate::capture::{Capture, Direction};
use crate::random::Random;

/// Something that answers EtherCAT frames.
pub trait Bus {
    /// Passes an Ethernet frame at this time; returns the replies.
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>>;
}

/// Reads by position.
pub const APRD: u8 = 1;
/// Writes by position.
pub const APWR: u8 = 2;
/// Reads and writes by position.
pub const APRW: u8 = 3;
/// Reads by station address.
pub const FPRD: u8 = 4;
/// Writes by station address.
pub const FPWR: u8 = 5;
/// Reads from all, combined by OR.
pub const BRD: u8 = 7;
/// Writes to all.
pub const BWR: u8 = 8;
/// Reads from all and writes to all.
pub const BRW: u8 = 9;
/// Reads logical memory.
pub const LRD: u8 = 10;
/// Writes logical memory.
pub const LWR: u8 = 11;
/// Reads and writes logical memory.
pub const LRW: u8 = 12;
/// Reads by position, writes at all others.
pub const ARMW: u8 = 13;
/// Reads by station address, writes at all others.
pub const FRMW: u8 = 14;

/// Ethernet and EtherCAT headers, then the first datagram.
pub const DATA: usize = 14 + 2 + 10;

/// A datagram to be sent: command, device address, register or high half, data.
pub type Ask<'a> = (u8, u16, u16, &'a [u8]);

/// An Ethernet frame with these datagrams; each datagram's index is its position.
#[must_use]
pub fn frame_of(asks: &[Ask]) -> Vec<u8> {
    let mut chain = Vec::new();
    for (at, (command, device, register, data)) in asks.iter().enumerate() {
        let more = if at + 1 < asks.len() { 0x8000 } else { 0 };
        chain.extend_from_slice(&[*command, at as u8]);
        chain.extend_from_slice(&device.to_le_bytes());
        chain.extend_from_slice(&register.to_le_bytes());
        chain.extend_from_slice(&(data.len() as u16 | more).to_le_bytes());
        chain.extend_from_slice(&[0, 0]);
        chain.extend_from_slice(data);
        chain.extend_from_slice(&[0, 0]);
    }
    let mut frame = vec![0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0x10, 0x10, 0x10, 0x10, 0x10];
    frame.extend_from_slice(&[0x88, 0xA4]);
    frame.extend_from_slice(&(chain.len() as u16 | 0x1000).to_le_bytes());
    frame.extend_from_slice(&chain);
    frame.resize(frame.len().max(60), 0);
    frame
}

/// Data and working counter of the only datagram of a reply.
///
/// # Panics
/// If the reply is shorter than its data.
#[must_use]
pub fn content(reply: &[u8], length: usize) -> (Vec<u8>, u16) {
    let end = DATA + length;
    (
        reply[DATA..end].to_vec(),
        u16::from_le_bytes([reply[end], reply[end + 1]]),
    )
}

/// A bus that gets one hand-made frame a millisecond.
#[derive(Debug)]
pub struct Rig<B> {
    /// The bus.
    pub bus: B,
    /// Time of the next frame, microseconds.
    pub time_us: u64,
    mailbox_counter: u8,
    /// Length of the mailboxes in both directions, bytes: 512 (AX2000) or 256 (generic drive).
    pub mail_bytes: usize,
    /// Delays each frame by less than 0.45 ms.
    pub jitter: Option<Random>,
    /// Records the frames.
    pub capture: Option<Capture<Vec<u8>>>,
}

impl<B: Bus> Rig<B> {
    /// A rig whose first frame comes at 5 ms.
    pub fn new(bus: B) -> Self {
        Self {
            bus,
            time_us: 5_000,
            mailbox_counter: 0,
            mail_bytes: 512,
            jitter: None,
            capture: None,
        }
    }

    /// Sends a frame and waits for the next millisecond; returns the replies.
    pub fn send(&mut self, frame: &[u8]) -> Vec<Vec<u8>> {
        let jitter_us = self.jitter.as_mut().map_or(0, |random| random.bits() % 450);
        let at_us = self.time_us + jitter_us;
        let replies = self.bus.frame(at_us, frame);
        if let Some(capture) = &mut self.capture {
            capture.record(at_us, Direction::Sent, frame).expect("memory");
            for reply in &replies {
                capture.record(at_us, Direction::Received, reply).expect("memory");
            }
        }
        self.time_us += 1000;
        replies
    }

    /// Sends one datagram; returns data and working counter.
    pub fn ask(&mut self, command: u8, device: u16, register: u16, data: &[u8]) -> (Vec<u8>, u16) {
        let replies = self.send(&frame_of(&[(command, device, register, data)]));
        assert_eq!(replies.len(), 1);
        content(&replies[0], data.len())
    }

    /// Writes a register of one slave.
    pub fn write(&mut self, station: u16, register: u16, data: &[u8]) {
        assert_eq!(self.ask(FPWR, station, register, data).1, 1, "write to {register:#x}");
    }

    /// Reads a register of one slave.
    pub fn read(&mut self, station: u16, register: u16, length: usize) -> Vec<u8> {
        let (data, count) = self.ask(FPRD, station, register, &vec![0; length]);
        assert_eq!(count, 1, "read of {register:#x}");
        data
    }

    /// AL status and AL status code of a slave.
    pub fn al_status(&mut self, station: u16) -> (u16, u16) {
        let data = self.read(station, 0x0130, 6);
        (
            u16::from_le_bytes([data[0], data[1]]),
            u16::from_le_bytes([data[4], data[5]]),
        )
    }

    /// Requests a state from all slaves.
    pub fn request(&mut self, state: u16) {
        self.ask(BWR, 0, 0x0120, &state.to_le_bytes());
    }

    /// Gives four slaves the station addresses 0x1001 to 0x1004.
    pub fn addresses(&mut self) {
        for position in 0..4u16 {
            let station = 0x1001 + position;
            let (_, count) = self.ask(APWR, 0u16.wrapping_sub(position), 0x0010, &station.to_le_bytes());
            assert_eq!(count, 1);
        }
    }

    /// Configures the mailboxes of four AX2000.
    pub fn mailboxes(&mut self) {
        for station in 0x1001..=0x1004 {
            self.write(station, 0x0800, &[0x00, 0x18, 0x00, 0x02, 0x26, 0, 1, 0]);
            self.write(station, 0x0808, &[0x00, 0x1C, 0x00, 0x02, 0x22, 0, 1, 0]);
        }
    }

    /// Configures process data, mapping and watchdog of four AX2000.
    pub fn process_data(&mut self) {
        for station in 0x1001..=0x1004u16 {
            let logical = (station - 0x1001) as u8 * 6;
            self.write(station, 0x0810, &[0x00, 0x11, 6, 0, 0x64, 0, 1, 0]);
            self.write(station, 0x0818, &[0x40, 0x11, 6, 0, 0x20, 0, 1, 0]);
            let fmmu =
                |start: u8, physical: u8, kind: u8| [start, 0, 1, 0, 6, 0, 0, 7, physical, 0x11, 0, kind, 1, 0, 0, 0];
            self.write(station, 0x0600, &fmmu(logical, 0x00, 2));
            self.write(station, 0x0610, &fmmu(0x40 + logical, 0x40, 1));
            self.write(station, 0x0400, &2498u16.to_le_bytes());
            self.write(station, 0x0420, &100u16.to_le_bytes());
        }
    }

    /// Writes a CoE message into the mailbox.
    pub fn post(&mut self, station: u16, coe: &[u8]) {
        self.mailbox_counter = self.mailbox_counter % 7 + 1;
        let mut message = vec![coe.len() as u8, (coe.len() >> 8) as u8, 0, 0, 0];
        message.push(3 | self.mailbox_counter << 4);
        message.extend_from_slice(coe);
        message.resize(self.mail_bytes, 0);
        let register = if self.mail_bytes == 512 { 0x1800 } else { 0x1000 };
        self.write(station, register, &message);
    }

    /// The next CoE message from the mailbox.
    pub fn fetch(&mut self, station: u16) -> Vec<u8> {
        for _ in 0..10 {
            if self.read(station, 0x080D, 1)[0] & 0x08 != 0 {
                let register = if self.mail_bytes == 512 { 0x1C00 } else { 0x1200 };
                let mail = self.read(station, register, self.mail_bytes);
                let length = usize::from(u16::from_le_bytes([mail[0], mail[1]]));
                assert_eq!(mail[5] & 0x0F, 3, "CoE");
                return mail[6..6 + length].to_vec();
            }
        }
        panic!("no mail from {station:#x}");
    }

    /// The answer to an SDO request.
    pub fn sdo(&mut self, station: u16, sdo: &[u8]) -> Vec<u8> {
        let mut coe = vec![0, 0x20];
        coe.extend_from_slice(sdo);
        self.post(station, &coe);
        self.fetch(station)[2..].to_vec()
    }

    /// Writes an object of up to four bytes; returns the abort code, 0 for success.
    pub fn download(&mut self, station: u16, index: u16, sub: u8, value: &[u8]) -> u32 {
        let [low, high] = index.to_le_bytes();
        let mut sdo = vec![0x23 | (4 - value.len() as u8) << 2, low, high, sub];
        sdo.extend_from_slice(value);
        sdo.resize(8, 0);
        outcome(&self.sdo(station, &sdo))
    }

    /// The answer to an SDO upload request.
    pub fn upload(&mut self, station: u16, index: u16, sub: u8) -> Vec<u8> {
        let [low, high] = index.to_le_bytes();
        self.sdo(station, &[0x40, low, high, sub, 0, 0, 0, 0])
    }

    /// From power-up to OP with all drives enabled in digital speed mode.
    pub fn bring_up(&mut self) {
        self.addresses();
        self.mailboxes();
        self.request(2);
        for station in 0x1001..=0x1004 {
            assert_eq!(self.al_status(station), (2, 0));
            assert_eq!(self.download(station, 0x6060, 0, &[0xFE]), 0);
        }
        self.process_data();
        self.request(4);
        assert_eq!(self.al_status(0x1004), (4, 0));
        self.cycle([0; 4], 0);
        self.request(8);
        self.cycle([0; 4], 0);
        assert_eq!(self.al_status(0x1004), (8, 0));
        let mut status = [0; 4];
        for control in [0x06, 0x07, 0x0F] {
            for _ in 0..8 {
                (_, status) = self.cycle([0; 4], control);
            }
        }
        assert!(status.iter().all(|status| status & 0x6F == 0x27), "{status:x?}");
    }

    /// Input and output in one millisecond: commands are computed from this millisecond's positions.
    pub fn control(&mut self, mut law: impl FnMut([i32; 4]) -> [i32; 4]) {
        let replies = self.bus.frame(self.time_us, &frame_of(&[(LRD, 0x0040, 1, &[0; 24])]));
        let (inputs, count) = content(&replies[0], 24);
        assert_eq!(count, 4, "each slave reads once");
        let velocity = law(std::array::from_fn(|slave| {
            i32::from_le_bytes(std::array::from_fn(|byte| inputs[slave * 6 + byte]))
        }));
        let mut outputs = Vec::new();
        for velocity in velocity {
            outputs.extend_from_slice(&velocity.to_le_bytes());
            outputs.extend_from_slice(&0x0Fu16.to_le_bytes());
        }
        let reply = self.bus.frame(self.time_us + 100, &frame_of(&[(LWR, 0, 1, &outputs)]));
        assert_eq!(content(&reply[0], 24).1, 4, "each slave writes once");
        self.time_us += 1000;
    }

    /// One exchange of process data: positions and status words.
    pub fn cycle(&mut self, velocity: [i32; 4], control: u16) -> ([i32; 4], [u16; 4]) {
        let mut outputs = Vec::new();
        for velocity in velocity {
            outputs.extend_from_slice(&velocity.to_le_bytes());
            outputs.extend_from_slice(&control.to_le_bytes());
        }
        let frame = frame_of(&[(LRD, 0x0040, 1, &[0; 24]), (LWR, 0, 1, &outputs)]);
        let replies = self.send(&frame);
        let (inputs, count) = content(&replies[0], 24);
        assert_eq!(count, 4, "each slave reads once");
        let counter = DATA + 24 + 2 + 10 + 24;
        assert_eq!(replies[0][counter..counter + 2], [4, 0], "each slave writes once");
        let of = |slave: usize, at: usize| inputs[slave * 6 + at];
        let position = |n| i32::from_le_bytes([of(n, 0), of(n, 1), of(n, 2), of(n, 3)]);
        let status = |n| u16::from_le_bytes([of(n, 4), of(n, 5)]);
        (std::array::from_fn(position), std::array::from_fn(status))
    }
}

/// Abort code of an SDO answer, 0 for any other.
#[must_use]
pub fn outcome(sdo: &[u8]) -> u32 {
    if sdo[0] == 0x80 {
        u32::from_le_bytes([sdo[4], sdo[5], sdo[6], sdo[7]])
    } else {
        0
    }
}
