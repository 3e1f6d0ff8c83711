//! What the firmware did to the chip in a run of `run.py`, line by line.

use host_tools::setup;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

/// One line of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// A reset and its cause.
    Reset(String),
    /// A write to a register.
    Write(String, u32),
    /// Last value read of a register since the previous write.
    Read(String, u32),
    /// The chip did not take the write.
    Ignored(String),
    /// What went out on the serial line.
    Serial(Vec<u8>),
    /// A command to the PHY.
    Phy(String),
    /// A sent Ethernet frame.
    Frame(Vec<u8>),
    /// The core went to sleep.
    Wfi,
}

/// A run of the image.
#[derive(Debug)]
pub(crate) struct Run {
    pub(crate) events: Vec<Event>,
    /// Registers that are not as after a reset.
    pub(crate) finals: BTreeMap<String, u32>,
    /// Why it ended.
    pub(crate) end: String,
}

impl Run {
    /// The events up to the first sleep.
    pub(crate) fn start_up(&self) -> &[Event] {
        let asleep = self.events.iter().position(|event| *event == Event::Wfi);
        &self.events[..asleep.map_or(self.events.len(), |asleep| asleep + 1)]
    }

    /// All that went out on the serial line, as text.
    pub(crate) fn text(&self) -> String {
        String::from_utf8_lossy(&self.serial()).into_owned()
    }

    /// All that went out on the serial line.
    pub(crate) fn serial(&self) -> Vec<u8> {
        let bytes = self.events.iter().filter_map(|event| match event {
            Event::Serial(bytes) => Some(bytes.as_slice()),
            _ => None,
        });
        bytes.flatten().copied().collect()
    }

    /// Causes of the resets, the power-on first.
    pub(crate) fn resets(&self) -> Vec<&str> {
        let causes = self.events.iter().filter_map(|event| match event {
            Event::Reset(cause) => Some(cause.as_str()),
            _ => None,
        });
        causes.collect()
    }

    pub(crate) fn frames(&self) -> impl Iterator<Item = &[u8]> {
        self.events.iter().filter_map(|event| match event {
            Event::Frame(frame) => Some(frame.as_slice()),
            _ => None,
        })
    }
}

/// The program's Python and the image; prints a note and returns `None` if unicorn cannot be installed.
fn prepared() -> Option<&'static (std::path::PathBuf, std::path::PathBuf)> {
    static PREPARED: OnceLock<Option<(std::path::PathBuf, std::path::PathBuf)>> = OnceLock::new();
    let prepared = PREPARED.get_or_init(|| match setup::ensure_unicorn() {
        Ok(python) => Some((python, setup::build_firmware("nucleo").expect("the firmware is built"))),
        Err(missing) => {
            println!("SKIPPED: the start-up was not run. {missing}");
            None
        }
    });
    prepared.as_ref()
}

/// The shipped image.
pub(crate) fn image() -> Option<&'static Path> {
    prepared().map(|(_, image)| image.as_path())
}

/// Virtual time in which the tasks run some periods, as an option of [`run`].
pub(crate) const TASKS_RUN: [&str; 2] = ["--until-ms", "60"];

/// An undisturbed run into the tasks' periods; made once for all tests.
pub(crate) fn run_of_tasks() -> Option<&'static Run> {
    static RUN: OnceLock<Option<Run>> = OnceLock::new();
    RUN.get_or_init(|| run(&TASKS_RUN)).as_ref()
}

/// Runs the shipped image with options of `run.py`; `None` if unicorn cannot be installed.
pub(crate) fn run(options: &[&str]) -> Option<Run> {
    let (python, image) = prepared()?;
    let program = setup::workspace().join("tests/startup/run.py");
    let mut command = Command::new(python);
    // `-B` leaves no byte code among the sources.
    command.arg("-B").arg(program).arg(image).args(options);
    let output = command.output().expect("Python starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "run.py {options:?}: {said}");
    Some(parse(&String::from_utf8_lossy(&output.stdout)))
}

fn parse(text: &str) -> Run {
    let mut run = Run {
        events: Vec::new(),
        finals: BTreeMap::new(),
        end: String::new(),
    };
    for line in text.lines() {
        let (kind, rest) = line.split_once(' ').unwrap_or((line, ""));
        let register = || {
            let (name, value) = rest.split_once(' ').expect("a register has a value");
            let value = value.trim_start_matches("0x");
            (name.to_owned(), u32::from_str_radix(value, 16).expect("a number"))
        };
        match kind {
            "reset" => run.events.push(Event::Reset(rest.to_owned())),
            "write" => run.events.push(Event::Write(register().0, register().1)),
            "read" => run.events.push(Event::Read(register().0, register().1)),
            "ignored" => run.events.push(Event::Ignored(rest.to_owned())),
            "serial" => run.events.push(Event::Serial(bytes(rest))),
            "phy" => run.events.push(Event::Phy(rest.to_owned())),
            "frame" => run.events.push(Event::Frame(bytes(rest))),
            "wfi" => run.events.push(Event::Wfi),
            "final" => drop(run.finals.insert(register().0, register().1)),
            "end" => run.end = rest.to_owned(),
            other => panic!("unknown line: {other}"),
        }
    }
    assert!(!run.end.is_empty(), "the run has an end");
    run
}

fn bytes(hexadecimal: &str) -> Vec<u8> {
    let digits: Vec<u32> = hexadecimal
        .chars()
        .map(|digit| digit.to_digit(16).expect("a digit"))
        .collect();
    digits
        .chunks_exact(2)
        .map(|pair| (pair[0] * 16 + pair[1]) as u8)
        .collect()
}
