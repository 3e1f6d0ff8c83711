//! Requirements on the robot on the bus: scaling, turns, sharing of slaves, and the effect of a lost drive.

use super::*;
use crate::drives::cia402::ControlWord;
use crate::drives::io::IoTrigger;
use crate::drives::{DriveKind, MemoryGroup, PositionRange, akd, ax2000, generic};

const TURN: i32 = 1 << 20;

fn axis() -> AxisState {
    let axis = Axis {
        sync_angle_rad: -0.5,
        sync_increments: 1000,
        ..Axis::default()
    };
    AxisState::new(&axis)
}

fn at(position: i32) -> Option<DriveInput> {
    Some(DriveInput {
        position,
        status: StatusWord(0x0637),
        mode_in_effect: true,
    })
}

/// A drive in OP.
fn drive(kind: DriveKind, mode: AxisMode) -> GroupDrive {
    GroupDrive {
        kind,
        mode,
        range: PositionRange::WHOLE,
        operational: true,
        generation: 0,
    }
}

fn enabled(demand: Demand) -> AxisCommand {
    AxisCommand {
        target: DriveTarget::Enabled,
        demand,
    }
}

fn robot(positions: [i32; AXES]) -> RobotAxes {
    let mut robot = RobotAxes::new(
        &[Axis {
            sync_increments: 1000,
            ..Axis::default()
        }; AXES],
        AXES,
    );
    for (axis, position) in robot.axes.iter_mut().zip(positions) {
        axis.step(at(position), 0);
    }
    robot
}

#[test]
fn turns_are_counted_both_ways_for_single_turn_and_for_counting_encoders() {
    let (mut wrapping, mut counting) = (axis(), axis());
    let mut truth = 5_i64;
    for cycle in 0..400_i64 {
        truth += if cycle < 150 { 90_000 } else { -110_000 };
        wrapping.step(at(truth.rem_euclid(i64::from(TURN)) as i32), 0);
        counting.step(at((truth + i64::from(i32::MAX)) as i32), 0);
        if cycle == 0 {
            assert_eq!(wrapping.position, truth);
        }
    }
    assert_eq!(wrapping.position, truth);
    assert_eq!(counting.position, truth + i64::from(i32::MAX) - (1 << 32));
}

#[test]
fn a_multi_turn_encoder_counts_turns_that_nobody_has_seen_and_the_pose_is_lost() {
    let settings = Axis {
        encoder: Encoder::MultiTurn,
        sync_increments: i32::MAX - 1000,
        ..Axis::default()
    };
    for turns in [0.7, -0.7, 1.3, 900.0] {
        let mut robot = RobotAxes::new(&[settings; AXES], AXES);
        for axis in &mut robot.axes {
            axis.step(at(i32::MAX - 1000), 0);
        }
        robot.home(None).unwrap();
        let moved = (turns * f64::from(TURN)) as i32;
        for axis in &mut robot.axes {
            (0..300).for_each(|_| axis.step(None, 0));
            axis.step(at((i32::MAX - 1000).wrapping_add(moved)), 0);
            axis.step(at((i32::MAX - 1000).wrapping_add(moved)), 0);
        }
        assert!(!robot.is_homed(), "{turns}");
        let axis = robot.axes[0];
        assert_eq!(axis.position as i32, axis.raw, "{turns}");
        robot.home(None).unwrap();
        let angle_rad = robot.axes[0].axis_input().unwrap().angle_rad.unwrap();
        let expected_rad = settings.sync_angle_rad + TAU / settings.gear * turns;
        assert!((angle_rad - expected_rad).abs() < 1e-4, "{turns}: {angle_rad}");
    }
}

#[test]
fn the_resolver_gives_the_angle_nearest_to_the_mark() {
    // A quarter turn of the motor beyond the mark, seen across the end of the turn and four turns up.
    for position in [1000 + TURN / 4, 1000 + TURN / 4 + 4 * TURN, 1000 + TURN / 4 - TURN] {
        let mut robot = robot([position; AXES]);
        assert!(!robot.is_homed());
        assert_eq!(robot.home(None), Ok(()));
        let angle_rad = robot.axes[0].axis_input().unwrap().angle_rad.unwrap();
        let expected_rad = Axis::default().sync_angle_rad + TAU / 4.0 / 12.0;
        assert!((angle_rad - expected_rad).abs() < 1e-9, "{angle_rad}");
    }
    let mut robot = robot([1000 - TURN / 4; AXES]);
    assert_eq!(robot.home(None), Ok(()));
    assert!(robot.axes[3].axis_input().unwrap().angle_rad.unwrap() < Axis::default().sync_angle_rad);
}

