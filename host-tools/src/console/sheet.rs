//! Touches of the sheet, from which the operator gets its height and tilt.
//!
//! The operator jogs the pen to three or more places, down until it touches, and presses Touch. The configuration in force
//! stays as it is: what is stored holds from the next start on.
//!
//! Invariant: no touch outlives the reference in which it was taken.

use super::hub::{Hub, Level, Topic};
use super::messages::TouchAction;
use super::{Console, lock};
use crate::settings::sheet::{follows, found, store_sheet};
use crate::touches::{PRESS_MM, TOUCHES_MIN, Touch, add, check_residual, rise_mm, tilt_deg};
use etherpen::application::Mode;
use etherpen::config::{Config, Paper};
use etherpen::messages::Status;
use serde::Serialize;
use std::path::PathBuf;

/// Most touches.
const TOUCHES_MAX: usize = 50;
/// Time for which the pen has to stand still before a touch, ms, and the farthest it may go meanwhile, mm.
const STILL_MS: u64 = 60;
const STILL_MM: f32 = 0.05;

/// The touches so far.
#[derive(Debug)]
pub(super) struct SheetTouches {
    touches: Vec<Touch>,
    /// What this console has stored.
    stored: Option<Paper>,
    /// The file to store in, or why there is none.
    file: Result<PathBuf, String>,
}

impl Default for SheetTouches {
    fn default() -> Self {
        Self {
            touches: Vec::new(),
            stored: None,
            file: Err("this console has no configuration file to store in".to_owned()),
        }
    }
}

/// The sheet's place as shown on the page.
#[derive(Debug, Serialize)]
pub(super) struct SheetView {
    /// Whether the machine can follow a sheet that is not level.
    follows: bool,
    touches: usize,
    /// Whether the touches give a place that can be stored.
    is_found: bool,
    text: String,
}

/// The place of a sheet in words.
fn words(paper: &Paper) -> String {
    let words = format!(
        "tilt {:.2}°, {:.2} mm over the sheet, height {:.2} mm",
        tilt_deg(paper.slope),
        rise_mm(paper),
        paper.pen_down_z_mm
    );
    // The page writes numbers with a true minus.
    words.replace('-', "−")
}

/// The place of a robot's pen that stands still.
///
/// # Errors
/// Why it is not known, or that the pen moves.
fn touching(hub: &Hub) -> Result<Touch, &'static str> {
    let status = hub.status().filter(|status| status.referenced);
    let status = status.ok_or("the robot is not homed, so the place of its pen is unknown")?;
    let is_at_rest = matches!(status.mode, Mode::Idle | Mode::DrivesOff | Mode::Fault);
    let history = hub.history();
    let (_, rows) = history.some_since(history.next().saturating_sub(STILL_MS), usize::MAX);
    let last = rows.last().map(|row| row.measured_mm());
    let last = last.filter(|place| place.iter().all(|value| value.is_finite()));
    let last = last.ok_or("the robot does not report where its pen is; look at its drives")?;
    let is_near = |place: [f32; 3]| place.iter().zip(last).all(|(then, now)| (then - now).abs() < STILL_MM);
    match is_at_rest && rows.iter().all(|row| is_near(row.measured_mm())) {
        true => Ok(last.map(f64::from)),
        false => Err("the pen does not stand still; wait until it does, then press Touch again"),
    }
}

fn view(config: &Config, sheet: &SheetTouches) -> SheetView {
    let touches = &sheet.touches;
    let (is_found, text) = match touches.len() {
        0 => (false, resting_text(config, sheet.stored.as_ref())),
        count if count < TOUCHES_MIN => (false, format!("{count} of {TOUCHES_MIN} touches")),
        count => match found(config, touches, PRESS_MM) {
            Ok((paper, fit)) => match check_residual(touches, &fit) {
                Ok(()) => {
                    let off = format!("touch {} is {:.2} mm off", fit.worst, fit.residual_mm);
                    (true, format!("{count} touches: {}; {off}", words(&paper)))
                }
                Err(why) => (false, why.to_string()),
            },
            Err(why) => (false, why),
        },
    };
    SheetView {
        follows: follows(config).is_ok(),
        touches: touches.len(),
        is_found,
        text,
    }
}

/// What is shown without a touch.
fn resting_text(config: &Config, stored: Option<&Paper>) -> String {
    match stored {
        Some(paper) => format!("stored; holds after a restart of the console: {}", words(paper)),
        None => format!("configured: {}", words(&config.paper)),
    }
}

/// The sheet's place before any touch.
pub(super) fn configured(config: &Config) -> SheetView {
    view(config, &SheetTouches::default())
}

impl Console {
    /// Lets the operator store the sheet's place in a file; without one, says why not.
    pub fn store_sheet_in(&self, file: Result<PathBuf, String>) {
        lock(&self.sheet).file = file;
    }

    /// Forgets the touches if the robot has lost its reference, or is being homed anew.
    pub(super) fn keep_touches(&self, status: &Status) {
        if status.referenced && status.mode != Mode::Homing {
            return;
        }
        let mut sheet = lock(&self.sheet);
        if sheet.touches.is_empty() {
            return;
        }
        sheet.touches.clear();
        let view = view(&self.config, &sheet);
        self.change(|hub| {
            let text = "the touches of the sheet are forgotten: the robot has lost its place; home it, and touch the sheet anew";
            hub.note(Level::Warning, text);
            hub.say(Topic::Sheet, &view);
        });
    }

    /// Takes a touch, forgets one, or stores the sheet's place.
    ///
    /// # Errors
    /// Why nothing was done.
    pub(super) fn touch(&self, action: TouchAction) -> Result<(), String> {
        follows(&self.config)?;
        let mut sheet = lock(&self.sheet);
        match action {
            TouchAction::Add => {
                let touch = touching(&self.hub())?;
                if sheet.touches.len() >= TOUCHES_MAX {
                    return Err(format!("there are {TOUCHES_MAX} touches already"));
                }
                add(&mut sheet.touches, touch);
            }
            TouchAction::Undo => _ = sheet.touches.pop(),
            TouchAction::Store => {
                let (paper, fit) = found(&self.config, &sheet.touches, PRESS_MM)?;
                check_residual(&sheet.touches, &fit).map_err(|why| why.to_string())?;
                let file = sheet.file.clone()?;
                let stored = store_sheet(&file, &self.config, &paper, "the console");
                stored.map_err(|error| error.message)?;
                sheet.touches.clear();
                sheet.stored = Some(paper);
                let text = format!(
                    "the sheet's place is stored in {}: {}. It holds when the console is started again",
                    file.display(),
                    words(&paper)
                );
                self.change(|hub| hub.note(Level::Info, text));
            }
        }
        let view = view(&self.config, &sheet);
        self.change(|hub| hub.say(Topic::Sheet, &view));
        Ok(())
    }
}
