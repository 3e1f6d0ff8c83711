//! The tracked files of the sources, and all sites in those that are mutated.

use crate::operators;
use crate::parts::part_of;
use crate::site::Site;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;
use std::process::Command;

/// The sources that are mutated.
pub(crate) struct Sources {
    /// Texts of the mutated files, by their paths from the root.
    pub texts: BTreeMap<String, String>,
    /// All sites, file by file.
    pub sites: Vec<Site>,
    /// Hash of the code without its tests; the same code has the same hash with one version of Rust.
    pub code: u64,
}

/// Files under version control, from the root, as they lie in the folder now.
///
/// # Errors
/// `git` cannot list them.
pub(crate) fn tracked(root: &Path) -> Result<Vec<String>, String> {
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

/// Reads the mutated files, without those that are only tests.
///
/// # Errors
/// A file cannot be read or is not Rust.
pub(crate) fn read(root: &Path, tracked: &[String]) -> Result<Sources, String> {
    let mut texts = BTreeMap::new();
    let mut tests = Vec::new();
    for file in tracked.iter().filter(|file| file.ends_with(".rs")) {
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
    let mut hasher = DefaultHasher::new();
    for (file, text) in &texts {
        sites.extend(operators::sites(file, text).map_err(|error| format!("{file}: {error}"))?);
        // The tests are at the foot.
        let code = text.split("\n#[cfg(test)]\nmod ").next();
        (file, code).hash(&mut hasher);
    }
    Ok(Sources {
        texts,
        sites,
        code: hasher.finish(),
    })
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
    fn every_part_has_sites_and_no_test_has_one() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let tracked = tracked(&root).unwrap();
        let sources = read(&root, &tracked).unwrap();
        assert!(sources.sites.len() > 1_000, "{} sites", sources.sites.len());
        let has_none = |source: &&&str| !sources.sites.iter().any(|site| site.file.starts_with(**source));
        let listed = crate::parts::PARTS.iter().flat_map(|part| part.sources);
        let without: Vec<_> = listed.filter(has_none).collect();
        assert!(without.is_empty(), "without sites: {without:?}");
        for part in ["tests", "checks", "search", "random"] {
            let test = sources.sites.iter().find(|site| site.file.contains(part));
            assert!(test.is_none(), "{test:?}");
        }
        for site in &sources.sites {
            assert!(!site.function.is_empty(), "{site:?}");
        }
    }
}
