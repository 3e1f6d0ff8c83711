//! The serial link's way to the host: the lockstep's files or UART0.

use crate::lockstep::Link;
use crate::uart::Uart;
use etherpen::controller::HostBytes;

/// Where the link's bytes go.
pub(crate) enum Route {
    /// Through files, once a millisecond.
    Lockstep(Link),
    /// Through UART0, byte by byte.
    Uart(Uart),
}

/// The link's bytes and their way.
pub(crate) struct Serial {
    bytes: HostBytes<'static>,
    route: Route,
}

impl Serial {
    pub(crate) fn new(bytes: HostBytes<'static>, route: Route) -> Self {
        Self { bytes, route }
    }

    /// The exchange of millisecond `ms`.
    pub(crate) fn exchange(&mut self, ms: u32) {
        match &mut self.route {
            Route::Lockstep(link) => {
                let received = link.exchange(ms, |buffer| self.bytes.to_send(buffer));
                self.bytes.received(received);
            }
            Route::Uart(uart) => uart.send(|buffer| self.bytes.to_send(buffer)),
        }
    }

    /// A byte has come to the UART.
    pub(crate) fn on_received(&mut self) {
        if let Route::Uart(uart) = &mut self.route
            && let Some(byte) = uart.on_received()
        {
            self.bytes.received(&[byte]);
        }
    }

    /// A byte has left the UART.
    pub(crate) fn on_sent(&mut self) {
        if let Route::Uart(uart) = &mut self.route {
            uart.on_sent();
        }
    }
}
