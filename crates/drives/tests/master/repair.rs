//! Repair of slaves that are swapped, inserted, missing or returned, in a small chain of drives.

use super::fake::{FakeSegment, FakeSlave};
use super::rig::{Bench, Next, run};
use etherpen_ethercat::error::{BusError, IdentityProperty};
use etherpen_ethercat::event::{BusEvent, Step};
use etherpen_ethercat::wire::write_bytes;
use std::vec::Vec;

/// Drives with serial numbers from 11 on.
fn numbered() -> FakeSegment {
    let mut segment = FakeSegment::drives(4);
    for (serial, slave) in (11_u32..).zip(&mut segment.slaves) {
        write_bytes(&mut slave.sii, 28, &serial.to_le_bytes());
    }
    segment
}

fn assert_inputs(bench: &Bench<'_>, slaves: &[usize]) {
    for slave in slaves {
        assert!(bench.exchange.input(*slave).is_some(), "slave {slave} lost an input");
    }
}

/// Brings four drives up, does `harm`, recovers when all of `lost` are reported lost, and returns the events from then
/// on until `enough`; the inputs of the others never fail.
fn after_harm(
    lost: &[u8],
    harm: fn(&mut FakeSegment),
    clear_faults: fn(&mut FakeSegment),
    enough: fn(&[BusEvent]) -> bool,
) -> Vec<BusEvent> {
    let others: Vec<usize> = (0..4_u8)
        .filter(|slave| !lost.contains(slave))
        .map(usize::from)
        .collect();
    let (mut harmed, mut missing, mut recovering) = (false, lost.to_vec(), false);
    let mut log = Vec::new();
    run(
        numbered(),
        |_| false,
        |_, bench, events| {
            if harmed {
                assert_inputs(bench, &others);
            } else if events.contains(&BusEvent::Operational) {
                harmed = true;
                harm(&mut bench.segment);
                return Next::On;
            }
            for event in events.iter().filter(|_| harmed) {
                if let BusEvent::SlaveLost { position } = event {
                    missing.retain(|slave| slave != position);
                }
                log.push(*event);
            }
            if harmed && missing.is_empty() && !recovering {
                recovering = true;
                log.clear();
                clear_faults(&mut bench.segment);
                return Next::Recover;
            }
            if recovering && enough(&log) {
                Next::Done
            } else {
                Next::On
            }
        },
    );
    log
}

fn refusals(log: &[BusEvent]) -> Vec<(Option<u8>, Step, BusError)> {
    let refused = log.iter().filter_map(|event| match event {
        BusEvent::Refused { position, step, error } => Some((*position, *step, *error)),
        _ => None,
    });
    refused.collect()
}

#[test]
fn two_equal_drives_that_were_swapped_are_refused() {
    let log = after_harm(
        &[1, 2],
        |segment| {
            segment.slaves.swap(1, 2);
            segment.slaves[1].power_up();
            segment.slaves[2].power_up();
        },
        |_| {},
        |log| refusals(log).len() == 2,
    );
    let error = |expected, actual, other| BusError::WrongSlave {
        property: IdentityProperty::Serial,
        expected,
        actual,
        other: Some(other),
    };
    assert_eq!(
        refusals(&log),
        [
            (Some(1), Step::Identify, error(12, 13, 2)),
            (Some(2), Step::Identify, error(13, 12, 1))
        ]
    );
}

#[test]
fn two_drives_whose_cables_were_swapped_under_power_are_refused_by_their_addresses() {
    let log = after_harm(
        &[1, 2],
        |segment| {
            segment.slaves[1].connected = false;
            segment.slaves[2].connected = false;
        },
        |segment| {
            segment.slaves.swap(1, 2);
            segment.slaves[1].connected = true;
            segment.slaves[2].connected = true;
        },
        |log| !refusals(log).is_empty(),
    );
    let error = BusError::Station {
        expected: 0x1002,
        actual: 0x1003,
    };
    assert_eq!(refusals(&log)[0], (Some(1), Step::Locate, error));
}

#[test]
fn an_equal_drive_with_an_unknown_serial_number_is_taken() {
    let log = after_harm(
        &[1],
        |segment| segment.slaves[1].connected = false,
        |segment| {
            let mut spare = FakeSlave::drive();
            write_bytes(&mut spare.sii, 28, &99_u32.to_le_bytes());
            segment.slaves[1] = spare;
        },
        |log| log.contains(&BusEvent::Operational),
    );
    assert_eq!(refusals(&log), []);
}

#[test]
fn a_slave_plugged_in_before_the_others_gets_a_number_behind_them_and_disturbs_nobody() {
    let mut plugged_ms = None;
    let mut shown = Vec::new();
    run(
        numbered(),
        |_| false,
        |now_ms, bench, events| {
            if events.contains(&BusEvent::Operational) {
                bench.segment.slaves.insert(1, FakeSlave::drive());
                plugged_ms = Some(now_ms);
                return Next::On;
            }
            let Some(since_ms) = plugged_ms else { return Next::On };
            assert_inputs(bench, &[0, 1, 2, 3]);
            shown.extend_from_slice(events);
            if now_ms < since_ms + 500 { Next::On } else { Next::Done }
        },
    );
    assert!(shown.contains(&BusEvent::Found { slaves: 5 }), "{shown:?}");
    let extra = |event: &&BusEvent| {
        matches!(
            event,
            BusEvent::Slave {
                position: 4,
                member: None,
                ..
            }
        )
    };
    assert_eq!(shown.iter().filter(extra).count(), 1, "{shown:?}");
    assert!(!shown.iter().any(|event| matches!(event, BusEvent::SlaveLost { .. })));
}

