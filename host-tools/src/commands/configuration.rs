//! `etherpen config show`: the values in effect, and the source of each.

use super::ports::OptionalPort;
use super::{ConfigArguments, print_json};
use crate::error::{ProgramError, code};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;

/// Options of `etherpen config`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand, Debug)]
enum Command {
    /// Print every value in force.
    ///
    /// Values come from the built-in IRB 340 and from a file that overrides it (--config, else ETHERPEN_CONFIG, else
    /// etherpen.toml in this folder). The port comes from --port, else ETHERPEN_PORT.
    Show(Show),
}

#[derive(clap::Args, Debug)]
struct Show {
    /// Print where each value comes from.
    #[arg(long)]
    origin: bool,
    /// Print the values as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    port: OptionalPort,
    #[command(flatten)]
    config: ConfigArguments,
}

/// A value and where it comes from.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct ConfigEntry {
    value: serde_json::Value,
    origin: String,
}

/// Runs the command.
///
/// # Errors
/// The configuration cannot be used.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let Command::Show(show) = &arguments.command;
    let entries = entries(show)?;
    if show.json {
        return match show.origin {
            true => print_json(&entries),
            false => print_json(
                &entries
                    .iter()
                    .map(|(key, entry)| (key, &entry.value))
                    .collect::<BTreeMap<_, _>>(),
            ),
        };
    }
    let mut out = std::io::stdout().lock();
    for (key, entry) in &entries {
        let line = match show.origin {
            true => format!("{key} = {}  # {}", entry.value, entry.origin),
            false => format!("{key} = {}", entry.value),
        };
        writeln!(out, "{line}").map_err(|cause| ProgramError::failed("stdout", cause))?;
    }
    Ok(())
}

fn entries(show: &Show) -> Result<BTreeMap<String, ConfigEntry>, ProgramError> {
    let config = show.config.load()?;
    let failed = |cause: &dyn std::fmt::Display| ProgramError::new(code::USAGE, format!("the configuration: {cause}"));
    let mut entries = BTreeMap::new();
    let built_in = "built-in";
    let values = serde_json::to_value(&config).map_err(|cause| failed(&cause))?;
    flatten(&values, "", &mut |key, value| {
        let (value, origin) = (value.clone(), built_in.to_owned());
        entries.insert(key, ConfigEntry { value, origin });
    });
    if let Some((path, how)) = show.config.file() {
        let text = std::fs::read_to_string(&path).map_err(|cause| failed(&cause))?;
        let written: serde_json::Value = toml::from_str(&text).map_err(|cause| failed(&cause))?;
        let origin = format!("{} ({how})", path.display());
        flatten(&written, "", &mut |key, _| {
            if let Some(entry) = entries.get_mut(&key) {
                entry.origin.clone_from(&origin);
            }
        });
    }
    let (value, origin) = match &show.port.port {
        Some(port) if show.port.is_from_environment() => (port.to_string().into(), "environment ETHERPEN_PORT"),
        Some(port) => (port.to_string().into(), "flag --port"),
        None => (serde_json::Value::Null, built_in),
    };
    let origin = origin.to_owned();
    entries.insert("port".into(), ConfigEntry { value, origin });
    Ok(entries)
}

/// Visits every value that is not a table; list indices count from 0, in brackets.
fn flatten(value: &serde_json::Value, key: &str, visit: &mut dyn FnMut(String, &serde_json::Value)) {
    match value {
        serde_json::Value::Object(table) => {
            for (name, value) in table {
                let key = if key.is_empty() {
                    name.clone()
                } else {
                    format!("{key}.{name}")
                };
                flatten(value, &key, visit);
            }
        }
        serde_json::Value::Array(list) => {
            for (index, value) in list.iter().enumerate() {
                flatten(value, &format!("{key}[{index}]"), visit);
            }
        }
        value => visit(key.to_owned(), value),
    }
}

/// The file of a configuration, and how it was given.
pub(super) fn named(flag: Option<&PathBuf>) -> Option<(PathBuf, &'static str)> {
    let default = PathBuf::from("etherpen.toml");
    let from_environment = std::env::var_os("ETHERPEN_CONFIG").map(PathBuf::from);
    match flag {
        Some(path) if from_environment.as_ref() == Some(path) => Some((path.clone(), "environment ETHERPEN_CONFIG")),
        Some(path) => Some((path.clone(), "flag --config")),
        None if default.exists() => Some((default, "file in this folder")),
        None => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn show(config: Option<PathBuf>) -> BTreeMap<String, ConfigEntry> {
        let show = Show {
            origin: true,
            json: false,
            port: OptionalPort {
                port: "tcp:127.0.0.1:1".parse().ok(),
            },
            config: ConfigArguments { config, machine: None },
        };
        entries(&show).unwrap()
    }

    #[test]
    fn every_value_says_where_it_comes_from() {
        let path = std::env::temp_dir().join(format!("etherpen-origin-{}.toml", std::process::id()));
        std::fs::write(&path, "[motion]\nspeed_mm_s = 123.0\n").unwrap();
        let entries = show(Some(path.clone()));
        std::fs::remove_file(&path).unwrap();
        let speed = &entries["motion.speed_mm_s"];
        assert_eq!(speed.value, serde_json::json!(123.0));
        assert!(speed.origin.contains("flag --config") && speed.origin.contains("etherpen-origin"));
        assert_eq!(entries["motion.travel_speed_mm_s"].origin, "built-in");
        assert_eq!(entries["axes[3].gear"].origin, "built-in");
        assert_eq!(entries["port"].origin, "flag --port");
    }
}
