//! Plausibility of an axis's position feedback: commands against measured motion.
//!
//! A [`FeedbackMonitor`] predicts the motion from the commands sent to the drive and compares it with the measured
//! motion every millisecond. It does not use the setpoint: a controller whose feedback does not respond sends ever
//! larger commands, and only these show how far the motor has moved.
//!
//! - **Velocity.** The drive follows the velocity after a delay, modelled as a low-pass of that delay. The *deviation*
//!   is the sum of predicted less measured motion. A wrong delay leaves a motion of up to [`LAG_MS`] at the present
//!   speed; scaling and the drive's clock may be wrong by [`LEAK_PER_RAD`] times the limit.
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
/// Share of a new value in the mean of the noise: the mean of 32 ms.
const NOISE_SHARE: f32 = 1.0 / 32.0;
/// Change of speed from one millisecond to the next that a drive's own sampling clock can cause, relative to the speed.
const NOISE_PER_SPEED: f32 = 2.0;
/// Part of the deviation limit that applies in torque mode: there an error grows with the square of time and faster.
const TORQUE_LIMIT_SHARE: f32 = 0.25;

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
            AxisMode::Velocity => {
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
                AxisMode::Torque => TORQUE_LIMIT_SHARE * limit_rad,
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
                let leak = LEAK_PER_MS + LEAK_PER_RAD * self.speed_rad;
                self.deviation_rad = deviation_rad - deviation_rad * leak;
            }
            Model::Torque(model) => self.deviation_rad = model.correct(deviation_rad),
        }
    }
}

