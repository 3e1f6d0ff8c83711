//! Converts dashed lines into strokes.

use super::line::{self, Point};

/// The drawn parts of a dashed line; `dashes` are alternating lengths of dashes and gaps.
pub(super) fn cut_into_dashes(points: &[Point], dashes: &[f64], offset: f64) -> Vec<Vec<Point>> {
    let period: f64 = dashes.iter().sum();
    let (mut index, mut left) = (0, offset.rem_euclid(period));
    while left >= dashes[index] && index + 1 < dashes.len() {
        left -= dashes[index];
        index += 1;
    }
    let mut left = (dashes[index] - left).max(0.0);
    let mut result = Vec::new();
    let mut dash: Vec<Point> = points.iter().take(1).copied().collect();
    for pair in points.windows(2) {
        let piece = line::distance(pair[0], pair[1]);
        let mut done = 0.0;
        while piece - done > left {
            done += left;
            let at = line::between(pair[0], pair[1], done / piece);
            if index.is_multiple_of(2) {
                dash.push(at);
                result.push(std::mem::take(&mut dash));
            }
            index = (index + 1) % dashes.len();
            left = dashes[index];
            dash = vec![at];
        }
        left -= piece - done;
        dash.push(pair[1]);
    }
    if index.is_multiple_of(2) {
        result.push(dash);
    }
    for dash in &mut result {
        dash.dedup();
    }
    result.retain(|dash| dash.len() > 1);
    result
}
