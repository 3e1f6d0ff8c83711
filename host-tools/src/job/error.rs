//! Reasons why a job ends early, each with what to try.

use crate::error::{ProgramError, code};
use crate::link::text;
use etherpen::application::{Fault, Mode, Refusal};
use etherpen::messages::{Command, ConfigRefusal};
use std::fmt;

/// Phase of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Waiting for the firmware's answer to the greeting.
    Connecting,
    /// Waiting for the first status.
    Inspecting,
    /// Waiting for an earlier fault to be cleared.
    Acknowledging,
    /// Waiting for the configuration's hash.
    Configuring,
    /// Waiting for the bus to be operational.
    BusUp,
    /// Waiting for the power that homing by switches needs.
    Powering,
    /// Waiting for the joint angles to be referenced.
    Referencing,
    /// Waiting for the drives to hold the pose.
    Enabling,
    /// Waiting for a command to be answered and to take effect.
    Telling,
    /// Waiting for the drawing to begin.
    Starting,
    /// Moving without a path.
    Moving,
    /// Drawing.
    Drawing,
    /// Coming to rest and switching the power off.
    Resting,
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Connecting => "connecting",
            Self::Inspecting => "asking for the status",
            Self::Acknowledging => "acknowledging a fault, or ending an abandoned drawing",
            Self::Configuring => "sending the configuration",
            Self::BusUp => "bringing up the bus",
            Self::Powering => "switching the drives' power on to home",
            Self::Referencing => "homing",
            Self::Enabling => "enabling the drives",
            Self::Telling => "sending the command",
            Self::Starting => "starting",
            Self::Moving => "moving",
            Self::Drawing => "drawing",
            Self::Resting => "coming to rest",
        })
    }
}

/// Why a job ended early.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JobError {
    /// Firmware and program use different protocol versions.
    Version {
        /// This program's version.
        host: u16,
        /// The firmware's version.
        firmware: u16,
    },
    /// Nothing answered the greeting.
    NoAnswer {
        /// Time waited, ms.
        waited_ms: u64,
    },
    /// The firmware no longer sends.
    LinkLost {
        /// Time since its last message, ms.
        silent_ms: u64,
    },
    /// The firmware was reset or another program has taken over.
    Restarted,
    /// The configuration was refused.
    Config(ConfigRefusal),
    /// The firmware computed a different hash of the configuration.
    ConfigHash {
        /// This program's hash.
        ours: Option<u64>,
        /// The firmware's hash.
        firmware: u64,
    },
    /// The robot was busy.
    Busy(Mode),
    /// A command of the job was refused.
    Refused(Command, Refusal),
    /// A vertex of the path was refused.
    Vertex(etherpen::motion::Refusal),
    /// A fault was latched.
    Fault {
        /// Its cause.
        fault: Fault,
        /// Whether the fault was latched before the job did anything.
        before: bool,
    },
    /// A phase took too long.
    Timeout {
        /// The phase.
        phase: Phase,
        /// Time waited, ms.
        waited_ms: u64,
    },
    /// The robot came to rest before the path's end.
    EndedEarly {
        /// Vertices executed.
        executed: u32,
        /// Vertices of the path.
        total: usize,
    },
    /// The path ended, but the measured pen did not follow a part of it.
    NotFollowed {
        /// Length of the missing parts, mm.
        missing_mm: f64,
        /// Length of all strokes, mm.
        total_mm: f64,
        /// The first stroke with a missing part, counted from 0.
        first: u32,
        /// The last stroke with a missing part.
        last: u32,
        /// Number of strokes with a missing part.
        strokes: usize,
    },
    /// The firmware does not hold the drawing that was to be resumed.
    NotHeld(Mode),
    /// The joint angles are not referenced, and they cannot be assumed.
    NotReferenced,
    /// The operator cancelled the job.
    Cancelled,
    /// The program that ordered the motion no longer responds.
    Abandoned,
    /// The firmware was restarted in the middle of the drawing.
    Forgotten,
}

