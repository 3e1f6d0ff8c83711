//! What the fuzz targets run: every reader of bytes that come from outside.
//!
//! A [`Target`] is a name, a function that takes any bytes, and seeds made by the product's own writers. `fuzz/` calls
//! the functions from libFuzzer; `tests/replay.rs` calls them with every file of `fuzz/corpus/` and with seeded
//! mutations, on the stable toolchain; `tests/limits.rs` reads files of 10 MiB within limits.
//!
//! Invariant: a target panics only if the product breaks a promise. An error with a text is a result.
#![forbid(unsafe_code)]

mod configuration;
mod console;
mod drawing;
mod ethercat;
mod files;
mod firmware;
mod frame;
pub mod hostile;
pub mod limits;
mod link;
pub mod mutation;
mod recording;
mod segment;

use std::path::{Path, PathBuf};

/// A reader of bytes from outside.
#[derive(Clone, Copy)]
pub struct Target {
    /// Name of the target, of its corpus and of its dictionary.
    pub name: &'static str,
    /// Reads any bytes. Panics if the product breaks a promise.
    pub run: fn(&[u8]),
    /// First inputs, made by the product's own writers or taken from its samples.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All targets.
pub const TARGETS: [Target; 25] = [
    target("frame", frame::run, frame::seeds),
    target("sii", ethercat::sii, ethercat::sii_seeds),
    target("mailbox", ethercat::mailbox, ethercat::mailbox_seeds),
    target("coe", ethercat::coe, ethercat::coe_seeds),
    target("segment", segment::frames, segment::frame_seeds),
    target("faults", segment::script, segment::script_seeds),
    target("link", link::stream, link::stream_seeds),
    target("messages", link::messages, link::message_seeds),
    target("config_wire", configuration::wire, configuration::wire_seeds),
    target("config_toml", configuration::file, configuration::file_seeds),
    target("svg", drawing::svg, drawing::svg_seeds),
    target("gcode", drawing::gcode, drawing::gcode_seeds),
    target("hpgl", drawing::hpgl, drawing::hpgl_seeds),
    target("csv", drawing::csv, drawing::csv_seeds),
    target("image", drawing::picture, drawing::picture_seeds),
    target("mcap", recording::mcap, recording::mcap_seeds),
    target("pcapng", recording::pcapng, recording::pcapng_seeds),
    target("console", console::messages, console::message_seeds),
    target("http", console::http, console::http_seeds),
    target("black_box", files::black_box, files::black_box_seeds),
    target("elf", files::elf, files::elf_seeds),
    target("cell_toml", files::cell_toml, files::cell_seeds),
    target("case", files::case, files::case_seeds),
    target("esi", files::esi, files::esi_seeds),
    target("control", files::control, files::control_seeds),
];

const fn target(name: &'static str, run: fn(&[u8]), seeds: fn() -> Vec<Vec<u8>>) -> Target {
    Target { name, run, seeds }
}

/// Runs the target with this name.
///
/// # Panics
/// There is no target with this name, or the product breaks a promise.
pub fn run(name: &str, bytes: &[u8]) {
    let target = TARGETS.iter().find(|target| target.name == name);
    (target.expect("a target").run)(bytes);
}

/// The folder `fuzz/` of the repository.
#[must_use]
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz")
}

/// The kept inputs of a target, by file name.
///
/// # Panics
/// A file of the corpus cannot be read.
#[must_use]
pub fn corpus(name: &str) -> Vec<(String, Vec<u8>)> {
    let Ok(entries) = std::fs::read_dir(folder().join("corpus").join(name)) else {
        return Vec::new();
    };
    let mut files: Vec<_> = entries
        .map(|entry| {
            let entry = entry.expect("an entry of the corpus");
            let bytes = std::fs::read(entry.path()).expect("a file of the corpus");
            (entry.file_name().to_string_lossy().into_owned(), bytes)
        })
        .collect();
    files.sort();
    files
}
