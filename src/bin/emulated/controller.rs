//! A stand-in for the library's controller: two telegrams a millisecond that say nothing, and a link that echoes.

use core::future::pending;
use core::task::{Context, Waker};
use embassy_net_driver::{Driver, RxToken, TxToken};
use heapless::spsc::{Consumer, Producer, Queue};

const QUEUE: usize = 512;
const TELEGRAM_BYTES: usize = 100;
const INPUT: u8 = 0;
const OUTPUT: u8 = 1;
const PREDICTED_OUTPUT: u8 = 2;

pub(crate) struct Channels {
    received: Queue<u8, QUEUE>,
    to_send: Queue<u8, QUEUE>,
}

pub(crate) struct Parts<'a> {
    pub(crate) sampler: Sampler<'a>,
    pub(crate) trajectory: TrajectoryTask<'a>,
    pub(crate) link: LinkTask<'a>,
    pub(crate) host_bytes: HostBytes<'a>,
    pub(crate) supervisor: Supervisor<'a>,
}

type Life<'a> = core::marker::PhantomData<&'a ()>;

pub(crate) struct Sampler<'a> {
    sequence: u32,
    output_sent: bool,
    life: Life<'a>,
}

pub(crate) struct TrajectoryTask<'a>(Life<'a>);

pub(crate) struct LinkTask<'a> {
    received: Consumer<'a, u8>,
    to_send: Producer<'a, u8>,
}

pub(crate) struct HostBytes<'a> {
    received: Producer<'a, u8>,
    to_send: Consumer<'a, u8>,
}

pub(crate) struct Supervisor<'a>(Life<'a>);

impl Channels {
    pub(crate) const fn new() -> Self {
        Self {
            received: Queue::new(),
            to_send: Queue::new(),
        }
    }

    pub(crate) fn split(&mut self, _board: &'static str) -> Parts<'_> {
        let (received, link_received) = self.received.split();
        let (link_to_send, to_send) = self.to_send.split();
        Parts {
            sampler: Sampler {
                sequence: 0,
                output_sent: false,
                life: Life::default(),
            },
            trajectory: TrajectoryTask(Life::default()),
            link: LinkTask {
                received: link_received,
                to_send: link_to_send,
            },
            host_bytes: HostBytes { received, to_send },
            supervisor: Supervisor(Life::default()),
        }
    }
}

impl Sampler<'_> {
    pub(crate) fn sample(&mut self, device: &mut impl Driver, _elapsed_ns: u32) -> bool {
        self.sequence = self.sequence.wrapping_add(1);
        self.output_sent = false;
        self.send(device, INPUT);
        self.sequence.is_multiple_of(12)
    }

    pub(crate) fn bus_frame(&mut self, device: &mut impl Driver, _elapsed_ns: u32) {
        let mut context = Context::from_waker(Waker::noop());
        let mut input = false;
        while let Some((received, _)) = device.receive(&mut context) {
            let expected = self.sequence.to_le_bytes();
            input |=
                received.consume(|frame| frame.get(14) == Some(&INPUT) && frame.get(16..20) == Some(&expected[..]));
        }
        if input && !self.output_sent {
            self.output_sent = true;
            self.send(device, OUTPUT);
        }
    }

    pub(crate) fn bus_deadline(&mut self, device: &mut impl Driver, _elapsed_ns: u32) {
        if !self.output_sent {
            self.output_sent = true;
            self.send(device, PREDICTED_OUTPUT);
        }
    }

    fn send(&self, device: &mut impl Driver, kind: u8) {
        let mut context = Context::from_waker(Waker::noop());
        if let Some(token) = device.transmit(&mut context) {
            let head = [0x88, 0xa4, kind, 0];
            token.consume(TELEGRAM_BYTES, |frame| {
                frame.fill(0);
                for (place, byte) in frame[12..]
                    .iter_mut()
                    .zip(head.into_iter().chain(self.sequence.to_le_bytes()))
                {
                    *place = byte;
                }
            });
        }
    }
}

impl TrajectoryTask<'_> {
    pub(crate) fn release(&mut self) {
        cortex_m::asm::delay(100_000);
    }
}

impl LinkTask<'_> {
    pub(crate) fn tick(&mut self) {
        while let Some(byte) = self.received.dequeue() {
            // An echo that finds no room is lost, as on a wire.
            let _ = self.to_send.enqueue(byte);
        }
    }
}

impl HostBytes<'_> {
    pub(crate) fn received(&mut self, bytes: &[u8]) {
        for byte in bytes {
            // As above.
            let _ = self.received.enqueue(*byte);
        }
    }

    #[allow(clippy::wrong_self_convention)] // the name of the queue it empties
    pub(crate) fn to_send(&mut self, buffer: &mut [u8]) -> usize {
        let mut length = 0;
        for place in buffer {
            let Some(byte) = self.to_send.dequeue() else {
                break;
            };
            *place = byte;
            length += 1;
        }
        length
    }
}

impl Supervisor<'_> {
    pub(crate) async fn run(&mut self) -> ! {
        pending().await
    }
}
