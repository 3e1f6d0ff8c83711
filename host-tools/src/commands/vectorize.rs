//! `etherpen vectorize`: a photograph as the lines of an SVG.

use super::{ConfigArguments, print_json};
use crate::drawing::preparation::compose::{from_photograph, unusable};
use crate::drawing::preparation::source::SourceArguments;
use crate::drawing::{DrawingError, Input, load, write_svg};
use crate::error::ProgramError;
use crate::output_file::{refuse_input, write_text};
use crate::terminal::counted;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Options of `etherpen vectorize`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Photograph (PNG, JPEG); - reads it from standard input.
    photo: PathBuf,
    /// The SVG to write, of the sheet's size; - writes it to standard output.
    #[arg(short, long, value_name = "OUT.svg")]
    out: PathBuf,
    /// Print strokes, their length and the computing time as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
    #[command(flatten)]
    source: SourceArguments,
}

/// What the command prints.
#[derive(Debug, Serialize)]
struct Answer {
    strokes: usize,
    pen_down_mm: f64,
    pen_up_mm: f64,
    /// Width and height of the picture on the sheet, mm.
    size_mm: [f64; 2],
    /// Time to read, vectorise and write, s.
    seconds: f64,
}

/// Runs the command.
///
/// # Errors
/// The photograph or an option cannot be used, or the result cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let begun = Instant::now();
    refuse_input(
        &arguments.out,
        &arguments.source.inputs(&arguments.photo, arguments.config.path()),
    )?;
    let config = arguments.config.load()?;
    let refused = |cause: DrawingError| unusable(&arguments.photo, &cause);
    let Input::Photograph(picture) = load(&arguments.photo).map_err(refused)? else {
        return Err(refused(DrawingError::NoPhotograph));
    };
    let made = from_photograph(picture, &config, &arguments.source).map_err(refused)?;
    let ([_, _, width, height], drawing) = (made.place_mm, made.drawing);
    let svg = write_svg(&drawing.strokes, drawing.sheet_mm, arguments.source.pen_width_mm());
    write_text(&arguments.out, &svg)?;
    let answer = Answer {
        strokes: drawing.strokes.len(),
        pen_down_mm: drawing.pen_down_mm(),
        pen_up_mm: drawing.pen_up_mm(),
        size_mm: [width, height],
        seconds: begun.elapsed().as_secs_f64(),
    };
    if arguments.json {
        return print_json(&answer);
    }
    eprintln!(
        "etherpen: {}, {:.0} mm drawn and {:.0} mm with the pen up, {width:.1} x {height:.1} mm, in {:.2} s",
        counted(answer.strokes, "stroke"),
        answer.pen_down_mm,
        answer.pen_up_mm,
        answer.seconds
    );
    Ok(())
}
