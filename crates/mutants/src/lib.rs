//! Mutation testing: whether the tests and campaigns find errors that somebody put into the firmware.
//!
//! ```text
//! sources --operators--> sites --seed--> 100 mutants --instrument--> copy with all of them --cargo--> tests, etherpen
//!                                                                                                        |
//!                                             results.json <--judge, one mutant switched on at a time----+
//! ```
//!
//! Building takes minutes, so all mutants are compiled at once, each behind a condition; [`switch`] says which one is on.
//!
//! # Layers
//!
//! A module imports modules of lower layers only.
//!
//! 1. `site`, `parts`, `process`, `switch`: a place and its mutant; what is mutated; programs with limits; which mutant is on
//! 2. `operators`, `choice`, `instrument`, `results`, `cargo`: finds places, chooses, writes mutants; what is known; builds
//! 3. `sources`, `judge`, `report`: reads the sources; tests and campaign; the document
//! 4. `copy`: the instrumented copy
//! 5. `run`: everything in its order
//!
//! # Invariants
//!
//! - With no mutant switched on, the copy behaves as the sources do.
//! - One seed chooses the same mutants of the same sources on every computer.
//! - An outcome is kept only while code, tests and campaigns stay the same.
//! - A failure of the computer (a full disk, a program that cannot be started) ends the run; it finds no mutant.
#![forbid(unsafe_code)]

mod cargo;
mod choice;
mod copy;
mod instrument;
mod judge;
mod operators;
mod parts;
mod process;
pub mod report;
pub mod results;
mod run;
mod site;
mod sources;
pub mod switch;

pub use run::{Options, run};
pub use site::Operator;
