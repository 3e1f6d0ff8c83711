//! Requirements on the count of executed vertices: none counts before the path has reached it.
//!
//! A job that continues after a fault starts at the last counted vertex, so an early count leaves a gap.

use super::*;

/// Distance before a vertex that counts as zero, mm: rounding of the setpoints' angles and of the kinematics.
const ROUNDED_MM: f64 = 1.0e-6;

fn unaveraged() -> Settings {
    let mut settings = Settings::default();
    settings.motion.jerk_window_ms = 0;
    settings
}

/// Largest distance to a vertex when it is first counted, mm, along the line from the vertex before to the one after.
fn earliest_mm(run: &Run) -> f64 {
    let kinematics = Kinematics::new(&run.settings.geometry).unwrap();
    let mut worst = f64::MIN;
    for pair in run.setpoints.windows(2) {
        let at = Vector::from(kinematics.forward(&JointAngles(pair[1].position_rad)).unwrap());
        for index in pair[0].vertex as usize..pair[1].vertex as usize {
            let point = |index: usize| Vector::from(run.path[index].position);
            let after = (index + 1).min(run.path.len() - 1);
            let onward = subtract(&point(after), &point(index.saturating_sub(1)));
            let left = subtract(&point(index), &at);
            worst = worst.max(dot(&left, &onward) / length(&onward));
        }
    }
    worst
}

/// Legs as uneven as a spline accepts, straight or with turns that the tolerance allows.
fn uneven(random: &mut Random, straight: bool) -> Vec<Vertex> {
    let (mut at, mut heading, mut leg) = ([-100.0, 0.0, -850.0], 0.0_f64, random.between(0.5, 10.0));
    let mut path = std::vec![vertex(at, Pen::Down, 0)];
    for _ in 0..12 {
        leg = (leg * libm::exp(random.between(-1.09, 1.09))).clamp(0.1, 12.0);
        if !straight {
            heading += random.between(-1.0, 1.0) * (0.12 / leg).min(0.5);
        }
        at[0] += leg * libm::cos(heading);
        at[1] += leg * libm::sin(heading);
        path.push(vertex(at, Pen::Down, 0));
    }
    path
}

#[test]
fn no_vertex_counts_before_the_path_reaches_it() {
    let settings = unaveraged();
    let mut worst = f64::MIN;
    for seed in 1..=40 {
        let path = uneven(&mut Random::new(seed), seed % 2 == 0);
        let run = Run::new(&settings, &path).whole();
        let early = earliest_mm(&run);
        assert!(early < ROUNDED_MM, "seed {seed}: counted {early} mm before");
        assert_eq!(run.trajectory.executed() as usize, path.len());
        worst = worst.max(early);
    }
    println!("counted {worst} mm before at most");
}

#[test]
fn a_motion_that_rests_for_want_of_vertices_counts_only_those_that_it_has_reached() {
    let settings = unaveraged();
    for seed in 1..=20 {
        let path = uneven(&mut Random::new(seed), seed % 2 == 0);
        let mut run = Run::new(&settings, &path);
        run.command(MotionCommand::Start);
        for _ in 1..path.len() {
            run.feed(1);
            for _ in 0..40 {
                run.step();
            }
            let early = earliest_mm(&run);
            assert!(early < ROUNDED_MM, "seed {seed}: counted {early} mm before");
        }
        run.until(MotionState::Idle);
        assert_eq!(run.trajectory.executed() as usize, path.len());
    }
}
