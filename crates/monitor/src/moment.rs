//! One millisecond: the truth, and what crossed the walls between controller, operator and machine.
//!
//! Plain data. A caller that leaves something out makes the monitor more lenient, never wrong: a command that is never
//! answered counts as accepted after a while, and a report that never comes is not judged.

/// True state of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Joint {
    /// Angle, rad.
    pub angle_rad: f64,
    /// Speed, rad/s.
    pub speed_rad_s: f64,
    /// Whether the drive's power stage moves or holds the motor: operation enabled, quick stop or fault reaction.
    pub has_power: bool,
    /// Whether an order of the controller took the motor's power within the last two milliseconds.
    pub is_switched_off: bool,
}

/// Most axes of a pose.
pub const POSE_AXES: usize = 4;

/// A command of the operator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Home at the present pose, on the motor turns nearest to the marks.
    Home,
    /// Home at a given pose.
    HomeAt {
        /// The pose, rad.
        pose_rad: [f64; POSE_AXES],
    },
    /// Lead the axes to their home switches, which show where the joints are.
    Search,
    /// Power the drives.
    Enable,
    /// Take the power from the drives.
    Disable,
    /// Move while this message is repeated.
    Jog {
        /// Velocity of the tool, mm/s.
        velocity_mm_s: [f64; 3],
    },
    /// Move to a position in a straight line.
    Move {
        /// Target, mm.
        position_mm: [f64; 3],
    },
    /// Begin a drawing.
    Draw {
        /// Number of the job.
        job: u16,
    },
    /// Hold the drawing.
    Hold,
    /// Continue a held drawing.
    Resume,
    /// End the motion.
    Cancel,
    /// Scale the path's speed.
    Override {
        /// Percent of the configured speed, 10 to 200.
        percent: u8,
    },
    /// Lift or lower the pen at the present position.
    Pen {
        /// Whether to lower it.
        down: bool,
    },
    /// Quick stop.
    Stop,
    /// Acknowledge a fault.
    Acknowledge,
}

/// What reached the controller, or was done to the machine, in this millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Input {
    /// A configuration; the cell's numbers are those of the configuration in force.
    Configured,
    /// A command.
    Commanded(Command),
    /// The emergency-stop input shows open or closed from now on.
    StopInput(bool),
    /// The board's clock source has failed, or works again: a stop at once.
    ClockFailed(bool),
    /// The encoder of this axis, from 0, was mounted again: it shows true positions from now on, but the reference of the axis
    /// is not true until it is homed.
    Mounted {
        /// The axis.
        axis: usize,
    },
    /// The position feedback of an axis, from 0, is not true from now on, or true again. A reference that was taken
    /// from it or that it has shifted is not true either, until the axis is homed at its true angle.
    Feedback {
        /// Axis, from 0.
        axis: usize,
        /// Whether the feedback is not true.
        disturbed: bool,
    },
    /// Anything else that disturbs machine or controller: frames, cables, slaves, power, late tasks, clocks. From now
    /// on, or no longer. Frames of a moment are disturbed for that moment.
    Machine {
        /// Whether something is disturbed.
        disturbed: bool,
    },
    /// The drive of an axis, from 0, cannot obey from now on, or can again: its processor stands still.
    Drive {
        /// Axis, from 0.
        axis: usize,
        /// Whether it cannot obey.
        deaf: bool,
    },
    /// The operator's link is cut from now on, or joined.
    Link {
        /// Whether it is cut.
        cut: bool,
    },
    /// A vertex of a job's path. The path belongs to one order: each further order of its number brings it again, until one
    /// that came with it is accepted.
    PathVertex {
        /// Number of the job.
        job: u16,
        /// Index of the vertex, from 0. Repeated vertices of an accepted order are ignored; those of an order whose
        /// answer is awaited begin anew with 0.
        index: u32,
        /// Position in the robot's frame, mm.
        position_mm: [f64; 3],
        /// Whether the pen draws on the way to this vertex.
        pen_down: bool,
    },
    /// The controller has restarted: everything that it was told is forgotten.
    Restarted,
    /// A fault began that the controller can notice, because nothing else is disturbed.
    Noticeable {
        /// What happened.
        what: &'static str,
        /// When it has to be reported, ms.
        by_ms: u64,
        /// How it has to be reported.
        notice: Notice,
    },
    /// Something happened that may hide what [`Input::Noticeable`] told.
    Hidden,
    /// Number of events, so far, that a counter of this name must show at the end. Replaces an earlier number.
    Expected {
        /// Name of the counter.
        name: &'static str,
        /// Events so far.
        count: u64,
    },
}

/// How the controller has to report a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// With any latched fault.
    Fault,
    /// With joint angles that are not known.
    Unhomed,
}

/// Operating mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Waiting for a configuration.
    Startup,
    /// The bus is being brought up.
    BusConfiguring,
    /// The drives have no power.
    DrivesOff,
    /// The drives hold the pose; the joint angles are not known.
    Unreferenced,
    /// Enabled and at rest.
    Idle,
    /// The home switches are searched for.
    Homing,
    /// A jog or a single move.
    Moving,
    /// A path is being drawn.
    Drawing,
    /// A drawing is held: decelerating, lifting the pen, or at rest.
    Holding,
    /// Decelerating to a standstill.
    Stopping,
    /// A fault is latched.
    Fault,
}

impl Mode {
    /// Whether the robot stands still in this mode.
    #[must_use]
    pub fn stands(self) -> bool {
        !matches!(
            self,
            Self::Homing | Self::Moving | Self::Drawing | Self::Holding | Self::Stopping
        )
    }
}

/// Value of a counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Count {
    /// Name of the counter.
    pub name: &'static str,
    /// Its value.
    pub count: u64,
}

/// What the controller told its operator in this millisecond.
#[derive(Clone, Debug, PartialEq)]
pub enum Report {
    /// The operating mode.
    Mode(Mode),
    /// The latched fault in words, or none.
    Fault(Option<String>),
    /// Whether the joint angles are known.
    Homed(bool),
    /// A command was accepted.
    Accepted(Command),
    /// A command was refused; nothing has changed.
    Refused(Command),
    /// A vertex was refused; the vertices before it end the path.
    VertexRefused {
        /// Number of the job.
        job: u16,
        /// Index of the vertex, from 0.
        index: u32,
    },
    /// A job's path was executed to its end.
    Finished {
        /// Number of the job.
        job: u16,
    },
    /// Counters since the controller started.
    Counters(Vec<Count>),
}

/// An Ethernet frame on the wire, without its check sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WireFrame<'a> {
    /// Whether the master sent it.
    pub from_master: bool,
    /// Its bytes.
    pub bytes: &'a [u8],
    /// When it left, ns.
    pub time_ns: u64,
}

/// Distributed clocks at one true moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clocks<'a> {
    /// The moment, ns.
    pub time_ns: u64,
    /// System time of each slave's clock, ns, in the order of the chain: the lower 32 bits count. `None` for a slave without a
    /// clock, or not in OP. Empty where no clock is set up.
    pub system_ns: &'a [Option<u64>],
}

/// One millisecond.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// Milliseconds since the start.
    pub time_ms: u64,
    /// The true joints.
    pub joints: &'a [Joint],
    /// Whether the pen's tip touches the sheet.
    pub pen_touches: bool,
    /// What reached the controller.
    pub inputs: &'a [Input],
    /// What the controller told its operator.
    pub reports: &'a [Report],
    /// Frames on the wire.
    pub wire: &'a [WireFrame<'a>],
    /// The slaves' distributed clocks.
    pub clocks: Clocks<'a>,
}
