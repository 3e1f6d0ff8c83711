//! Homing by the drive (mode of operation 6): settings, sequence, and how it can fail.
//!
//! The drive searches a limit switch, a home switch or an index pulse by itself; the [`HomingMethod`] says which. The
//! sequence is that of CiA 402: leave operation, choose the mode, enable, start with the rising edge of bit 4, wait, take
//! the bit back, choose the former mode. A drive may show that an earlier homing has ended; the end counts only after the
//! drive has shown a run, or some cycles after the edge. After the end the position has jumped: targets have to be taken
//! afresh.
//!
//! Invariants: the drive has power only in the states that the sequence needs; every step ends, at the latest by its
//! time-out; after any end the drive is switched on, without torque, in its former mode if it takes it.

use crate::cia402::{ControlWord, DriveState, DriveTarget, StatusWord, step_from};
use etherpen_ethercat::driver::Setting;

/// Mode of operation: homing.
pub const HOMING_MODE: i8 = 6;

/// Bit 4 of the control word: start.
const START: u16 = 1 << 4;
/// Bits of the status word in homing mode.
const REACHED: u16 = 1 << 10;
const ATTAINED: u16 = 1 << 12;
const ERROR: u16 = 1 << 13;
/// Cycles after the start in which an end that was shown before it does not count.
const STALE_CYCLES: u32 = 20;
/// Cycles that each other step of the sequence may take.
const STEP_CYCLES_MAX: u32 = 2_000;

/// What the drive searches; object 0x6098.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HomingMethod(i8);

impl HomingMethod {
    /// The present position becomes the home position.
    pub const PRESENT_POSITION: Self = Self(37);
    /// The next index pulse in negative and in positive direction.
    pub const INDEX: [Self; 2] = [Self(33), Self(34)];

    /// A method by its number: 1 to 14, 17 to 30, 33 to 35 and 37 are those of CiA 402, negative ones the maker's; `None`
    /// for a reserved number.
    pub const fn new(number: i8) -> Option<Self> {
        match number {
            i8::MIN..=-1 | 1..=14 | 17..=30 | 33..=35 | 37 => Some(Self(number)),
            _ => None,
        }
    }

    /// Its number.
    pub const fn number(self) -> i8 {
        self.0
    }
}

/// Settings of a homing, in the drive's increments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HomingSettings {
    /// What is searched.
    pub method: HomingMethod,
    /// Speed towards the switch, increments/s; object 0x6099:1.
    pub switch_speed: u32,
    /// Speed towards edge and index pulse, increments/s; object 0x6099:2.
    pub zero_speed: u32,
    /// Acceleration, increments/s2; object 0x609A.
    pub acceleration: u32,
    /// Distance from the home position to position 0, increments; object 0x607C. Whether the home position becomes this
    /// number or its negative has changed between versions of the profile: try it with the drive.
    pub offset: i32,
}

impl HomingSettings {
    /// What is written to the drive before the sequence. A drive need not have acceleration and offset.
    pub fn settings(&self) -> [Setting; 5] {
        [
            Setting::new(0x6098, 0, i32::from(self.method.0).cast_unsigned(), 1).verified(),
            Setting::new(0x6099, 1, self.switch_speed, 4),
            Setting::new(0x6099, 2, self.zero_speed, 4),
            Setting::new(0x609A, 0, self.acceleration, 4).optional(),
            Setting::new(0x607C, 0, self.offset.cast_unsigned(), 4).optional(),
        ]
    }
}

/// Why a homing has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingFailure {
    /// The drive reports a fault, or has left operation by itself.
    Drive {
        /// Its status word.
        status: StatusWord,
    },
    /// The drive does not take the mode.
    Mode {
        /// The mode that was set.
        expected: i8,
        /// The mode in effect.
        actual: i8,
    },
    /// The drive does not get to the state that the sequence needs.
    State {
        /// Its status word.
        status: StatusWord,
    },
    /// The drive has given up: a switch or the index was not found.
    NotFound {
        /// Its status word.
        status: StatusWord,
    },
    /// The drive has stopped the search without an error.
    Interrupted {
        /// Its status word.
        status: StatusWord,
    },
    /// The search took longer than allowed.
    TimeOut {
        /// The time allowed, cycles.
        cycles: u32,
    },
}

