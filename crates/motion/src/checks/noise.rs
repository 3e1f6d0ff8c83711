//! Requirements on noise: a line with the noise of a digitiser or of rounding ends at its last vertex, in bounded time.
//!
//! A walk has steps of one scale or of all scales from 1 nm to 1 mm, reversals, repeated vertices and straight runs.
//! Some walks are rounded to the link's micrometre. The time that a walk may take follows from its length and its
//! limits alone.

use super::*;
use crate::settings::Orientation;

/// Environment variable for the number of walks; the default of the test suite takes seconds.
const WALKS: &str = "ETHERPEN_NOISE_WALKS";
const WALKS_OF_THE_SUITE: u64 = 240;
/// Largest duration of a walk relative to a walk that rests at each vertex: where the turn is nearly a reversal, a
/// blend's curvature costs more time than a rest. The longest of 1,200 walks took 0.85 of its bound.
const SLOWER: f64 = 4.0;
/// Time that a walk takes besides its motion, s: averaging, and periods at its ends.
const BESIDE_S: f64 = 0.12;

/// Walks beyond those of the suite: repeated vertices behind a knot of the spline, an override in the second half of a
/// slow blend's interval, and a fast average past repeated vertices.
const EXTRA_SEEDS: [u64; 3] = [4517, 2013, 7682];

fn walks() -> impl Iterator<Item = u64> {
    let asked = std::env::var(WALKS).ok().and_then(|text| text.parse().ok());
    (1..=asked.unwrap_or(WALKS_OF_THE_SUITE)).chain(EXTRA_SEEDS)
}

/// Limits of a walk: mostly the default ones, some far from them.
pub(super) fn limits(random: &mut Random) -> Settings {
    let mut settings = Settings::default();
    if random.below(3) == 0 {
        let motion = &mut settings.motion;
        motion.speed_mm_s = libm::pow(10.0, random.between(0.5, 3.0));
        motion.travel_speed_mm_s = motion.speed_mm_s;
        motion.acceleration_mm_s2 = libm::pow(10.0, random.between(1.0, 5.0));
        motion.joint_acceleration_rad_s2 = [libm::pow(10.0, random.between(0.5, 3.0)); AXES];
        motion.tolerance_mm = libm::pow(10.0, random.between(-2.3, -0.3));
        motion.travel_tolerance_mm = 2.0 * motion.tolerance_mm;
        motion.jerk_window_ms = [0, 4, 4, 16][random.below(4)];
        motion.pen_dwell_ms = [0, 0, 5][random.below(3)];
    }
    if random.below(6) == 0 {
        settings.motion.orientation = Orientation::Path;
    }
    assert_eq!(settings.check(), Ok(()));
    settings
}

/// A walk of a random character.
pub(super) fn walk(random: &mut Random) -> Vec<Vertex> {
    let scale_mm = libm::pow(10.0, random.between(-6.0, 0.0));
    let (kind, rounded) = (random.below(6), random.below(2) == 0);
    let mut at = [random.between(-40.0, 40.0), random.between(-40.0, 40.0)];
    let mut heading = random.between(0.0, TAU);
    let mut path = Vec::new();
    for number in 0..20 + random.below(100) {
        let (turn, step) = match (kind, random.below(4)) {
            // Steps of one length in any direction.
            (0, _) => (random.between(-PI, PI), 1.0),
            // Reversals, some a little off.
            (1, 0) => (PI, random.next()),
            (1, _) => (PI + random.between(-0.3, 0.3), 1.0),
            // Straight runs of uneven steps, there and back.
            (2, 0) => (PI, random.next()),
            (2, _) => (0.0, random.next()),
            // Repeated vertices.
            (3, 0 | 1) => (0.0, 0.0),
            (3, _) => (random.between(-PI, PI), 1.0),
            // A line with noise across.
            (4, _) => (if number % 2 == 0 { 2.8 } else { -2.8 } * random.next(), 1.0),
            // Every scale at once.
            (_, 0) => (
                random.between(-PI, PI),
                libm::pow(10.0, random.between(-6.0, 0.0)) / scale_mm,
            ),
            (_, _) => (PI + random.between(-0.1, 0.1), random.next()),
        };
        heading += turn;
        at[0] += step * scale_mm * libm::cos(heading);
        at[1] += step * scale_mm * libm::sin(heading);
        let placed = if rounded {
            at.map(|value| libm::round(value * 1_000.0) / 1_000.0)
        } else {
            at
        };
        path.push(vertex([placed[0], placed[1], -850.0], Pen::Down, 0));
    }
    path
}

