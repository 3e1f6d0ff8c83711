//! Tells the monitor what happens: translates messages, states and faults into its words.
//!
//! Nothing is judged here. Commands are taken from the bytes that reached the board, after the line's noise.

use super::machine::{Chain, has_height_axis};
use super::world::Frame;
use super::{Rule, robot};
use crate::cell::{Clocks, Fault, PEN_SPRING_MM, Product, ResolverFault, SiiFault, Truth};
use etherpen::application::Mode;
use etherpen::config::{Axis, AxisMode, Config, PenLiftKind, Transport};
use etherpen::link::frame::{Decoder, decode};
use etherpen::messages::{Command, HostMessage, PathVertex, Status};
use etherpen::motion::Pen;
use etherpen::robots::{AXES, MAIN_AXES};
use etherpen_monitor as monitor;
use monitor::{Count, Input, Joint, Moment, Monitor, Report, WireFrame};

/// Most frames of a millisecond that are judged.
const FRAMES_MAX: usize = 16;
/// How far the tool may be from its setpoint in velocity and in torque mode, mm. Torque keeps 1.0 mm while it draws
/// (`tests/drives.rs`) and 1.2 mm in travel at 1,000 mm/s.
const FOLLOWING_MM: f64 = 0.3;
const FOLLOWING_BY_TORQUE_MM: f64 = 1.3;
/// How far the pen may be beside its line in velocity mode, in addition to the tolerance and to what its acceleration
/// explains, while nothing is disturbed, mm.
const UNDISTURBED_MM: f64 = 0.02;
/// By which part of its speed the tool may exceed it in velocity and in torque mode.
const OVERSHOOT: f64 = 0.05;
const OVERSHOOT_BY_TORQUE: f64 = 0.15;
/// By how much the tool may exceed it in torque mode besides, mm/s: 66 mm/s were seen where 36 were ordered, as a pen
/// left the paper.
const OVERSHOOT_BY_TORQUE_MM_S: f64 = 35.0;
/// How long a joint may creep after a motion in velocity and in torque mode, ms.
const CREEP_MS: u32 = 100;
const CREEP_BY_TORQUE_MS: u32 = 250;
/// Part of the ink that may be missing in torque mode, where the pen's spring does not always reach the paper.
const INK_MISSING_BY_TORQUE: f64 = 0.01;

/// Length of a gap that this leaves in a line, mm.
const INK_MISSING_BY_TORQUE_MM: f64 = 1.0;

/// How far the tool may be astray in torque and position mode while a feedback is not true, mm: a slip need not be noticed
/// there (`docs/faults.md`), so that only the joints' ranges bound it.
const ASTRAY_BY_SLIP_MM: f64 = 600.0;

/// How long the bus needs after a disturbance was put right, ms.
const AFTER_REPAIR_MS: u64 = 3_000;
/// How long a slave counts as disturbed that refuses its next request, ms.
const REFUSAL_MS: u64 = 1_000;

/// A disturbance of the machine that lasts until it is put right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Open {
    /// A cable is pulled.
    Cut,
    /// This slave is bypassed.
    Removed(usize),
    /// This slave is another product.
    Swapped(usize),
    /// This slave's information memory is faulty.
    Memory(usize),
    /// These two slaves are at each other's places.
    Recabled(usize, usize),
}

/// What on the board demands a stop in a millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Interlocks {
    /// The emergency-stop input shows open.
    pub(super) stop_open: bool,
    /// The board runs on its substitute clock.
    pub(super) clock_failed: bool,
}

