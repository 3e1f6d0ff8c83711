//! A drawing whose firmware restarts in the middle: the emulator is ended and started again; drives, robot and paper
//! stay as they are, and the drawing is resumed from the job log.

use crate::program::{Folder, Running, etherpen, run, strokes, wait_until};
use etherpen::config::Config;
use host_tools::cell::{CellOptions, InkStroke};
use host_tools::console::messages::Injection;
use host_tools::console::virtual_cell::{Firmware, VirtualCell};
use host_tools::error::code;
use host_tools::setup;

/// Largest distance of a point of ink from the other run's ink, mm.
const SAME_MM: f64 = 0.03;
/// Longest distance that the drives need to stop without telegrams, mm; it belongs to no stroke.
const STOP_MM: f64 = 6.0;
/// Most ink drawn twice where the stroke broke, mm: the overlap of a millimetre, the broken leg, and legs whose
/// execution had not been reported yet, which are several on a busy computer; a leg is four millimetres long.
const TWICE_MAX_MM: f64 = 60.0;

type Point = [f64; 2];

fn whole_mm(ink: &[InkStroke]) -> f64 {
    ink.iter().map(InkStroke::length_mm).sum()
}

/// Distance of a point from the nearest ink, mm.
fn away_mm(point: &Point, ink: &[InkStroke]) -> f64 {
    let lines = ink.iter().map(|stroke| stroke.distance_mm(point));
    lines.fold(f64::INFINITY, f64::min)
}

/// A cell with the emulated firmware, and the program that controls it.
struct Rig {
    folder: Folder,
    cell: VirtualCell,
}

impl Rig {
    fn new() -> Self {
        setup::ensure_qemu().expect("the emulator can be had");
        let image = setup::build_firmware("emulated").expect("the firmware builds");
        let cell = VirtualCell::start(&Config::default(), CellOptions::default(), Firmware::Emulated(image));
        Self {
            folder: Folder::new(),
            cell: cell.expect("the cell starts"),
        }
    }

    fn command(&self, words: &[&str]) -> std::process::Command {
        let mut command = etherpen(&self.folder);
        command.args(words).env("ETHERPEN_PORT", self.cell.port().to_string());
        command
    }

    /// Runs a command that must end with this exit code; returns its stderr.
    fn ends_with(&self, words: &[&str], expected: u8) -> String {
        let (status, _, stderr) = run(&mut self.command(words));
        assert_eq!(status, Some(i32::from(expected)), "{words:?}: {stderr}");
        stderr
    }
}

fn drawn_undisturbed(file: &str) -> Vec<InkStroke> {
    let rig = Rig::new();
    rig.ends_with(&["draw", file], 0);
    rig.cell.ink()
}

#[test]
fn after_a_restart_of_the_firmware_a_drawing_goes_on_from_the_log_with_nothing_missing_and_a_leg_or_two_twice() {
    let file = strokes().to_string_lossy().into_owned();
    let whole = drawn_undisturbed(&file);
    let rig = Rig::new();
    let mut first = Running::start(&mut rig.command(&["draw", &file]));
    // In the middle of a stroke that is neither the first nor the last one.
    first.wait_for("third stroke or one behind it", |_| {
        let ink = rig.cell.ink();
        let last = ink.last().map_or(0.0, InkStroke::length_mm);
        ((3..6).contains(&ink.len()) && last > 20.0).then_some(())
    });
    rig.cell.inject(Injection::Restart).expect("it is an emulator");
    let status = first.end();
    assert_eq!(status.code(), Some(i32::from(code::CONNECTION)), "{}", first.stderr());
    wait_until("word of --resume", || first.stderr().contains("draw --resume"));
    println!("{}", first.stderr());
    let stderr = rig.ends_with(&["draw", &file, "--resume"], code::FAILED);
    assert!(stderr.contains("etherpen reference"), "{stderr}");
    let broken = rig.cell.ink();
    // A person measures the position of the platform: on the paper, where the pen has stopped.
    let paper = Config::default().paper;
    let [x, y] = *broken.last().and_then(|stroke| stroke.points_mm.last()).expect("ink");
    let x_mm = x - 0.5 * paper.size_mm[0] + paper.centre_mm[0];
    let y_mm = 0.5 * paper.size_mm[1] - y + paper.centre_mm[1];
    let position = format!("{x_mm:.0},{y_mm:.0},{:.0}", paper.pen_down_z_mm);
    let port = rig.cell.port().to_string();
    rig.ends_with(&["reference", "--position", &position, "--port", &port], 0);
    // The drives have latched the loss of telegrams.
    let stderr = rig.ends_with(&["draw", &file, "--resume"], code::FAULT);
    assert!(stderr.contains("acknowledge"), "{stderr}");
    rig.ends_with(&["acknowledge"], 0);
    let stderr = rig.ends_with(&["draw", &file, "--resume"], 0);
    println!("{stderr}");
    assert!(stderr.contains("continuing from the log at stroke "), "{stderr}");
    let ink = rig.cell.ink();
    let missing_mm = whole
        .iter()
        .flat_map(|stroke| &stroke.points_mm)
        .map(|point| away_mm(point, &ink))
        .fold(0.0, f64::max);
    assert!(
        missing_mm <= SAME_MM,
        "ink is missing {missing_mm} mm away from any other"
    );
    let points_mm = (ink.iter().flat_map(|stroke| &stroke.points_mm))
        .filter(|point| away_mm(point, &whole) > SAME_MM)
        .copied()
        .collect();
    let elsewhere = InkStroke {
        points_mm,
        ..InkStroke::default()
    };
    let (whole_mm, drawn_mm, stray_mm) = (whole_mm(&whole), whole_mm(&ink), elsewhere.length_mm());
    println!(
        "{whole_mm:.2} mm undisturbed, {drawn_mm:.2} mm with the restart, {stray_mm:.2} mm of them beside the lines while \
         the drives stopped; {} pieces",
        ink.len()
    );
    assert!(stray_mm < STOP_MM, "{stray_mm} mm beside the lines");
    let twice_mm = drawn_mm - stray_mm - whole_mm;
    assert!(twice_mm < TWICE_MAX_MM, "{twice_mm} mm were drawn twice");
    let done = rig.ends_with(&["draw", &file, "--resume"], code::INPUT);
    assert!(done.contains("to its end"), "{done}");
}
