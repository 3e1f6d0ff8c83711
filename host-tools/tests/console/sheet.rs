//! The page's touches of a sheet that does not lie level.

use super::browser::Browser;
use super::client::{Client, Rig};
use super::page::{begin, enable, mode};
use etherpen::config::Config;
use host_tools::cell::{CellOptions, Physics, SheetPlace};
use host_tools::console::messages::Injection;
use host_tools::touches::{Touch, fit};
use serde_json::{Value, json};
use std::fs;
use std::path::PathBuf;

/// Half a degree, and the height of the sheet's centre.
const SHEET: SheetPlace = SheetPlace {
    z_mm: -849.5,
    slope_x: 0.0071,
    slope_y: -0.0051,
};
/// Height above its drawing height at which the pen's spring first touches, mm.
const SPRING_MM: f64 = 0.3;

fn tilted() -> Rig {
    Rig::in_cell(CellOptions {
        physics: Physics {
            sheet: Some(SHEET),
            ..Physics::NOMINAL
        },
        ..CellOptions::default()
    })
}

/// A configuration file of this test, removed when dropped.
struct File(PathBuf);

impl File {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("pensheet-{name}-{}.toml", std::process::id()));
        fs::write(&path, "[paper]\npen_down_z_mm = -850.0  # the table\n").expect("a file");
        Self(path)
    }

    fn text(&self) -> String {
        fs::read_to_string(&self.0).expect("the file")
    }
}

impl Drop for File {
    fn drop(&mut self) {
        // What cannot be removed is in the system's folder for temporary files.
        let _ = fs::remove_file(&self.0);
    }
}

fn position(place: &Value) -> Touch {
    [0, 1, 2].map(|axis| place[axis].as_f64().expect("a number"))
}

/// Waits until the pen stands still and presses Touch; returns where it is.
fn press_touch(browser: &mut Browser, number: usize) -> Touch {
    browser.until(
        "(() => { const now = etherpen.link.state.pose.measured_mm; const then = globalThis.poseThen ?? [0, 0, 0]; \
         globalThis.poseThen = [...now]; return Math.hypot(...now.map((at, axis) => at - then[axis])) < 0.005; })()",
    );
    let place = position(&browser.value("etherpen.link.state.pose.measured_mm"));
    browser.press("#touch");
    browser.until(&format!("etherpen.link.state.sheet.touches === {number}"));
    place
}

