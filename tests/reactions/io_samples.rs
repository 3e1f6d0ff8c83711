//! The named inputs and outputs in the samples of each millisecond, against the terminals of the cell.

use crate::robot::Robot;
use etherpen::application::Mode;
use etherpen::config::{Config, IoDirection, IoPoint, IoRole, IoType};
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::messages::{Command, IoValues};
use host_tools::cell::{CellOptions, Fault as CellFault, parse_slaves};
use host_tools::random::Random;

/// Places of the terminals in the chain, from 1.
const EL1008: usize = 6;
const EL2004: usize = 7;
/// Points in the order of the configuration.
const CONTACT: usize = 0;
const WORD: usize = 1;
const VALVE: usize = 2;
const DURATION_MS: u32 = 400;

fn config(exchange: ExchangeKind) -> Config {
    let mut config = Config::default();
    config.bus.exchange = exchange;
    let point = |name: &str, slave: usize, direction, bit| IoPoint {
        name: name.try_into().unwrap(),
        slave: slave as u8 - 1,
        direction,
        bit: Some(bit),
        role: IoRole::None,
        ..IoPoint::default()
    };
    let points = [
        point("contact", EL1008, IoDirection::In, 3),
        IoPoint {
            kind: IoType::U8,
            ..point("word", EL1008, IoDirection::In, 0)
        },
        point("valve", EL2004, IoDirection::Out, 2),
    ];
    config.io.extend(points);
    config
}

fn robot(exchange: ExchangeKind) -> Robot {
    let options = CellOptions {
        slaves: parse_slaves("ax2000*4,ek1100,el1008,el2004").unwrap(),
        ..CellOptions::default()
    };
    Robot::of(&config(exchange), options).enabled()
}

/// The points at a time of the device.
fn at(robot: &Robot, t_ms: u64) -> IoValues {
    let found = robot.samples.iter().find(|sample| u64::from(sample.t_ms) == t_ms);
    found.unwrap_or_else(|| panic!("no sample of {t_ms} ms")).io
}

#[test]
pub(crate) fn an_input_and_an_output_are_in_the_sample_of_the_millisecond_in_which_they_change() {
    // With one telegram for both directions the inputs are those of its way round, at the start of the millisecond, and an
    // output leaves with the next one.
    for (exchange, output_later) in [(ExchangeKind::Split, 0), (ExchangeKind::Combined, 1)] {
        let mut robot = robot(exchange);
        let mut random = Random::new(17);
        let (mut contacts, mut valves) = (Vec::new(), Vec::new());
        let mut contact = false;
        for step in 0..DURATION_MS {
            contact ^= random.unit() < 0.2;
            robot.set_inputs(EL1008, u8::from(contact) << 3);
            if step % 23 == 0 {
                let value = (step / 23) % 2;
                robot.say(Command::SetOutput { io: VALVE as u8, value });
            }
            robot.run(1);
            // The number of the millisecond that has just run.
            let now_ms = robot.now_ms();
            contacts.push((now_ms, contact));
            valves.push((now_ms, robot.outputs(EL2004) & 1 << 2 != 0));
        }
        robot.run(50);
        let changes = |values: &[(u64, bool)]| values.windows(2).filter(|pair| pair[0].1 != pair[1].1).count();
        println!("{exchange:?}: {} and {} changes", changes(&contacts), changes(&valves));
        assert!(changes(&contacts) > 30 && changes(&valves) > 10);
        for (t_ms, closed) in contacts {
            assert_eq!(at(&robot, t_ms).get(CONTACT), Some(closed), "{exchange:?}, {t_ms} ms");
        }
        for (t_ms, on) in valves {
            let sent_ms = t_ms - output_later;
            assert_eq!(at(&robot, sent_ms).get(VALVE), Some(on), "{exchange:?}, {t_ms} ms");
        }
    }
}

#[test]
pub(crate) fn a_terminal_that_is_lost_is_missing_in_the_samples_and_a_word_shows_whether_it_is_0() {
    let mut robot = robot(ExchangeKind::Split);
    robot.set_inputs(EL1008, 0b100);
    robot.run(100);
    let with_word = robot.samples.last().unwrap().io;
    assert_eq!(
        [CONTACT, WORD, VALVE].map(|io| with_word.get(io)),
        [Some(false), Some(true), Some(false)]
    );
    robot.inject(CellFault::Power(EL1008, 2_000));
    robot.run(500);
    let without = robot.samples.last().unwrap().io;
    assert_eq!([CONTACT, WORD].map(|io| without.get(io)), [None, None]);
    assert_eq!(robot.mode(), Mode::Idle, "nothing needs this terminal");
}
