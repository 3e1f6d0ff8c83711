//! A master and the small chain of drives that it controls.

use super::fake::FakeSegment;
use core::pin::pin;
use core::task::{Context, Waker};
use etherpen_drives::ServoDrives;
use etherpen_ethercat::BusQueues;
use etherpen_ethercat::cyclic::{Arrival, Exchange, ExchangeEnd};
use etherpen_ethercat::diagnostics::{ServiceRequest, ServiceResult};
use etherpen_ethercat::event::BusSetup;
use etherpen_ethercat::supervisor::{BusCommand, BusEvent, Supervisor};

/// Four drives.
pub(crate) type Drives = ServoDrives<4>;

/// A bus of four drives.
pub(crate) fn setup() -> BusSetup<Drives> {
    BusSetup {
        members: 4,
        ..BusSetup::default()
    }
}

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
pub(crate) const SLAVES: usize = 16;
pub(crate) const MESSAGE: usize = 1024;
/// Longest script, ms.
const SCRIPT_MS_MAX: u32 = 120_000;

/// Whether the frame with this number is lost.
pub(crate) type Losses = fn(u32) -> bool;

pub(crate) struct Bench<'a> {
    pub(crate) segment: FakeSegment,
    pub(crate) exchange: Exchange<'a, Drives, SLAVES, MESSAGE>,
    pub(crate) losses: Losses,
    pub(crate) frames: u32,
    /// Of them, those that may carry requests.
    pub(crate) first_frames: u32,
    /// Service request that is sent after this millisecond.
    pub(crate) request: Option<ServiceRequest>,
    /// Answer to a service request that has come in this millisecond.
    pub(crate) answer: Option<ServiceResult>,
}

impl<'a> Bench<'a> {
    pub(crate) fn new(segment: FakeSegment, end: ExchangeEnd<'a, Drives, SLAVES, MESSAGE>, losses: Losses) -> Self {
        Self {
            segment,
            exchange: Exchange::new(end, MAC),
            losses,
            frames: 0,
            first_frames: 0,
            request: None,
            answer: None,
        }
    }

    fn transfer(&mut self, mut frame: Vec<u8>) {
        if frame.is_empty() {
            return;
        }
        self.frames += 1;
        // Even frames are lost on the way there, odd ones on the way back.
        let lost = (self.losses)(self.frames);
        if lost && self.frames.is_multiple_of(2) {
            return;
        }
        self.segment.process(&mut frame);
        if !lost {
            let arrival = self.exchange.receive(&frame);
            assert!(matches!(arrival, Arrival::Input | Arrival::Output), "{arrival:?}");
        }
    }

    pub(crate) fn millisecond(&mut self) {
        self.segment.millisecond();
        let frame = self.exchange.input_telegram().to_vec();
        self.first_frames += u32::from(!frame.is_empty());
        self.transfer(frame);
        let frame = self.exchange.output_telegram().to_vec();
        self.transfer(frame);
    }
}

/// Runs `script` with a supervisor that has received a start command; the script gets each millisecond's events.
pub(crate) fn run(segment: FakeSegment, losses: Losses, script: impl FnMut(u32, &mut Bench<'_>, &[BusEvent]) -> Next) {
    run_with(setup(), segment, losses, script);
}

/// Runs `script` with a supervisor that has received a start command with this configuration.
pub(crate) fn run_with(
    setup: BusSetup<Drives>,
    segment: FakeSegment,
    losses: Losses,
    mut script: impl FnMut(u32, &mut Bench<'_>, &[BusEvent]) -> Next,
) {
    let mut queues = Box::new(BusQueues::<Drives, SLAVES, MESSAGE>::new());
    let (exchange_end, supervisor_end, mut application) = queues.split();
    let mut bench = Bench::new(segment, exchange_end, losses);
    let mut supervisor = Supervisor::new(supervisor_end);
    let mut future = pin!(supervisor.run());
    let mut context = Context::from_waker(Waker::noop());
    assert!(application.commands.enqueue(BusCommand::Start(setup)).is_ok());
    for now_ms in 0..SCRIPT_MS_MAX {
        bench.millisecond();
        assert!(future.as_mut().poll(&mut context).is_pending());
        let events: Vec<_> = core::iter::from_fn(|| application.events.dequeue()).collect();
        bench.answer = application.answers.dequeue();
        let next = script(now_ms, &mut bench, &events);
        if let Some(request) = bench.request.take() {
            assert!(application.services.enqueue(request).is_ok());
        }
        match next {
            Next::On => {}
            Next::Recover => assert!(application.commands.enqueue(BusCommand::Recover).is_ok()),
            Next::Done => return,
        }
    }
    panic!("the script did not end within {SCRIPT_MS_MAX} ms");
}

pub(crate) enum Next {
    On,
    Recover,
    Done,
}
