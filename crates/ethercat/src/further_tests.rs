//! Process data that need several frames, against a model of the slaves that reads the wire: generated plans and faults.

extern crate std;

use super::BusQueues;
use super::acyclic::{Outcome, Request};
use super::cyclic::{
    Arrival, CyclicPlan, CyclicSlave, Exchange, ExchangeKind, FrameCounters, Ignored, PROCESS_BYTES_MAX,
    ReferenceClock, Turn,
};
use super::driver::Role;
use super::no_drivers::NoDrivers;
use super::random::Random;
use super::slave_set::SlaveSet;
use super::supervisor::SupervisorEnd;
use super::wire::{Address, Command, Datagram, Datagrams, FRAME_LEN_MAX, FrameView, PAYLOAD_OFFSET, SOURCE_BIT};
use std::boxed::Box;
use std::vec::Vec;

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const SLAVES: usize = 64;
const MESSAGE: usize = 1024;
const FURTHER: usize = 4;
const SPACING: u32 = 64;
const START: u32 = 0x1_0000;
const TIME_NS: u64 = 0x0123_4567_89AB_CDEF;
/// Most bytes of datagrams in an Ethernet frame.
const DATAGRAMS_MAX: usize = 1_486;

type Plan = CyclicPlan<NoDrivers, SLAVES>;
type TestExchange = Exchange<'static, NoDrivers, SLAVES, MESSAGE, FURTHER>;
type TestEnd = SupervisorEnd<'static, NoDrivers, SLAVES, MESSAGE>;

/// What happens to a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Well,
    /// The slaves do not see it.
    RequestLost,
    /// The slaves process it, and the master does not see the reply.
    ReplyLost,
    /// The reply comes in the next cycle.
    Late,
    /// The reply comes twice.
    Twice,
}

/// The slaves: what they would give, what they were given, and which of them do not answer.
struct Model {
    plan: Plan,
    inputs: Vec<[u8; PROCESS_BYTES_MAX]>,
    outputs: Vec<[u8; PROCESS_BYTES_MAX]>,
    dead: SlaveSet,
}

/// What a frame did, seen from the wire.
struct Passed {
    reply: Vec<u8>,
    read: SlaveSet,
    written: SlaveSet,
    has_status: bool,
}

impl Model {
    fn new(plan: Plan) -> Self {
        Self {
            plan,
            inputs: std::vec![[0; PROCESS_BYTES_MAX]; SLAVES],
            outputs: std::vec![[0; PROCESS_BYTES_MAX]; SLAVES],
            dead: SlaveSet::NONE,
        }
    }

    /// Processes a telegram as slaves with one FMMU for each direction do.
    fn pass(&mut self, telegram: &[u8]) -> Passed {
        let mut reply = telegram.to_vec();
        let mut passed = Passed {
            reply: Vec::new(),
            read: SlaveSet::NONE,
            written: SlaveSet::NONE,
            has_status: false,
        };
        assert!(telegram.len() <= FRAME_LEN_MAX);
        let view = FrameView::new_checked(telegram).expect("a frame");
        let payload = view.payload().to_vec();
        assert!(payload.len() <= DATAGRAMS_MAX && !payload.is_empty());
        let mut chain = Datagrams::new(&payload);
        while let Some(range) = chain.next_range() {
            let range = range.expect("a datagram");
            let bytes = &mut reply[PAYLOAD_OFFSET + range.start..PAYLOAD_OFFSET + range.end];
            let mut datagram = Datagram::new_checked(bytes).expect("a datagram");
            match Command::from_number(datagram.command_number()).expect("a command") {
                Command::Brd => {
                    passed.has_status = true;
                    let there = self.plan.slaves.len() as u16 - self.dead.count() as u16;
                    datagram.data_mut().copy_from_slice(&[8, 0]);
                    datagram.set_address(Address::new(self.plan.slaves.len() as u16, 0x0130));
                    datagram.set_working_counter(there);
                }
                Command::Frmw => {
                    datagram.data_mut().copy_from_slice(&TIME_NS.to_le_bytes());
                    datagram.set_working_counter(3);
                }
                Command::Fprd => datagram.set_working_counter(1),
                command => self.move_data(command, &mut datagram, &mut passed),
            }
        }
        reply[6] |= SOURCE_BIT;
        passed.reply = reply;
        passed
    }

