//! A sync manager: transfers an area of process memory consistently between bus and slave.
//!
//! Buffered mode: one side writes a whole buffer, the other side always sees the last complete one. The three rotating
//! buffers of the silicon are two here (filling and complete). That is equivalent as long as one side does not read
//! while the other swaps; frames and application never overlap here. Mailbox mode: full until the other side has
//! read the message to its last byte. The first byte opens a buffer and the last byte hands it over; the bytes between
//! need not be touched. The slave's side can deactivate a sync manager: its area is locked for the bus then. Register
//! layout: sync manager registers 0x0800 to 0x087F of the slave controller's register description.

const CONTROL_MODE_MASK: u8 = 0x03;
const CONTROL_MODE_MAILBOX: u8 = 0x02;
const CONTROL_DIRECTION_MASK: u8 = 0x0C;
const CONTROL_DIRECTION_BUS_WRITES: u8 = 0x04;
const CONTROL_EVENT: u8 = 0x10;
const CONTROL_WATCHDOG: u8 = 0x40;
const STATUS_WRITTEN: u8 = 0x01;
const STATUS_READ: u8 = 0x02;
const STATUS_MAILBOX_FULL: u8 = 0x08;
const STATUS_BUFFER_SHIFT: u8 = 4;
const STATUS_READ_OPEN: u8 = 0x40;
const STATUS_WRITE_OPEN: u8 = 0x80;
/// Number of buffers, and the number that says that none was written.
const BUFFERS: u8 = 3;
const STATUS_NO_BUFFER_WRITTEN: u8 = BUFFERS << STATUS_BUFFER_SHIFT;
const PDI_DEACTIVATE: u8 = 0x01;
const ACTIVATE_ENABLE: u8 = 0x01;
const REPEAT: u8 = 0x02;

/// Bytes of one sync manager's register block.
pub(crate) const BLOCK: usize = 8;
/// Offsets inside the block.
pub(crate) const STATUS_OFFSET: usize = 5;
pub(crate) const PDI_CONTROL_OFFSET: usize = 7;
/// Bytes of start, length and control: not writable while the sync manager is enabled.
pub(crate) const LOCKED_LENGTH: usize = 5;

/// Configuration and content of one sync manager.
#[derive(Clone, Debug, Default)]
pub(crate) struct SyncManager {
    start: usize,
    control: u8,
    enabled: bool,
    /// Whether the slave's side has deactivated the sync manager.
    deactivated: bool,
    repeat_requested: bool,
    repeat_acknowledged: bool,
    filling: Vec<u8>,
    complete: Vec<u8>,
    open: bool,
    full: bool,
    ever_written: bool,
    written_since_look: bool,
    /// Flags of the status: a buffer was written completely, or read completely. The first byte that the other side then reads or
    /// writes clears them.
    was_written: bool,
    was_read: bool,
    /// Number of the buffer written last.
    buffer: u8,
    /// Whether the slave's side has opened a buffer to write it.
    composing: bool,
}

impl SyncManager {
    /// Takes the register block written by the bus.
    pub(crate) fn configure(&mut self, block: [u8; BLOCK]) {
        let [start_low, start_high, length_low, length_high, control, _, activate, _] = block;
        let start = usize::from(u16::from_le_bytes([start_low, start_high]));
        let length = usize::from(u16::from_le_bytes([length_low, length_high]));
        let enabled = activate & ACTIVATE_ENABLE != 0;
        let changed = start != self.start || length != self.complete.len() || control != self.control;
        if changed || enabled != self.enabled {
            let acknowledged = self.repeat_acknowledged;
            *self = Self {
                start,
                control,
                enabled,
                deactivated: self.deactivated,
                filling: vec![0; length],
                ..Self::default()
            };
            self.complete = vec![0; length];
            self.repeat_acknowledged = acknowledged;
        }
        self.repeat_requested = activate & REPEAT != 0;
    }

    /// Start of the area in process memory.
    #[inline]
    pub(crate) fn start(&self) -> usize {
        self.start
    }

    /// First address behind the area.
    #[inline]
    pub(crate) fn end(&self) -> usize {
        self.start + self.complete.len()
    }

    /// Length of the area, bytes.
    #[inline]
    pub(crate) fn length(&self) -> usize {
        self.complete.len()
    }

