//! Merges vertices that are denser than the tolerance can tell, in one pass and constant memory.
//!
//! A vertex that ends a short leg is held back until the next one shows whether it may be dropped. Dropped vertices
//! stay within a share e of the tolerance of the leg that replaces theirs, and the shaping of such a leg uses e less.
//! Vertices at which pen or stroke change are kept, as are the first and the last. The order never changes.
//!
//! # Proof
//!
//! Let the leg from a to b replace the vertices p1 .. pn between them, ri the distance of pi from a, and Ri the largest
//! of r1 .. ri. The rule drops pi
//! - while Ri <= e; or
//! - if ri >= Ri - 0.35 e and the direction from a to b is within asin(0.6 e / ri) of that from a to pi. Also b keeps
//!   |b - a| >= Rn - 0.35 e.
//!
//! Give each pi a place ti on the leg: 0 while Ri <= e, then the largest projection so far on the direction of the leg,
//! at most |b - a|. Places never decrease. In the first case the distance of pi from its place is ri <= e. In the second
//! ri >= 0.65 e; across the leg the distance is hi <= 0.6 e; the projection is si >= sqrt(ri^2 - hi^2) >= 0.25 e, so ri -
//! si = hi^2 / (ri + si) <= 0.4 e. As ti <= Ri <= ri + 0.35 e, ti - si <= 0.75 e; where |b - a| bounds ti, si exceeds it by
//! at most 0.35 e. The distance of pi from its place is at most sqrt(0.6^2 + 0.75^2) e < 0.97 e. Between two vertices,
//! points in equal proportion are no farther apart than at the ends (a ball is convex). The two lines therefore stay
//! within e of each other in the order of travel (their Frechet distance), in both directions.

use super::admission::LEG_MIN_MM;
use super::shaping::Node;
use crate::robots::vector::{Vector, add, length, scale, subtract};
use crate::settings::averaging::tolerances;
use crate::settings::{Orientation, Settings};

/// Bound on the distance across the leg, as a part of the share.
const ACROSS: f64 = 0.6;
/// Bound on the way back, as a part of the share.
const BACK: f64 = 0.35;
/// Longest leg to a vertex that may be dropped, in tolerances: 0.2 mm by default, where the planner's 2,000 corners a
/// second pass at 400 mm/s.
const DENSE_TOLERANCES: f64 = 4.0;
/// Longest way along the input that one leg replaces, mm: reports of progress name the vertices at its ends only.
const REPLACED_MAX_MM: f64 = 2.0;

/// Directions within an angle of an axis.
#[derive(Clone, Copy, Debug)]
struct Cone {
    axis: Vector,
    half_rad: f64,
}

/// The vertex that is held back, and what has been dropped before it.
#[derive(Clone, Copy, Debug)]
struct Held {
    node: Node,
    /// Largest distance from the anchor so far, mm.
    farthest_mm: f64,
    /// Way along the input since the anchor, mm.
    way_mm: f64,
    /// Directions that keep all vertices since the anchor; `None` while all directions do.
    cone: Option<Cone>,
}

/// Holds back at most one vertex.
#[derive(Clone, Debug)]
pub(crate) struct Merger {
    /// Largest distance of a dropped vertex from the path, mm; 0 merges nothing.
    share_mm: f64,
    dense_mm: f64,
    held: Option<Held>,
}

/// What becomes of the vertices when another one arrives: those to be queued, in order.
pub(crate) type Queued = [Option<Node>; 2];

impl Merger {
    /// A merger that merges nothing.
    pub(crate) const fn new() -> Self {
        Self {
            share_mm: 0.0,
            dense_mm: 0.0,
            held: None,
        }
    }

    /// Takes the tolerances of a configuration. Where the fourth axis follows the path nothing is merged, because
    /// admission counts the turns at every vertex.
    pub(crate) fn configure(&mut self, settings: &Settings) {
        let merges = settings.motion.orientation == Orientation::Constant;
        self.share_mm = if merges { tolerances(settings).merging_mm } else { 0.0 };
        self.dense_mm = if merges {
            DENSE_TOLERANCES * settings.motion.tolerance_mm
        } else {
            0.0
        };
        self.held = None;
    }

    /// Whether a vertex is held back.
    pub(crate) fn holds(&self) -> bool {
        self.held.is_some()
    }

