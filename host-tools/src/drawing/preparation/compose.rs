//! Converts a file's content into strokes on the sheet, in the order of drawing.

use super::choose_order::choose_order;
use super::overview::{Overview, PhotographPart, small_copy};
use super::source::SourceArguments;
use super::time_budget;
use super::wire::as_sent;
use crate::drawing::photo::{SIDE_MIN, check_size};
use crate::drawing::{
    Artwork, Crop, Drawing, DrawingError, Input, Layer, LayerStroke, OrderOptions, Stroke, Subject, Travel,
    VectorizeOptions, in_faces, load_content, to_path, vectorize_coarser, vectorize_subject,
};
use crate::drawing::{FACE_PENS_MIN, FACE_PENS_WANTED};
use crate::error::{ProgramError, code};
use etherpen::config::Config;
use etherpen::motion::{Pen, Vertex};
use image::{RgbImage, imageops};
use std::path::Path;

/// A file as strokes on the sheet, not yet checked.
pub struct Composed {
    /// The source picture, and its place on the sheet: left, top, width and height, mm.
    pub photograph: Option<(RgbImage, [f64; 4])>,
    /// The whole photograph, of which the source picture is a part.
    pub overview: Option<Overview>,
    /// Layers and their strokes in the order of drawing; empty for a path in the robot's frame.
    pub parts: Vec<(Layer, Drawing)>,
    /// The path in the robot's frame, coordinates as the link carries them, without repetitions.
    pub path: Vec<Vertex>,
    /// Duration of the strokes by the firmware's planner, s; `None` for a path in the robot's frame, or if the robot
    /// cannot draw them.
    pub planned_s: Option<f64>,
}

/// An error of the input file.
pub(crate) fn unusable(file: &Path, cause: &dyn std::fmt::Display) -> ProgramError {
    let shown = file.display();
    let shown = if file.as_os_str() == "-" {
        "standard input".to_owned()
    } else {
        shown.to_string()
    };
    ProgramError::new(code::INPUT, format!("{shown}: {cause}"))
}

