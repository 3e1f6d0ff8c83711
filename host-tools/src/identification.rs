//! Identification of delay and gain of the drives from the telemetry of a test motion.
//!
//! The position controller itself recomputes its commands from the telemetry. A drive answers with a velocity w(t) = g
//! u(t - D). The regression of w on the command, its first three derivatives and a constant gives the gain g and the
//! mean delay D for any shape of the response, because slow signals depend only on its first moments. These give for
//! each axis
//!
//! - feed-forward gain Kff = 1 / g;
//! - feed-forward lead tau = D - age - 0.5 ms: the command has to be as early as its response is late, and the
//!   measurement is compared with the reference of its age; 0.5 ms is the centre of a 1 ms difference;
//! - feedback gain Kfb = (pi / 6) / (D - 0.5 ms) / g: the loop of an integrator and a delay has a phase margin of 60
//!   degrees there (Åström and Murray, *Feedback Systems*, 2nd ed., 10.3).
//!
//! The main axes share one lead and one Kfb, so that the platform's lag is along its path. Commands and responses pass
//! identical low-pass filters before the regression, which changes neither g nor D.
//!
//! An axis in position mode needs a second record (`by_position.rs`).
//!
//! Invariant: an axis that has hardly moved, or whose samples do not fit the model, gets no estimate.

mod by_position;
pub mod one_axis;
pub mod seen;

pub use by_position::weak_config;

use etherpen::application::Mode;
use etherpen::config::{Axis, AxisMode, Config, Orientation, command_delay_ms};
use etherpen::control::position::{PositionController, SETPOINTS_AHEAD};
use etherpen::messages::{PathVertex, Sample};
use etherpen::motion::Pen;
use etherpen::robots::{AXES, Kinematics, MAIN_AXES, Position};
use std::f64::consts::{PI, TAU};

/// Radius of the test motion's circles, mm.
const RADIUS_MM: f64 = 40.0;
/// Height of the test motion above the lifted pen, mm.
const CLEARANCE_MM: f64 = 25.0;
/// How far the circles rise and fall, mm.
const WAVE_MM: f64 = 15.0;
/// Rises and falls in one turn; not a whole number, so that every turn moves the joints differently.
const WAVES_PER_TURN: f64 = 2.4;
/// Turns, and vertices on each.
const TURNS: usize = 5;
const VERTICES_PER_TURN: usize = 72;
/// Figures of eight after the circles; there the path's direction swings back and forth, which moves the fourth axis.
const EIGHTS: usize = 4;
/// Strokes up and down at the end.
const STROKES_UP: usize = 4;
/// Highest speed and acceleration of the test motion, mm/s and mm/s2, unless the configuration's are lower.
const SPEED_MAX_MM_S: f64 = 400.0;
const ACCELERATION_MAX_MM_S2: f64 = 8_000.0;

/// Farthest turn of the fourth axis along the test motion, rad: that of the circles, of the way to them and of half a turn
/// where the axis starts from.
const TURNED_MAX_RAD: f64 = TAU * (TURNS as f64 + 1.5);

/// Half the width of the low-pass, ms.
const FILTER_HALF_MS: usize = 10;
/// Terms of the regression: command, three derivatives, constant.
const TERMS: usize = 5;
/// Parts that the record is divided into, for the uncertainty.
const PARTS: usize = 8;
/// Fewest samples of a part.
const PART_SAMPLES_MIN: usize = 100;
/// Smallest root mean square of a command's change that counts as motion, rad/s2.
const CHANGE_MIN_RAD_S2: f64 = 0.5;
/// Largest part of the response that the model may leave unexplained (root mean square).
const UNEXPLAINED_MAX: f64 = 0.1;

/// A value with its standard uncertainty.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// One standard deviation of the value, from the scatter between parts of the record.
    pub uncertainty: f64,
}

/// Identified response of one axis.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Answer {
    /// Samples used.
    pub samples: usize,
    /// Mean time from a command to the measured velocity, ms.
    pub delay_ms: Measured,
    /// Measured velocity for a commanded one.
    pub gain: Measured,
    /// Lead that results from the delay, ms.
    pub lead_ms: Measured,
    /// Feed-forward gain that results from the gain.
    pub feed_forward_gain: Measured,
    /// Feedback gain with a phase margin of 60 degrees, 1/s; in position mode the gain of the drive's position loop.
    pub feedback_gain_per_s: f64,
    /// Lead of the target position; absent in the other modes.
    pub position_lead_ms: Option<Measured>,
}

