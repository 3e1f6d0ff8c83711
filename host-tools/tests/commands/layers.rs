//! A drawing of three layers with a pause before each but the first. The ink, the platform and the drives are the
//! reference.

use crate::program::{Folder, Running, etherpen, run};
use etherpen::config::Config;
use host_tools::cell::{CellOptions, DriveState, InkStroke};
use host_tools::console::virtual_cell::{Firmware, VirtualCell};
use host_tools::error::code;
use std::path::Path;
use std::process::Stdio;

/// Strokes of a layer.
const STROKES: usize = 2;
/// The place for changing the pen, mm.
const PLACE: [f64; 3] = [60.0, -90.0, -800.0];
const PLACE_TEXT: &str = "60,-90,-800";
/// Largest distance of a point of ink from the other run's ink, mm.
const SAME_MM: f64 = 0.1;

fn cell() -> VirtualCell {
    VirtualCell::start(&Config::default(), CellOptions::default(), Firmware::Simulated).expect("the cell starts")
}

/// Each layer has two long lines of its own colour.
fn svg() -> String {
    let line = |colour: &str, y: usize| format!("<path fill='none' stroke='{colour}' d='M10 {y}H110'/>");
    let layers = ["red", "green", "blue"].iter().enumerate();
    let lines: String = layers
        .map(|(layer, colour)| line(colour, 10 + 30 * layer) + &line(colour, 20 + 30 * layer))
        .collect();
    format!("<svg xmlns='http://www.w3.org/2000/svg' width='120mm' height='100mm' viewBox='0 0 120 100'>{lines}</svg>")
}

struct Pauses<'a> {
    folder: &'a Folder,
    cell: &'a VirtualCell,
}

impl Pauses<'_> {
    fn draw(&self, file: &Path, words: &[&str]) -> Running {
        let mut command = etherpen(self.folder);
        command.arg("draw").arg(file).args(["--pause", "--port"]);
        command.arg(self.cell.port().to_string()).args(words);
        Running::start(command.stdin(Stdio::piped()))
    }

    fn tell(&self, word: &str) {
        let (status, _, stderr) = run(etherpen(self.folder).args([word, "--port", &self.cell.port().to_string()]));
        assert_eq!(status, Some(0), "{word}: {stderr}");
    }

    /// Waits for the `times`-th occurrence of a text, then checks that the robot stands without power and the pen is up.
    fn until_told(&self, drawing: &mut Running, text: &str, times: usize) {
        until(drawing, text, times);
        let state = self.cell.state();
        assert!(!state.pen_touches, "{text}: the pen is down");
        let powered = state
            .slaves
            .iter()
            .any(|slave| slave.drive == DriveState::OperationEnabled);
        assert!(!powered, "{text}: a drive has power");
    }

    fn is_at_the_place(&self) {
        let at = self.cell.state().platform.expect("the robot holds a platform");
        let off_mm = [at.x_mm - PLACE[0], at.y_mm - PLACE[1], at.z_mm - PLACE[2]].map(f64::abs);
        assert!(
            off_mm.iter().all(|off_mm| *off_mm < 1.0),
            "{at:?} is not the place for changing the pen"
        );
    }
}

/// Waits for the `times`-th occurrence of a text.
fn until(drawing: &mut Running, text: &str, times: usize) {
    drawing.wait_for(text, |drawing| {
        (drawing.stderr().matches(text).count() >= times).then_some(())
    });
}

/// The farthest point of one run's ink from the other's, mm.
fn farthest_mm(of: &[InkStroke], from: &[InkStroke]) -> f64 {
    let points = of.iter().flat_map(|stroke| &stroke.points_mm);
    let nearest = |point| {
        from.iter()
            .map(|stroke| stroke.distance_mm(point))
            .fold(f64::INFINITY, f64::min)
    };
    points.map(nearest).fold(0.0, f64::max)
}

fn length_mm(ink: &[InkStroke]) -> f64 {
    ink.iter().map(InkStroke::length_mm).sum()
}

