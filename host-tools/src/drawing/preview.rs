//! Preview of a drawing as a picture: order, travel moves, borders, refused strokes.

use super::line::{self, Point};
use super::{Drawing, DrawingError, Stroke};
use image::{ImageFormat, Rgb, RgbImage};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::Cursor;

/// Border around everything shown, mm.
const BORDER_MM: f64 = 5.0;
/// Largest side of a picture, pixels.
const SIDE_PX_MAX: f64 = 8_000.0;
/// Line width of a travel move, mm.
const TRAVEL_MM: f64 = 0.15;
const TRAVEL_COLOUR: [u8; 3] = [170, 170, 170];
const REFUSED_COLOUR: [u8; 3] = [220, 0, 0];
const SHEET_COLOUR: [u8; 3] = [252, 251, 247];
const AROUND_COLOUR: [u8; 3] = [226, 226, 222];
const AREA_COLOUR: [u8; 3] = [120, 120, 200];
/// Sides of the polygon that approximates the work area's circle.
const CIRCLE_SIDES: u32 = 180;

/// Content of a preview.
#[derive(Clone, Copy, Debug)]
pub struct PreviewScene<'a> {
    /// The strokes in the order of drawing.
    pub drawing: &'a Drawing,
    /// Numbers of the strokes that would be refused, from 0.
    pub refused: &'a BTreeSet<u32>,
    /// Line width of the pen, mm.
    pub pen_width_mm: f64,
    /// The work area on the sheet: centre and radius, mm.
    pub work_area: ([f64; 2], f64),
}

/// A line of the picture.
struct PreviewLine<'a> {
    points: &'a [Point],
    colour: [u8; 3],
    width_mm: f64,
}

impl PreviewScene<'_> {
    /// The scene as an SVG in true scale.
    #[must_use]
    pub fn svg(&self) -> String {
        let [left, top, width, height] = self.window_mm();
        let [sheet_width, sheet_height] = self.drawing.sheet_mm;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.3}mm\" height=\"{height:.3}mm\" \
             viewBox=\"{left:.3} {top:.3} {width:.3} {height:.3}\" style=\"background:{}\">\n\
             <rect width=\"{sheet_width}\" height=\"{sheet_height}\" fill=\"{}\"/>\n\
             <g fill=\"none\" stroke-linecap=\"round\" stroke-linejoin=\"round\">\n",
            hex(AROUND_COLOUR),
            hex(SHEET_COLOUR)
        );
        let ([x, y], radius) = self.work_area;
        // Writing into a string cannot fail.
        let _ = writeln!(
            svg,
            "<circle cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{radius:.3}\" stroke=\"{}\" stroke-width=\"0.5\"/>",
            hex(AREA_COLOUR)
        );
        self.each_line(|line| {
            let _ = write!(
                svg,
                "<polyline stroke=\"{}\" stroke-width=\"{}\" points=\"",
                hex(line.colour),
                line.width_mm
            );
            for (k, [x, y]) in line.points.iter().enumerate() {
                let _ = write!(svg, "{}{x:.3},{y:.3}", if k == 0 { "" } else { " " });
            }
            svg.push_str("\"/>\n");
        });
        svg.push_str("</g>\n</svg>\n");
        svg
    }

    /// The scene as the bytes of a PNG with `px_per_mm` pixels per millimetre, or fewer if it is very large.
    ///
    /// # Errors
    /// [`DrawingError::Unsupported`] if the picture cannot be encoded.
    pub fn png(&self, px_per_mm: f64) -> Result<Vec<u8>, DrawingError> {
        let [left, top, width, height] = self.window_mm();
        let px_per_mm = px_per_mm.min(SIDE_PX_MAX / width.max(height));
        let side = |mm: f64| (mm * px_per_mm).round().clamp(1.0, SIDE_PX_MAX) as u32;
        let place = |[x, y]: Point| [(x - left) * px_per_mm - 0.5, (y - top) * px_per_mm - 0.5];
        let [low, high] = [[0.0, 0.0], self.drawing.sheet_mm].map(place);
        let mut picture = RgbImage::from_fn(side(width), side(height), |x, y| {
            let (x, y) = (f64::from(x), f64::from(y));
            let on_sheet = (low[0]..=high[0]).contains(&x) && (low[1]..=high[1]).contains(&y);
            Rgb(if on_sheet { SHEET_COLOUR } else { AROUND_COLOUR })
        });
        let ([x, y], radius) = self.work_area;
        let circle: Vec<Point> = (0..=CIRCLE_SIDES)
            .map(|k| {
                let (sine, cosine) = (f64::from(k) / f64::from(CIRCLE_SIDES) * std::f64::consts::TAU).sin_cos();
                place([x + radius * cosine, y + radius * sine])
            })
            .collect();
        paint(&mut picture, &circle, 0.5 * px_per_mm, AREA_COLOUR);
        self.each_line(|line| {
            let points: Vec<Point> = line.points.iter().map(|&point| place(point)).collect();
            paint(&mut picture, &points, (line.width_mm * px_per_mm).max(1.0), line.colour);
        });
        let mut bytes = Cursor::new(Vec::new());
        picture
            .write_to(&mut bytes, ImageFormat::Png)
            .map_err(|_| DrawingError::Unsupported)?;
        Ok(bytes.into_inner())
    }

    /// The area shown: sheet and strokes, with a border; left, top, width, height, mm.
    fn window_mm(&self) -> [f64; 4] {
        let corners = [[0.0, 0.0], self.drawing.sheet_mm];
        let points = self.drawing.strokes.iter().flat_map(|stroke| &stroke.points);
        let finite = points.filter(|point| point.iter().all(|value| value.is_finite()));
        let [left, top, width, height] = super::artwork::bounds(corners.iter().chain(finite));
        [
            left - BORDER_MM,
            top - BORDER_MM,
            width + 2.0 * BORDER_MM,
            height + 2.0 * BORDER_MM,
        ]
    }

    /// Calls `visit` with every line from the bottom to the top: travel moves, strokes, refused strokes.
    fn each_line(&self, mut visit: impl FnMut(PreviewLine)) {
        let strokes = &self.drawing.strokes;
        for pair in strokes.windows(2) {
            let [before, after] = pair else { continue };
            if let (Some(&from), Some(&to)) = (before.points.last(), after.points.first()) {
                visit(PreviewLine {
                    points: &[from, to],
                    colour: TRAVEL_COLOUR,
                    width_mm: TRAVEL_MM,
                });
            }
        }
        let refused = |number: u32| self.refused.contains(&number);
        let mut show = |wanted: bool| {
            for (number, Stroke { points }) in (0_u32..).zip(strokes).filter(|(number, _)| refused(*number) == wanted) {
                let share = f64::from(number) / strokes.len().max(2) as f64;
                visit(PreviewLine {
                    points,
                    colour: if wanted { REFUSED_COLOUR } else { rainbow(share) },
                    width_mm: if wanted { 2.0 } else { 1.0 } * self.pen_width_mm,
                });
            }
        };
        show(false);
        show(true);
    }
}

