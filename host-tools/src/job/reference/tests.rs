//! References of the virtual robot in virtual time, and of a rig that refuses.

use super::*;
use crate::cell::{Cell, CellOptions};
use crate::link::rig::Rig;
use crate::simulation;
use etherpen::application::{Fault, StopSource};
use etherpen::robots::Kinematics;
use std::f64::consts::TAU;

const LIMIT_MS: u32 = 120_000;
/// Largest accepted difference between two angles, rad: two of the resolver's increments.
const SAME_RAD: f64 = 1.2e-6;

const MARKS: Wanted = Wanted {
    pose: Pose::Marks,
    position: None,
    calibrate: false,
};

fn at(pose: JointAngles, position: Option<Position>) -> Wanted {
    Wanted {
        pose: Pose::Joints(pose),
        position,
        calibrate: false,
    }
}

/// A configuration with a non-zero resolver position at every mark, and a cell with it.
fn robot() -> (Config, Cell) {
    let mut config = Config::default();
    for (axis, increments) in config.axes.iter_mut().zip([123_456, 700_000, 5, 1_040_000]) {
        axis.sync_increments = increments;
    }
    let cell = Cell::new(&config, CellOptions::default());
    (config, cell)
}

fn take(cell: &mut Cell, config: &Config, wanted: Wanted) -> Result<Referenced, Box<JobError>> {
    let mut job = ReferenceJob::new(config.clone(), wanted, 1);
    simulation::run(cell, &mut job, LIMIT_MS);
    job.outcome().cloned().expect("the job ends").map_err(Box::new)
}

fn assert_same(found: &JointAngles, truth: &JointAngles) {
    for (found, truth) in found.0.iter().zip(truth.0) {
        assert!((found - truth).abs() < SAME_RAD, "{found} rad for {truth} rad");
    }
}

#[test]
fn marks_pose_and_position_give_the_same_true_angles() {
    let (config, cell) = robot();
    let truth = cell.state();
    let [first, second, third, _] = truth.joints.0;
    let main = Wanted {
        pose: Pose::MainAxes([first, second, third]),
        position: truth.platform,
        calibrate: false,
    };
    let mut beside = truth.joints;
    beside.0.iter_mut().for_each(|angle| *angle += 0.03);
    for wanted in [MARKS, at(beside, None), at(truth.joints, truth.platform), main] {
        let (_, mut cell) = robot();
        let found = take(&mut cell, &config, wanted).unwrap();
        assert_same(&found.pose, &truth.joints);
    }
}

#[test]
fn a_pose_wrong_by_30_degrees_is_refused_with_its_axis() {
    let (config, cell) = robot();
    let truth = cell.state();
    for axis in 0..MAIN_AXES {
        let (_, mut cell) = robot();
        let mut wrong = truth.joints;
        wrong.0[axis] += TAU / config.axes[axis].gear;
        let refused = take(&mut cell, &config, at(wrong, truth.platform)).unwrap_err();
        assert!(
            matches!(*refused, JobError::Refused(_, Refusal::PosePosition { axis: named, .. }) if usize::from(named) == axis),
            "{refused}"
        );
        assert!(refused.to_string().contains(&format!("axis {}", axis + 1)), "{refused}");
    }
    let (_, mut cell) = robot();
    let mut beside = truth.joints;
    beside.0[3] += 0.1;
    let refused = take(&mut cell, &config, at(beside, None)).unwrap_err();
    assert!(
        matches!(*refused, JobError::Refused(_, Refusal::PoseResolver { axis: 3, .. })),
        "{refused}"
    );
}

