//! An episode: the machine, what its operator wants, and what happens meanwhile; a test-case file.
//!
//! Everything that decides an episode is in [`Episode`], so that the same value always gives the same run, and a file is
//! enough to repeat it.

use super::machine::{DEFAULT_MACHINE, Machine};
use crate::error::{ProgramError, code};
use etherpen::config::Config;
use etherpen::messages::{Command, PathVertex};
use etherpen::motion::Pen;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use toml::Value;

/// An episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Episode {
    /// What the episode found when its file was written; text for people.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub found: String,
    /// The machine: a bundled one, or a configuration file.
    #[serde(default = "default_machine")]
    pub machine: String,
    /// Seed of everything that is left to chance in the run: the cell, and the line's noise.
    pub seed: u64,
    /// Time from power-up until all faults are ended, ms.
    pub duration_ms: u32,
    /// Pause of the operator between two decisions, ms.
    pub patience_ms: u32,
    /// Whether the drives are expected to follow well enough to draw: the last drawing has to come out right.
    pub draws: bool,
    /// Wishes of the operator, carried out one after the other, again and again.
    #[serde(default)]
    pub wishes: Vec<Wish>,
    /// Whether the drawings are drawn by the program's own jobs with their log, one after the other, and not by an operator
    /// with wishes.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub by_jobs: bool,
    /// Drawings that wishes refer to.
    #[serde(default)]
    pub figures: Vec<Figure>,
    /// Values of the configuration that differ from the machine's, by their place, for example `motion.speed_mm_s` or
    /// `axes.2.gear`.
    #[serde(default)]
    pub config: BTreeMap<String, Value>,
    /// What happens, in the order of time.
    #[serde(default)]
    pub events: Vec<Event>,
}

fn default_machine() -> String {
    DEFAULT_MACHINE.to_owned()
}

/// Something that happens at a time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// Milliseconds since power-up.
    pub at_ms: u32,
    /// What.
    pub what: What,
}

/// What happens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum What {
    /// A fault of the segment, in the words of its script.
    Fault(String),
    /// A fault of this many frames in a row, in the words of the segment's script.
    Frames(String, u32),
    /// A command of the operator over the connection.
    Command(Command),
    /// A command beside the connection: all of one millisecond arrive together.
    Beside(Command),
    /// The slave, from 0, is asked to go to an AL state: 1, 2, 3 (BOOT), 4 or 8.
    State(u8, u8),
    /// A file of the slave, from 0, is opened, a piece of it is written or read, and it is closed or left open.
    File(u8, FileUse),
    /// The operator's program ends and another one connects.
    Reconnect,
    /// The serial line carries nothing for some milliseconds.
    Unplug(u32),
    /// The serial line damages or loses this many of a thousand bytes, for some milliseconds.
    Noise(u32, u32),
    /// The emergency-stop input is open for some milliseconds.
    StopInput(u32),
    /// The board runs on its substitute clock for some milliseconds.
    SubstituteClock(u32),
    /// The trajectory task does not run for some milliseconds.
    TrajectoryWaits(u32),
    /// The Ethernet port reports no link for some milliseconds.
    PortDown(u32),
    /// A mishap of the program that draws; only where its jobs do.
    Program(Mishap),
}

/// A mishap of the program that draws, of its computer, or of the newest entry of its log. Places in the entry are thousandths
/// of its length.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Mishap {
    /// The program is killed; another one is started after some milliseconds.
    Killed(u32),
    /// It is killed when the next entry is written up to a place; another one is started after some milliseconds.
    KilledWriting(u32, u32),
    /// The computer loses its supply, and the disk what was not synced; another program is started after some milliseconds.
    PowerCut(u32),
    /// The program does not run for some milliseconds.
    Stands(u32),
    /// The entry ends at a place.
    Cut(u32),
    /// The byte at a place has other bits.
    Changed(u32, u8),
    /// The entry has zeros from a place on.
    Zeroed(u32),
    /// The log is removed.
    Removed,
    /// The disk with the log is away for some milliseconds.
    Away(u32),
}

/// How a file is used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileUse {
    /// Whether the slave is brought to BOOT first.
    pub bootstrap: bool,
    /// Whether the file is written; otherwise it is read.
    pub writes: bool,
    /// Whether the file is closed at the end.
    pub closes: bool,
}

/// A wish of the operator, carried out when the robot is enabled and at rest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Wish {
    /// Draw a figure.
    Draw(usize),
    /// Move to a position in the robot's frame, mm.
    Move([f64; 3]),
    /// Jog with a velocity, mm/s, for some milliseconds.
    Jog([f32; 3], u32),
    /// Lower the pen, and lift it again.
    Pen,
    /// Switch the power off.
    Disable,
    /// Change the override, percent.
    Override(u8),
    /// Give several commands in one millisecond. Homing is done at the pose that the operator measures.
    AtOnce(Vec<Command>),
}

/// A drawing: strokes of points, micrometres in the robot's x and y.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Figure(pub Vec<Vec<[i32; 2]>>);

