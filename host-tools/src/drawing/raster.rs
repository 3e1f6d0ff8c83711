//! Planes of floating-point values: the picture while it is being understood.
//!
//! Every stage of the vectoriser reads and writes whole planes of the same size, so that a value is found by one pair
//! of coordinates in all of them. Reading outside a plane gives the nearest value inside, never a failure.

/// Widest Gaussian that is computed with its own kernel; wider ones are three passes of a box.
const KERNEL_SIGMA_MAX: f32 = 2.5;

/// A picture of one value a pixel, row by row.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    /// A plane whose value at `(x, y)` is `value(x, y)`; both sides are at least one pixel.
    pub(crate) fn from_fn(width: usize, height: usize, mut value: impl FnMut(usize, usize) -> f32) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                values.push(value(x, y));
            }
        }
        Self { width, height, values }
    }

    /// A plane of one value.
    pub(crate) fn filled(width: usize, height: usize, value: f32) -> Self {
        Self::from_fn(width, height, |_, _| value)
    }

    /// Pixels from left to right.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Pixels from top to bottom.
    pub(crate) fn height(&self) -> usize {
        self.height
    }

    /// All values, row by row.
    pub(crate) fn values(&self) -> &[f32] {
        &self.values
    }

    /// The value at a pixel, or at the nearest one inside.
    pub(crate) fn at(&self, x: isize, y: isize) -> f32 {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.values[y * self.width + x]
    }

    /// Replaces the value at a pixel; outside nothing happens.
    pub(crate) fn set(&mut self, x: isize, y: isize, value: f32) {
        if x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height {
            self.values[y as usize * self.width + x as usize] = value;
        }
    }

    /// The value between pixels, bilinear; pixel centres are at whole numbers.
    pub(crate) fn sample(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (left, top) = (x as usize, y as usize);
        let (right, bottom) = ((left + 1).min(self.width - 1), (top + 1).min(self.height - 1));
        let (u, v) = (x - left as f32, y - top as f32);
        let (upper, lower) = (top * self.width, bottom * self.width);
        let above = self.values[upper + left] * (1.0 - u) + self.values[upper + right] * u;
        let below = self.values[lower + left] * (1.0 - u) + self.values[lower + right] * u;
        above * (1.0 - v) + below * v
    }

    /// A plane of `f` of every value.
    pub(crate) fn map(&self, f: impl Fn(f32) -> f32) -> Self {
        Self {
            width: self.width,
            height: self.height,
            values: self.values.iter().map(|&v| f(v)).collect(),
        }
    }

    /// A plane of `f` of every value and the value of `other` at the same place (planes of the same size).
    pub(crate) fn zip(&self, other: &Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let values = self.values.iter().zip(&other.values).map(|(&a, &b)| f(a, b)).collect();
        Self {
            width: self.width,
            height: self.height,
            values,
        }
    }

    /// This plane where `share` is 0, `other` where it is 1 (planes of the same size).
    pub(crate) fn mixed(&self, other: &Self, share: &Self) -> Self {
        let change = other
            .zip(self, |to, from| to - from)
            .zip(share, |change, share| change * share);
        self.zip(&change, |from, change| from + change)
    }

    /// Mean of all values.
    pub(crate) fn mean(&self) -> f32 {
        (self.values.iter().map(|&v| f64::from(v)).sum::<f64>() / self.values.len() as f64) as f32
    }

    /// The value below which the share `fraction` (0 to 1) of all values lies.
    pub(crate) fn percentile(&self, fraction: f32) -> f32 {
        let mut sorted = self.values.clone();
        let k = ((sorted.len() - 1) as f32 * fraction.clamp(0.0, 1.0)) as usize;
        *sorted.select_nth_unstable_by(k, f32::total_cmp).1
    }

    /// Blurred by a Gaussian of `sigma` pixels, edges continued outwards.
    pub(crate) fn blurred(&self, sigma: f32) -> Self {
        if sigma < 0.2 {
            return self.clone();
        }
        if sigma <= KERNEL_SIGMA_MAX {
            let kernel = gaussian(sigma);
            return self
                .convolved_rows(&kernel)
                .transposed()
                .convolved_rows(&kernel)
                .transposed();
        }
        let radii = box_radii(sigma);
        let rows = radii
            .iter()
            .fold(self.clone(), |plane, &radius| plane.averaged_rows(radius))
            .transposed();
        radii
            .iter()
            .fold(rows, |plane, &radius| plane.averaged_rows(radius))
            .transposed()
    }

    /// Mean over squares of `2 radius + 1` pixels.
    pub(crate) fn averaged(&self, radius: usize) -> Self {
        self.averaged_rows(radius)
            .transposed()
            .averaged_rows(radius)
            .transposed()
    }

    fn convolved_rows(&self, kernel: &[f32]) -> Self {
        let radius = (kernel.len() / 2) as isize;
        let mut result = self.clone();
        for (y, row) in result.values.chunks_exact_mut(self.width).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                *value = (kernel.iter().zip(-radius..))
                    .map(|(weight, offset)| weight * self.at(x as isize + offset, y as isize))
                    .sum();
            }
        }
        result
    }

    fn averaged_rows(&self, radius: usize) -> Self {
        let mut result = self.clone();
        let radius = radius as isize;
        let scale = 1.0 / (2 * radius + 1) as f64;
        for (y, row) in result.values.chunks_exact_mut(self.width).enumerate() {
            let y = y as isize;
            let mut sum: f64 = (-radius..=radius).map(|x| f64::from(self.at(x, y))).sum();
            for (x, value) in row.iter_mut().enumerate() {
                *value = (sum * scale) as f32;
                let x = x as isize;
                sum += f64::from(self.at(x + radius + 1, y)) - f64::from(self.at(x - radius, y));
            }
        }
        result
    }

    fn transposed(&self) -> Self {
        Self::from_fn(self.height, self.width, |x, y| self.values[x * self.width + y])
    }
}

