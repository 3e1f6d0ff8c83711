//! Chooses, builds and judges the mutants of a seed, and goes on where an earlier run was interrupted.

use crate::cargo::Cargo;
use crate::choice::choose;
use crate::copy::Copy;
use crate::judge::{Judges, judges_of};
use crate::parts::{PARTS, part_of};
use crate::report::{self, Score};
use crate::results::{Mutant, Outcome, Results};
use crate::site::Site;
use crate::sources::{self, Sources};
use std::path::{Path, PathBuf};

/// Reasons of survivors, from the root of the sources.
const REASONS: &str = "crates/mutants/reasons.toml";
/// The document on the mutants, from the root of the sources.
const DOCUMENT: &str = "docs/mutants.md";

/// What to do.
#[derive(Clone, Debug)]
pub struct Options {
    /// Chooses the mutants.
    pub seed: u64,
    /// Number of mutants.
    pub count: usize,
    /// File of results; by default below cargo's output folder.
    pub results: Option<PathBuf>,
    /// Judge all mutants, even if they were judged.
    pub fresh: bool,
    /// Judge this mutant alone, even if it was judged.
    pub only: Option<u32>,
    /// Print the mutants and judge none.
    pub list: bool,
    /// Write this document at the end, of what is known then.
    pub report: Option<PathBuf>,
}

/// Does what the options say. Returns whether all mutants are judged and enough were found; with `only` or `list`,
/// `true`.
///
/// # Errors
/// What cannot be read, built, started or written.
pub fn run(options: &Options) -> Result<bool, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let root = root.canonicalize().map_err(|error| format!("no sources: {error}"))?;
    let target = match std::env::var_os("CARGO_TARGET_DIR") {
        Some(folder) => root.join(folder),
        None => root.join("target"),
    };
    let folder = target.join("mutants");
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let files = sources::files(&root)?;
    let sources = sources::read(&root, &files)?;
    let file = options.results.clone().unwrap_or_else(|| folder.join("results.json"));
    // What this program writes, and the reasons, change no outcome.
    let mut left_out = vec![root.join(REASONS), root.join(DOCUMENT), file.clone()];
    left_out.extend(options.report.clone());
    let hash = sources::hash(&root, &files, &left_out)?;
    let mut results = match options.fresh {
        true => Results::new(options.seed, options.count, hash),
        false => Results::read(&file, options.seed, options.count, hash)?,
    };
    results.take(&chosen_sites(&sources, &results));
    eprintln!(
        "seed {}: {} of {} places, {} judged",
        options.seed,
        results.mutants.len(),
        sources.sites.len(),
        results.mutants.iter().filter(|mutant| mutant.outcome.is_some()).count()
    );
    let is_waiting = results.mutants.iter().any(|mutant| mutant.outcome.is_none());
    if options.list {
        list(&results);
    } else if is_waiting || options.only.is_some() {
        let mut copy = Copy::make(&root, &files, &sources, folder.join("source"))?;
        let judges = build(&mut copy, &folder.join("build"), &sources, &mut results)?;
        results.write(&file)?;
        judge_all(&judges, options.only, &mut results, &file)?;
    }
    let is_enough = finish(&root, options, &results)?;
    Ok(is_enough || options.list || options.only.is_some())
}

fn chosen_sites<'a>(sources: &'a Sources, results: &Results) -> Vec<&'a Site> {
    let chosen = choose(&sources.sites, results.seed, results.count, &results.uncompilable);
    chosen.into_iter().map(|site| &sources.sites[site]).collect()
}

fn list(results: &Results) {
    for mutant in &results.mutants {
        println!("{}", shown(mutant));
    }
}

