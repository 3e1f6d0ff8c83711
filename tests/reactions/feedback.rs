//! False position feedback: how soon it is detected, and how far the pen has moved by then.
//!
//! One case is a motion with a fault, chosen at random from a seed. The truth is the cell's: the moment at which a
//! drive begins to brake, and where the motors have brought the pen. `feedback_scan.rs` tries many.

use super::STILL_RAD_S;
use super::robot::{Robot, path};
use etherpen::application::{Fault, Mode};
use etherpen::config::{AxisMode, Config};
use etherpen::messages::Command;
use etherpen::robots::{MAIN_AXES, Position};
use host_tools::cell::{DriveState, Fault as CellFault, InkStroke, ResolverFault};
use host_tools::random::Random;

/// Where a motion begins, mm.
const POSES_MM: [[f64; 3]; 4] = [
    [0.0, 0.0, -800.0],
    [140.0, 0.0, -760.0],
    [-90.0, 140.0, -840.0],
    [-150.0, -130.0, -780.0],
];
/// Fastest jog, mm/s: faster motions are moves at this travel speed.
const JOG_MAX_MM_S: f64 = 250.0;
/// Distance driven with a fault before the operator lets go, mm.
const JOG_DISTANCE_MM: f64 = 90.0;
/// Distances of a move that are tried, mm.
const MOVE_DISTANCES_MM: [f64; 6] = [300.0, 240.0, 180.0, 120.0, 60.0, 30.0];
/// Speed above which a move has to accelerate harder than the default configuration to reach it, mm/s.
const GENTLE_MAX_MM_S: f64 = 1_000.0;
/// Acceleration along the path for that, mm/s2.
pub(crate) const HARD_MM_S2: f64 = 50_000.0;
/// Time between two signs of life of the operator, ms.
const SIGN_OF_LIFE_MS: u32 = 40;
/// Longest duration of a fault, ms.
const LONG_MS: u64 = 1_000_000;
/// Speed of a joint from which on the robot counts as moving, rad/s: a tenth of the slowest motion's.
const MOVES_RAD_S: f64 = 2.0e-3;
/// Feedback gain around the firmware's own velocity loop, 1/s: a third of that loop's default bandwidth.
const TORQUE_FEEDBACK_GAIN_PER_S: f64 = 40.0;
/// Gain of the position loop of the cell's drives, 1/s.
const POSITION_GAIN_PER_S: f64 = 100.0;

/// A feedback fault of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    Frozen,
    Slipping,
    SlippingHalf,
    Jumped,
    Reversed,
    Exchanged,
    Noisy,
}

impl Kind {
    pub(crate) const ALL: [Self; 7] = [
        Self::Frozen,
        Self::Slipping,
        Self::SlippingHalf,
        Self::Jumped,
        Self::Reversed,
        Self::Exchanged,
        Self::Noisy,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Frozen => "frozen",
            Self::Slipping => "slipping: 10 % of the motion lost",
            Self::SlippingHalf => "slipping: 50 % of the motion lost",
            Self::Jumped => "jumped by 0.02 rad",
            Self::Reversed => "reversed",
            Self::Exchanged => "exchanged with the next arm's",
            Self::Noisy => "noisy: 0.004 rad at most",
        }
    }

    /// The cell's fault for an axis, from 0; a duration of 0 ms ends the fault.
    fn injected(self, axis: usize, milliseconds: u64) -> CellFault {
        let drive = axis + 1;
        let resolver = |fault| CellFault::Resolver(drive, fault, milliseconds);
        match self {
            Self::Frozen => resolver(ResolverFault::Stuck),
            Self::Slipping => resolver(ResolverFault::Slip(90)),
            Self::SlippingHalf => resolver(ResolverFault::Slip(50)),
            Self::Jumped if milliseconds > 0 => CellFault::Jump(drive, 40_000),
            Self::Jumped => resolver(ResolverFault::Stuck),
            Self::Reversed => resolver(ResolverFault::Reversed),
            Self::Exchanged => CellFault::Exchange(drive, (axis + 1) % MAIN_AXES + 1, milliseconds),
            Self::Noisy => resolver(ResolverFault::Noise(8_000)),
        }
    }
}

