//! Any bytes as a recording, and as the frames of a capture.

use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::{IoValues, Sample};
use etherpen::motion::Pen;
use etherpen::robots::AXES;
use etherpen_segment::capture::{Capture, Direction};
use host_tools::recording::export::{table_columns, write_csv, write_parquet};
use host_tools::recording::messages::Severity;
use host_tools::recording::plot::{Form, plot};
use host_tools::recording::signals::named;
use host_tools::recording::statistics::statistics;
use host_tools::recording::{About, Playback, Recorder};
use std::io;

/// Most entries that a file of so many bytes can hold: a message's head has 9 bytes and its fields 22.
const fn entries_max(bytes: usize) -> usize {
    bytes / 31 + 1
}

/// Reads a recording once for every command that reads one.
pub(crate) fn mcap(bytes: &[u8]) {
    let _ = read(bytes);
}

/// Reads a recording; returns the number of its entries, or why there are none.
pub(crate) fn read(bytes: &[u8]) -> io::Result<usize> {
    let mut playback = Playback::new(bytes)?;
    let mut count = 0;
    while playback.next_entry()?.is_some() {
        count += 1;
    }
    assert!(
        count <= entries_max(bytes.len()),
        "{count} entries of {} bytes",
        bytes.len()
    );
    assert!(playback.notices().iter().all(|notice| !notice.is_empty()));
    let fresh = || Playback::new(bytes);
    statistics(&mut fresh()?)?;
    let config = fresh()?.config().unwrap_or_default();
    let table = write_csv(&mut fresh()?, &table_columns(&config, None), io::sink());
    let rows = table.as_ref().map_or(0, |table| table.rows);
    assert!(rows <= count as u64);
    // What has become of the table is known from the other readers.
    let _ = write_parquet(&mut fresh()?, &table_columns(&config, None), io::sink());
    let mut part = fresh()?;
    part.select(Some(0.001), Some(0.01));
    while part.next_entry()?.is_some() {}
    if let Ok(signals) = named("q1_*", &config) {
        plot(&mut fresh()?, &signals, Form::Svg)?;
    }
    Ok(count)
}

fn sample(t_ms: u32) -> Sample {
    let angle = t_ms as f32 / 100.0;
    Sample {
        t_ms,
        mode: if t_ms < 5 { Mode::Idle } else { Mode::Drawing },
        stroke: t_ms / 4,
        pen: if t_ms % 4 < 2 { Pen::Down } else { Pen::Up },
        setpoint_rad: [angle; AXES],
        measured_rad: [angle + 0.001; AXES],
        setpoint_rad_s: [0.1; AXES],
        measured_rad_s: [0.11; AXES],
        io: IoValues::default(),
    }
}

/// A recording with its end, without its end, and one with gaps and events only.
pub(crate) fn mcap_seeds() -> Vec<Vec<u8>> {
    let about = About {
        config: &Config::default(),
        source: "fuzzing",
        begin_ns: 0,
    };
    let record = |write: &dyn Fn(&mut Recorder<&mut Vec<u8>>) -> io::Result<()>| {
        let mut bytes = Vec::new();
        let mut recorder = Recorder::new(&mut bytes, &about).expect("memory");
        write(&mut recorder).expect("memory");
        drop(recorder);
        bytes
    };
    let samples: Vec<Sample> = (1..9).map(sample).collect();
    let whole = record(&|recorder| {
        recorder.samples(0, &samples)?;
        recorder.event(Severity::Warning, "test", "an event")?;
        recorder.samples(3, &samples[7..])?;
        recorder.finish().map(|_| ())
    });
    let open = record(&|recorder| recorder.samples(0, &samples).and_then(|()| recorder.flush()));
    let eventful = record(&|recorder| {
        recorder.event(Severity::Error, "fault", "x")?;
        recorder.flush()
    });
    vec![whole, open, eventful]
}

/// Writes a capture of frames and reads its blocks. The bytes are records of a time (one byte, ms), a length (two bytes)
/// and a frame.
pub(crate) fn pcapng(bytes: &[u8]) {
    let mut capture = Capture::new(Vec::new()).expect("memory");
    let (mut rest, mut time_us, mut frames) = (bytes, u64::MAX / 2_000, Vec::new());
    while let Some(([ms, low, high], behind)) = rest.split_first_chunk() {
        let length = usize::from(u16::from_le_bytes([*low, *high]));
        let (frame, behind) = behind.split_at(behind.len().min(length));
        rest = behind;
        time_us = time_us.wrapping_add(1_000 * u64::from(*ms));
        let direction = if ms % 2 == 0 {
            Direction::Sent
        } else {
            Direction::Received
        };
        capture.record(time_us, direction, frame).expect("memory");
        frames.push((time_us * 1_000, frame));
    }
    let file = capture.finish().expect("memory");
    assert_eq!(packets(&file), frames);
}

/// Time and content of each packet, after a section header and an interface.
fn packets(file: &[u8]) -> Vec<(u64, &[u8])> {
    let (mut rest, mut found, mut kinds) = (file, Vec::new(), Vec::new());
    while !rest.is_empty() {
        let word = |at: usize| u32::from_le_bytes(*rest[at..].first_chunk().expect("a word"));
        let (kind, length) = (word(0), word(4) as usize);
        assert!(length % 4 == 0 && word(length - 4) as usize == length, "a closed block");
        if kind == 6 {
            let time_ns = u64::from(word(12)) << 32 | u64::from(word(16));
            assert_eq!(word(20), word(24), "no frame is cut");
            found.push((time_ns, &rest[28..28 + word(20) as usize]));
        } else {
            kinds.push(kind);
        }
        rest = &rest[length..];
    }
    assert_eq!(kinds, [0x0A0D_0D0A, 1]);
    found
}

/// Frames of all lengths that a wire carries, in both directions.
pub(crate) fn pcapng_seeds() -> Vec<Vec<u8>> {
    let record = |length: u16| {
        [
            &[length as u8],
            length.to_le_bytes().as_slice(),
            &vec![0xA5; length.into()],
        ]
        .concat()
    };
    let mut seeds: Vec<Vec<u8>> = [0, 1, 59, 60].into_iter().map(record).collect();
    seeds.push(seeds.concat());
    seeds
}
