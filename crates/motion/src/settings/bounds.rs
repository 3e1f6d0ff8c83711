//! Hard bounds: a table with the lowest and highest value that any settings may hold.
//!
//! A bound that depends on another value expresses a relation between the two.

use super::averaging::resonance_min_hz;
use super::input_shaper::{DAMPING_MAX, RESONANCE_HZ};
use super::{Paper, Settings, WorkVolume};
use crate::bounds::{Bound, Violation, bound, first_violation};
use crate::robots::Geometry;

/// Highest speed that a joint may be allowed, rad/s.
const JOINT_SPEED_MAX_RAD_S: f64 = 50.0;
/// Highest acceleration that a joint may be allowed, rad/s2.
const JOINT_ACCELERATION_MAX_RAD_S2: f64 = 2000.0;

impl Settings {
    /// Number of rows in [`Settings::bounds`].
    pub const BOUNDS: usize = Geometry::BOUNDS + 33;

    /// Hard bounds of every value except the dead-man time, which is bounded by the settings of the bus.
    #[must_use]
    pub fn bounds(&self) -> [Bound; Self::BOUNDS] {
        let (geometry, area, paper, motion) = (&self.geometry, &self.work_area, &self.paper, &self.motion);
        let (reach, [floor, ceiling]) = (geometry.reach_mm(), geometry.heights_mm());
        let farthest = WorkVolume::BORDER_MAX_MM;
        let rows: [Bound; Self::BOUNDS - Geometry::BOUNDS] = [
            bound("work_area.radius_mm", area.radius_mm, 1.0, reach),
            bound("work_area.inner_radius_mm", area.inner_radius_mm, 0.0, area.radius_mm),
            bound("work_area.x_mm[0]", area.x_mm[0], -farthest, area.x_mm[1]),
            bound("work_area.x_mm[1]", area.x_mm[1], area.x_mm[0], farthest),
            bound("work_area.y_mm[0]", area.y_mm[0], -farthest, area.y_mm[1]),
            bound("work_area.y_mm[1]", area.y_mm[1], area.y_mm[0], farthest),
            bound("work_area.z_low_mm", area.z_low_mm, floor, area.z_high_mm),
            bound("work_area.z_high_mm", area.z_high_mm, area.z_low_mm, ceiling),
            bound(
                "paper.centre_mm[0]",
                paper.centre_mm[0],
                -area.radius_mm,
                area.radius_mm,
            ),
            bound(
                "paper.centre_mm[1]",
                paper.centre_mm[1],
                -area.radius_mm,
                area.radius_mm,
            ),
            bound("paper.size_mm[0]", paper.size_mm[0], 1.0, 2.0 * area.radius_mm),
            bound("paper.size_mm[1]", paper.size_mm[1], 1.0, 2.0 * area.radius_mm),
            bound(
                "paper.pen_down_z_mm",
                paper.pen_down_z_mm,
                area.z_low_mm,
                area.z_high_mm,
            ),
            bound(
                "paper.pen_lift_mm",
                paper.pen_lift_mm,
                0.5,
                area.z_high_mm - paper.pen_down_z_mm,
            ),
            bound(
                "paper.pressing_depth_mm",
                paper.pressing_depth_mm,
                0.0,
                paper.pen_down_z_mm - area.z_low_mm,
            ),
            bound("paper.slope[0]", paper.slope[0], -Paper::SLOPE_MAX, Paper::SLOPE_MAX),
            bound("paper.slope[1]", paper.slope[1], -Paper::SLOPE_MAX, Paper::SLOPE_MAX),
            bound("motion.speed_mm_s", motion.speed_mm_s, 1.0, 10_000.0),
            bound("motion.travel_speed_mm_s", motion.travel_speed_mm_s, 1.0, 10_000.0),
            bound("motion.acceleration_mm_s2", motion.acceleration_mm_s2, 10.0, 150_000.0),
            bound("motion.pen_speed_mm_s", motion.pen_speed_mm_s, 0.0, 10_000.0),
            bound(
                "motion.pen_acceleration_mm_s2",
                motion.pen_acceleration_mm_s2,
                0.0,
                150_000.0,
            ),
            bound("motion.pen_dwell_ms", f64::from(motion.pen_dwell_ms), 0.0, 10_000.0),
            bound(
                "motion.joint_speed_rad_s",
                largest(&motion.joint_speed_rad_s),
                0.01,
                JOINT_SPEED_MAX_RAD_S,
            ),
            bound(
                "motion.joint_speed_rad_s",
                smallest(&motion.joint_speed_rad_s),
                0.01,
                JOINT_SPEED_MAX_RAD_S,
            ),
            bound(
                "motion.joint_acceleration_rad_s2",
                largest(&motion.joint_acceleration_rad_s2),
                0.1,
                JOINT_ACCELERATION_MAX_RAD_S2,
            ),
            bound(
                "motion.joint_acceleration_rad_s2",
                smallest(&motion.joint_acceleration_rad_s2),
                0.1,
                JOINT_ACCELERATION_MAX_RAD_S2,
            ),
            bound("motion.tolerance_mm", motion.tolerance_mm, 0.005, 5.0),
            bound(
                "motion.travel_tolerance_mm",
                motion.travel_tolerance_mm,
                motion.tolerance_mm,
                10.0,
            ),
            bound("motion.jerk_window_ms", f64::from(motion.jerk_window_ms), 0.0, 32.0),
            bound(
                "motion.resonance_hz",
                motion.resonance_hz,
                resonance_min_hz(motion),
                RESONANCE_HZ[1],
            ),
            bound("motion.resonance_damping", motion.resonance_damping, 0.0, DAMPING_MAX),
            bound(
                "motion.starve_dwell_ms",
                f64::from(motion.starve_dwell_ms),
                0.0,
                60_000.0,
            ),
        ];
        let mut all = [bound("", 0.0, 0.0, 0.0); Self::BOUNDS];
        let (dimensions, others) = all.split_at_mut(Geometry::BOUNDS);
        dimensions.copy_from_slice(&geometry.bounds());
        others.copy_from_slice(&rows);
        all
    }

    /// Checks every value against its hard bounds.
    ///
    /// # Errors
    /// The first value that is not finite or outside its bounds.
    pub fn check(&self) -> Result<(), Violation> {
        first_violation(&self.bounds())
    }
}

fn largest(values: &[f64]) -> f64 {
    values
        .iter()
        .fold(f64::NEG_INFINITY, |a, b| if b.is_nan() || *b > a { *b } else { a })
}

fn smallest(values: &[f64]) -> f64 {
    values
        .iter()
        .fold(f64::INFINITY, |a, b| if b.is_nan() || *b < a { *b } else { a })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_a_number_is_both_the_largest_and_the_smallest() {
        assert_eq!((largest(&[1.0, 3.0, -2.0]), smallest(&[1.0, 3.0, -2.0])), (3.0, -2.0));
        for place in 0..3 {
            let mut values = [1.0, 3.0, -2.0];
            values[place] = f64::NAN;
            assert!(largest(&values[..=place]).is_nan(), "{values:?}");
            assert!(smallest(&values[..=place]).is_nan(), "{values:?}");
        }
    }
}
