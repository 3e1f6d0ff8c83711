//! Pictures side by side, each above a line of text.

use crate::drawing::DrawingError;
use image::imageops::{FilterType, replace, resize};
use image::{ImageFormat, Rgb, RgbImage};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use std::io::Cursor;

/// Usual largest width and height of a picture, pixels.
const CELL_PX: u32 = 720;
/// Space around a picture, pixels.
const GAP_PX: u32 = 20;
/// Height of a line of text, pixels.
const TEXT: RasterHeight = RasterHeight::Size32;
const TEXT_PX: u32 = 32;
/// Usual most pictures in a row.
const COLUMNS_MAX: u32 = 3;
const PAPER: Rgb<u8> = Rgb([255; 3]);

/// All pictures side by side, three in a row, as the bytes of a PNG.
///
/// # Errors
/// [`DrawingError::Unsupported`] if the result cannot be encoded.
pub(crate) fn side_by_side(
    count: usize,
    cells: impl Iterator<Item = (RgbImage, String)>,
) -> Result<Vec<u8>, DrawingError> {
    in_rows(count, (count as u32).clamp(1, COLUMNS_MAX), CELL_PX, cells)
}

/// All pictures in rows of `columns`, each at most `cell_px` wide and high, as the bytes of a PNG.
///
/// # Errors
/// [`DrawingError::Unsupported`] if the result cannot be encoded.
pub(crate) fn in_rows(
    count: usize,
    columns: u32,
    cell_px: u32,
    cells: impl Iterator<Item = (RgbImage, String)>,
) -> Result<Vec<u8>, DrawingError> {
    let rows = (count as u32).div_ceil(columns);
    let [across, down] = [cell_px + GAP_PX, cell_px + TEXT_PX + GAP_PX];
    let mut sheet = RgbImage::from_pixel(columns * across + GAP_PX, rows * down + GAP_PX, PAPER);
    for (k, (picture, words)) in (0..).zip(cells.take(count)) {
        let [left, top] = [GAP_PX + k % columns * across, GAP_PX + k / columns * down];
        let scale = f64::from(cell_px) / f64::from(picture.width().max(picture.height()).max(1));
        let side = |length: u32| ((f64::from(length) * scale) as u32).max(1);
        let small = resize(
            &picture,
            side(picture.width()),
            side(picture.height()),
            FilterType::Triangle,
        );
        replace(&mut sheet, &small, i64::from(left), i64::from(top));
        write(&mut sheet, [left, top + cell_px], cell_px, &words);
    }
    let mut bytes = Cursor::new(Vec::new());
    sheet
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|_| DrawingError::Unsupported)?;
    Ok(bytes.into_inner())
}

/// A line of text in black; what does not fit the cell is left out.
fn write(picture: &mut RgbImage, [left, top]: [u32; 2], cell_px: u32, text: &str) {
    let advance = get_raster_width(FontWeight::Regular, TEXT) as u32;
    for (k, letter) in (0..cell_px / advance).zip(text.chars()) {
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
