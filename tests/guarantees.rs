//! The tests and files that the documents on guarantees and security name exist.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const GUARANTEES: &str = "docs/guarantees.md";
const DOCUMENTS: [&str; 2] = [GUARANTEES, "SECURITY.md"];
/// Rows of every table.
const ROWS: [&str; 5] = ["argument", "tests", "figure", "not covered", "only hardware shows"];
/// Folders whose files a document names by their path.
const FOLDERS: [&str; 8] = [
    "src/",
    "crates/",
    "host-tools/",
    "tests/",
    "docs/",
    "fuzz/",
    "samples/",
    "benchmarks/",
];

fn root(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn read(file: &str) -> String {
    std::fs::read_to_string(root(file)).unwrap_or_else(|error| panic!("{file}: {error}"))
}

/// The texts in backticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// Whether the code has a test of this name.
fn has_test(code: &str, name: &str) -> bool {
    let lines: Vec<&str> = code.lines().map(str::trim).collect();
    let function = format!("fn {name}(");
    lines.iter().enumerate().any(|(number, line)| {
        // Further attributes may stand between.
        let before = lines[..number].iter().rev().take_while(|line| line.starts_with("#["));
        let line = line.strip_prefix("pub(crate) ").unwrap_or(line);
        line.starts_with(&function) && before.into_iter().any(|line| *line == "#[test]")
    })
}

/// Sections of the document: title, and rows by their first column.
fn sections(text: &str) -> BTreeMap<&str, Vec<(&str, &str)>> {
    let sections = text.split("\n## ").skip(1).map(|section| {
        let (title, body) = section.split_once('\n').expect("a title");
        let rows = body.lines().filter_map(|line| {
            let (label, content) = line.strip_prefix("| ")?.strip_suffix(" |")?.split_once(" | ")?;
            ROWS.contains(&label).then_some((label, content))
        });
        (title, rows.collect())
    });
    sections.collect()
}

#[test]
fn every_guarantee_names_argument_tests_figure_and_what_it_does_not_cover() {
    let text = read(GUARANTEES);
    let sections = sections(&text);
    assert!(sections.len() >= 15, "{} guarantees", sections.len());
    for (title, rows) in sections {
        let labels: Vec<&str> = rows.iter().map(|(label, _)| *label).collect();
        assert_eq!(labels, ROWS, "{title}");
    }
}

#[test]
fn every_test_that_a_guarantee_names_exists() {
    let text = read(GUARANTEES);
    let mut missing = Vec::new();
    for (title, rows) in sections(&text) {
        let named = rows.iter().find(|(label, _)| *label == "tests").expect("tests").1;
        let (mut file, mut code, mut count) = ("", String::new(), 0);
        for word in quoted(named) {
            if word.ends_with(".rs") {
                (file, code) = (word, read(word));
            } else {
                count += 1;
                if !has_test(&code, word) {
                    missing.push(format!("{title}: `{file}` has no test `{word}`"));
                }
            }
        }
        assert!(count > 0, "{title} names no test");
        // Elsewhere a test is named in a sentence, with its file in the same row.
        for (label, content) in rows.iter().filter(|(label, _)| *label != "tests") {
            let files: Vec<String> = quoted(content).filter(|word| word.ends_with(".rs")).map(read).collect();
            for name in quoted(content).filter(|word| word.matches('_').count() > 3) {
                if !files.iter().any(|code| has_test(code, name)) {
                    missing.push(format!("{title}, {label}: no test `{name}` in a file of that row"));
                }
            }
        }
    }
    assert!(missing.is_empty(), "{GUARANTEES}:\n{}", missing.join("\n"));
}

#[test]
fn every_file_that_the_documents_name_exists() {
    for document in DOCUMENTS {
        let text = read(document);
        let folder = root(document).parent().expect("a folder").to_path_buf();
        let named = quoted(&text).filter(|word| FOLDERS.iter().any(|folder| word.starts_with(folder)));
        for path in named {
            assert!(root(path).exists(), "{document} names {path}, which does not exist");
        }
        for link in text.split("](").skip(1) {
            let (target, _) = link.split_once(')').expect("a link ends");
            let exists = target.contains("://") || folder.join(target).exists();
            assert!(exists, "{document} links to {target}, which does not exist");
        }
    }
}
