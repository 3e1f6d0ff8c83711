//! What a critical task may note in passing, and the log lines that a slow task makes of it.
//!
//! Everything noted is a plain atomic. The log is written by the task that polls the PHY; nothing is logged while nothing
//! changes but the load, once a second.

use crate::timer::{PERIOD_COUNTS, free_run};
use crate::{eth, serial};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Releases of the trajectory task that it has not completed.
static TRAJECTORIES_DUE: AtomicU32 = AtomicU32::new(0);
/// Releases of the trajectory task that found it still running or waiting.
static TRAJECTORY_OVERRUNS: AtomicU32 = AtomicU32::new(0);
/// Periods in which no sample ran.
static PERIODS_MISSED: AtomicU32 = AtomicU32::new(0);

static ASLEEP: AtomicBool = AtomicBool::new(false);
static SLEPT_AT: AtomicU32 = AtomicU32::new(0);
static SLEPT_COUNTS: AtomicU32 = AtomicU32::new(0);
/// Counts that tasks between the critical ones and the trajectory have run for, without those that preempted them.
static URGENT_COUNTS: AtomicU32 = AtomicU32::new(0);

/// Steps of [`Health::step`], 1 ms each, between two reports of the load.
const REPORT_PERIOD_STEPS: u32 = 1_000;
const PER_MILLE: u64 = 1_000;

/// Sleeps until the next interrupt; for the idle task only.
pub(crate) fn sleep() {
    SLEPT_AT.store(free_run(), Ordering::Relaxed);
    ASLEEP.store(true, Ordering::Relaxed);
    cortex_m::asm::wfi();
}

/// Notes that the core is awake; the first thing in every task that the hardware releases.
pub(crate) fn woke() {
    if ASLEEP.load(Ordering::Relaxed) {
        ASLEEP.store(false, Ordering::Relaxed);
        let slept = free_run().wrapping_sub(SLEPT_AT.load(Ordering::Relaxed));
        let total = SLEPT_COUNTS.load(Ordering::Relaxed).wrapping_add(slept);
        SLEPT_COUNTS.store(total, Ordering::Relaxed);
    }
}

/// Counts of the free-running timer slept since the start, wrapping.
pub(crate) fn slept_counts() -> u32 {
    SLEPT_COUNTS.load(Ordering::Relaxed)
}

/// Runs a task's body whose priority lies between the critical tasks' and the trajectory's, and counts how long it takes
/// itself: `critical_counts` says how long critical tasks have run.
pub(crate) fn urgent(critical_counts: impl Fn() -> u32, body: impl FnOnce()) {
    let (began_at, before) = (free_run(), critical_counts());
    body();
    let preempted = critical_counts().wrapping_sub(before);
    let taken = free_run().wrapping_sub(began_at).wrapping_sub(preempted);
    let total = URGENT_COUNTS.load(Ordering::Relaxed).wrapping_add(taken);
    URGENT_COUNTS.store(total, Ordering::Relaxed);
}

/// Counts of [`urgent`] since the start, wrapping.
pub(crate) fn urgent_counts() -> u32 {
    URGENT_COUNTS.load(Ordering::Relaxed)
}

/// Counts periods between two runs of the sample task in which it did not run.
pub(crate) struct Periods {
    last: Option<u32>,
}

impl Periods {
    pub(crate) const fn new() -> Self {
        Periods { last: None }
    }

    /// Call at each release of the sample; gives the periods missed since the start.
    pub(crate) fn released(&mut self) -> u32 {
        let now = free_run();
        if let Some(last) = self.last.replace(now) {
            let periods = (now.wrapping_sub(last) + PERIOD_COUNTS / 2) / PERIOD_COUNTS;
            PERIODS_MISSED.fetch_add(periods.saturating_sub(1), Ordering::Relaxed);
        }
        PERIODS_MISSED.load(Ordering::Relaxed)
    }
}

/// Notes a release of the trajectory task.
pub(crate) fn trajectory_released() {
    TRAJECTORIES_DUE.fetch_add(1, Ordering::Relaxed);
}

/// Runs the trajectory task's body and counts the releases that came while an earlier one was due.
pub(crate) fn trajectory_runs(body: impl FnOnce()) {
    let due = TRAJECTORIES_DUE.load(Ordering::Relaxed);
    body();
    let before = TRAJECTORIES_DUE.fetch_sub(due, Ordering::Relaxed);
    TRAJECTORY_OVERRUNS.fetch_add(before.saturating_sub(1), Ordering::Relaxed);
}

/// What was counted, in the order of the log line.
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

/// What the last report left behind.
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
        let (now, slept) = (free_run(), SLEPT_COUNTS.load(Ordering::Relaxed));
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