#[test]
fn a_moving_or_silent_axis_is_not_homed() {
    let mut moving = robot([0; AXES]);
    moving.axes[2].step(at(5_000), 0);
    assert_eq!(moving.home(None), Err(HomingError::Moving { axis: 2 }));
    let mut silent = robot([0; AXES]);
    silent.axes[1].step(None, 0);
    assert_eq!(silent.home(None), Err(HomingError::NoPosition { axis: 1 }));
    assert!(!silent.is_homed());
}

#[test]
fn a_pose_that_cannot_be_corrected_is_lost() {
    let mut robot = robot([0; AXES]);
    robot.home(None).unwrap();
    robot.axes[1].step(None, 0);
    let elsewhere = JointAngles([TAU / 12.0; AXES]);
    assert_eq!(robot.home(Some(&elsewhere)), Err(HomingError::NoPosition { axis: 1 }));
    assert!(!robot.is_homed(), "the wrong pose still counts");
    assert_eq!(robot.homes_lost(), [true; AXES]);
}

#[test]
fn a_gap_loses_the_pose_after_8_ms_in_motion_and_after_half_a_second_at_rest() {
    for (speed, survived_ms) in [(50_000, GAP_IN_MOTION_MAX_MS), (0, GAP_AT_REST_MAX_MS)] {
        for (gap_ms, kept) in [(survived_ms, true), (survived_ms + 1, false)] {
            let mut robot = robot([0; AXES]);
            robot.home(None).unwrap();
            let mut position = 0;
            for step in (0..=speed).step_by(2_000) {
                position += step;
                robot.axes[1].step(at(position), 0);
            }
            (0..gap_ms).for_each(|_| robot.axes[1].step(None, 0));
            assert_eq!(robot.axes[1].axis_input(), None);
            robot.axes[1].step(at(position), 0);
            assert_eq!(robot.is_homed(), kept, "{speed} increments/ms, {gap_ms} ms");
            assert_eq!(robot.homes_lost(), [false, !kept, false, false]);
        }
    }
}

#[test]
fn a_jump_of_the_feedback_loses_the_pose_also_after_a_gap_and_a_hand_does_not() {
    // A third of a turn is within the motor's speed over a gap of 39 ms, but far beyond its acceleration over 5.
    for gap_ms in [0, 5, 10] {
        let mut robot = robot([0; AXES]);
        robot.home(None).unwrap();
        (0..gap_ms).for_each(|_| robot.axes[1].step(None, 0));
        robot.axes[1].step(at(TURN / 3), 0);
        assert!(!robot.is_homed(), "after {gap_ms} ms");
    }
    // A joint without power that is pushed to 2 rad/s within 50 ms, with every fourth position missing.
    let mut robot = robot([0; AXES]);
    robot.home(None).unwrap();
    let increments_per_rad = 12.0 * f64::from(TURN) / TAU;
    for ms in 0..400 {
        let seconds = f64::from(ms) / 1e3;
        let angle_rad = if ms < 50 {
            20.0 * seconds * seconds
        } else {
            0.05 + 2.0 * (seconds - 0.05)
        };
        let input = at((angle_rad * increments_per_rad) as i32).filter(|_| ms % 4 > 0);
        robot.axes[1].step(input, 0);
        assert!(robot.is_homed(), "{ms} ms");
    }
    // A drive that reports every third position twice.
    let mut last = 0;
    for ms in 401..800 {
        let position = ((0.05 + 2.0 * (f64::from(ms) / 1e3 - 0.05)) * increments_per_rad) as i32;
        last = if ms % 3 == 0 && ms > 401 { last } else { position };
        robot.axes[1].step(at(last), 0);
        assert!(robot.is_homed(), "{ms} ms");
    }
}

#[test]
fn a_drive_that_was_configured_again_is_not_homed() {
    let mut robot = robot([0; AXES]);
    robot.home(None).unwrap();
    robot.axes[0].step(at(0), 1);
    assert_eq!(robot.homes_lost(), [true, false, false, false]);
    assert!(robot.axes[0].axis_input().unwrap().angle_rad.is_none());
}

