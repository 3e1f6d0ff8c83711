//! Port ownership: one program at a time uses a port; other programs find that program and send it their orders.
//!
//! Each port in use has a lock file in the user's runtime folder and, if the owner shares its machine, a Unix socket.
//! The lock is the kernel's (flock): it ends with its process, however that ends. Files left by a killed program are
//! removed by the next program that takes or searches a port, together with the socket of a virtual cell that was the
//! killed program's port.
//! Programs that do not use these lock files are found through the open files of this user's processes.
//!
//! Invariant: while an [`Ownership`] exists, no other program with this protocol opens the port.

use super::port_name::PortName;
use crate::hash::fnv1a;
use rustix::fs::{FlockOperation, Mode, flock};
use serde::{Deserialize, Serialize};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Attempts to lock a file that was removed meanwhile, or is being examined.
const ATTEMPTS_MAX: usize = 8;
/// Time between two attempts.
const ATTEMPT: Duration = Duration::from_millis(10);
/// Suffixes of a port's files.
const LOCK: &str = "lock";
const SOCKET: &str = "sock";
/// Longest part of a file name made from a port's name, bytes: a Unix socket's path has at most 108.
const NAME_BYTES_MAX: usize = 40;

/// Beginning of the name of a virtual cell's socket; its process and a number follow.
pub(crate) const CELL_SOCKET: &str = "etherpen-console-";

/// A program that has a port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Owner {
    /// Its process.
    pub pid: u32,
    /// Its name, and what it does with the port if that is known.
    pub program: String,
}

impl std::fmt::Display for Owner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} (process {})", self.program, self.pid)
    }
}

impl Owner {
    /// This process.
    pub fn this() -> Self {
        let command = std::env::args().nth(1).filter(|word| !word.starts_with('-'));
        let name = std::env::args_os().next().map(PathBuf::from);
        let name = name
            .as_deref()
            .and_then(Path::file_stem)
            .map_or_else(|| "etherpen".to_owned(), |name| name.to_string_lossy().into_owned());
        Self {
            pid: std::process::id(),
            program: command.map_or(name.clone(), |command| format!("{name} {command}")),
        }
    }

    /// Whether its process is running.
    fn lives(&self) -> bool {
        Path::new("/proc").join(self.pid.to_string()).exists()
    }
}

/// A port in use by a program of this user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InUse {
    /// The port, by its canonical name.
    pub port: PortName,
    /// The program.
    pub owner: Owner,
    /// Whether the program carries out orders of other programs.
    pub shares: bool,
}

/// Content of a lock file.
#[derive(Serialize, Deserialize)]
struct Held {
    #[serde(flatten)]
    owner: Owner,
    #[serde(default)]
    port: String,
}

/// Ownership of a port, until it is dropped.
#[derive(Debug)]
pub struct Ownership {
    path: PathBuf,
    _lock: File,
}

impl Ownership {
    /// Takes the ownership of a port, or returns its present owner.
    ///
    /// # Errors
    /// The folder or the file cannot be used.
    pub fn take(port: &PortName) -> io::Result<Result<Self, Owner>> {
        let path = beside(port, LOCK)?;
        let mut busy = None;
        for _ in 0..ATTEMPTS_MAX {
            match lock(&path)? {
                Locking::Locked(mut lock) => {
                    let held = Held {
                        owner: Owner::this(),
                        port: canonical(port).to_string(),
                    };
                    lock.set_len(0)?;
                    lock.write_all(&serde_json::to_vec(&held)?)?;
                    // Files left behind that cannot be removed do no harm.
                    let _ = in_use();
                    return Ok(Ok(Self { path, _lock: lock }));
                }
                Locking::Gone => {}
                Locking::Busy(held) => {
                    let owner = held.map(|held| held.owner);
                    if owner.as_ref().is_some_and(Owner::lives) {
                        return Ok(Err(owner.unwrap_or_else(unknown)));
                    }
                    // A program that removes a stale lock holds it for a moment.
                    busy = Some(owner.unwrap_or_else(unknown));
                    std::thread::sleep(ATTEMPT);
                }
            }
        }
        match busy {
            Some(owner) => Ok(Err(owner)),
            None => Err(io::Error::other("the port's lock file comes and goes")),
        }
    }
}

/// Result of an attempt to lock a file.
enum Locking {
    Locked(File),
    /// Another program has the lock; with the content of the file if it can be read.
    Busy(Option<Held>),
    /// The previous owner removed the file between opening and locking.
    Gone,
}

/// Locks a file; creates it if it is missing.
fn lock(path: &Path) -> io::Result<Locking> {
    let mut options = OpenOptions::new();
    let mut lock = options.read(true).write(true).create(true).mode(0o600).open(path)?;
    match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => {}
        Err(rustix::io::Errno::WOULDBLOCK) => return Ok(Locking::Busy(held_in(&mut lock))),
        Err(error) => return Err(error.into()),
    }
    let is_there = std::fs::metadata(path).is_ok_and(|there| {
        lock.metadata()
            .is_ok_and(|locked| (locked.dev(), locked.ino()) == (there.dev(), there.ino()))
    });
    Ok(if is_there { Locking::Locked(lock) } else { Locking::Gone })
}

