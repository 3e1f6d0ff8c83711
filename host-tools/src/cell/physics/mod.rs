//! What makes a cell honest: drives, friction, play, vibration, payload and calibration as numbers.
//!
//! One structure a phenomenon. [`Physics::NOMINAL`] is an ideal robot behind first-order drives;
//! [`Physics::PESSIMISTIC`] is one that is hard to control. `docs/cell.md` has the source of every value; a test compares
//! its table with these constants.
//!
//! Invariant: values that passed [`Physics::check`] give a cell that computes finite positions.

mod file;
mod sections;

pub use file::{CellChoice, CellFileError};
pub use sections::{
    Backlash, Calibration, DeadTime, Friction, LoopKind, Payload, PositionLoop, Resolver, SheetPlace, StructuralMode,
    TorqueMeasurement, VelocityLoop,
};

use etherpen::config::Paper;
use serde::{Deserialize, Serialize};

/// Physical properties of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Physics {
    /// The drives' velocity loops.
    pub velocity_loop: VelocityLoop,
    /// The drives' position loops.
    pub position_loop: PositionLoop,
    /// Delays between bus and drives.
    pub dead_time: DeadTime,
    /// The motors' resolvers.
    pub resolver: Resolver,
    /// The drives' torque measurement.
    pub torque: TorqueMeasurement,
    /// Friction of motors, gears and joints.
    pub friction: Friction,
    /// Load at the platform.
    pub payload: Payload,
    /// Play of the gears.
    pub backlash: Backlash,
    /// Vibration between joints and pen.
    pub structural_mode: StructuralMode,
    /// Differences between the robot and its configuration.
    pub calibration: Calibration,
    /// Where the sheet lies; without it, where the configuration says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sheet: Option<SheetPlace>,
}

/// A number of [`Physics`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Value {
    /// Name, as a file of a cell has it: section and key.
    pub name: &'static str,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
    /// The value.
    pub value: f64,
    /// The lowest value allowed.
    pub low: f64,
    /// The highest value allowed.
    pub high: f64,
}

/// Number of numbers in [`Physics`].
const VALUES: usize = 27;
/// Name, unit, lowest and highest value of every number, in the order of [`Physics::numbers`].
const BOUNDS: [(&str, &str, f64, f64); VALUES] = [
    ("velocity_loop.bandwidth_hz", "Hz", 1.0, 1_000.0),
    ("velocity_loop.integral_ms", "ms", 0.5, 10_000.0),
    ("velocity_loop.current_hz", "Hz", 50.0, 100_000.0),
    ("velocity_loop.speed_filter_hz", "Hz", 20.0, 100_000.0),
    ("position_loop.gain_per_s", "1/s", 1.0, 500.0),
    ("dead_time.command_cycles", "cycles", 0.0, 20.0),
    ("dead_time.position_cycles", "cycles", 0.0, 20.0),
    ("dead_time.late_share", "", 0.0, 1.0),
    ("resolver.once_arcmin", "arcmin", 0.0, 600.0),
    ("resolver.twice_arcmin", "arcmin", 0.0, 600.0),
    ("resolver.bits", "bit", 8.0, 32.0),
    ("resolver.noise_increments", "increments", 0.0, 1e6),
    ("torque.scale_share", "", 0.0, 0.5),
    ("torque.offset_nm", "N m", 0.0, 2.0),
    ("friction.coulomb_nm", "N m", 0.0, 50.0),
    ("friction.viscous_nm_s", "N m s", 0.0, 20.0),
    ("friction.stiction_factor", "", 1.0, 5.0),
    ("friction.stribeck_rad_s", "rad/s", 0.001, 10.0),
    ("friction.lag_rad_s", "rad/s", 0.0, 1.0),
    ("payload.mass_kg", "kg", 0.0, 10.0),
    ("backlash.gap_arcmin", "arcmin", 0.0, 60.0),
    ("structural_mode.xy_hz", "Hz", 0.0, 400.0),
    ("structural_mode.z_hz", "Hz", 0.0, 400.0),
    ("structural_mode.damping", "", 0.0, 0.9),
    ("calibration.sync_mrad", "mrad", 0.0, 50.0),
    ("calibration.length_mm", "mm", 0.0, 10.0),
    ("calibration.azimuth_mrad", "mrad", 0.0, 50.0),
];

