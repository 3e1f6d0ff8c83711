//! The fault matrix of `docs/faults.md`: each fault in each operating mode, at a low and at full speed.
//!
//! A cell of the matrix is a robot that is brought into the mode, gets the fault, is watched for 4 s, and is brought back
//! when the fault has ended. The virtual cell's motors tell when everything stands and how far the pen is astray. The
//! firmware's report tells what the operator reads.
//!
//! "Noticed after" ends with the first of two events: the firmware reports a new fault, a hold or the end of a search, or a drive that the
//! fault does not hit begins to brake or loses power, by the controller's command or by its own watchdog. The state of
//! the drive that the fault hits is the fault itself and does not count. A report counts when it leaves the board, so
//! that the operator's unplugged cable does not delay it. While the robot stops, every drive brakes anyway; then a drive
//! counts only when it goes into fault.
//!
//! All cells are measured with drives in velocity mode and in position mode; `position.rs` compares the two.

mod fault;
mod position;
mod situation;

use crate::STILL_RAD_S;
use crate::again::with_clocks;
use crate::robot::Robot;
use etherpen::application::{Fault, Mode, Refusal};
use etherpen::messages::Command;
use etherpen::robots::Position;
use fault::{FAULTS, Machine, Trouble};
use host_tools::cell::DriveState;
use host_tools::link::text;
use situation::{SITUATIONS, Situation};
use std::path::PathBuf;

/// How long a robot is watched after the beginning of a fault, ms: the slowest reaction at the low speed, and a stop.
const WATCHED_MS: u32 = 4_000;
/// Longest time for one step back, ms.
const STEP_MAX_MS: u32 = 20_000;
/// Most steps back.
const STEPS_MAX: usize = 12;
/// Distance of the move that shows that the robot is back, and how near to its target it has to come, mm.
const PROOF_MM: f64 = 10.0;
const PROOF_TOLERANCE_MM: f64 = 0.2;
/// One of so many cells is measured in every test run.
const SAMPLED: usize = 11;
const SAMPLED_WITH_CLOCKS: usize = 3;
/// Beginnings of the names of faults that hit several slaves in the same millisecond.
const SEVERAL: [&str; 3] = ["no outputs", "no frames", "50 frames damaged"];
/// Columns of a row.
const TOLD: usize = 2;
const NOTICED: usize = 3;
const STANDS: usize = 4;
const ASTRAY: usize = 5;
const STEPS: usize = 6;
/// How much later the same may come with distributed clocks, ms: what is read between two cycles is read in other ones.
const LATER_MS: f64 = 100.0;
/// How much further the pen may go, mm.
const FURTHER_MM: f64 = 0.2;
const DOCUMENT: &str = "docs/faults.md";
const HEADING: &str = "## The fault matrix";
/// Set to write the tables instead of comparing with them: 1 for all rows, or parts of the names of the rows to measure,
/// with | between them.
const RENEW: &str = "ETHERPEN_RENEW_FAULTS";

/// What a fault has led to.
#[derive(Debug, Default)]
struct Outcome {
    told: Option<String>,
    noticed_ms: Option<u32>,
    stands_ms: Option<u32>,
    astray_mm: f64,
    steps: Vec<&'static str>,
    is_lost: bool,
}

impl Outcome {
    fn row(&self, trouble: &Trouble) -> String {
        let ms = |ms: Option<u32>, none: &str| ms.map_or_else(|| none.to_owned(), |ms| format!("{ms} ms"));
        let told = self.told.as_deref().unwrap_or("nothing");
        let steps = match (self.is_lost, self.steps.is_empty()) {
            (true, _) => "the position is wrong until homed".to_owned(),
            (false, true) => "nothing to do".to_owned(),
            (false, false) => self.steps.join(", "),
        };
        format!(
            "| {} | {told} | {} | {} | {:.1} mm | {steps} |",
            trouble.name,
            ms(self.noticed_ms, "no reaction"),
            ms(self.stands_ms, "goes on"),
            self.astray_mm,
        )
    }
}

fn drives(robot: &Robot) -> Vec<DriveState> {
    robot.cell().slaves.iter().map(|slave| slave.drive).collect()
}

/// The robot before the fault.
struct Before {
    mode: Mode,
    fault: Option<Fault>,
    drives: Vec<DriveState>,
}

impl Before {
    fn of(robot: &Robot, situation: &Situation) -> Self {
        Self {
            mode: situation.mode,
            fault: situation.latched().or_else(|| robot.fault()),
            drives: drives(robot),
        }
    }

    /// Whether this is another fault than the one that was latched before.
    fn is_new(&self, fault: Option<Fault>) -> bool {
        fault.is_some() && fault != self.fault
    }

