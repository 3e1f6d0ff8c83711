//! The robot sampler: one millisecond of input, control and output.
//!
//! `sample` sends the input telegram, `bus_frame` takes its reply, steps the controllers and sends the output telegram
//! in the same millisecond, `bus_deadline` does this with predicted positions if the reply has not arrived. The three
//! run at one priority and never pre-empt each other; everything that comes from or goes to the slower tasks passes
//! through lock-free queues.
//!
//! When inputs and outputs are exchanged together, there is no output telegram: the outputs go with the next input
//! telegram.
//!
//! Invariants: every released millisecond sends the outputs exactly once when the bus is configured; a drive gets a
//! velocity other than zero, or another target position, only while it follows setpoints of the selected epoch; the first
//! fault makes every following output a quick stop until the fault is cleared, at once or, after late cycles, when the robot
//! has braked on its path.

mod absent;
mod searching;
mod stopping;

use crate::application::{Fault, Power};
use crate::board::Interlock;
use crate::config::{Axis, AxisMode, Bus, Transport, command_delay_ms};
pub use crate::control::cycle::{CycleReport, Queued, SamplerCommand, SamplerCounters};
use crate::control::feedback::COMPARISONS;
use crate::control::io::Io;
use crate::control::limit::limited;
use crate::control::path_stop::PathStop;
use crate::control::pen_switch::PenSwitch;
use crate::control::position::PositionController;
use crate::control::rest::Rest;
pub use crate::control::rest::STANDSTILL_MS;
use crate::control::robot_axes::{AxisCommand, Demand, PositionDemand, RobotAxes};
use crate::control::search::Search;
use crate::control::supervision::{Observation, Supervision};
use crate::control::tool::{ToolOutput, ToolValue};
use crate::control::torque_feedback::Demanded;
use crate::control::velocity::VelocityController;
use crate::control::window::Window;
use crate::drives::cia402::{DriveState, DriveTarget};
use crate::drives::io::{IoGroup, IoTrigger};
use crate::ethercat::clock::steering::{ClockReading, ClockSteering};
use crate::ethercat::cyclic::{Arrival, BusCounters, ExchangeKind};
use crate::ethercat::encapsulation::Encapsulation;
use crate::ethercat::frame_port::{FramePort, Sending};
use crate::ethercat::queue;
use crate::motion::Pen;
use crate::network::NetworkEnd;
pub use crate::robot_bus::PERIOD_NS;
use crate::robot_bus::RobotGroup;
use crate::robots::AXES;
use embassy_net_driver::Driver;
use heapless::spsc::{Consumer, Producer};

/// The telegram with the outputs counts as late when it is not with the MAC this long after the release, ns.
pub const OUTPUT_LATE_NS: u32 = 500_000;
/// Frames taken in one run of `bus_frame`, so that foreign traffic cannot keep the critical tasks busy.
pub const FRAMES_PER_RUN: usize = 8;
/// Samples between two releases of the trajectory task.
pub const TRAJECTORY_PERIOD: u32 = crate::motion::PERIOD_MS as u32;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Waiting for the reply to the input telegram.
    Input,
    /// The output telegram of this millisecond has been sent.
    Done,
}

/// The critical tasks' state.
pub struct Sampler<'a, G = RobotGroup<'a>> {
    group: G,
    network: NetworkEnd<'a>,
    /// Whether the addresses of EtherCAT in UDP are known.
    has_path: bool,
    robot: RobotAxes,
    axes: [Axis; AXES],
    /// Number of axes that have drives: the first ones.
    used: usize,
    bus: Bus,
    controllers: [PositionController; AXES],
    velocity_controllers: [VelocityController; AXES],
    has_torque_axis: bool,
    /// Demands of this millisecond on the axes in position mode.
    positions: [PositionDemand; AXES],
    supervision: Supervision,
    commands: Consumer<'a, SamplerCommand>,
    setpoints: Consumer<'a, Queued>,
    reports: Producer<'a, CycleReport>,
    phase: Phase,
    power: Power,
    epoch: Option<u8>,
    window: Window,
    /// The search for the switches that is under way.
    search: Option<Search>,
    /// The stop on the path that is under way.
    path_stop: PathStop,
    /// Report of this millisecond, filled step by step; measured values are kept from one millisecond to the next.
    now: CycleReport,
    was_enabled: [bool; AXES],
    home_lost: [bool; AXES],
    /// Whether an axis's last and next angle count from the same zero.
    same_zero: [bool; AXES],
    rest: [Rest; AXES],
    still_ms: u16,
    late: u16,
    missed: u32,
    /// Station of the reference clock that the timer follows.
    clock: Option<u16>,
    /// Number of the time to which the steering belongs.
    time_number: Option<u8>,
    steering: ClockSteering,
    released_late_ns: u32,
    timer_correction_ns: i32,
    /// Whether the telegram that began this cycle was late or not sent.
    first_late: bool,
    interlock: Option<Interlock>,
    io: Io,
    pen: PenSwitch,
    tool: ToolOutput,
    /// Whether the bus has terminals whose failure is no fault.
    spares_terminals: bool,
    counters: SamplerCounters,
}

