//! The drives of a group as the axes of a robot.
//!
//! Positions of single-turn resolvers are unwrapped into 64 bits and, once homed, returned as joint angles. An
//! axis's command goes to its drive ([`ServoAxis`]) and is compared with what the drive then reports
//! ([`FeedbackMonitor`]).
//!
//! Invariants: a position is available only in the cycle in which it arrived; an axis whose turns may have been
//! miscounted, whose feedback is implausible, or whose drive was configured again, is not homed.

mod encoder;
mod findings;

pub use findings::{HomingError, Reading};

use crate::config::{Axis, AxisMode, Encoder};
use crate::control::feedback::{COMPARISONS, FeedbackMonitor, Implausible};
use crate::control::limit::limited;
use crate::control::position::error_removed_rad;
use crate::control::torque_feedback::Demanded;
use crate::drives::cia402::{DriveState, DriveTarget, StatusWord};
use crate::drives::io::{GroupDrive, IoGroup, PositionIo, TorqueIo, VelocityIo};
use crate::drives::{AxisLimits, DriveInput, DriveOutput, ServoAxis};
use crate::robots::{AXES, JointAngles};
use core::f64::consts::TAU;
pub use encoder::encoder_angle_rad;
use encoder::{float, turned};

/// Longest gap of positions in motion after which the turns still count as known, ms: half a motor turn takes 10 ms at
/// full speed.
pub const GAP_IN_MOTION_MAX_MS: u32 = 8;
/// Longest gap of positions at rest after which the turns still count as known, ms.
pub const GAP_AT_REST_MAX_MS: u32 = 500;
/// How long the feedback is compared with the ramp of a quick stop, ms: long enough to detect a frozen feedback whose
/// following error stopped the robot first, and too short for the unknown start of the ramp to matter.
const RAMP_COMPARED_MS: u8 = 10;
/// Speed above which a change of the position is a jump of the feedback, as a part of the greatest speed.
const JUMP_SPEED: f64 = 1.5;
/// Acceleration above which a change of the position is a jump of the feedback, rad/s2 at the joint: no drive's ramp and
/// no hand reaches it. After a gap it tells a jump from a motion, which the speed alone cannot.
const JUMP_RAD_S2: f64 = 1_000.0;
/// Motor speed below which an axis is at rest, revolutions a second.
const REST_REVOLUTIONS_S: f64 = 0.05;

/// What an axis reported in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisInput {
    /// Motor position, unwrapped: it never jumps at the end of the encoder's range.
    pub position: i64,
    /// Joint angle, rad; `None` until the axis is homed.
    pub angle_rad: Option<f64>,
    /// The drive's status word.
    pub status: StatusWord,
}

/// Demand for an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Demand {
    /// Velocity at the joint, rad/s.
    Velocity(f64),
    /// Torque at the joint, N m.
    Torque(f64),
}

impl Default for Demand {
    /// A velocity of 0.
    fn default() -> Self {
        Self::Velocity(0.0)
    }
}

/// Command to an axis for one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisCommand {
    /// Target state of the drive.
    pub target: DriveTarget,
    /// Demand; used while the drive is in operation and its target is operation, if its mode takes this kind of demand.
    pub demand: Demand,
}

/// Demand of one cycle on an axis in position mode.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PositionDemand {
    /// Joint angle of the target, rad.
    pub angle_rad: f64,
    /// Velocity of the target, rad/s at the joint.
    pub velocity_rad_s: f64,
    /// Velocity to add to that of the drive's position loop, rad/s at the joint.
    pub forward_rad_s: f64,
    /// Velocity of the drive's position loop, as expected from the present error, rad/s at the joint.
    pub correction_rad_s: f64,
}

