//! Pins of the NUCLEO-H743ZI2 (UM2407): which pin is what, and nothing else.
//!
//! | pins | signal | function |
//! |---|---|---|
//! | PA1, PA7, PC4, PC5 | RMII reference clock, carrier sense, receive data 0 and 1 | 11 |
//! | PG11, PG13, PB13 | RMII transmit enable, transmit data 0 and 1 (PB13 through its jumper, closed by default) | 11 |
//! | PA2, PC1 | PHY management data and clock | 11 |
//! | PA11, PA12 | the user's USB connector CN13, D- and D+ | 10 |
//! | PD8, PD9 | USART3 transmit and receive, wired to the ST-LINK's virtual serial port | 7 |

use core::mem;
use embassy_stm32::gpio::{AfType, AnyPin, Flex, OutputType, Pull, Speed};
use embassy_stm32::pac::GPIOG;
use embassy_stm32::{Peri, Peripherals};

/// Alternate function of the Ethernet MAC on every pin used here (datasheet, alternate function tables).
const ETHERNET_FUNCTION: u8 = 11;
/// Alternate function of OTG_FS on port A.
const USB_FUNCTION: u8 = 10;
/// Alternate function of USART3 on port D.
const SERIAL_FUNCTION: u8 = 7;

/// Bit of the emergency-stop input, D2 on the board's connector: PG14.
const EMERGENCY_STOP: u32 = 1 << 14;

/// Gives every pin to its peripheral, for good.
pub(crate) fn start(chip: Peripherals) {
    let fast = AfType::output(OutputType::PushPull, Speed::VeryHigh);
    let ethernet: [Peri<'static, AnyPin>; 9] = [
        chip.PA1.into(),
        chip.PA2.into(),
        chip.PA7.into(),
        chip.PB13.into(),
        chip.PC1.into(),
        chip.PC4.into(),
        chip.PC5.into(),
        chip.PG11.into(),
        chip.PG13.into(),
    ];
    for pin in ethernet {
        assign(pin, ETHERNET_FUNCTION, fast);
    }
    for pin in [chip.PA11.into(), chip.PA12.into()] {
        assign(pin, USB_FUNCTION, fast);
    }
    assign(
        chip.PD8.into(),
        SERIAL_FUNCTION,
        AfType::output(OutputType::PushPull, Speed::High),
    );
    // Pulled up: an open line reads idle instead of a stream of breaks.
    assign(chip.PD9.into(), SERIAL_FUNCTION, AfType::input(Pull::Up));
    // Pulled up: an open wire reads high, which is a stop.
    let mut emergency_stop = Flex::new(chip.PG14);
    emergency_stop.set_as_input(Pull::Up);
    mem::forget(emergency_stop);
    let lamps: [Peri<'static, AnyPin>; 3] = [chip.PB0.into(), chip.PE1.into(), chip.PB14.into()];
    for pin in lamps {
        let mut lamp = Flex::new(pin);
        lamp.set_as_output(Speed::Low);
        mem::forget(lamp);
    }
}

/// Whether the emergency-stop input reads open at this moment. Safe in a critical task: one register read.
pub(crate) fn emergency_stop_shows_open() -> bool {
    GPIOG.idr().read().0 & EMERGENCY_STOP != 0
}

fn assign(pin: Peri<'static, AnyPin>, function: u8, kind: AfType) {
    let mut pin = Flex::new(pin);
    pin.set_as_af_unchecked(function, kind);
    // Dropping it would disconnect the pin.
    mem::forget(pin);
}
