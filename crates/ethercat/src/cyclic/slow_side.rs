//! The slow side's datagrams behind the cyclic ones of the first frame.
//!
//! Invariant: one reply for each request, in order, whether its frame came back or not.

use super::{Exchange, IN_OPERATION_MAX};
use crate::acyclic::{IN_FLIGHT_MAX, Outcome, Reply, bytes};
use crate::driver::SlaveFactory;
use crate::queue;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize>
    Exchange<'_, F, SLAVES, MESSAGE, FURTHER>
{
    /// Appends the slow side's datagrams behind the cyclic ones: register requests, and one message. In operation the
    /// two lanes alternate, so that neither waits for more than one datagram of the other.
    #[cold]
    pub(super) fn append_acyclic(&mut self) {
        let room = self.first.room();
        let in_operation = self.first.is_watched() || self.further.is_watched();
        let message_goes_first = in_operation && self.message_is_next && self.append_message(room);
        let sent = match (message_goes_first, in_operation) {
            (true, _) => 0,
            (false, true) => self.append_requests(room, IN_OPERATION_MAX),
            (false, false) => self.append_requests(room, IN_FLIGHT_MAX),
        };
        if !in_operation || (!message_goes_first && sent == 0) {
            self.append_message(room);
        }
        self.message_is_next = sent > 0;
        self.first.finish_acyclic(&self.encapsulation);
    }

    /// Appends at most `most` register requests as room permits; returns how many.
    fn append_requests(&mut self, room: usize, most: usize) -> usize {
        let mut owed = 0;
        for _ in 0..most {
            let Some(request) = queue::front(&self.end.requests) else {
                break;
            };
            // One reply is owed for each request that is taken.
            if !queue::has_room_for(&self.end.replies, owed + 1) {
                break;
            }
            if request.data.len() > room {
                if owed > 0 {
                    // Replies come in order: this reply waits for those of the requests before it.
                    break;
                }
                // There is room; it was checked above.
                let no_room = Outcome::NoRoom { room: room as u16 };
                let _ = queue::put(&mut self.end.replies, Reply::without_data(no_room));
            } else if self
                .first
                .push_acyclic(request.command, request.address, &request.data, false)
            {
                owed += 1;
            } else {
                break;
            }
            let _ = queue::take(&mut self.end.requests);
        }
        owed
    }

    /// Appends the waiting message, if there is one and it fits.
    fn append_message(&mut self, room: usize) -> bool {
        let Some(message) = queue::front(&self.end.messages) else {
            return false;
        };
        if !queue::has_room_for(&self.end.message_replies, 1) {
            return false;
        }
        let fits_never = message.data.len() > room;
        let taken = if fits_never {
            let no_room = Outcome::NoRoom { room: room as u16 };
            queue::put(&mut self.end.message_replies, Reply::without_data(no_room)).is_ok()
        } else {
            self.first
                .push_acyclic(message.command, message.address, &message.data, true)
        };
        if taken {
            let _ = queue::take(&mut self.end.messages);
        }
        taken && !fits_never
    }

    /// Replies to every acyclic request of the input telegram.
    #[cold]
    pub(super) fn answer_acyclic(&mut self, payload: &[u8]) {
        let (replies, message_replies) = (&mut self.end.replies, &mut self.end.message_replies);
        self.first.each_acyclic(payload, |place, data, working_counter| {
            let outcome = Outcome::Processed { working_counter };
            // Room was reserved when the request was taken.
            if place.is_message {
                let _ = queue::put(
                    message_replies,
                    Reply {
                        data: bytes(data),
                        outcome,
                    },
                );
            } else {
                let _ = queue::put(
                    replies,
                    Reply {
                        data: bytes(data),
                        outcome,
                    },
                );
            }
        });
    }

    /// Reports the acyclic requests of the input telegram to the slow side as lost. A separate function because of its
    /// stack.
    #[cold]
    #[inline(never)]
    pub(super) fn answer_lost(&mut self) {
        for place in &self.first.acyclic {
            // Room was reserved when the request was taken.
            if place.is_message {
                let _ = queue::put(&mut self.end.message_replies, Reply::without_data(Outcome::Lost));
            } else {
                let _ = queue::put(&mut self.end.replies, Reply::without_data(Outcome::Lost));
            }
        }
    }
}
