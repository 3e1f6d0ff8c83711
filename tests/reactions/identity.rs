//! Two equal drives with exchanged cables: no motor moves, both places are named, and put back the machine draws.

use crate::STILL_RAD_S;
use crate::liveness::{acknowledge, come_back};
use crate::robot::Robot;
use etherpen::application::{Fault, Mode};
use etherpen::config::Config;
use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest};
use etherpen::ethercat::error::IdentityProperty;
use host_tools::cell::{AlState, CellOptions, Fault as CellFault, PlaceOptions, SlaveKind};
use host_tools::link::text;

/// Number of the first drive; the others follow.
const FIRST: u16 = 31;
/// The exchanged slaves, from 1.
const EXCHANGED: CellFault = CellFault::Recable(2, 3);

const KINDS: [IdentityProperty; 3] = [
    IdentityProperty::Alias,
    IdentityProperty::Switch,
    IdentityProperty::Serial,
];

/// A robot that tells its drives apart in this way.
fn robot(kind: IdentityProperty, clocks: bool, speed_mm_s: f64) -> (Robot, Config) {
    let mut config = Config::default();
    config.bus.clocks = clocks;
    config.motion.speed_mm_s = speed_mm_s;
    let mut places = Vec::new();
    for (number, axis) in (FIRST..).zip(&mut config.axes) {
        // Nothing else tells them apart.
        let mut place = PlaceOptions {
            serial: Some(0),
            ..PlaceOptions::default()
        };
        match kind {
            IdentityProperty::Alias => (place.alias, axis.alias) = (number, number),
            IdentityProperty::Switch => (place.identification, axis.switch) = (Some(number), number),
            _ => (place.serial, axis.serial) = (Some(number.into()), number.into()),
        }
        places.push(place);
    }
    let options = CellOptions {
        places,
        ..CellOptions::default()
    };
    (Robot::of(&config, options), config)
}

/// Asserts that the operator reads both places.
fn assert_both_named(fault: Option<Fault>, kind: IdentityProperty) {
    let Some(
        fault @ Fault::WrongSlave {
            slave,
            property,
            expected,
            found,
            other,
        },
    ) = fault
    else {
        panic!("{fault:?}");
    };
    assert_eq!((slave, other, property), (1, Some(2), kind));
    assert_eq!((expected, found), (u32::from(FIRST) + 1, u32::from(FIRST) + 2));
    let told = text::fault(&fault);
    assert!(told.contains("slave 2 ") && told.contains("slave 3"), "{told}");
}

#[test]
fn drives_with_exchanged_cables_are_refused_before_anything_moves_and_draw_when_they_are_put_back() {
    for kind in KINDS {
        for clocks in [false, true] {
            println!("{kind:?}, clocks {clocks}");
            let (mut robot, config) = robot(kind, clocks, 100.0);
            robot.inject(EXCHANGED);
            robot.run(5);
            let before = robot.cell().joints;
            robot.configure(&config);
            robot.run_until("a fault is told", |robot| robot.mode() == Mode::Fault);
            robot.run(1_000);
            assert_both_named(robot.fault(), kind);
            assert_both_named(acknowledge(&mut robot), kind);
            assert_eq!(robot.cell().joints, before, "a motor has moved");
            robot.inject(EXCHANGED);
            robot.run(100);
            assert_eq!(come_back(&mut robot, 1), 1);
        }
    }
}

#[test]
fn drives_exchanged_while_they_were_off_are_refused_in_the_repair_and_draw_when_they_are_put_back() {
    for kind in KINDS {
        for (clocks, speed_mm_s) in [(false, 50.0), (true, 50.0), (false, 500.0), (true, 500.0)] {
            println!("{kind:?}, clocks {clocks}, {speed_mm_s} mm/s");
            let mut robot = robot(kind, clocks, speed_mm_s).0.enabled().in_a_drawing();
            robot.inject(CellFault::Power(2, 2_000));
            robot.inject(CellFault::Power(3, 2_000));
            robot.run(1_000);
            robot.inject(EXCHANGED);
            robot.run(1_500);
            robot.wait_for(Mode::Fault);
            assert!(robot.speed_rad_s() < STILL_RAD_S);
            let before = robot.cell().joints;
            assert_both_named(acknowledge(&mut robot), kind);
            robot.run(500);
            assert_eq!(robot.cell().joints, before, "a motor has moved");
            robot.inject(EXCHANGED);
            robot.run(700);
            assert_eq!(come_back(&mut robot, 1), 1);
        }
    }
}

