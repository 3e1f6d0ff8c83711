//! The SMSC LAN9118 Ethernet controller as an `embassy_net_driver::Driver`.
//!
//! Frames go through two FIFOs of 32-bit words. The logic works on [`Registers`]. Every wait is bounded, no length read
//! from the chip is trusted, and no FIFO is left between two frames: after every call the next word in the receive FIFO
//! is the first of a frame, so one damaged frame does not affect those behind it. A frame that cannot be received or
//! sent is counted, never waited for. No waker is kept: the owner of the interrupt polls.
//!
//! Register addresses and bits: SMSC LAN9118 data sheet, chapter 5 (system control and status registers, MAC control
//! and status registers) and sections 3.12 and 3.13 (transmit and receive data path).

use core::task::Context;
use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState};

/// Longest frame without its check sequence, bytes.
pub const FRAME_BYTES_MAX: usize = 1514;
/// Shortest frame without its check sequence, bytes; shorter ones are padded with zeros.
pub const FRAME_BYTES_MIN: usize = 60;
/// Destination, source and type: the least a received frame must have, bytes.
pub const HEADER_BYTES: usize = 14;
/// Check sequence at a received frame's end, counted in its length and not delivered, bytes.
pub const CHECK_SEQUENCE_BYTES: usize = 4;

/// Bytes of a FIFO word.
pub const WORD_BYTES: usize = 4;
/// A buffer holds whole FIFO words.
const BUFFER_BYTES: usize = 1520;
/// Buffers for each direction, used in turn: a frame stays readable until as many others have passed.
pub const BUFFERS: usize = 8;
/// The two command words ahead of a frame in the transmit FIFO, bytes.
const COMMAND_BYTES: usize = 2 * WORD_BYTES;
/// How often a busy bit is read before the controller counts as dead.
const POLLS_MAX: u32 = 100_000;

/// Valid lengths of a received frame, check sequence included.
const RX_LENGTHS: core::ops::RangeInclusive<usize> =
    HEADER_BYTES + CHECK_SEQUENCE_BYTES..=FRAME_BYTES_MAX + CHECK_SEQUENCE_BYTES;

const _: () = assert!(BUFFER_BYTES.is_multiple_of(WORD_BYTES));
const _: () = assert!(FRAME_BYTES_MAX + CHECK_SEQUENCE_BYTES <= BUFFER_BYTES);
const _: () = assert!(HEADER_BYTES < FRAME_BYTES_MIN && FRAME_BYTES_MIN < FRAME_BYTES_MAX);
const _: () = assert!(BUFFER_BYTES <= TX_LENGTH_MASK as usize);

/// The controller's registers by their byte offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Register {
    /// Next word of the receive data FIFO.
    RxData = 0x00,
    /// Next word of the transmit data FIFO.
    TxData = 0x20,
    /// Takes the next receive status.
    RxStatus = 0x40,
    /// Takes the next transmit status.
    TxStatus = 0x48,
    /// Chip and revision.
    IdRev = 0x50,
    /// Interrupt line: polarity, driver, enable.
    IrqCfg = 0x54,
    /// Pending interrupts; writing ones clears them.
    IntSts = 0x58,
    /// Enabled interrupts.
    IntEn = 0x5c,
    /// Always [`BYTE_TEST`].
    ByteTest = 0x64,
    /// Levels at which the FIFOs interrupt.
    FifoInt = 0x68,
    /// Receive configuration.
    RxCfg = 0x6c,
    /// Transmit configuration.
    TxCfg = 0x70,
    /// Reset and FIFO sizes.
    HwCfg = 0x74,
    /// Fill of the receive FIFOs.
    RxFifoInf = 0x7c,
    /// Fill of the transmit FIFOs.
    TxFifoInf = 0x80,
    /// Free-running counter, 25 MHz.
    FreeRun = 0x9c,
    /// Frames dropped because the controller had no room.
    RxDrop = 0xa0,
    /// Access to a register of the MAC: command.
    MacCsrCmd = 0xa4,
    /// Access to a register of the MAC: data.
    MacCsrData = 0xa8,
}

