//! The short drawing, the requirements on every run, and the values that runs are compared with.
//!
//! The golden file beside this one is a table that a person can read: figures of the report, then where the pen was ten
//! times a second. The tasks in virtual time and the firmware image in the emulator are compared with the same file.
//! After an intended change, run `ETHERPEN_RENEW_GOLDEN=1 cargo test --test simulated_drawing` and review the
//! difference. Values are compared within a tolerance, because the sine of another machine may differ.

use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::Sample;
use etherpen::robots::AXES;
use host_tools::drawing::preparation::prepare::{Prepared, prepare};
use host_tools::report::output::conclude;
use host_tools::report::{Report, rows};
use host_tools::run::task;
use host_tools::run::{Drawn, RunTask};
use std::fmt::Write;
use std::path::Path;

/// Farthest the pen, and its ink, may be from their line, mm.
const DEVIATION_MAX_MM: f64 = 0.1;
/// How much a value may differ from its golden one, in the value's own unit.
const TOLERANCE: f64 = 0.005;
/// Milliseconds between two positions of the table.
const POSITION_EVERY_MS: usize = 100;
/// The golden file, from the root.
const GOLDEN: &str = "tests/golden/strokes.csv";
/// Set to write the golden file instead of comparing with it.
const RENEW: &str = "ETHERPEN_RENEW_GOLDEN";

/// The short drawing, ready to be drawn.
pub(crate) fn strokes() -> (Prepared, RunTask) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/strokes.csv");
    let config = Config::default();
    let prepared = prepare(&file, &config).expect("the sample can be drawn");
    let task = task(&config, &prepared);
    (prepared, task)
}

/// Asserts that a run drew everything, in time and without a loss; returns its report.
pub(crate) fn assert_clean(prepared: &Prepared, task: &RunTask, drawn: &Drawn) -> Report {
    let report = conclude(task, prepared, drawn, String::new(), None).expect("the drawing was drawn");
    let counted = [
        report.cycles_late,
        report.frames_lost,
        report.working_counter_errors,
        report.reference_underruns,
        report.path_starvations,
        report.telemetry_lost,
    ];
    assert_eq!(
        counted, [0; 6],
        "late, lost, working counter, underruns, starvations, telemetry"
    );
    assert!(report.cycles > 0);
    assert_eq!(report.ink_missing_mm, 0.0);
    assert!(report.path_deviation_max_mm <= DEVIATION_MAX_MM, "{report:?}");
    assert!(report.ink_deviation_max_mm <= DEVIATION_MAX_MM, "{report:?}");
    assert!(
        report.shaping_deviation_max_mm <= report.shaping_tolerance_mm,
        "{report:?}"
    );
    for axis in &report.limits {
        for [reached, limit] in [axis.speed, axis.acceleration] {
            assert!(reached <= limit, "{axis:?}");
        }
    }
    report
}

/// Compares a run with the golden file, or writes the file if [`RENEW`] is set.
pub(crate) fn compare(task: &RunTask, drawn: &Drawn, report: &Report) {
    let table = table(task, drawn, report);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(GOLDEN);
    if std::env::var_os(RENEW).is_some() {
        std::fs::write(&path, &table).expect("the golden file can be written");
        return;
    }
    let golden = std::fs::read_to_string(&path).expect("the golden file; see its module for how to make it");
    let (golden, table): (Vec<_>, Vec<_>) = (golden.lines().collect(), table.lines().collect());
    assert_eq!(golden.len(), table.len(), "lines of {GOLDEN}; {RENEW}=1 renews it");
    for (golden, now) in golden.iter().zip(&table) {
        let same = golden.split(',').count() == now.split(',').count()
            && golden
                .split(',')
                .zip(now.split(','))
                .all(|(golden, now)| is_close(golden, now));
        assert!(same, "{GOLDEN} has {golden}, this run {now}; {RENEW}=1 renews it");
    }
}

fn is_close(golden: &str, now: &str) -> bool {
    match (golden.parse::<f64>(), now.parse::<f64>()) {
        (Ok(golden), Ok(now)) => (golden - now).abs() <= TOLERANCE,
        _ => golden == now,
    }
}

fn table(task: &RunTask, drawn: &Drawn, report: &Report) -> String {
    let ink = drawn.cell.ink();
    let ink_mm: f64 = ink
        .iter()
        .flat_map(|stroke| stroke.points_mm.windows(2))
        .map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]))
        .sum();
    let figures = [
        ("strokes", report.strokes as f64),
        ("pen_down_mm", report.pen_down_mm),
        ("pen_up_mm", report.pen_up_mm),
        ("planned_s", report.planned_s),
        ("moved_s", motion(&drawn.job.samples).len() as f64 / 1_000.0),
        ("path_deviation_max_mm", report.path_deviation_max_mm),
        ("path_deviation_rms_mm", report.path_deviation_rms_mm),
        ("ink_strokes", ink.len() as f64),
        ("ink_mm", ink_mm),
    ];
    let mut text = String::new();
    for (name, value) in figures {
        writeln!(text, "{name},{value:.4}").expect("memory");
    }
    let drawing = rows(&task.config, motion(&drawn.job.samples));
    writeln!(text, "ms,mode,stroke,x_mm,y_mm,z_mm").expect("memory");
    for (ms, row) in drawing.iter().enumerate().step_by(POSITION_EVERY_MS) {
        let (mode, at) = (row.sample.mode, row.position);
        let (x_mm, y_mm, z_mm) = (at.x_mm, at.y_mm, at.z_mm);
        writeln!(text, "{ms},{mode:?},{},{x_mm:.4},{y_mm:.4},{z_mm:.4}", row.stroke).expect("memory");
    }
    text
}

/// From the first to the last sample in which a setpoint moves, so that it does not matter in which millisecond of the
/// planner's period the drawing was requested.
fn motion(samples: &[Sample]) -> &[Sample] {
    let moves = |sample: &Sample| sample.mode == Mode::Drawing && sample.setpoint_rad_s != [0.0; AXES];
    let first = samples.iter().position(moves).unwrap_or(samples.len());
    let last = samples.iter().rposition(moves).map_or(first, |last| last + 1);
    &samples[first..last]
}
