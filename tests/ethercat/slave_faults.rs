//! Faults of slaves at every stage: states, information memory, mailbox, and the chain itself.

use crate::rig::{Rig, idle_rig, idle_rig_of, rig};
use etherpen::drives::io::IoTrigger;
use etherpen::ethercat::diagnostics::{ServiceError, ServiceReply, ServiceRequest};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::slave_set::SlaveSet;
use etherpen::ethercat::supervisor::BusEvent;
use etherpen::ethercat::wire::coe::Object;
use etherpen::robots::AXES;
use host_tools::cell::{self, CellOptions, Fault, MailFault, MailStep, Product, SiiFault, SlaveKind};

/// Device name, longer than an expedited transfer takes.
const DEVICE_NAME: Object = Object::new(0x1008, 0);
/// Longest time within which a change of the bus is noticed, ms.
const NOTICED_MAX_MS: u64 = 100;
/// Milliseconds without inputs after which a slave counts as touched: cycles during a change of the chain are lost.
const SILENT_MAX_MS: u32 = 3;
/// Longest time that a refusal takes, ms: all waiting ends.
const REFUSED_MAX_MS: u64 = 20_000;

fn name_of(slave: u8) -> ServiceRequest {
    ServiceRequest::Upload {
        slave,
        object: DEVICE_NAME,
        complete: false,
        offset: 0,
    }
}

/// Runs until the bring-up is refused or done; returns the refusal.
fn refusal(rig: &mut Rig<'_>) -> Option<(Option<u8>, BusError)> {
    let from = rig.log.len();
    rig.wait_for(REFUSED_MAX_MS, |event| {
        matches!(event, BusEvent::Refused { .. } | BusEvent::Operational)
    });
    rig.log[from..].iter().find_map(|event| match event {
        BusEvent::Refused { position, error, .. } => Some((*position, *error)),
        _ => None,
    })
}

fn assert_well(rig: &mut Rig<'_>, what: &str) {
    rig.run_ms(20);
    for slave in rig.cell.state().slaves.iter().take(AXES) {
        let state = (slave.al_state, slave.al_status_code);
        assert_eq!(state, (cell::AlState::Operational, 0), "{what}: {:#?}", rig.log);
    }
    assert!(rig.inputs.iter().all(Option::is_some), "{what}: {:#?}", rig.log);
}

#[test]
pub(crate) fn a_refused_state_is_reported_with_its_code_even_0_and_reached_at_the_next_try() {
    use cell::AlState::{Operational, PreOperational, SafeOperational};
    // Sync managers, their types, those of outputs and of inputs; mappings of inputs and of outputs; what does not fit together.
    let about_data = [0x0017, 0x001C, 0x001D, 0x001E, 0x0024, 0x0025, 0x0026];
    for state in [PreOperational, SafeOperational, Operational] {
        for code in about_data.into_iter().chain([0, 0x0016, 0x001B, 0xFFFF]) {
            for slave in [1, 3] {
                let mut rig = idle_rig("");
                rig.cell.inject(Fault::Refuse(slave, state, code));
                // A drive that refuses the sync managers of an equal one is configured once more with its own.
                let is_tried_again = (slave, state) == (3, SafeOperational) && about_data.contains(&code);
                if is_tried_again {
                    rig.cell.inject(Fault::Refuse(slave, state, code));
                }
                rig.start();
                let what = format!("slave {slave} refuses {state:?} with {code:#06X}");
                let found = refusal(&mut rig);
                let Some((
                    Some(position),
                    BusError::State {
                        expected,
                        actual,
                        code: told,
                    },
                )) = found
                else {
                    panic!("{what}: {found:?}");
                };
                assert_eq!(
                    (usize::from(position) + 1, expected, told),
                    (slave, state as u8, code),
                    "{what}"
                );
                assert!(actual & 0x10 != 0, "{what}: {actual:#04X}");
                rig.recover();
                rig.operational();
                assert_well(&mut rig, &what);
            }
        }
    }
}

