//! Slave controllers with less than others, or with units that another master has left in them.

use crate::bench;
use crate::device_images::{terminal_of_bytes, without_lrw};
use etherpen::ethercat::configure::Direction;
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::ethercat::event::{BusCommand, BusSetup};
use etherpen::ethercat::slave_set::SlaveSet;
use etherpen::ethercat::supervisor::BusEvent;
use etherpen::ethercat::wire::{Address, Command, FRAME_LEN_MAX, FrameBuilder, FrameView};
use etherpen_segment::random::Random;
use etherpen_segment::{AlState, Fault, PlaceOptions, SegmentOptions, SlaveKind};

/// Cycles until a value has gone through the exchange in either direction.
pub(crate) const THROUGH: u32 = 3;
/// Longest time until a lost or returned slave is noticed, ms.
pub(crate) const NOTICED_MS: u64 = 200;
const NO_LRW: PlaceOptions = PlaceOptions {
    ignores_lrw: true,
    ..DEFAULT
};
pub(crate) const PAIRS: PlaceOptions = PlaceOptions {
    takes_pairs: true,
    ..DEFAULT
};
pub(crate) const DEFAULT: PlaceOptions = PlaceOptions {
    alias: 0,
    serial: None,
    identification: None,
    clock: None,
    controller: None,
    managers: None,
    password: 0,
    one_turn: None,
    lock_ms: None,
    ignores_lrw: false,
    takes_pairs: false,
    processor: etherpen_segment::SlaveOptions {
        reads_sii: false,
        ignores_repeats: false,
        boot_ms: 0,
        transition_ms: 0,
        mailbox_ms: 0,
    },
};

pub(crate) type Bench = bench::Bench<16, 0>;

/// A slave of a chain: its kind, what is set on it, and the bits of its inputs and outputs.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    kind: SlaveKind,
    place: PlaceOptions,
    inputs: u8,
    outputs: u8,
}

impl Member {
    pub(crate) fn new(kind: SlaveKind, inputs: u8, outputs: u8) -> Self {
        let place = DEFAULT;
        Self {
            kind,
            place,
            inputs,
            outputs,
        }
    }

    pub(crate) fn coupler() -> Self {
        Self::new(SlaveKind::Ek1100, 0, 0)
    }

    /// A terminal of so many bytes; its memory says that it does not support LRW, or nothing about it.
    pub(crate) fn of_bytes(outputs: u8, inputs: u8, takes_lrw: bool) -> Self {
        let image = terminal_of_bytes(outputs.into(), inputs.into(), false);
        let image = if takes_lrw { image } else { without_lrw(image) };
        Self::new(SlaveKind::Sii(image.into()), 8 * inputs, 8 * outputs)
    }

    /// The terminal on a controller whose features say that it does not support LRW.
    pub(crate) fn with(self, place: PlaceOptions) -> Self {
        Self { place, ..self }
    }
}

pub(crate) fn options(chain: &[Member]) -> SegmentOptions {
    SegmentOptions {
        slaves: chain.iter().map(|member| member.kind.clone()).collect(),
        places: chain.iter().map(|member| member.place).collect(),
        ..SegmentOptions::default()
    }
}

pub(crate) fn setup(
    exchange: ExchangeKind,
    terminals: SlaveSet,
) -> BusSetup<etherpen::ethercat::no_drivers::NoDrivers> {
    BusSetup {
        terminals,
        exchange,
        cycle_ns: 1_000_000,
        watchdog_ms: 100,
        ..BusSetup::default()
    }
}

/// The datagrams of the last cycle's telegrams that address logical memory: command, address, length.
fn logical(bench: &Bench) -> Vec<(u8, u32, u32)> {
    let mut found = Vec::new();
    for telegram in bench.sent.iter().flatten() {
        let view = FrameView::new_checked(telegram).expect("a frame of the master");
        for datagram in view.datagrams().filter_map(Result::ok) {
            let command = datagram.command_number();
            if [Command::Lrd, Command::Lwr, Command::Lrw]
                .map(|known| known as u8)
                .contains(&command)
            {
                found.push((command, datagram.address().0, datagram.data().len() as u32));
            }
        }
    }
    found
}

