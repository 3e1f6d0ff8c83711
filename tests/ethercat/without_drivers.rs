//! The master alone: slaves of any kind by their own process data, at cycle times from 0.25 to 10 ms.

use crate::bench::{self, Pace};
use etherpen::ethercat::configure::{Direction, Entry};
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::event::{BusCommand, BusSetup, ChosenEntry, WantedValue};
use etherpen::ethercat::slave_set::SlaveSet;
use etherpen::ethercat::supervisor::BusEvent;
use etherpen::ethercat::wire::coe::Object;
use etherpen::ethercat::wire::{Address, Command, FRAME_LEN_MAX, FrameBuilder};
use etherpen_segment::random::Random;
use etherpen_segment::{AlState, Fault, PlaceOptions, SegmentOptions, SlaveKind, SlaveOptions};

/// Cycles until a value has gone through the exchange in either direction.
const THROUGH: u32 = 3;

/// A chain that one frame a cycle serves.
type Bench = bench::Bench<16, 0>;

impl Bench {
    fn new(slaves: &[SlaveKind], cycle_us: u64, exchange: ExchangeKind, values: &[WantedValue]) -> Self {
        Self::chosen(slaves, cycle_us, exchange, values, &[])
    }

    fn chosen(
        slaves: &[SlaveKind],
        cycle_us: u64,
        exchange: ExchangeKind,
        values: &[WantedValue],
        chosen: &'static [ChosenEntry],
    ) -> Self {
        let mut setup = BusSetup {
            terminals: SlaveSet::ALL,
            exchange,
            cycle_ns: cycle_us as u32 * 1_000,
            watchdog_ms: 100,
            ..BusSetup::default()
        };
        setup.values.extend(values.iter().copied());
        setup.chosen = chosen;
        let options = SegmentOptions {
            slaves: slaves.to_vec(),
            ..SegmentOptions::default()
        };
        Self::start(&options, setup)
    }
}

fn word(slave: u8, direction: Direction, index: u16, bits: u8) -> WantedValue {
    WantedValue::new(slave, direction, Object::new(index, 0), bits)
}

#[test]
pub(crate) fn drives_are_exchanged_by_the_objects_that_they_list_and_terminals_by_their_memory() {
    use SlaveKind::{Ax2000, Cia402, Ek1100, El1008, El2004};
    let chain = [Ek1100, Ax2000, El1008, Cia402, El2004, Ax2000];
    let values = [
        word(1, Direction::Inputs, 0x6041, 16),
        word(1, Direction::Outputs, 0x6040, 16),
        word(3, Direction::Inputs, 0x6041, 16),
        word(3, Direction::Outputs, 0x6040, 16),
        word(3, Direction::Inputs, 0x6064, 32),
        word(5, Direction::Inputs, 0x6041, 16),
    ];
    for kind in [ExchangeKind::Split, ExchangeKind::Combined] {
        let mut bench = Bench::new(&chain, 1_000, kind, &values);
        let took_ms = bench.operational();
        println!("{kind:?}: OP after {took_ms} ms");
        for (slave, state) in bench.segment.slaves().iter().enumerate() {
            assert_eq!(state.al_state, AlState::Operational, "slave {slave}: {:#?}", bench.log);
        }
        let word = |bench: &Bench, number: usize| -> u16 {
            let place = bench.exchange.value::<u16>(number, &values[number]).expect("a place");
            bench.exchange.get(&place).expect("a value")
        };
        let control = |bench: &mut Bench, number: usize, value: u16| {
            let place = bench.exchange.value::<u16>(number, &values[number]).expect("a place");
            assert!(bench.exchange.set(&place, value));
        };
        assert!(
            bench.exchange.value::<i32>(4, &values[4]).is_some(),
            "the position of the CiA 402 drive"
        );
        for (status, command) in [(0, 1), (2, 3)] {
            assert_eq!(word(&bench, status) & 0x6F, 0x40, "switch-on disabled");
            control(&mut bench, command, 0x0006);
            bench.run_ms(50);
            assert_eq!(word(&bench, status) & 0x6F, 0x21, "ready to switch on");
            control(&mut bench, command, 0x0000);
            bench.run_ms(50);
            assert_eq!(word(&bench, status) & 0x6F, 0x40, "switch-on disabled again");
        }
        assert_eq!(word(&bench, 5) & 0x6F, 0x40, "the other drive was not told");
    }
}

