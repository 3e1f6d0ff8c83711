//! Delay and gain of the virtual drives, found by the firmware's tasks and a test motion in virtual time.
//!
//! The figures of each run are printed (`cargo test --test identification -- --nocapture`).

use etherpen::config::{AxisMode, Config};
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::messages::Sample;
use host_tools::cell::{CellOptions, Physics};
use host_tools::drawing::preparation::prepare::prepare;
use host_tools::identification::{apply, identify, identify_with_weak, test_config, test_path, weak_config};
use host_tools::report::Report;
use host_tools::report::output::conclude;
use host_tools::run::task;
use host_tools::run::{self, RunTask};
use std::path::Path;

/// How far a lead may be from the cell's, ms.
const LEAD_MS: f64 = 0.1;
/// How far a gain may be from the cell's.
const GAIN: f64 = 0.002;
/// How far the gain of a position loop may be from the cell's.
const LOOP_GAIN: f64 = 0.25;
/// How far the lead of a target may be from the cell's, ms.
const POSITION_LEAD_MS: f64 = 0.15;
/// Farthest ink from its line after an identification in position mode, mm.
const INK_MM: f64 = 0.07;

/// The lead that the cell's drives require, ms: the delays of both directions, half a millisecond for sampling, and the
/// drive's lag 1 / (2 pi f), less the age of the measurement, which is compared with the setpoint of that age.
fn true_lead_ms(cell: &CellOptions, measurement_age_ms: f64) -> f64 {
    let Physics {
        dead_time,
        velocity_loop,
        ..
    } = cell.physics;
    let delays = f64::from(dead_time.command_cycles + dead_time.position_cycles);
    let lag_ms = 1_000.0 / (std::f64::consts::TAU * velocity_loop.bandwidth_hz);
    delays + 0.5 + lag_ms - measurement_age_ms
}

fn test_motion(config: &Config, cell: &CellOptions) -> Vec<Sample> {
    let test = test_config(config);
    let task = RunTask {
        path: test_path(&test),
        config: test,
        cell: cell.clone(),
    };
    let drawn = run::simulate(&task, None, &mut |_| {}).expect("nothing is captured");
    assert_eq!(drawn.outcome, Some(Ok(())));
    drawn.job.samples
}

fn identified(config: &Config, cell: &CellOptions) -> Config {
    let first = test_motion(config, cell);
    let answers = match config.axes[0].mode {
        AxisMode::Position => identify_with_weak(config, &first, &test_motion(&weak_config(config), cell)),
        AxisMode::Velocity | AxisMode::Torque => identify(config, &first),
    };
    let mut found = config.clone();
    apply(&mut found, &answers, None);
    found
}

fn drawn(config: &Config, cell: &CellOptions) -> Report {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/strokes.csv");
    let prepared = prepare(&file, config).expect("the sample can be drawn");
    let mut task = task(config, &prepared);
    task.cell = cell.clone();
    let drawn = run::simulate(&task, None, &mut |_| {}).expect("nothing is captured");
    conclude(&task, &prepared, &drawn, String::new(), None).expect("the drawing was drawn")
}

#[test]
fn a_wrong_lead_and_a_wrong_gain_are_found_and_the_drawn_line_comes_closer() {
    let cells = [(100.0, 1, 1), (200.0, 1, 1), (50.0, 1, 1), (100.0, 1, 2), (100.0, 0, 0)];
    for (bandwidth_hz, position_cycles, command_cycles) in cells {
        let mut cell = CellOptions::default();
        cell.physics.velocity_loop.bandwidth_hz = bandwidth_hz;
        cell.physics.dead_time.position_cycles = position_cycles;
        cell.physics.dead_time.command_cycles = command_cycles;
        let mut wrong = Config::default();
        let truth_ms = true_lead_ms(&cell, wrong.axes[0].measurement_age_ms);
        for axis in &mut wrong.axes {
            axis.feed_forward_lead_ms = truth_ms + 1.0;
            axis.feed_forward_gain = 1.02;
        }
        let found = identified(&wrong, &cell);
        for axis in &found.axes {
            let (lead_ms, gain) = (axis.feed_forward_lead_ms, axis.feed_forward_gain);
            println!(
                "{bandwidth_hz} Hz, {position_cycles}/{command_cycles} cycles: lead {lead_ms:.4} ms of {truth_ms:.4}, Kff {gain:.5}, Kfb {:.1}",
                axis.feedback_gain_per_s
            );
            assert!((lead_ms - truth_ms).abs() < LEAD_MS, "{lead_ms} ms of {truth_ms} ms");
            assert!((gain - 1.0).abs() < GAIN, "{gain}");
        }
        let (before, after) = (drawn(&wrong, &cell), drawn(&found, &cell));
        println!(
            "deviation {:.4} mm, tracking {:.4} mm before; {:.4} mm, {:.4} mm after",
            before.path_deviation_max_mm,
            before.tracking_error_max_mm,
            after.path_deviation_max_mm,
            after.tracking_error_max_mm
        );
        assert!(after.path_deviation_max_mm < before.path_deviation_max_mm);
        assert!(after.path_deviation_max_mm <= 0.1, "{} mm", after.path_deviation_max_mm);
    }
}

