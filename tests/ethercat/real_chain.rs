//! The robot's drives among eight slaves with the information memories of real devices.
//!
//! Couplers, terminals, servo drives of another maker, a blank memory and a damaged one, in any order. The memories are
//! built from [`device_images`](crate::device_images); with `ETHERPEN_REAL_DEVICES`, a folder with ethercrab's
//! `dumps/eeprom`, the dumps themselves take part too.

use crate::device_images::{Description, eight};
use crate::rig::{Rig, idle_rig_of};
use etherpen::control::robot_axes::Demand;
use etherpen::drives::CONTROL_WORD;
use etherpen::drives::cia402::{DriveState, DriveTarget};
use etherpen::ethercat::diagnostics::{ServiceError, ServiceReply, ServiceRequest, SlaveInfo};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::state::{AlReport, AlState};
use etherpen::ethercat::supervisor::BusEvent;
use etherpen::ethercat::wire::sii::{FixedPart, Identity, Sii};
use etherpen::robots::AXES;
use etherpen_segment::random::Random;
use host_tools::cell::{self, CellOptions, SlaveKind};
use std::io::Write as _;
use std::path::PathBuf;

/// Longest bring-up, ms.
const BRING_UP_MS_MAX: u64 = 5_000;
/// Axes as the rig counts them.
const ALL_AXES: [usize; AXES] = [0, 1, 2, 3];

/// A slave of the chain: its place in [`eight`] and its memory; `None` for a drive of the robot.
type Place = Option<(usize, Vec<u8>)>;

/// The memories of the eight dumps; prints a note and returns `None` if there are none.
fn dumps(test: &str) -> Option<Vec<Vec<u8>>> {
    let Some(folder) = std::env::var_os("ETHERPEN_REAL_DEVICES").map(PathBuf::from) else {
        // Not `eprintln!`: the test harness shows its output only for failing tests.
        let _ = writeln!(
            std::io::stderr(),
            "ETHERPEN_REAL_DEVICES is not set: {test} is left out"
        );
        return None;
    };
    let read = |device: &Description| {
        let path = folder.join(device.file);
        std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    };
    Some(eight().iter().map(read).collect())
}

fn described() -> Vec<Vec<u8>> {
    eight().iter().map(Description::image).collect()
}

/// Puts the slaves into a random order, the robot's drives in front of other drives: the first drives are the axes.
fn chain(images: &[Vec<u8>], seed: u64) -> Vec<Place> {
    let mut random = Random::new(seed);
    let mut chain: Vec<Place> = images.iter().cloned().enumerate().map(Some).collect();
    chain.extend((0..AXES).map(|_| None));
    for at in (1..chain.len()).rev() {
        chain.swap(at, (random.bits() % (at as u64 + 1)) as usize);
    }
    let is_drive = |place: &Place| match place {
        Some((_, image)) => identity(image).product == 0x0041_4B44,
        None => true,
    };
    let places: Vec<usize> = (0..chain.len()).filter(|at| is_drive(&chain[*at])).collect();
    let mut drives: Vec<Place> = places.iter().map(|at| chain[*at].take()).collect();
    drives.sort_by_key(Option::is_some);
    for (at, drive) in places.into_iter().zip(drives) {
        chain[at] = drive;
    }
    chain
}

fn identity(image: &[u8]) -> Identity {
    FixedPart::parse(image).expect("a fixed part").identity
}

/// A rig with this chain whose bus was brought up.
fn brought_up(chain: &[Place]) -> Rig<'static> {
    let kind = |place: &Place| match place {
        Some((_, image)) => SlaveKind::Sii(image.clone().into()),
        None => SlaveKind::Ax2000,
    };
    let mut rig = idle_rig_of(CellOptions {
        slaves: chain.iter().map(kind).collect(),
        ..CellOptions::default()
    });
    rig.start();
    let took_ms = rig.wait_for(BRING_UP_MS_MAX, |event| *event == BusEvent::Operational);
    println!("OP after {took_ms} ms");
    rig.run_ms(20);
    rig
}

fn info(rig: &mut Rig<'_>, slave: usize) -> SlaveInfo {
    match rig.ask_while(ServiceRequest::Slave { slave: slave as u8 }, &ALL_AXES) {
        Ok(ServiceReply::Slave(info)) => info,
        other => panic!("slave {slave}: {other:?}"),
    }
}

fn al_state(rig: &Rig<'_>, slave: usize) -> cell::AlState {
    rig.cell.state().slaves[slave].al_state
}

