//! Finds faces, and the eyes, nose and mouth in each of them.
//!
//! Boxes come from the SeetaFace detector (Wu, Kan, He, Shan and Chen, *Funnel-structured cascade for multi-view face
//! detection with alignment awareness*, 2016), whose model is part of the program. The eyes are the darkest blobs near
//! the places where a face of that box usually has them; the mouth is the darkest row below. Nothing is learned or
//! loaded at run time.

use super::raster::Plane;
use super::render::{grey, reduced};
use image::RgbImage;
use image::imageops::{FilterType, resize};
use rustface::ImageData;

/// The detector's model; its licence (BSD 2-Clause) lies beside it.
const MODEL: &[u8] = include_bytes!("../../assets/faces/seeta_fd_frontal_v1.0.bin");
/// Shorter side of the picture that is searched, and the largest enlargement of a small one.
const SEARCHED_PX: f64 = 480.0;
const ENLARGED_MAX: f64 = 4.0;
/// Longest side of the picture that is searched, pixels.
const SEARCHED_MAX_PX: f64 = 1_600.0;
/// Smallest face, pixels of the picture that is searched.
const FACE_MIN_PX: u32 = 40;
/// Range of light, of 1, below which a picture is stretched.
const RANGE_LOW: f32 = 0.5;
/// Least score of a face.
const SCORE_MIN: f64 = 2.0;
/// Most faces that are kept, the largest first.
const FACES_MAX: usize = 32;
/// Usual places in the box, shares of its side: the eye on the left, the mouth's middle.
const EYE_AT: [f64; 2] = [0.30, 0.40];
const MOUTH_AT: [f64; 2] = [0.5, 0.80];
/// Least distance of the eyes of a face seen from the front, in radii of the face.
const EYES_APART_MIN: f64 = 0.7;
/// Side of the box while its blobs are compared, pixels.
const BOX_PX: f64 = 96.0;

/// A face in a picture; all places and lengths are in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Centre of the face between brows and chin.
    pub centre: [f64; 2],
    /// Half the face's width at the cheekbones.
    pub radius: f64,
    /// The eyes: the one on the picture's left first.
    pub eyes: [[f64; 2]; 2],
    /// Middle of the mouth.
    pub mouth: [f64; 2],
    /// Whether eyes and mouth are known: they are not in a profile, or in a face that was pointed at.
    pub has_features: bool,
}

impl Face {
    /// A face without known features, for a place that a person has pointed at.
    #[must_use]
    pub fn pointed_at([x, y, radius]: [f64; 3]) -> Self {
        Self {
            centre: [x, y],
            radius,
            eyes: [
                [x - 0.45 * radius, y - 0.25 * radius],
                [x + 0.45 * radius, y - 0.25 * radius],
            ],
            mouth: [x, y + 0.6 * radius],
            has_features: false,
        }
    }

    /// This face in a picture that begins at `corner` of this one, scaled by `scale`.
    #[must_use]
    pub fn moved(&self, corner: [f64; 2], scale: f64) -> Self {
        let place = |at: [f64; 2]| [0, 1].map(|k| (at[k] - corner[k]) * scale);
        Self {
            centre: place(self.centre),
            radius: self.radius * scale,
            eyes: self.eyes.map(place),
            mouth: place(self.mouth),
            has_features: self.has_features,
        }
    }

    /// Unit vector from the eye on the left to the one on the right.
    #[must_use]
    pub fn across(&self) -> [f64; 2] {
        let [left, right] = self.eyes;
        let size = (right[0] - left[0]).hypot(right[1] - left[1]).max(1e-9);
        [(right[0] - left[0]) / size, (right[1] - left[1]) / size]
    }

    /// A place relative to the centre in widths of the face's radius: along the line of the eyes, and towards the chin.
    #[must_use]
    pub fn relative(&self, at: [f64; 2]) -> [f64; 2] {
        let [c, s] = self.across();
        let (x, y) = (at[0] - self.centre[0], at[1] - self.centre[1]);
        [(c * x + s * y) / self.radius, (c * y - s * x) / self.radius]
    }
}

/// All faces of a picture, the largest first.
#[must_use]
pub(super) fn find_faces(picture: &RgbImage) -> Vec<Face> {
    let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
    let scale = (SEARCHED_PX / width.min(height))
        .min(ENLARGED_MAX)
        .min(SEARCHED_MAX_PX / width.max(height));
    let side = |length: f64| (length * scale).round().max(20.0) as u32;
    let small = resize(
        &*reduced(picture, 2 * side(width.max(height))),
        side(width),
        side(height),
        FilterType::Triangle,
    );
    let light = with_contrast(&grey(&small));
    let bytes: Vec<u8> = light
        .values()
        .iter()
        .map(|value| (value * 255.0).round().clamp(0.0, 255.0) as u8)
        .collect();
    let Ok(model) = rustface::read_model(MODEL) else {
        return Vec::new();
    };
    let mut detector = rustface::create_detector_with_model(model);
    detector.set_min_face_size(FACE_MIN_PX);
    detector.set_score_thresh(SCORE_MIN);
    detector.set_pyramid_scale_factor(0.8);
    detector.set_slide_window_step(4, 4);
    let found = detector.detect(&ImageData::new(&bytes, small.width(), small.height()));
    let mut faces: Vec<Face> = found
        .iter()
        .map(|face| {
            let place = face.bbox();
            let corner = [f64::from(place.x()), f64::from(place.y())];
            with_features(&light, corner, f64::from(place.width().max(1)))
        })
        .collect();
    faces.sort_by(|a, b| b.radius.total_cmp(&a.radius));
    faces.truncate(FACES_MAX);
    faces.iter().map(|face| face.moved([0.0, 0.0], 1.0 / scale)).collect()
}

