//! What the monitor knows of machine and configuration: plain numbers.
//!
//! The numbers are those of the configuration that the controller was given. Nothing here is read from the controller.

use crate::robot::Robot;

/// Most axes that are judged.
pub const AXES_MAX: usize = 8;

/// Limits and properties of one axis, at the joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// Lowest and highest angle, rad.
    pub range_rad: [f64; 2],
    /// Configured speed limit, rad/s.
    pub speed_rad_s: f64,
    /// Configured acceleration limit, rad/s2.
    pub acceleration_rad_s2: f64,
    /// Configured deceleration of a quick stop, rad/s2.
    pub quick_stop_rad_s2: f64,
    /// Deceleration by the closed brake, rad/s2.
    pub brake_rad_s2: f64,
    /// Gain of the position controller, 1/s.
    pub feedback_gain_per_s: f64,
    /// Following error at which the controller stops the robot, rad.
    pub following_error_max_rad: f64,
    /// Largest velocity command, rad/s.
    pub output_max_rad_s: f64,
    /// Speed at which the axis is led to its home switch, rad/s; 0 without one.
    pub search_rad_s: f64,
    /// Angle at the synchronisation mark, rad.
    pub mark_rad: f64,
    /// Change of the angle by one motor revolution, after which a single-turn resolver shows the same position, rad.
    pub turn_rad: f64,
}

impl Default for JointLimits {
    /// A main axis of the default configuration.
    fn default() -> Self {
        Self {
            range_rad: [-0.7034, 1.7453],
            speed_rad_s: 25.0,
            acceleration_rad_s2: 250.0,
            quick_stop_rad_s2: 100.0,
            brake_rad_s2: 400.0,
            feedback_gain_per_s: 80.0,
            following_error_max_rad: 0.05,
            output_max_rad_s: 27.0,
            search_rad_s: 0.0,
            mark_rad: 0.3,
            turn_rad: core::f64::consts::TAU / 12.0,
        }
    }
}

/// The space that the tool may use: an upright cylinder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkArea {
    /// The cylinder's axis in the robot's frame, mm.
    pub centre_mm: [f64; 2],
    /// Radius, mm.
    pub radius_mm: f64,
    /// Radius of the part around the axis that does not belong to it, mm.
    pub inner_radius_mm: f64,
    /// Lowest and highest x, mm.
    pub x_mm: [f64; 2],
    /// Lowest and highest y, mm.
    pub y_mm: [f64; 2],
    /// Lowest z, mm.
    pub z_low_mm: f64,
    /// Highest z, mm.
    pub z_high_mm: f64,
}

impl Default for WorkArea {
    fn default() -> Self {
        Self {
            centre_mm: [0.0, 0.0],
            radius_mm: 565.0,
            inner_radius_mm: 0.0,
            x_mm: [f64::NEG_INFINITY, f64::INFINITY],
            y_mm: [f64::NEG_INFINITY, f64::INFINITY],
            z_low_mm: -960.0,
            z_high_mm: -700.0,
        }
    }
}

/// The sheet and the heights of the pen, in the robot's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paper {
    /// The sheet's centre, mm.
    pub centre_mm: [f64; 2],
    /// Width and height of the sheet, mm.
    pub size_mm: [f64; 2],
    /// The platform's z when the pen draws at the sheet's centre, mm.
    pub pen_down_z_mm: f64,
    /// How far the pen is lifted between strokes, mm.
    pub pen_lift_mm: f64,
    /// How far below its drawing height the platform may go, mm.
    pub pressing_depth_mm: f64,
    /// How far the sheet rises over 1 mm of x and of y, mm.
    pub slope: [f64; 2],
    /// Height above its drawing height up to which the pen's spring keeps its tip on the sheet, mm.
    pub pen_spring_mm: f64,
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
            pen_spring_mm: 0.3,
        }
    }
}

impl Paper {
    /// How much higher the sheet is at a place than at its centre, mm.
    pub(crate) fn rise_mm(&self, x_mm: f64, y_mm: f64) -> f64 {
        self.slope[0] * (x_mm - self.centre_mm[0]) + self.slope[1] * (y_mm - self.centre_mm[1])
    }
}

