//! File access: reads and writes files of a slave through its mailbox.
//!
//! A file travels in packets that fill the mailbox; one that does not fill it is the last and may be empty. The other
//! side acknowledges every packet by its number. A slave that is not ready answers "busy", and gets the last message
//! again after a pause. Protocol: IEC 61158-6-12, FoE.
//!
//! A packet that comes again is skipped. A packet with a wrong number ends the transfer with an error to the slave, so
//! that both sides know.
//!
//! Invariant: an error of the slave reaches the caller with its code; every wait ends.

use super::acyclic::{AcyclicPort, Bytes};
use super::error::BusError;
use super::mailbox::Mailbox;
use super::wire::foe::{ERROR_ILLEGAL, ERROR_PACKET_NUMBER, FOE_HEADER_LEN, Foe};
use super::wire::mailbox::{MAILBOX_HEADER_LEN, Protocol};

/// Longest wait for an answer, ms: a slave may erase its memory before it answers.
pub const FILE_TIMEOUT_MS: u32 = 20_000;
/// Longest time in which a slave may answer "busy" without a break, ms.
pub const FILE_BUSY_MAX_MS: u32 = 60_000;
/// Pause before a message is sent again to a slave that was busy, ms.
const BUSY_PAUSE_MS: u32 = 10;

/// A file of one slave, reached through its mailbox.
pub struct FileAccess<'c, 'q, const MESSAGE: usize> {
    port: &'c mut AcyclicPort<'q, MESSAGE>,
    mailbox: &'c mut Mailbox,
}

impl<'c, 'q, const MESSAGE: usize> FileAccess<'c, 'q, MESSAGE> {
    /// The files behind `mailbox`.
    pub fn new(port: &'c mut AcyclicPort<'q, MESSAGE>, mailbox: &'c mut Mailbox) -> Self {
        Self { port, mailbox }
    }

    /// Asks for a file; its first packet replaces the content of `into`.
    ///
    /// # Errors
    /// [`BusError::FileError`] when the slave refuses, [`BusError::FilePacket`] or [`BusError::FileAnswer`] for an answer
    /// that does not fit, [`BusError::FileBusy`], or errors of the mailbox.
    pub async fn begin_read(&mut self, name: &str, password: u32, into: &mut Bytes<MESSAGE>) -> Result<(), BusError> {
        self.mailbox.drain(self.port).await?;
        let request = Foe::Read {
            password,
            name: name.as_bytes(),
        };
        self.packet(&request, 1, into).await
    }

    /// Acknowledges packet `packet`, from 1; the next one replaces the content of `into`.
    ///
    /// # Errors
    /// As [`Self::begin_read`].
    pub async fn next(&mut self, packet: u32, into: &mut Bytes<MESSAGE>) -> Result<(), BusError> {
        self.packet(&Foe::Acknowledge { packet }, packet.wrapping_add(1), into)
            .await
    }

    /// Acknowledges the last packet of a file.
    ///
    /// # Errors
    /// Errors of the mailbox.
    pub async fn end_read(&mut self, packet: u32) -> Result<(), BusError> {
        self.send(&Foe::Acknowledge { packet }).await
    }

    /// Begins to write a file.
    ///
    /// # Errors
    /// As [`Self::begin_read`].
    pub async fn begin_write(&mut self, name: &str, password: u32) -> Result<(), BusError> {
        self.mailbox.drain(self.port).await?;
        let request = Foe::Write {
            password,
            name: name.as_bytes(),
        };
        self.acknowledged(&request, 0).await
    }

    /// Writes packet `packet`, from 1. All but the last have [`Self::room`] bytes, the last has fewer.
    ///
    /// # Errors
    /// As [`Self::begin_read`].
    pub async fn put(&mut self, packet: u32, data: &[u8]) -> Result<(), BusError> {
        self.acknowledged(&Foe::Data { packet, data }, packet).await
    }

    /// Bytes of a file in a packet that this side sends.
    pub fn room(&self) -> usize {
        self.mailbox.capacity().saturating_sub(FOE_HEADER_LEN)
    }

