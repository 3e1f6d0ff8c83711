//! A leg: the straight line to a vertex.

use crate::vector::{Vector, add, dot, scale, subtract};

/// A straight line that the tool was ordered to take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Leg {
    pub(crate) from: Vector,
    pub(crate) to: Vector,
    pub(crate) pen_down: bool,
    along: Vector,
    /// One over the squared length; 0 for a leg without length.
    inverse: f64,
    /// One over the squared length in plan view.
    inverse_flat: f64,
    /// The part on which the pen may touch, from and to, of the leg's length; empty if the first is the greater.
    touch: [f64; 2],
}

/// Squared length below which a leg is a point, mm2.
const POINT_MM2: f64 = 1.0e-12;

fn inverse(squared: f64) -> f64 {
    if squared > POINT_MM2 { 1.0 / squared } else { 0.0 }
}

impl Leg {
    /// A leg; the pen may touch below these heights at its beginning and its end.
    pub(crate) fn new(from: Vector, to: Vector, pen_down: bool, touch_z_mm: [f64; 2]) -> Self {
        let along = subtract(to, from);
        let [room, room_at_end] = [touch_z_mm[0] - from[2], touch_z_mm[1] - to[2]];
        let touch = match room - room_at_end {
            rise if rise.abs() < 1.0e-9 => [0.0, if room >= 0.0 { 1.0 } else { -1.0 }],
            rise if rise > 0.0 => [0.0, (room / rise).min(1.0)],
            rise => [(room / rise).max(0.0), 1.0],
        };
        Self {
            from,
            to,
            pen_down,
            along,
            inverse: inverse(dot(along, along)),
            inverse_flat: inverse(along[0] * along[0] + along[1] * along[1]),
            touch,
        }
    }

    /// The leg as it counts where no axis moves the tool up and down: all of it at one height, with the part on which the
    /// pen may touch as before.
    pub(crate) fn in_plan(self, plan_z_mm: Option<f64>) -> Self {
        let Some(z_mm) = plan_z_mm else { return self };
        let at_height = |[x, y, _]: Vector| [x, y, z_mm];
        let touch = self.touch;
        Self {
            touch,
            ..Self::new(at_height(self.from), at_height(self.to), self.pen_down, [z_mm; 2])
        }
    }

    /// A point of the leg, from 0 to 1.
    pub(crate) fn at(&self, part: f64) -> Vector {
        add(self.from, scale(self.along, part))
    }

    /// Squared distance of a point, mm2.
    #[inline]
    pub(crate) fn distance_squared(&self, point: &Vector) -> f64 {
        let offset = subtract(*point, self.from);
        let part = (dot(offset, self.along) * self.inverse).clamp(0.0, 1.0);
        let beside = subtract(offset, scale(self.along, part));
        dot(beside, beside)
    }

    /// Part of the leg that is nearest to a point in plan view, and the squared distance there, mm2.
    fn nearest_flat(&self, point: &Vector, [low, high]: [f64; 2]) -> (f64, f64) {
        let (x, y) = (point[0] - self.from[0], point[1] - self.from[1]);
        let part = (x * self.along[0] + y * self.along[1]) * self.inverse_flat;
        let part = part.max(low).min(high);
        let (x, y) = (x - part * self.along[0], y - part * self.along[1]);
        (part, x * x + y * y)
    }

    /// Whether the pen may touch anywhere on the leg.
    pub(crate) fn touches(&self) -> bool {
        self.touch[0] <= self.touch[1]
    }

    /// Squared distance in plan view of a point from the part where the pen may touch, mm2; infinite without one.
    #[inline]
    pub(crate) fn touch_distance_squared(&self, point: &Vector) -> f64 {
        if self.touches() {
            self.nearest_flat(point, self.touch).1
        } else {
            f64::INFINITY
        }
    }