    /// Whether the board has reported a new fault, a hold, or the end of a search.
    fn has_reported(&self, robot: &Robot) -> bool {
        robot.reported.as_ref().is_some_and(|status| {
            let holds = status.mode == Mode::Holding && self.mode != Mode::Holding;
            let ends = status.mode != Mode::Homing && self.mode == Mode::Homing;
            holds || ends || self.is_new(status.fault)
        })
    }

    /// Whether a drive that the fault does not hit brakes or has lost power.
    fn has_braked(&self, robot: &Robot, trouble: &Trouble) -> bool {
        let is_faulty = |drive: DriveState| matches!(drive, DriveState::FaultReactionActive | DriveState::Fault);
        let mut others = (1..)
            .zip(self.drives.iter().copied().zip(drives(robot)))
            .filter(|(number, _)| !trouble.hits.contains(number));
        others.any(|(_, (before, now))| match self.mode {
            // Every drive brakes and loses power because of the stop.
            Mode::Stopping => is_faulty(now) && !is_faulty(before),
            _ => before == DriveState::OperationEnabled && now != before,
        })
    }
}

fn measure(situation: &Situation, trouble: &Trouble) -> Outcome {
    let (mut robot, track) = situation.reach(trouble.machine);
    let before = Before::of(&robot, situation);
    let was_referenced = robot.status.as_ref().is_some_and(|status| status.referenced);
    let mut outcome = Outcome::default();
    let mut moved_ms = 0;
    (trouble.begin)(&mut robot);
    for ms in 1..=WATCHED_MS {
        robot.run(1);
        if ms == trouble.lasts_ms {
            (trouble.end)(&mut robot);
        }
        if robot.speed_rad_s() > STILL_RAD_S {
            moved_ms = ms;
        }
        if before.has_reported(&robot) || before.has_braked(&robot, trouble) {
            outcome.noticed_ms.get_or_insert(ms);
        }
        if let Some(platform) = robot.cell().platform {
            outcome.astray_mm = outcome.astray_mm.max(track.distance_mm(platform));
        }
    }
    let goes_on = matches!(situation.mode, Mode::Moving | Mode::Drawing | Mode::Homing);
    let is_ordered_to_go_on = goes_on && outcome.noticed_ms.is_none();
    if is_ordered_to_go_on && situation.mode == Mode::Homing {
        assert_eq!(
            moved_ms, WATCHED_MS,
            "{situation:?}, {}: the search goes on",
            trouble.name
        );
    }
    outcome.stands_ms = (moved_ms < WATCHED_MS && !is_ordered_to_go_on).then_some(moved_ms);
    outcome.told = robot.fault().filter(|fault| before.is_new(Some(*fault))).map(|fault| {
        let text = text::fault(&fault);
        text.split([';', ':', '(']).next().unwrap_or_default().trim().to_owned()
    });
    // A search comes to its switch after what is watched.
    assert_eq!(robot.cell().end_stop_ms, 0, "{situation:?}, {}", trouble.name);
    outcome.steps = bring_back(&mut robot, situation, trouble.machine, was_referenced);
    outcome.is_lost = !comes_to_its_target(&mut robot);
    if outcome.is_lost {
        home(&mut robot);
        assert!(comes_to_its_target(&mut robot), "{situation:?}, {}", trouble.name);
    }
    outcome
}

/// Brings the robot to rest with power; returns what the situation would not have needed without the fault.
fn bring_back(robot: &mut Robot, situation: &Situation, machine: Machine, was_referenced: bool) -> Vec<&'static str> {
    let mut steps = Vec::new();
    for _ in 0..STEPS_MAX {
        let referenced = robot.status.as_ref().is_some_and(|status| status.referenced);
        let step = match robot.mode() {
            Mode::Idle if referenced => return steps,
            Mode::Startup => {
                robot.configure(&situation.config(machine));
                (situation.mode != Mode::Startup).then_some("configure")
            }
            // The bus was started while the cables were exchanged.
            Mode::Fault if !steps.is_empty() && told_to_reset(robot) => {
                robot.reset_board();
                Some("reset the board")
            }
            Mode::Fault => {
                insist(robot, Command::Acknowledge);
                robot.run(20);
                let is_over = |robot: &Robot| !robot.status.as_ref().is_some_and(|status| status.recovering);
                robot.run_until("the repair ends", is_over);
                (situation.mode != Mode::Fault || !steps.is_empty()).then_some("acknowledge")
            }
            Mode::Holding => {
                insist(robot, Command::Resume);
                robot.run(500);
                (situation.mode != Mode::Holding).then_some("resume")
            }
            Mode::DrivesOff | Mode::Unreferenced | Mode::Idle if !referenced && can_home(robot) => {
                home(robot);
                (was_referenced || situation.mode == Mode::Homing).then_some("home")
            }
            Mode::DrivesOff => {
                insist(robot, Command::Enable);
                robot.run(20);
                let has_ended = |robot: &Robot| matches!(robot.mode(), Mode::Unreferenced | Mode::Idle | Mode::Fault);
                robot.run_until("the enabling ends", has_ended);
                situation.has_power().then_some("enable")
            }
            _ => {
                let is_busy = |mode| {
                    matches!(
                        mode,
                        Mode::Moving | Mode::Drawing | Mode::Homing | Mode::Stopping | Mode::BusConfiguring
                    )
                };
                robot.run(20);
                robot.run_until("the motion ends", |robot| !is_busy(robot.mode()));
                None
            }
        };
        steps.extend(step);
    }
    panic!("{situation:?}: {steps:?}, {:?}", robot.status);
}

