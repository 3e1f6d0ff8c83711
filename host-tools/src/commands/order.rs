//! `etherpen order`: the lines of a vector file in an order that costs little drawing time.

use super::prepare::{artwork_of, unusable};
use super::source::TextArguments;
use super::{CommandError, code, print_json};
use crate::drawing::{
    Artwork, Drawing, DrawingError, Input, LayerStroke, OrderOptions, load_with, order, parse_length_mm, write_artwork,
};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Options of `etherpen order`.
///
/// Lines whose ends meet become one, the lines are sorted and turned round, and the order is improved; lifts come before
/// distance. Nothing is scaled, moved or left out, and the coordinates stay those of the file. Layers stay apart and in
/// their order. The result has never more lifts, and never a longer way with the pen up, than the file.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Vectors (SVG), or a CSV of strokes; - reads them from standard input.
    file: PathBuf,
    /// The SVG to write; - writes it to standard output.
    #[arg(short, long, value_name = "OUT.svg")]
    out: PathBuf,
    /// Print lifts, ways with the pen up before and after, and the time taken as JSON on stdout.
    #[arg(long)]
    json: bool,
    /// Close gaps up to this length between ends [default: 0.05mm].
    #[arg(long, value_name = "LENGTH", value_parser = parse_length_mm)]
    join: Option<f64>,
    /// Keep order and directions; only close gaps between a line and the next one.
    #[arg(long)]
    keep_order: bool,
    #[command(flatten)]
    text: TextArguments,
}

/// Gaps closed without being asked, mm: a tenth of a pen's width, so that the ink is the same.
const JOIN_MM: f64 = 0.05;

/// What the command prints. Distances are from the first line's start to the last one's end.
#[derive(Debug, Serialize)]
struct Answer {
    strokes: usize,
    lifts_before: usize,
    lifts_after: usize,
    pen_up_mm_before: f64,
    pen_up_mm_after: f64,
    pen_down_mm: f64,
    bridged_mm: f64,
    layers: usize,
    /// Reading, ordering and writing.
    seconds: f64,
    /// Ordering alone.
    order_seconds: f64,
}

/// Runs the command.
///
/// # Errors
/// The file cannot be used, or the result cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let begun = Instant::now();
    let artwork =
        match load_with(&arguments.file, &arguments.text.font()).map_err(|cause| unusable(&arguments.file, &cause))? {
            Input::Artwork(artwork) => artwork,
            Input::Drawing(drawing) => artwork_of(drawing),
            Input::Photograph(_) | Input::Path(_) => return Err(unusable(&arguments.file, &DrawingError::NoArtwork)),
        };
    artwork.warnings.iter().for_each(|text| eprintln!("etherpen: {text}"));
    let options = OrderOptions {
        join_gap_mm: arguments.join.unwrap_or(JOIN_MM),
        keep_order: arguments.keep_order,
    };
    let before = sequence(&artwork);
    let order_begun = Instant::now();
    let ordered = by_layers(&artwork, &options);
    let order_seconds = order_begun.elapsed().as_secs_f64();
    let after = sequence(&ordered);
    write_text(&arguments.out, &write_artwork(&ordered))?;
    let answer = Answer {
        strokes: after.strokes.len(),
        lifts_before: before.strokes.len(),
        lifts_after: after.strokes.len(),
        pen_up_mm_before: before.pen_up_mm(),
        pen_up_mm_after: after.pen_up_mm(),
        pen_down_mm: after.pen_down_mm(),
        bridged_mm: (after.pen_down_mm() - before.pen_down_mm()).max(0.0),
        layers: ordered.layers.len(),
        seconds: begun.elapsed().as_secs_f64(),
        order_seconds,
    };
    if arguments.json {
        return print_json(&answer);
    }
    eprintln!(
        "etherpen: {} lifts (before: {}), {:.0} mm with the pen up (before: {:.0} mm), {:.0} mm drawn, in {:.2} s",
        answer.lifts_after,
        answer.lifts_before,
        answer.pen_up_mm_after,
        answer.pen_up_mm_before,
        answer.pen_down_mm,
        answer.seconds
    );
    Ok(())
}

fn sequence(artwork: &Artwork) -> Drawing {
    Drawing {
        sheet_mm: artwork.page_mm.unwrap_or_default(),
        strokes: artwork.strokes.iter().map(|stroke| stroke.stroke.clone()).collect(),
    }
}

/// Each layer ordered, one after the other; as given where that would be longer.
fn by_layers(artwork: &Artwork, options: &OrderOptions) -> Artwork {
    let mut strokes: Vec<LayerStroke> = Vec::new();
    for layer in 0..artwork.layers.len() {
        let own = artwork.strokes.iter().filter(|stroke| stroke.layer == layer);
        let mut drawing = Drawing {
            sheet_mm: artwork.page_mm.unwrap_or_default(),
            strokes: own.map(|stroke| stroke.stroke.clone()).collect(),
        };
        order(&mut drawing, options);
        strokes.extend(drawing.strokes.into_iter().map(|stroke| LayerStroke { layer, stroke }));
    }
    let result = Artwork {
        strokes,
        ..artwork.clone()
    };
    if sequence(&result).pen_up_mm() > sequence(artwork).pen_up_mm() {
        return artwork.clone();
    }
    result
}

/// Writes a text to a file, or to standard output for `-`.
///
/// # Errors
/// It cannot be written.
pub(super) fn write_text(path: &Path, text: &str) -> Result<(), CommandError> {
    write_bytes(path, text.as_bytes())
}

/// Writes bytes to a file, or to standard output for `-`.
///
/// # Errors
/// It cannot be written.
pub(super) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), CommandError> {
    let written = if path.as_os_str() == "-" {
        std::io::Write::write_all(&mut std::io::stdout().lock(), bytes)
    } else {
        std::fs::write(path, bytes)
    };
    written.map_err(|cause| CommandError::new(code::FAILED, format!("{} cannot be written: {cause}", path.display())))
}