    /// Whether the bus has enabled the sync manager, whatever its length.
    #[inline]
    pub(crate) fn is_enabled(&self) -> bool {
        self.enabled
    }

    /// Whether the sync manager controls an area: it is enabled and has a length.
    #[inline]
    pub(crate) fn is_active(&self) -> bool {
        self.enabled && !self.complete.is_empty()
    }

    /// Whether the bus writes and the slave reads.
    #[inline]
    pub(crate) fn is_bus_written(&self) -> bool {
        self.control & CONTROL_DIRECTION_MASK == CONTROL_DIRECTION_BUS_WRITES
    }

    /// Whether the area is a mailbox.
    #[inline]
    pub(crate) fn is_mailbox(&self) -> bool {
        self.control & CONTROL_MODE_MASK == CONTROL_MODE_MAILBOX
    }

    /// Whether writes feed the process-data watchdog.
    #[inline]
    pub(crate) fn triggers_watchdog(&self) -> bool {
        self.control & CONTROL_WATCHDOG != 0
    }

    /// The status register's content.
    pub(crate) fn status(&self) -> u8 {
        if !self.enabled {
            return STATUS_NO_BUFFER_WRITTEN;
        }
        let flag = |set, bit| if set { bit } else { 0 };
        let content = match (self.is_mailbox(), self.ever_written) {
            (true, _) => flag(self.full, STATUS_MAILBOX_FULL),
            (false, true) => self.buffer << STATUS_BUFFER_SHIFT,
            (false, false) => STATUS_NO_BUFFER_WRITTEN,
        };
        let (reading, writing) = match self.is_bus_written() {
            true => (false, self.open),
            false => (self.open, self.composing),
        };
        content
            | flag(self.was_written, STATUS_WRITTEN)
            | flag(self.was_read, STATUS_READ)
            | flag(reading, STATUS_READ_OPEN)
            | flag(writing, STATUS_WRITE_OPEN)
    }

    /// Whether the bus asked for an event of this sync manager, and the slave's side has written or read a buffer.
    pub(crate) fn has_event(&self) -> bool {
        let done = match self.is_bus_written() {
            true => self.was_read,
            false => self.was_written,
        };
        self.is_active() && self.control & CONTROL_EVENT != 0 && done
    }

    /// The slave's side has read the last complete buffer.
    pub(crate) fn note_read(&mut self) {
        if self.ever_written && self.was_written {
            (self.was_written, self.was_read) = (false, true);
        }
    }

    /// Sets whether the slave's side has opened a buffer to write it.
    pub(crate) fn set_composing(&mut self, composing: bool) {
        self.composing = composing;
        self.was_read &= !composing;
    }

    /// The register written by the slave's side: deactivation, and the acknowledgement of a repeat request.
    pub(crate) fn pdi_control(&self) -> u8 {
        let deactivated = if self.deactivated { PDI_DEACTIVATE } else { 0 };
        deactivated | if self.repeat_acknowledged { REPEAT } else { 0 }
    }

    /// Whether the slave's side has deactivated the sync manager.
    pub(crate) fn is_deactivated(&self) -> bool {
        self.deactivated
    }

    /// The slave's side deactivates the sync manager, which loses its content, or activates it.
    pub(crate) fn set_deactivated(&mut self, deactivated: bool) {
        if deactivated && !self.deactivated {
            self.clear();
        }
        self.deactivated = deactivated;
    }

    /// A read by the bus, `offset` bytes into the area; false if the silicon refuses it.
    pub(crate) fn bus_read(&mut self, offset: usize, into: &mut [u8]) -> bool {
        let empty = (self.is_mailbox() && !self.full) || !self.ever_written;
        if self.deactivated || self.is_bus_written() || empty {
            return false;
        }
        if offset == 0 {
            (self.open, self.was_written) = (true, false);
        }
        let end = offset + into.len();
        let Some(source) = self.complete.get(offset..end) else {
            return false;
        };
        if !self.open {
            return false;
        }
        into.copy_from_slice(source);
        if end == self.complete.len() {
            self.open = false;
            self.full = false;
            (self.was_written, self.was_read) = (false, true);
        }
        true
    }

