//! Addresses for EtherCAT in UDP: an IP stack beside the critical tasks.
//!
//! The exchange of the critical tasks builds and opens its UDP packets by itself; what it cannot know are the addresses.
//! Those come from here: [`NetworkTask`] runs an embassy-net stack (ARP, DHCP, ICMP echo) in a low-priority task, and tells
//! the critical side the headers to use ([`UdpRepr`]) as soon as address and next hop are known, and that they are gone.
//! The way in and out of the one Ethernet port leads through the critical side: frames that are not EtherCAT's come
//! through a ring of [`Frame`]s, and what the stack wants to send waits in another until nothing of the cycle is left to
//! send, at most one frame a millisecond.
//!
//! The stack resolves the segment's address by itself: it is given a datagram for the segment, and the headers that it
//! puts in front of it are the ones that are wanted. That datagram never leaves.
//!
//! Invariants: foreign traffic never delays the cyclic part and never needs more than the rings' memory; what does not
//! fit is dropped and counted; the stack lives inside the task that runs it.

mod port;
mod task;

pub use task::{NetworkTask, PATH_LIFE_MS, PROBE_PERIOD_MS};

use crate::config::HostAddress;
use crate::ethercat::wire::{UDP_PORT, UdpRepr, read_u8};
use crate::queue;
use core::net::Ipv4Addr;
use heapless::Vec;
use heapless::spsc::{Consumer, Producer, Queue};

/// Longest IP packet, bytes: what every host has to accept (RFC 791), and as long as DHCP's messages.
pub const PACKET_BYTES_MAX: usize = 576;
/// Longest frame for or from the stack, bytes, without check sequence.
pub const FRAME_BYTES_MAX: usize = 14 + PACKET_BYTES_MAX;
/// Places for frames to the stack; one stays empty.
const RECEIVED_PLACES: usize = 5;
/// Places for frames from the stack; one stays empty.
const SENT_PLACES: usize = 3;

/// A frame without check sequence.
pub type Frame = Vec<u8, FRAME_BYTES_MAX>;

/// What the stack is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkSettings {
    /// The own address.
    pub address: HostAddress,
    /// Where packets for other networks go, if anywhere; DHCP brings its own.
    pub gateway: Option<Ipv4Addr>,
    /// The segment's address.
    pub segment: Ipv4Addr,
}

/// All rings between critical side, stack and link; they live in static memory.
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

/// The end of who knows the configuration: `None` for a bus that needs no addresses.
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

    /// The ends: for the critical side, for the task of the stack, and for who knows the configuration.
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
    /// Gives a received frame to the stack unless it is EtherCAT's; false if it is.
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

    /// Hands the next frame of the stack to `send`.
    pub fn send_next(&mut self, send: impl FnOnce(&[u8])) {
        if let Some(frame) = queue::front(&self.sent) {
            send(frame);
            let _ = queue::take(&mut self.sent);
        }
    }

    /// Whether there is news about the headers to use.
    #[inline]
    pub fn has_path_news(&self) -> bool {
        self.paths.ready()
    }

    /// News about the headers to use: the inner `None` when there are none any more.
    pub fn next_path(&mut self) -> Option<Option<UdpRepr>> {
        queue::take(&mut self.paths)
    }

    /// Frames for the stack that were too long or found no room.
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }
}

/// Whether a frame is EtherCAT's: its own type, or UDP to or from its port. Only packets without options are looked into;
/// the exchange refuses others.
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