/// One axis: its drive, its unwrapped position, and its zero.
#[derive(Clone, Copy, Debug)]
struct AxisState {
    config: Axis,
    increments_per_rad: f64,
    increments_per_revolution: i32,
    drive: ServoAxis,
    raw: i32,
    position: i64,
    known: bool,
    gap_ms: u32,
    step: i32,
    /// Whether a position arrived in this cycle.
    valid: bool,
    status: StatusWord,
    /// Number of the present drive's configuration, and of the last input's.
    drive_generation: u8,
    generation: u8,
    /// Unwrapped position at joint angle 0.
    zero: Option<f64>,
    /// Whether targets count from where the unwrapping began while there is no zero.
    searches: bool,
    home_lost: bool,
    commanded: bool,
    feedback: FeedbackMonitor,
    /// Last demand sent to the drive, digits.
    sent: i32,
    /// Remaining time for which the feedback is compared with `sent`, ms.
    compared_ms: u8,
    /// Change of `sent` in a millisecond of a quick stop, digits.
    ramp_digits: i32,
    /// Largest change of the position in a millisecond, increments.
    jump_increments: u32,
    /// Step before the last but one, while commands are not compared.
    step_before: i32,
    /// Change of that in a millisecond above which it is one.
    jump_increments_ms2: u32,
    implausible: Option<Implausible>,
}

impl AxisState {
    fn new(axis: &Axis) -> Self {
        let increments = axis.increments_per_revolution.clamp(1, i32::MAX as u32) as i32;
        Self {
            config: *axis,
            increments_per_rad: axis.gear * f64::from(increments) / TAU,
            increments_per_revolution: increments,
            drive: ServoAxis::new(),
            raw: 0,
            position: 0,
            known: false,
            gap_ms: 0,
            step: 0,
            valid: false,
            status: StatusWord(0),
            drive_generation: 0,
            generation: 0,
            zero: None,
            searches: false,
            home_lost: false,
            commanded: false,
            feedback: FeedbackMonitor::new(axis, AxisMode::Velocity, 1.0),
            sent: 0,
            compared_ms: 0,
            ramp_digits: 0,
            step_before: 0,
            jump_increments_ms2: (JUMP_RAD_S2 * axis.gear.abs() * f64::from(increments) / TAU / 1e6) as u32 + 1,
            jump_increments: (JUMP_SPEED * axis.output_max_rad_s.abs() * axis.gear.abs() * f64::from(increments)
                / TAU
                / 1_000.0) as u32,
            implausible: None,
        }
    }

    /// The axis is no longer homed: the turns are unknown.
    fn lose_home(&mut self) {
        self.home_lost |= self.zero.is_some();
        self.zero = None;
    }

    fn is_moving(&self) -> bool {
        let rest = (REST_REVOLUTIONS_S * f64::from(self.increments_per_revolution) / 1000.0).max(1.0);
        f64::from(self.step.unsigned_abs()) > rest
    }

    /// Takes this cycle's input, or the lack of one.
    #[inline(always)]
    fn step(&mut self, input: Option<DriveInput>, generation: u8) {
        if generation != self.generation {
            self.generation = generation;
            self.known = false;
            self.lose_home();
        }
        let Some(input) = input else {
            self.miss();
            return;
        };
        if self.known {
            let shown = input.position.wrapping_sub(self.raw);
            let difference = turned(shown, self.increments_per_revolution);
            self.position += i64::from(difference);
            if shown != difference {
                self.pass_end(shown, difference);
            }
            let cycles = self.gap_ms.min(GAP_AT_REST_MAX_MS) as i32 + 1;
            let before = core::mem::replace(&mut self.step, difference / cycles);
            if self.compared_ms == 0 {
                self.look_for_jump(difference, before, cycles);
            } else if !self.feedback.step(self.sent, difference) {
                self.reject_feedback();
            }
        } else {
            self.position = i64::from(input.position);
            self.step = 0;
            self.known = true;
        }
        self.raw = input.position;
        self.gap_ms = 0;
        self.status = input.status;
        self.drive.take(&input);
        self.valid = true;
    }

    /// Handles a position that is not within half a turn of the one before. A multi-turn encoder counts the turns that nobody
    /// has seen; one whose position starts again after a turn is none.
    #[cold]
    fn pass_end(&mut self, shown: i32, difference: i32) {
        let counts_turns = self.config.encoder == Encoder::MultiTurn;
        if counts_turns {
            self.position += i64::from(shown) - i64::from(difference);
        }
        if counts_turns || self.drive.has_left_range(shown, difference) {
            self.lose_home();
            self.home_lost |= self.searches;
        }
    }

