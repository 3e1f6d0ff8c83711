//! Registers of the distributed clocks.
//!
//! A write to [`DC_RECEIVE_TIME`] makes every slave latch the local time at which the frame passes each of its ports;
//! the differences give the cable delays. The master writes offset and delay. From then on a datagram that carries the
//! reference clock's system time past all slaves adjusts their clocks (IEC 61158-4-12, distributed clocks). All times
//! are in nanoseconds; controllers with 32-bit clocks leave the upper half of 64-bit registers at 0.
//!
//! Invariant: constants and plain field structures; the choice of the reference and the delays are computed elsewhere.

use super::port::PORTS;
use crate::wire::{Error, check_len, check_room, read_u32, write_bytes};

/// First register of the distributed clocks: receive times of the four ports, 4 bytes each; a write latches all of
/// them.
pub const DC_RECEIVE_TIME: u16 = 0x0900;
/// System time of the slave, 8 bytes; a write adjusts the clock towards the value written.
pub const DC_SYSTEM_TIME: u16 = 0x0910;
/// Receive time at the processing unit, 8 bytes, in local time without offset.
pub const DC_RECEIVE_TIME_UNIT: u16 = 0x0918;
/// Offset from local to system time, 8 bytes.
pub const DC_OFFSET: u16 = 0x0920;
/// Delay from the reference clock to this slave, 4 bytes.
pub const DC_DELAY: u16 = 0x0928;
/// Mean difference between local and received system time, 4 bytes, see [`time_difference_ns`].
pub const DC_TIME_DIFFERENCE: u16 = 0x092C;
/// Bandwidth of the control loop, 2 bytes; a write resets the loop's filters.
pub const DC_SPEED_START: u16 = 0x0930;
/// Deviation of the local clock's period from the reference, 2 bytes.
pub const DC_SPEED_DIFFERENCE: u16 = 0x0932;
/// Filter depth of the time difference, 1 byte.
pub const DC_DIFFERENCE_FILTER: u16 = 0x0934;
/// Filter depth of the speed, 1 byte.
pub const DC_SPEED_FILTER: u16 = 0x0935;
/// Control of the SYNC unit, 1 byte: bit 0 clear means control by the master. Together with [`DC_ACTIVATION`] behind
/// it, this register takes the SII's AssignActivate as one 16-bit write.
pub const DC_CYCLIC_CONTROL: u16 = 0x0980;
/// SYNC unit activation, 1 byte, see the `ACTIVATE_` constants.
pub const DC_ACTIVATION: u16 = 0x0981;
/// Length of SYNC pulses, 2 bytes, in units of 10 ns; 0 waits for an acknowledge.
pub const DC_PULSE_LENGTH: u16 = 0x0982;
/// Activation status, 1 byte: bits 0 and 1 are set while a first SYNC0 or SYNC1 pulse is pending.
pub const DC_ACTIVATION_STATUS: u16 = 0x0984;
/// State of SYNC0, 1 byte.
pub const DC_SYNC0_STATUS: u16 = 0x098E;
/// State of SYNC1, 1 byte.
pub const DC_SYNC1_STATUS: u16 = 0x098F;
/// System time of the first SYNC0 pulse when written, of the next one when read; 8 bytes.
pub const DC_START_TIME: u16 = 0x0990;
/// System time of the next SYNC1 pulse, 8 bytes.
pub const DC_NEXT_SYNC1: u16 = 0x0998;
/// Cycle of SYNC0, 4 bytes, ns; 0 is a single pulse.
pub const DC_SYNC0_CYCLE: u16 = 0x09A0;
/// Time from SYNC0 to SYNC1, 4 bytes, ns.
pub const DC_SYNC1_CYCLE: u16 = 0x09A4;

/// [`DC_ACTIVATION`]: the SYNC unit is enabled.
pub const ACTIVATE_CYCLIC: u8 = 1 << 0;
/// [`DC_ACTIVATION`]: SYNC0 pulses are generated.
pub const ACTIVATE_SYNC0: u8 = 1 << 1;
/// [`DC_ACTIVATION`]: SYNC1 pulses are generated.
pub const ACTIVATE_SYNC1: u8 = 1 << 2;

/// Value of [`DC_SPEED_START`] at power-up; writing it resets the filters without changing the bandwidth.
pub const SPEED_START_DEFAULT: u16 = 0x1000;

const SIGN_BIT: u32 = 1 << 31;

/// The signed form of [`DC_TIME_DIFFERENCE`], ns: positive when the local clock is ahead of the reference.
///
/// The register holds the magnitude; bit 31 is set if the local clock is behind.
pub const fn time_difference_ns(register: u32) -> i32 {
    let magnitude = (register & !SIGN_BIT).cast_signed();
    if register & SIGN_BIT != 0 {
        -magnitude
    } else {
        magnitude
    }
}

/// The register form of a time difference in ns; `i32::MIN` becomes the largest magnitude.
pub const fn time_difference_bits(difference_ns: i32) -> u32 {
    if difference_ns < 0 {
        difference_ns.saturating_neg().cast_unsigned() | SIGN_BIT
    } else {
        difference_ns.cast_unsigned()
    }
}

/// Local times at which the latching frame arrived at the ports, ns, wrapping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReceiveTimes {
    /// Time of each port; meaningless for a port without a link.
    pub ports_ns: [u32; PORTS],
}

impl ReceiveTimes {
    /// Bytes of the registers.
    pub const LEN: usize = 4 * PORTS;

    /// Reads the registers from [`DC_RECEIVE_TIME`] on.
    ///
    /// # Errors
    /// [`Error::Truncated`] below [`Self::LEN`] bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        Ok(Self {
            ports_ns: core::array::from_fn(|port| read_u32(bytes, 4 * port)),
        })
    }

    /// Writes the registers.
    ///
    /// # Errors
    /// [`Error::Room`] below [`Self::LEN`] bytes.
    pub fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        for (port, time_ns) in self.ports_ns.iter().enumerate() {
            write_bytes(bytes, 4 * port, &time_ns.to_le_bytes());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_difference_is_sign_and_magnitude() {
        assert_eq!(time_difference_ns(5), 5);
        assert_eq!(time_difference_ns(0x8000_0005), -5);
        assert_eq!(time_difference_ns(0x8000_0000), 0);
        for difference_ns in [0, 1, -1, i32::MAX, -i32::MAX] {
            assert_eq!(time_difference_ns(time_difference_bits(difference_ns)), difference_ns);
        }
        assert_eq!(time_difference_ns(time_difference_bits(i32::MIN)), -i32::MAX);
    }

    #[test]
    fn receive_times_survive_emit_and_parse() {
        let times = ReceiveTimes {
            ports_ns: [1, 0x0203_0405, u32::MAX, 0],
        };
        let mut bytes = [0xAA; 16];
        times.emit(&mut bytes).unwrap();
        assert_eq!(bytes[4..8], [5, 4, 3, 2]);
        assert_eq!(ReceiveTimes::parse(&bytes), Ok(times));
        assert!(ReceiveTimes::parse(&bytes[1..]).is_err());
    }
}
