//! Texts about modes, faults and refusals, with what to try.
//!
//! Axes and slaves are counted from 1 here, as on the machine's labels; the protocol counts from 0.

use etherpen::application::{Fault, Mode, Refusal, StopSource};
use etherpen::board::{PortState, PreviousRun, RunEnd};
use etherpen::config::ConfigError;
use etherpen::ethercat::coe::{abort_hint, abort_text};
use etherpen::ethercat::event::Step;
use etherpen::ethercat::state::{al_code_hint, al_code_text};
use etherpen::messages::{Command, ConfigRefusal, Status};
use etherpen::motion::{Outside, RefusalReason};
use etherpen::robots::{KinematicsError, Words};

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

/// The state of the firmware in a few words: its mode, and whether it is recovering from a fault.
pub fn doing(status: &Status) -> &'static str {
    match status.recovering {
        true => "the fault was acknowledged: bringing back the bus and the drives",
        false => mode(status.mode),
    }
}

/// A command as a noun.
pub fn command(command: &Command) -> &'static str {
    match command {
        Command::Home | Command::HomeAt { .. } => "taking the reference",
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
        Refusal::Moving => {
            "the robot is still moving, changing its power or taking its reference; try again when it stands".into()
        }
        Refusal::Busy => "too many commands at once; wait a moment".into(),
        Refusal::Recovering => {
            "the fault was acknowledged already, and the bus and the drives are being brought back; wait".into()
        }
        Refusal::NotFinite => "a value is not a finite number; check the input".into(),
        Refusal::NoPosition { axis } => format!("no position of axis {} arrives; look at its drive", axis + 1),
        Refusal::PoseResolver { axis, difference_rad } => format!(
            "axis {}: the resolver shows an angle {:.2} degrees away from the pose; measure the pose again, or correct the \
             axis' synchronisation values",
            axis + 1,
            difference_rad.to_degrees()
        ),
        Refusal::PosePosition {
            axis,
            difference_rad,
            distance_mm,
        } => format!(
            "axis {}: the pose is {:.1} degrees away from what the measured position asks for, forward kinematics {distance_mm:.0} mm; \
             a multiple of 30 degrees is a wrong motor turn",
            axis + 1,
            difference_rad.to_degrees()
        ),
    }
}

/// Why a vertex was refused and what to try; vertices are counted from 0, as in the path's file.
pub fn vertex(refusal: &etherpen::motion::Refusal) -> String {
    let (why, hint) = match refusal.reason {
        RefusalReason::NotFinite => ("a coordinate is not a finite number".into(), "check the input file"),
        RefusalReason::Repeated { distance_mm } => (
            format!("it lies only {distance_mm:.4} mm from the one before"),
            "remove repeated points from the path",
        ),
        RefusalReason::Outside(why) => (outside(&why), MOVE_OR_SCALE),
        RefusalReason::Leg { at, outside: why } => (
            format!(
                "the straight line to it leaves the work area at x {:.1}, y {:.1}, z {:.1} mm: {}",
                at.x_mm,
                at.y_mm,
                at.z_mm,
                outside(&why)
            ),
            MOVE_OR_SCALE,
        ),
        RefusalReason::Wound {
            angle_rad,
            low_rad,
            high_rad,
        } => (
            format!(
                "the path has wound axis 4 up: it would turn to {angle_rad:.1} rad (allowed {low_rad:.1} to {high_rad:.1} rad)"
            ),
            "draw it in parts and take the reference before each, or set motion.orientation = \"constant\"",
        ),
    };
    format!("vertex {} of the path was refused: {why}; {hint}", refusal.index)
}

const MOVE_OR_SCALE: &str = "move or scale the drawing so that it lies within the work area";