impl Bench {
    fn until(&mut self, limit_ms: u64, wanted: impl Fn(&Self) -> bool, mut each: impl FnMut(&Self)) {
        for _ in 0..limit_ms {
            self.cycle();
            each(self);
            if wanted(self) {
                return;
            }
        }
        panic!("not within {limit_ms} ms: {:#?}", self.log);
    }

    /// Values go through every slave of a chain in both directions while no working counter is wrong.
    pub(crate) fn assert_exchanges(&mut self, chain: &[(usize, &Member)], random: &mut Random, what: &str) {
        let errors = self.exchange.counters().working_counter_errors;
        for _ in 0..8 {
            let values: Vec<u64> = chain.iter().map(|_| random.bits()).collect();
            for ((slave, member), value) in chain.iter().zip(&values) {
                self.segment.set_inputs(
                    slave + 1,
                    &value.to_le_bytes()[..usize::from(member.inputs.div_ceil(8))],
                );
                let is_set = member.outputs > 0 && self.set_bits(*slave, member.outputs, *value);
                assert_eq!(is_set, member.outputs > 0, "slave {slave}, {what}: {:#?}", self.log);
            }
            self.run(THROUGH);
            for ((slave, member), value) in chain.iter().zip(&values) {
                let masked = |bits: u8| value & ((1 << bits) - 1);
                if member.inputs > 0 {
                    let read = self.bits(*slave, Direction::Inputs, member.inputs);
                    assert_eq!(read, Some(masked(member.inputs)), "inputs of slave {slave}, {what}");
                }
                if member.outputs > 0 {
                    let bytes = masked(member.outputs).to_le_bytes();
                    let expected = bytes[..usize::from(member.outputs.div_ceil(8))].to_vec();
                    assert_eq!(
                        self.segment.outputs(slave + 1),
                        Some(expected),
                        "outputs of slave {slave}, {what}"
                    );
                }
            }
        }
        assert_eq!(self.exchange.counters().working_counter_errors, errors, "{what}");
        // As a bystander counts: the last telegrams once more.
        for telegram in self.sent.clone().iter().flatten() {
            for reply in self.segment.frame(self.now_us, telegram) {
                let view = FrameView::new_checked(&reply).expect("a frame");
                for datagram in view.datagrams().filter_map(Result::ok) {
                    let expected = match datagram.command_number() {
                        command if command == Command::Lrw as u8 => 3,
                        command if command == Command::Lrd as u8 || command == Command::Lwr as u8 => 1,
                        _ => continue,
                    };
                    assert_eq!(datagram.working_counter(), expected, "{what}: {datagram:?}");
                }
            }
        }
    }

    /// Has registers of the slave at a place on the wire written, as another master would.
    pub(crate) fn write_as_another(&mut self, position: u16, register: u16, bytes: &[u8]) {
        let address = Address::position(position, register);
        let (_, counter) = self.as_another(Command::Apwr, address, bytes);
        assert_eq!(counter, 1, "{register:#06x}");
    }

    /// Registers of the slave at a place on the wire.
    pub(crate) fn registers(&mut self, position: u16, register: u16, length: usize) -> Vec<u8> {
        let address = Address::position(position, register);
        let (data, counter) = self.as_another(Command::Aprd, address, &vec![0; length]);
        assert_eq!(counter, 1, "{register:#06x}");
        data
    }

    fn as_another(&mut self, command: Command, address: Address, bytes: &[u8]) -> (Vec<u8>, u16) {
        let mut frame = [0; FRAME_LEN_MAX];
        let mut builder = FrameBuilder::new(&mut frame, [0x10, 0, 0, 0, 0, 2]).expect("room");
        let data = builder.push(command, 0xEE, address, bytes.len()).expect("room");
        data.copy_from_slice(bytes);
        let length = builder.finish();
        let replies = self.segment.frame(self.now_us, &frame[..length]);
        let view = FrameView::new_checked(&replies[0]).expect("a frame");
        let datagram = view.datagrams().next().expect("a datagram").expect("a whole one");
        (datagram.data().to_vec(), datagram.working_counter())
    }

    /// Takes a slave, from 1, out of the chain without switching it off, plugs it in again, and repairs the bus.
    pub(crate) fn plug_again(&mut self, slave: usize) {
        self.segment.inject(Fault::Remove(slave));
        self.run_ms(NOTICED_MS);
        self.segment.inject(Fault::Insert(slave));
        self.run_ms(NOTICED_MS);
        self.recover();
    }

