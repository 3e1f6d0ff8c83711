//! The sampler while the axes are led to their switches: the setpoints of [`Search`] take the place of those of a path.

use super::Sampler;
use crate::application::{Fault, Power};
use crate::control::search::{Found, Search};
use crate::drives::io::{IoGroup, IoTrigger};
use crate::robots::AXES;

impl<G: IoTrigger + IoGroup> Sampler<'_, G> {
    /// Begins to lead the axes to their switches, from where they are.
    #[cold]
    pub(super) fn begin_search(&mut self) {
        if self.power != Power::On {
            return;
        }
        self.epoch = None;
        self.path_stop.end();
        self.window.clear();
        let search = Search::new(&self.axes, self.used, &self.now.measured_rad);
        let standing = search.setpoint();
        while self.window.has_room() {
            self.window.push(&standing);
        }
        self.robot.set_searching(true);
        self.search = Some(search);
    }

    #[cold]
    pub(super) fn end_search(&mut self) {
        self.search = None;
        self.robot.set_searching(false);
    }

    /// This millisecond's setpoint of a search. Returns what [`Self::next_setpoint`] does.
    #[cold]
    pub(super) fn search_setpoint(&mut self) -> (bool, bool) {
        let (io, increments) = (&self.io, &self.now.increments);
        let Some(search) = &mut self.search else {
            return (false, false);
        };
        match search.step(|input| io.is_open(input), increments) {
            Ok(Found::Setpoint(setpoint)) => {
                self.window.advance();
                self.window.push(&setpoint);
                if let Some(setpoint) = self.window.first() {
                    self.now.setpoint = *setpoint;
                }
                return (true, false);
            }
            Ok(Found::End(edges)) => {
                // A refusal leaves the axes unhomed, which the operating modes see and report.
                let _ = edges.map(|edges| self.robot.home_at(&edges));
                self.same_zero = [false; AXES];
            }
            Err((axis, failure)) => self.supervision.latch(Fault::HomingFailed { axis, failure }),
        }
        self.end_search();
        self.window.clear();
        (false, false)
    }
}
