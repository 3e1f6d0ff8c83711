//! The photograph on the page in a browser: the frame under a mouse, a finger and the keys, and variants to press.
//!
//! `ETHERPEN_SCREENSHOTS=FOLDER` saves pictures of the page.

use super::browser::Browser;
use super::client::Rig;
use super::page::{DESKTOP, PHONE, begin, drop_file, enable, small_photograph};
use super::photograph::{astronaut, disc};
use serde_json::json;

const STUDIO: &str = "etherpen.link.state.studio";

/// Left, top, width and height of an element as shares of the photograph on the page.
fn shares(browser: &mut Browser, selector: &str) -> [f64; 4] {
    let found = browser.value(&format!(
        "(() => {{ const all = document.querySelector('.photograph img').getBoundingClientRect(); \
         const it = document.querySelector({}).getBoundingClientRect(); \
         return [(it.left - all.left) / all.width, (it.top - all.top) / all.height, it.width / all.width, it.height / all.height]; }})()",
        json!(selector)
    ));
    [0, 1, 2, 3].map(|k| found[k].as_f64().unwrap())
}

fn window(browser: &mut Browser) -> [f64; 4] {
    let found = browser.value(&format!("{STUDIO}.photograph.window_px"));
    [0, 1, 2, 3].map(|k| found[k].as_f64().unwrap())
}

fn is_near(a: [f64; 4], b: [f64; 4], by: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= by)
}

/// The frame is where the part lies in the photograph of 512 x 512 pixels.
fn assert_framed(browser: &mut Browser) {
    let (shown, wanted) = (
        shares(browser, ".photograph .frame"),
        window(browser).map(|px| px / 512.0),
    );
    assert!(is_near(shown, wanted, 0.012), "{shown:?}, not {wanted:?}");
}

/// Waits until the last change of the window is drawn.
fn until_drawn(browser: &mut Browser, crop: &str) {
    browser.until(&format!("{STUDIO}?.state === 'ready' && {crop}"));
}

/// Chooses a value of a list with the pointer.
fn pick(browser: &mut Browser, field: &str, value: &str) {
    let list = format!("#options .field:has(choice-list[label^={}]) choice-list", json!(field));
    browser.click(&format!("{list} > button"));
    browser.click(&format!("{list} li[data-value={}]", json!(value)));
    // No value lies under STOP.
    assert_eq!(
        browser.value("etherpen.link.state.status.stopped"),
        false,
        "{field}: {value}"
    );
}

/// Width and height of the preview's ink on the sheet, mm.
fn ink_mm(browser: &mut Browser) -> [f64; 2] {
    browser.until(&format!("globalThis.path?.number === {STUDIO}.number"));
    ["x", "y"].map(|axis| {
        let side = format!(
            "(() => {{ const all = path.{axis}.filter((_, at) => path.drawn[at]); return Math.max(...all) - Math.min(...all); }})()"
        );
        browser.value(&side).as_f64().unwrap()
    })
}

