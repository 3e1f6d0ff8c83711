//! The robot sampler: one millisecond of input, control and output.
//!
//! `sample` sends the input telegram, `bus_frame` takes its reply, steps the controllers and sends the output
//! telegram in the same millisecond, `bus_deadline` does the same on predicted positions when the reply has not come.
//! The three run at one priority and never pre-empt each other; everything that comes from or goes to the slower
//! tasks passes through lock-free queues.
//!
//! When inputs and outputs are exchanged together, there is no output telegram: the outputs go with the next input
//! telegram.
//!
//! Invariants: every released millisecond sends the outputs exactly once when the bus is configured; a drive gets
//! a velocity other than zero only while it follows references of the epoch it was told; the first fault makes every
//! following output a quick stop until the fault is cleared.

use crate::application::{Fault, Power};
use crate::board::Interlock;
use crate::config::{Axis, AxisMode, Bus, Transport};
use crate::control::limited;
use crate::control::position::PositionController;
use crate::control::supervision::{Observation, Supervision};
use crate::control::velocity::VelocityController;
use crate::drives::cia402::{DriveState, DriveTarget, StatusWord};
use crate::ethercat::clock::steering::{ClockReading, ClockSteering};
use crate::ethercat::cyclic::{AlStatus, Arrival, BusCounters, ExchangeKind};
use crate::ethercat::envelope::Envelope;
use crate::ethercat::transport::raw::{RawTransport, Sending};
use crate::ethercat_robot::{EtherCatRobot, RobotExchange};
use crate::io::{AxisCommand, AxisInput, Demand, Increments};
use crate::motion::Reference;
use crate::network::NetworkEnd;
use crate::queue;
use crate::robot::{AXES, JointAngles};
use embassy_net_driver::Driver;
use heapless::spsc::{Consumer, Producer};

/// Length of the sample period, ns.
pub const PERIOD_NS: u32 = 1_000_000;
/// The telegram with the outputs counts as late when it is not with the MAC this long after the release, ns.
pub const OUTPUT_LATE_NS: u32 = 500_000;
/// Frames taken in one run of `bus_frame`, so that foreign traffic cannot keep the critical tasks busy.
pub const FRAMES_PER_RUN: usize = 8;
/// Samples between two releases of the trajectory task.
pub const TRAJECTORY_PERIOD: u32 = crate::motion::PERIOD_MS as u32;
/// References the sampler looks ahead, for the feed-forward that is read ahead of time.
pub const LOOK_AHEAD: usize = 12;
/// Speed below which an axis stands still, rad/s.
pub const STANDSTILL_RAD_S: f64 = 0.01;
/// How long an axis must be below [`STANDSTILL_RAD_S`], ms.
pub const STANDSTILL_MS: u16 = 20;

/// A reference on its way to the sampler, with the start it belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Queued {
    /// The start ([`crate::application::Action::Place`]) this reference belongs to.
    pub epoch: u8,
    /// The reference.
    pub reference: Reference,
}

/// What the slower side asks of the sampler.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // a handful, in static memory
pub enum SamplerCommand {
    /// Use these axes and bus limits.
    Configure {
        /// The axes.
        axes: [Axis; AXES],
        /// The bus.
        bus: Bus,
    },
    /// Power of the drives.
    Power(Power),
    /// Take the resolvers' present angles as the reference, on the turns nearest to a pose, or to the marks.
    TakeReference {
        /// The pose.
        near: Option<JointAngles>,
    },
    /// Follow the references of this start.
    Follow {
        /// Number of the start.
        epoch: u8,
    },
    /// Forget the latched fault.
    ClearFault,
}

/// What the sampler has counted since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SamplerCounters {
    /// Released samples.
    pub cycles: u32,
    /// Output telegrams later than [`OUTPUT_LATE_NS`], or not sent at all.
    pub cycles_late: u32,
    /// Milliseconds without a reference while following.
    pub underruns: u32,
    /// Reports that found no room in their queue.
    pub reports_dropped: u32,
}

