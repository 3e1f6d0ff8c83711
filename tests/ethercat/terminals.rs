//! Terminals beside the robot's drives: their own process data, their failures, and values named by objects.

use crate::device_images::terminal_of_managers;
use crate::rig::{Rig, idle_rig_of};
use etherpen::drives::cia402::{DriveState, DriveTarget};
use etherpen::ethercat::configure::Direction;
use etherpen::ethercat::configure::own_data::DATA_MANAGERS_MAX;
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::ethercat::diagnostics::ServiceRequest;
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::event::WantedValue;
use etherpen::ethercat::place::Place;
use etherpen::ethercat::slave_set::SlaveSet;
use etherpen::ethercat::state;
use etherpen::ethercat::supervisor::BusEvent;
use etherpen::ethercat::wire::coe::Object;
use etherpen::robots::AXES;
use etherpen_segment::random::Random;
use host_tools::cell::{AlState, CellOptions, DriveState as CellDriveState, Fault, SiiFault, SlaveKind, parse_slaves};

/// Longest bring-up, ms.
const BRING_UP_MS_MAX: u64 = 5_000;
/// Cycles until a value has gone through the exchange.
const THROUGH_MS: u32 = 3;

fn rig_of(slaves: Vec<SlaveKind>, exchange: ExchangeKind) -> Rig<'static> {
    let mut rig = idle_rig_of(CellOptions {
        slaves,
        ..CellOptions::default()
    });
    rig.setup.exchange = exchange;
    rig.setup.terminals = SlaveSet::ALL;
    rig
}

fn brought_up(list: &str, exchange: ExchangeKind) -> Rig<'static> {
    let mut rig = rig_of(parse_slaves(list).unwrap(), exchange);
    rig.start();
    rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
    rig.run_ms(20);
    rig
}

impl Rig<'_> {
    /// The bits of a place in the inputs, in this cycle.
    fn input_bits(&self, slave: usize, bit: u16, bits: u8) -> Option<u64> {
        let exchange = self.group.exchange();
        exchange.get(&exchange.bits::<u64>(slave, Direction::Inputs, bit, bits)?)
    }

    fn set_output_bits(&mut self, slave: usize, bit: u16, bits: u8, value: u64) -> bool {
        let place: Option<Place<u64>> = self.group.exchange().bits(slave, Direction::Outputs, bit, bits);
        place.is_some_and(|place| self.group.exchange_mut().set(&place, value))
    }

    fn al_state(&self, slave: usize) -> AlState {
        self.cell.state().slaves[slave].al_state
    }

    /// One more millisecond in which no axis may miss its input.
    fn undisturbed_ms(&mut self, what: &str) {
        self.millisecond();
        assert!(self.inputs.iter().all(Option::is_some), "{what}, at {} ms", self.now_ms);
    }
}

