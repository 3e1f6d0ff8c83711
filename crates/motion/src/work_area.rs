//! The work area: the space that a robot may use, and the reasons why a position is outside it.
//!
//! A position is inside when it lies in the work volume and not too far below the plane of the paper, every main axis
//! keeps its margin from the ends of its range, and the robot is far enough from both kinds of singularity. Each check
//! needs one inverse kinematics. The volume ends at the table, which is a plane too.
//!
//! Outer cylinder, box and planes are convex; the inner cylinder and the limits of the joints are not. Checked points
//! therefore keep a margin to these: the largest change that a displacement of that length can cause. This keeps a curve
//! near checked points inside too.

use crate::robots::joint_ranges::JointRanges;
use crate::robots::vector::{Vector, root};
use crate::robots::{Conditioning, GeometryError, Kinematics, KinematicsError, MAIN_AXES, Position};
use crate::settings::{Plane, Settings, WorkVolume};
use serde::{Deserialize, Serialize};

/// Factor on the bounds of a change, because these bounds grow along the displacement.
const ROOM_FACTOR: f64 = 1.1;

/// Borders of the work area: two radii, four sides of the box, two heights, paper, both ends of each main axis's range,
/// two singularities.
const BORDERS: usize = 9 + 2 * MAIN_AXES + 2;
/// Part of a radius that a position on it may lie beyond it by rounding.
const RADIUS_ROUNDING: f64 = 1.0e-12;
/// Change of a distance to a border that counts as none, mm or rad.
const CHANGE_NONE: f64 = 1.0e-9;

/// Why a position is outside the work area.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Outside {
    /// Too far from the robot's axis.
    Radius {
        /// Distance from the axis, mm.
        radius_mm: f64,
        /// The limit, mm.
        limit_mm: f64,
    },
    /// Too low or too high.
    Height {
        /// The height, mm.
        z_mm: f64,
        /// Lowest, mm.
        low_mm: f64,
        /// Highest, mm.
        high_mm: f64,
    },
    /// The position has no pose, or a pose outside the range of a joint.
    Kinematics(KinematicsError),
    /// A joint is nearer to the end of its range than the margin.
    Margin {
        /// Joint, from 0.
        joint: u8,
        /// Its angle, rad.
        angle_rad: f64,
        /// Lowest angle with margin, rad.
        low_rad: f64,
        /// Highest angle with margin, rad.
        high_rad: f64,
    },
    /// A joint is too close to its singularity.
    Stretched {
        /// Joint, from 0.
        joint: u8,
        /// The joint's [`Conditioning::ratio`].
        ratio: f64,
        /// The limit.
        limit: f64,
    },
    /// The joints are too close to a pose in which they do not hold the tool in one direction.
    Flat {
        /// The [`Conditioning::determinant`].
        determinant: f64,
        /// The limit.
        limit: f64,
    },
    /// Below the plane of the paper by more than the pressing depth.
    Paper {
        /// The height, mm.
        z_mm: f64,
        /// Lowest, mm.
        low_mm: f64,
    },
    /// Too near the robot's axis.
    InnerRadius {
        /// Distance from the axis, mm.
        radius_mm: f64,
        /// The limit, mm.
        limit_mm: f64,
    },
    /// Outside the box in x.
    X {
        /// The position's x, mm.
        x_mm: f64,
        /// Lowest, mm.
        low_mm: f64,
        /// Highest, mm.
        high_mm: f64,
    },
    /// Outside the box in y.
    Y {
        /// The position's y, mm.
        y_mm: f64,
        /// Lowest, mm.
        low_mm: f64,
        /// Highest, mm.
        high_mm: f64,
    },
}

/// The space that the tool may use, with the robot that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkArea {
    kinematics: Kinematics,
    /// The configured volume without what the robot's own box leaves out.
    volume: WorkVolume,
    paper: Plane,
    pressing_depth_mm: f64,
    /// Ranges of the main axes with the margin taken off.
    ranges: JointRanges,
}

impl WorkArea {
    /// Placeholder for a work area that is not configured yet; contains no position.
    pub(crate) const NONE: Self = Self {
        kinematics: Kinematics::NONE,
        volume: WorkVolume {
            radius_mm: 0.0,
            z_low_mm: 0.0,
            z_high_mm: 0.0,
            ..WorkVolume::ENDLESS
        },
        paper: Plane::ZERO,
        pressing_depth_mm: 0.0,
        ranges: JointRanges::NONE,
    };

