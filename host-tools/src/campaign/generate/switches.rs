//! Home switches of an episode: of axes that move together, which the bundled machines have none for, and the room behind all.

use super::super::chance::Chance;
use super::super::episode::Episode;
use super::mechanism::SEARCHED;
use crate::axes::{Motion, motion};
use crate::settings::checking;
use etherpen::config::{IoDirection, IoPoint, IoRole};
use etherpen::control::search::Approach;
use etherpen::robots::LINEAR_MM_PER_RAD;
use toml::Value;

/// Gives the switches random numbers of their own.
const SWITCHES_SEED: u64 = 0x0511_7C4E_5000;
/// First bit of the switches among the inputs of their terminal.
const FIRST_BIT: u16 = 4;
/// How far a switch is from the end of its range, and how far inside the work area the machine is afterwards, mm.
const FROM_END_MM: [f64; 2] = [2.0, 8.0];
const INSIDE_MM: f64 = 2.0;
/// Speeds of a search, mm/s, and the part of it with which the switch is approached again: slower ones take longer than
/// everything has to heal.
const SPEEDS_MM_S: [f64; 2] = [40.0, 150.0];
const LATCH_PART: f64 = 0.2;

/// Lets axes that move together have a switch each, at either end of x and of y.
pub(super) fn add(episode: &mut Episode, seed: u64) {
    let mut chance = Chance::new(seed ^ SWITCHES_SEED);
    let Ok(config) = episode.configuration() else { return };
    let coupled = config.geometry.kind().coupled_axes();
    let input = config.io.iter().find(|point| point.direction == IoDirection::In);
    let (Some(input), false) = (input, coupled == 0 || config.has_home_switches() || chance.one_in(2)) else {
        return;
    };
    let before = episode.config.clone();
    let (mut points, mut places_rad) = (config.io.clone(), config.switch_places_rad());
    for axis in 0..coupled {
        let is_upper = chance.one_in(2);
        let [low_rad, high_rad] = config.geometry.slide_ranges_rad()[axis];
        let area_mm = [config.work_area.x_mm, config.work_area.y_mm][axis];
        let from_end_rad = chance.between(FROM_END_MM[0], FROM_END_MM[1]) / LINEAR_MM_PER_RAD;
        let (switch_rad, inside_rad, towards) = match is_upper {
            true => (
                high_rad - from_end_rad,
                (area_mm[1] - INSIDE_MM) / LINEAR_MM_PER_RAD,
                1.0,
            ),
            false => (
                low_rad + from_end_rad,
                (area_mm[0] + INSIDE_MM) / LINEAR_MM_PER_RAD,
                -1.0,
            ),
        };
        places_rad[axis] = switch_rad;
        let speed_rad_s = chance.scaled(SPEEDS_MM_S[0], SPEEDS_MM_S[1]) / LINEAR_MM_PER_RAD;
        let io = points.len();
        let point = IoPoint {
            name: ["x_home", "y_home"][axis].try_into().unwrap_or_default(),
            slave: input.slave,
            bit: Some(FIRST_BIT + axis as u16),
            role: IoRole::Home,
            ..IoPoint::default()
        };
        if points.push(point).is_err() {
            return;
        }
        let values = [
            ("io", Value::Integer(io as i64)),
            ("order", Value::Integer(chance.below(2) as i64)),
            ("speed_rad_s", rounded(towards * speed_rad_s)),
            ("latch_rad_s", rounded(LATCH_PART * speed_rad_s)),
            ("pull_off_rad", rounded((switch_rad - inside_rad).abs())),
            ("travel_max_rad", rounded(SEARCHED * (high_rad - low_rad))),
        ];
        for (name, value) in values {
            episode.config.insert(format!("axes.{axis}.home.{name}"), value);
        }
    }
    for (axis, at_rad) in config
        .geometry
        .kind()
        .joints(places_rad)
        .into_iter()
        .enumerate()
        .take(coupled)
    {
        episode
            .config
            .insert(format!("axes.{axis}.sync_angle_rad"), rounded(at_rad));
    }
    let points = Value::try_from(&points);
    if let Ok(points) = points {
        episode.config.insert("io".into(), points);
    }
    if !episode.configuration().is_ok_and(|config| config.has_home_switches()) {
        episode.config = before;
    }
}

fn rounded(value: f64) -> Value {
    Value::Float((value * 1e4).round() / 1e4)
}

/// Gives linear axes with a weak quick stop the room behind their home switches in which a search comes to rest: without it they
/// would run against their ends, of which `etherpen config check` warns.
pub(super) fn make_room_behind(episode: &mut Episode) {
    let (Ok(config), before) = (episode.configuration(), episode.config.clone()) else {
        return;
    };
    let Ok(Value::Table(geometry)) = Value::try_from(config.geometry) else {
        return;
    };
    for (axis, name) in ["x_range_mm", "y_range_mm", "z_range_mm"].into_iter().enumerate() {
        let ends = geometry.get(name).and_then(Value::as_array);
        let ends: Option<Vec<f64>> = ends.map(|ends| ends.iter().filter_map(Value::as_float).collect());
        let motion = motion(config.geometry.kind(), axis);
        let (Some(&[low, high]), Motion::Linear) = (ends.as_deref(), motion) else {
            continue;
        };
        let Some(room_rad) = checking::room_behind_switch_rad(&config, axis) else {
            continue;
        };
        let settings = &config.axes[axis];
        let approach = Approach::of(config.geometry.kind(), &config.axes, axis);
        let missing_mm = ((approach.way_behind_switch_rad() - room_rad) * motion.factor()).ceil();
        let wider = match settings.home.speed_rad_s > 0.0 {
            _ if missing_mm <= 0.0 => continue,
            true => [low, high + missing_mm],
            false => [low - missing_mm, high],
        };
        let wider = Value::Array(wider.map(Value::Float).to_vec());
        episode.config.insert(format!("geometry.{name}"), wider);
    }
    if episode.configuration().is_err() {
        episode.config = before;
    }
}
