//! Process data of a slave between its sync managers and its device, their watchdog, and the checks of both.

use super::{MAILBOX_IN_MANAGER, MAILBOX_OUT_MANAGER, Slave};
use crate::application::{AlState, Readiness, code};
use crate::controller::clock::SyncState;
use crate::devices::ProcessManager;
use etherpen_ethercat::wire::sii::MailboxWindow;

impl Slave {
    /// The inputs of a device that gives them no meaning of their own.
    pub(crate) fn inputs(&self) -> Option<&[u8]> {
        let io = self.device.io().filter(|_| !self.managers.inputs.is_empty());
        io.map(|io| io.inputs.as_slice())
    }

    /// Sets the first inputs; bytes behind them keep their values.
    pub(crate) fn set_inputs(&mut self, inputs: &[u8]) {
        let grows = self.managers.inputs.iter().any(|manager| manager.bytes.is_none());
        if let Some(io) = self.device.io_mut() {
            if grows && io.inputs.len() < inputs.len() {
                io.inputs.resize(inputs.len(), 0);
            }
            for (input, value) in io.inputs.iter_mut().zip(inputs) {
                *input = *value;
            }
        }
        self.feed();
    }

    /// The outputs of a device that gives them no meaning of their own: 0 outside OP and after the watchdog.
    pub(crate) fn outputs(&self) -> Option<Vec<u8>> {
        let io = self.device.io().filter(|_| !self.managers.outputs.is_empty())?;
        if !self.controller.is_emulated() {
            return Some(io.outputs.clone());
        }
        let mut outputs = vec![0; io.outputs.len()];
        let valid = self.is_powered() && self.state() == AlState::Operational && !self.controller.watchdog_expired();
        let mut rest = outputs.as_mut_slice();
        for manager in self.managers.outputs.iter().filter(|_| valid) {
            let length = manager.bytes.unwrap_or(0).min(rest.len());
            let (here, behind) = rest.split_at_mut(length);
            let unit = self.controller.sync_manager(manager.number);
            let written = unit
                .filter(|unit| unit.start() == manager.start)
                .and_then(|unit| unit.outputs())
                .unwrap_or_default();
            here.iter_mut().zip(written).for_each(|(output, byte)| *output = *byte);
            rest = behind;
        }
        Some(outputs)
    }

    /// Without a processor, the silicon shows the inputs to the bus at any time and in any state.
    pub(super) fn feed(&mut self) {
        if !self.controller.is_emulated() {
            return;
        }
        let mut at = 0;
        for manager in &self.managers.inputs {
            let length = manager.bytes.unwrap_or(0);
            let inputs = self.device.io().and_then(|io| io.inputs.get(at..at + length));
            if let Some(inputs) = inputs {
                self.controller.feed(manager.number, manager.start, inputs);
            }
            at += length;
        }
    }

    /// Passes the inputs of the device to the sync managers.
    pub(super) fn put_inputs(&mut self) {
        if self.application.state() < AlState::SafeOperational {
            return;
        }
        let packed;
        let mut rest = match self.device.io() {
            Some(io) => io.inputs.as_slice(),
            None => {
                packed = self.process_data.pack(self.device.as_ref());
                packed.as_slice()
            }
        };
        for manager in &self.managers.inputs {
            let (here, behind) = rest.split_at(manager.bytes.unwrap_or(rest.len()).min(rest.len()));
            self.controller.with_sync_manager(manager.number, |unit| unit.put(here));
            rest = behind;
        }
    }

    /// Passes the outputs to the device; returns false without valid outputs.
    pub(super) fn take_outputs(&mut self) -> bool {
        if self.application.state() != AlState::Operational || !self.read_outputs() {
            return false;
        }
        for manager in &self.managers.outputs {
            self.controller
                .with_sync_manager(manager.number, |unit| unit.note_read());
        }
        true
    }

    fn read_outputs(&mut self) -> bool {
        let controller = &self.controller;
        let buffer = |manager: &ProcessManager| controller.sync_manager(manager.number)?.outputs();
        if let Some(io) = self.device.io_mut() {
            let buffers: Option<Vec<&[u8]>> = self.managers.outputs.iter().map(buffer).collect();
            let Some(buffers) = buffers else { return false };
            io.outputs = buffers.concat();
            return true;
        }
        let Some(outputs) = self.managers.outputs.first().and_then(buffer) else {
            return false;
        };
        self.process_data.unpack(outputs, self.device.as_mut());
        true
    }