impl Figure {
    /// The path: to the first point of each stroke with the pen up, then along its points, then up.
    #[must_use]
    pub fn path(&self, config: &Config) -> Vec<PathVertex> {
        let (down, lift_mm) = (config.paper.plane(), config.paper.pen_lift_mm);
        let z_um = |[x_um, y_um]: [i32; 2], lift_mm: f64| {
            let [x_mm, y_mm] = [x_um, y_um].map(|um| f64::from(um) * 1e-3);
            ((down.z_at_mm(x_mm, y_mm) + lift_mm) * 1e3).round() as i32
        };
        let mut path = Vec::new();
        for (stroke, points) in (0u32..).zip(&self.0) {
            let mut go = |at: [i32; 2], lift_mm: f64, pen: Pen| {
                let [x_um, y_um] = at;
                path.push(PathVertex {
                    position_um: [x_um, y_um, z_um(at, lift_mm)],
                    pen,
                    stroke,
                });
            };
            let (Some(first), Some(last)) = (points.first(), points.last()) else {
                continue;
            };
            go(*first, lift_mm, Pen::Up);
            go(*first, 0.0, Pen::Up);
            points.iter().skip(1).for_each(|point| go(*point, 0.0, Pen::Down));
            go(*last, lift_mm, Pen::Up);
        }
        path
    }
}

impl Episode {
    /// The configuration.
    ///
    /// # Errors
    /// The machine does not exist; a value has no place, has another type, or is out of its bounds.
    pub fn configuration(&self) -> Result<Config, String> {
        let machine = Machine::load(&self.machine)?;
        let mut table = Value::try_from(machine.config).map_err(|cause| cause.to_string())?;
        for (place, value) in &self.config {
            // A value that the machine leaves out, as its home switch, is added; whether there is such a value is asked below.
            let found = place.split('.').try_fold(&mut table, |within, name| match within {
                Value::Array(items) => items.get_mut(name.parse::<usize>().ok()?),
                Value::Table(items) => Some(items.entry(name).or_insert_with(|| value.clone())),
                _ => None,
            });
            *found.ok_or_else(|| format!("the configuration has no value {place}"))? = value.clone();
        }
        let config: Config = table.try_into().map_err(|cause: toml::de::Error| cause.to_string())?;
        config
            .check()
            .map_err(|cause| crate::link::text::config_error(&cause))?;
        config.check_io().map_err(|cause| crate::link::text::io_error(&cause))?;
        Ok(config)
    }

    /// Reads an episode from the text of a test-case file.
    ///
    /// # Errors
    /// The place in the text that cannot be used.
    pub fn parse(text: &str) -> Result<Self, String> {
        let episode: Self = toml::from_str(text).map_err(|cause| cause.to_string())?;
        episode.configuration()?;
        for event in &episode.events {
            if let What::Fault(words) | What::Frames(words, _) = &event.what {
                words
                    .parse::<crate::cell::Fault>()
                    .map_err(|cause| format!("'{words}': {cause}"))?;
            }
        }
        Ok(episode)
    }

    /// Reads a test-case file.
    ///
    /// # Errors
    /// The file cannot be read, or it is not a test case.
    pub fn read(path: &Path) -> Result<Self, ProgramError> {
        let wrong = |cause: String| ProgramError::new(code::INPUT, format!("{}: {cause}", path.display()));
        let text = std::fs::read_to_string(path).map_err(|cause| wrong(format!("it cannot be read: {cause}")))?;
        Self::parse(&text).map_err(wrong)
    }

    /// The text of the test-case file.
    #[must_use]
    pub fn to_text(&self) -> String {
        toml::to_string(self).unwrap_or_else(|cause| format!("# not written: {cause}\n"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::generate::{Profile, episode};

    fn of_the_default(seed: u64) -> Episode {
        let machine = Machine::load(DEFAULT_MACHINE).expect("a bundled machine");
        episode(&machine, seed, Profile::All)
    }

    #[test]
    fn a_file_gives_the_same_episode_again() {
        for seed in 0..200 {
            let written = of_the_default(seed);
            let read = Episode::parse(&written.to_text()).unwrap_or_else(|cause| panic!("seed {seed}: {cause}"));
            assert_eq!(read, written, "seed {seed}");
        }
    }

    #[test]
    fn a_place_that_does_not_exist_is_named() {
        let mut wrong = of_the_default(1);
        wrong.config.insert("axes.9.gear".to_owned(), Value::Float(1.0));
        assert_eq!(
            wrong.configuration().unwrap_err(),
            "the configuration has no value axes.9.gear"
        );
    }

    #[test]
    fn words_that_are_no_fault_are_named() {
        let mut wrong = of_the_default(1);
        wrong.events.push(Event {
            at_ms: 1,
            what: What::Fault("explode 3".to_owned()),
        });
        assert!(Episode::parse(&wrong.to_text()).unwrap_err().starts_with("'explode 3'"));
    }
}
