//! Named inputs and outputs of terminals: stops, holds, starts, the lamp, and terminals that fail.
//!
//! What the motors and the terminals' outputs do is taken from the cell.

use crate::liveness::{acknowledge, come_back};
use crate::robot::{Robot, path};
use crate::{STILL_RAD_S, assert_described_standstill, assert_recovers_and_draws};
use etherpen::application::{Fault, InputCause, IoRefusal, Mode, Refusal};
use etherpen::board::{Interlock, Lamps};
use etherpen::config::{Config, IoDirection, IoError, IoPoint, IoRole, IoType, ObjectName, OnFault, Terminal};
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::ethercat::error::IdentityProperty;
use etherpen::messages::{Command, ConfigRefusal, IoState};
use host_tools::cell::{AlState, CellOptions, DriveState, Fault as CellFault, SlaveKind, SlaveList, parse_slaves};
use host_tools::link::text;

/// Bits of the EL1008: all contacts closed, start open.
const CLOSED: u8 = 0b0000_0111;
const DOOR: u8 = 1 << 1;
const HOLD: u8 = 1 << 2;
const START: u8 = 1 << 3;
const STOP: u8 = 1 << 0;
/// Points in the order of the configuration.
const IO_STOP: u8 = 0;
const IO_DOOR: u8 = 1;
const IO_HOLD: u8 = 2;
const IO_LAMP: u8 = 4;
const IO_VALVE: u8 = 5;
const IO_LIGHT: u8 = 6;
const IO_BYTE: u8 = 7;
/// Longest time from the contact to the drives' quick stop, ms: the cycle that reads the input, and the drive's delay.
const QUICK_STOP_MAX_MS: u32 = 6;

/// Where the terminals are in the chain.
#[derive(Clone, Copy, Debug)]
struct Chain {
    list: &'static str,
    /// Place of the EL1008, from 0; the EL2004 is behind it.
    inputs: u8,
    exchange: ExchangeKind,
}

const BEHIND: Chain = Chain {
    list: "ax2000*4,ek1100,el1008,el2004",
    inputs: 5,
    exchange: ExchangeKind::Split,
};
const BEFORE: Chain = Chain {
    list: "ek1100,el1008,el2004,ax2000*4",
    inputs: 1,
    exchange: ExchangeKind::Combined,
};

impl Chain {
    fn inputs(self) -> usize {
        usize::from(self.inputs) + 1
    }

    fn config(self) -> Config {
        let mut config = Config::default();
        config.bus.exchange = self.exchange;
        let point = |name: &str, direction, bit, role| IoPoint {
            name: name.try_into().unwrap(),
            slave: self.inputs + u8::from(direction == IoDirection::Out),
            direction,
            bit: Some(bit),
            role,
            ..IoPoint::default()
        };
        let points = [
            point("stop", IoDirection::In, 0, IoRole::EmergencyStop),
            IoPoint {
                bit: None,
                object: Some(ObjectName { index: 0x6010, sub: 1 }),
                ..point("door", IoDirection::In, 1, IoRole::Door)
            },
            point("hold", IoDirection::In, 2, IoRole::Hold),
            point("start", IoDirection::In, 3, IoRole::Start),
            point("lamp", IoDirection::Out, 0, IoRole::Lamp),
            point("valve", IoDirection::Out, 1, IoRole::None),
            IoPoint {
                on_fault: OnFault::Hold,
                bit: None,
                object: Some(ObjectName { index: 0x7020, sub: 1 }),
                ..point("light", IoDirection::Out, 2, IoRole::None)
            },
            IoPoint {
                kind: IoType::U8,
                ..point("byte", IoDirection::In, 0, IoRole::None)
            },
        ];
        config.io.extend(points);
        config
    }

    fn robot_with(self, config: &Config) -> Robot {
        let mut robot = Robot::of(
            config,
            CellOptions {
                slaves: parse_slaves(self.list).unwrap(),
                ..CellOptions::default()
            },
        );
        robot.set_inputs(self.inputs(), CLOSED);
        robot
    }

    fn robot(self) -> Robot {
        self.robot_with(&self.config())
    }

    fn drawing(self, percent: u8) -> Robot {
        let mut robot = self.robot().enabled();
        robot.command(Command::Override { percent }).unwrap();
        robot.in_a_drawing()
    }

