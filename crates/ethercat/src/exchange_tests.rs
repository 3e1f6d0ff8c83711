//! The exchange of the critical task, frame by frame: what is used, what is dropped, what is counted.

extern crate std;

use super::BusQueues;
use super::acyclic::{IN_FLIGHT_MAX, Outcome, Request};
use super::cyclic::{
    AlStatus, Arrival, CyclicPlan, CyclicSlave, Exchange, ExchangeKind, Ignored, PROCESS_BYTES_MAX, SILENT_CYCLES,
    SPAN_BYTES_MAX,
};
use super::no_drivers::NoDrivers;
use super::process_data::LOGICAL_START;
use super::random::Random;
use super::slave_set::SlaveSet;
use super::supervisor::SupervisorEnd;
use super::wire::{
    Address, Command, Datagram, Datagrams, FRAME_LEN_MAX, FrameView, PAYLOAD_OFFSET, SOURCE_BIT, read_u16,
};
use std::boxed::Box;
use std::vec::Vec;

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const SLAVES: usize = 4;
const MESSAGE: usize = 512;
/// Slaves of an exchange whose frame is nearly full.
const MANY: usize = 19;

type TestExchange<'a> = Exchange<'a, NoDrivers, SLAVES, MESSAGE>;

fn plan(watched: bool) -> CyclicPlan<NoDrivers, SLAVES> {
    let slaves = (0..SLAVES as u32).map(|number| CyclicSlave {
        input_address: LOGICAL_START + 64 * number + 6,
        input_length: 6,
        output_address: LOGICAL_START + 64 * number,
        output_length: 6,
        watched,
        ..CyclicSlave::default()
    });
    CyclicPlan {
        slaves: slaves.collect(),
        ..CyclicPlan::default()
    }
}

/// An exchange with four watched slaves of six bytes each way; it lives as long as the program.
fn exchange() -> (
    TestExchange<'static>,
    SupervisorEnd<'static, NoDrivers, SLAVES, MESSAGE>,
) {
    let (exchange_end, mut supervisor_end, _) = Box::leak(Box::new(BusQueues::new())).split();
    assert!(supervisor_end.plans.enqueue(plan(true)).is_ok());
    (Exchange::new(exchange_end, MAC), supervisor_end)
}

fn input(exchange: &mut TestExchange<'_>) -> Vec<u8> {
    exchange.input_telegram().to_vec()
}

fn output(exchange: &mut TestExchange<'_>) -> Vec<u8> {
    exchange.output_telegram().to_vec()
}

/// Changes each datagram of a frame in place: its number and itself.
fn each_datagram(frame: &mut [u8], mut change: impl FnMut(usize, &mut Datagram<&mut [u8]>)) {
    let payload = FrameView::new_checked(frame).unwrap().payload().to_vec();
    let mut chain = Datagrams::new(&payload);
    for number in 0.. {
        let Some(range) = chain.next_range() else { break };
        let range = range.unwrap();
        let bytes = &mut frame[PAYLOAD_OFFSET + range.start..PAYLOAD_OFFSET + range.end];
        change(number, &mut Datagram::new_checked(bytes).unwrap());
    }
}

/// The reply of four slaves in OP to a telegram: inputs are 10 times the slave's number plus the byte's.
fn answered(mut frame: Vec<u8>) -> Vec<u8> {
    each_datagram(&mut frame, |number, datagram| match datagram.command_number() {
        7 => {
            datagram.data_mut().copy_from_slice(&[8, 0]);
            datagram.set_address(Address::new(SLAVES as u16, 0x0130));
            datagram.set_working_counter(SLAVES as u16);
        }
        10 => {
            (0..)
                .zip(datagram.data_mut())
                .for_each(|(byte, value)| *value = 10 * number as u8 + byte);
            datagram.set_working_counter(1);
        }
        _ => datagram.set_working_counter(1),
    });
    frame[6] |= SOURCE_BIT;
    frame
}

fn valid(exchange: &TestExchange<'_>) -> [bool; SLAVES] {
    core::array::from_fn(|slave| exchange.input(slave).is_some())
}

