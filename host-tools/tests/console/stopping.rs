//! STOP and Esc over everything that the page can show.
//!
//! Overlays are found, not listed: everything that opens something is pressed, and whatever becomes visible is an
//! overlay. The drives of the virtual cell show whether the robot was stopped.
//!
//! `ETHERPEN_SCREENSHOTS=FOLDER` saves pictures of the overlays.

use super::browser::Browser;
use super::client::{Client, PATIENCE, Rig};
use host_tools::cell::DriveState;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::{Duration, Instant};

const ESCAPE: u32 = 27;
const SIZES: [(u32, u32); 3] = [(360, 640), (1024, 768), (1440, 900)];

/// Finds, in the page, everything that can be pressed and everything that covers the page.
const SEARCH: &str = "globalThis.search = (() => {
  const inSight = (it) => it.checkVisibility({ visibilityProperty: true, opacityProperty: true }) && it.getBoundingClientRect().height > 0;
  const name = (it) => it.id ? `#${it.id}` : `${it.parentElement === document.body ? 'body' : name(it.parentElement)} > :nth-child(${[...it.parentElement.children].indexOf(it) + 1})`;
  const over = (it) => ['fixed', 'absolute'].includes(getComputedStyle(it).position) || it.matches(':modal, :popover-open, dialog[open]');
  return {
    openers: () => [...document.querySelectorAll('button, summary, select, [role=button], [role=combobox], [aria-haspopup], [popovertarget], input:not([type=text], [type=number], [type=range], [type=checkbox], [type=file])')]
      .filter((it) => inSight(it) && !it.disabled && !it.closest('#stop, #control, [role=listbox]')).map(name),
    overlays: () => [...document.body.querySelectorAll('*')].filter((it) => it.id !== 'stop' && it.tagName !== 'CANVAS' && inSight(it) && over(it)).map(name),
    stop: () => {
      const it = document.getElementById('stop');
      const { left, top, right, bottom } = it.getBoundingClientRect();
      const { visualViewport: seen } = globalThis;
      if (left < seen.offsetLeft || top < seen.offsetTop || right > seen.offsetLeft + seen.width + 1 || bottom > seen.offsetTop + seen.height + 1) return 'out of sight';
      const points = [[0.5, 0.5], [0.1, 0.2], [0.9, 0.2], [0.1, 0.8], [0.9, 0.8]].map(([x, y]) => document.elementFromPoint(left + x * (right - left), top + y * (bottom - top)));
      const wrong = points.find((found) => !it.contains(found));
      return wrong === undefined ? '' : `covered by ${wrong?.outerHTML?.slice(0, 80)}`;
    },
  };
})(), 0";

fn strings(value: &Value) -> Vec<String> {
    let list = value.as_array().expect("a list").iter();
    list.map(|item| item.as_str().expect("a text").to_owned()).collect()
}

/// Opens the page as a viewer that has not taken control: STOP needs none.
fn load(browser: &mut Browser, rig: &Rig) {
    browser.open("about:blank");
    browser.open(&rig.url());
    browser.until("globalThis.etherpen?.link.state.you && globalThis.etherpen.scope.all && etherpen.link.state.status");
    browser.value(SEARCH);
}

/// Whether every drive has power and follows.
fn has_power(rig: &Rig) -> bool {
    let slaves = rig.cell.state().slaves;
    slaves.iter().all(|slave| slave.drive == DriveState::OperationEnabled)
}

/// Switches the drives' power on, whatever prevents it.
fn power(rig: &Rig, helper: &mut Client) {
    // Messages that the helper has not read yet are older than the last stop.
    while !has_power(rig) {
        helper.recover();
    }
}

