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
//! | `link.up` | to the host | u32 ms, i32 us by which it began before `ms` times 1000, u8 n, n bytes |
//! | `link.down` | to the firmware | u8 n, n bytes |
//!
//! A millisecond begins early where the timer follows a bus clock that is faster; the times in `bus.up` follow none.
//! Numbers are little endian, n is at most [`LINK_BYTES_MAX`]. In `link.down` two other first bytes come before the record,
//! each with one byte more:
//!
//! | first byte | second byte | meaning |
//! |---|---|---|
//! | [`MEMORY`] | area | the firmware writes an area of its memory into `link.up` (see `memory`) and reads `link.down` again |
//! | [`AROUND`] | bits of [`around`] | conditions of the board from now on; the record follows at once |

use super::memory;
use super::semihosting::{self, Closed, EXIT_HOST_GONE, File};
use core::sync::atomic::AtomicI32;

/// Bytes of the serial link in a millisecond and direction: 921,600 baud with 10 bits a byte.
pub(crate) const LINK_BYTES_MAX: usize = 92;

const LINK_UP_HEADER_BYTES: usize = 9;
/// First bytes of what is no record.
const MEMORY: u8 = 0xFF;
const AROUND: u8 = 0xFE;
/// Bytes of what comes before a record.
const PREFIX_BYTES: usize = 2;

const _: () = assert!(LINK_BYTES_MAX < AROUND as usize);

/// Conditions of the board that the host controls, as the board's inputs would show them.
pub(crate) mod around {
    use core::sync::atomic::{AtomicU8, Ordering};

    /// The emergency-stop input shows open.
    pub(crate) const STOP_OPEN: u8 = 1 << 0;
    /// The board runs on its substitute clock.
    pub(crate) const SUBSTITUTE_CLOCK: u8 = 1 << 1;
    /// The trajectory task is not released.
    pub(crate) const TRAJECTORY_WAITS: u8 = 1 << 2;
    /// The Ethernet port has no link.
    pub(crate) const PORT_DOWN: u8 = 1 << 3;

    static BITS: AtomicU8 = AtomicU8::new(0);

    /// Whether a condition holds.
    pub(crate) fn is(bit: u8) -> bool {
        BITS.load(Ordering::Relaxed) & bit != 0
    }

    pub(super) fn set(bits: u8) {
        BITS.store(bits, Ordering::Relaxed);
    }
}

/// By how many microseconds the present millisecond began before its number times 1000.
pub(crate) static EARLY_US: AtomicI32 = AtomicI32::new(0);

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
    received: [u8; PREFIX_BYTES + 1 + LINK_BYTES_MAX],
}

/// Opens the files of the lockstep; `None` if the host wants the firmware to run free.
pub(crate) fn open() -> Option<(Bus, Link)> {
    let down = File::open_to_read(c"link.down")?;
    let link = Link {
        up: File::open_to_write(c"link.up")?,
        down,
        sent: [0; LINK_UP_HEADER_BYTES + LINK_BYTES_MAX],
        received: [0; PREFIX_BYTES + 1 + LINK_BYTES_MAX],
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
    pub(crate) fn exchange(&mut self, (ms, early_us): (u32, i32), fill: impl FnOnce(&mut [u8]) -> usize) -> &[u8] {
        let (header, bytes) = self.sent.split_at_mut(LINK_UP_HEADER_BYTES);
        let length = fill(bytes).min(LINK_BYTES_MAX);
        header[..4].copy_from_slice(&ms.to_le_bytes());
        header[4..8].copy_from_slice(&early_us.to_le_bytes());
        header[8] = length as u8;
        or_end(self.up.write(&self.sent[..LINK_UP_HEADER_BYTES + length]));
        loop {
            let mut have = or_end(self.down.read(&mut self.received));
            let is_prefixed = self.received[0] >= AROUND;
            while is_prefixed && have < PREFIX_BYTES {
                have += or_end(self.down.read(&mut self.received[have..PREFIX_BYTES]));
            }
            match self.received[0] {
                // The host says nothing else until it has the memory.
                MEMORY => {
                    or_end(memory::send(self.up, self.received[1]));
                    continue;
                }
                AROUND => around::set(self.received[1]),
                _ => {}
            }
            let first = if is_prefixed { PREFIX_BYTES } else { 0 };
            while have <= first {
                have += or_end(self.down.read(&mut self.received[have..=first]));
            }
            let want = first + 1 + usize::from(self.received[first]).min(LINK_BYTES_MAX);
            while have < want {
                have += or_end(self.down.read(&mut self.received[have..want]));
            }
            return &self.received[first + 1..want];
        }
    }
}

/// Ends the firmware if the host has gone: an emulator must not outlive the program that started it.
fn or_end<T>(result: Result<T, Closed>) -> T {
    result.unwrap_or_else(|Closed| semihosting::fail(EXIT_HOST_GONE, format_args!("the host closed the lockstep")))
}
