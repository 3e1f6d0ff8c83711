use super::*;
use crate::random::Lcg;

/// Speed with which gaps are bounded, mm/s.
const SPEED_MM_S: f64 = 400.0;

fn place(x_mm: f64, y_mm: f64) -> Position {
    Position {
        x_mm,
        y_mm,
        z_mm: -850.0,
    }
}

/// Two legs of 20 mm, 1 mm apart, joined at the far end.
fn hairpin() -> Vec<Position> {
    vec![place(0.0, 0.0), place(20.0, 0.0), place(20.0, 1.0), place(0.0, 1.0)]
}

/// Moments of one stroke, a millisecond apart.
fn moments(references: &[Position], measured: &[Position]) -> Vec<Moment> {
    let pairs = references.iter().zip(measured);
    let moment = |(t_ms, (reference, measured)): (u32, (&Position, &Position))| Moment {
        t_ms,
        stroke: 0,
        reference: *reference,
        measured: *measured,
    };
    (0..).zip(pairs).map(moment).collect()
}

#[test]
fn a_position_is_compared_with_its_own_leg_and_not_with_the_neighbour() {
    let there: Vec<Position> = (0..=20).map(|x| place(f64::from(x), 0.0)).collect();
    let beside: Vec<Position> = (0..=20).map(|x| place(f64::from(x), 0.8)).collect();
    let (reference, measured) = deviation(&moments(&there, &beside), &[(0, hairpin())], SPEED_MM_S);
    assert!(reference.max_mm < 1e-9, "{reference:?}");
    assert!((measured.max_mm - 0.8).abs() < 1e-3, "{measured:?}");
}

#[test]
fn a_stroke_whose_way_back_lies_on_the_way_there_has_no_deviation_when_it_is_followed() {
    // Forth, back over the same line, and away from its middle: a follower that goes back loses its place.
    let stroke = vec![place(0.0, 0.0), place(20.0, 0.0), place(10.0, 0.0), place(10.0, 8.0)];
    let there = (0..=200).map(|k| place(f64::from(k) * 0.1, 0.0));
    let back = (1..=100).map(|k| place(20.0 - f64::from(k) * 0.1, 0.0));
    let away = (1..=80).map(|k| place(10.0, f64::from(k) * 0.1));
    let followed: Vec<Position> = there.chain(back).chain(away).collect();
    let (reference, measured) = deviation(&moments(&followed, &followed), &[(0, stroke)], SPEED_MM_S);
    assert!(
        reference.max_mm < 1e-9 && measured.max_mm < 1e-9,
        "{reference:?} {measured:?}"
    );
}

#[test]
fn an_end_that_was_left_out_counts_with_its_distance() {
    // The last 10 mm forth and the first 10 mm back are cut off.
    let cut: Vec<Position> = (0..=100)
        .map(|k| place(f64::from(k) * 0.1, 0.0))
        .chain((0..=10).map(|k| place(10.0, f64::from(k) * 0.1)))
        .chain((0..=100).map(|k| place(10.0 - f64::from(k) * 0.1, 1.0)))
        .collect();
    let (_, measured) = deviation(&moments(&cut, &cut), &[(0, hairpin())], SPEED_MM_S);
    // Half of it: the positions before and after account for the nearer half of the part left out.
    assert!((5.0..5.2).contains(&measured.max_mm), "{measured:?}");
}

#[test]
fn a_position_that_lags_around_a_tip_is_compared_with_both_sides_of_it() {
    let points = vec![place(0.0, 0.0), place(10.0, 0.0), place(0.0, 2.0)];
    let along = |s: f64| {
        if s < 10.0 {
            place(s, 0.0)
        } else {
            place(20.0 - s, (s - 10.0) * 0.2)
        }
    };
    let references: Vec<Position> = (0..=180).map(|k| along(f64::from(k) * 0.1)).collect();
    let measured: Vec<Position> = (0..=180).map(|k| along((f64::from(k) * 0.1 - 0.4).max(0.0))).collect();
    let (reference, measured) = deviation(&moments(&references, &measured), &[(0, points)], SPEED_MM_S);
    assert!(
        reference.max_mm < 1e-6 && measured.max_mm < 1e-6,
        "{reference:?} {measured:?}"
    );
}

#[test]
fn a_stroke_goes_on_after_a_hold_and_after_lost_samples() {
    let followed: Vec<Position> = (0..=200).map(|k| place(f64::from(k) * 0.1, 0.0)).collect();
    let mut rows = moments(&followed, &followed);
    rows.drain(50..90);
    // The pen was up for a second.
    rows.iter_mut().skip(100).for_each(|moment| moment.t_ms += 1_000);
    let (reference, measured) = deviation(&rows, &[(0, hairpin())], SPEED_MM_S);
    assert!(
        reference.max_mm < 1e-6 && measured.max_mm < 1e-6,
        "{reference:?} {measured:?}"
    );
}

#[test]
fn ink_is_missing_where_none_is_near() {
    let strokes = vec![(0, vec![place(0.0, 0.0), place(10.0, 0.0)])];
    let ink: Vec<[f64; 2]> = (0..=50).map(|k| [f64::from(k) * 0.1, 0.2]).collect();
    let missing_mm = ink_missing(&strokes, &[ink]);
    assert!((missing_mm - 4.5).abs() < 0.15, "{missing_mm}");
}

