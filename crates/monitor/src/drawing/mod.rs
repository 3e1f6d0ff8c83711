//! What the tool was ordered to draw, and the ink that it left.
//!
//! A drawing is a chain of legs. The tool is looked for on the legs around the one where it was last, and only if it is
//! not there on all legs nearby.

mod grid;
mod ink;
mod leg;

use crate::bounds::Bounds;
use crate::cell::Cell;
use crate::moment::{Command, Input, Report};
use crate::vector::{Vector, is_finite, length, subtract};
use grid::Grid;
use ink::Ink;
use leg::Leg;

/// Side of a cell, mm. Legs are entered at places a quarter of a cell from each of their points.
const CELL_MM: f64 = 4.0;
/// Longest leg, in half cells, that is entered into the grid; longer ones are compared every time.
const LONG_HALF_CELLS: f64 = 2_000.0;
/// Most long legs; more are not judged.
const LONG_MAX: usize = 64;
/// Legs around the last one that are looked at first: one before, and those after it.
const BEFORE: usize = 1;
const AFTER: usize = 5;
/// Distance between places of a leg that are checked for ink, mm.
const STEP_MM: f64 = 0.5;
/// Moves and pen orders that are remembered.
const SINGLES_MAX: usize = 8;
/// Distance from a leg with the pen up within which the speed is that of travel, mm.
const TRAVEL_NEAR_MM: f64 = 3.0;

/// Where the tool is on the drawing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Place {
    /// Whether the tool is within the tolerance of a leg, or lifted above one.
    pub(crate) is_on_path: bool,
    /// Distance of the leg that was nearest among those looked at, mm.
    pub(crate) off_mm: f64,
    /// Whether only legs with the pen down are near.
    pub(crate) draws: bool,
}

/// A drawing that was ordered and is not answered.
#[derive(Clone, Debug)]
struct Asked {
    job: u16,
    /// Orders of this number that are not answered.
    orders: u32,
    /// Where the tool was when it was ordered first, mm, and how far false feedback may have led it away since, mm.
    at: Option<Vector>,
    astray_mm: f64,
    /// Its vertices so far: place in the path, position in mm, whether the pen is down.
    path: Vec<(u32, Vector, bool)>,
    /// What the pen has touched since: the answer may come later than the first ink, mm.
    ink: Vec<[f64; 2]>,
}

/// The present drawing, and single orders.
#[derive(Clone, Debug)]
pub(crate) struct Drawing {
    job: Option<u16>,
    /// The drawing that was ordered last and is not answered.
    next: Option<Asked>,
    /// The drawing that was ordered before it and is not answered either.
    replaced: Option<Asked>,
    /// The drawing whose answer was lost, and where its path ends so far.
    unanswered: Option<(u16, Option<Vector>)>,
    end: Option<Vector>,
    /// Smallest distance of the tool from the end of the path since that was ordered, mm.
    end_off_mm: f64,
    legs: Vec<Leg>,
    grid: Grid,
    long: Vec<u32>,
    /// Whether there are more legs than can be judged.
    is_too_much: bool,
    /// Vertices that arrived, and how many of them belong to the path.
    vertices: u32,
    limit: u32,
    cursor: usize,
    singles: [Option<(Command, Leg)>; SINGLES_MAX],
    single: usize,
    ink: Ink,
    /// How far from its first leg's beginning the tool may have been led before it began, mm.
    astray_mm: f64,
    /// Whether the ink may be elsewhere than ordered.
    pub(crate) was_disturbed: bool,
    /// Whether this drawing has been reported as finished, and whether that was in this millisecond.
    is_told: bool,
    pub(crate) is_finished_now: bool,
}

impl Drawing {
    pub(crate) fn new() -> Self {
        Self {
            job: None,
            next: None,
            replaced: None,
            unanswered: None,
            end: None,
            end_off_mm: f64::INFINITY,
            legs: Vec::new(),
            grid: Grid::new(CELL_MM),
            long: Vec::new(),
            is_too_much: false,
            vertices: 0,
            limit: u32::MAX,
            cursor: 0,
            singles: [None; SINGLES_MAX],
            single: 0,
            ink: Ink::new(),
            astray_mm: 0.0,
            was_disturbed: false,
            is_told: false,
            is_finished_now: false,
        }
    }

