//! What a job does with the events of its session.

use super::error::{JobError, Phase};
use super::task::Task;
use super::{Job, JobEvent};
use crate::link::session::Event;
use etherpen::application::{Mode, Refusal};
use etherpen::board::PortState;
use etherpen::link::message::PathAck;
use etherpen::messages::{Command, RecordAnswer, Sample, Status};
use etherpen::motion::Pen;
use std::sync::Arc;

/// Time before retrying a command that was refused because something was still moving, ms.
const RETRY_MS: u64 = 100;

impl Job {
    /// Takes one event.
    pub(super) fn take(&mut self, event: Event) {
        match event {
            Event::Connected(welcome) => {
                self.events.push_back(JobEvent::Connected(welcome.clone()));
                self.welcome = Some(welcome);
                self.enter(Phase::Inspecting);
            }
            Event::VersionRefused { host, firmware } => self.lose(JobError::Version { host, firmware }),
            Event::Restarted => self.lose(JobError::Restarted),
            Event::Measured(answer) => self.take_measured(answer),
            Event::Bus(result) => self.events.push_back(JobEvent::Bus(result)),
            Event::Configured(Ok(hash)) => match self.config.hash() {
                Some(ours) if ours == hash => self.enter(Phase::BusUp),
                ours => self.fail(JobError::ConfigHash { ours, firmware: hash }),
            },
            Event::Configured(Err(refusal)) => self.fail(JobError::Config(refusal)),
            Event::Answered { id, command, result } => self.take_answer(id, command, result),
            Event::Ack(ack) => self.take_ack(ack),
            Event::VertexRefused(refusal) => {
                self.ending.get_or_insert(JobError::Vertex(refusal));
            }
            Event::Status(status) => self.take_status(status),
            Event::Samples { missing, samples } => self.take_samples(missing, samples),
        }
    }

    fn take_ack(&mut self, ack: PathAck) {
        if self.outcome.is_some() {
            return;
        }
        if ack.finished && !self.ack.finished {
            let since_ms = self.drawing_ms.unwrap_or(self.now_ms);
            self.drawn_ms = self.now_ms.saturating_sub(since_ms).saturating_sub(self.held_ms);
        }
        self.ack = ack;
    }

    fn take_samples(&mut self, missing: u32, samples: Vec<Sample>) {
        if let Some(first) = samples.first().filter(|_| missing > 0) {
            let t_ms = first.t_ms;
            self.events.push_back(JobEvent::SamplesMissing { missing, t_ms });
        }
        self.sample = samples.last().copied().or(self.sample);
        if let Some(verifier) = &mut self.verifier {
            verifier.observe(&samples);
        }
        // A short lift may lie in the middle of what one message tells.
        let pen_is_up = |sample: &Sample| sample.mode == Mode::Drawing && sample.pen == Pen::Up;
        if self.hold_at_pen_up && samples.iter().any(pen_is_up) {
            self.hold_at_pen_up = false;
            self.session.command(Command::Hold);
        }
        if self.options.forward_samples {
            let samples = samples.into();
            self.events.push_back(JobEvent::Samples { missing, samples });
        } else {
            self.samples.extend(samples);
        }
    }

    fn take_answer(&mut self, id: u16, command: Command, result: Result<(), Refusal>) {
        let own = self.awaited.take_if(|awaited| *awaited == id).is_some();
        if !own {
            self.events.push_back(JobEvent::Told { id, command, result });
        }
        match result {
            Ok(()) => {
                self.fresh = false;
                self.accepted |= own;
                self.inquired_ms = self.now_ms;
                self.session.inquire();
                if own && self.phase == Phase::Starting {
                    self.start_path();
                }
            }
            Err(Refusal::Moving | Refusal::Recovering) if own && self.waits_for_standstill() => {
                self.retry_ms = self.now_ms + RETRY_MS;
            }
            Err(_) if own && self.phase == Phase::Resting => self.retry_ms = self.now_ms + RETRY_MS,
            Err(refusal) if own => {
                self.ending.get_or_insert(JobError::Refused(command, refusal));
            }
            Err(refusal) => self.events.push_back(JobEvent::Refused(command, refusal)),
        }
    }

    fn waits_for_standstill(&self) -> bool {
        !matches!(self.task, Task::Tell(_))
    }

    fn take_status(&mut self, status: Status) {
        let before = self.status.as_ref();
        if before.map(|before| before.mode) != Some(status.mode) {
            self.events.push_back(JobEvent::Mode(status.mode));
        }
        if let Some(fault) = status.fault
            && before.and_then(|before| before.fault) != status.fault
        {
            self.events.push_back(JobEvent::Fault(fault));
        }
        let known_port = before.map_or(PortState::Unknown, |before| before.port);
        if known_port != status.port {
            self.events.push_back(JobEvent::Port(status.port));
        }
        self.events.push_back(JobEvent::Status(Arc::new(status.clone())));
        self.fresh = true;
        self.status = Some(status);
    }

    fn take_measured(&mut self, answer: RecordAnswer) {
        if self.questions.pop_front() == Some(false) {
            return self.events.push_back(JobEvent::Measured(answer));
        }
        let RecordAnswer::Measurement(answer) = answer else {
            return;
        };
        let next = self.reader.as_mut().and_then(|reader| {
            reader.take(&answer);
            reader.request()
        });
        if let Some(request) = next {
            self.own_question(request);
        }
    }
}
