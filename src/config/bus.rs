//! The bus: what is expected on it, how patient the master is, and how EtherCAT travels.

use crate::ethercat::cyclic::ExchangeKind;
use crate::network::NetworkSettings;
use crate::robot::AXES;
use core::fmt::{self, Write};
use core::net::Ipv4Addr;
use heapless::String;
use serde::{Deserialize, Serialize};

/// How EtherCAT travels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transport {
    /// In Ethernet frames of its own type.
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
    /// A server gives it.
    #[default]
    Dhcp,
    /// It is this one.
    Fixed {
        /// The address.
        address: Ipv4Addr,
        /// Bits of the network's part, 1 to 30.
        prefix: u8,
    },
}

/// A text that is no [`HostAddress`].
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
        // The longest address has as many bytes as there is room for.
        let _ = match address {
            HostAddress::Dhcp => text.write_str("dhcp"),
            HostAddress::Fixed { address, prefix } => write!(text, "{address}/{prefix}"),
        };
        text
    }
}

/// The bus: what is expected on it and how patient the master is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bus {
    /// Number of drives expected, in chain order, one for each axis.
    pub drives: u8,
    /// Inputs and outputs apart, in the same cycle, or together, outputs one cycle later.
    pub exchange: ExchangeKind,
    /// Sync manager watchdog of the drives, ms; longer than `blind_max_ms`.
    pub watchdog_ms: u16,
    /// Longest motion without a valid measurement, ms.
    pub blind_max_ms: u16,
    /// Late cycles within a second that make a fault.
    pub late_max_per_s: u16,
    /// Silence of the host while drawing that leads to Holding, ms.
    pub host_silence_ms: u16,
    /// Longest pause between dead-man messages of a jog, ms.
    pub dead_man_ms: u16,
    /// Whether the slaves' distributed clocks are set up and the sample's timer follows them.
    pub clocks: bool,
    /// When SYNC0 of drives that use it comes after the frame of the input telegram has passed the reference clock, us.
    pub sync_shift_us: u16,
    /// Phase error of the sample against the bus clock that ends in a fault, us.
    pub clock_error_max_us: u16,
    /// How EtherCAT travels.
    pub transport: Transport,
    /// The own address, for UDP.
    pub address: HostAddress,
    /// Where packets for other networks go with an address that no server gave; 0.0.0.0 for nowhere.
    pub gateway: Ipv4Addr,
    /// The segment's address, for UDP; 0.0.0.0 for none.
    pub segment: Ipv4Addr,
    /// Name of the robot, for messages.
    pub name: String<24>,
}

impl Bus {
    /// What the IP stack is to do; `None` when the bus needs none.
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
            exchange: ExchangeKind::Split,
            watchdog_ms: 10,
            blind_max_ms: 5,
            late_max_per_s: 10,
            host_silence_ms: 500,
            dead_man_ms: 100,
            // Drives that ignore SYNC0 keep a time of their own: following the clock of one of them gains nothing.
            clocks: false,
            sync_shift_us: 500,
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
}