/// The monitor, and what it has to be told in this millisecond.
pub(super) struct Judge {
    monitor: Monitor,
    inputs: Vec<Input>,
    reports: Vec<Report>,
    decoder: Box<Decoder>,
    last_command: Option<u16>,
    interlocks: Interlocks,
    /// Ends of faults that end by themselves: when, ms, and what is true then.
    ends: Vec<(u64, Input)>,
    /// Disturbances of the machine, and of each axis's feedback, that have not ended.
    disturbances: u32,
    /// Those among them that end only when they are put right.
    open: Vec<Open>,
    untrue: [u32; AXES],
    /// Axes whose reference is not true: their encoder was mounted again, or was not true as the robot was homed.
    unsure: [bool; AXES],
    /// Axes whose encoder has been true since an order to home reached the board, and since a search was accepted.
    offered: [bool; AXES],
    shown: [bool; AXES],
    axes: usize,
    chain: Chain,
    has_switches: bool,
    /// Whether the axes were reported on their way to their home switches.
    searches: bool,
    /// The drives that belong in the cell.
    products: [Product; AXES],
    configured: bool,
    /// The drawing that the operator orders, until its order reaches the board.
    ordered: Option<(u16, Vec<Input>)>,
    finished: Option<u16>,
}

impl Judge {
    pub(super) fn new(config: &Config) -> Self {
        Self {
            monitor: Monitor::new(cell(config)),
            inputs: Vec::new(),
            reports: Vec::new(),
            decoder: Box::default(),
            last_command: None,
            interlocks: Interlocks::default(),
            ends: Vec::new(),
            disturbances: 0,
            open: Vec::new(),
            untrue: [0; AXES],
            unsure: [false; AXES],
            offered: [false; AXES],
            shown: [false; AXES],
            axes: config.bus.drives.into(),
            chain: Chain::new(config),
            has_switches: config.has_home_switches(),
            searches: false,
            products: config.axes.each_ref().map(product),
            configured: false,
            ordered: None,
            finished: None,
        }
    }

    /// A new connection numbers its commands from the beginning.
    pub(super) fn reconnected(&mut self) {
        self.last_command = None;
    }

