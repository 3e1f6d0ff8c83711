//! Reads fault scripts from files.

use super::Script;
use crate::error::{ProgramError, code};
use std::path::Path;

/// Reads a fault script for a chain of `slaves` slaves; without a file there are no faults.
///
/// # Errors
/// The file cannot be read, or the script is not valid for this chain.
pub fn read_faults(path: Option<&Path>, slaves: usize) -> Result<Script, ProgramError> {
    let Some(path) = path else {
        return Ok(Script::default());
    };
    let wrong = |cause| ProgramError::new(code::INPUT, format!("{}: {cause}", path.display()));
    let text = std::fs::read_to_string(path)
        .map_err(|cause| ProgramError::new(code::INPUT, format!("{} cannot be read: {cause}", path.display())))?;
    let script: Script = text.parse().map_err(wrong)?;
    script.check(slaves).map_err(wrong)?;
    Ok(script)
}