impl<'a, G: IoTrigger + IoGroup> Sampler<'a, G> {
    /// A sampler that has no configuration yet and keeps the drives without power.
    pub fn new(
        group: G,
        network: NetworkEnd<'a>,
        commands: Consumer<'a, SamplerCommand>,
        setpoints: Consumer<'a, Queued>,
        reports: Producer<'a, CycleReport>,
    ) -> Self {
        let axes = [Axis::default(); AXES];
        Self {
            group,
            network,
            has_path: false,
            robot: RobotAxes::new(&axes, AXES),
            axes,
            used: AXES,
            bus: Bus::default(),
            controllers: axes.map(|axis| PositionController::new(&axis)),
            velocity_controllers: axes.map(|axis| VelocityController::new(&axis)),
            has_torque_axis: false,
            positions: [PositionDemand::default(); AXES],
            supervision: Supervision::new(),
            commands,
            setpoints,
            reports,
            phase: Phase::Done,
            power: Power::Off,
            epoch: None,
            window: Window::new(),
            search: None,
            path_stop: PathStop::new(),
            now: CycleReport::default(),
            was_enabled: [false; AXES],
            home_lost: [false; AXES],
            same_zero: [false; AXES],
            rest: [Rest::UNKNOWN; AXES],
            still_ms: 0,
            late: 0,
            missed: 0,
            clock: None,
            time_number: None,
            steering: ClockSteering::new(PERIOD_NS),
            released_late_ns: 0,
            timer_correction_ns: 0,
            first_late: false,
            interlock: None,
            io: Io::new(),
            pen: PenSwitch::default(),
            tool: ToolOutput::default(),
            spares_terminals: false,
            counters: SamplerCounters::default(),
        }
    }

