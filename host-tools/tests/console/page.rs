//! The page in a browser: an operator's typical hour in half a minute.
//!
//! `ETHERPEN_RENEW_SCREENSHOTS=1 cargo test -p host-tools --test console page` renews the pictures of the
//! documentation.

use super::browser::Browser;
use super::client::Rig;
use serde_json::json;

/// Requests new pictures.
const RENEW: &str = "ETHERPEN_RENEW_SCREENSHOTS";
pub(crate) const DESKTOP: (u32, u32) = (1600, 1000);
pub(crate) const PHONE: (u32, u32) = (390, 844);

/// A few strokes that take some seconds.
pub(crate) fn short_drawing() -> String {
    let mut rows = vec!["x_mm,y_mm,pen".to_owned()];
    for row in 0..6 {
        let y_mm = 60.0 + 12.0 * f64::from(row);
        rows.push(format!("40,{y_mm},0"));
        rows.extend((1..=24).map(|step| {
            let x_mm = 40.0 + 5.0 * f64::from(step);
            let wave_mm = 4.0 * (f64::from(step) * 0.9).sin();
            format!("{x_mm},{},1", y_mm + wave_mm)
        }));
    }
    rows.join("\n")
}

/// Drops a file on the page, as a user does with the mouse, and waits for its preview.
pub(crate) fn drop_file(browser: &mut Browser, name: &str, content: &[u8]) {
    let_fall(browser, name, content);
    browser.until(&format!(
        "etherpen.link.state.studio?.name === {} && etherpen.link.state.studio.state === 'ready'",
        json!(name)
    ));
}

/// Releases a file over the page.
pub(crate) fn let_fall(browser: &mut Browser, name: &str, content: &[u8]) {
    browser.value(&format!(
        "{{ const carried = new DataTransfer(); \
         carried.items.add(new File([new Uint8Array({})], {})); \
         document.getElementById('drop').dispatchEvent(new DragEvent('drop', \
         {{ dataTransfer: carried, bubbles: true, cancelable: true }})); }}",
        json!(content),
        json!(name)
    ));
}

/// Chooses style, size and longest time of the next drawing.
fn choose(browser: &mut Browser, wishes: [&str; 3]) {
    browser.value(&format!(
        "{{ const fields = document.querySelectorAll('#options choice-list, #options input'); \
         {}.forEach((wish, index) => (fields[index].value = wish)); }}",
        json!(wishes)
    ));
}

/// The portrait, small enough to be prepared quickly.
pub(crate) fn small_photograph() -> Vec<u8> {
    let portrait = image::open(host_tools::setup::workspace().join("samples/astronaut.png")).unwrap();
    let small = portrait.resize(120, 120, image::imageops::FilterType::Triangle);
    let mut png = std::io::Cursor::new(Vec::new());
    small.write_to(&mut png, image::ImageFormat::Png).unwrap();
    png.into_inner()
}

pub(crate) fn mode(browser: &mut Browser, name: &str) {
    browser.until(&format!("etherpen.link.state.status?.mode === {}", json!(name)));
}

/// From a newly opened page to an enabled robot.
pub(crate) fn begin(browser: &mut Browser, rig: &Rig) {
    browser.window(DESKTOP.0, DESKTOP.1);
    browser.open(&rig.url());
    browser.until("globalThis.etherpen?.link.state.you");
    browser.press("#control");
    browser.until("etherpen.link.controls");
    mode(browser, "DrivesOff");
}

/// Presses a button repeatedly until the robot is in a mode: it may be refused once after a fault.
pub(crate) fn press_until(browser: &mut Browser, button: &str, name: &str) {
    browser.until(&format!(
        "(() => {{ const there = etherpen.link.state.status?.mode === {}; \
         const now = Math.floor(performance.now() / 400); \
         if (!there && globalThis.pressedAt !== now) document.getElementById({}).click(); \
         globalThis.pressedAt = now; return there; }})()",
        json!(name),
        json!(button)
    ));
}

pub(crate) fn acknowledge(browser: &mut Browser) {
    press_until(browser, "acknowledge", "DrivesOff");
}

pub(crate) fn set_override(browser: &mut Browser, percent: u32) {
    browser.value(&format!(
        "{{ const slider = document.getElementById('override'); slider.value = {percent}; \
         slider.dispatchEvent(new Event('input')); }}"
    ));
    browser.until(&format!("etherpen.link.state.status?.override_percent === {percent}"));
}