#[test]
pub(crate) fn a_slave_that_falls_back_in_op_with_any_code_is_named_and_repaired_and_disturbs_no_other() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(50);
    for slave in 1..=AXES {
        for code in [0, 0x001A, 0x001B, 0x002C, 0xFFFF] {
            let what = format!("slave {slave} falls back with {code:#06X}");
            rig.cell.inject(Fault::Retreat(slave, code));
            let from = rig.log.len();
            let mut noticed_ms = 0;
            for ms in 0..5_000 {
                rig.millisecond();
                for other in (0..AXES).filter(|other| other + 1 != slave) {
                    assert!(rig.inputs[other].is_some(), "{what}: axis {other} lost an input");
                }
                let left = rig.log[from..].iter().any(|event| {
                    matches!(event, BusEvent::SlaveLeft { position, report }
                        if usize::from(*position) + 1 == slave && report.code == code && report.is_flagged())
                });
                if left && noticed_ms == 0 {
                    noticed_ms = ms + 1;
                    rig.recover();
                }
                if rig.log[from..].contains(&BusEvent::Operational) {
                    break;
                }
            }
            assert!((1..=NOTICED_MAX_MS).contains(&noticed_ms), "{what}: {noticed_ms} ms");
            assert_well(&mut rig, &what);
        }
    }
}

#[test]
pub(crate) fn a_slave_that_falls_back_during_the_bring_up_ends_it_and_the_next_try_succeeds() {
    let mut clean = rig("");
    let whole_ms = clean.operational();
    for part in 1..12 {
        let at_ms = whole_ms * part / 12;
        let mut rig = rig(&format!("ms {at_ms} retreat 2 0x001D"));
        let mut tries = 1;
        while refusal(&mut rig).is_some() {
            tries += 1;
            assert!(tries < 4, "{at_ms} ms: {:#?}", rig.log);
            rig.recover();
        }
        rig.run_ms(150);
        if rig.log.iter().any(|event| matches!(event, BusEvent::SlaveLeft { .. })) {
            rig.recover();
            rig.run_ms(500);
        }
        println!("at {at_ms} of {whole_ms} ms: {tries} tries");
        assert_well(&mut rig, &format!("at {at_ms} ms"));
    }
}

#[test]
pub(crate) fn an_information_memory_that_fails_is_named_and_one_that_is_whole_again_is_read() {
    for fault in [
        SiiFault::Busy,
        SiiFault::Acknowledge,
        SiiFault::Blank,
        SiiFault::Damaged,
        SiiFault::Owned,
    ] {
        let mut rig = idle_rig("");
        rig.cell.inject(Fault::Sii(2, fault));
        rig.start();
        let found = refusal(&mut rig);
        println!("{fault:?}: {found:?}");
        match (fault, found) {
            (SiiFault::Busy, Some((Some(1), BusError::SiiBusy { .. })))
            | (SiiFault::Acknowledge, Some((Some(1), BusError::Sii { .. }))) => {}
            // An unknown slave is not a drive.
            (SiiFault::Blank | SiiFault::Damaged, Some((_, BusError::MemberCount { expected: 4, actual: 3 }))) => {}
            // The master takes the memory from the slave's own processor.
            (SiiFault::Owned, _) => {}
            other => panic!("{other:?}: {:#?}", rig.log),
        }
        rig.cell.inject(Fault::Sii(2, SiiFault::Whole));
        rig.run_ms(5);
        if found.is_some() {
            // A damaged memory looks like that of another product, which no waiting changes.
            if fault == SiiFault::Damaged {
                rig.recover();
            }
            rig.operational();
        }
        assert_well(&mut rig, &format!("{fault:?}"));
    }
}