/// The light of a dark or flat picture, stretched: the detector has learned from well exposed ones.
fn with_contrast(light: &Plane) -> Plane {
    let (black, white) = (light.percentile(0.01), light.percentile(0.99));
    if white - black > RANGE_LOW {
        return light.clone();
    }
    light.map(|value| ((value - black) / (white - black).max(0.01)).clamp(0.0, 1.0))
}

/// The face in a box with this upper left corner and side.
fn with_features(light: &Plane, corner: [f64; 2], side: f64) -> Face {
    let px = BOX_PX as usize;
    let patch = Plane::from_fn(px, px, |x, y| {
        let at = [x, y].map(|k| (k as f64 + 0.5) / BOX_PX * side);
        light.sample((corner[0] + at[0]) as f32, (corner[1] + at[1]) as f32)
    });
    let blob = patch
        .blurred(10.0)
        .zip(&patch.blurred(2.5), |around, here| around - here);
    let eyes = [EYE_AT, [1.0 - EYE_AT[0], EYE_AT[1]]].map(|usual| best_place(&blob, usual, [0.09, 0.07]));
    let middle = 0.5 * (eyes[0][0] + eyes[1][0]);
    let rows = wide_rows(&patch);
    let mouth = best_place(&rows, [0.4 * MOUTH_AT[0] + 0.6 * middle, MOUTH_AT[1]], [0.04, 0.07]);
    let place = |at: [f64; 2]| [0, 1].map(|k| corner[k] + at[k] * side);
    let between = [0, 1].map(|k| 0.5 * (eyes[0][k] + eyes[1][k]));
    Face {
        centre: place([
            0.5 * between[0] + 0.5 * mouth[0],
            between[1] + 0.45 * (mouth[1] - between[1]),
        ]),
        radius: 0.47 * side,
        eyes: eyes.map(place),
        mouth: place(mouth),
        // Two dark places close together are not the eyes of a face seen from the front.
        has_features: eyes[1][0] - eyes[0][0] > EYES_APART_MIN * 0.47,
    }
}

/// How much darker a short row is than the rows above and below.
fn wide_rows(patch: &Plane) -> Plane {
    let mean = |x: isize, y: isize| (-14..=14).map(|k| patch.at(x + k, y)).sum::<f32>() / 29.0;
    let rows = Plane::from_fn(patch.width(), patch.height(), |x, y| mean(x as isize, y as isize));
    rows.blurred(7.0).zip(&rows.blurred(1.5), |around, here| around - here)
}

/// Place of the largest value, weighted by its distance from the usual place; all in shares of the side.
fn best_place(answer: &Plane, usual: [f64; 2], spread: [f64; 2]) -> [f64; 2] {
    let (mut best, mut best_value) = (usual, 1e-6);
    for y in 0..answer.height() {
        for x in 0..answer.width() {
            let at = [(x as f64 + 0.5) / BOX_PX, (y as f64 + 0.5) / BOX_PX];
            let away = [0, 1].map(|k| (at[k] - usual[k]) / spread[k]);
            let likely = (-0.5 * (away[0] * away[0] + away[1] * away[1])).exp();
            let value = f64::from(answer.at(x as isize, y as isize)) * likely;
            if value > best_value {
                (best, best_value) = (at, value);
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::{Input, load};
    use std::path::Path;

    fn sample(name: &str) -> RgbImage {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../samples").join(name);
        match load(path) {
            Ok(Input::Photograph(picture)) => picture,
            other => panic!("{name}: {other:?}"),
        }
    }

    #[test]
    fn the_face_of_a_portrait_is_found_with_its_eyes_and_mouth() {
        let faces = find_faces(&sample("astronaut.png"));
        let [face] = faces.as_slice() else { panic!("{faces:?}") };
        let near = |place: [f64; 2], expected: [f64; 2]| (place[0] - expected[0]).hypot(place[1] - expected[1]) < 6.0;
        assert!(
            near(face.eyes[0], [203.0, 102.0]) && near(face.eyes[1], [246.0, 103.0]),
            "{face:?}"
        );
        assert!(near(face.mouth, [225.0, 142.0]), "{face:?}");
        assert!(face.has_features && (38.0..54.0).contains(&face.radius), "{face:?}");
    }

    #[test]
    fn a_face_from_the_side_has_no_features() {
        let faces = find_faces(&sample("camera.png"));
        assert!(faces.len() == 1 && !faces[0].has_features, "{faces:?}");
    }

    #[test]
    fn a_turned_or_enlarged_place_stays_the_same_relative_to_its_face() {
        let face = Face::pointed_at([100.0, 50.0, 20.0]);
        let moved = face.moved([40.0, 10.0], 3.0);
        assert_eq!((moved.centre, moved.radius), ([180.0, 120.0], 60.0));
        let [a, b] = [face.relative([110.0, 60.0]), moved.relative([210.0, 150.0])];
        assert!((a[0] - b[0]).abs() < 1e-9 && (a[1] - b[1]).abs() < 1e-9 && (a[0] - 0.5).abs() < 1e-9);
    }

    #[test]
    fn pictures_without_a_face_have_none() {
        let plain = RgbImage::from_fn(120, 90, |x, y| image::Rgb([(x * 2) as u8, (y * 2) as u8, 90]));
        assert_eq!(find_faces(&plain), []);
    }
}
