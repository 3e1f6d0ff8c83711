//! The work area: the space that a robot may use, and the reasons why a position is outside it.
//!
//! A position is inside when it lies in the cylinder and not too far below the plane of the paper, every arm keeps its
//! margin from the ends of its range, and the robot is far enough from both kinds of singularity. Each check needs one
//! inverse kinematics. The cylinder ends at the table, which is a plane too.
//!
//! Cylinder and planes are convex; the limits of the arms are not. Checked points therefore keep a margin to the arms'
//! limits: the largest change that a displacement of that length can cause. This keeps a curve near checked points
//! inside too.

use super::kinematics::{AngleRange, Conditioning, Delta, GeometryError, KinematicsError};
use super::vector::Vector;
use super::{ARMS, Position};
use crate::settings::{Settings, WorkCylinder as Cylinder};
use serde::{Deserialize, Serialize};

/// Smallest D/A: sine of the angle between an arm's plane projection of the forearm and the upper arm, in effect.
pub const RATIO_MIN: f64 = 0.35;
/// Smallest absolute determinant of the forearms' unit vectors.
pub const DETERMINANT_MIN: f64 = 0.2;

/// Factor on the bounds of a change, because these bounds grow along the displacement.
const ROOM_FACTOR: f64 = 1.1;

/// Borders of the work area: radius, two heights, paper, both ends of each arm's range, two singularities.
const BORDERS: usize = 4 + 2 * ARMS + 2;
/// Change of a distance to a border that counts as none, mm or rad.
const CHANGE_NONE: f64 = 1.0e-9;

const _: () = assert!(RATIO_MIN > super::kinematics::RATIO_SINGULAR);

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
    /// The position has no pose, or a pose outside the arm range.
    Kinematics(KinematicsError),
    /// An arm is nearer to the end of its range than the margin.
    Margin {
        /// Arm, from 0.
        arm: u8,
        /// Its angle, rad.
        angle_rad: f64,
        /// Lowest angle with margin, rad.
        low_rad: f64,
        /// Highest angle with margin, rad.
        high_rad: f64,
    },
    /// An arm is too close to being in line with its forearm.
    Stretched {
        /// Arm, from 0.
        arm: u8,
        /// D/A.
        ratio: f64,
        /// The limit.
        limit: f64,
    },
    /// The forearms are too close to lying in one plane.
    Flat {
        /// Absolute determinant of their unit vectors.
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
}

/// The space that the platform may use, with the robot that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkArea {
    delta: Delta,
    cylinder: Cylinder,
    paper_low_mm: f64,
    range_rad: [f64; 2],
    range: AngleRange,
}

impl WorkArea {
    /// Placeholder for a work area that is not configured yet; contains no position.
    pub(crate) const NONE: Self = Self {
        delta: Delta::NONE,
        cylinder: Cylinder {
            radius_mm: 0.0,
            z_low_mm: 0.0,
            z_high_mm: 0.0,
        },
        paper_low_mm: 0.0,
        range_rad: [0.0; 2],
        range: AngleRange::NONE,
    };

    /// The work area of a configuration.
    ///
    /// # Errors
    /// The dimensions do not form a valid delta robot, or the margins leave no range.
    pub fn new(settings: &Settings) -> Result<Self, GeometryError> {
        let [low, high] = settings.geometry.arm_range_rad;
        let margin = settings.geometry.arm_margin_rad;
        let (low_rad, high_rad) = (low + margin, high - margin);
        let delta = Delta::new(&settings.geometry)?;
        if (low_rad..high_rad).is_empty() {
            return Err(GeometryError::Range { low_rad, high_rad });
        }
        Ok(Self {
            delta,
            cylinder: settings.work_area,
            paper_low_mm: settings.paper.pen_down_z_mm - settings.paper.pressing_depth_mm,
            range_rad: [low_rad, high_rad],
            range: AngleRange::new([low_rad, high_rad]),
        })
    }

    /// The robot.
    pub fn delta(&self) -> &Delta {
        &self.delta
    }

    /// Whether a position is inside; [`WorkArea::check`] gives the reason if not.
    pub fn contains(&self, position: &Position) -> bool {
        let Position { x_mm, y_mm, z_mm } = *position;
        let Cylinder {
            radius_mm,
            z_low_mm,
            z_high_mm,
        } = self.cylinder;
        x_mm * x_mm + y_mm * y_mm <= radius_mm * radius_mm
            && z_mm >= z_low_mm.max(self.paper_low_mm)
            && z_mm <= z_high_mm
            && self
                .delta
                .clears(&Vector::from(*position), &self.range, RATIO_MIN, DETERMINANT_MIN)
    }

    /// Checks a position and returns its arm angles, rad.
    ///
    /// # Errors
    /// The first reason why the position is outside.
    pub fn check(&self, position: &Position) -> Result<[f64; ARMS], Outside> {
        self.check_around(position, 0.0)
    }