#[test]
pub(crate) fn a_mailbox_fault_at_any_step_of_the_bring_up_is_overcome_or_named_and_the_next_try_succeeds() {
    let faults = [
        MailFault::Abort(0x0800_0020),
        MailFault::Silent,
        MailFault::Lost,
        MailFault::Counter,
        MailFault::Flood(6),
    ];
    for fault in faults {
        for request in 1..=12 {
            let what = format!("{fault:?} at request {request}");
            let mut rig = idle_rig("");
            rig.cell.inject(Fault::Mailbox(1, MailStep::Request(request), fault));
            rig.start();
            let found = refusal(&mut rig);
            match (fault, found) {
                (_, None)
                | (MailFault::Abort(_), Some((Some(0), BusError::SdoAbort { code: 0x0800_0020, .. })))
                // A list that the slave refuses to show is taken from its information memory.
                | (MailFault::Abort(_), Some((Some(0), BusError::Mapping { .. })))
                | (MailFault::Silent, Some((Some(0), BusError::MailboxTimeout { .. }))) => {}
                other => panic!("{what}: {other:?}"),
            }
            if found.is_some() {
                println!("{what}: {found:?}");
                rig.recover();
                rig.operational();
            }
            assert_well(&mut rig, &what);
        }
    }
}

#[test]
pub(crate) fn a_mailbox_fault_in_op_reaches_the_asker_or_is_overcome_and_costs_no_cyclic_data() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(50);
    let all = [0, 1, 2, 3];
    for (slave, fault) in (0..4).cycle().zip([
        MailFault::Abort(0x0601_0001),
        MailFault::Silent,
        MailFault::Lost,
        MailFault::Counter,
        MailFault::Flood(1),
        MailFault::Flood(20),
    ]) {
        rig.cell
            .inject(Fault::Mailbox(usize::from(slave) + 1, MailStep::Request(1), fault));
        rig.run_ms(2);
        let answer = rig.ask_while(name_of(slave), &all);
        println!("{fault:?}: {answer:?}");
        match (fault, &answer) {
            (MailFault::Abort(code), Err(ServiceError::Bus(BusError::SdoAbort { object, code: told }))) => {
                assert_eq!((*object, *told), (DEVICE_NAME, code));
            }
            (MailFault::Silent, Err(ServiceError::Bus(BusError::MailboxTimeout { .. }))) => {}
            (MailFault::Lost | MailFault::Counter | MailFault::Flood(_), Ok(ServiceReply::Piece { .. })) => {}
            other => panic!("{other:?}"),
        }
        let answer = rig.ask_while(name_of(slave), &all);
        assert!(
            matches!(&answer, Ok(ServiceReply::Piece { piece, .. }) if piece.starts_with(b"AX2000")),
            "after {fault:?}: {answer:?}"
        );
    }
    assert_well(&mut rig, "mailboxes");
}

/// What happens to the chain, for how long, what ends it, and which axes must not notice.
struct Change {
    what: &'static str,
    fault: Fault,
    end: Option<Fault>,
    untouched: &'static [usize],
}

