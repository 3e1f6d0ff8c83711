//! A robot that has lost its reference is not assumed to be at its marks: nothing is drawn until a person gives the
//! joints' position. The cell's motors are the reference.

use crate::program::{Folder, etherpen, run, strokes};
use etherpen::config::Config;
use host_tools::cell::CellOptions;
use host_tools::console::virtual_cell::{CellView, Firmware, VirtualCell};
use host_tools::error::code;
use std::path::Path;

/// Largest turn of a joint that counts as no motion, rad.
const STILL_RAD: f64 = 1.0e-4;

fn joints(view: &CellView) -> [f64; 4] {
    view.state().joints.0
}

/// Runs a command that must be refused without a reference, and checks that no joint moves.
fn assert_refused(folder: &Folder, cell: &VirtualCell, words: &[&str]) {
    let before = joints(&cell.view());
    let (status, _, stderr) = tell(folder, cell, words);
    assert_eq!(status, Some(i32::from(code::FAILED)), "{words:?}: {stderr}");
    assert!(stderr.contains("etherpen reference"), "{words:?}: {stderr}");
    let after = joints(&cell.view());
    let turned = before.iter().zip(after).map(|(before, after)| (before - after).abs());
    assert!(
        turned.fold(0.0, f64::max) < STILL_RAD,
        "{words:?} moved: {before:?} {after:?}"
    );
}

fn tell(folder: &Folder, cell: &VirtualCell, words: &[&str]) -> (Option<i32>, String, String) {
    run(etherpen(folder)
        .args(words)
        .env("ETHERPEN_PORT", cell.port().to_string()))
}

fn toml(folder: &Folder, config: &Config) -> String {
    let text = toml::to_string(config).expect("a configuration");
    folder.file("other.toml", text).to_string_lossy().into_owned()
}

#[test]
fn a_reference_that_another_configuration_has_cost_is_not_guessed() {
    let folder = Folder::new();
    let file = strokes();
    let file = Path::to_str(&file).expect("UTF-8");
    let cell = VirtualCell::start(&Config::default(), CellOptions::default(), Firmware::Simulated);
    let cell = cell.expect("the cell starts");
    let (status, _, stderr) = tell(&folder, &cell, &["draw", file]);
    assert_eq!(status, Some(0), "{stderr}");
    let drawn = cell.ink().len();
    let mut config = Config::default();
    config.motion.speed_mm_s *= 0.9;
    let other = toml(&folder, &config);
    for words in [
        &["draw", file, "--config", &other][..],
        &["enable", "--config", &other],
        &["move", "0,0,-800", "--config", &other],
        &["draw", file],
    ] {
        assert_refused(&folder, &cell, words);
    }
    assert_eq!(cell.ink().len(), drawn, "ink without a reference");
    // A person measures the position of the platform.
    let platform = cell.view().state().platform.expect("the robot holds a platform");
    let position = format!("{:.0},{:.0},{:.0}", platform.x_mm, platform.y_mm, platform.z_mm);
    let (status, _, stderr) = tell(&folder, &cell, &["reference", "--position", &position]);
    assert_eq!(status, Some(0), "{stderr}");
    let (status, _, stderr) = tell(&folder, &cell, &["draw", file]);
    assert_eq!(status, Some(0), "{stderr}");
    assert_eq!(cell.ink().len(), 2 * drawn);
}
