//! Planes of floating-point values for image processing.
//!
//! Every stage of the vectoriser reads and writes whole planes of one size, so one pair of coordinates is valid in all
//! of them. Reading outside a plane returns the nearest value inside.

/// Widest Gaussian computed with its own kernel; wider ones are three passes of a box.
const KERNEL_SIGMA_MAX: f32 = 2.5;
/// Most threads that work on one plane, and the fewest rows for one thread.
const THREADS_MAX: usize = 8;
const BAND_ROWS_MIN: usize = 64;
/// The least number to which a 32-bit one cannot have a fraction: adding it rounds.
const WHOLE: f32 = 8_388_608.0;
/// Side of the squares in which a plane is transposed, pixels.
const TILE: usize = 32;

/// A picture of one value a pixel, row by row.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    /// A plane whose value at `(x, y)` is `value(x, y)`; both sides are at least one pixel.
    pub(crate) fn from_fn(width: usize, height: usize, value: impl Fn(usize, usize) -> f32 + Sync) -> Self {
        Self::from_bands(width.max(1), height.max(1), |top, band, width| {
            for (y, row) in (top..).zip(band.chunks_exact_mut(width)) {
                for (x, pixel) in row.iter_mut().enumerate() {
                    *pixel = value(x, y);
                }
            }
        })
    }

    /// A plane whose rows are filled by several threads; each call `fill(top, rows, width)` fills a band of rows from
    /// row `top` on.
    fn from_bands(width: usize, height: usize, fill: impl Fn(usize, &mut [f32], usize) + Sync) -> Self {
        let mut values = vec![0.0; width * height];
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let rows = height.div_ceil(threads.min(THREADS_MAX)).max(BAND_ROWS_MIN);
        if rows >= height {
            fill(0, &mut values, width);
        } else {
            std::thread::scope(|scope| {
                for (k, band) in values.chunks_mut(rows * width).enumerate() {
                    let fill = &fill;
                    scope.spawn(move || fill(k * rows, band, width));
                }
            });
        }
        Self { width, height, values }
    }

    /// A plane with one constant value.
    pub(crate) fn filled(width: usize, height: usize, value: f32) -> Self {
        Self::from_fn(width, height, |_, _| value)
    }

    /// Width, pixels.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Height, pixels.
    pub(crate) fn height(&self) -> usize {
        self.height
    }

    /// All values, row by row.
    pub(crate) fn values(&self) -> &[f32] {
        &self.values
    }

    /// Whether a pixel is at least `margin` pixels inside on every side.
    pub(crate) fn is_inside(&self, x: usize, y: usize, margin: usize) -> bool {
        let is_between = |at: usize, size: usize| at >= margin && at + margin < size;
        is_between(x, self.width) && is_between(y, self.height)
    }

    /// The value at a pixel, or at the nearest one inside.
    pub(crate) fn at(&self, x: isize, y: isize) -> f32 {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.values[y * self.width + x]
    }

    /// Replaces the value at a pixel; ignored outside the plane.
    pub(crate) fn set(&mut self, x: isize, y: isize, value: f32) {
        if x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height {
            self.values[y as usize * self.width + x as usize] = value;
        }
    }

    /// The value between pixels, bilinear; pixel centres are at whole numbers.
    #[inline]
    pub(crate) fn sample(&self, x: f32, y: f32) -> f32 {
        let x = x.max(0.0).min((self.width - 1) as f32);
        let y = y.max(0.0).min((self.height - 1) as f32);
        // Conversions to 32 bits are the fast ones.
        let (left, top) = (x as i32, y as i32);
        let (u, v) = (x - left as f32, y - top as f32);
        let (left, top) = (left as usize, top as usize);
        let below = if top + 1 < self.height { self.width } else { 0 };
        let first = top * self.width + left;
        // In the last column the share of the next value is 0.
        let row = |from: usize| match self.values.get(from..from + 2) {
            Some(pair) => pair[0] * (1.0 - u) + pair[1] * u,
            None => self.values[from],
        };
        row(first) * (1.0 - v) + row(first + below) * v
    }

    /// As [`Self::sample`], and with the same result, for places at least a pixel inside; quicker there.
    #[inline]
    pub(crate) fn sample_inside(&self, x: f32, y: f32) -> f32 {
        // Half a pixel less, rounded: the pixel before the place, or before a pixel on which it lies, which then has all of the share.
        let (left, top) = (x - 0.5 + WHOLE, y - 0.5 + WHOLE);
        let (u, v) = (x - (left - WHOLE), y - (top - WHOLE));
        let index = |value: f32| value.to_bits().wrapping_sub(WHOLE.to_bits()) as usize;
        let first = index(top).wrapping_mul(self.width).wrapping_add(index(left));
        match self.values.get(first..).and_then(|rest| rest.get(..self.width + 2)) {
            Some(rows) => {
                let row = |from: usize| rows[from] * (1.0 - u) + rows[from + 1] * u;
                row(0) * (1.0 - v) + row(self.width) * v
            }
            None => self.sample(x, y),
        }
    }

    /// A plane with `f` applied to every value.
    pub(crate) fn map(&self, f: impl Fn(f32) -> f32) -> Self {
        Self {
            width: self.width,
            height: self.height,
            values: self.values.iter().map(|&v| f(v)).collect(),
        }
    }

    /// A plane with `f` applied to every value and the value of `other` at that place (planes of one size).
    pub(crate) fn zip(&self, other: &Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let values = self.values.iter().zip(&other.values).map(|(&a, &b)| f(a, b)).collect();
        Self {
            width: self.width,
            height: self.height,
            values,
        }
    }

    /// This plane where `share` is 0, `other` where it is 1 (planes of one size).
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

    /// The value below which the fraction `fraction` (0 to 1) of all values lies.
    pub(crate) fn percentile(&self, fraction: f32) -> f32 {
        let mut sorted = self.values.clone();
        let k = ((sorted.len() - 1) as f32 * fraction.clamp(0.0, 1.0)) as usize;
        *sorted.select_nth_unstable_by(k, f32::total_cmp).1
    }

    /// The plane blurred by a Gaussian of `sigma` pixels; edges are continued outwards.
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
        let [first, second, third] = radii;
        let rows = self.averaged_rows(first).averaged_rows(second).averaged_rows(third);
        radii.iter().fold(rows, |plane, &radius| plane.averaged_columns(radius))
    }

    /// Mean over squares of `2 radius + 1` pixels.
    pub(crate) fn averaged(&self, radius: usize) -> Self {
        self.averaged_rows(radius).averaged_columns(radius)
    }

    fn convolved_rows(&self, kernel: &[f32]) -> Self {
        self.by_rows(kernel.len() / 2, |source, row| {
            for (value, around) in row.iter_mut().zip(source.windows(kernel.len())) {
                *value = kernel.iter().zip(around).map(|(weight, value)| weight * value).sum();
            }
        })
    }

    fn averaged_rows(&self, radius: usize) -> Self {
        // Farther out there is only the border, continued.
        let radius = radius.min(self.width.max(self.height));
        let length = 2 * radius + 1;
        let scale = 1.0 / length as f64;
        self.by_rows(radius, |source, row| {
            let mut sum: f64 = source.iter().take(length).map(|&value| f64::from(value)).sum();
            let mut ends = source.iter().skip(length).zip(source);
            for value in row {
                *value = (sum * scale) as f32;
                if let Some((&next, &last)) = ends.next() {
                    sum += f64::from(next) - f64::from(last);
                }
            }
        })
    }

    /// As [`Self::averaged_rows`], down the columns: all of a row's sums are independent of each other, which is quicker than turning
    /// the plane round.
    fn averaged_columns(&self, radius: usize) -> Self {
        let radius = radius.min(self.width.max(self.height)) as isize;
        let scale = 1.0 / (2 * radius + 1) as f64;
        let row = |y: isize| {
            let first = y.clamp(0, self.height as isize - 1) as usize * self.width;
            &self.values[first..first + self.width]
        };
        let mut sums = vec![0.0_f64; self.width];
        for y in -radius..=radius {
            for (sum, &value) in sums.iter_mut().zip(row(y)) {
                *sum += f64::from(value);
            }
        }
        let mut values = Vec::with_capacity(self.values.len());
        for y in 0..self.height as isize {
            values.extend(sums.iter().map(|sum| (sum * scale) as f32));
            let ends = row(y + radius + 1).iter().zip(row(y - radius));
            for (sum, (&next, &last)) in sums.iter_mut().zip(ends) {
                *sum += f64::from(next) - f64::from(last);
            }
        }
        Self {
            width: self.width,
            height: self.height,
            values,
        }
    }

    /// A plane whose rows are computed by `follow` from this plane's rows, continued by `margin` pixels on both sides.
    fn by_rows(&self, margin: usize, follow: impl Fn(&[f32], &mut [f32]) + Sync) -> Self {
        Self::from_bands(self.width, self.height, |top, band, width| {
            let mut continued = vec![0.0; width + 2 * margin];
            let sources = self.values.chunks_exact(width).skip(top);
            for (source, row) in sources.zip(band.chunks_exact_mut(width)) {
                let (before, rest) = continued.split_at_mut(margin);
                let (inside, after) = rest.split_at_mut(width);
                before.fill(source.first().copied().unwrap_or_default());
                inside.copy_from_slice(source);
                after.fill(source.last().copied().unwrap_or_default());
                follow(&continued, row);
            }
        })
    }

    fn transposed(&self) -> Self {
        Self::from_bands(self.height, self.width, |top, band, width| {
            // Tile by tile, so that the data stay in the cache.
            for left in (0..width).step_by(TILE) {
                let right = (left + TILE).min(width);
                for (k, row) in band.chunks_exact_mut(width).enumerate() {
                    for (y, value) in (left..right).zip(&mut row[left..right]) {
                        *value = self.values[y * self.width + top + k];
                    }
                }
            }
        })
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

    #[test]
    fn inside_and_down_the_columns_the_quick_ways_give_the_very_same() {
        let mut random = crate::random::Random::new(3);
        for (width, height) in [(40, 25), (3, 90), (70, 2), (1, 1)] {
            let noise: Vec<f32> = (0..width * height).map(|_| random.unit() as f32).collect();
            let plane = Plane::from_fn(width, height, |x, y| noise[y * width + x]);
            for radius in [0, 1, 4, 30, 200] {
                let turned = plane.transposed().averaged_rows(radius).transposed();
                assert_eq!(
                    plane.averaged_columns(radius).values(),
                    turned.values(),
                    "radius {radius}"
                );
            }
            let tries = match plane.is_inside(width / 2, height / 2, 1) {
                true => 2_000,
                false => 0,
            };
            for _ in 0..tries {
                let at = |size: usize, share: f64| (1.0 + share * size.saturating_sub(3) as f64) as f32;
                let (x, y) = (at(width, random.unit()), at(height, random.unit()));
                for (x, y) in [(x, y), (x.round(), y), (x, y.round()), (x.round(), y.round())] {
                    assert_eq!(plane.sample_inside(x, y), plane.sample(x, y), "{x}, {y}");
                }
            }
        }
    }
}