#[test]
pub(crate) fn any_cycle_time_from_250_us_to_10_ms_brings_a_chain_up_exchanges_and_repairs_it() {
    for seed in 0..12_u64 {
        let mut random = Random::new(seed);
        let cycle_us = [250, 500, 1_000, 2_000, 4_000, 10_000][(seed % 6) as usize];
        let kind = match random.bits() % 2 {
            0 => ExchangeKind::Split,
            _ => ExchangeKind::Combined,
        };
        const KINDS: [(SlaveKind, u8, u8); 6] = [
            (SlaveKind::Ek1100, 0, 0),
            (SlaveKind::El1004, 4, 0),
            (SlaveKind::El1008, 8, 0),
            (SlaveKind::El2004, 0, 4),
            (SlaveKind::El2008, 0, 8),
            (SlaveKind::Ax2000, 0, 0),
        ];
        let mut chain: Vec<(SlaveKind, u8, u8)> = vec![KINDS[0].clone()];
        chain.extend((0..1 + random.bits() % 14).map(|_| KINDS[(random.bits() % 6) as usize].clone()));
        chain.push(KINDS[4].clone());
        let kinds: Vec<SlaveKind> = chain.iter().map(|(kind, ..)| kind.clone()).collect();
        let mut bench = Bench::new(&kinds, cycle_us, kind, &[]);
        let took_ms = bench.operational();
        println!(
            "seed {seed}, {cycle_us} us, {kind:?}, {} slaves: OP after {took_ms} ms",
            chain.len()
        );
        let last = chain.len() - 1;
        bench.segment.inject(Fault::Power(last + 1, 200));
        bench.run_ms(1_000);
        let lost = BusEvent::SlaveLost { position: last as u8 };
        assert!(bench.log.contains(&lost), "{:#?}", bench.log);
        assert!(bench.commands.enqueue(BusCommand::Recover).is_ok());
        bench.operational();
        let errors = bench.exchange.counters().working_counter_errors;
        for _ in 0..10 {
            let values: Vec<u64> = chain.iter().map(|_| random.bits() & 0xFF).collect();
            for (slave, (_, _, outputs)) in chain.iter().enumerate() {
                bench.segment.set_inputs(slave + 1, &[values[slave] as u8]);
                let is_set = *outputs > 0 && bench.set_bits(slave, *outputs, values[slave]);
                assert_eq!(is_set, *outputs > 0, "slave {slave}: {:#?}", bench.log);
            }
            bench.run(THROUGH);
            for (slave, (_, inputs, outputs)) in chain.iter().enumerate() {
                let mask = (1_u64 << (inputs + outputs)) - 1;
                if *inputs > 0 {
                    let read = bench.bits(slave, Direction::Inputs, *inputs);
                    assert_eq!(read, Some(values[slave] & mask), "slave {slave}");
                } else if *outputs > 0 {
                    let act = bench.segment.outputs(slave + 1);
                    assert_eq!(act, Some(vec![(values[slave] & mask) as u8]), "slave {slave}");
                }
            }
        }
        assert_eq!(bench.exchange.counters().working_counter_errors, errors, "seed {seed}");
    }
}

