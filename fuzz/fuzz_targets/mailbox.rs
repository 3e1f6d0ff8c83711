//! Any bytes as a mailbox.
#![no_main]

use etherpen::ethercat::wire::coe::{Emergency, Sdo, Service};
use etherpen::ethercat::wire::mailbox::{ErrorReply, MailboxRepr, service_data};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(header) = MailboxRepr::parse(bytes) {
        let mut again = [0; 6];
        header.emit(&mut again).unwrap();
        assert_eq!(MailboxRepr::parse(&again), Ok(header));
    }
    let Ok(data) = service_data(bytes) else { return };
    assert!(data.len() + 6 <= bytes.len());
    let _ = (Service::parse(data), ErrorReply::parse(data), Sdo::parse_response(data));
    if let Ok(emergency) = Emergency::parse(data) {
        let mut again = [0; Emergency::LEN];
        emergency.emit(&mut again).unwrap();
        assert_eq!(Emergency::parse(&again), Ok(emergency));
    }
});
