//! From a photograph to strokes: lines where the picture has edges, hatching where it is dark.
//!
//! The picture is scaled to two pixels for each pen width, so that every number below is a length on paper. Lines come
//! first; hatching adds only the missing tone; the ink is scaled so that the drawing meets the time limit. The face
//! ([`super::focus`]) gets finer lines, shorter strokes and more contrast.

use super::edges::{self, Edge, Flow};
use super::focus::focus;
use super::line::{self, Point};
use super::photo::check_size;
use super::raster::Plane;
use super::render::{draw_line, grey};
use super::styles::{Style, hatch as straight_hatch, one_line};
use super::tone::{ToneGoal, hatch, join_serpentines};
use super::{Drawing, DrawingError, Input, OrderOptions, Stroke, load, order};
use image::RgbImage;
use image::imageops::{FilterType, resize};
use std::path::Path;

/// Pixels for each pen width while processing.
const PX_PER_PEN: f64 = 2.0;
/// Longest side of the processed picture, pixels.
const WORK_SIDE_MAX: f64 = 2400.0;
/// Mean speeds and times of the robot for the estimate.
const DRAW_MM_S: f64 = 350.0;
const TRAVEL_MM_S: f64 = 800.0;
const LIFT_S: f64 = 0.12;
/// Share of the time limit that is aimed at, and the share of that for lines.
const TIME_AIM: f64 = 0.88;
const LINE_SHARE: f64 = 0.4;
/// Direction of hatching where the picture has none, radians.
const HATCH_ANGLE_RAD: f32 = -0.8;
/// Densest hatching: share of the paper covered.
const COVERAGE_MAX: f32 = 0.66;
/// Thinnest hatching.
const COVERAGE_MIN: f32 = 0.13;
/// Scale of the ink in the face, independent of the time limit.
const FACE_GAIN: f32 = 0.9;
/// Weight of wide lines in the face, where fine ones count.
const COARSE_IN_FACE: f32 = 0.4;
/// Rounds of hatching to meet the time limit.
const TONE_ROUNDS: usize = 3;
/// Rounds of the other styles to meet the time limit.
const FILL_ROUNDS: usize = 5;

const _: () = assert!(COVERAGE_MAX <= 1.0, "the pitch is at least the pen's width");
const _: () = assert!(COVERAGE_MIN < COVERAGE_MAX);

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
        }
    }
}

impl VectorizeOptions {
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
    let frame = Frame::new(picture.width(), picture.height(), options)?;
    let study = Study::of(picture, &frame, options)?;
    let mut drawing = match options.style {
        Style::Sketch => study.drawing(&study.lines(options), options),
        Style::Flow => study.drawing(&[], options),
        Style::Hatch => study.filled(&study.lines(options), options, |density| {
            straight_hatch(&study.ink, study.pen, density)
        }),
        Style::Tsp => study.filled(&[], options, |density| {
            one_line(&study.ink, study.pen, density, options.seed)
        }),
    };
    keep_within(&mut drawing, options);
    if drawing.strokes.is_empty() {
        Err(DrawingError::Blank)
    } else {
        Ok(drawing)
    }
}

/// Position of the picture on the sheet, and its scale while processing.
struct Frame {
    corner_mm: [f64; 2],
    size_mm: [f64; 2],
    mm_per_px: f64,
    work_px: [u32; 2],
}

impl Frame {
    fn new(width_px: u32, height_px: u32, options: &VectorizeOptions) -> Result<Self, DrawingError> {
        let VectorizeOptions {
            sheet_mm,
            margin_mm,
            size_mm,
            origin_mm,
            pen_width_mm,
            time_max_s,
            ..
        } = *options;
        let room = size_mm.unwrap_or(sheet_mm.map(|side| side - 2.0 * margin_mm));
        let numbers = [room[0], room[1], pen_width_mm, time_max_s];
        let usable = numbers.iter().all(|value| value.is_finite() && *value > 0.0);
        let margin_usable = margin_mm.is_finite() && margin_mm >= 0.0 && (0.0..=1.0).contains(&options.detail);
        if !usable || !margin_usable || room[0].min(room[1]) < 8.0 * pen_width_mm {
            return Err(DrawingError::BadOptions);
        }
        let (width, height) = (f64::from(width_px.max(1)), f64::from(height_px.max(1)));
        let scale = (room[0] / width).min(room[1] / height);
        let size_mm = [width * scale, height * scale];
        let mm_per_px = (pen_width_mm / PX_PER_PEN).max(size_mm[0].max(size_mm[1]) / WORK_SIDE_MAX);
        let work_px = size_mm.map(|side| (side / mm_per_px).round().max(8.0) as u32);
        let corner_mm = origin_mm.unwrap_or([0, 1].map(|k| 0.5 * (sheet_mm[k] - size_mm[k])));
        Ok(Self {
            corner_mm,
            size_mm,
            mm_per_px,
            work_px,
        })
    }

    /// A line of the picture on the sheet, limited to the picture.
    fn on_sheet(&self, points: &[Point]) -> Vec<Point> {
        let place = |point: &Point| {
            [0, 1].map(|k| self.corner_mm[k] + ((point[k] + 0.5) * self.mm_per_px).clamp(0.0, self.size_mm[k]))
        };
        points.iter().map(place).collect()
    }
}