/// The drives are in OP, turn as told, and every slave is named as its memory says.
fn drives_operate(chain: &[Place]) {
    let mut rig = brought_up(chain);
    let names: Vec<String> = (0..chain.len())
        .map(|slave| {
            let info = info(&mut rig, slave);
            let Some((_, image)) = &chain[slave] else {
                assert_eq!(al_state(&rig, slave), cell::AlState::Operational, "slave {slave}");
                assert_eq!(info.driver, "AX2000-B110", "slave {slave}");
                return String::new();
            };
            let sii = Sii::new_checked(image).expect("an image");
            let name = sii.general().map(|general| sii.strings().text(general.name));
            assert_eq!(info.identity, identity(image), "slave {slave}");
            assert_eq!(info.member, None, "slave {slave}");
            if let Some(name) = name {
                assert_eq!(info.name.as_str(), name, "slave {slave}");
            }
            info.name.to_string()
        })
        .collect();
    println!("{names:?}");
    let members: Vec<_> = (0..chain.len())
        .filter_map(|slave| info(&mut rig, slave).member)
        .collect();
    assert_eq!(members, [0, 1, 2, 3]);
    rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
    let before = rig.cell.state().joints.0;
    rig.command.demand = Demand::Velocity(0.5);
    rig.run_ms(200);
    for (axis, (now_rad, then_rad)) in rig.cell.state().joints.0.iter().zip(before).enumerate() {
        assert!(
            (now_rad - then_rad - 0.1).abs() < 5e-3,
            "axis {axis}: {then_rad} to {now_rad}"
        );
    }
    let counters = rig.counters();
    assert_eq!((counters.frames_lost, counters.working_counter_errors), (0, 0));
    let refused = rig.log.iter().find(|event| match event {
        BusEvent::Refused { position, .. } => position.is_none_or(|place| chain[usize::from(place)].is_none()),
        BusEvent::SlaveLost { .. } | BusEvent::SlaveLeft { .. } => true,
        _ => false,
    });
    assert_eq!(refused, None);
}

/// What comes of the request to bring each of [`eight`] to OP.
fn outcomes(chain: &[Place]) -> Vec<(usize, Result<ServiceReply, ServiceError>, cell::AlState)> {
    let mut rig = brought_up(chain);
    let mut found = Vec::new();
    for (slave, place) in chain.iter().enumerate() {
        let Some((number, _)) = place else { continue };
        let request = ServiceRequest::SetState {
            slave: slave as u8,
            state: AlState::Operational,
        };
        let answer = rig.ask_while(request, &ALL_AXES);
        // Longer than any watchdog.
        rig.run_ms(200);
        found.push((*number, answer, al_state(&rig, slave)));
    }
    found.sort_by_key(|(number, ..)| *number);
    assert!(rig.inputs.iter().all(Option::is_some));
    found
}

/// Every device comes to OP but the one whose categories run past the memory's end: it lists no process data, and the
/// answer names the object that a drive needs.
fn every_image_comes_as_far_as_it_can(images: &[Vec<u8>]) {
    let operational = Ok(ServiceReply::State(AlReport { status: 8, code: 0 }));
    let without_process_data = Err(ServiceError::Bus(BusError::Mapping {
        object: CONTROL_WORD,
        expected: 16,
        actual: 0,
    }));
    for seed in 1..=2 {
        println!("seed {seed}");
        for (number, answer, state) in outcomes(&chain(images, seed)) {
            let file = eight()[number].file;
            let (expected, there) = match file {
                "akd_null_strings.hex" => (&without_process_data, cell::AlState::PreOperational),
                _ => (&operational, cell::AlState::Operational),
            };
            assert_eq!((&answer, state), (expected, there), "{file}");
        }
    }
}

#[test]
pub(crate) fn the_robots_drives_operate_among_eight_other_devices_in_any_order() {
    for seed in 1..=6 {
        println!("seed {seed}");
        drives_operate(&chain(&described(), seed));
    }
}

#[test]
pub(crate) fn the_robots_drives_operate_among_eight_real_memories_in_any_order() {
    let Some(images) = dumps("the chain of eight real memories") else {
        return;
    };
    for seed in 1..=6 {
        println!("seed {seed}");
        drives_operate(&chain(&images, seed));
    }
}

