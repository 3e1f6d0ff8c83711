//! The virtual cell: an EtherCAT segment with drives, motors, the robot and its pen.
//!
//! It replaces the hardware: the bus with its drives is [`etherpen_segment::Segment`], and its motors turn the robot
//! with pen and paper. [`Physics`] says how far they are from an ideal robot. The segment is written from the slave's side and shares names and layouts of registers and of
//! the SII with the master, but no logic. The robot's geometry is the controller's own
//! ([`etherpen::robots::Kinematics`]): an error in the kinematics would not show in the ink, so the kinematics have
//! tests of their own.
//!
//! Time is the segment's: everything advances once a millisecond, between the frames.
//!
//! Invariant: the same configuration, options and frames give the same ink, and no input panics.

mod calibration;
mod contact;
mod coupled;
mod dynamics;
mod faults;
mod joint;
mod machine;
mod mechanism;
mod neighbour;
mod paper;
mod pen_lift;
mod physics;
mod robot;
mod switches;
mod terminals;
mod tuning;
mod vibration;

pub use etherpen_segment::{
    AlState, Branch, ClockOptions, DriveState, Fault, MailFault, MailStep, OneTurn, PlaceOptions, Product,
    ResolverFault, SCRIPT_HELP, Script, SiiFault, SlaveKind, SlaveList, SlaveListError, SlaveState, parse_slaves,
};
pub use faults::read_faults;
pub use paper::{InkStroke, PEN_SPRING_MM};
pub use physics::{
    Backlash, Calibration, CellChoice, CellFileError, DeadTime, Friction, LoopKind, Payload, Physics, PositionLoop,
    Resolver, SheetPlace, StructuralMode, TorqueMeasurement, Value, VelocityLoop,
};
pub use terminals::usual_slaves;

use crate::random::Random;
use calibration::Residues;
use etherpen::config::{Axis, Config};
use etherpen::robots::{AXES, JointAngles, JointVelocities, Position};
use etherpen_segment::{Load, Segment, SegmentOptions};
use joint::Gear;
use machine::Machine;
use neighbour::Neighbour;
use pen_lift::PenOutput;
use std::collections::BTreeMap;
use switches::{Switches, starts_rad};
pub(crate) use tuning::BRAKE_RAD_S2;
use tuning::Commissioning;

/// Options of the cell, beyond the configuration.
#[derive(Clone, Debug)]
pub struct CellOptions {
    /// Drives, friction, play, vibration, payload and calibration.
    pub physics: Physics,
    /// Seed of all random values: starting pose, script's chances, resolvers' phases, signs of errors, late commands.
    pub seed: u64,
    /// Largest distance of a joint from its synchronisation angle at the start, radians.
    pub start_offset_max_rad: f64,
    /// Script of the faults.
    pub faults: Script,
    /// The slaves in the order of the chain; empty for [`usual_slaves`]. Drives belong to the configuration's axes in order;
    /// further drives move nothing.
    pub slaves: Vec<SlaveKind>,
    /// What is set on each slave. Drives beyond them have what their axes name, other slaves the default options.
    pub places: Vec<PlaceOptions>,
    /// Cables that do not lead from one slave to the next.
    pub branches: Vec<Branch>,
    /// Distributed clocks and the delays of the frames.
    pub clocks: ClockOptions,
    /// Busy time of a command to an information memory (SII), microseconds.
    pub sii_busy_us: u64,
}

impl Default for CellOptions {
    fn default() -> Self {
        Self {
            physics: Physics::NOMINAL,
            seed: 1,
            start_offset_max_rad: 0.1,
            faults: Script::default(),
            slaves: Vec::new(),
            places: Vec::new(),
            branches: Vec::new(),
            clocks: ClockOptions::default(),
            sii_busy_us: SegmentOptions::default().sii_busy_us,
        }
    }
}

/// The drive that an axis names: with its alias, its serial number and its switches.
fn expected(axis: &Axis) -> PlaceOptions {
    PlaceOptions {
        alias: axis.alias,
        serial: (axis.serial != 0).then_some(axis.serial),
        identification: (axis.switch != 0).then_some(axis.switch),
        ..PlaceOptions::default()
    }
}