    /// In a drawing with this override, near the highest speed that it reaches.
    fn fast(self, percent: u8) -> Robot {
        let mut trial = self.drawing(percent);
        let mut highest: f64 = 0.0;
        while trial.mode() == Mode::Drawing {
            trial.run(1);
            highest = highest.max(trial.speed_rad_s());
        }
        let mut robot = self.drawing(percent);
        robot.run_until("it is fast", |robot| robot.speed_rad_s() > 0.9 * highest);
        robot
    }
}

fn stop_input(io: u8, cause: InputCause) -> Fault {
    let role = if io == IO_STOP {
        IoRole::EmergencyStop
    } else {
        IoRole::Door
    };
    Fault::StopInput { io, role, cause }
}

impl Robot {
    fn io(&self, io: u8) -> IoState {
        self.status.as_ref().unwrap().io[usize::from(io)]
    }

    fn set(&mut self, io: u8, value: u32) -> Result<(), Refusal> {
        self.command(Command::SetOutput { io, value })
    }

    /// Milliseconds until no drive is in operation any more.
    fn brakes_after_ms(&mut self) -> u32 {
        for ms in 1..=200 {
            self.run(1);
            let slaves = self.cell().slaves;
            if slaves.iter().all(|slave| slave.drive != DriveState::OperationEnabled) {
                return ms;
            }
        }
        panic!("the drives go on");
    }
}

#[test]
pub(crate) fn an_open_stop_or_door_is_a_quick_stop_at_once_at_any_speed_and_heals() {
    for chain in [BEHIND, BEFORE] {
        for (io, contact) in [(IO_STOP, STOP), (IO_DOOR, DOOR)] {
            for percent in [10, 100, 200] {
                let mut robot = chain.fast(percent);
                let speed = robot.speed_rad_s();
                robot.set_inputs(chain.inputs(), CLOSED & !contact);
                let after_ms = robot.brakes_after_ms();
                println!("{chain:?}, io {io}, {percent} %, {speed:.2} rad/s: all drives brake after {after_ms} ms");
                assert!(after_ms <= QUICK_STOP_MAX_MS);
                let cause = stop_input(io, InputCause::Open);
                assert_described_standstill(&mut robot, |fault| *fault == cause);
                assert_eq!(robot.command(Command::Acknowledge), Err(Refusal::CauseRemains(cause)));
                let interlock = (io == IO_STOP).then_some(Interlock::Input { io });
                assert_eq!(robot.status.as_ref().unwrap().interlock, interlock);
                robot.set_inputs(chain.inputs(), CLOSED);
                robot.run(500);
                assert_eq!(robot.mode(), Mode::Fault, "a closed contact alone moves nothing");
                assert_recovers_and_draws(&mut robot);
            }
        }
    }
}

#[test]
pub(crate) fn without_power_an_open_door_keeps_it_away_and_an_open_stop_is_a_fault() {
    let mut robot = BEHIND.robot();
    robot.configure(&BEHIND.config());
    robot.wait_for(Mode::DrivesOff);
    robot.run(50);
    robot.set_inputs(BEHIND.inputs(), CLOSED & !DOOR);
    robot.run(50);
    assert_eq!((robot.mode(), robot.fault()), (Mode::DrivesOff, None));
    let open = stop_input(IO_DOOR, InputCause::Open);
    assert_eq!(robot.command(Command::Enable), Err(Refusal::CauseRemains(open)));
    robot.set_inputs(BEHIND.inputs(), CLOSED & !STOP);
    robot.wait_for(Mode::Fault);
    assert_eq!(robot.fault(), Some(stop_input(IO_STOP, InputCause::Open)));
    robot.set_inputs(BEHIND.inputs(), CLOSED);
    robot.run(50);
    assert_recovers_and_draws(&mut robot);
}

