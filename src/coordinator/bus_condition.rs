//! Translates events of the bus into conditions for the operating modes.
//!
//! The supervisor reports steps, slaves and errors; the operating modes know faults. Invariant: an event that takes the
//! drives out of operation always has a condition.

use crate::application::{BusCondition, Fault};
use crate::ethercat::configure::discovery::STATION_BASE;
use crate::ethercat::error::{BusError, IdentityProperty};
use crate::ethercat::event::{BusEvent, Step};

/// Bus condition for the operating modes; `None` if the event does not affect them.
pub fn bus_condition(event: &BusEvent) -> Option<BusCondition> {
    let fault = match *event {
        BusEvent::Operational => return Some(BusCondition::Operational),
        BusEvent::SlaveLost { position } => {
            return Some(BusCondition::Failed(Fault::SlaveLost { slave: position }));
        }
        BusEvent::SlaveLeft { position, report } => {
            return Some(BusCondition::Failed(Fault::SlaveState {
                slave: position,
                al_state: report.status,
                al_code: report.code,
            }));
        }
        BusEvent::ProcessorStopped { position, expiries } => Fault::ProcessorStopped {
            slave: position,
            expiries,
        },
        BusEvent::Refused { position, step, error } => refusal(position, step, error),
        BusEvent::TerminalRefused { position, step, error } => refusal(Some(position), step, error),
        BusEvent::Found { .. }
        | BusEvent::Slave { .. }
        | BusEvent::Returned { .. }
        | BusEvent::Repaired { .. }
        | BusEvent::Waiting { .. }
        | BusEvent::Stopped
        | BusEvent::Emergency { .. }
        | BusEvent::CableErrors { .. } => return None,
    };
    Some(BusCondition::Refused(fault))
}

/// Place of the slave that an event of one slave concerns; a slave's failure is a fault unless it is a terminal that the
/// drives do not need. `None` for an event that is a fault whatever the slave is: another slave than the configuration
/// expects, or one that does not go with the configuration, has to be told.
pub(super) const fn terminal_event(event: &BusEvent) -> Option<u8> {
    match event {
        BusEvent::TerminalRefused {
            error: BusError::SharedOutput { .. } | BusError::WrongSlave { .. },
            ..
        } => None,
        BusEvent::SlaveLost { position }
        | BusEvent::SlaveLeft { position, .. }
        | BusEvent::TerminalRefused { position, .. }
        | BusEvent::ProcessorStopped { position, .. } => Some(*position),
        _ => None,
    }
}

/// The fault of a bring-up or a repair that failed at a step.
fn refusal(position: Option<u8>, step: Step, error: BusError) -> Fault {
    match (position, step, error) {
        (Some(slave), _, BusError::Identity { expected, actual }) => Fault::OtherProduct {
            slave,
            expected,
            found: actual,
        },
        (
            Some(slave),
            _,
            BusError::WrongSlave {
                property,
                expected,
                actual,
                other,
            },
        ) => Fault::WrongSlave {
            slave,
            property,
            expected,
            found: actual,
            other,
        },
        (Some(slave), Step::Locate, BusError::Station { expected, actual }) => Fault::WrongSlave {
            slave,
            property: IdentityProperty::Station,
            expected: expected.into(),
            found: actual.into(),
            other: actual.checked_sub(STATION_BASE).and_then(|place| place.try_into().ok()),
        },
        (Some(slave), _, BusError::SharedOutput { first, second }) => Fault::SharedOutput { slave, first, second },
        (_, _, BusError::NoLink { port }) => Fault::NoLink { port },
        (_, _, BusError::MemberCount { expected, actual }) => Fault::UnexpectedBus {
            found: actual,
            expected,
        },
        (_, Step::Discover, BusError::SlaveCount { expected, actual }) => Fault::UnexpectedBus {
            found: actual.min(255) as u8,
            expected: expected.min(255) as u8,
        },
        _ => Fault::BusConfiguration {
            slave: position.unwrap_or(0),
            step: step as u8,
            code: error.code(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ethercat::state::AlReport;

    #[test]
    fn a_slave_that_leaves_the_bus_is_the_fault_that_names_it() {
        let report = AlReport {
            status: 0x14,
            code: 0x1b,
        };
        let left = bus_condition(&BusEvent::SlaveLeft { position: 2, report });
        let fault = Fault::SlaveState {
            slave: 2,
            al_state: 0x14,
            al_code: 0x1b,
        };
        assert_eq!(left, Some(BusCondition::Failed(fault)));
        let lost = bus_condition(&BusEvent::SlaveLost { position: 1 });
        assert_eq!(lost, Some(BusCondition::Failed(Fault::SlaveLost { slave: 1 })));
    }

    #[test]
    fn a_count_of_slaves_is_another_bus_at_discovery_and_a_failed_step_later() {
        let error = BusError::SlaveCount {
            expected: 4,
            actual: 300,
        };
        let at = |step| {
            bus_condition(&BusEvent::Refused {
                position: None,
                step,
                error,
            })
        };
        let other = Fault::UnexpectedBus {
            found: 255,
            expected: 4,
        };
        assert_eq!(at(Step::Discover), Some(BusCondition::Refused(other)));
        let failed = Fault::BusConfiguration {
            slave: 0,
            step: Step::Watch as u8,
            code: error.code(),
        };
        assert_eq!(at(Step::Watch), Some(BusCondition::Refused(failed)));
    }

    #[test]
    fn another_product_is_named_with_its_slave() {
        let error = BusError::Identity { expected: 1, actual: 2 };
        let event = BusEvent::Refused {
            position: Some(3),
            step: Step::Identify,
            error,
        };
        let fault = Fault::OtherProduct {
            slave: 3,
            expected: 1,
            found: 2,
        };
        assert_eq!(bus_condition(&event), Some(BusCondition::Refused(fault)));
    }

    #[test]
    fn a_number_of_slaves_beyond_what_a_fault_can_hold_is_shown_as_the_greatest() {
        let error = BusError::SlaveCount {
            expected: 300,
            actual: 259,
        };
        let fault = refusal(None, Step::Discover, error);
        let most = Fault::UnexpectedBus {
            found: 255,
            expected: 255,
        };
        assert_eq!(fault, most);
    }
}
