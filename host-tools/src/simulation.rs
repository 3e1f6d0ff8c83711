//! The complete cell in virtual time in one process: the firmware's task bodies with the virtual cell.
//!
//! A millisecond of a board is a sequence of calls here, in the order of the board's priorities; the task bodies are
//! those of a board. Nothing waits for a clock, so a run is as fast as the computer, and its result is identical on
//! every computer.

mod stack;

use crate::emulator::Segment;
use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState, RxToken, TxToken};
use etherpen::black_box::{Keep, Memory, NoFrames};
use etherpen::board::{BoardState, EmergencyStopInput, Interlock};
use etherpen::control::feedback::COMPARISONS;
use etherpen::controller::{Channels, Parts};
use etherpen::ethercat::cyclic::BusCounters;
use etherpen::ethercat::frame_port::FramePort;
use std::collections::VecDeque;
use std::future::Future;
use std::task::{Context, Poll, Waker};

/// Most bytes to and from the firmware in one millisecond, in each direction.
pub const LINE_BYTES_PER_MS: usize = etherpen::link::device::LINE_BYTES_PER_MS;
/// Length of an uncorrected millisecond, ns.
const MILLISECOND_NS: u64 = 1_000_000;
/// Arrival of the reply after a telegram, us.
const ROUND_TRIP_US: u64 = 50;
/// Deadline for the input reply after the release, us.
const DEADLINE_US: u64 = 300;

/// Conditions of a board other than bus and link.
#[derive(Clone, Copy, Debug, Default)]
pub struct Surroundings {
    /// Whether the emergency-stop input reads open.
    pub stop_shows_open: bool,
    /// Whether the board runs on its substitute clock.
    pub substitute_clock: bool,
    /// Whether the trajectory task is prevented from running.
    pub trajectory_waits: bool,
    /// State of the board.
    pub board: BoardState,
}

/// The host's end of the link.
pub trait Host {
    /// Takes the firmware's bytes of a millisecond, before [`milliseconds`] pauses and [`Self::exchange`] follows.
    fn hear(&mut self, _ms: u32, _from_firmware: &[u8]) {}

    /// Advances by one millisecond: takes the firmware's bytes and appends at most `room` bytes for the firmware.
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize);

    /// Takes the counters of the bus exchange at the end of a millisecond, before the last telegrams are settled.
    fn counted(&mut self, _counters: &BusCounters) {}

    /// Takes the share of its limit that each comparison of the position feedback has used by the end of a millisecond.
    fn feedback_used(&mut self, _used: [f32; COMPARISONS.len()]) {}

    /// Takes the black box at the end of a millisecond.
    fn recorded(&mut self, _black_box: &Memory) {}

    /// Conditions of the board in this millisecond.
    fn surroundings(&mut self) -> Surroundings {
        Surroundings::default()
    }

    /// Whether the run is over.
    fn is_over(&self) -> bool;
}

/// A network interface whose wire is the virtual segment.
struct Wire<'c> {
    cell: &'c mut dyn Segment,
    time_ns: u64,
    arrived: VecDeque<Vec<u8>>,
}

struct Arrived(Vec<u8>);

impl RxToken for Arrived {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(mut self, take: F) -> R {
        take(&mut self.0)
    }
}

struct Departing<'w, 'c>(&'w mut Wire<'c>);

impl TxToken for Departing<'_, '_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, fill: F) -> R {
        let mut frame = vec![0; length];
        let result = fill(&mut frame);
        let replies = self.0.cell.frame_at_ns(self.0.time_ns, &frame);
        self.0.arrived.extend(replies);
        result
    }
}

impl<'c> Driver for Wire<'c> {
    type RxToken<'a>
        = Arrived
    where
        Self: 'a;
    type TxToken<'a>
        = Departing<'a, 'c>
    where
        Self: 'a;

    fn receive(&mut self, _: &mut Context) -> Option<(Arrived, Departing<'_, 'c>)> {
        let frame = self.arrived.pop_front()?;
        Some((Arrived(frame), Departing(self)))
    }

    fn transmit(&mut self, _: &mut Context) -> Option<Departing<'_, 'c>> {
        Some(Departing(self))
    }

    fn link_state(&mut self, _: &mut Context) -> LinkState {
        LinkState::Up
    }

    fn capabilities(&self) -> Capabilities {
        let mut capabilities = Capabilities::default();
        capabilities.max_transmission_unit = 1_514;
        capabilities
    }

