//! The operator of an episode: events at their times, decisions from what the controller reports, and the healing.
//!
//! The operator sees what a person at the console sees: the reports that the line has carried. Only the robot's pose, and
//! whether it rests, are taken from the cell, as a person beside it would see them. When the episode's time is over,
//! everything is healed; then the robot has to come back and draw [`test_figure`].

mod decisions;
mod events;

use super::chance::Chance;
use super::counted;
use super::episode::{Episode, Figure};
use super::ink;
use super::judge::{Interlocks, Judge, ink_limit_mm};
use super::line::Line;
use super::machine::Chain;
use super::witness::Witness;
use super::world::World;
use super::{Failure, Rule};
use crate::black_box;
use crate::black_box::contents::{Contents, EventEntry};
use crate::black_box::replay::{Replay, replay};
use crate::cell::Clocks;
use crate::link::session::{Event as LinkEvent, Session};
use crate::simulation::{Host, Surroundings};
use etherpen::application::{Fault as Reason, InputCause, Mode, Refusal};
use etherpen::black_box::Memory;
use etherpen::black_box::recording::Origin;
use etherpen::board::PortState;
use etherpen::config::{Config, Paper};
use etherpen::link::frame::Decoder;
use etherpen::link::message::PathAck;
use etherpen::messages::{Command, PathVertex, Status};
use std::sync::Arc;

/// Longest time from the healing to the end of the test drawing, without the drawing itself, ms.
const LIVENESS_MAX_MS: u32 = 60_000;
/// Longest time from the order to switch off until all drives are without power, ms.
const OFF_MAX_MS: u32 = 3_000;
/// Events that a failed replay names: from so much before the difference to as much after it, s.
const NEAR_S: f64 = 0.01;
/// First number of commands beside the session, far from its own.
const FIRST_BESIDE: u16 = 0x8000;
/// Last byte of each frame of the link.
const FRAME_END: u8 = 0;

/// What the operator is about.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Events happen; the operator works.
    Free,
    /// Everything is healed; the test drawing has to come.
    Healed { since_ms: u32 },
    /// The test drawing is being drawn; it began with so much ink.
    Testing { since_ms: u32, inked: usize },
    /// It is drawn; the power has to go off.
    Ending { since_ms: u32 },
    /// Over.
    Over,
}

/// Conditions of the board that end at a time, ms.
#[derive(Clone, Copy, Debug, Default)]
struct Board {
    stop_until_ms: u32,
    substitute_until_ms: u32,
    trajectory_until_ms: u32,
    port_until_ms: u32,
}

impl Board {
    fn interlocks(&self, now_ms: u32) -> Interlocks {
        Interlocks {
            stop_open: now_ms < self.stop_until_ms,
            clock_failed: now_ms < self.substitute_until_ms,
        }
    }
}

/// The operator.
pub(super) struct Operator<'e> {
    episode: &'e Episode,
    config: Config,
    world: World,
    judge: Judge,
    chain: Chain,
    has_switches: bool,
    session: Session,
    connections: u32,
    up: Line,
    down: Line,
    board: Board,
    /// When the board began, and how often the operator has reset it.
    begun_ms: u32,
    resets: u32,
    presses_reset: bool,
    /// Whether the board has reported its slaves as ready, and whether memories were faulty or slaves exchanged before.
    has_been_ready: bool,
    misled_at_first: bool,
    now_ms: u32,
    stage: Stage,
    next_event: usize,
    next_wish: usize,
    decide_ms: u32,
    awaited: Option<(u16, u32)>,
    configured_ms: Option<u32>,
    /// Acknowledgements since the robot was last ready.
    acknowledged: u32,
    /// Whether the drives were refused their power because a terminal that is needed is missing.
    misses_terminal: bool,
    beside: u16,
    at_once: Vec<u8>,
    /// Commands beside the session that are not answered, and what reads their answers.
    unanswered: Vec<(u16, Command)>,
    decoder: Box<Decoder>,
    jog: Option<([f32; 3], u32)>,
    job: u16,
    drawing: Arc<[PathVertex]>,
    status: Option<Status>,
    ack: PathAck,
    /// Places tried after the straight way to the test drawing was refused, and whether the next one is to be tried.
    detours: (u64, bool),
    /// Executed vertices when the drawing last advanced, and the time.
    advanced: (u32, u32),
    swapped: Vec<usize>,
    /// Pairs of slaves that were put at each other's places, in order.
    recabled: Vec<(usize, usize)>,
    /// Whether the recording of the first fault was replayed.
    has_replayed: bool,
    failure: Option<Failure>,
}