/// The present state of the cell, for tests and displays.
#[derive(Clone, Debug, PartialEq)]
pub struct CellState {
    /// Milliseconds since the start.
    pub time_ms: u64,
    /// True joint angles, radians.
    pub joints: JointAngles,
    /// True joint speeds, rad/s.
    pub velocities: JointVelocities,
    /// Position of the platform; `None` if the joints cannot hold one.
    pub platform: Option<Position>,
    /// Whether the pen touches.
    pub pen_touches: bool,
    /// Milliseconds of contact off the sheet.
    pub contacts_outside: u64,
    /// How far the platform was below the height at which the pen draws, at most, mm.
    pub pressed_max_mm: f64,
    /// Milliseconds without a possible platform position.
    pub unreachable_ms: u64,
    /// Milliseconds in which an end stop held a joint.
    pub end_stop_ms: u64,
    /// EtherCAT frames received from the master.
    pub frames: u64,
    /// The slaves in the order of the chain.
    pub slaves: Vec<SlaveState>,
}

/// The motors and the pen at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// True joint angles, radians.
    pub angles_rad: [f64; AXES],
    /// True joint speeds, rad/s.
    pub speeds_rad_s: [f64; AXES],
    /// Whether the drive moves or holds its motor; otherwise the brake does.
    pub has_power: [bool; AXES],
    /// Whether an order took the motor's power within the last two milliseconds.
    pub is_switched_off: [bool; AXES],
    /// Whether the pen touches.
    pub pen_touches: bool,
}

/// Distributed clocks at one true moment.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Clocks {
    /// The moment, ns.
    pub time_ns: u64,
    /// System time of each slave's clock, ns, in the order of the chain; `None` for one without a clock, without power or not
    /// in OP.
    pub system_ns: Vec<Option<u64>>,
}

/// The virtual cell.
#[derive(Clone, Debug)]
pub struct Cell {
    segment: Segment<Machine>,
    /// The output that lowers the pen.
    pen: Option<PenOutput>,
    /// The output of a tool without which a pen that touches leaves no ink.
    tool: Option<PenOutput>,
    switches: Switches,
    /// Who tells the address of the next hop, with EtherCAT in UDP.
    neighbour: Option<Neighbour>,
}

impl Cell {
    /// A cell at rest, after power-up, with one drive for each of the configured axes (at most `bus.drives`).
    #[must_use]
    pub fn new(config: &Config, options: CellOptions) -> Self {
        let mut random = Random::new(options.seed);
        let slaves = match options.slaves.is_empty() {
            true => usual_slaves(config),
            false => options.slaves.clone(),
        };
        let residues = Residues::new(&config.geometry, &options.physics.calibration, options.seed);
        let mut commissioning = Commissioning::new(config, &options.physics, options.seed);
        let driven = slaves.iter().filter(|kind| kind.is_drive()).count();
        let starts_rad = starts_rad(config, driven, options.start_offset_max_rad, &mut random);
        let mut axes = config.axes.into_iter();
        let mut errors_rad = residues.sync_rad.into_iter();
        let (mut gears, mut drives) = (Vec::new(), Vec::new());
        let mut places = options.places;
        let mut joints = machine::resting(config);
        let mut angles = joints.0.iter_mut();
        for (number, kind) in slaves.iter().enumerate() {
            let axis = kind.is_drive().then(|| axes.next()).flatten().unwrap_or_default();
            let sync_rad = kind.is_drive().then(|| errors_rad.next()).flatten().unwrap_or(0.0);
            let gear = Gear::new(&axis, sync_rad);
            gears.push(gear);
            if kind.is_drive() {
                let angle_rad = gear.motor_rad(starts_rad.get(drives.len()).copied().unwrap_or(axis.sync_angle_rad));
                angles
                    .next()
                    .into_iter()
                    .for_each(|angle| *angle = gear.joint_rad(angle_rad));
                drives.push(commissioning.drive(drives.len(), &axis, angle_rad));
                if number >= places.len() {
                    places.resize(number, PlaceOptions::default());
                    places.push(expected(&axis));
                }
            }
        }
        let machine = Machine::new(config, gears, &joints, &options.physics, &residues);
        let segment = SegmentOptions {
            slaves,
            places,
            branches: options.branches,
            drives,
            clocks: options.clocks,
            sii_busy_us: options.sii_busy_us,
            faults: options.faults,
            seed: options.seed,
            fault_seed: random.bits(),
        };
        let segment = Segment::new(&segment, machine);
        let contacts = (0..segment.slaves().len()).map(|place| (place + 1, terminals::closed_contacts(config, place)));
        let contacts: Vec<(usize, u8)> = contacts.filter(|(_, closed)| *closed != 0).collect();
        let pen = PenOutput::new(config);
        let mut cell = Self {
            segment,
            pen,
            tool: PenOutput::of_tool(config),
            switches: Switches::new(config),
            neighbour: Neighbour::new(config),
        };
        for (slave, contacts) in contacts {
            cell.set_inputs(slave, &[contacts]);
        }
        cell.follow_machine();
        cell
    }

