//! The power state machine of CiA 402 drives: from status word and target to control word.
//!
//! The state is decoded with the masks 0x4F and 0x6F of the profile's table. [`step`] is pure: every millisecond it
//! returns the control word that leads one state further towards the target.
//!
//! Invariants: a drive in quick stop is never enabled on the way: it has to be switched off first; a fault is reset
//! only on request, by the 0 to 1 edge of bit 7 between [`DriveTarget::Off`] and [`DriveTarget::FaultReset`].

/// Status word of the drive (object 0x6041).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StatusWord(pub u16);

/// Control word to the drive (object 0x6040).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ControlWord(pub u16);

impl ControlWord {
    /// Switches the power off at once.
    pub const DISABLE_VOLTAGE: Self = Self(0x0000);
    /// Brakes with the quick-stop ramp.
    pub const QUICK_STOP: Self = Self(0x0002);
    /// Leads to ready to switch on.
    pub const SHUTDOWN: Self = Self(0x0006);
    /// Leads to switched on.
    pub const SWITCH_ON: Self = Self(0x0007);
    /// Leads to operation enabled.
    pub const ENABLE_OPERATION: Self = Self(0x000F);
    /// Bit 7: its rising edge resets a fault.
    pub const FAULT_RESET: Self = Self(0x0080);
}

/// State of the power stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum DriveState {
    /// Starting up; also any pattern without meaning.
    NotReadyToSwitchOn,
    /// Without power; not ready for power yet.
    SwitchOnDisabled,
    /// Power may be switched on.
    ReadyToSwitchOn,
    /// Power is on, the motor is free.
    SwitchedOn,
    /// The motor follows the setpoints.
    OperationEnabled,
    /// Braking, or stopped by a quick stop.
    QuickStopActive,
    /// Reacting to a fault.
    FaultReactionActive,
    /// In fault, without power.
    Fault,
}

impl StatusWord {
    /// The state given by the word.
    #[inline]
    pub const fn state(self) -> DriveState {
        STATES[(self.0 & 0x0F | self.0 >> 1 & 0x30) as usize]
    }

    /// The state according to the profile's table.
    const fn decoded(self) -> DriveState {
        match (self.0 & 0x4F, self.0 & 0x6F) {
            (0x40, _) => DriveState::SwitchOnDisabled,
            (0x0F, _) => DriveState::FaultReactionActive,
            (0x08, _) => DriveState::Fault,
            (_, 0x21) => DriveState::ReadyToSwitchOn,
            (_, 0x23) => DriveState::SwitchedOn,
            (_, 0x27) => DriveState::OperationEnabled,
            (_, 0x07) => DriveState::QuickStopActive,
            _ => DriveState::NotReadyToSwitchOn,
        }
    }

    /// Bit 4: the power stage is supplied.
    pub const fn voltage_enabled(self) -> bool {
        self.0 & 1 << 4 != 0
    }

    /// Bit 7: the drive reports a warning.
    pub const fn warning(self) -> bool {
        self.0 & 1 << 7 != 0
    }

    /// Whether the motor may be under torque.
    pub const fn is_powered(self) -> bool {
        matches!(
            self.state(),
            DriveState::SwitchedOn
                | DriveState::OperationEnabled
                | DriveState::QuickStopActive
                | DriveState::FaultReactionActive
        )
    }

    /// Whether the drive is in fault or reacting to a fault.
    pub const fn is_fault(self) -> bool {
        matches!(self.state(), DriveState::Fault | DriveState::FaultReactionActive)
    }
}

/// The state for each pattern of the six state bits: bits 0 to 3, 5 and 6 of the status word.
const STATES: [DriveState; 64] = {
    let mut states = [DriveState::NotReadyToSwitchOn; 64];
    let mut pattern = 0;
    while pattern < states.len() {
        states[pattern] = StatusWord((pattern & 0x0F | (pattern & 0x30) << 1) as u16).decoded();
        pattern += 1;
    }
    states
};

/// Target state of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum DriveTarget {
    /// Without power.
    #[default]
    Off,
    /// In operation.
    Enabled,
    /// Braking with the quick-stop ramp.
    QuickStop,
    /// Without power, and a fault reset by the rising edge since [`DriveTarget::Off`].
    FaultReset,
}

/// The control word that leads a drive one state further towards `target`.
pub const fn step(status: StatusWord, target: DriveTarget) -> ControlWord {
    step_from(status.state(), target)
}

