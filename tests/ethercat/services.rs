//! Service requests, on a bus that was brought up and on one that was not.

use crate::device_images::eight;
use crate::rig::{Rig, idle_rig, idle_rig_of, rig};
use etherpen::control::robot_axes::{AxisCommand, Demand};
use etherpen::drives::cia402::DriveTarget;
use etherpen::ethercat::diagnostics::{ServiceError, ServiceReply, ServiceRequest, SlaveInfo};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::state::{AlReport, AlState};
use etherpen::ethercat::supervisor::{BusCommand, BusEvent};
use etherpen::ethercat::wire::coe::Object;
use etherpen::ethercat::wire::register;
use etherpen::robots::AXES;
use host_tools::cell::{self, Fault};

/// Device name, a visible string.
const DEVICE_NAME: Object = Object::new(0x1008, 0);
/// CiA 402 status word.
const STATUS_WORD: Object = Object::new(0x6041, 0);

fn upload(slave: u8, object: Object) -> ServiceRequest {
    ServiceRequest::Upload {
        slave,
        object,
        complete: false,
        offset: 0,
    }
}

fn set_state(slave: u8, state: AlState) -> ServiceRequest {
    ServiceRequest::SetState { slave, state }
}

fn in_state(state: AlState) -> AlReport {
    AlReport {
        status: state as u8,
        code: 0,
    }
}

fn info(rig: &mut Rig<'_>, slave: u8) -> SlaveInfo {
    match rig.ask(ServiceRequest::Slave { slave }) {
        Ok(ServiceReply::Slave(info)) => info,
        other => panic!("{other:?}"),
    }
}

fn al_states(rig: &Rig<'_>) -> Vec<cell::AlState> {
    rig.cell.state().slaves.iter().map(|slave| slave.al_state).collect()
}

#[test]
pub(crate) fn without_a_bus_the_slaves_are_found_and_identified_and_nothing_is_configured() {
    let mut rig = idle_rig("");
    let Ok(ServiceReply::Bus(bus)) = rig.ask(ServiceRequest::Bus) else {
        panic!("no answer");
    };
    assert_eq!((bus.slaves, bus.operational), (4, false));
    for slave in 0..4 {
        let info = info(&mut rig, slave);
        println!("{info:?}");
        assert_eq!((info.identity.vendor, info.identity.product), (2, 0x07D0_6014));
        assert_eq!(info.identity.serial, u32::from(slave) + 1);
        assert_eq!(info.driver, "AX2000-B110");
        assert!(info.name.starts_with("AX2000"), "{}", info.name);
        assert_eq!((info.member, info.report), (None, in_state(AlState::Init)));
        let before = slave.checked_sub(1);
        let behind = (slave < 3).then_some(slave + 1);
        assert_eq!(info.ports.map(|port| port.partner), [before, behind, None, None]);
    }
    assert_eq!(al_states(&rig), [cell::AlState::Init; 4]);
    assert_eq!(
        rig.ask(ServiceRequest::Slave { slave: 4 }),
        Err(ServiceError::NoSlave { slaves: 4 })
    );
}

#[test]
pub(crate) fn without_a_bus_an_sdo_brings_its_slave_to_preop_and_no_other() {
    let mut rig = idle_rig("");
    let name = rig.value(upload(2, DEVICE_NAME));
    assert!(name.starts_with(b"AX2000"), "{name:?}");
    use cell::AlState::{Init, PreOperational};
    assert_eq!(al_states(&rig), [Init, Init, PreOperational, Init]);
}

#[test]
pub(crate) fn registers_and_information_are_read_in_pieces() {
    let mut rig = idle_rig("");
    let address = register::TYPE;
    let length = 200;
    let bytes = rig.value(ServiceRequest::Registers {
        slave: 0,
        address,
        length,
    });
    assert_eq!(bytes.len(), 200);
    let request = |word, length| ServiceRequest::Information { slave: 1, word, length };
    let identity = rig.value(request(8, 16));
    assert_eq!(identity[..8], [2, 0, 0, 0, 0x14, 0x60, 0xD0, 0x07]);
    assert!(rig.value(request(0, 256)).len() > 128);
}

