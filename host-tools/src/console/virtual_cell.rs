//! A complete virtual robot: the firmware and the virtual cell, behind a socket like any other port.
//!
//! Simulated: the firmware's tasks run in this process at the pace of the wall clock. Emulated: the firmware image runs
//! in QEMU. At the other end of the socket there is no difference from a board. Invariant: the cell outlives the
//! firmware: after a restart the firmware finds drives and robot in their present state.

use super::messages::Injection;
use crate::cell::{Cell, CellOptions, CellState, Fault, InkStroke, ResolverFault};
use crate::emulator::{self, ClientSlot, Emulator, EmulatorError, LINK_BYTES_MAX, Later, Link, Options, Pace, Segment};
use crate::link::ownership::{CELL_SOCKET, remove_if_left_behind};
use crate::link::port::PortName;
use crate::simulation::{self, Host};
use etherpen::config::Config;
use std::io::{self, ErrorKind};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Largest lag behind the wall clock that is caught up, ms.
const LAG_MAX_MS: u64 = 50;
/// Time between two checks of a running emulator.
const LOOK: Duration = Duration::from_millis(50);
/// Error code of an injected drive fault: following error, from the profile's table.
const DRIVE_ERROR: u16 = 0x8611;
/// AL status code of an injected fallback: sync manager watchdog.
const AL_WATCHDOG: u16 = 0x001B;
/// Duration of an injected loss of power, of a resolver or of all frames, ms.
const POWER_MS: u64 = 1_000;
const STUCK_MS: u64 = 200;
const STALL_MS: u64 = 50;
/// Makes the names of the sockets of one process different.
static SOCKETS: AtomicU32 = AtomicU32::new(0);

/// Firmware that runs.
#[derive(Clone, Debug)]
pub enum Firmware {
    /// The tasks in this process.
    Simulated,
    /// This image in QEMU.
    Emulated(PathBuf),
}

/// A cell shared by several threads.
#[derive(Clone)]
struct SharedCell(Arc<Mutex<Cell>>);

impl SharedCell {
    fn lock(&self) -> MutexGuard<'_, Cell> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Segment for SharedCell {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.lock().frame(time_us, frame)
    }

    fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.lock().frame_at_ns(time_ns, frame)
    }

    fn advance_to(&mut self, time_us: u64) {
        self.lock().advance_to(time_us);
    }
}

/// The serial line as a Unix socket: one client at a time.
struct Socket {
    listener: UnixListener,
    client: ClientSlot<UnixStream>,
}

impl Socket {
    fn exchange(&mut self, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        if let Ok((client, _)) = self.listener.accept()
            && client.set_nonblocking(true).is_ok()
        {
            self.client.take(client);
        }
        self.client.exchange(from_firmware, to_firmware, room);
    }
}

/// State shared by the threads.
struct Shared {
    socket: Mutex<Socket>,
    ended: AtomicBool,
    restart: AtomicBool,
    /// Time of the cell's clock, us.
    cell_us: Mutex<u64>,
    failure: Mutex<Option<String>>,
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A simulated firmware's line, paced by the wall clock.
struct PacedLine {
    shared: Arc<Shared>,
    begun: Instant,
    begun_us: u64,
}

impl Host for PacedLine {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        lock(&self.shared.socket).exchange(from_firmware, to_firmware, room);
        *lock(&self.shared.cell_us) = self.begun_us + u64::from(ms) * 1_000;
        let due = Duration::from_millis(ms.into());
        let passed = self.begun.elapsed();
        if let Some(early) = due.checked_sub(passed) {
            thread::sleep(early);
        } else if passed > due + Duration::from_millis(LAG_MAX_MS) {
            self.begun = Instant::now().checked_sub(due).unwrap_or(self.begun);
        }
    }

    fn is_over(&self) -> bool {
        self.shared.ended.load(Ordering::Relaxed) || self.shared.restart.load(Ordering::Relaxed)
    }
}

/// An emulated firmware's line.
struct EmulatedLine {
    shared: Arc<Shared>,
    begun_us: u64,
}

