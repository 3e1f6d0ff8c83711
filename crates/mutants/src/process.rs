//! Runs a program with a time limit, and ends it as soon as its output says enough.

use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

/// Address space of a program, KiB: a mutant that allocates without end must not take the computer's memory.
const MEMORY_KIB: u32 = 8 << 20;

/// How a program ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// By itself; whether with success.
    Exited(bool),
    /// Its output said enough.
    Enough,
    /// It took too long.
    TimeOut,
}

/// A program that has ended.
#[derive(Clone, Debug)]
pub(crate) struct Ended {
    /// How.
    pub ending: Ending,
    /// Its output and, behind it, its messages.
    pub output: String,
    /// How long it ran.
    pub elapsed: Duration,
}

/// A command whose program has limited memory.
#[must_use]
pub(crate) fn limited_command(program: &Path) -> Command {
    let mut command = Command::new("sh");
    command
        .args(["-c", &format!("ulimit -v {MEMORY_KIB}; exec \"$0\" \"$@\" 2>&1")])
        .arg(program);
    command
}

/// Runs a command until it ends, its output is `enough`, or `limit` has passed.
///
/// # Errors
/// The program cannot be started.
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
                break Ending::Exited(status.success());
            }
        }
    };
    Ok(Ended {
        ending,
        output,
        elapsed: begun.elapsed(),
    })
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
        assert_eq!(
            (ended.ending, ended.output.as_str()),
            (Ending::Exited(true), "one\ntwo\n")
        );
        let ended = run(&mut shell("exit 3"), LONG, |_| false).unwrap();
        assert_eq!(ended.ending, Ending::Exited(false));
        let ended = run(&mut shell("echo bad; exec sleep 60"), LONG, |text| text.contains("bad")).unwrap();
        assert_eq!(ended.ending, Ending::Enough);
        let ended = run(&mut shell("exec sleep 60"), Duration::from_millis(50), |_| false).unwrap();
        assert_eq!(ended.ending, Ending::TimeOut);
    }

    #[test]
    fn a_program_that_does_not_exist_fails() {
        let ended = run(&mut limited_command(Path::new("/no/such/program")), LONG, |_| false).unwrap();
        assert_eq!(ended.ending, Ending::Exited(false));
    }
}
