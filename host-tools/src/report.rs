//! What a drawing came to: the figures of `report.json` and the tables beside it.
//!
//! Everything is computed from what the firmware measured every millisecond, from the path that was intended and from
//! the ink on the virtual paper; nothing is taken from the planner's own word.

use etherpen::config::Config;
use etherpen::link::protocol::{Counters, Sample};
use etherpen::motion::{Pen, Vertex};
use etherpen::robot::{AXES, Delta, JointAngles, Position};
use serde::Serialize;
use std::io::{self, Write};

/// Intended ink counts as missing where no ink is within this distance, mm.
const INK_REACH_MM: f64 = 0.5;
/// Distance of the points at which intended ink is looked for, mm.
const INK_STEP_MM: f64 = 0.1;
/// How far ahead along its stroke the pen may have come since the last millisecond, mm: 2 m/s.
const AHEAD_MM: f64 = 2.0;
/// How far back along its stroke the nearest point may lie, mm: noise, not motion.
const BACK_MM: f64 = 0.5;

/// Peak speed, acceleration and jerk of one axis, and their limits, from the 1 ms references.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct AxisLimits {
    /// Highest speed, rad/s.
    pub speed_rad_s: f64,
    /// Its limit, rad/s.
    pub speed_limit_rad_s: f64,
    /// Highest acceleration, rad/s2.
    pub acceleration_rad_s2: f64,
    /// Its limit, rad/s2.
    pub acceleration_limit_rad_s2: f64,
    /// Highest jerk, rad/s3.
    pub jerk_rad_s3: f64,
    /// Its limit, rad/s3: 2 A / T with the jerk window T; `null` without a window.
    pub jerk_limit_rad_s3: Option<f64>,
}

/// The virtual drives.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Drives {
    /// Bandwidth of the velocity loop, Hz.
    pub bandwidth_hz: f64,
    /// Age of a position when it is put on the bus, cycles of 1 ms.
    pub input_delay_cycles: usize,
    /// Age of a command when the drive acts on it, cycles of 1 ms.
    pub output_delay_cycles: usize,
}

/// The figures of a drawing, as `report.json` has them.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Whether the whole path was executed.
    pub completed: bool,
    /// Strokes drawn.
    pub strokes: usize,
    /// Strokes of the path.
    pub strokes_intended: usize,
    /// Length of the intended strokes, mm.
    pub pen_down_mm: f64,
    /// Length of the way between them, lifts included, mm.
    pub pen_up_mm: f64,
    /// Duration the planner computes for the path alone, s; `null` where it cannot be planned.
    pub planned_s: f64,
    /// Duration of the drawing on the machine, s.
    pub drawn_s: f64,
    /// Largest distance of a measured pen-down position from its stroke, mm; `null` without any.
    pub path_deviation_max_mm: f64,
    /// Root of the mean square of that distance, mm.
    pub path_deviation_rms_mm: f64,
    /// Intended length without ink near it, mm; `null` where the paper cannot be read.
    pub ink_missing_mm: f64,
    /// Largest following error per axis, rad.
    pub following_error_max_rad: [f64; AXES],
    /// Peaks and limits per axis.
    pub limits: [AxisLimits; AXES],
    /// Milliseconds the firmware ran.
    pub cycles: u32,
    /// Output telegrams that were late.
    pub cycles_late: u32,
    /// Telegrams without a reply.
    pub frames_lost: u32,
    /// Replies with another working counter than expected.
    pub working_counter_errors: u32,
    /// Milliseconds without a reference.
    pub reference_underruns: u32,
    /// Times the path ran out of data.
    pub path_starvations: u32,
    /// Telemetry samples that were lost on the way.
    pub telemetry_lost: u32,
    /// Hash of the firmware image that ran, or `simulation`.
    pub image: String,
    /// The virtual drives; absent on a real machine.
    pub drives: Option<Drives>,
    /// Correlation of the drawn picture with the photograph, both blurred; absent without either.
    pub tone_correlation: Option<f64>,
}

