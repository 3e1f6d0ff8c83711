//! The mechanism of an episode: dimensions of the robot and its work area, gears, encoders, and the way frames take.
//!
//! Each has random numbers of its own. Dimensions are changed by the names of the configuration, whatever the kind of robot.
//! The sheet stays where it is, and the robot has to reach all of it.

use super::super::chance::Chance;
use super::super::episode::{Episode, Event, What};
use super::super::robot;
use super::setup::END_RAD;
use crate::axes::{Motion, motion};
use crate::settings::checking;
use etherpen::config::{AxisMode, Config, WorkVolume};
use etherpen::motion::WorkArea;
use etherpen::robots::{AXES, JointAngles, Kinematics, MAIN_AXES};
use std::f64::consts::TAU;
use toml::Value;

/// Gives the choice of other dimensions, gears and ways of the frames random numbers of their own.
const DIMENSIONS_SEED: u64 = 0x0D13_E510_0000;
const GEARS_SEED: u64 = 0x06EA_2500_0000;
const TRANSPORT_SEED: u64 = 0x07AA_4590_0000;
/// By which part dimensions change: lengths at most by so much, and a range by half of it at each end.
const SHARES: [f64; 2] = [0.003, 0.4];
/// How often the change is halved until the robot reaches its sheet.
const HALVES_MAX: u32 = 8;
/// Largest change of the angle between two equal parts of a robot, degrees, for a share of 1.
const UNEQUAL_DEG: f64 = 30.0;
/// By which factor a gear and the unit of a speed differ from the usual ones.
const GEARS: [f64; 2] = [0.5, 2.0];
const UNITS: [f64; 2] = [0.2, 5.0];
/// Fastest motor, revolutions per minute: the usual limit of a servo motor, of which `etherpen config check` warns.
const MOTOR_MAX_RPM: f64 = 6_000.0;
/// Increments for a turn of a motor: powers of two and of ten, and what no encoder has.
const RESOLUTIONS: [i64; 9] = [
    1 << 16,
    1 << 17,
    100_000,
    1 << 18,
    1_000_000,
    1_048_573,
    1 << 22,
    10_000_000,
    1 << 24,
];
/// Gives what encoders know random numbers of its own.
const KNOWLEDGE_SEED: u64 = 0x0E4C_0DE2_0000;
/// Faults in which an encoder shows another position than the motor's.
const UNTRUE: [&str; 6] = ["stuck", "slip", "jump", "reverse", "noise", "exchange"];
/// Values of an axis's encoder.
const ENCODER: [&str; 2] = ["increments_per_revolution", "sync_increments"];
/// Travel of a search for a home switch, in ways from one end of the axis to the other.
pub(super) const SEARCHED: f64 = 1.1;
/// The board's own address, the segment's on the same network, and one behind a gateway, with it.
const OWN: &str = "10.0.2.15/24";
const NEAR: &str = "10.0.2.2";
const FAR: [&str; 2] = ["192.168.7.9", "10.0.2.1"];

/// Varies the mechanism of an episode, and how its frames travel.
pub(super) fn vary(episode: &mut Episode, seed: u64) {
    let mut dimensions = Chance::new(seed ^ DIMENSIONS_SEED);
    if dimensions.one_in(3) {
        reshape(episode, &mut dimensions);
    }
    let mut gears = Chance::new(seed ^ GEARS_SEED);
    if gears.one_in(3) {
        regear(episode, &mut gears);
    }
    let mut transport = Chance::new(seed ^ TRANSPORT_SEED);
    if transport.one_in(5) {
        by_udp(episode, &mut transport);
    }
}

/// Changes the dimensions of robot and work area by as much as leaves a robot that reaches its sheet.
fn reshape(episode: &mut Episode, chance: &mut Chance) {
    let Ok(usual) = episode.configuration() else { return };
    // In torque mode the inertia is a configured one, which follows from the dimensions.
    if is_by_torque(&usual) {
        return;
    }
    let most = chance.scaled(SHARES[0], SHARES[1]);
    let turned_deg = chance.between(-180.0, 180.0);
    let sections = [
        ("geometry", Value::try_from(usual.geometry)),
        ("work_area", Value::try_from(usual.work_area)),
    ];
    // A mark at the end of an axis lets its range become wider only.
    let widens = chance.one_in(2);
    let mut parts = Vec::new();
    for (section, table) in sections {
        let Ok(Value::Table(table)) = table else { return };
        for (name, value) in table {
            let mut leans = [(); MAIN_AXES].map(|()| chance.between(-1.0, 1.0));
            if widens && section == "geometry" && name.contains("_range_") {
                (leans[0], leans[1]) = (-leans[0].abs(), leans[1].abs());
            }
            parts.push((section, name, value, leans));
        }
    }
    let is_mirrored = chance.one_in(2);
    let before = episode.config.clone();
    for halves in 0..HALVES_MAX {
        let share = most / f64::from(1 << halves);
        for (section, name, value, leans) in &parts {
            if let Some(changed) = changed(name, value, share, leans, turned_deg) {
                episode.config.insert(format!("{section}.{name}"), changed);
            }
        }
        if is_mirrored {
            mirror(episode, &usual, &parts);
        }
        search_farther(episode);
        if episode.configuration().is_ok_and(|config| is_usable(&config, &usual)) {
            return;
        }
        episode.config = before.clone();
    }
}

