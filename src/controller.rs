//! The controller as a board sees it: eight task bodies and the lock-free channels between them.
//!
//! A board owns one [`Channels`], splits it once and gives each part to the task of the same name: `sampler` to the
//! three critical tasks, `recorder` to the task that fills the black box, `trajectory` to the 12 ms task, `host_bytes`
//! to the task that moves the link's bytes,
//! `usb_bytes` to the task that moves the link's bytes on the board's own USB, `link` to the low-priority task that
//! runs the protocol and the coordinator, `network` to the task that runs the IP stack, `supervisor` to the task
//! that brings up and watches the bus. A simulation calls these parts in the same order in virtual time.
//!
//! Architecture invariant: priorities communicate only through these channels; no part waits for another.

use crate::black_box::{EventLog, Memory, Recorder};
use crate::control::sampler::{CycleReport, Queued, Sampler, SamplerCommand};
use crate::coordinator::CoordinatorEnds;
use crate::link::device::Identity;
use crate::link::frame::Decoder;
use crate::link_task::{LinkTask, PortEnds, Ports, SENT_AHEAD_BYTES};
use crate::measurement::Measurements;
use crate::messages::DeviceEndpoint;
use crate::motion::Trajectory;
use crate::network::{NetworkEnd, NetworkQueues, NetworkTask};
use crate::robot_bus::{MASTER_ADDRESS, RobotBusQueues, RobotExchange, RobotExchangeEnd, RobotGroup, RobotSupervisor};
use crate::trajectory_task::{MotionOrder, MotionReport, PathItem, TrajectoryTask};
use core::mem::MaybeUninit;
use heapless::spsc::{Consumer, Producer, Queue};

/// Setpoints between the trajectory task and the sampler: the period being read, the next one, and a spare.
pub const SETPOINTS: usize = 40;
/// Cycle reports queued for the recorder, which only the critical tasks and the link's bytes delay.
pub const NEW_REPORTS: usize = 5;
/// Cycle reports queued for the link task: one for each millisecond that the trajectory task may delay the link task.
pub const REPORTS: usize = 33;
/// Vertices queued between the coordinator and the trajectory task.
pub const VERTICES: usize = 513;
/// Bytes received from the host that are queued for the link task.
pub const RECEIVED_BYTES: usize = 4_097;
/// Bytes queued for the line to the host.
pub const SENT_BYTES: usize = 4_097;
/// Bytes received on USB that are queued for the link task: one millisecond at full rate. USB holds the host back by
/// itself while nobody takes its bytes.
pub const USB_RECEIVED_BYTES: usize = 1_025;
/// Bytes queued for the host on USB.
pub const USB_SENT_BYTES: usize = 257;

const _: () = assert!(SETPOINTS > 3 * crate::motion::PERIOD_MS);
const _: () = assert!(SETPOINTS + 20 <= crate::application::FOLLOWED_MS as usize);
const _: () = assert!(REPORTS > 2 * crate::motion::PERIOD_MS);
const _: () = assert!(SENT_BYTES > SENT_AHEAD_BYTES && USB_SENT_BYTES > SENT_AHEAD_BYTES);

/// All queues between the tasks, and the planner's memory. Large objects stay in here and are never moved.
pub struct Channels {
    trajectory: Trajectory,
    setpoints: Queue<Queued, SETPOINTS>,
    new_reports: Queue<CycleReport, NEW_REPORTS>,
    reports: Queue<CycleReport, REPORTS>,
    sampler_commands: Queue<SamplerCommand, 17>,
    vertices: Queue<PathItem, VERTICES>,
    motion_orders: Queue<MotionOrder, 17>,
    motion_reports: Queue<MotionReport, 5>,
    bus: RobotBusQueues,
    network: NetworkQueues,
    received: Queue<u8, RECEIVED_BYTES>,
    sent: Queue<u8, SENT_BYTES>,
    endpoint: DeviceEndpoint,
    decoder: Decoder,
    usb_received: Queue<u8, USB_RECEIVED_BYTES>,
    usb_sent: Queue<u8, USB_SENT_BYTES>,
    usb_decoder: Decoder,
    measurements: Measurements,
}

