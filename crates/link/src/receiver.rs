//! The path as the firmware receives it: go-back-N with credit.
//!
//! The host may send as many vertices as there is room for; each message names its first vertex. The firmware takes
//! only the message that continues the path, and only as far as there is room. The path therefore arrives complete and
//! in order whatever the line does. Acknowledgements are cumulative, carry the credit and report a missing message.

use crate::Protocol;
use crate::message::{DeviceMessage, PathAck, PathVertices};

/// Shortest time between two acknowledgements that only report progress, ms.
pub(crate) const ACK_PROGRESS_MS: u64 = 12;
/// Longest time between two acknowledgements while there is a path, ms; repeats credit that was lost on the line.
pub(crate) const ACK_PERIOD_MS: u64 = 100;

const _: () = assert!(ACK_PROGRESS_MS < ACK_PERIOD_MS);

/// The receiving end of one path.
#[derive(Debug)]
pub(crate) struct PathReceiver<P: Protocol> {
    ack: PathAck,
    open: bool,
    refusal: Option<P::VertexRefusal>,
    refusal_due: bool,
    ack_due: bool,
    changed: bool,
    ack_sent_ms: u64,
}

impl<P: Protocol> PathReceiver<P> {
    /// A path that begins with vertex 0; its first acknowledgement gives `credit`.
    pub(crate) fn new(job: u16, credit: u16) -> Self {
        Self {
            ack: PathAck {
                job,
                credit,
                ..PathAck::default()
            },
            open: true,
            refusal: None,
            refusal_due: false,
            ack_due: true,
            changed: false,
            ack_sent_ms: 0,
        }
    }

    pub(crate) fn job(&self) -> u16 {
        self.ack.job
    }

    /// Takes the vertices that continue the path and have room. Returns them with whether they end the path, or `None`
    /// if there is nothing to take, and whether something was dropped.
    pub(crate) fn take(
        &mut self,
        first: u32,
        mut vertices: PathVertices<P>,
        last: bool,
        free: usize,
    ) -> (Option<(PathVertices<P>, bool)>, bool) {
        self.ack_due = true;
        self.refusal_due = self.refusal.is_some();
        if !self.open || self.ack.complete || first != self.ack.next {
            self.ack.missing = self.open && first > self.ack.next;
            return (None, true);
        }
        let offered = vertices.len();
        vertices.truncate(free);
        let dropped = vertices.len() < offered;
        self.ack.missing = false;
        self.ack.next = self.ack.next.saturating_add(vertices.len() as u32);
        self.ack.credit = credit(free.saturating_sub(vertices.len()));
        self.ack.complete = last && !dropped;
        let last = self.ack.complete;
        let taken = (last || !vertices.is_empty()).then_some((vertices, last));
        (taken, dropped)
    }

    /// Sets the progress of the execution and the present room. A path of which a vertex was refused is never finished: it ends
    /// before that vertex.
    pub(crate) fn acknowledge(&mut self, executed: u32, free: usize, finished: bool) {
        let finished = finished && self.refusal.is_none();
        let ack = PathAck {
            credit: if self.open { credit(free) } else { 0 },
            executed,
            finished,
            ..self.ack
        };
        self.changed |= ack != self.ack;
        self.ack_due |= finished && !self.ack.finished;
        self.ack = ack;
    }

    /// Makes the acknowledgement due again.
    pub(crate) fn acknowledge_now(&mut self) {
        self.ack_due = true;
    }

    /// Takes no more vertices; sends the reason now, and behind each acknowledgement: it may be lost on the line.
    pub(crate) fn refuse(&mut self, refusal: P::VertexRefusal) {
        self.close();
        self.refusal = Some(refusal);
        self.refusal_due = true;
    }

    /// Takes no more vertices.
    pub(crate) fn close(&mut self) {
        self.open = false;
        self.ack.credit = 0;
        self.changed = true;
    }

    /// The refusal or the acknowledgement that is due.
    pub(crate) fn next_message(&mut self, now_ms: u64) -> Option<DeviceMessage<P>> {
        if let Some(refusal) = self.refusal.clone().filter(|_| self.refusal_due) {
            self.refusal_due = false;
            return Some(DeviceMessage::VertexRefused {
                job: self.ack.job,
                refusal,
            });
        }
        let age_ms = now_ms.saturating_sub(self.ack_sent_ms);
        let due = self.ack_due || (self.changed && age_ms >= ACK_PROGRESS_MS) || age_ms >= ACK_PERIOD_MS;
        if !due {
            return None;
        }
        let ack = self.ack;
        self.ack.missing = false;
        self.ack_due = false;
        self.changed = false;
        self.ack_sent_ms = now_ms;
        self.refusal_due = self.refusal.is_some();
        Some(DeviceMessage::Ack(ack))
    }
}

