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
        self.owed +=
            self.drive.step((wanted_rad_s * DIGITS) as i32, |angle| angle) + ((noise - self.noise) * INCREMENTS) as i32;
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

#[test]
fn after_a_reset_nothing_is_left_of_commands_measurements_and_gaps() {
    for mode in [AxisMode::Velocity, AxisMode::Position, AxisMode::Torque] {
        let new = FeedbackMonitor::new(&Axis::default(), mode, DIGITS);
        let mut used = new;
        for _ in 0..20 {
            used.step(4_000, 3_000);
        }
        for _ in 0..3 {
            used.step_blind(4_000);
        }
        used.reset();
        let mut fresh = new;
        for monitor in [&mut used, &mut fresh] {
            monitor.step(0, 900);
        }
        assert_eq!(used, fresh, "{mode:?}");
    }
}
