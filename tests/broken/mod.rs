//! A seeded bad line between a job and the firmware, and the requirements on a drawing over it.
//!
//! The line is good until the drawing has begun (a configuration of a kilobyte cannot pass if one percent of the bytes
//! is damaged), then bytes are damaged, lost, doubled and swapped in both directions. While the cable is unplugged,
//! nothing passes; the program at its end loses its port, and greets with another session when the cable is plugged in
//! again. It resumes the drawing, as a person with `etherpen draw --resume` does.

use etherpen::config::Config;
use etherpen::messages::{Command, Sample};
use etherpen::motion::Pen;
use host_tools::cell::InkStroke;
use host_tools::emulator::{LINK_BYTES_MAX, Link};
use host_tools::job::error::{JobError, Phase};
use host_tools::job::{DrawTask, Job, JobEvent, JobOptions, Task as JobTask};
use host_tools::random::Xorshift;
use host_tools::run::RunTask;
use host_tools::simulation::Host;
use std::collections::{BTreeSet, VecDeque};

/// Damaged bytes in a million; one percent.
const DAMAGED: u64 = 10_000;
/// Lost, doubled and swapped bytes in a million, each.
const OTHERWISE_SPOILT: u64 = 500;
/// When the cable is pulled, as a share of the path's vertices, and for how long, ms: longer than the firmware waits
/// for a host, much longer, and shorter, so that it continues with the vertices that it has.
const CUTS: [(f64, u64); 3] = [(0.15, 900), (0.4, 4_000), (0.65, 250)];
/// Longest distance of a point of ink from the other run's ink, mm.
const SAME_MM: f64 = 0.03;

/// One direction.
struct Direction {
    random: Xorshift,
    kept: Option<u8>,
    queue: VecDeque<u8>,
}

impl Direction {
    fn new(seed: u64) -> Self {
        Self {
            random: Xorshift::new(seed),
            kept: None,
            queue: VecDeque::new(),
        }
    }

    /// Carries bytes; those that are doubled wait for room.
    fn carry(&mut self, bytes: &[u8], spoils: bool, room: usize) -> Vec<u8> {
        for byte in bytes {
            let number = if spoils {
                self.random.scrambled() % 1_000_000
            } else {
                u64::MAX
            };
            let other = |kind: u64| DAMAGED + kind * OTHERWISE_SPOILT;
            if number < DAMAGED {
                let bit = self.random.scrambled() % 8;
                self.queue.push_back(byte ^ (1 << bit));
            } else if number < other(1) {
                continue;
            } else if number < other(2) {
                self.queue.extend([*byte, *byte]);
            } else if number < other(3) && self.kept.is_none() {
                self.kept = Some(*byte);
                continue;
            } else {
                self.queue.push_back(*byte);
            }
            self.queue.extend(self.kept.take());
        }
        let length = self.queue.len().min(room);
        self.queue.drain(..length).collect()
    }
}

fn options(session: u32) -> JobOptions {
    JobOptions {
        session,
        forward_samples: true,
        ..JobOptions::default()
    }
}

/// A person with a program at the end of a bad line.
pub(crate) struct BadLine {
    config: Config,
    drawing: DrawTask,
    job: Job,
    session: u32,
    job_begun_ms: u64,
    to_host: Direction,
    to_firmware: Direction,
    spoils: bool,
    cuts: VecDeque<(f64, u64)>,
    plugged_in_ms: Option<u64>,
    /// Pen-down strokes in the order in which samples reported them; samples are few on such a line.
    pub(crate) strokes: Vec<u32>,
    /// Connections that started the drawing, resumed it, or found it finished.
    pub(crate) resumed: BTreeSet<u32>,
    /// Number of drawings that started at vertex 0.
    pub(crate) begun: u32,
    pub(crate) bad_frames: u32,
    pub(crate) outcome: Option<Result<(), JobError>>,
}

impl BadLine {
    pub(crate) fn new(task: &RunTask, seed: u64) -> Self {
        println!("seed {seed:#x}");
        let drawing = DrawTask::new(task.path.clone());
        let job = Job::new(task.config.clone(), JobTask::Draw(drawing.clone()), options(1));
        Self {
            config: task.config.clone(),
            drawing,
            job,
            session: 1,
            job_begun_ms: 0,
            to_host: Direction::new(seed),
            to_firmware: Direction::new(seed + 1),
            spoils: false,
            cuts: CUTS.into(),
            plugged_in_ms: None,
            strokes: Vec::new(),
            resumed: BTreeSet::new(),
            begun: 0,
            bad_frames: 0,
            outcome: None,
        }
    }

    /// One millisecond.
    pub(crate) fn step(&mut self, ms: u64, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        if let Some(plugged_in_ms) = self.plugged_in_ms {
            if ms < plugged_in_ms {
                return;
            }
            self.plug_in(ms);
        }
        let arrived = self.to_host.carry(from_firmware, self.spoils, usize::MAX);
        let mut sent = Vec::new();
        self.job.step(ms - self.job_begun_ms, &arrived, &mut sent, room);
        to_firmware.extend(self.to_firmware.carry(&sent, self.spoils, room));
        while let Some(event) = self.job.next_event() {
            self.take(&event);
        }
        self.outcome = self.job.outcome().copied();
        self.pull(ms);
    }