#[test]
pub(crate) fn a_lost_terminal_with_a_stop_stops_the_robot_and_comes_back_after_the_acknowledgement() {
    for fault in [CellFault::Remove(6), CellFault::Power(6, 2_000)] {
        for percent in [10, 100] {
            let mut robot = BEHIND.fast(percent);
            let speed = robot.speed_rad_s();
            robot.inject(fault);
            let after_ms = robot.brakes_after_ms();
            let limit_ms = u32::from(BEHIND.config().bus.blind_max_ms) + QUICK_STOP_MAX_MS;
            println!("{fault:?}, {percent} %, {speed:.2} rad/s: all drives brake after {after_ms} ms of {limit_ms}");
            assert!(after_ms <= limit_ms);
            assert_described_standstill(&mut robot, |fault| {
                matches!(
                    fault,
                    Fault::StopInput {
                        cause: InputCause::Missing,
                        ..
                    } | Fault::SlaveLost { slave: 5 }
                        | Fault::SlaveState { slave: 5, .. }
                )
            });
            println!("{:?}", robot.fault());
            robot.run(2_500);
            robot.inject(CellFault::Insert(6));
            robot.run(300);
            robot.set_inputs(6, CLOSED);
            assert_recovers_and_draws(&mut robot);
        }
    }
}

#[test]
pub(crate) fn a_cut_cable_names_the_slave_that_was_lost_before_the_inputs_that_depend_on_it() {
    // The cable to the terminal itself, and the one to a drive before it.
    for (slaves, lost) in [(5, 5), (1, 1)] {
        for percent in [10, 100] {
            let mut robot = BEHIND.fast(percent);
            robot.inject(CellFault::Cut(slaves));
            robot.brakes_after_ms();
            robot.wait_for(Mode::Fault);
            let fault = robot.fault().unwrap();
            assert_eq!(fault, Fault::SlaveLost { slave: lost }, "{percent} %");
            let told = text::fault_of(robot.status.as_ref().unwrap()).unwrap();
            println!("{told}");
            let first = told.find(&format!("slave {} ", lost + 1));
            let then = told.find("with it io 1, 2, 3, 4, 5, 6, 7 and 8 are missing");
            assert!(first.is_some() && first < then, "{told}");
            robot.inject(CellFault::Join);
            robot.run(300);
            robot.set_inputs(6, CLOSED);
            assert_recovers_and_draws(&mut robot);
        }
    }
}

/// An output of the EL2004 named by its object.
fn output_by_object(chain: Chain, channel: u16) -> IoPoint {
    IoPoint {
        name: "hidden".try_into().unwrap(),
        slave: chain.inputs + 1,
        direction: IoDirection::Out,
        object: Some(ObjectName {
            index: 0x7000 + 0x10 * channel,
            sub: 1,
        }),
        on_fault: OnFault::Hold,
        ..IoPoint::default()
    }
}

/// An output byte that covers all outputs of the EL2004.
fn output_byte(chain: Chain) -> IoPoint {
    IoPoint {
        kind: IoType::U8,
        bit: Some(0),
        object: None,
        ..output_by_object(chain, 0)
    }
}

#[test]
pub(crate) fn an_output_with_two_names_is_refused_with_both_and_stays_off() {
    for chain in [BEHIND, BEFORE] {
        // The valve by its bit, the lamp that the controller switches on, a byte over the light's object.
        let shares = [
            (vec![output_by_object(chain, 1)], [IO_VALVE, IO_BYTE + 1]),
            (vec![output_by_object(chain, 0)], [IO_LAMP, IO_BYTE + 1]),
            (vec![output_byte(chain)], [IO_LIGHT, IO_BYTE + 1]),
        ];
        for (further, names) in shares {
            let mut config = chain.config();
            let is_byte = further[0].kind == IoType::U8;
            config.io.extend(further);
            if is_byte {
                for io in [IO_LAMP, IO_VALVE] {
                    config.io[usize::from(io)].slave = chain.inputs;
                    config.io[usize::from(io)].direction = IoDirection::In;
                    config.io[usize::from(io)].role = IoRole::None;
                }
            }
            let mut robot = chain.robot_with(&config);
            robot.configure(&config);
            for _ in 0..3_000 {
                robot.run(1);
                let outputs = robot.outputs(chain.inputs() + 1);
                assert_eq!(outputs, 0, "nobody sets an output with two names: {names:?}");
            }
            assert_eq!(robot.mode(), Mode::Fault, "{names:?}");
            let told = text::fault(&robot.fault().unwrap());
            println!("{told}");
            let both = names.map(|io| format!("io {}", io + 1));
            assert!(both.iter().all(|name| told.contains(name)), "{told}");
            let again = acknowledge(&mut robot).map(|fault| text::fault(&fault));
            assert_eq!(again, Some(told), "it stays refused");
            assert_eq!(robot.outputs(chain.inputs() + 1), 0);
            robot.configure(&chain.config());
            assert!(robot.configured.last().is_some_and(Result::is_ok));
            robot.wait_for(Mode::DrivesOff);
            assert_eq!(come_back(&mut robot, 0), 0);
        }
    }
}