    pub(crate) fn recover(&mut self) {
        assert!(self.commands.enqueue(BusCommand::Recover).is_ok());
        let from = self.log.len();
        self.until(
            5_000,
            |bench| bench.log[from..].contains(&BusEvent::Operational),
            |_| (),
        );
        self.run_ms(20);
    }

    /// Nothing is left in the units 4 to 7 of the controller at a place on the wire. Only its activation is written to a sync
    /// manager that is enabled.
    fn assert_blank(&mut self, position: u16, what: &str) {
        for unit in 4..8 {
            assert_eq!(self.registers(position, fmmu(unit), 16), [0; 16], "FMMU {unit}, {what}");
            let manager = self.registers(position, sync_manager(unit), 8);
            assert_eq!(manager[6] & 1, 0, "sync manager {unit}, {what}: {manager:x?}");
        }
    }

    pub(crate) fn al_state(&self, slave: usize) -> AlState {
        self.segment.slaves()[slave].al_state
    }
}

/// The logical memory of the slave at a place: 64 bytes for each place.
pub(crate) fn share(place: usize) -> (u32, u32) {
    (0x0001_0000 + 64 * place as u32, 64)
}

pub(crate) fn overlap(one: (u32, u32), other: (u32, u32)) -> bool {
    one.0 < other.0 + other.1 && other.0 < one.0 + one.1
}

#[test]
pub(crate) fn a_slave_without_lrw_exchanges_its_data_by_lrd_and_lwr_in_any_chain() {
    let (mut together, mut apart) = (0, 0);
    for seed in 0..24_u64 {
        let mut random = Random::new(seed);
        let kind = [ExchangeKind::Split, ExchangeKind::Combined][(seed % 2) as usize];
        let mut any = |count: u64| 1 + (random.bits() % count) as u8;
        let mut chain = vec![Member::coupler()];
        for _ in 0..any(5) {
            chain.push(match any(4) {
                1 => Member::new(SlaveKind::El1008, 8, 0),
                2 => Member::new(SlaveKind::El2004, 0, 4),
                3 => Member::coupler(),
                _ => Member::of_bytes(any(4), any(4), true),
            });
        }
        // Told by the memory, or by the features of the controller; some of them are not in use.
        let is_told_by_memory = seed / 2 % 2 == 0;
        let is_used = seed / 4 % 3 > 0;
        let (outputs, inputs) = (any(4), any(4));
        let odd = match is_told_by_memory {
            true => Member::of_bytes(outputs, inputs, false),
            false => Member::of_bytes(outputs, inputs, true).with(NO_LRW),
        };
        let at = usize::from(any(chain.len() as u64));
        chain.insert(at, odd);
        chain.push(Member::of_bytes(2, 2, true));
        let used = |place: &usize| is_used || *place != at;
        let terminals: SlaveSet = (0..chain.len()).filter(used).collect();
        let what = format!("seed {seed}, {kind:?}, at {at}, used {is_used}, by memory {is_told_by_memory}");

        let mut bench = Bench::start(&options(&chain), setup(kind, terminals));
        let mut lrw = 0;
        let mut look = |bench: &Bench| {
            for (command, address, length) in logical(bench) {
                let is_lrw = command == Command::Lrw as u8;
                lrw += u32::from(is_lrw);
                let crosses = is_lrw && overlap((address, length), share(at));
                assert!(!crosses, "{what}, at {} us", bench.now_us);
            }
        };
        bench.until(10_000, |bench| bench.log.contains(&BusEvent::Operational), &mut look);
        for _ in 0..20 {
            bench.cycle();
            look(&bench);
        }
        let members: Vec<(usize, &Member)> = chain.iter().enumerate().filter(|(place, _)| used(place)).collect();
        bench.assert_exchanges(&members, &mut random, &what);
        look(&bench);
        // The others travel together where nobody says that this is not possible.
        let travels_together = kind == ExchangeKind::Combined && !is_used && is_told_by_memory;
        assert_eq!(lrw > 0, travels_together, "{what}");
        together += u32::from(travels_together);
        apart += u32::from(kind == ExchangeKind::Combined && !travels_together);
    }
    assert!(together > 0 && apart > 0, "both kinds of chains");
}

