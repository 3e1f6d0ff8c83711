//! Runs a path through the firmware's planner, millisecond by millisecond, without a robot.
//!
//! The trajectory stage is the firmware's own, and gets its input as in the firmware: vertices while there is room,
//! then twelve references. Nothing is stored, so a path may be as long as its file.
//!
//! Invariant: every run ends: at rest at the path's end, with a refusal, without progress, or after a day.

mod analysis;
mod certificate;
mod dimensions;
mod table;
mod track;

pub use analysis::{Analysis, Findings, Limits, Peaks, Violation};
pub use certificate::{CertificateReport, EXCESS, Refused, UsedPart};
pub use table::Table;

use certificate::Witness;
use etherpen::config::{Config, Orientation};
use etherpen::motion::{MotionCommand, MotionRefusal, MotionState, Observer, Setpoint, Trajectory, Vertex};
use etherpen::robots::vector::{Vector, length, subtract};
use etherpen::robots::{GeometryError, JointAngles, Kinematics, KinematicsError, MAIN_AXES};

/// Longest motion, ms: a day.
const DURATION_MAX_MS: u64 = 86_400_000;
/// Least horizontal part of a unit tangent for a leg to have a direction.
const HORIZONTAL_MIN: f64 = 0.1;

/// One millisecond of a planned path.
#[derive(Clone, Copy, Debug)]
pub struct PlannedSample {
    /// Time since the path began, ms.
    pub t_ms: u64,
    /// The setpoint, as the position controllers get it.
    pub setpoint: Setpoint,
    /// Position of the platform, mm.
    pub point: Vector,
}

/// Summary of a run.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    /// Time from rest at the first vertex to rest at the last, ms.
    pub duration_ms: u64,
    /// Times that path data did not arrive in time.
    pub underruns: u32,
    /// Most points of the planner's grid computed in one period.
    pub work_max: u32,
    /// Length of the planner's moving average, ms; 0 without an average.
    pub jerk_window_ms: u16,
}

/// Why a path was not planned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlanningError {
    /// The configured dimensions do not form a valid robot.
    Geometry(GeometryError),
    /// The path has fewer than two vertices.
    TooShort {
        /// Number of vertices.
        vertices: usize,
    },
    /// The robot cannot reach the first vertex.
    Start(KinematicsError),
    /// The planner refused a vertex.
    Vertex {
        /// Its index in the path.
        index: usize,
        /// The refusal.
        refusal: MotionRefusal,
    },
    /// The planner refused a command.
    Command(MotionRefusal),
    /// The motion would take longer than a day.
    Endless,
    /// The planner makes no progress.
    Stalled {
        /// Vertices executed.
        vertex: u32,
    },
    /// A reference is not a possible pose of the robot.
    Reference {
        /// Time of the reference, ms.
        t_ms: u64,
        /// The reason.
        cause: KinematicsError,
    },
}

impl std::fmt::Display for PlanningError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Geometry(cause) => write!(f, "the configured dimensions do not form a valid robot ({cause})"),
            Self::TooShort { vertices } => write!(f, "a path needs two different vertices, here is {vertices}"),
            Self::Start(cause) => write!(f, "the robot cannot stand at the first vertex ({cause:?})"),
            Self::Vertex { index, refusal } => write!(f, "vertex {index}: the planner refuses it ({refusal:?})"),
            Self::Command(refusal) => write!(f, "the planner does not start ({refusal:?})"),
            Self::Endless => f.write_str("the motion would take longer than a day; the limits are too small for it"),
            Self::Stalled { vertex } => write!(
                f,
                "the planner makes no progress after vertex {vertex}; this is an error of the program, please report it with \
                 the path"
            ),
            Self::Reference { t_ms, cause } => {
                write!(f, "the reference at {t_ms} ms is no pose of the robot ({cause:?})")
            }
        }
    }
}

impl std::error::Error for PlanningError {}

/// Plans a path and compares the references with the limits and with the path; `observe` gets every millisecond.
///
/// # Errors
/// Why the path was not planned.
pub fn analyse(
    config: &Config,
    path: &[Vertex],
    observe: impl FnMut(&PlannedSample),
) -> Result<Findings, PlanningError> {
    analyse_observed(config, path, &mut (), observe)
}

