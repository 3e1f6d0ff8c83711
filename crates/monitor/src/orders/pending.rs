//! Commands that are not answered yet.

/// Time after which a command without an answer counts as accepted, ms: the answer was lost.
const ANSWER_MAX_MS: u64 = 1_000;

/// Commands of one kind that are not answered yet.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pending {
    count: u32,
    since_ms: u64,
}

impl Pending {
    pub(crate) fn ask(&mut self, now_ms: u64) {
        self.count = self.count.saturating_add(1);
        self.since_ms = now_ms;
    }

    /// Takes an answer; returns whether there was a command to answer.
    pub(crate) fn answer(&mut self) -> bool {
        let was_asked = self.count > 0;
        self.count = self.count.saturating_sub(1);
        was_asked
    }

    pub(crate) fn forget(&mut self) {
        self.count = 0;
    }

    /// Forgets these commands if all of them came before those of another kind: the answer to one of those shows that these have
    /// been decided on.
    pub(crate) fn forget_before(&mut self, others: Self) {
        if self.since_ms < others.since_ms {
            self.forget();
        }
    }

    pub(crate) fn is_waiting(self) -> bool {
        self.count > 0
    }

    /// Takes the answer that was lost: whether the commands have waited so long that they count as accepted.
    pub(crate) fn take_lost(&mut self, now_ms: u64) -> bool {
        let is_lost = self.count > 0 && now_ms.saturating_sub(self.since_ms) > ANSWER_MAX_MS;
        if is_lost {
            self.count = 0;
        }
        is_lost
    }
}
