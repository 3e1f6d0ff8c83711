//! The override of the path's speed.

use std::collections::VecDeque;

/// The override at the start, percent.
const PERCENT: u8 = 100;
/// Most overrides without an answer that are remembered; of more, the largest of the oldest.
const ASKED_MAX: usize = 256;

/// The override of the path's speed, percent: the present one, and others that may be in effect.
#[derive(Clone, Debug)]
pub(crate) struct Override {
    present: u8,
    /// Those that are not answered, in order. Each may be in effect, until one that was asked for after it is.
    asked: VecDeque<u8>,
    /// The one before, and until when the path may be that fast, ms.
    before: (u8, u64),
}

impl Default for Override {
    fn default() -> Self {
        Self {
            present: PERCENT,
            asked: VecDeque::new(),
            before: (0, 0),
        }
    }
}

impl Override {
    pub(crate) fn ask(&mut self, percent: u8) {
        if !(10..=200).contains(&percent) {
            return;
        }
        self.asked.push_back(percent);
        if self.asked.len() > ASKED_MAX
            && let Some(oldest) = self.asked.pop_front()
            && let Some(next) = self.asked.front_mut()
        {
            *next = oldest.max(*next);
        }
    }

    /// Notes that an override was refused. Others whose answer is not there yet, or was lost, may be in effect.
    pub(crate) fn refuse(&mut self, percent: u8) {
        if let Some(place) = self.asked.iter().position(|asked| *asked == percent) {
            self.asked.remove(place);
        }
    }

    /// Takes an override that was accepted; the path has slowed down to it at `until_ms`.
    pub(crate) fn accept(&mut self, percent: u8, now_ms: u64, until_ms: u64) {
        self.before = (self.largest(now_ms), until_ms);
        self.present = percent;
        let answered = self.asked.iter().position(|asked| *asked == percent);
        self.asked.drain(..answered.map_or(self.asked.len(), |place| place + 1));
    }

    /// Begins anew after a restart.
    pub(crate) fn restart(&mut self, now_ms: u64, until_ms: u64) {
        self.accept(PERCENT, now_ms, until_ms);
        self.asked.clear();
    }

    /// The largest override that may be in effect, percent.
    pub(crate) fn largest(&self, now_ms: u64) -> u8 {
        let (before, until_ms) = self.before;
        let before = if now_ms <= until_ms { before } else { 0 };
        let asked = self.asked.iter().copied().max().unwrap_or(0);
        self.present.max(before).max(asked)
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

    #[test]
    fn one_that_was_asked_for_after_another_may_be_in_effect_when_that_one_is_answered() {
        let mut speed = Override::default();
        for percent in [122, 36, 85] {
            speed.ask(percent);
        }
        speed.accept(36, 10, 20);
        // The answer to the first may have been lost, but the second came after it.
        assert_eq!((speed.largest(20), speed.largest(21)), (122, 85));
        speed.ask(36);
        speed.accept(85, 30, 40);
        speed.accept(36, 31, 41);
        assert_eq!((speed.largest(41), speed.largest(42)), (85, 36));
    }

    #[test]
    fn thousands_without_an_answer_need_no_more_memory_and_the_largest_is_not_forgotten() {
        let mut speed = Override::default();
        speed.ask(180);
        for _ in 0..10_000 {
            speed.ask(20);
        }
        assert_eq!((speed.largest(0), speed.asked.len()), (180, ASKED_MAX));
    }
}