/// The bodies of a board's tasks.
pub struct Parts<'a> {
    /// For the three critical tasks.
    pub sampler: Sampler<'a>,
    /// For the task that fills the black box and hands the reports on.
    pub recorder: Recorder<'a>,
    /// For the 12 ms task.
    pub trajectory: TrajectoryTask<'a>,
    /// For the task that moves the link's bytes.
    pub host_bytes: HostBytes<'a>,
    /// For the task that moves the link's bytes on the board's own USB, if it has one.
    pub usb_bytes: HostBytes<'a>,
    /// For the task that runs the link's protocol.
    pub link: LinkTask<'a>,
    /// For the task that runs the IP stack, for EtherCAT in UDP.
    pub network: NetworkTask<'a>,
    /// For the task that brings up and watches the bus.
    pub supervisor: RobotSupervisor<'a>,
    /// Where a board's tasks record their execution times.
    pub measurements: &'a Measurements,
}

impl Default for Channels {
    fn default() -> Self {
        Self::new()
    }
}

impl Channels {
    /// Empty channels.
    pub const fn new() -> Self {
        Self {
            trajectory: Trajectory::unconfigured(),
            setpoints: Queue::new(),
            new_reports: Queue::new(),
            reports: Queue::new(),
            sampler_commands: Queue::new(),
            vertices: Queue::new(),
            motion_orders: Queue::new(),
            motion_reports: Queue::new(),
            bus: RobotBusQueues::new(),
            network: NetworkQueues::new(),
            received: Queue::new(),
            sent: Queue::new(),
            endpoint: DeviceEndpoint::new(Identity {
                firmware: env!("CARGO_PKG_VERSION"),
                board: "",
                capacity: VERTICES as u16 - 1,
            }),
            decoder: Decoder::new(),
            usb_received: Queue::new(),
            usb_sent: Queue::new(),
            usb_decoder: Decoder::new(),
            measurements: Measurements::new(),
        }
    }

    /// Makes the task bodies in their place, so that they lie on the stack once only; the rest as [`Self::split`].
    #[inline(never)]
    pub fn split_into<'a>(
        &'a mut self,
        board: &'static str,
        black_box: &'a Memory,
        place: &'a mut MaybeUninit<Parts<'a>>,
    ) -> &'a mut Parts<'a> {
        place.write(self.split(board, black_box))
    }

    /// Makes the task bodies; `board` is the name the firmware reports to the host, `black_box` the memory that
    /// survives a reset, started.
    #[inline(always)]
    pub fn split<'a>(&'a mut self, board: &'static str, black_box: &'a Memory) -> Parts<'a> {
        self.endpoint.set_board(board);
        let (setpoints_in, setpoints_out) = self.setpoints.split();
        let (new_reports_in, new_reports_out) = self.new_reports.split();
        let (reports_in, reports_out) = self.reports.split();
        let (sampler_commands_in, sampler_commands_out) = self.sampler_commands.split();
        let (vertices_in, vertices_out) = self.vertices.split();
        let (orders_in, orders_out) = self.motion_orders.split();
        let (motion_reports_in, motion_reports_out) = self.motion_reports.split();
        let (exchange_end, supervisor_end, bus) = self.bus.split();
        let (network_end, network, network_settings) = self.network.split();
        let (received_in, received_out) = self.received.split();
        let (sent_in, sent_out) = self.sent.split();
        let (usb_received_in, usb_received_out) = self.usb_received.split();
        let (usb_sent_in, usb_sent_out) = self.usb_sent.split();
        let measurements = &self.measurements;
        Parts {
            sampler: sampler(
                exchange_end,
                network_end,
                sampler_commands_out,
                setpoints_out,
                new_reports_in,
            ),
            recorder: Recorder::new(black_box, new_reports_out, reports_in),
            trajectory: TrajectoryTask::new(
                &mut self.trajectory,
                orders_out,
                vertices_out,
                setpoints_in,
                motion_reports_in,
            ),
            host_bytes: HostBytes {
                received: received_in,
                sent: sent_out,
                lost: 0,
            },
            usb_bytes: HostBytes {
                received: usb_received_in,
                sent: usb_sent_out,
                lost: 0,
            },
            link: LinkTask::new(
                &mut self.endpoint,
                Ports {
                    serial: PortEnds {
                        received: received_out,
                        decoder: &mut self.decoder,
                        sent: sent_in,
                    },
                    usb: PortEnds {
                        received: usb_received_out,
                        decoder: &mut self.usb_decoder,
                        sent: usb_sent_in,
                    },
                },
                CoordinatorEnds {
                    reports: reports_out,
                    sampler_commands: sampler_commands_in,
                    vertices: vertices_in,
                    motion_orders: orders_in,
                    motion_reports: motion_reports_out,
                    bus,
                    network: network_settings,
                    measurements,
                },
                EventLog::new(black_box),
            ),
            network,
            supervisor: RobotSupervisor::new(supervisor_end),
            measurements,
        }
    }
}

