//! The four ports of a slave controller: medium, link state and error counters.
//!
//! A frame enters at port 0 and leaves through 3, 1 and 2 in this order, as far as they are open; a closed port loops
//! the frame back inside (IEC 61158-4-12, data link layer). The error counters stop at 255.
//!
//! Invariant: plain field structures without any interpretation of the counters.

use super::ERROR_COUNTERS_LEN;
use crate::wire::{Error, check_len, check_room, read_u8, read_u16, write_bytes};

/// Number of ports of a slave controller.
pub const PORTS: usize = 4;

const PDI_OPERATIONAL_BIT: u16 = 1 << 0;
const PDI_WATCHDOG_BIT: u16 = 1 << 1;
const ENHANCED_LINK_BIT: u16 = 1 << 2;
const LINK_SHIFT: usize = 4;
const LOOP_SHIFT: usize = 8;

/// Medium of a port.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum PortMedium {
    /// The port does not exist.
    #[default]
    Missing = 0,
    /// The port exists, but the SII does not configure it.
    Unconfigured = 1,
    /// The bus between terminals.
    Ebus = 2,
    /// Ethernet.
    Ethernet = 3,
}

/// The media of the four ports, from [`PORT_DESCRIPTOR`](super::PORT_DESCRIPTOR).
pub fn port_media(descriptor: u8) -> [PortMedium; PORTS] {
    core::array::from_fn(|port| match descriptor >> (2 * port) & 3 {
        0 => PortMedium::Missing,
        1 => PortMedium::Unconfigured,
        2 => PortMedium::Ebus,
        _ => PortMedium::Ethernet,
    })
}

/// The register [`PORT_DESCRIPTOR`](super::PORT_DESCRIPTOR) for four media.
pub fn port_descriptor(media: [PortMedium; PORTS]) -> u8 {
    media.iter().rev().fold(0, |bits, medium| bits << 2 | *medium as u8)
}

/// State of one port.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortStatus {
    /// Whether there is a physical link.
    pub link: bool,
    /// Whether frames are looped back inside instead of leaving.
    pub loop_closed: bool,
    /// Whether communication is established.
    pub communication: bool,
}

impl PortStatus {
    /// Whether frames leave through the port and come back.
    pub const fn is_open(&self) -> bool {
        self.communication && !self.loop_closed
    }
}

/// The register [`DL_STATUS`](super::DL_STATUS) in host form.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DlStatus {
    /// Whether the slave's own processor has loaded the SII and runs.
    pub pdi_operational: bool,
    /// Whether its watchdog has not expired.
    pub pdi_watchdog: bool,
    /// Whether enhanced link detection is on for at least one port.
    pub enhanced_link_detection: bool,
    /// The ports.
    pub ports: [PortStatus; PORTS],
}

impl DlStatus {
    /// Decodes the register.
    pub fn from_bits(bits: u16) -> Self {
        let bit = |shift: usize| bits >> shift & 1 != 0;
        Self {
            pdi_operational: bits & PDI_OPERATIONAL_BIT != 0,
            pdi_watchdog: bits & PDI_WATCHDOG_BIT != 0,
            enhanced_link_detection: bits & ENHANCED_LINK_BIT != 0,
            ports: core::array::from_fn(|port| PortStatus {
                link: bit(LINK_SHIFT + port),
                loop_closed: bit(LOOP_SHIFT + 2 * port),
                communication: bit(LOOP_SHIFT + 2 * port + 1),
            }),
        }
    }

    /// Encodes the register.
    pub fn bits(&self) -> u16 {
        let flag = |set: bool, bit: u16| if set { bit } else { 0 };
        let ports = self.ports.iter().enumerate().fold(0, |bits, (port, status)| {
            bits | u16::from(status.link) << (LINK_SHIFT + port)
                | u16::from(status.loop_closed) << (LOOP_SHIFT + 2 * port)
                | u16::from(status.communication) << (LOOP_SHIFT + 2 * port + 1)
        });
        ports
            | flag(self.pdi_operational, PDI_OPERATIONAL_BIT)
            | flag(self.pdi_watchdog, PDI_WATCHDOG_BIT)
            | flag(self.enhanced_link_detection, ENHANCED_LINK_BIT)
    }

    /// Number of ports that frames pass; 1 at the end of a line, 2 in its middle, more at a branch.
    pub fn open_ports(&self) -> usize {
        self.ports.iter().filter(|port| port.is_open()).count()
    }
}

/// Error counters of one port; each stops at 255.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PortErrors {
    /// Frames with a wrong check sequence or length: damaged on the cable of this port or earlier.
    pub invalid_frames: u8,
    /// Errors of the physical layer, within frames or between them, caused by the cable or plug of this port.
    pub receive_errors: u8,
    /// Frames that an earlier slave had already found damaged.
    pub forwarded_errors: u8,
    /// How often the link was lost.
    pub lost_links: u8,
}