/// One motion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Case {
    kind: Option<Kind>,
    speed_mm_s: f64,
    axis: usize,
    direction: [f64; 3],
    start_mm: [f64; 3],
    /// Whether the fault begins in motion; else before it.
    moving: bool,
}

/// Result of a case.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Outcome {
    /// From the fault, or from the first motion after it, to the first drive that brakes, ms.
    pub(crate) noticed_ms: Option<u32>,
    /// Largest distance of the pen from its line, mm.
    pub(crate) deviation_mm: f64,
    /// How far the pen has moved along its line, mm.
    pub(crate) way_mm: f64,
}

pub(crate) fn case(kind: Option<Kind>, speed_mm_s: f64, seed: u64) -> Case {
    let mut random = Random::new(seed ^ (speed_mm_s.to_bits() << 1));
    let mut pick = |count: usize| (random.bits() % count as u64) as usize;
    let start_mm = POSES_MM[pick(POSES_MM.len())];
    let axis = pick(MAIN_AXES);
    let moving = pick(2) == 1;
    let azimuth = f64::from(pick(3600) as u16) * std::f64::consts::TAU / 3600.0;
    // Up from below, down from above: there is room.
    let rise = [0.0, if start_mm[2] > -800.0 { -0.3 } else { 0.3 }][pick(2)];
    let flat = f64::sqrt(1.0 - rise * rise);
    // Towards the middle, so that there is room.
    let inward = -(start_mm[0] * azimuth.cos() + start_mm[1] * azimuth.sin());
    let turn = if inward < 0.0 { -1.0 } else { 1.0 };
    Case {
        kind,
        speed_mm_s,
        axis,
        direction: [turn * flat * azimuth.cos(), turn * flat * azimuth.sin(), rise],
        start_mm,
        moving,
    }
}

/// Distance from the start along a direction, and from the line that begins there and ends after `end_mm`.
fn along_and_across(start: Position, direction: [f64; 3], at: Position, end_mm: f64) -> (f64, f64) {
    let offset = [at.x_mm - start.x_mm, at.y_mm - start.y_mm, at.z_mm - start.z_mm];
    let along: f64 = offset.iter().zip(direction).map(|(a, b)| a * b).sum();
    let along = along.clamp(0.0, end_mm);
    let beside: f64 = offset.iter().zip(direction).map(|(a, b)| (a - along * b).powi(2)).sum();
    (along, beside.sqrt())
}

/// Starts the move of a fast case; a slow case is a jog that the caller repeats. Returns the distance, mm.
fn start_motion(robot: &mut Robot, case: &Case, start: Position) -> f64 {
    if case.speed_mm_s <= JOG_MAX_MM_S {
        return JOG_DISTANCE_MM;
    }
    for distance_mm in MOVE_DISTANCES_MM {
        let [x, y, z] = case.direction.map(|part| part * distance_mm);
        let position = Position {
            x_mm: start.x_mm + x,
            y_mm: start.y_mm + y,
            z_mm: start.z_mm + z,
        };
        if robot.command(Command::Move { position }).is_ok() {
            return distance_mm;
        }
    }
    assert!(
        robot.fault().is_some() || robot.mode() != Mode::Idle,
        "no room to move: {case:?}"
    );
    JOG_DISTANCE_MM
}