    /// The work area of a configuration.
    ///
    /// # Errors
    /// The dimensions do not form a valid robot, or the margins leave no range.
    pub fn new(settings: &Settings) -> Result<Self, GeometryError> {
        let geometry = &settings.geometry;
        let kinematics = Kinematics::new(geometry)?;
        let ranges_rad = geometry.ranges_with_margin_rad();
        if let Some([low_rad, high_rad]) = ranges_rad.into_iter().find(|[low, high]| (low..high).is_empty()) {
            return Err(GeometryError::Range { low_rad, high_rad });
        }
        let volume = match geometry.box_mm() {
            Some(of_robot) => settings.work_area.common(&of_robot),
            None => settings.work_area,
        };
        Ok(Self {
            kinematics,
            volume,
            paper: settings.paper.plane(),
            pressing_depth_mm: settings.paper.pressing_depth_mm,
            ranges: JointRanges::new(ranges_rad),
        })
    }

    /// The robot.
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// Where the platform is when the pen draws.
    pub(crate) fn paper(&self) -> &Plane {
        &self.paper
    }

    /// Lowest z of the tool over the sheet, mm.
    fn paper_low_mm(&self, x_mm: f64, y_mm: f64) -> f64 {
        self.paper.z_at_mm(x_mm, y_mm) - self.pressing_depth_mm
    }

    /// Whether a position is inside; [`WorkArea::check`] gives the reason if not.
    pub fn contains(&self, position: &Position) -> bool {
        let Position { x_mm, y_mm, z_mm } = *position;
        let WorkVolume {
            radius_mm,
            inner_radius_mm,
            x_mm: [x_low_mm, x_high_mm],
            y_mm: [y_low_mm, y_high_mm],
            z_low_mm,
            z_high_mm,
        } = self.volume;
        let radius_squared = x_mm * x_mm + y_mm * y_mm;
        radius_squared <= radius_mm * radius_mm
            && radius_squared >= inner_radius_mm * inner_radius_mm
            && x_mm >= x_low_mm
            && x_mm <= x_high_mm
            && y_mm >= y_low_mm
            && y_mm <= y_high_mm
            && z_mm >= z_low_mm.max(self.paper_low_mm(x_mm, y_mm))
            && z_mm <= z_high_mm
            && self.kinematics.clears(&Vector::from(*position), &self.ranges)
    }

    /// A position inside near one that is outside: at the borders of the volume and of the paper, where the joints reach
    /// that place; `None` where they do not.
    pub fn nearest(&self, position: &Position) -> Option<Position> {
        if !Vector::from(*position).iter().all(|value| value.is_finite()) {
            return None;
        }
        let within = |value: f64, [low, high]: [f64; 2]| value.max(low).min(high);
        let volume = &self.volume;
        let at_box = [within(position.x_mm, volume.x_mm), within(position.y_mm, volume.y_mm)];
        let [x, y] = at_box;
        let radius_mm = root(x * x + y * y);
        // Inwards by what rounding may add.
        let allowed = [
            volume.inner_radius_mm * (1.0 + RADIUS_ROUNDING),
            volume.radius_mm * (1.0 - RADIUS_ROUNDING),
        ];
        let scale = if radius_mm > 0.0 {
            within(radius_mm, allowed) / radius_mm
        } else {
            1.0
        };
        let [x_mm, y_mm] = at_box.map(|value| value * scale);
        let z_mm = within(
            position.z_mm,
            [volume.z_low_mm.max(self.paper_low_mm(x_mm, y_mm)), volume.z_high_mm],
        );
        let near = Position { x_mm, y_mm, z_mm };
        self.contains(&near).then_some(near)
    }

    /// Checks a position and returns the angles of its main axes, rad.
    ///
    /// # Errors
    /// The first reason why the position is outside.
    pub fn check(&self, position: &Position) -> Result<[f64; MAIN_AXES], Outside> {
        self.check_around(position, 0.0)
    }