    /// Releases a millisecond: sends the input telegram. `elapsed_ns` is the time since the nominal release, and
    /// `missed` counts the milliseconds since the start in which no sample could be released.
    ///
    /// Returns whether the trajectory task is to be released.
    pub fn sample<D: Driver>(&mut self, transport: &mut FramePort<D>, elapsed_ns: u32, missed: u32) -> bool {
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
        if self.commands.ready() {
            self.take_commands();
        }
        if self.network.has_path_news() {
            self.take_path();
        }
        let telegram = self.group.trigger_input();
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
    /// Returns whether more may be waiting: call it again then, after the other tasks of this priority.
    pub fn bus_frame<D: Driver>(&mut self, transport: &mut FramePort<D>, elapsed_ns: u32) -> bool {
        let over_ip = self.bus.transport == Transport::Udp;
        for _ in 0..FRAMES_PER_RUN {
            let Some(arrival) = transport.receive(|frame| {
                let passed_on = over_ip && self.network.offer(frame);
                (!passed_on).then(|| self.group.arrived(frame))
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
    pub fn bus_deadline<D: Driver>(&mut self, transport: &mut FramePort<D>, elapsed_ns: u32) {
        if self.phase == Phase::Input {
            self.finish(transport, elapsed_ns);
        }
    }

    /// Whether the reply to this millisecond's input telegram is outstanding, and the output telegram has not been
    /// sent.
    pub fn awaits_input(&self) -> bool {
        self.phase == Phase::Input
    }

    /// Sets the board input that keeps the drives in quick stop from this millisecond on. Call it before
    /// [`Self::sample`].
    pub fn set_interlock(&mut self, interlock: Option<Interlock>) {
        self.interlock = interlock;
    }

    /// Whether the wire is for EtherCAT alone, so that foreign frames may be dropped.
    pub fn has_the_wire_alone(&self) -> bool {
        self.bus.transport == Transport::Raw
    }

    /// Sends one last telegram when the firmware ends: quick stop for drives that have power, velocities zero. Nothing
    /// may follow.
    pub fn send_final_telegram<D: Driver>(&mut self, transport: &mut FramePort<D>) {
        let target = match self.power {
            Power::On | Power::QuickStop | Power::PathStop => DriveTarget::QuickStop,
            Power::Off | Power::FaultReset => DriveTarget::Off,
        };
        let demand = Demand::Velocity(0.0);
        self.robot
            .write(&mut self.group, &[AxisCommand { target, demand }; AXES]);
        self.io.write(&mut self.group, true, false, self.tool.off());
        let telegram = match self.group.exchange_kind() {
            ExchangeKind::Split => self.group.trigger_output(),
            ExchangeKind::Combined => self.group.trigger_input(),
        };
        if may_send(&self.bus, self.has_path) {
            // A port without room is still sending earlier telegrams; the drives' watchdogs are the guarantee.
            let _ = transport.send(telegram);
        }
    }

    /// Counters of the exchange with the bus; the telegrams of this millisecond are not settled yet.
    pub fn bus_counters(&self) -> BusCounters {
        self.group.counters()
    }

    /// Largest value of each feedback comparison in this millisecond, relative to its limit, in the order of
    /// [`COMPARISONS`]. For tests; no board calls it.
    pub fn feedback_used(&self) -> [f32; COMPARISONS.len()] {
        self.robot.feedback_used()
    }

    fn finish<D: Driver>(&mut self, transport: &mut FramePort<D>, elapsed_ns: u32) {
        self.phase = Phase::Done;
        self.measure();
        self.io.read(&self.group, self.bus.blind_max_ms);
        self.steer();
        let (following, underrun) = self.next_setpoint();
        let output_rad_s = self.control(following);
        self.supervise(following, underrun, &output_rad_s);
        self.write(following, &output_rad_s);
        let may_lower = following && self.may_lower_pen();
        let pen = self.pen.step(may_lower, &self.now.setpoint);
        let has_fault = self.supervision.fault().is_some();
        let tool = match self.tool.is_used() {
            true => self.tool_value(may_lower && !has_fault),
            false => ToolValue::default(),
        };
        self.io.write(&mut self.group, has_fault, pen, tool);
        let telegram = self.group.trigger_output();
        let sending = match may_send(&self.bus, self.has_path) {
            true => transport.send(telegram),
            false => Sending::Nothing,
        };
        self.network.send_next(|frame| {
            // A frame that the port does not take is lost, as on any network.
            let _ = transport.send(frame);
        });
        let late = match self.group.exchange_kind() {
            ExchangeKind::Split => elapsed_ns > OUTPUT_LATE_NS || sending == Sending::Busy,
            // The input telegram carried the previous outputs; these are in time for the next one.
            ExchangeKind::Combined => self.first_late || elapsed_ns >= PERIOD_NS,
        };
        self.late = u16::from(late);
        self.counters.cycles_late = self.counters.cycles_late.wrapping_add(u32::from(late));
        self.report(following);
    }

    /// Whether an output may lower the pen: its height is known, and no stop has begun.
    fn may_lower_pen(&self) -> bool {
        let is_known = self.search.is_none() && self.now.homed == [true; AXES];
        self.power == Power::On && is_known && !self.path_stop.is_active()
    }

    /// Values of the tool's outputs, which belong to the motion of the millisecond that begins when they arrive.
    /// `may_lower` is whether the tool may work at all: the setpoint is followed, and no stop has begun.
    #[inline(never)]
    fn tool_value(&mut self, may_lower: bool) -> ToolValue {
        let is_held = self.tool.is_off_at_hold && self.io.report().hold.is_some();
        let may_be_on = may_lower && self.tool.draws && !is_held && self.robot.is_in_operation();
        let ahead = self.tool.ahead(self.bus.exchange);
        match self.window.get(ahead) {
            // The way to the first vertex belongs to no stroke, whatever its pen.
            Some(setpoint) if may_be_on && setpoint.pen == Pen::Down && setpoint.vertex > 0 => {
                self.tool.step(setpoint.drawing_mm_s)
            }
            _ => self.tool.off(),
        }
    }

    /// Takes new addresses from the IP stack. Without addresses nothing is sent; the supervisor and the supervision see
    /// a silent bus.
    #[cold]
    fn take_path(&mut self) {
        while let Some(path) = self.network.next_path() {
            self.has_path = path.is_some();
            self.group
                .set_encapsulation(path.map_or(Encapsulation::Raw, Encapsulation::Udp));
        }
    }

    /// Correction of the timer's next period, ns (positive: longer), that keeps the sample's phase to the bus clock; at
    /// most [`CORRECTION_MAX_NS`](crate::ethercat::clock::steering::CORRECTION_MAX_NS) either way. Call it once a
    /// millisecond.
    pub fn take_timer_correction_ns(&mut self) -> i32 {
        core::mem::take(&mut self.timer_correction_ns)
    }

    /// Takes this cycle's time of the bus clock. Another reference clock has the same time, so that the phase stays,
    /// unless the clocks have been set anew.
    fn steer(&mut self) {
        let state = self.group.bus_state();
        let clock = state.reference_clock;
        if clock != self.clock || clock.is_some() && self.time_number != Some(state.time_number) {
            self.follow_clock(clock, state.time_number);
        }
        self.timer_correction_ns = match self.clock {
            Some(_) => self.steering.step(ClockReading {
                reference_ns: state.clock_ns,
                elapsed_ns: self.released_late_ns,
            }),
            None => self.steering.coast(),
        };
    }

    #[cold]
    fn follow_clock(&mut self, clock: Option<u16>, time_number: u8) {
        self.clock = clock;
        if clock.is_some() && self.time_number == Some(time_number) {
            self.steering.restart();
        } else if clock.is_some() {
            self.time_number = Some(time_number);
            self.steering = ClockSteering::new(PERIOD_NS);
        }
    }

    /// Makes the controllers of all axes anew.
    #[cold]
    fn renew_controllers(&mut self) {
        // One at a time: every move of an array would need its size on the stack again.
        for (index, axis) in self.axes.iter().enumerate() {
            self.controllers[index] = PositionController::new(axis);
            self.velocity_controllers[index] = VelocityController::new(axis);
        }
    }

    /// Gives the axes the leads of the exchange that runs: a slave that does not support the configured one makes it another.
    #[cold]
    fn match_leads(&mut self) {
        let (configured, actual) = (self.bus.exchange, self.group.exchange_kind());
        if configured == actual {
            return;
        }
        let later_ms = command_delay_ms(actual) - command_delay_ms(configured);
        self.bus.exchange = actual;
        for axis in &mut self.axes {
            *axis = axis.with_later_commands(later_ms);
        }
        self.robot.take_leads(&self.axes);
        self.renew_controllers();
    }

    #[cold]
    fn take_commands(&mut self) {
        while let Some(command) = queue::take(&mut self.commands) {
            match command {
                SamplerCommand::Configure { axes, bus } => {
                    self.used = usize::from(bus.drives).clamp(1, AXES);
                    self.robot.configure(&axes, self.used);
                    self.leave_out_absent();
                    self.has_torque_axis = axes.iter().take(self.used).any(|axis| axis.mode == AxisMode::Torque);
                    self.rest = axes.each_ref().map(Rest::of);
                    (self.axes, self.bus) = (axes, bus);
                    self.renew_controllers();
                    self.same_zero = [false; AXES];
                }
                SamplerCommand::Power(Power::PathStop) => self.stop_on_path(),
                SamplerCommand::Power(power) => {
                    if power == Power::On {
                        self.match_leads();
                    }
                    self.power = power;
                    self.path_stop.end();
                    if power != Power::On {
                        self.epoch = None;
                        self.end_search();
                    }
                }
                SamplerCommand::Home { near } => {
                    self.epoch = None;
                    self.path_stop.end();
                    // A refusal leaves the axes unhomed, which the operating modes see and report.
                    let _ = self.robot.home(near.as_ref());
                    self.same_zero = [false; AXES];
                }
                SamplerCommand::Search { kind } => self.begin_search(kind),
                SamplerCommand::EndSearch => {
                    if let Some(search) = &mut self.search {
                        search.cancel();
                    }
                }
                SamplerCommand::Follow { epoch } => {
                    self.epoch = Some(epoch);
                    self.path_stop.end();
                    self.window.clear();
                }
                SamplerCommand::ConfigureIo(points, pen, tool) => {
                    (self.pen, self.tool) = (pen, tool);
                    self.io.configure(points, pen.words);
                    self.spares_terminals = self.io.spares_terminals();
                }
                SamplerCommand::Draws(draws) => self.tool.draws = draws,
                SamplerCommand::SwitchOutputsOff => self.io.switch_off(),
                SamplerCommand::SetOutput { io, value } => self.io.request(io, value),
                SamplerCommand::ClearFault => {
                    self.supervision.clear();
                    self.steering.restart();
                }
            }
        }
    }

    /// Takes the inputs as joint angles and velocities. Counts how long all axes have been at rest.
    #[inline(never)]
    fn measure(&mut self) {
        self.robot.renew(&mut self.group);
        // Unrolled: with a constant index, an axis costs a third less.
        let still = [
            self.measure_axis::<0>(),
            self.measure_axis::<1>(),
            self.measure_axis::<2>(),
            self.measure_axis::<3>(),
        ];
        self.still_ms = match still == [true; AXES] {
            true => self.still_ms.saturating_add(1),
            false => 0,
        };
    }

    /// Takes an axis's input; a missing one is predicted from the last velocity. Returns whether the axis is at rest.
    #[inline(always)]
    fn measure_axis<const AXIS: usize>(&mut self) -> bool {
        if AXIS >= self.used {
            return self.follow_absent(AXIS);
        }
        let reading = self.robot.read_axis::<AXIS>(&self.group);
        let now = &mut self.now;
        let before_rad = now.measured_rad[AXIS];
        now.valid[AXIS] = reading.is_some();
        if let Some(reading) = reading {
            now.status_word[AXIS] = reading.status.0;
            now.increments[AXIS] = reading.increments;
            now.measured_rad[AXIS] = reading.angle_rad;
            let same_zero = self.same_zero[AXIS] && now.homed[AXIS] == reading.homed;
            self.same_zero[AXIS] = true;
            now.measured_rad_s[AXIS] = if same_zero {
                (reading.angle_rad - before_rad) * CYCLES_PER_S
            } else {
                0.0
            };
            self.home_lost[AXIS] = now.homed[AXIS] && !reading.homed;
            now.homed[AXIS] = reading.homed;
        } else {
            now.measured_rad[AXIS] = before_rad + now.measured_rad_s[AXIS] / CYCLES_PER_S;
        }
        // Silence does not mean rest: the last measured speed decides.
        self.rest[AXIS].is_at(now.measured_rad_s[AXIS])
    }

    /// Advances to this millisecond's setpoint. Returns whether one is followed, and whether one was missing.
    #[inline]
    fn next_setpoint(&mut self) -> (bool, bool) {
        if self.search.is_some() {
            return self.search_setpoint();
        }
        if self.path_stop.is_active() {
            return self.stop_setpoint();
        }
        let Some(epoch) = self.epoch else {
            self.window.clear();
            return (false, false);
        };
        let was_following = !self.window.is_empty();
        self.window.advance();
        self.window.fill(&mut self.setpoints, epoch);
        match self.window.first() {
            Some(setpoint) => {
                self.now.setpoint = *setpoint;
                (true, false)
            }
            None => (false, was_following),
        }
    }

    #[inline(never)]
    fn control(&mut self, following: bool) -> [f64; AXES] {
        if !following {
            self.controllers.iter_mut().for_each(PositionController::reset);
            return [0.0; AXES];
        }
        // Most machines have one lead for all axes.
        let around = self.window.velocities_around(self.controllers[0].lead().whole);
        let around = around.map(|velocities| *velocities);
        [
            self.control_axis::<0>(&around),
            self.control_axis::<1>(&around),
            self.control_axis::<2>(&around),
            self.control_axis::<3>(&around),
        ]
    }

    /// The velocity command of an axis, rad/s; `around` are the velocities around the first axis's lead.
    #[inline(always)]
    fn control_axis<const AXIS: usize>(&mut self, around: &[[f64; AXES]; 2]) -> f64 {
        if AXIS >= self.used {
            return 0.0;
        }
        let (setpoint_rad, measured_rad) = (self.now.setpoint.position_rad[AXIS], self.now.measured_rad[AXIS]);
        let whole = self.controllers[0].lead().whole;
        let controller = &mut self.controllers[AXIS];
        if self.axes[AXIS].mode != AxisMode::Velocity {
            return self.control_without_velocity(AXIS, setpoint_rad, measured_rad);
        }
        let lead = controller.lead();
        let [low, high] = match lead.whole == whole {
            true => around.map(|velocities| velocities[AXIS]),
            false => self
                .window
                .velocities_around(lead.whole)
                .map(|velocities| velocities[AXIS]),
        };
        controller.step_with(setpoint_rad, measured_rad, lead.between(low, high))
    }

    /// The velocity of an axis whose drive takes a torque or a position, rad/s: that to which the firmware, or the drive,
    /// leads it.
    #[inline(never)]
    fn control_without_velocity(&mut self, axis: usize, setpoint_rad: f64, measured_rad: f64) -> f64 {
        let (Some(controller), Some(demand)) = (self.controllers.get_mut(axis), self.positions.get_mut(axis)) else {
            return 0.0;
        };
        if self.axes.get(axis).is_some_and(|axis| axis.mode == AxisMode::Torque) {
            return controller.step_for_torque(setpoint_rad, measured_rad);
        }
        let lead = controller.lead();
        let around = self.window.velocities_around(lead.whole);
        let [low, high] = around.map(|velocities| velocities.get(axis).copied().unwrap_or(0.0));
        let ahead_rad = self.window.position_rad(axis, controller.position_lead());
        let velocity_rad_s = lead.between(low, high);
        let [correction_rad_s, forward_rad_s] =
            controller.step_for_position(setpoint_rad, measured_rad, velocity_rad_s);
        *demand = PositionDemand {
            angle_rad: ahead_rad.unwrap_or(setpoint_rad),
            velocity_rad_s,
            forward_rad_s,
            correction_rad_s,
        };
        correction_rad_s + forward_rad_s
    }

    #[inline(never)]
    fn supervise(&mut self, following: bool, underrun: bool, output_rad_s: &[f64; AXES]) {
        self.counters.underruns = self.counters.underruns.wrapping_add(u32::from(underrun));
        let power = self.power == Power::On;
        let mut seen = Observation {
            valid: self.now.valid,
            unconfirmed: self.group.unconfirmed(),
            following_error_rad: [0.0; AXES],
            output_rad_s: *output_rad_s,
            status_word: self.now.status_word,
            drive_fault: [false; AXES],
            home_lost: self.home_lost,
            al_status: self.group.bus_state().al_status,
            clock: self
                .clock
                .and_then(|_| self.steering.fault(u32::from(self.bus.clock_error_max_us) * 1_000))
                .map(Fault::from),
            power,
            following: following || underrun,
            underrun,
            late: self.late,
            interlock: self.interlock,
            io_stop: (self.io.report().stop).filter(|stop| self.search.is_none() || !stop.is_limit()),
            spares_terminals: self.spares_terminals,
        };
        if following {
            for (axis, error) in seen.following_error_rad.iter_mut().enumerate().take(self.used) {
                *error = self.controllers[axis].setpoint_at_age() - self.now.measured_rad[axis];
            }
        }
        if power && self.robot.is_in_operation() {
            self.was_enabled = [true; AXES];
        } else {
            seen.drive_fault = self.look_for_drive_faults(power);
        }
        // An axis whose feedback is implausible is no longer homed.
        if self.now.homed != [true; AXES] {
            self.check_feedback();
        }
        let fault = self.supervision.step(&self.axes, &self.bus, &seen);
        if fault.is_some() || self.path_stop.is_active() {
            self.watch_stop();
        }
    }

    /// Latches the fault of an implausible feedback, if that is why an axis is not homed.
    #[cold]
    fn check_feedback(&mut self) {
        if let Some((axis, implausible)) = self.robot.take_implausible() {
            self.supervision.latch(Fault::feedback(axis, implausible));
        }
    }

    /// Which drives report a fault, or have left operation although they are to stay there.
    #[cold]
    fn look_for_drive_faults(&mut self, power: bool) -> [bool; AXES] {
        let mut faults = [false; AXES];
        for (axis, fault) in faults.iter_mut().enumerate() {
            let state = self.robot.state(axis);
            let enabled = state == DriveState::OperationEnabled;
            let gave_up = power && self.was_enabled[axis] && !enabled;
            self.was_enabled[axis] = power && (enabled || self.was_enabled[axis]);
            let faulty = matches!(state, DriveState::Fault | DriveState::FaultReactionActive);
            *fault = self.now.valid[axis] && (faulty || gave_up);
        }
        faults
    }

    #[inline(never)]
    fn write(&mut self, following: bool, output_rad_s: &[f64; AXES]) {
        let stops_at_once = self.supervision.fault().is_some() && !self.path_stop.is_active();
        let target = match (self.power, stops_at_once) {
            (Power::Off, _) => DriveTarget::Off,
            (Power::FaultReset, _) => DriveTarget::FaultReset,
            (Power::On, false) => DriveTarget::Enabled,
            (Power::On, true) | (Power::QuickStop | Power::PathStop, _) => DriveTarget::QuickStop,
        };
        let moving = following && target == DriveTarget::Enabled && self.robot.is_in_operation();
        if self.has_torque_axis {
            self.tell_demanded(moving);
        }
        self.write_axis::<0>(target, moving, output_rad_s);
        self.write_axis::<1>(target, moving, output_rad_s);
        self.write_axis::<2>(target, moving, output_rad_s);
        self.write_axis::<3>(target, moving, output_rad_s);
    }

    #[inline(always)]
    fn write_axis<const AXIS: usize>(&mut self, target: DriveTarget, moving: bool, output_rad_s: &[f64; AXES]) {
        let velocity_rad_s = if moving { output_rad_s[AXIS] } else { 0.0 };
        let demand = match self.axes[AXIS].mode {
            AxisMode::Velocity => Demand::Velocity(velocity_rad_s),
            AxisMode::Torque => Demand::Torque(self.torque_nm(AXIS, velocity_rad_s, target, moving)),
            AxisMode::Position => {
                let demand = self.positions.get(AXIS).filter(|_| moving);
                return self.robot.write_position(AXIS, &mut self.group, target, demand);
            }
        };
        let command = AxisCommand { target, demand };
        self.robot.write_axis::<AXIS>(&mut self.group, &command);
    }

    /// Passes each axis what the setpoints demand of it and of the other axes.
    #[inline(never)]
    fn tell_demanded(&mut self, moving: bool) {
        let demanded = match moving {
            true => Demanded::between(self.window.velocities_around(0)),
            false => [Demanded::default(); AXES],
        };
        self.robot.set_demanded(&demanded);
    }

    /// The torque that leads an axis to a velocity, N m at the joint; an enabled axis that does not move is held.
    #[inline(never)]
    fn torque_nm(&mut self, axis: usize, velocity_rad_s: f64, target: DriveTarget, moving: bool) -> f64 {
        let state = self.robot.state(axis);
        let Some(controller) = self.velocity_controllers.get_mut(axis) else {
            return 0.0;
        };
        if target != DriveTarget::Enabled || state != DriveState::OperationEnabled {
            controller.reset();
            return 0.0;
        }
        let limit_rad_s = self.axes.get(axis).map_or(0.0, |axis| axis.output_max_rad_s.abs());
        let measured_rad_s = self.now.measured_rad_s.get(axis).copied().unwrap_or(0.0);
        let ahead = self.window.velocities_rad_s(axis).filter(|_| moving);
        controller.step(limited(velocity_rad_s, limit_rad_s), measured_rad_s, ahead)
    }

    #[inline]
    fn report(&mut self, following: bool) {
        let now = &mut self.now;
        now.cycle = self.counters.cycles;
        now.following = following;
        now.searching = self.search.is_some();
        now.standstill = self.still_ms >= STANDSTILL_MS;
        now.clock_error_ns = self.clock.map(|_| self.steering.error_ns());
        now.fault = self.supervision.fault();
        now.interlock = self.interlock.or(self.io.interlock());
        now.io = *self.io.report();
        self.io.copy_words(&mut now.io_words);
        now.counters = self.counters;
        now.bus = self.group.counters();
        if !queue::put_copy(&mut self.reports, now) {
            self.counters.reports_dropped = self.counters.reports_dropped.wrapping_add(1);
        }
    }
}

/// Whether telegrams may leave: EtherCAT in UDP needs addresses first.
fn may_send(bus: &Bus, has_path: bool) -> bool {
    bus.transport == Transport::Raw || has_path
}

/// Samples in a second.
const CYCLES_PER_S: f64 = 1.0e9 / PERIOD_NS as f64;

const _: () = assert!(OUTPUT_LATE_NS < PERIOD_NS);

#[cfg(test)]
mod tests;
