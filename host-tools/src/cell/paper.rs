//! The sheet of paper and the ink of the spring-loaded pen on it.
//!
//! The pen leaves one point every millisecond while it touches the sheet. Coordinates are the sheet's: millimetres, x
//! to the right, y downwards, the origin in the top left corner.

use etherpen::config::Paper;
use etherpen::robots::Position;

/// Height above its drawing height up to which the spring-loaded pen touches, mm.
pub const PEN_SPRING_MM: f64 = 0.3;

/// One uninterrupted line of ink.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InkStroke {
    /// Cell time of the first point, milliseconds since the cell's start.
    pub start_ms: u64,
    /// The points, one for each millisecond, mm on the sheet.
    pub points_mm: Vec<[f64; 2]>,
    /// Number of points off the sheet.
    pub points_outside: usize,
}

impl InkStroke {
    /// Length of the line, mm.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        let pairs = self.points_mm.windows(2);
        pairs
            .map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]))
            .sum()
    }

    /// Distance of a point on the sheet from the line, mm; infinite for a line of fewer than two points.
    #[must_use]
    pub fn distance_mm(&self, point: &[f64; 2]) -> f64 {
        let to_segment = |pair: &[[f64; 2]]| {
            let along = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
            let from = [point[0] - pair[0][0], point[1] - pair[0][1]];
            let squared = along[0] * along[0] + along[1] * along[1];
            let share = match squared > 0.0 {
                true => ((from[0] * along[0] + from[1] * along[1]) / squared).clamp(0.0, 1.0),
                false => 0.0,
            };
            (from[0] - share * along[0]).hypot(from[1] - share * along[1])
        };
        self.points_mm.windows(2).map(to_segment).fold(f64::INFINITY, f64::min)
    }
}

/// The sheet and the ink on it.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    paper: Paper,
    strokes: Vec<InkStroke>,
    touching: bool,
    contacts_outside: u64,
    pressed_max_mm: f64,
}

impl Sheet {
    pub(super) fn new(paper: Paper) -> Self {
        Self {
            paper,
            strokes: Vec::new(),
            touching: false,
            contacts_outside: 0,
            pressed_max_mm: 0.0,
        }
    }

    /// The ink so far; the last stroke may still grow.
    pub(super) fn ink(&self) -> &[InkStroke] {
        &self.strokes
    }

    /// Puts an empty sheet in this one's place. A pen that touches begins a stroke on it.
    #[cfg(test)]
    pub(super) fn replace(&mut self) {
        (self.strokes, self.touching) = (Vec::new(), false);
    }

    /// Whether the pen touches the sheet.
    pub(super) fn touching(&self) -> bool {
        self.touching
    }

    /// Milliseconds in which the pen touched the surface off the sheet.
    pub(super) fn contacts_outside(&self) -> u64 {
        self.contacts_outside
    }

    /// How far the platform was below the height at which the pen draws, at most, mm.
    pub(super) fn pressed_max_mm(&self) -> f64 {
        self.pressed_max_mm
    }

    /// Takes the platform's position at one millisecond.
    pub(super) fn step(&mut self, time_ms: u64, platform: Position) {
        let [from_centre_x_mm, from_centre_y_mm] = [
            platform.x_mm - self.paper.centre_mm[0],
            platform.y_mm - self.paper.centre_mm[1],
        ];
        let rise_mm = self.paper.slope[0] * from_centre_x_mm + self.paper.slope[1] * from_centre_y_mm;
        let above_mm = platform.z_mm - self.paper.pen_down_z_mm - rise_mm;
        let touches = above_mm <= PEN_SPRING_MM;
        self.pressed_max_mm = self.pressed_max_mm.max(-above_mm);
        if touches {
            let [x_mm, y_mm] = self.on_sheet(platform);
            let [width_mm, height_mm] = self.paper.size_mm;
            let inside = (0.0..=width_mm).contains(&x_mm) && (0.0..=height_mm).contains(&y_mm);
            if !self.touching {
                self.strokes.push(InkStroke {
                    start_ms: time_ms,
                    ..InkStroke::default()
                });
            }
            if let Some(stroke) = self.strokes.last_mut() {
                stroke.points_mm.push([x_mm, y_mm]);
                stroke.points_outside += usize::from(!inside);
            }
            self.contacts_outside += u64::from(!inside);
        }
        self.touching = touches;
    }

    fn on_sheet(&self, platform: Position) -> [f64; 2] {
        let [centre_x_mm, centre_y_mm] = self.paper.centre_mm;
        let [width_mm, height_mm] = self.paper.size_mm;
        [
            platform.x_mm - centre_x_mm + 0.5 * width_mm,
            centre_y_mm + 0.5 * height_mm - platform.y_mm,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x_mm: f64, y_mm: f64, z_mm: f64) -> Position {
        Position { x_mm, y_mm, z_mm }
    }

    fn sheet() -> Sheet {
        Sheet::new(Paper {
            centre_mm: [10.0, 20.0],
            size_mm: [200.0, 100.0],
            pen_down_z_mm: -850.0,
            pen_lift_mm: 3.0,
            ..Paper::default()
        })
    }

    #[test]
    fn ink_is_left_only_while_the_pen_touches() {
        let mut sheet = sheet();
        for (ms, z) in [-847.0, -849.6, -849.8, -850.0, -849.0, -850.0].into_iter().enumerate() {
            sheet.step(ms as u64, at(0.0, 0.0, z));
        }
        let lengths: Vec<_> = sheet.ink().iter().map(|s| (s.start_ms, s.points_mm.len())).collect();
        assert_eq!(lengths, [(2, 2), (5, 1)]);
    }

    #[test]
    fn the_sheet_has_its_origin_at_the_top_left() {
        let mut sheet = sheet();
        sheet.step(0, at(-90.0, 70.0, -850.0));
        sheet.step(1, at(110.0, -30.0, -850.0));
        assert_eq!(sheet.ink()[0].points_mm, [[0.0, 0.0], [200.0, 100.0]]);
        assert_eq!(sheet.contacts_outside(), 0);
    }

    #[test]
    fn a_tilted_sheet_is_touched_where_it_lies() {
        let mut sheet = sheet();
        sheet.paper.slope = [0.01, 0.02];
        // 1 mm higher at the right, 1 mm lower in front.
        for (ms, (x, y, z)) in [(110.0, 20.0, -848.6), (110.0, 20.0, -848.8), (10.0, -30.0, -850.6)]
            .into_iter()
            .enumerate()
        {
            sheet.step(ms as u64, at(x, y, z));
        }
        let lengths: Vec<_> = sheet.ink().iter().map(|s| (s.start_ms, s.points_mm.len())).collect();
        assert_eq!((lengths, sheet.pressed_max_mm()), (vec![(1, 1)], 0.0));
        sheet.step(9, at(10.0, -30.0, -851.2));
        assert!((sheet.pressed_max_mm() - 0.2).abs() < 1.0e-9);
    }

    #[test]
    fn contact_beside_the_sheet_is_flagged() {
        let mut sheet = sheet();
        sheet.step(0, at(-90.5, 0.0, -851.0));
        sheet.step(1, at(0.0, 0.0, -851.0));
        assert_eq!((sheet.contacts_outside(), sheet.ink()[0].points_outside), (1, 1));
    }
}
