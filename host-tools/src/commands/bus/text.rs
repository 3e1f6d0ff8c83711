//! Texts about the bus: states, errors and what to try.

use crate::link::text;
use crate::master::MasterError;
use etherpen::application::Mode;
use etherpen::drives::cia402::{DriveState, StatusWord};
use etherpen::ethercat::coe::{abort_hint, abort_text};
use etherpen::ethercat::diagnostics::ServiceError;
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::state::{al_code_hint, al_code_text};
use etherpen::ethercat::wire::coe::Object;
use etherpen::ethercat::wire::mailbox::error_text;

/// An object in text form.
pub fn object(object: Object) -> String {
    format!("{:04X}:{:02}", object.index, object.sub)
}

/// AL status code with text and what to try; empty for 0.
pub fn al_code(number: u16) -> String {
    match number {
        0 => String::new(),
        number => format!("{number:#06x}, {}; {}", al_code_text(number), al_code_hint(number)),
    }
}

/// Name of a CiA 402 state, as in the profile.
pub fn drive_state(status_word: u16) -> &'static str {
    match StatusWord(status_word).state() {
        DriveState::NotReadyToSwitchOn => "not ready to switch on",
        DriveState::SwitchOnDisabled => "switch on disabled",
        DriveState::ReadyToSwitchOn => "ready to switch on",
        DriveState::SwitchedOn => "switched on",
        DriveState::OperationEnabled => "operation enabled",
        DriveState::QuickStopActive => "quick stop active",
        DriveState::FaultReactionActive => "fault reaction active",
        DriveState::Fault => "fault",
    }
}

/// What to try in a CiA 402 state that keeps a drive from working.
pub fn drive_hint(status_word: u16) -> &'static str {
    match StatusWord(status_word).state() {
        DriveState::Fault | DriveState::FaultReactionActive => {
            "read 603F:00 for the cause, remove it, then acknowledge the fault"
        }
        DriveState::QuickStopActive => "switch the drive off and on again",
        DriveState::NotReadyToSwitchOn => "wait for the drive to start up",
        DriveState::SwitchOnDisabled if !StatusWord(status_word).voltage_enabled() => "switch the mains on",
        _ => "",
    }
}

/// Why a request was not carried out, and what to try.
pub fn service_error(error: &ServiceError) -> String {
    match error {
        ServiceError::NoSlave { slaves: 0 } => "there are no slaves; check cable and supply of the first one".into(),
        ServiceError::NoSlave { slaves } => format!("there is no such slave; there are {slaves}, counted from 1"),
        ServiceError::NoCoe => "the slave has no mailbox, or none that speaks CoE, so it has no objects".into(),
        ServiceError::NotAllowed(mode) => format!(
            "nothing can be changed now: {}; disable the drives, or end what the robot does first",
            Mode::from_number(*mode).map_or("unknown mode", text::mode)
        ),
        ServiceError::Busy => "the bus is being brought up or repaired, or another program asks it; try again".into(),
        ServiceError::Interrupted => "the bus changed meanwhile; try again".into(),
        ServiceError::Piece { room } => format!("the value is too long; there is room for {room} bytes"),
        ServiceError::Bus(error) => bus_error(error),
    }
}

