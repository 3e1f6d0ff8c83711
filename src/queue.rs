//! The ends of lock-free queues, as the critical tasks may use them.
//!
//! Two things heapless leaves open are closed here. `Consumer::peek` compares the ends of the queue with relaxed loads, so
//! alone it does not order the producer's write of the entry before the consumer's look at it; `dequeue` does. And the ends
//! do not know the queue's length when they are compiled: the remainder by it keeps the panic for a division by zero in
//! the code, unless the length is known to be another number.
//!
//! Invariants: what is looked at has been written completely; nothing here panics.

use core::sync::atomic::{Ordering, fence};
use heapless::spsc::{Consumer, Producer};

/// More entries than any queue has; an impossible queue of no length would seem longer.
const CAPACITY_MAX: usize = 1 << 20;

/// The entry at the front, which stays in the queue; `None` when the queue is empty.
#[inline]
pub(crate) fn front<'q, T>(queue: &'q Consumer<'_, T>) -> Option<&'q T> {
    if queue.capacity() > CAPACITY_MAX || !queue.ready() {
        return None;
    }
    // Pairs with the release in the producer's `enqueue`, whose effect `ready` has just seen.
    fence(Ordering::Acquire);
    queue.peek()
}

/// Takes the entry at the front; `None` when the queue is empty.
pub(crate) fn take<T>(queue: &mut Consumer<'_, T>) -> Option<T> {
    if queue.capacity() > CAPACITY_MAX {
        return None;
    }
    queue.dequeue()
}

/// Lets the entry at the front go, if there is one.
#[inline]
pub(crate) fn drop_front<T: Copy>(queue: &mut Consumer<'_, T>) {
    if queue.capacity() <= CAPACITY_MAX {
        let _ = queue.dequeue();
    }
}

/// Whether so many entries can be appended.
pub(crate) fn has_room_for<T>(queue: &Producer<'_, T>, entries: usize) -> bool {
    let capacity = queue.capacity();
    capacity <= CAPACITY_MAX && queue.len().saturating_add(entries) <= capacity
}

/// Appends a copy of an entry, which is copied once, into its place in the queue; false when the queue is full.
#[inline]
pub(crate) fn put_copy<T: Copy>(queue: &mut Producer<'_, T>, entry: &T) -> bool {
    queue.capacity() <= CAPACITY_MAX && queue.ready() && queue.enqueue(*entry).is_ok()
}

/// Appends an entry.
///
/// Never inlined: cold callers would share one copy of `enqueue`, which then does not know that the length is not zero.
///
/// # Errors
/// The entry, when the queue is full.
#[inline(never)]
pub(crate) fn put<T>(queue: &mut Producer<'_, T>, entry: T) -> Result<(), T> {
    if queue.capacity() > CAPACITY_MAX {
        return Err(entry);
    }
    queue.enqueue(entry)
}
