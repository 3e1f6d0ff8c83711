//! Stop: after a stop or a fault every joint decelerates, stands, and stays until enabled again.
//!
//! The drives brake at most 10 ms and their own delays after the command, the opened input or the report of a fault, or
//! after their watchdog if the telegrams do not reach them. Until then a joint may gain speed by its acceleration; from
//! then on its speed falls by the quick stop's deceleration, or by the brake's if that is weaker, with 5 % and 0.1
//! rad/s of margin. At rest it may creep above 1e-3 rad/s for 20 ms. A drive that cannot obey is not judged.
//!
//! After a stop command, and after a fault that only orders a stop, the robot may brake on its path. Then the joints come
//! to rest together, a joint may gain speed where the path bends, and the bound is one for all joints: the time that the
//! quick stop of the slowest to stop would take falls by 0.6 of the time that passes, from 8 ms later on.

use crate::bounds::STILL_RAD_S;
use crate::cell::AXES_MAX;
use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// Milliseconds in a row in which a joint has to be too fast.
const TOO_FAST_MS: u32 = 2;
/// Milliseconds in a row in which a joint that is to stand has to move.
const CREEP_MS: u32 = 20;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct StopRule {
    too_fast_ms: [u32; AXES_MAX],
}

impl StopRule {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let Some(stop) = &scene.orders.stop else {
            self.too_fast_ms = [0; AXES_MAX];
            return Ok(());
        };
        for axis in scene.motion.each_axis() {
            let bound = stop.speed_max_rad_s(axis, scene.now_ms(), scene.bounds);
            let speed = scene.motion.speeds_rad_s[axis].abs();
            let is_fast = speed > bound.max(STILL_RAD_S) && !scene.disturbances.deaf(axis);
            let too_fast_ms = &mut self.too_fast_ms[axis];
            *too_fast_ms = if is_fast { *too_fast_ms + 1 } else { 0 };
            let longest_ms = if bound > 0.0 { TOO_FAST_MS } else { CREEP_MS };
            if *too_fast_ms > longest_ms {
                let passed_ms = scene.now_ms().saturating_sub(stop.since_ms);
                let cause = stop.cause.words();
                let text = format!(
                    "joint {axis} moves at {speed:.4} rad/s {passed_ms} ms after {cause}, bound {bound:.4} rad/s"
                );
                return Err((Rule::Stop, text));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::moment::{Command, Input, Report};
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    /// Stops a moving robot with the deceleration `rad_s2` after `wait_ms`.
    fn stopped(begin: impl Fn(&mut Rig), wait_ms: u32, rad_s2: f64) -> Result<(), crate::Violation> {
        let mut rig = Rig::drawing();
        rig.accelerate_to(1.5);
        rig.run(10)?;
        begin(&mut rig);
        rig.run(wait_ms)?;
        rig.brake(rad_s2);
        rig.run(1_000)
    }

    #[test]
    fn joints_that_brake_in_time_and_hard_enough_have_stopped() {
        assert_eq!(stopped(|rig| rig.command(Command::Stop), 8, 100.0), Ok(()));
        assert_eq!(stopped(|rig| rig.input(Input::StopInput(true)), 9, 100.0), Ok(()));
        assert_eq!(stopped(|rig| rig.input(Input::ClockFailed(true)), 5, 100.0), Ok(()));
        assert_eq!(
            stopped(|rig| rig.report(Report::Fault(Some("x".into()))), 2, 100.0),
            Ok(())
        );
        assert_eq!(stopped(|rig| rig.input(Input::Restarted), 25, 100.0), Ok(()));
    }

    #[test]
    fn joints_that_go_on_or_brake_softly_break_the_rule() {
        assert!(broken(
            &stopped(|rig| rig.command(Command::Stop), 200, 100.0),
            Rule::Stop
        ));
        assert!(broken(&stopped(|rig| rig.command(Command::Stop), 8, 8.0), Rule::Stop));
        assert!(broken(
            &stopped(|rig| rig.input(Input::StopInput(true)), 200, 100.0),
            Rule::Stop
        ));
    }

    #[test]
    fn a_clock_that_fails_for_a_millisecond_stops_everything() {
        let failed = |rig: &mut Rig| {
            rig.input(Input::ClockFailed(true));
            rig.run(1).expect("it brakes next");
            rig.input(Input::ClockFailed(false));
        };
        assert_eq!(stopped(failed, 4, 100.0), Ok(()));
        assert!(broken(&stopped(failed, 200, 100.0), Rule::Stop));
    }

    #[test]
    fn a_stop_on_the_path_may_brake_with_part_of_the_deceleration_and_an_input_ends_it() {
        let late = Report::Fault(Some("CyclesLate { late: 11, limit: 10 }".into()));
        assert_eq!(stopped(|rig| rig.command(Command::Stop), 16, 14.0), Ok(()));
        assert_eq!(stopped(|rig| rig.report(late.clone()), 16, 14.0), Ok(()));
        assert!(broken(&stopped(|rig| rig.command(Command::Stop), 16, 8.0), Rule::Stop));
        let lost = Report::Fault(Some("SlaveLost { slave: 1 }".into()));
        assert!(broken(&stopped(|rig| rig.report(lost.clone()), 9, 14.0), Rule::Stop));
        let both = |rig: &mut Rig| {
            rig.command(Command::Stop);
            rig.input(Input::StopInput(true));
        };
        assert!(broken(&stopped(both, 9, 14.0), Rule::Stop));
    }

    #[test]
    fn a_stop_ends_with_the_power_of_an_enabling_whose_answer_is_lost() {
        let mut rig = Rig::idle();
        rig.command(Command::Stop);
        assert_eq!(rig.run(1_150), Ok(()));
        rig.power(false);
        rig.input(Input::Commanded(Command::Acknowledge));
        rig.report(Report::Fault(None));
        assert_eq!(rig.run(200), Ok(()));
        rig.input(Input::Commanded(Command::Enable));
        assert_eq!(rig.run(50), Ok(()));
        rig.power(true);
        assert_eq!(rig.run(600), Ok(()));
        rig.command(Command::Pen { down: false });
        rig.accelerate_to(0.02);
        assert_eq!(rig.run(300), Ok(()));
    }

    #[test]
    fn a_pulse_on_the_input_stops_nothing() {
        let mut rig = Rig::drawing();
        for _ in 0..10 {
            rig.input(Input::StopInput(true));
            assert_eq!(rig.run(3), Ok(()));
            rig.input(Input::StopInput(false));
            assert_eq!(rig.run(20), Ok(()));
        }
        rig.accelerate_to(0.02);
        assert_eq!(rig.run(500), Ok(()));
    }

    #[test]
    fn a_drive_that_cannot_obey_is_not_judged_until_it_can() {
        let mut rig = Rig::drawing();
        rig.accelerate_to(0.02);
        for axis in 0..4 {
            rig.input(Input::Drive { axis, deaf: true });
        }
        rig.command(Command::Stop);
        assert_eq!(rig.run(500), Ok(()));
        for axis in 0..4 {
            rig.input(Input::Drive { axis, deaf: false });
        }
        assert!(broken(&rig.run(600), Rule::Stop));
    }
}
