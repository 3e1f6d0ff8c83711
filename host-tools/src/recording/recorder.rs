//! Writes the firmware's data as they arrive.
//!
//! Times in the file are the device's, on a time axis that starts with the recording; after a restart the firmware's
//! samples continue after the existing ones. A chunk is closed every second, so a recorder that is killed has written
//! all but the last one. Invariants: samples are written in order, each once; a gap is recorded before the sample that
//! follows it.

use super::mcap::Writer;
use super::messages::{self, EVENT, Event, GAP, Gap, SAMPLE, STATUS, Severity, State};
use super::moment::{Moment, SampleAxes};
use crate::link::text;
use etherpen::application::{Fault, Mode};
use etherpen::config::Config;
use etherpen::messages::{Sample, SlaveStatus, Status};
use etherpen::motion::Pen;
use etherpen::robots::{JointAngles, Kinematics};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufWriter, PipeWriter, Seek, SeekFrom, Write};

/// Longest duration of a chunk, ns.
const CHUNK_NS: u64 = 1_000_000_000;
/// Most bytes in a chunk.
const CHUNK_BYTES: usize = 1 << 20;
const MILLISECOND_NS: u64 = 1_000_000;

/// Destination of a recording.
pub trait Storage: Write {
    /// Cuts off a partial write.
    ///
    /// # Errors
    /// The storage cannot be cut.
    fn cut(&mut self, length: u64) -> io::Result<()>;
}

impl Storage for File {
    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.seek(SeekFrom::Start(length)).map(|_| ())
    }
}

impl<S: Storage> Storage for &mut S {
    fn cut(&mut self, length: u64) -> io::Result<()> {
        (**self).cut(length)
    }
}

impl Storage for BufWriter<File> {
    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.flush()?;
        self.get_mut().cut(length)
    }
}

/// Data written into a pipe cannot be taken back; the reader leaves out an incomplete record.
impl Storage for PipeWriter {
    fn cut(&mut self, _: u64) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }
}

impl Storage for Vec<u8> {
    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.truncate(usize::try_from(length).unwrap_or(usize::MAX));
        Ok(())
    }
}

/// Description of a recording.
#[derive(Clone, Copy, Debug)]
pub struct About<'a> {
    /// The configuration, which is stored in the file.
    pub config: &'a Config,
    /// Source of the samples: a port's name, or `simulation`.
    pub source: &'a str,
    /// Start time, ns since 1970; 0 in virtual time, where the device's clock is the time axis.
    pub begin_ns: u64,
}

/// Counters of a recorder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Number of samples.
    pub samples: u64,
    /// Number of missing samples.
    pub missing: u64,
    /// Number of gaps.
    pub gaps: u64,
    /// Length of the file, bytes.
    pub bytes: u64,
}

/// Writes one recording.
pub struct Recorder<S> {
    writer: Writer<S>,
    axes: SampleAxes,
    kinematics: Option<Kinematics>,
    /// Age of a measurement when it is compared with its reference, samples.
    age: usize,
    /// Stroke and pen of the last references, the oldest first.
    causes: VecDeque<(u32, Pen)>,
    /// Device time of the last sample, ms, and its place on the file's time axis, ns.
    last: Option<(u32, u64)>,
    /// Present time on the file's axis for events, ns: the last sample's time plus the wall-clock time since its
    /// arrival.
    now_ns: u64,
    /// Wall-clock time now and at the arrival of the last sample, ns.
    wall_ns: [u64; 2],
    mode: Option<Mode>,
    fault: Option<Fault>,
    /// Data taken, and the part of it that is in the file.
    taken: Written,
    written: Written,
    message: Vec<u8>,
}

