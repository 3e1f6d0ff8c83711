//! The Kollmorgen AKD servo drive in velocity mode.
//!
//! Its SII is known from a real drive: mailboxes of 1024 bytes, fixed process data objects with
//! the AX2000's numbers but other contents, AssignActivate 0x0300. It has no fixed object with a torque demand, so it
//! is driven by velocity only.

use super::{
    CONTROL_WORD, Clocks, Digits, DriveDescription, ModeDescription, POSITION_INTERNAL, Recognition, STATUS_WORD,
    generic,
};
use etherpen_ethercat::driver::{Entry, PdoChoice, Windows};

/// Description of the drive for the master.
pub static AKD: DriveDescription = DriveDescription {
    name: "Kollmorgen AKD",
    recognition: Recognition::Product {
        vendor: 0x0000_006A,
        product: 0x0041_4B44,
    },
    velocity: Some(ModeDescription {
        operation_mode: generic::CYCLIC_VELOCITY,
        demand: generic::TARGET_VELOCITY,
        outputs: PdoChoice::fixed(
            0x1702,
            &[Entry::new(generic::TARGET_VELOCITY, 32), Entry::new(CONTROL_WORD, 16)],
        ),
        inputs: PdoChoice::fixed(
            0x1B01,
            &[Entry::new(POSITION_INTERNAL, 32), Entry::new(STATUS_WORD, 16)],
        ),
        digits: Digits::Velocity,
    }),
    torque: None,
    position: None,
    windows: Windows {
        outputs: 0x1100,
        inputs: 0x1140,
    },
    clocks: Clocks::SYNC0,
    settings: generic::settings,
};
