//! Board functions besides the bus: inputs, Ethernet port, task supervision, lamps.
//!
//! A board's folder reads pins and registers. The logic is here, so that it is shared by all boards and tested on the
//! host in virtual time.
//!
//! Invariant: no function here waits, locks or panics; a critical task may call all of them.

use crate::application::{Fault, InputCause, Mode, StopSource};
use crate::config::IoRole;
pub use crate::ethercat::port_state::PortState;
use heapless::String;
use serde::{Deserialize, Serialize};

/// How long the emergency-stop input has to be open before it counts as open, ms: longer than the pulses that a wire
/// next to a motor's cable picks up.
pub const STOP_OPEN_MS: u8 = 3;
/// How long the emergency-stop input has to be closed before it counts as released, ms: contacts bounce.
pub const STOP_CLOSED_MS: u8 = 100;
/// Bytes of text kept about the cause of a run's end.
pub const CAUSE_BYTES_MAX: usize = 120;
/// Releases of the trajectory task, 12 ms each, that may be overdue before the task counts as dead.
pub const TRAJECTORIES_DUE_MAX: u32 = 8;

/// A condition that keeps the drives in quick stop while it lasts; an acknowledgement does not clear it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Interlock {
    /// The emergency-stop input is open.
    EmergencyStop,
    /// The board runs on a clock that is not precise enough.
    Clock,
    /// An emergency-stop input of a terminal is open.
    Input {
        /// Its place in the configuration's `io`, from 0.
        io: u8,
    },
}

impl Interlock {
    /// The fault for this condition.
    pub const fn fault(self) -> Fault {
        match self {
            Self::EmergencyStop => Fault::EmergencyStop(StopSource::Input),
            Self::Clock => Fault::ClockFailure,
            Self::Input { io } => Fault::StopInput {
                io,
                role: IoRole::EmergencyStop,
                cause: InputCause::Open,
            },
        }
    }

    /// The first interlock that the board's inputs require, if any.
    pub const fn of(stopped: bool, substitute_clock: bool) -> Option<Self> {
        match (stopped, substitute_clock) {
            (true, _) => Some(Self::EmergencyStop),
            (false, true) => Some(Self::Clock),
            (false, false) => None,
        }
    }
}

/// The emergency-stop input: normally closed, so that a broken wire causes a stop.
#[derive(Clone, Copy, Debug, Default)]
pub struct EmergencyStopInput {
    open: bool,
    differs_ms: u8,
}

impl EmergencyStopInput {
    /// An input that has been closed so far.
    pub const fn new() -> Self {
        Self {
            open: false,
            differs_ms: 0,
        }
    }

    /// Advances by one millisecond: takes the state of the pin and returns whether the input counts as open.
    pub fn step(&mut self, shows_open: bool) -> bool {
        let longest_ms = if self.open { STOP_CLOSED_MS } else { STOP_OPEN_MS };
        self.differs_ms = if shows_open == self.open {
            0
        } else {
            self.differs_ms.saturating_add(1)
        };
        if self.differs_ms >= longest_ms {
            (self.open, self.differs_ms) = (shows_open, 0);
        }
        self.open
    }
}

/// Whether the independent watchdog may be fed: few releases of the trajectory task are overdue. The sample calls this
/// function, so the sample is alive.
pub const fn may_feed(trajectories_due: u32) -> bool {
    trajectories_due <= TRAJECTORIES_DUE_MAX
}

/// State of the three lamps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lamps {
    /// Operating state of the controller.
    pub green: bool,
    /// State of the Ethernet port.
    pub yellow: bool,
    /// Faults.
    pub red: bool,
}

impl Lamps {
    /// The lamps in a mode; `ms` is any millisecond counter.
    ///
    /// Green flashes once a second without an operational bus, blinks slowly with it, is on when the robot is enabled
    /// and at rest, and blinks fast in motion. Yellow is on with a link. Red is on in a fault and blinks while a fault
    /// is being handled.
    pub const fn show(mode: Mode, port: PortState, ms: u32) -> Self {
        let flash = ms % 1_000 < 100;
        let slow = ms % 1_000 < 500;
        let fast = ms % 200 < 100;
        let (green, red) = match mode {
            Mode::Startup | Mode::BusConfiguring => (flash, false),
            Mode::DrivesOff | Mode::Unreferenced => (slow, false),
            Mode::Idle => (true, false),
            Mode::Homing | Mode::Moving | Mode::Drawing | Mode::Holding => (fast, false),
            Mode::Stopping => (fast, fast),
            Mode::Fault => (false, true),
        };
        Self {
            green,
            yellow: matches!(port, PortState::Up),
            red,
        }
    }
}

