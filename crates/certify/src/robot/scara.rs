//! SCARA: two links in the horizontal plane, and a slide for z.
//!
//! With r^2 = x^2 + y^2, links l1 and l2, and c = (r^2 - l1^2 - l2^2) / (2 l1 l2), the elbow's angle has the cosine c and
//! the sine s = +-sqrt(1 - c^2). Its constraint is r^2 = l1^2 + l2^2 + 2 l1 l2 c: the position is a link from the origin
//! with the lever -l1 l2 s. The shoulder's constraint is the outer link's length: with the outer link o and the elbow's
//! place e, its lever is o . de/dt1.

use super::{Constraint, Joint, MAIN_AXES, Place, slide};
use crate::interval::Interval;
use crate::series::{Series, Series3};

/// Dimensions of a SCARA.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaraDimensions {
    /// From shoulder to elbow, mm.
    pub inner_mm: f64,
    /// From elbow to tool, mm.
    pub outer_mm: f64,
    /// Whether the elbow's angle is positive.
    pub positive: bool,
    /// Middle of the shoulder's range, rad.
    pub shoulder_middle_rad: f64,
    /// Travel of z for a turn, mm.
    pub z_mm_per_turn: f64,
}

/// A SCARA.
#[derive(Clone, Debug)]
pub struct Scara {
    dimensions: ScaraDimensions,
}

impl Scara {
    /// A SCARA of these dimensions. With dimensions that are no robot, nothing can be proved.
    #[must_use]
    pub fn new(dimensions: &ScaraDimensions) -> Self {
        Self {
            dimensions: *dimensions,
        }
    }

    /// The inner and the outer link, or what z moves by for a radian if that is more, mm.
    pub(super) fn links_mm(&self) -> [f64; 2] {
        let ScaraDimensions {
            inner_mm,
            outer_mm,
            z_mm_per_turn,
            ..
        } = self.dimensions;
        [inner_mm.max(1.0), outer_mm.max(z_mm_per_turn)]
    }

    pub(super) fn joints(&self, point: &Series3, first: &Series3) -> [Joint; MAIN_AXES] {
        let ScaraDimensions {
            inner_mm,
            outer_mm,
            positive,
            shoulder_middle_rad,
            z_mm_per_turn,
        } = self.dimensions;
        let (inner, outer) = (Interval::point(inner_mm), Interval::point(outer_mm));
        let product = inner * outer;
        let [x, y, _] = point;
        let squared = x.square() + y.square();
        let lengths = inner.square() + outer.square();
        let cosine = (squared - Series::constant(lengths)).times(Interval::point(0.5) / product);
        let root = (Series::constant(1.0) - cosine.square()).root();
        let sine = if positive { root } else { -root };
        // The position in the frame of the inner link.
        let (along, across) = (cosine.times(outer) + Series::constant(inner), sine.times(outer));
        let shoulder_cosine = (*x * along + *y * across).over(&squared);
        let shoulder_sine = (*y * along - *x * across).over(&squared);
        let (outer_x, outer_y) = (*x - shoulder_cosine.times(inner), *y - shoulder_sine.times(inner));
        let lever = sine.times(product);
        let shoulder_slope = (outer_x * first[0] + outer_y * first[1]).over(&lever);
        let elbow_slope = -(*x * first[0] + *y * first[1]).over(&lever);
        let (c, s) = (shoulder_cosine.value(), shoulder_sine.value());
        let shoulder = Joint {
            place: Place::Turned {
                direction: [c, s],
                middle_rad: shoulder_middle_rad,
            },
            slope: shoulder_slope,
            link: [outer_x.value(), outer_y.value(), Interval::ZERO],
            lever: lever.value(),
            constraint: Constraint::Link {
                tow: [-(inner * s), inner * c, Interval::ZERO],
                sway: -(product * cosine.value()),
                level: true,
            },
        };
        let elbow = Joint {
            place: Place::Turned {
                direction: [cosine.value(), sine.value()],
                middle_rad: 0.0,
            },
            slope: elbow_slope,
            link: [x.value(), y.value(), Interval::ZERO],
            lever: -lever.value(),
            constraint: Constraint::Link {
                tow: [Interval::ZERO; 3],
                sway: -(product * cosine.value()),
                level: true,
            },
        };
        let z = slide([0.0, 0.0, 1.0], z_mm_per_turn, point, first);
        // As long as a link, so that the inverse of the links' matrix has one size in all directions.
        let z = Joint {
            link: z.link.map(|part| part * outer),
            lever: z.lever * outer,
            ..z
        };
        [shoulder, elbow, z]
    }
}
