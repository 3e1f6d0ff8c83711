//! Any bytes as a CoE message, of either side.
#![no_main]

use etherpen::ethercat::wire::coe::{Information, InformationRepr, Sdo};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut room = vec![0; bytes.len() + 16];
    if let Ok(request) = Sdo::parse_request(bytes) {
        let length = request.emit(&mut room).unwrap();
        assert_eq!(Sdo::parse_request(&room[..length]), Ok(request));
    }
    if let Ok(response) = Sdo::parse_response(bytes) {
        let length = response.emit(&mut room).unwrap();
        assert_eq!(Sdo::parse_response(&room[..length]), Ok(response));
    }
    if let Ok(message) = InformationRepr::parse(bytes) {
        let length = message.emit(&mut room).unwrap();
        assert_eq!(InformationRepr::parse(&room[..length]), Ok(message));
        if let Information::Entry(entry) = message.body {
            assert!(entry.name().len() <= entry.data.len());
        }
    }
});
