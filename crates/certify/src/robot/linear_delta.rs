//! Linear delta: rods of equal length from carriages on upright towers.
//!
//! With the horizontal distance d from a tower and H = sqrt(L^2 - d^2) for a rod of length L, the carriage is at z + H. The
//! rod from the carriage to the platform is (d, -H).

use super::{Constraint, Joint, MAIN_AXES, Place};
use crate::angle::{cosine_and_sine, from_degrees, turn};
use crate::interval::Interval;
use crate::series::{Series, Series3};

/// Dimensions of a linear delta.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearDeltaDimensions {
    /// Distance of the rods' upper joints from the axis less that of the lower ones from the platform's centre, mm.
    pub radius_mm: f64,
    /// Length of a rod, mm.
    pub rod_mm: f64,
    /// Azimuths of the towers, degrees.
    pub azimuths_deg: [f64; MAIN_AXES],
    /// Travel of a carriage for a turn, mm.
    pub carriage_mm_per_turn: f64,
}

/// A linear delta.
#[derive(Clone, Debug)]
pub struct LinearDelta {
    /// Where the towers stand, mm.
    towers: [[Interval; 2]; MAIN_AXES],
    rod: Interval,
    carriage_mm_per_turn: f64,
}

impl LinearDelta {
    /// A linear delta of these dimensions. With dimensions that are no robot, nothing can be proved.
    #[must_use]
    pub fn new(dimensions: &LinearDeltaDimensions) -> Self {
        let radius = Interval::point(dimensions.radius_mm);
        Self {
            towers: dimensions
                .azimuths_deg
                .map(|azimuth_deg| cosine_and_sine(from_degrees(azimuth_deg)).map(|part| radius * part)),
            rod: Interval::point(dimensions.rod_mm),
            carriage_mm_per_turn: dimensions.carriage_mm_per_turn,
        }
    }

    /// What a carriage moves by for a radian, and the length of a rod, mm.
    pub(super) fn links_mm(&self) -> [f64; 2] {
        [self.mm_per_rad().high(), self.rod.high()]
    }

    fn mm_per_rad(&self) -> Interval {
        Interval::point(self.carriage_mm_per_turn) / turn()
    }

    pub(super) fn joints(&self, point: &Series3, first: &Series3) -> [Joint; MAIN_AXES] {
        self.towers.map(|tower| self.joint(tower, point, first))
    }

    fn joint(&self, [tower_x, tower_y]: [Interval; 2], point: &Series3, first: &Series3) -> Joint {
        let (x, y) = (
            point[0] - Series::constant(tower_x),
            point[1] - Series::constant(tower_y),
        );
        let height = (Series::constant(self.rod.square()) - x.square() - y.square()).root();
        let mm_per_rad = self.mm_per_rad();
        let rad_per_mm = Interval::ONE / mm_per_rad;
        let slope = first[2] - (x * first[0] + y * first[1]).over(&height);
        Joint {
            place: Place::Angle((point[2] + height).value() * rad_per_mm),
            slope: slope.times(rad_per_mm),
            link: [x.value(), y.value(), -height.value()],
            lever: -(height.value() * mm_per_rad),
            constraint: Constraint::Link {
                tow: [Interval::ZERO, Interval::ZERO, mm_per_rad],
                sway: Interval::ZERO,
                level: false,
            },
        }
    }
}
