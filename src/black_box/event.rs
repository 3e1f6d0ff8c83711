//! What happened, with its millisecond.

use super::memory::{EVENT_WORDS, Memory};
use crate::application::{Command, Fault, Mode, Refusal};
use serde::{Deserialize, Serialize};

/// Bytes of an encoded event.
pub(super) const EVENT_BYTES: usize = (EVENT_WORDS - 2) * 4;

/// Something that happened.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// Recordings began: the firmware started, or earlier contents were discarded.
    Began,
    /// A host connected.
    Connected,
    /// A configuration with this hash was accepted.
    Configured {
        /// FNV-1a of its encoding.
        hash: u64,
    },
    /// The host gave a command.
    Command(Command),
    /// The command before was refused.
    Refused(Refusal),
    /// The operating mode changed.
    Mode(Mode),
    /// The latched fault changed; `None` when it was cleared.
    Fault(Option<Fault>),
}

/// Writes events; for the link task.
pub struct EventLog<'a> {
    memory: &'a Memory,
    mode: Option<Mode>,
    fault: Option<Fault>,
    /// The last command: a jog that is only repeated is recorded once.
    command: Option<Command>,
}

impl<'a> EventLog<'a> {
    /// A log that has seen nothing yet.
    pub const fn new(memory: &'a Memory) -> Self {
        Self {
            memory,
            mode: None,
            fault: None,
            command: None,
        }
    }

    /// The memory, for requests of the host.
    pub fn memory(&self) -> &Memory {
        self.memory
    }

    /// Records a command; a jog that is repeated unchanged is recorded once.
    pub fn command(&mut self, now_ms: u64, command: Command) {
        let repeated = matches!(command, Command::Jog { .. }) && self.command == Some(command);
        self.command = Some(command);
        if !repeated {
            self.put(now_ms, &Event::Command(command));
        }
    }

    /// Records an event, unless an earlier recording is kept.
    pub fn put(&mut self, now_ms: u64, event: &Event) {
        if !self.memory.takes() {
            return;
        }
        let mut bytes = [0; EVENT_BYTES];
        // Every event fits; one that did not would be recorded without its contents.
        let length = postcard::to_slice(event, &mut bytes).map_or(0, |used| used.len());
        let mut words = [0; EVENT_WORDS];
        let [ms, stored, encoded @ ..] = &mut words;
        (*ms, *stored) = (now_ms as u32, length as u32);
        for (word, bytes) in encoded.iter_mut().zip(bytes.as_chunks::<4>().0) {
            *word = u32::from_le_bytes(*bytes);
        }
        self.memory.put_event(&words);
    }

    /// Records changes of the operating mode and of the fault; call it once a millisecond.
    pub fn watch(&mut self, now_ms: u64, mode: Mode, fault: Option<Fault>) {
        if !self.memory.takes() {
            return;
        }
        if self.memory.has_no_events() {
            // The present state is news.
            (self.mode, self.fault, self.command) = (None, None, None);
            self.put(now_ms, &Event::Began);
        }
        if self.mode != Some(mode) {
            self.put(now_ms, &Event::Mode(mode));
            self.mode = Some(mode);
        }
        // A fault's figures are those of its first moment: another kind is another fault.
        if self.fault != fault {
            self.put(now_ms, &Event::Fault(fault));
            self.fault = fault;
        }
    }
}