/// What a report is made of.
pub struct Evidence<'a> {
    /// The configuration that was in force.
    pub config: &'a Config,
    /// The intended path.
    pub path: &'a [Vertex],
    /// What the firmware measured.
    pub samples: &'a [Sample],
    /// Ink in the robot's frame, mm; absent where the paper cannot be read.
    pub ink_mm: Option<&'a [[f64; 2]]>,
    /// What the firmware counted.
    pub counters: Counters,
    /// Whether the whole path was executed.
    pub completed: bool,
    /// Planner's duration, s.
    pub planned_s: f64,
    /// Name of what ran.
    pub image: String,
    /// The virtual drives.
    pub drives: Option<Drives>,
}

/// One millisecond in the robot's frame.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The sample as it came.
    pub sample: Sample,
    /// Measured position of the platform, mm.
    pub position: Position,
    /// Stroke the measured position belongs to.
    pub stroke: u32,
    /// Pen as the path had it for the measured position.
    pub pen: Pen,
}

/// Puts the measured positions into the robot's frame. A drive acts on a reference some milliseconds later and its
/// position takes another to come back; stroke and pen are those of the reference the position answers to.
pub fn rows(config: &Config, samples: &[Sample]) -> Vec<Row> {
    let Ok(delta) = Delta::new(&config.geometry) else {
        return Vec::new();
    };
    let axis = &config.axes[0];
    let lag = (axis.feed_forward_lead_ms + axis.measurement_age_ms).round() as usize;
    let with_lag = |index: usize| samples.get(index.saturating_sub(lag)).unwrap_or(&samples[0]);
    let row = |(index, sample): (usize, &Sample)| {
        let angles = JointAngles(sample.measured_rad.map(f64::from));
        let (position, cause) = (delta.forward(&angles).unwrap_or_default(), with_lag(index));
        Row {
            sample: *sample,
            position,
            stroke: cause.stroke,
            pen: cause.pen,
        }
    };
    samples.iter().enumerate().map(row).collect()
}

impl Report {
    /// Computes the figures.
    pub fn new(evidence: &Evidence) -> Self {
        let drawing: Vec<Sample> = drawn_part(evidence.samples).copied().collect();
        let rows = rows(evidence.config, &drawing);
        let strokes = strokes(evidence.path);
        let (path_deviation_max_mm, path_deviation_rms_mm) = deviation(&rows, &strokes);
        let (pen_down_mm, pen_up_mm) = lengths(evidence.path);
        let ink_missing_mm = evidence.ink_mm.map_or(f64::NAN, |ink| ink_missing(&strokes, ink));
        let mut drawn: Vec<u32> = rows
            .iter()
            .filter(|row| row.pen == Pen::Down)
            .map(|row| row.stroke)
            .collect();
        drawn.dedup();
        let counters = &evidence.counters;
        Self {
            completed: evidence.completed,
            strokes: drawn.len(),
            strokes_intended: strokes.len(),
            pen_down_mm,
            pen_up_mm,
            planned_s: evidence.planned_s,
            drawn_s: f64::from(span_ms(&drawing)) / 1_000.0,
            path_deviation_max_mm,
            path_deviation_rms_mm,
            ink_missing_mm,
            following_error_max_rad: following_error(evidence.config, &drawing),
            limits: limits(evidence.config, &drawing),
            cycles: counters.cycles,
            cycles_late: counters.cycles_late,
            frames_lost: counters.frames_lost,
            working_counter_errors: counters.working_counter_errors,
            reference_underruns: counters.reference_underruns,
            path_starvations: counters.path_starvations,
            telemetry_lost: span_ms(evidence.samples).saturating_sub(evidence.samples.len() as u32),
            image: evidence.image.clone(),
            drives: evidence.drives,
            tone_correlation: None,
        }
    }
}

/// Milliseconds from the first to the last sample, both included.
fn span_ms(samples: &[Sample]) -> u32 {
    match (samples.first(), samples.last()) {
        (Some(first), Some(last)) => last.t_ms.wrapping_sub(first.t_ms).wrapping_add(1),
        _ => 0,
    }
}

/// From the first to the last sample in which the path was executed.
fn drawn_part(samples: &[Sample]) -> impl Iterator<Item = &Sample> {
    use etherpen::application::Mode;
    let active = |sample: &Sample| matches!(sample.mode, Mode::Drawing | Mode::Holding);
    let first = samples.iter().position(active).unwrap_or(samples.len());
    let last = samples.iter().rposition(active).map_or(first, |last| last + 1);
    samples[first..last].iter()
}