fn frame_by_hand(size: (u32, u32)) {
    let Some(mut browser) = Browser::start() else { return };
    let rig = Rig::start();
    let browser = &mut browser;
    begin(browser, &rig);
    enable(browser);
    browser.window(size.0, size.1);
    browser.until(&format!("innerWidth === {}", size.0));
    browser.value("{ etherpen.link.on('path', (path) => { if (path.use === 2) globalThis.path = path; }); setInterval(() => { const { link } = etherpen; if (link.state.control?.holder === null) link.send({ type: 'take' }); }, 300); }");
    browser.value("{ const [size, time] = document.querySelectorAll('#options label input'); size.value = '60mm'; time.value = '15s'; }");
    drop_file(browser, "astronaut.png", &astronaut());
    browser.until("document.querySelector('.photograph img')?.naturalWidth > 100");
    // The automatic choice is seen, and is the head.
    assert_framed(browser);
    let head = window(browser);
    let is_automatic = "document.querySelector('#photograph .note').textContent.includes('automatic')";
    assert!(head[2] < 400.0 && browser.value(is_automatic) == true, "{head:?}");
    // A press with a hand that is not quite still moves nothing.
    let middle = browser.place(".photograph .frame");
    browser.drag(size.0 < 600, middle, [middle[0] + 2.0, middle[1] + 1.0]);
    assert_eq!(browser.value(is_automatic), true);
    browser.keep(&format!("20 photograph {}", size.0));

    // A corner is dragged: only its two sides move, by the pointer's way, and what is drawn has the frame's shape.
    let picture_px = browser
        .value("document.querySelector('.photograph').clientWidth")
        .as_f64()
        .unwrap();
    let px = 512.0 / picture_px;
    let from = browser.place(".grip[data-x='1'][data-y='1']");
    let by = [-40.0, -70.0];
    browser.drag(size.0 < 600, from, [from[0] + by[0], from[1] + by[1]]);
    until_drawn(browser, &format!("{STUDIO}.wishes.crop.split(',').length === 4"));
    let dragged = window(browser);
    let wanted = [head[0], head[1], head[2] + by[0] * px, head[3] + by[1] * px];
    assert!(is_near(dragged, wanted, 3.0), "{dragged:?}, not {wanted:?}");
    assert_framed(browser);
    // The longer side of the part is 60 mm; light pixels at its edges get no ink.
    let longer = dragged[2].max(dragged[3]);
    let (ink, room) = (ink_mm(browser), [dragged[2], dragged[3]].map(|px| 60.0 * px / longer));
    println!("{} px: frame {dragged:?}, ink {ink:.1?} mm in {room:.1?} mm", size.0);
    for (ink, room) in ink.iter().zip(room) {
        assert!((0.6 * room..=room + 0.5).contains(ink), "{ink} mm of {room} mm");
    }

    // The frame is moved, and stays in the picture however far.
    let middle = browser.place(".photograph .frame");
    browser.drag(size.0 < 600, middle, [middle[0] + 20.0, middle[1] + 900.0]);
    until_drawn(
        browser,
        &format!("{STUDIO}.photograph.window_px[1] > {}", dragged[1] + 5.0),
    );
    let moved = window(browser);
    let wanted = [dragged[0] + 20.0 * px, 512.0 - dragged[3], dragged[2], dragged[3]];
    assert!(is_near(moved, wanted, 3.0), "{moved:?}, not {wanted:?}");

    // Keys move it and change its size; the robot is not jogged.
    browser.value("{ document.querySelector('.photograph .frame').focus(); document.getElementById('jog-keys').click(); document.querySelector('.photograph .frame').focus(); globalThis.jogs = 0; const { send } = etherpen.link; etherpen.link.send = function (request) { if (request.type === 'jog') globalThis.jogs += 1; return send.call(this, request); }; }");
    for _ in 0..3 {
        browser.key("ArrowLeft", 37);
    }
    browser.key("ArrowUp", 38);
    until_drawn(
        browser,
        &format!("{STUDIO}.photograph.window_px[1] < {}", moved[1] - 2.0),
    );
    let keyed = window(browser);
    let step = 5.0;
    assert!(
        is_near(keyed, [moved[0] - 3.0 * step, moved[1] - step, moved[2], moved[3]], 1.0),
        "{keyed:?} after {moved:?}"
    );
    browser.shift_key("ArrowLeft", 37);
    until_drawn(
        browser,
        &format!("{STUDIO}.photograph.window_px[2] < {}", keyed[2] - 2.0),
    );
    assert!(is_near(
        window(browser),
        [keyed[0], keyed[1], keyed[2] - step, keyed[3]],
        1.0
    ));
    assert_framed(browser);
    assert_eq!(browser.value("jogs"), 0);
    // Beside the frame the same key jogs.
    browser.value("{ document.activeElement.blur(); }");
    browser.key("ArrowLeft", 37);
    browser.until("jogs > 0");
    browser.value("{ document.getElementById('jog-keys').click(); }");

    // The list: everything, then the person's own numbers.
    pick(browser, "Part", "none");
    until_drawn(browser, &format!("{STUDIO}.wishes.crop === 'none'"));
    assert!(is_near(
        shares(browser, ".photograph .frame"),
        [0.0, 0.0, 1.0, 1.0],
        0.001
    ));
    pick(browser, "Part", "own");
    browser.value("{ const field = document.querySelector('#options .field input:not([hidden])'); field.value = '100,20,200,300'; field.dispatchEvent(new Event('change')); }");
    until_drawn(browser, &format!("{STUDIO}.wishes.crop === '100,20,200,300'"));
    assert_eq!(window(browser), [100.0, 20.0, 200.0, 300.0]);
    assert_framed(browser);

    // The circle of the face is dragged.
    pick(browser, "Face", "own");
    until_drawn(browser, &format!("{STUDIO}.wishes.focus"));
    let face = browser
        .value(&format!("{STUDIO}.photograph.face_px[0]"))
        .as_f64()
        .unwrap();
    let from = browser.place(".grip.middle");
    browser.drag(size.0 < 600, from, [from[0] - 25.0, from[1]]);
    until_drawn(browser, &format!("{STUDIO}.photograph.face_px[0] < {}", face - 5.0));
    let now = browser
        .value(&format!("{STUDIO}.photograph.face_px[0]"))
        .as_f64()
        .unwrap();
    assert!((face - now - 25.0 * px).abs() < 3.0, "{face} to {now}");
    browser.keep(&format!("21 frame {}", size.0));
    let over = browser.value("document.documentElement.scrollWidth - document.documentElement.clientWidth");
    assert_eq!(over, 0, "the page is wider than {} px", size.0);

    // A frame belongs to its photograph: the next file is drawn with the automatic choice.
    drop_file(browser, "disc.png", &disc());
    assert_eq!(
        browser.value(&format!("{STUDIO}.wishes.crop + {STUDIO}.wishes.focus")),
        ""
    );
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}

