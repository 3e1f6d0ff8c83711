//! Weighted least squares with few unknowns: the normal equations, solved by Cholesky's factorisation.

/// Least part of an unknown's own sum that has to be left when all unknowns before it are known.
const TELLS_MIN: f64 = 1.0e-12;

/// An equation: how each unknown acts on it, and what is left of it; both divided by its standard error.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Equation {
    pub(super) slopes: Vec<f64>,
    pub(super) left: f64,
}

/// The sums of many equations in `n` unknowns, and their factor.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Normal {
    /// The lower factor, row by row.
    factor: Vec<Vec<f64>>,
    right: Vec<f64>,
}

impl Normal {
    /// Sums equations; `None` if they do not tell all unknowns.
    pub(super) fn of(equations: &[Equation], unknowns: usize) -> Option<Self> {
        let mut factor = vec![vec![0.0; unknowns]; unknowns];
        let mut right = vec![0.0; unknowns];
        for Equation { slopes, left } in equations {
            for ((row, right), slope) in factor.iter_mut().zip(&mut right).zip(slopes) {
                *right += slope * left;
                for (sum, other) in row.iter_mut().zip(slopes) {
                    *sum += slope * other;
                }
            }
        }
        for row in 0..unknowns {
            for column in 0..=row {
                let (upper, lower) = (factor.get(column)?.clone(), factor.get_mut(row)?);
                let products: f64 = upper
                    .iter()
                    .zip(&*lower)
                    .take(column)
                    .map(|(one, other)| one * other)
                    .sum();
                let value = lower.get(column)? - products;
                let before = *lower.get(column)?;
                *lower.get_mut(column)? = match row == column {
                    true => Some(value).filter(|value| *value > TELLS_MIN * before)?.sqrt(),
                    false => value / upper.get(column)?,
                };
            }
        }
        Some(Self { factor, right })
    }

    /// The unknowns that leave the least.
    pub(super) fn solution(&self) -> Option<Vec<f64>> {
        self.solve(&self.right)
    }

    /// Covariance of the unknowns.
    pub(super) fn covariance(&self) -> Option<Vec<Vec<f64>>> {
        let unknowns = self.right.len();
        let column = |index: usize| {
            let unit: Vec<f64> = (0..unknowns).map(|row| f64::from(u8::from(row == index))).collect();
            self.solve(&unit)
        };
        (0..unknowns).map(column).collect()
    }

    fn solve(&self, right: &[f64]) -> Option<Vec<f64>> {
        let mut values = right.to_vec();
        for (row, factors) in self.factor.iter().enumerate() {
            let known: f64 = factors
                .iter()
                .zip(&values)
                .take(row)
                .map(|(one, other)| one * other)
                .sum();
            let value = values.get_mut(row)?;
            *value = (*value - known) / factors.get(row)?;
        }
        for row in (0..values.len()).rev() {
            let behind =
                (row + 1..values.len()).map(|below| Some(self.factor.get(below)?.get(row)? * values.get(below)?));
            let known: f64 = behind.sum::<Option<f64>>()?;
            let diagonal = self.factor.get(row)?.get(row)?;
            let value = values.get_mut(row)?;
            *value = (*value - known) / diagonal;
        }
        values.iter().all(|value| value.is_finite()).then_some(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn random_unknowns_are_found_and_what_does_not_tell_them_is_none() {
        let mut random = Random::new(1);
        let mut number = || 2.0 * random.unit() - 1.0;
        for unknowns in 1..12 {
            let wanted: Vec<f64> = (0..unknowns).map(|_| number()).collect();
            let mut equation = || {
                let slopes: Vec<f64> = (0..unknowns).map(|_| number()).collect();
                let left = slopes.iter().zip(&wanted).map(|(slope, value)| slope * value).sum();
                Equation { slopes, left }
            };
            let equations: Vec<Equation> = (0..3 * unknowns).map(|_| equation()).collect();
            let normal = Normal::of(&equations, unknowns).expect("enough equations");
            let found = normal.solution().expect("a solution");
            for (found, wanted) in found.iter().zip(&wanted) {
                assert!((found - wanted).abs() < 1e-9, "{found} {wanted}");
            }
            // The covariance is the inverse of the sums.
            let covariance = normal.covariance().expect("an inverse");
            for (row, variances) in covariance.iter().enumerate() {
                for column in 0..unknowns {
                    let sum = |other: usize| -> f64 {
                        equations
                            .iter()
                            .map(|equation| equation.slopes[other] * equation.slopes[column])
                            .sum()
                    };
                    let product: f64 = (0..unknowns).map(|other| variances[other] * sum(other)).sum();
                    let unit = f64::from(u8::from(row == column));
                    assert!((product - unit).abs() < 1e-6, "{product}");
                }
            }
            assert_eq!(Normal::of(&equations[..unknowns - 1], unknowns), None);
        }
    }
}