#[test]
fn inputs_come_and_outputs_go_in_the_same_cycle() {
    let (mut exchange, _end) = exchange();
    let reply = answered(input(&mut exchange));
    assert_eq!(exchange.receive(&reply), Arrival::Input);
    assert_eq!(exchange.input(2), Some(&[20, 21, 22, 23, 24, 25][..]));
    assert_eq!(exchange.al_status(), Some(AlStatus { status: 8, slaves: 4 }));

    exchange.output(3).copy_from_slice(b"output");
    let telegram = output(&mut exchange);
    let view = FrameView::new_checked(&telegram).unwrap();
    let last = view.datagrams().nth(3).unwrap().unwrap();
    assert_eq!((last.address().0, last.data()), (LOGICAL_START + 192, &b"output"[..]));
    assert_eq!(exchange.receive(&answered(telegram)), Arrival::Output);
    assert_eq!(exchange.counters().frames_sent, 2);
    assert_eq!(
        exchange.counters().frames_ignored() + exchange.counters().working_counter_errors,
        0
    );
}

#[test]
fn a_lost_reply_costs_one_cycle_and_old_inputs_are_not_shown_again() {
    let (mut exchange, _end) = exchange();
    let reply = answered(input(&mut exchange));
    exchange.receive(&reply);
    input(&mut exchange);
    assert_eq!(valid(&exchange), [false; SLAVES]);
    assert_eq!(exchange.al_status(), None);
    let reply = answered(input(&mut exchange));
    assert_eq!(exchange.receive(&reply), Arrival::Input);
    assert_eq!(valid(&exchange), [true; SLAVES]);
    assert_eq!(exchange.counters().frames_lost, 1);
}

#[test]
fn late_and_duplicated_replies_are_dropped_and_counted() {
    let (mut exchange, _end) = exchange();
    let late = answered(input(&mut exchange));
    let reply = answered(input(&mut exchange));
    assert_eq!(exchange.receive(&late), Arrival::Ignored(Ignored::Late));
    assert_eq!(valid(&exchange), [false; SLAVES]);
    assert_eq!(exchange.receive(&reply), Arrival::Input);
    assert_eq!(exchange.receive(&reply), Arrival::Ignored(Ignored::Duplicate));
    let counters = exchange.counters();
    assert_eq!((counters.frames_lost, counters.frames_late), (1, 1));
    assert_eq!(counters.ignored[Ignored::Duplicate as usize], 1);
}

#[test]
fn one_slaves_wrong_counter_costs_only_its_own_inputs() {
    let (mut exchange, mut end) = exchange();
    for watched in [true, false] {
        assert!(end.plans.enqueue(plan(watched)).is_ok());
        let mut reply = answered(input(&mut exchange));
        each_datagram(&mut reply, |number, datagram| {
            if number == 1 {
                datagram.set_working_counter(0);
            }
        });
        assert_eq!(exchange.receive(&reply), Arrival::Input);
        assert_eq!(valid(&exchange), [true, false, true, true]);
        // A slave that is known to be lost is not an error.
        assert_eq!(exchange.counters().working_counter_errors, 1);
    }
}

