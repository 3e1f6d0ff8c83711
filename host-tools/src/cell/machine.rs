//! The machine that the segment's motors turn: gears, robot, pen and paper.

use super::calibration::{Placing, Residues};
use super::coupled::Coupled;
use super::dynamics::Dynamics;
use super::joint::{Gear, Joint};
use super::mechanism::Mechanism;
use super::paper::Sheet;
use super::pen_lift::PenLift;
use super::physics::{LoopKind, Physics};
use super::robot::Robot;
use super::vibration::Vibration;
use etherpen::config::Config;
use etherpen::robots::{AXES, JointAngles, LINEAR_MM_PER_RAD, MAIN_AXES, Position};
use etherpen_segment::{Load, STEP_S, Shaft};

/// Motion of the joints that only have a torque.
#[derive(Clone, Debug)]
enum Motion {
    /// Smooth friction and no play, for drives that move their motors by themselves unless they are in torque mode.
    Smooth(Box<Dynamics>),
    /// Dry friction that holds, and play.
    Coupled(Box<Coupled>),
}

/// Everything that the motors turn.
#[derive(Clone, Debug)]
pub(super) struct Machine {
    /// The gear at each slave, used if the slave has a motor.
    gears: Vec<Gear>,
    motion: Motion,
    pub(super) robot: Robot,
    vibration: Option<Vibration>,
    placing: Option<Placing>,
    pub(super) sheet: Sheet,
    /// Where the axes are that the machine lacks.
    resting: JointAngles,
    pen_lift: Option<PenLift>,
    /// Whether the tool is off: nothing touches the sheet.
    is_dark: bool,
    /// The joint, from 0, that a hand pushes, and the angle to which it does, rad.
    push: Option<(usize, f64)>,
}

/// Speed with which a hand pushes a joint, rad/s.
const PUSH_RAD_S: f64 = 0.5;

/// The joints of the axes that a machine lacks: a missing height is that of the paper, with the pen down. The other joints
/// are at 0.
pub(super) fn resting(config: &Config) -> JointAngles {
    let mut joints = JointAngles([0.0; AXES]);
    if usize::from(config.bus.drives) < MAIN_AXES {
        let [.., height, _] = &mut joints.0;
        *height = config.paper.pen_down_z_mm / LINEAR_MM_PER_RAD;
    }
    joints
}

impl Machine {
    /// The machine at rest, with a gear for each slave of the chain.
    pub(super) fn new(
        config: &Config,
        gears: Vec<Gear>,
        joints: &JointAngles,
        physics: &Physics,
        residues: &Residues,
    ) -> Self {
        let mechanism = Mechanism::new(&config.geometry).with(physics.payload.mass_kg, residues.mechanism);
        let mut robot = Robot::new(mechanism.clone());
        robot.step(joints);
        let differs = residues.mechanism.is_some() || physics.calibration.sync_mrad > 0.0;
        Self {
            gears,
            motion: Motion::new(mechanism, physics, joints),
            robot,
            vibration: Vibration::new(&physics.structural_mode),
            placing: differs
                .then(|| Placing::new(&config.geometry, &config.paper, residues))
                .flatten(),
            sheet: Sheet::new(physics.paper(&config.paper)),
            resting: resting(config),
            pen_lift: PenLift::new(config),
            is_dark: false,
            push: None,
        }
    }

    /// Pushes a joint, from 0, by hand to an angle, rad, against whatever holds it.
    pub(super) fn push(&mut self, axis: usize, to_rad: f64) {
        self.push = Some((axis, to_rad));
    }

    /// Pushes for a millisecond.
    fn push_on(&mut self, joints: &mut [Joint]) {
        let Some((axis, to_rad)) = self.push else { return };
        let Some(joint) = joints.get_mut(axis) else { return };
        let left_rad = to_rad - joint.angle_rad();
        let most_rad = PUSH_RAD_S * STEP_S;
        if left_rad.abs() <= most_rad {
            self.push = None;
        }
        joint.turn(left_rad.clamp(-most_rad, most_rad) / STEP_S, STEP_S);
    }

    /// The joints of the axes that the machine lacks; the other joints are at 0.
    pub(super) fn resting(&self) -> JointAngles {
        self.resting
    }

    /// Takes what the pen's output asks for: 0 down, 1 up.
    pub(super) fn move_pen(&mut self, height: f64) {
        if let Some(lift) = &mut self.pen_lift {
            lift.aim(height);
        }
    }

    /// Switches a laser or a dispenser on or off.
    pub(super) fn switch_tool(&mut self, is_on: bool) {
        self.is_dark = !is_on;
    }

    /// The gear at a slave, from 1.
    pub(super) fn gear(&self, slave: usize) -> Option<Gear> {
        slave.checked_sub(1).and_then(|index| self.gears.get(index)).copied()
    }

    /// Replaces the main joints' angles and speeds at the motors by those behind the play of their gears.
    pub(super) fn behind_play(&self, angles_rad: &mut [f64; AXES], speeds_rad_s: &mut [f64; AXES]) {
        let Motion::Coupled(coupled) = &self.motion else {
            return;
        };
        if let Some((angles, speeds)) = coupled.load_side() {
            angles_rad
                .iter_mut()
                .zip(angles)
                .for_each(|(here, angle)| *here = angle);
            speeds_rad_s
                .iter_mut()
                .zip(speeds)
                .for_each(|(here, speed)| *here = speed);
        }
    }
}

impl Motion {
    fn new(mechanism: Mechanism, physics: &Physics, joints: &JointAngles) -> Self {
        let Physics { friction, backlash, .. } = *physics;
        let smooth = physics.velocity_loop.kind == LoopKind::Lag
            && friction.stiction_factor <= 1.0
            && backlash.gap_arcmin <= 0.0;
        if smooth {
            return Self::Smooth(Box::new(Dynamics::new(mechanism, friction)));
        }
        let gap_rad = (backlash.gap_arcmin / 60.0).to_radians();
        let [a, b, c, ..] = joints.0;
        Self::Coupled(Box::new(Coupled::new(mechanism, friction, gap_rad, [a, b, c])))
    }
}

impl Load for Machine {
    fn step(&mut self, time_ms: u64, shafts: &mut [Shaft<'_>]) {
        let with_gears = shafts
            .iter_mut()
            .filter_map(|shaft| Some((self.gear(shaft.slave())?, shaft)));
        let mut joints: Vec<Joint> = with_gears.map(|(gear, shaft)| Joint::new(shaft, gear)).collect();
        match &mut self.motion {
            Motion::Smooth(dynamics) => dynamics.step(&mut joints),
            Motion::Coupled(coupled) => coupled.step(&mut joints),
        }
        self.push_on(&mut joints);
        for (axis, joint) in joints.iter_mut().enumerate() {
            self.robot.limit(axis, joint);
        }
        let mut angles = self.resting;
        for (angle, joint) in angles.0.iter_mut().zip(&joints) {
            *angle = joint.angle_rad();
        }
        self.behind_play(&mut angles.0, &mut [0.0; AXES]);
        let lifted_mm = self.pen_lift.as_mut().map_or(0.0, PenLift::step);
        if let Some(platform) = self.robot.step(&angles) {
            let pen = match &mut self.vibration {
                Some(vibration) => vibration.step(platform),
                None => platform,
            };
            let pen = self.placing.map_or(pen, |placing| placing.on_paper(pen));
            let z_mm = if self.is_dark {
                f64::INFINITY
            } else {
                pen.z_mm + lifted_mm
            };
            self.sheet.step(time_ms, Position { z_mm, ..pen });
        }
    }
}