#[test]
fn slaves_plugged_in_at_the_same_time_are_all_found_at_once() {
    let mut plugged_ms = None;
    let mut shown = Vec::new();
    run(
        numbered(),
        |_| false,
        |now_ms, bench, events| {
            if events.contains(&BusEvent::Operational) {
                for place in [1, 3, 6] {
                    bench.segment.slaves.insert(place, FakeSlave::drive());
                }
                plugged_ms = Some(now_ms);
                return Next::On;
            }
            let Some(since_ms) = plugged_ms else { return Next::On };
            shown.extend(events.iter().map(|event| (now_ms, *event)));
            if now_ms < since_ms + 500 { Next::On } else { Next::Done }
        },
    );
    let found: Vec<_> = shown
        .iter()
        .filter(|(_, event)| matches!(event, BusEvent::Found { .. }))
        .collect();
    assert!(matches!(found[..], [(_, BusEvent::Found { slaves: 7 })]), "{shown:?}");
    let extras: Vec<(u32, u8)> = shown
        .iter()
        .filter_map(|(ms, event)| match event {
            BusEvent::Slave {
                position, member: None, ..
            } => Some((*ms, *position)),
            _ => None,
        })
        .collect();
    let numbers: Vec<u8> = extras.iter().map(|(_, number)| *number).collect();
    assert_eq!(numbers, [4, 5, 6]);
    let [(first_ms, _), .., (last_ms, _)] = extras[..] else {
        panic!("{extras:?}")
    };
    assert!(last_ms - first_ms < 80, "in one look through the chain: {extras:?}");
}

#[test]
fn a_power_cycled_slave_is_found_behind_one_that_was_plugged_in_meanwhile() {
    let log = after_harm(
        &[2],
        |segment| {
            segment.slaves[2].power_up();
            let mut coupler = FakeSlave::drive();
            write_bytes(&mut coupler.sii, 20, &[9, 0, 0, 0]);
            segment.slaves.insert(1, coupler);
        },
        |_| {},
        |log| log.contains(&BusEvent::Operational),
    );
    assert!(log.contains(&BusEvent::Repaired { position: 2 }), "{log:?}");
}

#[test]
fn one_of_two_missing_slaves_is_repaired_and_the_other_one_refused() {
    let log = after_harm(
        &[1, 2],
        |segment| {
            segment.slaves[1].connected = false;
            segment.slaves[2].power_up();
        },
        |_| {},
        |log| log.contains(&BusEvent::Repaired { position: 2 }),
    );
    assert_eq!(refusals(&log).len(), 1);
    assert_eq!(refusals(&log)[0].0, Some(1));
}

#[test]
fn a_new_drive_behind_a_missing_one_is_not_taken_for_it() {
    let (mut since, mut lost, mut harmed) = (None, 0, false);
    run(
        numbered(),
        |_| false,
        |now_ms, bench, events| {
            lost += events
                .iter()
                .filter(|event| matches!(event, BusEvent::SlaveLost { .. }))
                .count();
            let station = |bench: &Bench<'_>, slave: usize| {
                let memory = &bench.segment.slaves[slave].memory;
                u16::from_le_bytes([memory[0x10], memory[0x11]])
            };
            match since {
                None if !harmed && events.contains(&BusEvent::Operational) => {
                    harmed = true;
                    bench.segment.slaves[2].connected = false;
                    let mut spare = FakeSlave::drive();
                    write_bytes(&mut spare.sii, 28, &99_u32.to_le_bytes());
                    bench.segment.slaves[3] = spare;
                    Next::On
                }
                None if lost == 2 => {
                    since = Some(now_ms);
                    Next::Recover
                }
                Some(at_ms) if now_ms == at_ms + 3_000 => {
                    // What it is for is told by its place only once all are there.
                    assert_eq!(station(bench, 3), 0);
                    bench.segment.slaves[2].connected = true;
                    bench.segment.slaves[2].power_up();
                    Next::On
                }
                Some(at_ms) if now_ms == at_ms + 3_100 => Next::Recover,
                Some(at_ms) if now_ms > at_ms + 3_100 && events.contains(&BusEvent::Operational) => {
                    assert_eq!((station(bench, 2), station(bench, 3)), (0x1003, 0x1004));
                    Next::Done
                }
                _ => Next::On,
            }
        },
    );
}

#[test]
fn a_standing_error_flag_is_cleared_through_init() {
    let log = after_harm(
        &[1],
        |segment| segment.slaves[1].connected = false,
        |segment| {
            segment.slaves[1].connected = true;
            segment.slaves[1].set_al(0x14, 0);
            segment.slaves[1].sticky_error = true;
        },
        |log| log.contains(&BusEvent::Operational),
    );
    assert!(log.contains(&BusEvent::Repaired { position: 1 }), "{log:?}");
}
