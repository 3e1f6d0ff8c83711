//! The page's check of the axes: one motor alone turns while a button is held, and what the operator says is told and kept.

use super::browser::Browser;
use super::client::{Client, PATIENCE, Rig};
use super::page::{begin, enable, mode, press_until};
use etherpen::application::Mode;
use host_tools::cell::CellOptions;
use host_tools::settings::machines::MACHINES;
use serde_json::json;
use std::time::{Duration, Instant};

/// A way of an axis that a person can see, rad.
const VISIBLE_RAD: f64 = 0.02;
/// Least way of an axis that is held, rad; the largest of another one, rad and as a part of it: the robot follows a tangent from
/// where the joints were measured.
const MOVED_RAD: f64 = 2.0e-3;
const STOOD_RAD: f64 = 2.0e-4;
const STOOD_PART: f64 = 0.05;

/// Waits until the robot has been at rest for half a second by its own time.
fn rest(rig: &Rig) {
    rig.until("rest", |console| {
        let hub = console.hub();
        let history = hub.history();
        let (_, rows) = history.since(history.next().saturating_sub(500));
        rows.iter().all(|row| row.mode == Mode::Idle || row.mode == Mode::Fault)
    });
}

/// Holds a button until the motors have moved, and lets go; returns how far each motor went, rad.
fn held(browser: &mut Browser, rig: &Rig, selector: &str, (axis, way_rad): (usize, f64)) -> Vec<f64> {
    mode(browser, "Idle");
    browser.until(&format!("!document.querySelector({selector:?}).disabled"));
    let before_rad = rig.cell.state().joints.0;
    let at = browser.place(selector);
    browser.mouse(true, at);
    rig.until("the motor to turn", |_| {
        (rig.cell.state().joints.0[axis] - before_rad[axis]).abs() > way_rad
    });
    mode(browser, "Moving");
    browser.mouse(false, at);
    rest(rig);
    let stands_rad = rig.cell.state().joints.0;
    std::thread::sleep(Duration::from_millis(200));
    let after_rad = rig.cell.state().joints.0;
    let ways_rad = after_rad.iter().zip(before_rad).map(|(after, before)| after - before);
    for (then, now) in stands_rad.iter().zip(after_rad) {
        assert!((then - now).abs() < 1.0e-3, "it goes on: {then} rad, then {now} rad");
    }
    ways_rad.collect()
}

/// Homes the machine and has its drives hold it; a search for the switches needs the drives first.
fn ready(browser: &mut Browser, searches: bool) {
    if !searches {
        return enable(browser);
    }
    press_until(browser, "enable", "Unreferenced");
    browser.press("#reference");
    browser.until("etherpen.link.state.status.referenced");
    mode(browser, "Idle");
}

#[test]
fn one_motor_turns_while_its_button_is_held_on_every_kind_of_machine() {
    let Some(mut browser) = Browser::start() else { return };
    let browser = &mut browser;
    for machine in &MACHINES {
        let config = machine.load().expect("a configuration");
        let count = usize::from(config.bus.drives).min(3);
        let searches = config.axes.iter().any(|axis| axis.home.io.is_some());
        let rig = Rig::with(config, CellOptions::default(), None);
        begin(browser, &rig);
        ready(browser, searches);
        browser.click("#axes summary");
        for axis in 0..count {
            for (button, sign) in [(1, -1.0), (2, 1.0)] {
                let selector = format!(".axis:nth-child({}) > button:nth-of-type({button})", axis + 1);
                let ways_rad = held(browser, &rig, &selector, (axis, MOVED_RAD));
                for (other, way_rad) in ways_rad.iter().enumerate().take(count) {
                    match other == axis {
                        true => assert!(sign * way_rad > MOVED_RAD, "{}: {ways_rad:?}", machine.name),
                        false => assert!(
                            way_rad.abs() < STOOD_RAD + STOOD_PART * ways_rad[axis].abs(),
                            "{}, axis {axis}: {ways_rad:?}",
                            machine.name
                        ),
                    }
                }
            }
        }
    }
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn what_the_operator_says_has_its_advice_until_the_robot_loses_its_place() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    enable(browser);
    browser.click("#axes summary");
    let say = |browser: &mut Browser, axis: usize, answer: usize| {
        browser.click(&format!(".axis:nth-child({axis}) choice-list > button"));
        browser.click(&format!(".axis:nth-child({axis}) choice-list li:nth-child({answer})"));
    };
    let summary = |words: &str| format!("document.getElementById('axes-summary').textContent === '{words}'");
    let advice = "document.getElementById('axes-advice').textContent";
    browser.until(&summary("not checked"));
    for axis in 0..3 {
        let list = format!(".axis:nth-child({}) choice-list", axis + 1);
        assert_eq!(
            browser.value(&format!("document.querySelector({list:?}).disabled")),
            true
        );
        held(
            browser,
            &rig,
            &format!(".axis:nth-child({}) > button:nth-of-type(2)", axis + 1),
            (axis, VISIBLE_RAD),
        );
        browser.until(&format!("!document.querySelector({list:?}).disabled"));
    }
    // Each instead of the other: the list has "not checked", right, reversed, then the three other axes.
    say(browser, 1, 4);
    say(browser, 2, 4);
    browser.until(&format!("{advice}.startsWith('axes 1 and 2 are exchanged')"));
    browser.until(&summary("2 of 3 checked"));
    browser.keep("axes");
    say(browser, 2, 3);
    browser.until(&format!("{advice}.includes('axis 2 goes the other way')"));
    for axis in 1..=3 {
        say(browser, axis, 2);
    }
    browser.until(&summary("all as configured"));
    assert_eq!(browser.value(advice), "");
    browser.value("etherpen.link.send({type: 'inject', fault: {what: 'restart'}}), 0");
    browser.until(&summary("not checked"));
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn an_axis_that_does_not_exist_is_refused_in_words_and_nothing_moves() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("viewer");
    viewer.enable();
    let before_rad = rig.cell.state().joints.0;
    for (request, why) in [
        (
            json!({"type": "jog_axis", "axis": 0, "forward": true, "press": 1}),
            "numbered from 1",
        ),
        (
            json!({"type": "jog_axis", "axis": 4, "forward": true, "press": 1}),
            "does not move the tool",
        ),
        (
            json!({"type": "jog_axis", "axis": 255, "forward": false, "press": 1}),
            "does not move the tool",
        ),
        (json!({"type": "saw", "axis": 0, "seen": "as_told"}), "numbered from 1"),
        (
            json!({"type": "saw", "axis": 1, "seen": "as_told"}),
            "move this axis first",
        ),
        (
            json!({"type": "saw", "axis": 4, "seen": "as_told"}),
            "does not move the tool",
        ),
        (json!({"type": "saw", "axis": 1, "seen": {"other": 9}}), "no such axis"),
    ] {
        viewer.send(&request);
        viewer.until("refused", |said| said.as_str().is_some_and(|said| said.contains(why)));
    }
    let after_rad = rig.cell.state().joints.0;
    for (before, after) in before_rad.iter().zip(after_rad) {
        assert!((before - after).abs() < 1.0e-4, "{before} rad, then {after} rad");
    }
}

