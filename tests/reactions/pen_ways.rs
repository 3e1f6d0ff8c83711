//! A pen that an output lowers is down where an order says so, and nowhere else: single moves leave the paper straight up, go
//! over the sheet and come straight down, whatever ends them, and a drawing that was held on the way down has its whole line.

use crate::pen_output::{TERMINAL, corexy, gantry_with_pen_output};
use crate::pen_servo::servo;
use crate::robot::Robot;
use etherpen::application::Mode;
use etherpen::config::{Config, PenLiftKind};
use etherpen::messages::{Command, PathVertex};
use etherpen::motion::Pen;
use etherpen::robots::Position;
use host_tools::cell::CellOptions;

/// Largest distance of ink from its place, mm: the solenoid or servo may begin to move while the tool settles.
const BESIDE_MAX_MM: f64 = 0.1;
/// Time in which any of the pens is down or up, ms.
const PEN_MS: u32 = 150;
/// Largest time by which the planner is ahead of the motors, ms: two periods, and what a command takes to it.
const AHEAD_MS: u32 = 40;

fn solenoid(down_ms: u16, up_ms: u16) -> Config {
    let mut config = corexy();
    (config.pen.down_ms, config.pen.up_ms) = (down_ms, up_ms);
    config
}

/// A place on the sheet of a machine, mm.
fn on_sheet(config: &Config, [x_mm, y_mm]: [f64; 2]) -> [f64; 2] {
    let ([centre_x, centre_y], [width, height]) = (config.paper.centre_mm, config.paper.size_mm);
    [x_mm - centre_x + 0.5 * width, 0.5 * height - (y_mm - centre_y)]
}

/// Heights of the tool with the pen up and down, mm.
fn heights(config: &Config) -> [f64; 2] {
    let down_mm = config.paper.pen_down_z_mm;
    [down_mm + config.paper.pen_lift_mm, down_mm]
}

fn is_on(robot: &Robot) -> bool {
    let off = match robot.config().pen.kind {
        PenLiftKind::Servo => robot.config().pen.up as u16,
        _ => 0,
    };
    robot.output_word(TERMINAL) != off
}

/// Waits until the machine rests, and its pen.
fn settle(robot: &mut Robot) {
    robot.run(AHEAD_MS);
    robot.run_until("at rest", |robot| {
        matches!(robot.mode(), Mode::Idle | Mode::Holding) && robot.speed_rad_s() < 1e-3
    });
    robot.run(PEN_MS);
}

fn carry_out(robot: &mut Robot, command: Command) {
    robot.command(command).unwrap();
    settle(robot);
}

fn move_to([x_mm, y_mm]: [f64; 2], z_mm: f64) -> Command {
    let position = Position { x_mm, y_mm, z_mm };
    Command::Move { position }
}

/// Asserts that all ink lies at one of these places, mm.
fn assert_ink_at(robot: &Robot, places: &[[f64; 2]], what: &str) {
    let places: Vec<_> = places.iter().map(|place| on_sheet(robot.config(), *place)).collect();
    for [x, y] in robot.ink().iter().flat_map(|stroke| &stroke.points_mm) {
        let away = |[at_x, at_y]: &[f64; 2]| (x - at_x).hypot(y - at_y);
        let away_mm = places.iter().map(away).fold(f64::INFINITY, f64::min);
        assert!(away_mm < BESIDE_MAX_MM, "{what}: ink {away_mm} mm away, at {x}, {y}");
    }
}

/// Asserts that all ink since a time lies on a line, mm, and that the line has ink at both ends.
fn assert_ink_on(robot: &Robot, since_ms: u64, line: [[f64; 2]; 2], what: &str) {
    let [[x, y], [to_x, to_y]] = line.map(|end| on_sheet(robot.config(), end));
    let along = [to_x - x, to_y - y];
    let squared = along[0] * along[0] + along[1] * along[1];
    let mut ink = robot.ink();
    ink.retain(|stroke| stroke.start_ms >= since_ms);
    for [at_x, at_y] in ink.iter().flat_map(|stroke| &stroke.points_mm) {
        let share = (((at_x - x) * along[0] + (at_y - y) * along[1]) / squared).clamp(0.0, 1.0);
        let away_mm = (at_x - x - share * along[0]).hypot(at_y - y - share * along[1]);
        assert!(
            away_mm < BESIDE_MAX_MM,
            "{what}: ink {away_mm} mm away, at {at_x}, {at_y}"
        );
    }
    for end in [[x, y], [to_x, to_y]] {
        let distances = ink.iter().map(|stroke| stroke.distance_mm(&end));
        let away_mm = distances.fold(f64::INFINITY, f64::min);
        assert!(away_mm < BESIDE_MAX_MM, "{what}: no ink within {away_mm} mm of {end:?}");
    }
}

