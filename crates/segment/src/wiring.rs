//! Cables of a tree of slaves, and the way of a frame through them.
//!
//! A frame enters a slave at port 0, is processed, leaves through the ports 3, 1 and 2 in turn, comes back from each,
//! and leaves through port 0. A port whose loop is closed passes the frame on at once; a frame that leaves through an
//! open port without a neighbour, or that arrives at a closed port, is lost. Order of the ports and loop control: the
//! slave controller's data-link control (registers 0x0100 and 0x0110).
//!
//! Invariant: every call ends; cables that contradict each other leave slaves out, and no input panics.

use crate::controller::PORTS;
use crate::slave::Slave;

/// Order in which a frame leaves through the ports behind the processing unit.
const EXITS: [u8; 3] = [3, 1, 2];
/// Port at which the cable towards the master is plugged in.
const ENTRY: u8 = 0;
/// Order in which a bypass of a removed slave looks for the next one.
const BYPASS: [u8; 3] = [1, 2, 3];

/// A cable that does not lead from port 1 of the slave before to the next slave. Slaves count from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Branch {
    /// The slave whose port 0 the cable leads to.
    pub slave: usize,
    /// The slave from which it comes; a lower number.
    pub behind: usize,
    /// The port there, 1 to 3.
    pub port: u8,
}

/// Propagation times of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TravelTimes {
    /// Through one cable, ns.
    pub(crate) cable_ns: u64,
    /// Through one slave, in either direction, ns.
    pub(crate) forwarding_ns: u64,
}

/// A frame at one slave; times count from the moment in which it left the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Visit {
    /// The slave, from 0.
    pub(crate) slave: usize,
    /// Arrival at port 0, ns.
    pub(crate) arrival_ns: u64,
    /// Arrival at the other ports, ns; `None` where it does not come back.
    pub(crate) back_ns: [Option<u64>; PORTS],
}

/// The way of a frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct Route {
    /// The slaves that process it, in order.
    pub(crate) visits: Vec<Visit>,
    /// Time at which it is back at the master, ns; `None` if it is lost on its way.
    pub(crate) back_ns: Option<u64>,
}

/// Which slaves are connected, and which cables are pulled.
#[derive(Clone, Debug)]
pub(crate) struct Wiring {
    /// The slaves behind the ports of each slave, from 0.
    behind: Vec<[Option<usize>; PORTS]>,
    /// Whether the cable that leads to each slave is pulled.
    cut: Vec<bool>,
    /// How long that cable still lies open because a slave at one of its ends is being exchanged, ms.
    open_ms: Vec<u64>,
    /// Whether each slave is bypassed.
    removed: Vec<bool>,
    travel: TravelTimes,
}

impl Wiring {
    /// A line of `slaves` slaves with these branches; a branch that makes no sense is a place of the line.
    pub(crate) fn new(slaves: usize, branches: &[Branch], travel: TravelTimes) -> Self {
        let mut behind = vec![[None; PORTS]; slaves];
        for slave in 1..slaves {
            let branch = branches.iter().rfind(|branch| {
                let port = EXITS.contains(&branch.port);
                branch.slave == slave + 1 && (1..branch.slave).contains(&branch.behind) && port
            });
            let (parent, port) = branch.map_or((slave - 1, 1), |branch| (branch.behind - 1, branch.port));
            let place = behind
                .get_mut(parent)
                .and_then(|ports| ports.get_mut(usize::from(port)));
            if let Some(place) = place {
                place.get_or_insert(slave);
            }
        }
        Self {
            behind,
            cut: vec![false; slaves],
            open_ms: vec![0; slaves],
            removed: vec![false; slaves],
            travel,
        }
    }

    /// Pulls the cable that leads to the slave behind this number, from 0, or plugs it in.
    pub(crate) fn set_cut(&mut self, cable: usize, cut: bool) {
        self.cut.iter_mut().skip(cable).take(1).for_each(|flag| *flag = cut);
    }

    /// Plugs in every cable that was cut; those of slaves that are being exchanged stay open for their time.
    pub(crate) fn join(&mut self) {
        self.cut.fill(false);
    }

