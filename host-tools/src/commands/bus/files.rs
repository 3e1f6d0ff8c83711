//! Reads and writes files of a slave: foe read, foe write.

use super::table;
use crate::bus::access::BusAccess;
use crate::bus::files::{FILE_BYTES_MAX, RemoteFile};
use crate::commands::print_json;
use crate::error::{ProgramError, code};
use crate::output_file;
use etherpen::ethercat::diagnostics::{NAME_BYTES_MAX, Name};
use std::path::{Path, PathBuf};

/// Which file of which slave.
#[derive(clap::Args, Debug)]
pub(super) struct FileArguments {
    /// The slave, from 1.
    #[arg(value_name = "N", value_parser = super::slave_number)]
    slave: u8,
    /// Name of the file in the slave, at most 64 bytes.
    #[arg(value_parser = file_name)]
    name: Name,
    /// File on this computer.
    path: PathBuf,
    /// Password of the file, a number: decimal or 0x hexadecimal.
    #[arg(long, value_name = "NUMBER", default_value = "0", value_parser = password)]
    password: u32,
    /// Use the mailbox of the present state, from PREOP on, instead of bringing the slave to BOOT and back to INIT.
    #[arg(long)]
    no_boot: bool,
}

fn file_name(text: &str) -> Result<Name, String> {
    Name::try_from(text).map_err(|_| format!("a name has at most {NAME_BYTES_MAX} bytes"))
}

fn password(text: &str) -> Result<u32, String> {
    let parsed = match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16),
        None => text.parse(),
    };
    parsed.map_err(|_| format!("'{text}' is no password; it is a number up to 0xffffffff"))
}

impl FileArguments {
    /// Path of the file on this computer.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    fn remote(&self) -> RemoteFile {
        RemoteFile {
            slave: self.slave,
            name: self.name.clone(),
            password: self.password,
            bootstrap: !self.no_boot,
        }
    }
}

/// `bus foe read N NAME PATH`.
pub(super) fn read(access: &mut dyn BusAccess, arguments: &FileArguments, json: bool) -> Result<(), ProgramError> {
    let remote = arguments.remote();
    let Some(content) = remote.read(access, progress)? else {
        let message = format!("the slave's file has no end within {FILE_BYTES_MAX} bytes");
        return Err(ProgramError::new(code::FAILED, message));
    };
    output_file::write_bytes(&arguments.path, &content)?;
    tell(&remote, content.len(), "read from", json)
}

/// `bus foe write N NAME PATH`.
pub(super) fn write(
    access: &mut dyn BusAccess,
    arguments: &FileArguments,
    content: &[u8],
    json: bool,
) -> Result<(), ProgramError> {
    let remote = arguments.remote();
    remote.write(access, content, progress)?;
    tell(&remote, content.len(), "written to", json)
}

/// Tells about every 64 KiB of a long transfer.
fn progress(bytes: usize) {
    const STEP: usize = 64 << 10;
    if bytes > 0 && bytes.is_multiple_of(STEP) {
        eprintln!("{} KiB", bytes >> 10);
    }
}

fn tell(remote: &RemoteFile, bytes: usize, done: &str, json: bool) -> Result<(), ProgramError> {
    if json {
        return print_json(&remote.transferred(bytes));
    }
    let state = if remote.bootstrap { "; it is in INIT now" } else { "" };
    let RemoteFile { slave, name, .. } = remote;
    table::say(&format!("{name}: {bytes} bytes {done} slave {slave}{state}"))
}
