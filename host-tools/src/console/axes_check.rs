//! The check of the axes: one alone moves while the operator presses, who then says which one moved.
//!
//! Drives that are exchanged, or turn the other way, are consistent with themselves; only somebody who sees the machine can
//! tell. The work area is no protection against them, so that a press moves an axis by [`way_max_rad`], and by what it goes until
//! the console hears of it.
//!
//! Invariants: a press asks for no motion beyond its way, nor for longer than that way takes; only an axis that was moved has an
//! answer; no answer outlives the reference with which it was given.

use super::control::ViewerId;
use super::hub::{Level, Topic};
use super::page_text::for_page;
use super::{Console, lock};
use crate::axes::axes;
use crate::identification::one_axis::{alone, way_max_rad};
use crate::identification::seen::{Seen, advice};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::Status;
use etherpen::robots::{AXES, MAIN_AXES};
use serde::Serialize;

/// Smallest share of the speed for which an axis of the frame is named.
const PART_MIN: f64 = 0.2;
/// How much longer than its way takes a press may ask for a motion, ms.
const SPARE_MS: f64 = 300.0;
/// Part of the way of a press that a person can see.
const VISIBLE_PART: f64 = 0.125;

/// A press of a button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Press {
    /// Who presses.
    pub(super) viewer: ViewerId,
    /// Its number, of which the page counts every press.
    pub(super) number: u64,
    /// The axis, from 1.
    pub(super) axis: u8,
    /// Whether it goes forwards.
    pub(super) forward: bool,
}

/// Where the axis was when a press began, rad, and when that was, ms.
#[derive(Clone, Copy, Debug)]
struct Begun {
    press: Press,
    from_rad: f64,
    at_ms: u64,
}

/// What is known of the axes that move the tool.
#[derive(Debug, Default)]
pub(super) struct AxesCheck {
    seen: [Option<Seen>; MAIN_AXES],
    moved: [bool; MAIN_AXES],
    begun: Option<Begun>,
}

#[derive(Debug, Serialize)]
struct CheckedAxis {
    /// The axis, from 1.
    axis: u8,
    name: String,
    /// Where the tool goes from where it is when the axis goes forwards: `x +, z −`. Empty without a reference.
    way: String,
    /// Whether a press has moved it.
    moved: bool,
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
    let named = parts.filter(|(_, part)| part.abs() >= PART_MIN * speed_mm_s);
    let named: Vec<String> = named
        .map(|(name, part)| format!("{name} {}", if *part < 0.0 { "−" } else { "+" }))
        .collect();
    named.join(", ")
}

/// The check with the robot's joints where they are; `None` without a reference.
fn view(config: &Config, check: &AxesCheck, joints_rad: Option<&[f64; AXES]>) -> AxesView {
    let states = check.seen.iter().zip(check.moved);
    let checked = axes(config)
        .into_iter()
        .zip(states)
        .map(|(axis, (seen, moved))| CheckedAxis {
            axis: axis.index as u8 + 1,
            way: joints_rad
                .and_then(|joints_rad| alone(config, joints_rad, axis.index))
                .map_or_else(String::new, |alone| way(&alone.velocity_mm_s)),
            name: axis.name,
            moved,
            seen: *seen,
        });
    let checked: Vec<CheckedAxis> = checked.collect();
    let others = axes(config).into_iter().skip(MAIN_AXES).map(|axis| OtherAxis {
        axis: axis.index as u8 + 1,
        name: axis.name,
    });
    let seen = checked.iter().filter_map(|axis| Some((axis.axis, axis.seen?)));
    let seen: Vec<(u8, Seen)> = seen.collect();
    AxesView {
        confirmed: checked.iter().all(|axis| axis.seen == Some(Seen::AsTold)),
        advice: advice(&seen).iter().map(|line| for_page(line)).collect(),
        others: others.collect(),
        axes: checked,
    }
}

/// The check before anything was moved.
pub(super) fn untried(config: &Config) -> AxesView {
    view(config, &AxesCheck::default(), None)
}

