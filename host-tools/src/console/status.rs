//! The firmware's status as text for display.
//!
//! The page shows these texts unchanged. Invariant: only the firmware's mode and fault determine whether the robot is
//! shown as stopped.

use crate::axes::{AxisView, axes};
use crate::link::text;
use etherpen::application::{Fault, Mode, StopSource};
use etherpen::config::{Config, Encoder, IoDirection, IoRole};
use etherpen::drives::cia402::{DriveState, StatusWord};
use etherpen::ethercat::state::{al_code_hint, al_code_text};
use etherpen::messages::{SlaveStatus, Status};
use serde::Serialize;
use std::borrow::Cow;

/// A status as shown on the page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StatusView {
    mode: &'static str,
    text: Cow<'static, str>,
    fault: Option<String>,
    /// Whether the robot is stopped because of a requested stop.
    stopped: bool,
    referenced: bool,
    /// Last position of the platform while the joints were referenced, mm; only while they are not referenced.
    seen_mm: Option<[f32; 3]>,
    configured: bool,
    override_percent: u8,
    /// Actions allowed by the mode, by the names of the page's buttons.
    allowed: Vec<&'static str>,
    bus: BusView,
    slaves: Vec<SlaveView>,
    counters: Vec<(&'static str, u32)>,
    /// The named inputs and outputs of terminals.
    io: Vec<IoView>,
    /// What the encoders show; only while the joints are not referenced.
    encoders: Vec<EncoderView>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct EncoderView {
    axis: String,
    /// Absent while no position arrives.
    increments: Option<i32>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct IoView {
    name: String,
    is_output: bool,
    role: &'static str,
    /// Absent while the terminal does not exchange it.
    value: Option<i64>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct BusView {
    text: String,
    good: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct SlaveView {
    number: usize,
    /// Time since the slave last answered, whole seconds; its other data are as old.
    silent_s: Option<u64>,
    vendor: String,
    product: String,
    state: String,
    operational: bool,
    /// AL status code with its text; empty without an error.
    error: String,
    hint: &'static str,
    status_word: String,
    drive: &'static str,
    powered: bool,
    fault: bool,
    voltage: bool,
    warning: bool,
}

/// The name of a mode on the page and in the telemetry.
pub fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Startup => "Startup",
        Mode::BusConfiguring => "BusConfiguring",
        Mode::DrivesOff => "DrivesOff",
        Mode::Unreferenced => "Unreferenced",
        Mode::Idle => "Idle",
        Mode::Moving => "Moving",
        Mode::Drawing => "Drawing",
        Mode::Holding => "Holding",
        Mode::Stopping => "Stopping",
        Mode::Fault => "Fault",
        Mode::Homing => "Homing",
    }
}

/// Actions allowed by a mode. A terminal whose points are missing without a fault is brought back by an acknowledgement.
fn allowed(mode: Mode, referenced: bool, misses_points: bool) -> Vec<&'static str> {
    let mut allowed: Vec<&'static str> = match mode {
        Mode::DrivesOff if referenced => vec!["enable", "reference", "draw"],
        Mode::DrivesOff => vec!["enable", "reference"],
        Mode::Unreferenced => vec!["reference", "disable"],
        Mode::Idle => vec!["disable", "reference", "jog", "pen", "move", "draw"],
        Mode::Moving => vec!["jog"],
        Mode::Homing => vec!["cancel", "disable"],
        Mode::Drawing => vec!["hold", "cancel"],
        Mode::Holding => vec!["resume", "cancel"],
        Mode::Fault => vec!["acknowledge"],
        Mode::Startup | Mode::BusConfiguring | Mode::Stopping => Vec::new(),
    };
    if misses_points && !allowed.is_empty() && mode != Mode::Fault {
        allowed.push("acknowledge");
    }
    if mode != Mode::Startup {
        allowed.push("override");
    }
    allowed
}

