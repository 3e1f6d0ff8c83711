//! Selects, from several orders of a set of strokes, the one with the shortest duration in the firmware's planner.
//!
//! The search for an order uses average durations of travel moves; the selection uses the planner, which considers each
//! corner and position. Invariant: the selected order has neither a longer duration nor a longer travel length than the
//! given one.

use super::wire::as_sent;
use crate::drawing::{Drawing, OrderOptions, Travel, estimate, order, to_path};
use crate::planning::planned_s;
use etherpen::config::Config;
use etherpen::motion::Vertex;

/// Longest estimated duration of a drawing that is planned, s. Beyond it, an order is selected by the time gained on
/// travel moves, if that is at least this share of the drawing.
const PLANNED_MAX_S: f64 = 7_200.0;
const SURE_SHARE: f64 = 0.1;

/// The path sent for strokes on the sheet: coordinates as the link carries them, without repetitions.
pub(crate) fn travelling(drawing: &Drawing, config: &Config) -> Vec<Vertex> {
    as_sent(&to_path(drawing, &config.paper))
}

/// Layers in the chosen order, and the planned durations.
pub(crate) struct ChosenOrder {
    /// The layers' strokes; `None` if no order is quicker than the given one.
    pub(crate) layers: Option<Vec<Drawing>>,
    /// Planned duration of the given order, s, approximate above two hours; `None` if the robot cannot draw it.
    pub(crate) given_s: Option<f64>,
    /// Planned duration of the chosen order, s; `None` if the robot cannot draw it.
    pub(crate) chosen_s: Option<f64>,
}

/// Orders the strokes of each layer. If that would take longer than the given order, only joins them, or keeps them.
///
/// `given` are the strokes of all layers in the given order; the result is never longer than it.
pub(crate) fn choose_order(
    layers: &[Drawing],
    given: &Drawing,
    options: &OrderOptions,
    config: &Config,
) -> ChosenOrder {
    let layers_of = |options: &OrderOptions| {
        let mut layers = layers.to_vec();
        for layer in &mut layers {
            order(layer, options);
        }
        let sequence = sequence(&layers, given.sheet_mm);
        (layers, sequence)
    };
    let first = layers_of(options);
    let gained_s = travel_s(given, &options.travel) - travel_s(&first.1, &options.travel);
    let is_long = estimate(given).time_s > PLANNED_MAX_S && gained_s > SURE_SHARE * estimate(&first.1).time_s;
    let [first_s, given_s] = match is_long {
        true => {
            let [first_s] = durations_s([&first.1], config);
            [first_s, first_s.map(|first_s| first_s + gained_s)]
        }
        false => durations_s([&first.1, given], config),
    };
    let is_fit = |(layers, sequence): (Vec<Drawing>, Drawing), seconds: Option<f64>| {
        let is_quicker = given_s.is_none_or(|given_s| seconds.is_some_and(|seconds| seconds <= given_s));
        (is_quicker && sequence.pen_up_mm() <= given.pen_up_mm()).then_some((layers, seconds))
    };
    let chosen = is_fit(first, first_s).or_else(|| {
        if options.keep_order {
            return None;
        }
        let joined = layers_of(&OrderOptions {
            keep_order: true,
            ..*options
        });
        let [joined_s] = durations_s([&joined.1], config);
        is_fit(joined, joined_s)
    });
    let (layers, chosen_s) = chosen.map_or((None, given_s), |(layers, seconds)| (Some(layers), seconds));
    ChosenOrder {
        layers,
        given_s,
        chosen_s,
    }
}

/// Duration of all travel moves, s.
fn travel_s(drawing: &Drawing, travel: &Travel) -> f64 {
    drawing.travels_mm().map(|way_mm| travel.seconds(way_mm)).sum()
}

/// All layers' strokes, one layer after the other.
fn sequence(layers: &[Drawing], sheet_mm: [f64; 2]) -> Drawing {
    Drawing {
        sheet_mm,
        strokes: layers.iter().flat_map(|layer| layer.strokes.iter().cloned()).collect(),
    }
}