    /// A write by the bus, `offset` bytes into the area; false if the silicon refuses it.
    pub(crate) fn bus_write(&mut self, offset: usize, data: &[u8]) -> bool {
        if self.deactivated || !self.is_bus_written() || (self.is_mailbox() && self.full) {
            return false;
        }
        if offset == 0 {
            (self.open, self.was_read) = (true, false);
        }
        let end = offset + data.len();
        let Some(target) = self.filling.get_mut(offset..end) else {
            return false;
        };
        if !self.open {
            return false;
        }
        target.copy_from_slice(data);
        if end == self.filling.len() {
            self.complete.copy_from_slice(&self.filling);
            self.written_since_look = true;
            self.hand_over();
        }
        true
    }

    /// Completes a buffer.
    fn hand_over(&mut self) {
        self.buffer = match self.ever_written {
            true => (self.buffer + 1) % BUFFERS,
            false => 0,
        };
        self.open = false;
        self.composing = false;
        self.full = true;
        self.ever_written = true;
        (self.was_written, self.was_read) = (true, false);
    }

    /// The slave's side takes a mailbox message, if there is one.
    pub(crate) fn take_message(&mut self) -> Option<Vec<u8>> {
        if !(self.is_active() && self.is_mailbox() && self.is_bus_written() && self.full) {
            return None;
        }
        self.full = false;
        (self.was_written, self.was_read) = (false, true);
        Some(self.complete.clone())
    }

    /// Whether the slave's side may write a mailbox message.
    pub(crate) fn accepts_message(&self) -> bool {
        self.is_active() && self.is_mailbox() && !self.is_bus_written() && !self.full
    }

    /// The slave's side writes a buffer or a message; shorter content is padded with zeros.
    pub(crate) fn put(&mut self, content: &[u8]) {
        if !self.is_active() || self.deactivated || self.is_bus_written() {
            return;
        }
        for (target, source) in self
            .complete
            .iter_mut()
            .zip(content.iter().chain(std::iter::repeat(&0)))
        {
            *target = *source;
        }
        self.hand_over();
    }

    /// The device's inputs without a processor: they are in the buffer whenever the bus does not just read it.
    pub(crate) fn feed(&mut self, content: &[u8]) {
        if !self.open {
            self.put(content);
        }
    }

    /// The last message of a mailbox, read or not.
    pub(crate) fn mail(&self) -> Option<&[u8]> {
        let has_had_mail = self.complete.iter().any(|byte| *byte != 0);
        (self.is_active() && self.is_mailbox() && has_had_mail).then_some(self.complete.as_slice())
    }

    /// The last complete buffer written by the bus; `None` before the first.
    pub(crate) fn outputs(&self) -> Option<&[u8]> {
        (self.is_active() && self.is_bus_written() && self.ever_written).then_some(self.complete.as_slice())
    }

    /// Whether the bus has completed a buffer since the last call.
    pub(crate) fn look_for_write(&mut self) -> bool {
        std::mem::take(&mut self.written_since_look)
    }

    /// Whether the bus has requested the last message again and was not answered yet.
    pub(crate) fn repeat_is_due(&self) -> bool {
        self.is_active() && self.repeat_requested != self.repeat_acknowledged
    }

    /// The slave's side has provided the last message again.
    pub(crate) fn acknowledge_repeat(&mut self) {
        self.repeat_acknowledged = self.repeat_requested;
    }

