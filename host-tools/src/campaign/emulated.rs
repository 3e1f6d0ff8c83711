//! Episodes against a board's image: the firmware runs in the emulator, in lockstep with the same cell and operator.
//!
//! The emulator has a thread of its own; in each millisecond it waits for the operator, so that an episode gives the
//! same result in every run.

use super::episode::{Episode, What};
use super::operator::Operator;
use super::world::World;
use super::{Failure, Rule, Run, begun_later, caught, prepared, with_resets};
use crate::emulator::{Emulator, EmulatorError, LINK_BYTES_MAX, Later, Link, Options, Segment, Traffic};
use crate::simulation::Host;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// The emulator's end of the link: asks the operator and waits for the answer.
struct Bridge {
    heard: SyncSender<(u32, Vec<u8>)>,
    said: Receiver<Vec<u8>>,
}

impl Link for Bridge {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        // An operator who is gone says nothing.
        if self.heard.send((ms, from_device.to_vec())).is_ok()
            && let Ok(bytes) = self.said.recv()
        {
            to_device.extend(bytes);
        }
    }
}

/// What a board's wire leads to, until it is switched off: the emulator ends a little later than it is told.
struct Connected {
    segment: Later<World>,
    is_off: Arc<AtomicBool>,
}

impl Segment for Connected {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        match self.is_off.load(Ordering::Acquire) {
            true => Vec::new(),
            false => self.segment.frame(time_us, frame),
        }
    }

    fn advance_to(&mut self, time_us: u64) {
        if !self.is_off.load(Ordering::Acquire) {
            self.segment.advance_to(time_us);
        }
    }
}

/// An episode without what the emulated board cannot show: its inputs and its Ethernet port's link.
#[must_use]
pub fn for_the_image(episode: &Episode) -> Episode {
    let mut episode = episode.clone();
    episode.events.retain(|event| {
        !matches!(
            event.what,
            What::StopInput(_) | What::SubstituteClock(_) | What::TrajectoryWaits(_) | What::PortDown(_)
        )
    });
    episode
}

/// Runs an episode of [`for_the_image`] against a firmware image.
#[must_use]
pub fn run_image(image: &Path, episode: &Episode) -> Run {
    caught(|| run_uncaught(image, episode))
}

fn run_uncaught(image: &Path, episode: &Episode) -> Run {
    let (config, world) = match prepared(episode) {
        Ok(prepared) => prepared,
        Err(failed) => return failed,
    };
    let mut operator = Operator::new(episode, config, world.clone());
    let (passed_ms, ended) = with_resets(&mut operator, |operator, begun_ms, left_ms| {
        match run_from(image, begun_later(&world, begun_ms), operator, left_ms) {
            Ok((ran_ms, ended)) => (ran_ms, Ok(ended)),
            Err(error) => (0, Err(error)),
        }
    });
    let ended = match ended {
        Ok(ended) => ended,
        Err(error) => return Run::failed(Rule::Episode, error.to_string()),
    };
    Run {
        passed_ms,
        resets: operator.resets(),
        failure: operator
            .into_failure()
            .or_else(|| end_of_the_firmware(&ended, passed_ms)),
    }
}

/// Runs the image from its start to the episode's end or the operator's reset; returns the time, ms, and how the emulator ended.
///
/// # Errors
/// The emulator does not start.
fn run_from(
    image: &Path,
    segment: Later<World>,
    operator: &mut Operator,
    limit_ms: u32,
) -> Result<(u32, Result<Traffic, EmulatorError>), EmulatorError> {
    let ((heard, from_firmware), (to_firmware, said)) = (sync_channel(0), sync_channel(0));
    let quiet = Options {
        decode_log: false,
        ..Options::default()
    };
    let is_off = Arc::new(AtomicBool::new(false));
    let connected = Connected {
        segment,
        is_off: Arc::clone(&is_off),
    };
    let emulator = Emulator::start(image, &quiet, connected, Bridge { heard, said }, |_| ())?;
    let ran_ms = operate(operator, limit_ms, &from_firmware, &to_firmware);
    // It waits for its answer.
    is_off.store(true, Ordering::Release);
    drop((from_firmware, to_firmware));
    Ok((ran_ms, emulator.stop()))
}

/// Answers the emulator until the episode is over or the board is reset; returns the virtual time, ms.
fn operate(
    operator: &mut Operator,
    limit_ms: u32,
    from_firmware: &Receiver<(u32, Vec<u8>)>,
    to_firmware: &SyncSender<Vec<u8>>,
) -> u32 {
    let mut passed_ms = 0;
    while let Ok((ms, bytes)) = from_firmware.recv() {
        passed_ms = ms;
        let mut answer = Vec::new();
        operator.exchange(ms, &bytes, &mut answer, LINK_BYTES_MAX);
        if operator.is_over() || ms >= limit_ms || to_firmware.send(answer).is_err() {
            break;
        }
    }
    passed_ms
}

/// A firmware that ended before its episode was over has panicked, or the emulator has.
fn end_of_the_firmware(ended: &Result<Traffic, EmulatorError>, passed_ms: u32) -> Option<Failure> {
    ended.as_ref().err().map(|error| Failure {
        time_ms: passed_ms,
        rule: Rule::Panic,
        text: error.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::generate::{Profile, episode};
    use super::super::machine::{DEFAULT_MACHINE, Machine};
    use super::*;
    use crate::setup;

    #[test]
    fn episodes_against_the_emulated_board_find_nothing() {
        setup::ensure_qemu().expect("the emulator can be had");
        let image = setup::build_firmware("emulated").expect("the firmware builds");
        let machine = Machine::load(DEFAULT_MACHINE).expect("a bundled machine");
        let episode = Episode {
            duration_ms: 4_000,
            ..for_the_image(&episode(&machine, 3, Profile::All))
        };
        let runs = [(); 2].map(|()| run_image(&image, &episode));
        println!("{} ms", runs[0].passed_ms);
        assert_eq!(runs[0].failure, None);
        assert!(runs[0].passed_ms > 4_000);
        assert_eq!(runs[0], runs[1], "every run is the same");
        let damaged = include_str!("../../../tests/campaign/memory-damaged-at-the-first-reading.toml");
        let run = run_image(&image, &Episode::parse(damaged).expect("a test case"));
        assert_eq!((run.failure, run.resets), (None, 1));
    }
}
