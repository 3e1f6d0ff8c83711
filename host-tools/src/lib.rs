//! The etherpen program's parts: drawing tools, virtual cell, emulator and reports.
#![forbid(unsafe_code)]

pub mod bench;
pub mod captured_cell;
pub mod cell;
pub mod commands;
pub mod console;
pub mod drawing;
pub mod emulator;
pub mod error;
pub mod firmware_image;
pub mod hash;
pub mod identification;
pub mod job;
pub mod link;
pub mod machine;
pub mod master;
pub mod matching;
pub mod output_file;
pub mod planning;
pub mod probe;
pub mod random;
pub mod recording;
pub mod report;
pub mod run;
pub mod settings;
pub mod setup;
pub mod simulation;
pub mod terminal;
pub mod transport;
