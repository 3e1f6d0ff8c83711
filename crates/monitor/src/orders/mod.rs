//! What the operator ordered and the controller has answered: which power and which motion is permitted now.
//!
//! A command permits as soon as it arrives; a refusal takes the permission back. A command obliges only when it has
//! been accepted. Where the monitor cannot know what the controller decided, both are right.

mod pending;
mod speed_override;
mod stop;

pub(crate) use stop::{Stop, StopCause};

use crate::bounds::{Bounds, PIPELINE_MS, REPORT_MS};
use crate::cell::Cell;
use crate::disturbances::Disturbances;
use crate::moment::{Command, Input, Mode, Report};
use crate::motion::Motion;
use crate::vector::length;
use crate::violation::Rule;
use pending::Pending;
use speed_override::Override;
use stop::STOP_OPEN_MS;

/// The order that the robot moves for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Order {
    /// None: the robot stands.
    #[default]
    None,
    /// A jog.
    Jog,
    /// A move, or the pen alone.
    Single,
    /// A drawing.
    Path,
    /// A motion that was cancelled.
    Ending,
    /// The search for the home switches.
    Search,
}

/// What the operator ordered, as far as it is known.
#[derive(Clone, Debug, Default)]
pub(crate) struct Orders {
    pub(crate) is_configured: bool,
    is_homed: bool,
    unhomed_ms: Option<u64>,
    home_ordered_ms: Option<u64>,
    is_enabled: bool,
    enabling: Pending,
    disabling: Pending,
    /// When the order that permitted power ended, ms.
    pub(crate) power_ended_ms: Option<u64>,
    pub(crate) order: Order,
    /// Whether the present order is a search that nothing has confirmed yet.
    is_search_guessed: bool,
    /// Since when the motion has to come to rest, and whether for a silent host.
    held: Option<(u64, bool)>,
    moving: Pending,
    searching: Pending,
    jogging: Pending,
    path: Pending,
    holding: Pending,
    cancelling: Pending,
    /// Number of the last command.
    asked: u64,
    commanded_ms: u64,
    /// When a jog has to be at rest, ms.
    jog_ends_ms: Option<u64>,
    /// Whether a jog was accepted since the last other motion.
    has_jogged: bool,
    pub(crate) stop: Option<Stop>,
    needs_acknowledgement: bool,
    acknowledged: bool,
    /// Whether the last report tells of a fault.
    pub(crate) fault_reported: bool,
    stop_open_since_ms: Option<u64>,
    is_clock_failed: bool,
    cut_since_ms: Option<u64>,
    speed_override: Override,
    pub(crate) mode: Option<Mode>,
}

/// How long a cut has to last beyond the host's silence before the drawing must be held, ms: what was on the line
/// arrives.
const CUT_MS: u64 = 50;

impl Orders {
    /// Advances to a millisecond; returns whether a drawing counts as accepted whose answer was lost.
    pub(crate) fn step(&mut self, cell: &Cell, bounds: &Bounds, motion: &Motion, disturbances: &Disturbances) -> bool {
        let now_ms = motion.now_ms;
        if let Some(cause) = self.interlock(now_ms) {
            self.acknowledged = false;
            self.begin_stop(cause, motion, bounds, disturbances);
        }
        if let Some(cut_ms) = self.cut_since_ms {
            let silent_ms = cut_ms.saturating_add(u64::from(cell.host_silence_ms));
            if now_ms >= silent_ms.saturating_add(CUT_MS) && self.order == Order::Path && self.held.is_none() {
                self.held = Some((silent_ms, true));
            }
        }
        if disturbances.machine_disturbed()
            && let Some(stop) = &mut self.stop
        {
            stop.wait_for_watchdog();
        }
        if self.enabling.take_lost(now_ms) {
            self.is_enabled = true;
            self.stop = None;
        }
        if self.enabling.is_waiting() && motion.got_power {
            // The answer is on its way, or it was lost.
            self.stop = None;
        }
        if self.moving.take_lost(now_ms) {
            self.begin(Order::Single);
        }
        if self.searching.take_lost(now_ms) {
            self.begin(Order::Search);
            self.is_search_guessed = true;
        }
        let is_path_lost = self.path.take_lost(now_ms);
        if is_path_lost {
            self.begin(Order::Path);
        }
        for unanswered in [
            &mut self.disabling,
            &mut self.holding,
            &mut self.cancelling,
            &mut self.jogging,
        ] {
            // Without an answer these oblige to nothing.
            unanswered.take_lost(now_ms);
        }
        is_path_lost
    }

