//! Texts about faults: the cause, and what to try.

use super::bus::{PORT_HINT, al_state, bring_up_code, bring_up_step, identity_property, port_state};
use super::one;
use crate::axes::{self, Motion, Quantity};
use etherpen::application::{Fault, InputCause, PathStopFailure, StopSource};
use etherpen::config::IoRole;
use etherpen::control::search::SearchFailure;
use etherpen::ethercat::error::IdentityProperty;
use etherpen::ethercat::state::{al_code_hint, al_code_text};

/// The cause of a fault and what to try.
pub fn fault(fault: &Fault) -> String {
    match *fault {
        Fault::EmergencyStop(StopSource::Link) => "stop by command; check the robot, then acknowledge".into(),
        Fault::EmergencyStop(StopSource::Input) => {
            "emergency stop by the board's input; release the button, then acknowledge".into()
        }
        Fault::Blind { blind_ms, limit_ms } => format!(
            "no valid positions for {blind_ms} ms (limit {limit_ms} ms); check the bus cable and the drives' supply"
        ),
        Fault::OutputsLost {
            axis,
            lost_ms,
            limit_ms,
        } => format!(
            "{} confirmed no commands for {lost_ms} ms (limit {limit_ms} ms); check the bus cables and look for damaged \
             frames (etherpen bus errors), then acknowledge",
            match axis {
                Some(axis) => format!("the drive of axis {}", one(axis)),
                None => "the drives".to_owned(),
            }
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
            "axis {} was {} from its setpoint (limit {}); look for a collision, a closed brake or gains that are too low",
            one(axis),
            told(axis, Quantity::Position, error_rad),
            told(axis, Quantity::Position, limit_rad)
        ),
        Fault::OutputLimit {
            axis,
            output_rad_s,
            limit_rad_s,
        } => format!(
            "the controller of axis {} asked for {} (limit {}); check gear, scaling and gains",
            one(axis),
            told(axis, Quantity::Speed, output_rad_s),
            told(axis, Quantity::Speed, limit_rad_s)
        ),
        Fault::ReferenceLost { axis } => format!(
            "positions of axis {} were missing for so long that its motor's turn is unknown; acknowledge, move \
             the robot to its marks and home it again",
            one(axis)
        ),
        Fault::CyclesLate { late, limit } => {
            format!("{late} late cycles within a second (limit {limit}); the board is overloaded or its clock is wrong")
        }
        Fault::SetpointUnderrun => {
            "the controller ran out of setpoints; this is a firmware error, please report it".into()
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
            "the bus clock was missing for {missing_cycles} cycles (limit {limit_cycles}); check whether the first slave \
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
            "the board's 8 MHz from its ST-LINK failed, and its own clock is too inaccurate to move \
                                anything; check the board's USB supply, then reset the board"
                .into()
        }
        Fault::OtherProduct { slave, expected, found } if expected == found => format!(
            "slave {} has the same product code ({found:#010x}) but otherwise another identity: it is from another vendor, \
             or its information memory is damaged, or was damaged as the board first read it; put the right one back, then \
             acknowledge; if this one is to stay, reset the board",
            one(slave)
        ),
        Fault::OtherProduct { slave, expected, found } => format!(
            "slave {} is a different product (product code {found:#010x}, expected {expected:#010x}); put the right \
             one back, then acknowledge; if this one is to stay, reset the board",
            one(slave)
        ),
        Fault::WrongSlave {
            slave,
            property,
            expected,
            found,
            other,
        } => {
            let difference = match property {
                IdentityProperty::Station => String::new(),
                property => format!(": {}", identity_property(property, expected, found)),
            };
            let back = |other| {
                let other = one(other);
                format!("it was exchanged with slave {other}: put the cables or the devices of both places back")
            };
            let hint = match other {
                // Nothing but the order at the start, or what was read then, may tell them apart.
                Some(other) if property == IdentityProperty::Station => {
                    format!("{}, or reset the board if they are to stay", back(other))
                }
                Some(other) if property == IdentityProperty::Serial => format!(
                    "{}; or reset the board if they are to stay, and correct the serial of the axis in etherpen.toml if it \
                     names one",
                    back(other)
                ),
                Some(other) => back(other),
                None if property == IdentityProperty::Serial => {
                    "put the right one back and see to its supply, or reset the board if this one is to stay, with its serial at the axis in \
                     etherpen.toml if that names one (etherpen bus scan shows it)"
                        .to_owned()
                }
                None => "put the right one back, or correct alias, switch or serial of its axis in etherpen.toml \
                         (etherpen bus scan shows them)"
                    .to_owned(),
            };
            format!(
                "slave {} is not the one that belongs there{difference}; {hint}, then acknowledge",
                one(slave)
            )
        }
        Fault::RepairTimeout { waited_ms } => format!(
            "the bus did not recover within {waited_ms} ms, and the cause is not known yet; check the slaves (etherpen bus \
             scan), then acknowledge again"
        ),
        Fault::MotionStalled { vertex, waited_ms } => format!(
            "the planner made no progress for {waited_ms} ms after vertex {vertex} of the path; this is a firmware \
             error, please report it with the drawing; acknowledge to continue"
        ),
        Fault::FeedbackDeviation {
            axis,
            deviation_rad,
            limit_rad,
        } => format!(
            "axis {} measured a motion that differs from the commanded one by {} (limit {}): its \
             resolver is frozen, slips, is reversed or is another axis's, or the drive does not follow; check resolver, \
             coupling and cables, then acknowledge and home the robot again",
            one(axis),
            told(axis, Quantity::Position, deviation_rad),
            told(axis, Quantity::Position, limit_rad)
        ),
        Fault::FeedbackNoise {
            axis,
            acceleration_rad_s2,
            limit_rad_s2,
        } => format!(
            "the measured position of axis {} is erratic: {} on average (limit {}); check the resolver's cable and its \
             shield, then acknowledge and home the robot again",
            one(axis),
            told(axis, Quantity::Acceleration, acceleration_rad_s2),
            told(axis, Quantity::Acceleration, limit_rad_s2)
        ),
        Fault::ProcessorStopped { slave, expiries } => format!(
            "the processor of slave {} stopped ({expiries} times since the bring-up) while its controller kept \
             answering; check its supply and its firmware, then acknowledge",
            one(slave)
        ),
        Fault::StopInput { io, role, cause } => {
            let what = match role {
                IoRole::Door => "the door",
                IoRole::Limit => "the limit switch",
                IoRole::Pen => "the pen",
                IoRole::Tool => "the tool",
                _ => "the emergency stop",
            };
            match cause {
                InputCause::Open => format!("{what} is open (io {}); close it, then acknowledge", one(io)),
                InputCause::Missing if matches!(role, IoRole::Pen | IoRole::Tool) => format!(
                    "the terminal does not confirm the output of {what} (io {}); check its supply and cable, then acknowledge",
                    one(io)
                ),
                InputCause::Missing => format!(
                    "the input of {what} is missing (io {}); check its terminal's supply and cable, then acknowledge",
                    one(io)
                ),
            }
        }
        Fault::LimitSwitch { axis, io } => format!(
            "axis {} ran onto its limit switch (io {}), or its wire is broken; acknowledge, switch the drives on and jog the \
             axis off the switch",
            one(axis),
            one(io)
        ),
        Fault::HomingFailed { axis, failure } => {
            let (what, hint) = match failure {
                SearchFailure::NeverOpens => (
                    "did not reach its home switch on the longest way",
                    "check the switch, its direction and home.travel_max",
                ),
                SearchFailure::StaysOpen => (
                    "left its home switch, and the switch stayed open",
                    "check the switch and its wire",
                ),
                SearchFailure::Missing => (
                    "gets no input from its home switch, or no position",
                    "check the supply and cable of its terminal and its drive",
                ),
                SearchFailure::Differs => (
                    "found its home switch at two different places",
                    "check the switch, its wire and its fixing",
                ),
            };
            format!("axis {} {what}; {hint}, then acknowledge and home again", one(axis))
        }
        Fault::PathStopLeft(failure) => path_stop_left(&failure),
        Fault::SharedOutput { slave, first, second } => format!(
            "io {} and io {} set the same output of slave {}; give it one name in [[io]] of etherpen.toml",
            one(first),
            one(second),
            one(slave)
        ),
        Fault::UnexpectedBus { found, expected } => format!(
            "{found} drives are on the bus, {expected} were expected; check supply, cables and their order (etherpen bus \
             scan)"
        ),
    }
}

