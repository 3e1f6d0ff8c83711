//! The serial link's way to the host: the lockstep's files or UART0.

use crate::disturb::Noise;
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
    /// What is made up instead of what the host could send.
    noise: Noise,
    /// Whether the host's last message to the firmware has ended, and the firmware's to the host.
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

    /// The exchange of millisecond `ms`; `flood` fills what the firmware leaves free of it.
    pub(crate) fn exchange(&mut self, ms: u32, flood: bool) {
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
                let received = link.exchange(ms, send);
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

    /// Takes a byte of noise, as if the line had brought it, unless it would spoil a message of the host's.
    pub(crate) fn noise(&mut self) {
        if self.received_whole {
            self.bytes.received(&[self.noise.next()]);
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
