//! Admission: every vertex is checked before anything moves.
//!
//! A vertex is admitted when it lies in the work area and so does its leg, checked every 5 mm. The same check runs
//! on the host before a path is sent and in the firmware when it arrives.
//!
//! The shaped path is inside too: it stays in the hull of its vertices, which is enough for cylinder and planes, and
//! within the tolerance of its legs, which is the room that the checked points keep from what the arms allow.

use super::{Refusal, RefusalReason, Vertex};
use crate::config::Config;
use crate::robot::vector::{Vector, add_scaled, length, subtract};
use crate::robot::{GeometryError, JointAngles, Outside, Position, WorkArea};

/// Distance of the points that are checked on a leg, mm.
pub const LEG_CHECK_MM: f64 = 5.0;
/// Shortest leg, mm: half of the wire's resolution.
pub const LEG_MIN_MM: f64 = 0.0005;
/// Room kept from what the arms allow, beside the tolerance, mm: between two checked points of a leg their limits can be
/// nearer than at both.
const LEG_ROOM_MM: f64 = 0.05;
/// Points checked on one leg at most; more than any leg inside a work area needs.
const LEG_CHECKS_MAX: u32 = 4_000;

/// Checks the vertices of a path in order.
#[derive(Clone, Debug)]
pub struct Admission {
    area: WorkArea,
    room_mm: f64,
    previous: Option<Position>,
    /// Where the robot stands when the path begins.
    start: Option<Position>,
}

impl Admission {
    /// Admission with the limits of a configuration, before the first vertex of a path.
    ///
    /// # Errors
    /// A geometry that is no delta robot.
    pub fn new(config: &Config) -> Result<Self, GeometryError> {
        Ok(Self {
            area: WorkArea::new(config)?,
            room_mm: config.motion.travel_tolerance_mm.max(config.motion.tolerance_mm) + LEG_ROOM_MM,
            previous: None,
            start: None,
        })
    }

    /// Begins a new path from anywhere.
    pub fn restart(&mut self) {
        self.previous = None;
        self.start = None;
    }

    /// Begins a new path from a pose: the way to its first vertex is checked too, unless the robot stands outside the
    /// work area and has to come in.
    pub fn restart_at(&mut self, pose: &JointAngles) {
        self.previous = None;
        let position = self.area.delta().forward(pose).ok();
        self.start = position.filter(|position| self.area.check(position).is_ok());
    }

    /// Checks vertex `index` of the path; one that is refused leaves the state as it was.
    ///
    /// # Errors
    /// The index with the first reason found.
    pub fn check(&mut self, index: u32, vertex: &Vertex) -> Result<(), Refusal> {
        self.reason(&vertex.position)
            .map_err(|reason| Refusal { index, reason })?;
        self.previous = Some(vertex.position);
        Ok(())
    }

    fn reason(&self, position: &Position) -> Result<(), RefusalReason> {
        let point = Vector::from(*position);
        if !point.iter().all(|value| value.is_finite()) {
            return Err(RefusalReason::NotFinite);
        }
        self.area
            .check_around(position, self.room_mm)
            .map_err(RefusalReason::Outside)?;
        let leaves = |(at, outside)| RefusalReason::Leg { at, outside };
        let Some(previous) = self.previous else {
            let Some(start) = self.start else { return Ok(()) };
            // A robot that stands with less room may leave.
            let room_mm = if self.area.check_around(&start, self.room_mm).is_ok() {
                self.room_mm
            } else {
                0.0
            };
            return check_leg(&self.area, room_mm, &start, position).map_err(leaves);
        };
        let distance_mm = length(&subtract(&point, &previous.into()));
        if distance_mm < LEG_MIN_MM {
            return Err(RefusalReason::Repeated { distance_mm });
        }
        check_leg(&self.area, self.room_mm, &previous, position).map_err(leaves)
    }
}

/// Checks the points between two positions; gives the first that is outside and why.
pub(crate) fn check_leg(
    area: &WorkArea,
    room_mm: f64,
    from: &Position,
    to: &Position,
) -> Result<(), (Position, Outside)> {
    let start = Vector::from(*from);
    let leg = subtract(&(*to).into(), &start);
    let checks = (libm::ceil(length(&leg) / LEG_CHECK_MM) as u32).clamp(1, LEG_CHECKS_MAX);
    for check in 1..checks {
        let at = Position::from(add_scaled(&start, &leg, f64::from(check) / f64::from(checks)));
        area.check_around(&at, room_mm).map_err(|outside| (at, outside))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Pen;

    fn vertex(x_mm: f64, y_mm: f64, z_mm: f64) -> Vertex {
        Vertex {
            position: Position { x_mm, y_mm, z_mm },
            pen: Pen::Down,
            stroke: 0,
        }
    }

    #[test]
    fn a_refusal_names_the_index_and_the_reason_and_changes_nothing() {
        let mut admission = Admission::new(&Config::default()).unwrap();
        assert_eq!(admission.check(0, &vertex(10.0, 0.0, -850.0)), Ok(()));
        let refusal = admission.check(1, &vertex(f64::NAN, 0.0, -850.0)).unwrap_err();
        assert_eq!((refusal.index, refusal.reason), (1, RefusalReason::NotFinite));
        let refusal = admission.check(2, &vertex(10.0, 0.0, -850.0)).unwrap_err();
        assert_eq!(refusal.reason, RefusalReason::Repeated { distance_mm: 0.0 });
        let refusal = admission.check(3, &vertex(900.0, 0.0, -850.0)).unwrap_err();
        assert!(matches!(refusal.reason, RefusalReason::Outside(Outside::Radius { .. })));
        assert_eq!(admission.check(4, &vertex(11.0, 0.0, -850.0)), Ok(()));
    }

    #[test]
    fn a_leg_that_leaves_the_work_area_between_its_ends_is_refused() {
        let mut config = Config::default();
        // Below the lowest elbow hangs a sphere of the forearm's length that the platform cannot enter.
        config.geometry.arm_range_rad[0] = 0.0;
        config.geometry.arm_margin_rad = 0.2;
        config.paper.pressing_depth_mm = 10.0;
        let mut admission = Admission::new(&config).unwrap();
        assert_eq!(admission.check(0, &vertex(400.0, -150.0, -856.0)), Ok(()));
        let refusal = admission.check(1, &vertex(400.0, 150.0, -856.0)).unwrap_err();
        assert!(
            matches!(refusal, Refusal { index: 1, reason: RefusalReason::Leg { at, .. } } if at.y_mm.abs() < 149.0),
            "{refusal:?}"
        );
        admission.restart();
        assert_eq!(
            admission.check(1, &vertex(400.0, 150.0, -856.0)),
            Ok(()),
            "the end alone is inside"
        );
    }
}
