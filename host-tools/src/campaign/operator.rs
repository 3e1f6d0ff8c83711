//! The operator of an episode: events at their times, decisions from what the controller reports, and the healing.
//!
//! The operator sees what a person at the console sees: the reports that the line has carried. Only the robot's pose is
//! taken from the cell, as a person would measure it. When the episode's time is over, everything is healed; then the
//! robot has to come back and draw [`test_figure`].

use super::chance::Chance;
use super::counted;
use super::episode::{Episode, Event, Figure, What, Wish};
use super::ink;
use super::judge::{Judge, ink_limit_mm};
use super::line::Line;
use super::world::World;
use super::{Failure, Rule};
use crate::cell::Fault;
use crate::link::session::{Event as LinkEvent, Session};
use crate::simulation::{Host, Surroundings};
use etherpen::application::{Fault as Reason, Mode};
use etherpen::board::PortState;
use etherpen::config::Config;
use etherpen::ethercat::diagnostics::ServiceRequest;
use etherpen::ethercat::state::AlState;
use etherpen::link::frame::{Decoder, FRAME_BYTES_MAX, decode, encode};
use etherpen::link::message::PathAck;
use etherpen::messages::{Command, DeviceMessage, HostMessage, PathVertex, Status};
use etherpen::motion::Pen;
use etherpen::robots::{JointAngles, Position};
use std::sync::Arc;

/// Distance of all joints from their marks within which the operator homes at the marks, rad.
const AT_MARKS_RAD: f64 = 0.15;
/// Longest wait for an answer, ms.
const ANSWER_MAX_MS: u32 = 1_500;
/// Silence after which the operator connects again, ms.
const SILENCE_MAX_MS: u64 = 3_000;
/// Time between two messages of a jog, ms.
const JOG_REPEAT_MS: u32 = 20;
/// Time without progress after which the operator gives a drawing up, ms.
const PATIENCE_MAX_MS: u32 = 8_000;
/// Acknowledgements without effect after which the configuration is sent again: the bus may have become another one.
const ACKNOWLEDGED_MAX: u32 = 3;
/// Drives that can be put in the place of another one: product code, and the name in the script of faults.
const PRODUCTS: [(u32, &str); 2] = [(0x07D0_6014, "ax2000"), (0x0402, "cia402")];
/// Pause between two decisions once everything is healed, ms.
const HEALED_PATIENCE_MS: u32 = 100;
/// Longest time from the healing to the end of the test drawing, without the drawing itself, ms.
const LIVENESS_MAX_MS: u32 = 60_000;
/// Longest time from the order to switch off until all drives are without power, ms.
const OFF_MAX_MS: u32 = 3_000;
/// First number of commands beside the session, far from its own.
const FIRST_BESIDE: u16 = 0x8000;

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

/// The operator.
pub(super) struct Operator<'e> {
    episode: &'e Episode,
    config: Config,
    world: World,
    judge: Judge,
    session: Session,
    connections: u32,
    up: Line,
    down: Line,
    board: Board,
    now_ms: u32,
    stage: Stage,
    next_event: usize,
    next_wish: usize,
    decide_ms: u32,
    awaited: Option<(u16, u32)>,
    configured_ms: Option<u32>,
    /// Acknowledgements since the robot was last ready.
    acknowledged: u32,
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
    /// Executed vertices when the drawing last advanced, and the time.
    advanced: (u32, u32),
    swapped: Vec<usize>,
    failure: Option<Failure>,
}

