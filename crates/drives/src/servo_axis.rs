//! A servo drive as an axis: scales demands to the drive's digits and leads the drive through the states of CiA 402.
//!
//! Invariants: a demand never exceeds the axis's limit; it is 0 unless the drive is in operation, in the mode that was set,
//! meant to stay there, and takes this kind of demand; a drive that is not operational is not enabled, so that it goes
//! through the whole sequence afterwards; nor is one that shows another mode with power in more than [`MODE_CYCLES_MAX`]
//! cycles in a row. A target position begins where the drive is when it comes into operation,
//! changes by no more in a cycle than the axis's greatest velocity allows, and stays in the drive's range.

use crate::cia402::{self, ControlWord, DriveState, DriveTarget, StatusWord};
use crate::io::{GroupDrive, PositionIo, TorqueIo, VelocityIo};
use crate::{AxisMode, DriveInput, DriveKind, DriveOutput, DriveSettings, PositionRange};
use core::f64::consts::TAU;

/// Largest demands on an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// Largest velocity, rad/s at the joint.
    pub velocity_rad_s: f64,
    /// Largest torque, N m at the joint.
    pub torque_nm: f64,
}

/// Scale and limit of an axis's demand.
#[derive(Clone, Copy, Debug)]
struct Scale {
    kind: DriveKind,
    mode: AxisMode,
    /// Digits for 1 rad/s or 1 N m at the joint.
    digits_per_unit: f64,
    /// Largest demand, rad/s or N m at the joint.
    limit: f64,
    /// Largest change of the target position in a cycle, increments; at least 1.
    step_max: i32,
    range: PositionRange,
}

impl Scale {
    fn new(settings: &DriveSettings, limits: &AxisLimits, drive: &GroupDrive, cycle_s: f64) -> Option<Self> {
        let at_motor = drive.kind.mode(drive.mode)?.digits.per_unit(settings);
        let (digits_per_unit, limit) = match drive.mode {
            AxisMode::Velocity | AxisMode::Position => (at_motor * settings.gear, limits.velocity_rad_s.abs()),
            AxisMode::Torque => (at_motor / settings.gear, limits.torque_nm.abs()),
        };
        let increments_per_rad = settings.gear.abs() * f64::from(settings.increments_per_revolution) / TAU;
        Some(Self {
            kind: drive.kind,
            mode: drive.mode,
            digits_per_unit,
            limit,
            step_max: ((limits.velocity_rad_s.abs() * increments_per_rad * cycle_s) as i32)
                .min(drive.range.step_max())
                .max(1),
            range: drive.range,
        })
    }
}

/// Length of a cycle unless another one is given, ns.
const CYCLE_NS: u32 = 1_000_000;
/// Cycles in which a drive with power may show another mode; it gets no demand meanwhile.
const MODE_CYCLES_MAX: u8 = 10;

/// One axis and its drive.
#[derive(Clone, Copy, Debug)]
pub struct ServoAxis {
    scale: Option<Scale>,
    cycle_ns: u32,
    operational: bool,
    position: i32,
    state: DriveState,
    mode_in_effect: bool,
    /// Cycles with power in which the drive has shown another mode, since it was last in the mode that was set or meant to
    /// be without power.
    without_mode: u8,
    /// Last target position that the drive was to follow; `None` while it follows none.
    target_position: Option<i32>,
}

impl Default for ServoAxis {
    fn default() -> Self {
        Self::new()
    }
}

impl ServoAxis {
    /// An axis without a drive, with a demand each millisecond.
    pub const fn new() -> Self {
        Self::with_cycle(CYCLE_NS)
    }

    /// An axis without a drive, with a demand each `cycle_ns`: the length of the bus's cycle, which limits how far a target
    /// position may go in one.
    pub const fn with_cycle(cycle_ns: u32) -> Self {
        Self {
            cycle_ns,
            scale: None,
            operational: false,
            position: 0,
            state: StatusWord(0).state(),
            mode_in_effect: false,
            without_mode: 0,
            target_position: None,
        }
    }

    /// Takes over the axis's drive in the group; without one the axis takes no demand. Returns true if the drive or its
    /// mode has changed.
    pub fn adopt(&mut self, drive: Option<&GroupDrive>, settings: &DriveSettings, limits: &AxisLimits) -> bool {
        self.operational = drive.is_some_and(|drive| drive.operational);
        let same = match (&self.scale, drive) {
            (Some(scale), Some(drive)) => {
                core::ptr::eq(scale.kind, drive.kind) && (scale.mode, scale.range) == (drive.mode, drive.range)
            }
            (None, None) => true,
            _ => false,
        };
        if !same {
            self.scale = drive.and_then(|drive| Scale::new(settings, limits, drive, f64::from(self.cycle_ns) * 1.0e-9));
        }
        !same
    }

    /// Takes the values that the drive reported.
    #[inline(always)]
    pub fn take(&mut self, input: &DriveInput) {
        self.position = input.position;
        self.state = input.status.state();
        self.mode_in_effect = input.mode_in_effect;
        if input.mode_in_effect {
            self.without_mode = 0;
        }
    }