#[test]
pub(crate) fn a_terminal_that_stays_lost_refuses_the_acknowledgement_with_its_name() {
    let mut robot = BEHIND.robot().enabled().in_a_drawing();
    robot.inject(CellFault::Remove(6));
    robot.wait_for(Mode::Fault);
    robot.command(Command::Acknowledge).unwrap();
    robot.run(15_000);
    assert_eq!(robot.mode(), Mode::Fault);
    println!("{:?}", robot.fault());
    robot.inject(CellFault::Insert(6));
    robot.run(300);
    robot.set_inputs(6, CLOSED);
    assert_recovers_and_draws(&mut robot);
}

#[test]
pub(crate) fn a_terminal_without_a_stop_is_reported_and_disturbs_no_drawing() {
    for fault in [CellFault::Remove(7), CellFault::Power(7, 1_000)] {
        let mut robot = BEHIND.robot().enabled();
        robot.set(IO_VALVE, 1).unwrap();
        robot = robot.in_a_drawing();
        assert!(robot.io(IO_VALVE).valid && robot.outputs(7) & 2 != 0);
        robot.inject(fault);
        robot.run(200);
        assert_eq!((robot.mode(), robot.fault()), (Mode::Drawing, None), "{fault:?}");
        assert!(!robot.io(IO_VALVE).valid && robot.io(IO_STOP).valid, "{fault:?}");
        let missing = Refusal::Io {
            io: IO_VALVE,
            reason: IoRefusal::Missing,
        };
        assert_eq!(robot.set(IO_VALVE, 1), Err(missing));
        robot.run_until("the path is executed", Robot::has_drawn);
        robot.inject(CellFault::Insert(7));
        robot.run(1_300);
        assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None), "{fault:?}");
        robot.command(Command::Acknowledge).unwrap();
        robot.run_until("the output is back", |robot| robot.io(IO_VALVE).valid);
        robot.run(50);
        assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None), "{fault:?}");
        assert_eq!(robot.outputs(7) & 2, 0, "{fault:?}: an output that was away is off");
        robot.set(IO_VALVE, 1).unwrap();
        robot.run(5);
        assert_eq!(robot.outputs(7) & 2, 2, "{fault:?}");
        robot.draw(path());
        robot.run_until("the path is executed", Robot::has_drawn);
    }
}

#[test]
pub(crate) fn a_spare_drive_as_a_terminal_shows_its_objects_and_disturbs_no_drawing_in_any_state() {
    let mut config = Config::default();
    let word = IoPoint {
        name: "spare".try_into().unwrap(),
        slave: 4,
        object: Some(ObjectName { index: 0x6041, sub: 0 }),
        kind: IoType::U16,
        ..IoPoint::default()
    };
    config.io.push(word).unwrap();
    for state in [AlState::SafeOperational, AlState::PreOperational, AlState::Init] {
        let options = CellOptions {
            slaves: vec![SlaveKind::Ax2000; 5],
            ..CellOptions::default()
        };
        let mut robot = Robot::of(&config, options).enabled().in_a_drawing();
        let shown = robot.io(0);
        println!("status word {:#06x}", shown.raw);
        assert!(shown.valid && shown.raw & 0x6F == 0x40, "switch-on disabled: {shown:?}");
        robot.inject(CellFault::Fall(5, state, 0x1B));
        robot.run(300);
        assert_eq!(
            (robot.mode(), robot.fault(), robot.io(0).valid),
            (Mode::Drawing, None, false),
            "{state:?}"
        );
        robot.run_until("the path is executed", Robot::has_drawn);
        robot.command(Command::Acknowledge).unwrap();
        robot.run_until("the terminal is back", |robot| robot.io(0).valid);
        assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None), "{state:?}");
        // A drive that is needed and leaves OP still stops all.
        robot.draw(path());
        robot.run_until("the pen moves", |robot| robot.speed_rad_s() > 0.2);
        robot.inject(CellFault::Fall(2, state, 0x1B));
        let after_ms = robot.brakes_after_ms();
        println!("a needed drive in {state:?}: all brake after {after_ms} ms");
        assert!(after_ms <= 60);
        assert_described_standstill(&mut robot, |fault| {
            matches!(
                fault,
                Fault::SlaveState { .. } | Fault::SlaveLost { .. } | Fault::Drive { .. }
            )
        });
    }
}

