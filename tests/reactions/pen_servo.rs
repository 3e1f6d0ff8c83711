//! A pen that a servo at a word of a terminal lowers: ink begins and ends with the line, and the word is that of the lifted pen at
//! every stop, whatever stopped the machine.

use crate::pen_output::{TERMINAL, corexy, path};
use crate::robot::Robot;
use crate::{assert_described_standstill, assert_recovers_with};
use etherpen::application::{Fault, InputCause, Mode};
use etherpen::config::{Config, IoRole, IoType, PenLiftKind};
use etherpen::messages::Command;
use etherpen::motion::Pen;
use host_tools::cell::Fault as CellFault;

/// Words of the pen, as pulses of 1 to 2 ms.
const UP: u16 = 1_000;
const DOWN: u16 = 2_000;
/// Longest time from a stop to the word of the lifted pen at the terminal, ms: the supervision's own millisecond and the
/// exchange's.
const UP_MAX_MS: u32 = 4;
/// Longest time that the servo then needs to leave the paper, ms: a frame, and its speed over the spring's way.
const LEAVES_MAX_MS: u32 = 60;
/// Largest distance of an end of the ink from that of its line, mm.
const END_MAX_MM: f64 = 0.1;

pub(super) fn servo(speed_mm_s: f64) -> Config {
    let mut config = corexy();
    config.motion.speed_mm_s = speed_mm_s;
    config.pen.kind = PenLiftKind::Servo;
    (config.pen.down, config.pen.up) = (DOWN.into(), UP.into());
    (config.pen.down_ms, config.pen.up_ms) = (120, 90);
    let pen = config.io.iter_mut().find(|point| point.role == IoRole::Pen).unwrap();
    pen.kind = IoType::U16;
    assert_eq!((config.check(), config.check_io()), (Ok(()), Ok(())));
    config
}

fn drawing(speed_mm_s: f64) -> Robot {
    let mut robot = Robot::idle_with(&servo(speed_mm_s));
    assert_eq!(robot.output_word(TERMINAL), UP, "the pen is up at rest");
    robot.draw(path());
    robot.run_until("the pen draws", |robot| {
        robot.cell().pen_touches && robot.ack.executed > 3
    });
    assert_eq!(robot.output_word(TERMINAL), DOWN);
    robot
}

/// The strokes' first and last places with the pen down, mm on the sheet, whose y points down.
fn ends() -> Vec<[[f64; 2]; 2]> {
    let on_sheet = |position_um: [i32; 3]| {
        let [x_um, y_um, _] = position_um.map(f64::from);
        [x_um / 1e3 + 100.0, 100.0 - y_um / 1e3]
    };
    let path = path();
    let of = |stroke: u32| {
        let own: Vec<_> = path.iter().filter(|vertex| vertex.stroke == stroke).collect();
        let first = own.iter().position(|vertex| vertex.pen == Pen::Down).unwrap();
        let last = own.iter().rposition(|vertex| vertex.pen == Pen::Down).unwrap();
        [on_sheet(own[first - 1].position_um), on_sheet(own[last].position_um)]
    };
    vec![of(0), of(1)]
}

#[test]
pub(crate) fn ink_begins_and_ends_with_the_line_at_a_servos_speed() {
    for speed_mm_s in [20.0, 200.0] {
        let mut robot = Robot::idle_with(&servo(speed_mm_s));
        robot.draw(path());
        robot.run_until("the path is executed", Robot::has_drawn);
        assert_eq!(robot.fault(), None);
        let ink = robot.ink();
        assert_eq!(ink.len(), 2, "a line for each stroke");
        for (stroke, ends) in ink.iter().zip(ends()) {
            let own = [*stroke.points_mm.first().unwrap(), *stroke.points_mm.last().unwrap()];
            for (end, wanted) in own.iter().zip(ends) {
                let off_mm = (end[0] - wanted[0]).hypot(end[1] - wanted[1]);
                println!("{speed_mm_s} mm/s: {off_mm:.4} mm beside the line's end");
                assert!(off_mm < END_MAX_MM, "{speed_mm_s} mm/s: {end:?} instead of {wanted:?}");
            }
        }
        // The whole of each line has ink.
        for vertex in path().iter().filter(|vertex| vertex.pen == Pen::Down) {
            let [x_um, y_um, _] = vertex.position_um.map(f64::from);
            let at = [x_um / 1e3 + 100.0, 100.0 - y_um / 1e3];
            let away_mm = ink[vertex.stroke as usize].distance_mm(&at);
            assert!(away_mm < 0.3, "{at:?}: {away_mm} mm");
        }
    }
}

/// Stops the machine.
type Stopping = fn(&mut Robot);

#[test]
pub(crate) fn the_servo_lifts_the_pen_at_every_stop_and_keeps_it_up_when_power_comes_back() {
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
            robot.run(UP_MAX_MS);
            assert_eq!(robot.output_word(TERMINAL), UP, "{what} at {speed_mm_s} mm/s");
            robot.run(LEAVES_MAX_MS);
            assert!(!robot.cell().pen_touches, "{what} at {speed_mm_s} mm/s");
            assert_described_standstill(&mut robot, |_| true);
            robot.set_inputs(2, 1);
            robot.run(1_000);
            assert_recovers_with(&mut robot, |robot| {
                assert_ne!(robot.output_word(TERMINAL), DOWN, "{what}: nothing is drawn");
            });
            assert_eq!(robot.ink().len(), ink, "{what}: no ink after the stop");
            robot.draw(path());
            robot.run_until("the path is executed", Robot::has_drawn);
            assert_eq!((robot.fault(), robot.ink().len()), (None, ink + 2), "{what}");
        }
    }
}

#[test]
pub(crate) fn a_hold_lifts_the_servos_pen_and_its_terminals_failure_is_a_fault() {
    for speed_mm_s in [20.0, 200.0] {
        let mut robot = drawing(speed_mm_s);
        robot.command(Command::Hold).unwrap();
        robot.run_until("held", |robot| {
            robot.mode() == Mode::Holding && robot.speed_rad_s() < 1e-3
        });
        robot.run(1_000);
        assert!(robot.output_word(TERMINAL) == UP && !robot.cell().pen_touches);
        robot.command(Command::Resume).unwrap();
        robot.run_until("the path is executed", Robot::has_drawn);
        assert_eq!(robot.fault(), None);

        let mut robot = drawing(speed_mm_s);
        robot.inject(CellFault::Deaf(TERMINAL, 500));
        assert_described_standstill(&mut robot, |fault| {
            matches!(
                fault,
                Fault::StopInput {
                    role: IoRole::Pen,
                    cause: InputCause::Missing,
                    ..
                }
            )
        });
        let mut robot = drawing(speed_mm_s);
        robot.inject(CellFault::Power(TERMINAL, 800));
        assert_described_standstill(&mut robot, |_| true);
        assert!(
            !robot.cell().pen_touches,
            "without its word the servo stands beyond its upper end"
        );
        robot.run(1_500);
        assert_recovers_with(&mut robot, |_| {});
        let ink = robot.ink().len();
        robot.draw(path());
        robot.run_until("the path is executed", Robot::has_drawn);
        assert_eq!((robot.fault(), robot.ink().len()), (None, ink + 2), "it draws again");
    }
}
