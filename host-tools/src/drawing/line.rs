//! Polylines: length, resampling, smoothing, simplification.
//!
//! Every function keeps the first and the last point of a line, so that joined lines stay joined.

/// A point of the plane, in any unit.
pub(crate) type Point = [f64; 2];

/// Distance between two points.
pub(crate) fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Square of the distance between two points: quicker than the distance, but squares of huge or tiny numbers overflow or
/// vanish.
pub(crate) fn distance_squared(a: Point, b: Point) -> f64 {
    let (dx, dy) = (a[0] - b[0], a[1] - b[1]);
    dx * dx + dy * dy
}

/// Length of a line.
pub(crate) fn length(points: &[Point]) -> f64 {
    points.windows(2).map(|pair| distance(pair[0], pair[1])).sum()
}

/// The point at the fraction `t` of the segment from `a` to `b`.
pub(crate) fn between(a: Point, b: Point, t: f64) -> Point {
    [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
}

/// The unit vector from `a` to `b`; zero if they coincide.
pub(crate) fn direction(a: Point, b: Point) -> Point {
    let length = distance(a, b);
    if length > 0.0 {
        [(b[0] - a[0]) / length, (b[1] - a[1]) / length]
    } else {
        [0.0, 0.0]
    }
}

/// Distance of a point from the segment between `a` and `b`.
pub(crate) fn distance_to_segment(point: Point, a: Point, b: Point) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let squared = distance_squared(a, b);
    if squared == 0.0 {
        return distance(point, a);
    }
    let t = (((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / squared).clamp(0.0, 1.0);
    distance_squared(point, between(a, b, t)).sqrt()
}

/// The line with points about `step` apart.
pub(crate) fn resampled(points: &[Point], step: f64) -> Vec<Point> {
    let (Some(&first), Some(&last)) = (points.first(), points.last()) else {
        return Vec::new();
    };
    let total = length(points);
    let pieces = (total / step).round().max(1.0);
    let spacing = total / pieces;
    let mut result = vec![first];
    let mut travelled = 0.0;
    for pair in points.windows(2) {
        let piece = distance(pair[0], pair[1]);
        while piece > 0.0 && (result.len() as f64) < pieces && result.len() as f64 * spacing <= travelled + piece {
            let t = (result.len() as f64 * spacing - travelled) / piece;
            result.push(between(pair[0], pair[1], t));
        }
        travelled += piece;
    }
    result.push(last);
    result
}

/// The line with every point replaced by a Gaussian mean (`sigma` in points) of its neighbours.
///
/// Near an end the window shrinks, so that the ends do not move.
pub(crate) fn smoothed(points: &[Point], sigma: f64) -> Vec<Point> {
    let reach = (2.5 * sigma).ceil() as usize;
    let last = points.len().saturating_sub(1);
    (0..points.len())
        .map(|k| {
            let reach = reach.min(k).min(last - k);
            let (mut x, mut y, mut sum) = (0.0, 0.0, 0.0);
            for (offset, point) in points[k - reach..=k + reach].iter().enumerate() {
                let weight = (-0.5 * ((offset as f64 - reach as f64) / sigma).powi(2)).exp();
                x += weight * point[0];
                y += weight * point[1];
                sum += weight;
            }
            [x / sum, y / sum]
        })
        .collect()
}

/// The line without the points that are within `tolerance` of the remaining line (Ramer, Douglas and Peucker).
pub(crate) fn simplified(points: &[Point], tolerance: f64) -> Vec<Point> {
    if points.len() < 3 {
        return points.to_vec();
    }
    let mut keep = vec![false; points.len()];
    keep[0] = true;
    keep[points.len() - 1] = true;
    let mut open = vec![(0, points.len() - 1)];
    while let Some((from, to)) = open.pop() {
        let farthest = (from + 1..to)
            .map(|k| (k, distance_to_segment(points[k], points[from], points[to])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((k, away)) = farthest
            && away > tolerance
        {
            keep[k] = true;
            open.push((from, k));
            open.push((k, to));
        }
    }
    points
        .iter()
        .zip(keep)
        .filter(|(_, kept)| *kept)
        .map(|(&point, _)| point)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave() -> Vec<Point> {
        (0..200)
            .map(|k| [f64::from(k) * 0.1, (f64::from(k) * 0.1).sin()])
            .collect()
    }

    #[test]
    fn a_simplified_line_stays_within_the_tolerance_with_fewer_points() {
        let line = wave();
        let simple = simplified(&line, 0.05);
        assert!(simple.len() < 40, "{}", simple.len());
        for &point in &line {
            let away = simple
                .windows(2)
                .map(|pair| distance_to_segment(point, pair[0], pair[1]))
                .fold(9.0, f64::min);
            assert!(away <= 0.05, "{away}");
        }
    }

    #[test]
    fn even_steps_keep_ends_and_length() {
        let line = wave();
        let even = resampled(&line, 0.25);
        assert_eq!((even[0], even[even.len() - 1]), (line[0], line[199]));
        assert!((length(&even) / length(&line) - 1.0).abs() < 0.01);
        for pair in even.windows(2) {
            assert!((distance(pair[0], pair[1]) - 0.25).abs() < 0.02);
        }
    }

    #[test]
    fn smoothing_keeps_ends_and_shortens_noise() {
        let noisy: Vec<Point> = (0..100).map(|k| [f64::from(k), f64::from(k % 2)]).collect();
        let calm = smoothed(&noisy, 2.0);
        assert_eq!((calm[0], calm[99]), (noisy[0], noisy[99]));
        assert!(length(&calm) < 0.75 * length(&noisy));
    }
}
