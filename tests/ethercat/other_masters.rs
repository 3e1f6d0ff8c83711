//! Slaves that come from another master with power: its addresses, mappings, closed ports.

use crate::odd_controllers::{
    Bench, DEFAULT, Member, NOTICED_MS, PAIRS, STALE_MANAGER, fmmu, options, overlap, setup, share, stale_fmmu,
    sync_manager,
};
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::ethercat::slave_set::SlaveSet;
use etherpen::ethercat::supervisor::BusEvent;
use etherpen_segment::random::Random;
use etherpen_segment::{AlState, Fault, Product, SlaveKind};

/// What another master sets in a slave: ports closed, from 0x0101; the alias that is another slave's address; its own address.
#[derive(Clone, Copy, Debug)]
struct Left {
    ports: u8,
    alias: u16,
    station: u16,
}

#[test]
pub(crate) fn a_slave_that_is_plugged_in_with_power_loses_what_another_master_has_left_in_it() {
    /// The second port stays closed: no frame gets behind the slave.
    const PORT_1_CLOSED: u8 = 0x0C;
    for seed in 0..48_u64 {
        let mut random = Random::new(seed);
        let mut chain = vec![
            Member::coupler(),
            Member::of_bytes(1, 2, true),
            Member::of_bytes(2, 2, true),
            Member::new(SlaveKind::El2004, 0, 4),
            Member::of_bytes(3, 1, true),
        ];
        let plugged = 1 + (random.bits() % 4) as usize;
        let other = (plugged + 1 + (random.bits() % 3) as usize) % 5;
        // Repairs of a long chain take longer than a disturbed exchange is looked on at.
        let couplers = [0, 11][(seed / 12 % 2) as usize];
        chain.extend((0..couplers).map(|_| Member::coupler()));
        let left = Left {
            ports: [0, PORT_1_CLOSED][(seed % 2) as usize],
            alias: [0, 0x1001 + other as u16][(seed / 2 % 2) as usize],
            station: [0x2001, 0x1001 + plugged as u16, 0x1001 + other as u16][(seed / 4 % 3) as usize],
        };
        // A slave that nobody uses may have been with another master too.
        let is_used = seed / 24 % 2 == 0;
        let used = |place: &usize| is_used || *place != plugged;
        let kind = [ExchangeKind::Split, ExchangeKind::Combined][(random.bits() % 2) as usize];
        let what = format!(
            "seed {seed}, {left:x?} in slave {plugged} of {}, used {is_used}, mapping of {other}, {kind:?}",
            chain.len()
        );
        let mut options = options(&chain);
        // The controller takes its alias from its memory, and uses it when a master says so.
        options.places[plugged].alias = left.alias;
        let terminals = (0..chain.len()).filter(used).collect();
        let mut bench = Bench::start(&options, setup(kind, terminals));
        bench.operational();
        let place = plugged as u16;
        for unit in 0..3 {
            bench.write_as_another(place, fmmu(unit), &stale_fmmu(other, 0x1000, unit % 2 == 0));
            bench.write_as_another(place, sync_manager(unit + 1), &STALE_MANAGER);
        }
        bench.write_as_another(place, 0x0103, &[u8::from(left.alias != 0)]);
        bench.write_as_another(place, 0x0010, &left.station.to_le_bytes());
        bench.write_as_another(place, 0x0101, &[left.ports]);
        bench.plug_again(plugged + 1);
        assert_eq!(bench.registers(place, 0x0101, 1), [0], "ports, {what}");
        assert_eq!(bench.registers(place, 0x0103, 1), [0], "use of the alias, {what}");
        let station = (0x1001 + place).to_le_bytes();
        assert_eq!(bench.registers(place, 0x0010, 2), station, "address, {what}");
        for slave in (0..chain.len()).filter(used) {
            let state = bench.al_state(slave);
            assert_eq!(state, AlState::Operational, "slave {slave}, {what}: {:#?}", bench.log);
        }
        for unit in 0..3 {
            let mapping = bench.registers(place, fmmu(unit), 16);
            let logical = u32::from_le_bytes([mapping[0], mapping[1], mapping[2], mapping[3]]);
            let is_own = mapping[12] == 0 || overlap((logical, 1), share(plugged));
            assert!(is_own, "FMMU {unit} {mapping:x?}, {what}");
            let manager = bench.registers(place, sync_manager(unit + 1), 7);
            assert!(
                !is_used || manager != STALE_MANAGER[..7],
                "sync manager {}, {what}",
                unit + 1
            );
        }
        let members: Vec<(usize, &Member)> = chain.iter().enumerate().filter(|(place, _)| used(place)).collect();
        bench.assert_exchanges(&members, &mut random, &what);
    }
}

