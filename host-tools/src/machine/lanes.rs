//! Queues of orders to the machine's thread: stops have a queue of their own.
//!
//! Invariant: a stop is taken before every other waiting order. An order requested before the stop is not carried out
//! after it, whether it waits here or where its [`Ticket`] was taken.

use super::{Answer, Failure, Order};
use crate::error::code;
use crate::job::task::Life;
use etherpen::messages::Command;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Most stops in the queue; the thread takes all of them every millisecond.
const STOPS_MAX: usize = 64;
/// Most orders taken at a time.
const ORDERS_AT_ONCE: usize = 64;

/// Called once a stop has been written to the port, or can no longer be written.
pub(super) type Written = Box<dyn FnOnce() + Send>;

/// Position of a request in the sequence of all orders and stops.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ticket(u64);

/// An order on its way.
pub(super) struct Envelope {
    ticket: Ticket,
    pub(super) order: Order,
    pub(super) reply: Sender<Answer>,
    /// Signs of life that a motion from another process depends on.
    pub(super) life: Option<Life>,
    written: Option<Written>,
}

impl Envelope {
    fn is_stop(&self) -> bool {
        matches!(self.order, Order::Stop | Order::Tell(Command::Stop))
    }

    /// Takes the function to call once the stop has been written.
    pub(super) fn take_written(&mut self) -> Option<Written> {
        self.written.take()
    }
}

impl Drop for Envelope {
    fn drop(&mut self) {
        // A caller that waits for a stop to be written is released even if the stop is never written.
        if let Some(written) = self.written.take() {
            written();
        }
    }
}

/// Waiting stops; `None` once the thread has ended.
type Stops = Arc<Mutex<Option<Vec<Envelope>>>>;

fn lock(stops: &Stops) -> MutexGuard<'_, Option<Vec<Envelope>>> {
    stops.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The sending end of the queues.
#[derive(Clone)]
pub(super) struct Lanes {
    orders: Sender<Envelope>,
    stops: Stops,
    next: Arc<AtomicU64>,
    /// Number of the last stop.
    stopped: Arc<AtomicU64>,
}

impl std::fmt::Debug for Lanes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Lanes")
    }
}

/// Both ends of the queues.
pub(super) fn lanes() -> (Lanes, Taken) {
    let (orders, received) = mpsc::channel();
    let stops = Stops::new(Mutex::new(Some(Vec::new())));
    let lanes = Lanes {
        orders,
        stops: stops.clone(),
        next: Arc::default(),
        stopped: Arc::default(),
    };
    let taken = Taken {
        orders: received,
        stops,
        overtaken_to: 0,
    };
    (lanes, taken)
}

impl Lanes {
    /// A ticket for a request made now.
    pub(super) fn ticket(&self) -> Ticket {
        Ticket(self.next.fetch_add(1, Ordering::SeqCst))
    }

    /// Whether a stop was ordered after this ticket was taken.
    pub(super) fn is_overtaken(&self, ticket: Ticket) -> bool {
        self.stopped.load(Ordering::SeqCst) > ticket.0
    }

    /// Sends an order requested now. Exactly one answer arrives, or the channel closes when the thread has ended.
    pub(super) fn give(&self, order: Order, life: Option<Life>, written: Option<Written>) -> Receiver<Answer> {
        self.give_for(self.ticket(), order, life, written)
    }

    /// Sends an order that was requested when its ticket was taken.
    pub(super) fn give_for(
        &self,
        ticket: Ticket,
        order: Order,
        life: Option<Life>,
        written: Option<Written>,
    ) -> Receiver<Answer> {
        let (reply, answer) = mpsc::channel();
        let envelope = Envelope {
            ticket,
            order,
            reply,
            life,
            written,
        };
        if !envelope.is_stop() {
            // Without the thread the sender is dropped, which closes the receiver.
            let _ = self.orders.send(envelope);
            return answer;
        }
        self.stopped.fetch_max(ticket.0, Ordering::SeqCst);
        match lock(&self.stops).as_mut() {
            Some(stops) if stops.len() < STOPS_MAX => stops.push(envelope),
            Some(_) => {
                let many = Failure::new(code::FAILED, "other stops are on their way");
                let _ = envelope.reply.send(Err(many));
            }
            None => {}
        }
        answer
    }
}

/// The thread's end of the queues; dropping it closes both.
pub(super) struct Taken {
    orders: Receiver<Envelope>,
    stops: Stops,
    /// Number of the last stop that was taken: every order before it is overtaken.
    overtaken_to: u64,
}

impl Drop for Taken {
    fn drop(&mut self) {
        let _ = lock(&self.stops).take();
    }
}