/// Why an axis has no estimate.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoAnswer {
    /// The axis is in torque mode: lead and gain of a velocity have no meaning for its drive.
    Torque,
    /// The axis is in position mode, which takes a second record.
    Position,
    /// The axis has hardly moved.
    Still,
    /// Too few consecutive samples.
    Samples,
    /// The response does not fit a delay and a gain.
    Model,
}

impl std::fmt::Display for NoAnswer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Torque => "the axis follows a torque; lead and gain belong to drives that follow a velocity",
            Self::Position => "the axis follows a position; a second test motion is needed",
            Self::Still => "the axis has hardly moved, its values are kept",
            Self::Samples => "too few samples without a gap",
            Self::Model => "the drive's response is not that of a delay and a gain; check its own controller",
        })
    }
}

/// Least limit of the feedback deviation during the test motion, rad: the delay used to predict the motion is not known
/// yet.
const FEEDBACK_DEVIATION_RAD: f64 = 0.03;
/// Largest gain of a drive's position loop that the supervision counts on during the test motion, 1/s: what it makes of an
/// error whose delay is not known yet.
const LOOP_GAIN_PER_S: f64 = 2.0;

/// The configuration for the test motion: the given one with a limited speed, with the fourth axis along the path if its
/// range allows that, and with a tolerance in the feedback supervision for the delay that is not known yet.
pub fn test_config(config: &Config) -> Config {
    let mut test = config.clone();
    let [low_rad, high_rad] = config.geometry.turn_range_rad();
    let motion = &mut test.motion;
    motion.orientation = match high_rad.min(-low_rad) > TURNED_MAX_RAD {
        true => Orientation::Path,
        false => Orientation::Constant,
    };
    motion.speed_mm_s = motion.speed_mm_s.min(SPEED_MAX_MM_S);
    motion.travel_speed_mm_s = motion.travel_speed_mm_s.min(SPEED_MAX_MM_S);
    motion.acceleration_mm_s2 = motion.acceleration_mm_s2.min(ACCELERATION_MAX_MM_S2);
    for axis in &mut test.axes {
        axis.feedback_deviation_max_rad = axis.feedback_deviation_max_rad.max(FEEDBACK_DEVIATION_RAD);
        if axis.mode == AxisMode::Position {
            axis.feedback_gain_per_s = axis.feedback_gain_per_s.min(LOOP_GAIN_PER_S);
        }
    }
    test
}

/// The middle of a motion in the air above the sheet's centre, and how far the lifted pen is below it at most, mm.
fn middle_mm(config: &Config) -> ([f64; 3], f64) {
    let paper = &config.paper;
    let [x_mm, y_mm] = paper.centre_mm;
    // The highest place of the sheet under the circles.
    let rise_mm = RADIUS_MM * paper.slope.iter().map(|slope| slope.abs()).sum::<f64>();
    let low_mm = paper.pen_down_z_mm + paper.pen_lift_mm + rise_mm;
    // A low ceiling makes the motion flatter.
    let clearance_mm = CLEARANCE_MM.min(0.5 * (config.work_area.z_high_mm - low_mm)).max(0.0);
    ([x_mm, y_mm, low_mm + clearance_mm], clearance_mm)
}

/// The joints with the tool above the sheet's centre, rad; `None` if the robot has no pose there.
pub fn joints_over_sheet_rad(config: &Config) -> Option<[f64; AXES]> {
    let kinematics = Kinematics::new(&config.geometry).ok()?;
    let [first, second, third] = kinematics.inverse(&Position::from(middle_mm(config).0)).ok()?;
    Some([first, second, third, 0.0])
}

