//! The modules of the library keep the layers that its header lists.

use host_tools::layers::check;
use std::path::Path;

fn findings(folder: &str, table: &str) -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let findings = check(&folder, table).expect("the sources");
    findings.iter().map(ToString::to_string).collect()
}

#[test]
fn the_library_keeps_its_layers() {
    let none: [String; 0] = [];
    let shown = findings("src", include_str!("../src/lib.rs"));
    assert_eq!(shown, none, "{}", shown.join("\n"));
}

#[test]
fn an_import_that_points_up_is_found() {
    let turned = include_str!("../src/lib.rs").replace("//! 2. `config`:", "//! 2. `link_task`:");
    let turned = turned.replace("//! 13. `link_task`:", "//! 13. `config`:");
    let shown = findings("src", &turned);
    assert!(
        shown.iter().any(|finding| finding.contains("imports config")),
        "{}",
        shown.join("\n")
    );
}
