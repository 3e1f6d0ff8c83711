//! Requirements on commands: hold, starvation, override, cancel, jog, moves, refusals.

use super::*;

#[test]
fn a_hold_anywhere_stays_on_the_path_lifts_the_pen_and_goes_on() {
    let settings = Settings::default();
    let (path, _) = portrait(&mut Random::new(11), 3);
    for hold_at in 1..45 {
        let name = format!("hold after {hold_at} periods");
        let mut run = Run::new(&settings, &path);
        run.command(MotionCommand::Start);
        for _ in 0..hold_at {
            run.feed(usize::MAX);
            run.step();
        }
        if run.trajectory.state() != MotionState::Running {
            break;
        }
        run.command(MotionCommand::Hold);
        run.until(MotionState::Held);
        let held = *run.setpoints.last().unwrap();
        assert_eq!((held.velocity_rad_s, held.pen), ([0.0; AXES], Pen::Up), "{name}");
        assert!(run.end()[2] > -849.9, "{name}: pen is down");
        run.step();
        assert_eq!(run.setpoints.last().unwrap().position_rad, held.position_rad, "{name}");
        run.command(MotionCommand::Resume);
        run.until(MotionState::Idle);
        run.check_limits(&name);
        // The deviation counts only with the pen down, and the retract is reported as pen up.
        assert!(
            run.deviation().0 <= settings.motion.tolerance_mm * (1.0 + EXCESS),
            "{name}"
        );
        assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
    }
}

#[test]
fn a_hold_and_its_end_may_come_at_any_time() {
    let settings = Settings::default();
    let (path, _) = portrait(&mut Random::new(12), 2);
    for seed in 1..60 {
        let mut random = Random::new(seed);
        let mut run = Run::new(&settings, &path);
        run.command(MotionCommand::Start);
        for _ in 0..60 {
            run.feed(1 + random.below(6));
            run.step();
            let command = match random.below(12) {
                0 => MotionCommand::Hold,
                1 | 2 => MotionCommand::Resume,
                3 => MotionCommand::Override(10 + random.below(191) as u8),
                _ => continue,
            };
            // Not every command fits every state; none may break a limit.
            let _ = run.trajectory.command(command);
        }
        run.command(MotionCommand::Override(100));
        let _ = run.trajectory.command(MotionCommand::Resume);
        for _ in 0..4 {
            run.step();
        }
        let _ = run.trajectory.command(MotionCommand::Resume);
        run.settings.motion.speed_mm_s = 800.0;
        run.until(MotionState::Idle);
        run.check_limits(&format!("seed {seed}"));
        assert!(run.deviation().0 <= settings.motion.tolerance_mm * (1.0 + EXCESS));
        assert_eq!(run.trajectory.executed() as usize, path.len(), "seed {seed}");
    }
}

#[test]
fn a_path_that_stops_coming_ends_at_rest_on_the_path_and_goes_on_when_it_returns() {
    let settings = Settings::default();
    let (path, _) = portrait(&mut Random::new(5), 3);
    for part in 4..30 {
        let name = format!("{part} vertices");
        let mut run = Run::new(&settings, &path);
        run.command(MotionCommand::Start);
        run.feed(part);
        for _ in 0..120 {
            run.step();
        }
        assert_eq!(run.trajectory.state(), MotionState::Starved, "{name}");
        assert_eq!(run.trajectory.underruns(), 1, "{name}");
        let waiting = *run.setpoints.last().unwrap();
        assert_eq!((waiting.velocity_rad_s, waiting.pen), ([0.0; AXES], Pen::Up), "{name}");
        run.until(MotionState::Idle);
        run.check_limits(&name);
        assert!(
            run.deviation().0 <= settings.motion.tolerance_mm * (1.0 + EXCESS),
            "{name}"
        );
        assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
    }
}

