//! A servo drive: CiA 402 state machine, modes of operation, brake, resolver and the motor behind it.
//!
//! Position and speed are updated every millisecond, control and status word every second one, as in the real drive.
//! The motor only moves under the velocity or torque loop (operation enabled), on a ramp (quick stop, fault reaction)
//! or against the closed brake (all other states).

pub(crate) mod history;
pub(crate) mod homing;
pub(crate) mod motor;
mod options;
pub(crate) mod position_loop;
pub(crate) mod position_units;
pub(crate) mod probe;
pub(crate) mod resolver;
pub(crate) mod servo;
pub(crate) mod velocity_loop;

pub use options::{DriveOptions, OneTurn};

use homing::{Homing, Marks, Switch};
use motor::{Action, Motor};
use position_loop::PositionLoop;
use position_units::PositionUnits;
use probe::Probes;
use resolver::{Resolver, ResolverFault};
use std::collections::VecDeque;
use std::f64::consts::TAU;
use velocity_loop::{Regulator, VelocityLoop};

/// AX2000: digital speed.
pub(crate) const MODE_DIGITAL_SPEED: i8 = -2;
/// AX2000: digital current.
pub(crate) const MODE_DIGITAL_CURRENT: i8 = -3;
/// CiA 402: homing.
pub(crate) const MODE_HOMING: i8 = 6;
/// CiA 402: cyclic synchronous position.
pub(crate) const MODE_CYCLIC_POSITION: i8 = 8;
/// CiA 402: cyclic synchronous velocity.
pub(crate) const MODE_CYCLIC_VELOCITY: i8 = 9;
/// CiA 402: cyclic synchronous torque.
pub(crate) const MODE_CYCLIC_TORQUE: i8 = 10;
/// Rated torque of the motor, mN m; object 0x6076 of a CiA 402 drive.
pub(crate) const RATED_TORQUE_MNM: u32 = 2_800;
/// Peak torque of the motor, N m: 12 A at 0.7 N m/A.
const PEAK_TORQUE_NM: f64 = 8.4;
/// Digits of an AX2000 at peak current.
const PEAK_CURRENT_DIGITS: f64 = 3_280.0;
/// Error code for the loss of cyclic data.
const ERROR_CYCLIC_DATA_LOST: u16 = 0x8130;
/// Error code of an encoder that cannot be true.
const ERROR_ENCODER: u16 = 0x7305;
/// Error code for a following error above its window.
const ERROR_FOLLOWING: u16 = 0x8611;

/// Highest possible speed of the motor, revolutions per minute.
const SPEED_MAX_RPM: f64 = 6000.0;
/// Speed of the encoder, relative to that, beyond which the position loop does not believe it.
const ENCODER_SPEED_SHARE: f64 = 1.5;

const CONTROL_SWITCH_ON: u16 = 0x0001;
const CONTROL_ENABLE_VOLTAGE: u16 = 0x0002;
const CONTROL_NO_QUICK_STOP: u16 = 0x0004;
const CONTROL_ENABLE_OPERATION: u16 = 0x0008;
/// In homing mode.
const CONTROL_START: u16 = 0x0010;
const CONTROL_FAULT_RESET: u16 = 0x0080;

const STATUS_VOLTAGE: u16 = 0x0010;
const STATUS_REMOTE: u16 = 0x0200;
/// In cyclic synchronous position: the drive follows the targets; the following error is above its window.
const STATUS_FOLLOWS: u16 = 0x1000;
const STATUS_FOLLOWING_ERROR: u16 = 0x2000;

/// State of the drive as CiA 402 names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveState {
    /// No torque; the main voltage may be off.
    SwitchOnDisabled,
    /// No torque; the main voltage may be switched on.
    ReadyToSwitchOn,
    /// Main voltage on, no torque.
    SwitchedOn,
    /// The motor follows its command.
    OperationEnabled,
    /// Ramping down on request.
    QuickStopActive,
    /// Ramping down after a fault.
    FaultReactionActive,
    /// At rest after a fault.
    Fault,
}

