//! `etherpen vectorize`: a photograph as the lines of an SVG.

use super::{ConfigArguments, print_json};
use crate::drawing::preparation::compose::{from_photograph, unusable};
use crate::drawing::preparation::source::SourceArguments;
use crate::drawing::preparation::variants::{Variant, contact_sheet, variants_of};
use crate::drawing::{DrawingError, Input, load, write_svg};
use crate::error::{ProgramError, code};
use crate::output_file::{refuse_input, write_bytes, write_text};
use crate::terminal::counted;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Options of `etherpen vectorize`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Photograph (PNG, JPEG, WebP); - reads it from standard input.
    photo: PathBuf,
    /// The SVG to write, of the sheet's size; - writes it to standard output.
    #[arg(short, long, value_name = "OUT.svg", required_unless_present = "contact_sheet")]
    out: Option<PathBuf>,
    /// Draw the photograph in this many ways: styles, crops and backgrounds; the first one is the one asked for. A window
    /// given by --crop stays.
    #[arg(long, value_name = "COUNT", requires = "contact_sheet", value_parser = clap::value_parser!(u8).range(1..=12))]
    variants: Option<u8>,
    /// The PNG with all variants side by side, each with its options [default: 6 variants].
    #[arg(long, value_name = "OUT.png")]
    contact_sheet: Option<PathBuf>,
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
    /// What the contact sheet shows, in its order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    variants: Vec<VariantAnswer>,
}

/// A variant on the contact sheet.
#[derive(Debug, Serialize)]
struct VariantAnswer {
    /// The options that draw this variant.
    options: String,
    strokes: usize,
    pen_down_mm: f64,
    pen_up_mm: f64,
}

/// Variants on a contact sheet without a number of them.
const VARIANTS: u8 = 6;

/// Runs the command.
///
/// # Errors
/// The photograph or an option cannot be used, or the result cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let begun = Instant::now();
    let inputs = arguments.source.inputs(&arguments.photo, arguments.config.path());
    for out in [&arguments.out, &arguments.contact_sheet].into_iter().flatten() {
        refuse_input(out, &inputs)?;
    }
    check_names(arguments)?;
    let config = arguments.config.load()?;
    let refused = |cause: DrawingError| unusable(&arguments.photo, &cause);
    let Input::Photograph(picture) = load(&arguments.photo).map_err(refused)? else {
        return Err(refused(DrawingError::NoPhotograph));
    };
    let source = &arguments.source;
    let made = from_photograph(picture.clone(), &config, source).map_err(refused)?;
    made.remarks.iter().for_each(|text| eprintln!("etherpen: {text}"));
    let ([_, _, width, height], drawing) = (made.place_mm, made.drawing);
    if let Some(out) = &arguments.out {
        write_text(
            out,
            &write_svg(&drawing.strokes, drawing.sheet_mm, source.pen_width_mm()),
        )?;
    }
    let mut variants = Vec::new();
    if let Some(out) = &arguments.contact_sheet {
        let count = usize::from(arguments.variants.unwrap_or(VARIANTS));
        let all = variants_of(&picture, &config, source, drawing.clone(), count).map_err(refused)?;
        write_bytes(out, &contact_sheet(&all, source.pen_width_mm()).map_err(refused)?)?;
        variants = all.iter().map(VariantAnswer::of).collect();
    }
    let answer = Answer {
        strokes: drawing.strokes.len(),
        pen_down_mm: drawing.pen_down_mm(),
        pen_up_mm: drawing.pen_up_mm(),
        size_mm: [width, height],
        seconds: begun.elapsed().as_secs_f64(),
        variants,
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
    for (k, variant) in answer.variants.iter().enumerate() {
        eprintln!(
            "etherpen: {}: {}, {}",
            k + 1,
            variant.options,
            counted(variant.strokes, "stroke")
        );
    }
    Ok(())
}

/// Refuses names of files that would be written twice, or with another format than their name says.
fn check_names(arguments: &Arguments) -> Result<(), ProgramError> {
    let Some(sheet) = &arguments.contact_sheet else {
        return Ok(());
    };
    let shown = sheet.display();
    let is_png = sheet.extension().is_some_and(|end| end.eq_ignore_ascii_case("png"));
    if !is_png && sheet.as_os_str() != "-" {
        let text = format!("--contact-sheet {shown}: it is a PNG; give it a name that ends in .png");
        return Err(ProgramError::new(code::USAGE, text));
    }
    let is_same = |out: &PathBuf| match (out.canonicalize(), sheet.canonicalize()) {
        (Ok(out), Ok(sheet)) => out == sheet,
        _ => out == sheet,
    };
    if arguments.out.as_ref().is_some_and(is_same) {
        let text = format!("-o and --contact-sheet are both {shown}; name two files");
        return Err(ProgramError::new(code::USAGE, text));
    }
    Ok(())
}

impl VariantAnswer {
    fn of(variant: &Variant) -> Self {
        Self {
            options: variant.options.clone(),
            strokes: variant.drawing.strokes.len(),
            pen_down_mm: variant.drawing.pen_down_mm(),
            pen_up_mm: variant.drawing.pen_up_mm(),
        }
    }
}
