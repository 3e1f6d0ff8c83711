//! `etherpen paper`: a sheet that does not lie level, found by touches and drawn on, judged by the ink.

use crate::program::{Folder, Running, etherpen, run, wait_until};
use etherpen::config::Config;
use etherpen::robots::Position;
use host_tools::cell::{Cell, CellOptions, InkStroke, Physics, SheetPlace};
use host_tools::console::virtual_cell::{Firmware, VirtualCell};
use host_tools::drawing::preparation::wire::to_wire;
use host_tools::drawing::{Drawing, Stroke, to_path};
use host_tools::error::code;
use host_tools::run::{RunTask, simulate};
use host_tools::settings::machines::MACHINES;
use host_tools::touches::{Touch, fit, lying};
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// Half a degree.
const SLOPE: [f64; 2] = [0.0071, -0.0051];
/// Height above its drawing height at which the pen's spring first touches, mm.
const SPRING_MM: f64 = 0.3;
const GANTRY: &str = MACHINES[1].text;

fn sheet(config: &Config, raised_mm: f64) -> Physics {
    Physics {
        sheet: Some(SheetPlace {
            z_mm: config.paper.pen_down_z_mm + raised_mm,
            slope_x: SLOPE[0],
            slope_y: SLOPE[1],
        }),
        ..Physics::NOMINAL
    }
}

/// z of the tool where the pen first touches a sheet that is raised at its centre.
fn touch_z_mm(config: &Config, raised_mm: f64, [x, y]: [f64; 2]) -> f64 {
    let ([centre_x, centre_y], down_mm) = (config.paper.centre_mm, config.paper.pen_down_z_mm);
    down_mm + raised_mm + SPRING_MM + SLOPE[0] * (x - centre_x) + SLOPE[1] * (y - centre_y)
}

/// Places near three corners of the sheet, in the robot's frame.
fn corners(config: &Config) -> [[f64; 2]; 3] {
    let ([x, y], [width, height]) = (config.paper.centre_mm, config.paper.size_mm);
    [[-0.45, -0.45], [0.45, -0.45], [0.4, 0.45]].map(|[across, along]| [x + across * width, y + along * height])
}

/// Border, both diagonals, and a short line in each corner.
fn drawing(sheet_mm: [f64; 2]) -> Drawing {
    let [right, bottom] = sheet_mm.map(|side_mm| side_mm - 5.0);
    let (left, top) = (5.0, 5.0);
    let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
    let mut strokes = vec![
        [&corners[..], &corners[..1]].concat(),
        vec![corners[2], corners[0]],
        vec![corners[1], corners[3]],
    ];
    strokes.extend(corners.map(|[x, y]| vec![[x, 0.5 * (y + 0.5 * bottom)], [0.5 * (x + 0.5 * right), y]]));
    let strokes = strokes.into_iter().map(|points| Stroke { points }).collect();
    Drawing { sheet_mm, strokes }
}

/// Length of the drawing, every quarter of a millimetre, with no ink within half a millimetre, mm.
fn missing_mm(drawing: &Drawing, cell: &Cell) -> f64 {
    const STEP_MM: f64 = 0.25;
    let mut missing = 0.0;
    for ends in drawing.strokes.iter().flat_map(|stroke| stroke.points.windows(2)) {
        let along = [ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]];
        let steps = (along[0].hypot(along[1]) / STEP_MM) as usize;
        for step in 0..=steps {
            let part = step as f64 / steps.max(1) as f64;
            let at = [ends[0][0] + part * along[0], ends[0][1] + part * along[1]];
            let is_inked = cell.ink().iter().any(|stroke| stroke.distance_mm(&at) < 0.5);
            missing += if is_inked { 0.0 } else { STEP_MM };
        }
    }
    missing
}

/// The cell after the drawing was made with this configuration.
fn drawn(config: &Config, physics: Physics) -> (Drawing, Cell) {
    let drawing = drawing(config.paper.size_mm);
    let task = RunTask {
        config: config.clone(),
        path: to_path(&drawing, &config.paper).iter().map(to_wire).collect(),
        cell: CellOptions {
            physics,
            ..CellOptions::default()
        },
    };
    let drawn = simulate(&task, None, &mut |_| {}).expect("no capture");
    assert_eq!(drawn.outcome, Some(Ok(())));
    (drawing, drawn.cell)
}

