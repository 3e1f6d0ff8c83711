//! The document on the mutants: its first lines tell how many wait; once none does, enough are found. Every survivor
//! has its reason.

use etherpen_mutants::report::{Reason, Score, reasons};
use std::collections::BTreeSet;

const DOCUMENT: &str = include_str!("../../../docs/mutants.md");
const REASONS: &str = include_str!("../reasons.toml");
/// Number of mutants.
const MUTANTS: u32 = 100;

/// Rows of the table below a heading, in columns; none if there is no such heading.
fn rows(title: &str) -> Vec<Vec<String>> {
    let Some((_, text)) = DOCUMENT.split_once(&format!("\n## {title}\n")) else {
        return Vec::new();
    };
    let (text, _) = text.split_once("\n## ").unwrap_or((text, ""));
    let rows = text
        .lines()
        .filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"));
    let columns = |row: &str| {
        let row = row.replace("\\|", "\0");
        row.split(" | ").map(|text| text.replace('\0', "|")).collect()
    };
    rows.skip(1).map(columns).collect()
}

/// The reason for a row's mutant.
fn reason_of<'a>(row: &[String], reasons: &'a [Reason]) -> Option<&'a Reason> {
    let [_, place, _, change, _] = row else {
        panic!("{row:?}");
    };
    let is_it = |reason: &&Reason| {
        *place == format!("`{}`: `{}`", reason.file, reason.function) && *change == reason.numbered_change()
    };
    reasons.iter().find(is_it)
}

/// Numbers of the row below the table's heading: mutants, found, by tests, by campaigns, missed, equivalent, waiting.
fn counts() -> Vec<usize> {
    let heading =
        "| seed | mutants | found | by tests | by campaigns | missed | equivalent | not judged to the end |\n";
    let (_, text) = DOCUMENT.split_once(heading).expect("the table of counts");
    let row = text.lines().nth(1).expect("a row");
    let numbers = row.trim_matches(['|', ' ']).split(" | ").skip(1);
    numbers.map(|number| number.parse().expect("a number")).collect()
}

#[test]
fn every_mutant_is_listed_once_and_enough_are_found_unless_the_first_lines_say_not_finished() {
    let [found, survivors, waiting] = ["Found", "Survivors", "Not judged to the end"].map(rows);
    let all = || found.iter().chain(&survivors).chain(&waiting);
    let numbers: BTreeSet<u32> = all().map(|row| row[0].parse().expect("a number")).collect();
    assert_eq!(numbers, (1..=MUTANTS).collect());
    assert_eq!(all().count(), MUTANTS as usize);
    let reasons = reasons(REASONS).expect("the reasons");
    let is_equivalent = |row: &&Vec<String>| reason_of(row, &reasons).is_some_and(|reason| reason.equivalent);
    let equivalent = survivors.iter().filter(is_equivalent).count();
    let score = Score {
        found: found.len(),
        missed: survivors.len() - equivalent,
        equivalent,
        waiting: waiting.len(),
    };
    let by_campaigns = found.iter().filter(|row| row[4].starts_with("campaign")).count();
    let expected = [
        MUTANTS as usize,
        score.found,
        score.found - by_campaigns,
        by_campaigns,
        score.missed,
        score.equivalent,
        score.waiting,
    ];
    assert_eq!(counts(), expected);
    // The sentence begins with "Not finished" while a mutant waits.
    assert!(
        DOCUMENT.starts_with(&format!("# Mutants\n\n{score}\n")),
        "expected: {score}"
    );
    assert_eq!(DOCUMENT.contains("Not finished"), score.waiting > 0);
    assert!(score.waiting > 0 || score.is_enough(), "{score}");
}

#[test]
fn every_survivor_has_a_reason_and_no_reason_is_given_in_vain() {
    let reasons = reasons(REASONS).expect("the reasons");
    for row in rows("Survivors") {
        let reason = reason_of(&row, &reasons).unwrap_or_else(|| panic!("no reason for {row:?}"));
        assert!(row[4].ends_with(reason.reason.trim()), "another reason: {row:?}");
        assert!(reason.reason.split_whitespace().count() >= 5, "{}", reason.reason);
    }
    let found = rows("Found");
    for reason in &reasons {
        let is_found = found
            .iter()
            .any(|row| reason_of(row, std::slice::from_ref(reason)).is_some());
        assert!(!is_found, "the mutant is found: {reason:?}");
    }
}
