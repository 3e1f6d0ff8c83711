//! Searches whose motors follow exactly.

use super::*;
use core::f64::consts::TAU;
use proptest::prelude::*;

const PER_RAD: f64 = 100_000.0;

fn axis(io: u8, order: u8, speed_rad_s: f64) -> Axis {
    Axis {
        home: HomeSwitch {
            io: Some(io),
            order,
            speed_rad_s,
            ..HomeSwitch::default()
        },
        ..Axis::default()
    }
}

/// Steps a search whose motors follow exactly; switches are open beyond their places, rad, in the search's direction.
fn run(axes: &[Axis; AXES], switches_rad: [f64; AXES]) -> (Result<Found, (u8, SearchFailure)>, [f64; AXES], u32) {
    let mut search = Search::new(Kind::Delta, axes, AXES, &[0.0; AXES]);
    let mut fastest = [0.0_f64; AXES];
    for ms in 0..600_000 {
        let pose = search.setpoint().position_rad;
        let is_open = |io: u8| {
            let axis = usize::from(io);
            let towards = axes[axis].home.speed_rad_s.signum();
            Some((pose[axis] - switches_rad[axis]) * towards >= 0.0)
        };
        let increments = pose.map(|rad| (rad * PER_RAD) as i64);
        let found = search.step(axes, is_open, &increments);
        match found {
            Ok(Found::Setpoint(setpoint)) => {
                for (fastest, speed) in fastest.iter_mut().zip(setpoint.velocity_rad_s) {
                    *fastest = fastest.max(speed.abs());
                }
            }
            end => return (end, fastest, ms),
        }
    }
    panic!("the search does not end");
}

fn edges(found: Result<Found, (u8, SearchFailure)>) -> [Option<f64>; AXES] {
    match found {
        Ok(Found::End(Some(edges))) => edges.map(|edge| edge.map(|increments| increments as f64 / PER_RAD)),
        other => panic!("{other:?}"),
    }
}

#[test]
fn each_switch_is_found_where_it_is_from_either_side_and_no_axis_is_faster_than_its_search() {
    let axes = [axis(0, 1, -0.5), axis(1, 0, 0.8), axis(2, 1, -0.3), Axis::default()];
    for switches_rad in [[-1.0, 2.0, -0.2, 0.0], [0.02, -0.04, 0.03, 0.0], [-3.0, 0.0, 0.0, 0.0]] {
        let (found, fastest, _) = run(&axes, switches_rad);
        let found = edges(found);
        for axis in 0..3 {
            let edge_rad = found[axis].expect("an edge");
            assert!(
                (edge_rad - switches_rad[axis]).abs() < 2e-4,
                "{edge_rad} for {switches_rad:?}"
            );
            assert!(fastest[axis] <= axes[axis].home.speed_rad_s.abs() + 1e-12);
        }
        assert_eq!((found[3], fastest[3]), (None, 0.0));
    }
}

#[test]
fn a_switch_that_never_opens_stays_open_or_is_missing_ends_the_search_with_its_axis() {
    let axes = [axis(0, 0, -0.5), axis(1, 1, 0.8), Axis::default(), Axis::default()];
    let far = axes[0].home.travel_max_rad + 1.0;
    assert_eq!(run(&axes, [-far, 1.0, 0.0, 0.0]).0, Err((0, SearchFailure::NeverOpens)));
    // Open wherever the axis is: a broken wire.
    assert_eq!(run(&axes, [-0.1, -1e9, 0.0, 0.0]).0, Err((1, SearchFailure::StaysOpen)));
    let mut search = Search::new(Kind::Delta, &axes, AXES, &[0.0; AXES]);
    assert_eq!(
        search.step(&axes, |_| None, &[0; AXES]),
        Err((0, SearchFailure::Missing))
    );
}

#[test]
fn a_loose_contact_and_a_flag_that_is_too_narrow_end_the_search_instead_of_giving_a_wrong_place() {
    let only = |is_open: &dyn Fn(u32, f64) -> bool| {
        let axes = [axis(0, 0, -0.5), Axis::default(), Axis::default(), Axis::default()];
        let mut search = Search::new(Kind::Delta, &axes, AXES, &[0.0; AXES]);
        for ms in 0..60_000 {
            let pose = search.setpoint().position_rad;
            let increments = pose.map(|rad| (rad * PER_RAD) as i64);
            match search.step(&axes, |_| Some(is_open(ms, pose[0])), &increments) {
                Ok(Found::Setpoint(_)) => {}
                end => return end,
            }
        }
        panic!("the search does not end");
    };
    // The way from the first place of the switch to the slow approach is 3 mm: a contact that opens there for 5 ms.
    let mut wrong = 0;
    for opens_ms in 0..9_000 {
        let found = only(&|ms, rad| rad <= -0.8 || (opens_ms..opens_ms + 5).contains(&ms));
        match found {
            Ok(Found::End(Some([Some(edge), ..]))) => {
                let apart_rad = (edge as f64 / PER_RAD + 0.8).abs();
                assert!(apart_rad < 0.018, "{opens_ms} ms: {apart_rad} rad");
            }
            Err((0, SearchFailure::Differs | SearchFailure::StaysOpen | SearchFailure::NeverOpens)) => wrong += 1,
            other => panic!("{opens_ms} ms: {other:?}"),
        }
    }
    assert!(wrong > 100, "{wrong}");
    // A flag that the first approach passes over: beyond it the contact is closed again.
    for width_rad in [0.001, 0.005, 0.01] {
        let found = only(&|_, rad| (-0.8 - width_rad..=-0.8).contains(&rad));
        assert!(
            matches!(
                found,
                Err((
                    0,
                    SearchFailure::Differs | SearchFailure::StaysOpen | SearchFailure::NeverOpens
                ))
            ) || matches!(found, Ok(Found::End(Some([Some(edge), ..]))) if (edge as f64 / PER_RAD + 0.8).abs() < 0.018),
            "{width_rad} rad: {found:?}"
        );
    }
}