/// The drawn polylines of a path with their stroke numbers, each from the vertex where the pen came down.
pub fn strokes(path: &[Vertex]) -> Vec<(u32, Vec<Position>)> {
    let mut strokes: Vec<(u32, Vec<Position>)> = Vec::new();
    for pair in path.windows(2) {
        if pair[1].pen == Pen::Up {
            continue;
        }
        match strokes.last_mut() {
            Some((number, points)) if *number == pair[1].stroke && points.last() == Some(&pair[0].position) => {
                points.push(pair[1].position);
            }
            _ => strokes.push((pair[1].stroke, vec![pair[0].position, pair[1].position])),
        }
    }
    strokes
}

fn lengths(path: &[Vertex]) -> (f64, f64) {
    let mut sums = (0.0, 0.0);
    for pair in path.windows(2) {
        let length_mm = distance(&pair[0].position, &pair[1].position);
        match pair[1].pen {
            Pen::Down => sums.0 += length_mm,
            Pen::Up => sums.1 += length_mm,
        }
    }
    sums
}

fn distance(a: &Position, b: &Position) -> f64 {
    ((a.x_mm - b.x_mm).powi(2) + (a.y_mm - b.y_mm).powi(2) + (a.z_mm - b.z_mm).powi(2)).sqrt()
}

/// Distance from `p` to the segment from `a` to `b`, and how far along it the nearest point lies, mm.
fn to_segment(p: &Position, a: &Position, b: &Position) -> (f64, f64) {
    let (dx, dy, dz) = (b.x_mm - a.x_mm, b.y_mm - a.y_mm, b.z_mm - a.z_mm);
    let length2 = dx * dx + dy * dy + dz * dz;
    let along = (p.x_mm - a.x_mm) * dx + (p.y_mm - a.y_mm) * dy + (p.z_mm - a.z_mm) * dz;
    let t = if length2 > 0.0 {
        (along / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let foot = Position {
        x_mm: a.x_mm + t * dx,
        y_mm: a.y_mm + t * dy,
        z_mm: a.z_mm + t * dz,
    };
    (distance(p, &foot), t * length2.sqrt())
}

/// Follows one stroke in order: the nearest point is looked for close to the last one only, never on a neighbour.
struct Follower<'a> {
    points: &'a [Position],
    /// Segment of the last nearest point, and how far along the stroke that segment begins, mm.
    segment: usize,
    begin_mm: f64,
    /// How far along the stroke the last nearest point lies, mm.
    foot_mm: f64,
}

impl<'a> Follower<'a> {
    fn new(points: &'a [Position]) -> Self {
        Self {
            points,
            segment: 0,
            begin_mm: 0.0,
            foot_mm: 0.0,
        }
    }

    fn segment_mm(&self, segment: usize) -> f64 {
        distance(&self.points[segment], &self.points[segment + 1])
    }

    /// Distance of the next measured position, mm.
    fn step(&mut self, position: &Position) -> f64 {
        let (mut segment, mut begin_mm) = (self.segment, self.begin_mm);
        while segment > 0 && begin_mm > self.foot_mm - BACK_MM {
            segment -= 1;
            begin_mm -= self.segment_mm(segment);
        }
        let (mut nearest_mm, ahead_mm) = (f64::INFINITY, self.foot_mm + AHEAD_MM);
        while segment + 1 < self.points.len() && begin_mm <= ahead_mm {
            let (away_mm, along_mm) = to_segment(position, &self.points[segment], &self.points[segment + 1]);
            if away_mm < nearest_mm {
                nearest_mm = away_mm;
                (self.segment, self.begin_mm, self.foot_mm) = (segment, begin_mm, begin_mm + along_mm);
            }
            begin_mm += self.segment_mm(segment);
            segment += 1;
        }
        nearest_mm
    }
}

/// Largest distance of the pen-down positions from their strokes, and the root of the mean square, mm.
fn deviation(rows: &[Row], strokes: &[(u32, Vec<Position>)]) -> (f64, f64) {
    let (mut largest, mut squares, mut count) = (0.0_f64, 0.0, 0u64);
    let mut current: Option<(u32, Follower)> = None;
    for row in rows.iter().filter(|row| row.pen == Pen::Down) {
        if current.as_ref().is_none_or(|(stroke, _)| *stroke != row.stroke) {
            let points = strokes.iter().find(|(stroke, _)| *stroke == row.stroke);
            current = points.map(|(stroke, points)| (*stroke, Follower::new(points)));
        }
        let Some((_, follower)) = &mut current else { continue };
        let away_mm = follower.step(&row.position);
        largest = largest.max(away_mm);
        squares += away_mm * away_mm;
        count += 1;
    }
    if count == 0 {
        return (f64::NAN, f64::NAN);
    }
    (largest, (squares / count as f64).sqrt())
}

fn ink_missing(strokes: &[(u32, Vec<Position>)], ink_mm: &[[f64; 2]]) -> f64 {
    let cell = |v: f64| (v / INK_REACH_MM).floor() as i64;
    let mut cells: std::collections::HashMap<(i64, i64), Vec<[f64; 2]>> = std::collections::HashMap::new();
    for point in ink_mm {
        cells.entry((cell(point[0]), cell(point[1]))).or_default().push(*point);
    }
    let near = |x: f64, y: f64| {
        let around = (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i, j)));
        let mut points = around
            .filter_map(|(i, j)| cells.get(&(cell(x) + i, cell(y) + j)))
            .flatten();
        points.any(|p| (p[0] - x).hypot(p[1] - y) <= INK_REACH_MM)
    };
    let mut missing_mm = 0.0;
    for pair in strokes.iter().flat_map(|(_, points)| points.windows(2)) {
        let length_mm = distance(&pair[0], &pair[1]);
        let steps = (length_mm / INK_STEP_MM).ceil().max(1.0) as usize;
        let lost = (0..steps).filter(|k| {
            let t = (*k as f64 + 0.5) / steps as f64;
            !near(
                pair[0].x_mm + t * (pair[1].x_mm - pair[0].x_mm),
                pair[0].y_mm + t * (pair[1].y_mm - pair[0].y_mm),
            )
        });
        missing_mm += lost.count() as f64 * length_mm / steps as f64;
    }
    missing_mm
}