#[test]
pub(crate) fn an_sdo_in_operation_disturbs_no_cyclic_data() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(20);
    for slave in 0..4 {
        let answer = rig.ask_while(upload(slave, STATUS_WORD), &[0, 1, 2, 3]);
        assert!(matches!(answer, Ok(ServiceReply::Piece { total: 2, .. })), "{answer:?}");
    }
    let info = info(&mut rig, 3);
    assert_eq!((info.member, info.report), (Some(3), in_state(AlState::Operational)));
    assert!(info.status_word.is_some());
    assert_eq!((info.output_bytes, info.input_bytes), (6, 6));
}

#[test]
pub(crate) fn switches_are_asked_for_in_init_and_preop_and_never_in_operation() {
    let place = cell::PlaceOptions {
        identification: Some(7),
        ..cell::PlaceOptions::default()
    };
    let mut rig = idle_rig_of(cell::CellOptions {
        places: vec![place; 4],
        ..cell::CellOptions::default()
    });
    rig.start();
    rig.operational();
    rig.run_ms(20);
    let before = rig.state_requests;
    for state in [AlState::Operational, AlState::SafeOperational] {
        if state == AlState::SafeOperational {
            rig.ask(set_state(2, state)).expect("a lower state");
        }
        let before = rig.state_requests;
        let seen = info(&mut rig, 2);
        assert_eq!((seen.report, seen.switch), (in_state(state), None));
        assert_eq!(rig.state_requests, before, "AL control was written in {state:?}");
    }
    assert!(rig.state_requests > before, "the test sees requests");
    rig.ask(set_state(2, AlState::PreOperational)).expect("a lower state");
    assert_eq!(info(&mut rig, 2).switch, Some(7));
    rig.ask(set_state(2, AlState::Operational)).expect("it comes back");
    assert_eq!(info(&mut rig, 2).switch, Some(7), "what was read stays known");
}

#[test]
pub(crate) fn an_abort_reaches_the_asker_with_object_and_code() {
    let mut rig = rig("");
    rig.operational();
    let object = Object::new(0x5123, 4);
    let answer = rig.ask(upload(1, object));
    let Err(ServiceError::Bus(BusError::SdoAbort { object: theirs, code })) = answer else {
        panic!("{answer:?}");
    };
    assert_eq!((theirs, code), (object, 0x0602_0000));
}

#[test]
pub(crate) fn a_slave_left_in_preop_is_left_alone_until_it_is_asked_up_again_or_the_bus_is_repaired() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(20);
    let others = [0, 2, 3];
    let answer = rig.ask_while(set_state(1, AlState::PreOperational), &others);
    assert_eq!(answer, Ok(ServiceReply::State(in_state(AlState::PreOperational))));
    for _ in 0..500 {
        for event in rig.millisecond() {
            let noise = matches!(
                event,
                BusEvent::SlaveLost { .. } | BusEvent::SlaveLeft { .. } | BusEvent::Repaired { .. }
            );
            assert!(!noise, "{event:?}");
        }
        for other in others {
            assert!(rig.inputs[other].is_some());
        }
    }
    assert_eq!(al_states(&rig)[1], cell::AlState::PreOperational);
    let answer = rig.ask_while(set_state(1, AlState::Operational), &others);
    assert_eq!(answer, Ok(ServiceReply::State(in_state(AlState::Operational))));
    rig.run_ms(10);
    assert!(rig.inputs.iter().all(Option::is_some));
    assert!(rig.log.ends_with(&[BusEvent::Operational]) || rig.log.contains(&BusEvent::Operational));
    // A repair brings a slave back to OP even if a request brought it down.
    let answer = rig.ask_while(set_state(1, AlState::PreOperational), &others);
    assert_eq!(answer, Ok(ServiceReply::State(in_state(AlState::PreOperational))));
    rig.recover();
    rig.operational();
    rig.run_ms(10);
    assert_eq!(al_states(&rig)[1], cell::AlState::Operational);
    assert!(rig.inputs.iter().all(Option::is_some));
}