/// The drawing in the middle of the sheet with which a healed machine has to show that it draws.
pub(super) fn test_figure(paper: &Paper) -> Figure {
    let [centre_x_um, centre_y_um] = paper.centre_mm.map(|mm| (mm * 1e3).round() as i32);
    let zigzag = |y_um: i32| {
        let x_um = |leg: i32| if leg % 2 == 0 { -6_000 } else { 6_000 };
        let points = (0..6).map(|leg| [centre_x_um + x_um(leg), centre_y_um + y_um + 1_500 * leg]);
        points.collect()
    };
    Figure(vec![zigzag(-9_000), zigzag(3_000)])
}

impl<'e> Operator<'e> {
    pub(super) fn new(episode: &'e Episode, config: Config, world: World) -> Self {
        let judge = Judge::new(&config);
        let mut operator = Self {
            episode,
            judge,
            chain: Chain::new(&config),
            has_switches: config.has_home_switches(),
            world,
            session: Session::new(1),
            connections: 0,
            up: Line::new(episode.seed),
            down: Line::new(!episode.seed),
            board: Board::default(),
            begun_ms: 0,
            resets: 0,
            presses_reset: false,
            has_been_ready: false,
            misled_at_first: false,
            now_ms: 0,
            stage: Stage::Free,
            next_event: 0,
            next_wish: 0,
            decide_ms: 0,
            awaited: None,
            configured_ms: None,
            acknowledged: 0,
            misses_terminal: false,
            beside: FIRST_BESIDE,
            at_once: Vec::new(),
            unanswered: Vec::new(),
            decoder: Box::default(),
            jog: None,
            job: 0,
            drawing: Arc::default(),
            status: None,
            ack: PathAck::default(),
            detours: (0, false),
            advanced: (0, 0),
            swapped: Vec::new(),
            recabled: Vec::new(),
            has_replayed: false,
            failure: None,
            config,
        };
        operator.reconnect();
        operator
    }

    /// How often the operator has reset the board.
    pub(super) const fn resets(&self) -> u32 {
        self.resets
    }

    /// Whether the operator resets the board: nothing else ends its fault.
    pub(super) const fn presses_reset(&self) -> bool {
        self.presses_reset
    }

    /// The board begins again, and remembers nothing.
    pub(super) fn begin_again(&mut self, now_ms: u32) {
        (self.begun_ms, self.now_ms) = (now_ms, now_ms);
        (self.presses_reset, self.resets) = (false, self.resets + 1);
        (self.status, self.ack, self.acknowledged) = (None, PathAck::default(), 0);
        self.judge.board_was_reset(&self.config);
        self.reconnect();
    }

    /// What the episode has found.
    pub(super) fn failure(&self) -> Option<Failure> {
        self.failure.clone()
    }

    /// The drawing that was reported last as executed to its end.
    #[cfg(test)]
    pub(super) fn finished(&self) -> Option<u16> {
        self.judge.finished()
    }

    /// Whether a fault is reported.
    #[cfg(test)]
    pub(super) fn hears_a_fault(&self) -> bool {
        self.status.as_ref().is_some_and(|status| status.fault.is_some())
    }

    /// Whether the faults are over and everything was healed.
    #[cfg(test)]
    pub(super) fn is_healed(&self) -> bool {
        self.stage != Stage::Free
    }

    fn fail(&mut self, rule: Rule, text: String) {
        self.failure.get_or_insert(Failure {
            time_ms: self.now_ms,
            rule,
            text,
        });
        self.stage = Stage::Over;
    }

    fn reconnect(&mut self) {
        self.connections += 1;
        // The number only has to differ from the last one's.
        self.session = Session::new(Chance::new(self.episode.seed ^ u64::from(self.connections)).below(1 << 31) as u32);
        self.session.connect();
        self.judge.reconnected();
        (self.awaited, self.configured_ms, self.jog) = (None, None, None);
        self.unanswered.clear();
    }

    fn mode(&self) -> Mode {
        self.status.as_ref().map_or(Mode::Startup, |status| status.mode)
    }

