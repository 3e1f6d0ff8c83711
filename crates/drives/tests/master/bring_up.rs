//! Bring-up, loss and recovery of drives: the master against a small chain.

use super::fake::{FakeSegment, FakeSlave};
use super::rig::{Bench, Drives, Losses, MESSAGE, Next, SLAVES, run};
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use etherpen_ethercat::BusQueues;
use etherpen_ethercat::coe::ObjectDictionary;
use etherpen_ethercat::configure::discovery::STATION_BASE;
use etherpen_ethercat::cyclic::{Arrival, CyclicSlave, Exchange, Ignored};
use etherpen_ethercat::error::BusError;
use etherpen_ethercat::mailbox::Mailbox;
use etherpen_ethercat::state::AlReport;
use etherpen_ethercat::supervisor::{BusEvent, Step, Supervisor};
use etherpen_ethercat::wire::coe::Object;
use etherpen_ethercat::wire::sii::MailboxWindow;
use etherpen_ethercat::wire::{FrameView, register};
use std::boxed::Box;
use std::vec::Vec;

#[test]
fn four_drives_reach_op_with_every_setting_written() {
    run(
        FakeSegment::drives(4),
        |_| false,
        |now_ms, bench, events| {
            if events.first() == Some(&BusEvent::Found { slaves: 4 }) {
                assert!(now_ms < 100);
            }
            if !events.contains(&BusEvent::Operational) {
                return Next::On;
            }
            assert_eq!(bench.segment.states(), [8; 4]);
            for slave in &bench.segment.slaves {
                assert_eq!(slave.objects[&(0x1C12, 1)], [0x02, 0x17]);
                assert_eq!(slave.objects[&(0x1C13, 1)], [0x01, 0x1B]);
                assert_eq!(slave.objects[&(0x6060, 0)], [0xFE]);
                assert_eq!(slave.objects[&(0x60C2, 2)], [0xFD]);
                assert_eq!(slave.objects[&(0x6085, 0)], 200_263_264_u32.to_le_bytes());
                let watchdog = usize::from(register::WATCHDOG_SYNC_MANAGER);
                assert_eq!(slave.memory[watchdog..watchdog + 2], [100, 0]);
                assert_eq!((slave.manager(2).control, slave.manager(3).control), (0x64, 0x20));
            }
            for axis in 0..4 {
                assert_eq!(bench.exchange.member(axis), Some(axis));
                assert!(bench.exchange.input(axis).is_some());
            }
            let frames = bench.first_frames;
            std::println!("bring-up of 4 drives: {frames} frames with requests, {now_ms} ms");
            assert!(frames <= 400 && now_ms < 3_000);
            assert_eq!(bench.exchange.counters().working_counter_errors, 0);
            assert_eq!(bench.exchange.counters().frames_ignored(), 0);
            Next::Done
        },
    );
}

#[test]
fn a_chain_as_long_as_the_list_of_slaves_is_taken_and_a_longer_one_refused() {
    for slaves in [SLAVES, SLAVES + 1] {
        run(
            FakeSegment::drives(slaves),
            |_| false,
            |_, _, events| {
                let too_many = BusError::TooManySlaves {
                    expected: SLAVES as u16,
                    actual: slaves as u16,
                };
                let is_refused =
                    |event: &BusEvent| matches!(event, BusEvent::Refused { error, .. } if *error == too_many);
                let is_taken = |event: &BusEvent| matches!(event, BusEvent::Found { .. });
                match (events.iter().any(is_taken), events.iter().any(is_refused)) {
                    (false, false) => return Next::On,
                    ended => assert_eq!(ended, (slaves <= SLAVES, slaves > SLAVES)),
                }
                Next::Done
            },
        );
    }
}

