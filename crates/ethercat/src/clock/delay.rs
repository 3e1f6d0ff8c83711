//! Propagation delays in a chain with branches, from the times at which one frame passed the ports.
//!
//! A frame enters a slave at one port, is processed there, leaves through the next open port in the order 0, 3, 1, 2
//! and comes back through it, and so on until it leaves through the port where it entered. Every port latches the
//! slave's own 32-bit time, so the difference between two neighbouring ports is the round trip through everything
//! connected between them. Both directions are taken as equal, as in IEC 61158-4-12 (delay measurement).
//!
//! Invariant: for any times every slave gets a delay and no arithmetic overflows; times may wrap.

use crate::topology::{self, CableEnd, PORT_ORDER, Parents};
use crate::wire::register::PORTS;
use heapless::Vec;

/// Times that one slave latched when the frame of the delay measurement passed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortTimes {
    /// Whether the slave has distributed clocks; otherwise its times are ignored.
    pub has_clock: bool,
    /// Which ports are open: bit n for port n.
    pub open: u8,
    /// Receive time at each port on the slave's own clock, ns, wrapping.
    pub received_ns: [u32; PORTS],
}

impl PortTimes {
    fn is_open(&self, port: u8) -> bool {
        self.open & 1 << port != 0
    }

    /// The port at which the frame entered: the open one with the earliest time, or without a clock the first open one in
    /// the order of the frame; port 0 if none is open.
    fn entry(&self) -> u8 {
        let mut entry = PORT_ORDER.into_iter().find(|port| self.is_open(*port)).unwrap_or(0);
        if self.has_clock {
            let mut earliest: Option<u32> = None;
            for (port, time_ns) in (0..).zip(&self.received_ns) {
                // Within half the range of the clock, the sign of the difference gives the order across a wrap.
                let is_earlier = earliest.is_none_or(|first| (time_ns.wrapping_sub(first) as i32) < 0);
                if self.is_open(port) && is_earlier {
                    (entry, earliest) = (port, Some(*time_ns));
                }
            }
        }
        entry
    }

    /// The open ports in the order of the frame, the entry first.
    fn visited(&self) -> Vec<u8, PORTS> {
        let start = PORT_ORDER.iter().position(|port| *port == self.entry()).unwrap_or(0);
        let ports = PORT_ORDER.into_iter().cycle().skip(start).take(PORTS);
        ports
            .enumerate()
            .filter(|(step, port)| *step == 0 || self.is_open(*port))
            .map(|(_, port)| port)
            .collect()
    }

    /// Time from the entry until the frame was back from everything behind the open ports, ns.
    pub(super) fn span_ns(&self) -> u32 {
        let ports = (0..PORTS as u8).filter(|port| self.is_open(*port));
        ports.map(|port| self.since_entry_ns(port)).max().unwrap_or(0)
    }

    /// Whether another frame has passed every open port than the one of the times `before`.
    pub(super) fn is_later_than(&self, before: &Self) -> bool {
        let times = self.received_ns.iter().zip(&before.received_ns);
        (0..)
            .zip(times)
            .all(|(port, (now, then))| !self.is_open(port) || now != then)
    }

    /// Time from the entry until the frame was back from everything behind `port`, ns.
    fn since_entry_ns(&self, port: u8) -> u32 {
        let time_ns = |port: u8| self.received_ns.get(usize::from(port)).copied().unwrap_or(0);
        time_ns(port).wrapping_sub(time_ns(self.entry()))
    }
}

/// The delay from the first slave with a clock to each slave, ns, in chain order; 0 for slaves without a clock.
///
/// Slaves beyond `SLAVES` are left out. A slave without a clock counts as a part of the cable.
pub fn propagation_delays_ns<const SLAVES: usize>(slaves: &[PortTimes]) -> Vec<u32, SLAVES> {
    let parents: Parents<SLAVES> = topology::tree(slaves.len(), |slave| {
        slaves
            .get(slave)
            .map_or_else(Vec::new, |slave| slave.visited().into_iter().skip(1).collect())
    });
    let mut delays = Vec::new();
    for (number, slave) in slaves.iter().enumerate().take(SLAVES) {
        let delay_ns = measured_from(slaves, &parents, number)
            .filter(|_| slave.has_clock)
            .and_then(|end| {
                let parent = usize::from(end.slave);
                let parent_delay_ns: u32 = delays.get(parent).copied()?;
                Some(parent_delay_ns.saturating_add(step_ns(slaves.get(parent)?, end.port, slave)))
            })
            .unwrap_or(0);
        // The loop ends at the capacity.
        let _ = delays.push(delay_ns);
    }
    delays
}

/// The end of the cable at the nearest slave with a clock on the way to the master.
fn measured_from<const SLAVES: usize>(
    slaves: &[PortTimes],
    parents: &Parents<SLAVES>,
    number: usize,
) -> Option<CableEnd> {
    let mut end = (*parents.get(number)?)?;
    // The way up is at most as long as the chain.
    for _ in 0..parents.len() {
        let parent = usize::from(end.slave);
        if slaves.get(parent)?.has_clock {
            return Some(end);
        }
        end = (*parents.get(parent)?)?;
    }
    None
}

/// Time from the parent's entry to the entry of the slave at the end of the cable in one of its ports, ns.
fn step_ns(parent: &PortTimes, port: u8, slave: &PortTimes) -> u32 {
    let visited = parent.visited();
    let Some((before, port)) = visited
        .iter()
        .zip(visited.iter().skip(1))
        .find(|(_, next)| **next == port)
    else {
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
    use crate::random::Random;
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
    fn a_coupler_without_a_clock_whose_first_port_is_closed_is_no_parent_of_what_hangs_elsewhere() {
        // Slave 0 has a coupler without a clock at port 3, cabled at the coupler's port 1 (100 ns one way), and slave 2
        // at port 1 (700 ns).
        let coupler = PortTimes {
            has_clock: false,
            open: 0b0010,
            received_ns: [0; PORTS],
        };
        let bus = [
            slave(0b1011, [5_000, 5_000 + 200 + 1_400, 0, 5_000 + 200]),
            coupler,
            slave(0b0001, [4_000, 0, 0, 0]),
        ];
        assert_eq!(propagation_delays_ns::<16>(&bus)[..], [0, 0, 200 + 700]);
    }

    #[test]
    fn a_branch_is_measured_behind_what_the_frame_visited_before_it() {
        // Slave 0 has slave 1 at port 3 (300 ns one way) with slave 2 behind it (200 ns), and slave 3 at port 1 (700
        // ns).
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
        let mut generator = Random::new(0x1234_5678);
        let mut random = || generator.next();
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