#[test]
pub(crate) fn terminals_of_any_chain_exchange_their_bits_beside_the_drives() {
    const KINDS: [(SlaveKind, u8, u8); 5] = [
        (SlaveKind::Ek1100, 0, 0),
        (SlaveKind::El1004, 4, 0),
        (SlaveKind::El1008, 8, 0),
        (SlaveKind::El2004, 0, 4),
        (SlaveKind::El2008, 0, 8),
    ];
    for seed in 0..12 {
        let mut random = Random::new(seed);
        let exchange = match seed % 2 {
            0 => ExchangeKind::Split,
            _ => ExchangeKind::Combined,
        };
        let mut chain: Vec<(SlaveKind, u8, u8)> = (0..1 + random.bits() % 11)
            .map(|_| KINDS[(random.bits() % KINDS.len() as u64) as usize].clone())
            .collect();
        for _ in 0..AXES {
            let at = random.bits() as usize % (chain.len() + 1);
            chain.insert(at, (SlaveKind::Ax2000, 0, 0));
        }
        println!(
            "seed {seed}: {:?}",
            chain.iter().map(|(kind, ..)| kind).collect::<Vec<_>>()
        );
        let mut rig = rig_of(chain.iter().map(|(kind, ..)| kind.clone()).collect(), exchange);
        rig.start();
        let took_ms = rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.run_ms(20);
        println!("OP after {took_ms} ms");
        for slave in 0..chain.len() {
            assert_eq!(rig.al_state(slave), AlState::Operational, "slave {slave}");
        }
        rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
        let errors = rig.counters().working_counter_errors;
        for _ in 0..20 {
            let values: Vec<u64> = chain.iter().map(|_| random.bits() & 0xFF).collect();
            for (slave, (_, inputs, outputs)) in chain.iter().enumerate() {
                rig.cell.set_inputs(slave + 1, &[values[slave] as u8]);
                let taken = *outputs > 0 && rig.set_output_bits(slave, 0, *outputs, values[slave]);
                assert_eq!(taken, *outputs > 0, "slave {slave}");
                let is_drive = chain[slave].0 == SlaveKind::Ax2000;
                assert_eq!(
                    rig.input_bits(slave, 0, 1).is_some(),
                    *inputs > 0 || is_drive,
                    "slave {slave}"
                );
            }
            for _ in 0..THROUGH_MS {
                rig.undisturbed_ms("an exchange");
            }
            for (slave, (_, inputs, outputs)) in chain.iter().enumerate() {
                let mask = (1 << (inputs + outputs)) - 1;
                if *inputs > 0 {
                    let read = rig.input_bits(slave, 0, *inputs);
                    assert_eq!(read, Some(values[slave] & mask), "inputs of slave {slave}");
                }
                if *outputs > 0 {
                    let act = rig.cell.outputs(slave + 1);
                    assert_eq!(
                        act,
                        Some(vec![(values[slave] & mask) as u8]),
                        "outputs of slave {slave}"
                    );
                }
            }
        }
        assert_eq!(rig.counters().working_counter_errors, errors);
    }
}

#[test]
pub(crate) fn a_terminal_that_fails_disturbs_no_drive_and_comes_back_on_command() {
    // The terminals lie behind the drives, so that the drives stay connected.
    for exchange in [ExchangeKind::Split, ExchangeKind::Combined] {
        for fault in [
            Fault::Power(6, 300),
            Fault::Remove(7),
            Fault::Power(7, 3_000),
            Fault::Remove(6),
        ] {
            let mut rig = brought_up("ax2000*4,ek1100,el1008,el2004", exchange);
            rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
            let (Fault::Power(slave, _) | Fault::Remove(slave)) = fault else {
                unreachable!()
            };
            let what = format!("{fault:?}, {exchange:?}");
            rig.cell.inject(fault);
            let mut lost_ms = None;
            for ms in 0..500 {
                let events = rig.millisecond().to_vec();
                assert!(
                    ms < 4 || rig.inputs.iter().all(Option::is_some),
                    "{what}: a drive at {ms} ms"
                );
                let lost = |event: &BusEvent| {
                    matches!(event, BusEvent::SlaveLost { position } | BusEvent::SlaveLeft { position, .. }
                        if usize::from(*position) + 1 >= slave)
                };
                if events.iter().any(lost) {
                    lost_ms = lost_ms.or(Some(ms));
                }
            }
            assert!(lost_ms.is_some_and(|ms| ms <= 100), "{what}: {lost_ms:?}");
            assert_eq!(rig.drive_states(), [Some(DriveState::OperationEnabled); AXES], "{what}");
            assert!(!rig.set_output_bits(6, 0, 4, 1) || slave != 7 || rig.input_bits(5, 0, 8).is_some());
            rig.run_ms(3_000);
            rig.cell.inject(Fault::Insert(slave));
            rig.run_ms(200);
            rig.recover();
            rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
            rig.run_ms(20);
            rig.cell.set_inputs(6, &[0xA5]);
            assert!(rig.set_output_bits(6, 0, 4, 0x9), "{what}");
            rig.run_ms(THROUGH_MS);
            assert_eq!(rig.input_bits(5, 0, 8), Some(0xA5), "{what}: {:#?}", rig.log);
            assert_eq!(rig.cell.outputs(7), Some(vec![0x9]), "{what}");
            assert_eq!(rig.drive_states(), [Some(DriveState::OperationEnabled); AXES], "{what}");
        }
    }
}

