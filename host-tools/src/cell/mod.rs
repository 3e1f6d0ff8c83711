//! The virtual cell: an EtherCAT segment with drives, motors, the robot and its pen.
//!
//! It stands for the hardware, for any master: Ethernet frames go in at a time of the caller's clock, replies come
//! out, and what the motors did is on the sheet of paper. Bus and drives are written from the slave's side and share
//! names and layouts of registers and of the SII with the master, none of its logic. The robot's geometry is the
//! controller's own ([`etherpen::robots::Kinematics`]): an error in the kinematics would not show in the ink, so the
//! kinematics have tests of their own.
//!
//! Time: the first call sets the start. Drives, watchdogs, robot and paper advance once a millisecond, at boundaries
//! half a millisecond beside the first frame (and beside the first one after a long silence), so frames that come once
//! a millisecond may jitter by almost half of one without any effect. At each boundary a drive takes the outputs of `output_delay_cycles` milliseconds ago, moves
//! its motor over one millisecond, and shows the position of `input_delay_cycles` milliseconds ago: with delays of
//! zero a command in one frame is seen, a millisecond long, in the next frame's position.
//!
//! Invariant: the same configuration, options and frames give the same ink, and no input panics.

mod abort;
mod application;
mod ax2000;
pub mod capture;
mod clock;
mod coe;
mod controller;
mod coupler;
mod damage;
mod datagram;
mod device;
mod dictionary;
mod drive;
mod dynamics;
mod eeprom;
mod fault_kinds;
mod faults;
mod fmmu;
mod generic_drive;
mod image_device;
mod kind;
mod live_objects;
mod mechanism;
mod motor;
mod objects;
mod paper;
mod process_data;
mod registers;
mod resolver;
mod robot;
mod sdo_information;
mod segment;
mod servo;
mod servo_device;
mod sii;
mod slave;
mod sync_manager;

pub use application::AlState;
pub use ax2000::NAME;
pub use device::ClockWidth;
pub use drive::DriveState;
pub use eeprom::SiiFault;
pub use fault_kinds::{Fault, MailFault, MailStep, Product};
pub use faults::{SCRIPT_HELP, Script, ScriptError, ScriptProblem};
pub use kind::{SLAVES_MAX, SlaveKind, SlaveListError, parse_slaves};
pub use paper::{InkStroke, PEN_SPRING_MM};
pub use resolver::ResolverFault;

use crate::random::Random;
use controller::Nature;
use drive::Drive;
use dynamics::Dynamics;
use etherpen::config::Config;
use etherpen::robots::{AXES, JointAngles, JointVelocities, Position};
use faults::Schedule;
use paper::Sheet;
use robot::Robot;
use segment::{CellSegment, Now, TravelTimes};
use servo::Servo;
use slave::Slave;
use std::collections::BTreeMap;

/// Length of the cell's step, microseconds.
const STEP_US: u64 = 1000;
/// Distance of the boundaries from the whole milliseconds, microseconds.
const BOUNDARY_US: u64 = STEP_US / 2;
/// Silence of the master after which its next frame sets the boundaries anew, microseconds.
const SILENCE_US: u64 = 100_000;
/// Longest time that one call catches up, steps; a longer jump of the clock is passed over.
const CATCH_UP_STEPS_MAX: u64 = 600_000;
/// Longest delay between bus and motor, steps.
const DELAY_CYCLES_MAX: usize = 100;

/// Ethernet header around the payload of a datagram.
const ENVELOPE: [u8; 14] = [
    0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x88, 0xA4,
];
/// Makes the clocks' chances others than the rest.
const CLOCK_SEED: u64 = 0xC10C;
/// Makes the resolvers' noise another than the rest.
const RESOLVER_SEED: u64 = 0x5EED_0000;
/// Longest time a slave's clock has run at the start, ns.
const CLOCK_AGE_MAX_NS: u64 = 10_000_000_000;
/// Largest drift of a clock, parts per million.
const DRIFT_MAX_PPM: f64 = 1000.0;
/// Longest time through a cable or a slave, ns.
const TRAVEL_MAX_NS: u64 = 1_000_000;
/// Longest time of a command of an information memory, microseconds.
const SII_BUSY_MAX_US: u64 = 10_000_000;