    fn move_data(&mut self, command: Command, datagram: &mut Datagram<&mut [u8]>, passed: &mut Passed) {
        let start = datagram.address().0;
        let mut counter = 0;
        for (place, slave) in self.plan.slaves.iter().enumerate() {
            if self.dead.contains(place) {
                continue;
            }
            let within = |address: u32, length: u16, data: &[u8]| {
                let at = address.checked_sub(start)? as usize;
                (length > 0 && at + usize::from(length) <= data.len()).then_some(at..at + usize::from(length))
            };
            if matches!(command, Command::Lwr | Command::Lrw)
                && let Some(range) = within(slave.output_address, slave.output_length, datagram.data())
            {
                self.outputs[place][..range.len()].copy_from_slice(&datagram.data()[range]);
                counter += if command == Command::Lrw { 2 } else { 1 };
                passed.written |= SlaveSet::of(place);
            }
            if matches!(command, Command::Lrd | Command::Lrw)
                && let Some(range) = within(slave.input_address, slave.input_length, datagram.data())
            {
                let inputs = self.inputs[place];
                datagram.data_mut()[range.clone()].copy_from_slice(&inputs[..range.len()]);
                counter += 1;
                passed.read |= SlaveSet::of(place);
            }
        }
        datagram.set_working_counter(counter);
    }
}

/// A plan of `slaves` slaves of up to `longest` bytes each way; with a `clock` or without.
fn plan(random: &mut Random, slaves: usize, longest: u32, exchange: ExchangeKind, clock: bool) -> Plan {
    let slaves = (0..slaves).map(|number| {
        let [input_length, output_length] = [0; 2].map(|_: u16| match random.next() % 5 {
            0 => 0,
            _ => (random.next() % (longest + 1)) as u16,
        });
        let start = START + SPACING * number as u32;
        CyclicSlave {
            input_address: start,
            input_length,
            output_address: start + u32::from(input_length),
            output_length,
            watched: true,
            role: random.next().is_multiple_of(2).then_some(Role {
                member: number as u8,
                device: (),
                layout: (),
            }),
            ..CyclicSlave::default()
        }
    });
    let slaves = slaves.collect();
    CyclicPlan {
        slaves,
        exchange,
        message: (random.next() % (MESSAGE as u32 + 1)) as u16,
        clock: clock.then_some(ReferenceClock {
            station: 0x1001,
            slaves: 3,
            wide: true,
            is_spread: true,
            time_number: 0,
            period: ReferenceClock::period_of_ns(1_000_000),
        }),
        ..CyclicPlan::default()
    }
}

struct Bench {
    exchange: TestExchange,
    end: TestEnd,
    model: Model,
    /// Replies of the last cycle that come late, with the number of their frame and the direction.
    late: Vec<(Vec<u8>, usize, usize)>,
    /// Lost and late frames of each direction, by their numbers in it.
    counted: [[FrameCounters; 2]; FURTHER + 1],
}

impl Bench {
    fn new(plan: Plan) -> Self {
        let queues = BusQueues::<NoDrivers, SLAVES, MESSAGE, FURTHER>::new();
        let (exchange_end, end, _) = Box::leak(Box::new(queues)).split();
        assert_eq!(usize::from(end.frames), FURTHER + 1);
        let mut bench = Self {
            exchange: Exchange::new(exchange_end, MAC),
            end,
            model: Model::new(Plan::default()),
            late: Vec::new(),
            counted: Default::default(),
        };
        bench.adopt(plan);
        bench
    }

    /// Puts a plan in force, which takes a cycle.
    fn adopt(&mut self, plan: Plan) {
        assert_eq!(plan.check(FURTHER + 1), Ok(()), "{plan:?}");
        assert!(self.end.plans.enqueue(plan.clone()).is_ok());
        self.model.plan = plan;
        for telegram in self.telegrams(0) {
            let passed = self.model.pass(&telegram);
            self.exchange.receive(&passed.reply);
        }
    }

