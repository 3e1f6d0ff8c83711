//! Requests of the slow side that ride in the cyclic frames' spare room.
//!
//! The slow side never touches the network: it queues a [`Request`] and the critical side's
//! [`Exchange`](super::cyclic::Exchange) puts it behind the cyclic datagrams of its next input telegram. Every request
//! gets exactly one [`Reply`], in order, at the latest one cycle later; when the frame was lost the reply says so.
//!
//! Invariant: a pending future of this module is polled again every millisecond; no waker is ever registered. Time is
//! counted in polls.

use super::error::BusError;
use super::wire::{Address, Command};
use core::future::poll_fn;
use core::task::Poll;
use heapless::Vec;
use heapless::spsc::{Consumer, Producer};

/// Most data of one acyclic datagram, bytes: one mailbox of the drives.
pub const ACYCLIC_BYTES_MAX: usize = 512;
/// Most requests on the way at a time.
pub const IN_FLIGHT_MAX: usize = 4;
/// How often a datagram that cannot do harm is repeated after loss or a wrong working counter.
pub const TRIES_MAX: u8 = 8;

/// Data of an acyclic datagram.
pub type Bytes = Vec<u8, ACYCLIC_BYTES_MAX>;

/// One datagram to be sent as soon as there is room.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// What is asked.
    pub command: Command,
    /// Whom and where.
    pub address: Address,
    /// What is written, or zeros to be replaced by what is read.
    pub data: Bytes,
}

/// What became of a request's frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It came back.
    Processed {
        /// How many reads and writes the slaves counted.
        working_counter: u16,
    },
    /// It did not come back within its cycle; whether slaves saw it is unknown.
    Lost,
}

/// The answer to a [`Request`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply {
    /// The datagram's data when it came back; empty when it was lost.
    pub data: Bytes,
    /// What became of it.
    pub outcome: Outcome,
}

/// The slow side's access to the slaves' registers, and its clock.
pub struct AcyclicPort<'a> {
    pub(super) requests: Producer<'a, Request>,
    pub(super) replies: Consumer<'a, Reply>,
    polls: u32,
}

impl<'a> AcyclicPort<'a> {
    /// A port over the slow ends of the two queues.
    pub const fn new(requests: Producer<'a, Request>, replies: Consumer<'a, Reply>) -> Self {
        Self {
            requests,
            replies,
            polls: 0,
        }
    }

    /// Milliseconds that this side has waited so far, wrapping.
    pub const fn now_ms(&self) -> u32 {
        self.polls
    }

    /// Lets `duration_ms` polls pass.
    pub async fn wait_ms(&mut self, duration_ms: u32) {
        let mut left = duration_ms;
        poll_fn(|_| {
            if left == 0 {
                return Poll::Ready(());
            }
            left -= 1;
            self.polls = self.polls.wrapping_add(1);
            Poll::Pending
        })
        .await;
    }

    /// Sends one datagram and waits for what becomes of it.
    pub async fn transact(&mut self, request: Request) -> Reply {
        let mut waiting = Some(request);
        poll_fn(|_| {
            if let Some(request) = waiting.take() {
                waiting = self.requests.enqueue(request).err();
            } else if let Some(reply) = self.replies.dequeue() {
                return Poll::Ready(reply);
            }
            self.polls = self.polls.wrapping_add(1);
            Poll::Pending
        })
        .await
    }

    /// Sends `request` until it comes back with the working counter `expected`.
    ///
    /// Only for datagrams that may be executed more than once.
    ///
    /// # Errors
    /// [`BusError::Lost`] or [`BusError::WorkingCounter`] after [`TRIES_MAX`] tries.
    pub async fn insist(&mut self, request: &Request, expected: u16) -> Result<Bytes, BusError> {
        let mut error = BusError::Lost { tries: TRIES_MAX };
        for _ in 0..TRIES_MAX {
            let reply = self.transact(request.clone()).await;
            match reply.outcome {
                Outcome::Processed { working_counter } if working_counter == expected => return Ok(reply.data),
                Outcome::Processed { working_counter } => {
                    error = BusError::WorkingCounter {
                        expected,
                        actual: working_counter,
                    };
                }
                Outcome::Lost => {}
            }
        }
        Err(error)
    }

    /// Reads `length` bytes (at most [`ACYCLIC_BYTES_MAX`]) of one slave's memory.
    ///
    /// # Errors
    /// As [`Self::insist`].
    pub async fn read(&mut self, station: u16, register: u16, length: usize) -> Result<Bytes, BusError> {
        let request = Request {
            command: Command::Fprd,
            address: Address::station(station, register),
            data: zeros(length),
        };
        self.insist(&request, 1).await
    }

    /// Reads a 16-bit register of one slave.
    ///
    /// # Errors
    /// As [`Self::insist`].
    pub async fn read_u16(&mut self, station: u16, register: u16) -> Result<u16, BusError> {
        let bytes = self.read(station, register, 2).await?;
        Ok(super::wire::read_u16(&bytes, 0))
    }

    /// Writes one slave's memory; `data` beyond [`ACYCLIC_BYTES_MAX`] are cut off.
    ///
    /// # Errors
    /// As [`Self::insist`].
    pub async fn write(&mut self, station: u16, register: u16, data: &[u8]) -> Result<(), BusError> {
        let request = Request {
            command: Command::Fpwr,
            address: Address::station(station, register),
            data: bytes(data),
        };
        self.insist(&request, 1).await.map(|_| ())
    }

    /// Writes the same register of all slaves and gives how many took it.
    ///
    /// # Errors
    /// [`BusError::Lost`] after [`TRIES_MAX`] tries.
    pub async fn broadcast_write(&mut self, register: u16, data: &[u8]) -> Result<u16, BusError> {
        let request = Request {
            command: Command::Bwr,
            address: Address::broadcast(register),
            data: bytes(data),
        };
        self.answered(&request).await.map(|(_, slaves)| slaves)
    }

    /// Reads the same register of all slaves: the values OR-ed together, and how many slaves gave one.
    ///
    /// # Errors
    /// [`BusError::Lost`] after [`TRIES_MAX`] tries.
    pub async fn broadcast_read_u16(&mut self, register: u16) -> Result<(u16, u16), BusError> {
        let request = Request {
            command: Command::Brd,
            address: Address::broadcast(register),
            data: zeros(2),
        };
        let (bytes, slaves) = self.answered(&request).await?;
        Ok((super::wire::read_u16(&bytes, 0), slaves))
    }

    /// Sends `request` until it comes back, with whatever working counter.
    ///
    /// # Errors
    /// [`BusError::Lost`] after [`TRIES_MAX`] tries.
    pub async fn answered(&mut self, request: &Request) -> Result<(Bytes, u16), BusError> {
        for _ in 0..TRIES_MAX {
            let reply = self.transact(request.clone()).await;
            if let Outcome::Processed { working_counter } = reply.outcome {
                return Ok((reply.data, working_counter));
            }
        }
        Err(BusError::Lost { tries: TRIES_MAX })
    }
}

/// `length` zeros, at most [`ACYCLIC_BYTES_MAX`].
pub(crate) fn zeros(length: usize) -> Bytes {
    let mut data = Bytes::new();
    // The length asked for never exceeds the capacity.
    let _ = data.resize(length.min(ACYCLIC_BYTES_MAX), 0);
    data
}

/// A copy of `data`, at most [`ACYCLIC_BYTES_MAX`].
pub(crate) fn bytes(data: &[u8]) -> Bytes {
    Bytes::from_slice(data.get(..data.len().min(ACYCLIC_BYTES_MAX)).unwrap_or(&[])).unwrap_or_default()
}
