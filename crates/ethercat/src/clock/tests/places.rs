//! Measurements of a chain whose cables or slaves have changed.

use super::*;

#[test]
fn after_a_change_of_the_chain_its_cables_are_measured_anew_once() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
    let mut clocks = chain.set_up();
    clocks.chain_changed();
    for measurements in [1, 0] {
        chain.log.clear();
        chain
            .run(async |mut port: AcyclicPort<'static, 64>| {
                tell_delays(&mut port, &STATIONS, &mut clocks, |_| Presence::Used).await
            })
            .expect("the delays");
        assert_eq!(chain.log.matches("Bwr:0900").count(), measurements);
        assert!(!chain.log.contains("Fpwr"), "no cable has changed: {}", chain.log);
    }
}

#[test]
fn a_stranger_at_a_junction_changes_no_delay_of_the_others() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
    chain.is_junction = true;
    let delays = |clocks: &BusClocks<16>| clocks.slaves.iter().map(|slave| slave.delay_ns).collect::<StdVec<_>>();
    let all = delays(&chain.set_up());
    assert_eq!(all, [0, 1, 3, 4].map(|hops| hops * HOP_NS as u32));
    let known = [STATIONS[0], STATIONS[2], STATIONS[3]];
    let clocks: BusClocks<16> = chain
        .run(async |mut port: AcyclicPort<'static, 64>| {
            let mut clocks = discover(&mut port, &known, |_| true).await?;
            measure(&mut port, &known, &mut clocks, |_| Presence::Used).await?;
            Ok::<_, BusError>(clocks)
        })
        .expect("the measurement");
    assert_eq!(delays(&clocks), [all[0], all[2], all[3]]);
}

/// Each pair of places, also one place twice.
fn pairs_of_places() -> impl Iterator<Item = (usize, usize)> {
    (0..4).flat_map(|one| (0..4).map(move |other| (one, other)))
}

/// Asserts that the first slave of the chain distributes its time, and that each is told its delay from that one.
fn assert_told_by_the_first(chain: &Chain, clocks: &BusClocks<16>, what: &str) {
    let delay = |slave: &Model| read_u32(&slave.memory, usize::from(register::DC_DELAY));
    let told: StdVec<u32> = chain.slaves.iter().map(delay).collect();
    assert_eq!(told, [0, 500, 1_000, 1_500], "{what}");
    let reference = clocks.reference_clock(&STATIONS, |_| true).expect("a reference");
    assert_eq!(reference.station, chain.stations[0], "{what}");
    let times: StdVec<u64> = chain
        .slaves
        .iter()
        .map(|slave| slave.system_ns(chain.true_ns))
        .collect();
    assert!(times.iter().all(|time_ns| *time_ns == times[0]), "{what}: {times:?}");
}

#[test]
fn slaves_that_were_exchanged_with_power_are_told_the_delays_of_their_new_places() {
    for (first, second) in pairs_of_places().flat_map(|first| pairs_of_places().map(move |second| (first, second))) {
        // The looks through the chain that are lost, each with all its repetitions.
        for lost_looks in 0..2 {
            let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
            let mut clocks = chain.set_up();
            for (one, other) in [first, second] {
                chain.exchange(one, other);
                clocks.chain_changed();
                for look in 0..=lost_looks {
                    chain.losses = if look < lost_looks { 1_000 } else { 0 };
                    let told = chain.run(async |mut port: AcyclicPort<'static, 64>| {
                        tell_delays(&mut port, &STATIONS, &mut clocks, |_| Presence::Used).await
                    });
                    assert_eq!(told.is_ok(), look == lost_looks, "{told:?}");
                }
                assert_told_by_the_first(&chain, &clocks, &std::format!("{one} for {other}"));
            }
        }
    }
}

