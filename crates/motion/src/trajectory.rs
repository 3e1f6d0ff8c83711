//! The 12 ms trajectory stage: takes vertices and commands, returns the setpoints of a period.
//!
//! Vertices wait in a queue until they are shaped; the plan keeps a look-ahead over the shaped path. Everything besides
//! the path (lifting and lowering the pen, moves, jogs) is a separate motion from rest to rest. When path data stop
//! arriving the motion ends at rest on the path; that counts as an underrun if the motion had begun.
//!
//! Invariants: [`Trajectory::step`] always returns twelve valid setpoints and does a bounded amount of work; every
//! command leads from one rest to the next within the limits.

use super::admission::{LEG_MIN_MM, check_way_in};
use super::committed::Observer;
use super::delay_line::PathSample;
use super::jog::{self, Jog};
use super::limits::Limits;
use super::merging::Merger;
use super::micro_interpolator::{MicroInterpolator, Profile};
use super::pen_lift::PenLift;
use super::plan::{GROWTH, Pace, Plan};
use super::progress::Watch;
use super::ring::Ring;
use super::shaping::{Label, Node, QUEUE, Shaper};
use super::straight::Straight;
use super::work_area::WorkArea;
use super::{MotionCommand, MotionRefusal, MotionState, PERIOD_MS, Pen, Refusal, RefusalReason, Setpoint, Vertex};
use crate::robots::vector::{Vector, length, subtract};
use crate::robots::{GeometryError, JointAngles, Position};
use crate::settings::Settings;
use crate::settings::input_shaper::shaper_rest_ms;
use crate::settings::{TICK_S, averaging::averaging};

/// Most vertices queued for shaping.
pub const QUEUE_VERTICES: usize = QUEUE;
/// Bounds of the override, percent.
/// The legs of a path that has starved wait for others until no vertex has come for this long, ms.
const GATHER_MS: u32 = 240;
const OVERRIDE_PERCENT: core::ops::RangeInclusive<u8> = 10..=200;

/// What follows after the motion has come to rest on the path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Then {
    Held,
    Dropped,
    Starved,
}

/// The present motion.
#[derive(Clone, Copy, Debug)]
enum Activity {
    Rest,
    Path,
    Brake(Then),
    Lift(Straight, Then),
    Parked {
        starved: bool,
        lifted: bool,
    },
    Lower(Straight, Option<Then>),
    /// A leg of a move, and where the move leads; nowhere else once it has been ended.
    Move(Straight, Option<Vector>),
    Jog(Jog),
}

/// The trajectory stage.
#[derive(Clone, Debug)]
pub struct Trajectory {
    motion: Motion,
    interpolator: MicroInterpolator,
    pose: Option<JointAngles>,
}

/// The trajectory stage without the averaging.
#[derive(Clone, Debug)]
struct Motion {
    area: WorkArea,
    limits: Limits,
    pen: PenLift,
    starve_dwell_ms: u16,
    dead_man_ms: u16,
    /// Rest after each motion that ends, until all copies of an input shaper have come, ms, and what is left of it.
    rest_ms: u16,
    resting_ms: u16,
    queue: Ring<Node, QUEUE>,
    /// Stands before the queue.
    merger: Merger,
    shaper: Shaper,
    plan: Plan,
    activity: Activity,
    here: PathSample,
    finished: bool,
    /// Whether a vertex of the present path has arrived.
    joined: bool,
    /// Vertices pushed since the path began.
    pushed: u32,
    /// Whether the motion on the path has begun since its start.
    begun: bool,
    starving_ms: u32,
    /// Whether the legs wait for others since the path has starved.
    gathers: bool,
    /// Vertices pushed when this was last looked at, and for how long none has come since, ms.
    heard: u32,
    silent_ms: u32,
    underruns: u32,
    work: u32,
    watch: Watch,
}

