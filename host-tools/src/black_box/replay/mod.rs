//! Replays a recording: the controller's own sampler gets the recorded inputs in virtual time, millisecond by
//! millisecond, and has to come to the recorded results.
//!
//! Inputs are the encoder positions (from angles and increments), which axes answered, status words, setpoints, late
//! telegrams and the board's inputs, and orders: power, home and acknowledgement by their events, the beginning and end
//! of following by the samples. Results are standstill, home, and above all the latched fault with its millisecond; the
//! angles show that positions and home were taken rightly. What the sampler does not decide, or what no sample holds, is
//! not replayed: a stop by command, the state of a slave, the bus clock.
//!
//! Invariant: no recording makes this module panic.

mod comparison;
mod drives;
mod events;
mod player;
mod positions;

use super::contents::{Contents, SampleEntry};
use drives::{Control, Queues};
use etherpen::application::Fault;
use etherpen::config::{AxisMode, Config};
use etherpen::drives::cia402::{DriveState, StatusWord};
use etherpen::robots::AXES;
use events::{EVENT_MS, Events};
use player::Player;
use serde::Serialize;

/// Time after a configuration until the tasks have taken it, ms.
const CONFIGURED_MS: u32 = 10;
/// Time until controllers and supervision have forgotten what was before the recording, ms.
const SETTLED_MS: usize = 25;

/// Speed up to which a replay may begin in motion, rad/s: in the lag of a drive, 3 ms, it makes a milliradian, an eighth
/// of the usual limit of the feedback's deviation.
const SLOW_RAD_S: f32 = 0.3;

/// Result of a replay.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Replay {
    /// The controller's time of the first millisecond that was compared, ms.
    pub from_ms: u32,
    /// Number of milliseconds in which recording and replay agree.
    pub agreed_ms: u32,
    /// Faults that both latched in the same millisecond.
    pub faults: Vec<Latched>,
    /// Where they differ; the replay ends there.
    pub difference: Option<Difference>,
    /// A fault whose cause the samples do not hold, or not all of it; the replay ends there.
    pub not_recorded: Option<Latched>,
}

/// A fault and its millisecond.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Latched {
    /// Time before the end of the recording, s.
    pub before_end_s: f64,
    /// The recorded fault; `None` if its event is missing, or another task's fault came first.
    pub fault: Option<Fault>,
}

/// The first result in which recording and replay differ.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Time before the end of the recording, s.
    pub before_end_s: f64,
    /// What differs, in words.
    pub what: String,
}

/// Replays the last samples that follow each other without a gap and have one configuration.
///
/// # Errors
/// Why there is nothing to replay, in words.
pub fn replay(contents: &Contents, config: &Config) -> Result<Replay, String> {
    let samples = stretch(contents, config)?;
    let mut queues = Queues::new(config);
    let control = Control::new(&mut queues, config);
    Ok(Player::new(contents, samples, config, control).play())
}

/// The samples that can be replayed.
fn stretch<'c>(contents: &'c Contents, config: &Config) -> Result<&'c [SampleEntry], String> {
    let samples = &contents.samples[..];
    let gap = samples
        .windows(2)
        .rposition(|pair| pair[1].t_ms != pair[0].t_ms.wrapping_add(1));
    let behind_gap = gap.map_or(0, |gap| gap + 1);
    let configured_ms = Events(&contents.events).configured_ms();
    let configured_ms = configured_ms.map(|ms| ms.wrapping_add(CONFIGURED_MS));
    let after = samples.get(behind_gap..).unwrap_or_default();
    let is_usable = |index: usize| {
        let Some(sample) = after.get(index) else { return false };
        // A part of the axes cannot be homed, and an axis that comes back may be about to lose its home.
        let recent = after.get(index.saturating_sub(EVENT_MS as usize)..=index);
        let are_there = recent.is_some_and(|recent| recent.iter().all(|sample| sample.valid == [true; AXES]));
        // An axis without a drive has a position from the configuration on; the events may not reach back so far.
        let is_configured = sample.valid.iter().skip(config.bus.drives.into()).all(|valid| *valid);
        let is_uniform = sample.homed == [false; AXES] || sample.homed == [true; AXES] && are_there;
        let is_after = configured_ms.is_none_or(|ms| sample.t_ms.wrapping_sub(ms) < u32::MAX / 2);
        is_uniform && is_configured && is_after && (has_no_power(sample) || !without_velocity(config))
    };
    let fault = after.iter().position(|sample| sample.fault);
    let last = fault.unwrap_or(after.len()).saturating_sub(SETTLED_MS);
    let usable = || (0..after.len()).filter(|index| is_usable(*index));
    let early = || usable().take_while(|index| *index < last);
    let speed = |index: usize| after.get(index..index + 2).map_or(f32::MAX, speed_rad_s);
    // From drives without power, a replay is exact. What controllers and supervision knew of an earlier motion is
    // missing, the less, the slower it was; but a late beginning is better than none.
    early()
        .find(|index| has_no_power(&after[*index]))
        .or_else(|| early().find(|index| speed(*index) < SLOW_RAD_S))
        .or_else(|| early().min_by(|one, other| speed(*one).total_cmp(&speed(*other))))
        .or_else(|| usable().next())
        .and_then(|first| after.get(first..))
        .filter(|samples| samples.len() > SETTLED_MS)
        .ok_or_else(|| {
            format!(
                "fewer than {SETTLED_MS} ms in a row can be replayed: a replay needs one configuration, all axes homed or \
                 none, and, in torque mode, drives without power at its beginning"
            )
        })
}

/// The greatest speed of a joint from one sample to the next, rad/s.
fn speed_rad_s(pair: &[SampleEntry]) -> f32 {
    let [one, next] = pair else { return f32::MAX };
    let moved = one.measured_rad.iter().zip(&next.measured_rad);
    moved.fold(0.0, |most, (one, next)| most.max((next - one).abs() * 1e3))
}

fn without_velocity(config: &Config) -> bool {
    config.axes.iter().any(|axis| axis.mode != AxisMode::Velocity)
}

/// Whether no drive has power, so that the controllers have forgotten all motion.
fn has_no_power(sample: &SampleEntry) -> bool {
    let has_power = |word: &u16| StatusWord(*word).state() == DriveState::OperationEnabled;
    !sample.following && !sample.status_word.iter().any(has_power)
}
