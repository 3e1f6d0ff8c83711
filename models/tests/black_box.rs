//! The black box: whatever is interrupted, what it shows is whole.

use etherpen_models::black_box::{
    Direction, Fetcher, FrameNote, FrameNotes, FrameSource, Left, Memory, put_event, put_sample, recording,
};
use etherpen_models::interrupted::{AtomicU32, Ordering, SLEEP, explore, free_run};
use etherpen_models::load;
use std::cell::RefCell;
use std::rc::Rc;

/// A memory, and what the first reset leaves of it.
struct Reset {
    memory: Box<Memory>,
    left: RefCell<Option<Left>>,
}

impl Reset {
    fn new(memory: Box<Memory>) -> Rc<Self> {
        Rc::new(Self {
            memory,
            left: RefCell::new(None),
        })
    }

    fn come(&self) {
        self.left.borrow_mut().get_or_insert_with(|| Left::by(&self.memory));
    }

    /// What is left; the whole memory if the reset came after the task.
    fn left(&self) -> Left {
        self.left.take().unwrap_or_else(|| Left::by(&self.memory))
    }
}

/// The numbers of entries, each of which consists of its number only.
fn numbers(entries: &[Vec<u32>]) -> Vec<u32> {
    let number = |entry: &Vec<u32>| {
        assert!(entry.iter().all(|word| *word == entry[0]), "a torn entry: {entry:?}");
        entry[0]
    };
    entries.iter().map(number).collect()
}

/// Writes entries into a full ring, with a reset at every access: the newest ones are there, without a gap, and at most one is
/// missing at the oldest end.
fn a_reset_leaves_whole_entries(entries: u32, put: fn(&Memory, u32), read: fn(&Left) -> Vec<Vec<u32>>) {
    const WRITTEN: u32 = 2;
    let start = || {
        let memory = recording();
        (0..entries).for_each(|number| put(&memory, number));
        Reset::new(memory)
    };
    let executions = explore(
        1,
        start,
        |shared| shared.come(),
        |shared| (0..WRITTEN).for_each(|number| put(&shared.memory, entries + number)),
        |shared, (), _| {
            let left = numbers(&read(&shared.left()));
            let last = *left.last().expect("entries");
            assert!((entries - 1..entries + WRITTEN).contains(&last), "{last}");
            assert!(left.len() as u32 >= entries - 1, "{} are left", left.len());
            assert!(left.is_sorted_by(|a, b| a + 1 == *b));
        },
    );
    println!("reset in a ring of {entries}: {executions} executions");
}

#[test]
fn a_reset_at_any_access_leaves_whole_samples() {
    a_reset_leaves_whole_entries(2_000, put_sample, Left::samples);
}

#[test]
fn a_reset_at_any_access_leaves_whole_events() {
    a_reset_leaves_whole_entries(100, put_event, Left::events);
}

/// Buffers of an Ethernet controller that are used again in turn.
const BUFFERS: usize = 8;
/// Words of a buffer.
const WORDS: usize = 16;

/// Frames whose bytes are their number again and again.
struct Frames {
    notes: FrameNotes,
    buffers: [[AtomicU32; WORDS]; BUFFERS],
}

impl Frames {
    fn new() -> Self {
        Self {
            notes: FrameNotes::new(),
            buffers: [const { [const { AtomicU32::new(0) }; WORDS] }; BUFFERS],
        }
    }

    /// Lets frames pass.
    fn pass(&self, count: u32) {
        for _ in 0..count {
            let number = self.notes.count();
            let place = number as usize % BUFFERS;
            let words = 1 + number as usize % WORDS;
            (self.buffers[place].iter()).for_each(|word| word.store(number, Ordering::Relaxed));
            self.notes.note(Direction::Received, place as u32, 4 * words, number);
        }
    }
}

impl FrameSource for Frames {
    fn notes(&self) -> &FrameNotes {
        &self.notes
    }