#[test]
fn drives_exchanged_under_power_are_refused_by_their_order_and_draw_when_they_are_put_back() {
    for clocks in [false, true] {
        let mut config = Config::default();
        config.bus.clocks = clocks;
        let mut robot = Robot::of(&config, CellOptions::default()).enabled().in_a_drawing();
        robot.inject(CellFault::Cut(1));
        robot.run(500);
        robot.inject(EXCHANGED);
        robot.inject(CellFault::Join);
        robot.run(1_000);
        let before = robot.cell().joints;
        let left = acknowledge(&mut robot);
        assert!(
            matches!(
                left,
                Some(Fault::WrongSlave {
                    slave: 1,
                    property: IdentityProperty::Station,
                    other: Some(2),
                    ..
                })
            ),
            "{left:?}"
        );
        assert_eq!(robot.cell().joints, before, "a motor has moved");
        robot.inject(EXCHANGED);
        robot.run(700);
        assert_eq!(come_back(&mut robot, 1), 1);
    }
}

#[test]
fn the_operator_reads_what_tells_the_drives_apart() {
    for kind in KINDS {
        let mut robot = robot(kind, false, 100.0).0.enabled();
        for slave in 0..4 {
            robot.bus_answers.clear();
            robot.ask(ServiceRequest::Slave { slave });
            robot.run_until("the slave is described", |robot| !robot.bus_answers.is_empty());
            let Ok(ServiceReply::Slave(info)) = &robot.bus_answers[0] else {
                panic!("{:?}", robot.bus_answers);
            };
            let number = FIRST + u16::from(slave);
            match kind {
                IdentityProperty::Alias => assert_eq!(info.alias, number),
                IdentityProperty::Switch => assert_eq!(info.switch, Some(number)),
                _ => assert_eq!(info.identity.serial, u32::from(number)),
            }
        }
        robot.run(100);
        assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None));
        assert_eq!(come_back(&mut robot, 0), 0);
    }
}

#[test]
fn a_drive_that_returned_at_anothers_place_is_known_again_when_it_is_put_back_with_power() {
    for (clocks, apart_ms) in [false, true]
        .into_iter()
        .flat_map(|clocks| [200, 203, 207].map(|ms| (clocks, ms)))
    {
        let mut config = Config::default();
        config.bus.clocks = clocks;
        let mut robot = Robot::of(&config, CellOptions::default()).enabled().in_a_drawing();
        robot.inject(CellFault::Power(2, 500));
        robot.run(apart_ms);
        robot.inject(EXCHANGED);
        robot.run(3_000);
        robot.wait_for(Mode::Fault);
        let slaves = robot.status.as_ref().unwrap().slaves.len();
        assert_eq!(slaves, 4, "it waits for its place, and is no extra one");
        let before = robot.cell().joints;
        let left = acknowledge(&mut robot);
        assert!(left.is_some(), "it is not at its place");
        assert_eq!(robot.cell().joints, before, "a motor has moved");
        robot.inject(EXCHANGED);
        robot.run(500);
        assert_eq!(come_back(&mut robot, 1), 1);
    }
}

/// A robot that knows its four drives by their serial numbers, with the cables of two more drives still open: slaves 5 and 6.
fn with_two_spares(clocks: bool, expects_serials: bool) -> Robot {
    let mut config = Config::default();
    config.bus.clocks = clocks;
    let serials = (u32::from(FIRST)..).take(6);
    let places = serials.clone().map(|serial| PlaceOptions {
        serial: Some(serial),
        ..PlaceOptions::default()
    });
    for (serial, axis) in serials.zip(&mut config.axes).filter(|_| expects_serials) {
        axis.serial = serial;
    }
    let options = CellOptions {
        slaves: vec![SlaveKind::Ax2000; 6],
        places: places.collect(),
        ..CellOptions::default()
    };
    let mut robot = Robot::of(&config, options);
    for spare in [5, 6] {
        robot.inject(CellFault::Remove(spare));
    }
    robot.run(5);
    robot.enabled()
}

