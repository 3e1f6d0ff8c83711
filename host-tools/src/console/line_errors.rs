//! Error counters of the slave controllers: damaged frames and lost links of each port.
//!
//! The counters are read slowly, through the firmware's master like any other bus request, and only while there is a
//! viewer. Invariant: an unanswered request only leaves a number missing on the page; no motion waits for it.

use super::Console;
use super::hub::Topic;
use crate::machine::{Answer, Order, Reply};
use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest, SlaveErrors};
use etherpen::ethercat::wire::register::PortErrors;
use serde::Serialize;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// Time between two readings.
const PAUSE: Duration = Duration::from_secs(2);
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(3);

/// Counters of a slave, summed over its ports; the registers stop at 255.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct LineErrorsView {
    number: u8,
    /// Frames with a wrong checksum or without an end.
    invalid_frames: u32,
    /// Errors of the physical layer.
    receive_errors: u32,
    /// Errors already marked by an earlier slave.
    forwarded: u32,
    lost_links: u32,
    watchdog: u8,
    /// Counters of each port that are not 0, as text.
    text: String,
}

fn view(number: u8, errors: &SlaveErrors) -> LineErrorsView {
    let sum = |count: fn(&PortErrors) -> u8| errors.ports.iter().map(|port| u32::from(count(port))).sum();
    let told = errors.ports.iter().enumerate().filter_map(|(port, counted)| {
        let counts = [
            (counted.invalid_frames, "invalid frames"),
            (counted.receive_errors, "receive errors"),
            (counted.forwarded_errors, "forwarded errors"),
            (counted.lost_links, "lost links"),
        ];
        let told: Vec<_> = counts
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}"))
            .collect();
        (!told.is_empty()).then(|| format!("port {port}: {}", told.join(", ")))
    });
    LineErrorsView {
        number,
        invalid_frames: sum(|port| port.invalid_frames),
        receive_errors: sum(|port| port.receive_errors),
        forwarded: sum(|port| port.forwarded_errors),
        lost_links: sum(|port| port.lost_links),
        watchdog: errors.watchdog,
        text: told.collect::<Vec<_>>().join("; "),
    }
}

/// Reads the counters periodically in a separate thread until the console has ended.
pub(super) fn watch(console: &Arc<Console>) {
    let console = Arc::downgrade(console);
    // Without the thread the page shows no counters.
    let _ = std::thread::Builder::new()
        .name("line errors".to_owned())
        .spawn(move || while read(&console).is_some() {});
}

/// Takes one reading; `None` when the console has ended.
fn read(console: &Weak<Console>) -> Option<()> {
    std::thread::sleep(PAUSE);
    let asked = ask(&*console.upgrade()?);
    // The console is not kept alive meanwhile, so that it can end.
    let answered = asked
        .into_iter()
        .filter_map(|(number, answer)| match answer.recv_timeout(PATIENCE) {
            Ok(Ok(Reply::Bus(Ok(ServiceReply::Errors(errors))))) => Some(view(number, &errors)),
            _ => None,
        });
    let views: Vec<_> = answered.collect();
    console.upgrade()?.change(|hub| hub.say(Topic::LineErrors, &views));
    Some(())
}

fn ask(console: &Console) -> Vec<(u8, Receiver<Answer>)> {
    let slaves = match &*console.hub() {
        hub if hub.is_watched() => hub.slaves(),
        _ => 0,
    };
    let order = |slave| {
        (
            slave + 1,
            console.machine.order(Order::Bus(ServiceRequest::Errors { slave })),
        )
    };
    (0..slaves).map(order).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_are_added_over_the_ports_and_told_port_by_port() {
        let mut errors = SlaveErrors {
            watchdog: 1,
            ..SlaveErrors::default()
        };
        let [first, second, ..] = &mut errors.ports;
        *first = PortErrors {
            invalid_frames: 200,
            lost_links: 1,
            ..PortErrors::default()
        };
        second.invalid_frames = 255;
        let view = view(3, &errors);
        assert_eq!(
            (view.number, view.invalid_frames, view.lost_links, view.watchdog),
            (3, 455, 1, 1)
        );
        assert_eq!(
            view.text,
            "port 0: 200 invalid frames, 1 lost links; port 1: 255 invalid frames"
        );
    }
}
