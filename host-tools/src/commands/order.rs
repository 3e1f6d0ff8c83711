//! `etherpen order`: puts the lines of a vector file into an order with little drawing time.

use super::{ConfigArguments, print_json};
use crate::drawing::preparation::choose_order::choose_order;
use crate::drawing::preparation::compose::{artwork_of, unusable};
use crate::drawing::preparation::source::TextArguments;
use crate::drawing::{DrawingError, Input, OrderOptions, Travel, load_with, parse_length_mm, write_artwork};
use crate::error::ProgramError;
use crate::output_file::{refuse_input, write_text};
use crate::terminal::counted;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Options of `etherpen order`.
///
/// Lines whose ends meet are joined, lines are sorted and reversed, and the order is improved; fewer lifts take
/// precedence over shorter travel. Nothing is scaled, moved or left out, and the coordinates stay those of the file.
/// Layers stay separate and in their order. The result never has more lifts, longer travel moves or a longer drawing
/// time by the firmware's planner than the file. The drawing time is that of the page in the middle of the configured
/// paper; a page on which the robot cannot draw has none.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Vectors (SVG), or a CSV of strokes; - reads them from standard input.
    file: PathBuf,
    /// The SVG to write; - writes it to standard output.
    #[arg(short, long, value_name = "OUT.svg")]
    out: PathBuf,
    /// Print lifts, travel moves before and after, and the computing time as JSON on stdout.
    #[arg(long)]
    json: bool,
    /// Close gaps up to this length between ends [default: 0.05mm].
    #[arg(long, value_name = "LENGTH", value_parser = parse_length_mm)]
    join: Option<f64>,
    /// Keep order and directions; only close gaps between a line and the next one.
    #[arg(long)]
    keep_order: bool,
    #[command(flatten)]
    config: ConfigArguments,
    #[command(flatten)]
    text: TextArguments,
}

/// Default gap closed, mm: a tenth of a pen's width, so that the ink does not change.
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
    /// Planned drawing time, s, of the file's order approximate above two hours; `None` if the robot cannot draw the
    /// page.
    drawing_s_before: Option<f64>,
    drawing_s_after: Option<f64>,
    bridged_mm: f64,
    layers: usize,
    /// Time to read, order and write, s.
    seconds: f64,
    /// Time to order, including the planner's checks, s.
    order_seconds: f64,
}

/// Runs the command.
///
/// # Errors
/// The file cannot be used, or the result cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let begun = Instant::now();
    refuse_input(
        &arguments.out,
        &arguments.text.inputs(&arguments.file, arguments.config.path()),
    )?;
    let config = arguments.config.load()?;
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
        travel: Travel::of(&config),
    };
    let before = artwork.in_sequence();
    let order_begun = Instant::now();
    let chosen = choose_order(&artwork.by_layers(), &before, &options, &config);
    let order_seconds = order_begun.elapsed().as_secs_f64();
    let ordered = match chosen.layers {
        Some(layers) => artwork.with_strokes(layers),
        None => artwork,
    };
    let after = ordered.in_sequence();
    write_text(&arguments.out, &write_artwork(&ordered))?;
    let answer = Answer {
        strokes: after.strokes.len(),
        lifts_before: before.strokes.len(),
        lifts_after: after.strokes.len(),
        pen_up_mm_before: before.pen_up_mm(),
        pen_up_mm_after: after.pen_up_mm(),
        pen_down_mm: after.pen_down_mm(),
        drawing_s_before: chosen.given_s,
        drawing_s_after: chosen.chosen_s,
        bridged_mm: (after.pen_down_mm() - before.pen_down_mm()).max(0.0),
        layers: ordered.layers.len(),
        seconds: begun.elapsed().as_secs_f64(),
        order_seconds,
    };
    if arguments.json {
        return print_json(&answer);
    }
    let time = |seconds: Option<f64>| seconds.map_or("no time".to_owned(), |seconds| format!("{seconds:.1} s"));
    eprintln!(
        "etherpen: {} (before: {}), {:.0} mm with the pen up (before: {:.0} mm), {:.0} mm drawn, {} to draw (before: \
         {}); done in {:.2} s",
        counted(answer.lifts_after, "lift"),
        answer.lifts_before,
        answer.pen_up_mm_after,
        answer.pen_up_mm_before,
        answer.pen_down_mm,
        time(answer.drawing_s_after),
        time(answer.drawing_s_before),
        answer.seconds
    );
    Ok(())
}
