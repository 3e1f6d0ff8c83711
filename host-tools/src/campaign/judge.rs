//! Tells the monitor what happens: translates messages, states and faults into its words.
//!
//! Nothing is judged here. Commands are taken from the bytes that reached the board, after the line's noise.

mod bounds;
mod notices;

use super::Rule;
use super::machine::Chain;
use super::world::Frame;
use crate::cell::{Clocks, Fault, Product, ResolverFault, SiiFault, Truth};
pub(super) use bounds::{ink_limit_mm, product};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::link::device::REQUESTS_KEPT;
use etherpen::link::frame::{Decoder, decode};
use etherpen::messages::{Command, HostMessage, PathVertex, Status};
use etherpen::motion::Pen;
use etherpen::robots::AXES;
use etherpen_monitor as monitor;
use monitor::{Count, Input, Joint, Moment, Monitor, Report, WireFrame};
use notices::Notices;
use std::collections::VecDeque;

/// Most frames of a millisecond that are judged.
const FRAMES_MAX: usize = 16;
/// How long the bus needs after a disturbance was put right, ms.
const AFTER_REPAIR_MS: u64 = 3_000;
/// Time in which an axis goes back where it was led away by positions that were not true, ms.
const BACK_MS: u64 = 60;
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

/// A drawing that the operator orders.
struct Ordered {
    job: u16,
    path: Vec<Input>,
    /// Whether the monitor has been told the path: an earlier order of the number may be answered before.
    is_told: bool,
}

/// The monitor, and what it has to be told in this millisecond.
pub(super) struct Judge {
    monitor: Monitor,
    inputs: Vec<Input>,
    reports: Vec<Report>,
    decoder: Box<Decoder>,
    /// Numbers of the last commands, and whether each is a stop.
    known: VecDeque<(u16, bool)>,
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
    /// The drawing that the operator orders, until an order of its number is accepted behind its path.
    ordered: Option<Ordered>,
    finished: Option<u16>,
    notices: Notices,
}

impl Judge {
    pub(super) fn new(config: &Config) -> Self {
        let chain = Chain::new(config);
        Self {
            monitor: Monitor::new(bounds::cell(config)),
            inputs: Vec::new(),
            reports: Vec::new(),
            decoder: Box::default(),
            known: VecDeque::new(),
            interlocks: Interlocks::default(),
            ends: Vec::new(),
            disturbances: 0,
            open: Vec::new(),
            untrue: [0; AXES],
            unsure: [false; AXES],
            offered: [false; AXES],
            shown: [false; AXES],
            axes: config.bus.drives.into(),
            notices: Notices::new(config, &chain),
            chain,
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
        self.known.clear();
    }

    /// The board begins again, and with it what it has been told, ordered and reported.
    pub(super) fn board_was_reset(&mut self, config: &Config) {
        self.monitor = Monitor::new(bounds::cell(config));
        self.inputs.clear();
        self.reports.clear();
        (self.decoder, self.interlocks) = (Box::default(), Interlocks::default());
        (self.searches, self.configured) = (false, false);
        (self.ordered, self.finished) = (None, None);
        self.notices = Notices::new(config, &self.chain);
    }

    /// Takes bytes that reached the board.
    pub(super) fn delivered(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let Some(Ok(payload)) = self.decoder.push(*byte) else {
                continue;
            };
            match decode::<HostMessage>(payload) {
                Ok(HostMessage::Command { id, command }) if self.is_new(id, matches!(command, Command::Stop)) => {
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

    /// Whether a request is no repetition of one of the last ones: those are carried out once. A stop only repeats a stop.
    fn is_new(&mut self, id: u16, is_stop: bool) -> bool {
        if let Some((_, was_stop)) = self.known.iter_mut().find(|(known, _)| *known == id) {
            let is_new = is_stop && !*was_stop;
            *was_stop |= is_stop;
            return is_new;
        }
        if self.known.len() == REQUESTS_KEPT {
            self.known.pop_front();
        }
        self.known.push_back((id, is_stop));
        true
    }

    /// The operator orders a drawing.
    pub(super) fn orders(&mut self, job: u16, path: &[PathVertex]) {
        let inputs = (0..).zip(path).map(|(index, vertex)| Input::PathVertex {
            job,
            index,
            position_mm: vertex.position_um.map(|um| f64::from(um) / 1e3),
            pen_down: vertex.pen == Pen::Down,
        });
        self.ordered = Some(Ordered {
            job,
            path: inputs.collect(),
            is_told: false,
        });
        self.finished = None;
    }

    /// A command has reached the board. The path of a drawing follows each order of its number, until one
    /// that came with it is accepted: the operator sends the vertices then.
    fn reached(&mut self, command: &Command) {
        self.notices.commanded(command);
        self.inputs.extend(self.command_of(command).map(Input::Commanded));
        if matches!(command, Command::Home | Command::HomeAt { .. }) {
            self.offered = self.untrue.map(|disturbances| disturbances == 0);
        }
        if let Command::Draw { job } = *command
            && let Some(ordered) = self.ordered.as_mut().filter(|ordered| ordered.job == job)
        {
            self.inputs.extend_from_slice(&ordered.path);
            ordered.is_told = true;
        }
    }

    pub(super) fn answered(&mut self, command: &Command, accepted: bool) {
        let is_home = matches!(command, Command::Home) && !self.has_switches;
        if accepted && (is_home || matches!(command, Command::HomeAt { .. })) {
            self.homed(self.offered);
        } else if accepted && matches!(command, Command::Home) {
            self.shown = self.offered;
        }
        if let Command::Draw { job } = *command {
            self.ordered
                .take_if(|ordered| accepted && ordered.is_told && ordered.job == job);
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
        self.notices.reported(status, &self.chain);
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
        self.inputs.push(Input::Hidden);
        let noticeable = self.notices.of(fault, now_ms.into(), &self.chain);
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
        self.inputs.extend(noticeable);
    }

    /// The operator uses a service of the bus.
    pub(super) fn serviced(&mut self) {
        self.notices.serviced();
        self.inputs.push(Input::Hidden);
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
            self.ends_after(now_ms, lasts_ms + BACK_MS, Input::Feedback { axis, disturbed: false });
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

    /// Whether nothing keeps the positions of all axes from being true and reported.
    pub(super) fn shows_positions(&self) -> bool {
        self.disturbances == 0 && self.untrue.iter().all(|disturbances| *disturbances == 0)
    }

    /// The machine is disturbed for some milliseconds, or until it is healed.
    pub(super) fn disturbed(&mut self, now_ms: u32, lasts_ms: Option<u64>) {
        self.disturbances += 1;
        self.notices.disturbed();
        self.inputs.push(Input::Hidden);
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
        self.inputs.push(Input::Hidden);
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
        let is_disturbed = self.disturbances > 0
            || self.untrue.iter().any(|disturbances| *disturbances > 0)
            || interlocks.clock_failed;
        self.notices.step(
            now_ms,
            is_disturbed,
            interlocks.stop_open,
            truth.has_power.contains(&true),
        );
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
            is_switched_off: truth.is_switched_off[axis],
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

#[cfg(test)]
mod tests;
