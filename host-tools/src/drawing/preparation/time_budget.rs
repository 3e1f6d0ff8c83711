//! Fits a photograph into a drawing time: coarser lines, until the firmware's planner computes a short enough time.
//!
//! The picture is drawn as if with a wider pen: lines are farther apart, and finer details are left out, in the whole
//! picture, but in faces less than elsewhere. The required width is found by planning; a little too much time is met by
//! leaving out short strokes, none that touches a face whose features are known.
//!
//! Invariant: the drawing takes no longer than its time limit, and at least [`SHARE_MIN`] of it unless the whole
//! picture takes less.

use super::choose_order::{choose_order, travelling};
use crate::drawing::{Drawing, DrawingError, OrderOptions, Stroke};
use crate::planning::planned_s;
use etherpen::config::Config;

/// Least share of the time limit that is used.
const SHARE_MIN: f64 = 0.97;
/// Share of the time limit that is aimed at.
const SHARE_AIM: f64 = 0.985;
/// Largest share of the time limit at which short strokes are left out; a drawing that takes longer is computed again.
const SHARE_THINNED: f64 = 1.12;
/// Fewest strokes of a drawing from which some can be left out without a visible gap.
const THINNED_STROKES_MIN: usize = 60;
/// Most drawings computed.
const TRIES: usize = 24;
/// Tries after which widths outside the remaining range are tried, and the step between them.
const SCATTERED_FROM: usize = 10;
const SCATTER: f64 = 0.003;
/// Most repetitions of leaving strokes out until the time fits.
const THINNINGS: usize = 6;
/// Exponent with which the time falls with the pen's width: the initial value, and its bounds.
const POWER: f64 = 1.3;
const POWER_RANGE: [f64; 2] = [0.5, 3.0];
/// Widest pen tried, as a multiple of the real width.
const WIDEST: f64 = 64.0;

/// A drawing in its order, and its planned duration, s.
pub(super) struct Timed {
    pub(super) drawing: Drawing,
    pub(super) planned_s: f64,
}

/// The most detailed drawing that takes no longer than `budget_s`; `draw` makes one for a multiple of the pen's width, and no
/// stroke with a point that `is_kept` is left out of it.
///
/// # Errors
/// Errors of `draw` with the real pen, and [`DrawingError::TimeTooShort`].
pub(super) fn within(
    budget_s: f64,
    config: &Config,
    options: &OrderOptions,
    draw: impl Fn(f64) -> Result<Drawing, DrawingError>,
    is_kept: impl Fn([f64; 2]) -> bool,
) -> Result<Option<Timed>, DrawingError> {
    let whole = timed(draw(1.0)?, config, options);
    // A drawing that the robot cannot execute has no time; the check of positions refuses it.
    if !whole.planned_s.is_finite() || whole.planned_s <= budget_s {
        return Ok(Some(whole).filter(|whole| whole.planned_s.is_finite()));
    }
    let (mut best, mut shortest_s): (Option<Timed>, f64) = (None, whole.planned_s);
    // Widths that take too long, and widths that take too little, each with its time.
    let (mut slow, mut quick) = ((1.0_f64, whole.planned_s), None::<(f64, f64)>);
    let mut width = (whole.planned_s / (SHARE_AIM * budget_s)).powf(1.0 / POWER);
    for attempt in 0..TRIES {
        if let (Some(quick), true) = (quick, attempt >= SCATTERED_FROM) {
            width = scattered_width(slow, quick, attempt - SCATTERED_FROM);
        }
        width = width.min(WIDEST);
        let Some(tried) = draw(width).ok().map(|drawing| timed(drawing, config, options)) else {
            // A pen this wide draws nothing.
            quick = Some((width, 0.0));
            width = (slow.0 * width).sqrt();
            continue;
        };
        shortest_s = shortest_s.min(tried.planned_s);
        let share = tried.planned_s / budget_s;
        if (SHARE_MIN..=1.0).contains(&share) {
            return Ok(Some(tried));
        }
        if share > 1.0 {
            if share <= SHARE_THINNED
                && let Some(thinned) = thinned(&tried, budget_s, config, &is_kept)
            {
                return Ok(Some(thinned));
            }
            if width >= WIDEST {
                break;
            }
            slow = (width, tried.planned_s);
        } else {
            quick = Some((width, tried.planned_s));
            if best.as_ref().is_none_or(|best| best.planned_s < tried.planned_s) {
                best = Some(tried);
            }
        }
        width = next_width(slow, quick, SHARE_AIM * budget_s);
    }
    match best {
        Some(best) => Ok(Some(best)),
        None => Err(DrawingError::TimeTooShort {
            asked_ms: (budget_s * 1_000.0) as u64,
            shortest_ms: (shortest_s * 1_000.0) as u64,
        }),
    }
}