/// Waits until no drive of the cell is enabled and the robot is at rest.
fn until_stopped(rig: &Rig, how: &str) {
    let begun = Instant::now();
    loop {
        let state = rig.cell.state();
        let powered = state
            .slaves
            .iter()
            .filter(|slave| slave.drive == DriveState::OperationEnabled);
        if powered.count() == 0 && state.velocities.0.iter().all(|speed| speed.abs() < 1e-3) {
            return;
        }
        assert!(begun.elapsed() < PATIENCE, "not stopped: {how}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// A key also opens the list of keys where its button is not shown.
const LIST_OF_KEYS: &str = "key ?";

/// Presses the steps of a path to an overlay, one after the other.
fn follow(browser: &mut Browser, path: &[String]) {
    for step in path {
        match step.strip_prefix("key ") {
            Some(key) => browser.key(key, 0),
            None => browser.click(step),
        }
    }
}

/// Everything that opens an overlay, as the presses that lead there; STOP must be uncovered at every step.
fn ways_to_overlays(browser: &mut Browser, rig: &Rig, helper: &mut Client) -> Vec<Vec<String>> {
    let mut ways: Vec<Vec<String>> = Vec::new();
    let mut tried = BTreeSet::new();
    let mut open: Vec<Vec<String>> = vec![Vec::new()];
    while let Some(before) = open.pop() {
        // On a busy computer this takes minutes, for which no buffer holds what comes.
        helper.catch_up();
        load(browser, rig);
        follow(browser, &before);
        let under = strings(&browser.value("search.overlays()"));
        let mut openers = strings(&browser.value("search.openers()"));
        openers.push(LIST_OF_KEYS.to_owned());
        for opener in openers {
            if !tried.insert(opener.clone()) {
                continue;
            }
            follow(browser, std::slice::from_ref(&opener));
            assert_eq!(browser.value("search.stop()"), "", "after {before:?} and {opener}");
            let over = strings(&browser.value("search.overlays()"));
            if over.iter().any(|overlay| !under.contains(overlay)) {
                let way: Vec<String> = before.iter().chain([&opener]).cloned().collect();
                open.push(way.clone());
                ways.push(way);
                load(browser, rig);
                follow(browser, &before);
            }
        }
    }
    ways
}

/// Stops by mouse and by Esc; each time the robot has power before, and the cell's drives have none after.
fn stops(browser: &mut Browser, rig: &Rig, helper: &mut Client, what: &str, open: &mut dyn FnMut(&mut Browser)) {
    for by_key in [false, true] {
        power(rig, helper);
        load(browser, rig);
        open(browser);
        assert_eq!(browser.value("search.stop()"), "", "{what}");
        assert!(has_power(rig), "nothing but STOP stops: {what}");
        browser.keep(&format!("1 {what}"));
        match by_key {
            false => browser.click("#stop"),
            true => browser.key("Escape", ESCAPE),
        }
        until_stopped(rig, &format!("{what}, {}", if by_key { "Esc" } else { "mouse" }));
    }
}

#[test]
fn stop_and_esc_reach_the_robot_over_everything_that_the_page_can_show() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    let mut helper = rig.viewer("helper");
    helper.mode("DrivesOff");
    let mut count = 0;
    for (width, height) in SIZES {
        browser.window(width, height);
        for dark in [true, false] {
            browser.dark(dark);
            let ways = ways_to_overlays(browser, &rig, &mut helper);
            println!("{width} x {height}, {}: {ways:?}", if dark { "dark" } else { "light" });
            let shortcuts = ways.iter().any(|way| way == &[LIST_OF_KEYS]);
            let nested = ways.iter().any(|way| way.len() > 1);
            assert!(ways.len() >= 8 && shortcuts && nested, "{ways:?}");
            if dark {
                continue;
            }
            for way in ways {
                let what = format!("{way:?} at {width} x {height}");
                stops(browser, &rig, &mut helper, &what, &mut |browser| follow(browser, &way));
                count += 2;
            }
            let long = "A message that is so long that it takes several lines, however wide the window is. ".repeat(6);
            stops(
                browser,
                &rig,
                &mut helper,
                &format!("messages at {width} x {height}"),
                &mut |browser| {
                    browser.value(&format!(
                    "import('/dom.js').then(({{ toast }}) => {{ for (const tone of ['warn', 'good', 'bad', 'warn', 'good']) \
                     for (let n = 0; n < 4; n += 1) toast(`${{n}} ${{tone}} ` + {}, tone); }})",
                    json!(long)
                ));
                    browser.until("document.querySelector('.toast')");
                },
            );
            count += 2;
        }
    }
    println!("{count} stops, each seen at the drives of the cell");
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn stop_works_in_the_first_picture_of_a_page_whose_scripts_have_not_come() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    let mut helper = rig.viewer("helper");
    helper.mode("DrivesOff");
    browser.call("Fetch.enable", json!({"patterns": [{"urlPattern": "*/main.js"}]}));
    for (width, height) in SIZES {
        browser.window(width, height);
        for round in 0..3 {
            power(&rig, &mut helper);
            browser.open("about:blank");
            browser.open(&rig.url());
            browser.until("document.getElementById('about')");
            assert_eq!(
                browser.value("typeof globalThis.etherpen"),
                "undefined",
                "no module has run"
            );
            match round {
                0 => browser.click("#stop"),
                1 => browser.key("Escape", ESCAPE),
                _ => {
                    // The console cannot be reached at first.
                    browser.value(
                        "{ const real = fetch; globalThis.tries = 0; \
                         globalThis.fetch = (...call) => (tries += 1) < 4 ? Promise.reject(new TypeError('down')) : real(...call); }",
                    );
                    browser.touch("#stop");
                }
            }
            until_stopped(&rig, &format!("round {round} at {width} x {height}"));
        }
    }
}

#[test]
fn stop_stays_in_sight_when_one_zooms_in() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    let mut helper = rig.viewer("helper");
    helper.mode("DrivesOff");
    browser.window(360, 640);
    power(&rig, &mut helper);
    load(browser, &rig);
    browser.call("Emulation.setPageScaleFactor", json!({"pageScaleFactor": 2.0}));
    browser.until("visualViewport.scale === 2 && search.stop() === ''");
    assert!(has_power(&rig));
    // A press beside everything shows how a place in the window maps to the page.
    browser.value(
        "addEventListener('pointerdown', (event) => (globalThis.pressedAt ??= event.clientX - visualViewport.offsetLeft), true)",
    );
    browser.mouse(true, [40.0, 2.0]);
    browser.mouse(false, [40.0, 2.0]);
    browser.until("globalThis.pressedAt > 0");
    let scale = 40.0 / browser.value("pressedAt").as_f64().expect("a place");
    let middle = browser.value(
        "(() => { const box = document.getElementById('stop').getBoundingClientRect(); \
         return [box.left + box.width / 2 - visualViewport.offsetLeft, box.top + box.height / 2 - visualViewport.offsetTop]; })()",
    );
    let place = [0, 1].map(|axis| scale * middle[axis].as_f64().expect("a place"));
    println!("zoomed in: {scale} of the window for a pixel of the page, STOP at {place:?}");
    browser.mouse(true, place);
    browser.mouse(false, place);
    until_stopped(&rig, "zoomed in");
}

#[test]
fn nothing_in_the_pages_sources_can_come_over_stop() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("assets/console");
    let mut highest = 0;
    let mut files = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let source = std::fs::read_to_string(&path).unwrap();
        files += 1;
        // What the browser shows over the page, and what makes the rest of the page inert.
        for forbidden in [
            "showModal",
            "showPicker",
            "requestFullscreen",
            "requestPointerLock",
            "<select",
            "popover",
            "alert(",
            "confirm(",
            "prompt(",
            "beforeunload",
            "inert",
            "type=\"color\"",
            "type=\"date",
            "datalist",
            "print()",
        ] {
            assert!(!source.contains(forbidden), "{}: {forbidden}", path.display());
        }
        for layer in source.split("z-index:").skip(1) {
            let digits: String = layer.trim_start().chars().take_while(char::is_ascii_digit).collect();
            let layer: u32 = digits.parse().unwrap();
            assert!(
                layer < 1_000 || highest < 1_000,
                "only STOP lies so high: {}",
                path.display()
            );
            highest = highest.max(layer);
        }
    }
    assert!(files > 10 && highest == 1_000, "{files} files, {highest}");
}
