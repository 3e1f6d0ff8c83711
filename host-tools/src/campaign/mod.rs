//! Campaigns: seeded episodes of the whole cell in virtual time, judged by an independent monitor.
//!
//! ```text
//! seed, profile --generate--> Episode --run--> Option<Failure> --shrink--> smaller Episode --> test-case file
//!                                |
//!         simulation::run(World: cell and wire, Operator: line, decisions, events, healing; Judge: the monitor)
//! ```
//!
//! An episode powers the machine up and gives it an operator with wishes; meanwhile faults and commands come at times
//! that nobody chose. Then everything is healed, and the machine has to come back and draw. The monitor
//! ([`etherpen_monitor`]) looks at the motors, the pen and the wire in every millisecond.
//!
//! Invariant: equal episodes give equal results, on every computer.

mod chance;
mod counted;
mod emulated;
pub mod episode;
mod figures;
pub mod generate;
mod ink;
mod jobs;
mod judge;
mod line;
pub mod machine;
mod operator;
mod robot;
mod shrink;
#[cfg(test)]
mod soak;
mod trouble;
mod witness;
mod world;

use crate::cell::{Cell, CellOptions, ClockOptions};
use crate::emulator::Later;
use crate::simulation;
pub use emulated::run_image;
use episode::Episode;
use etherpen::config::Config;
use generate::Profile;
use machine::Machine;
use operator::Operator;
pub use robot::robot as monitored;
use serde::Serialize;
pub use shrink::shrink;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use world::World;

/// What was broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// A rule of the monitor.
    Monitor(etherpen_monitor::Rule),
    /// Healed, the machine does not come back or does not draw.
    Liveness,
    /// The ink is not the drawing that was reported as drawn.
    Ink,
    /// The power stays on although it was switched off.
    Power,
    /// The black box does not replay to what was recorded.
    Replay,
    /// The black box cannot be read, has gaps, or is not what was seen from outside.
    BlackBox,
    /// The firmware or the cell panicked.
    Panic,
    /// The episode cannot be run.
    Episode,
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Monitor(rule) => write!(f, "{rule:?}"),
            other => write!(f, "{other:?}"),
        }
    }
}

/// What an episode has found.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// Milliseconds since power-up.
    pub time_ms: u32,
    /// The rule that was broken.
    pub rule: Rule,
    /// What was seen.
    pub text: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} at {} ms: {}", self.rule, self.time_ms, self.text)
    }
}

/// Longest time of an episode, ms; the operator ends each one much earlier.
const LIMIT_MS: u32 = 1_200_000;

/// Time for which a reset board does nothing, ms.
const RESET_MS: u32 = 100;

/// An episode that was run.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// What was found.
    pub failure: Option<Failure>,
    /// Virtual time, ms.
    pub passed_ms: u32,
    /// How often the operator reset the board, because the fault said that nothing else helps.
    pub resets: u32,
}

impl Run {
    /// An episode that did not begin, or did not end.
    fn failed(rule: Rule, text: String) -> Self {
        Self {
            failure: Some(Failure { time_ms: 0, rule, text }),
            passed_ms: 0,
            resets: 0,
        }
    }
}

/// 400 m of cable between any two slaves: a delay that was taken for another slave's makes two clocks differ by more than
/// the monitor allows.
fn long_cables() -> ClockOptions {
    ClockOptions {
        cable_ns: 2_000,
        ..ClockOptions::default()
    }
}

/// The configuration of an episode, and its cell before power-up.
fn prepared(episode: &Episode) -> Result<(Config, World), Run> {
    let config = episode
        .configuration()
        .map_err(|text| Run::failed(Rule::Episode, text))?;
    let options = CellOptions {
        seed: episode.seed,
        clocks: long_cables(),
        ..CellOptions::default()
    };
    let world = World::new(Cell::new(&config, options));
    Ok((config, world))
}

/// Runs an episode.
#[must_use]
pub fn run(episode: &Episode) -> Run {
    caught(|| {
        let (config, world) = match prepared(episode) {
            Ok(prepared) => prepared,
            Err(failed) => return failed,
        };
        if episode.by_jobs {
            return jobs::run(episode, config, world);
        }
        let mut operator = Operator::new(episode, config, world.clone());
        let passed_ms = with_resets(LIMIT_MS, &mut operator, |operator, begun_ms, left_ms| {
            let mut segment = begun_later(&world, begun_ms);
            (simulation::run(&mut segment, operator, left_ms), ())
        });
        Run {
            passed_ms: passed_ms.0,
            resets: operator.resets(),
            failure: operator.failure(),
        }
    })
}