    /// Distance of a position beyond each border, mm, rad, or a ratio's own unit; zero or negative inside.
    fn beyond(&self, position: &Position) -> [f64; BORDERS] {
        let Position { x_mm, y_mm, z_mm } = *position;
        let Conditioning {
            ratio: (_, ratio),
            determinant,
            ..
        } = self.kinematics.conditioning(position);
        let min = self.kinematics.conditioning_min();
        let [a, b, c] = self.kinematics.angles(&Vector::from(*position));
        let [[low_a, high_a], [low_b, high_b], [low_c, high_c]] = self.ranges.rad;
        let ([x_low_mm, x_high_mm], [y_low_mm, y_high_mm]) = (self.volume.x_mm, self.volume.y_mm);
        let radius_mm = root(x_mm * x_mm + y_mm * y_mm);
        [
            radius_mm - self.volume.radius_mm,
            self.volume.inner_radius_mm - radius_mm,
            x_mm - x_high_mm,
            x_low_mm - x_mm,
            y_mm - y_high_mm,
            y_low_mm - y_mm,
            z_mm - self.volume.z_high_mm,
            self.volume.z_low_mm - z_mm,
            self.paper_low_mm(x_mm, y_mm) - z_mm,
            a - high_a,
            b - high_b,
            c - high_c,
            low_a - a,
            low_b - b,
            low_c - c,
            min.ratio - ratio,
            min.determinant - determinant,
        ]
    }

    /// Checks a step from a position that may be outside; from outside a step may only lead inwards. A step leads
    /// inwards when it gets nearer to a border that the position is beyond, and no farther beyond any border.
    ///
    /// # Errors
    /// The first reason why the end of the step is outside.
    pub(crate) fn check_step(&self, from: &Position, to: &Position) -> Result<(), Outside> {
        let Err(outside) = self.check(to) else { return Ok(()) };
        if matches!(outside, Outside::Kinematics(KinematicsError::NotFinite)) {
            return Err(outside);
        }
        let (before, after) = (self.beyond(from), self.beyond(to));
        let nearer = |(before, after): (&f64, &f64)| *before > 0.0 && *after < *before - CHANGE_NONE;
        let enters = before.iter().zip(&after).any(nearer);
        if enters && no_farther(&before, &after) {
            Ok(())
        } else {
            Err(outside)
        }
    }

    /// Whether a step ends inside, or no farther beyond any border than it begins.
    pub(crate) fn keeps_within(&self, from: &Position, to: &Position) -> bool {
        self.check(to).is_ok() || no_farther(&self.beyond(from), &self.beyond(to))
    }

    /// Checks a position like [`Self::check`], with a margin of `room_mm` to the inner radius and to the limits of the
    /// joints; meant for a few millimetres at most.
    ///
    /// # Errors
    /// The first reason why the position is outside; the reported limits have the margin taken off.
    pub fn check_around(&self, position: &Position, room_mm: f64) -> Result<[f64; MAIN_AXES], Outside> {
        let WorkVolume {
            radius_mm: limit_mm,
            z_low_mm: low_mm,
            z_high_mm: high_mm,
            ..
        } = self.volume;
        let Position { x_mm, y_mm, z_mm } = *position;
        if !(x_mm.is_finite() && y_mm.is_finite() && z_mm.is_finite()) {
            return Err(Outside::Kinematics(KinematicsError::NotFinite));
        }
        let radius_mm = root(x_mm * x_mm + y_mm * y_mm);
        if radius_mm > limit_mm {
            return Err(Outside::Radius { radius_mm, limit_mm });
        }
        self.check_sides(x_mm, y_mm, radius_mm, room_mm)?;
        if !(z_mm >= low_mm && z_mm <= high_mm) {
            return Err(Outside::Height { z_mm, low_mm, high_mm });
        }
        let paper_low_mm = self.paper_low_mm(x_mm, y_mm);
        if z_mm < paper_low_mm {
            return Err(Outside::Paper {
                z_mm,
                low_mm: paper_low_mm,
            });
        }
        let angles = self.kinematics.inverse(position).map_err(Outside::Kinematics)?;
        let Conditioning {
            ratio: (joint, ratio),
            determinant,
            change,
        } = self.kinematics.conditioning(position);
        let min = self.kinematics.conditioning_min();
        let room = room_mm * ROOM_FACTOR;
        let limit = min.ratio + room * change.ratio;
        if ratio < limit {
            return Err(Outside::Stretched { joint, ratio, limit });
        }
        let ranges_rad = angles.into_iter().zip(self.ranges.rad).zip(change.angles);
        for (joint, ((angle_rad, [low_rad, high_rad]), change)) in (0u8..).zip(ranges_rad) {
            let (low_rad, high_rad) = (low_rad + room * change, high_rad - room * change);
            if !(angle_rad >= low_rad && angle_rad <= high_rad) {
                return Err(Outside::Margin {
                    joint,
                    angle_rad,
                    low_rad,
                    high_rad,
                });
            }
        }
        let limit = min.determinant + room * change.determinant;
        if determinant < limit {
            return Err(Outside::Flat { determinant, limit });
        }
        Ok(angles)
    }

