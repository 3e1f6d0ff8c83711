//! What a drive and its motor are like.

use super::homing::Switches;
use super::resolver::ResolverError;
use super::velocity_loop::VelocityLoop;

/// How a drive counts its position when it counts one motor turn only, from 0 to its increments less 1. Its targets are
/// in this range too, and are approached the shorter way round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OneTurn {
    /// Object 0x607B tells the range.
    Told,
    /// The drive has no object 0x607B.
    Untold,
}

/// Properties and settings of a servo drive and its motor; angles, speeds and decelerations are those of the motor.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveOptions {
    /// Position increments of one motor revolution; 0 counts as 1.
    pub increments_per_revolution: u32,
    /// Position of the drive at the angle 0, increments.
    pub zero_increments: i32,
    /// Digits of the velocity demand for one revolution per minute.
    pub digits_per_rpm: f64,
    /// Quick-stop deceleration until a master writes another one, rad/s2.
    pub quick_stop_rad_s2: f64,
    /// Deceleration against the closed brake, rad/s2.
    pub brake_rad_s2: f64,
    /// How the motor follows its velocity demand.
    pub velocity_loop: VelocityLoop,
    /// Bandwidth of a velocity loop that is a first-order lag, Hz; at least 0.1.
    pub bandwidth_hz: f64,
    /// Gain of the position loop in cyclic synchronous position, 1/s.
    pub position_gain_per_s: f64,
    /// Speed by which dry friction slows a first-order velocity loop down until its integral makes up for it, rad/s.
    pub friction_rad_s: f64,
    /// True torque for a demanded or shown torque of 1 N m.
    pub torque_scale: f64,
    /// Torque that is shown without any, N m.
    pub torque_offset_nm: f64,
    /// Noise of the resolver, increments at most.
    pub noise_increments: f64,
    /// Error of the resolver that repeats with every turn.
    pub resolver_error: ResolverError,
    /// Resolution of the resolver, bits in a turn; 0 or more bits than the increments have: the increments' resolution.
    pub resolver_bits: u32,
    /// Share of the milliseconds in which a command takes effect one millisecond late.
    pub late_share: f64,
    /// Age of a position when the bus can read it, ms; at most 100.
    pub input_delay_ms: usize,
    /// Age of a command when the motor obeys it, ms; at most 100.
    pub output_delay_ms: usize,
    /// Limit and home switches.
    pub switches: Switches,
    /// Angle of the motor at the start, rad.
    pub angle_rad: f64,
}

impl Default for DriveOptions {
    fn default() -> Self {
        Self {
            increments_per_revolution: 1 << 20,
            zero_increments: 0,
            digits_per_rpm: 262_144.0 / 1_875.0,
            quick_stop_rad_s2: 1_200.0,
            brake_rad_s2: 4_800.0,
            velocity_loop: VelocityLoop::Lag,
            bandwidth_hz: 100.0,
            position_gain_per_s: 100.0,
            friction_rad_s: 0.0,
            torque_scale: 1.0,
            torque_offset_nm: 0.0,
            noise_increments: 0.0,
            resolver_error: ResolverError::default(),
            resolver_bits: 0,
            late_share: 0.0,
            input_delay_ms: 1,
            output_delay_ms: 1,
            switches: Switches::default(),
            angle_rad: 0.0,
        }
    }
}
