//! The dimensions of a machine from marks that it drew.
//!
//! The controller believes its axes at a pose and puts a mark where its dimensions say that the pen is. Somebody measures where the
//! marks truly are, in any frame on the sheet. Least squares find the dimensions, the positions of the axes at their marks and the
//! frame that explain what was measured; each dimension has a usual error beside it (a Gaussian prior), so what marks on one sheet
//! cannot tell stays as it was. A mark is also predicted from all others, which shows what the fit is worth where nobody measured.
//!
//! The plane in which the marks lie is not measured: it is where the pen wrote, so in the new dimensions the sheet lies where the
//! same poses of the axes are. Touches of the sheet tell only about height, and nearly nothing of the dimensions: see
//! [`expected_mm`].

mod checks;
mod least_squares;
pub mod marks;
pub mod parameters;
mod rigid;

use crate::settings::sheet::follows;
use crate::touches::{self, TOUCH_ERROR_MM, Touch};
use checks::{check_changes, check_each, check_touches, checked};
use etherpen::config::{Config, Plane};
use etherpen::robots::{AXES, JointAngles, Kinematics, MAIN_AXES, Position};
use least_squares::{Equation, Normal};
use marks::Mark;
use parameters::{Parameter, changed, of, true_pose};
use rigid::Rigid;

/// Positions of the main axes, as in the controller.
pub type JointPose = [f64; MAIN_AXES];

/// Fewest marks.
pub const MARKS_MIN: usize = 6;
/// Steps of the solution at most, and the length of the last one, usual errors.
const STEPS_MAX: usize = 30;
const STEP_MIN: f64 = 1.0e-6;
/// Length of a difference for a slope, usual errors.
const DIFFERENCE: f64 = 1.0e-3;
/// Unknowns of the frame: a turn and a displacement, and their usual errors, rad and mm.
const FRAME_USUAL: [f64; 3] = [1.0, 1.0e3, 1.0e3];
/// Unknowns of the plane of touches, and their usual errors: mm, and mm for each mm.
const PLANE_USUAL: [f64; 3] = [1.0e2, 0.1, 0.1];
/// Points a side of the grid over the sheet.
const GRID: usize = 9;

/// A distance of many points: its root mean square and the largest, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Distance {
    /// Root mean square.
    pub rms_mm: f64,
    /// Largest.
    pub max_mm: f64,
}

impl Distance {
    fn of(distances: impl Iterator<Item = f64>) -> Self {
        let (mut squares, mut max_mm, mut count) = (0.0, 0.0_f64, 0);
        for distance in distances {
            squares += distance * distance;
            max_mm = max_mm.max(distance);
            count += 1;
        }
        Self {
            rms_mm: (squares / f64::from(count.max(1))).sqrt(),
            max_mm,
        }
    }
}

/// What was found.
#[derive(Clone, Debug)]
pub struct Found {
    /// The configuration with all of it.
    pub config: Config,
    /// What may have changed.
    pub parameters: Vec<Parameter>,
    /// The change of each, and its standard error, in the controller's unit.
    pub changes: Vec<[f64; 2]>,
    /// Distance of the marks from their places as the machine is, the sheet placed best.
    pub before: Distance,
    /// Distance of the marks from their places with what was found, the sheet placed best.
    pub after: Distance,
    /// Distance of each mark from where all others predict it.
    pub predicted: Distance,
    /// What is left of the marks, in parts of what the error of measuring them explains. The standard errors have it in them.
    pub left_over: f64,
}

impl Found {
    /// Whether the marks are predicted better with what was found than without.
    #[must_use]
    pub fn is_better(&self) -> bool {
        self.predicted.rms_mm < self.before.rms_mm
    }
}

/// A machine whose dimensions are to be found.
struct Machine<'c> {
    config: &'c Config,
    kinematics: Kinematics,
    parameters: Vec<Parameter>,
}

