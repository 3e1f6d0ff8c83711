//! Slaves that no member needs, or that leave their state by themselves, while the bus is brought up.

use crate::rig::{Rig, idle_rig_of};
use etherpen::board::PortState;
use etherpen::ethercat::configure::Direction;
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::event::Step;
use etherpen::ethercat::slave_set::SlaveSet;
use etherpen::ethercat::supervisor::{BusCommand, BusEvent};
use etherpen::robots::AXES;
use host_tools::cell::{AlState, CellOptions, Fault, SlaveList};

/// Longest bring-up with all that happens here, ms.
const BRING_UP_MS_MAX: u64 = 10_000;
/// Moments of a bring-up at which something happens.
const MOMENTS: u64 = 60;

fn rig_of(list: &str, terminals: SlaveSet) -> Rig<'static> {
    let list: SlaveList = list.parse().expect("a list");
    let mut rig = idle_rig_of(CellOptions {
        slaves: list.slaves,
        places: list.places,
        ..CellOptions::default()
    });
    rig.setup.terminals = terminals;
    rig
}

impl Rig<'_> {
    fn started(mut self) -> Self {
        self.start();
        self
    }

    fn al_state_of(&self, slave: usize) -> AlState {
        self.cell.state().slaves[slave].al_state
    }

    fn refusals(&self) -> Vec<(Option<u8>, Step, BusError)> {
        let refused = self.log.iter().filter_map(|event| match event {
            BusEvent::Refused { position, step, error } => Some((*position, *step, *error)),
            _ => None,
        });
        refused.collect()
    }

    /// All drives are in OP, and their inputs arrive.
    fn assert_drives_operate(&mut self, what: &str) {
        self.run_ms(20);
        for drive in 0..AXES {
            assert_eq!(self.al_state_of(drive), AlState::Operational, "drive {drive}, {what}");
        }
        assert!(self.inputs.iter().all(Option::is_some), "{what}: {:#?}", self.log);
    }
}

/// Time of an undisturbed bring-up, ms.
fn undisturbed_ms(list: &str, terminals: SlaveSet) -> u64 {
    rig_of(list, terminals).started().operational()
}

#[test]
pub(crate) fn an_unused_slave_with_an_error_keeps_no_drive_from_operation() {
    const CHAIN: &str = "ax2000*4,cia402@name=other";
    let whole_ms = undisturbed_ms(CHAIN, SlaveSet::NONE);
    for moment in 0..MOMENTS {
        let at_ms = whole_ms * moment / MOMENTS;
        let mut rig = rig_of(CHAIN, SlaveSet::NONE).started();
        rig.run_ms(at_ms as u32);
        rig.cell.inject(Fault::Fall(AXES + 1, AlState::Init, 0x0060));
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        assert_eq!(rig.refusals(), [], "at {at_ms} ms");
        rig.assert_drives_operate(&format!("at {at_ms} of {whole_ms} ms"));
    }
}

#[test]
pub(crate) fn a_terminal_that_falls_during_the_bring_up_is_named_alone_and_comes_back() {
    const CHAIN: &str = "ax2000*4,el1008,cia402@name=other,el2004";
    const TERMINAL: usize = AXES + 1;
    let whole_ms = undisturbed_ms(CHAIN, SlaveSet::ALL);
    let mut named = 0;
    for moment in 0..MOMENTS {
        let at_ms = whole_ms * moment / MOMENTS;
        let mut rig = rig_of(CHAIN, SlaveSet::ALL).started();
        rig.run_ms(at_ms as u32);
        rig.cell.inject(Fault::Fall(TERMINAL + 1, AlState::Init, 0x0060));
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        assert_eq!(rig.refusals(), [], "at {at_ms} ms");
        rig.assert_drives_operate(&format!("at {at_ms} of {whole_ms} ms"));
        for neighbour in [TERMINAL - 1, TERMINAL + 1] {
            assert_eq!(rig.al_state_of(neighbour), AlState::Operational, "at {at_ms} ms");
        }
        if rig.al_state_of(TERMINAL) == AlState::Operational {
            continue;
        }
        named += 1;
        let is_named = |event: &BusEvent| {
            let position = match event {
                BusEvent::TerminalRefused { position, .. } | BusEvent::SlaveLeft { position, .. } => *position,
                _ => return false,
            };
            usize::from(position) == TERMINAL
        };
        assert!(rig.log.iter().any(is_named), "at {at_ms} ms: {:#?}", rig.log);
        rig.recover();
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        let state = rig.al_state_of(TERMINAL);
        assert_eq!(state, AlState::Operational, "at {at_ms} ms: {:#?}", rig.log);
    }
    assert!(named > 0, "the terminal has to be out of OP at least once");
}

