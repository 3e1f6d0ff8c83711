//! Benchmarks of drawings: the vectoriser on photographs, portraits beside those of other programs, the order of strokes
//! compared with vpype's, and the style of one line with LKH's tours.

mod judge;
mod line;
mod order;
mod peers;
mod photographs;
mod portraits;
mod scores;

use super::{BenchError, BenchReport, BenchRow, Selection};
use crate::drawing::{
    Drawing, Input, VectorizeOptions, edge_coverage, load, render_rgb, tone_correlation, vectorize_image,
};
use crate::setup;
use image::{RgbImage, imageops};
use std::path::PathBuf;
use std::time::Instant;

/// The photographs.
const PHOTOGRAPHS: [&str; 2] = ["astronaut.png", "camera.png"];
/// Runs of which the fastest counts.
const RUNS: usize = 3;
/// linedraw's tone on portraits of this size is 0.83 to 0.94.
const TONE_MIN: f64 = 0.83;
/// A photograph of a megapixel may take about a second; any photograph may take this long.
const SECONDS_PER_MEGAPIXEL: f64 = 1.0;
const SECONDS_MIN: f64 = 1.0;
/// Line width of the pen and scale of the compared drawing.
const PEN_MM: f64 = 0.5;
const PX_PER_MM: f64 = 5.0;

fn failed(program: &str, cause: impl std::fmt::Display) -> BenchError {
    BenchError::Program {
        program: program.to_owned(),
        cause: cause.to_string(),
    }
}

/// Parts of this benchmark that take long.
#[derive(Clone, Debug, Default)]
pub struct DrawingPlan {
    /// No portraits and no tours of LKH.
    pub quick: bool,
    /// The PNG with all portraits to write.
    pub contact_sheet: Option<PathBuf>,
}

/// Runs the selected benchmarks; `progress` gets a description of each step.
///
/// # Errors
/// A sample cannot be read; vpype, the judge of portraits or another program cannot be set up or fails.
pub fn run(selection: &Selection, plan: &DrawingPlan, progress: impl Fn(&str)) -> Result<BenchReport, BenchError> {
    let mut rows = Vec::new();
    for file in PHOTOGRAPHS {
        if wants(selection, file, &["lifts", "seconds", "tone", "edges"], "etherpen") {
            progress(&format!("vectorising {file}"));
            photograph(file, &mut rows)?;
        }
    }
    order::run(selection, &progress, &mut rows)?;
    if !plan.quick {
        line::run(selection, &progress, &mut rows)?;
        portraits::run(selection, plan.contact_sheet.as_deref(), &progress, &mut rows)?;
    }
    rows.retain(|row: &BenchRow| selection.wants(&row.case, row.subject));
    Ok(BenchReport { bench: "drawing", rows })
}

/// Whether one of the figures `names` of a file is selected.
fn wants(selection: &Selection, file: &str, names: &[&str], subject: &str) -> bool {
    names
        .iter()
        .any(|name| selection.wants(&format!("{name}/{file}"), subject))
}

fn sample(file: &str) -> PathBuf {
    let folder = setup::workspace().join("samples");
    if file.ends_with(".svg") {
        folder.join("vectors").join(file)
    } else {
        folder.join(file)
    }
}

fn photograph(file: &str, rows: &mut Vec<BenchRow>) -> Result<(), BenchError> {
    let Input::Photograph(picture) = load(sample(file)).map_err(|cause| failed(file, cause))? else {
        return Err(failed(file, "this is no photograph"));
    };
    let options = VectorizeOptions::default();
    let (mut seconds, mut drawing) = (f64::INFINITY, Drawing::default());
    for _ in 0..RUNS {
        let begun = Instant::now();
        drawing = vectorize_image(&picture, &options).map_err(|cause| failed(file, cause))?;
        seconds = seconds.min(begun.elapsed().as_secs_f64());
    }
    let megapixels = f64::from(picture.width()) * f64::from(picture.height()) / 1e6;
    let rendered = rendered(&picture, &drawing, &options).map_err(|cause| failed(file, cause))?;
    let figures = [
        ("lifts", drawing.strokes.len() as f64, "lifts", None),
        ("pen_up_mm", drawing.pen_up_mm(), "mm", None),
        (
            "seconds",
            seconds,
            "s",
            Some((SECONDS_PER_MEGAPIXEL * megapixels).max(SECONDS_MIN)),
        ),
        (
            "tone",
            tone_correlation(&picture, &rendered),
            "correlation",
            Some(TONE_MIN),
        ),
        ("edges", edge_coverage(&picture, &rendered), "share", None),
    ];
    rows.extend(figures.map(|(name, value, unit, target)| BenchRow {
        case: format!("{name}/{file}"),
        subject: "etherpen",
        value,
        unit,
        target,
    }));
    Ok(())
}

/// The drawing as an image of the photograph's part of the sheet.
fn rendered(
    picture: &RgbImage,
    drawing: &Drawing,
    options: &VectorizeOptions,
) -> Result<RgbImage, crate::drawing::DrawingError> {
    let place_mm = options.picture_mm(picture.width(), picture.height())?;
    let whole = render_rgb(&drawing.strokes, drawing.sheet_mm, PEN_MM, PX_PER_MM);
    let [left, top, width, height] = place_mm.map(|mm| (mm * PX_PER_MM).round() as u32);
    Ok(imageops::crop_imm(&whole, left, top, width, height).to_image())
}