fn following_error(config: &Config, samples: &[Sample]) -> [f64; AXES] {
    std::array::from_fn(|axis| {
        let age = config.axes[axis].measurement_age_ms.round() as usize;
        let errors = samples.iter().skip(age).zip(samples);
        let error = errors.map(|(now, then)| f64::from(then.reference_rad[axis] - now.measured_rad[axis]).abs());
        error.fold(0.0, f64::max)
    })
}

fn limits(config: &Config, samples: &[Sample]) -> [AxisLimits; AXES] {
    let motion = &config.motion;
    let window_s = f64::from(motion.jerk_window_ms) / 1_000.0;
    std::array::from_fn(|axis| {
        let speed: Vec<f64> = samples
            .iter()
            .map(|sample| f64::from(sample.reference_rad_s[axis]))
            .collect();
        let per_second = |values: &[f64]| -> Vec<f64> { values.windows(2).map(|w| (w[1] - w[0]) * 1_000.0).collect() };
        let peak = |values: &[f64]| values.iter().fold(0.0_f64, |peak, value| peak.max(value.abs()));
        let acceleration = per_second(&speed);
        AxisLimits {
            speed_rad_s: peak(&speed),
            speed_limit_rad_s: motion.joint_speed_rad_s[axis],
            acceleration_rad_s2: peak(&acceleration),
            acceleration_limit_rad_s2: motion.joint_acceleration_rad_s2[axis],
            jerk_rad_s3: peak(&per_second(&acceleration)),
            jerk_limit_rad_s3: (window_s > 0.0).then(|| 2.0 * motion.joint_acceleration_rad_s2[axis] / window_s),
        }
    })
}