#[test]
fn frames_other_than_this_cycles_reply_are_classified() {
    use Ignored::*;
    type Change = fn(&mut Vec<u8>);
    let changes: [(Ignored, Change); 13] = [
        (EtherType, |frame| frame[12..14].copy_from_slice(&[0x81, 0x00])),
        (FrameType, |frame| frame[15] = 0x40),
        (Truncated, |frame| frame.truncate(40)),
        (Truncated, |frame| frame.truncate(9)),
        (ForeignSource, |frame| frame[11] ^= 1),
        (ForeignIndex, |frame| frame[PAYLOAD_OFFSET + 1] = 200),
        (Mismatch, |frame| frame[PAYLOAD_OFFSET + 19] = 200),
        (Mismatch, |frame| frame[PAYLOAD_OFFSET] = 12),
        (Mismatch, |frame| frame[PAYLOAD_OFFSET + 3] ^= 1),
        (Mismatch, |frame| frame[PAYLOAD_OFFSET + 6] = 5),
        (Mismatch, |frame| frame[PAYLOAD_OFFSET + 7] &= 0x7F),
        (Mismatch, |frame| frame[14] -= 1),
        (Circulating, |frame| {
            each_datagram(frame, |_, datagram| datagram.set_circulating(true))
        }),
    ];
    for (kind, change) in changes {
        let (mut exchange, _end) = exchange();
        let reply = answered(input(&mut exchange));
        let mut changed = reply.clone();
        change(&mut changed);
        assert_eq!(exchange.receive(&changed), Arrival::Ignored(kind));
        assert_eq!(valid(&exchange), [false; SLAVES], "{kind:?}");
        assert_eq!(exchange.counters().ignored[kind as usize], 1);
        // The genuine reply still counts.
        assert_eq!(exchange.receive(&reply), Arrival::Input, "after {kind:?}");
    }
}

#[test]
fn a_reflected_frame_is_no_reply_and_replies_without_the_source_bit_are() {
    let (mut exchange, _end) = exchange();
    let telegram = input(&mut exchange);
    assert_eq!(exchange.receive(&telegram), Arrival::Ignored(Ignored::Reflection));
    let mut reply = answered(telegram);
    reply[6] &= !SOURCE_BIT;
    assert_eq!(exchange.receive(&reply), Arrival::Input);

    // If slaves are known to mark replies, an unprocessed output telegram is recognised too.
    let reply = answered(input(&mut exchange));
    assert_eq!(exchange.receive(&reply), Arrival::Input);
    let telegram = output(&mut exchange);
    assert_eq!(exchange.receive(&telegram), Arrival::Ignored(Ignored::Reflection));
}

#[test]
fn every_request_gets_one_reply_in_order_lost_or_not() {
    let (mut exchange, mut end) = exchange();
    assert!(end.plans.enqueue(plan(false)).is_ok());
    let address = |register| Address::station(0x1001, register);
    for register in 0..IN_FLIGHT_MAX as u16 {
        let request = Request::read(Command::Fprd, address(register), 2);
        assert!(end.port.registers.requests.enqueue(request).is_ok());
    }
    let telegram = input(&mut exchange);
    assert!(end.port.registers.replies.dequeue().is_none());
    let mut reply = answered(telegram);
    each_datagram(&mut reply, |number, datagram| {
        if number > SLAVES {
            let register = datagram.address().register();
            datagram.data_mut().copy_from_slice(&register.to_le_bytes());
        }
    });
    assert_eq!(exchange.receive(&reply), Arrival::Input);
    for register in 0..IN_FLIGHT_MAX as u16 {
        let reply = end.port.registers.replies.dequeue().unwrap();
        assert_eq!(reply.outcome, Outcome::Processed { working_counter: 1 });
        assert_eq!(read_u16(&reply.data, 0), register);
    }

    let request = Request::read(Command::Fprd, address(0), 64);
    assert!(end.port.registers.requests.enqueue(request).is_ok());
    input(&mut exchange);
    assert!(end.port.registers.replies.dequeue().is_none());
    input(&mut exchange);
    assert_eq!(end.port.registers.replies.dequeue().unwrap().outcome, Outcome::Lost);
}

/// An exchange whose process data leave less room than the longest request needs: 28 bytes.
fn full_exchange() -> (
    Exchange<'static, NoDrivers, MANY, MESSAGE>,
    SupervisorEnd<'static, NoDrivers, MANY, MESSAGE>,
) {
    let (exchange_end, mut end, _) = Box::leak(Box::new(BusQueues::new())).split();
    let slaves = (0..MANY as u32).map(|number| CyclicSlave {
        input_address: LOGICAL_START + 64 * number,
        input_length: 32,
        output_address: LOGICAL_START + 64 * number + 32,
        output_length: 32,
        ..CyclicSlave::default()
    });
    let full = CyclicPlan {
        slaves: slaves.collect(),
        exchange: ExchangeKind::Combined,
        ..CyclicPlan::default()
    };
    assert!(end.plans.enqueue(full).is_ok());
    (Exchange::new(exchange_end, MAC), end)
}