    /// State of the drive when it last reported.
    #[inline]
    pub fn state(&self) -> DriveState {
        self.state
    }

    /// Kind of demand that the drive takes, and its digits for 1 rad/s or 1 N m at the joint; `None` without a drive.
    pub fn demand_scale(&self) -> Option<(AxisMode, f64)> {
        self.scale.as_ref().map(|scale| (scale.mode, scale.digits_per_unit))
    }

    /// How far a position of the drive is ahead of the present one, increments: the shorter way round in its range.
    #[inline]
    pub fn ahead(&self, position: i32) -> i32 {
        let difference = position.wrapping_sub(self.position);
        self.scale
            .as_ref()
            .map_or(difference, |scale| scale.range.nearest(difference))
    }

    /// Whether a drive in position mode has passed the end of a range that it has not told: `difference` is that of two
    /// positions, `turned` the one that the motor has moved. What its targets would mean is not known.
    #[cold]
    pub fn has_left_range(&self, difference: i32, turned: i32) -> bool {
        let is_beyond = |scale: &Scale| scale.mode == AxisMode::Position && scale.range.nearest(difference) != turned;
        self.scale.as_ref().is_some_and(is_beyond)
    }

    /// Whether an output lets the drive run: its demand is in effect.
    #[inline]
    pub fn runs(&self, output: &DriveOutput) -> bool {
        let is_enabled = output.control == ControlWord::ENABLE_OPERATION;
        self.state == DriveState::OperationEnabled && is_enabled && self.mode_in_effect
    }

    /// A demand in digits, if the drive takes this kind of demand, else 0.
    #[inline(always)]
    fn digits(&self, mode: AxisMode, wanted: f64) -> i32 {
        let Some(scale) = self.scale.as_ref().filter(|scale| scale.mode == mode) else {
            return 0;
        };
        let value = if wanted.abs() <= scale.limit {
            wanted
        } else if wanted.is_finite() {
            scale.limit.copysign(wanted)
        } else {
            0.0
        };
        // Rounds to the nearest integer: the conversion truncates and saturates.
        let digits = value * scale.digits_per_unit;
        (digits + if digits < 0.0 { -0.5 } else { 0.5 }) as i32
    }

    /// Whether a drive that shows another mode may be enabled, or stay so for a moment: some show the mode when they have
    /// power.
    #[cold]
    fn awaits_mode(&mut self) -> bool {
        self.without_mode += u8::from(self.state == DriveState::OperationEnabled && self.without_mode < u8::MAX);
        self.without_mode <= MODE_CYCLES_MAX
    }

    #[inline(always)]
    fn output(&mut self, target: DriveTarget, mode: AxisMode, wanted: f64) -> DriveOutput {
        let may_run = self.operational && (self.mode_in_effect || self.awaits_mode());
        let target = match target {
            // A drive that is still moving brakes; any other one stays without power.
            DriveTarget::Enabled if !may_run => DriveTarget::QuickStop,
            DriveTarget::Enabled => DriveTarget::Enabled,
            target => {
                self.without_mode = 0;
                target
            }
        };
        let running = self.state == DriveState::OperationEnabled && target == DriveTarget::Enabled;
        DriveOutput {
            demand_digits: match running && self.mode_in_effect {
                true => self.digits(mode, wanted),
                false => 0,
            },
            position: self.position,
            control: match running {
                true => ControlWord::ENABLE_OPERATION,
                false => cia402::step_from(self.state, target),
            },
        }
    }
}

impl VelocityIo for ServoAxis {
    #[inline(always)]
    fn set_velocity(&mut self, target: DriveTarget, velocity_rad_s: f64) -> DriveOutput {
        self.output(target, AxisMode::Velocity, velocity_rad_s)
    }
}

impl TorqueIo for ServoAxis {
    #[inline(always)]
    fn set_torque(&mut self, target: DriveTarget, torque_nm: f64) -> DriveOutput {
        self.output(target, AxisMode::Torque, torque_nm)
    }
}

impl PositionIo for ServoAxis {
    #[inline(never)]
    fn set_position(&mut self, target: DriveTarget, position: Option<i32>, velocity_rad_s: f64) -> DriveOutput {
        let wanted_rad_s = if position.is_some() { velocity_rad_s } else { 0.0 };
        let output = self.output(target, AxisMode::Position, wanted_rad_s);
        let follows = self.runs(&output);
        let Some(scale) = self
            .scale
            .as_ref()
            .filter(|scale| follows && scale.mode == AxisMode::Position)
        else {
            self.target_position = None;
            return output;
        };
        let last = self.target_position.unwrap_or(self.position);
        // The drive may have passed an end of its range since the last target, and the target may lie beyond one.
        let lead = scale.range.nearest(last.wrapping_sub(self.position));
        let change = position.map_or(0, |position| position.wrapping_sub(self.position).wrapping_sub(lead));
        let next = last.wrapping_add(change.max(-scale.step_max).min(scale.step_max));
        let next = scale.range.fold(next);
        self.target_position = Some(next);
        DriveOutput {
            position: next,
            ..output
        }
    }
}
