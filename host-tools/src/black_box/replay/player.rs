//! Plays a recording to the sampler.

use super::super::contents::{Contents, SampleEntry};
use super::comparison::{Comparison, Finding};
use super::drives::{Control, Millisecond};
use super::events::{EVENT_MS, Events};
use super::positions::{Position, Positions};
use super::{Difference, Latched, Replay, SETTLED_MS, has_no_power};
use etherpen::application::{Command, Fault, Mode, Power};
use etherpen::black_box::Event;
use etherpen::config::Config;
use etherpen::control::sampler::{Queued, SamplerCommand};
use etherpen::drives::DriveInput;
use etherpen::drives::cia402::{DriveState, StatusWord};
use etherpen::motion::Setpoint;
use etherpen::robots::{AXES, JointAngles};

/// Setpoints that the sampler looks at, from the present one on. Those behind the last one of a motion that was
/// interrupted are not recorded, but the controller had them.
const LOOK_AHEAD: usize = 12;
/// Longest time from an order to home or to enable to what it shows, ms.
const ORDER_MS: usize = 3;

/// A replay in progress.
pub(super) struct Player<'a, 'q> {
    config: &'a Config,
    events: Events<'a>,
    samples: &'a [SampleEntry],
    control: Control<'q>,
    positions: Positions,
    comparison: Comparison<'a>,
    epoch: u8,
    /// Setpoints before this index are with the sampler.
    queued: usize,
}

impl<'a, 'q> Player<'a, 'q> {
    /// A player at the beginning of `samples`.
    pub(super) fn new(
        contents: &'a Contents,
        samples: &'a [SampleEntry],
        config: &'a Config,
        control: Control<'q>,
    ) -> Self {
        let events = Events(&contents.events);
        let first = samples.first();
        let (no_power, no_fault) = (first.is_some_and(has_no_power), first.is_some_and(|first| !first.fault));
        let mut player = Self {
            config,
            events,
            samples,
            control,
            positions: Positions::new(),
            comparison: Comparison::new(config, events, no_power, no_fault),
            epoch: 0,
            queued: 0,
        };
        player.begin();
        player
    }

    /// Brings the sampler to where the recording begins.
    fn begin(&mut self) {
        let Some(first) = self.samples.first() else { return };
        let now = Millisecond {
            inputs: self.inputs(first),
            ..Millisecond::default()
        };
        self.positions = Positions::new();
        for _ in 0..2 {
            self.control.step(&now);
        }
        if first.homed == [true; AXES] {
            self.home(Some(pose_of(first)));
        }
        if first.following {
            self.control.order(SamplerCommand::Power(Power::On));
            self.follow();
        }
    }

    /// Plays all samples, or up to the first one with another result.
    pub(super) fn play(mut self) -> Replay {
        let mut replay = Replay {
            from_ms: self.samples.get(SETTLED_MS).map_or(0, |first| first.t_ms),
            agreed_ms: 0,
            faults: Vec::new(),
            difference: None,
            not_recorded: None,
        };
        for (index, now) in self.samples.iter().enumerate() {
            let finding = self.millisecond(index, now);
            let before_end_s = now.before_end_s;
            match finding {
                Finding::Agreed { latched } => {
                    let latched = latched.map(|fault| Latched { before_end_s, fault });
                    replay.faults.extend(latched);
                }
                Finding::NotRecorded(fault) => {
                    replay.not_recorded = Some(Latched { before_end_s, fault });
                    break;
                }
                Finding::Differs(what) => {
                    replay.difference = Some(Difference { before_end_s, what });
                    break;
                }
            }
            replay.agreed_ms += u32::from(index >= SETTLED_MS);
        }
        replay
    }

    /// Plays one sample; returns what it has shown.
    fn millisecond(&mut self, index: usize, now: &SampleEntry) -> Finding {
        let before = index.checked_sub(1).and_then(|before| self.samples.get(before));
        if let Some(before) = before {
            self.give_orders(index, before, now);
        }
        self.offer_setpoints(index);
        let late = before.map_or(0, |before| now.cycles_late.wrapping_sub(before.cycles_late));
        let millisecond = Millisecond {
            inputs: self.inputs(now),
            interlock: now.interlock,
            late: late.into(),
        };
        let report = self.control.step(&millisecond);
        if index + 1 == SETTLED_MS && self.comparison.has_only_replayed(now, &report) {
            // The controllers knew nothing of the motion before.
            self.control.order(SamplerCommand::ClearFault);
        }
        self.comparison.step(index, now, &report)
    }

