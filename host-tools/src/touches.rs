//! Height and tilt of a sheet from places where the pen touched it.
//!
//! The plane is the one with the least squares of its distances in z. A touch is good to [`TOUCH_ERROR_MM`]; places from which
//! that gives a corner of the sheet by more than [`CORNER_ERROR_MAX_MM`] are refused.

use etherpen::config::{Paper, Plane};

/// A place where the pen touched: x, y, z of the platform, mm.
pub type Touch = [f64; 3];

/// Fewest touches.
pub const TOUCHES_MIN: usize = 3;
/// Shortest distance between two touches in plan view, and of the touches from a line, mm.
pub const APART_MIN_MM: f64 = 20.0;

/// Standard error of a touch in z, mm: the finest step of an operator.
pub const TOUCH_ERROR_MM: f64 = 0.1;
/// Largest standard error of the plane at a corner of the sheet, mm: as much as a pen's spring gives way.
pub const CORNER_ERROR_MAX_MM: f64 = 0.3;
/// Largest distance of one of four or more touches from the plane that is stored, mm.
pub const RESIDUAL_MAX_MM: f64 = 0.5;

/// How far below its first touch the pen usually draws, mm.
pub const PRESS_MM: f64 = 0.3;

/// Why touches give no plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TouchError {
    /// There are too few.
    Few {
        /// Their number.
        touches: usize,
    },
    /// Two are at nearly the same place.
    Near {
        /// Their numbers, from 1.
        touches: [usize; 2],
        /// Their distance in plan view, mm.
        distance_mm: f64,
    },
    /// They are nearly on a line in plan view.
    Line {
        /// Width of the narrowest strip that contains them and is parallel to their longest extent, mm.
        width_mm: f64,
    },
    /// The plane is too steep.
    Steep {
        /// Its tilt, degrees.
        tilt_deg: f64,
    },
    /// They are too far from a corner of the sheet to tell its height.
    Uncertain {
        /// The corner, x and y in the robot's frame, mm.
        corner_mm: [f64; 2],
        /// Standard error of its height, mm.
        error_mm: f64,
    },
    /// One is far off the plane through all of them.
    Off {
        /// Its number, from 1.
        touch: usize,
        /// Its place, x and y, mm.
        place_mm: [f64; 2],
        /// Its distance from the plane in z, mm.
        residual_mm: f64,
    },
}

impl std::fmt::Display for TouchError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Few { touches } => write!(
                f,
                "a plane needs {TOUCHES_MIN} touches, and there are {touches}; touch the sheet near three of its corners"
            ),
            Self::Near {
                touches: [first, second],
                distance_mm,
            } => write!(
                f,
                "touches {first} and {second} are only {distance_mm:.1} mm apart: at least {APART_MIN_MM} mm are needed, \
                 better the length of the sheet"
            ),
            Self::Line { width_mm } => write!(
                f,
                "the touches lie on a line, within a strip of {width_mm:.1} mm: at least {APART_MIN_MM} mm are needed; \
                 touch the sheet near a third corner"
            ),
            Self::Steep { tilt_deg } => write!(
                f,
                "the touches give a tilt of {tilt_deg:.1} degrees, and a sheet may rise by {} mm over 100 mm of x or of y: was \
                 one of them beside the sheet, or before the pen touched?",
                100.0 * Paper::SLOPE_MAX
            ),
            Self::Uncertain {
                corner_mm: [x, y],
                error_mm,
            } => write!(
                f,
                "the touches give the height of the corner at x {x:.0}, y {y:.0} mm to {error_mm:.1} mm only, and \
                 {CORNER_ERROR_MAX_MM} mm are needed: touch the sheet nearer to that corner"
            ),
            Self::Off {
                touch,
                place_mm: [x, y],
                residual_mm,
            } => write!(
                f,
                "touch {touch} at x {x:.0}, y {y:.0} mm is {residual_mm:.2} mm off the plane, and at most {RESIDUAL_MAX_MM} mm \
                 can be stored: touch there again, or smooth the sheet"
            ),
        }
    }
}

impl std::error::Error for TouchError {}

/// A plane through touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The plane.
    pub plane: Plane,
    /// Largest distance of a touch from it in z, mm.
    pub residual_mm: f64,
    /// The touch with that distance, from 1.
    pub worst: usize,
}

/// Angle between a plane and the level, degrees.
#[must_use]
pub fn tilt_deg([along_x, along_y]: [f64; 2]) -> f64 {
    along_x.hypot(along_y).atan().to_degrees()
}