/// Plans a path, compares the references with the limits, and proves the limits of the motion between them with the
/// given excess (see [`EXCESS`]); `observe` gets every millisecond.
///
/// # Errors
/// Why the path was not planned.
pub fn certify(
    config: &Config,
    path: &[Vertex],
    excess: f64,
    observe: impl FnMut(&PlannedSample),
) -> Result<(Findings, CertificateReport), PlanningError> {
    let mut witness = Witness::new(config, path, excess)?;
    let findings = analyse_observed(config, path, &mut witness, observe)?;
    Ok((findings, witness.finish()))
}

fn analyse_observed(
    config: &Config,
    path: &[Vertex],
    observer: &mut impl Observer,
    mut observe: impl FnMut(&PlannedSample),
) -> Result<Findings, PlanningError> {
    let mut analysis = None;
    let run = plan_observed(config, path, observer, |sample, run| {
        analysis
            .get_or_insert_with(|| Analysis::new(config, path, run.jerk_window_ms))
            .observe(sample);
        observe(sample);
    })?;
    let analysis = analysis.unwrap_or_else(|| Analysis::new(config, path, run.jerk_window_ms));
    Ok(analysis.finish(&run))
}

/// Plans a path from rest at its first vertex to rest at its last; `observe` gets every millisecond with the run so
/// far: the first at rest at 0 ms, and a few at rest at the end.
///
/// # Errors
/// Why the path was not planned.
pub fn plan(config: &Config, path: &[Vertex], observe: impl FnMut(&PlannedSample, &Run)) -> Result<Run, PlanningError> {
    plan_observed(config, path, &mut (), observe)
}

fn plan_observed(
    config: &Config,
    path: &[Vertex],
    observer: &mut impl Observer,
    mut observe: impl FnMut(&PlannedSample, &Run),
) -> Result<Run, PlanningError> {
    let [first, _, ..] = path else {
        return Err(PlanningError::TooShort { vertices: path.len() });
    };
    let kinematics = Kinematics::new(&config.geometry).map_err(PlanningError::Geometry)?;
    let mut trajectory = Box::new(Trajectory::new(&config.motion_settings()).map_err(PlanningError::Geometry)?);
    let [a, b, c] = kinematics.inverse(&first.position).map_err(PlanningError::Start)?;
    let pose = JointAngles([a, b, c, first_angle(config, path)]);
    trajectory.place(pose);
    let mut sample = PlannedSample {
        t_ms: 0,
        setpoint: Setpoint {
            position_rad: pose.0,
            pen: first.pen,
            stroke: first.stroke,
            ..Setpoint::default()
        },
        point: first.position.into(),
    };
    let mut run = Run {
        duration_ms: 0,
        underruns: 0,
        work_max: 0,
        jerk_window_ms: trajectory.jerk_window_ms(),
    };
    observe(&sample, &run);
    let mut feed = path.iter().enumerate();
    let mut started = false;
    while sample.t_ms < DURATION_MAX_MS {
        fill(&mut trajectory, &mut feed)?;
        if !started {
            trajectory
                .command(MotionCommand::Start)
                .map_err(PlanningError::Command)?;
            started = true;
        }
        for setpoint in trajectory.step_observed(observer) {
            let [a, b, c, _] = setpoint.position_rad;
            let t_ms = sample.t_ms + 1;
            if setpoint.position_rad[..MAIN_AXES] != sample.setpoint.position_rad[..MAIN_AXES] {
                let position = kinematics
                    .forward(&JointAngles([a, b, c, 0.0]))
                    .map_err(|cause| PlanningError::Reference { t_ms, cause })?;
                sample.point = position.into();
            }
            if setpoint.position_rad != sample.setpoint.position_rad {
                run.duration_ms = t_ms;
            }
            (sample.t_ms, sample.setpoint) = (t_ms, setpoint);
            observe(&sample, &run);
        }
        run.work_max = run.work_max.max(trajectory.work());
        if trajectory.stalled_ms() > 0 {
            let vertex = trajectory.executed();
            return Err(PlanningError::Stalled { vertex });
        }
        if trajectory.state() == MotionState::Idle && feed.len() == 0 {
            run.underruns = trajectory.underruns();
            return Ok(run);
        }
    }
    Err(PlanningError::Endless)
}

