//! Position mode of AKD drives, which count as objects tell them and have neither a velocity beside the target nor a window
//! of CiA 402; and of drives that have no position mode.

use crate::feedback::{apart_mm, with};
use crate::liveness::come_back;
use crate::robot::Robot;
use crate::{STILL_RAD_S, assert_described_standstill};
use etherpen::application::{Fault, Mode};
use etherpen::config::{AxisMode, Config};
use etherpen::messages::Command;
use etherpen::robots::AXES;
use host_tools::cell::{CellOptions, Fault as CellFault, InkStroke, Product, ResolverFault, SlaveKind};
use host_tools::link::text;

/// Speeds of the pen on the paper, mm/s.
const SPEEDS_MM_S: [f64; 2] = [60.0, 400.0];
/// How far the ink of AKD drives may be from that of drives with a velocity beside the target, mm, at each of these speeds.
const APART_MM: [f64; 2] = [0.06, 0.18];
/// How far ink may be from that of a sound robot with the same drives, mm.
const ALIKE_MM: f64 = 0.06;
/// How far ink may be from the ink of a sound robot after single lost targets, mm: the drives extrapolate.
const EXTRAPOLATED_MM: f64 = 0.07;
/// How far a joint runs on in the quick stop at least, rad: 600 increments, far beyond what may happen while enabling.
const RUN_ON_RAD: f64 = 3e-4;
/// Farthest that a joint may move while its drive is enabled, rad: 5 increments.
const ENABLING_RAD: f64 = 2.5e-6;

fn config(speed_mm_s: f64) -> Config {
    let mut config = with(AxisMode::Position, 250.0);
    config.motion.speed_mm_s = speed_mm_s;
    config
}

fn cell(kind: &SlaveKind) -> CellOptions {
    CellOptions {
        slaves: vec![kind.clone(); AXES],
        ..CellOptions::default()
    }
}

/// A robot with these drives, enabled.
fn idle(kind: &SlaveKind, config: &Config) -> Robot {
    Robot::of(config, cell(kind)).enabled()
}

/// The ink of a drawing of a sound robot with these drives.
fn sound(kind: &SlaveKind, config: &Config) -> Vec<InkStroke> {
    let mut robot = idle(kind, config).in_a_drawing();
    robot.run_until("the path is executed", Robot::has_drawn);
    assert_eq!(robot.fault(), None);
    robot.ink()
}

#[test]
pub(crate) fn akd_drives_draw_what_other_drives_in_position_mode_draw_also_with_targets_lost() {
    for (speed_mm_s, apart_max_mm) in SPEEDS_MM_S.into_iter().zip(APART_MM) {
        let config = config(speed_mm_s);
        let ink = sound(&SlaveKind::Akd, &config);
        let apart = apart_mm(&ink, &sound(&SlaveKind::Cia402, &config));
        let mut robot = idle(&SlaveKind::Akd, &config).in_a_drawing();
        let mut lost = 0;
        while !robot.has_drawn() {
            robot.inject(CellFault::Stall(1));
            robot.run(37);
            lost += 1;
            assert!(lost < 2_000 && robot.fault().is_none(), "{:?}", robot.fault());
        }
        let extrapolated = apart_mm(&robot.ink(), &ink);
        println!("{speed_mm_s} mm/s: {apart:.4} mm from other drives, {extrapolated:.4} mm with {lost} frames lost");
        assert!(apart < apart_max_mm, "{apart} mm");
        assert!(lost > 10 && extrapolated < EXTRAPOLATED_MM, "{extrapolated} mm");
    }
}

#[test]
pub(crate) fn drives_enabled_elsewhere_than_at_their_last_target_do_not_move() {
    for kind in [SlaveKind::Akd, SlaveKind::Cia402] {
        let config = config(400.0);
        let mut robot = idle(&kind, &config).in_a_drawing();
        let moving = robot.cell().joints;
        // The quick stop of one drive ends the motion of all far behind the targets that were sent last.
        robot.inject(CellFault::Drive(2, 0x2310));
        assert_described_standstill(&mut robot, |fault| matches!(fault, Fault::Drive { axis: 1, .. }));
        let at_rest = robot.cell().joints;
        let run_on = at_rest.0.iter().zip(moving.0).map(|(now, then)| (now - then).abs());
        let run_on = run_on.fold(0.0, f64::max);
        robot.command(Command::Acknowledge).unwrap();
        robot.wait_for(Mode::DrivesOff);
        robot.command(Command::Enable).unwrap();
        let mut moved_rad = 0.0_f64;
        for _ in 0..3_000 {
            robot.run(1);
            for (now, then) in robot.cell().joints.0.iter().zip(at_rest.0) {
                moved_rad = moved_rad.max((now - then).abs());
            }
        }
        println!("{kind:?}: ran on by {run_on:.4} rad, then moved by {moved_rad:.2e} rad while enabled");
        assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None));
        assert!(
            run_on > RUN_ON_RAD && moved_rad < ENABLING_RAD,
            "{run_on} rad, {moved_rad} rad"
        );
    }
}

#[test]
pub(crate) fn whatever_an_akd_forgets_it_is_told_again_and_the_next_drawing_comes_out_right() {
    for speed_mm_s in SPEEDS_MM_S {
        let config = config(speed_mm_s);
        let expected = sound(&SlaveKind::Akd, &config);
        let faults = [
            // Without its power the drive forgets how its positions count.
            ("power-cycled", CellFault::Power(3, 800)),
            ("replaced", CellFault::Swap(3, Product::Akd)),
            ("frozen feedback", CellFault::Resolver(1, ResolverFault::Stuck, 600)),
            ("frames stalled", CellFault::Stall(300)),
        ];
        for (what, fault) in faults {
            let mut robot = idle(&SlaveKind::Akd, &config).in_a_drawing();
            robot.inject(fault);
            robot.run_until("a fault is told", |robot| robot.fault().is_some());
            robot.run(2_000);
            assert!(robot.speed_rad_s() < STILL_RAD_S);
            println!("{speed_mm_s} mm/s, {what}: {:?}", robot.fault());
            come_back(&mut robot, 2);
            let strokes = robot.ink().len();
            robot.draw(crate::robot::path());
            robot.run_until("the path is executed", Robot::has_drawn);
            let apart = apart_mm(&robot.ink()[strokes..], &expected);
            println!("    the next drawing is {apart:.4} mm from that of a sound robot");
            assert!(apart < ALIKE_MM, "{what}: {apart} mm");
        }
    }
}

#[test]
pub(crate) fn a_drive_without_a_position_mode_is_refused_by_name_and_nothing_moves() {
    let config = config(60.0);
    let mut robot = Robot::of(&config, cell(&SlaveKind::Ax2000));
    let before = robot.cell().joints;
    robot.configure(&config);
    robot.run_until("the refusal is told", |robot| robot.mode() == Mode::Fault);
    let told = robot.fault().map(|fault| text::fault(&fault)).unwrap();
    println!("{told}");
    assert!(
        told.contains("slave 1") && told.contains("no mode \"position\""),
        "{told}"
    );
    assert_eq!(robot.cell().joints, before);
}
