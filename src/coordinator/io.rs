//! The named inputs and outputs: what the host may set, and what it is told.
//!
//! Invariant: an output is set only by a request that has been checked against its type and its terminal.

use super::Coordinator;
use crate::application::{IoRefusal, Mode, Refusal};
use crate::board::Lamps;
use crate::config::{Config, IO_MAX, IoDirection, IoPoint, IoRole, SAMPLE_WORDS_MAX, ToolFollows};
use crate::control::io::{IoPlace, IoReport};
use crate::control::pen_switch::PenSwitch;
use crate::control::sampler::{CycleReport, SamplerCommand};
use crate::control::tool::ToolOutput;
use crate::ethercat::slave_set::SlaveSet;
use crate::messages::{IoState, IoValues};
use heapless::Vec;

/// Shortest time between two status messages because of inputs and outputs, ms.
pub(super) const IO_STATUS_MS: u32 = 50;

/// A point as far as requests need it.
#[derive(Clone, Copy)]
struct Point {
    bits: u8,
    is_output: bool,
    role: IoRole,
}

/// The coordinator's record of the named inputs and outputs.
pub(super) struct Io {
    points: Vec<Point, IO_MAX>,
    states: Vec<IoState, IO_MAX>,
    /// Points whose values are in each sample.
    words: Vec<u8, SAMPLE_WORDS_MAX>,
    /// Places of terminals whose failure is no fault.
    spared: SlaveSet,
    /// How often a state has changed, wrapping.
    changes: u32,
    /// Value of the lamps last passed on.
    lamp: Option<bool>,
    /// Whether a fault was latched in the last millisecond.
    had_fault: bool,
    /// Whether there is a tool that follows the path.
    has_tool: bool,
    /// Whether the tool stays on until a held drawing is at rest.
    is_on_in_hold: bool,
    /// What the critical tasks were last told: whether the tool may be on.
    draws: bool,
}

impl Io {
    pub(super) const fn new() -> Self {
        Self {
            points: Vec::new(),
            states: Vec::new(),
            words: Vec::new(),
            spared: SlaveSet::NONE,
            changes: 0,
            lamp: None,
            had_fault: false,
            has_tool: false,
            is_on_in_hold: false,
            draws: false,
        }
    }

    fn configure(&mut self, config: &Config) {
        let point = |point: &IoPoint| Point {
            bits: point.kind.bits(),
            is_output: point.direction == IoDirection::Out,
            role: point.role,
        };
        self.points = config.io.iter().map(point).collect();
        self.states = config.io.iter().map(|_| IoState::default()).collect();
        self.words = config.sampled_words();
        let needed = config.io.iter().filter(|point| point.role.is_needed());
        let needed = needed.map(|point| usize::from(point.slave)).collect();
        self.spared = config.terminal_places().without(needed);
        self.has_tool = config.tool.follows != ToolFollows::Nothing;
        (self.is_on_in_hold, self.draws) = (!config.tool.off_at_hold, false);
        self.lamp = None;
        self.changes = self.changes.wrapping_add(1);
    }

    /// Whether a slave is a terminal whose failure is no fault.
    pub(super) const fn is_spared(&self, position: u8) -> bool {
        self.spared.contains(position as usize)
    }

    /// The points of a report for a sample.
    pub(super) fn values(&self, report: &CycleReport) -> IoValues {
        let points = (1_u32 << self.points.len()) - 1;
        let CycleReport { io, io_words, .. } = report;
        let value = |(place, value): (&u8, &u32)| if io.valid >> place & 1 != 0 { *value } else { 0 };
        IoValues {
            set: io.set,
            missing: points as u16 & !io.valid,
            words: self.words.iter().zip(io_words).map(value).collect(),
        }
    }

    /// Whether the terminal of any point is missing.
    fn is_missing(&self) -> bool {
        self.states.iter().any(|state| !state.valid)
    }