#[test]
pub(crate) fn a_drive_behind_terminals_is_named_by_its_place() {
    let mut robot = BEFORE.robot().enabled().in_a_drawing();
    robot.inject(CellFault::Remove(5));
    assert_described_standstill(&mut robot, |fault| matches!(fault, Fault::SlaveLost { slave: 4 }));
    let words: Vec<bool> = robot
        .status
        .as_ref()
        .unwrap()
        .slaves
        .iter()
        .map(|slave| slave.status_word != 0)
        .collect();
    assert_eq!(words, [false, false, false, true, true, true, true]);
}

#[test]
pub(crate) fn outputs_are_set_when_the_mode_allows_and_fall_to_their_safe_state_at_a_fault() {
    let mut robot = BEHIND.robot();
    robot.configure(&BEHIND.config());
    assert!(matches!(
        robot.set(IO_VALVE, 1),
        Err(Refusal::NotInMode(Mode::BusConfiguring))
    ));
    robot.wait_for(Mode::DrivesOff);
    robot.run(50);
    let refused = |io, reason| Err(Refusal::Io { io, reason });
    assert_eq!(robot.set(IO_STOP, 1), refused(IO_STOP, IoRefusal::IsInput));
    assert_eq!(robot.set(IO_LAMP, 1), refused(IO_LAMP, IoRefusal::IsOwn));
    assert_eq!(robot.set(8, 1), refused(8, IoRefusal::Unknown));
    let range = IoRefusal::Range { expected: 1, actual: 2 };
    assert_eq!(robot.set(IO_VALVE, 2), refused(IO_VALVE, range));
    assert_eq!(robot.outputs(7) & 6, 0, "refused requests change nothing");
    robot.set(IO_VALVE, 1).unwrap();
    robot.set(IO_LIGHT, 1).unwrap();
    robot.run(60);
    assert_eq!(robot.outputs(7) & 6, 6);
    assert_eq!((robot.io(IO_VALVE).raw, robot.io(IO_LIGHT).raw), (1, 1));
    robot.set_inputs(6, 0xA5 & !DOOR | CLOSED);
    robot.run(60);
    assert_eq!(robot.io(IO_BYTE), IoState { raw: 0xA7, valid: true });
    robot.set_inputs(6, CLOSED);
    robot.command(Command::Home).unwrap();
    robot.run(100);
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Idle);
    robot = robot.in_a_drawing();
    assert_eq!(robot.outputs(7) & 6, 6, "they are kept in every mode");
    robot.set_inputs(6, CLOSED & !STOP);
    robot.run(3);
    assert_eq!(robot.outputs(7) & 6, 4, "off at the fault, the light keeps its value");
    robot.wait_for(Mode::Fault);
    assert_eq!(robot.set(IO_VALVE, 1), Err(Refusal::NotInMode(Mode::Fault)));
    robot.set_inputs(6, CLOSED);
    robot.run(20);
    assert_recovers_and_draws(&mut robot);
    assert_eq!(robot.outputs(7) & 6, 4, "what went off stays off until it is set again");
    robot.set(IO_VALVE, 1).unwrap();
    robot.run(5);
    assert_eq!(robot.outputs(7) & 6, 6);
}

#[test]
pub(crate) fn a_stop_over_the_link_and_a_lost_drive_switch_the_outputs_off_too() {
    for lost in [false, true] {
        let mut robot = BEHIND.robot().enabled();
        robot.set(IO_VALVE, 1).unwrap();
        robot.set(IO_LIGHT, 1).unwrap();
        robot.run(10);
        assert_eq!(robot.outputs(7) & 6, 6);
        match lost {
            true => robot.inject(CellFault::Drive(2, 0x2310)),
            false => robot.command(Command::Stop).unwrap(),
        }
        robot.run(40);
        assert_eq!(robot.outputs(7) & 6, 4, "lost: {lost}");
        robot.wait_for(Mode::Fault);
        assert_recovers_and_draws(&mut robot);
        assert_eq!(robot.outputs(7) & 6, 4, "lost: {lost}");
    }
}

