//! Both kinds of exchange in every encapsulation: what a fault costs, and what rides along.

extern crate std;

use super::BusQueues;
use super::acyclic::{Outcome, Request};
use super::cyclic::{Arrival, CyclicPlan, CyclicSlave, Exchange, ExchangeKind, Ignored, ReferenceClock};
use super::encapsulation::Encapsulation;
use super::error::BusError;
use super::no_drivers::NoDrivers;
use super::process_data::LOGICAL_START;
use super::slave_set::SlaveSet;
use super::supervisor::SupervisorEnd;
use super::wire::{Address, Command, Datagram, Datagrams, FRAME_LEN_MAX, SOURCE_BIT, UdpRepr, read_u16};
use core::net::Ipv4Addr;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::boxed::Box;
use std::vec;
use std::vec::Vec;

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const SLAVES: usize = 4;
const MESSAGE: usize = 1024;
const TIME_NS: u64 = 0x0123_4567_89AB_CDEF;
const UDP: UdpRepr = UdpRepr::request(MAC, Ipv4Addr::new(10, 0, 2, 15), Ipv4Addr::new(10, 0, 2, 2));
const ENVELOPES: [Encapsulation; 3] = [Encapsulation::Raw, Encapsulation::Udp(UDP), Encapsulation::Bare];
const KINDS: [ExchangeKind; 2] = [ExchangeKind::Split, ExchangeKind::Combined];

type TestEnd = SupervisorEnd<'static, NoDrivers, SLAVES, MESSAGE>;

/// An exchange whose cycles are answered by four slaves with eleven bytes each way.
struct Rig {
    exchange: Exchange<'static, NoDrivers, SLAVES, MESSAGE>,
    end: TestEnd,
    start: usize,
}

fn plan(exchange: ExchangeKind) -> CyclicPlan<NoDrivers, SLAVES> {
    let slaves = (0..SLAVES as u32).map(|number| CyclicSlave {
        input_address: LOGICAL_START + 64 * number + 11,
        input_length: 11,
        output_address: LOGICAL_START + 64 * number,
        output_length: 11,
        watched: true,
        ..CyclicSlave::default()
    });
    CyclicPlan {
        slaves: slaves.collect(),
        exchange,
        clock: Some(ReferenceClock {
            station: 0x1001,
            slaves: 4,
            wide: true,
            is_spread: true,
            time_number: 0,
            period: ReferenceClock::period_of_ns(1_000_000),
        }),
        ..CyclicPlan::default()
    }
}

/// A [`plan`] with no slave in operation: acyclic datagrams share frames.
fn starting(exchange: ExchangeKind) -> CyclicPlan<NoDrivers, SLAVES> {
    let mut plan = plan(exchange);
    plan.slaves.iter_mut().for_each(|slave| slave.watched = false);
    plan
}

impl Rig {
    fn new(plan: CyclicPlan<NoDrivers, SLAVES>, encapsulation: Encapsulation) -> Self {
        let (exchange_end, mut end, _) = Box::leak(Box::new(BusQueues::<_, _, _, 0>::new())).split();
        assert!(end.plans.enqueue(plan).is_ok());
        let mut exchange = Exchange::new(exchange_end, MAC);
        exchange.set_encapsulation(encapsulation);
        let start = match encapsulation {
            Encapsulation::Raw => 16,
            Encapsulation::Udp(_) => 44,
            Encapsulation::Bare => 2,
        };
        Self { exchange, end, start }
    }

    fn input(&mut self) -> Vec<u8> {
        self.exchange.input_telegram().to_vec()
    }

    fn output(&mut self) -> Vec<u8> {
        self.exchange.output_telegram().to_vec()
    }