#[test]
pub(crate) fn chosen_process_data_are_assigned_mapped_and_found_where_they_lie() {
    const fn chosen(manager: u8, pdo: u16, index: u16, bits: u8) -> ChosenEntry {
        ChosenEntry {
            slave: 1,
            manager,
            pdo,
            entry: Some(Entry::new(Object::new(index, 0), bits)),
        }
    }
    const CHOICE: [ChosenEntry; 4] = [
        chosen(3, 0x1A00, 0x6064, 32),
        chosen(3, 0x1A00, 0x6041, 16),
        chosen(2, 0x1600, 0x60FF, 32),
        chosen(2, 0x1600, 0x6040, 16),
    ];
    const ODD: [ChosenEntry; 1] = [chosen(3, 0x1A00, 0x2FFF, 32)];
    let values = [
        word(1, Direction::Inputs, 0x6064, 32),
        word(1, Direction::Inputs, 0x6041, 16),
        word(1, Direction::Outputs, 0x6040, 16),
        word(1, Direction::Outputs, 0x60FF, 32),
    ];
    let chain = [SlaveKind::Ek1100, SlaveKind::Cia402, SlaveKind::El2004];
    let mut bench = Bench::chosen(&chain, 1_000, ExchangeKind::Split, &values, &CHOICE);
    bench.operational();
    let plan = bench.exchange.plan();
    let bits: Vec<u16> = plan.values.iter().filter_map(|value| value.bit()).collect();
    assert_eq!(
        bits,
        [0, 32, 32, 0],
        "the entries lie in the order that was chosen: {:#?}",
        bench.log
    );
    let share = &plan.slaves[1];
    assert_eq!((share.input_length, share.output_length), (6, 6));
    let (status, command) = (
        bench.exchange.value::<u16>(1, &values[1]),
        bench.exchange.value::<u16>(2, &values[2]),
    );
    let (status, command) = (status.expect("a place"), command.expect("a place"));
    for (control, expected) in [(0x0006, 0x21), (0x0007, 0x23), (0x0000, 0x40)] {
        assert!(bench.exchange.set(&command, control));
        bench.run_ms(50);
        assert_eq!(bench.exchange.get(&status).map(|word| word & 0x6F), Some(expected));
    }
    // What the slave cannot map is refused with its object, and the others operate.
    let mut bench = Bench::chosen(&chain, 1_000, ExchangeKind::Split, &values, &ODD);
    bench.operational();
    let refused = |event: &BusEvent| {
        matches!(event, BusEvent::TerminalRefused { position: 1, error: BusError::SdoAbort { object, .. }, .. }
            if object.index == 0x1A00)
    };
    assert!(bench.log.iter().any(refused), "{:#?}", bench.log);
    assert!(bench.set_bits(2, 4, 0x5));
    bench.run(THROUGH);
    assert_eq!(bench.segment.outputs(3), Some(vec![0x5]));
}

/// Has a slave's register written, as another master would.
fn write_as_another(bench: &mut Bench, position: u16, register: u16, bytes: &[u8]) {
    let mut frame = [0; FRAME_LEN_MAX];
    let mut builder = FrameBuilder::new(&mut frame, [0x10, 0, 0, 0, 0, 2]).expect("room");
    let address = Address::position(position, register);
    let data = builder.push(Command::Apwr, 0xEE, address, bytes.len()).expect("room");
    data.copy_from_slice(bytes);
    let length = builder.finish();
    bench.segment.frame(0, &frame[..length]);
}

#[test]
pub(crate) fn what_another_master_left_in_ports_and_aliases_hides_no_slave() {
    use SlaveKind::{Ek1100, El1008, El2004};
    /// Port 1 stays closed, from 0x0101.
    const PORT_1_CLOSED: u8 = 0x0C;
    for (closed, aliases) in [
        (&[][..], &[1, 2][..]),
        (&[1], &[]),
        (&[0], &[]),
        (&[2, 0], &[]),
        (&[2, 1, 0], &[3, 1]),
    ] {
        let mut options = SegmentOptions {
            slaves: vec![Ek1100, El1008, El2004, El1008],
            places: vec![PlaceOptions::default(); 4],
            ..SegmentOptions::default()
        };
        for position in aliases {
            // The address that the second slave gets.
            options.places[usize::from(*position)].alias = 0x1002;
        }
        let setup = BusSetup {
            terminals: SlaveSet::ALL,
            cycle_ns: 1_000_000,
            watchdog_ms: 100,
            ..BusSetup::default()
        };
        let mut bench = Bench::start(&options, setup);
        for position in aliases {
            // Its use.
            write_as_another(&mut bench, *position, 0x0103, &[1]);
        }
        for position in closed {
            write_as_another(&mut bench, *position, 0x0101, &[PORT_1_CLOSED]);
        }
        bench.operational();
        for (slave, state) in bench.segment.slaves().iter().enumerate() {
            let what = format!(
                "slave {slave}, closed {closed:?}, aliases {aliases:?}: {:#?}",
                bench.log
            );
            assert_eq!(state.al_state, AlState::Operational, "{what}");
        }
    }
}