pub(crate) fn drive(robot: &mut Robot, case: &Case) -> Outcome {
    let [x_mm, y_mm, z_mm] = case.start_mm;
    let target = Position { x_mm, y_mm, z_mm };
    robot.command(Command::Move { position: target }).unwrap();
    robot.run(20);
    robot.wait_for(Mode::Idle);
    robot.run(100);
    let start = robot.cell().platform.expect("the robot holds a platform");
    if let (Some(kind), false) = (case.kind, case.moving) {
        robot.inject(kind.injected(case.axis, LONG_MS));
    }
    let distance_mm = start_motion(robot, case, start);
    let is_jog = case.speed_mm_s <= JOG_MAX_MM_S;
    let velocity_mm_s = case.direction.map(|part| (part * case.speed_mm_s) as f32);
    let limit_ms = (2_000.0 + distance_mm / case.speed_mm_s * 1_000.0) as u32;
    // A jog continues for its dead-man time; a move ends at its point.
    let end_mm = if is_jog { f64::INFINITY } else { distance_mm };
    let mut outcome = Outcome::default();
    let (mut injected, mut moved_ms, mut still_ms, mut before) = (!case.moving, None, 0, 0.0);
    for ms in 0..limit_ms {
        let cell = robot.cell();
        let at = cell.platform.unwrap_or(start);
        let (along, beside) = along_and_across(start, case.direction, at, end_mm);
        let is_fast = (along - before) * 1_000.0 >= 0.95 * case.speed_mm_s || along > 0.3 * distance_mm;
        before = along;
        let braking = cell
            .slaves
            .iter()
            .any(|slave| slave.drive != DriveState::OperationEnabled);
        if let (Some(kind), false, true) = (case.kind, injected, is_fast) {
            robot.inject(kind.injected(case.axis, LONG_MS));
            (injected, moved_ms) = (true, Some(ms));
        }
        if injected && moved_ms.is_none() && robot.speed_rad_s() > MOVES_RAD_S {
            moved_ms = Some(ms);
        }
        outcome.deviation_mm = outcome.deviation_mm.max(beside);
        outcome.way_mm = outcome.way_mm.max(along);
        if braking && outcome.noticed_ms.is_none() {
            // A fault at rest may be noticed before anything moves.
            outcome.noticed_ms = Some(moved_ms.map_or(0, |moved_ms| ms - moved_ms));
        }
        still_ms = if robot.speed_rad_s() < STILL_RAD_S {
            still_ms + 1
        } else {
            0
        };
        if still_ms > 100 && ms > 200 {
            break;
        }
        if ms % SIGN_OF_LIFE_MS == 0 && is_jog && !braking && along < distance_mm {
            robot.say(Command::Jog { velocity_mm_s });
        }
        robot.run(1);
    }
    outcome
}

/// Ends and acknowledges the fault, and takes the reference at the true joint angles.
pub(crate) fn recover(robot: &mut Robot, case: &Case) {
    if let Some(kind) = case.kind {
        robot.inject(kind.injected(case.axis, 0));
    }
    robot.run(300);
    if robot.fault().is_some() {
        robot.wait_for(Mode::Fault);
        let fault = robot.fault().unwrap();
        robot.run(20);
        robot.command(Command::Acknowledge).unwrap();
        robot.wait_for(Mode::DrivesOff);
        let referenced = robot.status.as_ref().unwrap().referenced;
        assert!(!referenced, "{case:?}: {fault:?} leaves the robot referenced");
    } else {
        robot.wait_for(Mode::Idle);
        robot.run(20);
    }
    let pose = robot.cell().joints;
    robot.command(Command::HomeAt { pose, position: None }).unwrap();
    robot.run(100);
    if robot.mode() == Mode::DrivesOff {
        robot.command(Command::Enable).unwrap();
    }
    robot.wait_for(Mode::Idle);
}

/// A configuration with all drives in a mode, in which the pen reaches a speed.
pub(crate) fn with(mode: AxisMode, speed_mm_s: f64) -> Config {
    let mut config = in_mode(mode);
    config.motion.travel_speed_mm_s = speed_mm_s.max(JOG_MAX_MM_S);
    if speed_mm_s > GENTLE_MAX_MM_S {
        config.motion.acceleration_mm_s2 = HARD_MM_S2;
    }
    config
}

/// The default configuration with all drives in a mode.
pub(crate) fn in_mode(mode: AxisMode) -> Config {
    with_mode(Config::default(), mode)
}