    /// Takes an input.
    pub(crate) fn take(
        &mut self,
        cell: &Cell,
        bounds: &Bounds,
        motion: &Motion,
        disturbances: &Disturbances,
        input: &Input,
    ) {
        match *input {
            Input::Configured => self.is_configured = true,
            Input::Commanded(Command::Stop) => {
                self.begin_stop(StopCause::Command, motion, bounds, disturbances);
            }
            Input::Commanded(command) => self.command(cell, bounds, motion.now_ms, command),
            Input::StopInput(true) => _ = self.stop_open_since_ms.get_or_insert(motion.now_ms),
            Input::StopInput(false) => self.stop_open_since_ms = None,
            Input::ClockFailed(is_failed) => self.is_clock_failed = is_failed,
            Input::Link { cut: true } => _ = self.cut_since_ms.get_or_insert(motion.now_ms),
            Input::Link { cut: false } => self.cut_since_ms = None,
            Input::Restarted => self.restart(motion, bounds, disturbances),
            _ => {}
        }
    }

    fn restart(&mut self, motion: &Motion, bounds: &Bounds, disturbances: &Disturbances) {
        let (open, cut, is_clock_failed) = (self.stop_open_since_ms, self.cut_since_ms, self.is_clock_failed);
        self.begin_stop(StopCause::Restart, motion, bounds, disturbances);
        *self = Self {
            stop: self.stop,
            power_ended_ms: self.power_ended_ms,
            stop_open_since_ms: open,
            is_clock_failed,
            cut_since_ms: cut,
            speed_override: self.speed_override.clone(),
            ..Self::default()
        };
        self.speed_override
            .restart(motion.now_ms, motion.now_ms.saturating_add(bounds.slowing_ms));
    }

    /// What on the board demands a stop for as long as it lasts.
    fn interlock(&self, now_ms: u64) -> Option<StopCause> {
        let is_long = |since_ms: u64| now_ms.saturating_sub(since_ms) >= STOP_OPEN_MS;
        match self.stop_open_since_ms {
            Some(since_ms) if is_long(since_ms) => Some(StopCause::Input),
            _ => self.is_clock_failed.then_some(StopCause::Clock),
        }
    }

    fn command(&mut self, cell: &Cell, bounds: &Bounds, now_ms: u64, command: Command) {
        self.asked += 1;
        let number = self.asked;
        match command {
            Command::Home | Command::HomeAt { .. } => self.home_ordered_ms = Some(now_ms),
            Command::Search => {
                self.home_ordered_ms = Some(now_ms);
                self.searching.ask(now_ms, number);
            }
            Command::Enable if self.needs_acknowledgement && !self.acknowledged => {}
            Command::Enable => self.enabling.ask(now_ms, number),
            Command::Disable => self.disabling.ask(now_ms, number),
            Command::Jog { velocity_mm_s } => {
                let ends_ms = now_ms.saturating_add(bounds.jog_ms(cell, length(velocity_mm_s)));
                self.jog_ends_ms = Some(self.jog_ends_ms.map_or(ends_ms, |ms| ms.max(ends_ms)));
                self.jogging.ask(now_ms, number);
            }
            Command::Move { .. } | Command::Pen { .. } => self.moving.ask(now_ms, number),
            Command::Draw { .. } | Command::Resume => self.path.ask(now_ms, number),
            Command::Hold => self.holding.ask(now_ms, number),
            Command::Cancel => self.cancelling.ask(now_ms, number),
            Command::Override { percent } => self.speed_override.ask(percent),
            Command::Acknowledge => self.acknowledged = true,
            Command::Stop => {}
        }
        if matches!(
            command,
            Command::Jog { .. }
                | Command::Move { .. }
                | Command::Pen { .. }
                | Command::Draw { .. }
                | Command::Resume
                | Command::Search
        ) {
            self.commanded_ms = now_ms;
        }
    }

    /// Takes a report.
    pub(crate) fn hear(&mut self, bounds: &Bounds, motion: &Motion, disturbances: &Disturbances, report: &Report) {
        let now_ms = motion.now_ms;
        match report {
            Report::Mode(mode) => self.hear_mode(now_ms, *mode),
            Report::Fault(Some(_)) if self.fault_reported => {}
            Report::Fault(Some(words)) => {
                self.fault_reported = true;
                // A stop by command began with its command: heard of late, it takes back no acknowledgement after it.
                if self.needs_acknowledgement && stop::is_by_command(words) {
                    return;
                }
                self.begin_stop(StopCause::of_fault(words), motion, bounds, disturbances);
            }
            Report::Fault(None) => {
                if std::mem::take(&mut self.fault_reported) {
                    self.needs_acknowledgement = false;
                }
            }
            Report::Homed(is_homed) => {
                // A search begins with it.
                self.is_search_guessed &= is_homed;
                self.is_homed = *is_homed;
                if !is_homed {
                    self.unhomed_ms = Some(now_ms);
                }
            }
            Report::Accepted(command) => self.accepted(bounds, now_ms, *command),
            Report::Refused(command) => self.refused(*command),
            Report::VertexRefused { .. } | Report::Finished { .. } | Report::Counters(_) => {}
        }
    }

