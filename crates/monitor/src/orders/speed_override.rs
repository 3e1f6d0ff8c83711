//! The override of the path's speed.

/// The override at the start, percent.
const PERCENT: u8 = 100;

/// The override of the path's speed, percent: the present one, and others that may be in effect.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Override {
    present: u8,
    /// The largest one that is not answered.
    asked: u8,
    /// The one before, and until when the path may be that fast, ms.
    before: (u8, u64),
}

impl Default for Override {
    fn default() -> Self {
        Self {
            present: PERCENT,
            asked: 0,
            before: (0, 0),
        }
    }
}

impl Override {
    pub(crate) fn ask(&mut self, percent: u8) {
        if (10..=200).contains(&percent) {
            self.asked = self.asked.max(percent);
        }
    }

    /// Notes that an override was refused. Others whose answer is not there yet, or was lost, may be in effect.
    pub(crate) fn refuse(&mut self, percent: u8) {
        if percent == self.asked {
            self.asked = 0;
        }
    }

    /// Takes an override that was accepted; the path has slowed down to it at `until_ms`.
    pub(crate) fn accept(&mut self, percent: u8, now_ms: u64, until_ms: u64) {
        *self = Self {
            present: percent,
            asked: 0,
            before: (self.largest(now_ms), until_ms),
        };
    }

    /// Begins anew after a restart.
    pub(crate) fn restart(&mut self, now_ms: u64, until_ms: u64) {
        self.accept(PERCENT, now_ms, until_ms);
    }

    /// The largest override that may be in effect, percent.
    pub(crate) fn largest(&self, now_ms: u64) -> u8 {
        let (before, until_ms) = self.before;
        let before = if now_ms <= until_ms { before } else { 0 };
        self.present.max(before).max(self.asked)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_override_without_an_answer_may_be_in_effect_until_a_later_one_is() {
        let mut speed = Override::default();
        speed.ask(165);
        speed.ask(3);
        speed.refuse(3);
        assert_eq!(speed.largest(0), 165);
        speed.accept(50, 10, 20);
        assert_eq!((speed.largest(20), speed.largest(21)), (165, 50));
        speed.ask(120);
        speed.refuse(120);
        assert_eq!(speed.largest(21), 50);
    }
}
