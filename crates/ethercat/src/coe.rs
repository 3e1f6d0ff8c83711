//! SDO client: reads and writes a slave's objects and queries its object dictionary.
//!
//! Values of up to four bytes travel in one message. Longer values fill one message and continue in segments, whose
//! toggle bit alternates. Complete access transfers all sub-indices of an object at once; sub-index 0 then takes 16
//! bits. Protocol: CiA 301, in the mailbox of IEC 61158-6-12.
//!
//! Every answer is checked against its request. An answer for another object belongs to an earlier request and is
//! skipped; an answer that violates the transfer ends it with an abort to the slave, so that both sides know.
//!
//! Invariant: an abort by the slave reaches the caller with object and code; no transfer is longer than its buffer.

use super::acyclic::{AcyclicPort, Bytes};
use super::error::BusError;
use super::mailbox::{MAILBOX_TIMEOUT_MS, Mailbox};
use super::wire::coe::{
    EntryDescription, Information, InformationRepr, Object, ObjectDescription, ObjectList, SDO_LEN, SEGMENT_DATA_MIN,
    SEGMENT_HEADER_LEN, Sdo, Service, VALUE_INFO_ACCESS,
};
use super::wire::mailbox::Protocol;
use super::wire::{read_u16, read_u32};

/// Most fragments of one answer about the object dictionary.
const FRAGMENTS_MAX: usize = 1_024;
/// Longest value of an expedited transfer, bytes.
const EXPEDITED_MAX: usize = 4;

/// Device type (CiA 301), which every slave with a dictionary has.
pub const DEVICE_TYPE: Object = Object::new(0x1000, 0);
/// Longest wait for the answer to a message whose counter may equal the slave's last one, ms. A slower slave is asked
/// twice.
const JOIN_WAIT_MS: u32 = 100;

const ABORT_TOGGLE: u32 = 0x0503_0000;
const ABORT_COMMAND: u32 = 0x0504_0001;
const ABORT_MEMORY: u32 = 0x0504_0005;
const ABORT_TOO_LONG: u32 = 0x0607_0012;

/// One slave's object dictionary, reached through its mailbox.
pub struct ObjectDictionary<'c, 'q, const MESSAGE: usize> {
    port: &'c mut AcyclicPort<'q, MESSAGE>,
    mailbox: &'c mut Mailbox,
}

impl<'c, 'q, const MESSAGE: usize> ObjectDictionary<'c, 'q, MESSAGE> {
    /// The dictionary behind `mailbox`.
    pub fn new(port: &'c mut AcyclicPort<'q, MESSAGE>, mailbox: &'c mut Mailbox) -> Self {
        Self { port, mailbox }
    }

    /// Makes the mailbox usable after another master may have used it.
    ///
    /// A slave treats a message with the counter of its last message as a repetition and does not answer; that counter
    /// cannot be read. The slave is therefore asked for its device type with two counters, one of which at least
    /// differs from the last. Asking twice is harmless.
    ///
    /// # Errors
    /// Errors of the mailbox, except a mailbox error, which is an answer too.
    pub async fn join(&mut self) -> Result<(), BusError> {
        let request = Sdo::Upload {
            object: DEVICE_TYPE,
            complete: false,
        };
        let emit = |data: &mut [u8]| {
            // The data are as long as the request says.
            let _ = request.emit(data);
        };
        let mut silence = BusError::MailboxTimeout { waited_ms: 0 };
        self.mailbox.drain(self.port).await?;
        for limit_ms in [JOIN_WAIT_MS, MAILBOX_TIMEOUT_MS] {
            self.mailbox.send(self.port, Protocol::Coe, request.len(), emit).await?;
            let answer = self
                .mailbox
                .receive_within(self.port, Protocol::Coe, limit_ms, |_| true);
            match answer.await {
                Ok(_) | Err(BusError::Mailbox { .. }) => return Ok(()),
                Err(error @ BusError::MailboxTimeout { .. }) => silence = error,
                Err(error) => return Err(error),
            }
        }
        Err(silence)
    }

