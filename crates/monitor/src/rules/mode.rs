//! Mode: a reported standstill is a standstill.
//!
//! A report may be some milliseconds old, and a joint creeps for a moment after a motion. The rule is broken when a
//! mode in which the robot stands is reported after a joint has moved for 100 ms throughout which such a mode was the
//! last one reported, and no joint has just slowed down to a creep: the report of the motion itself may be lost.

use crate::moment::{Mode, Report};
use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// Speed below which a joint creeps, rad/s. The controller calls a joint at rest below 0.01 rad/s.
const CREEP_RAD_S: f64 = 0.012;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReportedMode {
    moving_ms: u32,
    creeping_ms: u32,
}

impl ReportedMode {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let Some(mode) = scene
            .orders
            .mode
            .filter(|mode| mode.stands() && scene.stands_without_order())
        else {
            (self.moving_ms, self.creeping_ms) = (0, 0);
            return Ok(());
        };
        let moved_ms = self.moving_ms;
        self.moving_ms = if scene.motion.moves { self.moving_ms + 1 } else { 0 };
        let creeps = (scene.motion.each_axis()).all(|axis| scene.motion.speeds_rad_s[axis].abs() < CREEP_RAD_S);
        self.creeping_ms = if creeps { self.creeping_ms + 1 } else { 0 };
        let slowed_down = (1..=scene.cell.creep_ms).contains(&self.creeping_ms);
        let stands = |report: &Report| matches!(report, Report::Mode(mode) if Mode::stands(*mode));
        if moved_ms > scene.cell.creep_ms
            && scene.motion.moves
            && !slowed_down
            && scene.moment.reports.iter().any(stands)
        {
            let text = format!("{mode:?} is reported while a joint has been moving for {moved_ms} ms");
            return Err((Rule::Mode, text));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::moment::{Command, Mode, Report};
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    #[test]
    fn a_robot_that_is_reported_at_rest_stands() {
        let mut rig = Rig::idle();
        rig.command(Command::Pen { down: false });
        rig.accelerate_to(0.1);
        for _ in 0..11 {
            // The order is young, so that the motion itself is permitted.
            rig.command(Command::Pen { down: false });
            rig.report(Report::Mode(Mode::Idle));
            if let Err(found) = rig.run(10) {
                assert_eq!(found.rule, Rule::Mode, "{found}");
                return;
            }
        }
        rig.report(Report::Mode(Mode::Idle));
        assert!(broken(&rig.step(), Rule::Mode));
    }

    #[test]
    fn a_joint_that_has_just_slowed_down_may_creep_though_its_motion_was_not_reported() {
        let mut rig = Rig::idle();
        rig.command(Command::Pen { down: false });
        assert_eq!(rig.run(15), Ok(()));
        rig.accelerate_to(0.1);
        assert_eq!(rig.run(300), Ok(()));
        rig.accelerate_to(0.005);
        rig.report(Report::Mode(Mode::Idle));
        assert_eq!(rig.step(), Ok(()));
        rig.command(Command::Pen { down: false });
        assert_eq!(rig.run(150), Ok(()));
        rig.report(Report::Mode(Mode::Idle));
        assert!(broken(&rig.step(), Rule::Mode), "it creeps too long");
    }

    #[test]
    fn a_report_that_crosses_an_order_is_none_of_rest() {
        let mut rig = Rig::idle();
        rig.command(Command::Pen { down: false });
        rig.report(Report::Mode(Mode::Idle));
        assert_eq!(rig.run(15), Ok(()));
        rig.accelerate_to(0.1);
        rig.report(Report::Mode(Mode::Moving));
        assert_eq!(rig.run(300), Ok(()));
        rig.accelerate_to(0.0);
        assert_eq!(rig.run(30), Ok(()));
        for _ in 0..100 {
            rig.report(Report::Mode(Mode::Idle));
            assert_eq!(rig.run(3), Ok(()));
        }
    }
}