/// The test motion: circles above the paper that rise and fall, figures of eight, then strokes up and down, all with
/// the pen lifted.
pub fn test_path(config: &Config) -> Vec<PathVertex> {
    let ([x_mm, y_mm, middle_mm], clearance_mm) = middle_mm(config);
    let wave_mm = WAVE_MM.min(clearance_mm);
    let vertex = |x: f64, y: f64, z: f64| PathVertex {
        position_um: [x, y, z].map(|mm| (mm * 1_000.0).round() as i32),
        pen: Pen::Up,
        stroke: 0,
    };
    let on_circle = (0..=TURNS * VERTICES_PER_TURN).map(|step| {
        let turn = step as f64 / VERTICES_PER_TURN as f64;
        let (sine, cosine) = (TAU * turn).sin_cos();
        let wave = (TAU * WAVES_PER_TURN * turn).sin();
        vertex(
            x_mm + RADIUS_MM * cosine,
            y_mm + RADIUS_MM * sine,
            middle_mm + wave_mm * wave,
        )
    });
    let on_eights = (1..=EIGHTS * VERTICES_PER_TURN).map(|step| {
        let (sine, cosine) = (TAU * step as f64 / VERTICES_PER_TURN as f64).sin_cos();
        // The circles end in this direction.
        vertex(x_mm + RADIUS_MM * cosine, y_mm + RADIUS_MM * sine * cosine, middle_mm)
    });
    let up_and_down = (0..=2 * STROKES_UP).map(|stroke| {
        let sign = if stroke % 2 == 0 { -1.0 } else { 1.0 };
        vertex(x_mm, y_mm, middle_mm + sign * wave_mm)
    });
    on_circle.chain(on_eights).chain(up_and_down).collect()
}

/// Estimates every axis from the telemetry of a motion run with `config`.
pub fn identify(config: &Config, samples: &[Sample]) -> [Result<Answer, NoAnswer>; AXES] {
    std::array::from_fn(|number| identify_by_velocity(config, number, samples))
}

/// Estimates every axis from the telemetry of two motions, one run with `config`, the other with its [`weak_config`]. The
/// second one is needed for axes in position mode.
pub fn identify_with_weak(config: &Config, samples: &[Sample], weak: &[Sample]) -> [Result<Answer, NoAnswer>; AXES] {
    std::array::from_fn(|number| match config.axes[number].mode {
        AxisMode::Velocity | AxisMode::Torque => identify_by_velocity(config, number, samples),
        // It finds how far the leads are off, whatever the exchange adds to them.
        AxisMode::Position => by_position::identify_axis(&config.axes[number], number, samples, weak),
    })
}

/// An estimate from the commands of the controller, whose lead is the configuration's and what the exchange costs.
fn identify_by_velocity(config: &Config, number: usize, samples: &[Sample]) -> Result<Answer, NoAnswer> {
    let mut answer = identify_axis(&config.controlled_axes()[number], number, samples)?;
    answer.lead_ms.value -= command_delay_ms(config.bus.exchange);
    match answer.lead_ms.value < 0.0 {
        true => Err(NoAnswer::Model),
        false => Ok(answer),
    }
}

/// Puts estimates into a configuration. `only` limits the change to one axis. Lead and feedback gain of the main axes
/// change together, to their mean and to their smallest value.
pub fn apply(config: &mut Config, answers: &[Result<Answer, NoAnswer>; AXES], only: Option<usize>) {
    let wanted = |axis: usize| only.is_none_or(|only| only == axis);
    // Axes without a drive answer nothing, and need nothing.
    let drives = usize::from(config.bus.drives);
    let main_axes = MAIN_AXES.min(drives);
    let main: Vec<&Answer> = answers
        .iter()
        .take(main_axes)
        .filter_map(|answer| answer.as_ref().ok())
        .collect();
    // Without an estimate of every main axis no lead is shared: the platform would lag beside its path.
    let main_wanted = (0..main_axes).any(wanted) && main.len() == main_axes;
    let lead_ms = main.iter().map(|answer| answer.lead_ms.value).sum::<f64>() / main_axes as f64;
    let position_leads_ms = main
        .iter()
        .map(|answer| answer.position_lead_ms.map(|lead_ms| lead_ms.value));
    let position_lead_ms = position_leads_ms
        .sum::<Option<f64>>()
        .map(|sum_ms| sum_ms / main_axes as f64);
    let feedback = main
        .iter()
        .map(|answer| answer.feedback_gain_per_s)
        .fold(f64::INFINITY, f64::min);
    for (number, (axis, answer)) in config.axes.iter_mut().zip(answers).take(drives).enumerate() {
        if number < MAIN_AXES && main_wanted {
            axis.feed_forward_lead_ms = lead_ms;
            axis.feedback_gain_per_s = feedback;
            axis.position_lead_ms = position_lead_ms.unwrap_or(axis.position_lead_ms);
        }
        let Ok(answer) = answer else { continue };
        if !wanted(number) {
            continue;
        }
        axis.feed_forward_gain = answer.feed_forward_gain.value;
        if axis.mode == AxisMode::Position {
            // A property of this drive, not a choice.
            axis.feedback_gain_per_s = answer.feedback_gain_per_s;
        }
        if number >= MAIN_AXES {
            axis.feed_forward_lead_ms = answer.lead_ms.value;
            axis.feedback_gain_per_s = answer.feedback_gain_per_s;
            axis.position_lead_ms = answer
                .position_lead_ms
                .map_or(axis.position_lead_ms, |lead_ms| lead_ms.value);
        }
    }
}