    /// Takes an input; `tool` is where the tool is.
    pub(crate) fn take(&mut self, cell: &Cell, bounds: &Bounds, tool: Option<Vector>, input: &Input) {
        match *input {
            Input::Commanded(Command::Draw { job }) => self.ask(job, tool),
            Input::Commanded(command @ Command::Move { position_mm }) => {
                self.order_single(cell, command, tool, position_mm, bounds);
            }
            Input::Commanded(command @ Command::Pen { down }) => {
                if let Some([x, y, _]) = tool {
                    let lift_mm = if down { 0.0 } else { cell.paper.pen_lift_mm };
                    let to = [x, y, cell.paper.pen_down_z_mm + cell.paper.rise_mm(x, y) + lift_mm];
                    self.order_single(cell, command, tool, to, bounds);
                }
            }
            Input::PathVertex {
                job,
                index,
                position_mm,
                pen_down,
            } => {
                let asked = [&mut self.next, &mut self.replaced];
                let asked = asked.into_iter().flatten().find(|asked| asked.job == job);
                if let Some(asked) = asked {
                    if index == 0 {
                        // A repeated order brings its path again.
                        asked.path.clear();
                    }
                    asked.path.push((index, position_mm, pen_down));
                } else if self.unanswered.is_some_and(|(unanswered, _)| unanswered == job) {
                    self.append_unanswered(cell, position_mm, pen_down, bounds);
                } else if self.job == Some(job) {
                    self.go_on(cell, bounds, index, position_mm, pen_down);
                }
            }
            Input::Restarted => {
                (self.job, self.next, self.replaced, self.unanswered) = (None, None, None, None);
            }
            _ => {}
        }
    }

    /// A drawing is ordered. An order that repeats the number of the last one is for the same path.
    fn ask(&mut self, job: u16, tool: Option<Vector>) {
        if let Some(asked) = self.next.as_mut().filter(|asked| asked.job == job) {
            asked.orders = asked.orders.saturating_add(1);
            return;
        }
        self.replaced = self.next.replace(Asked {
            job,
            orders: 1,
            at: tool,
            astray_mm: 0.0,
            path: Vec::new(),
            ink: Vec::new(),
        });
    }

    /// Takes a report.
    pub(crate) fn hear(&mut self, cell: &Cell, bounds: &Bounds, report: &Report) {
        match *report {
            Report::Accepted(Command::Draw { job }) => {
                let asked = if is_of(&self.next, job) {
                    self.replaced = None;
                    self.next.take()
                } else {
                    self.replaced.take_if(|asked| asked.job == job)
                };
                if let Some(asked) = asked {
                    self.begin(cell, bounds, asked);
                }
            }
            Report::Refused(Command::Draw { job }) => self.refused(cell, bounds, job),
            Report::Refused(command @ (Command::Move { .. } | Command::Pen { .. })) => {
                let refused = self
                    .singles
                    .iter_mut()
                    .find(|single| single.is_some_and(|(order, _)| order == command));
                refused.into_iter().for_each(|single| *single = None);
            }
            Report::Finished { job } if self.job == Some(job) && !self.is_told => {
                (self.is_told, self.is_finished_now) = (true, true);
            }
            Report::VertexRefused { job, index } if self.job == Some(job) => self.limit = self.limit.min(index),
            _ => {}
        }
    }

    /// An order to draw was refused.
    fn refused(&mut self, cell: &Cell, bounds: &Bounds, job: u16) {
        if !is_of(&self.next, job) {
            self.replaced.take_if(|asked| asked.job == job);
            return;
        }
        let Some(asked) = self.next.as_mut() else { return };
        asked.orders -= 1;
        let Some(asked) = self.next.take_if(|asked| asked.orders == 0) else {
            return;
        };
        if self.job == Some(job) {
            // The drawing of that number was begun by an earlier order: the path is its own.
            for (index, position_mm, pen_down) in &asked.path {
                self.go_on(cell, bounds, *index, *position_mm, *pen_down);
            }
        }
    }

    /// The drawing that was ordered last is not waited for any more: it was refused, or the robot stands or stops.
    pub(crate) fn forget_asked(&mut self) {
        (self.next, self.replaced) = (None, None);
    }

