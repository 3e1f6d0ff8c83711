//! Plausibility of an axis's position feedback: commands against measured motion.
//!
//! A [`FeedbackMonitor`] predicts the motion from the commands sent to the drive and compares it with the measured
//! motion every millisecond. It does not use the setpoint: a controller whose feedback does not respond sends ever
//! larger commands, and only these show how far the motor has moved.
//!
//! - **Velocity.** The drive follows the velocity after a delay, modelled as a low-pass of that delay. The *deviation*
//!   is the sum of predicted less measured motion. A wrong delay leaves a motion of up to [`LAG_MS`] at the present
//!   speed; scaling and the drive's clock may be wrong by [`LEAK_PER_RAD`] times the limit.
//! - **Position.** The drive closes the position loop: the velocity that it demands of the motor is computed from the
//!   setpoint, the measured position and the gain of its loop, and takes the place of a velocity command.
//! - **Torque.** A disturbance observer predicts speed and position from torque and inertia; the deviation is its
//!   position error. In addition, the motion is compared with the previous motion, the setpoint and the torque
//!   (`torque_feedback.rs`).
//! - **Noise.** The mean change of the measured speed from one millisecond to the next is an acceleration. Above what
//!   any motor can do, the measurement is noise.
//!
//! Frozen, slipping, reversed and swapped feedback all end in a deviation, at any speed: the sum has no time limit.
//!
//! Invariants: bounded work without a branch on data; all values stay finite; at rest, with drives that hold, nothing
//! adds up.

use super::torque_feedback::{Demanded, TorqueModel};
use crate::config::{Axis, AxisMode};

/// How far the model of a drive's delay may be wrong, ms. A drive with its own sampling clock repeats or skips a
/// position, which takes 1 ms of it.
pub const LAG_MS: f32 = 1.5;
/// Share of the deviation that a radian of motion removes, 1/rad: because of it a wrong scale of [`LEAK_PER_RAD`] times
/// the limit (0.3 % at 0.008 rad) is never a fault.
pub const LEAK_PER_RAD: f32 = 0.4;
/// Share of the deviation that a millisecond removes.
const LEAK_PER_MS: f32 = 1.0e-6;
/// Share of the deviation that a millisecond removes in position mode: an error that the drive leaves standing must not add
/// up.
const LEAK_PER_MS_BY_POSITION: f32 = 5.0e-4;
/// Share of a new value in the mean of the noise: the mean of 32 ms.
const NOISE_SHARE: f32 = 1.0 / 32.0;
/// Change of speed from one millisecond to the next that a drive's own sampling clock can cause, relative to the speed.
const NOISE_PER_SPEED: f32 = 2.0;
/// Part of the deviation limit that applies in torque mode: there an error grows with the square of time and faster.
const TORQUE_LIMIT_SHARE: f32 = 0.25;
/// Part of it that applies in position mode: there an error grows with the square of time.
const POSITION_LIMIT_SHARE: f32 = 0.75;

/// Names of the comparisons; the last three apply in torque mode only.
pub const COMPARISONS: [&str; 5] = ["deviation", "noise", "sudden", "stuck", "pushed"];

/// Why a feedback is implausible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Implausible {
    /// The measured motion differs from the commanded motion.
    Deviation {
        /// Commanded less measured motion, rad at the joint.
        deviation_rad: f32,
        /// The limit, rad.
        limit_rad: f32,
    },
    /// The measured position is too noisy.
    Noise {
        /// Mean acceleration measured, rad/s2 at the joint.
        acceleration_rad_s2: f32,
        /// The limit, rad/s2.
        limit_rad_s2: f32,
    },
}

