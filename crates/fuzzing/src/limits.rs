//! Reads a file as a command would, within limits of memory and processor time.
//!
//! The limits apply to the whole process, so each file is read by a process of its own: `etherpen-fuzzing read`. What
//! exceeds them ends that process with a signal.

use crate::{drawing, recording};
use etherpen_segment::{Script, SlaveKind};
use host_tools::drawing::{TextFont, load_with};
use host_tools::recording::Playback;
use host_tools::settings::{self, Settings};
use rustix::process::{Resource, Rlimit, setrlimit};
use std::fs;
use std::io;
use std::path::Path;

/// Most memory of a process that reads a file of 10 MiB, bytes.
pub const MEMORY_BYTES: u64 = 1 << 30;
/// Most processor time of a process that reads a file of 10 MiB, s, in a release build.
pub const SECONDS: u64 = 10;

/// Limits this process.
///
/// # Errors
/// The operating system refuses the limits.
pub fn restrict(memory_bytes: u64, seconds: u64) -> io::Result<()> {
    for (resource, limit) in [
        (Resource::As, memory_bytes),
        (Resource::Cpu, seconds),
        (Resource::Core, 0),
    ] {
        let limit = Rlimit {
            current: Some(limit),
            maximum: Some(limit),
        };
        setrlimit(resource, limit)?;
    }
    Ok(())
}

/// Reads a file as the command for its kind does; returns what became of it, in words.
///
/// # Errors
/// The file cannot be read at all.
pub fn read(path: &Path) -> io::Result<String> {
    let kind = path.extension().and_then(|kind| kind.to_str()).unwrap_or_default();
    let told = match kind {
        "mcap" => {
            let mut playback = Playback::open(path);
            // The commands show the notices.
            let notices = playback.as_mut().map_or(0, |playback| {
                while let Ok(Some(_)) = playback.next_entry() {}
                playback.notices().len()
            });
            let entries = recording::read(&fs::read(path)?);
            entries
                .map(|entries| format!("{entries} entries, {notices} notices"))
                .map_err(|error| error.to_string())
        }
        "toml" => {
            let changed = Settings::open(path).and_then(|settings| settings.config());
            let changed = changed.map_err(|error| error.to_string());
            settings::load(Some(path))
                .map_err(|error| error.message)
                .and(changed)
                .map(|_| "a configuration".to_owned())
        }
        "script" => {
            let script: Result<Script, _> = fs::read_to_string(path)?.parse();
            let checked = script.and_then(|script| script.check(4));
            checked
                .map(|()| "a script".to_owned())
                .map_err(|error| error.to_string())
        }
        "sii" => {
            let kind = SlaveKind::from_file(path);
            kind.map(crate::segment::visit)
                .map(|()| "a slave".to_owned())
                .map_err(|error| error.to_string())
        }
        _ => {
            let input = load_with(path, &TextFont::SingleStroke);
            input
                .map(|input| format!("{} points or pixels", drawing::count(input)))
                .map_err(|error| error.to_string())
        }
    };
    // The beginning of a message names what is wrong.
    Ok(told.unwrap_or_else(|error| {
        format!(
            "refused, {} bytes: {}",
            error.len(),
            error.chars().take(120).collect::<String>()
        )
    }))
}

/// Most address space this process has had, MiB, and its processor time, s.
///
/// # Errors
/// `/proc` cannot be read.
pub fn used() -> io::Result<(u64, f64)> {
    let status = fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| {
        line.strip_prefix("VmPeak:")?
            .trim()
            .split(' ')
            .next()?
            .parse::<u64>()
            .ok()
    });
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Ok((peak.unwrap_or(0) / 1024, time.tv_sec as f64 + time.tv_nsec as f64 / 1e9))
}
