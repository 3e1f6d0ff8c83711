//! The stages from a photograph to its lines and tone, side by side in one picture.

use super::compose::{Part, part_of, turned};
use super::grid::side_by_side;
use super::source::SourceArguments;
use crate::drawing::{DrawingError, panels};
use etherpen::config::Config;
use image::RgbImage;

/// What the vectoriser finds in the part of a photograph that would be drawn, as the bytes of a PNG: evened exposure
/// and contrast, faces and landmarks, weights of focus and background, edges, tone, directions.
///
/// # Errors
/// Errors of the vectoriser for this photograph and these options.
pub(crate) fn stages(picture: RgbImage, config: &Config, source: &SourceArguments) -> Result<Vec<u8>, DrawingError> {
    let options = source.vectorize_options(config);
    let Part { picture, subject, .. } = part_of(turned(picture, source)?, source.crop(), &options)?;
    let panels = panels(&picture, &subject, &options)?;
    let count = panels.len();
    side_by_side(
        count,
        panels.into_iter().map(|(name, picture)| (picture, name.to_owned())),
    )
}
