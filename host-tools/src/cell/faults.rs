//! Scripted faults: what goes wrong on the segment, and when.
//!
//! A script is text, one fault a line, `#` starts a comment:
//!
//! ```text
//! frame 120 drop                 the 120th EtherCAT frame (the first is 1) never arrives
//! frame 120..125 truncate 30     the replies to these frames are cut after 30 bytes
//! every 100 duplicate            every 100th reply comes twice
//! chance 0.01 lose               each reply is lost with this probability (seeded)
//! ms 2000 cut 2                  2 s after the start the cable behind slave 2 is pulled (0: the master's)
//! ```
//!
//! | fault | what happens |
//! |---|---|
//! | `drop`, `lose` | the request never reaches the slaves; the slaves act, the reply is lost |
//! | `delay N` | the reply comes N frames later, before that frame's own reply |
//! | `duplicate` | the reply comes twice |
//! | `truncate N` | the reply is cut after N bytes |
//! | `index N` | N is added to the index of the reply's datagrams |
//! | `foreign` | a frame of another protocol comes before the reply |
//! | `counter N` | N (it may be negative) is added to the working counters of the reply |
//! | `stall N` | no frame gets through in either direction for N ms |
//! | `cut K`, `join` | the cable behind slave K is pulled; all cables are plugged in again |
//! | `remove K`, `insert K` | slave K is bypassed; it comes back |
//! | `power K N` | slave K is without power for N ms, and with it the chain behind it |
//! | `retreat K CODE` | slave K falls back to SAFEOP with the error bit and this AL status code |
//! | `silence K N` | slave K answers no mailbox message for N ms |
//! | `fault K CODE` | drive K faults with this error code |
//! | `mains K N` | drive K has no main voltage for N ms |
//! | `stuck K N` | the resolver of drive K freezes for N ms |
//!
//! Slaves count from 1 in the order of the chain; numbers are decimal or `0x` hexadecimal. `every` and `chance` go
//! with faults of frames only. A fault of a frame with `ms` hits the first frame at or after that time.

use super::random::Random;
use std::fmt;
use std::str::FromStr;

/// One fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The request never reaches the slaves.
    Drop,
    /// The slaves act, the reply is lost.
    Lose,
    /// The reply comes this many frames later.
    Delay(u64),
    /// The reply comes twice.
    Duplicate,
    /// The reply is cut after this many bytes.
    Truncate(usize),
    /// This is added to the index of the reply's datagrams.
    Index(u8),
    /// A frame of another protocol comes before the reply.
    Foreign,
    /// This is added to the working counters of the reply.
    Counter(i16),
    /// No frame gets through for this many milliseconds.
    Stall(u64),
    /// The cable behind this slave is pulled; 0 is the master's.
    Cut(usize),
    /// All cables are plugged in.
    Join,
    /// This slave is bypassed.
    Remove(usize),
    /// This slave comes back.
    Insert(usize),
    /// A slave is without power for some milliseconds.
    Power(usize, u64),
    /// A slave falls back to SAFEOP with an AL status code.
    Retreat(usize, u16),
    /// A slave answers no mailbox message for some milliseconds.
    Silence(usize, u64),
    /// A drive faults with an error code.
    Drive(usize, u16),
    /// A drive has no main voltage for some milliseconds.
    Mains(usize, u64),
    /// A drive's resolver freezes for some milliseconds.
    Stuck(usize, u64),
}

impl Fault {
    /// Whether it happens to one frame.
    pub(super) fn is_of_frame(self) -> bool {
        matches!(
            self,
            Self::Drop
                | Self::Lose
                | Self::Delay(_)
                | Self::Duplicate
                | Self::Truncate(_)
                | Self::Index(_)
                | Self::Foreign
                | Self::Counter(_)
        )
    }
}

/// When a fault happens.
#[derive(Clone, Copy, Debug, PartialEq)]
enum When {
    Frames { first: u64, last: u64 },
    Time { ms: u64 },
    Every { frames: u64 },
    Chance { probability: f64 },
}

/// Why a script was not understood.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScriptError {
    /// Line, from 1.
    pub line: usize,
    /// What is wrong with it.
    pub reason: ScriptProblem,
    /// The word it is about; empty where one is missing.
    pub word: String,
}

/// What can be wrong with a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScriptProblem {
    /// The line does not start with `frame`, `ms`, `every` or `chance`.
    When,
    /// No such fault.
    Fault,
    /// A number is missing, malformed or out of range.
    Number,
    /// More words than the fault takes.
    Surplus,
    /// `every` and `chance` go with faults of frames only.
    Repeated,
}