/// Value of [`Register::ByteTest`].
pub const BYTE_TEST: u32 = 0x8765_4321;
/// Chip number in the upper half of [`Register::IdRev`].
pub const CHIP: u32 = 0x0118;
/// Counts of [`Register::FreeRun`] in a second.
pub const FREE_RUN_HZ: u32 = 25_000_000;

// IRQ_CFG
const IRQ_PUSH_PULL: u32 = 1 << 0;
const IRQ_ACTIVE_HIGH: u32 = 1 << 4;
const IRQ_ENABLE: u32 = 1 << 8;
// INT_STS, INT_EN
const INT_RX_STATUS_LEVEL: u32 = 1 << 3;
const INT_ALL: u32 = 0xffff_ffff;
// FIFO_INT: transmit levels at their largest, receive status level 0 (interrupt at the first status)
const FIFO_INT_FIRST_FRAME: u32 = 0xffff_0000;
// RX_CFG
const RX_DUMP: u32 = 1 << 15;
// TX_CFG
const TX_ON: u32 = 1 << 1;
// HW_CFG
const HW_SOFT_RESET: u32 = 1 << 0;
const HW_TX_FIFO_5_KIB: u32 = 5 << 16;
const HW_MUST_BE_ONE: u32 = 1 << 20;
// Transmit commands A and B
const TX_FIRST_SEGMENT: u32 = 1 << 13;
const TX_LAST_SEGMENT: u32 = 1 << 12;
const TX_LENGTH_MASK: u32 = 0x7ff;
// Receive and transmit status
const STATUS_ERROR: u32 = 1 << 15;
const RX_LENGTH_SHIFT: u32 = 16;
const RX_LENGTH_MASK: u32 = 0x3fff;
// RX_FIFO_INF, TX_FIFO_INF
const FIFO_STATUS_SHIFT: u32 = 16;
const FIFO_STATUS_MASK: u32 = 0xff;
const FIFO_DATA_MASK: u32 = 0xffff;
// MAC_CSR_CMD
const MAC_BUSY: u32 = 1 << 31;
// Registers of the MAC
const MAC_CR: u32 = 1;
const MAC_ADDRH: u32 = 2;
const MAC_ADDRL: u32 = 3;
const MAC_FULL_DUPLEX: u32 = 1 << 20;
const MAC_PROMISCUOUS: u32 = 1 << 18;
const MAC_TX_ENABLE: u32 = 1 << 3;
const MAC_RX_ENABLE: u32 = 1 << 2;

/// Access to the controller's registers.
pub trait Registers {
    /// Reads `register`; some reads take a word from a FIFO.
    fn read(&mut self, register: Register) -> u32;
    /// Writes `value` to `register`.
    fn write(&mut self, register: Register, value: u32);

    /// Takes words from the receive data FIFO.
    fn read_data(&mut self, words: &mut [[u8; WORD_BYTES]]) {
        for word in words {
            *word = self.read(Register::RxData).to_le_bytes();
        }
    }

    /// Puts words into the transmit data FIFO.
    fn write_data(&mut self, words: &[[u8; WORD_BYTES]]) {
        for word in words {
            self.write(Register::TxData, u32::from_le_bytes(*word));
        }
    }
}

/// Why the controller could not be started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartError {
    /// The byte order test word is wrong: there is no controller, or the bus swaps bytes.
    ByteTest {
        /// [`BYTE_TEST`].
        expected: u32,
        /// Value read.
        actual: u32,
    },
    /// The chip is not a LAN9118.
    Chip {
        /// [`CHIP`].
        expected: u32,
        /// Value read.
        actual: u32,
    },
    /// The reset did not end.
    ResetTimeout,
    /// A register of the MAC stayed busy.
    MacTimeout {
        /// Number of the register.
        register: u32,
    },
}

/// Counters since start-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames given to the controller.
    pub tx_frames: u32,
    /// Frames received with the error bit set.
    pub rx_errors: u32,
    /// Frames received shorter than a header or longer than [`FRAME_BYTES_MAX`].
    pub rx_lengths: u32,
    /// Statuses that announced more data than the FIFO had; the FIFO was emptied.
    pub rx_inconsistent: u32,
    /// Frames sent whose status had the error bit set.
    pub tx_errors: u32,
    /// Frames not sent because the transmit FIFO had no room.
    pub tx_no_room: u32,
    /// Frames not sent because they were longer than [`FRAME_BYTES_MAX`].
    pub tx_too_long: u32,
}

