//! Builds the instrumented copy with cargo, and reads cargo's messages.

use crate::parts::{PARTS, Suite};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// An error of the compiler.
#[derive(Clone, Debug)]
pub(crate) struct CompileError {
    /// Files from the root of the copy, and bytes there.
    pub places: Vec<(String, Range<usize>)>,
    /// The message as the compiler shows it.
    pub text: String,
}

/// Cargo in the copy.
pub(crate) struct Cargo<'a> {
    /// Root of the copy.
    pub copy: &'a Path,
    /// Cargo's output folder: one of its own, because cargo takes files of the sources for those of the copy.
    pub target: &'a Path,
}

impl Cargo<'_> {
    /// Errors of the crates with mutants.
    ///
    /// # Errors
    /// Cargo cannot be started.
    pub(crate) fn check(&self) -> Result<Vec<CompileError>, String> {
        let (_, messages) = self.run(&[&["check", "--lib", "--keep-going"], packages().as_slice()].concat())?;
        Ok(messages.iter().filter_map(compile_error).collect())
    }

    /// Builds the tests of all parts.
    ///
    /// # Errors
    /// Cargo failed, or a test of a part does not exist.
    pub(crate) fn tests(&self) -> Result<BTreeMap<Suite, PathBuf>, String> {
        let suites: BTreeSet<Suite> = PARTS.iter().flat_map(|part| part.suites).copied().collect();
        let mut arguments = [&["test", "--no-run", "--lib"], packages().as_slice()].concat();
        let targets: BTreeSet<&str> = suites.iter().map(|suite| suite.target).collect();
        for target in targets.into_iter().filter(|target| !target.is_empty()) {
            arguments.extend(["--test", target]);
        }
        let messages = self.succeed(&arguments)?;
        let program = |suite: Suite| {
            let manifest = self.copy.join(suite.package).join("Cargo.toml");
            let is_it = |message: &&Value| {
                let target = &message["target"];
                let is_library = target["kind"][0] == "lib";
                message["profile"]["test"] == true
                    && Path::new(message["manifest_path"].as_str().unwrap_or_default()) == manifest
                    && (is_library && suite.target.is_empty() || !is_library && target["name"] == suite.target)
            };
            let message = messages.iter().find(is_it);
            let program = message.and_then(|message| message["executable"].as_str());
            let program = program.ok_or_else(|| format!("cargo built no tests {suite}"))?;
            Ok((suite, PathBuf::from(program)))
        };
        suites.into_iter().map(program).collect()
    }

    /// Builds the program `etherpen`, for campaigns.
    ///
    /// # Errors
    /// Cargo failed.
    pub(crate) fn etherpen(&self) -> Result<PathBuf, String> {
        let messages = self.succeed(&["build", "--release", "-p", "host-tools", "--bin", "etherpen"])?;
        let mut built = messages.iter().filter_map(|message| message["executable"].as_str());
        let built = built.next_back().ok_or("cargo built no program etherpen")?;
        Ok(built.into())
    }

    fn succeed(&self, arguments: &[&str]) -> Result<Vec<Value>, String> {
        let (succeeded, messages) = self.run(arguments)?;
        if succeeded {
            return Ok(messages);
        }
        let errors: Vec<String> = messages
            .iter()
            .filter_map(compile_error)
            .map(|error| error.text)
            .collect();
        Err(format!("cargo {} failed\n{}", arguments.join(" "), errors.join("\n")))
    }

    /// Whether cargo succeeded, and its messages.
    fn run(&self, arguments: &[&str]) -> Result<(bool, Vec<Value>), String> {
        let output = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()))
            .args(arguments)
            .args(["--message-format", "json"])
            .env("CARGO_TARGET_DIR", self.target)
            .current_dir(self.copy)
            .stderr(Stdio::inherit())
            .output()
            .map_err(|error| format!("cargo: {error}"))?;
        let text = String::from_utf8_lossy(&output.stdout);
        let messages = text.lines().filter_map(|line| serde_json::from_str(line).ok());
        Ok((output.status.success(), messages.collect()))
    }
}

/// Options that select the packages with mutants.
fn packages() -> Vec<&'static str> {
    let name = |suite: &Suite| match suite.package {
        "" => "etherpen",
        "crates/drives" => "etherpen-drives",
        "crates/ethercat" => "etherpen-ethercat",
        "crates/motion" => "etherpen-motion",
        other => other,
    };
    let names: BTreeSet<&str> = PARTS.iter().flat_map(|part| part.suites).map(name).collect();
    names.into_iter().flat_map(|name| ["-p", name]).collect()
}

fn compile_error(message: &Value) -> Option<CompileError> {
    let content = &message["message"];
    if message["reason"] != "compiler-message" || content["level"] != "error" {
        return None;
    }
    let place = |span: &Value| {
        let byte = |key: &str| span[key].as_u64().and_then(|byte| usize::try_from(byte).ok());
        Some((
            span["file_name"].as_str()?.to_owned(),
            byte("byte_start")?..byte("byte_end")?,
        ))
    };
    let spans = content["spans"].as_array();
    Some(CompileError {
        places: spans.into_iter().flatten().filter_map(place).collect(),
        text: content["rendered"].as_str().unwrap_or_default().to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_the_compiler_is_read_with_its_places() {
        let message = r#"{"reason":"compiler-message","message":{"level":"error","rendered":"error: no",
            "spans":[{"file_name":"src/a.rs","byte_start":3,"byte_end":9}]}}"#;
        let error = compile_error(&serde_json::from_str(message).unwrap()).unwrap();
        assert_eq!(error.places, [("src/a.rs".to_owned(), 3..9)]);
        let warning = message.replace("\"level\":\"error\"", "\"level\":\"warning\"");
        assert!(compile_error(&serde_json::from_str(&warning).unwrap()).is_none());
    }

    #[test]
    fn every_suite_belongs_to_a_package_that_is_built() {
        assert_eq!(
            packages(),
            [
                "-p",
                "etherpen",
                "-p",
                "etherpen-drives",
                "-p",
                "etherpen-ethercat",
                "-p",
                "etherpen-motion"
            ]
        );
    }
}
