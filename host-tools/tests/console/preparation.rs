//! A file becomes a drawing: it is never lost, and every change of an option plans it again.

use super::browser::Browser;
use super::client::{Client, Rig, TOKEN};
use super::page::{DESKTOP, begin, drop_file, let_fall, short_drawing, small_photograph};
use serde_json::json;

/// Opens the page as a viewer that has not taken control.
fn look(browser: &mut Browser, url: &str) {
    browser.window(DESKTOP.0, DESKTOP.1);
    browser.open(url);
    browser.until("globalThis.etherpen?.link.state.you && etherpen.link.state.control");
}

fn is_ready(name: &str) -> String {
    format!("etherpen.link.state.studio?.name === '{name}' && etherpen.link.state.studio.state === 'ready'")
}

const KEPT: &str = "(document.getElementById('kept').hidden ? '' : document.getElementById('kept').innerText)";

#[test]
fn a_file_that_is_dropped_without_control_takes_free_control_and_is_kept_where_it_is_not_free() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;

    // Control is free: the drop takes it.
    look(browser, &rig.url());
    assert_eq!(browser.value("etherpen.link.controls"), false);
    let_fall(browser, "free.csv", short_drawing().as_bytes());
    browser.until(&is_ready("free.csv"));
    assert_eq!(browser.value("etherpen.link.controls"), true);
    assert_eq!(browser.value(KEPT), "");
    browser.press("#control");

    // Another viewer has control: the file waits, the page shows why, and a press continues it.
    let mut other = rig.viewer("other");
    browser.until("etherpen.link.state.control.holder === null");
    other.send(&json!({"type": "take"}));
    let you = other.sections["you"]["id"].clone();
    other.state("control", |control| control["holder"] == you);
    browser.until("etherpen.link.state.control.holder");
    let_fall(browser, "taken.csv", short_drawing().as_bytes());
    browser.until(&format!(
        "{KEPT}.includes('taken.csv is kept') && {KEPT}.includes('Viewer {you} has control')"
    ));
    other.send(&json!({"type": "alive"}));
    browser.click("#kept button");
    browser.until(&is_ready("taken.csv"));
    assert_eq!(browser.value(KEPT), "");

    // Control is released: the waiting file shows it, and continues with the button in the page's header.
    browser.press("#control");
    browser.until("etherpen.link.state.control.holder === null");
    other.send(&json!({"type": "take"}));
    browser.until("etherpen.link.state.control.holder");
    let_fall(browser, "later.csv", short_drawing().as_bytes());
    browser.until(&format!("{KEPT}.includes('later.csv')"));
    other.send(&json!({"type": "release"}));
    browser.until(&format!("{KEPT}.includes('Take control')"));
    browser.press("#control");
    browser.until(&is_ready("later.csv"));

    // A file that the console cannot use is named, and the next file is accepted.
    let_fall(browser, "letter.png", b"no picture");
    browser.until("document.getElementById('studio').innerText.includes('letter.png')");
    drop_file(browser, "after.csv", short_drawing().as_bytes());
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn a_page_without_the_token_keeps_the_file_and_says_what_is_to_be_done() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    look(browser, &rig.url().replace(TOKEN, "wrong"));
    let_fall(browser, "guest.csv", short_drawing().as_bytes());
    browser.until(&format!(
        "{KEPT}.includes('guest.csv is kept') && {KEPT}.includes('address')"
    ));
    assert_eq!(browser.value("etherpen.link.state.studio.state"), "idle");
}

/// Darkest value of the sheet's picture, 0 black to 255 white.
const DARKEST: &str = "(() => { const it = document.getElementById('paper'); \
    const { data } = it.getContext('2d').getImageData(0, 0, it.width, it.height); \
    const found = []; for (let at = 0; at < data.length; at += 4) if (data[at + 3] === 255) found.push((data[at] + data[at + 1] + data[at + 2]) / 3); \
    found.sort((a, b) => a - b); return found[Math.floor(found.length / 2000)]; })()";

/// Sets the three options as a user does, one after the other.
fn wish(browser: &mut Browser, wishes: [&str; 3]) {
    browser.value(&format!(
        "{{ const fields = document.querySelectorAll('#options choice-list, #options input'); \
         {}.forEach((wish, index) => {{ fields[index].value = wish; fields[index].dispatchEvent(new Event('change')); }}); }}",
        json!(wishes)
    ));
}