impl Trajectory {
    /// A stage without a configuration, for a static: it is at rest and refuses commands. All of its bits are zero, so
    /// it takes no flash memory.
    pub const fn unconfigured() -> Self {
        Self {
            motion: Motion {
                area: WorkArea::NONE,
                limits: Limits::NONE,
                pen: PenLift::NONE,
                starve_dwell_ms: 0,
                dead_man_ms: 0,
                rest_ms: 0,
                resting_ms: 0,
                queue: Ring::new(Node::NONE),
                merger: Merger::new(),
                shaper: Shaper::new(),
                plan: Plan::new(),
                activity: Activity::Rest,
                here: PathSample::NONE,
                finished: false,
                joined: false,
                pushed: 0,
                begun: false,
                starving_ms: 0,
                gathers: false,
                heard: 0,
                silent_ms: 0,
                underruns: 0,
                work: 0,
                watch: Watch::new(),
            },
            interpolator: MicroInterpolator::new(),
            pose: None,
        }
    }

    /// A stage with the limits of a configuration and without a pose. About 64 KiB pass over the stack; a board keeps a
    /// [`Trajectory::unconfigured`] stage in a static instead.
    ///
    /// # Errors
    /// The dimensions do not form a valid robot.
    pub fn new(settings: &Settings) -> Result<Self, GeometryError> {
        let mut trajectory = Self::unconfigured();
        trajectory.reconfigure(settings)?;
        Ok(trajectory)
    }

    /// Takes a configuration in place. Discards the path, and the pose until the stage is placed again.
    ///
    /// # Errors
    /// The dimensions do not form a valid robot; nothing has changed.
    pub fn reconfigure(&mut self, settings: &Settings) -> Result<(), GeometryError> {
        let area = WorkArea::new(settings)?;
        let limits = Limits::new(settings);
        let (window_ms, _) = averaging(&settings.motion);
        let motion = &mut self.motion;
        motion.area = area;
        motion.limits = limits;
        motion.pen = PenLift::new(settings);
        motion.starve_dwell_ms = settings.motion.starve_dwell_ms;
        motion.dead_man_ms = settings.dead_man_ms;
        motion.rest_ms = shaper_rest_ms(&settings.motion);
        motion.resting_ms = 0;
        motion.merger.configure(settings);
        motion.shaper.configure(settings);
        motion.plan.reconfigure(*area.kinematics(), limits, &settings.motion);
        motion.here = PathSample::NONE;
        motion.pushed = 0;
        motion.begun = false;
        motion.underruns = 0;
        motion.work = 0;
        motion.drop_path();
        self.interpolator
            .configure(*area.kinematics(), window_ms, &settings.motion);
        self.pose = None;
        Ok(())
    }

    /// Takes the measured pose, at rest, as the start; discards any path.
    ///
    /// Returns whether the robot can have this pose and reach it again: one with a joint on the other side is another one than
    /// the planner would choose there. Without a valid pose, setpoints stay where they are and commands are refused.
    pub fn place(&mut self, pose: JointAngles) -> bool {
        self.pose = None;
        self.motion.drop_path();
        let [_, _, _, fourth_rad] = pose.0;
        if !pose.0.iter().all(|angle| angle.is_finite()) {
            return false;
        }
        self.motion.resting_ms = 0;
        self.interpolator.place(&pose);
        let kinematics = self.motion.area.kinematics();
        let Ok(position) = kinematics.forward(&pose) else {
            return false;
        };
        if kinematics.other_side(&pose, &position).is_some() {
            return false;
        }
        self.motion.here = PathSample {
            point: position.into(),
            heading: fourth_rad,
            label: Label::NONE,
        };
        self.interpolator.stand_at(&self.motion.here);
        self.motion.drop_path();
        self.motion.watch = Watch::new();
        self.pose = Some(pose);
        true
    }

    /// Number of vertices that can be pushed now.
    pub fn free(&self) -> usize {
        self.motion.room()
    }

