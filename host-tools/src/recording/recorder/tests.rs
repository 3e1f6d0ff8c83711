use super::super::playback::{Playback, RecordingEntry};
use super::super::statistics::statistics;
use super::*;
use crate::random::Lcg;
use crate::recording::signals::columns;
use crate::report::{rows, write_telemetry};
use etherpen::config::{IoPoint, IoType};
use etherpen::messages::IoValues;
use etherpen::robots::AXES;
use std::sync::{Arc, Mutex};

fn sample(t_ms: u32) -> Sample {
    let t = t_ms as f32 / 1_000.0;
    Sample {
        t_ms,
        mode: if t_ms % 4_000 < 1_000 {
            Mode::Idle
        } else {
            Mode::Drawing
        },
        stroke: t_ms / 700,
        pen: if t_ms % 700 < 500 { Pen::Down } else { Pen::Up },
        setpoint_rad: std::array::from_fn(|k| 0.3 + 0.1 * (t + k as f32).sin()),
        measured_rad: std::array::from_fn(|k| 0.3 + 0.1 * (t - 0.001 + k as f32).sin() + 1e-5),
        setpoint_rad_s: [0.1 * t.cos(); AXES],
        measured_rad_s: [0.1 * t.cos() + 1e-4; AXES],
        io: IoValues {
            set: (t_ms / 3) as u16,
            missing: (t_ms / 1_000) as u16,
            words: [t_ms.wrapping_mul(37) & 0xFFFF, t_ms & 0xFF].into_iter().collect(),
        },
    }
}

fn about(config: &Config) -> About<'_> {
    About {
        config,
        source: "test",
        begin_ns: 0,
    }
}

fn entries(bytes: &[u8]) -> Vec<(f64, RecordingEntry)> {
    let mut playback = Playback::new(bytes).unwrap();
    let mut entries = Vec::new();
    while let Some(entry) = playback.next_entry().unwrap() {
        entries.push(entry);
    }
    entries
}

fn times_ms(bytes: &[u8]) -> Vec<u32> {
    let moments = entries(bytes).into_iter().filter_map(|(_, entry)| match entry {
        RecordingEntry::Moment(moment) => Some(moment.sample.t_ms),
        _ => None,
    });
    moments.collect()
}

