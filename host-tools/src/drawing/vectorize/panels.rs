//! What the vectoriser finds in a photograph, stage by stage, as pictures to look at.
//!
//! Every picture comes from the planes that the drawing itself is made of, so it shows what happened, not what should
//! have.

use super::study::Study;
use super::{Frame, VectorizeOptions};
use crate::drawing::line::Point;
use crate::drawing::preview::paint;
use crate::drawing::{DrawingError, Face, Plane, Subject};
use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage};

/// A stage's name and picture.
pub(crate) type Panel = (&'static str, RgbImage);

/// Distance and length of the marks of the direction field, in widths of the pen.
const MARKS_PENS: f64 = 7.0;
const MARK_PENS: f64 = 5.0;
/// Half the length of the cross at an eye or a mouth, in radii of the face.
const CROSS_RADII: f64 = 0.09;
/// Sides of the polygon that approximates a face's oval.
const OVAL_SIDES: u32 = 72;
const BOX_COLOUR: [u8; 3] = [214, 69, 65];
const OVAL_COLOUR: [u8; 3] = [36, 113, 163];
const LANDMARK_COLOUR: [u8; 3] = [240, 180, 0];
const LINE_COLOUR: [u8; 3] = [192, 40, 30];
const INK_COLOUR: [u8; 3] = [20, 20, 20];

/// The stages from a photograph to its lines and tone; `subject` belongs to this very picture.
///
/// # Errors
/// Errors of [`super::vectorize_image`].
pub(crate) fn panels(
    picture: &RgbImage,
    subject: &Subject,
    options: &VectorizeOptions,
) -> Result<Vec<Panel>, DrawingError> {
    let frame = Frame::new(picture.width(), picture.height(), options)?;
    let [width, height] = frame.work_px;
    let photograph = resize(picture, width, height, FilterType::Triangle);
    let study = Study::of(picture, subject, frame, options)?;
    let light = study.with_contrast_in_faces();
    let (strength, _) = study.line_strength(&light);
    let strongest = strength.percentile(0.99).max(1e-3);
    let mut lines = pale(&study.calm);
    for edge in study.lines(options) {
        paint(&mut lines, &edge.points, 0.6 * study.pen, LINE_COLOUR);
    }
    Ok(vec![
        ("photograph", photograph.clone()),
        ("exposure and contrast evened", grey(&light)),
        ("faces and landmarks", with_faces(photograph, &study.faces)),
        ("focus (red), features (blue)", weights(&study)),
        ("kept of the background", grey(&study.kept)),
        ("edges: strength", grey(&strength.map(|value| 1.0 - value / strongest))),
        ("edges: lines traced", lines),
        ("tone: ink required", grey(&study.ink.map(|ink| 1.0 - ink))),
        ("direction field", directions(&study)),
    ])
}

fn byte(value: f32) -> u8 {
    (255.0 * value).round().clamp(0.0, 255.0) as u8
}

fn picture_of(plane: &Plane, colour: impl Fn(isize, isize) -> [u8; 3]) -> RgbImage {
    RgbImage::from_fn(plane.width() as u32, plane.height() as u32, |x, y| {
        Rgb(colour(x as isize, y as isize))
    })
}

fn grey(plane: &Plane) -> RgbImage {
    picture_of(plane, |x, y| [byte(plane.at(x, y)); 3])
}

/// A light copy of a plane, to draw on.
fn pale(plane: &Plane) -> RgbImage {
    grey(&plane.map(|value| 0.7 + 0.3 * value))
}

/// The light, tinted red by the focus and blue by the features of faces.
fn weights(study: &Study) -> RgbImage {
    picture_of(&study.calm, |x, y| {
        let (light, focus) = (study.calm.at(x, y), study.focus.at(x, y).clamp(0.0, 1.0));
        let feature = study.features.at(x, y).clamp(0.0, 1.0);
        let tinted = |share: f32| byte((0.3 + 0.7 * light) * (1.0 - 0.75 * share));
        [
            tinted(feature),
            tinted(focus.max(feature)),
            tinted(focus * (1.0 - feature)),
        ]
    })
}

/// The box of each face, and, where they are known, its oval, eyes and mouth.
fn with_faces(mut picture: RgbImage, faces: &[Face]) -> RgbImage {
    let width = (f64::from(picture.width().max(picture.height())) / 300.0).max(1.0);
    for face in faces {
        let place = |across: f64, down: f64| -> Point {
            let ([c, s], r) = (face.across(), face.radius);
            [
                face.centre[0] + r * (c * across - s * down),
                face.centre[1] + r * (s * across + c * down),
            ]
        };
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]];
        let corners: Vec<Point> = corners.iter().map(|&[across, down]| place(across, down)).collect();
        paint(&mut picture, &corners, width, BOX_COLOUR);
        if !face.has_features {
            continue;
        }
        let oval: Vec<Point> = (0..=OVAL_SIDES)
            .map(|k| {
                let (sine, cosine) = (f64::from(k) / f64::from(OVAL_SIDES) * std::f64::consts::TAU).sin_cos();
                place(cosine, sine * oval_end(sine))
            })
            .collect();
        paint(&mut picture, &oval, width, OVAL_COLOUR);
        for [x, y] in [face.eyes[0], face.eyes[1], face.mouth] {
            let half = CROSS_RADII * face.radius;
            paint(
                &mut picture,
                &[[x - half, y], [x + half, y]],
                1.5 * width,
                LANDMARK_COLOUR,
            );
            paint(
                &mut picture,
                &[[x, y - half], [x, y + half]],
                1.5 * width,
                LANDMARK_COLOUR,
            );
        }
    }
    picture
}

