//! Drawings that end early and are continued from the page: the ink is complete, and little of it is drawn twice.
//!
//! `ETHERPEN_SCREENSHOTS=FOLDER` saves pictures of the page.

use super::browser::Browser;
use super::client::Rig;
use super::page::{begin, drop_file, enable, mode, set_override, short_drawing};
use host_tools::cell::InkStroke;
use serde_json::json;

/// Largest distance of a point of ink from the other run's ink, mm.
const SAME_MM: f64 = 0.1;
/// Most ink drawn twice, mm: the overlap of one millimetre, and what was drawn while the last telemetry was in transit.
const TWICE_MAX_MM: f64 = 8.0;
/// Longest distance beside the line that the drives need to stop, mm.
const STOP_MM: f64 = 8.0;

type Point = [f64; 2];

fn whole_mm(ink: &[InkStroke]) -> f64 {
    ink.iter().map(InkStroke::length_mm).sum()
}

/// Distance of a point from the nearest ink, mm.
fn away_mm(point: &Point, ink: &[InkStroke]) -> f64 {
    let lines = ink.iter().map(|stroke| stroke.distance_mm(point));
    lines.fold(f64::INFINITY, f64::min)
}

/// Adds the drawing to the queue and starts it. If a busy computer does not schedule the page for seconds, or the line
/// falls silent, takes control again and resumes a held drawing.
fn start(browser: &mut Browser) {
    browser.value(
        "setInterval(() => { const { link } = etherpen; \
         if (link.state.control && link.state.control.holder === null) link.send({ type: 'take' }); \
         if (link.allows('resume')) link.command({ do: 'resume' }); }, 300), 0",
    );
    drop_file(browser, "waves.csv", short_drawing().as_bytes());
    browser.press("#enqueue");
    browser.press("#queue button.primary");
}

/// Ink of the uninterrupted drawing.
fn undisturbed(browser: &mut Browser) -> Vec<InkStroke> {
    let rig = Rig::start();
    begin(browser, &rig);
    start(browser);
    browser.until("etherpen.link.state.jobs.past.length === 1 && etherpen.link.state.jobs.past[0].done");
    assert_eq!(
        browser.value("document.querySelectorAll('#past button:not([hidden])').length"),
        0,
        "what is done needs no button"
    );
    rig.cell().ink()
}

/// Waits until the pen is in the middle of a stroke that is neither the first nor the last one.
fn until_broken(rig: &Rig) {
    rig.until("the third stroke", |_| {
        let ink = rig.cell().ink();
        let last = ink.last().map_or(0.0, InkStroke::length_mm);
        ink.len() == 3 && last > 40.0
    });
}

fn check(what: &str, whole: &[InkStroke], ink: &[InkStroke]) {
    let points = whole.iter().flat_map(|stroke| &stroke.points_mm);
    let missing_mm = points.map(|point| away_mm(point, ink)).fold(0.0, f64::max);
    let points_mm = (ink.iter().flat_map(|stroke| &stroke.points_mm))
        .filter(|point| away_mm(point, whole) > SAME_MM)
        .copied()
        .collect();
    let stray = InkStroke {
        points_mm,
        ..InkStroke::default()
    };
    let (whole_mm, drawn_mm, stray_mm) = (whole_mm(whole), whole_mm(ink), stray.length_mm());
    println!(
        "{what}: {whole_mm:.2} mm undisturbed, {drawn_mm:.2} mm with the interruption, {stray_mm:.2} mm of them beside the \
         lines; farthest point without ink {missing_mm:.3} mm"
    );
    assert!(
        missing_mm <= SAME_MM,
        "{what}: ink is missing {missing_mm} mm away from any other"
    );
    assert!(stray_mm < STOP_MM, "{what}: {stray_mm} mm beside the lines");
    let twice_mm = drawn_mm - stray_mm - whole_mm;
    assert!(twice_mm < TWICE_MAX_MM, "{what}: {twice_mm} mm were drawn twice");
}

