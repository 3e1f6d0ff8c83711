//! The checks on small crates in memory, on this crate and on the segment.

use super::*;

const TABLE: &str = "//! A crate.
//!
//! # Layers
//!
//! Words before the list: `none`.
//!
//! 1. `base`, `other`: what all use (`none`)
//! 2. `middle`: it has parts, and a description of
//!    two lines: `none`
//! 3. `middle::upper`,
//!    `top`: the rest
//!
//! # Another heading
//!
//! 1. `none`: no layer
";

/// Findings in a crate with all modules of the table, some of which have the given text.
fn found(texts: &[(&str, &str)]) -> Vec<String> {
    let plain = [
        "base.rs",
        "other.rs",
        "middle/mod.rs",
        "middle/upper.rs",
        "top.rs",
        "lib.rs",
        "main.rs",
    ];
    let mut files: BTreeMap<String, String> = plain.map(|name| (name.to_owned(), String::new())).into();
    files.extend(
        texts
            .iter()
            .map(|(name, text)| ((*name).to_owned(), (*text).to_owned())),
    );
    let files: Vec<(String, String)> = files.into_iter().collect();
    let findings = check_texts(&files, TABLE);
    findings.iter().map(ToString::to_string).collect()
}

#[test]
fn this_crate_and_the_segment_keep_their_layers() {
    let crates = [
        ("src", include_str!("../lib.rs")),
        (
            "../crates/segment/src",
            include_str!("../../../crates/segment/src/lib.rs"),
        ),
    ];
    for (source, table) in crates {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join(source);
        let findings = check(&source, table).expect("the sources");
        let shown: Vec<String> = findings.iter().map(ToString::to_string).collect();
        assert!(shown.is_empty(), "{}", shown.join("\n"));
    }
}

#[test]
fn imports_that_point_down_are_fine() {
    let none: [String; 0] = [];
    let texts = [
        (
            "top.rs",
            "use crate::base;\nuse crate::middle::{self, upper as _};\nfn f() { crate::other::g() }",
        ),
        ("middle/upper.rs", "use super::Thing;\nuse crate::base::{A, B};"),
        (
            "middle/mod.rs",
            "pub mod upper;\nuse crate::base::A;\npub struct Thing;",
        ),
    ];
    // The entry of middle::upper is in the layer of top.
    assert_eq!(
        found(&texts),
        ["top.rs:2: top (layer 3) imports middle::upper (layer 3)"]
    );
    assert_eq!(found(&texts[1..]), none);
}

#[test]
fn an_import_that_points_up_is_found_with_its_line() {
    assert_eq!(
        found(&[("base.rs", "//! Text.\n\nuse std::fmt;\nuse crate::middle::Thing;\n")]),
        ["base.rs:4: base (layer 1) imports middle (layer 2)"]
    );
    assert_eq!(
        found(&[("other.rs", "fn f() -> crate::base::Thing {}")]),
        ["other.rs:1: other (layer 1) imports base (layer 1)"]
    );
    assert_eq!(
        found(&[("middle/mod.rs", "mod inside { use super::super::top::Thing; }")]),
        ["middle/mod.rs:1: middle (layer 2) imports top (layer 3)"]
    );
}

#[test]
fn texts_comments_tests_and_binaries_do_not_count() {
    let text = "// use crate::top;\n/* use crate::top; /* */ use crate::top; */\n\
        const A: &str = \"use crate::top::\\\"A;\";\nconst B: &str = r#\"crate::top::\"A\"#;\nconst C: char = '\"';\n\
        fn f<'a>(x: &'a str) {}\n#[cfg(test)]\nmod tests {\n    use crate::top::A;\n    fn f() {}\n}\n\
        #[cfg(test)]\nmod more;\n#[cfg(test)]\nuse crate::top::B;";
    let texts = [
        ("base.rs", text),
        ("base/more.rs", "use crate::top::A;"),
        ("main.rs", "use crate::top::A;"),
        ("bin/tool/main.rs", "use crate::top::A;"),
    ];
    assert_eq!(found(&texts), [""; 0]);
    let after = format!("{text}\nuse crate::top::C;");
    assert_eq!(
        found(&[("base.rs", &after)]),
        ["base.rs:16: base (layer 1) imports top (layer 3)"]
    );
}

#[test]
fn what_is_handed_on_counts_for_the_file_that_defines_it() {
    let texts = [
        ("middle/mod.rs", "mod a;\nmod b;\nuse a::One;\npub use b::Two;"),
        ("middle/a.rs", "use super::Two;\npub struct One;"),
        ("middle/b.rs", "use super::One;\npub struct Two;"),
    ];
    assert_eq!(
        found(&texts),
        ["a circle: middle/a.rs:1: middle::a imports middle::b; middle/b.rs:1: middle::b imports middle::a"]
    );
}

#[test]
fn a_module_and_its_submodules_are_one_unit_and_longer_circles_are_found() {
    let unit = [
        ("middle/mod.rs", "mod a;\nuse a::One;\nstruct Own;"),
        ("middle/a.rs", "use super::Own;"),
    ];
    assert_eq!(found(&unit), [""; 0]);
    let circle = [
        ("middle/a.rs", "use super::b::Two;"),
        ("middle/b.rs", "use crate::middle::c;"),
        ("middle/c.rs", "fn f() { super::a::g() }"),
    ];
    let findings = found(&circle);
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert_eq!(findings[0].matches("imports").count(), 3, "{findings:?}");
}

#[test]
fn the_table_and_the_modules_are_the_same() {
    assert_eq!(found(&[("new/mod.rs", "")]), ["new is in no layer"]);
    let table = TABLE.replace("`base`", "`base`, `gone`");
    let files: Vec<(String, String)> = ["base", "other", "middle/mod", "middle/upper", "top"]
        .map(|name| (format!("{name}.rs"), String::new()))
        .into();
    assert_eq!(check_texts(&files, &table), [Finding::Absent("gone".into())]);
    for (wrong, cause) in [
        ("//! No list.", "no numbered list"),
        ("# Layers\n1. `a`: x\n3. `b`: y", "layer 3 follows layer 1"),
        ("# Layers\n1. `a`: x\n2. `a`: y", "listed twice"),
    ] {
        let error = Layers::parse(wrong).unwrap_err();
        assert!(error.contains(cause), "{error}");
    }
}