    /// Takes bytes that reached the board.
    pub(super) fn delivered(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let Some(Ok(payload)) = self.decoder.push(*byte) else {
                continue;
            };
            match decode::<HostMessage>(payload) {
                // A repeated request is carried out once.
                Ok(HostMessage::Command { id, command }) if self.last_command != Some(id) => {
                    self.last_command = Some(id);
                    self.reached(&command);
                }
                Ok(HostMessage::Configure { .. }) if !self.configured => {
                    self.configured = true;
                    self.inputs.push(Input::Configured);
                }
                _ => {}
            }
        }
    }

    /// The operator orders a drawing.
    pub(super) fn orders(&mut self, job: u16, path: &[PathVertex]) {
        let inputs = (0..).zip(path).map(|(index, vertex)| Input::PathVertex {
            job,
            index,
            position_mm: vertex.position_um.map(|um| f64::from(um) / 1e3),
            pen_down: vertex.pen == Pen::Down,
        });
        (self.ordered, self.finished) = (Some((job, inputs.collect())), None);
    }

    /// A command has reached the board. The path of a drawing follows its order.
    fn reached(&mut self, command: &Command) {
        self.inputs.extend(self.command_of(command).map(Input::Commanded));
        if matches!(command, Command::Home | Command::HomeAt { .. }) {
            self.offered = self.untrue.map(|disturbances| disturbances == 0);
        }
        if let Command::Draw { job } = *command
            && let Some((_, path)) = self.ordered.take_if(|(ordered, _)| *ordered == job)
        {
            self.inputs.extend(path);
        }
    }

    pub(super) fn answered(&mut self, command: &Command, accepted: bool) {
        let is_home = matches!(command, Command::Home) && !self.has_switches;
        if accepted && (is_home || matches!(command, Command::HomeAt { .. })) {
            self.homed(self.offered);
        } else if accepted && matches!(command, Command::Home) {
            self.shown = self.offered;
        }
        self.reports
            .extend(self.command_of(command).map(|command| match accepted {
                true => Report::Accepted(command),
                false => Report::Refused(command),
            }));
    }

    pub(super) fn refused_vertex(&mut self, job: u16, index: u32) {
        self.reports.push(Report::VertexRefused { job, index });
    }

    /// A drawing is reported as executed to its end.
    pub(super) fn drawn(&mut self, job: u16) {
        if self.finished.replace(job) != Some(job) {
            self.reports.push(Report::Finished { job });
        }
    }

    /// The drawing that was reported last as executed to its end.
    #[cfg(test)]
    pub(super) fn finished(&self) -> Option<u16> {
        self.finished
    }

    /// A status has arrived.
    pub(super) fn reported(&mut self, status: &Status) {
        self.reports.push(Report::Mode(mode_of(status.mode)));
        self.in_mode(status.mode, status.referenced);
        self.reports
            .push(Report::Fault(status.fault.map(|fault| format!("{fault:?}"))));
        self.reports.push(Report::Homed(status.referenced));
        let counters = &status.counters;
        let counts = [
            ("cycles", counters.cycles),
            ("frames_lost", counters.frames_lost),
            ("working_counter_errors", counters.working_counter_errors),
            ("frames_ignored", counters.frames_ignored),
            ("cycles_late", counters.cycles_late),
            ("link_errors", counters.link_errors),
        ];
        let counts = counts.map(|(name, count)| Count {
            name,
            count: count.into(),
        });
        self.reports.push(Report::Counters(counts.to_vec()));
    }

    /// The end of a search is seen from the mode.
    fn in_mode(&mut self, mode: Mode, is_referenced: bool) {
        let searched = self.searches;
        self.searches = mode == Mode::Homing;
        if searched && !self.searches && is_referenced {
            self.homed(self.shown);
        }
    }

    /// A fault of the segment begins; a fault of frames hits `count` of them.
    pub(super) fn injected(&mut self, fault: Fault, count: u32, now_ms: u32) {
        match fault {
            Fault::Resolver(slave, _, 0) => self.true_again(slave),
            Fault::Resolver(slave, kind, lasts_ms) => {
                // What a slipping or reversed resolver has lost stays lost until it is put right.
                let ends = matches!(kind, ResolverFault::Stuck | ResolverFault::Noise(_));
                self.untrue(now_ms, slave, ends.then_some(lasts_ms));
            }
            Fault::Jump(slave, _) => self.untrue(now_ms, slave, None),
            Fault::Exchange(one, other, lasts_ms) => {
                for slave in [one, other] {
                    self.untrue(now_ms, slave, Some(lasts_ms));
                }
            }
            Fault::Processor(slave, lasts_ms) => {
                if let Some(axis) = self.chain.axis(slave) {
                    let deaf = |deaf| Input::Drive { axis, deaf };
                    self.inputs.push(deaf(true));
                    self.ends_after(now_ms, lasts_ms, deaf(false));
                }
                self.disturbed(now_ms, Some(lasts_ms));
            }
            Fault::Cut(_) => self.opens(now_ms, Open::Cut),
            Fault::Remove(slave) => self.opens(now_ms, Open::Removed(slave)),
            Fault::Join => self.closes(now_ms, Open::Cut),
            Fault::Insert(slave) => self.closes(now_ms, Open::Removed(slave)),
            // A slave that is exchanged, if only for one of its own kind, is bypassed for a moment.
            Fault::Swap(slave, product) => match Some(product) == self.product(slave) {
                true => {
                    self.disturbed(now_ms, Some(AFTER_REPAIR_MS));
                    self.closes(now_ms, Open::Swapped(slave));
                }
                false => self.opens(now_ms, Open::Swapped(slave)),
            },
            Fault::Sii(slave, SiiFault::Whole) => self.closes(now_ms, Open::Memory(slave)),
            Fault::Sii(slave, _) => self.opens(now_ms, Open::Memory(slave)),
            Fault::Refuse(..) => self.disturbed(now_ms, Some(REFUSAL_MS)),
            // What exchanges two slaves puts them back too.
            Fault::Recable(one, other) => {
                let pair = Open::Recabled(one.min(other), one.max(other));
                match self.open.contains(&pair) {
                    true => self.closes(now_ms, pair),
                    false => self.opens(now_ms, pair),
                }
            }
            // Drives without new outputs stop by their own watchdogs, as without frames.
            Fault::Mute(lasts_ms)
            | Fault::Deaf(_, lasts_ms)
            | Fault::Stall(lasts_ms)
            | Fault::Power(_, lasts_ms)
            | Fault::Silence(_, lasts_ms)
            | Fault::Mains(_, lasts_ms) => self.disturbed(now_ms, Some(lasts_ms)),
            Fault::Crc(_, frames) => self.disturbed(now_ms, Some(frames)),
            // At least one frame travels in a millisecond.
            _ => self.disturbed(now_ms, Some(count.into())),
        }
    }

    /// The drive that belongs at a slave's place.
    fn product(&self, slave: usize) -> Option<Product> {
        self.chain.axis(slave).and_then(|axis| self.products.get(axis)).copied()
    }

    /// The command as the monitor knows it: homing leads the axes to their switches where there are some.
    fn command_of(&self, command: &Command) -> Option<monitor::Command> {
        match command {
            Command::Home if self.has_switches => Some(monitor::Command::Search),
            other => command_of(other),
        }
    }

    /// An axis's feedback is not true for some milliseconds, or until it is put right.
    fn untrue(&mut self, now_ms: u32, slave: usize, lasts_ms: Option<u64>) {
        let Some(axis) = self.chain.axis(slave) else { return };
        let Some(untrue) = self.untrue.get_mut(axis) else {
            return;
        };
        *untrue += 1;
        (self.offered[axis], self.shown[axis]) = (false, false);
        self.inputs.push(Input::Feedback { axis, disturbed: true });
        if let Some(lasts_ms) = lasts_ms {
            self.ends_after(now_ms, lasts_ms, Input::Feedback { axis, disturbed: false });
        }
    }

    /// An axis's encoder has been put right. One that had lost its position shows true changes again, but from another zero:
    /// the robot has to be homed.
    fn true_again(&mut self, slave: usize) {
        let Some(axis) = self.chain.axis(slave) else { return };
        let Some(untrue) = self.untrue.get_mut(axis) else {
            return;
        };
        let disturbances = std::mem::take(untrue);
        let before = self.ends.len();
        self.ends
            .retain(|(_, end)| !matches!(end, Input::Feedback { axis: other, .. } if *other == axis));
        let passing = before - self.ends.len();
        (self.offered[axis], self.shown[axis]) = (false, false);
        self.inputs.push(match disturbances as usize > passing {
            true => {
                self.unsure[axis] = true;
                Input::Mounted { axis }
            }
            false => Input::Feedback { axis, disturbed: false },
        });
    }

    /// The robot is homed by encoders of which these are true.
    fn homed(&mut self, by: [bool; AXES]) {
        for (unsure, is_true) in self.unsure.iter_mut().zip(by).take(self.axes) {
            *unsure = !is_true;
        }
    }

    /// Whether an axis shows true positions, but not from a true reference, so that the robot has to be homed.
    pub(super) fn asks_for_homing(&self) -> bool {
        let mut axes = self.unsure.iter().zip(self.untrue);
        axes.any(|(unsure, disturbances)| *unsure && disturbances == 0)
    }

    /// The machine is disturbed for some milliseconds, or until it is healed.
    pub(super) fn disturbed(&mut self, now_ms: u32, lasts_ms: Option<u64>) {
        self.disturbances += 1;
        self.inputs.push(Input::Machine { disturbed: true });
        if let Some(lasts_ms) = lasts_ms {
            self.ends_after(now_ms, lasts_ms, Input::Machine { disturbed: false });
        }
    }

    /// The machine is disturbed until this is put right.
    fn opens(&mut self, now_ms: u32, what: Open) {
        self.open.push(what);
        self.disturbed(now_ms, None);
    }

    /// This was put right; the bus needs a while to come back.
    fn closes(&mut self, now_ms: u32, what: Open) {
        let before = self.open.len();
        self.open.retain(|open| *open != what);
        for _ in self.open.len()..before {
            self.ends_after(now_ms, AFTER_REPAIR_MS, Input::Machine { disturbed: false });
        }
    }

    fn ends_after(&mut self, now_ms: u32, lasts_ms: u64, end: Input) {
        self.ends.push((u64::from(now_ms).saturating_add(lasts_ms) + 1, end));
    }

    /// All faults have been ended.
    pub(super) fn healed(&mut self) {
        self.ends.clear();
        self.open.clear();
        (self.disturbances, self.untrue) = (0, [0; AXES]);
        for axis in 0..self.axes {
            self.inputs.push(Input::Feedback { axis, disturbed: false });
            self.inputs.push(Input::Drive { axis, deaf: false });
        }
        self.inputs.push(Input::Machine { disturbed: false });
        self.inputs.push(Input::Link { cut: false });
    }

    /// The line between operator and board carries nothing until a time, ms.
    pub(super) fn unplugged(&mut self, until_ms: u32) {
        self.inputs.push(Input::Link { cut: true });
        self.ends.push((until_ms.into(), Input::Link { cut: false }));
    }

    /// Tells the ends that have come. What is disturbed several times is sound again when the last of them has ended.
    fn end_disturbances(&mut self, now_ms: u64) {
        let (inputs, disturbances, untrue) = (&mut self.inputs, &mut self.disturbances, &mut self.untrue);
        self.ends.retain(|(ends_ms, end)| {
            let over = *ends_ms <= now_ms;
            if !over {
                return true;
            }
            let left = match *end {
                Input::Machine { .. } => Some(&mut *disturbances),
                Input::Feedback { axis, .. } => untrue.get_mut(axis),
                _ => None,
            };
            let is_last = left.is_none_or(|left| {
                *left = left.saturating_sub(1);
                *left == 0
            });
            inputs.extend(is_last.then_some(*end));
            false
        });
    }

    /// Judges a millisecond.
    pub(super) fn moment(
        &mut self,
        ms: u32,
        truth: &Truth,
        frames: &[Frame],
        clocks: &Clocks,
        interlocks: Interlocks,
    ) -> Result<(), (Rule, String)> {
        let now_ms = u64::from(ms);
        self.end_disturbances(now_ms);
        let inputs = &mut self.inputs;
        let before = std::mem::replace(&mut self.interlocks, interlocks);
        inputs.extend((before.stop_open != interlocks.stop_open).then_some(Input::StopInput(interlocks.stop_open)));
        inputs.extend(
            (before.clock_failed != interlocks.clock_failed).then_some(Input::ClockFailed(interlocks.clock_failed)),
        );
        let joints: [Joint; AXES] = std::array::from_fn(|axis| Joint {
            angle_rad: truth.angles_rad[axis],
            speed_rad_s: truth.speeds_rad_s[axis],
            has_power: truth.has_power[axis],
        });
        let wire: heapless::Vec<WireFrame<'_>, FRAMES_MAX> = frames
            .iter()
            .take(FRAMES_MAX)
            .map(|frame| WireFrame {
                from_master: frame.from_master,
                bytes: &frame.bytes,
                time_ns: frame.time_ns,
            })
            .collect();
        let verdict = self.monitor.step(&Moment {
            time_ms: now_ms,
            joints: &joints,
            pen_touches: truth.pen_touches,
            inputs: &self.inputs,
            reports: &self.reports,
            wire: &wire,
            clocks: monitor::Clocks {
                time_ns: clocks.time_ns,
                system_ns: &clocks.system_ns,
            },
        });
        self.inputs.clear();
        self.reports.clear();
        verdict.map_err(|violation| (Rule::Monitor(violation.rule), violation.text))
    }

    /// A counter has to show a number at the end.
    pub(super) fn expect(&mut self, name: &'static str, count: u64) {
        self.monitor.expect(name, count);
    }

    /// Judges what can only be judged at the end.
    pub(super) fn end(&mut self) -> Result<(), (Rule, String)> {
        let verdict = self.monitor.end();
        verdict.map_err(|violation| (Rule::Monitor(violation.rule), violation.text))
    }
}

