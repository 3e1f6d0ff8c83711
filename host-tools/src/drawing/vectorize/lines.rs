//! Edges and dark lines of a photograph: the surest in faces, few in the background.

use super::fill::TIME_AIM;
use super::study::Study;
use super::{DRAW_MM_S, LIFT_S, VectorizeOptions};
use crate::drawing::edges::{self, Edge, Flow};
use crate::drawing::line;
use crate::drawing::raster::Plane;

/// Share of the time aimed at that lines may take.
const LINE_SHARE: f64 = 0.4;
/// Weight of wide lines in the face, where fine ones count.
const COARSE_IN_FACE: f32 = 0.4;
/// Half widths of fine and wide lines, in widths of the pen, and the least ones inside a face, in its radii.
const FINE_PENS: f64 = 0.55;
const COARSE_PENS: f64 = 1.1;
const FINE_FACE: f64 = 0.010;
const COARSE_FACE: f64 = 0.020;
/// Least strength of lines away from faces, at features, at the outline of a portrait, and on skin.
const STRENGTH: f32 = 0.035;
const STRENGTH_AT_FEATURES: f32 = 0.018;
const STRENGTH_AT_OUTLINE: f32 = 0.014;
const STRENGTH_ON_SKIN: f32 = 0.050;
/// Least strength of lines at the edge of a subject as light as the paper: nothing but the line shows white hair.
const STRENGTH_AT_PALE_EDGE: f32 = 0.007;
/// Range of light in a face, of 1, to which a flat one is stretched, and the largest stretch.
const FACE_RANGE: f32 = 0.75;
const FACE_GAIN_MAX: f32 = 2.2;
/// Least share of the background that lines are weighed with.
const KEPT_MIN: f32 = 0.02;

impl Study {
    /// Edges and dark lines, the most important first, as many as the budget allows.
    pub(super) fn lines(&self, options: &VectorizeOptions) -> Vec<Edge> {
        let (mixed, flow) = self.line_strength(&self.with_contrast_in_faces());
        let texture = mixed.blurred((8.0 * self.pen) as f32);
        let strictness = 2.0_f32.powf(1.0 - 2.0 * options.detail as f32);
        let high = self.focus.zip(&texture, |face, busy| {
            STRENGTH - 0.015 * face + 0.8 * (1.0 - face) * busy
        });
        let in_face = self
            .features
            .map(|feature| STRENGTH_ON_SKIN + (STRENGTH_AT_FEATURES - STRENGTH_ON_SKIN) * feature);
        // A step is drawn on its dark side, which may be the background's.
        let kept = self.kept.zip(&self.outline, f32::max).zip(&self.pale_edge, f32::max);
        let high = high
            .mixed(&in_face, &self.skin)
            .zip(&self.outline, |high, outline| {
                high + (STRENGTH_AT_OUTLINE - high).min(0.0) * outline
            })
            .zip(&self.pale_edge, |high, pale| {
                high + (STRENGTH_AT_PALE_EDGE - high).min(0.0) * pale
            })
            .zip(&kept, |high, kept| strictness * high / (kept * kept).max(KEPT_MIN));
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

    /// Strength of dark lines in the light, fine ones first in faces, and the flow along them.
    pub(super) fn line_strength(&self, light: &Plane) -> (Plane, Flow) {
        let radius = self.faces.iter().map(|face| face.radius).fold(0.0, f64::max);
        let half_width = |pens: f64, radii: f64| (pens * self.pen).max(radii * radius) as f32;
        let flow = Flow::of(&self.calm, (1.2 * self.pen) as f32, 0.0, 1e-4);
        let fine = edges::line_strength(light, &flow, half_width(FINE_PENS, FINE_FACE));
        let coarse = edges::line_strength(light, &flow, half_width(COARSE_PENS, COARSE_FACE));
        let mixed = coarse.mixed(
            &fine.zip(&coarse, |fine, coarse| fine.max(COARSE_IN_FACE * coarse)),
            &self.focus,
        );
        (mixed, flow)
    }

    /// The light with the same range in every face.
    pub(super) fn with_contrast_in_faces(&self) -> Plane {
        let mut inside: Vec<f32> = (self.calm.values().iter().zip(self.ovals.values()))
            .filter(|(_, oval)| **oval > 0.7)
            .map(|(value, _)| *value)
            .collect();
        inside.sort_by(f32::total_cmp);
        let at = |share: f32| {
            inside
                .get((share * inside.len().saturating_sub(1) as f32) as usize)
                .copied()
        };
        let (Some(dark), Some(bright)) = (at(0.03), at(0.97)) else {
            return self.calm.clone();
        };
        let gain = (FACE_RANGE / (bright - dark).max(0.05)).clamp(1.0, FACE_GAIN_MAX);
        self.calm
            .zip(&self.ovals, |value, oval| value * (1.0 + oval * (gain - 1.0)))
    }

    /// A line smoothed and weighted, if it is long enough for its place.
    fn finished(&self, edge: Edge) -> Option<Edge> {
        let middle = *edge.points.get(edge.points.len() / 2)?;
        let at = |plane: &Plane| f64::from(plane.sample(middle[0] as f32, middle[1] as f32));
        let (face, skin, feature) = (at(&self.focus), at(&self.skin), at(&self.features));
        let even = line::resampled(&edge.points, 1.0);
        let points = line::smoothed(&even, self.pen * (1.2 - 0.5 * face));
        // A short line on bare skin is a scar.
        let shortest = 8.0 - 4.0 * face + 8.0 * skin * (1.0 - feature);
        let long_enough = line::length(&points) >= self.pen * shortest;
        long_enough.then_some(Edge {
            points,
            weight: edge.weight * (1.0 + 4.0 * face + 8.0 * feature),
        })
    }
}
