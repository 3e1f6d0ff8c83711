//! Output files, written completely or not at all.
//!
//! A file that a command writes keeps its last good content until the new content is complete and on the disk. The new
//! content is written to a hidden file in the same folder, synced, and renamed. A full disk, a kill or a power cut
//! leaves the old file unchanged. The hidden file is locked while its program runs; the next program that writes this
//! file removes the hidden file of a killed program.
//!
//! Devices, pipes, and paths of file descriptors (`/dev/stdout`) are written directly: they have no content to lose.

use crate::error::{ProgramError, code};
use rustix::fs::{FlockOperation, flock};
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{MetadataExt, fchown};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Most symbolic links followed to an output, as many as Linux follows.
const LINKS_MAX: usize = 40;
/// Longest part of the output's name in the hidden file's name, bytes.
const NAME_BYTES_MAX: usize = 180;
/// Suffix of hidden files.
const BESIDE: &str = ".part";

/// A file being written. Dropping it keeps the last good content; [`commit`](Self::commit) replaces it.
#[derive(Debug)]
pub struct OutputFile {
    out: BufWriter<File>,
    beside: Option<Beside>,
}

/// A hidden file, removed when dropped unless it was renamed.
#[derive(Debug)]
struct Beside {
    path: PathBuf,
    target: PathBuf,
}

impl Drop for Beside {
    fn drop(&mut self) {
        // After a rename there is no file at this path.
        let _ = fs::remove_file(&self.path);
    }
}

