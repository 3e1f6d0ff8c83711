//! News for several readers; no reader can delay the machine or another reader.
//!
//! Invariant: a reader that is too slow loses the oldest news and is told how many; publishing never waits.

use super::News;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

/// News queued for a reader.
#[derive(Debug, Default)]
struct Waiting {
    news: VecDeque<News>,
    lost: u64,
    closed: bool,
}

#[derive(Debug)]
struct Mailbox {
    capacity: usize,
    waiting: Mutex<Waiting>,
    arrived: Condvar,
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Why there is no news.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoNews {
    /// None arrived in time.
    Timeout,
    /// The machine was dropped; no more news will come.
    Closed,
}

/// One reader's queue of news, in order.
#[derive(Debug)]
pub struct Subscription(Arc<Mailbox>);

impl Subscription {
    /// The oldest news; waits for it at most `longest`.
    ///
    /// # Errors
    /// [`NoNews`].
    pub fn next_within(&self, longest: Duration) -> Result<News, NoNews> {
        let until = Instant::now() + longest;
        let mut waiting = self.0.lock();
        loop {
            if let Some(news) = waiting.news.pop_front() {
                return Ok(news);
            }
            if waiting.closed {
                return Err(NoNews::Closed);
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(NoNews::Timeout);
            }
            let woken = self.0.arrived.wait_timeout(waiting, left);
            (waiting, _) = woken.unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// The oldest news, if there is one.
    pub fn try_next(&self) -> Option<News> {
        self.0.lock().news.pop_front()
    }

    /// Number of news lost since the last call because this reader was too slow.
    pub fn take_lost(&self) -> u64 {
        std::mem::take(&mut self.0.lock().lost)
    }
}

/// All readers.
#[derive(Debug, Default)]
pub(super) struct Subscribers(Mutex<Vec<Weak<Mailbox>>>);

impl Subscribers {
    fn lock(&self) -> MutexGuard<'_, Vec<Weak<Mailbox>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a reader of the news published from now on.
    pub(super) fn subscribe(&self, capacity: usize) -> Subscription {
        let mailbox = Arc::new(Mailbox {
            capacity: capacity.max(1),
            waiting: Mutex::default(),
            arrived: Condvar::new(),
        });
        self.lock().push(Arc::downgrade(&mailbox));
        Subscription(mailbox)
    }

    /// Passes news to every reader.
    pub(super) fn publish(&self, news: &News) {
        self.lock().retain(|reader| {
            let Some(mailbox) = reader.upgrade() else { return false };
            let mut waiting = mailbox.lock();
            if waiting.news.len() >= mailbox.capacity {
                waiting.news.pop_front();
                waiting.lost = waiting.lost.saturating_add(1);
            }
            waiting.news.push_back(news.clone());
            drop(waiting);
            mailbox.arrived.notify_one();
            true
        });
    }

    /// Closes all queues: no more news will come.
    pub(super) fn close(&self) {
        for mailbox in self.lock().iter().filter_map(Weak::upgrade) {
            mailbox.lock().closed = true;
            mailbox.arrived.notify_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reconnecting(attempt: u32) -> News {
        News::Reconnecting { attempt }
    }

    #[test]
    fn a_slow_reader_loses_the_oldest_and_is_told_while_others_get_everything() {
        let subscribers = Subscribers::default();
        let (slow, fast) = (subscribers.subscribe(3), subscribers.subscribe(10));
        (0..5).for_each(|attempt| subscribers.publish(&reconnecting(attempt)));
        let attempts = |reader: &Subscription| {
            let news = std::iter::from_fn(|| reader.try_next());
            news.map(|news| match news {
                News::Reconnecting { attempt } => attempt,
                other => panic!("{other:?}"),
            })
            .collect::<Vec<_>>()
        };
        assert_eq!((attempts(&slow), slow.take_lost()), (vec![2, 3, 4], 2));
        assert_eq!((attempts(&fast), fast.take_lost()), (vec![0, 1, 2, 3, 4], 0));
        assert_eq!(slow.take_lost(), 0);
    }

    #[test]
    fn a_reader_that_has_gone_is_forgotten_and_an_end_is_told() {
        let subscribers = Subscribers::default();
        drop(subscribers.subscribe(1));
        let reader = subscribers.subscribe(2);
        subscribers.publish(&reconnecting(1));
        assert_eq!(subscribers.lock().len(), 1);
        subscribers.close();
        assert!(reader.next_within(Duration::ZERO).is_ok());
        assert_eq!(reader.next_within(Duration::from_secs(60)).err(), Some(NoNews::Closed));
    }
}