/// Analysis of the picture before drawing.
struct Study {
    frame: Frame,
    /// Pen's width, pixels.
    pen: f64,
    /// How much a pixel belongs to the face.
    focus: Plane,
    /// Lightness without noise, 0 to 1.
    calm: Plane,
    /// Required ink at full strength, 0 to 1.
    ink: Plane,
    hatch_flow: Flow,
}

impl Study {
    fn of(picture: &RgbImage, frame: &Frame, options: &VectorizeOptions) -> Result<Self, DrawingError> {
        let small = resize(picture, frame.work_px[0], frame.work_px[1], FilterType::CatmullRom);
        let light = grey(&small);
        let (black, white) = (light.percentile(0.01), light.percentile(0.985));
        if white - black < 0.02 {
            return Err(DrawingError::Blank);
        }
        let light = light.map(|value| ((value - black) / (white - black)).clamp(0.0, 1.0));
        let pen = options.pen_width_mm / frame.mm_per_px;
        let sigma = |pens: f64| (pens * pen) as f32;
        let calm = denoised(&light, sigma(1.0) as usize + 1);
        let detail = light.zip(&light.blurred(sigma(2.0)), |value, around| (value - around).abs());
        let focus = focus(&small, &detail);
        let tone = denoised(&light, sigma(3.0) as usize + 1).mixed(&calm, &focus);
        let (near, far) = (calm.blurred(sigma(6.0)), calm.blurred(sigma(30.0)));
        let width = calm.width();
        let ink = Plane::from_fn(width, calm.height(), |x, y| {
            let (x, y) = (x as isize, y as isize);
            let (value, face) = (tone.at(x, y), focus.at(x, y));
            let lifted = value + 0.25 * (value - far.at(x, y)) + 1.2 * face * (value - near.at(x, y));
            let dark = (1.0 - lifted).clamp(0.0, 1.0);
            ((dark - 0.1) / 0.9).max(0.0).powf(1.35)
        });
        let hatch_flow = Flow::of(&calm.blurred(sigma(1.0)), sigma(7.0), HATCH_ANGLE_RAD, 0.006).mixed(
            &Flow::of(&calm.blurred(sigma(0.6)), sigma(3.0), HATCH_ANGLE_RAD, 0.006),
            &focus,
        );
        let frame = Frame { ..*frame };
        Ok(Self {
            frame,
            pen,
            focus,
            calm,
            ink,
            hatch_flow,
        })
    }

    /// Edges and dark lines, the most important first, as many as the budget allows.
    fn lines(&self, options: &VectorizeOptions) -> Vec<Edge> {
        let sigma = |pens: f64| (pens * self.pen) as f32;
        let flow = Flow::of(&self.calm, sigma(1.2), HATCH_ANGLE_RAD, 1e-4);
        let fine = edges::line_strength(&self.calm, &flow, sigma(0.55));
        let coarse = edges::line_strength(&self.calm, &flow, sigma(1.1));
        let mixed = coarse.mixed(
            &fine.zip(&coarse, |fine, coarse| fine.max(COARSE_IN_FACE * coarse)),
            &self.focus,
        );
        let texture = mixed.blurred(sigma(8.0));
        let strictness = 2.0_f32.powf(1.0 - 2.0 * options.detail as f32);
        let high = self.focus.zip(&texture, |face, busy| {
            strictness * (0.035 - 0.015 * face + 0.8 * (1.0 - face) * busy)
        });
        let traced = edges::trace_lines(&mixed, &flow, &high, 0.45);
        let joined = edges::join_by_direction(traced, 2.5 * self.pen);
        let mut lines: Vec<Edge> = joined.into_iter().filter_map(|edge| self.finished(edge)).collect();
        lines.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        let mut time_s = 2.0 * options.detail * LINE_SHARE * TIME_AIM * options.time_max_s;
        lines
            .into_iter()
            .take_while(|edge| {
                time_s -= LIFT_S + line::length(&edge.points) * self.frame.mm_per_px / DRAW_MM_S;
                time_s > 0.0
            })
            .take(options.strokes_max / 2)
            .collect()
    }

    /// A line smoothed and weighted, if it is long enough for its place.
    fn finished(&self, edge: Edge) -> Option<Edge> {
        let middle = *edge.points.get(edge.points.len() / 2)?;
        let face = f64::from(self.focus.sample(middle[0] as f32, middle[1] as f32));
        let even = line::resampled(&edge.points, 1.0);
        let points = line::smoothed(&even, self.pen * (1.2 - 0.5 * face));
        let long_enough = line::length(&points) >= self.pen * (8.0 - 4.0 * face);
        long_enough.then_some(Edge {
            points,
            weight: edge.weight * (1.0 + 4.0 * face),
        })
    }

