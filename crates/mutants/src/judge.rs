//! Judges mutants: by the tests of their part, the quickest first, and by an hour of robot time.
//!
//! A judge finds a mutant by a test that fails or a seed that breaks a rule. A crash or a time-out can come from the
//! computer too: it counts only if the judge passes without the mutant right after it.

use crate::parts::{Part, Suite};
use crate::process::{self, Ended, Ending};
use crate::results::{Baselines, Finding};
use crate::switch;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// Hours of robot time of a campaign.
const CAMPAIGN_HOURS: u32 = 1;
/// A judge may take this many times as long with a mutant as without one.
const SLOWER: f64 = 5.0;
/// Time that a judge has in any case, s.
const SHORTEST_S: f64 = 20.0;
/// Time for a judge without a mutant, s.
const LONGEST_S: f64 = 3_600.0;

/// Parts of the names of tests that judge no mutant.
const SKIPPED: [&str; 8] = [
    // More than half of the time of all tests, and other tests and campaigns look for the same.
    "another_five_hundred_random_paths",
    "bursts::",
    "feedback_scan::",
    "feedback_soak::",
    "liveness::an_information_memory_that_could_not_be_read",
    "stale::",
    // Builds the firmware of a board, for which there is no switch.
    "board::the_emulated_board",
    // Reads the sources, which are not those of the copy.
    "only_a_robots_own_files_name_its_parts",
];

/// Who looks at a mutant.
#[derive(Clone, Copy, Debug)]
enum Judge {
    Tests(Suite),
    Campaign(&'static str),
}

impl Judge {
    fn name(self) -> String {
        match self {
            Self::Tests(suite) => suite.to_string(),
            Self::Campaign(profile) => format!("campaign --profile {profile}"),
        }
    }

    /// The first failure in the output.
    fn failure(self, output: &str) -> Option<&str> {
        match self {
            Self::Tests(_) => failed_test(output),
            Self::Campaign(_) => failed_seed(output),
        }
    }

    /// What the judge says, by how it ended.
    ///
    /// # Errors
    /// The output does not show that tests or episodes ran.
    fn verdict(self, ended: &Ended) -> Result<Verdict, String> {
        let output = ended.output.as_str();
        let has_run = match self {
            Self::Tests(_) => tests_started(output) > 0,
            // A campaign tells its time at the end only.
            Self::Campaign(_) => ended.ending != Ending::Exited(0) || hours(output) >= f64::from(CAMPAIGN_HOURS),
        };
        if !has_run {
            return Err(format!(
                "{} ran no tests or not all: {}",
                self.name(),
                process::tail(output)
            ));
        }
        let failure = self.failure(output).map(str::to_owned);
        let broke_off = |how: String| Verdict::BrokeOff(format!("{} {how}", running(output)));
        Ok(match (ended.ending, failure) {
            (Ending::Exited(0), _) => Verdict::Passes,
            (Ending::TimeOut, _) => broke_off("takes too long".to_owned()),
            (_, Some(failure)) => Verdict::Failed(failure),
            (Ending::Exited(code), None) => broke_off(format!("ends the program with code {code}")),
            (Ending::Crashed(signal), None) => broke_off(format!("ends the program with signal {signal}")),
            (Ending::Enough, None) => broke_off("ends the program".to_owned()),
        })
    }
}

/// What a judge says.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Verdict {
    /// Nothing is wrong.
    Passes,
    /// This test failed, or this seed broke a rule.
    Failed(String),
    /// The judge crashed or took too long, which can have other causes than the mutant.
    BrokeOff(String),
}

impl Verdict {
    /// What is wrong.
    fn wrong(self) -> Option<String> {
        match self {
            Self::Passes => None,
            Self::Failed(what) | Self::BrokeOff(what) => Some(what),
        }
    }
}

/// Number of judges of a part: its tests, and the campaign.
pub(crate) fn judges_of(part: &Part) -> usize {
    part.suites.len() + 1
}

/// All judges, built.
pub(crate) struct Judges {
    /// Root of the instrumented copy.
    pub copy: PathBuf,
    /// Programs of the tests.
    pub tests: BTreeMap<Suite, PathBuf>,
    /// The program `etherpen`.
    pub etherpen: PathBuf,
}