/// Length of a step, s.
const STEP_S: f64 = 1.0e-3;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::position::PositionController;
    use host_tools::random::Random;
    use std::collections::VecDeque;

    /// Digits for a rad/s at the joint, and increments for a radian, of the default axis.
    const DIGITS: f64 = 16_021.0;
    const INCREMENTS: f64 = 12.0 * 1_048_576.0 / core::f64::consts::TAU;

    /// A drive with the delays of the default axis: a millisecond each way and a loop of 100 Hz.
    struct Drive {
        commands: VecDeque<i32>,
        positions: VecDeque<f64>,
        speed_rad_s: f64,
        angle_rad: f64,
        shown: i64,
    }

    impl Drive {
        fn new() -> Self {
            Self {
                commands: VecDeque::from([0]),
                positions: VecDeque::from([0.0]),
                speed_rad_s: 0.0,
                angle_rad: 0.0,
                shown: 0,
            }
        }

        /// One millisecond: the change of the position that the bus sees, increments.
        fn step(&mut self, digits: i32, shows: impl Fn(f64) -> f64) -> i32 {
            self.commands.push_back(digits);
            let wanted_rad_s = f64::from(self.commands.pop_front().unwrap()) / DIGITS;
            let decay = libm::exp(-core::f64::consts::TAU * 100.0 * STEP_S);
            self.speed_rad_s = wanted_rad_s + (self.speed_rad_s - wanted_rad_s) * decay;
            self.angle_rad += self.speed_rad_s * STEP_S;
            self.positions.push_back(self.angle_rad);
            let shown = (shows(self.positions.pop_front().unwrap()) * INCREMENTS) as i64;
            let moved = shown - self.shown;
            self.shown = shown;
            moved as i32
        }
    }

    fn monitor() -> FeedbackMonitor {
        FeedbackMonitor::new(&Axis::default(), AxisMode::Velocity, DIGITS)
    }

    /// A velocity that wanders between the limits of speed and acceleration, rad/s.
    fn wander(random: &mut Random, velocity_rad_s: &mut f64, goal_rad_s: &mut f64, speed_rad_s: f64) -> f64 {
        if (*velocity_rad_s - *goal_rad_s).abs() < 1.0e-9 {
            *goal_rad_s = (2.0 * random.unit() - 1.0) * speed_rad_s;
        }
        let change = (*goal_rad_s - *velocity_rad_s).clamp(-0.25, 0.25);
        *velocity_rad_s += change;
        *velocity_rad_s
    }

    /// One axis in closed loop with the imperfections of a sound machine: friction, noise, telegrams lost in both
    /// directions.
    struct Loop {
        monitor: FeedbackMonitor,
        controller: PositionController,
        drive: Drive,
        ahead: VecDeque<f64>,
        velocity_rad_s: f64,
        goal_rad_s: f64,
        setpoint_rad: f64,
        measured_rad: f64,
        obeyed: i32,
        sent: i32,
        owed: i32,
        made_up_rad_s: f64,
        noise: f64,
        blind_ms: u32,
    }

    /// Friction: a speed by which the drive's loop lags behind until its integral compensates it, rad/s and ms.
    const FRICTION_RAD_S: f64 = 0.016;
    const INTEGRAL_MS: f64 = 20.0;
    /// Noise of the resolver, rad at the joint at most: a tenth of a degree at the motor.
    const NOISE_RAD: f64 = 1.5e-4;
    /// Share of the telegrams that are lost, each way.
    const LOST: f64 = 0.001;
    /// Scale of the drive's velocity, and its clock: 0.1 % wrong.
    const SCALE: f64 = 1.001;

    impl Loop {
        fn new() -> Self {
            Self {
                monitor: monitor(),
                controller: PositionController::new(&Axis::default()),
                drive: Drive::new(),
                ahead: VecDeque::from([0.0; 12]),
                velocity_rad_s: 0.0,
                goal_rad_s: 0.0,
                setpoint_rad: 0.0,
                measured_rad: 0.0,
                obeyed: 0,
                sent: 0,
                owed: 0,
                made_up_rad_s: 0.0,
                noise: 0.0,
                blind_ms: 0,
            }
        }

        /// Advances by one millisecond; returns whether the monitor accepts the feedback.
        fn step(&mut self, random: &mut Random, speed_rad_s: f64) -> bool {
            let sent = self.sent;
            if random.unit() >= LOST {
                self.obeyed = sent;
            }
            let friction_rad_s = FRICTION_RAD_S * libm::tanh(self.drive.speed_rad_s / 0.02);
            self.made_up_rad_s += (friction_rad_s - self.made_up_rad_s) / INTEGRAL_MS;
            let wanted_rad_s = f64::from(self.obeyed) / DIGITS * SCALE - friction_rad_s + self.made_up_rad_s;
            let noise = (2.0 * random.unit() - 1.0) * NOISE_RAD;
            self.owed += self.drive.step((wanted_rad_s * DIGITS) as i32, |angle| angle)
                + ((noise - self.noise) * INCREMENTS) as i32;
            self.noise = noise;
            let next = wander(random, &mut self.velocity_rad_s, &mut self.goal_rad_s, speed_rad_s);
            self.ahead.push_back(next);
            self.ahead.pop_front();
            self.setpoint_rad += self.ahead[0] * STEP_S;
            let believed = if random.unit() < LOST && self.blind_ms < 5 {
                self.blind_ms += 1;
                self.monitor.step_blind(sent);
                true
            } else {
                self.blind_ms = 0;
                let moved = core::mem::take(&mut self.owed);
                self.measured_rad += f64::from(moved) / INCREMENTS;
                self.monitor.step(sent, moved)
            };
            let ahead = self.ahead.iter().copied();
            let command_rad_s = self.controller.step(self.setpoint_rad, self.measured_rad, ahead);
            self.sent = (command_rad_s.clamp(-27.0, 27.0) * DIGITS) as i32;
            believed
        }
    }

    /// Runs 0.05 robot hours of four axes; `ETHERPEN_SOAK_HOURS` sets another duration.
    #[test]
    fn a_sound_axis_with_friction_noise_and_lost_telegrams_is_believed_for_hours() {
        let asked = std::env::var("ETHERPEN_SOAK_HOURS").ok();
        let hours: f64 = asked.map_or(0.05, |hours| hours.parse().expect("a number of hours"));
        let slices = 20_u32;
        let slice_ms = (hours * 3.6e6 * 4.0 / f64::from(slices)) as u64;
        let mut worst = [0.0_f32; 2];
        for slice in 0..slices {
            let speed_rad_s = [0.001, 0.01, 0.1, 1.0, 25.0][slice as usize % 5];
            let (mut axis, mut random) = (Loop::new(), Random::new(u64::from(slice)));
            for ms in 0..slice_ms {
                let believed = axis.step(&mut random, speed_rad_s);
                let fault = axis.monitor.implausible();
                assert!(
                    believed,
                    "{fault:?} at {ms} ms, seed {slice}, up to {speed_rad_s} rad/s"
                );
                let used = axis.monitor.used();
                worst = [worst[0].max(used[0]), worst[1].max(used[1])];
            }
        }
        std::println!(
            "{hours} robot hours of four axes, seeds 0 to {}: deviation up to {:.2}, noise up to {:.2} of their limits",
            slices - 1,
            worst[0],
            worst[1]
        );
        assert!(worst[0] < 0.95 && worst[1] < 0.95, "{worst:?}");
    }

    #[test]
    fn feedback_that_is_frozen_reversed_or_slips_is_noticed_before_the_joint_has_gone_far() {
        // Share of the motion that is shown.
        let wrongs = [
            ("frozen", 0.0, 0.0105),
            ("reversed", -1.0, 0.0065),
            ("slipping", 0.9, 0.13),
            ("doubled", 2.0, 0.0105),
        ];
        for (name, shown, most_rad) in wrongs {
            for velocity_rad_s in [0.0003, 0.003, 0.03, 0.3, -0.3, -0.003] {
                let (mut monitor, mut drive) = (monitor(), Drive::new());
                let noticed = (0..600_000).find(|_| {
                    let digits = (velocity_rad_s * DIGITS) as i32;
                    let moved = drive.step(digits, |angle| shown * angle);
                    !monitor.step(digits, moved)
                });
                let went_rad = drive.angle_rad.abs();
                assert!(noticed.is_some(), "{name} at {velocity_rad_s} rad/s");
                assert!(went_rad < most_rad, "{name} at {velocity_rad_s} rad/s: {went_rad} rad");
            }
        }
    }

    #[test]
    fn noise_that_no_motor_makes_is_told_from_the_steps_of_a_resolver() {
        let run = |amplitude_rad: f64| {
            let (mut monitor, mut random) = (monitor(), Random::new(7));
            let mut before = 0;
            (0..5_000).find_map(|_| {
                let now = ((2.0 * random.unit() - 1.0) * amplitude_rad * INCREMENTS) as i32;
                let sound = monitor.step(0, now - before);
                before = now;
                (!sound).then(|| monitor.implausible())
            })
        };
        assert_eq!(run(1.0e-4), None);
        assert!(matches!(run(2.0e-3), Some(Implausible::Noise { .. })));
    }

    #[test]
    fn a_cycle_without_a_position_costs_nothing() {
        let (mut monitor, mut drive, mut owed) = (monitor(), Drive::new(), 0);
        for ms in 0..20_000 {
            let digits = (5.0 * DIGITS) as i32;
            owed += drive.step(digits, |angle| angle);
            if ms % 10 < 4 {
                monitor.step_blind(digits);
            } else {
                assert!(
                    monitor.step(digits, core::mem::take(&mut owed)),
                    "{:?}",
                    monitor.implausible()
                );
            }
        }
    }

    #[test]
    fn a_load_that_comes_and_goes_is_no_fault_of_the_feedback_in_torque_mode_and_a_runaway_is() {
        let axis = Axis::default();
        let mut monitor = FeedbackMonitor::new(&axis, AxisMode::Torque, 10.0);
        // A quarter of the inertia's weight as a load that changes slowly, held by the torque.
        let moved = |monitor: &mut FeedbackMonitor, torque_nm: f64| monitor.step((torque_nm * 10.0) as i32, 0);
        for ms in 0..5_000 {
            let load_nm = 5.0 * libm::sin(f64::from(ms) / 1_000.0);
            // The torque balances the load; nothing moves.
            assert!(moved(&mut monitor, load_nm), "{:?} at {ms} ms", monitor.implausible());
        }
        let noticed = (0..200).find(|ms| !moved(&mut monitor, -4.8 + f64::from(*ms) * 0.1));
        assert!(noticed.is_some_and(|ms| ms < 100), "{noticed:?}");
    }
}
