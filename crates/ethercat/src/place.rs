//! Places of values in the process data: typed handles to bits, valid for one plan.
//!
//! A place is found once for a plan ([`Exchange::place`], [`Exchange::bits`]); a value is then read or written without a
//! search. Values lie as CoE and SII list them: the first entry in the lowest bits of the first byte, each entry directly
//! behind the one before it, numbers with their lowest byte first (ETG.1000.6, process data mapping).
//!
//! Invariant: a place of another plan reads nothing and writes nothing; a value touches its own bits only.

use super::configure::Direction;
use super::cyclic::Exchange;
use super::driver::SlaveFactory;
use super::event::WantedValue;
use core::marker::PhantomData;

/// A type of values in process data.
pub trait Scalar: Copy {
    /// Bits of a whole value.
    const BITS: u8;

    /// The value of the lowest `bits` bits of `raw`; the others are 0.
    fn from_raw(raw: u64, bits: u8) -> Self;

    /// The bits of the value, in the lowest ones.
    fn to_raw(self) -> u64;
}

macro_rules! unsigned {
    ($($kind:ty),*) => {$(
        impl Scalar for $kind {
            const BITS: u8 = <$kind>::BITS as u8;

            #[inline]
            fn from_raw(raw: u64, _: u8) -> Self {
                raw as Self
            }

            #[inline]
            fn to_raw(self) -> u64 {
                u64::from(self)
            }
        }
    )*};
}

macro_rules! signed {
    ($($kind:ty),*) => {$(
        impl Scalar for $kind {
            const BITS: u8 = <$kind>::BITS as u8;

            #[inline]
            fn from_raw(raw: u64, bits: u8) -> Self {
                // The highest bit of the value is its sign.
                let unused = u64::BITS - u32::from(bits.clamp(1, Self::BITS as u8));
                ((raw << unused).cast_signed() >> unused) as Self
            }

            #[inline]
            fn to_raw(self) -> u64 {
                i64::from(self).cast_unsigned()
            }
        }
    )*};
}

unsigned!(u8, u16, u32, u64);
signed!(i8, i16, i32, i64);

impl Scalar for bool {
    const BITS: u8 = 1;

    #[inline]
    fn from_raw(raw: u64, _: u8) -> Self {
        raw != 0
    }

    #[inline]
    fn to_raw(self) -> u64 {
        u64::from(self)
    }
}

impl Scalar for f32 {
    const BITS: u8 = 32;

    #[inline]
    fn from_raw(raw: u64, _: u8) -> Self {
        Self::from_bits(raw as u32)
    }

    #[inline]
    fn to_raw(self) -> u64 {
        u64::from(self.to_bits())
    }
}

/// Where a value of a slave is, for one plan.
#[derive(Debug, PartialEq, Eq)]
pub struct Place<T> {
    plan: u32,
    slave: u8,
    direction: Direction,
    bit: u16,
    bits: u8,
    kind: PhantomData<T>,
}

impl<T> Clone for Place<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Place<T> {}

impl<T> Place<T> {
    /// Place in the chain of the slave that has the value, from 0.
    pub const fn slave(&self) -> usize {
        self.slave as usize
    }

    /// Number of the plan for which this place is valid, see [`Exchange::plan_number`].
    pub const fn plan(&self) -> u32 {
        self.plan
    }
}

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize>
    Exchange<'_, F, SLAVES, MESSAGE, FURTHER>
{
    /// Place of a whole value that begins at bit `bit` of a slave's inputs or outputs; `None` if the plan in force
    /// exchanges no such bits. `slave` is its place in the chain.
    pub fn place<T: Scalar>(&self, slave: usize, direction: Direction, bit: u16) -> Option<Place<T>> {
        self.bits(slave, direction, bit, T::BITS)
    }

    /// Place of a wanted value, which has this number in [`BusSetup::values`](super::event::BusSetup::values); `None`
    /// while no slave exchanges it, or if the type has fewer bits.
    pub fn value<T: Scalar>(&self, number: usize, wanted: &WantedValue) -> Option<Place<T>> {
        let bit = self.plan().values.get(number)?.bit()?;
        self.bits(wanted.slave.into(), wanted.direction, bit, wanted.bits)
    }

    /// Place of a value of `bits` bits, as [`Self::place`]. `None` also if the type has fewer bits, or for 0 bits.
    pub fn bits<T: Scalar>(&self, slave: usize, direction: Direction, bit: u16, bits: u8) -> Option<Place<T>> {
        let share = self.plan().slaves.get(slave)?;
        if share.role.is_none() && !self.plan().terminals.contains(slave) {
            return None;
        }
        let bytes = match direction {
            Direction::Inputs => share.input_length,
            Direction::Outputs => self.sent(slave).len() as u16,
        };
        let end = u32::from(bit) + u32::from(bits);
        let is_there = (1..=T::BITS).contains(&bits) && end <= 8 * u32::from(bytes);
        is_there.then_some(Place {
            plan: self.plan_number(),
            slave: slave as u8,
            direction,
            bit,
            bits,
            kind: PhantomData,
        })
    }

    /// The value at a place: of this cycle's inputs, `None` unless they arrived; or of the outputs that the next telegram
    /// carries. `None` for a place of another plan.
    #[inline]
    pub fn get<T: Scalar>(&self, place: &Place<T>) -> Option<T> {
        if place.plan != self.plan_number() {
            return None;
        }
        let bytes = match place.direction {
            Direction::Inputs => self.input(place.slave())?,
            Direction::Outputs => self.sent(place.slave()),
        };
        Some(T::from_raw(read_bits(bytes, place.bit, place.bits)?, place.bits))
    }

    /// Sets the value at a place of outputs for the next telegram. Returns whether it was set: not for a place of another
    /// plan, and not for inputs.
    #[inline]
    pub fn set<T: Scalar>(&mut self, place: &Place<T>, value: T) -> bool {
        place.plan == self.plan_number()
            && place.direction == Direction::Outputs
            && write_bits(self.output(place.slave()), place.bit, place.bits, value.to_raw()).is_some()
    }
}

