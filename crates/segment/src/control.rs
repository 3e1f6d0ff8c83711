//! Commands to a running segment, as text.
//!
//! A line is one command, described in [`COMMAND_HELP`]. [`Names`] knows what the slaves are called and turns a line
//! into a [`Command`]; what carries it out is the caller's.
//!
//! Invariant: no line causes a panic, and a command names slaves that exist.

use crate::devices::kind::SlaveKind;
use crate::faults::ScriptError;
use crate::faults::kinds::Fault;
use crate::list::SlaveList;
use std::fmt;

/// Description of the commands, for display.
pub const COMMAND_HELP: &str = "\
Commands to a running segment, one a line, at its prompt or through its control socket:

  list                the slaves: number, name, kind, state, ports, inputs, outputs; faults so far
  get SLAVE           inputs and outputs of a slave as hexadecimal bytes, or the state of a drive
  get SLAVE.BIT       one input, or one output of a slave that has outputs only; bits count from 1
  get SLAVE.BIT:N     N bits from BIT on as a number
  get SLAVE.out.BIT   an output of a slave that has both (in: an input)
  set SLAVE BYTES     sets the first inputs: pairs of hexadecimal digits, the first byte first
  set SLAVE.BIT V     sets one input to 0 or 1
  set SLAVE.BIT:N V   sets N inputs to a number, decimal (it may be negative) or 0x hexadecimal
  unplug SLAVE        pulls the cable that leads to a slave, and with it what is behind
  plug SLAVE          plugs that cable in
  fault WORDS         any fault of the script language, at once: fault power 3 500; --help lists them
  help                this text
  quit                ends the segment

SLAVE is a number from 1 in the order of the chain, a name from the list of slaves (@name=NAME), or the word of a kind
of which there is one. In a fault, a name stands for the number. The time of the segment stands still while its process
does not run.";

/// Which process data of a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// What the master reads.
    Inputs,
    /// What the master writes.
    Outputs,
}

/// Some bits of a slave's process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bits {
    /// The side; `None` for the inputs if there are any, else for the outputs.
    pub side: Option<Side>,
    /// First bit, from 0.
    pub first: usize,
    /// Number of bits, 1 to 64.
    pub count: usize,
}

/// New inputs of a slave.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Inputs {
    /// The first bytes.
    Bytes(Vec<u8>),
    /// Some bits, from 0, as a number of this many bits.
    Bits {
        /// First bit.
        first: usize,
        /// Number of bits, 1 to 64.
        count: usize,
        /// The number.
        value: u64,
    },
}

/// A command. Slaves count from 1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Asks for the commands.
    Help,
    /// Asks for the state of everything.
    List,
    /// Asks for the process data of a slave.
    Get {
        /// The slave.
        slave: usize,
        /// The bits; `None` for everything.
        bits: Option<Bits>,
    },
    /// Sets inputs of a slave.
    Set {
        /// The slave.
        slave: usize,
        /// The inputs.
        inputs: Inputs,
    },
    /// Pulls the cable that leads to a slave, or plugs it in.
    Cable {
        /// The slave.
        slave: usize,
        /// Whether the cable is plugged in.
        plugged: bool,
    },
    /// Injects a fault.
    Fault(Fault),
    /// Ends the segment.
    Quit,
}

/// Why a line is no command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CommandError {
    /// There is no such command.
    Unknown {
        /// The word.
        word: String,
    },
    /// No slave has this name or number, or several are of this kind.
    Slave {
        /// The word.
        word: String,
    },
    /// Malformed bits of a slave.
    Bits {
        /// The word.
        word: String,
    },
    /// The value is missing, malformed or does not fit its bits.
    Value {
        /// The word.
        word: String,
    },
    /// Outputs are written by the master only.
    Output {
        /// The word.
        word: String,
    },
    /// One word too many.
    Surplus {
        /// The word.
        word: String,
    },
    /// Not a fault of the script language.
    Fault {
        /// What is wrong.
        error: ScriptError,
    },
}

