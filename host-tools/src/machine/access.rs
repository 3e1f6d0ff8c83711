//! Access to a machine from any terminal: through the program that has the port, or over the port itself.

use super::ending::{END_MAX, Ending};
use super::{Answer, Client, Failure, Machine, MachineOptions, Order, Snapshot};
use crate::error::{ProgramError, code};
use crate::link::ownership::Owner;
use crate::link::port::{PortError, PortName};
use crate::link::text;
use etherpen::config::Config;
use etherpen::messages::Command as Told;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

/// Time between two checks while waiting.
const LOOK: Duration = Duration::from_millis(20);
/// Longest wait for the machine's state; the link's own time limit is shorter.
const STATE_MAX: Duration = Duration::from_secs(10);
/// Longest wait for a sample of a machine whose status is known.
const SAMPLE_MAX: Duration = Duration::from_secs(1);

/// What this program needs to open a port itself, and to be interrupted.
#[derive(Clone, Copy)]
pub(crate) struct OwnPort<'a> {
    /// Reads the configuration.
    pub(crate) config: &'a (dyn Fn() -> Result<Config, ProgramError> + Sync),
    /// Starts watching for an interrupt, which cancels the order, and a motion also through another program.
    pub(crate) interrupted: &'a (dyn Fn() -> Result<Arc<AtomicBool>, ProgramError> + Sync),
    /// Tells the operator what the machine is waiting for.
    pub(crate) tell: &'a (dyn Fn(&str) + Sync),
}

/// Tells what a machine waits for while an order is carried out, each wait once.
struct Progress<'a> {
    tell: &'a (dyn Fn(&str) + Sync),
    told: Option<u8>,
}

impl<'a> Progress<'a> {
    fn new(tell: &'a (dyn Fn(&str) + Sync)) -> Self {
        Self { tell, told: None }
    }

    /// Takes a state of the machine; whether it waits for a slave that is still starting up.
    fn take(&mut self, snapshot: &Snapshot) -> bool {
        let status = snapshot.status.as_ref().filter(|_| snapshot.lost.is_none());
        let waiting = status.filter(|status| text::waits_for_slave(status));
        let slave = waiting.and_then(|status| status.waiting_for);
        if let Some(status) = waiting.filter(|_| slave != self.told) {
            (self.tell)(&text::doing(status));
        }
        self.told = slave;
        slave.is_some()
    }
}

/// An order that a machine accepted, and the state that the order led to.
#[derive(Debug)]
pub(crate) struct Effect {
    /// Whether the end state of the order was reached.
    pub(crate) reached: bool,
    /// Whether missing the end state is an error.
    pub(crate) is_due: bool,
    /// Current state of the machine.
    pub(crate) snapshot: Snapshot,
    /// The program that carried out the order; `None` for this one.
    pub(crate) owner: Option<Owner>,
}

/// Sends an order to the machine at a port and waits for its effect.
///
/// # Errors
/// There is no connection, or the machine did not carry out the order.
pub(crate) fn carry_out(port: &PortName, own: OwnPort, order: Order) -> Result<Effect, ProgramError> {
    let mut access = MachineAccess::find(port, own)?;
    let mut progress = Progress::new(own.tell);
    let order = access.carry_out(order, port, own, &mut progress)?;
    let mut begun = Instant::now();
    let mut ending: Option<Ending> = None;
    loop {
        match access.state() {
            Ok(snapshot) => {
                let ending = ending.get_or_insert_with(|| Ending::new(order.clone(), &snapshot));
                if progress.take(&snapshot) {
                    begun = Instant::now();
                }
                if ending.is_reached(&snapshot) || begun.elapsed() > END_MAX {
                    return Ok(Effect {
                        reached: ending.is_reached(&snapshot),
                        is_due: ending.is_due(),
                        snapshot,
                        owner: access.owner().cloned(),
                    });
                }
            }
            Err(gone) if begun.elapsed() > END_MAX => return Err(gone),
            // The program that had the port has ended, as a drawing program does after a stop: open the port here.
            Err(_) => {
                if let Ok(found) = MachineAccess::find(port, own) {
                    (access, ending) = (found, Some(Ending::after_reconnection(order.clone())));
                }
            }
        }
        std::thread::sleep(LOOK);
    }
}

/// Stops the machines at several ports in parallel; the results are in the order of the ports.
pub(crate) fn stop_all(ports: &[PortName], own: OwnPort) -> Vec<Result<Effect, ProgramError>> {
    std::thread::scope(|scope| {
        let begin = |port| scope.spawn(move || carry_out(port, own, Order::Stop));
        let under_way: Vec<_> = ports.iter().map(begin).collect();
        let end = |thread: std::thread::ScopedJoinHandle<'_, _>| {
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        under_way.into_iter().map(end).collect()
    })
}

/// Access to a machine.
#[allow(clippy::large_enum_variant)] // there is one
pub(crate) enum MachineAccess {
    /// Through the program that has the port.
    Through(Client),
    /// The port, opened here.
    Own(Machine),
}

