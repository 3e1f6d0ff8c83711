//! Propagation delays of a chain with branches, from the times at which one frame passed the ports.
//!
//! A frame enters a slave at one port, is processed there, leaves through the next open port in the order 0, 3, 1, 2 and
//! comes back through it, and so on until it leaves where it came in. Every port latches the slave's own 32-bit time, so
//! the difference between two neighbouring ports is the round trip of what hangs between them. Way there and way back
//! are taken as equal, as IEC 61158-4-12 (delay measurement) does.
//!
//! Invariant: whatever the times are, every slave gets a delay and no arithmetic overflows; times may wrap.

use crate::ethercat::wire::register::PORTS;
use heapless::Vec;

/// The order in which a frame visits the ports, seen from port 0.
const VISIT: [usize; PORTS] = [0, 3, 1, 2];

/// What one slave latched when the frame for the delay measurement passed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortTimes {
    /// Whether the slave has distributed clocks; the times of the others are not looked at.
    pub has_clock: bool,
    /// Which ports are open: bit n for port n.
    pub open: u8,
    /// Receive time at each port on the slave's own clock, ns, wrapping.
    pub received_ns: [u32; PORTS],
}

impl PortTimes {
    fn is_open(&self, port: usize) -> bool {
        self.open & 1 << port != 0
    }

    /// The port through which the frame came in: the open one with the earliest time; port 0 without a clock.
    fn entry(&self) -> usize {
        let mut entry = 0;
        if self.has_clock {
            let mut earliest: Option<u32> = None;
            for (port, time_ns) in self.received_ns.iter().enumerate() {
                // Within half the range of the clock, the sign of the difference tells the order across a wrap.
                let is_earlier = earliest.is_none_or(|first| (time_ns.wrapping_sub(first) as i32) < 0);
                if self.is_open(port) && is_earlier {
                    (entry, earliest) = (port, Some(*time_ns));
                }
            }
        }
        entry
    }

    /// The open ports in the order of the frame, the entry first.
    fn visited(&self) -> Vec<usize, PORTS> {
        let start = VISIT.iter().position(|port| *port == self.entry()).unwrap_or(0);
        let ports = (0..PORTS).filter_map(|step| VISIT.get((start + step) % PORTS).copied());
        ports
            .enumerate()
            .filter(|(step, port)| *step == 0 || self.is_open(*port))
            .map(|(_, port)| port)
            .collect()
    }

    /// Time from the entry until the frame was back from everything behind `ports`' last one, ns.
    fn since_entry_ns(&self, port: usize) -> u32 {
        let time_ns = |port: usize| self.received_ns.get(port).copied().unwrap_or(0);
        time_ns(port).wrapping_sub(time_ns(self.entry()))
    }
}

/// Where a slave hangs: the slave before it and how many of that one's ports the frame had visited before.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    parent: Option<usize>,
    branch: usize,
    branches_used: usize,
}

/// The delay from the first slave with a clock to each slave, ns, in chain order; 0 for slaves without a clock.
///
/// Slaves beyond `SLAVES` are left out. A slave without a clock counts as a part of the cable.
pub fn propagation_delays_ns<const SLAVES: usize>(slaves: &[PortTimes]) -> Vec<u32, SLAVES> {
    let nodes: Vec<Node, SLAVES> = tree(slaves);
    let mut delays = Vec::new();
    for (number, slave) in slaves.iter().enumerate().take(SLAVES) {
        let delay_ns = measured_from(slaves, &nodes, number)
            .filter(|_| slave.has_clock)
            .and_then(|(parent, branch)| {
                let parent_delay_ns: u32 = delays.get(parent).copied()?;
                Some(parent_delay_ns.saturating_add(step_ns(slaves.get(parent)?, branch, slave)))
            })
            .unwrap_or(0);
        // The loop ends at the capacity.
        let _ = delays.push(delay_ns);
    }
    delays
}

/// Who hangs on whom: each slave on the nearest one before it that has an open port left.
fn tree<const SLAVES: usize>(slaves: &[PortTimes]) -> Vec<Node, SLAVES> {
    let mut nodes: Vec<Node, SLAVES> = Vec::new();
    for number in 0..slaves.len().min(SLAVES) {
        let has_room = |candidate: &usize| {
            let used = nodes.get(*candidate).map_or(0, |node| node.branches_used);
            slaves
                .get(*candidate)
                .is_some_and(|slave| slave.visited().len() > used + 1)
        };
        let parent = (0..number).rev().find(has_room);
        let branch = parent.and_then(|parent| nodes.get_mut(parent)).map_or(0, |node| {
            node.branches_used += 1;
            node.branches_used
        });
        let _ = nodes.push(Node {
            parent,
            branch,
            branches_used: 0,
        });
    }
    nodes
}

