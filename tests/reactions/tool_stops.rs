//! A laser is off within a millisecond of every stop, hold and fault, whatever caused it, and draws again afterwards.

use crate::assert_recovers_with;
use crate::pen_output::TERMINAL;
use crate::robot::Robot;
use crate::tool::{MINIMUM, laser};
use etherpen::application::Mode;
use etherpen::config::{IoDirection, IoPoint, IoRole};
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::messages::{Command, PathVertex};
use etherpen::motion::Pen;
use host_tools::cell::{DriveState, Fault as CellFault};

/// Speed of the drawing, mm/s.
const SPEED_MM_S: f64 = 200.0;
/// Acceleration of the machine along its path, mm/s2.
const ACCELERATION_MM_S2: f64 = 4_000.0;

/// A long zigzag.
fn path() -> Vec<PathVertex> {
    let vertex = |x_um: i32, y_um: i32, z_um: i32, pen: Pen| PathVertex {
        position_um: [x_um, y_um, z_um],
        pen,
        stroke: 0,
    };
    let mut path = vec![vertex(-80_000, 0, 0, Pen::Up), vertex(-80_000, 0, -2_000, Pen::Up)];
    for leg in 1..=8 {
        let x_um = if leg % 2 == 0 { -80_000 } else { 80_000 };
        path.push(vertex(x_um, 5_000 * leg, -2_000, Pen::Down));
    }
    path.push(vertex(-80_000, 40_000, 0, Pen::Up));
    path
}

/// A drawing in the middle of a leg, at full speed, with its light on. An input holds drawings.
fn drawing(exchange: ExchangeKind, off_at_hold: bool) -> Robot {
    let mut config = laser(SPEED_MM_S, exchange);
    config.tool.off_at_hold = off_at_hold;
    config
        .io
        .push(IoPoint {
            name: "hold".try_into().unwrap(),
            slave: 1,
            direction: IoDirection::In,
            bit: Some(1),
            role: IoRole::Hold,
            ..IoPoint::default()
        })
        .unwrap();
    assert_eq!((config.check(), config.check_io()), (Ok(()), Ok(())));
    let mut robot = Robot::idle_with(&config);
    robot.draw(path());
    robot.run_until("the light is full", |robot| {
        let x_mm = robot.cell().platform.unwrap().x_mm;
        robot.ack.executed > 2 && robot.output_word(TERMINAL) > 31_000 && x_mm.abs() < 10.0
    });
    robot
}

/// True speed of the tool, mm/s.
fn speed_mm_s(robot: &mut Robot) -> f64 {
    let place = |robot: &Robot| robot.cell().platform.unwrap();
    let before = place(robot);
    robot.run(1);
    let after = place(robot);
    1e3 * (after.x_mm - before.x_mm).hypot(after.y_mm - before.y_mm)
}

/// What happens, and the longest time until the light is off at the terminal, ms.
struct Stopping {
    what: &'static str,
    happens: fn(&mut Robot),
    off_ms: u32,
}

const fn stopping(what: &'static str, happens: fn(&mut Robot), off_ms: u32) -> Stopping {
    Stopping { what, happens, off_ms }
}

/// What arrives in a millisecond, over the link or with the input telegram, is in the outputs of that millisecond. They leave with
/// the next telegram if one serves both directions.
const AT_ONCE_MS: u32 = 1;
/// The status of a drive is sent with the next telegram.
const AFTER_STATUS_MS: u32 = 2;

/// A fault of the first drive, up to the millisecond in which the drive has it.
fn drive_fault(robot: &mut Robot) {
    robot.inject(CellFault::Drive(4, 0x2310));
    robot.run_until("the drive has its fault", |robot| {
        robot.cell().slaves[3].drive != DriveState::OperationEnabled
    });
}

