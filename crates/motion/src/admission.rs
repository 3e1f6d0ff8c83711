//! Admission: checks every vertex before any motion begins.
//!
//! A vertex is admitted when both the vertex and its leg, checked every 5 mm, lie in the work area. The host runs this
//! check before it sends a path, and the firmware runs it when the path arrives.
//!
//! Where the fourth axis follows the path, its turns add up over a drawing. Admission keeps the accumulated angle and
//! refuses a vertex whose leg would turn the axis out of its range.
//!
//! The shaped path is inside too. It stays in the hull of its vertices, which is enough for cylinder and planes; the setpoints of
//! a `zvd` input shaper may pass them by a part of its deviation. It stays within the tolerance of its legs and the deviation
//! of the input shaper, and the checked points keep that margin from the limits of the joints.

use super::heading::Winding;
use super::pen_lift::PenLift;
use super::work_area::{Outside, WorkArea};
use super::{Pen, Refusal, RefusalReason, Vertex, jog};
use crate::robots::vector::{Vector, add_scaled, length, subtract};
use crate::robots::{GeometryError, JointAngles, OtherSide, Position};
use crate::settings::averaging::shaper_deviation_mm;
use crate::settings::{MotionLimits, Orientation, Plane, Settings};

/// Distance between checked points on a leg, mm.
pub const LEG_CHECK_MM: f64 = 5.0;
/// Shortest leg, mm: half of the wire's resolution.
pub const LEG_MIN_MM: f64 = 0.0005;
/// Margin kept from the joints' limits in addition to the tolerance, mm: between two checked points of a leg the limits
/// can be nearer than at either point.
const LEG_ROOM_MM: f64 = 0.05;
/// Most points checked on one leg; more than any leg inside a work area needs.
const LEG_CHECKS_MAX: u32 = 4_000;

/// Margin kept from the joints' limits, mm.
fn room_mm(motion: &MotionLimits) -> f64 {
    motion.travel_tolerance_mm.max(motion.tolerance_mm) + shaper_deviation_mm(motion) + LEG_ROOM_MM
}

/// Checks the vertices of a path in order.
#[derive(Clone, Debug)]
pub struct Admission {
    area: WorkArea,
    room_mm: f64,
    previous: Option<Position>,
    /// Position of the robot when the path begins.
    start: Option<Position>,
    /// State of a fourth axis that follows the path: its angle, the position that belongs to it, and its range.
    winding: Option<Winding>,
    wound_at: Option<Position>,
    turn_range_rad: [f64; 2],
    /// Where the platform is with the pen down and up.
    pen: [Plane; 2],
    lift: PenLift,
}

impl Admission {
    /// Makes the admission for the limits of a configuration, before the first vertex of a path.
    ///
    /// # Errors
    /// The dimensions do not form a valid robot.
    pub fn new(settings: &Settings) -> Result<Self, GeometryError> {
        let down = settings.paper.plane();
        Ok(Self {
            area: WorkArea::new(settings)?,
            room_mm: room_mm(&settings.motion),
            previous: None,
            start: None,
            winding: (settings.motion.orientation == Orientation::Path).then(Winding::default),
            wound_at: None,
            turn_range_rad: settings.geometry.turn_range_rad(),
            pen: [down, down.raised(settings.paper.pen_lift_mm)],
            lift: PenLift::new(settings),
        })
    }

    /// Starts a new path from an unknown position, with the fourth axis at 0.
    pub fn restart(&mut self) {
        self.previous = None;
        self.start = None;
        self.wind_from(None, 0.0);
    }

    fn wind_from(&mut self, place: Option<Position>, angle_rad: f64) {
        self.wound_at = place;
        if let Some(winding) = &mut self.winding {
            *winding = Winding::new(angle_rad);
        }
    }

    /// Starts a new path from a pose; the leg to its first vertex is checked too. From outside the work area that leg
    /// may only lead inwards.
    pub fn restart_at(&mut self, pose: &JointAngles) {
        self.previous = None;
        let position = self.area.kinematics().forward(pose).ok();
        let [_, _, _, fourth_rad] = pose.0;
        self.wind_from(position, fourth_rad);
        self.start = position;
    }