#[test]
pub(crate) fn another_product_that_has_the_address_of_a_lost_slave_is_refused_until_the_right_one_is_back() {
    let products = [
        (Product::Cia402, SlaveKind::Cia402),
        (Product::Ax2000, SlaveKind::Ax2000),
        (Product::Ek1100, SlaveKind::Ek1100),
    ];
    for seed in 0..24_u64 {
        let mut random = Random::new(seed);
        let mut chain = vec![Member::of_bytes(1, 2, true), Member::of_bytes(2, 1, true)];
        let place = (random.bits() % 3) as usize;
        let (right, kind) = products[(seed % 3) as usize].clone();
        let (wrong, _) = products[((seed + 1 + random.bits() % 2) % 3) as usize];
        chain.insert(place, Member::new(kind, 0, 0));
        let what = format!("seed {seed}, {wrong:?} for {right:?} at {place}");
        let mut bench = Bench::start(&options(&chain), setup(ExchangeKind::Split, SlaveSet::ALL));
        bench.operational();
        let others: Vec<(usize, &Member)> = chain.iter().enumerate().filter(|(other, _)| *other != place).collect();
        bench.segment.inject(Fault::Remove(place + 1));
        bench.run_ms(NOTICED_MS);
        bench.segment.inject(Fault::Swap(place + 1, wrong));
        bench.segment.inject(Fault::Insert(place + 1));
        // As masters give addresses too: from 0x1001 on.
        let station = (0x1001 + place as u16).to_le_bytes();
        bench.write_as_another(place as u16, 0x0010, &station);
        bench.run_ms(NOTICED_MS);
        let from = bench.log.len();
        bench.recover();
        let position = place as u8;
        let is_refusal =
            |event: &BusEvent| matches!(event, BusEvent::TerminalRefused { position: there, .. } if *there == position);
        assert!(bench.log[from..].iter().any(is_refusal), "{what}: {:#?}", bench.log);
        assert_ne!(bench.al_state(place), AlState::Operational, "{what}");
        bench.assert_exchanges(&others, &mut random, &what);
        bench.segment.inject(Fault::Swap(place + 1, right));
        bench.run_ms(NOTICED_MS);
        bench.recover();
        for slave in 0..chain.len() {
            assert_eq!(bench.al_state(slave), AlState::Operational, "{what}: {:#?}", bench.log);
        }
        bench.assert_exchanges(&others, &mut random, &what);
    }
}

#[test]
pub(crate) fn the_address_of_a_lost_slave_at_another_place_is_taken_away_and_the_right_one_comes_back() {
    let mut addressed = 0;
    for seed in 0..24_u64 {
        let mut random = Random::new(seed);
        let mut chain = vec![Member::of_bytes(1, 2, true), Member::of_bytes(2, 1, true)];
        let lost = (random.bits() % 3) as usize;
        chain.insert(lost, Member::new(SlaveKind::Cia402, 0, 0));
        // An unused slave, anywhere else in the chain.
        let stranger = [lost + 1, 0, 3][(random.bits() % 3) as usize].min(3);
        let lost = lost + usize::from(stranger <= lost);
        chain.insert(stranger, Member::new(SlaveKind::Ax2000, 0, 0));
        let what = format!("seed {seed}, the address of {lost} in {stranger}");
        let used = |place: &usize| *place != stranger;
        let mut bench = Bench::start(
            &options(&chain),
            setup(ExchangeKind::Split, (0..4).filter(used).collect()),
        );
        bench.operational();
        bench.segment.inject(Fault::Power(lost + 1, 2 * NOTICED_MS));
        bench.segment.inject(Fault::Remove(stranger + 1));
        bench.run_ms(NOTICED_MS);
        bench.segment.inject(Fault::Insert(stranger + 1));
        bench.run_ms(1);
        // Behind the slave without power there is none.
        if bench.segment.slaves()[stranger].reached {
            addressed += 1;
            let station = (0x1001 + lost as u16).to_le_bytes();
            bench.write_as_another(stranger as u16, 0x0010, &station);
        }
        bench.run_ms(3 * NOTICED_MS);
        for _ in 0..2 {
            bench.recover();
        }
        for slave in (0..4).filter(used) {
            let state = bench.al_state(slave);
            assert_eq!(state, AlState::Operational, "slave {slave}, {what}: {:#?}", bench.log);
        }
        let members: Vec<(usize, &Member)> = chain.iter().enumerate().filter(|(place, _)| used(place)).collect();
        bench.assert_exchanges(&members, &mut random, &what);
    }
    assert!(addressed > 5, "{addressed}");
}

