//! Preparation: from a dropped file to a drawing that can be started: strokes, check, planned time.
//!
//! Invariant: the preview shows exactly the path that is sent to the firmware.

use super::jobs::PreparedDrawing;
use super::layers::PathLayer;
use super::page_text::for_page;
use crate::drawing::PHOTOGRAPH_SIDE_MIN_PX;
use crate::drawing::preparation::overview::{Overview, PhotographPart};
use crate::drawing::preparation::prepare::prepare_with;
use crate::drawing::preparation::source::SourceArguments;
use crate::drawing::preparation::wire::to_wire;
use crate::planning::planned_s;
use axum::body::Bytes;
use clap::{CommandFactory, Parser};
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use etherpen::motion::Pen;
use image::ImageFormat;
use serde::{Deserialize, Serialize};
use std::io::Cursor;
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
    /// Options requested, with the defaults of style, crop and background; `None` if they cannot be read.
    pub explicit: Option<PageOptions>,
    /// The photograph, and the part of it that was last drawn; `None` until it is known, and for other files.
    pub photograph: Option<PhotographView>,
}

/// A photograph as shown on the page.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PhotographView {
    /// Number of its picture.
    pub number: u64,
    /// The part that is drawn.
    #[serde(flatten)]
    pub part: PhotographPart,
    /// Least width and height of a part, pixels.
    pub side_min_px: u32,
}

impl PhotographView {
    /// A photograph whose picture has this number.
    pub fn new(number: u64, part: PhotographPart) -> Self {
        Self {
            number,
            part,
            side_min_px: PHOTOGRAPH_SIDE_MIN_PX,
        }
    }
}

impl PreparationView {
    /// No preparation.
    pub fn idle() -> Self {
        Self {
            state: "idle",
            ..Self::default()
        }
    }

    /// A preparation in progress.
    pub fn working(number: u64, name: &str, wishes: &PageOptions, photograph: Option<PhotographView>) -> Self {
        Self {
            state: "working",
            number,
            name: name.to_owned(),
            wishes: wishes.clone(),
            explicit: wishes.explicit().ok(),
            photograph,
            ..Self::default()
        }
    }

    /// This preparation when it has ended.
    pub fn ended(self, result: Result<&PreparedDrawing, &String>) -> Self {
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
                    ..self
                }
            }
            Err(error) => Self {
                state: "failed",
                error: error.clone(),
                ..self
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
    /// Part of a photograph that is drawn: `auto`, `head`, `subject`, `none`, or `X,Y,W,H` in pixels.
    pub crop: String,
    /// What is drawn of a photograph's background.
    pub background: String,
    /// Centre and radius of the face in a photograph, `X,Y,R` in pixels.
    pub focus: String,
}

impl PageOptions {
    /// These options with the defaults of style, crop and background.
    ///
    /// # Errors
    /// An option cannot be read.
    pub fn explicit(&self) -> Result<Self, String> {
        let [style, crop, background] = options(self)?.look().map(str::to_owned);
        Ok(Self {
            style,
            crop,
            background,
            ..self.clone()
        })
    }