impl Lamps {
    /// A single lamp that shows the mode; `ms` is any millisecond counter.
    ///
    /// It is off until the bus is operational, blinks slowly while the drives have no power or the angles are not known, is
    /// on when the robot is enabled and at rest, blinks fast in motion, and flashes twice a second in a fault.
    pub const fn single(mode: Mode, ms: u32) -> bool {
        match mode {
            Mode::Startup | Mode::BusConfiguring => false,
            Mode::DrivesOff | Mode::Unreferenced => ms % 1_000 < 500,
            Mode::Idle => true,
            Mode::Homing | Mode::Moving | Mode::Drawing | Mode::Holding | Mode::Stopping => ms % 200 < 100,
            Mode::Fault => ms % 500 < 100,
        }
    }
}

/// How the previous run ended.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum RunEnd {
    /// The supply was switched off, or the cause is not known.
    #[default]
    PowerOff,
    /// The reset button or a debug probe.
    Reset,
    /// The watchdog: a required task did not run.
    Watchdog,
    /// The firmware panicked, with this message.
    Panic(String<CAUSE_BYTES_MAX>),
}

/// End and last fault of the previous run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PreviousRun {
    /// How it ended.
    pub end: RunEnd,
    /// The last fault latched in that run.
    pub fault: Option<Fault>,
}

impl PreviousRun {
    /// The end of a run that panicked; a message that is too long is cut.
    pub fn panicked(cause: &str) -> RunEnd {
        let mut text = String::new();
        for letter in cause.chars() {
            if text.push(letter).is_err() {
                break;
            }
        }
        RunEnd::Panic(text)
    }
}

/// State of the board, passed to the link task every millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoardState {
    /// The Ethernet port.
    pub port: PortState,
    /// Frames that the Ethernet controller dropped or could not send, plus errors of its DMA, since start-up.
    pub ethernet_errors: u32,
}

const _: () = assert!(STOP_OPEN_MS < STOP_CLOSED_MS);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_does_not_stop_and_an_open_contact_does() {
        let mut input = EmergencyStopInput::new();
        for _ in 0..100 {
            for _ in 1..STOP_OPEN_MS {
                assert!(!input.step(true));
            }
            assert!(!input.step(false));
        }
        let opened = (1..=10).find(|_| input.step(true));
        assert_eq!(opened, Some(STOP_OPEN_MS));
    }

    #[test]
    fn a_bouncing_contact_is_released_only_when_it_has_settled() {
        let mut input = EmergencyStopInput::new();
        assert_eq!((0..STOP_OPEN_MS).filter(|_| input.step(true)).count(), 1);
        for ms in 0..500 {
            assert!(input.step(ms % 50 == 0), "it bounces every 50 ms");
        }
        let closed = (1..=200).find(|_| !input.step(false));
        assert!(closed.is_some_and(|ms| ms <= STOP_CLOSED_MS));
    }

    #[test]
    fn the_watchdog_is_fed_while_the_trajectory_task_owes_less_than_a_tenth_of_a_second() {
        assert!(may_feed(0) && may_feed(1) && may_feed(TRAJECTORIES_DUE_MAX));
        assert!(!may_feed(TRAJECTORIES_DUE_MAX + 1));
        assert!(TRAJECTORIES_DUE_MAX * crate::motion::PERIOD_MS as u32 <= 100);
    }

    #[test]
    fn every_mode_is_told_from_its_neighbours_by_the_lamps() {
        let pattern =
            |mode| -> std::vec::Vec<_> { (0..1_000).map(|ms| Lamps::show(mode, PortState::Up, ms)).collect() };
        let told_apart = [
            Mode::Startup,
            Mode::DrivesOff,
            Mode::Idle,
            Mode::Drawing,
            Mode::Stopping,
            Mode::Fault,
        ];
        for (number, mode) in told_apart.iter().enumerate() {
            for other in &told_apart[..number] {
                assert_ne!(pattern(*mode), pattern(*other), "{mode:?} {other:?}");
            }
        }
        assert!(pattern(Mode::Fault).iter().all(|lamps| lamps.red && lamps.yellow));
        assert!(!Lamps::show(Mode::Idle, PortState::Down, 0).yellow);
    }

    #[test]
    fn a_cause_that_is_too_long_is_cut_between_letters() {
        let long = "Aü".repeat(CAUSE_BYTES_MAX);
        let RunEnd::Panic(text) = PreviousRun::panicked(&long) else {
            panic!("it is a panic")
        };
        assert!(long.starts_with(text.as_str()) && text.len() >= CAUSE_BYTES_MAX - 1);
    }
}
