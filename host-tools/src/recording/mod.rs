//! Recordings: everything the firmware sends, in one MCAP file, and what can be made of it.
//!
//! [`Recorder`] writes, [`Playback`] reads; [`export`], [`plot`] and [`statistics`] are made of what a playback gives, one
//! sample after the other. Foxglove and PlotJuggler open the same files: the schemas are in them, and units are in the
//! names of the signals.
//!
//! Invariant: memory does not depend on how long a recording is, but for the recorder's table of chunks, one for each second:
//! `etherpen bench recording --hours 24` measures 2.7 MB.

mod bytes;
pub mod export;
pub mod mcap;
pub mod messages;
pub mod parquet;
pub mod playback;
pub mod plot;
pub mod recorder;
pub mod signals;
pub mod statistics;

pub use playback::{Entry, Playback};
pub use recorder::{About, Recorder, Storage};