impl MachineAccess {
    /// Finds the program that has the port, or opens the port.
    ///
    /// # Errors
    /// The configuration cannot be used, or the port cannot be opened.
    pub(crate) fn find(port: &PortName, own: OwnPort) -> Result<Self, ProgramError> {
        if let Some(client) = Client::find(port) {
            return Ok(Self::Through(client));
        }
        let config = (own.config)()?;
        match Machine::start(port.clone(), config, MachineOptions::default()) {
            Ok(machine) => Ok(Self::Own(machine)),
            // Another program took the port between the two checks.
            Err(error @ PortError::Occupied { .. }) => Client::find(port)
                .map(Self::Through)
                .ok_or_else(|| ProgramError::new(code::CONNECTION, error)),
            Err(error) => Err(ProgramError::new(code::CONNECTION, error)),
        }
    }

    /// The program that has the port; `None` for this one.
    pub(crate) fn owner(&self) -> Option<&Owner> {
        match self {
            Self::Through(client) => Some(client.owner()),
            Self::Own(_) => None,
        }
    }

    /// Sends an order and waits for its answer; an interrupt cancels it. Returns the order that was carried out.
    fn carry_out(
        &mut self,
        order: Order,
        port: &PortName,
        own: OwnPort,
        progress: &mut Progress,
    ) -> Result<Order, ProgramError> {
        let (order, answer) = match self {
            Self::Through(client) => (order.clone(), wait_through(client, order, port, own, progress)?),
            Self::Own(machine) => {
                let order = without_drawing(order)?;
                let interrupted = (own.interrupted)()?;
                (order.clone(), wait(machine, order, &interrupted, progress))
            }
        };
        answer.map(|_| order).map_err(ProgramError::from)
    }

    /// State of the machine, once it is known.
    ///
    /// # Errors
    /// There is no connection.
    pub(crate) fn state(&mut self) -> Result<Snapshot, ProgramError> {
        match self {
            Self::Through(client) => Ok(client.snapshot()?),
            Self::Own(machine) => {
                let begun = Instant::now();
                loop {
                    let snapshot = machine.snapshot();
                    if let Some(lost) = snapshot.lost {
                        return Err(lost.into());
                    }
                    let sampled = snapshot.sample.is_some() || begun.elapsed() > SAMPLE_MAX;
                    let known = snapshot.status.is_some() && snapshot.phase.is_none() && sampled;
                    if known || begun.elapsed() > STATE_MAX {
                        return Ok(snapshot);
                    }
                    std::thread::sleep(LOOK);
                }
            }
        }
    }
}

/// The order to send if no program is drawing: one that waits for its effect.
fn without_drawing(order: Order) -> Result<Order, ProgramError> {
    Ok(match order {
        Order::Hold | Order::HoldAtPenUp => Order::Settle(Told::Hold),
        Order::Cancel => Order::Settle(Told::Cancel),
        Order::Override(percent) => Order::Settle(Told::Override { percent }),
        Order::Resume => {
            let text = "no program streams a drawing over this port, so there is nothing to resume; start it \
                        again where it broke off: etherpen draw FILE --resume";
            return Err(ProgramError::new(code::FAILED, text));
        }
        order => order,
    })
}

/// Sends an order to the program that has the port and waits for its answer; an interrupt cancels a motion. A second
/// connection shows meanwhile what the machine waits for.
///
/// # Errors
/// Signals cannot be watched for.
fn wait_through(
    client: &mut Client,
    order: Order,
    port: &PortName,
    own: OwnPort,
    progress: &mut Progress,
) -> Result<Answer, ProgramError> {
    if matches!(order, Order::Motion(_)) {
        return Ok(client.carry_out_unless(order, &*(own.interrupted)()?));
    }
    // Only these bring slaves up; every other order ends soon.
    if !matches!(order, Order::Settle(Told::Acknowledge) | Order::Prepare(_)) {
        return Ok(client.carry_out(order));
    }
    let answer = std::thread::scope(|scope| {
        let answer = scope.spawn(|| client.carry_out(order));
        let mut watching = None;
        while !answer.is_finished() {
            std::thread::sleep(LOOK);
            let watch: Option<&mut Client> = match &mut watching {
                Some(watch) => Some(watch),
                none => Client::find(port).map(|found| none.insert(found)),
            };
            match watch.map(Client::snapshot) {
                Some(Ok(snapshot)) => _ = progress.take(&snapshot),
                Some(Err(_)) => watching = None,
                None => {}
            }
        }
        answer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    });
    Ok(answer)
}

/// Sends an order and waits for its answer; an interrupt cancels it.
fn wait(machine: &Machine, order: Order, interrupted: &AtomicBool, progress: &mut Progress) -> Answer {
    let answer = machine.order(order);
    let mut cancelled = false;
    loop {
        match answer.recv_timeout(LOOK) {
            Ok(answer) => return answer,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                return Err(Failure {
                    code: code::FAILED,
                    text: "the machine's thread has ended".into(),
                });
            }
        }
        progress.take(&machine.snapshot());
        if interrupted.load(Ordering::Relaxed) && !cancelled {
            cancelled = true;
            // Its effect is the end of the other order.
            drop(machine.order(Order::Cancel));
        }
    }
}
