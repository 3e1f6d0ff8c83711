//! A pen that an output lowers: it leaves the paper at every stop, whatever stopped the machine, and never touches by itself.

use crate::robot::Robot;
use crate::{assert_described_standstill, assert_recovers_with};
use etherpen::application::{Fault, InputCause, Mode};
use etherpen::config::{Config, IoDirection, IoPoint, IoRole, PenLift, PenLiftKind};
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::messages::{Command, PathVertex};
use etherpen::motion::Pen;
use etherpen::robots::Position;
use host_tools::cell::{CellOptions, Fault as CellFault};
use host_tools::settings::machines::MACHINES;

/// The terminal with the pen's output, from 1.
pub(super) const TERMINAL: usize = 3;
/// Longest time from a stop to an output that is off at the terminal, ms: the supervision's own millisecond and the
/// exchange's.
const OFF_MAX_MS: u32 = 4;

pub(super) fn corexy() -> Config {
    MACHINES[2].load().unwrap()
}

/// Two strokes of 60 mm zigzags around the middle of the bed.
pub(super) fn path() -> Vec<PathVertex> {
    let mut path = Vec::new();
    for stroke in 0..2_u32 {
        let y_um = 30_000 * stroke as i32;
        let mut go = |x_um: i32, y_um: i32, z_um: i32, pen: Pen| {
            path.push(PathVertex {
                position_um: [x_um, y_um, z_um],
                pen,
                stroke,
            });
        };
        go(-30_000, y_um, 0, Pen::Up);
        go(-30_000, y_um, -2_000, Pen::Up);
        for leg in 1..=8 {
            let x_um = if leg % 2 == 0 { -30_000 } else { 30_000 };
            go(x_um, y_um + 2_500 * leg, -2_000, Pen::Down);
        }
        go(-30_000, y_um + 20_000, 0, Pen::Up);
    }
    path
}

fn drawing(speed_mm_s: f64) -> Robot {
    drawing_with(speed_mm_s, ExchangeKind::Split)
}

fn drawing_with(speed_mm_s: f64, exchange: ExchangeKind) -> Robot {
    let mut config = corexy();
    config.motion.speed_mm_s = speed_mm_s;
    config.bus.exchange = exchange;
    let mut robot = Robot::idle_with(&config);
    assert_eq!(robot.outputs(TERMINAL), 0, "the pen is up at rest");
    robot.draw(path());
    robot.run_until("the pen draws", |robot| {
        robot.cell().pen_touches && robot.ack.executed > 3
    });
    robot
}

/// Stops the machine.
type Stopping = fn(&mut Robot);

#[test]
pub(crate) fn the_pen_is_off_at_once_at_a_stop_a_drive_fault_and_a_lost_terminal_and_stays_up_when_power_comes_back() {
    let stops: [(&str, Stopping); 4] = [
        ("stop", |robot| robot.command(Command::Stop).unwrap()),
        ("drive fault", |robot| robot.inject(CellFault::Drive(4, 0x2310))),
        ("emergency stop", |robot| robot.set_inputs(2, 0)),
        ("drive lost", |robot| robot.inject(CellFault::Power(5, 500))),
    ];
    for speed_mm_s in [20.0, 200.0] {
        for (what, stop) in stops {
            let mut robot = drawing(speed_mm_s);
            let ink = robot.ink().len();
            stop(&mut robot);
            robot.run_until("the fault is latched", |robot| robot.fault().is_some());
            robot.run(OFF_MAX_MS);
            assert_eq!(robot.outputs(TERMINAL), 0, "{what} at {speed_mm_s} mm/s");
            assert_described_standstill(&mut robot, |_| true);
            assert!(!robot.cell().pen_touches, "{what}");
            robot.set_inputs(2, 1);
            robot.run(1_000);
            assert_recovers_with(&mut robot, |robot| {
                assert_eq!(
                    robot.outputs(TERMINAL),
                    0,
                    "{what}: the pen is up while nothing is drawn"
                );
            });
            assert_eq!(robot.ink().len(), ink, "{what}: no ink after the stop");
            robot.draw(path());
            robot.run_until("the path is executed", |robot| {
                robot.ack.finished && robot.mode() == Mode::Idle
            });
            assert_eq!((robot.fault(), robot.ink().len()), (None, ink + 2), "{what}");
        }
    }
}

/// A gantry with switches and an axis of the height, whose pen is at an output besides.
pub(super) fn gantry_with_pen_output() -> Config {
    let mut config = MACHINES[1].load().unwrap();
    config.pen = PenLift {
        kind: PenLiftKind::Output,
        ..PenLift::default()
    };
    config
        .io
        .push(IoPoint {
            name: "pen".try_into().unwrap(),
            slave: TERMINAL as u8 - 1,
            direction: IoDirection::Out,
            bit: Some(0),
            role: IoRole::Pen,
            ..IoPoint::default()
        })
        .unwrap();
    assert_eq!((config.check(), config.check_io()), (Ok(()), Ok(())));
    config
}

