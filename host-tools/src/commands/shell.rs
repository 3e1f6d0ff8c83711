//! `etherpen completions` and `etherpen man`: shell completions and manual pages.

use crate::error::ProgramError;
use crate::output_file::write_bytes;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Options of `etherpen completions`.
#[derive(clap::Args, Debug)]
pub struct Completions {
    /// Shell; the script goes to stdout.
    shell: clap_complete::Shell,
}

/// Options of `etherpen man`.
#[derive(clap::Args, Debug)]
pub struct Man {
    /// Folder for the pages, one per command; created if it is missing.
    dir: PathBuf,
}

/// Prints a shell's completions of a command line.
///
/// # Errors
/// stdout is closed.
pub fn completions(arguments: &Completions, mut command: clap::Command) -> Result<(), ProgramError> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "etherpen", &mut script);
    std::io::stdout().write_all(&script).or_else(ProgramError::of_stdout)
}

/// Writes the manual pages of a command line.
///
/// # Errors
/// A page cannot be written.
pub fn man(arguments: &Man, command: clap::Command) -> Result<(), ProgramError> {
    crate::output_file::make_folder(&arguments.dir)?;
    let shown = arguments.dir.display();
    let mut command = command.disable_help_subcommand(true);
    command.build();
    pages(&command, &arguments.dir)?;
    eprintln!("manual pages in {shown}: man -l {shown}/etherpen.1");
    Ok(())
}

/// Writes the page of a command, and those of its subcommands.
fn pages(command: &clap::Command, dir: &Path) -> Result<(), ProgramError> {
    for subcommand in command.get_subcommands().filter(|subcommand| !subcommand.is_hide_set()) {
        pages(subcommand, dir)?;
    }
    let page = clap_mangen::Man::new(command.clone());
    let (path, mut text) = (dir.join(page.get_filename()), Vec::new());
    page.render(&mut text)
        .map_err(|cause| ProgramError::failed("a manual page", cause))?;
    write_bytes(&path, &text)
}