/// Asks for a motion of the second axis until it has gone so far, rad; returns where it began.
fn ask_until(rig: &Rig, viewer: &mut Client, way_rad: f64) -> f64 {
    let from_rad = rig.cell.state().joints.0[1];
    let begun = Instant::now();
    while (rig.cell.state().joints.0[1] - from_rad).abs() < way_rad {
        viewer.send(&json!({"type": "jog_axis", "axis": 2, "forward": true, "press": 1}));
        viewer.listen(Duration::from_millis(20));
        assert!(begun.elapsed() < PATIENCE, "it does not move");
    }
    // The telemetry may be later than the motors.
    rig.until("the motion in the telemetry", |console| {
        console.hub().history().last().is_some_and(|row| row.mode != Mode::Idle)
    });
    from_rad
}

#[test]
fn a_press_that_is_held_ends_after_its_way() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("viewer");
    viewer.enable();
    // 0.08 rad are meant; half of them come first.
    let from_rad = ask_until(&rig, &mut viewer, 0.04);
    let mut last_rad = f64::NAN;
    let begun = Instant::now();
    while rig.cell.state().joints.0[1] != last_rad || begun.elapsed() < Duration::from_secs(2) {
        last_rad = rig.cell.state().joints.0[1];
        for _ in 0..20 {
            viewer.send(&json!({"type": "jog_axis", "axis": 2, "forward": true, "press": 1}));
            viewer.listen(Duration::from_millis(20));
        }
        assert!(
            begun.elapsed() < PATIENCE,
            "it goes on: {from_rad} rad, then {last_rad} rad"
        );
    }
    let way_rad = last_rad - from_rad;
    assert!((0.04..0.12).contains(&way_rad), "{way_rad} rad");
}

#[test]
fn an_axis_stands_when_its_viewer_vanishes_or_presses_stop_and_nobody_moves_it_without_control() {
    let rig = Rig::start();
    let mut watching = rig.viewer("watching");
    let mut pressing = rig.viewer("pressing");
    pressing.enable();
    watching.send(&json!({"type": "jog_axis", "axis": 2, "forward": true, "press": 1}));
    watching.until("refused", |said| {
        said.as_str().is_some_and(|said| said.contains("control"))
    });
    let stands = |mode: Mode| {
        rig.until("standstill", |console| {
            console.hub().history().last().is_some_and(|row| row.mode == mode)
        });
        let before_rad = rig.cell.state().joints.0[1];
        std::thread::sleep(Duration::from_millis(300));
        let after_rad = rig.cell.state().joints.0[1];
        assert!(
            (before_rad - after_rad).abs() < 1.0e-3,
            "{before_rad} rad, then {after_rad} rad"
        );
    };
    ask_until(&rig, &mut pressing, MOVED_RAD);
    pressing.send(&json!({"type": "stop"}));
    stands(Mode::Fault);
    // What is asked after the stop moves nothing.
    for _ in 0..10 {
        pressing.send(&json!({"type": "jog_axis", "axis": 2, "forward": true, "press": 1}));
        pressing.listen(Duration::from_millis(20));
    }
    stands(Mode::Fault);
    pressing.recover();
    ask_until(&rig, &mut pressing, MOVED_RAD);
    drop(pressing);
    stands(Mode::Idle);
}
