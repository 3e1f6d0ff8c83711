//! What a person reads about modes, faults and refusals, and what to try.
//!
//! Axes and slaves are counted from 1 here, as they are labelled on the machine; the protocol counts from 0.

use etherpen::application::{Fault, Mode, Refusal, StopSource};
use etherpen::config::ConfigError;
use etherpen::link::protocol::{Command, ConfigRefusal};

/// An operating mode in a few words.
pub fn mode(mode: Mode) -> &'static str {
    match mode {
        Mode::Startup => "waiting for a configuration",
        Mode::BusConfiguring => "bringing up the bus",
        Mode::DrivesOff => "ready, the drives are without power",
        Mode::Unreferenced => "the drives hold, the joint angles are not referenced",
        Mode::Idle => "enabled and at rest",
        Mode::Moving => "moving",
        Mode::Drawing => "drawing",
        Mode::Holding => "the drawing is held",
        Mode::Stopping => "coming to a standstill",
        Mode::Fault => "stopped by a fault",
    }
}

/// A command as a noun.
pub fn command(command: &Command) -> &'static str {
    match command {
        Command::Reference => "taking the reference",
        Command::Enable => "enabling the drives",
        Command::Disable => "disabling the drives",
        Command::Jog { .. } => "jogging",
        Command::Move { .. } => "moving",
        Command::Draw { .. } => "starting a drawing",
        Command::Hold => "holding",
        Command::Resume => "resuming",
        Command::Cancel => "cancelling",
        Command::Override { .. } => "the speed override",
        Command::Pen { .. } => "moving the pen",
        Command::Stop => "stopping",
        Command::Acknowledge => "acknowledging the fault",
    }
}

/// Why a command was refused and what to try.
pub fn refusal(refusal: &Refusal) -> String {
    match refusal {
        Refusal::NotInMode(now) => format!("not possible now: {}; wait, or end what it does first", mode(*now)),
        Refusal::NotConfigured => "there is no configuration yet; connect with one (etherpen.toml)".into(),
        Refusal::NotReferenced => "the joint angles are not referenced; take the reference first".into(),
        Refusal::Target(target) => vertex(target),
        Refusal::OverrideRange(percent) => format!("an override of {percent} % is outside 10 to 200 %"),
        Refusal::CauseRemains(cause) => format!("its cause is still there: {}", fault(cause)),
        Refusal::Moving => "the robot is still moving or changing its power; try again when it stands".into(),
        Refusal::NotFinite => "a value is not a finite number; check the input".into(),
    }
}

/// Why a vertex was refused and what to try.
pub fn vertex(refusal: &etherpen::motion::Refusal) -> String {
    format!(
        "vertex {} of the path was refused ({}); move or scale the drawing so that it lies within the work area",
        refusal.index,
        words(&format!("{:?}", refusal.reason))
    )
}