/// Progress of a homing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingProgress {
    /// The sequence goes on.
    Running,
    /// The drive has found its home position and is in its former mode.
    Done,
    /// The sequence has ended without one.
    Failed(HomingFailure),
}

/// What the drive gets in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HomingOutput {
    /// Its control word.
    pub control: ControlWord,
    /// Its mode of operation, in the process data or by SDO whenever it changes.
    pub mode: i8,
    /// How far the sequence is.
    pub progress: HomingProgress,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// To "switched on", where the mode may be changed.
    Leave,
    /// Until the mode is in effect.
    Choose,
    /// To operation, with bit 4 clear.
    Enable,
    /// Bit 4 set.
    Search,
    /// Back to "switched on".
    Return,
    /// Until the former mode is in effect.
    Restore,
    End,
}

/// The sequence of one homing, stepped once a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Homing {
    phase: Phase,
    former_mode: i8,
    cycles: u32,
    cycles_max: u32,
    /// Whether the drive has shown that the search runs.
    has_run: bool,
    result: HomingProgress,
}

impl Homing {
    /// A sequence for a drive whose mode of operation is `former_mode`; the search may take `cycles_max` cycles.
    pub const fn new(former_mode: i8, cycles_max: u32) -> Self {
        Self {
            phase: Phase::Leave,
            former_mode,
            cycles: 0,
            cycles_max,
            has_run: false,
            result: HomingProgress::Running,
        }
    }

    /// Stops the search; the sequence goes on to its end.
    pub fn abort(&mut self, status: StatusWord) {
        if !matches!(self.phase, Phase::Return | Phase::Restore | Phase::End) {
            self.fail(HomingFailure::Interrupted { status });
        }
    }

    /// Advances by one cycle with what the drive shows.
    pub fn step(&mut self, status: StatusWord, mode_in_effect: i8) -> HomingOutput {
        self.cycles = self.cycles.saturating_add(1);
        let state = status.state();
        let is_over = matches!(self.phase, Phase::Return | Phase::Restore | Phase::End);
        if status.is_fault() && !is_over {
            self.fail(HomingFailure::Drive { status });
        }
        match self.phase {
            Phase::Leave => self.proceed_when(
                state == DriveState::SwitchedOn,
                Phase::Choose,
                HomingFailure::State { status },
            ),
            Phase::Choose => {
                let failure = HomingFailure::Mode {
                    expected: HOMING_MODE,
                    actual: mode_in_effect,
                };
                self.proceed_when(mode_in_effect == HOMING_MODE, Phase::Enable, failure);
            }
            Phase::Enable => {
                let enabled = state == DriveState::OperationEnabled;
                self.proceed_when(enabled, Phase::Search, HomingFailure::State { status });
            }
            Phase::Search => self.look_at_search(status),
            Phase::Return => {
                let off = matches!(
                    state,
                    DriveState::SwitchedOn | DriveState::Fault | DriveState::SwitchOnDisabled
                );
                self.proceed_when(off, Phase::Restore, HomingFailure::State { status });
            }
            Phase::Restore => {
                let failure = HomingFailure::Mode {
                    expected: self.former_mode,
                    actual: mode_in_effect,
                };
                self.proceed_when(mode_in_effect == self.former_mode, Phase::End, failure);
            }
            Phase::End => {}
        }
        self.output(state)
    }

