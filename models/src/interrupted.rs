//! Atomics of one core on which an interrupt may come in front of every access.
//!
//! [`explore`] runs a task once for every place of the interrupts. An interrupt runs to its end and is not interrupted.

use std::cell::{Cell, RefCell};
pub use std::sync::atomic::{Ordering, compiler_fence, fence};

type Handler = Box<dyn FnMut()>;

thread_local! {
    /// Accesses of the task so far.
    static ACCESSES: Cell<usize> = const { Cell::new(0) };
    /// Time: every access takes one count.
    static TIME: Cell<u32> = const { Cell::new(0) };
    /// Accesses in front of which an interrupt comes, the last one first.
    static PLACES: RefCell<Vec<usize>> = const { RefCell::new(Vec::new()) };
    static HANDLER: RefCell<Option<Handler>> = const { RefCell::new(None) };
}

/// An access of the task: interrupts that are due come first.
fn access() {
    TIME.set(TIME.get().wrapping_add(1));
    let number = ACCESSES.get();
    ACCESSES.set(number + 1);
    while PLACES.with_borrow(|places| places.last() == Some(&number)) {
        PLACES.with_borrow_mut(Vec::pop);
        // Taken for the time of the interrupt, which therefore is not interrupted.
        if let Some(mut handler) = HANDLER.take() {
            let places = PLACES.take();
            handler();
            PLACES.set(places);
            ACCESSES.set(number + 1);
            HANDLER.set(Some(handler));
        }
    }
}

/// The free-running counter.
pub fn free_run() -> u32 {
    TIME.get()
}

/// Counts for which the core sleeps.
pub const SLEEP: u32 = 1_000;

/// Sleeps until an interrupt comes, whose handler the caller calls.
pub fn wait() {
    access();
    TIME.set(TIME.get().wrapping_add(SLEEP));
}

/// Runs a task with one interrupt or two in all places, and returns the number of executions. `start` makes the shared data,
/// `interrupt` is the handler, `task` is what is interrupted, and `check` judges the end.
pub fn explore<S: 'static + Clone, R>(
    interrupts: usize,
    start: impl Fn() -> S,
    interrupt: impl Fn(&S) + Clone + 'static,
    task: impl Fn(&S) -> R,
    check: impl Fn(&S, R, usize),
) -> usize {
    let mut executions = 0;
    let mut run = |mut places: Vec<usize>| {
        let shared = start();
        places.sort_unstable_by(|a, b| b.cmp(a));
        let (handler, data) = (interrupt.clone(), shared.clone());
        let asked = places.len();
        PLACES.set(places);
        HANDLER.set(Some(Box::new(move || handler(&data))));
        ACCESSES.set(0);
        let result = task(&shared);
        let (accesses, left) = (ACCESSES.get(), PLACES.take().len());
        HANDLER.take();
        check(&shared, result, asked - left);
        executions += 1;
        accesses
    };
    let accesses = run(Vec::new());
    // An interrupt may lengthen the task: places behind its former end count as well.
    for first in 0..2 * accesses {
        run(vec![first]);
        for second in (first..2 * accesses).filter(|_| interrupts == 2) {
            run(vec![first, second]);
        }
    }
    executions
}

macro_rules! atomic {
    ($name:ident, $value:ty) => {
        /// An atomic in front of whose accesses an interrupt may come.
        #[derive(Debug, Default)]
        pub struct $name(std::sync::atomic::$name);

        impl $name {
            /// An atomic with a value.
            pub const fn new(value: $value) -> Self {
                Self(std::sync::atomic::$name::new(value))
            }

            /// Reads.
            pub fn load(&self, _: Ordering) -> $value {
                access();
                self.0.load(Ordering::Relaxed)
            }

            /// Writes.
            pub fn store(&self, value: $value, _: Ordering) {
                access();
                self.0.store(value, Ordering::Relaxed);
            }

            /// Writes, and returns the value before, in one access.
            pub fn swap(&self, value: $value, _: Ordering) -> $value {
                access();
                self.0.swap(value, Ordering::Relaxed)
            }
        }
    };
}

atomic!(AtomicU32, u32);
atomic!(AtomicU8, u8);
atomic!(AtomicBool, bool);
