//! The time of the bus as the master continues it while it is not read, and what is done with it when the clock that distributed
//! its time has gone.

use super::super::acyclic::AcyclicPort;
use super::super::slave_set::SlaveSet;
use super::super::wire::{read_u32, register};
use super::{BusClocks, reference_of, restart_loop};

/// How often the reference's time is continued, ms.
const FOLLOW_PERIOD_MS: u32 = 1_000;
/// How far the master's own time may be from the moment at which a slave notes its, ns: its count may be coarse, and a reading takes
/// its cycles. The time would be continued no better without that slave.
const READING_MAX_NS: u64 = 20 * NS_PER_MS;
/// What the master's own time may be wrong by, as the divisor of the time that has passed: 200 parts per million.
const OWN_TIME_DIVISOR: u64 = 5_000;
/// Most that both may come to, ns: 32 bits of a time that is further away say nothing.
const OFF_MAX_NS: u64 = 1_000 * NS_PER_MS;
/// Nanoseconds in a millisecond.
const NS_PER_MS: u64 = 1_000_000;

impl<const SLAVES: usize> BusClocks<SLAVES> {
    /// The time of the bus at `now_ms` according to the master's own time, ns; `None` before it was read.
    fn expected_ns(&self, now_ms: u32) -> Option<u64> {
        let passed_ns = u64::from(now_ms.wrapping_sub(self.read_ms)) * NS_PER_MS;
        self.time_ns.map(|time_ns| time_ns.wrapping_add(passed_ns))
    }

    /// The reference's time in 64 bits from the low 32 bits that were read of it at `now_ms`: the value nearest to what
    /// the master's own time lets expect. The upper bits of a clock of 64 bits that was set by one of 32 say nothing.
    pub(super) fn extended_ns(&mut self, read_ns: u64, now_ms: u32) -> u64 {
        let time_ns = match self.expected_ns(now_ms) {
            Some(expected_ns) => {
                let off_ns = (read_ns as u32).wrapping_sub(expected_ns as u32) as i32;
                expected_ns.wrapping_add_signed(off_ns.into())
            }
            None => read_ns,
        };
        (self.time_ns, self.read_ms) = (Some(time_ns), now_ms);
        time_ns
    }

    /// The time of the bus for a frame at `now_ms` when no clock has kept it, ns: about that of the master, and with the
    /// phase that the frames had at the reference.
    pub(super) fn continued_ns(&self, now_ms: u32) -> u64 {
        let (expected_ns, period_ns) = (self.expected_ns(now_ms).unwrap_or(0), u64::from(self.period_ns.max(1)));
        expected_ns - expected_ns % period_ns + u64::from(self.phase_ns)
    }

    /// Whether a clock's lower 32 bits, read at `now_ms`, may be those of the time of the bus as the master's own time tells it.
    fn may_be_the_time(&self, read_ns: u32, now_ms: u32) -> bool {
        let passed_ns = u64::from(now_ms.wrapping_sub(self.read_ms)) * NS_PER_MS;
        let off_max_ns = (READING_MAX_NS + passed_ns / OWN_TIME_DIVISOR).min(OFF_MAX_NS);
        self.expected_ns(now_ms).is_some_and(|expected_ns| {
            let off_ns = read_ns.wrapping_sub(expected_ns as u32) as i32;
            u64::from(off_ns.unsigned_abs()) <= off_max_ns
        })
    }
}

/// Continues the reference's time in 64 bits once a second, and notes that those who do not answer were without it. The master's
/// time may be off by 2 s in between.
pub async fn follow<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
    answers: impl Fn(usize) -> bool,
) {
    if port.now_ms().wrapping_sub(clocks.read_ms) < FOLLOW_PERIOD_MS {
        return;
    }
    if let Some(station) = reference_of(stations, clocks, &answers)
        && let Ok(bytes) = port.read(station, register::DC_SYSTEM_TIME, 4).await
    {
        clocks.extended_ns(read_u32(&bytes, 0).into(), port.now_ms());
        for position in (0..clocks.slaves.len()).filter(|position| !answers(*position)) {
            clocks.was_alone(position);
        }
    }
}

/// Gives the bus a distributor when no clock that answers has the time of the bus any more: the first of the chain that had it and
/// has run alone since, if its own is still about that time. Those that are looked at lose the correction that they were given
/// last: without a reference they would keep up to 10 % for ever. One that is too far from the time is not looked at again. Returns
/// whether there is a distributor now.
pub async fn find_source<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
    answers: impl Fn(usize) -> bool,
) -> bool {
    let mut tried = SlaveSet::NONE;
    let may_be = |clocks: &BusClocks<SLAVES>, tried: SlaveSet, position: usize| {
        clocks.astray.contains(position) && !tried.contains(position) && answers(position)
    };
    while let Some(position) = clocks.first(|position, _| may_be(clocks, tried, position)) {
        tried |= SlaveSet::of(position);
        if let Some(station) = stations.get(position)
            && restart_loop(port, *station).await.is_ok()
            && let Ok(bytes) = port.read(*station, register::DC_SYSTEM_TIME, 4).await
        {
            if clocks.may_be_the_time(read_u32(&bytes, 0), port.now_ms()) {
                clocks.found_in_time(position);
                return true;
            }
            clocks.astray = clocks.astray.without(SlaveSet::of(position));
        }
    }
    false
}
