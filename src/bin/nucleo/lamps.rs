//! The board's three lamps: LD1 green, LD2 yellow, LD3 red. `etherpen::board::Lamps` defines their meaning.

use super::pins;
use crate::stm32h7::gpio::{self, Pin};
use etherpen::board::Lamps;
use stm32_metapac::{GPIOB, GPIOE};

/// Port and bit of LD1, LD2 and LD3 (UM2407, LEDs).
const PLACES: [Pin; 3] = [(GPIOB, 0), (GPIOE, 1), (GPIOB, 14)];

/// Makes the lamps' pins outputs; the first step of a start-up.
pub(crate) fn start() {
    pins::clock_ports();
    for pin in PLACES {
        gpio::output(pin);
    }
}

/// Shows the lamps; one register write for each, which changes no other pin.
pub(crate) fn show(lamps: Lamps) {
    for ((port, bit), on) in PLACES.into_iter().zip([lamps.green, lamps.yellow, lamps.red]) {
        // The lower half sets, the upper half resets.
        let bit = if on { bit } else { bit + 16 };
        port.bsrr().write(|pins| pins.0 = 1 << bit);
    }
}
