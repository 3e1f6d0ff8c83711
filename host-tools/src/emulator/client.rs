//! One client at the host's end of the virtual serial line, over any stream.
//!
//! Invariant: a client that does not read takes a bounded amount of memory, and nothing waits for it.

use super::LINK_BYTES_MAX;
use std::io::{self, ErrorKind, Read, Write};

/// Most bytes queued for a client that does not read; older ones are dropped, as on a serial line.
const WAITING_BYTES_MAX: usize = 1 << 20;

/// A place for one client, whose stream does not block.
pub(crate) struct ClientSlot<S> {
    client: Option<S>,
    waiting: Vec<u8>,
}

impl<S: Read + Write> ClientSlot<S> {
    pub(crate) fn empty() -> Self {
        Self {
            client: None,
            waiting: Vec::new(),
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.client.is_none()
    }

    /// Takes a client and replaces the previous one; bytes that the previous one has not read are discarded.
    pub(crate) fn take(&mut self, client: S) {
        self.waiting.clear();
        self.client = Some(client);
    }

    /// Moves bytes in both directions, at most `room` of them to the firmware; returns false once the client has gone.
    pub(crate) fn exchange(&mut self, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) -> bool {
        if self.client.is_some() {
            self.waiting.extend_from_slice(from_firmware);
            let excess = self.waiting.len().saturating_sub(WAITING_BYTES_MAX);
            self.waiting.drain(..excess);
        }
        let is_there = self.transfer(to_firmware, room);
        if !is_there {
            self.client = None;
        }
        is_there
    }

    fn transfer(&mut self, to_firmware: &mut Vec<u8>, room: usize) -> bool {
        let Some(client) = &mut self.client else { return true };
        let blocked = |error: &io::Error| matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted);
        match client.write(&self.waiting) {
            Ok(written) => {
                self.waiting.drain(..written);
            }
            Err(error) if blocked(&error) => {}
            Err(_) => return false,
        }
        let mut bytes = [0; LINK_BYTES_MAX];
        let room = room.min(bytes.len());
        match client.read(bytes.get_mut(..room).unwrap_or_default()) {
            Ok(0) => room == 0,
            Ok(length) => {
                to_firmware.extend(bytes.iter().take(length));
                true
            }
            Err(error) => blocked(&error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixStream;

    #[test]
    fn bytes_go_both_ways_as_there_is_room_and_an_end_is_seen() {
        let (mut outside, inside) = UnixStream::pair().unwrap();
        inside.set_nonblocking(true).unwrap();
        let mut slot = ClientSlot::empty();
        let mut received = Vec::new();
        assert!(slot.exchange(b"lost", &mut received, 92) && slot.is_empty());
        slot.take(inside);
        outside.write_all(b"abcde").unwrap();
        assert!(slot.exchange(b"hello", &mut received, 3));
        assert!(slot.exchange(b"", &mut received, 92));
        assert_eq!(received, b"abcde");
        let mut heard = [0; 5];
        outside.read_exact(&mut heard).unwrap();
        assert_eq!(&heard, b"hello");
        assert!(slot.exchange(b"", &mut received, 0));
        drop(outside);
        assert!(!slot.exchange(b"", &mut received, 92) && slot.is_empty());
    }
}
