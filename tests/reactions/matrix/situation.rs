//! The tables of the matrix: operating modes and speeds, and how a robot is brought there.

use super::fault::{CLOSED, Machine, OUTPUT_TERMINAL, STOP_TERMINAL};
use crate::STILL_RAD_S;
use crate::feedback::{in_mode, with_mode};
use crate::robot::Robot;
use etherpen::application::{Fault, Mode, StopSource};
use etherpen::config::{AxisMode, Config, IoDirection, IoPoint, IoRole};
use etherpen::messages::{Command, PathVertex};
use etherpen::motion::Pen;
use etherpen::robots::{AXES, Position};
use host_tools::cell::{CellOptions, PlaceOptions, parse_slaves};
use host_tools::settings::machines::MACHINES;

/// Alias of the first drive, where the drives have one.
const FIRST_ALIAS: u16 = 31;
/// The line of all motions: from here to its opposite, mm.
const FROM_MM: [f64; 2] = [-60.0, -75.0];
/// Heights of the pen on and above the paper, mm.
const DOWN_MM: f64 = -850.0;
const UP_MM: f64 = -847.0;
/// Part of the line after which the fault begins, at the low and at full speed: there the speed is reached.
const BEGUN_PART: f64 = 0.02;
const HALF_WAY_PART: f64 = 0.45;
/// Speeds along the line, mm/s.
pub(super) const LOW_MM_S: f64 = 20.0;
pub(super) const FULL_MM_S: f64 = 1_000.0;
/// Time from STOP to the fault at the low and at full speed, ms. A motor still moves then: while drawing, the robot stands
/// 9 ms after STOP at 20 mm/s and 36 ms after STOP at 1,000 mm/s (`docs/faults.md`, the rows STOP).
const BRAKING_LOW_MS: u32 = 1;
const BRAKING_FULL_MS: u32 = 6;
/// Time from HOLD to the fault, ms. A motor still moves then.
const HOLDING_MS: u32 = 60;

/// The gantry's terminal with the home switches, from 1, behind its drives and a coupler.
const SWITCHES: u8 = 5;
/// The gantry's second axis searches for its switch in this direction, from here, mm.
const SEARCH_FROM: Position = Position {
    x_mm: 300.0,
    y_mm: 465.0,
    z_mm: -5.0,
};
const SEARCH_TO_Y_MM: f64 = 0.0;
/// Way of the search after which the fault begins, mm.
const SEARCHED_MM: f64 = 10.0;
/// Speed of the search at full speed, mm/s: the switch is not reached while the robot is watched.
const SEARCH_FULL_MM_S: f64 = 100.0;
const MM_PER_RAD: f64 = 100.0;

/// An operating mode, and the speed of the pen in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Situation {
    pub(super) name: &'static str,
    pub(super) mode: Mode,
    speed_mm_s: f64,
    /// Mode of all drives.
    drives: AxisMode,
}

const fn at(name: &'static str, mode: Mode, speed_mm_s: f64) -> Situation {
    Situation {
        name,
        mode,
        speed_mm_s,
        drives: AxisMode::Velocity,
    }
}

/// The tables.
pub(super) static SITUATIONS: [Situation; 16] = [
    at("Startup", Mode::Startup, 0.0),
    at("Bus configuring", Mode::BusConfiguring, 0.0),
    at("Drives off", Mode::DrivesOff, 0.0),
    at("Unreferenced, with power", Mode::Unreferenced, 0.0),
    at("Idle", Mode::Idle, 0.0),
    at("Moving at 20 mm/s", Mode::Moving, LOW_MM_S),
    at("Moving at 1,000 mm/s", Mode::Moving, FULL_MM_S),
    at("Drawing at 20 mm/s", Mode::Drawing, LOW_MM_S),
    at("Drawing at 1,000 mm/s", Mode::Drawing, FULL_MM_S),
    at("Holding, from 20 mm/s", Mode::Holding, LOW_MM_S),
    at("Holding, from 1,000 mm/s", Mode::Holding, FULL_MM_S),
    at("Stopping, from 20 mm/s", Mode::Stopping, LOW_MM_S),
    at("Stopping, from 1,000 mm/s", Mode::Stopping, FULL_MM_S),
    at("Fault", Mode::Fault, 0.0),
    at("Homing at 20 mm/s", Mode::Homing, LOW_MM_S),
    at("Homing at 100 mm/s", Mode::Homing, SEARCH_FULL_MM_S),
];

/// The line that the pen was ordered to follow; a point where nothing moves.
pub(super) struct Track {
    from: Position,
    to: Position,
    /// Whether the pen may be lifted above it.
    draws: bool,
}

