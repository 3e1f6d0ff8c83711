//! The delta robot: three arms, three forearms, one platform.
//!
//! Seen from the shoulder, in the arm's plane, the forearm's lower end is at (u, w), and y beside that plane. With
//! A^2 = u^2 + w^2 and k = (A^2 + y^2 + a^2 - l^2) / 2a for an upper arm of length a and a forearm of length l, the
//! angle t solves u cos t - w sin t = k. Its two solutions differ in the sign of D = sqrt(A^2 - k^2); the robot has the
//! one with the elbow outside. There the forearm's product with the elbow's derivative is a D, which gives t' = f . p' /
//! (a D).

use super::{Constraint, Joint, MAIN_AXES, Place};
use crate::angle::{cosine_and_sine, from_degrees};
use crate::interval::Interval;
use crate::series::{Series, Series3};

/// DeltaDimensions of a delta robot with equal arms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeltaDimensions {
    /// Centre of the base to the shoulder axes, mm.
    pub base_radius_mm: f64,
    /// Length of an upper arm, mm.
    pub upper_arm_mm: f64,
    /// Length of a forearm, mm.
    pub forearm_mm: f64,
    /// Centre of the platform to the forearms' joints, mm.
    pub platform_radius_mm: f64,
    /// Azimuths of the arms, degrees.
    pub azimuths_deg: [f64; MAIN_AXES],
}

impl Default for DeltaDimensions {
    /// The IRB 340, as the default configuration describes it.
    fn default() -> Self {
        Self {
            base_radius_mm: 200.0,
            upper_arm_mm: 350.0,
            forearm_mm: 800.0,
            platform_radius_mm: 45.0,
            azimuths_deg: [0.0, 120.0, 240.0],
        }
    }
}

/// A delta robot. At angle 0 an arm points outwards and level; a positive angle lowers its elbow.
#[derive(Clone, Debug)]
pub struct Delta {
    /// Cosine and sine of each arm's azimuth.
    azimuths: [[Interval; 2]; MAIN_AXES],
    offset: Interval,
    upper: Interval,
    forearm: Interval,
}

impl Delta {
    /// A delta robot of these dimensions. With dimensions that are no robot, nothing can be proved.
    #[must_use]
    pub fn new(dimensions: &DeltaDimensions) -> Self {
        Self {
            azimuths: dimensions
                .azimuths_deg
                .map(|azimuth_deg| cosine_and_sine(from_degrees(azimuth_deg))),
            offset: Interval::point(dimensions.platform_radius_mm) - Interval::point(dimensions.base_radius_mm),
            upper: Interval::point(dimensions.upper_arm_mm),
            forearm: Interval::point(dimensions.forearm_mm),
        }
    }

    /// Lengths of upper arm and forearm, mm.
    pub(super) fn links_mm(&self) -> [f64; 2] {
        [self.upper.high(), self.forearm.high()]
    }

    pub(super) fn joints(&self, point: &Series3, first: &Series3) -> [Joint; MAIN_AXES] {
        self.azimuths.map(|azimuth| self.joint(azimuth, point, first))
    }

    fn joint(&self, [c, s]: [Interval; 2], point: &Series3, first: &Series3) -> Joint {
        let upper = self.upper;
        let u = point[0].times(c) + point[1].times(s) + Series::constant(self.offset);
        let y = point[1].times(c) - point[0].times(s);
        let w = point[2];
        let first_u = first[0].times(c) + first[1].times(s);
        let first_y = first[1].times(c) - first[0].times(s);
        let first_w = first[2];
        let squared = u.square() + w.square();
        let lengths = upper.square() - self.forearm.square();
        let double = Interval::point(2.0) * upper;
        let k = (squared + y.square() + Series::constant(lengths)).times(Interval::ONE / double);
        let d = (squared - k.square()).root();
        let cosine = (k * u - w * d).over(&squared);
        let sine = -(k * w + u * d).over(&squared);
        let (out, along) = (u - cosine.times(upper), w + sine.times(upper));
        let slope = (out * first_u + y * first_y + along * first_w).over(&d.times(upper));
        let (out, across, along) = (out.value(), y.value(), along.value());
        let (cosine, sine) = (cosine.value(), sine.value());
        Joint {
            place: Place::Turned {
                direction: [cosine, sine],
                middle_rad: 0.0,
            },
            slope,
            link: [out * c - across * s, out * s + across * c, along],
            lever: d.value() * upper,
            constraint: Constraint::Link {
                tow: [-(upper * sine * c), -(upper * sine * s), -(upper * cosine)],
                sway: upper * (along * sine - out * cosine),
                level: false,
            },
        }
    }
}
