//! Dependencies: where they come from, under which licences, and which come in several versions.
//!
//! `cargo metadata` describes every package that a build for this computer or for a board can use. It compiles nothing, and
//! it needs no network once cargo has the packages. `deny.toml` lists the licences.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Cargo's name for crates.io, whatever mirror is in use.
const CRATES_IO: &str = "registry+https://github.com/rust-lang/crates.io-index";
/// Platforms that anything is built for.
const PLATFORMS: [&str; 2] = ["x86_64-unknown-linux-gnu", "thumbv7em-none-eabihf"];
/// Lock files of the workspace and of the packages outside of it.
const LOCKS: [&str; 4] = [
    "Cargo.lock",
    "benchmarks/Cargo.lock",
    "fuzz/Cargo.lock",
    "models/Cargo.lock",
];

/// Crates in several versions: name, number of versions, and why there is not only one.
const SEVERAL: [(&str, usize, &str); 13] = [
    ("base64", 2, "axum has the older one, usvg the newer one"),
    ("bitflags", 2, "smoltcp, defmt and linuxvideo have version 1"),
    ("embassy-time", 2, "ethercrab, the master that a test compares with"),
    (
        "embedded-hal",
        2,
        "cortex-m, usbd-serial and embassy-time implement both",
    ),
    ("embedded-io", 2, "usbd-serial and ethercrab have the older one"),
    ("embedded-io-async", 2, "ethercrab"),
    ("heapless", 2, "usb-device and ethercrab have the older one"),
    ("linux-raw-sys", 2, "ethercrab's timerfd has the older rustix"),
    ("nb", 2, "belongs to both versions of embedded-hal"),
    ("num-bigint", 2, "rustface has the older one, cbor-edn the newer one"),
    (
        "roxmltree",
        2,
        "fontconfig-parser has the older one, usvg the newer one",
    ),
    ("rustix", 2, "ethercrab's timerfd has the older one"),
    (
        "syn",
        3,
        "macros move from 2 to 3 one by one; ethercrab's smlang has version 1",
    ),
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(file: &str) -> String {
    std::fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"))
}

/// A package as cargo describes it.
struct Package {
    name: String,
    version: String,
    /// SPDX expression.
    licence: Option<String>,
    source: Option<String>,
    manifest: PathBuf,
}

/// What a cargo command that compiles nothing prints.
fn cargo(arguments: &[&str]) -> Vec<u8> {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    let output = cargo.current_dir(root()).args(arguments).output().expect("cargo");
    assert!(
        output.status.success(),
        "`cargo {}` failed; `cargo fetch --locked` gets missing packages:\n{}",
        arguments[0],
        String::from_utf8_lossy(&output.stderr)
    );
    output.stdout
}

fn packages() -> Vec<Package> {
    let mut arguments = vec!["metadata", "--format-version", "1", "--locked", "--all-features"];
    for platform in PLATFORMS {
        arguments.extend(["--filter-platform", platform]);
    }
    let metadata: Value = serde_json::from_slice(&cargo(&arguments)).expect("JSON");
    let text = |package: &Value, key: &str| package[key].as_str().map(str::to_owned);
    let described = metadata["packages"].as_array().expect("packages");
    let described = described.iter().map(|package| Package {
        name: text(package, "name").expect("a name"),
        version: text(package, "version").expect("a version"),
        licence: text(package, "license"),
        source: text(package, "source"),
        manifest: text(package, "manifest_path").expect("a manifest").into(),
    });
    described.collect()
}

/// Whether an SPDX expression is satisfied by allowed licences. `/` is the older notation of `OR`.
fn is_allowed(expression: &str, allowed: &dyn Fn(&str) -> bool) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut rest = words.as_slice();
    let is_allowed = either(&mut rest, allowed);
    assert!(rest.is_empty(), "`{expression}` is not an SPDX expression");
    is_allowed
}

fn take(rest: &mut &[&str], word: &str) -> bool {
    let is_next = rest.first() == Some(&word);
    if is_next {
        *rest = &rest[1..];
    }
    is_next
}

/// Terms with `OR` between them.
fn either(rest: &mut &[&str], allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut any = both(rest, allowed);
    while take(rest, "OR") {
        // Not `||`, which would not read the term behind a true one.
        any |= both(rest, allowed);
    }
    any
}

/// Terms with `AND` between them, which binds tighter than `OR`.
fn both(rest: &mut &[&str], allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut all = licence(rest, allowed);
    while take(rest, "AND") {
        all &= licence(rest, allowed);
    }
    all
}

/// One licence, with its exception, or an expression in parentheses.
fn licence(rest: &mut &[&str], allowed: &dyn Fn(&str) -> bool) -> bool {
    if take(rest, "(") {
        let inner = either(rest, allowed);
        assert!(take(rest, ")"), "a parenthesis is not closed before {rest:?}");
        return inner;
    }
    let (name, behind) = rest.split_first().expect("a licence");
    *rest = behind;
    if !take(rest, "WITH") {
        return allowed(name);
    }
    let (exception, behind) = rest.split_first().expect("an exception");
    *rest = behind;
    allowed(&format!("{name} WITH {exception}"))
}

/// Licences that `deny.toml` allows for all crates, and pairs of a crate and the licence that it alone may have.
fn licences() -> (BTreeSet<String>, BTreeSet<(String, String)>) {
    let text = read("deny.toml");
    let quoted = |text: &str| -> Vec<String> { text.split('"').skip(1).step_by(2).map(str::to_owned).collect() };
    let list = |opening: &str| {
        let (_, rest) = text.split_once(opening).unwrap_or_else(|| panic!("no `{opening}`"));
        rest.split_once("\n]").expect("the list ends").0.to_owned()
    };
    let exceptions = list("\nexceptions = [\n");
    let exceptions = exceptions.lines().map(|line| match quoted(line).as_slice() {
        [name, licence] => (name.clone(), licence.clone()),
        _ => panic!("not one crate with one licence: {line}"),
    });
    (
        quoted(&list("\nallow = [\n")).into_iter().collect(),
        exceptions.collect(),
    )
}