/// Writes the mutants into the copy and builds everything. Mutants that do not compile are replaced.
fn build(copy: &mut Copy, target: &Path, sources: &Sources, results: &mut Results) -> Result<Judges, String> {
    let folder = copy.folder.clone();
    let cargo = Cargo { copy: &folder, target };
    loop {
        let chosen = choose(&sources.sites, results.seed, results.count, &results.uncompilable);
        results.take(&chosen_sites(sources, results));
        copy.mutate(sources, &chosen)?;
        let errors = cargo.check()?;
        if errors.is_empty() {
            break;
        }
        let mutants = errors.iter().flat_map(|error| &error.places);
        let mut wrong: Vec<u32> = mutants
            .filter_map(|(file, bytes)| copy.mutant_at(file, bytes))
            .collect();
        wrong.sort_unstable();
        wrong.dedup();
        if wrong.is_empty() {
            let texts: Vec<&str> = errors.iter().map(|error| error.text.as_str()).collect();
            return Err(format!("errors that belong to no mutant:\n{}", texts.join("\n")));
        }
        eprintln!("replaced, because they do not compile: {wrong:?}");
        let sites = wrong.iter().map(|number| chosen[*number as usize - 1]);
        results.uncompilable.extend(sites);
    }
    let tests = cargo.tests()?;
    let etherpen = cargo.etherpen()?;
    Ok(Judges {
        copy: folder,
        tests,
        etherpen,
    })
}

/// Judges the mutants that were not judged yet, or one. All meet their first judge, then those that are left the second:
/// the quick judges first. Keeps the results after each.
fn judge_all(judges: &Judges, only: Option<u32>, results: &mut Results, file: &Path) -> Result<(), String> {
    if let Some(number) = only {
        let last = results.mutants.len();
        let mutant = results.mutants.iter_mut().find(|mutant| mutant.number == number);
        let mutant = mutant.ok_or_else(|| format!("there is no mutant {number}; the numbers are 1 to {last}"))?;
        (mutant.passed, mutant.outcome) = (0, None);
    }
    let rounds = PARTS.iter().map(judges_of).max().unwrap_or(0);
    for round in 0..rounds {
        for place in 0..results.mutants.len() {
            let mutant = &results.mutants[place];
            let is_meant = only.is_none_or(|number| mutant.number == number);
            if is_meant && mutant.outcome.is_none() && mutant.passed == round {
                judge(judges, round, place, results)?;
                results.write(file)?;
            }
        }
    }
    Ok(())
}

/// Lets the judge of a round look at a mutant.
fn judge(judges: &Judges, round: usize, place: usize, results: &mut Results) -> Result<(), String> {
    let (mutant, baselines_s) = (&mut results.mutants[place], &mut results.baselines_s);
    let part = part_of(&mutant.file).ok_or_else(|| format!("{} is in no part", mutant.file))?;
    eprintln!("{}", shown(mutant));
    mutant.outcome = match judges.ask(round, mutant.number, part, baselines_s)? {
        Some(found) => {
            eprintln!(
                "    found by {} after {:.1} s: {}",
                found.judge, found.after_s, found.what
            );
            Some(Outcome::Found(found))
        }
        None => {
            mutant.passed = round + 1;
            eprintln!("    passes {} of {} judges", mutant.passed, judges_of(part));
            (mutant.passed == judges_of(part)).then_some(Outcome::Survived)
        }
    };
    Ok(())
}

/// Says how many were found, and writes the document.
fn finish(root: &Path, options: &Options, results: &Results) -> Result<bool, String> {
    let text = std::fs::read_to_string(root.join(REASONS)).map_err(|error| format!("{REASONS}: {error}"))?;
    let reasons = report::reasons(&text).map_err(|error| format!("{REASONS}: {error}"))?;
    let survivors = results
        .mutants
        .iter()
        .filter(|mutant| mutant.outcome == Some(Outcome::Survived));
    for mutant in survivors {
        let reason = report::reason_of(mutant, &reasons).map(|reason| reason.reason.trim());
        let reason = reason.unwrap_or("no reason known: write a test, or the reason");
        eprintln!("survives: {}\n    {reason}", shown(mutant));
    }
    let score = Score::of(&results.mutants, &reasons);
    eprintln!("seed {}: {score}", results.seed);
    if let Some(document) = &options.report {
        let text = report::document(results, &reasons, &sources::state(root, &[REASONS, DOCUMENT])?);
        std::fs::write(document, text).map_err(|error| format!("{}: {error}", document.display()))?;
    }
    Ok(score.is_enough())
}

fn shown(mutant: &Mutant) -> String {
    let operator = mutant.operator.name();
    format!(
        "{} {}: {}: {operator}: {}",
        mutant.number,
        mutant.file,
        mutant.function,
        mutant.numbered_change()
    )
}