    /// Clears buffers and flags and keeps the configuration, as on a change to INIT.
    pub(crate) fn clear(&mut self) {
        self.open = false;
        self.composing = false;
        self.full = false;
        self.ever_written = false;
        self.written_since_look = false;
        (self.was_written, self.was_read) = (false, false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manager(control: u8, length: u8) -> SyncManager {
        let mut manager = SyncManager::default();
        manager.configure([0x00, 0x11, length, 0, control, 0, ACTIVATE_ENABLE, 0]);
        manager
    }

    #[test]
    fn a_buffer_counts_only_when_its_last_byte_is_written() {
        let mut manager = manager(0x64, 4);
        assert!(!manager.bus_write(2, &[9, 9]), "not opened at the first byte");
        assert!(manager.bus_write(0, &[1, 2]));
        assert_eq!(manager.outputs(), None);
        assert!(manager.bus_write(2, &[3, 4]));
        assert_eq!(manager.outputs(), Some([1, 2, 3, 4].as_slice()));
        assert!(manager.look_for_write() && !manager.look_for_write());
    }

    #[test]
    fn a_full_mailbox_refuses_a_second_message() {
        let mut manager = manager(0x26, 2);
        assert!(manager.bus_write(0, &[1, 2]));
        assert_eq!(manager.status() & STATUS_MAILBOX_FULL, STATUS_MAILBOX_FULL);
        assert!(!manager.bus_write(0, &[3, 4]));
        assert_eq!(manager.take_message(), Some(vec![1, 2]));
        assert_eq!(manager.status() & STATUS_MAILBOX_FULL, 0);
        assert!(manager.bus_write(0, &[3, 4]));
    }

    #[test]
    fn an_empty_mailbox_is_not_read_and_a_read_one_is_empty() {
        let mut manager = manager(0x22, 2);
        let mut into = [0; 2];
        assert!(!manager.bus_read(0, &mut into));
        manager.put(&[5]);
        assert!(manager.bus_read(0, &mut into));
        assert_eq!(into, [5, 0]);
        assert!(!manager.bus_read(0, &mut into));
    }

    #[test]
    fn the_status_tells_who_was_last_and_which_buffer() {
        let mut mailbox = manager(0x22, 2);
        let mut seen = vec![mailbox.status()];
        mailbox.put(&[1, 2]);
        seen.push(mailbox.status());
        assert!(mailbox.bus_read(0, &mut [0; 2]));
        seen.push(mailbox.status());
        assert_eq!(seen, [0x00, 0x09, 0x02], "as an AKD's");
        let mut buffers = manager(0x64, 1);
        let mut seen = vec![buffers.status()];
        for _ in 0..4 {
            assert!(buffers.bus_write(0, &[1]));
            seen.push(buffers.status());
        }
        assert_eq!(seen, [0x30, 0x01, 0x11, 0x21, 0x01]);
        buffers.configure([0; BLOCK]);
        assert_eq!(buffers.status(), 0x30);
    }

    #[test]
    fn a_buffer_in_use_shows_in_the_status() {
        let mut outputs = manager(0x64, 4);
        assert!(outputs.bus_write(0, &[1, 2]));
        assert_eq!(outputs.status(), 0xB0, "opened to write, nothing complete");
        assert!(outputs.bus_write(2, &[3, 4]));
        assert_eq!(outputs.status(), 0x01);
        outputs.note_read();
        assert_eq!(outputs.status(), 0x02);
        let mut inputs = manager(0x20, 4);
        inputs.put(&[1, 2, 3, 4]);
        assert!(inputs.bus_read(0, &mut [0; 2]));
        assert_eq!(inputs.status(), 0x40, "opened to read");
        assert!(inputs.bus_read(2, &mut [0; 2]));
        assert_eq!(inputs.status(), 0x02);
        inputs.set_composing(true);
        assert_eq!(inputs.status(), 0x80, "opened to write");
    }

    #[test]
    fn an_event_needs_its_control_bit() {
        for (control, event) in [(0x22, false), (0x32, true)] {
            let mut mailbox = manager(control, 2);
            assert!(!mailbox.has_event());
            mailbox.put(&[1, 2]);
            assert_eq!(mailbox.has_event(), event);
            assert!(mailbox.bus_read(0, &mut [0; 2]) && !mailbox.has_event());
        }
    }

    #[test]
    fn a_deactivated_area_is_locked() {
        let mut manager = manager(0x64, 1);
        assert!(manager.bus_write(0, &[7]));
        manager.set_deactivated(true);
        assert!(!manager.bus_write(0, &[8]));
        assert_eq!((manager.pdi_control(), manager.outputs()), (PDI_DEACTIVATE, None));
        manager.set_deactivated(false);
        assert_eq!(manager.outputs(), None, "the old content is lost");
        assert!(manager.bus_write(0, &[9]));
    }

    #[test]
    fn a_toggled_repeat_bit_is_due_once() {
        let mut manager = manager(0x22, 2);
        assert!(!manager.repeat_is_due());
        manager.configure([0x00, 0x11, 2, 0, 0x22, 0, ACTIVATE_ENABLE | REPEAT, 0]);
        assert!(manager.repeat_is_due());
        manager.acknowledge_repeat();
        assert!(!manager.repeat_is_due());
        assert_eq!(manager.pdi_control(), REPEAT);
    }
}