/// The command as the monitor knows it; `None` for one that moves nothing.
fn command_of(command: &Command) -> Option<monitor::Command> {
    use monitor::Command as Told;
    let told = match *command {
        Command::Home => Told::Home,
        Command::HomeAt { pose, .. } => Told::HomeAt { pose_rad: pose.0 },
        Command::Enable => Told::Enable,
        Command::Disable => Told::Disable,
        Command::Jog { velocity_mm_s } => Told::Jog {
            velocity_mm_s: velocity_mm_s.map(f64::from),
        },
        Command::Move { position } => Told::Move {
            position_mm: [position.x_mm, position.y_mm, position.z_mm],
        },
        Command::Draw { job } => Told::Draw { job },
        Command::Hold => Told::Hold,
        Command::Resume => Told::Resume,
        Command::Cancel => Told::Cancel,
        Command::Override { percent } => Told::Override { percent },
        Command::Pen { pen } => Told::Pen { down: pen == Pen::Down },
        Command::Stop => Told::Stop,
        Command::Acknowledge => Told::Acknowledge,
        Command::SetOutput { .. } => return None,
    };
    Some(told)
}

fn mode_of(mode: Mode) -> monitor::Mode {
    use monitor::Mode as Told;
    match mode {
        Mode::Startup => Told::Startup,
        Mode::BusConfiguring => Told::BusConfiguring,
        Mode::DrivesOff => Told::DrivesOff,
        Mode::Unreferenced => Told::Unreferenced,
        Mode::Idle => Told::Idle,
        Mode::Homing => Told::Homing,
        Mode::Moving => Told::Moving,
        Mode::Drawing => Told::Drawing,
        Mode::Holding => Told::Holding,
        Mode::Stopping => Told::Stopping,
        Mode::Fault => Told::Fault,
    }
}