/// What the cell is made of, beyond the configuration.
#[derive(Clone, Debug)]
pub struct CellOptions {
    /// Bandwidth of the drives' velocity loops, Hz.
    pub drive_bandwidth_hz: f64,
    /// Age of a position when the bus can read it, milliseconds.
    pub input_delay_cycles: usize,
    /// Age of a command when the motor obeys it, milliseconds.
    pub output_delay_cycles: usize,
    /// Seed of everything that is random: the starting pose and the script's chances.
    pub seed: u64,
    /// Largest distance of a joint from its synchronisation angle at the start, radians.
    pub start_offset_max_rad: f64,
    /// What goes wrong.
    pub faults: Script,
    /// The slaves in the order of the chain; empty: an AX2000 for each of the configured drives. Drives are the
    /// configuration's axes in their order, further ones move nothing.
    pub slaves: Vec<SlaveKind>,
    /// Distributed clocks and the way of the frames.
    pub clocks: ClockOptions,
    /// How long a command of an information memory is busy, microseconds.
    pub sii_busy_us: u64,
    /// Noise of the resolvers, increments at most.
    pub resolver_noise_increments: f64,
    /// Speed by which dry friction slows the drives' velocity loops down until their integral makes up for it, rad/s at
    /// the joint.
    pub friction_rad_s: f64,
    /// Dry friction of joints in torque mode, N m.
    pub dry_friction_nm: f64,
}

/// Distributed clocks of the slaves, and how long frames travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockOptions {
    /// Width of the clocks of all slaves that have one.
    pub width: ClockWidth,
    /// Largest drift of a slave's clock, in either direction, parts per million.
    pub drift_max_ppm: f64,
    /// Time through one cable, ns.
    pub cable_ns: u64,
    /// Time through one slave in one direction, ns.
    pub forwarding_ns: u64,
}

impl Default for ClockOptions {
    fn default() -> Self {
        Self {
            width: ClockWidth::Bits64,
            drift_max_ppm: 30.0,
            cable_ns: 50,
            forwarding_ns: 300,
        }
    }
}

impl Default for CellOptions {
    fn default() -> Self {
        Self {
            drive_bandwidth_hz: 100.0,
            input_delay_cycles: 1,
            output_delay_cycles: 1,
            seed: 1,
            start_offset_max_rad: 0.1,
            faults: Script::default(),
            slaves: Vec::new(),
            clocks: ClockOptions::default(),
            sii_busy_us: eeprom::BUSY_NS / 1000,
            resolver_noise_increments: 0.0,
            friction_rad_s: 0.0,
            dry_friction_nm: 0.3,
        }
    }
}

/// One slave as it is, for tests and displays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlaveState {
    /// State of the application layer.
    pub al_state: AlState,
    /// AL status code; 0 without an error.
    pub al_status_code: u16,
    /// State of the drive; switched off where there is none.
    pub drive: DriveState,
    /// Error code of the drive; 0 without a fault.
    pub drive_error: u16,
    /// Whether it has power.
    pub powered: bool,
}

/// The cell as it is, for tests and displays.
#[derive(Clone, Debug, PartialEq)]
pub struct CellState {
    /// Milliseconds since the start.
    pub time_ms: u64,
    /// True joint angles, radians.
    pub joints: JointAngles,
    /// True joint speeds, rad/s.
    pub velocities: JointVelocities,
    /// The platform; nothing where the joints cannot hold one.
    pub platform: Option<Position>,
    /// Whether the pen touches.
    pub pen_touches: bool,
    /// Milliseconds of contact beside the sheet.
    pub contacts_outside: u64,
    /// Milliseconds without a possible platform position.
    pub unreachable_ms: u64,
    /// Milliseconds in which an end stop held a joint.
    pub end_stop_ms: u64,
    /// EtherCAT frames that came from the master.
    pub frames: u64,
    /// The slaves in the order of the chain.
    pub slaves: Vec<SlaveState>,
}

/// The virtual cell.
#[derive(Clone, Debug)]
pub struct Cell {
    segment: CellSegment,
    robot: Robot,
    dynamics: Dynamics,
    sheet: Sheet,
    schedule: Schedule,
    boundary_us: Option<u64>,
    last_frame_us: Option<u64>,
    steps: u64,
}

