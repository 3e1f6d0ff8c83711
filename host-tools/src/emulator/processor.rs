//! One processor for those who take turns.
//!
//! The emulator and who answers it never run at the same time: one waits while the other works, several times in a virtual
//! millisecond. On two processors each turn costs the time in which a sleeping processor wakes up, which is more than the work
//! itself. Where threads cannot be bound to a processor, they are left alone: it is a matter of speed only.

#[cfg(target_os = "linux")]
mod bound {
    use rustix::thread::{CpuSet, sched_getaffinity, sched_getcpu, sched_setaffinity};
    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Keeps the thread that made it, and what it starts meanwhile, on one processor; dropped, it lets the thread go.
    pub(crate) struct OneProcessor {
        before: Option<CpuSet>,
    }

    impl OneProcessor {
        /// Chooses a processor: the present one for the first caller of this program, the next ones for those behind it.
        pub(crate) fn take() -> Self {
            static FIRST: OnceLock<usize> = OnceLock::new();
            static TAKEN: AtomicUsize = AtomicUsize::new(0);
            let Ok(before) = sched_getaffinity(None) else {
                return Self { before: None };
            };
            let allowed: Vec<usize> = (0..CpuSet::MAX_CPU).filter(|cpu| before.is_set(*cpu)).collect();
            let first = *FIRST.get_or_init(|| {
                let here = sched_getcpu();
                allowed.iter().position(|cpu| *cpu == here).unwrap_or(0)
            });
            let number = first.wrapping_add(TAKEN.fetch_add(1, Ordering::Relaxed));
            let mut only = CpuSet::new();
            if let Some(cpu) = number.checked_rem(allowed.len()).and_then(|index| allowed.get(index)) {
                only.set(*cpu);
            }
            let is_bound = sched_setaffinity(None, &only).is_ok();
            Self {
                before: is_bound.then_some(before),
            }
        }
    }

    impl Drop for OneProcessor {
        fn drop(&mut self) {
            if let Some(before) = &self.before {
                // What was allowed before is allowed now, unless somebody else has changed it: then it stays as it is.
                let _ = sched_setaffinity(None, before);
            }
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        /// How many processors this thread may use.
        fn here() -> usize {
            let set = sched_getaffinity(None).expect("a thread has its processors");
            (0..CpuSet::MAX_CPU).filter(|cpu| set.is_set(*cpu)).count()
        }

        #[test]
        fn a_thread_and_what_it_starts_stay_on_one_processor_until_it_is_let_go() {
            let all = here();
            let one = OneProcessor::take();
            assert_eq!(here(), 1);
            assert_eq!(std::thread::spawn(here).join().expect("a count"), 1);
            drop(one);
            assert_eq!(here(), all);
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod bound {
    /// Leaves threads on the processors that they have.
    pub(crate) struct OneProcessor;

    impl OneProcessor {
        pub(crate) fn take() -> Self {
            Self
        }
    }
}

pub(crate) use bound::OneProcessor;