    /// What the drives report in a sample.
    fn inputs(&mut self, sample: &SampleEntry) -> [Option<DriveInput>; AXES] {
        let positions = self.positions.next(&self.config.axes, sample);
        std::array::from_fn(|axis| {
            let Position { increments, is_new } = positions[axis]?;
            if is_new {
                self.control.configured_again(axis);
            }
            Some(DriveInput {
                position: increments,
                status: StatusWord(sample.status_word[axis]),
                mode_in_effect: true,
            })
        })
    }

    /// The orders that lead from one sample to the next. An order without its event is none, unless the events of that
    /// time have been overwritten.
    fn give_orders(&mut self, index: usize, before: &SampleEntry, now: &SampleEntry) {
        let is_overwritten = self.events.begin_after(now);
        let recent_ms = now.t_ms.wrapping_sub(EVENT_MS);
        let acknowledged = self.events.accepted(recent_ms, 2 * EVENT_MS, is_acknowledge).is_some()
            || self.events.happened(recent_ms, 2 * EVENT_MS, &Event::Fault(None));
        if before.fault && !now.fault && (acknowledged || is_overwritten) {
            self.control.order(SamplerCommand::Power(Power::Off));
            self.control.order(SamplerCommand::ClearFault);
        }
        self.configure_again(index, before, now);
        let ends = before.following && !now.following;
        let becomes_homed = before.homed != [true; AXES] && now.homed == [true; AXES];
        let searches = self.config.has_home_switches();
        let is_home = |command: &Command| match command {
            // It begins a search, which the samples show.
            Command::Home => !searches,
            command => matches!(command, Command::HomeAt { .. }),
        };
        // The sampler takes an order in the millisecond after it; what it shows may come later.
        let home = match ends || becomes_homed {
            true => self.events.accepted(recent_ms, EVENT_MS, is_home),
            // On a board an event may be recorded with a time one millisecond later than here.
            false if self.is_homed_soon(index) => None,
            false => self.events.accepted(before.t_ms, 1, is_home),
        };
        match home {
            Some(Command::HomeAt { pose, .. }) => self.home(Some(pose)),
            Some(_) => self.home(None),
            None if becomes_homed && is_overwritten => self.home(Some(pose_of(now))),
            None => {}
        }
        // The setpoints come some milliseconds after the power.
        if now.following && !before.following || self.is_enabled(index, before, now) {
            self.control.order(SamplerCommand::Power(Power::On));
        }
        if now.following && !before.following {
            self.queued = index;
            self.follow();
        }
        let ordered_ms = before.t_ms.wrapping_sub(1);
        // A robot that follows no setpoints, just after homing, stops too; one that brakes on its path still follows.
        let stops = !now.following && self.events.happened(ordered_ms, 2, &Event::Mode(Mode::Stopping));
        if (stops || ends && home.is_none()) && !self.runs_dry(index) {
            self.control.order(SamplerCommand::Power(Power::QuickStop));
        }
    }

    /// Configures drives again that were away and come back without power and home.
    fn configure_again(&mut self, index: usize, before: &SampleEntry, now: &SampleEntry) {
        let recent = self.samples.get(index.saturating_sub(EVENT_MS as usize)..index);
        let recent = recent.unwrap_or_default();
        for axis in 0..AXES {
            let was_away = recent.iter().any(|sample| !sample.valid[axis]);
            let loses_home = before.homed[axis] && !now.homed[axis] && now.valid[axis];
            let has_power = StatusWord(now.status_word[axis]).state() == DriveState::OperationEnabled;
            // Its own fault tells why a feedback that is not plausible lost the home.
            let is_told = self
                .events
                .fault_at(now)
                .is_some_and(|fault| is_feedback_of(&fault, axis));
            if was_away && loses_home && !has_power && !is_told {
                self.control.configured_again(axis);
            }
        }
    }

