//! Input and output terminals, as their information memories describe them.
//!
//! They have no processor: the controller emulates the device and gives the bits of its first sync manager to the
//! outside. Each channel is a PDO of one entry. Values of Beckhoff's EL1004, EL1008, EL2004 and EL2008; the analogue
//! terminals have this project's own numbers.

use crate::controller::silicon::Silicon;
use crate::devices::image_device::ImageDevice;
use crate::eeprom::sii::{self, Description, PdoDescription};
use crate::eeprom::windows::SyncManagerDefault;
use crate::mailbox::process_data::{Pdo, PdoEntry};
use etherpen_ethercat::wire::sii::Identity;

/// Digital interface, and device emulation.
const CONFIGURATION: u16 = 0x0104;
const VENDOR: u32 = 2;

/// A type of terminal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Terminal {
    name: &'static str,
    order: &'static str,
    vendor: u32,
    product: u32,
    revision: u32,
    current_ma: i16,
    channels: u8,
    /// Bits of a channel.
    bits: u8,
    direction: Direction,
}

#[derive(Clone, Copy, Debug)]
enum Direction {
    Inputs,
    Outputs,
}

/// Four digital inputs.
pub(crate) const EL1004: Terminal = Terminal {
    name: "EL1004 4 digital inputs 24 V, 3 ms",
    order: "EL1004",
    vendor: VENDOR,
    product: 0x03EC_3052,
    revision: 0x0013_0000,
    current_ma: 90,
    channels: 4,
    bits: 1,
    direction: Direction::Inputs,
};

/// Eight digital inputs.
pub(crate) const EL1008: Terminal = Terminal {
    name: "EL1008 8 digital inputs 24 V, 3 ms",
    order: "EL1008",
    product: 0x03F0_3052,
    revision: 0x0010_0000,
    channels: 8,
    ..EL1004
};

/// Four digital outputs.
pub(crate) const EL2004: Terminal = Terminal {
    name: "EL2004 4 digital outputs 24 V, 0.5 A",
    order: "EL2004",
    vendor: VENDOR,
    product: 0x07D4_3052,
    revision: 0x0010_0000,
    current_ma: 100,
    channels: 4,
    bits: 1,
    direction: Direction::Outputs,
};

/// Eight digital outputs.
pub(crate) const EL2008: Terminal = Terminal {
    name: "EL2008 8 digital outputs 24 V, 0.5 A",
    order: "EL2008",
    product: 0x07D8_3052,
    current_ma: 110,
    channels: 8,
    ..EL2004
};

/// Two analogue inputs of 16 bits.
pub(crate) const AI2: Terminal = Terminal {
    name: "AI2 2 analogue inputs 16 bit",
    order: "AI2",
    vendor: 0x0000_0E7E,
    product: 0x0000_0A03,
    channels: 2,
    bits: 16,
    ..EL1004
};

/// Two analogue outputs of 16 bits.
pub(crate) const AO2: Terminal = Terminal {
    name: "AO2 2 analogue outputs 16 bit",
    order: "AO2",
    vendor: 0x0000_0E7E,
    product: 0x0000_0A02,
    channels: 2,
    bits: 16,
    ..EL2004
};

impl Terminal {
    /// A slave of this type.
    pub(crate) fn device(&self) -> ImageDevice {
        ImageDevice::new(self.image())
    }

    fn image(&self) -> Vec<u8> {
        let (fmmus, manager, pdo, entry): (&[u8], _, u16, u16) = match self.direction {
            Direction::Inputs => (
                &[0x02, 0xFF],
                SyncManagerDefault {
                    start: 0x1000,
                    length: (u16::from(self.channels) * u16::from(self.bits)).div_ceil(8),
                    control: 0x00,
                    activate: 0x01,
                    kind: 4,
                },
                0x1A00,
                0x6000,
            ),
            // The length is left to the PDOs.
            Direction::Outputs => (
                &[0x01, 0xFF],
                SyncManagerDefault {
                    start: 0x0F00,
                    length: 0,
                    control: 0x44,
                    activate: 0x09,
                    kind: 3,
                },
                0x1600,
                0x7000,
            ),
        };
        let channel = |number: u16| {
            let entry = PdoEntry {
                index: entry + 0x10 * number,
                sub: 1,
                bits: self.bits,
            };
            PdoDescription {
                pdo: Pdo::new(pdo + number, "Channel", true, &[entry]),
                manager: 0,
                mandatory: true,
            }
        };
        sii::image(&Description {
            identity: Identity {
                vendor: self.vendor,
                product: self.product,
                revision: self.revision,
                serial: 0,
            },
            name: self.name,
            order: self.order,
            configuration: CONFIGURATION,
            current_ma: self.current_ma,
            fmmus,
            sync_managers: vec![manager],
            has_sync_units: true,
            pdos: (0..self.channels.into()).map(channel).collect(),
            ports: Silicon::TERMINAL.ports,
            ..Description::default()
        })
    }
}