    /// Lowers or lifts the pen as its output says, and moves the contacts of the switches with the joints.
    fn follow_machine(&mut self) {
        if let Some(pen) = self.pen {
            let height = self
                .segment
                .outputs(pen.slave)
                .map_or(1.0, |outputs| pen.height(&outputs));
            self.segment.load_mut().move_pen(height);
        }
        if let Some(tool) = self.tool {
            let outputs = self.segment.outputs(tool.slave);
            let is_on = outputs.is_some_and(|outputs| tool.raw(&outputs) != 0);
            self.segment.load_mut().switch_tool(is_on);
        }
        if !self.switches.is_empty() {
            let angles_rad = self.truth().angles_rad;
            for (slave, inputs) in self.switches.step(&angles_rad) {
                self.segment.set_inputs(slave, &inputs);
            }
        }
    }

    /// Breaks the wires of all home switches, or mends them. A broken wire is an open contact.
    pub fn break_switches(&mut self, broken: bool) {
        self.switches.break_wires(broken);
    }

    /// Takes the home switches out of the way of their axes, or puts them back: without them the contacts stay closed.
    pub fn remove_switches(&mut self, removed: bool) {
        self.switches.remove(removed);
    }

    /// Pushes a joint, from 0, by hand to an angle, rad: at half a radian a second, against whatever holds it.
    pub fn push(&mut self, axis: usize, to_rad: f64) {
        self.segment.load_mut().push(axis, to_rad);
    }

    /// Advances the time to `time_us` on the caller's clock; an earlier time than before does nothing.
    pub fn advance_to(&mut self, time_us: u64) {
        self.follow_machine();
        self.segment.advance_to(time_us);
    }