/// The drive that belongs to an axis.
pub(super) fn product(axis: &Axis) -> Product {
    match axis.mode {
        AxisMode::Velocity | AxisMode::Torque => Product::Ax2000,
        AxisMode::Position => Product::Cia402,
    }
}

fn by_torque(config: &Config) -> bool {
    config.axes.iter().any(|axis| axis.mode == AxisMode::Torque)
}

/// How far the tool may be from its setpoint, mm.
fn following_mm(config: &Config) -> f64 {
    if by_torque(config) {
        FOLLOWING_BY_TORQUE_MM
    } else {
        FOLLOWING_MM
    }
}

/// How far the ink of the test drawing may be from its line, mm. In torque mode the pen may leave the paper for a
/// moment, and the ink ends there.
pub(super) fn ink_limit_mm(config: &Config) -> f64 {
    let missing_mm = if by_torque(config) {
        INK_MISSING_BY_TORQUE_MM
    } else {
        0.0
    };
    config.motion.tolerance_mm + following_mm(config) + missing_mm
}

/// Slowest vertical speed of lowering and lifting, mm/s; 0 if only the limits of all motion apply. A lift by an output takes
/// the pen's time, less the part of it that a rounded corner saves.
fn pen_speed_mm_s(config: &Config) -> f64 {
    let (motion, paper, pen) = (&config.motion, &config.paper, &config.pen);
    let slowest_ms = f64::from(pen.down_ms.max(pen.up_ms));
    if !pen.kind.is_output() || slowest_ms == 0.0 {
        return motion.pen_speed_mm_s;
    }
    let lift_mm = (paper.pen_lift_mm - motion.travel_tolerance_mm).max(0.1 * paper.pen_lift_mm);
    let by_pen_mm_s = lift_mm * 1e3 / slowest_ms;
    match motion.pen_speed_mm_s > 0.0 {
        true => by_pen_mm_s.min(motion.pen_speed_mm_s),
        false => by_pen_mm_s,
    }
}