/// Gain, delay in ms, and the solution they come from.
type Estimate = (f64, f64, [f64; TERMS]);

/// One equation of the regression: the terms, and the response.
type Equation = ([f64; TERMS], f64);

fn identify_axis(axis: &Axis, number: usize, samples: &[Sample]) -> Result<Answer, NoAnswer> {
    match axis.mode {
        AxisMode::Velocity => {}
        AxisMode::Torque => return Err(NoAnswer::Torque),
        AxisMode::Position => return Err(NoAnswer::Position),
    }
    let shift = (axis.feed_forward_lead_ms + axis.measurement_age_ms + 0.5).round() as usize;
    let runs = samples.chunk_by(|a, b| b.t_ms == a.t_ms.wrapping_add(1) && moves(a) == moves(b));
    let equations: Vec<Equation> = runs
        .filter(|run| run.first().is_some_and(moves))
        .flat_map(|run| equations(&commands(axis, number, run), number, run, shift))
        .collect();
    if equations.len() < PARTS * PART_SAMPLES_MIN {
        return Err(NoAnswer::Samples);
    }
    let mean_square = |of: &dyn Fn(&Equation) -> f64| {
        equations.iter().map(|equation| of(equation).powi(2)).sum::<f64>() / equations.len() as f64
    };
    // The derivative is per millisecond.
    if mean_square(&|(terms, _)| terms[1]).sqrt() * 1_000.0 < CHANGE_MIN_RAD_S2 {
        return Err(NoAnswer::Still);
    }
    let estimate = |part: &[Equation]| {
        let solution = least_squares(part)?;
        let (gain, delay_ms) = (solution[0], shift as f64 - solution[1] / solution[0]);
        (gain > 0.0 && gain.is_finite() && delay_ms.is_finite()).then_some((gain, delay_ms, solution))
    };
    let (gain, delay_ms, solution) = estimate(&equations).ok_or(NoAnswer::Model)?;
    let left = mean_square(&|(terms, answer)| answer - terms.iter().zip(&solution).map(|(a, b)| a * b).sum::<f64>());
    let fits = left.sqrt() < UNEXPLAINED_MAX * mean_square(&|(_, answer)| *answer).sqrt();
    let lead_ms = delay_ms - axis.measurement_age_ms - 0.5;
    if !fits || lead_ms < 0.0 || delay_ms <= 0.5 {
        return Err(NoAnswer::Model);
    }
    // A part at one constant speed cannot separate gain from delay and gives no estimate.
    let parts: Vec<_> = equations
        .chunks_exact(equations.len() / PARTS)
        .take(PARTS)
        .filter_map(estimate)
        .collect();
    if parts.len() <= PARTS / 2 {
        return Err(NoAnswer::Model);
    }
    let spread = |of: fn(&Estimate) -> f64| {
        let mean = parts.iter().map(of).sum::<f64>() / parts.len() as f64;
        let squares = parts.iter().map(|part| (of(part) - mean).powi(2)).sum::<f64>();
        (squares / (parts.len() - 1) as f64 / parts.len() as f64).sqrt()
    };
    let (gain_spread, delay_spread_ms) = (spread(|part| part.0), spread(|part| part.1));
    let measured = |value: f64, uncertainty: f64| Measured { value, uncertainty };
    Ok(Answer {
        samples: equations.len(),
        delay_ms: measured(delay_ms, delay_spread_ms),
        gain: measured(gain, gain_spread),
        lead_ms: measured(lead_ms, delay_spread_ms),
        feed_forward_gain: measured(1.0 / gain, gain_spread / (gain * gain)),
        feedback_gain_per_s: PI / 6.0 / ((delay_ms - 0.5) / 1_000.0) / gain,
        position_lead_ms: None,
    })
}

fn moves(sample: &Sample) -> bool {
    sample.mode == Mode::Drawing
}

