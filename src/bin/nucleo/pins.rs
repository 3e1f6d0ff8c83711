//! Pin assignment of the NUCLEO-H743ZI2 (UM2407).
//!
//! | pins | signal | function |
//! |---|---|---|
//! | PA1, PA7, PC4, PC5 | RMII reference clock, carrier sense, receive data 0 and 1 | 11 |
//! | PG11, PG13, PB13 | RMII transmit enable, transmit data 0 and 1 (PB13 through its jumper, closed by default) | 11 |
//! | PA2, PC1 | PHY management data and clock | 11 |
//! | PA11, PA12 | the user's USB connector CN13, D- and D+ | 10 |
//! | PD8, PD9 | USART3 transmit and receive, wired to the ST-LINK's virtual serial port | 7 |
//! | PG14 | emergency-stop input, D2 on the board's connector | input |

use crate::stm32h7::gpio::{self, Pin};
use stm32_metapac::gpio::vals::{Moder, Ospeedr, Pupdr};
use stm32_metapac::{GPIOA, GPIOB, GPIOC, GPIOD, GPIOG, RCC};

/// Alternate function of the Ethernet MAC on every pin used here (datasheet, alternate function tables).
const ETHERNET_FUNCTION: u8 = 11;
const ETHERNET: [Pin; 9] = [
    (GPIOA, 1),
    (GPIOA, 2),
    (GPIOA, 7),
    (GPIOB, 13),
    (GPIOC, 1),
    (GPIOC, 4),
    (GPIOC, 5),
    (GPIOG, 11),
    (GPIOG, 13),
];
/// Alternate function of OTG_FS on port A.
const USB_FUNCTION: u8 = 10;
const USB: [Pin; 2] = [(GPIOA, 11), (GPIOA, 12)];
/// Alternate function of USART3 on port D.
const SERIAL_FUNCTION: u8 = 7;
const SERIAL_TRANSMIT: Pin = (GPIOD, 8);
const SERIAL_RECEIVE: Pin = (GPIOD, 9);
/// Port and bit of the emergency-stop input.
const EMERGENCY_STOP: Pin = (GPIOG, 14);

/// Clocks the ports that are used.
pub(crate) fn clock_ports() {
    RCC.ahb4enr().modify(|enable| {
        enable.set_gpioaen(true);
        enable.set_gpioben(true);
        enable.set_gpiocen(true);
        enable.set_gpioden(true);
        enable.set_gpioeen(true);
        enable.set_gpiogen(true);
    });
    // The clock enable takes effect two bus cycles later; a read back spends them.
    let _ = RCC.ahb4enr().read();
}

/// Assigns every pin but the lamps' to its peripheral, permanently.
pub(crate) fn start() {
    for pin in ETHERNET {
        gpio::assign(pin, ETHERNET_FUNCTION, Ospeedr::VERY_HIGH_SPEED, Pupdr::FLOATING);
    }
    for pin in USB {
        gpio::assign(pin, USB_FUNCTION, Ospeedr::VERY_HIGH_SPEED, Pupdr::FLOATING);
    }
    start_serial();
    let (port, bit) = EMERGENCY_STOP;
    let pin = usize::from(bit);
    // Pulled up: an open wire reads high, which is a stop.
    port.pupdr().modify(|pulls| pulls.set_pupdr(pin, Pupdr::PULL_UP));
    port.moder().modify(|modes| modes.set_moder(pin, Moder::INPUT));
}

/// Assigns the serial line's pins.
pub(crate) fn start_serial() {
    gpio::assign(SERIAL_TRANSMIT, SERIAL_FUNCTION, Ospeedr::HIGH_SPEED, Pupdr::FLOATING);
    // Pulled up: an open line reads idle instead of a stream of breaks.
    gpio::assign(SERIAL_RECEIVE, SERIAL_FUNCTION, Ospeedr::LOW_SPEED, Pupdr::PULL_UP);
}

/// Whether the emergency-stop input reads open at this moment. Safe in a critical task: one register read.
pub(crate) fn emergency_stop_shows_open() -> bool {
    let (port, bit) = EMERGENCY_STOP;
    port.idr().read().0 & 1 << bit != 0
}