impl AxesCheck {
    /// The velocity of the tool, mm/s, that a press asks for; 0 once it has had its way or the time for it.
    fn pressed(
        &mut self,
        config: &Config,
        joints_rad: &[f64; AXES],
        press: Press,
        now_ms: u64,
    ) -> Result<[f32; 3], &'static str> {
        let axis = usize::from(press.axis)
            .checked_sub(1)
            .ok_or("axes are numbered from 1")?;
        if !joints_rad.iter().all(|angle| angle.is_finite()) {
            return Err("the drives do not report where the axes are");
        }
        let alone = alone(config, joints_rad, axis).ok_or("this axis does not move the tool here")?;
        let at_rad = joints_rad.get(axis).copied().unwrap_or_default();
        let begun = self.begun.filter(|begun| begun.press == press).unwrap_or(Begun {
            press,
            from_rad: at_rad,
            at_ms: now_ms,
        });
        self.begun = Some(begun);
        let (way_rad, way_max_rad) = ((at_rad - begun.from_rad).abs(), way_max_rad(config, axis));
        if let Some(moved) = self.moved.get_mut(axis) {
            *moved |= way_rad > VISIBLE_PART * way_max_rad;
        }
        let time_max_ms = 1.0e3 * way_max_rad / alone.speed_rad_s + SPARE_MS;
        let goes_on = way_rad < way_max_rad && (now_ms.saturating_sub(begun.at_ms) as f64) < time_max_ms;
        let sign = match goes_on {
            true if press.forward => 1.0,
            true => -1.0,
            false => 0.0,
        };
        Ok(alone.velocity_mm_s.map(|part| (sign * part) as f32))
    }

    /// Takes an answer about an axis, from 0.
    fn answer(&mut self, axis: usize, drives: u8, what: Option<Seen>) -> Result<(), &'static str> {
        let what = match what {
            Some(Seen::Other(other)) if !(1..=drives).contains(&other) => return Err("there is no such axis"),
            Some(Seen::Other(other)) if usize::from(other) == axis + 1 => Some(Seen::AsTold),
            what => what,
        };
        let has_moved = self.moved.get(axis).copied().filter(|_| axis < drives.into());
        if !has_moved.ok_or("this axis does not move the tool")? {
            return Err("move this axis first, then say what moved");
        }
        if let Some(seen) = self.seen.get_mut(axis) {
            *seen = what;
        }
        Ok(())
    }
}

