//! What a board's black box has to hold, as seen from outside: the wire, the motors and the operator's reports.
//!
//! Nothing here comes from the board's memory or from the code that writes it. Whether the samples lead to the recorded results
//! is left to the replay.

use crate::black_box::contents::{Contents, EventEntry, FrameEntry, SampleEntry};
use crate::emulator::{REPLIES_MAX, REPLY_BYTES};
use etherpen::application::{Fault, Mode};
use etherpen::black_box::recording::Origin;
use etherpen::black_box::{Direction, Event, SAMPLES};
use etherpen::messages::Command;
use etherpen::robots::AXES;
use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Shortest frame on a cable, without its check sequence, bytes.
const FRAME_BYTES_MIN: usize = 60;
/// Frames kept: more than a black box has room for.
const FRAMES_KEPT: usize = 2_500;
/// Milliseconds kept.
const MOMENTS_KEPT: usize = SAMPLES + 100;
/// Milliseconds of frames that a black box has to hold.
const FRAMES_MS: u32 = 20;
/// Milliseconds before the reading that need not be recorded yet, and those that a firmware which has ended did not record.
const LATE_MS: u32 = 2;
/// Milliseconds until the first one is recorded.
const FIRST_MS: u32 = 3;
/// Events that a black box has room for.
const EVENTS: usize = 100;
/// Longest time from a change to its report, ms, on a line that works.
const REPORTED_MS: u32 = 1_000;
/// How much earlier and later than its millisecond a sample's position may have been true, ms.
const SHOWN_BEFORE_MS: u32 = 6;
const SHOWN_AFTER_MS: u32 = 1;
/// Any distance of an axis from its motor.
const ANYWHERE: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);
/// By how much a measured angle may differ from those, rad.
const ANGLE_RAD: f64 = 1e-3;

/// A frame that passed.
#[derive(Clone, Debug, PartialEq)]
struct Passed {
    direction: Direction,
    bytes: Vec<u8>,
}

#[derive(Clone, Debug, Default)]
struct Seen {
    frames: VecDeque<Passed>,
    /// Frames that passed since the start.
    count: u64,
    /// Numbers of frames that had passed at the last exchanges of the link, oldest first.
    at_exchanges: VecDeque<u64>,
    now_ms: u32,
    /// Time that the wire and the cell have reached, us, and how far a frame came behind it.
    reached_us: u64,
    behind_us: u64,
    /// The true joint angles of each millisecond; `None` where the feedback is not true.
    angles: VecDeque<(u32, Option<[f64; AXES]>)>,
    /// Changes of mode and fault that were reported, with their milliseconds.
    modes: Vec<(u32, Mode)>,
    faults: Vec<(u32, Option<Fault>)>,
}

/// What is seen of one run of a board, from its start on; shared by the wire and the operator.
#[derive(Clone, Debug, Default)]
pub(super) struct Witness(Arc<Mutex<Seen>>);

impl Witness {
    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What was seen until now.
    #[cfg(test)]
    pub(super) fn copy(&self) -> Self {
        Self(Arc::new(Mutex::new(self.seen().clone())))
    }

    /// The faults that were reported.
    #[cfg(test)]
    pub(super) fn faults(&self) -> Vec<Option<Fault>> {
        self.seen().faults.iter().map(|(_, fault)| *fault).collect()
    }

    /// A frame of the board, and what came back on the wire.
    pub(super) fn passes(&self, frame: &[u8], replies: &[Vec<u8>]) {
        let mut seen = self.seen();
        seen.pass(Direction::Sent, frame);
        let arriving = replies.iter().filter(|reply| REPLY_BYTES.contains(&reply.len()));
        for reply in arriving.take(REPLIES_MAX.into()) {
            seen.pass(Direction::Received, reply);
        }
    }

    /// The wire or the cell has come to a time, us.
    pub(super) fn reaches(&self, time_us: u64) {
        let mut seen = self.seen();
        let behind_us = seen.reached_us.saturating_sub(time_us);
        seen.behind_us = seen.behind_us.max(behind_us);
        seen.reached_us = seen.reached_us.max(time_us);
    }

    /// A millisecond of the link: the motors' true angles, `None` where an encoder does not show them, and what was last
    /// reported.
    pub(super) fn moment(&self, ms: u32, angles_rad: Option<[f64; AXES]>, reported: Option<(Mode, Option<Fault>)>) {
        let mut seen = self.seen();
        seen.now_ms = ms;
        let count = seen.count;
        seen.at_exchanges.push_back(count);
        while seen.at_exchanges.len() > 1 + LATE_MS as usize {
            seen.at_exchanges.pop_front();
        }
        seen.angles.push_back((ms, angles_rad));
        if seen.angles.len() > MOMENTS_KEPT {
            seen.angles.pop_front();
        }
        if let Some((mode, fault)) = reported {
            if seen.modes.last().is_none_or(|(_, last)| *last != mode) {
                seen.modes.push((ms, mode));
            }
            if seen.faults.last().map_or(fault.is_some(), |(_, last)| *last != fault) {
                seen.faults.push((ms, fault));
            }
        }
    }

