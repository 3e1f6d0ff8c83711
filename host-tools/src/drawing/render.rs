//! Strokes as pictures: what the pen leaves on the paper, and how well its tone matches a photograph.
//!
//! Used both for the intended drawing and for the ink of the virtual robot's pen. A picture shows exactly the whole
//! sheet, so it can be compared with a photograph that fills the sheet.

use super::line::{self, Point};
use super::raster::Plane;
use super::{Artwork, DrawingError, Layer, Stroke, UserSpace};
use image::imageops::{FilterType, resize, thumbnail};
use image::{ImageFormat, Rgb, RgbImage};
use std::borrow::Cow;
use std::fmt::Write as _;
use std::io::Cursor;

/// Colour of untouched paper.
const PAPER: [f32; 3] = [252.0, 251.0, 247.0];
/// Colour of a single layer of ink.
const INK: [f32; 3] = [24.0, 26.0, 38.0];
/// Share of pixels whose gradients are not strong edges, and largest distance of ink from an edge, pixels.
const EDGE_PERCENTILE: f32 = 0.95;
const EDGE_REACH_PX: isize = 2;
/// Width of the lines of written artwork, mm.
const LINE_MM: f64 = 0.3;
/// Largest side of a rendered picture, pixels.
const SIDE_PX_MAX: f64 = 20_000.0;
/// Width at which tones are compared, pixels.
const COMPARE_WIDTH_PX: u32 = 512;
/// Blur with which tones are compared, pixels.
const COMPARE_SIGMA_PX: f32 = 12.0;

/// The sheet with the strokes on it, dark ink on white paper, antialiased.
///
/// `sheet_mm` is width and height, `pen_width_mm` the width of a line, `px_per_mm` the scale; a side is at least one and
/// at most 20 000 pixels.
#[must_use]
pub fn render_rgb(strokes: &[Stroke], sheet_mm: [f64; 2], pen_width_mm: f64, px_per_mm: f64) -> RgbImage {
    let side = |mm: f64| (mm * px_per_mm).round().clamp(1.0, SIDE_PX_MAX) as usize;
    let mut ink = Plane::filled(side(sheet_mm[0]), side(sheet_mm[1]), 0.0);
    for stroke in strokes {
        let points: Vec<Point> = stroke.points.iter().map(|p| p.map(|mm| mm * px_per_mm - 0.5)).collect();
        draw_line(&mut ink, &points, pen_width_mm * px_per_mm);
    }
    RgbImage::from_fn(ink.width() as u32, ink.height() as u32, |x, y| {
        let ink = ink.at(x as isize, y as isize);
        Rgb([0, 1, 2].map(|k| (PAPER[k] + (INK[k] - PAPER[k]) * ink).round() as u8))
    })
}

/// [`render_rgb`] as the bytes of a PNG file.
///
/// # Errors
///
/// [`DrawingError::Unsupported`] if the picture cannot be encoded.
pub fn render_png(
    strokes: &[Stroke],
    sheet_mm: [f64; 2],
    pen_width_mm: f64,
    px_per_mm: f64,
) -> Result<Vec<u8>, DrawingError> {
    let mut bytes = Cursor::new(Vec::new());
    render_rgb(strokes, sheet_mm, pen_width_mm, px_per_mm)
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|_| DrawingError::Unsupported)?;
    Ok(bytes.into_inner())
}

/// Adds the ink of a round pen of `width` pixels along the line; 1 is full ink.
pub(crate) fn draw_line(ink: &mut Plane, points: &[Point], width: f64) {
    let radius = 0.5 * width;
    let reach = radius + 1.0;
    let (columns, rows) = (ink.width() as f64, ink.height() as f64);
    for pair in points.windows(2) {
        let span = |axis: usize, end: f64| {
            let (a, b) = (pair[0][axis], pair[1][axis]);
            (
                (a.min(b) - reach).floor().max(0.0) as isize,
                (a.max(b) + reach).ceil().min(end - 1.0) as isize,
            )
        };
        let ((left, right), (top, bottom)) = (span(0, columns), span(1, rows));
        for y in top..=bottom {
            for x in left..=right {
                let away = line::distance_to_segment([x as f64, y as f64], pair[0], pair[1]);
                let covered = (radius + 0.5 - away).clamp(0.0, width.min(1.0)) as f32;
                if covered > ink.at(x, y) {
                    ink.set(x, y, covered);
                }
            }
        }
    }
}

/// The strokes as an SVG document in true scale: one unit is one millimetre.
#[must_use]
pub fn write_svg(strokes: &[Stroke], sheet_mm: [f64; 2], pen_width_mm: f64) -> String {
    let [width, height] = sheet_mm;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" \
         viewBox=\"0 0 {width} {height}\" style=\"background:#fcfbf7\">\n<g fill=\"none\" stroke=\"#181a26\" stroke-width=\"{pen_width_mm}\" stroke-linecap=\"round\" \
         stroke-linejoin=\"round\">\n"
    );
    for stroke in strokes {
        svg.push_str("<polyline points=\"");
        for (k, [x, y]) in stroke.points.iter().enumerate() {
            let separator = if k == 0 { "" } else { " " };
            // Writing into a string cannot fail.
            let _ = write!(svg, "{separator}{x:.3},{y:.3}");
        }
        svg.push_str("\"/>\n");
    }
    svg.push_str("</g>\n</svg>\n");
    svg
}

