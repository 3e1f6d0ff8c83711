//! What can be wrong with a drawing's file, and what to try.
//!
//! One flat error for the whole subsystem. It carries no path: the caller knows which file it asked for and names it.

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

/// Why a file did not become a drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DrawingError {
    /// There is no such file.
    Missing,
    /// The file exists and cannot be read or written.
    Unreadable(io::ErrorKind),
    /// The file has no bytes.
    Empty,
    /// Neither a PNG or JPEG picture nor a list of coordinates.
    UnknownContent,
    /// It begins as a picture of a known kind, and its data are damaged or cut off.
    Damaged,
    /// The picture is of a kind that this program does not decode.
    Unsupported,
    /// More pixels than are accepted.
    TooLarge {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Most pixels accepted.
        pixels_max: u64,
    },
    /// Fewer pixels on a side than a drawing can be made of.
    TooSmall {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Fewest pixels accepted on either side.
        side_min: u32,
    },
    /// The file is larger than is accepted.
    FileTooLarge {
        /// Size of the file, bytes.
        bytes: u64,
        /// Largest size accepted, bytes.
        bytes_max: u64,
    },
    /// Nothing can be drawn: the picture is of one tone.
    Blank,
    /// The sheet has no room inside its margins, or a number of the options is not positive and finite.
    BadOptions,
    /// No photograph, where one is needed.
    NoPhotograph,
    /// No vector file, where one is needed.
    NoArtwork,
    /// A vector file is no well-formed XML, or no SVG.
    SvgSyntax {
        /// Line of the file, the first is 1.
        line: u32,
        /// Column, the first is 1.
        column: u32,
    },
    /// References of a vector file lead back to themselves.
    SvgCycle,
    /// A vector file's width or height is zero or no number.
    SvgSize,
    /// A vector file has more elements than are accepted.
    SvgElements {
        /// Most elements accepted.
        elements_max: usize,
    },
    /// The lines of a file have more points than are accepted.
    TooManyPoints {
        /// Most points accepted.
        points_max: usize,
    },
    /// A line of G-code has something that is no word: a letter and a number.
    GcodeWord {
        /// Line of the file, the first is 1.
        line: usize,
    },
    /// A line of G-code asks for a motion that is not known.
    GcodeMotion {
        /// Line of the file, the first is 1.
        line: usize,
        /// Ten times the G word's number.
        tenths: u32,
    },
    /// An arc of G-code has no radius, or its ends do not lie on one circle.
    GcodeArc {
        /// Line of the file, the first is 1.
        line: usize,
    },
    /// An instruction of HPGL lacks a number, or has something that is none.
    HpglNumber {
        /// Which one, the first is 1.
        instruction: usize,
    },
    /// A coordinate is more than a kilometre away, or no number.
    FarAway {
        /// Where the file has it.
        place: FilePlace,
    },
    /// Even the coarsest drawing of a photograph takes longer than asked for.
    TimeTooShort {
        /// The time asked for, ms.
        asked_ms: u64,
        /// What the coarsest drawing takes, ms.
        shortest_ms: u64,
    },
    /// A photograph is turned by something else than quarters.
    BadRotation,
    /// A vector file without a line.
    NothingDrawn,
    /// None of the layers has the wanted name or number.
    NoSuchLayer {
        /// How many layers there are.
        layers: usize,
    },
    /// A stroke does not lie on the sheet.
    OffSheet {
        /// Where it is off the sheet, from the sheet's left edge, micrometres.
        x_um: i64,
        /// Where it is off the sheet, from the sheet's upper edge, micrometres.
        y_um: i64,
    },
    /// A line of a coordinate file has another number of columns than its heading.
    CsvColumns {
        /// Line of the file, the first is 1.
        line: usize,
        /// Columns of the heading.
        expected: usize,
        /// Columns found.
        actual: usize,
    },
    /// A value of a coordinate file is no finite number.
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
    /// A coordinate file with no point drawn.
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
            Self::NoPhotograph => write!(f, "a photograph (PNG, JPEG) is needed here"),
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