#[test]
fn times_of_different_frames_are_no_measurement() {
    for (passed, times) in (0..4).flat_map(|passed| (0..5).map(move |times| (passed, times))) {
        for lost in [None, Some(0), Some(2)] {
            let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (NARROW, 42, 0), (WIDE, 123_456, 0)]);
            let mut clocks = chain.set_up();
            chain.cut = (times, passed);
            clocks.chain_changed();
            if let Some(lost) = lost {
                chain.slaves[lost].start_ns += 1 << 33;
                clocks.was_off(lost);
            }
            let mut repair = |chain: &mut Chain| {
                chain.run(async |mut port: AcyclicPort<'static, 64>| match lost {
                    Some(lost) => restore(&mut port, &STATIONS, &mut clocks, lost, |_| Presence::Used).await,
                    None => tell_delays(&mut port, &STATIONS, &mut clocks, |_| Presence::Used).await,
                })
            };
            let done = repair(&mut chain);
            assert_eq!(done.is_ok(), times < 3, "{done:?}, {passed} slaves, {times} times");
            let again = repair(&mut chain);
            assert!(again.is_ok(), "{again:?}, {passed} slaves, {times} times");
            let delay = |slave: &Model| read_u32(&slave.memory, usize::from(register::DC_DELAY));
            let told: StdVec<u32> = chain.slaves.iter().map(delay).collect();
            assert_eq!(told, [0, 500, 1_000, 1_500], "{passed} slaves, {times} times");
            let time = |slave: &Model| slave.system_ns(chain.true_ns) as u32;
            assert!(chain.slaves.iter().all(|slave| time(slave) == time(&chain.slaves[0])));
        }
    }
}

#[test]
fn slaves_that_were_exchanged_and_one_of_them_off_agree_again() {
    for (first, second) in pairs_of_places().flat_map(|first| pairs_of_places().map(move |second| (first, second))) {
        let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
        let mut clocks = chain.set_up();
        for (one, other) in [first, second] {
            chain.exchange(one, other);
            let off = usize::from(chain.stations[other] - STATIONS[0]);
            chain.slaves[other].start_ns += 1 << 33;
            clocks.was_off(off);
            clocks.chain_changed();
            chain
                .run(async |mut port: AcyclicPort<'static, 64>| {
                    tell_delays(&mut port, &STATIONS, &mut clocks, present(|number| number != off)).await?;
                    restore(&mut port, &STATIONS, &mut clocks, off, |_| Presence::Used).await
                })
                .expect("the repair");
            assert_told_by_the_first(&chain, &clocks, &std::format!("{one} for {other}"));
        }
    }
}

#[test]
fn a_slave_that_only_promises_to_latch_times_keeps_no_clock_from_being_set() {
    for place in 0..4 {
        let clocks: [_; 4] = core::array::from_fn(|slave| if slave == place { None } else { WIDE });
        let mut chain = Chain::new(clocks.map(|width| (width, 42, 0)));
        let other = &mut chain.slaves[place];
        // Its features tell of times that stay what they are.
        other.is_frozen = true;
        other.put(register::FEATURES, &register::FEATURE_CLOCKS.to_le_bytes());
        let mut clocks = chain.set_up();
        for again in [false, true] {
            if again {
                clocks.chain_changed();
                let told = chain.run(async |mut port: AcyclicPort<'static, 64>| {
                    tell_delays(&mut port, &STATIONS, &mut clocks, |_| Presence::Used).await
                });
                told.expect("the delays");
            }
            let delay = |slave: &Model| read_u32(&slave.memory, usize::from(register::DC_DELAY));
            let told: StdVec<u32> = chain.slaves.iter().map(delay).collect();
            let first = usize::from(place == 0);
            let right = |slave: usize| {
                if slave == place {
                    0
                } else {
                    500 * (slave - first) as u32
                }
            };
            assert_eq!(told, [0, 1, 2, 3].map(right), "place {place}, again {again}");
        }
    }
}

#[test]
fn who_begins_to_distribute_its_time_runs_freely_even_if_the_cables_cannot_be_measured() {
    for lost in [&[0][..], &[0, 1]] {
        let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
        let mut clocks = chain.set_up();
        clocks.chain_changed();
        chain.losses = 1_000;
        chain.log.clear();
        let told = chain.run(async |mut port: AcyclicPort<'static, 64>| {
            tell_delays(
                &mut port,
                &STATIONS,
                &mut clocks,
                present(|number| !lost.contains(&number)),
            )
            .await
        });
        assert!(told.is_err());
        assert_eq!(chain.log.matches("Fpwr:0930").count(), 1, "{}", chain.log);
    }
}

