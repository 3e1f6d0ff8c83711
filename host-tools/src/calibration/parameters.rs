//! What is measured of each kind of machine: dimensions, the positions of the axes at their marks, and the travel of a turn.
//!
//! Left out is what marks on a sheet cannot tell from something else: a delta's platform from its base (only their difference
//! acts), a SCARA's shoulder from the place of the sheet, a gantry's marks from the place of the sheet.

use super::JointPose;
use etherpen::config::Config;
use etherpen::robots::{Geometry, Kind, LINEAR_MM_PER_RAD, MAIN_AXES};

/// Usual error of a length, mm; of an azimuth, degrees; of a rotary and of a linear axis at its mark, rad and mm; of the
/// travel of a turn, a part of it. From machined and glued parts and homing by hand: assumed, and generous.
const LENGTH_MM: f64 = 1.0;
const AZIMUTH_DEG: f64 = 0.15;
const SYNC_RAD: f64 = 3.0e-3;
const SYNC_MM: f64 = 1.0;
const PITCH_PART: f64 = 3.0e-3;
/// What values are rounded to: parts of a millimetre, of a degree and of a radian.
const LENGTH_PARTS: f64 = 1.0e3;
const AZIMUTH_PARTS: f64 = 1.0e4;
const SYNC_RAD_PARTS: f64 = 1.0e6;

/// What a parameter changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum What {
    /// A dimension in `[geometry]`: its key, and its place in a list.
    Dimension(&'static str, Option<usize>),
    /// The position of an axis, from 0, at its mark.
    Sync(usize),
    /// The travel of an axis, from 0, for one turn; the value is the part by which it is longer.
    Pitch(usize),
}

/// One value that is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// What it changes.
    pub what: What,
    /// Usual error of it before it is measured, in the controller's unit.
    pub usual: f64,
}

/// The parameters of a kind of machine.
#[must_use]
pub fn of(kind: Kind) -> Vec<Parameter> {
    let length = |key| Parameter {
        what: What::Dimension(key, None),
        usual: LENGTH_MM,
    };
    let azimuths = |key| {
        (0..MAIN_AXES).map(move |index| Parameter {
            what: What::Dimension(key, Some(index)),
            usual: AZIMUTH_DEG,
        })
    };
    let sync = |axis, usual| Parameter {
        what: What::Sync(axis),
        usual,
    };
    let syncs = |usual| (0..MAIN_AXES).map(move |axis| sync(axis, usual));
    let pitch = |axis| Parameter {
        what: What::Pitch(axis),
        usual: PITCH_PART,
    };
    match kind {
        Kind::Delta => ["base_radius_mm", "upper_arm_mm", "forearm_mm"]
            .map(length)
            .into_iter()
            .chain(azimuths("arm_azimuths_deg"))
            .chain(syncs(SYNC_RAD))
            .collect(),
        Kind::LinearDelta => ["radius_mm", "rod_mm"]
            .map(length)
            .into_iter()
            .chain(azimuths("tower_azimuths_deg"))
            .chain(syncs(SYNC_MM / LINEAR_MM_PER_RAD))
            .collect(),
        Kind::Scara => ["inner_link_mm", "outer_link_mm"]
            .map(length)
            .into_iter()
            .chain([sync(1, SYNC_RAD)])
            .collect(),
        Kind::Gantry | Kind::CoreXy => vec![pitch(0), pitch(1)],
    }
}

/// The place of a dimension; `None` if the kind has none of that key.
fn dimension<'g>(geometry: &'g mut Geometry, key: &str, index: Option<usize>) -> Option<&'g mut f64> {
    match (geometry, key) {
        (Geometry::Delta(delta), "base_radius_mm") => Some(&mut delta.base_radius_mm),
        (Geometry::Delta(delta), "upper_arm_mm") => Some(&mut delta.upper_arm_mm),
        (Geometry::Delta(delta), "forearm_mm") => Some(&mut delta.forearm_mm),
        (Geometry::Delta(delta), "arm_azimuths_deg") => delta.arm_azimuths_deg.get_mut(index?),
        (Geometry::LinearDelta(delta), "radius_mm") => Some(&mut delta.radius_mm),
        (Geometry::LinearDelta(delta), "rod_mm") => Some(&mut delta.rod_mm),
        (Geometry::LinearDelta(delta), "tower_azimuths_deg") => delta.tower_azimuths_deg.get_mut(index?),
        (Geometry::Scara(scara), "inner_link_mm") => Some(&mut scara.inner_link_mm),
        (Geometry::Scara(scara), "outer_link_mm") => Some(&mut scara.outer_link_mm),
        _ => None,
    }
}

/// The value that a parameter changes, in the controller's unit; the travel of a turn as a part of what it was.
#[must_use]
pub fn value(config: &Config, what: What) -> f64 {
    let mut geometry = config.geometry;
    match what {
        What::Dimension(key, index) => dimension(&mut geometry, key, index).map_or(0.0, |value| *value),
        What::Sync(axis) => config.axes.get(axis).map_or(0.0, |axis| axis.sync_angle_rad),
        What::Pitch(_) => 1.0,
    }
}

/// The configuration with a change of each parameter; `rounded` to what a file shows.
#[must_use]
pub fn changed(config: &Config, parameters: &[Parameter], changes: &[f64], rounded: bool) -> Config {
    let round = |value: f64, parts: f64| match rounded {
        true => (value * parts).round() / parts,
        false => value,
    };
    let mut found = config.clone();
    for (Parameter { what, .. }, change) in parameters.iter().zip(changes) {
        match *what {
            What::Dimension(key, index) => {
                let parts = if index.is_some() { AZIMUTH_PARTS } else { LENGTH_PARTS };
                if let Some(value) = dimension(&mut found.geometry, key, index) {
                    *value = round(*value + change, parts);
                }
            }
            What::Sync(axis) => {
                if let Some(axis) = found.axes.get_mut(axis) {
                    axis.sync_angle_rad = round(axis.sync_angle_rad + change, SYNC_RAD_PARTS);
                }
            }
            What::Pitch(axis) => {
                if let Some(axis) = found.axes.get_mut(axis) {
                    axis.gear /= 1.0 + change;
                }
            }
        }
    }
    found
}

/// Where the axes truly are when the controller believes them at a pose, if the machine differs by these changes.
#[must_use]
pub fn true_pose(config: &Config, parameters: &[Parameter], changes: &[f64], mut believed: JointPose) -> JointPose {
    for (Parameter { what, .. }, change) in parameters.iter().zip(changes) {
        let (What::Sync(axis) | What::Pitch(axis)) = *what else {
            continue;
        };
        let (Some(position), Some(settings)) = (believed.get_mut(axis), config.axes.get(axis)) else {
            continue;
        };
        *position += match what {
            What::Pitch(_) => (*position - settings.sync_angle_rad) * change,
            _ => *change,
        };
    }
    believed
}
