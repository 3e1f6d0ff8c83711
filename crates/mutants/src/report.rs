//! The document with all mutants: found by what, or why they survive.

use crate::parts::PARTS;
use crate::results::{Mutant, Outcome, Results};
use serde::Deserialize;
use std::fmt::Write;

/// Part of the mutants that has to be found, percent.
pub const FOUND_MIN_PERCENT: usize = 95;

/// Why a mutant survives.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reason {
    /// File, from the root of the sources.
    pub file: String,
    /// Type and function.
    pub function: String,
    /// The change in words.
    pub change: String,
    /// Why neither the tests nor the campaign find it.
    pub reason: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Reasons {
    #[serde(default)]
    survivor: Vec<Reason>,
}

/// Reads the file of reasons.
///
/// # Errors
/// What is wrong in the file.
pub fn reasons(text: &str) -> Result<Vec<Reason>, String> {
    let reasons: Reasons = toml::from_str(text).map_err(|error| error.to_string())?;
    Ok(reasons.survivor)
}

/// The reason why a mutant survives.
#[must_use]
pub fn reason_of<'a>(mutant: &Mutant, reasons: &'a [Reason]) -> Option<&'a str> {
    let place = (&mutant.file, &mutant.function, &mutant.change);
    let of = |reason: &&Reason| (&reason.file, &reason.function, &reason.change) == place;
    reasons.iter().find(of).map(|reason| reason.reason.trim())
}

/// Whether enough of these mutants were found.
#[must_use]
pub fn is_enough(found: usize, mutants: usize) -> bool {
    mutants > 0 && found * 100 >= mutants * FOUND_MIN_PERCENT
}

/// The document.
#[must_use]
pub fn document(results: &Results, reasons: &[Reason]) -> String {
    let mut text = heading(results);
    for (title, survives) in [("Survivors", true), ("Found", false)] {
        let of = |mutant: &&Mutant| matches!(mutant.outcome, Some(Outcome::Survived)) == survives;
        let mutants: Vec<&Mutant> = results.mutants.iter().filter(of).collect();
        let last = if survives {
            "why it survives"
        } else {
            "found by | after s"
        };
        let columns = if survives { 5 } else { 6 };
        let _ = write!(
            text,
            "\n## {title}\n\n| number | place | operator | change | {last} |\n{}|\n",
            "|---".repeat(columns)
        );
        for mutant in mutants {
            let _ = writeln!(text, "{}", row(mutant, reasons));
        }
    }
    text
}

const NOT_COVERED: &str = "\n\
Not mutated are tests, constants and `const fn` (the switch needs a value at run time), arguments of macros, what only prints or
diagnoses, and the drivers of the boards. Boundaries of floating-point numbers stay where they are: moved, they would differ
for one number of 2^64. Mutants that do not compile are replaced by the next ones of the seed.
";

fn heading(results: &Results) -> String {
    let count = |is_it: &dyn Fn(&Mutant) -> bool| results.mutants.iter().filter(|mutant| is_it(mutant)).count();
    let by_campaign = count(&|mutant| match &mutant.outcome {
        Some(Outcome::Found(finding)) => finding.judge.starts_with("campaign"),
        _ => false,
    });
    let (found, all) = (results.found(), results.mutants.len());
    let mut text = format!(
        "# Mutants\n\n\
         A mutant is the firmware with one small error: a comparison turned round, a latch forgotten, a limit dropped. Tests \
         that are\nworth something find it. `etherpen-mutants` wrote this file; it says which test or campaign found which \
         mutant.\n\n\
         ```\n\
         cargo run -p etherpen-mutants -- --seed {seed} --report docs/mutants.md   # goes on where it was interrupted\n\
         cargo run -p etherpen-mutants -- --seed {seed} --only 17                  # one mutant again\n\
         cargo run -p etherpen-mutants -- --seed {seed} --list                     # the mutants of a seed\n\
         ```\n\n\
         A seed chooses the mutants, spread over operators and files. All are compiled into one copy of the sources, and an\n\
         environment variable turns one of them on. The tests of its part look at it first, the quickest first, then one robot\n\
         hour of [campaign](campaign.md). A judge that takes more than five times as long as without a mutant has found it.\n\n\
         | seed | mutants | found | by tests | by campaigns | survivors |\n|---|---|---|---|---|---|\n\
         | {seed} | {all} | {found} | {by_tests} | {by_campaign} | {survivors} |\n\n\
         Mutated are:\n\n",
        seed = results.seed,
        by_tests = found - by_campaign,
        survivors = all - found,
    );
    for part in PARTS {
        let sources: Vec<String> = part.sources.iter().map(|source| format!("`{source}`")).collect();
        let _ = writeln!(text, "- {}: {}", sources.join(", "), part.reason);
    }
    text.push_str(NOT_COVERED);
    text
}

fn plural(judges: usize) -> String {
    if judges == 1 {
        "1 judge".to_owned()
    } else {
        format!("{judges} judges")
    }
}

fn row(mutant: &Mutant, reasons: &[Reason]) -> String {
    let Mutant {
        number, file, function, ..
    } = mutant;
    let last = match &mutant.outcome {
        Some(Outcome::Found(finding)) => format!("{}: {} | {:.1}", finding.judge, finding.what, finding.after_s),
        Some(Outcome::Survived) => reason_of(mutant, reasons).unwrap_or("no reason known").to_owned(),
        None => format!("passes {}, not judged to the end | -", plural(mutant.passed)),
    };
    let operator = mutant.operator.name();
    let change = mutant.change.replace('|', "\\|");
    format!("| {number} | `{file}`: `{function}` | {operator} | {change} | {last} |")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::Finding;
    use crate::site::Operator;

    fn mutant(number: u32, outcome: Outcome) -> Mutant {
        Mutant {
            number,
            file: "src/a.rs".to_owned(),
            function: "A::f".to_owned(),
            operator: Operator::Side,
            change: format!("`b{number} || c` left out"),
            passed: 0,
            outcome: Some(outcome),
        }
    }

    #[test]
    fn the_document_names_who_found_a_mutant_or_why_it_survives() {
        let mut results = Results::new(9, 2, 0);
        let found = Outcome::Found(Finding {
            judge: "src".to_owned(),
            what: "tests::one".to_owned(),
            after_s: 0.25,
        });
        results.mutants = vec![mutant(1, found), mutant(2, Outcome::Survived)];
        let listed =
            "[[survivor]]\nfile = 'src/a.rs'\nfunction = 'A::f'\nchange = '`b2 || c` left out'\nreason = 'equal'\n";
        let text = document(&results, &reasons(listed).unwrap());
        for line in [
            "| 9 | 2 | 1 | 1 | 0 | 1 |",
            "| 1 | `src/a.rs`: `A::f` | condition dropped | `b1 \\|\\| c` left out | src: tests::one | 0.2 |",
            "| 2 | `src/a.rs`: `A::f` | condition dropped | `b2 \\|\\| c` left out | equal |",
        ] {
            assert!(text.lines().any(|other| other == line), "{line}\n{text}");
        }
        let without = document(&results, &[]);
        assert!(without.contains("| no reason known |"));
    }

    #[test]
    fn ninety_five_of_a_hundred_are_enough() {
        assert!(is_enough(95, 100) && is_enough(1, 1));
        assert!(!is_enough(94, 100) && !is_enough(0, 0));
    }

    #[test]
    fn a_wrong_file_of_reasons_is_refused() {
        assert!(reasons("[[survivor]]\nfile = 'a'\n").is_err());
        assert!(reasons("").unwrap().is_empty());
    }
}
