//! The machine that the segment's motors turn: gears, robot, pen and paper.

use super::dynamics::Dynamics;
use super::joint::{Gear, Joint};
use super::paper::Sheet;
use super::robot::Robot;
use etherpen::config::Config;
use etherpen::robots::{AXES, JointAngles};
use etherpen_segment::{Load, Shaft};

/// Everything that the motors turn.
#[derive(Clone, Debug)]
pub(super) struct Machine {
    /// The gear at each slave, used if the slave has a motor.
    gears: Vec<Gear>,
    dynamics: Dynamics,
    pub(super) robot: Robot,
    pub(super) sheet: Sheet,
}

impl Machine {
    /// The machine at rest, with a gear for each slave of the chain.
    pub(super) fn new(config: &Config, gears: Vec<Gear>, joints: &JointAngles, dry_friction_nm: f64) -> Self {
        let mut robot = Robot::new(&config.geometry);
        robot.step(joints);
        Self {
            gears,
            dynamics: Dynamics::new(&config.geometry, dry_friction_nm),
            robot,
            sheet: Sheet::new(config.paper),
        }
    }

    /// The gear at a slave, from 1.
    pub(super) fn gear(&self, slave: usize) -> Option<Gear> {
        slave.checked_sub(1).and_then(|index| self.gears.get(index)).copied()
    }
}

impl Load for Machine {
    fn step(&mut self, time_ms: u64, shafts: &mut [Shaft<'_>]) {
        let with_gears = shafts
            .iter_mut()
            .filter_map(|shaft| Some((self.gear(shaft.slave())?, shaft)));
        let mut joints: Vec<Joint> = with_gears.map(|(gear, shaft)| Joint::new(shaft, gear)).collect();
        self.dynamics.step(&mut joints);
        for (axis, joint) in joints.iter_mut().enumerate() {
            self.robot.limit(axis, joint);
        }
        let mut angles = [0.0; AXES];
        for (angle, joint) in angles.iter_mut().zip(&joints) {
            *angle = joint.angle_rad();
        }
        if let Some(platform) = self.robot.step(&JointAngles(angles)) {
            self.sheet.step(time_ms, platform);
        }
    }
}