    /// Whether the order to enable is taken between two samples: in the millisecond after its event, or, on a board, up to three
    /// later. What latches as soon as there is power tells which.
    fn is_enabled(&self, index: usize, before: &SampleEntry, now: &SampleEntry) -> bool {
        const LATER_MS: u32 = ORDER_MS as u32;
        let enabled = match !before.fault && now.fault {
            true => self
                .events
                .accepted(before.t_ms.wrapping_sub(LATER_MS), 1 + LATER_MS, is_enable),
            false if self.latches_soon(index) => None,
            false => self.events.accepted(before.t_ms, 1, is_enable),
        };
        enabled.is_some()
    }

    /// Whether the axes become homed in one of the next milliseconds: the order is taken then.
    fn is_homed_soon(&self, index: usize) -> bool {
        self.is_soon(index, |before, now| {
            before.homed != [true; AXES] && now.homed == [true; AXES]
        })
    }

    /// Whether a fault latches in one of the next milliseconds.
    fn latches_soon(&self, index: usize) -> bool {
        self.is_soon(index, |before, now| !before.fault && now.fault)
    }

    fn is_soon(&self, index: usize, happens: impl Fn(&SampleEntry, &SampleEntry) -> bool) -> bool {
        let next = self.samples.get(index..).unwrap_or_default();
        let mut next = next.windows(2).take(ORDER_MS);
        next.any(|pair| happens(&pair[0], &pair[1]))
    }

    fn home(&mut self, near: Option<JointAngles>) {
        self.control.order(SamplerCommand::Home { near });
    }

    fn follow(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        self.control.order(SamplerCommand::Follow { epoch: self.epoch });
    }

    /// Whether the setpoints ended by themselves at a sample.
    fn runs_dry(&self, index: usize) -> bool {
        let Some(now) = self.samples.get(index) else {
            return false;
        };
        matches!(self.events.fault_at(now), Some(Fault::SetpointUnderrun))
    }

    /// Gives the sampler the setpoints that it looks at. What follows the last one of a motion that was interrupted is
    /// not recorded: it goes on as before.
    fn offer_setpoints(&mut self, index: usize) {
        let rest = self.samples.get(index..).unwrap_or_default();
        let length = rest.iter().take_while(|sample| sample.following).count();
        if length == 0 {
            return;
        }
        let end = index + length;
        let goes_on = !self.runs_dry(end);
        self.queued = self.queued.max(index);
        while self.queued < index + LOOK_AHEAD {
            let ended = (self.queued + 1).saturating_sub(end);
            if ended > 0 && !goes_on {
                return;
            }
            let setpoint = self.setpoint(self.queued - ended, ended);
            let epoch = self.epoch;
            if !self.control.offer(Queued { epoch, setpoint }) {
                return;
            }
            self.queued += 1;
        }
    }

    /// The setpoint of a millisecond of a motion, `after` milliseconds later at its speed.
    fn setpoint(&self, index: usize, after: usize) -> Setpoint {
        let follows = |index: usize| self.samples.get(index).filter(|sample| sample.following);
        let Some(now) = follows(index) else {
            return Setpoint::default();
        };
        let before = index.checked_sub(1).and_then(follows);
        let [low, high] = match (before, follows(index + 1)) {
            (Some(before), _) => [before, now],
            (None, Some(next)) => [now, next],
            (None, None) => [now, now],
        }
        .map(|sample| sample.setpoint_rad.map(f64::from));
        let velocity_rad_s = std::array::from_fn(|axis| 1e3 * (high[axis] - low[axis]));
        let moved_rad = |axis: usize| self.comparison.turns_rad()[axis] + velocity_rad_s[axis] * after as f64 / 1e3;
        Setpoint {
            position_rad: std::array::from_fn(|axis| f64::from(now.setpoint_rad[axis]) + moved_rad(axis)),
            velocity_rad_s,
            ..Setpoint::default()
        }
    }
}

fn is_enable(command: &Command) -> bool {
    *command == Command::Enable
}

fn is_acknowledge(command: &Command) -> bool {
    *command == Command::Acknowledge
}

/// The joint angles of a sample.
fn pose_of(sample: &SampleEntry) -> JointAngles {
    JointAngles(sample.measured_rad.map(f64::from))
}

/// Whether the fault is an implausible feedback of this axis.
fn is_feedback_of(fault: &Fault, axis: usize) -> bool {
    match *fault {
        Fault::FeedbackDeviation { axis: of, .. } | Fault::FeedbackNoise { axis: of, .. } => usize::from(of) == axis,
        _ => false,
    }
}
