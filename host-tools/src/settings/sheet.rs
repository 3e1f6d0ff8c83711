//! Where the sheet lies: whether a machine can follow it, and its values in the file.

use super::{Settings, SettingsError, checking};
use crate::error::{ProgramError, code};
use crate::link::text;
use crate::touches::{Fit, Touch, check_corners, fit, lying};
use etherpen::config::{Config, Paper, PenLiftKind};
use etherpen::motion::WorkArea;
use etherpen::robots::MAIN_AXES;
use std::path::Path;
use toml_edit::{Array, Item, Value};

impl Settings {
    /// Stores height and slope of a sheet if they differ from the file's; returns the number of changed values.
    ///
    /// # Errors
    /// [`SettingsError`]; nothing is written.
    pub fn store_sheet(&mut self, paper: &Paper) -> Result<usize, SettingsError> {
        let now = self.config()?.paper;
        let mut changed = 0;
        if now.pen_down_z_mm != paper.pen_down_z_mm {
            self.set_paper("pen_down_z_mm", paper.pen_down_z_mm.into());
            changed += 1;
        }
        if now.slope != paper.slope {
            let slope: Array = paper.slope.into_iter().collect();
            self.set_paper("slope", slope.into());
            changed += 1;
        }
        Ok(changed)
    }

    fn set_paper(&mut self, field: &str, mut value: Value) {
        let paper = self.document.entry("paper").or_insert_with(toml_edit::table);
        // A configuration that was read has no other kind of paper.
        let Some(paper) = paper.as_table_like_mut() else { return };
        if let Some(before) = paper.get(field).and_then(Item::as_value) {
            *value.decor_mut() = before.decor().clone();
        }
        paper.insert(field, Item::Value(value));
    }
}

/// Whether the machine's axes set the height of the pen, so that it can follow a sheet that is not level.
///
/// # Errors
/// Why not, and what to do.
pub fn follows(config: &Config) -> Result<(), String> {
    let by = match config.pen.kind {
        PenLiftKind::Axis if usize::from(config.bus.drives) >= MAIN_AXES => return Ok(()),
        PenLiftKind::Axis => "has no axis for its height",
        PenLiftKind::Output | PenLiftKind::Servo => "is lowered by an output",
        PenLiftKind::None => "always touches",
    };
    Err(format!(
        "the pen of this machine {by}, so it cannot follow a sheet that is not level: only a pen whose height is an axis \
         ([pen] kind = \"axis\") can; level the sheet instead"
    ))
}

/// The sheet that was touched at these places, if the machine reaches all of it; the pen draws `press_mm` below its first
/// touch.
///
/// # Errors
/// The touches give no plane, or say too little about a corner of the sheet, or the machine does not reach the sheet there.
pub fn found(config: &Config, touches: &[Touch], press_mm: f64) -> Result<(Paper, Fit), String> {
    let found = fit(touches).map_err(|cause| cause.to_string())?;
    check_corners(touches, &config.paper).map_err(|cause| cause.to_string())?;
    let paper = lying(&config.paper, &found.plane, press_mm);
    let there = Config {
        paper,
        ..config.clone()
    };
    let refused = |cause: String| format!("the sheet cannot lie there: {cause}");
    there.check().map_err(|error| refused(text::config_error(&error)))?;
    let area = WorkArea::new(&there.motion_settings()).map_err(|cause| refused(text::config_refusal(&cause.into())))?;
    match checking::unreached(&there, &area) {
        None => Ok((paper, found)),
        Some(cause) => Err(refused(cause)),
    }
}