    /// Handles a cycle without an input.
    #[cold]
    fn miss(&mut self) {
        self.gap_ms = self.gap_ms.saturating_add(1);
        let moving = self.is_moving() || self.commanded;
        if self.gap_ms > GAP_IN_MOTION_MAX_MS && moving || self.gap_ms > GAP_AT_REST_MAX_MS {
            self.lose_home();
        }
        if self.compared_ms > 0 {
            self.feedback.step_blind(self.sent);
        }
        self.valid = false;
    }

    /// Handles an implausible feedback: stores the reason; the axis is no longer homed.
    #[cold]
    fn reject_feedback(&mut self) {
        self.implausible = Some(self.feedback.implausible());
        self.end_comparison();
        self.lose_home();
    }

    /// The axis is no longer homed after a jump: a joint without power may be moved by hand, but not faster than its motor
    /// can move, nor get there at once; it may stop at once. `before` is the step in the millisecond before the last
    /// `cycles` milliseconds. A jump is one alone and together with the step before it: a drive may report a position
    /// twice. After a gap of more than about 16 ms only the speed tells.
    #[cold]
    fn look_for_jump(&mut self, difference: i32, before: i32, cycles: i32) {
        let is_beyond = |moved: i64, from: i32, ms: i64| {
            let going_on = i64::from(from) * ms;
            let gained = i64::from(self.jump_increments_ms2) * ms * ms;
            !(going_on.min(0) - gained..=going_on.max(0) + gained).contains(&moved)
        };
        let (ms, moved) = (i64::from(cycles), i64::from(difference));
        let is_jump = is_beyond(moved, before, ms) && is_beyond(moved + i64::from(before), self.step_before, ms + 1);
        if is_jump || self.step.unsigned_abs() > self.jump_increments {
            self.lose_home();
        }
        self.step_before = before;
    }

    #[cold]
    fn end_comparison(&mut self) {
        (self.compared_ms, self.sent) = (0, 0);
        self.step_before = self.step;
        self.feedback.reset();
    }

    /// Compares a drive that does not follow commands with its quick-stop ramp for a moment, then ends the comparison.
    #[cold]
    fn follow_ramp(&mut self) {
        let state = self.drive.state();
        let brakes = matches!(state, DriveState::OperationEnabled | DriveState::QuickStopActive);
        let ramps = matches!(
            self.drive.demand_scale(),
            Some((AxisMode::Velocity | AxisMode::Position, _))
        );
        let left = self.sent.saturating_abs().saturating_sub(self.ramp_digits);
        if self.compared_ms <= 1 || !brakes || !ramps || left <= 0 {
            return self.end_comparison();
        }
        self.compared_ms -= 1;
        self.sent = if self.sent < 0 { -left } else { left };
    }

    #[inline]
    fn angle_rad(&self, position: i64) -> Option<f64> {
        self.zero.map(|zero| (float(position) - zero) / self.increments_per_rad)
    }

    #[inline]
    fn axis_input(&self) -> Option<AxisInput> {
        self.valid.then(|| AxisInput {
            position: self.position,
            angle_rad: self.angle_rad(self.position),
            status: self.status,
        })
    }

    /// Takes over the axis's drive in the group; without one the axis takes no demand.
    fn adopt(&mut self, drive: Option<&GroupDrive>) {
        if let Some(drive) = drive {
            self.drive_generation = drive.generation;
        }
        let limits = AxisLimits {
            velocity_rad_s: self.config.output_max_rad_s,
            torque_nm: self.config.torque_max_nm,
        };
        if self.drive.adopt(drive, &self.config.drive(), &limits) {
            self.renew_feedback();
        }
    }

