//! The delta robot between motors and pen: joint angles to platform, and the mechanical end stops of the arms.

use super::drive::Drive;
use etherpen::config::Geometry;
use etherpen::robot::{ARMS, Delta, JointAngles, Position};

/// Distance of the mechanical end stops behind the ends of the arm range, radians.
const END_STOP_RAD: f64 = 0.05;

/// The mechanism; without a valid geometry it has no platform.
#[derive(Clone, Debug)]
pub(super) struct Robot {
    delta: Option<Delta>,
    arm_range_rad: [f64; 2],
    platform: Option<Position>,
    unreachable_ms: u64,
    end_stop_ms: u64,
}

impl Robot {
    pub(super) fn new(geometry: &Geometry) -> Self {
        Self {
            delta: Delta::new(geometry).ok(),
            arm_range_rad: geometry.arm_range_rad,
            platform: None,
            unreachable_ms: 0,
            end_stop_ms: 0,
        }
    }

    /// Position of the platform; `None` while the arms are in positions that no platform can connect.
    pub(super) fn platform(&self) -> Option<Position> {
        self.platform
    }

    /// Milliseconds without a possible platform position.
    pub(super) fn unreachable_ms(&self) -> u64 {
        self.unreachable_ms
    }

    /// Milliseconds in which an end stop held an arm.
    pub(super) fn end_stop_ms(&self) -> u64 {
        self.end_stop_ms
    }

    /// Holds an arm at its end stop when it has reached it.
    pub(super) fn limit(&mut self, arm: usize, drive: &mut Drive) {
        let [low_rad, high_rad] = self.arm_range_rad;
        let joint_rad = drive.joint_rad();
        let inside_rad = joint_rad.max(low_rad - END_STOP_RAD).min(high_rad + END_STOP_RAD);
        if arm < ARMS && inside_rad != joint_rad {
            drive.block_at(inside_rad);
            self.end_stop_ms += 1;
        }
    }

    /// Moves the platform to the position for these joint angles.
    pub(super) fn step(&mut self, joints: &JointAngles) -> Option<Position> {
        self.platform = self.delta.as_ref().and_then(|delta| delta.forward(joints).ok());
        self.unreachable_ms += u64::from(self.platform.is_none());
        self.platform
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::drive::{Demand, DriveState, MODE_DIGITAL_SPEED};
    use etherpen::config::Axis;

    #[test]
    fn an_arm_is_held_at_its_end_stop() {
        let mut robot = Robot::new(&Geometry::default());
        let mut drive = Drive::new(Axis::default(), 1.5, 100.0);
        drive.mode = MODE_DIGITAL_SPEED;
        for millisecond in 0..500 {
            let control = [0x06, 0x07, 0x0F][(millisecond / 2).min(2)];
            let velocity_digits = 200_000;
            drive.step(Some(Demand {
                velocity_digits,
                control,
                ..Demand::default()
            }));
            robot.limit(0, &mut drive);
        }
        assert_eq!(drive.state(), DriveState::OperationEnabled);
        let stop_rad = Geometry::default().arm_range_rad[1] + END_STOP_RAD;
        assert!((drive.joint_rad() - stop_rad).abs() < 1e-9, "{}", drive.joint_rad());
        assert!(robot.end_stop_ms() > 200);
    }

    #[test]
    fn arms_that_no_platform_connects_are_counted() {
        let mut robot = Robot::new(&Geometry::default());
        assert!(robot.step(&JointAngles([0.3; 4])).is_some());
        let geometry = Geometry {
            forearm_mm: 200.0,
            ..Geometry::default()
        };
        let mut short = Robot::new(&geometry);
        assert_eq!((short.step(&JointAngles([-0.7; 4])), short.unreachable_ms()), (None, 1));
    }
}