impl fmt::Display for JobError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version { host, firmware } => write!(
                f,
                "the firmware speaks link protocol version {firmware}, this program version {host}; flash the firmware \
                 that belongs to this program (etherpen flash), or use the program of the firmware's version"
            ),
            Self::NoAnswer { waited_ms } => write!(
                f,
                "no firmware answered within {:.1} s; check that the board runs, that this is its port, and that no \
                 other program has it open or works through the board's other port",
                seconds(*waited_ms)
            ),
            Self::LinkLost { silent_ms } => write!(
                f,
                "nothing came from the firmware for {:.1} s; the robot holds by itself: check the cable, then connect \
                 again and resume or cancel",
                seconds(*silent_ms)
            ),
            Self::Restarted => f.write_str(
                "the firmware no longer knows this connection: it was reset, or another program took the port; \
                 close the other program, and look for the cause of the reset before drawing again",
            ),
            Self::Config(refusal) => f.write_str(&text::config_refusal(refusal)),
            Self::ConfigHash { ours, firmware } => write!(
                f,
                "the firmware has a different configuration from the one that was sent (hash {firmware:016x}, sent {:016x}); program and \
                 firmware differ: flash the firmware that belongs to this program",
                ours.unwrap_or_default()
            ),
            Self::Busy(mode) => write!(
                f,
                "the robot is busy: {}; wait for it, resume a held drawing (draw --resume), or end what it does \
                 (etherpen cancel)",
                text::mode(*mode)
            ),
            Self::Refused(command, refusal) => {
                write!(f, "{} was refused: {}", text::command(command), text::refusal(refusal))
            }
            Self::Vertex(refusal) => f.write_str(&text::vertex(refusal)),
            Self::Fault { fault, before } => {
                let when = if *before {
                    "an earlier fault is latched"
                } else {
                    "fault"
                };
                write!(f, "{when}: {}", text::fault(fault))?;
                if *before {
                    f.write_str("; etherpen acknowledge (or draw --acknowledge) clears it after its cause is gone")?;
                }
                Ok(())
            }
            Self::Timeout { phase, waited_ms } => write!(
                f,
                "{phase} did not end within {:.0} s; look at the bus and the drives (etherpen bus state)",
                seconds(*waited_ms)
            ),
            Self::EndedEarly { executed, total } => write!(
                f,
                "the robot came to rest after {executed} of {total} vertices; another program may have cancelled the \
                 drawing"
            ),
            Self::NotFollowed {
                missing_mm,
                total_mm,
                first,
                last,
                strokes,
            } => {
                write!(
                    f,
                    "the drawing is not finished: {missing_mm:.1} of {total_mm:.1} mm were not drawn where they belong, in "
                )?;
                let (first, last) = (first.saturating_add(1), last.saturating_add(1));
                match strokes {
                    1 => write!(f, "stroke {first}")?,
                    _ => write!(f, "{strokes} strokes from {first} to {last}")?,
                }
                write!(
                    f,
                    "; the drives did not follow although none reported a fault: check them, home the robot again, then \
                     continue the drawing at stroke {first}"
                )
            }
            Self::NotHeld(mode) => write!(
                f,
                "the firmware does not hold this drawing (now: {}); draw --resume continues from the job log",
                text::mode(*mode)
            ),
            Self::NotReferenced => f.write_str(
                "the robot is not homed and may be in any pose; home it (etherpen reference), where its encoders do not know the \
                 pose at its marks or another known pose, then continue: with draw --resume for an interrupted drawing",
            ),
            Self::Cancelled => f.write_str("it was cancelled; the robot is at rest"),
            Self::Abandoned => f.write_str(
                "the program that commanded the motion fell silent, so the robot was stopped; command it again",
            ),
            Self::Forgotten => f.write_str(
                "the firmware restarted during the drawing and lost it; draw --resume continues where the ink ends",
            ),
        }
    }
}

impl std::error::Error for JobError {}

impl From<&JobError> for ProgramError {
    fn from(error: &JobError) -> Self {
        let code = match error {
            JobError::Version { .. } => code::VERSION,
            JobError::NoAnswer { .. } | JobError::LinkLost { .. } | JobError::Restarted | JobError::Forgotten => {
                code::CONNECTION
            }
            JobError::Fault { .. } => code::FAULT,
            JobError::Vertex(_) => code::INPUT,
            JobError::Config(_) | JobError::ConfigHash { .. } => code::USAGE,
            JobError::NotFollowed { .. } => code::INCOMPLETE,
            JobError::Cancelled => code::INTERRUPTED,
            _ => code::FAILED,
        };
        Self::new(code, error)
    }
}

fn seconds(ms: u64) -> f64 {
    ms as f64 / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_version_names_both_and_what_to_do() {
        let error = JobError::Version { host: 1, firmware: 7 };
        let text = error.to_string();
        assert!(text.contains("version 7") && text.contains("version 1") && text.contains("flash"));
    }

    #[test]
    fn every_error_is_one_sentence_without_debug_syntax() {
        let errors = [
            JobError::NoAnswer { waited_ms: 5000 },
            JobError::LinkLost { silent_ms: 3001 },
            JobError::Restarted,
            JobError::Busy(Mode::Holding),
            JobError::Refused(Command::Enable, Refusal::NotConfigured),
            JobError::Timeout {
                phase: Phase::BusUp,
                waited_ms: 60_000,
            },
            JobError::EndedEarly { executed: 3, total: 9 },
            JobError::NotFollowed {
                missing_mm: 44.8,
                total_mm: 271.5,
                first: 2,
                last: 2,
                strokes: 1,
            },
            JobError::Cancelled,
            JobError::Abandoned,
            JobError::Forgotten,
        ];
        for error in errors {
            let text = error.to_string();
            assert!(!text.contains(['{', '}', '\n']) && !text.contains("  "), "{text}");
        }
    }
}
