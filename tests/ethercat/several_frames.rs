//! Up to 64 slaves, whose process data take several frames a cycle: what arrives at the slaves and what comes back.

use crate::bench::{self, Fate, Which};
use crate::device_images::terminal_of_bytes;
use etherpen::ethercat::cyclic::{CyclicSlave, ExchangeKind, FrameCounters};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::event::{BusCommand, BusSetup};
use etherpen::ethercat::no_drivers::NoDrivers;
use etherpen::ethercat::process_data::LOGICAL_START;
use etherpen::ethercat::slave_set::SlaveSet;
use etherpen::ethercat::supervisor::{BusEvent, Step};
use etherpen::ethercat::wire::{Command, FrameView};
use etherpen_segment::random::Random;
use etherpen_segment::{Branch, ClockOptions, Fault, SegmentOptions, SlaveKind};

/// What the host's master has: 64 slaves, and four frames behind the first one in each direction.
type Bench = bench::Bench<64, 4>;

/// Longest Ethernet frame without its check sequence, bytes.
const FRAME_BYTES_MAX: usize = 1_514;
/// Logical memory of a slave, bytes.
const SPAN: u32 = 64;

/// A generated chain.
struct Case {
    cycle_us: u32,
    kind: ExchangeKind,
    clocks: bool,
    /// Bytes of outputs and inputs of each slave.
    lengths: Vec<(u16, u16)>,
}

impl Case {
    /// The longest chain with all process data that slaves may have for every fourth seed: 4 KiB with 64 slaves.
    fn new(seed: u64, random: &mut Random) -> Self {
        let cycle_us = [1_000, 250, 10_000][(seed % 3) as usize];
        let mut below = |limit: u64| (random.bits() % limit) as u16;
        let longest: u64 = [32, 32, 8, 2][(seed / 3 % 4) as usize];
        // Each acyclic frame of a bring-up takes a cycle.
        let most = if cycle_us > 1_000 { 40 } else { 64 };
        let slaves = if seed.is_multiple_of(4) {
            most as u16
        } else {
            2 + below(most - 1)
        };
        let lengths = (0..slaves).map(|_| match seed.is_multiple_of(4) {
            true => (32, 32),
            false => (below(longest + 1), below(longest + 1)),
        });
        let lengths = lengths.collect();
        Self {
            cycle_us,
            kind: [ExchangeKind::Split, ExchangeKind::Combined][usize::from(below(2))],
            clocks: (seed / 2).is_multiple_of(2),
            lengths,
        }
    }

    fn start(&self, seed: u64) -> Bench {
        let terminal = |&(outputs, inputs): &(u16, u16)| match (outputs, inputs) {
            (0, 0) => SlaveKind::Ek1100,
            _ => SlaveKind::Sii(terminal_of_bytes(outputs, inputs, self.clocks).into()),
        };
        let options = SegmentOptions {
            slaves: self.lengths.iter().map(terminal).collect(),
            seed,
            ..SegmentOptions::default()
        };
        let setup = BusSetup {
            terminals: SlaveSet::ALL,
            exchange: self.kind,
            cycle_ns: self.cycle_us * 1_000,
            watchdog_ms: 500,
            clocks: self.clocks,
            ..BusSetup::default()
        };
        Bench::start(&options, setup)
    }
}

/// The slaves whose data the telegrams carry, read from their bytes: for each telegram those whose inputs it reads, and
/// those whose outputs it writes.
fn carried(telegrams: &[Vec<u8>], plan: &[CyclicSlave<NoDrivers>]) -> Vec<[SlaveSet; 2]> {
    let of = |telegram: &Vec<u8>| {
        assert!(telegram.len() <= FRAME_BYTES_MAX, "{} bytes", telegram.len());
        let mut sets = [SlaveSet::NONE; 2];
        for datagram in FrameView::new_checked(telegram).expect("a frame").datagrams() {
            let datagram = datagram.expect("a datagram");
            let command = Command::from_number(datagram.command_number()).expect("a command");
            let place = (datagram.address().0.wrapping_sub(LOGICAL_START) / SPAN) as usize;
            if matches!(command, Command::Lrd | Command::Lrw) && plan[place].input_length > 0 {
                sets[0] |= SlaveSet::of(place);
            }
            if matches!(command, Command::Lwr | Command::Lrw) && plan[place].output_length > 0 {
                sets[1] |= SlaveSet::of(place);
            }
        }
        sets
    };
    telegrams.iter().map(of).collect()
}

