//! Requirements on small acceleration limits: at low speed, differences over a millisecond smooth nothing.

use super::*;

/// The platform's largest acceleration as a part of its limit, and when, ms.
fn peak(run: &Run) -> (f64, usize) {
    let kinematics = Kinematics::new(&run.settings.geometry).unwrap();
    let points: Vec<Vector> = run
        .setpoints
        .iter()
        .map(|r| kinematics.forward(&JointAngles(r.position_rad)).unwrap().into())
        .collect();
    let acceleration = |three: &[Vector]| {
        let second: Vector = core::array::from_fn(|axis| three[0][axis] - 2.0 * three[1][axis] + three[2][axis]);
        length(&second) / (TICK_S * TICK_S)
    };
    let worst = points.windows(3).map(acceleration).enumerate();
    let (at, worst) = worst.fold((0, 0.0), |most, one| if one.1 > most.1 { one } else { most });
    (worst / run.settings.motion.acceleration_mm_s2, at)
}

fn down(x: f64, y: f64) -> Vertex {
    vertex([x, y, -850.0], Pen::Down, 0)
}

/// Paths whose curvature peaks: corners of every turn between long and short legs, a circle, noise, strokes.
fn paths(seed: u64) -> Vec<Vec<Vertex>> {
    let mut random = Random::new(seed);
    let corner = |turn: f64, leg: f64| {
        let end = [leg * libm::cos(turn), leg * libm::sin(turn)];
        [[-leg, 0.0], [0.0, 0.0], end].map(|[x, y]| down(x, y)).to_vec()
    };
    let mut paths: Vec<Vec<Vertex>> = (0..8)
        .map(|_| corner(random.between(0.1, 2.88), libm::pow(10.0, random.between(-2.0, 1.3))))
        .collect();
    // Just below the turn beyond which the path stops: the sharpest peak.
    paths.push(corner(2.879, 10.0));
    let (radius, step) = (libm::pow(10.0, random.between(-1.5, 1.0)), random.between(0.05, 0.6));
    let round = |k: u32| step * f64::from(k);
    paths.push(
        (0..40)
            .map(|k| down(radius * libm::cos(round(k)), radius * libm::sin(round(k))))
            .collect(),
    );
    paths.push(super::noise::walk(&mut random));
    paths.push(random_path(&mut random, 1));
    paths
}

#[test]
fn small_acceleration_limits_hold_as_exactly_as_large_ones() {
    let mut worst = [0.0_f64; 2];
    for (seed, acceleration) in (1..).zip([10.0, 14.0, 30.0, 55.0, 100.0, 300.0, 1_000.0, 4_000.0, 30_000.0]) {
        for (window_ms, worst) in [0, 4].into_iter().zip(&mut worst) {
            let mut settings = Settings::default();
            settings.motion.acceleration_mm_s2 = acceleration;
            settings.motion.jerk_window_ms = window_ms;
            assert_eq!(settings.check(), Ok(()));
            for (number, path) in paths(seed).iter().enumerate() {
                let name = format!("{acceleration} mm/s2, seed {seed}, path {number}, window {window_ms}");
                let run = Run::new(&settings, path).whole();
                let (part, at) = peak(&run);
                assert!(part <= 1.0 + EXCESS, "{name}: {part} of the limit at {at} ms");
                run.check_limits(&name);
                run.check_deviation(&name);
                *worst = worst.max(part);
            }
        }
    }
    println!("worst parts of the acceleration limit, without and with an average: {worst:?}");
}

/// Runs a path with speed overrides; `change` returns the override for a period, `None` for no change.
fn run_with_overrides(settings: &Settings, path: &[Vertex], mut change: impl FnMut(usize) -> Option<u8>) -> Run {
    let mut run = Run::new(settings, path);
    run.command(MotionCommand::Start);
    for period in 0..PERIODS_MAX {
        run.feed(usize::MAX);
        if let Some(percent) = change(period) {
            run.command(MotionCommand::Override(percent));
        }
        run.step();
        if run.trajectory.state() == MotionState::Idle {
            return run;
        }
    }
    panic!("{} of {} executed", run.trajectory.executed(), path.len());
}

/// Where the limits are used up, a new choice of the acceleration has almost no room.
#[test]
fn speeds_that_change_all_the_time_keep_the_acceleration() {
    let mut worst = 0.0_f64;
    for seed in (1..40).chain([308, 525, 905, 1596, 2334, 2513, 2784]) {
        let mut random = Random::new(seed);
        let mut settings = Settings::default();
        let motion = &mut settings.motion;
        motion.acceleration_mm_s2 = libm::pow(10.0, random.between(1.3, 3.5));
        motion.speed_mm_s = libm::pow(10.0, random.between(0.5, 2.5));
        motion.tolerance_mm = libm::pow(10.0, random.between(-2.0, -0.2));
        motion.jerk_window_ms = [0, 0, 4][random.below(3)];
        let scale_mm = motion.tolerance_mm * libm::pow(10.0, random.between(-0.3, 1.5));
        let (mut at, mut heading, mut path) = ([0.0, 0.0], 0.0, Vec::new());
        for _ in 0..40 {
            path.push(down(at[0], at[1]));
            heading += random.between(-2.8, 2.8);
            let leg_mm = scale_mm * random.between(0.5, 1.5);
            at[0] += leg_mm * libm::cos(heading);
            at[1] += leg_mm * libm::sin(heading);
        }
        let (part, at) = peak(&run_with_overrides(&settings, &path, |_| {
            (random.below(3) == 0).then(|| match random.below(2) {
                0 => 99 + random.below(3) as u8,
                _ => 50 + random.below(151) as u8,
            })
        }));
        assert!(part <= 1.0 + EXCESS, "seed {seed}: {part} of the limit at {at} ms");
        worst = worst.max(part);
    }
    println!("worst part of the acceleration limit: {worst}");
}