#[test]
fn a_sheet_tilted_by_half_a_degree_gets_all_its_ink_and_no_pressure_once_it_was_touched() {
    for machine in [&MACHINES[0], &MACHINES[1]] {
        let level = machine.load().expect("a bundled machine");
        let (name, allowed_mm) = (machine.name, level.paper.pressing_depth_mm);
        let raised_mm = 0.15;
        let physics = sheet(&level, raised_mm);
        let touches: Vec<Touch> = corners(&level)
            .iter()
            .map(|[x, y]| {
                [
                    *x,
                    *y,
                    (touch_z_mm(&level, raised_mm, [*x, *y]) * 100.0).round() / 100.0,
                ]
            })
            .collect();
        let found = fit(&touches).expect("a plane");
        let touched = Config {
            paper: lying(&level.paper, &found.plane, SPRING_MM),
            ..level.clone()
        };
        let (drawing, cell) = drawn(&touched, physics);
        let (missing, pressed) = (missing_mm(&drawing, &cell), cell.state().pressed_max_mm);
        std::println!("{name}: touched: {missing} mm without ink, pressed by {pressed:.3} mm");
        assert_eq!((cell.ink().len(), missing), (drawing.strokes.len(), 0.0), "{name}");
        assert!(pressed < 0.1 && pressed < allowed_mm, "{name}: {pressed} mm");
        assert_eq!(cell.state().contacts_outside, 0, "{name}");

        let (drawing, cell) = drawn(&level, physics);
        let (missing, pressed) = (missing_mm(&drawing, &cell), cell.state().pressed_max_mm);
        std::println!("{name}: as if level: {missing} mm without ink, pressed by {pressed:.3} mm");
        assert!(
            missing > 300.0 && pressed > allowed_mm,
            "{name}: {missing} mm, {pressed} mm"
        );
    }
}

#[test]
fn given_touches_are_stored_with_the_comments_kept_and_shown_again() {
    let folder = Folder::new();
    let file = folder.file("etherpen.toml", GANTRY);
    let config = MACHINES[1].load().expect("the gantry");
    let mut words = vec!["paper".to_owned(), "--json".to_owned(), "--store".to_owned()];
    for [x, y] in corners(&config) {
        let z = touch_z_mm(&config, 0.5, [x, y]);
        words.extend(["--touch".to_owned(), format!("{x},{y},{z}")]);
    }
    let (status, stdout, stderr) = run(etherpen(&folder).args(&words));
    assert_eq!(status, Some(0), "{stderr}");
    let found: Value = serde_json::from_str(&stdout).expect("JSON");
    let stored = fs::read_to_string(&file).expect("the file");
    let expected = GANTRY.replace(
        "pen_down_z_mm = -30.0\npen_lift_mm = 3.0\n",
        "pen_down_z_mm = -29.5\npen_lift_mm = 3.0\nslope = [0.0071, -0.0051]\n",
    );
    assert_eq!(stored, expected, "{found}");
    assert!(
        (found["tilt_deg"].as_f64().expect("a number") - 0.5009).abs() < 1.0e-3,
        "{found}"
    );
    assert!(found["residual_mm"].as_f64().expect("a number") < 1.0e-6, "{found}");
    let (status, stdout, _) = run(etherpen(&folder).arg("paper"));
    assert_eq!(status, Some(0));
    assert!(
        stdout.contains("-29.500 mm") && stdout.contains("0.501 degrees"),
        "{stdout}"
    );
    // Not stored, it is only shown.
    let places = ["--touch=230,150,-30", "--touch=400,150,-30", "--touch=320,330,-29.9"];
    let (status, stdout, _) = run(etherpen(&folder).arg("paper").args(places));
    assert_eq!(status, Some(0));
    assert!(
        stdout.contains("Not stored") && stdout.contains("slope = ["),
        "{stdout}"
    );
    assert_eq!(fs::read_to_string(&file).expect("the file"), expected);
}

