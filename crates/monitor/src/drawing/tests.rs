use super::*;
use crate::vector::length;
use proptest::prelude::*;

/// A drawing with this path, which began at the first point.
fn drawing(points: &[([f64; 2], bool)]) -> (Cell, Bounds, Drawing) {
    let cell = Cell::default();
    let bounds = Bounds::new(&cell);
    let mut drawing = Drawing::new();
    drawing.take(&cell, &bounds, None, &Input::Commanded(Command::Draw { job: 1 }));
    for (index, ([x, y], pen_down)) in (0..).zip(points) {
        let vertex = Input::PathVertex {
            job: 1,
            index,
            position_mm: [*x, *y, -850.0],
            pen_down: *pen_down,
        };
        drawing.take(&cell, &bounds, None, &vertex);
    }
    drawing.hear(&cell, &bounds, &Report::Accepted(Command::Draw { job: 1 }));
    (cell, bounds, drawing)
}

#[test]
fn of_two_orders_at_once_the_path_of_the_accepted_one_counts() {
    let (cell, bounds) = (Cell::default(), Bounds::new(&Cell::default()));
    let order = |job| Input::Commanded(Command::Draw { job });
    let vertex = |job, index, x| Input::PathVertex {
        job,
        index,
        position_mm: [x, 0.0, -850.0],
        pen_down: index > 0,
    };
    // The numbers of both orders, and which of them was accepted.
    for (first, second, accepted) in [(7, 8, 7), (7, 8, 8), (7, 7, 7)] {
        let mut drawing = Drawing::new();
        for input in [order(first), order(second), vertex(8, 0, 0.0), vertex(8, 1, 20.0)] {
            drawing.take(&cell, &bounds, None, &input);
        }
        for (index, x) in [(0, 0.0), (1, 40.0)] {
            drawing.take(&cell, &bounds, None, &vertex(7, index, x));
        }
        let answers = match accepted == first {
            true => [
                Report::Accepted(Command::Draw { job: first }),
                Report::Refused(Command::Draw { job: second }),
            ],
            false => [
                Report::Refused(Command::Draw { job: first }),
                Report::Accepted(Command::Draw { job: second }),
            ],
        };
        for report in answers {
            drawing.hear(&cell, &bounds, &report);
        }
        let touches = |x| drawing.may_touch(&bounds, &[x, 0.0, -850.0], 0.0);
        assert!(touches(10.0));
        assert_eq!(touches(30.0), accepted == 7, "{first}, {second}: {accepted}");
        assert_eq!(drawing.job, Some(accepted));
    }
}

proptest! {
    #[test]
    fn every_point_of_the_path_is_on_it_and_points_far_from_it_are_not(
        points in proptest::collection::vec(((-300.0_f64..300.0, -300.0_f64..300.0), any::<bool>()), 2..40),
        leg in 0_usize..38,
        part in 0.0_f64..1.0,
        aside in (-20.0_f64..20.0, -20.0_f64..20.0),
    ) {
        let points: Vec<_> = points.into_iter().map(|((x, y), pen_down)| ([x, y], pen_down)).collect();
        let (cell, bounds, mut drawing) = drawing(&points);
        let leg = leg % (points.len() - 1);
        let (from, to) = (points[leg].0, points[leg + 1].0);
        let on = [from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1]), -850.0];
        prop_assert!(drawing.locate(&cell, &bounds, &on, 0.0).is_on_path);
        prop_assert!(drawing.may_touch(&bounds, &on, 0.0));
        let beside = [on[0] + aside.0, on[1] + aside.1, -850.0];
        // The distance from all legs, leg by leg.
        let near = |pen_down: bool, tolerance: f64| drawing.legs.iter().any(|leg| {
            leg.pen_down == pen_down && leg.distance_squared(&beside) <= tolerance * tolerance
        });
        let expected = near(true, bounds.drawn_mm) || near(false, bounds.travel_mm);
        prop_assert_eq!(drawing.may_touch(&bounds, &beside, 0.0), expected);
        prop_assert_eq!(drawing.locate(&cell, &bounds, &beside, 0.0).is_on_path, expected);
    }

    #[test]
    fn nonsense_in_a_path_panics_nowhere(
        x in proptest::num::f64::ANY, y in proptest::num::f64::ANY, at in proptest::num::f64::ANY,
    ) {
        let (cell, bounds, mut drawing) = drawing(&[([0.0, 0.0], false), ([x, y], true), ([x, 0.0], true)]);
        drawing.locate(&cell, &bounds, &[at, x, y], at);
        drawing.may_touch(&bounds, &[at, y, x], x);
        drawing.add_ink(&[x, at, y]);
        drawing.missing(at, x);
    }
}

