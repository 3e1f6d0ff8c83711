//! Service requests to slaves that are not as the master has left them.

use super::fake::{FakeSegment, FakeSlave};
use super::rig::{Drives, Next, run_with, setup};
use etherpen_ethercat::diagnostics::{ServiceReply, ServiceRequest, ServiceResult};
use etherpen_ethercat::event::{BusEvent, BusSetup};
use etherpen_ethercat::state::{AlReport, AlState};
use etherpen_ethercat::wire::coe::Object;
use etherpen_ethercat::wire::sii;

/// What happens to the slaves before a request.
type Before = fn(&mut FakeSegment);

/// Starts a bus, which then is in operation or refused, and sends requests one after the other; returns their answers.
fn answers(setup: BusSetup<Drives>, segment: FakeSegment, requests: &[(Before, ServiceRequest)]) -> Vec<ServiceResult> {
    let (mut requests, mut answers) = (requests.iter(), Vec::new());
    run_with(
        setup,
        segment,
        |_| false,
        |_, bench, events| {
            let is_started = |event: &BusEvent| matches!(event, BusEvent::Operational | BusEvent::Refused { .. });
            let answer = bench.answer.take();
            if answer.is_none() && !(answers.is_empty() && events.iter().any(is_started)) {
                return Next::On;
            }
            answers.extend(answer);
            let Some((before, request)) = requests.next() else {
                return Next::Done;
            };
            before(&mut bench.segment);
            bench.request = Some(request.clone());
            Next::On
        },
    );
    answers
}

/// A slave without a driver. Its objects list 2 bytes of outputs and 9 of inputs, its memory 1 and 3.
fn described_twice() -> FakeSlave {
    let mut slave = FakeSlave::drive();
    slave.sii[20..24].copy_from_slice(&0x044C_2C52_u32.to_le_bytes());
    slave.sii.resize(128, 0);
    slave
        .sii
        .extend([sii::CATEGORY_SYNC_MANAGER, 16].map(u16::to_le_bytes).as_flattened());
    for (start, length, control, usage) in [
        (0x1800_u16, 512_u16, 0x26, 1),
        (0x1C00, 512, 0x22, 2),
        (0x1100, 1, 0x64, 3),
        (0x1400, 3, 0x20, 4),
    ] {
        slave.sii.extend([start, length].map(u16::to_le_bytes).as_flattened());
        slave.sii.extend([control, 0, 1, usage]);
    }
    slave.sii.extend([0xFF; 4]);
    for (object, value) in [
        ((0x1701, 0), vec![1]),
        ((0x1701, 1), 0x7000_0110_u32.to_le_bytes().to_vec()),
        ((0x1B01, 0), vec![2]),
        ((0x1B01, 1), 0x6000_0140_u32.to_le_bytes().to_vec()),
        ((0x1B01, 2), 0x6001_0108_u32.to_le_bytes().to_vec()),
    ] {
        slave.objects.insert(object, value);
    }
    slave
}

#[test]
fn the_lengths_of_process_data_are_those_of_the_objects_once_the_master_has_set_up_the_mailbox() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves.push(described_twice());
    let unchanged: Before = |_| {};
    let device_name = ServiceRequest::Upload {
        slave: 4,
        object: Object::new(0x1008, 0),
        complete: false,
        offset: 0,
    };
    let answers = answers(
        setup(),
        segment,
        &[
            (unchanged, ServiceRequest::Slave { slave: 4 }),
            // Another master has brought it to PREOP: its mailbox is anywhere.
            (
                |segment| segment.slaves[4].set_al(2, 0),
                ServiceRequest::Slave { slave: 4 },
            ),
            (|segment| segment.slaves[4].set_al(1, 0), device_name),
            (unchanged, ServiceRequest::Slave { slave: 4 }),
        ],
    );
    let lengths = answers.iter().filter_map(|answer| match answer {
        Ok(ServiceReply::Slave(info)) => Some((info.report.state(), info.output_bytes, info.input_bytes)),
        _ => None,
    });
    let expected = [
        (Some(AlState::Init), 1, 3),
        (Some(AlState::PreOperational), 1, 3),
        (Some(AlState::PreOperational), 2, 9),
    ];
    assert_eq!(lengths.collect::<Vec<_>>(), expected, "{answers:#?}");
}

#[test]
fn a_slave_that_has_got_an_error_meanwhile_that_only_init_clears_is_brought_up_by_a_request() {
    // There is a slave too few: the bus is not in operation, and nobody watches its slaves.
    let setup = BusSetup { members: 5, ..setup() };
    let answers = answers(
        setup,
        FakeSegment::drives(4),
        &[
            (|_| {}, ServiceRequest::Slave { slave: 1 }),
            // Another master has had it in SAFEOP and gone away.
            (
                |segment| {
                    segment.slaves[1].sticky_error = true;
                    segment.slaves[1].set_al(0x14, 0x1B);
                },
                ServiceRequest::SetState {
                    slave: 1,
                    state: AlState::Operational,
                },
            ),
        ],
    );
    let [Ok(ServiceReply::Slave(before)), Ok(ServiceReply::State(report))] = &answers[..] else {
        panic!("{answers:#?}");
    };
    assert_eq!(before.report.state(), Some(AlState::Init));
    let operational = AlReport {
        status: AlState::Operational as u8,
        code: 0,
    };
    assert_eq!(*report, operational);
}
