//! Implausible feedback while the robot has power and no reference, in both modes of the drives. The truth is the
//! cell's: how far a joint has turned.

use crate::STILL_RAD_S;
use crate::robot::Robot;
use etherpen::application::Mode;
use etherpen::config::{AxisMode, Config};
use etherpen::messages::Command;
use host_tools::cell::{CellOptions, Fault as CellFault, ResolverFault};

/// Feedback gain around the firmware's own velocity loop, 1/s.
const TORQUE_FEEDBACK_GAIN_PER_S: f64 = 40.0;
/// Time without power after the configuration, ms: longer than anything that is learned when a drive takes its power.
const WITHOUT_POWER_MS: u32 = 3_000;

#[test]
pub(crate) fn feedback_that_cannot_be_true_is_a_fault_without_a_reference_too() {
    for mode in [AxisMode::Velocity, AxisMode::Torque] {
        for (what, fault) in [
            ("reversed", ResolverFault::Reversed),
            ("noisy", ResolverFault::Noise(8_000)),
        ] {
            let mut config = Config::default();
            for axis in config.axes.iter_mut().filter(|_| mode == AxisMode::Torque) {
                (axis.mode, axis.feedback_gain_per_s) = (mode, TORQUE_FEEDBACK_GAIN_PER_S);
            }
            let mut robot = Robot::of(&config, CellOptions::default());
            robot.configure(&config);
            robot.wait_for(Mode::DrivesOff);
            robot.run(WITHOUT_POWER_MS);
            robot.command(Command::Enable).unwrap();
            robot.wait_for(Mode::Unreferenced);
            robot.run(500);
            assert_eq!(robot.fault(), None, "{mode:?}: the robot only holds");
            let before = robot.cell().joints.0[0];
            robot.inject(CellFault::Resolver(1, fault, 1_000_000));
            robot.run(1_000);
            let turned_rad = (robot.cell().joints.0[0] - before).abs();
            println!("{mode:?}, {what}: {:?}, turned by {turned_rad:.4} rad", robot.fault());
            assert!(turned_rad < 0.02, "{mode:?}, {what}: {turned_rad} rad");
            let is_standing = robot.speed_rad_s() < STILL_RAD_S && !matches!(robot.mode(), Mode::Unreferenced);
            // A reversed position of a joint that holds still is the same position.
            assert!(
                is_standing || what == "reversed",
                "{mode:?}, {what}: {:?}",
                robot.status
            );
        }
    }
}
