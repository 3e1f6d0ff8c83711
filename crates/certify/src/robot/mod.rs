//! Robots: how the joints move when the tool moves along a curve.
//!
//! Every kind of robot is a file here. The arithmetic is this crate's own and works on series, which include all
//! derivatives.
//!
//! Lengths are millimetres, angles radians; the joint of a linear axis is its pulley or screw. z points up.

mod corexy;
mod delta;
mod gantry;
mod linear_delta;
mod scara;

pub use corexy::CoreXy;
pub use delta::{Delta, DeltaDimensions};
pub use gantry::Gantry;
pub use linear_delta::{LinearDelta, LinearDeltaDimensions};
pub use scara::{Scara, ScaraDimensions};

use crate::angle::{of_unit, turn};
use crate::interval::Interval;
use crate::series::{Series, Series3};

/// Number of axes that place the tool; they are the first of a robot's axes.
pub const MAIN_AXES: usize = 3;

/// A robot of known dimensions.
#[derive(Clone, Debug)]
pub enum Robot {
    /// A delta robot.
    Delta(Delta),
    /// A gantry.
    Gantry(Gantry),
    /// A machine with two crossed belts.
    CoreXy(CoreXy),
    /// A SCARA.
    Scara(Scara),
    /// A linear delta.
    LinearDelta(LinearDelta),
}

/// A main axis while the tool moves along a curve. The angle changes by `link . dp / lever` when the tool moves by dp.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Joint {
    pub(crate) place: Place,
    /// Derivative of the angle with respect to the curve's parameter, rad.
    pub(crate) slope: Series,
    /// The link that holds the tool, mm, or the direction in which a linear axis moves it.
    pub(crate) link: [Interval; 3],
    /// Product of the link with the derivative of its other end by the angle, mm2; for a linear axis mm.
    pub(crate) lever: Interval,
    pub(crate) constraint: Constraint,
}

/// The angle of a main axis.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Place {
    /// By its cosine and sine; within half a turn of the middle, rad.
    Turned { direction: [Interval; 2], middle_rad: f64 },
    /// Itself, rad: of a joint with any number of turns.
    Angle(Interval),
}

impl Place {
    /// The angle, rad; no bounds unless they are narrow.
    pub(crate) fn angle(&self) -> Interval {
        match *self {
            Self::Turned {
                direction: [cosine, sine],
                middle_rad,
            } => {
                let angle = of_unit(cosine, sine);
                let turns = ((middle_rad - angle.middle()) / std::f64::consts::TAU).round();
                if turns.is_finite() {
                    angle + turn() * Interval::point(turns)
                } else {
                    Interval::ENTIRE
                }
            }
            Self::Angle(angle) => angle,
        }
    }
}

/// What holds the tool at a main axis.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Constraint {
    /// A link of constant length.
    Link {
        /// Derivative of the link's other end by the angle, mm.
        tow: [Interval; 3],
        /// Product of the link with the second derivative of its other end by the angle, mm2.
        sway: Interval,
        /// Whether the link keeps its length in the horizontal plane, and heights do not count.
        level: bool,
    },
    /// A slide: the tool's place along the link's direction is in proportion to the angle.
    Slide,
}

impl Joint {
    /// What the speeds add to `link . p''` in the joint's acceleration times its lever, mm2/s2. `speed` is the joint's,
    /// rad/s.
    pub(crate) fn pull(&self, velocity: &[Interval; 3], speed: Interval) -> Interval {
        match self.constraint {
            Constraint::Link { tow, sway, level } => {
                let [x, y, z] = [0, 1, 2].map(|place| velocity[place] - tow[place] * speed);
                let heights = if level { Interval::ZERO } else { z.square() };
                x.square() + y.square() + heights - sway * speed.square()
            }
            Constraint::Slide => Interval::ZERO,
        }
    }
}

impl Robot {
    /// The main axes while the tool is at `point` and moves with the derivative `first`.
    pub(crate) fn joints(&self, point: &Series3, first: &Series3) -> [Joint; MAIN_AXES] {
        match self {
            Self::Delta(delta) => delta.joints(point, first),
            Self::Gantry(gantry) => gantry.joints(point, first),
            Self::CoreXy(corexy) => corexy.joints(point, first),
            Self::Scara(scara) => scara.joints(point, first),
            Self::LinearDelta(delta) => delta.joints(point, first),
        }
    }

    /// Two lengths a and l, mm, with which the bounds in [`crate::average`] hold in every pose. With links, a is the largest
    /// derivative of the other end of a main axis's link by the angle, also the second, and l the length of that link. For
    /// other constraints they cover each lever divided by the length of its link, and the tool's second derivatives by the
    /// angles; the kind's file has the proof. `None` where the position is in proportion to the angles.
    pub(crate) fn links_mm(&self) -> Option<[f64; 2]> {
        match self {
            Self::Delta(delta) => Some(delta.links_mm()),
            Self::Gantry(_) | Self::CoreXy(_) => None,
            Self::Scara(scara) => Some(scara.links_mm()),
            Self::LinearDelta(delta) => Some(delta.links_mm()),
        }
    }
}

impl Default for Robot {
    /// The robot of the default configuration.
    fn default() -> Self {
        Self::Delta(Delta::new(&DeltaDimensions::default()))
    }
}

/// A linear axis: its angle for a place along a direction, and the travel for a turn, mm.
pub(crate) fn slide(direction: [f64; 3], mm_per_turn: f64, point: &Series3, first: &Series3) -> Joint {
    let [x, y, z] = direction.map(Interval::point);
    let along = |of: &Series3| of[0].times(x) + of[1].times(y) + of[2].times(z);
    let rad_per_mm = turn() / Interval::point(mm_per_turn);
    Joint {
        place: Place::Angle((along(point).times(rad_per_mm)).value()),
        slope: along(first).times(rad_per_mm),
        link: [x, y, z],
        lever: Interval::point(mm_per_turn) / turn(),
        constraint: Constraint::Slide,
    }
}