    /// Reads an object of at most `MESSAGE` bytes.
    ///
    /// # Errors
    /// As [`Self::upload_into`].
    pub async fn upload(&mut self, object: Object) -> Result<Bytes<MESSAGE>, BusError> {
        let mut value = super::acyclic::zeros(MESSAGE);
        let length = self.upload_into(object, false, &mut value).await?;
        value.truncate(length);
        Ok(value)
    }

    /// Reads an object into `buffer` and returns its length in bytes; with `complete` all its sub-indices from the
    /// object's (0 or 1) on.
    ///
    /// # Errors
    /// [`BusError::SdoAbort`]; [`BusError::SdoAnswer`], [`BusError::SdoToggle`] or [`BusError::SdoLength`] for an
    /// answer that does not fit the transfer, which is then aborted; or errors of the mailbox.
    pub async fn upload_into(&mut self, object: Object, complete: bool, buffer: &mut [u8]) -> Result<usize, BusError> {
        let answer = self.ask(object, &Sdo::Upload { object, complete }).await?;
        let (size, here) = match Sdo::parse_response(&answer) {
            Ok(Sdo::UploadExpedited { data, .. }) => (data.len(), data),
            Ok(Sdo::UploadNormal { size, data, .. }) => {
                let size = usize::try_from(size).unwrap_or(usize::MAX);
                (size, data.get(..size).unwrap_or(data))
            }
            _ => {
                return self
                    .give_up(object, ABORT_COMMAND, BusError::SdoAnswer { object })
                    .await;
            }
        };
        if size > buffer.len() {
            let error = length_error(object, buffer.len(), size);
            return self.give_up(object, ABORT_MEMORY, error).await;
        }
        put(buffer, 0, here);
        let filled = here.len();
        if filled < size {
            let target = buffer.get_mut(..size).unwrap_or(&mut []);
            self.upload_segments(object, target, filled).await?;
        }
        Ok(size)
    }

    /// Fetches the rest of a value in segments.
    async fn upload_segments(&mut self, object: Object, value: &mut [u8], filled: usize) -> Result<(), BusError> {
        let mut filled = filled;
        let mut toggle = false;
        // Each iteration adds at least one byte, or is the last.
        for _ in 0..=value.len() {
            let answer = self.ask(object, &Sdo::UploadSegment { toggle }).await?;
            let (actual, last, data) = match Sdo::parse_response(&answer) {
                Ok(Sdo::UploadSegmentData { toggle, last, data }) => (toggle, last, data),
                _ => {
                    return self
                        .give_up(object, ABORT_COMMAND, BusError::SdoAnswer { object })
                        .await;
                }
            };
            if actual != toggle {
                return self.give_up(object, ABORT_TOGGLE, BusError::SdoToggle { object }).await;
            }
            let length = filled + data.len();
            if length > value.len() {
                let error = length_error(object, value.len(), length);
                return self.give_up(object, ABORT_TOO_LONG, error).await;
            }
            put(value, filled, data);
            filled = length;
            if last {
                break;
            }
            if data.is_empty() {
                return self
                    .give_up(object, ABORT_COMMAND, BusError::SdoAnswer { object })
                    .await;
            }
            toggle = !toggle;
        }
        if filled == value.len() {
            Ok(())
        } else {
            Err(length_error(object, value.len(), filled))
        }
    }

    /// Reads an object of `length` bytes (1 to 4) as an unsigned number.
    ///
    /// # Errors
    /// [`BusError::SdoLength`] when it has another length, or as [`Self::upload_into`].
    pub async fn read(&mut self, object: Object, length: u8) -> Result<u32, BusError> {
        let mut value = [0; EXPEDITED_MAX];
        let actual = self.upload_into(object, false, &mut value).await?;
        if actual != usize::from(length) {
            return Err(length_error(object, length.into(), actual));
        }
        Ok(read_u32(&value, 0))
    }

    /// Writes the `length` (1 to 4) low bytes of `value` to an object.
    ///
    /// # Errors
    /// As [`Self::download`].
    pub async fn write(&mut self, object: Object, value: u32, length: u8) -> Result<(), BusError> {
        let value = value.to_le_bytes();
        let data = value.get(..usize::from(length.clamp(1, 4))).unwrap_or(&value);
        self.download(object, false, data).await
    }

