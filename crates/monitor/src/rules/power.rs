//! Power: drives have power only after an order for it, and lose it soon after the order ends.
//!
//! Enabling permits power, after a configuration and, after a stop or a fault, after an acknowledgement. A stop, a
//! reported fault, a restart, and an accepted order to disable end the permission. The controller then waits at most
//! 1,000 ms for a standstill and 100 ms for the brakes, and the drives follow within 100 ms. Drives that the telegrams
//! do not reach take their watchdog's time in addition; a drive that cannot obey is not judged.
//!
//! Power is taken from joints that stand: a brake is no means of stopping a robot. Where frames or slaves are disturbed, only
//! an order that takes the power breaks the rule. A drive that cannot obey, and joints whose angles are not true, are not judged.

use crate::cell::AXES_MAX;
use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// Speed up to which a joint stands that loses its power, rad/s, besides the end of its quick stop, which the motor
/// reaches after the drive's delay.
const STANDS_RAD_S: f64 = 0.1;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Power {
    had_power: [bool; AXES_MAX],
}

impl Power {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let (motion, orders) = (scene.motion, scene.orders);
        let had_power = std::mem::replace(&mut self.had_power, motion.has_power);
        let may_cut = scene.disturbances.is_misled() || orders.has_restarted();
        for axis in motion.each_axis().filter(|_| !may_cut) {
            let is_ordered = motion.is_switched_off[axis] && !scene.disturbances.deaf(axis);
            if scene.disturbances.machine_disturbed() && !is_ordered {
                continue;
            }
            let speed = motion.speeds_before_rad_s[axis].abs();
            let late_s = f64::from(scene.cell.drive_delay_ms) / 1_000.0;
            let stands = STANDS_RAD_S + scene.cell.joints[axis].quick_stop_rad_s2 * late_s;
            if had_power[axis] && !motion.has_power[axis] && speed > stands {
                let text = format!("drive {axis} loses its power at {speed:.3} rad/s");
                return Err((Rule::Power, text));
            }
        }
        if orders.may_have_power() {
            return Ok(());
        }
        let ended_ms = orders
            .power_ended_ms
            .map(|ended_ms| scene.now_ms().saturating_sub(ended_ms));
        let watchdog_ms = if scene.disturbances.machine_disturbed() {
            scene.bounds.watchdog_ms
        } else {
            0
        };
        for axis in motion.each_axis().filter(|axis| !scene.disturbances.deaf(*axis)) {
            if !motion.has_power[axis] {
                continue;
            }
            let text = match ended_ms {
                None => format!("drive {axis} has power without an order"),
                Some(ms) if ms > scene.bounds.power_off_ms + watchdog_ms => {
                    format!("drive {axis} still has power {ms} ms after the order for it ended")
                }
                // A drive on its way to power takes as long as a stop needs to reach it.
                Some(ms) if !had_power[axis] && ms > 2 * scene.bounds.reaction_ms + watchdog_ms => {
                    format!("drive {axis} gets power {ms} ms after the order for it ended")
                }
                Some(_) => continue,
            };
            return Err((Rule::Power, text));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::moment::{Command, Input, Report};
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    #[test]
    fn power_without_an_order_breaks_the_rule() {
        let mut rig = Rig::new();
        assert_eq!(rig.run(50), Ok(()));
        rig.power(true);
        assert!(broken(&rig.step(), Rule::Power));
        let mut rig = Rig::new();
        rig.input(Input::Configured);
        rig.input(Input::Commanded(Command::Enable));
        rig.power(true);
        assert_eq!(rig.run(50), Ok(()));
    }

    #[test]
    fn power_is_off_in_time_after_a_stop_and_after_disabling() {
        for command in [Command::Stop, Command::Disable] {
            let mut rig = Rig::idle();
            rig.command(command);
            assert_eq!(rig.run(1_190), Ok(()), "{command:?}");
            let found = rig.run(30);
            assert!(broken(&found, Rule::Power), "{command:?}: {found:?}");
            let mut rig = Rig::idle();
            rig.command(command);
            assert_eq!(rig.run(1_190), Ok(()));
            rig.power(false);
            assert_eq!(rig.run(500), Ok(()), "{command:?}");
        }
    }

    #[test]
    fn power_is_taken_from_joints_that_stand() {
        let lost_at = |rad_s: f64, input: Option<Input>, is_switched_off: bool| {
            let mut rig = Rig::drawing();
            rig.accelerate_to(rad_s);
            assert_eq!(rig.run(4), Ok(()));
            input.into_iter().for_each(|input| rig.input(input));
            rig.power(false);
            rig.joints[0].is_switched_off = is_switched_off;
            rig.step()
        };
        let disturbed = Input::Machine { disturbed: true };
        let untrue = Input::Feedback {
            axis: 1,
            disturbed: true,
        };
        for is_switched_off in [false, true] {
            assert!(broken(&lost_at(0.5, None, is_switched_off), Rule::Power));
            assert_eq!(lost_at(0.05, None, is_switched_off), Ok(()));
            assert_eq!(lost_at(0.05, Some(disturbed), is_switched_off), Ok(()));
            assert_eq!(lost_at(0.5, Some(untrue), is_switched_off), Ok(()));
            assert_eq!(lost_at(0.5, Some(Input::Restarted), is_switched_off), Ok(()));
        }
        assert_eq!(lost_at(0.5, Some(disturbed), false), Ok(()), "by the disturbance");
        assert!(broken(&lost_at(0.5, Some(disturbed), true), Rule::Power), "by an order");
        let deaf = Input::Drive { axis: 0, deaf: true };
        assert_eq!(
            lost_at(0.5, Some(deaf), true),
            Ok(()),
            "an order that it could not take in time"
        );
    }

    #[test]
    fn a_refused_order_gives_no_power_and_a_refused_disabling_takes_none() {
        let mut rig = Rig::new();
        rig.input(Input::Commanded(Command::Enable));
        rig.report(Report::Refused(Command::Enable));
        assert_eq!(rig.step(), Ok(()));
        rig.power(true);
        assert!(broken(&rig.step(), Rule::Power));
        let mut rig = Rig::idle();
        rig.input(Input::Commanded(Command::Disable));
        rig.report(Report::Refused(Command::Disable));
        assert_eq!(rig.run(3_000), Ok(()));
    }

    #[test]
    fn power_that_returns_during_a_stop_breaks_the_rule() {
        let mut rig = Rig::idle();
        rig.command(Command::Stop);
        assert_eq!(rig.run(150), Ok(()));
        rig.power(false);
        assert_eq!(rig.run(50), Ok(()));
        rig.power(true);
        assert!(broken(&rig.step(), Rule::Power));
    }

    #[test]
    fn after_a_fault_power_needs_an_acknowledgement_and_an_order() {
        let mut rig = Rig::idle();
        rig.report(Report::Fault(Some("lost".into())));
        assert_eq!(rig.run(100), Ok(()));
        rig.power(false);
        assert_eq!(rig.run(2_000), Ok(()));
        rig.input(Input::Commanded(Command::Enable));
        assert_eq!(rig.run(10), Ok(()));
        rig.power(true);
        assert!(broken(&rig.step(), Rule::Power), "not acknowledged");
        rig.power(false);
        rig.input(Input::Commanded(Command::Acknowledge));
        rig.report(Report::Fault(None));
        rig.command(Command::Enable);
        rig.power(true);
        assert_eq!(rig.run(100), Ok(()));
    }
}
