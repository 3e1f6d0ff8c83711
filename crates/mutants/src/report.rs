//! The document with all mutants: found by what, or why they survive.

use crate::parts::PARTS;
use crate::results::{Mutant, Outcome, Results, numbered};
use serde::Deserialize;
use std::fmt::{self, Write};

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
    /// Number of this change, from 1, among equal changes in the same function; none if there is only one.
    pub occurrence: Option<u32>,
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
    let place = (&mutant.file, &mutant.function, &mutant.change, mutant.occurrence);
    let of = |reason: &&Reason| (&reason.file, &reason.function, &reason.change, reason.occurrence) == place;
    reasons.iter().find(of)
}

impl Reason {
    /// The change in words, with its number where the function has several equal ones.
    #[must_use]
    pub fn numbered_change(&self) -> String {
        numbered(&self.change, self.occurrence)
    }
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

    /// Whether all are judged to the end and enough were found of those that can be found.
    #[must_use]
    pub fn is_enough(&self) -> bool {
        let is_finished = self.waiting == 0;
        is_finished && self.found > 0 && self.found * 100 >= (self.found + self.missed) * FOUND_MIN_PERCENT
    }
}

impl fmt::Display for Score {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            found,
            missed,
            equivalent,
            waiting,
        } = self;
        let judged = found + missed + equivalent;
        match waiting {
            0 => write!(f, "Finished: all {judged} mutants are judged to the end")?,
            _ => write!(
                f,
                "Not finished: {waiting} of {} mutants are not judged to the end",
                judged + waiting
            )?,
        }
        write!(f, ". Judged: {found} found, {missed} missed, {equivalent} equivalent.")
    }
}

/// The document.
#[must_use]
pub fn document(results: &Results, reasons: &[Reason], state: &str) -> String {
    let mut text = heading(results, Score::of(&results.mutants, reasons), state);
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

fn heading(results: &Results, score: Score, state: &str) -> String {
    let count = |is_it: &dyn Fn(&Mutant) -> bool| results.mutants.iter().filter(|mutant| is_it(mutant)).count();
    let by_campaign = count(&|mutant| match &mutant.outcome {
        Some(Outcome::Found(finding)) => finding.judge.starts_with("campaign"),
        _ => false,
    });
    let mut text = format!(
        "# Mutants\n\n\
         {score}\n\n\
         A mutant is the firmware with one small error: a comparison turned round, a latch forgotten, a limit dropped. Tests \
         that are\nworth something find it. `etherpen-mutants` wrote this file; it says which test or campaign found which \
         mutant,\nwhich mutants survive, and which are not judged to the end.\n\n\
         ```\n\
         cargo run -p etherpen-mutants -- --seed {seed} --report docs/mutants.md   # goes on if no file has changed\n\
         cargo run -p etherpen-mutants -- --seed {seed} --fresh                    # judges all mutants again\n\
         cargo run -p etherpen-mutants -- --seed {seed} --only 17                  # one mutant again\n\
         cargo run -p etherpen-mutants -- --seed {seed} --list                     # the mutants of a seed\n\
         ```\n\n\
         A seed chooses the mutants, spread over operators and files. All are compiled into one copy of the sources, and an\n\
         environment variable turns one of them on. The tests of its part look at it first, the quickest first, then one robot\n\
         hour of [campaign](campaign.md). A test that fails and a seed that breaks a rule find the mutant. So does a judge that\n\
         crashes, or takes 20 s more than five times its time without a mutant; it must pass without the mutant right after that.\n\n\
         The outcomes are those of {state}. They are valid for the files they were made with. Once a file\n\
         that git does not ignore has changed, other than this one and the reasons of survivors, every mutant is judged again.\n\n\
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
    let change = mutant.numbered_change().replace('|', "\\|");
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
            occurrence: None,
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
        let text = document(&results, &reasons(listed).unwrap(), "commit `abc`");
        for line in [
            "| 9 | 3 | 1 | 1 | 0 | 0 | 1 | 1 |",
            "| 1 | `src/a.rs`: `A::f` | condition dropped | `b1 \\|\\| c` left out | src: tests::one, 0.2 |",
            "| 2 | `src/a.rs`: `A::f` | condition dropped | `b2 \\|\\| c` left out | equivalent: equal |",
            "| 3 | `src/a.rs`: `A::f` | condition dropped | `b3 \\|\\| c` left out | 0 |",
        ] {
            assert!(text.lines().any(|other| other == line), "{line}\n{text}");
        }
        let first = "# Mutants\n\nNot finished: 1 of 3 mutants are not judged to the end. Judged: 1 found, 0 missed, 1 equivalent.\n";
        assert!(text.starts_with(first), "{text}");
        let without = document(&results, &[], "commit `abc`");
        assert!(without.contains("| no reason known |"));
        results.mutants.truncate(2);
        let first =
            "# Mutants\n\nFinished: all 2 mutants are judged to the end. Judged: 1 found, 1 missed, 0 equivalent.\n";
        assert!(document(&results, &[], "commit `abc`").starts_with(first));
    }

    #[test]
    fn a_reason_belongs_to_one_of_several_equal_changes() {
        let listed = "[[survivor]]\nfile = 'src/a.rs'\nfunction = 'A::f'\nchange = '`b2 || c` left out'\n\
                      occurrence = 2\nequivalent = true\nreason = 'equal'\n";
        let numbered = reasons(listed).unwrap();
        let of_any = reasons(&listed.replace("occurrence = 2\n", "")).unwrap();
        let [first, second] = [1, 2].map(|occurrence| Mutant {
            occurrence: Some(occurrence),
            ..mutant(2, Some(Outcome::Survived))
        });
        assert!(reason_of(&first, &numbered).is_none() && reason_of(&second, &numbered).is_some());
        assert!(reason_of(&second, &of_any).is_none() && reason_of(&mutant(2, None), &of_any).is_some());
        let mutants = [first, second];
        let score = Score::of(&mutants, &numbered);
        assert_eq!((score.missed, score.equivalent), (1, 1));
        let line = "| 2 | `src/a.rs`: `A::f` | condition dropped | `b2 \\|\\| c` left out (occurrence 2) | equivalent: equal |";
        assert_eq!(row(&mutants[1], &numbered), line);
        assert_eq!(numbered[0].numbered_change(), mutants[1].numbered_change());
    }

    #[test]
    fn ninety_five_of_a_hundred_that_can_be_found_are_enough_once_none_waits() {
        let score = |found, missed, equivalent| Score {
            found,
            missed,
            equivalent,
            waiting: 0,
        };
        assert!(score(95, 5, 0).is_enough() && score(1, 0, 99).is_enough());
        assert!(!score(94, 6, 0).is_enough() && !score(0, 0, 100).is_enough());
        let unfinished = Score {
            waiting: 1,
            ..score(99, 0, 0)
        };
        assert!(!unfinished.is_enough());
    }

    #[test]
    fn a_wrong_file_of_reasons_is_refused() {
        assert!(reasons("[[survivor]]\nfile = 'a'\n").is_err());
        assert!(reasons("").unwrap().is_empty());
    }
}
