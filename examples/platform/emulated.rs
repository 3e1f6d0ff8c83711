//! The emulated board for the examples: an Ethernet port and a tick, without interrupts.
//!
//! QEMU's mps2-an500 with a LAN9118. Virtual time follows the computer's time, so a busy computer delays a reply: a
//! cycle waits for it.

#[path = "../../src/bin/emulated/device.rs"]
#[allow(dead_code)] // the vector table is for all interrupts, the examples use none
mod device;
#[path = "../../src/bin/emulated/lan9118.rs"]
#[allow(dead_code)]
mod lan9118;
#[path = "../../src/bin/emulated/semihosting.rs"]
#[allow(dead_code)]
mod semihosting;

use core::fmt::Arguments;
use core::panic::PanicInfo;
use core::sync::atomic::AtomicU32;
use core::sync::atomic::Ordering::Relaxed;
use defmt as _;
use device::CLOCK_HZ;
use etherpen::ethernet::lan9118::Lan9118;
use etherpen_ethercat::frame_port::FramePort;
use lan9118::{Mmio, free_run};

/// The master's Ethernet address.
pub(crate) const ADDRESS: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
/// Longest wait for a reply, counts of the clock.
const REPLY_COUNTS: u32 = CLOCK_HZ / 20;

/// The board.
pub(crate) struct Platform {
    port: FramePort<Lan9118<Mmio>>,
    ticked_at: u32,
}

impl Platform {
    fn start() -> Self {
        // SAFETY: `main` is the only caller, and it runs once.
        let mmio = unsafe { Mmio::take() };
        let Ok(mac) = Lan9118::start(mmio, ADDRESS) else {
            panic!("no Ethernet controller")
        };
        Self {
            port: FramePort::new(mac),
            ticked_at: free_run(),
        }
    }

    /// Waits for the next millisecond; begins at once if it is late.
    pub(crate) fn tick(&mut self) {
        while free_run().wrapping_sub(self.ticked_at) < CLOCK_HZ / 1_000 {}
        self.ticked_at = free_run();
    }

    /// The time, ms, wrapping; to be called every minute at least, before the counter wraps.
    pub(crate) fn now_ms() -> u32 {
        static COUNTED: AtomicU32 = AtomicU32::new(0);
        static PASSED_MS: AtomicU32 = AtomicU32::new(0);
        const COUNTS_PER_MS: u32 = CLOCK_HZ / 1_000;
        let more_ms = free_run().wrapping_sub(COUNTED.load(Relaxed)) / COUNTS_PER_MS;
        COUNTED.fetch_add(more_ms * COUNTS_PER_MS, Relaxed);
        PASSED_MS.fetch_add(more_ms, Relaxed).wrapping_add(more_ms)
    }

    /// Sends a frame; an empty one is not sent.
    pub(crate) fn send(&mut self, frame: &[u8]) {
        self.port.send(frame);
    }

    /// Passes received frames to `take` until it returns true, or the reply is too late.
    pub(crate) fn receive(&mut self, mut take: impl FnMut(&[u8]) -> bool) {
        let sent_at = free_run();
        while free_run().wrapping_sub(sent_at) < REPLY_COUNTS && self.port.receive(&mut take) != Some(true) {}
    }

    /// Prints a line on the emulator's console.
    pub(crate) fn say(&self, line: Arguments) {
        semihosting::say(line);
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    crate::run(&mut Platform::start());
    semihosting::exit(0)
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    semihosting::fail(semihosting::EXIT_PANIC, format_args!("{info}"))
}
