//! Finds the face in a picture, which is drawn finer than the rest.
//!
//! This is not a face detector but a saliency measure without learned weights. Evidence is skin colour, if the picture
//! has any, and fine detail; it has more weight above the middle, where portraits have their faces. A window is moved
//! to the centre of the evidence in it and fitted to its spread until it no longer moves (mean shift).

use super::raster::Plane;
use image::RgbImage;

/// Typical position of faces in portraits, shares of width and height, and its spread.
const USUAL_PLACE: [f32; 2] = [0.5, 0.33];
const USUAL_SPREAD: [f32; 2] = [0.2, 0.17];
/// Red and blue difference (Rec. 601, 0 to 255) of skin in daylight, and their spread.
const SKIN_RED: [f32; 2] = [150.0, 9.0];
const SKIN_BLUE: [f32; 2] = [110.0, 9.0];
/// Smallest and largest radius of the window, shares of the shorter side.
const RADIUS_RANGE: [f32; 2] = [0.09, 0.3];
/// Moves of the window.
const ROUNDS: usize = 12;

/// How much each pixel belongs to the face, 0 to 1; `picture` and `detail` have equal sizes.
pub(crate) fn focus(picture: &RgbImage, detail: &Plane) -> Plane {
    let (width, height) = (detail.width() as f32, detail.height() as f32);
    let shorter = width.min(height);
    let skin = Plane::from_fn(detail.width(), detail.height(), |x, y| skin_likeness(picture, x, y));
    let coloured = skin.mean() > 0.005;
    let detail = detail.blurred(0.02 * shorter);
    let detail_top = detail.percentile(0.98).max(1e-6);
    let skin = skin.blurred(0.015 * shorter);
    let evidence = Plane::from_fn(detail.width(), detail.height(), |x, y| {
        let away_x = (x as f32 / width - USUAL_PLACE[0]) / USUAL_SPREAD[0];
        let away_y = (y as f32 / height - USUAL_PLACE[1]) / USUAL_SPREAD[1];
        let usual = (-0.5 * (away_x * away_x + away_y * away_y)).exp();
        let (x, y) = (x as isize, y as isize);
        let busy = (detail.at(x, y) / detail_top).min(1.0);
        let likely = if coloured {
            skin.at(x, y) * (0.3 + 0.7 * busy)
        } else {
            busy
        };
        usual * likely
    });
    let (centre, radius) = rest_of_window(&evidence, shorter);
    Plane::from_fn(detail.width(), detail.height(), |x, y| {
        let away = (x as f32 - centre[0]).hypot((y as f32 - centre[1]) / 1.2) / (1.6 * radius);
        1.0 / (1.0 + away.powi(6))
    })
}

fn skin_likeness(picture: &RgbImage, x: usize, y: usize) -> f32 {
    let [red, green, blue] = picture.get_pixel(x as u32, y as u32).0.map(f32::from);
    let luma = 0.299 * red + 0.587 * green + 0.114 * blue;
    let red_difference = 128.0 + 0.713 * (red - luma);
    let blue_difference = 128.0 + 0.564 * (blue - luma);
    let away_red = (red_difference - SKIN_RED[0]) / SKIN_RED[1];
    let away_blue = (blue_difference - SKIN_BLUE[0]) / SKIN_BLUE[1];
    let bright = ((luma - 50.0) / 60.0).clamp(0.0, 1.0);
    bright * (-0.5 * (away_red * away_red + away_blue * away_blue)).exp()
}

/// Final centre and radius of the window, pixels.
fn rest_of_window(evidence: &Plane, shorter: f32) -> ([f32; 2], f32) {
    let start = evidence.blurred(0.06 * shorter);
    let best = (0..start.values().len())
        .max_by(|&a, &b| start.values()[a].total_cmp(&start.values()[b]))
        .unwrap_or(0);
    let mut centre = [(best % start.width()) as f32, (best / start.width()) as f32];
    let mut radius = 0.12 * shorter;
    for _ in 0..ROUNDS {
        let (mut sum, mut sum_x, mut sum_y, mut sum_away) = (1e-9_f64, 0.0, 0.0, 0.0);
        for (k, &value) in evidence.values().iter().enumerate() {
            let (dx, dy) = (
                (k % evidence.width()) as f32 - centre[0],
                (k / evidence.width()) as f32 - centre[1],
            );
            let away = dx * dx + dy * dy;
            let weight = f64::from(value * (-0.5 * away / (1.5 * radius).powi(2)).exp());
            sum += weight;
            sum_x += weight * f64::from(dx);
            sum_y += weight * f64::from(dy);
            sum_away += weight * f64::from(away);
        }
        centre = [centre[0] + (sum_x / sum) as f32, centre[1] + (sum_y / sum) as f32];
        let spread = (sum_away / sum).sqrt() as f32;
        radius = spread.clamp(RADIUS_RANGE[0] * shorter, RADIUS_RANGE[1] * shorter);
    }
    (centre, radius)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn a_patch_of_skin_is_the_focus() {
        let picture = RgbImage::from_fn(200, 200, |x, y| {
            let away = (f64::from(x) - 80.0).hypot(f64::from(y) - 60.0);
            if away < 25.0 {
                Rgb([210, 165, 140])
            } else {
                Rgb([90, 110, 140])
            }
        });
        let detail = Plane::from_fn(200, 200, |x, y| ((x * 7 + y * 13) % 5) as f32);
        let focus = focus(&picture, &detail);
        assert!(focus.at(80, 60) > 0.9, "{}", focus.at(80, 60));
        assert!(focus.at(170, 170) < 0.1, "{}", focus.at(170, 170));
    }

    #[test]
    fn without_colour_the_busiest_place_near_the_usual_one_is_the_focus() {
        let picture = RgbImage::from_pixel(200, 200, Rgb([128; 3]));
        let detail = Plane::from_fn(200, 200, |x, y| {
            if x.abs_diff(110) < 20 && y.abs_diff(70) < 20 {
                1.0
            } else {
                0.0
            }
        });
        let focus = focus(&picture, &detail);
        assert!(focus.at(110, 70) > 0.9);
        assert!(focus.at(20, 180) < 0.1);
    }
}
