//! Addresses for EtherCAT in UDP: an IP stack alongside the critical tasks.
//!
//! The critical tasks' exchange builds and parses its UDP packets by itself, but it needs the addresses. This module
//! provides them: [`NetworkTask`] runs an embassy-net stack (ARP, DHCP, ICMP echo) in a low-priority task, and passes
//! the critical side the headers to use ([`UdpRepr`]) as soon as address and next hop are known, and a notice when they
//! become invalid. All frames pass the one Ethernet port through the critical side: frames that are not EtherCAT come
//! through a ring of [`Frame`]s; frames from the stack wait in another ring until the cycle has nothing left to send,
//! at most one frame a millisecond.
//!
//! The stack resolves the segment's address by itself: it gets a datagram for the segment, and the headers that it puts
//! before the datagram are the ones to use. That datagram is never sent.
//!
//! Invariants: foreign traffic never delays the cyclic part and never needs more than the rings' memory; frames that do
//! not fit are dropped and counted; the stack is owned by the task that runs it.

mod port;
mod task;

pub use task::{NetworkTask, PATH_LIFE_MS, PROBE_PERIOD_MS};

use crate::config::NetworkSettings;
use crate::ethercat::queue;
use crate::ethercat::wire::{UDP_PORT, UdpRepr, read_u8};
use heapless::Vec;
use heapless::spsc::{Consumer, Producer, Queue};

/// Longest IP packet, bytes: the length that every host has to accept (RFC 791), which also suffices for DHCP.
pub const PACKET_BYTES_MAX: usize = 576;
/// Longest frame to or from the stack, bytes, without check sequence.
pub const FRAME_BYTES_MAX: usize = 14 + PACKET_BYTES_MAX;
/// Places for frames to the stack; one stays empty.
const RECEIVED_PLACES: usize = 5;
/// Places for frames from the stack; one stays empty.
const SENT_PLACES: usize = 3;

/// A frame without check sequence.
pub type Frame = Vec<u8, FRAME_BYTES_MAX>;

/// All rings between critical side, stack and link; in static memory.
#[derive(Debug, Default)]
pub struct NetworkQueues {
    received: Queue<Frame, RECEIVED_PLACES>,
    sent: Queue<Frame, SENT_PLACES>,
    paths: Queue<Option<UdpRepr>, 3>,
    settings: Queue<Option<NetworkSettings>, 3>,
}

/// The critical side's ends.
pub struct NetworkEnd<'a> {
    received: Producer<'a, Frame>,
    sent: Consumer<'a, Frame>,
    paths: Consumer<'a, Option<UdpRepr>>,
    dropped: u32,
}

/// Sends the settings to the stack: `None` for a bus that needs no addresses.
pub type SettingsEnd<'a> = Producer<'a, Option<NetworkSettings>>;

impl NetworkQueues {
    /// Empty rings.
    pub const fn new() -> Self {
        Self {
            received: Queue::new(),
            sent: Queue::new(),
            paths: Queue::new(),
            settings: Queue::new(),
        }
    }

    /// Splits into the ends for the critical side, for the task of the stack, and for the owner of the configuration.
    pub fn split(&mut self) -> (NetworkEnd<'_>, NetworkTask<'_>, SettingsEnd<'_>) {
        let (received_in, received) = self.received.split();
        let (sent_in, sent) = self.sent.split();
        let (paths_in, paths) = self.paths.split();
        let (settings_in, settings) = self.settings.split();
        let end = NetworkEnd {
            received: received_in,
            sent,
            paths,
            dropped: 0,
        };
        (
            end,
            NetworkTask::new(received, sent_in, paths_in, settings),
            settings_in,
        )
    }
}

impl NetworkEnd<'_> {
    /// Passes a received frame to the stack; returns false if the frame is EtherCAT.
    pub fn offer(&mut self, frame: &[u8]) -> bool {
        if is_ethercat(frame) {
            return false;
        }
        let copy = if queue::has_room_for(&self.received, 1) {
            Frame::from_slice(frame).ok()
        } else {
            None
        };
        let taken = copy.is_some_and(|frame| queue::put(&mut self.received, frame).is_ok());
        self.dropped = self.dropped.saturating_add(u32::from(!taken));
        true
    }

    /// Passes the next frame of the stack to `send`.
    pub fn send_next(&mut self, send: impl FnOnce(&[u8])) {
        if let Some(frame) = queue::front(&self.sent) {
            send(frame);
            let _ = queue::take(&mut self.sent);
        }
    }

    /// Whether the headers to use have changed.
    #[inline]
    pub fn has_path_news(&self) -> bool {
        self.paths.ready()
    }

    /// The change of the headers to use, if any; the inner `None` if they have become invalid.
    pub fn next_path(&mut self) -> Option<Option<UdpRepr>> {
        queue::take(&mut self.paths)
    }

    /// Number of frames for the stack that were too long or found no room.
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }
}

/// Whether a frame is EtherCAT: by its own EtherType, or in UDP to or from EtherCAT's port. Packets with IP options do
/// not count; the exchange refuses them.
fn is_ethercat(frame: &[u8]) -> bool {
    let be = |offset: usize| u16::from(read_u8(frame, offset)) << 8 | u16::from(read_u8(frame, offset + 1));
    match be(12) {
        crate::ethercat::wire::ETHERTYPE => true,
        0x0800 => read_u8(frame, 14) == 0x45 && read_u8(frame, 23) == 17 && [be(34), be(36)].contains(&UDP_PORT),
        _ => false,
    }
}

#[cfg(test)]
mod tests;
