//! Memory windows of a device as its information image describes them.

use etherpen_ethercat::wire::register::{CONTROL_INPUTS, CONTROL_MAILBOX_IN, CONTROL_MAILBOX_OUT, CONTROL_OUTPUTS};
use etherpen_ethercat::wire::sii::MailboxWindow;

/// The two mailboxes and the process-data windows that the device requires.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Windows {
    /// Mailbox the master writes; length 0 if there is none.
    pub(crate) mailbox_out: MailboxWindow,
    /// Mailbox the master reads.
    pub(crate) mailbox_in: MailboxWindow,
    /// Start of the outputs.
    pub(crate) outputs: u16,
    /// Start of the inputs.
    pub(crate) inputs: u16,
    /// Protocols of the mailbox, as in the information image.
    pub(crate) protocols: u16,
    /// Mailbox that the master writes in BOOT; length 0 if there is no such state.
    pub(crate) bootstrap_out: MailboxWindow,
    /// Mailbox that the master reads in BOOT.
    pub(crate) bootstrap_in: MailboxWindow,
}

impl Windows {
    /// No windows.
    pub(crate) const NONE: Self = Self {
        mailbox_out: MailboxWindow { start: 0, length: 0 },
        mailbox_in: MailboxWindow { start: 0, length: 0 },
        outputs: 0,
        inputs: 0,
        protocols: 0,
        bootstrap_out: MailboxWindow { start: 0, length: 0 },
        bootstrap_in: MailboxWindow { start: 0, length: 0 },
    };

    /// Whether the device has the state BOOT.
    pub(crate) fn has_bootstrap(&self) -> bool {
        self.bootstrap_out.length > 0 && self.bootstrap_in.length > 0
    }

    /// Whether the device has a mailbox.
    pub(crate) fn has_mailbox(&self) -> bool {
        self.mailbox_out.length > 0 && self.mailbox_in.length > 0
    }

    /// The sync managers of a slave with a mailbox, as the information image describes them. `types`: as object 0x1C00 tells
    /// them; `bytes`: those of outputs and inputs.
    pub(crate) fn sync_managers(&self, types: &[u8], bytes: (usize, usize)) -> Vec<SyncManagerDefault> {
        let (outputs, inputs) = bytes;
        let manager = |kind: &u8| {
            let (start, length, control) = match kind {
                1 => (self.mailbox_out.start, self.mailbox_out.length, CONTROL_MAILBOX_OUT),
                2 => (self.mailbox_in.start, self.mailbox_in.length, CONTROL_MAILBOX_IN),
                3 => (self.outputs, outputs as u16, CONTROL_OUTPUTS),
                4 => (self.inputs, inputs as u16, CONTROL_INPUTS),
                _ => (0, 0, 0),
            };
            SyncManagerDefault {
                start,
                length,
                control,
                activate: u8::from(*kind != 0),
                kind: *kind,
            }
        };
        types.iter().map(manager).collect()
    }
}

/// One sync manager as described in an information image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SyncManagerDefault {
    /// First byte.
    pub(crate) start: u16,
    /// Length, bytes.
    pub(crate) length: u16,
    /// Control byte.
    pub(crate) control: u8,
    /// Activation byte.
    pub(crate) activate: u8,
    /// 1 and 2 mailbox out and in, 3 and 4 process data out and in.
    pub(crate) kind: u8,
}
