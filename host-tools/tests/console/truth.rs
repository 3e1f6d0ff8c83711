//! The page shows the truth: old values are distinguished from live ones, and important ones are visible.

use super::browser::Browser;
use super::client::Rig;
use super::page::{DESKTOP, begin, drop_file, enable, mode, press_until, short_drawing};
use host_tools::cell::CellOptions;
use serde_json::json;

/// An input, a word of inputs and a lamp at the terminals behind the four drives.
const POINTS: &str = "
[[io]]
name = \"part\"
slave = 5
bit = 3

[[io]]
name = \"sensors\"
slave = 5
bit = 0
type = \"u8\"

[[io]]
name = \"lamp\"
slave = 6
direction = \"out\"
bit = 0
role = \"lamp\"
";

/// Opacity of an element, 0 to 1, including that of its ancestors.
fn opacity(browser: &mut Browser, selector: &str) -> f64 {
    let product = browser.value(&format!(
        "(() => {{ let product = 1; for (let it = document.querySelector({}); it; it = it.parentElement) \
         product *= Number(getComputedStyle(it).opacity); return product; }})()",
        json!(selector)
    ));
    product.as_f64().expect("a number")
}

fn without_transitions(browser: &mut Browser) {
    browser.call(
        "Emulation.setEmulatedMedia",
        json!({"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}),
    );
}

const ROW: &str = "document.querySelector('#slaves tr:nth-child(2)')";

#[test]
fn what_a_slave_that_does_not_answer_told_last_is_shown_as_old() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    without_transitions(browser);
    enable(browser);
    browser.until(&format!("{ROW}.innerText.includes('operation enabled')"));
    assert!(opacity(browser, "#slaves tr:nth-child(2) td:nth-child(3)") > 0.9);
    assert!(opacity(browser, "#positions td:nth-child(3)") > 0.9);
    browser.press("[data-inject='remove-2']");
    mode(browser, "Fault");
    browser.until(&format!("/no answer since \\d+ s/.test({ROW}.innerText)"));
    for column in [3, 4, 6, 7] {
        let shown = opacity(browser, &format!("#slaves tr:nth-child(2) td:nth-child({column})"));
        assert!(shown < 0.6, "column {column}: {shown}");
    }
    assert!(
        opacity(browser, "#slaves tr:nth-child(2) .state") > 0.9,
        "that it is silent is live"
    );
    assert!(
        opacity(browser, "#slaves tr:nth-child(1) td:nth-child(3)") > 0.9,
        "the first drive answers"
    );
    assert!(opacity(browser, "#errors output:nth-of-type(2)") < 0.6);
    assert!(opacity(browser, "#positions td:nth-child(3)") < 0.6);
    // It returns.
    browser.press("[data-inject='insert-2']");
    press_until(browser, "acknowledge", "DrivesOff");
    browser.until("[1, 2, 3, 4].every((slave) => !document.querySelector(`#slaves tr:nth-child(${slave})`).classList.contains('old'))");
    assert!(opacity(browser, "#slaves tr:nth-child(2) td:nth-child(3)") > 0.9);
    assert!(opacity(browser, "#positions td:nth-child(3)") > 0.9);
    // All slaves behind a pulled cable are silent, whichever the fault names.
    browser.value("etherpen.link.send({ type: 'inject', fault: { what: 'cut', slave: 2 } })");
    mode(browser, "Fault");
    let silent = |slaves: &str| {
        format!(
            "{slaves}.every((slave) => document.querySelector(`#slaves tr:nth-child(${{slave}})`).classList.contains('old'))"
        )
    };
    browser.until(&format!("{} && !{}", silent("[3, 4]"), silent("[1]")));
    browser.value("etherpen.link.send({ type: 'inject', fault: { what: 'join' } })");
    press_until(browser, "acknowledge", "DrivesOff");
    browser.until(&format!("!{} && !{}", silent("[3]"), silent("[4]")));
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn measurements_that_come_no_more_are_dimmed_with_their_age() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    without_transitions(browser);
    let live = ["#positions", "#errors", "#side", "#top", "#scope-legend"];
    browser.until("etherpen.link.silentSeconds() < 0.5 && !document.body.classList.contains('silent')");
    for selector in live {
        assert!(opacity(browser, selector) > 0.9, "{selector}");
    }
    // Poses stop changing, as when the firmware has gone.
    browser.value(
        "{ const take = etherpen.link.take; globalThis.last = null; \
         etherpen.link.take = function (data) { if (!String(data).startsWith('{\"section\":\"pose\"')) return take.call(this, data); \
         last ??= data; take.call(this, last); }; }",
    );
    browser.until("/measured [1-9]\\d* s ago/.test(document.querySelector('#panel-operate').innerText)");
    for selector in live {
        assert!(opacity(browser, selector) < 0.6, "{selector}");
    }
    browser.value("{ delete etherpen.link.take; }");
    browser.until("!document.body.innerText.includes(' ago')");
    for selector in live {
        assert!(opacity(browser, selector) > 0.9, "{selector}");
    }
    // The console has gone.
    browser.value("{ etherpen.link.connect = () => {}; etherpen.link.socket.close(); }");
    browser.until("/measured [1-9]\\d* s ago/.test(document.querySelector('#panel-operate').innerText)");
    for selector in ["#positions", "#counters", "#slaves", "#past", "#scope-legend"] {
        assert!(opacity(browser, selector) < 0.6, "{selector}");
    }
    assert_eq!(
        browser
            .value("document.querySelectorAll('#queue button:not(:disabled), #slaves button:not(:disabled)').length"),
        0
    );
}

#[test]
fn marks_of_a_plot_differ_and_fit_and_a_hole_has_no_value() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    let wrong = browser.value(
        "import('/plot.js').then(({ ticks, tickTexts, Columns, Plot }) => { \
         let seed = 7; const random = () => (seed = (seed * 1103515245 + 12345) % 2147483648) / 2147483648; \
         const wrong = []; \
         for (let round = 0; round < 20000; round += 1) { \
           const middle = (random() - 0.5) * 10 ** (random() * 8 - 4); const span = Math.max(Math.abs(middle) * 1e-7, 10 ** (random() * 12 - 8)); \
           const marks = ticks(middle - span / 2, middle + span / 2, 2 + Math.floor(random() * 8)); if (marks.length < 2) continue; \
           const { texts } = tickTexts(marks, marks[1] - marks[0]); \
           if (new Set(texts).size !== texts.length || texts.some((text) => text.length > 9)) wrong.push([middle, span, texts]); } \
         for (const value of [0, 0.15, -0.15, 1e-9, 512, -850.0001]) { \
           const plot = new Plot(document.getElementById('scope')); plot.show([{ name: 'v', unit: 'rad' }]); \
           plot.columns = new Columns(10, 1); plot.columns.add([0, 1, 2], new Float32Array(6).fill(value)); \
           const [low, high] = plot.range(plot.lanes[0], 0, 3); const marks = ticks(low, high, 4); \
           const { texts } = tickTexts(marks, marks[1] - marks[0]); \
           if (!(low < value && value < high) || texts.length < 2 || new Set(texts).size !== texts.length) wrong.push([value, low, high, texts]); \
           plot.columns.add([900], new Float32Array(2).fill(value)); \
           if (plot.readout(500)[0] !== null || plot.readout(1)[0] === null || plot.readout(9999)[0] === null) wrong.push(['hole', value]); } \
         return wrong.slice(0, 5); })",
    );
    assert_eq!(wrong, json!([]));
}

