//! The tour of the style of one line, compared with that of LKH (Helsgaun) through the same points.
//!
//! LKH comes from PyPI in elkai. It gets the vertices of the drawing as they are, and a further point without distance to any of
//! them: a tour through that is an open line through the others.

use super::{failed, sample, wants};
use crate::bench::{BenchError, BenchRow, Selection};
use crate::drawing::{Drawing, Input, Style, VectorizeOptions, load, vectorize_image};
use crate::setup;
use std::io::Write;
use std::process::{Command, Stdio};

/// Most drawing time of the compared lines, s: some two thousand points. LKH's memory grows with the square of their number.
const TIME_S: f64 = 40.0;
/// Largest ratio of the line's length to that of LKH's tour.
const RATIO_MAX: f64 = 1.05;
const CASE: &str = "one_line_mm";
/// The photographs.
const PHOTOGRAPHS: [&str; 2] = ["astronaut.png", "camera.png"];
/// Reads points, one a line; prints the length of LKH's tour. Distances are whole micrometres.
const LKH: &str = r#"
import elkai, math, sys
points = [tuple(map(float, line.split())) for line in sys.stdin]
nowhere = [0] * (len(points) + 1)
distances = [nowhere] + [[0] + [round(1000 * math.dist(a, b)) for b in points] for a in points]
tour = [k - 1 for k in elkai.DistanceMatrix(distances).solve_tsp(runs=1) if k]
print(sum(math.dist(points[a], points[b]) for a, b in zip(tour, tour[1:])))
"#;

/// Appends the lengths of the selected photographs' lines, links between their pieces included, beside LKH's.
pub(super) fn run(selection: &Selection, progress: &impl Fn(&str), rows: &mut Vec<BenchRow>) -> Result<(), BenchError> {
    for file in PHOTOGRAPHS {
        if !["etherpen", "lkh"]
            .iter()
            .any(|subject| wants(selection, file, &[CASE], subject))
        {
            continue;
        }
        progress(&format!(
            "{file} as one line; LKH takes a minute or more for its points"
        ));
        let points = one_line(file)?;
        let shortest_mm = lkh_mm(&points)?;
        let drawn_mm = points.windows(2).map(|pair| distance_mm(pair[0], pair[1])).sum();
        let mut row = |subject, value, target| {
            rows.push(BenchRow {
                case: format!("{CASE}/{file}"),
                subject,
                value,
                unit: "mm",
                target,
            });
        };
        row("etherpen", drawn_mm, Some(RATIO_MAX * shortest_mm));
        row("lkh", shortest_mm, None);
    }
    Ok(())
}

/// All vertices of the drawing of one line, in the order of drawing.
fn one_line(file: &str) -> Result<Vec<[f64; 2]>, BenchError> {
    let Input::Photograph(picture) = load(sample(file)).map_err(|cause| failed(file, cause))? else {
        return Err(failed(file, "this is no photograph"));
    };
    let options = VectorizeOptions {
        style: Style::Tsp,
        time_max_s: TIME_S,
        ..VectorizeOptions::default()
    };
    let Drawing { strokes, .. } = vectorize_image(&picture, &options).map_err(|cause| failed(file, cause))?;
    Ok(strokes.into_iter().flat_map(|stroke| stroke.points).collect())
}

fn distance_mm(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Length of LKH's tour.
fn lkh_mm(points: &[[f64; 2]]) -> Result<f64, BenchError> {
    let failed = |cause: String| failed("elkai", cause);
    let python = setup::ensure_elkai()?;
    let mut lkh = Command::new(python)
        .args(["-c", LKH])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|cause| failed(cause.to_string()))?;
    let lines: String = points.iter().map(|[x, y]| format!("{x} {y}\n")).collect();
    if let Some(mut input) = lkh.stdin.take() {
        // A program that ends before it has read everything tells why in its output.
        let _ = input.write_all(lines.as_bytes());
    }
    let output = lkh.wait_with_output().map_err(|cause| failed(cause.to_string()))?;
    let printed = String::from_utf8_lossy(&output.stdout);
    printed.trim().parse().map_err(|_| {
        failed(format!(
            "{}: {}",
            output.status,
            String::from_utf8_lossy(&output.stderr)
        ))
    })
}