/// A chain in operation, and what its slaves were last given.
struct Running {
    bench: Bench,
    lengths: Vec<(u16, u16)>,
    acting: Vec<Vec<u8>>,
    /// Lost and late frames of the cycle's start and after control, by their numbers.
    counted: [[FrameCounters; 2]; 5],
}

impl Running {
    /// One cycle with new values everywhere and these fates of single frames.
    fn cycle(&mut self, random: &mut Random, fates: &[(Which, Fate)]) {
        let mut bytes = |length: u16| -> Vec<u8> { (0..length).map(|_| random.bits() as u8).collect() };
        let values: Vec<(Vec<u8>, Vec<u8>)> = self
            .lengths
            .iter()
            .map(|&(outputs, inputs)| (bytes(outputs), bytes(inputs)))
            .collect();
        for (place, (outputs, inputs)) in values.iter().enumerate() {
            self.bench.segment.set_inputs(place + 1, inputs);
            self.bench.exchange.output(place).copy_from_slice(outputs);
        }
        self.bench.fates = fates.to_vec();
        self.bench.cycle();
        let fate = |which: Which| fates.iter().find(|(of, _)| *of == which).map(|(_, fate)| *fate);
        let plan = self.bench.exchange.plan().slaves.clone();
        let (mut read, mut written, mut seen) = ([SlaveSet::NONE; 2], [SlaveSet::NONE; 2], true);
        for (turn, telegrams) in self.bench.sent.iter().enumerate() {
            for (number, sets) in carried(telegrams, &plan).into_iter().enumerate() {
                let fate = fate((number, turn == 1));
                // All data travel, each once.
                assert!(read[0].and(sets[0]).is_empty() && written[0].and(sets[1]).is_empty());
                (read[0], written[0]) = (read[0] | sets[0], written[0] | sets[1]);
                read[1] |= if fate.is_none() { sets[0] } else { SlaveSet::NONE };
                written[1] |= if fate == Some(Fate::RequestLost) {
                    SlaveSet::NONE
                } else {
                    sets[1]
                };
                seen &= fate.is_none() || (number, turn) != (0, 0);
                self.counted[number][turn].lost += u32::from(fate.is_some());
                self.counted[number][turn].late += u32::from(fate == Some(Fate::Late));
            }
        }
        for (place, (outputs, inputs)) in values.into_iter().enumerate() {
            let expected = read[1].contains(place).then_some(inputs.as_slice());
            assert!(
                inputs.is_empty() || read[0].contains(place),
                "slave {place} is not read"
            );
            assert_eq!(self.bench.exchange.input(place), expected, "inputs of slave {place}");
            assert!(
                outputs.is_empty() || written[0].contains(place),
                "slave {place} is not written"
            );
            if written[1].contains(place) {
                self.acting[place] = outputs;
            }
            if !self.acting[place].is_empty() {
                let acting = self.bench.segment.outputs(place + 1);
                assert_eq!(acting.as_ref(), Some(&self.acting[place]), "outputs of slave {place}");
            }
        }
        assert_eq!(self.bench.exchange.al_status().is_some(), seen);
    }

    /// Some of the telegrams that the last cycle had, lost or late.
    fn fates(&self, random: &mut Random) -> Vec<(Which, Fate)> {
        let mut fates = Vec::new();
        for (turn, telegrams) in self.bench.sent.iter().enumerate() {
            for number in 0..telegrams.len() {
                let fate = match random.bits() % 12 {
                    0 => Fate::RequestLost,
                    1 => Fate::ReplyLost,
                    2 => Fate::Late,
                    _ => continue,
                };
                fates.push(((number, turn == 1), fate));
            }
        }
        fates
    }
}

