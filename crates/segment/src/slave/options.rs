//! What one slave's processor is like.

/// Properties of a slave's processor; they mean nothing for a slave that has none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlaveOptions {
    /// Whether the processor reads the information memory on the way from INIT to PREOP. It refuses this way with AL
    /// status code 0x0050 unless the master has given it the access (register 0x0500, bit 0).
    pub reads_sii: bool,
    /// How long the processor starts after power-up, ms. Until then it reads no state request, while the registers
    /// answer.
    pub boot_ms: u64,
    /// How long the processor takes for a change of state, ms, in addition to the millisecond of its cycle.
    pub transition_ms: u64,
    /// How long the answer to a mailbox message takes, ms, in addition to the millisecond of its cycle.
    pub mailbox_ms: u64,
}