#[test]
fn unknown_offsets_are_set_from_a_pose_and_marks_stored_there_give_the_same_angles() {
    let (_, mut cell) = robot();
    let truth = cell.state();
    // This configuration does not know what the resolvers show at the marks.
    let unknown = Config::default();
    let refused = take(&mut cell, &unknown, at(truth.joints, None)).unwrap_err();
    assert!(matches!(*refused, JobError::Refused(_, Refusal::PoseResolver { .. })));
    let (_, mut cell) = robot();
    let calibrate = Wanted {
        calibrate: true,
        ..at(truth.joints, truth.platform)
    };
    let found = take(&mut cell, &unknown, calibrate).unwrap();
    assert_same(&found.pose, &truth.joints);
    let (_, mut cell) = robot();
    let again = take(&mut cell, &found.marked(), MARKS).unwrap();
    assert_same(&again.pose, &truth.joints);
    let (_, mut cell) = robot();
    let mut wrong = calibrate;
    let mut pose = truth.joints;
    pose.0[0] += TAU / 12.0;
    wrong.pose = Pose::Joints(pose);
    let refused = take(&mut cell, &unknown, wrong).unwrap_err();
    let checked = matches!(*refused, JobError::Refused(_, Refusal::PosePosition { axis: 0, .. }));
    assert!(checked, "{refused}");
    assert!(Kinematics::new(&unknown.geometry).unwrap().forward(&found.pose).is_ok());
}

fn on_bench(rig: &mut Rig, acknowledge: bool) -> JobError {
    let mut job = ReferenceJob::new(Config::default(), MARKS, 1).acknowledging(acknowledge);
    for now_ms in 0..u64::from(LIMIT_MS) {
        rig.step(now_ms, |arrived, room| {
            let mut out = Vec::new();
            job.step(now_ms, arrived, &mut out, room);
            out
        });
        if let Some(outcome) = job.outcome() {
            return *outcome.as_ref().unwrap_err();
        }
    }
    panic!("the job ends")
}

#[test]
fn a_robot_that_moves_has_no_position_or_has_a_fault_is_not_referenced() {
    let mut rig = Rig::new(1, 0);
    rig.mode = Mode::Drawing;
    assert_eq!(on_bench(&mut rig, false), JobError::Busy(Mode::Drawing));

    let mut rig = Rig::new(1, 0);
    rig.refuse_reference = Some(Refusal::Moving);
    assert_eq!(
        on_bench(&mut rig, false),
        JobError::Refused(Command::Home, Refusal::Moving)
    );

    let mut rig = Rig::new(1, 0);
    rig.increments[2] = None;
    let error = on_bench(&mut rig, false);
    assert_eq!(error, JobError::Refused(Command::Home, Refusal::NoPosition { axis: 2 }));
    assert!(error.to_string().contains("no position arrives from axis 3"), "{error}");

    let mut rig = Rig::new(1, 0);
    let fault = Fault::EmergencyStop(StopSource::Link);
    (rig.mode, rig.fault) = (Mode::Fault, Some(fault));
    assert_eq!(on_bench(&mut rig, false), JobError::Fault { fault, before: true });
    assert!(rig.commands.is_empty());
}

#[test]
fn a_fault_from_before_is_acknowledged_where_that_is_asked_for() {
    let mut rig = Rig::new(1, 0);
    (rig.mode, rig.fault) = (Mode::Fault, Some(Fault::EmergencyStop(StopSource::Link)));
    // The rig does not count cycles, so nothing can be read back.
    let error = on_bench(&mut rig, true);
    assert!(
        matches!(
            error,
            JobError::Timeout {
                phase: Phase::Referencing,
                ..
            }
        ),
        "{error}"
    );
    assert_eq!(rig.commands, [Command::Acknowledge, Command::Home]);
}

#[test]
fn a_fault_of_another_configuration_ends_with_the_one_that_fits() {
    for acknowledge in [false, true] {
        let mut rig = Rig::new(1, 0);
        let fault = Fault::UnexpectedBus { expected: 4, found: 3 };
        (rig.mode, rig.fault, rig.config) = (Mode::Fault, Some(fault), Some(1));
        // The rig does not count cycles, so nothing can be read back.
        let error = on_bench(&mut rig, acknowledge);
        let is_taken = matches!(
            error,
            JobError::Timeout {
                phase: Phase::Referencing,
                ..
            }
        );
        assert!(is_taken, "{error}");
        assert_eq!(rig.commands, [Command::Home]);
    }
}