/// Angle of axis 4 at the beginning, rad: the direction of the path if the axis follows it, so that there is no initial
/// turn.
fn first_angle(config: &Config, path: &[Vertex]) -> f64 {
    if config.motion.orientation == Orientation::Constant {
        return 0.0;
    }
    let angle = path.windows(2).find_map(|ends| match ends {
        [from, to] => {
            let leg = subtract(&to.position.into(), &from.position.into());
            let [x, y, _] = leg;
            (x.hypot(y) >= HORIZONTAL_MIN * length(&leg) && x.hypot(y) > 0.0).then(|| y.atan2(x))
        }
        _ => None,
    });
    angle.unwrap_or(0.0)
}

/// Passes vertices on while there is room.
fn fill<'p>(
    trajectory: &mut Trajectory,
    feed: &mut (impl ExactSizeIterator<Item = (usize, &'p Vertex)> + 'p),
) -> Result<(), PlanningError> {
    while trajectory.free() > 0 {
        let Some((index, vertex)) = feed.next() else {
            trajectory.finish();
            break;
        };
        trajectory
            .push(*vertex)
            .map_err(|refusal| PlanningError::Vertex { index, refusal })?;
    }
    Ok(())
}

/// Duration that the firmware's planner computes for a path, s, from rest at its first vertex to rest at its end; NaN
/// if it cannot be planned.
pub fn planned_s(config: &Config, path: &[Vertex]) -> f64 {
    plan(config, path, |_, _| ()).map_or(f64::NAN, |run| run.duration_ms as f64 / 1_000.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::motion::Pen;
    use etherpen::robots::Position;

    pub(super) fn vertices(points: &[[f64; 3]]) -> Vec<Vertex> {
        let vertex = |point: &[f64; 3]| Vertex {
            position: Position::from(*point),
            pen: Pen::Down,
            stroke: 0,
        };
        points.iter().map(vertex).collect()
    }

    #[test]
    fn a_run_begins_at_rest_at_the_first_vertex_and_ends_at_rest_at_the_last() {
        let path = vertices(&[[0.0, 0.0, -800.0], [50.0, 0.0, -800.0], [50.0, 30.0, -800.0]]);
        let mut samples = Vec::new();
        let run = plan(&Config::default(), &path, |sample, _| samples.push(*sample)).unwrap();
        assert_eq!((samples[0].t_ms, samples[0].point), (0, [0.0, 0.0, -800.0]));
        assert_eq!(samples[0].setpoint.velocity_rad_s, [0.0; 4]);
        let end = samples[run.duration_ms as usize];
        assert_eq!(end.t_ms, run.duration_ms);
        for (value, expected) in end.point.iter().zip([50.0, 30.0, -800.0]) {
            assert!((value - expected).abs() < 1.0e-6);
        }
        assert_ne!(
            samples[run.duration_ms as usize - 1].setpoint.position_rad,
            end.setpoint.position_rad
        );
        assert!(
            samples[run.duration_ms as usize..]
                .iter()
                .skip(1)
                .all(|s| s.setpoint.velocity_rad_s == [0.0; 4])
        );
    }

    #[test]
    fn what_cannot_be_planned_says_why() {
        let config = Config::default();
        let one = vertices(&[[0.0, 0.0, -800.0]]);
        assert_eq!(
            plan(&config, &one, |_, _| ()).unwrap_err(),
            PlanningError::TooShort { vertices: 1 }
        );
        let far = vertices(&[[0.0, 0.0, -800.0], [900.0, 0.0, -800.0]]);
        assert!(matches!(
            plan(&config, &far, |_, _| ()).unwrap_err(),
            PlanningError::Vertex { index: 1, .. }
        ));
    }
}
