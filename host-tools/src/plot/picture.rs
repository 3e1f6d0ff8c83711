//! A picture of boxes, curves and text, as SVG or PNG, without a display and without installed fonts.
//!
//! Text is set in a fixed-pitch font in both formats. In PNG it is the raster of Noto Sans Mono from the crate
//! `noto-sans-mono-bitmap`, which has no dependencies and one built-in size. Invariant: both formats show equal shapes
//! at equal places.

use crate::drawing::{Plane, draw_line};
use image::{ImageFormat, Rgb, RgbImage};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use std::fmt::Write as _;
use std::io::{self, Cursor};

/// A colour: red, green, blue.
pub type Colour = [u8; 3];

/// Pixels of a PNG in a unit of the picture.
const SCALE: f64 = 2.0;
/// Height of the raster of a letter, pixels.
const RASTER: RasterHeight = RasterHeight::Size32;
/// Distance from the top of a letter's raster to the baseline, pixels.
const RASTER_ASCENT: f64 = 25.0;
/// Width of a letter, units.
pub const LETTER_WIDTH: f64 = get_raster_width(FontWeight::Regular, RASTER) as f64 / SCALE;
/// Size of the font in SVG: letters of common fixed-pitch fonts are 0.6 of it wide.
const FONT_SIZE: f64 = LETTER_WIDTH / 0.6;

/// Largest distance at which a line covers pixels, from its points, pixels.
const LINE_REACH: f64 = 8.0;

/// Part of a text that is at its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Its left end.
    Start,
    /// Its middle.
    Middle,
    /// Its right end.
    End,
}

enum Shape {
    /// Left, top, width, height.
    Filled([f64; 4], Colour),
    Curve(Vec<[f64; 2]>, f64, Colour),
    Text([f64; 2], Anchor, String, Colour),
}

/// Shapes, the later over the earlier.
pub struct Picture {
    width: f64,
    height: f64,
    shapes: Vec<Shape>,
}

impl Picture {
    /// A white picture.
    pub fn new(width: f64, height: f64) -> Self {
        let shapes = vec![Shape::Filled([0.0, 0.0, width, height], [255; 3])];
        Self { width, height, shapes }
    }

    /// A box: left, top, width, height.
    pub fn fill(&mut self, area: [f64; 4], colour: Colour) {
        self.shapes.push(Shape::Filled(area, colour));
    }

    /// A line along points.
    pub fn curve(&mut self, points: Vec<[f64; 2]>, width: f64, colour: Colour) {
        self.shapes.push(Shape::Curve(points, width, colour));
    }

    /// A dashed line along points: the lengths of dashes and gaps in turn; none for an unbroken line.
    pub fn dashed(&mut self, points: Vec<[f64; 2]>, width: f64, colour: Colour, pattern: &[f64]) {
        if pattern.is_empty() {
            return self.curve(points, width, colour);
        }
        for dash in dashes(&points, pattern) {
            self.curve(dash, width, colour);
        }
    }

    /// A line of text on a baseline.
    pub fn text(&mut self, place: [f64; 2], anchor: Anchor, text: impl Into<String>, colour: Colour) {
        self.shapes.push(Shape::Text(place, anchor, text.into(), colour));
    }

    /// The picture as an SVG document.
    pub fn svg(&self) -> String {
        let (width, height) = (self.width, self.height);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"'Noto Sans Mono', 'DejaVu Sans Mono', monospace\" \
             font-size=\"{FONT_SIZE:.1}\">\n"
        );
        for shape in &self.shapes {
            // Writing into a string cannot fail.
            let _ = match shape {
                Shape::Filled([x, y, width, height], colour) => writeln!(
                    svg,
                    "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{}\"/>",
                    hexadecimal(*colour)
                ),
                Shape::Curve(points, width, colour) => {
                    let _ = write!(
                        svg,
                        "<polyline fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" stroke-linejoin=\"round\" \
                         stroke-linecap=\"round\" points=\"",
                        hexadecimal(*colour)
                    );
                    for [x, y] in points {
                        let _ = write!(svg, "{x:.1},{y:.1} ");
                    }
                    writeln!(svg, "\"/>")
                }
                Shape::Text([x, y], anchor, text, colour) => {
                    let anchor = match anchor {
                        Anchor::Start => "start",
                        Anchor::Middle => "middle",
                        Anchor::End => "end",
                    };
                    writeln!(
                        svg,
                        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" fill=\"{}\">{}</text>",
                        hexadecimal(*colour),
                        escaped(text)
                    )
                }
            };
        }
        svg.push_str("</svg>\n");
        svg
    }

    /// The picture as the bytes of a PNG file.
    ///
    /// # Errors
    /// The picture cannot be encoded.
    pub fn png(&self) -> io::Result<Vec<u8>> {
        let side = |units: f64| (units * SCALE).round().clamp(1.0, 20_000.0) as u32;
        let mut image = RgbImage::new(side(self.width), side(self.height));
        let mut covered = Plane::filled(image.width() as usize, image.height() as usize, 0.0);
        for shape in &self.shapes {
            match shape {
                Shape::Filled(area, colour) => fill(&mut image, area.map(|units| units * SCALE), *colour),
                Shape::Curve(points, width, colour) => {
                    let in_pixels = |point: &[f64; 2]| point.map(|units| units * SCALE - 0.5);
                    let points: Vec<[f64; 2]> = points.iter().map(in_pixels).collect();
                    draw_line(&mut covered, &points, width * SCALE);
                    ink(&mut image, &mut covered, &points, *colour);
                }
                Shape::Text(place, anchor, text, colour) => letters(&mut image, *place, *anchor, text, *colour),
            }
        }
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).map_err(io::Error::other)?;
        Ok(bytes.into_inner())
    }
}

