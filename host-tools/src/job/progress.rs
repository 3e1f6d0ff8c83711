//! Progress of a drawing, from the vertices that the firmware executed.
//!
//! Vertices are weighted by the duration of their legs at the configured speeds, because travel moves are faster than
//! drawn legs and short strokes cost lifts. The remaining time is the remaining weight, scaled by the ratio of the
//! elapsed time to the weight done.

use etherpen::config::Config;
use etherpen::messages::PathVertex;
use etherpen::motion::Pen;
use serde::{Deserialize, Serialize};

/// Share of the path from which the elapsed time corrects the estimate.
const CALIBRATED_FROM: f64 = 0.02;

/// Progress of a drawing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Vertices executed.
    pub vertices: usize,
    /// Vertices before what was found missing: before the first stroke with such a part, or after a stop beside the path before
    /// that part; [`Self::vertices`] if none was.
    #[serde(default)]
    pub complete: usize,
    /// Vertices of the path.
    pub vertices_total: usize,
    /// Length executed, pen up and down, mm.
    pub executed_mm: f64,
    /// Length of the path, mm.
    pub total_mm: f64,
    /// Length executed with the pen down, mm.
    pub pen_down_mm: f64,
    /// Strokes started.
    pub strokes: u32,
    /// Strokes of the path.
    pub strokes_total: u32,
    /// Time since the drawing began or was resumed, without the time on hold, s.
    pub elapsed_s: f64,
    /// Estimated remaining time, s.
    pub left_s: f64,
}

impl Progress {
    /// The progress if what is behind so many vertices is not known to be whole.
    #[must_use]
    pub fn complete_to(self, vertices: Option<usize>) -> Self {
        Self {
            complete: vertices.map_or(self.complete, |vertices| vertices.min(self.complete)),
            ..self
        }
    }

    /// [`Self::complete`], or `None` if nothing was found missing.
    #[must_use]
    pub fn missing_from(&self) -> Option<usize> {
        (self.complete < self.vertices).then_some(self.complete)
    }
}

/// Lengths and times along a path, computed once.
#[derive(Clone, Debug, Default)]
pub struct PathMeasure {
    /// One entry for each number of executed vertices.
    marks: Vec<Mark>,
}

/// Totals up to a number of executed vertices.
#[derive(Clone, Copy, Debug, Default)]
struct Mark {
    length_mm: f64,
    pen_down_mm: f64,
    /// Estimated time, s.
    time_s: f64,
    /// Strokes started.
    strokes: u32,
}

impl PathMeasure {
    /// Evaluates a path at the speeds of a configuration.
    pub fn new(vertices: &[PathVertex], config: &Config) -> Self {
        let motion = &config.motion;
        let lift_s = 2.0 * (config.paper.pen_lift_mm / motion.acceleration_mm_s2).sqrt();
        let mut mark = Mark::default();
        let mut marks = vec![mark];
        let mut last: Option<&PathVertex> = None;
        for vertex in vertices {
            let leg_mm = last.map_or(0.0, |last| distance_mm(last, vertex));
            let speed_mm_s = match vertex.pen {
                Pen::Down => motion.speed_mm_s,
                Pen::Up => motion.travel_speed_mm_s,
            };
            let pen_moves = last.is_some_and(|last| last.pen != vertex.pen);
            mark.length_mm += leg_mm;
            mark.pen_down_mm += if vertex.pen == Pen::Down { leg_mm } else { 0.0 };
            mark.time_s += leg_mm / speed_mm_s + if pen_moves { lift_s } else { 0.0 };
            mark.strokes = mark.strokes.max(vertex.stroke.saturating_add(1));
            marks.push(mark);
            last = Some(vertex);
        }
        Self { marks }
    }

    /// Progress with `executed` vertices, `elapsed_s` after the drawing was resumed with `before` vertices executed.
    pub fn progress(&self, before: u32, executed: u32, elapsed_s: f64) -> Progress {
        let vertices_total = self.marks.len().saturating_sub(1);
        let within = |vertices: u32| usize::try_from(vertices).unwrap_or(usize::MAX).min(vertices_total);
        let at = |vertices: usize| self.marks.get(vertices).copied().unwrap_or_default();
        let (begun, done, total) = (at(within(before)), at(within(executed)), at(vertices_total));
        let estimated_s = done.time_s - begun.time_s;
        let scale = if estimated_s > CALIBRATED_FROM * total.time_s && elapsed_s > 0.0 {
            elapsed_s / estimated_s
        } else {
            1.0
        };
        Progress {
            vertices: within(executed),
            complete: within(executed),
            vertices_total,
            executed_mm: done.length_mm,
            total_mm: total.length_mm,
            pen_down_mm: done.pen_down_mm,
            strokes: done.strokes,
            strokes_total: total.strokes,
            elapsed_s,
            left_s: (total.time_s - done.time_s) * scale,
        }
    }
}

fn distance_mm(a: &PathVertex, b: &PathVertex) -> f64 {
    let squares = a.position_um.iter().zip(&b.position_um).map(|(a, b)| {
        let difference_mm = (f64::from(*b) - f64::from(*a)) / 1000.0;
        difference_mm * difference_mm
    });
    squares.sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path() -> Vec<PathVertex> {
        [
            (0, Pen::Up, 0),
            (40, Pen::Down, 0),
            (140, Pen::Up, 1),
            (180, Pen::Down, 1),
        ]
        .map(|(x_mm, pen, stroke)| PathVertex {
            position_um: [x_mm * 1000, 0, -850_000],
            pen,
            stroke,
        })
        .to_vec()
    }

    #[test]
    fn lengths_and_strokes_follow_the_executed_vertices() {
        let measure = PathMeasure::new(&path(), &Config::default());
        let at = |executed| {
            let progress = measure.progress(0, executed, 0.0);
            (progress.executed_mm, progress.strokes)
        };
        assert_eq!(
            [at(0), at(1), at(2), at(3)],
            [(0.0, 0), (0.0, 1), (40.0, 1), (140.0, 2)]
        );
        assert_eq!(at(4), (180.0, 2));
        assert_eq!(at(99), at(4), "more than the path has is the whole path");
        assert_eq!(measure.progress(0, 0, 0.0).total_mm, 180.0);
    }

    #[test]
    fn the_time_left_is_corrected_by_the_time_taken_and_ends_at_zero() {
        let measure = PathMeasure::new(&path(), &Config::default());
        let before = measure.progress(0, 0, 0.0).left_s;
        let estimated_done = before - measure.progress(0, 2, 0.0).left_s;
        let slow = measure.progress(0, 2, 2.0 * estimated_done);
        assert!((slow.left_s - 2.0 * (before - estimated_done)).abs() < 1e-9, "{slow:?}");
        assert_eq!(measure.progress(0, 4, 3.0).left_s, 0.0);
        assert_eq!(
            PathMeasure::new(&[], &Config::default()).progress(0, 5, 1.0).left_s,
            0.0
        );
    }
}
