//! Benchmark of a long recording: samples through writer and reader, and the memory used.
//!
//! One thread records, another reads the output from a pipe, so a day of data needs no disk. Every sample is checked.
//! Memory is this process's resident size at the end, compared with that after the first minute.

use super::{BenchError, BenchReport, BenchRow};
use crate::recording::statistics::statistics;
use crate::recording::{About, Playback, Recorder};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::link::message::SAMPLES_PER_MESSAGE;
use etherpen::messages::{IoValues, Sample};
use etherpen::motion::Pen;
use etherpen::robots::AXES;
use std::io::{self, BufReader, PipeWriter};

/// Number of samples before the first measurement of memory: a minute.
const WARM_SAMPLES: u32 = 60_000;
/// Largest growth of memory, MB for each hour: the recorder's table of chunks, 3 600 of some 70 bytes, plus the
/// allocator's overhead when the table moves.
const GROWTH_MAX_MB_PER_HOUR: f64 = 1.0;

/// Records this many hours and reads them back.
///
/// # Errors
/// The pipe, the recorder or the reader failed.
pub fn run(hours: f64) -> Result<BenchReport, BenchError> {
    let samples = (hours * 3_600_000.0) as u32;
    let failed = |cause: io::Error| BenchError::Program {
        program: "the recorder".into(),
        cause: cause.to_string(),
    };
    let (reader, writer) = io::pipe().map_err(failed)?;
    let recording = std::thread::spawn(move || record(writer, samples));
    let mut playback = Playback::new(BufReader::new(reader)).map_err(failed)?;
    let figures = statistics(&mut playback).map_err(failed)?;
    let recorded = recording.join().unwrap_or_else(|_| Err(io::ErrorKind::Other.into()));
    let (bytes, warm_mb) = recorded.map_err(failed)?;
    let growth_mb = memory_mb() - warm_mb;
    let row = |case: &str, value: f64, unit: &'static str, target: Option<f64>| BenchRow {
        case: case.into(),
        subject: "etherpen",
        value,
        unit,
        target,
    };
    let lost = f64::from(samples) - figures.samples as f64;
    Ok(BenchReport {
        bench: "recording",
        rows: vec![
            row("samples", f64::from(samples), "samples", None),
            row("samples_lost", lost, "samples", Some(0.0)),
            row("gaps", figures.gaps as f64, "gaps", Some(0.0)),
            row("bytes_per_sample", bytes as f64 / f64::from(samples), "bytes", None),
            row("memory", memory_mb(), "MB", None),
            row(
                "memory_growth",
                growth_mb,
                "MB",
                Some((hours * GROWTH_MAX_MB_PER_HOUR).max(2.0)),
            ),
        ],
    })
}

/// Length of the recording, bytes, and the memory after its first minute, MB.
fn record(pipe: PipeWriter, samples: u32) -> io::Result<(u64, f64)> {
    let config = Config::default();
    let about = About {
        config: &config,
        source: "bench",
        begin_ns: 0,
    };
    let mut recorder = Recorder::new(pipe, &about)?;
    let mut warm_mb = memory_mb();
    for first in (0..samples).step_by(SAMPLES_PER_MESSAGE) {
        let several: [Sample; SAMPLES_PER_MESSAGE] = std::array::from_fn(|k| sample(first + k as u32));
        let count = (samples - first).min(SAMPLES_PER_MESSAGE as u32) as usize;
        recorder.samples(0, several.get(..count).unwrap_or(&several))?;
        if first == WARM_SAMPLES {
            warm_mb = memory_mb();
        }
    }
    let written = recorder.finish()?;
    Ok((written.bytes, warm_mb))
}

/// Samples of a moving robot, all different.
fn sample(t_ms: u32) -> Sample {
    let t = f64::from(t_ms) / 1_000.0;
    let angle = |axis: usize, lag: f64| (0.4 + 0.2 * (t - lag + axis as f64).sin()) as f32;
    let speed = |axis: usize, lag: f64| (0.2 * (t - lag + axis as f64).cos()) as f32;
    let angles = |lag| -> [f32; AXES] { std::array::from_fn(|axis| angle(axis, lag)) };
    let speeds = |lag| -> [f32; AXES] { std::array::from_fn(|axis| speed(axis, lag)) };
    Sample {
        t_ms,
        mode: Mode::Drawing,
        stroke: t_ms / 1_000,
        pen: if t_ms % 1_000 < 800 { Pen::Down } else { Pen::Up },
        setpoint_rad: angles(0.0),
        measured_rad: angles(0.001),
        setpoint_rad_s: speeds(0.0),
        measured_rad_s: speeds(0.001),
        io: IoValues::default(),
    }
}

/// Resident memory of this process, MB, from proc(5); NaN if there is no /proc.
fn memory_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok());
    kilobytes.map_or(f64::NAN, |kilobytes| kilobytes / 1_000.0)
}
