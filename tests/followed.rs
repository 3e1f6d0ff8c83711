//! A drawing counts as finished only if the pen was measured where the path required it.
//!
//! Truth is the ink on the virtual paper: whatever a drive does without a fault, a job that ends well has left all of
//! it.

use etherpen::config::Config;
use etherpen::motion::{Pen, Vertex};
use host_tools::drawing::preparation::prepare::prepare;
use host_tools::job::error::JobError;
use host_tools::run::task;
use host_tools::run::{Drawn, RunTask, simulate};
use std::path::Path;

/// Ink that may be missing of a drawing that counts as finished, mm.
const INK_MISSING_MAX_MM: f64 = 1.0;

/// A place of the path counts as drawn with ink within this distance, mm.
const INK_REACH_MM: f64 = 0.5;
/// Distance between the places that are checked, mm.
const STEP_MM: f64 = 0.1;

/// Intended length without ink near it, mm: every place against every point of ink.
fn ink_missing_mm(task: &RunTask, path: &[Vertex], drawn: &Drawn) -> f64 {
    let paper = &task.config.paper;
    let mut missing_mm = 0.0;
    for pair in path.windows(2).filter(|pair| pair[1].pen == Pen::Down) {
        let (a, b) = (pair[0].position, pair[1].position);
        let length_mm = (b.x_mm - a.x_mm).hypot(b.y_mm - a.y_mm);
        let count = (length_mm / STEP_MM).ceil() as usize;
        for k in 0..count {
            let part = (k as f64 + 0.5) / count as f64;
            let x = a.x_mm + part * (b.x_mm - a.x_mm) - paper.centre_mm[0] + 0.5 * paper.size_mm[0];
            let y = paper.centre_mm[1] + 0.5 * paper.size_mm[1] - a.y_mm - part * (b.y_mm - a.y_mm);
            let mut ink = drawn.cell.ink().iter().flat_map(|line| &line.points_mm);
            if !ink.any(|point| (point[0] - x).hypot(point[1] - y) <= INK_REACH_MM) {
                missing_mm += length_mm / count as f64;
            }
        }
    }
    missing_mm
}

#[test]
fn a_drive_whose_processor_stands_still_does_not_leave_a_drawing_that_counts_as_finished() {
    let config = Config::default();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/strokes.csv");
    let prepared = prepare(&file, &config).expect("the sample can be drawn");
    let task = task(&config, &prepared);
    let (mut refused, mut faults, mut whole) = (0, 0, 0);
    let mut unnoticed = Vec::new();
    for slave in 1..=3 {
        for at_ms in (4_000..9_000).step_by(500) {
            let mut task = task.clone();
            task.cell.faults = format!("ms {at_ms} pdi {slave} 900").parse().expect("a script");
            let drawn = simulate(&task, None, &mut |_| {}).expect("nothing is captured");
            let ink_missing_mm = ink_missing_mm(&task, &prepared.path, &drawn);
            let verdict = drawn.job.verification.verdict();
            println!(
                "slave {slave} at {at_ms} ms: {ink_missing_mm:.1} mm of ink missing, {:?}, {:.1} mm noticed",
                drawn.outcome, verdict.missing_mm
            );
            match drawn.outcome {
                Some(Ok(())) => {
                    whole += 1;
                    if ink_missing_mm > INK_MISSING_MAX_MM {
                        unnoticed.push((slave, at_ms, ink_missing_mm));
                    }
                }
                Some(Err(JobError::NotFollowed { .. })) => refused += 1,
                _ => faults += 1,
            }
        }
    }
    println!("{refused} not followed, {faults} ended with a fault, {whole} whole");
    assert!(unnoticed.is_empty(), "{unnoticed:?}");
}