/// Whether a reset of the board is a way to go on, as the operator reads it.
fn told_to_reset(robot: &Robot) -> bool {
    robot
        .fault()
        .is_some_and(|fault| text::fault(&fault).contains("reset the board"))
}

/// Gives a command again as long as the robot is not ready for it.
fn insist(robot: &mut Robot, command: Command) {
    for _ in 0..STEP_MAX_MS / 100 {
        match robot.command(command) {
            Ok(()) | Err(Refusal::NotInMode(_)) => return,
            Err(_) => robot.run(100),
        }
    }
    panic!("{command:?} is refused for ever: {:?}", robot.status);
}

/// A search for switches needs power.
fn can_home(robot: &Robot) -> bool {
    !robot.config().has_home_switches() || robot.mode() != Mode::DrivesOff
}

fn home(robot: &mut Robot) {
    if robot.config().has_home_switches() {
        insist(robot, Command::Home);
        robot.run(20);
        return robot.run_until("the search ends", |robot| robot.mode() != Mode::Homing);
    }
    let pose = robot.cell().joints;
    insist(robot, Command::HomeAt { pose, position: None });
    robot.run(100);
}

/// Whether the platform comes to where it is sent.
fn comes_to_its_target(robot: &mut Robot) -> bool {
    let Some(from) = robot.cell().platform else {
        return false;
    };
    let centre = robot.config().paper.centre_mm;
    // The default robot stands low in its work area, and the homed gantry high.
    let upwards = if robot.config().has_home_switches() { -1.0 } else { 1.0 };
    let position = Position {
        x_mm: 0.5 * (from.x_mm + centre[0]),
        y_mm: 0.5 * (from.y_mm + centre[1]),
        z_mm: from.z_mm + upwards * PROOF_MM,
    };
    robot.command(Command::Move { position }).expect("a way to the middle");
    robot.run(20);
    robot.wait_for(Mode::Idle);
    robot.run(200);
    let at = robot.cell().platform.expect("the robot holds a platform");
    let off = [
        at.x_mm - position.x_mm,
        at.y_mm - position.y_mm,
        at.z_mm - position.z_mm,
    ];
    off.iter().map(|mm| mm * mm).sum::<f64>().sqrt() < PROOF_TOLERANCE_MM
}

/// The table below a situation's heading, with these rows.
fn table(situation: &Situation, rows: &[String]) -> String {
    format!(
        "### {}\n\n| fault | told | noticed after | stands after | pen astray | back by |\n|---|---|---|---|---|---|\n{}\n",
        situation.name,
        rows.join("\n")
    )
}

/// The document's row about a fault in a situation, in velocity mode.
fn written_row<'a>(situation: &Situation, trouble: &Trouble, text: &'a str) -> &'a str {
    let begin = format!("| {} |", trouble.name);
    written(situation, text)
        .lines()
        .find(|line| line.starts_with(&begin))
        .unwrap_or_else(|| panic!("{DOCUMENT}, {}, has no row {}", situation.name, trouble.name))
}

/// The part of the document about a situation.
fn written<'a>(situation: &Situation, text: &'a str) -> &'a str {
    let heading = format!("### {}\n", situation.name);
    let from = text.find(&heading).unwrap_or_else(|| panic!("{heading}"));
    let part = &text[from + heading.len()..];
    &part[..part.find("\n##").unwrap_or(part.len())]
}

fn document() -> (PathBuf, String) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(DOCUMENT);
    let text = std::fs::read_to_string(&path).expect("the document");
    (path, text)
}

/// The part of the document with the tables.
fn tables(text: &str) -> std::ops::Range<usize> {
    let heading = text.find(HEADING).expect("the heading");
    let from = heading + text[heading..].find("\n### ").expect("the first table") + 1;
    let length = text[from..]
        .find("\n## ")
        .map_or(text.len() - from, |length| length + 1);
    from..from + length
}