    /// Writes an object of any length; with `complete` all its sub-indices from the object's (0 or 1) on.
    ///
    /// # Errors
    /// [`BusError::SdoAbort`]; [`BusError::SdoAnswer`] or [`BusError::SdoToggle`] for an answer that does not fit the
    /// transfer, which is then aborted; [`BusError::Range`] beyond 4 GiB; or errors of the mailbox.
    pub async fn download(&mut self, object: Object, complete: bool, data: &[u8]) -> Result<(), BusError> {
        let Ok(size) = u32::try_from(data.len()) else {
            return Err(BusError::Range { object });
        };
        let here = data.len().min(self.mailbox.capacity().saturating_sub(SDO_LEN));
        let (here, rest) = data.split_at_checked(here).unwrap_or((data, &[]));
        let request = if (1..=EXPEDITED_MAX).contains(&data.len()) {
            Sdo::DownloadExpedited { object, complete, data }
        } else {
            Sdo::DownloadNormal {
                object,
                complete,
                size,
                data: here,
            }
        };
        let answer = self.ask(object, &request).await?;
        let Ok(Sdo::DownloadDone { .. }) = Sdo::parse_response(&answer) else {
            return self
                .give_up(object, ABORT_COMMAND, BusError::SdoAnswer { object })
                .await;
        };
        if matches!(request, Sdo::DownloadExpedited { .. }) {
            return Ok(());
        }
        self.download_segments(object, rest).await
    }

    /// Writes the rest of a value in segments.
    async fn download_segments(&mut self, object: Object, rest: &[u8]) -> Result<(), BusError> {
        let room = self.mailbox.capacity().saturating_sub(SEGMENT_HEADER_LEN);
        let mut segments = rest.chunks(room.max(SEGMENT_DATA_MIN)).peekable();
        let mut toggle = false;
        while let Some(data) = segments.next() {
            let last = segments.peek().is_none();
            let answer = self.ask(object, &Sdo::DownloadSegment { toggle, last, data }).await?;
            match Sdo::parse_response(&answer) {
                Ok(Sdo::DownloadSegmentDone { toggle: actual }) if actual == toggle => {}
                Ok(Sdo::DownloadSegmentDone { .. }) => {
                    return self.give_up(object, ABORT_TOGGLE, BusError::SdoToggle { object }).await;
                }
                _ => {
                    return self
                        .give_up(object, ABORT_COMMAND, BusError::SdoAnswer { object })
                        .await;
                }
            }
            toggle = !toggle;
        }
        Ok(())
    }

    /// Sends a request and returns its answer; an abort becomes an error.
    async fn ask(&mut self, object: Object, request: &Sdo<'_>) -> Result<Bytes<MESSAGE>, BusError> {
        let emit = |data: &mut [u8]| {
            // The data are as long as the request says.
            let _ = request.emit(data);
        };
        let answer = self
            .mailbox
            .exchange(self.port, Protocol::Coe, request.len(), emit, |data| {
                belongs(data, request, object)
            })
            .await?;
        match Sdo::parse_response(&answer) {
            Ok(Sdo::Abort { code, .. }) => Err(BusError::SdoAbort { object, code }),
            _ => Ok(answer),
        }
    }

    /// Aborts a transfer that the slave has violated; returns the reason.
    async fn give_up<T>(&mut self, object: Object, code: u32, error: BusError) -> Result<T, BusError> {
        let abort = Sdo::Abort { object, code };
        let emit = |data: &mut [u8]| {
            let _ = abort.emit(data);
        };
        // The reason is returned whether or not the slave received the abort.
        let _ = self.mailbox.send(self.port, Protocol::Coe, abort.len(), emit).await;
        Err(error)
    }

