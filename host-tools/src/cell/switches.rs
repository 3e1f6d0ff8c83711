//! Home switches: contacts at the ends of axes, which open when the axis reaches them.

use etherpen::config::{Config, IoDirection};
use etherpen::robots::AXES;
use std::collections::BTreeMap;

/// A switch of an axis.
#[derive(Clone, Copy, Debug)]
struct Switch {
    axis: usize,
    /// The terminal's place in the chain, from 1.
    slave: usize,
    /// The bit among its inputs.
    bit: usize,
    /// The joint's position at which it opens, rad.
    at_rad: f64,
    /// Direction towards it: 1 or -1.
    towards: f64,
}

/// All inputs of the terminals, with the switches among them.
#[derive(Clone, Debug, Default)]
pub(super) struct Switches {
    switches: Vec<Switch>,
    /// Inputs of each terminal, by its place from 1, as last set.
    inputs: BTreeMap<usize, Vec<u8>>,
    is_broken: bool,
    is_removed: bool,
}

impl Switches {
    /// The switches of a configuration: each stands where its axis has its synchronisation mark.
    pub(super) fn new(config: &Config) -> Self {
        let used = config.axes.iter().take(config.bus.drives.into()).enumerate();
        let switches = used.filter_map(|(axis, values)| {
            let point = config.io.get(usize::from(values.home.io?))?;
            // The entry of channel n is object 0x6000 + 0x10 n.
            let by_object = point.object.map(|object| object.index.wrapping_sub(0x6000) / 0x10);
            (point.direction == IoDirection::In).then_some(Switch {
                axis,
                slave: usize::from(point.slave) + 1,
                bit: usize::from(point.bit.or(by_object)?),
                at_rad: values.sync_angle_rad,
                towards: values.home.speed_rad_s.signum(),
            })
        });
        Self {
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

    /// Where the joint of an axis with a switch starts: somewhere before it, `share` of 0 to 1 of a third of the way that the
    /// search may take.
    pub(super) fn start_rad(config: &Config, axis: usize, share: f64) -> Option<f64> {
        let axis = config.axes.get(axis)?;
        let home = axis.home;
        home.io?;
        let away_rad = (0.05 + share) * home.travel_max_rad / 3.0;
        Some(axis.sync_angle_rad - home.speed_rad_s.signum() * away_rad)
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
        for switch in &self.switches {
            let is_closed = joints_rad
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