impl Judges {
    /// Lets a judge of the mutant's part look at it: 0 is the first. Returns what the judge found.
    ///
    /// # Errors
    /// The judge cannot be started, runs no test, or fails without the mutant.
    pub(crate) fn ask(
        &self,
        round: usize,
        number: u32,
        part: &Part,
        baselines_s: &mut Baselines,
    ) -> Result<Option<Finding>, String> {
        let judge = match part.suites.get(round) {
            Some(suite) => Judge::Tests(*suite),
            None => Judge::Campaign(part.profile),
        };
        ask(judge, number, baselines_s, &|number, limit_s| {
            self.run(judge, number, limit_s)
        })
    }

    /// Runs a judge with a mutant, or without any, for at most `limit_s`.
    fn run(&self, judge: Judge, number: Option<u32>, limit_s: f64) -> Result<Ended, String> {
        let mut command = match judge {
            Judge::Tests(suite) => {
                let program = self.tests.get(&suite).ok_or_else(|| format!("no tests {suite}"))?;
                let mut command = process::limited_command(program);
                command
                    .arg("--test-threads=1")
                    .current_dir(self.copy.join(suite.package));
                command.args(SKIPPED.iter().flat_map(|name| ["--skip", name]));
                command
            }
            Judge::Campaign(profile) => {
                let mut command = process::limited_command(&self.etherpen);
                command.args(["campaign", "--jobs", "1", "--seeds", "0..1", "--profile", profile]);
                command
                    .args(["--hours", &CAMPAIGN_HOURS.to_string()])
                    .current_dir(&self.copy);
                command
            }
        };
        match number {
            Some(number) => command.env(switch::VARIABLE, number.to_string()),
            None => command.env_remove(switch::VARIABLE),
        };
        let limit = Duration::from_secs_f64(limit_s);
        let ended = process::run(&mut command, limit, |output| judge.failure(output).is_some())?;
        if ended.ending != Ending::Exited(0) {
            // A test that was ended at its failure has not printed the reason.
            process::check_room(&self.copy)?;
            process::check_room(&std::env::temp_dir())?;
        }
        Ok(ended)
    }
}

/// Runs a judge with the mutant of a number, or without any, for at most so many seconds.
type Run<'a> = &'a dyn Fn(Option<u32>, f64) -> Result<Ended, String>;

/// Lets a judge look at a mutant. Returns what the judge found.
///
/// # Errors
/// The judge cannot be started, runs no test, or fails without the mutant.
fn ask(judge: Judge, number: u32, baselines_s: &mut Baselines, run: Run) -> Result<Option<Finding>, String> {
    let baseline_s = match baselines_s.get(&judge.name()) {
        Some(baseline_s) => *baseline_s,
        None => baseline(judge, baselines_s, run)?,
    };
    let limit_s = SHORTEST_S + SLOWER * baseline_s;
    let ended = run(Some(number), limit_s)?;
    let what = match judge.verdict(&ended)? {
        Verdict::Passes => return Ok(None),
        Verdict::Failed(what) => what,
        Verdict::BrokeOff(what) => {
            eprintln!("    {}: {what}; runs once more without the mutant", judge.name());
            if let Some(wrong) = judge.verdict(&run(None, limit_s)?)?.wrong() {
                return Err(format!(
                    "{}: with mutant {number} {what}, and without a mutant {wrong}. Try: run it again when the computer \
                     has time and memory",
                    judge.name()
                ));
            }
            what
        }
    };
    Ok(Some(Finding {
        judge: judge.name(),
        what,
        after_s: (ended.elapsed.as_secs_f64() * 10.0).round() / 10.0,
    }))
}

/// Runs a judge without a mutant, and keeps its time, s.
fn baseline(judge: Judge, baselines_s: &mut Baselines, run: Run) -> Result<f64, String> {
    eprintln!("without a mutant: {}", judge.name());
    let ended = run(None, LONGEST_S)?;
    if let Some(wrong) = judge.verdict(&ended)?.wrong() {
        return Err(format!("{} fails without a mutant: {wrong}", judge.name()));
    }
    let elapsed_s = ended.elapsed.as_secs_f64();
    baselines_s.insert(judge.name(), elapsed_s);
    Ok(elapsed_s)
}

