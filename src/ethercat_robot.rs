//! Four drives on the bus as the four axes of a robot.
//!
//! Positions of single-turn resolvers are unwrapped into 64 bits and, once referenced, given as joint angles; commands
//! are turned from rad/s at the joint into the drives' digits.
//!
//! Invariants: a position is only given in the cycle it came in; a velocity never exceeds the axis's clamp and is 0
//! unless the drive is in operation and meant to stay there; an axis whose turns may have been miscounted, or whose
//! drive was configured anew, is not referenced any more.

use crate::config::Axis;
use crate::drives::cia402::{self, DriveState, DriveTarget, StatusWord};
use crate::drives::{DriveInput, DriveOutput};
use crate::ethercat::BusQueues;
use crate::ethercat::cyclic::Exchange;
use crate::ethercat::supervisor::Supervisor;
use crate::io::{AxisCommand, AxisInput, Increments, IoGroup, VelocityIo};
use crate::robot::AXES;
use core::f64::consts::TAU;

/// Most slaves on the robot's bus.
pub const BUS_SLAVES_MAX: usize = 16;
/// Longest mailbox window on the robot's bus, bytes: that of a Kollmorgen AKD.
pub const BUS_MESSAGE_BYTES: usize = 1024;
/// The queues of the robot's bus.
pub type RobotBusQueues = BusQueues<BUS_SLAVES_MAX, BUS_MESSAGE_BYTES>;
/// The exchange of the robot's bus.
pub type RobotExchange<'a> = Exchange<'a, BUS_SLAVES_MAX, BUS_MESSAGE_BYTES>;
/// The supervisor of the robot's bus.
pub type RobotSupervisor<'a> = Supervisor<'a, BUS_SLAVES_MAX, BUS_MESSAGE_BYTES>;

/// Longest gap of positions in motion after which the turns still count as known, ms: half a motor turn takes 10 ms at
/// full speed.
pub const GAP_IN_MOTION_MAX_MS: u32 = 8;
/// Longest gap of positions at rest after which the turns still count as known, ms.
pub const GAP_AT_REST_MAX_MS: u32 = 500;
/// Motor speed below which an axis is at rest, revolutions a second.
const REST_REVOLUTIONS_S: f64 = 0.05;

/// Why an axis could not be referenced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReferenceError {
    /// No position came in this cycle.
    NoPosition {
        /// Axis, from 0.
        axis: u8,
    },
    /// The axis moves.
    Moving {
        /// Axis, from 0.
        axis: u8,
    },
}

/// One axis: scaling, unwrapped position, reference.
#[derive(Clone, Copy, Debug)]
struct AxisState {
    increments_per_rad: f64,
    digits_per_rad_s: f64,
    increments_per_revolution: i64,
    velocity_max_rad_s: f64,
    sync_angle_rad: f64,
    sync_increments: i64,
    raw: i32,
    position: i64,
    known: bool,
    gap_ms: u32,
    step: i64,
    input: Option<(i64, StatusWord)>,
    status: StatusWord,
    generation: u8,
    /// Unwrapped position at joint angle 0.
    zero: Option<f64>,
    reference_lost: bool,
    commanded: bool,
}

impl AxisState {
    fn new(axis: &Axis) -> Self {
        let increments = f64::from(axis.increments_per_revolution.max(1));
        Self {
            increments_per_rad: axis.gear * increments / TAU,
            digits_per_rad_s: axis.gear * 60.0 / TAU * axis.digits_per_rpm,
            increments_per_revolution: i64::from(axis.increments_per_revolution.max(1)),
            velocity_max_rad_s: axis.output_max_rad_s.abs(),
            sync_angle_rad: axis.sync_angle_rad,
            sync_increments: i64::from(axis.sync_increments),
            raw: 0,
            position: 0,
            known: false,
            gap_ms: 0,
            step: 0,
            input: None,
            status: StatusWord(0),
            generation: 0,
            zero: None,
            reference_lost: false,
            commanded: false,
        }
    }