    fn telegrams(&mut self, direction: usize) -> Vec<Vec<u8>> {
        let mut telegrams = Vec::new();
        let mut telegram = match direction {
            0 => self.exchange.input_telegram().to_vec(),
            _ => self.exchange.output_telegram().to_vec(),
        };
        while !telegram.is_empty() {
            telegrams.push(telegram);
            telegram = match direction {
                0 => self.exchange.next_input_telegram().to_vec(),
                _ => self.exchange.next_output_telegram().to_vec(),
            };
        }
        telegrams
    }

    /// Exchanges one direction. Returns the telegrams whose replies have come, in the order in which they were sent.
    fn pass(&mut self, random: &mut Random, direction: usize, faults: u32) -> Vec<Option<Passed>> {
        let telegrams = self.telegrams(direction);
        let mut come: Vec<Option<Passed>> = Vec::new();
        // Late replies of the cycle before come first.
        let late = if direction == 0 {
            core::mem::take(&mut self.late)
        } else {
            Vec::new()
        };
        for (number, telegram) in telegrams.iter().enumerate() {
            let fate = match random.next() % 100 < faults {
                false => Fate::Well,
                true => [Fate::RequestLost, Fate::ReplyLost, Fate::Late, Fate::Twice][random.next() as usize % 4],
            };
            if fate == Fate::RequestLost {
                come.push(None);
                self.counted[number][direction].lost += 1;
                continue;
            }
            let passed = self.model.pass(telegram);
            if matches!(fate, Fate::ReplyLost | Fate::Late) {
                self.counted[number][direction].lost += 1;
            }
            if fate == Fate::Late {
                self.late.push((passed.reply.clone(), number, direction));
            }
            come.push(matches!(fate, Fate::Well | Fate::Twice).then_some(passed));
        }
        for (reply, number, of) in late {
            assert_eq!(self.exchange.receive(&reply), Arrival::Ignored(Ignored::Late));
            self.counted[number][of].late += 1;
        }
        let mut order: Vec<&Passed> = come.iter().flatten().collect();
        for at in (1..order.len()).rev() {
            order.swap(at, random.next() as usize % (at + 1));
        }
        let expected = [Arrival::Input, Arrival::Output][direction];
        for passed in order {
            assert_eq!(self.exchange.receive(&passed.reply), expected);
            let again = self.exchange.receive(&passed.reply);
            assert_eq!(again, Arrival::Ignored(Ignored::Duplicate));
        }
        // What is missing in one direction is not awaited in the other.
        let is_missing = come.iter().any(Option::is_none);
        let turn = [Turn::First, Turn::Second][direction];
        assert_eq!(self.exchange.awaits_replies(turn), is_missing);
        come
    }