impl DriveState {
    /// Whether the power stage moves or holds the motor.
    #[must_use]
    pub fn has_power(self) -> bool {
        matches!(
            self,
            Self::OperationEnabled | Self::QuickStopActive | Self::FaultReactionActive
        )
    }

    fn status_bits(self) -> u16 {
        match self {
            Self::SwitchOnDisabled => 0x0040,
            Self::ReadyToSwitchOn => 0x0021,
            Self::SwitchedOn => 0x0023,
            Self::OperationEnabled => 0x0027,
            Self::QuickStopActive => 0x0007,
            Self::FaultReactionActive => 0x000F,
            Self::Fault => 0x0008,
        }
    }
}

/// Scaling of the drive's objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Profile {
    /// Current in digits, position within one motor turn.
    Ax2000,
    /// Torque in 1/1000 of the rated torque, position over all turns.
    Cia402,
}

/// Demand from the fieldbus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Demand {
    /// Velocity in digits of object 0x606B or 0x60FF.
    pub(crate) velocity_digits: i32,
    /// Torque in digits of object 0x6074 or 0x6071.
    pub(crate) torque_digits: i16,
    /// Position, increments; `None` holds the present one.
    pub(crate) position: Option<i32>,
    /// Velocity added to that of the position loop, digits of object 0x60FF. Without one, the drive takes the speed of the
    /// target position.
    pub(crate) velocity_offset: Option<i32>,
    /// Control word.
    pub(crate) control: u16,
    /// Whether no new outputs arrived in this millisecond.
    pub(crate) is_missed: bool,
}

/// One drive with its motor.
#[derive(Clone, Debug)]
pub(crate) struct Drive {
    options: DriveOptions,
    profile: Profile,
    motor: Motor,
    state: DriveState,
    /// Requested and active mode of operation.
    pub(crate) mode: i8,
    pub(crate) mode_display: i8,
    /// Quick-stop deceleration, position increments per second squared at the motor.
    pub(crate) quick_stop_increments_s2: u32,
    control: u16,
    /// Whether the last control word took the power of the motor.
    is_switched_off: bool,
    status: u16,
    error_code: u16,
    second_millisecond: bool,
    mains: bool,
    resolver: Resolver,
    pub(crate) position_loop: PositionLoop,
    /// Units of the positions on the bus, in a drive that has objects for them.
    pub(crate) units: PositionUnits,
    pub(crate) homing: Homing,
    pub(crate) probes: Probes,
    /// Whether and how the position counts one motor turn only.
    one_turn: Option<OneTurn>,
    /// Position at the motor's mark since the last homing, less the configured one, increments.
    home_shift: i64,
    emergencies: VecDeque<u16>,
}

impl Drive {
    /// A drive at rest; the seed is that of its resolver's noise and of the phases of its error.
    pub(crate) fn new(options: &DriveOptions, noise_seed: u64) -> Self {
        let regulator = match options.velocity_loop {
            VelocityLoop::Lag => None,
            VelocityLoop::Pi(options) => Some(Regulator::new(&options, PEAK_TORQUE_NM)),
        };
        let motor = Motor::new(options.angle_rad, options.bandwidth_hz)
            .with_friction(options.friction_rad_s)
            .with_regulator(regulator);
        let mut drive = Self {
            options: options.clone(),
            profile: Profile::Ax2000,
            motor,
            state: DriveState::SwitchOnDisabled,
            mode: 0,
            mode_display: 0,
            quick_stop_increments_s2: 0,
            control: 0,
            is_switched_off: false,
            status: 0,
            error_code: 0,
            second_millisecond: false,
            mains: true,
            resolver: Resolver::new(0.0, noise_seed),
            position_loop: PositionLoop::new(options.increments_per_revolution),
            units: PositionUnits::default(),
            homing: Homing::new(options.increments_per_revolution),
            one_turn: None,
            home_shift: 0,
            probes: Probes::default(),
            emergencies: VecDeque::new(),
        };
        drive.resolver = Resolver::new(options.noise_increments / drive.increments_per_rad(), noise_seed)
            .with_error(options.resolver_error, noise_seed);
        drive.power_up();
        drive
    }

    /// This drive with the given scaling of its objects.
    pub(crate) fn with_profile(self, profile: Profile) -> Self {
        Self { profile, ..self }
    }

