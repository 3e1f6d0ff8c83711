//! Commands that are not answered yet.

use std::collections::VecDeque;

/// Time after which a command without an answer counts as accepted, ms: the answer was lost.
const ANSWER_MAX_MS: u64 = 1_000;

/// A command: when it was asked for, ms, and its number among all commands.
#[derive(Clone, Copy, Debug)]
struct Asked {
    at_ms: u64,
    number: u64,
}

/// Commands of one kind that are not answered yet, the oldest one first.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pending(VecDeque<Asked>);

impl Pending {
    pub(crate) fn ask(&mut self, at_ms: u64, number: u64) {
        self.0.push_back(Asked { at_ms, number });
    }

    /// Takes an answer; returns the number of the command that it answers, at least, if there was one. If earlier answers were
    /// lost, it answers a later one.
    pub(crate) fn answer(&mut self) -> Option<u64> {
        self.0.pop_front().map(|asked| asked.number)
    }

    pub(crate) fn forget(&mut self) {
        self.0.clear();
    }

    /// Forgets what was asked for before a command of another kind: its answer shows that these have been decided on.
    pub(crate) fn forget_before(&mut self, number: u64) {
        self.0.retain(|asked| asked.number > number);
    }

    pub(crate) fn is_waiting(&self) -> bool {
        !self.0.is_empty()
    }

    /// Takes the answer that was lost: whether the commands have waited so long that they count as accepted.
    pub(crate) fn take_lost(&mut self, now_ms: u64) -> bool {
        let last = self.0.back();
        let is_lost = last.is_some_and(|asked| now_ms.saturating_sub(asked.at_ms) > ANSWER_MAX_MS);
        if is_lost {
            self.forget();
        }
        is_lost
    }
}
