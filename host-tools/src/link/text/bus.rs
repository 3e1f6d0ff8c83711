//! Texts about the bus: states of slaves and drives, errors, and what to try.

use super::mode;
use etherpen::application::Mode;
use etherpen::board::PortState;
use etherpen::drives::cia402::{DriveState, StatusWord};
use etherpen::ethercat::coe::{abort_hint, abort_text};
use etherpen::ethercat::diagnostics::ServiceError;
use etherpen::ethercat::error::{BusError, IdentityProperty};
use etherpen::ethercat::event::Step;
use etherpen::ethercat::state::{AlState, al_code_hint, al_code_text};
use etherpen::ethercat::wire::coe::Object;
use etherpen::ethercat::wire::foe;
use etherpen::ethercat::wire::mailbox::error_text;

/// The bus's Ethernet port in a few words.
pub fn port_state(port: PortState) -> &'static str {
    match port {
        PortState::Unknown => "nothing is known of the bus's Ethernet port",
        PortState::NoPhy => "no PHY answers at the bus's Ethernet port",
        PortState::Down => "the bus's Ethernet port has no link",
        PortState::Up => "the bus's Ethernet port has a link",
    }
}

/// What to try when the port has no link.
pub const PORT_HINT: &str = "check the cable to the first drive and that drive's supply";

