//! Preparation: from a dropped file to a drawing that can be started: strokes, check, planned time.
//!
//! Invariant: the preview shows exactly the path that is sent to the firmware.

use super::jobs::PreparedDrawing;
use super::layers::PathLayer;
use super::page_text::for_page;
use crate::drawing::preparation::prepare::prepare_with;
use crate::drawing::preparation::source::SourceArguments;
use crate::drawing::preparation::wire::to_wire;
use crate::planning::planned_s;
use clap::{CommandFactory, Parser};
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use etherpen::motion::Pen;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Longest file name shown, characters.
const NAME_CHARS_MAX: usize = 80;
/// Makes the file names of a process unique.
static FILES: AtomicU32 = AtomicU32::new(0);

/// A preparation as shown on the page.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PreparationView {
    /// `idle`, `working`, `ready` or `failed`.
    pub state: &'static str,
    /// Number of the preparation.
    pub number: u64,
    /// The file.
    pub name: String,
    /// Why the preparation failed.
    pub error: String,
    /// Number of strokes.
    pub strokes: u32,
    /// Length drawn, mm.
    pub pen_down_mm: f64,
    /// Length of the travel moves, mm.
    pub pen_up_mm: f64,
    /// Names of the layers, in the order of drawing.
    pub layers: Vec<String>,
    /// Duration computed by the planner, s.
    pub planned_s: f64,
    /// Options requested.
    pub wishes: PageOptions,
}

impl PreparationView {
    /// A preparation in progress.
    pub fn working(number: u64, name: &str, wishes: &PageOptions) -> Self {
        Self {
            state: "working",
            number,
            name: name.to_owned(),
            wishes: wishes.clone(),
            ..Self::default()
        }
    }

    /// Result of a preparation of a file.
    pub fn of(result: &Result<PreparedDrawing, String>, number: u64, name: &str, wishes: &PageOptions) -> Self {
        let plain = Self::working(number, name, wishes);
        match result {
            Ok(drawing) => {
                let (pen_down_mm, pen_up_mm) = lengths_mm(&drawing.path);
                Self {
                    state: "ready",
                    strokes: drawing.strokes,
                    pen_down_mm,
                    pen_up_mm,
                    layers: drawing.layers.iter().map(|layer| layer.name.clone()).collect(),
                    planned_s: drawing.planned_s,
                    ..plain
                }
            }
            Err(error) => Self {
                state: "failed",
                error: error.clone(),
                ..plain
            },
        }
    }
}

/// Options of a preparation, parsed as on the command line.
#[derive(Parser, Debug)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Options {
    #[command(flatten)]
    source: SourceArguments,
}

/// Options of a drawing from the page; empty ones take their defaults.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct PageOptions {
    /// Style in which a photograph is drawn.
    pub style: String,
    /// Largest size on the sheet, with its unit.
    pub size: String,
    /// Longest drawing time, with its unit.
    pub max_time: String,
}

impl PageOptions {
    /// Parses the page's options, JSON; an empty text means defaults.
    ///
    /// # Errors
    /// The text is not valid JSON of these options.
    pub fn parse(text: &str) -> Result<Self, String> {
        match text {
            "" => Ok(Self::default()),
            text => serde_json::from_str(text).map_err(|cause| format!("the wishes cannot be read: {cause}")),
        }
    }
}

/// Options of the command line with their names on the page.
const PAGE_NAMES: [(&str, &str); 3] = [
    ("--style", "style"),
    ("--size", "size"),
    ("--max-time", "the longest time"),
];

/// Styles available for photographs.
pub fn styles() -> Vec<String> {
    let command = Options::command();
    let style = command.get_arguments().find(|argument| argument.get_id() == "style");
    style.map_or_else(Vec::new, |argument| {
        let values = argument.get_possible_values();
        values.iter().map(|value| value.get_name().to_owned()).collect()
    })
}

fn options(wishes: &PageOptions) -> Result<SourceArguments, String> {
    let values = [&wishes.style, &wishes.size, &wishes.max_time];
    let mut options = SourceArguments::default();
    let mut words = Vec::new();
    for ((option, name), value) in PAGE_NAMES.into_iter().zip(values) {
        if value.is_empty() {
            continue;
        }
        words.push(format!("{option}={value}"));
        // Parsed one at a time, so that an error belongs to this option.
        options = match Options::try_parse_from(&words) {
            Ok(parsed) => parsed.source,
            Err(error) => return Err(format!("{name}: {}", why(&error))),
        };
    }
    if words.is_empty() {
        options = Options::try_parse_from(words).map_err(|error| why(&error))?.source;
    }
    Ok(options)
}

