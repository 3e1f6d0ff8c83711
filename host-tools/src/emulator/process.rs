//! The emulator's process and its working directory; neither outlives its owner.
//!
//! Both end when [`Process`] is dropped and when a signal ends this program. For every other end of this program there
//! is a guard: a shell that waits for the end of its input, then ends the emulator and removes the directory. The
//! firmware in lockstep detects closed files too, but only after it has opened them: an emulator that is still starting
//! would wait forever.

use super::error::EmulatorError;
use rustix::fs::{CWD, FileType, Mode, mknodat};
use rustix::process::{Pid, Signal, kill_process};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, Once, PoisonError};

/// File for the emulator's own output, in its working directory.
const OUTPUT_FILE: &str = "qemu.out";
/// File in which the firmware saves its black box when it panics or hangs.
const BLACK_BOX_FILE: &str = "black-box.bin";
/// Length of that output shown in an error, bytes.
const OUTPUT_SHOWN: usize = 2000;

/// The guard's script: its input ends when this program ends for any reason.
const GUARD: &str = "read -r _; kill -9 \"$1\"; rm -rf \"$2\"";

/// Emulators and directories that a signal handler has to clean up.
static LIVE: Mutex<Vec<Live>> = Mutex::new(Vec::new());
static NUMBER: AtomicU32 = AtomicU32::new(0);

struct Live {
    directory: PathBuf,
    child: Option<u32>,
}

fn live() -> std::sync::MutexGuard<'static, Vec<Live>> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A temporary directory that is removed when dropped.
pub(crate) struct Directory {
    path: PathBuf,
}

impl Directory {
    pub(crate) fn make() -> Result<Self, EmulatorError> {
        watch_signals()?;
        let path = loop {
            let number = NUMBER.fetch_add(1, Ordering::Relaxed);
            let name = format!("etherpen-{}-{number}", std::process::id());
            let path = std::env::temp_dir().join(name);
            match fs::create_dir(&path) {
                Ok(()) => break path,
                // Left behind by a program with the same process id.
                Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists => {}
                Err(cause) => {
                    let what = format!("making the emulator's working directory {}", path.display());
                    return Err(EmulatorError::Io { what, cause });
                }
            }
        };
        live().push(Live {
            directory: path.clone(),
            child: None,
        });
        Ok(Self { path })
    }

    pub(crate) fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    fn make_fifo(&self, name: &str) -> Result<PathBuf, EmulatorError> {
        let path = self.join(name);
        mknodat(CWD, &path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
            .map_err(io::Error::from)
            .map_err(EmulatorError::io(format!("making FIFO {}", path.display())))?;
        Ok(path)
    }

    /// A FIFO that the firmware writes and this program reads without waiting.
    pub(crate) fn fifo_from_firmware(&self, name: &str) -> Result<File, EmulatorError> {
        let path = self.make_fifo(name)?;
        OpenOptions::new()
            .read(true)
            .custom_flags(rustix::fs::OFlags::NONBLOCK.bits() as i32)
            .open(&path)
            .map_err(EmulatorError::io(format!("opening {}", path.display())))
    }

    /// A FIFO that the firmware reads and this program writes; opened both ways, so that it opens without a reader.
    pub(crate) fn fifo_to_firmware(&self, name: &str) -> Result<File, EmulatorError> {
        let path = self.make_fifo(name)?;
        OpenOptions::new()
            .read(true)
            .write(true)
            .open(&path)
            .map_err(EmulatorError::io(format!("opening {}", path.display())))
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        live().retain(|entry| entry.directory != self.path);
        // A directory that cannot be removed is left behind.
        let _ = fs::remove_dir_all(&self.path);
    }
}

/// A running emulator.
pub(crate) struct Process {
    child: Child,
    guard: Option<Child>,
    directory: Directory,
}

impl Process {
    /// Starts `program` with `arguments` in `directory`, in its own process group, so that the terminal's Ctrl-C only
    /// reaches this program.
    pub(crate) fn start(program: &Path, arguments: &[OsString], directory: Directory) -> Result<Self, EmulatorError> {
        let output = directory.join(OUTPUT_FILE);
        let open = || -> io::Result<(Stdio, Stdio)> {
            let file = File::create(&output)?;
            Ok((file.try_clone()?.into(), file.into()))
        };
        let (stdout, stderr) = open().map_err(EmulatorError::io(format!("making {}", output.display())))?;
        let child = Command::new(program)
            .args(arguments)
            .current_dir(&directory.path)
            .stdin(Stdio::null())
            .stdout(stdout)
            .stderr(stderr)
            .process_group(0)
            .spawn()
            .map_err(|cause| match cause.kind() {
                io::ErrorKind::NotFound => EmulatorError::QemuMissing {
                    program: program.to_owned(),
                },
                _ => EmulatorError::Io {
                    what: format!("starting {}", program.display()),
                    cause,
                },
            })?;
        for entry in live().iter_mut() {
            if entry.directory == directory.path {
                entry.child = Some(child.id());
            }
        }
        // From here on the emulator ends with its owner, even if the guard cannot be started.
        let mut process = Self {
            child,
            guard: None,
            directory,
        };
        process.guard = Some(process.guard().map_err(EmulatorError::io("starting /bin/sh"))?);
        Ok(process)
    }

