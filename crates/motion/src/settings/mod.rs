//! Settings of motion: the robot's shape, its work area, the paper, and the limits of motion.

pub(crate) mod averaging;
mod bounds;
pub(crate) mod input_shaper;

pub use crate::bounds::{Bound, Violation, bound, first_violation};
pub use crate::robots::Geometry;
pub use crate::work_volume::WorkVolume;

use crate::robots::AXES;
use serde::{Deserialize, Serialize};

/// One millisecond, s.
pub(crate) const TICK_S: f64 = 1.0e-3;

/// Position of the paper, and heights of the pen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Paper {
    /// The sheet's centre in the robot's frame, mm.
    pub centre_mm: [f64; 2],
    /// Width and height of the sheet, mm.
    pub size_mm: [f64; 2],
    /// The platform's z when the pen draws at the sheet's centre, mm.
    pub pen_down_z_mm: f64,
    /// How far the pen is lifted between strokes, mm.
    pub pen_lift_mm: f64,
    /// How far below its drawing height the platform may go, mm.
    pub pressing_depth_mm: f64,
    /// How far the sheet rises over 1 mm of x and of y, mm; 0 for a level sheet. A message carries it in 32 bits, which is
    /// exact to 6 nm over a metre.
    #[serde(with = "slope")]
    pub slope: [f64; 2],
}

/// A slope with 64 bits in texts and with 32 bits in messages, whose room is short.
mod slope {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(super) fn serialize<S: Serializer>(slope: &[f64; 2], serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            slope.serialize(serializer)
        } else {
            slope.map(|part| part as f32).serialize(serializer)
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
        if deserializer.is_human_readable() {
            <[f64; 2]>::deserialize(deserializer)
        } else {
            <[f32; 2]>::deserialize(deserializer).map(|slope| slope.map(f64::from))
        }
    }
}

/// A plane in the robot's frame that is not upright.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Its z at x = y = 0, mm.
    pub z_mm: f64,
    /// How far it rises over 1 mm of x and of y, mm.
    pub slope: [f64; 2],
}

impl Plane {
    /// The level plane through the origin.
    pub const ZERO: Self = Self {
        z_mm: 0.0,
        slope: [0.0; 2],
    };

    /// Its z at a place, mm.
    #[inline]
    #[must_use]
    pub fn z_at_mm(&self, x_mm: f64, y_mm: f64) -> f64 {
        let [along_x, along_y] = self.slope;
        self.z_mm + along_x * x_mm + along_y * y_mm
    }

    /// The plane that is this much higher, mm.
    #[must_use]
    pub fn raised(&self, by_mm: f64) -> Self {
        Self {
            z_mm: self.z_mm + by_mm,
            ..*self
        }
    }
}

impl Default for Paper {
    fn default() -> Self {
        Self {
            centre_mm: [0.0, 0.0],
            size_mm: [200.0, 200.0],
            pen_down_z_mm: -850.0,
            pen_lift_mm: 3.0,
            pressing_depth_mm: 1.0,
            slope: [0.0; 2],
        }
    }
}

impl Paper {
    /// Greatest slope of a sheet along x and along y: 5.4 degrees, a number that 32 bits hold exactly.
    pub const SLOPE_MAX: f64 = 0.093_75;

    /// Where the platform is when the pen draws.
    #[must_use]
    pub fn plane(&self) -> Plane {
        let ([x_mm, y_mm], [along_x, along_y]) = (self.centre_mm, self.slope);
        Plane {
            z_mm: self.pen_down_z_mm - along_x * x_mm - along_y * y_mm,
            slope: self.slope,
        }
    }

    /// Whether the sheet is not level.
    #[must_use]
    pub fn is_tilted(&self) -> bool {
        self.slope.iter().any(|slope| *slope != 0.0)
    }

    /// A sheet of at most 200 mm in the middle of a volume, a third of its height above its lowest z. In a ring the
    /// sheet lies in front, half way between both radii.
    fn within(volume: &WorkVolume) -> Self {
        let reach = |[low, high]: [f64; 2]| [low.max(-volume.radius_mm), high.min(volume.radius_mm)];
        let ([x_low, x_high], [y_low, y_high]) = (reach(volume.x_mm), reach(volume.y_mm));
        let height = volume.z_high_mm - volume.z_low_mm;
        let middle = if volume.inner_radius_mm > 0.0 {
            [0.5 * (volume.inner_radius_mm + volume.radius_mm), 0.0]
        } else {
            [0.5 * (x_low + x_high), 0.5 * (y_low + y_high)]
        };
        // In a ring half of its width; in a cylinder less than the square that touches it from inside.
        let round = if volume.inner_radius_mm > 0.0 {
            0.5 * (volume.radius_mm - volume.inner_radius_mm)
        } else {
            1.2 * volume.radius_mm
        };
        let of = |width: f64| (0.7 * width).min(round).min(200.0);
        Self {
            centre_mm: middle,
            size_mm: [of(x_high - x_low), of(y_high - y_low)],
            pen_down_z_mm: volume.z_low_mm + height / 3.0,
            ..Self::default()
        }
    }
}

