//! One datagram: a command to the slaves' memory, and the working counter of its executions.
//!
//! A frame carries a chain of datagrams. Each datagram's More bit is set if another one follows. Every slave that
//! executes the command adds to the working counter at the datagram's end (+1 for a read, +1 for a write, +2 for the
//! write half of a combined command).
//!
//! Invariant: a view or an iterator only returns ranges inside the bytes that it was made from.

use super::{Error, check_len, check_room, read_u8, read_u16, read_u32, write_bytes};
use core::ops::Range;

/// Bytes before a datagram's data.
pub const DATAGRAM_HEADER_LEN: usize = 10;
/// Bytes of a datagram besides its data: header and working counter.
pub const DATAGRAM_OVERHEAD: usize = DATAGRAM_HEADER_LEN + 2;

const COMMAND: usize = 0;
const INDEX: usize = 1;
const ADDRESS: usize = 2;
const LENGTH: usize = 6;
const INTERRUPT: usize = 8;

const LENGTH_MASK: u16 = 0x07FF;
const CIRCULATING_BIT: u16 = 1 << 14;
const MORE_BIT: u16 = 1 << 15;

/// Command of a datagram (IEC 61158-4-12, service table).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Command {
    /// No operation.
    #[default]
    Nop = 0,
    /// Auto-increment physical read: by position in the chain.
    Aprd = 1,
    /// Auto-increment physical write: by position in the chain.
    Apwr = 2,
    /// Auto-increment physical read and write: by position in the chain.
    Aprw = 3,
    /// Configured address physical read: by station address.
    Fprd = 4,
    /// Configured address physical write: by station address.
    Fpwr = 5,
    /// Configured address physical read and write: by station address.
    Fprw = 6,
    /// Broadcast read: every slave's data are OR-ed together.
    Brd = 7,
    /// Broadcast write.
    Bwr = 8,
    /// Broadcast read and write.
    Brw = 9,
    /// Logical memory read: through the slaves' FMMUs.
    Lrd = 10,
    /// Logical memory write.
    Lwr = 11,
    /// Logical memory read and write.
    Lrw = 12,
    /// Read by position, write to all other slaves.
    Armw = 13,
    /// Read by station address, write to all other slaves.
    Frmw = 14,
}

impl Command {
    /// The command with a number on the wire.
    ///
    /// # Errors
    /// [`Error::Command`] for a number above 14.
    pub const fn from_number(number: u8) -> Result<Self, Error> {
        Ok(match number {
            0 => Self::Nop,
            1 => Self::Aprd,
            2 => Self::Apwr,
            3 => Self::Aprw,
            4 => Self::Fprd,
            5 => Self::Fpwr,
            6 => Self::Fprw,
            7 => Self::Brd,
            8 => Self::Bwr,
            9 => Self::Brw,
            10 => Self::Lrd,
            11 => Self::Lwr,
            12 => Self::Lrw,
            13 => Self::Armw,
            14 => Self::Frmw,
            actual => return Err(Error::Command { actual }),
        })
    }

    /// Whether slaves put their data into the datagram.
    pub const fn reads(self) -> bool {
        !matches!(self, Self::Nop | Self::Apwr | Self::Fpwr | Self::Bwr | Self::Lwr)
    }

    /// Whether slaves take data out of the datagram.
    pub const fn writes(self) -> bool {
        !matches!(self, Self::Nop | Self::Aprd | Self::Fprd | Self::Brd | Self::Lrd)
    }

    /// Whether the address is an address in the logical memory.
    pub const fn is_logical(self) -> bool {
        matches!(self, Self::Lrd | Self::Lwr | Self::Lrw)
    }

    /// Whether each slave that the frame passes increments the device part of the address.
    pub const fn counts_position(self) -> bool {
        matches!(
            self,
            Self::Aprd | Self::Apwr | Self::Aprw | Self::Armw | Self::Brd | Self::Bwr | Self::Brw
        )
    }
}

/// The four address bytes of a datagram: slave and register, or one logical address.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Address(pub u32);