#[test]
fn cells_of_the_fault_matrix_here_and_there_are_as_written() {
    let (_, text) = document();
    let cells = SITUATIONS
        .iter()
        .flat_map(|situation| FAULTS.iter().map(move |trouble| (situation, trouble)));
    for (situation, trouble) in cells.step_by(SAMPLED) {
        let row = measure(situation, trouble).row(trouble);
        assert!(
            written(situation, &text).contains(&row),
            "{DOCUMENT}, {}, has no row\n{row}\n{RENEW}=1 cargo test --test reactions -- --ignored matrix renews it",
            situation.name
        );
    }
}

/// Other cells, with distributed clocks: what is told and done must be as without, and the pen goes no further. Where several
/// slaves fail together, another one may be named first. While the bus is configured a fault comes at another step.
fn cells_with_clocks() {
    let (_, text) = document();
    let situations = SITUATIONS.iter();
    let cells = situations
        .filter(|situation| situation.mode != Mode::BusConfiguring)
        .flat_map(|situation| FAULTS.iter().map(move |trouble| (situation, trouble)));
    let mut different = Vec::new();
    for (situation, trouble) in cells.skip(1).step_by(SAMPLED_WITH_CLOCKS) {
        let with = measure(situation, trouble).row(trouble);
        let without = written_row(situation, trouble, &text);
        let columns = |row: &str| -> Vec<String> { row.split('|').map(|column| column.trim().to_owned()).collect() };
        let (found, written) = (columns(&with), columns(without));
        let number = |columns: &[String], at: usize| -> Option<f64> { columns[at].split(' ').next()?.parse().ok() };
        let later = |at: usize, most: f64| match (number(&found, at), number(&written, at)) {
            (Some(found), Some(written)) => found > written + most,
            (found, written) => found != written,
        };
        let told = |columns: &[String]| match SEVERAL.iter().any(|several| trouble.name.starts_with(several)) {
            true => columns[TOLD].replace(|letter: char| letter.is_ascii_digit(), ""),
            false => columns[TOLD].clone(),
        };
        let is_same = told(&found) == told(&written) && found[STEPS] == written[STEPS];
        if !is_same || later(NOTICED, LATER_MS) || later(STANDS, LATER_MS) || later(ASTRAY, FURTHER_MM) {
            different.push(format!("{}:\n{with}\n{without}", situation.name));
        }
    }
    assert!(different.is_empty(), "{}", different.join("\n"));
}

#[test]
fn cells_of_the_fault_matrix_with_clocks_are_as_those_without() {
    with_clocks(cells_with_clocks);
}

/// Which rows are measured, by their names.
type IsWanted<'a> = dyn Fn(&str) -> bool + Sync + 'a;

/// The tables, in velocity mode; a row that is not wanted is that of the document.
fn in_velocity_mode(text: &str, is_wanted: &IsWanted) -> Vec<Vec<String>> {
    let row = |situation: &Situation, trouble: &Trouble| match is_wanted(trouble.name) {
        true => measure(situation, trouble).row(trouble),
        false => written_row(situation, trouble, text).to_owned(),
    };
    let rows = |situation| FAULTS.iter().map(|trouble| row(situation, trouble)).collect();
    SITUATIONS.iter().map(rows).collect()
}

#[test]
#[ignore = "takes minutes; part of cargo verify --nightly"]
fn the_whole_fault_matrix_is_as_written() {
    let (path, text) = document();
    let renewed_rows = std::env::var(RENEW).ok();
    let part = renewed_rows.as_deref().filter(|part| *part != "1").unwrap_or("");
    let is_wanted = |name: &str| part.split('|').any(|part| name.contains(part));
    let (velocity, outcomes) = std::thread::scope(|scope| {
        let position = scope.spawn(|| position::measured(&is_wanted));
        (in_velocity_mode(&text, &is_wanted), position.join().expect("a matrix"))
    });
    let measured: Vec<String> = SITUATIONS
        .iter()
        .zip(&velocity)
        .map(|(situation, rows)| table(situation, rows))
        .collect();
    let measured = format!("{}\n", measured.join("\n"));
    let differing = position::rows(&velocity, &outcomes, &text);
    let (range, place) = (tables(&text), position::place(&text));
    assert!(range.end <= place.start, "the table of position mode is the last one");
    if renewed_rows.is_some() {
        let parts = [
            &text[..range.start],
            &measured,
            &text[range.end..place.start],
            &differing,
            &text[place.end..],
        ];
        std::fs::write(&path, parts.concat()).expect("the document can be written");
    } else {
        assert_eq!(text[range].trim_end(), measured.trim_end(), "{RENEW}=1 renews it");
        assert_eq!(text[place], differing, "{RENEW}=1 renews it");
    }
}
