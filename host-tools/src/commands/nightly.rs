//! `etherpen verify --nightly`: what takes longer than continuous integration may.

use crate::campaign::generate::Profile;
use crate::error::{ProgramError, code};
use crate::settings::machines::MACHINES;
use crate::setup;
use crate::terminal::in_colour;
use clap::ValueEnum;
use std::process::Command;
use std::time::Instant;

/// Robot time of each profile of the campaign on each machine, hours.
const CAMPAIGN_HOURS: &str = "0.8";
/// Robot time of each profile against the emulated board's image, hours.
const EMULATED_HOURS: &str = "1";
/// First seed and the one behind the last; an episode takes some seconds of robot time.
const CAMPAIGN_SEEDS: &str = "0..100000";
/// Time for each fuzz target, s.
const FUZZ_S: u32 = 600;

/// Runs the models: a package of its own, built in a folder of its own.
pub(super) const MODELS: [&str; 4] = ["test", "--release", "--manifest-path", "models/Cargo.toml"];

/// A step: its name, and cargo's arguments.
struct Step {
    name: String,
    arguments: Vec<String>,
    /// For Miri.
    environment: &'static [(&'static str, &'static str)],
}

impl Step {
    fn new(name: &str, arguments: &str) -> Self {
        Self {
            name: name.to_owned(),
            arguments: arguments.split(' ').map(str::to_owned).collect(),
            environment: &[],
        }
    }
}

/// A step in which Miri runs unit tests.
fn miri(name: &str, tests: &str) -> Step {
    Step {
        environment: &[("MIRIFLAGS", "-Zmiri-ignore-leaks")],
        ..Step::new(name, &format!("+nightly miri test {tests}"))
    }
}

/// All steps, the shorter ones first.
fn steps() -> Vec<Step> {
    let mut steps = vec![
        Step::new("models", &MODELS.join(" ")),
        miri(
            "miri-ethercat",
            "-p etherpen-ethercat --lib -- exchange_tests encapsulation_tests telegram acyclic frame_port",
        ),
        miri("miri-drives", "-p etherpen-drives --lib"),
        miri(
            "miri-link",
            "-p etherpen-link --lib -- --skip garbage --skip nonsense --skip any_one_damaged_byte --skip the_longest_payload",
        ),
        Step::new("advisories", "deny check"),
        Step::new(
            "limits",
            "test --release -p etherpen-fuzzing --test limits -- --ignored --nocapture",
        ),
    ];
    steps.push(Step::new(
        "matrix",
        "test --workspace --test reactions the_whole_fault_matrix -- --ignored",
    ));
    steps.push(Step::new(
        "pictures",
        "test --release -p host-tools --lib time_budget -- --ignored --nocapture",
    ));
    steps.push(Step::new(
        "bench-ethercat",
        "run --release --bin etherpen -- bench ethercat --check",
    ));
    let profiles: Vec<String> = Profile::value_variants()
        .iter()
        .filter_map(Profile::to_possible_value)
        .map(|profile| profile.get_name().to_owned())
        .collect();
    let runs = profiles
        .iter()
        .flat_map(|profile| MACHINES.map(|machine| (profile, machine.name)));
    steps.extend(runs.map(|(profile, machine)| {
        let arguments = format!(
            "run --release --bin etherpen -- campaign --machine {machine} --profile {profile} --seeds {CAMPAIGN_SEEDS} \
             --hours {CAMPAIGN_HOURS} --cases target/campaign/{profile}-{machine}"
        );
        Step::new(&format!("campaign-{profile}-{machine}"), &arguments)
    }));
    // The profile of the program's own files is not about the board.
    let of_the_board = profiles.iter().filter(|profile| *profile != "files");
    steps.extend(of_the_board.map(|profile| {
        let arguments = format!(
            "run --release --bin etherpen -- campaign --emulated --profile {profile} --seeds {CAMPAIGN_SEEDS} \
             --hours {EMULATED_HOURS}"
        );
        Step::new(&format!("emulated-{profile}"), &arguments)
    }));
    steps.push(Step::new(
        "soak",
        "test --release -p host-tools --lib a_day_of_portraits -- --ignored --nocapture",
    ));
    steps.push(Step::new(
        "seeds-of-fuzzing",
        "run -p etherpen-fuzzing -- seeds target/seeds",
    ));
    steps.extend(targets().iter().map(|target| {
        let mut arguments = format!(
            "+nightly fuzz run {target} target/found/{target} fuzz/corpus/{target} target/seeds/{target} -- \
             -max_total_time={FUZZ_S} -timeout=10 -rss_limit_mb=1024"
        );
        if let Some(dictionary) = dictionary(target) {
            arguments += &format!(" -dict={dictionary}");
        }
        Step::new(&format!("fuzz-{target}"), &arguments)
    }));
    steps.push(Step::new(
        "mutants",
        "run -p etherpen-mutants -- --seed 1 --count 100 --fresh",
    ));
    steps.push(Step::new(
        "certificates",
        "test --release -p etherpen-certify -- --ignored --nocapture",
    ));
    steps
}

