use super::*;
use crate::drawing::Subject;
use crate::drawing::preparation::compose::Composed;
use crate::drawing::preparation::prepare::compose;
use crate::drawing::preparation::source::SourceArguments;
use clap::Parser;
use std::path::PathBuf;

/// Squares along a side of the sheet.
const SQUARES: usize = 4;
/// Least share of the ink in a square for its share to be compared.
const SHARE_OF_INK_MIN: f64 = 0.02;
/// Accepted change of a square's share of the ink, relative to the drawing with all detail.
const SHARE_CHANGE: [f64; 2] = [0.5, 2.0];

#[derive(Parser)]
#[command(no_binary_name = true)]
struct CommandLine {
    #[command(flatten)]
    source: SourceArguments,
}

fn options(words: &[&str]) -> SourceArguments {
    CommandLine::parse_from(words).source
}

fn composed(file: &str, words: &[&str]) -> Result<Composed, String> {
    let path: PathBuf = crate::setup::workspace().join("samples").join(file);
    compose(&path, &Config::default(), &options(words)).map_err(|error| error.message)
}

fn drawn(file: &str, words: &[&str]) -> Result<(Drawing, f64), String> {
    let config = Config::default();
    let composed = composed(file, words)?;
    let planned_s = planned_s(&config, &composed.path);
    assert!(
        composed
            .planned_s
            .is_none_or(|known_s| (known_s - planned_s).abs() < 1e-6),
        "{file} {words:?}"
    );
    let drawing = composed.parts.into_iter().next().map(|(_, drawing)| drawing);
    Ok((drawing.expect("a photograph's strokes"), planned_s))
}

/// Shares of the ink in the squares of the sheet.
fn shares(drawing: &Drawing) -> Vec<f64> {
    let mut squares = [0.0; SQUARES * SQUARES];
    for pair in drawing.strokes.iter().flat_map(|stroke| stroke.points.windows(2)) {
        let [a, b] = [pair[0], pair[1]];
        let length_mm = (b[0] - a[0]).hypot(b[1] - a[1]);
        let pieces = length_mm.ceil().max(1.0);
        for k in 0..pieces as usize {
            let part = (k as f64 + 0.5) / pieces;
            let square = [0, 1].map(|axis| {
                let at = (a[axis] + part * (b[axis] - a[axis])) / drawing.sheet_mm[axis] * SQUARES as f64;
                (at as usize).min(SQUARES - 1)
            });
            squares[square[1] * SQUARES + square[0]] += length_mm / pieces;
        }
    }
    let whole: f64 = squares.iter().sum();
    squares.iter().map(|mm| mm / whole).collect()
}

/// Checks that a budget is used to the required share, with ink distributed as in the drawing with all detail.
fn assert_kept(file: &str, style: &str, budgets_s: &[f64]) {
    let (whole, whole_s) = drawn(file, &["--style", style, "--max-time", "24h"]).expect("a photograph");
    let expected = shares(&whole);
    println!(
        "{file} {style}: {whole_s:.1} s with all detail, {} strokes",
        whole.strokes.len()
    );
    for budget_s in budgets_s {
        let time = budget_s.to_string();
        let (drawing, planned_s) = drawn(file, &["--style", style, "--max-time", &time]).expect("it can be met");
        let found = shares(&drawing);
        let changes = expected
            .iter()
            .zip(&found)
            .filter(|(share, _)| **share >= SHARE_OF_INK_MIN);
        let changes: Vec<f64> = changes.map(|(before, after)| after / before).collect();
        let least = changes.iter().copied().fold(f64::INFINITY, f64::min);
        let most = changes.iter().copied().fold(0.0, f64::max);
        println!(
            "{file} {style} in {budget_s} s: {planned_s:.2} s, {} strokes, a square's share of the ink times {least:.2} to {most:.2}",
            drawing.strokes.len()
        );
        let aim_s = budget_s.min(whole_s);
        assert!(
            planned_s <= aim_s * 1.000_001,
            "{file} {style}: {planned_s} of {budget_s} s"
        );
        assert!(
            planned_s >= SHARE_MIN * aim_s,
            "{file} {style}: {planned_s} of {budget_s} s"
        );
        assert!(
            least >= SHARE_CHANGE[0] && most <= SHARE_CHANGE[1],
            "{file} {style}: {changes:?}"
        );
    }
}

#[test]
fn a_sketch_keeps_its_time_and_loses_detail_everywhere() {
    assert_kept("camera.png", "sketch", &[33.0]);
}

#[test]
fn hatching_keeps_its_time_and_loses_detail_everywhere() {
    assert_kept("astronaut.png", "hatch", &[24.0]);
}

#[test]
fn flow_keeps_its_time_and_loses_detail_everywhere() {
    assert_kept("camera.png", "flow", &[20.0]);
}

