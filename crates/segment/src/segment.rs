//! The segment in virtual time: frames go in at a time of the caller's clock, replies come out.
//!
//! Time: the first call sets the start. Drives, watchdogs and load advance once a millisecond, at boundaries half a
//! millisecond away from the first frame (and from the first one after a long silence), so frames that come once a
//! millisecond may jitter by almost half a millisecond without any effect. Where slaves obey SYNC0 with a period of whole
//! milliseconds, the boundaries follow their pulses by 2 us instead. At each boundary a drive takes the outputs
//! of `output_delay_ms` ago, moves its motor over one millisecond, and shows the position of `input_delay_ms` ago: with
//! delays of zero, the next frame's position shows one millisecond of motion under the previous frame's command.
//!
//! Invariant: the same options and frames give the same replies and motions, and no input panics.

use crate::application::AlState;
use crate::chain::{Chain, Now};
use crate::controller::Nature;
use crate::controller::silicon::ClockWidth;
use crate::devices::kind::SlaveKind;
use crate::drive::servo::Servo;
use crate::drive::{Drive, DriveOptions, DriveState};
use crate::eeprom;
use crate::faults::kinds::Fault;
use crate::faults::{Schedule, Script};
use crate::load::Load;
use crate::random::Random;
use crate::rig::Bus;
use crate::slave::Slave;
use crate::slave::options::{PlaceOptions, SlaveOptions};
use crate::wiring::{Branch, TravelTimes};
use std::collections::BTreeMap;

/// Length of a step, microseconds.
const STEP_US: u64 = 1000;
/// Distance of the boundaries from the whole milliseconds, microseconds.
const BOUNDARY_US: u64 = STEP_US / 2;
/// Distance of a boundary from the SYNC0 pulses before it, microseconds: more than settled clocks differ.
const BEHIND_PULSE_US: u64 = 2;
/// Silence of the master after which its next frame sets the boundaries again, microseconds.
const SILENCE_US: u64 = 100_000;
/// Longest time that one call catches up, ms; a longer jump of the clock is passed over.
pub const CATCH_UP_MS_MAX: u64 = 600_000;

/// Ethernet header around the payload of a datagram.
const ENVELOPE: [u8; 14] = [
    0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x88, 0xA4,
];
/// Gives the clocks random numbers of their own.
const CLOCK_SEED: u64 = 0xC10C;
/// Gives the resolvers' noise random numbers of its own.
const RESOLVER_SEED: u64 = 0x5EED_0000;
/// Longest time a slave's clock has run at the start, ns.
const CLOCK_AGE_MAX_NS: u64 = 10_000_000_000;
/// Largest drift of a clock, parts per million.
const DRIFT_MAX_PPM: f64 = 1000.0;
/// Longest time through a cable or a slave, ns.
const TRAVEL_MAX_NS: u64 = 1_000_000;
/// Longest time of a command of an information memory, microseconds.
const SII_BUSY_MAX_US: u64 = 10_000_000;

/// Slaves, drives, clocks, faults and seeds of a segment.
#[derive(Clone, Debug)]
pub struct SegmentOptions {
    /// The slaves in the order of the chain.
    pub slaves: Vec<SlaveKind>,
    /// What is set on the slaves, in the order of the chain; slaves beyond them have the default options.
    pub places: Vec<PlaceOptions>,
    /// Cables that do not lead from one slave to the next: the others are a line. Slaves whose numbers follow the frame's
    /// way (ports 3, 1 and 2 of each) have the positions that a master counts.
    pub branches: Vec<Branch>,
    /// The drives in the order of the chain; drives beyond them have the default options.
    pub drives: Vec<DriveOptions>,
    /// Distributed clocks and propagation times of the frames.
    pub clocks: ClockOptions,
    /// How long a command of an information memory is busy, microseconds; at most 10 s.
    pub sii_busy_us: u64,
    /// Scripted faults.
    pub faults: Script,
    /// Seed of clocks and resolvers.
    pub seed: u64,
    /// Seed of the script's chances.
    pub fault_seed: u64,
}