#[test]
fn layers_wait_for_their_pens_through_stops_an_occupied_port_and_a_killed_program() {
    let folder = Folder::new();
    let file = folder.file("flag.svg", svg());
    let whole = cell();
    let (status, _, stderr) = run(etherpen(&folder)
        .arg("draw")
        .arg(&file)
        .args(["--port", &whole.port().to_string()]));
    assert_eq!(status, Some(0), "{stderr}");
    let whole = whole.ink();
    assert_eq!(whole.len(), 3 * STROKES);

    let cell = cell();
    let pauses = Pauses {
        folder: &folder,
        cell: &cell,
    };
    let mut drawing = pauses.draw(&file, &["--change-at", PLACE_TEXT]);
    pauses.until_told(&mut drawing, "change the pen for layer", 1);
    pauses.is_at_the_place();
    let first = cell.ink();
    assert_eq!(first.len(), STROKES, "only the first layer is drawn");

    // A stop and an occupied port in the pause: each ends an attempt, not the drawing.
    pauses.tell("stop");
    drawing.press_enter();
    pauses.until_told(&mut drawing, "Enter goes on with layer", 1);
    pauses.tell("acknowledge");
    let mut other = etherpen(&folder);
    let mut other = Running::start(other.args(["record", "-o", "other.mcap", "--port", &cell.port().to_string()]));
    other.wait_for("connection", |other| {
        other.stderr().contains("connected:").then_some(())
    });
    drawing.press_enter();
    pauses.until_told(&mut drawing, "Enter goes on with layer", 2);
    drop(other);
    assert_eq!(cell.ink(), first, "nothing was drawn meanwhile");

    // A stop in the middle of the second layer ends the program; the next one asks for that layer's pen first.
    drawing.press_enter();
    drawing.wait_for("ink of the second layer", |_| {
        let length_mm = cell.ink().get(STROKES).map_or(0.0, InkStroke::length_mm);
        (length_mm > 20.0).then_some(())
    });
    pauses.tell("stop");
    let status = drawing.end();
    assert_eq!(status.code(), Some(i32::from(code::FAULT)), "{}", drawing.stderr());
    assert!(
        drawing.stderr().contains("--pause --resume goes on"),
        "{}",
        drawing.stderr()
    );
    pauses.tell("acknowledge");
    let half = cell.ink();
    let mut drawing = pauses.draw(&file, &["--resume", "--change-at", PLACE_TEXT]);
    // A stop leaves this machine's pen where it is: on the paper.
    until(&mut drawing, "change the pen for layer", 1);
    // The last error that the controllers take away may leave a trace.
    let more_mm = length_mm(&cell.ink()) - length_mm(&half);
    assert!(more_mm < 0.5, "{more_mm} mm are drawn before the pen is in");
    drawing.press_enter();
    pauses.until_told(&mut drawing, "change the pen for layer", 2);
    pauses.is_at_the_place();
    let second = cell.ink();
    let last = second.iter().flat_map(|stroke| &stroke.points_mm);
    let lines = whole.get(..2 * STROKES).expect("two layers");
    let stray_mm = last
        .map(|point| {
            lines
                .iter()
                .map(|line| line.distance_mm(point))
                .fold(f64::INFINITY, f64::min)
        })
        .fold(0.0, f64::max);
    assert!(stray_mm <= SAME_MM, "{stray_mm} mm beside the first two layers");

    // The program dies in the pause; a new one asks for the third pen again.
    drop(drawing);
    let mut drawing = pauses.draw(&file, &["--resume", "--change-at", PLACE_TEXT]);
    pauses.until_told(&mut drawing, "change the pen for layer", 1);
    assert_eq!(cell.ink(), second, "nothing is drawn before the pen is in");
    drawing.press_enter();
    let status = drawing.end();
    assert_eq!(status.code(), Some(0), "{}", drawing.stderr());
    let (missing_mm, beside_mm) = (farthest_mm(&whole, &cell.ink()), farthest_mm(&cell.ink(), &whole));
    println!("ink missing {missing_mm:.3} mm, beside the lines {beside_mm:.3} mm");
    let (twice_mm, whole_mm) = (length_mm(&cell.ink()), length_mm(&whole));
    assert!(
        (twice_mm - whole_mm).abs() < 150.0,
        "{twice_mm} mm of ink, {whole_mm} mm in one go"
    );
    assert!(
        missing_mm <= SAME_MM && beside_mm <= SAME_MM,
        "{missing_mm} mm, {beside_mm} mm"
    );

    let mut drawing = pauses.draw(&file, &["--resume"]);
    let status = drawing.end();
    assert_eq!(status.code(), Some(i32::from(code::INPUT)), "{}", drawing.stderr());
    assert!(drawing.stderr().contains("to its end"), "{}", drawing.stderr());
}

#[test]
fn a_pause_ends_without_a_keyboard_and_a_place_out_of_reach_is_refused_before_anything_moves() {
    let folder = Folder::new();
    let file = folder.file("flag.svg", svg());
    let cell = cell();
    let port = cell.port().to_string();
    let draw = |words: &[&str]| {
        let mut command = etherpen(&folder);
        run(command
            .arg("draw")
            .arg(&file)
            .args(["--pause", "--port", &port])
            .args(words))
    };
    let (status, _, stderr) = draw(&["--change-at", "0,0,-2000"]);
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
    assert!(stderr.contains("--change-at: "), "{stderr}");
    let (status, _, stderr) = draw(&["--resume"]);
    assert_eq!(status, Some(i32::from(code::INPUT)), "{stderr}");
    assert!(stderr.contains("no layer of"), "{stderr}");
    assert!(cell.ink().is_empty());
    let (status, _, stderr) = draw(&[]);
    assert_eq!(status, Some(i32::from(code::INTERRUPTED)), "{stderr}");
    assert!(stderr.contains("--pause --resume draws it"), "{stderr}");
    assert_eq!(cell.ink().len(), STROKES, "one layer is drawn");
}