    /// Makes a CiA 402 drive count one motor turn only.
    pub(crate) fn count_one_turn(&mut self, one_turn: OneTurn) {
        if self.profile == Profile::Cia402 {
            self.one_turn = Some(one_turn);
            self.position_loop.wrap_at(self.options.increments_per_revolution);
        }
    }

    /// First and last position, object 0x607B; `None` if the drive does not have it.
    pub(crate) fn position_range(&self) -> Option<(i32, i32)> {
        match self.one_turn {
            None => Some((i32::MIN, i32::MAX)),
            Some(OneTurn::Told) => Some((0, self.options.increments_per_revolution.saturating_sub(1) as i32)),
            Some(OneTurn::Untold) => None,
        }
    }

    /// A position of the encoder in the units of the bus.
    pub(crate) fn in_units(&self, increments: i32) -> i32 {
        self.units.shown(increments, self.options.increments_per_revolution)
    }

    /// The encoder's increments for a position in the units of the bus.
    pub(crate) fn increments_of(&self, position: i32) -> i32 {
        self.units.increments(position, self.options.increments_per_revolution)
    }

    /// Resets everything but the motor to its state after power-up.
    pub(crate) fn power_up(&mut self) {
        self.state = DriveState::SwitchOnDisabled;
        self.mode = 0;
        self.mode_display = 0;
        self.quick_stop_increments_s2 = (self.options.quick_stop_rad_s2 * self.increments_per_rad()) as u32;
        self.control = 0;
        self.is_switched_off = false;
        self.error_code = 0;
        self.position_loop = PositionLoop::new(self.options.increments_per_revolution);
        self.one_turn
            .into_iter()
            .for_each(|one_turn| self.count_one_turn(one_turn));
        self.units = PositionUnits::default();
        self.homing = Homing::new(self.options.increments_per_revolution);
        self.home_shift = 0;
        self.probes = Probes::default();
        self.emergencies.clear();
        self.status = self.state.status_bits();
    }

    /// CiA 402 state.
    pub(crate) fn state(&self) -> DriveState {
        self.state
    }

    /// Status word, object 0x6041.
    pub(crate) fn status(&self) -> u16 {
        self.status
    }

    /// Control word in effect, object 0x6040.
    pub(crate) fn control(&self) -> u16 {
        self.control
    }

    /// Whether the last control word took the power of the motor, in the one or two milliseconds behind it.
    pub(crate) fn is_switched_off(&self) -> bool {
        self.is_switched_off
    }

    /// Error code of the present fault, object 0x603F; 0 without a fault.
    pub(crate) fn error_code(&self) -> u16 {
        self.error_code
    }

    /// The motor.
    pub(crate) fn motor(&self) -> &Motor {
        &self.motor
    }

    /// The motor, for the load that moves it.
    pub(crate) fn motor_mut(&mut self) -> &mut Motor {
        &mut self.motor
    }

    /// Whether the load decides how the motor moves: the drive only controls its torque.
    pub(crate) fn is_moved_by_load(&self) -> bool {
        let torque_mode = self.state == DriveState::OperationEnabled
            && matches!(self.mode_display, MODE_DIGITAL_CURRENT | MODE_CYCLIC_TORQUE);
        torque_mode || self.motor.is_regulated()
    }

    /// True torque of the motor, N m.
    pub(crate) fn true_torque_nm(&self) -> f64 {
        self.motor.torque_nm() * self.options.torque_scale
    }

    /// Advances a PI velocity loop, if it acts, by one of its steps.
    pub(crate) fn regulate(&mut self) {
        let share = self.resolver.speed_share(self.motor.angle_rad());
        self.motor.regulate(self.motor.speed_rad_s() * share);
    }

    /// Position in the drive's scaling, increments: within one motor turn, or over all turns.
    pub(crate) fn position(&self) -> i32 {
        self.position_at(self.resolved(self.resolver.shown_rad(self.motor.angle_rad())))
    }

    /// Speed in digits of the velocity demand.
    pub(crate) fn velocity_digits(&self) -> i32 {
        (self.motor.speed_rad_s() * self.digits_per_rad_s()).round() as i32
    }