/// Mode of the fourth axis on a path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Orientation {
    /// The axis keeps its angle.
    #[default]
    Constant,
    /// The axis follows the direction of the path in plan view.
    Path,
}

/// How setpoints keep a resonance of the mechanics quiet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InputShaper {
    /// Not at all.
    #[default]
    None,
    /// By two copies half a period apart (zero vibration): for a frequency known within 5 %.
    Zv,
    /// By copies over two periods (zero vibration and derivative): for a frequency known within 10 %.
    Zvd,
}

/// Limits and tolerances of motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionLimits {
    /// Path speed with the pen down, mm/s.
    pub speed_mm_s: f64,
    /// Path speed with the pen up, mm/s.
    pub travel_speed_mm_s: f64,
    /// Cartesian acceleration, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Vertical speed while the pen is lifted or lowered, mm/s; 0 applies only the limits of all motion.
    pub pen_speed_mm_s: f64,
    /// Vertical acceleration while the pen is lifted or lowered, mm/s2; 0 applies only the limits of all motion.
    pub pen_acceleration_mm_s2: f64,
    /// Time at rest where the pen meets the paper and where it leaves it, ms; 0 means no stop. With an input shaper it is at
    /// least the time of its copies.
    pub pen_dwell_ms: u16,
    /// Mode of the fourth axis on a path.
    pub orientation: Orientation,
    /// Joint speed, rad/s, per axis.
    pub joint_speed_rad_s: [f64; AXES],
    /// Joint acceleration, rad/s2, per axis.
    pub joint_acceleration_rad_s2: [f64; AXES],
    /// Largest deviation of the setpoints from the polyline with the pen down, mm.
    pub tolerance_mm: f64,
    /// Largest deviation of the setpoints from the polyline on travel moves (pen up), mm.
    pub travel_tolerance_mm: f64,
    /// Length of the moving average that bounds jerk, ms; 0 switches it off.
    pub jerk_window_ms: u16,
    /// How setpoints keep a resonance of the mechanics quiet.
    pub input_shaper: InputShaper,
    /// Frequency of the resonance without damping, Hz.
    pub resonance_hz: f64,
    /// Damping ratio of the resonance.
    pub resonance_damping: f64,
    /// Time at rest on the path before the pen is lifted when path data stop coming, ms.
    pub starve_dwell_ms: u16,
}

impl Default for MotionLimits {
    fn default() -> Self {
        Self {
            speed_mm_s: 400.0,
            travel_speed_mm_s: 1000.0,
            acceleration_mm_s2: 10_000.0,
            pen_speed_mm_s: 0.0,
            pen_acceleration_mm_s2: 0.0,
            pen_dwell_ms: 0,
            orientation: Orientation::Constant,
            joint_speed_rad_s: [25.0; AXES],
            joint_acceleration_rad_s2: [250.0; AXES],
            tolerance_mm: 0.05,
            travel_tolerance_mm: 0.5,
            jerk_window_ms: 4,
            input_shaper: InputShaper::None,
            resonance_hz: 50.0,
            resonance_damping: 0.03,
            starve_dwell_ms: 500,
        }
    }
}

/// All settings of the motion stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Shape of the robot.
    pub geometry: Geometry,
    /// Space the robot may use.
    pub work_area: WorkVolume,
    /// Paper and pen.
    pub paper: Paper,
    /// Limits of motion.
    pub motion: MotionLimits,
    /// Time after which a jog ends that is not repeated, ms.
    pub dead_man_ms: u16,
    /// Whether something else than the robot's axes, say a solenoid, lowers the pen while the tool goes down to the paper, and
    /// lifts it while the tool goes up.
    pub has_separate_pen: bool,
}

impl Settings {
    /// Settings of a usual machine with these dimensions: its largest usual work volume, a sheet of at most 200 mm in the
    /// middle of it, and the usual limits of its joints.
    #[must_use]
    pub fn usual(geometry: Geometry) -> Self {
        let work_area = geometry.work_volume();
        let mut motion = MotionLimits::default();
        let axes = motion
            .joint_speed_rad_s
            .iter_mut()
            .zip(&mut motion.joint_acceleration_rad_s2);
        for ((speed, acceleration), limits) in axes.zip(geometry.usual_limits()) {
            [*speed, *acceleration] = limits;
        }
        Self {
            geometry,
            work_area,
            paper: Paper::within(&work_area),
            motion,
            ..Self::default()
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            geometry: Geometry::default(),
            work_area: WorkVolume::default(),
            paper: Paper::default(),
            motion: MotionLimits::default(),
            dead_man_ms: 100,
            has_separate_pen: false,
        }
    }
}
