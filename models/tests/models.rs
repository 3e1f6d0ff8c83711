//! Every order of events between the two sides of everything that is shared without a lock.

use etherpen_models::atomic::{AtomicU32, Ordering};
use etherpen_models::descriptors::{Descriptor, Place, ReceiveRing, Received, TransmitRing};
use etherpen_models::interrupted::explore;
use etherpen_models::spsc::{Producer, Queue};
use etherpen_models::{interrupted_measurement, measurement, overruns, queue};
use loom::cell::UnsafeCell;
use loom::model::Builder;
use loom::thread;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

/// Runs a model in all orders; prints how many there were.
fn model(name: &str, body: impl Fn() + Sync + Send + 'static) {
    let mut builder = Builder::new();
    builder.max_branches = 20_000;
    let executions = Arc::new(AtomicUsize::new(0));
    let counted = executions.clone();
    builder.check(move || {
        counted.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        body();
    });
    println!("{name}: {executions:?} executions");
}

const ENTRIES: u32 = 3;

fn produce(mut end: Producer<'static, u32>) {
    let mut next = 1;
    while next <= ENTRIES {
        let room = queue::has_room_for(&end, 1);
        match next % 2 {
            0 => next += u32::from(queue::put(&mut end, next).is_ok()),
            _ => next += u32::from(queue::put_copy(&mut end, &next)),
        }
        assert!(!room || next > 1, "room that was seen does not vanish");
        thread::yield_now();
    }
}

#[test]
fn entries_arrive_complete_once_and_in_order_by_every_operation() {
    model("queue", || {
        let (producer, mut consumer) = Queue::split(3);
        let producing = thread::spawn(|| produce(producer));
        let mut next = 1;
        while next <= ENTRIES {
            if let Some(front) = queue::front(&consumer).copied() {
                assert_eq!(front, next);
                match next % 2 {
                    0 => assert_eq!(queue::take(&mut consumer), Some(next)),
                    _ => queue::drop_front(&mut consumer),
                }
                next += 1;
            }
            thread::yield_now();
        }
        producing.join().unwrap();
        assert_eq!(queue::take(&mut consumer), None);
    });
}

#[test]
#[should_panic(expected = "Causality violation: Concurrent")]
fn a_look_at_the_front_without_the_fence_is_found() {
    model("queue without its fence", || {
        let (producer, consumer) = Queue::split(3);
        let producing = thread::spawn(|| produce(producer));
        while !consumer.ready() {
            thread::yield_now();
        }
        assert_eq!(consumer.peek(), Some(&1));
        producing.join().unwrap();
    });
}

const RING: usize = 4;
const FRAMES: u32 = 5;
const OWN: u32 = 1 << 31;
const WHOLE: u32 = 1 << 29 | 1 << 28;
const PLACE: Place = Place {
    descriptors: 0,
    buffers: 0x1000,
    buffer_bytes: 64,
};

/// Memory and tail register that the processor and the DMA share.
struct Shared {
    descriptors: [Descriptor; RING],
    buffers: [UnsafeCell<u32>; RING],
    tail: AtomicU32,
}

// The cells are what the descriptors guard; loom checks every access.
unsafe impl Sync for Shared {}
unsafe impl Send for Shared {}

impl Shared {
    fn new() -> &'static Self {
        // loom's objects belong to one execution, so each has memory of its own.
        Box::leak(Box::new(Self {
            descriptors: std::array::from_fn(|_| Descriptor::new()),
            buffers: std::array::from_fn(|_| UnsafeCell::new(0)),
            tail: AtomicU32::new(0),
        }))
    }

    /// Tells the DMA how far it may go.
    fn set_tail(&self, tail: u32) {
        self.tail.store(tail, Ordering::Release);
    }

    /// Whether the DMA may use a descriptor: owned, and not the one at the tail.
    fn is_the_dmas(&self, at: usize) -> bool {
        let tail = self.tail.load(Ordering::Acquire) / 16;
        at != tail as usize && self.descriptors[at].read() & OWN != 0
    }
}

#[test]
fn no_received_frame_is_overwritten_torn_or_read_twice() {
    model("receive ring", || {
        let shared = Shared::new();
        let mut ring = ReceiveRing::start(&shared.descriptors, PLACE);
        shared.set_tail(ring.first_tail());
        let dma = thread::spawn(move || {
            let (mut at, mut frame) = (0, 1);
            while frame <= FRAMES {
                if shared.is_the_dmas(at) {
                    // SAFETY: the descriptor is the DMA's; loom checks it.
                    shared.buffers[at].with_mut(|buffer| unsafe { *buffer = frame });
                    shared.descriptors[at].write_back(WHOLE | 60);
                    (at, frame) = ((at + 1) % RING, frame + 1);
                }
                thread::yield_now();
            }
        });
        let mut frame = 1;
        while frame <= FRAMES {
            if ring.received() == Received::Frame(60) {
                // SAFETY: the descriptor is the processor's; loom checks it.
                let content = shared.buffers[ring.index()].with(|buffer| unsafe { *buffer });
                assert_eq!(content, frame);
                shared.set_tail(ring.give_back());
                frame += 1;
            }
            thread::yield_now();
        }
        dma.join().unwrap();
        assert_eq!(ring.received(), Received::Nothing);
    });
}

