//! Identification of a drive that closes the position loop itself, from two test motions.
//!
//! A drive in position mode with the loop gain K follows a target that is late by a, and a velocity beside it that is
//! late by b and too small by the share e. Slow signals see the measured position behind the setpoint by
//!
//! - a delay M = a + e / K, and
//! - a second cumulant C = (a - b) / K for e = 0,
//!
//! with the loop H(s) = K / (K + s + ..) in the expansion of exp(-as) H + (1 - e) exp(-bs) (1 - H). Two motions that
//! differ in e by a known amount give K, then a and b. The target has to be read ahead by what it is late, and the
//! velocity likewise.
//!
//! A drive that takes no velocity beside its target does not answer to e: only a is found.
//!
//! Invariant: what the record does not tell keeps the configured value.

use super::{Answer, Equation, Measured, NoAnswer, PART_SAMPLES_MIN, PARTS, equations, least_squares, moves};
use etherpen::config::{Axis, AxisMode, Config};
use etherpen::messages::Sample;

/// Share of the velocity beside the target that the second motion leaves out.
const WEAK_SHARE: f64 = 0.05;
/// Least change of the delay by it, ms: less is not told from a drive that takes no such velocity.
const CHANGE_MIN_MS: f64 = 0.05;
/// Largest uncertainty of a velocity's lead that is used, ms.
const LEAD_UNCERTAINTY_MAX_MS: f64 = 0.3;
/// Smallest root mean square of a change of the setpoint's velocity that counts as motion, rad/s2.
const CHANGE_MIN_RAD_S2: f64 = 0.5;
/// How far the gain of a closed position loop may be from 1.
const GAIN_ERROR_MAX: f64 = 0.02;

/// The configuration of the second motion: drives in position mode get too little of the velocity.
pub fn weak_config(config: &Config) -> Config {
    let mut weak = config.clone();
    for axis in weak.axes.iter_mut().filter(|axis| axis.mode == AxisMode::Position) {
        axis.feed_forward_gain *= 1.0 - WEAK_SHARE;
    }
    weak
}

/// Delay and second cumulant of the measured position behind the setpoint, ms and ms2.
#[derive(Clone, Copy, Debug)]
struct Response {
    samples: usize,
    delay_ms: Measured,
    cumulant_ms2: Measured,
}

pub(super) fn identify_axis(
    axis: &Axis,
    number: usize,
    samples: &[Sample],
    weak: &[Sample],
) -> Result<Answer, NoAnswer> {
    let (full, weak) = (response(axis, number, samples)?, response(axis, number, weak)?);
    let change_ms = Measured {
        value: weak.delay_ms.value - full.delay_ms.value,
        uncertainty: weak.delay_ms.uncertainty.hypot(full.delay_ms.uncertainty),
    };
    let left_out = WEAK_SHARE * axis.feed_forward_gain;
    let gain_per_ms = (change_ms.value > CHANGE_MIN_MS).then(|| left_out / change_ms.value);
    // What the first motion left out of the velocity delayed it as well.
    let missing_ms = gain_per_ms.map_or(0.0, |gain_per_ms| (1.0 - axis.feed_forward_gain) / gain_per_ms);
    let late_ms = full.delay_ms.value - axis.measurement_age_ms - missing_ms;
    let position_lead_ms = axis.position_lead_ms + late_ms;
    let kept = |value: f64| Measured {
        value,
        uncertainty: 0.0,
    };
    let velocity_lead_ms = gain_per_ms.map(|gain_per_ms| Measured {
        value: axis.feed_forward_lead_ms + late_ms - gain_per_ms * full.cumulant_ms2.value,
        uncertainty: full
            .delay_ms
            .uncertainty
            .hypot(gain_per_ms * full.cumulant_ms2.uncertainty),
    });
    let usable =
        velocity_lead_ms.filter(|lead_ms| lead_ms.uncertainty < LEAD_UNCERTAINTY_MAX_MS && lead_ms.value >= 0.0);
    if position_lead_ms < 0.0 || !position_lead_ms.is_finite() {
        return Err(NoAnswer::Model);
    }
    Ok(Answer {
        samples: full.samples,
        delay_ms: Measured {
            value: axis.position_lead_ms + full.delay_ms.value - missing_ms,
            ..full.delay_ms
        },
        gain: kept(1.0),
        lead_ms: usable.unwrap_or(kept(axis.feed_forward_lead_ms)),
        feed_forward_gain: kept(axis.feed_forward_gain),
        feedback_gain_per_s: gain_per_ms.map_or(axis.feedback_gain_per_s, |gain_per_ms| gain_per_ms * 1_000.0),
        position_lead_ms: Some(Measured {
            value: position_lead_ms,
            ..full.delay_ms
        }),
    })
}

/// How the measured velocity answers to that of the setpoint.
fn response(axis: &Axis, number: usize, samples: &[Sample]) -> Result<Response, NoAnswer> {
    let shift = axis.measurement_age_ms.round() as usize;
    let runs = samples.chunk_by(|a, b| b.t_ms == a.t_ms.wrapping_add(1) && moves(a) == moves(b));
    let equations: Vec<Equation> = runs
        .filter(|run| run.first().is_some_and(moves))
        .flat_map(|run| {
            let velocities: Vec<f64> = run.iter().map(|sample| sample.setpoint_rad_s[number].into()).collect();
            equations(&velocities, number, run, shift)
        })
        .collect();
    if equations.len() < PARTS * PART_SAMPLES_MIN {
        return Err(NoAnswer::Samples);
    }
    let squares: f64 = equations.iter().map(|(terms, _)| (1_000.0 * terms[1]).powi(2)).sum();
    if (squares / equations.len() as f64).sqrt() < CHANGE_MIN_RAD_S2 {
        return Err(NoAnswer::Still);
    }
    let estimate = |part: &[Equation]| {
        let [gain, first, second, ..] = least_squares(part)?;
        let (delay_ms, shift) = (shift as f64 - first / gain, shift as f64);
        let moment_ms2 = second / gain - shift * first / gain + 0.5 * shift * shift;
        let values = [gain, delay_ms, moment_ms2 - 0.5 * delay_ms * delay_ms];
        values.iter().all(|value| value.is_finite()).then_some(values)
    };
    let [gain, delay_ms, cumulant_ms2] = estimate(&equations).ok_or(NoAnswer::Model)?;
    if (gain - 1.0).abs() > GAIN_ERROR_MAX {
        return Err(NoAnswer::Model);
    }
    let parts: Vec<_> = equations
        .chunks_exact(equations.len() / PARTS)
        .take(PARTS)
        .filter_map(estimate)
        .collect();
    if parts.len() <= PARTS / 2 {
        return Err(NoAnswer::Model);
    }
    let measured = |of: usize, value: f64| {
        let mean = parts.iter().map(|part| part[of]).sum::<f64>() / parts.len() as f64;
        let squares = parts.iter().map(|part| (part[of] - mean).powi(2)).sum::<f64>();
        let uncertainty = (squares / (parts.len() - 1) as f64 / parts.len() as f64).sqrt();
        Measured { value, uncertainty }
    };
    Ok(Response {
        samples: equations.len(),
        delay_ms: measured(1, delay_ms),
        cumulant_ms2: measured(2, cumulant_ms2),
    })
}
