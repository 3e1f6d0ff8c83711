//! Axes that the machine lacks: the setpoints move them, and no drive does.

use super::Sampler;
use crate::control::pen_switch::HEIGHT;
use crate::drives::io::{IoGroup, IoTrigger};
use crate::motion::Setpoint;
use crate::robots::AXES;

impl<G: IoTrigger + IoGroup> Sampler<'_, G> {
    /// Takes an axis that the machine lacks: it is where the last setpoint was, and its drive is in the state of the first
    /// axis's. Without setpoints the pen is up. Returns true: the axis is at rest.
    #[cold]
    pub(super) fn follow_absent(&mut self, axis: usize) -> bool {
        let now = &mut self.now;
        if axis == HEIGHT && self.epoch.is_none() {
            now.setpoint.position_rad[HEIGHT] = self.pen.up_rad;
        }
        let at = (now.measured_rad.get_mut(axis), now.setpoint.position_rad.get(axis));
        if let (Some(measured_rad), Some(setpoint_rad)) = at {
            *measured_rad = *setpoint_rad;
        }
        let [first, ..] = now.status_word;
        now.status_word.iter_mut().skip(axis).for_each(|word| *word = first);
        true
    }

    /// Forgets what was measured; the axes that the machine lacks are at 0, valid and homed.
    #[cold]
    pub(super) fn leave_out_absent(&mut self) {
        let now = &mut self.now;
        now.setpoint = Setpoint::default();
        now.homed = core::array::from_fn(|axis| axis >= self.used);
        now.valid = now.homed;
        (now.measured_rad_s, now.increments) = ([0.0; AXES], [0; AXES]);
        self.home_lost = [false; AXES];
    }
}
