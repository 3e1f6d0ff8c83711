//! Devices that behave as real ones do: without a processor, slow to start, with few units or a blank memory.

use super::drives::generic_drive;
use super::fake::{FakeSegment, FakeSlave};
use super::identity::numbered;
use super::rig::{Next, run, run_with, setup};
use etherpen_ethercat::cyclic::ExchangeKind;
use etherpen_ethercat::error::{BusError, IdentityProperty};
use etherpen_ethercat::event::{BusEvent, BusSetup, Step};
use etherpen_ethercat::slave_set::SlaveSet;
use etherpen_ethercat::wire::coe::Object;
use etherpen_ethercat::wire::register;

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

fn is_waiting_for(event: &BusEvent, slave: u8) -> bool {
    matches!(event, BusEvent::Waiting { position, step: Step::PreOperational, .. } if *position == slave)
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
    segment.slaves[2].boots = 10_000;
    let (log, states, last_ms) = brought_up(segment);
    assert_eq!(states, [8; 4]);
    assert!((10_000..12_000).contains(&last_ms), "{last_ms} ms");
    assert_eq!(refusals(&log), []);
    let told: Vec<_> = log.iter().filter(|event| is_waiting_for(event, 2)).collect();
    assert!((2..5).contains(&told.len()), "{told:?}");
}

#[test]
fn a_drive_that_only_its_device_type_tells_is_waited_for_as_well() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[2] = generic_drive();
    segment.slaves[2].boots = 10_000;
    let (log, states, last_ms) = brought_up(segment);
    assert_eq!((refusals(&log), states), (Vec::new(), vec![8; 4]));
    assert!((10_000..13_000).contains(&last_ms), "{last_ms} ms");
    assert!(log.iter().any(|event| is_waiting_for(event, 2)), "{log:?}");
}

#[test]
fn drives_are_waited_for_when_their_switches_are_asked_for() {
    let (mut segment, setup) = numbered(IdentityProperty::Switch);
    segment.slaves[1].boots = 10_000;
    let (mut told, mut begun_ms) = (false, None);
    run_with(
        setup,
        segment,
        |_| false,
        |now_ms, _, events| {
            assert_eq!(refusals(events), []);
            told |= events.iter().any(|event| {
                matches!(
                    event,
                    BusEvent::Waiting {
                        position: 1,
                        step: Step::Identify,
                        ..
                    }
                )
            });
            begun_ms = begun_ms.or(events.contains(&BusEvent::Operational).then_some(now_ms));
            match begun_ms {
                Some(_) => Next::Done,
                None => Next::On,
            }
        },
    );
    assert!(
        told && begun_ms.is_some_and(|ms| (9_000..13_000).contains(&ms)),
        "{begun_ms:?}"
    );
}

#[test]
fn an_unused_slave_that_hangs_costs_the_others_a_few_seconds_only() {
    let mut segment = FakeSegment::drives(4);
    let mut hanging = generic_drive();
    hanging.boots = u32::MAX;
    segment.slaves.insert(0, hanging);
    let (log, states, last_ms) = brought_up(segment);
    assert_eq!((refusals(&log), &states[1..]), (Vec::new(), &[8; 4][..]));
    assert!(last_ms < 7_000, "{last_ms} ms");
}

#[test]
fn a_drive_that_never_reads_its_requests_is_refused_after_a_while() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[1].boots = u32::MAX;
    let (mut told, mut refused) = (0, Vec::new());
    run(
        segment,
        |_| false,
        |now_ms, _, events| {
            refused.extend(refusals(events));
            if refused.is_empty() {
                told += events.iter().filter(|event| is_waiting_for(event, 1)).count();
            }
            assert!(!events.contains(&BusEvent::Operational));
            match now_ms {
                29_000 => Next::Done,
                _ => Next::On,
            }
        },
    );
    assert!((5..=7).contains(&told), "{told}: the operator is told");
    let [(Some(1), Step::PreOperational, BusError::RequestUnread { .. })] = refused[..] else {
        panic!("{refused:?}: it goes on for ever");
    };
}