impl Counters {
    /// Frames that were damaged or not sent.
    pub fn failures(&self) -> u32 {
        [
            self.rx_errors,
            self.rx_lengths,
            self.rx_inconsistent,
            self.tx_errors,
            self.tx_no_room,
            self.tx_too_long,
        ]
        .iter()
        .fold(0, |sum: u32, count| sum.wrapping_add(*count))
    }
}

/// The controller, started.
pub struct Lan9118<R> {
    port: Port<R>,
    address: [u8; 6],
    rx: Buffers,
}

/// Whole FIFO words, and aligned like them.
#[derive(Clone)]
#[repr(align(4))]
struct Buffer([[u8; WORD_BYTES]; BUFFER_BYTES / WORD_BYTES]);

impl Buffer {
    const EMPTY: Self = Self([[0; WORD_BYTES]; BUFFER_BYTES / WORD_BYTES]);

    fn bytes_mut(&mut self) -> &mut [u8] {
        self.0.as_flattened_mut()
    }
}

/// Buffers used in turn.
struct Buffers {
    all: [Buffer; BUFFERS],
    last: usize,
}

impl Buffers {
    const EMPTY: Self = Self {
        all: [const { Buffer::EMPTY }; BUFFERS],
        last: 0,
    };

    /// Passes on to the next buffer.
    fn advance(&mut self) -> &mut Buffer {
        self.last = (self.last + 1) % BUFFERS;
        self.last()
    }

    fn last(&mut self) -> &mut Buffer {
        &mut self.all[self.last % BUFFERS]
    }
}

/// The controller without the received frame's buffer, so that a reply can be written while the frame is read.
struct Port<R> {
    registers: R,
    counters: Counters,
    tx: Buffers,
}

impl<R: Registers> Lan9118<R> {
    /// Resets and configures the controller: full duplex, promiscuous (a ring of slaves returns frames to the sender's
    /// own address), interrupt at the first received frame.
    ///
    /// # Errors
    /// See [`StartError`].
    pub fn start(mut registers: R, address: [u8; 6]) -> Result<Self, StartError> {
        expect(BYTE_TEST, registers.read(Register::ByteTest))
            .map_err(|(expected, actual)| StartError::ByteTest { expected, actual })?;
        expect(CHIP, registers.read(Register::IdRev) >> 16)
            .map_err(|(expected, actual)| StartError::Chip { expected, actual })?;
        // First of all: the line is active low out of reset, so an active-high controller sees it asserted.
        registers.write(Register::IrqCfg, IRQ_ACTIVE_HIGH | IRQ_PUSH_PULL);
        registers.write(Register::HwCfg, HW_SOFT_RESET);
        poll(&mut registers, Register::HwCfg, HW_SOFT_RESET).ok_or(StartError::ResetTimeout)?;
        registers.write(Register::IrqCfg, IRQ_ACTIVE_HIGH | IRQ_PUSH_PULL);
        registers.write(Register::HwCfg, HW_TX_FIFO_5_KIB | HW_MUST_BE_ONE);
        registers.write(Register::FifoInt, FIFO_INT_FIRST_FRAME);
        registers.write(Register::IntSts, INT_ALL);
        registers.write(Register::IntEn, INT_RX_STATUS_LEVEL);
        let [a, b, c, d, e, f] = address;
        mac_write(&mut registers, MAC_ADDRL, u32::from_le_bytes([a, b, c, d]))?;
        mac_write(&mut registers, MAC_ADDRH, u32::from_le_bytes([e, f, 0, 0]))?;
        let control = MAC_FULL_DUPLEX | MAC_PROMISCUOUS | MAC_TX_ENABLE | MAC_RX_ENABLE;
        mac_write(&mut registers, MAC_CR, control)?;
        registers.write(Register::TxCfg, TX_ON);
        let line = IRQ_ENABLE | IRQ_ACTIVE_HIGH | IRQ_PUSH_PULL;
        registers.write(Register::IrqCfg, line);
        let port = Port {
            registers,
            counters: Counters::default(),
            tx: Buffers::EMPTY,
        };
        Ok(Self {
            port,
            address,
            rx: Buffers::EMPTY,
        })
    }