/// The sampler over the robot's bus. Not inlined, so that its parts do not lie on the stack while the others are made.
#[inline(never)]
fn sampler<'a>(
    exchange: RobotExchangeEnd<'a>,
    network: NetworkEnd<'a>,
    commands: Consumer<'a, SamplerCommand>,
    setpoints: Consumer<'a, Queued>,
    reports: Producer<'a, CycleReport>,
) -> Sampler<'a> {
    let group = RobotGroup::new(RobotExchange::new(exchange, MASTER_ADDRESS));
    Sampler::new(group, network, commands, setpoints, reports)
}

/// Moves the link's bytes between a line's interrupt and the link task.
pub struct HostBytes<'a> {
    received: Producer<'a, u8>,
    sent: Consumer<'a, u8>,
    lost: u32,
}

impl HostBytes<'_> {
    /// Queues bytes received from the line; returns how many fitted. The rest is lost and the link retransmits it.
    pub fn received(&mut self, bytes: &[u8]) -> usize {
        let taken = bytes
            .iter()
            .take_while(|byte| self.received.enqueue(**byte).is_ok())
            .count();
        self.lost = self.lost.wrapping_add((bytes.len() - taken) as u32);
        taken
    }

    /// How many received bytes can be queued now.
    pub fn room(&self) -> usize {
        self.received.capacity() - self.received.len()
    }

    /// Discards the bytes queued for a line that nobody reads.
    pub fn discard(&mut self) {
        while self.sent.dequeue().is_some() {}
    }

    /// Fills `bytes` with bytes queued for the line; returns how many.
    pub fn to_send(&mut self, bytes: &mut [u8]) -> usize {
        let mut count = 0;
        for (slot, byte) in bytes.iter_mut().zip(core::iter::from_fn(|| self.sent.dequeue())) {
            *slot = byte;
            count += 1;
        }
        count
    }

    /// Number of received bytes that were lost because the queue was full.
    pub fn lost(&self) -> u32 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::boxed::Box;

    #[test]
    fn received_bytes_that_find_no_room_are_counted_and_those_before_them_are_kept() {
        let channels = Box::leak(Box::new(Channels::new()));
        let mut parts = channels.split("test", Box::leak(Box::new(Memory::new())));
        let chunk = [0x55; 100];
        let mut taken = 0;
        for _ in 0..50 {
            taken += parts.host_bytes.received(&chunk);
        }
        assert_eq!(taken, RECEIVED_BYTES - 1);
        assert_eq!(parts.host_bytes.lost() as usize, 50 * chunk.len() - taken);
        assert_eq!(parts.host_bytes.received(&chunk), 0, "nobody has taken any");
        parts.link.tick();
        assert_eq!(parts.host_bytes.received(&[0]), 1, "the link task takes what has come");
    }
}
