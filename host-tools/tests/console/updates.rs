//! A page updated many times a second keeps what the user is doing: presses, focus, selection, scrolling.

use super::browser::Browser;
use super::client::{Client, Rig};
use super::page::{begin, drop_file, short_drawing};
use host_tools::random::Lcg;
use serde_json::json;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const PRESSES: u32 = 50;
const HELD: Duration = Duration::from_millis(100);

/// Changes the state continuously while `act` runs: control and log; the status changes by itself.
fn while_news_flow(rig: &Rig, act: impl FnOnce()) {
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut viewer: Option<Client> = None;
            let mut round = 0_u32;
            while !ended.load(Ordering::Relaxed) {
                round += 1;
                // Viewers come and go, and the console publishes their number.
                viewer = match viewer {
                    Some(_) => None,
                    None => Some(rig.viewer(&format!("guest {round}"))),
                };
                rig.note(&format!("line {round}"));
                std::thread::sleep(Duration::from_millis(50));
            }
        });
        // The viewers end in any case; a failure is reported afterwards.
        let acted = std::panic::catch_unwind(std::panic::AssertUnwindSafe(act));
        ended.store(true, Ordering::Relaxed);
        if let Err(panic) = acted {
            std::panic::resume_unwind(panic);
        }
    });
}

/// A page with two drawings in the queue and a prepared one, and the robot's drives.
fn page_with_lists(browser: &mut Browser, rig: &Rig) {
    begin(browser, rig);
    for name in ["one.csv", "two.csv", "three.csv"] {
        drop_file(browser, name, short_drawing().as_bytes());
        if name != "three.csv" {
            browser.press("#enqueue");
            browser.until("etherpen.link.state.studio.state === 'idle'");
        }
    }
    browser.until("document.querySelectorAll('#queue .primary').length === 2");
    browser.until("document.querySelector('#queue .primary').disabled === false");
}

#[test]
fn no_press_is_lost_while_the_page_is_updated() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    page_with_lists(browser, &rig);
    let mut random = Lcg::new(20_261_122);
    // Presses are counted but have no effect: the page is to stay as it is.
    browser.value(
        "{ globalThis.pressed = {}; globalThis.total = 0; globalThis.shown = 0; globalThis.without = 0; \
         etherpen.link.on('control', () => (without += Number(!etherpen.link.controls))); \
         for (const name of ['status', 'control']) etherpen.link.on(name, () => (shown += 1)); \
         addEventListener('click', (event) => { const it = event.target.closest('button'); if (!it) return; \
         const name = it.textContent; pressed[name] = (pressed[name] ?? 0) + 1; total += 1; \
         event.stopImmediatePropagation(); event.preventDefault(); }, true); }",
    );
    let targets = [
        ("#queue li:nth-child(2) .primary", "Draw"),
        ("#queue li:nth-child(1) .quiet", "×"),
        ("#enqueue", "Add to queue"),
        ("[data-inject='power-3']", "power dip"),
        ("[data-inject='stall']", "Stall 50 ms"),
    ];
    while_news_flow(&rig, || {
        let mut press = 0;
        while press < PRESSES {
            let (selector, name) = targets[press as usize % targets.len()];
            // A page starved by a busy computer has lost control, and its buttons with it; it may lose it at any time.
            browser.until(&format!(
                "(etherpen.link.controls || (etherpen.link.send({{ type: 'take' }}), false)) && \
                 !document.querySelector({}).disabled",
                json!(selector)
            ));
            let place = browser.place(selector);
            let before = browser.value("[without, total]");
            std::thread::sleep(Duration::from_millis(random.bits() % 120));
            browser.mouse(true, place);
            std::thread::sleep(HELD);
            browser.mouse(false, place);
            // On a busy computer a click arrives late; a lost one never arrives.
            browser.until(&format!("total > {} || without !== {}", before[1], before[0]));
            let after = browser.value("[without, total]");
            if after[0] != before[0] {
                println!("press {press} on {name} again: control was lost meanwhile");
                continue;
            }
            let count = before[1].as_u64().map(|count| count + 1);
            assert_eq!(after[1].as_u64(), count, "press {press} on {name} at {place:?}");
            press += 1;
        }
    });
    let (pressed, shown) = (browser.value("pressed"), browser.value("shown"));
    println!("{PRESSES} presses of {HELD:?}, shown anew {shown} times: {pressed}");
    assert!(shown.as_u64() > Some(50), "the page was shown anew: {shown}");
    assert!(
        targets.iter().all(|(_, name)| pressed[name].as_u64() >= Some(10)),
        "{pressed}"
    );
}

#[test]
fn focus_selection_and_scrolling_outlive_updates() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    page_with_lists(browser, &rig);
    (0..60).for_each(|line| rig.note(&format!("earlier line {line}")));
    browser.until("document.querySelectorAll('#log li').length > 60");
    browser.value(
        "{ const log = document.getElementById('log'); log.scrollTop = 40; \
         const range = document.createRange(); range.selectNodeContents(document.querySelector('#slaves tr:nth-child(2) td:nth-child(5)')); \
         getSelection().removeAllRanges(); getSelection().addRange(range); \
         document.querySelector('#queue li:nth-child(2) .primary').focus(); \
         globalThis.focused = document.activeElement; globalThis.selected = getSelection().toString(); \
         globalThis.shown = 0; for (const name of ['status', 'control']) etherpen.link.on(name, () => (shown += 1)); }",
    );
    assert_eq!(browser.value("selected.startsWith('0x')"), true);
    while_news_flow(&rig, || browser.until("shown > 60"));
    assert_eq!(browser.value("document.activeElement === focused"), true, "the focus");
    assert_eq!(
        browser.value("getSelection().toString() === selected"),
        true,
        "the selection"
    );
    assert_eq!(
        browser.value("document.getElementById('log').scrollTop"),
        json!(40),
        "the log's place"
    );

    // The cursor position in a text being edited.
    browser.value(
        "{ const size = document.querySelector('#options input'); size.focus(); size.value = '120x90mm'; \
         size.setSelectionRange(4, 6); shown = 0; }",
    );
    while_news_flow(&rig, || browser.until("shown > 60"));
    let written = browser.value(
        "(() => { const size = document.querySelector('#options input'); \
         return [document.activeElement === size, size.value, size.selectionStart, size.selectionEnd]; })()",
    );
    assert_eq!(written, json!([true, "120x90mm", 4, 6]));
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}
