//! What an exchange takes from a reply, for generated plans: inputs, answers, clock; and which changes it notices.

extern crate std;

use super::BusQueues;
use super::cyclic::{
    Arrival, CyclicPlan, CyclicSlave, Exchange, ExchangeKind, Ignored, PROCESS_BYTES_MAX, ReferenceClock,
};
use super::no_drivers::NoDrivers;
use super::random::Random;
use super::wire::{Datagram, Datagrams, FrameView, PAYLOAD_OFFSET, SOURCE_BIT};
use std::boxed::Box;
use std::vec::Vec;

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const SLAVES: usize = 6;
const PLANS: u32 = 400;
const SPACING: u32 = 0x100;

type Plan = CyclicPlan<NoDrivers, SLAVES>;

/// A plan with any lengths up to the longest and inputs before, behind or over the outputs.
fn plan(random: &mut Random) -> Plan {
    let mut length = || match random.next() % 4 {
        0 => 0,
        1 => 1 + (random.next() % 16) as u16,
        _ => (random.next() % (PROCESS_BYTES_MAX as u32 + 1)) as u16,
    };
    let lengths: [[u16; 2]; SLAVES] = core::array::from_fn(|_| [length(), length()]);
    let slaves = (0..).zip(lengths).map(|(number, [input_length, output_length])| {
        let start = 0x1_0000 + SPACING * number;
        let (input_address, output_address) = match random.next() % 3 {
            0 => (start, start + u32::from(input_length)),
            1 => (start + u32::from(output_length), start),
            _ => (start, start),
        };
        CyclicSlave {
            input_address,
            input_length,
            output_address,
            output_length,
            watched: true,
            ..CyclicSlave::default()
        }
    });
    let slaves = slaves.collect();
    let exchange = match random.next() % 2 {
        0 => ExchangeKind::Split,
        _ => ExchangeKind::Combined,
    };
    let clock = match random.next() % 3 {
        0 => None,
        kind => Some(ReferenceClock {
            station: 0x1001,
            slaves: 5,
            wide: kind == 1,
            is_spread: random.next().is_multiple_of(2),
            time_number: 0,
            period: ReferenceClock::period_of_ns(1_000_000),
        }),
    };
    CyclicPlan {
        slaves,
        exchange,
        clock,
        ..CyclicPlan::default()
    }
}

/// Places of the datagrams in a frame.
fn places(frame: &[u8]) -> Vec<core::ops::Range<usize>> {
    let payload = FrameView::new_checked(frame).unwrap().payload();
    let mut chain = Datagrams::new(payload);
    core::iter::from_fn(|| chain.next_range())
        .map(|range| range.unwrap())
        .map(|range| PAYLOAD_OFFSET + range.start..PAYLOAD_OFFSET + range.end)
        .collect()
}

/// The reply of slaves in OP with random data. Returns what each logical address was given.
fn answered(frame: &mut [u8], random: &mut Random) -> Vec<(u32, Vec<u8>)> {
    let mut given = Vec::new();
    for place in places(frame) {
        let mut datagram = Datagram::new_checked(&mut frame[place]).unwrap();
        let command = datagram.command_number();
        if command != 11 {
            datagram
                .data_mut()
                .iter_mut()
                .for_each(|byte| *byte = random.next() as u8);
        }
        datagram.set_working_counter(match command {
            7 => SLAVES as u16,
            4 | 14 => 5,
            12 => 3,
            _ => 1,
        });
        if matches!(command, 10 | 12) {
            given.push((datagram.address().0, datagram.data().to_vec()));
        }
    }
    frame[6] |= SOURCE_BIT;
    given
}

fn inputs<'g>(given: &'g [(u32, Vec<u8>)], slave: &CyclicSlave<NoDrivers>) -> Option<&'g [u8]> {
    let (start, end) = (slave.input_address, slave.input_address + u32::from(slave.input_length));
    given.iter().filter(|_| slave.input_length > 0).find_map(|(at, data)| {
        let offset = start.checked_sub(*at)? as usize;
        data.get(offset..offset + (end - start) as usize)
    })
}

#[test]
fn every_slaves_inputs_are_those_of_the_reply_whatever_their_lengths_and_order() {
    let seed = 23;
    let mut random = Random::new(seed);
    for number in 0..PLANS {
        let plan = plan(&mut random);
        let (end, mut supervisor, _) = Box::leak(Box::new(BusQueues::<NoDrivers, SLAVES, 64>::new())).split();
        assert!(supervisor.plans.enqueue(plan.clone()).is_ok());
        let mut exchange = Exchange::new(end, MAC);
        for _ in 0..2 {
            let mut reply = exchange.input_telegram().to_vec();
            let given = answered(&mut reply, &mut random);
            assert_eq!(exchange.receive(&reply), Arrival::Input, "seed {seed}, plan {number}");
            for (place, slave) in plan.slaves.iter().enumerate() {
                let context = std::format!("seed {seed}, plan {number}, slave {place}: {slave:?}");
                assert_eq!(exchange.input(place), inputs(&given, slave), "{context}");
            }
            assert_eq!(exchange.clock_ns().is_some(), plan.clock.is_some());
        }
        assert_eq!(exchange.counters().working_counter_errors, 0);
    }
}

/// What becomes of a frame with the reference's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Answered,
    /// The others answer, the reference does not.
    Silent,
    Lost,
    /// The reference does not answer, and the next frame is that of a new plan.
    NewPlan,
}

