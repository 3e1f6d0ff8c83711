//! The order of strokes compared with vpype's.
//!
//! Both programs order the same files in one run, without reading and writing; the fastest of three runs counts. The
//! best known tour is this program's own with forty times the effort, or vpype's if that is shorter. Seconds depend on
//! the computer; the target is a share of vpype's time on it. Drawing times come from the firmware's planner at its
//! default limits; vpype converts curves into its own lines.

use super::{RUNS, failed, sample, wants};
use crate::bench::{BenchError, BenchRow, Selection};
use crate::drawing::preparation::choose_order::travelling;
use crate::drawing::{Drawing, Input, OrderOptions, OrderReport, Stroke, Travel, load, order, order_with_effort};
use crate::planning::planned_s;
use crate::random::Random;
use crate::setup;
use etherpen::config::Config;
use serde::Deserialize;
use std::process::{Command, Stdio};
use std::time::Instant;

/// Largest gap closed by both programs, mm: vpype's default.
const JOIN_MM: f64 = 0.05;
/// Effort of the search for the best tour.
const BEST_EFFORT: usize = 40;
/// Largest mean ratio of the travel lengths to the best known ones; no travel may be longer than the given one.
const PEN_UP_RATIO_MAX: f64 = 1.05;
/// Share of vpype's time that the order may take.
const TIME_SHARE_MAX: f64 = 0.1;
/// Strokes of a generated drawing, its name, and the time in which it is ordered at most, s.
const GENERATED_STROKES: usize = 3_000;
const GENERATED: &str = "3000-strokes";
const GENERATED_S_MAX: f64 = 0.1;
/// The vector files.
const VECTORS: [&str; 4] = ["contours.svg", "grass.svg", "portrait.svg", "streets.svg"];
/// Orders files with vpype and prints a line of JSON for each.
const VPYPE: &str = r#"
import copy, json, sys, time
import vpype
from vpype_cli import execute
for path in sys.argv[1:]:
    given = execute(f'read "{path}"')
    best = None
    for _ in range(3):
        begun = time.perf_counter()
        ordered = execute('linemerge linesort --two-opt', copy.deepcopy(given))
        seconds = time.perf_counter() - begun
        best = seconds if best is None else min(best, seconds)
    mm = 25.4 / 96
    lines = [[[p.real * mm, p.imag * mm] for p in line] for layer in ordered.layers.values() for line in layer]
    print(json.dumps({'seconds': best, 'strokes': lines, 'pen_up_mm': ordered.pen_up_length() * mm}))
"#;

/// Result of vpype for a file.
#[derive(Clone, Debug, Deserialize)]
struct Peer {
    seconds: f64,
    strokes: Vec<Vec<[f64; 2]>>,
    pen_up_mm: f64,
}

/// Appends the figures of the selected vector files.
pub(super) fn run(selection: &Selection, progress: &impl Fn(&str), rows: &mut Vec<BenchRow>) -> Result<(), BenchError> {
    let wants = |file: &str, names: &[&str], subject: &str| wants(selection, file, names, subject);
    let ordered = ["pen_up_mm", "lifts", "seconds", "drawing_s"];
    let wanted = VECTORS.into_iter().filter(|file| {
        ["etherpen", "vpype", "best known"]
            .iter()
            .any(|subject| wants(file, &ordered, subject))
    });
    let files: Vec<&str> = wanted.collect();
    let has_peer = files.iter().any(|file| wants(file, &ordered, "vpype"));
    let peers = if has_peer { vpype(&files, progress)? } else { Vec::new() };
    for (k, file) in files.into_iter().enumerate() {
        progress(&format!("ordering {file}"));
        vectors(file, peers.get(k), rows)?;
    }
    mean_ratio(rows);
    if wants(GENERATED, &["seconds"], "etherpen") {
        progress("ordering generated strokes");
        rows.push(BenchRow {
            case: format!("seconds/{GENERATED}"),
            subject: "etherpen",
            value: fastest(&generated(), &OrderOptions::default()).0,
            unit: "s",
            target: Some(GENERATED_S_MAX),
        });
    }
    Ok(())
}

/// Short strokes anywhere on a sheet.
fn generated() -> Drawing {
    let mut random = Random::new(1);
    let strokes = (0..GENERATED_STROKES).map(|_| {
        let [x_mm, y_mm] = [(); 2].map(|()| 10.0 + 170.0 * random.unit());
        let [across_mm, down_mm] = [(); 2].map(|()| 12.0 * random.unit() - 6.0);
        Stroke {
            points: vec![[x_mm, y_mm], [x_mm + across_mm, y_mm + down_mm]],
        }
    });
    Drawing {
        sheet_mm: [200.0; 2],
        strokes: strokes.collect(),
    }
}

/// Time of the fastest of several runs, s, with what it did.
fn fastest(given: &Drawing, options: &OrderOptions) -> (f64, OrderReport, Drawing) {
    let timed = || {
        let mut drawing = given.clone();
        let begun = Instant::now();
        let report = order(&mut drawing, options);
        (begun.elapsed().as_secs_f64(), report, drawing)
    };
    let first = timed();
    (1..RUNS).fold(first, |fastest, _| {
        let next = timed();
        if next.0 < fastest.0 { next } else { fastest }
    })
}