fn drive_text(state: DriveState) -> &'static str {
    match state {
        DriveState::NotReadyToSwitchOn => "not ready",
        DriveState::SwitchOnDisabled => "switch-on disabled",
        DriveState::ReadyToSwitchOn => "ready to switch on",
        DriveState::SwitchedOn => "switched on",
        DriveState::OperationEnabled => "operation enabled",
        DriveState::QuickStopActive => "quick stop",
        DriveState::FaultReactionActive => "reacting to a fault",
        DriveState::Fault => "fault",
    }
}

/// Whether a slave does not answer; the firmware then keeps its last data.
pub fn is_silent(status: &Status, index: usize) -> bool {
    let lost = matches!(status.fault, Some(Fault::SlaveLost { slave }) if usize::from(slave) == index);
    lost || status.slaves.get(index).is_none_or(|slave| slave.al_state == 0)
}

fn slave(index: usize, slave: &SlaveStatus, silent_s: Option<u64>) -> SlaveView {
    let word = StatusWord(slave.status_word);
    let flagged = slave.al_state & 0x10 != 0 || slave.al_code != 0;
    SlaveView {
        number: index + 1,
        silent_s,
        vendor: format!("{:#010x}", slave.vendor),
        product: format!("{:#010x}", slave.product),
        state: match slave.al_state {
            _ if silent_s.is_some() => "no answer".to_owned(),
            state => text::bus::al_state(state),
        },
        operational: slave.al_state == 8 && silent_s.is_none(),
        error: match flagged {
            true => format!("{:#06x} {}", slave.al_code, al_code_text(slave.al_code)),
            false => String::new(),
        },
        hint: if flagged { al_code_hint(slave.al_code) } else { "" },
        status_word: format!("{:#06x}", slave.status_word),
        drive: drive_text(word.state()),
        powered: word.is_powered(),
        fault: word.is_fault(),
        voltage: word.voltage_enabled(),
        warning: word.warning(),
    }
}

impl StatusView {
    /// Adds what the configuration tells: the named inputs and outputs, the axes' encoders, which slaves have to be in OP, and
    /// that home switches need power.
    pub fn with_machine(mut self, config: &Config, status: &Status) -> Self {
        let io = config.io.iter().zip(&status.io).map(|(point, state)| IoView {
            name: point.name.to_string(),
            is_output: point.direction == IoDirection::Out,
            role: point.role.name(),
            value: state.valid.then(|| point.kind.value(state.raw)),
        });
        self.io = io.collect();
        if !status.referenced && status.increments.iter().any(Option::is_some) {
            let shown = axes(config).into_iter().zip(status.increments);
            let encoder = |(axis, increments): (AxisView, Option<i32>)| EncoderView {
                axis: axis.label,
                increments,
            };
            self.encoders = shown.map(encoder).collect();
        }
        if config.has_home_switches() && status.mode == Mode::DrivesOff {
            self.allowed.retain(|action| *action != "reference");
        }
        // A coupler that no name belongs to is not brought up.
        let used = usize::from(config.bus.drives) + config.terminal_places().count() as usize;
        if used < self.slaves.len() {
            let operational = self.slaves.iter().filter(|slave| slave.operational).count();
            self.bus = bus(operational.min(used), used);
        }
        self
    }

    /// Adds the platform's last position from the time when the joints were referenced, if they no longer are.
    pub fn seen_at(self, seen_mm: Option<[f32; 3]>) -> Self {
        let seen_mm = seen_mm.filter(|_| !self.referenced);
        Self { seen_mm, ..self }
    }
}

/// The bus with this many slaves in OP of those that have to be.
fn bus(operational: usize, slaves: usize) -> BusView {
    BusView {
        text: match slaves {
            0 => "no slaves yet".to_owned(),
            slaves => format!("{operational} of {slaves} slaves in OP"),
        },
        good: operational == slaves && operational > 0,
    }
}

