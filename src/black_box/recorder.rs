//! The recorder: a task below the critical ones that takes the sampler's reports on their way to the link task.

use super::frames::{FrameRing, FrameSource};
use super::memory::{Memory, State};
use super::sample::Sample;
use crate::control::sampler::CycleReport;
use crate::drives::cia402::{DriveState, StatusWord};
use crate::ethercat::queue;
use heapless::spsc::{Consumer, Producer};

/// How long the recording of a run that was reset from outside is kept, ms: a firmware that crashes before a drive is
/// enabled has to be recorded, too.
const KEPT_AFTER_RESET_MS: u32 = 120_000;

/// Records each millisecond and hands its report on.
pub struct Recorder<'a> {
    memory: &'a Memory,
    reports: Consumer<'a, CycleReport>,
    passed_on: Producer<'a, CycleReport>,
    frames: FrameRing,
    /// Reports that found no room behind the recorder.
    dropped: u32,
    /// The last report's millisecond.
    cycle: u32,
    /// Milliseconds for which an earlier recording was kept.
    kept_ms: u32,
}

impl<'a> Recorder<'a> {
    /// A recorder between the sampler's reports and the link task.
    pub const fn new(
        memory: &'a Memory,
        reports: Consumer<'a, CycleReport>,
        passed_on: Producer<'a, CycleReport>,
    ) -> Self {
        Self {
            memory,
            reports,
            passed_on,
            frames: FrameRing::new(),
            dropped: 0,
            cycle: 0,
            kept_ms: 0,
        }
    }

    /// Takes all reports and frames that have come. Call it once a millisecond.
    pub fn tick(&mut self, frames: &impl FrameSource) {
        if self.memory.is_to_be_discarded() {
            self.memory.clear();
        }
        let takes = self.memory.takes();
        while let Some(mut report) = queue::take(&mut self.reports) {
            self.cycle = report.cycle;
            if takes {
                self.memory.put_sample(&Sample::of(&report).to_words());
            } else {
                self.step_aside(&report);
            }
            report.counters.reports_dropped = report.counters.reports_dropped.wrapping_add(self.dropped);
            if !queue::put_copy(&mut self.passed_on, &report) {
                self.dropped = self.dropped.wrapping_add(1);
            }
        }
        if takes {
            self.frames.take(self.memory, frames, self.cycle);
        } else {
            self.frames.skip(frames);
        }
    }

    /// A millisecond that is not recorded: ends what keeps the recorder from it.
    fn step_aside(&mut self, report: &CycleReport) {
        self.memory.shorten_pause();
        self.kept_ms = self.kept_ms.saturating_add(1);
        let is_enabled = |word: &u16| StatusWord(*word).state() == DriveState::OperationEnabled;
        let is_over = self.kept_ms >= KEPT_AFTER_RESET_MS || report.status_word.iter().any(is_enabled);
        if is_over && !self.memory.is_read() && self.memory.state() == Some(State::KeptAfterReset) {
            self.memory.clear();
        }
    }
}
