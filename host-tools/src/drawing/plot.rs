//! A pen moved by a program: the common part of G-code and HPGL.
//!
//! Both languages move a point, raise and lower a pen, and change it. This module collects the pen's lines, converts
//! the languages' upward y into the page's y, and approximates arcs by chords.

use super::artwork::{Artwork, Layer, LayerStroke};
use super::line::Point;
use super::{DrawingError, FilePlace, Stroke};
use std::collections::HashMap;
use std::f64::consts::TAU;

/// Largest distance of a chord from its arc, mm.
const TOLERANCE_MM: f64 = 0.02;
/// Largest coordinate, mm.
pub(super) const PLACE_MAX_MM: f64 = 1e6;
/// Most points of all strokes together.
const POINTS_MAX: usize = 20_000_000;
/// Most kinds of warnings.
const WARNINGS_MAX: usize = 12;

/// The pen and what it has drawn.
#[derive(Debug, Default)]
pub(super) struct Plot {
    /// Position of the pen, mm, y upwards.
    pub(super) at: Point,
    is_down: bool,
    pen: usize,
    line: Vec<Point>,
    points: usize,
    layers: Vec<Layer>,
    /// The layer of each pen.
    pens: HashMap<usize, usize>,
    strokes: Vec<LayerStroke>,
    warnings: Vec<(String, usize)>,
}

impl Plot {
    /// Adds a warning; repeated ones are counted.
    pub(super) fn warn(&mut self, text: String) {
        if let Some((_, count)) = self.warnings.iter_mut().find(|(known, _)| *known == text) {
            *count += 1;
        } else if self.warnings.len() < WARNINGS_MAX {
            self.warnings.push((text, 1));
        }
    }

    /// Raises or lowers the pen.
    pub(super) fn set_down(&mut self, is_down: bool) {
        if self.is_down && !is_down {
            self.end_line();
        }
        self.is_down = is_down;
    }

    /// Changes the pen.
    pub(super) fn change(&mut self, pen: usize) {
        if pen != self.pen {
            self.end_line();
            self.pen = pen;
        }
    }

    /// Moves in a straight line; draws while the pen is down.
    ///
    /// # Errors
    /// [`DrawingError::TooManyPoints`] and [`DrawingError::FarAway`].
    pub(super) fn go(&mut self, to: Point) -> Result<(), DrawingError> {
        if !to.iter().all(|value| value.abs() <= PLACE_MAX_MM) {
            return Err(DrawingError::FarAway {
                place: FilePlace::Somewhere,
            });
        }
        if self.is_down && to != self.at {
            if self.line.is_empty() {
                self.line.push(self.at);
            }
            self.line.push(to);
            self.points += 1;
            if self.points > POINTS_MAX {
                return Err(DrawingError::TooManyPoints { points_max: POINTS_MAX });
            }
        }
        self.at = to;
        Ok(())
    }

    /// Moves along an arc around a centre by an angle, counter-clockwise if positive, and ends exactly at `to`.
    ///
    /// # Errors
    /// As [`Self::go`].
    pub(super) fn turn(&mut self, centre: Point, angle_rad: f64, to: Point) -> Result<(), DrawingError> {
        let (x, y) = (self.at[0] - centre[0], self.at[1] - centre[1]);
        let radius = x.hypot(y);
        let largest = 2.0 * (1.0 - (TOLERANCE_MM / radius.max(TOLERANCE_MM)).min(1.0)).acos();
        if !self.is_down {
            return self.go(to);
        }
        let chords = (angle_rad.abs() / largest.max(1e-3)).ceil().clamp(1.0, 1e5);
        for k in 1..chords as u32 {
            let (sine, cosine) = (angle_rad * f64::from(k) / chords).sin_cos();
            self.go([centre[0] + x * cosine - y * sine, centre[1] + x * sine + y * cosine])?;
        }
        self.go(to)
    }

    fn end_line(&mut self) {
        let points: Vec<Point> = std::mem::take(&mut self.line).iter().map(|[x, y]| [*x, -*y]).collect();
        if points.len() < 2 {
            return;
        }
        let pen = self.pen;
        let layers = &mut self.layers;
        let layer = *self.pens.entry(pen).or_insert_with(|| {
            layers.push(Layer {
                name: format!("pen {pen}"),
                ..Layer::default()
            });
            layers.len() - 1
        });
        self.strokes.push(LayerStroke {
            layer,
            stroke: Stroke { points },
        });
    }

    /// The lines drawn; the page size is not known.
    pub(super) fn finish(mut self) -> Artwork {
        self.end_line();
        let told = |(text, count): (String, usize)| match count {
            1 => text,
            _ => format!("{text} ({count} times)"),
        };
        Artwork {
            page_mm: None,
            layers: self.layers,
            strokes: self.strokes,
            warnings: self.warnings.into_iter().map(told).collect(),
            ..Artwork::default()
        }
    }
}

/// The angle of an arc from one point to another around a centre, in the given direction; a full turn if both points
/// coincide.
pub(super) fn arc_angle(from: Point, to: Point, centre: Point, is_clockwise: bool) -> f64 {
    let angle = |point: Point| (point[1] - centre[1]).atan2(point[0] - centre[0]);
    let turn = (angle(to) - angle(from)).rem_euclid(TAU);
    let turn = if turn < 1e-9 || from == to { TAU } else { turn };
    match (is_clockwise, turn == TAU) {
        (false, _) => turn,
        (true, true) => -TAU,
        (true, false) => turn - TAU,
    }
}
