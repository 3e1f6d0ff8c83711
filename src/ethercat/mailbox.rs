//! Messages to and from one slave through its mailbox.
//!
//! The master writes the whole window of sync manager 0 and reads the whole window of sync manager 1. Frames get lost
//! on the way, and neither side may execute or miss a message because of that: an unanswered write is looked after
//! before it is repeated with the same counter, and a lost answer is fetched again through the repeat bit of sync
//! manager 1 (IEC 61158-4-12, mailbox).
//!
//! Invariant: a request is handed to the slave's application once; waiting always ends.

use super::acyclic::{AcyclicPort, Bytes, Outcome, Reply, Request, bytes, no_room, zeros};
use super::error::BusError;
use super::wire::coe::{Emergency, Service};
use super::wire::mailbox::{self, MAILBOX_HEADER_LEN, MailboxRepr, Protocol};
use super::wire::sii::MailboxWindow;
use super::wire::{Address, Command, read_u8, register, write_bytes};

/// Longest wait for a slave to take or give a message, ms.
pub const MAILBOX_TIMEOUT_MS: u32 = 1_000;
/// How long an answer is waited for when the fate of the request is unknown, ms.
const UNKNOWN_FATE_MS: u32 = 20;
/// Most messages thrown away before a request.
const DRAIN_MAX: usize = 8;

/// One slave's mailbox.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mailbox {
    station: u16,
    out: MailboxWindow,
    input: MailboxWindow,
    counter: u8,
    emergency: Option<Emergency>,
}

impl Mailbox {
    /// A mailbox with the windows of the slave's SII, over a port whose datagrams carry up to `MESSAGE` bytes.
    ///
    /// # Errors
    /// [`BusError::MailboxLength`] when there is none or a window is longer than one datagram may carry.
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
            counter: 0,
            emergency: None,
        })
    }

    /// Bytes of service data that one message may hold.
    pub fn capacity(&self) -> usize {
        usize::from(self.out.length) - MAILBOX_HEADER_LEN
    }

    /// The last emergency that came between other messages; it is handed out once.
    pub fn take_emergency(&mut self) -> Option<Emergency> {
        self.emergency.take()
    }

    /// Throws away what the slave still has to say from before; emergencies are kept.
    ///
    /// # Errors
    /// As [`AcyclicPort::insist`].
    pub async fn drain<const MESSAGE: usize>(&mut self, port: &mut AcyclicPort<'_, MESSAGE>) -> Result<(), BusError> {
        for _ in 0..DRAIN_MAX {
            if !self.is_full(port, 1).await? {
                break;
            }
            let message = self.fetch(port).await?;
            // Whatever it is, nobody waits for it any more.
            let _ = self.dispatch(Protocol::Coe, &message);
        }
        Ok(())
    }

    /// Sends `request` as service data of `protocol` and gives the service data of the answer, which `accept` has to
    /// recognise; messages of other kinds that come in between are dispatched.
    ///
    /// # Errors
    /// [`BusError::MailboxTimeout`], [`BusError::Mailbox`], [`BusError::MailboxLength`], or as
    /// [`AcyclicPort::insist`].
    pub async fn exchange<const MESSAGE: usize>(
        &mut self,
        port: &mut AcyclicPort<'_, MESSAGE>,
        protocol: Protocol,
        request: &[u8],
        accept: impl Fn(&[u8]) -> bool,
    ) -> Result<Bytes<MESSAGE>, BusError> {
        self.drain(port).await?;
        self.send(port, protocol, request).await?;
        let started_ms = port.now_ms();
        loop {
            if self.is_full(port, 1).await? {
                let message = self.fetch(port).await?;
                match self.dispatch(protocol, &message)? {
                    Some(data) if accept(data) => return Ok(bytes(data)),
                    _ => {}
                }
            }
            let waited_ms = port.now_ms().wrapping_sub(started_ms);
            if waited_ms > MAILBOX_TIMEOUT_MS {
                return Err(BusError::MailboxTimeout { waited_ms });
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

    async fn send<const MESSAGE: usize>(
        &mut self,
        port: &mut AcyclicPort<'_, MESSAGE>,
        protocol: Protocol,
        request: &[u8],
    ) -> Result<(), BusError> {
        if request.len() > self.capacity() {
            return Err(BusError::MailboxLength {
                expected: self.capacity() as u16,
                actual: request.len() as u16,
            });
        }
        self.counter = mailbox::next_counter(self.counter);
        let header = MailboxRepr {
            length: request.len() as u16,
            address: 0,
            priority: 0,
            protocol,
            counter: self.counter,
        };
        let write = || {
            let mut data = zeros(usize::from(self.out.length));
            // Header and request fit the window, which was checked above.
            let _ = header.emit(&mut data);
            write_bytes(&mut data, MAILBOX_HEADER_LEN, request);
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
                // Full: the slave has not taken the message before.
                Outcome::Processed { working_counter: 0 } => {}
                Outcome::NoRoom { room } => return Err(no_room(self.out.length.into(), room)),
                Outcome::Processed { .. } | Outcome::Lost => {
                    if self.is_full(port, 0).await? || self.answer_comes(port).await? {
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

    /// Waits a moment for an answer to a request of unknown fate.
    async fn answer_comes<const MESSAGE: usize>(&self, port: &mut AcyclicPort<'_, MESSAGE>) -> Result<bool, BusError> {
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
        &self,
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
                } => return Ok(data),
                Reply {
                    outcome: Outcome::NoRoom { room },
                    ..
                } => return Err(no_room(length, room)),
                _ => {}
            }
            // The message may have left the mailbox on a frame that was lost or damaged.
            if !self.is_full(port, 1).await? {
                self.ask_again(port).await?;
            }
        }
        Err(BusError::Lost {
            tries: super::acyclic::TRIES_MAX,
        })
    }

    /// Toggles the repeat bit and waits until the slave has put its last message into the mailbox again.
    async fn ask_again<const MESSAGE: usize>(&self, port: &mut AcyclicPort<'_, MESSAGE>) -> Result<(), BusError> {
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
            if waited_ms > MAILBOX_TIMEOUT_MS {
                return Err(BusError::MailboxTimeout { waited_ms });
            }
        }
    }

    /// The service data of a message of `protocol`; `None` for messages of other kinds.
    fn dispatch<'m>(&mut self, protocol: Protocol, message: &'m [u8]) -> Result<Option<&'m [u8]>, BusError> {
        let (Ok(header), Ok(data)) = (MailboxRepr::parse(message), mailbox::service_data(message)) else {
            return Ok(None);
        };
        if header.protocol == Protocol::Error {
            return Err(BusError::Mailbox {
                detail: mailbox::ErrorReply::parse(data).map_or(0, |reply| reply.detail),
            });
        }
        if header.protocol == Protocol::Coe && Service::parse(data) == Ok(Service::Emergency) {
            self.emergency = Emergency::parse(data).ok().or(self.emergency);
            return Ok(None);
        }
        Ok((header.protocol == protocol).then_some(data))
    }
}
