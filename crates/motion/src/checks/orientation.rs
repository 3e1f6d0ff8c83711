//! Requirements on the fourth axis where it follows the path.

use super::super::heading::{Winding, turn_to};
use super::*;
use crate::settings::Orientation;

fn following() -> Settings {
    let mut settings = Settings::default();
    settings.motion.orientation = Orientation::Path;
    settings
}

/// Largest difference between the fourth axis and the direction of the drawn leg in the middle of long legs, rad, and
/// over how many setpoints.
fn misalignment(run: &Run) -> (f64, usize) {
    let kinematics = Kinematics::new(&run.settings.geometry).unwrap();
    let (mut worst, mut samples) = (0.0_f64, 0);
    let drawn = |setpoint: &&Setpoint| setpoint.pen == Pen::Down && setpoint.velocity_rad_s[..3] != [0.0; 3];
    for setpoint in run.setpoints.iter().filter(drawn) {
        let at = Vector::from(kinematics.forward(&JointAngles(setpoint.position_rad)).unwrap());
        let near = setpoint.vertex as usize;
        // Legs may cross.
        let (mut off, mut on_long_leg) = (f64::INFINITY, false);
        for leg in run.path[near.saturating_sub(2)..(near + 3).min(run.path.len())].windows(2) {
            let (from, to) = (Vector::from(leg[0].position), Vector::from(leg[1].position));
            let way = subtract(&to, &from);
            let along = dot(&subtract(&at, &from), &way) / dot(&way, &way);
            let middle = along * length(&way) > 3.0 && (1.0 - along) * length(&way) > 3.0;
            if distance(&at, &from, &to) < 1.0e-3 && leg[1].pen == Pen::Down {
                on_long_leg |= middle;
                let direction = libm::atan2(way[1], way[0]);
                off = off.min(turn_to(setpoint.position_rad[3], direction).abs());
            }
        }
        if on_long_leg {
            worst = worst.max(off);
            samples += 1;
        }
    }
    (worst, samples)
}

#[test]
fn the_fourth_axis_follows_the_path_within_its_limits() {
    let mut worst = [0.0_f64; KINDS];
    for seed in 1..=60 {
        let path = random_path(&mut Random::new(seed), 2);
        let name = format!("seed {seed}");
        let run = Run::new(&following(), &path).whole();
        for (all, one) in worst.iter_mut().zip(run.check_limits(&name)) {
            *all = all.max(one);
        }
        run.check_deviation(&name);
        assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
    }
    println!("worst parts of the limits: {worst:?}");
}

#[test]
fn on_a_straight_leg_the_fourth_axis_has_its_direction() {
    for seed in 1..=20 {
        let mut random = Random::new(seed);
        let (mut point, mut heading) = ([0.0, 0.0, -850.0], 0.0);
        let mut path = std::vec![vertex([0.0, 0.0, -847.0], Pen::Up, 0), vertex(point, Pen::Up, 0)];
        for _ in 0..8 {
            // Gentle turns would be rounded along their full length.
            let turn = random.between(-2.2, 2.2);
            heading += turn + turn.signum() * 0.3;
            let leg = random.between(8.0, 20.0);
            point[0] += leg * libm::cos(heading);
            point[1] += leg * libm::sin(heading);
            path.push(vertex(point, Pen::Down, 0));
        }
        let run = Run::new(&following(), &path).whole();
        run.check_limits("polygon");
        let (off, samples) = misalignment(&run);
        assert!(samples > 20, "seed {seed}: {samples} samples on long legs");
        assert!(off < 1.0e-3, "seed {seed}: {off} rad off the direction of the leg");
    }
}

#[test]
fn on_a_circle_the_fourth_axis_turns_on_and_on() {
    let mut path = Vec::new();
    for step in 0..=300 {
        let angle = TAU * f64::from(step) / 100.0;
        let point = [20.0 * libm::cos(angle), 20.0 * libm::sin(angle), -850.0];
        path.push(vertex(point, Pen::Down, 0));
    }
    let run = Run::new(&following(), &path).whole();
    run.check_limits("circle");
    let turned = run.setpoints.last().unwrap().position_rad[3] - PI / 2.0;
    assert!((turned - 3.0 * TAU).abs() < 0.1, "{turned} rad");
    let constant = Run::new(&Settings::default(), &path).whole();
    println!(
        "circles: {:.3} s, {:.3} s with a constant angle",
        run.duration_s(),
        constant.duration_s()
    );
}

#[test]
fn the_angle_that_admission_expects_is_the_angle_of_the_setpoints() {
    let (mut worst, mut widest) = (0.0_f64, 0.0_f64);
    for seed in 1..=100 {
        let path = random_path(&mut Random::new(seed), 2);
        let run = Run::new(&following(), &path).whole();
        let mut winding = Winding::new(0.0);
        let mut range = (0.0_f64, 0.0_f64);
        for leg in path.windows(2) {
            winding = winding.over(&subtract(&leg[1].position.into(), &leg[0].position.into()));
            range = (range.0.min(winding.angle_rad()), range.1.max(winding.angle_rad()));
        }
        let end = run.setpoints.last().unwrap().position_rad[3];
        worst = worst.max((end - winding.angle_rad()).abs());
        for setpoint in &run.setpoints {
            let angle = setpoint.position_rad[3];
            assert!(
                range.0 - 1.0e-3 < angle && angle < range.1 + 1.0e-3,
                "seed {seed}: {angle} rad is not within {range:?}"
            );
        }
        widest = widest.max(range.1 - range.0);
    }
    println!("ends differ by {worst:e} rad at most, the widest range is {widest} rad");
    assert!(worst < 1.0e-6, "{worst} rad");
    assert!(widest > TAU);
}

#[test]
fn at_a_reversal_the_fourth_axis_turns_at_rest_and_does_not_wind_up() {
    let mut path = Vec::new();
    for step in 0..9 {
        let x_mm = if step % 2 == 0 { 0.0 } else { 30.0 };
        path.push(vertex([x_mm, 0.0, -850.0], Pen::Down, 0));
    }
    let run = Run::new(&following(), &path).whole();
    run.check_limits("to and fro");
    let angles = run.setpoints.iter().map(|setpoint| setpoint.position_rad[3]);
    let (low, high) = angles.fold((0.0_f64, 0.0_f64), |(low, high), angle| {
        (low.min(angle), high.max(angle))
    });
    assert!(high - low < PI + 1.0e-6, "from {low} to {high} rad");
    assert!(high - low > PI - 1.0e-6);
}

#[test]
fn a_hold_while_the_fourth_axis_turns_keeps_its_limits() {
    let path = random_path(&mut Random::new(4), 2);
    for hold_at in 1..60 {
        let name = format!("hold after {hold_at} periods");
        let mut run = Run::new(&following(), &path);
        run.feed(usize::MAX);
        run.command(MotionCommand::Start);
        for _ in 0..3 * hold_at {
            run.feed(usize::MAX);
            run.step();
        }
        if run.trajectory.command(MotionCommand::Hold).is_err() {
            break;
        }
        run.until(MotionState::Held);
        run.command(MotionCommand::Resume);
        run.until(MotionState::Idle);
        run.check_limits(&name);
        run.check_drawn(&name);
    }
}