    /// The turns are not known any more.
    fn lose_reference(&mut self) {
        self.reference_lost |= self.zero.is_some();
        self.zero = None;
    }

    /// Wraps a difference of increments to the nearest within half a revolution.
    fn nearest(&self, difference: i64) -> i64 {
        let half = self.increments_per_revolution / 2;
        (difference + half).rem_euclid(self.increments_per_revolution) - half
    }

    fn is_moving(&self) -> bool {
        let rest = (REST_REVOLUTIONS_S * self.increments_per_revolution as f64 / 1000.0).max(1.0);
        self.step.unsigned_abs() as f64 > rest
    }

    /// Takes this cycle's input, or the lack of one.
    fn step(&mut self, input: Option<DriveInput>, generation: u8) {
        if generation != self.generation {
            self.generation = generation;
            self.known = false;
            self.lose_reference();
        }
        let Some(input) = input else {
            self.gap_ms = self.gap_ms.saturating_add(1);
            let moving = self.is_moving() || self.commanded;
            if self.gap_ms > GAP_IN_MOTION_MAX_MS && moving || self.gap_ms > GAP_AT_REST_MAX_MS {
                self.lose_reference();
            }
            self.input = None;
            return;
        };
        if self.known {
            let difference = self.nearest(i64::from(input.position.wrapping_sub(self.raw)));
            self.position += difference;
            self.step = difference / (i64::from(self.gap_ms) + 1);
        } else {
            self.position = i64::from(input.position);
            self.step = 0;
            self.known = true;
        }
        self.raw = input.position;
        self.gap_ms = 0;
        self.status = input.status;
        self.input = Some((self.position, input.status));
    }

    fn angle_rad(&self, position: i64) -> Option<f64> {
        self.zero.map(|zero| (position as f64 - zero) / self.increments_per_rad)
    }

    fn axis_input(&self) -> Option<AxisInput> {
        let (position, status) = self.input?;
        Some(AxisInput {
            position: Increments(position),
            angle_rad: self.angle_rad(position),
            status,
        })
    }

    fn output(&mut self, command: &AxisCommand) -> DriveOutput {
        let running = self.status.state() == DriveState::OperationEnabled && command.target == DriveTarget::Enabled;
        let wanted_rad_s = if running && command.velocity_rad_s.is_finite() {
            command.velocity_rad_s
        } else {
            0.0
        };
        let velocity_rad_s = wanted_rad_s.clamp(-self.velocity_max_rad_s, self.velocity_max_rad_s);
        self.commanded = velocity_rad_s != 0.0;
        DriveOutput {
            // The conversion saturates.
            velocity_digits: libm::round(velocity_rad_s * self.digits_per_rad_s) as i32,
            control: cia402::step(self.status, command.target),
        }
    }
}

/// The robot's axes on the bus.
#[derive(Clone, Debug)]
pub struct EtherCatRobot {
    axes: [AxisState; AXES],
    commands: [AxisCommand; AXES],
}

impl EtherCatRobot {
    /// A robot with the scaling of the configuration; not referenced.
    pub fn new(axes: &[Axis; AXES]) -> Self {
        Self {
            axes: axes.each_ref().map(AxisState::new),
            commands: [AxisCommand::default(); AXES],
        }
    }

    /// Takes this cycle's inputs; to be called exactly once a cycle, also when nothing came.
    pub fn read(&mut self, exchange: &RobotExchange<'_>) -> [Option<AxisInput>; AXES] {
        for (number, axis) in self.axes.iter_mut().enumerate() {
            let drive = exchange.drive(number);
            let input = drive.and_then(|(slave, kind)| (kind.description().decode)(exchange.input(slave)?));
            let generation = drive
                .and_then(|(slave, _)| exchange.plan().slaves.get(slave))
                .map_or(axis.generation, |slave| slave.generation);
            axis.step(input, generation);
        }
        self.axes.each_ref().map(AxisState::axis_input)
    }