    /// Runs the process-data watchdog in milliseconds of the segment; returns whether it has expired now.
    fn run_watchdog(&mut self, watches: bool) -> bool {
        let (mut fed, mut triggers) = (false, false);
        for manager in &self.managers.outputs {
            fed |= self
                .controller
                .with_sync_manager(manager.number, |unit| unit.look_for_write());
            let unit = self.controller.sync_manager(manager.number);
            triggers |= unit.is_some_and(|unit| unit.triggers_watchdog());
        }
        if fed {
            self.outputs_received = true;
            self.unfed_ms = 0;
            self.controller.set_watchdog(false);
            return false;
        }
        self.unfed_ms = self.unfed_ms.saturating_add(1);
        let limit_us = self.controller.watchdog_us();
        let over = limit_us.is_some_and(|limit_us| self.unfed_ms.saturating_mul(1000) >= limit_us);
        let expired = watches && triggers && over;
        if expired {
            self.controller.set_watchdog(true);
        }
        expired
    }

    /// The watchdog of a device without a processor resets the outputs, not the state.
    pub(super) fn watch_alone(&mut self) {
        self.run_watchdog(self.outputs_received);
    }

    /// The watchdog of a device with a processor: SAFEOP.
    pub(super) fn watch(&mut self) {
        let state = self.application.state();
        let expired = self.run_watchdog(state == AlState::Operational);
        self.outputs_received &= state >= AlState::SafeOperational;
        self.device.set_outputs_missed(self.unfed_ms > 0);
        if expired {
            self.application.retreat(AlState::SafeOperational, code::WATCHDOG);
            self.device.cyclic_data_lost();
            self.outputs_received = false;
            self.show_state();
        }
    }

    /// The processor activates the sync managers that belong to the present state and deactivates the others.
    pub(super) fn activate_sync_managers(&mut self) {
        if self.is_alone() {
            return;
        }
        let state = self.application.state();
        let mut set = |number, least| {
            let deactivated = state < least;
            let unit = self.controller.sync_manager(number);
            if unit.is_some_and(|unit| unit.is_deactivated() != deactivated) {
                self.controller
                    .with_sync_manager(number, |unit| unit.set_deactivated(deactivated));
            }
        };
        if self.device.windows().has_mailbox() {
            set(MAILBOX_OUT_MANAGER, AlState::PreOperational);
            set(MAILBOX_IN_MANAGER, AlState::PreOperational);
        }
        for manager in self.managers.outputs.iter().chain(&self.managers.inputs) {
            set(manager.number, AlState::SafeOperational);
        }
    }

    /// What the transitions need, as the registers are now.
    pub(super) fn readiness(&self) -> Readiness {
        let assigned = self.process_data.bytes();
        let windows = self.device.windows();
        let is_mailbox = |index, window: MailboxWindow, bus_written| {
            self.controller.sync_manager(index).is_some_and(|manager| {
                manager.is_active()
                    && manager.is_mailbox()
                    && manager.is_bus_written() == bus_written
                    && manager.start() == usize::from(window.start)
                    && manager.length() == usize::from(window.length)
            })
        };
        let is_process_data = |manager: &ProcessManager, assigned: usize, bus_written| {
            let bytes = manager.bytes.unwrap_or(assigned);
            self.controller.sync_manager(manager.number).is_some_and(|unit| {
                let fits = unit.length() == bytes;
                let kind = !unit.is_mailbox() && unit.is_bus_written() == bus_written;
                match unit.is_active() {
                    true => kind && fits && bytes > 0,
                    false => bytes == 0,
                }
            })
        };
        let (outputs, inputs) = (&self.managers.outputs, &self.managers.inputs);
        let no_outputs = outputs.iter().all(|manager| manager.bytes.unwrap_or(assigned.0) == 0);
        let sync = self.controller.sync_state();
        Readiness {
            sync_valid: sync != SyncState::Invalid,
            synchronous: matches!(sync, SyncState::Off | SyncState::Running),
            bootstrap: windows.has_bootstrap().then(|| {
                is_mailbox(MAILBOX_OUT_MANAGER, windows.bootstrap_out, true)
                    && is_mailbox(MAILBOX_IN_MANAGER, windows.bootstrap_in, false)
            }),
            mailbox: !windows.has_mailbox()
                || is_mailbox(MAILBOX_OUT_MANAGER, windows.mailbox_out, true)
                    && is_mailbox(MAILBOX_IN_MANAGER, windows.mailbox_in, false),
            information: !self.options.reads_sii || self.controller.offers_sii() || self.controller.holds_sii(),
            outputs: outputs.iter().all(|manager| is_process_data(manager, assigned.0, true))
                && self.device.accepts(&self.process_data),
            inputs: inputs.iter().all(|manager| is_process_data(manager, assigned.1, false)),
            outputs_received: self.outputs_received || no_outputs,
        }
    }
}