    /// Appends a vertex to the path. A vertex that coincides with the last one is merged with it; vertices denser than
    /// the tolerance can tell are merged within a fifth of it.
    ///
    /// # Errors
    /// [`MotionRefusal::Full`], or [`MotionRefusal::Target`] for a vertex outside the work area. Its leg is checked by
    /// [`super::Admission`].
    pub fn push(&mut self, vertex: Vertex) -> Result<(), MotionRefusal> {
        self.motion.push(&vertex)
    }

    /// Marks the end of the path for now: the path may end at the last vertex.
    pub fn finish(&mut self) {
        self.motion.finished = true;
    }

    /// Carries out a command, or refuses it and changes nothing.
    ///
    /// # Errors
    /// Why the command is refused.
    pub fn command(&mut self, command: MotionCommand) -> Result<(), MotionRefusal> {
        if self.pose.is_none() {
            return Err(MotionRefusal::NotPlaced);
        }
        let state = self.state();
        self.motion.command(command, state)
    }

    /// The setpoints of the next 12 ms.
    pub fn step(&mut self) -> [Setpoint; PERIOD_MS] {
        self.step_observed(&mut ())
    }

    /// The setpoints of the next 12 ms; the observer sees the motion on the path from which they are taken.
    pub fn step_observed(&mut self, observer: &mut impl Observer) -> [Setpoint; PERIOD_MS] {
        if self.pose.is_none() {
            return self.interpolator.rest();
        }
        self.motion.feed();
        let motion = &mut self.motion;
        let setpoints = self.interpolator.step(&mut Observed { motion, observer });
        motion.watch.step(&motion.here, motion.has_to_move());
        setpoints
    }

    /// State of the stage.
    pub fn state(&self) -> MotionState {
        match &self.motion.activity {
            Activity::Rest if self.interpolator.settled() => MotionState::Idle,
            Activity::Rest => MotionState::Stopping,
            Activity::Path if self.motion.starving_ms > 0 => MotionState::Starved,
            Activity::Path => MotionState::Running,
            Activity::Brake(Then::Held) | Activity::Lift(_, Then::Held) => MotionState::Holding,
            Activity::Brake(Then::Dropped) | Activity::Lift(_, Then::Dropped) => MotionState::Stopping,
            Activity::Brake(Then::Starved) | Activity::Lift(_, Then::Starved) => MotionState::Starved,
            Activity::Parked { starved: true, .. } => MotionState::Starved,
            Activity::Parked { .. } if self.interpolator.settled() => MotionState::Held,
            Activity::Parked { .. } => MotionState::Holding,
            Activity::Lower(_, None) => MotionState::Resuming,
            Activity::Lower(_, Some(Then::Dropped)) => MotionState::Stopping,
            Activity::Lower(_, Some(_)) => MotionState::Holding,
            Activity::Move(..) => MotionState::Moving,
            Activity::Jog(_) => MotionState::Jogging,
        }
    }

    /// Vertices of the path fully executed by the end of the last period.
    pub fn executed(&self) -> u32 {
        self.motion.here.label.vertex
    }

    /// Position on the path at the end of the last period, before averaging.
    pub fn position(&self) -> Position {
        self.motion.here.point.into()
    }

    /// Underruns since start-up: how often path data did not arrive in time.
    pub fn underruns(&self) -> u32 {
        self.motion.underruns
    }

    /// How long a motion that should progress has made no progress, ms; 0 up to two seconds. A planner that stalls is
    /// an error of the firmware: the path has to be discarded.
    pub fn stalled_ms(&self) -> u32 {
        self.motion.watch.stalled_ms()
    }

    /// Effective length of the moving average, ms: the configured length, shortened if it would use more than its part
    /// of the tolerance; 0 without an average.
    pub fn jerk_window_ms(&self) -> u16 {
        self.interpolator.window_ms()
    }

    /// Points of the grid that the last step computed: new ones, and ones whose speed was recomputed.
    pub fn work(&self) -> u32 {
        self.motion.work
    }
}

