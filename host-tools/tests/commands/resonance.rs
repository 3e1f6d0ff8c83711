//! Input shapers, judged by the ink of a pen that swings against the machine.

use crate::program::{Folder, etherpen, run};
use etherpen::config::Config;
use host_tools::settings::machines::MACHINES;
use serde_json::Value;
use std::fs;

/// Corners of several angles, and lifts between them.
const CORNERS: &str = r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100" fill="none" stroke="black">
<path d="M10 10H60V60H10Z M70 10L90 50L74 12L92 30 M20 70H24V74H28V70H40L22 90L60 88"/><circle cx="78" cy="75" r="12"/></svg>"#;
/// Distance of the ink from its line that the machine itself adds to the tolerance, mm.
const FOLLOWED_MM: f64 = 0.03;

/// The report of the drawing on a machine whose pen swings with this frequency.
fn drawn(machine: &str, motion: &str, hz: f64) -> Value {
    let folder = Folder::new();
    folder.file("corners.svg", CORNERS);
    folder.file(
        "robot.toml",
        machine.replacen("[motion]\n", &format!("[motion]\n{motion}"), 1),
    );
    folder.file(
        "cell.toml",
        format!("[structural_mode]\nxy_hz = {hz:.1}\nz_hz = 0.0\ndamping = 0.03\n"),
    );
    let words = "simulate corners.svg --config robot.toml --cell cell.toml --out out";
    let (status, _, stderr) = run(etherpen(&folder).args(words.split(' ')));
    assert!(folder.join("out/report.json").exists(), "{status:?}: {stderr}");
    let report = fs::read_to_string(folder.join("out/report.json")).expect("a report");
    serde_json::from_str(&report).expect("JSON")
}

/// Acceleration of the tool in a configuration file, mm/s2.
fn acceleration_of(machine: &str) -> f64 {
    let (_, rest) = machine.split_once("\nacceleration_mm_s2 = ").expect("an acceleration");
    rest.lines()
        .next()
        .and_then(|number| number.parse().ok())
        .expect("a number")
}

fn ink_mm(report: &Value) -> f64 {
    assert_eq!(report["ink_missing_mm"], 0.0, "{report}");
    report["ink_deviation_max_mm"].as_f64().expect("a number")
}

#[test]
fn a_pen_that_swings_draws_within_the_tolerance_with_an_input_shaper_and_not_without() {
    for machine in &MACHINES[..3] {
        // No machine has a tolerance of its own.
        let tolerance_mm = Config::default().motion.tolerance_mm;
        assert!(!machine.text.contains("\ntolerance_mm"), "{}", machine.name);
        for (shaper, gentle, most) in [("zv", 1.0, 0.3), ("zvd", 0.2, 0.6)] {
            let usual = acceleration_of(machine.text);
            let acceleration = gentle * usual;
            // Just above the lowest that the tolerance allows.
            let hz = (46.0 * (usual / 10_000.0).sqrt()).round();
            let text = machine.text.replacen("\nacceleration_mm_s2 = ", "\n# ", 1);
            let limits = format!("acceleration_mm_s2 = {acceleration:.1}\n");
            let unshaped = drawn(&text, &limits, hz)["ink_deviation_max_mm"]
                .as_f64()
                .expect("a number");
            let motion = format!("{limits}input_shaper = \"{shaper}\"\nresonance_hz = {hz:.1}\n");
            let off_mm = ink_mm(&drawn(&text, &motion, hz));
            println!("{}, {shaper}: {off_mm:.3} mm, {unshaped:.3} mm without", machine.name);
            assert!(
                off_mm < tolerance_mm + FOLLOWED_MM,
                "{}, {shaper}: {off_mm} mm",
                machine.name
            );
            assert!(
                off_mm < most * unshaped,
                "{}, {shaper}: {off_mm} of {unshaped} mm",
                machine.name
            );
        }
    }
}
