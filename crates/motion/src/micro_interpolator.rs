//! The micro-interpolator: from path speeds to twelve joint setpoints a period.
//!
//! Every millisecond the interpolator advances along the path (in stretches of constant path acceleration between the
//! speeds at the grid's points), sums the copies of the point that an input shaper asks for, turns it into joint angles, and
//! averages over a whole number of milliseconds, which bounds the jerk. The moving average keeps every bound on speed and
//! acceleration, because an average of values inside a convex limit is inside it.
//!
//! Invariant: velocities are the exact differences of the averaged positions. The sums are integers, so they do not
//! drift however long the program runs.

use super::delay_line::{DelayLine, PathSample};
use super::shaping::Label;
use super::{PERIOD_MS, Pen, Setpoint};
use crate::robots::vector::{Vector, root};
use crate::robots::{AXES, JointAngles, Kinematics, MAIN_AXES};
use crate::settings::MotionLimits;
use crate::settings::TICK_S;

/// Longest moving average, ms; the bound of `motion.jerk_window_ms`.
pub(crate) const WINDOW_MAX: usize = 32;
/// Units per radian in which the sums count: 2^40.
const PARTS_PER_RAD: f64 = 1_099_511_627_776.0;
/// Bound on the relative rounding error of a difference of squared speeds.
const ROUNDED: f64 = 1.0e-12;
/// Largest angle that can be represented, rad.
const ANGLE_MAX_RAD: f64 = 10_000.0;

const _: () = assert!(ANGLE_MAX_RAD * PARTS_PER_RAD * (WINDOW_MAX as f64) < i64::MAX as f64);

/// Motion along the path with constant acceleration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretch {
    start_mm: f64,
    length_mm: f64,
    speed: f64,
    acceleration: f64,
    end_squared: f64,
    duration_s: f64,
    elapsed_s: f64,
}

impl Stretch {
    /// Motion over `length_mm` between two squared speeds.
    pub(crate) fn new(start_mm: f64, length_mm: f64, start_squared: f64, end_squared: f64) -> Self {
        let (speed, end_speed) = (root(start_squared), root(end_squared));
        Self {
            start_mm,
            length_mm,
            speed,
            acceleration: (end_squared - start_squared) / (2.0 * length_mm),
            end_squared,
            duration_s: 2.0 * length_mm / (speed + end_speed),
            elapsed_s: 0.0,
        }
    }

    /// Motion over `length_mm` with an acceleration, mm/s2.
    pub(crate) fn to(start_mm: f64, length_mm: f64, start_squared: f64, acceleration: f64) -> Self {
        let end_squared = start_squared + 2.0 * length_mm * acceleration;
        // A result below the rounding error of the difference counts as rest.
        let rests = end_squared <= ROUNDED * start_squared;
        Self::new(
            start_mm,
            length_mm,
            start_squared,
            if rests { 0.0 } else { end_squared },
        )
    }

    /// This motion, ended after `time_s` if it is longer.
    pub(crate) fn within(self, time_s: f64) -> Self {
        if self.duration_s <= time_s {
            return self;
        }
        let shorter = Self {
            elapsed_s: time_s,
            ..self
        };
        Self {
            length_mm: shorter.offset_mm() - self.start_mm,
            end_squared: shorter.squared(),
            duration_s: time_s,
            ..self
        }
    }

    /// Duration, s.
    pub(crate) fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Whether the duration is finite.
    pub(crate) fn valid(&self) -> bool {
        self.duration_s.is_finite() && self.duration_s >= 0.0 && self.length_mm >= 0.0
    }

    /// Advances by a time; returns the time left over when the end is reached.
    pub(crate) fn run(&mut self, time_s: f64) -> f64 {
        let left_s = self.duration_s - self.elapsed_s;
        if time_s >= left_s {
            self.elapsed_s = self.duration_s;
            time_s - left_s
        } else {
            self.elapsed_s += time_s;
            0.0
        }
    }

    pub(crate) fn complete(&self) -> bool {
        self.elapsed_s >= self.duration_s
    }