impl fmt::Display for CommandError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown { word } => write!(
                formatter,
                "no such command: '{word}' (list, get, set, unplug, plug, fault, help or quit)"
            ),
            Self::Slave { word } => write!(
                formatter,
                "no such slave: '{word}' (a number from 1, a name, or a kind of which there is one)"
            ),
            Self::Bits { word } => write!(
                formatter,
                "no such bits: '{word}' (SLAVE.BIT or SLAVE.BIT:N, BIT from 1, N to 64)"
            ),
            Self::Value { word } => write!(formatter, "not a value that fits: '{word}'"),
            Self::Output { word } => write!(formatter, "'{word}' is an output: the master sets it"),
            Self::Surplus { word } => write!(formatter, "one word too many: '{word}'"),
            Self::Fault { error } => {
                let text = error.to_string();
                formatter.write_str(text.split_once(": ").map_or(text.as_str(), |(_, reason)| reason))
            }
        }
    }
}

impl std::error::Error for CommandError {}

/// What the slaves of a segment are called.
#[derive(Clone, Debug, Default)]
pub struct Names {
    kinds: Vec<SlaveKind>,
    names: Vec<String>,
}

impl Names {
    /// The slaves of a list.
    #[must_use]
    pub fn new(list: &SlaveList) -> Self {
        Self {
            kinds: list.slaves.clone(),
            names: list.names.clone(),
        }
    }

    /// The kind of a slave, from 1.
    #[must_use]
    pub fn kind(&self, slave: usize) -> Option<&SlaveKind> {
        self.kinds.get(slave.checked_sub(1)?)
    }

    /// The name of a slave, from 1, if it has one.
    #[must_use]
    pub fn name(&self, slave: usize) -> Option<&str> {
        let name = self.names.get(slave.checked_sub(1)?)?;
        (!name.is_empty()).then_some(name)
    }

    /// The slave, from 1, that a word means.
    ///
    /// # Errors
    /// [`CommandError::Slave`].
    pub fn slave(&self, word: &str) -> Result<usize, CommandError> {
        let number = word
            .parse()
            .ok()
            .filter(|number| (1..=self.kinds.len()).contains(number));
        let mut of_kind = (1..).zip(&self.kinds).filter(|(_, kind)| kind.name() == word);
        let only = of_kind
            .next()
            .filter(|_| of_kind.next().is_none())
            .map(|(slave, _)| slave);
        let found = number.or_else(|| self.named(word)).or(only);
        found.ok_or_else(|| CommandError::Slave { word: word.to_owned() })
    }

    fn named(&self, word: &str) -> Option<usize> {
        let mut named = (1..).zip(&self.names).filter(|(_, name)| !name.is_empty());
        named.find(|(_, name)| *name == word).map(|(slave, _)| slave)
    }

    /// Reads a command; `None` for an empty line or a comment behind `#`.
    ///
    /// # Errors
    /// [`CommandError`] with the word that was rejected.
    pub fn command(&self, line: &str) -> Result<Option<Command>, CommandError> {
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_whitespace();
        let Some(first) = words.next() else {
            return Ok(None);
        };
        let command = match first {
            "help" | "?" => Command::Help,
            "list" => Command::List,
            "quit" | "exit" => Command::Quit,
            "get" => {
                let (slave, bits) = self.target(words.next().unwrap_or_default())?;
                Command::Get { slave, bits }
            }
            "set" => self.set(words.next().unwrap_or_default(), words.next().unwrap_or_default())?,
            "plug" | "unplug" => Command::Cable {
                slave: self.slave(words.next().unwrap_or_default())?,
                plugged: first == "plug",
            },
            "fault" => return self.fault(words).map(|fault| Some(Command::Fault(fault))),
            word => return Err(CommandError::Unknown { word: word.to_owned() }),
        };
        match words.next() {
            Some(word) => Err(CommandError::Surplus { word: word.to_owned() }),
            None => Ok(Some(command)),
        }
    }