#[test]
pub(crate) fn a_slave_without_lrw_that_replaces_one_with_it_ends_the_combined_exchange_at_its_repair() {
    for seed in 0..40_u64 {
        let mut random = Random::new(seed);
        let (is_told_by_memory, is_first_away) = (seed % 2 == 0, seed / 2 % 2 == 0);
        let usual = Member::of_bytes(2, 2, true);
        let odd = match is_told_by_memory {
            true => Member::of_bytes(2, 2, false),
            false => usual.clone().with(NO_LRW),
        };
        // The third slave is away at first, and then takes the place of the second.
        let chain = [
            Member::coupler(),
            usual.clone(),
            odd,
            Member::of_bytes(3, 1, true),
            Member::coupler(),
        ];
        // Another slave loses its supply in the repair, which is begun again.
        let disturbed_ms = (seed >= 8).then(|| 1 + random.bits() % 80);
        let what = format!("seed {seed}, by memory {is_told_by_memory}, disturbed after {disturbed_ms:?} ms");
        let mut bench = Bench::start(
            &options(&chain),
            setup(ExchangeKind::Combined, SlaveSet::places(&[0, 1, 2])),
        );
        bench.segment.inject(Fault::Remove(3));
        bench.operational();
        let has_lrw = |bench: &Bench| {
            logical(bench)
                .iter()
                .any(|(command, ..)| *command == Command::Lrw as u8)
        };
        assert!(has_lrw(&bench), "{what}");
        bench.segment.inject(Fault::Remove(2));
        if is_first_away {
            bench.run_ms(NOTICED_MS);
        }
        bench.segment.inject(Fault::Insert(3));
        bench.run_ms(NOTICED_MS);
        let from = bench.log.len();
        if let Some(after_ms) = disturbed_ms {
            assert!(bench.commands.enqueue(BusCommand::Recover).is_ok());
            bench.run_ms(after_ms);
            bench.segment.inject(Fault::Power(4, 30));
            bench.run_ms(1_000);
        }
        assert!(bench.commands.enqueue(BusCommand::Recover).is_ok());
        let recovering = bench.log.len();
        bench.until(
            5_000,
            |bench| bench.log[recovering..].contains(&BusEvent::Operational),
            |bench| {
                let is_mapped = matches!(bench.al_state(2), AlState::SafeOperational | AlState::Operational);
                for (command, address, length) in logical(bench) {
                    let crosses = command == Command::Lrw as u8 && overlap((address, length), share(1));
                    assert!(!(is_mapped && crosses), "{what}, at {} us", bench.now_us);
                }
            },
        );
        bench.run_ms(20);
        let repaired = BusEvent::Repaired { position: 1 };
        assert!(
            bench.log[from..].contains(&repaired),
            "{what}: {:#?}",
            &bench.log[from..]
        );
        assert!(!has_lrw(&bench), "{what}");
        // Place 1 is the third slave of the segment now.
        let errors = bench.exchange.counters().working_counter_errors;
        for _ in 0..8 {
            let value = random.bits() & 0xFFFF;
            bench.segment.set_inputs(3, &(value as u16).to_le_bytes());
            bench.segment.set_inputs(4, &[value as u8]);
            assert!(bench.set_bits(1, 16, value) && bench.set_bits(2, 24, value), "{what}");
            bench.run(THROUGH);
            assert_eq!(bench.bits(1, Direction::Inputs, 16), Some(value), "{what}");
            assert_eq!(bench.bits(2, Direction::Inputs, 8), Some(value & 0xFF), "{what}");
            assert_eq!(
                bench.segment.outputs(3),
                Some((value as u16).to_le_bytes().to_vec()),
                "{what}"
            );
            assert_eq!(
                bench.segment.outputs(4),
                Some(value.to_le_bytes()[..3].to_vec()),
                "{what}"
            );
        }
        assert_eq!(bench.exchange.counters().working_counter_errors, errors, "{what}");
    }
}