/// Artwork as an SVG in the coordinates of its source file: with its width, height and viewBox, and one group for each
/// run of strokes of one layer.
#[must_use]
pub fn write_artwork(artwork: &Artwork) -> String {
    let UserSpace {
        attributes,
        units_per_mm,
        origin,
    } = &artwork.user_space;
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:inkscape=\"http://www.inkscape.org/namespaces/inkscape\"",
    );
    // Writing into a string cannot fail.
    for (name, value) in attributes {
        let _ = write!(svg, " {name}=\"{}\"", escaped(value));
    }
    if let (true, Some([width, height])) = (attributes.is_empty(), artwork.page_mm) {
        let _ = write!(
            svg,
            " width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\""
        );
    }
    let width = LINE_MM * units_per_mm[0];
    let _ = writeln!(
        svg,
        ">\n<g fill=\"none\" stroke-width=\"{width:.4}\" stroke-linecap=\"round\" stroke-linejoin=\"round\">"
    );
    // A thousandth of a millimetre in any unit.
    let places = (3.0 - units_per_mm[0].min(units_per_mm[1]).log10())
        .ceil()
        .clamp(0.0, 9.0) as usize;
    for run in artwork.strokes.chunk_by(|before, after| before.layer == after.layer) {
        let layer = run.first().and_then(|stroke| artwork.layers.get(stroke.layer));
        let Layer { name, colour } = layer.cloned().unwrap_or_default();
        let [red, green, blue] = colour;
        let _ = writeln!(
            svg,
            "<g inkscape:groupmode=\"layer\" inkscape:label=\"{}\" stroke=\"#{red:02x}{green:02x}{blue:02x}\">",
            escaped(&name)
        );
        for stroke in run {
            svg.push_str("<polyline points=\"");
            for (k, point) in stroke.stroke.points.iter().enumerate() {
                let [x, y] = [0, 1].map(|axis| origin[axis] + point[axis] * units_per_mm[axis]);
                let _ = write!(svg, "{}{x:.places$},{y:.places$}", if k == 0 { "" } else { " " });
            }
            svg.push_str("\"/>\n");
        }
        svg.push_str("</g>\n");
    }
    svg.push_str("</g>\n</svg>\n");
    svg
}

/// A text escaped for use as an attribute value.
fn escaped(text: &str) -> String {
    let mut result = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => result.push_str("&amp;"),
            '<' => result.push_str("&lt;"),
            '"' => result.push_str("&quot;"),
            other => result.push(other),
        }
    }
    result
}

/// How well the tones of a drawing follow a photograph: correlation (-1 to 1) of both in grey, blurred.
///
/// The rendered sheet is compared with the photograph as a whole: both are resized to 512 pixels in width, the drawing
/// to the photograph's aspect ratio, and blurred with sigma 12 pixels. Pictures of one tone give 0. If the photograph
/// does not fill the sheet, crop the rendered sheet to `VectorizeOptions::picture_mm` first.
#[must_use]
pub fn tone_correlation(photograph: &RgbImage, rendered: &RgbImage) -> f64 {
    let (width, height) = photograph.dimensions();
    let height = (u64::from(height) * u64::from(COMPARE_WIDTH_PX) / u64::from(width.max(1))).clamp(1, 8192) as u32;
    let tone = |picture: &RgbImage| {
        let small = resize(picture, COMPARE_WIDTH_PX, height, FilterType::Triangle);
        grey(&small).blurred(COMPARE_SIGMA_PX)
    };
    correlation(&tone(photograph), &tone(rendered))
}

/// Share of a photograph's strong edges with ink next to them, 0 to 1.
///
/// Both pictures are resized as for [`tone_correlation`]. Strong edges are the twentieth of all pixels with the largest
/// gradient of the photograph blurred by one pixel; an edge has ink if the drawing is dark within two pixels of it.
#[must_use]
pub fn edge_coverage(photograph: &RgbImage, rendered: &RgbImage) -> f64 {
    let (width, height) = photograph.dimensions();
    let height = (u64::from(height) * u64::from(COMPARE_WIDTH_PX) / u64::from(width.max(1))).clamp(1, 8192) as u32;
    let small = |picture: &RgbImage| grey(&resize(picture, COMPARE_WIDTH_PX, height, FilterType::Triangle));
    let light = small(photograph).blurred(1.0);
    let ink = small(rendered);
    let steepness = Plane::from_fn(light.width(), light.height(), |x, y| {
        let (x, y) = (x as isize, y as isize);
        (light.at(x + 1, y) - light.at(x - 1, y)).hypot(light.at(x, y + 1) - light.at(x, y - 1))
    });
    let limit = steepness.percentile(EDGE_PERCENTILE);
    let (mut strong, mut covered) = (0_u32, 0_u32);
    for y in 0..steepness.height() as isize {
        for x in 0..steepness.width() as isize {
            if steepness.at(x, y) > limit {
                strong += 1;
                let around = (-EDGE_REACH_PX..=EDGE_REACH_PX)
                    .flat_map(|dy| (-EDGE_REACH_PX..=EDGE_REACH_PX).map(move |dx| (dx, dy)));
                covered += u32::from(around.into_iter().any(|(dx, dy)| ink.at(x + dx, y + dy) < 0.5));
            }
        }
    }
    f64::from(covered) / f64::from(strong.max(1))
}