impl Link for EmulatedLine {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        lock(&self.shared.socket).exchange(from_device, to_device, LINK_BYTES_MAX);
        *lock(&self.shared.cell_us) = self.begun_us + u64::from(ms) * 1_000;
    }
}

/// True state of a cell, independent of its firmware; for tests and displays.
#[derive(Clone)]
pub struct CellView(SharedCell);

impl CellView {
    /// The present state of the cell.
    #[must_use]
    pub fn state(&self) -> CellState {
        self.0.lock().state()
    }
}

/// A running cell with its firmware; dropping it ends both.
pub struct VirtualCell {
    cell: SharedCell,
    shared: Arc<Shared>,
    path: PathBuf,
    thread: Option<JoinHandle<()>>,
}

/// Removes the sockets of killed programs.
fn remove_left_behind(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    entries.flatten().for_each(|entry| remove_if_left_behind(&entry.path()));
}

impl VirtualCell {
    /// Starts a cell and a firmware; [`VirtualCell::port`] returns the port.
    ///
    /// # Errors
    /// The socket cannot be made.
    pub fn start(config: &Config, options: CellOptions, firmware: Firmware) -> io::Result<Self> {
        let number = SOCKETS.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir();
        remove_left_behind(&folder);
        let path = folder.join(format!("{CELL_SOCKET}{}-{number}.sock", std::process::id()));
        if let Err(error) = std::fs::remove_file(&path)
            && error.kind() != ErrorKind::NotFound
        {
            return Err(error);
        }
        let listener = UnixListener::bind(&path)?;
        listener.set_nonblocking(true)?;
        let shared = Arc::new(Shared {
            socket: Mutex::new(Socket {
                listener,
                client: ClientSlot::empty(),
            }),
            ended: AtomicBool::new(false),
            restart: AtomicBool::new(false),
            cell_us: Mutex::new(0),
            failure: Mutex::new(None),
        });
        let cell = SharedCell(Arc::new(Mutex::new(Cell::new(config, options))));
        let thread = thread::Builder::new().name("firmware".to_owned()).spawn({
            let (shared, cell) = (shared.clone(), cell.clone());
            move || run(&shared, &cell, &firmware)
        })?;
        Ok(Self {
            cell,
            shared,
            path,
            thread: Some(thread),
        })
    }

    /// The port of the firmware.
    pub fn port(&self) -> PortName {
        PortName::Unix(self.path.clone())
    }

    /// A view of the cell, which stays valid when the cell has another owner.
    #[must_use]
    pub fn view(&self) -> CellView {
        CellView(self.cell.clone())
    }

    /// Why the firmware no longer runs, if it does not.
    pub fn failure(&self) -> Option<String> {
        lock(&self.shared.failure).clone()
    }

    /// The ink on the paper so far; the last stroke may still grow.
    pub fn ink(&self) -> Vec<InkStroke> {
        self.cell.lock().ink().to_vec()
    }

    /// The present true state of the cell, independent of any message.
    pub fn state(&self) -> CellState {
        self.cell.lock().state()
    }

    /// Injects a fault; returns a text for display, or why it is not possible.
    ///
    /// # Errors
    /// The slave does not exist.
    pub fn inject(&self, injection: Injection) -> Result<String, String> {
        let slaves = self.cell.lock().state().slaves.len();
        let exists = |slave: usize| match (1..=slaves).contains(&slave) {
            true => Ok(slave),
            false => Err(format!("there is no slave {slave}, the chain has {slaves}")),
        };
        let (fault, text) = match injection {
            Injection::Restart => {
                self.shared.restart.store(true, Ordering::Relaxed);
                return Ok("the firmware is being restarted".to_owned());
            }
            Injection::Remove { slave } => (Fault::Remove(exists(slave)?), format!("slave {slave} is unplugged")),
            Injection::Insert { slave } => (Fault::Insert(exists(slave)?), format!("slave {slave} is plugged in")),
            Injection::Fault { slave } => (
                Fault::Drive(exists(slave)?, DRIVE_ERROR),
                format!("drive {slave} faults with {DRIVE_ERROR:#06x}"),
            ),
            Injection::Retreat { slave } => (
                Fault::Retreat(exists(slave)?, AL_WATCHDOG),
                format!("slave {slave} falls back to SAFEOP"),
            ),
            Injection::Power { slave } => (
                Fault::Power(exists(slave)?, POWER_MS),
                format!("slave {slave} is without power for {POWER_MS} ms"),
            ),
            Injection::Stuck { slave } => (
                Fault::Resolver(exists(slave)?, ResolverFault::Stuck, STUCK_MS),
                format!("the resolver of drive {slave} freezes for {STUCK_MS} ms"),
            ),
            Injection::Cut { slave: 0 } => (Fault::Cut(0), "the master's cable is pulled".to_owned()),
            Injection::Cut { slave } => (
                Fault::Cut(exists(slave)?),
                format!("the cable behind slave {slave} is pulled"),
            ),
            Injection::Join => (Fault::Join, "all cables are plugged in".to_owned()),
            Injection::Stall => (
                Fault::Stall(STALL_MS),
                format!("no frame gets through for {STALL_MS} ms"),
            ),
            Injection::Lose => (Fault::Lose, "one reply is lost".to_owned()),
        };
        self.cell.lock().inject(fault);
        Ok(text)
    }
}

