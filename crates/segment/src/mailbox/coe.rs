//! Mailbox server: the slave's side of CANopen over EtherCAT.
//!
//! Takes one mailbox message and queues the answers. Supports SDO upload and download in expedited, normal and
//! segmented form, of one entry or of a whole object (complete access), SDO information, and emergencies. Unsupported
//! requests are refused with an abort or a mailbox error, never ignored. Layout: IEC 61158-6-12, CoE coding; abort
//! codes: CiA 301. Written from the slave's side, byte by byte, so that it tests a master independently.

use crate::mailbox::abort::Abort;
use crate::mailbox::dictionary::Dictionary;
use crate::mailbox::objects::Objects;
use crate::mailbox::sdo_information;
use std::collections::VecDeque;

const MAILBOX_HEADER: usize = 6;
const COE_HEADER: usize = 2;
const SDO_HEADER: usize = 8;
const SEGMENT_HEADER: usize = 1;
const SEGMENT_DATA_MIN: usize = 7;
const TYPE_ERROR: u8 = 0;
pub(crate) const TYPE_ETHERNET: u8 = 2;
pub(crate) const TYPE_COE: u8 = 3;
pub(crate) const TYPE_FILE: u8 = 4;
const SERVICE_EMERGENCY: u8 = 1;
const SERVICE_SDO_REQUEST: u8 = 2;
const SERVICE_SDO_RESPONSE: u8 = 3;
const SERVICE_SDO_INFORMATION: u8 = 8;
const ERROR_PROTOCOL: u16 = 2;
const ERROR_SERVICE: u16 = 4;
const ERROR_SHORT: u16 = 6;
const ERROR_LENGTH: u16 = 8;
const TOGGLE: u8 = 0x10;
const COMPLETE_ACCESS: u8 = 0x10;
/// Longest value accepted in segments, bytes.
const DOWNLOAD_BYTES_MAX: usize = 64 * 1024;
/// Most messages queued for the master; the oldest emergency is dropped first.
const QUEUE_MAX: usize = 64;

/// A gratuitous ARP request of the station 02:00:00:00:00:01 with the address 192.168.1.1.
const ADDRESS_ANNOUNCEMENT: [u8; 42] = [
    0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x02, 0x00, 0x00, 0x00, 0x00, 0x01, 0x08, 0x06, 0x00, 0x01, 0x08, 0x00, 0x06,
    0x04, 0x00, 0x01, 0x02, 0x00, 0x00, 0x00, 0x00, 0x01, 192, 168, 1, 1, 0, 0, 0, 0, 0, 0, 192, 168, 1, 1,
];

/// Operations on an object dictionary.
pub(crate) trait ObjectServer {
    /// The value of an entry, little-endian; of all entries from `sub` on with complete access.
    fn upload(&self, index: u16, sub: u8, complete: bool) -> Result<Vec<u8>, Abort>;
    /// Writes an entry, or all entries from `sub` on with complete access.
    fn download(&mut self, index: u16, sub: u8, complete: bool, value: &[u8]) -> Result<(), Abort>;
    /// The object dictionary.
    fn dictionary(&self) -> &Dictionary;
}

impl ObjectServer for Objects<'_> {
    fn upload(&self, index: u16, sub: u8, complete: bool) -> Result<Vec<u8>, Abort> {
        if complete {
            self.upload_complete(index, sub)
        } else {
            Objects::upload(self, index, sub)
        }
    }

    fn download(&mut self, index: u16, sub: u8, complete: bool, value: &[u8]) -> Result<(), Abort> {
        if complete {
            self.download_complete(index, sub, value)
        } else {
            Objects::download(self, index, sub, value)
        }
    }

    fn dictionary(&self) -> &Dictionary {
        self.dictionary
    }
}

#[derive(Clone, Debug, Default)]
enum Transfer {
    #[default]
    None,
    Upload {
        rest: VecDeque<u8>,
        toggle: bool,
    },
    Download {
        object: [u8; 3],
        complete: bool,
        expected: usize,
        value: Vec<u8>,
        toggle: bool,
    },
}