impl<S: Storage> Recorder<S> {
    /// Starts a recording.
    ///
    /// # Errors
    /// Errors of the storage.
    pub fn new(storage: S, about: &About) -> io::Result<Self> {
        let library = concat!("etherpen ", env!("CARGO_PKG_VERSION"));
        let config = about.config;
        let axes = SampleAxes::of(config);
        let mut writer = Writer::new(storage, &messages::topics(&axes), library)?;
        let hash = config.hash().map_or_else(String::new, |hash| format!("{hash:016x}"));
        let facts = [
            ("source", about.source.to_owned()),
            ("begin_ns", about.begin_ns.to_string()),
            ("config_hash", hash),
            ("program", library.to_owned()),
        ];
        writer.metadata("etherpen", &facts)?;
        let text = toml::to_string(config).map_err(io::Error::other)?;
        writer.attach("etherpen.toml", "application/toml", text.as_bytes(), about.begin_ns)?;
        Ok(Self {
            writer,
            axes,
            kinematics: Kinematics::new(&config.geometry).ok(),
            age: config
                .axes
                .first()
                .map_or(0, |axis| axis.measurement_age_ms.round() as usize),
            causes: VecDeque::new(),
            last: None,
            now_ns: about.begin_ns,
            wall_ns: [about.begin_ns; 2],
            mode: None,
            fault: None,
            taken: Written::default(),
            written: Written::default(),
            message: Vec::new(),
        })
    }

    /// Sets the wall-clock time, ns since 1970, for the following data. Not called in virtual time.
    pub fn set_time(&mut self, wall_ns: u64) {
        let [_, at_sample_ns] = self.wall_ns;
        self.wall_ns = [wall_ns, at_sample_ns];
        self.now_ns = match self.last {
            Some((_, last_ns)) => last_ns + wall_ns.saturating_sub(at_sample_ns),
            None => wall_ns,
        };
    }

    /// Writes consecutive samples; `missing` samples before them are known to be lost.
    ///
    /// # Errors
    /// Errors of the storage; data written before stay readable.
    pub fn samples(&mut self, missing: u32, samples: &[Sample]) -> io::Result<()> {
        for (k, sample) in samples.iter().enumerate() {
            self.sample(if k == 0 { missing } else { 0 }, sample)?;
        }
        Ok(())
    }

    fn sample(&mut self, missing: u32, sample: &Sample) -> io::Result<()> {
        let time_ns = self.place(missing, sample)?;
        if self.mode != Some(sample.mode) {
            self.mode = Some(sample.mode);
            self.event(
                Severity::Info,
                "mode",
                &format!("{:?}: {}", sample.mode, text::mode(sample.mode)),
            )?;
        }
        self.causes.push_back((sample.stroke, sample.pen));
        if self.causes.len() > self.age + 1 {
            self.causes.pop_front();
        }
        let (stroke, pen) = self.causes.front().copied().unwrap_or((sample.stroke, sample.pen));
        let joints = JointAngles(sample.measured_rad.map(f64::from));
        let position = self
            .kinematics
            .as_ref()
            .and_then(|kinematics| kinematics.forward(&joints).ok());
        let moment = Moment {
            sample: Sample { stroke, pen, ..*sample },
            position: position.unwrap_or_default(),
        };
        moment.encode(&self.axes, &mut self.message);
        self.put(SAMPLE, time_ns)?;
        self.taken.samples += 1;
        Ok(())
    }

    /// The sample's place on the time axis, after recording a gap or a restart of the firmware.
    fn place(&mut self, missing: u32, sample: &Sample) -> io::Result<u64> {
        let Some((last_ms, last_ns)) = self.last else {
            // In virtual time the device's time is the axis.
            let begin_ns = if self.now_ns == 0 {
                u64::from(sample.t_ms) * MILLISECOND_NS
            } else {
                self.now_ns
            };
            self.arrive(sample, begin_ns);
            return Ok(begin_ns);
        };
        let passed_ms = sample.t_ms.wrapping_sub(last_ms);
        let started = passed_ms == 0 || passed_ms > u32::MAX / 2;
        let time_ns = if started {
            self.now_ns.max(last_ns + MILLISECOND_NS)
        } else {
            last_ns + u64::from(passed_ms) * MILLISECOND_NS
        };
        self.arrive(sample, time_ns);
        if started {
            self.causes.clear();
            let text = format!(
                "the device's time went from {last_ms} ms to {} ms: it has started again",
                sample.t_ms
            );
            self.event(Severity::Warning, "link", &text)?;
        }
        let lost = if started {
            missing
        } else {
            missing.max(passed_ms.saturating_sub(1))
        };
        if lost > 0 {
            let gap = Gap {
                before_ms: last_ms,
                t_ms: sample.t_ms,
                missing: lost,
            };
            gap.encode(&mut self.message);
            self.put(GAP, time_ns)?;
            self.taken.missing += u64::from(lost);
            self.taken.gaps += 1;
            let text = format!("{lost} samples are missing before {} ms", sample.t_ms);
            self.event_at(time_ns, Severity::Warning, "gap", &text)?;
        }
        Ok(time_ns)
    }