impl Address {
    /// A slave by its position in the chain (0 is the first) and one of its registers.
    pub const fn position(position: u16, register: u16) -> Self {
        Self::new(0u16.wrapping_sub(position), register)
    }

    /// A slave by its configured station address and one of its registers.
    pub const fn station(station: u16, register: u16) -> Self {
        Self::new(station, register)
    }

    /// One register of all slaves.
    pub const fn broadcast(register: u16) -> Self {
        Self::new(0, register)
    }

    /// An address in the logical memory.
    pub const fn logical(address: u32) -> Self {
        Self(address)
    }

    /// An address from its two halves as on the wire: device part first, register second.
    pub const fn new(device: u16, register: u16) -> Self {
        Self(device as u32 | (register as u32) << 16)
    }

    /// The device half: station address, or the counter that is 0 at the addressed position.
    pub const fn device(self) -> u16 {
        self.0 as u16
    }

    /// The register half.
    pub const fn register(self) -> u16 {
        (self.0 >> 16) as u16
    }
}

/// A datagram's header in host form.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DatagramRepr {
    /// The command.
    pub command: Command,
    /// Index by which the master recognises the answer; slaves do not change it.
    pub index: u8,
    /// Slave and register.
    pub address: Address,
    /// Length of the data, bytes: at most 1486 in an Ethernet frame; 11 bits on the wire.
    pub length: u16,
    /// Set by a slave in a frame that passes a second time; such a frame is void.
    pub circulating: bool,
    /// Whether another datagram follows.
    pub more: bool,
    /// The slaves' event requests, OR-ed together.
    pub interrupt: u16,
}

impl DatagramRepr {
    /// The header of a request; the slaves' fields are 0.
    pub const fn request(command: Command, index: u8, address: Address, length: u16) -> Self {
        Self {
            command,
            index,
            address,
            length,
            circulating: false,
            more: false,
            interrupt: 0,
        }
    }

    /// Length of the complete datagram, bytes: header, data and working counter.
    pub const fn len(&self) -> usize {
        DATAGRAM_OVERHEAD + self.length as usize
    }

    /// Always false: a datagram has at least a header.
    pub const fn is_empty(&self) -> bool {
        false
    }

    /// Parses a header.
    ///
    /// # Errors
    /// [`Error::Command`] when the command is unknown.
    pub fn parse<T: AsRef<[u8]>>(datagram: &Datagram<T>) -> Result<Self, Error> {
        let bytes = datagram.buffer.as_ref();
        let length = read_u16(bytes, LENGTH);
        Ok(Self {
            command: Command::from_number(read_u8(bytes, COMMAND))?,
            index: read_u8(bytes, INDEX),
            address: Address(read_u32(bytes, ADDRESS)),
            length: length & LENGTH_MASK,
            circulating: length & CIRCULATING_BIT != 0,
            more: length & MORE_BIT != 0,
            interrupt: read_u16(bytes, INTERRUPT),
        })
    }

    /// Writes the header to the start of `bytes`; data and working counter stay as they are.
    ///
    /// # Errors
    /// [`Error::Room`] when the datagram does not fit, [`Error::Value`] when the length needs more than 11 bits.
    pub fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        if self.length > LENGTH_MASK {
            return Err(Error::Value { actual: self.length });
        }
        check_room(bytes, self.len())?;
        let mut length = self.length;
        if self.circulating {
            length |= CIRCULATING_BIT;
        }
        if self.more {
            length |= MORE_BIT;
        }
        write_bytes(bytes, COMMAND, &[self.command as u8, self.index]);
        write_bytes(bytes, ADDRESS, &self.address.0.to_le_bytes());
        write_bytes(bytes, LENGTH, &length.to_le_bytes());
        write_bytes(bytes, INTERRUPT, &self.interrupt.to_le_bytes());
        Ok(())
    }
}

/// A view of one datagram at the start of a buffer.
#[derive(Clone, Copy, Debug)]
pub struct Datagram<T> {
    buffer: T,
}