    /// Changes each datagram of a frame in place.
    fn each(&self, frame: &mut [u8], mut change: impl FnMut(usize, &mut Datagram<&mut [u8]>)) {
        let length = usize::from(read_u16(frame, self.start - 2) & 0x07FF);
        let payload = frame[self.start..self.start + length].to_vec();
        let mut chain = Datagrams::new(&payload);
        for number in 0.. {
            let Some(range) = chain.next_range() else { break };
            let range = range.unwrap();
            let bytes = &mut frame[self.start + range.start..self.start + range.end];
            change(number, &mut Datagram::new_checked(bytes).unwrap());
        }
    }

    /// The slaves' reply to a telegram: the inputs of slave 2 are 20, 21, 22 and so on.
    fn answered(&self, mut frame: Vec<u8>) -> Vec<u8> {
        self.each(&mut frame, |number, datagram| {
            let counter = match Command::from_number(datagram.command_number()).unwrap() {
                Command::Brd => {
                    datagram.data_mut().copy_from_slice(&[8, 0]);
                    datagram.set_address(Address::new(SLAVES as u16, 0x0130));
                    SLAVES as u16
                }
                Command::Frmw => {
                    let length = datagram.data().len();
                    datagram.data_mut().copy_from_slice(&TIME_NS.to_le_bytes()[..length]);
                    SLAVES as u16
                }
                command => {
                    let offset = if command == Command::Lrw { 11 } else { 0 };
                    if command.is_logical() && command.reads() {
                        let inputs = &mut datagram.data_mut()[offset..];
                        inputs
                            .iter_mut()
                            .zip(10 * number as u8..)
                            .for_each(|(byte, value)| *byte = value);
                    }
                    if command == Command::Lrw { 3 } else { 1 }
                }
            };
            datagram.set_working_counter(counter);
        });
        if self.start == 16 {
            frame[6] |= SOURCE_BIT;
        }
        frame
    }

    /// Whether all slaves' inputs arrived; they must be correct, and either all or none.
    fn valid(&self) -> bool {
        let valid: Vec<_> = (0..SLAVES).map(|slave| self.exchange.input(slave).is_some()).collect();
        assert!(valid.iter().all(|one| *one == valid[0]), "{valid:?}");
        let expected: Vec<u8> = (20..31).collect();
        assert!(!valid[2] || self.exchange.input(2) == Some(&expected));
        valid[0]
    }

    fn poll<T>(&mut self, lost: bool, future: core::pin::Pin<&mut impl Future<Output = T>>) -> Poll<T> {
        let frame = self.input();
        if !lost {
            let reply = self.answered(frame);
            self.exchange.receive(&reply);
        }
        future.poll(&mut Context::from_waker(Waker::noop()))
    }
}

#[test]
fn a_fault_of_a_frame_costs_one_cycle_in_every_kind_and_encapsulation() {
    type Change = fn(&Rig, &mut Vec<u8>);
    let faults: [(Ignored, Change); 4] = [
        (Ignored::ForeignIndex, |rig, frame| frame[rig.start + 1] ^= 0x80),
        (Ignored::Mismatch, |rig, frame| frame[rig.start + 2] ^= 1),
        (Ignored::Truncated, |_, frame| frame.truncate(70)),
        (Ignored::Circulating, |rig, frame| {
            rig.each(frame, |_, datagram| datagram.set_circulating(true));
        }),
    ];
    for (kind, encapsulation) in KINDS
        .into_iter()
        .flat_map(|kind| ENVELOPES.map(|encapsulation| (kind, encapsulation)))
    {
        let mut rig = Rig::new(plan(kind), encapsulation);
        let mut lost = 0;
        for (ignored, change) in faults {
            let mut reply = rig.input();
            reply = rig.answered(reply);
            change(&rig, &mut reply);
            assert_eq!(
                rig.exchange.receive(&reply),
                Arrival::Ignored(ignored),
                "{kind:?} {encapsulation:?}"
            );
            assert!(!rig.valid());
            lost += 1;

            let reply = rig.input();
            assert!(!rig.valid());
            let late = rig.answered(reply);
            lost += 1;
            let reply = rig.input();
            assert_eq!(rig.exchange.receive(&late), Arrival::Ignored(Ignored::Late));
            let reply = rig.answered(reply);
            assert_eq!(rig.exchange.receive(&reply), Arrival::Input);
            assert_eq!(rig.exchange.receive(&reply), Arrival::Ignored(Ignored::Duplicate));
            assert!(rig.valid());
            assert_eq!(rig.exchange.clock_ns(), Some(TIME_NS));
            let telegram = rig.output();
            assert_eq!(telegram.is_empty(), kind == ExchangeKind::Combined);
            if !telegram.is_empty() {
                let reply = rig.answered(telegram);
                assert_eq!(rig.exchange.receive(&reply), Arrival::Output);
            }
        }
        let counters = rig.exchange.counters();
        assert_eq!((counters.frames_lost, counters.frames_late), (lost, 4));
        assert_eq!(counters.working_counter_errors, 0);
    }
}