/// The configuration in the monitor's numbers.
fn cell(config: &Config) -> monitor::Cell {
    let usual = monitor::Cell::default();
    let (motion, paper) = (&config.motion, &config.paper);
    let ranges_rad = robot::ranges_rad(&config.geometry);
    // The height of a machine without an axis for it counts as a joint that stands.
    let axes = usize::from(config.bus.drives).max(MAIN_AXES);
    let joints = config
        .axes
        .iter()
        .take(axes)
        .enumerate()
        .map(|(axis, settings)| monitor::JointLimits {
            range_rad: ranges_rad[axis],
            speed_rad_s: motion.joint_speed_rad_s[axis],
            acceleration_rad_s2: motion.joint_acceleration_rad_s2[axis],
            quick_stop_rad_s2: settings.quick_stop_rad_s2,
            brake_rad_s2: crate::cell::BRAKE_RAD_S2,
            feedback_gain_per_s: settings.feedback_gain_per_s,
            following_error_max_rad: settings.following_error_max_rad,
            output_max_rad_s: settings.output_max_rad_s,
            search_rad_s: match settings.home.io {
                Some(_) => settings.home.speed_rad_s.abs().max(settings.home.latch_rad_s.abs()),
                None => 0.0,
            },
            mark_rad: settings.sync_angle_rad,
            turn_rad: core::f64::consts::TAU / settings.gear.abs(),
        });
    monitor::Cell {
        robot: robot::robot(&config.geometry),
        joints: joints.collect(),
        work_area: monitor::WorkArea {
            centre_mm: [0.0; 2],
            radius_mm: config.work_area.radius_mm,
            inner_radius_mm: config.work_area.inner_radius_mm,
            x_mm: config.work_area.x_mm,
            y_mm: config.work_area.y_mm,
            z_low_mm: config.work_area.z_low_mm,
            z_high_mm: config.work_area.z_high_mm,
        },
        paper: monitor::Paper {
            centre_mm: paper.centre_mm,
            size_mm: paper.size_mm,
            pen_down_z_mm: paper.pen_down_z_mm,
            pen_lift_mm: paper.pen_lift_mm,
            pressing_depth_mm: paper.pressing_depth_mm,
            slope: paper.slope,
            pen_spring_mm: PEN_SPRING_MM,
        },
        has_height_axis: has_height_axis(config),
        always_touches: config.pen.kind == PenLiftKind::None,
        tool_speed_mm_s: motion.speed_mm_s,
        travel_speed_mm_s: motion.travel_speed_mm_s,
        tool_acceleration_mm_s2: motion.acceleration_mm_s2,
        pen_speed_mm_s: pen_speed_mm_s(config),
        pen_acceleration_mm_s2: motion.pen_acceleration_mm_s2,
        pen_dwell_ms: motion.pen_dwell_ms.into(),
        tolerance_mm: motion.tolerance_mm,
        travel_tolerance_mm: motion.travel_tolerance_mm,
        dead_man_ms: config.bus.dead_man_ms.into(),
        blind_ms: config.bus.blind_max_ms.into(),
        watchdog_ms: config.bus.watchdog_ms.into(),
        host_silence_ms: config.bus.host_silence_ms.into(),
        following_mm: following_mm(config),
        undisturbed_mm: match config.axes.iter().all(|axis| axis.mode == AxisMode::Velocity) {
            true => UNDISTURBED_MM,
            false => following_mm(config),
        },
        kept_torque_mm_s2: if by_torque(config) {
            motion.acceleration_mm_s2
        } else {
            0.0
        },
        creep_ms: if by_torque(config) {
            CREEP_BY_TORQUE_MS
        } else {
            CREEP_MS
        },
        overshoot_part: if by_torque(config) {
            OVERSHOOT_BY_TORQUE
        } else {
            OVERSHOOT
        },
        overshoot_mm_s: if by_torque(config) {
            OVERSHOOT_BY_TORQUE_MM_S
        } else {
            usual.overshoot_mm_s
        },
        ink_missing_part: if by_torque(config) { INK_MISSING_BY_TORQUE } else { 0.0 },
        disturbed_mm: if config.axes.iter().any(|axis| axis.mode != AxisMode::Velocity) {
            ASTRAY_BY_SLIP_MM
        } else {
            usual.disturbed_mm
        },
        raw_wire: config.bus.transport == Transport::Raw,
        ..usual
    }
}

