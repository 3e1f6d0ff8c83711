//! Which of a board's ports the link speaks on.
//!
//! A board may offer the link on a serial line and on USB at once. Two programs that speak at once must not share a
//! robot. A port that is merely opened (by a modem manager or a terminal) must not take the link from the port in use,
//! and a pulled cable must not keep it. Invariant: the port whose host spoke last holds the link; messages from the
//! other port are dropped until the holder has been silent for [`HELD_MS`].

/// Silence of the holder after which the other port may take the link, ms: longer than a host's repetitions, and longer
/// than the silence after which a drawing holds by default.
pub const HELD_MS: u64 = 1_000;

/// A port on which a host may speak.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LinkPort {
    /// A serial line; the only port on a board without USB.
    #[default]
    Serial,
    /// The board's own USB.
    Usb,
}

impl LinkPort {
    /// All ports.
    pub const ALL: [Self; 2] = [Self::Serial, Self::Usb];
}

/// How a message is treated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PortDecision {
    /// Its port already holds the link.
    Held,
    /// The link was free; the message's port holds it from now on.
    Taken,
    /// Another port holds the link; the message is dropped.
    Dropped,
}

/// Keeps which port holds the link.
#[derive(Clone, Copy, Debug, Default)]
pub struct PortHold {
    port: LinkPort,
    heard_ms: Option<u64>,
}

impl PortHold {
    /// A free link.
    pub const fn new() -> Self {
        Self {
            port: LinkPort::Serial,
            heard_ms: None,
        }
    }

    /// The port to send on: the holder, or the last one if the link is free.
    pub const fn port(&self) -> LinkPort {
        self.port
    }

    /// Decides how to treat a message with a correct CRC.
    pub fn hear(&mut self, port: LinkPort, now_ms: u64) -> PortDecision {
        let held = |heard_ms: u64| now_ms.saturating_sub(heard_ms) < HELD_MS;
        let decision = match self.heard_ms {
            _ if port == self.port => PortDecision::Held,
            Some(heard_ms) if held(heard_ms) => return PortDecision::Dropped,
            _ => PortDecision::Taken,
        };
        *self = Self {
            port,
            heard_ms: Some(now_ms),
        };
        decision
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use LinkPort::{Serial, Usb};

    #[test]
    fn the_first_to_speak_has_the_link_whichever_port_it_is() {
        for port in LinkPort::ALL {
            let mut hold = PortHold::new();
            assert_ne!(hold.hear(port, 5), PortDecision::Dropped);
            assert_eq!((hold.port(), hold.hear(port, 6)), (port, PortDecision::Held));
        }
    }

    #[test]
    fn a_port_keeps_the_link_as_long_as_it_is_not_silent() {
        let mut hold = PortHold::new();
        assert_eq!(hold.hear(Usb, 0), PortDecision::Taken);
        for now_ms in (1..100_000).step_by(HELD_MS as usize - 1) {
            assert_eq!(hold.hear(Serial, now_ms), PortDecision::Dropped);
            assert_eq!(hold.hear(Usb, now_ms), PortDecision::Held);
        }
    }

    #[test]
    fn a_silent_port_gives_the_link_away_but_only_to_one_that_speaks() {
        let mut hold = PortHold::new();
        hold.hear(Serial, 100);
        assert_eq!(hold.hear(Usb, 100 + HELD_MS - 1), PortDecision::Dropped);
        assert_eq!(hold.port(), Serial);
        assert_eq!(hold.hear(Usb, 100 + HELD_MS), PortDecision::Taken);
        assert_eq!(
            (hold.port(), hold.hear(Serial, 101 + HELD_MS)),
            (Usb, PortDecision::Dropped)
        );
    }

    #[test]
    fn what_is_dropped_does_not_prolong_the_silence_of_its_port() {
        let mut hold = PortHold::new();
        hold.hear(Serial, 0);
        for now_ms in 1..HELD_MS {
            assert_eq!(hold.hear(Usb, now_ms), PortDecision::Dropped);
        }
        assert_eq!(hold.hear(Usb, HELD_MS), PortDecision::Taken);
    }
}