/// One millisecond as the sampler saw it.
#[derive(Clone, Copy, Debug)]
pub struct CycleReport {
    /// Number of the millisecond.
    pub cycle: u32,
    /// The reference that was followed.
    pub reference: Reference,
    /// Whether a reference was followed.
    pub following: bool,
    /// Measured or predicted joint positions, rad.
    pub measured_rad: [f64; AXES],
    /// Measured joint velocities, rad/s.
    pub measured_rad_s: [f64; AXES],
    /// Velocity commands after the clamp, rad/s.
    pub output_rad_s: [f64; AXES],
    /// Status words of the drives.
    pub status_word: [u16; AXES],
    /// Whether each axis delivered a valid position.
    pub valid: [bool; AXES],
    /// What the drives' encoders show, increments since an unknown turn; `None` where nothing came.
    pub increments: [Option<i64>; AXES],
    /// Whether each axis is referenced.
    pub referenced: [bool; AXES],
    /// Whether all axes stand still.
    pub standstill: bool,
    /// AL states OR-ed and number of slaves, when the broadcast came back.
    pub al: Option<AlStatus>,
    /// Phase of the sample against the bus clock, ns, positive when it came too late; `None` without a clock.
    pub clock_error_ns: Option<i32>,
    /// The latched fault.
    pub fault: Option<Fault>,
    /// What on the board keeps the drives in quick stop.
    pub interlock: Option<Interlock>,
    /// The sampler's counters.
    pub counters: SamplerCounters,
    /// The bus' counters.
    pub bus: BusCounters,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Waiting for the reply to the input telegram.
    Input,
    /// The output telegram of this millisecond has been sent.
    Done,
}

/// The critical tasks' state.
pub struct Sampler<'a> {
    exchange: RobotExchange<'a>,
    network: NetworkEnd<'a>,
    /// Whether the addresses of EtherCAT in UDP are known.
    has_path: bool,
    robot: EtherCatRobot,
    axes: [Axis; AXES],
    bus: Bus,
    controllers: [PositionController; AXES],
    velocity_controllers: [VelocityController; AXES],
    supervision: Supervision,
    commands: Consumer<'a, SamplerCommand>,
    references: Consumer<'a, Queued>,
    reports: Producer<'a, CycleReport>,
    phase: Phase,
    power: Power,
    epoch: Option<u8>,
    window: heapless::Deque<Reference, LOOK_AHEAD>,
    reference: Reference,
    inputs: [Option<AxisInput>; AXES],
    status: [StatusWord; AXES],
    was_enabled: [bool; AXES],
    referenced: [bool; AXES],
    reference_lost: [bool; AXES],
    measured_rad: [f64; AXES],
    measured_rad_s: [f64; AXES],
    still_ms: u16,
    late: u16,
    missed: u32,
    /// Station of the reference clock that the timer follows.
    clock: Option<u16>,
    steering: ClockSteering,
    released_late_ns: u32,
    timer_correction_ns: i32,
    /// Whether the telegram that began this cycle was late or not sent.
    first_late: bool,
    interlock: Option<Interlock>,
    counters: SamplerCounters,
}

impl<'a> Sampler<'a> {
    /// A sampler that has no configuration yet and keeps the drives without power.
    pub fn new(
        exchange: RobotExchange<'a>,
        network: NetworkEnd<'a>,
        commands: Consumer<'a, SamplerCommand>,
        references: Consumer<'a, Queued>,
        reports: Producer<'a, CycleReport>,
    ) -> Self {
        let axes = [Axis::default(); AXES];
        Self {
            exchange,
            network,
            has_path: false,
            robot: EtherCatRobot::new(&axes),
            axes,
            bus: Bus::default(),
            controllers: axes.map(|axis| PositionController::new(&axis)),
            velocity_controllers: axes.map(|axis| VelocityController::new(&axis)),
            supervision: Supervision::new(),
            commands,
            references,
            reports,
            phase: Phase::Done,
            power: Power::Off,
            epoch: None,
            window: heapless::Deque::new(),
            reference: Reference::default(),
            inputs: [None; AXES],
            status: [StatusWord(0); AXES],
            was_enabled: [false; AXES],
            referenced: [false; AXES],
            reference_lost: [false; AXES],
            measured_rad: [0.0; AXES],
            measured_rad_s: [0.0; AXES],
            still_ms: 0,
            late: 0,
            missed: 0,
            clock: None,
            steering: ClockSteering::new(),
            released_late_ns: 0,
            timer_correction_ns: 0,
            first_late: false,
            interlock: None,
            counters: SamplerCounters::default(),
        }
    }

