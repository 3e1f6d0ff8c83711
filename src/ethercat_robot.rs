//! Four drives on the bus as the four axes of a robot.
//!
//! Positions of single-turn resolvers are unwrapped into 64 bits and, once referenced, given as joint angles; commands
//! are turned from rad/s or N m at the joint into the drives' digits.
//!
//! Invariants: a position is only given in the cycle it came in; a velocity or torque never exceeds the axis's clamp and
//! is 0 unless the drive is in operation, meant to stay there, and takes this kind of demand; a drive that is not in OP,
//! or not in the mode that was set, is not enabled, so that it goes through the whole sequence afterwards; an axis whose
//! turns may have been miscounted, whose feedback cannot be true, or whose drive was configured anew, is not referenced.

mod encoder;
mod findings;

pub use findings::{Reading, ReferenceError};

use crate::application::homing::resolver_angle_rad;
use crate::config::{Axis, AxisMode};
use crate::control::feedback::{COMPARISONS, FeedbackMonitor, Implausible};
use crate::control::limited;
use crate::control::torque_feedback::Demanded;
use crate::drives::cia402::{self, DriveState, DriveTarget, StatusWord};
use crate::drives::io::{AxisCommand, AxisInput, Demand, Increments, IoGroup, TorqueIo, VelocityIo};
use crate::drives::layout::ProcessLayout;
use crate::drives::{DriveInput, DriveKind, DriveOutput};
use crate::ethercat::cyclic::OutputPlace;
use crate::robot_bus::{DriveRole, DriveShare, RobotExchange};
use crate::robots::{AXES, JointAngles};
use core::f64::consts::TAU;
use encoder::{float, turned};

/// Longest gap of positions in motion after which the turns still count as known, ms: half a motor turn takes 10 ms at
/// full speed.
pub const GAP_IN_MOTION_MAX_MS: u32 = 8;
/// Longest gap of positions at rest after which the turns still count as known, ms.
pub const GAP_AT_REST_MAX_MS: u32 = 500;
/// How long the feedback is compared with the ramp of a quick stop, ms: long enough to tell a frozen feedback, whose
/// following error stopped the robot first, and too short for what is not known of the ramp's beginning to matter.
const RAMP_COMPARED_MS: u8 = 10;
/// Speed above which a change of the position is a jump of the feedback, as a part of the greatest speed.
const JUMP_SPEED: f64 = 1.5;
/// Motor speed below which an axis is at rest, revolutions a second.
const REST_REVOLUTIONS_S: f64 = 0.05;

/// What a drive's digits are worth on an axis.
#[derive(Clone, Copy, Debug)]
struct Scale {
    kind: DriveKind,
    mode: AxisMode,
    /// Digits for 1 rad/s or 1 N m at the joint.
    digits_per_unit: f64,
    /// Largest demand, rad/s or N m at the joint.
    limit: f64,
}

impl Scale {
    fn new(axis: &Axis, role: &DriveRole) -> Option<Self> {
        let mode = role.layout.mode;
        let at_motor = role.device.mode(mode)?.digits.per_unit(&axis.drive());
        let (digits_per_unit, limit) = match mode {
            AxisMode::Velocity => (at_motor * axis.gear, axis.output_max_rad_s.abs()),
            AxisMode::Torque => (at_motor / axis.gear, axis.torque_max_nm.abs()),
        };
        Some(Self {
            kind: role.device,
            mode,
            digits_per_unit,
            limit,
        })
    }
}

/// Where an axis's values are.
#[derive(Clone, Copy, Debug)]
struct DrivePlace {
    slave: usize,
    layout: ProcessLayout,
    outputs: OutputPlace,
}