impl Console {
    /// Velocity of the tool, mm/s, for a press that moves an axis alone.
    ///
    /// # Errors
    /// Why it cannot be moved alone.
    pub(super) fn press_axis(&self, press: Press, now_ms: u64) -> Result<[f32; 3], &'static str> {
        let joints_rad = self
            .hub()
            .joints_rad()
            .ok_or("the robot is not homed, or does not report where it is")?;
        lock(&self.axes_check).pressed(&self.config, &joints_rad.map(f64::from), press, now_ms)
    }

    /// Takes what the operator saw of an axis, from 1; `None` clears the answer.
    ///
    /// # Errors
    /// There is no such axis, or it was not moved.
    pub(super) fn saw(&self, axis: u8, what: Option<Seen>) -> Result<(), &'static str> {
        let index = usize::from(axis).checked_sub(1).ok_or("axes are numbered from 1")?;
        lock(&self.axes_check).answer(index, self.config.bus.drives, what)?;
        self.show_axes();
        Ok(())
    }

    /// Shows the check as the robot stands; without a reference, or while it is homed, nothing of it is kept.
    pub(super) fn keep_axes(&self, status: &Status) {
        let keeps = status.referenced && status.mode != Mode::Homing;
        let cleared = {
            let mut check = lock(&self.axes_check);
            let had_answers = check.seen.iter().any(Option::is_some);
            if !keeps {
                *check = AxesCheck::default();
            }
            had_answers && !keeps
        };
        if cleared {
            let text = "the check of the axes was cleared because the robot lost its reference or is being homed";
            self.change(|hub| hub.note(Level::Info, text));
        }
        self.show_axes();
    }

    fn show_axes(&self) {
        let joints_rad = self.hub().joints_rad().map(|joints_rad| joints_rad.map(f64::from));
        let view = view(&self.config, &lock(&self.axes_check), joints_rad.as_ref());
        self.change(|hub| hub.say(Topic::Axes, &view));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identification::joints_over_sheet_rad;
    use crate::settings::machines::MACHINES;

    #[test]
    fn every_machine_has_its_axes_that_move_the_tool_and_where_it_goes() {
        for machine in &MACHINES {
            let config = machine.load().expect("a configuration");
            let drives = usize::from(config.bus.drives).min(MAIN_AXES);
            let joints_rad = joints_over_sheet_rad(&config).expect("a pose");
            let shown = |seen| {
                let check = AxesCheck {
                    seen,
                    ..AxesCheck::default()
                };
                view(&config, &check, Some(&joints_rad))
            };
            let none = shown([None; MAIN_AXES]);
            assert_eq!(none.axes.len(), drives);
            assert_eq!(none.others.len(), usize::from(config.bus.drives) - drives);
            assert!(none.axes.iter().all(|axis| !axis.way.is_empty()), "{none:?}");
            assert!(untried(&config).axes.iter().all(|axis| axis.way.is_empty()));
            assert!(!none.confirmed && none.advice.is_empty());
            let all = shown([Some(Seen::AsTold); MAIN_AXES]);
            assert!(all.confirmed && all.advice.is_empty());
            let one = shown([Some(Seen::AsTold), Some(Seen::Reversed), Some(Seen::Unclear)]);
            assert!(
                !one.confirmed && one.advice[0].starts_with("axis 2 goes the other way"),
                "{one:?}"
            );
            for line in one.advice {
                assert!(!line.contains("etherpen") && !line.contains("--"), "{line}");
            }
        }
    }

    /// The speed of the tool for a press of the second axis, mm/s.
    fn asked(
        check: &mut AxesCheck,
        joints_rad: &[f64; AXES],
        (number, forward): (u64, bool),
        now_ms: u64,
    ) -> Result<f32, &'static str> {
        let press = Press {
            viewer: 1,
            number,
            axis: 2,
            forward,
        };
        let velocity = check.pressed(&Config::default(), joints_rad, press, now_ms)?;
        Ok(velocity.iter().map(|part| part * part).sum::<f32>().sqrt())
    }

    #[test]
    fn a_press_ends_after_its_way_and_a_new_one_begins_anew() {
        let config = Config::default();
        let mut joints_rad = joints_over_sheet_rad(&config).expect("a pose");
        let check = &mut AxesCheck::default();
        let goes = |speed: Result<f32, &str>| speed.is_ok_and(|mm_s| mm_s > 1.0);
        assert!(goes(asked(check, &joints_rad, (1, true), 0)));
        assert!(check.answer(1, 4, Some(Seen::AsTold)).is_err(), "it has not moved yet");
        joints_rad[1] += 1.01 * way_max_rad(&config, 1);
        assert_eq!(asked(check, &joints_rad, (1, true), 100), Ok(0.0));
        assert_eq!(
            asked(check, &joints_rad, (1, true), 60_000),
            Ok(0.0),
            "it is the same press"
        );
        assert_eq!(check.answer(1, 4, Some(Seen::AsTold)), Ok(()));
        assert!(goes(asked(check, &joints_rad, (2, false), 60_001)), "the other button");
        assert!(goes(asked(check, &joints_rad, (3, true), 60_002)), "pressed anew");
        joints_rad[0] = f64::NAN;
        let why = asked(check, &joints_rad, (3, true), 60_003);
        assert_eq!(why, Err("the drives do not report where the axes are"));
    }

    #[test]
    fn a_press_ends_in_time_though_nothing_is_heard_of_its_way() {
        let joints_rad = joints_over_sheet_rad(&Config::default()).expect("a pose");
        let check = &mut AxesCheck::default();
        let last_ms = (0..60_000)
            .step_by(40)
            .take_while(|now_ms| asked(check, &joints_rad, (1, true), *now_ms).is_ok_and(|mm_s| mm_s > 0.0));
        let last_ms = last_ms.last().expect("a motion");
        assert!((500..4_000).contains(&last_ms), "{last_ms} ms");
        assert_eq!(
            check.answer(1, 4, Some(Seen::AsTold)),
            Err("move this axis first, then say what moved")
        );
    }

    #[test]
    fn only_an_axis_that_was_moved_has_an_answer() {
        let mut check = AxesCheck::default();
        let first = "move this axis first, then say what moved";
        assert_eq!(check.answer(0, 4, Some(Seen::AsTold)), Err(first));
        check.moved[0] = true;
        assert_eq!(check.answer(0, 4, Some(Seen::Other(4))), Ok(()));
        assert_eq!(check.seen[0], Some(Seen::Other(4)));
        assert_eq!(check.answer(0, 4, Some(Seen::Other(1))), Ok(()));
        assert_eq!(check.seen[0], Some(Seen::AsTold));
        assert_eq!(check.answer(0, 4, None), Ok(()));
        assert_eq!(check.seen[0], None);
        assert_eq!(check.answer(0, 4, Some(Seen::Other(5))), Err("there is no such axis"));
        assert_eq!(check.answer(1, 4, Some(Seen::AsTold)), Err(first));
        assert_eq!(
            check.answer(3, 4, Some(Seen::AsTold)),
            Err("this axis does not move the tool")
        );
        assert_eq!(check.answer(2, 2, None), Err("this axis does not move the tool"));
    }

    #[test]
    fn the_way_of_the_tool_is_told_by_its_large_parts() {
        assert_eq!(way(&[10.0, 0.1, -9.0]), "x +, z −");
        assert_eq!(way(&[0.0, -3.0, 0.0]), "y −");
    }
}