#[test]
fn repeated_vertices_are_taken_once_and_a_refused_drawing_leaves_the_present_one() {
    let (cell, bounds, mut drawing) = drawing(&[([0.0, 0.0], false), ([10.0, 0.0], true)]);
    let again = Input::PathVertex {
        job: 1,
        index: 1,
        position_mm: [50.0, 0.0, -850.0],
        pen_down: true,
    };
    drawing.take(&cell, &bounds, None, &again);
    assert!(!drawing.may_touch(&bounds, &[30.0, 0.0, -850.0], 0.0));
    drawing.take(&cell, &bounds, None, &Input::Commanded(Command::Draw { job: 2 }));
    let other = Input::PathVertex {
        job: 2,
        index: 0,
        position_mm: [90.0, 0.0, -850.0],
        pen_down: true,
    };
    drawing.take(&cell, &bounds, None, &other);
    drawing.hear(&cell, &bounds, &Report::Refused(Command::Draw { job: 2 }));
    drawing.hear(&cell, &bounds, &Report::Accepted(Command::Draw { job: 2 }));
    assert!(!drawing.may_touch(&bounds, &[90.0, 0.0, -850.0], 0.0));
    assert!(drawing.may_touch(&bounds, &[5.0, 0.0, -850.0], 0.0));
}

#[test]
fn a_leg_that_is_too_long_for_the_grid_is_a_leg() {
    let (_, bounds, drawing) = drawing(&[([0.0, 0.0], false), ([1.0e7, 0.0], true), ([1.0e7, 5.0], true)]);
    assert!(drawing.may_touch(&bounds, &[5.0e6, 0.1, -850.0], 0.0));
    assert!(!drawing.may_touch(&bounds, &[5.0e6, 2.0, -850.0], 0.0));
}

#[test]
fn ink_from_before_the_answer_belongs_to_the_drawing_and_ink_from_before_the_order_does_not() {
    let (cell, bounds) = (Cell::default(), Bounds::new(&Cell::default()));
    let mut drawing = Drawing::new();
    for x in [0.0, 1.0, 2.0] {
        drawing.add_ink(&[x, 0.0, -850.0]);
    }
    drawing.take(&cell, &bounds, None, &Input::Commanded(Command::Draw { job: 1 }));
    for (index, x, pen_down) in [(0, 0.0, false), (1, 4.0, true)] {
        let vertex = Input::PathVertex {
            job: 1,
            index,
            position_mm: [x, 0.0, -850.0],
            pen_down,
        };
        drawing.take(&cell, &bounds, None, &vertex);
    }
    drawing.add_ink(&[3.0, 0.0, -850.0]);
    drawing.add_ink(&[4.0, 0.0, -850.0]);
    drawing.hear(&cell, &bounds, &Report::Accepted(Command::Draw { job: 1 }));
    let missing = drawing.missing(0.5, 0.0).expect("what was drawn before the order");
    assert!(missing[0] < 2.5, "{missing:?}");
    assert_eq!(drawing.missing(3.1, 0.0), None);
}

#[test]
fn ink_is_missing_where_there_is_none() {
    let (_, _, mut drawing) = drawing(&[([0.0, 0.0], false), ([10.0, 0.0], true)]);
    for step in 0..=20 {
        let x = 0.5 * f64::from(step);
        if !(4.0..6.0).contains(&x) {
            drawing.add_ink(&[x, 0.1, -850.0]);
        }
    }
    let missing = drawing.missing(0.5, 0.0).expect("a gap of 2.5 mm");
    assert!(length([missing[0] - 4.5, missing[1], 0.0]) < 0.6, "{missing:?}");
    assert_eq!(drawing.missing(1.5, 0.0), None);
    assert_eq!(drawing.missing(0.5, 0.2), None, "a share of it may be missing");
    assert!(drawing.missing(0.5, 0.05).is_some());
    drawing.was_disturbed = true;
    assert_eq!(drawing.missing(0.5, 0.0), None);
}

