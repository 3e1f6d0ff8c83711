//! The etherpen program's parts: drawing tools, virtual cell, emulator and reports.
#![forbid(unsafe_code)]

pub mod cell;
pub mod drawing;
pub mod emulator;
pub mod link;