    /// The answers to the drawings that were ordered last were lost. The robot may draw them or the one before: all are
    /// right, and none has to be complete.
    pub(crate) fn begin_unanswered(&mut self, cell: &Cell, bounds: &Bounds) {
        for asked in [self.replaced.take(), self.next.take()].into_iter().flatten() {
            self.unanswered = Some((asked.job, asked.at));
            self.was_disturbed = true;
            for (_, position_mm, pen_down) in asked.path {
                self.append_unanswered(cell, position_mm, pen_down, bounds);
            }
        }
    }

    /// Whether the robot does what was ordered before a drawing whose answer was lost: a single motion.
    pub(crate) fn may_be_refused_at(&self, bounds: &Bounds, tool: &Vector, more_mm: f64) -> bool {
        let tolerance_mm = bounds.travel_mm + more_mm;
        let is_near = |leg: &Leg| leg.distance_squared(tool) <= tolerance_mm * tolerance_mm;
        self.unanswered.is_some() && self.singles.iter().flatten().any(|(_, leg)| is_near(leg))
    }

    /// The path of the drawing whose answer was lost goes on to a vertex.
    fn append_unanswered(&mut self, cell: &Cell, to: Vector, pen_down: bool, bounds: &Bounds) {
        let Some((job, end)) = self.unanswered else { return };
        let present = std::mem::replace(&mut self.end, end);
        self.append(cell, to, pen_down, bounds);
        self.unanswered = Some((job, self.end));
        self.end = present;
    }

    /// A drawing was accepted and begins.
    fn begin(&mut self, cell: &Cell, bounds: &Bounds, asked: Asked) {
        (self.job, self.unanswered) = (Some(asked.job), None);
        (self.end, self.astray_mm) = (asked.at, asked.astray_mm);
        self.legs.clear();
        self.grid.clear();
        self.long.clear();
        self.ink.clear();
        asked.ink.iter().for_each(|[x, y]| self.ink.add(*x, *y));
        (self.vertices, self.limit, self.cursor) = (0, u32::MAX, 0);
        (self.is_too_much, self.was_disturbed, self.is_told) = (false, false, false);
        for (index, position_mm, pen_down) in asked.path {
            self.go_on(cell, bounds, index, position_mm, pen_down);
        }
    }

    /// The path goes on to a vertex; one that repeats an earlier one is ignored.
    fn go_on(&mut self, cell: &Cell, bounds: &Bounds, index: u32, position_mm: Vector, pen_down: bool) {
        if index < self.vertices {
            return;
        }
        self.vertices = index.saturating_add(1);
        if index == 0 && !pen_down {
            self.lift_first(cell, bounds);
        }
        self.append(cell, position_mm, pen_down, bounds);
    }

    fn order_single(&mut self, cell: &Cell, command: Command, tool: Option<Vector>, to: Vector, bounds: &Bounds) {
        let Some(from) = tool.filter(|_| is_finite(&to)) else {
            return;
        };
        // The tool may be as much lower as it follows; on a flat leg the pen then leaves the paper much later.
        let touch_mm = [from, to].map(|[x, y, _]| bounds.touch_z_mm + cell.paper.rise_mm(x, y) + cell.following_mm);
        let leg = Leg::new(from, to, false, touch_mm).in_plan(bounds.plan_z_mm);
        if let Some(single) = self.singles.get_mut(self.single) {
            *single = Some((command, leg));
        }
        self.single = (self.single + 1) % SINGLES_MAX;
    }

    /// A pen that may touch where a drawing begins is lifted first, straight up.
    fn lift_first(&mut self, cell: &Cell, bounds: &Bounds) {
        let touches = |[x, y, z]: &Vector| *z <= bounds.touch_z_mm + cell.paper.rise_mm(*x, *y);
        if let Some([x, y, z]) = self.end.filter(touches) {
            let up_mm = cell.paper.pen_down_z_mm + cell.paper.rise_mm(x, y) + cell.paper.pen_lift_mm;
            self.append(cell, [x, y, up_mm.max(z)], false, bounds);
        }
    }

