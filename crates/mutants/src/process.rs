//! Runs a program with a time limit, and ends it as soon as its output shows the result.
//!
//! What is wrong with the computer and not with the program (no such program, a signal from outside, a full disk) is an
//! error, never an ending.

use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

/// Address space of a program, KiB: a mutant that allocates without end must not take the computer's memory.
const MEMORY_KIB: u32 = 8 << 20;
/// Exit codes of the shell for a program that cannot be started.
const NOT_STARTED: [i32; 2] = [126, 127];
/// Signals that a program gets by its own fault: SIGILL, SIGTRAP, SIGABRT, SIGBUS, SIGFPE, SIGSEGV. Others come from
/// outside: from the user, or from a system without memory.
const CRASHES: [i32; 6] = [4, 5, 6, 7, 8, 11];
/// What a program prints that could not write a file.
const FULL: [&str; 2] = ["No space left on device", "Disk quota exceeded"];
/// Free disk space that a judge needs at least, bytes.
const ROOM: usize = 1 << 20;

/// How a program ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// It exited with this code.
    Exited(i32),
    /// It crashed with this signal.
    Crashed(i32),
    /// It was ended because its output showed the result.
    Enough,
    /// It was ended because it took too long.
    TimeOut,
}

/// A program that has ended.
#[derive(Clone, Debug)]
pub(crate) struct Ended {
    /// How the program ended.
    pub ending: Ending,
    /// Standard output and standard error, in the order of writing.
    pub output: String,
    /// Time between start and end.
    pub elapsed: Duration,
}

/// A command whose program has limited memory.
#[must_use]
pub(crate) fn limited_command(program: &Path) -> Command {
    let mut command = Command::new("sh");
    command
        .args([
            "-c",
            &format!("ulimit -v {MEMORY_KIB} 2>&1 || exit 126; exec \"$0\" \"$@\" 2>&1"),
        ])
        .arg(program);
    command
}

/// Runs a command of [`limited_command`] until it ends, its output is `enough`, or `limit` has passed.
///
/// # Errors
/// The program cannot be started, is killed from outside, or fails because the disk is full.
pub(crate) fn run(command: &mut Command, limit: Duration, enough: impl Fn(&str) -> bool) -> Result<Ended, String> {
    let begun = Instant::now();
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .map_err(|error| format!("{}: {error}", command.get_program().display()))?;
    let mut pipe = child.stdout.take().ok_or("a program without output")?;
    let (sender, chunks) = mpsc::channel();
    // Ends with the pipe. A grandchild may hold the pipe longer than the program lives, so nobody waits for this thread.
    std::thread::spawn(move || {
        let mut buffer = [0; 4096];
        while let Ok(length @ 1..) = pipe.read(&mut buffer) {
            if sender.send(buffer[..length].to_vec()).is_err() {
                return;
            }
        }
    });
    let mut bytes = Vec::new();
    let mut output = String::new();
    let ending = loop {
        let left = limit.saturating_sub(begun.elapsed());
        match chunks.recv_timeout(left) {
            Ok(chunk) => {
                bytes.extend(chunk);
                output = String::from_utf8_lossy(&bytes).into_owned();
                if enough(&output) {
                    end(&mut child);
                    break Ending::Enough;
                }
            }
            Err(RecvTimeoutError::Timeout) => {
                end(&mut child);
                break Ending::TimeOut;
            }
            Err(RecvTimeoutError::Disconnected) => {
                let status = child.wait().map_err(|error| error.to_string())?;
                break ending_of(status).map_err(|what| format!("{}{what}: {}", shown(command), tail(&output)))?;
            }
        }
    };
    if ending != Ending::Exited(0) && FULL.iter().any(|text| output.contains(text)) {
        return Err(format!("{}ran on a full disk: {}", shown(command), tail(&output)));
    }
    Ok(Ended {
        ending,
        output,
        elapsed: begun.elapsed(),
    })
}

/// The last lines of an output.
#[must_use]
pub(crate) fn tail(output: &str) -> &str {
    const LINES: usize = 20;
    let start = output.trim_end().rmatch_indices('\n').nth(LINES - 1);
    output[start.map_or(0, |(place, _)| place + 1)..].trim_end()
}

