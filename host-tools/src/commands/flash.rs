//! `etherpen flash`: builds the firmware of the board, checks it, writes it to the board and verifies it.
//!
//! The program probe-rs writes the image; its requirements and errors are explained here with what to try. Invariant:
//! nothing is written before the image is known to be valid for this chip.

use super::print_json;
use crate::error::{ProgramError, code};
use crate::firmware_image::Image;
use crate::{probe, setup};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

/// Flash memory of an STM32H743ZI (RM0433, memory map): start and length.
const FLASH: (u32, u32) = (0x0800_0000, 2 * 1024 * 1024);
/// Memory in which the image's stack may begin: DTCM and AXI SRAM.
const STACK: [(u32, u32); 2] = [(0x2000_0000, 128 * 1024), (0x2400_0000, 512 * 1024)];
/// Section of the vector table: the stack's start and the address of the first instruction come first.
const VECTORS: &str = ".vector_table";

/// Options of `etherpen flash`.
///
/// Exit codes: 0 written, verified and started; 1 probe-rs failed; 3 the image is none for this chip; 4 probe-rs or the
/// Rust target is missing; 5 no debug probe, or no right to open it.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Write this ELF file instead of building the firmware.
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
    /// The chip, as probe-rs names it.
    #[arg(long, default_value = "STM32H743ZITx")]
    chip: String,
    /// Which debug probe, where there are several: VID:PID:SERIAL (etherpen doctor lists them).
    #[arg(long, value_name = "PROBE")]
    probe: Option<String>,
    /// Install probe-rs by cargo where it is missing; takes some minutes.
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
    check(&image).map_err(|cause| refused(&cause))?;
    let probe_rs = program(arguments.install)?;
    let begun = Instant::now();
    eprintln!(
        "etherpen: writing {} bytes into the {}",
        image.flash_bytes(),
        arguments.chip
    );
    let connect_under_reset = download(&probe_rs, arguments, &path)?;
    let mut reset = probe(&probe_rs, "reset", arguments, connect_under_reset);
    ended(&mut reset).map_err(|said| failed("the firmware is written, but could not be started", &said))?;
    let flashed = Flashed {
        image: path.display().to_string(),
        chip: arguments.chip.clone(),
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

fn within((start, length): (u32, u32), address: u32, size: u32) -> bool {
    let offset = address.checked_sub(start);
    offset
        .and_then(|offset| offset.checked_add(size))
        .is_some_and(|end| end <= length)
}

/// Checks that the chip can start an image; otherwise returns why not and what to try.
fn check(image: &Image) -> Result<(), String> {
    let vectors = image
        .section(VECTORS)
        .ok_or_else(|| format!("it has no section {VECTORS}; build one with: cargo nucleo"))?;
    if vectors.address != FLASH.0 {
        return Err(format!(
            "its vector table is at {:#010x}, this chip starts at {:#010x}: it is the image of another board; build one \
             with: cargo nucleo",
            vectors.address, FLASH.0
        ));
    }
    for load in image.loads() {
        if !within(FLASH, load.address, load.size) {
            return Err(format!(
                "{} bytes at {:#010x} are outside the flash memory of {} KiB at {:#010x}",
                load.size,
                load.address,
                FLASH.1 / 1024,
                FLASH.0
            ));
        }
    }
    let stack = image.word(FLASH.0).unwrap_or_default();
    if !STACK.iter().any(|memory| within(*memory, stack, 0)) {
        return Err(format!(
            "its stack would begin at {stack:#010x}, where this chip has no memory for it"
        ));
    }
    let entry = image.word(FLASH.0 + 4).unwrap_or_default();
    if entry & 1 == 0 || !within(FLASH, entry & !1, 2) {
        return Err(format!(
            "it would begin at {entry:#010x}, which is no Thumb code in the flash memory"
        ));
    }
    Ok(())
}

/// The program probe-rs; installed if it is missing and `install` is set.
fn program(install: bool) -> Result<PathBuf, ProgramError> {
    if let Some(program) = probe::probe_rs() {
        return Ok(program);
    }
    let missing = || {
        let text = format!(
            "probe-rs is needed and not installed. Try: {}   (or: etherpen flash --install)",
            probe::INSTALL
        );
        ProgramError::new(code::TOOL, text)
    };
    if !install {
        return Err(missing());
    }
    eprintln!("etherpen: {}", probe::INSTALL);
    let mut words = probe::INSTALL.split_whitespace().skip(1);
    let mut command = setup::cargo();
    let installed = command.args(words.by_ref()).stdout(Stdio::null()).status();
    match installed {
        Ok(status) if status.success() => probe::probe_rs().ok_or_else(missing),
        _ => Err(ProgramError::new(
            code::TOOL,
            format!(
                "probe-rs could not be installed; what its build needs is at https://probe.rs/docs/getting-started/installation. \
                 Try: {}",
                probe::INSTALL
            ),
        )),
    }
}

fn probe(program: &Path, subcommand: &str, arguments: &Arguments, under_reset: bool) -> Command {
    let mut command = Command::new(program);
    command.args([subcommand, "--chip", &arguments.chip]);
    if let Some(selector) = &arguments.probe {
        command.args(["--probe", selector]);
    }
    if under_reset {
        command.arg("--connect-under-reset");
    }
    command
}

/// Runs a command to its end; the error is its output.
fn ended(command: &mut Command) -> Result<(), String> {
    let output = command
        .stdin(Stdio::null())
        .output()
        .map_err(|cause| cause.to_string())?;
    if output.status.success() {
        return Ok(());
    }
    let said = [output.stderr, output.stdout].concat();
    Err(String::from_utf8_lossy(&said).trim().to_owned())
}

/// Writes and verifies; after a failure once more with the chip held in reset. Returns whether that was needed.
fn download(program: &Path, arguments: &Arguments, image: &Path) -> Result<bool, ProgramError> {
    let mut last = String::new();
    for under_reset in [false, true] {
        let mut command = probe(program, "download", arguments, under_reset);
        match ended(command.arg("--verify").arg(image)) {
            Ok(()) => return Ok(under_reset),
            Err(said) => {
                if let Some(error) = unreachable(&said) {
                    return Err(error);
                }
                last = said;
            }
        }
        if !under_reset {
            eprintln!("etherpen: the chip was not reached; once more with the chip held in reset");
        }
    }
    Err(failed(
        "the firmware could not be written, also not with the chip held in reset; check the board's supply and jumpers, \
         then try again",
        &last,
    ))
}

fn failed(what: &str, said: &str) -> ProgramError {
    ProgramError::new(code::FAILED, format!("{what}. probe-rs says:\n{said}"))
}

/// The error for a probe that is missing or cannot be opened, if probe-rs reports one.
fn unreachable(said: &str) -> Option<ProgramError> {
    let text = said.to_lowercase();
    let says = |parts: &[&str]| parts.iter().any(|part| text.contains(part));
    let denied = says(&[
        "permission denied",
        "access denied",
        "insufficient permission",
        "os error 13",
    ]);
    let absent = says(&[
        "no connected probes",
        "no probe",
        "probe was not found",
        "probe not found",
    ]);
    if !denied && !absent {
        return None;
    }
    // A probe that may not be opened is one that probe-rs does not see.
    let present = probe::st_links(Path::new(probe::USB_DEVICES));
    let message = match present.first() {
        _ if denied => format!("the debug probe may not be opened; {}", probe::UDEV_RULE),
        Some(link) => format!(
            "{} is plugged in, but probe-rs does not find it, as when it may not be opened; {}",
            link.name,
            probe::UDEV_RULE
        ),
        None => {
            "no debug probe is plugged in; connect the board's ST-LINK (USB connector CN1) to this computer, and see \
                 etherpen doctor"
                .into()
        }
    };
    Some(ProgramError::new(
        code::CONNECTION,
        format!("{message}\nprobe-rs says:\n{said}"),
    ))
}
