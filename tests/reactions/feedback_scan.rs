//! A scan over faults of the position feedback, speeds, axes, directions and poses, in all modes of the drives.
//!
//! The tables are part of `docs/faults.md`; the tests compare. To renew them after an intended change, run
//! `ETHERPEN_RENEW_FAULTS=1 cargo test --test reactions untrue_feedback` and review the difference.

use crate::feedback::{Case, HARD_MM_S2, Kind, Outcome, case, drive, recover, with};
use crate::robot::{Robot, Used};
use etherpen::application::Mode;
use etherpen::config::{AxisMode, Config};
use etherpen::control::feedback::COMPARISONS;
use host_tools::cell::CellOptions;
use std::fmt::Write;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Mutex;

/// Speeds of the pen, mm/s: from a slow jog to the speed limit of most drawings and beyond.
const SPEEDS_MM_S: [f64; 6] = [5.0, 20.0, 100.0, 300.0, 1_000.0, 2_500.0];
/// Cases for each fault and speed.
const CASES: u64 = 8;
/// Most deviation of the pen from its line, mm: up to 5 mm/s, and up to 1 m/s.
const SLOW_MAX_MM: f64 = 5.0;
const MEDIUM_MAX_MM: f64 = 20.0;
/// Most deviation by a slip of a tenth and of a half, which torque and position mode need not notice, relative to the distance that
/// the pen has moved: a joint that shows 0.9 of its motion moves by 1 / 0.9.
const SLIP_MAX_OF_WAY: f64 = 1.0 / 0.9 - 1.0;
const HALF_SLIP_MAX_OF_WAY: f64 = 1.0 / 0.5 - 1.0;
/// Most deviation of a sound robot, mm. In torque mode gravity, friction and coupling are left to the feedback.
const SOUND_MAX_MM: f64 = 0.1;
const SOUND_TORQUE_MAX_MM: f64 = 5.0;
/// Noise of a sound resolver, increments at most: 17 bits of 20.
const NOISE_INCREMENTS: f64 = 8.0;
/// Largest part of its limit that a comparison may use on a sound robot.
const USED_MAX: f32 = 0.8;
/// Seeds that the limits were not chosen with; those of 0 to 7 were.
const HELD_OUT: Range<u64> = 8..16;
/// Set to try other seeds, as `0..8`.
const SEEDS: &str = "ETHERPEN_FEEDBACK_SEEDS";
const DOCUMENT: &str = "docs/faults.md";
/// Set to write the tables instead of comparing with them.
const RENEW: &str = "ETHERPEN_RENEW_FAULTS";

/// The worst of some cases: latest notice, most deviation, and how many were not noticed.
#[derive(Clone, Copy, Debug, Default)]
struct Worst {
    noticed_ms: u32,
    deviation_mm: f64,
    /// Deviation relative to the distance that the pen has moved.
    of_way: f64,
    unnoticed: u32,
}

fn scan(mode: AxisMode, cases: u64) -> Vec<(Kind, Vec<Worst>)> {
    let mut robots = SPEEDS_MM_S.map(|speed_mm_s| Robot::idle_with(&with(mode, speed_mm_s)));
    let mut table = Vec::new();
    for kind in Kind::ALL {
        let mut row = Vec::new();
        for (speed_mm_s, robot) in SPEEDS_MM_S.into_iter().zip(&mut robots) {
            let mut worst = Worst::default();
            for seed in 0..cases {
                let case = case(Some(kind), speed_mm_s, seed + 1);
                let outcome = drive(robot, &case);
                println!("{case:?}: {outcome:?}, {:?}", robot.fault());
                recover(robot, &case);
                worst.noticed_ms = worst.noticed_ms.max(outcome.noticed_ms.unwrap_or(0));
                worst.deviation_mm = worst.deviation_mm.max(outcome.deviation_mm);
                worst.of_way = worst.of_way.max(outcome.deviation_mm / outcome.way_mm);
                worst.unnoticed += u32::from(outcome.noticed_ms.is_none());
            }
            row.push(worst);
        }
        table.push((kind, row));
    }
    table
}

fn rendered(table: &[(Kind, Vec<Worst>)]) -> String {
    let mut text = String::from("| feedback |");
    SPEEDS_MM_S
        .iter()
        .for_each(|speed| write!(text, " {speed:.0} mm/s |").expect("memory"));
    text.push_str("\n|---|");
    SPEEDS_MM_S.iter().for_each(|_| text.push_str("---|"));
    for (kind, row) in table {
        write!(text, "\n| {} |", kind.name()).expect("memory");
        for worst in row {
            write!(text, " {} ms, {:.1} mm", worst.noticed_ms, worst.deviation_mm).expect("memory");
            if worst.unnoticed > 0 {
                write!(text, " ({} not noticed)", worst.unnoticed).expect("memory");
            }
            text.push_str(" |");
        }
    }
    text.push('\n');
    text
}

fn assert_within_limits(mode: AxisMode, table: &[(Kind, Vec<Worst>)]) {
    for (kind, row) in table {
        for (speed_mm_s, worst) in SPEEDS_MM_S.iter().zip(row) {
            let deviation_mm = worst.deviation_mm;
            let slip = match (mode, kind) {
                (AxisMode::Torque | AxisMode::Position, Kind::Slipping) => Some(SLIP_MAX_OF_WAY),
                (AxisMode::Torque | AxisMode::Position, Kind::SlippingHalf) => Some(HALF_SLIP_MAX_OF_WAY),
                _ => None,
            };
            if let Some(most) = slip {
                let of_way = worst.of_way;
                println!("{kind:?} at {speed_mm_s} mm/s: {of_way:.3} of the way");
                assert!(of_way <= most, "{kind:?} at {speed_mm_s} mm/s: {of_way:.3} of the way");
                continue;
            }
            let limit_mm = match *speed_mm_s {
                ..=5.0 => SLOW_MAX_MM,
                ..=1_000.0 => MEDIUM_MAX_MM,
                _ => f64::INFINITY,
            };
            assert!(
                deviation_mm <= limit_mm,
                "{kind:?} at {speed_mm_s} mm/s: {deviation_mm:.1} mm"
            );
        }
    }
}

