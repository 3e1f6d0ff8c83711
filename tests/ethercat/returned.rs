//! Slaves that return, and what the master read of them before: a wrong reading, or a slave that was elsewhere, keeps no axis
//! from coming back.

use crate::rig::{Rig, rig};
use crate::slave_faults::with_a_spare_drive;
use etherpen::ethercat::supervisor::BusEvent;
use etherpen::robots::AXES;
use host_tools::cell::{AlState, Fault, SiiFault};

/// The drives are in OP and answer.
fn assert_well(rig: &mut Rig<'_>, what: &str) {
    rig.run_ms(20);
    for slave in rig.cell.state().slaves.iter().take(AXES) {
        let state = (slave.al_state, slave.al_status_code);
        assert_eq!(state, (AlState::Operational, 0), "{what}: {:#?}", rig.log);
    }
    assert!(rig.inputs.iter().all(Option::is_some), "{what}: {:#?}", rig.log);
}

/// Acknowledges until all drives are in OP.
fn acknowledge(rig: &mut Rig<'_>) {
    for _ in 0..3 {
        rig.recover();
        rig.run_ms(1_000);
    }
}

#[test]
pub(crate) fn a_memory_that_is_damaged_for_a_moment_of_a_repair_is_read_again_by_the_next() {
    let mut refused = 0;
    for fault in [SiiFault::Damaged, SiiFault::Blank] {
        for at_ms in 60..120 {
            let mut rig = rig("");
            rig.operational();
            rig.run_ms(50);
            rig.cell.inject(Fault::Power(2, 50));
            rig.run_ms(300);
            rig.recover();
            rig.run_ms(at_ms);
            rig.cell.inject(Fault::Sii(2, fault));
            rig.run_ms(1);
            rig.cell.inject(Fault::Sii(2, SiiFault::Whole));
            rig.run_ms(1_500);
            refused += usize::from(rig.log.iter().any(|event| matches!(event, BusEvent::Refused { .. })));
            acknowledge(&mut rig);
            assert_well(&mut rig, &format!("{fault:?} at {at_ms} ms"));
        }
    }
    println!("{refused} repairs refused");
    assert!(refused > 0);
}

#[test]
pub(crate) fn an_extra_drive_takes_no_axis_whose_own_drive_is_back() {
    // The extra one stands before the last drive, and both lose their power together.
    for lasts_ms in [50, 300] {
        let mut rig = with_a_spare_drive();
        rig.run_ms(300);
        rig.cell.inject(Fault::Remove(AXES + 1));
        rig.run_ms(300);
        rig.cell.inject(Fault::Recable(AXES, AXES + 1));
        rig.run_ms(300);
        rig.cell.inject(Fault::Insert(AXES + 1));
        rig.run_ms(500);
        acknowledge(&mut rig);
        for slave in [AXES, AXES + 1] {
            rig.cell.inject(Fault::Power(slave, lasts_ms));
        }
        rig.run_ms(600);
        acknowledge(&mut rig);
        let state = |rig: &Rig<'_>, slave: usize| rig.cell.state().slaves[slave - 1].al_state;
        assert_eq!(state(&rig, AXES + 1), AlState::Operational, "{:#?}", rig.log);
        assert!(state(&rig, AXES) < AlState::SafeOperational, "{:#?}", rig.log);
    }
}