/// The ports in use by programs of this user, sorted by name. Files of killed programs are removed.
///
/// # Errors
/// The runtime folder cannot be used.
pub fn in_use() -> io::Result<Vec<InUse>> {
    let folder = folder()?;
    let entries = std::fs::read_dir(&folder)?.flatten();
    let is_ours = |path: &PathBuf| path.extension().is_some_and(|end| end == LOCK || end == SOCKET);
    let mut stems: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_ours).collect();
    stems.iter_mut().for_each(|path| {
        path.set_extension("");
    });
    stems.sort();
    stems.dedup();
    Ok(stems.iter().filter_map(|stem| port_in_use(stem)).collect())
}

/// The port of a lock file, if a program uses it; otherwise removes its files.
fn port_in_use(stem: &Path) -> Option<InUse> {
    let (path, socket) = (stem.with_extension(LOCK), stem.with_extension(SOCKET));
    for _ in 0..ATTEMPTS_MAX {
        match lock(&path).ok()? {
            Locking::Locked(mut lock) => {
                let port = held_in(&mut lock).and_then(|held| held.port.parse().ok());
                if let Some(PortName::Unix(path)) = port {
                    remove_if_left_behind(&path);
                }
                // While the lock is held nobody takes the port, so no socket in use is removed.
                let _ = std::fs::remove_file(&socket);
                let _ = std::fs::remove_file(&path);
                return None;
            }
            Locking::Busy(Some(held)) => {
                return Some(InUse {
                    port: held.port.parse().ok()?,
                    owner: held.owner,
                    shares: socket.exists(),
                });
            }
            // Its owner has just taken the port, or has just ended.
            Locking::Busy(None) | Locking::Gone => std::thread::sleep(ATTEMPT),
        }
    }
    None
}

/// Removes the socket of a virtual cell if its process has gone and nobody listens there.
pub(crate) fn remove_if_left_behind(path: &Path) {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let rest = name.strip_prefix(CELL_SOCKET).and_then(|rest| rest.split_once('-'));
    let Some(process) = rest.and_then(|(process, _)| process.parse::<u32>().ok()) else {
        return;
    };
    let has_ended = !Path::new("/proc").join(process.to_string()).exists();
    let refuses = || UnixStream::connect(path).is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused);
    if has_ended && refuses() {
        // A socket that cannot be removed does no harm.
        let _ = std::fs::remove_file(path);
    }
}

impl Drop for Ownership {
    fn drop(&mut self) {
        // A file that stays is taken over by the next owner.
        let _ = std::fs::remove_file(&self.path);
    }
}

fn held_in(lock: &mut File) -> Option<Held> {
    let mut text = String::new();
    let read = lock.rewind().and_then(|()| lock.read_to_string(&mut text));
    read.ok().and_then(|_| serde_json::from_str(&text).ok())
}

fn unknown() -> Owner {
    Owner {
        pid: 0,
        program: "another etherpen".into(),
    }
}

/// Path of the socket on which an owner shares its machine.
///
/// # Errors
/// There is no folder for the socket.
pub fn socket_path(port: &PortName) -> io::Result<PathBuf> {
    beside(port, SOCKET)
}

fn beside(port: &PortName, extension: &str) -> io::Result<PathBuf> {
    Ok(folder()?.join(format!("{}.{extension}", safe_name(port))))
}

/// A folder that only this user can enter.
fn folder() -> io::Result<PathBuf> {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    let user = rustix::process::getuid();
    let folder = match runtime.filter(|runtime| runtime.is_absolute() && runtime.is_dir()) {
        Some(runtime) => runtime.join("etherpen"),
        None => std::env::temp_dir().join(format!("etherpen-{}", user.as_raw())),
    };
    match std::fs::DirBuilder::new().mode(0o700).create(&folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    let there = std::fs::symlink_metadata(&folder)?;
    let foreign = Mode::RWXG | Mode::RWXO;
    if !there.is_dir() || there.uid() != user.as_raw() || Mode::from_raw_mode(there.mode()).intersects(foreign) {
        let text = format!("{} is not a folder of this user alone", folder.display());
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, text));
    }
    Ok(folder)
}

/// The canonical name of a port: all names of one device give one name, in any working directory.
fn canonical(port: &PortName) -> PortName {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let canonical = |path: &Path| std::fs::canonicalize(path).unwrap_or_else(|_| absolute(path));
    match port {
        PortName::Serial(path) => PortName::Serial(canonical(path)),
        PortName::Unix(path) => PortName::Unix(canonical(path)),
        PortName::Tcp(address) => PortName::Tcp(address.replacen("localhost:", "127.0.0.1:", 1)),
    }
}