#[test]
fn a_good_terminal_is_not_given_up_because_a_cable_was_loose_for_long() {
    for (passed, times) in (0..4).flat_map(|passed| (3..8).map(move |times| (passed, times))) {
        let mut chain = Chain::new([(WIDE, 5, 0), (None, 0, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
        chain.slaves[1].latches = true;
        chain.slaves[1].put(register::FEATURES, &register::FEATURE_CLOCKS.to_le_bytes());
        let mut clocks = chain.set_up();
        chain.cut = (times, passed);
        for _ in 0..4 {
            clocks.chain_changed();
            // It fails as long as the cable is loose.
            let _ = chain.run(async |mut port: AcyclicPort<'static, 64>| {
                tell_delays(&mut port, &STATIONS, &mut clocks, |_| Presence::Used).await
            });
        }
        assert!(clocks.slaves[1].ports.has_clock, "{passed} slaves, {times} times");
        let delays: StdVec<u32> = clocks.slaves.iter().map(|slave| slave.delay_ns).collect();
        assert_eq!(delays, [0, 500, 1_000, 1_500], "{passed} slaves, {times} times");
    }
}

#[test]
fn a_slave_that_may_be_another_one_is_told_its_delay_again() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
    let mut clocks = chain.set_up();
    clocks.was_off(2);
    chain.slaves[2].put(register::DC_DELAY, &[0; 4]);
    let told = chain.run(async |mut port: AcyclicPort<'static, 64>| {
        tell_delays(&mut port, &STATIONS, &mut clocks, |_| Presence::Used).await
    });
    told.expect("the delays");
    assert_eq!(
        read_u32(&chain.slaves[2].memory, usize::from(register::DC_DELAY)),
        1_000
    );
}

#[test]
fn a_chain_of_which_only_a_part_was_seen_is_looked_through_again() {
    for (one, other) in pairs_of_places() {
        for seen in 1..4 {
            let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
            let mut clocks = chain.set_up();
            chain.exchange(one, other);
            clocks.chain_changed();
            let behind_a_loose_cable = chain.slaves.split_off(seen);
            let mut tell = |chain: &mut Chain| {
                let told = chain.run(async |mut port: AcyclicPort<'static, 64>| {
                    tell_delays(&mut port, &STATIONS, &mut clocks, |_| Presence::Used).await
                });
                told.expect("the delays");
                clocks.clone()
            };
            tell(&mut chain);
            chain.slaves.extend(behind_a_loose_cable);
            let clocks = tell(&mut chain);
            assert_told_by_the_first(&chain, &clocks, &std::format!("{one} for {other}, {seen} seen"));
        }
    }
}

#[test]
fn a_clock_takes_the_time_from_the_first_of_the_chain_whatever_its_number() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
    let mut clocks = chain.set_up();
    chain.exchange(0, 2);
    clocks.chain_changed();
    // Slave 0, the last one now, has come back almost in time.
    chain.slaves[2].start_ns += 15_000;
    clocks.was_off(1);
    let restored = chain.run(async |mut port: AcyclicPort<'static, 64>| {
        tell_delays(&mut port, &STATIONS, &mut clocks, present(|number| number != 1)).await?;
        restore(&mut port, &STATIONS, &mut clocks, 1, |_| Presence::Used).await
    });
    restored.expect("the repair");
    let time = |slave: usize| chain.slaves[slave].system_ns(chain.true_ns);
    assert_eq!(time(1), time(0));
}

#[test]
fn a_replaced_clock_is_told_its_delay_whatever_it_was_told_elsewhere() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
    let mut clocks = chain.set_up();
    chain.slaves[0].put(register::DC_DELAY, &77_u32.to_le_bytes());
    let found = SlaveClock {
        width: NARROW,
        ..clocks.slaves[0]
    };
    clocks.replace(0, &found);
    clocks.found_in_time(0);
    let told = chain.run(async |mut port: AcyclicPort<'static, 64>| {
        tell_delays(&mut port, &STATIONS, &mut clocks, |_| Presence::Used).await
    });
    told.expect("the delays");
    assert_eq!(read_u32(&chain.slaves[0].memory, usize::from(register::DC_DELAY)), 0);
}
