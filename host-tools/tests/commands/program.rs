//! The program as a user starts it: temporary folders, supervised processes.

use rustix::process::{Pid, Signal, kill_process};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Longest wait; even a very busy machine needs less.
pub(crate) const PATIENCE: Duration = Duration::from_secs(180);
/// Time between two checks of a condition.
const LOOK: Duration = Duration::from_millis(10);
/// Longest wait for the rest of what an ended program has printed.
const REST: Duration = Duration::from_secs(10);

/// The short drawing.
pub(crate) fn strokes() -> PathBuf {
    host_tools::setup::workspace().join("samples/strokes.csv")
}

/// A test's own folder, removed when dropped.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("pentest-{}-{number}", std::process::id()));
        fs::create_dir(&path).expect("a folder for the test");
        Self(path)
    }

    pub(crate) fn join(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// A file with this content.
    pub(crate) fn file(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.join(name);
        fs::write(&path, content).expect("a file of the test");
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What cannot be removed is in the system's folder for temporary files.
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// The program, started in `folder`, its temporary files in `folder/tmp`, its log in `folder/state`.
pub(crate) fn etherpen(folder: &Folder) -> Command {
    let (temporary, runtime) = (folder.join("tmp"), folder.join("run"));
    fs::create_dir_all(&temporary).expect("a folder for temporary files");
    fs::create_dir_all(&runtime).expect("a folder for sockets");
    let mut command = Command::new(env!("CARGO_BIN_EXE_etherpen"));
    command
        .current_dir(&folder.0)
        .env("TMPDIR", &temporary)
        .env("XDG_RUNTIME_DIR", &runtime)
        .env("XDG_STATE_HOME", folder.join("state"))
        .env_remove("ETHERPEN_CONFIG")
        .env_remove("ETHERPEN_PORT")
        .stdin(Stdio::null());
    command
}

/// Runs the program to its end: exit code, stdout, stderr.
pub(crate) fn run(command: &mut Command) -> (Option<i32>, String, String) {
    let Output { status, stdout, stderr } = command.output().expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("the program prints UTF-8");
    (status.code(), text(stdout), text(stderr))
}

/// The running program.
pub(crate) struct Running {
    child: Child,
    stdout: Arc<Mutex<String>>,
    stderr: Arc<Mutex<String>>,
}

impl Running {
    pub(crate) fn start(command: &mut Command) -> Self {
        let piped = command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = piped.spawn().expect("the program starts");
        let stdout = collect(child.stdout.take().expect("it is piped"));
        let stderr = collect(child.stderr.take().expect("it is piped"));
        Self { child, stdout, stderr }
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    pub(crate) fn stdout(&self) -> String {
        self.stdout.lock().expect("nobody panics with it").clone()
    }

    pub(crate) fn stderr(&self) -> String {
        self.stderr.lock().expect("nobody panics with it").clone()
    }

    /// Sends a line to a program that was started with a pipe as its standard input.
    pub(crate) fn press_enter(&mut self) {
        self.type_line("");
    }

    /// Sends a line to a program that was started with a pipe as its standard input.
    pub(crate) fn type_line(&mut self, line: &str) {
        let input = self.child.stdin.as_mut().expect("standard input is a pipe");
        input
            .write_all(format!("{line}\n").as_bytes())
            .expect("the program reads");
    }

    /// Closes the standard input of a program that was started with a pipe as its standard input.
    pub(crate) fn close_input(&mut self) {
        drop(self.child.stdin.take());
    }

    /// Sends a signal.
    pub(crate) fn signal(&self, signal: Signal) {
        let pid = Pid::from_raw(self.id() as i32).expect("a process has a number");
        kill_process(pid, signal).expect("it is a child of this test");
    }

    /// Waits until `found` returns a value for a program that is still running.
    pub(crate) fn wait_for<T>(&mut self, what: &str, mut found: impl FnMut(&Self) -> Option<T>) -> T {
        let begun = Instant::now();
        loop {
            if let Some(thing) = found(self) {
                return thing;
            }
            let ended = self.child.try_wait().expect("a child can be asked");
            assert!(
                ended.is_none() && begun.elapsed() < PATIENCE,
                "no {what}; ended: {ended:?}; {}",
                self.stderr()
            );
            std::thread::sleep(LOOK);
        }
    }

    pub(crate) fn end(&mut self) -> ExitStatus {
        self.end_within(PATIENCE)
    }

    /// Reads the last of what an ended program has printed, unless a child of it keeps the pipes.
    fn read_the_rest(&self) {
        let ended = Instant::now();
        let are_read = || {
            [&self.stdout, &self.stderr]
                .iter()
                .all(|text| Arc::strong_count(text) == 1)
        };
        while !are_read() && ended.elapsed() < REST {
            std::thread::sleep(LOOK);
        }
    }

    /// Waits for the end of a program that may take longer than [`PATIENCE`].
    pub(crate) fn end_within(&mut self, patience: Duration) -> ExitStatus {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("a child can be asked") {
                self.read_the_rest();
                return status;
            }
            assert!(begun.elapsed() < patience, "the program did not end; {}", self.stderr());
            std::thread::sleep(LOOK);
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Fails only if the program has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Collects what a program prints; the text has one owner once the pipe has ended.
fn collect(pipe: impl Read + Send + 'static) -> Arc<Mutex<String>> {
    let text = Arc::new(Mutex::new(String::new()));
    let shared = text.clone();
    std::thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            let mut text = shared.lock().expect("nobody panics with it");
            text.push_str(&line);
            text.push('\n');
        }
    });
    text
}

/// Waits until a condition is true.
pub(crate) fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < PATIENCE, "{what} did not come");
        std::thread::sleep(LOOK);
    }
}

/// State letter and parent of a process, from its line in /proc (proc(5)); `None` when there is none.
fn process(stat: &Path) -> Option<(char, u32)> {
    let line = fs::read_to_string(stat).ok()?;
    let mut fields = line.rsplit_once(')')?.1.split_whitespace();
    Some((fields.next()?.chars().next()?, fields.next()?.parse().ok()?))
}

/// Whether a process is still running.
pub(crate) fn runs(id: u32) -> bool {
    process(&PathBuf::from(format!("/proc/{id}/stat"))).is_some_and(|(state, _)| state != 'Z')
}

/// The emulator that a running program has started.
pub(crate) fn emulator_of(parent: u32) -> Option<u32> {
    let entries = fs::read_dir("/proc").expect("this system has /proc");
    entries.flatten().find_map(|entry| {
        let id = entry.file_name().to_str()?.parse().ok()?;
        let (_, its_parent) = process(&entry.path().join("stat"))?;
        let name = fs::read_to_string(entry.path().join("comm")).ok()?;
        (its_parent == parent && name.starts_with("qemu-system")).then_some(id)
    })
}
