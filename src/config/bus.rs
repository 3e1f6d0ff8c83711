//! Configuration of the bus: the expected drives, time limits, and the transport of EtherCAT.

use crate::ethercat::clock::{DIFFERENCE_MAX_NS, DIFFERENCE_TIMEOUT_MS};
use crate::ethercat::cyclic::ExchangeKind;
use crate::robots::AXES;
use core::fmt::{self, Write};
use core::net::Ipv4Addr;
use heapless::String;
use serde::{Deserialize, Serialize};

/// Transport of EtherCAT.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transport {
    /// In Ethernet frames with EtherCAT's own EtherType.
    #[default]
    Raw,
    /// In UDP.
    Udp,
}

/// Longest text of a [`HostAddress`], bytes.
const ADDRESS_TEXT_MAX: usize = 18;

/// The controller's own IPv4 address: `dhcp`, or `a.b.c.d/len`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String<ADDRESS_TEXT_MAX>", into = "String<ADDRESS_TEXT_MAX>")]
pub enum HostAddress {
    /// A DHCP server assigns the address.
    #[default]
    Dhcp,
    /// This address.
    Fixed {
        /// The address.
        address: Ipv4Addr,
        /// Bits of the network's part, 1 to 30.
        prefix: u8,
    },
}

/// The text is not a valid [`HostAddress`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AddressError;

impl fmt::Display for AddressError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "expected \"dhcp\" or an address with the length of its network's part from 1 to 30, \"192.168.1.2/24\"",
        )
    }
}

impl TryFrom<String<ADDRESS_TEXT_MAX>> for HostAddress {
    type Error = AddressError;

    fn try_from(text: String<ADDRESS_TEXT_MAX>) -> Result<Self, AddressError> {
        if text == "dhcp" {
            return Ok(Self::Dhcp);
        }
        let (address, prefix) = text.split_once('/').ok_or(AddressError)?;
        let address = address.parse().map_err(|_| AddressError)?;
        let prefix = prefix.parse().map_err(|_| AddressError)?;
        match prefix {
            1..=30 => Ok(Self::Fixed { address, prefix }),
            _ => Err(AddressError),
        }
    }
}

impl From<HostAddress> for String<ADDRESS_TEXT_MAX> {
    fn from(address: HostAddress) -> Self {
        let mut text = Self::new();
        // The capacity holds the longest address.
        let _ = match address {
            HostAddress::Dhcp => text.write_str("dhcp"),
            HostAddress::Fixed { address, prefix } => write!(text, "{address}/{prefix}"),
        };
        text
    }
}

/// Settings of the IP stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkSettings {
    /// The controller's own address.
    pub address: HostAddress,
    /// Gateway for a fixed address, if any; DHCP provides its own.
    pub gateway: Option<Ipv4Addr>,
    /// The segment's address.
    pub segment: Ipv4Addr,
}

/// Configuration of the bus: expected drives and time limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bus {
    /// Number of drives expected, in chain order; one for each axis.
    pub drives: u8,
    /// Number of slaves, with couplers and terminals, for which the bring-up waits; 0: enough for the drives and the named
    /// places.
    pub slaves: u8,
    /// Separate telegrams for inputs and outputs within a cycle, or one telegram for both with outputs one cycle later.
    pub exchange: ExchangeKind,
    /// Sync manager watchdog of the drives, ms; longer than `blind_max_ms`, at most 500. What is left of 950 ms is the longest
    /// time of an axis's quick stop.
    pub watchdog_ms: u16,
    /// Longest time in motion without a valid measurement, or with outputs that a drive has not confirmed, ms.
    pub blind_max_ms: u16,
    /// Late cycles within a second above which a fault is raised.
    pub late_max_per_s: u16,
    /// Silence of the host after which a drawing is held, ms.
    pub host_silence_ms: u16,
    /// Longest pause between dead-man messages of a jog, ms.
    pub dead_man_ms: u16,
    /// Whether the slaves' distributed clocks are set up and the sample's timer follows them.
    pub clocks: bool,
    /// Time of SYNC0 after the input telegram's frame has passed the reference clock, us, for drives that use SYNC0.
    pub sync_shift_us: u16,
    /// Difference from the reference at which a slave's clock has settled, ns; before that it does not go to OP.
    pub settle_difference_ns: u32,
    /// Longest wait for a clock to settle, ms.
    pub settle_max_ms: u16,
    /// Phase error of the sample relative to the bus clock above which a fault is raised, us.
    pub clock_error_max_us: u16,
    /// Transport of EtherCAT.
    pub transport: Transport,
    /// The controller's own address, for UDP.
    pub address: HostAddress,
    /// Gateway for a fixed address; 0.0.0.0 for none.
    pub gateway: Ipv4Addr,
    /// The segment's address, for UDP; 0.0.0.0 for none.
    pub segment: Ipv4Addr,
    /// Name of the robot, for messages.
    pub name: String<24>,
}

