//! A coarser drawing of a photograph, in which faces give up their detail last.
//!
//! Everything is drawn as if with a wider pen; the ovals of faces with a less wide one, whose strokes are cut at the
//! ovals. One line without a lift cannot be put together from two drawings: it is coarser everywhere.

use super::{DrawingError, Frame, Style, VectorizeOptions, vectorize_subject};
use crate::drawing::clip::{Region, clip};
use crate::drawing::face::Face;
use crate::drawing::light::{ABOVE, TO_CHIN};
use crate::drawing::subject::Subject;
use crate::drawing::{Drawing, Stroke};
use image::RgbImage;
use std::f64::consts::TAU;

/// Exponent from the pen's width elsewhere to that in faces, both as multiples of the real one.
const IN_FACES: f64 = 0.5;
/// Corners of an oval.
const CORNERS: usize = 72;
/// Shortest piece of a stroke that is kept after a cut, widths of the pen.
const PIECE_MIN_PENS: f64 = 2.0;

/// Draws a photograph as if with a pen `widths` times as wide, at least 1, faces less so; `subject` belongs to this very
/// picture.
///
/// # Errors
/// Errors of [`vectorize_subject`] if neither faces nor the rest can be drawn.
pub(crate) fn vectorize_coarser(
    picture: &RgbImage,
    subject: &Subject,
    options: &VectorizeOptions,
    widths: f64,
) -> Result<Drawing, DrawingError> {
    let with_pen = |widths: f64| VectorizeOptions {
        pen_width_mm: widths * options.pen_width_mm,
        ..*options
    };
    let coarse = vectorize_subject(picture, subject, &with_pen(widths));
    let known: Vec<&Face> = subject.faces.iter().filter(|face| face.has_features).collect();
    if widths <= 1.0 || options.style == Style::Tsp || known.is_empty() {
        return coarse;
    }
    let fine = vectorize_subject(picture, subject, &with_pen(widths.powf(IN_FACES)))?;
    let frame = Frame::new(picture.width(), picture.height(), options)?;
    let mm_per_px = frame.size_mm[0] / f64::from(picture.width().max(1));
    let to_sheet = |at: [f64; 2]| [0, 1].map(|k| frame.corner_mm[k] + at[k] * mm_per_px);
    let ovals: Vec<Vec<[f64; 2]>> = known.iter().map(|face| oval(face).map(to_sheet).collect()).collect();
    let shortest_mm = PIECE_MIN_PENS * options.pen_width_mm;
    let inside: Vec<Region> = ovals
        .iter()
        .map(|oval| Region::new(vec![oval.clone()], false))
        .collect();
    let mut strokes = cut(fine.strokes, &inside, shortest_mm);
    let mut outside = coarse.map_or(Vec::new(), |coarse| coarse.strokes);
    for oval in ovals {
        let [width, height] = options.sheet_mm;
        let sheet = vec![[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]];
        outside = cut(outside, &[Region::new(vec![sheet, oval], true)], shortest_mm);
    }
    strokes.extend(outside);
    Ok(Drawing {
        sheet_mm: options.sheet_mm,
        strokes,
    })
}

/// Whether a point of the sheet, mm, is in the oval of a face whose features are known.
///
/// # Errors
/// The sheet is too small for its margin.
pub(crate) fn in_faces<'a>(
    picture: &RgbImage,
    subject: &'a Subject,
    options: &VectorizeOptions,
) -> Result<impl Fn([f64; 2]) -> bool + use<'a>, DrawingError> {
    let frame = Frame::new(picture.width(), picture.height(), options)?;
    let px_per_mm = f64::from(picture.width().max(1)) / frame.size_mm[0];
    Ok(move |at_mm: [f64; 2]| {
        let at_px = [0, 1].map(|k| (at_mm[k] - frame.corner_mm[k]) * px_per_mm);
        let known = subject.faces.iter().filter(|face| face.has_features);
        known.map(|face| face.relative(at_px)).any(|[across, down]| {
            let end = if down > 0.0 { TO_CHIN } else { ABOVE };
            across.hypot(down / end) < 1.0
        })
    })
}

/// The corners of the oval of a face, pixels.
fn oval(face: &Face) -> impl Iterator<Item = [f64; 2]> {
    let ([c, s], centre, radius) = (face.across(), face.centre, face.radius);
    (0..CORNERS).map(move |corner| {
        let (down, across) = (TAU * corner as f64 / CORNERS as f64).sin_cos();
        let down = down * if down > 0.0 { TO_CHIN } else { ABOVE };
        [
            centre[0] + radius * (c * across - s * down),
            centre[1] + radius * (s * across + c * down),
        ]
    })
}

/// The pieces of strokes inside one of the regions that are not too short.
fn cut(strokes: Vec<Stroke>, regions: &[Region], shortest_mm: f64) -> Vec<Stroke> {
    let pieces = strokes.into_iter().flat_map(|stroke| {
        // A stroke that is too much work stays whole.
        let pieces = clip(&stroke.points, regions, &mut 0);
        let is_whole = |pieces: &Vec<Vec<[f64; 2]>>| pieces.len() == 1 && pieces.first() == Some(&stroke.points);
        match pieces.filter(|pieces| !is_whole(pieces)) {
            None => vec![stroke],
            Some(pieces) => pieces
                .into_iter()
                .map(|points| Stroke { points })
                .filter(|piece| piece.length_mm() >= shortest_mm)
                .collect(),
        }
    });
    pieces.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_oval_is_where_a_face_is_also_when_it_is_tilted() {
        let mut face = Face::pointed_at([100.0, 80.0, 20.0]);
        for tilt in [0.0_f64, 0.4, -0.7] {
            let (s, c) = tilt.sin_cos();
            face.eyes = [[100.0 - 9.0 * c, 75.0 - 9.0 * s], [100.0 + 9.0 * c, 75.0 + 9.0 * s]];
            for corner in oval(&face) {
                let [across, down] = face.relative(corner);
                let end = if down > 0.0 { TO_CHIN } else { ABOVE };
                assert!((across.hypot(down / end) - 1.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn pieces_inside_and_outside_make_up_a_stroke() {
        let face = Face::pointed_at([50.0, 50.0, 10.0]);
        let corners: Vec<[f64; 2]> = oval(&face).collect();
        let stroke = Stroke {
            points: vec![[10.0, 50.0], [90.0, 51.0], [50.0, 90.0]],
        };
        let sheet = vec![[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]];
        let inside = cut(vec![stroke.clone()], &[Region::new(vec![corners.clone()], false)], 0.5);
        let outside = cut(vec![stroke.clone()], &[Region::new(vec![sheet, corners], true)], 0.5);
        assert_eq!((inside.len(), outside.len()), (1, 2));
        let length = |strokes: &[Stroke]| strokes.iter().map(Stroke::length_mm).sum::<f64>();
        assert!((length(&inside) + length(&outside) - stroke.length_mm()).abs() < 1e-6);
        assert!((length(&inside) - 20.0).abs() < 0.1);
    }
}
