//! Position of the picture on the sheet, and its scale while it is processed.

use super::{DrawingError, VectorizeOptions};
use crate::drawing::line::Point;

/// Pixels for each pen width while processing.
const PX_PER_PEN: f64 = 2.0;
/// Longest side of the processed picture, pixels.
const WORK_SIDE_MAX: f64 = 2400.0;

/// Position of the picture on the sheet, and its scale while processing.
pub(super) struct Frame {
    pub(super) corner_mm: [f64; 2],
    pub(super) size_mm: [f64; 2],
    pub(super) mm_per_px: f64,
    pub(super) work_px: [u32; 2],
}

impl Frame {
    pub(super) fn new(width_px: u32, height_px: u32, options: &VectorizeOptions) -> Result<Self, DrawingError> {
        let VectorizeOptions {
            sheet_mm,
            margin_mm,
            origin_mm,
            pen_width_mm,
            time_max_s,
            ..
        } = *options;
        let room = options.room_mm();
        let numbers = [room[0], room[1], pen_width_mm, time_max_s];
        let usable = numbers.iter().all(|value| value.is_finite() && *value > 0.0);
        let margin_usable = margin_mm.is_finite() && margin_mm >= 0.0 && (0.0..=1.0).contains(&options.detail);
        if !usable || !margin_usable || room[0].min(room[1]) < 8.0 * pen_width_mm {
            return Err(DrawingError::BadOptions);
        }
        let (width, height) = (f64::from(width_px.max(1)), f64::from(height_px.max(1)));
        let scale = (room[0] / width).min(room[1] / height);
        let size_mm = [width * scale, height * scale];
        let mm_per_px = (pen_width_mm / PX_PER_PEN).max(size_mm[0].max(size_mm[1]) / WORK_SIDE_MAX);
        let work_px = size_mm.map(|side| (side / mm_per_px).round().max(8.0) as u32);
        let corner_mm = origin_mm.unwrap_or([0, 1].map(|k| 0.5 * (sheet_mm[k] - size_mm[k])));
        Ok(Self {
            corner_mm,
            size_mm,
            mm_per_px,
            work_px,
        })
    }

    /// A line of the picture on the sheet, limited to the picture.
    pub(super) fn on_sheet(&self, points: &[Point]) -> Vec<Point> {
        let place = |point: &Point| {
            [0, 1].map(|k| self.corner_mm[k] + ((point[k] + 0.5) * self.mm_per_px).clamp(0.0, self.size_mm[k]))
        };
        points.iter().map(place).collect()
    }
}