#[test]
fn a_tenth_of_the_frames_lost_delays_the_bring_up_and_executes_nothing_twice() {
    run(
        FakeSegment::drives(4),
        |frame| frame.wrapping_mul(0x9E37_79B1) >> 16 & 0xFFFF < 6_500,
        |_, bench, events| {
            assert!(
                !events.iter().any(|event| matches!(event, BusEvent::Refused { .. })),
                "{events:?}"
            );
            if !events.contains(&BusEvent::Operational) {
                return Next::On;
            }
            assert!(bench.exchange.counters().frames_lost > 30);
            for slave in &bench.segment.slaves {
                assert_eq!(slave.downloads, 10);
            }
            Next::Done
        },
    );
}

#[test]
fn extra_and_unknown_slaves_are_shown_and_left_alone() {
    let mut segment = FakeSegment::drives(5);
    segment.slaves.insert(0, {
        let mut coupler = FakeSlave::drive();
        coupler.sii[20..24].copy_from_slice(&0x044C_2C52_u32.to_le_bytes());
        coupler
    });
    let mut shown = Vec::new();
    run(
        segment,
        |_| false,
        |_, bench, events| {
            shown.extend(events.iter().filter_map(|event| match event {
                BusEvent::Slave {
                    position, member, name, ..
                } => Some((*position, *member, *name)),
                _ => None,
            }));
            if !events.contains(&BusEvent::Operational) {
                return Next::On;
            }
            assert_eq!(bench.segment.states(), [1, 8, 8, 8, 8, 1]);
            assert_eq!(shown[0], (0, None, "unknown device"));
            assert_eq!(shown[1], (1, Some(0), "AX2000-B110"));
            assert_eq!(shown[5], (5, None, "AX2000-B110"));
            assert_eq!(bench.exchange.member(3), Some(4));
            Next::Done
        },
    );
}

#[test]
fn too_few_drives_are_refused_and_a_later_recover_finds_them() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[3].connected = false;
    let mut refused = false;
    run(
        segment,
        |_| false,
        |_, bench, events| {
            if let Some(BusEvent::Refused { step, error, .. }) = events.first() {
                assert_eq!(
                    (*step, *error),
                    (Step::Discover, BusError::SlaveCount { expected: 4, actual: 3 })
                );
                refused = true;
                bench.segment.slaves[3].connected = true;
                return Next::Recover;
            }
            if events.contains(&BusEvent::Operational) {
                Next::Done
            } else {
                Next::On
            }
        },
    );
    assert!(refused);
}

#[test]
fn a_refused_state_is_reported_with_slave_step_and_code() {
    let mut segment = FakeSegment::drives(4);
    segment.slaves[2].refuse_state = Some((4, 0x001E));
    run(
        segment,
        |_| false,
        |_, _, events| {
            let Some(BusEvent::Refused { position, step, error }) = events.last() else {
                return Next::On;
            };
            assert_eq!((*position, *step), (Some(2), Step::SafeOperational));
            assert_eq!(
                *error,
                BusError::State {
                    expected: 4,
                    actual: 0x12,
                    code: 0x001E
                }
            );
            assert_eq!(error.code(), 0x1E);
            Next::Done
        },
    );
}

/// Brings four drives up, does `harm`, waits for `noticed`, does `clear_faults`, recovers, and checks the others' inputs.
fn repair(
    harm: fn(&mut FakeSlave),
    noticed: fn(&BusEvent) -> bool,
    clear_faults: fn(&mut FakeSlave),
    verdict: fn(&BusEvent) -> bool,
) {
    let (mut harmed_ms, mut recovering, mut judged) = (None, false, false);
    run(
        FakeSegment::drives(4),
        |_| false,
        |now_ms, bench, events| {
            if let Some(since_ms) = harmed_ms {
                for other in [0, 2, 3] {
                    assert!(
                        bench.exchange.input(other).is_some(),
                        "slave {other} lost its inputs too"
                    );
                }
                assert!(recovering || now_ms - since_ms < 100, "not noticed within 100 ms");
            } else if events.contains(&BusEvent::Operational) {
                harm(&mut bench.segment.slaves[1]);
                harmed_ms = Some(now_ms);
            }
            if harmed_ms.is_some() && !recovering && events.iter().any(noticed) {
                recovering = true;
                clear_faults(&mut bench.segment.slaves[1]);
                return Next::Recover;
            }
            judged |= recovering && events.iter().any(verdict);
            if judged { Next::Done } else { Next::On }
        },
    );
}

