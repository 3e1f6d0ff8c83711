//! The task that runs the stack: determines address and next hop and passes both to the critical side.
//!
//! Like the supervisor it uses no waker: it is polled once a millisecond.
//!
//! Invariant: the critical side has a path only while the stack has an address and has resolved the next hop within the
//! last [`PATH_LIFE_MS`].

use super::Frame;
use super::port::StackPort;
use crate::config::HostAddress;
use crate::config::NetworkSettings;
use crate::ethercat::wire::{MacAddress, UDP_PORT, UdpRepr};
use crate::robot_bus::MASTER_ADDRESS;
use core::cell::Cell;
use core::future::{Future, poll_fn};
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{Config, ConfigV4, Ipv4Cidr, StackResources, StaticConfigV4};
use heapless::spsc::{Consumer, Producer};

/// Time between two datagrams that ask the stack for the path, ms.
pub const PROBE_PERIOD_MS: u32 = 250;
/// How long a path stays valid without an answer, ms: several repetitions of ARP, which come once a second.
pub const PATH_LIFE_MS: u32 = 5_000;
/// Sockets of the stack: DHCP's and the one for the segment.
const SOCKETS: usize = 2;
/// Content of the datagram that is never sent: an EtherCAT header without datagrams.
const PROBE: [u8; 2] = [0x00, 0x10];

/// Body of the network task.
pub struct NetworkTask<'a> {
    received: Consumer<'a, Frame>,
    sent: Producer<'a, Frame>,
    paths: Producer<'a, Option<UdpRepr>>,
    settings: Consumer<'a, Option<NetworkSettings>>,
    address: MacAddress,
    told: Option<UdpRepr>,
}

impl<'a> NetworkTask<'a> {
    pub(super) const fn new(
        received: Consumer<'a, Frame>,
        sent: Producer<'a, Frame>,
        paths: Producer<'a, Option<UdpRepr>>,
        settings: Consumer<'a, Option<NetworkSettings>>,
    ) -> Self {
        Self {
            received,
            sent,
            paths,
            settings,
            address: MASTER_ADDRESS,
            told: None,
        }
    }

    /// Sets the port's own Ethernet address; call it before [`Self::run`].
    pub fn set_hardware_address(&mut self, address: MacAddress) {
        self.address = address;
    }

    /// Runs the task and never returns. Poll the future once a millisecond.
    pub async fn run(&mut self) -> ! {
        let mut settings = None;
        loop {
            settings = match settings {
                Some(settings) => self.serve(settings).await,
                None => self.idle().await,
            };
        }
    }

    /// Waits without a stack for settings that need one; discards frames meanwhile.
    async fn idle(&mut self) -> Option<NetworkSettings> {
        poll_fn(|_| {
            while self.received.dequeue().is_some() {}
            self.tell(None);
            match self.settings.dequeue() {
                Some(settings) => Poll::Ready(settings),
                None => Poll::Pending,
            }
        })
        .await
    }

    /// Runs a stack until the settings change.
    async fn serve(&mut self, settings: NetworkSettings) -> Option<NetworkSettings> {
        let path = Cell::new(None);
        let seed = self.address.iter().fold(0, |seed, byte| seed << 8 | u64::from(*byte));
        let mut resources = StackResources::<SOCKETS>::new();
        let port = StackPort {
            received: &mut self.received,
            sent: &mut self.sent,
            path: &path,
            address: self.address,
        };
        let (stack, mut runner) = embassy_net::new(port, stack_config(&settings), &mut resources, seed);
        let (mut meta_in, mut meta_out) = ([PacketMetadata::EMPTY; 1], [PacketMetadata::EMPTY; 1]);
        let (mut bytes_in, mut bytes_out) = ([0; PROBE.len()], [0; PROBE.len()]);
        let mut socket = UdpSocket::new(stack, &mut meta_in, &mut bytes_in, &mut meta_out, &mut bytes_out);
        // The port is free: this is the only socket of the kind.
        let _ = socket.bind(UDP_PORT);
        let mut run = pin!(runner.run());
        let mut news = News {
            paths: &mut self.paths,
            told: &mut self.told,
        };
        let (mut probe_ms, mut age_ms) = (0_u32, PATH_LIFE_MS);
        poll_fn(|_| {
            if let Some(settings) = self.settings.dequeue() {
                return Poll::Ready(settings);
            }
            let mut context = Context::from_waker(Waker::noop());
            if probe_ms == 0 {
                probe_ms = PROBE_PERIOD_MS;
                // Refused while the last probe still waits for its next hop.
                let _ = socket.poll_send_to(&PROBE, (settings.segment, UDP_PORT), &mut context);
            }
            probe_ms -= 1;
            // The stack's own future never ends.
            let _ = run.as_mut().poll(&mut context);
            age_ms = age_ms.saturating_add(1);
            let fresh = path.take();
            if fresh.is_some() {
                age_ms = 0;
            }
            if !stack.is_config_up() || age_ms >= PATH_LIFE_MS {
                news.tell(None);
            } else if fresh.is_some() {
                news.tell(fresh);
            }
            Poll::Pending
        })
        .await
    }

    fn tell(&mut self, path: Option<UdpRepr>) {
        News {
            paths: &mut self.paths,
            told: &mut self.told,
        }
        .tell(path);
    }
}

/// State that the critical side knows.
struct News<'n, 'a> {
    paths: &'n mut Producer<'a, Option<UdpRepr>>,
    told: &'n mut Option<UdpRepr>,
}

impl News<'_, '_> {
    /// Reports a changed path; if the queue is full, tries again in the next millisecond.
    fn tell(&mut self, path: Option<UdpRepr>) {
        if path != *self.told && self.paths.enqueue(path).is_ok() {
            *self.told = path;
        }
    }
}

fn stack_config(settings: &NetworkSettings) -> Config {
    let mut config = Config::default();
    config.ipv4 = match settings.address {
        HostAddress::Dhcp => ConfigV4::Dhcp(Default::default()),
        HostAddress::Fixed { address, prefix } => ConfigV4::Static(StaticConfigV4 {
            address: Ipv4Cidr::new(address, prefix),
            gateway: settings.gateway,
            dns_servers: Default::default(),
        }),
    };
    config
}