#[test]
pub(crate) fn slaves_and_cables_that_go_and_come_are_noticed_in_time_and_taken_back() {
    let changes = [
        Change {
            what: "slave 3 is bypassed",
            fault: Fault::Remove(3),
            end: Some(Fault::Insert(3)),
            untouched: &[0, 1, 3],
        },
        Change {
            what: "the last slave is bypassed",
            fault: Fault::Remove(4),
            end: Some(Fault::Insert(4)),
            untouched: &[0, 1, 2],
        },
        Change {
            what: "the cable behind slave 2 is pulled",
            fault: Fault::Cut(2),
            end: Some(Fault::Join),
            untouched: &[0, 1],
        },
        Change {
            what: "the master's cable is pulled",
            fault: Fault::Cut(0),
            end: Some(Fault::Join),
            untouched: &[],
        },
        Change {
            what: "slave 4 is power-cycled",
            fault: Fault::Power(4, 200),
            end: None,
            untouched: &[0, 1, 2],
        },
        Change {
            what: "slave 1 is power-cycled, and the chain behind it is gone meanwhile",
            fault: Fault::Power(1, 200),
            end: None,
            untouched: &[],
        },
        Change {
            what: "slave 2 is replaced by one of the same product",
            fault: Fault::Swap(2, Product::Ax2000),
            end: None,
            untouched: &[],
        },
        Change {
            what: "nothing gets through for 60 ms: the drives' watchdogs expire",
            fault: Fault::Stall(60),
            end: None,
            untouched: &[],
        },
    ];
    for change in changes {
        let what = change.what;
        let mut rig = rig("");
        rig.operational();
        rig.run_ms(50);
        rig.cell.inject(change.fault);
        let noticed_ms = rig.wait_for(NOTICED_MAX_MS, |event| {
            matches!(event, BusEvent::SlaveLost { .. } | BusEvent::SlaveLeft { .. })
        });
        println!("{what}: noticed after {noticed_ms} ms");
        for _ in 0..300 {
            rig.millisecond();
            for axis in change.untouched {
                assert!(rig.inputs[*axis].is_some(), "{what}: axis {axis} lost an input");
            }
        }
        if let Some(end) = change.end {
            rig.cell.inject(end);
        }
        rig.run_ms(50);
        rig.recover();
        for ms in 0.. {
            assert!(ms < 20_000, "{what}: {:#?}", rig.log);
            let done = rig.millisecond().contains(&BusEvent::Operational);
            for axis in change.untouched {
                assert!(rig.inputs[*axis].is_some(), "{what}: axis {axis} lost an input");
            }
            if done {
                break;
            }
        }
        assert_well(&mut rig, what);
    }
}

#[test]
pub(crate) fn a_slave_that_is_replaced_during_repairs_while_those_behind_it_are_away_takes_its_own_place() {
    for away in [Fault::Cut(2), Fault::Remove(3), Fault::Remove(4)] {
        for delay_ms in (4..160).step_by(16) {
            let what = format!("{away:?}, {delay_ms} ms");
            let mut rig = rig("");
            rig.operational();
            rig.run_ms(50);
            for fault in [
                away,
                Fault::Power(3, 50),
                Fault::Power(4, 50),
                Fault::Swap(2, Product::Cia402),
            ] {
                rig.cell.inject(fault);
            }
            rig.run_ms(300);
            rig.recover();
            rig.run_ms(delay_ms);
            rig.cell.inject(Fault::Swap(2, Product::Ax2000));
            rig.run_ms(300);
            for end in [Fault::Join, Fault::Insert(3), Fault::Insert(4)] {
                rig.cell.inject(end);
            }
            for _ in 0..5 {
                rig.recover();
                rig.run_ms(700);
            }
            assert_well(&mut rig, &what);
        }
    }
}

#[test]
pub(crate) fn a_slave_that_returns_while_another_is_identified_at_its_place_loses_nothing() {
    for delay_ms in 0..60 {
        let mut rig = rig("");
        rig.operational();
        rig.run_ms(50);
        for fault in [Fault::Remove(1), Fault::Swap(2, Product::Ax2000), Fault::Stall(23)] {
            rig.cell.inject(fault);
        }
        rig.run_ms(300);
        rig.recover();
        rig.run_ms(delay_ms);
        rig.cell.inject(Fault::Insert(1));
        rig.run_ms(300);
        for _ in 0..5 {
            rig.recover();
            rig.run_ms(700);
        }
        assert_well(&mut rig, &format!("{delay_ms} ms"));
    }
}