/// Duration of a path that rests at each vertex and uses half of the joints' limits, s.
pub(super) fn duration_with_rests_s(settings: &Settings, path: &[Vertex]) -> f64 {
    let kinematics = Kinematics::new(&settings.geometry).unwrap();
    let motion = &settings.motion;
    let [_, _, _, turn_acceleration] = motion.joint_acceleration_rad_s2;
    let turn_s = match motion.orientation {
        Orientation::Path => 4.0 * libm::sqrt(PI / turn_acceleration) + PI / motion.joint_speed_rad_s[3],
        Orientation::Constant => 0.0,
    };
    let leg_s = |leg: &[Vertex]| {
        let from = Vector::from(leg[0].position);
        let way = subtract(&leg[1].position.into(), &from);
        let whole = length(&way);
        let rows = kinematics.rows(&from, &way.map(|part| part / whole.max(f64::MIN_POSITIVE)), &[0.0; 3]);
        let steepest = rows.slope.iter().fold(1.0e-6_f64, |most, slope| most.max(slope.abs()));
        let acceleration = motion
            .acceleration_mm_s2
            .min(0.5 * motion.joint_acceleration_rad_s2[0] / steepest);
        let speed = motion.speed_mm_s.min(motion.joint_speed_rad_s[0] / steepest);
        2.0 * libm::sqrt(whole / acceleration) + whole / speed + if whole > 0.0 { turn_s } else { 0.0 }
    };
    path.windows(2).map(leg_s).sum()
}

/// Runs a path to its end; also returns the part of the allowed time that it took.
pub(super) fn run_to_its_end(settings: &Settings, path: &[Vertex], name: &str) -> (Run, f64) {
    let bound_s = SLOWER * duration_with_rests_s(settings, path) + BESIDE_S;
    let mut run = Run::new(settings, path);
    run.feed(usize::MAX);
    run.command(MotionCommand::Start);
    let periods = (bound_s / (PERIOD_MS as f64 * TICK_S)) as usize + 1;
    for _ in 0..periods {
        run.feed(usize::MAX);
        run.step();
        assert_eq!(run.trajectory.stalled_ms(), 0, "{name}: no progress");
        if run.trajectory.state() == MotionState::Idle {
            let took_s = run.setpoints.len() as f64 * TICK_S;
            return (run, took_s / bound_s);
        }
    }
    panic!(
        "{name}: {} of {} executed in {bound_s} s",
        run.trajectory.executed(),
        path.len()
    );
}

/// Checks what must hold at a walk's end. Returns the largest values as parts of its limits and of its tolerance.
pub(super) fn check_end(run: &Run, name: &str) -> ([f64; KINDS], (f64, f64)) {
    let parts = run.check_limits(name);
    let distances = tolerance::check_distances(run, name);
    let last = run.path.last().unwrap().position.into();
    let away = length(&subtract(&run.end(), &last));
    // A vertex that repeats the one before is merged with it.
    assert!(away < 2.0 * LEG_MIN_MM, "{name}: ends {away} mm away");
    assert_eq!(run.trajectory.executed() as usize, run.path.len(), "{name}");
    assert_eq!(run.trajectory.underruns(), 0, "{name}");
    (parts, distances)
}

#[test]
fn noise_of_every_scale_ends_at_its_last_vertex_in_bounded_time() {
    let (mut count, mut longest, mut worst, mut apart) = (0, 0.0_f64, [0.0_f64; KINDS], (0.0_f64, 0.0_f64));
    for seed in walks() {
        let mut random = Random::new(seed);
        let settings = limits(&mut random);
        let path = walk(&mut random);
        let name = format!("walk {seed}");
        let (run, part) = run_to_its_end(&settings, &path, &name);
        let (parts, distances) = check_end(&run, &name);
        worst = core::array::from_fn(|kind| worst[kind].max(parts[kind]));
        apart = (apart.0.max(distances.0), apart.1.max(distances.1));
        longest = longest.max(part);
        count += 1;
    }
    println!("{count} walks, the longest took {longest:.3} of its bound, worst parts of the limits {worst:.4?}");
    println!(
        "worst parts of the tolerance: setpoint to line {:.4}, vertex to setpoint {:.4}",
        apart.0, apart.1
    );
}