/// A command's program and arguments, with a space behind each.
fn shown(command: &Command) -> String {
    // `sh -c`, and what the shell does.
    let words = command.get_args().skip(2);
    words.map(|word| format!("{} ", word.display())).collect()
}

/// How a program ended by itself.
///
/// # Errors
/// It was not started, or was killed from outside.
fn ending_of(status: ExitStatus) -> Result<Ending, String> {
    match (status.code(), status.signal()) {
        (Some(code), _) if NOT_STARTED.contains(&code) => Err("cannot be started".to_owned()),
        (Some(code), _) => Ok(Ending::Exited(code)),
        (None, Some(signal)) if CRASHES.contains(&signal) => Ok(Ending::Crashed(signal)),
        (None, signal) => Err(format!("was killed from outside, signal {}", signal.unwrap_or(0))),
    }
}

/// Checks that a folder's disk has room for what a program writes.
///
/// # Errors
/// It has none, or the folder cannot be written.
pub(crate) fn check_room(folder: &Path) -> Result<(), String> {
    let file = folder.join(format!(".etherpen-mutants-room-{}", std::process::id()));
    let written = std::fs::write(&file, vec![0; ROOM]);
    // The file may not exist.
    let _ = std::fs::remove_file(&file);
    written.map_err(|error| format!("no room in {}: {error}", folder.display()))
}

/// Ends a program that may have ended already.
fn end(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Command {
        let mut command = limited_command(Path::new("sh"));
        command.args(["-c", script]);
        command
    }

    const LONG: Duration = Duration::from_secs(60);

    #[test]
    fn a_program_ends_by_itself_by_its_output_or_by_the_time() {
        let ended = run(&mut shell("echo one; echo two >&2"), LONG, |_| false).unwrap();
        assert_eq!((ended.ending, ended.output.as_str()), (Ending::Exited(0), "one\ntwo\n"));
        let ended = run(&mut shell("exit 3"), LONG, |_| false).unwrap();
        assert_eq!(ended.ending, Ending::Exited(3));
        let ended = run(&mut shell("kill -ABRT $$"), LONG, |_| false).unwrap();
        assert_eq!(ended.ending, Ending::Crashed(6));
        let ended = run(&mut shell("echo bad; exec sleep 60"), LONG, |text| text.contains("bad")).unwrap();
        assert_eq!(ended.ending, Ending::Enough);
        let ended = run(&mut shell("exec sleep 60"), Duration::from_millis(50), |_| false).unwrap();
        assert_eq!(ended.ending, Ending::TimeOut);
    }

    #[test]
    fn a_message_quotes_the_last_lines() {
        let output: String = (1..=30).map(|line| format!("{line}\n")).collect();
        let last = tail(&output);
        assert!(last.starts_with("11\n12\n") && last.ends_with("\n30"), "{last}");
        assert_eq!((tail("one\n\n"), tail("")), ("one", ""));
    }

    #[test]
    fn what_is_wrong_with_the_computer_is_an_error_and_no_ending() {
        let failure = |command: &mut Command| run(command, LONG, |_| false).unwrap_err();
        let missing = failure(&mut limited_command(Path::new("/no/such/program")));
        assert!(missing.starts_with("/no/such/program cannot be started: "), "{missing}");
        // A folder is no program.
        let folder = failure(&mut limited_command(Path::new("/")));
        assert!(folder.contains("cannot be started"), "{folder}");
        for code in NOT_STARTED {
            let refused = failure(&mut shell(&format!("exit {code}")));
            assert!(refused.contains("cannot be started"), "{refused}");
        }
        for (name, number) in [("KILL", 9), ("TERM", 15), ("USR1", 10)] {
            let killed = failure(&mut shell(&format!("kill -{name} $$")));
            assert!(killed.contains(&format!("from outside, signal {number}")), "{killed}");
        }
        let full = failure(&mut shell("echo 'write: No space left on device'; exit 101"));
        assert!(full.contains("full disk"), "{full}");
    }

    #[test]
    fn a_folder_without_room_is_an_error_and_one_with_room_stays_as_it_was() {
        let folder = std::env::temp_dir().join(format!("etherpen-mutants-room-{}", std::process::id()));
        assert!(check_room(&folder).unwrap_err().contains("no room in"));
        std::fs::create_dir_all(&folder).unwrap();
        assert_eq!(check_room(&folder), Ok(()));
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
