//! Identification of the drives on a machine: the test motion run with the present values and with those found.
//!
//! Invariant: only values that the second test motion has tried are stored.

use super::tracking;
use crate::error::{ProgramError, code};
use crate::identification::{self, Answer, NoAnswer, apply, test_config, weak_config};
use crate::job::JobReport;
use crate::link::text;
use crate::settings::Settings;
use etherpen::config::{AxisMode, Config};
use etherpen::robots::MAIN_AXES;
use serde::Serialize;
use std::path::Path;

/// A value of the controller before and after.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Change {
    /// Value of the configuration.
    pub before: f64,
    /// Value found.
    pub after: f64,
    /// One standard deviation; absent if the value itself was not measured.
    pub uncertainty: Option<f64>,
}

/// Result of one axis.
#[derive(Clone, Debug, Serialize)]
pub struct AxisResult {
    /// Number of the axis, from 1.
    pub axis: usize,
    /// What was measured.
    pub measured: Option<Answer>,
    /// Why nothing was measured.
    pub not_measured: Option<String>,
    /// Feed-forward lead, ms.
    pub feed_forward_lead_ms: Change,
    /// Feed-forward gain.
    pub feed_forward_gain: Change,
    /// Feedback gain, 1/s; in position mode that of the drive's position loop.
    pub feedback_gain_per_s: Change,
    /// Lead of the target position, ms; absent unless the axis is in position mode.
    pub position_lead_ms: Option<Change>,
}

impl AxisResult {
    fn new(axis: usize, before: &Config, after: &Config, answer: Result<&Answer, &NoAnswer>) -> Self {
        let (old, new) = (&before.axes[axis], &after.axes[axis]);
        let change = |before: f64, after: f64, uncertainty: Option<f64>| Change {
            before,
            after,
            uncertainty,
        };
        let measured = answer.ok();
        Self {
            axis: axis + 1,
            measured: measured.copied(),
            not_measured: answer.err().map(ToString::to_string),
            feed_forward_lead_ms: change(
                old.feed_forward_lead_ms,
                new.feed_forward_lead_ms,
                measured.map(|answer| answer.lead_ms.uncertainty),
            ),
            feed_forward_gain: change(
                old.feed_forward_gain,
                new.feed_forward_gain,
                measured.map(|answer| answer.feed_forward_gain.uncertainty),
            ),
            feedback_gain_per_s: change(old.feedback_gain_per_s, new.feedback_gain_per_s, None),
            position_lead_ms: (new.mode == AxisMode::Position).then(|| {
                let lead_ms = measured.and_then(|answer| answer.position_lead_ms);
                let uncertainty = lead_ms.map(|lead_ms| lead_ms.uncertainty);
                change(old.position_lead_ms, new.position_lead_ms, uncertainty)
            }),
        }
    }
}

/// Distance in space between the measured platform and its reference over the test motion, mm.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Tracking {
    /// Largest distance.
    pub max_mm: f64,
    /// Root mean square.
    pub rms_mm: f64,
}

impl Tracking {
    fn new(config: &Config, job: &JobReport) -> Self {
        let (max_mm, rms_mm) = tracking(config, &job.samples);
        Self { max_mm, rms_mm }
    }
}

/// Result of an identification.
#[derive(Clone, Debug, Serialize)]
pub struct Identified {
    /// The axes that have a drive.
    pub axes: Vec<AxisResult>,
    /// Tracking with the present values.
    pub tracking_before: Tracking,
    /// Tracking with the values found.
    pub tracking_after: Tracking,
    /// The file with the stored values.
    pub stored: Option<String>,
    /// The configuration with the values found.
    #[serde(skip)]
    config: Config,
}

impl Identified {
    /// Stores the values found in a configuration file; returns how many changed.
    ///
    /// # Errors
    /// The file cannot be changed.
    pub fn store(&mut self, path: &Path) -> Result<usize, ProgramError> {
        let failed = |cause| ProgramError::failed(format!("{} cannot be changed", path.display()), cause);
        let mut settings = Settings::open(path).map_err(failed)?;
        let changed = settings.store_axes(&self.config).map_err(failed)?;
        settings.save(path).map_err(failed)?;
        self.stored = Some(path.display().to_string());
        Ok(changed)
    }
}

/// Runs the test motion, measures delay and gain of the drives, and runs the motion again with the values found. Drives in
/// position mode take one motion more. `only` limits the changes to one axis, from 0; `drive` runs the test motion of a
/// configuration.
///
/// # Errors
/// Errors of `drive`, a needed axis without an estimate, or a value found that is out of bounds.
pub fn identify(
    config: &Config,
    only: Option<usize>,
    mut drive: impl FnMut(&Config) -> Result<JobReport, ProgramError>,
) -> Result<Identified, ProgramError> {
    let first = drive(&test_config(config))?;
    let mut driven = config.axes.iter().take(config.bus.drives.into());
    let answers = match driven.any(|axis| axis.mode == AxisMode::Position) {
        true => {
            let weak = drive(&test_config(&weak_config(config)))?;
            identification::identify_with_weak(config, &first.samples, &weak.samples)
        }
        false => identification::identify(config, &first.samples),
    };
    let drives = usize::from(config.bus.drives);
    refuse_silence(answers.get(..drives).unwrap_or(&answers), only)?;
    let mut found = config.clone();
    apply(&mut found, &answers, only);
    found.check().map_err(|cause| {
        let text = text::config_error(&cause);
        ProgramError::new(code::FAILED, format!("what was measured cannot be used: {text}"))
    })?;
    let second = drive(&test_config(&found))?;
    let axes = answers.iter().take(drives).enumerate();
    Ok(Identified {
        axes: axes
            .map(|(axis, answer)| AxisResult::new(axis, config, &found, answer.as_ref()))
            .collect(),
        tracking_before: Tracking::new(config, &first),
        tracking_after: Tracking::new(&found, &second),
        stored: None,
        config: found,
    })
}

/// Fails if a needed axis has no estimate: the requested axis, or any main axis without a request. The main axes always
/// move.
fn refuse_silence(answers: &[Result<Answer, NoAnswer>], only: Option<usize>) -> Result<(), ProgramError> {
    for (axis, answer) in answers.iter().enumerate() {
        let needed = only.map_or(axis < MAIN_AXES, |only| only == axis);
        if let (true, Err(cause)) = (needed, answer) {
            return Err(ProgramError::new(code::FAILED, format!("axis {}: {cause}", axis + 1)));
        }
    }
    Ok(())
}
