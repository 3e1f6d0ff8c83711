//! The imports of a crate's files, and the files that define what they import.

use super::tokens::{Token, tokens, without_tests};
use super::{Graph, Module};
use std::collections::{BTreeMap, BTreeSet};

/// Most `use` lines followed from a name to its definition.
const STEPS_MAX: usize = 8;

/// A path in a file.
#[derive(Clone, Debug)]
pub(super) struct Import {
    /// File and line.
    pub(super) place: String,
    /// The path from the root.
    path: Module,
}

/// What a file imports.
#[derive(Debug, Default)]
struct File {
    imports: Vec<Import>,
    /// Names that `use` lines bring into the module, with their paths from the root.
    names: BTreeMap<String, Module>,
}

/// The imports of all files of a crate.
#[derive(Debug, Default)]
pub(super) struct Imports(BTreeMap<Module, File>);

impl Imports {
    /// Reads the files, each a path and a text.
    pub(super) fn of(files: &[(String, String)]) -> Self {
        let mut result = Self::default();
        let mut tests = BTreeSet::new();
        let mut read = Vec::new();
        for (name, text) in files {
            let Some(module) = module_of(name) else { continue };
            let (tokens, test_modules) = without_tests(&tokens(text));
            for test in test_modules {
                tests.insert([module.clone(), vec![test]].concat());
            }
            result.0.insert(module.clone(), File::default());
            read.push((name, module, tokens));
        }
        let is_test = |module: &Module| tests.iter().any(|test: &Module| module.starts_with(test));
        result.0.retain(|module, _| !is_test(module));
        read.retain(|(_, module, _)| !is_test(module));
        for (name, module, tokens) in read {
            let file = Reader::new(name, &module, &result).read(&tokens);
            result.0.insert(module, file);
        }
        result
    }

    /// All modules that have a file.
    pub(super) fn modules(&self) -> impl Iterator<Item = &Module> {
        self.0.keys()
    }

    /// Whether a module has a file.
    pub(super) fn has(&self, module: &[String]) -> bool {
        self.0.contains_key(module)
    }

    /// The imports between files, without those of a module's own submodules.
    pub(super) fn graph(&self) -> Graph {
        let mut graph = Graph::new();
        for (module, file) in &self.0 {
            for import in &file.imports {
                let defined = self.defined_in(&import.path, STEPS_MAX);
                if !defined.is_empty() && !defined.starts_with(module) && !module.is_empty() {
                    let imports = graph.entry(module.clone()).or_default();
                    imports.entry(defined).or_insert_with(|| import.clone());
                }
            }
        }
        graph
    }

    /// The module whose file defines what a path names.
    fn defined_in(&self, path: &[String], steps: usize) -> Module {
        let lengths = (0..=path.len()).rev();
        let length = lengths
            .into_iter()
            .find(|length| path.get(..*length).is_some_and(|prefix| self.has(prefix)))
            .unwrap_or(0);
        let (module, rest) = path.split_at(length);
        let file = self.0.get(module);
        let named = rest.first().and_then(|name| file?.names.get(name));
        match named {
            Some(named) if steps > 0 && named.as_slice() != path => {
                let further: Module = named.iter().chain(rest.iter().skip(1)).cloned().collect();
                self.defined_in(&further, steps - 1)
            }
            _ => module.to_vec(),
        }
    }
}

/// The module of a file; `None` for the file of a binary.
fn module_of(name: &str) -> Option<Module> {
    let name = name.strip_suffix(".rs")?;
    if name == "main" || name.starts_with("bin/") {
        return None;
    }
    let mut module: Module = name.split('/').map(str::to_owned).collect();
    if module.last().is_some_and(|last| last == "mod") || name == "lib" {
        module.pop();
    }
    Some(module)
}

/// Reads the tokens of one file.
struct Reader<'a> {
    name: &'a str,
    known: &'a Imports,
    /// The module at the present token: the file's own, or one inside it.
    module: Module,
    /// Depths of braces at which modules inside the file end.
    inner: Vec<usize>,
    depth: usize,
    file: File,
}

impl<'a> Reader<'a> {
    fn new(name: &'a str, module: &Module, known: &'a Imports) -> Self {
        Self {
            name,
            known,
            module: module.clone(),
            inner: Vec::new(),
            depth: 0,
            file: File::default(),
        }
    }