    fn hear_mode(&mut self, now_ms: u64, mode: Mode) {
        self.mode = Some(mode);
        // Older orders are known to be over; a younger one may have been accepted after this mode was sent.
        let is_recent = now_ms.saturating_sub(self.commanded_ms) < REPORT_MS;
        if mode.stands() && !is_recent {
            self.begin(Order::None);
            self.searching.forget();
            self.forget_motions();
        }
        // Nothing else is accepted while the search goes on.
        if mode == Mode::Homing && !is_recent {
            if self.searching.answer().is_some() {
                self.begin(Order::Search);
            }
            self.forget_motions();
        }
        if mode == Mode::Holding && !is_recent && self.order == Order::Path {
            self.held.get_or_insert((now_ms, false));
        }
    }

    fn accepted(&mut self, bounds: &Bounds, now_ms: u64, command: Command) {
        match command {
            Command::Enable => {
                if self.enabling.answer().is_some() {
                    self.is_enabled = true;
                    self.stop = None;
                }
            }
            Command::Disable => {
                if self.disabling.answer().is_some() {
                    self.is_enabled = false;
                    let is_search = self.order == Order::Search;
                    self.begin(if is_search { Order::Search } else { Order::None });
                    // Axes that search brake from the speed of the search.
                    self.held = is_search.then_some((now_ms, false));
                    self.end_power(now_ms);
                }
            }
            Command::Jog { .. } => {
                if self.jogging.answer().is_some() {
                    // A jog that is accepted during a move does not end it.
                    if self.order != Order::Single {
                        self.begin(Order::Jog);
                    }
                    self.has_jogged = true;
                }
            }
            Command::Move { .. } | Command::Pen { .. } => {
                if let Some(number) = self.moving.answer() {
                    self.begin(Order::Single);
                    // It is not accepted while drawing: a drawing that was ordered before it was refused, or has ended.
                    self.path.forget_before(number);
                }
            }
            Command::Draw { .. } | Command::Resume => {
                if let Some(number) = self.path.answer() {
                    self.begin(Order::Path);
                    // It is not accepted while moving: the same for a move that was ordered before it.
                    self.moving.forget_before(number);
                }
            }
            Command::Hold => {
                if self.holding.answer().is_some() && self.order == Order::Path {
                    self.held.get_or_insert((now_ms, false));
                }
            }
            Command::Search => {
                if self.searching.answer().is_some() {
                    self.begin(Order::Search);
                    // It is accepted at rest only: what was asked for before it is not carried out.
                    self.forget_motions();
                }
            }
            Command::Cancel => {
                if self.cancelling.answer().is_some() && self.order != Order::None {
                    let (is_search, has_jogged) = (self.order == Order::Search, self.has_jogged);
                    self.begin(if is_search { Order::Search } else { Order::Ending });
                    // A jog that is cancelled slows down; the next message of it is refused.
                    self.has_jogged = has_jogged;
                    self.held = Some((now_ms, false));
                }
            }
            Command::Override { percent } => {
                self.speed_override
                    .accept(percent, now_ms, now_ms.saturating_add(bounds.slowing_ms));
            }
            Command::Home | Command::HomeAt { .. } | Command::Stop | Command::Acknowledge => {}
        }
    }

    fn refused(&mut self, command: Command) {
        let pending = match command {
            Command::Enable => &mut self.enabling,
            Command::Disable => &mut self.disabling,
            Command::Jog { .. } => &mut self.jogging,
            Command::Move { .. } | Command::Pen { .. } => &mut self.moving,
            Command::Search => &mut self.searching,
            Command::Draw { .. } | Command::Resume => &mut self.path,
            Command::Hold => &mut self.holding,
            Command::Cancel => &mut self.cancelling,
            Command::Override { percent } => {
                self.speed_override.refuse(percent);
                return;
            }
            Command::Home | Command::HomeAt { .. } | Command::Stop | Command::Acknowledge => return,
        };
        pending.answer();
        if matches!(command, Command::Jog { .. }) && !self.jogging.is_waiting() && !self.has_jogged {
            self.jog_ends_ms = None;
        }
    }

    fn begin(&mut self, order: Order) {
        self.order = order;
        self.is_search_guessed = false;
        self.held = None;
        self.has_jogged = false;
    }

    /// Forgets the motions that were asked for.
    fn forget_motions(&mut self) {
        self.moving.forget();
        self.path.forget();
        self.jogging.forget();
    }

    fn end_power(&mut self, now_ms: u64) {
        self.power_ended_ms = Some(now_ms);
    }

