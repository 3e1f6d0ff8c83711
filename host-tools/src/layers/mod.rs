//! Checks of a crate's structure: every import points down in the crate's layers, and no files import each other in a
//! circle.
//!
//! The layers are a numbered list under the heading `# Layers` of a documentation text; the lowest layer is the first:
//!
//! ```text
//! //! # Layers
//! //!
//! //! 1. `error`, `hash`: what they are
//! //! 2. `drawing`: what it is
//! //! 3. `drawing::preparation`, `console`: what they are
//! ```
//!
//! A module imports modules of lower layers and of its own entry, but no other module of its own layer. A submodule
//! that has an entry of its own is not part of its parent's entry. Every top-level module has an entry.
//!
//! A module and its submodules are one unit: a submodule may use its parent's items, and the parent may use its
//! submodule. All other files that import each other, directly or through other files, form a circle. An imported item
//! counts for the file that defines it, even if another module re-exports it with `use`.
//!
//! Test code and binaries (`main.rs`, `bin/`) are not checked.

mod circles;
mod imports;
mod tokens;

use imports::{Import, Imports};
use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::path::Path;

/// A module by its path from the root; the root is empty.
type Module = Vec<String>;

/// A violation of the structure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finding {
    /// The table is missing, its numbers are not consecutive, or a module is listed twice.
    Table(String),
    /// A top-level module is in no layer.
    Unlisted(String),
    /// A module of the table does not exist.
    Absent(String),
    /// An import points up, or to another module of the same layer.
    Upward {
        /// File and line.
        place: String,
        /// The importing module and its layer.
        from: (String, usize),
        /// The imported module and its layer.
        to: (String, usize),
    },
    /// Files import each other: the imports, each with file and line.
    Circle(Vec<String>),
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Table(cause) => write!(f, "the table of layers: {cause}"),
            Self::Unlisted(module) => write!(f, "{module} is in no layer"),
            Self::Absent(module) => write!(f, "{module} is in a layer, and there is no such module"),
            Self::Upward { place, from, to } => write!(
                f,
                "{place}: {} (layer {}) imports {} (layer {})",
                from.0, from.1, to.0, to.1
            ),
            Self::Circle(imports) => write!(f, "a circle: {}", imports.join("; ")),
        }
    }
}

/// Checks the sources in a folder against the layers in `table`, usually the text of the crate's `lib.rs`.
///
/// # Errors
/// A file cannot be read.
pub fn check(folder: &Path, table: &str) -> io::Result<Vec<Finding>> {
    let mut files = Vec::new();
    collect(folder, "", &mut files)?;
    Ok(check_texts(&files, table))
}

/// Reads the sources of a folder, each with its path inside the folder.
fn collect(folder: &Path, prefix: &str, files: &mut Vec<(String, String)>) -> io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        if entry.file_type()?.is_dir() {
            collect(&entry.path(), &format!("{name}/"), files)?;
        } else if name.ends_with(".rs") {
            files.push((name, std::fs::read_to_string(entry.path())?));
        }
    }
    Ok(())
}

/// Checks sources, each a path and a text.
fn check_texts(files: &[(String, String)], table: &str) -> Vec<Finding> {
    let layers = match Layers::parse(table) {
        Ok(layers) => layers,
        Err(cause) => return vec![Finding::Table(cause)],
    };
    let sources = Imports::of(files);
    let mut findings = layers.missing(&sources);
    let graph = sources.graph();
    for (from, to, import) in edges(&graph) {
        findings.extend(layers.upward(from, to, import));
    }
    findings.extend(circles::circles(&graph).into_iter().map(Finding::Circle));
    findings
}

/// Imports between files: importing module, imported module, the first place.
type Graph = BTreeMap<Module, BTreeMap<Module, Import>>;

fn edges(graph: &Graph) -> impl Iterator<Item = (&Module, &Module, &Import)> {
    graph
        .iter()
        .flat_map(|(from, imports)| imports.iter().map(move |(to, import)| (from, to, import)))
}

/// Modules with the numbers of their layers.
#[derive(Debug)]
struct Layers(BTreeMap<Module, usize>);

impl Layers {
    /// Reads the numbered list under the heading `# Layers`.
    fn parse(text: &str) -> Result<Self, String> {
        let lines = text
            .lines()
            .map(|line| line.trim_start().trim_start_matches("//!").trim());
        let list = lines.skip_while(|line| *line != "# Layers").skip(1);
        let mut layers = BTreeMap::new();
        let (mut number, mut is_named) = (0, false);
        for line in list.take_while(|line| !line.starts_with('#')) {
            let begun = line
                .split_once(". ")
                .and_then(|(number, rest)| Some((number.parse::<usize>().ok()?, rest)));
            let rest = match begun {
                Some((next, rest)) if next == number + 1 => {
                    (number, is_named) = (next, true);
                    rest
                }
                Some((next, _)) => return Err(format!("layer {next} follows layer {number}")),
                None if line.is_empty() => {
                    is_named = false;
                    continue;
                }
                None => line,
            };
            if !is_named {
                continue;
            }
            // The modules are before the first colon outside a name.
            for (index, part) in rest.split('`').enumerate() {
                if index % 2 == 1 {
                    let module: Module = part.split("::").map(str::to_owned).collect();
                    if layers.insert(module, number).is_some() {
                        return Err(format!("{part} is listed twice"));
                    }
                } else if part.contains(':') {
                    is_named = false;
                    break;
                }
            }
        }
        match layers.is_empty() {
            true => Err("there is no numbered list under the heading # Layers".to_owned()),
            false => Ok(Self(layers)),
        }
    }

    /// The entry to which a module belongs, and its layer.
    fn entry(&self, module: &[String]) -> Option<(&Module, usize)> {
        let prefixes = (1..=module.len()).rev().filter_map(|length| module.get(..length));
        let mut entries = prefixes.filter_map(|prefix| self.0.get_key_value(prefix));
        entries.next().map(|(entry, layer)| (entry, *layer))
    }

    /// Modules without an entry, and entries without a module.
    fn missing(&self, sources: &Imports) -> Vec<Finding> {
        let modules = sources.modules().filter(|module| module.len() == 1);
        let unlisted = modules.filter(|module| !self.0.contains_key(*module));
        let absent = self.0.keys().filter(|entry| !sources.has(entry));
        unlisted
            .map(|module| Finding::Unlisted(module.join("::")))
            .chain(absent.map(|entry| Finding::Absent(entry.join("::"))))
            .collect()
    }

    /// The violation of an import, if any.
    fn upward(&self, from: &Module, to: &Module, import: &Import) -> Option<Finding> {
        let ((entry, layer), (imported, lower)) = (self.entry(from)?, self.entry(to)?);
        if entry == imported || lower < layer {
            return None;
        }
        Some(Finding::Upward {
            place: import.place.clone(),
            from: (from.join("::"), layer),
            to: (to.join("::"), lower),
        })
    }
}

#[cfg(test)]
mod tests;