#[test]
pub(crate) fn an_open_hold_holds_the_drawing_and_start_resumes_it() {
    let mut robot = BEHIND.robot().enabled().in_a_drawing();
    robot.set_inputs(6, CLOSED & !HOLD);
    robot.wait_for(Mode::Holding);
    robot.run(1_000);
    assert!(robot.speed_rad_s() < STILL_RAD_S);
    let holds = Refusal::Io {
        io: IO_HOLD,
        reason: IoRefusal::Holds,
    };
    assert_eq!(robot.command(Command::Resume), Err(holds));
    robot.set_inputs(6, CLOSED & !HOLD | START);
    robot.run(300);
    assert_eq!(robot.mode(), Mode::Holding, "start does nothing while hold is open");
    robot.set_inputs(6, CLOSED | START);
    robot.run(300);
    assert_eq!(robot.mode(), Mode::Holding, "a start that stays closed is no start");
    robot.set_inputs(6, CLOSED);
    robot.run(300);
    assert_eq!(robot.mode(), Mode::Holding);
    robot.set_inputs(6, CLOSED | START);
    robot.run_until("it draws", |robot| robot.mode() == Mode::Drawing);
    robot.run_until("the path is executed", Robot::has_drawn);
    // A lost terminal is an open contact.
    assert_eq!(robot.fault(), None);
}

#[test]
pub(crate) fn start_switches_the_drives_on_only_when_it_closes() {
    let mut robot = BEHIND.robot();
    robot.set_inputs(6, CLOSED | START);
    robot.configure(&BEHIND.config());
    robot.wait_for(Mode::DrivesOff);
    robot.run(1_000);
    assert_eq!(robot.mode(), Mode::DrivesOff, "it was closed from the beginning");
    robot.set_inputs(6, CLOSED);
    robot.run(100);
    robot.set_inputs(6, CLOSED | START);
    robot.wait_for(Mode::Unreferenced);
    robot.set_inputs(6, CLOSED);
    robot.command(Command::Home).unwrap();
    robot.wait_for(Mode::Idle);
    assert_eq!(robot.fault(), None);
}

#[test]
pub(crate) fn the_lamp_shows_every_mode() {
    let mut robot = BEHIND.robot();
    robot.configure(&BEHIND.config());
    robot.wait_for(Mode::DrivesOff);
    robot.run(100);
    let lit = |robot: &mut Robot| {
        let mut lit = 0;
        let mut changes = 0;
        let mut before = robot.outputs(7) & 1;
        for _ in 0..2_000 {
            robot.run(1);
            let now = robot.outputs(7) & 1;
            lit += u32::from(now);
            changes += u32::from(now != before);
            before = now;
        }
        (lit, changes)
    };
    let (on, changes) = lit(&mut robot);
    assert!(
        (980..=1_020).contains(&on) && (3..=5).contains(&changes),
        "slowly: {on} {changes}"
    );
    robot.command(Command::Home).unwrap();
    robot.run(100);
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Idle);
    robot.run(10);
    assert_eq!(lit(&mut robot), (2_000, 0), "on");
    robot.set_inputs(6, CLOSED & !STOP);
    robot.wait_for(Mode::Fault);
    let (on, changes) = lit(&mut robot);
    assert!(
        (380..=420).contains(&on) && (7..=9).contains(&changes),
        "flashes: {on} {changes}"
    );
    assert!(Lamps::single(Mode::Idle, 0) && !Lamps::single(Mode::Startup, 0));
}

#[test]
pub(crate) fn a_configuration_with_a_wrong_point_is_refused_with_its_reason() {
    let mut config = BEHIND.config();
    config.io[3].name = config.io[1].name.clone();
    let mut robot = BEHIND.robot();
    robot.configure(&config);
    let (first, second) = (1, 3);
    let refused = ConfigRefusal::Io(IoError::SameName { first, second });
    assert_eq!(robot.configured.last(), Some(&Err(refused)));
    let (one, mut other) = (BEHIND.config(), BEHIND.config());
    other.io[5].bit = Some(3);
    assert_ne!(one.hash(), other.hash());
}