/// One axis: scaling, unwrapped position, reference.
#[derive(Clone, Copy, Debug)]
struct AxisState {
    config: Axis,
    increments_per_rad: f64,
    increments_per_revolution: i32,
    /// Where the drive is on the bus and in its process data, by the present plan.
    place: Option<DrivePlace>,
    drive: Option<Scale>,
    raw: i32,
    position: i64,
    known: bool,
    gap_ms: u32,
    step: i32,
    /// Whether a position came in this cycle.
    valid: bool,
    status: StatusWord,
    state: DriveState,
    mode_in_effect: bool,
    operational: bool,
    /// Of the present plan, and of the last input.
    plan_generation: u8,
    generation: u8,
    /// Unwrapped position at joint angle 0.
    zero: Option<f64>,
    reference_lost: bool,
    commanded: bool,
    feedback: FeedbackMonitor,
    /// What the drive was told last, digits.
    sent: i32,
    /// For how long the feedback is still to be compared with what was sent, ms.
    compared_ms: u8,
    /// Change of `sent` in a millisecond of a quick stop, digits.
    ramp_digits: i32,
    /// Largest change of the position in a millisecond, increments.
    jump_increments: u32,
    implausible: Option<Implausible>,
}

impl AxisState {
    fn new(axis: &Axis) -> Self {
        let increments = axis.increments_per_revolution.clamp(1, i32::MAX as u32) as i32;
        Self {
            config: *axis,
            increments_per_rad: axis.gear * f64::from(increments) / TAU,
            increments_per_revolution: increments,
            place: None,
            drive: None,
            raw: 0,
            position: 0,
            known: false,
            gap_ms: 0,
            step: 0,
            valid: false,
            status: StatusWord(0),
            state: StatusWord(0).state(),
            mode_in_effect: false,
            operational: false,
            plan_generation: 0,
            generation: 0,
            zero: None,
            reference_lost: false,
            commanded: false,
            feedback: FeedbackMonitor::new(axis, AxisMode::Velocity, 1.0),
            sent: 0,
            compared_ms: 0,
            ramp_digits: 0,
            jump_increments: (JUMP_SPEED * axis.output_max_rad_s.abs() * axis.gear.abs() * f64::from(increments)
                / TAU
                / 1_000.0) as u32,
            implausible: None,
        }
    }

    /// The turns are not known any more.
    fn lose_reference(&mut self) {
        self.reference_lost |= self.zero.is_some();
        self.zero = None;
    }

    fn is_moving(&self) -> bool {
        let rest = (REST_REVOLUTIONS_S * f64::from(self.increments_per_revolution) / 1000.0).max(1.0);
        f64::from(self.step.unsigned_abs()) > rest
    }

    /// Takes this cycle's input from the exchange.
    #[inline(always)]
    fn read(&mut self, exchange: &RobotExchange<'_>) {
        let place = self.place.as_ref();
        let input = place.and_then(|place| place.layout.decode(exchange.image(place.slave)?));
        self.step(input, self.plan_generation);
    }

    /// Takes this cycle's input, or the lack of one.
    #[inline(always)]
    fn step(&mut self, input: Option<DriveInput>, generation: u8) {
        if generation != self.generation {
            self.generation = generation;
            self.known = false;
            self.lose_reference();
        }
        let Some(input) = input else {
            self.miss();
            return;
        };
        if self.known {
            let difference = turned(input.position.wrapping_sub(self.raw), self.increments_per_revolution);
            self.position += i64::from(difference);
            let cycles = self.gap_ms.min(GAP_AT_REST_MAX_MS) as i32 + 1;
            self.step = difference / cycles;
            if self.compared_ms == 0 {
                self.look_for_jump();
            } else if !self.feedback.step(self.sent, difference) {
                self.distrust();
            }
        } else {
            self.position = i64::from(input.position);
            self.step = 0;
            self.known = true;
        }
        self.raw = input.position;
        self.gap_ms = 0;
        self.status = input.status;
        self.state = input.status.state();
        self.mode_in_effect = input.mode_in_effect;
        self.valid = true;
    }

    /// No input came in this cycle.
    #[cold]
    fn miss(&mut self) {
        self.gap_ms = self.gap_ms.saturating_add(1);
        let moving = self.is_moving() || self.commanded;
        if self.gap_ms > GAP_IN_MOTION_MAX_MS && moving || self.gap_ms > GAP_AT_REST_MAX_MS {
            self.lose_reference();
        }
        if self.compared_ms > 0 {
            self.feedback.step_blind(self.sent);
        }
        self.valid = false;
    }

    /// The feedback cannot be true: where the joint is, is not known any more.
    #[cold]
    fn distrust(&mut self) {
        self.implausible = Some(self.feedback.implausible());
        self.end_comparison();
        self.lose_reference();
    }