impl Track {
    /// Distance of a position from the line, mm.
    pub(super) fn distance_mm(&self, at: Position) -> f64 {
        let way = [self.to.x_mm - self.from.x_mm, self.to.y_mm - self.from.y_mm];
        let off = [at.x_mm - self.from.x_mm, at.y_mm - self.from.y_mm];
        let length_squared: f64 = way.iter().map(|mm| mm * mm).sum();
        let along: f64 = off.iter().zip(way).map(|(a, b)| a * b).sum();
        let part = (along / length_squared.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let beside: f64 = off.iter().zip(way).map(|(a, b)| (a - part * b).powi(2)).sum();
        let mut above = at.z_mm - self.from.z_mm;
        if self.draws {
            above -= above.clamp(0.0, UP_MM - DOWN_MM);
        }
        (beside + above * above).sqrt()
    }

    /// How much of the line is done.
    fn part(&self, at: Position) -> f64 {
        let length = |mm: [f64; 2]| mm[0].hypot(mm[1]);
        let whole = length([self.to.x_mm - self.from.x_mm, self.to.y_mm - self.from.y_mm]);
        length([at.x_mm - self.from.x_mm, at.y_mm - self.from.y_mm]) / whole
    }
}

fn position(z_mm: f64, side: f64) -> Position {
    Position {
        x_mm: side * FROM_MM[0],
        y_mm: side * FROM_MM[1],
        z_mm,
    }
}

/// A stroke along the line.
fn stroke() -> Vec<PathVertex> {
    let vertex = |side: f64, z_mm: f64, pen: Pen| {
        let at = position(z_mm, side);
        PathVertex {
            position_um: [at.x_mm, at.y_mm, at.z_mm].map(|mm| (mm * 1e3).round() as i32),
            pen,
            stroke: 0,
        }
    };
    vec![
        vertex(1.0, UP_MM, Pen::Up),
        vertex(1.0, DOWN_MM, Pen::Up),
        vertex(-1.0, DOWN_MM, Pen::Down),
        vertex(-1.0, UP_MM, Pen::Up),
    ]
}

/// A gantry whose second axis searches after the height, alone, at this speed; its drives are the first slaves.
fn gantry(drives: AxisMode, speed_mm_s: f64) -> Config {
    let mut config = with_mode(MACHINES[1].load().expect("the gantry"), drives);
    for point in &mut config.io {
        point.slave = SWITCHES - 1;
    }
    config.axes[0].home.order = 3;
    config.axes[1].home.speed_rad_s = -speed_mm_s / MM_PER_RAD;
    config
}

impl Situation {
    /// This situation of a robot whose drives are in position mode.
    pub(super) fn in_position_mode(self) -> Self {
        Self {
            drives: AxisMode::Position,
            ..self
        }
    }

    /// The cell of such a robot.
    fn cell(&self, machine: Machine) -> CellOptions {
        let mut options = CellOptions::default();
        let drive = match self.drives {
            AxisMode::Position => "cia402",
            AxisMode::Velocity | AxisMode::Torque => "ax2000",
        };
        let usual = match self.mode {
            Mode::Homing => format!("{drive}*3,ek1100,el1008"),
            _ => format!("{drive}*4,ek1100"),
        };
        let chain = |chain: &str| parse_slaves(chain).expect("a chain");
        if self.mode == Mode::Homing {
            options.slaves = chain(&usual);
        }
        match machine {
            Machine::Usual => {}
            Machine::Aliases => {
                let place = |alias| PlaceOptions {
                    alias,
                    serial: Some(0),
                    ..PlaceOptions::default()
                };
                options.places = (FIRST_ALIAS..).take(self.axes()).map(place).collect();
            }
            Machine::Terminals => options.slaves = chain(&format!("{usual},el1008,el2004")),
        }
        options
    }

    /// Number of axes.
    fn axes(&self) -> usize {
        match self.mode {
            Mode::Homing => AXES - 1,
            _ => AXES,
        }
    }

    /// The configuration, in which the line is driven at the situation's speed.
    pub(super) fn config(&self, machine: Machine) -> Config {
        let mut config = match self.mode {
            Mode::Homing => gantry(self.drives, self.speed_mm_s),
            _ => in_mode(self.drives),
        };
        match machine {
            Machine::Usual => {}
            Machine::Aliases => {
                for (alias, axis) in (FIRST_ALIAS..).zip(&mut config.axes[..self.axes()]) {
                    axis.alias = alias;
                }
            }
            Machine::Terminals => {
                let point = |name: &str, slave: usize, direction, role| IoPoint {
                    name: name.try_into().expect("a name"),
                    slave: slave as u8 - 1,
                    direction,
                    bit: Some(0),
                    role,
                    ..IoPoint::default()
                };
                config.io.extend([
                    point("stop", STOP_TERMINAL, IoDirection::In, IoRole::EmergencyStop),
                    point("valve", OUTPUT_TERMINAL, IoDirection::Out, IoRole::None),
                ]);
            }
        }
        if self.travels() && self.mode != Mode::Homing {
            config.motion.speed_mm_s = self.speed_mm_s;
            config.motion.travel_speed_mm_s = self.speed_mm_s;
        }
        config
    }