#[test]
fn touches_that_give_no_sheet_and_machines_that_cannot_follow_one_are_refused() {
    let folder = Folder::new();
    let file = folder.file("etherpen.toml", GANTRY);
    let refused = |words: &[&str], parts: &[&str]| {
        let (status, stdout, stderr) = run(etherpen(&folder).arg("paper").args(words));
        assert_eq!(status, Some(i32::from(code::USAGE)), "{words:?}: {stderr}");
        assert!(
            parts.iter().all(|part| stderr.contains(part)) && stdout.is_empty(),
            "{words:?}: {stderr}"
        );
    };
    let with = |places: &[&'static str]| {
        let mut words = vec!["--store"];
        words.extend(places.iter().flat_map(|place| ["--touch", place]));
        words
    };
    refused(&with(&["230,150,-30", "400,150,-30"]), &["3 touches", "there are 2"]);
    refused(
        &with(&["230,150,-30", "400,150,-30", "405,150,-30"]),
        &["touches 2 and 3", "5.0 mm apart"],
    );
    refused(&with(&["230,150,-30", "300,200,-30", "370,250,-30"]), &["on a line"]);
    refused(
        &with(&["230,150,-30", "400,150,-30", "320,330,-50"]),
        &["tilt", "degrees"],
    );
    refused(
        &with(&["230,150,-30", "254,150,-30", "242,171,-30"]),
        &["corner at x 420, y 340 mm", "nearer to that corner"],
    );
    refused(
        &with(&[
            "230,150,-30",
            "410,150,-30",
            "410,330,-30",
            "230,330,-30",
            "320,240,-28",
        ]),
        &["touch 5 at x 320, y 240", "off the plane"],
    );
    refused(
        &with(&["230,150,-2", "400,150,-2", "320,330,-2"]),
        &["the sheet cannot lie there"],
    );
    refused(&["--touch", "230,150"], &["three finite numbers"]);
    refused(&["--touch=-230,150,x"], &["three finite numbers"]);
    refused(&["--store"], &["--touch"]);
    refused(&["--touch", "--press", "9"], &["0 to 5"]);
    assert_eq!(fs::read_to_string(&file).expect("the file"), GANTRY);
    refused(
        &["--touch", "--machine", "corexy"],
        &["lowered by an output", "level the sheet"],
    );
    let slope = "[paper]\nslope = [0.01, 0.0]\n";
    folder.file("tilted.toml", MACHINES[2].text.replacen("[paper]\n", slope, 1));
    refused(&["--config", "tilted.toml"], &["paper.slope"]);
}

/// Types a line and waits for the answer with this text.
fn type_line(program: &mut Running, line: &str, text: &str) {
    let count = |program: &Running| program.stderr().matches(text).count();
    let before = count(program);
    program.type_line(line);
    program.wait_for(line, |program| (count(program) > before).then_some(()));
}

/// A gantry at rest that was homed, over a tilted sheet.
struct Led {
    folder: Folder,
    file: PathBuf,
    config: Config,
    cell: VirtualCell,
}

impl Led {
    fn new(text: &str, raised_mm: f64) -> Self {
        let folder = Folder::new();
        let file = folder.file("etherpen.toml", text);
        let config = host_tools::settings::load(Some(&file)).expect("a configuration");
        let options = CellOptions {
            physics: sheet(&config, raised_mm),
            ..CellOptions::default()
        };
        let cell = VirtualCell::start(&config, options, Firmware::Simulated).expect("the cell starts");
        Self {
            folder,
            file,
            config,
            cell,
        }
    }

    fn command(&self, words: &[&str]) -> Command {
        let mut command = etherpen(&self.folder);
        command.args(words).env("ETHERPEN_PORT", self.cell.port().to_string());
        command
    }

    /// Homes it; on a busy computer the firmware may fall silent meanwhile.
    fn home(&self) {
        wait_until("a homed machine", || run(&mut self.command(&["home"])).0 == Some(0));
    }

    /// The dialogue, waiting for its first line.
    fn dialogue(&self) -> Running {
        let mut command = self.command(&["paper", "--touch", "--store"]);
        let mut program = Running::start(command.stdin(Stdio::piped()));
        program.wait_for("the first touch", |program| {
            program.stderr().contains("Ctrl-C").then_some(())
        });
        program
    }

    fn platform(&self) -> Position {
        self.cell.state().platform.expect("a place")
    }

    /// Moves the pen along one axis to a place.
    fn go(&self, program: &mut Running, axis: &str, to_mm: f64) {
        let now = self.platform();
        let from_mm = match axis {
            "x" => now.x_mm,
            "y" => now.y_mm,
            _ => now.z_mm,
        };
        type_line(program, &format!("{axis} {:.2}", to_mm - from_mm), " mm\n");
    }

    fn stored(&self) -> String {
        fs::read_to_string(&self.file).expect("the file")
    }
}

/// Extent of the longest stroke on the paper, mm.
fn longest_mm(ink: &[InkStroke]) -> f64 {
    let extent = |stroke: &InkStroke| {
        let first = stroke.points_mm[0];
        let distances = stroke.points_mm.iter().map(|[x, y]| (x - first[0]).hypot(y - first[1]));
        distances.fold(0.0, f64::max)
    };
    ink.iter().map(extent).fold(0.0, f64::max)
}

