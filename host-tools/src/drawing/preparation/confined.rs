//! Converts external files into strokes in a separate process, with limits on memory and processor time.
//!
//! The readers already limit what they make of a file. If these limits, the ordering's search or a library fail, only
//! the separate process ends: a console that draws continues, and the error describes what the file caused. The process
//! is this program with a hidden command. It gets the file's content on standard input and answers on standard output,
//! so it needs no file permissions except for fonts.
//!
//! `order`, `vectorize` and `preview --debug` read their file in their own process: nothing else runs there, and they move no
//! robot.

use super::compose::{Composed, compose_content};
use super::overview::{Overview, PhotographPart};
use super::source::SourceArguments;
use super::wire::{from_wire, to_wire};
use crate::drawing::{Drawing, Layer};
use crate::error::{ProgramError, code};
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use image::RgbImage;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use signal_hook::consts::{SIGABRT, SIGINT, SIGKILL, SIGSEGV, SIGTERM};
use std::io::{self, Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

/// Most memory that the process may map, bytes. The largest picture accepted takes a quarter of it.
const MEMORY_MAX_BYTES: u64 = 4 << 30;
/// Most processor time of the process, s: ten times the time for the largest sample.
const PROCESSOR_MAX_S: u64 = 120;
/// Most bytes of its answer: a path of all points that are accepted, and a picture.
const ANSWER_MAX_BYTES: u64 = 2 << 30;
/// Signal for exhausted processor time.
const SIGXCPU: i32 = 24;
/// The hidden command.
pub const COMMAND: &str = "compose-confined";

/// Whether this program has the hidden command.
static IS_ENABLED: AtomicBool = AtomicBool::new(false);

/// Declares that this program has the hidden command; without it files are read in the caller's process.
pub fn enable() {
    IS_ENABLED.store(true, Ordering::Relaxed);
}

/// Whether files are read in a separate process.
pub(super) fn is_enabled() -> bool {
    IS_ENABLED.load(Ordering::Relaxed)
}

/// Request to the process; the file's content follows.
#[derive(Serialize, Deserialize)]
struct Request {
    name: String,
    config: Config,
    options: SourceArguments,
}

/// Answer of the process; the bytes of the picture and of its overview follow.
#[derive(Serialize, Deserialize)]
enum Answer {
    Composed {
        /// Width and height of the picture, pixels, and its place on the sheet, mm.
        photograph: Option<([u32; 2], [f64; 4])>,
        /// The part that is drawn, and width and height of the small copy, pixels.
        overview: Option<(PhotographPart, [u32; 2])>,
        parts: Vec<(Layer, Drawing)>,
        path: Vec<PathVertex>,
        planned_s: Option<f64>,
    },
    Refused {
        code: u8,
        message: String,
    },
}

/// Reads, vectorises and orders a file's content in a separate process.
///
/// # Errors
/// Errors of [`compose_content`], and a failure of the process.
pub(super) fn compose(
    file: &Path,
    content: Vec<u8>,
    config: &Config,
    options: &SourceArguments,
) -> Result<Composed, ProgramError> {
    let failed = |cause: &dyn std::fmt::Display| ProgramError::failed("the file cannot be prepared", cause);
    let request = Request {
        name: file.to_string_lossy().into_owned(),
        config: config.clone(),
        options: options.clone(),
    };
    let request = framed(&request, content).map_err(|cause| failed(&cause))?;
    // This program itself, even if its file has been replaced since.
    let mut command = Command::new("/proc/self/exe");
    command.arg(COMMAND);
    let (status, answer) = exchange(&mut command, request).map_err(|cause| failed(&cause))?;
    if let Some(cause) = death(status) {
        let message = format!("{}: {cause}", file.display());
        let code = if status.signal() == Some(SIGINT) {
            code::INTERRUPTED
        } else {
            code::INPUT
        };
        return Err(ProgramError::new(code, message));
    }
    let (answer, mut pixels) = unframed::<Answer>(&answer).ok_or_else(|| failed(&"its answer is damaged"))?;
    match answer {
        Answer::Refused { code, message } => Err(ProgramError { code, message }),
        Answer::Composed {
            photograph,
            overview,
            parts,
            path,
            planned_s,
        } => Ok(Composed {
            photograph: photograph.and_then(|(size, place_mm)| Some((taken(&mut pixels, size)?, place_mm))),
            overview: overview.and_then(|(part, size)| {
                let small = taken(&mut pixels, size)?;
                Some(Overview { part, small })
            }),
            parts,
            path: path.iter().map(from_wire).collect(),
            planned_s,
        }),
    }
}

/// Runs the hidden command: limits itself, then answers one request.
///
/// # Errors
/// The limits cannot be set, or the request cannot be read.
pub fn run() -> Result<(), ProgramError> {
    let failed = |cause: &dyn std::fmt::Display| ProgramError::failed("preparing a file", cause);
    for (resource, most) in [
        (Resource::As, MEMORY_MAX_BYTES),
        (Resource::Cpu, PROCESSOR_MAX_S),
        (Resource::Core, 0),
    ] {
        // A process may lower its limits, but not raise them above those that it was started with.
        let most = getrlimit(resource).maximum.map_or(most, |maximum| maximum.min(most));
        let limit = Rlimit {
            current: Some(most),
            maximum: Some(most),
        };
        setrlimit(resource, limit).map_err(|cause| failed(&cause))?;
    }
    let mut request = Vec::new();
    io::stdin()
        .lock()
        .read_to_end(&mut request)
        .map_err(|cause| failed(&cause))?;
    let (asked, content) = unframed::<Request>(&request).ok_or_else(|| failed(&"there is no request"))?;
    let composed = compose_content(Path::new(&asked.name), content, &asked.config, &asked.options);
    let (answer, pixels) = match composed {
        Err(ProgramError { code, message }) => (Answer::Refused { code, message }, Vec::new()),
        Ok(composed) => {
            let mut pixels = Vec::new();
            let mut append = |picture: RgbImage| {
                let (width, height) = picture.dimensions();
                pixels.append(&mut picture.into_raw());
                [width, height]
            };
            let answer = Answer::Composed {
                photograph: (composed.photograph).map(|(picture, place_mm)| (append(picture), place_mm)),
                overview: (composed.overview).map(|overview| (overview.part, append(overview.small))),
                parts: composed.parts,
                path: composed.path.iter().map(to_wire).collect(),
                planned_s: composed.planned_s,
            };
            (answer, pixels)
        }
    };
    let answer = framed(&answer, pixels).map_err(|cause| failed(&cause))?;
    let mut out = io::stdout().lock();
    out.write_all(&answer)
        .and_then(|()| out.flush())
        .map_err(|cause| failed(&cause))
}

/// A message followed by bytes: the message's length, the message, the bytes.
fn framed(message: &impl Serialize, mut bytes: Vec<u8>) -> Result<Vec<u8>, postcard::Error> {
    let message = postcard::to_extend(message, Vec::new())?;
    let mut result = (message.len() as u64).to_le_bytes().to_vec();
    result.extend(message);
    result.append(&mut bytes);
    Ok(result)
}

fn unframed<T: DeserializeOwned>(bytes: &[u8]) -> Option<(T, &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<8>()?;
    let (message, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    Some((postcard::from_bytes(message).ok()?, rest))
}

/// Takes a picture of this width and height, pixels, from the front of the bytes.
fn taken(pixels: &mut &[u8], [width, height]: [u32; 2]) -> Option<RgbImage> {
    let bytes = usize::try_from(3 * u128::from(width) * u128::from(height)).ok()?;
    let (picture, rest) = pixels.split_at_checked(bytes)?;
    *pixels = rest;
    RgbImage::from_raw(width, height, picture.to_vec())
}

/// Passes a request to a process and returns its answer.
fn exchange(command: &mut Command, request: Vec<u8>) -> io::Result<(ExitStatus, Vec<u8>)> {
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
    let (input, output) = (child.stdin.take(), child.stdout.take());
    let mut answer = Vec::new();
    let read = std::thread::scope(|scope| {
        scope.spawn(|| {
            // A process that has ended does not read the request; its exit status gives the reason.
            let _ = input.map(|mut input| input.write_all(&request));
        });
        output.map_or(Ok(0), |output| output.take(ANSWER_MAX_BYTES).read_to_end(&mut answer))
    });
    Ok((child.wait()?, read.map(|_| answer)?))
}

/// Why a process ended before it answered.
fn death(status: ExitStatus) -> Option<String> {
    let cause = match status.signal() {
        None if status.success() => return None,
        None => "preparing it failed; this is a mistake in the program: please report it with the file".to_owned(),
        Some(SIGXCPU | SIGKILL) => format!(
            "preparing it takes more than {PROCESSOR_MAX_S} s of processor time; simplify its lines, or split the file"
        ),
        Some(SIGABRT | SIGSEGV) => format!(
            "preparing it takes more than {} GB of memory, or its elements are nested too deeply; simplify its lines, or \
             split the file",
            MEMORY_MAX_BYTES >> 30
        ),
        Some(SIGINT | SIGTERM) => "ended before it was prepared".to_owned(),
        Some(signal) => format!("preparing it was ended by signal {signal}"),
    };
    Some(cause)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> (ExitStatus, Vec<u8>) {
        let mut command = Command::new("sh");
        command.arg("-c").arg(script).stderr(Stdio::null());
        exchange(&mut command, vec![b'x'; 1 << 20]).expect("a shell")
    }

    #[test]
    fn a_process_that_exceeds_a_limit_or_dies_becomes_an_error_that_names_it() {
        for (script, expected) in [
            ("ulimit -t 1; while :; do :; done", "processor time"),
            ("kill -KILL $$", "processor time"),
            ("kill -ABRT $$", "memory"),
            ("kill -SEGV $$", "nested"),
            ("kill -TERM $$", "ended before"),
            ("exit 101", "mistake"),
        ] {
            let cause = death(shell(script).0).expect(script);
            assert!(cause.contains(expected), "{script}: {cause}");
        }
        let (status, answer) = shell("cat");
        assert_eq!((death(status), answer.len()), (None, 1 << 20));
    }

    #[test]
    fn pictures_are_taken_one_after_the_other_and_never_beyond_the_end() {
        let bytes: Vec<u8> = (0..30).collect();
        let mut pixels = bytes.as_slice();
        assert!(taken(&mut pixels, [u32::MAX, u32::MAX]).is_none());
        let first = taken(&mut pixels, [3, 2]).expect("18 bytes");
        assert_eq!((first.dimensions(), first.as_raw().as_slice()), ((3, 2), &bytes[..18]));
        assert!(taken(&mut pixels, [5, 1]).is_none(), "12 bytes are left");
        let second = taken(&mut pixels, [1, 4]).expect("12 bytes");
        assert_eq!((second.as_raw().as_slice(), pixels.len()), (&bytes[18..], 0));
    }

    #[test]
    fn messages_keep_the_bytes_behind_them_and_damaged_ones_are_none() {
        let bytes = framed(&("name", 7_u32), vec![1, 2, 3]).expect("memory");
        assert_eq!(
            unframed::<(String, u32)>(&bytes),
            Some((("name".to_owned(), 7), &[1_u8, 2, 3][..]))
        );
        for length in 0..bytes.len() - 3 {
            assert_eq!(unframed::<(String, u32)>(&bytes[..length]), None);
        }
    }
}
