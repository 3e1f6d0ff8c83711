//! A sound robot with friction and noise draws, moves and jogs at random: its feedback is accepted.
//!
//! `ETHERPEN_SOAK_HOURS` sets the robot hours in each drive mode instead of a minute; `ETHERPEN_SOAK_SEED` is the first
//! seed instead of 0. A seed lasts ten minutes of robot time.

use crate::feedback::with;
use crate::robot::{Robot, Used};
use etherpen::application::Mode;
use etherpen::config::AxisMode;
use etherpen::control::feedback::COMPARISONS;
use etherpen::messages::{Command, PathVertex};
use etherpen::motion::Pen;
use etherpen::robots::Position;
use host_tools::cell::CellOptions;
use host_tools::random::Random;

/// Length without the variable, hours.
const HOURS: f64 = 1.0 / 60.0;
/// Robot time after which the next seed begins, ms.
const SLICE_MS: u64 = 600_000;
/// Noise of the resolvers, increments.
const NOISE_INCREMENTS: f64 = 8.0;
/// Largest part of its limit that a comparison may use.
const USED_MAX: f32 = 0.8;
/// Time between two signs of life in a jog, ms.
const SIGN_OF_LIFE_MS: u32 = 40;
/// Strokes stay within this distance of the middle, mm.
const PAPER_MM: f64 = 80.0;
/// Fastest jog along each axis, mm/s.
const JOG_MAX_MM_S: f64 = 140.0;

/// Random numbers.
struct Chance(Random);

impl Chance {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.unit()
    }

    fn one_of(&mut self, count: u64) -> u64 {
        self.0.bits() % count
    }
}

/// A coordinate as the link carries it, micrometres.
fn um(mm: f64) -> i32 {
    (mm * 1_000.0) as i32
}

/// Some strokes on the paper.
fn strokes(chance: &mut Chance) -> Vec<PathVertex> {
    let mut path = Vec::new();
    for stroke in 0..=chance.one_of(3) as u32 {
        let mut at = [chance.between(-60.0, 60.0), chance.between(-60.0, 60.0)];
        let mut go = |at: [f64; 2], z_um: i32, pen: Pen| {
            let [x_um, y_um] = at.map(um);
            path.push(PathVertex {
                position_um: [x_um, y_um, z_um],
                pen,
                stroke,
            });
        };
        go(at, -847_000, Pen::Up);
        go(at, -850_000, Pen::Up);
        let reach_mm = [0.5, 5.0, 40.0][chance.one_of(3) as usize];
        for _ in 0..3 + chance.one_of(12) {
            let before = at;
            at = at.map(|mm| {
                let by_mm = chance.between(-reach_mm, reach_mm);
                if (mm + by_mm).abs() < PAPER_MM {
                    mm + by_mm
                } else {
                    mm - by_mm
                }
            });
            // The controller refuses a vertex that repeats the one before it.
            if at.map(um) != before.map(um) {
                go(at, -850_000, Pen::Down);
            }
        }
        go(at, -847_000, Pen::Up);
    }
    path
}

/// Performs a random action; returns its duration, ms.
fn act(robot: &mut Robot, chance: &mut Chance) -> u64 {
    let from_ms = robot.now_ms();
    match chance.one_of(3) {
        0 => {
            robot.draw(strokes(chance));
            robot.run_until("the strokes are drawn or refused", |robot| {
                robot.has_drawn() || !robot.refused.is_empty()
            });
            assert!(robot.refused.is_empty(), "{:?}", robot.refused);
        }
        1 => {
            let position = Position {
                x_mm: chance.between(-120.0, 120.0),
                y_mm: chance.between(-120.0, 120.0),
                z_mm: chance.between(-840.0, -770.0),
            };
            robot.command(Command::Move { position }).expect("there is room");
        }
        _ => {
            let speed_mm_s = JOG_MAX_MM_S * [0.01, 0.1, 1.0][chance.one_of(3) as usize];
            let velocity_mm_s = std::array::from_fn(|_| chance.between(-speed_mm_s, speed_mm_s) as f32);
            for _ in 0..1 + chance.one_of(15) {
                robot.say(Command::Jog { velocity_mm_s });
                robot.run(SIGN_OF_LIFE_MS);
            }
        }
    }
    robot.run(20);
    robot.run_until("the robot rests or stops", |robot| {
        robot.mode() == Mode::Idle || robot.fault().is_some()
    });
    robot.run(chance.one_of(300) as u32);
    assert_eq!(robot.fault(), None, "after {} ms", robot.now_ms());
    robot.now_ms() - from_ms
}

fn soak(mode: AxisMode) {
    let asked = std::env::var("ETHERPEN_SOAK_HOURS").ok();
    let hours: f64 = asked.map_or(HOURS, |hours| hours.parse().expect("a number of hours"));
    let asked = std::env::var("ETHERPEN_SOAK_SEED").ok();
    let first: u64 = asked.map_or(0, |seed| seed.parse().expect("a seed"));
    let (mut left_ms, mut passed_ms) = ((hours * 3.6e6) as u64, 0);
    let mut most = Used::default();
    for seed in first.. {
        let mut options = CellOptions {
            seed,
            ..CellOptions::default()
        };
        options.physics.resolver.noise_increments = NOISE_INCREMENTS;
        options.physics.friction.lag_rad_s = 0.016;
        let (mut robot, mut chance) = (
            Robot::of(&with(mode, 1_000.0), options).enabled(),
            Chance(Random::new(seed)),
        );
        let mut slice_ms = SLICE_MS.min(left_ms);
        left_ms -= slice_ms;
        while slice_ms > 0 {
            let took_ms = act(&mut robot, &mut chance);
            let used = robot.take_used();
            most = std::array::from_fn(|comparison| most[comparison].max(used[comparison]));
            (slice_ms, passed_ms) = (slice_ms.saturating_sub(took_ms), passed_ms + took_ms);
        }
        let passed_h = passed_ms as f64 / 3.6e6;
        println!(
            "{mode:?}: {passed_h:.3} robot hours, seeds {first} to {seed}; of the limits of {COMPARISONS:?} {most:.3?}"
        );
        if left_ms == 0 {
            break;
        }
    }
    assert!(most.iter().all(|used| *used <= USED_MAX), "{COMPARISONS:?}: {most:?}");
}

#[test]
fn strokes_moves_and_jogs_of_a_sound_robot_in_velocity_mode_are_accepted() {
    soak(AxisMode::Velocity);
}

#[test]
fn strokes_moves_and_jogs_of_a_sound_robot_in_torque_mode_are_accepted() {
    soak(AxisMode::Torque);
}

#[test]
fn strokes_moves_and_jogs_of_a_sound_robot_in_position_mode_are_accepted() {
    soak(AxisMode::Position);
}