/// From drives without power to a robot that is enabled and at rest.
pub(crate) fn enable(browser: &mut Browser) {
    mode(browser, "DrivesOff");
    if browser.value("etherpen.link.state.status.referenced") == json!(false) {
        browser.press("#reference");
        browser.until("etherpen.link.state.status.referenced");
    }
    press_until(browser, "enable", "Idle");
}

/// Saves the plot as a picture, and checks that the signals' curves are in it.
fn export_picture(browser: &mut Browser) {
    browser.value(
        "{ const make = URL.createObjectURL; \
         URL.createObjectURL = (blob) => { globalThis.saved = blob; URL.createObjectURL = make; return make.call(URL, blob); }; }",
    );
    browser.press("#scope-png");
    browser.until("globalThis.saved?.type === 'image/png'");
    browser.value(
        "createImageBitmap(saved).then((picture) => { \
         const context = new OffscreenCanvas(picture.width, picture.height).getContext('2d'); \
         context.drawImage(picture, 0, 0); \
         const { data } = context.getImageData(0, 0, picture.width, picture.height); \
         const colours = new Set(); \
         for (let at = 0; at < data.length; at += 4) colours.add(data[at] << 16 | data[at + 1] << 8 | data[at + 2]); \
         globalThis.savedPicture = { width: picture.width, plot: document.getElementById('scope').width, colours: colours.size }; }), 0",
    );
    browser.until("globalThis.savedPicture");
    let picture = browser.value("savedPicture");
    assert_eq!(picture["width"], picture["plot"], "{picture}");
    assert!(
        picture["colours"].as_u64() > Some(8),
        "curves, grid and names: {picture}"
    );
}