    /// One cycle with this many faults among 100 frames, checked against what has passed on the wire.
    fn cycle(&mut self, random: &mut Random, faults: u32) {
        let places = 0..self.model.plan.slaves.len();
        let kind = self.model.plan.exchange;
        let lost = self.sum(|frame| frame.lost);
        let mut set = self.model.outputs.clone();
        for place in places.clone() {
            self.model.inputs[place].fill_with(|| random.next() as u8);
            set[place].fill_with(|| random.next() as u8);
        }
        let write = |exchange: &mut TestExchange| {
            for place in places.clone() {
                let output = exchange.output(place);
                let length = output.len();
                output.copy_from_slice(&set[place][..length]);
            }
        };
        let before = self.model.outputs.clone();
        if kind == ExchangeKind::Combined {
            write(&mut self.exchange);
        }
        let come = self.pass(random, 0, faults);
        let union = |of: fn(&Passed) -> SlaveSet, come: &[Option<Passed>]| {
            come.iter()
                .flatten()
                .fold(SlaveSet::NONE, |set, passed| set | of(passed))
        };
        let read = union(|passed| passed.read, &come);
        let mut written = union(|passed| passed.written, &come);
        let first = read | written;
        let status = come.iter().flatten().any(|passed| passed.has_status);
        assert_eq!(self.exchange.al_status().is_some(), status);
        let clock = self.model.plan.clock.filter(|_| status).map(|_| TIME_NS);
        assert_eq!(self.exchange.clock_ns(), clock);
        for place in places.clone() {
            let length = usize::from(self.model.plan.slaves[place].input_length);
            let expected = read.contains(place).then(|| &self.model.inputs[place][..length]);
            assert_eq!(self.exchange.input(place), expected, "slave {place}");
            let image = self.exchange.image_at(self.exchange.input_place(place));
            assert_eq!(image.map(|image| &image[..length]), expected, "slave {place}");
        }
        if kind == ExchangeKind::Split {
            write(&mut self.exchange);
            let come = self.pass(random, 1, faults);
            written = union(|passed| passed.written, &come);
            self.check_unconfirmed(written);
        } else {
            assert!(self.exchange.unconfirmed().is_empty());
        }
        for (place, slave) in self.model.plan.slaves.iter().enumerate() {
            let is_first = slave.input_length > 0 || kind == ExchangeKind::Combined;
            let answered = if is_first { first } else { written };
            assert_eq!(
                self.exchange.has_answered(place),
                answered.contains(place),
                "slave {place}"
            );
        }
        // What has come back was written; what else was written is what was set, and nothing else has changed.
        for place in places {
            let length = usize::from(self.model.plan.slaves[place].output_length);
            let (now, set) = (&self.model.outputs[place][..length], &set[place][..length]);
            assert!(
                now == set || !written.contains(place) && now == &before[place][..length],
                "slave {place}"
            );
        }
        // What is missing in this cycle is lost only when the next one begins.
        let counters = self.exchange.counters();
        assert_eq!(counters.frames_lost, lost);
        assert_eq!(counters.frames_late, self.sum(|frame| frame.late));
    }

    fn check_unconfirmed(&self, written: SlaveSet) {
        let members = self.model.plan.slaves.iter().enumerate();
        let expected: SlaveSet = members
            .filter(|(place, slave)| slave.role.is_some() && slave.output_length > 0 && !written.contains(*place))
            .map(|(place, _)| place)
            .collect();
        assert_eq!(self.exchange.unconfirmed(), expected);
    }

    fn sum(&self, of: fn(&FrameCounters) -> u32) -> u32 {
        self.counted.as_flattened().iter().map(of).sum()
    }

    /// The slaves that have answered, as last told to the slow side.
    fn observed(&mut self) -> Option<SlaveSet> {
        let told = core::iter::from_fn(|| self.end.observations.dequeue());
        told.last().map(|seen| seen.answered)
    }

    fn check_frames(&mut self) {
        // A cycle settles the one before.
        let _ = self.exchange.input_telegram();
        for (number, expected) in self.counted.iter().enumerate() {
            assert_eq!(self.exchange.frame_counters(number), Some(*expected), "frame {number}");
        }
        assert_eq!(self.exchange.frame_counters(self.counted.len()), None);
    }
}

#[test]
fn each_frame_is_lost_late_or_doubled_for_itself_whatever_the_plan() {
    let (mut several, mut bytes_most) = (0, 0);
    for seed in 1..=60 {
        let mut random = Random::new(seed);
        let slaves = 1 + random.next() as usize % SLAVES;
        let longest = [1, 8, 32][random.next() as usize % 3];
        let kind = [ExchangeKind::Split, ExchangeKind::Combined][random.next() as usize % 2];
        let clock = random.next().is_multiple_of(2);
        let plan = plan(&mut random, slaves, longest, kind, clock);
        let bytes = plan.slaves.iter().map(|slave| slave.input_length + slave.output_length);
        bytes_most = bytes_most.max(bytes.sum());
        let mut bench = Bench::new(plan);
        let mut observed = None;
        for cycle in 0..120 {
            // Faults in the first two thirds of the cycles; then all is well again.
            let faults = if cycle < 80 { 20 } else { 0 };
            if cycle < 80 && random.next().is_multiple_of(8) {
                bench.model.dead = SlaveSet::of(random.next() as usize % slaves);
            } else if cycle >= 80 {
                bench.model.dead = SlaveSet::NONE;
            }
            bench.cycle(&mut random, faults);
            observed = bench.observed().or(observed);
        }
        several += u32::from(bench.telegrams(0).len() > 1);
        observed = bench.observed().or(observed);
        let all: SlaveSet = bench
            .model
            .plan
            .slaves
            .iter()
            .enumerate()
            .filter(|(_, slave)| slave.input_length + slave.output_length > 0)
            .map(|(place, _)| place)
            .collect();
        assert_eq!(observed, Some(all), "seed {seed}");
    }
    assert!(several > 15, "{several} plans needed several frames");
    assert!(bytes_most > 1_500, "{bytes_most} bytes at most");
}