/// The reason of a command line error, without references to options.
fn why(error: &clap::Error) -> String {
    let text = error.to_string();
    let first = text.lines().next().unwrap_or_default();
    let plain = first.strip_prefix("error: ").unwrap_or(first);
    match (plain.split_once(" for '--"), plain.rsplit_once("': ")) {
        (Some((what, _)), Some((_, reason))) => format!("{what}: {reason}"),
        (Some((what, _)), None) => what.to_owned(),
        _ => plain.to_owned(),
    }
}

/// A message of the preparation, worded for the page.
fn told(message: &str) -> String {
    let mut told = for_page(message);
    if message.contains("--size") {
        told.push_str("; give a size that fits");
    }
    told
}

/// A file at a unique path that is removed when dropped.
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

/// A name for display: one line, limited length.
pub fn shown_name(name: &str) -> String {
    let plain = name.chars().filter(|character| !character.is_control());
    let name: String = plain.take(NAME_CHARS_MAX).collect();
    if name.is_empty() { "drawing".to_owned() } else { name }
}

/// Converts a file's content into a drawing.
///
/// # Errors
/// Why it cannot be drawn, as text for display.
pub fn compose(config: &Config, name: &str, wishes: &PageOptions, content: &[u8]) -> Result<PreparedDrawing, String> {
    let name = shown_name(name);
    let options = options(wishes)?;
    let file = Dropped::write(&name, content).map_err(|cause| format!("{name} cannot be stored: {cause}"))?;
    let stored = file.0.display().to_string();
    let prepared =
        prepare_with(&file.0, config, &options).map_err(|error| told(&error.message.replace(&stored, &name)))?;
    let path: Vec<PathVertex> = prepared.path.iter().map(to_wire).collect();
    Ok(PreparedDrawing {
        name,
        strokes: path.iter().map(|vertex| vertex.stroke + 1).max().unwrap_or(0),
        path: path.into(),
        layers: prepared
            .layers
            .into_iter()
            .map(|(name, end)| PathLayer { name, end })
            .collect(),
        planned_s: planned_s(config, &prepared.path),
    })
}

/// Length drawn and length of the travel moves of a path, mm.
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
        let drawing = compose(&Config::default(), "strokes.csv", &PageOptions::default(), &content).unwrap();
        assert!(drawing.strokes > 0 && drawing.planned_s > 0.0);
        let (down_mm, up_mm) = lengths_mm(&drawing.path);
        assert!(down_mm > 10.0 && up_mm > 0.0);
    }

    #[test]
    fn what_is_no_picture_is_refused_by_the_name_it_was_dropped_with() {
        let error = compose(
            &Config::default(),
            "holiday\n.png",
            &PageOptions::default(),
            b"no picture",
        )
        .unwrap_err();
        assert!(
            error.contains("holiday.png") && !error.contains("etherpen-drop"),
            "{error}"
        );
    }

    #[test]
    fn wishes_are_read_as_on_the_command_line_and_errors_name_the_pages_fields() {
        let wishes = |style: &str, size: &str, max_time: &str| PageOptions {
            style: style.to_owned(),
            size: size.to_owned(),
            max_time: max_time.to_owned(),
        };
        assert!(options(&wishes("hatch", "90mm", "2m")).is_ok());
        assert!(options(&PageOptions::default()).is_ok());
        for (wrong, field) in [
            (wishes("", "ninety", ""), "size: "),
            (wishes("watercolour", "90mm", ""), "style: "),
            (wishes("hatch", "", "soon"), "the longest time: "),
        ] {
            let error = options(&wrong).unwrap_err();
            println!("{error}");
            assert!(error.starts_with(field) && !error.contains("--"), "{error}");
        }
        assert!(PageOptions::parse(r#"{"colour": "red"}"#).is_err() && PageOptions::parse("{").is_err());
        assert_eq!(PageOptions::parse(""), Ok(PageOptions::default()));
    }

    #[test]
    fn a_drawing_that_leaves_the_sheet_is_refused_in_the_pages_words() {
        let rows = b"x_mm,y_mm,pen\n10,10,0\n9000,10,1\n";
        let error = compose(&Config::default(), "wide.csv", &PageOptions::default(), rows).unwrap_err();
        assert!(error.contains("wide.csv") && !error.contains("--"), "{error}");
    }
}