    /// Moves on to the next stage when the present one is over or has taken too long.
    fn advance(&mut self) {
        let now_ms = self.now_ms;
        match self.stage {
            Stage::Free if now_ms >= self.episode.duration_ms => {
                self.heal();
                self.stage = match self.episode.draws {
                    true => Stage::Healed { since_ms: now_ms },
                    false => Stage::Over,
                };
            }
            Stage::Healed { since_ms } | Stage::Testing { since_ms, .. }
                if now_ms > since_ms + LIVENESS_MAX_MS + self.drawing_max_ms() =>
            {
                let text = format!("healed, and no drawing came: {:?}", self.status);
                self.fail(Rule::Liveness, text);
            }
            Stage::Testing { inked, .. } if self.has_drawn() => {
                let limit_mm = ink_limit_mm(&self.config);
                let (paper, path) = (self.config.paper, Arc::clone(&self.drawing));
                let verdict = self
                    .world
                    .look(|cell, _| ink::compare(cell.ink(), inked, &path, &paper, limit_mm));
                match verdict {
                    Ok(()) => {
                        self.say(Command::Disable);
                        self.stage = Stage::Ending { since_ms: now_ms };
                    }
                    Err(text) => self.fail(Rule::Ink, format!("the test drawing: {text}")),
                }
            }
            Stage::Ending { since_ms } => {
                let has_power = self.world.truth().has_power.contains(&true);
                match (has_power, now_ms > since_ms + OFF_MAX_MS) {
                    (false, _) => {
                        self.stage = Stage::Over;
                        self.end();
                    }
                    (true, true) => self.fail(Rule::Power, format!("the power stays on: {:?}", self.status)),
                    (true, false) => {}
                }
            }
            _ => {}
        }
    }

    /// Judges what can only be judged at the end.
    fn end(&mut self) {
        // A board that was reset has counted only what came behind.
        if self.resets == 0 {
            let (episode, config) = (self.episode, &self.config);
            let injected = |world: &World| world.look(|cell, _| counted::expected(episode, config, cell.injected()));
            for (name, count) in injected(&self.world).into_iter().flatten() {
                self.judge.expect(name, count);
            }
        }
        if let Err((rule, text)) = self.judge.end() {
            self.fail(rule, text);
        }
    }

    /// Time that the test drawing may take, ms.
    fn drawing_max_ms(&self) -> u32 {
        let motion = &self.config.motion;
        let mm = 300.0;
        let slowest_mm_s = motion.speed_mm_s.min(motion.travel_speed_mm_s);
        // An input shaper has at most two periods of its resonance, and a tenth for damping.
        let rest_ms = f64::from(motion.pen_dwell_ms).max(2.2e3 / motion.resonance_hz);
        let strokes_ms = 4.0 * rest_ms;
        (3_000.0 * mm / slowest_mm_s + strokes_ms) as u32
    }

    /// Whether the black box is to be looked at now: at the first fault, and at the end.
    pub(super) fn wants_black_box(&mut self) -> bool {
        let has_fault = self.status.as_ref().is_some_and(|status| status.fault.is_some());
        self.stage == Stage::Over || (has_fault && !std::mem::replace(&mut self.has_replayed, true))
    }

    /// Replays the last two seconds: the black box has to hold what led to each result.
    fn replay(&self, contents: &Contents) -> Result<(), (Rule, String)> {
        // There may be too little to replay.
        match replay(contents, &self.config) {
            Ok(Replay {
                difference: Some(difference),
                ..
            }) => {
                let near = |entry: &&EventEntry| (entry.before_end_s - difference.before_end_s).abs() < NEAR_S;
                let events: Vec<String> = (contents.events.iter().filter(near))
                    .map(|entry| format!("{:.0} ms ago {}", entry.before_end_s * 1e3, entry.text))
                    .collect();
                let what = &difference.what;
                let text = format!(
                    "{:.0} ms ago, {what}; events: {events:?}",
                    difference.before_end_s * 1e3
                );
                Err((Rule::Replay, text))
            }
            _ => Ok(()),
        }
    }

    /// Tells a witness what is true and reported in a millisecond of the board.
    pub(super) fn testifies(&self, witness: &Witness, ms: u32) {
        let angles_rad = self.judge.shows_positions().then(|| self.world.truth().angles_rad);
        let reported = self.status.as_ref().map(|status| (status.mode, status.fault));
        witness.moment(ms, angles_rad, reported);
    }

    /// Looks whether a black box holds what the witness has seen, and replays it.
    ///
    /// # Errors
    /// The rule that is broken, and how.
    pub(super) fn examine(&self, memory: &[u8], witness: &Witness, origin: Origin) -> Result<(), (Rule, String)> {
        let contents = Contents::of(memory).map_err(|why| (Rule::BlackBox, format!("{why:?}")))?;
        witness
            .check(&contents, origin, self.config.bus.drives.into())
            .map_err(|text| (Rule::BlackBox, text))?;
        self.replay(&contents)
    }

    /// Judges the black box of the present run.
    pub(super) fn judges_black_box(&mut self, memory: &[u8], witness: &Witness) {
        if let Err((rule, text)) = self.examine(memory, witness, Origin::Present) {
            self.fail(rule, text);
        }
    }

    fn has_drawn(&self) -> bool {
        self.ack.finished && self.ack.job == self.job && self.mode() == Mode::Idle
    }

