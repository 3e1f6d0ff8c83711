#![doc = include_str!("../README.md")]
//!
//! # Layers
//!
//! A module imports modules of lower layers only.
//!
//! 1. `bits`, `random`, `oscillator`, `registers`, `capture`, `transport`, `application`: what every module may use;
//!    pcapng files; networks; states of a slave
//! 2. `mailbox`, `rig`: messages, objects and mapped process data of a slave; hand-made frames
//! 3. `eeprom`: the information memory
//! 4. `controller`, `drive`: the slave controller; the servo drive with its motor
//! 5. `devices`, `load`: what is behind a slave controller; what the motors turn
//! 6. `faults`: the language of scripted faults
//! 7. `slave`: one slave
//! 8. `wiring`: cables between slaves, and the way of a frame
//! 9. `chain`, `list`: slaves and frames; chains as text
//! 10. `segment`: the chain in virtual time, with its load
//! 11. `control`: commands to a running segment, as text
#![forbid(unsafe_code)]

mod application;
mod bits;
pub mod capture;
mod chain;
pub mod control;
mod controller;
mod devices;
mod drive;
mod eeprom;
mod faults;
mod list;
mod load;
mod mailbox;
mod oscillator;
pub mod random;
mod registers;
pub mod rig;
mod segment;
mod slave;
pub mod transport;
mod wiring;

pub use application::AlState;
pub use controller::silicon::{ClockWidth, ControllerType};
pub use devices::ax2000::NAME as AX2000_NAME;
pub use devices::kind::SlaveKind;
pub use drive::homing::Switches;
pub use drive::resolver::{ResolverError, ResolverFault};
pub use drive::velocity_loop::{LOOP_STEP_S, LOOP_STEPS, PiLoop, VelocityLoop};
pub use drive::{DriveOptions, DriveState, OneTurn};
pub use eeprom::SiiFault;
pub use eeprom::esi::{EsiDevice, EsiError};
pub use faults::kinds::{Fault, MailFault, MailStep, Manner, Product};
pub use faults::{SCRIPT_HELP, Script, ScriptError, ScriptProblem};
pub use list::{SLAVES_MAX, SlaveList, SlaveListError, parse_slaves};
pub use load::{Flywheel, Load, STEP_S, Shaft};
pub use mailbox::foe::FileFault;
pub use mailbox::process_data::DataManagers;
pub use oscillator::Oscillator;
pub use segment::{CATCH_UP_MS_MAX, ClockOptions, MotorState, Segment, SegmentOptions, SlaveState};
pub use slave::options::{PlaceOptions, SlaveOptions};
pub use wiring::Branch;
