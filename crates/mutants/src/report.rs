//! The document with all mutants: found by what, or why they survive.

use crate::parts::PARTS;
use crate::results::{Mutant, Outcome, Results};
use serde::Deserialize;
use std::fmt::Write;

/// Part of the mutants that has to be found, percent; those that do what the original does are not counted.
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
    /// Whether no test can find it: the mutant does what the original does.
    #[serde(default)]
    pub equivalent: bool,
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
pub fn reason_of<'a>(mutant: &Mutant, reasons: &'a [Reason]) -> Option<&'a Reason> {
    let place = (&mutant.file, &mutant.function, &mutant.change);
    let of = |reason: &&Reason| (&reason.file, &reason.function, &reason.change) == place;
    reasons.iter().find(of)
}

/// How many mutants were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Score {
    /// Found.
    pub found: usize,
    /// Survivors that a test could find.
    pub missed: usize,
    /// Survivors that no test can find.
    pub equivalent: usize,
    /// Not judged to the end.
    pub waiting: usize,
}

impl Score {
    /// The score of these mutants.
    #[must_use]
    pub fn of(mutants: &[Mutant], reasons: &[Reason]) -> Self {
        let mut score = Self {
            found: 0,
            missed: 0,
            equivalent: 0,
            waiting: 0,
        };
        for mutant in mutants {
            let is_equivalent = reason_of(mutant, reasons).is_some_and(|reason| reason.equivalent);
            let count = match &mutant.outcome {
                Some(Outcome::Found(_)) => &mut score.found,
                Some(Outcome::Survived) if is_equivalent => &mut score.equivalent,
                Some(Outcome::Survived) => &mut score.missed,
                None => &mut score.waiting,
            };
            *count += 1;
        }
        score
    }

    /// Whether enough were found of those that can be found and are judged.
    #[must_use]
    pub fn is_enough(&self) -> bool {
        self.found > 0 && self.found * 100 >= (self.found + self.missed) * FOUND_MIN_PERCENT
    }
}

/// The document.
#[must_use]
pub fn document(results: &Results, reasons: &[Reason]) -> String {
    let mut text = heading(results, Score::of(&results.mutants, reasons));
    let is = |mutant: &Mutant, title: &str| match &mutant.outcome {
        Some(Outcome::Survived) => title == "Survivors",
        Some(Outcome::Found(_)) => title == "Found",
        None => title == "Not judged to the end",
    };
    for (title, last) in [
        ("Survivors", "why it survives"),
        ("Not judged to the end", "judges that found nothing"),
        ("Found", "found by, after s"),
    ] {
        let mutants: Vec<&Mutant> = results.mutants.iter().filter(|mutant| is(mutant, title)).collect();
        if mutants.is_empty() {
            continue;
        }
        let _ = write!(
            text,
            "\n## {title}\n\n| number | place | operator | change | {last} |\n|---|---|---|---|---|\n"
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

fn heading(results: &Results, score: Score) -> String {
    let count = |is_it: &dyn Fn(&Mutant) -> bool| results.mutants.iter().filter(|mutant| is_it(mutant)).count();
    let by_campaign = count(&|mutant| match &mutant.outcome {
        Some(Outcome::Found(finding)) => finding.judge.starts_with("campaign"),
        _ => false,
    });
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
         An equivalent mutant does what the original does: no test can find it.\n\n\
         | seed | mutants | found | by tests | by campaigns | missed | equivalent | not judged to the end |\n\
         |---|---|---|---|---|---|---|---|\n\
         | {seed} | {all} | {found} | {by_tests} | {by_campaign} | {missed} | {equivalent} | {waiting} |\n\n\
         Mutated are:\n\n",
        seed = results.seed,
        all = results.mutants.len(),
        found = score.found,
        by_tests = score.found - by_campaign,
        missed = score.missed,
        equivalent = score.equivalent,
        waiting = score.waiting,
    );
    for part in PARTS {
        let sources: Vec<String> = part.sources.iter().map(|source| format!("`{source}`")).collect();
        let _ = writeln!(text, "- {}: {}", sources.join(", "), part.reason);
    }
    text.push_str(NOT_COVERED);
    text
}

fn row(mutant: &Mutant, reasons: &[Reason]) -> String {
    let Mutant {
        number, file, function, ..
    } = mutant;
    let last = match &mutant.outcome {
        Some(Outcome::Found(finding)) => format!("{}: {}, {:.1}", finding.judge, finding.what, finding.after_s),
        Some(Outcome::Survived) => match reason_of(mutant, reasons) {
            Some(reason) if reason.equivalent => format!("equivalent: {}", reason.reason.trim()),
            Some(reason) => reason.reason.trim().to_owned(),
            None => "no reason known".to_owned(),
        },
        None => mutant.passed.to_string(),
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

    fn mutant(number: u32, outcome: Option<Outcome>) -> Mutant {
        Mutant {
            number,
            file: "src/a.rs".to_owned(),
            function: "A::f".to_owned(),
            operator: Operator::Side,
            change: format!("`b{number} || c` left out"),
            passed: 0,
            outcome,
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
        results.mutants = vec![
            mutant(1, Some(found)),
            mutant(2, Some(Outcome::Survived)),
            mutant(3, None),
        ];
        let listed = "[[survivor]]\nfile = 'src/a.rs'\nfunction = 'A::f'\nchange = '`b2 || c` left out'\n\
                      equivalent = true\nreason = 'equal'\n";
        let text = document(&results, &reasons(listed).unwrap());
        for line in [
            "| 9 | 3 | 1 | 1 | 0 | 0 | 1 | 1 |",
            "| 1 | `src/a.rs`: `A::f` | condition dropped | `b1 \\|\\| c` left out | src: tests::one, 0.2 |",
            "| 2 | `src/a.rs`: `A::f` | condition dropped | `b2 \\|\\| c` left out | equivalent: equal |",
            "| 3 | `src/a.rs`: `A::f` | condition dropped | `b3 \\|\\| c` left out | 0 |",
        ] {
            assert!(text.lines().any(|other| other == line), "{line}\n{text}");
        }
        let without = document(&results, &[]);
        assert!(without.contains("| no reason known |"));
    }

    #[test]
    fn ninety_five_of_a_hundred_that_can_be_found_are_enough() {
        let score = |found, missed, equivalent| Score {
            found,
            missed,
            equivalent,
            waiting: 0,
        };
        assert!(score(95, 5, 0).is_enough() && score(1, 0, 99).is_enough());
        assert!(!score(94, 6, 0).is_enough() && !score(0, 0, 100).is_enough());
    }

    #[test]
    fn a_wrong_file_of_reasons_is_refused() {
        assert!(reasons("[[survivor]]\nfile = 'a'\n").is_err());
        assert!(reasons("").unwrap().is_empty());
    }
}