/// Prediction from a velocity command.
#[derive(Clone, Copy, Debug, PartialEq)]
struct VelocityModel {
    /// Radians a millisecond for a digit, times the share of a new command in the filtered one.
    rad_per_digit: f32,
    /// Share of the filtered command that stays.
    kept: f32,
    /// Filtered command, rad a millisecond.
    expected_rad: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Model {
    Velocity(VelocityModel),
    Torque(TorqueModel),
}

/// Compares commands with measured motion, for one axis; stepped once a millisecond while its drive follows commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedbackMonitor {
    model: Model,
    rad_per_increment: f32,
    leak_per_ms: f32,
    limit_rad: f32,
    noise_limit_rad: f32,
    /// Predicted less measured motion, rad.
    deviation_rad: f32,
    /// Motion measured in the last millisecond, rad.
    moved_rad: f32,
    /// Milliseconds without a position before this one.
    blind_ms: u8,
    /// Mean change of the measured motion, rad a millisecond.
    noise_rad: f32,
    /// Speed that widens the limits, rad a millisecond.
    speed_rad: f32,
}

impl FeedbackMonitor {
    /// A monitor of an axis whose drive takes `digits_per_unit` for a rad/s or an N m at the joint.
    pub fn new(axis: &Axis, mode: AxisMode, digits_per_unit: f64) -> Self {
        let increments_per_rad = axis.gear * f64::from(axis.increments_per_revolution) / core::f64::consts::TAU;
        let share_of = |delay_ms: f64| 1.0 / (1.0 + delay_ms.max(0.0));
        let limit_rad = axis.feedback_deviation_max_rad as f32;
        let model = match mode {
            AxisMode::Velocity | AxisMode::Position => {
                // The lead is that of a velocity in the middle of its millisecond.
                let share = share_of(axis.feed_forward_lead_ms + axis.measurement_age_ms - 0.5);
                Model::Velocity(VelocityModel {
                    rad_per_digit: (share * STEP_S / digits_per_unit) as f32,
                    kept: (1.0 - share) as f32,
                    expected_rad: 0.0,
                })
            }
            AxisMode::Torque => Model::Torque(TorqueModel::new(axis, digits_per_unit)),
        };
        Self {
            model,
            rad_per_increment: (1.0 / increments_per_rad) as f32,
            limit_rad: match mode {
                AxisMode::Velocity => limit_rad,
                AxisMode::Position => POSITION_LIMIT_SHARE * limit_rad,
                AxisMode::Torque => TORQUE_LIMIT_SHARE * limit_rad,
            },
            leak_per_ms: match mode {
                AxisMode::Position => LEAK_PER_MS_BY_POSITION,
                AxisMode::Velocity | AxisMode::Torque => LEAK_PER_MS,
            },
            noise_limit_rad: (axis.feedback_acceleration_max_rad_s2 * STEP_S * STEP_S) as f32,
            deviation_rad: 0.0,
            moved_rad: 0.0,
            blind_ms: 0,
            noise_rad: 0.0,
            speed_rad: 0.0,
        }
    }

    /// Discards all commands and measurements; used while the drive does not follow commands.
    #[cold]
    pub fn reset(&mut self) {
        (self.deviation_rad, self.moved_rad, self.noise_rad, self.speed_rad) = (0.0, 0.0, 0.0, 0.0);
        self.blind_ms = 0;
        match &mut self.model {
            Model::Velocity(model) => model.expected_rad = 0.0,
            Model::Torque(model) => model.reset(),
        }
    }

    /// Advances by one millisecond with a position: `sent_digits` is the command that the drive got in the previous
    /// millisecond, `moved_increments` the motion since the last position. Returns whether they agree.
    #[inline]
    pub fn step(&mut self, sent_digits: i32, moved_increments: i32) -> bool {
        let moved_rad = moved_increments as f32 * self.rad_per_increment;
        let in_one_ms_rad = match self.blind_ms {
            0 => moved_rad,
            _ => self.mean_of_gap(moved_rad),
        };
        let change_rad = (in_one_ms_rad - self.moved_rad).abs();
        self.moved_rad = in_one_ms_rad;
        self.noise_rad += (change_rad - self.noise_rad) * NOISE_SHARE;
        self.expect(sent_digits);
        self.compare(moved_rad);
        let follows = match &mut self.model {
            Model::Velocity(_) => true,
            Model::Torque(model) => model.follows(in_one_ms_rad),
        };
        follows & (self.deviation_rad.abs() <= self.deviation_limit_rad()) & (self.noise_rad <= self.noise_limit_rad())
    }

