//! Configuration: every number the controller needs, checked against hard bounds before it is used.
//!
//! The host reads it from `etherpen.toml` and sends it at connect; the firmware checks every value, answers with a
//! hash, refuses to enable without one, and keeps running on it when the host goes.

use crate::robot::AXES;
use heapless::String;
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
}

impl Default for Geometry {
    /// The IRB 340 (design notes, motion, section 3).
    fn default() -> Self {
        Self {
            base_radius_mm: 200.0,
            upper_arm_mm: 350.0,
            forearm_mm: 800.0,
            platform_radius_mm: 45.0,
            arm_azimuths_deg: [0.0, 120.0, 240.0],
            arm_range_rad: [-0.7034, 1.7453],
            arm_margin_rad: 0.01745,
        }
    }
}

/// The space the platform may use: an upright cylinder around the robot's axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorkArea {
    /// Radius of the cylinder, mm.
    pub radius_mm: f64,
    /// Lowest z, mm.
    pub z_low_mm: f64,
    /// Highest z, mm.
    pub z_high_mm: f64,
}

impl Default for WorkArea {
    fn default() -> Self {
        Self { radius_mm: 565.0, z_low_mm: -960.0, z_high_mm: -700.0 }
    }
}

/// Where the paper lies and how the pen meets it.
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
}

impl Default for Paper {
    fn default() -> Self {
        Self { centre_mm: [0.0, 0.0], size_mm: [200.0, 200.0], pen_down_z_mm: -850.0, pen_lift_mm: 3.0 }
    }
}

/// Limits and tolerances of motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Motion {
    /// Path speed with the pen down, mm/s.
    pub speed_mm_s: f64,
    /// Path speed with the pen up, mm/s.
    pub travel_speed_mm_s: f64,
    /// Cartesian acceleration, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Joint speed, rad/s, per axis.
    pub joint_speed_rad_s: [f64; AXES],
    /// Joint acceleration, rad/s2, per axis.
    pub joint_acceleration_rad_s2: [f64; AXES],
    /// Deviation of the reference from the polyline with the pen down, mm.
    pub tolerance_mm: f64,
    /// The same with the pen up, mm.
    pub travel_tolerance_mm: f64,
    /// Length of the moving average that bounds jerk, ms; 0 switches it off.
    pub jerk_window_ms: u16,
    /// Time at rest on the path before the pen is lifted when path data stop coming, ms.
    pub starve_dwell_ms: u16,
}

impl Default for Motion {
    fn default() -> Self {
        Self {
            speed_mm_s: 400.0,
            travel_speed_mm_s: 1000.0,
            acceleration_mm_s2: 10_000.0,
            joint_speed_rad_s: [25.0; AXES],
            joint_acceleration_rad_s2: [250.0; AXES],
            tolerance_mm: 0.05,
            travel_tolerance_mm: 0.5,
            jerk_window_ms: 4,
            starve_dwell_ms: 500,
        }
    }
}

/// One axis: its drive's scaling, its reference, its controller and its supervision.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Axis {
    /// Motor revolutions for one revolution of the joint; negative where the motor turns the other way.
    pub gear: f64,
    /// Encoder increments for one motor revolution.
    pub increments_per_revolution: u32,
    /// Velocity command digits for one motor revolution per minute.
    pub digits_per_rpm: f64,
    /// Joint angle at the synchronisation mark, radians.
    pub sync_angle_rad: f64,
    /// What the single-turn resolver shows at the synchronisation mark, increments.
    pub sync_increments: u32,
    /// Feedback gain Kfb, 1/s.
    pub feedback_gain_per_s: f64,
    /// Feed-forward gain Kff.
    pub feed_forward_gain: f64,
    /// How far the velocity feed-forward is read ahead, ms.
    pub feed_forward_lead_ms: f64,
    /// Age of the measured position when the controller sees it, ms.
    pub measurement_age_ms: f64,
    /// Following error that ends in a fault, radians.
    pub following_error_max_rad: f64,
    /// Largest velocity command, rad/s at the joint.
    pub output_max_rad_s: f64,
    /// Quick-stop deceleration at the joint, rad/s2.
    pub quick_stop_rad_s2: f64,
}

impl Default for Axis {
    fn default() -> Self {
        Self {
            gear: 12.0,
            increments_per_revolution: 1 << 20,
            digits_per_rpm: 262_144.0 / 1_875.0,
            sync_angle_rad: -0.5,
            sync_increments: 0,
            feedback_gain_per_s: 80.0,
            feed_forward_gain: 1.0,
            feed_forward_lead_ms: 3.1,
            measurement_age_ms: 1.0,
            following_error_max_rad: 0.05,
            output_max_rad_s: 27.0,
            quick_stop_rad_s2: 100.0,
        }
    }
}

/// The bus: what is expected on it and how patient the master is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bus {
    /// Number of drives expected, in chain order, one for each axis.
    pub drives: u8,
    /// Sync manager watchdog of the drives, ms; longer than `blind_max_ms`.
    pub watchdog_ms: u16,
    /// Longest motion without a valid measurement, ms.
    pub blind_max_ms: u16,
    /// Late cycles within a second that make a fault.
    pub late_max_per_s: u16,
    /// Silence of the host while drawing that leads to Holding, ms.
    pub host_silence_ms: u16,
    /// Longest pause between dead-man messages of a jog, ms.
    pub dead_man_ms: u16,
    /// Name of the robot, for messages.
    pub name: String<24>,
}

impl Default for Bus {
    fn default() -> Self {
        let mut name = String::new();
        // The literal is shorter than the capacity.
        let _ = name.push_str("IRB 340");
        Self {
            drives: AXES as u8,
            watchdog_ms: 10,
            blind_max_ms: 5,
            late_max_per_s: 10,
            host_silence_ms: 500,
            dead_man_ms: 100,
            name,
        }
    }
}

/// The whole configuration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Shape of the robot.
    pub geometry: Geometry,
    /// Space the robot may use.
    pub work_area: WorkArea,
    /// Paper and pen.
    pub paper: Paper,
    /// Limits of motion.
    pub motion: Motion,
    /// The axes: three arms, then the fourth axis.
    pub axes: [Axis; AXES],
    /// The bus.
    pub bus: Bus,
}