/// The nearest slave with a clock on the way to the master, and the branch of it that leads to the slave.
fn measured_from(slaves: &[PortTimes], nodes: &[Node], number: usize) -> Option<(usize, usize)> {
    let mut node = nodes.get(number)?;
    // The way up is at most as long as the chain.
    for _ in 0..nodes.len() {
        let parent = node.parent?;
        if slaves.get(parent)?.has_clock {
            return Some((parent, node.branch));
        }
        node = nodes.get(parent)?;
    }
    None
}

/// Time from the parent's entry to the entry of the slave that hangs on its given branch (from 1), ns.
fn step_ns(parent: &PortTimes, branch: usize, slave: &PortTimes) -> u32 {
    let visited = parent.visited();
    let (Some(before), Some(port)) = (visited.get(branch.saturating_sub(1)), visited.get(branch)) else {
        return 0;
    };
    let earlier_ns = parent.since_entry_ns(*before);
    let round_trip_ns = parent.since_entry_ns(*port).saturating_sub(earlier_ns);
    let inside_ns = slave.visited().last().map_or(0, |last| slave.since_entry_ns(*last));
    earlier_ns.saturating_add(round_trip_ns.saturating_sub(inside_ns) / 2)
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::println;

    fn slave(open: u8, received_ns: [u32; PORTS]) -> PortTimes {
        PortTimes {
            has_clock: true,
            open,
            received_ns,
        }
    }

    #[test]
    fn delays_of_a_chain_add_up_also_across_a_wrap_of_the_clocks() {
        // Cables and controllers take 600, 400 and 500 ns one way; the clocks start anywhere.
        let chain = |bases: [u32; 4]| {
            [
                slave(0b0011, [bases[0], bases[0].wrapping_add(3_000), 0, 0]),
                slave(0b0011, [bases[1], bases[1].wrapping_add(1_800), 0, 0]),
                slave(0b0011, [bases[2], bases[2].wrapping_add(1_000), 0, 0]),
                slave(0b0001, [bases[3], 7, 7, 7]),
            ]
        };
        for bases in [[1_000, 77, 500_000, 3], [u32::MAX - 10, u32::MAX - 999, 0, u32::MAX]] {
            let delays = propagation_delays_ns::<16>(&chain(bases));
            println!("chain: {delays:?} ns");
            assert_eq!(delays[..], [0, 600, 1_000, 1_500]);
        }
    }

    #[test]
    fn a_branch_is_measured_behind_what_the_frame_visited_before_it() {
        // Slave 0 has slave 1 at port 3 (300 ns one way) with slave 2 behind it (200 ns), and slave 3 at port 1 (700 ns).
        let bus = [
            slave(0b1011, [5_000, 5_000 + 1_000 + 1_400, 0, 5_000 + 1_000]),
            slave(0b0011, [90, 90 + 400, 0, 0]),
            slave(0b0001, [17, 0, 0, 0]),
            slave(0b0001, [4_000, 0, 0, 0]),
        ];
        let delays = propagation_delays_ns::<16>(&bus);
        println!("branch: {delays:?} ns");
        assert_eq!(delays[..], [0, 300, 500, 1_700]);
    }

    #[test]
    fn a_slave_entered_by_another_port_is_measured_from_there() {
        // The second slave's cables are swapped: it is entered by port 1 and passes on through port 0.
        let bus = [
            slave(0b0011, [100, 2_100, 0, 0]),
            slave(0b0011, [1_200, 200, 0, 0]),
            slave(0b0001, [9, 0, 0, 0]),
        ];
        assert_eq!(propagation_delays_ns::<16>(&bus)[..], [0, 500, 1_000]);
    }

    #[test]
    fn a_slave_without_a_clock_is_a_part_of_the_cable() {
        let bare = PortTimes {
            open: 0b0011,
            ..PortTimes::default()
        };
        let bus = [
            bare,
            slave(0b0011, [50, 2_050, 0, 0]),
            bare,
            slave(0b0001, [8, 0, 0, 0]),
        ];
        assert_eq!(propagation_delays_ns::<16>(&bus)[..], [0, 0, 0, 1_000]);
    }

    #[test]
    fn any_times_give_a_delay_for_every_slave() {
        let mut state = 0x1234_5678_u32;
        println!("seed {state:#x}");
        let mut random = || {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            state
        };
        for _ in 0..2_000 {
            let bus: Vec<PortTimes, 20> = (0..random() % 20)
                .map(|_| PortTimes {
                    has_clock: random() & 3 != 0,
                    open: random() as u8 & 15,
                    received_ns: [random(), random(), random(), random()],
                })
                .collect();
            assert_eq!(propagation_delays_ns::<16>(&bus).len(), bus.len().min(16));
        }
    }
}
