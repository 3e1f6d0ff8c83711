//! Episodes against a board's image: the firmware runs in the emulator, in lockstep with the same cell and operator.
//!
//! The emulator has a thread of its own; in each millisecond it waits for the operator, so that an episode gives the
//! same result in every run. The black box is read from the board's memory at the first fault and at each end of a run; a
//! firmware that panics leaves it as a file. A [`Witness`] says what it has to hold, and it has to replay.

use super::episode::Episode;
use super::operator::Operator;
use super::witness::Witness;
use super::world::World;
use super::{Failure, LIMIT_MS, Rule, Run, begun_later, caught, prepared, with_resets};
use crate::emulator::{
    Area, Around, Emulator, EmulatorError, LINK_BYTES_MAX, Later, Link, OneProcessor, Options, Segment, Traffic,
};
use crate::simulation::{Host, Surroundings};
use etherpen::black_box::recording::Origin;
use etherpen::board::PortState;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// What the emulator's end of the link tells the operator.
enum Heard {
    /// The firmware's bytes of a millisecond.
    Bytes(u32, Vec<u8>),
    /// A memory that was asked for.
    Memory(Area, Vec<u8>),
}

/// What the operator answers.
#[derive(Default)]
struct Said {
    bytes: Vec<u8>,
    around: Around,
    wants: Vec<Area>,
}

/// The emulator's end of the link: asks the operator and waits for the answer.
struct Bridge {
    heard: SyncSender<Heard>,
    said: Receiver<Said>,
    around: Around,
    wanted: Vec<Area>,
}

impl Link for Bridge {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        // An operator who is gone says nothing.
        if self.heard.send(Heard::Bytes(ms, from_device.to_vec())).is_ok()
            && let Ok(said) = self.said.recv()
        {
            to_device.extend(said.bytes);
            self.around = said.around;
            self.wanted = said.wants;
        }
    }

    fn wants(&mut self) -> Option<Area> {
        self.wanted.pop()
    }

    fn take_memory(&mut self, area: Area, bytes: Vec<u8>) {
        // As above.
        let _ = self.heard.send(Heard::Memory(area, bytes));
    }

    fn around(&mut self) -> Around {
        self.around
    }
}

/// What a board's wire leads to, until it is switched off: the emulator ends a little later than it is told.
struct Connected {
    segment: Later<World>,
    is_off: Arc<AtomicBool>,
    witness: Witness,
}

impl Segment for Connected {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        match self.is_off.load(Ordering::Acquire) {
            true => Vec::new(),
            false => {
                self.witness.reaches(time_us);
                let replies = self.segment.frame(time_us, frame);
                self.witness.passes(frame, &replies);
                replies
            }
        }
    }

    fn advance_to(&mut self, time_us: u64) {
        if !self.is_off.load(Ordering::Acquire) {
            self.witness.reaches(time_us);
            self.segment.advance_to(time_us);
        }
    }
}

/// How an image is run.
pub(super) struct Plan<'p> {
    pub(super) image: &'p Path,
    /// Changes each black box that was read, for tests.
    pub(super) damage: &'p dyn Fn(&mut Vec<u8>, &Witness),
}

impl<'p> Plan<'p> {
    pub(super) fn new(image: &'p Path) -> Self {
        Self {
            image,
            damage: &|_, _| (),
        }
    }
}

thread_local! {
    /// The operator takes turns with the emulator and who answers it.
    static PROCESSOR: OneProcessor = OneProcessor::take();
}

/// Runs an episode against a firmware image. From then on the thread stays on one processor.
#[must_use]
pub fn run_image(image: &Path, episode: &Episode) -> Run {
    PROCESSOR.with(|_| ());
    caught(|| {
        if episode.by_jobs {
            let text = "the program's own jobs draw in this episode: run it without --emulated";
            return Run::failed(Rule::Episode, text.to_owned());
        }
        let (config, world) = match prepared(episode) {
            Ok(prepared) => prepared,
            Err(failed) => return failed,
        };
        let mut operator = Operator::new(episode, config, world.clone());
        run_watched(&Plan::new(image), &mut operator, &world)
    })
}

/// Runs an operator's episode against an image.
pub(super) fn run_watched(plan: &Plan, operator: &mut Operator, world: &World) -> Run {
    let (passed_ms, ended) = with_resets(LIMIT_MS, operator, |operator, begun_ms, left_ms| {
        match run_from(plan, begun_later(world, begun_ms), operator, left_ms) {
            Ok((ran_ms, ended)) => (ran_ms, Ok(ended)),
            Err(error) => (0, Err(error)),
        }
    });
    match ended {
        Ok(ended) => Run {
            passed_ms,
            resets: operator.resets(),
            failure: operator.failure().or_else(|| ended.failure(passed_ms)),
        },
        Err(error) => Run::failed(Rule::Episode, error.to_string()),
    }
}