/// A configuration with all drives in a mode.
pub(crate) fn with_mode(mut config: Config, mode: AxisMode) -> Config {
    for axis in &mut config.axes {
        axis.mode = mode;
        match mode {
            AxisMode::Velocity => {}
            AxisMode::Torque => axis.feedback_gain_per_s = TORQUE_FEEDBACK_GAIN_PER_S,
            AxisMode::Position => axis.feedback_gain_per_s = POSITION_GAIN_PER_S,
        }
    }
    config
}

/// Distance of a point from a line between two others, mm.
fn from_line_mm(point: [f64; 2], [begin, end]: [[f64; 2]; 2]) -> f64 {
    let (along, from) = ([0, 1].map(|k| end[k] - begin[k]), [0, 1].map(|k| point[k] - begin[k]));
    let square = along[0] * along[0] + along[1] * along[1];
    let part = match square > 0.0 {
        true => ((from[0] * along[0] + from[1] * along[1]) / square).clamp(0.0, 1.0),
        false => 0.0,
    };
    (from[0] - part * along[0]).hypot(from[1] - part * along[1])
}

/// Distance of a point from the line of a stroke beside the point of ink that is nearest to it, mm.
fn from_stroke_mm(point: [f64; 2], stroke: &InkStroke) -> f64 {
    let points = &stroke.points_mm;
    let (mut nearest, mut least) = (0, f64::INFINITY);
    for (index, [x_mm, y_mm]) in points.iter().enumerate() {
        let square = (x_mm - point[0]) * (x_mm - point[0]) + (y_mm - point[1]) * (y_mm - point[1]);
        if square < least {
            (nearest, least) = (index, square);
        }
    }
    let beside = points[nearest.saturating_sub(1)..].windows(2).take(2);
    let distances = beside.map(|pair| from_line_mm(point, [pair[0], pair[1]]));
    distances.fold(least.sqrt(), f64::min)
}

/// Largest distance of the points of some ink from the lines of other ink, and the other way round, mm.
pub(crate) fn apart_mm(ink: &[InkStroke], other: &[InkStroke]) -> f64 {
    let off_mm = |point: &[f64; 2], lines: &[InkStroke]| {
        let distances = lines.iter().map(|stroke| from_stroke_mm(*point, stroke));
        distances.fold(f64::INFINITY, f64::min)
    };
    let farthest_mm = |ink: &[InkStroke], lines: &[InkStroke]| {
        let points = ink.iter().flat_map(|stroke| &stroke.points_mm);
        points.fold(0.0, |most: f64, point| most.max(off_mm(point, lines)))
    };
    farthest_mm(ink, other).max(farthest_mm(other, ink))
}

#[test]
pub(crate) fn after_a_frozen_feedback_the_next_drawing_comes_out_right() {
    let mut sound = Robot::idle();
    sound.draw(path());
    sound.run_until("the path is executed", |robot| {
        robot.ack.finished && robot.mode() == Mode::Idle
    });
    let expected = sound.ink();

    let mut robot = Robot::drawing();
    robot.inject(CellFault::Resolver(1, ResolverFault::Stuck, LONG_MS));
    robot.run_until("a fault is told", |robot| robot.fault().is_some());
    assert!(
        matches!(robot.fault(), Some(Fault::FeedbackDeviation { axis: 0, .. })),
        "{:?}",
        robot.fault()
    );
    let strokes = robot.ink().len();
    let mended = Case {
        kind: Some(Kind::Frozen),
        ..case(None, 5.0, 1)
    };
    recover(&mut robot, &Case { axis: 0, ..mended });
    robot.draw(path());
    robot.run_until("the path is executed", |robot| {
        robot.ack.finished && robot.mode() == Mode::Idle
    });
    let drawn = &robot.ink()[strokes..];
    let apart_mm = apart_mm(drawn, &expected);
    println!("the drawing after the fault is {apart_mm:.3} mm from the one of a sound robot");
    assert!(apart_mm < 0.2, "{apart_mm} mm");
}
