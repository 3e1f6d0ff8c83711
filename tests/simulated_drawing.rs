//! The short drawing by the firmware's tasks in virtual time, without the emulator: undisturbed, and over a bad line.

mod broken;
mod golden;

use broken::{BadLine, assert_same_ink};
use host_tools::cell::Cell;
use host_tools::run::simulate;
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
