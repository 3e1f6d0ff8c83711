//! Acyclic requests: datagrams of the slow side in the free space of the cyclic frames.
//!
//! The slow side never accesses the network. It queues a [`Request`], and the critical side's
//! [`Exchange`](super::cyclic::Exchange) puts it behind the cyclic datagrams of its next input telegram. There are two
//! lanes: short requests for registers, several of which share a frame, and messages as long as a mailbox, at most one
//! in a frame. Every request gets exactly one [`Reply`], in the order of its lane, at most one cycle after it was sent;
//! the reply also reports a lost frame.
//!
//! Invariant: a pending future of this module is polled again every millisecond or so; no waker is ever registered. Without a
//! clock of the application, time is the number of polls.

use super::error::BusError;
use super::wire::{Address, Command};
use core::future::poll_fn;
use core::task::Poll;
use heapless::Vec;
use heapless::spsc::{Consumer, Producer};

/// Longest data of a register request, bytes: four FMMUs, or eight sync managers.
pub const REGISTER_BYTES_MAX: usize = 64;
/// Most register requests in one frame, and most in flight.
pub const IN_FLIGHT_MAX: usize = 8;
/// Most repetitions of a harmless datagram after a loss or a wrong working counter.
pub const TRIES_MAX: u8 = 8;
/// Most requests of one [`AcyclicPort::send_all_until_counted`].
pub const INSIST_MAX: usize = 32;

/// Data of an acyclic datagram.
pub type Bytes<const LENGTH: usize = REGISTER_BYTES_MAX> = Vec<u8, LENGTH>;

/// One datagram to be sent as soon as the frame has room.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request<const LENGTH: usize = REGISTER_BYTES_MAX> {
    /// The datagram's command.
    pub command: Command,
    /// Slave and register.
    pub address: Address,
    /// Data to write, or zeros to be replaced by the data read.
    pub data: Bytes<LENGTH>,
}

impl<const LENGTH: usize> Request<LENGTH> {
    /// Reads `length` bytes, at most `LENGTH`.
    pub fn read(command: Command, address: Address, length: usize) -> Self {
        Self {
            command,
            address,
            data: zeros(length),
        }
    }

    /// Writes `data`, truncated to `LENGTH` bytes.
    pub fn write(command: Command, address: Address, data: &[u8]) -> Self {
        Self {
            command,
            address,
            data: bytes(data),
        }
    }
}

/// Result of a request's frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The frame came back.
    Processed {
        /// Working counter: the reads and writes that the slaves counted.
        working_counter: u16,
    },
    /// The frame did not come back within its cycle; slaves may or may not have seen it.
    Lost,
    /// The datagram was not sent: the cyclic datagrams leave too little room.
    NoRoom {
        /// Longest data that would fit, bytes.
        room: u16,
    },
}

/// The answer to a [`Request`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply<const LENGTH: usize = REGISTER_BYTES_MAX> {
    /// The datagram's data when it came back; empty otherwise.
    pub data: Bytes<LENGTH>,
    /// Result of the request.
    pub outcome: Outcome,
}

impl<const LENGTH: usize> Reply<LENGTH> {
    /// The reply to a request that did not come back.
    pub const fn without_data(outcome: Outcome) -> Self {
        Self {
            data: Bytes::new(),
            outcome,
        }
    }
}

/// The slow side's end of one lane, with the number of replies still expected.
pub(super) struct Lane<'a, const LENGTH: usize> {
    pub(super) requests: Producer<'a, Request<LENGTH>>,
    pub(super) replies: Consumer<'a, Reply<LENGTH>>,
    owed: usize,
}

impl<'a, const LENGTH: usize> Lane<'a, LENGTH> {
    pub(super) const fn new(requests: Producer<'a, Request<LENGTH>>, replies: Consumer<'a, Reply<LENGTH>>) -> Self {
        Self {
            requests,
            replies,
            owed: 0,
        }
    }

    /// Queues a request if there is room.
    fn send(&mut self, build: impl FnOnce() -> Request<LENGTH>) -> bool {
        let sent = self.requests.ready() && self.requests.enqueue(build()).is_ok();
        self.owed += usize::from(sent);
        sent
    }

