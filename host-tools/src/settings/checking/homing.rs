//! What is unlikely about home switches.

use super::{Checks, Finding, Gravity, led, round, searched_rad, sync_keys};
use crate::axes::{AxisView, Motion, Quantity, axes};
use crate::link::text;
use etherpen::config::{Config, HomeSwitch};
use etherpen::control::search::Approach;
use etherpen::motion::WorkArea;
use etherpen::robots::{JointAngles, Kinematics, MAIN_AXES};

/// Place of the height among the axes, where it moves nothing else.
const HEIGHT: usize = 2;
/// Usual longest way to a switch, of the range.
const TRAVEL_SHARE: f64 = 1.1;
/// Rounding of a value that was written in other units, rad.
const ROUNDING_RAD: f64 = 1.0e-9;
/// Slowest search that a configuration may have, rad/s.
const SEARCH_SPEED_MIN_RAD_S: f64 = 1.0e-3;

/// Adds warnings about the axes that have a home switch.
pub(super) fn check(checks: &Checks<'_>, found: &mut Vec<Finding>) {
    for axis in axes(checks.config) {
        let home = checks.config.axes.get(axis.index).map(|settings| settings.home);
        if let Some(home) = home.filter(|home| home.io.is_some()) {
            let texts = [
                travel(checks, &axis, &home),
                direction(checks, &axis, &home),
                stopping(checks, &axis),
                height(checks, &axis, &home),
            ];
            found.extend(texts.into_iter().flatten().map(|text| Finding {
                gravity: Gravity::Warning,
                line: checks.places.of_axis(axis.index, &["home"]),
                text,
            }));
        }
    }
    found.extend(outside_after(checks));
}

/// A value of `home` in the unit of its axis: its name, and its unit.
fn key(axis: &AxisView, name: &str, quantity: Quantity) -> String {
    format!("{name}_{}", axis.motion.suffix(quantity))
}

fn travel(checks: &Checks<'_>, axis: &AxisView, home: &HomeSwitch) -> Option<String> {
    let [low_rad, high_rad] = searched_rad(checks.config, axis.index);
    let length_rad = high_rad - low_rad;
    let shown = |rad: f64| round(rad * axis.motion.factor());
    (home.travel_max_rad < length_rad).then(|| {
        let (key, unit) = (
            key(axis, "travel_max", Quantity::Position),
            axis.motion.unit(Quantity::Position),
        );
        format!(
            "{} seeks its switch for {} {unit} only, and its range is {} {unit} long: from the far end it does not get there; make \
             {key} {}",
            led(checks.config, axis),
            shown(home.travel_max_rad),
            shown(length_rad),
            shown(TRAVEL_SHARE * length_rad)
        )
    })
}

fn direction(checks: &Checks<'_>, axis: &AxisView, home: &HomeSwitch) -> Option<String> {
    let [low_rad, high_rad] = searched_rad(checks.config, axis.index);
    let switch_rad = *checks.config.switch_places_rad().get(axis.index)?;
    let is_upper = switch_rad > 0.5 * (low_rad + high_rad);
    (is_upper != (home.speed_rad_s > 0.0)).then(|| {
        format!(
            "{} seeks its switch towards {} values, and has it at the {} end of its range; turn the sign of {}, or correct {}",
            led(checks.config, axis),
            if is_upper { "smaller" } else { "greater" },
            if is_upper { "upper" } else { "lower" },
            key(axis, "speed", Quantity::Speed),
            sync_keys(checks.config, axis)
        )
    })
}

