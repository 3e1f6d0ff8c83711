//! The recorded part of a machine's news, in the form that is sent to another process.
//!
//! The owner of a port sends it as postcard in hexadecimal digits, so that measurements arrive bit for bit.

use super::{Failure, News};
use crate::job::JobEvent;
use crate::link::text;
use crate::recording::messages::Severity;
use crate::recording::{Recorder, Storage};
use crate::terminal::counted;
use etherpen::messages::{Sample, Status, Welcome};
use serde::{Deserialize, Serialize};
use std::io;

/// An event of a machine, in transmitted form.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // one is alive at a time
pub enum Account {
    /// Telemetry.
    Samples {
        /// Samples lost directly before these.
        missing: u32,
        /// One a millisecond, in order.
        samples: Vec<Sample>,
    },
    /// State of the firmware.
    Status(Status),
    /// The firmware has answered the greeting.
    Connected(Welcome),
    /// The connection to the firmware has broken.
    Lost(Failure),
    /// Event of a drawing or another task.
    Task {
        /// Whether it is an error.
        bad: bool,
        /// Text for display.
        text: String,
    },
    /// Number of news lost on the way to this follower.
    Missed(u64),
}

impl Account {
    /// The recorded part of the news; the rest is visible in samples and statuses.
    pub fn of(news: &News) -> Option<Self> {
        let task = |bad, text| Some(Self::Task { bad, text });
        match news {
            News::Samples { missing, samples } => Some(Self::Samples {
                missing: *missing,
                samples: samples.to_vec(),
            }),
            News::Status(status) => Some(Self::Status(Status::clone(status))),
            News::Connected(welcome) => Some(Self::Connected(welcome.clone())),
            News::Lost(failure) => Some(Self::Lost(failure.clone())),
            News::Begun { name, .. } => task(false, format!("{name} is drawn")),
            News::Ended { result: Ok(()), .. } => task(false, "ended".to_owned()),
            News::Ended {
                result: Err(failure), ..
            } => task(true, failure.text.clone()),
            News::Job(event) => Self::of_job(event),
            News::Progress(_) | News::Reconnecting { .. } => None,
        }
    }

    /// The recorded part of a job's events.
    pub fn of_job(event: &JobEvent) -> Option<Self> {
        match event {
            JobEvent::Connected(welcome) => Some(Self::Connected(welcome.clone())),
            JobEvent::Phase(phase) => Some(Self::Task {
                bad: false,
                text: phase.to_string(),
            }),
            JobEvent::Refused(command, refusal) => {
                let text = format!("refused {}: {}", text::command(command), text::refusal(refusal));
                Some(Self::Task { bad: true, text })
            }
            // These are visible in the samples and the statuses.
            _ => None,
        }
    }

    /// Level, name and text of what is recorded as an event; `None` for samples and statuses.
    pub fn event(&self) -> Option<(Severity, &'static str, String)> {
        match self {
            Self::Samples { .. } | Self::Status(_) => None,
            Self::Connected(welcome) => {
                let text = format!("connected: firmware {} on board {}", welcome.firmware, welcome.board);
                Some((Severity::Info, "link", text))
            }
            Self::Lost(failure) => Some((Severity::Warning, "link", failure.text.clone())),
            Self::Task { bad: false, text } => Some((Severity::Info, "job", text.clone())),
            Self::Task { bad: true, text } => Some((Severity::Warning, "job", text.clone())),
            Self::Missed(lost) => {
                let text = format!(
                    "{} lost on the way to this program: the disk is too slow",
                    counted(*lost, "message")
                );
                Some((Severity::Warning, "link", text))
            }
        }
    }

    /// Writes this account into a recording.
    ///
    /// # Errors
    /// Errors of the storage.
    pub fn record<S: Storage>(&self, recorder: &mut Recorder<S>) -> io::Result<()> {
        match self {
            Self::Samples { missing, samples } => return recorder.samples(*missing, samples),
            Self::Status(status) => recorder.status(status)?,
            _ => {}
        }
        match self.event() {
            Some((level, name, text)) => recorder.event(level, name, &text),
            None => Ok(()),
        }
    }

    pub(super) fn to_digits(&self) -> Option<String> {
        let bytes = postcard::to_extend(self, Vec::new()).ok()?;
        Some(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
    }

    pub(super) fn from_digits(digits: &str) -> Option<Self> {
        let byte = |pair: &[u8]| {
            let digits = std::str::from_utf8(pair).ok()?;
            u8::from_str_radix(digits, 16).ok()
        };
        let bytes: Option<Vec<u8>> = digits.as_bytes().chunks(2).map(byte).collect();
        postcard::from_bytes(&bytes?).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::code;
    use etherpen::application::Mode;
    use etherpen::messages::IoValues;
    use etherpen::motion::Pen;

    #[test]
    fn every_bit_of_a_sample_travels() {
        let sample = Sample {
            t_ms: 7,
            mode: Mode::Drawing,
            stroke: 3,
            pen: Pen::Down,
            setpoint_rad: [0.1, f32::MIN_POSITIVE, -0.0, 1e30],
            measured_rad: [f32::NAN, f32::INFINITY, 0.2, 0.3],
            setpoint_rad_s: [1.0; 4],
            measured_rad_s: [2.0; 4],
            io: IoValues::default(),
        };
        let account = Account::Samples {
            missing: 2,
            samples: vec![sample; 3],
        };
        let digits = account.to_digits().unwrap();
        let back = Account::from_digits(&digits).unwrap();
        assert_eq!(back.to_digits(), Some(digits));
        let lost = Account::Lost(Failure::new(code::CONNECTION, "gone"));
        assert_eq!(Account::from_digits(&lost.to_digits().unwrap()), Some(lost));
        for text in ["", "0", "zz", "ff00", "é"] {
            assert_eq!(Account::from_digits(text), None, "{text}");
        }
    }
}