/// A slave whose processor starts up for 1.5 s, and one that never reads its request.
#[test]
pub(crate) fn a_supervisor_with_a_clock_waits_as_long_however_often_it_is_polled() {
    let begun = |boot_ms, pace| {
        let slow = PlaceOptions {
            processor: SlaveOptions {
                boot_ms,
                ..SlaveOptions::default()
            },
            ..PlaceOptions::default()
        };
        let options = SegmentOptions {
            slaves: vec![SlaveKind::Ek1100, SlaveKind::El1008, SlaveKind::Cia402],
            places: vec![PlaceOptions::default(), PlaceOptions::default(), slow],
            ..SegmentOptions::default()
        };
        let setup = BusSetup {
            terminals: SlaveSet::ALL,
            cycle_ns: 1_000_000,
            watchdog_ms: 100,
            ..BusSetup::default()
        };
        Bench::at_pace(&options, setup, pace)
    };
    let refused_ms = |pace| {
        let mut bench = begun(3_600_000, pace);
        let is_refused = |event: &BusEvent| matches!(event, BusEvent::TerminalRefused { .. });
        while !bench.log.iter().any(is_refused) {
            assert!(bench.now_us < 120_000_000, "{:#?}", bench.log);
            bench.cycle();
        }
        bench.now_us / 1_000
    };
    let usual_ms = [
        begun(1_500, Pace::Milliseconds).operational(),
        refused_ms(Pace::Milliseconds),
    ];
    for (polls, cycles) in [(1, 1), (7, 1), (1, 4), (5, 9)] {
        let pace = Pace::Cycles { polls, cycles };
        let took_ms = [begun(1_500, pace).operational(), refused_ms(pace)];
        println!("{pace:?}: {took_ms:?} ms, with polls as milliseconds {usual_ms:?} ms");
        // The steps of the bring-up itself take longer with fewer polls, its waits do not.
        for (took_ms, usual_ms) in took_ms.into_iter().zip(usual_ms) {
            assert!(took_ms > usual_ms * 9 / 10, "{pace:?}: {took_ms} ms");
            assert!(
                took_ms < usual_ms + 300 * cycles + usual_ms / 10,
                "{pace:?}: {took_ms} ms"
            );
        }
    }
}

/// The supply of a whole chain fails while it is brought up, at any moment.
#[test]
pub(crate) fn a_chain_that_goes_off_as_a_whole_is_not_reported_in_operation_and_comes_up_unasked() {
    use SlaveKind::{Ek1100, El1008, El2004};
    let chain = [Ek1100, El1008, El2004, El1008];
    for (cycle_us, terminals) in [
        (1_000, SlaveSet::ALL),
        (1_000, SlaveSet::places(&[1, 2, 3])),
        (250, SlaveSet::places(&[1, 3])),
    ] {
        let begun = || {
            let setup = BusSetup {
                terminals,
                cycle_ns: cycle_us * 1_000,
                watchdog_ms: 100,
                ..BusSetup::default()
            };
            let options = SegmentOptions {
                slaves: chain.to_vec(),
                ..SegmentOptions::default()
            };
            Bench::start(&options, setup)
        };
        let took_ms = begun().operational();
        assert!(took_ms > 50, "{took_ms}");
        for off_at_ms in (0..took_ms - 3).step_by(3) {
            let mut bench = begun();
            bench.run_ms(off_at_ms);
            for slave in 1..=chain.len() {
                bench.segment.inject(Fault::Power(slave, 400));
            }
            bench.run_ms(390);
            let what = format!("off at {off_at_ms} of {took_ms} ms, {terminals:?}");
            assert!(!bench.log.contains(&BusEvent::Operational), "{what}: {:#?}", bench.log);
            bench.operational();
            for (slave, state) in bench.segment.slaves().iter().enumerate() {
                let is_in_operation = state.al_state == AlState::Operational;
                assert_eq!(
                    is_in_operation,
                    terminals.contains(slave),
                    "slave {slave}, {what}: {:#?}",
                    bench.log
                );
            }
        }
    }
}