    /// Releases a millisecond: sends the input telegram. `elapsed_ns` is the time since the nominal release, and
    /// `missed` counts the milliseconds since the start in which no sample could be released.
    ///
    /// Returns whether the trajectory task is to be released.
    pub fn sample<D: Driver>(&mut self, transport: &mut RawTransport<D>, elapsed_ns: u32, missed: u32) -> bool {
        if self.phase == Phase::Input {
            // Neither the reply nor the deadline came in the last millisecond.
            self.finish(transport, PERIOD_NS.saturating_add(elapsed_ns));
        }
        self.counters.cycles = self.counters.cycles.wrapping_add(1);
        let newly_missed = missed.wrapping_sub(self.missed);
        self.missed = missed;
        self.released_late_ns = elapsed_ns;
        self.counters.cycles_late = self.counters.cycles_late.wrapping_add(newly_missed);
        self.late = self
            .late
            .saturating_add(u16::try_from(newly_missed).unwrap_or(u16::MAX));
        self.take_commands();
        self.take_path();
        let telegram = self.exchange.input_telegram();
        let sending = match may_send(&self.bus, self.has_path) {
            true => transport.send(telegram),
            false => Sending::Nothing,
        };
        self.first_late = elapsed_ns > OUTPUT_LATE_NS || sending == Sending::Busy;
        self.phase = Phase::Input;
        self.counters.cycles.is_multiple_of(TRAJECTORY_PERIOD)
    }

    /// Takes frames the MAC has received, at most [`FRAMES_PER_RUN`]; the input reply leads to the output telegram.
    ///
    /// Returns whether more may be waiting: then this is to be called again, after what is as urgent.
    pub fn bus_frame<D: Driver>(&mut self, transport: &mut RawTransport<D>, elapsed_ns: u32) -> bool {
        for _ in 0..FRAMES_PER_RUN {
            let over_ip = self.bus.transport == Transport::Udp;
            let Some(arrival) = transport.receive(|frame| {
                let passed_on = over_ip && self.network.offer(frame);
                (!passed_on).then(|| self.exchange.receive(frame))
            }) else {
                return false;
            };
            if arrival == Some(Arrival::Input) && self.phase == Phase::Input {
                self.finish(transport, elapsed_ns);
            }
        }
        true
    }

    /// The input reply is overdue: predicts, steps and sends the output telegram.
    pub fn bus_deadline<D: Driver>(&mut self, transport: &mut RawTransport<D>, elapsed_ns: u32) {
        if self.phase == Phase::Input {
            self.finish(transport, elapsed_ns);
        }
    }

    /// Whether the reply to this millisecond's input telegram is still to come, and the output telegram to be sent.
    pub fn awaits_input(&self) -> bool {
        self.phase == Phase::Input
    }

    /// What on the board keeps the drives in quick stop from this millisecond on; to be told before [`Self::sample`].
    pub fn set_interlock(&mut self, interlock: Option<Interlock>) {
        self.interlock = interlock;
    }

    /// Whether foreign frames have no business on the wire: EtherCAT has it for itself.
    pub fn has_the_wire_alone(&self) -> bool {
        self.bus.transport == Transport::Raw
    }

    /// The firmware ends: one last telegram tells drives that have power to stop, velocities zero. Nothing may follow.
    pub fn say_last_word<D: Driver>(&mut self, transport: &mut RawTransport<D>) {
        let target = match self.power {
            Power::On | Power::QuickStop => DriveTarget::QuickStop,
            Power::Off | Power::FaultReset => DriveTarget::Off,
        };
        let demand = Demand::Velocity(0.0);
        self.robot
            .write(&mut self.exchange, &[AxisCommand { target, demand }; AXES]);
        let telegram = match self.exchange.plan().exchange {
            ExchangeKind::Split => self.exchange.output_telegram(),
            ExchangeKind::Combined => self.exchange.input_telegram(),
        };
        if may_send(&self.bus, self.has_path) {
            // A port without room has frames to send that are as good as this one.
            let _ = transport.send(telegram);
        }
    }