    /// Checks vertex `index` of the path; a refused vertex leaves the state unchanged.
    ///
    /// # Errors
    /// The index with the first reason found.
    pub fn check(&mut self, index: u32, vertex: &Vertex) -> Result<(), Refusal> {
        let refused = |reason| Refusal { index, reason };
        self.reason(&vertex.position).map_err(refused)?;
        let winding = self.wound(&vertex.position).map_err(refused)?;
        self.winding = winding;
        self.wound_at = Some(vertex.position);
        self.previous = Some(vertex.position);
        Ok(())
    }

    /// Checks that the planner can begin a motion where the robot stands.
    ///
    /// # Errors
    /// The joint that stands on the other side.
    pub fn check_side(&self, pose: &JointAngles) -> Result<(), OtherSide> {
        let kinematics = self.area.kinematics();
        let side = kinematics
            .forward(pose)
            .ok()
            .and_then(|at| kinematics.other_side(pose, &at));
        side.map_or(Ok(()), Err)
    }

    /// Checks a move from a pose, straight or over the sheet; the fourth axis keeps its angle.
    ///
    /// # Errors
    /// Index 0 with the first reason found.
    pub fn check_move(&mut self, pose: &JointAngles, target: &Position) -> Result<(), Refusal> {
        let refused = |reason| Refusal { index: 0, reason };
        self.restart_at(pose);
        if let Some(start) = self.start {
            let [lifted, above] = self.lift.over_in_move(&self.area, &start.into(), &(*target).into());
            self.start = Some(lifted.map_or(start, Position::from));
            if let Some(above) = above.map(Position::from) {
                self.reason(&above).map_err(refused)?;
                self.start = Some(above);
            }
        }
        self.reason(target).map_err(refused)
    }

    /// Checks lifting or lowering the pen at the present position.
    ///
    /// # Errors
    /// Index 0 with the first reason found.
    pub fn check_pen(&self, pose: &JointAngles, pen: Pen) -> Result<(), Refusal> {
        let refused = |outside| Refusal {
            index: 0,
            reason: RefusalReason::Outside(outside),
        };
        let position = self.standing(pose).map_err(refused)?;
        let [down, up] = &self.pen;
        let plane = if pen == Pen::Down { down } else { up };
        let z_mm = plane.z_at_mm(position.x_mm, position.y_mm);
        self.area
            .check(&Position { z_mm, ..position })
            .map(drop)
            .map_err(refused)
    }

    /// Checks that a jog from a pose, mm/s, is possible: at a border it must not lead outwards, outside the work area
    /// it must lead inwards.
    ///
    /// # Errors
    /// Index 0 with the limit that blocks the jog.
    pub fn check_jog(&self, pose: &JointAngles, velocity_mm_s: &Vector) -> Result<(), Refusal> {
        self.standing(pose)
            .and_then(|position| jog::check(&self.area, &position.into(), velocity_mm_s))
            .map_err(|outside| Refusal {
                index: 0,
                reason: RefusalReason::Outside(outside),
            })
    }

    /// Position of the platform for a pose.
    fn standing(&self, pose: &JointAngles) -> Result<Position, Outside> {
        self.area.kinematics().forward(pose).map_err(Outside::Kinematics)
    }

    /// State of the fourth axis after the leg to a position.
    fn wound(&self, position: &Position) -> Result<Option<Winding>, RefusalReason> {
        let (Some(winding), Some(from)) = (self.winding, self.wound_at) else {
            return Ok(self.winding);
        };
        let after = winding.over(&subtract(&(*position).into(), &from.into()));
        let [low_rad, high_rad] = self.turn_range_rad;
        let angle_rad = after.angle_rad();
        // An axis outside its range may move into it.
        let leaves = angle_rad > high_rad.max(winding.angle_rad()) || angle_rad < low_rad.min(winding.angle_rad());
        if leaves || angle_rad.is_nan() {
            return Err(RefusalReason::Wound {
                angle_rad,
                low_rad,
                high_rad,
            });
        }
        Ok(Some(after))
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
            // A robot that begins with less margin may leave that place.
            return if self.area.check_around(&start, self.room_mm).is_ok() {
                check_leg(&self.area, self.room_mm, &start, position)
            } else {
                check_way_in(&self.area, &start, position)
            }
            .map_err(leaves);
        };
        let distance_mm = length(&subtract(&point, &previous.into()));
        if distance_mm < LEG_MIN_MM {
            return Err(RefusalReason::Repeated { distance_mm });
        }
        check_leg(&self.area, self.room_mm, &previous, position).map_err(leaves)
    }
}

