//! One photograph drawn in several ways, side by side on a contact sheet to choose from.

use super::compose::from_photograph;
use super::grid::side_by_side;
use super::source::SourceArguments;
use crate::drawing::{Crop, Drawing, DrawingError, render_rgb};
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

/// Style, crop and background of the variants of a photograph, in the order in which they are tried; the first are those
/// asked for. A window given in pixels stays in all of them.
pub(crate) fn looks(asked: [&str; 3]) -> Vec<[String; 3]> {
    let window = matches!(Crop::parse(asked[1]), Ok(Crop::Window(_))).then_some(asked[1]);
    let mut looks = vec![asked.map(str::to_owned)];
    for [style, crop, background] in LOOKS {
        let look = [style, window.unwrap_or(crop), background].map(str::to_owned);
        if !looks.contains(&look) {
            looks.push(look);
        }
    }
    looks
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
    for look in looks(source.look())
        .iter()
        .skip(1)
        .map(|look| look.each_ref().map(String::as_str))
    {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_look_asked_for_comes_first_a_window_stays_and_none_is_repeated() {
        for asked in [
            ["sketch", "auto", "fade"],
            ["tsp", "head", "keep"],
            ["flow", "10,20,300,400", "none"],
        ] {
            let looks = looks(asked);
            assert_eq!(
                looks.first().map(|look| look.each_ref().map(String::as_str)),
                Some(asked)
            );
            assert!(looks.len() > 6, "{asked:?}: {}", looks.len());
            for (index, look) in looks.iter().enumerate() {
                assert!(!looks[..index].contains(look), "{look:?}");
                assert!(!asked[1].contains(',') || look[1] == asked[1], "{look:?}");
            }
        }
    }
}