    /// Passes the indices of a list to `take` and returns how many there were. [`ObjectList::Lengths`] gives the
    /// lengths of the five lists instead.
    ///
    /// # Errors [`BusError::SdoAbort`] when the slave refuses, [`BusError::SdoAnswer`] for an answer that is not a
    /// list, or errors of the mailbox. The object of both is 0:0.
    pub async fn list(&mut self, list: ObjectList, mut take: impl FnMut(u16)) -> Result<usize, BusError> {
        const NUMBER_LEN: usize = 2;
        let object = Object::new(0, 0);
        let request = Information::GetList { list: list as u16 };
        let mut answer = self.inform(object, request).await?;
        let mut count = 0;
        for fragment in 0..FRAGMENTS_MAX {
            let repr = InformationRepr::parse(&answer);
            let Ok(InformationRepr {
                incomplete,
                body: Information::List { data },
                ..
            }) = repr
            else {
                return Err(BusError::SdoAnswer { object });
            };
            let indices = match fragment {
                0 if read_u16(data, 0) != list as u16 => return Err(BusError::SdoAnswer { object }),
                0 => data.get(NUMBER_LEN..).unwrap_or(&[]),
                _ => data,
            };
            for index in indices.chunks_exact(2) {
                take(read_u16(index, 0));
                count += 1;
            }
            if !incomplete {
                return Ok(count);
            }
            answer = self.next_fragment(object).await?;
        }
        Err(BusError::SdoAnswer { object })
    }