    /// Torque in digits of the torque demand.
    pub(crate) fn torque_digits(&self) -> i16 {
        ((self.motor.torque_nm() + self.options.torque_offset_nm) / self.torque_nm_per_digit()).round() as i16
    }

    /// The next emergency: an error code, 0 when the error has ended.
    pub(crate) fn take_emergency(&mut self) -> Option<u16> {
        self.emergencies.pop_front()
    }

    /// Sets a resolver fault for some milliseconds.
    pub(crate) fn set_resolver_fault(&mut self, fault: ResolverFault, milliseconds: u64) {
        self.resolver.set_fault(fault, milliseconds, self.motor.angle_rad());
    }

    /// Makes the resolver slip on its shaft by this many increments, permanently.
    pub(crate) fn slip(&mut self, increments: i32) {
        self.resolver.slip(f64::from(increments) / self.increments_per_rad());
    }

    /// Makes the resolver show another motor's shaft, rad since that motor's mark, or its own again.
    pub(crate) fn show_foreign(&mut self, foreign_rad: Option<f64>) {
        self.resolver.show_foreign(foreign_rad);
    }

    /// Switches the main voltage; without it an enabled drive faults.
    pub(crate) fn set_mains(&mut self, on: bool) {
        self.mains = on;
        if !on && self.obeys() {
            self.fault(0x3220);
        }
    }

    /// Triggers a fault with this error code.
    pub(crate) fn fault(&mut self, error_code: u16) {
        if matches!(self.state, DriveState::Fault | DriveState::FaultReactionActive) {
            return;
        }
        self.error_code = error_code;
        self.emergencies.push_back(error_code);
        self.state = DriveState::FaultReactionActive;
    }

    /// Handles the loss of cyclic data: a switched-on drive goes into fault, with its emergency ramp.
    pub(crate) fn cyclic_data_lost(&mut self) {
        match self.state {
            DriveState::SwitchOnDisabled | DriveState::Fault | DriveState::FaultReactionActive => {}
            _ => self.fault(ERROR_CYCLIC_DATA_LOST),
        }
    }

    /// Advances by one millisecond with the processor stopped: the current loop keeps the motor at its last demand.
    pub(crate) fn coast(&mut self, demand: Demand) {
        let action = self.action(demand);
        self.motor.step(action);
        self.resolver
            .step(self.motor.angle_rad(), 1.0 / self.increments_per_rad());
    }

    /// Advances by one millisecond; no demand means that the fieldbus is not in OP.
    pub(crate) fn step(&mut self, demand: Option<Demand>) {
        self.second_millisecond = !self.second_millisecond;
        if self.second_millisecond {
            self.mode_display = self.mode;
            self.obey(demand.map(|demand| demand.control));
        }
        let action = self.action(demand.unwrap_or_default());
        self.motor.step(action);
        self.resolver
            .step(self.motor.angle_rad(), 1.0 / self.increments_per_rad());
        let marks = self.marks();
        self.probes.step(self.motor.angle_rad() * marks.per_rad, &marks);
        if self.motor.is_still() {
            self.state = match self.state {
                DriveState::QuickStopActive => DriveState::SwitchOnDisabled,
                DriveState::FaultReactionActive => DriveState::Fault,
                state => state,
            };
        }
        if self.second_millisecond {
            let voltage = if self.mains { STATUS_VOLTAGE } else { 0 };
            let remote = if demand.is_some() { STATUS_REMOTE } else { 0 };
            self.status = self.state.status_bits() | voltage | remote | self.following_bits();
        }
    }

