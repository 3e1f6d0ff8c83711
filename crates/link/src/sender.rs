//! Path transmission by the host: go-back-N within the firmware's credit.
//!
//! Invariant: only vertices within the credit of the last acknowledgement are sent. After a loss the path goes back to
//! the first unacknowledged vertex: once when the firmware reports the loss, and again whenever progress stops.

use crate::Protocol;
use crate::message::{HostMessage, PathAck, VERTICES_PER_MESSAGE};
use alloc::sync::Arc;

/// Time without progress after which the path is repeated from the first unacknowledged vertex, ms.
pub(crate) const PATH_REPEAT_MS: u64 = 50;

/// The sending end of one path.
pub(crate) struct PathSender<P: Protocol> {
    job: u16,
    vertices: Arc<[P::Vertex]>,
    /// First unacknowledged vertex.
    base: usize,
    /// Next vertex to send.
    next: usize,
    /// First vertex beyond the credit.
    limit: usize,
    /// Vertices in a message: halved at every loss and doubled at every progress, so that short frames get through
    /// where long ones are always damaged.
    part: usize,
    end_sent: bool,
    complete: bool,
    progress_ms: u64,
    /// Whether the path already went back because of the loss of `base`.
    repeated: bool,
}

impl<P: Protocol> PathSender<P> {
    /// A path of which nothing is sent before the first acknowledgement.
    pub(crate) fn new(job: u16, vertices: Arc<[P::Vertex]>) -> Self {
        Self {
            job,
            vertices,
            base: 0,
            next: 0,
            limit: 0,
            part: VERTICES_PER_MESSAGE,
            end_sent: false,
            complete: false,
            progress_ms: 0,
            repeated: false,
        }
    }

    pub(crate) fn job(&self) -> u16 {
        self.job
    }

    /// Number of vertices sent and not acknowledged.
    pub(crate) fn in_flight(&self) -> usize {
        self.next - self.base
    }

    /// Takes an acknowledgement; returns whether the path went back because of it.
    pub(crate) fn acknowledge(&mut self, ack: &PathAck, now_ms: u64) -> bool {
        let next = ack.next as usize;
        if next < self.base || next > self.vertices.len() {
            return false;
        }
        if next > self.base {
            self.base = next;
            self.next = self.next.max(next);
            self.progress_ms = now_ms;
            self.repeated = false;
            self.part = (self.part * 2).min(VERTICES_PER_MESSAGE);
        }
        self.complete |= ack.complete;
        self.limit = (next + usize::from(ack.credit)).min(self.vertices.len());
        let lost = ack.missing && !self.repeated;
        if lost {
            self.go_back(now_ms);
        }
        lost
    }

    fn go_back(&mut self, now_ms: u64) {
        self.next = self.base;
        self.part = (self.part / 2).max(1);
        self.end_sent = false;
        self.repeated = true;
        self.progress_ms = now_ms;
    }

    /// Goes back if nothing was acknowledged for too long; returns whether it did.
    pub(crate) fn repeat_if_silent(&mut self, now_ms: u64) -> bool {
        let waiting = self.next > self.base || (self.end_sent && !self.complete);
        let silent = waiting && now_ms.saturating_sub(self.progress_ms) >= PATH_REPEAT_MS;
        if silent {
            self.go_back(now_ms);
        }
        silent
    }

    /// The next part of the path within the credit.
    pub(crate) fn next_message(&mut self, now_ms: u64) -> Option<HostMessage<P>> {
        if self.complete || self.end_sent {
            return None;
        }
        let end = self.limit.min(self.next + self.part);
        let part = self.vertices.get(self.next..end).unwrap_or(&[]);
        let last = self.next + part.len() == self.vertices.len();
        if part.is_empty() && !last {
            return None;
        }
        if self.next == self.base {
            self.progress_ms = now_ms;
        }
        let message = HostMessage::Path {
            job: self.job,
            first: self.next as u32,
            vertices: part.iter().cloned().collect(),
            last,
        };
        self.next += part.len();
        self.end_sent = last;
        Some(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::Example;
    use std::vec::Vec;

    type PathSender = super::PathSender<Example>;

    fn path(count: i32) -> Arc<[i32]> {
        (0..count).collect()
    }

    fn ack(next: u32, credit: u16) -> PathAck {
        PathAck {
            job: 1,
            next,
            credit,
            ..PathAck::default()
        }
    }

    fn sent(sender: &mut PathSender, now_ms: u64) -> Vec<(u32, usize, bool)> {
        let messages = core::iter::from_fn(|| sender.next_message(now_ms));
        let parts = messages.map(|message| match message {
            HostMessage::Path {
                first, vertices, last, ..
            } => (first, vertices.len(), last),
            other => panic!("{other:?}"),
        });
        parts.collect()
    }

    #[test]
    fn nothing_is_sent_beyond_the_credit_and_the_last_part_says_so() {
        let mut sender = PathSender::new(1, path(30));
        assert_eq!(sent(&mut sender, 0), []);
        sender.acknowledge(&ack(0, 20), 1);
        assert_eq!(sent(&mut sender, 1), [(0, 16, false), (16, 4, false)]);
        sender.acknowledge(&ack(16, 20), 2);
        assert_eq!(sent(&mut sender, 2), [(20, 10, true)]);
        assert_eq!(sender.in_flight(), 14);
    }

    #[test]
    fn a_loss_goes_back_once_with_shorter_parts_and_again_only_when_progress_stops() {
        let mut sender = PathSender::new(1, path(64));
        sender.acknowledge(&ack(0, 64), 0);
        assert_eq!(sent(&mut sender, 0).len(), 4);
        let missing = PathAck {
            missing: true,
            ..ack(16, 48)
        };
        assert!(sender.acknowledge(&missing, 5));
        assert!(
            !sender.acknowledge(&missing, 6),
            "parts still in flight are missing the same vertex"
        );
        assert_eq!(sent(&mut sender, 6).first(), Some(&(16, 8, false)));
        assert!(!sender.repeat_if_silent(5 + PATH_REPEAT_MS));
        assert!(sender.repeat_if_silent(6 + PATH_REPEAT_MS));
        assert_eq!(sent(&mut sender, 60).first(), Some(&(16, 4, false)));
    }

    #[test]
    fn acknowledgements_of_vertices_that_do_not_exist_or_from_the_past_change_nothing() {
        let mut sender = PathSender::new(1, path(8));
        sender.acknowledge(&ack(4, 4), 0);
        sender.acknowledge(&ack(9, 99), 1);
        sender.acknowledge(&ack(2, 99), 1);
        assert_eq!(sent(&mut sender, 2), [(4, 4, true)]);
    }

    #[test]
    fn a_path_without_vertices_is_only_its_end() {
        let mut sender = PathSender::new(1, path(0));
        assert_eq!(sent(&mut sender, 0), [(0, 0, true)]);
    }
}