    /// A joint that nothing drives may be moved by hand, but no faster than its motor can.
    #[cold]
    fn look_for_jump(&mut self) {
        if self.step.unsigned_abs() > self.jump_increments {
            self.lose_reference();
        }
    }

    #[cold]
    fn end_comparison(&mut self) {
        (self.compared_ms, self.sent) = (0, 0);
        self.feedback.reset();
    }

    /// The drive follows no command: it brakes for a moment, then it stands by itself.
    #[cold]
    fn follow_ramp(&mut self) {
        let brakes = matches!(self.state, DriveState::OperationEnabled | DriveState::QuickStopActive);
        let ramps = self
            .drive
            .as_ref()
            .is_some_and(|drive| drive.mode == AxisMode::Velocity);
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
            position: Increments(self.position),
            angle_rad: self.angle_rad(self.position),
            status: self.status,
        })
    }

    /// The drive of this cycle's plan; without one the axis takes no demand.
    fn adopt(&mut self, share: Option<&DriveShare>) {
        // The slave is watched from when it has reached OP until it is seen elsewhere.
        self.operational = share.is_some_and(|share| share.watched);
        if let Some(share) = share {
            self.plan_generation = share.generation;
        }
        let role = share.and_then(|share| share.role);
        let same = match (&self.drive, &role) {
            (Some(scale), Some(role)) => core::ptr::eq(scale.kind, role.device) && scale.mode == role.layout.mode,
            (None, None) => true,
            _ => false,
        };
        if !same {
            self.drive = role.and_then(|role| Scale::new(&self.config, &role));
            self.end_comparison();
            if let Some(drive) = &self.drive {
                self.feedback = FeedbackMonitor::new(&self.config, drive.mode, drive.digits_per_unit);
                let ramp_rad_s2 = self.config.quick_stop_rad_s2.abs();
                self.ramp_digits = (ramp_rad_s2 * drive.digits_per_unit.abs() / 1_000.0) as i32;
            }
        }
    }

    /// The demand in digits, if the drive takes it, else 0.
    #[inline(always)]
    fn digits(&self, demand: Demand) -> i32 {
        let wanted = match (demand, &self.drive) {
            (Demand::Velocity(rad_s), Some(scale)) if scale.mode == AxisMode::Velocity => Some((rad_s, scale)),
            (Demand::Torque(nm), Some(scale)) if scale.mode == AxisMode::Torque => Some((nm, scale)),
            _ => None,
        };
        let Some((value, scale)) = wanted else { return 0 };
        let value = if value.abs() <= scale.limit {
            value
        } else if value.is_finite() {
            limited(value, scale.limit)
        } else {
            0.0
        };
        // To the nearest whole number; the conversion cuts off and saturates.
        let digits = value * scale.digits_per_unit;
        (digits + if digits < 0.0 { -0.5 } else { 0.5 }) as i32
    }

    /// Writes a command to the exchange's outputs.
    #[inline(always)]
    fn write(&mut self, exchange: &mut RobotExchange<'_>, command: &AxisCommand) {
        let output = self.output(command);
        if let Some(place) = &self.place {
            place.layout.encode(&output, exchange.output_at(place.outputs));
        }
    }

    #[inline(always)]
    fn output(&mut self, command: &AxisCommand) -> DriveOutput {
        let may_run = self.operational && self.mode_in_effect;
        let target = match command.target {
            // A drive that still moves brakes, any other one stays without power.
            DriveTarget::Enabled if !may_run => DriveTarget::QuickStop,
            target => target,
        };
        let running = self.state == DriveState::OperationEnabled && target == DriveTarget::Enabled;
        let demand_digits = if running { self.digits(command.demand) } else { 0 };
        self.commanded = demand_digits != 0;
        if running {
            (self.sent, self.compared_ms) = (demand_digits, RAMP_COMPARED_MS);
        } else if self.compared_ms > 0 {
            self.follow_ramp();
        }
        DriveOutput {
            demand_digits,
            position: self.raw,
            control: match running {
                true => cia402::ControlWord::ENABLE_OPERATION,
                false => cia402::step_from(self.state, target),
            },
        }
    }
}

