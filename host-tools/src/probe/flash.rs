//! Writes firmware to a board with the program probe-rs, and explains its errors with what to try.

use crate::error::{ProgramError, code};
use crate::{probe, setup};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The program probe-rs, set up for one chip.
#[derive(Clone, Debug)]
pub struct Flasher {
    /// Path of the program.
    pub program: PathBuf,
    /// The chip, as probe-rs names it.
    pub chip: String,
    /// The debug probe, `VID:PID:SERIAL`; `None` if only one is plugged in.
    pub probe: Option<String>,
}

impl Flasher {
    /// Writes and verifies an image. After a failure it tries once more with the chip held in reset; `retry` is called
    /// before the second attempt. Returns whether the chip had to be held in reset.
    ///
    /// # Errors
    /// The probe is missing or cannot be opened, or both attempts failed.
    pub fn download(&self, image: &Path, retry: &mut dyn FnMut()) -> Result<bool, ProgramError> {
        let mut last = String::new();
        for under_reset in [false, true] {
            let mut command = self.command("download", under_reset);
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
                retry();
            }
        }
        Err(failed(
            "the firmware could not be written, also not with the chip held in reset; check the board's supply and jumpers, \
             then try again",
            &last,
        ))
    }

    /// Resets the chip, which starts the image.
    ///
    /// # Errors
    /// The chip could not be reset.
    pub fn reset(&self, under_reset: bool) -> Result<(), ProgramError> {
        ended(&mut self.command("reset", under_reset))
            .map_err(|said| failed("the firmware is written, but could not be started", &said))
    }

    fn command(&self, subcommand: &str, under_reset: bool) -> Command {
        let mut command = Command::new(&self.program);
        command.args([subcommand, "--chip", &self.chip]);
        if let Some(selector) = &self.probe {
            command.args(["--probe", selector]);
        }
        if under_reset {
            command.arg("--connect-under-reset");
        }
        command
    }
}

/// Finds the program probe-rs. With `install`, a missing one is installed; `before` gets the command first.
///
/// # Errors
/// The program is missing or could not be installed.
pub fn program(install: bool, before: &mut dyn FnMut(&str)) -> Result<PathBuf, ProgramError> {
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
    before(probe::INSTALL);
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
    // probe-rs does not see a probe that it cannot open.
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