    /// Present squared speed, mm2/s2.
    pub(crate) fn squared(&self) -> f64 {
        let speed = (self.speed + self.acceleration * self.elapsed_s).max(0.0);
        speed * speed
    }

    pub(crate) fn end_squared(&self) -> f64 {
        self.end_squared
    }

    /// Place at which the motion begins, mm from the origin of the stretches.
    pub(crate) fn start_mm(&self) -> f64 {
        self.start_mm
    }

    /// Speed at the beginning, mm/s.
    pub(crate) fn speed(&self) -> f64 {
        self.speed
    }

    /// Time since the beginning, s.
    pub(crate) fn elapsed_s(&self) -> f64 {
        self.elapsed_s
    }

    /// Acceleration, mm/s2.
    pub(crate) fn acceleration(&self) -> f64 {
        self.acceleration
    }

    /// Position on the path, mm from the origin of the stretches.
    pub(crate) fn offset_mm(&self) -> f64 {
        if self.complete() {
            return self.start_mm + self.length_mm;
        }
        let passed = self.elapsed_s * (self.speed + 0.5 * self.acceleration * self.elapsed_s);
        self.start_mm + passed.clamp(0.0, self.length_mm)
    }
}

/// Source of the motion: asked once a millisecond for the position a millisecond later.
pub(crate) trait Profile {
    fn next_millisecond(&mut self) -> PathSample;
}

/// Averages a window of joint angles and turns them into setpoints.
#[derive(Clone, Debug)]
pub(crate) struct MicroInterpolator {
    kinematics: Kinematics,
    window: [([i64; AXES], Label); WINDOW_MAX],
    /// Number of averaged angles besides the newest.
    beside: usize,
    newest: usize,
    sums: [i64; AXES],
    /// Places over the paper, mm, in the order of the window.
    places_mm: [[f64; 2]; WINDOW_MAX],
    copies: DelayLine,
    /// Milliseconds until the average is at rest once the angles are.
    settling_ms: usize,
}

impl MicroInterpolator {
    /// An interpolator without a moving average or a robot; see [`MicroInterpolator::configure`].
    pub(crate) const fn new() -> Self {
        Self {
            kinematics: Kinematics::NONE,
            window: [([0; AXES], Label::NONE); WINDOW_MAX],
            beside: 0,
            newest: 0,
            sums: [0; AXES],
            places_mm: [[0.0; 2]; WINDOW_MAX],
            copies: DelayLine::new(),
            settling_ms: 0,
        }
    }

    /// Sets the robot, a moving average over `window_ms`, and the input shaper; 0 and 1 switch the average off. At rest until
    /// placed.
    pub(crate) fn configure(&mut self, kinematics: Kinematics, window_ms: u16, motion: &MotionLimits) {
        self.kinematics = kinematics;
        self.copies.configure(motion);
        self.beside = usize::from(window_ms).clamp(1, WINDOW_MAX) - 1;
        self.settling_ms = 0;
    }

    /// Number of averaged angles.
    fn length(&self) -> usize {
        self.beside + 1
    }

    /// Length of the moving average, ms; 0 without one.
    pub(crate) fn window_ms(&self) -> u16 {
        if self.length() > 1 { self.length() as u16 } else { 0 }
    }

    /// Places the interpolator at rest at a pose.
    pub(crate) fn place(&mut self, pose: &JointAngles) {
        let parts = pose.0.map(to_parts);
        self.window = [(parts, Label::NONE); WINDOW_MAX];
        self.sums = parts.map(|value| value * self.length() as i64);
        self.settling_ms = 0;
        self.copies.stand();
    }

    /// Sets the point of the pose at which the interpolator was placed.
    pub(crate) fn stand_at(&mut self, sample: &PathSample) {
        let [x_mm, y_mm, _] = sample.point;
        self.places_mm = [[x_mm, y_mm]; WINDOW_MAX];
        self.copies.fill(sample);
    }

