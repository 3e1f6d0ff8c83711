//! Layers of a drawing: a part of its path for each pen, with a pause before the next one.
//!
//! Invariant: the path that is drawn after a pause begins with the next layer's first stroke and ends with its last one,
//! so no pen draws a line of another layer.

use crate::job::remainder::Remainder;
use etherpen::messages::PathVertex;
use serde::Serialize;
use std::sync::Arc;

/// A layer of a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PathLayer {
    /// The layer's label or colour.
    pub name: String,
    /// Vertices of the path up to the layer's end.
    pub end: usize,
}

/// A pause as shown on the page.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PauseView {
    /// Number of the drawing.
    pub job: u64,
    /// The layer whose pen is needed.
    pub layer: String,
    /// Number of that layer, from 1.
    pub number: usize,
    /// Number of layers.
    pub layers: usize,
}

/// How far a drawing has come in its layers.
#[derive(Clone, Debug, Default)]
pub(super) struct Layers {
    layers: Vec<PathLayer>,
    /// Layers that were drawn to their end.
    done: usize,
    /// Whether the next layer waits for its pen.
    waits: bool,
}

impl Layers {
    /// Layers of a path, with a pause before each but the first. A single one is drawn without a pause.
    pub(super) fn new(layers: Vec<PathLayer>) -> Self {
        let several = layers.len() > 1;
        Self {
            layers: if several { layers } else { Vec::new() },
            ..Self::default()
        }
    }

    /// Whether there are pauses.
    pub(super) fn are_several(&self) -> bool {
        !self.layers.is_empty()
    }

    /// Whether the next layer waits for its pen.
    pub(super) fn wait(&self) -> bool {
        self.waits
    }

    /// Vertices of the layers that were drawn to their end.
    pub(super) fn drawn(&self) -> usize {
        let last = self.done.checked_sub(1).and_then(|last| self.layers.get(last));
        last.map_or(0, |layer| layer.end)
    }

    /// Counts the present layer as drawn. Returns whether another one follows, which then waits for its pen.
    pub(super) fn end(&mut self) -> bool {
        self.done += 1;
        self.waits = self.done < self.layers.len();
        self.waits
    }

    /// Takes the operator's word that the next layer's pen is in place; returns whether that was awaited.
    pub(super) fn pen_is_in(&mut self) -> bool {
        std::mem::take(&mut self.waits)
    }

    /// The part of a remainder that belongs to the present layer.
    pub(super) fn part(&self, rest: &Remainder, total: usize) -> Arc<[PathVertex]> {
        let end = self.layers.get(self.done).map_or(total, |layer| layer.end);
        let kept = rest.vertices.len().saturating_sub(total.saturating_sub(end));
        rest.vertices.get(..kept).unwrap_or_default().into()
    }

    /// The pause, if the next layer waits for its pen.
    pub(super) fn view(&self, job: u64) -> Option<PauseView> {
        let layer = self.layers.get(self.done).filter(|_| self.waits)?;
        Some(PauseView {
            job,
            layer: layer.name.clone(),
            number: self.done + 1,
            layers: self.layers.len(),
        })
    }
}