#[test]
fn the_frame_follows_the_mouse_and_the_keys() {
    frame_by_hand(DESKTOP);
}

#[test]
fn the_frame_follows_a_finger_on_a_phone() {
    frame_by_hand(PHONE);
}

#[test]
fn a_press_on_a_variant_makes_it_the_drawing() {
    let Some(mut browser) = Browser::start() else { return };
    let browser = &mut browser;
    for (width, height) in [DESKTOP, (400, 800)] {
        let rig = Rig::start();
        begin(browser, &rig);
        browser.window(width, height);
        browser.until(&format!("innerWidth === {width}"));
        browser.value("{ setInterval(() => { const { link } = etherpen; if (link.state.control?.holder === null) link.send({ type: 'take' }); }, 300); const [size, time] = document.querySelectorAll('#options label input'); size.value = '60mm'; time.value = '15s'; }");
        drop_file(browser, "portrait.png", &small_photograph());
        assert_eq!(browser.value("document.getElementById('strip').hidden"), true);
        browser.press("#vary");
        browser.until("document.querySelectorAll('#variants .empty').length > 0 && document.getElementById('strip-text').textContent.includes(' of ')");
        browser.until("etherpen.link.state.variants.state === 'ready'");
        let loaded = "document.querySelectorAll('#variants img').length === etherpen.link.state.variants.items.length \
                      && [...document.querySelectorAll('#variants img')].every((it) => it.naturalWidth >= 200)";
        browser.until(loaded);
        let pressed = "[...document.querySelectorAll('#variants button')].map((it) => it.ariaPressed).join()";
        let first = browser.value(pressed);
        assert!(first.as_str().unwrap().starts_with("true,false,false"), "{first}");
        browser.keep(&format!("22 variants {width}"));

        browser.click("#variants button:nth-child(3)");
        browser.until(&format!("{pressed}.startsWith('false,false,true,false')"));
        browser.until(&format!("{STUDIO}.state === 'ready' && {STUDIO}.explicit.style === etherpen.link.state.variants.items[2].wishes.style"));
        assert_eq!(browser.value("document.querySelector('#options choice-list').value === etherpen.link.state.variants.items[2].wishes.style"), true);
        browser.keep(&format!("23 variant {width}"));
        let strokes = browser.value("etherpen.link.state.variants.items[2].strokes");
        let over = browser.value("document.documentElement.scrollWidth - document.documentElement.clientWidth");
        assert_eq!(over, 0, "the page is wider than {width} px");
        browser.press("#enqueue");
        browser.until("etherpen.link.state.jobs.waiting.length === 1");
        assert_eq!(browser.value("etherpen.link.state.jobs.waiting[0].strokes"), strokes);
        browser.until("document.getElementById('strip').hidden && document.getElementById('photograph').hidden");
    }
    assert!(browser.errors.is_empty(), "{:?}", browser.errors);
}
