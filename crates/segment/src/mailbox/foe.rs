//! File server of a slave: file access over EtherCAT (FoE).
//!
//! A file is read or written in packets that fill the mailbox; one that does not fill it is the last, and may be empty.
//! The other side acknowledges each packet by its number. Layout and error codes: IEC 61158-6-12, FoE; ETG.1020.
//! Written from the slave's side, byte by byte, so that it tests a master independently.
//!
//! Invariant: a file is replaced when its last packet has arrived, never in part.

use std::collections::BTreeMap;

const MAILBOX_HEADER: usize = 6;
const HEADER: usize = 6;
const READ: u8 = 1;
const WRITE: u8 = 2;
const DATA: u8 = 3;
const ACKNOWLEDGE: u8 = 4;
const ERROR: u8 = 5;
const BUSY: u8 = 6;
const NOT_FOUND: u32 = 0x8001;
const DISK_FULL: u32 = 0x8003;
const ILLEGAL: u32 = 0x8004;
const PACKET_NUMBER: u32 = 0x8005;
const BOOTSTRAP_ONLY: u32 = 0x8008;
const NO_RIGHTS: u32 = 0x800A;
/// Most bytes of all files together.
const BYTES_MAX: usize = 16 << 20;
/// Parts of the whole in which a busy answer tells the progress.
const WHOLE: u16 = 1000;

/// Fault of a file server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileFault {
    /// The next packets are answered with "busy" this often before they are taken.
    Busy(u32),
    /// The next message is answered with this error code.
    Error(u32),
    /// The next answer has a packet number that is too large by one.
    Packet,
    /// The next messages are not answered, this many.
    Silent(u32),
}

#[derive(Clone, Debug, Default)]
enum Transfer {
    #[default]
    None,
    Reading {
        content: Vec<u8>,
        /// Number of the packet sent last, and its first byte.
        packet: u32,
        start: usize,
        length: usize,
    },
    Writing {
        name: String,
        content: Vec<u8>,
        /// Number of the packet taken last.
        packet: u32,
    },
}

/// Files of one slave and the transfer in progress.
#[derive(Clone, Debug, Default)]
pub(crate) struct FileServer {
    files: BTreeMap<String, Vec<u8>>,
    password: u32,
    /// Whether files are written in BOOT only.
    writes_in_bootstrap: bool,
    transfer: Transfer,
    busy: u32,
    error: Option<u32>,
    silent: u32,
    wrong_packet: bool,
}

impl FileServer {
    /// A server without files; a password other than 0 is asked for.
    pub(crate) fn new(password: u32, writes_in_bootstrap: bool) -> Self {
        Self {
            password,
            writes_in_bootstrap,
            ..Self::default()
        }
    }

    /// The file with a name.
    pub(crate) fn file(&self, name: &str) -> Option<&[u8]> {
        self.files.get(name).map(Vec::as_slice)
    }

    /// Stores a file.
    pub(crate) fn store(&mut self, name: &str, content: &[u8]) {
        self.files.insert(name.to_owned(), content.to_vec());
    }

    /// Ends the transfer in progress, as a change of state does.
    pub(crate) fn end(&mut self) {
        self.transfer = Transfer::None;
    }

    /// Sets a fault.
    pub(crate) fn spoil(&mut self, fault: FileFault) {
        match fault {
            FileFault::Busy(times) => self.busy = times,
            FileFault::Error(code) => self.error = Some(code),
            FileFault::Packet => self.wrong_packet = true,
            FileFault::Silent(times) => self.silent = times,
        }
    }

    /// Answers one message; `capacities` are the lengths of the mailboxes for messages and for answers, `in_bootstrap`
    /// tells the state.
    pub(crate) fn receive(
        &mut self,
        message: &[u8],
        capacities: (usize, usize),
        in_bootstrap: bool,
    ) -> Option<Vec<u8>> {
        if self.silent > 0 {
            self.silent -= 1;
            return None;
        }
        let answer = match self.error.take() {
            Some(code) => Err(code),
            None => self.carry_out(message, capacities, in_bootstrap),
        };
        match answer {
            Ok(Some(mut answer)) => {
                if std::mem::take(&mut self.wrong_packet)
                    && let Some(number) = answer.get_mut(2)
                {
                    *number = number.wrapping_add(1);
                }
                Some(answer)
            }
            Ok(None) => None,
            Err(code) => {
                self.transfer = Transfer::None;
                Some(with_number(ERROR, code, text_of(code).as_bytes()))
            }
        }
    }