#[test]
fn a_path_that_stops_coming_leaves_the_pen_on_the_paper_for_the_dwell() {
    let (path, _) = portrait(&mut Random::new(5), 1);
    for dwell_ms in [0_u16, 120, 500] {
        let mut settings = Settings::default();
        settings.motion.starve_dwell_ms = dwell_ms;
        let name = format!("dwell {dwell_ms} ms");
        let starved = || {
            let mut run = Run::new(&settings, &path);
            run.command(MotionCommand::Start);
            run.feed(12);
            let starves = (0..100).any(|_| {
                run.step();
                run.trajectory.state() == MotionState::Starved
            });
            assert!(starves, "{name}: {:?}", run.trajectory.state());
            run
        };
        let mut run = starved();
        let lifts = (0..100).any(|_| {
            run.step();
            run.end()[2] > -849.9
        });
        assert!(lifts, "{name}: the pen stays on the paper");
        let still = |r: &&Setpoint| r.pen == Pen::Down && r.velocity_rad_s == [0.0; AXES];
        let rested_ms = run.setpoints.iter().filter(still).count();
        // The dwell counts whole periods, from the first that finds the motion at rest.
        let least_ms = usize::from(dwell_ms).saturating_sub(PERIOD_MS);
        assert!(
            (least_ms..=least_ms + 4 * PERIOD_MS).contains(&rested_ms),
            "{name}: at rest on the paper for {rested_ms} ms"
        );
        run.until(MotionState::Idle);
        run.check_limits(&name);
        // Path data that return in time find the pen on the paper.
        let mut run = starved();
        for _ in 0..usize::from(dwell_ms) / PERIOD_MS / 2 {
            run.step();
            assert!(run.end()[2] < -849.999, "{name}: the pen was lifted");
        }
        run.until(MotionState::Idle);
        run.check_limits(&name);
        assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
    }
}

#[test]
fn a_path_that_stops_coming_where_the_pen_has_come_down_lifts_it_after_the_dwell() {
    let (path, _) = portrait(&mut Random::new(5), 1);
    for (has_separate_pen, dwell_ms) in [(false, 0), (false, 100), (true, 0), (true, 100)] {
        let mut settings = Settings {
            has_separate_pen,
            ..Settings::default()
        };
        settings.motion.pen_dwell_ms = dwell_ms;
        for part in 2..12 {
            let name = format!("separate: {has_separate_pen}, dwell {dwell_ms} ms, {part} vertices");
            let mut run = Run::new(&settings, &path);
            run.command(MotionCommand::Start);
            run.feed(part);
            for _ in 0..120 {
                run.step();
            }
            assert!(
                run.end()[2] > -848.0,
                "{name}: the pen stays on the paper, {:?}",
                run.end()
            );
            run.until(MotionState::Idle);
            run.check_limits(&name);
            assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
        }
    }
}

#[test]
fn a_path_held_above_the_paper_is_lifted_as_high_as_any_and_not_beyond() {
    let mut settings = Settings::default();
    let paper = settings.paper;
    let up_mm = paper.pen_down_z_mm + paper.pen_lift_mm;
    settings.work_area.z_high_mm = up_mm;
    let path = [
        vertex([-20.0, 0.0, -849.0], Pen::Up, 0),
        vertex([20.0, 0.0, -849.0], Pen::Down, 0),
    ];
    for command in [MotionCommand::Hold, MotionCommand::Cancel] {
        let mut run = Run::new(&settings, &path);
        run.feed(usize::MAX);
        run.command(MotionCommand::Start);
        for _ in 0..6 {
            run.step();
        }
        run.command(command);
        for _ in 0..60 {
            run.step();
        }
        assert!((run.end()[2] - up_mm).abs() < 1.0e-6, "{command:?}: {:?}", run.end());
        assert_eq!(run.setpoints.last().unwrap().pen, Pen::Up, "{command:?}");
    }
}

#[test]
fn an_override_scales_the_speed_within_the_other_limits() {
    let settings = Settings::default();
    let path = [
        vertex([-100.0, 0.0, -850.0], Pen::Up, 0),
        vertex([100.0, 0.0, -850.0], Pen::Down, 0),
    ];
    for (percent, speed) in [(10, 40.0), (50, 200.0), (100, 400.0), (200, 800.0)] {
        let mut run = Run::new(&settings, &path);
        run.command(MotionCommand::Override(percent));
        run.settings.motion.speed_mm_s = speed;
        let worst = run.whole().check_limits("override");
        assert!(worst[2] > 0.99, "{percent} %: {worst:?}");
    }
    let mut run = Run::new(&settings, &path);
    for percent in [0, 9, 201, 255] {
        let refusal = run.trajectory.command(MotionCommand::Override(percent));
        assert_eq!(refusal, Err(MotionRefusal::Override { percent }));
    }
    run.feed(usize::MAX);
    run.command(MotionCommand::Start);
    for percent in [200, 30, 150, 10, 200, 100] {
        run.command(MotionCommand::Override(percent));
        for _ in 0..4 {
            run.step();
        }
    }
    run.until(MotionState::Idle);
    run.settings.motion.speed_mm_s = 800.0;
    run.check_limits("changing override");
}