#[test]
pub(crate) fn a_slave_that_is_asked_out_of_op_and_back_is_no_disturbance() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(20);
    let before = rig.counters().working_counter_errors;
    for state in [AlState::PreOperational, AlState::Operational] {
        let answer = rig.ask_while(set_state(1, state), &[0, 2, 3]);
        assert_eq!(answer, Ok(ServiceReply::State(in_state(state))));
        rig.run_ms(20);
    }
    assert_eq!(rig.counters().working_counter_errors, before);
}

#[test]
pub(crate) fn a_slave_without_an_axis_gets_process_data_with_which_it_stays_in_op() {
    let mut rig = idle_rig("");
    for target in [AlState::Operational, AlState::PreOperational, AlState::Operational] {
        let answer = rig.ask(set_state(3, target));
        assert_eq!(answer, Ok(ServiceReply::State(in_state(target))));
        // Longer than any watchdog.
        rig.run_ms(500);
        assert_eq!(info(&mut rig, 3).report, in_state(target));
    }
    let exchanged = info(&mut rig, 3);
    assert_eq!((exchanged.output_bytes > 0, exchanged.input_bytes > 0), (true, true));
    assert_eq!(al_states(&rig)[..3], [cell::AlState::Init; 3]);
    let answer = rig.ask(set_state(3, AlState::Init));
    assert_eq!(answer, Ok(ServiceReply::State(in_state(AlState::Init))));
}

#[test]
pub(crate) fn a_slave_that_falls_while_another_answers_slowly_is_noticed_within_100_ms() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(50);
    rig.cell.inject(Fault::Silence(2, 5_000));
    rig.run_ms(5);
    assert!(rig.services.enqueue(upload(1, STATUS_WORD)).is_ok());
    rig.run_ms(100);
    rig.cell.inject(Fault::Retreat(4, 0x001D));
    let took_ms = rig.wait_for(100, |event| matches!(event, BusEvent::SlaveLeft { position: 3, .. }));
    println!("noticed after {took_ms} ms");
    rig.run_ms(5);
    assert_eq!(rig.answers.dequeue(), Some(Err(ServiceError::Interrupted)));
    // The reply to the dropped request is skipped.
    rig.run_ms(5_000);
    let answer = rig.ask(upload(1, STATUS_WORD));
    assert!(matches!(answer, Ok(ServiceReply::Piece { total: 2, .. })), "{answer:?}");
}

#[test]
pub(crate) fn a_slave_lost_during_the_repair_of_another_is_noticed_within_100_ms_and_both_come_back() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(50);
    rig.cell.inject(Fault::Retreat(2, 0x001D));
    rig.wait_for(100, |event| matches!(event, BusEvent::SlaveLeft { position: 1, .. }));
    // The repair goes through INIT and hangs at a silent mailbox.
    assert!(rig.ask(set_state(1, AlState::Init)).is_ok());
    rig.run_ms(20);
    rig.cell.inject(Fault::Retreat(3, 0x001D));
    rig.wait_for(100, |event| matches!(event, BusEvent::SlaveLeft { position: 2, .. }));
    rig.cell.inject(Fault::Silence(3, 400));
    rig.recover();
    rig.run_ms(5);
    rig.cell.inject(Fault::Remove(4));
    let took_ms = rig.wait_for(100, |event| *event == BusEvent::SlaveLost { position: 3 });
    println!("noticed after {took_ms} ms");
    rig.cell.inject(Fault::Insert(4));
    rig.run_ms(3_000);
    rig.recover();
    rig.run_ms(2_000);
    let answer = rig.ask(set_state(1, AlState::Operational));
    assert_eq!(answer, Ok(ServiceReply::State(in_state(AlState::Operational))));
    rig.run_ms(20);
    assert!(rig.inputs.iter().all(Option::is_some), "{:#?}", rig.log);
}