#[test]
pub(crate) fn a_terminal_that_loses_its_power_during_the_bring_up_keeps_no_drive_from_operation() {
    const CHAIN: &str = "ax2000*4,el1008,cia402@name=other,el2004";
    const TERMINAL: usize = AXES + 1;
    let whole_ms = undisturbed_ms(CHAIN, SlaveSet::ALL);
    for (moment, off_ms) in (0..MOMENTS).flat_map(|moment| [(moment, 60), (moment, 400)]) {
        let at_ms = whole_ms * moment / MOMENTS;
        let what = format!("off for {off_ms} ms at {at_ms} of {whole_ms} ms");
        let mut rig = rig_of(CHAIN, SlaveSet::ALL);
        // Without it, a chain that ends before the terminal is taken as it is.
        rig.setup.slaves = TERMINAL as u8 + 2;
        let mut rig = rig.started();
        rig.run_ms(at_ms as u32);
        rig.cell.inject(Fault::Power(TERMINAL + 1, off_ms));
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.assert_drives_operate(&what);
        // While the slaves are being found and their clocks are set, a change of the chain begins it anew.
        let is_later = |step: &Step| {
            !matches!(
                step,
                Step::Discover | Step::Reset | Step::Address | Step::Identify | Step::Clocks
            )
        };
        let refusals = rig.refusals();
        assert!(
            !refusals.iter().any(|(_, step, _)| is_later(step)),
            "{what}: {refusals:?}"
        );
        rig.run_ms(1_000);
        if rig.al_state_of(TERMINAL) != AlState::Operational {
            rig.recover();
            rig.operational();
        }
        assert_eq!(rig.al_state_of(TERMINAL), AlState::Operational, "{what}");
        rig.assert_drives_operate(&what);
    }
}

#[test]
pub(crate) fn a_drive_that_leaves_its_state_during_the_bring_up_is_named_and_the_next_try_comes_unasked() {
    const DRIVE: usize = 1;
    let whole_ms = undisturbed_ms("ax2000*4", SlaveSet::NONE);
    let mut named = 0;
    for moment in 0..MOMENTS {
        let at_ms = whole_ms * moment / MOMENTS;
        let to = [AlState::SafeOperational, AlState::PreOperational, AlState::Init][moment as usize % 3];
        let mut rig = rig_of("ax2000*4", SlaveSet::NONE).started();
        rig.run_ms(at_ms as u32);
        rig.cell.inject(Fault::Fall(DRIVE + 1, to, 0x001A));
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        for (position, step, error) in rig.refusals() {
            assert_eq!(position, Some(DRIVE as u8), "at {at_ms} ms: {step:?}, {error:?}");
            // A step that has just acknowledged the error flag leaves only the state to be seen, or asks for one that cannot
            // follow (0x0011).
            assert!(
                matches!(
                    error,
                    BusError::State {
                        code: 0x001A | 0x0011 | 0,
                        ..
                    }
                ),
                "{to:?} at {at_ms} ms: {step:?}, {error:?}"
            );
            named += u64::from(error.code() == 0x001A);
        }
        rig.run_ms(150);
        if rig.al_state_of(DRIVE) != AlState::Operational {
            // It fell when it was in OP already.
            let has_left =
                |event: &BusEvent| matches!(event, BusEvent::SlaveLeft { position, .. } if *position == DRIVE as u8);
            assert!(rig.log.iter().any(has_left), "at {at_ms} ms: {:#?}", rig.log);
            rig.recover();
            rig.operational();
        }
        rig.assert_drives_operate(&format!("at {at_ms} of {whole_ms} ms"));
    }
    assert!(named > 0, "the drive has to end the bring-up at least once");
}