impl Physics {
    /// An ideal robot behind first-order drives.
    pub const NOMINAL: Self = Self {
        velocity_loop: VelocityLoop::NOMINAL,
        position_loop: PositionLoop::NOMINAL,
        dead_time: DeadTime::NOMINAL,
        resolver: Resolver::NOMINAL,
        torque: TorqueMeasurement::NOMINAL,
        friction: Friction::NOMINAL,
        payload: Payload::NOMINAL,
        backlash: Backlash::NOMINAL,
        structural_mode: StructuralMode::NOMINAL,
        calibration: Calibration::NOMINAL,
        sheet: None,
    };
    /// A robot that is hard to control.
    pub const PESSIMISTIC: Self = Self {
        velocity_loop: VelocityLoop {
            kind: LoopKind::Pi,
            bandwidth_hz: 50.0,
            integral_ms: 20.0,
            current_hz: 800.0,
            speed_filter_hz: 300.0,
        },
        position_loop: PositionLoop { gain_per_s: 60.0 },
        dead_time: DeadTime {
            command_cycles: 2,
            position_cycles: 1,
            late_share: 0.05,
        },
        resolver: Resolver {
            once_arcmin: 10.0,
            twice_arcmin: 3.0,
            bits: 16,
            noise_increments: 0.0,
        },
        torque: TorqueMeasurement {
            scale_share: 0.05,
            offset_nm: 0.05,
        },
        friction: Friction {
            coulomb_nm: 1.2,
            viscous_nm_s: 0.5,
            stiction_factor: 1.3,
            stribeck_rad_s: 0.05,
            lag_rad_s: 0.0,
        },
        payload: Payload { mass_kg: 1.0 },
        backlash: Backlash { gap_arcmin: 0.5 },
        structural_mode: StructuralMode {
            xy_hz: 45.0,
            z_hz: 60.0,
            damping: 0.03,
        },
        calibration: Calibration {
            sync_mrad: 2.0,
            length_mm: 0.5,
            azimuth_mrad: 1.0,
        },
        sheet: None,
    };

    /// All numbers in the order of the file, with their bounds.
    #[must_use]
    pub fn values(&self) -> [Value; VALUES] {
        let mut numbers = self.numbers().into_iter();
        BOUNDS.map(|(name, unit, low, high)| Value {
            name,
            unit,
            value: numbers.next().unwrap_or(f64::NAN),
            low,
            high,
        })
    }

    /// All numbers in the order of the file.
    fn numbers(&self) -> [f64; VALUES] {
        [
            self.velocity_loop.bandwidth_hz,
            self.velocity_loop.integral_ms,
            self.velocity_loop.current_hz,
            self.velocity_loop.speed_filter_hz,
            self.position_loop.gain_per_s,
            f64::from(self.dead_time.command_cycles),
            f64::from(self.dead_time.position_cycles),
            self.dead_time.late_share,
            self.resolver.once_arcmin,
            self.resolver.twice_arcmin,
            f64::from(self.resolver.bits),
            self.resolver.noise_increments,
            self.torque.scale_share,
            self.torque.offset_nm,
            self.friction.coulomb_nm,
            self.friction.viscous_nm_s,
            self.friction.stiction_factor,
            self.friction.stribeck_rad_s,
            self.friction.lag_rad_s,
            self.payload.mass_kg,
            self.backlash.gap_arcmin,
            self.structural_mode.xy_hz,
            self.structural_mode.z_hz,
            self.structural_mode.damping,
            self.calibration.sync_mrad,
            self.calibration.length_mm,
            self.calibration.azimuth_mrad,
        ]
    }

    /// Checks every number against its bounds.
    ///
    /// # Errors
    /// The first number outside its bounds.
    pub fn check(&self) -> Result<(), Value> {
        let outside = |value: &Value| !(value.low..=value.high).contains(&value.value);
        let sheet = self.sheet.as_ref().map(SheetPlace::values);
        let mut all = self.values().into_iter().chain(sheet.into_iter().flatten());
        all.find(outside).map_or(Ok(()), Err)
    }

    /// The sheet of a configuration as it really lies.
    pub(super) fn paper(&self, configured: &Paper) -> Paper {
        match self.sheet {
            Some(SheetPlace { z_mm, slope_x, slope_y }) => Paper {
                pen_down_z_mm: z_mm,
                slope: [slope_x, slope_y],
                ..*configured
            },
            None => *configured,
        }
    }
}

impl Default for Physics {
    fn default() -> Self {
        Self::NOMINAL
    }
}

#[cfg(test)]
mod tests;
