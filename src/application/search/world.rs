//! The world around the operating modes in the search: drives, bus, trajectory, host, operator.
//!
//! Anything may happen at any time, except the impossible: drives do not take power that nobody requested, an angle is
//! not referenced by itself, and a motion whose setpoints nobody takes does not end. [`State::check`] checks every
//! transition against the guarantees of the operating modes.

extern crate std;

use super::super::step::{FOLLOWED_MS, RESET_MS, SEARCH_BEGINS_MS, SETTLE_MS};
use super::super::*;
use super::inputs::{ANSWERS, BLIND, CHANGES, COMMANDS, Change, DRIVE, NEWS};
use super::trajectory::{Data, Doing, Model};
use crate::board::Interlock;
use crate::trajectory_task::MotionOrder;
use std::vec::Vec;

/// One transition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Move {
    /// A configuration, of a machine with home switches or without.
    Configure(bool),
    Command(Command),
    Bus(BusCondition),
    /// The trajectory task runs and reports.
    Release,
    PathComes,
    Arrives,
    /// This time passes, ms, then a report with up to two changes.
    Time(u32, Change, Change),
}

impl Move {
    /// All transitions that are possible in a state.
    pub(super) fn all(state: &State) -> Vec<Self> {
        let mut moves: Vec<Self> = COMMANDS.into_iter().map(Self::Command).collect();
        if state.application.may_configure() {
            moves.extend([false, true].map(Self::Configure));
        }
        moves.extend(NEWS.into_iter().map(Self::Bus));
        if state.supervisor_asked {
            moves.extend(ANSWERS.into_iter().map(Self::Bus));
        }
        moves.extend([Self::Release, Self::PathComes]);
        if state.is_followed() {
            moves.push(Self::Arrives);
        }
        for ms in state.times_ms() {
            for (number, first) in CHANGES.into_iter().enumerate() {
                if first != Change::Nothing && !state.may(first) {
                    continue;
                }
                moves.push(Self::Time(ms, first, Change::Nothing));
                let seconds = CHANGES.into_iter().skip(number + 1).filter(|second| state.may(*second));
                moves.extend(
                    seconds
                        .filter(|_| first != Change::Nothing)
                        .map(|second| Self::Time(ms, first, second)),
                );
            }
        }
        moves
    }
}

/// Two states with equal keys are the same state of the search.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Key {
    mode: u8,
    fault: Option<u8>,
    bus: Option<u8>,
    enabling: (u8, u8),
    stop: (u8, u8),
    recovering: Option<u8>,
    motion: u8,
    flags: [bool; 14],
    power: u8,
    epochs: [Option<bool>; 2],
    trajectory: Model,
}

/// The operating modes and the world around them.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub(super) application: Application,
    now_ms: u32,
    /// The last report.
    condition: Condition,
    /// Whether homing was requested and may succeed from the next millisecond on.
    taking: bool,
    /// Number of the start that the sampler follows.
    followed: Option<u8>,
    trajectory: Model,
    /// Whether the trajectory task has reported that it took all orders.
    up_to_date: bool,
    /// Whether the supervisor owes an answer.
    supervisor_asked: bool,
    /// Actions of the last transition.
    actions: Vec<Action>,
    refused: bool,
}

impl Clone for Application {
    fn clone(&self) -> Self {
        Self {
            actions: self.actions.clone(),
            ..*self
        }
    }
}

fn passed(thresholds_ms: &[u32], waited_ms: u32) -> u8 {
    thresholds_ms
        .iter()
        .filter(|threshold| waited_ms >= **threshold)
        .count() as u8
}

fn kind(fault: &Fault) -> u8 {
    match fault {
        Fault::EmergencyStop(_) => 0,
        Fault::Blind { .. } => 1,
        Fault::SlaveLost { .. } => 2,
        Fault::SlaveState { .. } => 3,
        Fault::Drive { .. } => 4,
        Fault::UnexpectedBus { .. } => 5,
        Fault::NoLink { .. } => 6,
        Fault::EnableTimeout { .. } => 7,
        Fault::ReferenceLost { .. } => 8,
        Fault::RepairTimeout { .. } => 9,
        _ => 10,
    }
}