/// State of one slave's mailbox.
#[derive(Clone, Debug, Default)]
pub(crate) struct MailboxServer {
    counter: u8,
    received_counter: u8,
    queue: VecDeque<Vec<u8>>,
    last_sent: Option<Vec<u8>>,
    transfer: Transfer,
    losing: bool,
}

impl MailboxServer {
    /// Handles one message of the master; `capacity` is the length of the mailbox for the answers. Returns protocol and
    /// body of a message of another protocol, which the caller answers or refuses.
    pub(crate) fn receive<'m>(
        &mut self,
        message: &'m [u8],
        capacity: usize,
        dictionary: &mut impl ObjectServer,
    ) -> Option<(u8, &'m [u8])> {
        let Some((&[length_low, length_high, _, _, _, kind], rest)) = message.split_first_chunk() else {
            self.refuse(ERROR_SHORT);
            return None;
        };
        let counter = kind >> 4 & 0x07;
        if counter != 0 && counter == self.received_counter {
            return None;
        }
        self.received_counter = counter;
        let Some(body) = rest.get(..usize::from(u16::from_le_bytes([length_low, length_high]))) else {
            self.refuse(ERROR_LENGTH);
            return None;
        };
        match kind & 0x0F {
            TYPE_COE => self.receive_coe(body, capacity, dictionary),
            other => return Some((other, body)),
        }
        None
    }

    /// Refuses a message whose protocol the slave does not speak.
    pub(crate) fn refuse_protocol(&mut self) {
        self.refuse(ERROR_PROTOCOL);
    }

    fn receive_coe(&mut self, body: &[u8], capacity: usize, dictionary: &mut impl ObjectServer) {
        match body.split_first_chunk::<COE_HEADER>() {
            Some(([_, service], sdo)) if service >> 4 == SERVICE_SDO_REQUEST => {
                self.sdo(sdo, capacity, dictionary);
            }
            Some(([_, service], request)) if service >> 4 == SERVICE_SDO_INFORMATION => {
                for body in sdo_information::answer(request, capacity, dictionary.dictionary()) {
                    self.coe(SERVICE_SDO_INFORMATION, &body);
                }
            }
            Some(_) => self.refuse(ERROR_SERVICE),
            None => self.refuse(ERROR_SHORT),
        }
    }

    /// Queues an emergency message: error code, error register, five manufacturer-specific bytes.
    pub(crate) fn emergency(&mut self, code: u16, register: u8, detail: [u8; 5]) {
        let mut body = Vec::from(code.to_le_bytes());
        body.push(register);
        body.extend_from_slice(&detail);
        self.coe(SERVICE_EMERGENCY, &body);
    }

    /// Queues an Ethernet frame in one fragment that nobody has asked for: the announcement of an address (ARP).
    pub(crate) fn ethernet(&mut self) {
        let mut body = vec![0x00, 0x01, 0x00, 0x00];
        body.extend_from_slice(&ADDRESS_ANNOUNCEMENT);
        self.send(TYPE_ETHERNET, &body);
    }

    /// The next message for the master.
    pub(crate) fn next(&mut self) -> Option<Vec<u8>> {
        let message = self.queue.pop_front()?;
        self.last_sent = Some(message.clone());
        (!std::mem::take(&mut self.losing)).then_some(message)
    }

    /// Scripted fault: refuses an SDO request with this code.
    pub(crate) fn abort(&mut self, request: &[u8], code: u32) {
        let object = object_of(request).map_or([0; 3], |(index, sub)| {
            let [low, high] = index.to_le_bytes();
            [low, high, sub]
        });
        self.transfer = Transfer::None;
        let mut body = vec![0x80];
        body.extend_from_slice(&object);
        body.extend_from_slice(&code.to_le_bytes());
        self.coe(SERVICE_SDO_REQUEST, &body);
    }

    /// Scripted fault: the next message is lost, and only a repeat request returns it.
    pub(crate) fn lose_next(&mut self) {
        self.losing = true;
    }

    /// Scripted fault: the next message has the counter of the previous one.
    pub(crate) fn repeat_counter(&mut self) {
        self.counter = match self.counter {
            0 | 1 => 7,
            counter => counter - 1,
        };
    }

    /// The last message sent, for a repeat request.
    pub(crate) fn last_sent(&self) -> Option<&[u8]> {
        self.last_sent.as_deref()
    }

    fn sdo(&mut self, request: &[u8], capacity: usize, dictionary: &mut impl ObjectServer) {
        let Some((&[command, index_low, index_high, sub, ..], data)) = request.split_first_chunk::<SDO_HEADER>() else {
            return self.refuse(ERROR_SHORT);
        };
        let object = [index_low, index_high, sub];
        let index = u16::from_le_bytes([index_low, index_high]);
        let complete = command & COMPLETE_ACCESS != 0;
        let result = match command >> 5 {
            0 => self.download_segment(request, dictionary),
            1 => self.download(request, data, dictionary),
            2 => dictionary
                .upload(index, sub, complete)
                .map(|value| self.answer_upload(object, value, capacity)),
            3 => self.upload_segment(command, capacity),
            4 => {
                self.transfer = Transfer::None;
                Ok(())
            }
            _ => Err(Abort::COMMAND),
        };
        if let Err(Abort(code)) = result {
            self.transfer = Transfer::None;
            let mut body = vec![0x80];
            body.extend_from_slice(&object);
            body.extend_from_slice(&code.to_le_bytes());
            self.coe(SERVICE_SDO_REQUEST, &body);
        }
    }

    fn answer_upload(&mut self, object: [u8; 3], value: Vec<u8>, capacity: usize) {
        let mut body = Vec::new();
        if (1..=4).contains(&value.len()) {
            body.push(0x43 | (4 - value.len() as u8) << 2);
            body.extend_from_slice(&object);
            body.extend_from_slice(&value);
            body.resize(SDO_HEADER, 0);
        } else {
            let room = capacity.saturating_sub(MAILBOX_HEADER + COE_HEADER + SDO_HEADER);
            body.push(0x41);
            body.extend_from_slice(&object);
            body.extend_from_slice(&(value.len() as u32).to_le_bytes());
            let mut rest = VecDeque::from(value);
            body.extend(rest.drain(..room.min(rest.len())));
            if !rest.is_empty() {
                self.transfer = Transfer::Upload { rest, toggle: false };
            }
        }
        self.coe(SERVICE_SDO_RESPONSE, &body);
    }

    fn upload_segment(&mut self, command: u8, capacity: usize) -> Result<(), Abort> {
        let Transfer::Upload { rest, toggle } = &mut self.transfer else {
            return Err(Abort::COMMAND);
        };
        if *toggle != (command & TOGGLE != 0) {
            return Err(Abort::TOGGLE);
        }
        let room = capacity
            .saturating_sub(MAILBOX_HEADER + COE_HEADER + SEGMENT_HEADER)
            .max(SEGMENT_DATA_MIN);
        let part: Vec<u8> = rest.drain(..room.min(rest.len())).collect();
        let last = rest.is_empty();
        let unused = SEGMENT_DATA_MIN.saturating_sub(part.len()) as u8;
        let mut body = vec![(command & TOGGLE) | unused << 1 | u8::from(last)];
        *toggle = !*toggle;
        body.extend_from_slice(&part);
        body.resize(body.len().max(SEGMENT_HEADER + SEGMENT_DATA_MIN), 0);
        if last {
            self.transfer = Transfer::None;
        }
        self.coe(SERVICE_SDO_RESPONSE, &body);
        Ok(())
    }

    fn download(&mut self, request: &[u8], data: &[u8], dictionary: &mut impl ObjectServer) -> Result<(), Abort> {
        let Some(&[command, index_low, index_high, sub, b0, b1, b2, b3]) = request.first_chunk() else {
            return Err(Abort::COMMAND);
        };
        let object = [index_low, index_high, sub];
        let index = u16::from_le_bytes([index_low, index_high]);
        let complete = command & COMPLETE_ACCESS != 0;
        if command & 0x02 != 0 {
            let unused = if command & 0x01 != 0 {
                usize::from(command >> 2 & 3)
            } else {
                0
            };
            let value = [b0, b1, b2, b3];
            let value = value.get(..4 - unused).unwrap_or(&value);
            dictionary.download(index, sub, complete, value)?;
            self.confirm_download(object);
            return Ok(());
        }
        let expected = u32::from_le_bytes([b0, b1, b2, b3]) as usize;
        if expected > DOWNLOAD_BYTES_MAX {
            return Err(Abort::MEMORY);
        }
        let value = data.get(..expected.min(data.len())).unwrap_or_default().to_vec();
        if value.len() == expected {
            dictionary.download(index, sub, complete, &value)?;
        } else {
            self.transfer = Transfer::Download {
                object,
                complete,
                expected,
                value,
                toggle: false,
            };
        }
        self.confirm_download(object);
        Ok(())
    }

    fn download_segment(&mut self, request: &[u8], dictionary: &mut impl ObjectServer) -> Result<(), Abort> {
        let Transfer::Download {
            object,
            complete,
            expected,
            value,
            toggle,
        } = &mut self.transfer
        else {
            return Err(Abort::COMMAND);
        };
        let (&command, data) = request.split_first().ok_or(Abort::COMMAND)?;
        if *toggle != (command & TOGGLE != 0) {
            return Err(Abort::TOGGLE);
        }
        let unused = if data.len() <= SEGMENT_DATA_MIN {
            usize::from(command >> 1 & 7)
        } else {
            0
        };
        let data = data.get(..data.len().saturating_sub(unused)).unwrap_or_default();
        if value.len() + data.len() > *expected {
            return Err(Abort::TOO_LONG);
        }
        value.extend_from_slice(data);
        *toggle = !*toggle;
        if command & 0x01 != 0 {
            if value.len() < *expected {
                return Err(Abort::TOO_SHORT);
            }
            let [index_low, index_high, sub] = *object;
            let (value, complete) = (std::mem::take(value), *complete);
            self.transfer = Transfer::None;
            let index = u16::from_le_bytes([index_low, index_high]);
            dictionary.download(index, sub, complete, &value)?;
        }
        self.coe(SERVICE_SDO_RESPONSE, &[0x20 | (command & TOGGLE), 0, 0, 0, 0, 0, 0, 0]);
        Ok(())
    }

    fn confirm_download(&mut self, object: [u8; 3]) {
        let [index_low, index_high, sub] = object;
        self.coe(SERVICE_SDO_RESPONSE, &[0x60, index_low, index_high, sub, 0, 0, 0, 0]);
    }

    fn coe(&mut self, service: u8, body: &[u8]) {
        let mut message = vec![0, service << 4];
        message.extend_from_slice(body);
        self.send(TYPE_COE, &message);
    }

    fn refuse(&mut self, detail: u16) {
        let [low, high] = detail.to_le_bytes();
        self.send(TYPE_ERROR, &[1, 0, low, high]);
    }

    /// Queues a message of a protocol.
    pub(crate) fn send(&mut self, kind: u8, body: &[u8]) {
        self.counter = self.counter % 7 + 1;
        let mut message = Vec::from((body.len() as u16).to_le_bytes());
        message.extend_from_slice(&[0, 0, 0, kind | self.counter << 4]);
        message.extend_from_slice(body);
        if self.queue.len() >= QUEUE_MAX {
            self.queue.pop_front();
        }
        self.queue.push_back(message);
    }
}