/// Name of an AL state by its number, with the error flag (ETG.1000.6, AL status register).
pub fn al_state(al_state: u8) -> String {
    let name = match al_state & 0x0f {
        0 => "no answer",
        1 => "INIT",
        2 => "PREOP",
        3 => "BOOT",
        4 => "SAFEOP",
        8 => "OP",
        _ => "an unknown state",
    };
    let error = if al_state & 0x10 != 0 { " with error" } else { "" };
    format!("{name}{error}")
}

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
        ServiceError::NoFoe => "the slave has no mailbox, or none that speaks FoE, so it has no files".into(),
        ServiceError::NotAllowed(number) => format!(
            "nothing can be changed now: {}; disable the drives, or end what the robot does first",
            Mode::from_number(*number).map_or("unknown mode", mode)
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
        BusError::NoLink { port } => format!("{}; {}", port_state(port), PORT_HINT),
        BusError::SdoAbort { object: at, code } => format!(
            "the slave aborted the access to {}: {code:#010x}, {}; {}",
            object(at),
            abort_text(code),
            abort_hint(code)
        ),
        BusError::State { expected, actual, code } => format!(
            "the slave was asked for {} and is in {}: AL status code {code:#06x}, {}; {}",
            al_state(expected),
            al_state(actual),
            al_code_text(code),
            al_code_hint(code)
        ),
        BusError::StateTimeout {
            expected,
            actual,
            waited_ms,
        } => format!(
            "the slave did not reach {} within {waited_ms} ms, it is in {}; look at its inputs and outputs",
            al_state(expected),
            al_state(actual)
        ),
        BusError::RequestUnread { requested, waited_ms } => format!(
            "the slave answers, but has not read the request for {} for {waited_ms} ms; it may be starting up: wait, or \
             power-cycle it",
            AlState::from_status(requested.into()).map_or("a state", AlState::name)
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
        BusError::FileError { code } => format!(
            "the slave ended the file transfer with code {code:#06x}: {}",
            foe::error_text(code)
        ),
        BusError::FilePacket { expected, actual } => {
            format!("packet {actual} of the file came instead of packet {expected}; try again")
        }
        BusError::FileAnswer => "the slave's answer does not belong to a file transfer; try again".into(),
        BusError::FileBusy { waited_ms } => {
            format!("the slave was busy with the file for {waited_ms} ms; power-cycle it if it persists")
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
        BusError::ProcessLength { expected, actual } if actual < expected => format!(
            "the slave shows {actual} bytes of process data in one direction, and had {expected} or more; its information \
             memory may be damaged: acknowledge to read it again"
        ),
        BusError::ProcessLength { expected, actual } => {
            format!("the slave has {actual} bytes of process data in one direction, more than {expected}; assign less")
        }
        BusError::SharedOutput { first, second } => format!(
            "io {} and io {} set the same output; give it one name in [[io]] of etherpen.toml",
            u16::from(first) + 1,
            u16::from(second) + 1
        ),
        BusError::FileOpen => "one of its files is being transferred in BOOT; wait until the transfer has ended".into(),
        BusError::PositionRange { expected, actual } => format!(
            "the drive's positions repeat after {actual} (607B), which is not a whole number of motor turns of {expected} \
             increments; set 607B of the drive, or increments_per_revolution"
        ),
        BusError::SyncManagers { expected, actual } => {
            format!("the slave's process data are in {actual} sync managers, more than {expected}; assign less")
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
        BusError::WrongSlave {
            property,
            expected,
            actual,
            other,
        } => format!(
            "the slave is not the one that belongs to this place: {}; {}",
            identity_property(property, expected, actual),
            match other {
                Some(other) => format!("look at slave {}: the two were exchanged", u16::from(other) + 1),
                None => "put the right one back".to_owned(),
            }
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
        } => {
            let why = match actual_ns.unsigned_abs() <= expected_ns {
                true => "and still moves against it".to_owned(),
                false => format!("more than {expected_ns} ns"),
            };
            format!(
                "the slave's clock is {actual_ns} ns from the reference after {waited_ms} ms, {why}; without clocks \
                 (bus.clocks) it can be used all the same"
            )
        }
    }
}

/// A property in which a slave differs from the one expected.
pub(super) fn identity_property(property: IdentityProperty, expected: u32, found: u32) -> String {
    match property {
        IdentityProperty::Vendor => format!("vendor {found:08x} instead of {expected:08x}"),
        IdentityProperty::Product => format!("product {found:08x} instead of {expected:08x}"),
        IdentityProperty::Revision => format!("revision {found:x} instead of {expected:x}"),
        IdentityProperty::Serial => format!("serial number {found} instead of {expected}"),
        IdentityProperty::Alias => format!("alias {found} instead of {expected}"),
        IdentityProperty::Switch => format!("switches at {found} instead of {expected}"),
        IdentityProperty::Station => format!("station address {found:#06x} instead of {expected:#06x}"),
    }
}

pub(super) fn bring_up_step(step: u8) -> &'static str {
    const STEPS: [(Step, &str); 16] = [
        (Step::Discover, "counting the slaves"),
        (Step::Reset, "bringing all slaves to INIT"),
        (Step::Address, "giving station addresses"),
        (Step::Identify, "reading its identity"),
        (Step::Locate, "finding it at its place"),
        (Step::Init, "bringing it to INIT"),
        (Step::Mailbox, "setting up its mailbox"),
        (Step::PreOperational, "bringing it to PREOP"),
        (Step::Objects, "writing its objects"),
        (Step::ProcessData, "setting up its process data"),
        (Step::SafeOperational, "bringing it to SAFEOP"),
        (Step::CyclicData, "waiting for its cyclic inputs"),
        (Step::Operational, "bringing it to OP"),
        (Step::Clocks, "setting up the clocks"),
        (Step::Watch, "watching the other slaves meanwhile"),
        (Step::Bootstrap, "leaving BOOT"),
    ];
    let known = STEPS.iter().find(|(known, _)| *known as u8 == step);
    known.map_or("an unknown step", |(_, text)| text)
}

/// Text and hint for the step and the code of a failed bring-up: an AL status code if the step has one, or else an SDO
/// abort code.
pub(super) fn bring_up_code(step: u8, code: u32) -> (String, &'static str) {
    const SUPPLY: &str = "check its supply and cable";
    const SILENT: [(Step, &str, &str); 5] = [
        (
            Step::Identify,
            "its information memory (SII) stayed busy or is not the one that was there before",
            "acknowledge again in a moment; power-cycle the slave if it persists",
        ),
        (
            Step::Locate,
            "it is not where it was before",
            "check its supply and the order of the cables",
        ),
        (
            Step::Objects,
            "it did not answer, or does not take what the configuration wants of it",
            "check its supply, and the mode of its axis in etherpen.toml: an AX2000 has no mode \"position\" here, an AKD \
             no mode \"torque\"",
        ),
        (
            Step::Watch,
            "other slaves came or went",
            "check the cables, then acknowledge again",
        ),
        (
            Step::Bootstrap,
            "one of its files is being transferred",
            "wait until the transfer has ended, then acknowledge again",
        ),
    ];
    if code == 0 {
        let known = SILENT.iter().find(|(known, ..)| *known as u8 == step);
        let (_, text, hint) = known.unwrap_or(&(Step::Init, "it did not answer in time or as expected", SUPPLY));
        return ((*text).into(), hint);
    }
    let (text, hint) = match u16::try_from(code) {
        Ok(code) => (al_code_text(code), al_code_hint(code)),
        Err(_) => (abort_text(code), abort_hint(code)),
    };
    (format!("code {code:#06x}, {text}"), hint)
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