impl Motion {
    fn push(&mut self, vertex: &Vertex) -> Result<(), MotionRefusal> {
        let point = Vector::from(vertex.position);
        if !self.area.contains(&vertex.position)
            && let Err(outside) = self.area.check(&vertex.position)
        {
            return Err(MotionRefusal::Target(Refusal {
                index: self.pushed,
                reason: RefusalReason::Outside(outside),
            }));
        }
        if self.room() == 0 {
            return Err(MotionRefusal::Full);
        }
        if !self.joined {
            self.joined = true;
            self.pushed = 0;
            self.here.label.vertex = 0;
            self.plan.count_from_zero();
            self.shaper.merge(0);
            if vertex.pen == Pen::Up {
                self.lift_first(vertex);
            }
        }
        self.pushed = self.pushed.saturating_add(1);
        self.finished = false;
        let count = self.pushed;
        let repeats = |other: &Vector| length(&subtract(&point, other)) < LEG_MIN_MM;
        match self.merger.last_mut().or(self.queue.last_mut()) {
            Some(last) if repeats(&last.point) => last.count = count,
            None if repeats(&self.shaper.node().point) => self.shaper.merge(count),
            _ => {
                let node = Node {
                    point,
                    pen: vertex.pen,
                    stroke: vertex.stroke,
                    count,
                    merged: false,
                };
                let last = self
                    .queue
                    .last_mut()
                    .map_or(self.shaper.node().point, |last| last.point);
                for node in self.merger.take(node, &last).into_iter().flatten() {
                    // There is room for both.
                    self.queue.push(node);
                }
            }
        }
        Ok(())
    }

    /// Number of vertices that can be pushed; the one that the merger holds has a place.
    fn room(&self) -> usize {
        self.queue.room().saturating_sub(usize::from(self.merger.holds()))
    }

    /// Lets a path begin with lifting the pen if it is near the paper: on its way to the first vertex it would leave ink. A pen
    /// of its own is also lowered at the first vertex only.
    fn lift_first(&mut self, vertex: &Vertex) {
        let from = self.plan.sample().point;
        let to = Vector::from(vertex.position);
        let [lifted, above] = self.pen.over(&self.area, &from, &to);
        let is_free = |to: &Vector| check_way_in(&self.area, &lifted.unwrap_or(from).into(), &(*to).into()).is_ok();
        // Where the way at the height of a lifted pen is not free, it goes down on its way to the first vertex.
        let above = above.filter(|above| self.area.keeps_within(&(*above).into(), &to.into()) && is_free(above));
        if above.is_none() && !is_free(&to) {
            return;
        }
        // A path begins with an empty queue.
        for point in [lifted, above].into_iter().flatten() {
            self.queue.push(Node {
                point,
                pen: Pen::Up,
                stroke: vertex.stroke,
                count: 0,
                merged: false,
            });
        }
    }

    /// Whether progress is required now: the motion is not at rest, does not wait for path data, does not pause at a
    /// stop and is not a jog.
    fn has_to_move(&self) -> bool {
        match self.activity {
            Activity::Rest | Activity::Parked { .. } | Activity::Jog(_) => false,
            Activity::Path => self.starving_ms == 0 && !self.plan.pauses(),
            Activity::Brake(_) => !self.plan.pauses(),
            Activity::Lift(..) | Activity::Lower(..) | Activity::Move(..) => true,
        }
    }

    fn is_empty(&self) -> bool {
        self.queue.length() == 0 && !self.merger.holds() && self.plan.exhausted()
    }

    /// Shapes the vertices that have arrived, grows the grid, looks back, and detects starvation.
    fn feed(&mut self) {
        if self.finished
            && let Some(node) = self.merger.release()
        {
            self.queue.push(node);
        }
        // Every leg adds at least one interval to the grid, so more legs would only wait for the grid.
        let growth = if self.still_gathers() { 0 } else { GROWTH };
        for _ in 0..growth {
            if !self.plan.has_room() {
                break;
            }
            let Some(pieces) = self.shaper.next_leg(&mut self.queue, self.finished) else {
                break;
            };
            for piece in pieces {
                self.plan.push(piece);
            }
        }
        let grown = self.plan.grow();
        let computed = self.plan.look_back();
        self.work = (grown + computed) as u32;
        let waits = !(self.plan.can_go() || self.finished && self.is_empty());
        match self.activity {
            Activity::Path if self.plan.resting() && waits => self.starve(),
            Activity::Path => self.starving_ms = 0,
            Activity::Parked { starved: true, lifted } if !waits => self.return_to_path(lifted),
            _ => {}
        }
    }

