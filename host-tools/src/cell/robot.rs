//! The robot between motors and pen: joint angles to platform, and the mechanical end stops of the joints.

use super::drive::Drive;
use super::mechanism::Mechanism;
use etherpen::config::Geometry;
use etherpen::robots::{JointAngles, Position};

/// The robot; without a valid geometry it has no platform.
#[derive(Clone, Debug)]
pub(super) struct Robot {
    mechanism: Mechanism,
    platform: Option<Position>,
    unreachable_ms: u64,
    end_stop_ms: u64,
}

impl Robot {
    pub(super) fn new(geometry: &Geometry) -> Self {
        Self {
            mechanism: Mechanism::new(geometry),
            platform: None,
            unreachable_ms: 0,
            end_stop_ms: 0,
        }
    }

    /// Position of the platform; `None` while the joints are where no platform can connect them.
    pub(super) fn platform(&self) -> Option<Position> {
        self.platform
    }

    /// Milliseconds without a possible platform position.
    pub(super) fn unreachable_ms(&self) -> u64 {
        self.unreachable_ms
    }

    /// Milliseconds in which an end stop held a joint.
    pub(super) fn end_stop_ms(&self) -> u64 {
        self.end_stop_ms
    }

    /// Holds a joint at its end stop when it has reached it.
    pub(super) fn limit(&mut self, axis: usize, drive: &mut Drive) {
        let Some([low_rad, high_rad]) = self.mechanism.end_stops_rad().get(axis).copied() else {
            return;
        };
        let joint_rad = drive.joint_rad();
        let inside_rad = joint_rad.max(low_rad).min(high_rad);
        if inside_rad != joint_rad {
            drive.block_at(inside_rad);
            self.end_stop_ms += 1;
        }
    }

    /// Moves the platform to the position for these joint angles.
    pub(super) fn step(&mut self, joints: &JointAngles) -> Option<Position> {
        self.platform = self.mechanism.tool(joints);
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
    fn a_joint_is_held_at_its_end_stop() {
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
        let stop_rad = robot.mechanism.end_stops_rad()[0][1];
        assert!(stop_rad > Geometry::default().ranges_rad()[0][1]);
        assert!((drive.joint_rad() - stop_rad).abs() < 1e-9, "{}", drive.joint_rad());
        assert!(robot.end_stop_ms() > 200);
    }

    #[test]
    fn joints_that_no_platform_connects_are_counted() {
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
