//! Requirements on paths: limits, tolerance, duration.

use super::*;

/// A path file of the samples.
pub(super) fn sample_path(text: &str) -> Vec<Vertex> {
    let mut path: Vec<Vertex> = Vec::new();
    for line in text.lines().skip(1) {
        let mut values = line.split(',').map(|value| value.trim().parse::<f64>().unwrap());
        let point = [values.next().unwrap(), values.next().unwrap(), values.next().unwrap()];
        let pen = if values.next().unwrap() > 0.5 {
            Pen::Down
        } else {
            Pen::Up
        };
        path.push(vertex(point, pen, 0));
    }
    path
}

#[test]
fn random_paths_keep_every_limit_and_the_tolerance_and_end_at_rest() {
    let settings = Settings::default();
    let mut worst = [0.0_f64; KINDS];
    for seed in 1..=250 {
        let mut random = Random::new(seed);
        let path = random_path(&mut random, 2);
        let run = Run::new(&settings, &path).whole();
        let name = format!("seed {seed}");
        for (all, one) in worst.iter_mut().zip(run.check_limits(&name)) {
            *all = all.max(one);
        }
        run.check_deviation(&name);
        let last = path.last().unwrap().position.into();
        assert!(length(&subtract(&run.end(), &last)) < 1.0e-6, "{name}: ends elsewhere");
        assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
        assert_eq!(run.trajectory.underruns(), 0, "{name}");
    }
    println!("worst parts of the limits: {worst:?}");
}

#[test]
fn a_lift_costs_a_tenth_of_a_second() {
    let settings = Settings::default();
    let (path, drawn_mm) = portrait(&mut Random::new(7), 40);
    let run = Run::new(&settings, &path).whole();
    let worst = run.check_limits("portrait");
    run.check_deviation("portrait");
    let lifted = run.setpoints.iter().filter(|r| r.pen == Pen::Up).count() as f64 * TICK_S;
    println!(
        "{:.3} s for {drawn_mm:.0} mm, {:.4} s a lift, worst {worst:?}, work at most {}, mean {}",
        run.duration_s(),
        lifted / 40.0,
        run.work_max,
        run.work_sum / (run.setpoints.len() / PERIOD_MS) as u64
    );
    assert!(lifted / 40.0 < 0.11);
}

#[test]
fn joint_limited_durations_are_near_the_optimum_of_the_shaped_path() {
    let mut settings = Settings::default();
    settings.motion.speed_mm_s = 1.0e5;
    settings.motion.travel_speed_mm_s = 1.0e5;
    settings.motion.acceleration_mm_s2 = 1.0e7;
    settings.motion.tolerance_mm = 0.1;
    settings.motion.travel_tolerance_mm = 0.1;
    settings.motion.jerk_window_ms = 0;
    for (name, text, optimum_s) in [
        ("square", include_str!("../../../../samples/motion/square.csv"), 0.302),
        ("circle", include_str!("../../../../samples/motion/circle.csv"), 0.137),
        ("text", include_str!("../../../../samples/motion/text.csv"), 3.854),
    ] {
        let run = Run::new(&settings, &sample_path(text)).whole();
        let worst = run.check_limits(name);
        run.check_deviation(name);
        println!(
            "{name}: {:.3} s of {optimum_s} s, worst {worst:?}, work {}",
            run.duration_s(),
            run.work_max
        );
        assert!(run.duration_s() < 1.03 * optimum_s, "{name}: {} s", run.duration_s());
    }
}

#[test]
fn other_limits_hold_as_well() {
    type Change = fn(&mut Settings);
    let changes: [Change; 5] = [
        |settings| settings.motion.joint_acceleration_rad_s2 = [10.0; AXES],
        |settings| settings.motion.joint_speed_rad_s = [0.3; AXES],
        |settings| {
            settings.motion.speed_mm_s = 10_000.0;
            settings.motion.travel_speed_mm_s = 10_000.0;
            settings.motion.acceleration_mm_s2 = 150_000.0;
        },
        |settings| {
            settings.motion.jerk_window_ms = 32;
            settings.motion.acceleration_mm_s2 = 1_000.0;
        },
        |settings| {
            settings.motion.tolerance_mm = 0.005;
            settings.motion.travel_tolerance_mm = 0.005;
            settings.motion.jerk_window_ms = 0;
        },
    ];
    for (number, change) in changes.iter().enumerate() {
        let mut worst = [0.0_f64; KINDS];
        let mut settings = Settings::default();
        change(&mut settings);
        for seed in 1000..1012 {
            let path = random_path(&mut Random::new(seed), 2);
            let run = Run::new(&settings, &path).whole();
            let name = format!("change {number}, seed {seed}");
            for (all, one) in worst.iter_mut().zip(run.check_limits(&name)) {
                *all = all.max(one);
            }
            run.check_deviation(&name);
        }
        println!("change {number}: worst {worst:?}");
    }
}

#[test]
fn the_stage_fits_its_memory_and_its_period() {
    let bytes = core::mem::size_of::<Trajectory>();
    assert!(bytes <= 104 * 1024, "{bytes} bytes");
    println!("{} bytes", core::mem::size_of::<Trajectory>());
}
