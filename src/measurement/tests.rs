//! Histograms, pieces and the stamps of a period.

use super::*;
use std::vec::Vec as Values;

#[test]
fn bins_are_monotone_and_leave_no_gap() {
    for bin in 0..BINS {
        let (from, to) = (lower_bound(bin), lower_bound(bin + 1));
        assert!(from < to, "bin {bin}: {from} to {to}");
        assert_eq!(bin_of(from), bin, "lower bound {from}");
        assert_eq!(bin_of(to - 1), bin, "upper bound {}", to - 1);
        assert!(to - from == 1 || (to - from) * 8 <= from, "bin {bin} is too wide");
    }
}

#[test]
fn values_beyond_the_last_bin_are_counted_in_it() {
    let last = BINS - 1;
    for value in [1 << VALUE_BITS, u32::MAX / 2, u32::MAX] {
        assert_eq!(bin_of(value), last);
    }
}

#[test]
fn no_value_is_lost_and_the_extremes_and_the_sum_are_exact() {
    let histogram = Histogram::new();
    let values: Values<u32> = (0..40_000_u32)
        .map(|k| k.wrapping_mul(2_654_435_761) >> (k % 32))
        .collect();
    values.iter().for_each(|value| histogram.record(*value));
    assert_eq!(histogram.count(), values.len() as u64);
    assert_eq!(Some(histogram.largest()), values.iter().copied().max());
    assert_eq!(Some(histogram.smallest()), values.iter().copied().min());
    assert_eq!(
        histogram.sum(),
        values.iter().map(|value| u64::from(*value)).sum::<u64>()
    );
}

/// Reads a whole histogram the way a host does.
fn read(measurements: &Measurements, quantity: Quantity) -> (Values<(u8, u32)>, usize) {
    let (mut bins, mut first, mut pieces) = (Values::new(), Some(0), 0);
    while let Some(bin) = first {
        let request = MeasurementRequest::Read { quantity, first: bin };
        let MeasurementAnswer::Piece(piece) = measurements.answer(request) else {
            panic!("a piece was asked for");
        };
        bins.extend(piece.bins.iter().copied());
        first = piece.next;
        pieces += 1;
    }
    (bins, pieces)
}

#[test]
fn the_pieces_of_a_histogram_are_the_histogram() {
    let measurements = Measurements::new();
    for bin in 0..BINS {
        for _ in 0..=bin {
            measurements.record(Quantity::BusFrame, lower_bound(bin));
        }
    }
    let (bins, pieces) = read(&measurements, Quantity::BusFrame);
    let expected: Values<(u8, u32)> = (0..BINS).map(|bin| (bin as u8, bin as u32 + 1)).collect();
    assert_eq!(bins, expected);
    assert_eq!(pieces, BINS.div_ceil(BINS_PER_PIECE));
    assert_eq!(read(&measurements, Quantity::Sample), (Values::new(), 1));
}

#[test]
fn a_reset_leaves_nothing() {
    let measurements = Measurements::new();
    Quantity::ALL
        .iter()
        .for_each(|quantity| measurements.record(*quantity, 77));
    assert_eq!(measurements.answer(MeasurementRequest::Reset), MeasurementAnswer::Done);
    for quantity in Quantity::ALL {
        let histogram = measurements.histogram(quantity);
        assert_eq!((histogram.count(), histogram.largest(), histogram.sum()), (0, 0, 0));
        assert_eq!(histogram.smallest(), u32::MAX);
    }
}

#[test]
fn quantities_have_histograms_of_their_own() {
    let measurements = Measurements::new();
    for (index, quantity) in Quantity::ALL.iter().enumerate() {
        assert_eq!(*quantity as usize, index);
        measurements.record(*quantity, index as u32);
    }
    for (index, quantity) in Quantity::ALL.iter().enumerate() {
        assert_eq!(measurements.histogram(*quantity).largest(), index as u32);
    }
}

#[test]
fn a_board_that_offers_no_disturbance_refuses_it() {
    let measurements = Measurements::new();
    let request = MeasurementRequest::Disturb {
        bits: disturbance::LOG | disturbance::SERIAL,
    };
    assert_eq!(measurements.answer(request), MeasurementAnswer::NotOffered);
    assert_eq!(measurements.disturbance(), 0);
    measurements.offer_disturbance();
    assert_eq!(measurements.answer(request), MeasurementAnswer::Done);
    assert_eq!(measurements.disturbance(), 3);
}

fn ran(began_at: u32, ended_at: u32, excluded: u32) -> Run {
    Run {
        began_at,
        ended_at,
        excluded,
    }
}

