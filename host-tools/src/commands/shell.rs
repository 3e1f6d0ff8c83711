//! `etherpen completions` and `etherpen man`: what shells and manuals want to know of the command line.

use super::CommandError;
use std::io::Write;
use std::path::PathBuf;

/// Options of `etherpen completions`.
#[derive(clap::Args, Debug)]
pub struct Completions {
    /// The shell that is to complete; the script goes to stdout.
    shell: clap_complete::Shell,
}

/// Options of `etherpen man`.
#[derive(clap::Args, Debug)]
pub struct Man {
    /// Folder for the pages, one of each command; it is made if it is missing.
    dir: PathBuf,
}

/// Prints a shell's completions of a command line.
///
/// # Errors
/// stdout is closed.
pub fn completions(arguments: &Completions, mut command: clap::Command) -> Result<(), CommandError> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "etherpen", &mut script);
    std::io::stdout()
        .write_all(&script)
        .map_err(|cause| CommandError::failed("stdout", cause))
}

/// Writes the manual pages of a command line.
///
/// # Errors
/// A page cannot be written.
pub fn man(arguments: &Man, command: clap::Command) -> Result<(), CommandError> {
    super::outputs::make_folder(&arguments.dir)?;
    let shown = arguments.dir.display();
    clap_mangen::generate_to(command, &arguments.dir)
        .map_err(|cause| CommandError::failed(format!("{shown} cannot be written"), cause))?;
    eprintln!("manual pages in {shown}: man -l {shown}/etherpen.1");
    Ok(())
}