impl<'c> Machine<'c> {
    fn new(config: &'c Config) -> Result<Self, String> {
        Ok(Self {
            config,
            kinematics: Kinematics::new(&config.geometry).map_err(|error| format!("{error:?}"))?,
            parameters: of(config.geometry.kind()),
        })
    }

    /// The pose in which the controller believes the pen at a place.
    fn pose(&self, x_mm: f64, y_mm: f64, z_mm: f64) -> Result<JointPose, String> {
        let place = Position { x_mm, y_mm, z_mm };
        let refused = |_| format!("the machine does not reach {x_mm:.1}, {y_mm:.1}, {z_mm:.1} mm");
        self.kinematics.inverse(&place).map_err(refused)
    }

    /// The pose in which it believes the pen on the sheet, at a place from the sheet's middle.
    fn pose_on_sheet(&self, [x_mm, y_mm]: [f64; 2]) -> Result<JointPose, String> {
        let paper = &self.config.paper;
        let [along_x, along_y] = paper.slope;
        let z_mm = paper.pen_down_z_mm + along_x * x_mm + along_y * y_mm;
        self.pose(paper.centre_mm[0] + x_mm, paper.centre_mm[1] + y_mm, z_mm)
    }

    /// The machine with changes; `None` if there is none of such dimensions.
    fn with(&self, changes: &[f64]) -> Option<Changed<'_>> {
        let there = changed(self.config, &self.parameters, changes, false);
        Some(Changed {
            machine: self,
            changes: changes.to_vec(),
            kinematics: Kinematics::new(&there.geometry).ok()?,
        })
    }

    fn usual(&self) -> impl Iterator<Item = f64> {
        self.parameters.iter().map(|parameter| parameter.usual)
    }
}

/// A machine that differs from its configuration.
struct Changed<'m> {
    machine: &'m Machine<'m>,
    changes: Vec<f64>,
    kinematics: Kinematics,
}

impl Changed<'_> {
    /// Where the pen truly is when the controller believes the axes at a pose.
    fn place(&self, believed: JointPose) -> Option<[f64; 3]> {
        let mut joints = [0.0; AXES];
        let pose = true_pose(self.machine.config, &self.machine.parameters, &self.changes, believed);
        for (joint, position) in joints.iter_mut().zip(pose) {
            *joint = position;
        }
        let place = self.kinematics.forward(&JointAngles(joints)).ok()?;
        Some([place.x_mm, place.y_mm, place.z_mm])
    }
}

/// What was measured: marks with the poses in which they were drawn, and poses in which the pen touched the sheet.
struct Measured {
    marks: Vec<(JointPose, [f64; 2])>,
    mark_error_mm: f64,
    touches: Vec<JointPose>,
}

impl Measured {
    /// What is left of each measurement, standard errors, with these unknowns: changes, frame and plane.
    fn left(&self, machine: &Machine<'_>, unknowns: &[f64]) -> Option<Vec<f64>> {
        let (changes, rest) = unknowns.split_at_checked(machine.parameters.len())?;
        let [turn, x, y, height, along_x, along_y] = *rest.first_chunk()?;
        let frame = Rigid::new(turn, [x, y]);
        let machine = machine.with(changes)?;
        let mut left = Vec::with_capacity(2 * self.marks.len() + self.touches.len());
        for (pose, measured_mm) in &self.marks {
            let [x, y, _] = machine.place(*pose)?;
            let [measured_x, measured_y] = frame.of(*measured_mm);
            left.extend([measured_x - x, measured_y - y].map(|mm| mm / self.mark_error_mm));
        }
        let plane = Plane {
            z_mm: height,
            slope: [along_x, along_y],
        };
        for pose in &self.touches {
            let [x, y, z] = machine.place(*pose)?;
            left.push((plane.z_at_mm(x, y) - z) / TOUCH_ERROR_MM);
        }
        Some(left)
    }