    fn read(mut self, tokens: &[Token]) -> File {
        let text = |index: usize| tokens.get(index).map_or("", |token| token.text.as_str());
        let mut index = 0;
        while let Some(token) = tokens.get(index) {
            match token.text.as_str() {
                "{" => self.depth += 1,
                "}" => {
                    self.depth = self.depth.saturating_sub(1);
                    if self.inner.last() == Some(&self.depth) {
                        self.inner.pop();
                        self.module.pop();
                    }
                }
                "mod" if text(index + 2) == "{" => {
                    self.module.push(text(index + 1).to_owned());
                    self.inner.push(self.depth);
                    self.depth += 1;
                    index += 2;
                }
                "use" if text(index + 1) != "<" => {
                    let end = index + tokens.iter().skip(index).take_while(|token| token.text != ";").count();
                    let body = tokens.get(index + 1..end).unwrap_or_default();
                    self.tree(body, &[]);
                    index = end;
                }
                _ if token.is_word()
                    && text(index + 1) == "::"
                    && !matches!(text_before(tokens, index), "::" | "in" | "$") =>
                {
                    let mut path = vec![token.text.clone()];
                    while text(index + 1) == "::" && tokens.get(index + 2).is_some_and(Token::is_word) {
                        path.push(text(index + 2).to_owned());
                        index += 2;
                    }
                    self.import(&path, token.line);
                }
                _ => {}
            }
            index += 1;
        }
        self.file
    }

    /// Reads the tree of a `use` line.
    fn tree(&mut self, tokens: &[Token], prefix: &[String]) {
        let mut path = prefix.to_vec();
        let mut index = 0;
        while let Some(token) = tokens.get(index) {
            match token.text.as_str() {
                "{" => {
                    for part in parts(tokens.get(index + 1..tokens.len() - 1).unwrap_or_default()) {
                        self.tree(part, &path);
                    }
                    return;
                }
                "as" => break,
                "::" => {}
                name => path.push(name.to_owned()),
            }
            index += 1;
        }
        let Some(first) = tokens.first() else { return };
        if path.last().is_some_and(|last| last == "self") && path.len() > 1 {
            path.pop();
        }
        let alias = tokens.get(index + 1).map(|token| token.text.clone());
        let name = alias.or_else(|| path.last().cloned()).unwrap_or_default();
        let Some(absolute) = self.absolute(&path) else { return };
        // A private name is visible in the module's submodules too.
        if self.inner.is_empty() && name != "*" {
            self.file.names.insert(name, absolute.clone());
        }
        self.file.imports.push(Import {
            place: format!("{}:{}", self.name, first.line),
            path: absolute,
        });
    }

    fn import(&mut self, path: &[String], line: usize) {
        // A path that starts with an imported name counts at its `use` line.
        let Some(path) = self.absolute(path) else { return };
        self.file.imports.push(Import {
            place: format!("{}:{line}", self.name),
            path,
        });
    }

    /// The path from the root; `None` for a path into another crate.
    fn absolute(&self, path: &[String]) -> Option<Module> {
        let first = path.first()?.as_str();
        let rest = path.iter().skip(1);
        match first {
            "crate" => Some(rest.cloned().collect()),
            "self" => Some(self.module.iter().chain(rest).cloned().collect()),
            "super" => {
                let ups = path.iter().take_while(|part| *part == "super").count();
                let kept = self.module.len().checked_sub(ups)?;
                let below = path.iter().skip(ups);
                Some(self.module.iter().take(kept).chain(below).cloned().collect())
            }
            _ => {
                let child: Module = self.module.iter().cloned().chain([first.to_owned()]).collect();
                let is_child = self.known.has(&child);
                is_child.then(|| self.module.iter().chain(path).cloned().collect())
            }
        }
    }
}

fn text_before(tokens: &[Token], index: usize) -> &str {
    let before = index.checked_sub(1).and_then(|before| tokens.get(before));
    before.map_or("", |token| token.text.as_str())
}

/// The parts of a list between commas outside braces.
fn parts(tokens: &[Token]) -> Vec<&[Token]> {
    let mut depth = 0_usize;
    let split = tokens.split(|token| {
        match token.text.as_str() {
            "{" => depth += 1,
            "}" => depth = depth.saturating_sub(1),
            _ => {}
        }
        depth == 0 && token.text == ","
    });
    split.filter(|part| !part.is_empty()).collect()
}
