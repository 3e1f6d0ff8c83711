//! Operating modes: what the robot may do in each, and how each motion ends in a standstill.
//!
//! `Startup -> BusConfiguring -> DrivesOff -> Unreferenced -> Idle -> Drawing <-> Holding -> Idle`, and `Fault` from
//! any mode, with `Stopping` in between while the drives still obey. [`Application`] is the state machine alone. Each
//! millisecond it takes the reports of the 1 kHz tasks, the trajectory and the bus, and answers with [`Action`]s. The
//! critical tasks do not wait for it: they have already stopped the drives when it learns of a fault.
//!
//! Invariants: a command that the mode does not allow is refused with the reason and changes nothing; the drives lose
//! power only after a standstill and the brake delay; a fault stays latched until it is acknowledged; a failed
//! acknowledgement leaves a fault that names the remaining cause; every wait has a time limit.

mod action;
mod command;
mod condition;
mod fault;
pub mod homing;
mod mode;
mod step;

pub use action::{Action, Power};
pub use command::{Command, IoRefusal, Refusal};
pub use condition::{BusCondition, Condition, Progress};
pub use fault::{Fault, InputCause, PathStopFailure, StopSource};
pub use mode::Mode;
pub use step::FOLLOWED_MS;

use crate::motion::MotionCommand;
use crate::robots::JointAngles;
use heapless::Vec;