#[test]
pub(crate) fn the_drives_exchange_data_soon_after_safeop_and_operate_before_a_terminal_is_configured() {
    const CHAIN: &str = "ax2000,el1008,ax2000*3,el2004@boot=3000,cia402@boot=3000";
    const DRIVES: [usize; AXES] = [0, 2, 3, 4];
    const LAST: usize = AXES + 2;
    // Longest time from SAFEOP to the first process data, ms.
    const SOON_MS: u32 = 10;
    for exchange in [ExchangeKind::Split, ExchangeKind::Combined] {
        let mut rig = rig_of(CHAIN, SlaveSet::ALL);
        rig.setup.exchange = exchange;
        let mut rig = rig.started();
        let (mut without_ms, mut operating) = ([0; AXES], false);
        for _ in 0..BRING_UP_MS_MAX {
            if rig.millisecond().contains(&BusEvent::Operational) {
                break;
            }
            for (drive, without_ms) in DRIVES.iter().zip(&mut without_ms) {
                let bits = rig.group.exchange().bits::<u64>(*drive, Direction::Inputs, 0, 8);
                let is_waiting = rig.al_state_of(*drive) == AlState::SafeOperational && bits.is_none();
                *without_ms = if is_waiting { *without_ms + 1 } else { 0 };
                assert!(*without_ms <= SOON_MS, "drive {drive}, {exchange:?}");
            }
            operating = DRIVES
                .iter()
                .all(|drive| rig.al_state_of(*drive) == AlState::Operational);
            let is_configured = |slave: &usize| rig.al_state_of(*slave) > AlState::PreOperational;
            let terminal = [1, LAST - 1, LAST].into_iter().find(is_configured);
            assert!(
                operating || terminal.is_none(),
                "{terminal:?} comes first, {exchange:?}"
            );
            let shares = &rig.group.exchange().plan().slaves;
            let are_watched = DRIVES
                .iter()
                .all(|drive| shares.get(*drive).is_some_and(|share| share.watched));
            assert!(are_watched || terminal.is_none(), "{terminal:?}, {exchange:?}");
        }
        assert!(
            operating && rig.al_state_of(LAST) == AlState::Operational,
            "{:#?}",
            rig.log
        );
    }
}

#[test]
pub(crate) fn a_terminal_that_lost_its_power_is_told_when_it_is_back() {
    let mut rig = rig_of("ax2000*4,el1008,el2004", SlaveSet::ALL).started();
    rig.operational();
    rig.run_ms(50);
    rig.cell.inject(Fault::Power(AXES + 2, 1_500));
    rig.wait_for(100, |event| {
        *event
            == BusEvent::SlaveLost {
                position: AXES as u8 + 1,
            }
    });
    // A command that comes too early brings nothing back, and hides nothing.
    rig.recover();
    let returned = BusEvent::Returned {
        position: AXES as u8 + 1,
    };
    rig.wait_for(3_000, |event| *event == returned);
    assert!(rig.al_state_of(AXES + 1) != AlState::Operational);
    rig.recover();
    rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
    assert_eq!(rig.al_state_of(AXES + 1), AlState::Operational);
    rig.assert_drives_operate("with the terminal back");
}

