//! A laser or a dispenser whose output follows the path: its word at the terminal beside the true speed of the tool.

use crate::pen_output::{TERMINAL, corexy, path};
use crate::robot::{self, Robot};
use etherpen::config::{Config, IoDirection, IoPoint, IoRole, IoType, PenLiftKind, Tool, ToolFollows};
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::messages::{Command, PathVertex};
use etherpen::motion::Pen;
use host_tools::cell::InkStroke;

/// Values of the laser's word at rest and at the nominal speed.
pub(super) const MINIMUM: u16 = 2_000;
const MAXIMUM: u16 = 32_000;
/// Largest difference of the word's speed from the true one, mm/s.
const WORST_MM_S: f64 = 3.5;
/// Longest piece of a line without light, mm: the tool turns back at a corner and is at rest for a moment.
const DARK_MAX_MM: f64 = 0.01;
/// The terminal of the delta's laser, from 1, behind four drives and a coupler.
const BEHIND_DRIVES: usize = 6;

/// A CoreXY that nothing lifts, with a laser whose word is full at this speed.
pub(super) fn laser(speed_mm_s: f64, exchange: ExchangeKind) -> Config {
    let mut config = corexy();
    config.pen.kind = PenLiftKind::None;
    config.motion.speed_mm_s = speed_mm_s;
    config.bus.exchange = exchange;
    config.tool = Tool {
        follows: ToolFollows::Speed,
        nominal_mm_s: speed_mm_s as f32,
        minimum: MINIMUM,
        maximum: MAXIMUM,
        ..Tool::default()
    };
    let point = config.io.iter_mut().find(|point| point.role == IoRole::Pen).unwrap();
    (point.role, point.kind) = (IoRole::Tool, IoType::U16);
    checked(config)
}

fn checked(config: Config) -> Config {
    assert_eq!((config.check(), config.check_io()), (Ok(()), Ok(())));
    config
}

/// The delta, whose axes lift the whole tool, with the same laser.
fn delta(speed_mm_s: f64, exchange: ExchangeKind) -> Config {
    let mut config = Config {
        tool: laser(speed_mm_s, exchange).tool,
        ..Config::default()
    };
    config.motion.speed_mm_s = speed_mm_s;
    config.bus.exchange = exchange;
    let point = IoPoint {
        name: "laser".try_into().unwrap(),
        slave: BEHIND_DRIVES as u8 - 1,
        direction: IoDirection::Out,
        bit: Some(0),
        kind: IoType::U16,
        role: IoRole::Tool,
        ..IoPoint::default()
    };
    config.io.push(point).unwrap();
    checked(config)
}

/// What is seen in a millisecond.
struct Moment {
    /// The terminal's word.
    word: u16,
    /// The true place of the tool, mm.
    at: [f64; 2],
    /// Distance from the nearest stroke in the plan view, mm.
    beside_mm: f64,
}

/// Distance of a place from a leg, mm.
fn beside_mm(at: [f64; 2], [from, to]: [[f64; 2]; 2]) -> f64 {
    let (along, out) = ([to[0] - from[0], to[1] - from[1]], [at[0] - from[0], at[1] - from[1]]);
    let squared = along[0] * along[0] + along[1] * along[1];
    let share = ((along[0] * out[0] + along[1] * out[1]) / squared.max(1e-9)).clamp(0.0, 1.0);
    (out[0] - share * along[0]).hypot(out[1] - share * along[1])
}

/// The legs with the pen down, mm.
fn drawn(path: &[PathVertex]) -> Vec<[[f64; 2]; 2]> {
    let legs = path.windows(2).filter(|pair| pair[1].pen == Pen::Down);
    let place = |vertex: &PathVertex| [0, 1].map(|axis| f64::from(vertex.position_um[axis]) / 1e3);
    legs.map(|pair| [place(&pair[0]), place(&pair[1])]).collect()
}

fn seen(robot: &Robot, terminal: usize, legs: &[[[f64; 2]; 2]]) -> Moment {
    let platform = robot.cell().platform.expect("the joints hold a place");
    let at = [platform.x_mm, platform.y_mm];
    let beside = legs.iter().map(|leg| beside_mm(at, *leg));
    Moment {
        word: robot.output_word(terminal),
        at,
        beside_mm: beside.fold(f64::INFINITY, f64::min),
    }
}

/// Draws a path; returns all milliseconds.
fn watched(robot: &mut Robot, terminal: usize, path: &[PathVertex]) -> Vec<Moment> {
    let legs = drawn(path);
    robot.draw(path.to_vec());
    let mut moments = Vec::new();
    while !robot.has_drawn() || robot.speed_rad_s() > 1e-3 {
        robot.run(1);
        moments.push(seen(robot, terminal, &legs));
        assert_eq!(robot.fault(), None);
    }
    moments
}

