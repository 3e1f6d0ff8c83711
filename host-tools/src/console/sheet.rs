//! Touches of the sheet, from which the operator gets its height and tilt.
//!
//! The operator jogs the pen to three or more places, down until it touches, and presses Touch. The configuration in force
//! stays as it is: what is stored holds from the next start on.

use super::hub::{Level, Topic};
use super::messages::TouchAction;
use super::{Console, lock};
use crate::settings::sheet::{follows, found, store_sheet};
use crate::touches::{PRESS_MM, TOUCHES_MIN, Touch, rise_mm, tilt_deg};
use etherpen::config::{Config, Paper};
use serde::Serialize;
use std::path::PathBuf;

/// Most touches.
const TOUCHES_MAX: usize = 50;

/// The touches so far.
#[derive(Debug)]
pub(super) struct SheetTouches {
    touches: Vec<Touch>,
    /// The file to store in, or why there is none.
    file: Result<PathBuf, String>,
}

impl Default for SheetTouches {
    fn default() -> Self {
        Self {
            touches: Vec::new(),
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

pub(super) fn view(config: &Config, touches: &[Touch]) -> SheetView {
    let (is_found, text) = match touches.len() {
        0 => (false, format!("configured: {}", words(&config.paper))),
        count if count < TOUCHES_MIN => (false, format!("{count} of {TOUCHES_MIN} touches")),
        count => match found(config, touches, PRESS_MM) {
            Ok((paper, fit)) => {
                let text = format!("{count} touches: {}, {:.2} mm off", words(&paper), fit.residual_mm);
                (true, text)
            }
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

impl Console {
    /// Lets the operator store the sheet's place in a file; without one, says why not.
    pub fn store_sheet_in(&self, file: Result<PathBuf, String>) {
        lock(&self.sheet).file = file;
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
                let hub = self.hub();
                let known = hub
                    .known()
                    .filter(|_| hub.status().is_some_and(|status| status.referenced));
                drop(hub);
                let known = known.ok_or("the robot is not homed, so the place of its pen is unknown")?;
                if sheet.touches.len() >= TOUCHES_MAX {
                    return Err(format!("there are {TOUCHES_MAX} touches already"));
                }
                sheet.touches.push(known.platform_mm.map(f64::from));
            }
            TouchAction::Undo => _ = sheet.touches.pop(),
            TouchAction::Store => {
                let (paper, _) = found(&self.config, &sheet.touches, PRESS_MM)?;
                let file = sheet.file.clone()?;
                store_sheet(&file, &paper).map_err(|error| error.message)?;
                sheet.touches.clear();
                let text = format!(
                    "the sheet's place is stored in {}: {}. It holds when the console is started again",
                    file.display(),
                    words(&paper)
                );
                self.change(|hub| hub.note(Level::Info, text));
            }
        }
        let view = view(&self.config, &sheet.touches);
        self.change(|hub| hub.say(Topic::Sheet, &view));
        Ok(())
    }
}
