//! Looking at the front of a queue whose producer may run at the same time.
//!
//! heapless's `Consumer::peek` compares the ends of the queue with relaxed loads, so alone it does not order the
//! producer's write of the entry before the consumer's look at it; `dequeue` does.
//!
//! Invariant: what is looked at has been written completely.

use core::sync::atomic::{Ordering, fence};
use heapless::spsc::Consumer;

/// The entry at the front, which stays in the queue; `None` when the queue is empty.
pub(crate) fn front<'q, T>(queue: &'q Consumer<'_, T>) -> Option<&'q T> {
    if !queue.ready() {
        return None;
    }
    // Pairs with the release in the producer's `enqueue`, whose effect `ready` has just seen.
    fence(Ordering::Acquire);
    queue.peek()
}
