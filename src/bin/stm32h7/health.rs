//! Counters that critical tasks may update, and the log lines that a slow task makes from them.
//!
//! All counters are plain atomics. The task that polls the PHY writes the log; while nothing changes, only the load is
//! logged, once a second.

use super::timer::{PERIOD_COUNTS, free_run};
use super::{eth, serial};
use crate::shared::load;
use crate::shared::overruns::TRAJECTORY_OVERRUNS;
use core::sync::atomic::{AtomicU32, Ordering};

/// Periods in which no sample ran.
static PERIODS_MISSED: AtomicU32 = AtomicU32::new(0);

/// Steps of [`Health::step`], 1 ms each, between two reports of the load.
const REPORT_PERIOD_STEPS: u32 = 1_000;
const PER_MILLE: u64 = 1_000;

/// Counts periods between two runs of the sample task in which it did not run.
pub(crate) struct Periods {
    last: Option<u32>,
}

impl Periods {
    pub(crate) const fn new() -> Self {
        Periods { last: None }
    }

    /// Counts the release; call it at each release of the sample. Returns the periods missed since start-up.
    pub(crate) fn released(&mut self) -> u32 {
        let now = free_run();
        if let Some(last) = self.last.replace(now) {
            let periods = (now.wrapping_sub(last) + PERIOD_COUNTS / 2) / PERIOD_COUNTS;
            PERIODS_MISSED.fetch_add(periods.saturating_sub(1), Ordering::Relaxed);
        }
        PERIODS_MISSED.load(Ordering::Relaxed)
    }
}

/// The counts in the order of the log line.
type Counts = [u32; 6];

fn counts() -> Counts {
    [
        &PERIODS_MISSED,
        &TRAJECTORY_OVERRUNS,
        &eth::FRAMES_DROPPED,
        &eth::RING_EXHAUSTED,
        &eth::BUS_ERRORS,
        &serial::BYTES_LOST,
    ]
    .map(|counter| counter.load(Ordering::Relaxed))
}

/// Counters of the last report.
pub(crate) struct Health {
    counts: Counts,
    steps: u32,
    reported_at: u32,
    slept_counts: u32,
}

impl Health {
    pub(crate) const fn new() -> Self {
        Health {
            counts: [0; 6],
            steps: 0,
            reported_at: 0,
            slept_counts: 0,
        }
    }

    /// Once a second: the load, and the counts if one has grown.
    pub(crate) fn step(&mut self) {
        self.steps += 1;
        if self.steps < REPORT_PERIOD_STEPS {
            return;
        }
        self.steps = 0;
        let (now, slept) = (free_run(), load::slept_counts());
        let passed = u64::from(now.wrapping_sub(self.reported_at)).max(1);
        let idle = u64::from(slept.wrapping_sub(self.slept_counts)).min(passed);
        (self.reported_at, self.slept_counts) = (now, slept);
        let busy = PER_MILLE - idle * PER_MILLE / passed;
        defmt::debug!("load {=u64} per mille", busy);
        let counts = counts();
        if counts != self.counts {
            self.counts = counts;
            let [periods, overruns, dropped, exhausted, bus, bytes] = counts;
            defmt::error!(
                "{=u32} periods without a sample, {=u32} trajectory overruns",
                periods,
                overruns
            );
            defmt::error!(
                "{=u32} frames dropped, ring full {=u32} times, {=u32} bus errors",
                dropped,
                exhausted,
                bus
            );
            defmt::error!("{=u32} bytes lost on the serial line", bytes);
        }
    }
}
