//! Errors of a drawing's file, with what to try.
//!
//! One flat error for the whole subsystem. It contains no path: the caller knows the file and names it.

use std::fmt;
use std::io;

/// A place in a file of text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilePlace {
    /// A line; the first is 1.
    Line(usize),
    /// An instruction of HPGL; the first is 1.
    Instruction(usize),
    /// Not known.
    Somewhere,
}

impl fmt::Display for FilePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}: "),
            Self::Instruction(number) => write!(f, "instruction {number}: "),
            Self::Somewhere => Ok(()),
        }
    }
}

/// Why a file could not be converted into a drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DrawingError {
    /// The file does not exist.
    Missing,
    /// The file exists but cannot be read or written.
    Unreadable(io::ErrorKind),
    /// The file is empty.
    Empty,
    /// The content is neither a PNG or JPEG picture nor a list of coordinates.
    UnknownContent,
    /// The content begins like a known picture format, but is damaged or cut off.
    Damaged,
    /// The picture has an unsupported format.
    Unsupported,
    /// The picture is a HEIC or AVIF file.
    Heic,
    /// The picture has too many pixels.
    TooLarge {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Most pixels accepted.
        pixels_max: u64,
    },
    /// The picture has too few pixels on a side.
    TooSmall {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Fewest pixels accepted on either side.
        side_min: u32,
    },
    /// The file is too large.
    FileTooLarge {
        /// Size of the file, bytes.
        bytes: u64,
        /// Largest size accepted, bytes.
        bytes_max: u64,
    },
    /// Nothing can be drawn: the picture has a single tone.
    Blank,
    /// The sheet has no space inside its margins, or an option is not a positive finite number.
    BadOptions,
    /// A photograph is required.
    NoPhotograph,
    /// A vector file is required.
    NoArtwork,
    /// A vector file is not well-formed XML, or not an SVG.
    SvgSyntax {
        /// Line of the file, the first is 1.
        line: u32,
        /// Column, the first is 1.
        column: u32,
    },
    /// A reference in a vector file leads back to itself.
    SvgCycle,
    /// A vector file's width or height is zero or not a number.
    SvgSize,
    /// A vector file has too many elements.
    SvgElements {
        /// Most elements accepted.
        elements_max: usize,
    },
    /// A vector file has too much of something that takes long to read.
    SvgTooMuch {
        /// What there is too much of.
        what: &'static str,
        /// Line of the file, the first is 1.
        line: usize,
        /// Most accepted.
        most: usize,
    },
    /// The lines of a file have too many points.
    TooManyPoints {
        /// Most points accepted.
        points_max: usize,
    },
    /// A line of G-code contains something that is not a word: a letter and a number.
    GcodeWord {
        /// Line of the file, the first is 1.
        line: usize,
    },
    /// A line of G-code contains an unknown motion.
    GcodeMotion {
        /// Line of the file, the first is 1.
        line: usize,
        /// Ten times the G word's number.
        tenths: u32,
    },
    /// An arc of G-code has no radius, or its ends are not on one circle.
    GcodeArc {
        /// Line of the file, the first is 1.
        line: usize,
    },
    /// An instruction of HPGL lacks a number, or has an invalid one.
    HpglNumber {
        /// The instruction, from 1.
        instruction: usize,
    },
    /// A coordinate is more than a kilometre away, or not a number.
    FarAway {
        /// The place in the file.
        place: FilePlace,
    },
    /// Even the coarsest drawing of a photograph takes longer than the requested time.
    TimeTooShort {
        /// Requested time, ms.
        asked_ms: u64,
        /// Duration of the coarsest drawing, ms.
        shortest_ms: u64,
    },
    /// The rotation of a photograph is not a multiple of 90 degrees.
    BadRotation,
    /// A window of a photograph has too few pixels, or lies outside.
    BadCrop {
        /// Width of the upright photograph, pixels.
        width: u32,
        /// Height of the upright photograph, pixels.
        height: u32,
        /// Fewest pixels accepted on either side.
        side_min: u32,
    },
    /// A face that was pointed at lies outside the photograph, or is larger than it.
    BadFocus {
        /// Width of the upright photograph, pixels.
        width: u32,
        /// Height of the upright photograph, pixels.
        height: u32,
    },
    /// A vector file contains no line.
    NothingDrawn,
    /// No layer has the requested name or number.
    NoSuchLayer {
        /// Number of layers.
        layers: usize,
    },
    /// A stroke is not on the sheet.
    OffSheet {
        /// Position that is off the sheet, from the sheet's left edge, micrometres.
        x_um: i64,
        /// Position that is off the sheet, from the sheet's upper edge, micrometres.
        y_um: i64,
    },
    /// A line of a coordinate file does not have as many columns as its heading.
    CsvColumns {
        /// Line of the file, the first is 1.
        line: usize,
        /// Columns of the heading.
        expected: usize,
        /// Columns found.
        actual: usize,
    },
    /// A value of a coordinate file is not a finite number.
    CsvNumber {
        /// Line of the file, the first is 1.
        line: usize,
        /// Column, the first is 1.
        column: usize,
    },
    /// A pen value of a coordinate file is neither 0 nor 1.
    CsvPen {
        /// Line of the file, the first is 1.
        line: usize,
    },
    /// A coordinate file's first line is not `x_mm,y_mm,pen` or `x_mm,y_mm,z_mm,pen`.
    CsvHeading,
    /// A coordinate file contains no drawn point.
    CsvNothingDrawn,
}

