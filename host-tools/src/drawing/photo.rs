//! Photographs: decoded within limits, upright, on white.
//!
//! Sizes are checked before decoding, and decoding has its own limits, so that memory is bounded for every file.

use super::DrawingError;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits, RgbImage};
use std::io::Cursor;

/// Most pixels decoded.
const PIXELS_MAX: u64 = 64_000_000;
/// Most memory a decoder may take, bytes.
const DECODER_BYTES_MAX: u64 = PIXELS_MAX * PIXEL_BYTES_MAX + SPARE_BYTES;
/// Bytes of a pixel with four channels of 16 bits.
const PIXEL_BYTES_MAX: u64 = 8;
/// Memory of a decoder besides its pixels, bytes: rows, tables, remarks.
const SPARE_BYTES: u64 = 16 << 20;
/// Least number of pixels on a side.
pub(crate) const SIDE_MIN: u32 = 16;
/// Start of a scan and end of the picture in a JPEG file.
const JPEG_SCAN: [u8; 2] = [0xFF, 0xDA];
const JPEG_END: [u8; 2] = [0xFF, 0xD9];

const _: () = assert!(DECODER_BYTES_MAX <= 600 << 20);

/// Decodes a picture within limits, turns it upright and lays it on white.
pub(super) fn decode(bytes: &[u8], format: ImageFormat) -> Result<RgbImage, DrawingError> {
    if format == ImageFormat::Jpeg && !is_jpeg_complete(bytes) {
        return Err(DrawingError::Damaged);
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    // A small picture may not unpack a large remark.
    let bytes_max = match announced_png(bytes) {
        Some([width, height]) => {
            check_size(width, height)?;
            u64::from(width) * u64::from(height) * PIXEL_BYTES_MAX + SPARE_BYTES
        }
        None => DECODER_BYTES_MAX,
    };
    limits.max_alloc = Some(bytes_max);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(what_failed)?;
    let (width, height) = decoder.dimensions();
    check_size(width, height)?;
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    // Turned last: then the two pictures in memory are small ones.
    let mut picture = DynamicImage::ImageRgb8(on_white(DynamicImage::from_decoder(decoder).map_err(what_failed)?));
    picture.apply_orientation(orientation);
    Ok(picture.into_rgb8())
}

/// Width and height that the header of a PNG announces.
fn announced_png(bytes: &[u8]) -> Option<[u32; 2]> {
    let side = |at: usize| Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?));
    (bytes.get(12..16) == Some(b"IHDR")).then_some([side(16)?, side(20)?])
}

/// Refuses pictures that are too small or too large.
pub(super) fn check_size(width: u32, height: u32) -> Result<(), DrawingError> {
    if width.min(height) < SIDE_MIN {
        return Err(DrawingError::TooSmall {
            width,
            height,
            side_min: SIDE_MIN,
        });
    }
    if u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(DrawingError::TooLarge {
            width,
            height,
            pixels_max: PIXELS_MAX,
        });
    }
    Ok(())
}

fn what_failed(error: ImageError) -> DrawingError {
    match error {
        ImageError::Unsupported(_) | ImageError::Limits(_) => DrawingError::Unsupported,
        _ => DrawingError::Damaged,
    }
}

/// A decoder may fill missing data with grey; a complete file has an end marker after its last scan.
fn is_jpeg_complete(bytes: &[u8]) -> bool {
    let last = |marker: [u8; 2]| bytes.windows(2).rposition(|pair| pair == marker);
    last(JPEG_END) > last(JPEG_SCAN)
}

fn on_white(picture: DynamicImage) -> RgbImage {
    if !picture.color().has_alpha() {
        return picture.into_rgb8();
    }
    let picture = picture.into_rgba8();
    let mut result = RgbImage::new(picture.width(), picture.height());
    for (to, from) in result.pixels_mut().zip(picture.pixels()) {
        let [red, green, blue, alpha] = from.0.map(u32::from);
        to.0 = [red, green, blue].map(|value| ((value * alpha + 255 * (255 - alpha) + 127) / 255) as u8);
    }
    result
}

#[cfg(test)]
mod tests;