/// Time for the brakes to close before the power is taken from the drives, ms.
pub const BRAKE_DELAY_MS: u32 = 100;
/// Longest wait for a standstill after a stop has begun, ms.
pub const STANDSTILL_MAX_MS: u32 = 1_000;
/// Longest wait for the drives to follow a change of their power, ms.
pub const ENABLE_MAX_MS: u32 = 3_000;
/// Longest wait for the bus and the drives to recover after an acknowledgement, ms.
pub const RECOVERY_MAX_MS: u32 = 10_000;
/// Most actions of one step.
pub const ACTIONS_MAX: usize = 8;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Enabling {
    No,
    /// Homing: waiting until the angles are valid.
    Homing {
        since_ms: u32,
    },
    /// Switching the drives' power on.
    Powering {
        since_ms: u32,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stop {
    /// Decelerating to a standstill.
    Ramp { since_ms: u32 },
    /// At rest; the brakes are closing.
    Brake { since_ms: u32 },
    /// Switching the drives' power off.
    Release { since_ms: u32 },
}

/// The state machine of the operating modes.
#[derive(Debug)]
pub struct Application {
    mode: Mode,
    fault: Option<Fault>,
    now_ms: u32,
    condition: Condition,
    bus: Option<BusCondition>,
    /// Whether a start input was closed in the last millisecond.
    start_was_closed: bool,
    epoch: u8,
    override_percent: u8,
    enabling: Enabling,
    stop: Option<Stop>,
    recovering_since_ms: Option<u32>,
    cancelling: bool,
    /// When a motion was ordered, or the trajectory or the search last had something to do.
    moved_ms: u32,
    host_silence_max_ms: u16,
    /// Power state last asked of the drives.
    power: Power,
    has_configuration: bool,
    /// Whether axes are homed by switches, which needs power.
    has_switches: bool,
    actions: Vec<Action, ACTIONS_MAX>,
}

impl Default for Application {
    fn default() -> Self {
        Self::new()
    }
}

/// Time from a quick stop request until the drives decelerate, ms: bus cycles and the drives' own delay.
const QUICK_STOP_DELAY_MS: u32 = 30;
impl Application {
    /// The state machine before a configuration has been taken.
    pub const fn new() -> Self {
        Self {
            mode: Mode::Startup,
            fault: None,
            now_ms: 0,
            condition: Condition::UNKNOWN,
            bus: None,
            start_was_closed: false,
            epoch: 0,
            override_percent: 100,
            enabling: Enabling::No,
            stop: None,
            recovering_since_ms: None,
            cancelling: false,
            moved_ms: 0,
            host_silence_max_ms: 500,
            power: Power::Off,
            has_configuration: false,
            has_switches: false,
            actions: Vec::new(),
        }
    }

    /// The operating mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The latched fault.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Whether the fault was acknowledged and the bus and drives are still recovering.
    pub fn is_recovering(&self) -> bool {
        self.recovering_since_ms.is_some()
    }

    /// Path speed override, percent.
    pub fn override_percent(&self) -> u8 {
        self.override_percent
    }

    /// The last report of the critical tasks.
    pub fn condition(&self) -> &Condition {
        &self.condition
    }

    /// Whether another configuration is accepted now: the drives are without power and no operation is in progress.
    pub fn may_configure(&self) -> bool {
        // In a fault, only one that a different configuration may resolve: the bus is not the expected one.
        let at_rest = match self.mode {
            Mode::Startup | Mode::DrivesOff => true,
            Mode::Fault => self.fault.is_some_and(|fault| fault.is_of_configuration()),
            _ => false,
        };
        at_rest && self.stop.is_none() && self.enabling == Enabling::No && self.recovering_since_ms.is_none()
    }

    /// Whether outputs of terminals may be set: the bus is operational and no fault or stop is in progress.
    pub fn may_set_outputs(&self) -> bool {
        !matches!(
            self.mode,
            Mode::Startup | Mode::BusConfiguring | Mode::Stopping | Mode::Fault
        )
    }

    /// Reports that a checked configuration was taken and that the bus is being brought up. `has_switches` tells whether axes
    /// are homed by switches.
    pub fn configured(&mut self, host_silence_max_ms: u16, has_switches: bool) {
        self.host_silence_max_ms = host_silence_max_ms;
        self.has_switches = has_switches;
        self.has_configuration = true;
        self.mode = Mode::BusConfiguring;
        self.fault = None;
        self.bus = None;
    }

    /// Reports that the repair waits for a slave that is still starting up: its time limit begins again. The supervisor
    /// ends a wait that takes too long.
    pub fn bus_waits(&mut self) {
        if let Some(since_ms) = &mut self.recovering_since_ms
            && self.now_ms.wrapping_sub(*since_ms) >= step::RESET_MS
        {
            *since_ms = self.now_ms.wrapping_sub(step::RESET_MS);
        }
    }

    /// Takes a report of the bus's supervisor.
    pub fn bus(&mut self, condition: BusCondition) {
        let was_whole = self.bus == Some(BusCondition::Operational);
        if condition != BusCondition::Operational {
            self.stop_at_once();
        }
        match (condition, self.bus) {
            // The first slave that fails is the cause; failures of slaves behind it follow from it.
            (BusCondition::Failed(_), Some(BusCondition::Failed(_) | BusCondition::Refused(_))) => {}
            _ => self.bus = Some(condition),
        }
        match (condition, self.fault) {
            (BusCondition::Operational, _) if self.mode == Mode::BusConfiguring => self.mode = Mode::DrivesOff,
            (BusCondition::Operational, _) => {}
            (BusCondition::Refused(fault), Some(_)) if self.recovering_since_ms.is_some() => self.give_up(fault),
            // The bus was operational and no longer is.
            (BusCondition::Failed(_), Some(_)) if self.recovering_since_ms.is_some() && was_whole => self.recover_bus(),
            (BusCondition::Failed(fault) | BusCondition::Refused(fault), None) => self.enter_fault(fault),
            (BusCondition::Failed(fault) | BusCondition::Refused(fault), Some(known)) => {
                if fault.is_more_precise_than(&known) {
                    self.fault = Some(fault);
                }
            }
        }
    }

    /// Carries out a command, or refuses it with the reason.
    ///
    /// # Errors
    /// The reason; nothing has changed.
    pub fn command(&mut self, command: Command) -> Result<(), Refusal> {
        match command {
            Command::Stop => {
                self.enter_fault(Fault::EmergencyStop(StopSource::Link));
                Ok(())
            }
            Command::Acknowledge => self.acknowledge(),
            Command::Home => self.home(None),
            Command::HomeAt { pose, .. } => self.home(Some(pose)),
            Command::Enable => self.enable(),
            Command::Disable => self.disable(),
            Command::Draw { .. } => {
                self.require_idle()?;
                self.act(Action::BeginPath);
                self.enter_motion(Mode::Drawing);
                Ok(())
            }
            Command::Hold => {
                self.require(Mode::Drawing)?;
                self.hold();
                Ok(())
            }
            Command::Resume => {
                self.require(Mode::Holding)?;
                if let Some(io) = self.condition.hold_input {
                    return Err(Refusal::Io {
                        io,
                        reason: IoRefusal::Holds,
                    });
                }
                self.act(Action::Motion(MotionCommand::Resume));
                self.enter_motion(Mode::Drawing);
                Ok(())
            }
            Command::Cancel => {
                if self.mode == Mode::Homing {
                    self.act(Action::EndSearch);
                    return Ok(());
                }
                if !matches!(self.mode, Mode::Drawing | Mode::Holding | Mode::Moving) {
                    return Err(Refusal::NotInMode(self.mode));
                }
                self.act(Action::Motion(MotionCommand::Cancel));
                self.enter_motion(Mode::Stopping);
                self.cancelling = true;
                Ok(())
            }
            Command::Override { percent } => {
                if !(10..=200).contains(&percent) {
                    return Err(Refusal::OverrideRange(percent));
                }
                self.override_percent = percent;
                self.act(Action::Motion(MotionCommand::Override(percent)));
                Ok(())
            }
            Command::Move { position } => self.start_move(MotionCommand::MoveTo(position)),
            Command::Pen { pen } => self.start_move(MotionCommand::Pen(pen)),
            Command::Jog { velocity_mm_s } => self.jog(velocity_mm_s),
            Command::SetOutput { io, value } => {
                if !self.may_set_outputs() {
                    return Err(Refusal::NotInMode(self.mode));
                }
                self.act(Action::SetOutput { io, value });
                Ok(())
            }
        }
    }

    /// Actions that have become due since the last call; call it after each command.
    pub fn take_actions(&mut self) -> Vec<Action, ACTIONS_MAX> {
        core::mem::take(&mut self.actions)
    }

    fn act(&mut self, action: Action) {
        if let Action::Power(power) = action {
            self.power = power;
        }
        // One command or one millisecond makes at most a handful of transitions; the capacity covers all of them.
        let _ = self.actions.push(action);
    }

    fn require(&self, mode: Mode) -> Result<(), Refusal> {
        if self.mode == mode {
            Ok(())
        } else {
            Err(Refusal::NotInMode(self.mode))
        }
    }

    /// Checks that a motion may begin: no operation is in progress. Homing counts as one, because it takes the
    /// setpoints of a motion away from the drives.
    fn require_idle(&self) -> Result<(), Refusal> {
        match self.mode {
            Mode::Idle if self.enabling != Enabling::No => Err(Refusal::Moving),
            Mode::Idle => Ok(()),
            Mode::Unreferenced => Err(Refusal::NotReferenced),
            Mode::Startup => Err(Refusal::NotConfigured),
            mode => Err(Refusal::NotInMode(mode)),
        }
    }

    fn enter_motion(&mut self, mode: Mode) {
        self.mode = mode;
        self.moved_ms = self.now_ms;
    }

    fn start_move(&mut self, command: MotionCommand) -> Result<(), Refusal> {
        self.require_idle()?;
        self.act(Action::Motion(command));
        self.enter_motion(Mode::Moving);
        Ok(())
    }

    fn jog(&mut self, velocity_mm_s: [f32; 3]) -> Result<(), Refusal> {
        if velocity_mm_s.iter().any(|v| !v.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        if self.mode != Mode::Moving {
            self.require_idle()?;
        }
        self.act(Action::Motion(MotionCommand::Jog(velocity_mm_s.map(f64::from))));
        self.enter_motion(Mode::Moving);
        Ok(())
    }

    fn hold(&mut self) {
        self.act(Action::Motion(MotionCommand::Hold));
        self.mode = Mode::Holding;
    }

    fn enable(&mut self) -> Result<(), Refusal> {
        match self.mode {
            Mode::DrivesOff if self.enabling != Enabling::No || self.stop.is_some() => Err(Refusal::Moving),
            Mode::DrivesOff => {
                if let Some(stop) = self.condition.stop_input {
                    return Err(Refusal::CauseRemains(stop));
                }
                self.follow_from_here();
                self.act(Action::Power(Power::On));
                self.enabling = Enabling::Powering { since_ms: self.now_ms };
                Ok(())
            }
            Mode::Startup => Err(Refusal::NotConfigured),
            Mode::Idle | Mode::Unreferenced => Ok(()),
            mode => Err(Refusal::NotInMode(mode)),
        }
    }

    fn disable(&mut self) -> Result<(), Refusal> {
        match self.mode {
            Mode::Idle | Mode::Unreferenced | Mode::Homing => {
                self.mode = Mode::Stopping;
                self.enabling = Enabling::No;
                self.begin_stop(Power::QuickStop);
                Ok(())
            }
            Mode::DrivesOff if self.enabling == Enabling::No => Ok(()),
            Mode::DrivesOff => Err(Refusal::Moving),
            mode => Err(Refusal::NotInMode(mode)),
        }
    }

    fn home(&mut self, near: Option<JointAngles>) -> Result<(), Refusal> {
        if !matches!(self.mode, Mode::DrivesOff | Mode::Unreferenced | Mode::Idle) {
            return Err(Refusal::NotInMode(self.mode));
        }
        if !self.condition.standstill || self.enabling != Enabling::No {
            return Err(Refusal::Moving);
        }
        if self.has_switches && near.is_none() {
            return self.search();
        }
        self.act(Action::Home { near });
        self.enabling = Enabling::Homing { since_ms: self.now_ms };
        Ok(())
    }

    /// Leads the axes to their switches.
    fn search(&mut self) -> Result<(), Refusal> {
        if self.mode == Mode::DrivesOff {
            return Err(Refusal::NeedsPower);
        }
        self.act(Action::Search);
        self.enter_motion(Mode::Homing);
        Ok(())
    }

    fn acknowledge(&mut self) -> Result<(), Refusal> {
        self.require(Mode::Fault)?;
        if self.stop.is_some() {
            return Err(Refusal::Moving);
        }
        if self.recovering_since_ms.is_some() {
            return Err(Refusal::Recovering);
        }
        if let Some(interlock) = self.condition.interlock {
            return Err(Refusal::CauseRemains(interlock.fault()));
        }
        // A terminal that is missing has to be brought back first.
        if let Some(
            stop @ Fault::StopInput {
                cause: InputCause::Open,
                ..
            },
        ) = self.condition.stop_input
        {
            return Err(Refusal::CauseRemains(stop));
        }
        self.recovering_since_ms = Some(self.now_ms);
        if !self.has_configuration {
            self.act(Action::ClearFault);
            return Ok(());
        }
        // The supervisor has to check the bus: slaves that left OP may continue to answer with their last data.
        self.recover_bus();
        self.act(Action::ClearFault);
        self.act(Action::Power(match self.condition.drive_fault {
            Some(_) => Power::FaultReset,
            None => Power::Off,
        }));
        Ok(())
    }

    fn recover_bus(&mut self) {
        self.act(Action::RecoverBus);
        self.bus = None;
    }

    fn follow_from_here(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        self.act(Action::Place {
            pose: self.condition.pose,
            epoch: self.epoch,
        });
        self.act(Action::Follow { epoch: self.epoch });
        self.act(Action::Motion(MotionCommand::Override(self.override_percent)));
    }

    fn enter_fault(&mut self, fault: Fault) {
        if self.fault.is_none() {
            self.fault = Some(fault);
        }
        self.enabling = Enabling::No;
        self.cancelling = false;
        self.recovering_since_ms = None;
        // Drives that send nothing are not proof of power off: the last power request counts too.
        let may_have_power = self.power.is_on() || !self.condition.unpowered;
        if may_have_power {
            self.mode = Mode::Stopping;
            let keeps_path = fault.keeps_path() && self.fault.is_some_and(|first| first.keeps_path());
            let how = if keeps_path { Power::PathStop } else { Power::QuickStop };
            if self.stop.is_none() {
                self.begin_stop(how);
            } else if how == Power::QuickStop {
                self.stop_at_once();
            }
        } else {
            self.act(Action::Power(Power::Off));
            self.mode = Mode::Fault;
            self.stop = None;
        }
    }

    fn begin_stop(&mut self, how: Power) {
        self.act(Action::Power(how));
        self.stop = Some(Stop::Ramp { since_ms: self.now_ms });
    }

    /// Ends braking on the path by the drives' quick stop.
    fn stop_at_once(&mut self) {
        if self.power == Power::PathStop {
            self.act(Action::Power(Power::QuickStop));
        }
    }

    fn waited_ms(&self, since_ms: u32) -> u32 {
        self.now_ms.wrapping_sub(since_ms)
    }
}

const _: () = assert!(BRAKE_DELAY_MS < STANDSTILL_MAX_MS);
// In any valid configuration the quick stop ends, and the standstill is detected, before the brakes close.
const _: () = assert!(
    crate::config::QUICK_STOP_MAX_MS + crate::control::sampler::STANDSTILL_MS as u32 + QUICK_STOP_DELAY_MS
        <= STANDSTILL_MAX_MS
);

const _: () = assert!(
    crate::control::path_stop::PATH_STOP_MAX_MS + crate::control::sampler::STANDSTILL_MS as u32 + QUICK_STOP_DELAY_MS
        <= STANDSTILL_MAX_MS
);

#[cfg(test)]
mod search;
#[cfg(test)]
mod tests;
