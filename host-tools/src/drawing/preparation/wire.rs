//! Vertices as the link carries them.

use etherpen::messages::PathVertex;
use etherpen::motion::Vertex;
use etherpen::robots::Position;

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

/// A vertex of the link, in millimetres.
pub(crate) fn from_wire(wire: &PathVertex) -> Vertex {
    let [x_mm, y_mm, z_mm] = wire.position_um.map(|um| f64::from(um) / 1_000.0);
    Vertex {
        position: Position { x_mm, y_mm, z_mm },
        pen: wire.pen,
        stroke: wire.stroke,
    }
}

/// A path with coordinates as the link carries them, without repetitions.
pub(crate) fn as_sent(path: &[Vertex]) -> Vec<Vertex> {
    let mut path: Vec<Vertex> = path.iter().map(|vertex| from_wire(&to_wire(vertex))).collect();
    path.dedup_by(|next, last| next.position == last.position);
    path
}