#[test]
pub(crate) fn two_equal_terminals_that_lost_their_power_are_both_told_when_they_are_back() {
    const LOST: [usize; 2] = [AXES, AXES + 1];
    for (first_ms, second_ms) in [(1_500, 1_500), (1_000, 2_500), (2_500, 1_000)] {
        let mut rig = rig_of("ax2000*4,el2004,el2004,el1008", SlaveSet::ALL).started();
        rig.operational();
        rig.run_ms(50);
        for (place, off_ms) in LOST.into_iter().zip([first_ms, second_ms]) {
            rig.cell.inject(Fault::Power(place + 1, off_ms));
        }
        // A cut chain hides the terminals behind the cut: nothing is told of them before both have their power again.
        for position in LOST.map(|place| place as u8) {
            rig.wait_for(4_000, |event| *event == BusEvent::Returned { position });
        }
        rig.recover();
        rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        for place in LOST {
            assert_eq!(
                rig.al_state_of(place),
                AlState::Operational,
                "{place}, {first_ms} {second_ms}"
            );
        }
        rig.assert_drives_operate("with both terminals back");
    }
}

/// Drives in OP beside a terminal that is still starting up, and an unused slave with an error.
fn while_a_terminal_starts_up() -> Rig<'static> {
    const OTHER: usize = AXES;
    let mut rig = rig_of("ax2000*4,cia402,cia402@boot=4000", SlaveSet::of(AXES + 1)).started();
    rig.run_ms(30);
    rig.cell.inject(Fault::Fall(OTHER + 1, AlState::Init, 0x0060));
    for _ in 0..BRING_UP_MS_MAX {
        rig.millisecond();
        if (0..AXES).all(|drive| rig.al_state_of(drive) == AlState::Operational) {
            rig.run_ms(50);
            assert!(
                !rig.log.contains(&BusEvent::Operational),
                "the terminal is still awaited"
            );
            return rig;
        }
    }
    panic!("{:#?}", rig.log);
}

#[test]
pub(crate) fn a_stop_while_a_terminal_starts_up_takes_the_drives_out_of_operation() {
    let mut rig = while_a_terminal_starts_up();
    assert!(rig.commands.enqueue(BusCommand::Stop).is_ok());
    rig.wait_for(1_000, |event| *event == BusEvent::Stopped);
    for drive in 0..AXES {
        assert_eq!(rig.al_state_of(drive), AlState::Init, "drive {drive}");
    }
    rig.start();
    rig.operational();
    rig.assert_drives_operate("started again");
}

#[test]
pub(crate) fn a_stop_at_any_moment_of_the_bring_up_leaves_no_drive_in_operation() {
    let whole_ms = undisturbed_ms("ax2000*4", SlaveSet::NONE);
    for at_ms in 0..whole_ms {
        let mut rig = rig_of("ax2000*4", SlaveSet::NONE).started();
        rig.run_ms(at_ms as u32);
        assert!(rig.commands.enqueue(BusCommand::Stop).is_ok());
        rig.wait_for(1_000, |event| *event == BusEvent::Stopped);
        rig.run_ms(100);
        for drive in 0..AXES {
            assert_ne!(
                rig.al_state_of(drive),
                AlState::Operational,
                "drive {drive}, {at_ms} ms"
            );
        }
    }
}

#[test]
pub(crate) fn a_drive_that_is_lost_for_good_during_the_bring_up_leaves_no_other_in_operation() {
    let whole_ms = undisturbed_ms("ax2000*4", SlaveSet::NONE);
    for moment in 0..MOMENTS {
        let at_ms = whole_ms * moment / MOMENTS;
        let mut rig = rig_of("ax2000*4", SlaveSet::NONE).started();
        rig.run_ms(at_ms as u32);
        rig.cell.inject(Fault::Power(AXES, 60_000));
        rig.run_ms(1_500);
        assert!(!rig.log.contains(&BusEvent::Operational), "{at_ms} ms: {:#?}", rig.log);
        for drive in 0..AXES - 1 {
            assert_ne!(
                rig.al_state_of(drive),
                AlState::Operational,
                "drive {drive}, {at_ms} ms"
            );
        }
    }
}