/// Difference between the highest and the lowest corner of a sheet, mm.
#[must_use]
pub fn rise_mm(paper: &Paper) -> f64 {
    let sides = paper.slope.iter().zip(paper.size_mm);
    sides.map(|(slope, side_mm)| (slope * side_mm).abs()).sum()
}

/// The plane through touches.
///
/// # Errors
/// [`TouchError`].
pub fn fit(touches: &[Touch]) -> Result<Fit, TouchError> {
    if touches.len() < TOUCHES_MIN {
        return Err(TouchError::Few { touches: touches.len() });
    }
    check_distances(touches)?;
    let mean = mean_of(touches);
    let sum = |first: usize, second: usize| moment(touches, mean, first, second);
    let (xx, xy, yy, xz, yz) = (sum(0, 0), sum(0, 1), sum(1, 1), sum(0, 2), sum(1, 2));
    check_width(touches, [xx, xy, yy])?;
    let determinant = xx * yy - xy * xy;
    let slope = [(xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant];
    if !slope.iter().all(|slope| slope.abs() <= Paper::SLOPE_MAX) {
        let tilt_deg = tilt_deg(slope);
        return Err(TouchError::Steep { tilt_deg });
    }
    let plane = Plane {
        z_mm: mean[2] - slope[0] * mean[0] - slope[1] * mean[1],
        slope,
    };
    let distances = touches.iter().map(|[x, y, z]| (z - plane.z_at_mm(*x, *y)).abs());
    let (worst, residual_mm) = (1..)
        .zip(distances)
        .fold((1, 0.0), |worst, found| if found.1 > worst.1 { found } else { worst });
    Ok(Fit {
        plane,
        residual_mm,
        worst,
    })
}

fn mean_of(touches: &[Touch]) -> Touch {
    let count = touches.len() as f64;
    [0, 1, 2].map(|axis| touches.iter().map(|touch| touch[axis]).sum::<f64>() / count)
}

/// Sum of the products of two coordinates, each from its mean.
fn moment(touches: &[Touch], mean: Touch, first: usize, second: usize) -> f64 {
    let products = touches
        .iter()
        .map(|touch| (touch[first] - mean[first]) * (touch[second] - mean[second]));
    products.sum()
}

/// Checks that the touches tell the height of every corner of a sheet.
///
/// The variance of a plane of least squares at a distance d from the mean of n places is the touches' own, times
/// 1/n + d' M^-1 d, with M their matrix of second moments.
///
/// # Errors
/// [`TouchError::Uncertain`] with the corner that they tell least about.
pub fn check_corners(touches: &[Touch], paper: &Paper) -> Result<(), TouchError> {
    let mean = mean_of(touches);
    let [xx, xy, yy] = [(0, 0), (0, 1), (1, 1)].map(|(first, second)| moment(touches, mean, first, second));
    let determinant = xx * yy - xy * xy;
    let ([x, y], [width, height]) = (paper.centre_mm, paper.size_mm);
    let corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)];
    let worst = corners
        .map(|(across, along)| [x + across * width, y + along * height])
        .map(|corner_mm| {
            let (dx, dy) = (corner_mm[0] - mean[0], corner_mm[1] - mean[1]);
            let away = (dx * dx * yy - 2.0 * dx * dy * xy + dy * dy * xx) / determinant;
            (corner_mm, TOUCH_ERROR_MM * (1.0 / touches.len() as f64 + away).sqrt())
        })
        .into_iter()
        .fold(None, |worst: Option<([f64; 2], f64)>, found| match worst {
            Some(worst) if found.1 <= worst.1 => Some(worst),
            _ => Some(found),
        });
    match worst {
        // Not a number is too much as well.
        Some((corner_mm, error_mm)) if error_mm.is_nan() || error_mm > CORNER_ERROR_MAX_MM => {
            Err(TouchError::Uncertain { corner_mm, error_mm })
        }
        _ => Ok(()),
    }
}

/// Checks that no touch is too far off the plane to be stored. Three touches are always on their plane.
///
/// # Errors
/// [`TouchError::Off`].
pub fn check_residual(touches: &[Touch], fit: &Fit) -> Result<(), TouchError> {
    let Some([x, y, _]) = touches.get(fit.worst - 1).filter(|_| touches.len() > TOUCHES_MIN) else {
        return Ok(());
    };
    match fit.residual_mm <= RESIDUAL_MAX_MM {
        true => Ok(()),
        false => Err(TouchError::Off {
            touch: fit.worst,
            place_mm: [*x, *y],
            residual_mm: fit.residual_mm,
        }),
    }
}