    /// Begins to compare anew, by the drive's scale.
    fn renew_feedback(&mut self) {
        self.end_comparison();
        if let Some((mode, digits_per_unit)) = self.drive.demand_scale() {
            self.feedback = FeedbackMonitor::new(&self.config, mode, digits_per_unit);
            let ramp_rad_s2 = self.config.quick_stop_rad_s2.abs();
            self.ramp_digits = (ramp_rad_s2 * digits_per_unit.abs() / 1_000.0) as i32;
        }
    }

    /// The output to the drive; the feedback of the next cycles is compared with it.
    #[inline(always)]
    fn output(&mut self, command: &AxisCommand) -> DriveOutput {
        let output = match command.demand {
            Demand::Velocity(rad_s) => self.drive.set_velocity(command.target, rad_s),
            Demand::Torque(nm) => self.drive.set_torque(command.target, nm),
        };
        self.commanded = output.demand_digits != 0;
        if self.drive.runs(&output) {
            (self.sent, self.compared_ms) = (output.demand_digits, RAMP_COMPARED_MS);
        } else if self.compared_ms > 0 {
            self.follow_ramp();
        }
        output
    }

    /// The output to a drive in position mode, which holds its last target without a demand. The feedback of the next
    /// cycles is compared with what the drive is expected to do.
    #[inline(never)]
    fn output_position(&mut self, target: DriveTarget, demand: Option<&PositionDemand>) -> DriveOutput {
        let wanted = demand.and_then(|demand| Some((self.increments_at(demand.angle_rad)?, demand)));
        let forward_rad_s = wanted.map_or(0.0, |(_, demand)| demand.forward_rad_s);
        let increments = wanted.map(|(increments, _)| increments);
        let output = self.drive.set_position(target, increments, forward_rad_s);
        self.commanded = wanted.is_some_and(|(_, demand)| demand.velocity_rad_s != 0.0);
        let scale = self.drive.demand_scale().filter(|_| self.drive.runs(&output));
        if let Some((_, digits_per_unit)) = scale {
            let expected_rad_s = match wanted {
                Some((_, demand)) => demand.correction_rad_s + demand.velocity_rad_s,
                None => {
                    let error = f64::from(self.drive.ahead(output.position)) / self.increments_per_rad;
                    self.config.feedback_gain_per_s * error_removed_rad(error, 0.0)
                }
            };
            let expected_rad_s = limited(expected_rad_s, self.config.output_max_rad_s.abs());
            (self.sent, self.compared_ms) = ((expected_rad_s * digits_per_unit) as i32, RAMP_COMPARED_MS);
        } else if self.compared_ms > 0 {
            self.follow_ramp();
        }
        output
    }

    /// The drive's position at a joint angle, increments; `None` while the axis is neither homed nor led to its switch, or for
    /// an angle that is not finite.
    fn increments_at(&self, angle_rad: f64) -> Option<i32> {
        let zero = self.zero.or(self.searches.then_some(0.0))?;
        let ahead = zero + angle_rad * self.increments_per_rad - float(self.position);
        // Rounds to the nearest integer: the conversion truncates and saturates.
        let rounded = (ahead + if ahead < 0.0 { -0.5 } else { 0.5 }) as i32;
        ahead.is_finite().then(|| self.raw.wrapping_add(rounded))
    }
}

/// The robot's axes: the first `used` of them have drives. One that the machine lacks is in the state of the first.
#[derive(Clone, Debug)]
pub struct RobotAxes {
    axes: [AxisState; AXES],
    used: usize,
    /// Whether the axes still have to take over their drives, whatever the group reports.
    is_new: bool,
}

impl RobotAxes {
    /// A robot with the scaling of the configuration; not homed.
    pub fn new(axes: &[Axis; AXES], used: usize) -> Self {
        Self {
            axes: axes.each_ref().map(AxisState::new),
            used,
            is_new: true,
        }
    }

    /// Replaces the axes, of which the first `used` have drives; none of the new ones is homed.
    pub fn configure(&mut self, axes: &[Axis; AXES], used: usize) {
        for (state, axis) in self.axes.iter_mut().zip(axes) {
            *state = AxisState::new(axis);
        }
        self.used = used;
        self.is_new = true;
    }