#[test]
fn a_drive_that_is_slower_than_the_longest_wait_is_brought_up_unasked_all_the_same() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[1].boots = 24_000;
    let (log, states, last_ms) = brought_up(segment);
    let [(Some(1), Step::PreOperational, BusError::RequestUnread { .. })] = refusals(&log)[..] else {
        panic!("{log:#?}");
    };
    assert_eq!(states, [8; 4]);
    assert!((24_000..29_500).contains(&last_ms), "{last_ms} ms");
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
fn a_terminal_with_a_blank_memory_or_a_long_mailbox_is_refused_alone() {
    let blank = |slave: &mut FakeSlave| slave.sii.fill(0xFF);
    let long = |slave: &mut FakeSlave| {
        for word in [0x19, 0x1B] {
            slave.sii[word * 2..][..2].copy_from_slice(&1_486_u16.to_le_bytes());
        }
    };
    for spoil in [blank as fn(&mut FakeSlave), long] {
        for named in [SlaveSet::of(1), SlaveSet::ALL] {
            let mut segment = FakeSegment::drives(4);
            let mut odd = FakeSlave::drive();
            odd.sii[20..24].copy_from_slice(&0x044C_2C52_u32.to_le_bytes());
            spoil(&mut odd);
            segment.slaves.insert(1, odd);
            let setup = BusSetup {
                terminals: named,
                ..setup()
            };
            let (mut is_refused, mut refused) = (false, Vec::new());
            run_with(
                setup,
                segment,
                |_| false,
                |_, bench, events| {
                    refused.extend(refusals(events));
                    is_refused |= events
                        .iter()
                        .any(|event| matches!(event, BusEvent::TerminalRefused { position: 1, .. }));
                    let states = bench.segment.states();
                    match [0, 2, 3, 4].iter().all(|place| states[*place] == 8) && is_refused {
                        true => Next::Done,
                        false => Next::On,
                    }
                },
            );
            assert_eq!(refused, []);
        }
    }
}

#[test]
fn a_slave_with_objects_whose_memory_lists_no_sync_managers_exchanges_what_its_objects_list() {
    let mut segment = FakeSegment::drives(4);
    let mut slave = FakeSlave::drive();
    slave.sii[20..24].copy_from_slice(&0x044C_2C52_u32.to_le_bytes());
    // Nine process data objects of a byte each for the inputs, one of two bytes for the outputs.
    slave.objects.insert((0x1701, 0), vec![1]);
    slave
        .objects
        .insert((0x1701, 1), 0x7000_0110_u32.to_le_bytes().to_vec());
    slave.objects.insert((0x1C13, 0), vec![9]);
    for number in 1..=9_u16 {
        let pdo = 0x1A00 + number;
        slave.objects.insert((0x1C13, number as u8), pdo.to_le_bytes().to_vec());
        slave.objects.insert((pdo, 0), vec![1]);
        slave.objects.insert(
            (pdo, 1),
            (0x6000_0108 + (u32::from(number) << 16)).to_le_bytes().to_vec(),
        );
    }
    segment.slaves.push(slave);
    let setup = BusSetup {
        terminals: SlaveSet::of(4),
        ..setup()
    };
    run_with(
        setup,
        segment,
        |_| false,
        |_, bench, events| {
            assert_eq!(refusals(events), []);
            if bench.segment.states() != [8; 5] {
                return Next::On;
            }
            let slave = &bench.segment.slaves[4];
            let (outputs, inputs) = (slave.manager(2), slave.manager(3));
            assert_eq!(
                (outputs.start, outputs.length, inputs.start, inputs.length),
                (0x1100, 2, 0x1400, 9)
            );
            let share = &bench.exchange.plan().slaves[4];
            assert_eq!((share.output_length, share.input_length), (2, 9));
            Next::Done
        },
    );
}

#[test]
fn all_units_of_a_large_controller_are_cleared() {
    let mut segment = FakeSegment::drives(4);
    let (fmmus, managers) = (0x0600..0x0600 + 8 * 16, 0x0800..0x0800 + 8 * 8);
    for slave in &mut segment.slaves {
        slave.memory[fmmus.clone()].fill(0x55);
        slave.memory[managers.clone()].fill(0x55);
    }
    run(
        segment,
        |_| false,
        |_, bench, events| {
            assert_eq!(refusals(events), []);
            if !events.contains(&BusEvent::Operational) {
                return Next::On;
            }
            for slave in &bench.segment.slaves {
                for number in 4..8 {
                    assert_eq!(slave.memory[0x0600 + 16 * number..][..16], [0; 16], "FMMU {number}");
                    assert_eq!(
                        slave.memory[0x0800 + 8 * number..][..8],
                        [0; 8],
                        "sync manager {number}"
                    );
                }
            }
            Next::Done
        },
    );
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

#[test]
fn a_drive_that_shows_its_mode_only_in_op_is_used_and_one_that_never_does_is_refused() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[1].shows_mode_in = 8;
    let (log, states, _) = brought_up(segment);
    assert_eq!((refusals(&log), states), (Vec::new(), vec![8; 4]));

    let mut segment = FakeSegment::drives(4);
    segment.slaves[1].shows_mode_in = 9;
    run(
        segment,
        |_| false,
        |_, _, events| {
            assert!(!events.contains(&BusEvent::Operational));
            let Some(refusal) = refusals(events).pop() else {
                return Next::On;
            };
            let error = BusError::ReadBack {
                object: Object::new(0x6061, 0),
                expected: 0xFE,
                actual: 0,
            };
            assert_eq!(refusal, (Some(1), Step::Objects, error));
            Next::Done
        },
    );
}