#[test]
fn velocities_are_scaled_clamped_and_zero_unless_in_operation() {
    let mut axis = axis();
    let velocity = |rad_s| enabled(Demand::Velocity(rad_s));
    axis.adopt(Some(&drive(&ax2000::AX2000, AxisMode::Velocity)));
    assert_eq!(axis.output(&velocity(1.0)).demand_digits, 0);
    axis.step(at(0), 0);
    // 1 rad/s at the joint is 12 rad/s, 114.59 rpm, at the motor.
    assert_eq!(axis.output(&velocity(1.0)).demand_digits, 16_021);
    assert_eq!(axis.output(&velocity(-1.0)).demand_digits, -16_021);
    let clamped = axis.output(&velocity(1.0e9)).demand_digits;
    let limit = velocity(Axis::default().output_max_rad_s);
    assert_eq!(clamped, axis.output(&limit).demand_digits);
    assert_eq!(axis.output(&velocity(f64::NAN)).demand_digits, 0);
    assert_eq!(axis.output(&enabled(Demand::Torque(1.0))).demand_digits, 0);
    let stop = AxisCommand {
        target: DriveTarget::QuickStop,
        ..velocity(1.0)
    };
    let output = axis.output(&stop);
    assert_eq!((output.demand_digits, output.control), (0, ControlWord::QUICK_STOP));
}

#[test]
fn torques_are_scaled_by_current_or_rated_torque_and_clamped() {
    let torque = |nm| enabled(Demand::Torque(nm));
    for (kind, digits, limit_digits) in [
        // 12 N m at the joint are 1 N m at the motor: 1 / 8.4 of 3280 digits, or 1000 / 2.8 digits.
        (&ax2000::AX2000, 390, 3_254),
        (&generic::GENERIC, 357, 2_976),
    ] {
        let mut axis = axis();
        axis.adopt(Some(&drive(kind, AxisMode::Torque)));
        axis.step(at(0), 0);
        assert_eq!(axis.output(&torque(12.0)).demand_digits, digits);
        assert_eq!(axis.output(&torque(-12.0)).demand_digits, -digits);
        assert_eq!(axis.output(&torque(1.0e9)).demand_digits, limit_digits);
        assert_eq!(axis.output(&torque(f64::INFINITY)).demand_digits, 0);
        assert_eq!(axis.output(&enabled(Demand::Velocity(1.0))).demand_digits, 0);
    }
}

#[test]
fn a_drive_that_is_not_in_op_or_in_another_mode_is_not_enabled() {
    let mut axis = axis();
    let akd = drive(&akd::AKD, AxisMode::Velocity);
    let quick_stop = DriveOutput {
        control: ControlWord::QUICK_STOP,
        ..DriveOutput::default()
    };
    axis.step(at(0), 0);
    let left = GroupDrive {
        operational: false,
        ..akd
    };
    for drive in [None, Some(&left)] {
        axis.adopt(drive);
        assert_eq!(axis.output(&enabled(Demand::Velocity(1.0))), quick_stop);
    }
    axis.adopt(Some(&akd));
    assert_ne!(axis.output(&enabled(Demand::Velocity(1.0))).demand_digits, 0);
    let mut other_mode = at(0).unwrap();
    other_mode.mode_in_effect = false;
    // Some drives show the mode a moment after they have got power.
    let waiting = DriveOutput {
        control: ControlWord::ENABLE_OPERATION,
        ..DriveOutput::default()
    };
    for cycle in 0..12 {
        axis.step(Some(other_mode), 0);
        let expected = if cycle < 10 { waiting } else { quick_stop };
        assert_eq!(axis.output(&enabled(Demand::Velocity(1.0))), expected, "cycle {cycle}");
    }
    axis.output(&AxisCommand {
        target: DriveTarget::Off,
        demand: Demand::Velocity(0.0),
    });
    axis.step(Some(other_mode), 0);
    assert_eq!(axis.output(&enabled(Demand::Velocity(1.0))), waiting, "asked anew");
    axis.step(at(0), 0);
    assert_ne!(axis.output(&enabled(Demand::Velocity(1.0))).demand_digits, 0);
    other_mode.status = StatusWord(0x0250);
    axis.step(Some(other_mode), 0);
    let output = axis.output(&enabled(Demand::Velocity(1.0)));
    assert_eq!(output.control, ControlWord::SHUTDOWN, "on the way to power");
    // Cycles count in a row: a drive that was in its mode meanwhile is waited for again.
    other_mode.status = at(0).unwrap().status;
    for _ in 0..3 {
        for cycle in 0..10 {
            axis.step(Some(other_mode), 0);
            assert_eq!(axis.output(&enabled(Demand::Velocity(1.0))), waiting, "cycle {cycle}");
        }
        axis.step(at(0), 0);
        assert_ne!(axis.output(&enabled(Demand::Velocity(1.0))).demand_digits, 0);
    }
}