#[test]
fn a_request_that_no_frame_has_room_for_is_answered_in_its_turn() {
    let (mut exchange, mut end) = full_exchange();
    let mut outcomes_after_frame = |lengths: &[usize]| {
        for length in lengths {
            let request = Request::read(Command::Fprd, Address::station(0x1001, 0x0110), *length);
            assert!(end.port.registers.requests.enqueue(request).is_ok());
        }
        exchange.input_telegram();
        let replies = core::iter::from_fn(|| end.port.registers.replies.dequeue());
        replies.map(|reply| reply.outcome).collect::<Vec<_>>()
    };
    let no_room = Outcome::NoRoom { room: 28 };
    assert_eq!(outcomes_after_frame(&[64]), [no_room]);
    assert_eq!(outcomes_after_frame(&[2, 64, 64, 4]), []);
    assert_eq!(outcomes_after_frame(&[]), [Outcome::Lost, no_room, no_room]);
    assert_eq!(outcomes_after_frame(&[]), [Outcome::Lost]);
    assert!(end.port.registers.requests.is_empty());
}

#[test]
fn what_exactly_fills_the_frame_travels_and_what_is_a_byte_longer_is_answered() {
    const AT: Address = Address::station(0x1001, 0x1000);
    for (length, is_message) in [27, 28, 29]
        .into_iter()
        .flat_map(|length| [(length, false), (length, true)])
    {
        let (mut exchange, mut end) = full_exchange();
        match is_message {
            true => drop(
                end.port
                    .messages
                    .requests
                    .enqueue(Request::read(Command::Fprd, AT, length)),
            ),
            false => drop(
                end.port
                    .registers
                    .requests
                    .enqueue(Request::read(Command::Fprd, AT, length)),
            ),
        }
        let telegram = exchange.input_telegram().to_vec();
        let outcome = match is_message {
            true => end.port.messages.replies.dequeue().map(|reply| reply.outcome),
            false => end.port.registers.replies.dequeue().map(|reply| reply.outcome),
        };
        let view = FrameView::new_checked(&telegram).unwrap();
        let last = view.datagrams().last().unwrap().unwrap();
        let travels = (last.address(), last.data().len()) == (AT, length);
        assert_eq!(travels, length <= 28, "{length} bytes, message {is_message}");
        let no_room = Outcome::NoRoom { room: 28 };
        assert_eq!(outcome, (length > 28).then_some(no_room), "message {is_message}");
        assert_eq!(telegram.len() == FRAME_LEN_MAX, length == 28, "message {is_message}");
    }
}

#[test]
fn a_reply_in_which_a_request_was_changed_on_the_way_does_not_count() {
    let (mut exchange, mut end) = exchange();
    assert!(end.plans.enqueue(plan(false)).is_ok());
    for register in 0..2 {
        let request = Request::read(Command::Fprd, Address::station(0x1001, register), 2);
        assert!(end.port.registers.requests.enqueue(request).is_ok());
    }
    let reply = answered(input(&mut exchange));
    for changed_request in [1, 2] {
        let mut changed = reply.clone();
        each_datagram(&mut changed, |number, datagram| {
            if number == SLAVES + changed_request {
                datagram.set_address(Address::station(0x1002, 1));
            }
        });
        assert_eq!(exchange.receive(&changed), Arrival::Ignored(Ignored::Mismatch));
        assert!(end.port.registers.replies.dequeue().is_none());
    }
    assert_eq!(exchange.receive(&reply), Arrival::Input);
    for _ in 0..2 {
        let outcome = end.port.registers.replies.dequeue().unwrap().outcome;
        assert_eq!(outcome, Outcome::Processed { working_counter: 1 });
    }
}