/// Puts the slave at `from` to `to`, where nothing is plugged in; without power on the way, or with it. The others are brought
/// back on the way.
fn put(robot: &mut Robot, from: usize, to: usize, with_power: bool) {
    robot.inject(CellFault::Remove(from));
    robot.run(100);
    if !with_power {
        robot.inject(CellFault::Power(from, 300));
        robot.run(10);
    }
    robot.inject(CellFault::Recable(from, to));
    robot.run(700);
    for _ in 0..3 {
        acknowledge(robot);
        robot.run(100);
    }
    robot.inject(CellFault::Insert(to));
    robot.run(1_000);
}

#[test]
fn a_drive_that_got_the_number_of_another_extra_one_takes_no_axis_that_expects_a_serial_number() {
    for (clocks, comes_with_power) in [(false, false), (false, true), (true, false), (true, true)] {
        let mut robot = with_two_spares(clocks, true);
        robot.inject(CellFault::Remove(2));
        robot.run(1_000);
        robot.wait_for(Mode::Fault);
        // The drive of the second axis comes back at the end of the chain, and is an extra one there.
        put(&mut robot, 2, 5, false);
        assert_eq!(robot.status.as_ref().unwrap().slaves.len(), 5, "an extra one");
        robot.inject(CellFault::Remove(5));
        robot.run(500);
        // Another one gets its number, and comes to the axis with power.
        robot.inject(CellFault::Insert(6));
        robot.run(1_000);
        put(&mut robot, 6, 2, true);
        let before = robot.cell().joints;
        for _ in 0..3 {
            let named = Fault::WrongSlave {
                slave: 1,
                property: IdentityProperty::Serial,
                expected: u32::from(FIRST) + 1,
                found: u32::from(FIRST) + 5,
                other: None,
            };
            assert_eq!(acknowledge(&mut robot), Some(named), "clocks {clocks}: it was expected");
            assert_ne!(robot.cell().slaves[1].al_state, AlState::Operational);
        }
        assert_eq!(robot.cell().joints, before, "a motor has moved");
        // Back at its place, the right one may still have that number too.
        robot.inject(CellFault::Remove(2));
        put(&mut robot, 5, 2, comes_with_power);
        come_back(&mut robot, 2);
    }
}

#[test]
fn a_drive_that_was_repaired_takes_its_axis_again_after_a_spare_one() {
    for (clocks, comes_with_power) in [(false, false), (false, true), (true, false), (true, true)] {
        let mut robot = with_two_spares(clocks, false);
        robot.inject(CellFault::Remove(2));
        robot.run(1_000);
        robot.wait_for(Mode::Fault);
        // The drive of the second axis visits the end of the chain, and works at its place again.
        put(&mut robot, 2, 5, false);
        put(&mut robot, 5, 2, comes_with_power);
        come_back(&mut robot, 2);
        // It fails, a spare one takes its place, and it comes back repaired.
        for spare in [6, 6] {
            robot.inject(CellFault::Remove(2));
            robot.run(1_000);
            robot.wait_for(Mode::Fault);
            put(&mut robot, spare, 2, false);
            let left = acknowledge(&mut robot);
            assert_eq!(left, None, "with power {comes_with_power}, clocks {clocks}");
            assert_eq!(robot.cell().slaves[1].al_state, AlState::Operational);
        }
        come_back(&mut robot, 2);
    }
}

#[test]
fn a_spare_drive_beside_an_axis_keeps_it_from_nothing() {
    for (clocks, expects_serials) in [(false, false), (false, true), (true, false), (true, true)] {
        let mut robot = with_two_spares(clocks, expects_serials);
        // The spare one between the second and the third axis: the chain is longer by one there.
        for (one, other) in [(5, 4), (4, 3)] {
            robot.inject(CellFault::Remove(one.max(other)));
            robot.inject(CellFault::Recable(one, other));
        }
        robot.run(700);
        for place in [3, 4, 5] {
            robot.inject(CellFault::Insert(place));
        }
        robot.run(1_000);
        come_back(&mut robot, 3);
        let slaves = robot.status.as_ref().unwrap().slaves.len();
        assert_eq!(slaves, 5, "the spare one is known");
        robot.inject(CellFault::Power(2, 300));
        robot.run(1_000);
        robot.wait_for(Mode::Fault);
        come_back(&mut robot, 2);
    }
}
