//! End of the ink on a path, from the measured positions of the pen.
//!
//! The place advances along the path with the pen. It is searched only as far ahead as the pen has moved, so it never
//! jumps to a neighbouring line, nor back. Invariant: the place is never ahead of the ink by more than [`AWAY_MAX_MM`];
//! while the pen is not on its stroke, the place stays.

use etherpen::messages::PathVertex;
use etherpen::motion::Pen;
use std::sync::Arc;

/// Largest distance of the pen from its path, mm: more than the tolerance of a path plus the lag of the drives, less
/// than the width of a line.
pub const AWAY_MAX_MM: f64 = 0.25;
/// How far ahead the place is searched, in distances that the pen has moved, plus an offset, mm.
const AHEAD: f64 = 1.5;
const AHEAD_MM: f64 = 0.1;

type Point = [f64; 3];

/// The end of the ink on one path.
#[derive(Clone, Debug)]
pub struct Ink {
    path: Arc<[PathVertex]>,
    /// First drawn leg of each stroke, by the vertex at its end.
    starts: Vec<Option<usize>>,
    /// Vertex at the end of the leg on which the ink ends.
    leg: usize,
    /// Distance along that leg, mm.
    along_mm: f64,
    last: Option<Point>,
    /// Distance that the pen has moved since the place was last found, mm.
    moved_mm: f64,
}

/// Where the ink ended on a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InkEnd {
    leg: usize,
    along_mm: f64,
}

fn at(vertex: &PathVertex) -> Point {
    vertex.position_um.map(|um| f64::from(um) / 1_000.0)
}

fn distance_mm(a: &Point, b: &Point) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b));
    squares.sum::<f64>().sqrt()
}

fn between(a: &Point, b: &Point, share: f64) -> Point {
    std::array::from_fn(|axis| {
        let of = |point: &Point| point.get(axis).copied().unwrap_or(0.0);
        of(a) + (of(b) - of(a)) * share
    })
}

impl Ink {
    /// A path without ink.
    pub fn new(path: Arc<[PathVertex]>) -> Self {
        let strokes = path.iter().map(|vertex| vertex.stroke as usize + 1).max().unwrap_or(0);
        let mut starts = vec![None; strokes.min(path.len())];
        for (leg, vertex) in path
            .iter()
            .enumerate()
            .skip(1)
            .filter(|(_, vertex)| vertex.pen == Pen::Down)
        {
            if let Some(start) = starts.get_mut(vertex.stroke as usize) {
                start.get_or_insert(leg);
            }
        }
        Self {
            path,
            starts,
            leg: 0,
            along_mm: 0.0,
            last: None,
            moved_mm: 0.0,
        }
    }

    /// Takes a position of the pen on the paper, mm, drawing this stroke.
    pub fn draws(&mut self, stroke: u32, pen_mm: Point) {
        if pen_mm.iter().any(|mm| !mm.is_finite()) {
            return;
        }
        let Some(start) = self.starts.get(stroke as usize).copied().flatten() else {
            return;
        };
        let there = self
            .path
            .get(self.leg)
            .filter(|_| self.leg > 0)
            .map(|vertex| vertex.stroke);
        match there {
            Some(there) if there > stroke => return,
            Some(there) if there == stroke => {}
            _ => (self.leg, self.along_mm, self.last, self.moved_mm) = (start, 0.0, None, 0.0),
        }
        self.moved_mm += self.last.map_or(0.0, |last| distance_mm(&last, &pen_mm));
        self.last = Some(pen_mm);
        if let Some((leg, along_mm)) = self.nearest(&pen_mm, AHEAD * self.moved_mm + AHEAD_MM) {
            (self.leg, self.along_mm, self.moved_mm) = (leg, along_mm, 0.0);
        }
    }

    /// Records that the pen is off the paper.
    pub fn lifted(&mut self) {
        (self.last, self.moved_mm) = (None, 0.0);
    }

    /// Where the ink ends.
    pub fn keep(&self) -> InkEnd {
        InkEnd {
            leg: self.leg,
            along_mm: self.along_mm,
        }
    }

    /// Goes back to where the ink ended.
    pub fn restore(&mut self, end: InkEnd) {
        (self.leg, self.along_mm) = (end.leg, end.along_mm);
        self.lifted();
    }