/// The bits from `bit` on, at most 64, in the lowest ones; `None` beyond the end.
#[inline]
fn read_bits(bytes: &[u8], bit: u16, bits: u8) -> Option<u64> {
    let (first, shift) = (usize::from(bit / 8), u32::from(bit % 8));
    let end = (usize::from(bit) + usize::from(bits)).div_ceil(8);
    let bytes = bytes.get(first..end)?;
    let low = (0..u64::BITS).step_by(8).zip(bytes);
    let raw = low.fold(0, |raw, (at, byte)| raw | u64::from(*byte) << at);
    // A ninth byte is there only if the value does not begin at a byte boundary.
    let high = bytes.get(8).map_or(0, |ninth| u64::from(*ninth) << (u64::BITS - shift));
    Some((raw >> shift | high) & mask(bits))
}

/// Sets the bits from `bit` on, at most 64; `None` beyond the end, and then nothing is changed.
#[inline]
fn write_bits(bytes: &mut [u8], bit: u16, bits: u8, raw: u64) -> Option<()> {
    let (first, shift) = (usize::from(bit / 8), u32::from(bit % 8));
    let end = (usize::from(bit) + usize::from(bits)).div_ceil(8);
    let mask = mask(bits);
    // The part of a number that belongs into the byte at this distance in bits.
    let part = |number: u64, at: u32| match at {
        0 => (number << shift) as u8,
        _ => (number >> (at - shift)) as u8,
    };
    for (at, byte) in (0..).step_by(8).zip(bytes.get_mut(first..end)?) {
        *byte = *byte & !part(mask, at) | part(raw & mask, at);
    }
    Some(())
}

const fn mask(bits: u8) -> u64 {
    match bits {
        0 => 0,
        1..=63 => (1 << bits) - 1,
        _ => u64::MAX,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn a_value_touches_its_own_bits_only_and_reads_back() {
        let mut random = Random::new(11);
        for _ in 0..20_000 {
            let bits = 1 + (random.next() % 64) as u8;
            let bit = (random.next() % (257 - u32::from(bits))) as u16;
            let mut bytes = [0_u8; 32];
            bytes.iter_mut().for_each(|byte| *byte = random.next() as u8);
            let raw = u64::from(random.next()) << 32 | u64::from(random.next());
            let before = bytes;
            assert_eq!(write_bits(&mut bytes, bit, bits, raw), Some(()));
            assert_eq!(read_bits(&bytes, bit, bits), Some(raw & mask(bits)));
            for number in 0..256_u16 {
                let at = |bytes: &[u8; 32]| bytes[usize::from(number / 8)] >> (number % 8) & 1;
                let expected = match number.checked_sub(bit).filter(|place| *place < bits.into()) {
                    Some(place) => (raw >> place & 1) as u8,
                    None => at(&before),
                };
                assert_eq!(at(&bytes), expected, "bit {number} of {bits} bits at {bit}");
            }
        }
    }

    #[test]
    fn values_beyond_the_end_are_neither_read_nor_written() {
        let mut bytes = [0xA5; 4];
        for (bit, bits) in [(32, 1), (31, 2), (0, 33), (25, 8), (u16::MAX, 64)] {
            assert_eq!(read_bits(&bytes, bit, bits), None);
            assert_eq!(write_bits(&mut bytes, bit, bits, u64::MAX), None);
        }
        assert_eq!(bytes, [0xA5; 4]);
    }

    #[test]
    fn signed_values_keep_their_sign_in_any_number_of_bits() {
        assert_eq!(i16::from_raw(0x0FFF, 12), -1);
        assert_eq!(i16::from_raw(0x07FF, 12), 0x07FF);
        assert_eq!(i8::from_raw(0x80, 8), i8::MIN);
        assert_eq!(i64::from_raw(u64::MAX, 64), -1);
        assert_eq!((-2_i32).to_raw() & 0xF, 0xE);
        assert_eq!(f32::from_raw(1.5_f32.to_raw(), 32), 1.5);
        assert!(bool::from_raw(1, 1) && !bool::from_raw(0, 1));
    }
}