/// Runs the firmware from each start of the board to its next reset, or to the episode's end, `limit_ms` at most: `start` gets
/// when it begins and what time is left, ms, and returns how long it ran. Returns the whole time, ms, and what the last run
/// returned.
fn with_resets<R>(
    limit_ms: u32,
    operator: &mut Operator,
    mut start: impl FnMut(&mut Operator, u32, u32) -> (u32, R),
) -> (u32, R) {
    let mut begun_ms = 0;
    loop {
        let (ran_ms, result) = start(operator, begun_ms, limit_ms.saturating_sub(begun_ms));
        let passed_ms = begun_ms + ran_ms;
        if !operator.presses_reset() {
            return (passed_ms, result);
        }
        begun_ms = passed_ms + RESET_MS;
        operator.begin_again(begun_ms);
    }
}

/// The world as a board sees it that begins at a time, ms.
fn begun_later(world: &World, begun_ms: u32) -> Later<World> {
    Later {
        segment: world.clone(),
        begun_us: u64::from(begun_ms) * 1_000,
    }
}

/// The result of `episode`; its panic is one.
fn caught(episode: impl FnOnce() -> Run) -> Run {
    let outcome = catch_unwind(AssertUnwindSafe(episode));
    outcome.unwrap_or_else(|cause| {
        let text = cause.downcast_ref::<String>().cloned();
        let text = text.or_else(|| cause.downcast_ref::<&str>().map(|text| (*text).to_owned()));
        Run::failed(Rule::Panic, text.unwrap_or_else(|| "a panic without words".to_owned()))
    })
}

/// What a campaign has to do.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The machine of all episodes.
    pub machine: Machine,
    /// First seed.
    pub first: u64,
    /// Seed behind the last one.
    pub end: u64,
    /// Which faults there are.
    pub profile: Profile,
    /// Virtual time after which no further episode begins, ms; `None` for all seeds.
    pub limit_ms: Option<u64>,
    /// Episodes run at the same time.
    pub jobs: usize,
}

/// A seed that failed.
#[derive(Clone, Debug)]
pub struct Failed {
    /// The seed.
    pub seed: u64,
    /// What was found.
    pub failure: Failure,
}

/// Result of a campaign.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Episodes run.
    pub episodes: u64,
    /// Virtual time of all episodes, ms.
    pub virtual_ms: u64,
    /// Resets of the board in all episodes.
    pub resets: u64,
    /// Seeds that failed, in their order.
    pub failed: Vec<Failed>,
}

/// State of a campaign, for display.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Progress {
    /// Episodes that have ended.
    pub episodes: u64,
    /// Virtual time of these, ms.
    pub virtual_ms: u64,
    /// Seeds that failed.
    pub failed: usize,
}

/// Runs episodes in parallel by `run` until all seeds are done, the time is over or `ended` is set; `report` gets each
/// seed that fails, and the progress after each episode.
pub fn campaign(
    plan: &Plan,
    run: &(dyn Fn(&Episode) -> Run + Sync),
    ended: &AtomicBool,
    report: &(dyn Fn(Option<&Failed>, Progress) + Sync),
) -> Summary {
    let next = AtomicU64::new(plan.first);
    let summary = Mutex::new(Summary::default());
    let lock = || summary.lock().unwrap_or_else(PoisonError::into_inner);
    let work = || {
        while !ended.load(Ordering::Relaxed) {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            let over = plan.limit_ms.is_some_and(|limit_ms| lock().virtual_ms >= limit_ms);
            if seed >= plan.end || over {
                return;
            }
            let run = run(&generate::episode(&plan.machine, seed, plan.profile));
            let failed = run.failure.map(|failure| Failed { seed, failure });
            let mut summary = lock();
            summary.episodes += 1;
            summary.virtual_ms += u64::from(run.passed_ms);
            summary.resets += u64::from(run.resets);
            summary.failed.extend(failed.clone());
            let progress = Progress {
                episodes: summary.episodes,
                virtual_ms: summary.virtual_ms,
                failed: summary.failed.len(),
            };
            drop(summary);
            report(failed.as_ref(), progress);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..plan.jobs.max(1) {
            scope.spawn(work);
        }
    });
    let mut summary = summary.into_inner().unwrap_or_else(PoisonError::into_inner);
    summary.failed.sort_by_key(|failed| failed.seed);
    summary
}

#[cfg(test)]
mod replay_tests;
#[cfg(test)]
mod tests;
