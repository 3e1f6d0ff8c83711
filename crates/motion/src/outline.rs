//! The shaped path alone, without speeds: the curve that the planner follows.
//!
//! Tools that compare the planner with others need the curve itself. The curve comes from the trajectory stage's
//! shaping, leg by leg, in bounded memory.

use super::Vertex;
use super::ring::Ring;
use super::shaping::{Node, PIECES_PER_LEG, Piece, QUEUE, Shaper};
use crate::robots::vector::{Vector, length};
use crate::robots::{GeometryError, JointRows, Kinematics};
use crate::settings::Settings;
use heapless::Vec;

/// Shapes a path and returns its sections.
#[derive(Clone, Debug)]
pub struct Outline {
    kinematics: Kinematics,
    shaper: Shaper,
    queue: Ring<Node, QUEUE>,
    finished: bool,
}

/// A smooth section of the shaped path, over a parameter from 0 to 1.
#[derive(Clone, Copy, Debug)]
pub struct Section {
    kinematics: Kinematics,
    piece: Piece,
}

/// Geometry of the path at one parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Position, mm.
    pub point: Vector,
    /// Derivatives of the main axes' angles with respect to arc length.
    pub joints: JointRows,
    /// Curvature, 1/mm.
    pub curvature: f64,
}

impl Outline {
    /// Starts shaping within the tolerances of a configuration, from a vertex at rest.
    ///
    /// # Errors
    /// The dimensions do not form a valid robot.
    pub fn new(settings: &Settings, first: &Vertex) -> Result<Self, GeometryError> {
        let mut shaper = Shaper::new();
        shaper.configure(settings);
        shaper.place(node(first));
        Ok(Self {
            kinematics: Kinematics::new(&settings.geometry)?,
            shaper,
            queue: Ring::new(Node::NONE),
            finished: false,
        })
    }

    /// Appends a vertex, which must differ from the one before it; returns `false` when sections have to be taken
    /// first.
    pub fn push(&mut self, vertex: &Vertex) -> bool {
        if self.queue.room() == 0 {
            return false;
        }
        self.queue.push(node(vertex));
        true
    }

    /// Marks the end of the path.
    pub fn finish(&mut self) {
        self.finished = true;
    }

    /// The sections of the next leg, if enough of the path is known.
    pub fn next_leg(&mut self) -> Option<Vec<Section, PIECES_PER_LEG>> {
        let pieces = self.shaper.next_leg(&mut self.queue, self.finished)?;
        let section = |piece| Section {
            kinematics: self.kinematics,
            piece,
        };
        Some(pieces.into_iter().map(section).collect())
    }
}

/// A vertex for the shaper. The sections do not count vertices.
fn node(vertex: &Vertex) -> Node {
    Node {
        point: vertex.position.into(),
        pen: vertex.pen,
        stroke: vertex.stroke,
        count: 0,
        merged: false,
    }
}

impl Section {
    /// Number of intervals of the planner's grid on this section, evenly spaced in the parameter.
    pub fn intervals(&self) -> u16 {
        self.piece.intervals.max(1)
    }

    /// Whether the path is at rest at the end of this section.
    pub fn stops(&self) -> bool {
        self.piece.stop_after
    }

    /// Whether any part of the section is drawn.
    pub fn is_drawn(&self) -> bool {
        self.piece.drawn()
    }

    /// Geometry of the path at a parameter.
    pub fn station(&self, parameter: f64) -> Station {
        let frame = self.piece.curve.frame(parameter);
        Station {
            point: frame.point,
            joints: self.kinematics.rows(&frame.point, &frame.tangent, &frame.bend),
            curvature: length(&frame.bend),
        }
    }

    /// Arc length between two parameters, mm.
    pub fn arc_mm(&self, from: f64, to: f64) -> f64 {
        self.piece.curve.arc(from, to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pen;

    #[test]
    fn the_sections_join_and_end_at_the_last_vertex() {
        let points = [
            [0.0, 0.0],
            [20.0, 0.0],
            [20.0, 15.0],
            [21.0, 15.2],
            [22.0, 15.3],
            [20.0, 15.3],
        ];
        let vertices = points.map(|[x, y]| Vertex {
            position: [x, y, -800.0].into(),
            pen: Pen::Down,
            stroke: 0,
        });
        let mut outline = Outline::new(&Settings::default(), &vertices[0]).unwrap();
        for vertex in &vertices[1..] {
            assert!(outline.push(vertex));
        }
        outline.finish();
        let (mut end, mut arc_mm, mut stops) = ([0.0, 0.0, -800.0], 0.0, 0);
        while let Some(sections) = outline.next_leg() {
            for section in sections {
                let start = section.station(0.0).point;
                assert!(length(&crate::robots::vector::subtract(&start, &end)) < 1.0e-9);
                end = section.station(1.0).point;
                arc_mm += section.arc_mm(0.0, 1.0);
                stops += u32::from(section.stops());
                assert!(section.is_drawn() && section.intervals() > 0);
            }
        }
        assert!(length(&crate::robots::vector::subtract(&end, &[20.0, 15.3, -800.0])) < 1.0e-9);
        assert!(arc_mm > 38.5 && arc_mm < 39.1, "{arc_mm}");
        assert_eq!(stops, 2, "the reversal and the end");
    }
}
