//! Speed: no joint and no tool moves faster than its limit and what its controller may add.
//!
//! A joint: the configured limit, plus the correction that the controller adds before the following error is a fault
//! (gain times largest error), at most the largest command; 5 % and 0.1 rad/s for the overshoot of a velocity loop.
//!
//! On the way to the home switches, in sound motion: the speed of the search with that overshoot. The tool's speed is then
//! what the joints make of it.
//!
//! The tool, in sound motion: the configured speed times the override, 5 % and 20 mm/s. Single moves, jogs and lifts
//! are not scaled by the override. Where only legs with the pen down are near and the pen touches, the drawing speed
//! counts, else the travel speed. An override counts from its command until the path has slowed down after a lower one.

use crate::bounds::Bounds;
use crate::orders::Order;
use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// Milliseconds in a row in which the tool has to be too fast: one difference may be across a border between two
/// speeds.
const TOO_FAST_MS: u32 = 3;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Speed {
    too_fast_ms: u32,
}

impl Speed {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let motion = scene.motion;
        if !motion.is_finite {
            return Err((Rule::Speed, "an angle or a speed is not a number".into()));
        }
        for axis in motion.each_axis() {
            let (speed, bound) = (motion.speeds_rad_s[axis].abs(), scene.bounds.joints[axis].speed_rad_s);
            if speed > bound {
                let text = format!("joint {axis} moves at {speed:.3} rad/s, bound {bound:.3} rad/s");
                return Err((Rule::Speed, text));
            }
        }
        if !scene.is_sound() {
            self.too_fast_ms = 0;
            return Ok(());
        }
        if scene.orders.is_search_known() {
            self.too_fast_ms = 0;
            return search(scene);
        }
        let (speed, bound) = tool(scene);
        // A search that nobody has confirmed may go on, or another motion.
        let is_too_fast = speed > bound && !(scene.orders.may_search() && search(scene).is_ok());
        self.too_fast_ms = if is_too_fast { self.too_fast_ms + 1 } else { 0 };
        if self.too_fast_ms < TOO_FAST_MS {
            return Ok(());
        }
        let percent = scene.orders.percent_max(scene.now_ms());
        let text = format!("the tool moves at {speed:.1} mm/s, bound {bound:.1} mm/s at {percent} %");
        Err((Rule::Speed, text))
    }
}

/// The joints on the way to their switches.
fn search(scene: &Scene<'_>) -> Finding {
    let motion = scene.motion;
    for axis in motion.each_axis() {
        let (speed, bound) = (motion.speeds_rad_s[axis].abs(), scene.bounds.joints[axis].search_rad_s);
        if speed > bound {
            let text = format!("joint {axis} moves at {speed:.3} rad/s in the search, bound {bound:.3} rad/s");
            return Err((Rule::Speed, text));
        }
    }
    Ok(())
}

/// Speed of the tool and its bound, mm/s.
fn tool(scene: &Scene<'_>) -> (f64, f64) {
    let (cell, motion) = (scene.cell, scene.motion);
    let part = f64::from(scene.orders.percent_max(scene.now_ms())) / 100.0;
    let draws = scene.place.is_some_and(|place| place.draws) && scene.moment.pen_touches;
    if draws {
        // A pen that is lifted from the path moves upwards, at the speed of lifts.
        let [x, y, _] = motion.velocity_mm_s;
        return (x.hypot(y), Bounds::with_margin(cell, cell.tool_speed_mm_s * part));
    }
    let on_path = (cell.tool_speed_mm_s.max(cell.travel_speed_mm_s) * part).max(scene.bounds.lift_mm_s);
    let is_path_alone = scene.orders.order == Order::Path && scene.orders.is_drawing(scene.now_ms());
    let bound = if is_path_alone {
        on_path
    } else {
        on_path.max(cell.travel_speed_mm_s)
    };
    (motion.tool_speed_mm_s, Bounds::with_margin(cell, bound))
}

#[cfg(test)]
mod tests {
    use crate::moment::{Command, Input, Mode, Report};
    use crate::rig::{Rig, broken, cell};
    use crate::violation::Rule;

    #[test]
    fn a_joint_within_its_limit_and_its_controllers_correction_is_fast_enough() {
        let mut rig = Rig::moving();
        rig.disturb_machine(true);
        for speed in [7.0, 14.0, 21.0, 28.4] {
            rig.joints[0].speed_rad_s = speed;
            rig.joints[3].speed_rad_s = -speed;
            assert_eq!(rig.step(), Ok(()));
        }
        rig.joints[3].speed_rad_s = -28.6;
        assert!(broken(&rig.step(), Rule::Speed));
    }

    #[test]
    fn numbers_that_are_none_break_the_rule_and_panic_nowhere() {
        for value in [f64::NAN, f64::INFINITY] {
            let mut rig = Rig::moving();
            rig.joints[1].angle_rad = value;
            assert!(broken(&rig.step(), Rule::Speed));
        }
    }

    #[test]
    fn a_search_may_be_as_fast_as_its_switches_are_approached_however_slow_the_tool_is() {
        let searching = |speed_rad_s: f64, ended: Option<Command>| {
            let mut cell = cell();
            (cell.tool_speed_mm_s, cell.travel_speed_mm_s) = (1.0, 1.0);
            cell.joints.iter_mut().for_each(|joint| joint.search_rad_s = 0.5);
            let mut rig = Rig::with(cell);
            rig.input(Input::Configured);
            rig.command(Command::Enable);
            rig.power(true);
            assert_eq!(rig.run(600), Ok(()));
            rig.command(Command::Search);
            rig.report(Report::Homed(false));
            rig.report(Report::Mode(Mode::Moving));
            rig.accelerate_to(speed_rad_s);
            rig.run(400)?;
            if let Some(command) = ended {
                rig.command(command);
                rig.run(8)?;
                rig.brake(100.0);
            }
            rig.run(40)
        };
        for ended in [None, Some(Command::Cancel), Some(Command::Disable)] {
            assert_eq!(searching(0.6, ended), Ok(()), "{ended:?}");
            let found = searching(0.7, ended);
            assert!(broken(&found, Rule::Speed), "{found:?}");
        }
    }

    #[test]
    fn while_a_search_is_not_answered_another_motion_keeps_its_own_limit() {
        let asked = |speed_rad_s: f64| {
            let mut rig = Rig::moving();
            rig.input(Input::Commanded(Command::Search));
            rig.accelerate_to(speed_rad_s);
            rig.run(60)
        };
        assert_eq!(asked(0.5), Ok(()));
        let found = asked(5.0);
        assert!(broken(&found, Rule::Speed), "{found:?}");
    }

    #[test]
    fn a_tool_that_runs_away_at_twice_the_travel_speed_breaks_the_rule() {
        let mut rig = Rig::moving();
        rig.accelerate_to(2.4);
        assert_eq!(rig.run(30), Ok(()), "about 950 mm/s");
        let mut rig = Rig::moving();
        rig.accelerate_to(5.0);
        let found = rig.run(60);
        assert!(broken(&found, Rule::Speed), "{found:?}");
    }
}