fn hex([red, green, blue]: [u8; 3]) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// From blue over green and yellow to red, dark enough for white paper.
fn rainbow(share: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] = [
        [40.0, 60.0, 190.0],
        [0.0, 140.0, 170.0],
        [40.0, 150.0, 50.0],
        [215.0, 140.0, 0.0],
        [200.0, 40.0, 90.0],
    ];
    let at = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let low = (at as usize).min(STOPS.len() - 2);
    [0, 1, 2].map(|k| (STOPS[low][k] + (STOPS[low + 1][k] - STOPS[low][k]) * (at - low as f64)).round() as u8)
}

/// Draws an antialiased line into a picture.
pub(super) fn paint(picture: &mut RgbImage, points: &[Point], width: f64, colour: [u8; 3]) {
    let (columns, rows) = (f64::from(picture.width()), f64::from(picture.height()));
    let reach = 0.5 * width + 1.0;
    for pair in points.windows(2) {
        let [a, b] = [pair[0], pair[1]];
        let span = |axis: usize, end: f64| {
            let low = (a[axis].min(b[axis]) - reach).floor().max(0.0) as u32;
            (low, (a[axis].max(b[axis]) + reach).ceil().min(end - 1.0) as i64)
        };
        let ((left, right), (top, bottom)) = (span(0, columns), span(1, rows));
        for y in top..u32::try_from(bottom + 1).unwrap_or(0) {
            for x in left..u32::try_from(right + 1).unwrap_or(0) {
                let away = line::distance_to_segment([f64::from(x), f64::from(y)], a, b);
                let cover = (0.5 * width + 0.5 - away).clamp(0.0, 1.0);
                if cover > 0.0
                    && let Some(pixel) = picture.get_pixel_mut_checked(x, y)
                {
                    for (value, ink) in pixel.0.iter_mut().zip(colour) {
                        *value = (f64::from(*value) + (f64::from(ink) - f64::from(*value)) * cover).round() as u8;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawing() -> Drawing {
        let stroke = |points: &[Point]| Stroke {
            points: points.to_vec(),
        };
        Drawing {
            sheet_mm: [50.0, 40.0],
            strokes: vec![
                stroke(&[[5.0, 5.0], [20.0, 5.0]]),
                stroke(&[[20.0, 30.0], [70.0, 30.0]]),
                stroke(&[[5.0, 20.0], [5.0, 30.0]]),
            ],
        }
    }

    #[test]
    fn both_pictures_show_order_ways_borders_and_refusals() {
        let drawing = drawing();
        let refused = BTreeSet::from([1]);
        let scene = PreviewScene {
            drawing: &drawing,
            refused: &refused,
            pen_width_mm: 0.5,
            work_area: ([25.0, 20.0], 30.0),
        };
        let svg = scene.svg();
        assert!(svg.contains("width=\"80.000mm\" height=\"50.000mm\" viewBox=\"-5.000 -5.000 80.000 50.000\""));
        assert_eq!(svg.matches("<polyline").count(), 5);
        assert_eq!(svg.matches(&hex(TRAVEL_COLOUR)).count(), 2);
        assert_eq!(
            (
                svg.matches(&hex(REFUSED_COLOUR)).count(),
                svg.matches("<circle").count()
            ),
            (1, 1)
        );
        let picture = image::load_from_memory(&scene.png(4.0).expect("a picture"))
            .expect("a PNG")
            .into_rgb8();
        assert_eq!(picture.dimensions(), (320, 200));
        let at = |x_mm: f64, y_mm: f64| {
            picture
                .get_pixel(((x_mm + 5.0) * 4.0) as u32, ((y_mm + 5.0) * 4.0) as u32)
                .0
        };
        assert_eq!((at(60.0, 30.0), at(10.0, 5.0)), (REFUSED_COLOUR, rainbow(0.0)));
        assert_eq!((at(45.0, 2.0), at(60.0, 20.0)), (SHEET_COLOUR, AROUND_COLOUR));
    }
}