#[test]
fn after_a_new_plan_nobody_waits_for_slaves_of_the_one_before() {
    for seed in 1..=30 {
        let mut random = Random::new(seed);
        let mut bench = Bench::new(Plan::default());
        for _ in 0..6 {
            // Few or many slaves: those of the further frames come, go, and take other parts.
            let slaves = 1 + random.next() as usize % SLAVES;
            let kind = [ExchangeKind::Split, ExchangeKind::Combined][(random.next() % 4 / 3) as usize];
            let plan = plan(&mut random, slaves, 32, kind, false);
            bench.adopt(plan);
            for cycle in 0..10 {
                // No reply of one plan comes under the next.
                bench.cycle(&mut random, if cycle < 9 { 20 } else { 0 });
            }
        }
    }
}

#[test]
fn outputs_that_only_further_frames_carry_are_sent_and_written() {
    for outputs in [1, 40] {
        let mut random = Random::new(5);
        let mut few = plan(&mut random, SLAVES, 1, ExchangeKind::Split, false);
        for (place, slave) in few.slaves.iter_mut().enumerate() {
            (slave.input_length, slave.output_length) = if place < 32 { (1, 0) } else { (0, outputs.min(32)) };
            slave.output_address = START + SPACING * place as u32;
        }
        few.slaves.truncate(32 + usize::from(outputs));
        let mut bench = Bench::new(few);
        for cycle in 0..60 {
            bench.cycle(&mut random, if cycle < 40 { 20 } else { 0 });
        }
    }
}

#[test]
fn lost_and_late_frames_are_counted_for_the_frame_and_a_request_rides_in_the_first() {
    for kind in [ExchangeKind::Split, ExchangeKind::Combined] {
        let mut random = Random::new(77);
        let mut full = plan(&mut random, SLAVES, 32, kind, true);
        for (number, slave) in full.slaves.iter_mut().enumerate() {
            (slave.input_length, slave.output_length) = (32, 32);
            slave.output_address = START + SPACING * number as u32 + 32;
        }
        full.message = MESSAGE as u16;
        let mut bench = Bench::new(full);
        for cycle in 0..200 {
            if cycle % 7 == 0 {
                let request = Request::read(Command::Fprd, Address::station(0x1001, 0x0130), 64);
                assert!(bench.end.port.registers.requests.enqueue(request).is_ok());
            }
            if cycle % 11 == 0 {
                let message = Request::read(Command::Fprd, Address::station(0x1001, 0x1000), MESSAGE);
                assert!(bench.end.port.messages.requests.enqueue(message).is_ok());
            }
            bench.cycle(&mut random, 15);
            bench.cycle(&mut random, 15);
            let registers = core::iter::from_fn(|| bench.end.port.registers.replies.dequeue());
            for reply in registers {
                assert!(matches!(
                    reply.outcome,
                    Outcome::Processed { working_counter: 1 } | Outcome::Lost
                ));
            }
            while let Some(reply) = bench.end.port.messages.replies.dequeue() {
                let outcomes = [Outcome::Processed { working_counter: 1 }, Outcome::Lost];
                assert!(outcomes.contains(&reply.outcome), "{:?}", reply.outcome);
            }
        }
        bench.check_frames();
        let (firsts, seconds) = match kind {
            ExchangeKind::Combined => (5, 0),
            ExchangeKind::Split => (3, 2),
        };
        for (number, [first, second]) in bench.counted.iter().enumerate() {
            assert_eq!(
                first.lost > 0 && first.late > 0,
                number < firsts,
                "{kind:?} {number}: {first:?}"
            );
            assert_eq!(
                second.lost > 0 && second.late > 0,
                number < seconds,
                "{kind:?} {number}: {second:?}"
            );
        }
    }
}