    /// Checks inner radius and box.
    fn check_sides(&self, x_mm: f64, y_mm: f64, radius_mm: f64, room_mm: f64) -> Result<(), Outside> {
        let WorkVolume {
            inner_radius_mm,
            x_mm: [x_low_mm, x_high_mm],
            y_mm: [y_low_mm, y_high_mm],
            ..
        } = self.volume;
        if inner_radius_mm > 0.0 && radius_mm < inner_radius_mm + room_mm {
            let limit_mm = inner_radius_mm + room_mm;
            return Err(Outside::InnerRadius { radius_mm, limit_mm });
        }
        if !(x_mm >= x_low_mm && x_mm <= x_high_mm) {
            let (low_mm, high_mm) = (x_low_mm, x_high_mm);
            return Err(Outside::X { x_mm, low_mm, high_mm });
        }
        if !(y_mm >= y_low_mm && y_mm <= y_high_mm) {
            let (low_mm, high_mm) = (y_low_mm, y_high_mm);
            return Err(Outside::Y { y_mm, low_mm, high_mm });
        }
        Ok(())
    }
}

/// Whether no border is farther exceeded after a step than before it. A NaN is never inside.
fn no_farther(before: &[f64; BORDERS], after: &[f64; BORDERS]) -> bool {
    let stays = |(before, after): (&f64, &f64)| *after <= before.max(0.0) + CHANGE_NONE;
    before.iter().zip(after).all(stays)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::robots::{DeltaGeometry, Geometry, Kind};

    fn check(x_mm: f64, y_mm: f64, z_mm: f64) -> Result<[f64; MAIN_AXES], Outside> {
        WorkArea::new(&Settings::default())
            .unwrap()
            .check(&Position { x_mm, y_mm, z_mm })
    }

    #[test]
    fn the_sheet_is_inside_and_the_borders_are_named() {
        for x in [-100.0, 100.0] {
            for y in [-100.0, 100.0] {
                assert!(check(x, y, -850.0).is_ok());
                assert!(check(x, y, -750.0).is_ok());
            }
        }
        assert!(matches!(check(566.0, 0.0, -850.0), Err(Outside::Radius { .. })));
        assert!(matches!(check(0.0, 0.0, -699.0), Err(Outside::Height { .. })));
        assert!(matches!(check(0.0, 0.0, -961.0), Err(Outside::Height { .. })));
        assert!(check(0.0, 0.0, -851.0).is_ok());
        assert!(matches!(check(0.0, 0.0, -851.001), Err(Outside::Paper { .. })));
        assert!(matches!(
            check(f64::NAN, 0.0, -850.0),
            Err(Outside::Kinematics(KinematicsError::NotFinite))
        ));
    }

    #[test]
    fn a_position_with_room_is_inside_all_around() {
        let mut settings = Settings::default();
        settings.paper.pressing_depth_mm = 110.0;
        let area = WorkArea::new(&settings).unwrap();
        let (room_mm, mut random, mut borders) = (3.0, Random::new(7), 0);
        let mut number = || random.between(-1.0, 1.0);
        for _ in 0..20_000 {
            let at = [565.0 * number(), 565.0 * number(), -830.0 + 130.0 * number()];
            if area.check_around(&at.into(), room_mm).is_err() {
                borders += u32::from(area.check(&at.into()).is_ok());
                continue;
            }
            let step = [number(), number(), number()];
            let length = crate::robots::vector::length(&step);
            let near = crate::robots::vector::add_scaled(&at, &step, room_mm / length);
            let joints_allow = !matches!(
                area.check(&near.into()),
                Err(Outside::Kinematics(_) | Outside::Margin { .. } | Outside::Stretched { .. } | Outside::Flat { .. })
            );
            assert!(joints_allow, "{at:?} has no room towards {near:?}");
        }
        assert!(borders > 100, "only {borders} positions were near a border");
    }

    #[test]
    fn what_contains_says_is_what_check_says() {
        let mut settings = Settings::default();
        settings.paper.pressing_depth_mm = 110.0;
        let narrow = DeltaGeometry {
            arm_range_rad: [-0.2, 0.6],
            ..DeltaGeometry::default()
        };
        let geometries = [settings.geometry, Geometry::Delta(narrow)];
        let (mut inside, mut outside) = (0, 0);
        for geometry in geometries {
            settings.geometry = geometry;
            let area = WorkArea::new(&settings).unwrap();
            for index in 0..40_000u32 {
                let turn = f64::from(index % 60) * 0.1047;
                let radius = f64::from(index / 60 % 25) * 24.0;
                let position = Position {
                    x_mm: radius * libm::cos(turn),
                    y_mm: radius * libm::sin(turn),
                    z_mm: -970.0 + 11.0 * f64::from(index / 1500),
                };
                let contained = area.contains(&position);
                assert_eq!(contained, area.check(&position).is_ok(), "{position:?}");
                *(if contained { &mut inside } else { &mut outside }) += 1;
            }
            let nowhere = |x_mm, y_mm, z_mm| area.contains(&Position { x_mm, y_mm, z_mm });
            assert!(!nowhere(f64::NAN, 0.0, -850.0) && !nowhere(0.0, f64::INFINITY, -850.0));
            assert!(!nowhere(0.0, 0.0, f64::NAN) && !nowhere(0.0, 0.0, f64::NEG_INFINITY));
        }
        assert!(
            inside > 20_000 && outside > 10_000,
            "{inside} inside, {outside} outside"
        );
    }

    /// Positions in and around a usual machine's work volume.
    fn around(settings: &Settings, count: usize) -> impl Iterator<Item = Position> {
        let (volume, mut random) = (settings.work_area, Random::new(3));
        (0..count).map(move |_| {
            let mut within = |[low, high]: [f64; 2]| random.between(low - 10.0, high + 10.0);
            let round = |[low, high]: [f64; 2]| [low.max(-volume.radius_mm), high.min(volume.radius_mm)];
            Position {
                x_mm: within(round(volume.x_mm)),
                y_mm: within(round(volume.y_mm)),
                z_mm: within([volume.z_low_mm, volume.z_high_mm]),
            }
        })
    }

    #[test]
    fn in_every_kinds_work_area_what_has_room_is_inside_all_around() {
        let room_mm = 3.0;
        for kind in Kind::ALL {
            let mut settings = Settings::usual(kind.geometry());
            settings.work_area.inner_radius_mm = settings.work_area.inner_radius_mm.max(20.0);
            settings.paper.pressing_depth_mm = 1000.0;
            let (area, mut random) = (WorkArea::new(&settings).unwrap(), Random::new(4));
            let (mut inside, mut outside) = (0, 0);
            for position in around(&settings, 20_000) {
                let contained = area.contains(&position);
                assert_eq!(contained, area.check(&position).is_ok(), "{kind:?}: {position:?}");
                *(if contained { &mut inside } else { &mut outside }) += 1;
                if area.check_around(&position, room_mm).is_err() {
                    continue;
                }
                let step = [(); 3].map(|()| random.between(-1.0, 1.0));
                let length = crate::robots::vector::length(&step);
                let near = crate::robots::vector::add_scaled(&position.into(), &step, room_mm / length);
                // Convex borders need no room: the ends of a line keep all of it inside.
                let allowed = matches!(
                    area.check(&near.into()),
                    Ok(_)
                        | Err(Outside::Radius { .. } | Outside::Height { .. } | Outside::X { .. } | Outside::Y { .. })
                );
                let proportional = matches!(kind, Kind::Gantry | Kind::CoreXy | Kind::Scara);
                let of_axis = matches!(
                    area.check(&near.into()),
                    Err(Outside::Margin { .. } | Outside::Kinematics(_))
                );
                assert!(
                    allowed || (proportional && of_axis),
                    "{kind:?}: {position:?} has no room towards {near:?}: {:?}",
                    area.check(&near.into())
                );
            }
            assert!(
                inside > 4_000 && outside > 1_000,
                "{kind:?}: {inside} inside, {outside} outside"
            );
        }
    }

    #[test]
    fn every_border_of_the_volume_has_its_reason_and_the_nearest_place() {
        let mut settings = Settings::usual(Kind::Gantry.geometry());
        settings.work_area.radius_mm = 500.0;
        settings.work_area.inner_radius_mm = 100.0;
        settings.work_area.x_mm = [50.0, 450.0];
        let area = WorkArea::new(&settings).unwrap();
        let at = |x_mm, y_mm, z_mm| Position { x_mm, y_mm, z_mm };
        let near = |position: Position, expected: Position| {
            let found = area.nearest(&position).unwrap();
            let apart = crate::robots::vector::subtract(&found.into(), &expected.into());
            assert!(crate::robots::vector::length(&apart) < 1.0e-9, "{found:?}");
        };
        assert!(area.check(&at(200.0, 200.0, -30.0)).is_ok());
        near(at(200.0, 200.0, -30.0), at(200.0, 200.0, -30.0));
        let left = at(40.0, 200.0, -30.0);
        let expected = Outside::X {
            x_mm: 40.0,
            low_mm: 50.0,
            high_mm: 450.0,
        };
        assert_eq!(area.check(&left), Err(expected));
        near(left, at(50.0, 200.0, -30.0));
        let behind = at(200.0, 455.0, -30.0);
        assert!(matches!(area.check(&behind), Err(Outside::Y { .. })));
        near(behind, at(200.0, 449.0, -30.0));
        let high = at(200.0, 200.0, 5.0);
        assert!(matches!(area.check(&high), Err(Outside::Height { .. })));
        near(high, at(200.0, 200.0, -1.0));
        let deep = at(200.0, 200.0, -55.0);
        assert!(matches!(area.check(&deep), Err(Outside::Paper { .. })));
        near(deep, at(200.0, 200.0, settings.paper.pen_down_z_mm - 1.0));
        let far = at(400.0, 400.0, -30.0);
        assert!(matches!(area.check(&far), Err(Outside::Radius { .. })));
        near(far, at(500.0 * 0.5_f64.sqrt(), 500.0 * 0.5_f64.sqrt(), -30.0));
        let inner = at(60.0, 60.0, -30.0);
        assert!(matches!(area.check(&inner), Err(Outside::InnerRadius { .. })));
        near(inner, at(100.0 * 0.5_f64.sqrt(), 100.0 * 0.5_f64.sqrt(), -30.0));
        assert_eq!(area.nearest(&at(f64::NAN, 0.0, 0.0)), None);
    }

    #[test]
    fn the_lowest_place_follows_a_sheet_that_is_not_level() {
        let mut settings = Settings::usual(Kind::Gantry.geometry());
        settings.paper.slope = [0.02, -0.01];
        let area = WorkArea::new(&settings).unwrap();
        let ([x, y], depth_mm) = (settings.paper.centre_mm, settings.paper.pressing_depth_mm);
        let at = |along: f64, across: f64, above_mm: f64| {
            let surface_mm = settings.paper.pen_down_z_mm + 0.02 * along - 0.01 * across;
            Position {
                x_mm: x + along,
                y_mm: y + across,
                z_mm: surface_mm + above_mm,
            }
        };
        for (along, across) in [(0.0, 0.0), (90.0, 0.0), (-90.0, 40.0), (60.0, -90.0)] {
            let (above, below) = (
                at(along, across, 0.001 - depth_mm),
                at(along, across, -0.001 - depth_mm),
            );
            assert!(area.check(&above).is_ok() && area.contains(&above), "{above:?}");
            assert!(matches!(area.check(&below), Err(Outside::Paper { .. })) && !area.contains(&below));
            let near = area.nearest(&at(along, across, -2.0 - depth_mm)).unwrap();
            assert!((near.z_mm - at(along, across, -depth_mm).z_mm).abs() < 1.0e-9);
            assert!(area.check_step(&below, &above).is_ok() && area.check_step(&above, &below).is_err());
        }
    }

    #[test]
    fn the_box_of_crossed_belts_holds_where_the_belts_own_ranges_do_not_end() {
        let mut settings = Settings::usual(Kind::CoreXy.geometry());
        settings.work_area.x_mm = WorkVolume::ENDLESS.x_mm;
        settings.work_area.y_mm = WorkVolume::ENDLESS.y_mm;
        let area = WorkArea::new(&settings).unwrap();
        let beside = Position {
            x_mm: 349.5,
            y_mm: 175.0,
            z_mm: -20.0,
        };
        assert!(area.kinematics().inverse(&beside).is_ok());
        assert!(matches!(area.check(&beside), Err(Outside::X { high_mm: 349.0, .. })));
        assert!(!area.contains(&beside));
    }

    #[test]
    fn a_margin_that_uses_up_the_range_is_refused() {
        let settings = Settings {
            geometry: Geometry::Delta(DeltaGeometry {
                arm_range_rad: [0.0, 0.1],
                arm_margin_rad: 0.1,
                ..DeltaGeometry::default()
            }),
            ..Settings::default()
        };
        assert!(matches!(WorkArea::new(&settings), Err(GeometryError::Range { .. })));
    }
}
