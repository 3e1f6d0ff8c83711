//! Health report, once a second in the log: load, missed periods, overruns.

use super::timer::PERIOD_COUNTS;
use crate::shared::load;
use crate::shared::overruns::TRAJECTORY_OVERRUNS;
use core::sync::atomic::{AtomicU32, Ordering};

const REPORT_PERIOD_MS: u32 = 1000;
const REPORT_COUNTS: u32 = PERIOD_COUNTS * REPORT_PERIOD_MS;
const PER_MILLE: u64 = 1000;

/// Periods in which the sample timer did not release.
pub(crate) static PERIODS_MISSED: AtomicU32 = AtomicU32::new(0);
/// Frames that were damaged or not sent.
pub(crate) static FRAMES_FAILED: AtomicU32 = AtomicU32::new(0);

/// Counters of the last report.
pub(crate) struct Health {
    next_ms: u32,
    slept_counts: u32,
    missed: u32,
    overruns: u32,
    failed: u32,
}

impl Health {
    pub(crate) const fn new() -> Self {
        Self {
            next_ms: REPORT_PERIOD_MS,
            slept_counts: 0,
            missed: 0,
            overruns: 0,
            failed: 0,
        }
    }

    /// Call it every millisecond.
    pub(crate) fn tick(&mut self, ms: u32) {
        if ms < self.next_ms {
            return;
        }
        self.next_ms = ms.saturating_add(REPORT_PERIOD_MS);
        let slept = load::slept_counts();
        let idle = u64::from(slept.wrapping_sub(self.slept_counts));
        self.slept_counts = slept;
        let busy = PER_MILLE.saturating_sub(idle * PER_MILLE / u64::from(REPORT_COUNTS)) as u32;
        defmt::debug!("load {=u32} per mille", busy);
        self.report_growth();
    }

    fn report_growth(&mut self) {
        let missed = PERIODS_MISSED.load(Ordering::Relaxed);
        if missed != self.missed {
            defmt::error!("{=u32} periods without a sample", missed);
            self.missed = missed;
        }
        let overruns = TRAJECTORY_OVERRUNS.load(Ordering::Relaxed);
        if overruns != self.overruns {
            defmt::error!("trajectory released {=u32} times before it was done", overruns);
            self.overruns = overruns;
        }
        let failed = FRAMES_FAILED.load(Ordering::Relaxed);
        if failed != self.failed {
            defmt::error!("{=u32} frames damaged or not sent", failed);
            self.failed = failed;
        }
    }
}
