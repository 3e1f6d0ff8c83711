//! Requirements on the end of a stretch: at a stop, and at the end of the time.

use super::*;
use crate::curve::Curve;
use crate::settings::Settings;
use crate::work_area::WorkArea;

/// A plan over two straight pieces, with a stop and a dwell of the pen between them.
fn plan() -> Plan {
    let settings = Settings::default();
    let kinematics = *WorkArea::new(&settings).unwrap().kinematics();
    let mut plan = Plan::new();
    plan.reconfigure(kinematics, Limits::new(&settings), &settings.motion);
    plan.dwell_s = 0.05;
    for [from, to] in [[0.0, 10.0], [10.0, 20.0]] {
        assert!(plan.push(Piece {
            curve: Curve::line(&[from, 0.0, -850.0], &[to, 0.0, -850.0]),
            intervals: 1,
            stop_after: true,
            dwell_after: true,
            ..Piece::NONE
        }));
    }
    plan.grow();
    plan.look_back();
    plan
}

/// Ends the present stretch less than [`ARRIVED_MM`] before the end of its interval, with a speed.
fn nearly_arrive(plan: &mut Plan) {
    plan.stretch = None;
    plan.offset_mm = plan.points.get(plan.place).unwrap().span.length_mm - 0.5 * ARRIVED_MM;
    plan.squared = 1.0e-6;
}

#[test]
fn a_speed_that_is_left_a_picometre_before_a_stop_ends_there() {
    let mut braked = plan();
    nearly_arrive(&mut braked);
    braked.advance(1.0e-3, Pace::Brake, &mut ());
    assert!(braked.resting(), "before a dwell");
    let mut plan = plan();
    let goes_on = (0..2_000).any(|_| plan.advance(1.0e-3, Pace::Go, &mut ()).point[0] > 10.0);
    assert!(goes_on, "after the dwell");
    nearly_arrive(&mut plan);
    plan.advance(1.0e-3, Pace::Go, &mut ());
    assert!(plan.pauses() || plan.exhausted(), "at the end of the path");
    for _ in 0..100 {
        plan.advance(1.0e-3, Pace::Go, &mut ());
    }
    assert!(plan.exhausted(), "at the end of the path");
}

/// Sees whether a part without a duration was reported.
#[derive(Default)]
struct Parts {
    all: usize,
    empty: usize,
}

impl Observer for Parts {
    fn moved(&mut self, passage: &Passage) {
        let [from_s, to_s] = passage.time_s;
        self.all += 1;
        self.empty += usize::from(from_s >= to_s);
    }
}

#[test]
fn a_stretch_that_ends_with_the_time_is_followed_by_nothing_until_the_next() {
    let mut plan = plan();
    plan.begin(Pace::Go);
    let mut parts = Parts::default();
    for number in 1..=2 {
        let duration_s = plan.stretch.unwrap().duration_s();
        plan.advance(duration_s, Pace::Go, &mut parts);
        assert_eq!((parts.all, parts.empty), (number, 0));
        assert!(plan.stretch.is_none());
        plan.begin(Pace::Go);
        if plan.stretch.is_none() {
            break;
        }
    }
}