    fn arrive(&mut self, sample: &Sample, time_ns: u64) {
        let [wall_ns, _] = self.wall_ns;
        self.last = Some((sample.t_ms, time_ns));
        self.wall_ns = [wall_ns; 2];
        self.now_ns = time_ns;
    }

    /// Writes the state of the controller.
    ///
    /// # Errors
    /// Errors of the storage.
    pub fn status(&mut self, status: &Status) -> io::Result<()> {
        let fault = status.fault.as_ref().map_or_else(String::new, text::fault);
        if self.fault != status.fault {
            self.fault = status.fault;
            let (level, text) = if fault.is_empty() {
                (Severity::Info, "acknowledged")
            } else {
                (Severity::Error, fault.as_str())
            };
            self.event(level, "fault", text)?;
        }
        let slave = |slave: &SlaveStatus| [slave.al_state.into(), slave.al_code, slave.status_word];
        let state = State {
            t_ms: self.last.map_or(0, |(t_ms, _)| t_ms),
            mode: status.mode,
            referenced: status.referenced,
            override_percent: status.override_percent,
            counters: status.counters,
            slaves: status.slaves.iter().map(slave).collect(),
            fault,
            io: status.io.iter().map(|point| point.valid.then_some(point.raw)).collect(),
        };
        state.encode(&mut self.message);
        self.put(STATUS, self.now_ns)
    }

    /// Writes an event.
    ///
    /// # Errors
    /// Errors of the storage.
    pub fn event(&mut self, level: Severity, name: &str, text: &str) -> io::Result<()> {
        self.event_at(self.now_ns, level, name, text)
    }

    fn event_at(&mut self, time_ns: u64, level: Severity, name: &str, text: &str) -> io::Result<()> {
        let event = Event {
            time_ns,
            level,
            name: name.to_owned(),
            text: text.to_owned(),
        };
        event.encode(&mut self.message);
        self.put(EVENT, time_ns)
    }

    /// Puts the encoded message into its channel.
    fn put(&mut self, channel: u16, time_ns: u64) -> io::Result<()> {
        let (bytes, begin_ns) = self.writer.open_chunk();
        let long = begin_ns.is_some_and(|begin_ns| time_ns.saturating_sub(begin_ns) >= CHUNK_NS);
        if (long || bytes >= CHUNK_BYTES)
            && let Err(error) = self.flush()
        {
            self.message.clear();
            return Err(error);
        }
        self.writer.message(channel, time_ns, &self.message);
        self.message.clear();
        Ok(())
    }

    /// Writes all pending data.
    ///
    /// # Errors
    /// Errors of the storage; data written before stay readable.
    pub fn flush(&mut self) -> io::Result<()> {
        let result = self.writer.flush();
        self.keep_whole(result)
    }

    /// Writes the rest and the end of the file; nothing may follow. Also called after an error, to leave a complete
    /// file if there is room for its end.
    ///
    /// # Errors
    /// Errors of the storage; data written before stay readable.
    pub fn finish(&mut self) -> io::Result<Written> {
        self.flush()?;
        let whole = self.writer.whole_bytes();
        if let Err(error) = self.writer.finish() {
            // A storage that cannot be cut ends with a partial record, which readers leave out.
            let _ = self.writer.sink_mut().cut(whole);
            return Err(error);
        }
        Ok(self.written())
    }

    /// Counters of the data in the file.
    pub fn written(&self) -> Written {
        Written {
            bytes: self.writer.whole_bytes(),
            ..self.written
        }
    }

    /// Counters of the data taken, including data that are not yet in the file, or never will be.
    pub fn taken(&self) -> Written {
        self.taken
    }

    /// The storage.
    pub fn storage_mut(&mut self) -> &mut S {
        self.writer.sink_mut()
    }

    fn keep_whole(&mut self, result: io::Result<()>) -> io::Result<()> {
        if result.is_ok() {
            self.written = self.taken;
        } else {
            let whole = self.writer.whole_bytes();
            // As in `finish`.
            let _ = self.writer.sink_mut().cut(whole);
        }
        result
    }
}

#[cfg(test)]
mod tests;