/// Planned duration of each drawing, s; `None` if the robot cannot draw it.
fn durations_s<const N: usize>(drawings: [&Drawing; N], config: &Config) -> [Option<f64>; N] {
    let duration_s = |drawing: &Drawing| {
        let seconds = planned_s(config, &travelling(drawing, config));
        seconds.is_finite().then_some(seconds)
    };
    std::thread::scope(|scope| {
        let threads = drawings.map(|drawing| scope.spawn(move || duration_s(drawing)));
        threads.map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::Stroke;
    use crate::random::Lcg;

    const SHEET_MM: [f64; 2] = [200.0, 200.0];

    fn drawing(strokes: Vec<Vec<[f64; 2]>>) -> Drawing {
        Drawing {
            sheet_mm: SHEET_MM,
            strokes: strokes.into_iter().map(|points| Stroke { points }).collect(),
        }
    }

    /// Strokes of all lengths anywhere, some in clusters, some already in order.
    fn scattered(seed: u64) -> Drawing {
        let mut random = Lcg::new(seed);
        let mut unit = || random.unit();
        let (size, spread) = (1.0 + 20.0 * unit(), 20.0 + 130.0 * unit());
        let strokes = (0..2 + seed % 13).map(|_| {
            let (x, y) = (10.0 + spread * unit(), 10.0 + spread * unit());
            (0..4).map(|_| [x + size * unit(), y + size * unit()]).collect()
        });
        drawing(strokes.collect())
    }

    /// Orders that are hard to make better, or easy to make worse.
    fn pathological() -> Vec<Drawing> {
        let dash = |x: f64, y: f64, length: f64| vec![[x, y], [x + length, y]];
        let rows = |k: u32| (f64::from(k % 4), f64::from(k / 4));
        vec![
            drawing(vec![dash(50.0, 50.0, 20.0)]),
            drawing(vec![dash(10.0, 10.0, 5.0), dash(180.0, 180.0, 5.0)]),
            // There and back in one row, which is the best order already.
            drawing((0..8).map(|k| dash(10.0 + 20.0 * f64::from(k), 50.0, 19.0)).collect()),
            // All beginnings at one point.
            drawing(
                (0..6)
                    .map(|k| vec![[100.0, 100.0], [150.0, 60.0 + 15.0 * f64::from(k)]])
                    .collect(),
            ),
            // The same stroke again and again, in both directions.
            drawing(
                (0..6)
                    .map(|k| {
                        if k % 2 == 0 {
                            vec![[20.0, 20.0], [60.0, 40.0]]
                        } else {
                            vec![[60.0, 40.0], [20.0, 20.0]]
                        }
                    })
                    .collect(),
            ),
            // Dots, and gaps exactly as wide as those that are joined.
            drawing(
                (0..12)
                    .map(rows)
                    .map(|(x, y)| dash(40.0 + 0.5 * x, 40.0 + 0.5 * y, 0.01))
                    .collect(),
            ),
            drawing(
                (0..12)
                    .map(rows)
                    .map(|(x, y)| dash(40.0 + 10.0 * x, 40.0 + 0.499 * y, 9.5))
                    .collect(),
            ),
            // Squares whose corners meet.
            drawing(
                (0..4)
                    .map(rows)
                    .map(|(x, _)| {
                        let (x, y) = (30.0 + 20.0 * x, 30.0 + 20.0 * x);
                        vec![[x, y], [x + 20.0, y], [x + 20.0, y + 20.0], [x, y + 20.0], [x, y]]
                    })
                    .collect(),
            ),
        ]
    }

    #[test]
    fn what_is_chosen_never_takes_longer_than_what_was_given() {
        let config = Config::default();
        let options = OrderOptions::default();
        let scattered = (1..=24).map(|seed| (format!("seed {seed}"), scattered(seed)));
        let pathological = (0..)
            .zip(pathological())
            .map(|(k, drawing)| (format!("case {k}"), drawing));
        for (name, given) in pathological.chain(scattered) {
            let chosen = choose_order(std::slice::from_ref(&given), &given, &options, &config);
            let drawn = chosen
                .layers
                .map_or(given.clone(), |layers| sequence(&layers, given.sheet_mm));
            let [given_s, drawn_s] = [&given, &drawn].map(|drawing| planned_s(&config, &travelling(drawing, &config)));
            assert!(drawn_s <= given_s, "{name}: {drawn_s} s, {given_s} s as given");
            assert_eq!(
                (chosen.given_s, chosen.chosen_s),
                (Some(given_s), Some(drawn_s)),
                "{name}"
            );
            assert!(drawn.strokes.len() <= given.strokes.len(), "{name}");
            assert!(drawn.pen_up_mm() <= given.pen_up_mm(), "{name}");
            let missing_mm = given.pen_down_mm() - drawn.pen_down_mm();
            assert!(missing_mm < 1e-6, "{name}: {missing_mm} mm of the ink are missing");
        }
    }

    #[test]
    fn layers_that_take_turns_are_put_one_after_the_other_only_where_that_is_quicker() {
        let dash = |x: f64| Stroke {
            points: vec![[x, 50.0], [x + 9.0, 50.0]],
        };
        let places: Vec<f64> = (0..8).map(|k| 20.0 + 10.0 * f64::from(k)).collect();
        let given = Drawing {
            sheet_mm: SHEET_MM,
            strokes: places.iter().map(|&x| dash(x)).collect(),
        };
        let layer = |first: usize| Drawing {
            sheet_mm: SHEET_MM,
            strokes: places.iter().skip(first).step_by(2).map(|&x| dash(x)).collect(),
        };
        let chosen = choose_order(
            &[layer(0), layer(1)],
            &given,
            &OrderOptions::default(),
            &Config::default(),
        );
        assert!(chosen.layers.is_none());
    }

    #[test]
    fn what_the_robot_cannot_draw_has_no_time_and_is_ordered_by_its_ways() {
        let dash = |x: f64| vec![[x, 50.0], [x + 9.0, 50.0]];
        let given = drawing([50.0, 5_000.0, 60.0, 5_100.0].map(dash).to_vec());
        let chosen = choose_order(
            std::slice::from_ref(&given),
            &given,
            &OrderOptions::default(),
            &Config::default(),
        );
        assert_eq!((chosen.given_s, chosen.chosen_s), (None, None));
        let layers = chosen.layers.expect("an order");
        assert!(sequence(&layers, SHEET_MM).pen_up_mm() < 0.5 * given.pen_up_mm());
    }
}