/// Velocity commands of one run of samples, as the controller computed them.
fn commands(axis: &Axis, number: usize, run: &[Sample]) -> Vec<f64> {
    let mut controller = PositionController::new(axis);
    let command = |k: usize| {
        let sample = &run[k];
        let ahead = run[k..]
            .iter()
            .take(SETPOINTS_AHEAD)
            .map(|sample| f64::from(sample.setpoint_rad_s[number]));
        let (reference, measured) = (sample.setpoint_rad[number].into(), sample.measured_rad[number].into());
        controller.step(reference, measured, ahead)
    };
    (0..run.len()).map(command).collect()
}

/// The equations of one run of samples: filtered responses on the filtered command `shift` milliseconds earlier.
fn equations(commands: &[f64], number: usize, run: &[Sample], shift: usize) -> Vec<Equation> {
    let answers: Vec<f64> = run.iter().map(|sample| sample.measured_rad_s[number].into()).collect();
    let (commands, answers) = (low_pass(commands), low_pass(&answers));
    // References after the run's end are not known, nor commands before its beginning.
    let last = answers.len().saturating_sub(SETPOINTS_AHEAD);
    let first = shift + 2 + etherpen::control::position::AGE_MAX_MS;
    (first..last)
        .filter_map(|k| {
            let at = |offset: usize| commands.get(k + offset - shift - 2).copied();
            let [a, b, c, d, e] = [at(0)?, at(1)?, at(2)?, at(3)?, at(4)?];
            let derivatives = [
                c,
                (d - b) / 2.0,
                d - 2.0 * c + b,
                (e - 2.0 * d + 2.0 * b - a) / 2.0,
                1.0,
            ];
            Some((derivatives, *answers.get(k)?))
        })
        .collect()
}

/// Moving average with raised-cosine weights; both ends, where the window does not fit, are cut off.
fn low_pass(values: &[f64]) -> Vec<f64> {
    let width = 2 * FILTER_HALF_MS + 1;
    let weight = |k: usize| 1.0 - (TAU * (k + 1) as f64 / (width + 1) as f64).cos();
    let weights: Vec<f64> = (0..width).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    let average = |window: &[f64]| {
        window
            .iter()
            .zip(&weights)
            .map(|(value, weight)| value * weight)
            .sum::<f64>()
            / sum
    };
    values.windows(width).map(average).collect()
}