/// Adds a touch as the last one, in the place of those nearer than [`APART_MIN_MM`] to it; returns the number of the first
/// one that it replaces, from 1.
pub fn add(touches: &mut Vec<Touch>, touch: Touch) -> Option<usize> {
    let is_near = |[x, y, _]: &Touch| (x - touch[0]).hypot(y - touch[1]) < APART_MIN_MM;
    let replaced = touches.iter().position(is_near).map(|place| place + 1);
    touches.retain(|other| !is_near(other));
    touches.push(touch);
    replaced
}

fn check_distances(touches: &[Touch]) -> Result<(), TouchError> {
    for (second, [x, y, _]) in touches.iter().enumerate() {
        for (first, [other_x, other_y, _]) in touches.iter().enumerate().take(second) {
            let distance_mm = (x - other_x).hypot(y - other_y);
            if distance_mm < APART_MIN_MM || distance_mm.is_nan() {
                let touches = [first + 1, second + 1];
                return Err(TouchError::Near { touches, distance_mm });
            }
        }
    }
    Ok(())
}

/// Checks the extent across the longest one, whose direction is the principal axis of the second moments xx, xy, yy.
fn check_width(touches: &[Touch], [xx, xy, yy]: [f64; 3]) -> Result<(), TouchError> {
    let (sine, cosine) = (0.5 * (2.0 * xy).atan2(xx - yy)).sin_cos();
    let across = touches.iter().map(|[x, y, _]| y * cosine - x * sine);
    let (low, high) = across.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    let width_mm = high - low;
    match width_mm >= APART_MIN_MM {
        true => Ok(()),
        false => Err(TouchError::Line { width_mm }),
    }
}