#[test]
fn while_a_drive_is_not_in_operation_its_set_points_are_where_it_is() {
    let mut axis = axis();
    axis.adopt(Some(&drive(&generic::GENERIC, AxisMode::Velocity)));
    for status in [0x0250, 0x0231, 0x0233] {
        let input = DriveInput {
            status: StatusWord(status),
            ..at(1_234).unwrap()
        };
        axis.step(Some(input), 0);
        let output = axis.output(&enabled(Demand::Velocity(1.0)));
        assert_eq!((output.demand_digits, output.position), (0, 1_234));
    }
}

/// An axis in position mode at these increments, homed there at angle 0, in operation.
fn position_axis(gear: f64, increments: i32) -> AxisState {
    let mut axis = AxisState::new(&Axis {
        gear,
        ..Axis::default()
    });
    axis.adopt(Some(&drive(&generic::GENERIC, AxisMode::Position)));
    axis.step(at(increments), 0);
    axis.zero = Some(f64::from(increments));
    axis
}

/// A demand for an angle, rad.
fn to_angle(angle_rad: f64) -> PositionDemand {
    PositionDemand {
        angle_rad,
        ..PositionDemand::default()
    }
}

#[test]
fn a_target_position_begins_where_the_drive_is_and_moves_no_faster_than_the_axis_may() {
    // Within two revolutions of both ends of the drive's range.
    for start in [0, 1_234_567, i32::MAX - 5, i32::MIN + 5] {
        for gear in [12.0, -12.0] {
            let mut axis = position_axis(gear, start);
            let held = axis.output_position(DriveTarget::Enabled, None);
            assert_eq!((held.position, held.demand_digits), (start, 0), "the first target");
            // What the drive shows in the meantime does not move the target.
            axis.step(at(start.wrapping_add(40)), 0);
            assert_eq!(axis.output_position(DriveTarget::Enabled, None).position, start);
            // 1 mrad at the joint is 12 mrad at the motor: 2003 increments.
            let near = axis.output_position(DriveTarget::Enabled, Some(&to_angle(0.001)));
            assert_eq!(
                near.position.wrapping_sub(start),
                (2_002.6 * gear.signum()).round() as i32
            );
            // 27 rad/s are 54,071 increments in a millisecond.
            let far = axis.output_position(DriveTarget::Enabled, Some(&to_angle(1.0)));
            let step = far.position.wrapping_sub(near.position);
            assert_eq!(step, (54_071.0 * gear.signum()) as i32);
            let nowhere = axis.output_position(DriveTarget::Enabled, Some(&to_angle(f64::NAN)));
            assert_eq!(nowhere.position, far.position, "holds");
        }
    }
}

#[test]
fn a_drive_that_does_not_follow_has_its_position_as_target_and_begins_anew_there() {
    let mut axis = position_axis(12.0, 5_000);
    axis.output_position(DriveTarget::Enabled, Some(&to_angle(0.001)));
    let stop = axis.output_position(DriveTarget::QuickStop, Some(&to_angle(0.001)));
    assert_eq!((stop.position, stop.control), (5_000, ControlWord::QUICK_STOP));
    for (status, position) in [(0x0217, 5_300), (0x0250, 5_400), (0x0233, 5_500)] {
        let input = DriveInput {
            status: StatusWord(status),
            ..at(position).unwrap()
        };
        axis.step(Some(input), 0);
        let output = axis.output_position(DriveTarget::Enabled, Some(&to_angle(0.001)));
        assert_eq!((output.position, output.demand_digits), (position, 0), "{status:#06x}");
    }
    axis.step(at(5_500), 0);
    assert_eq!(axis.output_position(DriveTarget::Enabled, None).position, 5_500);
    // An axis that is not homed has no angles.
    axis.zero = None;
    let output = axis.output_position(DriveTarget::Enabled, Some(&to_angle(0.3)));
    assert_eq!(output.position, 5_500);
}

