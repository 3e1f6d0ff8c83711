//! Errors of the emulator, each with what to try.

use crate::error::{ProgramError, code};
use std::fmt;
use std::io;
use std::path::PathBuf;
use std::process::ExitStatus;
use std::time::Duration;

/// Why an emulator could not be started or continued.
#[derive(Debug)]
pub enum EmulatorError {
    /// The program is not installed.
    QemuMissing {
        /// The program searched for.
        program: PathBuf,
    },
    /// The firmware image cannot be read.
    Image {
        /// Its path.
        path: PathBuf,
        /// Why it could not be read or parsed.
        cause: String,
    },
    /// Making or using the working directory, its FIFOs or sockets failed.
    Io {
        /// The operation that failed.
        what: String,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// The emulator ended by itself; the firmware ends it when it panics or hangs.
    Ended {
        /// How it ended.
        status: ExitStatus,
        /// The last output of the emulator: the panic message, or the emulator's error message.
        said: String,
        /// The last lines of the firmware's log.
        log: Vec<String>,
        /// The black box, if the firmware has left one.
        black_box: Option<PathBuf>,
    },
    /// The firmware did not reach its next millisecond.
    Silent {
        /// Time waited, wall time.
        waited: Duration,
        /// Milliseconds reached.
        milliseconds: u32,
        /// Output of the emulator.
        said: String,
        /// The last lines of the firmware's log.
        log: Vec<String>,
    },
    /// The firmware sent an invalid record.
    Record {
        /// The file with the record.
        file: &'static str,
        /// Length found.
        length: usize,
        /// Largest valid length.
        length_max: usize,
    },
    /// A peer's code panicked.
    PeerPanicked,
}

impl EmulatorError {
    pub(crate) fn io(what: impl Into<String>) -> impl FnOnce(io::Error) -> Self {
        let what = what.into();
        move |cause| Self::Io { what, cause }
    }
}

fn write_log(f: &mut fmt::Formatter, said: &str, log: &[String]) -> fmt::Result {
    if !said.is_empty() {
        write!(f, "\nit said: {said}")?;
    }
    if !log.is_empty() {
        write!(f, "\nthe end of the firmware's log:")?;
        for line in log {
            write!(f, "\n  {line}")?;
        }
    }
    Ok(())
}

impl fmt::Display for EmulatorError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::QemuMissing { program } => write!(
                f,
                "{} is not installed; install it with `sudo apt-get install qemu-system-arm` (Debian, Ubuntu), \
                 `sudo dnf install qemu-system-arm` (Fedora), `sudo pacman -S qemu-system-arm` (Arch) or \
                 `brew install qemu` (macOS)",
                program.display()
            ),
            Self::Image { path, cause } => write!(
                f,
                "firmware image {}: {cause}; build it with `cargo emulated`",
                path.display()
            ),
            Self::Io { what, cause } => write!(f, "{what}: {cause}"),
            Self::Ended {
                status,
                said,
                log,
                black_box,
            } => {
                write!(f, "the emulator ended by itself ({status})")?;
                write_log(f, said, log)?;
                match black_box {
                    Some(path) => write!(
                        f,
                        "\nits last two seconds: `etherpen blackbox --image {}`",
                        path.display()
                    ),
                    None => Ok(()),
                }
            }
            Self::Silent {
                waited,
                milliseconds,
                said,
                log,
            } => {
                write!(
                    f,
                    "the emulator has not answered for {} s; the firmware had come to millisecond {milliseconds}",
                    waited.as_secs()
                )?;
                write_log(f, said, log)
            }
            Self::Record {
                file,
                length,
                length_max,
            } => write!(
                f,
                "the firmware sent {length} bytes by {file} where {length_max} is the most: image and program are of \
                 different versions"
            ),
            Self::PeerPanicked => write!(f, "the emulator's peer panicked"),
        }
    }
}

impl std::error::Error for EmulatorError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io { cause, .. } => Some(cause),
            _ => None,
        }
    }
}

impl From<&EmulatorError> for ProgramError {
    fn from(error: &EmulatorError) -> Self {
        let code = match error {
            EmulatorError::QemuMissing { .. } => code::TOOL,
            _ => code::CONNECTION,
        };
        Self::new(code, error)
    }
}