#[test]
fn in_operation_a_frame_carries_one_acyclic_datagram_and_none_is_lost() {
    let (mut exchange, mut end) = exchange();
    let address = |register| Address::station(0x1001, register);
    let registers = 0..IN_FLIGHT_MAX as u16;
    let message = Request::read(Command::Fprd, address(0x1C00), 64);
    assert!(end.port.messages.requests.enqueue(message).is_ok());
    for register in registers.clone() {
        let request = Request::read(Command::Fprd, address(register), 2);
        assert!(end.port.registers.requests.enqueue(request).is_ok());
    }
    // A register request, the message, the other register requests; the last frame carries none.
    let in_order = [0, 0x1C00].into_iter().chain(registers.clone().skip(1));
    for expected in in_order.map(Some).chain([None]) {
        let mut reply = answered(input(&mut exchange));
        let mut acyclic = Vec::new();
        each_datagram(&mut reply, |number, datagram| {
            if number > SLAVES {
                acyclic.push(datagram.address().register());
            }
        });
        assert_eq!(acyclic, Vec::from_iter(expected));
        assert_eq!(exchange.receive(&reply), Arrival::Input);
        assert_eq!(valid(&exchange), [true; SLAVES]);
    }
    let processed = Some(Outcome::Processed { working_counter: 1 });
    for _ in registers {
        let reply = end.port.registers.replies.dequeue();
        assert_eq!(reply.map(|reply| reply.outcome), processed);
    }
    assert!(end.port.registers.replies.dequeue().is_none());
    let reply = end.port.messages.replies.dequeue();
    assert_eq!(
        reply.map(|reply| (reply.data.len(), reply.outcome)),
        processed.map(|outcome| (64, outcome))
    );
}

#[test]
fn in_operation_neither_requests_nor_messages_wait_for_more_than_one_datagram_of_the_other() {
    let (mut exchange, mut end) = exchange();
    let (mut requests, mut messages) = (0, 0);
    for cycle in 0..100 {
        while end.port.registers.requests.ready() {
            let request = Request::read(Command::Fprd, Address::station(0x1001, 0x0110), 2);
            assert!(end.port.registers.requests.enqueue(request).is_ok());
        }
        // In every seventh cycle no message is queued.
        if cycle % 7 != 0 && end.port.messages.requests.ready() {
            let message = Request::read(Command::Fprd, Address::station(0x1001, 0x1C00), 64);
            assert!(end.port.messages.requests.enqueue(message).is_ok());
        }
        let reply = answered(input(&mut exchange));
        assert_eq!(exchange.receive(&reply), Arrival::Input);
        while end.port.registers.replies.dequeue().is_some() {
            requests += 1;
        }
        while end.port.messages.replies.dequeue().is_some() {
            messages += 1;
        }
        assert!(
            requests >= messages && requests + messages == cycle + 1,
            "in cycle {cycle}"
        );
    }
    assert!(messages >= 40, "{messages} messages, {requests} requests");
}

#[test]
fn the_supervisor_hears_of_changes_and_of_silence() {
    let (mut exchange, mut end) = exchange();
    for _ in 0..3 {
        let reply = answered(input(&mut exchange));
        exchange.receive(&reply);
    }
    input(&mut exchange);
    let seen = end.observations.dequeue().unwrap();
    assert_eq!(
        (seen.al, seen.answered, seen.silent),
        (AlStatus { status: 8, slaves: 4 }, SlaveSet::from(0b1111), false)
    );
    assert_eq!(end.observations.dequeue(), None);
    (0..SILENT_CYCLES + 2).for_each(|_| drop(input(&mut exchange)));
    let seen = end.observations.dequeue().unwrap();
    assert_eq!((seen.al.slaves, seen.answered, seen.silent), (0, SlaveSet::NONE, true));
}

