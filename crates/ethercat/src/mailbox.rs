//! Mailbox communication with one slave.
//!
//! The master writes the whole window of sync manager 0 and reads the whole window of sync manager 1. Frames may be
//! lost, and then neither side may execute a message twice or miss one. The master checks an unanswered write before it
//! repeats the message with the same counter, and fetches a lost answer again through the repeat bit of sync manager 1
//! (IEC 61158-4-12, mailbox).
//!
//! Emergencies may come at any time; they are kept in [`Emergencies`] until they are taken.
//!
//! Invariant: a request is passed to the slave's application once; every wait ends.

use super::acyclic::{AcyclicPort, Bytes, Outcome, Reply, Request, no_room, zeros};
use super::error::BusError;
use super::wire::coe::{Emergency, Service};
use super::wire::mailbox::{self, MAILBOX_HEADER_LEN, MailboxRepr, Protocol};
use super::wire::sii::MailboxWindow;
use super::wire::{Address, Command, read_u8, register};

/// Longest wait for a slave to accept or send a message, ms.
pub const MAILBOX_TIMEOUT_MS: u32 = 1_000;
/// Most emergencies kept.
pub const EMERGENCIES_MAX: usize = 4;
/// Longest wait for an answer when it is unknown whether the request arrived, ms.
const UNKNOWN_FATE_MS: u32 = 20;
/// Wait for an answer after which the slave is asked to repeat its last message, ms.
const REPEAT_AFTER_MS: u32 = 500;
/// Longest wait for that repetition, ms.
const REPEAT_WAIT_MS: u32 = 100;
/// Most messages discarded before a request.
const DRAIN_MAX: usize = 8;

/// Emergencies of one slave that were not taken yet, oldest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Emergencies {
    places: [Emergency; EMERGENCIES_MAX],
    first: u8,
    count: u8,
    dropped: u16,
}

impl Emergencies {
    /// Appends an emergency; if there is no room the oldest is dropped and counted.
    fn push(&mut self, emergency: Emergency) {
        if usize::from(self.count) == EMERGENCIES_MAX {
            self.pop();
            self.dropped = self.dropped.saturating_add(1);
        }
        let place = usize::from(self.first + self.count) % EMERGENCIES_MAX;
        if let Some(place) = self.places.get_mut(place) {
            *place = emergency;
            self.count += 1;
        }
    }

    /// Takes the oldest emergency.
    fn pop(&mut self) -> Option<Emergency> {
        self.count = self.count.checked_sub(1)?;
        let oldest = self.places.get(usize::from(self.first)).copied();
        self.first = (self.first + 1) % EMERGENCIES_MAX as u8;
        oldest
    }
}

const _: () = assert!(EMERGENCIES_MAX <= 64, "places are counted in eight bits");

/// One slave's mailbox.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mailbox {
    station: u16,
    out: MailboxWindow,
    input: MailboxWindow,
    counter: u8,
    /// Counter of the slave's last message; 0 if the slave does not count.
    received: Option<u8>,
    unexpected: u16,
    /// Whether the last exchange ended with its answer: a stale message cannot be mistaken for the next answer.
    settled: bool,
    emergencies: Emergencies,
}

impl Mailbox {
    /// A mailbox with the windows from the slave's SII, over a port whose datagrams carry up to `MESSAGE` bytes.
    ///
    /// # Errors
    /// [`BusError::MailboxLength`] when there is no mailbox or a window is longer than one datagram may carry.
    pub fn new<const MESSAGE: usize>(station: u16, out: MailboxWindow, input: MailboxWindow) -> Result<Self, BusError> {
        for window in [out, input] {
            let length = usize::from(window.length);
            if length <= MAILBOX_HEADER_LEN || length > MESSAGE {
                return Err(BusError::MailboxLength {
                    expected: MESSAGE as u16,
                    actual: window.length,
                });
            }
        }
        Ok(Self {
            station,
            out,
            input,
            ..Self::default()
        })
    }

    /// Bytes of service data that one message may hold.
    pub fn capacity(&self) -> usize {
        usize::from(self.out.length).saturating_sub(MAILBOX_HEADER_LEN)
    }

    /// Length of the mailbox that the slave writes, bytes.
    pub const fn input_length(&self) -> u16 {
        self.input.length
    }

    /// The oldest emergency that was not taken yet; each is returned once.
    pub fn take_emergency(&mut self) -> Option<Emergency> {
        self.emergencies.pop()
    }

    /// Number of emergencies dropped in favour of newer ones.
    pub const fn emergencies_dropped(&self) -> u16 {
        self.emergencies.dropped
    }