/// The control word of [`step`] for a decoded state.
pub const fn step_from(state: DriveState, target: DriveTarget) -> ControlWord {
    use DriveState as S;
    use DriveTarget as T;
    match (target, state) {
        (T::FaultReset, S::Fault) => ControlWord::FAULT_RESET,
        (_, S::Fault | S::FaultReactionActive | S::NotReadyToSwitchOn) => ControlWord::DISABLE_VOLTAGE,

        (T::Off | T::FaultReset, S::OperationEnabled | S::SwitchedOn) => ControlWord::SHUTDOWN,
        (T::Off | T::FaultReset, _) => ControlWord::DISABLE_VOLTAGE,

        (T::Enabled, S::SwitchOnDisabled) => ControlWord::SHUTDOWN,
        (T::Enabled, S::ReadyToSwitchOn) => ControlWord::SWITCH_ON,
        (T::Enabled, S::SwitchedOn | S::OperationEnabled) => ControlWord::ENABLE_OPERATION,
        (T::Enabled, S::QuickStopActive) => ControlWord::QUICK_STOP,

        (T::QuickStop, S::SwitchOnDisabled) => ControlWord::DISABLE_VOLTAGE,
        (T::QuickStop, _) => ControlWord::QUICK_STOP,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The state of a drive after a control word; transitions are numbered as in the profile's diagram.
    fn drive(state: DriveState, before: u16, control: u16) -> DriveState {
        use DriveState::*;
        let reset = control & !before & 0x80 != 0;
        let no_voltage = control & 0x02 == 0;
        let quick_stop = control & 0x06 == 0x02;
        match (state, control & 0x0F) {
            (NotReadyToSwitchOn, _) => SwitchOnDisabled,
            (Fault, _) if reset => SwitchOnDisabled,
            (FaultReactionActive, _) => Fault,
            (Fault, _) => Fault,
            (_, _) if no_voltage => SwitchOnDisabled,
            (OperationEnabled, _) if quick_stop => QuickStopActive,
            (QuickStopActive, _) => QuickStopActive,
            (_, _) if quick_stop => SwitchOnDisabled,
            (_, 0x06) => ReadyToSwitchOn,
            (ReadyToSwitchOn | OperationEnabled, 0x07) => SwitchedOn,
            (SwitchedOn, 0x0F) => OperationEnabled,
            (other, _) => other,
        }
    }

    fn word(state: DriveState) -> StatusWord {
        StatusWord(match state {
            DriveState::NotReadyToSwitchOn => 0x0000,
            DriveState::SwitchOnDisabled => 0x0250,
            DriveState::ReadyToSwitchOn => 0x0231,
            DriveState::SwitchedOn => 0x0233,
            DriveState::OperationEnabled => 0x0637,
            DriveState::QuickStopActive => 0x0217,
            DriveState::FaultReactionActive => 0x021F,
            DriveState::Fault => 0x0218,
        })
    }

    fn lead(mut state: DriveState, target: DriveTarget) -> DriveState {
        let mut before = 0;
        for _ in 0..10 {
            let control = step(word(state), target).0;
            state = drive(state, before, control);
            before = control;
        }
        state
    }

    const ALL: [DriveState; 8] = [
        DriveState::NotReadyToSwitchOn,
        DriveState::SwitchOnDisabled,
        DriveState::ReadyToSwitchOn,
        DriveState::SwitchedOn,
        DriveState::OperationEnabled,
        DriveState::QuickStopActive,
        DriveState::FaultReactionActive,
        DriveState::Fault,
    ];

    #[test]
    fn every_state_survives_its_status_word_whatever_the_other_bits_are() {
        for state in ALL {
            assert_eq!(word(state).state(), state);
            assert_eq!(StatusWord(word(state).0 ^ 0xFF90).state(), state);
        }
    }

    #[test]
    fn every_state_without_fault_or_quick_stop_is_led_to_operation() {
        for state in ALL {
            let expected = match state {
                DriveState::Fault | DriveState::FaultReactionActive => DriveState::Fault,
                DriveState::QuickStopActive => DriveState::QuickStopActive,
                _ => DriveState::OperationEnabled,
            };
            assert_eq!(lead(state, DriveTarget::Enabled), expected, "from {state:?}");
        }
    }

    #[test]
    fn off_ends_without_power_from_every_state() {
        for state in ALL {
            let end = lead(state, DriveTarget::Off);
            assert!(!word(end).is_powered(), "{state:?} ended in {end:?}");
        }
    }

    #[test]
    fn a_quick_stop_brakes_and_stays() {
        assert_eq!(
            lead(DriveState::OperationEnabled, DriveTarget::QuickStop),
            DriveState::QuickStopActive
        );
        assert_eq!(
            lead(DriveState::SwitchOnDisabled, DriveTarget::QuickStop),
            DriveState::SwitchOnDisabled
        );
    }

    #[test]
    fn a_fault_is_reset_by_an_edge_and_never_by_another_target() {
        assert_eq!(
            lead(DriveState::Fault, DriveTarget::FaultReset),
            DriveState::SwitchOnDisabled
        );
        assert_eq!(
            lead(DriveState::FaultReactionActive, DriveTarget::FaultReset),
            DriveState::SwitchOnDisabled
        );
        for target in [DriveTarget::Off, DriveTarget::Enabled, DriveTarget::QuickStop] {
            assert_eq!(lead(DriveState::Fault, target), DriveState::Fault);
        }
        // Bit 7 is never left set, so the next reset has a rising edge.
        for state in ALL {
            assert_eq!(step(word(state), DriveTarget::Off).0 & 0x80, 0);
        }
    }
}
