//! The light of a photograph, evened before lines are looked for.
//!
//! The range from black to white is stretched, and dark pictures are brightened: a face decides over its own
//! brightness, so that a face before a bright window keeps its shades. Inside a face the range is that of the sitter's
//! own skin, so that dark and light skin get the same amount of white paper.

use super::face::Face;
use super::raster::Plane;

/// Shares of all pixels that become black and white.
const BLACK_SHARE: f32 = 0.01;
const WHITE_SHARE: f32 = 0.985;
/// Least difference of black and white, of 1, for a picture that shows anything.
const RANGE_MIN: f32 = 0.02;
/// Median lightness of a dark face, of the range from black to white; white above its brightest skin, of the same range.
const DARK_FACE: f32 = 0.33;
const ABOVE_SKIN: f32 = 1.2;
/// Median lightness that a face gets, and the least one of a picture without a face.
const FACE_MEDIAN: f32 = 0.6;
const MEDIAN_MIN: f32 = 0.25;
/// Range of the exponents that brighten or darken.
const EXPONENTS: [f32; 2] = [0.5, 1.15];
/// Ends of a face's oval above its centre, at the chin, and at the neck, in face radii.
pub(super) const ABOVE: f64 = 1.22;
pub(super) const TO_CHIN: f64 = 1.22;
pub(super) const TO_NECK: f64 = 1.75;
/// Shares of the pixels of a face that become its darkest shade and white.
const SHADE_SHARE: f32 = 0.03;
const SKIN_WHITE_SHARE: f32 = 0.8;
/// Share of the wide shades of a face that is evened out, and their width in radii of the face.
const FLATTENED: f32 = 0.4;
const WIDE_RADII: f64 = 0.6;
/// Least and largest stretch of a face's range.
const STRETCH: [f32; 2] = [0.8, 1.7];

/// How much each pixel belongs to the ovals of these faces, 0 to 1; `below` is the oval's lower end, in face radii from
/// the face's centre.
pub(super) fn ovals(width: usize, height: usize, faces: &[Face], below: f64) -> Plane {
    Plane::from_fn(width, height, |x, y| {
        let cover = faces.iter().filter(|face| face.has_features).map(|face| {
            let [across, down] = face.relative([x as f64, y as f64]);
            let end = if down > 0.0 { below } else { ABOVE };
            let away = across.hypot(down / end) as f32;
            1.0 / (1.0 + away.powi(10))
        });
        cover.fold(0.0, f32::max)
    })
}

/// The lightness with an even exposure, 0 to 1; `None` if the picture has one tone only.
pub(super) fn exposed(light: &Plane, ovals: &Plane) -> Option<Plane> {
    let (black, white) = (light.percentile(BLACK_SHARE), light.percentile(WHITE_SHARE));
    if white - black < RANGE_MIN {
        return None;
    }
    let white = white_of_dark_faces(light, ovals, black, white);
    let stretched = light.map(|value| ((value - black) / (white - black)).clamp(0.0, 1.0));
    let skin = inside(&stretched, ovals);
    let exponent = match percentile(skin, 0.5) {
        Some(median) => (FACE_MEDIAN.ln() / median.clamp(0.02, 0.98).ln()).sqrt(),
        None => {
            let median = stretched.percentile(0.5).max(0.02);
            if median < MEDIAN_MIN {
                MEDIAN_MIN.ln() / median.ln()
            } else {
                1.0
            }
        }
    };
    let exponent = exponent.clamp(EXPONENTS[0], EXPONENTS[1]);
    Some(stretched.map(|value| value.powf(exponent)))
}

/// White for a picture whose faces are dark before a bright background, which may lose its shades.
fn white_of_dark_faces(light: &Plane, ovals: &Plane, black: f32, white: f32) -> f32 {
    let skin = inside(light, ovals);
    let (Some(median), Some(bright)) = (percentile(skin.clone(), 0.5), percentile(skin, 0.97)) else {
        return white;
    };
    if median - black > DARK_FACE * (white - black) {
        return white;
    }
    (black + ABOVE_SKIN * (bright - black).max(RANGE_MIN)).min(white)
}

/// The lightness of skin, stretched to the range of the skin inside the ovals; `radius` is that of the largest face, pixels.
pub(super) fn with_even_skin(light: &Plane, ovals: &Plane, radius: f64) -> Plane {
    // A cheek in the shadow stays a shade darker, not a beard.
    let wide = light.blurred((WIDE_RADII * radius) as f32);
    let Some(middle) = percentile(inside(&wide, ovals), 0.5) else {
        return light.clone();
    };
    let flat = light.zip(&wide, |value, wide| value + FLATTENED * (middle - wide));
    let skin = inside(&flat, ovals);
    let (Some(dark), Some(white)) = (
        percentile(skin.clone(), SHADE_SHARE),
        percentile(skin, SKIN_WHITE_SHARE),
    ) else {
        return light.clone();
    };
    let stretch = (0.88 / (white - dark).max(0.05)).clamp(STRETCH[0], STRETCH[1]);
    flat.map(|value| (0.96 + stretch * (value - white)).clamp(0.0, 1.0))
}

/// How dark each pixel is within the range of the face, 0 (light skin) to 1 (pupils); 0 without a face.
pub(super) fn darkness_in_faces(light: &Plane, ovals: &Plane) -> Plane {
    let face = inside(light, ovals);
    let (Some(dark), Some(white)) = (percentile(face.clone(), 0.01), percentile(face, SKIN_WHITE_SHARE)) else {
        return light.map(|_| 0.0);
    };
    light.map(|value| ((white - value) / (white - dark).max(0.1)).clamp(0.0, 1.0))
}

/// Values inside the ovals.
fn inside(light: &Plane, ovals: &Plane) -> Vec<f32> {
    let pairs = light.values().iter().zip(ovals.values());
    pairs
        .filter(|(_, cover)| **cover > 0.7)
        .map(|(value, _)| *value)
        .collect()
}

fn percentile(mut values: Vec<f32>, fraction: f32) -> Option<f32> {
    if values.is_empty() {
        return None;
    }
    let k = ((values.len() - 1) as f32 * fraction) as usize;
    Some(*values.select_nth_unstable_by(k, f32::total_cmp).1)
}
