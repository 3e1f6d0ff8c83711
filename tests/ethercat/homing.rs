//! Homing by the drive and its touch probe over the bus: `drives::homing` and `drives::probe` against a virtual CiA 402
//! drive. The truth is the motor.

use crate::rig::{OUTPUTS_AFTER_NS, Rig, idle_rig_of};
use core::f64::consts::TAU;
use core::task::{Context, Waker};
use etherpen::config::Config;
use etherpen::control::robot_axes::{AxisCommand, Demand};
use etherpen::drives::DriveOutput;
use etherpen::drives::cia402::{ControlWord, DriveState, DriveTarget, StatusWord};
use etherpen::drives::homing::{
    HOMING_MODE, Homing, HomingFailure, HomingMethod, HomingOutput, HomingProgress, HomingSettings,
};
use etherpen::drives::io::{IoGroup, IoTrigger};
use etherpen::drives::probe::{
    PROBE_FUNCTION, PROBE_STATUS, Probe, ProbeEdge, ProbeNumber, ProbeSettings, ProbeSource,
};
use etherpen::ethercat::diagnostics::{Piece, ServiceReply, ServiceRequest};
use etherpen::ethercat::wire::coe::Object;
use etherpen::robots::AXES;
use host_tools::cell::{CellOptions, Fault, SlaveKind};

/// The axis that is homed: the fourth one turns freely.
const AXIS: usize = 3;
/// Mode of the drives before: cyclic synchronous velocity.
const FORMER_MODE: i8 = 9;
const TURN: f64 = 1_048_576.0;

fn rig() -> Rig<'static> {
    let mut rig = idle_rig_of(CellOptions {
        slaves: vec![SlaveKind::Cia402; AXES],
        ..CellOptions::default()
    });
    rig.start();
    rig.operational();
    rig
}

/// Writes an object of the drive.
fn download(object: Object, value: u32, length: usize) -> ServiceRequest {
    ServiceRequest::Download {
        slave: AXIS as u8,
        object,
        complete: false,
        total: length as u16,
        offset: 0,
        piece: Piece::from_slice(&value.to_le_bytes()[..length]).expect("four bytes fit"),
    }
}

/// A millisecond in which the drive of the axis gets this control word; returns what it shows: status, position, and
/// whether its former mode is in effect.
fn millisecond(rig: &mut Rig<'_>, control: ControlWord) -> Option<(StatusWord, i32, bool)> {
    let time_ns = rig.sample_ns();
    let frame = rig.group.trigger_input().to_vec();
    rig.transfer(&frame, time_ns);
    rig.steer();
    rig.robot.read(&mut rig.group);
    let input = rig.group.read(AXIS);
    let output = DriveOutput {
        control,
        ..DriveOutput::default()
    };
    rig.group.write(AXIS, &output);
    let frame = rig.group.trigger_output().to_vec();
    rig.transfer(&frame, time_ns + OUTPUTS_AFTER_NS);
    let poll = rig.supervisor.as_mut().poll(&mut Context::from_waker(Waker::noop()));
    assert!(poll.is_pending());
    rig.now_ms += 1;
    input.map(|input| (input.status, input.position, input.mode_in_effect))
}

/// Runs the sequence; returns its end and the position that the drive shows then.
fn home(rig: &mut Rig<'_>, settings: &HomingSettings, cycles_max: u32, fault_at: Option<u32>) -> (HomingProgress, i32) {
    for setting in settings.settings() {
        let request = download(setting.object, setting.value, setting.length.into());
        assert_eq!(rig.ask(request), Ok(ServiceReply::Done), "{setting:?}");
    }
    let mut homing = Homing::new(FORMER_MODE, cycles_max);
    let mut mode = FORMER_MODE;
    let mut control = ControlWord::DISABLE_VOLTAGE;
    for cycle in 0..30_000 {
        if fault_at == Some(cycle) {
            rig.cell.inject(Fault::Drive(AXIS + 1, 0x7121));
        }
        let shown = millisecond(rig, control);
        let _ = rig.answers.dequeue();
        let Some((status, position, is_former)) = shown else {
            continue;
        };
        let in_effect = if is_former { FORMER_MODE } else { HOMING_MODE };
        let output: HomingOutput = homing.step(status, in_effect);
        if output.progress != HomingProgress::Running {
            return (output.progress, position);
        }
        if output.mode != mode {
            mode = output.mode;
            let request = download(Object::new(0x6060, 0), i32::from(mode).cast_unsigned(), 1);
            assert!(rig.services.enqueue(request).is_ok());
        }
        control = output.control;
    }
    panic!("the sequence has no end");
}

