//! The MAC's management interface, and the link's state for the critical tasks.
//!
//! The task that polls the PHY publishes the state in an atomic; the Ethernet driver reads it and waits for nobody.

use crate::clocks::BUS_HZ;
use core::sync::atomic::{AtomicBool, Ordering};
use embassy_stm32::pac::ETH;
use etherpen::ethernet::phy::Management;

/// Clock range field: bus clock / 102, for a management clock of at most 2.5 MHz (RM0433, ETH_MACMDIOAR).
const CLOCK_RANGE_150_250_MHZ: u8 = 0b0100;
const _: () = assert!(BUS_HZ >= 150_000_000 && BUS_HZ <= 250_000_000 && BUS_HZ / 102 <= 2_500_000);

/// Operation field.
const WRITE: u8 = 0b01;
const READ: u8 = 0b11;

static LINK_IS_UP: AtomicBool = AtomicBool::new(false);

/// The link as last published. Safe in a critical task.
pub(crate) fn link_is_up() -> bool {
    LINK_IS_UP.load(Ordering::Relaxed)
}

/// Tells the driver the link's state.
pub(crate) fn publish(link_is_up: bool) {
    LINK_IS_UP.store(link_is_up, Ordering::Relaxed);
}

/// The station management agent of the MAC; one exists, in the task that polls the PHY.
pub(crate) struct Sma;

impl Sma {
    fn start(&mut self, address: u8, register: u8, operation: u8) {
        ETH.ethernet_mac().macmdioar().write(|access| {
            access.set_pa(address);
            access.set_rda(register);
            access.set_cr(CLOCK_RANGE_150_250_MHZ);
            access.set_goc(operation);
            access.set_mb(true);
        });
    }
}

impl Management for Sma {
    fn start_read(&mut self, address: u8, register: u8) {
        self.start(address, register, READ);
    }

    fn start_write(&mut self, address: u8, register: u8, value: u16) {
        ETH.ethernet_mac().macmdiodr().write(|data| data.set_md(value));
        self.start(address, register, WRITE);
    }

    fn result(&mut self) -> Option<u16> {
        let mac = ETH.ethernet_mac();
        (!mac.macmdioar().read().mb()).then(|| mac.macmdiodr().read().md())
    }
}
