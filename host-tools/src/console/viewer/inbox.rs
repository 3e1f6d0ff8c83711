//! A viewer's requests that are not started yet.
//!
//! Invariant: at most [`WAITING_MAX`] requests wait; of plot requests only the newest of each kind, and a jog replaces
//! one of its own kind directly before it.

use super::super::messages::Request;
use crate::machine::Ticket;
use std::collections::VecDeque;

/// Most waiting requests.
pub(super) const WAITING_MAX: usize = 64;

/// Requests in their order, each with when it was heard.
#[derive(Debug, Default)]
pub(super) struct Inbox(VecDeque<(Ticket, Request)>);

impl Inbox {
    /// Takes a request; returns whether there was room for it.
    pub(super) fn push(&mut self, heard: Ticket, request: Request) -> bool {
        let same_kind =
            |(_, other): &(Ticket, Request)| std::mem::discriminant(other) == std::mem::discriminant(&request);
        match request {
            Request::Alive if self.0.iter().any(same_kind) => return true,
            Request::Watch { .. } | Request::Range { .. } => self.0.retain(|other| !same_kind(other)),
            Request::Jog { .. } | Request::JogAxis { .. } if self.0.back().is_some_and(same_kind) => {
                drop(self.0.pop_back())
            }
            _ => {}
        }
        let has_room = self.0.len() < WAITING_MAX;
        if has_room {
            self.0.push_back((heard, request));
        }
        has_room
    }

    /// The oldest request.
    pub(super) fn pop(&mut self) -> Option<(Ticket, Request)> {
        self.0.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Lcg;

    /// A request that carries this number.
    fn request(number: u64) -> Request {
        match number % 6 {
            0 => Request::Alive,
            1 if number % 12 == 1 => Request::Jog {
                velocity_mm_s: [number as f64, 0.0, 0.0],
            },
            1 => Request::JogAxis {
                axis: number as u8,
                forward: true,
                press: number,
            },
            2 | 3 => Request::Range {
                id: number as u32,
                signals: vec![0],
                from_ms: 0,
                to_ms: 1,
                columns: 0,
            },
            4 => Request::Freeze,
            _ => Request::Release,
        }
    }

    #[test]
    fn whatever_is_asked_little_waits_and_the_newest_picture_and_jog_are_in_it() {
        for seed in 1..200_u64 {
            let (mut inbox, mut random) = (Inbox::default(), Lcg::new(seed));
            let (mut last_range, mut last_jog) = (None, None);
            for _ in 0..500 {
                let asked = request(random.bits());
                let is_range = matches!(asked, Request::Range { .. });
                let has_room = inbox.push(Ticket::default(), asked.clone());
                if has_room && matches!(asked, Request::Jog { .. }) {
                    last_jog = Some(asked.clone());
                }
                if is_range && has_room {
                    last_range = Some(asked);
                } else if is_range {
                    last_range = None;
                }
                assert!(inbox.0.len() <= WAITING_MAX, "seed {seed}");
            }
            let waiting: Vec<_> = std::iter::from_fn(|| inbox.pop()).map(|(_, request)| request).collect();
            let ranges: Vec<_> = waiting
                .iter()
                .filter(|request| matches!(request, Request::Range { .. }))
                .collect();
            assert_eq!(ranges, last_range.iter().collect::<Vec<_>>(), "seed {seed}");
            let jog = waiting
                .iter()
                .rev()
                .find(|request| matches!(request, Request::Jog { .. }));
            assert_eq!(jog, last_jog.as_ref(), "seed {seed}");
        }
    }
}