/// What went wrong in a stop on the path, and what to try.
fn path_stop_left(failure: &PathStopFailure) -> String {
    let (what, hint) = match *failure {
        PathStopFailure::Distance {
            axis,
            error_rad,
            limit_rad,
        } => (
            format!(
                "axis {} was {} off the path (limit {})",
                one(axis),
                told(axis, Quantity::Position, error_rad),
                told(axis, Quantity::Position, limit_rad)
            ),
            "look for a collision or a drive that does not follow",
        ),
        PathStopFailure::Speed {
            axis,
            measured_rad_s,
            planned_rad_s,
        } => (
            format!(
                "axis {} moved with {} instead of {}",
                one(axis),
                told(axis, Quantity::Speed, measured_rad_s),
                told(axis, Quantity::Speed, planned_rad_s)
            ),
            "check its drive, its resolver and axes.quick_stop_rad_s2",
        ),
        PathStopFailure::Time {
            axis,
            measured_rad_s,
            passed_ms,
        } => (
            format!(
                "after {passed_ms} ms axis {} still moved with {}",
                one(axis),
                told(axis, Quantity::Speed, measured_rad_s)
            ),
            "check its drive and its gains",
        ),
        PathStopFailure::Dry => (
            "the controller ran out of setpoints".to_owned(),
            "this is a firmware error, please report it",
        ),
    };
    format!("a stop left its path: {what}; the drives' quick stop followed; {hint}, then acknowledge")
}