#[test]
fn combined_outputs_go_with_the_next_input_telegram_and_one_slaves_failure_is_its_own() {
    let mut rig = Rig::new(plan(ExchangeKind::Combined), Encapsulation::Raw);
    let telegram = rig.input();
    let mut reply = rig.answered(telegram);
    rig.each(&mut reply, |number, datagram| {
        if number == 1 {
            // The slave took its outputs but returned no inputs.
            datagram.set_working_counter(2);
        }
    });
    assert_eq!(rig.exchange.receive(&reply), Arrival::Input);
    assert_eq!(rig.exchange.input(1), None);
    assert_eq!(rig.exchange.input(2).map(|input| input[10]), Some(30));
    assert_eq!(rig.exchange.counters().working_counter_errors, 1);
    rig.exchange.output(3).copy_from_slice(b"new outputs");
    assert!(rig.output().is_empty());
    let mut telegram = rig.input();
    rig.each(&mut telegram, |number, datagram| {
        if number == 3 {
            assert_eq!(datagram.command_number(), Command::Lrw as u8);
            assert_eq!(
                (&datagram.data()[..11], datagram.data().len()),
                (&b"new outputs"[..], 22)
            );
        }
    });
}

#[test]
fn slaves_with_one_direction_count_once_and_answer_where_their_data_travel() {
    for kind in KINDS {
        let mut mixed = plan(kind);
        mixed.slaves[0].output_length = 0;
        mixed.slaves[1].input_length = 0;
        let mut rig = Rig::new(mixed, Encapsulation::Raw);
        let mut commands = vec![];
        let mut telegram = rig.input();
        rig.each(&mut telegram, |_, datagram| commands.push(datagram.command_number()));
        let expected: &[u8] = match kind {
            ExchangeKind::Split => &[10, 10, 10, 7, 14],
            ExchangeKind::Combined => &[10, 11, 12, 12, 7, 14],
        };
        assert_eq!(commands, expected);
        let reply = rig.answered(telegram);
        assert_eq!(rig.exchange.receive(&reply), Arrival::Input);
        let telegram = rig.output();
        if !telegram.is_empty() {
            let reply = rig.answered(telegram);
            assert_eq!(rig.exchange.receive(&reply), Arrival::Output);
        }
        assert!(rig.exchange.input(0).is_some() && rig.exchange.input(1).is_none());
        assert_eq!(rig.exchange.counters().working_counter_errors, 0);
        rig.input();
        assert_eq!(
            rig.end.observations.dequeue().map(|seen| seen.answered),
            Some(SlaveSet::from(0b1111))
        );
    }
}

