//! The board's three lamps: LD1 green, LD2 yellow, LD3 red. What they mean is `etherpen::board::Lamps`.

use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::{GPIOB, GPIOE};
use etherpen::board::Lamps;

/// Port and bit of LD1, LD2 and LD3 (UM2407, LEDs).
const PLACES: [(Gpio, u8); 3] = [(GPIOB, 0), (GPIOE, 1), (GPIOB, 14)];

/// Shows them; one write for each, which changes no other pin.
pub(crate) fn show(lamps: Lamps) {
    for ((port, bit), on) in PLACES.into_iter().zip([lamps.green, lamps.yellow, lamps.red]) {
        // The lower half sets, the upper half resets.
        let bit = if on { bit } else { bit + 16 };
        port.bsrr().write(|pins| pins.0 = 1 << bit);
    }
}
