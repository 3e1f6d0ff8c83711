//! Requirements on a thousand random paths with random limits: what must always hold.

use super::super::plan::{GROWTH, POINTS};
use super::*;
use crate::WorkArea;
use crate::robots::{Geometry, LinearDeltaGeometry, ScaraGeometry};
use crate::settings::{InputShaper, Orientation};

/// Random limits, tolerances and options.
pub(super) fn varied(random: &mut Random, bench: &Bench) -> Settings {
    let mut settings = bench.settings.clone();
    let motion = &mut settings.motion;
    motion.speed_mm_s = random.between(50.0, 2_000.0);
    motion.travel_speed_mm_s = motion.speed_mm_s * random.between(1.0, 3.0);
    motion.acceleration_mm_s2 = libm::pow(10.0, random.between(3.0, 5.0));
    for axis in 0..AXES {
        // Of the default machine: 1 to 30 rad/s, 32 to 1,000 rad/s2.
        motion.joint_speed_rad_s[axis] *= random.between(0.04, 1.2);
        motion.joint_acceleration_rad_s2[axis] *= libm::pow(10.0, random.between(-0.9, 0.6));
    }
    motion.tolerance_mm = random.between(0.01, 0.3);
    motion.travel_tolerance_mm = motion.tolerance_mm * random.between(1.0, 10.0);
    motion.jerk_window_ms = [0, 1, 2, 4, 4, 8, 32][random.below(7)];
    motion.pen_dwell_ms = [0, 0, 0, 15][random.below(4)];
    if random.below(4) == 0 {
        motion.pen_speed_mm_s = random.between(20.0, 300.0);
        motion.pen_acceleration_mm_s2 = random.between(500.0, 10_000.0);
    }
    if random.below(2) == 0 {
        motion.orientation = Orientation::Path;
    }
    settings.paper.pen_lift_mm = random.between(0.5, 10.0);
    assert_eq!(settings.check(), Ok(()));
    settings
}

/// Strokes of all characters, lowered and lifted straight or on a slant, on the default machine's sheet.
pub(super) fn varied_path(random: &mut Random, settings: &Settings) -> Vec<Vertex> {
    let down = Settings::default().paper.pen_down_z_mm;
    let up = down + settings.paper.pen_lift_mm;
    let mut path = Vec::new();
    for stroke in 0..1 + random.below(3) as u32 {
        let slant = [0.0, random.between(-2.0, 2.0)][random.below(2)];
        let mut point = [random.between(-90.0, 90.0), random.between(-90.0, 90.0), down];
        path.push(vertex([point[0] - slant, point[1], up], Pen::Up, stroke));
        path.push(vertex(point, Pen::Up, stroke));
        let kind = random.below(7);
        let (bend, step) = (random.between(-0.3, 0.3), random.between(0.1, 2.0));
        let mut heading = random.between(0.0, TAU);
        for number in 0..1 + random.below(24) {
            let (turn, leg) = match kind {
                0 => (random.between(-1.2, 1.2), random.between(0.3, 3.0)),
                1 => (if number % 2 == 0 { 2.6 } else { -2.6 }, random.between(0.5, 5.0)),
                2 => (random.between(-PI, PI), random.between(20.0, 150.0)),
                3 => (bend, step),
                4 => ([0.0, PI / 2.0, PI, -2.0][random.below(4)], random.between(0.01, 20.0)),
                5 => (random.between(-PI, PI), random.between(0.001, 0.05)),
                _ => (random.between(-2.0, 2.0), random.between(0.5, 10.0)),
            };
            heading += turn;
            point[0] = (point[0] + leg * libm::cos(heading)).clamp(-150.0, 150.0);
            point[1] = (point[1] + leg * libm::sin(heading)).clamp(-150.0, 150.0);
            if kind == 6 {
                point[2] = random.between(down, up);
            }
            path.push(vertex(point, Pen::Down, stroke));
        }
        path.push(vertex([point[0] + slant, point[1], up], Pen::Up, stroke));
    }
    path
}

fn check_whole(run: &Run, name: &str) -> [f64; KINDS] {
    let worst = run.check_limits(name);
    run.check_deviation(name);
    let last = run.path.last().unwrap().position.into();
    assert!(length(&subtract(&run.end(), &last)) < 1.0e-6, "{name}: ends elsewhere");
    assert_eq!(run.trajectory.executed() as usize, run.path.len(), "{name}");
    assert_eq!(run.trajectory.underruns(), 0, "{name}");
    assert!(
        run.work_max as usize <= GROWTH + POINTS,
        "{name}: work {}",
        run.work_max
    );
    worst
}

/// Draws the path with a hold, an override and a resume at random times.
fn check_held(random: &mut Random, settings: &Settings, path: &[Vertex], periods: usize, name: &str) {
    let mut run = Run::new(settings, path);
    run.command(MotionCommand::Start);
    let hold_at = random.below(periods.max(1));
    let percent = 10 + random.below(91) as u8;
    for period in 0..=hold_at {
        if period == hold_at / 2 {
            run.command(MotionCommand::Override(percent));
        }
        run.feed(usize::MAX);
        run.step();
    }
    if run.trajectory.state() == MotionState::Running {
        run.command(MotionCommand::Hold);
        run.until(MotionState::Held);
        assert_eq!(run.setpoints.last().unwrap().velocity_rad_s, [0.0; AXES], "{name}");
        run.command(MotionCommand::Override(100));
        run.command(MotionCommand::Resume);
    }
    run.until(MotionState::Idle);
    run.check_limits(name);
    run.check_drawn(name);
    assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
}