#[test]
fn a_recorded_walk_of_ten_micrometres_with_reversals_ends() {
    let path = paths::sample_path(include_str!("../../../../samples/motion/stall.csv"));
    let settings = Settings::default();
    let (run, part) = run_to_its_end(&settings, &path, "stall.csv");
    check_end(&run, "stall.csv");
    println!("{:.3} s, {part:.3} of its bound", run.duration_s());
}

/// Runs a walk with an override and a hold or a cancel. Returns the time to come to rest, ms, and the largest values as
/// parts of the limits; `None` if the walk ended before.
pub(super) fn commanded(seed: u64) -> Option<(usize, [f64; KINDS])> {
    let mut random = Random::new(seed);
    let settings = limits(&mut random);
    let path = walk(&mut random);
    let name = format!("walk {seed}");
    let bound_s = SLOWER * duration_with_rests_s(&settings, &path) + BESIDE_S;
    let periods = (bound_s / (PERIOD_MS as f64 * TICK_S)) as usize + 1;
    let mut run = Run::new(&settings, &path);
    run.command(MotionCommand::Start);
    for _ in 0..random.below(periods.min(200)) {
        run.feed(usize::MAX);
        run.step();
    }
    let before = run.setpoints.len();
    let percent = 10 + random.below(191) as u8;
    let _ = run.trajectory.command(MotionCommand::Override(percent));
    run.step();
    let cancels = random.below(2) == 0;
    let command = if cancels {
        MotionCommand::Cancel
    } else {
        MotionCommand::Hold
    };
    if run.trajectory.state() != MotionState::Running {
        return None;
    }
    run.command(command);
    // Braking from the highest speed, the turn of the fourth axis at a stop, and the lift of the pen.
    let motion = &settings.motion;
    let turn_acceleration = motion.joint_acceleration_rad_s2[3];
    let brake_s = 2.0 * motion.speed_mm_s / motion.acceleration_mm_s2 + 4.0 * libm::sqrt(PI / turn_acceleration) + 3.0;
    for _ in 0..(brake_s / (PERIOD_MS as f64 * TICK_S)) as usize {
        run.feed(if cancels { 0 } else { usize::MAX });
        run.step();
        if matches!(run.trajectory.state(), MotionState::Held | MotionState::Idle) {
            break;
        }
    }
    let state = run.trajectory.state();
    assert!(
        matches!(state, MotionState::Idle) || !cancels && state == MotionState::Held,
        "{name}: {state:?} after {command:?} and {brake_s} s"
    );
    let rest_ms = run.setpoints.len() - before;
    if state == MotionState::Held {
        resume_to_the_end(&mut run, periods, &name);
    }
    run.settings.motion.speed_mm_s *= 2.0;
    run.settings.motion.travel_speed_mm_s *= 2.0;
    Some((rest_ms, run.check_limits(&name)))
}

fn resume_to_the_end(run: &mut Run, periods: usize, name: &str) {
    run.command(MotionCommand::Override(100));
    run.command(MotionCommand::Resume);
    let left = periods + (4.0 / (PERIOD_MS as f64 * TICK_S)) as usize;
    for _ in 0..left {
        run.feed(usize::MAX);
        run.step();
        if run.trajectory.state() == MotionState::Idle {
            break;
        }
    }
    assert_eq!(run.trajectory.state(), MotionState::Idle, "{name}: after the resume");
    assert_eq!(run.trajectory.executed() as usize, run.path.len(), "{name}");
}

/// A command in the middle of a walk completes as it does on a line.
#[test]
fn hold_cancel_and_override_act_in_the_middle_of_noise() {
    let (mut count, mut slowest_ms, mut worst) = (0, 0, [0.0_f64; KINDS]);
    for (rest_ms, parts) in walks().filter_map(commanded) {
        count += 1;
        slowest_ms = slowest_ms.max(rest_ms);
        worst = core::array::from_fn(|kind| worst[kind].max(parts[kind]));
    }
    println!("{count} commanded walks, at rest after {slowest_ms} ms at most, worst parts of the limits {worst:.4?}");
}

