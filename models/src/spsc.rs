//! A model of heapless' queue for one producer and one consumer: its contract, with the orderings of version 0.9.3.
//!
//! `enqueue` and `dequeue` order the entry between the two sides; `ready`, `len` and `peek` compare the ends with
//! relaxed loads. loom tracks every access to an entry, so a read without order before a write is found.

use crate::atomic::{AtomicUsize, Ordering};
use loom::cell::{ConstPtr, UnsafeCell};
use std::sync::Arc;

/// The shared part.
pub struct Queue<T> {
    head: AtomicUsize,
    tail: AtomicUsize,
    entries: Vec<UnsafeCell<Option<T>>>,
}

impl<T> Queue<T> {
    /// The two ends of a queue that holds one entry less than its places.
    pub fn split(places: usize) -> (Producer<'static, T>, Consumer<'static, T>) {
        let queue = Arc::new(Self {
            head: AtomicUsize::new(0),
            tail: AtomicUsize::new(0),
            entries: (0..places).map(|_| UnsafeCell::new(None)).collect(),
        });
        // loom wants both ends to exist before the threads do.
        assert_eq!(queue.len(), 0);
        let producer = Producer(queue.clone(), std::marker::PhantomData);
        (producer, Consumer(queue, std::marker::PhantomData))
    }

    fn after(&self, place: usize) -> usize {
        (place + 1) % self.entries.len()
    }

    fn len(&self) -> usize {
        let head = self.head.load(Ordering::Relaxed);
        let tail = self.tail.load(Ordering::Relaxed);
        (tail + self.entries.len() - head) % self.entries.len()
    }
}

/// The producing end.
pub struct Producer<'q, T>(Arc<Queue<T>>, std::marker::PhantomData<&'q ()>);

impl<T> Producer<'_, T> {
    /// Entries that the queue holds.
    pub fn capacity(&self) -> usize {
        self.0.entries.len() - 1
    }

    /// Entries in the queue.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether the queue is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether an entry can be appended.
    pub fn ready(&self) -> bool {
        let queue = &self.0;
        queue.after(queue.tail.load(Ordering::Relaxed)) != queue.head.load(Ordering::Relaxed)
    }

    /// Appends an entry.
    ///
    /// # Errors
    /// The entry, when the queue is full.
    pub fn enqueue(&mut self, entry: T) -> Result<(), T> {
        let queue = &self.0;
        let tail = queue.tail.load(Ordering::Relaxed);
        let next = queue.after(tail);
        if next == queue.head.load(Ordering::Acquire) {
            return Err(entry);
        }
        // SAFETY: the place behind the tail belongs to the producer; loom checks it.
        queue.entries[tail].with_mut(|place| unsafe { *place = Some(entry) });
        queue.tail.store(next, Ordering::Release);
        Ok(())
    }
}

/// The consuming end.
pub struct Consumer<'q, T>(Arc<Queue<T>>, std::marker::PhantomData<&'q ()>);

impl<T> Consumer<'_, T> {
    /// Entries that the queue holds.
    pub fn capacity(&self) -> usize {
        self.0.entries.len() - 1
    }

    /// Whether there is an entry.
    pub fn ready(&self) -> bool {
        self.0.head.load(Ordering::Relaxed) != self.0.tail.load(Ordering::Relaxed)
    }

    /// The entry at the front, without order towards the producer.
    pub fn peek(&self) -> Option<&T> {
        if !self.ready() {
            return None;
        }
        let place: ConstPtr<Option<T>> = self.0.entries[self.0.head.load(Ordering::Relaxed)].get();
        // SAFETY: the entry stays until the consumer takes it; loom checks that it was written before.
        let entry: *const Option<T> = place.with(|place| place);
        unsafe { (*entry).as_ref() }
    }

    /// Takes the entry at the front.
    pub fn dequeue(&mut self) -> Option<T> {
        let queue = &self.0;
        let head = queue.head.load(Ordering::Relaxed);
        if head == queue.tail.load(Ordering::Acquire) {
            return None;
        }
        // SAFETY: the place at the head belongs to the consumer; loom checks it.
        let entry = queue.entries[head].with_mut(|place| unsafe { (*place).take() });
        queue.head.store(queue.after(head), Ordering::Release);
        entry
    }
}
