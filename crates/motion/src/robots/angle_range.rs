//! Ranges of angles that are compared without trigonometry.

/// A range of angles less than a full turn: an angle is inside if it is within half the width of the middle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AngleRange {
    /// Cosine and sine of the middle.
    middle: (f64, f64),
    cosine_half: f64,
}

impl AngleRange {
    /// Placeholder for a range that is not known yet.
    pub(crate) const NONE: Self = Self {
        middle: (0.0, 0.0),
        cosine_half: 0.0,
    };

    /// The range from `low_rad` to `high_rad`.
    pub(crate) fn new([low_rad, high_rad]: [f64; 2]) -> Self {
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
