//! How a clock is judged to have settled.

use super::*;

#[test]
fn a_clock_that_only_passes_by_the_reference_is_not_taken_for_one_that_agrees() {
    // 15 ppm fast and without a control loop: for some fifty milliseconds it is near.
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 15_000), (WIDE, 42, 2_000), (WIDE, 7, 0)]);
    chain.set_up();
    chain.distributes = true;
    let mut settled = |station| {
        chain.run(async move |mut port: AcyclicPort<'static, 64>| {
            await_agreement(&mut port, station, Settling::default()).await
        })
    };
    let slow = settled(STATIONS[2]);
    assert!(slow.is_ok(), "{slow:?}: 2 ppm are agreement");
    let passing = settled(STATIONS[1]);
    assert!(matches!(passing, Err(BusError::ClockDifference { .. })), "{passing:?}");
}

#[test]
fn a_clock_that_does_not_follow_is_an_error_with_its_difference() {
    // Half a percent fast and without a control loop: 32 frames later it is far away.
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 5_000_000), (WIDE, 42, 0), (WIDE, 7, 0)]);
    chain.set_up();
    let settled = |station, settling| {
        async move |mut port: AcyclicPort<'static, 64>| await_agreement(&mut port, station, settling).await
    };
    let result = chain.run(settled(STATIONS[1], Settling::default()));
    match result {
        Err(BusError::ClockDifference {
            expected_ns: DIFFERENCE_MAX_NS,
            actual_ns,
            waited_ms,
        }) => {
            println!("{actual_ns} ns after {waited_ms} ms");
            assert!(actual_ns > 100_000 && waited_ms > DIFFERENCE_TIMEOUT_MS);
        }
        other => panic!("{other:?}"),
    }
    assert_eq!(chain.run(settled(STATIONS[2], Settling::default())), Ok(0));
    let wait_ms = 50;
    let difference_ns = u32::MAX;
    let near = chain.run(settled(STATIONS[1], Settling { difference_ns, wait_ms }));
    assert!(near.is_ok(), "{near:?}");
    let difference_ns = 10;
    let far = chain.run(settled(STATIONS[1], Settling { difference_ns, wait_ms }));
    assert!(
        matches!(far, Err(BusError::ClockDifference { expected_ns: 10, waited_ms, .. }) if waited_ms < 60),
        "{far:?}"
    );
}

#[test]
fn a_clock_that_swings_within_the_limit_is_an_error_after_the_longest_wait() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 42, 0), (WIDE, 7, 0), (WIDE, 9, 0)]);
    chain.set_up();
    chain.distributes = true;
    chain.slaves[1].swing_ns = 300;
    let result = chain.run(async |mut port: AcyclicPort<'static, 64>| {
        await_agreement(&mut port, STATIONS[1], Settling::default()).await
    });
    match result {
        Err(BusError::ClockDifference { waited_ms, .. }) => assert!(waited_ms < DIFFERENCE_TIMEOUT_MS + 50),
        other => panic!("{other:?}"),
    }
}