impl PortErrors {
    /// Whether any counter is not 0.
    pub fn any(&self) -> bool {
        *self != Self::default()
    }
}

/// The error counters of a slave: the registers from [`RECEIVE_ERRORS`](super::RECEIVE_ERRORS) to the end of
/// [`LOST_LINKS`](super::LOST_LINKS).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorCounters {
    /// The ports.
    pub ports: [PortErrors; PORTS],
    /// Frames that the processing unit could not interpret.
    pub processing_errors: u8,
    /// Errors of the slave's own processor at the PDI.
    pub pdi_errors: u8,
    /// The last PDI error, vendor-specific code.
    pub pdi_error_code: u8,
}

const FORWARDED: usize = 0x08;
const PROCESSING: usize = 0x0C;
const LOST: usize = 0x10;

impl ErrorCounters {
    /// Reads the registers from [`RECEIVE_ERRORS`](super::RECEIVE_ERRORS) on.
    ///
    /// # Errors
    /// [`Error::Truncated`] below [`ERROR_COUNTERS_LEN`] bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, ERROR_COUNTERS_LEN)?;
        Ok(Self {
            ports: core::array::from_fn(|port| {
                let [invalid_frames, receive_errors] = read_u16(bytes, 2 * port).to_le_bytes();
                PortErrors {
                    invalid_frames,
                    receive_errors,
                    forwarded_errors: read_u8(bytes, FORWARDED + port),
                    lost_links: read_u8(bytes, LOST + port),
                }
            }),
            processing_errors: read_u8(bytes, PROCESSING),
            pdi_errors: read_u8(bytes, PROCESSING + 1),
            pdi_error_code: read_u8(bytes, PROCESSING + 2),
        })
    }

    /// Writes the registers; the reserved one becomes 0.
    ///
    /// # Errors
    /// [`Error::Room`] below [`ERROR_COUNTERS_LEN`] bytes.
    pub fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, ERROR_COUNTERS_LEN)?;
        for (port, errors) in self.ports.iter().enumerate() {
            write_bytes(bytes, 2 * port, &[errors.invalid_frames, errors.receive_errors]);
            write_bytes(bytes, FORWARDED + port, &[errors.forwarded_errors]);
            write_bytes(bytes, LOST + port, &[errors.lost_links]);
        }
        write_bytes(
            bytes,
            PROCESSING,
            &[self.processing_errors, self.pdi_errors, self.pdi_error_code, 0],
        );
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_with_two_open_ports_is_read_from_its_status() {
        // PDI runs, links on 0 and 1, communication on 0 and 1, loops closed on 2 and 3.
        let status = DlStatus::from_bits(0x5A31);
        assert!(status.pdi_operational && !status.pdi_watchdog);
        let open = PortStatus {
            link: true,
            loop_closed: false,
            communication: true,
        };
        let closed = PortStatus {
            loop_closed: true,
            ..PortStatus::default()
        };
        assert_eq!(status.ports, [open, open, closed, closed]);
        assert_eq!(status.open_ports(), 2);
    }

    #[test]
    fn every_status_and_descriptor_survives_both_ways() {
        for bits in (0..=u16::MAX).filter(|bits| bits & 1 << 3 == 0) {
            assert_eq!(DlStatus::from_bits(bits).bits(), bits);
        }
        for descriptor in 0..=u8::MAX {
            assert_eq!(port_descriptor(port_media(descriptor)), descriptor);
        }
        let medium = PortMedium::Ethernet;
        assert_eq!(
            port_media(0x0F),
            [medium, medium, PortMedium::Missing, PortMedium::Missing]
        );
    }

    #[test]
    fn each_counter_has_its_register() {
        let mut bytes = [0; ERROR_COUNTERS_LEN];
        for (n, byte) in bytes.iter_mut().enumerate() {
            *byte = n as u8;
        }
        let counters = ErrorCounters::parse(&bytes).unwrap();
        let second = PortErrors {
            invalid_frames: 2,
            receive_errors: 3,
            forwarded_errors: 9,
            lost_links: 0x11,
        };
        assert_eq!(counters.ports[1], second);
        assert_eq!(
            (counters.processing_errors, counters.pdi_errors, counters.pdi_error_code),
            (12, 13, 14)
        );
        let mut written = [0xFF; ERROR_COUNTERS_LEN];
        counters.emit(&mut written).unwrap();
        bytes[0x0F] = 0;
        assert_eq!(written, bytes);
        assert!(ErrorCounters::parse(&bytes[1..]).is_err());
    }
}