#[test]
fn a_cancel_ends_on_the_path_with_the_pen_up_and_a_new_path_can_follow() {
    let settings = Settings::default();
    let (path, _) = portrait(&mut Random::new(3), 2);
    for cancel_at in 1..40 {
        let name = format!("cancel after {cancel_at} periods");
        let mut run = Run::new(&settings, &path);
        run.feed(usize::MAX);
        run.command(MotionCommand::Start);
        for _ in 0..cancel_at {
            run.step();
        }
        run.command(MotionCommand::Cancel);
        for _ in 0..40 {
            run.step();
        }
        assert_eq!(run.trajectory.state(), MotionState::Idle, "{name}");
        assert_eq!(run.trajectory.free(), QUEUE_VERTICES);
        assert!(run.end()[2] > -849.9, "{name}: pen is down");
        run.check_limits(&name);
        let executed = run.trajectory.executed();
        assert!(executed < path.len() as u32);
        run.pushed = 0;
        run.command(MotionCommand::Start);
        run.until(MotionState::Idle);
        run.check_limits(&name);
        assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
    }
}

#[test]
fn a_jog_stops_when_it_is_not_repeated_and_at_the_border() {
    let mut settings = Settings::default();
    settings.paper.pressing_depth_mm = 110.0;
    let start = [vertex([0.0, 0.0, -850.0], Pen::Up, 0)];
    let mut run = Run::new(&settings, &start);
    for _ in 0..20 {
        run.command(MotionCommand::Jog([50.0, 0.0, 0.0]));
        run.step();
    }
    let moved = run.end()[0];
    assert!(moved > 9.0 && moved < 12.0, "{moved}");
    for _ in 0..20 {
        run.step();
    }
    assert_eq!(run.trajectory.state(), MotionState::Idle);
    assert!(run.end()[0] < moved + 50.0 * 0.1 + 1.5);
    for direction in [[300.0, 40.0, 0.0], [0.0, 0.0, 300.0], [-20.0, -300.0, -300.0]] {
        for _ in 0..500 {
            run.command(MotionCommand::Jog(direction));
            run.step();
        }
        let area = crate::WorkArea::new(&settings).unwrap();
        assert!(area.check(&run.end().into()).is_ok(), "{direction:?} leads outside");
        run.command(MotionCommand::JogStop);
        run.until(MotionState::Idle);
        let refusal = run.trajectory.command(MotionCommand::Jog(direction));
        assert!(
            matches!(
                refusal,
                Err(MotionRefusal::Target(Refusal {
                    reason: RefusalReason::Outside(_),
                    ..
                }))
            ),
            "at the border {direction:?} leads nowhere: {refusal:?}"
        );
    }
    run.check_limits("jog");
    let refusal = run.trajectory.command(MotionCommand::Jog([f64::NAN, 0.0, 0.0]));
    assert!(matches!(refusal, Err(MotionRefusal::Target(_))));
}