/// Compares a table with the one below a heading of the document, or puts it there.
fn compare(heading: &str, table: &str) {
    static DOCUMENT_LOCK: Mutex<()> = Mutex::new(());
    let _alone = DOCUMENT_LOCK.lock().expect("no test panics while it writes");
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(DOCUMENT);
    let text = std::fs::read_to_string(&path).expect("the document");
    let from = text.find(heading).expect("the heading") + heading.len();
    let from = from + text[from..].find("| feedback |").expect("the table");
    let length = text[from..].find("\n\n").map_or(text.len() - from, |length| length + 1);
    if std::env::var_os(RENEW).is_some() {
        let renewed = [&text[..from], table, &text[from + length..]].concat();
        std::fs::write(&path, renewed).expect("the document can be written");
    } else {
        assert_eq!(
            &text[from..from + length],
            table,
            "{DOCUMENT} is not what was measured; {RENEW}=1 renews it"
        );
    }
}

#[test]
fn untrue_feedback_in_velocity_mode_is_noticed_before_the_pen_has_gone_far() {
    let table = scan(AxisMode::Velocity, CASES);
    println!("{}", rendered(&table));
    assert_within_limits(AxisMode::Velocity, &table);
    compare("\n#### Velocity mode\n", &rendered(&table));
}

#[test]
fn untrue_feedback_in_torque_mode_is_noticed_before_the_pen_has_gone_far() {
    let table = scan(AxisMode::Torque, CASES);
    println!("{}", rendered(&table));
    assert_within_limits(AxisMode::Torque, &table);
    compare("\n#### Torque mode\n", &rendered(&table));
}

#[test]
fn untrue_feedback_in_position_mode_is_noticed_before_the_pen_has_gone_far() {
    let table = scan(AxisMode::Position, CASES);
    println!("{}", rendered(&table));
    assert_within_limits(AxisMode::Position, &table);
    compare("\n#### Position mode\n", &rendered(&table));
}

/// Drives a sound robot through some cases at a speed; returns the parts of their limits that the comparisons used.
fn drive_sound(config: &Config, speed_mm_s: f64, options: CellOptions, seeds: Range<u64>) -> Used {
    let mode = config.axes[0].mode;
    let limit_mm = match mode {
        AxisMode::Velocity | AxisMode::Position => SOUND_MAX_MM,
        AxisMode::Torque => SOUND_TORQUE_MAX_MM,
    };
    let mut robot = Robot::of(config, options).enabled();
    let mut most = Used::default();
    for seed in seeds {
        let case: Case = case(None, speed_mm_s, seed);
        let outcome: Outcome = drive(&mut robot, &case);
        let used = robot.take_used();
        most = std::array::from_fn(|comparison| most[comparison].max(used[comparison]));
        println!("{mode:?} {case:?}: {outcome:?}, {used:?}");
        assert_eq!((outcome.noticed_ms, robot.fault()), (None, None), "{mode:?} {case:?}");
        assert!(outcome.deviation_mm < limit_mm, "{mode:?} {case:?}: {outcome:?}");
        robot.wait_for(Mode::Idle);
    }
    most
}

#[test]
fn a_sound_robot_keeps_to_its_line_in_the_same_motions() {
    for mode in [AxisMode::Velocity, AxisMode::Position] {
        for speed_mm_s in SPEEDS_MM_S {
            let config = with(mode, speed_mm_s);
            let used = drive_sound(&config, speed_mm_s, CellOptions::default(), 0..2);
            println!("{mode:?} at {speed_mm_s} mm/s: {used:.3?}");
        }
    }
}

#[test]
fn a_sound_robot_in_torque_mode_keeps_a_fifth_of_every_limit_free() {
    let text = std::env::var(SEEDS).ok();
    let seeds = text.map_or(HELD_OUT, |text| {
        let (from, to) = text.split_once("..").expect("a range");
        from.parse().expect("a number")..to.parse().expect("a number")
    });
    let mut most = Used::default();
    println!("of the limits of {COMPARISONS:?}, seeds {seeds:?}:");
    for speed_mm_s in SPEEDS_MM_S {
        for acceleration_mm_s2 in [Config::default().motion.acceleration_mm_s2, HARD_MM_S2] {
            for (coulomb_nm, noise_increments) in [(0.0, 0.0), (0.3, 0.0), (0.3, NOISE_INCREMENTS)] {
                let mut config = with(AxisMode::Torque, speed_mm_s);
                config.motion.acceleration_mm_s2 = acceleration_mm_s2;
                let mut options = CellOptions::default();
                options.physics.friction.coulomb_nm = coulomb_nm;
                options.physics.resolver.noise_increments = noise_increments;
                let used = drive_sound(&config, speed_mm_s, options, seeds.clone());
                println!(
                    "{speed_mm_s} mm/s, {acceleration_mm_s2} mm/s2, {coulomb_nm} N m, \
                     {noise_increments} increments: {used:.2?}"
                );
                most = std::array::from_fn(|comparison| most[comparison].max(used[comparison]));
            }
        }
    }
    println!("at most {most:.3?}");
    assert!(most.iter().all(|used| *used <= USED_MAX), "{COMPARISONS:?}: {most:?}");
}