/// The drawing with which a healed machine has to show that it draws.
pub(super) fn test_figure() -> Figure {
    let zigzag = |y_um: i32| {
        let points = (0..6).map(|leg| [if leg % 2 == 0 { -6_000 } else { 6_000 }, y_um + 1_500 * leg]);
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
            world,
            session: Session::new(1),
            connections: 0,
            up: Line::new(episode.seed),
            down: Line::new(!episode.seed),
            board: Board::default(),
            now_ms: 0,
            stage: Stage::Free,
            next_event: 0,
            next_wish: 0,
            decide_ms: 0,
            awaited: None,
            configured_ms: None,
            acknowledged: 0,
            beside: FIRST_BESIDE,
            at_once: Vec::new(),
            unanswered: Vec::new(),
            decoder: Box::default(),
            jog: None,
            job: 0,
            drawing: Arc::default(),
            status: None,
            ack: PathAck::default(),
            advanced: (0, 0),
            swapped: Vec::new(),
            failure: None,
            config,
        };
        operator.reconnect();
        operator
    }

    /// What the episode has found.
    pub(super) fn into_failure(self) -> Option<Failure> {
        self.failure
    }

    /// The drawing that was reported last as executed to its end.
    #[cfg(test)]
    pub(super) fn finished(&self) -> Option<u16> {
        self.judge.finished()
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

    /// Makes an event happen.
    fn happen(&mut self, event: &Event) {
        let until = |duration_ms: u32| event.at_ms.saturating_add(duration_ms);
        match &event.what {
            What::Fault(words) => self.inject(words),
            What::Frames(words, count) => {
                if let Ok(fault) = words.parse::<Fault>() {
                    self.world.inject_into_frames(fault, *count);
                    self.judge.injected(fault, *count, self.now_ms);
                }
            }
            What::Command(command) => drop(self.session.command(*command)),
            What::Beside(command) => self.put_beside(*command),
            What::State(slave, state) => {
                let state = match state {
                    1 => AlState::Init,
                    2 => AlState::PreOperational,
                    4 => AlState::SafeOperational,
                    _ => AlState::Operational,
                };
                self.session.bus(ServiceRequest::SetState { slave: *slave, state });
            }
            What::Reconnect => self.reconnect(),
            What::Unplug(duration_ms) => {
                self.up.unplug(until(*duration_ms));
                self.down.unplug(until(*duration_ms));
                self.judge.unplugged(until(*duration_ms));
            }
            What::Noise(duration_ms, per_mille) => {
                self.up.disturb(until(*duration_ms), *per_mille);
                self.down.disturb(until(*duration_ms), *per_mille);
            }
            What::StopInput(duration_ms) => self.board.stop_until_ms = until(*duration_ms),
            What::SubstituteClock(duration_ms) => self.board.substitute_until_ms = until(*duration_ms),
            What::TrajectoryWaits(duration_ms) => {
                self.board.trajectory_until_ms = until(*duration_ms);
                self.judge.disturbed(self.now_ms, Some((*duration_ms).into()));
            }
            What::PortDown(duration_ms) => {
                self.board.port_until_ms = until(*duration_ms);
                self.judge.disturbed(self.now_ms, Some((*duration_ms).into()));
            }
        }
    }

    /// Injects a fault of the segment's script; [`Episode::parse`] has read its words before.
    fn inject(&mut self, words: &str) {
        let Ok(fault) = words.parse::<Fault>() else { return };
        if let Fault::Swap(slave, _) = fault {
            self.swapped.push(slave);
        }
        self.world.inject(fault);
        self.judge.injected(fault, 1, self.now_ms);
    }

    /// Sends a command beside the session, which sends one after the other.
    fn put_beside(&mut self, command: Command) {
        self.beside = self.beside.wrapping_add(1).max(FIRST_BESIDE);
        let id = self.beside;
        let mut frame = [0; FRAME_BYTES_MAX];
        if let Ok(length) = encode(&HostMessage::Command { id, command }, &mut frame) {
            self.at_once.extend(frame.iter().take(length));
            self.unanswered.push((id, command));
        }
    }

    /// Hears the answers to commands beside the session.
    fn hear_beside(&mut self, heard: &[u8]) {
        if self.unanswered.is_empty() {
            return;
        }
        for byte in heard {
            let Some(Ok(payload)) = self.decoder.push(*byte) else {
                continue;
            };
            let Ok(DeviceMessage::Answer { id, result }) = decode::<DeviceMessage>(payload) else {
                continue;
            };
            if let Some(index) = self.unanswered.iter().position(|(asked, _)| *asked == id) {
                let (_, command) = self.unanswered.swap_remove(index);
                self.judge.answered(&command, result.is_ok());
            }
        }
    }

    /// Ends all faults: what was cut, removed, exchanged or damaged is restored.
    fn heal(&mut self) {
        self.board = Board::default();
        self.up.heal();
        self.down.heal();
        self.world.spare_frames();
        self.inject("join");
        let drives = self.config.axes.len();
        for slave in 1..=drives {
            self.inject(&format!("insert {slave}"));
            self.inject(&format!("sii {slave} whole"));
            self.inject(&format!("stuck {slave} 0"));
        }
        for slave in std::mem::take(&mut self.swapped) {
            self.inject(&format!("swap {slave} ax2000"));
        }
        self.judge.healed();
        (self.jog, self.job) = (None, self.job.wrapping_add(1));
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
        let counts = {
            let (episode, config) = (self.episode, &self.config);
            self.world
                .look(|cell, _| counted::expected(episode, config, cell.injected()))
        };
        for (name, count) in counts.into_iter().flatten() {
            self.judge.expect(name, count);
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
        let strokes_ms = 4.0 * f64::from(motion.pen_dwell_ms);
        (3_000.0 * mm / slowest_mm_s + strokes_ms) as u32
    }

    fn has_drawn(&self) -> bool {
        self.ack.finished && self.ack.job == self.job && self.mode() == Mode::Idle
    }

    fn say(&mut self, command: Command) {
        self.awaited = Some((self.session.command(command), self.now_ms));
        self.session.inquire();
    }

    /// Decides what to do from what was reported last.
    fn decide(&mut self) {
        let is_free = self.stage == Stage::Free;
        let patience_ms = if is_free {
            self.episode.patience_ms
        } else {
            HEALED_PATIENCE_MS
        };
        self.decide_ms = self.now_ms + patience_ms.max(1);
        if self
            .session
            .silence_ms(self.now_ms.into())
            .is_some_and(|ms| ms > SILENCE_MAX_MS)
        {
            return self.reconnect();
        }
        self.session.inquire();
        if self
            .awaited
            .is_some_and(|(_, since_ms)| self.now_ms < since_ms + ANSWER_MAX_MS)
            || self.jog.is_some()
        {
            return;
        }
        let Some(status) = &self.status else { return };
        let (mode, homed, recovering) = (status.mode, status.referenced, status.recovering);
        let is_configured = status.config == self.config.hash();
        if mode == Mode::Idle {
            self.acknowledged = 0;
        }
        match mode {
            _ if recovering => {}
            Mode::Fault if self.acknowledged >= ACKNOWLEDGED_MAX => {
                self.acknowledged = 0;
                self.configure();
            }
            Mode::Fault => {
                self.acknowledged += 1;
                self.put_right();
                self.say(Command::Acknowledge);
            }
            Mode::Startup | Mode::BusConfiguring | Mode::DrivesOff if !is_configured => self.configure(),
            Mode::Startup | Mode::BusConfiguring | Mode::Stopping | Mode::Moving => {}
            Mode::DrivesOff | Mode::Unreferenced if !homed => self.home(),
            Mode::DrivesOff => self.say(Command::Enable),
            Mode::Unreferenced => self.say(Command::Disable),
            Mode::Idle if is_free => self.wish(),
            Mode::Idle => self.draw_test(),
            Mode::Drawing | Mode::Holding if self.ack.job != self.job || self.is_stuck() => self.say(Command::Cancel),
            Mode::Holding => self.say(Command::Resume),
            Mode::Drawing => {}
        }
    }

    /// Puts the product back that the controller asks for: the drives may have been exchanged before it first saw them.
    fn put_right(&mut self) {
        let fault = self.status.as_ref().and_then(|status| status.fault);
        let Some(Reason::OtherProduct { slave, expected, .. }) = fault else {
            return;
        };
        let product = PRODUCTS.iter().find(|(code, _)| *code == expected);
        if let Some((_, name)) = product.filter(|_| self.stage != Stage::Free) {
            self.inject(&format!("swap {} {name}", slave + 1));
            self.judge.healed();
        }
    }

    /// Whether the drawing has not advanced for long.
    fn is_stuck(&mut self) -> bool {
        if self.advanced.0 != self.ack.executed {
            self.advanced = (self.ack.executed, self.now_ms);
        }
        self.stage == Stage::Free && self.now_ms > self.advanced.1 + PATIENCE_MAX_MS
    }

    fn configure(&mut self) {
        if self
            .configured_ms
            .is_none_or(|since_ms| self.now_ms > since_ms + ANSWER_MAX_MS)
        {
            self.session.configure(self.config.clone());
            self.configured_ms = Some(self.now_ms);
        }
    }

    /// Homes: at the marks if the joints are there, else at the pose that the operator measures.
    fn home(&mut self) {
        let angles_rad = self.world.truth().angles_rad;
        let marks = self.config.axes.iter().map(|axis| axis.sync_angle_rad);
        let at_marks = angles_rad
            .iter()
            .zip(marks)
            .all(|(angle, mark)| (angle - mark).abs() < AT_MARKS_RAD);
        self.say(match at_marks {
            true => Command::Home,
            false => Command::HomeAt {
                pose: JointAngles(angles_rad),
                position: None,
            },
        });
    }

    /// Carries out the next wish.
    fn wish(&mut self) {
        let episode = self.episode;
        let Some(wish) = episode.wishes.get(self.next_wish % episode.wishes.len().max(1)) else {
            return;
        };
        self.next_wish += 1;
        match wish {
            Wish::Draw(index) => {
                if let Some(figure) = episode.figures.get(*index) {
                    self.draw(figure);
                }
            }
            Wish::Move([x_mm, y_mm, z_mm]) => self.say(Command::Move {
                position: Position {
                    x_mm: *x_mm,
                    y_mm: *y_mm,
                    z_mm: *z_mm,
                },
            }),
            Wish::Jog(velocity_mm_s, duration_ms) => {
                self.jog = Some((*velocity_mm_s, self.now_ms.saturating_add(*duration_ms)));
            }
            Wish::Pen => {
                let pen = if self.next_wish.is_multiple_of(2) {
                    Pen::Up
                } else {
                    Pen::Down
                };
                self.say(Command::Pen { pen });
            }
            Wish::Disable => self.say(Command::Disable),
            Wish::Override(percent) => self.say(Command::Override { percent: *percent }),
            Wish::AtOnce(commands) => {
                let pose = JointAngles(self.world.truth().angles_rad);
                for command in commands {
                    self.put_beside(match command {
                        Command::Home => Command::HomeAt { pose, position: None },
                        other => *other,
                    });
                }
            }
        }
    }

    fn draw(&mut self, figure: &Figure) {
        self.job = self.job.wrapping_add(1);
        self.drawing = figure.path(&self.config).into();
        self.ack = PathAck::default();
        self.advanced = (0, self.now_ms);
        self.judge.orders(self.job, &self.drawing);
        self.say(Command::Draw { job: self.job });
        self.session.start_path(self.job, Arc::clone(&self.drawing));
    }

    /// Draws the test figure, again if it was not drawn to its end, at full speed.
    fn draw_test(&mut self) {
        let since_ms = match self.stage {
            Stage::Healed { since_ms } | Stage::Testing { since_ms, .. } => since_ms,
            _ => return,
        };
        if self
            .status
            .as_ref()
            .is_some_and(|status| status.override_percent != 100)
        {
            return self.say(Command::Override { percent: 100 });
        }
        let inked = self.world.look(|cell, _| ink::points(cell.ink()));
        self.stage = Stage::Testing { since_ms, inked };
        self.draw(&test_figure());
    }

    fn repeat_jog(&mut self) {
        let Some((velocity_mm_s, until_ms)) = self.jog else {
            return;
        };
        if self.now_ms >= until_ms || !matches!(self.mode(), Mode::Idle | Mode::Moving) {
            self.jog = None;
        } else if self.now_ms.is_multiple_of(JOG_REPEAT_MS) {
            self.session.command(Command::Jog { velocity_mm_s });
        }
    }

    fn take(&mut self, event: LinkEvent) {
        match event {
            LinkEvent::Answered { id, command, result } => {
                self.awaited.take_if(|(awaited, _)| *awaited == id);
                self.judge.answered(&command, result.is_ok());
            }
            LinkEvent::Ack(ack) => {
                if ack.finished && ack.job == self.job {
                    self.judge.drawn(ack.job);
                }
                self.ack = ack;
            }
            LinkEvent::VertexRefused(refusal) => self.judge.refused_vertex(self.job, refusal.index),
            LinkEvent::Status(status) => {
                self.judge.reported(&status);
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
        self.hear_beside(&heard);
        self.session.receive(&heard, self.now_ms.into());
        while let Some(event) = self.session.next_event() {
            self.take(event);
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
        self.now_ms = ms;
        let episode = self.episode;
        while let Some(event) = episode.events.get(self.next_event).filter(|event| event.at_ms <= ms) {
            self.next_event += 1;
            if self.stage == Stage::Free {
                self.happen(event);
            }
        }
        let stop_open = ms < self.board.stop_until_ms;
        let verdict = {
            let (world, judge) = (&self.world, &mut self.judge);
            world.look(|cell, frames| judge.moment(ms, &cell.truth(), frames, stop_open))
        };
        if let Err((rule, text)) = verdict {
            self.fail(rule, text);
        }
        self.converse(from_firmware, to_firmware, room);
    }

    fn surroundings(&mut self) -> Surroundings {
        let now_ms = self.now_ms;
        let mut around = Surroundings {
            stop_shows_open: now_ms < self.board.stop_until_ms,
            substitute_clock: now_ms < self.board.substitute_until_ms,
            trajectory_waits: now_ms < self.board.trajectory_until_ms,
            ..Surroundings::default()
        };
        if now_ms < self.board.port_until_ms {
            around.board.port = PortState::Down;
        }
        around
    }

    fn is_over(&self) -> bool {
        self.stage == Stage::Over
    }
}