    /// Whether a point lies above the leg by no more than a lift: there the pen is lifted and lowered between parts of
    /// a drawing.
    pub(crate) fn is_lifted(&self, point: &Vector, lift_mm: f64, tolerance_mm: f64) -> bool {
        let (part, squared) = self.nearest_flat(point, [0.0, 1.0]);
        let (low, high) = match self.inverse_flat > 0.0 {
            true => {
                let z = self.from[2] + part * self.along[2];
                (z, z)
            }
            false => (self.from[2].min(self.to[2]), self.from[2].max(self.to[2])),
        };
        squared <= tolerance_mm * tolerance_mm
            && point[2] >= low - tolerance_mm
            && point[2] <= high + lift_mm + tolerance_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_plan_view_only_the_distance_beside_the_leg_counts_and_the_pen_touches_where_it_did() {
        let lowering = Leg::new([1.0, 2.0, -847.0], [1.0, 2.0, -850.0], false, [-849.7; 2]);
        assert_eq!(lowering.in_plan(None), lowering);
        let travel = Leg::new([0.0, 0.0, -847.0], [9.0, 0.0, -847.0], false, [-849.7; 2]).in_plan(Some(-850.0));
        assert!(!travel.touches());
        assert!((travel.distance_squared(&[4.0, 0.5, -850.0]) - 0.25).abs() < 1e-12);
        let lowering = lowering.in_plan(Some(-850.0));
        assert!((lowering.touch_distance_squared(&[1.0, 2.5, -850.0]) - 0.25).abs() < 1e-12);
    }

    #[test]
    fn distances_are_to_the_line_between_the_ends() {
        let leg = Leg::new([0.0, 0.0, -850.0], [10.0, 0.0, -850.0], true, [-849.7; 2]);
        assert!((leg.distance_squared(&[5.0, 3.0, -850.0]) - 9.0).abs() < 1e-12);
        assert!((leg.distance_squared(&[-3.0, 0.0, -846.0]) - 25.0).abs() < 1e-12);
        assert!((leg.touch_distance_squared(&[12.0, 0.0, -840.0]) - 4.0).abs() < 1e-12);
        assert!(leg.is_lifted(&[5.0, 0.1, -848.0], 3.0, 0.5));
        assert!(!leg.is_lifted(&[5.0, 0.1, -846.0], 3.0, 0.5));
        assert!(!leg.is_lifted(&[5.0, 0.6, -848.0], 3.0, 0.5));
    }

    #[test]
    fn a_leg_touches_where_it_is_low() {
        let down = Leg::new([0.0, 0.0, -847.0], [0.0, 0.0, -850.0], false, [-849.7; 2]);
        assert!(down.touches() && down.touch_distance_squared(&[0.0, 1.0, -850.0]) <= 1.0);
        let slope = Leg::new([0.0, 0.0, -850.0], [10.0, 0.0, -840.0], false, [-849.0; 2]);
        assert!(slope.touch_distance_squared(&[1.0, 0.0, -849.5]) < 1e-12);
        assert!((slope.touch_distance_squared(&[3.0, 0.0, -849.5]) - 4.0).abs() < 1e-9);
        // A level leg over a sheet that rises by 2 mm meets it half way.
        let level = Leg::new([0.0, 0.0, -849.0], [10.0, 0.0, -849.0], false, [-850.0, -848.0]);
        assert!((level.touch_distance_squared(&[2.0, 0.0, -849.0]) - 9.0).abs() < 1e-9);
        assert!(level.touch_distance_squared(&[7.0, 0.0, -849.0]) < 1e-12);
        let high = Leg::new([0.0, 0.0, -847.0], [9.0, 0.0, -847.0], false, [-849.7; 2]);
        assert!(!high.touches() && high.touch_distance_squared(&[0.0, 0.0, -847.0]).is_infinite());
    }

    #[test]
    fn a_leg_without_length_is_a_point() {
        let leg = Leg::new([1.0, 2.0, -850.0], [1.0, 2.0, -850.0], true, [-849.7; 2]);
        assert!((leg.distance_squared(&[1.0, 4.0, -850.0]) - 4.0).abs() < 1e-12);
        assert!((leg.touch_distance_squared(&[1.0, 4.0, -850.0]) - 4.0).abs() < 1e-12);
    }
}
