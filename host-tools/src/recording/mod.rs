//! Recordings: all data from the firmware in one MCAP file, and their evaluation.
//!
//! [`Recorder`] writes, [`Playback`] reads; [`export`], [`plot`] and [`statistics`] process the samples of a playback
//! one after the other. Foxglove and PlotJuggler open these files too: the file contains the schemas, and the names of
//! the signals contain the units.
//!
//! Invariant: memory does not depend on the length of a recording, except for the recorder's table of chunks, with one
//! entry for each second: `etherpen bench recording --hours 24` measures 2.7 MB.

mod bytes;
mod cdr;
pub mod export;
pub mod file;
pub mod mcap;
pub mod messages;
pub mod moment;
pub mod parquet;
pub mod playback;
pub mod plot;
pub mod recorder;
pub mod signals;
pub mod statistics;

pub use playback::{Playback, RecordingEntry};
pub use recorder::{About, Recorder, Storage};
