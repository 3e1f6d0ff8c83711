//! Prepares a file: from its content to an admitted path, without a machine.
//!
//! Every command that draws, plans or shows a file uses this module, so all of them handle the file alike.

use super::budget;
use super::confined;
use super::quickest::{as_sent, quickest};
use super::source::SourceArguments;
use super::{CommandError, code};
use crate::drawing::{
    Artwork, Drawing, DrawingError, Input, Layer, LayerStroke, OrderOptions, Stroke, Travel, VectorizeOptions,
    load_content, off_sheet, read_file, to_path, vectorize_image,
};
use crate::link::text;
use etherpen::config::Config;
use etherpen::link::protocol::{ConfigRefusal, PathVertex};
use etherpen::motion::{Admission, Pen, Vertex};
use etherpen::robot::Position;
use image::{RgbImage, imageops};
use std::path::Path;

/// A file made ready for drawing.
pub struct Prepared {
    /// The picture it was made of, and where it lies on the sheet: left, top, width and height, mm.
    pub photograph: Option<(RgbImage, [f64; 4])>,
    /// The path in the robot's frame, every vertex admitted.
    pub path: Vec<Vertex>,
}

/// A file as strokes on the sheet, not yet checked.
pub struct Composed {
    /// The picture it was made of, and where it lies on the sheet: left, top, width and height, mm.
    pub photograph: Option<(RgbImage, [f64; 4])>,
    /// Layers and their strokes in the order of drawing; none for a path in the robot's frame.
    pub parts: Vec<(Layer, Drawing)>,
    /// The path in the robot's frame, coordinates as the link carries them, without repetitions.
    pub path: Vec<Vertex>,
    /// Duration of the strokes by the firmware's planner, s; none for a path in the robot's frame, or where the robot
    /// cannot draw them.
    pub planned_s: Option<f64>,
}

/// A stroke that would not be drawn.
pub struct Refused {
    /// Its number in the order of drawing, the first is 0.
    pub stroke: u32,
    /// Where, in the robot's frame.
    pub position: Position,
    /// Why, and what to try.
    pub reason: String,
}

/// Reads, vectorises, orders and checks a file, with the default options.
///
/// # Errors
/// As [`prepare_with`].
pub fn prepare(file: &Path, config: &Config) -> Result<Prepared, CommandError> {
    prepare_with(file, config, &SourceArguments::default())
}

/// Reads, vectorises, orders and checks a file.
///
/// # Errors
/// The file cannot be used, or a stroke leaves the sheet or the work area.
pub fn prepare_with(file: &Path, config: &Config, options: &SourceArguments) -> Result<Prepared, CommandError> {
    let composed = compose(file, config, options)?;
    if let Some(first) = refused(&composed, config)?.first() {
        return Err(unusable(
            file,
            &format!("stroke {}: {}", first.stroke + 1, first.reason),
        ));
    }
    Ok(Prepared {
        photograph: composed.photograph,
        path: composed.path,
    })
}

/// An error of the input file.
pub(super) fn unusable(file: &Path, cause: &dyn std::fmt::Display) -> CommandError {
    let shown = file.display();
    let shown = if file.as_os_str() == "-" {
        "standard input".to_owned()
    } else {
        shown.to_string()
    };
    CommandError::new(code::INPUT, format!("{shown}: {cause}"))
}

/// Reads, vectorises and orders a file; says on stderr what a person should know about it. The program does it in a
/// process of its own ([`confined`]).
///
/// # Errors
/// The file cannot be used, or it contains nothing to draw.
pub fn compose(file: &Path, config: &Config, options: &SourceArguments) -> Result<Composed, CommandError> {
    let content = read_file(file).map_err(|cause| unusable(file, &cause))?;
    if confined::is_enabled() {
        return confined::compose(file, content, config, options);
    }
    compose_content(file, &content, config, options)
}

