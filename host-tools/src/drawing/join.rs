//! Ends of lines: which lie near each other, and lines joined end to end.
//!
//! End `2 k` of a set of lines is the start of line `k`, end `2 k + 1` its last point.

use super::line::Point;

/// Points in square cells, so that near ones are found without looking at all.
pub(crate) struct Near {
    origin: Point,
    cell: f64,
    columns: usize,
    rows: usize,
    cells: Vec<Vec<usize>>,
}

impl Near {
    /// An index of `points` with about two points a cell.
    pub(crate) fn of(points: &[Point]) -> Self {
        let low = [0, 1].map(|axis| points.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min));
        let high = [0, 1].map(|axis| points.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max));
        let size = [0, 1].map(|axis| (high[axis] - low[axis]).max(1e-6));
        let per_cell = 2.0 / points.len().max(1) as f64;
        let cell = (size[0] * size[1] * per_cell).sqrt().max(size[0].max(size[1]) / 2000.0);
        let (columns, rows) = ((size[0] / cell) as usize + 1, (size[1] / cell) as usize + 1);
        let mut result = Self {
            origin: low,
            cell,
            columns,
            rows,
            cells: vec![Vec::new(); columns * rows],
        };
        for (k, &point) in points.iter().enumerate() {
            let (column, row) = result.cell_of(point);
            result.cells[row * columns + column].push(k);
        }
        result
    }

    fn cell_of(&self, point: Point) -> (usize, usize) {
        let at = |axis: usize, count: usize| {
            (((point[axis] - self.origin[axis]) / self.cell).max(0.0) as usize).min(count - 1)
        };
        (at(0, self.columns), at(1, self.rows))
    }

    /// Takes a point out of the index.
    pub(crate) fn remove(&mut self, k: usize, point: Point) {
        let (column, row) = self.cell_of(point);
        self.cells[row * self.columns + column].retain(|&other| other != k);
    }

    /// Distance to which everything is known after rings 0 to `ring` of cells.
    pub(crate) fn reach(&self, ring: usize) -> f64 {
        ring as f64 * self.cell
    }

    /// Number of rings that cover everything from anywhere.
    pub(crate) fn rings(&self) -> usize {
        self.columns.max(self.rows)
    }

    /// Calls `visit` with each point in the cells that are `ring` cells away from the point's own.
    pub(crate) fn visit_ring(&self, point: Point, ring: usize, mut visit: impl FnMut(usize)) {
        let (column, row) = self.cell_of(point);
        let (left, top) = (column as isize - ring as isize, row as isize - ring as isize);
        let (right, bottom) = (column + ring, row + ring);
        for y in top.max(0) as usize..=bottom.min(self.rows - 1) {
            let edge_row = y as isize == top || y == bottom;
            let step = if edge_row || ring == 0 { 1 } else { 2 * ring };
            let mut x = left;
            while x <= right as isize {
                if x >= 0 && (x as usize) < self.columns {
                    self.cells[y * self.columns + x as usize].iter().for_each(|&k| visit(k));
                }
                x += step as isize;
            }
        }
    }

    /// Calls `visit` with each point within `radius` (and some beyond).
    pub(crate) fn visit_within(&self, point: Point, radius: f64, mut visit: impl FnMut(usize)) {
        let rings = ((radius / self.cell).ceil() as usize).min(self.rings());
        for ring in 0..=rings {
            self.visit_ring(point, ring, &mut visit);
        }
    }
}

/// Both ends of every line.
pub(crate) fn ends(lines: &[Vec<Point>]) -> Vec<Point> {
    lines
        .iter()
        .flat_map(|points| [0, points.len().saturating_sub(1)].map(|k| points.get(k).copied().unwrap_or_default()))
        .collect()
}

/// Joins lines across bridges (length, end, end), the shortest first; no end twice, no closed loop.
pub(crate) fn join_ends(lines: &[Vec<Point>], mut bridges: Vec<(f64, usize, usize)>) -> Vec<Vec<Point>> {
    bridges.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut partner = vec![None; 2 * lines.len()];
    let mut chain: Vec<usize> = (0..lines.len()).collect();
    for (_, a, b) in bridges {
        let (one, other) = (root(&mut chain, a / 2), root(&mut chain, b / 2));
        if partner[a].is_none() && partner[b].is_none() && one != other {
            (partner[a], partner[b]) = (Some(b), Some(a));
            chain[one] = other;
        }
    }
    let mut used = vec![false; lines.len()];
    let mut result = Vec::new();
    for start in 0..partner.len() {
        if partner[start].is_some() || used[start / 2] {
            continue;
        }
        let mut points: Vec<Point> = Vec::new();
        let mut entry = Some(start);
        while let Some(end) = entry {
            let line = &lines[end / 2];
            used[end / 2] = true;
            if end % 2 == 0 {
                points.extend(line);
            } else {
                points.extend(line.iter().rev());
            }
            entry = partner[end ^ 1];
        }
        points.dedup();
        result.push(points);
    }
    result
}

/// The representative of a chain.
fn root(chain: &mut [usize], mut k: usize) -> usize {
    while chain[k] != k {
        chain[k] = chain[chain[k]];
        k = chain[k];
    }
    k
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::line;

    #[test]
    fn near_points_are_all_found() {
        let points: Vec<Point> = (0..500_u32)
            .map(|k| [f64::from(k * 7919 % 1000), f64::from(k * 104_729 % 613)])
            .collect();
        let index = Near::of(&points);
        for &centre in points.iter().step_by(50) {
            let mut found = Vec::new();
            index.visit_within(centre, 60.0, |k| found.push(k));
            for (k, &point) in points.iter().enumerate() {
                let count = found.iter().filter(|&&other| other == k).count();
                assert!(count <= 1 && (count == 1 || line::distance(point, centre) > 60.0));
            }
        }
    }

    #[test]
    fn lines_are_joined_in_either_direction_and_never_to_a_loop() {
        let lines = vec![
            vec![[0.0, 0.0], [1.0, 0.0]],
            vec![[3.0, 0.0], [1.0, 0.0]],
            vec![[3.0, 0.0], [0.0, 0.0]],
        ];
        let joined = join_ends(&lines, vec![(0.0, 1, 3), (0.0, 2, 4), (0.0, 5, 0)]);
        assert_eq!(joined, [vec![[0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [0.0, 0.0]]]);
    }
}
