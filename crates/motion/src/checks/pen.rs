//! Requirements on lifting and lowering the pen as parts of the path.

use super::*;

/// Largest vertical speed and acceleration of the setpoints.
fn vertical(run: &Run) -> (f64, f64) {
    let kinematics = Kinematics::new(&run.settings.geometry).unwrap();
    let heights: Vec<f64> = run
        .setpoints
        .iter()
        .map(|setpoint| kinematics.forward(&JointAngles(setpoint.position_rad)).unwrap().z_mm)
        .collect();
    heights.windows(3).fold((0.0_f64, 0.0_f64), |(speed, acceleration), z| {
        let (first, second) = ((z[1] - z[0]) / TICK_S, (z[2] - z[1]) / TICK_S);
        (
            speed.max(second.abs()),
            acceleration.max((second - first).abs() / TICK_S),
        )
    })
}

#[test]
fn the_pen_has_limits_of_its_own() {
    for (speed, acceleration) in [(40.0, 1_000.0), (20.0, 0.0), (0.0, 500.0), (200.0, 4_000.0)] {
        let mut settings = Settings::default();
        settings.motion.pen_speed_mm_s = speed;
        settings.motion.pen_acceleration_mm_s2 = acceleration;
        for seed in 1..=12 {
            let name = format!("{speed} mm/s, {acceleration} mm/s2, seed {seed}");
            let (path, _) = portrait(&mut Random::new(seed), 4);
            let mut run = Run::new(&settings, &path);
            run.command(MotionCommand::Start);
            for _ in 0..30 {
                run.feed(usize::MAX);
                run.step();
            }
            run.command(MotionCommand::Hold);
            run.until(MotionState::Held);
            run.command(MotionCommand::Resume);
            run.until(MotionState::Idle);
            run.check_limits(&name);
            run.check_drawn(&name);
            let (fastest, strongest) = vertical(&run);
            assert!(
                speed == 0.0 || fastest <= speed * (1.0 + EXCESS),
                "{name}: {fastest} mm/s"
            );
            assert!(
                acceleration == 0.0 || strongest <= acceleration * (1.0 + EXCESS) + 0.1,
                "{name}: {strongest} mm/s2"
            );
            if seed == 1 {
                println!("{name}: {fastest:.2} mm/s, {strongest:.1} mm/s2");
            }
        }
    }
}

#[test]
fn a_jog_keeps_the_pens_limits_too() {
    for (speed, acceleration) in [(20.0, 300.0), (0.0, 300.0), (20.0, 0.0)] {
        let mut settings = Settings::default();
        settings.motion.pen_speed_mm_s = speed;
        settings.motion.pen_acceleration_mm_s2 = acceleration;
        let name = format!("{speed} mm/s, {acceleration} mm/s2");
        let mut run = Run::new(&settings, &[vertex([0.0, 0.0, -800.0], Pen::Up, 0)]);
        for z_mm_s in [60.0, -60.0] {
            for _ in 0..40 {
                run.command(MotionCommand::Jog([0.0, 0.0, z_mm_s]));
                run.step();
            }
        }
        run.command(MotionCommand::JogStop);
        run.until(MotionState::Idle);
        run.check_limits(&name);
        let (fastest, strongest) = vertical(&run);
        let wanted = if speed > 0.0 { speed } else { 60.0 };
        assert!(fastest > 0.9 * wanted, "{name}: {fastest} mm/s");
        assert!(fastest <= wanted * (1.0 + EXCESS), "{name}: {fastest} mm/s");
        assert!(
            acceleration == 0.0 || strongest <= acceleration * (1.0 + EXCESS) + 0.1,
            "{name}: {strongest} mm/s2"
        );
    }
}

#[test]
fn random_lifts_keep_the_pens_limits_between_the_points_of_the_grid_too() {
    let (mut worst, mut samples) = ((0.0_f64, 0.0_f64), 0);
    for seed in 1..=250 {
        let mut random = Random::new(seed);
        let mut settings = Settings::default();
        let motion = &mut settings.motion;
        motion.pen_speed_mm_s = random.between(5.0, 300.0);
        motion.pen_acceleration_mm_s2 = random.between(200.0, 9_000.0);
        motion.travel_tolerance_mm = random.between(0.2, 1.0);
        motion.tolerance_mm = random.between(0.03, 0.2);
        motion.jerk_window_ms = random.below(9) as u16;
        settings.paper.pen_lift_mm = random.between(0.5, 10.0);
        let (speed_max, acceleration_max) = (motion.pen_speed_mm_s, motion.pen_acceleration_mm_s2);
        let (down, up) = (
            settings.paper.pen_down_z_mm,
            settings.paper.pen_down_z_mm + settings.paper.pen_lift_mm,
        );
        let mut path = Vec::new();
        for stroke in 0..4 {
            let mut point = [random.between(-20.0, 20.0), random.between(-20.0, 20.0), up];
            // Straight down, on a slant, or over a hump.
            let slant = [0.0, random.between(-6.0, 6.0), random.between(-0.5, 0.5)][random.below(3)];
            path.push(vertex(point, Pen::Up, stroke));
            if random.below(3) == 0 {
                path.push(vertex([point[0] + slant, point[1], 0.5 * (up + down)], Pen::Up, stroke));
            }
            point = [point[0] + 2.0 * slant, point[1], down];
            path.push(vertex(point, Pen::Up, stroke));
            for _ in 0..1 + random.below(6) {
                point[0] += random.between(-5.0, 5.0);
                point[1] += random.between(-5.0, 5.0);
                path.push(vertex(point, Pen::Down, stroke));
            }
            path.push(vertex([point[0] + slant, point[1] - slant, up], Pen::Up, stroke));
        }
        let name = format!("seed {seed}");
        let run = Run::new(&settings, &path).whole();
        run.check_limits(&name);
        run.check_deviation(&name);
        let (speed, acceleration) = vertical(&run);
        worst = (
            worst.0.max(speed / speed_max),
            worst.1.max(acceleration / acceleration_max),
        );
        samples += run.setpoints.len();
        assert!(
            speed <= speed_max * (1.0 + EXCESS),
            "{name}: {speed} of {speed_max} mm/s"
        );
        assert!(
            acceleration <= acceleration_max * (1.0 + EXCESS) + 0.1,
            "{name}: {acceleration} of {acceleration_max} mm/s2"
        );
    }
    println!("worst parts of the vertical limits in {samples} samples: {worst:?}");
}

