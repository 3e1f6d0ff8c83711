//! Reports to the host (samples and status), and the condition that a report is for the operating modes.

use super::Coordinator;
use super::io::IO_STATUS_MS;
use crate::application::{Condition, Fault, Mode};
use crate::board::{Interlock, PortState};
use crate::control::sampler::CycleReport;
use crate::drives::cia402::{DriveState, StatusWord};
use crate::messages::{Sample, Status};
use crate::motion::Pen;
use crate::robots::{AXES, JointAngles};

/// Longest time between two status messages, ms.
pub const STATUS_PERIOD_MS: u32 = 500;

/// What was last reported to the host.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Told {
    mode: Mode,
    fault: Option<Fault>,
    recovering: bool,
    referenced: bool,
    interlock: Option<Interlock>,
    port: PortState,
    /// How often the named inputs and outputs had changed.
    io_changes: u32,
    waiting_for: Option<u8>,
}

impl Told {
    /// Before the first status.
    pub(super) const NOTHING: Self = Self {
        mode: Mode::Startup,
        fault: None,
        recovering: false,
        referenced: false,
        interlock: None,
        port: PortState::Unknown,
        io_changes: 0,
        waiting_for: None,
    };
}

impl Coordinator<'_> {
    /// The status if it has changed, or was last reported [`STATUS_PERIOD_MS`] ago.
    pub fn due_status(&mut self) -> Option<Status> {
        let (told, now) = (self.told, self.to_tell());
        let since_ms = (self.now_ms as u32).wrapping_sub(self.told_ms);
        let io_changes = now.io_changes;
        let changed = Told { io_changes, ..told } != now;
        let io_changed = told.io_changes != io_changes && since_ms >= IO_STATUS_MS;
        let due = changed || io_changed || since_ms >= STATUS_PERIOD_MS;
        due.then(|| self.status())
    }

    /// The status; counts as reported.
    pub fn status(&mut self) -> Status {
        (self.told, self.told_ms) = (self.to_tell(), self.now_ms as u32);
        if let Some(report) = &self.report {
            for (place, status_word) in self.places.iter().zip(report.status_word) {
                if let Some(slave) = self.slaves.get_mut(usize::from(*place)) {
                    slave.status_word = status_word;
                }
            }
        }
        Status {
            mode: self.application.mode(),
            fault: self.application.fault(),
            recovering: self.application.is_recovering(),
            interlock: self.condition.interlock,
            port: self.board.port,
            waiting_for: self.waiting_for,
            referenced: self.condition.unreferenced.is_none(),
            reference_lost: self.was_referenced && self.condition.unreferenced.is_some(),
            increments: self.increments(),
            config: self.config_hash,
            override_percent: self.application.override_percent(),
            counters: self.counters,
            slaves: self.slaves.clone(),
            io: self.io.states(),
        }
    }

    fn to_tell(&self) -> Told {
        Told {
            mode: self.application.mode(),
            fault: self.application.fault(),
            recovering: self.application.is_recovering(),
            referenced: self.condition.unreferenced.is_none(),
            interlock: self.condition.interlock,
            port: self.board.port,
            io_changes: self.io.changes(),
            waiting_for: self.waiting_for,
        }
    }

    /// Positions as the encoders know them.
    fn increments(&self) -> [Option<i32>; AXES] {
        match (&self.homing_check, &self.report) {
            (Some(check), Some(report)) => check.known(&report.shown()),
            _ => [None; AXES],
        }
    }

    /// The sample of a report.
    pub(super) fn sample(&self, report: &CycleReport) -> Sample {
        let single = |values: &[f64; 4]| values.map(|value| value as f32);
        Sample {
            t_ms: report.cycle,
            mode: self.application.mode(),
            stroke: report.setpoint.stroke,
            pen: if report.following { report.setpoint.pen } else { Pen::Up },
            setpoint_rad: single(if report.following {
                &report.setpoint.position_rad
            } else {
                &report.measured_rad
            }),
            measured_rad: single(&report.measured_rad),
            setpoint_rad_s: if report.following {
                single(&report.setpoint.velocity_rad_s)
            } else {
                [0.0; 4]
            },
            measured_rad_s: single(&report.measured_rad_s),
            io: self.io.values(report),
        }
    }
}

/// The condition for the operating modes from a report. `places` are those of the axes' drives in the chain: the critical
/// tasks know a silent slave by its axis only.
pub(super) fn condition(report: &CycleReport, places: &[u8; AXES]) -> Condition {
    let place = |axis: u8| places.get(usize::from(axis)).copied().unwrap_or(axis);
    let fault = report.fault.map(|fault| match fault {
        Fault::SlaveLost { slave } => Fault::SlaveLost { slave: place(slave) },
        other => other,
    });
    let status = report.status_word.map(StatusWord);
    let in_operation = |status: &StatusWord| status.state() == DriveState::OperationEnabled;
    let first = |flags: [bool; AXES]| (0..).zip(flags).find_map(|(axis, flag)| flag.then_some(axis));
    let silent = first(report.valid.map(|valid| !valid));
    let faulty = |axis: usize| report.valid[axis] && status[axis].is_fault();
    Condition {
        pose: JointAngles(report.measured_rad),
        unreferenced: first(report.homed.map(|homed| !homed)),
        powered: silent.is_none() && status.iter().all(in_operation),
        // A drive that does not answer keeps its last known state.
        unpowered: !status.iter().any(|status| status.is_powered()),
        searching: report.searching,
        standstill: report.standstill,
        drive_fault: (0..AXES).find(|axis| faulty(*axis)).map(|axis| Fault::Drive {
            axis: axis as u8,
            status_word: report.status_word[axis],
        }),
        silent: silent.map(place),
        fault,
        interlock: report.interlock,
        stop_input: report.io.stop.map(|stop| stop.fault()),
        hold_input: report.io.hold,
        start_input: report.io.start,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Status word of a drive in operation.
    const ENABLED: u16 = 0x0237;

    #[test]
    fn drives_have_power_only_if_all_say_so_in_this_millisecond() {
        let report = CycleReport {
            status_word: [ENABLED; AXES],
            valid: [true; AXES],
            ..CycleReport::default()
        };
        let places = [0, 1, 2, 3];
        assert!(condition(&report, &places).powered);
        for axis in 0..AXES {
            let mut silent = report;
            silent.valid[axis] = false;
            assert!(
                !condition(&silent, &places).powered,
                "the last word of axis {axis} is old"
            );
            let mut other = report;
            other.status_word[axis] = 0x0233;
            assert!(!condition(&other, &places).powered);
        }
    }
}