/// Stores height and slope of a sheet in a configuration file; returns the number of changed values. `known` is the
/// configuration with which they were found, and `reader` what read it from the file.
///
/// # Errors
/// The file says something else than `known` about the rest of the machine, cannot be changed, or would not be a valid
/// configuration.
pub fn store_sheet(path: &Path, known: &Config, paper: &Paper, reader: &str) -> Result<usize, ProgramError> {
    let failed = |cause| ProgramError::failed(format!("{} cannot be changed", path.display()), cause);
    let mut settings = Settings::open(path).map_err(failed)?;
    let mut now = settings.config().map_err(failed)?;
    (now.paper.pen_down_z_mm, now.paper.slope) = (known.paper.pen_down_z_mm, known.paper.slope);
    if now != *known {
        let text = format!(
            "{} has changed since {reader} was started, so the sheet's place may be wrong for it: start {reader} again, then \
             touch the sheet anew",
            path.display()
        );
        return Err(ProgramError::new(code::FAILED, text));
    }
    let changed = settings.store_sheet(paper).map_err(failed)?;
    settings.save(path).map_err(failed)?;
    Ok(changed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn height_and_slope_are_stored_and_everything_else_stays_as_it_was_written() {
        let wanted = Paper {
            pen_down_z_mm: -29.125,
            slope: [0.008727, -0.001],
            ..Paper::default()
        };
        let bundled = crate::settings::machines::MACHINES[1].text;
        for (text, expected) in [
            (
                bundled.to_owned(),
                bundled.replace(
                    "pen_down_z_mm = -30.0\npen_lift_mm = 3.0\n",
                    "pen_down_z_mm = -29.125\npen_lift_mm = 3.0\nslope = [0.008727, -0.001]\n",
                ),
            ),
            (
                bundled.replace("-30.0\n", "-30.0  # as measured\nslope = [0.0, 0.0]  # level\n"),
                bundled.replace(
                    "-30.0\n",
                    "-29.125  # as measured\nslope = [0.008727, -0.001]  # level\n",
                ),
            ),
        ] {
            let mut settings = Settings::parse(&text).unwrap();
            assert_eq!(settings.store_sheet(&wanted).unwrap(), 2);
            assert_eq!(settings.document.to_string(), expected);
            let paper = settings.config().unwrap().paper;
            assert_eq!((paper.pen_down_z_mm, paper.slope), (-29.125, wanted.slope));
            assert_eq!(settings.store_sheet(&wanted).unwrap(), 0);
        }
        let paper = Paper {
            pen_down_z_mm: -851.0,
            ..Paper::default()
        };
        for (text, expected) in [
            ("", "[paper]\npen_down_z_mm = -851.0\n"),
            (
                "# mine\n[paper]\npen_down_z_mm = -850.0  # the table\n",
                "# mine\n[paper]\npen_down_z_mm = -851.0  # the table\n",
            ),
            (
                "[axis_defaults]\ngear = 14.0\n\n[paper]\n",
                "[axis_defaults]\ngear = 14.0\n\n[paper]\npen_down_z_mm = -851.0\n",
            ),
        ] {
            let mut settings = Settings::parse(text).unwrap();
            assert_eq!(settings.store_sheet(&paper).unwrap(), 1);
            assert_eq!(settings.document.to_string(), expected);
            assert_eq!(settings.config().unwrap().paper, paper);
        }
    }

    #[test]
    fn a_file_that_says_something_else_than_at_the_start_is_not_changed() {
        let path = std::env::temp_dir().join(format!("etherpen-sheet-{}.toml", std::process::id()));
        let paper = Paper {
            slope: [0.01, 0.0],
            ..Paper::default()
        };
        let store = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let stored = store_sheet(&path, &Config::default(), &paper, "the console");
            (stored, std::fs::read_to_string(&path).unwrap())
        };
        for other in [
            "[paper]\ncentre_mm = [50.0, 0.0]\n",
            "[[axes]]\nsync_increments = 77\n[[axes]]\n[[axes]]\n[[axes]]\n",
        ] {
            let (refused, text) = store(other);
            let refused = refused.unwrap_err();
            assert!(
                refused.message.contains("has changed since the console was started"),
                "{}",
                refused.message
            );
            assert_eq!(text, other);
        }
        let (stored, text) = store("[paper]\npen_down_z_mm = -849.0\n");
        std::fs::remove_file(&path).unwrap();
        assert_eq!(stored.unwrap(), 2);
        assert_eq!(text, "[paper]\npen_down_z_mm = -850.0\nslope = [0.01, 0.0]\n");
    }
}
