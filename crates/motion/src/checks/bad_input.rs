//! Requirements on bad input: a refusal that names the vertex, or a plan within the limits.

use super::super::plan::{GROWTH, POINTS};
use super::*;
use crate::WorkArea;
use crate::robots::DeltaGeometry;
use crate::settings::{Geometry, Orientation};

fn down(x_mm: f64, y_mm: f64) -> Vertex {
    vertex([x_mm, y_mm, -850.0], Pen::Down, 0)
}

/// Draws a path with both orientations and checks what must always hold.
fn draw(name: &str, path: &[Vertex]) {
    for orientation in [Orientation::Constant, Orientation::Path] {
        let mut settings = Settings::default();
        settings.motion.orientation = orientation;
        let run = Run::new(&settings, path).whole();
        run.check_limits(name);
        if path.len() > 1 {
            run.check_deviation(name);
        }
        assert_eq!(run.trajectory.executed() as usize, path.len(), "{name}");
        assert!(run.work_max as usize <= GROWTH + POINTS, "{name}");
    }
}

fn refused(bad: [f64; 3], index: u32) -> RefusalReason {
    let mut admission = Admission::new(&Settings::default()).unwrap();
    for good in 0..index {
        assert_eq!(admission.check(good, &down(f64::from(good), 0.0)), Ok(()));
    }
    let refusal = admission.check(index, &vertex(bad, Pen::Down, 0)).unwrap_err();
    assert_eq!(refusal.index, index);
    let mut trajectory = placed(&Settings::default(), [0.0, 0.0, -850.0]);
    assert!(matches!(
        trajectory.push(vertex(bad, Pen::Down, 0)),
        Err(MotionRefusal::Target(_))
    ));
    refusal.reason
}

#[test]
fn what_is_not_a_number_is_refused_with_its_index() {
    assert_eq!(refused([f64::NAN, 0.0, -850.0], 3), RefusalReason::NotFinite);
    assert_eq!(refused([0.0, 0.0, f64::NAN], 0), RefusalReason::NotFinite);
}

#[test]
fn an_infinite_coordinate_is_refused_with_its_index() {
    assert_eq!(refused([0.0, f64::INFINITY, -850.0], 2), RefusalReason::NotFinite);
    assert_eq!(refused([0.0, 0.0, f64::NEG_INFINITY], 1), RefusalReason::NotFinite);
    assert!(matches!(refused([f64::MAX, 0.0, -850.0], 1), RefusalReason::Outside(_)));
}

#[test]
fn repeated_vertices_are_refused_and_where_they_come_through_merged() {
    let mut admission = Admission::new(&Settings::default()).unwrap();
    assert_eq!(admission.check(0, &down(5.0, 0.0)), Ok(()));
    let refusal = admission.check(1, &down(5.0, 1.0e-4)).unwrap_err();
    assert!(matches!(
        refusal,
        Refusal {
            index: 1,
            reason: RefusalReason::Repeated { .. }
        }
    ));
    let points = [(0.0, 0.0), (0.0, 0.0), (5.0, 0.0), (5.0, 0.0), (5.0, 5.0), (5.0, 5.0)];
    draw("repeated", &points.map(|(x, y)| down(x, y)));
}

#[test]
fn a_stroke_of_one_vertex_is_a_dot() {
    let at = |z: f64, pen: Pen| vertex([0.0, 0.0, z], pen, 0);
    draw("dot", &[at(-847.0, Pen::Up), at(-850.0, Pen::Up), at(-847.0, Pen::Up)]);
    draw("lone", &[down(1.0, 1.0)]);
}

#[test]
fn reversals_are_exact_stops() {
    draw(
        "reversal",
        &[down(0.0, 0.0), down(20.0, 0.0), down(0.0, 0.0), down(20.0, 0.0)],
    );
}

#[test]
fn micrometre_zigzags_are_drawn() {
    let zigzag: Vec<Vertex> = (0..200)
        .map(|step| down(0.001 * f64::from(step), 0.001 * f64::from(step % 2)))
        .collect();
    draw("zigzag", &zigzag);
    draw(
        "mixed",
        &[
            down(0.0, 0.0),
            down(100.0, 0.0),
            down(100.0, 0.001),
            down(100.001, 0.001),
            down(0.0, 50.0),
        ],
    );
}

