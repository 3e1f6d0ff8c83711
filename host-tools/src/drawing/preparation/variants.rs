//! One photograph drawn in several ways, side by side on a contact sheet to choose from.

use super::compose::from_photograph;
use super::grid::side_by_side;
use super::source::SourceArguments;
use crate::drawing::{Drawing, DrawingError, render_rgb};
use etherpen::config::Config;
use image::RgbImage;

/// Style, crop and background of the variants, in the order in which they are shown.
const LOOKS: [[&str; 3]; 13] = [
    ["sketch", "auto", "fade"],
    ["hatch", "auto", "fade"],
    ["engrave", "auto", "fade"],
    ["flow", "auto", "fade"],
    ["tsp", "auto", "fade"],
    ["sketch", "none", "fade"],
    ["hatch", "head", "none"],
    ["sketch", "head", "keep"],
    ["engrave", "none", "fade"],
    ["sketch", "subject", "none"],
    ["tsp", "none", "keep"],
    ["flow", "none", "keep"],
    ["hatch", "none", "keep"],
];
/// Scale at which drawings are rendered before they are reduced, pixels a millimetre.
const PX_PER_MM: f64 = 8.0;

/// A drawing and the options that draw it.
pub(crate) struct Variant {
    /// The options as on the command line.
    pub(crate) options: String,
    /// The strokes.
    pub(crate) drawing: Drawing,
}

impl Variant {
    fn new([style, crop, background]: [&str; 3], drawing: Drawing) -> Self {
        Self {
            options: format!("--style {style} --crop {crop} --background {background}"),
            drawing,
        }
    }
}

/// At most `count` drawings of a photograph, the first of them `drawing`, which `source` asks for. Options that lead to the
/// lines of an earlier one are left out: a head that fills the picture is not cropped.
///
/// # Errors
/// The first drawing that cannot be made.
pub(crate) fn variants_of(
    picture: &RgbImage,
    config: &Config,
    source: &SourceArguments,
    drawing: Drawing,
    count: usize,
) -> Result<Vec<Variant>, DrawingError> {
    let mut variants = vec![Variant::new(source.look(), drawing)];
    for look in LOOKS.into_iter().filter(|look| *look != source.look()) {
        if variants.len() >= count {
            break;
        }
        let drawing = from_photograph(picture.clone(), config, &source.varied(look))?.drawing;
        if variants.iter().all(|other| other.drawing.strokes != drawing.strokes) {
            variants.push(Variant::new(look, drawing));
        }
    }
    Ok(variants)
}

/// All variants side by side, each above its options, as the bytes of a PNG.
///
/// # Errors
/// [`DrawingError::Unsupported`] if the picture cannot be encoded.
pub(crate) fn contact_sheet(variants: &[Variant], pen_width_mm: f64) -> Result<Vec<u8>, DrawingError> {
    let cells = (1..).zip(variants).map(|(k, variant)| {
        let drawing = &variant.drawing;
        let rendered = render_rgb(&drawing.strokes, drawing.sheet_mm, pen_width_mm, PX_PER_MM);
        (rendered, format!("{k}: {}", short(&variant.options)))
    });
    side_by_side(variants.len(), cells)
}

/// Options without those that have their default.
fn short(options: &str) -> String {
    options.replace(" --crop auto", "").replace(" --background fade", "")
}