/// The robot's axes on the bus.
#[derive(Clone, Debug)]
pub struct EtherCatRobot {
    axes: [AxisState; AXES],
    commands: [AxisCommand; AXES],
    /// Number of the plan to which the axes belong.
    plan: Option<u32>,
}

impl EtherCatRobot {
    /// A robot with the scaling of the configuration; not referenced.
    pub fn new(axes: &[Axis; AXES]) -> Self {
        Self {
            axes: axes.each_ref().map(AxisState::new),
            commands: [AxisCommand::default(); AXES],
            plan: None,
        }
    }

    /// Starts again with other axes, none of them referenced.
    pub fn configure(&mut self, axes: &[Axis; AXES]) {
        for (state, axis) in self.axes.iter_mut().zip(axes) {
            *state = AxisState::new(axis);
        }
        self.commands = [AxisCommand::default(); AXES];
        self.plan = None;
    }

    /// Takes this cycle's inputs; to be called exactly once a cycle, also when nothing came.
    pub fn read(&mut self, exchange: &RobotExchange<'_>) {
        self.follow_plan(exchange);
        for axis in &mut self.axes {
            axis.read(exchange);
        }
    }

    /// Looks whether the exchange has another plan; comes before [`Self::read_axis`].
    #[inline]
    pub fn follow_plan(&mut self, exchange: &RobotExchange<'_>) {
        if self.plan != Some(exchange.plan_number()) {
            self.adopt(exchange);
        }
    }

    /// Takes this cycle's input of one axis, as [`Self::read`] does of all; `None` when nothing came.
    #[inline(always)]
    pub fn read_axis<const AXIS: usize>(&mut self, exchange: &RobotExchange<'_>) -> Option<Reading> {
        const { assert!(AXIS < AXES) };
        let axis = &mut self.axes[AXIS];
        axis.read(exchange);
        axis.valid.then(|| Reading {
            increments: axis.position,
            angle_rad: (float(axis.position) - axis.zero.unwrap_or(0.0)) / axis.increments_per_rad,
            referenced: axis.zero.is_some(),
            status: axis.status,
        })
    }

    /// The drives of another plan.
    #[cold]
    fn adopt(&mut self, exchange: &RobotExchange<'_>) {
        self.plan = Some(exchange.plan_number());
        for (number, axis) in self.axes.iter_mut().enumerate() {
            let slave = exchange.member(number);
            let share = slave.and_then(|slave| exchange.plan().slaves.get(slave));
            axis.adopt(share);
            let role = share.and_then(|share| share.role);
            let length = share.map_or(0, |share| share.input_length);
            let whole = role.filter(|role| u16::from(role.layout.input_length) <= length);
            axis.place = slave.zip(whole).map(|(slave, role)| DrivePlace {
                slave,
                layout: role.layout,
                outputs: exchange.output_place(slave),
            });
        }
    }

    /// What the axes reported in this cycle.
    pub fn inputs(&self) -> [Option<AxisInput>; AXES] {
        self.axes.each_ref().map(AxisState::axis_input)
    }

    /// Whether all drives were in operation when they last reported.
    #[inline]
    pub fn is_in_operation(&self) -> bool {
        self.axes.iter().all(|axis| axis.state == DriveState::OperationEnabled)
    }

    /// State of an axis's drive when it last reported.
    #[inline]
    pub fn state(&self, axis: usize) -> DriveState {
        self.axes
            .get(axis)
            .map_or(DriveState::NotReadyToSwitchOn, |axis| axis.state)
    }

    /// Takes the present positions as the reference: each axis stands within half a motor turn of the pose `near`, or of
    /// its synchronisation mark, and its single-turn resolver tells the angle nearest to it.
    ///
    /// # Errors
    /// [`ReferenceError`]; then no axis is referenced: the reference from before is what was to be corrected.
    pub fn reference(&mut self, near: Option<&JointAngles>) -> Result<(), ReferenceError> {
        if let Some(error) = self.why_not_referenced() {
            self.axes.iter_mut().for_each(AxisState::lose_reference);
            return Err(error);
        }
        for (number, axis) in self.axes.iter_mut().enumerate() {
            let near_rad = near.and_then(|pose| pose.0.get(number).copied());
            let angle_rad = resolver_angle_rad(&axis.config, i64::from(axis.raw), near_rad);
            axis.zero = Some(float(axis.position) - angle_rad * axis.increments_per_rad);
            axis.reference_lost = false;
        }
        Ok(())
    }