    fn append(&mut self, cell: &Cell, to: Vector, pen_down: bool, bounds: &Bounds) {
        let Some(from) = self.end.or(Some(to)).filter(|_| is_finite(&to)) else {
            return;
        };
        (self.end, self.end_off_mm) = (Some(to), f64::INFINITY);
        let Ok(number) = u32::try_from(self.legs.len()) else {
            return;
        };
        let touch_mm = [from, to].map(|[x, y, _]| bounds.touch_z_mm + cell.paper.rise_mm(x, y));
        self.legs
            .push(Leg::new(from, to, pen_down, touch_mm).in_plan(bounds.plan_z_mm));
        let half_cells = (to[0] - from[0]).hypot(to[1] - from[1]) / (0.5 * CELL_MM);
        if half_cells.is_nan() || half_cells >= LONG_HALF_CELLS {
            self.is_too_much |= self.long.len() >= LONG_MAX;
            if !self.is_too_much {
                self.long.push(number);
            }
            return;
        }
        let steps = half_cells.ceil().max(1.0);
        let mut last = None;
        for step in 0..=steps as u32 {
            let [x, y, _] = self.legs.last().map_or(to, |leg| leg.at(f64::from(step) / steps));
            let cell = self.grid.cell(x, y);
            if last != Some(cell) {
                self.grid.insert(cell, number);
                last = Some(cell);
            }
        }
    }

    /// Numbers of the legs around the last one.
    fn around(&self) -> std::ops::Range<usize> {
        self.cursor.saturating_sub(BEFORE)..(self.cursor + AFTER).min(self.legs.len())
    }

    /// Whether any leg within a distance satisfies a condition: first those around the last one, then all others.
    #[inline]
    fn any_leg(&self, tool: &Vector, distance_mm: f64, mut is_wanted: impl FnMut(usize, &Leg) -> bool) -> bool {
        let mut wanted = |number: usize| self.legs.get(number).is_some_and(|leg| is_wanted(number, leg));
        self.around().any(&mut wanted)
            || self.long.iter().any(|number| wanted(*number as usize))
            || self
                .grid
                .any_near(tool[0], tool[1], distance_mm + 0.25 * CELL_MM, |number| {
                    wanted(number as usize)
                })
    }

    /// Takes where the tool is, for [`Self::short_of_end`].
    pub(crate) fn approach(&mut self, tool: &Vector) {
        if let Some(leg) = self.legs.last() {
            self.end_off_mm = self.end_off_mm.min(length(subtract(*tool, leg.to)));
        }
    }

    /// How near the tool has come to the end of the path, mm, if it was never within a distance of it. `None` too where that
    /// cannot be known.
    pub(crate) fn short_of_end(&self, distance_mm: f64) -> Option<f64> {
        let is_known = !self.was_disturbed && !self.is_too_much && self.limit == u32::MAX && !self.legs.is_empty();
        Some(self.end_off_mm).filter(|off_mm| is_known && *off_mm > distance_mm)
    }

    /// Finds the tool on the path; `more_mm` widens the tolerances.
    pub(crate) fn locate(&mut self, cell: &Cell, bounds: &Bounds, tool: &Vector, more_mm: f64) -> Place {
        for asked in [&mut self.next, &mut self.replaced].into_iter().flatten() {
            asked.astray_mm = asked.astray_mm.max(more_mm);
        }
        let mut off_squared = f64::INFINITY;
        let mut found = self.cursor;
        let astray_mm = more_mm.max(self.astray_mm);
        let tolerance = |number: usize, leg: &Leg| {
            let more_mm = if number == 0 { astray_mm } else { more_mm };
            more_mm
                + if leg.pen_down {
                    bounds.drawn_mm
                } else {
                    bounds.travel_mm
                }
        };
        let widest_mm = astray_mm + bounds.travel_mm.max(bounds.drawn_mm);
        let is_on_leg = self.any_leg(tool, widest_mm, |number, leg| {
            let squared = leg.distance_squared(tool);
            off_squared = off_squared.min(squared);
            let tolerance = tolerance(number, leg);
            let is_near = squared <= tolerance * tolerance;
            if is_near {
                found = number;
            }
            is_near
        });
        // Between two parts of a drawing the pen is lifted and lowered above the path.
        let lift_mm = cell.paper.pen_lift_mm;
        let is_on_path = is_on_leg
            || self.legs.is_empty()
            || self.is_too_much
            || self.any_leg(tool, widest_mm, |number, leg| {
                leg.is_lifted(tool, lift_mm, tolerance(number, leg))
            });
        self.cursor = found;
        Place {
            is_on_path,
            off_mm: off_squared.sqrt(),
            draws: is_on_leg && self.legs.get(found).is_some_and(|leg| leg.pen_down) && self.is_far_from_travel(tool),
        }
    }