    pub(super) const fn changes(&self) -> u32 {
        self.changes
    }

    pub(super) fn states(&self) -> Vec<IoState, IO_MAX> {
        self.states.clone()
    }

    /// Takes a millisecond's report.
    pub(super) fn take(&mut self, report: &IoReport) {
        for (io, (state, point)) in self.states.iter_mut().zip(&self.points).enumerate() {
            let word = report.word.filter(|(number, _)| usize::from(*number) == io);
            let raw = match (point.bits, word) {
                (1, _) => u32::from(report.set >> io & 1),
                (_, Some((_, raw))) => raw,
                (_, None) => state.raw,
            };
            let valid = report.valid >> io & 1 != 0;
            let now = IoState { raw, valid };
            if now != *state {
                *state = now;
                self.changes = self.changes.wrapping_add(1);
            }
        }
    }

    /// Checks a request for an output.
    pub(super) fn check(&self, io: u8, value: u32) -> Result<(), Refusal> {
        let refused = |reason| Err(Refusal::Io { io, reason });
        let (Some(point), Some(state)) = (self.points.get(usize::from(io)), self.states.get(usize::from(io))) else {
            return refused(IoRefusal::Unknown);
        };
        if !point.is_output {
            return refused(IoRefusal::IsInput);
        }
        if point.role.is_own() {
            return refused(IoRefusal::IsOwn);
        }
        if u64::from(value) >> point.bits != 0 {
            return refused(IoRefusal::Range {
                expected: point.bits,
                actual: value,
            });
        }
        if !state.valid {
            return refused(IoRefusal::Missing);
        }
        Ok(())
    }
}

impl Coordinator<'_> {
    pub(super) fn configure_io(&mut self, config: &Config) {
        self.io.configure(config);
        self.tell_sampler(SamplerCommand::ConfigureIo(
            config.io.iter().map(IoPlace::from).collect(),
            PenSwitch::new(config),
            ToolOutput::new(config),
        ));
    }

    /// Switches the outputs off at a fault, and passes the lamps' state on when it changes.
    pub(super) fn follow_mode(&mut self) {
        let has_fault = self.application.fault().is_some();
        let had_fault = core::mem::replace(&mut self.io.had_fault, has_fault);
        if has_fault && !had_fault && !self.io.points.is_empty() {
            self.tell_sampler(SamplerCommand::SwitchOutputsOff);
        }
        self.permit_tool();
        self.show_mode();
    }

    /// Tells the critical tasks whether the tool may be on, before the setpoints of a stop arrive: only while a drawing is
    /// executed. An order that finds no room is given again a millisecond later.
    fn permit_tool(&mut self) {
        let draws = match self.application.mode() {
            Mode::Drawing => true,
            Mode::Holding => self.io.is_on_in_hold,
            _ => false,
        };
        if !self.io.has_tool || draws == self.io.draws {
            return;
        }
        let order = SamplerCommand::Draws(draws);
        if self.ends.sampler_commands.enqueue(order).is_ok() {
            self.io.draws = draws;
        }
    }

    fn show_mode(&mut self) {
        let lit = Lamps::single(self.application.mode(), self.now_ms as u32);
        if self.io.lamp == Some(lit) || !self.ends.sampler_commands.is_empty() {
            return;
        }
        self.io.lamp = Some(lit);
        for io in 0..self.io.points.len() {
            if self.io.points.get(io).is_some_and(|point| point.role == IoRole::Lamp) {
                let (io, value) = (io as u8, u32::from(lit));
                self.tell_sampler(SamplerCommand::SetOutput { io, value });
            }
        }
    }

    /// Whether an acknowledgement without a fault has something to bring back: a terminal whose failure is no fault, or that
    /// was taken out of OP by a request.
    pub(super) fn brings_terminals_back(&self) -> bool {
        self.application.fault().is_none() && self.config_hash.is_some() && self.io.is_missing()
    }
}
