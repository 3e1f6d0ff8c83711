//! Scripted damage to the bytes of a reply.

use crate::controller::datagram::{Datagram, Datagrams, set_frame_header};
use crate::faults::kinds::Fault;

/// Tag of a virtual network, between source address and EtherType: priority 0, network 1.
const VLAN_TAG: [u8; 4] = [0x81, 0x00, 0x00, 0x01];
const VLAN_OFFSET: usize = 12;

/// Changes header and datagrams in place.
pub(crate) fn change(reply: &mut [u8], fault: Fault) {
    match fault {
        Fault::Index(by) => each(reply, |datagram, _| datagram.change_index(by)),
        Fault::Counter(by) => each(reply, |datagram, _| datagram.count(by as u16)),
        Fault::Circulate => each(reply, |datagram, _| datagram.set_circulating()),
        Fault::More => each(reply, |datagram, last| {
            if last {
                datagram.set_more();
            }
        }),
        Fault::Type(kind) => set_frame_header(reply, |length, _| (length, kind)),
        _ => {}
    }
}

/// Changes length and envelope; the last step.
pub(crate) fn envelop(reply: &mut Vec<u8>, faults: &[Fault]) {
    for fault in faults {
        match *fault {
            Fault::Overlong(bytes) => {
                reply.resize(reply.len() + usize::from(bytes), 0xA5);
                set_frame_header(reply, |length, kind| (length.saturating_add(bytes), kind));
            }
            Fault::Vlan if reply.len() >= VLAN_OFFSET => {
                reply.splice(VLAN_OFFSET..VLAN_OFFSET, VLAN_TAG);
            }
            _ => {}
        }
    }
    for fault in faults {
        if let Fault::Truncate(length) = fault {
            reply.truncate(*length);
        }
    }
}

fn each(frame: &mut [u8], mut change: impl FnMut(&mut Datagram, bool)) {
    if let Some(mut datagrams) = Datagrams::of_frame(frame) {
        while let Some(mut datagram) = datagrams.next() {
            let last = !datagram.has_more();
            change(&mut datagram, last);
        }
    }
}