/// Why a position is outside the work area.
pub fn outside(outside: &Outside) -> String {
    let words = Words::default();
    let noun = words.joint;
    match *outside {
        Outside::Radius { radius_mm, limit_mm } => {
            format!("it is {radius_mm:.1} mm from the robot's axis (limit {limit_mm:.1} mm)")
        }
        Outside::Height { z_mm, low_mm, high_mm } => {
            format!("its height is {z_mm:.1} mm (allowed {low_mm:.1} to {high_mm:.1} mm)")
        }
        Outside::Kinematics(KinematicsError::Apart) => format!("the {} do not meet there", words.last_links),
        Outside::Kinematics(KinematicsError::NotFinite) => "a coordinate is not a finite number".into(),
        Outside::Kinematics(KinematicsError::Unreachable { joint, .. }) => {
            format!("{noun} {} does not reach it", one(joint))
        }
        Outside::Kinematics(KinematicsError::Singular { joint, .. }) | Outside::Stretched { joint, .. } => {
            format!("{noun} {} would be stretched out", one(joint))
        }
        Outside::Kinematics(KinematicsError::Range {
            joint,
            angle_rad,
            low_rad,
            high_rad,
        })
        | Outside::Margin {
            joint,
            angle_rad,
            low_rad,
            high_rad,
        } => format!(
            "{noun} {} would stand at {angle_rad:.3} rad (allowed {low_rad:.3} to {high_rad:.3} rad)",
            one(joint)
        ),
        Outside::Flat { .. } => format!("the {} would lie in a plane", words.last_links),
        Outside::Paper { z_mm, low_mm } => {
            format!("at {z_mm:.1} mm the pen would press too deep into the paper (allowed down to {low_mm:.1} mm)")
        }
    }
}

/// Why a configuration was refused and what to try.
pub fn config_refusal(refusal: &ConfigRefusal) -> String {
    match refusal {
        ConfigRefusal::Bounds(error) => config_error(error),
        ConfigRefusal::Geometry(cause) => {
            format!(
                "the configured dimensions do not form a valid robot ({cause}); correct [geometry] in etherpen.toml"
            )
        }
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
    let why = match error.field.name() {
        "axes.quick_stop_rad_s2" => "the axis has to stand before its brake closes, from the fastest it may turn; ",
        _ => "",
    };
    format!(
        "{}{axis} is {}, allowed is {} to {}; {why}correct it in etherpen.toml",
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
            "{} went to {}, AL code {al_code:#06x} ({}); {}",
            which_slave(slave),
            al_state(state),
            al_code_text(al_code),
            al_code_hint(al_code)
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
             the robot to the marks and take the reference again",
            one(axis)
        ),
        Fault::CyclesLate { late, limit } => {
            format!("{late} late cycles within a second (limit {limit}); the board is overloaded or its clock is wrong")
        }
        Fault::SetpointUnderrun => {
            "the controller ran out of references; this is an error of the firmware, please report it".into()
        }
        Fault::EnableTimeout { waited_ms } => format!(
            "the drives were not enabled within {waited_ms} ms; check their power stage's supply and the enable input"
        ),
        Fault::BusConfiguration { slave, step, code } => {
            let (text, hint) = bring_up_code(step, code);
            format!("slave {} failed at {}: {text}; {hint}", one(slave), bring_up_step(step))
        }
        Fault::ClockLost {
            missing_cycles,
            limit_cycles,
        } => format!(
            "the bus clock did not come for {missing_cycles} cycles (limit {limit_cycles}); look whether the first slave \
             with a clock still answers (etherpen bus scan)"
        ),
        Fault::ClockJump { error_ns, limit_ns } => format!(
            "the sample was {:.1} us off the bus clock (limit {:.1} us); look for a slave that was restarted, or for an \
             Ethernet connection that delays frames",
            f64::from(error_ns) / 1e3,
            f64::from(limit_ns) / 1e3
        ),
        Fault::NoLink { port } => format!("{}; {PORT_HINT}, then acknowledge", port_state(port)),
        Fault::ClockFailure => {
            "the board's 8 MHz from its ST-LINK fail and it runs on a clock that is not exact enough to \
                                move anything; check the board's USB supply, then reset the board"
                .into()
        }
        Fault::OtherProduct { slave, expected, found } if expected == found => format!(
            "slave {} has the product code of before ({found:#010x}) and otherwise tells another identity: it is of another \
             vendor or its information memory is damaged; put the right one back, then acknowledge",
            one(slave)
        ),
        Fault::OtherProduct { slave, expected, found } => format!(
            "slave {} is another product than before (product code {found:#010x}, expected {expected:#010x}); put the right \
             one back, then acknowledge",
            one(slave)
        ),
        Fault::RepairTimeout { waited_ms } => format!(
            "the bus was not brought back within {waited_ms} ms, and why is not known yet; look at the slaves (etherpen bus \
             scan), then acknowledge again"
        ),
        Fault::MotionStalled { vertex, waited_ms } => format!(
            "the planner made no progress for {waited_ms} ms after vertex {vertex} of the path; this is an error of the \
             firmware, please report it with the drawing; acknowledge to go on"
        ),
        Fault::FeedbackDeviation {
            axis,
            deviation_rad,
            limit_rad,
        } => format!(
            "axis {} measured another motion than was commanded, by {deviation_rad:.4} rad (limit {limit_rad:.4} rad): its \
             resolver is frozen, slips, is reversed or is another axis's, or the drive does not follow; check resolver, \
             coupling and cables, then acknowledge and take the reference again",
            one(axis)
        ),
        Fault::FeedbackNoise {
            axis,
            acceleration_rad_s2,
            limit_rad_s2,
        } => format!(
            "the measured position of axis {} jumps about: {acceleration_rad_s2:.0} rad/s2 on average (limit \
             {limit_rad_s2:.0} rad/s2); check the resolver's cable and its shield, then acknowledge and take the \
             reference again",
            one(axis)
        ),
        Fault::ProcessorStopped { slave, expiries } => format!(
            "the processor of slave {} stood still ({expiries} times since it was brought up) while its controller went \
             on answering; check its supply and its firmware, then acknowledge",
            one(slave)
        ),
        Fault::UnexpectedBus { found, expected } => format!(
            "{found} drives are on the bus, {expected} are expected; check supply, cables and their order (etherpen bus \
             scan)"
        ),
    }
}