#[test]
fn ink_that_begins_on_top_of_the_last_stroke_belongs_to_its_own() {
    // The second stroke begins on the first one, and is drawn slightly beside its own beginning.
    let strokes = vec![
        (0, vec![place(0.0, 0.0), place(20.0, 0.0)]),
        (1, vec![place(10.0, 0.05), place(10.0, 5.0)]),
        (2, vec![place(30.0, 0.0), place(40.0, 0.0)]),
    ];
    let ink = [
        vec![[0.0, 0.0], [20.0, 0.0]],
        vec![[10.0, 0.0], [10.0, 5.0]],
        vec![[30.0, 0.0], [40.0, 0.0]],
    ];
    let found = ink_deviation(&ink, &strokes);
    assert!(found.max_mm < 0.06, "{}", found.max_mm);
}

#[test]
fn ink_is_compared_with_the_strokes_in_their_order() {
    let strokes = vec![(0, hairpin()), (1, vec![place(0.0, 1.5), place(20.0, 1.5)])];
    let line = |y: f64, from: i32, to: i32| (from..=to).map(|x| [f64::from(x), y]).collect::<Vec<_>>();
    let first = [
        line(0.1, 0, 20),
        vec![[20.0, 0.5]],
        line(1.0, 0, 20).into_iter().rev().collect(),
    ]
    .concat();
    let second = line(1.3, 0, 20);
    // 1.3 is nearer to the last leg of the first stroke than 0.2 mm only if the order is not kept.
    let found = ink_deviation(&[first.clone(), second.clone()], &strokes);
    assert!((found.max_mm - 0.2).abs() < 1e-3, "{found:?}");
    let (before, after) = first.split_at(10);
    let held = ink_deviation(&[before.to_vec(), after.to_vec(), second], &strokes);
    assert!((held.max_mm - 0.2).abs() < 1e-3, "a hold in the first stroke: {held:?}");
}

#[test]
fn a_stroke_without_ink_leaves_the_ink_of_the_others_with_their_own() {
    // Ten parallel lines 0.8 mm apart, drawn to and fro, each 0.3 mm off; every choice of one or two that left no ink.
    let strokes: Vec<NumberedStroke> = (0..10)
        .map(|k| {
            let y = 0.8 * f64::from(k);
            let ends = [place(0.0, y), place(30.0, y)];
            (
                k,
                if k % 2 == 0 {
                    ends.to_vec()
                } else {
                    ends.iter().rev().copied().collect()
                },
            )
        })
        .collect();
    let drawn: Vec<Vec<[f64; 2]>> = strokes
        .iter()
        .map(|(_, points)| {
            let line = |k: u32| {
                let part = f64::from(k) / 100.0;
                [
                    points[0].x_mm + part * (points[1].x_mm - points[0].x_mm),
                    points[0].y_mm + 0.3,
                ]
            };
            (0..=100).map(line).collect()
        })
        .collect();
    for missing in 0..10 {
        for also in missing..10 {
            let ink: Vec<_> = (0..)
                .zip(&drawn)
                .filter(|(k, _)| *k != missing && *k != also)
                .map(|(_, line)| line.clone())
                .collect();
            let found = ink_deviation(&ink, &strokes);
            assert!(
                (found.max_mm - 0.3).abs() < 1e-3,
                "without {missing} and {also}: {found:?}"
            );
        }
    }
}

/// Random vertices within 0.03 mm, like a digitiser's noise, followed by a line of 30 mm.
fn noise(count: usize) -> Vec<Position> {
    let mut random = Lcg::new(5);
    let mut random = || random.between(-0.03, 0.03);
    let mut points: Vec<Position> = (0..count).map(|_| place(random(), random())).collect();
    points.push(place(30.0, 0.0));
    points
}

/// Positions that rest within the noise and then follow the line.
fn rest_and_follow(rest: usize) -> Vec<Step> {
    let along = (0..=300).map(|k| place(f64::from(k) * 0.1, 0.0));
    let positions = std::iter::repeat_n(place(0.0, 0.0), rest).chain(along);
    let step = |position| Step {
        position,
        unseen_mm: None,
    };
    positions.map(step).collect()
}

#[test]
fn a_stroke_of_noise_is_thinned_within_its_limits_and_one_that_can_be_matched_is_not() {
    for (count, is_thinned) in [(100, false), (20_000, true)] {
        let points = noise(count);
        let steps = rest_and_follow(2_000);
        let mut way = Way::new(&points);
        let matched = way.follow(&steps, beginning(&way.line, &steps));
        println!(
            "{count} vertices: thinned to {} mm, {} mm",
            way.thinned_mm, matched.distance_mm
        );
        assert_eq!(way.thinned_mm > 0.0, is_thinned, "{count} vertices");
        assert!(way.moved_mm == 0.0 && matched.distance_mm < 0.1, "{count} vertices");
        assert_eq!(matched.places_mm.len(), steps.len());
    }
}

#[test]
fn no_distance_from_a_thinned_stroke_is_too_small_by_more_than_its_noise() {
    let points = noise(100);
    let steps = rest_and_follow(200);
    let mut way = Way::new(&points);
    let exact = way.follow(&steps, beginning(&way.line, &steps));
    for _ in 0..4 {
        way.thin();
        let found = way.follow(&steps, beginning(&way.line, &steps));
        let least_mm = exact.distance_mm - 2.0 * THINNED_MM;
        let most_mm = exact.distance_mm + 2.0 * THINNED_MM + 2.0 * way.moved_mm;
        let found_mm = found.distance_mm + way.moved_mm;
        assert!(
            (least_mm..=most_mm).contains(&found_mm),
            "{found_mm} mm, {least_mm} to {most_mm} mm, moved {} mm",
            way.moved_mm
        );
    }
}