/// Memories with wrong bytes in mailboxes and categories; identities and protocols stay.
fn damaged(images: Vec<Vec<u8>>, random: &mut Random) -> Vec<Vec<u8>> {
    let damage = |mut image: Vec<u8>| {
        for _ in 0..random.bits() % 30 {
            let at = match random.bits() % 4 {
                0 => 0x28 + random.bits() % 16,
                _ => 0x80 + random.bits() % 0x200,
            };
            if let Some(byte) = image.get_mut(at as usize) {
                *byte = random.bits() as u8;
            }
        }
        image
    };
    images.into_iter().map(damage).collect()
}

#[test]
pub(crate) fn no_damaged_memory_of_an_unused_slave_keeps_the_drives_from_operating() {
    let mut random = Random::new(21);
    for seed in 1..=12 {
        println!("seed {seed}");
        let images = damaged(described(), &mut random);
        let chain = chain(&images, seed);
        let mut rig = brought_up(&chain);
        // Somebody asks for each of them, too.
        for slave in (0..chain.len()).filter(|slave| chain[*slave].is_some()) {
            let state = [AlState::PreOperational, AlState::Operational][slave % 2];
            let slave = slave as u8;
            // Whatever the answer is, it comes, and costs no drive an input.
            let _ = rig.ask_while(ServiceRequest::SetState { slave, state }, &ALL_AXES);
        }
        assert!(rig.inputs.iter().all(Option::is_some), "{:#?}", rig.log);
    }
}

#[test]
pub(crate) fn what_can_come_up_comes_up_while_the_drives_run() {
    every_image_comes_as_far_as_it_can(&described());
}

#[test]
pub(crate) fn what_can_come_up_of_eight_real_memories_comes_up_while_the_drives_run() {
    if let Some(images) = dumps("the states of eight real memories") {
        every_image_comes_as_far_as_it_can(&images);
    }
}

/// PDOs as index, sync manager, flags and entries.
type Pdos = Vec<(u16, u8, u16, Vec<(u16, u8, u8)>)>;

fn pdos(image: &[u8]) -> Pdos {
    let sii = Sii::new_checked(image).expect("an image");
    let list = sii.rx_pdos().chain(sii.tx_pdos()).flatten().map(|pdo| {
        let entries = pdo.entries().map(|entry| (entry.index, entry.sub, entry.bits));
        let record = pdo.record;
        (record.index, record.sync_manager, record.flags, entries.collect())
    });
    list.collect()
}

#[test]
pub(crate) fn the_descriptions_say_what_the_dumps_hold() {
    let Some(dumps) = dumps("the comparison of descriptions with dumps") else {
        return;
    };
    for (device, dump) in eight().iter().zip(&dumps) {
        let (image, file) = (device.image(), device.file);
        assert_eq!(image[..0x10], dump[..0x10], "{file}: configuration and checksum");
        assert_eq!(identity(&image), identity(dump), "{file}");
        assert_eq!(image[0x28..0x3A], dump[0x28..0x3A], "{file}: mailboxes");
        assert_eq!(image[0x7C..0x80], dump[0x7C..0x80], "{file}: size");
        let (ours, theirs) = (Sii::new_checked(&image).unwrap(), Sii::new_checked(dump).unwrap());
        let kinds =
            |sii: &Sii<'_>| -> Vec<u16> { sii.categories().map(|(category, _)| category.kind).take(64).collect() };
        assert_eq!(kinds(&ours), kinds(&theirs), "{file}");
        assert_eq!(
            ours.sync_managers().collect::<Vec<_>>(),
            theirs.sync_managers().collect::<Vec<_>>(),
            "{file}"
        );
        assert!(ours.fmmus().eq(theirs.fmmus()), "{file}");
        let general = |sii: &Sii<'_>| {
            sii.general().map(|general| {
                (
                    (general.coe, general.foe, general.eoe, general.flags),
                    (general.ports, general.current_ma),
                )
            })
        };
        assert_eq!(general(&ours), general(&theirs), "{file}");
        let assigns = |sii: &Sii<'_>| sii.clocks().map(|clock| clock.assign_activate).collect::<Vec<_>>();
        assert_eq!(assigns(&ours), assigns(&theirs), "{file}");
        let theirs = pdos(dump);
        for pdo in pdos(&image) {
            assert!(theirs.contains(&pdo), "{file}: {pdo:x?}");
        }
        let assigned = |list: &Pdos| list.iter().filter(|(_, manager, ..)| *manager != 0xFF).count();
        assert_eq!(assigned(&pdos(&image)), assigned(&theirs), "{file}");
    }
}