/// A part of a table of dimensions: table, name, usual value, and by which part of the largest change each number changes.
type Part = (&'static str, String, Value, [f64; MAIN_AXES]);

/// A dimension that differs from the usual one; `None` for one that stays.
fn changed(name: &str, value: &Value, share: f64, leans: &[f64; MAIN_AXES], turned_deg: f64) -> Option<Value> {
    let rounded = |value: f64| Value::Float((value * 1e4).round() / 1e4);
    if name.contains("margin") || name.starts_with("turn_") {
        return None;
    }
    match value {
        // A height of the work area may lie at 0: it changes by a part of 100 mm.
        Value::Float(mm) if name.starts_with("z_") => Some(rounded(mm + share * leans[0] * 100.0)),
        Value::Float(mm) if name.ends_with("_mm") && *mm < WorkVolume::BORDER_MAX_MM => {
            Some(rounded(mm * (1.0 + share * leans[0])))
        }
        Value::Array(values) if name.ends_with("_deg") => {
            let values = values.iter().filter_map(Value::as_float).zip(leans);
            let turned = |(deg, lean): (f64, &f64)| rounded((deg + turned_deg + share * lean * UNEQUAL_DEG) % 360.0);
            Some(Value::Array(values.map(turned).collect()))
        }
        Value::Array(ends) => {
            let [low, high] = [ends.first()?, ends.last()?].map(Value::as_float);
            let (low, high) = (low?, high?);
            let width = high - low;
            let is_a_range = (0.0..WorkVolume::BORDER_MAX_MM).contains(&width);
            let moved = |end: f64, lean: f64| rounded(end + 0.5 * share * lean * width);
            is_a_range.then(|| Value::Array(vec![moved(low, leans[0]), moved(high, leans[1])]))
        }
        _ => None,
    }
}

/// Puts a robot that has sides on its other one: it and its marks are mirrored at the x axis.
fn mirror(episode: &mut Episode, usual: &Config, parts: &[Part]) {
    let side = parts.iter().find_map(|(section, name, value, _)| match value {
        Value::Integer(side) => Some((format!("{section}.{name}"), *side)),
        _ => None,
    });
    let Some((place, side)) = side else { return };
    episode.config.insert(place, Value::Integer(-side));
    let kind = usual.geometry.kind();
    for (axis, settings) in usual.axes.iter().enumerate().take(MAIN_AXES) {
        if motion(kind, axis) == Motion::Rotary {
            let mark = Value::Float(-settings.sync_angle_rad);
            episode.config.insert(format!("axes.{axis}.sync_angle_rad"), mark);
        }
    }
}

/// Lets the search for a home switch go from one end of the axis to the other.
fn search_farther(episode: &mut Episode) {
    let Ok(config) = episode.configuration() else { return };
    let ranges_rad = config.geometry.slide_ranges_rad();
    for (axis, settings) in config.axes.iter().enumerate().take(config.bus.drives.into()) {
        let turn_rad = || config.geometry.turn_range_rad();
        let [low_rad, high_rad] = ranges_rad.get(axis).copied().unwrap_or_else(turn_rad);
        let needed_rad = ((high_rad - low_rad) * SEARCHED * 1e3).round() / 1e3;
        if settings.home.io.is_some() && settings.home.travel_max_rad < needed_rad {
            let place = format!("axes.{axis}.home.travel_max_rad");
            episode.config.insert(place, Value::Float(needed_rad));
        }
    }
}

/// Whether a robot reaches all of its sheet, and stands at its marks as it usually does: within its ranges, joints no nearer to their
/// ends than those of a folded robot may be or usually are, and with the tool above the paper if it usually is.
fn is_usable(config: &Config, usual: &Config) -> bool {
    let area = WorkArea::new(&config.motion_settings());
    let drives = usize::from(config.bus.drives);
    // Ways from the marks to the nearer ends, rad; below 0 outside.
    let rooms_rad = |config: &Config| {
        let ranges_rad = robot::ranges_rad(&config.geometry);
        let mark_rad = config.axes.each_ref().map(|axis| axis.sync_angle_rad);
        let room_rad = |axis: usize| (mark_rad[axis] - ranges_rad[axis][0]).min(ranges_rad[axis][1] - mark_rad[axis]);
        core::array::from_fn::<f64, AXES, _>(room_rad)
    };
    let (rooms, usual_rooms) = (rooms_rad(config), rooms_rad(usual));
    let least_rad = |axis: usize| match motion(config.geometry.kind(), axis) {
        Motion::Rotary => usual_rooms[axis].clamp(0.0, END_RAD),
        Motion::Linear => 0.0,
    };
    let is_within = |config: &Config| {
        let low_mm = config.paper.pen_down_z_mm + config.paper.pen_lift_mm;
        let marks = JointAngles(config.axes.each_ref().map(|axis| axis.sync_angle_rad));
        let tool = Kinematics::new(&config.geometry).map(|robot| robot.forward(&marks));
        tool.is_ok_and(|tool| tool.is_ok_and(|tool| tool.z_mm >= low_mm))
    };
    area.is_ok_and(|area| checking::unreached(config, &area).is_none())
        && (0..drives).all(|axis| rooms[axis] >= least_rad(axis))
        && (is_within(config) || !is_within(usual))
}

fn is_by_torque(config: &Config) -> bool {
    config.axes.iter().any(|axis| axis.mode == AxisMode::Torque)
}

/// Gives the axes other gears, also ones that turn the other way, other encoders, other marks and another unit of the speed.
fn regear(episode: &mut Episode, chance: &mut Chance) {
    let Ok(usual) = episode.configuration() else { return };
    let keeps_inertia = is_by_torque(&usual);
    for (axis, settings) in usual.axes.iter().enumerate().take(usual.bus.drives.into()) {
        let factor = chance.scaled(GEARS[0], GEARS[1]);
        let rpm_for_one = settings.output_max_rad_s * 60.0 / TAU;
        let most = (MOTOR_MAX_RPM / rpm_for_one).max(settings.gear.abs());
        let gear = match keeps_inertia {
            true => settings.gear,
            false => settings.gear.signum() * (settings.gear.abs() * factor).min(most),
        };
        let sign = if chance.one_in(3) { -1.0 } else { 1.0 };
        let increments = chance.one_of(&RESOLUTIONS);
        let mark = chance.below(increments as u64) as i64;
        let digits_per_rpm = settings.digits_per_rpm * chance.scaled(UNITS[0], UNITS[1]);
        let rounded = |value: f64| Value::Float((value * 1e6).round() / 1e6);
        for (name, value) in [
            ("gear", rounded(sign * gear)),
            ("increments_per_revolution", Value::Integer(increments)),
            ("sync_increments", Value::Integer(mark)),
            ("digits_per_rpm", rounded(digits_per_rpm)),
        ] {
            episode.config.insert(format!("axes.{axis}.{name}"), value);
        }
    }
    // A fine encoder behind a high gear has more increments than its drive can be told to brake by: then all get the usual ones.
    for names in [&ENCODER[..], &["gear", "digits_per_rpm"]] {
        if episode.configuration().is_err() {
            let is_of_these = |place: &str| names.iter().any(|name| place.ends_with(&format!(".{name}")));
            episode.config.retain(|place, _| !is_of_these(place));
        }
    }
}

/// Gives axes encoders that know more or less than those of most machines: incremental ones where there is a home switch, and
/// multi-turn ones with any offset where the drives show all of their position, unless one slips or shows something else.
pub(super) fn change_encoders(episode: &mut Episode, seed: u64) {
    let mut chance = Chance::new(seed ^ KNOWLEDGE_SEED);
    let Ok(usual) = episode.configuration() else { return };
    if !chance.one_in(3) {
        return;
    }
    let shows_other = |event: &Event| match &event.what {
        What::Fault(words) => UNTRUE.iter().any(|word| words.starts_with(word)),
        _ => false,
    };
    let used = usual.axes.iter().take(usual.bus.drives.into());
    let counts_turns = used.clone().all(|axis| axis.mode == AxisMode::Position);
    let is_true = !episode.events.iter().any(shows_other);
    for (number, axis) in used.enumerate() {
        let mark = chance.one_of(&[1, i64::from(i32::MAX), i64::from(i32::MIN), -1])
            + chance.one_of(&[0, 1]) * chance.below(1 << 30) as i64 * chance.one_of(&[-1, 1]);
        let (encoder, mark) = match axis.home.io {
            Some(_) if chance.one_in(2) => ("incremental", 0),
            // A mark at 0 is that of an encoder that was never calibrated.
            None if counts_turns && is_true => {
                ("multi-turn", i64::from(if mark as i32 == 0 { 1 } else { mark as i32 }))
            }
            _ => continue,
        };
        let values = [
            ("encoder", Value::String(encoder.into())),
            ("sync_increments", Value::Integer(mark)),
        ];
        for (name, value) in values {
            episode.config.insert(format!("axes.{number}.{name}"), value);
        }
    }
}

/// Sends EtherCAT in UDP: to a segment on the board's own network, or behind a gateway.
fn by_udp(episode: &mut Episode, chance: &mut Chance) {
    let [segment, gateway] = FAR;
    let is_far = chance.one_in(2);
    let places = [
        ("transport", "udp"),
        ("address", OWN),
        ("segment", if is_far { segment } else { NEAR }),
        ("gateway", if is_far { gateway } else { "0.0.0.0" }),
    ];
    for (name, text) in places {
        episode.config.insert(format!("bus.{name}"), Value::String(text.into()));
    }
}
