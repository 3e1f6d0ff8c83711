//! What is known about the mutants of a seed, in a file that is written after each mutant.

use crate::site::{Operator, Site};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Time of each judge without a mutant, s, by the judge's name.
pub type Baselines = BTreeMap<String, f64>;

/// How a mutant was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The tests, or the campaign with its profile.
    pub judge: String,
    /// The test that failed, or the seed with the broken rule.
    pub what: String,
    /// Time until then in the program that found it, s.
    pub after_s: f64,
}

/// What became of a mutant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// It was found.
    Found(Finding),
    /// Neither the tests nor the campaign found it.
    Survived,
}

/// A mutant and what is known about it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mutant {
    /// Its number, from 1.
    pub number: u32,
    /// File, from the root of the sources.
    pub file: String,
    /// Type and function.
    pub function: String,
    /// What it does.
    pub operator: Operator,
    /// The change in words.
    pub change: String,
    /// Number of this change, from 1, among equal changes in the same function; `None` if there is only one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub occurrence: Option<u32>,
    /// Number of judges that found nothing.
    #[serde(default)]
    pub passed: usize,
    /// What became of it; `None` if it is not judged to the end.
    pub outcome: Option<Outcome>,
}

impl Mutant {
    fn new(number: u32, site: &Site) -> Self {
        Self {
            number,
            file: site.file.clone(),
            function: site.function.clone(),
            operator: site.operator,
            change: site.change.clone(),
            occurrence: site.occurrence,
            passed: 0,
            outcome: None,
        }
    }

    fn is_at(&self, site: &Site) -> bool {
        let own = (&self.file, &self.function, self.operator, &self.change, self.occurrence);
        own == (&site.file, &site.function, site.operator, &site.change, site.occurrence)
    }

    /// The change in words, with its number where the function has several equal ones.
    #[must_use]
    pub fn numbered_change(&self) -> String {
        numbered(&self.change, self.occurrence)
    }
}

/// A change in words, with its number if it has one.
pub(crate) fn numbered(change: &str, occurrence: Option<u32>) -> String {
    match occurrence {
        Some(occurrence) => format!("{change} (occurrence {occurrence})"),
        None => change.to_owned(),
    }
}

/// The mutants of a seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// The seed that chose them.
    pub seed: u64,
    /// How many were wanted.
    pub count: usize,
    /// Hash of the files that git does not ignore: code, tests and campaigns. Outcomes and times are valid for these
    /// files only.
    pub files: u64,
    /// Sites whose mutants do not compile.
    pub uncompilable: Vec<usize>,
    /// Time of each judge without a mutant, s.
    pub baselines_s: Baselines,
    /// The mutants, in their order.
    pub mutants: Vec<Mutant>,
}

impl Results {
    /// Results before the first mutant is chosen.
    #[must_use]
    pub fn new(seed: u64, count: usize, files: u64) -> Self {
        Self {
            seed,
            count,
            files,
            uncompilable: Vec::new(),
            baselines_s: BTreeMap::new(),
            mutants: Vec::new(),
        }
    }

    /// Reads a file of results. Starts from nothing if the file does not exist or belongs to another seed, count or
    /// hash of the files: a test that has changed may find other mutants and take another time.
    ///
    /// # Errors
    /// The file cannot be read, or holds no results.
    pub fn read(file: &Path, seed: u64, count: usize, files: u64) -> Result<Self, String> {
        let text = match std::fs::read_to_string(file) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Self::new(seed, count, files)),
            Err(error) => return Err(format!("{}: {error}", file.display())),
        };
        let read: Self = serde_json::from_str(&text)
            .map_err(|error| format!("{} holds no results: {error}. Try: --fresh", file.display()))?;
        if (read.seed, read.count, read.files) == (seed, count, files) {
            return Ok(read);
        }
        eprintln!(
            "{} belongs to another seed, count or state of the files: every mutant is judged again",
            file.display()
        );
        Ok(Self::new(seed, count, files))
    }

    /// Writes the file: completely or not at all.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn write(&self, file: &Path) -> Result<(), String> {
        let shown = |error: &dyn std::fmt::Display| format!("{}: {error}", file.display());
        let text = serde_json::to_string_pretty(self).map_err(|error| shown(&error))?;
        let new = file.with_extension("new");
        std::fs::write(&new, text)
            .and_then(|()| std::fs::rename(&new, file))
            .map_err(|error| shown(&error))
    }

    /// Takes the chosen sites as the mutants, and keeps the outcomes of those that were there.
    pub(crate) fn take(&mut self, chosen: &[&Site]) {
        let mut old = std::mem::take(&mut self.mutants);
        for (number, site) in (1..).zip(chosen) {
            let mut mutant = Mutant::new(number, site);
            if let Some(place) = old.iter().position(|mutant| mutant.is_at(site)) {
                let old = old.remove(place);
                (mutant.passed, mutant.outcome) = (old.passed, old.outcome);
            }
            self.mutants.push(mutant);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn site(change: &str) -> Site {
        Site {
            file: "src/a.rs".to_owned(),
            function: "f".to_owned(),
            operator: Operator::Not,
            range: 0..1,
            replacement: String::new(),
            change: change.to_owned(),
            occurrence: None,
        }
    }

    #[test]
    fn a_run_goes_on_where_it_ended_and_judges_all_again_for_another_seed_count_or_state_of_the_files() {
        let folder = std::env::temp_dir().join(format!("etherpen-mutants-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("results.json");
        let mut results = Results::read(&file, 1, 2, 3).unwrap();
        results.take(&[&site("one"), &site("two")]);
        results.mutants[0].outcome = Some(Outcome::Found(Finding {
            judge: "src".to_owned(),
            what: "tests::one".to_owned(),
            after_s: 0.5,
        }));
        results.mutants[1].outcome = Some(Outcome::Survived);
        results.baselines_s.insert("src".to_owned(), 7.0);
        results.write(&file).unwrap();
        assert_eq!(Results::read(&file, 1, 2, 3).unwrap(), results);
        for (seed, count, files) in [(2, 2, 3), (1, 3, 3), (1, 2, 4)] {
            let other = Results::read(&file, seed, count, files).unwrap();
            assert_eq!(other, Results::new(seed, count, files));
        }
        std::fs::write(&file, "nonsense").unwrap();
        assert!(Results::read(&file, 1, 2, 3).unwrap_err().contains("holds no results"));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_mutant_keeps_its_outcome_when_another_one_is_replaced() {
        let mut results = Results::new(1, 2, 3);
        results.take(&[&site("one"), &site("two")]);
        results.mutants[1].outcome = Some(Outcome::Survived);
        results.take(&[&site("two"), &site("three")]);
        let outcomes: Vec<_> = results.mutants.iter().map(|mutant| mutant.outcome.clone()).collect();
        assert_eq!(outcomes, [Some(Outcome::Survived), None]);
    }

    #[test]
    fn two_equal_changes_of_one_function_keep_their_own_outcomes() {
        let [first, second] = [1, 2].map(|occurrence| Site {
            occurrence: Some(occurrence),
            ..site("one")
        });
        let mut results = Results::new(1, 2, 3);
        results.take(&[&first, &second]);
        results.mutants[1].outcome = Some(Outcome::Survived);
        results.take(&[&second, &first]);
        let outcomes: Vec<_> = results.mutants.iter().map(|mutant| mutant.outcome.clone()).collect();
        assert_eq!(outcomes, [Some(Outcome::Survived), None]);
        assert_eq!(results.mutants[0].numbered_change(), "one (occurrence 2)");
    }
}