    /// Looks whether a black box that was read after the last [`Self::moment`] holds what was seen, without gaps.
    ///
    /// # Errors
    /// What is missing or different, in words.
    pub(super) fn check(&self, contents: &Contents, origin: Origin, drives: usize) -> Result<(), String> {
        let seen = self.seen();
        if seen.behind_us > 0 {
            return Err(format!("the cell was {} us ahead of a frame", seen.behind_us));
        }
        let summary = &contents.summary;
        if summary.origin != origin {
            return Err(format!("it is that of {:?}", summary.origin));
        }
        seen.check_samples(&contents.samples)?;
        seen.check_angles(contents, drives)?;
        seen.check_events(&contents.events)?;
        seen.check_frames(&contents.frames, summary.frames_missed)
    }
}

impl Seen {
    fn pass(&mut self, direction: Direction, bytes: &[u8]) {
        let bytes = bytes.to_vec();
        self.frames.push_back(Passed { direction, bytes });
        self.count += 1;
        if self.frames.len() > FRAMES_KEPT {
            self.frames.pop_front();
        }
    }

    /// All of the last milliseconds, one after the other, up to now.
    fn check_samples(&self, samples: &[SampleEntry]) -> Result<(), String> {
        let gap = samples
            .windows(2)
            .find(|pair| pair[1].t_ms != pair[0].t_ms.wrapping_add(1));
        if let Some([before, after]) = gap {
            return Err(format!("no samples between {} and {} ms", before.t_ms, after.t_ms));
        }
        let wanted = (SAMPLES as u32).min(self.now_ms.saturating_sub(LATE_MS + FIRST_MS));
        if samples.len() < wanted as usize {
            return Err(format!("{} samples of {wanted}", samples.len()));
        }
        let newest_ms = samples.last().map_or(0, |sample| sample.t_ms);
        if wanted > 0 && !(self.now_ms.saturating_sub(LATE_MS)..=self.now_ms + 1).contains(&newest_ms) {
            return Err(format!("the newest sample is of {newest_ms} ms at {} ms", self.now_ms));
        }
        Ok(())
    }

    /// The angles follow the motors' true ones, where the encoders are true and nobody tells the robot another position.
    fn check_angles(&self, contents: &Contents, drives: usize) -> Result<(), String> {
        let is_homing = |entry: &EventEntry| {
            matches!(
                entry.event,
                Some(Event::Command(Command::Home | Command::HomeAt { .. }) | Event::Mode(Mode::Homing))
            )
        };
        let first_ms = contents.samples.first().map_or(0, |sample| sample.t_ms);
        let is_told = contents.events.len() >= EVENTS
            || contents
                .events
                .iter()
                .filter(|entry| entry.t_ms.saturating_add(REPORTED_MS) >= first_ms)
                .any(is_homing);
        if is_told || self.angles.iter().any(|(_, angles)| angles.is_none()) {
            return Ok(());
        }
        for axis in 0..drives.min(AXES) {
            // Wherever the robot was told that it stands: what all samples leave of the distance from the motor.
            let mut distance_rad = ANYWHERE;
            for sample in &contents.samples {
                let (from_ms, to_ms) = (
                    sample.t_ms.saturating_sub(SHOWN_BEFORE_MS),
                    sample.t_ms.saturating_add(SHOWN_AFTER_MS),
                );
                let before = self.angles.partition_point(|(ms, _)| *ms < from_ms);
                let around = self.angles.iter().skip(before).take_while(|(ms, _)| *ms <= to_ms);
                let (low, high) = around
                    .filter_map(|(_, angles)| angles.map(|angles| angles[axis]))
                    .fold((f64::MAX, f64::MIN), |(low, high), angle| {
                        (low.min(angle), high.max(angle))
                    });
                if !sample.valid[axis] || !sample.homed[axis] || low > high {
                    distance_rad = ANYWHERE;
                    continue;
                }
                let measured_rad = f64::from(sample.measured_rad[axis]);
                let (least_rad, most_rad) = (measured_rad - high - ANGLE_RAD, measured_rad - low + ANGLE_RAD);
                distance_rad = (distance_rad.0.max(least_rad), distance_rad.1.min(most_rad));
                let off_rad = distance_rad.0 - distance_rad.1;
                if off_rad > 0.0 {
                    return Err(format!(
                        "axis {}: {off_rad:.4} rad further from the motor at {} ms than before",
                        axis + 1,
                        sample.t_ms
                    ));
                }
            }
        }
        Ok(())
    }