/// Number of tests that a test program began to run, by its output.
fn tests_started(output: &str) -> u32 {
    let number = |line: &str| {
        let (number, _) = line.strip_prefix("running ")?.split_once(" test")?;
        number.parse().ok()
    };
    output.lines().find_map(number).unwrap_or(0)
}

/// Robot time of a campaign, by its last line, hours.
fn hours(output: &str) -> f64 {
    let told = output
        .lines()
        .rev()
        .find_map(|line| line.split_once(" hours of robot time"));
    told.and_then(|(before, _)| before.rsplit_once(' ')?.1.parse().ok())
        .unwrap_or(0.0)
}

/// The first test that failed, by the output of a test program.
fn failed_test(output: &str) -> Option<&str> {
    // The last line may not be complete yet.
    let (complete, _) = output.rsplit_once('\n')?;
    let mut failed = complete.lines().filter_map(|line| line.strip_suffix(" ... FAILED"));
    let listed = || complete.rsplit_once("\nfailures:\n    ")?.1.lines().next();
    failed.find_map(|line| line.strip_prefix("test ")).or_else(listed)
}

/// The first seed that failed, with the rule that was broken.
fn failed_seed(output: &str) -> Option<&str> {
    let (complete, _) = output.rsplit_once('\n')?;
    let failed = complete.lines().find_map(|line| line.strip_prefix("failed "))?;
    let (what, _) = failed.split_once("; etherpen campaign").unwrap_or((failed, ""));
    what.split(" ms: ").next()
}