#[cfg(test)]
mod tests {
    use super::super::trouble;
    use super::*;

    fn fault(words: &str) -> Fault {
        words.parse().expect("words of the script")
    }

    #[test]
    fn what_was_put_right_is_judged_as_sound_again() {
        let config = Config::default();
        for words in [
            "cut 2",
            "remove 3",
            "swap 2 cia402",
            "swap 2 ax2000",
            "sii 1 blank",
            "refuse 1 op 0x001A",
            "recable 3 2",
            "mute 400",
            "deaf 4 400",
            "slip 2 10 50",
        ] {
            let mut judge = Judge::new(&config);
            for words in [Some(words.to_owned()), trouble::end(words)].into_iter().flatten() {
                judge.injected(fault(&words), 1, 1_000);
            }
            judge.end_disturbances(1_000 + AFTER_REPAIR_MS + 1);
            let left = (judge.disturbances, judge.untrue, judge.open.len());
            assert_eq!(left, (0, [0; AXES], 0), "{words}");
            assert_eq!(judge.asks_for_homing(), words.starts_with("slip"), "{words}");
            judge.reached(&Command::Home);
            judge.answered(&Command::Home, true);
            assert!(!judge.asks_for_homing());
        }

        let mut judge = Judge::new(&config);
        judge.injected(fault("remove 3"), 1, 1_000);
        judge.end_disturbances(1_000_000);
        assert_eq!(judge.disturbances, 1, "it is still missing");
    }

