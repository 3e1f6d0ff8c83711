//! The trajectory task: every 12 ms it plans and fills the ring with the next setpoints.
//!
//! Released by every twelfth sample, below the critical tasks. It keeps at least one complete period of setpoints ahead
//! of the sampler, so a release may take up to its deadline. Every committed plan ends at rest, so the robot comes to
//! rest if a release never comes.

use crate::control::sampler::Queued;
use etherpen_motion::robots::JointAngles;
use etherpen_motion::{MotionCommand, MotionState, PERIOD_MS, Settings, Trajectory, Vertex};
use heapless::spsc::{Consumer, Producer};

/// An order to the trajectory task.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // a handful, in static memory
pub enum MotionOrder {
    /// Use these settings; discards everything planned.
    Configure(Settings),
    /// Start at rest from this pose; the setpoints carry the epoch.
    Place {
        /// The pose.
        pose: JointAngles,
        /// Number of this start.
        epoch: u8,
    },
    /// Begin a path; discards the rest of an earlier one.
    BeginPath,
    /// Discard the path; the drives are stopping by themselves.
    Abandon,
    /// A command to the trajectory.
    Command(MotionCommand),
}

impl MotionOrder {
    /// Whether [`MotionReport::orders`] counts the order. An override moves nothing, so nothing waits for it.
    pub(crate) fn is_counted(&self) -> bool {
        !matches!(self, Self::Command(MotionCommand::Override(_)))
    }
}

/// An item of the path for the trajectory task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathItem {
    /// An admitted vertex.
    Vertex(Vertex),
    /// End of the path.
    End,
}

/// State of the trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotionReport {
    /// At rest with nothing left to do.
    pub idle: bool,
    /// At rest on a held path.
    pub held: bool,
    /// Vertices of the path fully executed.
    pub executed: u32,
    /// Whether the path was executed to its end.
    pub finished: bool,
    /// How long a motion that should progress has made no progress, ms; 0 if none has stalled.
    pub stalled_ms: u16,
    /// Times the path ran out of data.
    pub starvations: u32,
    /// Releases that found the ring empty: the previous release was too late.
    pub overruns: u32,
    /// Number of orders taken so far, without overrides; a report reflects the orders that it counts.
    pub orders: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PathPhase {
    /// There is no path.
    None,
    /// Collecting vertices; at rest.
    Gathering,
    /// The path is being executed and more vertices may come.
    Running,
    /// All vertices have arrived.
    Complete,
    /// The path was executed to its end.
    Finished,
}

/// The 12 ms task.
pub struct TrajectoryTask<'a> {
    /// Reconfigured in place.
    trajectory: &'a mut Trajectory,
    /// Whether a valid configuration has been taken.
    configured: bool,
    orders: Consumer<'a, MotionOrder>,
    vertices: Consumer<'a, PathItem>,
    setpoints: Producer<'a, Queued>,
    reports: Producer<'a, MotionReport>,
    epoch: Option<u8>,
    filled: bool,
    path: PathPhase,
    /// Whether the path that was begun last has started; before that, the trajectory counts what another one has executed.
    has_started: bool,
    /// Whether a hold arrived before the path began to move.
    held_before_start: bool,
    overruns: u32,
    orders_taken: u32,
}

impl<'a> TrajectoryTask<'a> {
    /// A task without a pose; it produces nothing until it is placed.
    pub fn new(
        trajectory: &'a mut Trajectory,
        orders: Consumer<'a, MotionOrder>,
        vertices: Consumer<'a, PathItem>,
        setpoints: Producer<'a, Queued>,
        reports: Producer<'a, MotionReport>,
    ) -> Self {
        Self {
            trajectory,
            configured: false,
            orders,
            vertices,
            setpoints,
            reports,
            epoch: None,
            filled: false,
            path: PathPhase::None,
            has_started: false,
            held_before_start: false,
            overruns: 0,
            orders_taken: 0,
        }
    }

    /// One release.
    pub fn release(&mut self) {
        while let Some(order) = self.orders.dequeue() {
            self.orders_taken = self.orders_taken.wrapping_add(u32::from(order.is_counted()));
            self.take_order(order);
        }
        if !self.configured {
            return;
        }
        let trajectory = &mut *self.trajectory;
        if !self.held_before_start {
            self.path = take_vertices(trajectory, &mut self.vertices, self.path);
        }
        self.has_started |= matches!(self.path, PathPhase::Running | PathPhase::Complete);
        if let Some(epoch) = self.epoch {
            self.overruns += u32::from(self.filled && self.setpoints.is_empty());
            self.filled = true;
            while self.setpoints.len() <= PERIOD_MS {
                for setpoint in trajectory.step() {
                    // There is room: the ring holds more than three periods.
                    let _ = self.setpoints.enqueue(Queued { epoch, setpoint });
                }
            }
        }
        let state = trajectory.state();
        if state == MotionState::Idle && self.path == PathPhase::Complete {
            self.path = PathPhase::Finished;
        }
        let path_pending = matches!(
            self.path,
            PathPhase::Gathering | PathPhase::Running | PathPhase::Complete
        );
        let report = MotionReport {
            idle: state == MotionState::Idle && !path_pending,
            held: state == MotionState::Held || self.held_before_start,
            executed: if self.has_started { trajectory.executed() } else { 0 },
            finished: self.path == PathPhase::Finished,
            // Without a pose no motion is expected.
            stalled_ms: self
                .epoch
                .map_or(0, |_| u16::try_from(trajectory.stalled_ms()).unwrap_or(u16::MAX)),
            starvations: trajectory.underruns(),
            overruns: self.overruns,
            orders: self.orders_taken,
        };
        // A report that finds no room is followed by a newer one 12 ms later.
        let _ = self.reports.enqueue(report);
    }