#[test]
pub(crate) fn an_equal_device_with_the_address_of_a_lost_one_is_configured_anew() {
    for (place, is_in_share) in [(0, true), (1, true), (2, true), (1, false)] {
        let mut random = Random::new(place as u64);
        let mut chain = vec![Member::of_bytes(1, 2, true), Member::of_bytes(2, 1, true)];
        chain.insert(place, Member::new(SlaveKind::Cia402, 0, 0));
        let what = format!("at {place}, mapping {is_in_share}");
        let mut bench = Bench::start(&options(&chain), setup(ExchangeKind::Split, SlaveSet::ALL));
        bench.operational();
        bench.segment.inject(Fault::Remove(place + 1));
        bench.run_ms(NOTICED_MS);
        bench.segment.inject(Fault::Swap(place + 1, Product::Cia402));
        bench.segment.inject(Fault::Insert(place + 1));
        let position = place as u16;
        bench.write_as_another(position, 0x0010, &(0x1001 + position).to_le_bytes());
        if is_in_share {
            // What the same master has set up for another machine.
            bench.write_as_another(position, fmmu(5), &stale_fmmu(place, 0x1000, true));
        }
        bench.run_ms(NOTICED_MS);
        bench.recover();
        for slave in 0..chain.len() {
            assert_eq!(bench.al_state(slave), AlState::Operational, "{what}: {:#?}", bench.log);
        }
        assert_eq!(bench.registers(position, fmmu(5), 16), [0; 16], "{what}");
        let others: Vec<(usize, &Member)> = chain.iter().enumerate().filter(|(other, _)| *other != place).collect();
        bench.assert_exchanges(&others, &mut random, &what);
    }
}

#[test]
pub(crate) fn all_units_of_a_slave_that_comes_with_the_address_of_another_are_cleared() {
    for seed in 0..32_u64 {
        let mut random = Random::new(seed);
        // One controller with eight units, in blocks or in pairs, and one with three, in either order.
        let large = Member::new(SlaveKind::Cia402, 0, 0).with([DEFAULT, PAIRS][(seed % 2) as usize]);
        let mut chain = vec![
            Member::coupler(),
            Member::of_bytes(2, 2, true),
            Member::of_bytes(1, 1, true),
            Member::new(SlaveKind::El2004, 0, 4),
        ];
        let plugged = (random.bits() % 5) as usize;
        chain.insert(plugged, large);
        let other = (plugged + 1 + (random.bits() % 4) as usize) % 5;
        let is_used = seed / 2 % 2 == 0;
        let used = |place: &usize| is_used || *place != plugged;
        let what = format!("seed {seed}, slave {plugged} with the address of {other}, used {is_used}");
        let mut bench = Bench::start(
            &options(&chain),
            setup(ExchangeKind::Split, (0..5).filter(used).collect()),
        );
        bench.operational();
        let place = plugged as u16;
        for unit in 0..8 {
            bench.write_as_another(place, fmmu(unit), &stale_fmmu(other, 0x1000, unit % 2 == 0));
        }
        bench.write_as_another(place, 0x0010, &(0x1001 + other as u16).to_le_bytes());
        bench.plug_again(plugged + 1);
        for unit in 0..8 {
            let mapping = bench.registers(place, fmmu(unit), 16);
            let logical = u32::from_le_bytes([mapping[0], mapping[1], mapping[2], mapping[3]]);
            let is_own = mapping[12] == 0 || overlap((logical, 1), share(plugged));
            assert!(is_own, "FMMU {unit} {mapping:x?}, {what}");
        }
        for slave in (0..5).filter(used) {
            let state = bench.al_state(slave);
            assert_eq!(state, AlState::Operational, "slave {slave}, {what}: {:#?}", bench.log);
        }
        let members: Vec<(usize, &Member)> = chain.iter().enumerate().filter(|(place, _)| used(place)).collect();
        bench.assert_exchanges(&members, &mut random, &what);
    }
}