/// Checks the points between two positions; returns the first that is outside, with the reason.
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

/// Checks the points between a position, which may be outside, and one inside. Each step has to lead inwards until a
/// point is inside, and from there every point has to be inside. Returns the first point that fails, with the reason.
pub(crate) fn check_way_in(area: &WorkArea, from: &Position, to: &Position) -> Result<(), (Position, Outside)> {
    let start = Vector::from(*from);
    let leg = subtract(&(*to).into(), &start);
    let checks = (libm::ceil(length(&leg) / LEG_CHECK_MM) as u32).clamp(2, LEG_CHECKS_MAX);
    let mut before = *from;
    for check in 1..checks {
        let at = Position::from(add_scaled(&start, &leg, f64::from(check) / f64::from(checks)));
        area.check_step(&before, &at).map_err(|outside| (at, outside))?;
        before = at;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pen;
    use crate::robots::{DeltaGeometry, Geometry, Kinematics};

    fn vertex(x_mm: f64, y_mm: f64, z_mm: f64) -> Vertex {
        Vertex {
            position: Position { x_mm, y_mm, z_mm },
            pen: Pen::Down,
            stroke: 0,
        }
    }

    #[test]
    fn a_refusal_names_the_index_and_the_reason_and_changes_nothing() {
        let mut admission = Admission::new(&Settings::default()).unwrap();
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
    fn a_leg_that_winds_the_fourth_axis_out_of_its_range_is_refused() {
        let mut settings = Settings::default();
        settings.motion.orientation = Orientation::Path;
        settings.geometry = Geometry::Delta(DeltaGeometry {
            turn_range_rad: [-7.0, 10.0],
            ..DeltaGeometry::default()
        });
        let square = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)];
        let corner = |index: u32, left: bool| {
            let (x, y) = square[index as usize % 4];
            vertex(x, if left { y } else { -y }, -850.0)
        };
        let refusal = |admission: &mut Admission, left: bool| {
            (0..20).find_map(|index| admission.check(index, &corner(index, left)).err())
        };
        let mut admission = Admission::new(&settings).unwrap();
        // The first leg has the direction 0; leg k turns to k quarters.
        let quarter = core::f64::consts::FRAC_PI_2;
        let wound = |index: u32, quarters: f64| {
            Some(Refusal {
                index,
                reason: RefusalReason::Wound {
                    angle_rad: quarters * quarter,
                    low_rad: -7.0,
                    high_rad: 10.0,
                },
            })
        };
        assert_eq!(refusal(&mut admission, true), wound(8, 7.0));
        admission.restart();
        assert_eq!(refusal(&mut admission, false), wound(6, -5.0));
        let [a, b, c] = Kinematics::new(&settings.geometry)
            .unwrap()
            .inverse(&Position {
                x_mm: -5.0,
                y_mm: 0.0,
                z_mm: -850.0,
            })
            .unwrap();
        let pose = JointAngles([a, b, c, 4.0 * quarter]);
        admission.restart_at(&pose);
        assert_eq!(
            refusal(&mut admission, true),
            wound(4, 7.0),
            "it goes on from where the axis is"
        );
        let target = corner(2, true).position;
        assert_eq!(admission.check_move(&JointAngles([a, b, c, 9.9]), &target), Ok(()));
        settings.motion.orientation = Orientation::Constant;
        assert_eq!(refusal(&mut Admission::new(&settings).unwrap(), true), None);
    }

    #[test]
    fn a_leg_that_leaves_the_work_area_between_its_ends_is_refused() {
        let mut settings = Settings::default();
        // Below the lowest end of the first links hangs a sphere that the platform cannot enter.
        let defaults = DeltaGeometry::default();
        settings.geometry = Geometry::Delta(DeltaGeometry {
            arm_range_rad: [0.0, defaults.arm_range_rad[1]],
            arm_margin_rad: 0.2,
            ..defaults
        });
        settings.paper.pressing_depth_mm = 10.0;
        let mut admission = Admission::new(&settings).unwrap();
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