    /// What the exchange with the bus has counted so far; the telegrams of this millisecond are not settled yet.
    pub fn bus_counters(&self) -> BusCounters {
        self.exchange.counters()
    }

    fn finish<D: Driver>(&mut self, transport: &mut RawTransport<D>, elapsed_ns: u32) {
        self.phase = Phase::Done;
        self.inputs = self.robot.read(&self.exchange);
        self.steer();
        self.measure();
        let (following, underrun) = self.next_reference();
        let output_rad_s = self.control(following);
        self.supervise(following, underrun, &output_rad_s);
        self.write(following, &output_rad_s);
        let telegram = self.exchange.output_telegram();
        let sending = match may_send(&self.bus, self.has_path) {
            true => transport.send(telegram),
            false => Sending::Nothing,
        };
        self.network.send_next(|frame| {
            // A frame that the port does not take is lost, as on any network.
            let _ = transport.send(frame);
        });
        let late = match self.exchange.plan().exchange {
            ExchangeKind::Split => elapsed_ns > OUTPUT_LATE_NS || sending == Sending::Busy,
            // The outputs before these went with the input telegram; these are in time for the next one.
            ExchangeKind::Combined => self.first_late || elapsed_ns >= PERIOD_NS,
        };
        self.late = u16::from(late);
        self.counters.cycles_late = self.counters.cycles_late.wrapping_add(u32::from(late));
        self.report(following, output_rad_s);
    }

    /// Takes what the IP stack has found out. Without addresses nothing is sent, which the bus' other side takes for
    /// silence, and the supervision too.
    fn take_path(&mut self) {
        while let Some(path) = self.network.next_path() {
            self.has_path = path.is_some();
            self.exchange.set_envelope(path.map_or(Envelope::Raw, Envelope::Udp));
        }
    }

    /// By how much the timer's next period is to be longer, ns (negative: shorter), so that the sample keeps its phase to
    /// the bus clock; to be asked for once a millisecond, at most
    /// [`CORRECTION_MAX_NS`](crate::ethercat::clock::steering::CORRECTION_MAX_NS) either way.
    pub fn take_timer_correction_ns(&mut self) -> i32 {
        core::mem::take(&mut self.timer_correction_ns)
    }

    /// Takes this cycle's time of the bus clock. A plan with another reference begins anew.
    fn steer(&mut self) {
        let clock = self.exchange.plan().clock.map(|clock| clock.station);
        if clock != self.clock {
            self.clock = clock;
            self.steering = ClockSteering::new();
        }
        if self.clock.is_some() {
            self.timer_correction_ns = self.steering.step(ClockReading {
                // The low half is enough for a phase, and all that narrow clocks have.
                reference_ns: self.exchange.clock_ns().map(|time_ns| time_ns as u32),
                elapsed_ns: self.released_late_ns,
            });
        }
    }

    fn take_commands(&mut self) {
        while let Some(command) = queue::take(&mut self.commands) {
            match command {
                SamplerCommand::Configure { axes, bus } => {
                    self.robot = EtherCatRobot::new(&axes);
                    self.controllers = axes.map(|axis| PositionController::new(&axis));
                    self.velocity_controllers = axes.map(|axis| VelocityController::new(&axis));
                    (self.axes, self.bus) = (axes, bus);
                }
                SamplerCommand::Power(power) => {
                    self.power = power;
                    if power != Power::On {
                        self.epoch = None;
                    }
                }
                SamplerCommand::TakeReference { near } => {
                    self.epoch = None;
                    // A refusal leaves the axes unreferenced, which the operating modes wait for in vain and report.
                    let _ = self.robot.reference(near.as_ref());
                }
                SamplerCommand::Follow { epoch } => {
                    self.epoch = Some(epoch);
                    self.window.clear();
                }
                SamplerCommand::ClearFault => self.supervision.clear(),
            }
        }
    }

