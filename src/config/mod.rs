//! Configuration: every number the controller needs, checked against hard bounds before it is used.
//!
//! The host reads the configuration from `etherpen.toml` and sends it when it connects. The firmware checks every
//! value, answers with a hash, refuses to enable without a configuration, and keeps running on it when the host
//! disconnects.

mod axis;
mod bounds;
mod bus;

pub use axis::{Axis, AxisMode};
pub use bounds::{ConfigError, Field, QUICK_STOP_MAX_MS};
pub use bus::{AddressError, Bus, HostAddress, Transport};

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
pub struct Motion {
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

impl Default for Motion {
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
/// The whole configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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

/// Arm angle at the synchronisation marks of the default configuration, radians: at these angles the platform is in the
/// upper part of the work area. The mark in public descriptions, -0.78191 rad, lies outside the arm range that they
/// give.
const ARM_SYNC_ANGLE_RAD: f64 = 0.3;

impl Default for Config {
    /// The IRB 340 with four AX2006 drives.
    fn default() -> Self {
        let arm = Axis {
            sync_angle_rad: ARM_SYNC_ANGLE_RAD,
            ..Axis::default()
        };
        let fourth = Axis {
            inertia_kg_m2: 0.079,
            velocity_gain_nm_s: 9.5,
            ..Axis::default()
        };
        Self {
            geometry: Geometry::default(),
            work_area: WorkArea::default(),
            paper: Paper::default(),
            motion: Motion::default(),
            axes: [arm, arm, arm, fourth],
            bus: Bus::default(),
        }
    }
}

/// Longest encoded configuration, bytes.
pub const CONFIG_BYTES_MAX: usize = 1280;
impl Config {
    /// Hash of the configuration's postcard encoding: FNV-1a, 64 bits.
    ///
    /// `None` when the encoding is longer than [`CONFIG_BYTES_MAX`].
    pub fn hash(&self) -> Option<u64> {
        let mut buffer = [0u8; CONFIG_BYTES_MAX];
        let bytes = postcard::to_slice(self, &mut buffer).ok()?;
        Some(bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
            (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::net::Ipv4Addr;

    #[test]
    fn the_default_configuration_is_within_its_bounds_and_fits_a_message() {
        let config = Config::default();
        assert_eq!(config.check(), Ok(()));
        assert!(config.hash().is_some());
    }

    #[test]
    fn a_value_out_of_bounds_is_named_with_its_bounds() {
        let mut config = Config::default();
        config.axes[2].feedback_gain_per_s = 501.0;
        let error = config.check().unwrap_err();
        assert_eq!(
            (error.field.name(), error.field.axis),
            ("axes.feedback_gain_per_s", Some(2))
        );
        assert_eq!((error.value, error.high), (501.0, 500.0));
    }

    #[test]
    fn a_quick_stop_that_does_not_end_before_the_brakes_close_is_refused_with_the_value_needed() {
        let mut config = Config::default();
        config.axes[1].quick_stop_rad_s2 = 1.0;
        let error = config.check().unwrap_err();
        assert_eq!(
            (error.field.name(), error.field.axis),
            ("axes.quick_stop_rad_s2", Some(1))
        );
        // The output limit's 27 rad/s in 0.95 s.
        assert!(error.low >= 27.0 / 0.95 && error.low < 29.0, "{error:?}");
        config.axes[1].quick_stop_rad_s2 = error.low;
        assert_eq!(config.check(), Ok(()), "the value that it names is enough");
        // A slow axis needs less: its own speed, and what its controller adds before the following error is a fault.
        config.motion.joint_speed_rad_s[1] = 0.5;
        config.axes[1].quick_stop_rad_s2 = 1.0;
        let error = config.check().unwrap_err();
        assert!((error.low - 4.5 / 0.95).abs() < 0.01, "{error:?}");
        config.axes[1].following_error_max_rad = 0.001;
        config.axes[1].feedback_gain_per_s = 10.0;
        assert_eq!(config.check(), Ok(()));
    }

    #[test]
    fn values_that_are_not_numbers_are_refused_wherever_they_stand() {
        let mut config = Config::default();
        config.motion.joint_speed_rad_s[3] = f64::NAN;
        assert_eq!(config.check().unwrap_err().field.name(), "motion.joint_speed_rad_s");
        let mut config = Config::default();
        config.work_area.z_low_mm = f64::NAN;
        assert!(config.check().is_err());
    }

    #[test]
    fn the_watchdog_is_longer_than_the_blind_limit() {
        let mut config = Config::default();
        config.bus.watchdog_ms = config.bus.blind_max_ms;
        assert_eq!(config.check().unwrap_err().field.name(), "bus.watchdog_ms");
    }

    #[test]
    fn udp_needs_a_segment_to_talk_to() {
        let mut config = Config::default();
        config.bus.transport = Transport::Udp;
        assert_eq!(config.check().unwrap_err().field.name(), "bus.segment");
        config.bus.segment = Ipv4Addr::new(10, 0, 2, 2);
        assert_eq!(config.check(), Ok(()));
        assert!(config.hash().is_some());
    }

    #[test]
    fn any_changed_value_changes_the_hash() {
        let mut config = Config::default();
        let before = config.hash();
        config.axes[3].gear = 12.000001;
        assert_ne!(config.hash(), before);
    }
}