    /// Each event can be read, and what was reported is among them, in its order.
    fn check_events(&self, events: &[EventEntry]) -> Result<(), String> {
        if let Some(entry) = events.iter().find(|entry| entry.event.is_none()) {
            return Err(format!("an event of {} ms that cannot be read", entry.t_ms));
        }
        if !events.is_sorted_by_key(|entry| entry.t_ms) || events.last().is_some_and(|last| last.t_ms > self.now_ms + 1)
        {
            return Err("times of events".to_owned());
        }
        let is_whole = events.len() < EVENTS;
        if is_whole && events.first().is_none_or(|first| first.t_ms > FIRST_MS) {
            return Err("events without their beginning".to_owned());
        }
        let from_ms = match is_whole {
            true => 0,
            false => events.first().map_or(0, |first| first.t_ms.saturating_add(REPORTED_MS)),
        };
        let modes = events.iter().filter_map(|entry| match entry.event {
            Some(Event::Mode(mode)) => Some(mode),
            _ => None,
        });
        in_order("mode", reported(&self.modes, from_ms, is_whole), modes)?;
        let faults = events.iter().filter_map(|entry| match entry.event {
            Some(Event::Fault(fault)) => Some(fault),
            _ => None,
        });
        in_order("fault", reported(&self.faults, from_ms, is_whole), faults)
    }

    /// The frames of the wire, in each direction without one missing, for long enough and up to now.
    fn check_frames(&self, frames: &[FrameEntry], missed: u32) -> Result<(), String> {
        let is_needed = |number: u64| self.at_exchanges.front().is_some_and(|needed| number < *needed);
        let first_kept = self.count - self.frames.len() as u64;
        for direction in [Direction::Sent, Direction::Received] {
            let passed: Vec<(u64, &[u8])> = (first_kept..)
                .zip(&self.frames)
                .filter(|(_, frame)| frame.direction == direction)
                .map(|(number, frame)| (number, frame.bytes.as_slice()))
                .collect();
            let recorded: Vec<Cow<'_, [u8]>> = frames
                .iter()
                .filter(|frame| frame.direction == direction)
                .map(|frame| on_the_wire(direction, &frame.bytes))
                .collect();
            let needed = passed.iter().take_while(|(number, _)| is_needed(*number)).count();
            if missed > 0 {
                // Those that it counts as not recorded are not known.
                let mut passed = passed.iter();
                let found = recorded
                    .iter()
                    .filter(|bytes| passed.any(|(_, passed)| *passed == bytes.as_ref()))
                    .count();
                if found < recorded.len() {
                    return Err(format!("{direction:?}: a frame that was not on the wire"));
                }
                continue;
            }
            let is_at = |end: usize| {
                let bytes = passed.get(..end).unwrap_or_default().iter().map(|(_, bytes)| *bytes);
                recorded.len() <= end && bytes.skip(end - recorded.len()).eq(recorded.iter().map(AsRef::as_ref))
            };
            if !(needed..=passed.len()).any(is_at) {
                let number = |bytes: &[u8]| passed.iter().rposition(|(_, passed)| *passed == bytes);
                let places: Vec<_> = recorded.iter().map(|bytes| number(bytes)).collect();
                let strange = places.iter().filter(|place| place.is_none()).count();
                let behind = places
                    .iter()
                    .flatten()
                    .max()
                    .map_or(passed.len(), |last| passed.len() - 1 - last);
                return Err(format!(
                    "{direction:?}: {} frames are not the last ones of the wire: {strange} were not on it, {behind} came later",
                    recorded.len()
                ));
            }
        }
        let held_ms = frames.first().map_or(0.0, |first| first.before_end_s * 1e3);
        let is_all = frames.len() as u64 + u64::from(missed) + 32 >= self.count;
        if held_ms < f64::from(FRAMES_MS) && !is_all {
            return Err(format!("{held_ms:.1} ms of frames"));
        }
        Ok(())
    }
}

/// A recorded frame as a witness of the wire has it: the controller pads a short one behind what the driver wrote, and this
/// emulator's network pads none.
fn on_the_wire(direction: Direction, bytes: &[u8]) -> Cow<'_, [u8]> {
    if direction == Direction::Received || bytes.len() >= FRAME_BYTES_MIN {
        return Cow::Borrowed(bytes);
    }
    let mut padded = bytes.to_vec();
    padded.resize(FRAME_BYTES_MIN, 0);
    Cow::Owned(padded)
}

/// What was reported from a time on. Unless all events are there, the first report may be of a change before them.
fn reported<T: Copy>(reports: &[(u32, T)], from_ms: u32, is_whole: bool) -> impl Iterator<Item = T> {
    let later = reports.iter().filter(move |(ms, _)| *ms >= from_ms);
    later.skip(usize::from(!is_whole)).map(|(_, report)| *report)
}

/// Whether everything that was reported is recorded, in its order.
fn in_order<T: std::fmt::Debug>(
    what: &str,
    reported: impl Iterator<Item = T>,
    mut recorded: impl Iterator<Item = T>,
) -> Result<(), String> {
    for report in reported {
        // In words, in which a figure that is no number is equal to itself.
        let words = format!("{report:?}");
        if !recorded.any(|recorded| format!("{recorded:?}") == words) {
            return Err(format!("the {what} {report:?} was reported and is not recorded"));
        }
    }
    Ok(())
}
