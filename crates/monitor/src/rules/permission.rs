//! Permission: nothing moves without configuration, homing, power and an order to move.
//!
//! A move, the pen alone and a drawing permit motion until the controller reports a mode in which it stands; a jog
//! until its dead-man time, the way of an order to the motors, and its deceleration have passed; a drawing that is
//! held, by order or for a silent host, and a motion that is cancelled until they have braked and lifted the pen. What
//! may creep after that comes to rest within a time of the drives, and a joint that stands stays within 0.02 rad of where it stood,
//! whatever happens to frames and slaves; false feedback and drives that cannot obey may move it. A motion that
//! outlasts a jog breaks the rule `deadman`, one that outlasts the host's silence the rule `silence`.

use crate::bounds::STAND_RAD;
use crate::cell::AXES_MAX;
use crate::scene::{Finding, Scene};

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Permission {
    moving_ms: u32,
    /// Where the joints stood when the permission ended, rad.
    stood_rad: [f64; AXES_MAX],
    has_stood: bool,
}

impl Permission {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let (motion, orders) = (scene.motion, scene.orders);
        let may_move = orders.may_move(scene.bounds, scene.now_ms());
        if may_move || !scene.stands_without_order() || !self.has_stood {
            self.stood_rad = motion.angles_rad;
            self.has_stood = motion.axes > 0;
            self.moving_ms = 0;
            return Ok(());
        }
        self.moving_ms = if motion.moves { self.moving_ms + 1 } else { 0 };
        if self.moving_ms > scene.cell.creep_ms {
            let text = format!("a joint moves for {} ms, {}", self.moving_ms, self.why(scene));
            return Err((orders.rule_of_rest(), text));
        }
        for axis in motion.each_axis() {
            let away_rad = (motion.angles_rad[axis] - self.stood_rad[axis]).abs();
            if away_rad > STAND_RAD {
                let text = format!(
                    "joint {axis} is {away_rad:.4} rad from where it stood, {}",
                    self.why(scene)
                );
                return Err((orders.rule_of_rest(), text));
            }
        }
        Ok(())
    }

    fn why(&self, scene: &Scene<'_>) -> &'static str {
        let orders = scene.orders;
        if !orders.is_configured {
            "without a configuration"
        } else if !orders.may_have_power() {
            "without an order for power"
        } else if !orders.may_be_homed() {
            "without known joint angles"
        } else {
            "without an order to move"
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::moment::{Command, Input, Mode, Report};
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    const MOVE: Command = Command::Move {
        position_mm: [20.0, 0.0, -800.0],
    };

    #[test]
    fn a_robot_that_creeps_or_drifts_without_an_order_breaks_the_rule() {
        let mut rig = Rig::idle();
        rig.joints[0].speed_rad_s = 2e-3;
        assert_eq!(rig.run(90), Ok(()), "it may still come to rest");
        let found = rig.run(20);
        assert!(broken(&found, Rule::Permission), "{found:?}");
        let mut rig = Rig::idle();
        rig.accelerate_to(0.9);
        let found = rig.run(50);
        assert!(broken(&found, Rule::Permission), "0.02 rad: {found:?}");
        assert!(rig.time_ms() - rig.started_ms() < 40);
    }

    #[test]
    fn lost_frames_are_no_order_and_false_feedback_is_no_crime() {
        let mut rig = Rig::idle();
        rig.disturb_machine(true);
        rig.accelerate_to(0.9);
        assert!(broken(&rig.run(50), Rule::Permission));
        let mut rig = Rig::idle();
        rig.input(Input::Feedback {
            axis: 0,
            disturbed: true,
        });
        rig.accelerate_to(0.9);
        assert_eq!(rig.run(50), Ok(()));
    }

    #[test]
    fn an_order_permits_until_the_robot_is_reported_at_rest() {
        let mut rig = Rig::idle();
        rig.command(MOVE);
        rig.report(Report::Mode(Mode::Moving));
        rig.accelerate_to(0.1);
        assert_eq!(rig.run(400), Ok(()));
        rig.accelerate_to(0.0);
        assert_eq!(rig.run(20), Ok(()));
        rig.report(Report::Mode(Mode::Idle));
        assert_eq!(rig.run(200), Ok(()));
        rig.accelerate_to(0.1);
        assert!(broken(&rig.run(250), Rule::Permission));
    }

    #[test]
    fn a_refused_order_permits_nothing() {
        let mut rig = Rig::idle();
        rig.input(Input::Commanded(MOVE));
        rig.report(Report::Refused(MOVE));
        rig.accelerate_to(0.1);
        assert!(broken(&rig.run(150), Rule::Permission));
    }

    #[test]
    fn a_robot_whose_angles_are_not_known_may_not_move() {
        let mut rig = Rig::new();
        rig.input(Input::Configured);
        rig.command(Command::Enable);
        rig.power(true);
        rig.report(Report::Homed(false));
        assert_eq!(rig.run(1_000), Ok(()));
        rig.command(MOVE);
        rig.accelerate_to(0.1);
        let found = rig.run(150);
        assert!(broken(&found, Rule::Permission), "{found:?}");
    }

    #[test]
    fn a_jog_ends_with_its_messages() {
        let jog = Command::Jog {
            velocity_mm_s: [30.0, 0.0, 0.0],
        };
        let mut rig = Rig::idle();
        for _ in 0..6 {
            rig.command(jog);
            rig.report(Report::Mode(Mode::Moving));
            rig.accelerate_to(0.05);
            assert_eq!(rig.run(50), Ok(()));
        }
        assert_eq!(rig.run(150), Ok(()), "dead man, pipeline and deceleration");
        assert!(broken(&rig.run(150), Rule::DeadMan));
    }

    #[test]
    fn a_held_drawing_stands_and_a_silent_host_holds_it() {
        let mut rig = Rig::drawing();
        rig.command(Command::Hold);
        rig.accelerate_to(0.05);
        assert_eq!(rig.run(1_000), Ok(()));
        assert!(broken(&rig.run(1_500), Rule::Permission));
        let mut rig = Rig::drawing();
        rig.accelerate_to(0.02);
        rig.input(Input::Link { cut: true });
        assert_eq!(rig.run(1_500), Ok(()));
        assert!(broken(&rig.run(1_500), Rule::Silence));
    }
}