/// Vectorises and orders a file's content in this process.
///
/// # Errors
/// The file cannot be used, or it contains nothing to draw.
pub(crate) fn compose_content(
    file: &Path,
    content: &[u8],
    config: &Config,
    options: &SourceArguments,
) -> Result<Composed, ProgramError> {
    let refused = |cause: DrawingError| unusable(file, &cause);
    let (mut photograph, mut overview) = (None, None);
    let mut parts = Vec::new();
    let mut known_s = None;
    let path = match load_content(file, content, &options.font()).map_err(refused)? {
        Input::Photograph(picture) => {
            let made = from_photograph(picture, config, options).map_err(refused)?;
            made.remarks.iter().for_each(|text| eprintln!("etherpen: {text}"));
            photograph = Some((made.picture, made.place_mm));
            overview = Some(made.overview);
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
        let chosen = choose_order(&layers, &in_sequence(&parts), &order_options(config, options), config);
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
        overview,
        parts,
        // The checked path is the one that is sent.
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
pub(crate) fn in_sequence(parts: &[(Layer, Drawing)]) -> Drawing {
    Drawing {
        sheet_mm: parts.first().map_or([0.0; 2], |(_, drawing)| drawing.sheet_mm),
        strokes: parts
            .iter()
            .flat_map(|(_, drawing)| drawing.strokes.iter().cloned())
            .collect(),
    }
}

/// A photograph's strokes.
pub(crate) struct FromPhotograph {
    /// The part of the rotated picture that is drawn.
    pub(crate) picture: RgbImage,
    /// Its place on the sheet: left, top, width and height, mm.
    pub(crate) place_mm: [f64; 4],
    /// The whole rotated picture.
    pub(crate) overview: Overview,
    /// The strokes.
    pub(crate) drawing: Drawing,
    /// Planned duration of the strokes in this order, s, if a drawing time was requested.
    pub(crate) planned_s: Option<f64>,
    /// Remarks for the person who asked for the drawing.
    pub(crate) remarks: Vec<String>,
}

/// Converts a photograph into strokes, within a drawing time if one is given.
pub(crate) fn from_photograph(
    picture: RgbImage,
    config: &Config,
    options: &SourceArguments,
) -> Result<FromPhotograph, DrawingError> {
    let source = options;
    let options = source.vectorize_options(config);
    let whole = turned(picture, source)?;
    let small = small_copy(&whole);
    let Part {
        picture,
        subject,
        part,
        remarks,
    } = part_of(whole, source.crop(), &options)?;
    let place_mm = options.picture_mm(picture.width(), picture.height())?;
    let timed = match source.time_budget_s() {
        None => None,
        Some(budget_s) => {
            let in_faces = in_faces(&picture, &subject, &options)?;
            let draw = |widths| vectorize_coarser(&picture, &subject, &options, widths);
            time_budget::within(budget_s, config, &order_options(config, source), draw, in_faces)?
        }
    };
    let (drawing, planned_s) = match timed {
        Some(timed) => (timed.drawing, Some(timed.planned_s)),
        None => (vectorize_subject(&picture, &subject, &options)?, None),
    };
    Ok(FromPhotograph {
        picture,
        place_mm,
        overview: Overview { part, small },
        drawing,
        planned_s,
        remarks,
    })
}

/// The photograph rotated as requested, if its size can be used.
pub(super) fn turned(picture: RgbImage, options: &SourceArguments) -> Result<RgbImage, DrawingError> {
    let picture = match options.quarters().ok_or(DrawingError::BadRotation)? {
        0 => picture,
        1 => imageops::rotate90(&picture),
        2 => imageops::rotate180(&picture),
        _ => imageops::rotate270(&picture),
    };
    check_size(picture.width(), picture.height())?;
    Ok(picture)
}

/// The part of a photograph that is drawn.
pub(super) struct Part {
    /// Its pixels.
    pub(super) picture: RgbImage,
    /// Its subject.
    pub(super) subject: Subject,
    /// Its place in the photograph.
    pub(super) part: PhotographPart,
    /// Remarks for the person who asked for it.
    pub(super) remarks: Vec<String>,
}

/// Cuts the part of a photograph that is drawn.
pub(super) fn part_of(picture: RgbImage, crop: Crop, options: &VectorizeOptions) -> Result<Part, DrawingError> {
    let size_px @ [width, height] = [picture.width(), picture.height()];
    if options.focus.is_some_and(|focus| !is_in(focus, size_px.map(f64::from))) {
        return Err(DrawingError::BadFocus { width, height });
    }
    let subject = Subject::of(&picture, options.focus);
    let face_px = subject
        .faces
        .first()
        .map(|face| [face.centre[0], face.centre[1], face.radius]);
    let mut window_px = [0, 0, width, height];
    let room_mm = options.room_mm();
    let mut remarks = Vec::new();
    let (picture, subject) = match subject.window(size_px, crop, room_mm, options.pen_width_mm) {
        Some(window) if window[2].min(window[3]) >= SIDE_MIN => {
            if crop == Crop::Auto {
                let [left, top, width, height] = window;
                remarks.push(format!(
                    "draws the head alone (--crop {left},{top},{width},{height}), because the face would be small in the \
                     whole picture; --crop none draws everything"
                ));
            }
            window_px = window;
            subject.cut(&picture, window)
        }
        Some(_) if matches!(crop, Crop::Window(_)) => {
            return Err(DrawingError::BadCrop {
                width,
                height,
                side_min: SIDE_MIN,
            });
        }
        _ => (picture, subject),
    };
    let face_pens = subject.face_pens([picture.width(), picture.height()], room_mm, options.pen_width_mm);
    if let Some(pens) = face_pens.filter(|&pens| pens < FACE_PENS_MIN) {
        remarks.push(format!(
            "the face is only {pens:.0} pen widths wide; a likeness needs {FACE_PENS_WANTED:.0}: try --crop head, a larger \
             --size or a finer pen"
        ));
    }
    Ok(Part {
        picture,
        subject,
        part: PhotographPart {
            size_px,
            window_px,
            face_px,
        },
        remarks,
    })
}

/// Whether a face of this centre and radius, pixels, can be in a picture of this size.
fn is_in([x, y, radius]: [f64; 3], [width, height]: [f64; 2]) -> bool {
    (0.0..=width).contains(&x) && (0.0..=height).contains(&y) && radius <= width.hypot(height)
}

/// Strokes on a sheet as artwork whose page is that sheet.
pub(crate) fn artwork_of(drawing: Drawing) -> Artwork {
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
) -> Result<Vec<(Layer, Drawing)>, ProgramError> {
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
