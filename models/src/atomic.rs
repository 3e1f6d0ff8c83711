//! loom's atomics with constructors that are constant, as the product's statics need them.

pub use loom::sync::atomic::{Ordering, fence};
use std::sync::OnceLock;

macro_rules! atomic {
    ($name:ident, $value:ty) => {
        /// An atomic that loom knows from its first use on.
        #[derive(Debug, Default)]
        pub struct $name {
            first: $value,
            inner: OnceLock<loom::sync::atomic::$name>,
        }

        impl $name {
            /// An atomic with a value.
            pub const fn new(first: $value) -> Self {
                Self {
                    first,
                    inner: OnceLock::new(),
                }
            }

            fn inner(&self) -> &loom::sync::atomic::$name {
                self.inner
                    .get_or_init(|| loom::sync::atomic::$name::new(self.first))
            }

            /// Reads.
            pub fn load(&self, order: Ordering) -> $value {
                self.inner().load(order)
            }

            /// Writes.
            pub fn store(&self, value: $value, order: Ordering) {
                self.inner().store(value, order);
            }
        }
    };
}

atomic!(AtomicU32, u32);
atomic!(AtomicUsize, usize);
atomic!(AtomicU8, u8);
atomic!(AtomicBool, bool);

impl AtomicU32 {
    /// Adds; returns the value before.
    pub fn fetch_add(&self, value: u32, order: Ordering) -> u32 {
        self.inner().fetch_add(value, order)
    }

    /// Subtracts; returns the value before.
    pub fn fetch_sub(&self, value: u32, order: Ordering) -> u32 {
        self.inner().fetch_sub(value, order)
    }
}