#[test]
fn generated_chains_lose_what_their_lost_frames_carry_and_nothing_else() {
    let (mut most_bytes, mut most_frames) = (0, 0);
    for seed in 0..12 {
        let mut random = Random::new(seed);
        let case = Case::new(seed, &mut random);
        let mut bench = case.start(seed);
        let took_ms = bench.operational();
        let all = case.lengths.clone();
        let bytes: u32 = all.iter().map(|(outputs, inputs)| u32::from(outputs + inputs)).sum();
        let frames = bench.sent[0].len().max(bench.sent[1].len());
        println!(
            "seed {seed}, {} us, {:?}, clocks {}: {} slaves, {bytes} bytes, {frames} frames, OP after {took_ms} ms",
            case.cycle_us,
            case.kind,
            case.clocks,
            all.len(),
        );
        (most_bytes, most_frames) = (most_bytes.max(bytes), most_frames.max(frames));
        let before: [[FrameCounters; 2]; 5] =
            core::array::from_fn(|number| bench.exchange.frame_counters(number).expect("a frame"));
        let errors = bench.exchange.counters().working_counter_errors;
        let acting = all.iter().map(|(outputs, _)| vec![0; usize::from(*outputs)]).collect();
        let mut running = Running {
            bench,
            lengths: all,
            acting,
            counted: before,
        };
        for _ in 0..60 {
            let fates = running.fates(&mut random);
            running.cycle(&mut random, &fates);
        }
        // All is well again at once.
        let mut clock_ns = None;
        for _ in 0..10 {
            running.cycle(&mut random, &[]);
            let now_ns = running.bench.exchange.clock_ns();
            assert_eq!(now_ns.is_some(), case.clocks);
            if let (Some(now_ns), Some(before_ns)) = (now_ns, clock_ns) {
                let off_ns = u64::abs_diff(now_ns - before_ns, u64::from(case.cycle_us) * 1_000);
                assert!(off_ns < 1_000, "the reference clock is {off_ns} ns off after a cycle");
            }
            clock_ns = now_ns;
        }
        for (number, expected) in running.counted.iter().enumerate() {
            let counters = running.bench.exchange.frame_counters(number);
            assert_eq!(counters, Some(*expected), "seed {seed}, frame {number}");
        }
        let now = running.bench.exchange.counters().working_counter_errors;
        assert_eq!(now, errors, "seed {seed}: lost frames are no wrong working counters");
        lose_the_last_slave(running, &mut random);
    }
    assert!(
        most_bytes >= 4_096 && most_frames == 4,
        "{most_bytes} bytes, {most_frames} frames"
    );
}

/// The last slave with process data is switched off and comes back; the others go on meanwhile.
fn lose_the_last_slave(mut running: Running, random: &mut Random) {
    let Some(last) = running.lengths.iter().rposition(|lengths| *lengths != (0, 0)) else {
        return;
    };
    running.bench.segment.inject(Fault::Power(last + 1, 200));
    running.bench.run_ms(1_500);
    let lost = BusEvent::SlaveLost { position: last as u8 };
    assert!(running.bench.log.contains(&lost), "{:#?}", running.bench.log);
    let is_there = |place: usize| running.bench.exchange.input(place).is_some();
    let mut inputs = running.lengths.iter().enumerate().take(last);
    assert!(inputs.all(|(place, (_, inputs))| *inputs == 0 || is_there(place)));
    assert!(running.bench.commands.enqueue(BusCommand::Recover).is_ok());
    running.bench.operational();
    for _ in 0..5 {
        running.cycle(random, &[]);
    }
}

#[test]
fn outputs_of_slaves_beyond_the_first_frame_only_arrive_at_them() {
    let case = Case {
        cycle_us: 1_000,
        kind: ExchangeKind::Split,
        clocks: false,
        lengths: [vec![(0, 1); 32], vec![(1, 0); 2]].concat(),
    };
    let mut bench = case.start(1);
    bench.operational();
    assert_eq!(bench.sent.each_ref().map(Vec::len), [1, 1]);
    let acting = case.lengths.iter().map(|(outputs, _)| vec![0; usize::from(*outputs)]);
    let mut running = Running {
        acting: acting.collect(),
        bench,
        lengths: case.lengths,
        counted: Default::default(),
    };
    let mut random = Random::new(1);
    for _ in 0..20 {
        running.cycle(&mut random, &[]);
    }
    running.cycle(&mut random, &[((0, true), Fate::RequestLost)]);
    running.cycle(&mut random, &[]);
    lose_the_last_slave(running, &mut random);
}

/// A chain of terminals with a byte of outputs and of inputs, with clocks or without; the last one is not there yet.
fn chain_without_its_last(clocks: &[bool]) -> Bench {
    let slaves = clocks
        .iter()
        .map(|clock| SlaveKind::Sii(terminal_of_bytes(1, 1, *clock).into()));
    let options = SegmentOptions {
        slaves: slaves.collect(),
        ..SegmentOptions::default()
    };
    start_without(clocks.len(), &options)
}