    /// The vertex that is held back.
    pub(crate) fn last_mut(&mut self) -> Option<&mut Node> {
        self.held.as_mut().map(|held| &mut held.node)
    }

    /// Releases the vertex that is held back: the path ends there, or is discarded.
    pub(crate) fn release(&mut self) -> Option<Node> {
        self.held.take().map(|held| held.node)
    }

    /// Takes the next vertex; `last` is the last one that was queued, where a leg that replaces others begins.
    pub(crate) fn take(&mut self, node: Node, last: &Vector) -> Queued {
        let Some(held) = self.held else {
            return [None, self.hold(node, last)];
        };
        if let Some(next) = self.without(&held, &node, last) {
            self.held = Some(next);
            return [None, None];
        }
        self.held = None;
        [Some(held.node), self.hold(node, &held.node.point)]
    }

    /// Holds a vertex back if it ends a short leg, otherwise returns it.
    fn hold(&mut self, node: Node, anchor: &Vector) -> Option<Node> {
        let way = subtract(&node.point, anchor);
        let way_mm = length(&way);
        // Rounding of the vertices' numbers never makes a merged leg that counts as a repeated vertex.
        if way_mm >= self.dense_mm || self.share_mm < LEG_MIN_MM {
            return Some(node);
        }
        self.held = Some(Held {
            node,
            farthest_mm: way_mm,
            way_mm,
            cone: self.narrowed(None, &way, way_mm, way_mm),
        });
        None
    }

    /// The state after the held vertex is dropped in favour of the next one; `None` if it has to be kept.
    fn without(&self, held: &Held, node: &Node, anchor: &Vector) -> Option<Held> {
        let step_mm = length(&subtract(&node.point, &held.node.point));
        let way = subtract(&node.point, anchor);
        let (distance_mm, way_mm) = (length(&way), held.way_mm + step_mm);
        let same = (node.pen, node.stroke) == (held.node.pen, held.node.stroke);
        let returns = distance_mm < held.farthest_mm - BACK * self.share_mm && held.farthest_mm > self.share_mm;
        if !same || step_mm >= self.dense_mm || way_mm > REPLACED_MAX_MM || distance_mm < LEG_MIN_MM || returns {
            return None;
        }
        let farthest_mm = held.farthest_mm.max(distance_mm);
        if let Some(cone) = &held.cone
            && angle(&cone.axis, &scale(&way, 1.0 / distance_mm)) > cone.half_rad
        {
            return None;
        }
        Some(Held {
            node: Node { merged: true, ..*node },
            farthest_mm,
            way_mm,
            cone: self.narrowed(held.cone, &way, distance_mm, farthest_mm),
        })
    }

    /// The directions of a cone that also keep a vertex at `way` from the anchor.
    fn narrowed(&self, cone: Option<Cone>, way: &Vector, distance_mm: f64, farthest_mm: f64) -> Option<Cone> {
        if farthest_mm <= self.share_mm {
            return cone;
        }
        let own = Cone {
            axis: scale(way, 1.0 / distance_mm),
            half_rad: libm::asin((ACROSS * self.share_mm / distance_mm).min(1.0)),
        };
        Some(cone.map_or(own, |cone| common(&cone, &own)))
    }
}

/// A cone within two others whose axes are no farther apart than the sum of their angles. In a plane it is all that they
/// have in common.
fn common(one: &Cone, other: &Cone) -> Cone {
    let apart = angle(&one.axis, &other.axis);
    if apart + other.half_rad <= one.half_rad {
        return *other;
    }
    if apart + one.half_rad <= other.half_rad {
        return *one;
    }
    let from_one = 0.5 * (apart - other.half_rad + one.half_rad);
    let axis = add(
        &scale(&one.axis, libm::sin(apart - from_one)),
        &scale(&other.axis, libm::sin(from_one)),
    );
    Cone {
        axis: scale(&axis, 1.0 / length(&axis).max(f64::MIN_POSITIVE)),
        half_rad: 0.5 * (one.half_rad + other.half_rad - apart),
    }
}

/// Angle between two unit vectors, rad.
fn angle(one: &Vector, other: &Vector) -> f64 {
    2.0 * libm::asin((0.5 * length(&subtract(one, other))).min(1.0))
}