#[test]
pub(crate) fn a_slave_that_returns_before_one_that_is_being_identified_costs_no_other_its_address() {
    let mut touched = Vec::new();
    for delay_ms in 0..60 {
        let mut rig = rig("");
        rig.operational();
        rig.run_ms(50);
        for fault in [Fault::Remove(1), Fault::Swap(3, Product::Ax2000)] {
            rig.cell.inject(fault);
        }
        rig.run_ms(300);
        rig.recover();
        rig.run_ms(delay_ms);
        rig.cell.inject(Fault::Insert(1));
        let (mut silent_ms, mut longest_ms) = ([0; 2], 0);
        for _ in 0..1_000 {
            rig.millisecond();
            for (silent_ms, axis) in silent_ms.iter_mut().zip([1, 3]) {
                *silent_ms = if rig.inputs[axis].is_some() { 0 } else { *silent_ms + 1 };
                longest_ms = longest_ms.max(*silent_ms);
            }
        }
        if longest_ms >= SILENT_MAX_MS {
            touched.push(delay_ms);
        }
        for _ in 0..5 {
            rig.recover();
            rig.run_ms(700);
        }
        assert_well(&mut rig, &format!("{delay_ms} ms"));
    }
    println!("another slave got the temporary address: {touched:?}");
    // It is given by place, in the millisecond after the places were read.
    assert!(touched.len() <= 1, "{touched:?}");
}

#[test]
pub(crate) fn another_product_in_a_slaves_place_is_refused_until_the_right_one_is_back() {
    for product in [Product::Cia402, Product::Ek1100] {
        let mut rig = rig("");
        rig.operational();
        rig.run_ms(50);
        rig.cell.inject(Fault::Swap(2, product));
        rig.wait_for(NOTICED_MAX_MS, |event| {
            matches!(
                event,
                BusEvent::SlaveLost { position: 1 } | BusEvent::SlaveLeft { position: 1, .. }
            )
        });
        rig.run_ms(100);
        rig.recover();
        rig.wait_for(5_000, |event| {
            matches!(
                event,
                BusEvent::Refused {
                    position: Some(1),
                    error: BusError::Identity { .. },
                    ..
                }
            )
        });
        for _ in 0..200 {
            rig.millisecond();
            assert!([0, 2, 3].iter().all(|axis| rig.inputs[*axis].is_some()), "{product:?}");
        }
        assert!(rig.cell.state().slaves[1].al_state < cell::AlState::SafeOperational);
        rig.cell.inject(Fault::Swap(2, Product::Ax2000));
        rig.run_ms(100);
        rig.recover();
        rig.operational();
        assert_well(&mut rig, "the right product");
    }
}

#[test]
pub(crate) fn a_drive_that_only_its_device_type_tells_is_replaced_by_one_with_another_serial_number() {
    for slave in 1..=AXES {
        let mut rig = idle_rig_of(CellOptions {
            slaves: vec![SlaveKind::Cia402; AXES],
            ..CellOptions::default()
        });
        rig.start();
        rig.operational();
        rig.run_ms(50);
        // The first of the refused ones goes to PREOP only at the second try: nobody can ask it before.
        for refuses in [true, false] {
            rig.cell.inject(Fault::Swap(slave, Product::Cia402));
            if refuses {
                rig.cell
                    .inject(Fault::Refuse(slave, cell::AlState::PreOperational, 0x0016));
            }
            rig.wait_for(NOTICED_MAX_MS, |event| {
                matches!(event, BusEvent::SlaveLost { .. } | BusEvent::SlaveLeft { .. })
            });
            rig.run_ms(100);
            rig.recover();
            if refuses {
                let (position, error) = refusal(&mut rig).expect("it refuses");
                assert_eq!(position, Some(slave as u8 - 1));
                assert!(matches!(error, BusError::State { code: 0x0016, .. }), "{error:?}");
                rig.recover();
            }
            rig.operational();
            assert_well(&mut rig, "the new drive");
        }
    }
}