#[test]
fn moves_and_the_pen_keep_the_limits_and_unreachable_targets_are_refused() {
    let mut settings = Settings::default();
    settings.paper.pressing_depth_mm = 60.0;
    let mut run = Run::new(&settings, &[vertex([0.0, 0.0, -850.0], Pen::Up, 0)]);
    let at = |x_mm, y_mm, z_mm| Position { x_mm, y_mm, z_mm };
    for target in [at(400.0, 0.0, -900.0), at(-300.0, 300.0, -850.0), at(0.0, 0.0, -847.0)] {
        run.command(MotionCommand::MoveTo(target));
        assert_eq!(
            run.trajectory.command(MotionCommand::Pen(Pen::Up)),
            Err(MotionRefusal::State(MotionState::Moving))
        );
        run.until(MotionState::Idle);
        assert!(length(&subtract(&run.end(), &target.into())) < 1.0e-6);
    }
    run.command(MotionCommand::Pen(Pen::Down));
    run.until(MotionState::Idle);
    assert!((run.end()[2] + 850.0).abs() < 1.0e-6 && run.setpoints.last().unwrap().pen == Pen::Down);
    run.command(MotionCommand::Pen(Pen::Up));
    run.until(MotionState::Idle);
    assert!((run.end()[2] + 847.0).abs() < 1.0e-6);
    for target in [at(f64::NAN, 0.0, -850.0), at(0.0, 900.0, -850.0), at(0.0, 0.0, 0.0)] {
        let refusal = run.trajectory.command(MotionCommand::MoveTo(target));
        assert!(matches!(refusal, Err(MotionRefusal::Target(_))), "{target:?}");
    }
    run.check_limits("moves");
}

#[test]
fn a_pen_whose_way_down_is_cancelled_is_up_unless_it_gets_there() {
    let settings = Settings::default();
    let mut got_there = [0; 2];
    for periods in 0..40 {
        let mut run = Run::new(&settings, &[vertex([0.0, 0.0, -800.0], Pen::Up, 0)]);
        run.command(MotionCommand::Pen(Pen::Down));
        for _ in 0..periods {
            run.step();
        }
        if run.trajectory.state() == MotionState::Idle {
            break;
        }
        run.command(MotionCommand::Cancel);
        run.until(MotionState::Idle);
        run.step();
        let is_down = (run.end()[2] + 850.0).abs() < 1.0e-6;
        got_there[usize::from(is_down)] += 1;
        let pen = run.setpoints.last().unwrap().pen;
        assert_eq!(pen == Pen::Down, is_down, "after {periods} periods, at {:?}", run.end());
    }
    println!("cancelled {got_there:?} times before and behind the beginning of the last ramp");
    assert!(got_there[0] > 2);
}

#[test]
fn the_pen_is_lowered_to_a_sheet_that_is_not_level_and_lifted_from_where_it_lies() {
    let mut settings = Settings::default();
    settings.paper.slope = [0.02, -0.01];
    let surface = |x: f64, y: f64| -850.0 + 0.02 * x - 0.01 * y;
    for [x, y] in [[90.0, -90.0], [-90.0, 90.0], [80.0, 80.0]] {
        let above = [x, y, surface(x, y) + 5.0];
        let mut run = Run::new(&settings, &[vertex(above, Pen::Up, 0)]);
        for (pen, lift_mm) in [(Pen::Down, 0.0), (Pen::Up, 3.0), (Pen::Down, 0.0)] {
            run.command(MotionCommand::Pen(pen));
            run.until(MotionState::Idle);
            let expected = [x, y, surface(x, y) + lift_mm];
            assert!(length(&subtract(&run.end(), &expected)) < 1.0e-6, "{pen:?} at {x}, {y}");
        }
        let mut admission = Admission::new(&settings).unwrap();
        let pose = JointAngles(run.setpoints.last().unwrap().position_rad);
        assert_eq!(admission.check_pen(&pose, Pen::Down), Ok(()));
        admission.restart_at(&pose);
        let below = [x, y, surface(x, y) - 1.01];
        assert!(admission.check(0, &vertex(below, Pen::Down, 0)).is_err(), "{x}, {y}");
        // A path that begins with the pen down elsewhere lifts it first.
        run.path = [
            vertex([0.0, 0.0, surface(0.0, 0.0) + 3.0], Pen::Up, 0),
            vertex([0.0, 0.0, surface(0.0, 0.0)], Pen::Up, 0),
            vertex([10.0, 0.0, surface(10.0, 0.0)], Pen::Down, 0),
        ]
        .to_vec();
        run.pushed = 0;
        let before = run.setpoints.len();
        run.command(MotionCommand::Start);
        run.until(MotionState::Idle);
        let kinematics = Kinematics::new(&settings.geometry).unwrap();
        let places: Vec<Vector> = run.setpoints[before..]
            .iter()
            .map(|at| kinematics.forward(&JointAngles(at.position_rad)).unwrap().into())
            .collect();
        let highest = places.iter().map(|[x, y, z]| z - surface(*x, *y)).fold(0.0, f64::max);
        assert!((2.0..3.01).contains(&highest), "{highest}");
        // It leaves its place straight up.
        let drags = |[at_x, at_y, z]: &Vector| {
            (at_x - x).hypot(at_y - y) > 1.0 && (at_x - 0.0).hypot(*at_y) > 11.0 && z - surface(*at_x, *at_y) < 1.5
        };
        assert!(!places.iter().any(drags), "{x}, {y}");
        run.check_limits("tilted");
    }
}

