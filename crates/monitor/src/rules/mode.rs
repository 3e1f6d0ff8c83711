//! Mode: a reported standstill is a standstill.
//!
//! A report may be some milliseconds old, reports of a motion may be lost, and a joint creeps for a moment after a
//! motion. The rule is broken when a mode in which the robot stands is reported
//! - while a joint has been faster than a creep for 100 ms throughout which such a mode was the last one reported;
//! - twice in one motion, however slow, 100 ms or more apart.

use crate::moment::{Mode, Report};
use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// Speed up to which a joint creeps, rad/s. The controller calls a joint at rest below 0.01 rad/s.
const CREEP_RAD_S: f64 = 0.012;
/// Age of a motion at which it has to be in the reports, ms.
const REPORTED_MS: u32 = 30;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReportedMode {
    moving_ms: u32,
    fast_ms: u32,
    /// How long the motion had lasted when the robot was first reported to stand, ms.
    told_ms: Option<u32>,
}

impl ReportedMode {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let motion = scene.motion;
        let Some(mode) = (scene.orders.mode)
            .filter(|mode| mode.stands() && scene.stands_without_order())
            .filter(|_| motion.moves)
        else {
            *self = Self::default();
            return Ok(());
        };
        let is_fast = (motion.each_axis()).any(|axis| motion.speeds_rad_s[axis].abs() > CREEP_RAD_S);
        let moved_ms = self.moving_ms;
        self.moving_ms += 1;
        self.fast_ms = if is_fast { self.fast_ms + 1 } else { 0 };
        let stands = |report: &Report| matches!(report, Report::Mode(mode) if Mode::stands(*mode));
        if !scene.moment.reports.iter().any(stands) {
            return Ok(());
        }
        let told_before = self
            .told_ms
            .is_some_and(|told_ms| moved_ms - told_ms > scene.cell.creep_ms);
        if self.fast_ms > scene.cell.creep_ms || told_before {
            let text = format!("{mode:?} is reported while a joint has been moving for {moved_ms} ms");
            return Err((Rule::Mode, text));
        }
        if moved_ms >= REPORTED_MS {
            self.told_ms.get_or_insert(moved_ms);
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
    fn a_motion_whose_reports_are_lost_may_end_in_a_creep_but_not_go_on() {
        let idle = || Report::Mode(Mode::Idle);
        for speed_rad_s in [0.005, 0.1] {
            let mut rig = Rig::idle();
            rig.command(Command::Pen { down: false });
            assert_eq!(rig.run(15), Ok(()));
            rig.accelerate_to(speed_rad_s);
            assert_eq!(rig.run(300), Ok(()));
            rig.accelerate_to(0.005);
            rig.report(idle());
            assert_eq!(rig.step(), Ok(()), "{speed_rad_s} rad/s");
            rig.command(Command::Pen { down: false });
            assert_eq!(rig.run(150), Ok(()));
            rig.report(idle());
            assert!(
                broken(&rig.step(), Rule::Mode),
                "{speed_rad_s} rad/s: it creeps too long"
            );
        }
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