    /// Takes the present positions as the reference: each axis stands within half a motor turn of its synchronisation
    /// mark, and its single-turn resolver tells the angle nearest to the mark's.
    ///
    /// # Errors
    /// [`ReferenceError`]; then nothing has changed.
    pub fn reference(&mut self) -> Result<(), ReferenceError> {
        for (number, axis) in (0..).zip(&self.axes) {
            if axis.input.is_none() {
                return Err(ReferenceError::NoPosition { axis: number });
            }
            if axis.is_moving() {
                return Err(ReferenceError::Moving { axis: number });
            }
        }
        for axis in &mut self.axes {
            let off_mark = axis.nearest(i64::from(axis.raw) - axis.sync_increments);
            let at_mark = (axis.position - off_mark) as f64;
            axis.zero = Some(at_mark - axis.sync_angle_rad * axis.increments_per_rad);
            axis.reference_lost = false;
        }
        Ok(())
    }

    /// Whether all axes are referenced.
    pub fn is_referenced(&self) -> bool {
        self.axes.iter().all(|axis| axis.zero.is_some())
    }

    /// Which axes were referenced once and are not any more; cleared by [`Self::reference`].
    pub fn references_lost(&self) -> [bool; AXES] {
        self.axes.each_ref().map(|axis| axis.reference_lost)
    }

    /// Joint angle of a motor position, rad; `None` until referenced.
    pub fn angle_rad(&self, axis: usize, position: Increments) -> Option<f64> {
        self.axes.get(axis)?.angle_rad(position.0)
    }