    /// Takes the next reply and leaves `later` replies for the requests behind it. Skips replies to callers whose
    /// futures were dropped.
    fn take(&mut self, later: usize) -> Option<Reply<LENGTH>> {
        while let Some(reply) = self.replies.dequeue() {
            let abandoned = self.owed > later;
            self.owed = self.owed.saturating_sub(1);
            if !abandoned {
                return Some(reply);
            }
        }
        None
    }
}

/// The slow side's access to the slaves' registers and mailboxes, and its time base.
pub struct AcyclicPort<'a, const MESSAGE: usize> {
    pub(super) registers: Lane<'a, REGISTER_BYTES_MAX>,
    pub(super) messages: Lane<'a, MESSAGE>,
    polls: u32,
    /// The application's clock, ms.
    #[cfg(feature = "clock")]
    clock: Option<fn() -> u32>,
}

impl<'a, const MESSAGE: usize> AcyclicPort<'a, MESSAGE> {
    /// A port over the slow ends of the two lanes.
    pub(super) const fn new(registers: Lane<'a, REGISTER_BYTES_MAX>, messages: Lane<'a, MESSAGE>) -> Self {
        Self {
            registers,
            messages,
            polls: 0,
            #[cfg(feature = "clock")]
            clock: None,
        }
    }

    /// Takes the time from a clock of the application: milliseconds, wrapping. Without one a poll counts as a millisecond.
    #[cfg(feature = "clock")]
    pub(super) const fn set_clock(&mut self, now_ms: fn() -> u32) {
        self.clock = Some(now_ms);
    }

    /// Milliseconds of the application's clock, wrapping; without one, the number of polls so far.
    pub fn now_ms(&self) -> u32 {
        #[cfg(feature = "clock")]
        if let Some(now_ms) = self.clock {
            return now_ms();
        }
        self.polls
    }

    /// Waits for so many milliseconds, and as many polls at least.
    pub async fn wait_ms(&mut self, duration_ms: u32) {
        let (begun_ms, mut left) = (self.now_ms(), duration_ms);
        poll_fn(|_| {
            if left == 0 && self.now_ms().wrapping_sub(begun_ms) >= duration_ms {
                return Poll::Ready(());
            }
            left = left.saturating_sub(1);
            self.pending()
        })
        .await;
    }

    fn pending<T>(&mut self) -> Poll<T> {
        self.polls = self.polls.wrapping_add(1);
        Poll::Pending
    }

    /// Sends one datagram and waits for its reply.
    pub async fn transact(&mut self, request: &Request) -> Reply {
        let mut sent = false;
        poll_fn(|_| {
            if !sent {
                sent = self.registers.send(|| request.clone());
            } else if let Some(reply) = self.registers.take(1) {
                return Poll::Ready(reply);
            }
            self.pending()
        })
        .await
    }

    /// Sends one datagram that may be as long as a mailbox, and waits for its reply. `build` is called when there is
    /// room for it.
    pub async fn transact_message(&mut self, build: impl Fn() -> Request<MESSAGE>) -> Reply<MESSAGE> {
        let mut sent = false;
        poll_fn(|_| {
            if !sent {
                sent = self.messages.send(&build);
            } else if let Some(reply) = self.messages.take(1) {
                return Poll::Ready(reply);
            }
            self.pending()
        })
        .await
    }

