//! Scales of plots: where values are, round marks and their texts.

/// A scale from its low end to its high end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// Equal differences are equally long.
    Linear([f64; 2]),
    /// Equal ratios are equally long; the ends are positive.
    Logarithmic([f64; 2]),
}

impl Scale {
    /// Place of a value: 0 at the low end, 1 at the high end.
    #[must_use]
    pub fn share(self, value: f64) -> f64 {
        match self {
            Self::Linear([low, high]) => (value - low) / (high - low),
            Self::Logarithmic([low, high]) => (value / low).log10() / (high / low).log10(),
        }
    }
}

/// Approximate number of marks on a scale.
const MARKS: f64 = 4.0;

/// Round values between two ends, 1, 2 or 5 times a power of ten apart.
pub fn marks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / MARKS;
    if !(rough > 0.0 && rough.is_finite()) {
        return Vec::new();
    }
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|factor| factor * power)
        .into_iter()
        .find(|step| *step >= rough);
    let step = step.unwrap_or(rough);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|k| k as f64 * step).collect()
}

/// Most decimals of a mark, plus one.
const DECIMALS_MAX: f64 = 13.0;

/// A mark's text, with as many decimals as its scale needs.
pub fn number(value: f64, span: f64) -> String {
    let decimals =
        (1.0 - (span / MARKS).log10().floor()).clamp(0.0, DECIMALS_MAX) as usize - usize::from(span / MARKS < 10.0);
    format!("{:.decimals$}", value + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_round_and_have_the_decimals_they_need() {
        let text = |low, high| {
            marks(low, high)
                .iter()
                .map(|mark| number(*mark, high - low))
                .collect::<Vec<_>>()
                .join(" ")
        };
        assert_eq!(text(2.0, 4.0), "2.0 2.5 3.0 3.5 4.0");
        assert_eq!(text(-61.0, 61.0), "-50 0 50");
        assert_eq!(text(0.121, 0.163), "0.14 0.16");
    }
}