impl Taken {
    /// Hands out the pending orders: all stops first, then some of the others.
    pub(super) fn take(&mut self, mut act: impl FnMut(Envelope)) {
        self.take_stops(&mut act);
        for _ in 0..ORDERS_AT_ONCE {
            let Ok(envelope) = self.orders.try_recv() else { return };
            self.sort(envelope, &mut act);
        }
    }

    /// Hands out the pending orders; waits for the first one at most this long.
    pub(super) fn take_within(&mut self, longest: Duration, mut act: impl FnMut(Envelope)) {
        self.take_stops(&mut act);
        match self.orders.recv_timeout(longest) {
            Ok(envelope) => self.sort(envelope, &mut act),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
        }
        self.take_stops(&mut act);
    }

    fn take_stops(&mut self, act: &mut impl FnMut(Envelope)) {
        let stops = lock(&self.stops).as_mut().map(std::mem::take).unwrap_or_default();
        for stop in stops {
            self.overtaken_to = self.overtaken_to.max(stop.ticket.0);
            act(stop);
        }
    }

    fn sort(&self, envelope: Envelope, act: &mut impl FnMut(Envelope)) {
        if envelope.ticket.0 >= self.overtaken_to {
            return act(envelope);
        }
        let _ = envelope.reply.send(Err(overtaken()));
    }
}

/// Failure text of an order that a stop has overtaken.
pub const OVERTAKEN: &str = "a stop has overtaken it";

/// Answer to an order that a stop has overtaken.
pub(super) fn overtaken() -> Failure {
    Failure::new(code::FAILED, OVERTAKEN)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Orders in the sequence in which they are handed out.
    fn taken(lane: &mut Taken) -> Vec<Order> {
        let mut orders = Vec::new();
        lane.take(|envelope| orders.push(envelope.order.clone()));
        orders
    }

    #[test]
    fn a_stop_comes_out_first_and_what_was_ordered_before_it_never() {
        for (before, after) in (0..200_u64).map(|case| (case % 14, case / 14)) {
            let (lanes, mut lane) = lanes();
            let give = |order| lanes.give(order, None, None);
            let earlier: Vec<_> = (0..before).map(|_| give(Order::Tell(Command::Acknowledge))).collect();
            let _stopped = give(Order::Stop);
            let _later: Vec<_> = (0..after).map(|_| give(Order::Hold)).collect();
            let mut expected = vec![Order::Stop];
            expected.extend((0..after).map(|_| Order::Hold));
            assert_eq!(taken(&mut lane), expected, "{before} before, {after} after");
            for answer in earlier {
                assert_eq!(answer.recv(), Ok(Err(overtaken())));
            }
        }
    }

    #[test]
    fn what_was_asked_for_before_a_stop_is_not_carried_out_although_it_is_given_after_it() {
        let (lanes, mut lane) = lanes();
        let before = lanes.ticket();
        assert!(!lanes.is_overtaken(before));
        let _stopped = lanes.give(Order::Stop, None, None);
        let after = lanes.ticket();
        let late = lanes.give_for(before, Order::Tell(Command::Acknowledge), None, None);
        let _held = lanes.give_for(after, Order::Hold, None, None);
        assert!(lanes.is_overtaken(before) && !lanes.is_overtaken(after));
        assert_eq!(taken(&mut lane), [Order::Stop, Order::Hold]);
        assert_eq!(late.recv(), Ok(Err(overtaken())));
    }

    #[test]
    fn however_many_orders_wait_a_stop_is_among_the_next_that_are_taken() {
        let (lanes, mut lane) = lanes();
        let _answers: Vec<_> = (0..10_000).map(|_| lanes.give(Order::Hold, None, None)).collect();
        assert_eq!(taken(&mut lane).len(), ORDERS_AT_ONCE);
        let _stopped = lanes.give(Order::Stop, None, None);
        assert_eq!(taken(&mut lane), [Order::Stop]);
    }

    #[test]
    fn a_caller_waiting_for_a_stop_is_released_even_if_the_stop_is_not_taken() {
        let (lanes, lane) = lanes();
        let (told, wait) = mpsc::channel();
        let told_again = told.clone();
        let waiting = lanes.give(
            Order::Stop,
            None,
            Some(Box::new(move || told.send(()).unwrap_or_default())),
        );
        drop(lane);
        let late = lanes.give(
            Order::Stop,
            None,
            Some(Box::new(move || told_again.send(()).unwrap_or_default())),
        );
        assert_eq!((wait.recv(), wait.recv()), (Ok(()), Ok(())));
        assert!(waiting.recv().is_err() && late.recv().is_err());
    }
}
