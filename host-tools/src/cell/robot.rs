//! The robot between motors and pen: joint angles to platform, and the mechanical end stops of the joints.

use super::joint::Joint;
use super::mechanism::Mechanism;
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
    pub(super) fn new(mechanism: Mechanism) -> Self {
        Self {
            mechanism,
            platform: None,
            unreachable_ms: 0,
            end_stop_ms: 0,
        }
    }

    /// Position of the platform; `None` if no platform can connect the joints.
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
    pub(super) fn limit(&mut self, axis: usize, joint: &mut Joint<'_, '_>) {
        let Some([low_rad, high_rad]) = self.mechanism.end_stops_rad().get(axis).copied() else {
            return;
        };
        let angle_rad = joint.angle_rad();
        let inside_rad = angle_rad.max(low_rad).min(high_rad);
        if inside_rad != angle_rad {
            joint.block_at(inside_rad);
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
    use crate::cell::{Cell, CellOptions, DriveState};
    use etherpen::config::{Config, Geometry};
    use etherpen::robots::DeltaGeometry;
    use etherpen_segment::rig::Rig;

    #[test]
    fn a_joint_is_held_at_its_end_stop() {
        let mut rig = Rig::new(Cell::new(&Config::default(), CellOptions::default()));
        rig.bring_up();
        for _ in 0..500 {
            rig.cycle([200_000, 0, 0, 0], 0x0F);
        }
        let state = rig.bus.state();
        assert_eq!(state.slaves[0].drive, DriveState::OperationEnabled);
        let stop_rad = Robot::new(Mechanism::new(&Geometry::default()))
            .mechanism
            .end_stops_rad()[0][1];
        assert!(stop_rad > Geometry::default().ranges_rad()[0][1]);
        assert!((state.joints.0[0] - stop_rad).abs() < 1e-9, "{state:?}");
        assert!(state.end_stop_ms > 200);
    }

    #[test]
    fn joints_that_no_platform_connects_are_counted() {
        let mut robot = Robot::new(Mechanism::new(&Geometry::default()));
        assert!(robot.step(&JointAngles([0.3; 4])).is_some());
        let geometry = Geometry::Delta(DeltaGeometry {
            forearm_mm: 200.0,
            ..DeltaGeometry::default()
        });
        let mut short = Robot::new(Mechanism::new(&geometry));
        assert_eq!((short.step(&JointAngles([-0.7; 4])), short.unreachable_ms()), (None, 1));
    }
}