    fn carry_out(
        &mut self,
        message: &[u8],
        capacities: (usize, usize),
        in_bootstrap: bool,
    ) -> Result<Option<Vec<u8>>, u32> {
        let Some((&[operation, _, a, b, c, d], data)) = message.split_first_chunk::<HEADER>() else {
            return Err(ILLEGAL);
        };
        let number = u32::from_le_bytes([a, b, c, d]);
        let room = |capacity: usize| capacity.saturating_sub(MAILBOX_HEADER + HEADER).max(1);
        let (room_in, room) = (room(capacities.0), room(capacities.1));
        match operation {
            READ => {
                let content = self
                    .permitted(number, data)
                    .and_then(|name| self.files.get(&name).ok_or(NOT_FOUND))?;
                let content = content.clone();
                self.transfer = Transfer::Reading {
                    content,
                    packet: 0,
                    start: 0,
                    length: 0,
                };
                self.next_packet(0, room)
            }
            WRITE => {
                let name = self.permitted(number, data)?;
                if self.writes_in_bootstrap && !in_bootstrap {
                    return Err(BOOTSTRAP_ONLY);
                }
                self.transfer = Transfer::Writing {
                    name,
                    content: Vec::new(),
                    packet: 0,
                };
                Ok(Some(with_number(ACKNOWLEDGE, 0, &[])))
            }
            DATA => self.take_packet(number, data, room_in),
            ACKNOWLEDGE => self.next_packet(number, room),
            ERROR => {
                self.transfer = Transfer::None;
                Ok(None)
            }
            _ => Err(ILLEGAL),
        }
    }

    /// The name in a request whose password is right.
    fn permitted(&self, password: u32, name: &[u8]) -> Result<String, u32> {
        if self.password != 0 && password != self.password {
            return Err(NO_RIGHTS);
        }
        let name: Vec<u8> = name.iter().copied().take_while(|byte| *byte != 0).collect();
        String::from_utf8(name).map_err(|_| NOT_FOUND)
    }

    /// The packet behind the one that was acknowledged; the same again for a repeated acknowledgement.
    fn next_packet(&mut self, acknowledged: u32, room: usize) -> Result<Option<Vec<u8>>, u32> {
        let Transfer::Reading {
            content,
            packet,
            start,
            length,
        } = &mut self.transfer
        else {
            return Err(ILLEGAL);
        };
        if acknowledged == *packet {
            if *packet > 0 && *length < room {
                self.transfer = Transfer::None;
                return Ok(None);
            }
            if self.busy > 0 {
                self.busy -= 1;
                return Ok(Some(busy(*start, content.len())));
            }
            *start += *length;
            *packet = packet.wrapping_add(1);
        } else if acknowledged.wrapping_add(1) != *packet {
            return Err(PACKET_NUMBER);
        }
        let rest = content.get(*start..).unwrap_or_default();
        *length = rest.len().min(room);
        let part = rest.get(..*length).unwrap_or_default();
        Ok(Some(with_number(DATA, *packet, part)))
    }

    /// Takes a packet of a file that is written; one that was taken before is acknowledged again.
    fn take_packet(&mut self, number: u32, data: &[u8], room: usize) -> Result<Option<Vec<u8>>, u32> {
        let kept: usize = self.files.values().map(Vec::len).sum();
        let Transfer::Writing { name, content, packet } = &mut self.transfer else {
            return Err(ILLEGAL);
        };
        if number == *packet {
            return Ok(Some(with_number(ACKNOWLEDGE, number, &[])));
        }
        if number != packet.wrapping_add(1) {
            return Err(PACKET_NUMBER);
        }
        if kept + content.len() + data.len() > BYTES_MAX {
            return Err(DISK_FULL);
        }
        if self.busy > 0 {
            self.busy -= 1;
            return Ok(Some(busy(content.len(), content.len() + data.len())));
        }
        content.extend_from_slice(data);
        *packet = number;
        if data.len() < room {
            let (name, content) = (std::mem::take(name), std::mem::take(content));
            self.files.insert(name, content);
            self.transfer = Transfer::None;
        }
        Ok(Some(with_number(ACKNOWLEDGE, number, &[])))
    }
}

fn with_number(operation: u8, number: u32, data: &[u8]) -> Vec<u8> {
    let mut message = vec![operation, 0];
    message.extend_from_slice(&number.to_le_bytes());
    message.extend_from_slice(data);
    message
}

/// Tells how far the work has come, in thousandths.
fn busy(done: usize, entire: usize) -> Vec<u8> {
    let share = done.saturating_mul(WHOLE.into()).checked_div(entire).unwrap_or(0);
    let mut message = vec![BUSY, 0];
    message.extend_from_slice(&u16::try_from(share).unwrap_or(WHOLE).to_le_bytes());
    message.extend_from_slice(&WHOLE.to_le_bytes());
    message.extend_from_slice(b"busy");
    message
}