    /// Writes the axes' commands to the outputs of the next output telegram.
    pub fn write(&mut self, exchange: &mut RobotExchange<'_>, commands: &[AxisCommand; AXES]) {
        for (number, (axis, command)) in self.axes.iter_mut().zip(commands).enumerate() {
            let output = axis.output(command);
            if let Some((slave, kind)) = exchange.drive(number) {
                (kind.description().encode)(&output, exchange.output(slave));
            }
        }
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

    fn set_velocity(&mut self, command: AxisCommand) {
        *self.command = command;
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
mod tests {
    use super::*;

    const TURN: i32 = 1 << 20;

    fn axis() -> AxisState {
        let axis = Axis {
            sync_angle_rad: -0.5,
            sync_increments: 1000,
            ..Axis::default()
        };
        AxisState::new(&axis)
    }

    fn at(position: i32) -> Option<DriveInput> {
        Some(DriveInput {
            position,
            status: StatusWord(0x0637),
        })
    }

    fn robot(positions: [i32; AXES]) -> EtherCatRobot {
        let mut robot = EtherCatRobot::new(
            &[Axis {
                sync_increments: 1000,
                ..Axis::default()
            }; AXES],
        );
        for (axis, position) in robot.axes.iter_mut().zip(positions) {
            axis.step(at(position), 0);
        }
        robot
    }

    #[test]
    fn turns_are_counted_both_ways_for_single_turn_and_for_counting_encoders() {
        let (mut wrapping, mut counting) = (axis(), axis());
        let mut truth = 5_i64;
        for cycle in 0..400_i64 {
            truth += if cycle < 150 { 90_000 } else { -110_000 };
            wrapping.step(at(truth.rem_euclid(i64::from(TURN)) as i32), 0);
            counting.step(at((truth + i64::from(i32::MAX)) as i32), 0);
            if cycle == 0 {
                assert_eq!(wrapping.position, truth);
            }
        }
        assert_eq!(wrapping.position, truth);
        assert_eq!(counting.position, truth + i64::from(i32::MAX) - (1 << 32));
    }

    #[test]
    fn the_resolver_gives_the_angle_nearest_to_the_mark() {
        // A quarter turn of the motor beyond the mark, seen across the end of the turn and four turns up.
        for position in [1000 + TURN / 4, 1000 + TURN / 4 + 4 * TURN, 1000 + TURN / 4 - TURN] {
            let mut robot = robot([position; AXES]);
            assert!(!robot.is_referenced());
            assert_eq!(robot.reference(), Ok(()));
            let angle_rad = robot.axes[0].axis_input().unwrap().angle_rad.unwrap();
            let expected_rad = Axis::default().sync_angle_rad + TAU / 4.0 / 12.0;
            assert!((angle_rad - expected_rad).abs() < 1e-9, "{angle_rad}");
        }
        let mut robot = robot([1000 - TURN / 4; AXES]);
        assert_eq!(robot.reference(), Ok(()));
        assert!(robot.axes[3].axis_input().unwrap().angle_rad.unwrap() < Axis::default().sync_angle_rad);
    }

    #[test]
    fn a_moving_or_silent_axis_is_not_referenced() {
        let mut moving = robot([0; AXES]);
        moving.axes[2].step(at(5_000), 0);
        assert_eq!(moving.reference(), Err(ReferenceError::Moving { axis: 2 }));
        let mut silent = robot([0; AXES]);
        silent.axes[1].step(None, 0);
        assert_eq!(silent.reference(), Err(ReferenceError::NoPosition { axis: 1 }));
        assert!(!silent.is_referenced());
    }

    #[test]
    fn a_gap_in_motion_costs_the_reference_after_8_ms_and_at_rest_after_half_a_second() {
        for (speed, survived_ms) in [(50_000, GAP_IN_MOTION_MAX_MS), (0, GAP_AT_REST_MAX_MS)] {
            for (gap_ms, kept) in [(survived_ms, true), (survived_ms + 1, false)] {
                let mut robot = robot([0; AXES]);
                robot.reference().unwrap();
                robot.axes[1].step(at(speed), 0);
                (0..gap_ms).for_each(|_| robot.axes[1].step(None, 0));
                assert_eq!(robot.axes[1].axis_input(), None);
                robot.axes[1].step(at(speed), 0);
                assert_eq!(robot.is_referenced(), kept, "{speed} increments/ms, {gap_ms} ms");
                assert_eq!(robot.references_lost(), [false, !kept, false, false]);
            }
        }
    }

    #[test]
    fn a_drive_that_was_configured_anew_is_not_referenced() {
        let mut robot = robot([0; AXES]);
        robot.reference().unwrap();
        robot.axes[0].step(at(0), 1);
        assert_eq!(robot.references_lost(), [true, false, false, false]);
        assert!(robot.axes[0].axis_input().unwrap().angle_rad.is_none());
    }

    #[test]
    fn velocities_are_scaled_clamped_and_zero_unless_in_operation() {
        let mut axis = axis();
        let command = |velocity_rad_s| AxisCommand {
            target: DriveTarget::Enabled,
            velocity_rad_s,
        };
        assert_eq!(axis.output(&command(1.0)).velocity_digits, 0);
        axis.step(at(0), 0);
        // 1 rad/s at the joint is 12 rad/s, 114.59 rpm, at the motor.
        assert_eq!(axis.output(&command(1.0)).velocity_digits, 16_021);
        assert_eq!(axis.output(&command(-1.0)).velocity_digits, -16_021);
        let clamped = axis.output(&command(1.0e9)).velocity_digits;
        assert_eq!(
            clamped,
            axis.output(&command(Axis::default().output_max_rad_s)).velocity_digits
        );
        assert_eq!(axis.output(&command(f64::NAN)).velocity_digits, 0);
        let stop = AxisCommand {
            target: DriveTarget::QuickStop,
            velocity_rad_s: 1.0,
        };
        let output = axis.output(&stop);
        assert_eq!(
            (output.velocity_digits, output.control),
            (0, cia402::ControlWord::QUICK_STOP)
        );
    }

    #[test]
    fn a_motor_that_turns_the_other_way_is_turned_back() {
        let mut axis = AxisState::new(&Axis {
            gear: -12.0,
            ..Axis::default()
        });
        axis.step(at(0), 0);
        axis.zero = Some(0.0);
        let command = AxisCommand {
            target: DriveTarget::Enabled,
            velocity_rad_s: 1.0,
        };
        assert!(axis.output(&command).velocity_digits < 0);
        axis.step(at(-1000), 0);
        assert!(axis.axis_input().unwrap().angle_rad.unwrap() > 0.0);
    }
}
