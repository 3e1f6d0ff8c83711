//! Lockstep with the host, through files in the emulator's working directory.
//!
//! After every Ethernet frame the firmware waits for the host's token; every millisecond it exchanges the serial link's
//! bytes. Neither wait takes virtual time (see `semihosting`). The host answers in that order, so the firmware's
//! behaviour never depends on the host's speed. If the host has not created `link.down`, the firmware runs free: the
//! link uses UART0, and the firmware does not wait for tokens.
//!
//! | file | direction | record |
//! |---|---|---|
//! | `bus.up` | to the host | u64 time in us, after a frame was handed to the MAC |
//! | `bus.down` | to the firmware | u8 token: how many replies the host has just sent |
//! | `link.up` | to the host | u32 ms, u8 n, n bytes |
//! | `link.down` | to the firmware | u8 n, n bytes |
//!
//! Numbers are little endian, n is at most [`LINK_BYTES_MAX`].

use super::semihosting::{self, Closed, EXIT_HOST_GONE, File};

/// Bytes of the serial link in a millisecond and direction: 921,600 baud with 10 bits a byte.
pub(crate) const LINK_BYTES_MAX: usize = 92;

const LINK_UP_HEADER_BYTES: usize = 5;

const _: () = assert!(LINK_BYTES_MAX <= u8::MAX as usize);

/// The token exchange of the Ethernet frames.
#[derive(Clone, Copy)]
pub(crate) struct Bus {
    up: File,
    down: File,
}

/// The byte exchange of the serial link.
pub(crate) struct Link {
    up: File,
    down: File,
    sent: [u8; LINK_UP_HEADER_BYTES + LINK_BYTES_MAX],
    received: [u8; 1 + LINK_BYTES_MAX],
}

/// Opens the files of the lockstep; `None` if the host wants the firmware to run free.
pub(crate) fn open() -> Option<(Bus, Link)> {
    let down = File::open_to_read(c"link.down")?;
    let link = Link {
        up: File::open_to_write(c"link.up")?,
        down,
        sent: [0; LINK_UP_HEADER_BYTES + LINK_BYTES_MAX],
        received: [0; 1 + LINK_BYTES_MAX],
    };
    let bus = Bus {
        up: File::open_to_write(c"bus.up")?,
        down: File::open_to_read(c"bus.down")?,
    };
    Some((bus, link))
}

impl Bus {
    /// Reports a frame sent at `time_us`, waits until its replies are on their way, and returns their number.
    pub(crate) fn frame_sent(&self, time_us: u64) -> u8 {
        let mut token = [0];
        let exchange = self.up.write(&time_us.to_le_bytes());
        or_end(exchange.and_then(|()| self.down.read(&mut token)));
        token[0]
    }
}

impl Link {
    /// Sends the bytes that `fill` writes into the buffer (it returns their number), and returns the bytes from the
    /// host.
    pub(crate) fn exchange(&mut self, ms: u32, fill: impl FnOnce(&mut [u8]) -> usize) -> &[u8] {
        let (header, bytes) = self.sent.split_at_mut(LINK_UP_HEADER_BYTES);
        let length = fill(bytes).min(LINK_BYTES_MAX);
        header[..4].copy_from_slice(&ms.to_le_bytes());
        header[4] = length as u8;
        or_end(self.up.write(&self.sent[..LINK_UP_HEADER_BYTES + length]));
        let mut have = or_end(self.down.read(&mut self.received));
        let want = 1 + usize::from(self.received[0]).min(LINK_BYTES_MAX);
        while have < want {
            have += or_end(self.down.read(&mut self.received[have..want]));
        }
        &self.received[1..want]
    }
}

/// Ends the firmware if the host has gone: an emulator must not outlive the program that started it.
fn or_end<T>(result: Result<T, Closed>) -> T {
    result.unwrap_or_else(|Closed| semihosting::fail(EXIT_HOST_GONE, format_args!("the host closed the lockstep")))
}