/// A chain whose two input terminals are told apart by their aliases, and its configuration.
fn two_input_terminals() -> (Config, CellOptions) {
    let mut config = BEHIND.config();
    config
        .terminals
        .extend([(5, 21), (7, 22)].map(|(slave, alias)| Terminal {
            slave,
            alias,
            vendor: 2,
            ..Terminal::default()
        }));
    let list: SlaveList = "ax2000*4,ek1100,el1008@alias=21,el2004,el1008@alias=22"
        .parse()
        .unwrap();
    let options = CellOptions {
        slaves: list.slaves,
        places: list.places,
        ..CellOptions::default()
    };
    (config, options)
}

#[test]
pub(crate) fn terminals_at_each_others_places_are_refused_with_both_and_draw_when_they_are_put_back() {
    let exchanged = CellFault::Recable(6, 8);
    for at_bring_up in [true, false] {
        let (config, options) = two_input_terminals();
        let mut robot = Robot::of(&config, options);
        robot.set_inputs(6, CLOSED);
        if at_bring_up {
            robot.inject(exchanged);
            robot.run(5);
            robot.configure(&config);
        } else {
            robot = robot.enabled().in_a_drawing();
            robot.inject(CellFault::Power(6, 1_500));
            robot.inject(CellFault::Power(8, 1_500));
            robot.run(500);
            robot.inject(exchanged);
            robot.run(1_500);
        }
        // The contacts that are wired to the other terminal are closed: only its alias tells that it is the wrong one.
        robot.set_inputs(6, CLOSED);
        robot.set_inputs(8, CLOSED);
        robot.wait_for(Mode::Fault);
        robot.run(1_000);
        assert!(robot.speed_rad_s() < STILL_RAD_S);
        let before = robot.cell().joints;
        for fault in [robot.fault(), acknowledge(&mut robot)]
            .into_iter()
            .skip(usize::from(!at_bring_up))
        {
            let told = fault.as_ref().map(text::fault).unwrap_or_default();
            println!("{told}");
            let Some(Fault::WrongSlave {
                slave, property, other, ..
            }) = fault
            else {
                panic!("at bring-up {at_bring_up}: {fault:?}");
            };
            assert_eq!((slave, property, other), (5, IdentityProperty::Alias, Some(7)));
            assert!(told.contains("slave 6 ") && told.contains("slave 8"), "{told}");
        }
        assert_eq!(robot.command(Command::Enable), Err(Refusal::NotInMode(Mode::Fault)));
        assert_eq!(robot.cell().joints, before, "a motor has moved");
        assert!(!robot.io(IO_STOP).valid, "its inputs are missing");
        robot.inject(CellFault::Power(6, 300));
        robot.inject(CellFault::Power(8, 300));
        robot.run(100);
        robot.inject(exchanged);
        robot.run(600);
        robot.set_inputs(6, CLOSED);
        robot.set_inputs(8, CLOSED);
        robot.run(100);
        assert_recovers_and_draws(&mut robot);
    }
}

#[test]
pub(crate) fn a_terminal_of_another_product_than_expected_is_refused_and_the_right_one_is_taken_in_its_place() {
    let mut config = BEHIND.config();
    let expected = Terminal {
        slave: 5,
        vendor: 2,
        product: 0x03F0_3052,
        ..Terminal::default()
    };
    config.terminals.push(expected).unwrap();
    let mut robot = Robot::of(
        &config,
        CellOptions {
            slaves: parse_slaves("ax2000*4,ek1100,el2004,el1008").unwrap(),
            ..CellOptions::default()
        },
    );
    robot.configure(&config);
    robot.wait_for(Mode::Fault);
    assert!(
        matches!(
            robot.fault(),
            Some(Fault::WrongSlave {
                slave: 5,
                property: IdentityProperty::Product,
                other: Some(6),
                ..
            })
        ),
        "{:?}",
        robot.fault()
    );
    for slave in [6, 7] {
        robot.inject(CellFault::Power(slave, 300));
    }
    robot.run(100);
    robot.inject(CellFault::Recable(6, 7));
    robot.run(500);
    // The cell names the terminals by their present places.
    robot.set_inputs(6, CLOSED);
    robot.run(100);
    assert_recovers_and_draws(&mut robot);
}