#[test]
fn legs_of_a_metre_are_drawn() {
    draw("metre", &[down(-500.0, 0.0), down(500.0, 0.0), down(-500.0, 0.001)]);
}

#[test]
fn a_stroke_of_a_million_vertices_costs_bounded_work_in_every_period() {
    let settings = Settings::default();
    const VERTICES: u32 = 1_000_000;
    let at = |index: u32| {
        let angle = 2.0e-4 * f64::from(index);
        down(60.0 * libm::cos(angle), 60.0 * libm::sin(angle))
    };
    let mut trajectory = placed(&settings, at(0).position.into());
    let (mut pushed, mut work, mut last, mut periods) = (0, 0, Setpoint::default(), 0_u32);
    trajectory.command(MotionCommand::Start).unwrap();
    while trajectory.executed() < VERTICES || trajectory.state() != MotionState::Idle {
        while pushed < VERTICES && trajectory.free() > 0 {
            trajectory.push(at(pushed)).unwrap();
            pushed += 1;
        }
        if pushed == VERTICES {
            trajectory.finish();
        }
        for setpoint in trajectory.step() {
            for axis in 0..AXES {
                let change = (setpoint.velocity_rad_s[axis] - last.velocity_rad_s[axis]) / TICK_S;
                assert!(change.abs() <= settings.motion.joint_acceleration_rad_s2[axis] * (1.0 + EXCESS));
            }
            last = setpoint;
        }
        work = work.max(trajectory.work());
        periods += 1;
        assert!(periods < 40_000, "stuck after {} vertices", trajectory.executed());
    }
    println!(
        "{} vertices a second, work at most {work}",
        u64::from(VERTICES) * 1_000 / (u64::from(periods) * PERIOD_MS as u64)
    );
    assert!(work as usize <= GROWTH + POINTS);
    assert_eq!(trajectory.underruns(), 0);
}

#[test]
fn vertices_on_the_border_of_the_work_area_are_taken_or_refused_and_never_left() {
    let settings = Settings::default();
    let area = WorkArea::new(&settings).unwrap();
    let (mut taken, mut refusals) = (0, 0);
    for z in [settings.work_area.z_high_mm, -850.0, -851.0, -851.1] {
        let mut admission = Admission::new(&settings).unwrap();
        let mut path = Vec::new();
        for index in 0..36_u32 {
            let angle = TAU * f64::from(index) / 36.0;
            let radius = settings.work_area.radius_mm;
            let next = vertex([radius * libm::cos(angle), radius * libm::sin(angle), z], Pen::Down, 0);
            match admission.check(index, &next) {
                Ok(()) => path.push(next),
                Err(refusal) => {
                    assert_eq!(refusal.index, index);
                    refusals += 1;
                }
            }
        }
        taken += path.len();
        if path.is_empty() {
            continue;
        }
        let run = Run::new(&settings, &path).whole();
        run.check_limits("border");
        for setpoint in &run.setpoints {
            let at = area.kinematics().forward(&JointAngles(setpoint.position_rad)).unwrap();
            let near = Position {
                x_mm: at.x_mm * (1.0 - 1.0e-9),
                y_mm: at.y_mm * (1.0 - 1.0e-9),
                z_mm: at.z_mm.clamp(z - 1.0e-6, z + 1.0e-6).clamp(-851.0, -700.0),
            };
            assert!(area.check(&near).is_ok(), "{at:?}");
        }
    }
    println!("{taken} taken, {refusals} refused");
    assert!(taken > 20 && refusals > 36);
}

