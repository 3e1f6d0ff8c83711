//! `etherpen calibrate`: a robot that is not as its configuration says draws marks, and draws true afterwards, judged by the ink.

use crate::program::{Folder, etherpen, run};
use etherpen::config::Config;
use host_tools::calibration::marks::places;
use host_tools::cell::{Calibration, Cell, CellOptions, Physics};
use host_tools::drawing::preparation::wire::to_wire;
use host_tools::drawing::{Drawing, Stroke, to_path};
use host_tools::error::code;
use host_tools::run::{RunTask, simulate_on};
use host_tools::settings::{load, machines::MACHINES};
use serde_json::Value;
use std::fmt::Write;
use std::fs;

/// Half a cross of the pattern, mm.
const HALF_MM: f64 = 3.0;
const IRB340: &str = MACHINES[0].text;

/// Crosses at places from the middle of the sheet.
fn crosses(config: &Config, places: &[[f64; 2]]) -> Drawing {
    let [width, height] = config.paper.size_mm;
    let cross = |[x, y]: &[f64; 2]| {
        let (x, y) = (0.5 * width + x, 0.5 * height - y);
        [
            vec![[x - HALF_MM, y], [x + HALF_MM, y]],
            vec![[x, y - HALF_MM], [x, y + HALF_MM]],
        ]
    };
    let strokes = places.iter().flat_map(cross).map(|points| Stroke { points }).collect();
    Drawing {
        sheet_mm: config.paper.size_mm,
        strokes,
    }
}

/// Where the ink of each cross is, from the middle of the sheet, on a robot that is as `machine` and these errors say.
fn inked(machine: &Config, config: &Config, physics: Physics, seed: u64, places: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let drawing = crosses(config, places);
    let task = RunTask {
        config: config.clone(),
        path: to_path(&drawing, &config.paper).iter().map(to_wire).collect(),
        cell: CellOptions {
            physics,
            seed,
            ..CellOptions::default()
        },
    };
    let drawn = simulate_on(machine, &task, &mut |_| {}).expect("no capture");
    assert_eq!(drawn.outcome, Some(Ok(())));
    let [width, height] = machine.paper.size_mm;
    let found = |[x, y]: &[f64; 2]| {
        let [x, y] = centre(&drawn.cell, [0.5 * width + x, 0.5 * height - y]);
        [x - 0.5 * width, 0.5 * height - y]
    };
    places.iter().map(found).collect()
}

/// The middle of the ink near a place on the sheet.
fn centre(cell: &Cell, place: [f64; 2]) -> [f64; 2] {
    let near = |point: &&[f64; 2]| (point[0] - place[0]).hypot(point[1] - place[1]) < 2.0 * HALF_MM;
    let points: Vec<&[f64; 2]> = cell
        .ink()
        .iter()
        .flat_map(|stroke| &stroke.points_mm)
        .filter(near)
        .collect();
    assert!(points.len() > 20, "{} points at {place:?}", points.len());
    [0, 1].map(|axis| {
        let values = points.iter().map(|point| point[axis]);
        let (least, most) = (values.clone().fold(f64::MAX, f64::min), values.fold(f64::MIN, f64::max));
        f64::midpoint(least, most)
    })
}

/// Root mean square of the distances of places from others, turned and displaced for the best, mm.
fn shape_mm(found: &[[f64; 2]], wanted: &[[f64; 2]]) -> f64 {
    let middle = |points: &[[f64; 2]]| {
        [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / points.len() as f64)
    };
    let (from, to) = (middle(found), middle(wanted));
    let pairs: Vec<[f64; 4]> = found
        .iter()
        .zip(wanted)
        .map(|(one, other)| [one[0] - from[0], one[1] - from[1], other[0] - to[0], other[1] - to[1]])
        .collect();
    let sum = |of: fn(&[f64; 4]) -> f64| pairs.iter().map(of).sum::<f64>();
    let turn = f64::atan2(sum(|[a, b, c, d]| a * d - b * c), sum(|[a, b, c, d]| a * c + b * d));
    let squares = pairs.iter().map(|[a, b, c, d]| {
        let (x, y) = (turn.cos() * a - turn.sin() * b - c, turn.sin() * a + turn.cos() * b - d);
        x * x + y * y
    });
    (squares.sum::<f64>() / pairs.len() as f64).sqrt()
}