    /// Goes back to the end of the ink before a vertex, the first that counts as not drawn: it may be within a stroke.
    pub fn back_to(&mut self, vertex: usize) {
        let before = self.path.get(..vertex).unwrap_or(&self.path);
        let is_drawn = |vertex: &PathVertex| vertex.pen == Pen::Down;
        let leg = before.iter().rposition(is_drawn).unwrap_or(0);
        if leg >= self.leg {
            return;
        }
        let legs = leg.checked_sub(1).and_then(|begin| self.path.get(begin..=leg));
        self.along_mm = match legs {
            Some([begin, end]) => distance_mm(&at(begin), &at(end)),
            _ => 0.0,
        };
        self.leg = leg;
        self.lifted();
    }

    /// The place nearest to the pen, from the present one up to this distance along the stroke; `None` if the pen is
    /// not there.
    fn nearest(&self, pen_mm: &Point, ahead_mm: f64) -> Option<(usize, f64)> {
        let stroke = self.path.get(self.leg)?.stroke;
        let mut left_mm = ahead_mm;
        let mut from_mm = self.along_mm;
        let mut best: Option<(f64, usize, f64)> = None;
        for leg in self.leg..self.path.len() {
            let (Some(begin), Some(end)) = (self.path.get(leg.wrapping_sub(1)), self.path.get(leg)) else {
                break;
            };
            if end.stroke != stroke || end.pen != Pen::Down || left_mm < 0.0 {
                break;
            }
            let (begin, end) = (at(begin), at(end));
            let length_mm = distance_mm(&begin, &end);
            let to_mm = (from_mm + left_mm).min(length_mm);
            let dot: f64 = (0..3)
                .filter_map(|axis| Some((pen_mm.get(axis)? - begin.get(axis)?) * (end.get(axis)? - begin.get(axis)?)))
                .sum();
            let along_mm = if length_mm > 0.0 { dot / length_mm } else { 0.0 };
            let along_mm = along_mm.min(to_mm).max(from_mm.min(length_mm));
            let share = if length_mm > 0.0 { along_mm / length_mm } else { 0.0 };
            let away_mm = distance_mm(pen_mm, &between(&begin, &end, share));
            if best.is_none_or(|(nearest_mm, ..)| away_mm < nearest_mm - 1e-9) {
                best = Some((away_mm, leg, along_mm));
            }
            left_mm -= length_mm - from_mm;
            from_mm = 0.0;
        }
        best.filter(|(away_mm, ..)| *away_mm <= AWAY_MAX_MM)
            .map(|(_, leg, along_mm)| (leg, along_mm))
    }

    /// The vertex at the end of the leg on which the ink ends, 0 if there is no ink, and the place of the end, um.
    pub fn end(&self) -> (usize, Option<[i32; 3]>) {
        let (Some(begin), Some(end)) = (self.path.get(self.leg.wrapping_sub(1)), self.path.get(self.leg)) else {
            return (0, None);
        };
        let (begin, end) = (at(begin), at(end));
        let length_mm = distance_mm(&begin, &end);
        let share = if length_mm > 0.0 {
            self.along_mm / length_mm
        } else {
            0.0
        };
        let place = between(&begin, &end, share.clamp(0.0, 1.0));
        (self.leg, Some(place.map(|mm| (mm * 1_000.0).round() as i32)))
    }

