//! A drawing of several layers on the page: it pauses for each pen, whoever watches and whatever happens meanwhile.

use super::browser::Browser;
use super::client::{Client, Rig, TOKEN};
use super::page::{begin, drop_file};
use etherpen::robots::Position;
use host_tools::cell::{CellOptions, DriveState, InkStroke};
use serde_json::{Value, json};

/// The place for changing the pen.
const PLACE: Position = Position {
    x_mm: -70.0,
    y_mm: 60.0,
    z_mm: -800.0,
};

/// Two lines in each of three colours.
fn layers() -> String {
    let line = |colour: &str, y: usize| format!("<path fill='none' stroke='{colour}' d='M10 {y}H110'/>");
    let colours = ["red", "green", "blue"].iter().enumerate();
    let lines: String = colours
        .map(|(layer, colour)| line(colour, 10 + 30 * layer) + &line(colour, 20 + 30 * layer))
        .collect();
    format!("<svg xmlns='http://www.w3.org/2000/svg' width='120mm' height='100mm' viewBox='0 0 120 100'>{lines}</svg>")
}

/// Prepares the layers and starts them; returns the number of the job.
fn start(rig: &Rig, viewer: &mut Client) -> Value {
    let head = format!(
        "POST /file HTTP/1.1\r\nHost: {}\r\nx-etherpen-token: {TOKEN}\r\nx-etherpen-viewer: {}\r\nx-etherpen-name: flag.svg",
        rig.address(),
        viewer.sections["you"]["id"]
    );
    let answer = rig.http(&head, layers().as_bytes());
    assert!(answer.starts_with("HTTP/1.1 2"), "{answer}");
    let made = viewer.state("studio", |made| made["state"] == "ready");
    assert_eq!(made["layers"].as_array().map(Vec::len), Some(3), "{made}");
    viewer.send(&json!({"type": "enqueue", "preparation": made["number"], "pauses": true}));
    let jobs = viewer.state("jobs", |jobs| {
        jobs["waiting"].as_array().is_some_and(|waiting| !waiting.is_empty())
    });
    let job = jobs["waiting"][0]["number"].clone();
    viewer.send(&json!({"type": "start", "job": job}));
    job
}

fn is_near(at: &Position) -> bool {
    let off_mm = [at.x_mm - PLACE.x_mm, at.y_mm - PLACE.y_mm, at.z_mm - PLACE.z_mm];
    off_mm.iter().all(|off_mm| off_mm.abs() < 1.0)
}

/// Waits for the pause before a layer, until the robot stands at the place without power.
fn paused(rig: &Rig, viewer: &mut Client, layer: u64) {
    viewer.state("jobs", |jobs| jobs["pause"]["number"] == layer);
    rig.until("the place for changing the pen", |_| {
        let state = rig.cell.state();
        let powered = state
            .slaves
            .iter()
            .any(|slave| slave.drive == DriveState::OperationEnabled);
        state.platform.is_some_and(|at| is_near(&at)) && !powered && !state.pen_touches
    });
    viewer.mode("DrivesOff");
}

fn lines(rig: &Rig) -> usize {
    rig.cell()
        .ink()
        .iter()
        .filter(|stroke| stroke.length_mm() > 1.0)
        .count()
}