    /// Clears the receive interrupt. Only an arrival raises it, so call this before draining the frames.
    pub fn acknowledge(&mut self) {
        clear_arrival(&mut self.port.registers);
    }

    /// The counters.
    pub fn counters(&self) -> Counters {
        self.port.counters
    }

    /// Takes the next intact frame, without check sequence, from the FIFO into the next buffer; damaged frames before it
    /// are counted and discarded.
    fn take_frame<'b>(port: &mut Port<R>, buffers: &'b mut Buffers) -> Option<&'b mut [u8]> {
        let Port {
            registers, counters, ..
        } = port;
        loop {
            let fill = registers.read(Register::RxFifoInf);
            if frames_waiting(fill) == 0 {
                return None;
            }
            let status = registers.read(Register::RxStatus);
            let length = ((status >> RX_LENGTH_SHIFT) & RX_LENGTH_MASK) as usize;
            let words = length.div_ceil(WORD_BYTES);
            if words * WORD_BYTES > (fill & FIFO_DATA_MASK) as usize {
                counters.rx_inconsistent = counters.rx_inconsistent.wrapping_add(1);
                registers.write(Register::RxCfg, RX_DUMP);
                return None;
            }
            if status & STATUS_ERROR != 0 {
                counters.rx_errors = counters.rx_errors.wrapping_add(1);
            } else if !RX_LENGTHS.contains(&length) {
                counters.rx_lengths = counters.rx_lengths.wrapping_add(1);
            } else {
                let buffer = buffers.advance();
                registers.read_data(buffer.0.get_mut(..words)?);
                return buffer.bytes_mut().get_mut(..length - CHECK_SEQUENCE_BYTES);
            }
            for _ in 0..words {
                registers.read(Register::RxData);
            }
        }
    }
}

impl<R: Registers> Port<R> {
    /// Passes the first `length` bytes of the buffer to the MAC, padded to [`FRAME_BYTES_MIN`]; returns false if they
    /// do not fit.
    fn send(&mut self, length: usize) -> bool {
        let padded = length.max(FRAME_BYTES_MIN);
        if padded > FRAME_BYTES_MAX {
            self.counters.tx_too_long = self.counters.tx_too_long.wrapping_add(1);
            return false;
        }
        if length < padded
            && let Some(padding) = self.tx.last().bytes_mut().get_mut(length..padded)
        {
            padding.fill(0);
        }
        let words = padded.div_ceil(WORD_BYTES);
        let fill = self.registers.read(Register::TxFifoInf);
        if ((fill & FIFO_DATA_MASK) as usize) < words * WORD_BYTES + COMMAND_BYTES {
            self.counters.tx_no_room = self.counters.tx_no_room.wrapping_add(1);
            return false;
        }
        let length_bits = padded as u32 & TX_LENGTH_MASK;
        let segments = TX_FIRST_SEGMENT | TX_LAST_SEGMENT;
        self.registers.write(Register::TxData, segments | length_bits);
        self.registers.write(Register::TxData, length_bits);
        self.registers.write_data(self.tx.last().0.get(..words).unwrap_or(&[]));
        self.drain_transmit_status();
        self.counters.tx_frames = self.counters.tx_frames.wrapping_add(1);
        true
    }

    /// Takes the statuses of transmitted frames, so that their FIFO never fills.
    fn drain_transmit_status(&mut self) {
        let fill = self.registers.read(Register::TxFifoInf);
        for _ in 0..(fill >> FIFO_STATUS_SHIFT) & FIFO_STATUS_MASK {
            if self.registers.read(Register::TxStatus) & STATUS_ERROR != 0 {
                self.counters.tx_errors = self.counters.tx_errors.wrapping_add(1);
            }
        }
    }
}

impl<R: Registers> Driver for Lan9118<R> {
    type RxToken<'a>
        = RxToken<'a>
    where
        R: 'a;
    type TxToken<'a>
        = TxToken<'a, R>
    where
        R: 'a;