    fn take_order(&mut self, order: MotionOrder) {
        match order {
            MotionOrder::Configure(settings) => {
                // The coordinator has already refused invalid geometries.
                self.configured = self.trajectory.reconfigure(&settings).is_ok();
                self.epoch = None;
                self.drop_path();
            }
            MotionOrder::Place { pose, epoch } => {
                let placed = self.configured && self.trajectory.place(pose);
                self.epoch = placed.then_some(epoch);
                self.filled = false;
            }
            MotionOrder::BeginPath => (self.path, self.has_started) = (PathPhase::Gathering, false),
            MotionOrder::Abandon => {
                self.epoch = None;
                self.drop_path();
            }
            MotionOrder::Command(command) => {
                match command {
                    MotionCommand::Cancel => self.drop_path(),
                    MotionCommand::Hold => self.held_before_start = self.path == PathPhase::Gathering,
                    MotionCommand::Resume => self.held_before_start = false,
                    _ => {}
                }
                if self.configured {
                    // The operating modes have admitted the command; a command that is impossible at this moment has no
                    // effect.
                    let _ = self.trajectory.command(command);
                }
            }
        }
    }

    fn drop_path(&mut self) {
        while self.vertices.dequeue().is_some() {}
        self.path = PathPhase::None;
        self.held_before_start = false;
    }
}

/// Hands vertices on while there is room; starts the path when the window is full or the path complete.
fn take_vertices(trajectory: &mut Trajectory, vertices: &mut Consumer<'_, PathItem>, mut path: PathPhase) -> PathPhase {
    while matches!(path, PathPhase::Gathering | PathPhase::Running) {
        if trajectory.free() == 0 {
            if path == PathPhase::Gathering && trajectory.command(MotionCommand::Start).is_err() {
                return PathPhase::None;
            }
            return PathPhase::Running;
        }
        match vertices.dequeue() {
            // There is room, and only finite vertices are admitted.
            Some(PathItem::Vertex(vertex)) => drop(trajectory.push(vertex)),
            Some(PathItem::End) => {
                trajectory.finish();
                if path == PathPhase::Gathering && trajectory.command(MotionCommand::Start).is_err() {
                    return PathPhase::None;
                }
                path = PathPhase::Complete;
            }
            None => break,
        }
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::control::sampler::Queued;
    use etherpen_motion::Pen;
    use etherpen_motion::robots::{Kinematics, Position};
    use heapless::spsc::Queue;
    use std::boxed::Box;

    fn queue<T, const N: usize>() -> (Producer<'static, T>, Consumer<'static, T>) {
        Box::leak(Box::new(Queue::<T, N>::new())).split()
    }

    #[test]
    fn what_an_earlier_path_has_executed_is_not_told_of_one_that_never_started() {
        let config = Config::default();
        let kinematics = Kinematics::new(&config.geometry).expect("a robot");
        let settings = config.motion_settings();
        let trajectory = Box::leak(Box::new(Trajectory::new(&settings).expect("a robot")));
        let (mut orders, orders_out) = queue::<_, 8>();
        let (mut vertices, vertices_out) = queue::<_, 64>();
        let (setpoints_in, mut setpoints) = queue::<Queued, 64>();
        let (reports_in, mut reports) = queue::<_, 4>();
        let mut task = TrajectoryTask::new(trajectory, orders_out, vertices_out, setpoints_in, reports_in);
        let mut release = |task: &mut TrajectoryTask, reports: &mut Consumer<'static, MotionReport>| {
            task.release();
            for _ in 0..PERIOD_MS {
                let _ = setpoints.dequeue();
            }
            reports.dequeue().expect("a report")
        };
        let mut order = |order: MotionOrder| orders.enqueue(order).expect("room");
        let at = |x_mm: f64| Position {
            x_mm,
            y_mm: 0.0,
            z_mm: config.paper.pen_down_z_mm + config.paper.pen_lift_mm,
        };
        let [first, second, third] = kinematics.inverse(&at(0.0)).expect("a pose");
        let pose = JointAngles([first, second, third, 0.0]);
        order(MotionOrder::Configure(settings));
        order(MotionOrder::Place { pose, epoch: 1 });
        release(&mut task, &mut reports);
        for (from, count) in [(0, 20), (20, 30)] {
            order(MotionOrder::BeginPath);
            for number in 1..=count {
                let vertex = Vertex {
                    position: at(f64::from(from + number)),
                    pen: Pen::Up,
                    stroke: 0,
                };
                vertices.enqueue(PathItem::Vertex(vertex)).expect("room");
            }
            vertices.enqueue(PathItem::End).expect("room");
            // The path starts while the ring is still full of the rest before it.
            task.release();
            let started = reports.dequeue().expect("a report");
            assert_eq!((started.executed, started.idle), (0, false));
            let done = (0..500)
                .map(|_| release(&mut task, &mut reports))
                .find(|report| report.finished);
            assert_eq!(done.expect("it is executed").executed, count);
            task.release();
            reports.dequeue();
        }
        order(MotionOrder::BeginPath);
        assert_eq!(release(&mut task, &mut reports).executed, 0);
        order(MotionOrder::Abandon);
        assert_eq!(
            release(&mut task, &mut reports).executed,
            0,
            "the path that was dropped has executed nothing"
        );
    }
}
