//! The machine of an episode: values of its configuration, the modes of its drives, its pose at the start.

use super::super::chance::Chance;
use super::super::episode::Episode;
use super::super::machine::Machine;
use super::super::robot;
use crate::axes::{Motion, motion};
use crate::settings::checking;
use etherpen::config::{Config, PenLiftKind};
use etherpen::motion::WorkArea;
use etherpen::robots::{JointAngles, Kinematics, MAIN_AXES};
use std::collections::BTreeMap;
use toml::Value;

/// Distance of a lifted pen from the upper border of the work area, mm.
const BELOW_MM: f64 = 0.5;
/// Feedback gain with which drives in torque mode follow well, 1/s.
const TORQUE_GAIN_PER_S: f64 = 40.0;
/// Gain of the position loop of the cell's drives, 1/s.
const POSITION_GAIN_PER_S: f64 = 100.0;
/// Largest angle between the usual pose at the start and another one, rad.
const FOLDED_MAX_RAD: f64 = 1.0;
/// Least distance of a joint from an end of its range at the start, rad.
pub(super) const END_RAD: f64 = 0.05;
/// Strongest quick stop that is tried as a gentle one, rad/s2.
const QUICK_STOP_MAX_RAD_S2: f64 = 200.0;
/// Steepest sheet along each side, mm for each mm.
const TILT_MAX: f64 = 0.03;
/// Gives the choice of position mode random numbers of its own.
const POSITION_SEED: u64 = 0x0005_1710_0000;
/// Gives the tilt of the sheet random numbers of its own.
const TILT_SEED: u64 = 0x0711_7000_0000;
/// Gives the choice of one telegram for both directions random numbers of its own.
const EXCHANGE_SEED: u64 = 0x0C03_B140_0000;
/// Gives the input shaper random numbers of its own.
const SHAPER_SEED: u64 = 0x0005_4A9E_0000;
/// Gives the pose at the start random numbers of its own.
const FOLD_SEED: u64 = 0x0F01_DED0_0000;

/// Varies the machine of an episode further. What was added later has chances of its own, so that other episodes stay as they
/// are.
pub(super) fn vary(episode: &mut Episode, machine: &Machine, seed: u64, chance: &mut Chance) {
    keep_valid(episode);
    if chance.one_in(5) {
        soften(episode, machine, chance.scaled(0.5, 400.0));
    }
    let is_by_torque = episode.config.keys().any(|key| key.ends_with(".mode"));
    if !is_by_torque && Chance::new(seed ^ POSITION_SEED).one_in(6) {
        by_position(episode, machine);
    }
    let mut tilting = Chance::new(seed ^ TILT_SEED);
    if machine.config.pen.kind == PenLiftKind::Axis && tilting.one_in(4) {
        tilt(episode, &mut tilting);
    }
    if Chance::new(seed ^ EXCHANGE_SEED).one_in(4) {
        let combined = Value::String("combined".into());
        episode.config.insert("bus.exchange".into(), combined);
    }
    let mut shaping = Chance::new(seed ^ SHAPER_SEED);
    if shaping.one_in(4) {
        shape(episode, &mut shaping);
    }
    let mut folding = Chance::new(seed ^ FOLD_SEED);
    // Drives in torque mode follow well near the work area only: folded, the joints have less inertia than is configured.
    if !machine.config.has_home_switches() && folding.one_in(4) && !is_by_torque {
        fold(episode, &mut folding);
    }
}

