//! How drives of every type get their process data, against a small chain of slaves.

use super::fake::{FakeSegment, FakeSlave, Rounding};
use super::rig::{self, Bench, Drives, Next, run_with};
use etherpen_drives::cia402::ControlWord;
use etherpen_drives::{
    AxisMode, DriveOutput, DriveSettings, PositionRange, QUICK_STOP_DECELERATION, ax2000, generic,
    quick_stop_increments_s2,
};
use etherpen_ethercat::error::BusError;
use etherpen_ethercat::supervisor::{BusEvent, BusSetup, Step};
use etherpen_ethercat::wire::coe::Object;
use etherpen_ethercat::wire::register;
use etherpen_ethercat::wire::sii::{self, PdoEntryRecord, PdoRecord, Record, SyncManagerRecord, SyncManagerUse};
use std::vec;
use std::vec::Vec;

fn setup(mode: AxisMode) -> BusSetup<Drives> {
    let mut setup = rig::setup();
    setup.settings = setup.settings.map(|drive| DriveSettings { mode, ..drive });
    setup
}

/// A servo drive of an unknown maker with variable process data.
pub(crate) fn generic_drive() -> FakeSlave {
    let mut slave = FakeSlave::drive();
    slave.sii[16..18].copy_from_slice(&[0x7E, 0x0E]);
    slave.objects = [
        ((0x1000, 0), generic::DEVICE_TYPE_SERVO.to_le_bytes().to_vec()),
        ((0x1600, 0), vec![1]),
        ((0x1600, 1), vec![0; 4]),
        ((0x1600, 2), vec![0; 4]),
        ((0x1A00, 0), vec![1]),
        ((0x1A00, 1), vec![0; 4]),
        ((0x1A00, 2), vec![0; 4]),
        ((0x1A00, 3), vec![0; 4]),
        ((0x1A00, 4), vec![0; 4]),
        ((0x1C12, 0), vec![0]),
        ((0x1C12, 1), vec![0; 2]),
        ((0x1C13, 0), vec![0]),
        ((0x1C13, 1), vec![0; 2]),
        ((0x6060, 0), vec![0]),
        ((0x6085, 0), vec![0; 4]),
    ]
    .into_iter()
    .collect();
    slave
}

fn segment(slave: impl Fn() -> FakeSlave) -> FakeSegment {
    let slaves = (0..4).map(|_| slave()).collect();
    FakeSegment { slaves }
}