/// The test that was running at the end of the output.
fn running(output: &str) -> &str {
    let last = output.lines().rev().find_map(|line| line.strip_prefix("test "));
    last.and_then(|line| line.split_once(" ... "))
        .map_or("the program", |(name, _)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_test_that_failed_is_named_once_its_line_is_complete() {
        let output = "running 3 tests\ntest a::one ... ok\ntest a::two ... FAILED\ntest a::three ... ";
        assert_eq!(failed_test(output), Some("a::two"));
        assert_eq!(running(output), "a::three");
        // What a test prints may come between.
        let mixed =
            "test a::one ... words\nFAILED\n\nfailures:\n\n---- a::one stdout ----\n\nfailures:\n    a::one\n\n";
        assert_eq!(failed_test(mixed), Some("a::one"));
        assert_eq!(failed_test("test a::one ... FAILED"), None);
        assert_eq!(failed_test("test a::one ... ok\n"), None);
        assert_eq!(running(""), "the program");
    }

    const SUITE: Judge = Judge::Tests(Suite {
        package: "",
        target: "",
    });
    const CAMPAIGN: Judge = Judge::Campaign("bus");
    const PASSED: &str = "running 2 tests\ntest a::one ... ok\ntest a::two ... ok\n";
    const FAILED: &str = "running 2 tests\ntest a::one ... FAILED\n";
    const BROKEN_OFF: &str = "running 2 tests\ntest a::one ... ok\ntest a::two ... ";

    fn ended(ending: Ending, output: &str) -> Ended {
        Ended {
            ending,
            output: output.to_owned(),
            elapsed: Duration::from_secs(2),
        }
    }

    /// Asks about mutant 7; the judge ends so with the mutant, and so without. Returns also how often it ran without.
    fn asked(judge: Judge, with: &Ended, without: &Ended) -> (Result<Option<String>, String>, u32) {
        let mut baselines_s = Baselines::from([(judge.name(), 2.0)]);
        let count = std::cell::Cell::new(0);
        let run = |number: Option<u32>, limit_s: f64| {
            assert_eq!(limit_s, 30.0);
            match number {
                Some(number) => {
                    assert_eq!(number, 7);
                    Ok(with.clone())
                }
                None => {
                    count.set(count.get() + 1);
                    Ok(without.clone())
                }
            }
        };
        let found = ask(judge, 7, &mut baselines_s, &run);
        (found.map(|found| found.map(|found| found.what)), count.get())
    }

    #[test]
    fn a_test_that_fails_finds_the_mutant_and_tests_that_pass_do_not() {
        let passes = ended(Ending::Exited(0), PASSED);
        assert_eq!(asked(SUITE, &passes, &passes), (Ok(None), 0));
        for ending in [Ending::Enough, Ending::Exited(101)] {
            let fails = ended(ending, FAILED);
            assert_eq!(asked(SUITE, &fails, &passes), (Ok(Some("a::one".to_owned())), 0));
        }
    }

    #[test]
    fn a_crash_or_time_out_counts_only_if_the_judge_passes_without_the_mutant() {
        let passes = ended(Ending::Exited(0), PASSED);
        for (ending, what) in [
            (Ending::TimeOut, "a::two takes too long"),
            (Ending::Crashed(6), "a::two ends the program with signal 6"),
            (Ending::Exited(101), "a::two ends the program with code 101"),
        ] {
            let broken_off = ended(ending, BROKEN_OFF);
            let (found, runs) = asked(SUITE, &broken_off, &passes);
            assert_eq!((found, runs), (Ok(Some(what.to_owned())), 1));
            for without in [
                &broken_off,
                &ended(Ending::Enough, FAILED),
                &ended(Ending::Exited(0), ""),
            ] {
                let (found, runs) = asked(SUITE, &broken_off, without);
                assert!(found.is_err() && runs == 1, "{ending:?} {found:?}");
            }
        }
    }

    #[test]
    fn a_program_that_runs_no_test_is_an_error() {
        let passes = ended(Ending::Exited(0), PASSED);
        for output in ["", "no such option\n", "running 0 tests\n", "running out of memory\n"] {
            for ending in [
                Ending::Exited(0),
                Ending::Exited(1),
                Ending::Crashed(6),
                Ending::TimeOut,
            ] {
                let (found, _) = asked(SUITE, &ended(ending, output), &passes);
                assert!(found.is_err(), "{ending:?} {output:?} {found:?}");
            }
        }
        assert_eq!(tests_started("words\n\nrunning 1 test\ntest a ... "), 1);
    }

    #[test]
    fn a_campaign_passes_only_after_its_whole_robot_time() {
        let after = |hours: &str| {
            let output = format!("9 episodes, {hours} hours of robot time (31 times real time): no failure\n");
            ended(Ending::Exited(0), &output)
        };
        assert_eq!(asked(CAMPAIGN, &after("1.00"), &after("1.00")), (Ok(None), 0));
        for early in [after("0.99"), ended(Ending::Exited(0), "")] {
            assert!(asked(CAMPAIGN, &early, &early).0.is_err());
        }
        let failed = ended(Ending::Enough, "failed seed 4: Liveness at 8120 ms: mode Fault\n");
        assert_eq!(
            asked(CAMPAIGN, &failed, &after("1.00")),
            (Ok(Some("seed 4: Liveness at 8120".to_owned())), 0)
        );
        let unusable = ended(Ending::Exited(2), "no such profile\n");
        assert!(asked(CAMPAIGN, &unusable, &unusable).0.is_err());
    }

    #[test]
    fn a_judge_that_fails_without_a_mutant_has_no_baseline() {
        let mut baselines_s = Baselines::new();
        let fails = |_: Option<u32>, _: f64| Ok(ended(Ending::Enough, FAILED));
        let error = ask(SUITE, 7, &mut baselines_s, &fails).unwrap_err();
        assert!(error.contains("fails without a mutant: a::one"), "{error}");
        assert!(baselines_s.is_empty());
        let passes = |_: Option<u32>, _: f64| Ok(ended(Ending::Exited(0), PASSED));
        assert_eq!(ask(SUITE, 7, &mut baselines_s, &passes), Ok(None));
        assert_eq!(baselines_s, Baselines::from([("src".to_owned(), 2.0)]));
    }

    #[test]
    fn the_first_seed_that_failed_is_named_with_its_rule_and_time() {
        let output =
            "failed seed 4: Liveness at 8120 ms: mode Fault; etherpen campaign --seeds 4..5 --profile bus\nfailed";
        assert_eq!(failed_seed(output), Some("seed 4: Liveness at 8120"));
        assert_eq!(failed_seed("3 episodes, 0.01 hours: no failure\n"), None);
    }
}