    /// Whether the legs still wait for others after the path has starved: until the queue is full, the path complete, or
    /// nothing more comes. A link that is slower than the path would otherwise give one leg at a time, with a stop of the
    /// lowered pen after each.
    fn still_gathers(&mut self) -> bool {
        self.silent_ms = match self.heard == self.pushed {
            true => self.silent_ms.saturating_add(PERIOD_MS as u32),
            false => 0,
        };
        self.heard = self.pushed;
        self.gathers &= !self.finished && self.room() > 0 && self.silent_ms < GATHER_MS;
        self.gathers
    }

    fn starve(&mut self) {
        if self.starving_ms == 0 && self.begun {
            self.underruns = self.underruns.saturating_add(1);
            (self.gathers, self.silent_ms) = (true, 0);
        }
        self.starving_ms = self.starving_ms.saturating_add(PERIOD_MS as u32);
        if self.starving_ms > u32::from(self.starve_dwell_ms) && self.has_to_lift() {
            self.leave_path(Then::Starved);
        }
    }

    fn command(&mut self, command: MotionCommand, state: MotionState) -> Result<(), MotionRefusal> {
        let refused = Err(MotionRefusal::State(state));
        match (command, self.activity) {
            (MotionCommand::Start, Activity::Rest) => {
                self.activity = Activity::Path;
                self.begun = false;
                self.starving_ms = 0;
                Ok(())
            }
            (MotionCommand::Hold, _) => self.stop(Then::Held).ok_or(MotionRefusal::State(state)),
            (MotionCommand::Cancel, _) => self.stop(Then::Dropped).ok_or(MotionRefusal::State(state)),
            (MotionCommand::Resume, _) => self.resume().ok_or(MotionRefusal::State(state)),
            (MotionCommand::Override(percent), _) => {
                if !OVERRIDE_PERCENT.contains(&percent) {
                    return Err(MotionRefusal::Override { percent });
                }
                self.plan.scale_speed(f64::from(percent) / 100.0);
                Ok(())
            }
            (MotionCommand::MoveTo(position), Activity::Rest) if self.is_empty() => self.move_to(position, Pen::Up),
            (MotionCommand::Pen(pen), Activity::Rest) if self.is_empty() => {
                let here = &self.here.point;
                let mut position = Position::from(*here);
                position.z_mm = match pen {
                    Pen::Down => self.area.paper().z_at_mm(position.x_mm, position.y_mm),
                    Pen::Up => self.pen.up_mm(&self.area, here),
                };
                self.move_to(position, pen)
            }
            (MotionCommand::Jog(velocity), Activity::Rest | Activity::Jog(_)) if self.is_empty() => {
                if !velocity.iter().all(|value| value.is_finite()) {
                    return Err(MotionRefusal::Target(Refusal {
                        index: 0,
                        reason: RefusalReason::NotFinite,
                    }));
                }
                if !matches!(self.activity, Activity::Jog(_)) {
                    jog::check(&self.area, &self.here.point, &velocity).map_err(|outside| {
                        MotionRefusal::Target(Refusal {
                            index: 0,
                            reason: RefusalReason::Outside(outside),
                        })
                    })?;
                    self.activity = Activity::Jog(Jog::new(&self.here));
                }
                if let Activity::Jog(jog) = &mut self.activity {
                    jog.want(&velocity);
                }
                Ok(())
            }
            (MotionCommand::JogStop, Activity::Jog(_)) => {
                self.stop(Then::Dropped);
                Ok(())
            }
            (MotionCommand::JogStop, Activity::Rest) => Ok(()),
            (_, Activity::Rest) => Err(MotionRefusal::PathPending),
            _ => refused,
        }
    }