#[test]
fn the_time_of_a_reference_that_does_not_answer_goes_on_by_the_cycles_whatever_else_happens() {
    let mut random = Random::new(31);
    let mut seen = 0;
    for number in 0..PLANS {
        let mut plan = plan(&mut random);
        let Some(clock) = plan.clock.as_mut() else { continue };
        let period_ns = [250_000, 1_000_000, 10_000_000][number as usize % 3];
        (clock.is_spread, clock.period) = (true, ReferenceClock::period_of_ns(period_ns));
        let length = if clock.wide { 8 } else { 4 };
        let mask = u64::MAX >> (64 - 8 * length);
        let (end, mut supervisor, _) = Box::leak(Box::new(BusQueues::<NoDrivers, SLAVES, 64>::new())).split();
        assert!(supervisor.plans.enqueue(plan.clone()).is_ok());
        let mut exchange = Exchange::new(end, MAC);
        let begun_ns = u64::from(random.next()) << 20 | u64::from(random.next());
        let fates = [Fate::Answered, Fate::Silent, Fate::Lost, Fate::NewPlan];
        // The first answer tells the time.
        let later = (0..12).map(|_| fates[random.next() as usize % 4]);
        let fates: Vec<Fate> = core::iter::once(Fate::Answered).chain(later).collect();
        for (cycle, fate) in fates.iter().enumerate() {
            let sent = exchange.input_telegram().to_vec();
            let clock = places(&sent).last().expect("the clock's datagram").clone();
            let data = clock.end - 2 - length..clock.end - 2;
            let mut carried = [0; 8];
            carried[..length].copy_from_slice(&sent[data.clone()]);
            let now_ns = begun_ns.wrapping_add(u64::from(period_ns) * cycle as u64);
            if cycle > 0 {
                let expected_ns = now_ns & mask;
                assert_eq!(
                    u64::from_le_bytes(carried),
                    expected_ns,
                    "plan {number}, {fates:?}, {cycle}"
                );
            }
            if *fate == Fate::NewPlan {
                assert!(supervisor.plans.enqueue(plan.clone()).is_ok());
            }
            if *fate != Fate::Lost {
                let answers = *fate == Fate::Answered;
                let mut reply = sent.clone();
                answered(&mut reply, &mut random);
                let time_ns = if answers { now_ns.to_le_bytes() } else { carried };
                reply[data].copy_from_slice(&time_ns[..length]);
                // The others have been written what was sent.
                reply[clock.end - 2] = if answers { 5 } else { 4 };
                assert_eq!(exchange.receive(&reply), Arrival::Input, "plan {number}");
                assert_eq!(exchange.clock_ns().is_some(), answers, "plan {number}");
            }
            seen += 1;
        }
    }
    assert!(seen > 1_000, "{seen}");
}

#[test]
fn a_changed_bit_of_any_header_is_noticed_and_one_wrong_counter_costs_one_slaves_inputs() {
    let seed = 29;
    let mut random = Random::new(seed);
    for number in 0..PLANS / 8 {
        let plan = plan(&mut random);
        let (end, mut supervisor, _) = Box::leak(Box::new(BusQueues::<NoDrivers, SLAVES, 64>::new())).split();
        assert!(supervisor.plans.enqueue(plan.clone()).is_ok());
        let mut exchange = Exchange::new(end, MAC);
        let mut reply = exchange.input_telegram().to_vec();
        let given = answered(&mut reply, &mut random);
        let places = places(&reply);
        for (datagram, place) in places.iter().enumerate() {
            // The interrupt field behind the first eight bytes and the position of a broadcast are the slaves' own.
            let is_broadcast = reply[place.start] == 7;
            let bits = (0..64).filter(|bit| !(is_broadcast && (16..32).contains(bit)));
            for bit in bits {
                let mut changed = reply.clone();
                changed[place.start + bit / 8] ^= 1 << (bit % 8);
                let arrival = exchange.receive(&changed);
                let context = std::format!("seed {seed}, plan {number}, datagram {datagram}, bit {bit}");
                assert!(matches!(arrival, Arrival::Ignored(_)), "{context}: {arrival:?}");
                assert!((0..SLAVES).all(|slave| exchange.input(slave).is_none()), "{context}");
            }
        }
        // The first datagram of a slave with inputs comes back unprocessed.
        let slave = plan.slaves.iter().position(|slave| inputs(&given, slave).is_some());
        let address = slave.map(|slave| plan.slaves[slave].input_address);
        for place in places {
            let mut datagram = Datagram::new_checked(&mut reply[place]).unwrap();
            let covered = datagram.address().0..datagram.address().0 + datagram.data().len() as u32;
            if matches!(datagram.command_number(), 10 | 12) && address.is_some_and(|at| covered.contains(&at)) {
                datagram.set_working_counter(datagram.working_counter() - 1);
            }
        }
        assert_eq!(exchange.receive(&reply), Arrival::Input);
        for (place, planned) in plan.slaves.iter().enumerate() {
            let expected = inputs(&given, planned).filter(|_| Some(place) != slave);
            assert_eq!(
                exchange.input(place),
                expected,
                "seed {seed}, plan {number}, slave {place}"
            );
        }
        assert_eq!(exchange.counters().working_counter_errors, u32::from(slave.is_some()));
        assert_eq!(exchange.receive(&reply), Arrival::Ignored(Ignored::Duplicate));
    }
}