    /// Whether the setpoints are at rest.
    pub(crate) fn settled(&self) -> bool {
        self.settling_ms == 0 && self.copies.settled()
    }

    /// A period at rest at the last pose.
    pub(crate) fn rest(&self) -> [Setpoint; PERIOD_MS] {
        let (parts, label) = self.window[self.newest];
        [Setpoint {
            position_rad: parts.map(|value| value as f64 / PARTS_PER_RAD),
            velocity_rad_s: [0.0; AXES],
            stroke: label.stroke,
            pen: label.pen,
            vertex: label.vertex,
            drawing_mm_s: 0.0,
        }; PERIOD_MS]
    }

    /// The next period.
    pub(crate) fn step(&mut self, profile: &mut impl Profile) -> [Setpoint; PERIOD_MS] {
        [(); PERIOD_MS].map(|()| {
            let sample = self.copies.pass(&profile.next_millisecond());
            self.setpoint(&sample)
        })
    }

    fn setpoint(&mut self, sample: &PathSample) -> Setpoint {
        let mut angles = [sample.heading; AXES];
        let main: [f64; MAIN_AXES] = self.kinematics.angles(&sample.point);
        for (angle, main) in angles.iter_mut().zip(main) {
            *angle = main;
        }
        let mut setpoint = self.average(angles.map(to_parts), sample.label);
        setpoint.drawing_mm_s = self.drawing_mm_s(&sample.point, setpoint.pen);
        setpoint
    }

    /// Speed over the paper of the average that [`Self::average`] has just moved on to this point. The average of the places
    /// moves by a part of the way from the oldest to the newest, as that of the angles does.
    fn drawing_mm_s(&mut self, [x_mm, y_mm, _]: &Vector, pen: Pen) -> f32 {
        let oldest = self.places_mm[(self.newest + WINDOW_MAX - self.length()) % WINDOW_MAX];
        self.places_mm[self.newest] = [*x_mm, *y_mm];
        if pen == Pen::Up {
            return 0.0;
        }
        let [along_x, along_y] = [x_mm - oldest[0], y_mm - oldest[1]];
        let way_mm = root(along_x * along_x + along_y * along_y);
        (way_mm / (TICK_S * self.length() as f64)) as f32
    }

    fn average(&mut self, parts: [i64; AXES], label: Label) -> Setpoint {
        let slot = |newest: usize, back: usize| (newest + WINDOW_MAX - back) % WINDOW_MAX;
        let before = self.window[self.newest].0;
        self.settling_ms = if parts == before {
            self.settling_ms.saturating_sub(1)
        } else {
            self.length()
        };
        self.newest = (self.newest + 1) % WINDOW_MAX;
        let oldest = self.window[slot(self.newest, self.length())].0;
        // A window as long as the ring overwrites its oldest entry with the newest.
        self.window[self.newest] = (parts, label);
        let per_part = 1.0 / (PARTS_PER_RAD * self.length() as f64);
        let mut setpoint = Setpoint::default();
        for axis in 0..AXES {
            let change = parts[axis] - oldest[axis];
            self.sums[axis] += change;
            setpoint.position_rad[axis] = self.sums[axis] as f64 * per_part;
            setpoint.velocity_rad_s[axis] = change as f64 * (per_part / TICK_S);
        }
        // The average lags by half its length; labels lag by the same amount.
        let label = self.window[slot(self.newest, self.length() / 2)].1;
        setpoint.stroke = label.stroke;
        setpoint.pen = label.pen;
        setpoint.vertex = label.vertex;
        setpoint
    }
}

