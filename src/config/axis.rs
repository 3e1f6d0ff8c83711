//! Configuration of one axis: drive scaling, reference mark, controllers and supervision.

pub use crate::drives::AxisMode;
use crate::drives::DriveSettings;
use crate::ethercat::driver::ExpectedIdentity;
use serde::{Deserialize, Serialize};

/// Configuration of one axis: drive scaling, reference mark, controllers and supervision.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Axis {
    /// Alias of the axis's drive; 0 accepts any.
    pub alias: u16,
    /// Number set with the identification switches of the axis's drive; 0 accepts any.
    pub switch: u16,
    /// Serial number of the axis's drive; 0 accepts any.
    pub serial: u32,
    /// Vendor number of the axis's drive; 0 accepts any.
    pub vendor: u32,
    /// Product code of the axis's drive; 0 accepts any.
    pub product: u32,
    /// Revision of the axis's drive; 0 accepts any.
    pub revision: u32,
    /// How the axis is homed by a switch.
    pub home: HomeSwitch,
    /// What the axis's encoder knows when it is switched on.
    pub encoder: Encoder,
    /// Whether the drive is commanded by velocity, by torque or by position.
    pub mode: AxisMode,
    /// Motor revolutions for one revolution of the joint; negative where the motor turns the other way.
    pub gear: f64,
    /// Encoder increments for one motor revolution.
    pub increments_per_revolution: u32,
    /// Velocity command digits for one motor revolution per minute.
    pub digits_per_rpm: f64,
    /// Joint angle at the synchronisation mark, radians.
    pub sync_angle_rad: f64,
    /// Encoder position at the synchronisation mark, increments; within a motor turn for a single-turn encoder, 0 for a
    /// multi-turn encoder that was never calibrated.
    pub sync_increments: i32,
    /// Feedback gain Kfb, 1/s; in position mode the gain of the drive's own position loop.
    pub feedback_gain_per_s: f64,
    /// Feed-forward gain Kff.
    pub feed_forward_gain: f64,
    /// Lead of the velocity feed-forward, ms.
    pub feed_forward_lead_ms: f64,
    /// Lead of the target position in position mode, ms: the time from a target to the motor.
    pub position_lead_ms: f64,
    /// Age of the measured position when the controller sees it, ms.
    pub measurement_age_ms: f64,
    /// Following error above which a fault is raised, radians.
    pub following_error_max_rad: f64,
    /// Difference between commanded and measured motion above which a fault is raised, radians; the drive's lag is
    /// compensated.
    pub feedback_deviation_max_rad: f64,
    /// Mean acceleration of the measured position above which the position counts as noise, rad/s2; more than the motor
    /// can do.
    pub feedback_acceleration_max_rad_s2: f64,
    /// Largest velocity command, rad/s at the joint.
    pub output_max_rad_s: f64,
    /// Quick-stop deceleration at the joint, rad/s2; at the motor at most 2^32 - 1 increments per second squared, which is what
    /// a drive can be told.
    pub quick_stop_rad_s2: f64,
    /// Torque constant of the motor, N m/A.
    pub torque_constant_nm_a: f64,
    /// Peak current of the drive, A.
    pub peak_current_a: f64,
    /// Rated torque of the motor, N m.
    pub rated_torque_nm: f64,
    /// Largest torque command, N m at the joint.
    pub torque_max_nm: f64,
    /// Inertia of motor and load, kg m2 at the joint; used by the torque feed-forward.
    pub inertia_kg_m2: f64,
    /// Lead of the torque feed-forward, ms.
    pub torque_lead_ms: f64,
    /// Gain of the velocity controller in torque mode, N m for 1 rad/s at the joint.
    pub velocity_gain_nm_s: f64,
    /// Integral gain of the velocity controller relative to its gain, 1/s.
    pub velocity_integral_per_s: f64,
    /// Time constant of the low-pass on the velocity controller's error, ms; 0 switches it off.
    pub velocity_filter_ms: f64,
}

/// What an encoder knows of its place when it is switched on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoder {
    /// Its place within a motor turn, as a resolver does.
    #[default]
    SingleTurn,
    /// Its place within many motor turns, all of the axis's range within 2^31 increments of the mark. The drive's position may wrap at 32
    /// bits, and nowhere else.
    MultiTurn,
    /// Nothing.
    Incremental,
}