impl Default for SegmentOptions {
    fn default() -> Self {
        Self {
            slaves: Vec::new(),
            places: Vec::new(),
            branches: Vec::new(),
            drives: Vec::new(),
            clocks: ClockOptions::default(),
            sii_busy_us: eeprom::BUSY_NS / 1000,
            faults: Script::default(),
            seed: 1,
            fault_seed: 1,
        }
    }
}

/// Distributed clocks of the slaves, and how long frames travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockOptions {
    /// Width of the clocks of all slaves that have one, but for those whose kind or place says another.
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

/// State of one slave, for tests and displays.
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
    /// Whether frames of the master reach it.
    pub reached: bool,
}

/// State of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorState {
    /// The slave that has it: its place in the chain at the start, from 1.
    pub slave: usize,
    /// State of its drive.
    pub drive: DriveState,
    /// Whether an order took the motor's power within the last two milliseconds.
    pub is_switched_off: bool,
    /// True angle, rad.
    pub angle_rad: f64,
    /// True speed, rad/s.
    pub speed_rad_s: f64,
}

/// A virtual EtherCAT segment whose motors turn a load.
#[derive(Clone, Debug)]
pub struct Segment<L> {
    chain: Chain,
    load: L,
    schedule: Schedule,
    boundary_us: Option<u64>,
    last_frame_us: Option<u64>,
    steps: u64,
}

impl<L: Load> Segment<L> {
    /// A segment at rest, after power-up.
    #[must_use]
    pub fn new(options: &SegmentOptions, load: L) -> Self {
        let mut clocks = Random::new(options.seed ^ CLOCK_SEED);
        let mut drives = options.drives.iter();
        let mut places = options.places.iter().copied();
        let slaves = (1..).zip(&options.slaves).map(|(serial, kind)| {
            let servo = kind.is_drive().then(|| {
                let noise_seed = options.seed ^ (RESOLVER_SEED + u64::from(serial));
                match drives.next() {
                    Some(drive) => Servo::new(drive, noise_seed),
                    None => Servo::new(&DriveOptions::default(), noise_seed),
                }
            });
            Slave::new(
                kind.device(servo, serial),
                places.next().unwrap_or_default(),
                options.clocks.width,
                nature(&mut clocks, options),
            )
        });
        let travel = TravelTimes {
            cable_ns: options.clocks.cable_ns.min(TRAVEL_MAX_NS),
            forwarding_ns: options.clocks.forwarding_ns.min(TRAVEL_MAX_NS),
        };
        Self {
            chain: Chain::new(slaves.collect(), &options.branches, travel),
            load,
            schedule: Schedule::new(&options.faults, options.fault_seed),
            boundary_us: None,
            last_frame_us: None,
            steps: 0,
        }
    }

    /// Lets time pass up to `time_us` on the caller's clock; an earlier time has no effect.
    pub fn advance_to(&mut self, time_us: u64) {
        let earliest_us = time_us.saturating_sub(CATCH_UP_MS_MAX * STEP_US);
        let first_us = time_us.saturating_add(BOUNDARY_US);
        let mut boundary_us = self.boundary_us.unwrap_or(first_us).max(earliest_us);
        while boundary_us <= time_us && boundary_us < u64::MAX {
            self.step(boundary_us.saturating_mul(1000));
            boundary_us = boundary_us.saturating_add(self.step_us());
        }
        self.boundary_us = Some(boundary_us);
    }

