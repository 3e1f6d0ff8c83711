//! The kinds of robots by name.

use super::AXES;
use serde::{Deserialize, Serialize};

/// A kind of robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A delta robot.
    #[default]
    Delta,
    /// A gantry: three linear axes at right angles.
    Gantry,
    /// Two crossed belts for x and y, and a linear axis for z.
    #[serde(rename = "corexy")]
    CoreXy,
    /// A SCARA: two links that turn in the horizontal plane, and a linear axis for z.
    Scara,
    /// A linear delta.
    LinearDelta,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 5] = [Self::Delta, Self::Gantry, Self::CoreXy, Self::Scara, Self::LinearDelta];

    /// The name in configuration files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Delta => "delta",
            Self::Gantry => "gantry",
            Self::CoreXy => "corexy",
            Self::Scara => "scara",
            Self::LinearDelta => "linear-delta",
        }
    }

    /// The kind of this name, see [`Self::name`].
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Which axes are linear.
    #[must_use]
    pub fn linear_axes(self) -> [bool; AXES] {
        match self {
            Self::Delta => [false; AXES],
            Self::Scara => [false, false, true, false],
            Self::Gantry | Self::CoreXy | Self::LinearDelta => [true, true, true, false],
        }
    }

    /// How many of the first axes move the tool in two directions at once, each alone.
    #[must_use]
    pub fn coupled_axes(self) -> usize {
        match self {
            Self::CoreXy => 2,
            Self::Delta | Self::Gantry | Self::Scara | Self::LinearDelta => 0,
        }
    }

    /// Positions of what can be led to a switch by itself, from those of the joints, rad: of the joints themselves, and for
    /// coupled axes of the slides that they move together.
    #[must_use]
    pub fn slides(self, joints: [f64; AXES]) -> [f64; AXES] {
        let [a, b, third, fourth] = joints;
        match self.coupled_axes() {
            0 => joints,
            _ => [0.5 * (a + b), 0.5 * (a - b), third, fourth],
        }
    }

    /// Positions of the joints, from those of the slides, rad: the inverse of [`Self::slides`]. Also for speeds.
    #[must_use]
    pub fn joints(self, slides: [f64; AXES]) -> [f64; AXES] {
        let [x, y, third, fourth] = slides;
        match self.coupled_axes() {
            0 => slides,
            _ => [x + y, x - y, third, fourth],
        }
    }

    /// Whether the third main axis is the tool's height, and moves nothing else.
    #[must_use]
    pub fn has_height_axis(self) -> bool {
        match self {
            Self::Gantry | Self::CoreXy | Self::Scara => true,
            Self::Delta | Self::LinearDelta => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The kind behind another one, in the order of the messages.
    fn next(kind: Kind) -> Option<Kind> {
        match kind {
            Kind::Delta => Some(Kind::Gantry),
            Kind::Gantry => Some(Kind::CoreXy),
            Kind::CoreXy => Some(Kind::Scara),
            Kind::Scara => Some(Kind::LinearDelta),
            Kind::LinearDelta => None,
        }
    }

    #[test]
    fn the_list_has_every_kind_in_the_order_of_the_messages() {
        assert!(core::iter::successors(Some(Kind::Delta), |kind| next(*kind)).eq(Kind::ALL));
        for (number, kind) in Kind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, number);
            assert_eq!(Kind::named(kind.name()), Some(kind));
        }
    }
}