#[test]
pub(crate) fn a_link_that_is_away_for_a_moment_during_the_bring_up_costs_nothing_for_ever() {
    let whole_ms = undisturbed_ms("ax2000*4", SlaveSet::NONE);
    for (moment, away_ms) in (0..MOMENTS).flat_map(|moment| [(moment, 8), (moment, 150)]) {
        let at_ms = whole_ms * moment / MOMENTS;
        let mut rig = rig_of("ax2000*4", SlaveSet::NONE).started();
        rig.run_ms(at_ms as u32);
        assert!(rig.commands.enqueue(BusCommand::Port(PortState::Down)).is_ok());
        rig.cell.inject(Fault::Stall(away_ms));
        rig.run_ms(away_ms as u32);
        assert!(rig.commands.enqueue(BusCommand::Port(PortState::Up)).is_ok());
        let has_come = |rig: &Rig| rig.log.contains(&BusEvent::Operational);
        if !has_come(&rig) {
            rig.wait_for(2 * BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        }
        rig.run_ms(50);
        rig.assert_drives_operate(&format!("{away_ms} ms away at {at_ms} ms"));
    }
}

#[test]
pub(crate) fn a_loose_contact_of_an_unused_slave_takes_no_drive_out_of_operation() {
    let mut rig = while_a_terminal_starts_up();
    for _ in 0..20 {
        // It is the last of the chain but one: the terminal behind it goes and comes with it.
        rig.cell.inject(Fault::Power(AXES + 1, 60));
        rig.run_ms(120);
        rig.assert_drives_operate("with a loose contact behind them");
    }
    assert_eq!(rig.refusals(), []);
    assert!(rig.log.contains(&BusEvent::Operational), "{:#?}", rig.log);
    rig.run_ms(4_000);
    rig.recover();
    rig.wait_for(2 * BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
    assert_eq!(rig.al_state_of(AXES + 1), AlState::Operational);
    rig.assert_drives_operate("after a loose contact");
}

#[test]
pub(crate) fn a_new_setup_while_a_terminal_starts_up_begins_in_init() {
    let mut rig = while_a_terminal_starts_up();
    rig.start();
    let is_found = |event: &BusEvent| matches!(event, BusEvent::Found { .. });
    rig.wait_for(1_000, is_found);
    for drive in 0..AXES {
        assert_eq!(rig.al_state_of(drive), AlState::Init, "drive {drive}");
    }
    rig.operational();
    rig.assert_drives_operate("started again");
}

#[test]
pub(crate) fn a_drive_that_falls_while_a_terminal_starts_up_is_named_and_all_begin_anew() {
    const DRIVE: usize = 1;
    for to in [AlState::SafeOperational, AlState::PreOperational, AlState::Init] {
        let mut rig = while_a_terminal_starts_up();
        rig.cell.inject(Fault::Fall(DRIVE + 1, to, 0x001B));
        let is_named = |event: &BusEvent| matches!(event, BusEvent::Refused { position: Some(place), step: Step::Watch, .. } if *place == DRIVE as u8);
        rig.wait_for(BRING_UP_MS_MAX, is_named);
        rig.run_ms(500);
        for drive in 0..AXES {
            assert_ne!(rig.al_state_of(drive), AlState::Operational, "drive {drive}, {to:?}");
        }
        rig.wait_for(2 * BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.assert_drives_operate(&format!("{to:?}"));
    }
}

#[test]
pub(crate) fn a_drive_that_is_lost_while_a_terminal_starts_up_comes_back_unasked() {
    for off_ms in [60, 2_000] {
        let mut rig = while_a_terminal_starts_up();
        rig.cell.inject(Fault::Power(AXES, off_ms));
        let is_named = |event: &BusEvent| matches!(event, BusEvent::Refused { position: Some(place), step: Step::Watch, .. } if usize::from(*place) == AXES - 1);
        rig.wait_for(1_000, is_named);
        rig.wait_for(2 * BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
        rig.assert_drives_operate(&format!("off for {off_ms} ms"));
    }
}