#[test]
fn every_wish_replans_the_file_and_the_last_one_wins() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    browser.value(
        "{ globalThis.ready = []; globalThis.dimmed = []; etherpen.link.on('path', (path) => { if (path.use === 2) globalThis.path = path; }); \
         etherpen.link.on('studio', (made) => { if (made?.state === 'ready') ready.push(made.wishes); }); }",
    );
    let is = |style: &str, size: &str| {
        format!(
            "etherpen.link.state.studio.state === 'ready' && etherpen.link.state.studio.wishes.style === '{style}' \
             && etherpen.link.state.studio.wishes.size === '{size}'"
        )
    };
    wish(browser, ["sketch", "60mm", "20s"]);
    drop_file(browser, "portrait.png", &small_photograph());
    browser.until(&format!("{} && globalThis.path", is("sketch", "60mm")));
    let width = "(Math.max(...path.x.filter((_, at) => path.drawn[at])) - Math.min(...path.x.filter((_, at) => path.drawn[at])))";
    let height = width.replace("path.x", "path.y");
    let extent = format!("Math.max({width}, {height})");
    let first = browser.value(&extent).as_f64().unwrap();
    assert!((40.0..=60.5).contains(&first), "{first} mm");
    browser.until(&format!("{DARKEST} < 120"));
    let drawn = browser.value(DARKEST).as_f64().unwrap();
    let strokes = browser.value("etherpen.link.state.studio.strokes");

    // One option set with the mouse: the old preview is dimmed until the new one arrives.
    browser.value(&format!(
        "{{ globalThis.darkest = null; etherpen.link.on('studio', (made) => {{ if (made?.state === 'working' && darkest === null) \
         requestAnimationFrame(() => requestAnimationFrame(() => (darkest = {DARKEST}))); }}); }}"
    ));
    browser.click("#options choice-list button");
    browser.click("#options choice-list li[data-value=hatch]");
    browser.keep("12 while it is planned");
    browser.until("darkest !== null");
    browser.until(&is("hatch", "60mm"));
    browser.keep("12 planned");
    let dimmed = browser.value("darkest").as_f64().unwrap();
    println!("darkest of the sheet: preview {drawn}, while it is planned anew {dimmed}");
    assert!(drawn < 120.0 && dimmed > drawn + 60.0, "{drawn}, {dimmed}");
    assert_ne!(
        browser.value("etherpen.link.state.studio.strokes"),
        strokes,
        "another style, another drawing"
    );

    // Quick changes: only the last one is shown, and it is the one that can be drawn.
    browser.value("{ ready.length = 0; }");
    for (style, size) in [
        ("sketch", "50mm"),
        ("tsp", "90mm"),
        ("hatch", "70mm"),
        ("sketch", "45mm"),
        ("hatch", "85mm"),
    ] {
        wish(browser, [style, size, "20s"]);
    }
    browser.until(&is("hatch", "85mm"));
    browser.until(&format!("{extent} > 75"));
    let last = browser.value(&extent).as_f64().unwrap();
    assert!((75.0..=85.5).contains(&last), "{last} mm");
    browser.press("#enqueue");
    browser.until("etherpen.link.state.jobs.waiting.length === 1");
    let ready = browser.value("ready");
    assert_eq!(
        ready.as_array().unwrap().last(),
        Some(&json!({"style": "hatch", "size": "85mm", "max_time": "20s", "crop": "", "background": "", "focus": ""})),
        "{ready}"
    );

    // An impossible option is reported in the page's words; the file stays, and the next option is applied.
    drop_file(browser, "again.png", &small_photograph());
    wish(browser, ["hatch", "ninety", "20s"]);
    browser.until("etherpen.link.state.studio.state === 'failed'");
    let told = browser.value("document.getElementById('studio').innerText");
    let told = told.as_str().unwrap();
    assert!(
        told.contains("again.png") && told.contains("size") && !told.contains("--"),
        "{told}"
    );
    wish(browser, ["hatch", "55mm", "20s"]);
    browser.until(&is("hatch", "55mm"));
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn an_older_preparation_never_replaces_a_newer_one() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("one");
    viewer.send(&json!({"type": "take"}));
    let you = viewer.sections["you"]["id"].clone();
    viewer.state("control", |control| control["holder"] == you);
    viewer.send(&json!({"type": "replan", "wishes": {"style": "hatch"}}));
    viewer.until("refused", |why| why.as_str().is_some_and(|why| why.contains("no file")));
    let head = format!(
        "POST /file HTTP/1.1\r\nHost: {}\r\nx-etherpen-token: {TOKEN}\r\nx-etherpen-viewer: {you}\r\nx-etherpen-name: portrait.png",
        rig.address()
    );
    let answer = rig.http(&head, &small_photograph());
    assert!(answer.starts_with("HTTP/1.1 202"), "{answer}");
    let sizes: Vec<String> = (40..60).map(|mm| format!("{mm}mm")).collect();
    for size in &sizes {
        let wishes = json!({"style": "hatch", "size": size, "max_time": "20s"});
        viewer.send(&json!({"type": "replan", "wishes": wishes}));
    }
    let mut numbers = Vec::new();
    let mut last = |viewer: &mut Client| {
        let made = viewer.until("studio", |made| made["state"] == "ready");
        numbers.push(made["number"].as_u64().unwrap());
        made["wishes"]["size"] == "59mm"
    };
    while !last(&mut viewer) {}
    println!("20 wishes at once: the ready previews were {numbers:?}");
    assert!(numbers.is_sorted(), "{numbers:?}");
    // After such a long silence it may have lost control.
    viewer.send(&json!({"type": "take", "force": true}));
    viewer.send(&json!({"type": "enqueue", "preparation": numbers.last()}));
    viewer.until("jobs", |jobs| {
        jobs["waiting"].as_array().is_some_and(|waiting| waiting.len() == 1)
    });
    viewer.send(&json!({"type": "replan", "wishes": {}}));
    viewer.until("refused", |why| why.as_str().is_some_and(|why| why.contains("no file")));
}