/// Runs until the bus is operational, then looks at it.
fn operational(mode: AxisMode, segment: FakeSegment, look: impl Fn(&mut Bench<'_>)) {
    let lossless = |_| false;
    run_with(setup(mode), segment, lossless, |_, bench, events| {
        let refused = events.iter().find(|event| matches!(event, BusEvent::Refused { .. }));
        assert_eq!(refused, None);
        if !events.contains(&BusEvent::Operational) {
            return Next::On;
        }
        look(bench);
        Next::Done
    });
}

/// Runs until the bring-up is refused and returns the error of the first slave.
fn refusal(mode: AxisMode, segment: FakeSegment) -> BusError {
    refusal_of(0, mode, segment)
}

/// Runs until the bring-up is refused and returns the error of this slave.
fn refusal_of(slave: u8, mode: AxisMode, segment: FakeSegment) -> BusError {
    let mut found = None;
    run_with(
        setup(mode),
        segment,
        |_| false,
        |_, _, events| {
            found = events.iter().find_map(|event| match event {
                BusEvent::Refused { position, step, error } => {
                    assert_eq!((*position, *step), (Some(slave), Step::Objects));
                    Some(*error)
                }
                _ => None,
            });
            if found.is_some() { Next::Done } else { Next::On }
        },
    );
    found.unwrap()
}

/// The outputs of axis 0 for a demand of 0x1234 and the control word 0x000F.
fn encoded(bench: &mut Bench<'_>) -> Vec<u8> {
    let share = bench.exchange.plan().slaves[0];
    let output = DriveOutput {
        demand_digits: 0x1234,
        position: 0,
        control: ControlWord(0x000F),
    };
    let mut bytes = vec![0; share.output_length.into()];
    share.role.unwrap().layout.encode(&output, &mut bytes);
    bytes
}

#[test]
fn an_unknown_servo_drive_is_used_as_the_generic_one_with_its_mapping_written() {
    operational(AxisMode::Velocity, segment(generic_drive), |bench| {
        for slave in &bench.segment.slaves {
            assert_eq!(slave.objects[&(0x1600, 1)], 0x6040_0010_u32.to_le_bytes());
            assert_eq!(slave.objects[&(0x1600, 2)], 0x60FF_0020_u32.to_le_bytes());
            assert_eq!(slave.objects[&(0x1A00, 2)], 0x6064_0020_u32.to_le_bytes());
            assert_eq!(slave.objects[&(0x1C13, 1)], [0x00, 0x1A]);
            assert_eq!(slave.objects[&(0x6060, 0)], [9]);
            assert_eq!(slave.objects[&(0x1A00, 3)], 0x6061_0008_u32.to_le_bytes());
            assert_eq!((slave.manager(2).length, slave.manager(3).length), (6, 7));
        }
        let role = bench.exchange.plan().slaves[3].role.unwrap();
        assert_eq!(role.device, &generic::GENERIC);
        assert_eq!(encoded(bench), [0x0F, 0, 0x34, 0x12, 0, 0]);
    });
}

#[test]
fn torque_takes_other_objects_of_the_same_drives() {
    operational(AxisMode::Torque, segment(generic_drive), |bench| {
        assert_eq!(bench.segment.slaves[0].objects[&(0x6060, 0)], [10]);
        assert_eq!(encoded(bench), [0x0F, 0, 0x34, 0x12]);
        assert_eq!(bench.exchange.plan().slaves[0].input_length, 9);
    });
    let with_three_entries = || {
        let mut slave = generic_drive();
        slave.objects.remove(&(0x1A00, 4));
        slave
    };
    operational(AxisMode::Torque, segment(with_three_entries), |bench| {
        assert_eq!(bench.segment.slaves[0].objects[&(0x1A00, 0)], [3]);
        assert_eq!(bench.exchange.plan().slaves[0].input_length, 8);
    });
    operational(AxisMode::Torque, FakeSegment::drives(4), |bench| {
        let slave = &bench.segment.slaves[2];
        assert_eq!(slave.objects[&(0x1C12, 1)], [0x03, 0x17]);
        assert_eq!(slave.objects[&(0x1C13, 1)], [0x03, 0x1B]);
        assert_eq!(slave.objects[&(0x6060, 0)], [-3_i8 as u8]);
        let watched = slave.manager(2).control == register::CONTROL_OUTPUTS;
        assert!(watched);
        assert_eq!(encoded(bench), [0x34, 0x12, 0x0F, 0]);
    });
}

/// The generic drive with the objects of cyclic synchronous position.
fn position_drive() -> FakeSlave {
    let mut slave = generic_drive();
    for (object, length) in [
        ((0x1600, 3), 4),
        ((0x6065, 0), 4),
        ((0x6066, 0), 2),
        ((0x60C2, 1), 1),
        ((0x60C2, 2), 1),
    ] {
        slave.objects.insert(object, vec![0xEE; length]);
    }
    slave
}

#[test]
fn position_writes_the_period_and_the_window_and_gives_the_target_and_the_velocity_beside_it() {
    operational(AxisMode::Position, segment(position_drive), |bench| {
        for slave in &bench.segment.slaves {
            assert_eq!(slave.objects[&(0x6060, 0)], [8]);
            assert_eq!(slave.objects[&(0x1600, 2)], 0x607A_0020_u32.to_le_bytes());
            assert_eq!(slave.objects[&(0x1600, 3)], 0x60B1_0020_u32.to_le_bytes());
            assert_eq!(
                (&slave.objects[&(0x60C2, 1)], &slave.objects[&(0x60C2, 2)]),
                (&vec![1], &vec![0xFD])
            );
            assert_eq!(slave.objects[&(0x6065, 0)], 100_131_u32.to_le_bytes());
            assert_eq!(slave.objects[&(0x6066, 0)], [0, 0]);
        }
        let layout = bench.exchange.plan().slaves[0].role.unwrap().layout;
        let output = DriveOutput {
            demand_digits: -2,
            position: 0x0403_0201,
            control: ControlWord(0x000F),
        };
        let mut bytes = [0; 10];
        layout.encode(&output, &mut bytes);
        assert_eq!(bytes, [0x0F, 0, 1, 2, 3, 4, 0xFE, 0xFF, 0xFF, 0xFF]);
    });
}

#[test]
fn the_period_that_a_drive_is_told_is_the_cycle_of_the_bus() {
    for (cycle_ns, expected) in [
        (250_000, Some((25, 0xFB))),
        (10_000_000, Some((10, 0xFD))),
        (333_000, None),
    ] {
        let setup = BusSetup {
            cycle_ns,
            ..setup(AxisMode::Position)
        };
        run_with(
            setup,
            segment(position_drive),
            |_| false,
            |_, bench, events| {
                for event in events {
                    if let BusEvent::Refused { error, .. } = event {
                        let object = Object::new(0x60C2, 1);
                        assert_eq!((*error, expected), (BusError::Range { object }, None), "{cycle_ns} ns");
                        return Next::Done;
                    }
                }
                if !events.contains(&BusEvent::Operational) {
                    return Next::On;
                }
                for slave in &bench.segment.slaves {
                    let told = (slave.objects[&(0x60C2, 1)][0], slave.objects[&(0x60C2, 2)][0]);
                    assert_eq!(Some(told), expected, "{cycle_ns} ns");
                }
                Next::Done
            },
        );
    }
}

/// An AKD whose owner has set these options of its fieldbus.
fn akd_with_options(options: u32) -> FakeSlave {
    let mut slave = position_drive();
    slave.sii[16..24].copy_from_slice(&[0x6A, 0, 0, 0, 0x44, 0x4B, 0x41, 0]);
    for object in [(0x1600, 3), (0x6065, 0), (0x6066, 0)] {
        slave.objects.remove(&object);
    }
    for object in [(0x6091, 1), (0x6091, 2), (0x6092, 1), (0x6092, 2)] {
        slave.objects.insert(object, vec![0; 4]);
    }
    slave.objects.insert((0x36E9, 0), options.to_le_bytes().to_vec());
    slave
}

#[test]
fn an_akd_keeps_its_other_options_and_has_to_take_the_period_in_position_mode() {
    for (options, expected) in [(0, 0x10_u32), (0x8000_0181, 0x8000_0191), (0x10, 0x10)] {
        operational(AxisMode::Position, segment(|| akd_with_options(options)), |bench| {
            for slave in &bench.segment.slaves {
                assert_eq!(slave.objects[&(0x36E9, 0)], expected.to_le_bytes(), "{options:#x}");
                assert_eq!(slave.objects[&(0x60C2, 1)], [1]);
                assert_eq!(slave.objects[&(0x60C2, 2)], [0xFD]);
            }
        });
    }
    let deaf = || {
        let mut slave = akd_with_options(0);
        slave.deaf.push(0x60C2);
        slave
    };
    let expected = BusError::ReadBack {
        object: Object::new(0x60C2, 1),
        expected: 1,
        actual: 0xEE,
    };
    assert_eq!(refusal(AxisMode::Position, segment(deaf)), expected);
}

#[test]
fn a_drive_in_position_mode_may_lack_everything_but_its_target() {
    // No room for the velocity offset, and none of the optional objects.
    operational(AxisMode::Position, segment(generic_drive), |bench| {
        assert_eq!(bench.segment.slaves[0].objects[&(0x1600, 0)], [2]);
        assert_eq!(encoded(bench), [0x0F, 0, 0, 0, 0, 0]);
    });
    let object = Object::new(0x6060, 0);
    let error = refusal(AxisMode::Position, FakeSegment::drives(4));
    assert_eq!(error, BusError::Range { object }, "the AX2000 has no such mode");
}

/// The generic drive in position mode with a first and a last position.
fn drive_with_range(first: i32, last: i32) -> FakeSlave {
    let mut slave = position_drive();
    for (sub, end) in [(1, first), (2, last)] {
        slave.objects.insert((0x607B, sub), end.to_le_bytes().to_vec());
    }
    slave
}

#[test]
fn a_drive_in_position_mode_tells_the_range_of_its_targets_and_one_of_broken_turns_is_refused() {
    const TURN: i32 = 1 << 20;
    let range = |bench: &Bench<'_>| bench.exchange.plan().slaves[3].role.unwrap().layout.range();
    let whole = || drive_with_range(i32::MIN, i32::MAX);
    operational(AxisMode::Position, segment(position_drive), |bench| {
        assert_eq!(range(bench), PositionRange::WHOLE, "it does not tell");
    });
    operational(AxisMode::Position, segment(whole), |bench| {
        assert_eq!(range(bench), PositionRange::WHOLE);
    });
    // Equal drives may be set differently.
    let mut drives = segment(whole);
    drives.slaves[3] = drive_with_range(-TURN, TURN - 1);
    operational(AxisMode::Position, drives, |bench| {
        let turns = range(bench);
        assert_eq!((turns.fold(TURN), turns.nearest(3 * TURN / 2)), (-TURN, -TURN / 2));
    });
    let mut drives = segment(whole);
    drives.slaves[2] = drive_with_range(0, 3_599);
    let expected = BusError::PositionRange {
        expected: 1 << 20,
        actual: 3_600,
    };
    assert_eq!(refusal_of(2, AxisMode::Position, drives), expected);
    let mut drives = segment(whole);
    drives.slaves[2] = drive_with_range(0, 3_599);
    operational(AxisMode::Velocity, drives, |bench| {
        assert_eq!(range(bench), PositionRange::WHOLE)
    });
}

#[test]
fn a_drive_that_keeps_its_assignment_is_used_as_it_is() {
    let fixed = || {
        let mut slave = FakeSlave::drive();
        slave.read_only = vec![0x1C12, 0x1C13];
        slave.objects.insert((0x1C12, 1), vec![0x02, 0x17]);
        slave
    };
    operational(AxisMode::Velocity, segment(fixed), |bench| {
        assert_eq!(encoded(bench), [0x34, 0x12, 0, 0, 0x0F, 0]);
    });
    // Another fixed object, whose content is not listed anywhere.
    let other = || {
        let mut slave = fixed();
        slave.objects.insert((0x1C12, 1), vec![0x01, 0x17]);
        slave
    };
    let error = refusal(AxisMode::Velocity, segment(other));
    let object = Object::new(0x1701, 0);
    assert!(
        matches!(error, BusError::SdoAbort { object: at, .. } if at == object),
        "{error:?}"
    );
}

#[test]
fn a_drive_that_keeps_one_of_its_assignments_is_not_taken_for_its_twin() {
    for (assignment, fixed) in [(0x1C12, 0x1701_u16), (0x1C13, 0x1B07)] {
        let mut chain = FakeSegment::drives(4);
        let other = &mut chain.slaves[1];
        other.read_only = vec![assignment];
        other.objects.insert((assignment, 1), fixed.to_le_bytes().to_vec());
        let error = refusal_of(1, AxisMode::Velocity, chain);
        let unlisted = Object::new(fixed, 0);
        assert!(
            matches!(error, BusError::SdoAbort { object, .. } if object == unlisted),
            "{error:?}"
        );
    }
}

#[test]
fn a_mapping_without_the_demand_is_refused_with_the_object() {
    let without = || {
        let mut slave = generic_drive();
        slave.read_only = vec![0x1600];
        slave
            .objects
            .insert((0x1600, 1), 0x6040_0010_u32.to_le_bytes().to_vec());
        slave
    };
    let expected = BusError::Mapping {
        object: generic::TARGET_VELOCITY,
        expected: 32,
        actual: 0,
    };
    assert_eq!(refusal(AxisMode::Velocity, segment(without)), expected);
}

#[test]
fn a_list_longer_than_any_is_refused() {
    let endless = || {
        let mut slave = generic_drive();
        slave.read_only = vec![0x1600];
        slave.objects.insert((0x1600, 0), vec![255]);
        slave
    };
    let object = Object::new(0x1600, 0);
    assert_eq!(
        refusal(AxisMode::Velocity, segment(endless)),
        BusError::Range { object }
    );
}

#[test]
fn a_mode_that_the_drive_does_not_show_is_refused() {
    let stubborn = || {
        let mut slave = generic_drive();
        slave.objects.insert((0x6060, 0), vec![8, 0]);
        slave
    };
    let error = refusal(AxisMode::Velocity, segment(stubborn));
    assert!(
        matches!(error, BusError::SdoAbort { object, .. } if object.index == 0x6060),
        "{error:?}"
    );
}

#[test]
fn a_quick_stop_that_a_drive_rounds_is_taken_within_2_percent_and_refused_beyond() {
    /// The last drive of the chain rounds.
    const ROUNDS: u8 = 3;
    let (mut taken, mut refused) = (0, 0);
    let mut random = 1_u32;
    let mut any = |count: u32| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 8) % count
    };
    for round in 0..80 {
        let mut settings = setup(AxisMode::Velocity);
        let acceleration = f64::from(20 + any(180));
        settings.settings = settings.settings.map(|drive| DriveSettings {
            quick_stop_rad_s2: acceleration,
            ..drive
        });
        let written = quick_stop_increments_s2(&settings.settings[0]).unwrap();
        let rounding = [Rounding::Down, Rounding::Up][any(2) as usize];
        // Up to 5 % of the value; every fourth round nearly the 2 % that are tolerated, on either side.
        let unit = match round % 4 {
            0 => written / 50 + any(3) + 1,
            _ => 1 + any(written / 20),
        };
        let unit = if round % 4 == 0 && rounding == Rounding::Down {
            written - unit + 2
        } else {
            unit
        };
        let shown = rounding.of(written, unit);
        let drive = [FakeSlave::drive, generic_drive][any(2) as usize];
        let mut chain = segment(drive);
        let slave = &mut chain.slaves[usize::from(ROUNDS)];
        slave.coarse.push((QUICK_STOP_DECELERATION.index, unit, rounding));
        let what = format!("{written} shown as {shown}, unit {unit}");
        let mut ended = None;
        run_with(
            settings,
            chain,
            |_| false,
            |_, bench, events| {
                ended = events.iter().find_map(|event| match event {
                    BusEvent::Operational => Some(None),
                    BusEvent::Refused { position, step, error } => Some(Some((*position, *step, *error))),
                    _ => None,
                });
                if ended == Some(None) {
                    assert_eq!(bench.segment.states(), [8; 4], "{what}");
                }
                if ended.is_some() { Next::Done } else { Next::On }
            },
        );
        // 2 % of what was written, to the whole increment.
        let is_near = u64::from(written.abs_diff(shown)) * 50 <= u64::from(written);
        let error = BusError::ReadBack {
            object: QUICK_STOP_DECELERATION,
            expected: written,
            actual: shown,
        };
        let expected = (!is_near).then_some((Some(ROUNDS), Step::Objects, error));
        assert_eq!(ended, Some(expected), "{what}");
        (taken, refused) = (taken + u32::from(is_near), refused + u32::from(!is_near));
    }
    assert!(taken > 10 && refused > 10, "{taken} taken, {refused} refused");
}