    fn output(&self, state: DriveState) -> HomingOutput {
        let enabled = step_from(state, DriveTarget::Enabled);
        let switched_on = match state {
            DriveState::OperationEnabled | DriveState::SwitchedOn => ControlWord::SWITCH_ON,
            _ => enabled,
        };
        let (control, mode) = match self.phase {
            Phase::Leave | Phase::Return | Phase::Restore | Phase::End => (switched_on, self.former_mode),
            Phase::Choose => (switched_on, HOMING_MODE),
            Phase::Enable => (enabled, HOMING_MODE),
            Phase::Search => (ControlWord(enabled.0 | START), HOMING_MODE),
        };
        // A drive is not led to power again by a sequence that has failed.
        let is_left_alone = matches!(self.result, HomingProgress::Failed(_)) && state != DriveState::OperationEnabled;
        HomingOutput {
            control: if is_left_alone {
                step_from(state, DriveTarget::Off)
            } else {
                control
            },
            mode,
            progress: match self.phase {
                Phase::End => self.result,
                _ => HomingProgress::Running,
            },
        }
    }

    fn look_at_search(&mut self, status: StatusWord) {
        if status.state() != DriveState::OperationEnabled {
            return self.fail(HomingFailure::Drive { status });
        }
        let shown = status.0 & (ERROR | ATTAINED | REACHED);
        self.has_run |= shown == 0 || shown == ATTAINED;
        let counts = self.has_run || self.cycles > STALE_CYCLES;
        if shown & ERROR != 0 && counts {
            self.fail(HomingFailure::NotFound { status });
        } else if shown == ATTAINED | REACHED && counts {
            self.result = HomingProgress::Done;
            self.enter(Phase::Return);
        } else if shown == REACHED && counts {
            self.fail(HomingFailure::Interrupted { status });
        } else if self.cycles > self.cycles_max {
            self.fail(HomingFailure::TimeOut {
                cycles: self.cycles_max,
            });
        }
    }

    fn proceed_when(&mut self, reached: bool, next: Phase, failure: HomingFailure) {
        if reached {
            self.enter(next);
        } else if self.cycles > STEP_CYCLES_MAX {
            self.fail(failure);
        }
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.cycles = 0;
        if phase == Phase::End && self.result == HomingProgress::Running {
            self.result = HomingProgress::Done;
        }
    }