#[test]
fn one_telegram_for_both_directions_needs_no_other_leads() {
    for mode in [AxisMode::Velocity, AxisMode::Position] {
        let cell = CellOptions::default();
        let [split, combined] = [ExchangeKind::Split, ExchangeKind::Combined].map(|exchange| {
            let mut config = Config::default();
            config.bus.exchange = exchange;
            config.axes.iter_mut().for_each(|axis| axis.mode = mode);
            let found = identified(&config, &cell);
            let axis = found.axes[0];
            let ink_mm = drawn(&config, &cell).ink_deviation_max_mm;
            println!(
                "{mode:?}, {exchange:?}: lead {:.4} ms, of the target {:.4} ms, ink {ink_mm:.4} mm",
                axis.feed_forward_lead_ms, axis.position_lead_ms
            );
            (axis, ink_mm)
        });
        let (lead_ms, before_ms) = (combined.0.feed_forward_lead_ms, split.0.feed_forward_lead_ms);
        assert!((lead_ms - before_ms).abs() < LEAD_MS, "{lead_ms} ms, {before_ms} ms");
        let (lead_ms, before_ms) = (combined.0.position_lead_ms, split.0.position_lead_ms);
        assert!(
            (lead_ms - before_ms).abs() < POSITION_LEAD_MS,
            "{lead_ms} ms, {before_ms} ms"
        );
        // At 400 mm/s a millisecond is 0.4 mm.
        assert!(combined.1 < split.1 + 0.01, "{} mm, {} mm", combined.1, split.1);
    }
}

#[test]
fn in_position_mode_leads_and_loop_gain_are_found_and_the_ink_keeps_to_its_line() {
    // Gain of the position loop, bandwidth below it, cycles of position and command.
    let cells = [(100.0, 100.0, 1, 1), (60.0, 100.0, 1, 2), (150.0, 200.0, 0, 1)];
    for (gain_per_s, bandwidth_hz, position_cycles, command_cycles) in cells {
        let mut cell = CellOptions::default();
        cell.physics.position_loop.gain_per_s = gain_per_s;
        cell.physics.velocity_loop.bandwidth_hz = bandwidth_hz;
        cell.physics.dead_time.position_cycles = position_cycles;
        cell.physics.dead_time.command_cycles = command_cycles;
        let mut wrong = Config::default();
        let age_ms = wrong.axes[0].measurement_age_ms;
        // A millisecond of interpolation, less the sampling of a velocity in the middle of its own.
        let truth_ms = f64::from(position_cycles + command_cycles) + 1.0 - age_ms;
        let velocity_truth_ms = true_lead_ms(&cell, age_ms);
        for axis in &mut wrong.axes {
            axis.mode = AxisMode::Position;
            axis.position_lead_ms = truth_ms + 1.0;
            axis.feed_forward_lead_ms = velocity_truth_ms + 0.5;
        }
        let found = identified(&wrong, &cell);
        for axis in &found.axes {
            println!(
                "{gain_per_s} /s, {bandwidth_hz} Hz, {position_cycles}/{command_cycles} cycles: lead {:.4} ms of \
                 {truth_ms:.4}, velocity {:.4} ms of {velocity_truth_ms:.4}, gain {:.2} /s",
                axis.position_lead_ms, axis.feed_forward_lead_ms, axis.feedback_gain_per_s
            );
            assert!(
                (axis.position_lead_ms - truth_ms).abs() < POSITION_LEAD_MS,
                "{truth_ms} ms"
            );
            assert!(
                (axis.feed_forward_lead_ms - velocity_truth_ms).abs() < 4.0 * LEAD_MS,
                "{velocity_truth_ms} ms"
            );
            assert!(
                (axis.feedback_gain_per_s / gain_per_s - 1.0).abs() < LOOP_GAIN,
                "{gain_per_s} /s"
            );
        }
        let after = drawn(&found, &cell);
        println!(
            "deviation {:.4} mm, ink {:.4} mm",
            after.path_deviation_max_mm, after.ink_deviation_max_mm
        );
        assert!(
            after.ink_deviation_max_mm <= INK_MM,
            "{} mm",
            after.ink_deviation_max_mm
        );
    }
}
