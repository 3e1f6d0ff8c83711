//! A robot for tests: joints that the test moves, an operator, and the monitor that watches.

use crate::cell::Cell;
use crate::moment::{Clocks, Command, Input, Joint, Mode, Moment, Report, WireFrame};
use crate::monitor::Monitor;
use crate::robot::Robot;
use crate::vector::{Vector, add, cross, dot, length, scale, subtract};
use crate::violation::{Rule, Violation};

/// The job of a drawing.
pub(crate) const JOB: u16 = 7;
/// Acceleration of a joint that the test moves, rad/s2.
const ACCELERATION_RAD_S2: f64 = 200.0;
const TICK_S: f64 = 1.0e-3;

/// The usual cell with joints that a test moves alone, as hard as they can: the tool's acceleration is no limit.
pub(crate) fn cell() -> Cell {
    Cell {
        tool_acceleration_mm_s2: 200_000.0,
        ..Cell::default()
    }
}

/// Whether a rule is broken.
pub(crate) fn broken(result: &Result<(), Violation>, rule: Rule) -> bool {
    result.as_ref().is_err_and(|violation| violation.rule == rule)
}

/// Angles of the main axes for a position, by Newton's method.
pub(crate) fn angles(robot: &Robot, target: Vector) -> [f64; 3] {
    const STEP_RAD: f64 = 1e-6;
    let mut angles = [0.4; 3];
    for _ in 0..20 {
        let here = robot.tool(angles).expect("on the way to a position inside");
        let column = |axis: usize| {
            let mut moved = angles;
            moved[axis] += STEP_RAD;
            let there = robot.tool(moved).expect("near a position inside");
            scale(subtract(there, here), 1.0 / STEP_RAD)
        };
        let [a, b, c] = [column(0), column(1), column(2)];
        let wanted = subtract(target, here);
        let volume = dot(a, cross(b, c));
        angles[0] += dot(wanted, cross(b, c)) / volume;
        angles[1] += dot(a, cross(wanted, c)) / volume;
        angles[2] += dot(a, cross(b, wanted)) / volume;
    }
    let reached = robot.tool(angles).expect("the position");
    assert!(length(subtract(reached, target)) < 1e-9);
    angles
}

/// A robot, its operator and the monitor.
pub(crate) struct Rig {
    pub(crate) monitor: Monitor,
    cell: Cell,
    pub(crate) joints: [Joint; 4],
    time_ms: u64,
    started_ms: u64,
    /// Speed that the first joint approaches, rad/s, and how fast, rad/s2.
    wanted_rad_s: Option<(f64, f64)>,
    inputs: Vec<Input>,
    reports: Vec<Report>,
    frames: Vec<(bool, Vec<u8>)>,
    /// System times of the slaves in OP.
    pub(crate) clocks_ns: Vec<Option<u64>>,
}

impl Rig {
    /// A robot that has just been switched on.
    pub(crate) fn new() -> Self {
        Self::with(cell())
    }

    pub(crate) fn with(cell: Cell) -> Self {
        let joint = Joint {
            angle_rad: 0.3,
            ..Joint::default()
        };
        Self {
            monitor: Monitor::new(cell.clone()),
            cell,
            joints: [joint, joint, joint, Joint::default()],
            time_ms: 0,
            started_ms: 0,
            wanted_rad_s: None,
            inputs: Vec::new(),
            reports: Vec::new(),
            frames: Vec::new(),
            clocks_ns: Vec::new(),
        }
    }

    fn at(mut self, position: Vector) -> Self {
        let angles = angles(&self.cell.robot, position);
        self.joints
            .iter_mut()
            .zip(angles)
            .for_each(|(joint, angle)| joint.angle_rad = angle);
        self
    }

    pub(crate) fn at_height(self, z_mm: f64) -> Self {
        self.at([0.0, 0.0, z_mm])
    }

    fn pose(&self) -> [f64; 4] {
        self.joints.map(|joint| joint.angle_rad)
    }

    fn enabled(mut self) -> Self {
        self.input(Input::Configured);
        let pose_rad = self.pose();
        self.command(Command::HomeAt { pose_rad });
        self.report(Report::Homed(true));
        self.command(Command::Enable);
        self.power(true);
        assert_eq!(self.run(600), Ok(()));
        self.report(Report::Mode(Mode::Idle));
        assert_eq!(self.run(10), Ok(()));
        self.started_ms = self.time_ms;
        self
    }

    /// Homed, with power, at rest.
    pub(crate) fn idle() -> Self {
        Self::new().enabled()
    }

    pub(crate) fn idle_at(position: Vector) -> Self {
        Self::new().at(position).enabled()
    }

    /// With an order to move.
    pub(crate) fn in_motion(self) -> Self {
        let mut rig = self.enabled();
        rig.command(Command::Move {
            position_mm: [0.0, 0.0, -800.0],
        });
        rig.report(Report::Mode(Mode::Moving));
        assert_eq!(rig.step(), Ok(()));
        rig
    }

    pub(crate) fn moving() -> Self {
        Self::new().in_motion()
    }

    /// With an order to draw, before the path.
    pub(crate) fn drawing() -> Self {
        let mut rig = Self::idle();
        rig.draw();
        rig
    }

    fn draw(&mut self) {
        self.command(Command::Draw { job: JOB });
        self.report(Report::Mode(Mode::Drawing));
        assert_eq!(self.step(), Ok(()));
    }

