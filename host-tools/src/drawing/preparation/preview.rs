//! Figures of how a file would be drawn: strokes, lengths, lifts, time and refusals.

use super::compose::Composed;
use super::prepare::RefusedStroke;
use crate::drawing::Drawing;
use crate::planning::planned_s;
use etherpen::config::Config;
use etherpen::motion::Vertex;
use serde::Serialize;
use std::collections::BTreeSet;

/// Most refusals listed.
const REFUSALS_LISTED: usize = 100;

/// How a file would be drawn.
#[derive(Debug, Serialize)]
pub struct Preview {
    /// Number of strokes.
    pub strokes: usize,
    /// Length drawn, mm.
    pub pen_down_mm: f64,
    /// Length of the travel moves, from the first stroke's start to the last one's end, mm.
    pub pen_up_mm: f64,
    /// Number of lifts of the pen.
    pub lifts: usize,
    /// Planned duration of what would be drawn, s; `None` if that is nothing.
    pub estimated_s: Option<f64>,
    /// Number of strokes that would be refused.
    pub refused: usize,
    /// The first refusals, in the order of drawing.
    pub refusals: Vec<PreviewRefusal>,
    /// Layers in the order of drawing; empty for a path in the robot's frame.
    pub layers: Vec<PreviewLayer>,
}

/// A stroke that would be refused.
#[derive(Debug, Serialize)]
pub struct PreviewRefusal {
    /// Number in the order of drawing, from 1.
    pub stroke: u32,
    /// X of the refused position in the robot's frame, mm.
    pub x_mm: f64,
    /// Y of the refused position in the robot's frame, mm.
    pub y_mm: f64,
    /// Z of the refused position in the robot's frame, mm.
    pub z_mm: f64,
    /// Why, and what to try.
    pub reason: String,
}

/// A layer of the file.
#[derive(Debug, Serialize)]
pub struct PreviewLayer {
    /// Name of the layer.
    pub name: String,
    /// Number of strokes.
    pub strokes: usize,
    /// Length drawn, mm.
    pub pen_down_mm: f64,
}

impl Preview {
    /// The figures of `drawing`, which has the strokes of `composed` in the order of drawing.
    pub fn new(composed: &Composed, drawing: &Drawing, refused: &[RefusedStroke], config: &Config) -> Self {
        let numbers: BTreeSet<u32> = refused.iter().map(|refused| refused.stroke).collect();
        let kept: Vec<Vertex> = (composed.path.iter().copied())
            .filter(|vertex| !numbers.contains(&vertex.stroke))
            .collect();
        let listed = refused.iter().take(REFUSALS_LISTED);
        let layers = composed.parts.iter().map(|(layer, drawing)| PreviewLayer {
            name: layer.name.clone(),
            strokes: drawing.strokes.len(),
            pen_down_mm: drawing.pen_down_mm(),
        });
        Self {
            strokes: drawing.strokes.len(),
            pen_down_mm: drawing.pen_down_mm(),
            pen_up_mm: drawing.pen_up_mm(),
            lifts: drawing.strokes.len(),
            estimated_s: match composed.planned_s.filter(|_| refused.is_empty()) {
                None => Some(planned_s(config, &kept)).filter(|seconds| seconds.is_finite()),
                known => known,
            },
            refused: refused.len(),
            refusals: listed
                .map(|refused| PreviewRefusal {
                    stroke: refused.stroke + 1,
                    x_mm: refused.position.x_mm,
                    y_mm: refused.position.y_mm,
                    z_mm: refused.position.z_mm,
                    reason: refused.reason.clone(),
                })
                .collect(),
            layers: layers.collect(),
        }
    }
}