/// The machines, at rest with the pen up over a place of the sheet, mm, and another place.
fn machines() -> Vec<(&'static str, Robot, [[f64; 2]; 2])> {
    let config = gantry_with_pen_output();
    let mut gantry = Robot::of(&config, CellOptions::default());
    gantry.configure(&config);
    gantry.wait_for(Mode::DrivesOff);
    gantry.command(Command::Enable).unwrap();
    gantry.wait_for(Mode::Unreferenced);
    gantry.command(Command::Home).unwrap();
    gantry.wait_for(Mode::Homing);
    gantry.wait_for(Mode::Idle);
    let over = [[-60.0, -40.0], [60.0, 40.0]];
    let mut machines = vec![
        ("solenoid", Robot::idle_with(&corexy()), over),
        ("servo", Robot::idle_with(&servo(200.0)), over),
        ("gantry", gantry, [[300.0, 240.0], [380.0, 280.0]]),
    ];
    for (_, robot, [place, _]) in &mut machines {
        let [up_mm, _] = heights(robot.config());
        carry_out(robot, move_to(*place, up_mm));
    }
    machines
}

#[test]
pub(crate) fn a_move_leaves_the_paper_straight_up_goes_over_the_sheet_and_comes_straight_down() {
    for (name, mut robot, [first, second]) in machines() {
        let [up_mm, down_mm] = heights(robot.config());
        let mut lowered = Vec::new();
        for (place, z_mm) in [
            // Slanted to the sheet, level on it, away from it, level above it.
            (second, down_mm),
            (first, down_mm),
            (second, up_mm),
            (first, up_mm),
            // From above the height of a lifted pen, and to it.
            (first, up_mm + 1.0),
            (second, down_mm),
            (first, up_mm + 1.0),
        ] {
            let what = format!("{name}, to {place:?}, {z_mm} mm");
            if z_mm == down_mm {
                lowered.push(place);
            }
            carry_out(&mut robot, move_to(place, z_mm));
            let is_down = z_mm == down_mm;
            assert_eq!((is_on(&robot), robot.cell().pen_touches), (is_down, is_down), "{what}");
            assert_ink_at(&robot, &lowered, &what);
        }
        assert_eq!(robot.fault(), None, "{name}");
    }
}

#[test]
pub(crate) fn a_path_that_begins_on_the_sheet_is_approached_from_above_with_the_pen_up() {
    for (name, mut robot, [first, second]) in machines() {
        let [up_mm, down_mm] = heights(robot.config());
        let vertex = |[x_mm, y_mm]: [f64; 2], z_mm: f64, pen: Pen| PathVertex {
            position_um: [x_mm, y_mm, z_mm].map(|mm| (mm * 1e3) as i32),
            pen,
            stroke: 0,
        };
        let end = [second[0] - 30.0, second[1]];
        // From where the pen is up, and from above.
        for z_mm in [up_mm, up_mm + 1.0] {
            carry_out(&mut robot, move_to([first[0] + 1.0, first[1]], z_mm));
            robot.draw(vec![
                vertex(second, down_mm, Pen::Up),
                vertex(end, down_mm, Pen::Down),
                vertex(end, up_mm, Pen::Up),
            ]);
            robot.run_until("the path is executed", Robot::has_drawn);
            robot.run(PEN_MS);
            assert_eq!((robot.fault(), robot.cell().pen_touches), (None, false), "{name}");
            assert_ink_on(&robot, 0, [second, end], name);
        }
    }
}