/// The port's name as a file name.
fn safe_name(port: &PortName) -> String {
    let name = canonical(port).to_string();
    let safe = name
        .chars()
        .map(|letter| if letter.is_ascii_alphanumeric() { letter } else { '_' });
    let safe: String = safe.collect();
    let safe = safe.trim_matches('_');
    // Names differ at their end; the hash distinguishes names that are cut or differ in replaced characters.
    let start = safe.len().saturating_sub(NAME_BYTES_MAX);
    format!(
        "{}-{:08x}",
        safe.get(start..).unwrap_or(safe),
        fnv1a(name.bytes()) as u32
    )
}

/// Another program that has a device open, as far as this user can see.
pub fn holder_of(device: &Path) -> Option<Owner> {
    let device = std::fs::canonicalize(device).ok()?;
    let processes = std::fs::read_dir("/proc").ok()?;
    let numbered = processes.flatten().filter_map(|entry| {
        let pid: u32 = entry.file_name().to_str()?.parse().ok()?;
        (pid != std::process::id()).then_some((pid, entry.path()))
    });
    let mut holders = numbered.filter_map(|(pid, process)| {
        let mut files = std::fs::read_dir(process.join("fd")).ok()?.flatten();
        files.find(|file| std::fs::read_link(file.path()).is_ok_and(|target| target == device))?;
        let program = std::fs::read_to_string(process.join("comm")).unwrap_or_else(|_| "a program".into());
        let program = program.trim().to_owned();
        Some(Owner { pid, program })
    });
    holders.next()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn port(text: &str) -> PortName {
        text.parse().expect("the name of a port")
    }

    #[test]
    fn a_port_has_one_owner_and_another_one_after_it() {
        let port = port(&format!("unix:/absent/etherpen-ownership-{}", std::process::id()));
        let first = Ownership::take(&port).unwrap().unwrap();
        let refused = Ownership::take(&port).unwrap().unwrap_err();
        assert_eq!(refused.pid, std::process::id());
        drop(first);
        assert!(Ownership::take(&port).unwrap().is_ok());
    }

    #[test]
    fn a_lock_file_left_behind_does_not_lock() {
        let port = port(&format!("unix:/absent/etherpen-stale-{}", std::process::id()));
        std::fs::write(beside(&port, LOCK).unwrap(), "{\"pid\":1,\"program\":\"gone\"}").unwrap();
        assert!(Ownership::take(&port).unwrap().is_ok());
    }

    #[test]
    fn files_of_killed_programs_are_removed_and_those_of_a_living_one_are_not() {
        let port = |name: &str| port(&format!("unix:/absent/etherpen-{name}-{}", std::process::id()));
        let (killed, without_lock, living) = (port("killed"), port("lockless"), port("living"));
        std::fs::write(
            beside(&killed, LOCK).unwrap(),
            "{\"pid\":4194305,\"program\":\"gone\",\"port\":\"\"}",
        )
        .unwrap();
        for port in [&killed, &without_lock] {
            drop(std::os::unix::net::UnixListener::bind(socket_path(port).unwrap()).unwrap());
        }
        let owned = Ownership::take(&living).unwrap().unwrap();
        let socket = std::os::unix::net::UnixListener::bind(socket_path(&living).unwrap()).unwrap();
        let found = in_use().unwrap();
        let ours: Vec<_> = found.iter().filter(|found| found.port == living).collect();
        assert!(
            matches!(ours.as_slice(), [found] if found.shares && found.owner == Owner::this()),
            "{found:?}"
        );
        for port in [&killed, &without_lock] {
            assert!(!socket_path(port).unwrap().exists() && !beside(port, LOCK).unwrap().exists());
        }
        assert!(socket_path(&living).unwrap().exists());
        drop((socket, owned));
        std::fs::remove_file(socket_path(&living).unwrap()).unwrap();
        assert!(in_use().unwrap().iter().all(|found| found.port != living));
    }

    #[test]
    fn names_of_one_port_agree_and_names_of_two_differ() {
        assert_eq!(
            safe_name(&port("tcp:localhost:70")),
            safe_name(&port("tcp:127.0.0.1:70"))
        );
        assert_ne!(safe_name(&port("unix:/a/b")), safe_name(&port("unix:/a_b")));
        let long = |end: char| safe_name(&port(&format!("unix:/{}{end}", "x".repeat(300))));
        assert_ne!(long('a'), long('b'));
        assert!(long('a').len() < 80);
    }

    #[test]
    fn a_program_that_has_a_file_open_is_found_by_name_and_process() {
        let path = std::env::temp_dir().join(format!("etherpen-held-{}", std::process::id()));
        std::fs::write(&path, "").unwrap();
        let file = File::open(&path).unwrap();
        let mut child = std::process::Command::new("sleep")
            .arg("60")
            .stdin(file)
            .spawn()
            .unwrap();
        let holder = holder_of(&path);
        child.kill().unwrap();
        child.wait().unwrap();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(
            holder.map(|holder| (holder.pid, holder.program)),
            Some((child.id(), "sleep".into()))
        );
    }
}