/// Values that differ from the machine's configuration, with which the drives still follow well.
pub(super) fn configuration(chance: &mut Chance, machine: &Machine) -> BTreeMap<String, Value> {
    let mut values = BTreeMap::new();
    let rounded = |value: f64| Value::Float((value * 1e3).round() / 1e3);
    let (motion, paper) = (&machine.config.motion, &machine.config.paper);
    let part_of =
        |chance: &mut Chance, usual: f64, [low, high]: [f64; 2]| rounded(chance.scaled(low * usual, high * usual));
    if chance.one_in(2) {
        let speed = part_of(chance, motion.speed_mm_s, [0.0125, 1.5]);
        values.insert("motion.speed_mm_s".into(), speed);
    }
    if chance.one_in(3) {
        let speed = part_of(chance, motion.travel_speed_mm_s, [0.02, 1.0]);
        values.insert("motion.travel_speed_mm_s".into(), speed);
    }
    if chance.one_in(3) {
        let acceleration = part_of(chance, motion.acceleration_mm_s2, [0.01, 1.2]);
        values.insert("motion.acceleration_mm_s2".into(), acceleration);
    }
    if chance.one_in(4) {
        values.insert("motion.tolerance_mm".into(), rounded(chance.scaled(0.02, 0.3)));
    }
    if chance.one_in(4) {
        values.insert("motion.jerk_window_ms".into(), Value::Integer(chance.below(12) as i64));
    }
    if chance.one_in(4) {
        values.insert("motion.pen_dwell_ms".into(), Value::Integer(chance.below(80) as i64));
    }
    if chance.one_in(4) {
        let room_mm = machine.config.work_area.z_high_mm - paper.pen_down_z_mm - BELOW_MM;
        values.insert(
            "paper.pen_lift_mm".into(),
            rounded(chance.scaled(1.0, 10.0).min(room_mm)),
        );
    }
    if chance.one_in(3) {
        values.insert("bus.clocks".into(), Value::Boolean(true));
    }
    if chance.one_in(4) {
        values.insert("bus.blind_max_ms".into(), Value::Integer(2 + chance.below(7) as i64));
    }
    if chance.one_in(4) {
        values.insert("bus.watchdog_ms".into(), Value::Integer(20 + chance.below(200) as i64));
    }
    if chance.one_in(4) {
        values.insert("bus.dead_man_ms".into(), Value::Integer(60 + chance.below(300) as i64));
    }
    if chance.one_in(4) {
        values.insert(
            "bus.host_silence_ms".into(),
            Value::Integer(200 + chance.below(2_000) as i64),
        );
    }
    // The other machines' drives are set up for the mode of their samples.
    if chance.one_in(5) && machine.is_default() {
        for axis in 0..machine.axes() {
            values.insert(format!("axes.{axis}.mode"), Value::String("torque".into()));
            values.insert(
                format!("axes.{axis}.feedback_gain_per_s"),
                Value::Float(TORQUE_GAIN_PER_S),
            );
        }
    }
    values
}

/// Takes values away that the machine cannot have together.
pub(super) fn keep_valid(episode: &mut Episode) {
    while episode.configuration().is_err() && episode.config.pop_last().is_some() {}
}

/// Sets the deceleration of a quick stop, rad/s2, if the configuration may have it.
fn soften(episode: &mut Episode, machine: &Machine, rad_s2: f64) {
    let place = |axis| format!("axes.{axis}.quick_stop_rad_s2");
    let axes = 0..machine.axes();
    let value = Value::Float((rad_s2 * 1e3).round() / 1e3);
    episode
        .config
        .extend(axes.clone().map(|axis| (place(axis), value.clone())));
    if episode.configuration().is_err() {
        axes.for_each(|axis| _ = episode.config.remove(&place(axis)));
    }
}

/// Makes the joints slow and their quick stops the weakest that the configuration may have, so that a stop from every move takes
/// long.
pub(super) fn with_gentle_stops(episode: &mut Episode, machine: &Machine, chance: &mut Chance) {
    let part = chance.between(0.1, 1.0);
    let speeds = machine
        .config
        .motion
        .joint_speed_rad_s
        .map(|rad_s| Value::Float((rad_s * part * 1e3).round() / 1e3));
    let before = episode.config.clone();
    episode
        .config
        .insert("motion.joint_speed_rad_s".into(), Value::Array(speeds.to_vec()));
    episode.config.retain(|place, _| !place.ends_with(".quick_stop_rad_s2"));
    let mut rad_s2 = 1.0;
    while rad_s2 < QUICK_STOP_MAX_RAD_S2 && !episode.config.contains_key("axes.0.quick_stop_rad_s2") {
        soften(episode, machine, rad_s2);
        rad_s2 *= 1.1;
    }
    if episode.configuration().is_err() {
        episode.config = before;
    }
}

/// Lets all drives close the position loop.
fn by_position(episode: &mut Episode, machine: &Machine) {
    for axis in 0..machine.axes() {
        let mode = Value::String("position".into());
        episode.config.insert(format!("axes.{axis}.mode"), mode);
        let gain = Value::Float(POSITION_GAIN_PER_S);
        episode.config.insert(format!("axes.{axis}.feedback_gain_per_s"), gain);
    }
    if episode.configuration().is_err() {
        // An axis may be faster with this gain, and then cannot have a gentle stop.
        episode.config.retain(|place, _| !place.ends_with(".quick_stop_rad_s2"));
        keep_valid(episode);
    }
}