    fn begin_stop(&mut self, cause: StopCause, motion: &Motion, bounds: &Bounds, disturbances: &Disturbances) {
        let now_ms = motion.now_ms;
        if self.may_have_power() || self.power_ended_ms.is_none() {
            self.end_power(now_ms);
        }
        self.is_enabled = false;
        self.begin(Order::None);
        self.jog_ends_ms = None;
        for pending in [
            &mut self.enabling,
            &mut self.moving,
            &mut self.searching,
            &mut self.jogging,
            &mut self.path,
        ] {
            pending.forget();
        }
        if !matches!(cause, StopCause::Input | StopCause::Clock) || self.stop.is_none() {
            self.acknowledged = false;
        }
        self.needs_acknowledgement = true;
        // What is the quick stop at once ends a stop that keeps the path.
        let is_stricter = |stop: Stop| stop.cause.keeps_path() && !cause.keeps_path();
        if self.stop.is_none_or(is_stricter) {
            self.stop = Some(Stop::new(cause, motion, bounds, disturbances.may_race()));
        }
    }

    /// Whether an order permits the drives to have power.
    pub(crate) fn may_have_power(&self) -> bool {
        self.is_configured && (self.is_enabled || self.enabling.is_waiting())
    }

    /// Whether the joint angles may be known.
    pub(crate) fn may_be_homed(&self) -> bool {
        let ordered = self.home_ordered_ms.is_some_and(|ordered_ms| {
            self.unhomed_ms
                .is_none_or(|unhomed_ms| ordered_ms.saturating_add(REPORT_MS) >= unhomed_ms)
        });
        self.is_homed || ordered
    }

    /// Whether an order permits motion now.
    pub(crate) fn may_move(&self, bounds: &Bounds, now_ms: u64) -> bool {
        if !self.may_have_power() {
            return false;
        }
        let is_searched = match (self.order, self.held) {
            (Order::Search, None) => true,
            (Order::Search, Some((since_ms, _))) => now_ms <= since_ms.saturating_add(bounds.hold_ms),
            _ => self.searching.is_waiting(),
        };
        if is_searched || !self.may_be_homed() {
            return is_searched;
        }
        let is_asked = self.moving.is_waiting() || self.path.is_waiting();
        let is_ordered = match (self.order, self.held) {
            (Order::Single, _) | (Order::Path, None) => true,
            (Order::Path | Order::Ending, Some((since_ms, _))) => now_ms <= since_ms.saturating_add(bounds.hold_ms),
            (Order::None | Order::Jog | Order::Ending | Order::Search, _) => false,
        };
        let is_jogged = self.jog_ends_ms.is_some_and(|ends_ms| now_ms <= ends_ms);
        is_asked || is_ordered || is_jogged
    }

    /// Whether the axes may be on their way to their home switches.
    pub(crate) fn may_search(&self) -> bool {
        self.order == Order::Search || self.searching.is_waiting()
    }

    /// Whether the axes are on their way to their home switches, as the controller has confirmed.
    pub(crate) fn is_search_known(&self) -> bool {
        self.order == Order::Search && !self.is_search_guessed
    }

    /// Whether a drawing, or its continuation, was ordered and is not answered.
    pub(crate) fn asks_for_path(&self) -> bool {
        self.path.is_waiting()
    }

    /// Whether a jog may be in progress.
    pub(crate) fn may_jog(&self, now_ms: u64) -> bool {
        self.jog_ends_ms.is_some_and(|ends_ms| now_ms <= ends_ms)
    }

    /// The rule that a motion without permission breaks.
    pub(crate) fn rule_of_rest(&self) -> Rule {
        match (self.order, self.held) {
            (Order::Jog, _) => Rule::DeadMan,
            (Order::Path, Some((_, true))) => Rule::Silence,
            _ => Rule::Permission,
        }
    }

    /// Whether the robot is drawing: on the path, or on its way from it.
    pub(crate) fn is_drawing(&self, now_ms: u64) -> bool {
        let is_asked = self.moving.is_waiting() || self.path.is_waiting();
        self.order == Order::Path && !is_asked && !self.may_jog(now_ms)
    }

    /// Largest override that may be in effect, percent.
    pub(crate) fn percent_max(&self, now_ms: u64) -> u8 {
        self.speed_override.largest(now_ms)
    }

    /// Whether the present stop is that of a restart.
    pub(crate) fn has_restarted(&self) -> bool {
        self.stop.as_ref().is_some_and(|stop| stop.cause == StopCause::Restart)
    }

    /// Whether a stop is in progress.
    pub(crate) fn is_stopping(&self, bounds: &Bounds, now_ms: u64) -> bool {
        self.stop
            .as_ref()
            .is_some_and(|stop| now_ms.saturating_sub(stop.since_ms) <= stop.duration_ms(bounds) + PIPELINE_MS)
    }
}

#[cfg(test)]
mod tests;
