//! Jogs by the keyboard: whatever becomes of a key, the robot moves only while it is held.

use super::browser::Browser;
use super::client::Rig;
use super::page::{acknowledge, begin, enable, mode};
use serde_json::json;
use std::time::Duration;

/// Sends an event of a key: what it is, where it is on the keyboard, and bits of Alt 1, Ctrl 2, Meta 4, Shift 8.
fn key(browser: &mut Browser, kind: &str, name: &str, code: &str, modifiers: u32) {
    let params = json!({"type": kind, "key": name, "code": code, "modifiers": modifiers});
    browser.call("Input.dispatchKeyEvent", params);
}

/// Holds a key until the robot moves.
fn hold(browser: &mut Browser, name: &str, code: &str) {
    mode(browser, "Idle");
    browser.until("etherpen.link.allows('jog')");
    key(browser, "rawKeyDown", name, code, 0);
    mode(browser, "Moving");
}

/// Has the page count the jogs that it sends from now on.
fn count_jogs(browser: &mut Browser) {
    browser.value(
        "{ globalThis.jogs = 0; globalThis.plainly ??= etherpen.link.send; etherpen.link.send = function (request) { \
         if (request.type === 'jog' && request.velocity_mm_s.some((part) => part !== 0)) globalThis.jogs += 1; \
         return globalThis.plainly.call(this, request); }; }",
    );
}

/// Asserts that the motors come to rest and stay there, and that no jog was sent since they are counted: without that, the
/// robot would go on to the end of its area.
fn assert_stands(browser: &mut Browser, rig: &Rig) {
    browser.until("etherpen.link.state.status.mode !== 'Moving' && etherpen.link.state.status.mode !== 'Stopping'");
    let angles_rad = |rig: &Rig| rig.cell.state().joints.0;
    let before_rad = angles_rad(rig);
    std::thread::sleep(Duration::from_millis(300));
    for (before, now) in before_rad.iter().zip(angles_rad(rig)) {
        assert!((before - now).abs() < 1.0e-3, "{before} rad, then {now} rad");
    }
    assert_eq!(browser.value("globalThis.jogs"), 0);
}

#[test]
fn the_robot_stands_once_a_key_is_released_whatever_letter_it_is_by_then() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    enable(browser);
    browser.press("#jog-keys");
    // NumLock or Shift have changed its letter meanwhile.
    hold(browser, "ArrowUp", "Numpad8");
    key(browser, "keyUp", "8", "Numpad8", 0);
    count_jogs(browser);
    assert_stands(browser, &rig);
    // Nothing is told of a key that is released while Meta is held.
    hold(browser, "ArrowDown", "ArrowDown");
    key(browser, "rawKeyDown", "Meta", "MetaLeft", 4);
    count_jogs(browser);
    assert_stands(browser, &rig);
    key(browser, "keyUp", "Meta", "MetaLeft", 0);
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn a_key_held_through_a_stop_moves_nothing_when_power_is_back() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    enable(browser);
    browser.press("#jog-keys");
    hold(browser, "ArrowUp", "ArrowUp");
    browser.press("#stop");
    mode(browser, "Fault");
    count_jogs(browser);
    assert_stands(browser, &rig);
    acknowledge(browser);
    enable(browser);
    mode(browser, "Idle");
    assert_stands(browser, &rig);
    assert_eq!(browser.value("etherpen.link.state.status.mode"), "Idle");
    // Pressed anew, it jogs.
    key(browser, "keyUp", "ArrowUp", "ArrowUp", 0);
    hold(browser, "ArrowDown", "ArrowDown");
    key(browser, "keyUp", "ArrowDown", "ArrowDown", 0);
    count_jogs(browser);
    assert_stands(browser, &rig);
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}
