//! Lines and tone as one drawing in each style, as dense as the time limit allows.

use super::silhouette::MASK_SURE;
use super::study::Study;
use super::{DRAW_MM_S, Drawing, Stroke, VectorizeOptions, estimate};
use crate::drawing::edges::{Edge, Flow};
use crate::drawing::engrave::engrave;
use crate::drawing::line::{self, Point};
use crate::drawing::raster::Plane;
use crate::drawing::render::draw_line;
use crate::drawing::stipple::one_line;
use crate::drawing::tone::{ToneGoal, hatch, join_serpentines};
use crate::drawing::{OrderOptions, order};

/// Share of the time limit that is aimed at.
pub(super) const TIME_AIM: f64 = 0.88;
/// Densest hatching: share of the paper covered.
const COVERAGE_MAX: f32 = 0.66;
/// Thinnest hatching.
const COVERAGE_MIN: f32 = 0.13;
/// Scale of the ink in the face, independent of the time limit.
const FACE_GAIN: f32 = 0.9;
/// How far shade keeps off the lines of a face, as a multiple of the ink they already give.
const KEPT_OFF: f32 = 2.0;
/// How far a stroke's neighbours count, widths of the pen, and the coverage around two long strokes at the
/// thinnest hatching.
const NEAR_PENS: f64 = 6.0;
const LONE_COVERAGE: f32 = 0.105;
/// Rounds of hatching to meet the time limit.
const TONE_ROUNDS: usize = 3;
/// Rounds of the other styles to meet the time limit.
const FILL_ROUNDS: usize = 5;
/// Additional points of the one line at features of a face, as a share.
const FEATURE_GAIN: f32 = 1.2;
/// Angle between the two layers of hatching, radians, and the ink at which the second one begins.
const CROSS_ANGLE_RAD: f32 = 1.0;
const CROSS_FROM: f32 = 0.42;

const _: () = assert!(COVERAGE_MAX <= 1.0, "the pitch is at least the pen's width");
const _: () = assert!(COVERAGE_MIN < COVERAGE_MAX);

impl Study {
    /// Lines, and tone in serpentines along the picture's flow.
    pub(super) fn sketch(&self, options: &VectorizeOptions) -> Drawing {
        self.toned(&self.lines(options), options)
    }

    /// Tone along the picture's flow; lines at eyes, nose and mouth and along the outline of a portrait alone.
    pub(super) fn flow(&self, options: &VectorizeOptions) -> Drawing {
        let wanted = self
            .features
            .zip(&self.outline, |feature, outline| feature.max(outline / MASK_SURE));
        let lines = self.lines(options).into_iter().filter(|edge| {
            let is_wanted = |point: &&Point| wanted.sample(point[0] as f32, point[1] as f32) > 0.5;
            2 * edge.points.iter().filter(is_wanted).count() > edge.points.len()
        });
        self.toned(&lines.collect::<Vec<_>>(), options)
    }

    /// Lines, and two layers of hatching over the form.
    pub(super) fn hatch(&self, options: &VectorizeOptions) -> Drawing {
        let lines = self.lines(options);
        let drawn = self.coverage_of(lines.iter().map(|edge| edge.points.as_slice()));
        let sigma = |pens: f64| (pens * self.pen) as f32;
        let flow = Flow::of(&self.calm.blurred(sigma(3.0)), sigma(16.0), -0.8, 0.01);
        let crossing = flow.turned(CROSS_ANGLE_RAD);
        self.filled(&lines, options, |density| {
            let gain = density as f32;
            let wanted = self.wanted(gain, &drawn);
            let first = wanted.map(|wanted| wanted.min(CROSS_FROM));
            let second = wanted.map(|wanted| (wanted - CROSS_FROM).max(0.0) * 1.6);
            let mut strokes = Vec::new();
            for (coverage, flow) in [(&first, &flow), (&second, &crossing)] {
                let length_min = self.focus.map(|face| (self.pen as f32) * (12.0 - 7.0 * face));
                let goal = ToneGoal {
                    coverage,
                    flow,
                    pen: self.pen,
                    coverage_min: COVERAGE_MIN,
                    length_min: &length_min,
                    seed: options.seed,
                };
                let serpentines = join_serpentines(&self.without_lone(hatch(&goal)), &goal);
                strokes.extend(serpentines.iter().map(|points| self.stroke(points)));
            }
            strokes
        })
    }

    /// One line through points.
    pub(super) fn one_line(&self, options: &VectorizeOptions) -> Drawing {
        // Where eyes and mouth are, the line has no help from edges.
        let ink = self.grain.zip(&self.features, |ink, feature| {
            ink * (1.0 + FEATURE_GAIN * feature * ink)
        });
        // Every point of a piece stays a vertex: its place is the tone, and the tour is short through all of them.
        let through = |points: &Vec<Point>| Stroke {
            points: self.frame.on_sheet(points),
        };
        self.filled(&[], options, |density| {
            let line = one_line(&ink, self.pen, density, options.seed);
            line.iter().map(through).collect()
        })
    }

    /// Long lines side by side that bend with the form, and lines at eyes, nose and mouth.
    pub(super) fn engraving(&self, options: &VectorizeOptions) -> Drawing {
        let lines = self.lines(options);
        let drawn = self.coverage_of(lines.iter().map(|edge| edge.points.as_slice()));
        self.filled(&lines, options, |density| {
            let ink = self.ink.zip(&drawn, |ink, drawn| (ink - 0.5 * drawn).max(0.0));
            let engraved = engrave(&ink, &self.calm, self.pen, density);
            engraved.iter().map(|points| self.stroke(points)).collect()
        })
    }