    /// Lines and hatching, the hatching as dense as the time limit allows.
    fn drawing(&self, lines: &[Edge], options: &VectorizeOptions) -> Drawing {
        let drawn = self.coverage_of(lines.iter().map(|edge| edge.points.as_slice()));
        let line_strokes: Vec<Stroke> = lines.iter().map(|edge| self.stroke(&edge.points)).collect();
        let area_mm2 = self.frame.size_mm[0] * self.frame.size_mm[1];
        let aim_s = TIME_AIM * options.time_max_s;
        let ink_mm = aim_s * 0.6 * DRAW_MM_S;
        let mut gain = (ink_mm * options.pen_width_mm / (area_mm2 * f64::from(self.ink.mean()).max(1e-3))).min(1.0);
        let mut result = Drawing::default();
        for round in 0..TONE_ROUNDS {
            let hatching = self.hatching(gain as f32, &drawn, options);
            let strokes = line_strokes.iter().cloned().chain(hatching).collect();
            result = Drawing {
                sheet_mm: options.sheet_mm,
                strokes,
            };
            order(
                &mut result,
                &OrderOptions {
                    join_gap_mm: options.pen_width_mm,
                    ..OrderOptions::default()
                },
            );
            let ratio = aim_s / estimate(&result).time_s;
            if round + 1 == TONE_ROUNDS || (0.93..1.07).contains(&ratio) || (ratio > 1.0 && gain >= 1.2) {
                break;
            }
            gain = (gain * ratio.powf(1.2)).min(1.2);
        }
        result
    }

    /// Lines and filling, the filling as dense as the time limit allows.
    fn filled(&self, lines: &[Edge], options: &VectorizeOptions, filling: impl Fn(f64) -> Vec<Vec<Point>>) -> Drawing {
        let aim_s = TIME_AIM * options.time_max_s;
        let mut density = 1.0;
        let mut result = Drawing::default();
        for _ in 0..FILL_ROUNDS {
            let filling = filling(density);
            let filling = filling.iter().map(|points| Stroke {
                points: self.frame.on_sheet(points),
            });
            let outlines = lines.iter().map(|edge| self.stroke(&edge.points));
            result = Drawing {
                sheet_mm: options.sheet_mm,
                strokes: outlines.chain(filling).collect(),
            };
            let join_gap_mm = options.pen_width_mm;
            order(
                &mut result,
                &OrderOptions {
                    join_gap_mm,
                    ..OrderOptions::default()
                },
            );
            let ratio = aim_s / estimate(&result).time_s.max(1e-3);
            if ratio > 0.95 && (ratio < 1.1 || density >= 1.0) {
                break;
            }
            density = (density * ratio).min(1.0);
        }
        result
    }

    fn hatching(&self, gain: f32, drawn: &Plane, options: &VectorizeOptions) -> Vec<Stroke> {
        let gains = self.focus.map(|face| gain + face * (FACE_GAIN - gain).max(0.0));
        let wanted = self.ink.zip(&gains, |ink, gain| gain * ink);
        let coverage = wanted.zip(drawn, |wanted, drawn| (wanted - drawn).clamp(0.0, COVERAGE_MAX));
        let coverage = coverage.blurred(0.6 * self.pen as f32);
        let length_min = self.focus.map(|face| (self.pen as f32) * (12.0 - 9.0 * face));
        let goal = ToneGoal {
            coverage: &coverage,
            flow: &self.hatch_flow,
            pen: self.pen,
            coverage_min: COVERAGE_MIN,
            length_min: &length_min,
            seed: options.seed,
        };
        let serpentines = join_serpentines(&hatch(&goal), &goal);
        serpentines
            .iter()
            .map(|points| self.stroke(&line::smoothed(&line::resampled(points, 1.0), 0.9 * self.pen)))
            .collect()
    }

    fn stroke(&self, points: &[Point]) -> Stroke {
        Stroke {
            points: line::simplified(&self.frame.on_sheet(points), 0.08 * self.pen * self.frame.mm_per_px),
        }
    }

    /// Share of the paper that the lines cover around each pixel.
    fn coverage_of<'a>(&self, lines: impl Iterator<Item = &'a [Point]>) -> Plane {
        let mut covered = Plane::filled(self.calm.width(), self.calm.height(), 0.0);
        lines.for_each(|points| draw_line(&mut covered, points, self.pen));
        let (wide, fine) = (covered.blurred(2.0 * self.pen as f32), covered.blurred(self.pen as f32));
        wide.mixed(&fine, &self.focus)
    }
}

/// The picture without noise, its edges kept (guided filter, He, Sun and Tang, 2010).
fn denoised(light: &Plane, radius: usize) -> Plane {
    const NOISE: f32 = 0.03;
    let mean = light.averaged(radius);
    let square = light.map(|value| value * value).averaged(radius);
    let slope = square.zip(&mean, |square, mean| {
        let variance = (square - mean * mean).max(0.0);
        variance / (variance + NOISE * NOISE)
    });
    let offset = mean.zip(&slope, |mean, slope| mean * (1.0 - slope));
    let (slope, offset) = (slope.averaged(radius), offset.averaged(radius));
    slope
        .zip(light, |slope, value| slope * value)
        .zip(&offset, |scaled, offset| scaled + offset)
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
mod tests;
