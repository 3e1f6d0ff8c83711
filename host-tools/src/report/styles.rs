//! The deviation of every style's drawing, compared with the planner's own analysis and a brute-force search.

use super::output::conclude;
use super::{Report, Row, drawn_part, rows, strokes};
use crate::drawing::Style;
use crate::drawing::preparation::prepare::prepare_with;
use crate::drawing::preparation::source::SourceArguments;
use crate::matching::{between, distance};
use crate::planning::{Analysis, PlannedSample as Planned, plan};
use crate::run::simulate;
use crate::run::task;
use clap::Parser;
use etherpen::config::{AxisMode, Config};
use etherpen::messages::Sample;
use etherpen::motion::Pen;
use etherpen::robots::Position;

/// Resolution of the brute-force search along the stroke, mm.
const FINE_MM: f64 = 0.02;
/// Longest stroke that is searched, mm.
const SEARCHED_MAX_MM: f64 = 60.0;
/// Feedback gain with the firmware's own velocity loop, 1/s.
const TORQUE_FEEDBACK_GAIN_PER_S: f64 = 40.0;
/// Largest distance of ink from its stroke if the drives close the velocity loop, and if they do not, mm.
const INK_MAX_MM: f64 = 0.15;
const INK_BY_TORQUE_MAX_MM: f64 = 1.5;

#[derive(Parser)]
#[command(no_binary_name = true)]
struct CommandLine {
    #[command(flatten)]
    source: SourceArguments,
}

/// Least possible largest distance of positions from a stroke when their places along it never go back.
fn in_order_mm(stroke: &[Position], positions: &[Position]) -> f64 {
    let mut line = vec![stroke[0]];
    for pair in stroke.windows(2) {
        let count = (distance(&pair[0], &pair[1]) / FINE_MM).ceil().max(1.0) as usize;
        line.extend((1..=count).map(|k| between(&pair[0], &pair[1], k as f64 / count as f64)));
    }
    let mut best = vec![0.0_f64; line.len()];
    for position in positions {
        let mut least = f64::INFINITY;
        for (known, point) in best.iter_mut().zip(&line) {
            least = least.min(*known);
            *known = least.max(distance(position, point));
        }
    }
    best.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Least possible largest distance of the positions from their stroke, over all strokes short enough to be searched.
fn searched_mm(
    config: &Config,
    samples: &[Sample],
    report_strokes: &[(u32, Vec<Position>)],
    of: fn(&Row) -> Position,
) -> f64 {
    let drawing: Vec<Sample> = drawn_part(samples).copied().collect();
    let rows = rows(config, &drawing);
    let length_mm = |points: &[Position]| points.windows(2).map(|pair| distance(&pair[0], &pair[1])).sum::<f64>();
    (report_strokes
        .iter()
        .filter(|(_, points)| length_mm(points) <= SEARCHED_MAX_MM))
    .map(|(number, points)| {
        let own = rows.iter().filter(|row| row.pen == Pen::Down && row.stroke == *number);
        in_order_mm(points, &own.map(of).collect::<Vec<_>>())
    })
    .fold(0.0, f64::max)
}

/// Draws a photograph in a style and compares the report with the planner and the search.
fn check(style: &str, mode: AxisMode) {
    let mut config = Config::default();
    for axis in config.axes.iter_mut().filter(|_| mode == AxisMode::Torque) {
        (axis.mode, axis.feedback_gain_per_s) = (mode, TORQUE_FEEDBACK_GAIN_PER_S);
    }
    let photograph = crate::setup::workspace().join("samples/astronaut.png");
    let options = CommandLine::parse_from(["--style", style, "--size", "70mm", "--max-time", "25s"]).source;
    let prepared = prepare_with(&photograph, &config, &options).expect("a photograph");
    let mut planned: Vec<Planned> = Vec::new();
    let run = plan(&config, &prepared.path, |sample, _| planned.push(*sample)).expect("it can be planned");
    let mut analysis = Analysis::new(&config, &prepared.path, run.jerk_window_ms);
    planned.iter().for_each(|sample| analysis.observe(sample));
    let expected_mm = analysis.finish(&run).deviation_drawn_max_mm;
    let task = task(&config, &prepared);
    let drawn = simulate(&task, None, &mut |_| {}).expect("nothing is captured");
    let report: Report = conclude(&task, &prepared, &drawn, String::new(), None).expect("it was drawn");
    let strokes = strokes(&prepared.path);
    let shaping_mm = searched_mm(&config, &drawn.job.samples, &strokes, |row| row.reference);
    let path_mm = searched_mm(&config, &drawn.job.samples, &strokes, |row| row.position);
    println!(
        "{style} {mode:?}: shaping {:.4} mm, {expected_mm:.4} planned, {shaping_mm:.4} searched; path {:.4} mm, \
         {path_mm:.4} searched; ink {:.4} mm",
        report.shaping_deviation_max_mm, report.path_deviation_max_mm, report.ink_deviation_max_mm
    );
    assert!((report.shaping_deviation_max_mm - expected_mm).abs() < 0.01, "{style}");
    assert!(report.shaping_deviation_max_mm >= shaping_mm - FINE_MM, "{style}");
    assert!(report.path_deviation_max_mm >= path_mm - FINE_MM, "{style}");
    assert!(
        report.path_deviation_max_mm <= report.shaping_deviation_max_mm + report.tracking_error_max_mm + 1e-3,
        "{style}"
    );
    let ink_max_mm = match mode {
        AxisMode::Velocity | AxisMode::Position => INK_MAX_MM,
        AxisMode::Torque => INK_BY_TORQUE_MAX_MM,
    };
    assert!(report.ink_deviation_max_mm <= ink_max_mm, "{style}");
    assert_eq!((report.not_followed_mm, report.not_verified_mm), (0.0, 0.0), "{style}");
}

#[test]
fn every_styles_deviation_is_the_planners_and_that_of_a_brute_force_search() {
    Style::NAMES.iter().for_each(|style| check(style, AxisMode::Velocity));
}

#[test]
fn hatching_drawn_by_torque_is_compared_with_its_own_strokes() {
    check("hatch", AxisMode::Torque);
}