    /// The sums of all equations around these unknowns.
    fn normal(&self, machine: &Machine<'_>, unknowns: &[f64], usual: &[f64]) -> Option<Normal> {
        let left = self.left(machine, unknowns)?;
        let mut equations: Vec<Equation> = left
            .iter()
            .map(|left| Equation {
                slopes: Vec::with_capacity(usual.len()),
                left: -left,
            })
            .collect();
        for (index, usual) in usual.iter().enumerate() {
            let moved = |by: f64| {
                let mut moved = unknowns.to_vec();
                *moved.get_mut(index)? += by * usual;
                self.left(machine, &moved)
            };
            let (above, below) = (moved(DIFFERENCE)?, moved(-DIFFERENCE)?);
            for ((equation, above), below) in equations.iter_mut().zip(above).zip(below) {
                equation.slopes.push((above - below) / (2.0 * DIFFERENCE * usual));
            }
        }
        for (index, (usual, unknown)) in usual.iter().zip(unknowns).enumerate() {
            let mut slopes = vec![0.0; index];
            slopes.push(1.0 / usual);
            slopes.resize(unknowns.len(), 0.0);
            equations.push(Equation {
                slopes,
                left: -unknown / usual,
            });
        }
        Normal::of(&equations, unknowns.len())
    }

    /// The unknowns that explain what was measured, and their covariance.
    fn solve(&self, machine: &Machine<'_>, start: Rigid) -> Option<(Vec<f64>, Vec<Vec<f64>>)> {
        let usual: Vec<f64> = machine.usual().chain(FRAME_USUAL).chain(PLANE_USUAL).collect();
        let mut unknowns = vec![0.0; machine.parameters.len()];
        unknowns.extend(start.unknowns());
        unknowns.extend([machine.config.paper.pen_down_z_mm, 0.0, 0.0]);
        for _ in 0..STEPS_MAX {
            let normal = self.normal(machine, &unknowns, &usual)?;
            let step = normal.solution()?;
            let mut longest = 0.0_f64;
            for ((unknown, step), usual) in unknowns.iter_mut().zip(&step).zip(&usual) {
                *unknown += step;
                longest = longest.max((step / usual).abs());
            }
            if longest < STEP_MIN {
                let covariance = self.normal(machine, &unknowns, &usual)?.covariance()?;
                return Some((unknowns, covariance));
            }
        }
        None
    }

    /// Distances of the marks from where these unknowns have them, mm.
    fn distances(&self, machine: &Machine<'_>, unknowns: &[f64]) -> Option<Vec<f64>> {
        let left = self.left(machine, unknowns)?;
        let pairs = left.chunks_exact(2).take(self.marks.len());
        Some(
            pairs
                .map(|pair| pair.iter().fold(0.0_f64, |sum, left| sum.hypot(*left)) * self.mark_error_mm)
                .collect(),
        )
    }
}

/// The dimensions of a machine from marks; `error_mm` is the standard error of measuring a mark in x and in y.
///
/// # Errors
/// There are too few marks, they do not fit to what was drawn, one was measured wrong, or no machine explains them; which, and
/// what to do.
pub fn calibrate(config: &Config, marks: &[Mark], touches: &[Touch], error_mm: f64) -> Result<Found, String> {
    let machine = Machine::new(config)?;
    let placed = checked(config, marks)?;
    check_touches(touches)?;
    let measured = Measured {
        marks: marks
            .iter()
            .map(|mark| Ok((machine.pose_on_sheet(mark.wanted_mm)?, mark.measured_mm)))
            .collect::<Result<_, String>>()?,
        mark_error_mm: error_mm,
        touches: touches
            .iter()
            .map(|[x, y, z]| machine.pose(*x, *y, *z))
            .collect::<Result<_, _>>()?,
    };
    let unexplained = || "no machine of this kind explains these marks; look at the table again".to_owned();
    let (unknowns, covariance) = measured.solve(&machine, placed).ok_or_else(unexplained)?;
    let after = measured.distances(&machine, &unknowns).ok_or_else(unexplained)?;
    let predicted = left_out(&machine, &measured, placed).ok_or_else(unexplained)?;
    check_each(marks, &predicted)?;
    let left_over = left_over(&machine, &measured, &unknowns).ok_or_else(unexplained)?;
    let changes: Vec<[f64; 2]> = unknowns
        .iter()
        .zip(covariance.iter().enumerate())
        .map(|(change, (index, row))| {
            [
                *change,
                row.get(index)
                    .map_or(0.0, |variance| variance.sqrt() * left_over.max(1.0)),
            ]
        })
        .take(machine.parameters.len())
        .collect();
    check_changes(&machine, &changes)?;
    let before = marks.iter().map(|mark| {
        let [x, y] = placed.of(mark.measured_mm);
        (x - config.paper.centre_mm[0] - mark.wanted_mm[0]).hypot(y - config.paper.centre_mm[1] - mark.wanted_mm[1])
    });
    Ok(Found {
        config: found_config(&machine, &changes, &measured)?,
        before: Distance::of(before),
        after: Distance::of(after.into_iter()),
        predicted: Distance::of(predicted.into_iter()),
        left_over,
        parameters: machine.parameters,
        changes,
    })
}

