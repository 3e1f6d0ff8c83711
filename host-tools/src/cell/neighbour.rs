//! The neighbour of the board in its network: the host that leads to the segment, or the gateway before it.
//!
//! EtherCAT in UDP needs the Ethernet address of its next hop. The segment itself answers no ARP, so a virtual one stands
//! behind a neighbour, as behind the router or the first slave of a real one. Frames of faults do not hit its answers.

use etherpen::config::Config;
use std::net::Ipv4Addr;

/// Its Ethernet address.
const ADDRESS: [u8; 6] = [0x02, 0, 0, 0, 0, 0x02];
/// Bytes of an ARP packet for IPv4 in an Ethernet frame, and of the shortest frame.
const ARP_BYTES: usize = 42;
const FRAME_BYTES_MIN: usize = 60;
/// EtherType of ARP; then Ethernet, IPv4, the lengths of their addresses, and a request.
const REQUEST: [u8; 10] = [0x08, 0x06, 0, 1, 0x08, 0, 6, 4, 0, 1];
const REPLY: u8 = 2;

/// The neighbour.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbour {
    segment: Ipv4Addr,
    gateway: Option<Ipv4Addr>,
}

impl Neighbour {
    /// The neighbour that a configuration needs; `None` for EtherCAT without UDP.
    pub(super) fn new(config: &Config) -> Option<Self> {
        config.bus.network().map(|network| Self {
            segment: network.segment,
            gateway: network.gateway,
        })
    }

    /// The answer to a request for the Ethernet address of the segment or of the gateway; `None` for any other frame.
    pub(super) fn answer(self, frame: &[u8]) -> Option<Vec<u8>> {
        let request = frame.first_chunk::<ARP_BYTES>()?;
        let (asker, asked) = (&request[22..32], &request[38..42]);
        let own = [Some(self.segment), self.gateway];
        let is_own = own.iter().flatten().any(|address| address.octets() == *asked);
        if request[12..22] != REQUEST || !is_own {
            return None;
        }
        let mut reply = Vec::with_capacity(FRAME_BYTES_MIN);
        reply.extend(&request[6..12]);
        reply.extend(ADDRESS);
        reply.extend(&REQUEST[..9]);
        reply.push(REPLY);
        reply.extend(ADDRESS);
        reply.extend(asked);
        reply.extend(asker);
        reply.resize(FRAME_BYTES_MIN, 0);
        Some(reply)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::config::Transport;

    #[test]
    fn it_answers_for_the_segment_and_the_gateway_and_for_nobody_else() {
        let mut config = Config::default();
        assert!(Neighbour::new(&config).is_none());
        config.bus.transport = Transport::Udp;
        config.bus.segment = Ipv4Addr::new(192, 168, 7, 9);
        config.bus.gateway = Ipv4Addr::new(10, 0, 2, 1);
        let neighbour = Neighbour::new(&config).expect("in UDP");
        let mut request = vec![0xFF; 6];
        request.extend([0x10, 0, 0, 0, 0, 1]);
        request.extend(REQUEST);
        request.extend([0x10, 0, 0, 0, 0, 1, 10, 0, 2, 15, 0, 0, 0, 0, 0, 0]);
        let asked = |address: [u8; 4]| [request.as_slice(), &address].concat();
        for address in [[192, 168, 7, 9], [10, 0, 2, 1]] {
            let reply = neighbour.answer(&asked(address)).expect("an answer");
            assert_eq!((reply.len(), &reply[..6]), (60, &[0x10, 0, 0, 0, 0, 1][..]));
            assert_eq!(reply[20..22], [0, 2]);
            assert_eq!((&reply[22..28], &reply[28..32]), (&ADDRESS[..], &address[..]));
            assert_eq!(reply[32..42], request[22..32]);
        }
        assert_eq!(neighbour.answer(&asked([10, 0, 2, 3])), None);
        assert_eq!(neighbour.answer(&asked([192, 168, 7, 9])[..41]), None);
        let mut answered = asked([192, 168, 7, 9]);
        answered[21] = REPLY;
        assert_eq!(neighbour.answer(&answered), None);
    }
}