impl Cell {
    /// A cell at rest, after power-up, with one drive for each of the configured axes (at most `bus.drives`).
    #[must_use]
    pub fn new(config: &Config, options: CellOptions) -> Self {
        let mut random = Random::new(options.seed);
        let output_delay = options.output_delay_cycles.min(DELAY_CYCLES_MAX);
        let input_delay = options.input_delay_cycles.min(DELAY_CYCLES_MAX);
        let drives = usize::from(config.bus.drives).min(config.axes.len());
        let kinds = match options.slaves.len() {
            0 => vec![SlaveKind::Ax2000; drives],
            _ => options.slaves.clone(),
        };
        let mut axes = config.axes.into_iter();
        let mut clocks = Random::new(options.seed ^ CLOCK_SEED);
        let slaves = (1..).zip(&kinds).map(|(serial, kind)| {
            let servo = kind.is_drive().then(|| {
                let axis = axes.next().unwrap_or_default();
                let offset_rad = (2.0 * random.unit() - 1.0) * options.start_offset_max_rad;
                let noise_seed = options.seed ^ (RESOLVER_SEED + u64::from(serial));
                let drive = Drive::new(axis, axis.sync_angle_rad + offset_rad, options.drive_bandwidth_hz)
                    .with_imperfections(options.friction_rad_s, options.resolver_noise_increments, noise_seed);
                Servo::new(drive, output_delay, input_delay)
            });
            Slave::new(
                kind.device(servo, serial),
                options.clocks.width,
                nature(&mut clocks, &options),
            )
        });
        let segment = CellSegment::new(
            slaves.collect(),
            TravelTimes {
                cable_ns: options.clocks.cable_ns.min(TRAVEL_MAX_NS),
                forwarding_ns: options.clocks.forwarding_ns.min(TRAVEL_MAX_NS),
            },
        );
        let mut robot = Robot::new(&config.geometry);
        robot.step(&joints(&segment));
        Self {
            segment,
            robot,
            dynamics: Dynamics::new(&config.geometry, options.dry_friction_nm),
            sheet: Sheet::new(config.paper),
            schedule: Schedule::new(&options.faults, random.bits()),
            boundary_us: None,
            last_frame_us: None,
            steps: 0,
        }
    }

    /// Lets time pass up to `time_us` on the caller's clock; an earlier time than before does nothing.
    pub fn advance_to(&mut self, time_us: u64) {
        let earliest_us = time_us.saturating_sub(CATCH_UP_STEPS_MAX * STEP_US);
        let first_us = time_us.saturating_add(BOUNDARY_US);
        let mut boundary_us = self.boundary_us.unwrap_or(first_us).max(earliest_us);
        while boundary_us <= time_us && boundary_us < u64::MAX {
            self.step(boundary_us.saturating_mul(1000));
            boundary_us = boundary_us.saturating_add(STEP_US);
        }
        self.boundary_us = Some(boundary_us);
    }

