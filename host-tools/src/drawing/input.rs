//! Loads files by content: photographs, vector files, lists of coordinates.
//!
//! The kind of a file is determined from its bytes; its name only matters if the bytes fit several kinds of text. A
//! file is read from a disk or from standard input, up to a size limit.

use super::artwork::Artwork;
use super::csv::{Coordinates, Path3d, read_csv};
use super::gcode::read_gcode;
use super::hpgl::read_hpgl;
use super::photo::decode;
use super::svg::{TextFont, read_svg_with};
use super::{Drawing, DrawingError};
use image::{ImageFormat, RgbImage};
use std::io::Read;
use std::path::Path;

/// Largest file read, bytes.
const FILE_BYTES_MAX: u64 = 256 << 20;

/// Content of a file.
#[derive(Clone, Debug)]
pub enum Input {
    /// A picture, upright, with transparent parts on white.
    Photograph(RgbImage),
    /// Strokes on a sheet.
    Drawing(Drawing),
    /// A path in the robot's frame.
    Path(Path3d),
    /// Lines with their own page.
    Artwork(Artwork),
}

impl From<Coordinates> for Input {
    fn from(coordinates: Coordinates) -> Self {
        match coordinates {
            Coordinates::Sheet(drawing) => Self::Drawing(drawing),
            Coordinates::Robot(path) => Self::Path(path),
        }
    }
}

/// Reads a file, `-` for standard input: a PNG or JPEG picture, an SVG, G-code, HPGL, or a CSV of
/// coordinates. Text becomes outlines of the installed fonts.
///
/// # Errors
///
/// [`DrawingError`] describes what is wrong with the file and what to try.
pub fn load(path: impl AsRef<Path>) -> Result<Input, DrawingError> {
    load_with(path, &TextFont::default())
}

/// Reads a file like [`load`], with a font for its text.
///
/// # Errors
///
/// [`DrawingError`] describes what is wrong with the file and what to try.
pub fn load_with(path: impl AsRef<Path>, font: &TextFont) -> Result<Input, DrawingError> {
    let path = path.as_ref();
    load_content(path, &read_file(path)?, font)
}

/// Converts a file's content like [`load`]; the name determines the kind of text if the content is ambiguous.
///
/// # Errors
///
/// [`DrawingError`] describes what is wrong with the file and what to try.
pub fn load_content(path: &Path, bytes: &[u8], font: &TextFont) -> Result<Input, DrawingError> {
    if bytes.is_empty() {
        return Err(DrawingError::Empty);
    }
    match image::guess_format(bytes) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP)) => {
            return decode(bytes, format).map(Input::Photograph);
        }
        _ if is_heic(bytes) => return Err(DrawingError::Heic),
        Ok(_) => return Err(DrawingError::Unsupported),
        Err(_) => {}
    }
    let text = std::str::from_utf8(bytes).map_err(|_| DrawingError::UnknownContent)?;
    let text = text.trim_start_matches('\u{feff}');
    match kind(path, text) {
        Some(Kind::Svg) => read_svg_with(text, font).map(Input::Artwork),
        Some(Kind::Csv) => read_csv(text).map(Input::from),
        Some(Kind::Gcode) => read_gcode(text).map(Input::Artwork),
        Some(Kind::Hpgl) => read_hpgl(text).map(Input::Artwork),
        None => Err(DrawingError::UnknownContent),
    }
}

/// Whether a file is a picture in a container of ISO 14496-12 with HEVC or AV1, as telephones make them.
fn is_heic(bytes: &[u8]) -> bool {
    const BRANDS: [&[u8; 4]; 8] = [b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1", b"avif"];
    let brand = bytes.get(8..12);
    bytes.get(4..8) == Some(b"ftyp") && BRANDS.iter().any(|known| brand == Some(known.as_slice()))
}

/// Reads a file's content, `-` for standard input.
///
/// # Errors
///
/// The file cannot be read, or is too large.
pub fn read_file(path: &Path) -> Result<Vec<u8>, DrawingError> {
    let mut bytes = Vec::new();
    let most = FILE_BYTES_MAX + 1;
    if path.as_os_str() == "-" {
        std::io::stdin().lock().take(most).read_to_end(&mut bytes)?;
    } else {
        std::fs::File::open(path)?.take(most).read_to_end(&mut bytes)?;
    }
    if bytes.len() as u64 > FILE_BYTES_MAX {
        return Err(DrawingError::FileTooLarge {
            bytes: std::fs::metadata(path).map_or(bytes.len() as u64, |metadata| metadata.len()),
            bytes_max: FILE_BYTES_MAX,
        });
    }
    Ok(bytes)
}

/// Kinds of text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Svg,
    Csv,
    Gcode,
    Hpgl,
}

/// The kind of a text: by its beginning, or by its file name if the beginning is malformed.
fn kind(path: &Path, text: &str) -> Option<Kind> {
    let begins = text.trim_start();
    let named = |names: &[&str]| {
        path.extension()
            .is_some_and(|extension| names.iter().any(|name| extension.eq_ignore_ascii_case(name)))
    };
    if begins.starts_with('<') || named(&["svg"]) {
        Some(Kind::Svg)
    } else if begins.starts_with("x_mm") || named(&["csv"]) {
        Some(Kind::Csv)
    } else if named(&["gcode", "gco", "nc", "ngc", "tap", "g"]) || is_gcode(begins) {
        Some(Kind::Gcode)
    } else if named(&["hpgl", "plt", "hpg"]) || is_hpgl(begins) {
        Some(Kind::Hpgl)
    } else {
        None
    }
}

/// Whether the first line that is not a comment begins with a word of G-code.
fn is_gcode(text: &str) -> bool {
    let begins_comment = |line: &&str| line.is_empty() || line.starts_with([';', '(', '%']);
    let first = text
        .lines()
        .map(str::trim)
        .find(|line| !begins_comment(line))
        .unwrap_or_default();
    let mut letters = first.chars().map(|c| c.to_ascii_uppercase());
    matches!(letters.next(), Some('G' | 'M' | 'N' | 'T' | 'F')) && letters.next().is_some_and(|c| c.is_ascii_digit())
}

/// Whether a text begins with a typical first instruction of HPGL files.
fn is_hpgl(text: &str) -> bool {
    let name: String = text.chars().take(2).collect::<String>().to_ascii_uppercase();
    let is_followed = text
        .chars()
        .nth(2)
        .is_some_and(|c| matches!(c, ';' | '-' | ',' | ' ') || c.is_ascii_digit());
    ["IN", "DF", "SP", "PU", "PD", "PA"].contains(&name.as_str()) && is_followed
}
