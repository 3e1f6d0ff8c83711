//! Type of a slave controller, as its first registers report it.

/// The slave controller's silicon, registers 0x0000 to 0x0009.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Silicon {
    /// Type, revision, build (2 bytes).
    pub(crate) identity: [u8; 4],
    /// Number of fieldbus memory management units.
    pub(crate) fmmus: u8,
    /// Number of sync managers.
    pub(crate) sync_managers: u8,
    /// Process memory, KiB.
    pub(crate) memory_kib: u8,
    /// Kind of each port, two bits each: 0 none, 2 EBUS, 3 MII.
    pub(crate) ports: u8,
    /// Width of the distributed clock.
    pub(crate) clock: ClockWidth,
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
    pub(crate) const ET1100: Self = Self {
        identity: [0x11, 0x00, 0x02, 0x00],
        fmmus: 8,
        sync_managers: 8,
        memory_kib: 8,
        ports: 0x0F,
        clock: ClockWidth::Bits64,
    };
}