#[test]
fn a_move_that_is_ended_brakes_at_once_and_within_the_limits() {
    let settings = Settings::default();
    let (from, to) = ([-100.0, 0.0, -800.0], [100.0, 40.0, -800.0]);
    let moving = || {
        let mut run = Run::new(&settings, &[vertex(from, Pen::Up, 0)]);
        // No path follows.
        run.pushed = run.path.len();
        run.command(MotionCommand::MoveTo(to.into()));
        run
    };
    let whole = {
        let mut run = moving();
        run.until(MotionState::Idle);
        run.setpoints.len() / PERIOD_MS
    };
    for command in [MotionCommand::Cancel, MotionCommand::Hold] {
        for periods in 1..whole - 1 {
            let name = format!("{command:?} after {periods} periods");
            let mut run = moving();
            for _ in 0..periods {
                run.step();
            }
            assert_eq!(run.trajectory.state(), MotionState::Moving, "{name}");
            let going = length(&subtract(&run.end(), &from));
            run.command(command);
            // A second command does not prolong the braking.
            run.step();
            let _ = run.trajectory.command(command);
            run.until(MotionState::Idle);
            assert!(run.setpoints.len() / PERIOD_MS <= whole + 1, "{name}: too late");
            let moved = length(&subtract(&run.end(), &from));
            assert!(moved >= going, "{name}: back from {going} to {moved} mm");
            assert!(distance(&run.end(), &from, &to) < 1.0e-6, "{name}: beside the line");
            if periods < whole / 3 {
                assert!(moved < 0.75 * length(&subtract(&to, &from)), "{name}: {moved} mm");
            }
            run.check_limits(&name);
            run.command(MotionCommand::MoveTo(to.into()));
            run.until(MotionState::Idle);
            assert!(length(&subtract(&run.end(), &to)) < 1.0e-6, "{name}: a move can follow");
            run.check_limits(&name);
        }
    }
}

#[test]
fn a_robot_whose_joint_is_on_the_other_side_gets_no_setpoints_that_would_jump_there() {
    let settings = Settings {
        geometry: Kind::Scara.geometry(),
        ..Settings::default()
    };
    let mut trajectory = Trajectory::new(&settings).unwrap();
    for second_rad in [0.02, 0.6, 2.0] {
        let pose = |side: f64| JointAngles([0.2, side * second_rad, -0.1, 0.0]);
        assert!(trajectory.place(pose(1.0)), "{second_rad} rad");
        let begun = trajectory.step();
        assert!(begun.iter().all(|r| (r.position_rad[1] - second_rad).abs() < 1.0e-9));
        assert!(!trajectory.place(pose(-1.0)), "{second_rad} rad");
        assert_eq!(trajectory.command(MotionCommand::Start), Err(MotionRefusal::NotPlaced));
    }
}

#[test]
fn what_is_not_a_number_is_refused_and_a_full_queue_says_so() {
    let settings = Settings::default();
    let mut trajectory = placed(&settings, [0.0, 0.0, -850.0]);
    let refusal = trajectory.push(vertex([f64::INFINITY, 0.0, 0.0], Pen::Up, 0));
    assert!(matches!(refusal, Err(MotionRefusal::Target(_))));
    let mut pushed = 0;
    while trajectory
        .push(vertex([0.5 * f64::from(pushed + 1), 0.0, -850.0], Pen::Down, 0))
        .is_ok()
    {
        pushed += 1;
    }
    assert_eq!((pushed as usize, trajectory.free()), (QUEUE_VERTICES, 0));
    let mut lost = Trajectory::new(&settings).unwrap();
    assert!(!lost.place(JointAngles([f64::NAN; AXES])));
    assert_eq!(lost.command(MotionCommand::Start), Err(MotionRefusal::NotPlaced));
    assert!(lost.step().iter().all(|r| r.velocity_rad_s == [0.0; AXES]));
}