#[test]
fn the_pen_changes_without_a_stop_unless_it_dwells() {
    let (path, _) = portrait(&mut Random::new(2), 5);
    let rests = |dwell_ms: u16| {
        let mut settings = Settings::default();
        settings.motion.pen_dwell_ms = dwell_ms;
        let run = Run::new(&settings, &path).whole();
        run.check_limits("dwell");
        run.check_deviation("dwell");
        let moving = run.setpoints.iter().skip_while(|r| r.velocity_rad_s == [0.0; AXES]);
        let (mut longest, mut current, mut rests) = (0, 0, 0);
        for setpoint in moving {
            if setpoint.velocity_rad_s == [0.0; AXES] {
                current += 1;
                continue;
            }
            rests += usize::from(current > 0);
            longest = longest.max(current);
            current = 0;
        }
        (rests, longest, run.duration_s())
    };
    let (none, _, without_s) = rests(0);
    assert_eq!(none, 0);
    let (ten, longest, with_s) = rests(40);
    assert_eq!(ten, 10, "each stroke is lowered and lifted once");
    // The average over 4 ms shortens the rest that is seen.
    assert!((36..=41).contains(&longest), "{longest} ms");
    assert!(with_s > without_s + 10.0 * 0.04);
}

#[test]
fn a_path_that_begins_on_the_paper_leaves_no_ink_on_the_way_to_its_first_stroke() {
    let mut settings = Settings::default();
    settings.work_area.radius_mm = 120.0;
    let kinematics = Kinematics::new(&settings.geometry).unwrap();
    let area = crate::WorkArea::new(&settings).unwrap();
    let (down, up) = (
        settings.paper.pen_down_z_mm,
        settings.paper.pen_down_z_mm + settings.paper.pen_lift_mm,
    );
    for seed in 1..=40 {
        let mut random = Random::new(seed);
        let mut spot = |z| [random.between(-60.0, 60.0), random.between(-60.0, 60.0), z];
        let (mut rest, above, end) = (spot(down), spot(up), spot(down));
        // A machine that was placed wrongly may stand outside when it is placed again.
        if seed % 2 == 0 {
            let (radius_mm, angle) = (
                settings.work_area.radius_mm + random.between(0.1, 20.0),
                random.between(-PI, PI),
            );
            rest = [radius_mm * libm::cos(angle), radius_mm * libm::sin(angle), down];
            assert!(area.check(&rest.into()).is_err(), "seed {seed}: {rest:?} is inside");
        }
        let on_paper = [above[0], above[1], down];
        let path = [
            vertex(above, Pen::Up, 1),
            vertex(on_paper, Pen::Down, 1),
            vertex(end, Pen::Down, 1),
            vertex([end[0], end[1], up], Pen::Up, 1),
        ];
        let mut run = Run::new(&settings, &path);
        run.trajectory = placed(&settings, rest);
        run.setpoints.clear();
        run.step();
        let run = run.whole();
        run.check_limits(&format!("seed {seed}"));
        for setpoint in &run.setpoints {
            let at = kinematics.forward(&JointAngles(setpoint.position_rad)).unwrap();
            let touches = at.z_mm < down + 0.05 * settings.paper.pen_lift_mm;
            let dragged = (at.x_mm - rest[0]).hypot(at.y_mm - rest[1]);
            if setpoint.pen == Pen::Up && touches && dragged > settings.motion.tolerance_mm {
                let placing = (at.x_mm - above[0]).hypot(at.y_mm - above[1]);
                let lifting = (at.x_mm - end[0]).hypot(at.y_mm - end[1]);
                assert!(
                    placing.min(lifting) < 0.1,
                    "seed {seed}: ink {dragged:.2} mm from where the pen stood"
                );
            }
        }
    }
}