fn to_parts(angle_rad: f64) -> i64 {
    (angle_rad.clamp(-ANGLE_MAX_RAD, ANGLE_MAX_RAD) * PARTS_PER_RAD) as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Geometry;

    /// Speeds up and slows down along x, then rests.
    struct There {
        stretches: [Stretch; 2],
    }

    impl Profile for There {
        fn next_millisecond(&mut self) -> PathSample {
            let mut left = TICK_S;
            let mut x_mm = 0.0;
            for stretch in &mut self.stretches {
                left = stretch.run(left);
                x_mm = stretch.offset_mm();
                if !stretch.complete() {
                    break;
                }
            }
            PathSample {
                point: [x_mm, 0.0, -850.0],
                heading: 0.25,
                label: Label::default(),
            }
        }
    }

    fn run(window_ms: u16) -> (MicroInterpolator, [[Setpoint; PERIOD_MS]; 12]) {
        let kinematics = Kinematics::new(&Geometry::default()).unwrap();
        let mut interpolator = MicroInterpolator::new();
        interpolator.configure(kinematics, window_ms, &MotionLimits::default());
        let [a, b, c] = kinematics.angles(&[0.0, 0.0, -850.0]);
        interpolator.place(&JointAngles([a, b, c, 0.25]));
        let mut there = There {
            stretches: [
                Stretch::to(0.0, 8.0, 0.0, 10_000.0),
                Stretch::new(8.0, 8.0, 160_000.0, 0.0),
            ],
        };
        let periods = [(); 12].map(|()| interpolator.step(&mut there));
        (interpolator, periods)
    }

    #[test]
    fn velocities_are_the_differences_of_the_positions() {
        for window_ms in [0, 4, 32] {
            let (_, periods) = run(window_ms);
            let setpoints = periods.as_flattened();
            for pair in setpoints.windows(2) {
                for axis in 0..AXES {
                    let difference = (pair[1].position_rad[axis] - pair[0].position_rad[axis]) / TICK_S;
                    assert!((difference - pair[1].velocity_rad_s[axis]).abs() < 1.0e-9);
                }
            }
        }
    }

    #[test]
    fn the_motion_ends_exactly_where_the_path_ends_and_settles() {
        for window_ms in [0, 1, 5, 32] {
            let (interpolator, periods) = run(window_ms);
            let last = periods.as_flattened()[143];
            let expected = interpolator.kinematics.angles(&[16.0, 0.0, -850.0]);
            assert!(interpolator.settled());
            for (actual, expected) in last.position_rad.iter().zip(expected) {
                assert!((actual - expected).abs() < 1.0e-11);
            }
            assert_eq!((last.position_rad[3], last.velocity_rad_s), (0.25, [0.0; AXES]));
        }
    }

    #[test]
    fn placed_in_the_middle_of_a_motion_it_is_at_rest() {
        let kinematics = Kinematics::new(&Geometry::default()).unwrap();
        let mut interpolator = MicroInterpolator::new();
        interpolator.configure(kinematics, 8, &MotionLimits::default());
        let [a, b, c] = kinematics.angles(&[0.0, 0.0, -850.0]);
        let pose = JointAngles([a, b, c, 0.25]);
        interpolator.place(&pose);
        interpolator.step(&mut There {
            stretches: [
                Stretch::to(0.0, 8.0, 0.0, 10_000.0),
                Stretch::new(8.0, 8.0, 160_000.0, 0.0),
            ],
        });
        assert!(!interpolator.settled());
        interpolator.place(&pose);
        assert!(interpolator.settled());
    }

    #[test]
    fn the_average_bounds_the_jerk_and_raises_no_acceleration() {
        let peaks = |window_ms| {
            let (_, periods) = run(window_ms);
            let setpoints = periods.as_flattened();
            let acceleration = |a: &Setpoint, b: &Setpoint| (b.velocity_rad_s[0] - a.velocity_rad_s[0]) / TICK_S;
            let mut peak = (0.0_f64, 0.0_f64);
            for three in setpoints.windows(3) {
                let (first, second) = (acceleration(&three[0], &three[1]), acceleration(&three[1], &three[2]));
                peak = (peak.0.max(second.abs()), peak.1.max((second - first).abs() / TICK_S));
            }
            peak
        };
        let (raw, averaged) = (peaks(0), peaks(8));
        assert!(averaged.0 <= raw.0 * (1.0 + 1.0e-6));
        assert!(averaged.1 <= 2.0 * raw.0 / 8.0e-3, "{averaged:?} of {raw:?}");
    }
}