    /// Sends several datagrams in as few frames as possible, and passes each reply to `take`, in order.
    ///
    /// No datagram may depend on the reply to another; the slaves execute them in order unless a frame is lost.
    pub async fn transact_all<'r>(&mut self, requests: impl Iterator<Item = &'r Request>, mut take: impl FnMut(Reply)) {
        let mut requests = requests.peekable();
        let (mut sent, mut received) = (0_usize, 0);
        poll_fn(|_| {
            while let Some(reply) = self.registers.take(sent - received) {
                received += 1;
                take(reply);
            }
            while let Some(request) = requests.peek() {
                if !self.registers.send(|| (*request).clone()) {
                    break;
                }
                sent += 1;
                requests.next();
            }
            if received == sent {
                return Poll::Ready(());
            }
            self.pending()
        })
        .await;
    }

    /// Sends `request` until it comes back with the working counter `expected`.
    ///
    /// Only for datagrams that may be executed more than once.
    ///
    /// # Errors
    /// [`BusError::Lost`] or [`BusError::WorkingCounter`] after [`TRIES_MAX`] tries, or [`BusError::NoRoom`].
    pub async fn send_until_counted(&mut self, request: &Request, expected: u16) -> Result<Bytes, BusError> {
        let mut error = BusError::Lost { tries: TRIES_MAX };
        for _ in 0..TRIES_MAX {
            let reply = self.transact(request).await;
            match verdict(&reply, request, expected) {
                Ok(()) => return Ok(reply.data),
                Err(BusError::Lost { .. }) => {}
                Err(no_room @ BusError::NoRoom { .. }) => return Err(no_room),
                Err(other) => error = other,
            }
        }
        Err(error)
    }

    /// Sends several datagrams in as few frames as possible, each until it comes back with the working counter
    /// `expected`, and passes each one's number and data to `take`. Requests beyond [`INSIST_MAX`] are not sent.
    ///
    /// Only for datagrams that may be executed more than once and in any order.
    ///
    /// # Errors
    /// As [`Self::send_until_counted`], for the last one that failed.
    pub async fn send_all_until_counted(
        &mut self,
        requests: &[Request],
        expected: u16,
        mut take: impl FnMut(usize, &[u8]),
    ) -> Result<(), BusError> {
        let requests = requests.get(..requests.len().min(INSIST_MAX)).unwrap_or(&[]);
        let mut done = 0_u32;
        let mut error = None;
        for _ in 0..TRIES_MAX {
            error = None;
            let finished = done;
            let open = || {
                requests
                    .iter()
                    .enumerate()
                    .filter(|(number, _)| finished >> number & 1 == 0)
            };
            let mut asked = open();
            self.transact_all(open().map(|(_, request)| request), |reply| {
                let Some((number, request)) = asked.next() else { return };
                match verdict(&reply, request, expected) {
                    Ok(()) => {
                        done |= 1 << number;
                        take(number, &reply.data);
                    }
                    Err(failed) => error = Some(failed),
                }
            })
            .await;
            if !matches!(error, Some(BusError::Lost { .. } | BusError::WorkingCounter { .. })) {
                break;
            }
        }
        error.map_or(Ok(()), Err)
    }

    /// Sends several datagrams in as few frames as possible until all have come back, with any working counters.
    ///
    /// Only for datagrams that may be executed more than once and in any order.
    ///
    /// # Errors
    /// [`BusError::Lost`] after [`TRIES_MAX`] tries, or [`BusError::NoRoom`].
    pub async fn send_all_until_answered(&mut self, requests: &[Request]) -> Result<(), BusError> {
        let longest = requests.iter().map(|request| request.data.len()).max().unwrap_or(0);
        for _ in 0..TRIES_MAX {
            let (mut is_lost, mut error) = (false, None);
            self.transact_all(requests.iter(), |reply| match reply.outcome {
                Outcome::Processed { .. } => {}
                Outcome::Lost => is_lost = true,
                Outcome::NoRoom { room } => error = Some(no_room(longest, room)),
            })
            .await;
            match error {
                Some(error) => return Err(error),
                None if !is_lost => return Ok(()),
                None => {}
            }
        }
        Err(BusError::Lost { tries: TRIES_MAX })
    }

    /// Reads `length` bytes (at most [`REGISTER_BYTES_MAX`]) of one slave's memory.
    ///
    /// # Errors
    /// As [`Self::send_until_counted`].
    pub async fn read(&mut self, station: u16, register: u16, length: usize) -> Result<Bytes, BusError> {
        let request = Request::read(Command::Fprd, Address::station(station, register), length);
        self.send_until_counted(&request, 1).await
    }

    /// Reads a 16-bit register of one slave.
    ///
    /// # Errors
    /// As [`Self::send_until_counted`].
    pub async fn read_u16(&mut self, station: u16, register: u16) -> Result<u16, BusError> {
        let bytes = self.read(station, register, 2).await?;
        Ok(super::wire::read_u16(&bytes, 0))
    }

    /// Writes one slave's memory; `data` is truncated to [`REGISTER_BYTES_MAX`] bytes.
    ///
    /// # Errors
    /// As [`Self::send_until_counted`].
    pub async fn write(&mut self, station: u16, register: u16, data: &[u8]) -> Result<(), BusError> {
        let request = Request::write(Command::Fpwr, Address::station(station, register), data);
        self.send_until_counted(&request, 1).await.map(|_| ())
    }

    /// Writes one register of all slaves; returns how many slaves executed it.
    ///
    /// # Errors
    /// As [`Self::answered`].
    pub async fn broadcast_write(&mut self, register: u16, data: &[u8]) -> Result<u16, BusError> {
        let request = Request::write(Command::Bwr, Address::broadcast(register), data);
        self.answered(&request).await.map(|(_, slaves)| slaves)
    }

    /// Reads one register of all slaves; returns the values OR-ed together and how many slaves answered.
    ///
    /// # Errors
    /// As [`Self::answered`].
    pub async fn broadcast_read_u16(&mut self, register: u16) -> Result<(u16, u16), BusError> {
        let request = Request::read(Command::Brd, Address::broadcast(register), 2);
        let (bytes, slaves) = self.answered(&request).await?;
        Ok((super::wire::read_u16(&bytes, 0), slaves))
    }

    /// Sends `request` until it comes back, with any working counter.
    ///
    /// # Errors
    /// [`BusError::Lost`] after [`TRIES_MAX`] tries, or [`BusError::NoRoom`].
    pub async fn answered(&mut self, request: &Request) -> Result<(Bytes, u16), BusError> {
        for _ in 0..TRIES_MAX {
            let reply = self.transact(request).await;
            match reply.outcome {
                Outcome::Processed { working_counter } => return Ok((reply.data, working_counter)),
                Outcome::NoRoom { room } => return Err(no_room(request.data.len(), room)),
                Outcome::Lost => {}
            }
        }
        Err(BusError::Lost { tries: TRIES_MAX })
    }

    /// Sends a request to one slave until it comes back with the working counter 1, at most [`TRIES_MAX`] times. `None` if it
    /// came back with 0 at least half of the times: the slave does not execute the request, or is not there.
    ///
    /// # Errors
    /// [`BusError::WorkingCounter`] if it came back with others: two slaves have the address, or frames were damaged; or as
    /// [`Self::answered`].
    pub async fn answered_by_one(&mut self, request: &Request) -> Result<Option<Bytes>, BusError> {
        let (mut actual, mut unanswered) = (0, 0);
        for _ in 0..TRIES_MAX {
            let (bytes, slaves) = self.answered(request).await?;
            match slaves {
                1 => return Ok(Some(bytes)),
                0 => unanswered += 1,
                _ => actual = slaves,
            }
        }
        match 2 * unanswered >= TRIES_MAX {
            true => Ok(None),
            false => Err(BusError::WorkingCounter { expected: 1, actual }),
        }
    }
}

