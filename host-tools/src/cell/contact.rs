//! Impulses with bounds: dry friction at the motors, and flanks of gears with play.
//!
//! Projected Gauss-Seidel iteration: one impulse after the other gets the value that its own condition asks for, cut to
//! its bounds, until none changes. The matrix is symmetric and positive definite, so this converges from any start; it
//! starts from the impulses of the step before.

use super::mechanism::MainAxes;
use etherpen::robots::MAIN_AXES;

/// Most iterations of one step.
const ITERATIONS_MAX: u32 = 200;
/// Change of a speed at which the iteration ends, rad/s.
const CHANGE_RAD_S: f64 = 1e-12;

/// Impulses of one step, N m s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Contact {
    friction: MainAxes,
    flanks: MainAxes,
}

impl Contact {
    /// Brakes joints by friction impulses of at most `bounds`. `response` has the speeds that an impulse on each joint
    /// gives.
    pub(super) fn brake(&mut self, speeds: &mut MainAxes, response: &[MainAxes; MAIN_AXES], bounds: MainAxes) {
        for i in 0..MAIN_AXES {
            self.friction[i] = self.friction[i].clamp(-bounds[i], bounds[i]);
            for j in 0..MAIN_AXES {
                speeds[j] -= response[j][i] * self.friction[i];
            }
        }
        for _ in 0..ITERATIONS_MAX {
            let mut most: f64 = 0.0;
            for i in (0..MAIN_AXES).filter(|i| bounds[*i] > 0.0) {
                let wanted = self.friction[i] + speeds[i] / response[i][i];
                let change = wanted.clamp(-bounds[i], bounds[i]) - self.friction[i];
                self.friction[i] += change;
                for j in 0..MAIN_AXES {
                    speeds[j] -= response[j][i] * change;
                }
                most = most.max((change * response[i][i]).abs());
            }
            if most < CHANGE_RAD_S {
                return;
            }
        }
    }

    /// Brakes rotors by friction impulses of at most `bounds`, and keeps the speed of each load against its rotor within
    /// `limits` by impulses between their flanks. `mobility` is the inverse of each rotor's inertia, 0 for one that
    /// nothing moves; `response` has the speeds that an impulse on each load gives.
    pub(super) fn brake_and_touch(
        &mut self,
        rotors: &mut MainAxes,
        mobility: &MainAxes,
        bounds: MainAxes,
        loads: &mut MainAxes,
        response: &[MainAxes; MAIN_AXES],
        limits: [[f64; 2]; MAIN_AXES],
    ) {
        for i in 0..MAIN_AXES {
            self.friction[i] = self.friction[i].clamp(-bounds[i], bounds[i]);
            rotors[i] -= mobility[i] * (self.friction[i] + self.flanks[i]);
            for j in 0..MAIN_AXES {
                loads[j] += response[j][i] * self.flanks[i];
            }
        }
        for _ in 0..ITERATIONS_MAX {
            let mut most: f64 = 0.0;
            for i in 0..MAIN_AXES {
                if bounds[i] > 0.0 && mobility[i] > 0.0 {
                    let wanted = self.friction[i] + rotors[i] / mobility[i];
                    let change = wanted.clamp(-bounds[i], bounds[i]) - self.friction[i];
                    self.friction[i] += change;
                    rotors[i] -= mobility[i] * change;
                    most = most.max((change * mobility[i]).abs());
                }
                let own = response[i][i] + mobility[i];
                if own <= 0.0 {
                    continue;
                }
                let relative = loads[i] - rotors[i];
                let [low, high] = limits[i].map(|limit| self.flanks[i] + (limit - relative) / own);
                // A flank only pushes: forwards at the lower limit, backwards at the upper one.
                let wanted = if low > 0.0 { low } else { high.min(0.0) };
                let change = wanted - self.flanks[i];
                self.flanks[i] = wanted;
                rotors[i] -= mobility[i] * change;
                for j in 0..MAIN_AXES {
                    loads[j] += response[j][i] * change;
                }
                most = most.max((change * own).abs());
            }
            if most < CHANGE_RAD_S {
                return;
            }
        }
    }
}

/// Inverse of a positive definite matrix, by its adjugate; zero for a singular one.
pub(super) fn invert([[a, b, c], [d, e, f], [g, h, i]]: [MainAxes; MAIN_AXES]) -> [MainAxes; MAIN_AXES] {
    let (one, two, three) = (e * i - f * h, f * g - d * i, d * h - e * g);
    let determinant = a * one + b * two + c * three;
    let scale = if determinant.abs() > 1e-18 {
        1.0 / determinant
    } else {
        0.0
    };
    [
        [one, c * h - b * i, b * f - c * e],
        [two, a * i - c * g, c * d - a * f],
        [three, b * g - a * h, a * e - b * d],
    ]
    .map(|row| row.map(|entry| entry * scale))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MATRIX: [MainAxes; MAIN_AXES] = [[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]];

    #[test]
    fn the_inverse_times_the_matrix_is_one() {
        let inverse = invert(MATRIX);
        for (i, j) in (0..MAIN_AXES * MAIN_AXES).map(|place| (place / MAIN_AXES, place % MAIN_AXES)) {
            let product: f64 = (0..MAIN_AXES).map(|k| MATRIX[i][k] * inverse[k][j]).sum();
            assert!((product - f64::from(u8::from(i == j))).abs() < 1e-12);
        }
        assert_eq!(invert([[0.0; MAIN_AXES]; MAIN_AXES]), [[0.0; MAIN_AXES]; MAIN_AXES]);
    }

    #[test]
    fn friction_stops_what_it_can_and_brakes_the_rest_with_all_it_has() {
        let response = invert(MATRIX);
        let mut contact = Contact::default();
        let mut held = [0.1, -0.05, 0.02];
        contact.brake(&mut held, &response, [1.0; MAIN_AXES]);
        assert!(held.iter().all(|speed| speed.abs() < 1e-11), "{held:?}");

        let (mut speeds, bounds) = ([5.0, -0.001, -4.0], [0.3, 0.2, 0.1]);
        let before = speeds;
        let mut contact = Contact::default();
        contact.brake(&mut speeds, &response, bounds);
        assert_eq!((contact.friction[0], contact.friction[2]), (0.3, -0.1));
        for i in 0..MAIN_AXES {
            let impulse: f64 = (0..MAIN_AXES).map(|j| MATRIX[i][j] * (before[j] - speeds[j])).sum();
            assert!((impulse - contact.friction[i]).abs() < 1e-10);
            let slides = speeds[i].abs() > 1e-10;
            assert!(!slides || impulse * speeds[i] > 0.0, "friction pushes joint {i}");
        }
    }
}
