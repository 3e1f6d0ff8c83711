//! The dimensions of a machine in its file.

use super::{Settings, SettingsError, others};
use crate::error::ProgramError;
use etherpen::config::Config;
use etherpen::robots::{Geometry, Kind};
use std::path::Path;
use toml_edit::{Item, TableLike, Value};

const PITCH: &str = "pitch_mm";
/// Parts of a millimetre to which the travel of a turn is rounded.
const PITCH_PARTS: f64 = 1.0e4;

/// A configuration without dimensions and what else can be stored, to compare the others.
fn without_dimensions(config: &Config) -> Config {
    let mut others = others(config);
    others.geometry = Kind::default().geometry();
    for axis in &mut others.axes {
        axis.gear = 0.0;
    }
    others
}

impl Settings {
    /// Stores the dimensions that differ from the file's; returns their number.
    ///
    /// # Errors
    /// [`SettingsError`]; nothing is written.
    pub fn store_geometry(&mut self, wanted: &Geometry) -> Result<usize, SettingsError> {
        let now = self.config()?.geometry;
        self.check_kind(wanted.kind())?;
        let (now, wanted) = (table(&now), table(wanted));
        let mut changed = 0;
        for (key, value) in wanted.iter() {
            if now.get(key).map(Value::to_string) == Some(value.to_string()) {
                continue;
            }
            let geometry = self.document.entry("geometry").or_insert_with(toml_edit::table);
            // A configuration that was read has no other kind of geometry.
            let Some(geometry) = geometry.as_table_like_mut() else {
                continue;
            };
            set(geometry, key, value.clone());
            changed += 1;
        }
        Ok(changed)
    }

    /// Stores the travel of linear axes for one turn where an axis needs another number of turns than in the file; returns their
    /// number.
    ///
    /// # Errors
    /// [`SettingsError`]; nothing is written.
    pub fn store_travels(&mut self, wanted: &Config) -> Result<usize, SettingsError> {
        let now = self.config()?;
        let mut changed = 0;
        for (number, (axis, before)) in wanted.axes.iter().zip(&now.axes).enumerate() {
            if axis.gear == before.gear {
                continue;
            }
            let place = SettingsError::Place {
                axis: number,
                field: PITCH,
            };
            let pitch_mm = self.pitch_mm(number).ok_or(place)? * before.gear / axis.gear;
            self.set_axis(number, PITCH, (pitch_mm * PITCH_PARTS).round() / PITCH_PARTS)?;
            changed += 1;
        }
        Ok(changed)
    }

    fn pitch_mm(&self, axis: usize) -> Option<f64> {
        let own = match self.document.get("axes")? {
            Item::ArrayOfTables(tables) => tables.get(axis)?.get(PITCH).cloned(),
            Item::Value(Value::Array(array)) => {
                let table = array.get(axis)?.as_inline_table()?;
                table.get(PITCH).cloned().map(Item::Value)
            }
            _ => None,
        };
        let shared = || self.document.get(super::reading::SHARED)?.get(PITCH).cloned();
        let item = own.or_else(shared)?;
        item.as_float().or_else(|| item.as_integer().map(|value| value as f64))
    }
}

/// Stores dimensions, marks and sheet of a machine in its file; returns the number of changed values. `known` is the configuration
/// with which they were found.
///
/// # Errors
/// The file says something else than `known`, cannot be changed, or would not be a valid configuration.
pub fn store_dimensions(path: &Path, known: &Config, found: &Config) -> Result<usize, ProgramError> {
    let failed = |cause| ProgramError::failed(format!("{} cannot be changed", path.display()), cause);
    let mut settings = Settings::open(path).map_err(failed)?;
    if settings.config().map_err(failed)? != *known {
        let text = format!("{} has changed meanwhile; calibrate again", path.display());
        return Err(ProgramError::new(crate::error::code::FAILED, text));
    }
    let store = |settings: &mut Settings| {
        let changed = settings.store_geometry(&found.geometry)?
            + settings.store_travels(found)?
            + settings.store_axes(found)?
            + settings.store_sheet(&found.paper)?;
        settings.write(path, without_dimensions)?;
        Ok(changed)
    };
    store(&mut settings).map_err(failed)
}