#[test]
pub(crate) fn a_coupler_that_nobody_uses_is_recognised_after_a_loss_of_its_power_at_any_time() {
    // All drives fall silent with it for a moment: it lies before them, and the frames that are on their way are lost.
    for at_ms in 0..20 {
        let mut rig = idle_rig_of(CellOptions {
            slaves: std::iter::once(SlaveKind::Ek1100)
                .chain(vec![SlaveKind::Ax2000; AXES])
                .collect(),
            ..CellOptions::default()
        });
        rig.setup.terminals = SlaveSet::NONE;
        rig.start();
        rig.operational();
        rig.run_ms(50 + at_ms);
        let lasts_ms = [20, 50, 300, 1_246][at_ms as usize % 4];
        rig.cell.inject(Fault::Power(1, lasts_ms));
        rig.run_ms(lasts_ms as u32 + 1_000);
        rig.recover();
        rig.run_ms(2_000);
        // What the critical side sees of the states is OP alone, and it stays so.
        for _ in 0..200 {
            rig.millisecond();
            let seen = rig.group.bus_state().al_status;
            assert_eq!(seen, Some(cell::AlState::Operational as u8), "{at_ms}: {:#?}", rig.log);
        }
        let introduced = rig.log.iter().rev().find_map(|event| match event {
            BusEvent::Slave {
                position: 0, report, ..
            } => Some(*report),
            _ => None,
        });
        assert!(
            introduced.is_some_and(|report| report.status != 0),
            "{at_ms}: {introduced:?}"
        );
    }
}

/// Four drives in OP, and a fifth one behind them that has been reported.
pub(crate) fn with_a_spare_drive() -> Rig<'static> {
    let mut rig = idle_rig_of(CellOptions {
        slaves: vec![SlaveKind::Ax2000; AXES + 1],
        ..CellOptions::default()
    });
    rig.cell.inject(Fault::Remove(AXES + 1));
    rig.run_ms(5);
    rig.start();
    rig.operational();
    rig.run_ms(50);
    rig.cell.inject(Fault::Insert(AXES + 1));
    let took_ms = rig.wait_for(1_000, |event| {
        matches!(
            event,
            BusEvent::Found { slaves: 5 } | BusEvent::Slave { position: 4, .. }
        )
    });
    println!("reported after {took_ms} ms");
    rig
}

#[test]
pub(crate) fn an_extra_slave_is_reported_and_gets_no_process_data() {
    let mut rig = with_a_spare_drive();
    for _ in 0..500 {
        rig.millisecond();
        assert!(rig.inputs.iter().all(Option::is_some));
    }
    assert!(rig.cell.state().slaves[AXES].al_state < cell::AlState::SafeOperational);
    assert_well(&mut rig, "beside an extra slave");
}

#[test]
pub(crate) fn a_cable_that_destroys_frames_costs_these_frames_and_is_named_by_its_ends() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(300);
    let before = rig.counters().frames_lost;
    rig.cell.inject(Fault::Crc(2, 3));
    let mut missing = 0;
    let mut named = false;
    for _ in 0..1_000 {
        let cable = |event: &BusEvent| {
            matches!(
                event,
                BusEvent::CableErrors {
                    position: 2,
                    partner: Some(1),
                    ..
                }
            )
        };
        named |= rig.millisecond().iter().any(cable);
        missing += u32::from(rig.inputs.iter().any(Option::is_none));
    }
    let lost = rig.counters().frames_lost - before;
    println!(
        "{lost} frames lost, {missing} cycles without inputs; {:?}",
        rig.log.last()
    );
    assert_eq!(lost, 3);
    assert!(missing <= 2, "three frames in a row are two of inputs at most");
    assert!(named, "{:#?}", rig.log);
    assert_well(&mut rig, "after damaged frames");
}

#[test]
pub(crate) fn a_slave_whose_processor_hangs_costs_the_others_nothing_and_is_usable_again() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(50);
    rig.cell.inject(Fault::Processor(2, 300));
    for _ in 0..500 {
        rig.millisecond();
        assert!([0, 2, 3].iter().all(|axis| rig.inputs[*axis].is_some()));
    }
    println!("{:?}", rig.log.last());
    rig.recover();
    rig.run_ms(1_000);
    assert_well(&mut rig, "after the hang");
    let answer = rig.ask(name_of(1));
    assert!(matches!(answer, Ok(ServiceReply::Piece { .. })), "{answer:?}");
}
