//! What is individual about one slave: its processor's manners, and what its owner has set on it.

use crate::controller::silicon::{ClockWidth, ControllerType};
use crate::drive::OneTurn;
use crate::mailbox::process_data::DataManagers;

/// Properties of a slave's processor; they mean nothing for a slave that has none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlaveOptions {
    /// Whether the processor reads the information memory on the way from INIT to PREOP. It refuses this way with AL
    /// status code 0x0050 unless the master has given it the access (register 0x0500, bit 0).
    pub reads_sii: bool,
    /// Whether the processor ignores a request to give its last mailbox message again: it never acknowledges one.
    pub ignores_repeats: bool,
    /// How long the processor starts after power-up, ms. Until then it reads no state request, while the registers
    /// answer.
    pub boot_ms: u64,
    /// How long the processor takes for a change of state, ms, in addition to the millisecond of its cycle.
    pub transition_ms: u64,
    /// How long the answer to a mailbox message takes, ms, in addition to the millisecond of its cycle.
    pub mailbox_ms: u64,
}

/// What is set on the slave at one place of the chain, and stays with that device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaceOptions {
    /// Configured alias: word 4 of the information memory, register 0x0012 after power-up.
    pub alias: u16,
    /// Serial number in the information memory and, with a mailbox, in object 0x1018:4. `None` for the kind's own:
    /// drives count from 1 in the order of the chain, other kinds have 0, an image from a file has its own.
    pub serial: Option<u32>,
    /// Number set with the switches of the device. A master asks for it with bit 5 of AL control; bit 5 of AL status
    /// then says that register 0x0134 is this number. `None` for a device without switches.
    pub identification: Option<u16>,
    /// Width of the clock; `None` for the kind's, or else the segment's width. No effect on a kind without a clock.
    pub clock: Option<ClockWidth>,
    /// Type of the slave controller; `None` for the one that the information memory suggests. No effect on a kind that is not
    /// from a file.
    pub controller: Option<ControllerType>,
    /// Sync managers that carry the drive's process data; `None` for 2 and 3. No effect on other slaves.
    pub managers: Option<DataManagers>,
    /// Password of the files (FoE); 0 for none. No effect on a kind without files.
    pub password: u32,
    /// Whether the drive counts one motor turn only. No effect on a drive that counts one turn by itself (AX2000) and on other
    /// slaves.
    pub one_turn: Option<OneTurn>,
    /// Time constant in which the clock follows the reference clock, ms. `None` for 10 ms, which locks within half a
    /// second; the loop of real controllers takes seconds. No effect on a kind without a clock.
    pub lock_ms: Option<u32>,
    /// Whether the controller does not support LRW, as its features tell. An information memory that says so has the same
    /// effect; then the features do not tell.
    pub ignores_lrw: bool,
    /// Whether the controller takes at most two FMMUs or sync managers in one write: a longer one has no effect and does not
    /// count.
    pub takes_pairs: bool,
    /// The processor.
    pub processor: SlaveOptions,
}