#[test]
pub(crate) fn the_light_is_off_in_the_millisecond_in_which_a_stop_a_hold_or_a_fault_arrives() {
    let stops = [
        stopping("stop", |robot| robot.say(Command::Stop), AT_ONCE_MS),
        stopping("cancel", |robot| robot.say(Command::Cancel), AT_ONCE_MS),
        stopping("hold", |robot| robot.say(Command::Hold), AT_ONCE_MS),
        stopping("hold input", |robot| robot.set_inputs(2, 0b01), AT_ONCE_MS),
        stopping("emergency stop", |robot| robot.set_inputs(2, 0b10), AT_ONCE_MS),
        stopping("drive fault", drive_fault, AFTER_STATUS_MS),
        stopping(
            "terminal without power",
            |robot| robot.inject(CellFault::Power(TERMINAL, 500)),
            1,
        ),
        // The blind limit and a watchdog of 10 ms: nothing else reaches the terminal.
        stopping("cable", |robot| robot.inject(CellFault::Cut(2)), 12),
        stopping(
            "deaf terminal",
            |robot| robot.inject(CellFault::Deaf(TERMINAL, 500)),
            12,
        ),
        stopping("no frames", |robot| robot.inject(CellFault::Stall(400)), 12),
        // The host's silence is noticed after 500 ms.
        stopping("silent host", |robot| robot.plugged = false, 520),
    ];
    for exchange in [ExchangeKind::Split, ExchangeKind::Combined] {
        for stop in &stops {
            let mut robot = drawing(exchange, true);
            (stop.happens)(&mut robot);
            let mut waited_ms = 0;
            while robot.output_word(TERMINAL) > 0 && waited_ms <= stop.off_ms + 50 {
                robot.run(1);
                waited_ms += 1;
            }
            println!("{exchange:?}, {}: off after {waited_ms} ms", stop.what);
            let combined_ms = u32::from(exchange == ExchangeKind::Combined);
            assert!(waited_ms <= stop.off_ms + combined_ms, "{}: {waited_ms} ms", stop.what);
            for _ in 0..600 {
                robot.run(1);
                assert_eq!(robot.output_word(TERMINAL), 0, "{}", stop.what);
            }
        }
    }
}

#[test]
pub(crate) fn a_hold_is_dark_before_the_tool_brakes_and_the_line_goes_on_after_a_known_gap_or_none() {
    for (off_at_hold, by_input) in [(true, false), (true, true), (false, false), (false, true)] {
        let mut robot = drawing(ExchangeKind::Split, off_at_hold);
        match by_input {
            true => robot.set_inputs(2, 0b01),
            false => robot.say(Command::Hold),
        }
        let mut slowest_mm_s = f64::INFINITY;
        while robot.output_word(TERMINAL) > 0 {
            slowest_mm_s = slowest_mm_s.min(speed_mm_s(&mut robot));
        }
        println!("off at hold: {off_at_hold}: at least {slowest_mm_s:.1} mm/s with light");
        assert_eq!(slowest_mm_s > 0.95 * SPEED_MM_S, off_at_hold);
        robot.run_until("held", |robot| {
            robot.mode() == Mode::Holding && robot.speed_rad_s() < 1e-3
        });
        robot.run(300);
        robot.set_inputs(2, 0b11);
        robot.run(20);
        let before = *robot.ink().last().unwrap().points_mm.last().unwrap();
        let lines = robot.ink().len();
        robot.command(Command::Resume).unwrap();
        robot.run_until("the light is on", |robot| robot.ink().len() > lines);
        let after = robot.ink().last().unwrap().points_mm[0];
        let gap_mm = (after[0] - before[0]).hypot(after[1] - before[1]);
        println!("off at hold: {off_at_hold}: a gap of {gap_mm:.3} mm");
        // It brakes within 60 ms of the hold, as fast as the machine accelerates.
        let braking_mm = SPEED_MM_S * 0.06 + SPEED_MM_S * SPEED_MM_S / (2.0 * ACCELERATION_MM_S2);
        assert!(gap_mm < if off_at_hold { braking_mm } else { 0.05 }, "{gap_mm} mm");
        robot.run_until("the path is executed", Robot::has_drawn);
        assert_eq!((robot.fault(), robot.ink().len()), (None, lines + 1));
    }
}

#[test]
pub(crate) fn after_a_stop_the_light_stays_off_until_the_next_stroke_which_is_whole() {
    let stops: [fn(&mut Robot); 4] = [
        |robot| robot.command(Command::Stop).unwrap(),
        |robot| robot.set_inputs(2, 0b10),
        |robot| robot.inject(CellFault::Drive(4, 0x2310)),
        |robot| robot.inject(CellFault::Deaf(TERMINAL, 500)),
    ];
    for stop in stops {
        let mut robot = drawing(ExchangeKind::Split, true);
        stop(&mut robot);
        robot.wait_for(Mode::Fault);
        robot.run(1_000);
        robot.set_inputs(2, 0b11);
        robot.run(20);
        let ink = robot.ink().len();
        assert_recovers_with(&mut robot, |robot| assert_eq!(robot.output_word(TERMINAL), 0));
        robot.draw(path());
        robot.run_until("the path is executed", Robot::has_drawn);
        assert_eq!((robot.fault(), robot.ink().len()), (None, ink + 1));
        let line = robot.ink().last().unwrap().clone();
        assert!(
            MINIMUM > 0 && (line.length_mm() - 8.0 * 160.08).abs() < 3.0,
            "{} mm",
            line.length_mm()
        );
    }
}