    /// Starts the guard, in its own process group: what ends this program must not end the guard as well.
    fn guard(&self) -> io::Result<Child> {
        Command::new("/bin/sh")
            .args(["-c", GUARD, "guard", &self.child.id().to_string()])
            .arg(&self.directory.path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .process_group(0)
            .spawn()
    }

    /// Exit status of the emulator, if it has ended.
    pub(crate) fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// The end of the emulator's output.
    pub(crate) fn said(&self) -> String {
        let bytes = fs::read(self.directory.join(OUTPUT_FILE)).unwrap_or_default();
        let start = bytes.len().saturating_sub(OUTPUT_SHOWN);
        let shown = bytes.get(start..).unwrap_or_default();
        String::from_utf8_lossy(shown).trim().to_owned()
    }

    /// Moves the black box that a firmware has left at its end to a file that outlives the emulator; `None` if there is
    /// none.
    pub(crate) fn take_black_box(&self) -> Option<PathBuf> {
        let from = self.directory.join(BLACK_BOX_FILE);
        let name = self.directory.path.file_name()?.to_string_lossy().into_owned();
        let to = std::env::temp_dir().join(format!("{name}-{BLACK_BOX_FILE}"));
        fs::rename(from, &to).ok().map(|()| to)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The guard goes first: once the emulator has been waited for, its process id can be reused. Killing fails only
        // if a process has ended already; `wait` then collects it.
        if let Some(guard) = &mut self.guard {
            let _ = guard.kill();
            let _ = guard.wait();
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Ends every emulator and removes its directory when a signal ends this program.
fn watch_signals() -> Result<(), EmulatorError> {
    static WATCH: Once = Once::new();
    let mut result = Ok(());
    WATCH.call_once(|| {
        result = Signals::new([SIGINT, SIGTERM, SIGHUP])
            .map(|mut signals| {
                std::thread::spawn(move || {
                    for signal in signals.forever() {
                        end_all();
                        // Ends this program as the signal would have without this handler.
                        let _ = signal_hook::low_level::emulate_default_handler(signal);
                    }
                });
            })
            .map_err(EmulatorError::io("watching for signals"));
    });
    result
}

fn end_all() {
    for entry in live().drain(..) {
        if let Some(pid) = entry.child.and_then(|id| Pid::from_raw(id as i32)) {
            // An emulator that has ended by itself needs no killing.
            let _ = kill_process(pid, Signal::KILL);
        }
        let _ = fs::remove_dir_all(&entry.directory);
    }
}
