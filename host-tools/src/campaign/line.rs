//! The serial line between the operator's program and the board: whole, noisy or unplugged.

use super::chance::Chance;

/// The line.
pub(super) struct Line {
    chance: Chance,
    unplugged_until_ms: u32,
    noisy_until_ms: u32,
    /// Bytes of a thousand that are damaged or lost while the line is noisy.
    per_mille: u32,
}

impl Line {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            chance: Chance::new(seed ^ 0x11E),
            unplugged_until_ms: 0,
            noisy_until_ms: 0,
            per_mille: 0,
        }
    }

    pub(super) fn unplug(&mut self, until_ms: u32) {
        self.unplugged_until_ms = self.unplugged_until_ms.max(until_ms);
    }

    pub(super) fn disturb(&mut self, until_ms: u32, per_mille: u32) {
        (self.noisy_until_ms, self.per_mille) = (until_ms, per_mille.min(1_000));
    }

    /// Ends all faults of the line.
    pub(super) fn heal(&mut self) {
        (self.unplugged_until_ms, self.noisy_until_ms) = (0, 0);
    }

    /// What arrives of these bytes.
    pub(super) fn carry(&mut self, ms: u32, bytes: &mut Vec<u8>) {
        if ms < self.unplugged_until_ms {
            bytes.clear();
        }
        if ms >= self.noisy_until_ms || bytes.is_empty() {
            return;
        }
        let (chance, per_mille) = (&mut self.chance, u64::from(self.per_mille));
        bytes.retain_mut(|byte| {
            if chance.below(1_000) >= per_mille {
                return true;
            }
            *byte ^= 1 << chance.below(8);
            !chance.one_in(3)
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_carries_damages_or_loses() {
        let mut line = Line::new(1);
        let carried = |line: &mut Line, ms| {
            let mut bytes = vec![7; 1_000];
            line.carry(ms, &mut bytes);
            bytes
        };
        assert_eq!(carried(&mut line, 1), vec![7; 1_000]);
        line.disturb(10, 100);
        let noisy = carried(&mut line, 2);
        assert!((930..1_000).contains(&noisy.len()), "{}", noisy.len());
        let damaged = noisy.iter().filter(|byte| **byte != 7).count();
        assert!((30..150).contains(&damaged), "{damaged}");
        assert_eq!(carried(&mut line, 10), vec![7; 1_000], "the noise has ended");
        line.unplug(20);
        assert!(carried(&mut line, 11).is_empty());
        line.heal();
        assert_eq!(carried(&mut line, 12), vec![7; 1_000]);
    }
}