/// A chain whose bus is operational while one slave, from 1, is not there yet.
fn start_without(absent: usize, options: &SegmentOptions) -> Bench {
    let setup = BusSetup {
        terminals: SlaveSet::ALL,
        cycle_ns: 1_000_000,
        watchdog_ms: 500,
        clocks: true,
        ..BusSetup::default()
    };
    let mut bench = Bench::start(options, setup);
    bench.segment.inject(Fault::Remove(absent));
    bench.operational();
    bench
}

/// For 200 cycles the reference's time comes in each, and nothing that answers is wrong.
fn the_time_comes(bench: &mut Bench, what: &str) {
    let errors = bench.exchange.counters().working_counter_errors;
    for _ in 0..200 {
        bench.cycle();
        assert!(bench.exchange.clock_ns().is_some(), "{what}");
    }
    let now = bench.exchange.counters().working_counter_errors;
    assert_eq!(now, errors, "{what}: {:#?}", bench.log);
}

#[test]
fn the_clock_of_an_extra_slave_is_no_error_for_ever() {
    let mut bench = chain_without_its_last(&[true; 4]);
    for round in 0..2 {
        bench.segment.inject(Fault::Insert(4));
        bench.run_ms(1_500);
        the_time_comes(&mut bench, &format!("there, {round}"));
        bench.segment.inject(Fault::Remove(4));
        bench.run_ms(500);
        the_time_comes(&mut bench, &format!("gone, {round}"));
    }
}

#[test]
fn the_clocks_agree_whatever_is_plugged_into_a_free_port_of_a_junction() {
    // Frames pass port 3 of the first slave before its port 1.
    let behind_the_first = |slave, port| Branch { slave, behind: 1, port };
    let options = SegmentOptions {
        slaves: vec![SlaveKind::Sii(terminal_of_bytes(1, 1, true).into()); 3],
        branches: vec![behind_the_first(2, 3), behind_the_first(3, 1)],
        clocks: ClockOptions {
            cable_ns: 1_000,
            ..ClockOptions::default()
        },
        ..SegmentOptions::default()
    };
    let mut bench = start_without(2, &options);
    for round in 0..4 {
        for plugged in [true, false] {
            // The slave has a number from the first time on; without power meanwhile it comes back without its address.
            if plugged && round > 1 {
                bench.segment.inject(Fault::Power(2, 50));
            }
            bench.segment.inject(match plugged {
                true => Fault::Insert(2),
                false => Fault::Remove(2),
            });
            bench.run_ms(3_000);
            let times = bench.segment.system_times_ns();
            let (first, behind) = (times[0].expect("a clock"), times[2].expect("a clock"));
            let apart_ns = (first.wrapping_sub(behind) as i64).abs();
            assert!(apart_ns < 200, "{round}, {plugged}: {apart_ns} ns");
        }
    }
}

#[test]
fn a_slave_with_a_clock_is_replaced_by_one_without_and_back() {
    let mut bench = chain_without_its_last(&[true, true, false]);
    for (gone, come) in [(2, 3), (3, 2), (2, 3)] {
        let what = format!("{come} for {gone}");
        bench.segment.inject(Fault::Remove(gone));
        bench.run_ms(500);
        bench.segment.inject(Fault::Power(come, 50));
        bench.segment.inject(Fault::Insert(come));
        bench.run_ms(500);
        assert!(bench.commands.enqueue(BusCommand::Recover).is_ok());
        bench.operational();
        the_time_comes(&mut bench, &what);
        bench.segment.set_inputs(come, &[0x5A]);
        bench.exchange.output(1).copy_from_slice(&[0xA5]);
        bench.run(2);
        assert_eq!(bench.exchange.input(1), Some(&[0x5A][..]), "{what}");
        assert_eq!(bench.segment.outputs(come), Some(vec![0xA5]), "{what}");
    }
}

#[test]
fn the_65th_slave_is_refused_with_the_limit_and_64_come_up() {
    for slaves in [65, 64] {
        let case = Case {
            cycle_us: 1_000,
            kind: ExchangeKind::Split,
            clocks: false,
            lengths: vec![(1, 1); slaves],
        };
        let mut bench = case.start(1);
        if slaves == 64 {
            bench.operational();
            // Two frames: the first one carries the first 32 slaves.
            assert_eq!(bench.sent.each_ref().map(Vec::len), [2, 2]);
            continue;
        }
        bench.run_ms(5_000);
        let refused = BusEvent::Refused {
            position: None,
            step: Step::Discover,
            error: BusError::TooManySlaves {
                expected: 64,
                actual: 65,
            },
        };
        assert!(bench.log.contains(&refused), "{:#?}", bench.log);
    }
}