    /// The action on the motor in this millisecond.
    fn action(&mut self, demand: Demand) -> Action {
        let in_position_mode = self.mode_display == MODE_CYCLIC_POSITION;
        if !(in_position_mode && self.state == DriveState::OperationEnabled) {
            self.position_loop.stop();
        }
        if !(self.mode_display == MODE_HOMING && self.state == DriveState::OperationEnabled) {
            self.homing.leave();
        }
        match self.state {
            DriveState::OperationEnabled => match self.mode_display {
                MODE_DIGITAL_SPEED | MODE_CYCLIC_VELOCITY => self.speed(demand.velocity_digits),
                MODE_DIGITAL_CURRENT | MODE_CYCLIC_TORQUE => {
                    let torque_nm = f64::from(demand.torque_digits) * self.torque_nm_per_digit();
                    Action::Torque(torque_nm.clamp(-PEAK_TORQUE_NM, PEAK_TORQUE_NM))
                }
                MODE_CYCLIC_POSITION => self.follow(&demand),
                MODE_HOMING => self.home(demand.control),
                _ => self.speed(0),
            },
            DriveState::QuickStopActive | DriveState::FaultReactionActive => self.ramp(),
            _ => Action::Brake(self.options.brake_rad_s2),
        }
    }

    /// The speed of a search for the home position; its end gives the position another origin.
    fn home(&mut self, control: u16) -> Action {
        let marks = self.marks();
        let at = self.motor.angle_rad() * marks.per_rad;
        let (speed, found) = self.homing.step(control & CONTROL_START != 0, at, &marks);
        if let Some(home) = found {
            let shown = home + f64::from(self.options.zero_increments);
            self.home_shift = i64::from(self.homing.offset) - shown.floor() as i64;
        }
        Self::limited_speed(speed / marks.per_rad)
    }

    fn marks(&self) -> Marks {
        Marks {
            per_rad: self.increments_per_rad(),
            turn: f64::from(self.options.increments_per_revolution.max(1)),
            switches: self.options.switches,
        }
    }

    /// Position that a touch probe has stored, objects 0x60BA to 0x60BD, from 0.
    pub(crate) fn probed(&self, number: usize) -> i32 {
        let place = self.probes.stored.get(number).copied().unwrap_or(0.0);
        self.position_at(place / self.increments_per_rad())
    }

    /// Digital inputs, object 0x60FD: limit switches and home switch.
    pub(crate) fn digital_inputs(&self) -> u32 {
        let marks = self.marks();
        let at = self.motor.angle_rad() * marks.per_rad;
        let bit = |number: u32, switch| u32::from(marks.is_active(switch, at)) << number;
        bit(0, Switch::Negative) | bit(1, Switch::Positive) | bit(2, Switch::Home)
    }

    fn ramp(&self) -> Action {
        Action::Ramp(f64::from(self.quick_stop_increments_s2) / self.increments_per_rad())
    }

    /// The speed of the position loop: proportional to the error that the drive's own encoder shows, with feed-forward.
    fn follow(&mut self, demand: &Demand) -> Action {
        let target = demand.position.filter(|_| !demand.is_missed);
        let speed_max_rad_s = ENCODER_SPEED_SHARE * SPEED_MAX_RPM / 60.0 * TAU;
        let moved_max = speed_max_rad_s * self.increments_per_rad() * motor::STEP_S;
        let Some(step) = self.position_loop.step(target, self.position(), moved_max) else {
            self.fault(ERROR_ENCODER);
            return self.ramp();
        };
        if self.position_loop.has_tripped() {
            self.fault(ERROR_FOLLOWING);
            return self.ramp();
        }
        let forward_rad_s = match demand.velocity_offset {
            Some(digits) => f64::from(digits) / self.digits_per_rad_s(),
            None => step.rate / motor::STEP_S / self.increments_per_rad(),
        };
        let correction_rad_s = step.error / self.increments_per_rad() * self.options.position_gain_per_s;
        Self::limited_speed(correction_rad_s + forward_rad_s)
    }

    /// Bits of the status word in cyclic synchronous position and in homing.
    fn following_bits(&self) -> u16 {
        match (self.position_loop.follows(), self.position_loop.is_outside()) {
            (false, _) if self.mode_display == MODE_HOMING => self.homing.status_bits(),
            (false, _) => 0,
            (true, false) => STATUS_FOLLOWS,
            (true, true) => STATUS_FOLLOWS | STATUS_FOLLOWING_ERROR,
        }
    }

    fn speed(&self, digits: i32) -> Action {
        Self::limited_speed(f64::from(digits) / self.digits_per_rad_s())
    }

