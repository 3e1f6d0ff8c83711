//! Units of the positions of an AKD: objects 0x36E9, 0x6091 and 0x6092.
//!
//! With bit 4 of FBUS.PARAM05 (0x36E9) the drive counts 0x607A and 0x6064 in its feed (0x6092) for each turn of the shaft
//! behind the gear (0x6091). Without it they are in the unit that its commissioning tool has set: here 65,536 for a turn.
//! Objects: Kollmorgen, position scaling of the AKD, and setup of its cyclic synchronous position mode.

/// Bit of FBUS.PARAM05 for the scale by objects of CiA 402.
const BY_OBJECTS: u32 = 1 << 4;
/// Positions of a motor turn in the unit of the commissioning tool; assumed.
const COMMISSIONED: i64 = 1 << 16;

/// The settings since power-up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PositionUnits {
    /// FBUS.PARAM05.
    pub(crate) options: u32,
    /// Turns of the motor and of the shaft, object 0x6091.
    pub(crate) gear: [u32; 2],
    /// Positions for a number of turns of the shaft, object 0x6092.
    pub(crate) feed: [u32; 2],
}

impl Default for PositionUnits {
    fn default() -> Self {
        Self {
            options: 0,
            gear: [1, 1],
            feed: [COMMISSIONED as u32, 1],
        }
    }
}

impl PositionUnits {
    /// Positions of some motor turns, and the number of these turns.
    fn scale(&self) -> (i64, i64) {
        let [motor, shaft] = self.gear.map(i64::from);
        let [feed, turns] = self.feed.map(i64::from);
        match self.options & BY_OBJECTS {
            0 => (COMMISSIONED, 1),
            _ => (feed.saturating_mul(shaft), motor.saturating_mul(turns)),
        }
    }

    /// A position of the encoder in these units; `turn` is the number of the encoder's increments in a motor turn.
    pub(crate) fn shown(&self, increments: i32, turn: u32) -> i32 {
        let (positions, turns) = self.scale();
        converted(increments, positions, i64::from(turn).saturating_mul(turns))
    }

    /// The encoder's increments for a position in these units.
    pub(crate) fn increments(&self, position: i32, turn: u32) -> i32 {
        let (positions, turns) = self.scale();
        converted(position, i64::from(turn).saturating_mul(turns), positions)
    }
}

/// A number times a ratio, rounded down and wrapped to 32 bits.
fn converted(number: i32, numerator: i64, denominator: i64) -> i32 {
    let product = i128::from(number) * i128::from(numerator);
    product.div_euclid(i128::from(denominator.max(1))) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_in_the_commissioned_unit_until_the_objects_are_chosen() {
        let mut units = PositionUnits::default();
        assert_eq!(
            (units.shown(1 << 20, 1 << 20), units.increments(-1, 1 << 20)),
            (65_536, -16)
        );
        (units.feed, units.options) = ([1 << 20, 1], BY_OBJECTS);
        for increments in [0, 1, -1, i32::MIN, i32::MAX] {
            assert_eq!(units.shown(increments, 1 << 20), increments);
            assert_eq!(units.increments(increments, 1 << 20), increments);
        }
        (units.gear, units.feed) = ([3, 2], [900, 1]);
        assert_eq!(
            (units.shown(1 << 20, 1 << 20), units.increments(600, 1 << 20)),
            (600, 1 << 20)
        );
    }

    #[test]
    fn no_setting_divides_by_zero() {
        for gear in [[0, 0], [u32::MAX, 0], [0, u32::MAX]] {
            for feed in [[0, 0], [u32::MAX, u32::MAX]] {
                let units = PositionUnits {
                    options: BY_OBJECTS,
                    gear,
                    feed,
                };
                let _ = (units.shown(i32::MIN, u32::MAX), units.increments(i32::MAX, 0));
            }
        }
    }
}