/// The bus's Ethernet port in a few words.
pub fn port_state(port: PortState) -> &'static str {
    match port {
        PortState::Unknown => "nothing is known of the bus' Ethernet port",
        PortState::NoPhy => "no PHY answers at the bus' Ethernet port",
        PortState::Down => "the bus' Ethernet port has no link",
        PortState::Up => "the bus' Ethernet port has a link",
    }
}

/// What to try when the port has no link.
pub const PORT_HINT: &str = "check the cable to the first drive and that drive's supply";

/// How the previous run ended, if that is worth reporting.
pub fn previous_run(previous: &PreviousRun) -> Option<String> {
    let end = match &previous.end {
        RunEnd::PowerOff | RunEnd::Reset if previous.fault.is_none() => return None,
        RunEnd::PowerOff => "the firmware was switched off".into(),
        RunEnd::Reset => "the firmware was reset".into(),
        RunEnd::Watchdog => "the watchdog ended the firmware's last run: a task that has to run did not".into(),
        RunEnd::Panic(cause) => format!("the firmware's last run ended by itself: {cause}; please report it"),
    };
    Some(match &previous.fault {
        Some(last) => format!("{end}; its last fault was: {}", fault(last)),
        None => end,
    })
}

/// A slave by its place in the chain; the critical tasks detect that a slave has left OP before it is known which one.
fn which_slave(slave: u8) -> String {
    if slave == u8::MAX {
        "a slave".to_owned()
    } else {
        format!("slave {}", one(slave))
    }
}

fn one(index: u8) -> u16 {
    u16::from(index) + 1
}

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

fn bring_up_step(step: u8) -> &'static str {
    const STEPS: [(Step, &str); 15] = [
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
    ];
    let known = STEPS.iter().find(|(known, _)| *known as u8 == step);
    known.map_or("an unknown step", |(_, text)| text)
}