/// The error of shape over the sheet that is to be expected, mm rms, before anything is measured and with such measurements:
/// touches, and marks of `places` (from the sheet's middle).
///
/// # Errors
/// The machine does not reach the sheet or a touch.
pub fn expected_mm(config: &Config, places: &[[f64; 2]], touches: &[Touch], error_mm: f64) -> Result<[f64; 2], String> {
    let machine = Machine::new(config)?;
    let measured = Measured {
        marks: places
            .iter()
            .map(|[x, y]| {
                let [centre_x, centre_y] = config.paper.centre_mm;
                Ok((machine.pose_on_sheet([*x, *y])?, [centre_x + x, centre_y + y]))
            })
            .collect::<Result<_, String>>()?,
        mark_error_mm: error_mm,
        touches: touches
            .iter()
            .map(|[x, y, z]| machine.pose(*x, *y, *z))
            .collect::<Result<_, _>>()?,
    };
    let usual: Vec<f64> = machine.usual().chain(FRAME_USUAL).chain(PLANE_USUAL).collect();
    let mut unknowns = vec![0.0; usual.len()];
    if let Some(height) = unknowns.get_mut(machine.parameters.len() + FRAME_USUAL.len()) {
        *height = config.paper.pen_down_z_mm;
    }
    let found = || -> Option<[f64; 2]> {
        let covariance = measured.normal(&machine, &unknowns, &usual)?.covariance()?;
        let before: Vec<Vec<f64>> = (0..machine.parameters.len())
            .map(|index| {
                let mut row = vec![0.0; usual.len()];
                let variance = usual.get(index).map(|usual| usual * usual)?;
                *row.get_mut(index)? = variance;
                Some(row)
            })
            .collect::<Option<_>>()?;
        Some([shape_mm(&machine, &before)?, shape_mm(&machine, &covariance)?])
    };
    found().ok_or_else(|| "the machine does not reach all of the sheet".to_owned())
}