/// Weights of a Gaussian out to three sigma, their sum one.
fn gaussian(sigma: f32) -> Vec<f32> {
    let radius = (3.0 * sigma).ceil() as i32;
    let weights: Vec<f32> = (-radius..=radius)
        .map(|k| (-0.5 * (k as f32 / sigma).powi(2)).exp())
        .collect();
    let sum: f32 = weights.iter().sum();
    weights.iter().map(|weight| weight / sum).collect()
}

/// Radii of three boxes whose variances add up to that of the Gaussian as nearly as whole numbers allow.
fn box_radii(sigma: f32) -> [usize; 3] {
    let width = (4.0 * sigma * sigma + 1.0).sqrt();
    let low = ((width - 1.0) / 2.0).floor().max(0.0);
    let variance = |radius: f32| ((2.0 * radius + 1.0).powi(2) - 1.0) / 12.0;
    let (small, large) = (variance(low), variance(low + 1.0));
    let wider = ((sigma * sigma - 3.0 * small) / (large - small))
        .round()
        .clamp(0.0, 3.0) as usize;
    let mut radii = [low as usize; 3];
    radii.iter_mut().take(wider).for_each(|radius| *radius += 1);
    radii
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blur_keeps_the_sum_and_spreads_by_its_sigma() {
        for sigma in [0.8_f32, 2.0, 3.0, 6.5, 12.0] {
            let mut plane = Plane::filled(201, 201, 0.0);
            plane.set(100, 100, 1.0);
            let blurred = plane.blurred(sigma);
            let sum: f32 = blurred.values().iter().sum();
            let mut variance = 0.0;
            for x in 0..201 {
                for y in 0..201 {
                    variance += blurred.at(x, y) * ((x - 100) * (x - 100)) as f32;
                }
            }
            assert!((sum - 1.0).abs() < 1e-3, "sigma {sigma}: sum {sum}");
            assert!(
                (variance.sqrt() / sigma - 1.0).abs() < 0.06,
                "sigma {sigma}: {}",
                variance.sqrt()
            );
        }
    }

    #[test]
    fn reading_outside_gives_the_nearest_value() {
        let plane = Plane::from_fn(3, 2, |x, y| (x + 10 * y) as f32);
        assert_eq!(plane.at(-5, 0), 0.0);
        assert_eq!(plane.at(9, 9), 12.0);
        assert_eq!(plane.sample(1.5, 0.5), 6.5);
        assert_eq!(plane.sample(1e9, -1e9), 2.0);
    }
}
