//! One photograph drawn in several ways, side by side on a contact sheet to choose from.

use super::compose::from_photograph;
use super::source::SourceArguments;
use crate::drawing::{Drawing, DrawingError, render_rgb};
use etherpen::config::Config;
use image::imageops::{FilterType, replace, resize};
use image::{ImageFormat, Rgb, RgbImage};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use std::io::Cursor;

/// Style, crop and background of the variants, in the order in which they are shown.
const LOOKS: [[&str; 3]; 13] = [
    ["sketch", "auto", "fade"],
    ["hatch", "auto", "fade"],
    ["engrave", "auto", "fade"],
    ["flow", "auto", "fade"],
    ["tsp", "auto", "fade"],
    ["sketch", "none", "fade"],
    ["hatch", "head", "none"],
    ["sketch", "head", "keep"],
    ["engrave", "none", "fade"],
    ["sketch", "subject", "none"],
    ["tsp", "none", "keep"],
    ["flow", "none", "keep"],
    ["hatch", "none", "keep"],
];
/// Largest width and height of a drawing on the contact sheet, and the space around it, pixels.
const CELL_PX: u32 = 720;
const GAP_PX: u32 = 20;
/// Height of a line of text, pixels.
const TEXT: RasterHeight = RasterHeight::Size32;
const TEXT_PX: u32 = 32;
/// Most drawings in a row.
const COLUMNS_MAX: u32 = 3;
/// Scale at which drawings are rendered before they are reduced, pixels a millimetre.
const PX_PER_MM: f64 = 8.0;
const PAPER: Rgb<u8> = Rgb([255; 3]);

/// A drawing and the options that draw it.
pub(crate) struct Variant {
    /// The options as on the command line.
    pub(crate) options: String,
    /// The strokes.
    pub(crate) drawing: Drawing,
}

impl Variant {
    pub(crate) fn new([style, crop, background]: [&str; 3], drawing: Drawing) -> Self {
        Self {
            options: format!("--style {style} --crop {crop} --background {background}"),
            drawing,
        }
    }
}

/// At most `count` drawings of a photograph that differ from the one that `source` asks for.
///
/// # Errors
/// The first drawing that cannot be made.
pub(crate) fn variants_of(
    picture: &RgbImage,
    config: &Config,
    source: &SourceArguments,
    count: usize,
) -> Result<Vec<Variant>, DrawingError> {
    LOOKS
        .into_iter()
        .filter(|look| *look != source.look())
        .take(count)
        .map(|look| {
            let made = from_photograph(picture.clone(), config, &source.varied(look))?;
            Ok(Variant::new(look, made.drawing))
        })
        .collect()
}

/// All variants side by side, each above its options, as the bytes of a PNG.
///
/// # Errors
/// [`DrawingError::Unsupported`] if the picture cannot be encoded.
pub(crate) fn contact_sheet(variants: &[Variant], pen_width_mm: f64) -> Result<Vec<u8>, DrawingError> {
    let columns = (variants.len() as u32).clamp(1, COLUMNS_MAX);
    let rows = (variants.len() as u32).div_ceil(columns);
    let [across, down] = [CELL_PX + GAP_PX, CELL_PX + TEXT_PX + GAP_PX];
    let mut sheet = RgbImage::from_pixel(columns * across + GAP_PX, rows * down + GAP_PX, PAPER);
    for (k, variant) in (0..).zip(variants) {
        let drawing = &variant.drawing;
        let [left, top] = [GAP_PX + k % columns * across, GAP_PX + k / columns * down];
        let rendered = render_rgb(&drawing.strokes, drawing.sheet_mm, pen_width_mm, PX_PER_MM);
        let scale = f64::from(CELL_PX) / f64::from(rendered.width().max(rendered.height()));
        let side = |length: u32| ((f64::from(length) * scale) as u32).max(1);
        let small = resize(
            &rendered,
            side(rendered.width()),
            side(rendered.height()),
            FilterType::Triangle,
        );
        replace(&mut sheet, &small, i64::from(left), i64::from(top));
        write(
            &mut sheet,
            [left, top + CELL_PX],
            &format!("{}: {}", k + 1, short(&variant.options)),
        );
    }
    let mut bytes = Cursor::new(Vec::new());
    sheet
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|_| DrawingError::Unsupported)?;
    Ok(bytes.into_inner())
}

/// Options without those that have their default.
fn short(options: &str) -> String {
    options.replace(" --crop auto", "").replace(" --background fade", "")
}

/// A line of text in black; what does not fit the cell is left out.
fn write(picture: &mut RgbImage, [left, top]: [u32; 2], text: &str) {
    let advance = get_raster_width(FontWeight::Regular, TEXT) as u32;
    for (k, letter) in (0..CELL_PX / advance).zip(text.chars()) {
        let Some(raster) = get_raster(letter, FontWeight::Regular, TEXT) else {
            continue;
        };
        for (y, row) in (0..).zip(raster.rows()) {
            for (x, &ink) in (0..).zip(row) {
                if let Some(pixel) = picture.get_pixel_mut_checked(left + k * advance + x, top + y) {
                    *pixel = Rgb([255 - ink; 3]);
                }
            }
        }
    }
}
