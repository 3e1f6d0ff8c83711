//! The Kollmorgen AKD servo drive in cyclic synchronous velocity and position.
//!
//! Its SII is known from a real drive: mailboxes of 1024 bytes, fixed process data objects with
//! the AX2000's numbers but other contents, AssignActivate 0x0300. It has no fixed object with a torque demand, so it
//! is not driven by torque.
//!
//! Position mode follows the maker's page *Setup EtherCAT master to run AKD in DS402 cyclic synchronous position mode*
//! and the *AKD EtherCAT* manual, edition P: mode 8; control word and 0x607A mapped into 0x1600, status word, 0x6064 and
//! 0x6061 into 0x1A00, at most eight bytes each, so that the velocity offset has no room; 0x60C2 the bus cycle. Bit 4 of
//! FBUS.PARAM05 (0x36E9) makes both positions count in the feed 0x6092 behind the gear 0x6091: here the increments of one
//! motor turn. They are read back, because a wrong scale moves the motor too far. The fixed 0x1701 is not used: its target
//! 0x60C1 belongs to interpolated position (mode 7), and the position 0x6063 beside it has another origin than 0x607A. The
//! scale stays in the drive until it is switched off: switch it off when the mode is changed.

use super::{
    AxisMode, CONTROL_WORD, Clocks, Digits, DriveDescription, DriveSettings, INTERPOLATION_PERIOD, ModeDescription,
    OPERATION_MODE_DISPLAY, POSITION, POSITION_INTERNAL, Recognition, STATUS_WORD, SettingList, TARGET_POSITION,
    VELOCITY_OFFSET, generic,
};
use etherpen_ethercat::driver::{Entry, PdoChoice, Setting, Windows};
use etherpen_ethercat::wire::coe::Object;

/// FBUS.PARAM05: options of the fieldbus, 32 bits.
pub const BUS_OPTIONS: Object = Object::new(0x36E9, 0);
/// Bit of [`BUS_OPTIONS`]: positions are scaled by 0x6091 and 0x6092.
pub const SCALE_BY_OBJECTS: u32 = 1 << 4;

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
    position: Some(ModeDescription {
        operation_mode: generic::CYCLIC_POSITION,
        demand: VELOCITY_OFFSET,
        outputs: PdoChoice::written(0x1600, &[Entry::new(CONTROL_WORD, 16), Entry::new(TARGET_POSITION, 32)]),
        inputs: PdoChoice::written(
            0x1A00,
            &[
                Entry::new(STATUS_WORD, 16),
                Entry::new(POSITION, 32),
                Entry::new(OPERATION_MODE_DISPLAY, 8),
            ],
        ),
        digits: Digits::Velocity,
    }),
    windows: Windows::standard(0x1100, 0x1140),
    clocks: Clocks::SYNC0,
    settings,
};

/// Settings of any drive, in position mode after the scale of the positions.
fn settings(axis: &DriveSettings, cycle_ns: u32) -> Option<SettingList> {
    let mut settings = SettingList::new();
    if axis.mode == AxisMode::Position {
        settings.extend_from_slice(&scale(axis)?).ok()?;
    }
    for setting in &generic::settings(axis, cycle_ns)? {
        // Between two targets the drive interpolates for this time: with another period it would not move as it is told.
        let is_read_back = axis.mode == AxisMode::Position && setting.object.index == INTERPOLATION_PERIOD;
        let setting = if is_read_back { setting.verified() } else { *setting };
        settings.push(setting).ok()?;
    }
    Some(settings)
}

/// The scale of 0x607A and 0x6064: `None` for a motor turn without increments.
fn scale(axis: &DriveSettings) -> Option<[Setting; 5]> {
    let feed = Some(axis.increments_per_revolution).filter(|increments| *increments > 0)?;
    let long = |index, sub, value| Setting::new(index, sub, value, 4).verified();
    Some([
        long(0x6091, 1, 1),
        long(0x6091, 2, 1),
        long(0x6092, 1, feed),
        long(0x6092, 2, 1),
        // Its other bits belong to whoever set the drive up.
        Setting::of(BUS_OPTIONS, SCALE_BY_OBJECTS, 4).added().verified(),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_position_mode_scales_the_positions_and_a_turn_without_increments_is_refused() {
        let mut axis = DriveSettings {
            increments_per_revolution: 1 << 19,
            ..DriveSettings::default()
        };
        let scales = |axis: &DriveSettings| {
            let settings = settings(axis, 1_000_000).unwrap();
            settings.iter().any(|setting| setting.object == BUS_OPTIONS)
        };
        assert!(!scales(&axis));
        axis.mode = AxisMode::Position;
        assert!(scales(&axis));
        let feed = settings(&axis, 1_000_000).unwrap()[2];
        assert_eq!((feed.object, feed.value), (Object::new(0x6092, 1), 1 << 19));
        axis.increments_per_revolution = 0;
        assert_eq!(settings(&axis, 1_000_000), None);
    }
}