    /// Number of the stroke on which the ink ends, from 0.
    pub fn stroke(&self) -> u32 {
        self.path.get(self.leg).map_or(0, |vertex| vertex.stroke)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Lcg;

    /// Strokes with reversals, parallels a tenth of a millimetre apart, and lines on top of each other.
    fn dense(seed: u64) -> Arc<[PathVertex]> {
        let mut random = Lcg::new(seed);
        let mut path = Vec::new();
        for stroke in 0..4 {
            let (mut x_um, mut y_um) = (random.below(50_000) as i32, random.below(50_000) as i32);
            let vertex = |x_um, y_um, pen| PathVertex {
                position_um: [x_um, y_um, -850_000],
                pen,
                stroke,
            };
            path.push(vertex(x_um, y_um, Pen::Up));
            for _ in 0..30 {
                let length_um = 200 + random.below(10_000) as i32;
                match random.below(4) {
                    0 => x_um += length_um,
                    1 => x_um -= length_um,
                    2 => y_um += length_um.min(100),
                    _ => y_um += length_um,
                }
                path.push(vertex(x_um, y_um, Pen::Down));
            }
        }
        path.into()
    }

    /// Length drawn up to a place, mm.
    fn drawn_mm(path: &[PathVertex], leg: usize, end_um: Option<[i32; 3]>) -> f64 {
        let mut drawn_mm = 0.0;
        for index in 1..leg {
            if path[index].pen == Pen::Down {
                drawn_mm += distance_mm(&at(&path[index - 1]), &at(&path[index]));
            }
        }
        let end = end_um.map(|um| um.map(|um| f64::from(um) / 1_000.0));
        drawn_mm + end.map_or(0.0, |end| distance_mm(&at(&path[leg - 1]), &end))
    }

    #[test]
    fn the_place_goes_with_the_pen_on_dense_paths_and_is_never_far_ahead_of_it() {
        for seed in 1..60_u64 {
            let (path, mut random) = (dense(seed), Lcg::new(seed));
            let mut ink = Ink::new(path.clone());
            let mut drawn = 0.0;
            let (mut behind_mm, mut ahead_mm) = (0.0_f64, 0.0_f64);
            let step_mm = 0.02 + random.below(300) as f64 / 1_000.0;
            for leg in 1..path.len() {
                if path[leg].pen == Pen::Up {
                    ink.lifted();
                    continue;
                }
                let (begin, end) = (at(&path[leg - 1]), at(&path[leg]));
                let length_mm = distance_mm(&begin, &end);
                let steps = (length_mm / step_mm).ceil().max(1.0) as u64;
                for step in 1..=steps {
                    let mut pen = between(&begin, &end, step as f64 / steps as f64);
                    let noise = |random: &mut Lcg| (random.below(2_001) as f64 / 1_000.0 - 1.0) * 0.02;
                    pen.iter_mut().for_each(|mm| *mm += noise(&mut random));
                    // A tenth of the samples are lost.
                    if random.below(10) > 0 {
                        ink.draws(path[leg].stroke, pen);
                    }
                    let (found, place) = ink.end();
                    if found > 0 {
                        let off_mm = drawn + length_mm * step as f64 / steps as f64 - drawn_mm(&path, found, place);
                        behind_mm = behind_mm.max(off_mm);
                        ahead_mm = ahead_mm.max(-off_mm);
                    }
                }
                drawn += length_mm;
            }
            println!("seed {seed}: steps of {step_mm:.2} mm, at most {behind_mm:.2} mm behind, {ahead_mm:.2} mm ahead");
            assert!(ahead_mm < 1.0, "seed {seed}: {ahead_mm} mm ahead");
            assert!(behind_mm < 3.0, "seed {seed}: {behind_mm} mm behind");
        }
    }

    #[test]
    fn the_ink_goes_back_before_a_stroke_that_is_not_whole_and_on_from_there() {
        let path = dense(3);
        let mut ink = Ink::new(path.clone());
        let first_of = |stroke| path.iter().position(|vertex| vertex.stroke == stroke).unwrap();
        let draw = |ink: &mut Ink, stroke| {
            for leg in first_of(stroke) + 1..first_of(stroke) + 6 {
                let (begin, end) = (at(&path[leg - 1]), at(&path[leg]));
                (0..=200).for_each(|step| ink.draws(stroke, between(&begin, &end, f64::from(step) / 200.0)));
            }
            ink.lifted();
        };
        draw(&mut ink, 2);
        let whole = ink.end();
        ink.back_to(path.len());
        assert_eq!(ink.end(), whole, "it never goes on");
        ink.back_to(first_of(1));
        let before = first_of(1) - 1;
        assert_eq!(ink.end(), (before, Some(path[before].position_um)));
        draw(&mut ink, 1);
        assert_eq!(ink.end(), (first_of(1) + 5, Some(path[first_of(1) + 5].position_um)));
        ink.back_to(0);
        assert_eq!(ink.end(), (0, None));
    }

    #[test]
    fn a_pen_that_leaves_its_path_leaves_the_place_where_it_was() {
        let path = dense(1);
        let mut ink = Ink::new(path.clone());
        let (begin, end) = (at(&path[0]), at(&path[1]));
        ink.draws(0, begin);
        ink.draws(0, between(&begin, &end, 0.1));
        let place = ink.end();
        for step in 0..100 {
            let mut off = between(&begin, &end, 0.1);
            off[2] += 1.0 + f64::from(step);
            ink.draws(0, off);
            ink.draws(0, [f64::NAN; 3]);
            ink.draws(77, begin);
        }
        assert_eq!(ink.end(), place);
        assert_eq!(Ink::new(Vec::new().into()).end(), (0, None));
    }
}
