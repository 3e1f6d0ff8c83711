//! Unsolicited reports of the master: damaged cables and emergencies.

use crate::rig::rig;
use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest};
use etherpen::ethercat::supervisor::BusEvent;
use host_tools::cell::Fault;

#[test]
pub(crate) fn a_damaged_cable_is_reported_with_the_slaves_at_its_ends() {
    let mut rig = rig("");
    rig.operational();
    rig.cell.inject(Fault::Crc(2, 3));
    let waited_ms = rig.wait_for(1_000, |event| matches!(event, BusEvent::CableErrors { .. }));
    println!("reported after {waited_ms} ms: {:?}", rig.log.last());
    let reported = |event: &BusEvent| {
        matches!(
            event,
            BusEvent::CableErrors {
                position: 2,
                partner: Some(1),
                count: 1..=3,
                ..
            }
        )
    };
    let cables = rig
        .log
        .iter()
        .filter(|event| matches!(event, BusEvent::CableErrors { .. }));
    assert!(
        cables.clone().count() > 0 && cables.clone().all(reported),
        "{:#?}",
        rig.log
    );
    assert!(
        !rig.log.iter().any(|event| matches!(event, BusEvent::SlaveLost { .. })),
        "three damaged frames cost three cycles"
    );
}

#[test]
pub(crate) fn an_emergency_is_fetched_reported_and_kept_for_who_asks() {
    const OVERCURRENT: u16 = 0x2310;
    let mut rig = rig("");
    rig.operational();
    rig.cell.inject(Fault::Drive(3, OVERCURRENT));
    let said = |event: &BusEvent| matches!(event, BusEvent::Emergency { position: 2, emergency } if emergency.code == OVERCURRENT);
    let waited_ms = rig.wait_for(1_000, said);
    println!("reported after {waited_ms} ms");
    match rig.ask(ServiceRequest::Slave { slave: 2 }) {
        Ok(ServiceReply::Slave(info)) => assert_eq!(info.emergency.map(|last| last.code), Some(OVERCURRENT)),
        other => panic!("{other:?}"),
    }
}