#[test]
fn the_reference_clocks_time_is_read_spread_and_refused_unless_all_have_it() {
    for wide in [true, false] {
        let mut plan = plan(ExchangeKind::Split);
        plan.clock = plan.clock.map(|clock| ReferenceClock { wide, ..clock });
        let mut rig = Rig::new(plan, Encapsulation::Raw);
        let reply = rig.input();
        let reply = rig.answered(reply);
        rig.exchange.receive(&reply);
        let expected = if wide { TIME_NS } else { TIME_NS & 0xFFFF_FFFF };
        assert_eq!(rig.exchange.clock_ns(), Some(expected));
        let mut telegram = rig.input();
        assert_eq!(rig.exchange.clock_ns(), None, "a time is good for its cycle");
        let expected_ns = TIME_NS + 1_000_000;
        rig.each(&mut telegram, |number, datagram| {
            if number == SLAVES + 1 {
                // Without an answer of the reference the slaves get the time that is expected, not 0.
                assert_eq!(datagram.data(), &expected_ns.to_le_bytes()[..if wide { 8 } else { 4 }]);
                assert_eq!(datagram.address(), Address::station(0x1001, 0x0910));
            }
        });
        let mut reply = rig.answered(telegram);
        rig.each(&mut reply, |number, datagram| {
            if number == SLAVES + 1 {
                // Nobody has replaced what was sent.
                let length = datagram.data().len();
                datagram
                    .data_mut()
                    .copy_from_slice(&expected_ns.to_le_bytes()[..length]);
                datagram.set_working_counter(3);
            }
        });
        assert_eq!(rig.exchange.receive(&reply), Arrival::Input);
        assert_eq!(rig.exchange.clock_ns(), None);
        assert!(rig.valid());
    }
}

#[test]
fn one_message_shares_a_cycle_with_requests_for_registers_and_none_without_room_goes_unanswered() {
    let request = |length| Request::read(Command::Fprd, Address::station(0x1001, 0x1C00), length);
    let register = || Request::read(Command::Fprd, Address::station(0x1001, 0x0130), 6);
    for encapsulation in ENVELOPES {
        let mut rig = Rig::new(starting(ExchangeKind::Combined), encapsulation);
        let idle = rig.input().len();
        assert!(rig.end.port.messages.requests.enqueue(request(1024)).is_ok());
        assert!(rig.end.port.registers.requests.enqueue(register()).is_ok());
        assert!(rig.end.port.registers.requests.enqueue(register()).is_ok());
        let telegram = rig.input();
        assert_eq!(telegram.len(), idle + 1036 + 2 * 18, "{encapsulation:?}");
        assert!(telegram.len() <= FRAME_LEN_MAX);
        assert!(rig.end.port.messages.requests.enqueue(request(1024)).is_ok());
        let reply = rig.answered(telegram);
        assert_eq!(rig.exchange.receive(&reply), Arrival::Input);
        assert!(rig.valid());
        // The second request waits until there is room for its reply.
        assert_eq!(rig.input().len(), idle);
        let reply = rig.end.port.messages.replies.dequeue().unwrap();
        assert_eq!(
            (reply.data.len(), reply.outcome),
            (1024, Outcome::Processed { working_counter: 1 })
        );
        assert_eq!(rig.input().len(), idle + 1036);
        assert_eq!(rig.end.port.registers.replies.len(), 2);
    }
    let mut crowded = plan(ExchangeKind::Split);
    for slave in &mut crowded.slaves {
        (slave.input_length, slave.output_length) = (32, 32);
    }
    assert_eq!(crowded.check(MESSAGE), Ok(()));
    let (exchange_end, mut end, _) = Box::leak(Box::new(BusQueues::<NoDrivers, SLAVES, 1500>::new())).split();
    let mut exchange = Exchange::new(exchange_end, MAC);
    assert!(end.plans.enqueue(crowded).is_ok());
    let message = Request::read(Command::Fprd, Address::station(0x1001, 0x1C00), 1400);
    assert!(end.port.messages.requests.enqueue(message).is_ok());
    assert_eq!(exchange.input_telegram().len(), 16 + 4 * 44 + 14 + 20);
    let room = FRAME_LEN_MAX as u16 - (16 + 4 * 44 + 14 + 20 + 12);
    assert_eq!(
        end.port.messages.replies.dequeue().map(|reply| reply.outcome),
        Some(Outcome::NoRoom { room })
    );
}

