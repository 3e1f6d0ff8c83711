//! The page's touches of a sheet that does not lie level.

use super::browser::Browser;
use super::client::Rig;
use super::page::{begin, enable, mode};
use etherpen::config::Config;
use host_tools::cell::{CellOptions, Physics, SheetPlace};
use serde_json::json;
use std::fs;

/// Half a degree, and the height of the sheet's centre.
const SHEET: SheetPlace = SheetPlace {
    z_mm: -849.5,
    slope_x: 0.0071,
    slope_y: -0.0051,
};
/// Height above its drawing height at which the pen's spring first touches, mm.
const SPRING_MM: f64 = 0.3;

#[test]
fn an_operator_jogs_down_presses_touch_at_three_places_and_stores_the_tilt() {
    let Some(mut browser) = Browser::start() else { return };
    let file = std::env::temp_dir().join(format!("pensheet-{}.toml", std::process::id()));
    fs::write(&file, "[paper]\npen_down_z_mm = -850.0  # the table\n").expect("a file");
    let rig = Rig::in_cell(CellOptions {
        physics: Physics {
            sheet: Some(SHEET),
            ..Physics::NOMINAL
        },
        ..CellOptions::default()
    });
    rig.console().store_sheet_in(Ok(file.clone()));
    let browser = &mut browser;
    begin(browser, &rig);
    enable(browser);
    browser.until("document.getElementById('sheet-text').textContent.startsWith('configured: tilt 0.00°')");
    assert_eq!(browser.value("document.getElementById('touch-store').disabled"), true);
    // Closed, it leaves its room to the position.
    assert_eq!(browser.value("document.getElementById('touch').checkVisibility()"), false);
    browser.click("#sheet summary");
    browser.until("document.getElementById('touch').checkVisibility()");
    browser.value("document.getElementById('jog-speed').value = '5', 0");
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
        browser.mouse(false, down);
        mode(browser, "Idle");
        browser.press("#touch");
        browser.until(&format!("etherpen.link.state.sheet.touches === {number}"));
        let up = json!({"do": "move", "position_mm": [x, y, -810.0]});
        browser.value(&format!("etherpen.link.command({up}), 0"));
        browser.until("etherpen.link.state.pose.measured_mm[2] > -810.5");
        mode(browser, "Idle");
    }
    browser.until("document.getElementById('sheet-summary').textContent === '3 touches'");
    browser.until("/3 touches: tilt 0\\.[0-9]+°/.test(document.getElementById('sheet-text').textContent)");
    browser.place("#sheet-text");
    browser.keep("sheet");
    browser.press("#touch-undo");
    browser.until("etherpen.link.state.sheet.touches === 2");
    assert_eq!(browser.value("document.getElementById('touch-store').disabled"), true);
    // The pen is where the last touch was, far above it: too steep a sheet.
    browser.press("#touch");
    browser.until("document.getElementById('sheet-text').textContent.includes('degrees')");
    browser.press("#touch-undo");
    let touch = json!([
        70.0,
        80.0,
        SHEET.z_mm + SHEET.slope_x * 70.0 + SHEET.slope_y * 80.0 + SPRING_MM
    ]);
    let action = json!({"do": "move", "position_mm": touch});
    browser.value(&format!("etherpen.link.command({action}), 0"));
    browser.until(&format!(
        "Math.abs(etherpen.link.state.pose.measured_mm[2] - {touch}[2]) < 0.02"
    ));
    mode(browser, "Idle");
    browser.press("#touch");
    browser.until("etherpen.link.state.sheet.is_found");
    browser.press("#touch-store");
    browser.until("etherpen.link.state.sheet.touches === 0");
    browser.until("document.getElementById('log').innerText.includes('is stored in')");
    let text = fs::read_to_string(&file).expect("the file");
    let stored = host_tools::settings::load(Some(&file)).expect("a configuration").paper;
    fs::remove_file(&file).expect("it was there");
    assert!(text.contains("# the table") && text.contains("slope = ["), "{text}");
    let off = [stored.slope[0] - SHEET.slope_x, stored.slope[1] - SHEET.slope_y];
    let high_mm = stored.pen_down_z_mm - SHEET.z_mm;
    println!("stored {:?}, {high_mm:.3} mm beside the sheet", stored.slope);
    // After the touch a jog of 5 mm/s goes on for some hundredths of a second.
    assert!(
        off.iter().all(|off| off.abs() < 0.004) && (-0.5..0.05).contains(&high_mm),
        "{text}"
    );
    assert_eq!(stored.size_mm, Config::default().paper.size_mm);
}