/// The fuzz targets, by the folders of their inputs.
fn targets() -> Vec<String> {
    let folder = setup::ensure_sources().map(|sources| sources.join("fuzz/corpus"));
    let entries = folder.ok().and_then(|folder| std::fs::read_dir(folder).ok());
    let names = entries.into_iter().flatten().flatten();
    let mut targets: Vec<String> = names.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    targets.sort();
    targets
}

/// The dictionary of a fuzz target, if it has one.
fn dictionary(target: &str) -> Option<String> {
    let path = format!("fuzz/dictionaries/{target}.dict");
    let sources = setup::ensure_sources().ok()?;
    sources.join(&path).is_file().then_some(path)
}

/// Runs all steps, or those whose names begin with a word; a step that fails does not keep the others from running.
///
/// # Errors
/// The steps that failed; they have reported why. No step has such a name.
pub(super) fn run(only: Option<&str>) -> Result<(), ProgramError> {
    let mut steps = steps();
    if let Some(word) = only {
        let names: Vec<&str> = steps.iter().map(|step| step.name.as_str()).collect();
        let names = names.join(", ");
        steps.retain(|step| step.name.starts_with(word));
        if steps.is_empty() {
            return Err(ProgramError::new(
                code::USAGE,
                format!("no step {word}; there are {names}"),
            ));
        }
    }
    let mut failed = Vec::new();
    for step in &steps {
        eprintln!("{} {}", in_colour("nightly", "1;36"), step.name);
        let begun = Instant::now();
        if !succeeds(step)? {
            failed.push(step.name.as_str());
        }
        eprintln!("{}: {:.0} s", step.name, begun.elapsed().as_secs_f64());
    }
    match failed.is_empty() {
        true => Ok(()),
        false => Err(ProgramError::new(
            code::FAILED,
            format!("failed: {}", failed.join(", ")),
        )),
    }
}

/// Whether a step succeeds.
fn succeeds(step: &Step) -> Result<bool, ProgramError> {
    let sources = setup::ensure_sources()?;
    if let Some(target) = step.name.strip_prefix("fuzz-") {
        let found = sources.join("target/found").join(target);
        std::fs::create_dir_all(&found)
            .map_err(|error| ProgramError::new(code::FAILED, format!("{}: {error}", found.display())))?;
    }
    let status = Command::new("cargo")
        .args(&step.arguments)
        .envs(step.environment.iter().copied())
        .env_remove("RUSTUP_TOOLCHAIN")
        .current_dir(sources)
        .status()
        .map_err(|error| ProgramError::new(code::FAILED, format!("cargo: {error}")))?;
    Ok(status.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_has_a_name_of_its_own_and_every_fuzz_target_is_among_them() {
        let steps = steps();
        let mut names: Vec<&str> = steps.iter().map(|step| step.name.as_str()).collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
        let with_dictionary = |step: &&Step| step.arguments.iter().any(|word| word.starts_with("-dict="));
        assert_eq!(steps.iter().filter(with_dictionary).count(), 10);
        let targets = steps.iter().filter(|step| step.name.starts_with("fuzz-")).count();
        assert!(targets >= 19, "{targets}");
    }

    #[test]
    fn every_profile_of_the_campaign_runs_on_every_machine_and_against_the_emulated_board() {
        let steps = steps();
        for profile in Profile::value_variants() {
            let name = profile
                .to_possible_value()
                .expect("a profile has a name")
                .get_name()
                .to_owned();
            let of_profile = |step: &&Step| {
                step.arguments
                    .windows(2)
                    .any(|words| words == ["--profile", name.as_str()])
            };
            let found: Vec<&str> = (steps.iter().filter(of_profile))
                .map(|step| step.name.as_str())
                .collect();
            let mut expected: Vec<String> = (MACHINES.iter())
                .map(|machine| format!("campaign-{name}-{}", machine.name))
                .collect();
            if *profile != Profile::Files {
                expected.push(format!("emulated-{name}"));
            }
            assert_eq!(found, expected);
        }
    }

    #[test]
    fn a_step_that_does_not_exist_is_refused_with_the_names() {
        let refused = run(Some("nothing")).unwrap_err();
        assert!(refused.message.contains("campaign-bus"), "{}", refused.message);
    }
}