    /// Distance of a position beyond each border, mm, rad, or a ratio's own unit; zero or negative inside.
    fn beyond(&self, position: &Position) -> [f64; BORDERS] {
        let Position { x_mm, y_mm, z_mm } = *position;
        let Conditioning {
            ratio: (_, ratio),
            determinant,
            ..
        } = self.delta.conditioning(position);
        let [a, b, c] = self.delta.angles(&Vector::from(*position));
        let [low, high] = self.range_rad;
        [
            super::vector::root(x_mm * x_mm + y_mm * y_mm) - self.cylinder.radius_mm,
            z_mm - self.cylinder.z_high_mm,
            self.cylinder.z_low_mm - z_mm,
            self.paper_low_mm - z_mm,
            a - high,
            b - high,
            c - high,
            low - a,
            low - b,
            low - c,
            RATIO_MIN - ratio,
            DETERMINANT_MIN - determinant,
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
        // A NaN is never inside.
        let stays = |(before, after): (&f64, &f64)| *after <= before.max(0.0) + CHANGE_NONE;
        let nearer = |(before, after): (&f64, &f64)| *before > 0.0 && *after < *before - CHANGE_NONE;
        let stays_within = before.iter().zip(&after).all(stays);
        let enters = before.iter().zip(&after).any(nearer);
        if enters && stays_within { Ok(()) } else { Err(outside) }
    }

    /// Checks a position like [`Self::check`], with a margin of `room_mm` to the limits of the arms; meant for a few
    /// millimetres at most.
    ///
    /// # Errors
    /// The first reason why the position is outside; the reported limits have the margin taken off.
    pub fn check_around(&self, position: &Position, room_mm: f64) -> Result<[f64; ARMS], Outside> {
        let Cylinder {
            radius_mm: limit_mm,
            z_low_mm: low_mm,
            z_high_mm: high_mm,
        } = self.cylinder;
        let Position { x_mm, y_mm, z_mm } = *position;
        if !(x_mm.is_finite() && y_mm.is_finite() && z_mm.is_finite()) {
            return Err(Outside::Kinematics(KinematicsError::NotFinite));
        }
        let radius_mm = super::vector::root(x_mm * x_mm + y_mm * y_mm);
        if radius_mm > limit_mm {
            return Err(Outside::Radius { radius_mm, limit_mm });
        }
        if !(z_mm >= low_mm && z_mm <= high_mm) {
            return Err(Outside::Height { z_mm, low_mm, high_mm });
        }
        if z_mm < self.paper_low_mm {
            return Err(Outside::Paper {
                z_mm,
                low_mm: self.paper_low_mm,
            });
        }
        let angles = self.delta.inverse(position).map_err(Outside::Kinematics)?;
        let Conditioning {
            ratio: (arm, ratio),
            determinant,
            change,
        } = self.delta.conditioning(position);
        let room = room_mm * ROOM_FACTOR;
        let (low_rad, high_rad) = (
            self.range_rad[0] + room * change.angle,
            self.range_rad[1] - room * change.angle,
        );
        let limit = RATIO_MIN + room * change.ratio;
        if ratio < limit {
            return Err(Outside::Stretched { arm, ratio, limit });
        }
        for (arm, angle_rad) in (0u8..).zip(angles) {
            if !(angle_rad >= low_rad && angle_rad <= high_rad) {
                return Err(Outside::Margin {
                    arm,
                    angle_rad,
                    low_rad,
                    high_rad,
                });
            }
        }
        let limit = DETERMINANT_MIN + room * change.determinant;
        if determinant < limit {
            return Err(Outside::Flat { determinant, limit });
        }
        Ok(angles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(x_mm: f64, y_mm: f64, z_mm: f64) -> Result<[f64; ARMS], Outside> {
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
        let (room_mm, mut state, mut borders) = (3.0, 7u64, 0);
        let mut number = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        for _ in 0..20_000 {
            let at = [565.0 * number(), 565.0 * number(), -830.0 + 130.0 * number()];
            if area.check_around(&at.into(), room_mm).is_err() {
                borders += u32::from(area.check(&at.into()).is_ok());
                continue;
            }
            let step = [number(), number(), number()];
            let length = crate::robot::vector::length(&step);
            let near = crate::robot::vector::add_scaled(&at, &step, room_mm / length);
            let arms_allow = !matches!(
                area.check(&near.into()),
                Err(Outside::Kinematics(_) | Outside::Margin { .. } | Outside::Stretched { .. } | Outside::Flat { .. })
            );
            assert!(arms_allow, "{at:?} has no room towards {near:?}");
        }
        assert!(borders > 100, "only {borders} positions were near a border");
    }

    #[test]
    fn what_contains_says_is_what_check_says() {
        let mut settings = Settings::default();
        settings.paper.pressing_depth_mm = 110.0;
        let geometries = [
            settings.geometry,
            crate::settings::Geometry {
                arm_range_rad: [-0.2, 0.6],
                ..settings.geometry
            },
        ];
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

    #[test]
    fn a_margin_that_uses_up_the_range_is_refused() {
        let mut settings = Settings::default();
        settings.geometry.arm_range_rad = [0.0, 0.1];
        settings.geometry.arm_margin_rad = 0.1;
        assert!(matches!(WorkArea::new(&settings), Err(GeometryError::Range { .. })));
    }
}