    /// Number of messages received without a request, besides emergencies.
    pub const fn unexpected(&self) -> u16 {
        self.unexpected
    }

    /// Discards old messages of the slave; emergencies are kept.
    ///
    /// # Errors
    /// As [`AcyclicPort::send_until_counted`].
    pub async fn drain<const MESSAGE: usize>(&mut self, port: &mut AcyclicPort<'_, MESSAGE>) -> Result<(), BusError> {
        for _ in 0..DRAIN_MAX {
            if self.input.length == 0 || !self.is_full(port, 1).await? {
                break;
            }
            let message = self.fetch(port).await?;
            // No request waits for this message.
            if !matches!(self.dispatch(Protocol::Coe, &message), Ok(None)) {
                self.unexpected = self.unexpected.saturating_add(1);
            }
        }
        Ok(())
    }

    /// Sends a request and returns the service data of its answer; see [`Self::send`] and [`Self::receive`].
    ///
    /// # Errors
    /// [`BusError::MailboxLength`] for a slave without a mailbox; errors of [`Self::send`] and [`Self::receive`].
    pub async fn exchange<const MESSAGE: usize>(
        &mut self,
        port: &mut AcyclicPort<'_, MESSAGE>,
        protocol: Protocol,
        length: usize,
        emit: impl Fn(&mut [u8]),
        accept: impl Fn(&[u8]) -> bool,
    ) -> Result<Bytes<MESSAGE>, BusError> {
        if self.out.length == 0 {
            // A slave without a mailbox.
            let (expected, actual) = (MESSAGE as u16, 0);
            return Err(BusError::MailboxLength { expected, actual });
        }
        if !self.settled {
            self.drain(port).await?;
        }
        self.settled = false;
        self.send(port, protocol, length, emit).await?;
        let answer = self.receive(port, protocol, accept).await?;
        self.settled = true;
        Ok(answer)
    }

    /// Waits for a message of `protocol` whose service data `accept` recognises, and returns these data; messages of
    /// other kinds that arrive meanwhile are dispatched.
    ///
    /// # Errors
    /// [`BusError::MailboxTimeout`], [`BusError::Mailbox`], or as [`AcyclicPort::send_until_counted`].
    pub async fn receive<const MESSAGE: usize>(
        &mut self,
        port: &mut AcyclicPort<'_, MESSAGE>,
        protocol: Protocol,
        accept: impl Fn(&[u8]) -> bool,
    ) -> Result<Bytes<MESSAGE>, BusError> {
        self.receive_within(port, protocol, MAILBOX_TIMEOUT_MS, accept).await
    }

    /// Waits at most `limit_ms` for a message that [`Self::receive`] would return.
    ///
    /// # Errors
    /// As [`Self::receive`].
    pub async fn receive_within<const MESSAGE: usize>(
        &mut self,
        port: &mut AcyclicPort<'_, MESSAGE>,
        protocol: Protocol,
        limit_ms: u32,
        accept: impl Fn(&[u8]) -> bool,
    ) -> Result<Bytes<MESSAGE>, BusError> {
        let started_ms = port.now_ms();
        let mut repeated = false;
        loop {
            if self.is_full(port, 1).await? {
                let before = self.received;
                let mut message = self.fetch(port).await?;
                // A repetition may bring the message that came before the request.
                let is_stale = repeated && self.received == before;
                let answer = if is_stale {
                    None
                } else {
                    self.dispatch(protocol, &message)?
                };
                match answer {
                    Some(data) if accept(data) => {
                        let length = data.len();
                        strip_header(&mut message, length);
                        return Ok(message);
                    }
                    Some(_) => self.unexpected = self.unexpected.saturating_add(1),
                    None => self.unexpected = self.unexpected.saturating_add(u16::from(is_stale)),
                }
            }
            let waited_ms = port.now_ms().wrapping_sub(started_ms);
            if waited_ms > limit_ms {
                return Err(BusError::MailboxTimeout { waited_ms });
            }
            // If the slave does not count, a repeated message could not be distinguished from a new one.
            if !repeated && waited_ms > REPEAT_AFTER_MS && self.received != Some(0) {
                repeated = true;
                match self.ask_again(port, REPEAT_WAIT_MS).await {
                    // Nothing to repeat: the answer may still come.
                    Ok(()) | Err(BusError::MailboxTimeout { .. }) => {}
                    Err(error) => return Err(error),
                }
            }
        }
    }