    /// These options with another style, crop and background.
    pub fn varied([style, crop, background]: [String; 3], rest: &Self) -> Self {
        Self {
            style,
            crop,
            background,
            ..rest.clone()
        }
    }

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
const PAGE_NAMES: [(&str, &str); 6] = [
    ("--style", "style"),
    ("--size", "size"),
    ("--max-time", "the longest time"),
    ("--crop", "the part"),
    ("--background", "the background"),
    ("--focus", "the face"),
];

/// Names that an option takes, for instance the styles of photographs.
pub fn choices_of(option: &str) -> Vec<String> {
    let command = Options::command();
    let found = command.get_arguments().find(|argument| argument.get_id() == option);
    found.map_or_else(Vec::new, |argument| {
        let values = argument.get_possible_values();
        values.iter().map(|value| value.get_name().to_owned()).collect()
    })
}

fn options(wishes: &PageOptions) -> Result<SourceArguments, String> {
    let values = [
        &wishes.style,
        &wishes.size,
        &wishes.max_time,
        &wishes.crop,
        &wishes.background,
        &wishes.focus,
    ];
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
        let known = ["png", "jpg", "jpeg", "webp", "svg", "csv", "gcode", "nc", "hpgl", "plt"];
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

/// A file's drawing, and the photograph that it shows.
#[derive(Clone, Debug)]
pub struct Made {
    /// The drawing.
    pub drawing: PreparedDrawing,
    /// The part of the photograph that is drawn, and a small copy of the whole as a JPEG; `None` for other files.
    pub photograph: Option<(PhotographPart, Bytes)>,
}

/// A small copy of a photograph for the page.
fn for_display(overview: &Overview) -> Option<(PhotographPart, Bytes)> {
    let mut jpeg = Cursor::new(Vec::new());
    overview.small.write_to(&mut jpeg, ImageFormat::Jpeg).ok()?;
    Some((overview.part, jpeg.into_inner().into()))
}

/// Converts a file's content into a drawing.
///
/// # Errors
/// Why it cannot be drawn, as text for display.
pub fn compose(config: &Config, name: &str, wishes: &PageOptions, content: &[u8]) -> Result<Made, String> {
    let name = shown_name(name);
    let options = options(wishes)?;
    let file = Dropped::write(&name, content).map_err(|cause| format!("{name} cannot be stored: {cause}"))?;
    let stored = file.0.display().to_string();
    let prepared =
        prepare_with(&file.0, config, &options).map_err(|error| told(&error.message.replace(&stored, &name)))?;
    let path: Vec<PathVertex> = prepared.path.iter().map(to_wire).collect();
    let drawing = PreparedDrawing {
        name,
        strokes: path.iter().map(|vertex| vertex.stroke + 1).max().unwrap_or(0),
        path: path.into(),
        layers: prepared
            .layers
            .into_iter()
            .map(|(name, end)| PathLayer { name, end })
            .collect(),
        planned_s: planned_s(config, &prepared.path),
    };
    Ok(Made {
        drawing,
        photograph: prepared.overview.as_ref().and_then(for_display),
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
        let made = compose(&Config::default(), "strokes.csv", &PageOptions::default(), &content).unwrap();
        let drawing = made.drawing;
        assert!(made.photograph.is_none());
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
        let wishes = |text: &str| PageOptions::parse(text).unwrap();
        let all =
            r#"{"style":"hatch","size":"90mm","max_time":"2m","crop":"head","background":"keep","focus":"9,9,5"}"#;
        assert_eq!(options(&wishes(all)).unwrap().look(), ["hatch", "head", "keep"]);
        let plain = PageOptions::default().explicit().unwrap();
        assert_eq!(
            [&*plain.style, &*plain.crop, &*plain.background],
            ["sketch", "auto", "fade"]
        );
        assert_eq!((&*plain.size, &*plain.focus), ("", ""));
        for (wrong, field) in [
            (r#"{"size":"ninety"}"#, "size: "),
            (r#"{"style":"watercolour","size":"90mm"}"#, "style: "),
            (r#"{"style":"hatch","max_time":"soon"}"#, "the longest time: "),
            (r#"{"crop":"feet"}"#, "the part: "),
            (r#"{"crop":"NaN,0,10,10"}"#, "the part: "),
            (r#"{"crop":"0,0,1e999,10"}"#, "the part: "),
            (r#"{"crop":"0,0,-5,10"}"#, "the part: "),
            (r#"{"crop":"0,0,10"}"#, "the part: "),
            (r#"{"background":"blur"}"#, "the background: "),
            (r#"{"focus":"inf,0,10"}"#, "the face: "),
            (r#"{"crop":"head","focus":"1,2,0"}"#, "the face: "),
        ] {
            let error = options(&wishes(wrong)).unwrap_err();
            println!("{error}");
            assert!(error.starts_with(field) && !error.contains("--"), "{error}");
            assert!(wishes(wrong).explicit().is_err());
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
