//! Devices that behave as real ones do: without a processor, slow to start, with few units or a blank memory.

use super::fake::{FakeSegment, FakeSlave};
use super::rig::{Next, run};
use etherpen_ethercat::error::BusError;
use etherpen_ethercat::event::{BusEvent, Step};

/// A coupler or terminal: device emulation, no mailbox, three FMMUs.
fn terminal() -> FakeSlave {
    let mut slave = FakeSlave::drive();
    slave.sii[20..24].copy_from_slice(&0x044C_2C52_u32.to_le_bytes());
    slave.sii[0x18 * 2..0x1D * 2].fill(0);
    (slave.emulated, slave.fmmus) = (true, 3);
    slave
}

/// Brings a chain with four drives up; returns the events until all are in OP, and the AL states then.
fn brought_up(segment: FakeSegment) -> (Vec<BusEvent>, Vec<u8>, u32) {
    let (mut log, mut states, mut last_ms) = (Vec::new(), Vec::new(), 0);
    run(
        segment,
        |_| false,
        |now_ms, bench, events| {
            log.extend_from_slice(events);
            (states, last_ms) = (bench.segment.states(), now_ms);
            match events.contains(&BusEvent::Operational) {
                true => Next::Done,
                false => Next::On,
            }
        },
    );
    (log, states, last_ms)
}

fn refusals(log: &[BusEvent]) -> Vec<(Option<u8>, Step, BusError)> {
    let refused = log.iter().filter_map(|event| match event {
        BusEvent::Refused { position, step, error } => Some((*position, *step, *error)),
        _ => None,
    });
    refused.collect()
}

#[test]
fn slaves_with_device_emulation_keep_no_echo_and_stop_nobody() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves.insert(0, terminal());
    segment.slaves.insert(3, terminal());
    // What another master left.
    for (slave, status) in segment.slaves.iter_mut().zip([0x12, 0x14, 0x18, 0x11, 2, 8]) {
        slave.set_al(status, if slave.emulated { 0 } else { 0x1B });
    }
    let (log, states, _) = brought_up(segment);
    assert_eq!(refusals(&log), []);
    assert_eq!(states, [1, 8, 8, 1, 8, 8]);
}

#[test]
fn a_drive_whose_processor_starts_up_is_waited_for_and_named() {
    let mut segment = FakeSegment::drives(4);
    // One frame a millisecond.
    segment.slaves[2].boots = 10_000;
    let (log, states, last_ms) = brought_up(segment);
    assert_eq!(states, [8; 4]);
    assert!((10_000..12_000).contains(&last_ms), "{last_ms} ms");
    let told = refusals(&log);
    assert!((2..5).contains(&told.len()), "{told:?}");
    for (position, step, error) in told {
        assert_eq!((position, step), (Some(2), Step::PreOperational));
        assert!(matches!(error, BusError::RequestUnread { .. }), "{error:?}");
    }
}

#[test]
fn a_drive_that_never_reads_its_requests_is_refused_after_a_while() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[1].boots = u32::MAX;
    let mut told = 0;
    run(
        segment,
        |_| false,
        |now_ms, _, events| {
            told += refusals(events).len();
            assert!(!events.contains(&BusEvent::Operational));
            match now_ms {
                29_000 => Next::Done,
                _ => Next::On,
            }
        },
    );
    assert!((7..=9).contains(&told), "{told}: it goes on for ever");
}

#[test]
fn a_drive_that_reads_its_own_memory_gets_it_before_preop() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves.iter_mut().for_each(|slave| slave.reads_sii = true);
    let (log, states, _) = brought_up(segment);
    assert_eq!((refusals(&log), states), (Vec::new(), vec![8; 4]));
}

#[test]
fn a_blank_memory_of_an_unused_slave_stops_nobody() {
    let mut segment = FakeSegment::drives(4);
    let mut blank = FakeSlave::drive();
    blank.sii.fill(0xFF);
    segment.slaves.insert(1, blank);
    let (log, states, _) = brought_up(segment);
    assert_eq!((refusals(&log), states), (Vec::new(), vec![8, 1, 8, 8, 8]));
}

#[test]
fn a_drive_with_few_units_is_cleared_one_by_one() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[1].fmmus = 3;
    segment.slaves[1].memory[0x0600..0x0630].fill(0x55);
    let mut cleared = false;
    run(
        segment,
        |_| false,
        |_, bench, events| {
            cleared |= bench.segment.slaves[1].memory[0x0620..0x0630] == [0; 16];
            assert_eq!(refusals(events), []);
            match events.contains(&BusEvent::Operational) {
                true => Next::Done,
                false => Next::On,
            }
        },
    );
    assert!(cleared, "what another master mapped stays mapped");
}

#[test]
fn a_chain_that_was_too_short_is_brought_up_when_it_is_complete() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[3].connected = false;
    let mut refused_ms = None;
    run(
        segment,
        |_| false,
        |now_ms, bench, events| {
            if let [(_, step, error), ..] = refusals(events)[..] {
                let missing = BusError::SlaveCount { expected: 4, actual: 3 };
                assert_eq!((step, error, refused_ms), (Step::Discover, missing, None));
                refused_ms = Some(now_ms);
            }
            bench.segment.slaves[3].connected = now_ms > 8_000;
            match events.contains(&BusEvent::Operational) {
                true => {
                    assert!(refused_ms.is_some() && (8_000..10_000).contains(&now_ms), "{now_ms} ms");
                    Next::Done
                }
                false => Next::On,
            }
        },
    );
}