#[test]
fn the_status_of_unused_slaves_is_left_out_for_control_but_not_for_the_supervisor() {
    let (mut exchange, mut end) = exchange();
    assert!(
        end.plans
            .enqueue(CyclicPlan {
                al_bits_ignored: 1,
                ..plan(true)
            })
            .is_ok()
    );
    let mut reply = answered(input(&mut exchange));
    each_datagram(&mut reply, |number, datagram| {
        if number == SLAVES {
            datagram.data_mut().copy_from_slice(&[9, 0]);
        }
    });
    exchange.receive(&reply);
    assert_eq!(exchange.al_status().map(|al| al.status), Some(8));
    input(&mut exchange);
    assert_eq!(end.observations.dequeue().map(|seen| seen.al.status), Some(9));
}

#[test]
fn without_a_plan_there_are_no_outputs_and_a_removed_slaves_outputs_are_cleared() {
    let (mut exchange, mut end) = exchange();
    assert!(output(&mut exchange).is_empty());
    input(&mut exchange);
    exchange.output(0).fill(7);
    assert!(exchange.output(SLAVES).is_empty());
    assert!(end.plans.enqueue(plan(false)).is_ok());
    input(&mut exchange);
    assert_eq!(exchange.output(0), [7; 6], "a new flag does not touch outputs");
    assert!(end.plans.enqueue(CyclicPlan::default()).is_ok());
    assert!(end.plans.enqueue(plan(true)).is_ok());
    input(&mut exchange);
    assert_eq!(exchange.output(0), [0; 6]);
}

#[test]
fn outputs_of_a_terminal_that_left_operation_are_zero_until_they_are_set_again() {
    let (mut exchange, mut end) = exchange();
    let with = |watched| CyclicPlan {
        terminals: SlaveSet::of(1),
        ..plan(watched)
    };
    for watched in [true, false, true] {
        assert!(end.plans.enqueue(with(watched)).is_ok());
        input(&mut exchange);
        assert_eq!(exchange.output(1), [0; 6], "watched: {watched}");
        exchange.output(1).fill(7);
        exchange.output(0).fill(7);
        // The plan does not change for this slave.
        assert!(end.plans.enqueue(with(watched)).is_ok());
        input(&mut exchange);
        assert_eq!(exchange.output(1), [7; 6]);
        assert_eq!(
            exchange.output(0),
            [7; 6],
            "a slave that is no terminal keeps its outputs"
        );
    }
}

#[test]
fn outputs_of_a_terminal_are_unconfirmed_from_its_first_plan_on_until_no_plan_names_it() {
    let (mut exchange, mut end) = exchange();
    for terminals in [SlaveSet::of(0), SlaveSet::NONE, SlaveSet::places(&[1, 3])] {
        let plan = CyclicPlan {
            terminals,
            ..plan(true)
        };
        assert!(end.plans.enqueue(plan).is_ok());
        let reply = answered(input(&mut exchange));
        exchange.receive(&reply);
        let telegram = output(&mut exchange);
        assert_eq!(exchange.unconfirmed(), terminals);
        exchange.receive(&answered(telegram));
        assert_eq!(exchange.unconfirmed(), SlaveSet::NONE);
    }
}