/// Why a step on the bus failed, and what to try.
pub fn bus_error(error: &BusError) -> String {
    match *error {
        BusError::NoLink { port } => format!("{}; {}", text::port_state(port), text::PORT_HINT),
        BusError::SdoAbort { object: at, code } => format!(
            "the slave aborted the access to {}: {code:#010x}, {}; {}",
            object(at),
            abort_text(code),
            abort_hint(code)
        ),
        BusError::State { expected, actual, code } => format!(
            "the slave was asked for {} and is in {}: AL status code {code:#06x}, {}; {}",
            text::al_state(expected),
            text::al_state(actual),
            al_code_text(code),
            al_code_hint(code)
        ),
        BusError::StateTimeout {
            expected,
            actual,
            waited_ms,
        } => format!(
            "the slave did not reach {} within {waited_ms} ms, it is in {}; look at its inputs and outputs",
            text::al_state(expected),
            text::al_state(actual)
        ),
        BusError::Lost { tries } => {
            format!("no frame came back in {tries} tries; check the cable to the first slave and its supply")
        }
        BusError::WorkingCounter { expected, actual } => {
            format!("{actual} slaves answered instead of {expected}; the slave has gone, or its memory ends there")
        }
        BusError::SlaveCount { expected: 0, actual: 0 } => {
            "no slave answers; check the cable to the first slave and its supply".into()
        }
        BusError::SlaveCount { expected, actual } => {
            format!("{actual} slaves answer instead of {expected}; check cables and supplies")
        }
        BusError::TooManySlaves { expected, actual } => {
            format!("there are {actual} slaves, more than the {expected} this program has room for")
        }
        BusError::MailboxTimeout { waited_ms } => {
            format!("the slave's mailbox stayed silent for {waited_ms} ms; power-cycle the slave if it persists")
        }
        BusError::Mailbox { detail } => {
            format!(
                "the slave answered by mailbox error {detail:#06x}: {}",
                error_text(detail)
            )
        }
        BusError::MailboxLength { expected, actual } => {
            format!("the slave's mailbox of {actual} bytes cannot be used (1 to {expected} bytes can)")
        }
        BusError::SdoLength {
            object: at,
            expected,
            actual,
        } => format!("{} has {actual} bytes, not {expected}; check the type", object(at)),
        BusError::Mapping {
            object: at,
            expected,
            actual: 0,
        } => format!(
            "{} ({expected} bits) is not in the process data; look at what 0x1c12 and 0x1c13 assign",
            object(at)
        ),
        BusError::Mapping {
            object: at,
            expected,
            actual,
        } => format!("{} takes {actual} bits of the process data, not {expected}", object(at)),
        BusError::Alignment { object: at, bit } => {
            format!(
                "{} begins at bit {bit} of the process data, not with a byte",
                object(at)
            )
        }
        BusError::ProcessLength { expected, actual } => {
            format!("the slave has {actual} bytes of process data in one direction, more than {expected}; assign less")
        }
        BusError::SiiBusy { waited_ms } => format!("the slave information memory was busy for {waited_ms} ms"),
        BusError::Sii { status } => {
            format!("the slave information memory reports an error (status {status:#06x}); it may be damaged")
        }
        BusError::MemberCount { expected, actual } => {
            format!("{actual} drives are there, {expected} are needed; check cables and supplies, and bus.drives")
        }
        BusError::Identity { expected, actual } => {
            format!("there is product {actual:08x} where {expected:08x} was; put the slave back or restart the bus")
        }
        BusError::Serial { expected, actual } => format!(
            "there is serial number {actual} where {expected} was: two slaves were swapped; put them back or restart \
             the bus"
        ),
        BusError::Station { expected, actual } => format!(
            "there is the slave with address {actual:#06x} where {expected:#06x} was: the cables were changed; put them \
             back or restart the bus"
        ),
        BusError::SdoAnswer { object: at } => {
            format!(
                "the slave's answer to the access to {} is no answer to it; try again",
                object(at)
            )
        }
        BusError::SdoToggle { object: at } => {
            format!("a part of {} was lost or came twice; try again", object(at))
        }
        BusError::ReadBack {
            object: at,
            expected,
            actual,
        } => format!(
            "{expected:#x} was written, but {} reads {actual:#x}; the slave does not take this value in this state",
            object(at)
        ),
        BusError::Range { object: at } => {
            format!("the value asked for does not fit {} of this slave", object(at))
        }
        BusError::NoRoom { expected, actual } => {
            format!(
                "{expected} bytes were to be sent, a frame has room for {actual} beside the process data; ask for less"
            )
        }
        BusError::NoInputs { waited_ms } => {
            format!("no inputs came from the slave within {waited_ms} ms; look at what 0x1c12 and 0x1c13 assign")
        }
        BusError::ClockDifference {
            expected_ns,
            actual_ns,
            waited_ms,
        } => format!(
            "the slave's clock is {actual_ns} ns from the reference after {waited_ms} ms, more than {expected_ns} ns; \
             without clocks (bus.clocks) it can be used all the same"
        ),
    }
}

/// Why the master on this computer cannot work, and what to try.
pub fn master_error(error: &MasterError) -> String {
    match error {
        MasterError::Refused { position, error, .. } => match position {
            Some(position) => format!("slave {}: {}", u16::from(*position) + 1, bus_error(error)),
            None => bus_error(error),
        },
        MasterError::Transport(cause) => {
            format!("the way to the segment was lost ({cause}); is the interface up, does the segment still run?")
        }
        MasterError::Silent { waited } => {
            format!(
                "nothing was heard of the bus for {:.0} s; try again",
                waited.as_secs_f64()
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aborts_and_states_come_with_number_text_and_what_to_try() {
        let abort = bus_error(&BusError::SdoAbort {
            object: Object::new(0x6060, 0),
            code: 0x0609_0030,
        });
        for part in ["6060:00", "0x06090030", "value out of range", "the device's limits"] {
            assert!(abort.contains(part), "{abort}");
        }
        let state = bus_error(&BusError::State {
            expected: 8,
            actual: 0x14,
            code: 0x1B,
        });
        for part in ["asked for OP", "SAFEOP with error", "0x001b", "watchdog", "cyclic data"] {
            assert!(state.contains(part), "{state}");
        }
        assert_eq!(drive_state(0x0237), "operation enabled");
        assert!(drive_hint(0x0008).contains("603F"));
    }
}