fn vectors(file: &str, peer: Option<&Peer>, rows: &mut Vec<BenchRow>) -> Result<(), BenchError> {
    let Input::Artwork(artwork) = load(sample(file)).map_err(|cause| failed(file, cause))? else {
        return Err(failed(file, "this is no vector file"));
    };
    let given = Drawing {
        sheet_mm: artwork.page_mm.unwrap_or_default(),
        strokes: artwork.strokes.into_iter().map(|stroke| stroke.stroke).collect(),
    };
    let options = OrderOptions {
        join_gap_mm: JOIN_MM,
        ..OrderOptions::default()
    };
    let (seconds, report, drawing) = fastest(&given, &options);
    let shortest = OrderOptions {
        travel: Travel::Length,
        ..options
    };
    let long = order_with_effort(&mut given.clone(), &shortest, BEST_EFFORT).pen_up_mm_after;
    let best = peer
        .map_or(long, |peer| peer.pen_up_mm.min(long))
        .min(report.pen_up_mm_after);
    let mut row = |name: &str, subject, value, unit, target| {
        rows.push(BenchRow {
            case: format!("{name}/{file}"),
            subject,
            value,
            unit,
            target,
        });
    };
    let (way_mm, lifts) = (report.pen_up_mm_after, report.lifts_after as f64);
    let peers_lifts = peer.map(|peer| peer.strokes.len() as f64);
    let seconds_max = peer.map(|peer| TIME_SHARE_MAX * peer.seconds);
    row("pen_up_mm", "etherpen", way_mm, "mm", Some(given.pen_up_mm()));
    row("pen_up_mm", "best known", best, "mm", None);
    row("pen_up_mm", "as given", given.pen_up_mm(), "mm", None);
    row("lifts", "etherpen", lifts, "lifts", peers_lifts);
    row("lifts", "as given", given.strokes.len() as f64, "lifts", None);
    row("seconds", "etherpen", seconds, "s", seconds_max);
    for (subject, seconds, target) in drawing_times(&given, &drawing, peer) {
        row("drawing_s", subject, seconds, "s", target);
    }
    if let Some(peer) = peer {
        row("pen_up_mm", "vpype", peer.pen_up_mm, "mm", None);
        row("lifts", "vpype", peer.strokes.len() as f64, "lifts", None);
        row("seconds", "vpype", peer.seconds, "s", None);
    }
    Ok(())
}

/// Planned duration of the strokes as ordered here, as given and as ordered by the peer, s, with the target.
fn drawing_times(given: &Drawing, ordered: &Drawing, peer: Option<&Peer>) -> Vec<(&'static str, f64, Option<f64>)> {
    let config = Config::default();
    let planned_s = |drawing: &Drawing| planned_s(&config, &travelling(drawing, &config));
    let peers = peer.map(|peer| {
        let strokes = peer.strokes.iter().map(|points| Stroke { points: points.clone() });
        planned_s(&Drawing {
            sheet_mm: given.sheet_mm,
            strokes: strokes.collect(),
        })
    });
    let given_s = planned_s(given);
    let target_s = peers.map_or(given_s, |peers_s| peers_s.min(given_s));
    let ours = ("etherpen", planned_s(ordered), Some(target_s));
    let others = [("as given", given_s, None)].into_iter();
    let others = others.chain(peers.map(|peers_s| ("vpype", peers_s, None)));
    [ours].into_iter().chain(others).collect()
}

/// The mean ratio of travel length to the best known length, over all vector files.
fn mean_ratio(rows: &mut Vec<BenchRow>) {
    for subject in ["etherpen", "vpype"] {
        let ratio = |row: &BenchRow| {
            let best = rows
                .iter()
                .find(|best| best.case == row.case && best.subject == "best known")?;
            (row.subject == subject).then_some(row.value / best.value)
        };
        let ratios: Vec<f64> = rows.iter().filter_map(ratio).collect();
        if !ratios.is_empty() {
            rows.push(BenchRow {
                case: "pen_up_ratio".to_owned(),
                subject,
                value: ratios.iter().sum::<f64>() / ratios.len() as f64,
                unit: "best known",
                target: (subject == "etherpen").then_some(PEN_UP_RATIO_MAX),
            });
        }
    }
}

fn vpype(files: &[&str], progress: &impl Fn(&str)) -> Result<Vec<Peer>, BenchError> {
    let python = setup::ensure_vpype()?;
    progress("ordering the same files with vpype");
    let mut command = Command::new(python);
    command.args(["-c", VPYPE]).args(files.iter().map(|file| sample(file)));
    let output = command
        .stdin(Stdio::null())
        .output()
        .map_err(|cause| failed("vpype", cause))?;
    if !output.status.success() {
        return Err(failed("vpype", String::from_utf8_lossy(&output.stderr)));
    }
    let lines = String::from_utf8_lossy(&output.stdout).into_owned();
    let read = |line: &str| serde_json::from_str(line).map_err(|cause| failed("vpype", cause));
    lines.lines().map(read).collect()
}