/// How the emulator ended, and what is wrong with the black box of a firmware that ended by itself.
struct Ended {
    result: Result<Traffic, EmulatorError>,
    black_box: Result<(), String>,
}

impl Ended {
    /// A firmware that ended before its episode was over has panicked, or the emulator has.
    fn failure(&self, passed_ms: u32) -> Option<Failure> {
        let error = self.result.as_ref().err()?;
        let black_box = self.black_box.as_ref().err();
        let black_box = black_box.map_or_else(String::new, |why| format!("\nits black box: {why}"));
        Some(Failure {
            time_ms: passed_ms,
            rule: Rule::Panic,
            text: format!("{error}{black_box}"),
        })
    }
}

/// Runs the image from its start to the episode's end or the operator's reset; returns the time, ms, and how the emulator ended.
///
/// # Errors
/// The emulator does not start.
fn run_from(
    plan: &Plan,
    segment: Later<World>,
    operator: &mut Operator,
    limit_ms: u32,
) -> Result<(u32, Ended), EmulatorError> {
    let ((heard, from_firmware), (to_firmware, said)) = (sync_channel(0), sync_channel(0));
    let quiet = Options {
        decode_log: false,
        ..Options::default()
    };
    let (is_off, witness) = (Arc::new(AtomicBool::new(false)), Witness::default());
    let connected = Connected {
        segment,
        is_off: Arc::clone(&is_off),
        witness: witness.clone(),
    };
    let bridge = Bridge {
        heard,
        said,
        around: Around::default(),
        wanted: Vec::new(),
    };
    let emulator = Emulator::start(plan.image, &quiet, connected, bridge, |_| ())?;
    let ran_ms = Conversation {
        plan,
        operator,
        witness: &witness,
        from_firmware: &from_firmware,
        to_firmware: &to_firmware,
    }
    .hold(limit_ms);
    // It waits for its answer.
    is_off.store(true, Ordering::Release);
    drop((from_firmware, to_firmware));
    let result = emulator.stop();
    let black_box = left_black_box(&result, operator, &witness);
    Ok((ran_ms, Ended { result, black_box }))
}

/// Looks at the black box that a firmware has left that ended by itself; its file stays for people.
fn left_black_box(
    ended: &Result<Traffic, EmulatorError>,
    operator: &Operator,
    witness: &Witness,
) -> Result<(), String> {
    let Err(EmulatorError::Ended { black_box, .. }) = ended else {
        return Ok(());
    };
    let file = black_box.as_ref().ok_or("there is none")?;
    let memory = std::fs::read(file).map_err(|cause| cause.to_string())?;
    let found = operator.examine(&memory, witness, Origin::Crashed);
    found.map_err(|(rule, text)| format!("{rule}: {text}"))
}

/// The operator's side of the link.
struct Conversation<'a, 'e> {
    plan: &'a Plan<'a>,
    operator: &'a mut Operator<'e>,
    witness: &'a Witness,
    from_firmware: &'a Receiver<Heard>,
    to_firmware: &'a SyncSender<Said>,
}

impl Conversation<'_, '_> {
    /// Answers the emulator until the episode is over, the board is reset or the emulator ends; returns the virtual time, ms.
    fn hold(mut self, limit_ms: u32) -> u32 {
        let mut passed_ms = 0;
        while let Ok(heard) = self.from_firmware.recv() {
            let Heard::Bytes(ms, bytes) = heard else { continue };
            passed_ms = ms;
            let mut said = Said::default();
            self.operator.exchange(ms, &bytes, &mut said.bytes, LINK_BYTES_MAX);
            self.operator.testifies(self.witness, ms);
            let is_over = self.operator.is_over() || ms >= limit_ms;
            said.around = around(&self.operator.surroundings());
            if self.operator.wants_black_box() || is_over {
                said.wants.push(Area::BlackBox);
            }
            let wanted = said.wants.len();
            let is_running = self.to_firmware.send(said).is_ok() && (0..wanted).all(|_| self.takes_memory());
            // What the black box holds may have ended the episode.
            if !is_running || is_over || self.operator.is_over() {
                break;
            }
        }
        passed_ms
    }

    /// Takes a memory that was asked for; returns false if the emulator has ended.
    fn takes_memory(&mut self) -> bool {
        match self.from_firmware.recv() {
            Ok(Heard::Memory(Area::BlackBox, mut memory)) => {
                (self.plan.damage)(&mut memory, self.witness);
                self.operator.judges_black_box(&memory, self.witness);
                true
            }
            _ => false,
        }
    }
}

/// What the emulated board is told of its surroundings.
fn around(surroundings: &Surroundings) -> Around {
    Around {
        stop_shows_open: surroundings.stop_shows_open,
        substitute_clock: surroundings.substitute_clock,
        trajectory_waits: surroundings.trajectory_waits,
        port_is_down: surroundings.board.port == PortState::Down,
    }
}

#[cfg(test)]
mod tests;