#[test]
fn a_reconfigured_stage_is_as_good_as_new() {
    let first = Settings::default();
    let mut second = Settings::default();
    second.motion.tolerance_mm = 0.2;
    second.paper.pen_lift_mm += 1.0;
    let path = [[0.0, 0.0], [40.0, 10.0], [10.0, 60.0], [-30.0, 20.0]].map(|[x, y]| {
        let point = [x, y, second.paper.pen_down_z_mm];
        vertex(point, Pen::Down, 1)
    });
    let start: Vector = path[0].position.into();
    let setpoints = |mut trajectory: Trajectory| -> Vec<[Setpoint; PERIOD_MS]> {
        for vertex in path {
            trajectory.push(vertex).unwrap();
        }
        trajectory.finish();
        trajectory.command(MotionCommand::Start).unwrap();
        (0..200).map(|_| trajectory.step()).collect()
    };
    let mut used = placed(&first, start);
    for vertex in path {
        used.push(vertex).unwrap();
    }
    used.command(MotionCommand::Start).unwrap();
    for _ in 0..20 {
        used.step();
    }
    used.reconfigure(&second).unwrap();
    let [a, b, c] = Kinematics::new(&second.geometry)
        .unwrap()
        .inverse(&start.into())
        .unwrap();
    assert!(used.place(JointAngles([a, b, c, 0.0])));
    let (used, new) = (setpoints(used), setpoints(placed(&second, start)));
    assert_eq!(used, new);
    assert_ne!(new[0], new[199], "the path moved");
}

/// Places outside the default work area, and the way in: beside it, above it, under the paper, a joint out of range.
const OUTSIDE: [([f64; 3], [f64; 3]); 5] = [
    ([570.0, 0.0, -800.0], [-30.0, 0.0, 0.0]),
    ([-420.0, 400.0, -800.0], [30.0, -30.0, 0.0]),
    ([0.0, 0.0, -690.0], [0.0, 0.0, -30.0]),
    ([50.0, 20.0, -853.0], [0.0, 0.0, 30.0]),
    ([0.0, 0.0, -560.0], [0.0, 0.0, -60.0]),
];

#[test]
fn a_jog_from_outside_leads_inwards_and_nowhere_else() {
    let settings = Settings::default();
    let area = crate::WorkArea::new(&settings).unwrap();
    for (outside, inwards) in OUTSIDE {
        let start = [vertex(outside, Pen::Up, 0)];
        let mut run = Run {
            trajectory: Trajectory::new(&settings).unwrap(),
            ..Run::new(&settings, &[vertex([0.0, 0.0, -800.0], Pen::Up, 0)])
        };
        run.path = start.to_vec();
        run.pushed = 1;
        run.setpoints.clear();
        let [a, b, c] = area.kinematics().angles(&outside);
        let pose = JointAngles([a, b, c, 0.0]);
        assert!(area.check(&outside.into()).is_err(), "{outside:?} is inside");
        assert!(run.trajectory.place(pose));
        let admission = Admission::new(&settings).unwrap();
        let away = inwards.map(|part| -part);
        let along = [
            inwards[1] - inwards[2],
            inwards[2] - inwards[0],
            inwards[0] - inwards[1],
        ];
        assert!(
            run.trajectory.command(MotionCommand::Jog(away)).is_err(),
            "{outside:?}: outwards"
        );
        assert!(admission.check_jog(&pose, &away).is_err());
        // Along a single border a jog leads neither inwards nor outwards.
        if outside[0] == 0.0 {
            assert!(
                run.trajectory.command(MotionCommand::Jog(along)).is_err() || along[2] < 0.0,
                "{outside:?}: along"
            );
        }
        assert_eq!(
            run.trajectory.state(),
            MotionState::Idle,
            "a refused jog changes nothing"
        );
        assert_eq!(admission.check_jog(&pose, &inwards), Ok(()), "{outside:?}");
        let came_in = (0..2_000).find(|_| {
            // Near several borders the direction may have to change.
            let _ = run.trajectory.command(MotionCommand::Jog(inwards));
            run.step();
            area.check(&run.trajectory.position()).is_ok()
        });
        assert!(
            came_in.is_some(),
            "{outside:?}: still outside at {:?}",
            run.trajectory.position()
        );
        run.command(MotionCommand::JogStop);
        run.until(MotionState::Idle);
        assert!(area.check(&run.end().into()).is_ok(), "{outside:?}: left again");
        run.check_limits(&format!("jog from {outside:?}"));
    }
}

