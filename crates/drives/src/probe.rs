//! Touch probe of CiA 402: the drive stores its position at an edge of an input or at an index pulse.
//!
//! Objects 0x60B8 (function), 0x60B9 (status) and 0x60BA to 0x60BD (positions of probe 1 and 2, rising and falling edge).
//! A probe is armed by a new edge of its enable bit: what the drive stored before the probe was armed does not count.
//!
//! Invariant: a position is given only after the drive has shown the probe enabled and nothing stored.

use etherpen_ethercat::wire::coe::Object;

/// Touch probe function, 16 bits.
pub const PROBE_FUNCTION: Object = Object::new(0x60B8, 0);
/// Touch probe status, 16 bits.
pub const PROBE_STATUS: Object = Object::new(0x60B9, 0);

const ENABLE: u16 = 1 << 0;
const CONTINUOUS: u16 = 1 << 1;
const INDEX: u16 = 1 << 2;
const RISING: u16 = 1 << 4;
const FALLING: u16 = 1 << 5;
/// In the status.
const STORED_RISING: u16 = 1 << 1;
const STORED_FALLING: u16 = 1 << 2;

/// One of a drive's two probes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeNumber {
    /// Probe 1: the low byte of function and status.
    One,
    /// Probe 2: the high byte.
    Two,
}

impl ProbeNumber {
    const fn shift(self) -> u32 {
        match self {
            Self::One => 0,
            Self::Two => 8,
        }
    }

    /// The object with the position of an edge, 32 bits.
    pub const fn position(self, edge: ProbeEdge) -> Object {
        let index = match (self, edge) {
            (Self::One, ProbeEdge::Rising) => 0x60BA,
            (Self::One, ProbeEdge::Falling) => 0x60BB,
            (Self::Two, ProbeEdge::Rising) => 0x60BC,
            (Self::Two, ProbeEdge::Falling) => 0x60BD,
        };
        Object::new(index, 0)
    }
}

/// What triggers a probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeSource {
    /// The probe's digital input.
    Input,
    /// The encoder's index pulse.
    Index,
}

/// An edge of the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeEdge {
    /// From inactive to active.
    Rising,
    /// From active to inactive.
    Falling,
}

impl ProbeEdge {
    const fn function(self) -> u16 {
        match self {
            Self::Rising => RISING,
            Self::Falling => FALLING,
        }
    }

    const fn stored(self) -> u16 {
        match self {
            Self::Rising => STORED_RISING,
            Self::Falling => STORED_FALLING,
        }
    }
}

/// Settings of a probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProbeSettings {
    /// Which probe.
    pub number: ProbeNumber,
    /// What triggers it.
    pub source: ProbeSource,
    /// The edge that counts.
    pub edge: ProbeEdge,
    /// Whether each edge counts, instead of the first one only.
    pub continuous: bool,
}

impl ProbeSettings {
    /// The probe's bits of the function while it is enabled.
    const fn function(&self) -> u16 {
        let source = match self.source {
            ProbeSource::Input => 0,
            ProbeSource::Index => INDEX,
        };
        let continuous = if self.continuous { CONTINUOUS } else { 0 };
        (ENABLE | source | continuous | self.edge.function()) << self.number.shift()
    }
}

/// A probe at work, stepped once a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Probe {
    settings: ProbeSettings,
    /// Whether the drive has shown the probe disabled since the last edge of the enable bit, and then armed.
    disabled: bool,
    armed: bool,
}

impl Probe {
    /// A probe that is armed by the next steps.
    pub const fn new(settings: ProbeSettings) -> Self {
        Self {
            settings,
            disabled: false,
            armed: false,
        }
    }

    /// Enables the probe once more, for its next edge.
    pub fn rearm(&mut self) {
        (self.disabled, self.armed) = (false, false);
    }

    /// Whether the drive waits for the edge.
    pub const fn is_armed(&self) -> bool {
        self.armed
    }

    /// Advances by one cycle with the status that the drive shows (0x60B9) and the position of the edge
    /// ([`ProbeNumber::position`]). Returns the probe's bits of the function (0x60B8), and the position once it is stored.
    pub fn step(&mut self, status: u16, position: i32) -> (u16, Option<i32>) {
        let status = status >> self.settings.number.shift();
        let is_enabled = status & ENABLE != 0;
        let is_stored = status & self.settings.edge.stored() != 0;
        if !self.disabled {
            self.disabled = !is_enabled;
            return (0, None);
        }
        let function = self.settings.function();
        if !self.armed {
            self.armed = is_enabled && !is_stored;
            // The edge may come in the cycle in which the drive enables the probe.
            return (function, (is_enabled && is_stored).then_some(position));
        }
        (function, (is_enabled && is_stored).then_some(position))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: ProbeSettings = ProbeSettings {
        number: ProbeNumber::Two,
        source: ProbeSource::Index,
        edge: ProbeEdge::Rising,
        continuous: false,
    };

    #[test]
    fn what_was_stored_before_a_probe_was_armed_does_not_count() {
        let mut probe = Probe::new(SETTINGS);
        // Probe 2 is still enabled with an old position; probe 1 plays no part.
        let old = 0x0303;
        assert_eq!(probe.step(old, 77), (0, None));
        assert_eq!(probe.step(old, 77), (0, None));
        assert_eq!(probe.step(0x0003, 77), (0, None), "disabled now");
        let function = 0x1500;
        assert_eq!(probe.step(0x0003, 77), (function, None));
        assert!(!probe.is_armed());
        assert_eq!(probe.step(0x0103, 77), (function, None));
        assert!(probe.is_armed());
        assert_eq!(probe.step(0x0503, 77), (function, None), "the other edge");
        assert_eq!(probe.step(0x0303, 123), (function, Some(123)));
        probe.rearm();
        assert_eq!(probe.step(0x0303, 123), (0, None));
    }

    #[test]
    fn functions_and_objects_are_those_of_the_profile() {
        let one = ProbeSettings {
            number: ProbeNumber::One,
            source: ProbeSource::Input,
            edge: ProbeEdge::Falling,
            continuous: true,
        };
        let mut probe = Probe::new(one);
        probe.step(0, 0);
        assert_eq!(probe.step(0, 0).0, 0x0023);
        let objects = [
            (ProbeNumber::One, ProbeEdge::Rising, 0x60BA),
            (ProbeNumber::One, ProbeEdge::Falling, 0x60BB),
            (ProbeNumber::Two, ProbeEdge::Rising, 0x60BC),
            (ProbeNumber::Two, ProbeEdge::Falling, 0x60BD),
        ];
        for (number, edge, index) in objects {
            assert_eq!(number.position(edge), Object::new(index, 0));
        }
    }
}