    /// Pulls all cables of a slave, from 0, for some milliseconds.
    pub(crate) fn open(&mut self, slave: usize, ms: u64) {
        let behind = self.behind.get(slave).copied().unwrap_or_default();
        for cable in behind.into_iter().flatten().chain([slave]) {
            self.open_ms.iter_mut().skip(cable).take(1).for_each(|left| *left = ms);
        }
    }

    /// Advances by one millisecond.
    pub(crate) fn step(&mut self) {
        for left in &mut self.open_ms {
            *left = left.saturating_sub(1);
        }
    }

    /// Bypasses a slave, from 1, or brings it back.
    pub(crate) fn set_removed(&mut self, slave: usize, removed: bool) {
        let at = slave.wrapping_sub(1);
        self.removed
            .iter_mut()
            .skip(at)
            .take(1)
            .for_each(|flag| *flag = removed);
    }

    /// Which ports of each slave have a link: bit n for port n.
    pub(crate) fn links(&self, slaves: &[Slave]) -> Vec<u8> {
        let mut links = vec![0; slaves.len()];
        let mut link = |slave: usize, port: u8| {
            links
                .iter_mut()
                .skip(slave)
                .take(1)
                .for_each(|ports| *ports |= 1 << port);
        };
        if let Some(first) = self.neighbour(0, slaves) {
            link(first, ENTRY);
        }
        for (slave, _) in slaves.iter().enumerate().filter(|(_, slave)| slave.is_powered()) {
            if self.removed.get(slave).copied().unwrap_or(true) {
                continue;
            }
            for port in EXITS {
                if let Some(other) = self.neighbour_at(slave, port, slaves) {
                    link(slave, port);
                    link(other, ENTRY);
                }
            }
        }
        links
    }

    /// The way of a frame at present.
    pub(crate) fn route(&self, slaves: &[Slave]) -> Route {
        let mut route = Route::default();
        let cable_ns = self.travel.cable_ns;
        let entered = self.neighbour(0, slaves).filter(|first| is_open(slaves, *first, ENTRY));
        route.back_ns = entered
            .and_then(|first| self.visit(first, cable_ns, slaves, &mut route.visits))
            .map(|left_ns| left_ns + cable_ns);
        route
    }

    /// Follows a frame into a slave; returns the time at which it leaves through port 0, `None` if it is lost.
    fn visit(&self, slave: usize, arrival_ns: u64, slaves: &[Slave], visits: &mut Vec<Visit>) -> Option<u64> {
        let place = visits.len();
        visits.push(Visit {
            slave,
            arrival_ns,
            back_ns: [None; PORTS],
        });
        let TravelTimes {
            cable_ns,
            forwarding_ns,
        } = self.travel;
        let mut now_ns = arrival_ns + forwarding_ns;
        for port in EXITS.into_iter().filter(|port| is_open(slaves, slave, *port)) {
            let other = self.neighbour_at(slave, port, slaves)?;
            if !is_open(slaves, other, ENTRY) {
                return None;
            }
            let back_ns = self.visit(other, now_ns + cable_ns, slaves, visits)? + cable_ns;
            let times = visits.get_mut(place).map(|visit| &mut visit.back_ns);
            if let Some(time) = times.and_then(|times| times.get_mut(usize::from(port))) {
                *time = Some(back_ns);
            }
            now_ns = back_ns + forwarding_ns;
        }
        Some(now_ns)
    }

    fn neighbour_at(&self, slave: usize, port: u8, slaves: &[Slave]) -> Option<usize> {
        let next = self.behind.get(slave)?.get(usize::from(port)).copied().flatten()?;
        self.neighbour(next, slaves)
    }

    /// The slave with power at the end of the cable that leads to `slave`, past the removed ones.
    fn neighbour(&self, slave: usize, slaves: &[Slave]) -> Option<usize> {
        let mut at = slave;
        loop {
            if *self.cut.get(at)? || *self.open_ms.get(at)? > 0 {
                return None;
            }
            if !*self.removed.get(at)? {
                return slaves.get(at).filter(|slave| slave.is_powered()).map(|_| at);
            }
            // A slave is behind one with a lower number only: this ends.
            let ports = self.behind.get(at)?;
            at = BYPASS
                .into_iter()
                .find_map(|port| ports.get(usize::from(port)).copied().flatten())?;
        }
    }
}

fn is_open(slaves: &[Slave], slave: usize, port: u8) -> bool {
    slaves.get(slave).is_some_and(|slave| slave.is_open(port))
}
