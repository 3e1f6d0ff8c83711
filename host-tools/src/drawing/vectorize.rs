//! From a photograph to strokes: lines where the picture has edges, hatching where it is dark.
//!
//! The picture is scaled to two pixels for each pen width, so that every number below is a length on paper. Lines come
//! first; hatching adds only the missing tone; the ink is scaled so that the drawing meets the time limit. The face
//! ([`super::focus`]) gets finer lines, shorter strokes and more contrast.

use super::background::Background;
use super::photo::check_size;
use super::styles::Style;
use super::subject::Subject;
use super::{Drawing, DrawingError, Input, Stroke, load};
use image::RgbImage;
use std::path::Path;

mod fill;
mod frame;
mod graded;
mod lines;
mod panels;
mod silhouette;
mod study;

use frame::Frame;
pub(crate) use graded::{in_faces, vectorize_coarser};
pub(crate) use panels::panels;
use study::Study;

/// Mean speeds and times of the robot for the estimate.
const DRAW_MM_S: f64 = 350.0;
const TRAVEL_MM_S: f64 = 800.0;
const LIFT_S: f64 = 0.12;

/// Options for converting a photograph into strokes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VectorizeOptions {
    /// Width and height of the sheet, mm.
    pub sheet_mm: [f64; 2],
    /// White border on all sides, mm; the picture keeps its aspect ratio and is centred.
    pub margin_mm: f64,
    /// Largest width and height of the picture, mm; `None`: the sheet inside its margin.
    pub size_mm: Option<[f64; 2]>,
    /// Position of the picture's upper left corner on the sheet, mm; `None`: the picture is centred.
    pub origin_mm: Option<[f64; 2]>,
    /// Line width of the pen, mm.
    pub pen_width_mm: f64,
    /// Style of the drawing.
    pub style: Style,
    /// Amount of fine lines and edges, 0 (few) to 1 (many).
    pub detail: f64,
    /// Most strokes.
    pub strokes_max: usize,
    /// Longest estimated drawing time, s (see [`estimate`]).
    pub time_max_s: f64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// What is drawn of the background of a face.
    pub background: Background,
    /// Centre and radius of the face, pixels of the picture; `None`: faces are looked for.
    pub focus: Option<[f64; 3]>,
}

impl Default for VectorizeOptions {
    /// A sheet of 200 mm x 200 mm, a 0.5 mm pen, 900 strokes and 110 s at most.
    fn default() -> Self {
        Self {
            sheet_mm: [200.0, 200.0],
            margin_mm: 4.0,
            size_mm: None,
            origin_mm: None,
            pen_width_mm: 0.5,
            style: Style::Sketch,
            detail: 0.5,
            strokes_max: 900,
            time_max_s: 110.0,
            seed: 1,
            background: Background::Fade,
            focus: None,
        }
    }
}

impl VectorizeOptions {
    /// Largest width and height of a picture on the sheet, mm.
    #[must_use]
    pub fn room_mm(&self) -> [f64; 2] {
        self.size_mm
            .unwrap_or(self.sheet_mm.map(|side| side - 2.0 * self.margin_mm))
    }

    /// Position of a picture of this size on the sheet: left, top, width and height, mm.
    ///
    /// # Errors
    ///
    /// [`DrawingError::BadOptions`] if the sheet leaves no space.
    pub fn picture_mm(&self, width_px: u32, height_px: u32) -> Result<[f64; 4], DrawingError> {
        let frame = Frame::new(width_px, height_px, self)?;
        let ([left, top], [width, height]) = (frame.corner_mm, frame.size_mm);
        Ok([left, top, width, height])
    }
}

/// Rough estimate of a drawing's duration; the planner computes it exactly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Length drawn, mm.
    pub pen_down_mm: f64,
    /// Length of the travel moves, mm.
    pub pen_up_mm: f64,
    /// Number of pen lifts.
    pub lifts: usize,
    /// Duration, s.
    pub time_s: f64,
}

/// Estimates a drawing at 0.35 m/s drawn, 0.8 m/s travelled and 0.12 s a lift.
#[must_use]
pub fn estimate(drawing: &Drawing) -> Estimate {
    let (pen_down_mm, pen_up_mm, lifts) = (drawing.pen_down_mm(), drawing.pen_up_mm(), drawing.strokes.len());
    let time_s = pen_down_mm / DRAW_MM_S + pen_up_mm / TRAVEL_MM_S + lifts as f64 * LIFT_S;
    Estimate {
        pen_down_mm,
        pen_up_mm,
        lifts,
        time_s,
    }
}

/// Turns a photograph in a file into ordered strokes.
///
/// # Errors
///
/// Errors of [`load`]; [`DrawingError::NoPhotograph`] for any other kind of file; errors of [`vectorize_image`].
pub fn vectorize(path: impl AsRef<Path>, options: &VectorizeOptions) -> Result<Drawing, DrawingError> {
    match load(path)? {
        Input::Photograph(picture) => vectorize_image(&picture, options),
        Input::Drawing(_) | Input::Path(_) | Input::Artwork(_) => Err(DrawingError::NoPhotograph),
    }
}

/// Turns a photograph into ordered strokes.
///
/// # Errors
///
/// [`DrawingError::BadOptions`], [`DrawingError::TooSmall`], [`DrawingError::TooLarge`] or [`DrawingError::Blank`].
pub fn vectorize_image(picture: &RgbImage, options: &VectorizeOptions) -> Result<Drawing, DrawingError> {
    check_size(picture.width(), picture.height())?;
    vectorize_subject(picture, &Subject::of(picture, options.focus), options)
}

/// Turns a photograph whose subject is known into ordered strokes; `subject` belongs to this very picture.
///
/// # Errors
///
/// Errors of [`vectorize_image`].
pub fn vectorize_subject(
    picture: &RgbImage,
    subject: &Subject,
    options: &VectorizeOptions,
) -> Result<Drawing, DrawingError> {
    check_size(picture.width(), picture.height())?;
    let frame = Frame::new(picture.width(), picture.height(), options)?;
    let study = Study::of(picture, subject, frame, options)?;
    let mut drawing = match options.style {
        Style::Sketch => study.sketch(options),
        Style::Flow => study.flow(options),
        Style::Hatch => study.hatch(options),
        Style::Tsp => study.one_line(options),
        Style::Engrave => study.engraving(options),
    };
    keep_within(&mut drawing, options);
    if drawing.strokes.is_empty() {
        Err(DrawingError::Blank)
    } else {
        Ok(drawing)
    }
}

/// Removes the shortest strokes until the drawing keeps its limits.
fn keep_within(drawing: &mut Drawing, options: &VectorizeOptions) {
    while drawing.strokes.len() > options.strokes_max
        || (estimate(drawing).time_s > options.time_max_s && !drawing.strokes.is_empty())
    {
        let mut lengths: Vec<f64> = drawing.strokes.iter().map(Stroke::length_mm).collect();
        lengths.sort_by(f64::total_cmp);
        let surplus = drawing.strokes.len().saturating_sub(options.strokes_max);
        let cut = surplus.max(drawing.strokes.len() / 20).min(lengths.len() - 1);
        let shortest = lengths[cut];
        drawing.strokes.retain(|stroke| stroke.length_mm() > shortest);
    }
}

#[cfg(test)]
mod outline_tests;
#[cfg(test)]
mod tests;