    /// Whether the mailbox of sync manager `manager` is full.
    async fn is_full<const MESSAGE: usize>(
        &self,
        port: &mut AcyclicPort<'_, MESSAGE>,
        manager: u8,
    ) -> Result<bool, BusError> {
        let status = register::sync_manager(manager) + register::SYNC_MANAGER_STATUS_OFFSET;
        let byte = port.read(self.station, status, 1).await?;
        Ok(read_u8(&byte, 0) & register::MAILBOX_FULL_BIT != 0)
    }

    /// Sends `length` bytes of service data written by `emit`, as soon as the slave has taken the previous message.
    ///
    /// # Errors
    /// [`BusError::MailboxTimeout`], [`BusError::MailboxLength`], [`BusError::NoRoom`], or as [`AcyclicPort::send_until_counted`].
    pub async fn send<const MESSAGE: usize>(
        &mut self,
        port: &mut AcyclicPort<'_, MESSAGE>,
        protocol: Protocol,
        length: usize,
        emit: impl Fn(&mut [u8]),
    ) -> Result<(), BusError> {
        if length > self.capacity() {
            return Err(BusError::MailboxLength {
                expected: self.capacity() as u16,
                actual: u16::try_from(length).unwrap_or(u16::MAX),
            });
        }
        self.counter = mailbox::next_counter(self.counter);
        let header = MailboxRepr {
            length: length as u16,
            address: 0,
            priority: 0,
            protocol,
            counter: self.counter,
        };
        let write = || {
            let mut data = zeros(usize::from(self.out.length));
            // Header and service data fit the window, which was checked above.
            let _ = header.emit(&mut data);
            if let Some(service_data) = data.get_mut(MAILBOX_HEADER_LEN..MAILBOX_HEADER_LEN + length) {
                emit(service_data);
            }
            Request {
                command: Command::Fpwr,
                address: Address::station(self.station, self.out.start),
                data,
            }
        };
        let started_ms = port.now_ms();
        loop {
            match port.transact_message(write).await.outcome {
                Outcome::Processed { working_counter: 1 } => return Ok(()),
                // Full: the slave has not taken the previous message.
                Outcome::Processed { working_counter: 0 } => {}
                Outcome::NoRoom { room } => return Err(no_room(self.out.length.into(), room)),
                Outcome::Processed { .. } | Outcome::Lost => {
                    if self.is_full(port, 0).await? || self.await_answer(port).await? {
                        return Ok(());
                    }
                }
            }
            let waited_ms = port.now_ms().wrapping_sub(started_ms);
            if waited_ms > MAILBOX_TIMEOUT_MS {
                return Err(BusError::MailboxTimeout { waited_ms });
            }
        }
    }

    /// Waits briefly for the answer to a request that may not have arrived.
    async fn await_answer<const MESSAGE: usize>(&self, port: &mut AcyclicPort<'_, MESSAGE>) -> Result<bool, BusError> {
        let started_ms = port.now_ms();
        while port.now_ms().wrapping_sub(started_ms) < UNKNOWN_FATE_MS {
            if self.is_full(port, 1).await? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Reads a full mailbox. A lost answer is fetched again.
    async fn fetch<const MESSAGE: usize>(
        &mut self,
        port: &mut AcyclicPort<'_, MESSAGE>,
    ) -> Result<Bytes<MESSAGE>, BusError> {
        let window = Address::station(self.station, self.input.start);
        let length = usize::from(self.input.length);
        for _ in 0..super::acyclic::TRIES_MAX {
            let read = || Request::read(Command::Fprd, window, length);
            match port.transact_message(read).await {
                Reply {
                    data,
                    outcome: Outcome::Processed { working_counter: 1 },
                } => {
                    self.received = MailboxRepr::parse(&data).ok().map(|header| header.counter);
                    return Ok(data);
                }
                Reply {
                    outcome: Outcome::NoRoom { room },
                    ..
                } => return Err(no_room(length, room)),
                _ => {}
            }
            // The message may have left the mailbox on a frame that was lost or damaged.
            if !self.is_full(port, 1).await? {
                self.ask_again(port, MAILBOX_TIMEOUT_MS).await?;
            }
        }
        Err(BusError::Lost {
            tries: super::acyclic::TRIES_MAX,
        })
    }

    /// Toggles the repeat bit and waits until the slave has put its last message into the mailbox again.
    async fn ask_again<const MESSAGE: usize>(
        &self,
        port: &mut AcyclicPort<'_, MESSAGE>,
        limit_ms: u32,
    ) -> Result<(), BusError> {
        let manager = register::sync_manager(1);
        let activate = manager + register::SYNC_MANAGER_ACTIVATE_OFFSET;
        let wanted = read_u8(&port.read(self.station, activate, 1).await?, 0) ^ register::SYNC_MANAGER_REPEAT;
        port.write(self.station, activate, &[wanted]).await?;
        let started_ms = port.now_ms();
        loop {
            let answer = port
                .read(self.station, manager + register::SYNC_MANAGER_PDI_OFFSET, 1)
                .await?;
            if (read_u8(&answer, 0) ^ wanted) & register::SYNC_MANAGER_REPEAT == 0 && self.is_full(port, 1).await? {
                return Ok(());
            }
            let waited_ms = port.now_ms().wrapping_sub(started_ms);
            if waited_ms > limit_ms {
                return Err(BusError::MailboxTimeout { waited_ms });
            }
        }
    }

    /// The service data of a message of `protocol`; `None` for other messages. Emergencies among them are kept, the
    /// rest is counted.
    fn dispatch<'m>(&mut self, protocol: Protocol, message: &'m [u8]) -> Result<Option<&'m [u8]>, BusError> {
        let (header, data) = match (MailboxRepr::parse(message), mailbox::service_data(message)) {
            (Ok(header), Ok(data)) => (header, data),
            _ => {
                self.unexpected = self.unexpected.saturating_add(1);
                return Ok(None);
            }
        };
        // A slave without a last message repeats an empty one; that is not an error.
        if header.protocol == Protocol::Error && !data.is_empty() {
            return Err(BusError::Mailbox {
                detail: mailbox::ErrorReply::parse(data).map_or(0, |reply| reply.detail),
            });
        }
        if header.protocol == Protocol::Coe && Service::parse(data) == Ok(Service::Emergency) {
            if let Ok(emergency) = Emergency::parse(data) {
                self.emergencies.push(emergency);
            }
            return Ok(None);
        }
        if header.protocol != protocol {
            self.unexpected = self.unexpected.saturating_add(1);
            return Ok(None);
        }
        Ok(Some(data))
    }
}

