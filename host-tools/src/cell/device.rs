//! Devices behind slave controllers: the interface between bus and device.
//!
//! A device describes itself (identity, information image, silicon, mailbox, process data, objects), holds the values
//! of its live objects and mapped process data, and is stepped every millisecond. All access by a master goes through
//! the controller, the mailbox server and the object tables; no device knows the bus.

use super::dictionary::Dictionary;
use super::live_objects::LiveObjects;
use super::process_data::ProcessData;
use super::servo::{Emergency, Servo};
use etherpen::ethercat::wire::register::{CONTROL_INPUTS, CONTROL_MAILBOX_IN, CONTROL_MAILBOX_OUT, CONTROL_OUTPUTS};
use etherpen::ethercat::wire::sii::MailboxWindow;
use std::fmt;

/// The slave controller's silicon, registers 0x0000 to 0x0009.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Silicon {
    /// Type, revision, build (2 bytes).
    pub(super) identity: [u8; 4],
    /// Number of fieldbus memory management units.
    pub(super) fmmus: u8,
    /// Number of sync managers.
    pub(super) sync_managers: u8,
    /// Process memory, KiB.
    pub(super) memory_kib: u8,
    /// Kind of each port, two bits each: 0 none, 2 EBUS, 3 MII.
    pub(super) ports: u8,
    /// Width of the distributed clock.
    pub(super) clock: ClockWidth,
}

/// Width of a slave's distributed clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockWidth {
    /// No distributed clock.
    None,
    /// 32 bits: system time wraps after 4.29 s.
    Bits32,
    /// 64 bits.
    Bits64,
}

impl Silicon {
    /// An ET1100 with two MII ports.
    pub(super) const ET1100: Self = Self {
        identity: [0x11, 0x00, 0x02, 0x00],
        fmmus: 8,
        sync_managers: 8,
        memory_kib: 8,
        ports: 0x0F,
        clock: ClockWidth::Bits64,
    };
}

/// The two mailboxes and the process-data windows that the device requires.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Windows {
    /// Mailbox the master writes; length 0 if there is none.
    pub(super) mailbox_out: MailboxWindow,
    /// Mailbox the master reads.
    pub(super) mailbox_in: MailboxWindow,
    /// Start of the outputs.
    pub(super) outputs: u16,
    /// Start of the inputs.
    pub(super) inputs: u16,
}

impl Windows {
    /// Whether the device has a mailbox.
    pub(super) fn has_mailbox(&self) -> bool {
        self.mailbox_out.length > 0 && self.mailbox_in.length > 0
    }

    /// The four sync managers of a slave with a mailbox, as the information image describes them.
    pub(super) fn sync_managers(&self, bytes: (usize, usize)) -> Vec<SyncManagerDefault> {
        let manager = |start, length, control, kind| SyncManagerDefault {
            start,
            length,
            control,
            activate: 1,
            kind,
        };
        let (outputs, inputs) = bytes;
        vec![
            manager(self.mailbox_out.start, self.mailbox_out.length, CONTROL_MAILBOX_OUT, 1),
            manager(self.mailbox_in.start, self.mailbox_in.length, CONTROL_MAILBOX_IN, 2),
            manager(self.outputs, outputs as u16, CONTROL_OUTPUTS, 3),
            manager(self.inputs, inputs as u16, CONTROL_INPUTS, 4),
        ]
    }
}

/// One sync manager as described in an information image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SyncManagerDefault {
    /// First byte.
    pub(super) start: u16,
    /// Length, bytes.
    pub(super) length: u16,
    /// Control byte.
    pub(super) control: u8,
    /// Activation byte.
    pub(super) activate: u8,
    /// 1 and 2 mailbox out and in, 3 and 4 process data out and in.
    pub(super) kind: u8,
}

/// A device behind a slave controller.
pub(super) trait Device: LiveObjects + fmt::Debug + Send {
    /// The slave information image.
    fn image(&self) -> Vec<u8>;
    /// The controller's silicon.
    fn silicon(&self) -> Silicon {
        Silicon::ET1100
    }
    /// Windows of mailboxes and process data.
    fn windows(&self) -> Windows;
    /// PDOs and their assignment after power-up.
    fn process_data(&self) -> ProcessData;
    /// Objects after power-up.
    fn dictionary(&self) -> Dictionary;
    /// Resets everything but the motor to its state after power-up.
    fn power_up(&mut self) {}
    /// Advances by one millisecond; `operational` if the outputs are valid.
    fn step(&mut self, _operational: bool) {}
    /// Advances by one millisecond in which the processor is stopped, too short for the power stage to notice.
    fn coast(&mut self) {}
    /// Samples the inputs of this millisecond, after every motor has moved.
    fn sample(&mut self) {}
    /// Handles the loss of cyclic data.
    fn cyclic_data_lost(&mut self) {}
    /// The next emergency.
    fn take_emergency(&mut self) -> Option<Emergency> {
        None
    }
    /// The drive inside, if there is one.
    fn servo(&self) -> Option<&Servo> {
        None
    }
    /// The drive inside, mutable, if there is one.
    fn servo_mut(&mut self) -> Option<&mut Servo> {
        None
    }
    /// A copy of the device.
    fn boxed_clone(&self) -> Box<dyn Device>;
}

impl Clone for Box<dyn Device> {
    fn clone(&self) -> Self {
        self.as_ref().boxed_clone()
    }
}