/// Half the oval's height above (negative sine) or below the face's centre, in radii of the face.
fn oval_end(sine: f64) -> f64 {
    if sine < 0.0 {
        crate::drawing::light::ABOVE
    } else {
        crate::drawing::light::TO_CHIN
    }
}

/// Short marks along the directions of hatching.
fn directions(study: &Study) -> RgbImage {
    let mut picture = pale(&study.calm);
    let (step, half) = (MARKS_PENS * study.pen, 0.5 * MARK_PENS * study.pen);
    let count = |length: usize| (length as f64 / step).ceil() as usize;
    for row in 0..count(study.calm.height()) {
        for column in 0..count(study.calm.width()) {
            let [x, y] = [column, row].map(|k| (k as f64 + 0.5) * step);
            let [dx, dy] = study.hatch_flow.tangent([x, y], [1.0, 0.0]).map(|part| half * part);
            paint(
                &mut picture,
                &[[x - dx, y - dy], [x + dx, y + dy]],
                0.5 * study.pen,
                INK_COLOUR,
            );
        }
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dark disk on a bright ground that grows darker to the right.
    fn disk(dim: f64) -> RgbImage {
        RgbImage::from_fn(160, 160, |x, y| {
            let away = (f64::from(x) - 80.0).hypot(f64::from(y) - 80.0);
            let value = if away < 40.0 { 60.0 } else { 230.0 - 0.3 * f64::from(x) };
            Rgb([(dim * value) as u8; 3])
        })
    }

    fn panel<'a>(panels: &'a [Panel], name: &str) -> &'a RgbImage {
        let found = panels.iter().find(|(known, _)| known.starts_with(name));
        &found.unwrap_or_else(|| panic!("no panel {name}")).1
    }

    fn share_of(picture: &RgbImage, is_wanted: impl Fn([u8; 3]) -> bool) -> f64 {
        let count = picture.pixels().filter(|pixel| is_wanted(pixel.0)).count();
        count as f64 / f64::from(picture.width() * picture.height())
    }

    #[test]
    fn each_stage_shows_what_the_photograph_has_at_that_place() {
        let picture = disk(1.0);
        let subject = Subject::of(&picture, None);
        let made = panels(&picture, &subject, &VectorizeOptions::default()).expect("panels");
        let sizes: Vec<_> = made.iter().map(|(_, picture)| picture.dimensions()).collect();
        assert!(sizes.iter().all(|size| *size == sizes[0]), "{sizes:?}");
        let (width, height) = sizes[0];
        let at = |name: &str, x: f64, y: f64| {
            let place = |share: f64, side: u32| (share * f64::from(side)) as u32;
            panel(&made, name).get_pixel(place(x, width), place(y, height)).0[0]
        };
        // Ink in the disk, none on the ground; strength at its rim, none in its middle.
        assert!(at("tone", 0.5, 0.5) + 60 < at("tone", 0.1, 0.1));
        assert!((0..=8).any(|k| at("edges: strength", 0.25 - 0.01 * f64::from(k) + 0.04, 0.5) < 160));
        assert!(at("edges: strength", 0.5, 0.5) > 230);
        let red = |[red, green, blue]: [u8; 3]| red > 120 && green < 100 && blue < 100;
        assert!(share_of(panel(&made, "edges: lines"), red) > 1e-3);
        assert_eq!(share_of(panel(&made, "faces"), |colour| colour == BOX_COLOUR), 0.0);
    }

    #[test]
    fn a_very_dark_photograph_is_shown_with_an_even_exposure() {
        let picture = disk(0.15);
        let subject = Subject::of(&picture, None);
        let made = panels(&picture, &subject, &VectorizeOptions::default()).expect("panels");
        let brightest = |name: &str| panel(&made, name).pixels().map(|pixel| pixel.0[0]).max();
        assert!(brightest("photograph") < Some(60));
        assert!(brightest("exposure") > Some(200));
    }

    #[test]
    fn a_face_that_was_pointed_at_has_a_box_and_no_landmarks() {
        let face = Face::pointed_at([80.0, 80.0, 30.0]);
        let shown = with_faces(RgbImage::from_pixel(160, 160, Rgb([255; 3])), &[face]);
        let has = |x, y, colour| shown.get_pixel(x, y).0 == colour;
        assert!(has(50, 80, BOX_COLOUR) && has(110, 80, BOX_COLOUR) && has(80, 50, BOX_COLOUR));
        assert_eq!(share_of(&shown, |colour| colour == LANDMARK_COLOUR), 0.0);
        let known = Face {
            has_features: true,
            ..face
        };
        let shown = with_faces(RgbImage::from_pixel(160, 160, Rgb([255; 3])), &[known]);
        let [x, y] = known.mouth.map(|value| value as u32);
        assert_eq!(shown.get_pixel(x, y).0, LANDMARK_COLOUR);
    }
}