/// Cuts a line into dashes. Lengths of the pattern are positive.
fn dashes(points: &[[f64; 2]], pattern: &[f64]) -> Vec<Vec<[f64; 2]>> {
    let mut lengths = pattern.iter().copied().cycle();
    let mut left = lengths.next().unwrap_or(f64::INFINITY);
    let (mut drawn, mut all) = (true, Vec::new());
    let mut dash: Vec<[f64; 2]> = points.first().copied().into_iter().collect();
    for pair in points.windows(2) {
        let &[mut from, to] = pair else { continue };
        loop {
            let length = (to[0] - from[0]).hypot(to[1] - from[1]);
            if length <= left {
                left -= length;
                break;
            }
            let share = left / length;
            from = [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
            dash.push(from);
            if drawn {
                all.push(std::mem::take(&mut dash));
            }
            (drawn, dash) = (!drawn, vec![from]);
            left = lengths.next().unwrap_or(f64::INFINITY);
        }
        dash.push(to);
    }
    if drawn && dash.len() > 1 {
        all.push(dash);
    }
    all
}

fn hexadecimal([red, green, blue]: Colour) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Blends a colour over a pixel; ignored outside of the image.
fn blend(image: &mut RgbImage, x: i64, y: i64, colour: Colour, share: f32) {
    let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y)) else {
        return;
    };
    if let Some(Rgb(pixel)) = image.get_pixel_mut_checked(x, y) {
        for (old, new) in pixel.iter_mut().zip(colour) {
            let (from, to) = (f32::from(*old), f32::from(new));
            *old = (from + (to - from) * share).round() as u8;
        }
    }
}

/// Draws the pixels covered by a line into the image, and clears them. A line is within a few pixels of its points.
fn ink(image: &mut RgbImage, covered: &mut Plane, points: &[[f64; 2]], colour: Colour) {
    let span = |axis: usize, end: u32| {
        let values = || points.iter().filter_map(|point| point.get(axis).copied());
        let low = values().fold(f64::from(end), f64::min) - LINE_REACH;
        let high = values().fold(0.0, f64::max) + LINE_REACH;
        low.max(0.0) as isize..=high.min(f64::from(end) - 1.0) as isize
    };
    let rows = span(1, image.height());
    for x in span(0, image.width()) {
        for y in rows.clone() {
            let share = covered.at(x, y);
            if share > 0.0 {
                blend(image, x as i64, y as i64, colour, share);
                covered.set(x, y, 0.0);
            }
        }
    }
}

/// Fills a box to whole pixels, at least one wide and high.
fn fill(image: &mut RgbImage, [left, top, width, height]: [f64; 4], colour: Colour) {
    let (x, y) = (left.round() as i64, top.round() as i64);
    let (x_end, y_end) = ((left + width).round() as i64, (top + height).round() as i64);
    for y in y..y_end.max(y + 1).min(image.height().into()) {
        for x in x..x_end.max(x + 1).min(image.width().into()) {
            blend(image, x, y, colour, 1.0);
        }
    }
}

fn letters(image: &mut RgbImage, [x, y]: [f64; 2], anchor: Anchor, text: &str, colour: Colour) {
    let width = text.chars().count() as f64 * LETTER_WIDTH;
    let left = match anchor {
        Anchor::Start => x,
        Anchor::Middle => x - 0.5 * width,
        Anchor::End => x - width,
    };
    let top = (y * SCALE - RASTER_ASCENT).round() as i64;
    let mut left = (left * SCALE).round() as i64;
    for letter in text.chars() {
        let raster = get_raster(letter, FontWeight::Regular, RASTER);
        let Some(raster) = raster.or_else(|| get_raster('?', FontWeight::Regular, RASTER)) else {
            continue;
        };
        for (y, row) in (top..).zip(raster.rows()) {
            for (x, share) in (left..).zip(row) {
                if *share > 0 {
                    blend(image, x, y, colour, f32::from(*share) / 255.0);
                }
            }
        }
        left += raster.width() as i64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashes_follow_their_pattern_around_corners() {
        let corner = [[0.0, 0.0], [4.0, 0.0], [4.0, 6.0]];
        let all = dashes(&corner, &[3.0, 2.0]);
        assert_eq!(all, [vec![[0.0, 0.0], [3.0, 0.0]], vec![[4.0, 1.0], [4.0, 4.0]],]);
        assert!(dashes(&[], &[3.0, 2.0]).is_empty());
    }
}
