//! Acceleration: no joint gains speed faster than its limit, a stop or its brake can change it.
//!
//! In sound motion a joint gains speed by its configured limit, 25 % for the controller's corrections, and what weight
//! does to a joint whose motor takes over its load. While something is disturbed the correction may turn round within
//! a millisecond: twice the gain times the largest following error come on top. Slowing down is not bounded: a velocity
//! loop, a quick stop and a brake may all be faster than any limit, and no harm comes from it.

use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// One millisecond, s.
const TICK_S: f64 = 1.0e-3;
/// Absolute margin of a change of speed, rad/s.
const CHANGE_RAD_S: f64 = 0.02;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Acceleration;

impl Acceleration {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let motion = scene.motion;
        if !motion.is_steady {
            return Ok(());
        }
        let is_sound = scene.disturbances.none() && !scene.is_power_changing;
        for axis in motion.each_axis() {
            let (now, before) = (motion.speeds_rad_s[axis], motion.speeds_before_rad_s[axis]);
            // Speed gained in the direction of the motion; all of it after a reversal.
            let gained = if now * before > 0.0 {
                now.abs() - before.abs()
            } else {
                now.abs()
            };
            let joint = &scene.bounds.joints[axis];
            let bound = if is_sound {
                joint.acceleration_rad_s2
            } else {
                joint.disturbed_rad_s2
            };
            if gained > bound * TICK_S + CHANGE_RAD_S {
                let text = format!("joint {axis} went from {before:.3} to {now:.3} rad/s, bound {bound:.0} rad/s2");
                return Err((Rule::Acceleration, text));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    #[test]
    fn a_joint_gains_speed_by_its_limit_and_loses_it_as_fast_as_it_can() {
        let mut rig = Rig::moving();
        rig.joints[0].speed_rad_s = 0.25;
        assert_eq!(rig.step(), Ok(()));
        rig.joints[0].speed_rad_s = 0.5;
        assert_eq!(rig.step(), Ok(()));
        rig.joints[0].speed_rad_s = 0.0;
        assert_eq!(rig.step(), Ok(()));
        rig.joints[0].speed_rad_s = 0.6;
        assert!(broken(&rig.step(), Rule::Acceleration));
    }

    #[test]
    fn a_reversal_counts_from_standstill_and_a_disturbance_allows_a_correction() {
        let mut rig = Rig::moving();
        rig.joints[1].speed_rad_s = 0.4;
        assert_eq!(rig.step(), Ok(()));
        rig.joints[1].speed_rad_s = -0.4;
        assert_eq!(rig.step(), Ok(()));
        rig.disturb_machine(true);
        rig.joints[1].speed_rad_s = -7.0;
        assert_eq!(rig.step(), Ok(()));
        rig.joints[1].speed_rad_s = -16.0;
        assert!(broken(&rig.step(), Rule::Acceleration));
    }
}
