//! The fault matrix with drives in position mode: the cells that differ from those of velocity mode.
//!
//! All cells are measured. A cell that is as in velocity mode within the bounds below, and tells the same but for a
//! measured angle, has no row; the test that measures the whole matrix fails if such a row is there, or if the row of
//! another cell is not.

use super::fault::FAULTS;
use super::situation::{SITUATIONS, Situation};
use super::{DOCUMENT, IsWanted, RENEW, document, measure, written_row};

/// How much a cell may differ from that of velocity mode without a row of its own: times, ms, and the pen, mm.
const TIME_MS: f64 = 20.0;
const PEN_MM: f64 = 1.0;
/// One of so many cells is measured in every test run.
const SAMPLED: usize = 37;
const HEADING: &str = "## The fault matrix in position mode\n";

/// The columns of a row behind the fault: told, noticed after, stands after, pen astray, back by.
fn columns(row: &str) -> [&str; 5] {
    let mut cells = row.trim_matches('|').split('|').map(str::trim).skip(1);
    std::array::from_fn(|_| cells.next().expect("a column"))
}

/// Whether two quantities of a row differ by no more than this; words such as "goes on" have to be equal.
fn is_near(one: &str, other: &str, bound: f64) -> bool {
    let number = |text: &str| text.split(' ').next().and_then(|number| number.parse::<f64>().ok());
    match (number(one), number(other)) {
        (Some(one), Some(other)) => (one - other).abs() <= bound + f64::EPSILON * bound.max(one),
        _ => one == other,
    }
}

/// What is told, without measured angles; numbers of slaves, axes and codes stay.
fn without_angles(told: &str) -> Vec<&str> {
    told.split(' ').filter(|word| !word.contains('.')).collect()
}

/// Whether a cell is in position mode as in velocity mode.
fn is_same(position: &str, velocity: &str) -> bool {
    let [position, velocity] = [position, velocity].map(columns);
    without_angles(position[0]) == without_angles(velocity[0])
        && is_near(position[1], velocity[1], TIME_MS)
        && is_near(position[2], velocity[2], TIME_MS)
        && is_near(position[3], velocity[3], PEN_MM)
        && position[4] == velocity[4]
}

/// The row of a cell that differs from velocity mode: a row of velocity mode's tables behind the situation.
fn differing(situation: &Situation, row: &str) -> String {
    format!("| {} {row}", situation.name)
}

/// The document's row about a cell, if the cell has one.
fn written<'a>(situation: &Situation, fault: &str, text: &'a str) -> Option<&'a str> {
    let begin = format!("| {} | {fault} |", situation.name);
    text[place(text)].lines().find(|line| line.starts_with(&begin))
}

/// The part of the document with the rows.
pub(super) fn place(text: &str) -> std::ops::Range<usize> {
    let heading = text.find(HEADING).expect("the heading");
    let from = heading + text[heading..].find("\n|---|").expect("a table") + 1;
    let from = from + text[from..].find('\n').expect("the head of a table ends") + 1;
    let length = text[from..].find("\n\n").map_or(text.len() - from, |length| length + 1);
    from..from + length
}

/// The rows of all cells in position mode; `None` for cells that are not wanted.
pub(super) fn measured(is_wanted: &IsWanted) -> Vec<Vec<Option<String>>> {
    let of = |situation: &Situation| {
        let situation = situation.in_position_mode();
        let row = |trouble| measure(&situation, trouble).row(trouble);
        let rows = FAULTS
            .iter()
            .map(|trouble| is_wanted(trouble.name).then(|| row(trouble)));
        rows.collect()
    };
    SITUATIONS.iter().map(of).collect()
}

/// The table's rows, from those of all cells in velocity mode and in position mode.
pub(super) fn rows(velocity: &[Vec<String>], position: &[Vec<Option<String>>], text: &str) -> String {
    let mut table = String::new();
    for ((situation, velocity), position) in SITUATIONS.iter().zip(velocity).zip(position) {
        for ((trouble, velocity), position) in FAULTS.iter().zip(velocity).zip(position) {
            let row = match position {
                Some(row) => (!is_same(row, velocity)).then(|| differing(situation, row)),
                None => written(situation, trouble.name, text).map(str::to_owned),
            };
            table.extend(row.into_iter().flat_map(|row| [row, "\n".to_owned()]));
        }
    }
    table
}

#[test]
fn cells_in_position_mode_here_and_there_are_as_in_velocity_mode_or_as_written() {
    let (_, text) = document();
    let cells = SITUATIONS
        .iter()
        .flat_map(|situation| FAULTS.iter().map(move |trouble| (situation, trouble)));
    for (situation, trouble) in cells.step_by(SAMPLED) {
        let row = measure(&situation.in_position_mode(), trouble).row(trouble);
        let expected = (!is_same(&row, written_row(situation, trouble, &text))).then(|| differing(situation, &row));
        assert_eq!(
            written(situation, trouble.name, &text),
            expected.as_deref(),
            "{DOCUMENT}, position mode; {RENEW}=1 cargo test --test reactions -- --ignored matrix renews it"
        );
    }
}

#[test]
fn the_document_names_the_bounds_within_which_cells_are_the_same() {
    let (_, text) = document();
    let bounds = format!("at most {TIME_MS:.0} ms and {PEN_MM:.0} mm apart");
    assert!(text.contains(&bounds), "{DOCUMENT} does not say \"{bounds}\"");
}

#[test]
fn cells_differ_by_words_and_by_more_than_the_bounds() {
    let told = |told: &str| format!("| a fault | {told} | 10 ms | 9 ms | 1.0 mm | home |");
    assert!(is_same(
        &told("axis 2 is off by 0.01 rad"),
        &told("axis 2 is off by 0.02 rad")
    ));
    assert!(!is_same(
        &told("axis 2 is off by 0.01 rad"),
        &told("axis 1 is off by 0.01 rad")
    ));
    let velocity = "| a fault | nothing | 10 ms | goes on | 1.0 mm | nothing to do |";
    for same in [
        velocity,
        "| a fault | nothing | 30 ms | goes on | 1.0 mm | nothing to do |",
        "| a fault | nothing | 10 ms | goes on | 2.0 mm | nothing to do |",
    ] {
        assert!(is_same(same, velocity), "{same}");
    }
    for other in [
        "| a fault | a drive fault | 10 ms | goes on | 1.0 mm | nothing to do |",
        "| a fault | nothing | 31 ms | goes on | 1.0 mm | nothing to do |",
        "| a fault | nothing | no reaction | goes on | 1.0 mm | nothing to do |",
        "| a fault | nothing | 10 ms | 5 ms | 1.0 mm | nothing to do |",
        "| a fault | nothing | 10 ms | goes on | 2.1 mm | nothing to do |",
        "| a fault | nothing | 10 ms | goes on | 1.0 mm | home |",
    ] {
        assert!(!is_same(other, velocity), "{other}");
    }
}