proptest! {
    /// Two belts that move two slides: the switches see the slides, and the drives count from anywhere, in units
    /// and directions of their own.
    #[test]
    fn two_switches_give_the_places_of_two_axes_that_move_together(
        places_rad in prop::array::uniform2(-4.0..4.0_f64),
        away_rad in prop::array::uniform2(-0.1..6.0_f64),
        counted_from in prop::array::uniform2(-1_000_000..1_000_000_i64),
        gears in prop::array::uniform2((0.5..20.0_f64, any::<bool>())),
        orders in prop::array::uniform2(0..2_u8),
        quick_stops in prop::array::uniform2(5.0..100.0_f64),
    ) {
        let gears = gears.map(|(gear, turned)| if turned { -gear } else { gear });
        let drive = |number: u8| Axis {
            gear: gears[usize::from(number)],
            increments_per_revolution: 100_000,
            quick_stop_rad_s2: quick_stops[usize::from(number)],
            ..axis(number, orders[usize::from(number)], if number == 0 { -0.5 } else { 0.4 })
        };
        let axes = [drive(0), drive(1), axis(2, 1, 0.2), Axis::default()];
        let per_rad = gears.map(|gear| gear * 100_000.0 / TAU);
        let mut search = Search::new(Kind::CoreXy, &axes, 3, &[0.7, -0.3, 0.0, 0.0]);
        let begun = search.setpoint().position_rad;
        let starts_rad = [places_rad[0] + away_rad[0], places_rad[1] - away_rad[1]];
        let first = Kind::CoreXy.joints([starts_rad[0], starts_rad[1], 0.0, 0.0]);
        let (mut edges, mut speeds_before) = (None, [0.0; AXES]);
        for _ in 0..100_000 {
            let commanded = search.setpoint();
            let speeds = commanded.velocity_rad_s;
            prop_assert!(speeds[0].abs() <= 0.9 + 1e-9 && speeds[1].abs() <= 0.9 + 1e-9, "{speeds:?}");
            for axis in 0..2 {
                let acceleration = (speeds[axis] - speeds_before[axis]).abs() / CYCLE_S;
                prop_assert!(acceleration <= 0.5 * quick_stops[axis] + 1e-6, "axis {axis}: {acceleration} rad/s2");
            }
            speeds_before = speeds;
            let joints: [f64; AXES] =
                core::array::from_fn(|axis| first[axis] + commanded.position_rad[axis] - begun[axis]);
            let slides = [0.5 * (joints[0] + joints[1]), 0.5 * (joints[0] - joints[1])];
            let is_open = |io: u8| {
                match usize::from(io) {
                    2 => Some(commanded.position_rad[2] >= 0.5),
                    axis => Some((slides[axis] - places_rad[axis]) * axes[axis].home.speed_rad_s >= 0.0),
                }
            };
            let mut increments = [0; AXES];
            for axis in 0..2 {
                increments[axis] = counted_from[axis] + (joints[axis] * per_rad[axis]) as i64;
            }
            increments[2] = (commanded.position_rad[2] * PER_RAD) as i64;
            if let Found::End(found) = search.step(&axes, is_open, &increments).expect("no switch fails") {
                edges = found;
                break;
            }
        }
        let edges = edges.expect("the search ends");
        let at_both = [places_rad[0] + places_rad[1], places_rad[0] - places_rad[1]];
        for axis in 0..2 {
            let edge = edges[axis].expect("a place") - counted_from[axis];
            let apart_rad = edge as f64 / per_rad[axis] - at_both[axis];
            // Each approach is seen a millisecond late at most, at 0.05 rad/s.
            prop_assert!(apart_rad.abs() < 3e-4, "axis {axis}: {apart_rad} rad");
        }
        let third = edges[2].expect("the height has a switch of its own");
        prop_assert!((third as f64 / PER_RAD - 0.5).abs() < 1e-3, "{}", third);
    }
}

#[test]
fn a_cancelled_search_stops_all_axes_and_gives_no_position() {
    let axes = [axis(0, 0, -0.5), axis(1, 0, 0.8), Axis::default(), Axis::default()];
    for cancelled_ms in [0, 5, 400] {
        let mut search = Search::new(Kind::Delta, &axes, AXES, &[0.0; AXES]);
        for _ in 0..cancelled_ms {
            search.step(&axes, |_| Some(false), &[0; AXES]).unwrap();
        }
        search.cancel();
        let mut end = None;
        for _ in 0..200 {
            if let Found::End(found) = search.step(&axes, |_| Some(false), &[0; AXES]).unwrap() {
                end = Some(found);
                break;
            }
        }
        assert_eq!(end, Some(None));
        assert_eq!(search.setpoint().velocity_rad_s, [0.0; AXES]);
    }
}

#[test]
fn a_bouncing_switch_gives_the_place_of_its_first_contact() {
    let mut switch = Switch::default();
    for (ms, is_open) in [true, false, true, true, true].into_iter().enumerate() {
        switch.step(is_open, ms as i64, 0.0);
    }
    assert_eq!((switch.is_open, switch.changed_at), (true, 2));
}