    fn take(&mut self, event: LinkEvent) {
        match event {
            LinkEvent::Answered { id, command, result } => {
                self.awaited.take_if(|(awaited, _)| *awaited == id);
                self.misses_terminal = matches!(
                    (&command, result),
                    (
                        Command::Enable,
                        Err(Refusal::CauseRemains(Reason::StopInput {
                            cause: InputCause::Missing,
                            ..
                        }))
                    )
                );
                self.detours.1 |=
                    self.stage != Stage::Free && matches!(command, Command::Move { .. }) && result.is_err();
                self.judge.answered(&command, result.is_ok());
            }
            LinkEvent::Ack(ack) => {
                if ack.finished && ack.job == self.job {
                    self.judge.drawn(ack.job);
                }
                self.ack = ack;
            }
            LinkEvent::VertexRefused(refusal) => {
                self.detours.1 |= self.stage != Stage::Free;
                self.judge.refused_vertex(self.job, refusal.index);
            }
            LinkEvent::Status(status) => {
                self.judge.reported(&status);
                self.has_been_ready |= !matches!(status.mode, Mode::Startup | Mode::BusConfiguring | Mode::Fault);
                self.status = Some(status);
            }
            LinkEvent::Restarted => self.reconnect(),
            LinkEvent::VersionRefused { .. } => self.fail(Rule::Panic, "the versions differ".to_owned()),
            LinkEvent::Connected(_)
            | LinkEvent::Configured(_)
            | LinkEvent::Samples { .. }
            | LinkEvent::Bus(_)
            | LinkEvent::Measured(_) => {}
        }
    }

    /// Takes what the firmware sent, decides, and says what is due.
    fn converse(&mut self, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        let mut heard = from_firmware.to_vec();
        self.up.carry(self.now_ms, &mut heard);
        // Frame by frame, so that the answers are told in the order in which they were given.
        for frame in heard.split_inclusive(|byte| *byte == FRAME_END) {
            self.hear_beside(frame);
            self.session.receive(frame, self.now_ms.into());
            while let Some(event) = self.session.next_event() {
                self.take(event);
            }
        }
        self.advance();
        if self.now_ms >= self.decide_ms && !matches!(self.stage, Stage::Ending { .. } | Stage::Over) {
            self.decide();
        }
        self.repeat_jog();
        to_firmware.resize(room, 0);
        let length = self.session.transmit(self.now_ms.into(), to_firmware);
        to_firmware.truncate(length);
        // Not in the middle of a frame of the session's.
        if length == 0 {
            let taken = self.at_once.len().min(room);
            to_firmware.extend(self.at_once.drain(..taken));
        }
        self.down.carry(self.now_ms, to_firmware);
        self.judge.delivered(to_firmware);
    }
}

impl Host for Operator<'_> {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        let ms = self.begun_ms + ms;
        self.now_ms = ms;
        let episode = self.episode;
        while let Some(event) = episode.events.get(self.next_event).filter(|event| event.at_ms <= ms) {
            self.next_event += 1;
            if self.stage == Stage::Free {
                self.happen(event);
            }
        }
        let interlocks = self.board.interlocks(ms);
        let verdict = {
            let (world, judge, has_clocks) = (&self.world, &mut self.judge, self.config.bus.clocks);
            world.look(|cell, frames| {
                let clocks = if has_clocks { cell.clocks() } else { Clocks::default() };
                judge.moment(ms, &cell.truth(), frames, &clocks, interlocks)
            })
        };
        if let Err((rule, text)) = verdict {
            self.fail(rule, text);
        }
        self.converse(from_firmware, to_firmware, room);
    }

    fn surroundings(&mut self) -> Surroundings {
        let now_ms = self.now_ms;
        let Interlocks {
            stop_open,
            clock_failed,
        } = self.board.interlocks(now_ms);
        let mut around = Surroundings {
            stop_shows_open: stop_open,
            substitute_clock: clock_failed,
            trajectory_waits: now_ms < self.board.trajectory_until_ms,
            ..Surroundings::default()
        };
        if now_ms < self.board.port_until_ms {
            around.board.port = PortState::Down;
        }
        around
    }

    fn recorded(&mut self, black_box: &Memory) {
        if !self.wants_black_box() {
            return;
        }
        let replayed = Contents::of(&black_box::image(black_box))
            .map_err(|why| (Rule::Replay, format!("{why:?}")))
            .and_then(|contents| self.replay(&contents));
        if let Err((rule, text)) = replayed {
            self.fail(rule, text);
        }
    }

    fn is_over(&self) -> bool {
        self.stage == Stage::Over || self.presses_reset
    }
}