#[test]
fn a_robot_with_errors_of_half_a_millimetre_draws_true_after_its_marks_were_measured() {
    let machine = MACHINES[0].load().expect("a bundled machine");
    let physics = Physics {
        calibration: Calibration {
            sync_mrad: 2.0,
            length_mm: 0.5,
            azimuth_mrad: 1.0,
        },
        ..Physics::NOMINAL
    };
    let grid = places(&machine.paper, 9).expect("a large sheet");
    for seed in [1, 2, 3] {
        let folder = Folder::new();
        let file = folder.file("etherpen.toml", IRB340);
        let marks = places(&machine.paper, 5).expect("a large sheet");
        let measured = inked(&machine, &machine, physics, seed, &marks);
        let (status, _, text) = run(etherpen(&folder).args(["calibrate", "--pattern", "marks.svg"]));
        assert_eq!(status, Some(0), "{text}");
        let pattern = fs::read_to_string(folder.join("marks.csv")).expect("the table");
        let mut table: String = pattern.lines().take(2).flat_map(|line| [line, "\n"]).collect();
        for ([x, y], [measured_x, measured_y]) in marks.iter().zip(&measured) {
            // Somebody measures from the corner of the sheet, to a twentieth.
            let read = |mm: f64| ((mm + 100.0) * 20.0).round() / 20.0;
            writeln!(table, "{x},{y},{},{}", read(*measured_x), read(*measured_y)).expect("a text");
        }
        folder.file("marks.csv", table);
        let (status, answer, text) = run(etherpen(&folder).args(["calibrate", "marks.csv", "--store", "--json"]));
        assert_eq!(status, Some(0), "{text}");
        let answer: Value = serde_json::from_str(&answer).expect("JSON");
        let stored = load(Some(&file)).expect("a configuration");
        let before = shape_mm(&inked(&machine, &machine, physics, seed, &grid), &grid);
        let after = shape_mm(&inked(&machine, &stored, physics, seed, &grid), &grid);
        println!("seed {seed}: {before:.3} to {after:.3} mm over the sheet; {answer}");
        assert!(after < 0.03 && after < 0.5 * before, "seed {seed}: {before} {after}");
        assert_eq!(answer["marks"], 25);
        let changed = fs::read_to_string(&file).expect("the file");
        // What was measured says nothing about the machine that it has changed.
        let (status, _, text) = run(etherpen(&folder).args(["calibrate", "marks.csv", "--store"]));
        assert_eq!(
            (status, text.contains("already")),
            (Some(code::INPUT.into()), true),
            "{text}"
        );
        assert_eq!(fs::read_to_string(&file).expect("the file"), changed);
        assert_eq!(changed.matches('#').count(), IRB340.matches('#').count());
    }
}

#[test]
fn the_pattern_is_drawn_where_its_table_says_and_what_was_measured_is_not_overwritten() {
    let folder = Folder::new();
    let (status, _, text) = run(etherpen(&folder).args(["calibrate", "--pattern", "marks.svg", "--side", "3"]));
    assert_eq!(status, Some(0), "{text}");
    let table = fs::read_to_string(folder.join("marks.csv")).expect("the table");
    assert_eq!(table.lines().count(), 11);
    let (status, _, text) = run(etherpen(&folder).args(["calibrate", "--pattern", "marks.svg"]));
    assert_eq!(
        (status, text.contains("exists")),
        (Some(code::USAGE.into()), true),
        "{text}"
    );
    let (status, _, text) = run(etherpen(&folder).args(["simulate", "marks.svg", "--out", "out"]));
    assert_eq!(status, Some(0), "{text}");
    let intended = fs::read_to_string(folder.join("out/intended.csv")).expect("the strokes");
    let points: Vec<[f64; 2]> = intended
        .lines()
        .filter_map(|line| {
            let mut cells = line.split(',').skip(1).map(|cell| cell.parse::<f64>().ok());
            Some([cells.next()??, cells.next()??])
        })
        .collect();
    for line in table.lines().skip(2) {
        let cells: Vec<f64> = line.split(',').filter_map(|cell| cell.parse().ok()).collect();
        let [x, y] = cells[..] else { panic!("{line}") };
        for [across, up] in [[HALF_MM, 0.0], [-HALF_MM, 0.0], [0.0, HALF_MM], [0.0, -HALF_MM]] {
            let is_there = |point: &[f64; 2]| (point[0] - x - across).hypot(point[1] - y - up) < 0.01;
            assert!(points.iter().any(is_there), "{line}: {across} {up}");
        }
    }
}

#[test]
fn a_table_that_cannot_be_used_changes_nothing_and_says_why() {
    let folder = Folder::new();
    let file = folder.file("etherpen.toml", IRB340);
    folder.file("few.csv", "0,0,1,1\n10,0,11,1\n");
    folder.file("no.csv", "0,0,1,x\n");
    for (arguments, status, part) in [
        (&["calibrate", "few.csv", "--store"][..], code::INPUT, "at least 6"),
        (&["calibrate", "no.csv", "--store"][..], code::INPUT, "line 1"),
        (&["calibrate", "none.csv"][..], code::INPUT, "none.csv"),
        (&["calibrate"][..], code::USAGE, "--pattern"),
        (&["calibrate", "--pattern", "marks.csv"][..], code::USAGE, "SVG"),
        (&["calibrate", "--pattern", "etherpen.toml"][..], code::USAGE, "SVG"),
    ] {
        let (ended, _, text) = run(etherpen(&folder).args(arguments));
        assert_eq!(ended, Some(status.into()), "{arguments:?}: {text}");
        assert!(text.contains(part), "{arguments:?}: {text}");
    }
    assert_eq!(fs::read_to_string(&file).expect("the file"), IRB340);
    let touch = [
        "calibrate",
        "--touch=-80,-80,-850",
        "--touch=80,-80,-850",
        "--touch=0,80,-850",
        "--json",
    ];
    let (status, answer, text) = run(etherpen(&folder).args(touch));
    assert_eq!(status, Some(0), "{text}");
    let answer: Value = serde_json::from_str(&answer).expect("JSON");
    let figure = |name: &str| answer[name].as_f64().expect(name);
    assert!(figure("expected_after_mm") > 0.5 * figure("expected_before_mm"));
    assert!(figure("expected_with_marks_mm") < 0.3 * figure("expected_before_mm"));
}