    /// The inputs of the monitor that tell of the second axis's feedback, since the last call.
    fn told(judge: &mut Judge) -> Vec<Input> {
        let of_axis = |input: &Input| matches!(input, Input::Feedback { axis: 1, .. } | Input::Mounted { axis: 1 });
        judge.inputs.drain(..).filter(of_axis).collect()
    }

    #[test]
    fn a_mounted_encoder_is_true_and_its_reference_once_the_robot_is_homed() {
        let mut judge = Judge::new(&Config::default());
        let home = |judge: &mut Judge| {
            judge.reached(&Command::Home);
            judge.answered(&Command::Home, true);
        };
        let untrue = Input::Feedback {
            axis: 1,
            disturbed: true,
        };
        let mounted = Input::Mounted { axis: 1 };
        for words in ["slip 2 10 50", "stuck 2 0"] {
            judge.injected(fault(words), 1, 1_000);
        }
        assert_eq!(told(&mut judge), [untrue, mounted]);
        assert!(judge.asks_for_homing());
        // Nobody homes by an encoder that slips.
        judge.injected(fault("slip 2 10 50"), 1, 2_000);
        assert!(!judge.asks_for_homing());
        home(&mut judge);
        judge.injected(fault("stuck 2 0"), 1, 3_000);
        assert_eq!(told(&mut judge), [untrue, mounted]);
        assert!(judge.asks_for_homing());
        home(&mut judge);
        assert!(!judge.asks_for_homing());
        // What passes ends by itself, but a robot that was homed meanwhile has an untrue reference.
        for homes in [false, true] {
            judge.injected(fault("stuck 2 20"), 1, 4_000);
            if homes {
                home(&mut judge);
            }
            judge.end_disturbances(5_000);
            let sound = Input::Feedback {
                axis: 1,
                disturbed: false,
            };
            assert_eq!(told(&mut judge), [untrue, sound]);
            assert_eq!(judge.asks_for_homing(), homes);
        }
    }

    #[test]
    fn a_search_shows_nothing_about_an_encoder_that_is_mounted_while_it_goes_on() {
        for (mounted_in_search, answer_lost) in [(false, false), (true, false), (true, true), (false, true)] {
            let mut judge = Judge::new(&Config::default());
            judge.has_switches = true;
            judge.injected(fault("slip 2 10 50"), 1, 4_000);
            if !mounted_in_search {
                judge.injected(fault("stuck 2 0"), 1, 4_500);
            }
            judge.reached(&Command::Home);
            if !answer_lost {
                judge.answered(&Command::Home, true);
            }
            if mounted_in_search {
                judge.injected(fault("stuck 2 0"), 1, 5_000);
            }
            // Another order is refused meanwhile, perhaps before the mode is told.
            judge.reached(&Command::Home);
            judge.answered(&Command::Home, false);
            judge.in_mode(Mode::Homing, false);
            judge.in_mode(Mode::Idle, true);
            assert_eq!(judge.asks_for_homing(), mounted_in_search || answer_lost);
        }
    }
}
