//! Joins lines end to end, with an index for nearby ends.
//!
//! End `2 k` of a set of lines is the start of line `k`, end `2 k + 1` is its last point.

use super::line::{Point, distance};

/// Average number of ends checked for each line before the remaining rings are opened without a search.
const RING_STEPS_A_LINE: usize = 100;
/// Most points in one cell that a point of that cell checks.
const CROWD: usize = 4_096;

/// Points in square cells, to find nearby points without checking all of them.
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

    /// Removes a point from the index.
    pub(crate) fn remove(&mut self, k: usize, point: Point) {
        let (column, row) = self.cell_of(point);
        self.cells[row * self.columns + column].retain(|&other| other != k);
    }

    /// Distance up to which all points are known after rings 0 to `ring` of cells.
    pub(crate) fn reach(&self, ring: usize) -> f64 {
        ring as f64 * self.cell
    }

    /// Number of rings that cover all cells from any place.
    pub(crate) fn rings(&self) -> usize {
        self.columns.max(self.rows)
    }

    /// Calls `visit` with each point in the cells that are `ring` cells away from the point's cell.
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

    /// Calls `visit` with each point within `radius` (and some beyond). Where very many points coincide, for instance
    /// where a thousand rays begin, each checks only some: those that follow it in the cell, so that every point is
    /// checked by others.
    pub(crate) fn visit_within(&self, k: usize, point: Point, radius: f64, mut visit: impl FnMut(usize)) {
        let (column, row) = self.cell_of(point);
        let rings = ((radius / self.cell).ceil() as usize).min(self.rings());
        for y in row.saturating_sub(rings)..=(row + rings).min(self.rows - 1) {
            for x in column.saturating_sub(rings)..=(column + rings).min(self.columns - 1) {
                let cell = &self.cells[y * self.columns + x];
                let next = cell.partition_point(|&other| other <= k);
                let following = cell.iter().skip(next).chain(cell.iter().take(next));
                following.take(CROWD).for_each(|&other| visit(other));
            }
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

/// Joins lines across bridges (length, end, end) into few lines; no end is used twice, and lines are joined only across
/// bridges.
///
/// The shortest bridges are used first. Then two open ends at one joint split the joint and take one of its ends each.
/// A ring is merged into another line at an end where they meet, as in Hierholzer's algorithm; a ring that meets no
/// line is opened at its longest bridge.
pub(crate) fn join_ends(lines: &[Vec<Point>], mut bridges: Vec<(f64, usize, usize)>) -> Vec<Vec<Point>> {
    bridges.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut joints = Joints::new(ends(lines), &bridges);
    bridges.iter().for_each(|&(_, a, b)| joints.join(a, b));
    joints.exchange();
    joints.open_rings();
    joints.walked(lines)
}

/// Joints between the ends of lines.
struct Joints {
    ends: Vec<Point>,
    partner: Vec<Option<usize>>,
    /// The ends to which an end may be joined, the nearest first.
    near: Vec<Vec<usize>>,
}

impl Joints {
    fn new(ends: Vec<Point>, bridges: &[(f64, usize, usize)]) -> Self {
        let mut near = vec![Vec::new(); ends.len()];
        for &(_, a, b) in bridges {
            near[a].push(b);
            near[b].push(a);
        }
        Self {
            partner: vec![None; ends.len()],
            ends,
            near,
        }
    }

    /// Joins two open ends.
    fn join(&mut self, a: usize, b: usize) {
        if self.partner[a].is_none() && self.partner[b].is_none() {
            (self.partner[a], self.partner[b]) = (Some(b), Some(a));
        }
    }

    /// Opens the joint of an end.
    fn part(&mut self, a: usize) {
        if let Some(b) = self.partner[a].take() {
            self.partner[b] = None;
        }
    }

    /// Replaces one joint by two wherever two open ends can take one of its ends each.
    fn exchange(&mut self) {
        for open in 0..self.partner.len() {
            if self.partner[open].is_some() {
                continue;
            }
            let found = self.near[open].iter().find_map(|&a| {
                let b = self.partner[a]?;
                let is_free = |&other: &usize| other != open && self.partner[other].is_none();
                Some((a, b, self.near[b].iter().copied().find(is_free)?))
            });
            if let Some((a, b, other)) = found {
                self.part(a);
                self.join(open, a);
                self.join(b, other);
            }
        }
    }

    /// Merges every ring into a line that it meets, or opens it.
    fn open_rings(&mut self) {
        let mut group: Vec<usize> = (0..self.ends.len() / 2).collect();
        for end in 0..self.ends.len() {
            if let Some(other) = self.partner[end] {
                let (one, other) = (root(&mut group, end / 2), root(&mut group, other / 2));
                group[one] = other;
            }
        }
        let mut has_open_end = vec![false; group.len()];
        for end in (0..self.ends.len()).filter(|&end| self.partner[end].is_none()) {
            has_open_end[root(&mut group, end / 2)] = true;
        }
        let mut budget = RING_STEPS_A_LINE * group.len();
        for line in 0..group.len() {
            let ring = root(&mut group, line);
            if has_open_end[ring] {
                continue;
            }
            match self.meeting(2 * line, ring, &mut group, &mut budget) {
                Some((end, other)) => {
                    let into = root(&mut group, other / 2);
                    self.splice(end, other);
                    group[ring] = into;
                }
                None => {
                    self.open(2 * line);
                    has_open_end[ring] = true;
                }
            }
        }
    }

    /// An end of the ring through `first`, and the end of another line that replaces it at the joint.
    fn meeting(&self, first: usize, ring: usize, group: &mut [usize], budget: &mut usize) -> Option<(usize, usize)> {
        let mut entry = first;
        loop {
            for end in [entry, entry ^ 1] {
                let partner = self.partner[end]?;
                for &other in &self.near[end] {
                    *budget = budget.checked_sub(1)?;
                    let fits = self.partner[other].is_none_or(|far| self.near[partner].contains(&far));
                    if fits && root(group, other / 2) != ring {
                        return Some((end, other));
                    }
                }
            }
            entry = self.partner[entry ^ 1].filter(|&next| next != first)?;
        }
    }

    /// Joins an end of a ring to another end, and the ends that both were joined to.
    fn splice(&mut self, end: usize, other: usize) {
        let (partner, far) = (self.partner[end], self.partner[other]);
        self.part(end);
        self.part(other);
        self.join(end, other);
        if let (Some(partner), Some(far)) = (partner, far) {
            self.join(partner, far);
        }
    }

    /// Opens the ring through `first` at its longest bridge.
    fn open(&mut self, first: usize) {
        let (mut longest, mut entry) = ((0.0, first), first);
        while let Some(next) = self.partner[entry ^ 1] {
            let bridge = distance(self.ends[entry ^ 1], self.ends[next]);
            if bridge > longest.0 {
                longest = (bridge, next);
            }
            entry = next;
            if entry == first {
                break;
            }
        }
        self.part(longest.1);
    }

    /// The joined lines, each from an open end.
    fn walked(&self, lines: &[Vec<Point>]) -> Vec<Vec<Point>> {
        let mut used = vec![false; lines.len()];
        let mut result = Vec::new();
        for start in 0..self.partner.len() {
            if self.partner[start].is_some() || used[start / 2] {
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
                entry = self.partner[end ^ 1];
            }
            points.dedup();
            result.push(points);
        }
        result
    }
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
        for (number, &centre) in points.iter().enumerate().step_by(50) {
            let mut found = Vec::new();
            index.visit_within(number, centre, 60.0, |k| found.push(k));
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

    #[test]
    fn in_a_crowd_each_point_sees_some_and_is_seen() {
        let points = vec![[1.0, 2.0]; CROWD + 500];
        let index = Near::of(&points);
        let mut seen = vec![0; points.len()];
        for (number, &point) in points.iter().enumerate() {
            index.visit_within(number, point, 0.5, |other| seen[other] += 1);
        }
        assert!(seen.iter().all(|&count| count == CROWD), "{:?}", seen.iter().max());
    }

    /// All bridges between ends at one point.
    fn meetings(lines: &[Vec<Point>]) -> Vec<(f64, usize, usize)> {
        let ends = ends(lines);
        let pairs = (0..ends.len()).flat_map(|a| (a + 1..ends.len()).map(move |b| (a, b)));
        pairs
            .filter(|&(a, b)| ends[a] == ends[b])
            .map(|(a, b)| (0.0, a, b))
            .collect()
    }

    #[test]
    fn rings_are_drawn_on_the_way_of_a_line_that_meets_them() {
        let ring = |x: f64| vec![[x, 0.0], [x + 1.0, 1.0], [x, 1.0], [x, 0.0]];
        let line = |from: f64, to: f64| vec![[from, 0.0], [to, 0.0]];
        // A ring at an open end, one at a joint, two that meet, and one alone.
        let lines = vec![
            ring(0.0),
            line(0.0, 5.0),
            line(5.0, 9.0),
            ring(5.0),
            ring(20.0),
            ring(20.0),
            ring(40.0),
        ];
        let joined = join_ends(&lines, meetings(&lines));
        let counts: Vec<usize> = joined.iter().map(Vec::len).collect();
        assert_eq!(counts.iter().sum::<usize>(), 4 * 5 + 2 * 2 - 3 - 1, "{joined:?}");
        assert_eq!(joined.len(), 3, "{joined:?}");
    }

    #[test]
    fn a_net_takes_as_many_lines_as_half_its_odd_crossings() {
        // Every side of a net of squares is a line: 4 (n - 1) crossings on the rim have three of them.
        let n = 9_u32;
        let at = |x: u32, y: u32| [f64::from(x), f64::from(y)];
        let mut lines = Vec::new();
        for (x, y) in (0..=n).flat_map(|x| (0..=n).map(move |y| (x, y))) {
            if x < n {
                lines.push(vec![at(x, y), at(x + 1, y)]);
            }
            if y < n {
                lines.push(vec![at(x, y + 1), at(x, y)]);
            }
        }
        let joined = join_ends(&lines, meetings(&lines));
        assert_eq!(joined.len(), (4 * (n as usize - 1)) / 2);
        assert_eq!(joined.iter().map(|line| line.len() - 1).sum::<usize>(), lines.len());
    }
}