#[test]
fn in_position_mode_the_velocity_of_the_drives_own_loop_is_compared_and_the_offset_is_sent() {
    let mut axis = position_axis(12.0, 0);
    let demand = PositionDemand {
        angle_rad: 0.001,
        velocity_rad_s: 2.0,
        forward_rad_s: 1.0,
        correction_rad_s: 1.0,
    };
    let output = axis.output_position(DriveTarget::Enabled, Some(&demand));
    assert_eq!((output.demand_digits, axis.sent), (16_021, 48_063));
    assert!(axis.commanded);
    // A hold expects what the drive's loop makes of an error beyond the one it may leave.
    axis.step(at(2_003 - 201), 0);
    axis.output_position(DriveTarget::Enabled, None);
    let expected_rad_s = 80.0 * (0.0001 - 0.00002);
    assert!(
        (f64::from(axis.sent) - expected_rad_s * 16_021.4).abs() < 10.0,
        "{}",
        axis.sent
    );
    axis.step(at(2_003 - 20), 0);
    axis.output_position(DriveTarget::Enabled, None);
    assert_eq!(axis.sent, 0);
    // Velocity and torque demands do not move such a drive.
    for demand in [Demand::Velocity(1.0), Demand::Torque(1.0)] {
        assert_eq!(axis.output(&enabled(demand)).demand_digits, 0);
    }
}

#[test]
fn a_motor_that_turns_the_other_way_is_turned_back() {
    let mut axis = AxisState::new(&Axis {
        gear: -12.0,
        ..Axis::default()
    });
    axis.step(at(0), 0);
    axis.zero = Some(0.0);
    for (mode, demand) in [
        (AxisMode::Velocity, Demand::Velocity(1.0)),
        (AxisMode::Torque, Demand::Torque(10.0)),
    ] {
        axis.adopt(Some(&drive(&ax2000::AX2000, mode)));
        assert!(axis.output(&enabled(demand)).demand_digits < 0);
    }
    axis.step(at(-1000), 0);
    assert!(axis.axis_input().unwrap().angle_rad.unwrap() > 0.0);
}

#[test]
fn the_axes_of_a_group_in_memory_are_read_and_commanded_as_on_a_bus() {
    let mut robot = RobotAxes::new(&[Axis::default(); AXES], AXES);
    let velocity = drive(&ax2000::AX2000, AxisMode::Velocity);
    let mut group = MemoryGroup::new([Some(velocity); AXES]);
    group.inputs = [at(7); AXES];
    robot.read(&mut group);
    assert_eq!(robot.inputs(), [None; AXES], "no trigger has fetched anything");
    group.trigger_input();
    group.arrived(&MemoryGroup::<AXES>::ARRIVED);
    robot.read(&mut group);
    assert!(robot.inputs().iter().all(|input| input.unwrap().position == 7));
    robot.write(&mut group, &[enabled(Demand::Velocity(0.5)); AXES]);
    assert!(group.outputs.iter().all(|output| output.demand_digits == 8_011));
    // A member that loses its drive keeps its last output and takes no other.
    group.drives[1] = None;
    robot.read(&mut group);
    robot.write(&mut group, &[enabled(Demand::Velocity(-0.5)); AXES]);
    assert_eq!(
        group.outputs.map(|output| output.demand_digits),
        [-8_011, 8_011, -8_011, -8_011]
    );
}

#[test]
fn axes_that_are_configured_again_command_the_drives_that_the_group_already_has() {
    let mut robot = RobotAxes::new(&[Axis::default(); AXES], AXES);
    let velocity = drive(&ax2000::AX2000, AxisMode::Velocity);
    let mut group = MemoryGroup::new([Some(velocity); AXES]);
    group.inputs = [at(7); AXES];
    for demand_rad_s in [0.5, -0.5] {
        robot.configure(&[Axis::default(); AXES], AXES);
        group.trigger_input();
        group.arrived(&MemoryGroup::<AXES>::ARRIVED);
        robot.read(&mut group);
        robot.write(&mut group, &[enabled(Demand::Velocity(demand_rad_s)); AXES]);
        let digits = group.outputs.map(|output| output.demand_digits);
        assert_eq!(digits, [(demand_rad_s * 16_022.0) as i32; AXES], "{demand_rad_s} rad/s");
    }
}

#[test]
fn an_axis_without_a_resolution_has_angles_that_are_numbers() {
    for increments_per_revolution in [0, u32::MAX] {
        let axis = Axis {
            increments_per_revolution,
            ..Axis::default()
        };
        let mut axis = AxisState::new(&axis);
        axis.step(at(12_345), 0);
        axis.zero = Some(0.0);
        let angle_rad = axis.axis_input().and_then(|input| input.angle_rad);
        assert!(
            angle_rad.is_some_and(|angle| angle.is_finite() && angle >= 0.0),
            "{angle_rad:?}"
        );
    }
}