#[test]
pub(crate) fn a_slave_without_lrw_that_was_away_at_the_bring_up_is_used_from_the_next_one_on() {
    let mut random = Random::new(1);
    let chain = [
        Member::coupler(),
        Member::of_bytes(2, 2, true),
        Member::of_bytes(1, 3, false),
    ];
    let start = || setup(ExchangeKind::Combined, SlaveSet::ALL);
    let mut bench = Bench::start(&options(&chain), start());
    bench.segment.inject(Fault::Remove(3));
    bench.operational();
    bench.segment.inject(Fault::Insert(3));
    bench.run_ms(NOTICED_MS);
    bench.recover();
    assert_ne!(bench.al_state(2), AlState::Operational);
    bench.assert_exchanges(&[(1, &chain[1])], &mut random, "an extra slave");
    assert!(bench.commands.enqueue(BusCommand::Start(start())).is_ok());
    bench.operational();
    assert_eq!(bench.al_state(2), AlState::Operational);
    let members: Vec<(usize, &Member)> = chain.iter().enumerate().collect();
    bench.assert_exchanges(&members, &mut random, "from the next bring-up on");
}

/// An FMMU of another master: it maps memory of its slave into the logical memory of the slave at a place.
pub(crate) fn stale_fmmu(place: usize, physical: u16, is_input: bool) -> [u8; 16] {
    let mut block = [0; 16];
    block[..4].copy_from_slice(&share(place).0.to_le_bytes());
    block[4..6].copy_from_slice(&4_u16.to_le_bytes());
    block[7] = 7;
    block[8..10].copy_from_slice(&physical.to_le_bytes());
    (block[11], block[12]) = (if is_input { 1 } else { 2 }, 1);
    block
}

/// Registers of FMMUs, and of sync managers, from a number on.
pub(crate) fn fmmu(number: usize) -> u16 {
    0x0600 + 16 * number as u16
}

pub(crate) fn sync_manager(number: usize) -> u16 {
    0x0800 + 8 * number as u16
}

/// A sync manager of another master, enabled over memory that nobody else uses.
pub(crate) const STALE_MANAGER: [u8; 8] = [0x00, 0x1F, 4, 0, 0x24, 0, 1, 0];

#[test]
pub(crate) fn stale_units_of_a_large_controller_that_takes_no_blocks_of_them_are_cleared() {
    // Slaves with eight units of each kind, in use or not, in front of others.
    for (large, is_used) in [
        (Member::coupler(), true),
        (Member::coupler(), false),
        (Member::new(SlaveKind::Cia402, 0, 0), true),
        (Member::new(SlaveKind::Cia402, 0, 0), false),
    ] {
        for place in [PAIRS, DEFAULT] {
            let mut random = Random::new(7);
            let large = large.clone().with(place);
            let chain = [
                Member::new(SlaveKind::El1008, 8, 0),
                large.clone(),
                Member::of_bytes(2, 2, true),
                Member::new(SlaveKind::El2004, 0, 4),
            ];
            let what = format!("{:?}, used {is_used}, in pairs {}", large.kind, place.takes_pairs);
            let terminals = if is_used {
                SlaveSet::ALL
            } else {
                SlaveSet::places(&[0, 2, 3])
            };
            let mut bench = Bench::start(&options(&chain), setup(ExchangeKind::Split, terminals));
            let leave = |bench: &mut Bench| {
                for unit in 0..8 {
                    let mapped = stale_fmmu([0, 2][unit % 2], 0x1000 + 0x10 * unit as u16, unit % 4 > 1);
                    bench.write_as_another(1, fmmu(unit), &mapped);
                    bench.write_as_another(1, sync_manager(unit), &STALE_MANAGER);
                }
                bench.write_as_another(1, 0x1000, &[0x5A; 0x80]);
            };
            leave(&mut bench);
            bench.operational();
            let others = [(0, &chain[0]), (2, &chain[2]), (3, &chain[3])];
            bench.assert_exchanges(&others, &mut random, &what);
            bench.assert_blank(1, &what);
            if !is_used {
                continue;
            }
            // The repair clears them too, of a slave that comes from another master with power.
            leave(&mut bench);
            bench.write_as_another(1, 0x0010, &0x2001_u16.to_le_bytes());
            bench.plug_again(2);
            let state = bench.al_state(1);
            assert_eq!(state, AlState::Operational, "{what}: {:#?}", bench.log);
            bench.assert_exchanges(&others, &mut random, &what);
            bench.assert_blank(1, &what);
        }
    }
}
