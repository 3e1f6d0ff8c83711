//! What tasks share without a lock, for models that try every order of events.
//!
//! The modules below are the product's sources with other atomics (see `build.rs`). [`atomic`] is loom's: every
//! interleaving of threads, and every value that a weak memory may show. [`interrupted`] is one core: an interrupt may
//! come at every access and runs to its end, as on the boards. [`spsc`] stands for heapless' queue.

pub mod atomic;
pub mod black_box;
pub mod interrupted;
pub mod spsc;

/// As in the product's sampler; the models do not depend on it.
pub const OUTPUT_LATE_NS: u32 = 500_000;

/// As in the product's board interface.
pub enum RunEnd {
    /// The memory had no power.
    PowerOff,
    /// A reset from outside.
    Reset,
    /// The watchdog.
    Watchdog,
    /// A panic.
    Panic(()),
}

/// `src/ethernet/descriptors.rs`
pub mod descriptors {
    include!(concat!(env!("OUT_DIR"), "/descriptors.rs"));

    impl Descriptor {
        /// Word 3 as the DMA reads it.
        pub fn read(&self) -> u32 {
            self.control()
        }

        /// Writes word 3 back, as the DMA does when it has finished.
        pub fn write_back(&self, control: u32) {
            self.0[3].store(control, Ordering::Release);
        }
    }
}

/// `crates/ethercat/src/queue.rs`
pub mod queue {
    include!(concat!(env!("OUT_DIR"), "/queue.rs"));
}

/// `src/measurement.rs`
pub mod measurement {
    include!(concat!(env!("OUT_DIR"), "/measurement.rs"));
}

/// `src/measurement.rs` on one core.
pub mod interrupted_measurement {
    include!(concat!(env!("OUT_DIR"), "/interrupted_measurement.rs"));
}

/// `src/bin/shared/overruns.rs`
pub mod overruns {
    include!(concat!(env!("OUT_DIR"), "/overruns.rs"));

    /// A release, as the sampler's task makes it.
    pub fn released() {
        trajectory_released();
    }

    /// The end of the task that found so many releases.
    pub fn completed(due: u32) {
        trajectory_completed(due);
    }
}

/// `src/bin/shared/load.rs` on one core.
#[allow(dead_code)]
pub mod load {
    include!(concat!(env!("OUT_DIR"), "/load.rs"));

    /// The idle task's sleep.
    pub fn idle() {
        sleep();
    }

    /// The beginning of a task that an interrupt releases.
    pub fn task() {
        woke();
    }

    /// Counts slept since the start.
    pub fn slept() -> u32 {
        slept_counts()
    }
}