#[test]
fn a_user_is_led_to_the_touches_and_the_plane_is_the_sheets() {
    let raised_mm = 0.5;
    let led = Led::new(GANTRY, raised_mm);
    let (status, _, stderr) = run(&mut led.command(&["paper", "--touch"]));
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(stderr.contains("etherpen home"), "{stderr}");
    led.home();
    let mut program = led.dialogue();
    let program = &mut program;
    type_line(program, "done", "there are 0");
    type_line(program, "left 3", "undo: forget");
    for (number, [x, y]) in (1..).zip(corners(&led.config)) {
        led.go(program, "z", -26.0);
        led.go(program, "x", x);
        led.go(program, "y", y);
        assert!(!led.cell.state().pen_touches);
        if number == 1 {
            // Too early: the pen does not touch yet.
            led.go(program, "z", touch_z_mm(&led.config, raised_mm, [x, y]) + 1.5);
            type_line(program, "", "touch 1: x");
        }
        led.go(program, "z", touch_z_mm(&led.config, raised_mm, [x, y]) + 0.25);
        while !led.cell.state().pen_touches {
            type_line(program, "z -0.1", " mm\n");
        }
        type_line(program, "", &format!("touch {number}: x"));
        if number == 1 {
            assert!(program.stderr().contains("in place of touch 1"), "{}", program.stderr());
            // Along this line the sheet rises by more than the pen's spring gives way.
            type_line(program, "x 100", " mm\n");
            assert!((led.platform().x_mm - x - 100.0).abs() < 0.1, "{:?}", led.platform());
        }
        let (dragged_mm, pressed_mm) = (longest_mm(&led.cell.ink()), led.cell.state().pressed_max_mm);
        assert!(
            dragged_mm < 0.05 && pressed_mm == 0.0,
            "after touch {number}: a line of {dragged_mm:.2} mm, pressed by {pressed_mm:.2} mm"
        );
    }
    program.type_line("done");
    let status = program.end();
    assert_eq!(status.code(), Some(0), "{}", program.stderr());
    let stored = host_tools::settings::load(Some(&led.file))
        .expect("a configuration")
        .paper;
    let high_mm = stored.pen_down_z_mm - led.config.paper.pen_down_z_mm - raised_mm;
    std::println!(
        "stored: {high_mm:.3} mm beside the true height, slope {:?} for {SLOPE:?}",
        stored.slope
    );
    // A step of 0.1 mm was the finest.
    assert!((-0.12..0.02).contains(&high_mm), "{high_mm}");
    assert!(
        stored
            .slope
            .iter()
            .zip(SLOPE)
            .all(|(found, slope)| (found - slope).abs() < 0.0008),
        "{stored:?}"
    );
    assert!(led.stored().contains("# Gantry for an A2 sheet"));
}

#[test]
fn only_done_stores_what_was_touched() {
    let led = Led::new(GANTRY, 0.5);
    led.home();
    let hang_up = |program: &mut Running| {
        program.signal(Signal::HUP);
        program.close_input();
    };
    let ends: [&dyn Fn(&mut Running); 3] = [&Running::close_input, &|program| program.signal(Signal::HUP), &hang_up];
    for end in ends {
        let mut program = led.dialogue();
        let program = &mut program;
        for (number, [x, y]) in (1..).zip(corners(&led.config)) {
            led.go(program, "x", x);
            led.go(program, "y", y);
            led.go(program, "z", -26.0);
            type_line(program, "", &format!("touch {number}: x"));
        }
        // Enough for a plane that could be stored.
        program.wait_for("a plane", |program| {
            program.stderr().contains("another touch, or done").then_some(())
        });
        end(program);
        let status = program.end();
        assert_eq!(status.code(), Some(i32::from(code::FAILED)), "{}", program.stderr());
        assert!(
            program.stderr().contains("ended; nothing was stored"),
            "{}",
            program.stderr()
        );
        assert_eq!(led.stored(), GANTRY);
    }
}

#[test]
fn ctrl_c_stops_a_move_that_another_program_carries_out() {
    let slow = GANTRY.replace("travel_speed_mm_s = 800.0", "travel_speed_mm_s = 20.0");
    let led = Led::new(&slow, 0.5);
    led.home();
    let port = led.cell.port().to_string();
    let mut console = Running::start(&mut led.command(&["console", "--listen", "127.0.0.1:0", "--port", &port]));
    console.wait_for("address", |console| console.stdout().contains("http://").then_some(()));
    wait_until("enabled drives", || run(&mut led.command(&["enable"])).0 == Some(0));
    let mut program = led.dialogue();
    let from_mm = led.platform().x_mm;
    program.type_line("x 300");
    program.wait_for("motion", |_| (led.platform().x_mm > from_mm + 10.0).then_some(()));
    program.signal(Signal::INT);
    let status = program.end();
    assert_eq!(status.code(), Some(i32::from(code::FAILED)), "{}", program.stderr());
    assert!(
        program.stderr().contains("ended; nothing was stored"),
        "{}",
        program.stderr()
    );
    wait_until("a standstill", || {
        let speeds = led.cell.state().velocities.0;
        speeds.iter().all(|speed| speed.abs() < 5e-3)
    });
    let went_mm = led.platform().x_mm - from_mm;
    assert!((10.0..250.0).contains(&went_mm), "{went_mm} mm of 300");
}