#[test]
pub(crate) fn a_stop_sends_safe_outputs_first_and_ends_in_init() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(50);
    assert!(rig.commands.enqueue(BusCommand::Stop).is_ok());
    rig.wait_for(1_000, |event| *event == BusEvent::Stopped);
    rig.run_ms(20);
    assert_eq!(al_states(&rig), [cell::AlState::Init; 4]);
    assert!(rig.cell.state().slaves.iter().all(|slave| slave.al_status_code == 0));
    rig.start();
    rig.operational();
    rig.run_ms(10);
    assert_eq!(rig.inputs.iter().flatten().count(), AXES);
}

#[test]
pub(crate) fn requests_while_the_bus_is_brought_up_are_answered_by_busy() {
    let mut rig = rig("");
    rig.run_ms(30);
    assert_eq!(rig.ask(ServiceRequest::Bus), Err(ServiceError::Busy));
    rig.operational();
    assert!(rig.ask(ServiceRequest::Bus).is_ok());
}

#[test]
pub(crate) fn error_counters_name_the_slaves_at_both_ends_of_a_cable() {
    let mut rig = rig("");
    rig.operational();
    let Ok(ServiceReply::Errors(errors)) = rig.ask(ServiceRequest::Errors { slave: 2 }) else {
        panic!("no answer");
    };
    assert_eq!(errors.partners, [Some(1), Some(3), None, None]);
    assert_eq!(rig.ask(ServiceRequest::ClearErrors), Ok(ServiceReply::Done));
}

/// Four drives and a slave that no driver knows: four outputs behind a processor that checks its sync manager.
fn rig_with_stranger() -> Rig<'static> {
    let mut description = eight().into_iter().nth(1).expect("four outputs");
    // No device emulation.
    description.configuration[0] = 0x0004;
    let mut slaves = vec![cell::SlaveKind::Ax2000; AXES];
    slaves.push(cell::SlaveKind::Sii(description.image().into()));
    idle_rig_of(cell::CellOptions {
        slaves,
        ..cell::CellOptions::default()
    })
}

#[test]
pub(crate) fn a_slave_without_a_driver_gets_the_sync_managers_that_it_describes_and_goes_to_op() {
    const STRANGER: u8 = AXES as u8;
    for is_running in [false, true] {
        let mut rig = rig_with_stranger();
        let others: &[usize] = if is_running { &[0, 1, 2, 3] } else { &[] };
        if is_running {
            rig.start();
            rig.operational();
            rig.run_ms(20);
        }
        let before = info(&mut rig, STRANGER);
        assert_eq!(before.report, in_state(AlState::Init));
        assert_eq!(
            (before.output_bytes, before.input_bytes),
            (1, 0),
            "what would be exchanged"
        );
        for target in [
            AlState::Operational,
            AlState::Init,
            AlState::SafeOperational,
            AlState::Operational,
        ] {
            let answer = rig.ask_while(set_state(STRANGER, target), others);
            assert_eq!(
                answer,
                Ok(ServiceReply::State(in_state(target))),
                "running: {is_running}"
            );
            // Longer than any watchdog.
            for _ in 0..500 {
                rig.millisecond();
                assert!(others.iter().all(|axis| rig.inputs[*axis].is_some()));
            }
            let after = info(&mut rig, STRANGER);
            assert_eq!((after.report, after.output_bytes), (in_state(target), 1));
        }
        assert_eq!(rig.cell.outputs(AXES + 1), Some(vec![0]), "they are exchanged, and off");
    }
}

/// A bus whose bring-up has just failed because a drive refused a state once: the next one is due in some seconds.
fn failed(state: cell::AlState) -> Rig<'static> {
    const DRIVE: usize = 3;
    // May pass: the drive has lost its synchronisation.
    const CODE: u16 = 0x001A;
    let mut rig = idle_rig("");
    rig.cell.inject(Fault::Refuse(DRIVE, state, CODE));
    rig.start();
    rig.wait_for(5_000, |event| {
        matches!(
            event,
            BusEvent::Refused {
                error: BusError::State { code: CODE, .. },
                ..
            }
        )
    });
    rig
}