    /// Whether the pen is on a line.
    pub(super) fn travels(&self) -> bool {
        self.speed_mm_s > 0.0
    }

    /// Whether the speed is the full one.
    fn is_fast(&self) -> bool {
        self.speed_mm_s > LOW_MM_S
    }

    /// The fault that the situation itself latches, although its report may not have arrived yet.
    pub(super) fn latched(&self) -> Option<Fault> {
        matches!(self.mode, Mode::Stopping | Mode::Fault).then_some(Fault::EmergencyStop(StopSource::Link))
    }

    /// Whether the drives had power.
    pub(super) fn has_power(&self) -> bool {
        self.travels() || matches!(self.mode, Mode::Unreferenced | Mode::Idle)
    }

    /// Brings a robot there.
    pub(super) fn reach(&self, machine: Machine) -> (Robot, Track) {
        let config = self.config(machine);
        let mut robot = Robot::of(&config, self.cell(machine));
        if machine == Machine::Terminals {
            robot.set_inputs(STOP_TERMINAL, CLOSED);
        }
        match self.mode {
            Mode::Startup => robot.run(300),
            Mode::BusConfiguring => {
                robot.run(100);
                robot.configure(&config);
                robot.run(60);
                assert_eq!(robot.mode(), Mode::BusConfiguring, "too late");
            }
            Mode::DrivesOff => {
                robot = robot.enabled();
                robot.command(Command::Disable).expect("a robot at rest");
                robot.wait_for(Mode::DrivesOff);
            }
            Mode::Unreferenced => {
                robot.configure(&config);
                robot.wait_for(Mode::DrivesOff);
                robot.command(Command::Enable).expect("drives");
                robot.wait_for(Mode::Unreferenced);
            }
            Mode::Idle => robot = robot.enabled(),
            Mode::Fault => {
                robot = robot.enabled();
                robot.command(Command::Stop).expect("a stop");
                robot.wait_for(Mode::Fault);
            }
            Mode::Homing => return search(robot),
            _ => return self.travel(robot.enabled()),
        }
        robot.run(100);
        let here = robot.cell().platform.expect("the robot holds a platform");
        let track = Track {
            from: here,
            to: here,
            draws: false,
        };
        (robot, track)
    }

    /// Brings a robot onto the line, at speed.
    fn travel(&self, mut robot: Robot) -> (Robot, Track) {
        let draws = self.mode != Mode::Moving;
        robot
            .command(Command::Move {
                position: position(UP_MM, 1.0),
            })
            .expect("the beginning of the line");
        robot.run(20);
        robot.wait_for(Mode::Idle);
        robot.run(100);
        let z_mm = if draws { DOWN_MM } else { UP_MM };
        let track = Track {
            from: position(z_mm, 1.0),
            to: position(z_mm, -1.0),
            draws,
        };
        if draws {
            robot.draw(stroke());
        } else {
            let position = track.to;
            robot.command(Command::Move { position }).expect("the end of the line");
        }
        let (part, braking_ms) = if self.is_fast() {
            (HALF_WAY_PART, BRAKING_FULL_MS)
        } else {
            (BEGUN_PART, BRAKING_LOW_MS)
        };
        robot.run_until("the line is begun", |robot| {
            robot.cell().platform.is_some_and(|at| track.part(at) > part)
        });
        match self.mode {
            Mode::Holding => {
                robot.say(Command::Hold);
                robot.run(HOLDING_MS);
            }
            Mode::Stopping => {
                robot.say(Command::Stop);
                robot.run(braking_ms);
            }
            _ => {}
        }
        assert!(
            robot.speed_rad_s() > STILL_RAD_S,
            "{}: every motor stands before the fault begins",
            self.name
        );
        (robot, track)
    }
}

/// Brings a gantry that has been homed into the search of its second axis, at speed.
fn search(mut robot: Robot) -> (Robot, Track) {
    let config = robot.config().clone();
    robot.configure(&config);
    robot.wait_for(Mode::DrivesOff);
    robot.command(Command::Enable).expect("drives");
    robot.wait_for(Mode::Unreferenced);
    robot.command(Command::Home).expect("switches");
    robot.run_until("homed", |robot| robot.mode() == Mode::Idle);
    let position = SEARCH_FROM;
    robot
        .command(Command::Move { position })
        .expect("a way from the switches");
    robot.run(20);
    robot.wait_for(Mode::Idle);
    robot.run(100);
    robot.command(Command::Home).expect("switches");
    let place = |robot: &Robot| robot.cell().platform.expect("a gantry's tool");
    robot.run_until("the second axis searches", |robot| {
        place(robot).y_mm < SEARCH_FROM.y_mm - SEARCHED_MM
    });
    let from = place(&robot);
    let track = Track {
        from,
        to: Position {
            y_mm: SEARCH_TO_Y_MM,
            ..from
        },
        draws: false,
    };
    (robot, track)
}