/// The categories of an SII: sync managers at unusual places, and the velocity objects in unusual order.
fn categories() -> Vec<u8> {
    let manager = |start, usage| SyncManagerRecord {
        start,
        usage,
        ..SyncManagerRecord::default()
    };
    let mut managers = vec![0; 32];
    for (record, place) in [
        manager(0x1800, SyncManagerUse::MailboxOut),
        manager(0x1C00, SyncManagerUse::MailboxIn),
        manager(0x1300, SyncManagerUse::Outputs),
        manager(0x1380, SyncManagerUse::Inputs),
    ]
    .into_iter()
    .zip(managers.chunks_mut(8))
    {
        record.emit(place).unwrap();
    }
    type Entries<'a> = &'a [(u16, u8)];
    let pdos = |list: &[(u16, u8, Entries<'_>)]| {
        let mut bytes = Vec::new();
        for (index, sync_manager, entries) in list {
            let pdo = PdoRecord {
                index: *index,
                entries: entries.len() as u8,
                sync_manager: *sync_manager,
                ..PdoRecord::default()
            };
            let at = bytes.len();
            bytes.resize(at + 8 * (1 + entries.len()), 0);
            pdo.emit(&mut bytes[at..]).unwrap();
            for ((index, bits), place) in entries.iter().zip(bytes[at + 8..].chunks_mut(8)) {
                let entry = PdoEntryRecord {
                    index: *index,
                    bits: *bits,
                    ..PdoEntryRecord::default()
                };
                entry.emit(place).unwrap();
            }
        }
        bytes
    };
    let outputs = pdos(&[
        (0x1701, 0xFF, &[(0x60C1, 32), (0x6040, 16)]),
        (0x1702, 2, &[(0x6040, 16), (0, 16), (0x606B, 32)]),
    ]);
    let inputs = pdos(&[(0x1B01, 3, &[(0x6041, 16), (0x6063, 32)])]);
    let mut bytes = Vec::new();
    for (kind, data) in [
        (sii::CATEGORY_SYNC_MANAGER, managers),
        (sii::CATEGORY_TX_PDO, inputs),
        (sii::CATEGORY_RX_PDO, outputs),
        (sii::CATEGORY_END, Vec::new()),
    ] {
        bytes.extend(kind.to_le_bytes());
        bytes.extend((data.len() as u16 / 2).to_le_bytes());
        bytes.extend(data);
    }
    bytes
}

#[test]
fn where_the_drive_does_not_tell_its_sii_does() {
    let silent = || {
        let mut slave = FakeSlave::drive();
        slave.objects.retain(|(index, _), _| !matches!(index, 0x1C12 | 0x1C13));
        slave.sii[2 * usize::from(sii::WORD_SIZE)] = 15;
        slave.sii.extend(categories());
        slave
    };
    operational(AxisMode::Velocity, segment(silent), |bench| {
        let slave = &bench.segment.slaves[1];
        assert_eq!((slave.manager(2).start, slave.manager(3).start), (0x1300, 0x1380));
        assert_eq!((slave.manager(2).length, slave.manager(3).length), (8, 6));
        assert_eq!(encoded(bench), [0x0F, 0, 0, 0, 0x34, 0x12, 0, 0]);
        let role = bench.exchange.plan().slaves[1].role.unwrap();
        assert_eq!(role.device, &ax2000::AX2000);
        let input = role.layout.decode(&[0x37, 0x06, 4, 3, 2, 1]).unwrap();
        assert_eq!((input.status.0, input.position), (0x0637, 0x0102_0304));
    });
}