impl Bus {
    /// Settings for the IP stack; `None` when the bus does not need it.
    pub fn network(&self) -> Option<NetworkSettings> {
        (self.transport == Transport::Udp).then_some(NetworkSettings {
            address: self.address,
            gateway: (!self.gateway.is_unspecified()).then_some(self.gateway),
            segment: self.segment,
        })
    }
}

impl Default for Bus {
    fn default() -> Self {
        let mut name = String::new();
        // The literal is shorter than the capacity.
        let _ = name.push_str("IRB 340");
        Self {
            drives: AXES as u8,
            slaves: 0,
            exchange: ExchangeKind::Split,
            watchdog_ms: 10,
            blind_max_ms: 5,
            late_max_per_s: 10,
            host_silence_ms: 500,
            dead_man_ms: 100,
            // Drives that ignore SYNC0 keep their own time; following the clock of one of them has no benefit.
            clocks: false,
            sync_shift_us: 500,
            settle_difference_ns: DIFFERENCE_MAX_NS,
            settle_max_ms: DIFFERENCE_TIMEOUT_MS as u16,
            clock_error_max_us: 50,
            transport: Transport::Raw,
            address: HostAddress::Dhcp,
            gateway: Ipv4Addr::UNSPECIFIED,
            segment: Ipv4Addr::UNSPECIFIED,
            name,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_dhcp_or_an_address_with_its_network_and_nothing_else() {
        let parse = |text: &str| HostAddress::try_from(String::try_from(text).unwrap());
        assert_eq!(parse("dhcp"), Ok(HostAddress::Dhcp));
        let fixed = HostAddress::Fixed {
            address: Ipv4Addr::new(192, 168, 100, 200),
            prefix: 24,
        };
        assert_eq!(parse("192.168.100.200/24"), Ok(fixed));
        assert_eq!(String::from(fixed), "192.168.100.200/24");
        for wrong in [
            "",
            "DHCP",
            "1.2.3.4",
            "1.2.3.4/0",
            "1.2.3.4/31",
            "1.2.3/8",
            "1.2.3.4/x",
            "1.2.3.4/24/",
        ] {
            assert_eq!(parse(wrong), Err(AddressError), "{wrong}");
        }
    }

    #[test]
    fn the_ip_stack_gets_the_gateway_if_there_is_one_and_nothing_without_udp() {
        let mut bus = Bus {
            segment: Ipv4Addr::new(10, 0, 2, 2),
            ..Bus::default()
        };
        assert_eq!(bus.network(), None);
        bus.transport = Transport::Udp;
        assert_eq!(
            bus.network().map(|settings| (settings.gateway, settings.segment)),
            Some((None, bus.segment))
        );
        bus.gateway = Ipv4Addr::new(10, 0, 2, 1);
        assert_eq!(bus.network().and_then(|settings| settings.gateway), Some(bus.gateway));
    }
}