/// Time from a failed bring-up to the bus in operation while a request is sent every 200 ms; `None` after 20 s.
fn operational_beside(request: Option<&ServiceRequest>) -> Option<u64> {
    let mut rig = failed(cell::AlState::SafeOperational);
    for now_ms in 0..20_000_u64 {
        if let Some(request) = request.filter(|_| now_ms.is_multiple_of(200)) {
            assert!(rig.services.enqueue(request.clone()).is_ok());
        }
        if rig.millisecond().contains(&BusEvent::Operational) {
            return Some(now_ms);
        }
        while let Some(answer) = rig.answers.dequeue() {
            assert!(matches!(answer, Ok(_) | Err(ServiceError::Busy)), "{answer:?}");
        }
    }
    None
}

#[test]
pub(crate) fn error_counters_read_again_and_again_postpone_no_bring_up_and_work_on_a_slave_does() {
    let undisturbed_ms = operational_beside(None).expect("unasked");
    // A request in progress is finished first.
    const LATER_MS: u64 = 20;
    for slave in 0..AXES as u8 {
        let beside_ms = operational_beside(Some(&ServiceRequest::Errors { slave })).expect("unasked");
        assert!(
            (undisturbed_ms..=undisturbed_ms + LATER_MS).contains(&beside_ms),
            "{beside_ms} ms instead of {undisturbed_ms} ms"
        );
    }
    let registers = ServiceRequest::Registers {
        slave: 0,
        address: register::TYPE,
        length: 2,
    };
    assert_eq!(operational_beside(Some(&registers)), None);
}

#[test]
pub(crate) fn drives_that_requests_put_in_op_on_a_failed_bus_are_no_bus_in_operation_and_are_shut_down_at_the_next_start()
 {
    for state in [
        cell::AlState::PreOperational,
        cell::AlState::SafeOperational,
        cell::AlState::Operational,
    ] {
        let mut rig = failed(state);
        for slave in 0..AXES as u8 {
            let answer = rig.ask(set_state(slave, AlState::Operational));
            assert_eq!(
                answer,
                Ok(ServiceReply::State(in_state(AlState::Operational))),
                "{state:?}"
            );
        }
        rig.command = AxisCommand {
            target: DriveTarget::Enabled,
            demand: Demand::Velocity(0.5),
        };
        rig.run_ms(1_000);
        assert_eq!(al_states(&rig), [cell::AlState::Operational; AXES]);
        let drives = |rig: &Rig<'_>| -> Vec<cell::DriveState> {
            rig.cell.state().slaves.iter().map(|slave| slave.drive).collect()
        };
        // A bring-up that got as far as OP was shut down: its drives are nobody's axes any more, and take no commands.
        let expected = match state {
            cell::AlState::Operational => cell::DriveState::SwitchOnDisabled,
            _ => cell::DriveState::OperationEnabled,
        };
        assert_eq!(drives(&rig), [expected; AXES], "{state:?}");
        assert!(!rig.log.contains(&BusEvent::Operational), "{state:?}: {:#?}", rig.log);
        rig.start();
        let mut before = drives(&rig);
        let mut left = [false; AXES];
        while !left.iter().all(|left| *left) {
            rig.millisecond();
            assert!(!rig.log.contains(&BusEvent::Operational), "{state:?}");
            for (drive, al_state) in al_states(&rig).into_iter().enumerate() {
                if al_state != cell::AlState::Operational && !left[drive] {
                    left[drive] = true;
                    // Its power was taken by its control word, not by the loss of its process data.
                    assert_eq!(
                        before[drive],
                        cell::DriveState::SwitchOnDisabled,
                        "drive {drive}, {state:?}"
                    );
                }
            }
            before = drives(&rig);
        }
        rig.command = AxisCommand::default();
        rig.operational();
        assert_eq!(al_states(&rig), [cell::AlState::Operational; AXES]);
    }
}