    fn move_to(&mut self, position: Position, pen: Pen) -> Result<(), MotionRefusal> {
        let target = |reason| MotionRefusal::Target(Refusal { index: 0, reason });
        self.area
            .check(&position)
            .map_err(|outside| target(RefusalReason::Outside(outside)))?;
        let goal = Vector::from(position);
        let [lifted, above] = self.pen.over_in_move(&self.area, &self.here.point, &goal);
        let mut from = lifted.unwrap_or(self.here.point);
        for to in above.into_iter().chain([goal]) {
            check_way_in(&self.area, &from.into(), &to.into())
                .map_err(|(at, outside)| target(RefusalReason::Leg { at, outside }))?;
            from = to;
        }
        let label = Label { pen, ..self.here.label };
        self.move_on(goal, label);
        Ok(())
    }

    /// Begins the next leg of a move.
    fn move_on(&mut self, goal: Vector, label: Label) {
        let [lifted, above] = self.pen.over_in_move(&self.area, &self.here.point, &goal);
        let to = lifted.or(above).unwrap_or(goal);
        self.activity = Activity::Move(self.straight(&to, label), Some(goal));
    }

    /// Goes on after a leg of a move: to its goal if that is elsewhere. A move that has been ended leaves the pen up.
    fn end_leg(&mut self, goal: Option<Vector>) {
        let label = self.here.label;
        let is_elsewhere = |goal: &Vector| length(&subtract(goal, &self.here.point)) >= LEG_MIN_MM;
        if let Some(goal) = goal {
            if is_elsewhere(&goal) {
                self.move_on(goal, label);
            } else {
                self.drop_path();
            }
            return;
        }
        match self.pen.lifted_after_move(&self.area, &self.here.point) {
            Some(above) => {
                let label = Label { pen: Pen::Up, ..label };
                self.activity = Activity::Move(self.straight(&above, label), None);
            }
            None => self.drop_path(),
        }
    }

    fn straight(&self, to: &Vector, label: Label) -> Straight {
        Straight::new(self.area.kinematics(), &self.limits, &self.here, to, label)
    }

    /// Ends the present motion; `None` where there is nothing to end.
    fn stop(&mut self, then: Then) -> Option<()> {
        match &mut self.activity {
            Activity::Rest if then == Then::Held => return None,
            Activity::Rest => self.drop_path(),
            Activity::Path => self.activity = Activity::Brake(then),
            Activity::Brake(planned) | Activity::Lift(_, planned) => {
                if *planned != Then::Dropped {
                    *planned = then;
                }
            }
            Activity::Parked { .. } if then == Then::Dropped => self.drop_path(),
            Activity::Parked { starved, .. } => *starved = false,
            Activity::Lower(lower, next) => {
                lower.brake();
                if *next != Some(Then::Dropped) {
                    *next = Some(then);
                }
            }
            Activity::Move(straight, goal) => {
                straight.brake();
                *goal = None;
            }
            Activity::Jog(jog) => jog.want(&[0.0; 3]),
        }
        Some(())
    }

    fn resume(&mut self) -> Option<()> {
        match &mut self.activity {
            Activity::Brake(Then::Held) => self.activity = Activity::Path,
            // The lift is completed; then the path continues as after starvation.
            Activity::Lift(_, then @ Then::Held) => *then = Then::Starved,
            Activity::Parked { starved: false, lifted } => {
                let lifted = *lifted;
                self.return_to_path(lifted);
            }
            // The pen is lifted again, as far as it was lowered; then the path continues as after starvation.
            Activity::Lower(_, next @ Some(Then::Held)) => *next = Some(Then::Starved),
            _ => return None,
        }
        Some(())
    }

    /// Discards the path and stays at the present position; only called at rest.
    fn drop_path(&mut self) {
        self.queue.clear();
        self.merger.release();
        self.finished = false;
        self.activity = Activity::Rest;
        self.settle();
    }