    /// Whether a packet of the slave is the last of its file.
    pub fn is_last(&self, data: &[u8]) -> bool {
        let full = usize::from(self.mailbox.input_length()).saturating_sub(MAILBOX_HEADER_LEN + FOE_HEADER_LEN);
        data.len() < full
    }

    /// Ends a transfer.
    ///
    /// # Errors
    /// Errors of the mailbox.
    pub async fn cancel(&mut self) -> Result<(), BusError> {
        let error = Foe::Error {
            code: ERROR_ILLEGAL,
            text: &[],
        };
        self.send(&error).await
    }

    async fn send(&mut self, message: &Foe<'_>) -> Result<(), BusError> {
        let emit = |data: &mut [u8]| {
            // The data are as long as the message says.
            let _ = message.emit(data);
        };
        self.mailbox.send(self.port, Protocol::Foe, message.len(), emit).await
    }

    /// Sends a message and returns what `take` finds in its answer, the first one that is not "busy" or older than the
    /// message. The answer itself does not outlive this function: a message is long, and every function that waits with
    /// one needs memory for it.
    async fn ask<T>(
        &mut self,
        message: &Foe<'_>,
        is_old: impl Fn(&Foe) -> bool,
        mut take: impl FnMut(&Foe) -> T,
    ) -> Result<T, BusError> {
        let started_ms = self.port.now_ms();
        loop {
            self.send(message).await?;
            let accept = |data: &[u8]| Foe::parse(data).is_ok_and(|answer| !is_old(&answer));
            let answer = self
                .mailbox
                .receive_within(self.port, Protocol::Foe, FILE_TIMEOUT_MS, accept);
            let taken = answer.await.map(|answer| match Foe::parse(&answer) {
                Ok(Foe::Busy { .. }) => Ok(None),
                Ok(Foe::Error { code, .. }) => Err(BusError::FileError { code }),
                Ok(answer) => Ok(Some(take(&answer))),
                Err(_) => Err(BusError::FileAnswer),
            });
            if let Some(taken) = taken?? {
                return Ok(taken);
            }
            let waited_ms = self.port.now_ms().wrapping_sub(started_ms);
            if waited_ms > FILE_BUSY_MAX_MS {
                return Err(BusError::FileBusy { waited_ms });
            }
            self.port.wait_ms(BUSY_PAUSE_MS).await;
        }
    }

    /// Sends a message that is answered by packet `expected`, and puts this packet's content into `into`.
    async fn packet(&mut self, message: &Foe<'_>, expected: u32, into: &mut Bytes<MESSAGE>) -> Result<(), BusError> {
        let before = expected.wrapping_sub(1);
        let is_old = |answer: &Foe| matches!(answer, Foe::Data { packet, .. } if *packet == before && before != 0);
        let take = |answer: &Foe| match answer {
            Foe::Data { packet, data } => {
                into.clear();
                // A packet is shorter than the message in which it came.
                let _ = into.extend_from_slice(data);
                Some(*packet)
            }
            _ => None,
        };
        match self.ask(message, is_old, take).await? {
            Some(packet) if packet == expected => Ok(()),
            Some(packet) => self.give_up(expected, packet).await,
            None => Err(BusError::FileAnswer),
        }
    }

    /// Sends a message that is answered by the acknowledgement of packet `expected`.
    async fn acknowledged(&mut self, message: &Foe<'_>, expected: u32) -> Result<(), BusError> {
        let is_old = |answer: &Foe| matches!(answer, Foe::Acknowledge { packet } if expected != 0 && packet.wrapping_add(1) == expected);
        let take = |answer: &Foe| match answer {
            Foe::Acknowledge { packet } => Some(*packet),
            _ => None,
        };
        match self.ask(message, is_old, take).await? {
            Some(packet) if packet == expected => Ok(()),
            Some(packet) => self.give_up(expected, packet).await,
            None => Err(BusError::FileAnswer),
        }
    }

    /// Ends a transfer in which the slave has sent a wrong packet number.
    async fn give_up<T>(&mut self, expected: u32, actual: u32) -> Result<T, BusError> {
        let error = Foe::Error {
            code: ERROR_PACKET_NUMBER,
            text: &[],
        };
        // The reason is returned whether or not the slave received the error.
        let _ = self.send(&error).await;
        Err(BusError::FilePacket { expected, actual })
    }
}
