//! From a dropped file to a drawing that can be started: strokes, check, planned time.
//!
//! Invariant: what is shown is what is drawn: the preview is the very path that travels to the firmware.

use super::jobs::Drawing;
use crate::commands::prepare::{planned_s, prepare_with, to_wire};
use crate::commands::source::SourceArguments;
use clap::{CommandFactory, Parser};
use etherpen::config::Config;
use etherpen::link::protocol::PathVertex;
use etherpen::motion::Pen;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Longest name of a file that is shown.
const NAME_CHARS_MAX: usize = 80;
/// Makes the names of the files of one process different.
static FILES: AtomicU32 = AtomicU32::new(0);

/// What the page shows of a preparation.
#[derive(Clone, Debug, Default, Serialize)]
pub struct StudioView {
    /// `idle`, `working`, `ready` or `failed`.
    pub state: &'static str,
    /// Number of the preparation.
    pub number: u64,
    /// The file.
    pub name: String,
    /// Why it failed.
    pub error: String,
    /// Strokes.
    pub strokes: u32,
    /// Length drawn, mm.
    pub pen_down_mm: f64,
    /// Length travelled, mm.
    pub pen_up_mm: f64,
    /// Duration that the planner computed, s.
    pub planned_s: f64,
}

impl StudioView {
    /// How a preparation of a file ended.
    pub fn of(result: &Result<Drawing, String>, number: u64, name: &str) -> Self {
        match result {
            Ok(drawing) => {
                let (pen_down_mm, pen_up_mm) = lengths_mm(&drawing.path);
                Self {
                    state: "ready",
                    number,
                    name: drawing.name.clone(),
                    error: String::new(),
                    strokes: drawing.strokes,
                    pen_down_mm,
                    pen_up_mm,
                    planned_s: drawing.planned_s,
                }
            }
            Err(error) => Self {
                state: "failed",
                number,
                name: shown_name(name),
                error: error.clone(),
                ..Self::default()
            },
        }
    }
}

/// The options of a preparation, read as on the command line.
#[derive(Parser, Debug)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Options {
    #[command(flatten)]
    source: SourceArguments,
}

/// What the page asks for; empty values are left to the program.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Wishes {
    style: String,
    size: String,
    max_time: String,
}

/// Styles in which a photograph can be drawn.
pub fn styles() -> Vec<String> {
    let command = Options::command();
    let style = command.get_arguments().find(|argument| argument.get_id() == "style");
    style.map_or_else(Vec::new, |argument| {
        let values = argument.get_possible_values();
        values.iter().map(|value| value.get_name().to_owned()).collect()
    })
}

fn options(wishes: &str) -> Result<SourceArguments, String> {
    let wishes: Wishes = match wishes {
        "" => Wishes::default(),
        wishes => serde_json::from_str(wishes).map_err(|cause| format!("the options cannot be read: {cause}"))?,
    };
    let named = [
        ("--style", wishes.style),
        ("--size", wishes.size),
        ("--max-time", wishes.max_time),
    ];
    let words = named
        .iter()
        .filter(|(_, value)| !value.is_empty())
        .map(|(name, value)| format!("{name}={value}"));
    let parsed = Options::try_parse_from(words).map_err(|error| {
        let text = error.to_string();
        text.lines().next().unwrap_or_default().to_owned()
    });
    parsed.map(|options| options.source)
}

/// A file in a place of its own that is removed.
struct Dropped(PathBuf);

impl Dropped {
    fn write(name: &str, content: &[u8]) -> std::io::Result<Self> {
        let number = FILES.fetch_add(1, Ordering::Relaxed);
        let known = ["png", "jpg", "jpeg", "svg", "csv", "gcode", "nc", "hpgl", "plt"];
        let extension = Path::new(name)
            .extension()
            .and_then(|extension| extension.to_str())
            .map(str::to_ascii_lowercase)
            .filter(|extension| known.contains(&extension.as_str()))
            .unwrap_or_else(|| "dat".to_owned());
        let file = format!("etherpen-drop-{}-{number}.{extension}", std::process::id());
        let path = std::env::temp_dir().join(file);
        std::fs::write(&path, content)?;
        Ok(Self(path))
    }
}

impl Drop for Dropped {
    fn drop(&mut self) {
        // A file that cannot be removed is left to the system.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A name as it may be shown: one line, not too long.
pub fn shown_name(name: &str) -> String {
    let plain = name.chars().filter(|character| !character.is_control());
    let name: String = plain.take(NAME_CHARS_MAX).collect();
    if name.is_empty() { "drawing".to_owned() } else { name }
}

/// Makes a drawing of a file's content.
///
/// # Errors
/// Why it cannot be drawn, as a person reads it.
pub fn compose(config: &Config, name: &str, wishes: &str, content: &[u8]) -> Result<Drawing, String> {
    let name = shown_name(name);
    let options = options(wishes)?;
    let file = Dropped::write(&name, content).map_err(|cause| format!("{name} cannot be stored: {cause}"))?;
    let stored = file.0.display().to_string();
    let prepared = prepare_with(&file.0, config, &options).map_err(|error| error.message.replace(&stored, &name))?;
    let path: Vec<PathVertex> = prepared.path.iter().map(to_wire).collect();
    Ok(Drawing {
        name,
        strokes: path.iter().map(|vertex| vertex.stroke + 1).max().unwrap_or(0),
        path: path.into(),
        planned_s: planned_s(config, &prepared.path),
    })
}

/// Lengths of a path, drawn and travelled, mm.
pub fn lengths_mm(path: &[PathVertex]) -> (f64, f64) {
    let mut lengths = (0.0, 0.0);
    for (from, to) in path.iter().zip(path.iter().skip(1)) {
        let squares = from.position_um.iter().zip(&to.position_um).map(|(from, to)| {
            let mm = f64::from(to.wrapping_sub(*from)) / 1_000.0;
            mm * mm
        });
        let length_mm = squares.sum::<f64>().sqrt();
        match to.pen {
            Pen::Down => lengths.0 += length_mm,
            Pen::Up => lengths.1 += length_mm,
        }
    }
    lengths
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dropped_list_of_coordinates_becomes_a_drawing_and_its_file_goes() {
        let file = crate::setup::workspace().join("samples/strokes.csv");
        let content = std::fs::read(file).unwrap();
        let drawing = compose(&Config::default(), "strokes.csv", "", &content).unwrap();
        assert!(drawing.strokes > 0 && drawing.planned_s > 0.0);
        let (down_mm, up_mm) = lengths_mm(&drawing.path);
        assert!(down_mm > 10.0 && up_mm > 0.0);
    }

    #[test]
    fn what_is_no_picture_is_refused_by_the_name_it_was_dropped_with() {
        let error = compose(&Config::default(), "holiday\n.png", "", b"no picture").unwrap_err();
        assert!(
            error.contains("holiday.png") && !error.contains("etherpen-drop"),
            "{error}"
        );
    }

    #[test]
    fn options_are_those_of_the_command_line_and_errors_name_them() {
        assert!(options(r#"{"size": "90mm", "max_time": "2m"}"#).is_ok());
        assert!(options(r#"{"size": "ninety"}"#).unwrap_err().contains("--size"));
        assert!(options(r#"{"colour": "red"}"#).is_err() && options("{").is_err());
    }
}