    fn limited_speed(speed_rad_s: f64) -> Action {
        let speed_max_rad_s = SPEED_MAX_RPM / 60.0 * TAU;
        Action::Speed(speed_rad_s.max(-speed_max_rad_s).min(speed_max_rad_s))
    }

    fn obey(&mut self, control: Option<u16>) {
        self.is_switched_off = false;
        let Some(control) = control else {
            self.control = 0;
            self.state = match self.state {
                DriveState::OperationEnabled => DriveState::QuickStopActive,
                DriveState::ReadyToSwitchOn | DriveState::SwitchedOn => DriveState::SwitchOnDisabled,
                state => state,
            };
            return;
        };
        let reset = control & !self.control & CONTROL_FAULT_RESET != 0;
        self.control = control;
        if self.state == DriveState::Fault {
            if reset {
                self.error_code = 0;
                self.emergencies.push_back(0);
                self.state = DriveState::SwitchOnDisabled;
            }
            return;
        }
        let had_power = self.state.has_power();
        self.state = self.next_state(control);
        self.is_switched_off = had_power && !self.state.has_power();
    }

    fn next_state(&self, control: u16) -> DriveState {
        use DriveState as S;
        let has = |bit| control & bit != 0;
        let state = self.state;
        if matches!(state, S::Fault | S::FaultReactionActive) {
            return state;
        }
        if !has(CONTROL_ENABLE_VOLTAGE) {
            return S::SwitchOnDisabled;
        }
        if !has(CONTROL_NO_QUICK_STOP) {
            return match state {
                S::OperationEnabled | S::QuickStopActive => S::QuickStopActive,
                _ => S::SwitchOnDisabled,
            };
        }
        match (state, has(CONTROL_SWITCH_ON), has(CONTROL_ENABLE_OPERATION)) {
            (S::QuickStopActive, ..) => S::QuickStopActive,
            (S::SwitchOnDisabled, false, _) if self.mains => S::ReadyToSwitchOn,
            (S::SwitchOnDisabled, ..) => S::SwitchOnDisabled,
            (_, false, _) => S::ReadyToSwitchOn,
            (S::ReadyToSwitchOn, true, _) | (_, true, false) => S::SwitchedOn,
            (_, true, true) => S::OperationEnabled,
        }
    }

    fn obeys(&self) -> bool {
        matches!(self.state, DriveState::OperationEnabled | DriveState::QuickStopActive)
    }

    /// Velocity digits for one rad/s at the motor.
    fn digits_per_rad_s(&self) -> f64 {
        self.options.digits_per_rpm * 60.0 / TAU
    }

    fn increments_per_rad(&self) -> f64 {
        f64::from(self.options.increments_per_revolution.max(1)) / TAU
    }

    /// Torque at the motor for one digit of the torque demand, N m.
    fn torque_nm_per_digit(&self) -> f64 {
        match self.profile {
            Profile::Ax2000 => PEAK_TORQUE_NM / PEAK_CURRENT_DIGITS,
            Profile::Cia402 => f64::from(RATED_TORQUE_MNM) * 1e-6,
        }
    }

    /// The lowest angle that the resolver does not distinguish from this one, rad.
    fn resolved(&self, shaft_rad: f64) -> f64 {
        let steps = 1_u64.checked_shl(self.options.resolver_bits).unwrap_or(0);
        if steps <= 1 || steps >= u64::from(self.options.increments_per_revolution) {
            return shaft_rad;
        }
        let step_rad = TAU / steps as f64;
        // Half an increment keeps rounding errors away from the boundary between two increments.
        (shaft_rad / step_rad).floor() * step_rad + 0.5 / self.increments_per_rad()
    }

    /// The position for a shaft angle since its mark.
    fn position_at(&self, shaft_rad: f64) -> i32 {
        let increments = f64::from(self.options.increments_per_revolution.max(1));
        let turn = shaft_rad * self.increments_per_rad() + f64::from(self.options.zero_increments);
        match self.profile {
            Profile::Ax2000 => turn.floor().rem_euclid(increments) as i32,
            Profile::Cia402 => {
                let counted = (turn.floor() as i64).wrapping_add(self.home_shift);
                match self.one_turn {
                    Some(_) => counted.rem_euclid(increments as i64) as i32,
                    None => counted as i32,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
