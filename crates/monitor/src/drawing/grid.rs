//! A plane divided into square cells with numbers in them, to find what is near a place.
//!
//! Cells share a fixed number of buckets, so that no place is outside. Cells that share a bucket cost time, never a
//! wrong answer: a caller checks the distance of everything that it is given.

/// Number of buckets, a power of two.
const BUCKETS: usize = 1 << 13;
/// No entry.
const NONE: u32 = u32::MAX;
/// Most cells around a place that are searched in each direction.
const REACH_MAX: i64 = 24;

/// A plane with numbers in its cells.
#[derive(Clone, Debug)]
pub(crate) struct Grid {
    cell_mm: f64,
    heads: Vec<u32>,
    /// Number, and the next entry of the bucket.
    entries: Vec<(u32, u32)>,
}

impl Grid {
    pub(crate) fn new(cell_mm: f64) -> Self {
        Self {
            cell_mm,
            heads: vec![NONE; BUCKETS],
            entries: Vec::new(),
        }
    }

    pub(crate) fn clear(&mut self) {
        if !self.entries.is_empty() {
            self.heads.fill(NONE);
            self.entries.clear();
        }
    }

    /// The cell of a place.
    pub(crate) fn cell(&self, x_mm: f64, y_mm: f64) -> (i64, i64) {
        // A float that is too large, or no number, becomes the nearest integer or 0.
        (
            (x_mm / self.cell_mm).floor() as i64,
            (y_mm / self.cell_mm).floor() as i64,
        )
    }

    /// Puts a number into a cell.
    pub(crate) fn insert(&mut self, cell: (i64, i64), number: u32) {
        let Ok(entry) = u32::try_from(self.entries.len()) else {
            return;
        };
        let Some(head) = self.heads.get_mut(bucket(cell)) else {
            return;
        };
        self.entries.push((number, *head));
        *head = entry;
    }

    /// Calls `found` with each number that may be within a distance of a place, until it returns true; a number may
    /// come more than once. Returns whether one of the calls did.
    #[inline]
    pub(crate) fn any_near(&self, x_mm: f64, y_mm: f64, distance_mm: f64, mut found: impl FnMut(u32) -> bool) -> bool {
        let reach = ((distance_mm / self.cell_mm).ceil() as i64).clamp(1, REACH_MAX);
        let (x, y) = self.cell(x_mm, y_mm);
        for x in x.saturating_sub(reach)..=x.saturating_add(reach) {
            for y in y.saturating_sub(reach)..=y.saturating_add(reach) {
                let mut entry = self.heads.get(bucket((x, y))).copied().unwrap_or(NONE);
                while let Some((number, next)) = self.entries.get(entry as usize) {
                    if found(*number) {
                        return true;
                    }
                    entry = *next;
                }
            }
        }
        false
    }
}

fn bucket((x, y): (i64, i64)) -> usize {
    let mixed = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (y as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
    (mixed >> 40) as usize & (BUCKETS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn everything_within_the_distance_is_found(
            places in proptest::collection::vec((-600.0_f64..600.0, -600.0_f64..600.0), 1..60),
            at in (-600.0_f64..600.0, -600.0_f64..600.0),
            distance in 0.1_f64..40.0,
        ) {
            let mut grid = Grid::new(4.0);
            for (number, (x, y)) in (0..).zip(&places) {
                grid.insert(grid.cell(*x, *y), number);
            }
            for (number, (x, y)) in (0..).zip(&places) {
                if (x - at.0).hypot(y - at.1) <= distance {
                    prop_assert!(grid.any_near(at.0, at.1, distance, |found| found == number));
                }
            }
        }
    }

    #[test]
    fn nonsense_is_a_place_like_any_other() {
        let mut grid = Grid::new(4.0);
        for value in [f64::NAN, f64::INFINITY, -1e300] {
            grid.insert(grid.cell(value, 0.0), 7);
            assert!(grid.any_near(value, 0.0, f64::NAN, |found| found == 7));
        }
        grid.clear();
        assert!(!grid.any_near(0.0, 0.0, f64::INFINITY, |_| true));
    }
}