/// The width between two, or beyond the first, at which the estimated time is the one aimed at.
fn next_width(slow: (f64, f64), quick: Option<(f64, f64)>, aim_s: f64) -> f64 {
    let Some(quick) = quick else {
        return slow.0 * (slow.1 / aim_s).max(1.02).powf(1.0 / POWER);
    };
    let middle = (slow.0 * quick.0).sqrt();
    let power = (slow.1 / quick.1).ln() / (quick.0 / slow.0).ln();
    if !power.is_finite() {
        return middle;
    }
    let width = slow.0 * (slow.1 / aim_s).powf(1.0 / power.clamp(POWER_RANGE[0], POWER_RANGE[1]));
    // A try at an end of the range would add no information.
    let room = (quick.0 / slow.0).powf(0.1);
    width.clamp(slow.0.min(quick.0) * room, (quick.0 / room).max(slow.0 * room))
}

/// Widths on both sides of the remaining range: a single line's time is not a smooth function of the width.
fn scattered_width(slow: (f64, f64), quick: (f64, f64), attempt: usize) -> f64 {
    let side = if attempt.is_multiple_of(2) { 1.0 } else { -1.0 };
    (slow.0 * quick.0).sqrt() * (1.0 + side * SCATTER * (attempt / 2 + 1) as f64)
}

fn timed(drawing: Drawing, config: &Config, options: &OrderOptions) -> Timed {
    let chosen = choose_order(std::slice::from_ref(&drawing), &drawing, options, config);
    let ordered = chosen.layers.and_then(|mut layers| layers.pop()).unwrap_or(drawing);
    Timed {
        drawing: ordered,
        planned_s: chosen.chosen_s.unwrap_or(f64::NAN),
    }
}

/// The drawing without some of the shorter half of the strokes that need not be kept, evenly along its order, so that it meets
/// the time limit.
fn thinned(whole: &Timed, budget_s: f64, config: &Config, is_kept: &impl Fn([f64; 2]) -> bool) -> Option<Timed> {
    let strokes = &whole.drawing.strokes;
    let touches = |stroke: &Stroke| {
        let middles = stroke.points.iter().zip(stroke.points.iter().skip(1));
        let middles = middles.map(|(from, to)| [0, 1].map(|k| 0.5 * (from[k] + to[k])));
        stroke.points.iter().copied().chain(middles).any(is_kept)
    };
    let may_go: Vec<bool> = strokes.iter().map(|stroke| !touches(stroke)).collect();
    let mut lengths: Vec<f64> = (strokes.iter().zip(&may_go))
        .filter(|(_, may_go)| **may_go)
        .map(|(stroke, _)| stroke.length_mm())
        .collect();
    if lengths.len() < THINNED_STROKES_MIN {
        return None;
    }
    lengths.sort_by(f64::total_cmp);
    let median_mm = lengths.get(lengths.len() / 2).copied().unwrap_or_default();
    let mut share = 1.6 * (1.0 - SHARE_AIM * budget_s / whole.planned_s);
    for _ in 0..THINNINGS {
        let mut owed = 0.5;
        let kept = strokes.iter().zip(&may_go).filter(|(stroke, may_go)| {
            if !**may_go || stroke.length_mm() > median_mm {
                return true;
            }
            owed += 2.0 * share;
            let stays = owed < 1.0;
            owed -= if stays { 0.0 } else { 1.0 };
            stays
        });
        let drawing = Drawing {
            sheet_mm: whole.drawing.sheet_mm,
            strokes: kept.map(|(stroke, _)| stroke.clone()).collect(),
        };
        let planned_s = planned_s(config, &travelling(&drawing, config));
        if (SHARE_MIN * budget_s..=budget_s).contains(&planned_s) {
            return Some(Timed { drawing, planned_s });
        }
        let removed_s = whole.planned_s - planned_s;
        if removed_s <= 0.0 || !removed_s.is_finite() {
            return None;
        }
        share *= (whole.planned_s - SHARE_AIM * budget_s) / removed_s;
        if share > 0.4 {
            return None;
        }
    }
    None
}

#[cfg(test)]
mod tests;