    /// On the paper at the beginning of a line of 40 mm along x.
    pub(crate) fn drawing_on_paper() -> Self {
        Self::drawing_on_paper_with(Cell::default())
    }

    /// On the paper of this cell at the beginning of a line of 40 mm along x.
    pub(crate) fn drawing_on_paper_with(cell: Cell) -> Self {
        let mut rig = Self::with(cell).at([0.0, 0.0, -847.0]).enabled();
        rig.draw();
        let path = [([0.0, 0.0, -847.0], false), ([0.0, 0.0, -850.0], false)];
        let path = path
            .into_iter()
            .chain([([40.0, 0.0, -850.0], true), ([40.0, 0.0, -847.0], false)]);
        for (index, (position_mm, pen_down)) in (0..).zip(path) {
            rig.input(Input::PathVertex {
                job: JOB,
                index,
                position_mm,
                pen_down,
            });
        }
        assert_eq!(rig.go_to([0.0, 0.0, -850.0], 60), Ok(()));
        rig
    }

    pub(crate) fn input(&mut self, input: Input) {
        self.inputs.push(input);
    }

    pub(crate) fn report(&mut self, report: Report) {
        self.reports.push(report);
    }

    /// Gives a command that is accepted at once.
    pub(crate) fn command(&mut self, command: Command) {
        self.input(Input::Commanded(command));
        self.report(Report::Accepted(command));
    }

    pub(crate) fn disturb_machine(&mut self, disturbed: bool) {
        self.input(Input::Machine { disturbed });
    }

    pub(crate) fn frame(&mut self, from_master: bool, bytes: &[u8]) {
        self.frames.push((from_master, bytes.to_vec()));
    }

    pub(crate) fn power(&mut self, has_power: bool) {
        self.joints.iter_mut().for_each(|joint| joint.has_power = has_power);
    }

    /// Lets the first joint approach a speed.
    pub(crate) fn accelerate_to(&mut self, rad_s: f64) {
        self.wanted_rad_s = Some((rad_s, ACCELERATION_RAD_S2));
    }

    pub(crate) fn brake(&mut self, rad_s2: f64) {
        self.wanted_rad_s = Some((0.0, rad_s2));
    }

    pub(crate) fn time_ms(&self) -> u64 {
        self.time_ms
    }

    pub(crate) fn started_ms(&self) -> u64 {
        self.started_ms
    }

    /// Lets a millisecond pass.
    pub(crate) fn step(&mut self) -> Result<(), Violation> {
        if let Some((wanted, rad_s2)) = self.wanted_rad_s {
            let change = rad_s2 * TICK_S;
            let joint = &mut self.joints[0];
            joint.speed_rad_s += (wanted - joint.speed_rad_s).clamp(-change, change);
            joint.angle_rad += joint.speed_rad_s * TICK_S;
        }
        self.look()
    }

    fn look(&mut self) -> Result<(), Violation> {
        self.time_ms += 1;
        let [a, b, c, _] = self.pose();
        // The rig's sheet is level.
        let height = self.cell.paper.pen_down_z_mm + self.cell.paper.pen_spring_mm;
        let wire: Vec<WireFrame> = self
            .frames
            .iter()
            .map(|(from_master, bytes)| WireFrame {
                from_master: *from_master,
                bytes,
                time_ns: self.time_ms * 1_000_000,
            })
            .collect();
        let result = self.monitor.step(&Moment {
            time_ms: self.time_ms,
            joints: &self.joints,
            pen_touches: self.cell.robot.tool([a, b, c]).is_some_and(|[_, _, z]| z <= height),
            inputs: &self.inputs,
            reports: &self.reports,
            wire: &wire,
            clocks: Clocks {
                time_ns: self.time_ms * 1_000_000,
                system_ns: &self.clocks_ns,
            },
        });
        self.inputs.clear();
        self.reports.clear();
        self.frames.clear();
        result
    }

    /// Lets time pass, until a rule is broken.
    pub(crate) fn run(&mut self, ms: u32) -> Result<(), Violation> {
        (0..ms).try_for_each(|_| self.step())
    }

    /// Moves the tool in a straight line from rest to rest.
    pub(crate) fn go_to(&mut self, target: Vector, ms: u32) -> Result<(), Violation> {
        let [a, b, c, _] = self.pose();
        let from = self.cell.robot.tool([a, b, c]).expect("a tool");
        let way = subtract(target, from);
        for step in 1..=ms {
            let part = f64::from(step) / f64::from(ms);
            let there = add(from, scale(way, part * part * (3.0 - 2.0 * part)));
            for (joint, angle) in self.joints.iter_mut().zip(angles(&self.cell.robot, there)) {
                joint.speed_rad_s = (angle - joint.angle_rad) / TICK_S;
                joint.angle_rad = angle;
            }
            self.look()?;
        }
        self.joints.iter_mut().for_each(|joint| joint.speed_rad_s = 0.0);
        self.look()
    }

    /// Lets time pass unseen; the tool is at rest in another place behind it.
    pub(crate) fn miss(&mut self, target: Vector, ms: u64) {
        self.time_ms += ms;
        let angles = angles(&self.cell.robot, target);
        let joints = self.joints.iter_mut().zip(angles);
        joints.for_each(|(joint, angle)| joint.angle_rad = angle);
    }

    pub(crate) fn go_to_height(&mut self, z_mm: f64, ms: u32) -> Result<(), Violation> {
        self.go_to([0.0, 0.0, z_mm], ms)
    }

    pub(crate) fn end(&mut self) -> Result<(), Violation> {
        self.monitor.end()
    }
}
