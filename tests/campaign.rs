//! Every episode in which a campaign has ever found a failure, kept as a test case: it must find nothing any more.
//!
//! `etherpen campaign --seeds A..B --cases tests/campaign` writes such files; the name of a file says what it found.

use host_tools::campaign::{self, episode::Episode};
use std::path::{Path, PathBuf};

fn cases() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/campaign");
    let entries = std::fs::read_dir(&folder).expect("the folder of the test cases");
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "toml"));
    files.sort();
    files
}

#[test]
fn what_was_ever_found_is_not_found_again() {
    let cases = cases();
    assert!(!cases.is_empty(), "no test cases");
    let mut failed = Vec::new();
    for file in &cases {
        let episode = Episode::read(file).unwrap_or_else(|error| panic!("{}", error.message));
        assert!(
            !episode.found.is_empty(),
            "{}: what it found is missing",
            file.display()
        );
        if let Some(failure) = campaign::run(&episode).failure {
            failed.push(format!("{}: {failure}", file.display()));
        }
    }
    println!("{} test cases", cases.len());
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn every_test_case_stands_in_the_documentation() {
    let documented = include_str!("../docs/campaign.md");
    let name = |file: &PathBuf| file.file_name().and_then(|name| name.to_str()).map(str::to_owned);
    let missing: Vec<String> = cases()
        .iter()
        .filter_map(name)
        .filter(|name| !documented.contains(&format!("`{name}`")))
        .collect();
    assert!(missing.is_empty(), "docs/campaign.md does not list {missing:?}");
}
