//! Log output to the host: a defmt logger that writes into a ring, which a task of the lowest priority empties.
//!
//! A frame is stored completely or not at all. A frame without room is counted, and the count is logged when there is
//! room again. The logger never waits. Critical tasks must not log: a frame is written inside a critical section, which
//! does not mask them.

use super::semihosting::File;
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicU32, Ordering};
use critical_section::RestoreState;

const RING_BYTES: usize = 4096;
const DRAIN_BYTES: usize = 256;

const _: () = assert!(RING_BYTES.is_power_of_two());

/// Milliseconds since the first release, for the lines' time stamps.
pub(crate) static MILLISECONDS: AtomicU32 = AtomicU32::new(0);

defmt::timestamp!("{=u32:ms}", MILLISECONDS.load(Ordering::Relaxed));

/// Bytes between the logger and the drain. Positions keep counting and are reduced when the array is accessed.
struct Ring {
    bytes: [u8; RING_BYTES],
    read: usize,
    /// End of the last complete frame.
    committed: usize,
    /// End of the frame being written.
    written: usize,
    overflowed: bool,
    dropped: u32,
}

impl Ring {
    fn push(&mut self, bytes: &[u8]) {
        if self.overflowed || self.written.wrapping_sub(self.read) + bytes.len() > RING_BYTES {
            self.overflowed = true;
            return;
        }
        for byte in bytes {
            self.bytes[self.written % RING_BYTES] = *byte;
            self.written = self.written.wrapping_add(1);
        }
    }

    fn commit(&mut self) {
        if self.overflowed {
            self.written = self.committed;
            self.overflowed = false;
            self.dropped = self.dropped.wrapping_add(1);
        } else {
            self.committed = self.written;
        }
    }

    fn pop(&mut self, into: &mut [u8]) -> usize {
        let length = into.len().min(self.committed.wrapping_sub(self.read));
        for byte in &mut into[..length] {
            *byte = self.bytes[self.read % RING_BYTES];
            self.read = self.read.wrapping_add(1);
        }
        length
    }
}

/// State of the logger while a frame is being written.
struct State {
    encoder: defmt::Encoder,
    ring: Ring,
    restore: RestoreState,
    open: bool,
}

struct Shared(UnsafeCell<State>);

// SAFETY: the state is accessed inside critical sections only: between the logger's `acquire` and `release`, and in
// `drain` and `dropped`. Critical tasks, which no critical section masks, do not log.
unsafe impl Sync for Shared {}

static STATE: Shared = Shared(UnsafeCell::new(State {
    encoder: defmt::Encoder::new(),
    ring: Ring {
        bytes: [0; RING_BYTES],
        read: 0,
        committed: 0,
        written: 0,
        overflowed: false,
        dropped: 0,
    },
    restore: RestoreState::invalid(),
    open: false,
}));

#[defmt::global_logger]
struct Logger;

// SAFETY: `acquire` enters a critical section that `release` leaves, so one frame is written at a time; a second
// `acquire` inside a frame, which would need two references to the state, panics.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: left by `release`, which defmt calls once for each `acquire`.
        let restore = unsafe { critical_section::acquire() };
        // SAFETY: inside the critical section this is the only reference.
        let state = unsafe { &mut *STATE.0.get() };
        assert!(!state.open, "a log line inside a log line");
        state.open = true;
        state.restore = restore;
        let State { encoder, ring, .. } = state;
        encoder.start_frame(|bytes| ring.push(bytes));
    }

    unsafe fn flush() {}

    unsafe fn release() {
        // SAFETY: defmt calls this between `acquire` and the end of the critical section it entered.
        let state = unsafe { &mut *STATE.0.get() };
        let State { encoder, ring, .. } = state;
        encoder.end_frame(|bytes| ring.push(bytes));
        ring.commit();
        state.open = false;
        // SAFETY: the state that the matching `acquire` found.
        unsafe { critical_section::release(state.restore) };
    }

    unsafe fn write(bytes: &[u8]) {
        // SAFETY: as for `release`.
        let State { encoder, ring, .. } = unsafe { &mut *STATE.0.get() };
        encoder.write(bytes, |bytes| ring.push(bytes));
    }
}

fn with_ring<T>(f: impl FnOnce(&mut Ring) -> T) -> T {
    critical_section::with(|_| {
        // SAFETY: the critical section excludes the logger, and `f` cannot keep the reference.
        let state = unsafe { &mut *STATE.0.get() };
        f(&mut state.ring)
    })
}

/// The task's end of the ring.
pub(crate) struct Drain {
    file: Option<File>,
}

impl Drain {
    /// Opens the file `log` of the emulator's working directory.
    pub(crate) fn open() -> Self {
        Self {
            file: File::open_to_write(c"log"),
        }
    }

    /// Writes the content of the ring to the host's file; bytes that the host does not take are lost.
    pub(crate) fn run(&mut self) {
        let mut bytes = [0; DRAIN_BYTES];
        loop {
            let length = with_ring(|ring| ring.pop(&mut bytes));
            if length == 0 {
                break;
            }
            if self.file.is_some_and(|file| file.write(&bytes[..length]).is_err()) {
                self.file = None;
            }
        }
        let dropped = with_ring(|ring| core::mem::take(&mut ring.dropped));
        if dropped > 0 {
            defmt::warn!("{=u32} log lines dropped", dropped);
        }
    }
}
