//! What a board watches beside the bus: its inputs, its Ethernet port, its tasks' lives, its lamps.
//!
//! A board's folder reads pins and registers; what they mean is decided here, so that it is the same on every board and is
//! tried on the host in virtual time.
//!
//! Invariant: nothing here waits, locks or can panic; a critical task may call all of it.

use crate::application::{Fault, Mode, StopSource};
use heapless::String;
use serde::{Deserialize, Serialize};

/// How long the emergency-stop input has to be open before it counts, ms: longer than the pulses that a wire beside a motor's
/// picks up.
pub const STOP_OPEN_MS: u8 = 3;
/// How long it has to be closed again before it counts as released, ms: contacts bounce.
pub const STOP_CLOSED_MS: u8 = 100;
/// Bytes of text that are kept of what ended a run.
pub const CAUSE_BYTES_MAX: usize = 120;
/// Releases of the trajectory task, 12 ms each, that it may owe before it counts as dead.
pub const TRAJECTORIES_DUE_MAX: u32 = 8;

/// The Ethernet port, as its PHY says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum PortState {
    /// The board has no PHY to ask; the port counts as up.
    #[default]
    Unknown,
    /// No PHY answers.
    NoPhy,
    /// The PHY has no link: no cable, or nothing at its other end.
    Down,
    /// The link is up.
    Up,
}

impl PortState {
    /// Whether no frame can get through.
    pub const fn is_down(self) -> bool {
        matches!(self, Self::NoPhy | Self::Down)
    }
}

/// What keeps the drives in quick stop as long as it lasts, whatever is acknowledged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Interlock {
    /// The emergency-stop input is open.
    EmergencyStop,
    /// The board runs on a clock that is not exact enough.
    Clock,
}

impl Interlock {
    /// The fault that it is.
    pub const fn fault(self) -> Fault {
        match self {
            Self::EmergencyStop => Fault::EmergencyStop(StopSource::Input),
            Self::Clock => Fault::ClockFailure,
        }
    }

    /// What follows from the board's inputs: the first that holds.
    pub const fn of(stopped: bool, substitute_clock: bool) -> Option<Self> {
        match (stopped, substitute_clock) {
            (true, _) => Some(Self::EmergencyStop),
            (false, true) => Some(Self::Clock),
            (false, false) => None,
        }
    }
}

/// The emergency-stop input: normally closed, so that a broken wire stops.
#[derive(Clone, Copy, Debug, Default)]
pub struct EmergencyStopInput {
    open: bool,
    differs_ms: u8,
}

impl EmergencyStopInput {
    /// An input that was closed until now.
    pub const fn new() -> Self {
        Self {
            open: false,
            differs_ms: 0,
        }
    }

    /// One millisecond: takes what the pin shows and gives whether the input is open.
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

/// Whether the independent watchdog may be fed: the sample asks, so it lives, and the trajectory task owes few releases.
pub const fn may_feed(trajectories_due: u32) -> bool {
    trajectories_due <= TRAJECTORIES_DUE_MAX
}

/// Three lamps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lamps {
    /// What the controller is doing.
    pub green: bool,
    /// The Ethernet port.
    pub yellow: bool,
    /// Faults.
    pub red: bool,
}

impl Lamps {
    /// What they show in a mode: `ms` is any millisecond counter.
    ///
    /// Green flashes once a second without an operational bus, blinks slowly with it, is on when the robot is enabled and
    /// at rest, and blinks fast in motion. Yellow is on with a link. Red is on with a fault and blinks on the way there.
    pub const fn show(mode: Mode, port: PortState, ms: u32) -> Self {
        let flash = ms % 1_000 < 100;
        let slow = ms % 1_000 < 500;
        let fast = ms % 200 < 100;
        let (green, red) = match mode {
            Mode::Startup | Mode::BusConfiguring => (flash, false),
            Mode::DrivesOff | Mode::Unreferenced => (slow, false),
            Mode::Idle => (true, false),
            Mode::Moving | Mode::Drawing | Mode::Holding => (fast, false),
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

/// How the run before this one ended.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum RunEnd {
    /// The supply was switched off, or nothing is known.
    #[default]
    PowerOff,
    /// The reset button or a debug probe.
    Reset,
    /// The watchdog: a task that has to run did not.
    Watchdog,
    /// The firmware gave up, with this cause.
    Panic(String<CAUSE_BYTES_MAX>),
}

/// What is known of the run before this one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PreviousRun {
    /// How it ended.
    pub end: RunEnd,
    /// The last fault that was latched in it.
    pub fault: Option<Fault>,
}

impl PreviousRun {
    /// The end of a run that a panic ended; what does not fit of the cause is cut.
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

/// What a board tells the link task every millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoardState {
    /// The Ethernet port.
    pub port: PortState,
    /// Frames that the Ethernet controller dropped or could not send, and errors of its DMA, since the start.
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
