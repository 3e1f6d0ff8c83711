//! Operating mode and fault in the log: a line at every change, written by the task that steps the modes.

use etherpen::application::{Fault, Mode};

/// State last logged.
pub(crate) struct ModeLog {
    mode: Mode,
    fault: Option<Fault>,
}

impl ModeLog {
    pub(crate) const fn new() -> Self {
        Self {
            mode: Mode::Startup,
            fault: None,
        }
    }

    /// Logs changes; returns a new fault.
    pub(crate) fn watch(&mut self, mode: Mode, fault: Option<Fault>) -> Option<Fault> {
        if mode != self.mode {
            self.mode = mode;
            defmt::info!("mode {}", defmt::Debug2Format(&mode));
        }
        if fault == self.fault {
            return None;
        }
        self.fault = fault;
        match &fault {
            Some(fault) => defmt::error!("fault {}", defmt::Debug2Format(fault)),
            None => defmt::info!("fault cleared"),
        }
        fault
    }
}
