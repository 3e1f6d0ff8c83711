//! The serial link to the host: the lockstep's files or UART0.

use super::disturb::Noise;
use super::lockstep::Link;
use super::uart::Uart;
use etherpen::controller::HostBytes;

/// Route of the link's bytes.
pub(crate) enum Route {
    /// Through files, once a millisecond.
    Lockstep(Link),
    /// Through UART0, byte by byte.
    Uart(Uart),
}

/// The link's bytes and their route.
pub(crate) struct Serial {
    bytes: HostBytes<'static>,
    route: Route,
    /// Generates artificial traffic from the host.
    noise: Noise,
    /// Whether the host's last message to the firmware has ended, and the firmware's last message to the host.
    received_whole: bool,
    sent_whole: bool,
}

impl Serial {
    pub(crate) fn new(bytes: HostBytes<'static>, route: Route) -> Self {
        Self {
            bytes,
            route,
            noise: Noise::new(),
            received_whole: true,
            sent_whole: true,
        }
    }

    /// Exchanges the bytes of a millisecond, with the time by which it began early, us; `flood` fills the capacity that the firmware leaves free.
    pub(crate) fn exchange(&mut self, (ms, early_us): (u32, i32), flood: bool) {
        let Self {
            bytes,
            route,
            noise,
            received_whole,
            sent_whole,
        } = self;
        let send = |buffer: &mut [u8]| {
            let length = bytes.to_send(buffer);
            if let Some(last) = buffer[..length].last() {
                *sent_whole = *last == 0;
            }
            if flood && *sent_whole && length < buffer.len() {
                buffer[length..].fill(1);
                buffer[buffer.len() - 1] = 0;
                return buffer.len();
            }
            length
        };
        match route {
            Route::Lockstep(link) => {
                let received = link.exchange((ms, early_us), send);
                if noise.is_open() && !received.is_empty() {
                    bytes.received(&[noise.end()]);
                }
                bytes.received(received);
                if let Some(last) = received.last() {
                    *received_whole = *last == 0;
                }
            }
            Route::Uart(uart) => uart.send(send),
        }
    }

    /// Takes a byte of noise as if it came from the line, unless it would damage a message of the host.
    pub(crate) fn noise(&mut self) {
        if self.received_whole {
            self.bytes.received(&[self.noise.next()]);
        }
    }

    /// Handles a byte received by the UART.
    pub(crate) fn on_received(&mut self) {
        if let Route::Uart(uart) = &mut self.route
            && let Some(byte) = uart.on_received()
        {
            self.bytes.received(&[byte]);
        }
    }

    /// Handles a byte sent by the UART.
    pub(crate) fn on_sent(&mut self) {
        if let Route::Uart(uart) = &mut self.route {
            uart.on_sent();
        }
    }
}
