//! What cannot be a machine's marks: refusals, each with what to do.

use super::marks::Mark;
use super::rigid::Rigid;
use super::{MARKS_MIN, Machine};
use crate::touches::{self, Touch};
use etherpen::config::Config;

/// Least extent of the marks in x and in y, sides of the sheet.
const EXTENT_MIN: f64 = 1.0 / 3.0;
/// Largest difference in scale between what was measured and what was drawn.
const SCALE_MAX: f64 = 0.01;
/// Least width of the marks, sides of the sheet: they may not lie on a line.
const WIDTH_MIN: f64 = 0.1;
/// Largest change, usual errors.
const CHANGE_MAX: f64 = 5.0;
/// A single mark without which a turn and a displacement leave this part, and that is so many mm off, was typed wrong.
const TYPED_PART: f64 = 0.2;
const TYPED_MM: f64 = 5.0;
/// A mark that all others predict this many times worse than usual was measured wrong; in any case by so many mm.
const WRONG_FACTOR: f64 = 6.0;
const WRONG_MM: f64 = 0.3;

/// Looks whether marks can be what was drawn; returns the frame in which they fit best to it.
pub(super) fn checked(config: &Config, marks: &[Mark]) -> Result<Rigid, String> {
    if marks.len() < MARKS_MIN {
        return Err(format!(
            "there are {} measured marks, and at least {MARKS_MIN} are needed; 25 all over the sheet are worth the time",
            marks.len()
        ));
    }
    for (axis, name) in ["x", "y"].into_iter().enumerate() {
        let range = |extreme: fn(f64, f64) -> f64, start: f64| {
            marks.iter().map(|mark| mark.wanted_mm[axis]).fold(start, extreme)
        };
        let extent_mm = range(f64::max, f64::MIN) - range(f64::min, f64::MAX);
        let least_mm = EXTENT_MIN * config.paper.size_mm[axis];
        if extent_mm < least_mm {
            return Err(format!(
                "the measured marks are {extent_mm:.0} mm apart in {name} at most; measure some that are at least {least_mm:.0} mm \
                 apart"
            ));
        }
    }
    check_width(config, marks)?;
    let wanted = |mirrored: bool| {
        let [x, y] = config.paper.centre_mm;
        let side = if mirrored { -1.0 } else { 1.0 };
        let places = marks
            .iter()
            .map(move |mark| [x + side * mark.wanted_mm[0], y + mark.wanted_mm[1]]);
        places.collect::<Vec<_>>()
    };
    let measured: Vec<[f64; 2]> = marks.iter().map(|mark| mark.measured_mm).collect();
    let (frame, scale, left_mm) = Rigid::between(&measured, &wanted(false));
    check_typed(marks, &measured, &wanted(false), left_mm)?;
    let (_, _, mirrored_mm) = Rigid::between(&measured, &wanted(true));
    if mirrored_mm < 0.5 * left_mm {
        return Err(
            "the marks are mirrored: x has to go to the right and y up, seen as the pen sees the sheet (of a scanned picture y \
             goes down)"
                .to_owned(),
        );
    }
    if !((1.0 - SCALE_MAX)..=(1.0 + SCALE_MAX)).contains(&scale) {
        return Err(format!(
            "what was drawn is {scale:.3} times as large as what was measured; measure in millimetres, and draw the pattern \
             without --fit and --size"
        ));
    }
    Ok(frame)
}

/// Refuses marks on a line.
fn check_width(config: &Config, marks: &[Mark]) -> Result<(), String> {
    let count = marks.len() as f64;
    let middle = [0, 1].map(|axis| marks.iter().map(|mark| mark.wanted_mm[axis]).sum::<f64>() / count);
    let moment = |one: usize, other: usize| {
        let parts = marks
            .iter()
            .map(|mark| (mark.wanted_mm[one] - middle[one]) * (mark.wanted_mm[other] - middle[other]));
        parts.sum::<f64>() / count
    };
    let (xx, xy, yy) = (moment(0, 0), moment(0, 1), moment(1, 1));
    let least = 0.5 * (xx + yy) - (0.5 * (xx - yy)).hypot(xy);
    match least.max(0.0).sqrt() < WIDTH_MIN * config.paper.size_mm[0].min(config.paper.size_mm[1]) {
        true => Err("the measured marks lie nearly on a line; measure some beside it".to_owned()),
        false => Ok(()),
    }
}