/// How an axis is homed by a switch; without an input it is homed by its encoder, at its synchronisation mark.
///
/// The joint's position at the switch is the axis's `sync_angle_rad`. Of two axes that move the tool together, the first has
/// the switch of half of their sum, the second that of half of their difference, and speeds and ways are those of the halves
/// ([`Kind::slides`](crate::robots::Kind::slides)); where both open, the axes are at their `sync_angle_rad`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HomeSwitch {
    /// The input with the role `home`: its place in the configuration's `io`, from 0.
    pub io: Option<u8>,
    /// Axes are homed in this order, those with the same number together.
    pub order: u8,
    /// Speed towards the switch, rad/s; its sign is the direction.
    pub speed_rad_s: f64,
    /// Speed of the second, slow approach, rad/s.
    pub latch_rad_s: f64,
    /// How far the axis goes off the switch, rad.
    pub pull_off_rad: f64,
    /// Longest way to the switch, rad.
    pub travel_max_rad: f64,
}

impl Default for HomeSwitch {
    fn default() -> Self {
        Self {
            io: None,
            order: 0,
            speed_rad_s: -0.5,
            latch_rad_s: 0.05,
            pull_off_rad: 0.03,
            travel_max_rad: 10.0,
        }
    }
}

/// Following error at which a drive in position mode trips, relative to the deviation at which its feedback is not believed.
const DRIVE_WINDOW_SHARE: f64 = 1.5;

impl Axis {
    /// This axis where each command reaches its drive `later_ms` later than the leads say.
    #[must_use]
    pub fn with_later_commands(mut self, later_ms: f64) -> Self {
        for lead_ms in [
            &mut self.feed_forward_lead_ms,
            &mut self.position_lead_ms,
            &mut self.torque_lead_ms,
        ] {
            *lead_ms += later_ms;
        }
        self
    }

    /// Whether nothing shows where the axis is when it is switched on: an incremental encoder, or a multi-turn encoder that was
    /// never calibrated, and no home switch.
    pub fn is_blind(&self) -> bool {
        self.encoder != Encoder::SingleTurn && !self.knows_turns() && self.home.io.is_none()
    }

    /// Whether the axis has a multi-turn encoder that was calibrated: what it shows at the mark is known, and is not written as 0.
    pub fn knows_turns(&self) -> bool {
        self.encoder == Encoder::MultiTurn && self.sync_increments != 0
    }

    /// Identity required of the axis's drive.
    pub fn identity(&self) -> ExpectedIdentity {
        ExpectedIdentity {
            alias: self.alias,
            switch: self.switch,
            serial: self.serial,
            vendor: self.vendor,
            product: self.product,
            revision: self.revision,
        }
    }

    /// Settings of the axis's drive, and the scale of its values.
    pub fn drive(&self) -> DriveSettings {
        DriveSettings {
            identity: self.identity(),
            mode: self.mode,
            gear: self.gear,
            increments_per_revolution: self.increments_per_revolution,
            digits_per_rpm: self.digits_per_rpm,
            quick_stop_rad_s2: self.quick_stop_rad_s2,
            torque_constant_nm_a: self.torque_constant_nm_a,
            peak_current_a: self.peak_current_a,
            rated_torque_nm: self.rated_torque_nm,
            following_error_max_rad: self
                .following_error_max_rad
                .min(DRIVE_WINDOW_SHARE * self.feedback_deviation_max_rad),
        }
    }
}

impl Default for Axis {
    fn default() -> Self {
        Self {
            home: HomeSwitch::default(),
            encoder: Encoder::SingleTurn,
            alias: 0,
            switch: 0,
            serial: 0,
            vendor: 0,
            product: 0,
            revision: 0,
            mode: AxisMode::Velocity,
            gear: 12.0,
            increments_per_revolution: 1 << 20,
            digits_per_rpm: 262_144.0 / 1_875.0,
            sync_angle_rad: 0.0,
            sync_increments: 0,
            feedback_gain_per_s: 80.0,
            feed_forward_gain: 1.0,
            feed_forward_lead_ms: 3.1,
            position_lead_ms: 2.0,
            measurement_age_ms: 1.0,
            following_error_max_rad: 0.05,
            feedback_deviation_max_rad: 0.008,
            feedback_acceleration_max_rad_s2: 600.0,
            output_max_rad_s: 27.0,
            quick_stop_rad_s2: 100.0,
            torque_constant_nm_a: 0.7,
            peak_current_a: 12.0,
            rated_torque_nm: 2.8,
            torque_max_nm: 100.0,
            inertia_kg_m2: 0.3,
            torque_lead_ms: 1.5,
            velocity_gain_nm_s: 36.0,
            velocity_integral_per_s: 40.0,
            velocity_filter_ms: 0.25,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drive_trips_before_its_feedback_could_be_believed_too_long() {
        let window_rad = |own_rad, feedback_rad| {
            let axis = Axis {
                following_error_max_rad: own_rad,
                feedback_deviation_max_rad: feedback_rad,
                ..Axis::default()
            };
            axis.drive().following_error_max_rad
        };
        assert_eq!(window_rad(0.1, 0.01), DRIVE_WINDOW_SHARE * 0.01);
        assert_eq!(window_rad(0.002, 0.01), 0.002);
    }
}