#[test]
fn a_slave_without_room_in_the_frame_costs_no_other_its_inputs() {
    const MANY: usize = 24;
    // Of the first ones, with 12 bytes more than their data each, so many have room; the last one has 14 bytes in all.
    const WITH_ROOM: usize = if PROCESS_BYTES_MAX == 32 { 19 } else { 6 };
    const STEP: u32 = SPAN_BYTES_MAX as u32;
    let slaves = (0..MANY as u32).map(|number| {
        let length = if number as usize == MANY - 1 {
            1
        } else {
            PROCESS_BYTES_MAX as u16
        };
        let start = LOGICAL_START + STEP * number;
        CyclicSlave {
            input_address: start,
            input_length: length,
            output_address: start + u32::from(length),
            output_length: length,
            watched: true,
            ..CyclicSlave::default()
        }
    });
    let plan = CyclicPlan::<NoDrivers, MANY> {
        slaves: slaves.collect(),
        exchange: ExchangeKind::Combined,
        ..CyclicPlan::default()
    };
    let queues = Box::leak(Box::new(BusQueues::<NoDrivers, MANY, MESSAGE>::new()));
    let (exchange_end, mut end, _) = queues.split();
    let mut exchange: Exchange<'_, NoDrivers, MANY, MESSAGE> = Exchange::new(exchange_end, MAC);
    assert!(end.plans.enqueue(plan).is_ok());
    let mut reply = exchange.input_telegram().to_vec();
    let mut places = Vec::new();
    each_datagram(&mut reply, |_, datagram| {
        if datagram.command_number() == Command::Lrw as u8 {
            let place = (datagram.address().0 - LOGICAL_START) / STEP;
            places.push(place as usize);
            datagram.data_mut().fill(place as u8);
            datagram.set_working_counter(3);
        }
    });
    reply[6] |= SOURCE_BIT;
    assert_eq!(exchange.receive(&reply), Arrival::Input);
    let expected: Vec<usize> = (0..WITH_ROOM).chain([MANY - 1]).collect();
    assert_eq!(places, expected);
    for place in 0..MANY {
        let length = if place == MANY - 1 { 1 } else { PROCESS_BYTES_MAX };
        let on_the_wire = [place as u8; PROCESS_BYTES_MAX];
        let expected = places.contains(&place).then_some(&on_the_wire[..length]);
        assert_eq!(exchange.input(place), expected, "slave {place}");
        assert_eq!(exchange.has_answered(place), expected.is_some(), "slave {place}");
    }
}

#[test]
fn requests_and_replies_cross_unharmed_when_the_two_sides_run_at_the_same_time() {
    const REQUESTS: u16 = if cfg!(miri) { 40 } else { 2_000 };
    let (mut exchange, mut end) = exchange();
    std::thread::scope(|scope| {
        let slow_side = scope.spawn(move || {
            let lane = &mut end.port.registers;
            let (mut sent, mut received) = (0, 0);
            while received < REQUESTS {
                while sent < REQUESTS && lane.requests.ready() {
                    let request = Request::read(Command::Fprd, Address::station(0x1001, sent), 2);
                    assert!(lane.requests.enqueue(request).is_ok());
                    sent += 1;
                }
                while let Some(reply) = lane.replies.dequeue() {
                    assert_eq!(reply.outcome, Outcome::Processed { working_counter: 1 });
                    assert_eq!(read_u16(&reply.data, 0), received);
                    received += 1;
                }
                std::thread::yield_now();
            }
        });
        while !slow_side.is_finished() {
            let mut reply = answered(input(&mut exchange));
            each_datagram(&mut reply, |number, datagram| {
                if number > SLAVES {
                    let register = datagram.address().register();
                    datagram.data_mut().copy_from_slice(&register.to_le_bytes());
                }
            });
            assert_eq!(exchange.receive(&reply), Arrival::Input);
            std::thread::yield_now();
        }
    });
}

#[test]
fn no_frame_whatever_its_bytes_panics_or_passes_unless_it_is_the_reply() {
    const FRAMES: u32 = if cfg!(miri) { 200 } else { 20_000 };
    let (mut exchange, _end) = exchange();
    let mut generator = Random::new(0x1234_5678);
    let mut random = || generator.next();
    let mut inputs = 0;
    for _ in 0..FRAMES {
        let mut reply = answered(input(&mut exchange));
        let original = reply.clone();
        for _ in 0..random() % 4 {
            let at = random() as usize % reply.len();
            reply[at] ^= 1 << (random() % 8);
        }
        reply.truncate(reply.len() - (random() % 3) as usize * (random() as usize % reply.len()) / 2);
        if exchange.receive(&reply) == Arrival::Input {
            inputs += 1;
            // Every accepted frame has the original's headers.
            let view = FrameView::new_checked(&reply).unwrap();
            let sent = FrameView::new_checked(&original).unwrap();
            assert!(view.datagrams().zip(sent.datagrams()).all(|(got, want)| {
                let (got, want) = (got.unwrap(), want.unwrap());
                got.command_number() == want.command_number() && got.data().len() == want.data().len()
            }));
        }
    }
    assert!((FRAMES / 10..FRAMES / 20 * 19).contains(&inputs), "{inputs}");
}
