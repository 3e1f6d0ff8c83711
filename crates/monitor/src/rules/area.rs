//! Area: joints stay in their ranges, and the tool in the work area.
//!
//! A joint may be 0.005 rad beyond its range: the planner keeps a margin of its own. While something is disturbed or
//! stopping, and on the way to the home switches, behind which an axis brakes, the mechanical end stops bound it, 0.05 rad
//! beyond the range; a joint that was brought there may only come nearer.
//!
//! The tool may be the following error and 0.3 mm outside the work area, whose floor is also the paper less the
//! pressing depth. A stop adds how far the tool slides; feedback that is not true adds the deviation that is promised
//! for it. A robot that finds itself outside may only come nearer: what was outside at rest is allowed, and shrinks.

use crate::cell::AXES_MAX;
use crate::robot::MAIN_AXES;
use crate::scene::{Finding, Scene};
use crate::vector::Vector;
use crate::violation::Rule;

/// How far a joint may creep where it was brought to, rad.
const CREEP_RAD: f64 = 1.0e-3;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Area {
    /// How far outside the tool may be, mm: as far as it has been in unsound motion or at the start.
    found_mm: Option<f64>,
    /// How far beyond its range each joint may be, rad: as far as it has been in unsound motion or at the start.
    found_rad: [f64; AXES_MAX],
}

impl Area {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let motion = scene.motion;
        // In the first millisecond any place within the end stops is where the robot was found.
        let is_sound = scene.is_sound() && self.found_mm.is_some() && !scene.disturbances.searches();
        for axis in motion.each_axis() {
            let (angle, joint) = (motion.angles_rad[axis], &scene.bounds.joints[axis]);
            let found_rad = &mut self.found_rad[axis];
            let beyond_rad = (joint.low_rad - angle).max(angle - joint.high_rad).max(0.0);
            let more = match is_sound {
                true if *found_rad > 0.0 => *found_rad + CREEP_RAD,
                true => 0.0,
                false => joint.disturbed_rad,
            };
            *found_rad = if is_sound {
                found_rad.min(beyond_rad)
            } else {
                found_rad.max(beyond_rad).min(joint.disturbed_rad)
            };
            if angle < joint.low_rad - more || angle > joint.high_rad + more {
                let (low, high) = (joint.low_rad - more, joint.high_rad + more);
                let text = format!("joint {axis} is at {angle:.4} rad, bounds {low:.4} to {high:.4} rad");
                return Err((Rule::Area, text));
            }
        }
        let Some(tool) = motion.tool else {
            let is_lost = is_sound && motion.axes >= MAIN_AXES;
            let lost = || Err((Rule::Area, "no tool connects the joints".into()));
            return if is_lost { lost() } else { Ok(()) };
        };
        let outside_mm = outside_mm(scene, &tool);
        let (Some(found_mm), Some(more_mm)) = (self.found_mm, scene.more_mm) else {
            // The first millisecond, or nobody knows where the joints are.
            self.found_mm = Some(outside_mm);
            return Ok(());
        };
        if scene.orders.may_search() {
            self.found_mm = Some(outside_mm);
            return Ok(());
        }
        let bound_mm = found_mm.max(0.0) + more_mm + scene.bounds.area_mm;
        if outside_mm > bound_mm {
            let [x, y, z] = tool;
            let text = format!(
                "the tool is at {x:.2}, {y:.2}, {z:.2} mm, {outside_mm:.2} mm outside the work area, bound {bound_mm:.2} mm"
            );
            return Err((Rule::Area, text));
        }
        if is_sound {
            self.found_mm = Some(found_mm.min(outside_mm));
        } else {
            self.found_mm = Some(found_mm.max(outside_mm - scene.bounds.area_mm));
        }
        Ok(())
    }
}

/// Distance of the tool from the work area, mm; negative inside.
fn outside_mm(scene: &Scene<'_>, [x, y, z]: &Vector) -> f64 {
    let area = &scene.cell.work_area;
    let low_mm = (scene.bounds.paper_low_mm + scene.cell.paper.rise_mm(*x, *y)).max(area.z_low_mm);
    let beyond = |value: &f64, [low, high]: [f64; 2]| (value - high).max(low - value);
    let of_box = beyond(x, area.x_mm).max(beyond(y, area.y_mm));
    let (x, y) = (x - area.centre_mm[0], y - area.centre_mm[1]);
    let radius = (x * x + y * y).sqrt();
    let hole = if area.inner_radius_mm > 0.0 {
        area.inner_radius_mm - radius
    } else {
        f64::NEG_INFINITY
    };
    let beside = (radius - area.radius_mm).max(hole).max(of_box);
    beside.max(z - area.z_high_mm).max(low_mm - z)
}