#[test]
fn limits_of_zero_are_refused_and_never_moved_with() {
    type Change = fn(&mut Settings);
    let zeros: [(&str, Change); 6] = [
        ("motion.speed_mm_s", |settings| settings.motion.speed_mm_s = 0.0),
        ("motion.travel_speed_mm_s", |settings| {
            settings.motion.travel_speed_mm_s = 0.0
        }),
        ("motion.acceleration_mm_s2", |settings| {
            settings.motion.acceleration_mm_s2 = 0.0
        }),
        ("motion.joint_speed_rad_s", |settings| {
            settings.motion.joint_speed_rad_s = [0.0; AXES]
        }),
        ("motion.joint_acceleration_rad_s2", |settings| {
            settings.motion.joint_acceleration_rad_s2 = [0.0; AXES]
        }),
        ("motion.tolerance_mm", |settings| settings.motion.tolerance_mm = 0.0),
    ];
    let path = [down(0.0, 0.0), down(20.0, 0.0), down(20.0, 20.0), down(0.0, 20.0)];
    for (name, change) in zeros {
        for orientation in [Orientation::Constant, Orientation::Path] {
            let mut settings = Settings::default();
            settings.motion.orientation = orientation;
            change(&mut settings);
            assert_eq!(settings.check().unwrap_err().bound.name, name);
            let mut run = Run::new(&settings, &path);
            run.command(MotionCommand::Start);
            for _ in 0..50 {
                run.feed(usize::MAX);
                run.step();
            }
            for setpoint in &run.setpoints {
                for axis in 0..AXES {
                    let speed = setpoint.velocity_rad_s[axis].abs();
                    assert!(
                        speed <= settings.motion.joint_speed_rad_s[axis],
                        "{name}: {speed} rad/s"
                    );
                    let still = settings.motion.joint_acceleration_rad_s2[axis] == 0.0;
                    assert!(!still || speed == 0.0, "{name}: {speed} rad/s");
                }
            }
        }
    }
}

#[test]
fn contradictory_limits_are_refused_by_name() {
    type Change = fn(&mut Settings);
    let contradictions: [(&str, Change); 7] = [
        ("work_area.z_low_mm", |settings| settings.work_area.z_low_mm = -600.0),
        ("motion.travel_tolerance_mm", |settings| {
            settings.motion.travel_tolerance_mm = 0.01
        }),
        ("paper.pen_down_z_mm", |settings| {
            settings.paper.pen_down_z_mm = -1_000.0
        }),
        ("paper.pen_lift_mm", |settings| settings.paper.pen_lift_mm = 200.0),
        ("paper.pressing_depth_mm", |settings| {
            settings.paper.pressing_depth_mm = 200.0
        }),
        ("paper.slope[1]", |settings| settings.paper.slope = [0.05, -0.11]),
        ("geometry.forearm_mm", |settings| {
            settings.geometry = Geometry::Delta(DeltaGeometry {
                forearm_mm: 300.0,
                ..DeltaGeometry::default()
            });
        }),
    ];
    for (name, change) in contradictions {
        let mut settings = Settings::default();
        change(&mut settings);
        assert_eq!(settings.check().unwrap_err().bound.name, name);
    }
    let settings = Settings {
        geometry: Geometry::Delta(DeltaGeometry {
            arm_range_rad: [0.0, 0.1],
            arm_margin_rad: 0.1,
            ..DeltaGeometry::default()
        }),
        ..Settings::default()
    };
    assert!(Trajectory::new(&settings).is_err());
}

#[test]
fn whatever_is_pushed_and_commanded_nothing_panics_and_setpoints_are_numbers() {
    for seed in 1..200 {
        let mut random = Random::new(seed);
        let mut trajectory = placed(&Settings::default(), [0.0, 0.0, -850.0]);
        for _ in 0..60 {
            for _ in 0..random.below(8) {
                let mut value = |scale: f64| match random.below(12) {
                    0 => f64::NAN,
                    1 => f64::INFINITY,
                    2 => 1.0e300,
                    3 => 1.0e-300,
                    _ => random.between(-scale, scale),
                };
                let point = [value(100.0), value(100.0), -848.0 + value(3.0)];
                let pen = if random.below(2) == 0 { Pen::Up } else { Pen::Down };
                let _ = trajectory.push(vertex(point, pen, 0));
            }
            let _ = trajectory.command(match random.below(9) {
                0 => MotionCommand::Start,
                1 => MotionCommand::Hold,
                2 => MotionCommand::Resume,
                3 => MotionCommand::Cancel,
                4 => MotionCommand::Override(random.below(256) as u8),
                5 => MotionCommand::Jog([random.between(-1.0e3, 1.0e3), f64::NAN, 0.0]),
                6 => MotionCommand::MoveTo([random.between(-600.0, 600.0), 0.0, -800.0].into()),
                7 => MotionCommand::Pen(Pen::Up),
                _ => MotionCommand::JogStop,
            });
            for setpoint in trajectory.step() {
                assert!(setpoint.position_rad.iter().all(|angle| angle.is_finite()));
                assert!(setpoint.velocity_rad_s.iter().all(|speed| speed.abs() <= 25.0));
            }
        }
    }
}