#[test]
pub(crate) fn a_terminal_that_cannot_be_read_is_refused_and_the_drives_operate() {
    for fault in [
        SiiFault::Busy,
        SiiFault::Acknowledge,
        SiiFault::Damaged,
        SiiFault::Blank,
    ] {
        let mut rig = rig_of(
            parse_slaves("ek1100,el1008,ax2000*4,el2004").unwrap(),
            ExchangeKind::Split,
        );
        rig.cell.inject(Fault::Sii(2, fault));
        rig.start();
        rig.wait_for(3 * BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.run_ms(20);
        println!(
            "{fault:?}: {:?}",
            rig.log
                .iter()
                .filter(|event| matches!(event, BusEvent::TerminalRefused { .. }))
                .collect::<Vec<_>>()
        );
        rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
        assert!(rig.set_output_bits(6, 0, 4, 0x6), "{fault:?}");
        rig.run_ms(THROUGH_MS);
        assert_eq!(rig.cell.outputs(7), Some(vec![0x6]), "{fault:?}");
        rig.cell.inject(Fault::Sii(2, SiiFault::Whole));
        rig.run_ms(10);
        if rig.input_bits(1, 0, 8).is_none() {
            rig.recover();
            rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
            rig.run_ms(20);
        }
        rig.cell.set_inputs(2, &[0x3C]);
        rig.run_ms(THROUGH_MS);
        assert_eq!(rig.input_bits(1, 0, 8), Some(0x3C), "{fault:?}: {:#?}", rig.log);
    }
}

/// A value of so many bytes, one after the other in a slave's data of one direction.
fn bytes_of(rig: &Rig<'_>, slave: usize, bytes: u16) -> Option<Vec<u8>> {
    let byte = |at| rig.input_bits(slave, 8 * at, 8).map(|value| value as u8);
    (0..bytes).map(byte).collect()
}

#[test]
pub(crate) fn a_terminal_exchanges_its_data_in_however_many_sync_managers_they_are() {
    for seed in 0..40 {
        let mut random = Random::new(seed);
        let list: Vec<(Direction, u16)> = (0..1 + random.bits() % DATA_MANAGERS_MAX as u64)
            .map(|_| {
                let direction = match random.bits() % 2 {
                    0 => Direction::Outputs,
                    _ => Direction::Inputs,
                };
                (direction, 1 + (random.bits() % 4) as u16)
            })
            .collect();
        let length = |wanted| -> u16 {
            let of_wanted = list.iter().filter(|(direction, _)| *direction == wanted);
            of_wanted.map(|(_, bytes)| bytes).sum()
        };
        let (outputs, inputs) = (length(Direction::Outputs), length(Direction::Inputs));
        let kind = SlaveKind::Sii(terminal_of_managers(&list, list.len(), seed % 3 == 0).into());
        let mut slaves = parse_slaves("ek1100,ax2000*4").unwrap();
        let slave = 1 + random.bits() as usize % 5;
        slaves.insert(slave, kind);
        let exchange = match seed % 2 {
            0 => ExchangeKind::Split,
            _ => ExchangeKind::Combined,
        };
        let mut rig = rig_of(slaves, exchange);
        rig.start();
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.run_ms(20);
        rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
        for _ in 0..5 {
            let mut random_bytes = |count: u16| -> Vec<u8> { (0..count).map(|_| random.bits() as u8).collect() };
            let (read, written) = (random_bytes(inputs), random_bytes(outputs));
            rig.cell.set_inputs(slave + 1, &read);
            for (at, value) in (0..).zip(&written) {
                assert!(
                    rig.set_output_bits(slave, 8 * at, 8, (*value).into()),
                    "seed {seed}: {list:?}"
                );
            }
            for _ in 0..THROUGH_MS {
                rig.undisturbed_ms("an exchange");
            }
            assert_eq!(bytes_of(&rig, slave, inputs), Some(read), "seed {seed}: {list:?}");
            let acted = rig.cell.outputs(slave + 1).unwrap_or_default();
            assert_eq!(acted, written, "seed {seed}: {list:?}");
        }
        let counters = rig.counters();
        assert_eq!(
            (counters.frames_lost, counters.working_counter_errors),
            (0, 0),
            "seed {seed}: {list:?}"
        );
    }
}

#[test]
pub(crate) fn a_terminal_with_data_in_too_many_sync_managers_is_refused_and_the_drives_operate() {
    // More than the master keeps, and more than the controller has FMMUs.
    let most = DATA_MANAGERS_MAX as u8;
    for (managers, fmmus) in [(most + 1, most + 1), (4, 3), (most, 4)] {
        let list = vec![(Direction::Inputs, 1); managers.into()];
        let mut slaves = parse_slaves("ek1100,ax2000*4").unwrap();
        let terminal = terminal_of_managers(&list, fmmus.into(), false);
        slaves.insert(1, SlaveKind::Sii(terminal.into()));
        let mut rig = rig_of(slaves, ExchangeKind::Split);
        rig.start();
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
        let refusal = |event: &BusEvent| match event {
            BusEvent::TerminalRefused { position, error, .. } => Some((*position, *error)),
            _ => None,
        };
        let expected = BusError::SyncManagers {
            expected: fmmus.min(most),
            actual: managers,
        };
        assert_eq!(rig.log.iter().find_map(refusal), Some((1, expected)));
    }
}

/// Longest time until a terminal is back after an acknowledgement, ms.
const REPAIR_MS: u32 = 6_000;

/// When a terminal with a damaged memory loses its power for a moment.
#[derive(Clone, Copy, Debug)]
enum Interruption {
    /// While the memory is damaged: the controller cannot load its configuration.
    Damaged,
    /// Once the memory is whole: what was read of it before is not true any more.
    Whole,
    /// Both.
    Twice,
}

#[test]
pub(crate) fn a_terminal_that_lost_power_with_a_damaged_memory_comes_back_once_it_is_whole() {
    let interruptions = [Interruption::Damaged, Interruption::Whole, Interruption::Twice];
    let faults = [SiiFault::Damaged, SiiFault::Blank];
    // Cut off, it is identified again before it is repaired.
    let all = interruptions.into_iter().flat_map(|interruption| {
        let cases = faults
            .into_iter()
            .flat_map(|fault| [false, true].map(|is_cut_off| (fault, is_cut_off)));
        cases.map(move |(fault, is_cut_off)| (interruption, fault, is_cut_off))
    });
    for case in all {
        let (interruption, fault, is_cut_off) = case;
        let mut rig = rig_of(
            parse_slaves("ek1100,el1008,ax2000*4,el2004").unwrap(),
            ExchangeKind::Split,
        );
        rig.cell.inject(Fault::Sii(2, fault));
        rig.start();
        if !matches!(interruption, Interruption::Whole) {
            rig.cell.inject(Fault::Power(2, 133));
        }
        rig.wait_for(3 * BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.run_ms(20);
        rig.cell.inject(Fault::Sii(2, SiiFault::Whole));
        if !matches!(interruption, Interruption::Damaged) {
            rig.cell.inject(Fault::Power(2, 133));
        }
        rig.run_ms(300);
        if is_cut_off {
            rig.cell.inject(Fault::Cut(1));
            rig.run_ms(300);
            rig.cell.inject(Fault::Join);
            rig.run_ms(300);
        }
        rig.recover();
        rig.run_ms(REPAIR_MS);
        rig.cell.set_inputs(2, &[0x3C]);
        rig.run_ms(THROUGH_MS);
        assert_eq!(rig.input_bits(1, 0, 8), Some(0x3C), "{case:?}: {:#?}", rig.log);
        rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
        assert!(rig.set_output_bits(6, 0, 4, 0x6), "{case:?}");
        rig.run_ms(THROUGH_MS);
        assert_eq!(rig.cell.outputs(7), Some(vec![0x6]), "{case:?}");
    }
}

/// Asks for a state of a slave, by its place in the chain; whether it got there.
fn brings_to(rig: &mut Rig<'_>, slave: u8, state: state::AlState) -> bool {
    rig.ask(ServiceRequest::SetState { slave, state }).is_ok()
}

#[test]
pub(crate) fn a_terminal_whose_description_is_damaged_during_its_repair_is_refused_until_it_is_whole() {
    for attempts in [1, 2] {
        let mut rig = brought_up("ek1100,el1008,ax2000*4,el2004", ExchangeKind::Split);
        rig.cell.inject(Fault::Sii(2, SiiFault::Damaged));
        assert!(brings_to(&mut rig, 1, state::AlState::Init));
        for _ in 0..attempts {
            let from = rig.log.len();
            rig.recover();
            rig.run_ms(REPAIR_MS);
            let is_refused = |event: &BusEvent| matches!(event, BusEvent::TerminalRefused { position: 1, .. });
            assert!(rig.log[from..].iter().any(is_refused), "{:#?}", &rig.log[from..]);
        }
        assert_eq!(rig.input_bits(1, 0, 8), None);
        rig.cell.inject(Fault::Sii(2, SiiFault::Whole));
        rig.recover();
        rig.run_ms(REPAIR_MS);
        rig.cell.set_inputs(2, &[0x3C]);
        rig.run_ms(THROUGH_MS);
        assert_eq!(rig.input_bits(1, 0, 8), Some(0x3C), "{:#?}", rig.log);
        assert_eq!(rig.al_state(1), AlState::Operational);
    }
}

#[test]
pub(crate) fn a_refused_terminal_that_is_brought_to_op_by_a_request_is_read_again() {
    let mut rig = rig_of(
        parse_slaves("ek1100,el1008,ax2000*4,el2004").unwrap(),
        ExchangeKind::Split,
    );
    rig.cell.inject(Fault::Sii(2, SiiFault::Damaged));
    rig.start();
    rig.wait_for(3 * BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
    rig.run_ms(20);
    assert_eq!(rig.input_bits(1, 0, 8), None);
    rig.cell.inject(Fault::Sii(2, SiiFault::Whole));
    assert!(brings_to(&mut rig, 1, state::AlState::Operational), "{:#?}", rig.log);
    rig.cell.set_inputs(2, &[0x3C]);
    rig.run_ms(THROUGH_MS);
    assert_eq!(
        (rig.al_state(1), rig.input_bits(1, 0, 8)),
        (AlState::Operational, Some(0x3C)),
        "{:#?}",
        rig.log
    );
    // What was read is true: the terminal comes back from a power loss, too.
    rig.cell.inject(Fault::Power(2, 133));
    rig.run_ms(300);
    rig.recover();
    rig.run_ms(REPAIR_MS);
    assert_eq!(rig.input_bits(1, 0, 8), Some(0x3C), "{:#?}", rig.log);
}

#[test]
pub(crate) fn a_refused_terminal_and_its_neighbour_that_returns_first_are_not_taken_for_each_other() {
    for (list, first) in [
        ("ek1100,el1008,el2004,ax2000*4", 2),
        ("ax2000*4,ek1100,el1008,el2004", 6),
    ] {
        let mut rig = rig_of(parse_slaves(list).unwrap(), ExchangeKind::Split);
        rig.cell.inject(Fault::Sii(first, SiiFault::Damaged));
        rig.start();
        rig.wait_for(3 * BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.run_ms(20);
        rig.cell.inject(Fault::Sii(first, SiiFault::Whole));
        rig.cell.inject(Fault::Remove(first));
        rig.cell.inject(Fault::Power(first, 400));
        rig.cell.inject(Fault::Power(first + 1, 200));
        rig.run_ms(1_500);
        rig.recover();
        rig.run_ms(2 * REPAIR_MS);
        let is_other = rig.log.iter().any(|event| is_product_at(event, first, EL2004));
        assert!(!is_other, "{list}: {:#?}", rig.log);
        rig.cell.inject(Fault::Insert(first));
        rig.run_ms(1_500);
        for _ in 0..2 {
            rig.recover();
            rig.run_ms(2 * REPAIR_MS);
        }
        rig.cell.set_inputs(first, &[0x3C]);
        assert!(rig.set_output_bits(first, 0, 4, 0x6), "{list}: {:#?}", rig.log);
        rig.run_ms(THROUGH_MS);
        assert_eq!(rig.input_bits(first - 1, 0, 8), Some(0x3C), "{list}: {:#?}", rig.log);
        assert_eq!(rig.cell.outputs(first + 1), Some(vec![0x6]), "{list}");
    }
}

/// Product code of the terminal with four outputs.
const EL2004: u32 = 0x07D4_3052;

/// Whether an event tells that the slave at a place, from 1, has a product.
fn is_product_at(event: &BusEvent, slave: usize, product: u32) -> bool {
    matches!(event, BusEvent::Slave { position, identity, .. }
        if usize::from(*position) + 1 == slave && identity.product == product)
}

#[test]
pub(crate) fn a_terminal_that_was_too_slow_to_be_identified_comes_back_after_a_power_loss() {
    let mut rig = rig_of(
        parse_slaves("ek1100,el1008,ax2000*4,el2004").unwrap(),
        ExchangeKind::Split,
    );
    rig.cell.inject(Fault::Sii(2, SiiFault::Busy));
    rig.start();
    rig.wait_for(BRING_UP_MS_MAX, |event| matches!(event, BusEvent::Found { .. }));
    // The identification has given up, and the terminal has not been configured yet.
    rig.run_ms(1_300);
    rig.cell.inject(Fault::Sii(2, SiiFault::Whole));
    rig.wait_for(3 * BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
    assert!(rig.log.iter().any(|event| is_product_at(event, 2, 0)), "{:#?}", rig.log);
    rig.run_ms(20);
    rig.cell.set_inputs(2, &[0x3C]);
    rig.run_ms(THROUGH_MS);
    assert_eq!(rig.input_bits(1, 0, 8), Some(0x3C));
    rig.cell.inject(Fault::Power(2, 133));
    rig.run_ms(300);
    rig.recover();
    rig.run_ms(REPAIR_MS);
    assert_eq!(rig.input_bits(1, 0, 8), Some(0x3C), "{:#?}", rig.log);
}

#[test]
pub(crate) fn a_chain_in_which_a_named_place_may_be_another_slave_waits_for_the_missing_one() {
    // Without the coupler, the outputs would stand at the place of the inputs.
    for removed in [5, 6, 7, 2] {
        let mut rig = rig_of(
            parse_slaves("ax2000*4,ek1100,el1008,el2004").unwrap(),
            ExchangeKind::Split,
        );
        rig.setup.terminals = SlaveSet::places(&[5, 6]);
        rig.cell.inject(Fault::Remove(removed));
        rig.start();
        rig.wait_for(BRING_UP_MS_MAX, |event| matches!(event, BusEvent::Refused { .. }));
        let refused = rig.log.iter().find_map(|event| match event {
            BusEvent::Refused { error, .. } => Some(*error),
            _ => None,
        });
        let (expected, actual) = (7, 6);
        assert_eq!(
            refused,
            Some(BusError::SlaveCount { expected, actual }),
            "slave {removed}"
        );
        rig.run_ms(500);
        assert!(rig.input_bits(5, 0, 8).is_none());
        rig.cell.inject(Fault::Insert(removed));
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.run_ms(20);
        rig.cell.set_inputs(6, &[0x5A]);
        assert!(rig.set_output_bits(6, 0, 4, 0x3));
        rig.run_ms(THROUGH_MS);
        assert_eq!(
            (rig.input_bits(5, 0, 8), rig.cell.outputs(7)),
            (Some(0x5A), Some(vec![0x3]))
        );
    }
}

#[test]
pub(crate) fn outputs_become_0_when_the_bus_is_stopped_and_values_are_found_by_their_objects() {
    let mut rig = rig_of(
        parse_slaves("ek1100,el1008,el2004,ax2000*4").unwrap(),
        ExchangeKind::Split,
    );
    let wanted = |slave, direction, index, bits| WantedValue::new(slave, direction, Object::new(index, 1), bits);
    let asked = [
        wanted(1, Direction::Inputs, 0x6000, 1),
        wanted(1, Direction::Inputs, 0x6070, 1),
        wanted(2, Direction::Outputs, 0x7020, 1),
        wanted(2, Direction::Outputs, 0x7080, 1),
        wanted(2, Direction::Outputs, 0x7000, 8),
        wanted(3, Direction::Inputs, 0x6041, 16),
    ];
    rig.setup.values.extend(asked);
    rig.start();
    rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
    rig.run_ms(20);
    let found: Vec<bool> = (0..asked.len())
        .map(|number| rig.group.exchange().value::<u64>(number, &asked[number]).is_some())
        .collect();
    assert_eq!(found, [true, true, true, false, false, false]);
    for inputs in [0x00, 0x01, 0x80, 0x7E, 0x81] {
        rig.cell.set_inputs(2, &[inputs]);
        rig.run_ms(THROUGH_MS);
        let exchange = rig.group.exchange();
        let read = |number| exchange.get(&exchange.value::<bool>(number, &asked[number]).unwrap());
        assert_eq!((read(0), read(1)), (Some(inputs & 1 != 0), Some(inputs & 0x80 != 0)));
    }
    let place = rig.group.exchange().value::<bool>(2, &asked[2]).unwrap();
    assert!(rig.group.exchange_mut().set(&place, true));
    rig.run_ms(THROUGH_MS);
    assert_eq!(rig.cell.outputs(3), Some(vec![0x04]));
    assert!(
        rig.commands
            .enqueue(etherpen::ethercat::supervisor::BusCommand::Stop)
            .is_ok()
    );
    let mut last = None;
    rig.wait_for(2_000, |event| *event == BusEvent::Stopped);
    for _ in 0..10 {
        rig.millisecond();
        last = rig.cell.outputs(3);
    }
    assert_eq!(last, Some(vec![0]));
    assert!(
        !rig.group.exchange_mut().set(&place, true),
        "the place is of another plan"
    );
}

#[test]
pub(crate) fn a_drive_that_is_named_as_a_terminal_is_no_axis_wherever_it_is() {
    for named in [0, 2, 4] {
        let mut rig = rig_of(vec![SlaveKind::Ax2000; AXES + 1], ExchangeKind::Split);
        rig.setup.terminals = SlaveSet::places(&[named]);
        rig.start();
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
        let slaves = rig.cell.state().slaves;
        let enabled: Vec<bool> = slaves
            .iter()
            .map(|slave| slave.drive == CellDriveState::OperationEnabled)
            .collect();
        let expected: Vec<bool> = (0..=AXES).map(|place| place != named).collect();
        assert_eq!(enabled, expected, "the drive at place {named} is named");
        let mut members: Vec<(u8, Option<u8>)> = Vec::new();
        for event in &rig.log {
            if let BusEvent::Slave { position, member, .. } = event {
                members.retain(|(there, _)| there != position);
                members.push((*position, *member));
            }
        }
        members.sort_unstable();
        let mut axes = 0..AXES as u8;
        let expected: Vec<(u8, Option<u8>)> = (0..=AXES as u8)
            .map(|place| (place, (usize::from(place) != named).then(|| axes.next()).flatten()))
            .collect();
        assert_eq!(members, expected);
        assert_eq!(rig.al_state(named), AlState::Operational);
    }
}

#[test]
pub(crate) fn a_chain_whose_length_is_told_waits_for_a_missing_slave_that_nobody_names() {
    // Without the first EL1008, the named one would be the one behind it.
    let chain = "ek1100,el1008,el1008,el1008,ax2000*4";
    for told in [0, 8] {
        let mut rig = rig_of(parse_slaves(chain).unwrap(), ExchangeKind::Split);
        rig.setup.terminals = SlaveSet::places(&[2]);
        rig.setup.slaves = told;
        rig.cell.inject(Fault::Remove(2));
        rig.start();
        if told == 0 {
            rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
            continue;
        }
        rig.wait_for(BRING_UP_MS_MAX, |event| matches!(event, BusEvent::Refused { .. }));
        let error = BusError::SlaveCount {
            expected: told.into(),
            actual: 7,
        };
        let is_told = |event: &BusEvent| matches!(event, BusEvent::Refused { error: found, .. } if *found == error);
        assert!(rig.log.iter().any(is_told), "{:#?}", rig.log);
        rig.cell.inject(Fault::Insert(2));
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.run_ms(20);
        rig.cell.set_inputs(3, &[0x5A]);
        rig.run_ms(THROUGH_MS);
        assert_eq!(rig.input_bits(2, 0, 8), Some(0x5A));
    }
}