/// A line at 1 mm/s takes two seconds from one point of the grid to the next.
fn slow_line() -> Run {
    let mut settings = Settings::default();
    settings.motion.speed_mm_s = 1.0;
    settings.motion.travel_speed_mm_s = 1.0;
    let ends = [[0.0, 0.0, -850.0], [40.0, 0.0, -850.0]];
    let mut run = Run::new(&settings, &ends.map(|point| vertex(point, Pen::Down, 0)));
    run.feed(usize::MAX);
    run.command(MotionCommand::Start);
    for _ in 0..100 {
        run.step();
    }
    run
}

#[test]
fn a_hold_a_cancel_and_an_override_cut_a_long_stretch() {
    let speed = |run: &Run| {
        let mut ends = [run.setpoints.len() - 2, run.setpoints.len() - 1].into_iter();
        let kinematics = Kinematics::new(&run.settings.geometry).unwrap();
        let mut point = || {
            Vector::from(
                kinematics
                    .forward(&JointAngles(run.setpoints[ends.next().unwrap()].position_rad))
                    .unwrap(),
            )
        };
        length(&subtract(&point(), &point())) / TICK_S
    };
    for command in [MotionCommand::Hold, MotionCommand::Cancel] {
        let mut run = slow_line();
        assert!(
            (speed(&run) - 1.0).abs() < 0.01,
            "{} mm/s {:?}",
            speed(&run),
            run.trajectory.state()
        );
        let at = run.end()[0];
        run.command(command);
        run.step();
        let moved = run.trajectory.position().x_mm - at;
        assert!(moved < 0.005, "{command:?} let it go on for {moved} mm");
    }
    for (percent, expected) in [(50, 0.5), (200, 2.0)] {
        let mut run = slow_line();
        run.command(MotionCommand::Override(percent));
        run.step();
        run.step();
        assert!(
            (speed(&run) - expected).abs() < 0.01 * expected,
            "{percent} %: {} mm/s",
            speed(&run)
        );
    }
}

#[test]
fn a_motion_that_makes_no_progress_is_noticed_and_a_slow_one_goes_on() {
    let path = [[0.0, 0.0, -850.0], [0.02, 0.0, -850.0], [0.02, 0.02, -850.0]].map(|point| vertex(point, Pen::Down, 0));
    // Limits that no configuration may have: nothing can move.
    let mut settings = Settings::default();
    settings.motion.speed_mm_s = 0.0;
    settings.motion.travel_speed_mm_s = 0.0;
    let mut run = Run::new(&settings, &path);
    run.feed(usize::MAX);
    run.command(MotionCommand::Start);
    let noticed = (1..=400).find(|_| {
        run.step();
        run.trajectory.stalled_ms() > 0
    });
    assert_eq!(noticed, Some(2_000 / PERIOD_MS + 2), "after two seconds and the start");
    assert!(run.trajectory.place(JointAngles(run.setpoints[0].position_rad)));
    assert_eq!(
        run.trajectory.stalled_ms(),
        0,
        "a new start is watched from its beginning"
    );
    // The slowest that a configuration may ask for.
    let mut settings = Settings::default();
    settings.motion.speed_mm_s = 1.0;
    settings.motion.travel_speed_mm_s = 1.0;
    settings.motion.acceleration_mm_s2 = 10.0;
    settings.motion.joint_speed_rad_s[3] = 0.01;
    settings.motion.joint_acceleration_rad_s2 = [0.1; AXES];
    settings.motion.orientation = Orientation::Path;
    settings.motion.pen_dwell_ms = 10_000;
    assert_eq!(settings.check(), Ok(()));
    let mut run = Run::new(&settings, &path);
    run.command(MotionCommand::Override(10));
    run.feed(usize::MAX);
    run.command(MotionCommand::Start);
    for _ in 0..60_000 {
        run.step();
        assert_eq!(run.trajectory.stalled_ms(), 0, "after {} ms", run.setpoints.len());
        if run.trajectory.state() == MotionState::Idle {
            break;
        }
    }
    assert_eq!(
        run.trajectory.state(),
        MotionState::Idle,
        "{} executed",
        run.trajectory.executed()
    );
}