/// Vectorises and orders a file's content in this process.
///
/// # Errors
/// The file cannot be used, or it contains nothing to draw.
pub(super) fn compose_content(
    file: &Path,
    content: &[u8],
    config: &Config,
    options: &SourceArguments,
) -> Result<Composed, CommandError> {
    let refused = |cause: DrawingError| unusable(file, &cause);
    let mut photograph = None;
    let mut parts = Vec::new();
    let mut known_s = None;
    let path = match load_content(file, content, &options.font()).map_err(refused)? {
        Input::Photograph(picture) => {
            let made = from_photograph(picture, config, options).map_err(refused)?;
            photograph = Some((made.picture, made.place_mm));
            known_s = made.planned_s;
            parts.push((Layer::default(), made.drawing));
            Vec::new()
        }
        Input::Drawing(drawing) => {
            parts = on_sheet(file, &artwork_of(drawing), config, options)?;
            Vec::new()
        }
        Input::Artwork(artwork) => {
            parts = on_sheet(file, &artwork, config, options)?;
            Vec::new()
        }
        Input::Path(path) => path.vertices,
    };
    if known_s.is_none() {
        let layers: Vec<Drawing> = parts.iter().map(|(_, drawing)| drawing.clone()).collect();
        let chosen = quickest(&layers, &in_sequence(&parts), &order_options(config, options), config);
        if let Some(layers) = chosen.layers {
            let pairs = parts.iter_mut().zip(layers);
            pairs.for_each(|((_, drawing), ordered)| *drawing = ordered);
        }
        known_s = chosen.chosen_s;
    }
    let path = if parts.is_empty() {
        path
    } else {
        to_path(&in_sequence(&parts), &config.paper)
    };
    if !path.iter().skip(1).any(|vertex| vertex.pen == Pen::Down) {
        return Err(refused(DrawingError::NothingDrawn));
    }
    Ok(Composed {
        photograph,
        parts,
        // What travels is what is checked.
        path: as_sent(&path),
        planned_s: known_s,
    })
}

fn order_options(config: &Config, options: &SourceArguments) -> OrderOptions {
    OrderOptions {
        join_gap_mm: options.pen_width_mm(),
        keep_order: options.keeps_order(),
        travel: Travel::of(config),
    }
}

/// All layers' strokes, one layer after the other.
pub(super) fn in_sequence(parts: &[(Layer, Drawing)]) -> Drawing {
    Drawing {
        sheet_mm: parts.first().map_or([0.0; 2], |(_, drawing)| drawing.sheet_mm),
        strokes: parts
            .iter()
            .flat_map(|(_, drawing)| drawing.strokes.iter().cloned())
            .collect(),
    }
}

/// A photograph's strokes.
pub(super) struct FromPhotograph {
    /// The picture as it was turned.
    pub(super) picture: RgbImage,
    /// Its place on the sheet: left, top, width and height, mm.
    pub(super) place_mm: [f64; 4],
    /// The strokes.
    pub(super) drawing: Drawing,
    /// Their duration in this order by the firmware's planner, s, where they were made for a time.
    pub(super) planned_s: Option<f64>,
}

/// Converts a photograph into strokes, within a drawing time if one is given.
pub(super) fn from_photograph(
    picture: RgbImage,
    config: &Config,
    options: &SourceArguments,
) -> Result<FromPhotograph, DrawingError> {
    let picture = match options.quarters().ok_or(DrawingError::BadRotation)? {
        0 => picture,
        1 => imageops::rotate90(&picture),
        2 => imageops::rotate180(&picture),
        _ => imageops::rotate270(&picture),
    };
    let source = options;
    let options = source.vectorize_options(config);
    let place_mm = options.picture_mm(picture.width(), picture.height())?;
    let timed = match source.time_budget_s() {
        None => None,
        Some(budget_s) => budget::within(budget_s, config, &order_options(config, source), |widths| {
            let wider = VectorizeOptions {
                pen_width_mm: widths * options.pen_width_mm,
                ..options
            };
            vectorize_image(&picture, &wider)
        })?,
    };
    let (drawing, planned_s) = match timed {
        Some(timed) => (timed.drawing, Some(timed.planned_s)),
        None => (vectorize_image(&picture, &options)?, None),
    };
    Ok(FromPhotograph {
        picture,
        place_mm,
        drawing,
        planned_s,
    })
}