#[test]
fn a_refused_acknowledgement_stands_beside_the_button_and_one_stop_is_one_message() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    browser.value(
        "{ globalThis.toasts = 0; new MutationObserver((changes) => { for (const change of changes) toasts += change.addedNodes.length; }) \
         .observe(document.getElementById('toasts'), { childList: true }); }",
    );
    // One stop in the middle of a drawing.
    drop_file(browser, "waves.csv", short_drawing().as_bytes());
    enable(browser);
    browser.press("#enqueue");
    browser.press("#queue button.primary");
    mode(browser, "Drawing");
    browser.until("etherpen.link.state.progress?.executed > 2");
    browser.value("toasts = 0");
    browser.click("#stop");
    mode(browser, "Fault");
    browser.until("etherpen.link.state.jobs.past.length === 1");
    browser.until("document.getElementById('log').innerText.includes('ended early')");
    let (toasts, told) = (
        browser.value("toasts"),
        browser.value("document.getElementById('toasts').innerText"),
    );
    println!("one STOP: {toasts} messages, {told}");
    assert!(toasts.as_u64() <= Some(1), "{toasts}: {told}");
    let log = browser.value("document.getElementById('log').innerText");
    let log = log.as_str().unwrap();
    assert_eq!(log.matches("STOP from").count(), 1, "{log}");
    assert!(!log.contains("--") && !log.contains("etherpen "), "{log}");
    press_until(browser, "acknowledge", "DrivesOff");

    // An acknowledgement while another one is in progress: the firmware's answer is shown at the button.
    for (width, height) in [(360, 640), (1024, 768), DESKTOP] {
        browser.window(width, height);
        browser.press("[data-inject='remove-2']");
        mode(browser, "Fault");
        browser.until("!document.getElementById('acknowledge').disabled");
        browser.value("document.getElementById('fault-note').hidden = true");
        browser.value("document.getElementById('log').scrollTop = 0");
        // Both before the page can know the result of the first.
        browser.value("{ const button = document.getElementById('acknowledge'); button.click(); button.click(); }");
        browser.until(
            "(() => { const it = document.getElementById('fault-note'); const box = it.getBoundingClientRect(); \
             return !it.hidden && it.innerText.length > 10 && box.top >= 0 && box.bottom <= innerHeight; })()",
        );
        println!(
            "{width} x {height}: {}",
            browser.value("document.getElementById('fault-note').innerText")
        );
        browser.press("[data-inject='insert-2']");
        press_until(browser, "acknowledge", "DrivesOff");
        browser.until("document.getElementById('fault-note').hidden");
    }
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn a_preview_is_ink_on_paper_in_the_light_and_in_the_dark() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    drop_file(browser, "waves.csv", short_drawing().as_bytes());
    for dark in [false, true] {
        browser.dark(dark);
        let contrast = "(() => { const it = document.getElementById('paper'); \
            const { data } = it.getContext('2d').getImageData(0, 0, it.width, it.height); \
            const linear = (byte) => ((byte / 255) <= 0.04045 ? byte / 255 / 12.92 : ((byte / 255 + 0.055) / 1.055) ** 2.4); \
            const found = []; for (let at = 0; at < data.length; at += 4) if (data[at + 3] === 255) found.push(0.2126 * linear(data[at]) + 0.7152 * linear(data[at + 1]) + 0.0722 * linear(data[at + 2])); \
            found.sort((a, b) => a - b); const [ink, sheet] = [found[Math.floor(found.length / 1000)], found[Math.floor(found.length * 0.9)]]; \
            return (sheet + 0.05) / (ink + 0.05); })()";
        browser.until(&format!("{contrast} > 7"));
        println!(
            "contrast of the ink, {}: {}",
            if dark { "dark" } else { "light" },
            browser.value(contrast)
        );
    }
}

