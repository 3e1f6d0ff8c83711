//! Operations on lock-free queues for the critical tasks.
//!
//! Two gaps of heapless are closed here. `Consumer::peek` compares the ends of the queue with relaxed loads, so by
//! itself it does not order the producer's write of the entry before the consumer's read; `dequeue` does. The ends do
//! not know the queue's length at compile time, so the compiler keeps the division-by-zero panic of the remainder
//! unless it can see that the length is not zero.
//!
//! Invariants: an entry is only read after it has been written completely; no function here panics.

use core::sync::atomic::{Ordering, fence};
use heapless::spsc::{Consumer, Producer};

/// More entries than any queue has; excludes a length of zero, which would wrap to more.
const CAPACITY_MAX: usize = 1 << 20;

/// The entry at the front, which stays in the queue; `None` when the queue is empty.
#[inline]
pub fn front<'q, T>(queue: &'q Consumer<'_, T>) -> Option<&'q T> {
    if queue.capacity() > CAPACITY_MAX || !queue.ready() {
        return None;
    }
    // Pairs with the release in the producer's `enqueue`, whose effect `ready` has just seen.
    fence(Ordering::Acquire);
    queue.peek()
}

/// Takes the entry at the front; `None` when the queue is empty.
pub fn take<T>(queue: &mut Consumer<'_, T>) -> Option<T> {
    if queue.capacity() > CAPACITY_MAX {
        return None;
    }
    queue.dequeue()
}

/// Removes the entry at the front, if there is one.
#[inline]
pub fn drop_front<T: Copy>(queue: &mut Consumer<'_, T>) {
    if queue.capacity() <= CAPACITY_MAX {
        let _ = queue.dequeue();
    }
}

/// Whether this many entries can be appended.
pub fn has_room_for<T>(queue: &Producer<'_, T>, entries: usize) -> bool {
    let capacity = queue.capacity();
    capacity <= CAPACITY_MAX && queue.len().saturating_add(entries) <= capacity
}

/// Appends an entry, copying it once into its place in the queue; false when the queue is full.
#[inline]
pub fn put_copy<T: Copy>(queue: &mut Producer<'_, T>, entry: &T) -> bool {
    queue.capacity() <= CAPACITY_MAX && queue.ready() && queue.enqueue(*entry).is_ok()
}

/// Appends an entry.
///
/// Never inlined: cold callers share one copy of `enqueue`, which then does not know that the length is not zero.
///
/// # Errors
/// The entry, when the queue is full.
#[inline(never)]
pub fn put<T>(queue: &mut Producer<'_, T>, entry: T) -> Result<(), T> {
    if queue.capacity() > CAPACITY_MAX {
        return Err(entry);
    }
    queue.enqueue(entry)
}