fn picture(browser: &mut Browser, name: &str) {
    if let Some(folder) = std::env::var_os("ETHERPEN_SCREENSHOTS") {
        browser.screenshot(&std::path::Path::new(&folder).join(name), 1600, None);
    }
}

/// Presses *Continue* and waits for the end of the drawing.
fn go_on(browser: &mut Browser) {
    // On a busy computer the browser presses late.
    let stroke = browser.value("etherpen.link.state.jobs.past[0].stroke").as_u64();
    assert!(stroke.is_some_and(|stroke| (3..=6).contains(&stroke)), "{stroke:?}");
    browser.press("#past button.continue");
    until_drawn(browser);
}

fn until_drawn(browser: &mut Browser) {
    browser.until("etherpen.link.state.jobs.past.length === 1 && etherpen.link.state.jobs.past[0].done");
    browser.until("!document.querySelector('#past button:not([hidden])')");
}

#[test]
fn a_drawing_goes_on_from_the_history_after_a_fault_a_stop_and_a_cancel() {
    let Some(mut browser) = Browser::start() else { return };
    let browser = &mut browser;
    let whole = undisturbed(browser);
    for (what, press) in [
        ("fault", "[data-inject='fault-2']"),
        ("stop", "#stop"),
        ("cancel", "#cancel"),
    ] {
        let rig = Rig::start();
        begin(browser, &rig);
        set_override(browser, 50);
        start(browser);
        until_broken(&rig);
        browser.press(press);
        browser.until("etherpen.link.state.jobs.past.length === 1");
        assert_eq!(
            browser.value("etherpen.link.state.jobs.past[0].unfinished"),
            json!(true)
        );
        picture(browser, &format!("8-{what}.png"));
        if what != "cancel" {
            super::page::acknowledge(browser);
        }
        mode(browser, "DrivesOff");
        go_on(browser);
        check(what, &whole, &rig.cell().ink());
    }
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn a_restart_of_the_firmware_in_a_drawing_ends_it_and_it_goes_on_where_the_ink_ends() {
    let Some(mut browser) = Browser::start() else { return };
    let browser = &mut browser;
    let whole = undisturbed(browser);
    let rig = Rig::start();
    begin(browser, &rig);
    set_override(browser, 50);
    start(browser);
    until_broken(&rig);
    browser.press("#segment [data-inject='restart']");
    // The job ends and the controller is configured automatically; the texts are worded for the user.
    browser.until("etherpen.link.state.jobs.past.length === 1");
    browser.until("document.getElementById('past').innerText.includes('restarted')");
    let words = browser.value("document.getElementById('past').innerText");
    assert!(
        words.as_str().is_some_and(|words| !words.contains("etherpen ")),
        "{words}"
    );
    browser.until(
        "etherpen.link.state.status && !['Startup', 'BusConfiguring'].includes(etherpen.link.state.status.mode)",
    );
    picture(browser, "6-restarted.png");
    // The drives have latched the loss of telegrams.
    browser.until("['Fault', 'DrivesOff'].includes(etherpen.link.state.status?.mode)");
    if browser.value("etherpen.link.state.status.mode") == json!("Fault") {
        super::page::acknowledge(browser);
    }
    mode(browser, "DrivesOff");
    assert_eq!(
        browser.value("document.querySelector('#past button.continue').disabled"),
        true
    );
    picture(browser, "6-unreferenced.png");
    browser.press("#past button.reference-here");
    browser.until("etherpen.link.state.status.referenced");
    picture(browser, "6-ready.png");
    // Some drives report the loss of telegrams only when they are enabled; the drawing stays unfinished meanwhile.
    browser.press("#past button.continue");
    browser.until("['Fault', 'Drawing'].includes(etherpen.link.state.status?.mode)");
    if browser.value("etherpen.link.state.status.mode") == json!("Fault") {
        browser.until("etherpen.link.state.jobs.past.length === 1");
        super::page::acknowledge(browser);
        browser.press("#past button.continue");
    }
    until_drawn(browser);
    check("restart", &whole, &rig.cell().ink());
    // Everything else works again, too.
    enable(browser);
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}
