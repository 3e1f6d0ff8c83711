//! Makes episodes from seeds.
//!
//! A seed and a profile always give the same episode. Lengths, speeds and times are spread over scales, not over ranges,
//! so that small values are as likely as large ones.

use super::chance::Chance;
use super::episode::{Episode, Event, Figure, FileUse, What, Wish};
use super::machine::Machine;
use super::{figures, robot, trouble};
use crate::axes::{Motion, motion};
use crate::settings::checking;
use clap::ValueEnum;
use etherpen::config::{Config, PenLiftKind};
use etherpen::messages::Command;
use etherpen::motion::{Pen, WorkArea};
use etherpen::robots::{JointAngles, Kinematics, MAIN_AXES, Position};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use toml::Value;

/// Which faults an episode may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Profile {
    /// Everything below, several at once.
    All,
    /// No faults: random drawings and commands on a sound machine.
    Quiet,
    /// Frames, cables, power and slaves of the bus.
    Bus,
    /// Drives and their position feedback.
    Drives,
    /// The serial line and the operator's program.
    Link,
    /// Inputs, clock and processor of the board.
    Board,
    /// Commands at any time, several in one millisecond.
    Operator,
    /// Terminals behind the drives, and outputs that are lost on their way.
    Terminals,
    /// Drives at each other's places, told apart by their serial numbers, and outputs that are lost on their way.
    Cables,
}

/// Longest time of an episode before everything is healed, ms.
const DURATION_MAX_MS: f64 = 25_000.0;
/// Most events of an episode.
const EVENTS_MAX: u64 = 14;
/// One command beside the session in so many brings others with it, at most this many.
const CROWD_ONE_IN: u64 = 6;
const CROWD_MAX: u64 = 60;
/// Time in which a new connection is made, ms.
const RECONNECTING_MS: u64 = 60;

