//! Commands of the operator, and why one is refused.

use super::{Fault, Mode};
use crate::motion::{self, Pen};
use crate::robots::{JointAngles, Position};
use serde::{Deserialize, Serialize};

/// A command of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Home: take the encoders' angles at the present pose, where they do not know the motor turn on the one nearest to the mark.
    #[serde(rename = "Reference")]
    Home,
    /// Home at a known pose: take the motor turns nearest to it, if the encoders show that pose and its forward
    /// kinematics leads to the measured position.
    #[serde(rename = "ReferenceAt")]
    HomeAt {
        /// The robot's present pose.
        pose: JointAngles,
        /// Measured position of the platform, if known.
        position: Option<Position>,
    },
    /// Power the drives and hold the pose.
    Enable,
    /// Decelerate to a standstill, close the brakes, then switch the drives' power off.
    Disable,
    /// Move while this message is repeated within the dead-man time; velocity in mm/s.
    Jog {
        /// Velocity of the platform, mm/s.
        velocity_mm_s: [f32; 3],
    },
    /// Move to a position in a straight line.
    Move {
        /// Target.
        position: Position,
    },
    /// Begin a drawing: the path's vertices follow, counted from 0.
    Draw {
        /// Number chosen by the host, repeated in the acknowledgements.
        job: u16,
    },
    /// Decelerate on the path, lift the pen and wait; the drawing can be resumed.
    Hold,
    /// Continue a held drawing.
    Resume,
    /// End the drawing: decelerate on the path, lift the pen, discard the rest.
    Cancel,
    /// Scale the path speed, percent from 10 to 200.
    Override {
        /// Percent of the configured speed.
        percent: u8,
    },
    /// Lift or lower the pen at the present position.
    Pen {
        /// Target.
        pen: Pen,
    },
    /// Stop at once, on the path if there is one, as fast as the drives' quick stop; latched as a fault.
    Stop,
    /// Acknowledge a fault: clears it if its cause is gone, and brings lost slaves back.
    Acknowledge,
    /// Set an output of a terminal.
    SetOutput {
        /// The output: its place in the configuration's `io`, from 0.
        io: u8,
        /// Its bits; a signed value in two's complement of its own length.
        value: u32,
    },
}

/// Why a named input or output was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum IoRefusal {
    /// The configuration has no such point.
    Unknown,
    /// It is an input.
    IsInput,
    /// The controller itself sets this output.
    IsOwn,
    /// The value has more bits than the output.
    Range {
        /// Bits of the output.
        expected: u8,
        /// The value.
        actual: u32,
    },
    /// Its terminal is not in operation.
    Missing,
    /// This input holds the drawing.
    Holds,
}

/// Why a command was refused. A refused command changes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Refusal {
    /// The mode does not allow it.
    NotInMode(Mode),
    /// There is no configuration yet.
    NotConfigured,
    /// The joint angles are not referenced.
    NotReferenced,
    /// The target is outside the work area.
    Target(motion::Refusal),
    /// The override is outside 10 to 200 percent.
    OverrideRange(u8),
    /// The cause of the fault is still present.
    CauseRemains(Fault),
    /// The robot is moving.
    Moving,
    /// A value is not a finite number.
    NotFinite,
    /// No position of an axis arrives.
    NoPosition {
        /// Axis, from 0.
        axis: u8,
    },
    /// The angle that the axis's encoder shows differs from the pose.
    PoseResolver {
        /// Axis, from 0.
        axis: u8,
        /// That angle, of a single-turn encoder on the turn nearest to the pose, minus the pose, rad.
        difference_rad: f32,
    },
    /// Forward kinematics of the pose does not give the measured position.
    PosePosition {
        /// The axis that differs most, from 0.
        axis: u8,
        /// Difference of this axis, rad; near a multiple of a motor turn if the turn is wrong.
        difference_rad: f32,
        /// Distance between the two positions, mm.
        distance_mm: f32,
    },
    /// Too many commands at once.
    Busy,
    /// The fault is already acknowledged; the bus and drives are recovering.
    Recovering,
    /// A named input or output is concerned.
    Io {
        /// Its place in the configuration's `io`, from 0.
        io: u8,
        /// Why.
        reason: IoRefusal,
    },
    /// Homing by switches moves the axes: the drives need power first.
    NeedsPower,
    /// A joint stands on the other side than the planner would choose: no motion can begin there.
    OtherSide {
        /// Axis, from 0.
        axis: u8,
        /// Its angle, rad.
        angle_rad: f32,
        /// The angle that the planner would choose, rad.
        planned_rad: f32,
    },
}
