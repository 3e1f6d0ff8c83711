//! Joints, which the shafts of the segment's motors turn through their gears.

use etherpen::config::Axis;
use etherpen_segment::Shaft;

/// The gear between a motor and its joint.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gear {
    /// Motor revolutions for one revolution of the joint.
    ratio: f64,
    /// Angle of the joint at the motor's angle 0, rad.
    mark_rad: f64,
}

impl Gear {
    /// The gear of an axis whose synchronisation angle is truly larger by `sync_rad`.
    pub(super) fn new(axis: &Axis, sync_rad: f64) -> Self {
        Self {
            ratio: axis.gear,
            mark_rad: axis.sync_angle_rad + sync_rad,
        }
    }

    /// Angle of the joint, rad, for an angle of the motor.
    pub(super) fn joint_rad(self, motor_rad: f64) -> f64 {
        self.mark_rad + motor_rad / self.ratio
    }

    /// Speed of the joint, rad/s, for a speed of the motor.
    pub(super) fn joint_rad_s(self, motor_rad_s: f64) -> f64 {
        motor_rad_s / self.ratio
    }

    /// Angle of the motor, rad, for an angle of the joint.
    pub(super) fn motor_rad(self, joint_rad: f64) -> f64 {
        (joint_rad - self.mark_rad) * self.ratio
    }
}

/// A joint with its motor.
#[derive(Debug)]
pub(super) struct Joint<'a, 'b> {
    shaft: &'a mut Shaft<'b>,
    gear: Gear,
}

impl<'a, 'b> Joint<'a, 'b> {
    pub(super) fn new(shaft: &'a mut Shaft<'b>, gear: Gear) -> Self {
        Self { shaft, gear }
    }

    /// Angle, rad.
    pub(super) fn angle_rad(&self) -> f64 {
        self.gear.joint_rad(self.shaft.angle_rad())
    }

    /// Speed, rad/s.
    pub(super) fn speed_rad_s(&self) -> f64 {
        self.gear.joint_rad_s(self.shaft.speed_rad_s())
    }

    /// Torque of the motor at the joint, N m; `None` where the drive moves the motor by itself.
    pub(super) fn torque_nm(&self) -> Option<f64> {
        self.shaft.torque_nm().map(|torque_nm| torque_nm * self.gear.ratio)
    }

    /// Inertia at the joint, kg m2, of a rotor of this inertia.
    pub(super) fn inertia_kg_m2(&self, rotor_kg_m2: f64) -> f64 {
        self.gear.ratio.powi(2) * rotor_kg_m2
    }

    /// Moves the joint with this acceleration, rad/s2, for a duration.
    pub(super) fn accelerate(&mut self, rad_s2: f64, duration_s: f64) {
        self.shaft.accelerate(rad_s2 * self.gear.ratio, duration_s);
    }

    /// Advances the PI velocity loop of the joint's drive, if it acts, by one of its steps.
    pub(super) fn regulate(&mut self) {
        self.shaft.regulate();
    }

    /// Turns the joint at this speed, rad/s, for a duration.
    pub(super) fn turn(&mut self, rad_s: f64, duration_s: f64) {
        self.shaft.turn(rad_s * self.gear.ratio, duration_s);
    }

    /// Stops the joint at this angle, rad: a mechanical end stop.
    pub(super) fn block_at(&mut self, angle_rad: f64) {
        self.shaft.block_at(self.gear.motor_rad(angle_rad));
    }
}