/// Error of shape over the sheet, mm rms, of parameters with this covariance, the sheet placed best.
fn shape_mm(machine: &Machine<'_>, covariance: &[Vec<f64>]) -> Option<f64> {
    let paper = &machine.config.paper;
    let part = |index: usize| index as f64 / (GRID - 1) as f64 - 0.5;
    let grid = (0..GRID).flat_map(|row| (0..GRID).map(move |column| [part(column), part(row)]));
    let places: Vec<[f64; 2]> = grid
        .map(|[x, y]| [x * paper.size_mm[0], y * paper.size_mm[1]])
        .collect();
    let poses: Vec<JointPose> = places
        .iter()
        .map(|place| machine.pose_on_sheet(*place).ok())
        .collect::<Option<_>>()?;
    let mut shifts: Vec<Vec<[f64; 2]>> = Vec::new();
    for (index, usual) in machine.usual().enumerate() {
        let at = |by: f64| {
            let mut changes = vec![0.0; machine.parameters.len()];
            *changes.get_mut(index)? = by * usual;
            let there = machine.with(&changes)?;
            let places = poses.iter().map(|pose| there.place(*pose).map(|[x, y, _]| [x, y]));
            places.collect::<Option<Vec<_>>>()
        };
        let (above, below) = (at(DIFFERENCE)?, at(-DIFFERENCE)?);
        let slope = |(above, below): (&[f64; 2], &[f64; 2])| {
            [0, 1].map(|axis| (above[axis] - below[axis]) / (2.0 * DIFFERENCE * usual))
        };
        let slopes: Vec<[f64; 2]> = above.iter().zip(&below).map(slope).collect();
        shifts.push(rigid::without(&places, &slopes));
    }
    let mut sum = 0.0;
    for (row, shifts_of_row) in covariance.iter().zip(&shifts) {
        for (value, shifts_of_column) in row.iter().zip(&shifts) {
            let products = shifts_of_row.iter().zip(shifts_of_column);
            sum += value
                * products
                    .map(|(one, other)| one[0] * other[0] + one[1] * other[1])
                    .sum::<f64>();
        }
    }
    Some((sum.max(0.0) / places.len() as f64).sqrt())
}

/// What is left of the marks, in parts of what their error explains.
fn left_over(machine: &Machine<'_>, measured: &Measured, unknowns: &[f64]) -> Option<f64> {
    let left = measured.left(machine, unknowns)?;
    let of_marks = 2 * measured.marks.len();
    let squares: f64 = left.iter().take(of_marks).map(|left| left * left).sum();
    let free = of_marks
        .saturating_sub(machine.parameters.len() + FRAME_USUAL.len())
        .max(1);
    Some((squares / free as f64).sqrt())
}

/// Distance of each mark from where all others predict it, mm.
fn left_out(machine: &Machine<'_>, measured: &Measured, start: Rigid) -> Option<Vec<f64>> {
    let of = |index: usize| {
        let mut others = Measured {
            marks: measured.marks.clone(),
            touches: measured.touches.clone(),
            ..*measured
        };
        others.marks.remove(index);
        let (unknowns, _) = others.solve(machine, start)?;
        measured.distances(machine, &unknowns)?.get(index).copied()
    };
    (0..measured.marks.len()).map(of).collect()
}

/// The configuration with the changes, and with the sheet where the pen wrote.
fn found_config(machine: &Machine<'_>, changes: &[[f64; 2]], measured: &Measured) -> Result<Config, String> {
    let values: Vec<f64> = changes.iter().map(|[change, _]| *change).collect();
    let mut config = changed(machine.config, &machine.parameters, &values, true);
    if follows(&config).is_ok() {
        let there = machine.with(&values).ok_or("no such machine")?;
        let places = measured.marks.iter().map(|(pose, _)| there.place(*pose));
        let plane = places.collect::<Option<Vec<_>>>().and_then(|places| plane(&places));
        config.paper = touches::lying(&config.paper, &plane.ok_or("the marks lie in no plane")?, 0.0);
    }
    let invalid =
        |cause: String| format!("what was found is no machine that can draw: {cause}; look at the table again");
    config
        .check()
        .map_err(|error| invalid(crate::link::text::config_error(&error)))?;
    Ok(config)
}

/// The plane through places with the least squares of its distances in z.
fn plane(places: &[[f64; 3]]) -> Option<Plane> {
    let equation = |[x, y, z]: &[f64; 3]| Equation {
        slopes: vec![1.0, *x, *y],
        left: *z,
    };
    let equations: Vec<Equation> = places.iter().map(equation).collect();
    let solution = Normal::of(&equations, PLANE_USUAL.len())?.solution()?;
    let [z_mm, along_x, along_y] = *solution.first_chunk()?;
    Some(Plane {
        z_mm,
        slope: [along_x, along_y],
    })
}

#[cfg(test)]
mod tests;
