//! When a slave's clock has settled: near the reference, and hardly moving against it any more.

use super::super::acyclic::AcyclicPort;
use super::super::error::BusError;
use super::super::wire::{read_u32, register};

/// Largest difference between a slave's system time and the reference's before the slave goes to OP, ns.
pub const DIFFERENCE_MAX_NS: u32 = 1_000;
/// Longest wait for the clocks to agree, ms: some take thousands of frames.
pub const DIFFERENCE_TIMEOUT_MS: u32 = 5_000;
/// How often in a row a slave's clock has to be near the reference.
const AGREED_READINGS: u8 = 3;
/// Time between two readings of a clock that is near the reference, ms.
const AGREED_APART_MS: u32 = 10;
/// Part of the largest difference by which the readings may drift apart: a quarter of 1,000 ns in 20 ms is 12.5 ppm.
const CHANGE_SHARE: u32 = 4;

/// A slave's difference from the reference, ns: positive when it is ahead.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn difference_ns<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<i32, BusError> {
    let bytes = port.read(station, register::DC_TIME_DIFFERENCE, 4).await?;
    Ok(register::time_difference_ns(read_u32(&bytes, 0)))
}

/// How near to the reference a slave's clock has to come before the slave goes to OP, and how long this may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settling {
    /// Largest difference, ns.
    pub difference_ns: u32,
    /// Longest wait, ms.
    pub wait_ms: u32,
}

impl Default for Settling {
    /// [`DIFFERENCE_MAX_NS`] within [`DIFFERENCE_TIMEOUT_MS`].
    fn default() -> Self {
        Self {
            difference_ns: DIFFERENCE_MAX_NS,
            wait_ms: DIFFERENCE_TIMEOUT_MS,
        }
    }
}

/// Waits until a slave's clock has settled: near the reference, and hardly moving against it any more. The cyclic frames have
/// to carry the time datagram meanwhile. A clock that still learns its own drift passes by the reference's time first.
///
/// # Errors
/// [`BusError::ClockDifference`] after the longest wait, or as [`AcyclicPort::send_until_counted`].
pub async fn await_agreement<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    settling: Settling,
) -> Result<i32, BusError> {
    let (started_ms, mut agreed, mut least_ns, mut most_ns) = (port.now_ms(), 0, 0, 0);
    loop {
        let actual_ns = difference_ns(port, station).await?;
        (agreed, least_ns, most_ns) = match agreed {
            _ if actual_ns.unsigned_abs() > settling.difference_ns => (0, 0, 0),
            0 => (1, actual_ns, actual_ns),
            agreed => (agreed + 1, actual_ns.min(least_ns), actual_ns.max(most_ns)),
        };
        if agreed >= AGREED_READINGS {
            if most_ns.abs_diff(least_ns) <= settling.difference_ns / CHANGE_SHARE {
                return Ok(actual_ns);
            }
            (agreed, least_ns, most_ns) = (1, actual_ns, actual_ns);
        }
        if agreed > 0 {
            port.wait_ms(AGREED_APART_MS).await;
        }
        let waited_ms = port.now_ms().wrapping_sub(started_ms);
        // A clock that came near at the end is read as often as any other.
        let readings_ms = if agreed > 0 {
            u32::from(AGREED_READINGS) * AGREED_APART_MS
        } else {
            0
        };
        if waited_ms > settling.wait_ms.saturating_add(readings_ms) {
            return Err(BusError::ClockDifference {
                expected_ns: settling.difference_ns,
                actual_ns,
                waited_ms,
            });
        }
    }
}