    /// The axes that have drives.
    fn used(&self) -> impl Iterator<Item = &AxisState> {
        self.axes.iter().take(self.used)
    }

    /// Takes this cycle's inputs. Call it exactly once a cycle, even if nothing arrived.
    pub fn read(&mut self, group: &mut impl IoGroup) {
        self.renew(group);
        for (member, axis) in self.axes.iter_mut().enumerate() {
            axis.step(group.read(member), axis.drive_generation);
        }
    }

    /// Takes over the group's drives if they have changed. Call it before [`Self::read_axis`].
    #[inline]
    pub fn renew(&mut self, group: &mut impl IoGroup) {
        if group.renew() || self.is_new {
            self.adopt(group);
        }
    }

    #[cold]
    fn adopt(&mut self, group: &impl IoGroup) {
        self.is_new = false;
        for (member, axis) in self.axes.iter_mut().enumerate() {
            axis.adopt(group.drive(member).as_ref());
        }
    }

    /// Takes this cycle's input of one axis; [`Self::read`] takes those of all axes. `None` if none arrived.
    #[inline(always)]
    pub fn read_axis<const AXIS: usize>(&mut self, group: &impl IoGroup) -> Option<Reading> {
        const { assert!(AXIS < AXES) };
        let axis = &mut self.axes[AXIS];
        axis.step(group.read(AXIS), axis.drive_generation);
        axis.valid.then(|| Reading {
            increments: axis.position,
            angle_rad: (float(axis.position) - axis.zero.unwrap_or(0.0)) / axis.increments_per_rad,
            homed: axis.zero.is_some(),
            status: axis.status,
        })
    }

    /// Takes the leads of these axes over, at rest; all else stays as it was configured.
    #[cold]
    pub fn take_leads(&mut self, axes: &[Axis; AXES]) {
        for (state, axis) in self.axes.iter_mut().zip(axes) {
            state.config = *axis;
            state.renew_feedback();
        }
    }

    /// What the axes reported in this cycle.
    pub fn inputs(&self) -> [Option<AxisInput>; AXES] {
        self.axes.each_ref().map(AxisState::axis_input)
    }

    /// Whether all drives were in operation when they last reported.
    #[inline]
    pub fn is_in_operation(&self) -> bool {
        self.used()
            .all(|axis| axis.drive.state() == DriveState::OperationEnabled)
    }

    /// State of an axis's drive when it last reported; that of the first axis for one without a drive.
    #[inline]
    pub fn state(&self, axis: usize) -> DriveState {
        self.axes
            .get(if axis < self.used { axis } else { 0 })
            .map_or(DriveState::NotReadyToSwitchOn, |axis| axis.drive.state())
    }

    /// Finds the pose from the present positions: each axis takes the angle of its [encoder](encoder_angle_rad), on the motor
    /// turn nearest to the pose `near`, or to its synchronisation mark, if the encoder does not know the turn.
    ///
    /// # Errors
    /// [`HomingError`]; no axis is homed then, because the previous pose was to be corrected.
    pub fn home(&mut self, near: Option<&JointAngles>) -> Result<(), HomingError> {
        if let Some(error) = self.why_not_homed() {
            self.axes.iter_mut().for_each(AxisState::lose_home);
            return Err(error);
        }
        for (number, axis) in self.axes.iter_mut().enumerate() {
            let near_rad = near.and_then(|pose| pose.0.get(number).copied());
            let angle_rad = encoder_angle_rad(&axis.config, i64::from(axis.raw), near_rad);
            axis.zero = Some(float(axis.position) - angle_rad * axis.increments_per_rad);
            axis.home_lost = false;
        }
        Ok(())
    }

    /// Forgets the homes, because they are to be found anew.
    pub fn forget_home(&mut self) {
        for axis in &mut self.axes {
            (axis.zero, axis.home_lost) = (None, false);
        }
    }

