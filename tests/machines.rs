//! Every bundled machine draws: in virtual time, and the ones with terminals also as the firmware image in the emulator.
//!
//! The truth is the ink of the virtual cell, whose bodies, end stops, switches and pen are not the controller's.

use host_tools::drawing::preparation::prepare::{Prepared, prepare};
use host_tools::report::Report;
use host_tools::report::output::conclude;
use host_tools::run::{Drawn, RunTask, emulate, simulate, task};
use host_tools::settings::machines::{MACHINES, Machine};
use host_tools::setup;
use std::path::Path;

/// Farthest the ink may be from its line, mm.
const DEVIATION_MAX_MM: f64 = 0.1;

/// The short drawing on a machine.
fn strokes(machine: &Machine) -> (Prepared, RunTask) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/strokes.csv");
    let config = machine.load().expect("a bundled machine");
    let prepared = prepare(&file, &config).expect("the sample can be drawn");
    let task = task(&config, &prepared);
    (prepared, task)
}

fn assert_clean(machine: &Machine, prepared: &Prepared, task: &RunTask, drawn: &Drawn) -> Report {
    let report = conclude(task, prepared, drawn, String::new(), None).expect("the drawing was drawn");
    let state = drawn.cell.state();
    println!(
        "{}: ink {:.4} mm at most, {:.4} mm rms, {} strokes in {:.2} s",
        machine.name, report.ink_deviation_max_mm, report.ink_deviation_rms_mm, report.strokes, report.drawn_s
    );
    let counted = [
        report.cycles_late,
        report.frames_lost,
        report.working_counter_errors,
        report.reference_underruns,
    ];
    assert_eq!(counted, [0; 4], "{}: late, lost, counters, underruns", machine.name);
    assert_eq!(
        (state.contacts_outside, state.unreachable_ms, state.end_stop_ms),
        (0, 0, 0),
        "{}: off the sheet, without a pose, at an end stop",
        machine.name
    );
    assert_eq!(report.ink_missing_mm, 0.0, "{}", machine.name);
    assert!(
        report.ink_deviation_max_mm <= DEVIATION_MAX_MM,
        "{}: {report:?}",
        machine.name
    );
    // No line of ink that nobody ordered.
    let [ordered, drawn] = [report.strokes, drawn.cell.ink().len()];
    assert_eq!(ordered, drawn, "{}: strokes", machine.name);
    assert_eq!(report.limits.len(), usize::from(task.config.bus.drives));
    for axis in &report.limits {
        for [reached, limit] in [axis.speed, axis.acceleration] {
            assert!(reached <= limit, "{}: {axis:?}", machine.name);
        }
    }
    report
}

#[test]
fn every_bundled_machine_draws_its_lines_in_virtual_time() {
    for machine in &MACHINES {
        let (prepared, task) = strokes(machine);
        for seed in [1, 7] {
            let mut task = task.clone();
            task.cell.seed = seed;
            let drawn = simulate(&task, None, &mut |_| {}).expect("nothing is captured");
            assert_clean(machine, &prepared, &task, &drawn);
        }
    }
}

#[test]
fn a_gantry_that_homes_by_its_switches_and_a_corexy_with_a_solenoid_draw_as_the_firmware_image() {
    setup::ensure_qemu().expect("the emulator can be had");
    let image = setup::build_firmware("emulated").expect("the firmware builds");
    for machine in MACHINES
        .iter()
        .filter(|machine| matches!(machine.name, "gantry" | "corexy"))
    {
        let (prepared, task) = strokes(machine);
        let drawn = emulate(&task, &image, None, &mut |_| {}, |_| {}).expect("the emulator runs");
        assert_clean(machine, &prepared, &task, &drawn);
    }
}