/// Refuses a single mark that is far from everything: a digit that was typed wrong.
fn check_typed(marks: &[Mark], measured: &[[f64; 2]], wanted: &[[f64; 2]], left_mm: f64) -> Result<(), String> {
    let without = |index: usize| {
        let others = |all: &[[f64; 2]]| {
            let kept = all.iter().enumerate().filter(|(other, _)| *other != index);
            kept.map(|(_, place)| *place).collect::<Vec<_>>()
        };
        let (frame, _, left_mm) = Rigid::between(&others(measured), &others(wanted));
        let off_mm = measured
            .get(index)
            .zip(wanted.get(index))
            .map_or(0.0, |(measured, wanted)| {
                let [x, y] = frame.of(*measured);
                (x - wanted[0]).hypot(y - wanted[1])
            });
        (left_mm, off_mm)
    };
    let found = (0..marks.len()).map(|index| (index, without(index)));
    let worst = found.min_by(|(_, (one, _)), (_, (other, _))| one.total_cmp(other));
    let Some((mark, off_mm)) = worst
        .filter(|(_, (least_mm, off_mm))| *least_mm < TYPED_PART * left_mm && *off_mm > TYPED_MM)
        .and_then(|(index, (_, off_mm))| Some((marks.get(index)?, off_mm)))
    else {
        return Ok(());
    };
    let ([x, y], [measured_x, measured_y]) = (mark.wanted_mm, mark.measured_mm);
    Err(format!(
        "the mark at {x:.1}, {y:.1} mm is {off_mm:.1} mm from its place, and all others are near theirs: \
         {measured_x}, {measured_y} may be typed wrong"
    ))
}

/// Refuses touches that are on no plane.
pub(super) fn check_touches(touches: &[Touch]) -> Result<(), String> {
    if touches.is_empty() {
        return Ok(());
    }
    let refused = |cause: touches::TouchError| format!("the touches: {cause}");
    let fit = touches::fit(touches).map_err(refused)?;
    touches::check_residual(touches, &fit).map_err(refused)
}

/// Refuses a machine that would be too far from its drawing.
pub(super) fn check_changes(machine: &Machine<'_>, changes: &[[f64; 2]]) -> Result<(), String> {
    let most = machine
        .usual()
        .zip(changes)
        .map(|(usual, [change, _])| (change / usual).abs())
        .fold(0.0, f64::max);
    match most > CHANGE_MAX {
        true => Err(format!(
            "a dimension would change by {most:.0} times what is usual: the marks were measured with a wrong scale, or the \
             configuration is far from the machine; put the dimensions of its drawing there first"
        )),
        false => Ok(()),
    }
}

/// Refuses a mark that was measured wrong.
pub(super) fn check_each(marks: &[Mark], predicted_mm: &[f64]) -> Result<(), String> {
    let mut sorted = predicted_mm.to_vec();
    sorted.sort_by(f64::total_cmp);
    let usual_mm = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let worst = marks
        .iter()
        .zip(predicted_mm)
        .max_by(|(_, one), (_, other)| one.total_cmp(other));
    match worst {
        Some((mark, mm)) if *mm > (WRONG_FACTOR * usual_mm).max(WRONG_MM) => {
            let ([x, y], [measured_x, measured_y]) = (mark.wanted_mm, mark.measured_mm);
            Err(format!(
                "the mark at {x:.1}, {y:.1} mm, measured at {measured_x}, {measured_y} mm, is {mm:.2} mm from where all others \
                 predict it, and they are usually {usual_mm:.2} mm off: measure it again, or clear what was measured"
            ))
        }
        _ => Ok(()),
    }
}