/// The dimensions as a file has them.
fn table(geometry: &Geometry) -> toml_edit::InlineTable {
    // Numbers, names and lists of numbers can be written.
    let text = toml::to_string(geometry).unwrap_or_default();
    let document: toml_edit::DocumentMut = text.parse().unwrap_or_default();
    document.as_table().clone().into_inline_table()
}

fn set(table: &mut dyn TableLike, key: &str, mut value: Value) {
    if let (Some(Item::Value(Value::Array(before))), Value::Array(wanted)) = (table.get_mut(key), &value)
        && before.len() == wanted.len()
    {
        for (before, wanted) in before.iter_mut().zip(wanted) {
            let decor = before.decor().clone();
            *before = wanted.clone();
            *before.decor_mut() = decor;
        }
        return;
    }
    match table.get(key).and_then(Item::as_value) {
        Some(before) => *value.decor_mut() = before.decor().clone(),
        None => value.decor_mut().clear(),
    }
    table.insert(key, Item::Value(value));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::machines::MACHINES;

    #[test]
    fn dimensions_are_stored_with_their_comments_and_all_else_stays_as_it_was_written() {
        for machine in &MACHINES {
            let mut settings = Settings::parse(machine.text).expect("a bundled machine");
            let config = settings.config().expect("a bundled machine");
            assert_eq!(settings.store_geometry(&config.geometry).expect("nothing to do"), 0);
            assert_eq!(settings.store_travels(&config).expect("nothing to do"), 0);
            assert_eq!(settings.document.to_string(), machine.text);
            let mut wanted = config.clone();
            let count = match &mut wanted.geometry {
                Geometry::Delta(delta) => {
                    delta.base_radius_mm += 0.125;
                    delta.arm_azimuths_deg[2] = 239.95;
                    2
                }
                Geometry::LinearDelta(delta) => {
                    delta.rod_mm -= 0.5;
                    1
                }
                Geometry::Scara(scara) => {
                    scara.outer_link_mm += 0.25;
                    1
                }
                Geometry::Gantry(_) | Geometry::CoreXy(_) => 0,
            };
            assert_eq!(settings.store_geometry(&wanted.geometry).expect("stored"), count);
            let text = settings.document.to_string();
            let lines = machine.text.lines().zip(text.lines());
            let changed: Vec<_> = lines.filter(|(before, after)| before != after).collect();
            assert_eq!(
                (changed.len(), text.lines().count()),
                (count, machine.text.lines().count())
            );
            for (before, after) in changed {
                assert_eq!(before.contains('#'), after.contains('#'), "{before} {after}");
            }
            assert_eq!(settings.config().expect("a machine").geometry, wanted.geometry);
        }
    }

    #[test]
    fn the_comments_in_a_list_stay() {
        let text = "[geometry]\narm_azimuths_deg = [\n  0.0, # front\n  120.0,\n  240.0 # left\n]\n";
        let mut settings = Settings::parse(text).expect("a configuration");
        let mut geometry = settings.config().expect("a machine").geometry;
        if let Geometry::Delta(delta) = &mut geometry {
            delta.arm_azimuths_deg[1] = 120.25;
        }
        assert_eq!(settings.store_geometry(&geometry).expect("stored"), 1);
        assert_eq!(settings.document.to_string(), text.replace("120.0", "120.25"));
    }

    #[test]
    fn the_travel_of_a_turn_is_stored_where_an_axis_has_a_gear() {
        let gantry = MACHINES
            .iter()
            .find(|machine| machine.name == "gantry")
            .expect("bundled");
        let mut settings = Settings::parse(gantry.text).expect("a bundled machine");
        let mut wanted = settings.config().expect("a bundled machine");
        let before_mm = settings.pitch_mm(1).expect("a travel");
        wanted.axes[1].gear /= 1.002;
        assert_eq!(settings.store_travels(&wanted).expect("stored"), 1);
        let after_mm = settings.pitch_mm(1).expect("a travel");
        assert!(
            (after_mm - 1.002 * before_mm).abs() * PITCH_PARTS < 1.0,
            "{before_mm} {after_mm}"
        );
        let gear = settings.config().expect("a machine").axes[1].gear;
        assert!((gear / wanted.axes[1].gear - 1.0).abs() < 1e-5);
        assert_eq!(settings.pitch_mm(0), Some(before_mm));
    }
}