    /// The last angles of the joints, rad; of one that is not homed they count from where the unwrapping began.
    pub fn angles_rad(&self) -> [f64; AXES] {
        self.axes
            .each_ref()
            .map(|axis| (float(axis.position) - axis.zero.unwrap_or(0.0)) / axis.increments_per_rad)
    }

    /// Whether the axes are led to their switches: until they are homed their angles count from where the unwrapping began.
    pub fn set_searching(&mut self, searches: bool) {
        self.axes.iter_mut().for_each(|axis| axis.searches = searches);
    }

    /// Takes the positions of the switches, increments, as the joint angles of the marks; axes without one are homed at the
    /// marks of their encoders.
    ///
    /// # Errors
    /// [`HomingError`]; no axis is homed then.
    pub fn home_at(&mut self, edges: &[Option<i64>; AXES]) -> Result<(), HomingError> {
        self.home(None)?;
        for (axis, edge) in self.axes.iter_mut().zip(edges) {
            if let Some(edge) = edge {
                axis.zero = Some(float(*edge) - axis.config.sync_angle_rad * axis.increments_per_rad);
            }
        }
        Ok(())
    }

    /// Why the present positions do not give a pose.
    fn why_not_homed(&self) -> Option<HomingError> {
        (0..).zip(self.used()).find_map(|(number, axis)| match axis {
            _ if !axis.valid => Some(HomingError::NoPosition { axis: number }),
            _ if axis.is_moving() => Some(HomingError::Moving { axis: number }),
            _ => None,
        })
    }

    /// Whether all axes are homed.
    pub fn is_homed(&self) -> bool {
        self.used().all(|axis| axis.zero.is_some())
    }

    /// Which axes were homed and no longer are; cleared by [`Self::home`].
    pub fn homes_lost(&self) -> [bool; AXES] {
        self.axes.each_ref().map(|axis| axis.home_lost)
    }

    /// The first axis whose feedback was implausible since the last call, and why.
    #[cold]
    pub fn take_implausible(&mut self) -> Option<(u8, Implausible)> {
        let mut found = None;
        for (number, axis) in (0..).zip(&mut self.axes) {
            let implausible = axis.implausible.take();
            found = found.or(implausible.map(|implausible| (number, implausible)));
        }
        found
    }

    /// Largest value of each feedback comparison over all axes, relative to its limit. For tests.
    pub fn feedback_used(&self) -> [f32; COMPARISONS.len()] {
        let each = self.axes.each_ref().map(|axis| axis.feedback.used());
        core::array::from_fn(|comparison| each.iter().fold(0.0, |most, used| f32::max(most, used[comparison])))
    }

    /// Sets what the setpoints demand of the axes in torque mode: the motion and the change of load that are not a
    /// fault of the feedback.
    pub fn set_demanded(&mut self, demanded: &[Demanded; AXES]) {
        for (axis, demanded) in self.axes.iter_mut().zip(demanded) {
            axis.feedback.set_demanded(demanded);
        }
    }

    /// Writes the axes' commands to the group's outputs.
    pub fn write(&mut self, group: &mut impl IoGroup, commands: &[AxisCommand; AXES]) {
        for (member, (axis, command)) in self.axes.iter_mut().zip(commands).enumerate() {
            let output = axis.output(command);
            group.write(member, &output);
        }
    }

    /// Writes the command of one axis; [`Self::write`] writes those of all axes.
    #[inline(always)]
    pub fn write_axis<const AXIS: usize>(&mut self, group: &mut impl IoGroup, command: &AxisCommand) {
        const { assert!(AXIS < AXES) };
        let output = self.axes[AXIS].output(command);
        group.write(AXIS, &output);
    }

    /// Writes the command of one axis in position mode; without a demand its drive holds its last target.
    #[inline(never)]
    pub fn write_position(
        &mut self,
        axis: usize,
        group: &mut impl IoGroup,
        target: DriveTarget,
        demand: Option<&PositionDemand>,
    ) {
        if let Some(state) = self.axes.get_mut(axis) {
            group.write(axis, &state.output_position(target, demand));
        }
    }
}

#[cfg(test)]
mod tests;
