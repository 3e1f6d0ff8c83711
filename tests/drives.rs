//! The short drawing with every kind of drive and of demand, firmware tasks and virtual cell in virtual time.
//!
//! The figures of each run are printed (`cargo test --test drives -- --nocapture`).

use etherpen::config::{AxisMode, Config};
use etherpen::ethercat::cyclic::ExchangeKind;
use host_tools::cell::{CellOptions, SlaveKind};
use host_tools::drawing::preparation::prepare::prepare;
use host_tools::report::Report;
use host_tools::report::output::conclude;
use host_tools::run;
use host_tools::run::task;
use std::path::Path;

/// Feedback gain around the firmware's own velocity loop, 1/s: a third of that loop's default bandwidth.
const TORQUE_FEEDBACK_GAIN_PER_S: f64 = 40.0;
/// Farthest the pen may be from its line where the drives close the velocity loop, mm.
const DEVIATION_MAX_MM: f64 = 0.1;
/// Farthest the pen may be from its line where the drives get a target without a velocity beside it, mm: they follow its
/// changes of speed later than those that get one.
const TARGET_ALONE_DEVIATION_MAX_MM: f64 = 0.15;
/// Farthest the pen may be from its line in torque mode, mm: gravity, friction and coupling are left to the feedback.
const TORQUE_DEVIATION_MAX_MM: f64 = 1.0;
/// By how much the pen may be farther from its line where SYNC0 leads the drives, mm: resolvers of other seeds have other
/// errors.
const SYNC0_DEVIATION_MM: f64 = 0.005;
/// Most of the line that may be missing, as a share: in torque mode the pen's spring does not always reach the paper.
const INK_MISSING_MAX: f64 = 0.01;

/// Draws with four drives of a kind; asserts that everything is drawn, in time and without a loss.
fn draw(kind: SlaveKind, mode: AxisMode) -> Report {
    let mut config = Config::default();
    for axis in &mut config.axes {
        axis.mode = mode;
        if mode == AxisMode::Torque {
            axis.feedback_gain_per_s = TORQUE_FEEDBACK_GAIN_PER_S;
        }
    }
    draw_with(&config, kind, CellOptions::default().seed)
}

/// Draws with drives of a kind and of this configuration, with clocks and resolvers of a seed; asserts as [`draw`] does.
fn draw_with(config: &Config, kind: SlaveKind, seed: u64) -> Report {
    let mode = config.axes[0].mode;
    let name = format!("{kind:?} {mode:?}, seed {seed}");
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/strokes.csv");
    let prepared = prepare(&file, config).expect("the sample can be drawn");
    let mut task = task(config, &prepared);
    task.cell.slaves = vec![kind; config.axes.len()];
    task.cell.seed = seed;
    let drawn = run::simulate(&task, None, &mut |_| {}).expect("nothing is captured");
    let report = conclude(&task, &prepared, &drawn, String::new(), None).expect("the drawing was drawn");
    println!(
        "{name}: path deviation {:.4} mm at most, {:.4} mm rms; following error {}",
        report.path_deviation_max_mm,
        report.path_deviation_rms_mm,
        report.following_error_max.text()
    );
    let counted = [
        report.cycles_late,
        report.frames_lost,
        report.working_counter_errors,
        report.reference_underruns,
    ];
    assert_eq!(counted, [0; 4], "{name}: late, lost, working counter, underruns");
    println!(
        "{name}: {:.1} mm of {:.1} mm without ink",
        report.ink_missing_mm, report.pen_down_mm
    );
    let allowed_mm = match mode {
        AxisMode::Velocity | AxisMode::Position => 0.0,
        AxisMode::Torque => INK_MISSING_MAX * report.pen_down_mm,
    };
    assert!(report.ink_missing_mm <= allowed_mm, "{name}");
    report
}

#[test]
fn four_ax2000_draw_in_digital_speed() {
    let report = draw(SlaveKind::Ax2000, AxisMode::Velocity);
    assert!(report.path_deviation_max_mm <= DEVIATION_MAX_MM);
}

#[test]
fn four_generic_drives_draw_in_cyclic_synchronous_velocity() {
    let report = draw(SlaveKind::Cia402, AxisMode::Velocity);
    assert!(report.path_deviation_max_mm <= DEVIATION_MAX_MM);
}

#[test]
fn drives_that_obey_sync0_draw_as_exactly_as_free_running_ones_whatever_their_crystals() {
    let mut config = Config::default();
    for exchange in [ExchangeKind::Split, ExchangeKind::Combined] {
        (config.bus.exchange, config.bus.clocks) = (exchange, false);
        let free_mm = draw_with(&config, SlaveKind::Ax2000, 1).path_deviation_max_mm;
        config.bus.clocks = true;
        for seed in 1..=6 {
            let by_sync0_mm = draw_with(&config, SlaveKind::Ax2000, seed).path_deviation_max_mm;
            let worse_mm = by_sync0_mm - free_mm;
            assert!(
                worse_mm < SYNC0_DEVIATION_MM,
                "seed {seed}, {exchange:?}: {by_sync0_mm} mm, {free_mm} mm"
            );
        }
    }
}

#[test]
fn four_ax2000_draw_in_digital_current() {
    let report = draw(SlaveKind::Ax2000, AxisMode::Torque);
    assert!(report.path_deviation_max_mm <= TORQUE_DEVIATION_MAX_MM);
}

#[test]
fn four_generic_drives_draw_in_cyclic_synchronous_torque() {
    let report = draw(SlaveKind::Cia402, AxisMode::Torque);
    assert!(report.path_deviation_max_mm <= TORQUE_DEVIATION_MAX_MM);
}

#[test]
fn four_generic_drives_draw_in_cyclic_synchronous_position() {
    let report = draw(SlaveKind::Cia402, AxisMode::Position);
    assert!(report.path_deviation_max_mm <= DEVIATION_MAX_MM);
}

#[test]
fn four_akd_draw_in_cyclic_synchronous_velocity() {
    let report = draw(SlaveKind::Akd, AxisMode::Velocity);
    assert!(report.path_deviation_max_mm <= DEVIATION_MAX_MM);
}

#[test]
fn four_akd_draw_in_cyclic_synchronous_position() {
    let report = draw(SlaveKind::Akd, AxisMode::Position);
    assert!(report.path_deviation_max_mm <= TARGET_ALONE_DEVIATION_MAX_MM);
}