/// True speeds of the tool in the millisecond that begins with each moment, mm/s.
fn speeds_mm_s(moments: &[Moment]) -> Vec<f64> {
    let way = |pair: &[Moment]| 1e3 * (pair[1].at[0] - pair[0].at[0]).hypot(pair[1].at[1] - pair[0].at[1]);
    moments.windows(2).map(way).collect()
}

/// The speed that a word stands for, mm/s.
fn told_mm_s(word: u16, nominal_mm_s: f64) -> f64 {
    f64::from(word.saturating_sub(MINIMUM)) / f64::from(MAXIMUM - MINIMUM) * nominal_mm_s
}

/// Largest difference of the word's speed from the true one so many milliseconds later, mm/s.
fn largest_mm_s(moments: &[Moment], nominal_mm_s: f64, later_ms: isize) -> f64 {
    let speeds = speeds_mm_s(moments);
    let differences = moments.iter().enumerate().filter(|(_, moment)| moment.word > 0);
    let difference = |(place, moment): (usize, &Moment)| {
        let true_mm_s = speeds.get(place.checked_add_signed(later_ms)?)?;
        Some((told_mm_s(moment.word, nominal_mm_s) - true_mm_s).abs())
    };
    differences.filter_map(difference).fold(0.0, f64::max)
}

#[test]
pub(crate) fn the_word_follows_the_true_speed_at_corners_starts_and_ends_at_every_override() {
    let all = [10, 55, 100].as_slice();
    for (speed_mm_s, exchange, overrides) in [
        (20.0, ExchangeKind::Split, &[100][..]),
        (300.0, ExchangeKind::Split, all),
        (300.0, ExchangeKind::Combined, all),
    ] {
        for (name, config, terminal, path) in [
            ("corexy", laser(speed_mm_s, exchange), TERMINAL, path()),
            ("delta", delta(speed_mm_s, exchange), BEHIND_DRIVES, robot::path()),
        ] {
            for percent in overrides.iter().copied() {
                let mut robot = Robot::idle_with(&config);
                robot.command(Command::Override { percent }).unwrap();
                let moments = watched(&mut robot, terminal, &path);
                let errors: Vec<String> = (-5..=5)
                    .map(|later_ms| format!("{:.1}", largest_mm_s(&moments, speed_mm_s, later_ms)))
                    .collect();
                println!(
                    "{name}, {exchange:?}, {speed_mm_s} mm/s, {percent} %: {}",
                    errors.join(" ")
                );
                let worst_mm_s = largest_mm_s(&moments, speed_mm_s, 0);
                // Less than the speed changes by in a millisecond.
                assert!(worst_mm_s < WORST_MM_S, "{worst_mm_s} mm/s");
                let fastest = moments.iter().map(|moment| moment.word).max().unwrap();
                let reached_mm_s = told_mm_s(fastest, speed_mm_s);
                let wanted_mm_s = speed_mm_s * f64::from(percent) / 100.0;
                assert!(
                    (reached_mm_s - wanted_mm_s).abs() < 0.02 * speed_mm_s,
                    "{reached_mm_s} mm/s"
                );
            }
        }
    }
}

#[test]
pub(crate) fn the_laser_is_off_outside_strokes_and_the_whole_of_each_stroke_has_light() {
    for (speed_mm_s, exchange) in [(20.0, ExchangeKind::Combined), (200.0, ExchangeKind::Split)] {
        let mut robot = Robot::idle_with(&laser(speed_mm_s, exchange));
        let moments = watched(&mut robot, TERMINAL, &path());
        let lit: Vec<_> = moments.iter().filter(|moment| moment.word > 0).collect();
        let beside_mm = lit.iter().map(|moment| moment.beside_mm).fold(0.0, f64::max);
        println!("{speed_mm_s} mm/s: light at most {beside_mm:.3} mm beside a stroke");
        assert!(beside_mm < 0.3, "{beside_mm} mm");
        // The virtual sheet sees light only.
        let ink = joined(robot.ink());
        assert_eq!(ink.len(), 2, "a line for each stroke");
        for vertex in path().iter().filter(|vertex| vertex.pen == Pen::Down) {
            let [x_um, y_um, _] = vertex.position_um.map(f64::from);
            let at = [x_um / 1e3 + 100.0, 100.0 - y_um / 1e3];
            let away_mm = ink[vertex.stroke as usize].distance_mm(&at);
            assert!(away_mm < 0.4, "{at:?}: {away_mm} mm");
        }
        // Moves and jogs have no light, and the host cannot set it.
        robot.command(Command::Pen { pen: Pen::Down }).unwrap();
        robot
            .command(Command::Jog {
                velocity_mm_s: [20.0, 0.0, 0.0],
            })
            .ok();
        for _ in 0..500 {
            robot.run(1);
            assert_eq!(robot.output_word(TERMINAL), 0);
        }
        assert!(robot.command(Command::SetOutput { io: 1, value: 5 }).is_err());
    }
}

