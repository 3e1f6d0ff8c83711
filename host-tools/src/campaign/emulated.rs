//! Episodes against a board's image: the firmware runs in the emulator, in lockstep with the same cell and operator.
//!
//! The emulator has a thread of its own; in each millisecond it waits for the operator, so that an episode gives the
//! same result in every run.

use super::episode::{Episode, What};
use super::operator::Operator;
use super::{Failure, LIMIT_MS, Rule, Run, caught, prepared};
use crate::emulator::{Emulator, EmulatorError, LINK_BYTES_MAX, Link, Options, Traffic};
use crate::simulation::Host;
use std::path::Path;
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
    let ((heard, from_firmware), (to_firmware, said)) = (sync_channel(0), sync_channel(0));
    let quiet = Options {
        decode_log: false,
        ..Options::default()
    };
    let emulator = match Emulator::start(image, &quiet, world, Bridge { heard, said }, |_| ()) {
        Ok(emulator) => emulator,
        Err(error) => return Run::failed(Rule::Episode, error.to_string()),
    };
    let passed_ms = operate(&mut operator, &from_firmware, &to_firmware);
    drop((from_firmware, to_firmware));
    let ended = emulator.stop();
    Run {
        failure: operator
            .into_failure()
            .or_else(|| end_of_the_firmware(&ended, passed_ms)),
        passed_ms,
    }
}

/// Answers the emulator until the episode is over; returns the virtual time, ms.
fn operate(
    operator: &mut Operator,
    from_firmware: &Receiver<(u32, Vec<u8>)>,
    to_firmware: &SyncSender<Vec<u8>>,
) -> u32 {
    let mut passed_ms = 0;
    while let Ok((ms, bytes)) = from_firmware.recv() {
        passed_ms = ms;
        let mut answer = Vec::new();
        operator.exchange(ms, &bytes, &mut answer, LINK_BYTES_MAX);
        if operator.is_over() || ms >= LIMIT_MS || to_firmware.send(answer).is_err() {
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
    }
}