#[test]
fn the_single_line_keeps_its_time_and_loses_detail_everywhere() {
    assert_kept("astronaut.png", "tsp", &[20.0]);
}

#[test]
#[ignore = "more photographs and times than continuous integration has time for; nightly does it"]
fn every_style_keeps_short_and_long_times() {
    assert_kept("astronaut.png", "sketch", &[20.0, 75.0]);
    assert_kept("astronaut.png", "hatch", &[90.0]);
    assert_kept("camera.png", "flow", &[60.0]);
    assert_kept("astronaut.png", "tsp", &[110.0]);
}

/// Length of the strokes in the circle around the largest face, and elsewhere, mm.
fn in_face_and_elsewhere(composed: &Composed) -> [f64; 2] {
    let (picture, [left, top, width, _]) = composed.photograph.as_ref().expect("a photograph");
    let subject = Subject::of(picture, None);
    let face = subject.faces.first().expect("a face");
    let mm_per_px = width / f64::from(picture.width());
    let middle = [left + face.centre[0] * mm_per_px, top + face.centre[1] * mm_per_px];
    let mut lengths = [0.0; 2];
    for stroke in composed.parts.iter().flat_map(|(_, drawing)| &drawing.strokes) {
        for pair in stroke.points.windows(2) {
            let at = [0, 1].map(|k| 0.5 * (pair[0][k] + pair[1][k]) - middle[k]);
            let is_elsewhere = at[0].hypot(at[1]) > face.radius * mm_per_px;
            lengths[usize::from(is_elsewhere)] += (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
        }
    }
    lengths
}

/// Checks that the face keeps more of its lines than the rest does, by the factors that belong to the times.
fn assert_face_kept(style: &str, times: &[(&'static str, f64)]) {
    let words = ["--style", style, "--crop", "head", "--max-time"];
    let with = |time: &'static str| {
        let words: Vec<&str> = words.into_iter().chain([time]).collect();
        in_face_and_elsewhere(&composed("astronaut.png", &words).expect("it can be met"))
    };
    let whole = with("24h");
    for (budget, least) in times {
        let less = with(budget);
        let kept = [0, 1].map(|k| less[k] / whole[k]);
        println!(
            "{style} in {budget} s: {:.3} of the face's lines, {:.3} elsewhere",
            kept[0], kept[1]
        );
        assert!(kept[0] > least * kept[1], "{style} in {budget} s: {kept:?}");
    }
}

#[test]
fn a_face_gives_up_its_detail_last() {
    assert_face_kept("sketch", &[("20", 1.4)]);
}

#[test]
#[ignore = "nightly does it"]
fn a_face_gives_up_its_detail_last_in_every_style_and_time() {
    for style in ["sketch", "hatch"] {
        assert_face_kept(style, &[("20", 1.4), ("60", 1.05)]);
    }
}

#[test]
fn a_time_that_is_too_short_for_anything_is_refused_with_the_shortest() {
    let error = drawn("astronaut.png", &["--max-time", "0.2"]).expect_err("nobody is so quick");
    assert!(
        error.contains("cannot be drawn in 0.2 s") && error.contains("the coarsest drawing takes"),
        "{error}"
    );
}

#[test]
fn of_a_drawing_that_takes_a_little_too_long_nothing_is_left_out_that_must_be_kept() {
    let config = Config::default();
    let order = OrderOptions::default();
    let mut random = crate::random::Lcg::new(7);
    let mut somewhere = |below_mm: f64| random.below(1_000) as f64 / 1_000.0 * below_mm;
    for case in 0..6 {
        let strokes = (0..160).map(|_| {
            let at = [20.0 + somewhere(150.0), 20.0 + somewhere(150.0)];
            let end = [at[0] + 1.0 + somewhere(12.0), at[1] + somewhere(12.0)];
            Stroke { points: vec![at, end] }
        });
        let drawing = Drawing {
            sheet_mm: [200.0, 200.0],
            strokes: strokes.collect(),
        };
        let whole = timed(drawing, &config, &order);
        let budget_s = whole.planned_s * (0.9 + 0.015 * f64::from(case));
        let is_kept = |at: [f64; 2]| at[0] < 80.0;
        let thinned = thinned(&whole, budget_s, &config, &is_kept).expect("strokes that may go");
        assert!(thinned.planned_s <= budget_s && thinned.planned_s >= SHARE_MIN * budget_s);
        let (mut gone, mut kept) = (0, 0);
        for stroke in &whole.drawing.strokes {
            let stays = thinned.drawing.strokes.contains(stroke);
            let must = stroke.points.iter().any(|at| is_kept(*at));
            assert!(stays || !must, "case {case}: {stroke:?}");
            (gone, kept) = (gone + usize::from(!stays), kept + usize::from(must));
        }
        assert!(gone > 0 && kept > 20, "case {case}: {gone} gone, {kept} to be kept");
    }
}
