//! The named words in the samples of each millisecond, against the process images of the cell's terminals.

use crate::robot::Robot;
use etherpen::application::Mode;
use etherpen::config::{Config, IoDirection, IoPoint, IoType};
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::messages::{Command, IoValues};
use host_tools::cell::{CellOptions, Fault as CellFault, parse_slaves};
use host_tools::random::Random;
use host_tools::recording::signals::IoColumn;

/// Places of the terminals in the chain, from 1.
const AI2: usize = 6;
const AO2: usize = 7;
/// Points in the order of the configuration.
const LEVEL: usize = 0;
const SWITCHED: usize = 1;
const FORCE: usize = 2;
const VALVE: usize = 3;
const SPEED: usize = 4;
const FAR: usize = 5;
const DURATION_MS: u32 = 400;

fn config(exchange: ExchangeKind) -> Config {
    let mut config = Config::default();
    config.bus.exchange = exchange;
    let point = |name: &str, slave: usize, bit, kind| IoPoint {
        name: name.try_into().unwrap(),
        slave: slave as u8 - 1,
        direction: if slave == AI2 {
            IoDirection::In
        } else {
            IoDirection::Out
        },
        bit: Some(bit),
        kind,
        ..IoPoint::default()
    };
    config.io.extend([
        point("level", AI2, 0, IoType::I16),
        // A bit between words: words are counted alone.
        point("switched", AI2, 31, IoType::Bool),
        point("force", AI2, 16, IoType::U16),
        point("valve", AO2, 0, IoType::U16),
        point("speed", AO2, 16, IoType::I16),
        // The fifth word is not in the samples.
        point("far", AI2, 8, IoType::U16),
    ]);
    config
}

fn robot(exchange: ExchangeKind) -> Robot {
    let options = CellOptions {
        slaves: parse_slaves("ax2000*4,ek1100,ai2,ao2").unwrap(),
        ..CellOptions::default()
    };
    Robot::of(&config(exchange), options).enabled()
}

/// Sets both analogue inputs.
fn set_inputs(robot: &mut Robot, level: i16, force: u16) {
    let [level, force] = [level.to_le_bytes(), force.to_le_bytes()];
    robot.set_input_bytes(AI2, &[level[0], level[1], force[0], force[1]]);
}

/// The points at a time of the device.
fn at(robot: &Robot, t_ms: u64) -> IoValues {
    let found = robot.samples.iter().find(|sample| u64::from(sample.t_ms) == t_ms);
    found.unwrap_or_else(|| panic!("no sample of {t_ms} ms")).io
}

/// A point's value as tables show it.
fn value(io: &IoValues, point: usize) -> Option<i64> {
    IoColumn::all(&config(ExchangeKind::Split))
        .nth(point)
        .unwrap()
        .value(io)
}

#[test]
pub(crate) fn analogue_inputs_and_outputs_are_in_the_sample_of_the_millisecond_in_which_they_change() {
    // With one telegram for both directions an output leaves with the next one.
    for (exchange, output_later) in [(ExchangeKind::Split, 0), (ExchangeKind::Combined, 1)] {
        let mut robot = robot(exchange);
        let mut random = Random::new(17);
        let (mut inputs, mut written) = (Vec::new(), Vec::new());
        for step in 0..DURATION_MS {
            // Noise with some bits more or less, and sometimes 0.
            let [level, force] = [(); 2].map(|()| (random.bits() as u16) >> (random.bits() % 17).min(15));
            let level = if step % 2 == 0 {
                level as i16
            } else {
                (level as i16).wrapping_neg()
            };
            set_inputs(&mut robot, level, force);
            if step % 23 == 0 {
                let value = random.bits() as u16;
                let io = if step % 2 == 0 { VALVE } else { SPEED } as u8;
                robot.say(Command::SetOutput {
                    io,
                    value: value.into(),
                });
            }
            robot.run(1);
            let now_ms = robot.now_ms();
            inputs.push((now_ms, level, force));
            written.push((now_ms, robot.output_words(AO2)));
        }
        robot.run(50);
        let changes = written.windows(2).filter(|pair| pair[0].1 != pair[1].1).count();
        println!(
            "{exchange:?}: seed 17, {} inputs, {changes} outputs changed",
            inputs.len()
        );
        assert!(changes > 10);
        for (t_ms, level, force) in inputs {
            let io = at(&robot, t_ms);
            assert_eq!(value(&io, LEVEL), Some(level.into()), "{exchange:?}, {t_ms} ms");
            assert_eq!(value(&io, FORCE), Some(force.into()), "{exchange:?}, {t_ms} ms");
            assert_eq!(
                value(&io, SWITCHED),
                Some((force >> 15).into()),
                "{exchange:?}, {t_ms} ms"
            );
            // Bits of both inputs.
            let far = level as u16 >> 8 | force << 8;
            assert_eq!(value(&io, FAR), (far == 0).then_some(0), "{exchange:?}, {t_ms} ms");
        }
        for (t_ms, [valve, speed]) in written {
            let io = at(&robot, t_ms - output_later);
            assert_eq!(value(&io, VALVE), Some(valve.into()), "{exchange:?}, {t_ms} ms");
            assert_eq!(
                value(&io, SPEED),
                Some((speed as i16).into()),
                "{exchange:?}, {t_ms} ms"
            );
        }
    }
}

#[test]
pub(crate) fn words_of_a_terminal_that_is_lost_have_no_value_and_are_back_with_it() {
    let mut robot = robot(ExchangeKind::Split);
    set_inputs(&mut robot, -1_234, 0xFEDC);
    robot.run(100);
    let shown = |robot: &Robot| [LEVEL, FORCE, VALVE].map(|point| value(&robot.samples.last().unwrap().io, point));
    assert_eq!(shown(&robot), [Some(-1_234), Some(0xFEDC), Some(0)]);
    robot.inject(CellFault::Power(AI2, 2_000));
    robot.run(500);
    assert_eq!(shown(&robot)[..2], [None, None]);
    let words: Vec<u32> = robot.samples.last().unwrap().io.words.values().collect();
    assert_eq!(words[..2], [0, 0], "no stale values");
    assert_eq!(robot.mode(), Mode::Idle, "nothing needs this terminal");
    robot.run(2_000);
    robot.command(Command::Acknowledge).unwrap();
    set_inputs(&mut robot, 77, 3);
    robot.run_until("the terminal is back", |robot| shown(robot)[..2] == [Some(77), Some(3)]);
}