impl<T: AsRef<[u8]>> Datagram<T> {
    /// A view of the datagram that starts with `buffer`.
    ///
    /// # Errors
    /// [`Error::Truncated`] when header, data or working counter are cut off.
    pub fn new_checked(buffer: T) -> Result<Self, Error> {
        let bytes = buffer.as_ref();
        check_len(bytes, DATAGRAM_OVERHEAD)?;
        check_len(
            bytes,
            DATAGRAM_OVERHEAD + usize::from(read_u16(bytes, LENGTH) & LENGTH_MASK),
        )?;
        Ok(Self { buffer })
    }

    fn data_range(&self) -> Range<usize> {
        let length = usize::from(read_u16(self.buffer.as_ref(), LENGTH) & LENGTH_MASK);
        DATAGRAM_HEADER_LEN..DATAGRAM_HEADER_LEN + length
    }

    /// The command's number on the wire.
    pub fn command_number(&self) -> u8 {
        read_u8(self.buffer.as_ref(), COMMAND)
    }

    /// The master's index.
    pub fn index(&self) -> u8 {
        read_u8(self.buffer.as_ref(), INDEX)
    }

    /// Slave and register.
    pub fn address(&self) -> Address {
        Address(read_u32(self.buffer.as_ref(), ADDRESS))
    }

    /// Whether another datagram follows.
    pub fn more(&self) -> bool {
        read_u16(self.buffer.as_ref(), LENGTH) & MORE_BIT != 0
    }

    /// Whether the frame passed a second time.
    pub fn circulating(&self) -> bool {
        read_u16(self.buffer.as_ref(), LENGTH) & CIRCULATING_BIT != 0
    }

    /// The data.
    pub fn data(&self) -> &[u8] {
        self.buffer.as_ref().get(self.data_range()).unwrap_or(&[])
    }

    /// The working counter: reads and writes counted by the slaves.
    pub fn working_counter(&self) -> u16 {
        read_u16(self.buffer.as_ref(), self.data_range().end)
    }

    /// Length of the complete datagram, bytes.
    pub fn total_len(&self) -> usize {
        self.data_range().end + 2
    }
}

impl<T: AsRef<[u8]> + AsMut<[u8]>> Datagram<T> {
    /// Replaces the address, as slaves do with positions.
    pub fn set_address(&mut self, address: Address) {
        write_bytes(self.buffer.as_mut(), ADDRESS, &address.0.to_le_bytes());
    }

    /// Replaces the slaves' event requests.
    pub fn set_interrupt(&mut self, interrupt: u16) {
        write_bytes(self.buffer.as_mut(), INTERRUPT, &interrupt.to_le_bytes());
    }

    /// Marks the frame as passing a second time.
    pub fn set_circulating(&mut self, circulating: bool) {
        let rest = read_u16(self.buffer.as_ref(), LENGTH) & !CIRCULATING_BIT;
        let bit = if circulating { CIRCULATING_BIT } else { 0 };
        write_bytes(self.buffer.as_mut(), LENGTH, &(rest | bit).to_le_bytes());
    }

    /// The data, mutable.
    pub fn data_mut(&mut self) -> &mut [u8] {
        let range = self.data_range();
        self.buffer.as_mut().get_mut(range).unwrap_or(&mut [])
    }

    /// Replaces the working counter.
    pub fn set_working_counter(&mut self, working_counter: u16) {
        let offset = self.data_range().end;
        write_bytes(self.buffer.as_mut(), offset, &working_counter.to_le_bytes());
    }
}

/// Walks the chain of datagrams in an EtherCAT payload; ends after the first error.
///
/// The chain has to end exactly where the payload does.
#[derive(Clone, Debug)]
pub struct Datagrams<'a> {
    payload: &'a [u8],
    offset: usize,
    done: bool,
}

impl<'a> Datagrams<'a> {
    /// Walks `payload`: the bytes after the EtherCAT header, without the frame's padding.
    pub const fn new(payload: &'a [u8]) -> Self {
        Self {
            payload,
            offset: 0,
            done: false,
        }
    }