#[test]
fn a_slave_that_fails_on_its_way_up_has_its_memory() {
    for state in [2, 4] {
        let mut segment = FakeSegment::drives(4);
        segment.slaves[2].refuse_state = Some((state, 0x1D));
        run(
            segment,
            |_| false,
            |_, bench, events| match refusals(events).pop() {
                None => Next::On,
                Some((position, ..)) => {
                    assert_eq!(position, Some(2));
                    let owner = bench.segment.slaves[2].memory[usize::from(register::SII_CONFIG)];
                    assert_eq!(owner & register::SII_TO_PDI, register::SII_TO_PDI);
                    Next::Done
                }
            },
        );
    }
}

/// The general category of an information memory with these flags, behind the fixed part.
fn with_flags(slave: &mut FakeSlave, flags: u8) {
    slave.sii.resize(128, 0);
    slave.sii.extend([30, 0, 16, 0]);
    let mut general = [0; 32];
    general[11] = flags;
    slave.sii.extend(general);
    slave.sii.extend([0xFF; 4]);
}

/// No flag of the SII: stands for bit 9 of the features.
const NO_LRW: u8 = 0xFF;

#[test]
fn inputs_and_outputs_travel_apart_if_a_slave_in_use_does_not_support_them_together() {
    let (together, apart) = (ExchangeKind::Combined, ExchangeKind::Split);
    // The place of the slave with the flags, the places of terminals, and what results.
    let cases = [
        (3, 0, SlaveSet::NONE, together),
        (3, 1 << 1, SlaveSet::NONE, apart),
        (4, 1 << 1, SlaveSet::of(4), apart),
        (4, 1 << 1, SlaveSet::NONE, together),
        // In the features of its controller.
        (1, NO_LRW, SlaveSet::NONE, apart),
    ];
    for (place, flags, terminals, expected) in cases {
        let mut segment = FakeSegment::drives(4);
        segment.slaves.push(terminal());
        for slave in &mut segment.slaves {
            with_flags(slave, 0);
        }
        segment.slaves[place].sii.truncate(128);
        match flags {
            NO_LRW => segment.slaves[place].memory[usize::from(register::FEATURES) + 1] |= 1 << 1,
            flags => with_flags(&mut segment.slaves[place], flags),
        }
        let setup = BusSetup {
            exchange: ExchangeKind::Combined,
            terminals,
            ..setup()
        };
        run_with(
            setup,
            segment,
            |_| false,
            |_, bench, events| match events.contains(&BusEvent::Operational) {
                false => Next::On,
                true => {
                    assert_eq!(bench.exchange.plan().exchange, expected);
                    Next::Done
                }
            },
        );
    }
}

/// A chain of four drives, the third of which gives no inputs.
fn without_inputs() -> FakeSegment {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[2].gives_inputs = false;
    segment
}

#[test]
fn a_drive_whose_inputs_never_arrive_is_refused_after_a_second_and_taken_once_they_do() {
    let (mut log, mut refused_ms) = (Vec::new(), None);
    run(
        without_inputs(),
        |_| false,
        |now_ms, bench, events| {
            log.extend_from_slice(events);
            match (refused_ms, refusals(events).pop()) {
                (None, None) => assert!(now_ms < 4_000, "nobody is told: {log:#?}"),
                (None, Some(refusal)) => {
                    let (Some(2), Step::CyclicData, BusError::NoInputs { waited_ms }) = refusal else {
                        panic!("{refusal:?}");
                    };
                    assert!((1_001..1_010).contains(&waited_ms), "{waited_ms} ms");
                    assert_ne!(bench.segment.states()[2], 8);
                    assert!(!log.contains(&BusEvent::Operational));
                    (refused_ms, bench.segment.slaves[2].gives_inputs) = (Some(now_ms), true);
                }
                (Some(_), refusal) => assert_eq!(refusal, None),
            }
            match events.contains(&BusEvent::Operational) {
                true => {
                    assert_eq!(bench.segment.states(), [8; 4]);
                    Next::Done
                }
                false => Next::On,
            }
        },
    );
}

#[test]
fn the_pauses_between_bring_ups_without_a_command_grow_to_half_a_minute() {
    let mut expected_ms = [5_000, 10_000, 20_000, 30_000, 30_000].into_iter().peekable();
    let mut ended_ms = None;
    run(
        without_inputs(),
        |_| false,
        |now_ms, _, events| {
            for event in events {
                match (event, ended_ms) {
                    (BusEvent::Found { .. }, Some(ended_ms)) => {
                        let (pause_ms, expected_ms) = (now_ms - ended_ms, expected_ms.next().unwrap());
                        let is_expected = (expected_ms..expected_ms + 100).contains(&pause_ms);
                        assert!(is_expected, "{pause_ms} ms instead of {expected_ms}");
                    }
                    (BusEvent::Refused { .. }, _) => ended_ms = Some(now_ms),
                    _ => {}
                }
            }
            match expected_ms.peek() {
                None => Next::Done,
                Some(_) => Next::On,
            }
        },
    );
}
