//! The error of the program: a message and an exit code.
//!
//! Errors of a module become a [`ProgramError`] by `From`, next to the error itself.

/// Why the program ends without success.
#[derive(Clone, Debug)]
pub struct ProgramError {
    /// Exit code, as `etherpen --help` lists them.
    pub code: u8,
    /// What happened and what to try.
    pub message: String,
}

/// Exit codes.
pub mod code {
    /// The work failed.
    pub const FAILED: u8 = 1;
    /// Wrong usage, or a configuration that cannot be used.
    pub const USAGE: u8 = 2;
    /// The input file cannot be used.
    pub const INPUT: u8 = 3;
    /// A tool is missing.
    pub const TOOL: u8 = 4;
    /// No connection to the machine or the emulator.
    pub const CONNECTION: u8 = 5;
    /// The firmware speaks another protocol version.
    pub const VERSION: u8 = 6;
    /// The machine stopped with a fault.
    pub const FAULT: u8 = 7;
    /// The path ended, and a part of the drawing is missing.
    pub const INCOMPLETE: u8 = 8;
    /// Interrupted by the user.
    pub const INTERRUPTED: u8 = 130;
}

impl ProgramError {
    /// An error with its exit code.
    pub fn new(code: u8, message: impl std::fmt::Display) -> Self {
        Self {
            code,
            message: message.to_string(),
        }
    }

    /// The work failed while doing `what`.
    pub fn failed(what: impl std::fmt::Display, cause: impl std::fmt::Display) -> Self {
        Self::new(code::FAILED, format!("{what}: {cause}"))
    }

    /// What a failed write to stdout means: a reader that has ended, as in `| head -1`, wants no more, and ends nothing.
    ///
    /// # Errors
    /// stdout cannot be written for another reason: a full disk, say.
    pub fn of_stdout(cause: std::io::Error) -> Result<(), Self> {
        match cause.kind() {
            std::io::ErrorKind::BrokenPipe => Ok(()),
            _ => Err(Self::failed("stdout", cause)),
        }
    }
}