#[cfg(test)]
mod tests {
    use crate::cell::{Cell, WorkArea};
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    #[test]
    fn a_joint_beyond_its_range_breaks_the_rule() {
        let mut rig = Rig::moving();
        rig.joints[3].angle_rad = 6_283.004;
        assert_eq!(rig.step(), Ok(()));
        rig.joints[3].angle_rad = 6_283.01;
        assert!(broken(&rig.step(), Rule::Area));
        let mut rig = Rig::moving();
        rig.disturb_machine(true);
        rig.joints[3].angle_rad = 6_283.05;
        assert_eq!(rig.step(), Ok(()));
        rig.disturb_machine(false);
        assert_eq!(rig.run(1_000), Ok(()), "it was brought there");
        rig.joints[3].angle_rad = 6_283.03;
        assert_eq!(rig.step(), Ok(()));
        rig.joints[3].angle_rad = 6_283.04;
        assert!(broken(&rig.step(), Rule::Area), "it may only come nearer");
    }

    #[test]
    fn a_joint_that_is_found_beyond_its_range_may_only_come_nearer() {
        let mut rig = Rig::new();
        rig.joints[3].angle_rad = 6_283.03;
        let mut rig = rig.in_motion();
        rig.joints[3].angle_rad = 6_283.02;
        assert_eq!(rig.step(), Ok(()));
        rig.joints[3].angle_rad = 6_283.03;
        assert!(broken(&rig.step(), Rule::Area));
    }

    fn small() -> Cell {
        Cell {
            work_area: WorkArea {
                z_low_mm: -845.0,
                ..WorkArea::default()
            },
            ..Cell::default()
        }
    }

    #[test]
    fn a_tool_that_leaves_the_work_area_breaks_the_rule() {
        let mut rig = Rig::with(small()).at_height(-844.0).in_motion();
        let found = rig.go_to_height(-846.0, 200);
        assert!(broken(&found, Rule::Area), "{found:?}");
        let mut rig = Rig::with(small()).at_height(-844.0).in_motion();
        assert_eq!(rig.go_to_height(-845.2, 200), Ok(()));
    }

    #[test]
    fn a_sheet_that_lies_aslant_takes_the_lower_border_with_it() {
        let pressed = |slope: [f64; 2], below_mm: f64| {
            let mut cell = Cell::default();
            cell.paper.slope = slope;
            // No pen is in the holder.
            cell.paper.pen_spring_mm = -100.0;
            let sheet_mm = cell.paper.pen_down_z_mm + slope[0] * 60.0 + slope[1] * -50.0;
            let low_mm = cell.paper.pressing_depth_mm + below_mm;
            let mut rig = Rig::with(cell).at_height(-840.0).in_motion();
            rig.go_to([60.0, -50.0, -840.0], 400)?;
            rig.go_to([60.0, -50.0, sheet_mm - low_mm], 400)
        };
        for slope in [[0.0; 2], [0.03, -0.02], [-0.03, 0.02], [0.02, 0.03]] {
            assert_eq!(pressed(slope, -0.1), Ok(()), "{slope:?}");
            let found = pressed(slope, 2.5);
            assert!(broken(&found, Rule::Area), "{slope:?}: {found:?}");
        }
    }

    #[test]
    fn the_box_and_the_hole_around_the_axis_are_borders_too() {
        let around = |work_area: WorkArea| Cell {
            work_area,
            ..Cell::default()
        };
        let boxed = around(WorkArea {
            x_mm: [-1.0, 500.0],
            ..WorkArea::default()
        });
        let hollow = around(WorkArea {
            centre_mm: [20.0, 0.0],
            inner_radius_mm: 19.0,
            ..WorkArea::default()
        });
        for (cell, inside, outside) in [(boxed, 1.0, -3.0), (hollow, -1.0, 3.0)] {
            let mut rig = Rig::with(cell).at_height(-844.0).in_motion();
            assert_eq!(rig.go_to([inside, 0.0, -844.0], 200), Ok(()));
            let found = rig.go_to([outside, 0.0, -844.0], 200);
            assert!(broken(&found, Rule::Area), "{found:?}");
        }
    }

    #[test]
    fn from_outside_the_tool_only_comes_nearer() {
        let mut rig = Rig::with(small()).at_height(-847.0).in_motion();
        assert_eq!(rig.go_to_height(-845.0, 200), Ok(()));
        let found = rig.go_to_height(-846.5, 200);
        assert!(broken(&found, Rule::Area), "{found:?}");
    }
}
