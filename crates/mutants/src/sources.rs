//! The files that git does not ignore, and all sites in those that are mutated.

use crate::operators;
use crate::parts::part_of;
use crate::site::Site;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The sources that are mutated.
pub(crate) struct Sources {
    /// Texts of the mutated files, by their paths from the root.
    pub texts: BTreeMap<String, String>,
    /// All sites, file by file.
    pub sites: Vec<Site>,
}

/// The state of the sources in words: the last commit, and whether something has changed since. `left_out` are paths from the
/// root that do not matter.
///
/// # Errors
/// `git` cannot tell.
pub(crate) fn state(root: &Path, left_out: &[&str]) -> Result<String, String> {
    let ask = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).current_dir(root).output();
        let output = output.map_err(|error| format!("git: {error}"))?;
        let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        match output.status.success() {
            true => Ok(text),
            false => Err(format!(
                "git {arguments:?}: {}",
                String::from_utf8_lossy(&output.stderr).trim()
            )),
        }
    };
    let commit = ask(&["rev-parse", "--short=12", "HEAD"])?;
    let others: Vec<String> = left_out.iter().map(|path| format!(":!{path}")).collect();
    let mut status = vec!["status", "--porcelain", "--", "."];
    status.extend(others.iter().map(String::as_str));
    let changes = match ask(&status)?.is_empty() {
        true => "",
        false => " with changes that are not committed",
    };
    Ok(format!("commit `{commit}`{changes}"))
}

/// Paths of the files that git does not ignore, from the root.
///
/// # Errors
/// `git` cannot list them.
pub(crate) fn files(root: &Path) -> Result<Vec<String>, String> {
    let output = Command::new("git")
        .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
        .current_dir(root)
        .output()
        .map_err(|error| format!("git: {error}"))?;
    if !output.status.success() {
        let text = String::from_utf8_lossy(&output.stderr);
        return Err(format!("git cannot list the files of {}: {text}", root.display()));
    }
    let names = String::from_utf8_lossy(&output.stdout);
    let names = names.split('\0').filter(|name| root.join(name).is_file());
    Ok(names.map(str::to_owned).collect())
}

/// Hash of the names and contents of files, without those at the paths `left_out`. One version of Rust always gives the
/// same files the same hash.
///
/// # Errors
/// A file cannot be read.
pub(crate) fn hash(root: &Path, files: &[String], left_out: &[PathBuf]) -> Result<u64, String> {
    let left_out: Vec<PathBuf> = left_out.iter().filter_map(|path| path.canonicalize().ok()).collect();
    let mut hasher = DefaultHasher::new();
    for file in files {
        let path = root.join(file);
        let shown = |error: std::io::Error| format!("{file}: {error}");
        if !left_out.contains(&path.canonicalize().map_err(shown)?) {
            (file, std::fs::read(&path).map_err(shown)?).hash(&mut hasher);
        }
    }
    Ok(hasher.finish())
}

/// Reads the mutated files, without those that are only tests.
///
/// # Errors
/// A file cannot be read or is not Rust.
pub(crate) fn read(root: &Path, files: &[String]) -> Result<Sources, String> {
    let mut texts = BTreeMap::new();
    let mut tests = Vec::new();
    for file in files.iter().filter(|file| file.ends_with(".rs")) {
        if part_of(file).is_none() && !file.ends_with("/lib.rs") {
            continue;
        }
        let text = std::fs::read_to_string(root.join(file)).map_err(|error| format!("{file}: {error}"))?;
        let modules = operators::test_modules(&text).map_err(|error| format!("{file}: {error}"))?;
        tests.extend(modules.iter().map(|module| module_path(file, module)));
        texts.insert(file.clone(), text);
    }
    let is_test = |file: &str| {
        tests.iter().any(|module| {
            file.strip_prefix(module.as_str())
                .is_some_and(|rest| rest == ".rs" || rest.starts_with('/'))
        })
    };
    texts.retain(|file, _| part_of(file).is_some() && !is_test(file));
    let mut sites = Vec::new();
    for (file, text) in &texts {
        sites.extend(operators::sites(file, text).map_err(|error| format!("{file}: {error}"))?);
    }
    Ok(Sources { texts, sites })
}

/// Path of a module's file or folder, without `.rs`, as the file that declares the module sees it.
fn module_path(file: &str, module: &str) -> String {
    let stem = file.strip_suffix(".rs").unwrap_or(file);
    let (folder, name) = stem.rsplit_once('/').unwrap_or(("", stem));
    match name {
        "mod" | "lib" | "main" => format!("{folder}/{module}"),
        _ => format!("{stem}/{module}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn modules_lie_where_the_compiler_looks_for_them() {
        assert_eq!(module_path("src/lib.rs", "a"), "src/a");
        assert_eq!(module_path("src/a/mod.rs", "b"), "src/a/b");
        assert_eq!(module_path("src/a.rs", "b"), "src/a/b");
    }

    #[test]
    fn the_hash_changes_with_a_test_and_not_with_a_file_that_is_left_out() {
        let root = std::env::temp_dir().join(format!("etherpen-mutants-hash-{}", std::process::id()));
        std::fs::create_dir_all(root.join("tests")).unwrap();
        let files = ["tests/a.rs".to_owned(), "report.md".to_owned()];
        let left_out = [root.join("tests/../report.md"), root.join("does not exist")];
        let hash_of = |test: &str, report: &str| {
            std::fs::write(root.join(&files[0]), test).unwrap();
            std::fs::write(root.join(&files[1]), report).unwrap();
            hash(&root, &files, &left_out).unwrap()
        };
        let before = hash_of("assert!(true)", "one");
        assert_eq!(hash_of("assert!(true)", "two"), before);
        assert_ne!(hash_of("assert!(a)", "one"), before);
        assert!(
            hash(&root, &["gone.rs".to_owned()], &[])
                .unwrap_err()
                .contains("gone.rs")
        );
        std::fs::remove_dir_all(&root).unwrap();
    }

    #[test]
    fn every_part_has_sites_and_no_test_has_one() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let files = files(&root).unwrap();
        let sources = read(&root, &files).unwrap();
        assert!(sources.sites.len() > 1_000, "{} sites", sources.sites.len());
        let has_none = |source: &&&str| !sources.sites.iter().any(|site| site.file.starts_with(**source));
        let listed = crate::parts::PARTS.iter().flat_map(|part| part.sources);
        let without: Vec<_> = listed.filter(has_none).collect();
        assert!(without.is_empty(), "without sites: {without:?}");
        for part in ["tests", "checks", "application/search", "random"] {
            let test = sources.sites.iter().find(|site| site.file.contains(part));
            assert!(test.is_none(), "{test:?}");
        }
        for site in &sources.sites {
            assert!(!site.function.is_empty(), "{site:?}");
        }
    }
}