fn text_of(code: u32) -> &'static str {
    match code {
        NOT_FOUND => "file not found",
        DISK_FULL => "disk full",
        ILLEGAL => "illegal operation",
        PACKET_NUMBER => "wrong packet number",
        BOOTSTRAP_ONLY => "in bootstrap only",
        NO_RIGHTS => "wrong password",
        _ => "error",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAPACITY: usize = MAILBOX_HEADER + HEADER + 8;

    fn server() -> FileServer {
        let mut server = FileServer::new(0, false);
        server.store("notes", &[7; 16]);
        server
    }

    fn request(operation: u8, number: u32, data: &[u8]) -> Vec<u8> {
        with_number(operation, number, data)
    }

    fn ask(server: &mut FileServer, operation: u8, number: u32, data: &[u8]) -> Vec<u8> {
        server
            .receive(&request(operation, number, data), (CAPACITY, CAPACITY), false)
            .expect("an answer")
    }

    #[test]
    fn a_file_that_fills_its_packets_ends_with_an_empty_one() {
        let mut server = server();
        assert_eq!(ask(&mut server, READ, 0, b"notes")[..6], [DATA, 0, 1, 0, 0, 0]);
        assert_eq!(
            ask(&mut server, ACKNOWLEDGE, 1, &[])[2..],
            [2, 0, 0, 0, 7, 7, 7, 7, 7, 7, 7, 7]
        );
        assert_eq!(ask(&mut server, ACKNOWLEDGE, 1, &[])[2], 2, "the same again");
        assert_eq!(ask(&mut server, ACKNOWLEDGE, 2, &[]), [DATA, 0, 3, 0, 0, 0]);
        assert_eq!(
            server.receive(&request(ACKNOWLEDGE, 3, &[]), (CAPACITY, CAPACITY), false),
            None
        );
        assert_eq!(ask(&mut server, ACKNOWLEDGE, 3, &[])[..6], [ERROR, 0, 4, 0x80, 0, 0]);
    }

    #[test]
    fn a_written_file_is_there_after_its_last_packet() {
        let mut server = server();
        assert_eq!(ask(&mut server, WRITE, 0, b"new"), [ACKNOWLEDGE, 0, 0, 0, 0, 0]);
        server.spoil(FileFault::Busy(2));
        for _ in 0..2 {
            assert_eq!(ask(&mut server, DATA, 1, &[1; 8])[0], BUSY);
        }
        assert_eq!(ask(&mut server, DATA, 1, &[1; 8])[0], ACKNOWLEDGE);
        assert_eq!(server.file("new"), None);
        assert_eq!(ask(&mut server, DATA, 1, &[1; 8])[0], ACKNOWLEDGE, "a repetition");
        assert_eq!(ask(&mut server, DATA, 2, &[])[0], ACKNOWLEDGE);
        assert_eq!(server.file("new"), Some([1; 8].as_slice()));
    }

    #[test]
    fn the_length_of_the_mailbox_that_is_written_tells_the_last_packet_of_a_written_file() {
        let mut server = server();
        let mut ask = |message: &[u8]| {
            server
                .receive(message, (CAPACITY + 4, CAPACITY), false)
                .map(|answer| answer[0])
        };
        assert_eq!(ask(&request(WRITE, 0, b"new")), Some(ACKNOWLEDGE));
        assert_eq!(ask(&request(DATA, 1, &[1; 8])), Some(ACKNOWLEDGE));
        assert_eq!(server.file("new"), Some([1; 8].as_slice()));
    }

    #[test]
    fn what_is_wrong_is_answered_with_its_code() {
        let code = |answer: Vec<u8>| (answer[0], u16::from_le_bytes([answer[2], answer[3]]));
        let mut server = server();
        assert_eq!(code(ask(&mut server, READ, 0, b"nothing")), (ERROR, 0x8001));
        assert_eq!(code(ask(&mut server, DATA, 1, &[])), (ERROR, 0x8004));
        ask(&mut server, WRITE, 0, b"new");
        assert_eq!(code(ask(&mut server, DATA, 2, &[])), (ERROR, 0x8005));
        let mut secret = FileServer::new(9, true);
        assert_eq!(code(ask(&mut secret, READ, 8, b"notes")), (ERROR, 0x800A));
        assert_eq!(code(ask(&mut secret, WRITE, 9, b"notes")), (ERROR, 0x8008));
        assert!(
            secret
                .receive(&request(WRITE, 9, b"notes"), (CAPACITY, CAPACITY), true)
                .is_some()
        );
    }
}
