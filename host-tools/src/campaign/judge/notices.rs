//! Which faults the controller can notice for certain, how it reports them, and by when.
//!
//! Only faults of a machine that nothing else disturbs: two faults at once may hide each other. The milliseconds are those of
//! `docs/faults.md` with a margin.

use super::super::machine::Chain;
use crate::cell::Fault;
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::ethercat::state::AlState;
use etherpen::messages::{Command, Status};
use etherpen::robots::AXES;
use etherpen_monitor::{Input, Notice};
use std::f64::consts::TAU;

/// How long nothing has to be disturbed before a fault that the supervision of the bus notices, and before one of the critical
/// task, ms.
const CALM_BUS_MS: u64 = 1_000;
const CALM_TASK_MS: u64 = 300;
/// Longest time from a decision of the controller to a report of it, ms, with a margin.
const REPORTED_MS: u64 = 300;
/// Time of the processor's watchdog, ms.
const PROCESSOR_MS: u64 = 100;
/// Longest time until each slave's counter has been read once, ms for each slave: one is read every 20 ms.
const ROUND_MS: u64 = 40;
/// Milliseconds of lost outputs beyond the limit that are noticed for certain.
const LOST_MORE_MS: u64 = 4;
/// Longest gap of an axis's positions that leaves it homed at rest, ms (`GAP_AT_REST_MAX_MS` in `src/control/robot_axes.rs`), and
/// one that does not for certain.
const GAP_MS: u64 = 500;
const GAP_CERTAIN_MS: u64 = 600;
/// How long the drives have no power before a jump is noticed as one of a joint without power, ms.
const UNPOWERED_MS: u64 = 100;
/// Acceleration of a joint without power that is a jump for certain, rad/s2: five times the controller's limit, because one
/// position may be reported twice.
const JUMP_RAD_S2: f64 = 5_000.0;

/// What is known about the machine before a fault.
#[derive(Clone, Debug)]
pub(super) struct Notices {
    /// Since when nothing is disturbed and no fault is reported, ms.
    calm_since_ms: Option<u64>,
    /// Since when nothing is disturbed and all slaves are reported in OP, whatever fault is latched, ms.
    whole_since_ms: Option<u64>,
    /// Since when no drive has power, ms.
    unpowered_since_ms: Option<u64>,
    /// Whether the last report tells of no fault, and of all slaves in OP.
    is_well: bool,
    is_whole: bool,
    /// Whether the drives have power in the mode that was reported last.
    is_powered: bool,
    is_homed: bool,
    /// Whether a slave may be slow, or was asked for something by the operator, so that the supervision waits for it.
    is_busy: bool,
    /// From how many milliseconds on lost outputs are a fault.
    lost_ms: u64,
    has_output_frames: bool,
    slaves: u64,
    /// Least and largest jump of each axis that is one for certain, increments.
    jumps: [[f64; 2]; AXES],
}

impl Notices {
    pub(super) fn new(config: &Config, chain: &Chain) -> Self {
        Self {
            calm_since_ms: None,
            whole_since_ms: None,
            unpowered_since_ms: None,
            is_well: false,
            is_whole: false,
            is_powered: false,
            is_homed: false,
            is_busy: false,
            lost_ms: u64::from(config.bus.blind_max_ms).max(2),
            has_output_frames: config.bus.exchange != ExchangeKind::Combined,
            slaves: chain.slaves as u64,
            jumps: config.axes.each_ref().map(|axis| {
                let increments = f64::from(axis.increments_per_revolution);
                let least = JUMP_RAD_S2 * axis.gear.abs() * increments / TAU / 1e6 + 10.0;
                [least, increments / 4.0]
            }),
        }
    }

    /// The operator uses a service of the bus, which may take any time.
    pub(super) fn serviced(&mut self) {
        self.is_busy = true;
    }

    /// Something is disturbed, or ordered, that decides what is noticed.
    pub(super) fn disturbed(&mut self) {
        (self.calm_since_ms, self.whole_since_ms) = (None, None);
    }

    /// A command has reached the board.
    pub(super) fn commanded(&mut self, command: &Command) {
        let changes = matches!(
            command,
            Command::Stop
                | Command::Acknowledge
                | Command::Enable
                | Command::Disable
                | Command::Home
                | Command::HomeAt { .. }
        );
        if changes {
            self.calm_since_ms = None;
        }
        // A new reference is reported later.
        if matches!(command, Command::Home | Command::HomeAt { .. }) {
            self.whole_since_ms = None;
        }
        self.is_powered &= !changes;
    }

