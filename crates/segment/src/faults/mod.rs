//! Scripted faults on the segment.
//!
//! The language is described in [`SCRIPT_HELP`], which the command line prints too. A script is checked against the
//! chain before use ([`Script::check`]); the faults that happened are counted by kind.
//!
//! Invariant: equal scripts, seeds and frames give equal faults.

pub(crate) mod damage;
pub(crate) mod kinds;

use crate::application::AlState;
use crate::drive::resolver::ResolverFault;
use crate::eeprom::SiiFault;
use crate::mailbox::foe::FileFault;
use crate::random::Random;
use kinds::{Fault, MailFault, MailStep, Manner, Product};
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

/// Description of the script language, for display.
pub const SCRIPT_HELP: &str = "\
A script is text, one fault a line, '#' starts a comment. A line says when, then what:

  frame 120 drop                 the 120th EtherCAT frame (the first is 1) never arrives
  frame 120..125 truncate 30     the replies to these frames are cut after 30 bytes
  every 100 duplicate            every 100th reply comes twice
  chance 0.01 lose               each reply is lost with this probability (seeded)
  1% of frames: lose             the same
  ms 2000 cut 2                  2 s after the start the cable behind slave 2 is pulled

Faults of a frame:
  drop, lose          the request never reaches the slaves; the slaves act, the reply is lost
  delay N             the reply comes N frames later, before that frame's own reply
  duplicate           the reply comes twice
  truncate N          the reply is cut after N bytes
  overlong N          N bytes follow the reply, the EtherCAT header counts them
  index N             N is added to the index of the reply's datagrams
  counter N           N (it may be negative) is added to the working counters of the reply
  type N              the EtherCAT header of the reply has this type
  more                the last datagram of the reply says that another follows
  circulate           the reply's datagrams have the circulating bit
  vlan                the reply carries a VLAN tag
  foreign, reflect    a frame of another protocol, or the request itself, comes before the reply

