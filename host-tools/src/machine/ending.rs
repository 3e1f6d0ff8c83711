//! Waits for the end state of an order, so that the reply reports the state after the order.
//!
//! Invariant: only a status that arrived after the order's answer counts. The link keeps the order of messages, so the
//! firmware sent that status after it had carried out the order.

use super::{Order, Snapshot};
use crate::link::text;
use etherpen::application::Mode;
use etherpen::messages::{Command as Told, Sample, Status};
use std::time::{Duration, Instant};

/// Longest wait for an end state. A stop takes less than a second on a robot, and longer on an emulator with few
/// processors.
pub(crate) const END_MAX: Duration = Duration::from_secs(15);
/// Time after which a status is certainly new, even if its content is unchanged: at least two arrive each second.
const FRESH: Duration = Duration::from_secs(2);
/// Speed below which an axis counts as at rest, rad/s: above the noise of a resolver at rest.
const REST_RAD_S: f32 = 0.02;

/// Waits for the end state of an order.
pub(crate) struct Ending {
    order: Order,
    /// Cycle counter of the last status known when the order was answered.
    before: Option<u32>,
    begun: Instant,
}

impl Ending {
    /// Starts waiting; `snapshot` was taken after the order was answered.
    pub(crate) fn new(order: Order, snapshot: &Snapshot) -> Self {
        Self {
            order,
            before: snapshot.status.as_ref().map(|status| status.counters.cycles),
            begun: Instant::now(),
        }
    }

    /// Starts waiting on a connection made after the order was answered: every status on it is new.
    pub(crate) fn after_reconnection(order: Order) -> Self {
        Self {
            order,
            before: None,
            begun: Instant::now(),
        }
    }

    /// Whether the end state is reached.
    pub(crate) fn is_reached(&self, snapshot: &Snapshot) -> bool {
        self.is_reached_after(self.begun.elapsed(), snapshot)
    }

    fn is_reached_after(&self, waited: Duration, snapshot: &Snapshot) -> bool {
        let fresh = |status: &&Status| self.before != Some(status.counters.cycles) || waited > FRESH;
        let status = snapshot.status.as_ref().filter(|_| snapshot.lost.is_none());
        status.filter(fresh).is_some_and(|status| self.ends(status, snapshot))
    }

    fn ends(&self, status: &Status, snapshot: &Snapshot) -> bool {
        let mode = status.mode;
        let moves = matches!(mode, Mode::Moving | Mode::Drawing | Mode::Stopping);
        match &self.order {
            Order::Stop => mode == Mode::Fault && snapshot.sample.as_ref().is_none_or(stands),
            Order::Hold | Order::HoldAtPenUp | Order::Settle(Told::Hold) => !moves,
            Order::Cancel | Order::Settle(Told::Cancel | Told::Disable) => !moves && mode != Mode::Holding,
            Order::Resume => mode != Mode::Holding,
            Order::Override(percent) | Order::Settle(Told::Override { percent }) => status.override_percent == *percent,
            Order::Settle(Told::Acknowledge) => {
                !status.recovering && !matches!(mode, Mode::Fault | Mode::BusConfiguring)
            }
            Order::Tell(Told::SetOutput { io, value }) => {
                status.io.get(usize::from(*io)).is_some_and(|point| point.raw == *value)
            }
            Order::Motion(_) => !moves,
            _ => true,
        }
    }

    /// Whether missing the end state is an error. A hold at the next pen lift may take longer.
    pub(crate) fn is_due(&self) -> bool {
        self.order != Order::HoldAtPenUp
    }
}

fn stands(sample: &Sample) -> bool {
    sample.measured_rad_s.iter().all(|speed| speed.abs() < REST_RAD_S)
}

/// State of the machine in words.
pub(crate) fn state_text(snapshot: &Snapshot) -> String {
    let Some(status) = &snapshot.status else {
        return "the machine has not reported its state".to_owned();
    };
    match (status.mode, text::fault_of(status)) {
        (Mode::Fault, Some(_)) if text::waits_for_slave(status) => text::doing(status).into_owned(),
        (Mode::Fault, Some(fault)) => {
            let standing = match &snapshot.sample {
                Some(sample) if stands(sample) => "standing still, ",
                Some(_) => "an axis still moves, ",
                None => "",
            };
            format!("{standing}fault latched: {fault}")
        }
        (Mode::Idle | Mode::DrivesOff, _) if status.override_percent != 100 => {
            format!(
                "{}, speed override {} %",
                text::mode(status.mode),
                status.override_percent
            )
        }
        _ => text::doing(status).into_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::application::{Fault, StopSource};

    fn snapshot(cycles: u32, mode: Mode, speed_rad_s: f32) -> Snapshot {
        let fault = (mode == Mode::Fault).then_some(Fault::EmergencyStop(StopSource::Link));
        let mut status = crate::console::status::tests::status(mode, fault);
        status.counters.cycles = cycles;
        let sample = Sample {
            measured_rad_s: [0.0, speed_rad_s, 0.0, 0.0],
            ..crate::console::signals::tests::sample(0, 0.0)
        };
        Snapshot {
            status: Some(status),
            sample: Some(sample),
            ..Snapshot::default()
        }
    }

    #[test]
    fn a_stop_has_ended_once_a_later_status_tells_the_fault_and_all_axes_stand() {
        let ending = Ending::new(Order::Stop, &snapshot(10, Mode::Fault, 0.0));
        assert!(
            !ending.is_reached_after(Duration::ZERO, &snapshot(10, Mode::Fault, 0.0)),
            "the status from before the stop"
        );
        assert!(!ending.is_reached_after(Duration::ZERO, &snapshot(11, Mode::Stopping, 0.0)));
        assert!(!ending.is_reached_after(Duration::ZERO, &snapshot(12, Mode::Fault, -0.5)));
        let end = snapshot(13, Mode::Fault, 0.001);
        assert!(ending.is_reached_after(Duration::ZERO, &end) && ending.is_due());
        assert!(
            state_text(&end).starts_with("standing still, fault latched: "),
            "{}",
            state_text(&end)
        );
        assert!(Ending::after_reconnection(Order::Stop).is_reached_after(Duration::ZERO, &end));
        assert!(state_text(&snapshot(14, Mode::Fault, 0.3)).contains("still moves"));
    }

    #[test]
    fn every_order_ends_in_the_state_that_it_asks_for() {
        let cases = [
            (Order::Hold, Mode::Drawing, Mode::Holding),
            (Order::HoldAtPenUp, Mode::Drawing, Mode::Holding),
            (Order::Resume, Mode::Holding, Mode::Drawing),
            (Order::Cancel, Mode::Stopping, Mode::DrivesOff),
            (Order::Cancel, Mode::Holding, Mode::Idle),
            (Order::Settle(Told::Acknowledge), Mode::BusConfiguring, Mode::DrivesOff),
            (Order::Settle(Told::Disable), Mode::Stopping, Mode::DrivesOff),
        ];
        for (order, before, after) in cases {
            let ending = Ending::new(order.clone(), &snapshot(1, before, 0.0));
            assert!(
                !ending.is_reached_after(Duration::ZERO, &snapshot(2, before, 0.0)),
                "{order:?} in {before:?}"
            );
            assert!(
                ending.is_reached_after(Duration::ZERO, &snapshot(2, after, 0.0)),
                "{order:?} in {after:?}"
            );
        }
    }
}