    /// Passes an Ethernet frame through the segment at this time. Returns the replies in order: usually one, none for a
    /// lost or foreign frame, more if the script says so. With EtherCAT in UDP the request for the address of the next hop is
    /// answered.
    pub fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.frame_at_ns(time_us.saturating_mul(1_000), frame)
    }

    /// Passes a frame through the segment at a time in nanoseconds, which distributed clocks need; returns the replies.
    pub fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        if let Some(answer) = self.neighbour.and_then(|neighbour| neighbour.answer(frame)) {
            return vec![answer];
        }
        self.follow_machine();
        self.segment.frame_at_ns(time_ns, frame)
    }

    /// Passes the payload of EtherCAT in UDP, EtherCAT header and datagrams, through the segment; returns the replies.
    pub fn payload(&mut self, time_us: u64, payload: &[u8]) -> Vec<Vec<u8>> {
        self.follow_machine();
        self.segment.payload(time_us, payload)
    }

    /// Injects a fault: into the next frame, or at the next millisecond. Slaves count from 1.
    pub fn inject(&mut self, fault: Fault) {
        self.segment.inject(fault);
    }

    /// Number of injected faults of each kind, by its word in the script. Faults of frames count when they take effect,
    /// others when they begin.
    #[must_use]
    pub fn injected(&self) -> &BTreeMap<&'static str, u64> {
        self.segment.injected()
    }

    /// The segment with its slaves.
    pub(crate) fn segment_mut(&mut self) -> &mut Segment<impl Load> {
        &mut self.segment
    }

    /// The ink on the paper; the last stroke may still grow.
    #[must_use]
    pub fn ink(&self) -> &[InkStroke] {
        self.segment.load().sheet.ink()
    }

    /// Puts an empty sheet in the place of the one with the ink.
    #[cfg(test)]
    pub(crate) fn new_sheet(&mut self) {
        self.segment.load_mut().sheet.replace();
    }

    /// EtherCAT frames received from the master.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.segment.frames()
    }

    /// Sets the first inputs of a slave, from 1; the bytes behind them stay. No effect without inputs.
    pub fn set_inputs(&mut self, slave: usize, inputs: &[u8]) {
        self.switches.set(slave, inputs);
        self.segment.set_inputs(slave, inputs);
    }

    /// The outputs of a slave, from 1, as they act outside: 0 unless it is in OP and its watchdog runs. `None` for a
    /// slave without outputs, for a drive, and for a slave that does not exist.
    #[must_use]
    pub fn outputs(&self, slave: usize) -> Option<Vec<u8>> {
        self.segment.outputs(slave)
    }

    /// A file that was written to a slave, from 1; `None` if there is no such file, or the slave has no files.
    #[must_use]
    pub fn file(&self, slave: usize, name: &str) -> Option<&[u8]> {
        self.segment.file(slave, name)
    }

    /// True system times of the slaves' distributed clocks at one moment, ns; `None` for a slave without a clock.
    #[must_use]
    pub fn system_times_ns(&self) -> Vec<Option<u64>> {
        self.segment.system_times_ns()
    }

    /// The moment of [`Self::system_times_ns`] in true time, ns.
    #[must_use]
    pub fn true_time_ns(&self) -> u64 {
        self.segment.true_time_ns()
    }

    /// The motors and the pen at present.
    #[must_use]
    pub fn truth(&self) -> Truth {
        let machine = self.segment.load();
        let mut truth = Truth {
            angles_rad: machine.resting().0,
            pen_touches: machine.sheet.touching(),
            ..Truth::default()
        };
        let motors = self.segment.motors();
        let motors = motors.filter_map(|motor| Some((motor, machine.gear(motor.slave)?)));
        for (axis, (motor, gear)) in motors.take(AXES).enumerate() {
            truth.angles_rad[axis] = gear.joint_rad(motor.angle_rad);
            truth.speeds_rad_s[axis] = gear.joint_rad_s(motor.speed_rad_s);
            truth.has_power[axis] = motor.drive.has_power();
            truth.is_switched_off[axis] = motor.is_switched_off;
        }
        machine.behind_play(&mut truth.angles_rad, &mut truth.speeds_rad_s);
        truth
    }

    /// The distributed clocks of the slaves in OP.
    #[must_use]
    pub fn clocks(&self) -> Clocks {
        Clocks {
            time_ns: self.segment.true_time_ns(),
            system_ns: self.segment.operational_times_ns(),
        }
    }

    /// The present state of the cell.
    #[must_use]
    pub fn state(&self) -> CellState {
        let Machine { robot, sheet, .. } = self.segment.load();
        let truth = self.truth();
        CellState {
            time_ms: self.segment.time_ms(),
            joints: JointAngles(truth.angles_rad),
            velocities: JointVelocities(truth.speeds_rad_s),
            platform: robot.platform(),
            pen_touches: sheet.touching(),
            contacts_outside: sheet.contacts_outside(),
            pressed_max_mm: sheet.pressed_max_mm(),
            unreachable_ms: robot.unreachable_ms(),
            end_stop_ms: robot.end_stop_ms(),
            frames: self.segment.frames(),
            slaves: self.segment.slaves(),
        }
    }
}

#[cfg(test)]
mod master_tests;
#[cfg(test)]
mod tests;
