//! The MAC's management interface, and the port's state for the other tasks.
//!
//! The task that polls the PHY publishes the state in an atomic; the Ethernet driver reads it without waiting.

use super::clocks::BUS_HZ;
use core::sync::atomic::{AtomicU8, Ordering};
use etherpen::board::PortState;
use etherpen::ethernet::phy::Management;
use stm32_metapac::ETH;

/// Clock range field: bus clock / 102, for a management clock of at most 2.5 MHz (RM0433, ETH_MACMDIOAR).
const CLOCK_RANGE_150_250_MHZ: u8 = 0b0100;
const _: () = assert!(BUS_HZ >= 150_000_000 && BUS_HZ <= 250_000_000 && BUS_HZ / 102 <= 2_500_000);

/// Operation field.
const WRITE: u8 = 0b01;
const READ: u8 = 0b11;

/// Until a PHY has answered, none is there.
static PORT: AtomicU8 = AtomicU8::new(PortState::NoPhy as u8);

/// The port as last published. Safe in a critical task.
pub(crate) fn port() -> PortState {
    let code = PORT.load(Ordering::Relaxed);
    let known = [PortState::Down, PortState::Up];
    known
        .into_iter()
        .find(|state| *state as u8 == code)
        .unwrap_or(PortState::NoPhy)
}

/// Publishes the port's state for the driver and the link task.
pub(crate) fn publish(port: PortState) {
    PORT.store(port as u8, Ordering::Relaxed);
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