    pub(super) fn reported(&mut self, status: &Status, chain: &Chain) {
        let slaves = (1..).zip(&status.slaves);
        let is_in_op = |(place, al_state): (usize, u8)| !chain.is_used(place) || al_state == AlState::Operational as u8;
        self.is_whole = !status.recovering && slaves.map(|(place, slave)| (place, slave.al_state)).all(is_in_op);
        self.is_powered = matches!(
            status.mode,
            Mode::Unreferenced | Mode::Idle | Mode::Homing | Mode::Moving | Mode::Drawing | Mode::Holding
        );
        let is_quiet = self.is_powered || status.mode == Mode::DrivesOff;
        self.is_well = is_quiet && self.is_whole && status.fault.is_none();
        self.is_homed = status.referenced;
    }

    /// Takes a millisecond: whether something is disturbed, whether the board's inputs demand a stop, whether a drive has power.
    pub(super) fn step(&mut self, now_ms: u64, is_disturbed: bool, is_stopped: bool, has_power: bool) {
        let since = |is_so: bool, since_ms: Option<u64>| is_so.then(|| since_ms.unwrap_or(now_ms));
        self.calm_since_ms = since(self.is_well && !is_disturbed && !is_stopped, self.calm_since_ms);
        self.whole_since_ms = since(self.is_whole && !is_disturbed, self.whole_since_ms);
        self.unpowered_since_ms = since(!has_power, self.unpowered_since_ms);
    }

    /// What the controller has to report of a fault that begins now, if it can notice it for certain.
    pub(super) fn of(&mut self, fault: Fault, now_ms: u64, chain: &Chain) -> Option<Input> {
        let passed_ms = |since_ms: Option<u64>| since_ms.map_or(0, |since_ms| now_ms.saturating_sub(since_ms));
        let (calm_ms, unpowered_ms) = (passed_ms(self.calm_since_ms), passed_ms(self.unpowered_since_ms));
        let (is_busy, whole_ms) = (self.is_busy, passed_ms(self.whole_since_ms));
        self.disturbed();
        self.is_busy |= matches!(
            fault,
            Fault::Manner(..) | Fault::Mailbox(..) | Fault::File(..) | Fault::Ethernet(_) | Fault::Silence(..)
        );
        let is_certain_jump = |axis: usize, increments: i32| {
            let [least, largest] = self.jumps.get(axis).copied().unwrap_or([f64::INFINITY, 0.0]);
            (least..=largest).contains(&f64::from(increments).abs())
        };
        let is_homed = self.is_homed && calm_ms >= CALM_TASK_MS;
        let is_powered = self.is_powered && calm_ms >= CALM_TASK_MS;
        let loses_outputs = |lasts_ms: u64| is_powered && lasts_ms >= self.lost_ms + LOST_MORE_MS;
        let axis_of = |slave: usize| chain.axis(slave);
        let processor_ms = PROCESSOR_MS + ROUND_MS * self.slaves;
        let (what, within_ms, notice) = match fault {
            // One that goes on before the report is due finds its drive switched off, which is a fault as well.
            Fault::Processor(slave, lasts_ms)
                if lasts_ms > processor_ms + REPORTED_MS
                    && axis_of(slave).is_some()
                    && !is_busy
                    && calm_ms >= CALM_BUS_MS =>
            {
                ("a drive's processor stands still", processor_ms, Notice::Fault)
            }
            Fault::Mute(lasts_ms) if self.has_output_frames && loses_outputs(lasts_ms) => {
                ("the outputs of all drives are lost", self.lost_ms, Notice::Fault)
            }
            Fault::Deaf(slave, lasts_ms) if axis_of(slave).is_some() && loses_outputs(lasts_ms) => {
                ("a drive's outputs are lost", self.lost_ms, Notice::Fault)
            }
            Fault::Power(slave, lasts_ms) if lasts_ms >= GAP_CERTAIN_MS && is_homed && axis_of(slave).is_some() => {
                ("a drive loses its supply", GAP_MS, Notice::Unhomed)
            }
            Fault::Remove(slave) if is_homed && axis_of(slave).is_some() => {
                ("a drive is removed", GAP_MS, Notice::Unhomed)
            }
            Fault::Jump(slave, increments)
                if self.is_homed
                    && whole_ms >= CALM_TASK_MS
                    && unpowered_ms >= UNPOWERED_MS
                    && axis_of(slave).is_some_and(|axis| is_certain_jump(axis, increments)) =>
            {
                ("an encoder jumps", 0, Notice::Unhomed)
            }
            _ => return None,
        };
        Some(Input::Noticeable {
            what,
            by_ms: now_ms + within_ms + REPORTED_MS,
            notice,
        })
    }
}