#[test]
fn an_operator_jogs_down_presses_touch_at_three_places_and_stores_the_tilt() {
    let Some(mut browser) = Browser::start() else { return };
    let file = File::new("browser");
    let rig = tilted();
    rig.console().store_sheet_in(Ok(file.0.clone()));
    let browser = &mut browser;
    begin(browser, &rig);
    enable(browser);
    browser.until("document.getElementById('sheet-text').textContent.startsWith('configured: tilt 0.00°')");
    assert_eq!(browser.value("document.getElementById('touch-store').disabled"), true);
    // Closed, it leaves its room to the position.
    assert_eq!(
        browser.value("document.getElementById('touch').checkVisibility()"),
        false
    );
    browser.click("#sheet summary");
    browser.until("document.getElementById('touch').checkVisibility()");
    browser.value("document.getElementById('jog-speed').value = '5', 0");
    let mut touches = Vec::new();
    for (number, [x, y]) in (1..).zip([[-80.0, -80.0], [80.0, -80.0], [70.0, 80.0]]) {
        let surface_mm = SHEET.z_mm + SHEET.slope_x * x + SHEET.slope_y * y;
        for z in [-840.0, surface_mm + SPRING_MM + 1.0] {
            let action = json!({"do": "move", "position_mm": [x, y, z]});
            browser.value(&format!("etherpen.link.command({action}), 0"));
            browser.until(&format!(
                "Math.hypot(...etherpen.link.state.pose.measured_mm.map((at, axis) => at - {}[axis])) < 0.02",
                json!([x, y, z])
            ));
            mode(browser, "Idle");
        }
        let down = browser.place("[data-jog='0,0,-1']");
        browser.mouse(true, down);
        rig.until("the pen to touch", |_| rig.cell.state().pen_touches);
        // It still moves.
        browser.until("document.getElementById('touch').disabled");
        browser.mouse(false, down);
        mode(browser, "Idle");
        touches.push(press_touch(browser, number));
        let up = json!({"do": "move", "position_mm": [x, y, -810.0]});
        browser.value(&format!("etherpen.link.command({up}), 0"));
        browser.until("etherpen.link.state.pose.measured_mm[2] > -810.5");
        mode(browser, "Idle");
    }
    browser.until("document.getElementById('sheet-summary').textContent === '3 touches'");
    browser.until("/3 touches: tilt [0-9.]+°.*touch [123] is 0.00 mm off/.test(document.getElementById('sheet-text').textContent)");
    browser.place("#sheet-text");
    browser.keep("sheet");
    // The pen is where the last touch was, far above it: that touch is replaced, and the sheet is too steep.
    press_touch(browser, 3);
    browser.until("document.getElementById('sheet-text').textContent.includes('degrees')");
    assert_eq!(browser.value("document.getElementById('touch-store').disabled"), true);
    browser.press("#touch-undo");
    browser.until("etherpen.link.state.sheet.touches === 2");
    let [x, y, z] = touches[2];
    let action = json!({"do": "move", "position_mm": [x, y, z]});
    browser.value(&format!("etherpen.link.command({action}), 0"));
    browser.until(&format!(
        "Math.abs(etherpen.link.state.pose.measured_mm[2] - {z}) < 0.02"
    ));
    mode(browser, "Idle");
    touches[2] = press_touch(browser, 3);
    browser.until("etherpen.link.state.sheet.is_found");
    browser.press("#touch-store");
    browser.until("etherpen.link.state.sheet.touches === 0");
    browser.until("document.getElementById('log').innerText.includes('is stored in')");
    browser.until("document.getElementById('sheet-text').textContent.startsWith('stored; holds after a restart')");
    let text = file.text();
    let stored = host_tools::settings::load(Some(&file.0))
        .expect("a configuration")
        .paper;
    assert!(text.contains("# the table") && text.contains("slope = ["), "{text}");
    // The stored plane is the one through the places that the page showed when Touch was pressed.
    let plane = fit(&touches).expect("a plane").plane;
    println!("touched {touches:?}, stored {:?}", stored.slope);
    for (stored, touched) in stored.slope.iter().zip(plane.slope) {
        assert!((stored - touched).abs() < 1.0e-4, "{text}");
    }
    assert!(
        (stored.pen_down_z_mm - plane.z_at_mm(0.0, 0.0) + SPRING_MM).abs() < 0.01,
        "{text}"
    );
    assert_eq!(stored.size_mm, Config::default().paper.size_mm);
    // Lifted by 3 mm at the high end of this sheet is drawing height at the middle of a level one.
    let lowered = |tool: [f64; 3]| {
        let paper = json!({"centre_mm": [10, 0], "slope": [0.03, 0.0], "pen_down_z_mm": -850, "pen_lift_mm": 3});
        format!(
            "import('/paper.js').then(({{ isLowered }}) => isLowered({paper}, {}))",
            json!(tool)
        )
    };
    for (tool, is_lowered) in [
        ([110.0, 0.0, -847.0], true),
        ([110.0, 0.0, -844.0], false),
        ([-90.0, 0.0, -850.0], false),
        ([-90.0, 0.0, -853.0], true),
    ] {
        assert_eq!(browser.value(&lowered(tool)), json!(is_lowered), "{tool:?}");
    }
}

fn touches(viewer: &mut Client, number: usize) -> Value {
    viewer.state("sheet", |sheet| sheet["touches"] == number)
}

/// Moves the pen and presses Touch until it is taken.
fn touch_at(viewer: &mut Client, place: Touch, number: usize) {
    viewer.command(json!({"do": "move", "position_mm": place}));
    viewer.until("pose", |pose| {
        let at = position(&pose["measured_mm"]);
        at.iter().zip(place).all(|(at, wanted)| (at - wanted).abs() < 0.02)
    });
    viewer.mode("Idle");
    let begun = std::time::Instant::now();
    while viewer.sections["sheet"]["touches"] != number {
        assert!(
            begun.elapsed() < super::client::PATIENCE,
            "{:?}",
            viewer.sections.get("refused")
        );
        viewer.send(&json!({"type": "touch", "action": "add"}));
        viewer.listen(std::time::Duration::from_millis(200));
    }
}

