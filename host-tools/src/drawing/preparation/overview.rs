//! A photograph as a whole, and the part of it that is drawn, to be shown beside the drawing.

use image::{RgbImage, imageops};
use serde::{Deserialize, Serialize};

/// Largest side of the small copy, pixels.
const SMALL_SIDE_MAX: u32 = 640;

/// A photograph as a whole.
#[derive(Clone, Debug)]
pub struct Overview {
    /// The part that is drawn.
    pub part: PhotographPart,
    /// A small copy of the upright photograph, each side at most 640 pixels.
    pub small: RgbImage,
}

/// The part of a photograph that is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotographPart {
    /// Width and height of the upright photograph, pixels.
    pub size_px: [u32; 2],
    /// Left, top, width and height of the part, pixels of the upright photograph.
    pub window_px: [u32; 4],
    /// Centre and radius of the largest face, pixels of the upright photograph; `None` without a face.
    pub face_px: Option<[f64; 3]>,
}

/// A copy of a picture, each side at most 640 pixels.
pub(super) fn small_copy(picture: &RgbImage) -> RgbImage {
    let (width, height) = picture.dimensions();
    let scale = f64::from(SMALL_SIDE_MAX) / f64::from(width.max(height).max(1));
    if scale >= 1.0 {
        return picture.clone();
    }
    let side = |length: u32| ((f64::from(length) * scale).round() as u32).max(1);
    imageops::thumbnail(picture, side(width), side(height))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn a_copy_has_the_shape_and_the_tones_of_the_picture_and_is_never_larger() {
        let picture = |width: u32, height: u32| {
            RgbImage::from_fn(width, height, |x, _| Rgb([if 2 * x < width { 20 } else { 220 }; 3]))
        };
        for (width, height, small) in [
            (64, 40, (64, 40)),
            (1_280, 720, (640, 360)),
            (700, 1_400, (320, 640)),
            (6_400, 20, (640, 2)),
        ] {
            let copy = small_copy(&picture(width, height));
            assert_eq!(copy.dimensions(), small);
            let right = copy.width() - 1;
            assert_eq!(
                (copy.get_pixel(0, 0).0, copy.get_pixel(right, 0).0),
                ([20; 3], [220; 3])
            );
        }
    }
}