#[test]
fn a_move_and_the_pen_come_in_from_outside_and_lead_nowhere_else() {
    let settings = Settings::default();
    let area = crate::WorkArea::new(&settings).unwrap();
    for (outside, inwards) in OUTSIDE {
        let mut trajectory = Trajectory::new(&settings).unwrap();
        let mut admission = Admission::new(&settings).unwrap();
        let [a, b, c] = area.kinematics().angles(&outside);
        let pose = JointAngles([a, b, c, 0.0]);
        assert!(trajectory.place(pose));
        let beyond = Position::from(add_scaled(&outside, &inwards, -0.2));
        assert!(
            trajectory.command(MotionCommand::MoveTo(beyond)).is_err(),
            "{outside:?}: outwards"
        );
        assert!(admission.check_move(&pose, &beyond).is_err());
        let inside = Position::from([0.0, 0.0, -800.0]);
        assert_eq!(admission.check_move(&pose, &inside), Ok(()), "{outside:?}");
        assert_eq!(trajectory.command(MotionCommand::MoveTo(inside)), Ok(()), "{outside:?}");
        for _ in 0..2_000 {
            trajectory.step();
        }
        assert_eq!(trajectory.state(), MotionState::Idle);
        let away = length(&subtract(&trajectory.position().into(), &inside.into()));
        assert!(away < 1.0e-6, "{outside:?}: it stands {away} mm away");
    }
    let beside = area.kinematics().angles(&[570.0, 0.0, -800.0]);
    let pose = JointAngles([beside[0], beside[1], beside[2], 0.0]);
    let refusal = Admission::new(&settings)
        .unwrap()
        .check_pen(&pose, Pen::Down)
        .unwrap_err();
    assert!(
        matches!(refusal.reason, RefusalReason::Outside(crate::Outside::Radius { .. })),
        "{refusal:?}"
    );
}

#[test]
fn a_path_that_is_held_while_it_waits_for_data_moves_only_when_it_is_resumed() {
    let settings = Settings::default();
    let (path, _) = portrait(&mut Random::new(5), 3);
    let mut run = Run::new(&settings, &path);
    run.command(MotionCommand::Start);
    run.feed(12);
    for _ in 0..120 {
        run.step();
    }
    assert_eq!(run.trajectory.state(), MotionState::Starved);
    let waiting = *run.setpoints.last().unwrap();
    run.command(MotionCommand::Hold);
    for _ in 0..50 {
        run.feed(usize::MAX);
        run.step();
        assert_eq!(run.trajectory.state(), MotionState::Held);
        assert_eq!(run.setpoints.last().unwrap().position_rad, waiting.position_rad);
    }
    run.command(MotionCommand::Resume);
    run.until(MotionState::Idle);
    run.check_limits("held while starved");
    assert_eq!(run.trajectory.executed() as usize, path.len());
}

#[test]
fn a_jog_is_no_faster_than_the_travel_speed() {
    let mut settings = Settings::default();
    settings.motion.travel_speed_mm_s = 20.0;
    let mut run = Run::new(&settings, &[vertex([0.0, 0.0, -850.0], Pen::Up, 0)]);
    let mut fastest_mm_s = 0.0_f64;
    for _ in 0..60 {
        let before = run.end();
        run.command(MotionCommand::Jog([40.0, -30.0, 0.0]));
        run.step();
        let speed_mm_s = length(&subtract(&run.end(), &before)) / (PERIOD_MS as f64 * TICK_S);
        fastest_mm_s = fastest_mm_s.max(speed_mm_s);
    }
    assert!(fastest_mm_s > 19.0 && fastest_mm_s <= 20.0, "{fastest_mm_s} mm/s");
}
