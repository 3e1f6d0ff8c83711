//! The monitor: takes one millisecond after the other and tells the first broken rule of each.

use crate::bounds::Bounds;
use crate::cell::Cell;
use crate::disturbances::Disturbances;
use crate::drawing::{Drawing, Place};
use crate::moment::{Input, Moment};
use crate::motion::Motion;
use crate::orders::Orders;
use crate::rules::Rules;
use crate::scene::{self, Scene};
use crate::vector::Vector;
use crate::violation::Violation;

/// The judge of a controller.
///
/// It never panics, whatever it is given, and can be stepped on after a violation.
#[derive(Clone, Debug)]
pub struct Monitor {
    cell: Cell,
    bounds: Bounds,
    motion: Motion,
    orders: Orders,
    disturbances: Disturbances,
    drawing: Drawing,
    slide_mm: f64,
    rules: Rules,
}

impl Monitor {
    /// A monitor of a controller that has just started.
    #[must_use]
    pub fn new(cell: Cell) -> Self {
        Self {
            bounds: Bounds::new(&cell),
            cell,
            motion: Motion::default(),
            orders: Orders::default(),
            disturbances: Disturbances::default(),
            drawing: Drawing::new(),
            slide_mm: 0.0,
            rules: Rules::default(),
        }
    }

    /// Takes another configuration. Call it before the moment whose inputs contain [`Input::Configured`].
    pub fn configure(&mut self, cell: Cell) {
        self.bounds = Bounds::new(&cell);
        self.cell = cell;
    }

    /// Takes one millisecond. After a gap in the time, differences begin anew.
    ///
    /// # Errors
    /// The first rule that this millisecond breaks.
    pub fn step(&mut self, moment: &Moment<'_>) -> Result<(), Violation> {
        self.motion.step(&self.cell, &self.bounds, moment);
        self.drawing.is_finished_now = false;
        for input in moment.inputs {
            self.take(input);
        }
        self.disturbances.step(moment.time_ms);
        if self
            .orders
            .step(&self.cell, &self.bounds, &self.motion, &self.disturbances)
        {
            self.drawing.begin_unanswered(&self.cell, &self.bounds);
        }
        for report in moment.reports {
            self.disturbances.hear(report);
            self.orders.hear(&self.bounds, &self.motion, &self.disturbances, report);
            self.drawing.hear(&self.cell, &self.bounds, report);
        }
        if !self.orders.asks_for_path() {
            self.drawing.forget_asked();
        }
        let is_stopping = self.orders.is_stopping(&self.bounds, moment.time_ms);
        let is_power_changing = scene::is_power_changing(&self.motion);
        let is_changing = is_stopping || is_power_changing;
        if !is_stopping {
            let slide_mm = scene::slide_mm(&self.cell, &self.bounds, &self.motion, &self.disturbances);
            // What a disturbance hides may have begun at any of its speeds.
            let least_mm = if self.disturbances.none() { 0.0 } else { self.slide_mm };
            self.slide_mm = slide_mm.max(least_mm);
        }
        let more_mm = scene::more_mm(&self.cell, &self.disturbances, is_changing, self.slide_mm);
        let place = self.follow(moment, more_mm);
        let scene = Scene {
            cell: &self.cell,
            bounds: &self.bounds,
            motion: &self.motion,
            orders: &self.orders,
            disturbances: &self.disturbances,
            drawing: &self.drawing,
            place,
            is_stopping,
            is_power_changing,
            more_mm,
            moment,
        };
        self.rules.check(&scene).map_err(|(rule, text)| Violation {
            time_ms: moment.time_ms,
            rule,
            text,
        })
    }

    /// A counter of this name has to show a number at the end. An [`Input::Expected`] says the same.
    pub fn expect(&mut self, name: &'static str, count: u64) {
        self.rules.take(&Input::Expected { name, count });
    }

    /// Checks what can be told only at the end.
    ///
    /// # Errors
    /// The first rule that the whole run breaks.
    pub fn end(&mut self) -> Result<(), Violation> {
        self.rules.end().map_err(|(rule, text)| Violation {
            time_ms: self.motion.now_ms,
            rule,
            text,
        })
    }

    /// Where the tool is by the monitor's own kinematics, mm; `None` if no tool connects the joints.
    #[must_use]
    pub fn tool(&self) -> Option<Vector> {
        self.motion.tool
    }

    fn take(&mut self, input: &Input) {
        self.disturbances.take(&self.cell, &self.motion, input);
        self.orders
            .take(&self.cell, &self.bounds, &self.motion, &self.disturbances, input);
        self.drawing.take(&self.cell, &self.bounds, self.motion.tool, input);
        self.rules.take(input);
    }

    /// Adds the ink, and looks for the tool on the drawing.
    fn follow(&mut self, moment: &Moment<'_>, more_mm: Option<f64>) -> Option<Place> {
        let tool = self.motion.tool?;
        if moment.pen_touches {
            self.drawing.add_ink(&tool);
        }
        self.drawing.approach(&tool);
        self.drawing.was_disturbed |= self.disturbances.is_misled();
        let more_mm = more_mm.filter(|_| self.orders.is_drawing(self.motion.now_ms))?;
        Some(self.drawing.locate(&self.cell, &self.bounds, &tool, more_mm))
    }
}
