//! Two equal drives with exchanged cables, told apart by alias, switches or serial number.

use super::fake::FakeSegment;
use super::rig::{Next, run_with, setup};
use etherpen_ethercat::driver::ExpectedIdentity;
use etherpen_ethercat::error::{BusError, IdentityProperty};
use etherpen_ethercat::event::{BusEvent, BusSetup, Step};
use etherpen_ethercat::wire::write_bytes;

type Drives = super::rig::Drives;

/// What tells the drives apart.
const KINDS: [IdentityProperty; 3] = [
    IdentityProperty::Alias,
    IdentityProperty::Switch,
    IdentityProperty::Serial,
];

/// Four drives with the numbers 21 to 24 of a kind, and a bus that expects them in this order.
pub(crate) fn numbered(kind: IdentityProperty) -> (FakeSegment, BusSetup<Drives>) {
    let (mut segment, mut setup) = (FakeSegment::drives(4), setup());
    for (number, (slave, drive)) in (21_u16..).zip(segment.slaves.iter_mut().zip(&mut setup.settings)) {
        let expected = &mut drive.identity;
        match kind {
            IdentityProperty::Alias => (slave.alias, expected.alias) = (number, number),
            IdentityProperty::Switch => (slave.switch, expected.switch) = (Some(number), number),
            _ => {
                write_bytes(&mut slave.sii, 28, &u32::from(number).to_le_bytes());
                expected.serial = number.into();
            }
        }
        slave.power_up();
    }
    (segment, setup)
}

fn wrong(property: IdentityProperty, place: u8, other: u8) -> (Option<u8>, Step, BusError) {
    let error = BusError::WrongSlave {
        property,
        expected: 21 + u32::from(place),
        actual: 21 + u32::from(other),
        other: Some(other),
    };
    (Some(place), Step::Identify, error)
}

fn refusals(events: &[BusEvent]) -> impl Iterator<Item = (Option<u8>, Step, BusError)> {
    events.iter().filter_map(|event| match event {
        BusEvent::Refused { position, step, error } => Some((*position, *step, *error)),
        _ => None,
    })
}

#[test]
fn exchanged_drives_are_refused_at_bring_up_with_both_places_until_they_are_put_back() {
    for kind in KINDS {
        let (mut segment, setup) = numbered(kind);
        segment.slaves.swap(1, 2);
        let mut is_refused = false;
        run_with(
            setup,
            segment,
            |_| false,
            |_, bench, events| {
                if let Some(refusal) = refusals(events).next() {
                    assert!(!is_refused, "{refusal:?}");
                    assert_eq!(refusal, wrong(kind, 1, 2));
                    assert_eq!(bench.segment.states(), [1; 4], "nobody has left INIT");
                    is_refused = true;
                    bench.segment.slaves.swap(1, 2);
                    return Next::Recover;
                }
                match events.contains(&BusEvent::Operational) {
                    true => {
                        assert!(is_refused, "{kind:?}: the wrong order was taken");
                        Next::Done
                    }
                    false => Next::On,
                }
            },
        );
    }
}

#[test]
fn drives_exchanged_while_they_were_off_are_refused_in_the_repair_with_both_places() {
    for kind in KINDS {
        println!("{kind:?}");
        let (segment, setup) = numbered(kind);
        let (mut lost, mut refused, mut is_back) = (0, Vec::new(), false);
        run_with(
            setup,
            segment,
            |_| false,
            |_, bench, events| {
                let segment = &mut bench.segment;
                refused.extend(refusals(events));
                for event in events {
                    match event {
                        BusEvent::Operational if is_back => return Next::Done,
                        BusEvent::Operational => {
                            segment.slaves.swap(1, 2);
                            segment.slaves[1].power_up();
                            segment.slaves[2].power_up();
                        }
                        BusEvent::SlaveLost { .. } => lost += 1,
                        _ => {}
                    }
                }
                if lost == 2 {
                    lost = 0;
                    return Next::Recover;
                }
                if refused.len() == 2 && !is_back {
                    assert_eq!(refused, [wrong(kind, 1, 2), wrong(kind, 2, 1)]);
                    assert_eq!(segment.states()[1..3], [1; 2], "neither has left INIT");
                    // Under power: what a refusal leaves behind must not keep the right order from being seen.
                    segment.slaves.swap(1, 2);
                    is_back = true;
                    return Next::Recover;
                }
                Next::On
            },
        );
        assert_eq!(refused.len(), 2);
    }
}

#[test]
fn a_drive_of_another_product_or_without_the_number_is_refused_without_a_second_place() {
    let revision = ExpectedIdentity {
        revision: 0x1109,
        ..ExpectedIdentity::ANY
    };
    let alias = ExpectedIdentity {
        alias: 5,
        ..ExpectedIdentity::ANY
    };
    let switch = ExpectedIdentity {
        switch: 5,
        ..ExpectedIdentity::ANY
    };
    for (expected, property, value, actual) in [
        (revision, IdentityProperty::Revision, 0x1109, 0x110A),
        (alias, IdentityProperty::Alias, 5, 0),
        (switch, IdentityProperty::Switch, 5, 0),
    ] {
        let mut setup = setup();
        setup.settings[3].identity = expected;
        run_with(
            setup,
            FakeSegment::drives(4),
            |_| false,
            |_, _, events| {
                assert!(!events.contains(&BusEvent::Operational));
                let Some(refusal) = refusals(events).next() else {
                    return Next::On;
                };
                let error = BusError::WrongSlave {
                    property,
                    expected: value,
                    actual,
                    other: None,
                };
                assert_eq!(refusal, (Some(3), Step::Identify, error));
                Next::Done
            },
        );
    }
}