#[test]
fn an_operator_draws_holds_resumes_stops_and_acknowledges_in_a_browser() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    assert_eq!(
        browser.value("location.hash"),
        "",
        "the token does not stay in the address"
    );

    // A photograph is previewed but not drawn.
    choose(browser, ["sketch", "60mm", "20s"]);
    drop_file(browser, "portrait.png", &small_photograph());
    let planned_s = browser.value("etherpen.link.state.studio.planned_s").as_f64();
    assert!(planned_s.is_some_and(|planned_s| planned_s > 0.5), "{planned_s:?}");
    browser
        .until("/[0-9]+ strokes, [0-9.]+ m of line, about [0-9]+ s/.test(document.getElementById('studio').innerText)");
    browser.until("document.getElementById('paper-name').textContent === 'portrait.png · preview'");
    browser.press("#enqueue");
    browser.press("#queue button.quiet");
    browser.until("etherpen.link.state.jobs.waiting.length === 0");

    // Draw slowly, hold, resume and draw fast.
    choose(browser, ["", "", ""]);
    set_override(browser, 10);
    drop_file(browser, "waves.csv", short_drawing().as_bytes());
    browser.press("#enqueue");
    browser.press("#queue button.primary");
    mode(browser, "Drawing");
    browser.until("etherpen.link.state.progress?.executed > 2");
    browser.press("#hold");
    mode(browser, "Holding");
    let held = browser.value("etherpen.link.state.progress.executed").as_u64();
    set_override(browser, 200);
    browser.press("#resume");
    browser.until(&format!(
        "etherpen.link.state.progress.executed > {}",
        held.unwrap_or(0) + 5
    ));
    browser.until("etherpen.link.state.jobs.past.length === 1");
    assert_eq!(browser.value("etherpen.link.state.jobs.past[0].done"), true);
    assert_eq!(browser.value("etherpen.link.state.progress.strokes"), 6);
    browser.until("document.getElementById('past').innerText.includes('waves.csv')");

    // The next one is cancelled in the middle: the robot is at rest, and the history shows it.
    set_override(browser, 10);
    drop_file(browser, "cancelled.csv", short_drawing().as_bytes());
    browser.press("#enqueue");
    browser.press("#queue button.primary");
    mode(browser, "Drawing");
    browser.until("etherpen.link.state.progress?.executed > 2");
    browser.press("#cancel");
    mode(browser, "DrivesOff");
    browser.until("etherpen.link.state.jobs.past.length === 2");
    let past = browser.value("etherpen.link.state.jobs.past.find((job) => !job.done)?.name");
    assert_eq!(past, "cancelled.csv");
    browser.until("document.getElementById('past').innerText.includes('cancelled.csv')");
    set_override(browser, 100);

    // A capture that waits for a fault, and a drive that is unplugged.
    enable(browser);
    browser.value("document.getElementById('trigger-condition').value = 'fault'");
    browser.press("#trigger-arm");
    browser.until("document.getElementById('trigger-state').textContent.startsWith('armed')");
    browser.press("[data-inject='remove-2']");
    mode(browser, "Fault");
    browser.until("document.getElementById('trigger-state').textContent === 'caught'");
    browser.until("etherpen.scope.paused && etherpen.scope.plot.columns.count > 500");
    browser.press("#scope-csv");
    browser.until("etherpen.scope.exported === 1001");
    export_picture(browser);
    browser.until("!document.getElementById('fault').hidden");
    browser.press("[data-inject='insert-2']");
    acknowledge(browser);
    browser.press("#scope-pause");

    // Stop: the page shows it when the firmware does.
    enable(browser);
    browser.press("#stop");
    browser.until("document.getElementById('stop-text').textContent === 'confirmed by the firmware'");
    assert_eq!(browser.value("etherpen.link.state.status.stopped"), true);
    acknowledge(browser);

    // No other host was contacted, and no script failed.
    let host = rig.address().to_string();
    let foreign = |url: &&String| !url.contains(&host) && !url.starts_with("blob:") && !url.starts_with("about:");
    let foreign: Vec<_> = browser.requests.iter().filter(foreign).collect();
    assert!(foreign.is_empty(), "{foreign:?}");
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn sixteen_signals_are_plotted_and_the_page_fits_a_phone() {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    browser.value(
        "{ const preset = document.getElementById('scope-preset'); preset.value = '9'; \
         preset.dispatchEvent(new Event('change')); }",
    );
    browser.until("etherpen.scope.chosen.length === 16 && etherpen.scope.live.count > 100");
    browser.value("globalThis.etherpenFigures = null");
    browser.until("etherpenFigures");
    browser.value("globalThis.etherpenFigures = null");
    browser.until("etherpenFigures");
    let figures = browser.value("etherpenFigures");
    println!(
        "{} signals at 1 kHz, window of 10 s: {} frames/s, {:.1} kB/s",
        figures["signals"],
        figures["frames_per_s"],
        figures["bytes_per_s"].as_f64().unwrap_or(0.0) / 1_000.0
    );
    assert_eq!(figures["signals"], 16);

    for (width, height) in [DESKTOP, (1280, 800), (820, 1180), PHONE] {
        browser.window(width, height);
        browser.until(&format!("innerWidth === {width}"));
        let over = browser.value("document.documentElement.scrollWidth - document.documentElement.clientWidth");
        assert_eq!(over, 0, "the page is wider than {width} px");
        let stop = browser.value(
            "(() => { const box = document.getElementById('stop').getBoundingClientRect(); \
             return box.top >= 0 && box.bottom <= innerHeight && box.left >= 0 && box.right <= innerWidth; })()",
        );
        assert_eq!(stop, true, "STOP is in sight at {width} px");
    }
    let unnamed = browser.value(
        "[...document.querySelectorAll('button, input, select, canvas')].filter((it) => !it.closest('.readout') && \
         !(it.textContent.trim() || it.ariaLabel || it.getAttribute('aria-label') || it.labels?.length)).map((it) => it.outerHTML)",
    );
    assert_eq!(unnamed, json!([]), "everything that can be used has a name");
}

#[test]
fn the_documentations_pictures_are_renewed_when_asked() {
    if std::env::var_os(RENEW).is_none() {
        println!("SKIPPED: {RENEW} is not set");
        return;
    }
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    let photograph = std::fs::read(host_tools::setup::workspace().join("samples/astronaut.png")).unwrap();
    drop_file(browser, "astronaut.png", &photograph);
    let docs = host_tools::setup::workspace().join("docs");
    browser.press("#vary");
    browser.until("etherpen.link.state.variants.state === 'ready'");
    browser.value("{ scrollTo(0, 0); }");
    browser.screenshot(&docs.join("console-photograph.png"), DESKTOP.0, Some(1_110));
    browser.press("#enqueue");
    browser.press("#queue button.primary");
    browser.until("etherpen.link.state.progress?.executed_mm > 0.42 * etherpen.link.state.progress.total_mm");
    browser.screenshot(&docs.join("console.png"), DESKTOP.0, None);
    browser.dark(true);
    browser.screenshot(&docs.join("console-dark.png"), DESKTOP.0, None);
    browser.screenshot(&docs.join("console-phone.png"), PHONE.0, Some(1_490));
}