    /// Asks for an object's description and passes it to `take`; a name in several fragments is cut.
    ///
    /// # Errors
    /// [`BusError::SdoAbort`] when the slave refuses, or errors of the mailbox.
    pub async fn describe<R>(
        &mut self,
        index: u16,
        take: impl FnOnce(&ObjectDescription<'_>) -> R,
    ) -> Result<R, BusError> {
        let object = Object::new(index, 0);
        let answer = self.inform(object, Information::GetObject { index }).await?;
        let described = match InformationRepr::parse(&answer) {
            Ok(InformationRepr {
                incomplete,
                body: Information::Object(description),
                ..
            }) => Ok((incomplete, take(&description))),
            _ => Err(BusError::SdoAnswer { object }),
        };
        self.skip_fragments(object, described).await
    }

    /// Asks for the description of one entry of an object and passes it to `take`; a name in several fragments is cut.
    ///
    /// # Errors
    /// As [`Self::describe`].
    pub async fn describe_entry<R>(
        &mut self,
        object: Object,
        take: impl FnOnce(&EntryDescription<'_>) -> R,
    ) -> Result<R, BusError> {
        let request = Information::GetEntry {
            object,
            value_info: VALUE_INFO_ACCESS,
        };
        let answer = self.inform(object, request).await?;
        let described = match InformationRepr::parse(&answer) {
            Ok(InformationRepr {
                incomplete,
                body: Information::Entry(description),
                ..
            }) => Ok((incomplete, take(&description))),
            _ => Err(BusError::SdoAnswer { object }),
        };
        self.skip_fragments(object, described).await
    }

    /// Receives the fragments behind a first one, if there are any, and ignores them.
    async fn skip_fragments<R>(
        &mut self,
        object: Object,
        described: Result<(bool, R), BusError>,
    ) -> Result<R, BusError> {
        let (mut incomplete, result) = described?;
        for _ in 0..FRAGMENTS_MAX {
            if !incomplete {
                break;
            }
            let answer = self.next_fragment(object).await?;
            // The highest bit of the operation, in the first byte behind the two headers, is set if more fragments
            // follow.
            incomplete = InformationRepr::parse(&answer).is_ok_and(|repr| repr.incomplete);
        }
        Ok(result)
    }

    /// Sends a query about the object dictionary and returns the first fragment of the answer.
    async fn inform(&mut self, object: Object, question: Information<'_>) -> Result<Bytes<MESSAGE>, BusError> {
        let request = InformationRepr::request(question);
        let emit = |data: &mut [u8]| {
            // The data are as long as the request says.
            let _ = request.emit(data);
        };
        let answer = self
            .mailbox
            .exchange(self.port, Protocol::Coe, request.len(), emit, |data| {
                answers(data, question)
            })
            .await?;
        refusal(answer, object)
    }

    async fn next_fragment(&mut self, object: Object) -> Result<Bytes<MESSAGE>, BusError> {
        let answer = self
            .mailbox
            .receive(self.port, Protocol::Coe, |data| {
                Service::parse(data) == Ok(Service::SdoInformation)
            })
            .await?;
        refusal(answer, object)
    }
}

/// Converts a slave's refusal into an error.
fn refusal<const MESSAGE: usize>(answer: Bytes<MESSAGE>, object: Object) -> Result<Bytes<MESSAGE>, BusError> {
    match InformationRepr::parse(&answer) {
        Ok(InformationRepr {
            body: Information::Error { code },
            ..
        }) => Err(BusError::SdoAbort { object, code }),
        _ => Ok(answer),
    }
}

/// Whether a CoE message answers a query about the object dictionary; an answer to an earlier query does not.
fn answers(data: &[u8], question: Information<'_>) -> bool {
    match (question, InformationRepr::parse(data).map(|repr| repr.body)) {
        (_, Ok(Information::Error { .. })) => true,
        (Information::GetList { .. }, Ok(Information::List { .. })) => true,
        (Information::GetObject { index }, Ok(Information::Object(theirs))) => theirs.index == index,
        (Information::GetEntry { object, .. }, Ok(Information::Entry(theirs))) => theirs.object == object,
        _ => false,
    }
}

/// Whether a CoE message answers `request` for `object`, correctly or not; a message about another object answers an
/// earlier request.
fn belongs(data: &[u8], request: &Sdo<'_>, object: Object) -> bool {
    if !matches!(Service::parse(data), Ok(Service::SdoResponse | Service::SdoRequest)) {
        return false;
    }
    let segmented = matches!(request, Sdo::UploadSegment { .. } | Sdo::DownloadSegment { .. });
    match Sdo::parse_response(data) {
        // Slaves that answer a segment with an abort copy the segment's data to the place of the index.
        Ok(Sdo::Abort { object: theirs, .. }) => segmented || theirs.index == object.index,
        Ok(
            Sdo::UploadExpedited { object: theirs, .. }
            | Sdo::UploadNormal { object: theirs, .. }
            | Sdo::DownloadDone { object: theirs },
        ) => theirs == object,
        Ok(Sdo::UploadSegmentData { .. } | Sdo::DownloadSegmentDone { .. }) => segmented,
        _ => false,
    }
}

fn put(buffer: &mut [u8], offset: usize, data: &[u8]) {
    super::wire::write_bytes(buffer, offset, data);
}

fn length_error(object: Object, expected: usize, actual: usize) -> BusError {
    let number = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
    BusError::SdoLength {
        object,
        expected: number(expected),
        actual: number(actual),
    }
}

/// Splits a value read by complete access from sub-index 0 on into the value of sub-index 0, which takes 16 bits there,
/// and the values behind it.
pub fn split_complete(value: &[u8]) -> Option<(u8, &[u8])> {
    let (&[count, _], rest) = value.split_first_chunk::<2>()?;
    Some((count, rest))
}

/// Text of an SDO abort code (CiA 301 and IEC 61158-6-12 give the numbers).
pub const fn abort_text(code: u32) -> &'static str {
    match code {
        0x0503_0000 => "toggle bit did not alternate",
        0x0504_0000 => "transfer timed out",
        0x0504_0001 => "command not valid",
        0x0504_0002 => "block size not valid",
        0x0504_0003 => "sequence number not valid",
        0x0504_0004 => "checksum wrong",
        0x0504_0005 => "out of memory",
        0x0601_0000 => "access not supported",
        0x0601_0001 => "object can only be written",
        0x0601_0002 => "object can only be read",
        0x0601_0003 => "sub-index cannot be written while sub-index 0 is not 0",
        0x0601_0004 => "complete access not supported",
        0x0601_0005 => "object too long for the mailbox",
        0x0601_0006 => "object is mapped, writing is blocked",
        0x0602_0000 => "object does not exist",
        0x0604_0041 => "object cannot be mapped",
        0x0604_0042 => "mapped objects are longer than the process data",
        0x0604_0043 => "parameters do not go together",
        0x0604_0047 => "internal conflict of the device",
        0x0606_0000 => "hardware error",
        0x0607_0010 => "length or type does not match",
        0x0607_0012 => "too long",
        0x0607_0013 => "too short",
        0x0609_0011 => "sub-index does not exist",
        0x0609_0030 => "value out of range",
        0x0609_0031 => "value too high",
        0x0609_0032 => "value too low",
        0x0609_0033 => "list of modules does not match",
        0x0609_0036 => "highest value is below the lowest",
        0x060A_0023 => "resource not available",
        0x0800_0000 => "general error",
        0x0800_0020 => "value cannot be stored",
        0x0800_0021 => "value cannot be stored: local control",
        0x0800_0022 => "value cannot be stored in this state",
        0x0800_0023 => "no object dictionary",
        0x0800_0024 => "no data available",
        _ => "unknown abort code",
    }
}

/// Suggested remedy for an SDO abort code.
pub const fn abort_hint(code: u32) -> &'static str {
    match code {
        0x0503_0000 | 0x0504_0000 => "repeat; look for lost frames if it persists",
        0x0504_0001..=0x0504_0004 => "the device does not know this kind of transfer; try another form of access",
        0x0504_0005 => "read or write fewer bytes at a time",
        0x0601_0000..=0x0601_0002 => "check the direction of the access",
        0x0601_0003 => "set sub-index 0 to 0 first",
        0x0601_0004 => "read or write each sub-index by itself",
        0x0601_0005 => "read or write each sub-index by itself, or in segments",
        0x0601_0006 | 0x0800_0021 | 0x0800_0022 => "go to PREOP and switch the drive off first",
        0x0602_0000 | 0x0609_0011 => "check index and sub-index against the device's dictionary",
        0x0604_0041..=0x0604_0043 => "check the PDO lists against what the device allows",
        0x0604_0047 | 0x0606_0000 => "look at the device's own diagnosis; power it off and on",
        0x0607_0010..=0x0607_0013 => "check the object's type and length",
        0x0609_0030..=0x0609_0032 | 0x0609_0036 => "check the value against the device's limits",
        0x0609_0033 => "compare the modules there are with those configured",
        0x060A_0023 | 0x0800_0024 => "try again later",
        0x0800_0020 => "check the value, and whether the device's state allows it",
        _ => "look for the object in the device's manual",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sub_index_zero_takes_sixteen_bits_in_complete_access() {
        assert_eq!(
            split_complete(&[2, 0, 0x01, 0x1B, 0x02, 0x1B]),
            Some((2, &[1, 0x1B, 2, 0x1B][..]))
        );
        assert_eq!(
            (split_complete(&[0, 0]), split_complete(&[1])),
            (Some((0, &[][..])), None)
        );
    }

    #[test]
    fn an_answer_belongs_to_the_request_for_its_object_only() {
        let (object, other) = (Object::new(0x1C12, 1), Object::new(0x1C12, 2));
        let belongs = |answer: Sdo<'_>, request: Sdo<'_>| {
            let mut bytes = [0; 32];
            let length = answer.emit(&mut bytes).unwrap();
            super::belongs(&bytes[..length], &request, object)
        };
        let upload = Sdo::Upload {
            object,
            complete: false,
        };
        let segment = Sdo::UploadSegment { toggle: false };
        let data = &[1][..];
        assert!(belongs(Sdo::UploadExpedited { object, data }, upload));
        assert!(!belongs(Sdo::UploadExpedited { object: other, data }, upload));
        assert!(
            belongs(Sdo::DownloadDone { object }, upload),
            "wrong, but about the object"
        );
        let code = ABORT_TOGGLE;
        assert!(!belongs(
            Sdo::Abort {
                object: Object::new(0x1C13, 1),
                code
            },
            upload
        ));
        assert!(belongs(Sdo::Abort { object: other, code }, segment));
        let part = Sdo::UploadSegmentData {
            toggle: true,
            last: true,
            data,
        };
        assert!(belongs(part, segment), "its toggle is judged by the transfer");
        assert!(!belongs(part, upload));
    }
}
