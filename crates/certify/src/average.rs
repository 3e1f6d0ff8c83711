//! What a moving average of the joint angles adds to the distance from the path.
//!
//! The average of n angles a millisecond h apart differs from the angle in their middle by a mean of the joints'
//! accelerations times K = h^2 (n^2 - 1) / 24, which is a little less than T^2 / 24 for T = n h. The tool follows the
//! joints by the matrix J of its derivatives:
//!
//! - The acceleration that counts is J q'', not the tool's own: both differ by what the joints' speeds do, so a straight
//!   line at constant speed does not stay straight.
//! - J is that of the middle, q'' that of another moment. J changes with q' over half the window: differentiating the
//!   constraints twice bounds the change of J q'' per second by N sqrt(3) (l a |q'| |q''| + (|p'| + a |q'|) (|J q''| + a
//!   |q''|)), with N the norm of the inverse of the matrix of the links that hold the tool, a and l the lengths of a main
//!   axis's first and last link.
//! - The tool's way is curved over the joints' difference d; its second derivative is bounded in the same way, which adds
//!   half of it times d^2. On that way N at most doubles, as [`addition_mm`] checks.
//! - A jump of the velocity within the window adds at most a quarter of the window times the jump.

use crate::limits::TICK_S;
use crate::stretches::Rates;

/// Covers the rounding of a formula with a few dozen positive terms.
const ROUNDING: f64 = 1.0 + 1.0e-12;

/// Jumps between the stretches of a window: sums.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Jumps {
    /// Of the tool's velocity, mm/s.
    pub(crate) velocity: f64,
    /// Of the main axes' speeds, rad/s.
    pub(crate) joints: f64,
    /// Of the tool's position, mm.
    pub(crate) gap: f64,
}

/// Largest distance that the average of `window_ms` angles puts between the tool and its place in the window's middle,
/// mm; infinite if the bounds do not suffice. `rates` bound the motion in the whole window. Without links the tool's
/// position is in proportion to the angles, and its average is that of the position.
pub(crate) fn addition_mm(window_ms: u16, rates: &Rates, jumps: &Jumps, links_mm: Option<[f64; 2]>) -> f64 {
    if window_ms < 2 {
        return 0.0;
    }
    let count = f64::from(window_ms);
    let window_s = count * TICK_S;
    let share = TICK_S * TICK_S * (count * count - 1.0) / 24.0;
    let Some([first, last]) = links_mm else {
        let straight = rates.lifted * share + 0.25 * window_s * jumps.velocity + jumps.gap;
        return straight * ROUNDING;
    };
    let root = 3.0_f64.sqrt();
    let Rates {
        speed,
        joint_speed,
        joint_acceleration,
        lifted,
        inverse,
    } = *rates;
    let change = inverse
        * root
        * (last * first * joint_speed * joint_acceleration
            + (speed + first * joint_speed) * (lifted + first * joint_acceleration));
    let apart = joint_acceleration * share + 0.25 * window_s * jumps.joints;
    let double = 2.0 * inverse;
    let steepest = double * last * first;
    let at_most_doubles = inverse * root * (steepest + first) * apart <= 0.5;
    if !at_most_doubles {
        return f64::INFINITY;
    }
    let curvature = double * root * (last * first + (steepest + first) * (steepest + first));
    let straight = (lifted + 0.5 * window_s * change) * share + 0.25 * window_s * jumps.velocity + jumps.gap;
    (straight + 0.5 * curvature * apart * apart) * ROUNDING
}