/// Writes `telemetry.csv`.
///
/// # Errors
/// Those of the writer.
pub fn write_telemetry(rows: &[Row], mut out: impl Write) -> io::Result<()> {
    write!(out, "t_ms,mode,stroke,pen,x_mm,y_mm,z_mm")?;
    for k in 1..=AXES {
        write!(out, ",q{k}_ref_rad,q{k}_rad,v{k}_ref_rad_s,v{k}_rad_s")?;
    }
    writeln!(out)?;
    for Row {
        sample,
        position,
        stroke,
        pen,
    } in rows
    {
        let pen = u8::from(*pen == Pen::Down);
        let Position { x_mm, y_mm, z_mm } = position;
        write!(
            out,
            "{},{:?},{stroke},{pen},{x_mm:.4},{y_mm:.4},{z_mm:.4}",
            sample.t_ms, sample.mode
        )?;
        for k in 0..AXES {
            let (q_ref, q) = (sample.reference_rad[k], sample.measured_rad[k]);
            let (v_ref, v) = (sample.reference_rad_s[k], sample.measured_rad_s[k]);
            write!(out, ",{q_ref:.7},{q:.7},{v_ref:.5},{v:.5}")?;
        }
        writeln!(out)?;
    }
    out.flush()
}

/// Writes `intended.csv`: the drawn polylines.
///
/// # Errors
/// Those of the writer.
pub fn write_intended(path: &[Vertex], mut out: impl Write) -> io::Result<()> {
    writeln!(out, "stroke,x_mm,y_mm,z_mm")?;
    for (stroke, points) in strokes(path) {
        for Position { x_mm, y_mm, z_mm } in points {
            writeln!(out, "{stroke},{x_mm:.4},{y_mm:.4},{z_mm:.4}")?;
        }
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x_mm: f64, y_mm: f64) -> Position {
        Position {
            x_mm,
            y_mm,
            z_mm: -850.0,
        }
    }

    /// Two legs of 20 mm, 1 mm apart, joined at the far end.
    fn hairpin() -> Vec<Position> {
        vec![at(0.0, 0.0), at(20.0, 0.0), at(20.0, 1.0), at(0.0, 1.0)]
    }

    #[test]
    fn a_position_is_compared_with_its_own_leg_and_not_with_the_neighbour() {
        let points = hairpin();
        let mut follower = Follower::new(&points);
        let largest = (0..20)
            .map(|x| follower.step(&at(f64::from(x), 0.8)))
            .fold(0.0, f64::max);
        assert!((largest - 0.8).abs() < 1e-9, "{largest}");
    }

    #[test]
    fn a_stroke_followed_to_its_end_has_no_deviation() {
        let points = hairpin();
        let mut follower = Follower::new(&points);
        let there = (0..=40).map(|k| at(f64::from(k) * 0.5, 0.0));
        let back = (0..=40).map(|k| at(20.0 - f64::from(k) * 0.5, 1.0));
        for position in there.chain([at(20.0, 0.5)]).chain(back) {
            assert!(follower.step(&position) < 1e-9, "{position:?}");
        }
    }

    #[test]
    fn ink_is_missing_where_none_is_near() {
        let strokes = vec![(0, vec![at(0.0, 0.0), at(10.0, 0.0)])];
        let ink: Vec<[f64; 2]> = (0..=50).map(|k| [f64::from(k) * 0.1, 0.2]).collect();
        let missing_mm = ink_missing(&strokes, &ink);
        assert!((missing_mm - 4.5).abs() < 0.15, "{missing_mm}");
    }

    #[test]
    fn strokes_begin_where_the_pen_came_down() {
        let vertex = |x_mm, pen, stroke| Vertex {
            position: at(x_mm, 0.0),
            pen,
            stroke,
        };
        let path = [
            vertex(0.0, Pen::Up, 0),
            vertex(1.0, Pen::Down, 0),
            vertex(2.0, Pen::Down, 0),
            vertex(3.0, Pen::Up, 1),
            vertex(4.0, Pen::Down, 1),
        ];
        let strokes = strokes(&path);
        assert_eq!(
            strokes,
            [
                (0, vec![at(0.0, 0.0), at(1.0, 0.0), at(2.0, 0.0)]),
                (1, vec![at(3.0, 0.0), at(4.0, 0.0)])
            ]
        );
        assert_eq!(lengths(&path), (3.0, 1.0));
    }
}
