//! The space that a machine's tool may use.

use serde::{Deserialize, Serialize};

/// The space the tool may use: what is common to an upright ring around the frame's z axis, a box, and the space between
/// two heights. A border that a machine does not need is left at its default, which no machine reaches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorkVolume {
    /// Outer radius of the ring, mm.
    pub radius_mm: f64,
    /// Inner radius of the ring, mm; 0 for a cylinder.
    pub inner_radius_mm: f64,
    /// Lowest and highest x of the box, mm.
    pub x_mm: [f64; 2],
    /// Lowest and highest y of the box, mm.
    pub y_mm: [f64; 2],
    /// Lowest z, mm.
    pub z_low_mm: f64,
    /// Highest z, mm.
    pub z_high_mm: f64,
}

impl Default for WorkVolume {
    fn default() -> Self {
        Self {
            radius_mm: 565.0,
            z_low_mm: -960.0,
            z_high_mm: -700.0,
            ..Self::ENDLESS
        }
    }
}

impl WorkVolume {
    /// Farthest border that a configuration may have, mm.
    pub const BORDER_MAX_MM: f64 = 10_000.0;

    /// The volume with all borders where no machine reaches them.
    pub const ENDLESS: Self = Self {
        radius_mm: Self::BORDER_MAX_MM,
        inner_radius_mm: 0.0,
        x_mm: [-Self::BORDER_MAX_MM, Self::BORDER_MAX_MM],
        y_mm: [-Self::BORDER_MAX_MM, Self::BORDER_MAX_MM],
        z_low_mm: -Self::BORDER_MAX_MM,
        z_high_mm: Self::BORDER_MAX_MM,
    };

    /// A box: lowest and highest x, y and z, mm.
    #[must_use]
    pub fn of_box([x_mm, y_mm, [z_low_mm, z_high_mm]]: [[f64; 2]; 3]) -> Self {
        let farthest = |[low, high]: [f64; 2]| low.abs().max(high.abs());
        Self {
            radius_mm: libm::hypot(farthest(x_mm), farthest(y_mm)),
            x_mm,
            y_mm,
            z_low_mm,
            z_high_mm,
            ..Self::ENDLESS
        }
    }

    /// What is common to two volumes.
    #[must_use]
    pub fn common(&self, other: &Self) -> Self {
        let both = |[a_low, a_high]: [f64; 2], [b_low, b_high]: [f64; 2]| [a_low.max(b_low), a_high.min(b_high)];
        let [z_low_mm, z_high_mm] = both([self.z_low_mm, self.z_high_mm], [other.z_low_mm, other.z_high_mm]);
        Self {
            radius_mm: self.radius_mm.min(other.radius_mm),
            inner_radius_mm: self.inner_radius_mm.max(other.inner_radius_mm),
            x_mm: both(self.x_mm, other.x_mm),
            y_mm: both(self.y_mm, other.y_mm),
            z_low_mm,
            z_high_mm,
        }
    }
}