    /// Lets the next path begin at the present position at rest.
    fn settle(&mut self) {
        self.joined = false;
        self.plan.rest_at(self.here);
        self.shaper.place(Node {
            point: self.here.point,
            count: self.here.label.vertex,
            ..Node::NONE
        });
    }

    /// Whether a rest on the path leaves the pen on the paper or near it.
    fn has_to_lift(&self) -> bool {
        self.here.label.pen == Pen::Down || self.pen.is_low(&self.area, &self.here.point)
    }

    /// Leaves the path from a rest: lifts the pen if it is down.
    fn leave_path(&mut self, then: Then) {
        let lifted = self
            .has_to_lift()
            .then(|| self.pen.lifted(&self.area, &self.here.point));
        if let Some(above) = lifted.flatten() {
            let label = Label {
                pen: Pen::Up,
                ..self.here.label
            };
            self.activity = Activity::Lift(self.straight(&above, label), then);
        } else {
            self.park(then, false);
        }
    }

    fn park(&mut self, then: Then, lifted: bool) {
        match then {
            Then::Dropped => self.drop_path(),
            Then::Held | Then::Starved => {
                self.activity = Activity::Parked {
                    starved: then == Then::Starved,
                    lifted,
                };
            }
        }
    }

    fn return_to_path(&mut self, lifted: bool) {
        self.starving_ms = 0;
        self.activity = if lifted {
            let to = self.plan.sample().point;
            let lower = self.straight(&to, self.here.label);
            Activity::Lower(lower, None)
        } else {
            Activity::Path
        };
    }

    fn follow(&mut self, observer: &mut impl Observer) -> PathSample {
        let before = self.here.point;
        let sample = self.plan.advance(TICK_S, Pace::Go, observer);
        self.begun |= sample.point != before;
        if self.finished && self.is_empty() {
            self.here = sample;
            self.here.label.vertex = self.pushed;
            self.activity = Activity::Rest;
            self.settle();
            return self.here;
        }
        sample
    }

    fn next_millisecond(&mut self, observer: &mut impl Observer) -> PathSample {
        observer.millisecond();
        if self.resting_ms > 0 {
            self.resting_ms -= 1;
            return self.here;
        }
        let (sample, done) = match &mut self.activity {
            Activity::Rest | Activity::Parked { .. } => (self.here, false),
            Activity::Path => (self.follow(observer), false),
            Activity::Brake(_) => {
                let sample = self.plan.advance(TICK_S, Pace::Brake, observer);
                (sample, self.plan.resting())
            }
            Activity::Lift(straight, _) | Activity::Lower(straight, _) | Activity::Move(straight, _) => {
                straight.next_millisecond()
            }
            Activity::Jog(jog) => jog.next_millisecond(&self.area, &self.limits, self.dead_man_ms),
        };
        self.here = sample;
        if done {
            self.resting_ms = self.rest_ms;
            match self.activity {
                Activity::Brake(then) => self.leave_path(then),
                Activity::Lift(_, then) => self.park(then, true),
                Activity::Lower(_, None) => {
                    self.here.label = self.plan.sample().label;
                    self.activity = Activity::Path;
                }
                // The hold came before the pen was down: back to where it was lifted to.
                Activity::Lower(lower, Some(then)) => {
                    let lift = self.straight(lower.from(), self.here.label);
                    self.activity = Activity::Lift(lift, then);
                }
                Activity::Move(_, goal) => self.end_leg(goal),
                Activity::Jog(_) => self.drop_path(),
                Activity::Rest | Activity::Path | Activity::Parked { .. } => {}
            }
        }
        sample
    }
}

/// A motion, and who sees what is executed.
struct Observed<'a, O> {
    motion: &'a mut Motion,
    observer: &'a mut O,
}

impl<O: Observer> Profile for Observed<'_, O> {
    fn next_millisecond(&mut self) -> PathSample {
        self.motion.next_millisecond(self.observer)
    }
}
