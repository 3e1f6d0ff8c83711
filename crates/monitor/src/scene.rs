//! What the rules look at: one millisecond with everything that is known about it.

use crate::bounds::{Bounds, SETTLE_MS};
use crate::cell::Cell;
use crate::disturbances::Disturbances;
use crate::drawing::{Drawing, Place};
use crate::moment::Moment;
use crate::motion::Motion;
use crate::orders::Orders;
use crate::violation::Rule;

/// Time after a change of a drive's power in which its motor takes over its load, ms.
const POWER_SETTLE_MS: u64 = 500;
/// Factor on the tool's way in a stop, because joints that stop one after the other lead it aside, and a constant part,
/// mm.
const SLIDE_FACTOR: f64 = 2.0;
const SLIDE_MM: f64 = 2.0;

/// The finding of a rule: the rule that is broken, and how.
pub(crate) type Finding = Result<(), (Rule, String)>;

/// One millisecond with everything that is known about it.
pub(crate) struct Scene<'a> {
    pub(crate) cell: &'a Cell,
    pub(crate) bounds: &'a Bounds,
    pub(crate) motion: &'a Motion,
    pub(crate) orders: &'a Orders,
    pub(crate) disturbances: &'a Disturbances,
    pub(crate) drawing: &'a Drawing,
    /// Where the tool is on the drawing; `None` outside a drawing.
    pub(crate) place: Option<Place>,
    /// Whether everything is stopping.
    pub(crate) is_stopping: bool,
    /// Whether the power of a drive has changed a moment ago.
    pub(crate) is_power_changing: bool,
    /// How far the tool may be beside a border or a path, mm, in addition to the bounds of sound motion; `None` if that
    /// is not known.
    pub(crate) more_mm: Option<f64>,
    pub(crate) moment: &'a Moment<'a>,
}

impl Scene<'_> {
    pub(crate) fn now_ms(&self) -> u64 {
        self.motion.now_ms
    }

    /// Whether a robot without an order stands: frames that are disturbed do not move it, false feedback may.
    pub(crate) fn stands_without_order(&self) -> bool {
        !self.disturbances.moves_astray() && !self.is_stopping && !self.is_power_changing
    }

    /// Whether nothing is disturbed, nothing is stopping, and the drives' power is as it was.
    pub(crate) fn is_sound(&self) -> bool {
        self.disturbances.none() && !self.is_stopping && !self.is_power_changing
    }
}

/// How far the tool may be beside a border or a path in addition to the bounds of sound motion, mm; `None` if nobody
/// knows, because the reference is wrong or is being searched for.
pub(crate) fn more_mm(cell: &Cell, disturbances: &Disturbances, is_changing: bool, slide_mm: f64) -> Option<f64> {
    if disturbances.misreferenced() || disturbances.searches() {
        return None;
    }
    let by_feedback = if disturbances.feedback() {
        cell.disturbed_mm
    } else {
        0.0
    };
    let by_stop = if is_changing || disturbances.machine_disturbed() || disturbances.may_be_stopped() {
        slide_mm
    } else {
        0.0
    };
    Some(by_feedback + by_stop)
}

/// Whether the power of a drive has changed a moment ago.
pub(crate) fn is_power_changing(motion: &Motion) -> bool {
    let changed = motion.power_changed_ms;
    changed.is_some_and(|changed_ms| motion.now_ms.saturating_sub(changed_ms) <= POWER_SETTLE_MS)
}

/// How far the tool may slide if everything stops now, mm. Speeds count up to their limits. Drives that no telegram
/// reaches brake when their watchdog expires; one that takes a torque keeps the last one until then, and accelerates.
pub(crate) fn slide_mm(cell: &Cell, bounds: &Bounds, motion: &Motion, disturbances: &Disturbances) -> f64 {
    let reaction_ms = match disturbances.machine_disturbed() {
        true => bounds.watchdog_ms,
        false => bounds.reaction_ms,
    };
    let kept_s = match disturbances.machine_disturbed() {
        true => reaction_ms as f64 / 1_000.0,
        false => 0.0,
    };
    let driven_mm = 0.5 * cell.kept_torque_mm_s2 * kept_s * kept_s;
    let ramps_s = motion.speeds_rad_s.iter().zip(&bounds.joints).take(motion.axes);
    let ramp_s = ramps_s.map(|(speed, joint)| speed.abs().min(joint.speed_rad_s) / joint.stop_rad_s2);
    let duration_s = reaction_ms as f64 / 1_000.0 + ramp_s.fold(0.0, f64::max);
    let fastest_mm_s = 2.0 * cell.tool_speed_mm_s.max(cell.travel_speed_mm_s);
    SLIDE_MM + driven_mm + SLIDE_FACTOR * motion.tool_speed_mm_s.min(fastest_mm_s) * duration_s
}

const _: () = assert!(POWER_SETTLE_MS >= SETTLE_MS);