    /// Turns the inputs into joint angles and velocities; a missing one is predicted from the last velocity. Counts how
    /// long all axes stand still.
    fn measure(&mut self) {
        let mut still = true;
        for axis in 0..AXES {
            let before_rad = self.measured_rad[axis];
            let Some(input) = self.inputs[axis] else {
                self.measured_rad[axis] = before_rad + self.measured_rad_s[axis] / CYCLES_PER_S;
                // Silence is no standstill: the last speed that was seen decides.
                still &= self.measured_rad_s[axis].abs() < STANDSTILL_RAD_S;
                continue;
            };
            self.status[axis] = input.status;
            let angle_rad = input
                .angle_rad
                .unwrap_or_else(|| unreferenced_angle_rad(&self.axes[axis], input.position));
            let same_zero = self.referenced[axis] == input.angle_rad.is_some();
            self.measured_rad_s[axis] = if same_zero {
                (angle_rad - before_rad) * CYCLES_PER_S
            } else {
                0.0
            };
            self.measured_rad[axis] = angle_rad;
            self.reference_lost[axis] = self.referenced[axis] && input.angle_rad.is_none();
            self.referenced[axis] = input.angle_rad.is_some();
            still &= self.measured_rad_s[axis].abs() < STANDSTILL_RAD_S;
        }
        self.still_ms = if still { self.still_ms.saturating_add(1) } else { 0 };
    }

    /// Advances to this millisecond's reference: whether one is followed, and whether one was missing.
    fn next_reference(&mut self) -> (bool, bool) {
        let Some(epoch) = self.epoch else {
            self.window.clear();
            return (false, false);
        };
        let was_following = !self.window.is_empty();
        self.window.pop_front();
        while !self.window.is_full() {
            let Some(queued) = queue::take(&mut self.references) else {
                break;
            };
            if queued.epoch == epoch {
                // There is room: the loop's condition.
                let _ = self.window.push_back(queued.reference);
            }
        }
        match self.window.front() {
            Some(reference) => {
                self.reference = *reference;
                (true, false)
            }
            None => (false, was_following),
        }
    }

    fn control(&mut self, following: bool) -> [f64; AXES] {
        let mut output_rad_s = [0.0; AXES];
        for (axis, output) in output_rad_s.iter_mut().enumerate() {
            let controller = &mut self.controllers[axis];
            let (reference_rad, measured_rad) = (self.reference.position_rad[axis], self.measured_rad[axis]);
            if following {
                *output = match self.axes[axis].mode {
                    AxisMode::Velocity => {
                        let ahead = self.window.iter().map(|reference| at(&reference.velocity_rad_s, axis));
                        controller.step(reference_rad, measured_rad, ahead)
                    }
                    AxisMode::Torque => controller.step_for_torque(reference_rad, measured_rad),
                };
            } else {
                controller.reset();
            }
        }
        output_rad_s
    }

    fn supervise(&mut self, following: bool, underrun: bool, output_rad_s: &[f64; AXES]) {
        self.counters.underruns = self.counters.underruns.wrapping_add(u32::from(underrun));
        let mut seen = Observation {
            valid: [false; AXES],
            following_error_rad: [0.0; AXES],
            output_rad_s: *output_rad_s,
            status_word: [0; AXES],
            drive_fault: [false; AXES],
            reference_lost: [false; AXES],
            al_status: self.exchange.al_status().map(|al| al.status as u8),
            clock: self.steering.fault(u32::from(self.bus.clock_error_max_us) * 1_000),
            power: self.power == Power::On,
            following: following || underrun,
            underrun,
            late: self.late,
            interlock: self.interlock,
        };
        for axis in 0..AXES {
            let status = self.status[axis];
            seen.valid[axis] = self.inputs[axis].is_some();
            seen.status_word[axis] = status.0;
            if following {
                seen.following_error_rad[axis] = self.controllers[axis].reference_at_age() - self.measured_rad[axis];
            }
            seen.reference_lost[axis] = self.reference_lost[axis];
            seen.drive_fault[axis] = seen.valid[axis] && (status.is_fault() || self.gave_up(axis));
        }
        self.supervision.step(&self.axes, &self.bus, &seen);
    }

