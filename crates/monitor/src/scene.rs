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
    /// How far the tool may slide if everything stops, mm, as of the last sound millisecond.
    pub(crate) slide_mm: f64,
    pub(crate) moment: &'a Moment<'a>,
}

impl Scene<'_> {
    pub(crate) fn now_ms(&self) -> u64 {
        self.motion.now_ms
    }

    /// Whether everything is stopping.
    pub(crate) fn is_stopping(&self) -> bool {
        self.orders.is_stopping(self.bounds, self.now_ms())
    }

    /// Whether the power of a drive has changed a moment ago.
    pub(crate) fn is_power_changing(&self) -> bool {
        let changed = self.motion.power_changed_ms;
        changed.is_some_and(|changed_ms| self.now_ms().saturating_sub(changed_ms) <= POWER_SETTLE_MS)
    }

    /// Whether nothing is disturbed, nothing is stopping, and the drives' power is as it was.
    pub(crate) fn is_sound(&self) -> bool {
        self.disturbances.none() && !self.is_stopping() && !self.is_power_changing()
    }

    /// How far the tool may be beside a border or a path, mm, in addition to the bounds of sound motion; `None` if that
    /// is not known.
    pub(crate) fn more_mm(&self) -> Option<f64> {
        more_mm(
            self.cell,
            self.disturbances,
            self.is_stopping() || self.is_power_changing(),
            self.slide_mm,
        )
    }
}

/// How far the tool may be beside a border or a path in addition to the bounds of sound motion, mm; `None` if nobody
/// knows, because the reference is wrong.
pub(crate) fn more_mm(cell: &Cell, disturbances: &Disturbances, is_changing: bool, slide_mm: f64) -> Option<f64> {
    if disturbances.misreferenced() {
        return None;
    }
    let by_feedback = if disturbances.feedback() {
        cell.disturbed_mm
    } else {
        0.0
    };
    let by_stop = if is_changing || disturbances.machine() {
        slide_mm
    } else {
        0.0
    };
    Some(by_feedback + by_stop)
}

/// How far the tool may slide if everything stops now, mm.
pub(crate) fn slide_mm(bounds: &Bounds, motion: &Motion) -> f64 {
    let ramp_s = motion.each_axis().map(|axis| {
        let stop_rad_s2 = bounds.joints.get(axis).map_or(1.0, |joint| joint.stop_rad_s2);
        motion.speeds_rad_s.get(axis).copied().unwrap_or(0.0).abs() / stop_rad_s2
    });
    let duration_s = bounds.reaction_ms as f64 / 1_000.0 + ramp_s.fold(0.0, f64::max);
    let way_mm = motion.tool_speed_mm_s * duration_s;
    SLIDE_MM + SLIDE_FACTOR * way_mm
}

const _: () = assert!(POWER_SETTLE_MS >= SETTLE_MS);