/// A controller's value of an axis, from 0, in the axis's unit.
fn told(axis: u8, quantity: Quantity, value: impl Into<f64>) -> String {
    let motion = axes::motion(axes::machine(), axis.into());
    let decimals = match (quantity, motion) {
        (Quantity::Position, Motion::Rotary) => 4,
        (Quantity::Position, Motion::Linear) | (Quantity::Speed, Motion::Rotary) => 2,
        _ => 0,
    };
    format!(
        "{:.decimals$} {}",
        value.into() * motion.factor(),
        motion.unit(quantity)
    )
}

/// A slave by its place in the chain; the critical tasks detect that a slave has left OP before it is known which one.
fn which_slave(slave: u8) -> String {
    if slave == u8::MAX {
        "a slave".to_owned()
    } else {
        format!("slave {}", one(slave))
    }
}

#[cfg(test)]
mod tests {
    use super::super::refusal;
    use super::*;
    use etherpen::application::Refusal;
    use etherpen::ethercat::event::Step;

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
    fn two_slaves_that_were_exchanged_are_both_named() {
        let wrong = |property, other| {
            fault(&Fault::WrongSlave {
                slave: 1,
                property,
                expected: 7,
                found: 9,
                other,
            })
        };
        for (property, word) in [
            (IdentityProperty::Alias, "alias 9 instead of 7"),
            (IdentityProperty::Switch, "switches at 9 instead of 7"),
            (IdentityProperty::Serial, "serial number 9 instead of 7"),
            (IdentityProperty::Station, "is not the one"),
        ] {
            let text = wrong(property, Some(2));
            assert!(
                text.contains("slave 2 ") && text.contains("with slave 3:") && text.contains(word),
                "{text}"
            );
        }
        // A reset helps where nothing but the order at the start, or what was read then, tells them apart.
        let told = [
            IdentityProperty::Station,
            IdentityProperty::Serial,
            IdentityProperty::Alias,
        ];
        let helps = told.map(|property| wrong(property, Some(2)).contains("reset the board"));
        assert_eq!(helps, [true, true, false]);
        let unknown = wrong(IdentityProperty::Alias, None);
        assert!(
            unknown.contains("slave 2 ") && unknown.contains("etherpen.toml"),
            "{unknown}"
        );
    }

    #[test]
    fn a_stop_that_left_its_path_names_the_axis_and_the_part_of_the_envelope() {
        let told = |failure| fault(&Fault::PathStopLeft(failure));
        let distance = told(PathStopFailure::Distance {
            axis: 0,
            error_rad: 0.25,
            limit_rad: 0.05,
        });
        assert!(
            distance.contains("axis 1 was ") && distance.contains("(limit "),
            "{distance}"
        );
        let speed = told(PathStopFailure::Speed {
            axis: 2,
            measured_rad_s: 1.5,
            planned_rad_s: -0.5,
        });
        assert!(
            speed.contains("axis 3 moved with ") && speed.contains(" instead of -"),
            "{speed}"
        );
        let time = told(PathStopFailure::Time {
            axis: 3,
            measured_rad_s: 0.5,
            passed_ms: 21,
        });
        assert!(time.contains("after 21 ms axis 4 "), "{time}");
        let dry = told(PathStopFailure::Dry);
        assert!(dry.contains("ran out of setpoints"), "{dry}");
        for text in [distance, speed, time, dry] {
            assert!(
                text.starts_with("a stop left its path: ") && text.ends_with(", then acknowledge"),
                "{text}"
            );
        }
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