#[test]
fn jobs_are_in_sight_and_nothing_of_the_head_is_cut() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    for (width, height) in [(360, 640), (1024, 768), (1280, 800), (1440, 900)] {
        browser.window(width, height);
        browser.until(&format!("innerWidth === {width}"));
        let texts = [
            "a drawing with a name that is as long as names of files often are.png, 12 min 34 s left",
            "the drives have power, the robot stands and waits for what it is to do next",
        ];
        for words in texts {
            let cut = browser.value(&format!(
                "(() => {{ document.getElementById('mode-text').textContent = {}; \
                 const stop = document.getElementById('stop').getBoundingClientRect(); \
                 return [...document.querySelectorAll('header *, #panel-jobs *')].filter((it) => {{ const box = it.getBoundingClientRect(); \
                 const style = getComputedStyle(it); if (!box.width || style.position === 'absolute' || style.opacity === '0') return false; \
                 const over = it.closest('header') && box.left < stop.right && box.right > stop.left && box.top < stop.bottom && box.bottom > stop.top; \
                 return over || box.right > innerWidth + 1 || (style.overflowX !== 'visible' && it.scrollWidth > it.clientWidth + 1 && it.tagName !== 'INPUT'); }}).map((it) => it.outerHTML.slice(0, 90)); }})()",
                json!(words)
            ));
            assert_eq!(cut, json!([]), "{width} x {height}");
        }
        if width > 860 {
            let bottom = browser
                .value("document.getElementById('options').getBoundingClientRect().bottom")
                .as_f64();
            assert!(
                bottom.is_some_and(|bottom| bottom < f64::from(height)),
                "jobs end at {bottom:?} of {height} px"
            );
        }
    }
}

#[test]
fn named_inputs_and_outputs_are_shown_with_their_values_and_as_missing_without_their_terminal() {
    let Some(mut browser) = Browser::start() else { return };
    let config = host_tools::settings::reading::configuration(POINTS).unwrap();
    let rig = Rig::with(config, CellOptions::default(), None);
    let browser = &mut browser;
    begin(browser, &rig);
    let shows = |browser: &mut Browser, point: &str, value: &str| {
        browser.until(&format!(
            "[...document.querySelectorAll('#io > div')].some((it) => it.querySelector('dt').textContent === {} && \
             it.querySelector('dd').textContent === {})",
            json!(point),
            json!(value)
        ));
    };
    shows(browser, "part (input)", "0");
    shows(browser, "sensors (input)", "0");
    enable(browser);
    shows(browser, "lamp (output, lamp)", "1");
    browser.press("[data-inject='remove-6']");
    shows(browser, "part (input)", "missing");
    shows(browser, "sensors (input)", "missing");
    browser.press("[data-inject='remove-7']");
    shows(browser, "lamp (output, lamp)", "missing");
    browser.until("!document.getElementById('bring-back').hidden");
    browser
        .value("{ document.getElementById('bring-back').scrollIntoView({ block: 'center', behavior: 'instant' }); }");
    browser.keep("24 missing terminals");
    browser.press("[data-inject='insert-6']");
    browser.press("[data-inject='insert-7']");
    browser.until(
        "[6, 7].every((slave) => !document.querySelector(`#slaves tr:nth-child(${slave})`).classList.contains('old'))",
    );
    browser.press("#bring-back");
    shows(browser, "part (input)", "0");
    shows(browser, "lamp (output, lamp)", "1");
    browser.until("document.getElementById('bring-back').hidden");
}
