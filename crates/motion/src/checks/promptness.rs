//! A hold brakes, and an override changes the speed, in the period after the command, wherever the motion is.

use super::*;

/// Tool speeds, mm/s.
const SPEEDS_MM_S: [f64; 5] = [1.0, 5.0, 40.0, 200.0, 500.0];
/// Least part of what the undisturbed motion covers in the period by which the disturbed one is ahead or behind.
const CHANGED: f64 = 0.02;
/// Motion of the undisturbed run in a period below which nothing is compared, mm.
const MOVED_MIN_MM: f64 = 1.0e-3;

fn settings(speed_mm_s: f64) -> Settings {
    let mut settings = Settings::default();
    settings.motion.speed_mm_s = speed_mm_s;
    settings.motion.travel_speed_mm_s = settings.motion.travel_speed_mm_s.max(speed_mm_s);
    settings
}

/// A run under way for some periods, and one without what follows.
fn twins(run: &Run) -> [Run; 2] {
    [(); 2].map(|()| Run {
        settings: run.settings.clone(),
        trajectory: run.trajectory.clone(),
        path: run.path.clone(),
        pushed: run.pushed,
        setpoints: run.setpoints.clone(),
        work_max: 0,
        work_sum: 0,
    })
}

/// Length of the tool's way in plan view over the last period, mm, and that of its first and last milliseconds. A hold that is
/// at rest lifts the pen.
fn covered_mm(run: &Run) -> [f64; 3] {
    let kinematics = Kinematics::new(&run.settings.geometry).unwrap();
    let last = &run.setpoints[run.setpoints.len() - PERIOD_MS - 1..];
    let places: Vec<Vector> = last
        .iter()
        .map(|at| kinematics.forward(&JointAngles(at.position_rad)).unwrap().into())
        .collect();
    let ways: Vec<f64> = places
        .windows(2)
        .map(|pair| libm::hypot(pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]))
        .collect();
    [ways.iter().sum(), ways[0], ways[PERIOD_MS - 1]]
}

#[test]
fn a_hold_brakes_in_the_next_period_at_any_speed_and_the_path_goes_on_as_often_as_it_is_held() {
    let (mut compared, mut compared_slow) = (0, 0);
    for seed in 1..60_u64 {
        let mut random = Random::new(seed);
        let speed_mm_s = SPEEDS_MM_S[random.below(SPEEDS_MM_S.len())];
        let settings = settings(speed_mm_s);
        let path = random_path(&mut random, 1);
        // Slowly, the pen goes down first.
        let least_periods = if speed_mm_s <= 5.0 { 150 } else { 1 };
        let name = format!("seed {seed}, {speed_mm_s} mm/s");
        let mut run = Run::new(&settings, &path);
        run.command(MotionCommand::Start);
        for hold in 0..4 {
            for _ in 0..least_periods + random.below(40) {
                run.feed(usize::MAX);
                run.step();
            }
            if run.trajectory.state() != MotionState::Running {
                break;
            }
            run.feed(usize::MAX);
            let [mut held, mut free] = twins(&run);
            held.command(MotionCommand::Hold);
            held.step();
            free.step();
            let ([held_mm, _, _], [free_mm, first_mm, last_mm]) = (covered_mm(&held), covered_mm(&free));
            // What brakes already cannot brake more.
            if free_mm > MOVED_MIN_MM && last_mm >= first_mm {
                assert!(
                    held_mm < free_mm * (1.0 - CHANGED),
                    "{name}, hold {hold}: {held_mm} mm of {free_mm} mm"
                );
                compared += 1;
                compared_slow += usize::from(speed_mm_s <= 5.0 && free.setpoints.last().unwrap().pen == Pen::Down);
            }
            run = held;
            run.until(MotionState::Held);
            assert_eq!(run.setpoints.last().unwrap().velocity_rad_s, [0.0; AXES], "{name}");
            run.command(MotionCommand::Resume);
            // A second hold while the pen goes down again.
            for _ in 0..random.below(8) {
                run.step();
            }
            if run.trajectory.command(MotionCommand::Hold).is_ok() {
                run.until(MotionState::Held);
                run.command(MotionCommand::Resume);
            }
        }
        run.until(MotionState::Idle);
        // The average reports the first milliseconds of a lift with the pen still down.
        run.settings.motion.speed_mm_s = run.settings.motion.travel_speed_mm_s;
        run.check_limits(&name);
        run.check_drawn(&name);
        assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
    }
    println!("{compared} holds compared, {compared_slow} of them with the pen down at 5 mm/s or less");
    assert!(compared > 40);
}

#[test]
fn an_override_changes_the_speed_in_the_next_period_on_long_lines_and_in_corners() {
    let path = [
        vertex([-60.0, 0.0, -850.0], Pen::Up, 0),
        vertex([60.0, 10.0, -850.0], Pen::Down, 0),
        vertex([-60.0, 20.0, -850.0], Pen::Down, 0),
    ];
    for speed_mm_s in SPEEDS_MM_S {
        let settings = settings(speed_mm_s);
        for (seed, percent) in [(1, 10), (2, 50), (3, 90), (4, 110), (5, 150), (6, 200)] {
            let mut random = Random::new(seed);
            let mut run = Run::new(&settings, &path);
            run.feed(usize::MAX);
            run.command(MotionCommand::Start);
            for _ in 0..12 + random.below(5) {
                run.step();
            }
            let [mut changed, mut free] = twins(&run);
            changed.command(MotionCommand::Override(percent));
            changed.step();
            free.step();
            let ([changed_mm, ..], [free_mm, ..]) = (covered_mm(&changed), covered_mm(&free));
            let factor = f64::from(percent) / 100.0;
            let name = format!("{speed_mm_s} mm/s, {percent} %: {changed_mm} mm instead of {free_mm} mm");
            // A part of the wanted change at least, where the joints allow more than the order.
            let wanted = (factor - 1.0) * free_mm;
            let is_bound = speed_mm_s > 400.0 && factor > 1.0;
            assert!(is_bound || (changed_mm - free_mm) / wanted > 5.0 * CHANGED, "{name}");
        }
    }
}

#[test]
fn a_hold_while_the_pen_is_lowered_lifts_it_again_and_the_path_goes_on() {
    let settings = settings(40.0);
    let (path, _) = portrait(&mut Random::new(21), 1);
    for periods in 0..12 {
        let name = format!("{periods} periods");
        let mut run = Run::new(&settings, &path);
        run.command(MotionCommand::Start);
        for _ in 0..60 {
            run.feed(usize::MAX);
            run.step();
        }
        run.command(MotionCommand::Hold);
        run.until(MotionState::Held);
        let lifted_mm = run.end()[2];
        run.command(MotionCommand::Resume);
        for _ in 0..periods {
            run.step();
        }
        let is_lowered = run.trajectory.state() == MotionState::Resuming;
        let before_mm = run.end()[2];
        run.command(MotionCommand::Hold);
        if is_lowered {
            for _ in 0..3 {
                run.step();
            }
            let now_mm = run.end()[2];
            assert!(now_mm > before_mm - 1.0, "{name}: from {before_mm} mm to {now_mm} mm");
        }
        run.until(MotionState::Held);
        assert!((run.end()[2] - lifted_mm).abs() < 1.0 || !is_lowered, "{name}");
        run.command(MotionCommand::Resume);
        run.until(MotionState::Idle);
        run.check_limits(&name);
        run.check_drawn(&name);
        assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
    }
}
