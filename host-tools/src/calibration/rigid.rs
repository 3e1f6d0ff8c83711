//! A turn and a displacement in the plane.

/// A turn around the origin, then a displacement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rigid {
    turn_rad: f64,
    by_mm: [f64; 2],
}

impl Rigid {
    pub(super) fn new(turn_rad: f64, by_mm: [f64; 2]) -> Self {
        Self { turn_rad, by_mm }
    }

    /// Where a point comes to.
    pub(super) fn of(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sine, cosine) = self.turn_rad.sin_cos();
        [
            cosine * x - sine * y + self.by_mm[0],
            sine * x + cosine * y + self.by_mm[1],
        ]
    }

    /// The turn and the displacement.
    pub(super) fn unknowns(&self) -> [f64; 3] {
        let [x, y] = self.by_mm;
        [self.turn_rad, x, y]
    }

    /// The one that brings points closest to others, how many times larger the others are, and the root mean square of what is
    /// left, mm.
    pub(super) fn between(from: &[[f64; 2]], to: &[[f64; 2]]) -> (Self, f64, f64) {
        let (middle_from, middle_to) = (middle(from), middle(to));
        let (mut along, mut across, mut square_from, mut square_to) = (0.0, 0.0, 0.0, 0.0);
        for (one, other) in from.iter().zip(to) {
            let ([a, b], [c, d]) = (less(*one, middle_from), less(*other, middle_to));
            along += a * c + b * d;
            across += a * d - b * c;
            square_from += a * a + b * b;
            square_to += c * c + d * d;
        }
        let turned = Self::new(f64::atan2(across, along), [0.0; 2]);
        let frame = Self::new(turned.turn_rad, less(middle_to, turned.of(middle_from)));
        let squares = from.iter().zip(to).map(|(one, other)| {
            let [x, y] = less(frame.of(*one), *other);
            x * x + y * y
        });
        let left_mm = (squares.sum::<f64>() / from.len().max(1) as f64).sqrt();
        (frame, (square_to / square_from).sqrt(), left_mm)
    }
}

/// Small shifts of places without what a turn and a displacement of all of them explain.
pub(super) fn without(places: &[[f64; 2]], shifts: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let (middle_place, middle_shift) = (middle(places), middle(shifts));
    let (mut across, mut square) = (0.0, 0.0);
    for (place, shift) in places.iter().zip(shifts) {
        let ([a, b], [c, d]) = (less(*place, middle_place), less(*shift, middle_shift));
        across += a * d - b * c;
        square += a * a + b * b;
    }
    let turn = across / square;
    let left = places.iter().zip(shifts).map(|(place, shift)| {
        let ([a, b], [c, d]) = (less(*place, middle_place), less(*shift, middle_shift));
        [c + turn * b, d - turn * a]
    });
    left.collect()
}

fn middle(points: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / points.len().max(1) as f64)
}

fn less([x, y]: [f64; 2], [from_x, from_y]: [f64; 2]) -> [f64; 2] {
    [x - from_x, y - from_y]
}
