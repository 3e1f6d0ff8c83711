//! `etherpen flash`: builds the firmware of the board, checks it, writes it to the board and verifies it.
//!
//! Invariant: nothing is written before the image is known to be valid for this chip.

use super::print_json;
use crate::error::{ProgramError, code};
use crate::firmware_image::{Image, stm32h743};
use crate::probe::flash::{Flasher, program};
use crate::setup;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Options of `etherpen flash`.
///
/// Exit codes: 0 written, verified and started; 1 probe-rs failed; 3 the image is not for this chip; 4 probe-rs or the
/// Rust target is missing; 5 no debug probe, or no permission to open it.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Write this ELF file instead of building the firmware.
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
    /// The chip, as probe-rs names it.
    #[arg(long, default_value = "STM32H743ZITx")]
    chip: String,
    /// Debug probe, if there are several: VID:PID:SERIAL (etherpen doctor lists them).
    #[arg(long, value_name = "PROBE")]
    probe: Option<String>,
    /// Install probe-rs with cargo if it is missing; takes some minutes.
    #[arg(long)]
    install: bool,
    /// Print the result as JSON on stdout.
    #[arg(long)]
    json: bool,
}

/// What the command prints.
#[derive(Clone, Debug, Serialize)]
struct Flashed {
    image: String,
    chip: String,
    flash_bytes: u32,
    verified: bool,
    /// Whether the chip had to be held in reset to be reached.
    connect_under_reset: bool,
    seconds: f64,
}

/// Runs the command.
///
/// # Errors
/// The build or the image is invalid, a tool is missing, or the probe failed.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let path = match &arguments.image {
        Some(path) => path.clone(),
        None => {
            eprintln!("etherpen: building the firmware");
            setup::build_firmware("nucleo")?
        }
    };
    let refused =
        |cause: &dyn std::fmt::Display| ProgramError::new(code::INPUT, format!("{}: {cause}", path.display()));
    let image = Image::read(&path).map_err(|cause| refused(&cause))?;
    stm32h743::check(&image).map_err(|cause| refused(&cause))?;
    let flasher = Flasher {
        program: program(arguments.install, &mut |command| eprintln!("etherpen: {command}"))?,
        chip: arguments.chip.clone(),
        probe: arguments.probe.clone(),
    };
    let begun = Instant::now();
    eprintln!(
        "etherpen: writing {} bytes into the {}",
        image.flash_bytes(),
        arguments.chip
    );
    let connect_under_reset = flasher.download(&path, &mut || {
        eprintln!("etherpen: the chip was not reached; once more with the chip held in reset");
    })?;
    flasher.reset(connect_under_reset)?;
    let flashed = Flashed {
        image: path.display().to_string(),
        chip: flasher.chip,
        flash_bytes: image.flash_bytes(),
        verified: true,
        connect_under_reset,
        seconds: begun.elapsed().as_secs_f64(),
    };
    if arguments.json {
        return print_json(&flashed);
    }
    println!(
        "{} bytes written, verified and started in {:.1} s",
        flashed.flash_bytes, flashed.seconds
    );
    Ok(())
}