#[test]
fn a_pause_outlives_its_viewer_a_stop_a_cancel_and_a_restart_of_the_controller() {
    let rig = Rig::with_pen_change(CellOptions::default(), Some(PLACE));
    let mut viewer = rig.viewer("first");
    viewer.enable();
    viewer.command(json!({"do": "disable"}));
    viewer.mode("DrivesOff");
    let job = start(&rig, &mut viewer);
    paused(&rig, &mut viewer, 2);
    assert_eq!(lines(&rig), 2, "only the first layer is drawn");

    // The viewer leaves, another one goes on; a stop asks for its acknowledgement first.
    drop(viewer);
    let mut viewer = rig.viewer("second");
    viewer.send(&json!({"type": "take", "force": true}));
    viewer.send(&json!({"type": "stop"}));
    viewer.mode("Fault");
    viewer.send(&json!({"type": "pen_is_in", "job": job}));
    viewer.until("refused", |_| true);
    viewer.state("jobs", |jobs| jobs["pause"]["number"] == 2);
    while viewer.sections["status"]["mode"] != "DrivesOff" {
        viewer.command(json!({"do": "acknowledge"}));
        viewer.until("status", |_| true);
    }
    assert_eq!(lines(&rig), 2, "nothing was drawn meanwhile");
    // Two presses are one.
    viewer.send(&json!({"type": "pen_is_in", "job": job}));
    viewer.send(&json!({"type": "pen_is_in", "job": job}));
    viewer.until("refused", |_| true);
    paused(&rig, &mut viewer, 3);
    assert_eq!(lines(&rig), 4, "two layers are drawn");

    // A cancel ends the drawing; continued, it asks for the pen again.
    viewer.command(json!({"do": "cancel"}));
    viewer.until("jobs", |jobs| {
        jobs["active"].is_null() && jobs["past"][0]["unfinished"] == true
    });
    viewer.send(&json!({"type": "continue", "job": job}));
    viewer.until("jobs", |jobs| jobs["pause"]["number"] == 3);

    // A restarted controller has lost the pose: the pause waits until the robot is homed.
    viewer.send(&json!({"type": "inject", "fault": {"what": "restart"}}));
    viewer.until("status", |status| status["referenced"] == false);
    viewer.until("status", |status| {
        ["Fault", "DrivesOff"].contains(&status["mode"].as_str().unwrap_or(""))
    });
    while viewer.sections["status"]["mode"] != "DrivesOff" {
        viewer.command(json!({"do": "acknowledge"}));
        viewer.until("status", |_| true);
    }
    viewer.send(&json!({"type": "pen_is_in", "job": job}));
    viewer.until("refused", |_| true);
    viewer.command(json!({"do": "reference_here"}));
    viewer.until("status", |status| status["referenced"] == true);
    // Some drives report the loss of telegrams only when they are enabled; the drawing stays unfinished meanwhile.
    viewer.send(&json!({"type": "pen_is_in", "job": job}));
    let ended = |jobs: &Value| jobs["active"].is_null();
    while viewer.until("jobs", ended)["past"][0]["done"] != true {
        while viewer.sections["status"]["mode"] != "DrivesOff" {
            viewer.command(json!({"do": "acknowledge"}));
            viewer.until("status", |_| true);
        }
        viewer.send(&json!({"type": "continue", "job": job}));
        viewer.until("jobs", |jobs| !jobs["active"].is_null());
    }
    let ink = rig.cell().ink();
    let drawn_mm: f64 = ink.iter().map(InkStroke::length_mm).sum();
    println!("{} strokes, {drawn_mm:.1} mm", ink.len());
    assert!((598.0..610.0).contains(&drawn_mm), "{drawn_mm} mm of 600 mm");
}

#[test]
fn the_page_asks_for_each_pen_and_goes_on_at_the_press_of_a_button() {
    let Some(mut browser) = Browser::start() else { return };
    let browser = &mut browser;
    let rig = Rig::start();
    begin(browser, &rig);
    drop_file(browser, "flag.svg", layers().as_bytes());
    assert_eq!(browser.value("document.getElementById('pauses').checked"), true);
    browser.press("#enqueue");
    browser.press("#queue button.primary");
    for layer in [2, 3] {
        browser.until(&format!("etherpen.link.state.jobs.pause?.number === {layer}"));
        browser.until("!document.getElementById('pen-is-in').disabled");
        browser.until(&format!(
            "document.getElementById('mode-text').textContent.includes('({layer} of 3)')"
        ));
        assert_eq!(lines(&rig), 2 * (layer - 1));
        browser.press("#pen-is-in");
    }
    browser.until("etherpen.link.state.jobs.past[0]?.done");
    assert_eq!(lines(&rig), 6);
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}