/// An axis that comes to rest behind the end of its range runs against what ends it.
fn stopping(checks: &Checks<'_>, axis: &AxisView) -> Option<String> {
    let settings = checks.config.axes.get(axis.index)?;
    let approach = Approach::of(checks.config.geometry.kind(), &checks.config.axes, axis.index);
    let way_rad = approach.way_behind_switch_rad();
    let room_rad = room_behind_switch_rad(checks.config, axis.index)?.max(0.0);
    if way_rad <= room_rad + ROUNDING_RAD {
        return None;
    }
    let (factor, unit) = (axis.motion.factor(), axis.motion.unit(Quantity::Position));
    let steps = match axis.motion {
        Motion::Linear => 1.0e2,
        Motion::Rotary => 1.0e4,
    };
    let down = |value: f64| ((value + ROUNDING_RAD) * factor * steps).floor() / steps;
    let up = |value: f64| ((value - ROUNDING_RAD) * factor * steps).ceil() / steps;
    let speed_rad_s = approach.speed_max_rad_s(room_rad);
    let is_possible = down(speed_rad_s) > SEARCH_SPEED_MIN_RAD_S.max(settings.home.latch_rad_s) * factor;
    let slower = is_possible.then(|| {
        let value = down(speed_rad_s).copysign(settings.home.speed_rad_s);
        format!("make {} {value}", key(axis, "speed", Quantity::Speed))
    });
    let stronger = approach.quick_stop_min_rad_s2(room_rad).map(|needed| {
        format!(
            "make quick_stop_{} {}",
            axis.motion.suffix(Quantity::Acceleration),
            up(needed)
        )
    });
    let advice = [slower, stronger, Some("move the switch".to_owned())];
    Some(format!(
        "{} comes to rest up to {} {unit} behind its switch, and its range ends {} {unit} behind it: it may run against its end; {}",
        led(checks.config, axis),
        up(way_rad),
        down(room_rad),
        advice.into_iter().flatten().collect::<Vec<String>>().join(", or "),
    ))
}

/// How far the range of an axis goes on behind its home switch, rad; below 0 if the switch is outside.
pub(crate) fn room_behind_switch_rad(config: &Config, axis: usize) -> Option<f64> {
    let [low_rad, high_rad] = searched_rad(config, axis);
    let settings = config.axes.get(axis).filter(|axis| axis.home.io.is_some())?;
    let switch_rad = *config.switch_places_rad().get(axis)?;
    Some(match settings.home.speed_rad_s > 0.0 {
        true => high_rad - switch_rad,
        false => switch_rad - low_rad,
    })
}

/// The pen has to be off the sheet before anything moves across it.
fn height(checks: &Checks<'_>, axis: &AxisView, home: &HomeSwitch) -> Option<String> {
    if axis.index != HEIGHT || !checks.config.geometry.kind().has_height_axis() {
        return None;
    }
    let number = axis.index + 1;
    if home.speed_rad_s < 0.0 {
        return Some(format!(
            "axis {number} ({}) seeks its switch downwards, where the sheet is; put the switch at the upper end",
            axis.name
        ));
    }
    let others = checks.config.axes.iter().take(HEIGHT).map(|other| other.home);
    let is_late = others
        .filter(|other| other.io.is_some())
        .any(|other| other.order <= home.order);
    is_late.then(|| {
        format!(
            "axis {number} ({}) is not homed before the others, which move with the pen on the sheet; give it the lowest order",
            axis.name
        )
    })
}