/// Solution of the normal equations, by elimination with pivoting; `None` when they have none.
fn least_squares(equations: &[Equation]) -> Option<[f64; TERMS]> {
    let mut rows = [[0.0; TERMS + 1]; TERMS];
    for (terms, answer) in equations {
        for (row, left) in rows.iter_mut().zip(terms) {
            for (entry, right) in row.iter_mut().zip(terms.iter().chain([answer])) {
                *entry += left * right;
            }
        }
    }
    // The terms differ greatly in size: each is divided by its own size.
    let sizes: [f64; TERMS] = std::array::from_fn(|k| rows[k][k].sqrt());
    if sizes.iter().any(|size| !(*size > 0.0 && size.is_finite())) {
        return None;
    }
    for (i, row) in rows.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            *entry /= sizes[i] * sizes.get(j).copied().unwrap_or(1.0);
        }
    }
    for pivot in 0..TERMS {
        let best = (pivot..TERMS).max_by(|a, b| rows[*a][pivot].abs().total_cmp(&rows[*b][pivot].abs()))?;
        rows.swap(pivot, best);
        let row = rows[pivot];
        if row[pivot].abs() < 1e-12 {
            return None;
        }
        for (index, other) in rows.iter_mut().enumerate() {
            let factor = if index == pivot { 0.0 } else { other[pivot] / row[pivot] };
            other
                .iter_mut()
                .zip(&row)
                .for_each(|(entry, pivot)| *entry -= factor * pivot);
        }
    }
    Some(std::array::from_fn(|k| rows[k][TERMS] / rows[k][k] / sizes[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::messages::IoValues;

    /// Samples of an axis whose drive answers with a gain and a delay, on a smooth swing.
    fn swing(axis: &Axis, gain: f64, delay_ms: usize, amplitude_rad: f64) -> Vec<Sample> {
        let reference = |ms: i32| {
            let t = f64::from(ms.max(0)) / 1_000.0;
            amplitude_rad * ((TAU * 1.7 * t).cos() - 1.0 + 0.6 * ((TAU * 3.1 * t).cos() - 1.0))
        };
        let mut controller = PositionController::new(axis);
        let mut commands = vec![0.0; delay_ms];
        let mut angle = 0.0;
        (0..3_000)
            .map(|ms| {
                let speed = gain * commands[ms as usize];
                angle += speed / 1_000.0;
                let velocity = |ms: i32| (reference(ms) - reference(ms - 1)) * 1_000.0;
                let ahead = (0..SETPOINTS_AHEAD as i32).map(|k| velocity(ms + k));
                commands.push(controller.step(reference(ms), angle, ahead));
                Sample {
                    t_ms: ms as u32,
                    mode: Mode::Drawing,
                    stroke: 0,
                    pen: Pen::Up,
                    setpoint_rad: [reference(ms) as f32; AXES],
                    measured_rad: [angle as f32; AXES],
                    setpoint_rad_s: [velocity(ms) as f32; AXES],
                    measured_rad_s: [speed as f32; AXES],
                    io: IoValues::default(),
                }
            })
            .collect()
    }

    #[test]
    fn delay_and_gain_are_found_whatever_the_controller_was_set_to() {
        for (gain, delay_ms, lead_ms, kff) in [(1.0, 5, 3.5, 1.0), (0.97, 4, 4.4, 1.0), (1.03, 6, 3.1, 1.02)] {
            let axis = Axis {
                feed_forward_lead_ms: lead_ms,
                feed_forward_gain: kff,
                ..Axis::default()
            };
            let answer = identify_axis(&axis, 0, &swing(&axis, gain, delay_ms, 0.1)).unwrap();
            assert!((answer.gain.value - gain).abs() < 0.001, "{answer:?}");
            assert!((answer.delay_ms.value - delay_ms as f64).abs() < 0.05, "{answer:?}");
            assert!(
                (answer.lead_ms.value - (delay_ms as f64 - 1.5)).abs() < 0.05,
                "{answer:?}"
            );
        }
    }

    #[test]
    fn an_axis_that_rests_or_follows_a_torque_has_no_answer() {
        let axis = Axis::default();
        assert_eq!(
            identify_axis(&axis, 0, &swing(&axis, 1.0, 5, 1e-5)),
            Err(NoAnswer::Still)
        );
        assert_eq!(identify_axis(&axis, 0, &[]), Err(NoAnswer::Samples));
        let torque = Axis {
            mode: AxisMode::Torque,
            ..axis
        };
        assert_eq!(identify_axis(&torque, 0, &[]), Err(NoAnswer::Torque));
    }

    #[test]
    fn main_axes_share_lead_and_feedback_and_keep_their_own_gains() {
        let axis = Axis::default();
        let answer = |delay_ms| identify_axis(&axis, 0, &swing(&axis, 1.0, delay_ms, 0.1));
        let answers = [answer(5), answer(5), answer(6), Err(NoAnswer::Still)];
        let mut config = Config::default();
        apply(&mut config, &answers, None);
        let leads = config.axes.map(|axis| axis.feed_forward_lead_ms);
        assert!((leads[0] - 3.8333).abs() < 0.02, "{leads:?}");
        assert_eq!((leads[0], leads[3]), (leads[2], Axis::default().feed_forward_lead_ms));
        assert!(config.axes[0].feedback_gain_per_s < 100.0, "the slowest axis's");
        let mut one = Config::default();
        apply(&mut one, &answers, Some(3));
        assert_eq!(one, Config::default());
    }

    #[test]
    fn the_test_motion_is_admitted_and_leaves_the_paper_alone() {
        let config = Config::default();
        let path = test_path(&config);
        let lifted_um = ((config.paper.pen_down_z_mm + config.paper.pen_lift_mm) * 1_000.0) as i32;
        assert!(
            path.iter()
                .all(|vertex| vertex.pen == Pen::Up && vertex.position_um[2] >= lifted_um)
        );
        let mut admission = etherpen::motion::Admission::new(&config.motion_settings()).unwrap();
        for (index, vertex) in (0..).zip(&path) {
            let [x_mm, y_mm, z_mm] = vertex.position_um.map(|um| f64::from(um) / 1_000.0);
            let vertex = etherpen::motion::Vertex {
                position: etherpen::robots::Position { x_mm, y_mm, z_mm },
                pen: vertex.pen,
                stroke: vertex.stroke,
            };
            assert_eq!(admission.check(index, &vertex), Ok(()));
        }
    }
}