/// Lets an input shaper keep a resonance quiet, if it can within the tolerance.
fn shape(episode: &mut Episode, chance: &mut Chance) {
    let shaper = if chance.one_in(2) { "zv" } else { "zvd" };
    let rounded = |value: f64| Value::Float((value * 1e3).round() / 1e3);
    let values = [
        ("motion.input_shaper", Value::String(shaper.into())),
        ("motion.resonance_hz", rounded(chance.scaled(20.0, 200.0))),
        ("motion.resonance_damping", rounded(chance.between(0.0, 0.2))),
    ];
    let places = values.each_ref().map(|(place, _)| *place);
    episode
        .config
        .extend(values.map(|(place, value)| (place.to_string(), value)));
    if episode.configuration().is_err() {
        for place in places {
            episode.config.remove(place);
        }
    }
}

/// Lets the sheet lie aslant, as far as the machine reaches all of it.
fn tilt(episode: &mut Episode, chance: &mut Chance) {
    let mut part = || {
        let steep = chance.scaled(1.0e-4, TILT_MAX);
        (steep * if chance.one_in(2) { 1.0e6 } else { -1.0e6 }).round() / 1.0e6
    };
    let slope = vec![Value::Float(part()), Value::Float(part())];
    episode.config.insert("paper.slope".into(), Value::Array(slope));
    let is_reached = |config: &Config| {
        WorkArea::new(&config.motion_settings()).is_ok_and(|area| checking::unreached(config, &area).is_none())
    };
    if !episode.configuration().is_ok_and(|config| is_reached(&config)) {
        episode.config.remove("paper.slope");
    }
}

/// A machine that stands folded, or in another pose far from its usual one, when it is switched on: often outside its work area.
fn fold(episode: &mut Episode, chance: &mut Chance) {
    let Ok(config) = episode.configuration() else { return };
    let place = |axis: usize| format!("axes.{axis}.sync_angle_rad");
    let drives = usize::from(config.bus.drives).min(MAIN_AXES);
    let mut pose = JointAngles(config.axes.each_ref().map(|axis| axis.sync_angle_rad));
    let turns = |axis: usize| motion(config.geometry.kind(), axis) == Motion::Rotary;
    // The joints hold the tool within their ranges, and the pen stands above the paper.
    let ranges_rad = robot::ranges_rad(&config.geometry);
    let is_upwards = chance.one_in(2);
    let rooms_rad = (0..drives).filter(|axis| turns(*axis)).map(|axis| match is_upwards {
        true => ranges_rad[axis][1] - END_RAD - pose.0[axis],
        false => pose.0[axis] - ranges_rad[axis][0] - END_RAD,
    });
    let most_rad = rooms_rad.fold(FOLDED_MAX_RAD, f64::min).max(0.0);
    let part = if chance.one_in(2) {
        1.0
    } else {
        chance.between(0.0, 1.0)
    };
    let turned_rad = if is_upwards { part * most_rad } else { -part * most_rad };
    for axis in (0..drives).filter(|axis| turns(*axis)) {
        pose.0[axis] = ((pose.0[axis] + turned_rad) * 1e4).round() / 1e4;
        episode.config.insert(place(axis), Value::Float(pose.0[axis]));
    }
    let low_mm = config.paper.pen_down_z_mm + config.paper.pen_lift_mm;
    let is_above =
        Kinematics::new(&config.geometry).is_ok_and(|robot| robot.forward(&pose).is_ok_and(|tool| tool.z_mm >= low_mm));
    if !is_above || episode.configuration().is_err() {
        (0..drives).for_each(|axis| _ = episode.config.remove(&place(axis)));
    }
}

/// Names a lamp and an input of two terminals behind the drives, whose failure is no fault.
pub(super) fn with_terminals(episode: &mut Episode, machine: &Machine) {
    let point = |name: &str, place: u64, direction: &str, role: &str| {
        let text = |text: &str| Value::String(text.into());
        Value::Table(toml::Table::from_iter([
            ("name".into(), text(name)),
            ("slave".into(), Value::Integer(place as i64)),
            ("direction".into(), text(direction)),
            ("bit".into(), Value::Integer(0)),
            ("role".into(), text(role)),
        ]))
    };
    // A coupler comes first, behind the drives.
    let first = machine.chain.slaves as u64 + 1;
    let points = vec![
        point("lamp", first, "out", "lamp"),
        point("spare", first + 1, "in", "none"),
    ];
    episode.config.insert("io".into(), Value::Array(points));
}

/// Tells the drives apart: the serial number of each is its place in the chain, from 1.
pub(super) fn with_serial_numbers(episode: &mut Episode, machine: &Machine) {
    for (axis, slave) in machine.chain.drives.iter().enumerate() {
        let serial = Value::Integer(*slave as i64);
        episode.config.insert(format!("axes.{axis}.serial"), serial);
    }
}
