//! Home switches: contacts at the ends of axes, which open when the axis reaches them.

use crate::random::Random;
use etherpen::config::{Config, IoDirection};
use etherpen::robots::{AXES, Kind};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Largest distance of a motor from its synchronisation mark at the start, turns.
const TURN_PART: f64 = 0.25;

/// Where the joints of `driven` drives start, rad: at most `offset_max_rad` from their marks, and near enough for the motor's
/// turn to be known; with a switch, somewhere before it, in the first third of the way that the search may take.
pub(super) fn starts_rad(config: &Config, driven: usize, offset_max_rad: f64, random: &mut Random) -> Vec<f64> {
    let mut places_rad = config.switch_places_rad();
    let mut starts_rad = Vec::new();
    for number in 0..driven {
        let axis = config.axes.get(number).copied().unwrap_or_default();
        let most_rad = offset_max_rad.min(TURN_PART * TAU / axis.gear.abs());
        let offset_rad = (2.0 * random.unit() - 1.0) * most_rad;
        // A person has brought it to its mark: nothing else shows where it is.
        let offset_rad = if axis.is_blind() { 0.0 } else { offset_rad };
        if let Some(place_rad) = places_rad.get_mut(number).filter(|_| axis.home.io.is_some()) {
            let share = offset_rad / most_rad / 2.0 + 0.5;
            let away_rad = (0.05 + share) * axis.home.travel_max_rad / 3.0;
            *place_rad -= axis.home.speed_rad_s.signum() * away_rad;
        }
        starts_rad.push(axis.sync_angle_rad + offset_rad);
    }
    let before_switches_rad = config.geometry.kind().joints(places_rad);
    for ((start_rad, axis), before_rad) in starts_rad.iter_mut().zip(&config.axes).zip(before_switches_rad) {
        if axis.home.io.is_some() {
            *start_rad = before_rad;
        }
    }
    starts_rad
}

/// A switch of an axis, or of a slide that two axes move together.
#[derive(Clone, Copy, Debug)]
struct Switch {
    axis: usize,
    /// The terminal's place in the chain, from 1.
    slave: usize,
    /// The bit among its inputs.
    bit: usize,
    /// The position at which it opens, rad.
    at_rad: f64,
    /// Direction towards it: 1 or -1.
    towards: f64,
}

/// All inputs of the terminals, with the switches among them.
#[derive(Clone, Debug, Default)]
pub(super) struct Switches {
    kind: Kind,
    switches: Vec<Switch>,
    /// Inputs of each terminal, by its place from 1, as last set.
    inputs: BTreeMap<usize, Vec<u8>>,
    is_broken: bool,
    is_removed: bool,
}

impl Switches {
    /// The switches of a configuration: each opens where the configuration says.
    pub(super) fn new(config: &Config) -> Self {
        let places_rad = config.switch_places_rad();
        let used = config.axes.iter().take(config.bus.drives.into()).enumerate();
        let switches = used.filter_map(|(axis, values)| {
            let point = config.io.get(usize::from(values.home.io?))?;
            // The entry of channel n is object 0x6000 + 0x10 n.
            let by_object = point.object.map(|object| object.index.wrapping_sub(0x6000) / 0x10);
            (point.direction == IoDirection::In).then_some(Switch {
                axis,
                slave: usize::from(point.slave) + 1,
                bit: usize::from(point.bit.or(by_object)?),
                at_rad: *places_rad.get(axis)?,
                towards: values.home.speed_rad_s.signum(),
            })
        });
        Self {
            kind: config.geometry.kind(),
            switches: switches.collect(),
            ..Self::default()
        }
    }

    /// Whether there are none.
    pub(super) fn is_empty(&self) -> bool {
        self.switches.is_empty()
    }

    /// Breaks all wires, or mends them: a broken wire is an open contact.
    pub(super) fn break_wires(&mut self, broken: bool) {
        self.is_broken = broken;
    }

    /// Takes the switches away, or puts them back: without them the contacts stay closed.
    pub(super) fn remove(&mut self, removed: bool) {
        self.is_removed = removed;
    }

    /// Notes the first inputs of a terminal, as set from outside.
    pub(super) fn set(&mut self, slave: usize, inputs: &[u8]) {
        let kept = self.inputs.entry(slave).or_default();
        kept.resize(kept.len().max(inputs.len()), 0);
        kept.iter_mut().zip(inputs).for_each(|(kept, input)| *kept = *input);
    }

    /// Moves the contacts with the joints; returns the terminals whose inputs have changed.
    pub(super) fn step(&mut self, joints_rad: &[f64; AXES]) -> Vec<(usize, Vec<u8>)> {
        let mut changed = Vec::new();
        let places_rad = self.kind.slides(*joints_rad);
        for switch in &self.switches {
            let is_closed = places_rad
                .get(switch.axis)
                .is_some_and(|rad| (rad - switch.at_rad) * switch.towards < 0.0);
            let is_closed = !self.is_broken && (is_closed || self.is_removed);
            let inputs = self.inputs.entry(switch.slave).or_default();
            inputs.resize(inputs.len().max(switch.bit / 8 + 1), 0);
            let Some(byte) = inputs.get_mut(switch.bit / 8) else {
                continue;
            };
            let mask = 1 << (switch.bit % 8);
            if (*byte & mask != 0) != is_closed {
                *byte ^= mask;
                changed.push((switch.slave, inputs.clone()));
            }
        }
        changed
    }
}