/// Protocol of a mailbox message.
pub(crate) fn protocol_of(message: &[u8]) -> Option<u8> {
    message.get(5).map(|kind| kind & 0x0F)
}

/// Index and sub-index of an SDO request in a mailbox message.
pub(crate) fn object_of(message: &[u8]) -> Option<(u16, u8)> {
    let &[_, _, _, _, _, kind, _, service, _, low, high, sub] = message.first_chunk()?;
    let is_sdo = kind & 0x0F == TYPE_COE && service >> 4 == SERVICE_SDO_REQUEST;
    is_sdo.then_some((u16::from_le_bytes([low, high]), sub))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dictionary with one byte that counts how often it was written.
    struct Counter(u8, Dictionary);

    impl ObjectServer for Counter {
        fn upload(&self, _index: u16, _sub: u8, _complete: bool) -> Result<Vec<u8>, Abort> {
            Ok(vec![self.0])
        }

        fn download(&mut self, _index: u16, _sub: u8, _complete: bool, _value: &[u8]) -> Result<(), Abort> {
            self.0 += 1;
            Ok(())
        }

        fn dictionary(&self) -> &Dictionary {
            &self.1
        }
    }

    const DOWNLOAD: [u8; 10] = [0, 0x20, 0x2F, 0, 0x20, 0, 1, 0, 0, 0];

    fn message(kind: u8, counter: u8, body: &[u8]) -> Vec<u8> {
        let mut message = vec![body.len() as u8, 0, 0, 0, 0, kind | counter << 4];
        message.extend_from_slice(body);
        message.resize(64, 0);
        message
    }

    fn receive(server: &mut MailboxServer, dictionary: &mut Counter, message: &[u8]) -> Option<Vec<u8>> {
        if server.receive(message, 64, dictionary).is_some() {
            server.refuse_protocol();
        }
        server.next()
    }

    #[test]
    fn a_message_with_the_counter_of_the_last_is_not_executed_twice() {
        let (mut server, mut dictionary) = (MailboxServer::default(), Counter(0, Dictionary::default()));
        for counter in [1, 1, 1, 2, 0, 0] {
            receive(&mut server, &mut dictionary, &message(TYPE_COE, counter, &DOWNLOAD));
        }
        assert_eq!(dictionary.0, 4, "1 once, 2 once, and 0 counts every time");
    }

    #[test]
    fn what_is_not_spoken_is_refused_by_a_mailbox_error() {
        let cases: [(u8, &[u8], u8); 4] = [
            (4, &DOWNLOAD, 2),
            (TYPE_COE, &[0, 0x90, 1, 0, 0, 0], 4),
            (TYPE_COE, &[0], 6),
            (TYPE_COE, &[0, 0x20, 0x40], 6),
        ];
        for (counter, (kind, body, detail)) in (1..).zip(cases) {
            let (mut server, mut dictionary) = (MailboxServer::default(), Counter(0, Dictionary::default()));
            let answer = receive(&mut server, &mut dictionary, &message(kind, counter, body));
            assert_eq!(answer, Some(vec![4, 0, 0, 0, 0, 0x10, 1, 0, detail, 0]), "{body:x?}");
        }
        let (mut server, mut dictionary) = (MailboxServer::default(), Counter(0, Dictionary::default()));
        let mut long = message(TYPE_COE, 1, &DOWNLOAD);
        long[0] = 200;
        assert_eq!(
            receive(&mut server, &mut dictionary, &long).map(|answer| answer[8]),
            Some(8)
        );
    }

    #[test]
    fn counters_of_the_slave_run_from_one_to_seven() {
        let (mut server, mut dictionary) = (MailboxServer::default(), Counter(0, Dictionary::default()));
        let counters: Vec<_> = (0..9)
            .filter_map(|_| receive(&mut server, &mut dictionary, &message(TYPE_COE, 0, &DOWNLOAD)))
            .map(|answer| answer[5] >> 4)
            .collect();
        assert_eq!(counters, [1, 2, 3, 4, 5, 6, 7, 1, 2]);
    }

    #[test]
    fn a_segment_without_its_transfer_or_with_the_wrong_toggle_is_aborted() {
        let (mut server, mut dictionary) = (MailboxServer::default(), Counter(0, Dictionary::default()));
        let stray = message(TYPE_COE, 1, &[0, 0x20, 0x01, 1, 2, 3, 4, 5, 6, 7]);
        let code = |answer: Option<Vec<u8>>| answer.map(|answer| answer[12..16].to_vec());
        let expected = Some(Abort::COMMAND.0.to_le_bytes().to_vec());
        assert_eq!(code(receive(&mut server, &mut dictionary, &stray)), expected);
        let start = message(TYPE_COE, 2, &[0, 0x20, 0x21, 0, 0x20, 0, 9, 0, 0, 0]);
        receive(&mut server, &mut dictionary, &start);
        let wrong = message(TYPE_COE, 3, &[0, 0x20, 0x10, 1, 2, 3, 4, 5, 6, 7]);
        let expected = Some(Abort::TOGGLE.0.to_le_bytes().to_vec());
        assert_eq!(code(receive(&mut server, &mut dictionary, &wrong)), expected);
    }
}
