//! The etherpen program's parts: drawing tools, virtual cell, emulator and reports.
#![forbid(unsafe_code)]

pub mod bench;
pub mod captured_cell;
pub mod cell;
pub mod commands;
pub mod console;
pub mod drawing;
pub mod emulator;
pub mod history;
pub mod identification;
pub mod image;
pub mod link;
pub mod machine;
pub mod master;
pub mod matching;
pub mod output_file;
pub mod planning;
pub mod probe;
pub mod recording;
pub mod report;
pub mod run;
pub mod settings;
pub mod setup;
pub mod simulation;
pub mod transport;
