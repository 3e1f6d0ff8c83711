//! Prepares a file: from its content to an admitted path, without a machine.
//!
//! Every command that draws, plans or shows a file uses this module, so all of them handle the file alike.

use super::compose::{Composed, compose_content, unusable};
use super::confined;
use super::overview::Overview;
use super::source::SourceArguments;
use crate::drawing::{DrawingError, off_sheet, read_file};
use crate::error::{ProgramError, code};
use crate::link::text;
use etherpen::config::Config;
use etherpen::messages::ConfigRefusal;
use etherpen::motion::{Admission, Vertex};
use etherpen::robots::Position;
use image::RgbImage;
use std::path::Path;

/// A file made ready for drawing.
pub struct Prepared {
    /// The source picture, and its place on the sheet: left, top, width and height, mm.
    pub photograph: Option<(RgbImage, [f64; 4])>,
    /// The whole photograph, of which the source picture is a part.
    pub overview: Option<Overview>,
    /// The path in the robot's frame, every vertex admitted.
    pub path: Vec<Vertex>,
    /// Layers in the order of drawing: the name, and the number of the path's vertices up to the layer's end. Empty for
    /// a path in the robot's frame.
    pub layers: Vec<(String, usize)>,
}

/// Layers of a path: the name, and the number of vertices up to the layer's end.
fn layers_of(composed: &Composed) -> Vec<(String, usize)> {
    let mut strokes = 0;
    let ends = composed.parts.iter().map(|(layer, drawing)| {
        strokes += drawing.strokes.len();
        let end = (composed.path).partition_point(|vertex| (vertex.stroke as usize) < strokes);
        (layer.name.clone(), end)
    });
    ends.collect()
}

/// A stroke that would not be drawn.
pub struct RefusedStroke {
    /// Number of the stroke in the order of drawing, from 0.
    pub stroke: u32,
    /// First position that is refused, in the robot's frame.
    pub position: Position,
    /// Why, and what to try.
    pub reason: String,
}

/// Reads, vectorises, orders and checks a file, with the default options.
///
/// # Errors
/// As [`prepare_with`].
pub fn prepare(file: &Path, config: &Config) -> Result<Prepared, ProgramError> {
    prepare_with(file, config, &SourceArguments::default())
}

/// Reads, vectorises, orders and checks a file.
///
/// # Errors
/// The file cannot be used, or a stroke leaves the sheet or the work area.
pub fn prepare_with(file: &Path, config: &Config, options: &SourceArguments) -> Result<Prepared, ProgramError> {
    let composed = compose(file, config, options)?;
    if let Some(first) = refused(&composed, config)?.first() {
        return Err(unusable(
            file,
            &format!("stroke {}: {}", first.stroke + 1, first.reason),
        ));
    }
    Ok(Prepared {
        layers: layers_of(&composed),
        photograph: composed.photograph,
        overview: composed.overview,
        path: composed.path,
    })
}

/// Reads, vectorises and orders a file; prints warnings on stderr. The program `etherpen` does this in a separate
/// process ([`confined`]).
///
/// # Errors
/// The file cannot be used, or it contains nothing to draw.
pub fn compose(file: &Path, config: &Config, options: &SourceArguments) -> Result<Composed, ProgramError> {
    let content = read_file(file).map_err(|cause| unusable(file, &cause))?;
    if confined::is_enabled() {
        return confined::compose(file, content, config, options);
    }
    compose_content(file, &content, config, options)
}

/// The strokes that leave the sheet or the work area, each with its first refused position.
///
/// # Errors
/// The configured dimensions do not form a valid robot.
pub fn refused(composed: &Composed, config: &Config) -> Result<Vec<RefusedStroke>, ProgramError> {
    let mut result: Vec<RefusedStroke> = Vec::new();
    let mut admission = Admission::new(&config.motion_settings())
        .map_err(|cause| ProgramError::new(code::USAGE, text::config_refusal(&ConfigRefusal::Geometry(cause))))?;
    for (index, vertex) in (0u32..).zip(&composed.path) {
        if let Err(refusal) = admission.check(index, vertex)
            && result.last().is_none_or(|known| known.stroke != vertex.stroke)
        {
            result.push(RefusedStroke {
                stroke: vertex.stroke,
                position: vertex.position,
                reason: text::vertex(&refusal),
            });
        }
    }
    let strokes = composed.parts.iter().flat_map(|(_, drawing)| &drawing.strokes);
    for (number, stroke) in (0_u32..).zip(strokes) {
        let Some(at) = off_sheet(stroke, config.paper.size_mm) else {
            continue;
        };
        let x_mm = config.paper.centre_mm[0] + at[0] - 0.5 * config.paper.size_mm[0];
        let y_mm = config.paper.centre_mm[1] - at[1] + 0.5 * config.paper.size_mm[1];
        let reason = DrawingError::OffSheet {
            x_um: (at[0] * 1_000.0) as i64,
            y_um: (at[1] * 1_000.0) as i64,
        };
        result.push(RefusedStroke {
            stroke: number,
            position: Position {
                x_mm,
                y_mm,
                z_mm: config.paper.plane().z_at_mm(x_mm, y_mm),
            },
            reason: reason.to_string(),
        });
    }
    result.sort_by_key(|refused| refused.stroke);
    result.dedup_by_key(|refused| refused.stroke);
    Ok(result)
}
