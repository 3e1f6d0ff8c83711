//! The sampler while the axes are led to their switches: the setpoints of [`Search`] take the place of those of a path.

use super::Sampler;
use crate::application::{Fault, Power};
use crate::control::pen_switch::HEIGHT;
use crate::control::position::PositionController;
use crate::control::search::{Found, Search, SearchFailure};
use crate::drives::io::{IoGroup, IoTrigger};
use crate::robots::{AXES, Kind};

impl<G: IoTrigger + IoGroup> Sampler<'_, G> {
    /// Begins to lead the axes to their switches, from where they are. They are no longer homed, however the search ends:
    /// the pose that they had was to be corrected.
    #[cold]
    pub(super) fn begin_search(&mut self, kind: Kind) {
        if self.power != Power::On {
            return;
        }
        self.epoch = None;
        self.path_stop.end();
        self.window.clear();
        self.robot.forget_home();
        let homed = core::array::from_fn(|axis| axis >= self.used);
        let unhomed_rad = self.robot.angles_rad();
        let now = &mut self.now;
        for (measured_rad, unhomed_rad) in now.measured_rad.iter_mut().zip(unhomed_rad).take(self.used) {
            *measured_rad = unhomed_rad;
        }
        // A missing height is where the pen is up.
        if HEIGHT >= self.used {
            now.measured_rad[HEIGHT] = self.pen.up_rad;
        }
        (now.homed, self.home_lost, self.same_zero) = (homed, [false; AXES], [false; AXES]);
        // The setpoints that were followed belong to the former zeros.
        self.controllers.iter_mut().for_each(PositionController::reset);
        let search = Search::new(kind, &self.axes, self.used, &now.measured_rad);
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
        match search.step(&self.axes, |input| io.is_open(input), increments) {
            Ok(Found::Setpoint(setpoint)) => {
                self.window.advance();
                self.window.push(&setpoint);
                if let Some(setpoint) = self.window.first() {
                    self.now.setpoint = *setpoint;
                }
                return (true, false);
            }
            Ok(Found::End(edges)) => {
                let homed = edges.map_or(Ok(()), |edges| self.robot.home_at(&edges));
                self.same_zero = [false; AXES];
                match homed {
                    Ok(()) => {}
                    // A position may be missing in this very millisecond.
                    Err(_) if search.may_wait() => {
                        self.window.advance();
                        self.window.push(&search.setpoint());
                        return (true, false);
                    }
                    Err(error) => self.supervision.latch(Fault::HomingFailed {
                        axis: error.axis(),
                        failure: SearchFailure::Missing,
                    }),
                }
            }
            Err((axis, failure)) => self.supervision.latch(Fault::HomingFailed { axis, failure }),
        }
        self.end_search();
        self.window.clear();
        (false, false)
    }
}