/// The episode of a seed on a machine.
#[must_use]
pub fn episode(machine: &Machine, seed: u64, profile: Profile) -> Episode {
    let mut chance = Chance::new(seed ^ 0x5EED_0000_0000_0000);
    let duration_ms = chance.scaled(3_000.0, DURATION_MAX_MS) as u32;
    let figures: Vec<Figure> = (0..1 + chance.below(3))
        .map(|_| figures::figure(&mut chance, machine))
        .collect();
    let wishes = (0..1 + chance.below(6))
        .map(|_| wish(&mut chance, machine, figures.len()))
        .collect();
    let mut episode = Episode {
        found: String::new(),
        machine: machine.name.clone(),
        seed: chance.below(1 << 40),
        duration_ms,
        patience_ms: chance.scaled(10.0, 1_000.0) as u32,
        draws: true,
        wishes,
        figures,
        config: configuration(&mut chance, machine),
        events: Vec::new(),
    };
    keep_valid(&mut episode);
    if chance.one_in(5) {
        soften(&mut episode, machine, chance.scaled(0.5, 400.0));
    }
    let is_by_torque = episode.config.keys().any(|key| key.ends_with(".mode"));
    // With chances of its own, so that the other episodes of all seeds stay as they are.
    if !is_by_torque && Chance::new(seed ^ POSITION_SEED).one_in(6) {
        by_position(&mut episode, machine);
    }
    let mut tilting = Chance::new(seed ^ TILT_SEED);
    if machine.config.pen.kind == PenLiftKind::Axis && tilting.one_in(4) {
        tilt(&mut episode, &mut tilting);
    }
    if Chance::new(seed ^ EXCHANGE_SEED).one_in(4) {
        let combined = Value::String("combined".into());
        episode.config.insert("bus.exchange".into(), combined);
    }
    let mut folding = Chance::new(seed ^ FOLD_SEED);
    if !machine.config.has_home_switches() && folding.one_in(4) {
        fold(&mut episode, &mut folding);
    }
    let mut handling = Chance::new(seed ^ HANDLING_SEED);
    if handling.one_in(5) {
        let [lower, jog, draw] = with_the_pen_down(&mut handling, episode.figures.len());
        let place = handling.below(episode.wishes.len() as u64 + 1) as usize;
        match handling.one_in(2) {
            // Somebody who only tries the pen.
            true => episode.wishes = vec![lower, jog],
            false => _ = episode.wishes.splice(place..place, [lower, jog, draw]),
        }
    }
    match profile {
        Profile::Terminals if machine.chain.terminals.is_empty() => with_terminals(&mut episode, machine),
        Profile::Cables => with_serial_numbers(&mut episode, machine),
        _ => {}
    }
    if profile != Profile::Quiet {
        episode.events = events(
            &mut chance,
            &mut Chance::new(seed ^ CROWD_SEED),
            machine,
            profile,
            duration_ms,
        );
        let mut noise = Chance::new(seed ^ GREETING_SEED);
        if matches!(profile, Profile::Link | Profile::All) && noise.one_in(8) {
            episode.events.extend(stops_before_the_greeting(&mut noise));
        }
        let mut processors = Chance::new(seed ^ PROCESSOR_SEED);
        if matches!(profile, Profile::Bus | Profile::All) && processors.one_in(4) {
            episode
                .events
                .push(short_standstill(&mut processors, machine, duration_ms));
        }
        let mut brakes = Chance::new(seed ^ BRAKES_SEED);
        if matches!(profile, Profile::Drives | Profile::All) && brakes.one_in(6) {
            episode
                .events
                .extend(jump_without_power(&mut brakes, machine, duration_ms));
        }
        episode.events.sort_by_key(|event| event.at_ms);
    }
    episode
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

/// Lowers the pen, jogs upwards and draws.
fn with_the_pen_down(chance: &mut Chance, figures: usize) -> [Wish; 3] {
    let lower = Command::Pen { pen: Pen::Down };
    let mut velocity_mm_s = velocity(chance);
    velocity_mm_s[2] = chance.scaled(1.0, 200.0) as f32;
    let jog = Wish::Jog(velocity_mm_s, chance.milliseconds(1_500));
    let draw = Wish::Draw(chance.below(figures as u64) as usize);
    [Wish::AtOnce(vec![lower]), jog, draw]
}

/// A line with noise on which the first greeting may be lost, while somebody presses the stop a few times.
fn stops_before_the_greeting(chance: &mut Chance) -> Vec<Event> {
    let lasts_ms = chance.scaled(20.0, 1_500.0) as u32;
    let noise = What::Noise(lasts_ms, chance.scaled(5.0, 100.0) as u32);
    let mut events = vec![Event { at_ms: 0, what: noise }];
    events.extend((0..1 + chance.below(3)).map(|_| Event {
        at_ms: chance.below(lasts_ms.min(STOPPED_MAX_MS).into()) as u32,
        what: What::Beside(Command::Stop),
    }));
    events
}

/// A drive's processor that stands still for a moment, about as long as its watchdog takes.
fn short_standstill(chance: &mut Chance, machine: &Machine, duration_ms: u32) -> Event {
    let slave = chance.one_of(&machine.chain.drives);
    let lasts_ms = chance.scaled(60.0, 400.0) as u32;
    Event {
        at_ms: chance.below(duration_ms.into()) as u32,
        what: What::Fault(format!("pdi {slave} {lasts_ms}")),
    }
}

/// An encoder that slips on its shaft some time after the drives are switched off or stopped: the brakes close hard.
fn jump_without_power(chance: &mut Chance, machine: &Machine, duration_ms: u32) -> [Event; 2] {
    let at_ms = chance.below(duration_ms.into()) as u32;
    let later_ms = chance.scaled(150.0, 1_500.0) as u32;
    let off = chance.one_of(&[Command::Disable, Command::Stop, Command::Stop]);
    let slave = chance.one_of(&machine.chain.drives);
    let increments = chance.scaled(1_000.0, 200_000.0) as i64 * chance.one_of(&[-1, 1]);
    [
        (at_ms, What::Beside(off)),
        (at_ms + later_ms, What::Fault(format!("jump {slave} {increments}"))),
    ]
    .map(|(at_ms, what)| Event { at_ms, what })
}

/// Takes values away that the machine cannot have together.
fn keep_valid(episode: &mut Episode) {
    while episode.configuration().is_err() && episode.config.pop_last().is_some() {}
}

/// Names a lamp and an input of two terminals behind the drives, whose failure is no fault.
fn with_terminals(episode: &mut Episode, machine: &Machine) {
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
fn with_serial_numbers(episode: &mut Episode, machine: &Machine) {
    for (axis, slave) in machine.chain.drives.iter().enumerate() {
        let serial = Value::Integer(*slave as i64);
        episode.config.insert(format!("axes.{axis}.serial"), serial);
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

/// Events at random times, now and then several in one burst.
///
/// `crowds` has the chances of the commands that follow an event, so that they change no other one.
fn events(
    chance: &mut Chance,
    crowds: &mut Chance,
    machine: &Machine,
    profile: Profile,
    duration_ms: u32,
) -> Vec<Event> {
    // Faults of one kind of frames can be counted exactly.
    let only = (profile == Profile::Bus && chance.one_in(6)).then(|| trouble::of_frames(chance));
    let mut events = Vec::new();
    let mut at_ms = 0;
    for _ in 0..chance.below(EVENTS_MAX) {
        let in_a_burst = chance.one_in(3);
        at_ms = match in_a_burst {
            true => at_ms + chance.one_of(&[0, 0, 1, 4]),
            false => chance.below(duration_ms.into()) as u32,
        };
        let what = match &only {
            Some(words) => What::Frames(words.clone(), chance.scaled(1.0, 80.0) as u32),
            None => what(chance, machine, profile),
        };
        if let What::Fault(words) = &what
            && let Some(end) = trouble::end_of(chance, words)
        {
            let at_ms = at_ms.saturating_add(chance.milliseconds(3_000)).min(duration_ms);
            events.push(Event {
                at_ms,
                what: What::Fault(end),
            });
        }
        let at_ms = at_ms.min(duration_ms);
        let followers = followers(crowds, machine, &what);
        events.push(Event { at_ms, what });
        events.extend(followers.into_iter().map(|(later_ms, command)| Event {
            at_ms: at_ms + later_ms,
            what: What::Beside(command),
        }));
    }
    events.sort_by_key(|event| event.at_ms);
    events
}

/// Commands beside the session that may follow an event, each with its time after it, ms: as many as the line takes for some
/// ten milliseconds with a stop behind them, orders that pile up while the trajectory waits and a stop among them, or a stop
/// while a new connection is being made.
fn followers(chance: &mut Chance, machine: &Machine, what: &What) -> Vec<(u32, Command)> {
    match what {
        What::Beside(_) if chance.one_in(CROWD_ONE_IN) => {
            let mut crowd: Vec<_> = (0..chance.below(CROWD_MAX))
                .map(|_| (0, command(chance, machine)))
                .collect();
            crowd.push((0, Command::Stop));
            crowd
        }
        What::TrajectoryWaits(ms) if chance.one_in(2) => {
            let mut then = |_| chance.below(u64::from(*ms) + 1) as u32;
            let stop = (then(0), Command::Stop);
            let moments: Vec<u32> = (0..CROWD_MAX).map(&mut then).collect();
            let orders = moments.into_iter().map(|later_ms| {
                // Each of them is an order for the trajectory, in every mode.
                let percent = 10 + chance.below(191) as u8;
                (later_ms, Command::Override { percent })
            });
            orders.chain([stop]).collect()
        }
        What::Reconnect if chance.one_in(2) => vec![(chance.below(RECONNECTING_MS) as u32, Command::Stop)],
        _ => Vec::new(),
    }
}

/// One event.
pub(super) fn what(chance: &mut Chance, machine: &Machine, profile: Profile) -> What {
    let chain = &machine.chain;
    let profile = match profile {
        Profile::All | Profile::Quiet => chance.one_of(&[
            Profile::Bus,
            Profile::Bus,
            Profile::Drives,
            Profile::Drives,
            Profile::Link,
            Profile::Board,
            Profile::Operator,
        ]),
        one => one,
    };
    match profile {
        Profile::Bus if chance.one_in(3) => What::Frames(trouble::of_frames(chance), chance.scaled(1.0, 80.0) as u32),
        Profile::Bus if chance.one_in(10) => {
            What::State(chance.below(chain.slaves as u64) as u8, chance.one_of(&[1, 2, 3, 4, 8]))
        }
        Profile::Bus if chance.one_in(20) => {
            let [bootstrap, writes, closes] = [(); 3].map(|()| chance.one_in(2));
            let file = FileUse {
                bootstrap,
                writes,
                closes,
            };
            What::File(chance.below(chain.slaves as u64) as u8, file)
        }
        Profile::Bus => What::Fault(trouble::of_the_bus(chance, chain)),
        Profile::Drives => What::Fault(trouble::of_a_drive(chance, chain)),
        Profile::Terminals if chance.one_in(4) => What::Fault(trouble::of_the_bus(chance, chain)),
        Profile::Terminals => What::Fault(trouble::of_a_terminal(chance, chain)),
        Profile::Cables => What::Fault(trouble::of_exchanged_cables(chance, chain)),
        Profile::Link => match chance.below(4) {
            0 => What::Reconnect,
            1 => What::Unplug(chance.milliseconds(4_000)),
            _ => What::Noise(chance.milliseconds(4_000), chance.scaled(1.0, 300.0) as u32),
        },
        Profile::Board => match chance.below(6) {
            0 => What::SubstituteClock(chance.milliseconds(2_000)),
            1 => What::TrajectoryWaits(chance.milliseconds(90)),
            2 => What::PortDown(chance.milliseconds(2_000)),
            _ => What::StopInput(chance.milliseconds(2_000)),
        },
        Profile::Operator | Profile::All | Profile::Quiet if chance.one_in(2) => What::Beside(command(chance, machine)),
        Profile::Operator | Profile::All | Profile::Quiet => What::Command(command(chance, machine)),
    }
}

/// A command at a moment that nobody chose. Homing is left to the operator, who knows the robot's pose.
fn command(chance: &mut Chance, machine: &Machine) -> Command {
    match chance.below(14) {
        0 | 1 => Command::Stop,
        2 => Command::Enable,
        3 => Command::Disable,
        4 => Command::Hold,
        5 => Command::Resume,
        6 => Command::Cancel,
        7 => Command::Acknowledge,
        8 => Command::Override {
            percent: chance.below(256) as u8,
        },
        9 => Command::Pen {
            pen: chance.one_of(&[Pen::Up, Pen::Down]),
        },
        10 => Command::Jog {
            velocity_mm_s: velocity(chance),
        },
        11 => Command::Draw {
            job: chance.below(4) as u16,
        },
        _ => {
            let [x_mm, y_mm, z_mm] = position(chance, machine);
            Command::Move {
                position: Position { x_mm, y_mm, z_mm },
            }
        }
    }
}

fn velocity(chance: &mut Chance) -> [f32; 3] {
    let speed_mm_s = chance.scaled(0.5, 400.0);
    [0; 3].map(|_| chance.between(-speed_mm_s, speed_mm_s) as f32)
}

/// A position above the paper; one in eight may lie far outside the work area.
fn position(chance: &mut Chance, machine: &Machine) -> [f64; 3] {
    let (paper, area) = (&machine.config.paper, &machine.config.work_area);
    let sheets = if chance.one_in(8) { 4.5 } else { 1.25 };
    let mut beside = |axis: usize| {
        let reach_mm = sheets * paper.size_mm[axis];
        paper.centre_mm[axis] + chance.between(-reach_mm, reach_mm)
    };
    let (x_mm, y_mm) = (beside(0), beside(1));
    let low_mm = paper.pen_down_z_mm + 2.0;
    let high_mm = (paper.pen_down_z_mm + 70.0).min(area.z_high_mm).max(low_mm);
    [x_mm, y_mm, chance.between(low_mm, high_mm)]
}

/// A place near a border of the work area, on either side.
fn near_a_border(chance: &mut Chance, machine: &Machine) -> [f64; 3] {
    let area = &machine.config.work_area;
    let off_mm = chance.scaled(0.01, 20.0) * chance.one_of(&[-1.0, 1.0]);
    let (direction_rad, z_mm) = (chance.between(0.0, TAU), chance.between(area.z_low_mm, area.z_high_mm));
    let at = |radius_mm: f64, z_mm| [radius_mm * direction_rad.cos(), radius_mm * direction_rad.sin(), z_mm];
    let is_box = area.x_mm.iter().chain(&area.y_mm).all(|side_mm| side_mm.is_finite());
    let side = chance.below(3);
    if is_box {
        let mut place = [
            chance.between(area.x_mm[0], area.x_mm[1]),
            chance.between(area.y_mm[0], area.y_mm[1]),
            z_mm,
        ];
        let sides = [area.x_mm, area.y_mm, [area.z_low_mm, area.z_high_mm]];
        let [low_mm, high_mm] = sides[side as usize];
        place[side as usize] = off_mm + if chance.one_in(2) { low_mm } else { high_mm };
        return place;
    }
    match side {
        0 => at(
            chance.between(area.inner_radius_mm, area.radius_mm),
            area.z_high_mm + off_mm,
        ),
        1 => at(
            chance.between(area.inner_radius_mm, area.radius_mm),
            area.z_low_mm + off_mm,
        ),
        _ if area.inner_radius_mm > 0.0 && chance.one_in(2) => at(area.inner_radius_mm + off_mm, z_mm),
        _ => at(area.radius_mm + off_mm, z_mm),
    }
}

/// A velocity along one axis of the robot.
fn straight(chance: &mut Chance) -> [f32; 3] {
    let mut velocity_mm_s = [0.0; 3];
    velocity_mm_s[chance.below(3) as usize] = (chance.scaled(0.5, 400.0) * chance.one_of(&[-1.0, 1.0])) as f32;
    velocity_mm_s
}

/// Two or three commands for one millisecond.
fn at_once(chance: &mut Chance, machine: &Machine) -> Vec<Command> {
    let mut commands: Vec<Command> = (0..1 + chance.below(2)).map(|_| command(chance, machine)).collect();
    let place = chance.below(commands.len() as u64 + 1) as usize;
    let first = if chance.one_in(2) {
        Command::Home
    } else {
        command(chance, machine)
    };
    commands.insert(place, first);
    commands
}

fn wish(chance: &mut Chance, machine: &Machine, figures: usize) -> Wish {
    match chance.below(16) {
        0..=6 => Wish::Draw(chance.below(figures as u64) as usize),
        7 => Wish::Move(position(chance, machine)),
        8 => Wish::Move(near_a_border(chance, machine)),
        9 => Wish::Jog(velocity(chance), chance.milliseconds(1_500)),
        10 => Wish::Jog(straight(chance), chance.milliseconds(6_000)),
        11 | 12 => Wish::AtOnce(at_once(chance, machine)),
        13 | 14 => chance.one_of(&[Wish::Pen, Wish::Disable]),
        _ => Wish::Override(chance.one_of(&[10, 50, 100, 150, 200])),
    }
}

/// Values that differ from the machine's configuration, with which the drives still follow well.
fn configuration(chance: &mut Chance, machine: &Machine) -> BTreeMap<String, Value> {
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

/// Distance of a lifted pen from the upper border of the work area, mm.
const BELOW_MM: f64 = 0.5;
/// Feedback gain with which drives in torque mode follow well, 1/s.
const TORQUE_GAIN_PER_S: f64 = 40.0;
/// Gain of the position loop of the cell's drives, 1/s.
const POSITION_GAIN_PER_S: f64 = 100.0;
/// Gives the choice of position mode random numbers of its own.
const POSITION_SEED: u64 = 0x0005_1710_0000;
/// Gives the tilt of the sheet random numbers of its own.
const TILT_SEED: u64 = 0x0711_7000_0000;
/// Gives the choice of one telegram for both directions random numbers of its own.
const EXCHANGE_SEED: u64 = 0x0C03_B140_0000;
/// Gives the commands that follow an event random numbers of their own.
const CROWD_SEED: u64 = 0x0C20_3D00_0000;
/// Gives the pose at the start random numbers of its own.
const FOLD_SEED: u64 = 0x0F01_DED0_0000;
/// Largest angle between the usual pose at the start and another one, rad.
const FOLDED_MAX_RAD: f64 = 1.0;
/// Least distance of a joint from an end of its range at the start, rad.
const END_RAD: f64 = 0.05;
/// Gives jogs with the pen down random numbers of their own.
const HANDLING_SEED: u64 = 0x0A4D_1160_0000;
/// Gives stops before the greeting random numbers of their own.
const GREETING_SEED: u64 = 0x06EE_7160_0000;
/// Latest stop before the greeting, ms.
const STOPPED_MAX_MS: u32 = 300;
/// Gives short standstills of processors random numbers of their own.
const PROCESSOR_SEED: u64 = 0x0F0C_E550_0000;
/// Gives encoders that slip without power random numbers of their own.
const BRAKES_SEED: u64 = 0x0B4A_CE50_0000;
/// Steepest sheet along each side, mm for each mm.
const TILT_MAX: f64 = 0.03;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::machine::DEFAULT_MACHINE;
    use crate::cell::SlaveKind;
    use crate::settings::machines::MACHINES;
    use etherpen::ethercat::cyclic::ExchangeKind;

    fn machine(name: &str) -> Machine {
        Machine::load(name).expect("a bundled machine")
    }

    #[test]
    fn every_episode_has_a_valid_configuration_and_drawings() {
        for machine in MACHINES.map(|machine| self::machine(machine.name)) {
            let mut values = 0;
            for seed in 0..120 {
                let episode = episode(&machine, seed, Profile::All);
                let config = episode
                    .configuration()
                    .unwrap_or_else(|cause| panic!("{}, seed {seed}: {cause}", machine.name));
                values += episode.config.len();
                for figure in &episode.figures {
                    let path = figure.path(&config);
                    assert!(path.len() >= 4, "seed {seed}");
                    let repeats = path.windows(2).any(|pair| pair[0].position_um == pair[1].position_um);
                    assert!(!repeats, "seed {seed}: a vertex repeats the one before it");
                }
            }
            assert!(values > 200, "{}: {values} values of the configuration", machine.name);
        }
    }

    #[test]
    fn sheets_lie_aslant_where_the_pen_has_an_axis() {
        for machine in MACHINES.map(|machine| self::machine(machine.name)) {
            let tilts = (0..200).filter(|seed| {
                let config = episode(&machine, *seed, Profile::Quiet).configuration();
                config.expect("a valid configuration").paper.slope != [0.0; 2]
            });
            let tilts = tilts.count();
            match machine.config.pen.kind {
                PenLiftKind::Axis => assert!(tilts > 15, "{}: {tilts} of 200", machine.name),
                _ => assert_eq!(tilts, 0, "{}", machine.name),
            }
        }
    }

    #[test]
    fn both_kinds_of_exchange_are_tried_on_every_machine() {
        for machine in MACHINES.map(|machine| self::machine(machine.name)) {
            let combined = (0..100).filter(|seed| {
                let config = episode(&machine, *seed, Profile::Quiet).configuration();
                config.expect("a valid configuration").bus.exchange == ExchangeKind::Combined
            });
            let combined = combined.count();
            assert!((10..50).contains(&combined), "{}: {combined} of 100", machine.name);
        }
    }

    #[test]
    fn some_machines_stand_folded_at_the_start_and_others_never() {
        for machine in MACHINES.map(|machine| self::machine(machine.name)) {
            let folds = (0..200).filter(|seed| {
                let config = episode(&machine, *seed, Profile::Quiet).configuration();
                let config = config.expect("a valid configuration");
                (config.axes.iter().zip(&machine.config.axes))
                    .any(|(axis, usual)| axis.sync_angle_rad != usual.sync_angle_rad)
            });
            let folds = folds.count();
            match machine.name.as_str() {
                "irb340" | "scara" => assert!((10..100).contains(&folds), "{}: {folds} of 200", machine.name),
                _ => assert_eq!(folds, 0, "{}", machine.name),
            }
        }
    }

    #[test]
    fn stops_come_before_the_greeting_encoders_slip_without_power_and_processors_stand_still_for_a_moment() {
        let machine = machine(DEFAULT_MACHINE);
        let [mut greetings, mut slips, mut standstills] = [0; 3];
        for seed in 0..100 {
            let link = episode(&machine, seed, Profile::Link).events;
            let has_noise = link
                .iter()
                .any(|event| event.at_ms == 0 && matches!(event.what, What::Noise(..)));
            let stops = |event: &Event| event.at_ms < STOPPED_MAX_MS && event.what == What::Beside(Command::Stop);
            greetings += u32::from(has_noise && link.iter().any(stops));
            let drives = episode(&machine, seed, Profile::Drives).events;
            slips += u32::from(drives.iter().any(|event| matches!(event.what, What::Beside(_))));
            let is_short = |event: &Event| matches!(&event.what, What::Fault(words) if words.starts_with("pdi"));
            standstills += u32::from(episode(&machine, seed, Profile::Bus).events.iter().any(is_short));
        }
        assert!((5..30).contains(&greetings), "{greetings} of 100");
        assert!((8..30).contains(&slips), "{slips} of 100");
        assert!(standstills >= 20, "{standstills} of 100");
    }

    #[test]
    fn a_profile_keeps_to_its_faults() {
        let machine = machine(DEFAULT_MACHINE);
        for seed in 0..300 {
            assert!(episode(&machine, seed, Profile::Quiet).events.is_empty());
            for event in episode(&machine, seed, Profile::Link).events {
                assert!(matches!(
                    event.what,
                    What::Reconnect | What::Unplug(_) | What::Noise(..) | What::Beside(Command::Stop)
                ));
            }
        }
    }

    #[test]
    fn terminals_are_behind_the_drives_so_that_the_numbers_of_slaves_are_those_of_the_axes() {
        for seed in 0..50 {
            let episode = episode(&machine(DEFAULT_MACHINE), seed, Profile::Terminals);
            let config = episode.configuration().unwrap_or_else(|cause| panic!("{cause}"));
            let chain = crate::cell::usual_slaves(&config);
            let (drives, terminals) = chain.split_at(config.axes.len());
            assert!(drives.iter().all(|kind| kind.is_drive()), "{chain:?}");
            assert_eq!(terminals, [SlaveKind::Ek1100, SlaveKind::El2008, SlaveKind::El1008]);
        }
    }

    #[test]
    fn every_kind_of_event_and_wish_occurs() {
        let machine = machine(DEFAULT_MACHINE);
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..400 {
            let episode = episode(&machine, seed, Profile::All);
            for event in &episode.events {
                let words = match &event.what {
                    What::Fault(words) | What::Frames(words, _) => {
                        words.split(' ').next().unwrap_or_default().to_owned()
                    }
                    other => format!("{other:?}")
                        .split(['(', ' '])
                        .next()
                        .unwrap_or_default()
                        .to_owned(),
                };
                seen.insert(words);
            }
            seen.extend(episode.wishes.iter().map(|wish| {
                format!("wish {wish:?}")
                    .split('(')
                    .next()
                    .unwrap_or_default()
                    .to_owned()
            }));
        }
        assert!(seen.len() >= 50, "{} kinds: {seen:?}", seen.len());
    }
}
