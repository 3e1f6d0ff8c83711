//! The instrumented copy of the sources: files that git does not ignore, the mutants, and the crate with their switch.

use crate::instrument::{Instrumented, SWITCH_CRATE, instrument, with_switch};
use crate::parts::PARTS;
use crate::site::Site;
use crate::sources::Sources;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Folder of the crate with the switch, in the copy.
const SWITCH_FOLDER: &str = "mutant-switch";
const SWITCH: &str = include_str!("switch.rs");

/// A folder with the copy.
pub(crate) struct Copy {
    /// The folder.
    pub folder: PathBuf,
    mutated: BTreeMap<String, Instrumented>,
}

impl Copy {
    /// Copies `files` to `folder`, without those that [`Self::mutate`] writes. Files whose content is already there
    /// keep their times, so that cargo builds little.
    ///
    /// # Errors
    /// A file cannot be read or written.
    pub(crate) fn make(root: &Path, files: &[String], sources: &Sources, folder: PathBuf) -> Result<Self, String> {
        for file in files {
            let content = fs::read(root.join(file)).map_err(|error| format!("{file}: {error}"))?;
            let is_manifest = manifests().iter().any(|(manifest, _)| manifest == file);
            if !is_manifest && !sources.texts.contains_key(file) {
                write(&folder.join(file), &content)?;
            }
        }
        for (manifest, path) in manifests() {
            let text = fs::read_to_string(root.join(&manifest)).map_err(|error| format!("{manifest}: {error}"))?;
            let text = with_switch(&text, &path).map_err(|error| format!("{manifest}: {error}"))?;
            write(&folder.join(manifest), text.as_bytes())?;
        }
        let manifest = format!("[package]\nname = \"{SWITCH_CRATE}\"\nversion = \"0.0.0\"\nedition = \"2024\"\n");
        write(&folder.join(SWITCH_FOLDER).join("Cargo.toml"), manifest.as_bytes())?;
        write(&folder.join(SWITCH_FOLDER).join("src/lib.rs"), SWITCH.as_bytes())?;
        remove_others(&folder, files)?;
        Ok(Self {
            folder,
            mutated: BTreeMap::new(),
        })
    }

    /// Writes the mutants; the numbers begin at 1.
    ///
    /// # Errors
    /// A file cannot be written.
    pub(crate) fn mutate(&mut self, sources: &Sources, chosen: &[usize]) -> Result<(), String> {
        let numbered: Vec<(u32, &Site)> = (1..).zip(chosen.iter().map(|site| &sources.sites[*site])).collect();
        self.mutated.clear();
        for (file, text) in &sources.texts {
            let of_file: Vec<_> = numbered
                .iter()
                .filter(|(_, site)| site.file == *file)
                .copied()
                .collect();
            let instrumented = instrument(text, &of_file);
            write(&self.folder.join(file), instrumented.text.as_bytes())?;
            self.mutated.insert(file.clone(), instrumented);
        }
        Ok(())
    }

    /// The mutant whose code the compiler means.
    #[must_use]
    pub(crate) fn mutant_at(&self, file: &str, bytes: &std::ops::Range<usize>) -> Option<u32> {
        self.mutated.get(file)?.mutant_at(bytes)
    }
}

/// Manifests of the crates with mutants, and the path from there to the switch.
fn manifests() -> Vec<(String, String)> {
    let sources = PARTS.iter().flat_map(|part| part.sources);
    let packages: BTreeSet<&str> = sources
        .map(|source| source.split_once("src").map_or("", |(package, _)| package))
        .collect();
    let manifest = |package: &str| {
        let up = "../".repeat(package.matches('/').count());
        (format!("{package}Cargo.toml"), format!("{up}{SWITCH_FOLDER}"))
    };
    packages.into_iter().map(manifest).collect()
}

/// Removes Rust files that are not among `files`: cargo would find tests among them.
fn remove_others(folder: &Path, files: &[String]) -> Result<(), String> {
    let known: BTreeSet<PathBuf> = files.iter().map(|file| folder.join(file)).collect();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(inner) = folders.pop() {
        if inner == folder.join(SWITCH_FOLDER) {
            continue;
        }
        let entries = fs::read_dir(&inner).map_err(|error| format!("{}: {error}", inner.display()))?;
        for path in entries.flatten().map(|entry| entry.path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") && !known.contains(&path) {
                fs::remove_file(&path).map_err(|error| format!("{}: {error}", path.display()))?;
            }
        }
    }
    Ok(())
}

/// Writes a file unless it has this content already.
fn write(path: &Path, content: &[u8]) -> Result<(), String> {
    if fs::read(path).is_ok_and(|old| old == content) {
        return Ok(());
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder)
        .and_then(|()| fs::write(path, content))
        .map_err(|error| format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_crate_with_mutants_finds_the_switch() {
        let path = |crate_name: &str| {
            (
                format!("crates/{crate_name}/Cargo.toml"),
                "../../mutant-switch".to_owned(),
            )
        };
        let expected = [
            ("Cargo.toml".to_owned(), "mutant-switch".to_owned()),
            path("drives"),
            path("ethercat"),
            path("motion"),
        ];
        assert_eq!(manifests(), expected);
    }
}