#[test]
pub(crate) fn a_pen_whose_way_is_cancelled_at_any_millisecond_is_up_and_leaves_no_ink_elsewhere() {
    for (name, config) in [("solenoid", solenoid(120, 90)), ("servo", servo(200.0))] {
        let [up_mm, down_mm] = heights(&config);
        let (aside, place) = ([-20.0, 0.0], [-10.0, 0.0]);
        let mut robot = Robot::idle_with(&config);
        for order in [Command::Pen { pen: Pen::Down }, move_to(place, down_mm)] {
            let begin = |robot: &mut Robot| {
                carry_out(robot, Command::Pen { pen: Pen::Up });
                let from = if matches!(order, Command::Pen { .. }) {
                    place
                } else {
                    aside
                };
                carry_out(robot, move_to(from, up_mm));
                robot.command(order).unwrap();
            };
            begin(&mut robot);
            let begun_ms = robot.now_ms();
            robot.run_until("the output is on", is_on);
            let on_ms = (robot.now_ms() - begun_ms) as u32;
            settle(&mut robot);
            assert!(robot.cell().pen_touches, "{name}, {order:?}: not cancelled");
            for after_ms in 0..on_ms + 120 - AHEAD_MS {
                let what = format!("{name}, {order:?}, cancelled after {after_ms} ms");
                begin(&mut robot);
                robot.run(after_ms);
                robot.command(Command::Cancel).unwrap();
                settle(&mut robot);
                assert!(!is_on(&robot) && !robot.cell().pen_touches, "{what}");
            }
            assert_ink_at(&robot, &[place], name);
        }
        assert_eq!(robot.fault(), None, "{name}");
    }
}

#[test]
pub(crate) fn a_pen_whose_way_up_is_cancelled_is_up() {
    let mut robot = Robot::idle_with(&corexy());
    let [up_mm, _] = heights(robot.config());
    let (place, aside) = ([-10.0, 0.0], [-20.0, 0.0]);
    carry_out(&mut robot, move_to(place, up_mm));
    for order in [Command::Pen { pen: Pen::Up }, move_to(aside, up_mm)] {
        for after_ms in 0..40 {
            carry_out(&mut robot, move_to(place, up_mm));
            carry_out(&mut robot, Command::Pen { pen: Pen::Down });
            assert!(robot.cell().pen_touches);
            robot.send(order);
            robot.run(after_ms);
            robot.send(Command::Cancel);
            settle(&mut robot);
            let what = format!("{order:?}, cancelled after {after_ms} ms");
            assert!(!is_on(&robot) && !robot.cell().pen_touches, "{what}");
        }
    }
    assert_ink_at(&robot, &[place], "lifted");
}

#[test]
pub(crate) fn a_drawing_held_on_the_way_down_has_its_pen_up_and_then_draws_its_whole_line() {
    // With room above a lifted pen, and without.
    for (room_mm, step_ms) in [(4.0, 1), (0.0, 3)] {
        let mut config = solenoid(100, 80);
        let [up_mm, down_mm] = heights(&config);
        config.work_area.z_high_mm = up_mm + room_mm;
        let mut robot = Robot::idle_with(&config);
        let line = [[-30.0, 0.0], [30.0, 0.0]];
        let path = |robot: &mut Robot| {
            let vertex = |[x_mm, y_mm]: [f64; 2], z_mm: f64, pen: Pen| PathVertex {
                position_um: [x_mm, y_mm, z_mm].map(|mm| (mm * 1e3) as i32),
                pen,
                stroke: 0,
            };
            let [from, to] = line;
            robot.draw(vec![
                vertex(from, up_mm, Pen::Up),
                vertex(from, down_mm, Pen::Up),
                vertex(to, down_mm, Pen::Down),
                vertex(to, up_mm, Pen::Up),
            ]);
        };
        // Where the line begins.
        carry_out(&mut robot, move_to(line[0], up_mm));
        for after_ms in (0..320).step_by(step_ms) {
            let what = format!("{room_mm} mm of room, held after {after_ms} ms");
            let since_ms = robot.cell().time_ms;
            path(&mut robot);
            robot.run(after_ms);
            robot.command(Command::Hold).unwrap();
            settle(&mut robot);
            assert!(!is_on(&robot) && !robot.cell().pen_touches, "{what}");
            assert_eq!(robot.mode(), Mode::Holding, "{what}");
            robot.command(Command::Resume).unwrap();
            let (mut was_on, mut changes) = (false, 0);
            while !robot.has_drawn() {
                robot.run(1);
                changes += u32::from(is_on(&robot) != was_on);
                was_on = is_on(&robot);
            }
            assert_eq!(changes, 2, "{what}: the pen goes down once and up once");
            robot.run(PEN_MS);
            assert_ink_on(&robot, since_ms, line, &what);
            carry_out(&mut robot, move_to(line[0], up_mm));
        }
        assert_eq!(robot.fault(), None);
    }
}
