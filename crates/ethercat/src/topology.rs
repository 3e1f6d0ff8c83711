//! Topology: which slave is connected to which port.
//!
//! Frames pass the ports of a slave controller in the order 0, 3, 1, 2: they enter at the first one with a cable
//! (usually port 0), are processed, and leave through the others in turn. The order in which the slaves process frames
//! and the ports in use therefore give the whole tree (IEC 61158-4-12, DL status register).
//!
//! Invariant: partners are mutual; a port that contradicts the number of slaves has no partner.

use super::diagnostics::PortInfo;
use super::wire::register::{DlStatus, PORTS, PortStatus};
use heapless::Vec;

/// The order in which frames pass the ports.
pub const PORT_ORDER: [u8; PORTS] = [0, 3, 1, 2];

/// One end of a cable: a slave and its port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CableEnd {
    /// The slave, in the order in which frames pass.
    pub slave: u8,
    /// Its port, 0 to 3.
    pub port: u8,
}

/// Whether frames pass through a port.
fn communicates(dl_status: u16, port: u8) -> bool {
    let ports = DlStatus::from_bits(dl_status).ports;
    ports.get(usize::from(port)).is_some_and(PortStatus::is_open)
}

/// The ports of a slave according to its DL status, without partners.
pub fn ports(dl_status: u16) -> [PortInfo; PORTS] {
    DlStatus::from_bits(dl_status).ports.map(|port| PortInfo {
        link: port.link,
        loop_closed: port.loop_closed,
        communicates: port.communication,
        partner: None,
    })
}

/// The port at which frames enter: the first port in use.
pub fn entry(dl_status: u16) -> Option<u8> {
    PORT_ORDER.into_iter().find(|port| communicates(dl_status, *port))
}

/// The ports through which frames continue to other slaves, in their order.
fn exits(dl_status: u16) -> impl Iterator<Item = u8> {
    let in_use = PORT_ORDER
        .into_iter()
        .filter(move |port| communicates(dl_status, *port));
    in_use.skip(1)
}

/// The cable end to which each slave's entry port is connected; `None` for the master or if unknown.
pub type Parents<const SLAVES: usize> = Vec<Option<CableEnd>, SLAVES>;

/// The parent of each slave, from the slaves' DL status registers in the order in which frames pass.
pub fn parents<const SLAVES: usize>(dl_status: &[u16]) -> Parents<SLAVES> {
    tree(dl_status.len(), |slave| {
        exits(dl_status.get(slave).copied().unwrap_or(0)).collect()
    })
}

/// The parent of each of `count` slaves in the order in which frames pass; `exits` gives the ports of a slave through
/// which frames leave to others, in their order.
pub(super) fn tree<const SLAVES: usize>(count: usize, exits: impl Fn(usize) -> Vec<u8, PORTS>) -> Parents<SLAVES> {
    let mut parents = Parents::new();
    // The slaves on the path back to the master, and how many of their exits have been followed.
    let mut way: Vec<(usize, usize), SLAVES> = Vec::new();
    for slave in 0..count.min(SLAVES) {
        let mut parent = None;
        while let Some((candidate, followed)) = way.last_mut() {
            if let Some(port) = exits(*candidate).get(*followed) {
                *followed += 1;
                parent = Some(CableEnd {
                    slave: *candidate as u8,
                    port: *port,
                });
                break;
            }
            way.pop();
        }
        // Both lists have room for every slave.
        let _ = parents.push(parent);
        if !exits(slave).is_empty() {
            let _ = way.push((slave, 0));
        }
    }
    parents
}

/// The slaves at the other ends of a slave's cables.
pub fn partners(parents: &[Option<CableEnd>], slave: usize, dl_status: u16) -> [Option<u8>; PORTS] {
    let mut partners = [None; PORTS];
    let mut connect = |port: u8, other: u8| {
        if let Some(place) = partners.get_mut(usize::from(port)) {
            *place = Some(other);
        }
    };
    for (other, parent) in (0..).zip(parents) {
        if let Some(end) = parent.filter(|end| usize::from(end.slave) == slave) {
            connect(end.port, other);
        }
    }
    if let (Some(Some(parent)), Some(port)) = (parents.get(slave), entry(dl_status)) {
        connect(port, parent.slave);
    }
    partners
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A DL status with links, and communication, on these ports; the loops of the others are closed.
    fn status(open: &[u8]) -> u16 {
        (0..4).fold(0, |status, port| {
            if open.contains(&port) {
                status | 1 << (4 + port) | 1 << (9 + 2 * port)
            } else {
                status | 1 << (8 + 2 * port)
            }
        })
    }

    fn tree(slaves: &[&[u8]]) -> std::vec::Vec<[Option<u8>; PORTS]> {
        let dl_status: std::vec::Vec<_> = slaves.iter().map(|ports| status(ports)).collect();
        let parents = parents::<16>(&dl_status);
        let numbers = 0..dl_status.len();
        numbers
            .map(|slave| partners(&parents, slave, dl_status[slave]))
            .collect()
    }

    extern crate std;

    #[test]
    fn in_a_chain_everyone_has_the_neighbours_as_partners() {
        let chain = tree(&[&[0, 1], &[0, 1], &[0]]);
        assert_eq!(chain[0], [None, Some(1), None, None]);
        assert_eq!(chain[1], [Some(0), Some(2), None, None]);
        assert_eq!(chain[2], [Some(1), None, None, None]);
    }

    #[test]
    fn branches_are_followed_in_the_order_of_the_ports() {
        // Slave 0 has a branch of two at port 3, one slave at port 1 and one at port 2.
        let star = tree(&[&[0, 1, 2, 3], &[0, 1], &[0], &[0], &[0]]);
        assert_eq!(star[0], [None, Some(3), Some(4), Some(1)]);
        assert_eq!(star[1], [Some(0), Some(2), None, None]);
        assert_eq!(star[2], [Some(1), None, None, None]);
        assert_eq!(star[3], [Some(0), None, None, None]);
        assert_eq!(star[4], [Some(0), None, None, None]);
    }

    #[test]
    fn a_slave_whose_first_port_is_free_is_entered_at_the_next() {
        let chain = tree(&[&[0, 1], &[1, 2], &[0]]);
        assert_eq!(chain[1], [None, Some(0), Some(2), None]);
    }

    #[test]
    fn contradicting_ports_have_no_partner_and_nothing_ends_badly() {
        let short = tree(&[&[0], &[0], &[0]]);
        assert_eq!(short, [[None; PORTS]; 3]);
        let long = tree(&[&[0, 1, 2, 3], &[0]]);
        assert_eq!(long[0], [None, None, None, Some(1)]);
        for status in 0..=u16::MAX {
            let all = [status; 16];
            let parents = parents::<16>(&all);
            for slave in 0..16 {
                for partner in partners(&parents, slave, status).into_iter().flatten() {
                    assert!(usize::from(partner) < 16);
                }
            }
        }
    }

    #[test]
    fn ports_tell_link_loop_and_communication() {
        let ports = ports(status(&[0, 2]));
        assert_eq!(ports.map(|port| port.link), [true, false, true, false]);
        assert_eq!(ports.map(|port| port.loop_closed), [false, true, false, true]);
        assert_eq!(ports.map(|port| port.communicates), [true, false, true, false]);
        assert_eq!(entry(status(&[])), None);
    }
}
