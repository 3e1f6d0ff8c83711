//! Assignment of pins to peripherals.
//!
//! A pin's function, speed and pull are set before its mode, so that it changes from open to its signal at once. The
//! board has clocked the pin's port before.

use stm32_metapac::gpio::Gpio;
use stm32_metapac::gpio::vals::{Moder, Ospeedr, Pupdr};

/// Port and bit of a pin.
pub(crate) type Pin = (Gpio, u8);

/// Makes a pin an output with the level of its port's output register.
pub(crate) fn output((port, bit): Pin) {
    port.moder()
        .modify(|modes| modes.set_moder(usize::from(bit), Moder::OUTPUT));
}

/// Assigns a pin to the peripheral with this alternate function.
pub(crate) fn assign((port, bit): Pin, function: u8, speed: Ospeedr, pull: Pupdr) {
    let pin = usize::from(bit);
    port.afr(pin / 8)
        .modify(|functions| functions.set_afr(pin % 8, function));
    port.ospeedr().modify(|speeds| speeds.set_ospeedr(pin, speed));
    port.pupdr().modify(|pulls| pulls.set_pupdr(pin, pull));
    port.moder().modify(|modes| modes.set_moder(pin, Moder::ALTERNATE));
}