/// Strokes on a sheet as artwork whose page is that sheet.
pub(super) fn artwork_of(drawing: Drawing) -> Artwork {
    Artwork {
        page_mm: Some(drawing.sheet_mm),
        layers: vec![Layer::default()],
        strokes: (drawing
            .strokes
            .into_iter()
            .filter(|stroke: &Stroke| stroke.points.len() > 1))
        .map(|stroke| LayerStroke { layer: 0, stroke })
        .collect(),
        ..Artwork::default()
    }
}

fn on_sheet(
    file: &Path,
    artwork: &Artwork,
    config: &Config,
    options: &SourceArguments,
) -> Result<Vec<(Layer, Drawing)>, CommandError> {
    artwork.warnings.iter().for_each(|text| eprintln!("etherpen: {text}"));
    let placed = artwork
        .placed(config.paper.size_mm, &options.placement())
        .map_err(|cause| unusable(file, &cause))?;
    let ([width, height], [sheet_width, sheet_height]) = (placed.size_mm, config.paper.size_mm);
    eprintln!(
        "etherpen: {width:.1} x {height:.1} mm at scale {:.3} on a sheet of {sheet_width} x {sheet_height} mm",
        placed.scale
    );
    if placed.parts.len() > 1 {
        let shown = |layer: &Layer| match artwork.layers.iter().position(|known| known == layer) {
            Some(index) if layer.name.is_empty() => format!("no name (--layer {})", index + 1),
            _ => layer.name.clone(),
        };
        let names: Vec<String> = placed.parts.iter().map(|(layer, _)| shown(layer)).collect();
        eprintln!(
            "etherpen: {} layers, drawn one after the other: {}; --layer draws one of them, `draw --pause` waits between them",
            names.len(),
            names.join(", ")
        );
    }
    Ok(placed.parts)
}

/// The strokes that leave the sheet or what the robot may use, each with its first place.
///
/// # Errors
/// The configured dimensions do not form a valid delta robot.
pub fn refused(composed: &Composed, config: &Config) -> Result<Vec<Refused>, CommandError> {
    let mut result: Vec<Refused> = Vec::new();
    let mut admission = Admission::new(&config.motion_settings())
        .map_err(|cause| CommandError::new(code::USAGE, text::config_refusal(&ConfigRefusal::Geometry(cause))))?;
    for (index, vertex) in (0u32..).zip(&composed.path) {
        if let Err(refusal) = admission.check(index, vertex)
            && result.last().is_none_or(|known| known.stroke != vertex.stroke)
        {
            result.push(Refused {
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
        let reason = DrawingError::OffSheet {
            x_um: (at[0] * 1_000.0) as i64,
            y_um: (at[1] * 1_000.0) as i64,
        };
        result.push(Refused {
            stroke: number,
            position: Position {
                x_mm: config.paper.centre_mm[0] + at[0] - 0.5 * config.paper.size_mm[0],
                y_mm: config.paper.centre_mm[1] - at[1] + 0.5 * config.paper.size_mm[1],
                z_mm: config.paper.pen_down_z_mm,
            },
            reason: reason.to_string(),
        });
    }
    result.sort_by_key(|refused| refused.stroke);
    result.dedup_by_key(|refused| refused.stroke);
    Ok(result)
}

/// A vertex in the wire format: micrometres.
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

pub(super) fn from_wire(wire: &PathVertex) -> Vertex {
    let [x_mm, y_mm, z_mm] = wire.position_um.map(|um| f64::from(um) / 1_000.0);
    Vertex {
        position: Position { x_mm, y_mm, z_mm },
        pen: wire.pen,
        stroke: wire.stroke,
    }
}

/// Duration that the firmware's planner computes for a path, s, from rest at its first vertex to rest at its end; NaN
/// if it cannot be planned.
pub fn planned_s(config: &Config, path: &[Vertex]) -> f64 {
    crate::planning::plan(config, path, |_, _| ()).map_or(f64::NAN, |run| run.duration_ms as f64 / 1_000.0)
}