/// Spells a variant's name and its values as words.
fn words(debug: &str) -> String {
    let mut text = String::new();
    for letter in debug.chars().filter(|letter| !matches!(letter, '{' | '}' | '(' | ')')) {
        if letter.is_uppercase() && !text.is_empty() && !text.ends_with(' ') {
            text.push(' ');
        }
        text.extend(letter.to_lowercase());
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Why a configuration was not taken and what to try.
pub fn config_refusal(refusal: &ConfigRefusal) -> String {
    match refusal {
        ConfigRefusal::Bounds(error) => config_error(error),
        ConfigRefusal::NotInMode(now) => format!(
            "another configuration cannot be taken now: {}; disable the drives first",
            mode(*now)
        ),
    }
}

/// Which value of the configuration was refused.
pub fn config_error(error: &ConfigError) -> String {
    let axis = error
        .field
        .axis
        .map_or(String::new(), |axis| format!(" of axis {}", one(axis)));
    format!(
        "{}{axis} is {}, allowed is {} to {}; correct it in etherpen.toml",
        error.field.name(),
        error.value,
        error.low,
        error.high
    )
}

/// The cause of a fault and what to try.
pub fn fault(fault: &Fault) -> String {
    match *fault {
        Fault::EmergencyStop(StopSource::Link) => "stop by command; look at the robot, then acknowledge".into(),
        Fault::EmergencyStop(StopSource::Input) => {
            "emergency stop by the board's input; release the button, then acknowledge".into()
        }
        Fault::Blind { blind_ms, limit_ms } => format!(
            "no valid positions for {blind_ms} ms (limit {limit_ms} ms); check the bus cable and the drives' supply"
        ),
        Fault::SlaveLost { slave } => format!(
            "slave {} stopped answering; check its supply and the cable before it, then acknowledge",
            one(slave)
        ),
        Fault::SlaveState {
            slave,
            al_state: state,
            al_code,
        } => format!(
            "slave {} went to {}, AL code {al_code:#06x} ({}); {}",
            one(slave),
            al_state(state),
            al_status(al_code).0,
            al_status(al_code).1
        ),
        Fault::Drive { axis, status_word } => format!(
            "the drive of axis {} reports a fault (status word {status_word:#06x}); read its display, remove the cause, \
             then acknowledge",
            one(axis)
        ),
        Fault::FollowingError {
            axis,
            error_rad,
            limit_rad,
        } => format!(
            "axis {} was {error_rad:.4} rad from its reference (limit {limit_rad:.4} rad); look for a collision, a closed \
             brake or gains that are too low",
            one(axis)
        ),
        Fault::OutputLimit {
            axis,
            output_rad_s,
            limit_rad_s,
        } => format!(
            "the controller of axis {} asked for {output_rad_s:.2} rad/s (limit {limit_rad_s:.2} rad/s); check gear, \
             scaling and gains",
            one(axis)
        ),
        Fault::ReferenceLost { axis } => format!(
            "positions of axis {} were missing for so long that its motor's turn is no longer known; acknowledge, bring \
             the arms to the marks and take the reference again",
            one(axis)
        ),
        Fault::CyclesLate { late, limit } => {
            format!("{late} late cycles within a second (limit {limit}); the board is overloaded or its clock is wrong")
        }
        Fault::ReferenceUnderrun => {
            "the controller ran out of references; this is an error of the firmware, please report it".into()
        }
        Fault::EnableTimeout { waited_ms } => format!(
            "the drives were not enabled within {waited_ms} ms; check their power stage's supply and the enable input"
        ),
        Fault::BusConfiguration { slave, step, code } => format!(
            "slave {} could not be brought up (step {step}, code {code:#06x}: {}); check that it is the expected drive \
             and read its display",
            one(slave),
            bring_up_code(code)
        ),
        Fault::UnexpectedBus { found, expected } => format!(
            "{found} drives are on the bus, {expected} are expected; check supply, cables and their order (etherpen bus \
             scan)"
        ),
    }
}

fn one(index: u8) -> u16 {
    u16::from(index) + 1
}

/// AL state by its number, with the error flag (ETG.1000.6, AL status register).
pub fn al_state(al_state: u8) -> String {
    let name = match al_state & 0x0f {
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

fn bring_up_code(code: u32) -> &'static str {
    match code {
        0x0503_0000 => "SDO toggle bit not alternated",
        0x0504_0000 => "SDO timed out",
        0x0601_0000 => "object access not supported",
        0x0601_0002 => "object is read only",
        0x0602_0000 => "object does not exist",
        0x0604_0041 => "object cannot be mapped",
        0x0607_0010 => "data type or length does not match",
        0x0609_0011 => "subindex does not exist",
        0x0609_0030 => "value out of range",
        0x0800_0022 => "not possible in the present state",
        _ => u16::try_from(code).map_or("no text for this code", |code| al_status(code).0),
    }
}

/// AL status code as text and what to try (ETG.1000.6, table of AL status codes).
pub fn al_status(code: u16) -> (&'static str, &'static str) {
    match code {
        0x0000 => ("no error", "check the cable before the slave and its supply"),
        0x0001 => ("unspecified error", "read the drive's display"),
        0x0002 => ("no memory", "switch the drive off and on"),
        0x0011 => (
            "invalid requested state change",
            "acknowledge; the supervisor starts from INIT",
        ),
        0x0012 => ("unknown requested state", "check that it is the expected drive"),
        0x0013 => ("bootstrap not supported", "check that it is the expected drive"),
        0x0014 => ("no valid firmware", "restore the drive's firmware"),
        0x0016 => (
            "invalid mailbox configuration",
            "check that it is the expected drive and revision",
        ),
        0x0017 => (
            "invalid sync manager configuration",
            "check that it is the expected drive and revision",
        ),
        0x0018 => ("no valid inputs available", "check the drive's feedback"),
        0x0019 => ("no valid outputs", "check that cyclic data are running"),
        0x001a => ("synchronisation error", "check cycle time and clock settings"),
        0x001b => (
            "sync manager watchdog: outputs came too late",
            "look for late cycles, lost frames or a pulled cable, then acknowledge",
        ),
        0x001d => ("invalid output configuration", "check the process data of the drive"),
        0x001e => ("invalid input configuration", "check the process data of the drive"),
        0x001f => (
            "invalid watchdog configuration",
            "check bus.watchdog_ms in etherpen.toml",
        ),
        0x0020 => ("slave needs a cold start", "switch the drive off and on"),
        0x0021 => ("slave needs INIT", "acknowledge; the supervisor starts from INIT"),
        0x0022 => ("slave needs PREOP", "acknowledge; the supervisor starts from INIT"),
        0x0023 => ("slave needs SAFEOP", "acknowledge; the supervisor starts from INIT"),
        0x002c => ("fatal synchronisation error", "check cycle time and clock settings"),
        0x002d => ("no synchronisation error", "check cycle time and clock settings"),
        0x0030 => ("invalid distributed-clock configuration", "check clock settings"),
        0x0032 => ("distributed clock lost its lock", "check cycle time and clock settings"),
        0x0042 => (
            "mailbox error of CoE",
            "check that it is the expected drive and revision",
        ),
        0x0050 => ("EEPROM could not be accessed", "switch the drive off and on"),
        0x0051 => ("EEPROM error", "restore the drive's EEPROM"),
        _ => ("no text for this code", "look it up in the drive's manual"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::config::Config;
    use etherpen::motion::RefusalReason;

    #[test]
    fn axes_and_slaves_are_counted_from_one() {
        let drive = Fault::Drive {
            axis: 0,
            status_word: 0x1208,
        };
        assert!(fault(&drive).contains("axis 1 ") && fault(&drive).contains("0x1208"));
        let state = Fault::SlaveState {
            slave: 3,
            al_state: 0x14,
            al_code: 0x1b,
        };
        let text = fault(&state);
        assert!(
            text.contains("slave 4 went to SAFEOP with error") && text.contains("watchdog"),
            "{text}"
        );
    }

    #[test]
    fn a_refused_value_is_named_with_its_axis_and_bounds() {
        let mut config = Config::default();
        config.axes[1].gear = 0.0;
        let text = config_error(&config.check().unwrap_err());
        assert_eq!(
            text,
            "axes.gear of axis 2 is 0, allowed is 0.1 to 1000; correct it in etherpen.toml"
        );
    }

    #[test]
    fn a_refused_vertex_is_told_in_words() {
        let text = vertex(&etherpen::motion::Refusal {
            index: 17,
            reason: RefusalReason::NotFinite,
        });
        assert!(
            text.starts_with("vertex 17 of the path was refused (not finite); "),
            "{text}"
        );
        assert_eq!(
            words("Joint { axis: 2, angle_rad: 1.5 }"),
            "joint axis: 2, angle_rad: 1.5"
        );
    }
}