#[test]
pub(crate) fn the_pen_is_up_until_the_machine_is_homed_in_a_search_and_on_the_way_down_to_the_sheet() {
    let config = gantry_with_pen_output();
    let mut robot = Robot::of(&config, CellOptions::default());
    robot.configure(&config);
    robot.wait_for(Mode::DrivesOff);
    robot.command(Command::Enable).unwrap();
    let is_off = |robot: &mut Robot, what: &str| {
        assert_eq!(robot.outputs(TERMINAL), 0, "{what}: {:?}", robot.cell().joints);
    };
    let homes = |robot: &mut Robot| {
        robot.command(Command::Home).unwrap();
        robot.wait_for(Mode::Homing);
        while robot.mode() == Mode::Homing {
            robot.run(1);
            is_off(robot, "homing");
            // The file's 60 mm/s, and what a drive overshoots.
            assert!(robot.speed_rad_s() < 0.66, "{} rad/s", robot.speed_rad_s());
        }
        assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None));
    };
    for _ in 0..1_000 {
        robot.run(1);
        is_off(&mut robot, "not homed");
    }
    assert_eq!(robot.mode(), Mode::Unreferenced);
    homes(&mut robot);
    // The height stands near 0, and the pen is up at -27 mm: a slow way down over the sheet.
    let point = |x_mm: i32, z_mm: i32, pen: Pen| PathVertex {
        position_um: [x_mm * 1_000, 240_000, z_mm * 1_000],
        pen,
        stroke: 0,
    };
    robot.draw(vec![
        point(300, -27, Pen::Up),
        point(300, -30, Pen::Up),
        point(340, -30, Pen::Down),
        point(340, -27, Pen::Up),
    ]);
    robot.run_until("the pen is on", |robot| robot.outputs(TERMINAL) != 0);
    // The output follows the setpoints, the motor a moment later.
    let z_mm = robot.cell().joints.0[2] * 100.0;
    assert!(z_mm < -26.9, "{z_mm} mm");
    robot.run_until("the path is executed", |robot| {
        robot.ack.finished && robot.mode() == Mode::Idle
    });
    assert_eq!((robot.fault(), robot.ink().len()), (None, 1));
    // Low, and homed once more.
    robot.command(Command::Pen { pen: Pen::Down }).unwrap();
    robot.run_until("the pen is on", |robot| robot.outputs(TERMINAL) != 0);
    robot.run_until("at rest", |robot| {
        robot.mode() == Mode::Idle && robot.speed_rad_s() < 1e-3
    });
    homes(&mut robot);
    is_off(&mut robot, "homed");
    // Stopped with the pen on the paper: the tool stands low when power comes back, and the pen stays up.
    let lowers = |robot: &mut Robot| {
        robot.command(Command::Pen { pen: Pen::Up }).unwrap();
        robot.wait_for(Mode::Moving);
        robot.wait_for(Mode::Idle);
        robot.command(Command::Pen { pen: Pen::Down }).unwrap();
        robot.run_until("the pen is on", |robot| robot.outputs(TERMINAL) != 0);
        robot.run_until("at rest", |robot| {
            robot.mode() == Mode::Idle && robot.speed_rad_s() < 1e-3
        });
    };
    lowers(&mut robot);
    assert!(robot.cell().joints.0[2] * 100.0 < -29.9);
    robot.command(Command::Stop).unwrap();
    assert_described_standstill(&mut robot, |_| true);
    robot.command(Command::Acknowledge).unwrap();
    robot.wait_for(Mode::DrivesOff);
    robot.command(Command::Enable).unwrap();
    for _ in 0..1_000 {
        robot.run(1);
        is_off(&mut robot, "power comes back");
    }
    assert_eq!(robot.mode(), Mode::Idle);
    lowers(&mut robot);
}