/// Whether each axis's encoder would show that somebody has moved the machine.
pub(super) fn shows_motion(config: &Config) -> bool {
    let mut axes = config.axes.iter().take(config.bus.drives.into());
    axes.all(|axis| axis.encoder == Encoder::SingleTurn || axis.knows_turns())
}

/// Converts a status for display; `silent_s` gives for each slave how long it has not answered.
pub fn view(status: &Status, silent_s: &[Option<u64>]) -> StatusView {
    let counters = &status.counters;
    let slaves: Vec<SlaveView> = (0..)
        .zip(&status.slaves)
        .map(|(index, status)| slave(index, status, silent_s.get(index).copied().flatten()))
        .collect();
    let operational = slaves.iter().filter(|slave| slave.operational).count();
    StatusView {
        mode: mode_name(status.mode),
        text: text::doing(status),
        fault: text::fault_of(status),
        stopped: status.mode == Mode::Fault
            && matches!(
                status.fault,
                Some(
                    Fault::EmergencyStop(StopSource::Link | StopSource::Input)
                        | Fault::StopInput {
                            role: IoRole::EmergencyStop,
                            ..
                        }
                )
            ),
        referenced: status.referenced,
        seen_mm: None,
        configured: status.config.is_some(),
        override_percent: status.override_percent,
        allowed: match status.recovering {
            true => vec!["override"],
            false => allowed(
                status.mode,
                status.referenced,
                status.io.iter().any(|point| !point.valid),
            ),
        },
        bus: bus(operational, slaves.len()),
        slaves,
        counters: vec![
            ("cycles", counters.cycles),
            ("late", counters.cycles_late),
            ("frames lost", counters.frames_lost),
            ("wrong working counters", counters.working_counter_errors),
            ("frames ignored", counters.frames_ignored),
            ("setpoint underruns", counters.setpoint_underruns),
            ("path starvations", counters.path_starvations),
            ("planner overruns", counters.trajectory_overruns),
            ("telemetry dropped", counters.telemetry_dropped),
            ("link errors", counters.link_errors),
            ("stops that left the path", counters.path_stops_left),
        ],
        io: Vec::new(),
        encoders: Vec::new(),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::settings::machines::MACHINES;
    use etherpen::board::PortState;
    use etherpen::messages::Counters;
    use heapless::Vec as FixedVec;

    pub(crate) fn status(mode: Mode, fault: Option<Fault>) -> Status {
        let slave = |al_state, al_code, status_word| SlaveStatus {
            vendor: 0x6A,
            product: 2,
            al_state,
            al_code,
            status_word,
        };
        Status {
            mode,
            fault,
            referenced: true,
            reference_lost: false,
            increments: [None; 4],
            config: Some(1),
            override_percent: 100,
            counters: Counters::default(),
            recovering: false,
            interlock: None,
            port: PortState::default(),
            waiting_for: None,
            slaves: FixedVec::from_slice(&[slave(8, 0, 0x0637), slave(0x14, 0x1B, 0x0218)]).unwrap(),
            io: FixedVec::new(),
        }
    }

    #[test]
    fn a_stop_counts_as_confirmed_by_the_firmwares_fault_only() {
        assert!(!view(&status(Mode::Stopping, None), &[]).stopped);
        assert!(
            !view(
                &status(Mode::Stopping, Some(Fault::EmergencyStop(StopSource::Link))),
                &[]
            )
            .stopped
        );
        assert!(view(&status(Mode::Fault, Some(Fault::EmergencyStop(StopSource::Link))), &[]).stopped);
        assert!(!view(&status(Mode::Fault, Some(Fault::SlaveLost { slave: 0 })), &[]).stopped);
    }

    #[test]
    fn slaves_are_told_with_state_code_and_status_word() {
        let view = view(&status(Mode::Fault, None), &[]);
        assert_eq!(view.bus.text, "1 of 2 slaves in OP");
        let [first, second] = &view.slaves[..] else { panic!() };
        assert_eq!(
            (first.drive, first.powered, first.error.as_str()),
            ("operation enabled", true, "")
        );
        assert!(second.fault && second.error.starts_with("0x001b"), "{second:?}");
        assert_eq!(second.state, "SAFEOP with error");
        assert!(!second.hint.is_empty());
    }

    #[test]
    fn an_unused_coupler_is_not_counted_and_home_switches_need_power() {
        let machine = MACHINES[1].load().unwrap();
        let of = |mode, coupler: u8, drive: u8| {
            let mut status = status(mode, None);
            let states = [coupler, 8, 8, 8, drive];
            let used = status.slaves[0].clone();
            status.slaves = states
                .into_iter()
                .map(|al_state| SlaveStatus {
                    al_state,
                    ..used.clone()
                })
                .collect();
            let view = view(&status, &[]).with_machine(&machine, &status);
            (view.bus.text, view.bus.good, view.allowed.contains(&"reference"))
        };
        assert_eq!(of(Mode::DrivesOff, 1, 8), ("4 of 4 slaves in OP".into(), true, false));
        assert_eq!(
            of(Mode::Unreferenced, 1, 2),
            ("3 of 4 slaves in OP".into(), false, true)
        );
        assert!(of(Mode::Idle, 8, 8).2);
    }

    #[test]
    fn encoders_are_shown_by_their_axes_until_the_robot_is_homed() {
        let config = MACHINES[1].load().expect("a bundled machine");
        let mut shown = status(Mode::DrivesOff, None);
        let encoders = |status: &Status| {
            let view = view(status, &[]).with_machine(&config, status);
            let pair = |encoder: EncoderView| (encoder.axis, encoder.increments);
            view.encoders.into_iter().map(pair).collect::<Vec<_>>()
        };
        (shown.referenced, shown.increments) = (false, [Some(-5), None, Some(i32::MAX), Some(9)]);
        let expected = [("x", Some(-5)), ("y", None), ("z", Some(i32::MAX))];
        assert_eq!(encoders(&shown), expected.map(|(axis, shown)| (axis.to_owned(), shown)));
        shown.increments = [None; 4];
        assert_eq!(encoders(&shown), []);
        (shown.referenced, shown.increments) = (true, [Some(1); 4]);
        assert_eq!(encoders(&shown), []);
    }

    #[test]
    fn a_slave_that_stopped_answering_is_not_shown_in_its_last_state() {
        let lost = status(Mode::Fault, Some(Fault::SlaveLost { slave: 0 }));
        assert!(is_silent(&lost, 0) && !is_silent(&lost, 1));
        let mut unplugged = status(Mode::Fault, None);
        unplugged.slaves[1].al_state = 0;
        assert!(!is_silent(&unplugged, 0) && is_silent(&unplugged, 1));
        let view = view(&lost, &[Some(3), None]);
        assert_eq!((view.slaves[0].state.as_str(), view.bus.good), ("no answer", false));
        assert_eq!((view.slaves[0].silent_s, view.slaves[1].silent_s), (Some(3), None));
    }

    #[test]
    fn a_fault_is_acknowledged_and_so_is_a_terminal_that_was_away() {
        for mode in [Mode::Startup, Mode::Idle, Mode::Drawing, Mode::Stopping] {
            assert!(!allowed(mode, true, false).contains(&"acknowledge"));
        }
        for mode in [Mode::DrivesOff, Mode::Idle, Mode::Drawing, Mode::Holding] {
            assert!(allowed(mode, true, true).contains(&"acknowledge"));
        }
        assert!(!allowed(Mode::BusConfiguring, true, true).contains(&"acknowledge"));
        for misses_points in [false, true] {
            let allowed = allowed(Mode::Fault, false, misses_points);
            assert_eq!(allowed.iter().filter(|name| **name == "acknowledge").count(), 1);
        }
    }
}