fn is_repaired(event: &BusEvent) -> bool {
    *event == BusEvent::Repaired { position: 1 }
}

#[test]
fn a_slave_that_fell_to_safeop_is_brought_back_while_the_others_go_on() {
    repair(
        |slave| slave.set_al(0x14, 0x001B),
        |event| {
            *event
                == BusEvent::SlaveLeft {
                    position: 1,
                    report: AlReport {
                        status: 0x14,
                        code: 0x1B,
                    },
                }
        },
        |_| {},
        is_repaired,
    );
}

#[test]
fn a_power_cycled_slave_is_found_at_its_place_and_configured_again() {
    repair(
        FakeSlave::power_up,
        |event| *event == BusEvent::SlaveLost { position: 1 },
        |_| {},
        is_repaired,
    );
}

#[test]
fn a_swapped_product_is_refused() {
    repair(
        |slave| {
            slave.power_up();
            slave.sii[20..24].copy_from_slice(&[9, 0, 0, 0]);
        },
        |event| *event == BusEvent::SlaveLost { position: 1 },
        |_| {},
        |event| {
            let error = BusError::Identity {
                expected: 0x07D0_6014,
                actual: 9,
            };
            *event
                == BusEvent::Refused {
                    position: Some(1),
                    step: Step::Identify,
                    error,
                }
        },
    );
}

#[test]
fn a_slave_that_is_still_missing_is_refused() {
    repair(
        |slave| slave.connected = false,
        |event| *event == BusEvent::SlaveLost { position: 1 },
        |_| {},
        |event| {
            let error = BusError::SlaveCount { expected: 4, actual: 3 };
            *event
                == BusEvent::Refused {
                    position: Some(1),
                    step: Step::Locate,
                    error,
                }
        },
    );
}

#[test]
fn a_slave_plugged_in_behind_the_others_is_reported_once_and_never_mapped() {
    let (mut plugged_ms, mut reports) = (None, 0);
    run(
        FakeSegment::drives(4),
        |_| false,
        |now_ms, bench, events| {
            if events.contains(&BusEvent::Operational) {
                bench.segment.slaves.push(FakeSlave::drive());
                plugged_ms = Some(now_ms);
            }
            reports += usize::from(events.contains(&BusEvent::Found { slaves: 5 }));
            let lost = events.iter().any(|event| matches!(event, BusEvent::SlaveLost { .. }));
            assert!(!lost, "{events:?}");
            if plugged_ms.is_none_or(|since_ms| now_ms < since_ms + 500) {
                return Next::On;
            }
            let mapped = |slave: &&CyclicSlave<Drives>| slave.input_length + slave.output_length > 0;
            let plan = bench.exchange.plan();
            assert_eq!((reports, plan.slaves.iter().filter(mapped).count()), (1, 4));
            Next::Done
        },
    );
}

/// Runs one future over a port against a drive whose mailbox is set up.
fn with_dictionary<T>(
    losses: Losses,
    harm: fn(&mut FakeSlave),
    work: impl AsyncFnOnce(&mut ObjectDictionary<'_, '_, MESSAGE>) -> T,
) -> (T, FakeSlave) {
    let mut queues = Box::new(BusQueues::<Drives, SLAVES, MESSAGE>::new());
    let (exchange_end, mut supervisor_end, _) = queues.split();
    let mut segment = FakeSegment::drives(1);
    for (number, start, control) in [(0, 0x1800_u16, 0x26), (1, 0x1C00, 0x22)] {
        let at = usize::from(register::sync_manager(number));
        let [low, high] = start.to_le_bytes();
        segment.slaves[0].memory[at..at + 8].copy_from_slice(&[low, high, 0, 2, control, 0, 1, 0]);
    }
    let station = usize::from(register::STATION_ADDRESS);
    segment.slaves[0].memory[station..station + 2].copy_from_slice(&STATION_BASE.to_le_bytes());
    harm(&mut segment.slaves[0]);
    let mut bench = Bench::new(segment, exchange_end, losses);
    let window = |start| MailboxWindow { start, length: 512 };
    let mut mailbox = Mailbox::new::<MESSAGE>(STATION_BASE, window(0x1800), window(0x1C00)).unwrap();
    let mut dictionary = ObjectDictionary::new(&mut supervisor_end.port, &mut mailbox);
    let mut future = pin!(work(&mut dictionary));
    for _ in 0..20_000 {
        bench.millisecond();
        if let Poll::Ready(value) = future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            return (value, bench.segment.slaves.remove(0));
        }
    }
    panic!("the transfer did not end");
}

