//! Plans paths with the firmware's planner and certifies them.

use etherpen_certify::robot::{
    CoreXy, Delta, DeltaDimensions, Gantry, LinearDelta, LinearDeltaDimensions, Scara, ScaraDimensions,
};
use etherpen_certify::{Certificate, Certifier, Limits, Robot, Stretch};
use etherpen_motion::robots::{Geometry, JointAngles, Kinematics};
use etherpen_motion::{MotionCommand, MotionState, Observer, Passage, Pen, Settings, Trajectory, Vertex};

/// Excess over a limit that the planner's own tests allow.
pub(crate) const EXCESS: f64 = 1.0e-3;
/// Periods after which a run counts as stuck.
const PERIODS_MAX: usize = 60_000;

/// Hands the planner's motion to a certifier.
pub(crate) struct Feed {
    certifier: Certifier,
    ticks: u64,
}

impl Observer for Feed {
    fn millisecond(&mut self) {
        self.ticks += 1;
    }

    fn moved(&mut self, passage: &Passage) {
        self.certifier.take(&Stretch {
            coefficients: passage.coefficients,
            parameter: passage.parameter,
            start_mm: passage.start_mm,
            speed_mm_s: passage.speed_mm_s,
            acceleration_mm_s2: passage.acceleration_mm_s2,
            time_s: passage.time_s,
            ends_s: self.ticks as f64 * 1.0e-3 - passage.left_s,
            heading_rad: passage.heading_rad,
            turn_rad_mm: passage.turn_rad_mm,
            turn_change_rad_mm2: passage.turn_change_rad_mm2,
            drawn: passage.drawn,
            lifts: passage.lifts,
            vertex: passage.vertex,
        });
    }
}

/// Travel for a turn of the wheel that stands for a linear axis, mm.
const TURN_MM: f64 = core::f64::consts::TAU * etherpen_motion::robots::LINEAR_MM_PER_RAD;

/// The robot of some settings.
pub(crate) fn robot(settings: &Settings) -> Robot {
    match &settings.geometry {
        Geometry::Delta(geometry) => Robot::Delta(Delta::new(&DeltaDimensions {
            base_radius_mm: geometry.base_radius_mm,
            upper_arm_mm: geometry.upper_arm_mm,
            forearm_mm: geometry.forearm_mm,
            platform_radius_mm: geometry.platform_radius_mm,
            azimuths_deg: geometry.arm_azimuths_deg,
        })),
        Geometry::Gantry(_) => Robot::Gantry(Gantry::new([TURN_MM; 3])),
        Geometry::CoreXy(_) => Robot::CoreXy(CoreXy::new(TURN_MM, TURN_MM)),
        Geometry::Scara(geometry) => {
            let [low_rad, high_rad] = geometry.shoulder_range_rad;
            Robot::Scara(Scara::new(&ScaraDimensions {
                inner_mm: geometry.inner_link_mm,
                outer_mm: geometry.outer_link_mm,
                positive: geometry.elbow > 0,
                shoulder_middle_rad: 0.5 * (low_rad + high_rad),
                z_mm_per_turn: TURN_MM,
            }))
        }
        Geometry::LinearDelta(geometry) => Robot::LinearDelta(LinearDelta::new(&LinearDeltaDimensions {
            radius_mm: geometry.radius_mm,
            rod_mm: geometry.rod_mm,
            azimuths_deg: geometry.tower_azimuths_deg,
            carriage_mm_per_turn: TURN_MM,
        })),
    }
}

/// The limits of some settings, with an average of `window_ms`.
pub(crate) fn limits(settings: &Settings, window_ms: u16, excess: f64) -> Limits {
    let motion = &settings.motion;
    let [a, b, c] = settings.geometry.ranges_rad();
    Limits {
        range_rad: [a, b, c, settings.geometry.turn_range_rad()],
        joint_speed_rad_s: motion.joint_speed_rad_s,
        joint_acceleration_rad_s2: motion.joint_acceleration_rad_s2,
        speed_mm_s: motion.speed_mm_s,
        travel_speed_mm_s: motion.travel_speed_mm_s,
        acceleration_mm_s2: motion.acceleration_mm_s2,
        pen_speed_mm_s: motion.pen_speed_mm_s,
        pen_acceleration_mm_s2: motion.pen_acceleration_mm_s2,
        tolerance_mm: motion.tolerance_mm,
        travel_tolerance_mm: motion.travel_tolerance_mm,
        window_ms,
        excess,
        jump_part: EXCESS,
    }
}

/// Plans a path from rest to rest and certifies it; `change` changes the limits that the certificate has to prove.
pub(crate) fn certify(
    settings: &Settings,
    path: &[Vertex],
    excess: f64,
    change: impl FnOnce(&mut Limits),
) -> Certificate {
    let first = path[0].position;
    let mut trajectory = Box::new(Trajectory::new(settings).unwrap());
    let [a, b, c] = Kinematics::new(&settings.geometry).unwrap().inverse(&first).unwrap();
    assert!(trajectory.place(JointAngles([a, b, c, 0.0])));
    let mut limits = limits(settings, trajectory.jerk_window_ms(), excess);
    change(&mut limits);
    let points = path.iter().map(|vertex| {
        let position = vertex.position;
        [position.x_mm, position.y_mm, position.z_mm]
    });
    let mut feed = Feed {
        certifier: Certifier::new(robot(settings), limits, points.collect()),
        ticks: 0,
    };
    let mut left = path.iter();
    for period in 0..PERIODS_MAX {
        while trajectory.free() > 0 {
            let Some(vertex) = left.next() else {
                trajectory.finish();
                break;
            };
            trajectory.push(*vertex).unwrap();
        }
        if period == 0 {
            trajectory.command(MotionCommand::Start).unwrap();
        }
        trajectory.step_observed(&mut feed);
        if trajectory.state() == MotionState::Idle && left.len() == 0 {
            return feed.certifier.finish();
        }
    }
    panic!("the path does not end");
}

/// A vertex of a path.
pub(crate) fn vertex(point: [f64; 3], pen: Pen) -> Vertex {
    Vertex {
        position: point.into(),
        pen,
        stroke: 0,
    }
}

/// A path file of the samples.
pub(crate) fn sample(text: &str) -> Vec<Vertex> {
    let vertices = text.lines().skip(1).map(|line| {
        let values: Vec<f64> = line.split(',').map(|value| value.trim().parse().unwrap()).collect();
        vertex(
            [values[0], values[1], values[2]],
            if values[3] > 0.5 { Pen::Down } else { Pen::Up },
        )
    });
    vertices.collect()
}