    fn take(&mut self, event: &JobEvent) {
        match event {
            JobEvent::Phase(Phase::Drawing) => {
                self.spoils = true;
                self.begun += u32::from(self.session == 1);
                self.resumed.insert(self.session);
            }
            // At the end the line is good again, because the firmware's measurements are long.
            JobEvent::Phase(Phase::Resting) => {
                self.spoils = false;
                self.resumed.insert(self.session);
            }
            JobEvent::Samples { samples, .. } => self.note(samples),
            JobEvent::Told {
                command: Command::Draw { .. },
                ..
            } => self.begun += 1,
            _ => {}
        }
    }

    fn note(&mut self, samples: &[Sample]) {
        for sample in samples.iter().filter(|sample| sample.pen == Pen::Down) {
            if self.strokes.last() != Some(&sample.stroke) {
                self.strokes.push(sample.stroke);
            }
        }
    }

    fn pull(&mut self, ms: u64) {
        let progress = self.job.progress();
        let share = progress.vertices as f64 / progress.vertices_total.max(1) as f64;
        if self.job.phase() == Phase::Drawing
            && let Some((_, out_ms)) = self.cuts.pop_front_if(|(at, _)| share >= *at)
        {
            self.plugged_in_ms = Some(ms + out_ms);
            (self.to_host.queue, self.to_firmware.queue) = Default::default();
        }
    }

    fn plug_in(&mut self, ms: u64) {
        self.bad_frames += self.job.counts().frames.bad;
        self.plugged_in_ms = None;
        self.session += 1;
        self.job_begun_ms = ms;
        let held = DrawTask {
            held: true,
            ..self.drawing.clone()
        };
        self.job = Job::new(self.config.clone(), JobTask::Draw(held), options(self.session));
    }

    /// Asserts that all planned disturbances happened, and that the drawing ended well.
    pub(crate) fn assert_reported(&self) {
        assert_eq!(self.outcome, Some(Ok(())));
        assert_eq!((self.begun, self.resumed.len(), self.cuts.len()), (1, 4, 0));
        assert!(self.bad_frames > 50, "{} frames were spoilt", self.bad_frames);
        assert!(self.strokes.is_sorted(), "{:?}", self.strokes);
    }
}

impl Host for BadLine {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        self.step(u64::from(ms), from_firmware, to_firmware, room);
    }

    fn is_over(&self) -> bool {
        self.outcome.is_some()
    }
}

impl Link for BadLine {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        if self.outcome.is_none() {
            self.step(u64::from(ms), from_device, to_device, LINK_BYTES_MAX);
        }
    }
}

fn length_mm(ink: &[InkStroke]) -> f64 {
    let pairs = ink.iter().flat_map(|stroke| stroke.points_mm.windows(2));
    pairs.map(|pair| distance_mm(&pair[0], &pair[1])).sum()
}

fn distance_mm(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn to_segment_mm(point: &[f64; 2], a: &[f64; 2], b: &[f64; 2]) -> f64 {
    let (along, away) = ([b[0] - a[0], b[1] - a[1]], [point[0] - a[0], point[1] - a[1]]);
    let squared = along[0].powi(2) + along[1].powi(2);
    let share = if squared > 0.0 {
        ((away[0] * along[0] + away[1] * along[1]) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    distance_mm(point, &[a[0] + share * along[0], a[1] + share * along[1]])
}

/// The pieces of a stroke that was held in between, put together: a piece that begins where the last one ended
/// continues it.
fn strokes(ink: &[InkStroke]) -> Vec<Vec<[f64; 2]>> {
    let mut strokes: Vec<Vec<[f64; 2]>> = Vec::new();
    for piece in ink.iter().filter(|piece| !piece.points_mm.is_empty()) {
        let first = &piece.points_mm[0];
        match strokes.last_mut() {
            Some(stroke) if stroke.last().is_some_and(|last| distance_mm(last, first) < SAME_MM) => {
                stroke.extend_from_slice(&piece.points_mm);
            }
            _ => strokes.push(piece.points_mm.clone()),
        }
    }
    strokes
}

/// Farthest point of one line from another line, mm.
fn farthest_mm(line: &[[f64; 2]], other: &[[f64; 2]]) -> f64 {
    let nearest = |point: &[f64; 2]| {
        let distances = other.windows(2).map(|pair| to_segment_mm(point, &pair[0], &pair[1]));
        distances.fold(f64::INFINITY, f64::min)
    };
    line.iter().map(nearest).fold(0.0, f64::max)
}

/// Asserts that two runs drew the same strokes: as many, in the same order, each within a few hundredths of a
/// millimetre of the other in both directions, and nothing twice.
pub(crate) fn assert_same_ink(undisturbed: &[InkStroke], disturbed: &[InkStroke]) {
    let (whole, broken) = (strokes(undisturbed), strokes(disturbed));
    assert_eq!(whole.len(), broken.len(), "strokes");
    let mut worst_mm = 0.0_f64;
    for (number, (whole, broken)) in whole.iter().zip(&broken).enumerate() {
        let apart_mm = farthest_mm(whole, broken).max(farthest_mm(broken, whole));
        assert!(
            apart_mm <= SAME_MM,
            "stroke {number} lies {apart_mm} mm from the undisturbed one"
        );
        worst_mm = worst_mm.max(apart_mm);
    }
    let (whole_mm, broken_mm) = (length_mm(undisturbed), length_mm(disturbed));
    println!(
        "{} strokes in {} pieces, {whole_mm:.2} mm undisturbed, {broken_mm:.2} mm disturbed, at most {worst_mm:.4} mm apart",
        whole.len(),
        disturbed.len()
    );
    assert!((whole_mm - broken_mm).abs() < 0.2, "{whole_mm} mm and {broken_mm} mm");
}