#[test]
fn udp_answers_and_own_packets_count_and_others_do_not() {
    let mut rig = Rig::new(plan(ExchangeKind::Split), Encapsulation::Udp(UDP));
    let telegram = rig.input();
    assert_eq!(UdpRepr::parse(&telegram).map(|(repr, _)| repr), Ok(UDP));
    let reply = rig.answered(telegram);
    let length = reply.len() - 42;
    let answer = UdpRepr {
        source: UDP.destination,
        destination: UDP.source,
        ..UDP
    };
    let stranger = UdpRepr {
        source: UDP.destination,
        destination: Ipv4Addr::new(10, 0, 2, 16),
        ..UDP
    };
    for (repr, expected) in [
        (stranger, Arrival::Ignored(Ignored::ForeignSource)),
        (answer, Arrival::Input),
        (UDP, Arrival::Ignored(Ignored::Duplicate)),
    ] {
        let mut frame = reply.clone();
        repr.emit(&mut frame, length).unwrap();
        assert_eq!(rig.exchange.receive(&frame), expected);
    }
    let telegram = rig.input();
    assert_eq!(rig.exchange.receive(&telegram), Arrival::Ignored(Ignored::Reflection));
    let raw = Rig::new(plan(ExchangeKind::Split), Encapsulation::Raw).input();
    assert_eq!(rig.exchange.receive(&raw), Arrival::Ignored(Ignored::EtherType));
    let reply = rig.answered(telegram);
    assert_eq!(rig.exchange.receive(&reply), Arrival::Input);
    assert!(rig.valid());
}

#[test]
fn several_requests_share_a_frame_and_only_lost_ones_are_sent_again() {
    let mut rig = Rig::new(starting(ExchangeKind::Split), Encapsulation::Raw);
    // The port outlives the borrow of the rig.
    let (_, mut other, _) = Box::leak(Box::new(BusQueues::<_, _, _, 0>::new())).split();
    core::mem::swap(&mut rig.end, &mut other);
    let port = &mut other.port;
    let requests: Vec<Request> = (0..20)
        .map(|register| Request::read(Command::Fprd, Address::station(0x1001, register), 2))
        .collect();
    let mut answers = vec![0; 20];
    let mut cycles = 0;
    {
        let mut future = pin!(port.send_all_until_counted(&requests, 1, |number, _| answers[number] += 1));
        let result = loop {
            cycles += 1;
            if let Poll::Ready(result) = rig.poll(cycles == 3, future.as_mut()) {
                break result;
            }
        };
        assert_eq!(result, Ok(()));
    }
    assert_eq!(answers, vec![1; 20]);
    // Three frames; one is lost, which is known a cycle later, and a fourth repeats its datagrams.
    assert_eq!(cycles, 1 + 3 + 1 + 1);
    let mut future = pin!(port.send_all_until_counted(&requests[..3], 2, |_, _| ()));
    let result = loop {
        if let Poll::Ready(result) = rig.poll(false, future.as_mut()) {
            break result;
        }
    };
    assert_eq!(result, Err(BusError::WorkingCounter { expected: 2, actual: 1 }));
}

#[test]
fn a_request_that_nobody_waits_for_any_more_leaves_the_next_ones_reply_alone() {
    let mut rig = Rig::new(plan(ExchangeKind::Split), Encapsulation::Raw);
    let (_, mut other, _) = Box::leak(Box::new(BusQueues::<_, _, _, 0>::new())).split();
    core::mem::swap(&mut rig.end, &mut other);
    {
        let mut abandoned = pin!(other.port.broadcast_write(0x0120, &[1, 0, 0]));
        assert!(rig.poll(false, abandoned.as_mut()).is_pending());
    }
    let mut future = pin!(other.port.read(0x1001, 0x0130, 6));
    let bytes = loop {
        if let Poll::Ready(result) = rig.poll(false, future.as_mut()) {
            break result.unwrap();
        }
    };
    assert_eq!(bytes.len(), 6);
}