fn check_seeds(kind: Kind, seeds: core::ops::Range<u64>) {
    let bench = Bench::new(kind);
    let (mut worst, mut samples) = ([0.0_f64; KINDS], 0);
    for seed in seeds {
        let mut random = Random::new(seed);
        let settings = varied(&mut random, &bench);
        let path = bench.fitted(&varied_path(&mut random, &settings));
        let name = format!("{kind:?}, seed {seed}");
        let run = Run::new(&settings, &path).whole();
        samples += run.setpoints.len();
        for (all, one) in worst.iter_mut().zip(check_whole(&run, &name)) {
            *all = all.max(one);
        }
        let periods = run.setpoints.len() / PERIOD_MS;
        check_held(&mut random, &settings, &path, periods, &format!("{name}, held"));
    }
    println!("worst parts of the limits in {samples} samples: {worst:?}");
}

#[test]
fn five_hundred_random_paths_keep_all_limits_whole_and_held() {
    check_seeds(Kind::Delta, 1..501);
}

#[test]
fn another_five_hundred_random_paths_keep_all_limits_whole_and_held() {
    check_seeds(Kind::Delta, 501..1001);
}

#[test]
fn random_paths_on_a_gantry_keep_all_limits_whole_and_held() {
    check_seeds(Kind::Gantry, 1..201);
}

#[test]
fn random_paths_on_crossed_belts_keep_all_limits_whole_and_held() {
    check_seeds(Kind::CoreXy, 1..201);
}

#[test]
fn random_paths_on_a_scara_keep_all_limits_whole_and_held() {
    check_seeds(Kind::Scara, 1..201);
}

#[test]
fn random_paths_on_a_linear_delta_keep_all_limits_whole_and_held() {
    check_seeds(Kind::LinearDelta, 1..201);
}

/// Random vertices near all borders of the work area, of which those that are admitted are drawn.
fn check_inside(geometry: Geometry, shaper: InputShaper) {
    let mut settings = Settings::usual(geometry);
    settings.motion.input_shaper = shaper;
    settings.motion.resonance_hz = 30.0;
    let volume = settings.work_area;
    settings.paper.pressing_depth_mm = settings.paper.pen_down_z_mm - volume.z_low_mm;
    settings.motion.travel_tolerance_mm = 2.0;
    settings.motion.tolerance_mm = 1.0;
    let area = WorkArea::new(&settings).unwrap();
    let (mut samples, mut refused) = (0, 0);
    for seed in 1..=60 {
        let mut random = Random::new(seed);
        let mut admission = Admission::new(&settings).unwrap();
        let mut path = Vec::new();
        while path.len() < 8 {
            let mut within =
                |[low, high]: [f64; 2]| random.between(low.max(-volume.radius_mm), high.min(volume.radius_mm));
            let (x, y) = (within(volume.x_mm), within(volume.y_mm));
            let z = random.between(volume.z_low_mm, volume.z_high_mm);
            let pen = if random.below(2) == 0 { Pen::Up } else { Pen::Down };
            let next = vertex([x, y, z], pen, 0);
            if admission.check(path.len() as u32, &next).is_ok() {
                path.push(next);
            } else {
                refused += 1;
                assert!(refused < 50_000, "{:?}", geometry.kind());
            }
        }
        let run = Run::new(&settings, &path).whole();
        run.check_limits(&format!("{:?}, seed {seed}", geometry.kind()));
        for setpoint in &run.setpoints {
            let at = area.kinematics().forward(&JointAngles(setpoint.position_rad)).unwrap();
            let inside = area.check(&at);
            assert!(inside.is_ok(), "{:?}, seed {seed}: {at:?} {inside:?}", geometry.kind());
            samples += 1;
        }
    }
    println!("{samples} samples inside, {refused} vertices refused");
    assert!(
        refused > 50 || matches!(geometry.kind(), Kind::Gantry | Kind::CoreXy),
        "{refused}"
    );
}

#[test]
fn an_admitted_path_stays_inside_the_work_area_with_its_curve() {
    for kind in Kind::ALL {
        check_inside(kind.geometry(), InputShaper::None);
        check_inside(kind.geometry(), InputShaper::Zv);
    }
    let scara = Geometry::Scara(ScaraGeometry {
        elbow: -1,
        shoulder_range_rad: [0.0, 5.9],
        ..ScaraGeometry::default()
    });
    let linear_delta = Geometry::LinearDelta(LinearDeltaGeometry {
        carriage_range_mm: [200.0, 400.0],
        ..LinearDeltaGeometry::default()
    });
    for geometry in [scara, linear_delta] {
        check_inside(geometry, InputShaper::None);
        check_inside(geometry, InputShaper::Zv);
    }
}