/// Where the machine is after homing, if that is outside its work area.
fn outside_after(checks: &Checks<'_>) -> Option<Finding> {
    let config = checks.config;
    let mut places_rad = config.switch_places_rad();
    let driven = usize::from(config.bus.drives).min(MAIN_AXES);
    for (place_rad, axis) in places_rad.iter_mut().zip(&config.axes).take(driven) {
        axis.home.io?;
        *place_rad -= axis.home.pull_off_rad.copysign(axis.home.speed_rad_s);
    }
    let pose = JointAngles(config.geometry.kind().joints(places_rad));
    let position = Kinematics::new(&config.geometry).ok()?.forward(&pose).ok()?;
    let why = WorkArea::new(&config.motion_settings()).ok()?.check(&position).err()?;
    let key = match axes(config).first()?.motion {
        Motion::Linear => "pull_off_mm",
        Motion::Rotary => "pull_off_rad",
    };
    Some(Finding {
        gravity: Gravity::Warning,
        line: checks.places.of("work_area", &["x_mm", "y_mm"]),
        text: format!(
            "after homing the machine is at x {:.1}, y {:.1}, z {:.1} mm, outside its work area: {}; make {key} of home \
             greater, or [work_area] larger",
            position.x_mm,
            position.y_mm,
            position.z_mm,
            text::outside(&why)
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    const GANTRY: &str = include_str!("../../../../samples/machines/gantry.toml");

    /// The only finding about the gantry with a replaced part.
    fn finding(from: &str, to: &str) -> Finding {
        assert!(GANTRY.contains(from), "{from}");
        let findings = check(&GANTRY.replacen(from, to, 1));
        let [finding] = &findings[..] else {
            panic!("{findings:#?}")
        };
        finding.clone()
    }

    #[test]
    fn searches_that_end_too_early_or_lead_away_are_warnings() {
        let short = finding("travel_max_mm = 700.0", "travel_max_mm = 400.0");
        assert_eq!(short.gravity, Gravity::Warning);
        assert!(
            short.text.contains("400 mm only") && short.text.contains("travel_max_mm 704"),
            "{short}"
        );
        // The axis would leave the switch the other way too, and be outside its range.
        let away = check(&GANTRY.replacen("speed_mm_s = -60.0", "speed_mm_s = 60.0", 1));
        assert!(
            away.iter().any(|found| found.text.contains("towards greater values")
                && found.text.contains("lower end")
                && found.gravity == Gravity::Warning),
            "{away:#?}"
        );
    }

    /// The values that a finding tells to write, each after its name.
    fn told(finding: &Finding) -> Vec<(String, String)> {
        let advice = finding.text.split("make ").skip(1);
        let words = advice.filter_map(|advice| advice.split(", or").next()?.split_once(' '));
        words.map(|(name, value)| (name.to_owned(), value.to_owned())).collect()
    }

    #[test]
    fn a_search_that_ends_behind_the_range_is_a_warning_with_the_values_that_do_not() {
        let fast = finding("speed_mm_s = -60.0", "speed_mm_s = -120.0");
        assert_eq!(fast.gravity, Gravity::Warning);
        // 120 mm/s for 20 ms are 2.4 mm already, and 120 mm/s squared by 10,000 mm/s2.
        assert!(
            fast.text.contains("up to 3.84 mm") && fast.text.contains("ends 2 mm behind it"),
            "{fast}"
        );
        assert_eq!(told(&fast).len(), 1, "no quick stop is strong enough: {fast}");
        let weak = GANTRY.replacen("quick_stop_mm_s2 = 10000.0", "quick_stop_mm_s2 = 3000.0", 1);
        let both = check(&weak);
        assert_eq!(both.len(), 2, "the height's switch has room: {both:#?}");
        let told = told(&both[0]);
        let [(_, speed), (_, quick_stop)] = &told[..] else {
            panic!("{told:?}")
        };
        let slower = weak.replace("speed_mm_s = -60.0", &format!("speed_mm_s = {speed}"));
        assert_eq!(check(&slower), [], "at {speed} mm/s");
        let stronger = weak.replace("quick_stop_mm_s2 = 3000.0", &format!("quick_stop_mm_s2 = {quick_stop}"));
        assert_eq!(check(&stronger), [], "at {quick_stop} mm/s2");
    }

    #[test]
    fn a_switch_at_the_end_of_its_axis_is_moved_and_nothing_impossible_is_told() {
        let at_the_end = finding("sync_mm = 2.0", "sync_mm = 0.0");
        assert!(
            at_the_end.text.ends_with("its end; move the switch") && at_the_end.text.contains("ends 0 mm"),
            "{at_the_end}"
        );
    }

    #[test]
    fn a_height_that_is_homed_downwards_or_late_is_a_warning() {
        let late = finding("order = 1", "order = 2");
        assert!(late.text.contains("lowest order"), "{late}");
        let down = check(&GANTRY.replacen("sync_mm = 3.0", "sync_mm = -58.0", 1).replacen(
            "speed_mm_s = 20.0",
            "speed_mm_s = -20.0",
            1,
        ));
        assert!(down.iter().any(|found| found.text.contains("downwards")), "{down:#?}");
    }

    #[test]
    fn a_machine_that_is_outside_its_work_area_after_homing_is_told() {
        let outside = finding("pull_off_mm = 10.0", "pull_off_mm = 4.0");
        assert!(
            outside.text.contains("x 6.0") && outside.text.contains("pull_off_mm"),
            "{outside}"
        );
    }

    /// Two belts with a switch at the lower ends of x and y, -167 mm, where the belts are at -334 and 0 mm.
    fn with_switches(changes: &[(&str, &str)]) -> Vec<Finding> {
        let belts = include_str!("../../../../samples/machines/corexy.toml");
        let home = |switch: &str, sync: &str| {
            format!(
                "sync_mm = {sync}\n[axes.home]\nswitch = \"{switch}\"\nspeed_mm_s = -60.0\nlatch_mm_s = 6.0\n\
                 pull_off_mm = 20.0\ntravel_max_mm = 374.0\n"
            )
        };
        let mut text = belts.replacen("sync_mm = 0.0\n", &home("x_home", "-334.0"), 1);
        text = text.replacen("sync_mm = 0.0\n", &home("y_home", "0.0"), 1);
        for (name, bit) in [("x_home", 1), ("y_home", 2)] {
            text +=
                &format!("\n[[io]]\nname = \"{name}\"\nslave = 1\ndirection = \"in\"\nbit = {bit}\nrole = \"home\"\n");
        }
        for (from, to) in changes {
            assert!(text.contains(from), "{from}");
            text = text.replacen(from, to, 1);
        }
        check(&text)
    }

    #[test]
    fn axes_that_move_together_have_their_places_where_both_switches_open() {
        assert_eq!(with_switches(&[]), []);
        // The switch of y is beyond the end of y: a belt more is also a slide less.
        let beyond = with_switches(&[("sync_mm = 0.0", "sync_mm = 30.0")]);
        assert!(
            beyond.iter().any(|found| found.gravity == Gravity::Error
                && found
                    .text
                    .contains("y (moved by axes 1 and 2) would be at -182 mm at its switch")
                && found.text.contains("-170 to 170 mm")),
            "{beyond:#?}"
        );
        let away = with_switches(&[("speed_mm_s = -60.0", "speed_mm_s = 60.0")]);
        assert!(away.iter().any(|found| found.text.contains("lower end")), "{away:#?}");
        let short = with_switches(&[("travel_max_mm = 374.0", "travel_max_mm = 300.0")]);
        assert!(
            short.iter().any(|found| found.text.contains("340 mm long")),
            "{short:#?}"
        );
        let outside = with_switches(&[("pull_off_mm = 20.0", "pull_off_mm = 10.0")]);
        assert!(
            outside.iter().any(|found| found.text.contains("x -157.0")),
            "{outside:#?}"
        );
        let one = with_switches(&[(
            "[axes.home]\nswitch = \"y_home\"\nspeed_mm_s = -60.0\nlatch_mm_s = 6.0\npull_off_mm = 20.0\ntravel_max_mm = 374.0\n",
            "",
        )]);
        assert!(
            one.iter()
                .any(|found| found.gravity == Gravity::Error && found.text.contains("moves together")),
            "{one:#?}"
        );
        // Both searches at once, at 1000 and 600 mm/s, are faster than a belt may be; one behind the other they are not.
        let fast = [
            ("speed_mm_s = -60.0", "speed_mm_s = -1000.0"),
            ("speed_mm_s = -60.0", "speed_mm_s = -600.0"),
        ];
        let is_refused = |found: &Finding| found.gravity == Gravity::Error && found.text.contains("speed_mm_s");
        let together = with_switches(&fast);
        assert!(together.iter().any(is_refused), "{together:#?}");
        let in_turn = with_switches(&[fast[0], ("speed_mm_s = -60.0", "order = 1\nspeed_mm_s = -600.0")]);
        assert!(!in_turn.iter().any(is_refused), "{in_turn:#?}");
        // The other belt turns as fast as this one, also while x is sought alone.
        let weaker = with_switches(&[
            fast[0],
            ("speed_mm_s = -60.0", "order = 1\nspeed_mm_s = -600.0"),
            ("# belt b: x - y\n", "\noutput_max_mm_s = 900.0\n"),
        ]);
        assert!(weaker.iter().any(is_refused), "{weaker:#?}");
    }

    #[test]
    fn a_switch_outside_the_range_is_an_error() {
        let outside = finding("sync_mm = 2.0", "sync_mm = -2.0");
        assert_eq!(outside.gravity, Gravity::Error);
        assert!(
            outside.text.contains("-2 mm at its switch") && outside.text.contains("0 to 640 mm"),
            "{outside}"
        );
    }
}
