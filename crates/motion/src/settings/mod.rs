//! What motion depends on: the robot's shape, its work area, the paper, and the limits of motion.

mod bounds;

pub use bounds::{Bound, Violation, bound, first_violation};

use crate::robot::AXES;
use serde::{Deserialize, Serialize};

/// Geometry of a delta robot with three equal arms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Geometry {
    /// Centre of the base to the shoulder axes, mm.
    pub base_radius_mm: f64,
    /// Length of an upper arm, mm.
    pub upper_arm_mm: f64,
    /// Length of a forearm, mm.
    pub forearm_mm: f64,
    /// Centre of the platform to the forearms' joints, mm.
    pub platform_radius_mm: f64,
    /// Azimuths of the arms, degrees.
    pub arm_azimuths_deg: [f64; 3],
    /// Lowest and highest angle of an arm, radians.
    pub arm_range_rad: [f64; 2],
    /// Margin kept from both ends of the arm range, radians.
    pub arm_margin_rad: f64,
    /// Lowest and highest angle of the fourth axis, radians. The axis has no end stop; its cables and its turn counter
    /// limit it.
    pub turn_range_rad: [f64; 2],
}

impl Default for Geometry {
    /// The IRB 340, from public descriptions of the robot. They differ from each other by 2 %: measure your own robot.
    fn default() -> Self {
        Self {
            base_radius_mm: 200.0,
            upper_arm_mm: 350.0,
            forearm_mm: 800.0,
            platform_radius_mm: 45.0,
            arm_azimuths_deg: [0.0, 120.0, 240.0],
            arm_range_rad: [-0.7034, 1.7453],
            arm_margin_rad: 0.01745,
            turn_range_rad: [-6_283.0, 6_283.0],
        }
    }
}

/// The space the platform may use: an upright cylinder around the robot's axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorkCylinder {
    /// Radius of the cylinder, mm.
    pub radius_mm: f64,
    /// Lowest z, mm.
    pub z_low_mm: f64,
    /// Highest z, mm.
    pub z_high_mm: f64,
}

impl Default for WorkCylinder {
    fn default() -> Self {
        Self {
            radius_mm: 565.0,
            z_low_mm: -960.0,
            z_high_mm: -700.0,
        }
    }
}

/// Position of the paper, and heights of the pen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Paper {
    /// The sheet's centre in the robot's frame, mm.
    pub centre_mm: [f64; 2],
    /// Width and height of the sheet, mm.
    pub size_mm: [f64; 2],
    /// The platform's z when the pen draws, mm.
    pub pen_down_z_mm: f64,
    /// How far the pen is lifted between strokes, mm.
    pub pen_lift_mm: f64,
    /// How far below its drawing height the platform may go, mm.
    pub pressing_depth_mm: f64,
}

impl Default for Paper {
    fn default() -> Self {
        Self {
            centre_mm: [0.0, 0.0],
            size_mm: [200.0, 200.0],
            pen_down_z_mm: -850.0,
            pen_lift_mm: 3.0,
            pressing_depth_mm: 1.0,
        }
    }
}

/// Mode of the fourth axis on a path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Orientation {
    /// The axis keeps its angle.
    #[default]
    Constant,
    /// The axis follows the direction of the path in plan view.
    Path,
}

/// Limits and tolerances of motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionLimits {
    /// Path speed with the pen down, mm/s.
    pub speed_mm_s: f64,
    /// Path speed with the pen up, mm/s.
    pub travel_speed_mm_s: f64,
    /// Cartesian acceleration, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Vertical speed while the pen is lifted or lowered, mm/s; 0 applies only the limits of all motion.
    pub pen_speed_mm_s: f64,
    /// Vertical acceleration while the pen is lifted or lowered, mm/s2; 0 applies only the limits of all motion.
    pub pen_acceleration_mm_s2: f64,
    /// Time at rest where the pen meets the paper and where it leaves it, ms; 0 means no stop.
    pub pen_dwell_ms: u16,
    /// Mode of the fourth axis on a path.
    pub orientation: Orientation,
    /// Joint speed, rad/s, per axis.
    pub joint_speed_rad_s: [f64; AXES],
    /// Joint acceleration, rad/s2, per axis.
    pub joint_acceleration_rad_s2: [f64; AXES],
    /// Deviation of the reference from the polyline with the pen down, mm.
    pub tolerance_mm: f64,
    /// Deviation of the reference from the polyline on travel moves (pen up), mm.
    pub travel_tolerance_mm: f64,
    /// Length of the moving average that bounds jerk, ms; 0 switches it off.
    pub jerk_window_ms: u16,
    /// Time at rest on the path before the pen is lifted when path data stop coming, ms.
    pub starve_dwell_ms: u16,
}

impl Default for MotionLimits {
    fn default() -> Self {
        Self {
            speed_mm_s: 400.0,
            travel_speed_mm_s: 1000.0,
            acceleration_mm_s2: 10_000.0,
            pen_speed_mm_s: 0.0,
            pen_acceleration_mm_s2: 0.0,
            pen_dwell_ms: 0,
            orientation: Orientation::Constant,
            joint_speed_rad_s: [25.0; AXES],
            joint_acceleration_rad_s2: [250.0; AXES],
            tolerance_mm: 0.05,
            travel_tolerance_mm: 0.5,
            jerk_window_ms: 4,
            starve_dwell_ms: 500,
        }
    }
}

/// All settings of the motion stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Shape of the robot.
    pub geometry: Geometry,
    /// Space the robot may use.
    pub work_area: WorkCylinder,
    /// Paper and pen.
    pub paper: Paper,
    /// Limits of motion.
    pub motion: MotionLimits,
    /// Time after which a jog ends that is not repeated, ms.
    pub dead_man_ms: u16,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            geometry: Geometry::default(),
            work_area: WorkCylinder::default(),
            paper: Paper::default(),
            motion: MotionLimits::default(),
            dead_man_ms: 100,
        }
    }
}
