//! State of the Ethernet port.

/// State of the Ethernet port as reported by its PHY.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum PortState {
    /// The board has no PHY; the port counts as up.
    #[default]
    Unknown,
    /// No PHY answers.
    NoPhy,
    /// The PHY has no link: no cable, or nothing at its other end.
    Down,
    /// The link is up.
    Up,
}

impl PortState {
    /// Whether the port certainly carries no frames.
    pub const fn is_down(self) -> bool {
        matches!(self, Self::NoPhy | Self::Down)
    }
}
