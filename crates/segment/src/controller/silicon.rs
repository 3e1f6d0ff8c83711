//! Type of a slave controller, as its first registers report it.

/// Features: distributed clocks, and 64-bit distributed clocks.
const FEATURE_CLOCK: u16 = 0x0004;
const FEATURE_CLOCK_64: u16 = 0x0008;
/// Feature: LRW is not supported.
const FEATURE_NO_LRW: u16 = 0x0200;
/// Feature that goes with 64-bit clocks here: enhanced link detection (MII).
const FEATURE_ENHANCED_LINK: u16 = 0x0040;

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
    /// Kind of each port, two bits each: 0 none, 1 not configured, 2 EBUS, 3 MII.
    pub(crate) ports: u8,
    /// Features of the silicon with a 64-bit clock.
    pub(crate) features: u16,
    /// Width of the distributed clock.
    pub(crate) clock: ClockWidth,
    /// Idle state of the information memory's control register: bit 5 emulated by the processor, bit 6 reads of eight
    /// bytes, bit 7 two address bytes, bit 4 set by some controllers without a known meaning.
    pub(crate) sii_flags: u16,
    /// Whether LRW is not supported: such a datagram passes unchanged and uncounted.
    pub(crate) ignores_lrw: bool,
    /// Whether a write reaches at most two FMMUs or sync managers: a longer one has no effect and does not count.
    pub(crate) takes_pairs: bool,
}

/// Width of a slave's distributed clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockWidth {
    /// No distributed clock.
    None,
    /// Receive times of the ports only: no system time and no SYNC unit, although the features announce a clock.
    DelayOnly,
    /// 32 bits: system time wraps after 4.29 s.
    Bits32,
    /// 64 bits.
    Bits64,
}

/// A type of slave controller that a slave from a file can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControllerType {
    /// ET1100: 64-bit clock, eight FMMUs and sync managers.
    Et1100,
    /// LAN9252: 64-bit clock, three FMMUs and four sync managers, reads of the information memory bring four bytes.
    Lan9252,
    /// That of an AKD: 32-bit clock, an information memory that the processor emulates.
    Akd,
}

impl ControllerType {
    /// Words of a setting.
    pub(crate) const NAMES: [(&'static str, Self); 3] =
        [("et1100", Self::Et1100), ("lan9252", Self::Lan9252), ("akd", Self::Akd)];

    /// The silicon; it has the units that `used` has.
    pub(crate) fn silicon(self, used: &Silicon) -> Silicon {
        let silicon = match self {
            Self::Et1100 => Silicon::ET1100,
            Self::Lan9252 => Silicon::LAN9252,
            Self::Akd => Silicon::AKD,
        };
        Silicon {
            fmmus: used.fmmus.max(silicon.fmmus),
            sync_managers: used.sync_managers.max(silicon.sync_managers),
            ignores_lrw: used.ignores_lrw,
            ..silicon
        }
    }
}

impl Silicon {
    /// An ET1100 with two MII ports.
    pub(crate) const ET1100: Self = Self {
        identity: [0x11, 0x00, 0x02, 0x00],
        fmmus: 8,
        sync_managers: 8,
        memory_kib: 8,
        ports: 0x0F,
        features: 0x01CC,
        clock: ClockWidth::Bits64,
        sii_flags: 0x0040,
        ignores_lrw: false,
        takes_pairs: false,
    };

    /// The controller of a coupler: MII, E-bus, MII.
    pub(crate) const COUPLER: Self = Self {
        ports: 0x3B,
        features: 0x00FC,
        ..Self::ET1100
    };

    /// The small controller of a terminal between two E-bus neighbours. It measures delays and has no clock.
    pub(crate) const TERMINAL: Self = Self {
        identity: [0x12, 0x01, 0x02, 0x00],
        fmmus: 3,
        sync_managers: 4,
        memory_kib: 1,
        ports: 0x4A,
        features: 0x01FC,
        clock: ClockWidth::DelayOnly,
        sii_flags: 0x0050,
        ..Self::ET1100
    };

    /// A controller with integrated Ethernet, as on evaluation boards.
    pub(crate) const LAN9252: Self = Self {
        identity: [0xC0, 0x02, 0x00, 0x00],
        fmmus: 3,
        sync_managers: 4,
        memory_kib: 4,
        ports: 0x1F,
        sii_flags: 0x0080,
        ..Self::ET1100
    };

    /// The junction of a star: E-bus in and out, two MII ports.
    pub(crate) const JUNCTION: Self = Self {
        ports: 0xFA,
        ..Self::COUPLER
    };

    /// The controller of an AKD: a 32-bit clock, and an information memory that the processor emulates.
    pub(crate) const AKD: Self = Self {
        identity: [0x04, 0x02, 0x43, 0x00],
        fmmus: 3,
        sync_managers: 4,
        memory_kib: 4,
        ports: 0x0F,
        features: 0x0184,
        clock: ClockWidth::Bits32,
        sii_flags: 0x0020,
        ..Self::ET1100
    };

    /// The controller without LRW, as its features tell.
    pub(crate) fn without_lrw(self) -> Self {
        Self {
            features: self.features | FEATURE_NO_LRW,
            ignores_lrw: true,
            ..self
        }
    }

    /// Content of the feature register, which depends on the clock.
    pub(crate) fn feature_register(&self) -> u16 {
        match self.clock {
            ClockWidth::None => self.features & !(FEATURE_CLOCK | FEATURE_CLOCK_64),
            ClockWidth::Bits32 => self.features & !(FEATURE_CLOCK_64 | FEATURE_ENHANCED_LINK),
            ClockWidth::DelayOnly => self.features,
            ClockWidth::Bits64 => self.features | FEATURE_CLOCK_64,
        }
    }
}

impl ClockWidth {
    /// Whether there is a system time.
    pub(crate) fn has_system_time(self) -> bool {
        matches!(self, Self::Bits32 | Self::Bits64)
    }
}
