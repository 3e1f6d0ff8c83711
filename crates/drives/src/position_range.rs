//! Range of a drive's position: all 32 bits, or one or more motor turns after which the positions repeat.
//!
//! Invariant: a range is a whole number of motor turns, so that turns are counted alike on both sides of its ends.

use etherpen_ethercat::error::BusError;

/// First position of a drive and number of positions until they repeat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PositionRange {
    first: i32,
    /// 0 if the positions wrap at 32 bits.
    length: i32,
}

impl PositionRange {
    /// Positions that wrap at 32 bits.
    pub const WHOLE: Self = Self { first: 0, length: 0 };

    /// The range that a drive tells in object 0x607B (CiA 402, position range limit): its first and last position. A last
    /// position that is not above the first, as two zeros, tells none. A range of more than 2^31 - 1 positions counts as
    /// [`Self::WHOLE`]: no axis comes to its ends.
    ///
    /// # Errors
    /// [`BusError::PositionRange`] when the range is not a whole number of motor turns.
    pub fn told(first: i32, last: i32, increments_per_revolution: u32) -> Result<Self, BusError> {
        let length = i64::from(last) - i64::from(first) + 1;
        let Some(length) = i32::try_from(length).ok().filter(|length| *length > 1) else {
            return Ok(Self::WHOLE);
        };
        let (expected, actual) = (increments_per_revolution, length.unsigned_abs());
        match expected > 0 && actual.is_multiple_of(expected) {
            true => Ok(Self { first, length }),
            false => Err(BusError::PositionRange { expected, actual }),
        }
    }

    /// A difference of two positions in the range, the shorter way round.
    #[inline]
    pub const fn nearest(&self, difference: i32) -> i32 {
        let half = self.length / 2;
        if self.length > 0 && difference >= half {
            difference.wrapping_sub(self.length)
        } else if self.length > 0 && difference < -half {
            difference.wrapping_add(self.length)
        } else {
            difference
        }
    }

    /// A position that is less than a range away from it, in the range.
    #[inline]
    pub const fn fold(&self, position: i32) -> i32 {
        if self.length == 0 {
            position
        } else if position.wrapping_sub(self.first) < 0 {
            position.wrapping_add(self.length)
        } else if position.wrapping_sub(self.first) >= self.length {
            position.wrapping_sub(self.length)
        } else {
            position
        }
    }

    /// Largest step of a target that goes the way that is meant.
    #[inline]
    pub const fn step_max(&self) -> i32 {
        match self.length {
            0 => i32::MAX,
            length => (length - 1) / 2,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_repeat_after_whole_turns_and_differences_go_the_shorter_way() {
        let turn = PositionRange::told(0, 999, 1_000).unwrap();
        for (difference, nearest) in [(0, 0), (499, 499), (500, -500), (-500, -500), (-501, 499), (990, -10)] {
            assert_eq!(turn.nearest(difference), nearest);
        }
        assert_eq!([-1, 0, 999, 1_000].map(|at| turn.fold(at)), [999, 0, 999, 0]);
        let around = PositionRange::told(-2_000, 1_999, 1_000).unwrap();
        assert_eq!(
            [-2_001, -2_000, 2_000].map(|at| around.fold(at)),
            [1_999, -2_000, -2_000]
        );
        assert_eq!(around.nearest(3_999), -1);
    }

    #[test]
    fn a_drive_that_tells_no_range_or_a_great_one_wraps_at_32_bits() {
        for (first, last) in [(0, 0), (5, 5), (7, -7), (i32::MIN, i32::MAX), (-i32::MAX, i32::MAX)] {
            assert_eq!(
                PositionRange::told(first, last, 1_000),
                Ok(PositionRange::WHOLE),
                "{first} to {last}"
            );
        }
        let whole = PositionRange::WHOLE;
        assert_eq!((whole.nearest(i32::MIN), whole.fold(i32::MIN)), (i32::MIN, i32::MIN));
    }

    #[test]
    fn a_range_that_is_no_whole_number_of_turns_is_refused_with_both_numbers() {
        let refused = PositionRange::told(0, 1_000, 1_000);
        assert_eq!(
            refused,
            Err(BusError::PositionRange {
                expected: 1_000,
                actual: 1_001
            })
        );
        assert!(PositionRange::told(0, 999, 0).is_err());
    }
}
