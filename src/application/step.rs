//! The operating modes' step: transitions without a command, once a millisecond.

use super::{
    ACTIONS_MAX, Action, Application, BRAKE_DELAY_MS, BusCondition, Command, Condition, ENABLE_MAX_MS, Enabling, Fault,
    Mode, Power, Progress, RECOVERY_MAX_MS, STANDSTILL_MAX_MS, Stop,
};
use heapless::Vec;

/// Time until the reports of the other tasks reflect an action, ms.
pub(super) const SETTLE_MS: u32 = 2;
/// Time from a setpoint's planning until joints that stand have followed it, ms: 40 in the ring, 20 until a standstill is seen.
pub const FOLLOWED_MS: u32 = 60;
/// Time until the beginning and the result of a search show in the reports, ms.
pub(super) const SEARCH_BEGINS_MS: u32 = 5;
/// Time until a reset shows in the drives' status, ms.
pub(super) const RESET_MS: u32 = 30;

impl Application {
    /// Advances by one millisecond: takes the reports and returns the actions.
    pub fn step(
        &mut self,
        now_ms: u32,
        condition: &Condition,
        progress: Progress,
        host_silence_ms: u32,
    ) -> Vec<Action, ACTIONS_MAX> {
        self.now_ms = now_ms;
        self.condition = *condition;
        match (condition.fault, self.fault) {
            (Some(fault), None) => self.enter_fault(fault),
            (Some(fault), Some(known)) if fault.ends_stop_for(&known) => self.fault = Some(fault),
            _ => {}
        }
        if progress.stalled_ms > 0 && self.fault.is_none() {
            self.enter_fault(Fault::MotionStalled {
                vertex: progress.executed,
                waited_ms: progress.stalled_ms,
            });
        }
        self.check_referenced();
        self.step_enabling();
        self.step_stop();
        self.step_recovery();
        self.step_motion(progress, host_silence_ms);
        self.step_inputs();
        self.take_actions()
    }

    /// Requires the angles of all axes in modes in which the robot moves or may be asked to move.
    fn check_referenced(&mut self) {
        let needed = match self.mode {
            Mode::Idle | Mode::Moving | Mode::Drawing | Mode::Holding => true,
            Mode::Stopping => self.cancelling,
            _ => false,
        };
        if let Some(axis) = self.condition.unreferenced.filter(|_| needed) {
            self.enter_fault(Fault::ReferenceLost { axis });
        }
    }

    fn step_enabling(&mut self) {
        match self.enabling {
            Enabling::No => {}
            Enabling::Homing { since_ms } => {
                let taken = self.condition.unreferenced.is_none() && self.waited_ms(since_ms) >= SETTLE_MS;
                if !taken && self.waited_ms(since_ms) <= ENABLE_MAX_MS {
                    return;
                }
                self.enabling = Enabling::No;
                if matches!(self.mode, Mode::Unreferenced | Mode::Idle) {
                    // Homing ends following; if it failed, the drives hold the pose again.
                    self.follow_from_here();
                    self.mode = if taken { Mode::Idle } else { Mode::Unreferenced };
                }
            }
            Enabling::Powering { since_ms } => {
                if self.condition.powered {
                    self.enabling = Enabling::No;
                    self.mode = match self.condition.unreferenced {
                        None => Mode::Idle,
                        Some(_) => Mode::Unreferenced,
                    };
                } else if self.waited_ms(since_ms) > ENABLE_MAX_MS {
                    self.enter_fault(Fault::EnableTimeout {
                        waited_ms: ENABLE_MAX_MS as u16,
                    });
                }
            }
        }
    }

    fn step_stop(&mut self) {
        let Some(stop) = self.stop else { return };
        self.stop = match stop {
            Stop::Ramp { since_ms } if self.condition.standstill || self.waited_ms(since_ms) > STANDSTILL_MAX_MS => {
                Some(Stop::Brake { since_ms: self.now_ms })
            }
            Stop::Brake { since_ms } if self.waited_ms(since_ms) >= BRAKE_DELAY_MS => {
                self.act(Action::Power(Power::Off));
                Some(Stop::Release { since_ms: self.now_ms })
            }
            Stop::Release { since_ms } if self.condition.unpowered || self.waited_ms(since_ms) > ENABLE_MAX_MS => {
                self.mode = if self.fault.is_some() {
                    Mode::Fault
                } else {
                    Mode::DrivesOff
                };
                None
            }
            waiting => Some(waiting),
        };
    }