fn credit(free: usize) -> u16 {
    u16::try_from(free).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::{Example, part};

    fn receiver() -> PathReceiver<Example> {
        let mut receiver = PathReceiver::new(3, 100);
        assert_eq!(ack(&mut receiver, 0).map(|ack| ack.credit), Some(100));
        receiver
    }

    fn ack(receiver: &mut PathReceiver<Example>, now_ms: u64) -> Option<PathAck> {
        match receiver.next_message(now_ms)? {
            DeviceMessage::Ack(ack) => Some(ack),
            _ => None,
        }
    }

    #[test]
    fn only_what_continues_the_path_is_taken_and_only_as_much_as_there_is_room() {
        let mut receiver = receiver();
        assert_eq!(receiver.take(4, part(4, 4), false, 100), (None, true));
        let late = ack(&mut receiver, 1).unwrap();
        assert_eq!((late.next, late.missing), (0, true));
        assert_eq!(receiver.take(0, part(0, 4), true, 3), (Some((part(0, 3), false)), true));
        let some = ack(&mut receiver, 2).unwrap();
        assert_eq!(
            (some.next, some.credit, some.missing, some.complete),
            (3, 0, false, false)
        );
        assert_eq!(receiver.take(3, part(3, 1), true, 9), (Some((part(3, 1), true)), false));
        assert_eq!(receiver.take(3, part(3, 1), true, 9), (None, true));
        assert!(ack(&mut receiver, 3).unwrap().complete);
    }

    #[test]
    fn a_path_without_vertices_has_an_end() {
        let mut receiver = receiver();
        assert_eq!(receiver.take(0, part(0, 0), false, 9), (None, false));
        assert_eq!(receiver.take(0, part(0, 0), true, 0), (Some((part(0, 0), true)), false));
    }

    #[test]
    fn a_refused_path_is_never_finished_and_its_refusal_is_repeated() {
        let mut receiver = receiver();
        let refused = Some(DeviceMessage::VertexRefused { job: 3, refusal: 2 });
        receiver.refuse(2);
        assert_eq!(receiver.next_message(1), refused);
        let mut counts = [0; 2];
        for now_ms in 2..1_000 {
            // What came before that vertex is executed to its end.
            receiver.acknowledge(7, 50, now_ms > 100);
            match receiver.next_message(now_ms) {
                Some(DeviceMessage::Ack(ack)) => {
                    assert!(!ack.finished, "{now_ms}");
                    counts[0] += 1;
                }
                other => counts[1] += usize::from(other == refused),
            }
        }
        assert!(counts[0] > 8 && counts[1] == counts[0], "{counts:?}");
    }

    #[test]
    fn a_refused_vertex_closes_the_path_and_is_repeated_while_the_host_goes_on_sending() {
        let mut receiver = receiver();
        let refusal = 2;
        let refused = Some(DeviceMessage::VertexRefused { job: 3, refusal });
        receiver.refuse(refusal);
        assert_eq!(receiver.next_message(1), refused);
        assert_eq!(receiver.take(0, part(0, 4), false, 100), (None, true));
        assert_eq!(receiver.next_message(2), refused);
        assert_eq!(ack(&mut receiver, 2).map(|ack| ack.credit), Some(0));
    }

    #[test]
    fn progress_is_acknowledged_at_most_every_12_ms_and_credit_is_repeated() {
        let mut receiver = receiver();
        let mut count = 0;
        for now_ms in 1..=120 {
            receiver.acknowledge(now_ms as u32, 50, false);
            count += usize::from(ack(&mut receiver, now_ms).is_some());
        }
        assert_eq!(count, 10);
        let count = (121..=420)
            .filter(|now_ms| ack(&mut receiver, *now_ms).is_some())
            .count();
        assert_eq!(count, 3);
        receiver.acknowledge(120, 50, true);
        assert!(
            ack(&mut receiver, 421).is_some_and(|ack| ack.finished),
            "the end is told at once"
        );
    }
}