    /// Lets an Ethernet frame pass at this time; gives what comes back, in order: usually one reply, none for a lost
    /// or foreign frame, more where the script says so.
    pub fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.frame_at_ns(time_us.saturating_mul(1000), frame)
    }

    /// Passes a frame through the segment at a time in nanoseconds, which distributed clocks need; returns the replies.
    pub fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        let time_us = time_ns / 1000;
        self.advance_to(time_us);
        let frames = self.segment.frames();
        let now = Now {
            ms: self.steps,
            ns: time_ns,
        };
        let replies = self.segment.frame(frame, now, &mut self.schedule);
        if self.segment.frames() > frames {
            self.follow(time_us);
        }
        replies
    }

    /// Lets the payload of an EtherCAT datagram in UDP pass: EtherCAT header and datagrams in, the same out.
    pub fn payload(&mut self, time_us: u64, payload: &[u8]) -> Vec<Vec<u8>> {
        let mut frame = ENVELOPE.to_vec();
        frame.extend_from_slice(payload);
        let replies = self.frame(time_us, &frame);
        let strip = |reply: Vec<u8>| reply.get(ENVELOPE.len()..).map(<[u8]>::to_vec);
        replies
            .into_iter()
            .filter(|reply| reply.get(12..14) == ENVELOPE.get(12..14))
            .filter_map(strip)
            .collect()
    }

    /// Lets a fault happen: to the next frame, or at the next millisecond. Slaves count from 1.
    pub fn inject(&mut self, fault: Fault) {
        self.schedule.inject(fault);
    }

    /// How often each kind of fault has happened, by its word in the script. Faults of frames count where they had an
    /// effect, the others when they began.
    #[must_use]
    pub fn injected(&self) -> &BTreeMap<&'static str, u64> {
        self.schedule.counts()
    }

    /// The ink on the paper; the last stroke may still grow.
    #[must_use]
    pub fn ink(&self) -> &[InkStroke] {
        self.sheet.ink()
    }

    /// EtherCAT frames that came from the master.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.segment.frames()
    }

    /// The cell as it is now.
    #[must_use]
    pub fn state(&self) -> CellState {
        let mut velocities = [0.0; AXES];
        for (velocity, drive) in velocities.iter_mut().zip(self.segment.drives()) {
            *velocity = drive.joint_rad_s();
        }
        let slaves = self.segment.slaves().iter().map(|slave| SlaveState {
            al_state: slave.state(),
            al_status_code: slave.al_status_code(),
            drive: slave.drive().map_or(DriveState::SwitchOnDisabled, Drive::state),
            drive_error: slave.drive().map_or(0, Drive::error_code),
            powered: slave.is_powered(),
        });
        CellState {
            time_ms: self.steps,
            joints: joints(&self.segment),
            velocities: JointVelocities(velocities),
            platform: self.robot.platform(),
            pen_touches: self.sheet.touching(),
            contacts_outside: self.sheet.contacts_outside(),
            unreachable_ms: self.robot.unreachable_ms(),
            end_stop_ms: self.robot.end_stop_ms(),
            frames: self.segment.frames(),
            slaves: slaves.collect(),
        }
    }

    /// Puts the boundaries half a millisecond beside a frame that is the first or comes after a long silence.
    fn follow(&mut self, time_us: u64) {
        let silent = self
            .last_frame_us
            .is_none_or(|last_us| time_us.saturating_sub(last_us) >= SILENCE_US);
        if silent {
            self.boundary_us = Some(time_us.saturating_add(BOUNDARY_US));
        }
        self.last_frame_us = Some(time_us.max(self.last_frame_us.unwrap_or(0)));
    }

    fn step(&mut self, now_ns: u64) {
        self.steps += 1;
        for fault in self.schedule.at_time(self.steps) {
            self.segment.apply(fault, self.steps);
            self.schedule.count(fault);
        }
        self.segment.step(now_ns);
        self.dynamics.step(self.segment.drives_mut());
        for (axis, drive) in self.segment.drives_mut().enumerate() {
            self.robot.limit(axis, drive);
        }
        self.segment.sample();
        if let Some(platform) = self.robot.step(&joints(&self.segment)) {
            self.sheet.step(self.steps, platform);
        }
    }
}

fn nature(random: &mut Random, options: &CellOptions) -> Nature {
    let drift_ppm = options.clocks.drift_max_ppm.clamp(0.0, DRIFT_MAX_PPM);
    Nature {
        drift_ppb: ((2.0 * random.unit() - 1.0) * drift_ppm * 1000.0) as i64,
        local_ns: random.bits() % CLOCK_AGE_MAX_NS,
        sii_busy_ns: options.sii_busy_us.min(SII_BUSY_MAX_US) * 1000,
    }
}

fn joints(segment: &CellSegment) -> JointAngles {
    let mut joints = [0.0; AXES];
    for (joint, drive) in joints.iter_mut().zip(segment.drives()) {
        *joint = drive.joint_rad();
    }
    JointAngles(joints)
}

#[cfg(test)]
mod device_tests;
#[cfg(test)]
mod fault_tests;
#[cfg(test)]
mod master_tests;
#[cfg(test)]
mod replay_tests;
#[cfg(test)]
mod rig;
#[cfg(test)]
mod tests;
