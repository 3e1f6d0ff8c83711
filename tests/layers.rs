//! The modules of the library and of the crates below it keep the layers that their headers list.

use host_tools::layers::check;
use std::path::Path;

fn findings(folder: &str, table: &str) -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let findings = check(&folder, table).expect("the sources");
    findings.iter().map(ToString::to_string).collect()
}

/// Folders of sources, and the texts with their layers.
const CRATES: [(&str, &str); 8] = [
    ("src", include_str!("../src/lib.rs")),
    ("crates/certify/src", include_str!("../crates/certify/src/lib.rs")),
    ("crates/drives/src", include_str!("../crates/drives/src/lib.rs")),
    ("crates/ethercat/src", include_str!("../crates/ethercat/src/lib.rs")),
    ("crates/link/src", include_str!("../crates/link/src/lib.rs")),
    ("crates/monitor/src", include_str!("../crates/monitor/src/lib.rs")),
    ("crates/motion/src", include_str!("../crates/motion/src/lib.rs")),
    ("crates/mutants/src", include_str!("../crates/mutants/src/lib.rs")),
];

#[test]
fn the_library_and_the_crates_below_it_keep_their_layers() {
    for (folder, table) in CRATES {
        let shown = findings(folder, table).join("\n");
        assert_eq!(shown, "", "{folder}");
    }
}

#[test]
fn imports_that_point_up_are_found_in_every_crate() {
    for (folder, table) in CRATES {
        let (_, list) = table.split_once("//! # Layers").expect("the heading");
        let (list, _) = list.split_once("//! #").or(list.split_once("#![")).expect("an end");
        let numbered = |line: &&str| {
            line.split_once(". ")
                .is_some_and(|(number, _)| number.parse::<u8>().is_ok())
        };
        let layers: Vec<&str> = list
            .lines()
            .map(|line| line.trim_start_matches("//! "))
            .filter(numbered)
            .collect();
        let turned = layers.iter().rev().enumerate().map(|(place, layer)| {
            let (_, content) = layer.split_once(". ").expect("a numbered layer");
            format!("//! {}. {content}", place + 1)
        });
        let turned = format!("//! # Layers\n//!\n{}\n", turned.collect::<Vec<_>>().join("\n"));
        let shown = findings(folder, &turned);
        let upward = shown.iter().filter(|finding| finding.contains(" imports ")).count();
        assert!(upward >= layers.len() / 2, "{folder}: {shown:?}");
    }
}