#[test]
fn the_stamps_of_a_period_become_delays_and_executions_across_the_counters_wrap() {
    let measurements = Measurements::new();
    let mut watch = CycleWatch::new(&measurements);
    let start = 0_u32.wrapping_sub(500);
    let at = |counts: u32| start.wrapping_add(counts);
    watch.sample(ran(at(3), at(103), 10), 3, 0);
    watch.bus_frame(ran(at(800), at(1_300), 20), true);
    watch.bus_frame(ran(at(2_000), at(2_050), 0), false);
    watch.bus_deadline(ran(at(7_500), at(7_520), 0), false);
    watch.sample(ran(at(25_004), at(25_104), 10), 4, 24_000);
    let one = |quantity| {
        let histogram = measurements.histogram(quantity);
        (histogram.count(), histogram.smallest(), histogram.largest())
    };
    assert_eq!(one(Quantity::ReleaseDelay), (2, 3, 4));
    assert_eq!(one(Quantity::Period), (1, 25_001, 25_001));
    assert_eq!(one(Quantity::SendDelay), (2, 103, 104));
    assert_eq!(one(Quantity::RoundTrip), (1, 697, 697));
    assert_eq!(one(Quantity::TotalDelay), (1, 1_300, 1_300));
    assert_eq!(one(Quantity::Sample), (2, 90, 90));
    assert_eq!(one(Quantity::BusFrame), (2, 50, 480));
    assert_eq!(one(Quantity::BusDeadline), (1, 20, 20));
    assert_eq!(one(Quantity::CriticalPath), (1, 640, 640));
    assert_eq!(one(Quantity::Awake), (1, 1_001, 1_001));
    assert_eq!(measurements.critical_counts(), 100 + 500 + 50 + 20 + 100);
}

#[test]
fn an_output_sent_by_the_deadline_ends_the_period_without_a_round_trip() {
    let measurements = Measurements::new();
    let mut watch = CycleWatch::new(&measurements);
    watch.sample(ran(0, 100, 0), 0, 0);
    watch.bus_deadline(ran(7_500, 7_900, 0), true);
    watch.bus_frame(ran(8_000, 8_010, 0), true);
    assert_eq!(measurements.histogram(Quantity::RoundTrip).count(), 0);
    assert_eq!(measurements.histogram(Quantity::TotalDelay).largest(), 7_900);
}

#[test]
fn an_output_behind_its_deadline_is_counted_with_its_lateness() {
    let measurements = Measurements::new();
    // 500 counts to the deadline.
    measurements.set_counts_per_s(1_000_000);
    let mut watch = CycleWatch::new(&measurements);
    for (release, sent_at) in [(0, 500), (1_000, 1_512), (2_000, 2_703)] {
        watch.sample(ran(release, release + 10, 0), 0, 0);
        watch.bus_frame(ran(sent_at - 20, sent_at, 0), true);
    }
    let lateness = measurements.histogram(Quantity::Lateness);
    assert_eq!(
        (lateness.count(), lateness.smallest(), lateness.largest()),
        (2, 12, 203)
    );
}

#[test]
fn requests_and_the_longest_answer_survive_the_link() {
    use crate::link::frame::{Decoder, FRAME_BYTES_MAX, decode, encode};
    use crate::messages::{DeviceMessage, HostMessage, RecordAnswer};
    let carried = |frame: &[u8]| {
        let mut decoder = Decoder::<{ FRAME_BYTES_MAX }>::new();
        let payload = frame.iter().find_map(|byte| {
            let ended = decoder.push(*byte)?;
            Some(ended.expect("the frame is whole").to_vec())
        });
        payload.expect("a frame has an end")
    };
    let mut frame = [0; FRAME_BYTES_MAX];
    for request in [
        MeasurementRequest::Reset,
        MeasurementRequest::Disturb { bits: 7 },
        MeasurementRequest::Read {
            quantity: Quantity::Trajectory,
            first: 255,
        },
    ] {
        let message = HostMessage::Measure {
            id: 7,
            request: request.into(),
        };
        let length = encode(&message, &mut frame).expect("it fits");
        assert_eq!(decode::<HostMessage>(&carried(&frame[..length])), Ok(message));
    }
    let answer = MeasurementAnswer::Piece(HistogramPiece {
        quantity: Quantity::Trajectory,
        counts_per_s: u32::MAX,
        largest: u32::MAX,
        smallest: u32::MAX,
        sum: u64::MAX,
        bins: (0..BINS_PER_PIECE).map(|_| (u8::MAX, u32::MAX)).collect(),
        next: Some(u8::MAX),
    });
    let message = DeviceMessage::Measured {
        id: u16::MAX,
        answer: RecordAnswer::Measurement(answer),
    };
    let length = encode(&message, &mut frame).expect("it fits");
    assert_eq!(decode::<DeviceMessage>(&carried(&frame[..length])), Ok(message));
}