#[test]
pub(crate) fn a_terminal_that_fails_while_its_pen_draws_is_a_fault_and_a_held_drawing_has_its_pen_up() {
    let mut robot = drawing(200.0);
    robot.inject(CellFault::Power(TERMINAL, 800));
    assert_described_standstill(&mut robot, |fault| {
        matches!(
            fault,
            Fault::SlaveLost { slave: 2 } | Fault::SlaveState { .. } | Fault::Blind { .. } | Fault::StopInput { .. }
        )
    });
    // Its outputs are lost, though everything else of the bus is well: while it draws, and before.
    let is_unconfirmed = |fault: &Fault| {
        matches!(
            fault,
            Fault::StopInput {
                role: IoRole::Pen,
                cause: InputCause::Missing,
                ..
            }
        )
    };
    let exchanges = [ExchangeKind::Split, ExchangeKind::Combined];
    for (speed_mm_s, exchange) in exchanges.into_iter().flat_map(|kind| [(20.0, kind), (200.0, kind)]) {
        let mut robot = drawing_with(speed_mm_s, exchange);
        robot.inject(CellFault::Deaf(TERMINAL, 500));
        let begun_ms = robot.now_ms();
        robot.run_until("the fault is latched", |robot| robot.fault().is_some());
        let took_ms = robot.now_ms() - begun_ms;
        println!("{exchange:?}, {speed_mm_s} mm/s: latched after {took_ms} ms");
        // The limit, and what the report takes.
        assert!(
            took_ms <= u64::from(robot.config().bus.blind_max_ms) + 8,
            "{took_ms} ms"
        );
        assert_described_standstill(&mut robot, is_unconfirmed);
        robot.run(1_000);
        assert_recovers_with(&mut robot, |_| {});
        let ink = robot.ink().len();
        robot.draw(path());
        robot.run_until("the path is executed", Robot::has_drawn);
        assert_eq!((robot.fault(), robot.ink().len()), (None, ink + 2), "it draws again");
    }
    for is_deaf in [false, true] {
        let mut robot = Robot::of(&corexy(), CellOptions::default());
        robot.configure(&corexy());
        robot.wait_for(Mode::DrivesOff);
        if is_deaf {
            robot.inject(CellFault::Deaf(TERMINAL, 3_000));
        }
        robot.run(100);
        robot.command(Command::Home).unwrap();
        robot.run(100);
        let is_enabled = robot.command(Command::Enable).is_ok();
        robot.run(2_000);
        assert_eq!(
            robot.mode() == Mode::Idle,
            !is_deaf,
            "a pen that nobody moves keeps the drives off ({is_enabled})"
        );
    }
    let mut robot = drawing(200.0);
    robot.command(Command::Hold).unwrap();
    robot.run_until("held", |robot| {
        robot.mode() == Mode::Holding && robot.speed_rad_s() < 1e-3
    });
    robot.run(1_000);
    assert!(robot.outputs(TERMINAL) == 0 && !robot.cell().pen_touches);
    robot.command(Command::Resume).unwrap();
    robot.run_until("the path is executed", |robot| {
        robot.ack.finished && robot.mode() == Mode::Idle
    });
    assert_eq!(robot.fault(), None);
}

#[test]
pub(crate) fn a_way_down_that_ends_above_the_paper_is_travel_and_leaves_no_ink() {
    let mut robot = Robot::idle_with(&corexy());
    let mut go = |x_mm: f64, z_mm: f64| {
        let (y_mm, before) = (-40.0, robot.cell().joints.0[0]);
        let position = Position { x_mm, y_mm, z_mm };
        robot.command(Command::Move { position }).unwrap();
        robot.run_until("it moves", |robot| robot.speed_rad_s() > 0.1);
        while robot.mode() != Mode::Idle || robot.speed_rad_s() > 1e-3 {
            robot.run(1);
            assert!(
                robot.outputs(TERMINAL) == 0 && !robot.cell().pen_touches,
                "to {x_mm}, {z_mm} mm"
            );
        }
        assert!((robot.cell().joints.0[0] - before).abs() > 0.1, "it has moved");
    };
    // Up, down to the height of a lifted pen, up again, a part of the way down, and below the lifted pen: nothing holds the
    // pen there, so that it stays up.
    for (x_mm, z_mm) in [
        (-60.0, 3.5),
        (60.0, 0.0),
        (-60.0, 3.0),
        (60.0, 1.0),
        (-60.0, -0.3),
        (60.0, -1.9),
    ] {
        go(x_mm, z_mm);
    }
    assert_eq!(robot.ink().len(), 0);
    robot.draw(path());
    robot.run_until("the path is executed", |robot| {
        robot.ack.finished && robot.mode() == Mode::Idle
    });
    assert_eq!(
        (robot.fault(), robot.ink().len()),
        (None, 2),
        "a drawing lowers the pen"
    );
}

#[test]
pub(crate) fn a_tool_that_nothing_lifts_touches_always_and_draws_its_travel_too() {
    for speed_mm_s in [20.0, 200.0] {
        let mut config = corexy();
        config.pen.kind = PenLiftKind::None;
        config.io.retain(|point| point.role != IoRole::Pen);
        config.motion.speed_mm_s = speed_mm_s;
        let mut robot = Robot::idle_with(&config);
        assert!(robot.cell().pen_touches, "at rest too");
        let begun_ms = robot.now_ms();
        robot.draw(path());
        robot.run_until("the path is executed", |robot| {
            robot.ack.finished && robot.mode() == Mode::Idle
        });
        let drawn_ms = robot.now_ms() - begun_ms;
        assert_eq!(robot.fault(), None);
        let ink = robot.ink();
        assert_eq!(ink.len(), 1, "one line without an end");
        // Each vertex has ink, also those that are reached with the pen up. The sheet's y points down.
        for vertex in path() {
            let [x_um, y_um, _] = vertex.position_um.map(f64::from);
            let on_sheet = [x_um / 1e3 + 100.0, 100.0 - y_um / 1e3];
            let away_mm = ink[0].distance_mm(&on_sheet);
            assert!(away_mm < 0.3, "{on_sheet:?}: {away_mm} mm");
        }
        // 16 legs of 60 mm.
        println!("{speed_mm_s} mm/s: {drawn_ms} ms");
        assert!((drawn_ms as f64) > 950.0 * 1e3 / speed_mm_s, "{drawn_ms} ms");
    }
}