    fn is_far_from_travel(&self, tool: &Vector) -> bool {
        let is_far = |leg: &Leg| leg.pen_down || leg.distance_squared(tool) > TRAVEL_NEAR_MM * TRAVEL_NEAR_MM;
        self.legs.get(self.around()).is_some_and(|legs| legs.iter().all(is_far))
    }

    /// Whether the pen was ordered to touch within a distance of where the tool is.
    pub(crate) fn may_touch(&self, bounds: &Bounds, tool: &Vector, more_mm: f64) -> bool {
        let near = |leg: &Leg| {
            let tolerance = more_mm
                + if leg.pen_down {
                    bounds.drawn_mm
                } else {
                    bounds.travel_mm
                };
            leg.touch_distance_squared(tool) <= tolerance * tolerance
        };
        let widest_mm = more_mm + bounds.travel_mm.max(bounds.drawn_mm);
        // The answer to an order that the robot carries out already may be on its way.
        self.is_too_much
            || self.next.is_some()
            || self.any_leg(tool, widest_mm, |_, leg| near(leg))
            || self.singles.iter().flatten().any(|(_, leg)| near(leg))
    }

    /// Whether a leg with the pen down, or one on which the pen is lowered or lifted, is within a distance of the tool in
    /// plan view; legs around the last one are looked at first.
    pub(crate) fn has_line_within(&self, tool: &Vector, distance_mm: f64) -> bool {
        let squared = distance_mm * distance_mm;
        self.is_too_much || self.any_leg(tool, distance_mm, |_, leg| leg.touch_distance_squared(tool) <= squared)
    }

    /// Adds the ink of this millisecond.
    pub(crate) fn add_ink(&mut self, tool: &Vector) {
        let [x, y, _] = *tool;
        self.ink.add(x, y);
        for asked in [&mut self.next, &mut self.replaced].into_iter().flatten() {
            asked.ink.push([x, y]);
        }
    }

    /// The first place of a leg with the pen down that has no ink within a distance, if more than a share of all places
    /// has none; where that share is above 0, dots are not judged.
    pub(crate) fn missing(&self, distance_mm: f64, part_max: f64) -> Option<Vector> {
        if self.was_disturbed || self.is_too_much {
            return None;
        }
        let (mut places, mut missing, mut first) = (0_u32, 0_u32, None);
        let legs = self.legs.iter().take(self.limit as usize);
        for leg in legs.filter(|leg| leg.pen_down && leg.touches()) {
            let length_mm = (leg.to[0] - leg.from[0]).hypot(leg.to[1] - leg.from[1]);
            // A leg that is too long for the grid is too long for the sheet.
            if length_mm.is_nan() || length_mm >= LONG_HALF_CELLS * 0.5 * CELL_MM {
                continue;
            }
            // Where a share may be missing, a dot may be.
            if part_max > 0.0 && length_mm < STEP_MM {
                continue;
            }
            let steps = (length_mm / STEP_MM).ceil().max(1.0);
            for step in 0..=steps as u32 {
                let place = leg.at(f64::from(step) / steps);
                if leg.touch_distance_squared(&place) > f64::EPSILON {
                    continue;
                }
                places += 1;
                if !self.ink.covers(place[0], place[1], distance_mm) {
                    missing += 1;
                    first = first.or(Some(place));
                }
            }
        }
        first.filter(|_| f64::from(missing) > part_max * f64::from(places))
    }
}

/// Whether an order of this number waits for its answer.
fn is_of(asked: &Option<Asked>, job: u16) -> bool {
    asked.as_ref().is_some_and(|asked| asked.job == job)
}

#[cfg(test)]
mod tests;