/// A storage with a limited size, like a disk; or one that also cannot be cut.
#[derive(Clone)]
struct Disk {
    bytes: Arc<Mutex<Vec<u8>>>,
    room: usize,
    cuts: bool,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut stored = self.bytes.lock().unwrap();
        let taken = bytes.len().min(self.room - stored.len());
        stored.extend(&bytes[..taken]);
        if taken == 0 {
            Err(io::ErrorKind::StorageFull.into())
        } else {
            Ok(taken)
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Storage for Disk {
    fn cut(&mut self, length: u64) -> io::Result<()> {
        if !self.cuts {
            return Err(io::ErrorKind::Unsupported.into());
        }
        self.bytes.lock().unwrap().truncate(length as usize);
        Ok(())
    }
}

#[test]
fn a_recording_as_csv_is_the_telemetry_table_byte_by_byte() {
    use IoType::{Bool, I16, U8, U32};
    let mut config = Config::default();
    // The last one is beyond the room of a sample.
    let points = [
        ("door", Bool),
        ("level", I16),
        ("valve", Bool),
        ("byte", U8),
        ("long", U32),
        ("far", U32),
    ];
    for (bit, (name, kind)) in (0..).step_by(32).zip(points) {
        let point = IoPoint {
            name: name.try_into().unwrap(),
            slave: 5,
            bit: Some(bit),
            kind,
            ..IoPoint::default()
        };
        config.io.push(point).unwrap();
    }
    assert_eq!(config.sampled_words(), [1, 3, 4]);
    let samples: Vec<Sample> = (5..9_000).map(sample).collect();
    let mut recorder = Recorder::new(Vec::new(), &about(&config)).unwrap();
    samples.chunks(4).for_each(|four| recorder.samples(0, four).unwrap());
    let written = recorder.finish().unwrap();
    assert_eq!((written.samples, written.missing, written.gaps), (8_995, 0, 0));
    let bytes = std::mem::take(recorder.storage_mut());
    assert_eq!(written.bytes, bytes.len() as u64);

    let mut expected = Vec::new();
    write_telemetry(&config, &rows(&config, &samples), &mut expected).unwrap();
    let mut playback = Playback::new(bytes.as_slice()).unwrap();
    assert_eq!(playback.config(), Some(config.clone()));
    let mut csv = Vec::new();
    let exported = crate::recording::export::write_csv(&mut playback, &columns(&config), &mut csv).unwrap();
    assert_eq!(exported.rows, 8_995);
    assert!(csv == expected, "the tables differ");
    let text = String::from_utf8(csv).unwrap();
    let (heading, rows) = text.split_once('\n').unwrap();
    let names = "io_door,io_level,io_valve,io_byte,io_long,io_far";
    assert!(heading.ends_with(&format!(",v4_rad_s,{names}")), "{heading}");
    for row in rows.lines() {
        let t_ms: u32 = row.split(',').next().unwrap().parse().unwrap();
        // What stands in the place of a point that is not 0; the samples here have no third word.
        let of = |place: u32, value: Option<i64>| {
            let (missing, set) = ((t_ms / 1_000) >> place & 1, (t_ms / 3) >> place & 1);
            match (missing, set, value) {
                (1, ..) | (0, 1, None) => String::new(),
                (_, 0, _) => "0".to_owned(),
                (.., Some(value)) => value.to_string(),
                _ => unreachable!(),
            }
        };
        let level = i64::from((t_ms * 37) as u16 as i16);
        let values = [Some(1), Some(level), Some(1), Some(i64::from(t_ms & 0xFF)), None, None];
        let expected: Vec<String> = (0..).zip(values).map(|(place, value)| of(place, value)).collect();
        assert!(
            row.ends_with(&format!(",{}", expected.join(","))),
            "{row}: {expected:?}"
        );
    }
}

#[test]
fn missing_samples_and_a_new_start_are_stored_where_they_happened() {
    let config = Config::default();
    let mut recorder = Recorder::new(Vec::new(), &about(&config)).unwrap();
    recorder.samples(0, &[sample(10), sample(11)]).unwrap();
    recorder.samples(3, &[sample(15)]).unwrap();
    recorder.samples(0, &[sample(20)]).unwrap();
    recorder.samples(0, &[sample(2), sample(3)]).unwrap();
    let written = recorder.finish().unwrap();
    assert_eq!((written.samples, written.missing, written.gaps), (6, 7, 2));
    let bytes = std::mem::take(recorder.storage_mut());
    let mut seen = Vec::new();
    for (time_s, entry) in entries(&bytes) {
        match entry {
            RecordingEntry::Moment(moment) => {
                seen.push(format!("{:.0} ms: sample {}", time_s * 1e3, moment.sample.t_ms))
            }
            RecordingEntry::Gap(gap) => {
                seen.push(format!("{} to {}: {} missing", gap.before_ms, gap.t_ms, gap.missing))
            }
            RecordingEntry::Event(event) if event.name == "link" => seen.push(event.text),
            RecordingEntry::Event(_) | RecordingEntry::State(_) => {}
        }
    }
    assert_eq!(
        seen,
        [
            "0 ms: sample 10",
            "1 ms: sample 11",
            "11 to 15: 3 missing",
            "5 ms: sample 15",
            "15 to 20: 4 missing",
            "10 ms: sample 20",
            "the device's time went from 20 ms to 2 ms: it has started again",
            "11 ms: sample 2",
            "12 ms: sample 3",
        ]
    );
}

#[test]
fn a_recording_cut_anywhere_gives_all_but_its_last_second() {
    let config = Config::default();
    let mut recorder = Recorder::new(Vec::new(), &about(&config)).unwrap();
    // Length of the file after each sample was taken.
    let mut lengths = Vec::new();
    for t_ms in 0..6_000 {
        recorder.samples(0, &[sample(t_ms)]).unwrap();
        lengths.push(recorder.written().bytes as usize);
    }
    recorder.finish().unwrap();
    let bytes = std::mem::take(recorder.storage_mut());
    let mut random = Lcg::new(77);
    let head = lengths[0];
    for _ in 0..40 {
        let length = head + random.below(bytes.len() - head);
        let times = times_ms(&bytes[..length]);
        // A recorder that is killed at this length of the file has taken at most these samples.
        let taken = lengths.iter().filter(|at| **at <= length).count();
        assert!(
            times.len() + 1_000 >= taken,
            "{length} bytes: {} of {taken}",
            times.len()
        );
        assert_eq!(times, (0..times.len() as u32).collect::<Vec<u32>>());
    }
}

#[test]
fn a_full_disk_is_an_error_and_what_was_written_stays_readable() {
    let config = Config::default();
    for (room, cuts) in [(500_000, true), (500_000, false), (777_777, true), (777_777, false)] {
        let disk = Disk {
            bytes: Arc::default(),
            room,
            cuts,
        };
        let mut recorder = Recorder::new(disk.clone(), &about(&config)).unwrap();
        let failed =
            (0..100_000).find_map(|t_ms| recorder.samples(0, &[sample(t_ms)]).err().map(|error| (t_ms, error)));
        let (t_ms, error) = failed.expect("the disk is full before");
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        let finished = recorder.finish();
        let bytes = disk.bytes.lock().unwrap().clone();
        let times = times_ms(&bytes);
        println!(
            "{room} bytes, cut {cuts}: {t_ms} ms, {} samples, end {finished:?}",
            times.len()
        );
        assert!(times.len() as u32 + 1_100 > t_ms, "{} of {t_ms}", times.len());
        assert_eq!(times, (0..times.len() as u32).collect::<Vec<u32>>());
        let mut playback = Playback::new(bytes.as_slice()).unwrap();
        let figures = statistics(&mut playback).unwrap();
        assert_eq!(figures.complete, cuts && finished.is_ok());
    }
}

#[test]
fn figures_are_those_of_the_samples() {
    let config = Config::default();
    let mut recorder = Recorder::new(Vec::new(), &about(&config)).unwrap();
    recorder
        .samples(0, &(0..2_000).map(sample).collect::<Vec<_>>())
        .unwrap();
    recorder
        .samples(0, &(2_500..4_000).map(sample).collect::<Vec<_>>())
        .unwrap();
    recorder.finish().unwrap();
    let bytes = std::mem::take(recorder.storage_mut());
    let figures = statistics(&mut Playback::new(bytes.as_slice()).unwrap()).unwrap();
    assert_eq!((figures.samples, figures.missing, figures.gaps), (3_500, 500, 1));
    assert!(figures.complete && (figures.duration_s - 3.999).abs() < 1e-9);
    let seconds: Vec<(Mode, f64)> = figures.modes.iter().map(|of| (of.mode, of.seconds)).collect();
    assert_eq!(seconds, [(Mode::Idle, 1.0), (Mode::Drawing, 2.5)]);
    let q1 = figures.signals.iter().find(|of| of.name == "q1_ref_rad").unwrap();
    assert!((q1.max - 0.4).abs() < 1e-5 && q1.min > 0.2 && q1.rms >= q1.mean.abs());
    // The measurement lags by its age and is 10 microradians off; nothing is compared across the gap.
    for (_, error) in figures.following_error_max.iter() {
        assert!((0.9e-5..1.6e-5).contains(&error), "{error}");
    }
}

/// Largest and smallest measured speed of the first axis in a recording of these samples.
fn speeds_rad_s(samples: &[Sample]) -> [f64; 2] {
    let mut recorder = Recorder::new(Vec::new(), &about(&Config::default())).unwrap();
    recorder.samples(0, samples).unwrap();
    recorder.finish().unwrap();
    let bytes = std::mem::take(recorder.storage_mut());
    let figures = statistics(&mut Playback::new(bytes.as_slice()).unwrap()).unwrap();
    let v1 = figures.signals.iter().find(|of| of.name == "v1_rad_s").unwrap();
    [v1.min, v1.max]
}

#[test]
fn a_position_jump_does_not_count_as_speed_but_a_fast_motion_does() {
    let moving = |speed: &dyn Fn(u32) -> f32| -> Vec<Sample> {
        let of = |t_ms| Sample {
            measured_rad_s: [speed(t_ms); 4],
            ..sample(t_ms)
        };
        (0..200).map(of).collect()
    };
    // A reference is taken: at rest, in motion, in the first sample and in the last one.
    for at in [0, 1, 100, 199] {
        for jump in [512.0, -512.0, 5.0] {
            let swing = |t_ms: u32| (t_ms as f32 * 0.05).sin();
            let [low, high] = speeds_rad_s(&moving(&|t_ms| if t_ms == at { jump } else { swing(t_ms) }));
            assert!(low >= -1.0 && high <= 1.0, "{jump} at {at}: {low} to {high}");
        }
    }
    // At the acceleration used for planning, up and down again: every speed counts.
    let triangle = |t_ms: u32| 0.25 * (100.0 - (t_ms as f32 - 100.0).abs());
    assert_eq!(speeds_rad_s(&moving(&triangle))[1], 25.0);
    // Against an end stop: the speed differs from one neighbour only.
    let [_, high] = speeds_rad_s(&moving(&|t_ms| if t_ms < 50 { 8.0 } else { 0.0 }));
    assert_eq!(high, 8.0);
}

#[test]
fn samples_lie_on_the_devices_axis_and_what_happens_between_them_by_the_walls_clock() {
    let config = Config::default();
    let begin_ns = 1_800_000_000_000_000_000;
    let mut recorder = Recorder::new(
        Vec::new(),
        &About {
            begin_ns,
            ..about(&config)
        },
    )
    .unwrap();
    let wall = |ms: u64| begin_ns + ms * MILLISECOND_NS;
    recorder.set_time(wall(10));
    recorder.event(Severity::Info, "link", "connected").unwrap();
    // The device's clock runs at half the speed of the wall clock.
    recorder.set_time(wall(20));
    recorder.samples(0, &[sample(100)]).unwrap();
    recorder.set_time(wall(220));
    recorder.samples(0, &[sample(200)]).unwrap();
    recorder.set_time(wall(250));
    recorder.event(Severity::Info, "job", "begun").unwrap();
    recorder.set_time(wall(1_250));
    recorder.samples(0, &[sample(1)]).unwrap();
    recorder.finish().unwrap();
    let bytes = std::mem::take(recorder.storage_mut());
    let mut times_ms = Vec::new();
    for (time_s, entry) in entries(&bytes) {
        let what = match entry {
            RecordingEntry::Moment(moment) => moment.sample.t_ms.to_string(),
            RecordingEntry::Event(event) if event.name == "link" || event.name == "job" => event.text[..4].to_owned(),
            _ => continue,
        };
        times_ms.push(format!("{what} at {:.0}", time_s * 1e3));
    }
    let expected = [
        "conn at 0",
        "100 at 10",
        "200 at 110",
        "begu at 140",
        "the  at 1140",
        "1 at 1140",
    ];
    assert_eq!(times_ms, expected);
}