impl fmt::Display for DrawingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Missing => write!(f, "no such file; check the path"),
            Self::Unreadable(kind) => write!(f, "cannot be opened ({kind}); check the path and its permissions"),
            Self::Empty => write!(f, "the file is empty; copy or export it again"),
            Self::UnknownContent => {
                write!(
                    f,
                    "neither a PNG or JPEG picture nor an SVG, G-code, HPGL or a CSV of coordinates; convert it to one of them"
                )
            }
            Self::Damaged => write!(f, "the picture is damaged or cut off; copy or export it again"),
            Self::Unsupported => write!(f, "this kind of picture is not decoded; convert it to an 8-bit RGB PNG"),
            Self::Heic => write!(
                f,
                "HEIC and AVIF pictures are not decoded; convert the file with `heif-convert IN.heic OUT.jpg` (package \
                 libheif-examples), or export it as JPEG"
            ),
            Self::TooLarge {
                width,
                height,
                pixels_max,
            } => write!(
                f,
                "{width} x {height} pixels are more than the {} million accepted; scale the picture down \
                 (2000 pixels a side are plenty)",
                pixels_max / 1_000_000
            ),
            Self::TooSmall {
                width,
                height,
                side_min,
            } => write!(
                f,
                "{width} x {height} pixels are too few for a drawing; take a picture of at least \
                 {side_min} pixels a side"
            ),
            Self::FileTooLarge { bytes, bytes_max } => write!(
                f,
                "{bytes} bytes are more than the {bytes_max} accepted; scale the picture down or split the path"
            ),
            Self::Blank => write!(
                f,
                "the picture has one tone only, nothing can be drawn; take another picture"
            ),
            Self::BadOptions => {
                write!(
                    f,
                    "sheet, margin, pen width and budgets must be positive and leave room inside the margins"
                )
            }
            Self::NoPhotograph => write!(f, "a photograph (PNG, JPEG, WebP) is needed here"),
            Self::NoArtwork => write!(
                f,
                "a vector file (SVG) is needed here; `vectorize` makes one of a photograph"
            ),
            Self::SvgSyntax { line, column } => write!(
                f,
                "line {line}, column {column}: this is no well-formed SVG; export it again"
            ),
            Self::SvgCycle => write!(
                f,
                "its references go round in circles (an element that uses itself), or are nested too deeply; export it \
                 again"
            ),
            Self::SvgSize => write!(f, "width, height or viewBox is zero or no number; give the page a size"),
            Self::SvgTooMuch { what, line, most } => {
                write!(
                    f,
                    "line {line}: more than {most} {what}; simplify the file, or split it"
                )
            }
            Self::SvgElements { elements_max } => write!(
                f,
                "more than {elements_max} elements, or nested too deeply; join lines into paths, or split the file"
            ),
            Self::TooManyPoints { points_max } => {
                write!(
                    f,
                    "more than {points_max} points; simplify the lines, or split the file"
                )
            }
            Self::GcodeWord { line } => write!(
                f,
                "line {line}: this is no G-code, which is letters with numbers; expressions and macros are not read"
            ),
            Self::GcodeMotion { line, tenths } => write!(
                f,
                "line {line}: G{} is not understood (known are G0 to G4, G17, G20, G21, G90 to G92); leave it out or \
                 export for a pen plotter",
                f64::from(tenths) / 10.0
            ),
            Self::GcodeArc { line } => write!(
                f,
                "line {line}: the arc has no radius, or its ends do not lie on one circle; check I, J, R and units"
            ),
            Self::HpglNumber { instruction } => {
                write!(
                    f,
                    "instruction {instruction}: a number is missing or wrong; export it again"
                )
            }
            Self::FarAway { place } => write!(
                f,
                "{place}a coordinate is more than a kilometre away; check the file's units and transforms"
            ),
            Self::TimeTooShort { asked_ms, shortest_ms } => write!(
                f,
                "it cannot be drawn in {:.1} s: the coarsest drawing takes {:.1} s; give it more time (--max-time), or make \
                 it smaller (--size)",
                asked_ms as f64 / 1_000.0,
                shortest_ms as f64 / 1_000.0
            ),
            Self::BadCrop {
                width,
                height,
                side_min,
            } => write!(
                f,
                "its window (--crop X,Y,W,H) leaves less than {side_min} x {side_min} pixels of it; the upright picture has \
                 {width} x {height} pixels"
            ),
            Self::BadFocus { width, height } => write!(
                f,
                "the given circle (--focus X,Y,R) is not a face in it: the centre has to be inside the upright picture of \
                 {width} x {height} pixels, and the radius at most its diagonal"
            ),
            Self::BadRotation => write!(f, "a photograph is turned by 90, 180 or 270 degrees"),
            Self::NothingDrawn => write!(
                f,
                "there is nothing to draw in it; look whether it has visible lines, inside its page"
            ),
            Self::NoSuchLayer { layers } => write!(
                f,
                "no layer has that name or number; it has {layers}, and `preview --json` lists them"
            ),
            Self::OffSheet { x_um, y_um } => write!(
                f,
                "it leaves the sheet at x {:.2} mm, y {:.2} mm; --fit or --size makes it smaller, \
                 --origin or --rotate moves it",
                x_um as f64 / 1_000.0,
                y_um as f64 / 1_000.0
            ),
            Self::CsvColumns { line, expected, actual } => {
                write!(f, "line {line}: {actual} columns where the heading has {expected}")
            }
            Self::CsvNumber { line, column } => {
                write!(f, "line {line}: column {column} is no finite number")
            }
            Self::CsvPen { line } => write!(f, "line {line}: the pen is 1 (down) or 0 (up)"),
            Self::CsvHeading => {
                write!(
                    f,
                    "line 1: the heading must be x_mm,y_mm,pen (sheet) or x_mm,y_mm,z_mm,pen (robot)"
                )
            }
            Self::CsvNothingDrawn => {
                write!(f, "no stroke: at least two points in a row need pen 1")
            }
        }
    }
}

impl DrawingError {
    /// This error with its place in the file, if the place was not known yet.
    #[must_use]
    pub(super) fn at(self, place: FilePlace) -> Self {
        match self {
            Self::FarAway {
                place: FilePlace::Somewhere,
            } => Self::FarAway { place },
            other => other,
        }
    }
}

impl std::error::Error for DrawingError {}

impl From<io::Error> for DrawingError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::NotFound => Self::Missing,
            kind => Self::Unreadable(kind),
        }
    }
}