/// Checks whether a request was executed as often as expected.
fn verdict(reply: &Reply, request: &Request, expected: u16) -> Result<(), BusError> {
    match reply.outcome {
        Outcome::Processed { working_counter } if working_counter == expected => Ok(()),
        Outcome::Processed { working_counter } => Err(BusError::WorkingCounter {
            expected,
            actual: working_counter,
        }),
        Outcome::Lost => Err(BusError::Lost { tries: TRIES_MAX }),
        Outcome::NoRoom { room } => Err(no_room(request.data.len(), room)),
    }
}

pub(super) fn no_room(needed: usize, room: u16) -> BusError {
    BusError::NoRoom {
        expected: needed as u16,
        actual: room,
    }
}

/// `length` zeros, at most `LENGTH`.
pub(crate) fn zeros<const LENGTH: usize>(length: usize) -> Bytes<LENGTH> {
    let mut data = Bytes::new();
    // The length requested never exceeds the capacity.
    let _ = data.resize(length.min(LENGTH), 0);
    data
}

/// A copy of `data`, truncated to `LENGTH` bytes.
pub(crate) fn bytes<const LENGTH: usize>(data: &[u8]) -> Bytes<LENGTH> {
    Bytes::from_slice(data.get(..data.len().min(LENGTH)).unwrap_or(&[])).unwrap_or_default()
}