#[test]
fn a_second_order_before_the_answer_to_the_first_leaves_the_first_its_path() {
    let (cell, bounds) = (Cell::default(), Bounds::new(&Cell::default()));
    let draw = |job| Command::Draw { job };
    let vertex = |index, x| Input::PathVertex {
        job: 7,
        index,
        position_mm: [x, 0.0, -850.0],
        pen_down: index > 0,
    };
    // The second order repeats the number, or has its own; answers come in the order of the orders.
    for second in [7, 8] {
        let mut drawing = Drawing::new();
        for input in [
            Input::Commanded(draw(7)),
            vertex(0, 0.0),
            vertex(1, 20.0),
            Input::Commanded(draw(second)),
            vertex(2, 40.0),
        ] {
            drawing.take(&cell, &bounds, Some([0.0, 0.0, -850.0]), &input);
        }
        drawing.hear(&cell, &bounds, &Report::Accepted(draw(7)));
        drawing.hear(&cell, &bounds, &Report::Refused(draw(second)));
        drawing.take(&cell, &bounds, None, &vertex(3, 60.0));
        for x in [10.0, 30.0, 50.0] {
            assert!(drawing.may_touch(&bounds, &[x, 0.0, -850.0], 0.0), "{second}: {x}");
        }
        assert!(!drawing.may_touch(&bounds, &[70.0, 0.0, -850.0], 0.0), "{second}");
    }
}

#[test]
fn a_drawing_that_begins_on_the_paper_begins_with_a_lift() {
    let (cell, bounds) = (Cell::default(), Bounds::new(&Cell::default()));
    let mut drawing = Drawing::new();
    let pressed = Some([10.0, 0.0, -855.0]);
    drawing.take(&cell, &bounds, pressed, &Input::Commanded(Command::Draw { job: 1 }));
    let first = Input::PathVertex {
        job: 1,
        index: 0,
        position_mm: [60.0, 0.0, -847.0],
        pen_down: false,
    };
    drawing.take(&cell, &bounds, pressed, &first);
    drawing.hear(&cell, &bounds, &Report::Accepted(Command::Draw { job: 1 }));
    for on_way in [[10.0, 0.0, -851.0], [10.0, 0.0, -847.0], [40.0, 0.0, -847.0]] {
        assert!(drawing.locate(&cell, &bounds, &on_way, 0.0).is_on_path, "{on_way:?}");
    }
    assert!(
        !drawing.may_touch(&bounds, &[12.0, 0.0, -849.8], 0.0),
        "no ink on the way"
    );
}

#[test]
fn a_refused_drawing_permits_no_ink_until_it_is_accepted_with_the_path_that_came_last() {
    let (cell, bounds) = (Cell::default(), Bounds::new(&Cell::default()));
    let vertex = |index, x| Input::PathVertex {
        job: 7,
        index,
        position_mm: [x, 0.0, -850.0],
        pen_down: index > 0,
    };
    let order = Input::Commanded(Command::Draw { job: 7 });
    let touches = |drawing: &Drawing, x| drawing.may_touch(&bounds, &[x, 0.0, -850.0], 0.0);
    for (is_answered, new_path) in [(true, false), (true, true), (false, false), (false, true)] {
        let mut drawing = Drawing::new();
        for input in [order, vertex(0, 0.0), vertex(1, 20.0)] {
            drawing.take(&cell, &bounds, None, &input);
        }
        if is_answered {
            drawing.hear(&cell, &bounds, &Report::Refused(Command::Draw { job: 7 }));
            assert!(!touches(&drawing, 10.0), "it was refused");
        }
        let from = if new_path { 100.0 } else { 0.0 };
        for input in [order, vertex(0, from), vertex(1, from + 20.0)] {
            drawing.take(&cell, &bounds, None, &input);
        }
        drawing.hear(&cell, &bounds, &Report::Accepted(Command::Draw { job: 7 }));
        assert_eq!([10.0, 110.0].map(|x| touches(&drawing, x)), [!new_path, new_path]);
    }
}

#[test]
fn a_refused_order_of_the_running_drawings_number_brings_its_path() {
    let (cell, bounds) = (Cell::default(), Bounds::new(&Cell::default()));
    let vertex = |index, x| Input::PathVertex {
        job: 7,
        index,
        position_mm: [x, 0.0, -850.0],
        pen_down: index > 0,
    };
    let order = Input::Commanded(Command::Draw { job: 7 });
    let mut drawing = Drawing::new();
    drawing.take(&cell, &bounds, None, &order);
    drawing.hear(&cell, &bounds, &Report::Accepted(Command::Draw { job: 7 }));
    for input in [order, vertex(0, 0.0), vertex(1, 20.0)] {
        drawing.take(&cell, &bounds, None, &input);
    }
    let touches = |drawing: &Drawing, x| drawing.may_touch(&bounds, &[x, 0.0, -850.0], 0.0);
    drawing.hear(&cell, &bounds, &Report::Refused(Command::Draw { job: 7 }));
    assert!(
        touches(&drawing, 10.0),
        "the board draws the vertices for the order that it has accepted"
    );
}