    /// Goes to the end with a failure; the first one counts.
    fn fail(&mut self, failure: HomingFailure) {
        if !matches!(self.result, HomingProgress::Failed(_)) {
            self.result = HomingProgress::Failed(failure);
        }
        let next = match self.phase {
            Phase::Return => Phase::Restore,
            Phase::Restore | Phase::End => Phase::End,
            _ => Phase::Return,
        };
        self.enter(next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive that obeys after some cycles and shows an end after a search of some cycles.
    struct FakeDrive {
        state: u16,
        mode: i8,
        delay: u32,
        wait: u32,
        searched: u32,
        search: u32,
        end: u16,
        stale: u16,
        stuck_mode: bool,
    }

    impl FakeDrive {
        fn new(delay: u32, search: u32, end: u16, stale: u16) -> Self {
            Self {
                state: 0x0027,
                mode: 8,
                delay,
                wait: 0,
                searched: 0,
                search,
                end,
                stale,
                stuck_mode: false,
            }
        }

        fn status(&self) -> StatusWord {
            let bits = match (self.mode == HOMING_MODE, self.searched) {
                (false, _) => 0x1000,
                (true, 0) => self.stale,
                (true, searched) if searched <= self.search => 0,
                _ => self.end,
            };
            StatusWord(0x0210 | self.state | bits)
        }

        fn obey(&mut self, output: &HomingOutput) {
            self.wait += 1;
            if self.wait > self.delay {
                self.wait = 0;
                self.state = match (self.state, output.control.0 & 0x0F) {
                    (0x0027, 0x07) | (0x0021, 0x07) => 0x0023,
                    (0x0023, 0x0F) => 0x0027,
                    (0x0027, 0x0F) => 0x0027,
                    (0x0040, 0x06) => 0x0021,
                    (_, 0x00) => 0x0040,
                    (state, _) => state,
                };
                if !self.stuck_mode {
                    self.mode = output.mode;
                }
            }
            let starts = self.mode == HOMING_MODE && self.state == 0x0027 && output.control.0 & START != 0;
            self.searched = if starts { self.searched + 1 } else { 0 };
        }
    }

    fn run(drive: &mut FakeDrive, cycles_max: u32) -> (HomingProgress, u32) {
        let mut homing = Homing::new(8, cycles_max);
        for cycle in 1..20_000 {
            let output = homing.step(drive.status(), drive.mode);
            assert!(
                drive.state != 0x0027 || output.control.0 & 0x06 == 0x06,
                "never a quick stop"
            );
            if output.progress != HomingProgress::Running {
                return (output.progress, cycle);
            }
            drive.obey(&output);
        }
        (HomingProgress::Running, 20_000)
    }

    const DONE: u16 = ATTAINED | REACHED;

    #[test]
    fn a_homing_ends_in_the_former_mode_whatever_the_drive_showed_before() {
        for delay in [0, 1, 5, 100] {
            for search in [1, 10, 1_000] {
                for stale in [0, DONE, REACHED, ATTAINED, ERROR] {
                    let mut drive = FakeDrive::new(delay, search, DONE, stale);
                    let (progress, _) = run(&mut drive, 5_000);
                    assert_eq!(progress, HomingProgress::Done, "{delay} {search} {stale:#06x}");
                    assert_eq!((drive.mode, drive.state), (8, 0x0023));
                }
            }
        }
        // A method that ends at once never shows a run.
        let mut drive = FakeDrive::new(1, 0, DONE, DONE);
        assert_eq!(run(&mut drive, 5_000).0, HomingProgress::Done);
    }

    #[test]
    fn each_failure_is_named_and_leaves_the_drive_without_torque() {
        let mut cases = [
            (FakeDrive::new(1, 50, ERROR, 0), 5_000, "not found"),
            (FakeDrive::new(1, 50, ERROR | REACHED, DONE), 5_000, "not found"),
            (FakeDrive::new(1, 50, REACHED, 0), 5_000, "interrupted"),
            (FakeDrive::new(1, 9_000, DONE, 0), 500, "time-out"),
            (FakeDrive::new(1, 50, DONE, 0), 5_000, "mode"),
        ];
        cases[4].0.stuck_mode = true;
        for (mut drive, cycles_max, expected) in cases {
            let HomingProgress::Failed(failure) = run(&mut drive, cycles_max).0 else {
                panic!("{expected}");
            };
            let name = match failure {
                HomingFailure::NotFound { .. } => "not found",
                HomingFailure::Interrupted { .. } => "interrupted",
                HomingFailure::TimeOut { .. } => "time-out",
                HomingFailure::Mode { .. } => "mode",
                HomingFailure::Drive { .. } | HomingFailure::State { .. } => "drive",
            };
            assert_eq!(name, expected, "{failure:?}");
            assert_ne!(drive.state, 0x0027, "{expected}");
        }
    }

    #[test]
    fn a_fault_in_any_phase_ends_the_sequence() {
        for at in 1..80 {
            let mut drive = FakeDrive::new(1, 40, DONE, 0);
            let mut homing = Homing::new(8, 5_000);
            let mut end = HomingProgress::Running;
            for cycle in 0..10_000 {
                if cycle == at {
                    drive.state = 0x0008;
                }
                let output = homing.step(drive.status(), drive.mode);
                end = output.progress;
                if end != HomingProgress::Running {
                    break;
                }
                drive.obey(&output);
            }
            assert_ne!(end, HomingProgress::Running, "a fault in cycle {at}");
        }
    }

    #[test]
    fn reserved_methods_do_not_exist_and_settings_carry_the_numbers() {
        for reserved in [0, 15, 16, 31, 32, 36, 38, 127] {
            assert_eq!(HomingMethod::new(reserved), None, "{reserved}");
        }
        let settings = HomingSettings {
            method: HomingMethod::new(-3).unwrap(),
            switch_speed: 1_000,
            zero_speed: 100,
            acceleration: 5_000,
            offset: -7,
        };
        let values = settings.settings().map(|setting| setting.value);
        assert_eq!(values, [-3_i32 as u32, 1_000, 100, 5_000, -7_i32 as u32]);
    }
}