#[test]
fn every_frame_to_send_is_sent_once_in_order_and_complete() {
    model("transmit ring", || {
        let shared = Shared::new();
        let mut ring = TransmitRing::start(&shared.descriptors, PLACE);
        shared.set_tail(PLACE.descriptors);
        let dma = thread::spawn(move || {
            let (mut at, mut frame) = (0, 1);
            while frame <= FRAMES {
                if shared.is_the_dmas(at) {
                    // SAFETY: the descriptor is the DMA's; loom checks it.
                    let content = shared.buffers[at].with(|buffer| unsafe { *buffer });
                    assert_eq!(content, frame);
                    shared.descriptors[at].write_back(0);
                    (at, frame) = ((at + 1) % RING, frame + 1);
                }
                thread::yield_now();
            }
        });
        let mut frame = 1;
        while frame <= FRAMES {
            if ring.has_room() {
                // SAFETY: the descriptor is the processor's; loom checks it.
                shared.buffers[ring.index()].with_mut(|buffer| unsafe { *buffer = frame });
                shared.set_tail(ring.hand_over(60));
                frame += 1;
            }
            thread::yield_now();
        }
        dma.join().unwrap();
    });
}

#[test]
fn a_reader_sees_no_value_that_was_not_recorded_and_in_the_end_all_of_them() {
    use measurement::Histogram;
    model("histogram", || {
        let histogram: &'static Histogram = Box::leak(Box::new(Histogram::new()));
        // loom wants every atomic to exist before the threads do.
        assert_eq!((histogram.count(), histogram.sum(), histogram.largest()), (0, 0, 0));
        assert_eq!(histogram.smallest(), u32::MAX);
        let writer = thread::spawn(|| [3, 5].into_iter().for_each(|value| histogram.record(value)));
        // A thread that yields lets loom try what another one has done before.
        thread::yield_now();
        assert!([0, 3, 5].contains(&histogram.largest()));
        thread::yield_now();
        assert!([u32::MAX, 3].contains(&histogram.smallest()));
        thread::yield_now();
        assert!([0, 3, 8].contains(&histogram.sum()));
        writer.join().unwrap();
        assert_eq!((histogram.largest(), histogram.smallest(), histogram.sum()), (5, 3, 8));
        assert_eq!(histogram.count(), 2);
    });
}

#[test]
fn every_release_of_the_trajectory_task_is_completed_or_still_due() {
    model("releases", || {
        // loom wants every atomic to exist before the threads do.
        assert_eq!(overruns::TRAJECTORIES_DUE.load(Ordering::Relaxed), 0);
        assert_eq!(overruns::TRAJECTORY_OVERRUNS.load(Ordering::Relaxed), 0);
        let sampler = thread::spawn(|| (0..3).for_each(|_| overruns::released()));
        let mut completed = 0;
        for _ in 0..2 {
            thread::yield_now();
            let due = overruns::TRAJECTORIES_DUE.load(Ordering::Relaxed);
            assert!(due <= 3, "more was completed than released");
            if due > 0 {
                overruns::completed(due);
                completed += due;
            }
        }
        sampler.join().unwrap();
        let due = overruns::TRAJECTORIES_DUE.load(Ordering::Relaxed);
        assert_eq!(due + completed, 3);
        assert!(overruns::TRAJECTORY_OVERRUNS.load(Ordering::Relaxed) <= 4);
    });
}

/// Values whose sum passes 32 bits.
const LARGE: u32 = u32::MAX - 9;

#[test]
fn a_sum_that_is_read_while_it_grows_is_a_sum_that_was() {
    use interrupted_measurement::Histogram;
    let start = || {
        let histogram = Rc::new(Histogram::new());
        histogram.record(LARGE);
        histogram
    };
    let large = u64::from(LARGE);
    let executions = explore(
        2,
        start,
        |histogram| histogram.record(20),
        |histogram| histogram.sum(),
        |_, sum, interrupts| {
            let sums: Vec<u64> = (0..=interrupts as u64).map(|count| large + 20 * count).collect();
            assert!(sums.contains(&sum), "{sum} with {interrupts} interrupts");
        },
    );
    println!("sum: {executions} executions");
}

#[test]
fn a_reset_keeps_no_more_than_what_was_recorded_meanwhile() {
    use interrupted_measurement::{MeasurementRequest, Measurements, Quantity};
    let start = || {
        let measurements = Rc::new(Measurements::new());
        measurements.record(Quantity::Sample, LARGE);
        measurements
    };
    let executions = explore(
        1,
        start,
        |measurements| measurements.record(Quantity::Sample, 20),
        |measurements| {
            measurements.answer(MeasurementRequest::Reset);
        },
        |measurements, (), interrupts| {
            let histogram = measurements.histogram(Quantity::Sample);
            let (count, sum) = (histogram.count(), histogram.sum());
            assert!(
                count <= interrupts as u64,
                "{count} values after {interrupts} interrupts"
            );
            assert!(
                sum <= 20 * interrupts as u64,
                "a sum of {sum} after {interrupts} interrupts"
            );
        },
    );
    println!("reset: {executions} executions");
}
