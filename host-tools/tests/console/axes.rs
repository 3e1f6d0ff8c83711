//! The page's check of the axes: one motor alone turns while a button is held, and what the operator says is told and kept.

use super::browser::Browser;
use super::client::Rig;
use super::page::{begin, enable, mode, press_until};
use host_tools::cell::CellOptions;
use host_tools::settings::machines::MACHINES;
use serde_json::json;
use std::time::Duration;

/// Least and largest way of an axis that is held, rad, and the largest of another one.
const MOVED_RAD: f64 = 2.0e-3;
const STOOD_RAD: f64 = 2.0e-4;

/// Holds a button until the motors have moved, and lets go; returns how far each motor went, rad.
fn held(browser: &mut Browser, rig: &Rig, selector: &str, axis: usize) -> Vec<f64> {
    mode(browser, "Idle");
    browser.until(&format!("!document.querySelector({selector:?}).disabled"));
    let before_rad = rig.cell.state().joints.0;
    let at = browser.place(selector);
    browser.mouse(true, at);
    rig.until("the motor to turn", |_| {
        (rig.cell.state().joints.0[axis] - before_rad[axis]).abs() > MOVED_RAD
    });
    mode(browser, "Moving");
    browser.mouse(false, at);
    mode(browser, "Idle");
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
                let ways_rad = held(browser, &rig, &selector, axis);
                for (other, way_rad) in ways_rad.iter().enumerate().take(count) {
                    match other == axis {
                        true => assert!(sign * way_rad > MOVED_RAD, "{}: {ways_rad:?}", machine.name),
                        false => assert!(way_rad.abs() < STOOD_RAD, "{}, axis {axis}: {ways_rad:?}", machine.name),
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
    browser.until(&summary("which one is which"));
    // Each instead of the other: the list has "not said", right, reversed, then the three other axes.
    say(browser, 1, 4);
    say(browser, 2, 4);
    browser.until(&format!("{advice}.startsWith('axes 1 and 2 are exchanged')"));
    browser.until(&summary("2 of 3 said"));
    browser.keep("axes");
    say(browser, 2, 3);
    browser.until(&format!("{advice}.includes('axis 2 goes the other way')"));
    for axis in 1..=3 {
        say(browser, axis, 2);
    }
    browser.until(&summary("all as configured"));
    assert_eq!(browser.value(advice), "");
    browser.value("etherpen.link.send({type: 'inject', fault: {what: 'restart'}}), 0");
    browser.until(&summary("which one is which"));
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
            json!({"type": "jog_axis", "axis": 0, "forward": true}),
            "numbered from 1",
        ),
        (
            json!({"type": "jog_axis", "axis": 4, "forward": true}),
            "does not move the tool",
        ),
        (
            json!({"type": "jog_axis", "axis": 255, "forward": false}),
            "does not move the tool",
        ),
        (
            json!({"type": "saw", "axis": 0, "seen": "as_told"}),
            "does not move the tool",
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
