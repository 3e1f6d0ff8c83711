//! The phenomena of a cell, one structure each, as the sections of its file name them.

use super::Value;
use serde::{Deserialize, Serialize};

/// How a drive follows its velocity demand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LoopKind {
    /// A first-order lag that no load disturbs.
    #[default]
    Lag,
    /// A PI controller whose torque moves rotors, links, platform and payload.
    Pi,
}

/// The drives' velocity loops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VelocityLoop {
    /// The kind of loop.
    pub kind: LoopKind,
    /// Bandwidth, Hz: corner frequency of the lag; crossover of the PI loop at the mean inertia over the work area.
    pub bandwidth_hz: f64,
    /// Integral time of the PI loop, ms.
    pub integral_ms: f64,
    /// Bandwidth of the PI loop's current loop, Hz.
    pub current_hz: f64,
    /// Corner frequency of the second-order filter of the speed that the PI loop measures, Hz.
    pub speed_filter_hz: f64,
}

/// The drives' position loops, in cyclic synchronous position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PositionLoop {
    /// Gain, 1/s.
    pub gain_per_s: f64,
}

/// Delays between bus and drives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DeadTime {
    /// Age of a command when the motor follows it, cycles of 1 ms.
    pub command_cycles: u32,
    /// Age of a position when the bus can read it, cycles of 1 ms.
    pub position_cycles: u32,
    /// Share of the cycles in which a command is one cycle later.
    pub late_share: f64,
}

/// The motors' resolvers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Resolver {
    /// Amplitude of the error that repeats once a turn of the motor, arc minutes at the motor.
    pub once_arcmin: f64,
    /// Amplitude of the error that repeats twice a turn of the motor, arc minutes at the motor.
    pub twice_arcmin: f64,
    /// Resolution, bits in a turn of the motor; never finer than the configured increments.
    pub bits: u32,
    /// Largest noise, increments.
    pub noise_increments: f64,
}

/// The drives' torque measurement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TorqueMeasurement {
    /// Difference of true from demanded and shown torque, as a share of it.
    pub scale_share: f64,
    /// Torque that is shown without any, N m at the motor.
    pub offset_nm: f64,
}

/// Friction of motor, gear and joint, at the joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Friction {
    /// Dry friction in motion, N m.
    pub coulomb_nm: f64,
    /// Friction that grows with the speed, N m s.
    pub viscous_nm_s: f64,
    /// Dry friction at rest as a multiple of that in motion.
    pub stiction_factor: f64,
    /// Speed at which dry friction has fallen from that at rest to that in motion by 1 - 1/e, rad/s.
    pub stribeck_rad_s: f64,
    /// Speed by which dry friction slows a first-order lag until its integral compensates for it, rad/s.
    pub lag_rad_s: f64,
}

/// Load at the platform.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Payload {
    /// Mass, kg.
    pub mass_kg: f64,
}

/// Play between the gears and the main joints.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Backlash {
    /// Whole play, arc minutes at the joint.
    pub gap_arcmin: f64,
}

/// Vibration of platform and pen against the joints, which no encoder sees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StructuralMode {
    /// Frequency in x and y, Hz; 0 is rigid.
    pub xy_hz: f64,
    /// Frequency in z, Hz; 0 is rigid.
    pub z_hz: f64,
    /// Damping ratio.
    pub damping: f64,
}

/// Differences between the robot and its configuration: each of this size, with a random sign.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Calibration {
    /// Error of each synchronisation angle, mrad at the joint.
    pub sync_mrad: f64,
    /// Error of each length of the robot, mm.
    pub length_mm: f64,
    /// Error of each azimuth, mrad.
    pub azimuth_mrad: f64,
}

/// Where the sheet lies in the robot's frame, whatever the configuration says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SheetPlace {
    /// The platform's z when the pen draws at the sheet's centre, mm.
    pub z_mm: f64,
    /// How far the sheet rises over 1 mm of x, mm.
    #[serde(default)]
    pub slope_x: f64,
    /// How far the sheet rises over 1 mm of y, mm.
    #[serde(default)]
    pub slope_y: f64,
}

impl SheetPlace {
    /// Its numbers with their bounds.
    pub(super) fn values(&self) -> [Value; 3] {
        let number = |name, unit, value, most: f64| Value {
            name,
            unit,
            value,
            low: -most,
            high: most,
        };
        [
            number("sheet.z_mm", "mm", self.z_mm, 10_000.0),
            number("sheet.slope_x", "", self.slope_x, 0.5),
            number("sheet.slope_y", "", self.slope_y, 0.5),
        ]
    }
}

impl VelocityLoop {
    pub(super) const NOMINAL: Self = Self {
        kind: LoopKind::Lag,
        bandwidth_hz: 100.0,
        integral_ms: 8.0,
        current_hz: 800.0,
        speed_filter_hz: 600.0,
    };
}

impl DeadTime {
    pub(super) const NOMINAL: Self = Self {
        command_cycles: 1,
        position_cycles: 1,
        late_share: 0.0,
    };
}

impl Resolver {
    pub(super) const NOMINAL: Self = Self {
        once_arcmin: 0.0,
        twice_arcmin: 0.0,
        bits: 20,
        noise_increments: 0.0,
    };
}

impl PositionLoop {
    pub(super) const NOMINAL: Self = Self { gain_per_s: 100.0 };
}

impl TorqueMeasurement {
    pub(super) const NOMINAL: Self = Self {
        scale_share: 0.0,
        offset_nm: 0.0,
    };
}

impl Friction {
    pub(super) const NOMINAL: Self = Self {
        coulomb_nm: 0.3,
        viscous_nm_s: 0.05,
        stiction_factor: 1.0,
        stribeck_rad_s: 0.05,
        lag_rad_s: 0.0,
    };
}

impl Payload {
    pub(super) const NOMINAL: Self = Self { mass_kg: 0.0 };
}

impl Backlash {
    pub(super) const NOMINAL: Self = Self { gap_arcmin: 0.0 };
}

impl StructuralMode {
    pub(super) const NOMINAL: Self = Self {
        xy_hz: 0.0,
        z_hz: 0.0,
        damping: 0.03,
    };
}

impl Calibration {
    pub(super) const NOMINAL: Self = Self {
        sync_mrad: 0.0,
        length_mm: 0.0,
        azimuth_mrad: 0.0,
    };
}

/// A section that a file leaves out, or a key of it, is nominal.
macro_rules! nominal_by_default {
    ($($section:ty),*) => {
        $(impl Default for $section {
            fn default() -> Self {
                Self::NOMINAL
            }
        })*
    };
}

nominal_by_default!(
    VelocityLoop,
    PositionLoop,
    DeadTime,
    Resolver,
    TorqueMeasurement,
    Friction,
    Payload,
    Backlash,
    StructuralMode,
    Calibration
);
