//! The etherpen program's parts: drawing tools, virtual cell, emulator and reports.
//!
//! # Layers
//!
//! A module imports modules of lower layers only; the test of [`layers`] reads this list and the sources.
//!
//! 1. `error`, `hash`, `random`, `terminal`, `layers`, `axes`: what every module may use
//! 2. `output_file`, `setup`, `probe`, `firmware_image`, `matching`, `kinematics`, `planning`, `identification`,
//!    `touches`: files,
//!    programs and computations
//! 3. `drawing`, `link`, `cell`, `emulator`, `master`, `probe::flash`: strokes of a file; the host's end of the link to
//!    the firmware; the virtual cell; firmware in the emulator; an EtherCAT master in this process; writing firmware to a
//!    board
//! 4. `plot`: panels with scales and curves, as SVG or PNG
//! 5. `drawing::preparation`, `recording`, `settings`, `captured_cell`, `segment`, `simulation`: from a file to an
//!    admitted path; recordings of telemetry; configuration files; the cell with a capture of its bus; the cell for any
//!    master; firmware in virtual time
//! 6. `job`, `black_box`, `calibration`: tasks over one connection to the firmware, their progress, and how they go on
//!    after an interruption; a controller's last two seconds, taken apart and exported; a machine's dimensions from marks
//! 7. `machine`, `run`, `report`, `doctor`, `campaign`: one machine with several users; one drawing against the virtual
//!    cell; its figures; checks of what the commands need; random episodes under the monitor
//! 8. `report::output`, `bus`, `console`: the files of a drawing; diagnosis of an EtherCAT bus; the console in the browser
//! 9. `bench`: measurements of the project and of its peers
//! 10. `commands`: options, calls and printed results of the program's commands
#![forbid(unsafe_code)]

// Its macros replace those of the standard library in every module below.
#[macro_use]
pub mod terminal;

pub mod axes;
pub mod bench;
pub mod black_box;
pub mod bus;
pub mod calibration;
pub mod campaign;
pub mod captured_cell;
pub mod cell;
pub mod commands;
pub mod console;
pub mod doctor;
pub mod drawing;
pub mod emulator;
pub mod error;
pub mod firmware_image;
pub mod hash;
pub mod identification;
pub mod job;
pub mod kinematics;
pub mod layers;
pub mod link;
pub mod machine;
pub mod master;
pub mod matching;
pub mod output_file;
pub mod planning;
pub mod plot;
pub mod probe;
pub mod random;
pub mod recording;
pub mod report;
pub mod run;
pub mod segment;
pub mod settings;
pub mod setup;
pub mod simulation;
pub mod touches;