    fn walk(&mut self) -> Result<Range<usize>, Error> {
        self.done = true;
        let rest = self.payload.get(self.offset..).unwrap_or(&[]);
        let datagram = Datagram::new_checked(rest)?;
        let range = self.offset..self.offset + datagram.total_len();
        self.done = !datagram.more();
        self.offset = range.end;
        if self.done && range.end != self.payload.len() {
            return Err(Error::ChainLength {
                expected: self.payload.len(),
                actual: range.end,
            });
        }
        Ok(range)
    }

    /// The range of the next datagram within the payload, for in-place changes.
    pub fn next_range(&mut self) -> Option<Result<Range<usize>, Error>> {
        if self.done { None } else { Some(self.walk()) }
    }
}

impl<'a> Iterator for Datagrams<'a> {
    type Item = Result<Datagram<&'a [u8]>, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        let payload = self.payload;
        let range = self.next_range()?;
        Some(range.and_then(|range| Datagram::new_checked(payload.get(range).unwrap_or(&[]))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn a_header_survives_emit_and_parse() {
        for number in 0..=14 {
            let repr = DatagramRepr {
                command: Command::from_number(number).unwrap(),
                index: 0x80 + number,
                address: Address::new(0x1001 + u16::from(number), 0x0130),
                length: 4,
                circulating: number % 2 == 0,
                more: number % 3 == 0,
                interrupt: 0x0204,
            };
            let mut bytes = [0; 16];
            repr.emit(&mut bytes).unwrap();
            assert_eq!(
                DatagramRepr::parse(&Datagram::new_checked(&bytes[..]).unwrap()),
                Ok(repr)
            );
        }
        assert_eq!(Command::from_number(15), Err(Error::Command { actual: 15 }));
    }

    #[test]
    fn positions_count_down_from_zero() {
        assert_eq!(Address::position(0, 0x10).device(), 0);
        assert_eq!(Address::position(3, 0x10).device(), 0xFFFD);
        assert_eq!(Address::position(3, 0x10).register(), 0x10);
    }

    #[test]
    fn a_datagram_that_claims_more_than_there_is_is_refused() {
        let mut bytes = [0; 16];
        DatagramRepr::request(Command::Brd, 1, Address::broadcast(0), 4)
            .emit(&mut bytes)
            .unwrap();
        assert!(Datagram::new_checked(&bytes[..]).is_ok());
        assert_eq!(
            Datagram::new_checked(&bytes[..15]).err(),
            Some(Error::Truncated {
                expected: 16,
                actual: 15
            })
        );
        assert_eq!(
            DatagramRepr::request(Command::Brd, 1, Address::broadcast(0), 4).emit(&mut bytes[..15]),
            Err(Error::Room {
                expected: 16,
                actual: 15
            })
        );
    }

    #[test]
    fn a_chain_with_a_wrong_more_bit_is_an_error_at_its_end() {
        let mut bytes = [0; 28];
        let mut repr = DatagramRepr::request(Command::Brd, 1, Address::broadcast(0x130), 2);
        repr.emit(&mut bytes).unwrap();
        repr.emit(&mut bytes[14..]).unwrap();
        let mut chain = Datagrams::new(&bytes);
        assert_eq!(
            chain.next().unwrap().err(),
            Some(Error::ChainLength {
                expected: 28,
                actual: 14
            })
        );
        assert!(chain.next().is_none());

        repr.more = true;
        repr.emit(&mut bytes).unwrap();
        assert_eq!(Datagrams::new(&bytes).filter(|datagram| datagram.is_ok()).count(), 2);
        repr.emit(&mut bytes[14..]).unwrap();
        assert!(Datagrams::new(&bytes).nth(2).unwrap().is_err());
    }

    #[test]
    fn no_byte_pattern_makes_the_walk_read_outside_or_run_for_ever() {
        let mut random = Random::new(0x2545_F491);
        for round in 0..20_000 {
            let mut bytes = [0u8; 40];
            for byte in &mut bytes {
                let any = random.next() as u8;
                *byte = if round % 2 == 0 { any & 0x81 } else { any };
            }
            let length = (random.next() % 41) as usize;
            assert!(Datagrams::new(&bytes[..length]).count() <= 4);
        }
    }
}