/// Text and hint for the step and the code of a failed bring-up: an AL status code where the step has one, else an SDO
/// abort code.
fn bring_up_code(step: u8, code: u32) -> (String, &'static str) {
    const SUPPLY: &str = "check its supply and cable";
    const SILENT: [(Step, &str, &str); 3] = [
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
            Step::Watch,
            "other slaves came or went",
            "check the cables, then acknowledge again",
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
    use etherpen::config::Config;
    use etherpen::robots::Position;

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
    fn a_quick_stop_that_is_too_weak_is_refused_with_the_value_it_needs() {
        let mut config = Config::default();
        config.axes[2].quick_stop_rad_s2 = 1.0;
        let text = config_error(&config.check().unwrap_err());
        assert!(
            text.starts_with("axes.quick_stop_rad_s2 of axis 3 is 1, allowed is 28.43 to 2000; the axis has to stand"),
            "{text}"
        );
    }

    #[test]
    fn an_earlier_end_is_told_only_when_there_is_something_to_tell() {
        assert_eq!(previous_run(&PreviousRun::default()), None);
        let previous = PreviousRun {
            end: PreviousRun::panicked("src/a.rs:7: no"),
            fault: Some(Fault::ReferenceLost { axis: 2 }),
        };
        let text = previous_run(&previous).unwrap();
        assert!(text.contains("src/a.rs:7: no") && text.contains("axis 3"), "{text}");
        let reset = PreviousRun {
            end: RunEnd::Watchdog,
            fault: None,
        };
        assert!(previous_run(&reset).unwrap().contains("watchdog"));
    }

    #[test]
    fn a_refused_vertex_is_told_with_its_place_and_the_limit() {
        let radius = Outside::Radius {
            radius_mm: 571.25,
            limit_mm: 565.0,
        };
        let reason = RefusalReason::Leg {
            at: Position::default(),
            outside: radius,
        };
        let text = vertex(&etherpen::motion::Refusal { index: 17, reason });
        assert!(
            text.starts_with("vertex 17 of the path was refused: the straight line"),
            "{text}"
        );
        assert!(text.contains("(limit 565.0 mm); move or scale"), "{text}");
        let margin = Outside::Margin {
            joint: 0,
            angle_rad: -0.7,
            low_rad: -0.6,
            high_rad: 1.7,
        };
        assert!(outside(&margin).contains("arm 1 would stand at -0.700 rad"));
    }

    #[test]
    fn a_failed_bring_up_names_the_step_and_what_the_slave_said() {
        let failed = |step: Step, code| {
            fault(&Fault::BusConfiguration {
                slave: 1,
                step: step as u8,
                code,
            })
        };
        let objects = failed(Step::Objects, 0x0602_0000);
        assert!(
            objects.starts_with("slave 2 failed at writing its objects: code 0x6020000, object"),
            "{objects}"
        );
        assert!(failed(Step::SafeOperational, 0x1e).contains("SAFEOP: code 0x001e, input"));
        assert!(failed(Step::Init, 0).contains("did not answer"));
        assert!(failed(Step::Locate, 0).contains("not where it was"));
        assert!(failed(Step::Identify, 0).contains("SII"));
    }

    #[test]
    fn another_product_and_a_repair_that_takes_too_long_are_named() {
        let other = fault(&Fault::OtherProduct {
            slave: 1,
            expected: 0x07D0_6014,
            found: 0x044C_2C52,
        });
        assert!(
            other.contains("slave 2 ") && other.contains("0x044c2c52, expected 0x07d06014"),
            "{other}"
        );
        let damaged = fault(&Fault::OtherProduct {
            slave: 1,
            expected: 0x07D0_6014,
            found: 0x07D0_6014,
        });
        assert!(damaged.contains("slave 2 ") && damaged.contains("vendor"), "{damaged}");
        let late = fault(&Fault::RepairTimeout { waited_ms: 10_000 });
        assert!(
            late.contains("10000 ms") && late.contains("acknowledge again"),
            "{late}"
        );
        assert!(refusal(&Refusal::Recovering).contains("acknowledged already"));
    }
}