impl State {
    pub(super) fn new() -> Self {
        Self {
            application: Application::new(),
            now_ms: 0,
            condition: Condition::UNKNOWN,
            taking: false,
            followed: None,
            trajectory: Model::default(),
            up_to_date: true,
            supervisor_asked: false,
            actions: Vec::new(),
            refused: false,
        }
    }

    /// The timers with their thresholds, ms: waiting times at which something happens.
    fn timers(&self) -> [(Option<u32>, &'static [u32]); 4] {
        let application = &self.application;
        let enabling = match application.enabling {
            Enabling::No => (None, [].as_slice()),
            Enabling::Homing { since_ms } => (Some(since_ms), [SETTLE_MS, ENABLE_MAX_MS + 1].as_slice()),
            Enabling::Powering { since_ms } => (Some(since_ms), [ENABLE_MAX_MS + 1].as_slice()),
        };
        let stop = match application.stop {
            None => (None, [].as_slice()),
            Some(Stop::Ramp { since_ms }) => (Some(since_ms), [STANDSTILL_MAX_MS + 1].as_slice()),
            Some(Stop::Brake { since_ms }) => (Some(since_ms), [BRAKE_DELAY_MS].as_slice()),
            Some(Stop::Release { since_ms }) => (Some(since_ms), [ENABLE_MAX_MS + 1].as_slice()),
        };
        let recovering = (
            application.recovering_since_ms,
            [RESET_MS, RECOVERY_MAX_MS + 1].as_slice(),
        );
        let moves = matches!(
            application.mode,
            Mode::Moving | Mode::Drawing | Mode::Holding | Mode::Stopping
        );
        let motion = match application.mode {
            Mode::Homing => (Some(application.moved_ms), [SEARCH_BEGINS_MS + 1].as_slice()),
            _ => (moves.then_some(application.moved_ms), [FOLLOWED_MS].as_slice()),
        };
        [enabling, stop, recovering, motion]
    }

    pub(super) fn key(&self) -> Key {
        let application = &self.application;
        let [enabling, stop, recovering, motion] = self.timers().map(|(since_ms, thresholds)| {
            since_ms.map_or(0, |since_ms| passed(thresholds, self.now_ms.wrapping_sub(since_ms)))
        });
        let condition = &self.condition;
        let newest = |epoch: Option<u8>| epoch.map(|epoch| epoch == application.epoch);
        Key {
            mode: application.mode as u8,
            fault: application.fault.as_ref().map(kind),
            bus: application.bus.as_ref().map(|bus| match bus {
                BusCondition::Operational => 255,
                BusCondition::Failed(fault) | BusCondition::Refused(fault) => kind(fault),
            }),
            enabling: (
                match application.enabling {
                    Enabling::No => 0,
                    Enabling::Homing { .. } => 1,
                    Enabling::Powering { .. } => 2,
                },
                enabling,
            ),
            stop: (
                match application.stop {
                    None => 0,
                    Some(Stop::Ramp { .. }) => 1,
                    Some(Stop::Brake { .. }) => 2,
                    Some(Stop::Release { .. }) => 3,
                },
                stop,
            ),
            recovering: application.recovering_since_ms.map(|_| recovering),
            motion,
            flags: [
                application.cancelling,
                application.has_configuration,
                application.has_switches,
                condition.searching,
                condition.standstill,
                condition.silent.is_some(),
                condition.drive_fault.is_some(),
                condition.unreferenced.is_some(),
                condition.interlock.is_some(),
                condition.powered,
                condition.fault.is_some(),
                self.taking,
                self.up_to_date,
                self.supervisor_asked,
            ],
            power: application.power as u8,
            epochs: [newest(self.followed), newest(self.trajectory.epoch)],
            // Its motion matters only where something may move: otherwise it is placed again before anything moves.
            trajectory: Model {
                epoch: None,
                doing: if self.may_move() {
                    self.trajectory.doing
                } else {
                    Doing::Rest
                },
                ..self.trajectory
            },
        }
    }

    fn may_move(&self) -> bool {
        match self.application.mode {
            Mode::Idle | Mode::Unreferenced | Mode::Moving | Mode::Drawing | Mode::Holding => true,
            Mode::Stopping => self.application.cancelling,
            _ => false,
        }
    }

    /// Times, ms, after which the state may change.
    fn times_ms(&self) -> Vec<u32> {
        let mut times_ms: Vec<u32> = std::vec![1];
        for (since_ms, thresholds_ms) in self.timers() {
            let Some(since_ms) = since_ms else { continue };
            let waited_ms = self.now_ms.wrapping_sub(since_ms);
            let next = thresholds_ms.iter().find(|threshold| **threshold > waited_ms);
            times_ms.extend(next.map(|threshold| threshold - waited_ms).filter(|ms| *ms > 1));
        }
        times_ms.sort_unstable();
        times_ms.dedup();
        times_ms
    }

    /// Whether the next report can contain a change.
    fn may(&self, change: Change) -> bool {
        let condition = &self.condition;
        let power = self.application.power;
        match change {
            Change::Nothing => false,
            Change::Powered(true) => {
                !condition.powered
                    && power == Power::On
                    && condition.silent.is_none()
                    && condition.drive_fault.is_none()
            }
            Change::Powered(false) => condition.powered,
            Change::DriveFault => condition.drive_fault.is_none() || power == Power::FaultReset,
            Change::Referenced(true) => condition.unreferenced.is_some() && self.taking,
            Change::Searched(_) => condition.searching,
            Change::Referenced(false) => condition.unreferenced.is_none(),
            Change::Fault => condition.fault.is_none(),
            Change::Stalled => !self.progress().idle && self.is_followed(),
            Change::Standstill | Change::Silence | Change::Interlock | Change::HostSilent => true,
        }
    }

    fn change(&mut self, change: Change) {
        let condition = &mut self.condition;
        match change {
            Change::Nothing | Change::HostSilent | Change::Stalled => {}
            Change::Powered(powered) => (condition.powered, condition.unpowered) = (powered, !powered),
            Change::Standstill => condition.standstill = !condition.standstill,
            Change::Silence => {
                condition.silent = if condition.silent.is_some() { None } else { Some(1) };
            }
            Change::DriveFault => {
                condition.drive_fault = if condition.drive_fault.is_some() {
                    None
                } else {
                    Some(DRIVE)
                };
            }
            Change::Referenced(referenced) => condition.unreferenced = (!referenced).then_some(3),
            Change::Searched(found) => {
                condition.searching = false;
                condition.unreferenced = if found { None } else { condition.unreferenced };
            }
            Change::Interlock => {
                condition.interlock = match condition.interlock {
                    Some(_) => None,
                    None => Some(Interlock::EmergencyStop),
                };
            }
            Change::Fault => condition.fault = Some(BLIND),
        }
        if let Some(interlock) = condition.interlock {
            condition.fault.get_or_insert(interlock.fault());
        }
        if condition.silent.is_some() || condition.drive_fault.is_some() {
            condition.powered = false;
        }
    }

    fn is_followed(&self) -> bool {
        self.followed.is_some() && self.followed == self.trajectory.epoch
    }

    fn progress(&self) -> Progress {
        let progress = self.trajectory.progress();
        Progress {
            idle: progress.idle && self.up_to_date,
            held: progress.held && self.up_to_date,
            ..progress
        }
    }

    pub(super) fn make(&mut self, step: Move) {
        self.actions.clear();
        self.refused = false;
        match step {
            Move::Configure(has_switches) => {
                self.application.configured(500, has_switches);
                self.order(&MotionOrder::Configure(
                    crate::config::Config::default().motion_settings(),
                ));
                self.condition.unreferenced = Some(0);
                self.supervisor_asked = true;
            }
            Move::Command(command) => {
                self.refused = self.application.command(command).is_err();
                let actions = self.application.take_actions();
                self.take(&actions);
            }
            Move::Bus(condition) => {
                self.supervisor_asked &= !ANSWERS.contains(&condition);
                self.application.bus(condition);
                let actions = self.application.take_actions();
                self.take(&actions);
            }
            Move::Release => self.up_to_date = true,
            Move::PathComes => self.trajectory.bring_path(),
            Move::Arrives => self.trajectory.arrive(),
            Move::Time(ms, first, second) => self.pass(ms, first, second),
        }
    }

    fn pass(&mut self, ms: u32, first: Change, second: Change) {
        self.now_ms += ms;
        self.change(first);
        self.change(second);
        // Homing has succeeded or failed before the second report.
        self.taking = false;
        let silent = first == Change::HostSilent || second == Change::HostSilent;
        let silence_ms = if silent { 501 } else { 0 };
        let mut progress = self.progress();
        if first == Change::Stalled || second == Change::Stalled {
            progress.stalled_ms = 2_004;
        }
        let actions = self
            .application
            .step(self.now_ms, &self.condition, progress, silence_ms);
        self.take(&actions);
    }

    fn order(&mut self, order: &MotionOrder) {
        self.trajectory.take(order, false);
        self.up_to_date = false;
    }

    /// Applies actions as the tasks that receive them do.
    fn take(&mut self, actions: &[Action]) {
        for action in actions {
            self.actions.push(*action);
            match *action {
                Action::Power(power) => {
                    if power != Power::On {
                        self.followed = None;
                        self.condition.searching = false;
                    }
                    if matches!(power, Power::QuickStop | Power::Off) {
                        self.order(&MotionOrder::Abandon);
                    }
                }
                Action::ClearFault => self.condition.fault = None,
                Action::Home { .. } => (self.followed, self.taking) = (None, true),
                Action::Place { pose, epoch } => self.order(&MotionOrder::Place { pose, epoch }),
                Action::Search => (self.followed, self.condition.searching) = (None, true),
                // The axes need time to stop: the end comes by itself.
                Action::EndSearch => {}
                Action::Follow { epoch } => self.followed = Some(epoch),
                Action::BeginPath => self.order(&MotionOrder::BeginPath),
                Action::Motion(command) => self.order(&MotionOrder::Command(command)),
                Action::RecoverBus => self.supervisor_asked = true,
                Action::SetOutput { .. } => {}
            }
        }
    }

    /// Checks a transition against the guarantees of the operating modes.
    pub(super) fn check(&self, before: &Self, step: Move) {
        let (application, old) = (&self.application, &before.application);
        let told = || std::format!("{step:?}\nfrom {before:?}\nto {self:?}");
        assert!(self.actions.len() < ACTIONS_MAX, "too many actions: {}", told());
        if self.refused {
            assert!(
                self.actions.is_empty() && self.key() == before.key(),
                "half refused: {}",
                told()
            );
        }
        let (enables, configures) = (
            step == Move::Command(Command::Enable),
            matches!(step, Move::Configure(_)),
        );
        let powers = self.actions.contains(&Action::Power(Power::On));
        assert!(
            !powers || enables && old.mode == Mode::DrivesOff && old.has_configuration,
            "power: {}",
            told()
        );
        // Power is taken only behind the brakes, and the brakes close only at standstill or when its time is over.
        let had_power = old.power.is_on();
        let is_behind_brakes = matches!(old.stop, Some(Stop::Brake { .. }));
        assert!(
            !self.actions.contains(&Action::Power(Power::Off)) || !had_power || is_behind_brakes,
            "power taken from a robot without brakes: {}",
            told()
        );
        // The path is kept only for what orders a stop and doubts nothing, and never once the bus has failed.
        let begins_on_path = self.actions.contains(&Action::Power(Power::PathStop));
        assert!(
            !begins_on_path || application.fault.is_some_and(|fault| fault.keeps_path()),
            "the path is kept in doubt: {}",
            told()
        );
        let has_failed = matches!(step, Move::Bus(BusCondition::Failed(_) | BusCondition::Refused(_)));
        assert!(
            !has_failed || application.power != Power::PathStop,
            "the path is kept without a bus: {}",
            told()
        );
        let is_over = matches!(old.stop, Some(Stop::Ramp { since_ms })
            if self.now_ms.wrapping_sub(since_ms) > STANDSTILL_MAX_MS);
        let brakes = !is_behind_brakes && matches!(application.stop, Some(Stop::Brake { .. }));
        assert!(
            !brakes || self.condition.standstill || is_over,
            "brakes in motion: {}",
            told()
        );
        let off = matches!(application.mode, Mode::Startup | Mode::BusConfiguring | Mode::Fault);
        assert!(
            !off || matches!(application.power, Power::Off | Power::FaultReset),
            "power in vain: {}",
            told()
        );
        let resets = application.power == Power::FaultReset;
        assert!(
            !resets || application.recovering_since_ms.is_some(),
            "a reset for ever: {}",
            told()
        );
        let is_fault = application.mode == Mode::Fault;
        // Axes are led to their switches with power only, and nothing else moves them meanwhile.
        let searches = application.mode == Mode::Homing;
        assert!(
            !searches || application.power == Power::On && self.followed.is_none(),
            "a search beside a path: {}",
            told()
        );
        assert!(
            !is_fault || application.fault.is_some(),
            "a fault without a cause: {}",
            told()
        );
        let stops = application.stop.is_some() || application.cancelling;
        assert!(
            application.mode != Mode::Stopping || stops,
            "it stops for nothing: {}",
            told()
        );
        // A mode that may move requires a reference in the last report.
        let moves = |mode| matches!(mode, Mode::Idle | Mode::Moving | Mode::Drawing | Mode::Holding);
        if moves(application.mode) && matches!(step, Move::Time(..)) {
            assert!(self.condition.unreferenced.is_none(), "without a reference: {}", told());
        }
        // No motion starts while the sampler follows no setpoints.
        let begins = matches!(application.mode, Mode::Moving | Mode::Drawing) && old.mode == Mode::Idle;
        assert!(!begins || self.is_followed(), "nobody follows: {}", told());
        let latched = old.fault.is_none_or(|_| application.fault.is_some());
        let cleared = configures || matches!(step, Move::Time(..)) && old.recovering_since_ms.is_some();
        assert!(latched || cleared, "a fault was forgotten: {}", told());
        let timers = self.timers();
        let long = timers.iter().take(3).filter(|(since_ms, _)| since_ms.is_some()).count();
        assert!(long <= 1, "two timers: {}", told());
    }

    pub(super) fn is_idle(&self) -> bool {
        self.application.mode == Mode::Idle && self.application.enabling == Enabling::No && self.is_followed()
    }

    /// Ends all faults of the world.
    pub(super) fn heal(&mut self) {
        let condition = &mut self.condition;
        (condition.silent, condition.interlock) = (None, None);
        condition.powered = false;
    }

    /// The operator acts sensibly in this mode, or waits; the world carries out what was requested. Returns the time
    /// that passed, ms, and the number of commands.
    pub(super) fn operate_sensibly(&mut self) -> (u32, u32) {
        self.make(Move::Release);
        if self.is_followed() && self.trajectory.data != Data::Awaited {
            self.make(Move::Arrives);
        }
        let power = self.application.power;
        if power == Power::FaultReset {
            self.condition.drive_fault = None;
        }
        let powered = power == Power::On && self.condition.drive_fault.is_none();
        (self.condition.powered, self.condition.unpowered) = (powered, !powered);
        self.condition.standstill = true;
        let application = &self.application;
        if self.supervisor_asked
            && application
                .recovering_since_ms
                .is_some_and(|since_ms| self.now_ms > since_ms)
            || application.mode == Mode::BusConfiguring
        {
            self.make(Move::Bus(BusCondition::Operational));
        }
        let application = &self.application;
        let referenced = self.condition.unreferenced.is_none();
        let busy = application.enabling != Enabling::No || application.recovering_since_ms.is_some();
        let wanted = match application.mode {
            _ if busy => None,
            Mode::Startup => Some(Move::Configure(application.has_switches)),
            Mode::DrivesOff if !referenced && !application.has_switches => Some(Move::Command(Command::Home)),
            Mode::Unreferenced => Some(Move::Command(Command::Home)),
            Mode::DrivesOff => Some(Move::Command(Command::Enable)),
            Mode::Moving | Mode::Drawing | Mode::Holding if !self.progress().idle => {
                Some(Move::Command(Command::Cancel))
            }
            Mode::Fault => Some(Move::Command(Command::Acknowledge)),
            _ => None,
        };
        let given = wanted.is_some_and(|step| {
            self.make(step);
            !self.refused
        });
        if self.taking || self.condition.searching {
            self.condition.unreferenced = None;
        }
        self.condition.searching = false;
        let before = self.key();
        self.pass(1, Change::Nothing, Change::Nothing);
        let mut ms = 1;
        if !given && self.key() == before {
            // Only time has to pass.
            let more_ms = self.times_ms().last().copied().unwrap_or(1);
            self.pass(more_ms, Change::Nothing, Change::Nothing);
            ms += more_ms;
        }
        (ms, u32::from(given))
    }
}