    fn word(&self, note: &FrameNote, index: usize) -> u32 {
        self.buffers[note.place as usize][index].load(Ordering::Relaxed)
    }

    fn is_intact(&self, note: &FrameNote) -> bool {
        self.notes.count().wrapping_sub(note.number) <= BUFFERS as u32
    }
}

/// The numbers of the frames that are left, which are whole.
fn whole(left: &Left) -> Vec<u32> {
    let frames = left.frames();
    for (number, words) in &frames {
        assert_eq!(words.len(), 1 + *number as usize % WORDS);
        assert!(words.iter().all(|word| word == number), "frame {number}: {words:?}");
    }
    frames.into_iter().map(|(number, _)| number).collect()
}

/// Frames that an interrupt lets pass: few, as many as there are buffers, and more than there are notes.
fn frames_that_pass_meanwhile_are_whole_or_counted_as_missed(by_interrupt: u32, interrupts: usize) {
    const BEFORE: u32 = 3;
    let start = || {
        let frames = Frames::new();
        let fetcher = Fetcher::new(&frames);
        frames.pass(BEFORE);
        Rc::new((recording(), frames, RefCell::new(fetcher)))
    };
    let executions = explore(
        interrupts,
        start,
        move |shared| shared.1.pass(by_interrupt),
        |shared| {
            let (memory, frames, fetcher) = &**shared;
            (0..2).for_each(|_| fetcher.borrow_mut().take(memory, frames));
        },
        |shared, (), _| {
            let (memory, frames, fetcher) = &**shared;
            fetcher.borrow_mut().take(memory, frames);
            let left = Left::by(memory);
            let recorded = whole(&left);
            assert!(recorded.is_sorted_by(|a, b| a < b), "{recorded:?}");
            assert_eq!(recorded.len() as u32 + left.missed(), frames.notes.count());
        },
    );
    println!("{by_interrupt} frames at each of {interrupts} interrupts: {executions} executions");
}

#[test]
fn frames_that_pass_while_the_recorder_fetches_are_whole_or_counted_as_missed() {
    for by_interrupt in [1, BUFFERS as u32, 31, 33] {
        frames_that_pass_meanwhile_are_whole_or_counted_as_missed(by_interrupt, 1);
    }
    frames_that_pass_meanwhile_are_whole_or_counted_as_missed(2, 2);
}

#[test]
fn a_reset_at_any_access_leaves_whole_frames() {
    let start = || {
        let memory = recording();
        let frames = Frames::new();
        let mut fetcher = Fetcher::new(&frames);
        // Enough for the ring to be full: about 11 words each, of less than 32,000.
        for _ in 0..1_000 {
            frames.pass(4);
            fetcher.take(&memory, &frames);
        }
        frames.pass(2);
        Rc::new((Reset::new(memory), frames, RefCell::new(fetcher)))
    };
    let executions = explore(
        1,
        start,
        |shared| shared.0.come(),
        |shared| shared.2.borrow_mut().take(&shared.0.memory, &shared.1),
        |shared, (), _| {
            let left = whole(&shared.0.left());
            assert!((3_999..4_002).contains(left.last().expect("frames")));
            assert!(left.len() > 2_000, "{} are left", left.len());
            assert!(left.is_sorted_by(|a, b| a + 1 == *b));
        },
    );
    println!("reset in the ring of frames: {executions} executions");
}

#[test]
fn never_more_sleep_is_counted_than_time_has_passed() {
    let executions = explore(
        2,
        || (load::slept(), free_run()),
        |_| load::task(),
        |(slept, begun)| {
            load::idle();
            load::task();
            (load::slept().wrapping_sub(*slept), free_run().wrapping_sub(*begun))
        },
        |_, (slept, passed), interrupts| {
            assert!(slept <= passed, "{slept} of {passed}");
            assert!(slept >= SLEEP || interrupts > 0, "{slept} without an interrupt");
        },
    );
    println!("sleep: {executions} executions");
}