impl OutputFile {
    /// Starts an output. A symbolic link stays, and its target is replaced. Owner and permissions of an existing file
    /// are kept.
    ///
    /// # Errors
    /// The folder or the existing file cannot be written.
    pub fn create(path: &Path) -> io::Result<Self> {
        let target = followed(path)?;
        let present = match fs::metadata(&target) {
            Ok(present) => Some(present),
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        if present.as_ref().is_some_and(|present| !present.is_file()) || is_descriptor(&target) {
            // Append mode keeps what a shell's redirection has already written.
            let file = OpenOptions::new().append(true).open(&target)?;
            return Ok(Self::direct(file));
        }
        if present.is_some() {
            // A write-protected file is not replaced.
            OpenOptions::new().write(true).open(&target)?;
        }
        let (file, beside) = create_beside(target)?;
        if let Some(present) = present {
            file.set_permissions(present.permissions())?;
            // Only root may change a file's owner.
            let _ = fchown(&file, Some(present.uid()), Some(present.gid()));
        }
        Ok(Self {
            out: BufWriter::new(file),
            beside: Some(beside),
        })
    }

    /// Starts an output; `-` is standard output.
    ///
    /// # Errors
    /// As [`create`](Self::create).
    pub fn create_or_stdout(path: &Path) -> io::Result<Self> {
        if path.as_os_str() != "-" {
            return Self::create(path);
        }
        let stdout = io::stdout().as_fd().try_clone_to_owned()?;
        Ok(Self::direct(File::from(stdout)))
    }

    fn direct(file: File) -> Self {
        Self {
            out: BufWriter::new(file),
            beside: None,
        }
    }

    /// A second handle for a stream that grows. It writes into this file, before and after [`commit`](Self::commit).
    ///
    /// # Errors
    /// There are no more file descriptors.
    pub fn stream(&self) -> io::Result<File> {
        self.out.get_ref().try_clone()
    }

    /// Completes the output: the file has its new content from then on.
    ///
    /// # Errors
    /// The content is not on the disk; the last good content stays.
    pub fn commit(mut self) -> io::Result<()> {
        self.out.flush()?;
        let Some(beside) = self.beside.take() else {
            return Ok(());
        };
        self.out.get_ref().sync_all()?;
        fs::rename(&beside.path, &beside.target)?;
        sync_folder(&beside.target);
        Ok(())
    }

    /// Completes the output without waiting for the disk: the content survives the end of the program, but a power cut
    /// may lose it.
    ///
    /// # Errors
    /// As [`commit`](Self::commit).
    pub fn commit_unsynced(mut self) -> io::Result<()> {
        self.out.flush()?;
        match self.beside.take() {
            Some(beside) => fs::rename(&beside.path, &beside.target),
            None => Ok(()),
        }
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// Writes a whole file.
///
/// # Errors
/// The last good content stays.
pub fn write(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut out = OutputFile::create(path)?;
    out.write_all(content)?;
    out.commit()
}

/// Whether two paths are one regular file: equal paths, a symbolic or a hard link. `-` is standard input or output.
#[must_use]
pub fn is_same_file(output: &Path, input: &Path) -> bool {
    let named = |path: &Path, standard: &str| {
        let path = if path.as_os_str() == "-" {
            Path::new(standard)
        } else {
            path
        };
        fs::metadata(path).ok().filter(|file| file.is_file())
    };
    match (named(output, "/dev/stdout"), named(input, "/dev/stdin")) {
        (Some(output), Some(input)) => (output.dev(), output.ino()) == (input.dev(), input.ino()),
        _ => false,
    }
}

/// The target of a path's symbolic links, which may not exist yet; links to descriptors are not followed.
fn followed(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..LINKS_MAX {
        let is_link = fs::symlink_metadata(&path).is_ok_and(|found| found.file_type().is_symlink());
        if !is_link || is_descriptor(&path) {
            return Ok(path);
        }
        path = folder_of(&path).join(fs::read_link(&path)?);
    }
    Err(io::Error::other("too many symbolic links"))
}

/// Whether a path is a file descriptor's name under /proc.
fn is_descriptor(path: &Path) -> bool {
    fs::canonicalize(folder_of(path)).is_ok_and(|folder| folder.starts_with("/proc"))
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Prefix of the names of a target's hidden files.
fn stem(target: &Path) -> io::Result<String> {
    let name = target.file_name().ok_or(ErrorKind::IsADirectory)?.to_string_lossy();
    let mut end = name.len().min(NAME_BYTES_MAX);
    while !name.is_char_boundary(end) {
        end -= 1;
    }
    Ok(format!(".{}.", name.get(..end).unwrap_or_default()))
}

fn create_beside(target: PathBuf) -> io::Result<(File, Beside)> {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let (folder, stem) = (folder_of(&target).to_owned(), stem(&target)?);
    remove_left_behind(&folder, &stem);
    loop {
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = folder.join(format!("{stem}{}-{number}{BESIDE}", std::process::id()));
        let file = match OpenOptions::new().write(true).create_new(true).open(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
            opened => opened?,
        };
        // Some file systems have no locks; their hidden files are not removed.
        let locked = flock(&file, FlockOperation::NonBlockingLockExclusive) != Err(rustix::io::Errno::WOULDBLOCK);
        let is_there = fs::metadata(&path).is_ok_and(|there| file.metadata().is_ok_and(|own| own.ino() == there.ino()));
        // Another program may have taken the file for a stale one before it was locked.
        if locked && is_there {
            return Ok((file, Beside { path, target }));
        }
    }
}

/// Removes this target's hidden files of killed programs.
fn remove_left_behind(folder: &Path, stem: &str) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let is_beside = |name: &str| {
            let number = name.strip_prefix(stem).and_then(|rest| rest.strip_suffix(BESIDE));
            number.is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit() || byte == b'-'))
        };
        if !name.to_str().is_some_and(is_beside) {
            continue;
        }
        let unlocked =
            File::open(entry.path()).is_ok_and(|file| flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok());
        if unlocked {
            // A file that cannot be removed does no harm.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Makes a rename durable if the file system supports it.
fn sync_folder(target: &Path) {
    let synced = File::open(folder_of(target)).and_then(|folder| folder.sync_all());
    // Some file systems cannot sync a folder; the file itself is on the disk.
    let _ = synced;
}

/// Refuses an output that is one of the files that the command reads, whatever their names.
///
/// # Errors
/// Both names, and what to try.
pub fn refuse_input(output: &Path, inputs: &[PathBuf]) -> Result<(), ProgramError> {
    match inputs.iter().find(|input| is_same_file(output, input)) {
        None => Ok(()),
        Some(input) => {
            let (output, input) = (output.display(), input.display());
            let text = format!("{output} is the input file {input}, which would be lost; choose another output");
            Err(ProgramError::new(code::USAGE, text))
        }
    }
}

/// Writes a text to a file, or to standard output for `-`.
///
/// # Errors
/// The file cannot be written.
pub fn write_text(path: &Path, text: &str) -> Result<(), ProgramError> {
    write_bytes(path, text.as_bytes())
}

/// Writes bytes to a file, or to standard output for `-`.
///
/// # Errors
/// The file cannot be written.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), ProgramError> {
    let written = OutputFile::create_or_stdout(path).and_then(|mut out| {
        out.write_all(bytes)?;
        out.commit()
    });
    written.map_err(|cause| unwritable(path, &cause))
}

/// An output that could not be written.
pub fn unwritable(path: &Path, cause: &io::Error) -> ProgramError {
    ProgramError::failed(format!("{} cannot be written", path.display()), cause)
}

/// Creates the output folder.
///
/// # Errors
/// The folder cannot be created.
pub fn make_folder(dir: &Path) -> Result<(), ProgramError> {
    std::fs::create_dir_all(dir)
        .map_err(|cause| ProgramError::failed(format!("the folder {} cannot be made", dir.display()), cause))
}

/// Starts a file in the output folder.
///
/// # Errors
/// The file cannot be created.
pub fn create(dir: &Path, name: &str) -> Result<OutputFile, ProgramError> {
    let path = dir.join(name);
    OutputFile::create(&path).map_err(|cause| unwritable(&path, &cause))
}

#[cfg(test)]
mod tests;