    fn fault<'a>(&self, words: impl Iterator<Item = &'a str>) -> Result<Fault, CommandError> {
        let words = words.map(|word| match self.named(word) {
            Some(slave) => slave.to_string(),
            None => word.to_owned(),
        });
        let text = words.collect::<Vec<_>>().join(" ");
        let fault: Fault = text.parse().map_err(|error| CommandError::Fault { error })?;
        fault
            .check(self.kinds.len())
            .map_err(|(reason, number)| CommandError::Fault {
                error: ScriptError {
                    line: 1,
                    reason,
                    word: number.to_string(),
                },
            })?;
        Ok(fault)
    }

    /// A slave and its bits: `SLAVE`, `SLAVE.BIT`, `SLAVE.BIT:N`, with `.in` or `.out` behind the slave.
    fn target(&self, word: &str) -> Result<(usize, Option<Bits>), CommandError> {
        let wrong = || CommandError::Bits { word: word.to_owned() };
        let mut parts = word.split('.');
        let slave = self.slave(parts.next().unwrap_or_default())?;
        let mut part = parts.next();
        let side = match part {
            Some("in") => Some(Side::Inputs),
            Some("out") => Some(Side::Outputs),
            _ => None,
        };
        if side.is_some() {
            part = parts.next();
        }
        let Some(text) = part else {
            return if side.is_some() {
                Err(wrong())
            } else {
                Ok((slave, None))
            };
        };
        let (first, count) = text.split_once(':').unwrap_or((text, "1"));
        let first = first.parse::<u16>().ok().and_then(|first| first.checked_sub(1));
        let count = count.parse::<usize>().ok().filter(|count| (1..=64).contains(count));
        let (Some(first), Some(count), None) = (first, count, parts.next()) else {
            return Err(wrong());
        };
        let first = first.into();
        Ok((slave, Some(Bits { side, first, count })))
    }

    fn set(&self, target: &str, value: &str) -> Result<Command, CommandError> {
        let (slave, bits) = self.target(target)?;
        let wrong = || CommandError::Value { word: value.to_owned() };
        let inputs = match bits {
            None => Inputs::Bytes(bytes(value).ok_or_else(wrong)?),
            Some(Bits {
                side: Some(Side::Outputs),
                ..
            }) => {
                return Err(CommandError::Output {
                    word: target.to_owned(),
                });
            }
            Some(Bits { first, count, .. }) => Inputs::Bits {
                first,
                count,
                value: fitting(value, count).ok_or_else(wrong)?,
            },
        };
        Ok(Command::Set { slave, inputs })
    }
}

/// Pairs of hexadecimal digits.
fn bytes(text: &str) -> Option<Vec<u8>> {
    let digits = text.strip_prefix("0x").unwrap_or(text).as_bytes();
    let pairs = digits.chunks(2).map(|pair| {
        let pair = std::str::from_utf8(pair).ok().filter(|pair| pair.len() == 2)?;
        u8::from_str_radix(pair, 16).ok()
    });
    (!digits.is_empty()).then(|| pairs.collect()).flatten()
}

