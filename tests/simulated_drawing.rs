//! The short drawing by the firmware's tasks in virtual time, without the emulator: undisturbed, and over a bad line.

mod broken;
mod golden;

use broken::{BadLine, assert_same_ink};
use host_tools::cell::{Cell, Physics};
use host_tools::drawing::preparation::prepare::Prepared;
use host_tools::report::output::Outcome;
use host_tools::run::{RunTask, simulate};
use host_tools::simulation;

/// Virtual time within which every such drawing is done, ms.
const LIMIT_MS: u32 = 600_000;

#[test]
fn the_drawing_in_virtual_time_is_clean_and_the_golden_one() {
    let (prepared, task) = golden::strokes();
    let drawn = simulate(&task, None, &mut |_| {}).expect("nothing is captured");
    let report = golden::assert_clean(&prepared, &task, &drawn);
    golden::compare(&task, &drawn, &report);
}

#[test]
fn over_a_bad_line_unplugged_three_times_the_resumed_drawing_is_the_undisturbed_one() {
    let (_, task) = golden::strokes();
    let undisturbed = simulate(&task, None, &mut |_| {}).expect("nothing is captured");
    for seed in [1, 0x5eed, 0xbad_cab1e] {
        let mut cell = Cell::new(&task.config, task.cell.clone());
        let mut line = BadLine::new(&task, seed);
        let passed_ms = simulation::run(&mut cell, &mut line, LIMIT_MS);
        println!("{passed_ms} ms, {} spoilt frames", line.bad_frames);
        line.assert_reported();
        assert_same_ink(undisturbed.cell.ink(), cell.ink());
    }
}

/// The ink of the pessimistic cell, mm from its lines: what the present controller reaches, see `docs/cell.md`.
const PESSIMISTIC_MAX_MM: f64 = 1.5;

#[test]
fn a_robot_that_is_hard_to_control_draws_to_the_end_without_a_fault_and_repeats_itself() {
    let (prepared, task) = golden::strokes();
    for seed in 1..=4 {
        let mut task = task.clone().in_cell(Physics::PESSIMISTIC);
        task.cell.seed = seed;
        assert_draws_to_the_end(&prepared, &task);
    }
}

fn assert_draws_to_the_end(prepared: &Prepared, task: &RunTask) {
    let drawn = simulate(task, None, &mut |_| {}).expect("nothing is captured");
    let state = drawn.cell.state();
    assert!(state.slaves.iter().all(|slave| slave.drive_error == 0), "{state:?}");
    assert_eq!(
        (state.contacts_outside, state.unreachable_ms, state.end_stop_ms),
        (0, 0, 0)
    );
    let report = Outcome {
        config: &task.config,
        prepared,
        job: &drawn.job,
        cell: Some((&drawn.cell, &task.cell)),
        image: String::new(),
        planned_s: f64::NAN,
        completed: false,
    }
    .report();
    println!(
        "seed {}: ink {:.3} mm at most, {:.3} mm rms; {:.1} mm missing",
        task.cell.seed, report.ink_deviation_max_mm, report.ink_deviation_rms_mm, report.ink_missing_mm
    );
    assert!(report.ink_deviation_max_mm < PESSIMISTIC_MAX_MM);
    let again = simulate(task, None, &mut |_| {}).expect("nothing is captured");
    assert!(drawn.cell.ink() == again.cell.ink(), "another picture");
}