/// Reduces a message to its `length` bytes of service data.
fn strip_header<const MESSAGE: usize>(message: &mut Bytes<MESSAGE>, length: usize) {
    let end = MAILBOX_HEADER_LEN + length;
    if end <= message.len() {
        message.copy_within(MAILBOX_HEADER_LEN..end, 0);
        message.truncate(length);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_emergency_gives_way_and_is_counted() {
        let emergency = |code| Emergency {
            code,
            ..Emergency::default()
        };
        let mut mailbox = Mailbox::default();
        assert_eq!(mailbox.take_emergency(), None);
        for code in 1..=6 {
            mailbox.emergencies.push(emergency(code));
        }
        assert_eq!(mailbox.emergencies_dropped(), 2);
        for code in 3..=6 {
            assert_eq!(mailbox.take_emergency(), Some(emergency(code)));
        }
        assert_eq!(mailbox.take_emergency(), None);
        mailbox.emergencies.push(emergency(7));
        assert_eq!(mailbox.take_emergency(), Some(emergency(7)));
    }

    #[test]
    fn every_message_is_dispatched_by_its_kind_whatever_its_bytes_are() {
        let mut mailbox = Mailbox::default();
        let mut message = [0xAA; 24];
        let mut dispatch = |length: u16, protocol: Protocol, service: u8| {
            let header = MailboxRepr {
                length,
                address: 0,
                priority: 0,
                protocol,
                counter: 1,
            };
            header.emit(&mut message).unwrap();
            message[7] = service << 4;
            let given = mailbox.dispatch(Protocol::Coe, &message);
            (given.map(|data| data.map(<[u8]>::len)), mailbox.unexpected())
        };
        assert_eq!(dispatch(10, Protocol::Coe, 3), (Ok(Some(10)), 0));
        assert_eq!(dispatch(10, Protocol::Coe, 1), (Ok(None), 0), "an emergency");
        assert_eq!(dispatch(4, Protocol::Coe, 1), (Ok(None), 0), "one that is cut");
        assert_eq!(dispatch(10, Protocol::Foe, 3), (Ok(None), 1));
        assert_eq!(dispatch(19, Protocol::Coe, 3), (Ok(None), 2), "longer than the mailbox");
        let refused = BusError::Mailbox { detail: 0xAAAA };
        assert_eq!(dispatch(10, Protocol::Error, 0), (Err(refused), 2));
        assert_eq!(
            dispatch(3, Protocol::Error, 0),
            (Err(BusError::Mailbox { detail: 0 }), 2)
        );
        assert!(mailbox.take_emergency().is_some() && mailbox.take_emergency().is_none());
    }
}