    fn receive(&mut self, _: &mut Context) -> Option<(RxToken<'_>, TxToken<'_, R>)> {
        let frame = Self::take_frame(&mut self.port, &mut self.rx)?;
        Some((RxToken { frame }, TxToken { port: &mut self.port }))
    }

    /// `None` while the FIFO could not take the longest frame.
    fn transmit(&mut self, _: &mut Context) -> Option<TxToken<'_, R>> {
        let free = self.port.registers.read(Register::TxFifoInf) & FIFO_DATA_MASK;
        if (free as usize) < FRAME_BYTES_MAX + COMMAND_BYTES {
            self.port.counters.tx_no_room = self.port.counters.tx_no_room.wrapping_add(1);
            return None;
        }
        Some(TxToken { port: &mut self.port })
    }

    fn link_state(&mut self, _: &mut Context) -> LinkState {
        LinkState::Up
    }

    fn capabilities(&self) -> Capabilities {
        let mut capabilities = Capabilities::default();
        capabilities.max_transmission_unit = FRAME_BYTES_MAX;
        capabilities.max_burst_size = Some(1);
        capabilities
    }

    fn hardware_address(&self) -> HardwareAddress {
        HardwareAddress::Ethernet(self.address)
    }
}

/// Number of received frames according to a value of [`Register::RxFifoInf`].
pub const fn frames_waiting(rx_fifo_inf: u32) -> u32 {
    (rx_fifo_inf >> FIFO_STATUS_SHIFT) & FIFO_STATUS_MASK
}

/// Clears the receive interrupt. Only an arrival raises it, so call this before checking for frames.
fn clear_arrival(registers: &mut impl Registers) {
    registers.write(Register::IntSts, INT_RX_STATUS_LEVEL);
}

fn expect(expected: u32, actual: u32) -> Result<(), (u32, u32)> {
    if expected == actual {
        Ok(())
    } else {
        Err((expected, actual))
    }
}

/// Waits until `bits` of `register` are clear.
fn poll(registers: &mut impl Registers, register: Register, bits: u32) -> Option<()> {
    (0..POLLS_MAX)
        .any(|_| registers.read(register) & bits == 0)
        .then_some(())
}

fn mac_write(registers: &mut impl Registers, register: u32, value: u32) -> Result<(), StartError> {
    registers.write(Register::MacCsrData, value);
    registers.write(Register::MacCsrCmd, MAC_BUSY | register);
    poll(registers, Register::MacCsrCmd, MAC_BUSY).ok_or(StartError::MacTimeout { register })
}

/// A received frame, in the driver's buffer.
pub struct RxToken<'a> {
    frame: &'a mut [u8],
}

impl embassy_net_driver::RxToken for RxToken<'_> {
    fn consume<T, F: FnOnce(&mut [u8]) -> T>(self, f: F) -> T {
        f(self.frame)
    }
}

/// Permission to send one frame.
pub struct TxToken<'a, R> {
    port: &'a mut Port<R>,
}

impl<R: Registers> TxToken<'_, R> {
    /// Lets `f` fill a frame of `length` bytes and sends it; true if the controller took it.
    ///
    /// A frame longer than [`FRAME_BYTES_MAX`] is filled as far as the buffer goes, counted and not sent.
    pub fn send<T>(&mut self, length: usize, f: impl FnOnce(&mut [u8]) -> T) -> (T, bool) {
        let port = &mut *self.port;
        let result = match port.tx.advance().bytes_mut().get_mut(..length.min(FRAME_BYTES_MAX)) {
            Some(frame) => f(frame),
            None => f(&mut []),
        };
        (result, port.send(length))
    }

    /// Clears the receive interrupt, like [`Lan9118::acknowledge`].
    pub fn acknowledge(&mut self) {
        clear_arrival(&mut self.port.registers);
    }
}

impl<R: Registers> embassy_net_driver::TxToken for TxToken<'_, R> {
    fn consume<T, F: FnOnce(&mut [u8]) -> T>(mut self, length: usize, f: F) -> T {
        self.send(length, f).0
    }
}

#[cfg(test)]
mod tests;