/// Increments of the motor since its mark.
fn motor_increments(rig: &Rig<'_>) -> f64 {
    let axis = &Config::default().axes[AXIS];
    let joint_rad = rig.cell.state().joints.0[AXIS];
    (joint_rad - axis.sync_angle_rad) * axis.gear * TURN / TAU
}

fn settings(method: i8, offset: i32) -> HomingSettings {
    HomingSettings {
        method: HomingMethod::new(method).expect("a method of CiA 402"),
        switch_speed: 200_000,
        zero_speed: 300_000,
        acceleration: 20_000_000,
        offset,
    }
}

#[test]
pub(crate) fn an_index_pulse_and_the_present_place_become_the_home_position() {
    for (method, offset) in [(34, 0), (33, -12_345), (34, 700_000), (35, 5), (37, -5)] {
        let mut rig = rig();
        let before = motor_increments(&rig);
        let (progress, shown) = home(&mut rig, &settings(method, offset), 20_000, None);
        assert_eq!(progress, HomingProgress::Done, "method {method}");
        let after = motor_increments(&rig);
        let home = match method {
            33 => (before / TURN).floor() * TURN,
            34 => (before / TURN).ceil() * TURN,
            _ => before,
        };
        println!("method {method}: from {before:.0} to {after:.0}, home {home:.0}, shows {shown}");
        let expected = f64::from(offset) + after - home;
        assert!(
            (f64::from(shown) - expected).abs() < 3.0,
            "shows {shown}, {expected} expected"
        );
        // The motor has stopped right behind the pulse.
        assert!((after - home).abs() < 20_000.0, "{after} against {home}");
    }
}

#[test]
pub(crate) fn a_search_without_an_end_is_timed_out_and_a_fault_ends_it_at_rest() {
    let mut rig = rig();
    let (progress, _) = home(&mut rig, &settings(17, 0), 300, None);
    assert_eq!(progress, HomingProgress::Failed(HomingFailure::TimeOut { cycles: 300 }));
    let stands = |rig: &mut Rig<'_>| {
        for _ in 0..300 {
            millisecond(rig, ControlWord::DISABLE_VOLTAGE);
        }
        let before = motor_increments(rig);
        millisecond(rig, ControlWord::DISABLE_VOLTAGE);
        (motor_increments(rig) - before).abs() < 1.0
    };
    assert!(stands(&mut rig));
    let (progress, _) = home(&mut rig, &settings(34, 0), 20_000, Some(60));
    let HomingProgress::Failed(HomingFailure::Drive { status }) = progress else {
        panic!("{progress:?}");
    };
    assert!(
        status.is_fault() || status.state() != DriveState::OperationEnabled,
        "{status:?}"
    );
    assert!(stands(&mut rig));
}

/// Reads an object of the drive.
fn upload(rig: &mut Rig<'_>, object: Object) -> u32 {
    let bytes = rig.value(ServiceRequest::Upload {
        slave: AXIS as u8,
        object,
        complete: false,
        offset: 0,
    });
    bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
}

#[test]
pub(crate) fn a_touch_probe_stores_the_place_of_the_next_index_pulse_each_time_it_is_armed() {
    let mut rig = rig();
    rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
    let mut probe = Probe::new(ProbeSettings {
        number: ProbeNumber::One,
        source: ProbeSource::Index,
        edge: ProbeEdge::Rising,
        continuous: false,
    });
    let place = ProbeNumber::One.position(ProbeEdge::Rising);
    let speeds_rad_s = [0.6, -0.6];
    for speed_rad_s in speeds_rad_s {
        rig.command = AxisCommand {
            target: DriveTarget::Enabled,
            demand: Demand::Velocity(speed_rad_s),
        };
        rig.run_ms(200);
        probe.rearm();
        let mut from = None;
        let found = (0..200).find_map(|_| {
            let (status, position) = (upload(&mut rig, PROBE_STATUS), upload(&mut rig, place));
            let (function, found) = probe.step(status as u16, position.cast_signed());
            let request = download(PROBE_FUNCTION, function.into(), 2);
            assert_eq!(rig.ask(request), Ok(ServiceReply::Done));
            if probe.is_armed() && from.is_none() {
                from = Some(motor_increments(&rig));
            }
            found
        });
        let (from, found) = (from.expect("it was armed"), f64::from(found.expect("an index pulse")));
        let turns = from / TURN;
        let expected = TURN * if speed_rad_s > 0.0 { turns.ceil() } else { turns.floor() };
        println!("{speed_rad_s} rad/s: armed at {from:.0}, stored {found}, the pulse is at {expected}");
        // The request that enables the probe takes some milliseconds: a pulse may pass meanwhile.
        let passed = (found - expected).abs() / TURN;
        assert!(passed < 1e-6 || (passed - 1.0).abs() < 1e-6, "{found}, {expected}");
    }
}