    /// Passes an Ethernet frame at this time; returns the replies in order: usually one, none for a lost or foreign
    /// frame, more if the script says so.
    pub fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.frame_at_ns(time_us.saturating_mul(1000), frame)
    }

    /// Passes a frame through the segment at a time in nanoseconds, which distributed clocks need; returns the replies.
    pub fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        let time_us = time_ns / 1000;
        self.advance_to(time_us);
        let frames = self.chain.frames();
        let now = Now {
            ms: self.steps,
            ns: time_ns,
        };
        let replies = self.chain.frame(frame, now, &mut self.schedule);
        if self.chain.frames() > frames {
            self.follow(time_us);
        }
        replies
    }

    /// Passes the payload of an EtherCAT packet in UDP: EtherCAT header and datagrams, in both directions.
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

    /// Injects a fault: into the next frame, or at the next millisecond. Slaves count from 1.
    pub fn inject(&mut self, fault: Fault) {
        self.schedule.inject(fault);
    }

    /// How often each kind of fault has happened, by its word in the script. Faults of frames count where they had an
    /// effect, the others when they began.
    #[must_use]
    pub fn injected(&self) -> &BTreeMap<&'static str, u64> {
        self.schedule.counts()
    }

    /// Milliseconds since the start.
    #[must_use]
    pub fn time_ms(&self) -> u64 {
        self.steps
    }

    /// How long a frame travels through the slaves and back at present, ns; `None` if it does not come back.
    #[must_use]
    pub fn travel_ns(&self) -> Option<u64> {
        self.chain.travel_ns()
    }

    /// EtherCAT frames that came from the master.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.chain.frames()
    }

    /// Present states of the slaves, in the order of the chain.
    #[must_use]
    pub fn slaves(&self) -> Vec<SlaveState> {
        let reached = self.chain.reached();
        let states = self
            .chain
            .slaves()
            .iter()
            .zip(reached)
            .map(|(slave, reached)| SlaveState {
                al_state: slave.state(),
                al_status_code: slave.al_status_code(),
                drive: slave.drive().map_or(DriveState::SwitchOnDisabled, Drive::state),
                drive_error: slave.drive().map_or(0, Drive::error_code),
                powered: slave.is_powered(),
                reached,
            });
        states.collect()
    }

    /// System times of the slaves' distributed clocks at one true moment, ns, in the order of the chain; `None` for a
    /// slave without a clock. This is the truth: no frame and no delay is between it and the clocks.
    #[must_use]
    pub fn system_times_ns(&self) -> Vec<Option<u64>> {
        let now_ns = self.true_time_ns();
        let slaves = self.chain.slaves();
        slaves.iter().map(|slave| slave.system_at_ns(now_ns)).collect()
    }

    /// System times of the distributed clocks of the slaves in OP at one true moment, ns, in the order of the chain. `None` for a
    /// slave without a clock, without power or not in OP: its clock may be wrong, or be set.
    #[must_use]
    pub fn operational_times_ns(&self) -> Vec<Option<u64>> {
        let now_ns = self.true_time_ns();
        let is_in_operation = |slave: &&Slave| slave.is_powered() && slave.state() == AlState::Operational;
        let of = |slave: &Slave| Some(slave).filter(is_in_operation)?.system_at_ns(now_ns);
        self.chain.slaves().iter().map(of).collect()
    }

    /// True time up to which the slaves have run, ns: the moment of [`Self::system_times_ns`].
    #[must_use]
    pub fn true_time_ns(&self) -> u64 {
        let slaves = self.chain.slaves();
        slaves.iter().map(|slave| slave.now_ns()).max().unwrap_or(0)
    }

    /// Present states of the motors, in the order that their drives had in the chain at the start.
    pub fn motors(&self) -> impl Iterator<Item = MotorState> {
        let drives = self.chain.drives().into_iter();
        drives.map(|(slave, drive)| MotorState {
            slave,
            drive: drive.state(),
            is_switched_off: drive.is_switched_off(),
            angle_rad: drive.motor().angle_rad(),
            speed_rad_s: drive.motor().speed_rad_s(),
        })
    }

    /// The inputs of a slave, from 1, that are set from outside: the bytes of its input sync managers, one behind the
    /// other. `None` for a slave without inputs, for a drive, and for a slave that does not exist.
    #[must_use]
    pub fn inputs(&self, slave: usize) -> Option<Vec<u8>> {
        self.chain.slave(slave)?.inputs().map(<[u8]>::to_vec)
    }

    /// Sets the first inputs of a slave, from 1; the bytes behind them stay. No effect without inputs.
    pub fn set_inputs(&mut self, slave: usize, inputs: &[u8]) {
        self.chain.with(slave, |slave| slave.set_inputs(inputs));
    }

    /// The outputs of a slave, from 1, as they act outside: 0 unless it is in OP and its watchdog runs. `None` for a
    /// slave without outputs, for a drive, and for a slave that does not exist.
    #[must_use]
    pub fn outputs(&self, slave: usize) -> Option<Vec<u8>> {
        self.chain.slave(slave)?.outputs()
    }

    /// Content of a file that a slave, from 1, keeps for access over EtherCAT (FoE); `None` if there is none.
    #[must_use]
    pub fn file(&self, slave: usize, name: &str) -> Option<&[u8]> {
        self.chain.slave(slave)?.file(name)
    }

    /// Stores a file in a slave, from 1.
    pub fn store_file(&mut self, slave: usize, name: &str, content: &[u8]) {
        self.chain.with(slave, |slave| slave.store_file(name, content));
    }

    /// Sets what the processor of a slave, from 1, is like. The processor starts at once and at every power-up.
    pub fn set_slave_options(&mut self, slave: usize, options: SlaveOptions) {
        self.chain.with(slave, |slave| slave.set_options(options));
    }

    /// The load that the motors turn.
    #[must_use]
    pub fn load(&self) -> &L {
        &self.load
    }

    /// What the motors turn, to change it.
    pub fn load_mut(&mut self) -> &mut L {
        &mut self.load
    }

    /// Puts the boundaries half a millisecond away from a frame that is the first or comes after a long silence.
    fn follow(&mut self, time_us: u64) {
        let silent = self
            .last_frame_us
            .is_none_or(|last_us| time_us.saturating_sub(last_us) >= SILENCE_US);
        if silent {
            self.boundary_us = Some(time_us.saturating_add(BOUNDARY_US));
        }
        self.last_frame_us = Some(time_us.max(self.last_frame_us.unwrap_or(0)));
    }

    /// Time to the next boundary, microseconds: it is just behind the pulses of the slaves that obey SYNC0 in whole
    /// milliseconds, and otherwise a millisecond from the last one.
    fn step_us(&self) -> u64 {
        let Some(ahead_ns) = self.chain.pulse_ahead_ns() else {
            return STEP_US;
        };
        let behind_us = (ahead_ns.div_ceil(1000) + BEHIND_PULSE_US) % STEP_US;
        match behind_us > BOUNDARY_US {
            true => behind_us,
            false => behind_us + STEP_US,
        }
    }

    fn step(&mut self, now_ns: u64) {
        self.steps += 1;
        for fault in self.schedule.at_time(self.steps) {
            self.chain.apply(fault, self.steps);
            self.schedule.count(fault);
        }
        self.chain.step(now_ns);
        self.load.step(self.steps, &mut self.chain.shafts());
        self.chain.sample();
    }
}

impl<L: Load> Bus for Segment<L> {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.frame(time_us, frame)
    }
}

fn nature(random: &mut Random, options: &SegmentOptions) -> Nature {
    let drift_ppm = options.clocks.drift_max_ppm.clamp(0.0, DRIFT_MAX_PPM);
    Nature {
        drift_ppb: ((2.0 * random.unit() - 1.0) * drift_ppm * 1000.0) as i64,
        local_ns: random.bits() % CLOCK_AGE_MAX_NS,
        sii_busy_ns: options.sii_busy_us.min(SII_BUSY_MAX_US) * 1000,
        ..Nature::default()
    }
}