impl Drop for VirtualCell {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A firmware that panicked has ended as well.
            let _ = thread.join();
        }
        // The socket may already be gone.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Runs one firmware after the other until the cell is dropped or a firmware fails.
fn run(shared: &Arc<Shared>, cell: &SharedCell, firmware: &Firmware) {
    while !shared.ended.load(Ordering::Relaxed) {
        shared.restart.store(false, Ordering::Relaxed);
        let begun_us = *lock(&shared.cell_us);
        let mut later = Later {
            segment: cell.clone(),
            begun_us,
        };
        let result = match firmware {
            Firmware::Simulated => {
                let mut line = PacedLine {
                    shared: shared.clone(),
                    begun: Instant::now(),
                    begun_us,
                };
                simulation::run(&mut later, &mut line, u32::MAX);
                Ok(())
            }
            Firmware::Emulated(image) => emulate(shared, image, later, begun_us),
        };
        if let Err(error) = result {
            *lock(&shared.failure) = Some(error.to_string());
            return;
        }
    }
}

fn emulate(shared: &Arc<Shared>, image: &Path, cell: Later<SharedCell>, begun_us: u64) -> Result<(), EmulatorError> {
    let options = Options {
        pace: Pace::RealTime,
        decode_log: false,
        ..Options::default()
    };
    let line = EmulatedLine {
        shared: shared.clone(),
        begun_us,
    };
    let emulator = Emulator::start(image, &options, cell, line, |_: &emulator::LogLine| {})?;
    while emulator.is_running() {
        if shared.ended.load(Ordering::Relaxed) || shared.restart.load(Ordering::Relaxed) {
            return emulator.stop().map(|_| ());
        }
        thread::sleep(LOOK);
    }
    emulator.wait().map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_of_a_slave_that_is_not_there_is_refused() {
        let cell = VirtualCell::start(&Config::default(), CellOptions::default(), Firmware::Simulated).unwrap();
        assert!(cell.inject(Injection::Remove { slave: 2 }).is_ok());
        for slave in [0, 5, usize::MAX] {
            assert!(cell.inject(Injection::Fault { slave }).is_err());
        }
        assert_eq!(cell.failure(), None);
    }

    #[test]
    fn sockets_of_killed_consoles_are_removed_and_those_in_use_are_not() {
        let folder = std::env::temp_dir().join(format!("etherpen-cells-{}", std::process::id()));
        std::fs::create_dir(&folder).unwrap();
        // No process has this number (pid_max is 2^22 at most).
        let [killed, alive, other] = [
            "etherpen-console-4194305-0.sock",
            "etherpen-console-4194305-1.sock",
            "notes.sock",
        ]
        .map(|name| folder.join(name));
        drop(UnixListener::bind(&killed).unwrap());
        drop(UnixListener::bind(&other).unwrap());
        let listener = UnixListener::bind(&alive).unwrap();
        remove_left_behind(&folder);
        assert!(!killed.exists() && alive.exists() && other.exists());
        drop(listener);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