/// The sheet as it lies: the pen draws `press_mm` below where it first touched.
#[must_use]
pub fn lying(paper: &Paper, plane: &Plane, press_mm: f64) -> Paper {
    let rounded = |value: f64, part: f64| (value * part).round() / part;
    let [x_mm, y_mm] = paper.centre_mm;
    Paper {
        pen_down_z_mm: rounded(plane.z_at_mm(x_mm, y_mm) - press_mm, 1.0e3),
        // Over a metre less than a micrometre.
        slope: plane.slope.map(|slope| rounded(slope, 1.0e6)),
        ..*paper
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on(slope: [f64; 2], places: &[[f64; 2]]) -> Vec<Touch> {
        let touch = |[x, y]: &[f64; 2]| [*x, *y, -850.0 + slope[0] * x + slope[1] * y];
        places.iter().map(touch).collect()
    }

    const CORNERS: [[f64; 2]; 4] = [[-80.0, -90.0], [85.0, -80.0], [70.0, 90.0], [-90.0, 75.0]];

    #[test]
    fn three_touches_give_their_plane_and_more_the_one_between_them() {
        let slope = [0.00873, -0.004];
        for count in [3, 4] {
            let found = fit(&on(slope, &CORNERS[..count])).unwrap();
            assert!((found.plane.z_mm + 850.0).abs() < 1.0e-9, "{found:?}");
            assert!(
                (found.plane.slope[0] - slope[0]).abs() < 1.0e-12 && (found.plane.slope[1] - slope[1]).abs() < 1.0e-12
            );
            assert!(found.residual_mm < 1.0e-9);
        }
        let mut touches = on(slope, &CORNERS);
        touches[2][2] += 0.4;
        let found = fit(&touches).unwrap();
        // Nothing nearby has a smaller sum of squares.
        let squares = |plane: &Plane| -> f64 {
            touches
                .iter()
                .map(|[x, y, z]| (z - plane.z_at_mm(*x, *y)).powi(2))
                .sum()
        };
        for (up, x, y) in [(0.01, 0.0, 0.0), (0.0, 1.0e-4, 0.0), (0.0, 0.0, 1.0e-4)] {
            for sign in [-1.0, 1.0] {
                let [along_x, along_y] = found.plane.slope;
                let other = Plane {
                    z_mm: found.plane.z_mm + sign * up,
                    slope: [along_x + sign * x, along_y + sign * y],
                };
                assert!(squares(&other) > squares(&found.plane));
            }
        }
        assert!(found.residual_mm > 0.05 && found.residual_mm < 0.2, "{found:?}");
    }

    #[test]
    fn touches_that_say_too_little_are_refused_with_the_reason() {
        assert_eq!(fit(&on([0.0; 2], &CORNERS[..2])), Err(TouchError::Few { touches: 2 }));
        let near = on([0.0; 2], &[[0.0, 0.0], [100.0, 0.0], [100.0, 19.0]]);
        let expected = TouchError::Near {
            touches: [2, 3],
            distance_mm: 19.0,
        };
        assert_eq!(fit(&near), Err(expected));
        let line = on([0.0; 2], &[[0.0, 0.0], [50.0, 50.0], [100.0, 110.0]]);
        assert!(matches!(fit(&line), Err(TouchError::Line { width_mm }) if width_mm < 10.0));
        let steep = on([0.12, 0.0], &CORNERS);
        assert!(matches!(fit(&steep), Err(TouchError::Steep { tilt_deg }) if (tilt_deg - 6.84).abs() < 0.01));
        let broken = [[0.0, 0.0, f64::NAN], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0]];
        assert!(fit(&broken).is_err() && fit(&[[f64::NAN; 3]; 3]).is_err());
    }

    #[test]
    fn touches_that_say_nothing_about_a_corner_are_refused_and_name_it() {
        let paper = Paper::default();
        let narrow = on([0.0; 2], &[[-90.0, -90.0], [-66.0, -90.0], [-78.0, -69.0]]);
        assert!(fit(&narrow).is_ok());
        let refused = check_corners(&narrow, &paper).unwrap_err();
        assert!(
            matches!(refused, TouchError::Uncertain { corner_mm: [100.0, 100.0], error_mm } if error_mm > 1.0),
            "{refused:?}"
        );
        assert!(refused.to_string().contains("x 100, y 100 mm"), "{refused}");
        assert_eq!(check_corners(&on([0.0; 2], &CORNERS[..3]), &paper), Ok(()));
        assert_eq!(check_corners(&on([0.0; 2], &CORNERS), &paper), Ok(()));
    }

    /// The height of a corner from touches with errors of a tenth of a millimetre scatters as the check says.
    #[test]
    fn the_error_of_a_corner_is_the_scatter_of_its_height() {
        let places = [[-60.0, -70.0], [55.0, -40.0], [10.0, 80.0]];
        let paper = Paper {
            size_mm: [600.0, 600.0],
            ..Paper::default()
        };
        let refused = check_corners(&on([0.0; 2], &places), &paper).unwrap_err();
        let TouchError::Uncertain {
            corner_mm: [x, y],
            error_mm,
        } = refused
        else {
            panic!("{refused:?}")
        };
        // Errors of one touch at a time: their effects add in squares.
        let squares = (0..3).map(|wrong| {
            let mut touches = on([0.0; 2], &places);
            touches[wrong][2] += TOUCH_ERROR_MM;
            (fit(&touches).unwrap().plane.z_at_mm(x, y) + 850.0).powi(2)
        });
        assert!((squares.sum::<f64>().sqrt() - error_mm).abs() < 1.0e-9, "{error_mm}");
    }

    #[test]
    fn a_touch_near_another_takes_its_place_and_is_the_last_one() {
        let mut touches = on([0.0; 2], &CORNERS);
        assert_eq!(add(&mut touches, [-70.0, -80.0, -849.0]), Some(1));
        assert_eq!(touches.len(), 4);
        assert_eq!(touches.last(), Some(&[-70.0, -80.0, -849.0]));
        assert_eq!(add(&mut touches, [0.0, 0.0, -850.0]), None);
        assert_eq!(touches.len(), 5);
    }

    #[test]
    fn a_touch_far_off_the_plane_of_four_or_more_is_named() {
        let mut touches = on([0.01, 0.0], &CORNERS);
        touches.push([0.0, 0.0, -848.5]);
        let found = fit(&touches).unwrap();
        let refused = check_residual(&touches, &found).unwrap_err();
        assert!(matches!(refused, TouchError::Off { touch: 5, .. }), "{refused:?}");
        assert!(
            refused.to_string().starts_with("touch 5 at x 0, y 0 mm is 1."),
            "{refused}"
        );
        touches.truncate(3);
        touches[0][2] += 2.0;
        assert_eq!(check_residual(&touches, &fit(&touches).unwrap()), Ok(()));
    }

    #[test]
    fn the_pen_draws_below_where_it_touched_and_the_height_is_that_of_the_centre() {
        let paper = Paper {
            centre_mm: [100.0, 0.0],
            ..Paper::default()
        };
        let plane = fit(&on([0.01, 0.0], &CORNERS)).unwrap().plane;
        let found = lying(&paper, &plane, 0.3);
        assert_eq!((found.pen_down_z_mm, found.slope), (-849.3, [0.01, 0.0]));
        assert!((found.plane().z_at_mm(0.0, 50.0) + 850.3).abs() < 1.0e-9);
    }
}