impl fmt::Display for ScriptError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reason = match self.reason {
            ScriptProblem::When => "expected 'frame', 'ms', 'every' or 'chance'",
            ScriptProblem::Fault => "no such fault",
            ScriptProblem::Number => "a number is missing or out of range",
            ScriptProblem::Surplus => "one word too many",
            ScriptProblem::Repeated => "'every' and 'chance' go with faults of frames only",
        };
        write!(formatter, "line {}: {reason}: '{}'", self.line, self.word)
    }
}

impl std::error::Error for ScriptError {}

/// Faults and their times.
#[derive(Clone, Debug, Default)]
pub struct Script {
    entries: Vec<(When, Fault)>,
}

impl FromStr for Script {
    type Err = ScriptError;

    fn from_str(text: &str) -> Result<Self, ScriptError> {
        let mut entries = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let content = line.split('#').next().unwrap_or_default();
            let mut words = Words {
                line: index + 1,
                words: content.split_whitespace(),
            };
            if let Some(first) = words.words.next() {
                entries.push(entry(first, &mut words)?);
            }
        }
        Ok(Self { entries })
    }
}

struct Words<'a> {
    line: usize,
    words: std::str::SplitWhitespace<'a>,
}

impl Words<'_> {
    fn error(&self, reason: ScriptProblem, word: &str) -> ScriptError {
        ScriptError {
            line: self.line,
            reason,
            word: word.to_owned(),
        }
    }

    fn number<T: TryFrom<i64>>(&mut self) -> Result<T, ScriptError> {
        let word = self.words.next().unwrap_or_default();
        self.parse_number(word)
    }

    fn parse_number<T: TryFrom<i64>>(&self, word: &str) -> Result<T, ScriptError> {
        let parsed = match word.strip_prefix("0x") {
            Some(digits) => i64::from_str_radix(digits, 16),
            None => word.parse(),
        };
        parsed
            .ok()
            .and_then(|number| T::try_from(number).ok())
            .ok_or_else(|| self.error(ScriptProblem::Number, word))
    }

    fn slave(&mut self) -> Result<usize, ScriptError> {
        match self.number()? {
            0 => Err(self.error(ScriptProblem::Number, "0")),
            slave => Ok(slave),
        }
    }
}

fn entry(first: &str, words: &mut Words) -> Result<(When, Fault), ScriptError> {
    let when = match first {
        "frame" => {
            let word = words.words.next().unwrap_or_default();
            let (from, to) = word.split_once("..").unwrap_or((word, word));
            When::Frames {
                first: words.parse_number(from)?,
                last: words.parse_number(to)?,
            }
        }
        "ms" => When::Time { ms: words.number()? },
        "every" => match words.number()? {
            0 => return Err(words.error(ScriptProblem::Number, "0")),
            frames => When::Every { frames },
        },
        "chance" => {
            let word = words.words.next().unwrap_or_default();
            match word.parse() {
                Ok(probability) if (0.0..=1.0).contains(&probability) => When::Chance { probability },
                _ => return Err(words.error(ScriptProblem::Number, word)),
            }
        }
        word => return Err(words.error(ScriptProblem::When, word)),
    };
    let name = words.words.next().unwrap_or_default();
    let fault = match name {
        "drop" => Fault::Drop,
        "lose" => Fault::Lose,
        "delay" => Fault::Delay(words.number()?),
        "duplicate" => Fault::Duplicate,
        "truncate" => Fault::Truncate(words.number()?),
        "index" => Fault::Index(words.number()?),
        "foreign" => Fault::Foreign,
        "counter" => Fault::Counter(words.number()?),
        "stall" => Fault::Stall(words.number()?),
        "cut" => Fault::Cut(words.number()?),
        "join" => Fault::Join,
        "remove" => Fault::Remove(words.slave()?),
        "insert" => Fault::Insert(words.slave()?),
        "power" => Fault::Power(words.slave()?, words.number()?),
        "retreat" => Fault::Retreat(words.slave()?, words.number()?),
        "silence" => Fault::Silence(words.slave()?, words.number()?),
        "fault" => Fault::Drive(words.slave()?, words.number()?),
        "mains" => Fault::Mains(words.slave()?, words.number()?),
        "stuck" => Fault::Stuck(words.slave()?, words.number()?),
        word => return Err(words.error(ScriptProblem::Fault, word)),
    };
    if let Some(word) = words.words.next() {
        return Err(words.error(ScriptProblem::Surplus, word));
    }
    if matches!(when, When::Every { .. } | When::Chance { .. }) && !fault.is_of_frame() {
        return Err(words.error(ScriptProblem::Repeated, name));
    }
    Ok((when, fault))
}

