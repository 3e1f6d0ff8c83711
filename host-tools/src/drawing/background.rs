//! Separates the subject of a portrait from its background.
//!
//! A head and shoulders of usual shape around each face say where the subject is likely. The colours inside and outside
//! of that shape correct it: histograms of both give each pixel's likelihood, and a filter guided by the picture moves
//! the soft edge to the picture's own edges. Where the colours of subject and background do not differ, the shape alone
//! decides, so that the edge is never torn.

use super::face::Face;
use super::raster::Plane;
use super::render::{grey, reduced};
use image::RgbImage;
use image::imageops::{FilterType, resize};

/// Longest side of the picture in which the colours are compared, pixels.
const SIDE_PX: f64 = 320.0;
/// Steps of each colour in the histograms.
const STEPS: usize = 12;
/// Rounds of learning the colours and judging the pixels.
const ROUNDS: usize = 4;
/// Largest influence of a pixel's colour, and of its place, as logarithms of odds.
const COLOUR_MAX: f32 = 4.0;
const PLACE_MAX: f32 = 4.0;
/// Least difference of the mean judgement of sure subject and sure background by colour alone, as a logarithm of odds.
const SEPARATION_MIN: f32 = 1.2;

/// Least radius of a face in a portrait, as a share of the picture's shorter side. A smaller one stands in a scene.
const PORTRAIT_RADIUS: f64 = 0.09;

/// What is drawn of the background.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Background {
    /// All of it.
    Keep,
    /// Less with the distance from the subject.
    #[default]
    Fade,
    /// Nothing.
    None,
}

impl Background {
    /// The names of all kinds.
    pub const NAMES: [&'static str; 3] = ["keep", "fade", "none"];

    /// The kind with a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "keep" => Some(Self::Keep),
            "fade" => Some(Self::Fade),
            "none" => Some(Self::None),
            _ => None,
        }
    }
}

/// Whether the largest of these faces is the subject of a picture of this size, pixels.
pub(super) fn is_portrait(faces: &[Face], [width, height]: [usize; 2]) -> bool {
    let radius = faces.iter().map(|face| face.radius).fold(0.0, f64::max);
    radius >= PORTRAIT_RADIUS * width.min(height) as f64
}

/// How much each pixel of a small copy of the picture belongs to a subject with these faces, 0 to 1; `None` without a
/// face, or if neither colours nor the face's size tell the subject from the scene around it.
pub(super) fn subject_mask(picture: &RgbImage, faces: &[Face]) -> Option<Plane> {
    if faces.is_empty() {
        return None;
    }
    let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
    let scale = (SIDE_PX / width.max(height)).min(1.0);
    let side = |length: f64| (length * scale).round().max(8.0) as u32;
    let small = resize(
        &*reduced(picture, 2 * SIDE_PX as u32),
        side(width),
        side(height),
        FilterType::Triangle,
    );
    let faces: Vec<Face> = faces.iter().map(|face| face.moved([0.0, 0.0], scale)).collect();
    let place = Plane::from_fn(small.width() as usize, small.height() as usize, |x, y| {
        let odds = faces
            .iter()
            .map(|face| odds_of_place(face.relative([x as f64, y as f64])));
        odds.fold(-PLACE_MAX, f32::max)
    });
    let radius = faces.iter().map(|face| face.radius).fold(0.0, f64::max);
    let judged = match judged_by_colour(&small, &place) {
        Some(judged) => judged,
        None if is_portrait(&faces, [small.width() as usize, small.height() as usize]) => place.map(share),
        None => return None,
    };
    let guide = grey(&small);
    Some(guided(&judged, &guide, ((0.12 * radius) as usize).clamp(2, 8)).map(|value| value.clamp(0.0, 1.0)))
}

/// Odds of a place in face radii from the face's centre, as a logarithm.
fn odds_of_place([across, down]: [f64; 2]) -> f32 {
    let head = (across / 1.25).hypot((down + 0.25) / 1.6);
    let slope = ((down - 1.0) / 1.6).clamp(0.0, 1.0);
    let half_width = 0.7 + 2.1 * slope * slope * (3.0 - 2.0 * slope) + 0.5 * (down - 2.6).max(0.0);
    let above_shoulders = ((1.15 - down) / 0.5).max(0.0);
    let body = across.abs() / half_width + above_shoulders;
    // A head has one shape; bodies lean and turn.
    let head = 7.0 * (1.12 - head);
    let body = 3.0 * (1.1 - body);
    (head.max(body) as f32).clamp(-PLACE_MAX, PLACE_MAX)
}

fn share(odds: f32) -> f32 {
    1.0 / (1.0 + (-odds).exp())
}

/// The subject by place and colour; `None` if the colours do not separate it from the background.
fn judged_by_colour(picture: &RgbImage, place: &Plane) -> Option<Plane> {
    let cells: Vec<usize> = picture.pixels().map(|pixel| cell(pixel.0)).collect();
    let mut judged = place.map(share);
    let mut colour = Plane::filled(place.width(), place.height(), 0.0);
    for _ in 0..ROUNDS {
        let mut counts = [vec![0.0_f32; STEPS.pow(3)], vec![0.0_f32; STEPS.pow(3)]];
        for (&cell, &share) in cells.iter().zip(judged.values()) {
            for (counts, weight) in counts.iter_mut().zip([share, 1.0 - share]) {
                if let Some(count) = counts.get_mut(cell) {
                    *count += weight * weight;
                }
            }
        }
        let [inside, outside] = counts.map(|counts| frequencies(&counts));
        let odds: Vec<f32> = inside
            .iter()
            .zip(&outside)
            .map(|(a, b)| (a / b).ln().clamp(-COLOUR_MAX, COLOUR_MAX))
            .collect();
        let width = place.width();
        colour = Plane::from_fn(width, place.height(), |x, y| {
            cells
                .get(y * width + x)
                .and_then(|&cell| odds.get(cell))
                .copied()
                .unwrap_or_default()
        })
        .blurred(1.2);
        judged = colour.zip(place, |colour, place| share(colour + place));
    }
    let mean_where = |keep: &dyn Fn(f32) -> bool| {
        let chosen = colour
            .values()
            .iter()
            .zip(place.values())
            .filter(|(_, place)| keep(**place));
        let (sum, count) = chosen.fold((0.0, 0.0_f32), |(sum, count), (colour, _)| (sum + colour, count + 1.0));
        sum / count.max(1.0)
    };
    let separation = mean_where(&|place| place > 2.0) - mean_where(&|place| place < -2.0);
    (separation > SEPARATION_MIN).then_some(judged)
}