/// A copy of a large picture whose longer side is at most `side_max` pixels; each pixel is the mean of those it replaces.
pub(super) fn reduced(picture: &RgbImage, side_max: u32) -> Cow<'_, RgbImage> {
    let longer = picture.width().max(picture.height());
    if longer <= side_max {
        return Cow::Borrowed(picture);
    }
    let side = |length: u32| (u64::from(length) * u64::from(side_max) / u64::from(longer)).max(1) as u32;
    Cow::Owned(thumbnail(picture, side(picture.width()), side(picture.height())))
}

/// Luma of a picture, 0 to 1 (Rec. 601 weights).
pub(super) fn grey(picture: &RgbImage) -> Plane {
    Plane::from_fn(picture.width() as usize, picture.height() as usize, |x, y| {
        let [red, green, blue] = picture.get_pixel(x as u32, y as u32).0.map(f32::from);
        (0.299 * red + 0.587 * green + 0.114 * blue) / 255.0
    })
}

fn correlation(a: &Plane, b: &Plane) -> f64 {
    let (mean_a, mean_b) = (f64::from(a.mean()), f64::from(b.mean()));
    let (mut product, mut square_a, mut square_b) = (0.0, 0.0, 0.0);
    for (&a, &b) in a.values().iter().zip(b.values()) {
        let (a, b) = (f64::from(a) - mean_a, f64::from(b) - mean_b);
        product += a * b;
        square_a += a * a;
        square_b += b * b;
    }
    if square_a * square_b > 1e-12 {
        product / (square_a * square_b).sqrt()
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cross() -> Vec<Stroke> {
        vec![
            Stroke {
                points: vec![[2.0, 5.0], [8.0, 5.0]],
            },
            Stroke {
                points: vec![[5.0, 2.0], [5.0, 8.0]],
            },
        ]
    }

    #[test]
    fn a_line_covers_its_length_times_the_pens_width() {
        let picture = render_rgb(&cross()[..1], [10.0, 10.0], 0.5, 20.0);
        let full = f64::from(PAPER[0] - INK[0]);
        let ink: f64 = picture
            .pixels()
            .map(|pixel| (f64::from(PAPER[0]) - f64::from(pixel.0[0])) / full)
            .sum();
        let expected_mm2 = 6.0 * 0.5 + std::f64::consts::PI * 0.25 * 0.25;
        assert!((ink / 400.0 / expected_mm2 - 1.0).abs() < 0.02, "{}", ink / 400.0);
        assert_eq!(picture.get_pixel(100, 100).0, INK.map(|value| value as u8));
        assert_eq!(picture.get_pixel(10, 10).0, PAPER.map(|value| value as u8));
    }

    #[test]
    fn points_outside_the_sheet_are_clipped() {
        let stroke = Stroke {
            points: vec![[-50.0, 5.0], [50.0, 5.0], [f64::NAN, 3.0]],
        };
        assert_eq!(render_rgb(&[stroke], [10.0, 10.0], 0.5, 4.0).dimensions(), (40, 40));
    }

    #[test]
    fn the_svg_is_in_true_scale() {
        let svg = write_svg(&cross(), [200.0, 100.0], 0.4);
        assert!(svg.contains("width=\"200mm\" height=\"100mm\" viewBox=\"0 0 200 100\""));
        assert!(svg.contains("<polyline points=\"2.000,5.000 8.000,5.000\"/>"));
        assert_eq!(svg.matches("<polyline").count(), 2);
    }

    #[test]
    fn a_picture_correlates_with_itself_and_not_with_its_negative() {
        let picture = RgbImage::from_fn(300, 200, |x, y| Rgb([(x / 2 + y / 4) as u8; 3]));
        let negative = RgbImage::from_fn(300, 200, |x, y| Rgb(picture.get_pixel(x, y).0.map(|value| 255 - value)));
        assert!(tone_correlation(&picture, &picture) > 0.999);
        assert!(tone_correlation(&picture, &negative) < -0.999);
        assert_eq!(tone_correlation(&picture, &RgbImage::new(20, 20)), 0.0);
    }
}