/// A number in this many bits, 1 to 64; a negative one as its two's complement.
fn fitting(text: &str, count: usize) -> Option<u64> {
    let number = match text.strip_prefix("0x") {
        Some(digits) => i128::from(u64::from_str_radix(digits, 16).ok()?),
        None => text.parse().ok()?,
    };
    let lowest = -(1i128 << (count - 1));
    let mask = u64::MAX >> (64 - count);
    (lowest..=i128::from(mask))
        .contains(&number)
        .then_some(number as u64 & mask)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> Names {
        let list: SlaveList = "ek1100,el1008@name=door,el2004,cia402*2".parse().expect("a list");
        Names::new(&list)
    }

    fn command(line: &str) -> Command {
        names().command(line).expect(line).expect("a command")
    }

    #[test]
    fn slaves_have_numbers_names_and_kinds() {
        let names = names();
        for (word, slave) in [("1", 1), ("door", 2), ("el1008", 2), ("el2004", 3), ("5", 5)] {
            assert_eq!(names.slave(word), Ok(slave), "{word}");
        }
        for word in ["0", "6", "cia402", "gate", "", "-1"] {
            assert!(names.slave(word).is_err(), "{word}");
        }
    }

    #[test]
    fn commands_are_understood() {
        let bits = |side, first, count| Some(Bits { side, first, count });
        assert_eq!(command("get door"), Command::Get { slave: 2, bits: None });
        assert_eq!(
            command("get el2004.3"),
            Command::Get {
                slave: 3,
                bits: bits(None, 2, 1)
            }
        );
        assert_eq!(
            command("get 5.out.17:32 # target"),
            Command::Get {
                slave: 5,
                bits: bits(Some(Side::Outputs), 16, 32)
            }
        );
        let set = |inputs| Command::Set { slave: 2, inputs };
        assert_eq!(command("set door 0x0aFF"), set(Inputs::Bytes(vec![10, 255])));
        let value = |first, count, value| Inputs::Bits { first, count, value };
        assert_eq!(command("set door.1 1"), set(value(0, 1, 1)));
        assert_eq!(command("set door.in.3:16 -2"), set(value(2, 16, 0xFFFE)));
        assert_eq!(command("set door.1:64 0xFFFFFFFFFFFFFFFF"), set(value(0, 64, u64::MAX)));
        let cable = |plugged| Command::Cable { slave: 2, plugged };
        assert_eq!((command("plug door"), command("unplug 2")), (cable(true), cable(false)));
        assert_eq!(command("fault power door 500"), Command::Fault(Fault::Power(2, 500)));
        assert_eq!(names().command("  # nothing"), Ok(None));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let reason = |line: &str| names().command(line).expect_err(line).to_string();
        for (line, part) in [
            ("gte door", "'gte'"),
            ("get", "no such slave"),
            ("get door.0", "'door.0'"),
            ("get door.1:65", "'door.1:65'"),
            ("get door.out", "'door.out'"),
            ("get door.1.2", "'door.1.2'"),
            ("get door now", "'now'"),
            ("set door.1 2", "'2'"),
            ("set door", "not a value"),
            ("set door 123", "'123'"),
            ("set door.1:8 -129", "'-129'"),
            ("set el2004.out.1 1", "the master sets it"),
            ("plug 9", "'9'"),
            ("fault power 9 1", "no such slave in this chain: '9'"),
            ("fault explode", "no such fault: 'explode'"),
            ("fault cut 5", "no such cable"),
        ] {
            assert!(reason(line).contains(part), "{line}: {}", reason(line));
        }
    }

    #[test]
    fn every_command_is_in_the_help() {
        for word in ["list", "get", "set", "unplug", "plug", "fault", "help", "quit"] {
            assert!(COMMAND_HELP.contains(&format!("\n  {word} ")), "{word}");
        }
    }

    #[test]
    fn no_line_breaks_it() {
        let seed = 3;
        println!("seed {seed}");
        let mut random = crate::random::Random::new(seed);
        let words = [
            "get",
            "set",
            "fault",
            "door",
            "door.",
            ".",
            ".in",
            "1",
            "2.0",
            ":",
            "-",
            "0x",
            "é",
            "power",
            "plug",
            "5.1:64",
            "99999999999999999999",
            "cut",
            "list",
        ];
        for _ in 0..20_000 {
            let line: Vec<&str> = (0..random.bits() % 5)
                .map(|_| words[(random.bits() % words.len() as u64) as usize])
                .collect();
            let separator = [" ", "", "."][(random.bits() % 3) as usize];
            let _ = names()
                .command(&line.join(separator))
                .map_err(|error| error.to_string());
        }
    }
}