#[test]
pub(crate) fn the_way_to_a_path_that_begins_with_the_pen_down_is_dark() {
    for (speed_mm_s, exchange) in [(20.0, ExchangeKind::Combined), (200.0, ExchangeKind::Split)] {
        let mut robot = Robot::idle_with(&laser(speed_mm_s, exchange));
        let mut path = path();
        path[0].pen = Pen::Down;
        path[1].pen = Pen::Down;
        for again in 0..2 {
            let moments = watched(&mut robot, TERMINAL, &path);
            let lit: Vec<_> = moments.iter().filter(|moment| moment.word > 0).collect();
            let beside_mm = lit.iter().map(|moment| moment.beside_mm).fold(0.0, f64::max);
            assert!(
                !lit.is_empty() && beside_mm < 0.3,
                "{beside_mm} mm at {speed_mm_s} mm/s, {again}"
            );
        }
    }
}

/// Lines of ink that go on where another ends are one.
fn joined(lines: Vec<InkStroke>) -> Vec<InkStroke> {
    let mut joined: Vec<InkStroke> = Vec::new();
    for line in lines {
        let first = line.points_mm[0];
        let goes_on = |before: &&mut InkStroke| {
            let last = before.points_mm.last().unwrap();
            (first[0] - last[0]).hypot(first[1] - last[1]) < DARK_MAX_MM
        };
        match joined.last_mut().filter(goes_on) {
            Some(before) => before.points_mm.extend(line.points_mm),
            None => joined.push(line),
        }
    }
    joined
}

#[test]
pub(crate) fn a_dispenser_gets_a_pulse_for_each_pitch_of_each_stroke() {
    for (kind, pitch_um) in [(IoType::U16, 25), (IoType::U16, 1_000), (IoType::Bool, 400)] {
        for (speed_mm_s, percent) in [(20.0, 100), (200.0, 100), (200.0, 30)] {
            let mut config = laser(speed_mm_s, ExchangeKind::Split);
            (config.tool.follows, config.tool.pitch_um) = (ToolFollows::Distance, pitch_um);
            let point = config.io.iter_mut().find(|point| point.role == IoRole::Tool).unwrap();
            point.kind = kind;
            let mut robot = Robot::idle_with(&checked(config));
            robot.command(Command::Override { percent }).unwrap();
            let moments = watched(&mut robot, TERMINAL, &path());
            // Both strokes have the same form; the second one lies 30 mm beside the first.
            for middle_mm in [0.0, 30.0] {
                let is_own = |moment: &&Moment| (middle_mm - 5.0..middle_mm + 25.0).contains(&moment.at[1]);
                let own: Vec<_> = moments.iter().filter(is_own).collect();
                let first = own.iter().position(|moment| moment.word > 0).unwrap();
                let last = own.iter().rposition(|moment| moment.word > 0).unwrap();
                let way = |pair: &[&Moment]| (pair[1].at[0] - pair[0].at[0]).hypot(pair[1].at[1] - pair[0].at[1]);
                let length_mm: f64 = own[first..=last].windows(2).map(way).sum();
                let rises = |pair: &[&Moment]| u32::from(pair[1].word.saturating_sub(pair[0].word));
                let counted: u32 = own[first..=last].windows(2).map(rises).sum();
                let expected = 1e3 * length_mm / f64::from(pitch_um);
                println!("{kind:?}, {pitch_um} um, {speed_mm_s} mm/s: {counted} pulses, {expected:.2} pitches");
                // The tool passes several pitches in a millisecond, and lags by a part of it.
                let lag = 2e-4 * speed_mm_s * 1e3 / f64::from(pitch_um);
                assert!(
                    (f64::from(counted) - expected).abs() <= 1.0 + lag,
                    "{counted}, {expected}"
                );
                // Eight legs of 60.05 mm, less what the tolerance cuts off at their corners.
                let whole = 8.0 * 60_052.0 / f64::from(pitch_um);
                let all = f64::from(counted + u32::from(own[first].word));
                assert!(all <= whole + 1.0 && all > 0.99 * whole - 1.0, "{all} of {whole}");
            }
        }
    }
}