/// Cell of a colour in the histograms.
fn cell(colour: [u8; 3]) -> usize {
    colour
        .iter()
        .fold(0, |cell, &value| cell * STEPS + usize::from(value) * STEPS / 256)
}

/// Frequencies of all cells, spread into the neighbouring ones.
fn frequencies(counts: &[f32]) -> Vec<f32> {
    let mut spread = counts.to_vec();
    for stride in [1, STEPS, STEPS * STEPS] {
        let before = spread.clone();
        for (k, value) in spread.iter_mut().enumerate() {
            let digit = k / stride % STEPS;
            let beside = |inside: bool, other: usize| {
                if inside {
                    before.get(other).copied().unwrap_or_default()
                } else {
                    0.0
                }
            };
            let both = beside(digit > 0, k.wrapping_sub(stride)) + beside(digit + 1 < STEPS, k + stride);
            *value = 0.6 * *value + 0.2 * both;
        }
    }
    let sum: f32 = spread.iter().sum::<f32>().max(1.0);
    let floor = 0.5 / sum;
    spread.iter().map(|value| value / sum + floor).collect()
}

/// `plane` smoothed along the edges of `guide` (guided filter, He, Sun and Tang, 2010).
fn guided(plane: &Plane, guide: &Plane, radius: usize) -> Plane {
    const NOISE: f32 = 0.02;
    let (mean_guide, mean_plane) = (guide.averaged(radius), plane.averaged(radius));
    let both = guide.zip(plane, |a, b| a * b).averaged(radius);
    let square = guide.map(|value| value * value).averaged(radius);
    let covariance = both.zip(&mean_guide.zip(&mean_plane, |a, b| a * b), |both, product| {
        both - product
    });
    let variance = square.zip(&mean_guide, |square, mean| {
        (square - mean * mean).max(0.0) + NOISE * NOISE
    });
    let slope = covariance.zip(&variance, |covariance, variance| covariance / variance);
    let offset = mean_plane.zip(&slope.zip(&mean_guide, |slope, mean| slope * mean), |mean, part| {
        mean - part
    });
    let (slope, offset) = (slope.averaged(radius), offset.averaged(radius));
    slope
        .zip(guide, |slope, value| slope * value)
        .zip(&offset, |part, offset| part + offset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// A head with shoulders before a wall, and its face.
    fn portrait(skin: [u8; 3], coat: [u8; 3], wall: [u8; 3]) -> (RgbImage, Face) {
        let picture = RgbImage::from_fn(300, 300, |x, y| {
            let (across, down) = ((f64::from(x) - 150.0) / 40.0, (f64::from(y) - 110.0) / 40.0);
            let noise = (x * 7 + y * 13) % 9;
            let colour = if across.hypot((down + 0.2) / 1.4) < 1.15 {
                skin
            } else if down > 1.3 && across.abs() < 0.9 + 1.1 * (down - 1.3) {
                coat
            } else {
                wall
            };
            Rgb(colour.map(|value| value.saturating_add(noise as u8)))
        });
        (picture, Face::pointed_at([150.0, 110.0, 40.0]))
    }

    fn at(mask: &Plane, x: isize, y: isize) -> f32 {
        mask.at(x, y)
    }

    #[test]
    fn subject_and_background_are_separated_by_their_colours() {
        let (picture, face) = portrait([200, 160, 140], [60, 30, 30], [90, 120, 190]);
        let mask = subject_mask(&picture, &[face]).expect("a mask");
        for (x, y) in [(150, 110), (150, 280), (100, 260), (150, 60)] {
            assert!(at(&mask, x, y) > 0.8, "{x}, {y}: {}", at(&mask, x, y));
        }
        for (x, y) in [(20, 20), (280, 100), (70, 110), (20, 200)] {
            assert!(at(&mask, x, y) < 0.2, "{x}, {y}: {}", at(&mask, x, y));
        }
    }

    #[test]
    fn where_colours_do_not_differ_the_edge_is_soft_and_whole() {
        let (picture, face) = portrait([120; 3], [120; 3], [120; 3]);
        let mask = subject_mask(&picture, &[face]).expect("a mask");
        assert!(at(&mask, 150, 110) > 0.9 && at(&mask, 5, 5) < 0.2);
        for y in 0..300 {
            for x in 1..300 {
                let step = (at(&mask, x, y) - at(&mask, x - 1, y)).abs();
                assert!(step < 0.2, "{x}, {y}: {step}");
            }
        }
    }

    #[test]
    fn a_picture_without_a_face_and_a_scene_of_one_colour_have_no_subject() {
        let (picture, face) = portrait([120; 3], [120; 3], [120; 3]);
        assert!(subject_mask(&picture, &[]).is_none());
        let small = Face { radius: 10.0, ..face };
        assert!(subject_mask(&picture, &[small]).is_none());
    }
}