    fn step_recovery(&mut self) {
        let Some(since_ms) = self.recovering_since_ms else {
            return;
        };
        if self.waited_ms(since_ms) < RESET_MS {
            return;
        }
        if !self.has_configuration {
            self.recovering_since_ms = None;
            self.fault = None;
            self.mode = Mode::Startup;
            return;
        }
        let timed_out = self.waited_ms(since_ms) > RECOVERY_MAX_MS;
        match (self.condition.fault, self.missing()) {
            // The fault came after the acknowledgement.
            (Some(fault), _) => self.give_up(fault),
            (None, None) => {
                self.recovering_since_ms = None;
                self.fault = None;
                self.act(Action::Power(Power::Off));
                self.act(Action::ClearFault);
                self.mode = Mode::DrivesOff;
            }
            (None, Some(missing)) if timed_out => self.give_up(missing),
            (None, Some(Fault::Drive { .. })) => self.act(Action::Power(Power::FaultReset)),
            (None, Some(_)) => {}
        }
    }

    /// What keeps the drives from being enabled again, as far as known.
    fn missing(&self) -> Option<Fault> {
        match (self.bus, self.condition.silent, self.condition.drive_fault) {
            (Some(BusCondition::Failed(fault) | BusCondition::Refused(fault)), ..) => Some(fault),
            (None, ..) => Some(Fault::RepairTimeout {
                waited_ms: RECOVERY_MAX_MS as u16,
            }),
            (Some(BusCondition::Operational), Some(slave), _) => Some(Fault::SlaveLost { slave }),
            (Some(BusCondition::Operational), None, drive_fault) => drive_fault,
        }
    }

    /// Ends an acknowledgement that failed, with the cause.
    pub(super) fn give_up(&mut self, fault: Fault) {
        self.recovering_since_ms = None;
        self.fault = Some(fault);
        self.act(Action::Power(Power::Off));
    }

    /// Follows the hold and start inputs. A start that the mode refuses has no effect.
    fn step_inputs(&mut self) {
        if self.mode == Mode::Drawing && self.condition.hold_input.is_some() {
            self.hold();
        }
        let was_closed = core::mem::replace(&mut self.start_was_closed, self.condition.start_input);
        if self.condition.start_input && !was_closed {
            let _ = match self.mode {
                Mode::DrivesOff => self.command(Command::Enable),
                Mode::Holding => self.command(Command::Resume),
                _ => Ok(()),
            };
        }
    }

    /// Waits for the end of a search; a silent host ends it early.
    fn step_homing(&mut self, host_silence_ms: u32) {
        if host_silence_ms > u32::from(self.host_silence_max_ms) {
            self.act(Action::EndSearch);
        }
        if self.condition.searching {
            self.moved_ms = self.now_ms;
        }
        if !self.condition.searching && self.waited_ms(self.moved_ms) > SEARCH_BEGINS_MS {
            self.mode = match self.condition.unreferenced {
                None => Mode::Idle,
                Some(_) => Mode::Unreferenced,
            };
            self.follow_from_here();
        }
    }

    fn step_motion(&mut self, progress: Progress, host_silence_ms: u32) {
        // When the trajectory is at rest, its last setpoints are still in the ring. Joints that stand meanwhile say nothing: the
        // pen may rest before its last lift.
        if !progress.idle && self.mode != Mode::Homing {
            self.moved_ms = self.now_ms;
        }
        let at_rest = progress.idle && self.condition.standstill && self.waited_ms(self.moved_ms) >= FOLLOWED_MS;
        match self.mode {
            Mode::Homing => self.step_homing(host_silence_ms),
            Mode::Drawing if host_silence_ms > u32::from(self.host_silence_max_ms) => self.hold(),
            Mode::Drawing | Mode::Moving | Mode::Holding if at_rest => self.mode = Mode::Idle,
            Mode::Stopping if self.cancelling && at_rest => {
                self.cancelling = false;
                self.mode = Mode::Idle;
            }
            _ => {}
        }
    }
}
