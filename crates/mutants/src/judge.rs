//! Judges mutants: by the tests of their part, the quickest first, and by an hour of robot time.

use crate::parts::{Part, Suite};
use crate::process::{self, Ending};
use crate::results::{Baselines, Finding};
use crate::switch;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

/// Hours of robot time of a campaign.
const CAMPAIGN_HOURS: &str = "1";
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
}

/// What a judge says.
#[derive(Clone, Debug)]
struct Verdict {
    /// What was wrong.
    wrong: Option<String>,
    elapsed_s: f64,
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
    /// The judge cannot be started, or finds something without a mutant.
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
        let baseline_s = match baselines_s.get(&judge.name()) {
            Some(baseline_s) => *baseline_s,
            None => self.baseline(judge, baselines_s)?,
        };
        let verdict = self.run(judge, Some(number), SHORTEST_S + SLOWER * baseline_s)?;
        Ok(verdict.wrong.map(|what| Finding {
            judge: judge.name(),
            what,
            after_s: (verdict.elapsed_s * 10.0).round() / 10.0,
        }))
    }

    /// Runs a judge without a mutant, and keeps its time.
    fn baseline(&self, judge: Judge, baselines_s: &mut Baselines) -> Result<f64, String> {
        eprintln!("without a mutant: {}", judge.name());
        let verdict = self.run(judge, None, LONGEST_S)?;
        match verdict.wrong {
            Some(wrong) => Err(format!("{} fails without a mutant: {wrong}", judge.name())),
            None => {
                baselines_s.insert(judge.name(), verdict.elapsed_s);
                Ok(verdict.elapsed_s)
            }
        }
    }

    fn run(&self, judge: Judge, number: Option<u32>, limit_s: f64) -> Result<Verdict, String> {
        let (mut command, look): (Command, fn(&str) -> Option<&str>) = match judge {
            Judge::Tests(suite) => {
                let program = self.tests.get(&suite).ok_or_else(|| format!("no tests {suite}"))?;
                let mut command = process::limited_command(program);
                command
                    .arg("--test-threads=1")
                    .current_dir(self.copy.join(suite.package));
                command.args(SKIPPED.iter().flat_map(|name| ["--skip", name]));
                (command, failed_test)
            }
            Judge::Campaign(profile) => {
                let mut command = process::limited_command(&self.etherpen);
                command.args(["campaign", "--jobs", "1", "--seeds", "0..1", "--profile", profile]);
                command.args(["--hours", CAMPAIGN_HOURS]).current_dir(&self.copy);
                (command, failed_seed)
            }
        };
        match number {
            Some(number) => command.env(switch::VARIABLE, number.to_string()),
            None => command.env_remove(switch::VARIABLE),
        };
        let limit = Duration::from_secs_f64(limit_s);
        let ended = process::run(&mut command, limit, |output| look(output).is_some())?;
        let found = look(&ended.output).map(str::to_owned);
        let wrong = match ended.ending {
            Ending::Exited(true) => None,
            Ending::TimeOut => Some(format!("{} takes too long", running(&ended.output))),
            Ending::Enough | Ending::Exited(false) => {
                Some(found.unwrap_or_else(|| format!("{} ends the program", running(&ended.output))))
            }
        };
        Ok(Verdict {
            wrong,
            elapsed_s: ended.elapsed.as_secs_f64(),
        })
    }
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

    #[test]
    fn the_first_seed_that_failed_is_named_with_its_rule_and_time() {
        let output =
            "failed seed 4: Liveness at 8120 ms: mode Fault; etherpen campaign --seeds 4..5 --profile bus\nfailed";
        assert_eq!(failed_seed(output), Some("seed 4: Liveness at 8120"));
        assert_eq!(failed_seed("3 episodes, 0.01 hours: no failure\n"), None);
    }
}
