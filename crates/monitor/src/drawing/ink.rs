//! The ink of a drawing, in the robot's frame seen from above.

use super::grid::Grid;

/// Side of a cell, mm.
const CELL_MM: f64 = 1.0;
/// Points nearer to the last one are left out, mm.
const APART_MM: f64 = 0.05;

/// Points of ink, one for each millisecond in which the pen touched.
#[derive(Clone, Debug)]
pub(crate) struct Ink {
    grid: Grid,
    points: Vec<[f64; 2]>,
}

impl Ink {
    pub(crate) fn new() -> Self {
        Self {
            grid: Grid::new(CELL_MM),
            points: Vec::new(),
        }
    }

    pub(crate) fn clear(&mut self) {
        self.grid.clear();
        self.points.clear();
    }

    /// Adds the point that the pen touches.
    pub(crate) fn add(&mut self, x_mm: f64, y_mm: f64) {
        let is_near = |point: &[f64; 2]| (point[0] - x_mm).abs() < APART_MM && (point[1] - y_mm).abs() < APART_MM;
        if self.points.last().is_some_and(is_near) {
            return;
        }
        let Ok(number) = u32::try_from(self.points.len()) else {
            return;
        };
        self.points.push([x_mm, y_mm]);
        self.grid.insert(self.grid.cell(x_mm, y_mm), number);
    }

    /// Whether there is ink within a distance of a place.
    pub(crate) fn covers(&self, x_mm: f64, y_mm: f64, distance_mm: f64) -> bool {
        self.grid.any_near(x_mm, y_mm, distance_mm, |number| {
            self.points.get(number as usize).is_some_and(|[x, y]| {
                let (x, y) = (x - x_mm, y - y_mm);
                x * x + y * y <= distance_mm * distance_mm
            })
        })
    }
}