#[test]
fn every_dependency_has_an_allowed_licence_and_no_licence_is_allowed_in_vain() {
    let (general, exceptions) = licences();
    let allows = |package: &Package, without: &str| {
        let expression = package.licence.as_deref().unwrap_or("none");
        is_allowed(expression, &|name| {
            let exception = (package.name.clone(), name.to_owned());
            name != without && (general.contains(name) || exceptions.contains(&exception))
        })
    };
    let packages = packages();
    assert!(packages.len() > 100, "{} packages", packages.len());
    let refused = packages.iter().filter(|package| !allows(package, ""));
    let refused: Vec<_> = refused
        .map(|package| format!("{} {}: {:?}", package.name, package.version, package.licence))
        .collect();
    assert!(
        refused.is_empty(),
        "licences that deny.toml does not allow:\n{}",
        refused.join("\n")
    );
    for licence in general.iter().chain(exceptions.iter().map(|(_, licence)| licence)) {
        let is_needed = packages.iter().any(|package| !allows(package, licence));
        assert!(is_needed, "no dependency needs {licence}: take it out of deny.toml");
    }
    for (name, _) in &exceptions {
        let exists = packages.iter().any(|package| package.name == *name);
        assert!(
            exists,
            "{name} is not a dependency: take its exception out of deny.toml"
        );
    }
}

#[test]
fn every_dependency_comes_from_crates_io_or_from_this_workspace() {
    let packages = packages();
    let mut own = BTreeSet::from(["benchmarks", "etherpen-fuzz", "etherpen-models"].map(str::to_owned));
    for package in packages {
        match &package.source {
            Some(source) => assert!(source == CRATES_IO, "{} is not from crates.io", package.name),
            None => {
                let is_inside = package.manifest.starts_with(root());
                assert!(is_inside, "{} lies outside of this workspace", package.name);
                own.insert(package.name);
            }
        }
    }
    // The lock files name all packages, also those of other platforms.
    for file in LOCKS {
        let lock = read(file);
        for package in lock.split("[[package]]").skip(1) {
            let value = |key: &str| {
                let value = |line: &str| line.strip_prefix(key)?.strip_prefix(" = ").map(str::to_owned);
                let value = package.lines().find_map(value)?;
                Some(value.trim_matches('"').to_owned())
            };
            let name = value("name").expect("a name");
            match value("source") {
                Some(source) => assert!(source == CRATES_IO, "{file}: {name} is not from crates.io"),
                None => assert!(own.contains(&name), "{file}: {name} lies outside of this workspace"),
            }
        }
    }
}

#[test]
fn crates_in_several_versions_are_listed_with_the_reason() {
    let mut versions: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for package in packages() {
        versions.entry(package.name).or_default().insert(package.version);
    }
    versions.retain(|_, versions| versions.len() > 1);
    for (name, number, reason) in SEVERAL {
        let found = versions.remove(name).unwrap_or_default();
        assert!(
            found.len() >= number,
            "{name} has fewer versions than listed, {found:?}: shorten the list (\"{reason}\")"
        );
        assert!(
            found.len() <= number,
            "{name} has more versions than listed, {found:?}: `cargo tree --workspace --invert {name}@VERSION` tells why"
        );
    }
    assert!(
        versions.is_empty(),
        "crates in several versions: choose versions that agree (`cargo update NAME --precise VERSION`), or list them \
         with a reason: {versions:?}"
    );
}

/// The packages that a command compiles, with the features that they then have.
fn with_features(arguments: &[&str]) -> BTreeSet<String> {
    let tree = ["tree", "--locked", "--prefix", "none", "--format", "{p} {f}"];
    let tree = cargo(&[&tree, arguments].concat());
    let tree = String::from_utf8(tree).expect("text");
    // A package that is listed again has this mark.
    tree.lines()
        .map(|line| line.trim_end_matches(" (*)").to_owned())
        .collect()
}

#[test]
fn the_program_has_the_same_features_when_it_runs_and_when_it_is_tested() {
    // `cargo verify` is `cargo run`, which leaves out what tests alone depend on, and then tests the whole workspace. A crate
    // with other features there is compiled twice, and with it all that depend on it, host-tools among them.
    let (run, tested) = (with_features(&["--edges", "no-dev"]), with_features(&["--workspace"]));
    assert!(run.len() > 100, "{run:?}");
    let otherwise: Vec<_> = run.difference(&tested).collect();
    assert!(
        otherwise.is_empty(),
        "features without those of tests; give host-tools in [dependencies] what the tests add:\n{otherwise:#?}"
    );
}

#[test]
fn licence_expressions_are_read_as_spdx_defines_them() {
    let allowed = |name: &str| matches!(name, "A" | "B" | "A WITH X");
    for expression in [
        "A",
        "A OR C",
        "C OR A",
        "C/A",
        "A AND B",
        "C OR A AND B",
        "A WITH X",
        "(C OR B) AND A",
        "C AND C OR B",
    ] {
        assert!(is_allowed(expression, &allowed), "{expression}");
    }
    for expression in [
        "C",
        "A AND C",
        "C AND A OR C",
        "(A OR B) AND C",
        "A AND (C OR C)",
        "B WITH X",
        "C/C",
    ] {
        assert!(!is_allowed(expression, &allowed), "{expression}");
    }
}
