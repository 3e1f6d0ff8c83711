//! Ranges of the main axes, in the two forms that kinds of robots check without trigonometry.

use super::MAIN_AXES;

/// Ranges of all main axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct JointRanges {
    /// Lowest and highest angle, rad: for joints whose angle is known without trigonometry, of any number of turns.
    pub(crate) rad: [[f64; 2]; MAIN_AXES],
    /// For joints of which the cosine and sine are known. Without meaning where a range is a full turn or more.
    pub(crate) turned: [AngleRange; MAIN_AXES],
}

impl JointRanges {
    /// Placeholder for ranges that are not known yet.
    pub(crate) const NONE: Self = Self {
        rad: [[0.0; 2]; MAIN_AXES],
        turned: [AngleRange::NONE; MAIN_AXES],
    };

    /// The ranges from the lowest to the highest angle of each main axis, rad.
    pub(crate) fn new(ranges_rad: [[f64; 2]; MAIN_AXES]) -> Self {
        Self {
            rad: ranges_rad,
            turned: ranges_rad.map(AngleRange::new),
        }
    }
}

/// A range of angles less than a full turn: an angle is inside if it is within half the width of the middle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AngleRange {
    /// Cosine and sine of the middle.
    middle: (f64, f64),
    cosine_half: f64,
}

impl AngleRange {
    /// Placeholder for a range that is not known yet.
    const NONE: Self = Self {
        middle: (0.0, 0.0),
        cosine_half: 0.0,
    };

    /// The range from `low_rad` to `high_rad`.
    fn new([low_rad, high_rad]: [f64; 2]) -> Self {
        let middle = 0.5 * (low_rad + high_rad);
        Self {
            middle: (libm::cos(middle), libm::sin(middle)),
            cosine_half: libm::cos(0.5 * (high_rad - low_rad)),
        }
    }

    /// Whether the angle of this cosine and sine is inside.
    #[inline]
    pub(crate) fn contains(&self, cosine: f64, sine: f64) -> bool {
        cosine * self.middle.0 + sine * self.middle.1 >= self.cosine_half
    }
}
