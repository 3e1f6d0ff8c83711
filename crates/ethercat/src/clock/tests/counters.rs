//! Wrong working counters while clocks are looked for.

use super::*;

/// Clocks, one of them with 32 bits, and a slave that only latches receive times: its time has the working counter 0.
const SLAVES: [(Option<Width>, u64, i64); 4] = [(WIDE, 5, 0), (None, 0, 0), (NARROW, 42, 0), (WIDE, 7, 0)];
const WIDTHS: [Option<Width>; 4] = [WIDE, None, NARROW, WIDE];
/// What damage adds to a working counter.
const ADDED: [i16; 5] = [-2, -1, 1, 2, 200];
const TRIES: usize = acyclic::TRIES_MAX as usize;

fn chain(added: i16, miscounted: Range<usize>) -> Chain {
    let mut chain = Chain::new(SLAVES);
    let terminal = &mut chain.slaves[1];
    terminal.latches = true;
    terminal.put(register::FEATURES, &register::FEATURE_CLOCKS.to_le_bytes());
    (chain.miscount, chain.miscounted) = (added as u16, miscounted);
    chain
}

fn found(mut chain: Chain, is_used: bool) -> Result<[Option<Width>; 4], BusError> {
    chain.run(async |mut port: AcyclicPort<'static, 64>| {
        let clocks = discover::<4, 64>(&mut port, &STATIONS, |_| is_used).await?;
        Ok(core::array::from_fn(|slave| clocks.slaves[slave].width))
    })
}

#[test]
fn wrong_working_counters_take_no_slaves_clock_away() {
    for added in ADDED {
        // A slave without a time answers with 0 half of the times at least.
        for (first, count) in (1..40).flat_map(|first| (0..=TRIES / 2).map(move |count| (first, count))) {
            let mut widths = found(chain(added, first..first + count), true).expect("an end of the wrong counters");
            if added == 1 {
                // Where 0 is true, 1 cannot be told from a true one.
                widths[1] = None;
            }
            assert_eq!(widths, WIDTHS, "{added} in {count} frames from {first} on");
        }
    }
}

#[test]
fn a_wrong_working_counter_without_an_end_is_an_error_of_a_slave_that_is_used() {
    for first in 1..8 {
        let used = found(chain(2, first..1_000), true);
        let is_error = matches!(
            used,
            Err(BusError::WorkingCounter {
                expected: 1,
                actual: 2..
            })
        );
        assert!(is_error, "from frame {first} on: {used:?}");
        let widths = found(chain(2, first..1_000), false).expect("slaves that nobody uses");
        let told = widths
            .iter()
            .zip(WIDTHS)
            .all(|(found, true_one)| found.is_none() || *found == true_one);
        assert!(told && widths != WIDTHS, "from frame {first} on: {widths:?}");
    }
}

#[test]
fn a_repaired_slave_keeps_its_clock_whatever_the_working_counters_of_its_first_frames_are() {
    for added in ADDED {
        for (first, count) in (1..4).flat_map(|first| (0..TRIES).map(move |count| (first, count))) {
            for (place, width) in WIDTHS.into_iter().enumerate().filter(|(_, width)| width.is_some()) {
                let mut chain = chain(0, 0..0);
                let mut clocks = chain.set_up();
                let begun = chain.frames;
                (chain.miscount, chain.miscounted) = (added as u16, begun + first..begun + first + count);
                let found = chain
                    .run(async |mut port: AcyclicPort<'static, 64>| read_clock(&mut port, STATIONS[place]).await)
                    .expect("an end of the wrong counters")
                    .expect("a slave that answers");
                clocks.replace(place, &found);
                assert_eq!(
                    clocks.slaves[place].width, width,
                    "{added} in {count} frames from {first} on"
                );
                assert!(clocks.is_set(place));
            }
        }
    }
}
