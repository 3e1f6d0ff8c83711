//! The check of the axes: one alone moves while the operator presses, who then says which one moved.
//!
//! Drives that are exchanged, or turn the other way, are consistent with themselves; only somebody who sees the machine can
//! tell.
//!
//! Invariant: what was seen does not outlive the reference with which it was seen.

use super::hub::{Level, Topic};
use super::{Console, lock};
use crate::axes::axes;
use crate::identification::joints_over_sheet_rad;
use crate::identification::one_axis::velocity_mm_s;
use crate::identification::seen::{Seen, advice};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::Status;
use etherpen::robots::MAIN_AXES;
use serde::Serialize;

/// Least part of a velocity that is told as a direction.
const PART_MIN: f64 = 0.2;

/// What was seen of each axis that moves the tool.
pub(super) type AxesSeen = [Option<Seen>; MAIN_AXES];

#[derive(Debug, Serialize)]
struct CheckedAxis {
    /// The axis, from 1.
    axis: u8,
    name: String,
    /// Where the tool goes above the sheet's centre when the axis goes forwards: `x +, z −`.
    way: String,
    seen: Option<Seen>,
}

/// An axis that does not move the tool, and may be exchanged with one that does.
#[derive(Debug, Serialize)]
struct OtherAxis {
    /// The axis, from 1.
    axis: u8,
    name: String,
}

/// The check as shown on the page.
#[derive(Debug, Serialize)]
pub(super) struct AxesView {
    axes: Vec<CheckedAxis>,
    others: Vec<OtherAxis>,
    /// Whether each axis moved as it was told.
    confirmed: bool,
    /// What to do about those that did not.
    advice: Vec<String>,
}

/// Where the tool goes, in words.
fn way(velocity_mm_s: &[f64; 3]) -> String {
    let speed_mm_s = velocity_mm_s.iter().map(|part| part * part).sum::<f64>().sqrt();
    let parts = ["x", "y", "z"].iter().zip(velocity_mm_s);
    let told = parts.filter(|(_, part)| part.abs() >= PART_MIN * speed_mm_s);
    let told: Vec<String> = told
        .map(|(name, part)| format!("{name} {}", if *part < 0.0 { "−" } else { "+" }))
        .collect();
    told.join(", ")
}

/// The check with what was seen so far.
pub(super) fn view(config: &Config, seen: &AxesSeen) -> AxesView {
    let joints_rad = joints_over_sheet_rad(config);
    let checked = axes(config).into_iter().zip(seen).map(|(axis, seen)| CheckedAxis {
        axis: axis.index as u8 + 1,
        way: joints_rad
            .and_then(|joints_rad| velocity_mm_s(config, &joints_rad, axis.index))
            .map_or_else(String::new, |velocity| way(&velocity)),
        name: axis.name,
        seen: *seen,
    });
    let checked: Vec<CheckedAxis> = checked.collect();
    let others = axes(config).into_iter().skip(MAIN_AXES).map(|axis| OtherAxis {
        axis: axis.index as u8 + 1,
        name: axis.name,
    });
    let told = checked.iter().filter_map(|axis| Some((axis.axis, axis.seen?)));
    AxesView {
        confirmed: checked.iter().all(|axis| axis.seen == Some(Seen::AsTold)),
        advice: advice(&told.collect::<Vec<_>>()),
        others: others.collect(),
        axes: checked,
    }
}

impl Console {
    /// Velocity of the tool, mm/s, that moves an axis, from 1, alone from where the joints are now.
    ///
    /// # Errors
    /// Why it cannot be moved alone.
    pub(super) fn axis_velocity_mm_s(&self, axis: u8, forward: bool) -> Result<[f32; 3], &'static str> {
        let joints_rad = self.hub().joints_rad().ok_or("the robot is not homed")?.map(f64::from);
        let index = usize::from(axis).checked_sub(1).ok_or("axes are numbered from 1")?;
        let velocity = velocity_mm_s(&self.config, &joints_rad, index);
        let velocity = velocity.ok_or("this axis does not move the tool here")?;
        let sign = if forward { 1.0 } else { -1.0 };
        Ok(velocity.map(|part| (sign * part) as f32))
    }

    /// Takes what the operator saw of an axis, from 1; nothing forgets what was said of it.
    ///
    /// # Errors
    /// There is no such axis.
    pub(super) fn saw(&self, axis: u8, what: Option<Seen>) -> Result<(), &'static str> {
        let drives = self.config.bus.drives;
        let exists = |axis: u8| (1..=drives).contains(&axis);
        let what = match what {
            Some(Seen::Other(other)) if !exists(other) => return Err("there is no such axis"),
            Some(Seen::Other(other)) if other == axis => Some(Seen::AsTold),
            what => what,
        };
        let mut seen = lock(&self.axes_seen);
        let place = seen.get_mut(usize::from(axis).wrapping_sub(1)).filter(|_| exists(axis));
        *place.ok_or("this axis does not move the tool")? = what;
        let view = view(&self.config, &seen);
        self.change(|hub| hub.say(Topic::Axes, &view));
        Ok(())
    }

    /// Forgets what was seen if the robot has lost its reference, or is being homed anew.
    pub(super) fn keep_seen(&self, status: &Status) {
        if status.referenced && status.mode != Mode::Homing {
            return;
        }
        let mut seen = lock(&self.axes_seen);
        if seen.iter().all(Option::is_none) {
            return;
        }
        *seen = AxesSeen::default();
        let view = view(&self.config, &seen);
        self.change(|hub| {
            hub.note(
                Level::Info,
                "what was seen of the axes is forgotten: the robot has lost its place, or is homed anew",
            );
            hub.say(Topic::Axes, &view);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::machines::MACHINES;

    #[test]
    fn every_machine_has_its_axes_that_move_the_tool_and_where_it_goes() {
        for machine in &MACHINES {
            let config = machine.load().expect("a configuration");
            let drives = usize::from(config.bus.drives).min(MAIN_AXES);
            let none = view(&config, &AxesSeen::default());
            assert_eq!(none.axes.len(), drives);
            assert_eq!(none.others.len(), usize::from(config.bus.drives) - drives);
            assert!(none.axes.iter().all(|axis| !axis.way.is_empty()), "{none:?}");
            assert!(!none.confirmed && none.advice.is_empty());
            let all = view(&config, &[Some(Seen::AsTold); MAIN_AXES]);
            assert!(all.confirmed && all.advice.is_empty());
            let one = view(&config, &[Some(Seen::AsTold), Some(Seen::Reversed), None]);
            assert!(
                !one.confirmed && one.advice[0].starts_with("axis 2 goes the other way"),
                "{one:?}"
            );
        }
    }

    #[test]
    fn the_way_of_the_tool_is_told_by_its_large_parts() {
        assert_eq!(way(&[10.0, 0.1, -9.0]), "x +, z −");
        assert_eq!(way(&[0.0, -3.0, 0.0]), "y −");
    }
}