    /// What keeps the present positions from being a reference.
    fn why_not_referenced(&self) -> Option<ReferenceError> {
        (0..).zip(&self.axes).find_map(|(number, axis)| match axis {
            _ if !axis.valid => Some(ReferenceError::NoPosition { axis: number }),
            _ if axis.is_moving() => Some(ReferenceError::Moving { axis: number }),
            _ => None,
        })
    }

    /// Whether all axes are referenced.
    pub fn is_referenced(&self) -> bool {
        self.axes.iter().all(|axis| axis.zero.is_some())
    }

    /// Which axes were referenced once and are not any more; cleared by [`Self::reference`].
    pub fn references_lost(&self) -> [bool; AXES] {
        self.axes.each_ref().map(|axis| axis.reference_lost)
    }

    /// The first axis whose feedback could not be true since this was last asked, and why.
    #[cold]
    pub fn take_implausible(&mut self) -> Option<(u8, Implausible)> {
        let mut found = None;
        for (number, axis) in (0..).zip(&mut self.axes) {
            let implausible = axis.implausible.take();
            found = found.or(implausible.map(|implausible| (number, implausible)));
        }
        found
    }

    /// What the comparisons of the axes' feedback have used of their limits, for each the most of any axis. For tests.
    pub fn feedback_used(&self) -> [f32; COMPARISONS.len()] {
        let each = self.axes.each_ref().map(|axis| axis.feedback.used());
        core::array::from_fn(|comparison| each.iter().fold(0.0, |most, used| f32::max(most, used[comparison])))
    }

    /// Tells the axes that take a torque what their references demand: which motion and which change of their load is no
    /// fault of the feedback.
    pub fn set_demanded(&mut self, demanded: &[Demanded; AXES]) {
        for (axis, demanded) in self.axes.iter_mut().zip(demanded) {
            axis.feedback.set_demanded(demanded);
        }
    }

    /// Writes the axes' commands to the outputs of the next output telegram.
    pub fn write(&mut self, exchange: &mut RobotExchange<'_>, commands: &[AxisCommand; AXES]) {
        for (axis, command) in self.axes.iter_mut().zip(commands) {
            axis.write(exchange, command);
        }
    }

    /// Writes the command of one axis, as [`Self::write`] does those of all.
    #[inline(always)]
    pub fn write_axis<const AXIS: usize>(&mut self, exchange: &mut RobotExchange<'_>, command: &AxisCommand) {
        const { assert!(AXIS < AXES) };
        self.axes[AXIS].write(exchange, command);
    }

    /// Writes the commands that were set through [`IoGroup::io`].
    pub fn write_group(&mut self, exchange: &mut RobotExchange<'_>) {
        let commands = self.commands;
        self.write(exchange, &commands);
    }
}

/// One axis of the group.
#[derive(Debug)]
pub struct AxisIo<'a> {
    axis: &'a AxisState,
    command: &'a mut AxisCommand,
}

impl VelocityIo for AxisIo<'_> {
    fn input(&self) -> Option<AxisInput> {
        self.axis.axis_input()
    }

    fn set_velocity(&mut self, target: DriveTarget, velocity_rad_s: f64) {
        let demand = Demand::Velocity(velocity_rad_s);
        *self.command = AxisCommand { target, demand };
    }
}

impl TorqueIo for AxisIo<'_> {
    fn input(&self) -> Option<AxisInput> {
        self.axis.axis_input()
    }

    fn set_torque(&mut self, target: DriveTarget, torque_nm: f64) {
        let demand = Demand::Torque(torque_nm);
        *self.command = AxisCommand { target, demand };
    }
}

impl IoGroup for EtherCatRobot {
    type Io<'a> = AxisIo<'a>;

    fn len(&self) -> usize {
        AXES
    }

    fn io(&mut self, member: usize) -> Option<AxisIo<'_>> {
        Some(AxisIo {
            axis: self.axes.get(member)?,
            command: self.commands.get_mut(member)?,
        })
    }
}

#[cfg(test)]
mod tests;
