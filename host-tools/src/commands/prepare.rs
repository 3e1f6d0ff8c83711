//! From a file to an admitted path: the part of a drawing that needs no machine.

use super::{CommandError, code};
use crate::drawing::{Drawing, Input, OrderOptions, VectorizeOptions, load, order, to_path, vectorize_image};
use crate::link::text;
use etherpen::config::Config;
use etherpen::link::protocol::{ConfigRefusal, PathVertex};
use etherpen::motion::{Admission, Pen, Vertex};
use etherpen::robot::Position;
use image::RgbImage;
use std::path::Path;

/// A file made ready for drawing.
pub struct Prepared {
    /// The picture it was made of, and where it lies on the sheet: left, top, width and height, mm.
    pub photograph: Option<(RgbImage, [f64; 4])>,
    /// The path in the robot's frame, every vertex admitted.
    pub path: Vec<Vertex>,
}

/// Reads, vectorises, orders and checks a file.
///
/// # Errors
/// The file cannot be used, or a vertex is outside what the robot may use.
pub fn prepare(file: &Path, config: &Config) -> Result<Prepared, CommandError> {
    let shown = file.display();
    let refused = |cause: &dyn std::fmt::Display| CommandError::new(code::INPUT, format!("{shown}: {cause}"));
    let input = load(file).map_err(|cause| refused(&cause))?;
    let (photograph, path) = match input {
        Input::Photograph(picture) => {
            let options = VectorizeOptions {
                sheet_mm: config.paper.size_mm,
                ..VectorizeOptions::default()
            };
            let drawing = vectorize_image(&picture, &options).map_err(|cause| refused(&cause))?;
            let place_mm = options
                .picture_mm(picture.width(), picture.height())
                .map_err(|cause| refused(&cause))?;
            (Some((picture, place_mm)), ordered(drawing, config))
        }
        Input::Drawing(drawing) => (None, ordered(drawing, config)),
        Input::Path(path) => (None, path.vertices),
    };
    if !path.iter().skip(1).any(|vertex| vertex.pen == Pen::Down) {
        return Err(refused(&"there is nothing to draw in it"));
    }
    // What travels is what is checked: coordinates as the link carries them, without repetitions.
    let mut path: Vec<Vertex> = path.iter().map(|vertex| from_wire(&to_wire(vertex))).collect();
    path.dedup_by(|next, last| next.position == last.position);
    let mut admission = Admission::new(config)
        .map_err(|cause| CommandError::new(code::USAGE, text::config_refusal(&ConfigRefusal::Geometry(cause))))?;
    for (index, vertex) in (0u32..).zip(&path) {
        admission
            .check(index, vertex)
            .map_err(|refusal| refused(&format!("stroke {}: {}", vertex.stroke + 1, text::vertex(&refusal))))?;
    }
    Ok(Prepared { photograph, path })
}

fn ordered(mut drawing: Drawing, config: &Config) -> Vec<Vertex> {
    order(&mut drawing, &OrderOptions::default());
    to_path(&drawing, &config.paper)
}

/// A vertex as it travels: micrometres.
pub fn to_wire(vertex: &Vertex) -> PathVertex {
    let Position { x_mm, y_mm, z_mm } = vertex.position;
    // A float that is out of range becomes the nearest integer, which the admission refuses.
    let position_um = [x_mm, y_mm, z_mm].map(|mm| (mm * 1_000.0).round() as i32);
    PathVertex {
        position_um,
        pen: vertex.pen,
        stroke: vertex.stroke,
    }
}

fn from_wire(wire: &PathVertex) -> Vertex {
    let [x_mm, y_mm, z_mm] = wire.position_um.map(|um| f64::from(um) / 1_000.0);
    Vertex {
        position: Position { x_mm, y_mm, z_mm },
        pen: wire.pen,
        stroke: wire.stroke,
    }
}

/// Duration the firmware's planner computes for a path, s, from rest at its first vertex to rest at its end; not a
/// number where it cannot be planned.
pub fn planned_s(config: &Config, path: &[Vertex]) -> f64 {
    crate::planning::plan(config, path, |_, _| ()).map_or(f64::NAN, |run| run.duration_ms as f64 / 1_000.0)
}