#[test]
fn a_long_object_is_read_in_segments() {
    let (name, _) = with_dictionary(
        |_| false,
        |_| {},
        async |dictionary| dictionary.upload(Object::new(0x1008, 0)).await,
    );
    assert_eq!(name.unwrap(), *b"AX2000-B110 EtherCAT Drive");
}

#[test]
fn an_abort_reaches_the_caller_with_object_and_code() {
    let object = Object::new(0x5555, 1);
    let (result, _) = with_dictionary(
        |_| false,
        |_| {},
        async |dictionary| dictionary.write(object, 1, 2).await,
    );
    assert_eq!(
        result,
        Err(BusError::SdoAbort {
            object,
            code: 0x0602_0000
        })
    );
    assert_eq!(etherpen_ethercat::coe::abort_text(0x0602_0000), "object does not exist");
}

#[test]
fn a_silent_mailbox_ends_in_a_time_out() {
    let (result, _) = with_dictionary(
        |_| false,
        |slave| slave.mute = true,
        async |dictionary| dictionary.read(Object::new(0x6060, 0), 1).await,
    );
    assert!(
        matches!(
            result,
            Err(BusError::MailboxTimeout {
                waited_ms: 1_001..1_010
            })
        ),
        "{result:?}"
    );
}

#[test]
fn a_message_is_executed_once_whichever_frame_gets_lost() {
    for lost in 1..16 {
        static LOST: core::sync::atomic::AtomicU32 = core::sync::atomic::AtomicU32::new(0);
        LOST.store(lost, core::sync::atomic::Ordering::Relaxed);
        let (result, slave) = with_dictionary(
            |frame| frame == LOST.load(core::sync::atomic::Ordering::Relaxed),
            |_| {},
            async |dictionary| {
                dictionary.write(Object::new(0x6060, 0), 0xFE, 1).await?;
                dictionary.read(Object::new(0x6060, 0), 1).await
            },
        );
        assert_eq!(result, Ok(0xFE), "frame {lost} lost");
        assert_eq!(slave.downloads, 1, "frame {lost} lost");
    }
}

#[test]
fn a_whole_bring_up_has_no_malformed_frame() {
    run(
        FakeSegment::drives(1),
        |_| false,
        |now_ms, bench, _| {
            let frame = bench.exchange.input_telegram().to_vec();
            let view = FrameView::new_checked(&frame).unwrap();
            assert!(view.datagrams().all(|datagram| datagram.is_ok()));
            assert_eq!(bench.exchange.receive(&frame), Arrival::Ignored(Ignored::Reflection));
            if now_ms > 20 { Next::Done } else { Next::On }
        },
    );
}

#[test]
fn the_masters_static_memory_fits_32_kib() {
    let mut queues = Box::new(BusQueues::<Drives, SLAVES, MESSAGE>::new());
    let (_, supervisor_end, _) = queues.split();
    let mut supervisor = Supervisor::new(supervisor_end);
    let state = size_of::<Supervisor<'_, Drives, SLAVES, MESSAGE>>();
    let future = size_of_val(&supervisor.run());
    let (exchange, queues) = (
        size_of::<Exchange<'_, Drives, SLAVES, MESSAGE>>(),
        size_of::<BusQueues<Drives, SLAVES, MESSAGE>>(),
    );
    std::println!("exchange {exchange}, queues {queues}, supervisor {state}, its future {future} bytes");
    assert!(exchange + queues + state + future <= 32 * 1024);
}