    fn write(&mut self, following: bool, output_rad_s: &[f64; AXES]) {
        let target = match (self.supervision.fault(), self.power) {
            (_, Power::Off) => DriveTarget::Off,
            (_, Power::FaultReset) => DriveTarget::FaultReset,
            (Some(_), _) | (None, Power::QuickStop) => DriveTarget::QuickStop,
            (None, Power::On) => DriveTarget::Enabled,
        };
        let moving = following && target == DriveTarget::Enabled && self.powered();
        let commands = core::array::from_fn(|axis| {
            let velocity_rad_s = if moving { output_rad_s[axis] } else { 0.0 };
            let demand = match self.axes[axis].mode {
                AxisMode::Velocity => Demand::Velocity(velocity_rad_s),
                AxisMode::Torque => Demand::Torque(self.torque_nm(axis, velocity_rad_s, target, moving)),
            };
            AxisCommand { target, demand }
        });
        self.robot.write(&mut self.exchange, &commands);
    }

    /// The torque that leads an axis to a velocity, N m at the joint; an enabled axis that does not move is held.
    fn torque_nm(&mut self, axis: usize, velocity_rad_s: f64, target: DriveTarget, moving: bool) -> f64 {
        let Some(controller) = self.velocity_controllers.get_mut(axis) else {
            return 0.0;
        };
        if target != DriveTarget::Enabled || self.status[axis].state() != DriveState::OperationEnabled {
            controller.reset();
            return 0.0;
        }
        let limit_rad_s = self.axes[axis].output_max_rad_s.abs();
        let wanted_rad_s = limited(velocity_rad_s, limit_rad_s);
        let references = if moving { self.window.len() } else { 0 };
        let ahead = self
            .window
            .iter()
            .take(references)
            .map(|reference| at(&reference.velocity_rad_s, axis));
        controller.step(wanted_rad_s, self.measured_rad_s[axis], ahead)
    }

    fn powered(&self) -> bool {
        self.status
            .iter()
            .all(|status| status.state() == DriveState::OperationEnabled)
    }

    /// Whether a drive that was in operation has left it although it is to stay there.
    fn gave_up(&mut self, axis: usize) -> bool {
        let enabled = self.status[axis].state() == DriveState::OperationEnabled;
        let wanted = self.power == Power::On;
        let gave_up = wanted && self.was_enabled[axis] && !enabled;
        self.was_enabled[axis] = wanted && (enabled || self.was_enabled[axis]);
        gave_up
    }

    fn report(&mut self, following: bool, output_rad_s: [f64; AXES]) {
        let report = CycleReport {
            cycle: self.counters.cycles,
            reference: self.reference,
            following,
            measured_rad: self.measured_rad,
            measured_rad_s: self.measured_rad_s,
            output_rad_s,
            status_word: self.status.map(|status| status.0),
            valid: self.inputs.map(|input| input.is_some()),
            increments: self.inputs.map(|input| input.map(|input| input.position.0)),
            referenced: self.referenced,
            standstill: self.still_ms >= STANDSTILL_MS,
            al: self.exchange.al_status(),
            clock_error_ns: self.clock.map(|_| self.steering.error_ns()),
            fault: self.supervision.fault(),
            interlock: self.interlock,
            counters: self.counters,
            bus: self.exchange.counters(),
        };
        if queue::put(&mut self.reports, report).is_err() {
            self.counters.reports_dropped = self.counters.reports_dropped.wrapping_add(1);
        }
    }
}

/// Whether telegrams may leave: EtherCAT in UDP needs addresses first.
fn may_send(bus: &Bus, has_path: bool) -> bool {
    bus.transport == Transport::Raw || has_path
}

/// An axis's value, looked up without a panic where the compiler does not know the axis's range.
fn at(values: &[f64; AXES], axis: usize) -> f64 {
    values.get(axis).copied().unwrap_or(0.0)
}

/// Joint angle from where the unwrapping began, rad: good for differences before there is a reference.
fn unreferenced_angle_rad(axis: &Axis, position: Increments) -> f64 {
    let increments_per_rad = axis.gear * f64::from(axis.increments_per_revolution) / core::f64::consts::TAU;
    position.0 as f64 / increments_per_rad
}

/// Samples in a second.
const CYCLES_PER_S: f64 = 1.0e9 / PERIOD_NS as f64;

const _: () = assert!(OUTPUT_LATE_NS < PERIOD_NS);