#[test]
fn touches_end_with_the_reference_in_which_they_were_taken() {
    let rig = tilted();
    let mut viewer = rig.viewer("operator");
    let viewer = &mut viewer;
    viewer.send(&json!({"type": "take"}));
    viewer.mode("DrivesOff");
    viewer.send(&json!({"type": "touch", "action": "add"}));
    viewer.until("refused", |why| {
        why.as_str().is_some_and(|why| why.contains("not homed"))
    });
    viewer.enable();
    touch_at(viewer, [-80.0, -80.0, -845.0], 1);
    touch_at(viewer, [80.0, -80.0, -845.0], 2);
    rig.cell().inject(Injection::Restart).expect("it is simulated");
    touches(viewer, 0);
    viewer.until_told("the touches of the sheet are forgotten");
    viewer.mode("DrivesOff");
    viewer.command(json!({"do": "reference"}));
    viewer.state("status", |status| status["referenced"] == true);
    assert_eq!(viewer.sections["sheet"]["touches"], 0);
}

#[test]
fn a_touch_is_taken_at_rest_and_a_wrong_one_or_another_file_is_not_stored() {
    let file = File::new("refusals");
    let rig = tilted();
    rig.console().store_sheet_in(Ok(file.0.clone()));
    let mut viewer = rig.viewer("operator");
    let viewer = &mut viewer;
    viewer.enable();
    viewer.command(json!({"do": "override", "percent": 10}));
    viewer.state("status", |status| status["override_percent"] == 10);
    viewer.command(json!({"do": "move", "position_mm": [-80.0, -80.0, -845.0]}));
    viewer.mode("Moving");
    viewer.send(&json!({"type": "touch", "action": "add"}));
    viewer.until("refused", |why| {
        why.as_str().is_some_and(|why| why.contains("stand still"))
    });
    viewer.command(json!({"do": "override", "percent": 100}));
    let corners = [[-80.0, -80.0], [80.0, -80.0], [80.0, 80.0], [-80.0, 80.0]];
    for (number, [x, y]) in (1..).zip(corners) {
        touch_at(viewer, [x, y, -845.0], number);
    }
    touch_at(viewer, [0.0, 0.0, -843.0], 5);
    let sheet = touches(viewer, 5);
    assert_eq!(sheet["is_found"], false, "{sheet}");
    assert!(
        sheet["text"].as_str().is_some_and(|text| text.contains("touch 5 at x")),
        "{sheet}"
    );
    let store = json!({"type": "touch", "action": "store"});
    viewer.send(&store);
    viewer.until("refused", |why| {
        why.as_str().is_some_and(|why| why.contains("touch 5 at x"))
    });
    // Touched there again, it is the last of five.
    viewer.command(json!({"do": "move", "position_mm": [5.0, 0.0, -845.0]}));
    viewer.until("pose", |pose| position(&pose["measured_mm"])[2] < -844.98);
    viewer.mode("Idle");
    let begun = std::time::Instant::now();
    while viewer.sections["sheet"]["is_found"] != true {
        assert!(
            begun.elapsed() < super::client::PATIENCE,
            "{:?}",
            viewer.sections["sheet"]
        );
        viewer.send(&json!({"type": "touch", "action": "add"}));
        viewer.listen(std::time::Duration::from_millis(200));
    }
    assert_eq!(viewer.sections["sheet"]["touches"], 5);
    let other = "[paper]\ncentre_mm = [10.0, 0.0]\n";
    fs::write(&file.0, other).expect("the file");
    viewer.send(&store);
    viewer.until("refused", |why| {
        why.as_str()
            .is_some_and(|why| why.contains("has changed since the console was started"))
    });
    assert_eq!(file.text(), other);
    fs::write(&file.0, "[paper]\npen_down_z_mm = -850.0\n").expect("the file");
    viewer.send(&store);
    let sheet = touches(viewer, 0);
    assert!(
        sheet["text"]
            .as_str()
            .is_some_and(|text| text.starts_with("stored; holds after a restart")),
        "{sheet}"
    );
    let stored = host_tools::settings::load(Some(&file.0))
        .expect("a configuration")
        .paper;
    assert!(
        (stored.pen_down_z_mm + 845.0 + SPRING_MM).abs() < 0.05,
        "{}",
        file.text()
    );
}
