//! From a file to ordered strokes on a sheet, and from strokes to pictures.
//!
//! A photograph becomes lines that a pen can draw ([`vectorize`]). The lines are put into an order with little drawing
//! time ([`order`]), and are converted into a path in the robot's frame ([`to_path`]) or into a picture
//! ([`render_png`], [`write_svg`]). Lists of coordinates enter through [`load`] as well. Everything is a pure function
//! of its input and its options: a photograph gives identical strokes in every run.
//!
//! Invariant: a [`Drawing`] returned by this module has finite points inside its sheet, and every stroke has at least
//! two of them.

mod artwork;
mod background;
mod camera;
mod clip;
mod csv;
mod edges;
mod engrave;
mod error;
mod face;
mod focus;
mod gcode;
#[cfg(test)]
mod hostile;
mod hpgl;
mod input;
mod join;
mod length;
mod light;
mod line;
mod order;
mod path;
mod photo;
mod plot;
pub mod preparation;
mod preview;
mod raster;
mod render;
mod stipple;
mod styles;
mod subject;
mod svg;
mod tone;
mod tour;
mod travel;
mod vectorize;

pub use artwork::{Artwork, Layer, LayerStroke, Placed, Placement, UserSpace, off_sheet};
pub use background::Background;
pub use camera::{CameraError, take_photograph};
pub use csv::{Coordinates, Path3d, read_csv};
pub use error::{DrawingError, FilePlace};
pub use face::Face;
pub use input::{Input, load, load_content, load_with, read_file};
pub use length::{parse_duration_s, parse_length_mm, parse_point_mm, parse_size_mm};
pub use order::{OrderOptions, OrderReport, order, order_with_effort};
pub use path::{from_path, to_path};
pub(crate) use photo::SIDE_MIN as PHOTOGRAPH_SIDE_MIN_PX;
pub use preview::PreviewScene;
pub(crate) use raster::Plane;
pub(crate) use render::draw_line;
pub use render::{edge_coverage, render_png, render_rgb, tone_correlation, write_artwork, write_svg};
pub use styles::Style;
pub use subject::{Crop, FACE_PENS_MIN, FACE_PENS_WANTED, Subject, parse_focus};
pub use svg::{FontFile, TextFont, read_svg, read_svg_with};
pub use travel::Travel;
pub use vectorize::{Estimate, VectorizeOptions, estimate, vectorize, vectorize_image, vectorize_subject};
pub(crate) use vectorize::{in_faces, panels, vectorize_coarser};

use serde::{Deserialize, Serialize};

/// One line drawn without lifting the pen.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stroke {
    /// Vertices of the line on the sheet, mm: x to the right, y down, origin at the top left.
    pub points: Vec<[f64; 2]>,
}

impl Stroke {
    /// Length of the line, mm.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        line::length(&self.points)
    }
}

/// Strokes on a sheet, in the order in which they are drawn.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Drawing {
    /// Width and height of the sheet, mm.
    pub sheet_mm: [f64; 2],
    /// The strokes, first drawn first.
    pub strokes: Vec<Stroke>,
}

impl Drawing {
    /// Length of all strokes, mm.
    #[must_use]
    pub fn pen_down_mm(&self) -> f64 {
        self.strokes.iter().map(Stroke::length_mm).sum()
    }

    /// Sum of the straight distances from each stroke's end to the next one's start, mm.
    #[must_use]
    pub fn pen_up_mm(&self) -> f64 {
        // An empty sum is a negative zero.
        self.travels_mm().sum::<f64>() + 0.0
    }

    /// The straight distances from each stroke's end to the next one's start, mm.
    pub(crate) fn travels_mm(&self) -> impl Iterator<Item = f64> {
        self.strokes
            .windows(2)
            .map(|pair| match (pair[0].points.last(), pair[1].points.first()) {
                (Some(&from), Some(&to)) => line::distance(from, to),
                _ => 0.0,
            })
    }
}