    /// Advances by one millisecond without a position; the motion expected in it is compared with the next position.
    #[cold]
    pub fn step_blind(&mut self, sent_digits: i32) {
        self.blind_ms = self.blind_ms.saturating_add(1);
        self.expect(sent_digits);
    }

    /// Mean motion of a millisecond, rad, when positions were missing before this one.
    #[cold]
    fn mean_of_gap(&mut self, moved_rad: f32) -> f32 {
        moved_rad / (1.0 + f32::from(core::mem::take(&mut self.blind_ms)))
    }

    /// Sets what the setpoints demand from now on; has an effect in torque mode only.
    pub fn set_demanded(&mut self, demanded: &Demanded) {
        if let Model::Torque(model) = &mut self.model {
            model.set_demanded(demanded);
        }
    }

    /// The comparison that failed; call it after [`Self::step`] has returned false.
    #[cold]
    pub fn implausible(&self) -> Implausible {
        if let Model::Torque(model) = &self.model
            && let Some([deviation_rad, limit_rad]) = model.broken()
        {
            return Implausible::Deviation {
                deviation_rad,
                limit_rad,
            };
        }
        let limit_rad = self.deviation_limit_rad();
        if self.deviation_rad.abs() > limit_rad {
            return Implausible::Deviation {
                deviation_rad: self.deviation_rad.abs(),
                limit_rad,
            };
        }
        let per_rad = (1.0 / (STEP_S * STEP_S)) as f32;
        Implausible::Noise {
            acceleration_rad_s2: self.noise_rad * per_rad,
            limit_rad_s2: self.noise_limit_rad() * per_rad,
        }
    }

    /// Value of each of [`COMPARISONS`] in the last step, relative to its limit. For tests; no board calls it.
    pub fn used(&self) -> [f32; COMPARISONS.len()] {
        let deviation = self.deviation_rad.abs() / self.deviation_limit_rad();
        let noise = self.noise_rad / self.noise_limit_rad();
        let [sudden, stuck, pushed] = match &self.model {
            Model::Velocity(_) => [0.0; 3],
            Model::Torque(model) => model.used(),
        };
        [deviation, noise, sudden, stuck, pushed]
    }

    #[inline]
    fn deviation_limit_rad(&self) -> f32 {
        let unrest_rad = match &self.model {
            Model::Velocity(_) => 0.0,
            Model::Torque(model) => model.unrest_rad(),
        };
        self.limit_rad + unrest_rad + self.speed_rad * LAG_MS
    }

    #[inline]
    fn noise_limit_rad(&self) -> f32 {
        self.noise_limit_rad + NOISE_PER_SPEED * self.speed_rad
    }

    /// Adds the motion that the command causes in a millisecond to the deviation.
    #[inline]
    fn expect(&mut self, sent_digits: i32) {
        let sent = sent_digits as f32;
        match &mut self.model {
            Model::Velocity(model) => {
                let expected_rad = model.expected_rad * model.kept + sent * model.rad_per_digit;
                model.expected_rad = expected_rad;
                self.speed_rad = expected_rad.abs();
                self.deviation_rad += expected_rad;
            }
            Model::Torque(model) => {
                self.deviation_rad += model.expect(sent);
                self.speed_rad = model.speed_rad();
            }
        }
    }

    /// Subtracts the measured motion from the deviation, and corrects the prediction by the remainder.
    #[inline]
    fn compare(&mut self, moved_rad: f32) {
        let deviation_rad = self.deviation_rad - moved_rad;
        match &mut self.model {
            Model::Velocity(_) => {
                let leak = self.leak_per_ms + LEAK_PER_RAD * self.speed_rad;
                self.deviation_rad = deviation_rad - deviation_rad * leak;
            }
            Model::Torque(model) => self.deviation_rad = model.correct(deviation_rad),
        }
    }
}

/// Length of a step, s.
const STEP_S: f64 = 1.0e-3;

#[cfg(test)]
mod tests;