    fn hardware_address(&self) -> HardwareAddress {
        HardwareAddress::Ethernet([0x10, 0, 0, 0, 0, 1])
    }
}

/// Runs the firmware's tasks with the cell until the host reports that the run is over or `limit_ms` have passed.
///
/// Returns the virtual milliseconds that have passed.
pub fn run(cell: &mut dyn Segment, host: &mut dyn Host, limit_ms: u32) -> u32 {
    let mut running = std::pin::pin!(milliseconds(cell, host, limit_ms));
    loop {
        if let Poll::Ready(passed_ms) = running.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            return passed_ms;
        }
    }
}

/// As [`run`], and pauses once in each millisecond: whoever polls it decides between two polls, with what
/// [`Host::hear`] was told, what [`Host::exchange`] answers. A caller that leads the robot step by step needs no second
/// thread.
pub async fn milliseconds(cell: &mut dyn Segment, host: &mut dyn Host, limit_ms: u32) -> u32 {
    let black_box = Box::new(Memory::new());
    black_box.start(Keep::Nothing);
    let mut channels = Box::new(Channels::new());
    let Parts {
        mut sampler,
        mut recorder,
        mut trajectory,
        mut host_bytes,
        // The host uses the serial line.
        usb_bytes: _,
        mut link,
        mut supervisor,
        mut network,
        // Virtual time has no durations.
        measurements: _,
    } = channels.split("simulation", &black_box);
    let mut transport = FramePort::new(Wire {
        cell,
        time_ns: 0,
        arrived: VecDeque::new(),
    });
    let no_frames = NoFrames::default();
    let mut watch = std::pin::pin!(supervisor.run());
    let mut network = std::pin::pin!(network.run());
    let mut to_firmware = Vec::new();
    let mut from_firmware = [0; LINE_BYTES_PER_MS];
    let mut release_ns = 0;
    // Releases merge while one is pending, as those of an interrupt do.
    let mut trajectory_due = false;
    let mut emergency_stop = EmergencyStopInput::new();
    for ms in 1..=limit_ms {
        let period_ns = MILLISECOND_NS.saturating_add_signed(sampler.take_timer_correction_ns().into());
        release_ns += period_ns;
        transport.driver_mut().time_ns = release_ns;
        transport.driver_mut().cell.advance_to(release_ns / 1_000);
        let around = host.surroundings();
        let stopped = emergency_stop.step(around.stop_shows_open);
        sampler.set_interlock(Interlock::of(stopped, around.substitute_clock));
        link.set_board(around.board);
        trajectory_due |= sampler.sample(&mut transport, 0, 0);
        for time_us in [ROUND_TRIP_US, 2 * ROUND_TRIP_US] {
            transport.driver_mut().time_ns = release_ns + time_us * 1_000;
            sampler.bus_frame(&mut transport, (time_us * 1_000) as u32);
        }
        transport.driver_mut().time_ns = release_ns + DEADLINE_US * 1_000;
        sampler.bus_deadline(&mut transport, (DEADLINE_US * 1_000) as u32);
        sampler.bus_frame(&mut transport, ((DEADLINE_US + ROUND_TRIP_US) * 1_000) as u32);
        host.counted(&sampler.bus_counters());
        host.feedback_used(sampler.feedback_used());

        let sent = host_bytes.to_send(&mut from_firmware);
        host.hear(ms, &from_firmware[..sent]);
        pause().await;
        host.exchange(ms, &from_firmware[..sent], &mut to_firmware, LINE_BYTES_PER_MS);
        host_bytes.received(&to_firmware);
        to_firmware.clear();
        if trajectory_due && !around.trajectory_waits {
            trajectory.release();
            trajectory_due = false;
        }
        recorder.tick(&no_frames);
        link.tick();
        host.recorded(&black_box);
        let poll = watch.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        debug_assert_eq!(poll, Poll::Pending, "the supervisor never ends");
        let poll = stack::poll(network.as_mut(), ms);
        debug_assert_eq!(poll, Poll::Pending, "the IP stack never ends");
        if host.is_over() {
            return ms;
        }
    }
    limit_ms
}

/// Returns to whoever polls, once.
async fn pause() {
    let mut paused = false;
    std::future::poll_fn(|_| match std::mem::replace(&mut paused, true) {
        true => Poll::Ready(()),
        false => Poll::Pending,
    })
    .await;
}