    /// Lines and hatching, the hatching as dense as the time limit allows.
    fn toned(&self, lines: &[Edge], options: &VectorizeOptions) -> Drawing {
        let drawn = self.coverage_of(lines.iter().map(|edge| edge.points.as_slice()));
        let line_strokes: Vec<Stroke> = lines.iter().map(|edge| self.stroke(&edge.points)).collect();
        let area_mm2 = self.frame.size_mm[0] * self.frame.size_mm[1];
        let aim_s = TIME_AIM * options.time_max_s;
        let ink_mm = aim_s * 0.6 * DRAW_MM_S;
        let mut gain = (ink_mm * options.pen_width_mm / (area_mm2 * f64::from(self.ink.mean()).max(1e-3))).min(1.0);
        let mut result = Drawing::default();
        for round in 0..TONE_ROUNDS {
            let hatching = self.hatching(gain as f32, &drawn, options);
            result = ordered(line_strokes.iter().cloned().chain(hatching).collect(), options);
            let ratio = aim_s / estimate(&result).time_s;
            if round + 1 == TONE_ROUNDS || (0.93..1.07).contains(&ratio) || (ratio > 1.0 && gain >= 1.2) {
                break;
            }
            gain = (gain * ratio.powf(1.2)).min(1.2);
        }
        result
    }

    /// Lines and filling, the filling as dense as the time limit allows.
    fn filled(&self, lines: &[Edge], options: &VectorizeOptions, filling: impl Fn(f64) -> Vec<Stroke>) -> Drawing {
        let aim_s = TIME_AIM * options.time_max_s;
        let mut density = 1.0;
        let mut result = Drawing::default();
        for _ in 0..FILL_ROUNDS {
            let outlines = lines.iter().map(|edge| self.stroke(&edge.points));
            result = ordered(outlines.chain(filling(density)).collect(), options);
            let ratio = aim_s / estimate(&result).time_s.max(1e-3);
            if ratio > 0.95 && (ratio < 1.1 || density >= 1.0) {
                break;
            }
            density = (density * ratio).min(1.0);
        }
        result
    }

    /// Coverage that is still missing, if the ink is scaled by `gain` outside faces.
    fn wanted(&self, gain: f32, drawn: &Plane) -> Plane {
        let gains = self.focus.zip(&self.skin, |face, skin| {
            let gain = gain + face * (FACE_GAIN - gain).max(0.0);
            gain + skin * (1.0 - gain)
        });
        let wanted = self.ink.zip(&gains, |ink, gain| gain * ink);
        let bare = self.skin.zip(&self.features, |skin, feature| skin * (1.0 - feature));
        let drawn = drawn.zip(&bare, |drawn, bare| drawn * (1.0 + KEPT_OFF * bare));
        wanted
            .zip(&drawn, |wanted, drawn| (wanted - drawn).clamp(0.0, COVERAGE_MAX))
            .blurred(0.6 * self.pen as f32)
    }

    fn hatching(&self, gain: f32, drawn: &Plane, options: &VectorizeOptions) -> Vec<Stroke> {
        let coverage = self.wanted(gain, drawn);
        let length_min = self.focus.map(|face| (self.pen as f32) * (12.0 - 8.0 * face));
        let goal = ToneGoal {
            coverage: &coverage,
            flow: &self.hatch_flow,
            pen: self.pen,
            coverage_min: COVERAGE_MIN,
            length_min: &length_min,
            seed: options.seed,
        };
        let serpentines = join_serpentines(&self.without_lone(hatch(&goal)), &goal);
        serpentines
            .iter()
            .map(|points| self.stroke(&line::smoothed(&line::resampled(points, 1.0), 0.9 * self.pen)))
            .collect()
    }

    /// The strokes without those that stand alone on skin: one line is a scratch, not a shade.
    pub(super) fn without_lone(&self, mut strokes: Vec<Vec<Point>>) -> Vec<Vec<Point>> {
        let mut covered = Plane::filled(self.calm.width(), self.calm.height(), 0.0);
        strokes
            .iter()
            .for_each(|points| draw_line(&mut covered, points, self.pen));
        let covered = covered.blurred((NEAR_PENS * self.pen) as f32);
        let bare = self.skin.zip(&self.features, |skin, feature| skin * (1.0 - feature));
        let mean = |plane: &Plane, points: &[Point]| {
            let sum: f32 = points.iter().map(|at| plane.sample(at[0] as f32, at[1] as f32)).sum();
            sum / points.len().max(1) as f32
        };
        strokes.retain(|points| mean(&bare, points) < 0.5 || mean(&covered, points) > LONE_COVERAGE);
        strokes
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

/// The strokes in a good order.
fn ordered(strokes: Vec<Stroke>, options: &VectorizeOptions) -> Drawing {
    let mut result = Drawing {
        sheet_mm: options.sheet_mm,
        strokes,
    };
    let join_gap_mm = options.pen_width_mm;
    order(
        &mut result,
        &OrderOptions {
            join_gap_mm,
            ..OrderOptions::default()
        },
    );
    result
}