/// A script at work.
#[derive(Clone, Debug)]
pub(super) struct Schedule {
    entries: Vec<(When, Fault)>,
    random: Random,
}

impl Schedule {
    pub(super) fn new(script: &Script, seed: u64) -> Self {
        Self {
            entries: script.entries.clone(),
            random: Random::new(seed),
        }
    }

    /// Adds a fault that happens now: to the next frame, or to the cell at the next millisecond.
    pub(super) fn inject(&mut self, fault: Fault) {
        self.entries.push((When::Time { ms: 0 }, fault));
    }

    /// The faults that happen to the cell at this millisecond, once each.
    pub(super) fn at_time(&mut self, now_ms: u64) -> Vec<Fault> {
        let due = |when: &When, fault: &Fault| match when {
            When::Time { ms } => *ms <= now_ms && !fault.is_of_frame(),
            _ => false,
        };
        self.take(due)
    }

    /// The faults that the arrival of this frame (from 1) brings, of both kinds.
    pub(super) fn at_frame(&mut self, frame: u64, now_ms: u64) -> Vec<Fault> {
        let mut faults = self.take(|when, fault| match when {
            When::Time { ms } => *ms <= now_ms && fault.is_of_frame(),
            When::Frames { first, last } => {
                (*first..=*last).contains(&frame) && (first == last || !fault.is_of_frame())
            }
            _ => false,
        });
        for (when, fault) in &self.entries {
            let hits = match when {
                When::Frames { first, last } => (*first..=*last).contains(&frame),
                When::Every { frames } => frame.is_multiple_of(*frames),
                When::Chance { probability } => self.random.unit() < *probability,
                When::Time { .. } => false,
            };
            if hits {
                faults.push(*fault);
            }
        }
        faults
    }

    fn take(&mut self, due: impl Fn(&When, &Fault) -> bool) -> Vec<Fault> {
        if self.entries.is_empty() {
            return Vec::new();
        }
        let (taken, kept) = self.entries.iter().partition(|(when, fault)| due(when, fault));
        let taken: Vec<(When, Fault)> = taken;
        self.entries = kept;
        taken.into_iter().map(|(_, fault)| fault).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schedule(text: &str) -> Schedule {
        Schedule::new(&text.parse().expect("a script"), 7)
    }

    #[test]
    fn faults_happen_at_their_frames_and_times_only() {
        let mut schedule = schedule("frame 3 drop # one\n\nframe 5..6 index 9\nms 20 cut 2\nms 9 lose\n");
        let frames: Vec<_> = (1..=7).map(|frame| schedule.at_frame(frame, frame)).collect();
        assert_eq!(frames[2], [Fault::Drop]);
        assert_eq!(
            (&frames[4], &frames[5]),
            (&vec![Fault::Index(9)], &vec![Fault::Index(9)])
        );
        assert_eq!(frames.iter().map(Vec::len).sum::<usize>(), 3);
        assert_eq!(schedule.at_frame(8, 30), [Fault::Lose]);
        assert_eq!(schedule.at_time(19), []);
        assert_eq!(schedule.at_time(21), [Fault::Cut(2)]);
        assert_eq!(schedule.at_time(22), []);
    }

    #[test]
    fn chance_is_seeded_and_about_as_often_as_asked() {
        let hits = || {
            let mut schedule = schedule("chance 0.1 drop");
            (0..10_000)
                .filter(|frame| !schedule.at_frame(*frame, 0).is_empty())
                .collect::<Vec<_>>()
        };
        assert_eq!(hits(), hits());
        assert!((900..1100).contains(&hits().len()), "{} hits with seed 7", hits().len());
    }

    #[test]
    fn an_error_names_its_line_and_word() {
        let cases = [
            ("frame 1 drop\nfrme 2 drop", 2, ScriptProblem::When, "frme"),
            ("frame x drop", 1, ScriptProblem::Number, "x"),
            ("frame 1 explode", 1, ScriptProblem::Fault, "explode"),
            ("\n\nms 1 power 2", 3, ScriptProblem::Number, ""),
            ("ms 1 remove 0", 1, ScriptProblem::Number, "0"),
            ("ms 1 join now", 1, ScriptProblem::Surplus, "now"),
            ("every 3 cut 1", 1, ScriptProblem::Repeated, "cut"),
            ("chance 2 drop", 1, ScriptProblem::Number, "2"),
            ("every 0 drop", 1, ScriptProblem::Number, "0"),
        ];
        for (text, line, reason, word) in cases {
            let error = text.parse::<Script>().expect_err(text);
            assert_eq!(
                error,
                ScriptError {
                    line,
                    reason,
                    word: word.to_owned()
                },
                "{text}"
            );
        }
    }
}