Faults of the chain:
  stall N             no frame gets through in either direction for N ms
  mute N              no frame that only writes process data gets through for N ms
  cut K, plug K       the cable behind slave K is pulled (0: the master's), or plugged in; in a tree of slaves this
                      is the cable that leads to slave K + 1
  join                all cables are plugged in
  crc K N             the cable behind slave K destroys the next N frames (0: the master's)
  remove K, insert K  slave K is bypassed; it comes back
  swap K KIND         slave K is replaced: ax2000, cia402, akd or ek1100
  recable K L         the slaves K and L change places in the chain, with their motors; their cables lie open for 500 ms
  power K N           slave K is without power for N ms, and with it the chain behind it

Faults of a slave:
  retreat K CODE      slave K falls back to SAFEOP with the error bit and this AL status code
  fall K STATE CODE   it falls back to init, preop or safeop, the same way
  refuse K STATE CODE the next request for init, preop, safeop or op is refused with this code
  pdi K N             the processor of slave K stands still for N ms; its controller works
  sii K WHAT          the information memory: busy, refused, blank, damaged, owned; whole ends it
  silence K N         slave K answers no mailbox message for N ms
  mailbox K STEP WHAT at a mailbox request (its number from now on, or INDEX:SUB of an SDO): abort CODE,
                      silent, lost (only a repeat brings the answer), counter (the answer has the last
                      one's), flood N (N emergencies come before the answer)
  deaf K N            slave K takes no process data for N ms: their working counters tell
  eoe K               slave K sends an Ethernet fragment through its mailbox, unasked
  foe K WHAT          its file server: busy N (N packets are answered 'busy' first), error CODE (for the next
                      message), packet (a wrong packet number in the next answer), silent N (no answer to N messages)
  processor K WHAT N  the processor of slave K takes N ms from now on: boot (its start after power-up),
                      transition (a change of state) or mailbox (an answer)
  processor K sii WORD it reads the information memory on the way to PREOP (needed), or does not (free)
  processor K repeat WORD it gives its last mailbox message again when asked (known), or never (ignored)
  (a slave with device emulation has no processor: only power and sii mean anything to it)

Faults of a drive:
  fault K CODE        drive K faults with this error code
  mains K N           drive K has no main voltage for N ms
  stuck K N           the resolver of drive K freezes for N ms
  slip K P N          it shows only P per cent of the motion for N ms; what it lost stays lost
  jump K N            it slips on its shaft by N increments (it may be negative), for good
  reverse K N         it shows the motion the other way round for N ms
  noise K A N         its positions are wrong by chance, by A increments at most, for N ms
  exchange K L N      the resolvers of the drives K and L are exchanged for N ms
                      (0 ms put a resolver right, and back to where it was mounted)

Slaves count from 1 in the order of the chain; numbers are decimal or 0x hexadecimal. 'every', 'chance' and '%' go
with faults of frames only. A fault of a frame with 'ms' hits the first frame at or after that time.";

/// When a fault happens.
#[derive(Clone, Copy, Debug, PartialEq)]
enum When {
    Frames { first: u64, last: u64 },
    Time { ms: u64 },
    Every { frames: u64 },
    Chance { probability: f64 },
}

/// Why a script was rejected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScriptError {
    /// Line, from 1.
    pub line: usize,
    /// The problem.
    pub reason: ScriptProblem,
    /// The word concerned; empty if a word is missing.
    pub word: String,
}

/// Problem in a line of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScriptProblem {
    /// The line does not start with `frame`, `ms`, `every` or `chance`.
    When,
    /// Unknown fault.
    Fault,
    /// A number is missing, malformed or out of range.
    Number,
    /// Too many words for the fault.
    Surplus,
    /// `every` and `chance` are only allowed for faults of frames.
    Repeated,
    /// No slave with this number in the chain.
    Slave,
    /// No cable with this number in the chain.
    Cable,
}

impl fmt::Display for ScriptError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reason = match self.reason {
            ScriptProblem::When => "expected 'frame', 'ms', 'every', 'chance' or 'N% of frames:'",
            ScriptProblem::Fault => "no such fault",
            ScriptProblem::Number => "a number is missing or out of range",
            ScriptProblem::Surplus => "one word too many",
            ScriptProblem::Slave => "no such slave in this chain",
            ScriptProblem::Cable => "no such cable in this chain",
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
    lines: Vec<usize>,
}

impl Script {
    /// Checks that every slave and cable in the script exists in a chain of `slaves` slaves.
    ///
    /// # Errors
    /// [`ScriptError`] with the line and the number of the first that does not exist.
    pub fn check(&self, slaves: usize) -> Result<(), ScriptError> {
        for (line, (_, fault)) in self.lines.iter().zip(&self.entries) {
            fault.check(slaves).map_err(|(reason, number)| ScriptError {
                line: *line,
                reason,
                word: number.to_string(),
            })?;
        }
        Ok(())
    }
}

impl FromStr for Script {
    type Err = ScriptError;

    fn from_str(text: &str) -> Result<Self, ScriptError> {
        let (mut entries, mut lines) = (Vec::new(), Vec::new());
        for (index, line) in text.lines().enumerate() {
            let content = line.split('#').next().unwrap_or_default();
            let mut words = Words {
                line: index + 1,
                words: content.split_whitespace(),
            };
            if let Some(first) = words.words.next() {
                entries.push(entry(first, &mut words)?);
                lines.push(index + 1);
            }
        }
        Ok(Self { entries, lines })
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

    fn expect(&mut self, expected: &str) -> Result<(), ScriptError> {
        match self.words.next().unwrap_or_default() {
            word if word == expected => Ok(()),
            word => Err(self.error(ScriptProblem::When, word)),
        }
    }

    /// Parses one of a few words.
    fn choice<T: Copy>(&mut self, choices: &[(&str, T)]) -> Result<T, ScriptError> {
        let word = self.words.next().unwrap_or_default();
        let found = choices.iter().find(|(name, _)| *name == word);
        found
            .map(|(_, choice)| *choice)
            .ok_or_else(|| self.error(ScriptProblem::Fault, word))
    }

    fn state(&mut self) -> Result<AlState, ScriptError> {
        self.choice(&[
            ("init", AlState::Init),
            ("preop", AlState::PreOperational),
            ("safeop", AlState::SafeOperational),
            ("op", AlState::Operational),
        ])
    }

    fn mail_step(&mut self) -> Result<MailStep, ScriptError> {
        let word = self.words.next().unwrap_or_default();
        match word.split_once(':') {
            Some((index, sub)) => Ok(MailStep::Object(self.parse_number(index)?, self.parse_number(sub)?)),
            None => match self.parse_number(word)? {
                0 => Err(self.error(ScriptProblem::Number, word)),
                request => Ok(MailStep::Request(request)),
            },
        }
    }

    fn manner(&mut self) -> Result<Manner, ScriptError> {
        Ok(match self.words.next().unwrap_or_default() {
            "boot" => Manner::Boot(self.number()?),
            "transition" => Manner::Transition(self.number()?),
            "mailbox" => Manner::Mailbox(self.number()?),
            "sii" => Manner::ReadsSii(self.choice(&[("needed", true), ("free", false)])?),
            "repeat" => Manner::IgnoresRepeats(self.choice(&[("ignored", true), ("known", false)])?),
            word => return Err(self.error(ScriptProblem::Fault, word)),
        })
    }

    fn file_fault(&mut self) -> Result<FileFault, ScriptError> {
        Ok(match self.words.next().unwrap_or_default() {
            "busy" => FileFault::Busy(self.number()?),
            "error" => FileFault::Error(self.number()?),
            "packet" => FileFault::Packet,
            "silent" => FileFault::Silent(self.number()?),
            word => return Err(self.error(ScriptProblem::Fault, word)),
        })
    }

    fn mail_fault(&mut self) -> Result<MailFault, ScriptError> {
        Ok(match self.words.next().unwrap_or_default() {
            "abort" => MailFault::Abort(self.number()?),
            "silent" => MailFault::Silent,
            "lost" => MailFault::Lost,
            "counter" => MailFault::Counter,
            "flood" => MailFault::Flood(self.number()?),
            word => return Err(self.error(ScriptProblem::Fault, word)),
        })
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
        word => match word.strip_suffix('%').and_then(|number| number.parse::<f64>().ok()) {
            Some(percent) if (0.0..=100.0).contains(&percent) => {
                words.expect("of")?;
                words.expect("frames:")?;
                When::Chance {
                    probability: percent / 100.0,
                }
            }
            _ => return Err(words.error(ScriptProblem::When, word)),
        },
    };
    let name = words.words.next().unwrap_or_default();
    let fault = fault(name, words)?;
    if let Some(word) = words.words.next() {
        return Err(words.error(ScriptProblem::Surplus, word));
    }
    if matches!(when, When::Every { .. } | When::Chance { .. }) && !fault.is_of_frame() {
        return Err(words.error(ScriptProblem::Repeated, name));
    }
    Ok((when, fault))
}

impl FromStr for Fault {
    type Err = ScriptError;

    /// Reads the second half of a script's line, without its time: `stuck 1 200`.
    fn from_str(text: &str) -> Result<Self, ScriptError> {
        let mut words = Words {
            line: 1,
            words: text.split_whitespace(),
        };
        let name = words.words.next().unwrap_or_default();
        let fault = fault(name, &mut words)?;
        match words.words.next() {
            Some(word) => Err(words.error(ScriptProblem::Surplus, word)),
            None => Ok(fault),
        }
    }
}

impl Fault {
    /// Checks that the slave or the cable exists among `slaves` slaves.
    ///
    /// # Errors
    /// What does not exist, and its number.
    pub fn check(self, slaves: usize) -> Result<(), (ScriptProblem, usize)> {
        match (self.slave(), self.cable()) {
            (Some(slave), _) if slave > slaves => Err((ScriptProblem::Slave, slave)),
            (_, Some(cable)) if cable >= slaves => Err((ScriptProblem::Cable, cable)),
            _ => Ok(()),
        }
    }
}

fn fault(name: &str, words: &mut Words) -> Result<Fault, ScriptError> {
    Ok(match name {
        "drop" => Fault::Drop,
        "lose" => Fault::Lose,
        "delay" => Fault::Delay(words.number()?),
        "duplicate" => Fault::Duplicate,
        "truncate" => Fault::Truncate(words.number()?),
        "overlong" => Fault::Overlong(words.number::<u16>()?.min(OVERLONG_BYTES_MAX)),
        "index" => Fault::Index(words.number()?),
        "counter" => Fault::Counter(words.number()?),
        "type" => Fault::Type(words.number::<u8>()? & 0x0F),
        "more" => Fault::More,
        "circulate" => Fault::Circulate,
        "vlan" => Fault::Vlan,
        "foreign" => Fault::Foreign,
        "reflect" => Fault::Reflect,
        "stall" => Fault::Stall(words.number()?),
        "mute" => Fault::Mute(words.number()?),
        "cut" => Fault::Cut(words.number()?),
        "plug" => Fault::Plug(words.number()?),
        "join" => Fault::Join,
        "crc" => Fault::Crc(words.number()?, words.number()?),
        "remove" => Fault::Remove(words.slave()?),
        "insert" => Fault::Insert(words.slave()?),
        "recable" => Fault::Recable(words.slave()?, words.slave()?),
        "deaf" => Fault::Deaf(words.slave()?, words.number()?),
        "swap" => Fault::Swap(words.slave()?, words.choice(&Product::NAMES)?),
        "power" => Fault::Power(words.slave()?, words.number()?),
        "retreat" => Fault::Retreat(words.slave()?, words.number()?),
        "fall" => Fault::Fall(words.slave()?, words.state()?, words.number()?),
        "refuse" => Fault::Refuse(words.slave()?, words.state()?, words.number()?),
        "pdi" => Fault::Processor(words.slave()?, words.number()?),
        "sii" => Fault::Sii(words.slave()?, words.choice(&SII_FAULTS)?),
        "silence" => Fault::Silence(words.slave()?, words.number()?),
        "mailbox" => Fault::Mailbox(words.slave()?, words.mail_step()?, words.mail_fault()?),
        "eoe" => Fault::Ethernet(words.slave()?),
        "foe" => Fault::File(words.slave()?, words.file_fault()?),
        "processor" => Fault::Manner(words.slave()?, words.manner()?),
        "fault" => Fault::Drive(words.slave()?, words.number()?),
        "mains" => Fault::Mains(words.slave()?, words.number()?),
        "stuck" => Fault::Resolver(words.slave()?, ResolverFault::Stuck, words.number()?),
        "slip" => {
            let (slave, percent) = (words.slave()?, words.number()?);
            Fault::Resolver(slave, ResolverFault::Slip(percent), words.number()?)
        }
        "jump" => Fault::Jump(words.slave()?, words.number()?),
        "reverse" => Fault::Resolver(words.slave()?, ResolverFault::Reversed, words.number()?),
        "noise" => {
            let (slave, increments) = (words.slave()?, words.number()?);
            Fault::Resolver(slave, ResolverFault::Noise(increments), words.number()?)
        }
        "exchange" => Fault::Exchange(words.slave()?, words.slave()?, words.number()?),
        word => return Err(words.error(ScriptProblem::Fault, word)),
    })
}

/// Most bytes that can follow a reply.
const OVERLONG_BYTES_MAX: u16 = 2_000;

const SII_FAULTS: [(&str, SiiFault); 6] = [
    ("busy", SiiFault::Busy),
    ("refused", SiiFault::Acknowledge),
    ("blank", SiiFault::Blank),
    ("damaged", SiiFault::Damaged),
    ("owned", SiiFault::Owned),
    ("whole", SiiFault::Whole),
];

/// A running script.
#[derive(Clone, Debug)]
pub(crate) struct Schedule {
    entries: Vec<(When, Fault)>,
    random: Random,
    counts: BTreeMap<&'static str, u64>,
}

impl Schedule {
    pub(crate) fn new(script: &Script, seed: u64) -> Self {
        Self {
            entries: script.entries.clone(),
            random: Random::new(seed),
            counts: BTreeMap::new(),
        }
    }

    /// Injects a fault now: into the next frame, or into the chain at the next millisecond.
    pub(crate) fn inject(&mut self, fault: Fault) {
        self.entries.push((When::Time { ms: 0 }, fault));
    }

    /// Counts a fault that has happened.
    pub(crate) fn count(&mut self, fault: Fault) {
        *self.counts.entry(fault.name()).or_default() += 1;
    }

    /// How often each kind of fault has happened.
    pub(crate) fn counts(&self) -> &BTreeMap<&'static str, u64> {
        &self.counts
    }

    /// The faults of the chain due at this millisecond, once each.
    pub(crate) fn at_time(&mut self, now_ms: u64) -> Vec<Fault> {
        let due = |when: &When, fault: &Fault| match when {
            When::Time { ms } => *ms <= now_ms && !fault.is_of_frame(),
            _ => false,
        };
        self.take(due)
    }

    /// The faults due at the arrival of this frame (from 1), of the frame and of the chain.
    pub(crate) fn at_frame(&mut self, frame: u64, now_ms: u64) -> Vec<Fault> {
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
            ("1% of slaves: drop", 1, ScriptProblem::When, "slaves:"),
            ("101% of frames: drop", 1, ScriptProblem::When, "101%"),
            ("ms 1 sii 2 eaten", 1, ScriptProblem::Fault, "eaten"),
            ("ms 1 mailbox 1 0 silent", 1, ScriptProblem::Number, "0"),
            ("ms 1 refuse 1 boot 3", 1, ScriptProblem::Fault, "boot"),
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

    #[test]
    fn a_slave_or_cable_that_does_not_exist_is_refused_with_its_line() {
        let script: Script = "ms 1 cut 3\n\nms 2 swap 4 ek1100\nms 3 crc 4 1"
            .parse()
            .expect("a script");
        assert_eq!(script.check(5), Ok(()));
        let error = |line, reason, word: &str| ScriptError {
            line,
            reason,
            word: word.to_owned(),
        };
        assert_eq!(script.check(4), Err(error(4, ScriptProblem::Cable, "4")));
        assert_eq!(script.check(3), Err(error(1, ScriptProblem::Cable, "3")));
        let slave: Script = "ms 2 power 4 1".parse().expect("a script");
        assert_eq!(slave.check(3), Err(error(1, ScriptProblem::Slave, "4")));
    }

    #[test]
    fn every_fault_is_in_the_help_and_every_line_of_it_is_understood() {
        for text in [
            "1% of frames: overlong 10",
            "every 2 type 3",
            "frame 1 more",
            "frame 1 circulate",
            "frame 1 vlan",
            "frame 1 reflect",
            "ms 1 crc 0 2",
            "ms 1 plug 0",
            "ms 1 swap 1 cia402",
            "ms 1 fall 1 init 0x1D",
            "ms 1 refuse 1 safeop 0x1D",
            "ms 1 pdi 1 20",
            "ms 1 sii 1 damaged",
            "ms 1 mailbox 1 3 abort 0x06010000",
            "ms 1 mailbox 1 0x6060:0 silent",
            "ms 1 mailbox 1 1 lost",
            "ms 1 mailbox 1 1 counter",
            "ms 1 mailbox 1 1 flood 5",
            "ms 1 eoe 1",
            "ms 1 foe 1 busy 3",
            "ms 1 foe 1 error 0x8003",
            "ms 1 processor 1 boot 500",
            "ms 1 processor 1 sii needed",
            "ms 1 processor 1 repeat ignored",
            "ms 1 stuck 1 20",
            "ms 1 slip 1 90 20",
            "ms 1 jump 1 -2000",
            "ms 1 reverse 1 20",
            "ms 1 noise 1 3000 20",
            "ms 1 exchange 1 2 20",
            "ms 1 recable 1 2",
            "ms 1 mute 20",
            "ms 1 deaf 1 20",
        ] {
            let script: Script = text.parse().expect(text);
            let name = script.entries[0].1.name();
            assert!(
                SCRIPT_HELP.contains(&format!("  {name} ")) || SCRIPT_HELP.contains(&format!(", {name} ")),
                "{name}"
            );
        }
    }
}