/// Machine and configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// The robot.
    pub robot: Robot,
    /// The axes: the main axes, then further ones; at most [`AXES_MAX`] are judged.
    pub joints: Vec<JointLimits>,
    /// The space that the tool may use.
    pub work_area: WorkArea,
    /// The sheet and the pen.
    pub paper: Paper,
    /// Whether an axis moves the tool up and down. Otherwise an output lifts the pen: the height exists in orders only, the
    /// third main axis stands at the height of a pen that draws, and distances are those in plan view.
    pub has_height_axis: bool,
    /// Whether nothing lifts the pen: it touches wherever the tool is.
    pub always_touches: bool,
    /// Path speed with the pen down, mm/s.
    pub tool_speed_mm_s: f64,
    /// Path speed with the pen up, mm/s.
    pub travel_speed_mm_s: f64,
    /// Acceleration of the tool, mm/s2.
    pub tool_acceleration_mm_s2: f64,
    /// Vertical speed while the pen is lifted or lowered, mm/s; 0 if only the limits of all motion apply.
    pub pen_speed_mm_s: f64,
    /// Vertical acceleration while the pen is lifted or lowered, mm/s2; 0 if only the limits of all motion apply.
    pub pen_acceleration_mm_s2: f64,
    /// Time at rest where the pen meets the paper and where it leaves it, ms.
    pub pen_dwell_ms: u32,
    /// Largest deviation of the setpoints from the path with the pen down, mm.
    pub tolerance_mm: f64,
    /// Largest deviation of the setpoints from the path with the pen up, mm.
    pub travel_tolerance_mm: f64,
    /// Time over which an input shaper spreads each setpoint, ms; 0 without one.
    pub shaper_ms: u32,
    /// How far the tool may be from its setpoints at rest and in steady motion, mm. 0.3 leaves room beside the 0.1 mm
    /// that drives with a velocity loop of their own keep; motors in torque mode need 1.0 (`tests/drives.rs`).
    pub following_mm: f64,
    /// How far the pen may be beside its line, in addition to the tolerance and to what its acceleration explains, while
    /// nothing is disturbed, mm. 0.3 judges no more than `following_mm`; drives with a velocity loop of their own keep
    /// 0.02 in campaigns.
    pub undisturbed_mm: f64,
    /// Acceleration of the tool by a drive that keeps its last torque, mm/s2; 0 without drives that take a torque.
    pub kept_torque_mm_s2: f64,
    /// How long a joint may creep after a motion, ms. The position controller closes the last hundredths of a degree
    /// with a time constant of at most 25 ms: 100; motors in torque mode against the paper need 250.
    pub creep_ms: u32,
    /// Part of its speed by which the tool may exceed it. 0.05 leaves room for the overshoot of drives with a velocity
    /// loop of their own; motors in torque mode need 0.15.
    pub overshoot_part: f64,
    /// By how much the tool may exceed its speed beyond that, mm/s: 20 for the corrections of a following error of a
    /// quarter millimetre. Motors in torque mode swing by 0.15 mm at 30 Hz
    /// where the pen leaves the paper: 35.
    pub overshoot_mm_s: f64,
    /// Share of a drawing's lines that may be without ink. In torque mode the pen's spring does not always reach the
    /// paper: 0.01 (`tests/drives.rs`). If it is above 0, strokes shorter than half a millimetre are not judged.
    pub ink_missing_part: f64,
    /// Largest deviation from the path that is promised while an axis's feedback is not true, mm.
    pub disturbed_mm: f64,
    /// Longest pause between messages of a jog, ms.
    pub dead_man_ms: u32,
    /// Longest time in motion without a measurement, ms.
    pub blind_ms: u32,
    /// Watchdog of the drives, ms.
    pub watchdog_ms: u32,
    /// Silence of the host after which a drawing is held, ms.
    pub host_silence_ms: u32,
    /// Time from a telegram to the motor's reaction, ms: the drives' own delays.
    pub drive_delay_ms: u32,
    /// Period of the controller, ms; a [`Moment`](crate::Moment) is one millisecond whatever the period.
    pub period_ms: f64,
    /// Whether EtherCAT has the wire alone; otherwise it travels in UDP beside other protocols.
    pub raw_wire: bool,
}

impl Default for Cell {
    /// The default configuration: four equal axes, of which the last one turns freely.
    fn default() -> Self {
        let main = JointLimits::default();
        let fourth = JointLimits {
            range_rad: [-6_283.0, 6_283.0],
            mark_rad: 0.0,
            ..main
        };
        Self {
            robot: Robot::default(),
            joints: vec![main, main, main, fourth],
            work_area: WorkArea::default(),
            paper: Paper::default(),
            has_height_axis: true,
            always_touches: false,
            tool_speed_mm_s: 400.0,
            travel_speed_mm_s: 1_000.0,
            tool_acceleration_mm_s2: 10_000.0,
            pen_speed_mm_s: 0.0,
            pen_acceleration_mm_s2: 0.0,
            pen_dwell_ms: 0,
            tolerance_mm: 0.05,
            travel_tolerance_mm: 0.5,
            shaper_ms: 0,
            following_mm: 0.3,
            undisturbed_mm: 0.3,
            kept_torque_mm_s2: 0.0,
            creep_ms: 100,
            overshoot_part: 0.05,
            overshoot_mm_s: 20.0,
            ink_missing_part: 0.0,
            disturbed_mm: 40.0,
            dead_man_ms: 100,
            blind_ms: 5,
            watchdog_ms: 10,
            host_silence_ms: 500,
            drive_delay_ms: 2,
            period_ms: 1.0,
            raw_wire: true,
        }
    }
}
