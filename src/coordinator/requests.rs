//! Requests of the host to the coordinator: configuration, commands, path, bus and measurements.

use super::{Coordinator, PathProgress};
use crate::application::homing::{HomingCheck, positions_arrive};
use crate::application::{ACTIONS_MAX, Command, Mode, Refusal};
use crate::config::Config;
use crate::control::sampler::SamplerCommand;
use crate::ethercat::diagnostics::{ServiceError, ServiceRequest};
use crate::ethercat::event::BusCommand;
use crate::measurement::{MeasurementAnswer, MeasurementRequest};
use crate::messages::{ConfigRefusal, PathVertex};
use crate::motion::{self, Admission, Vertex};
use crate::robots::{AXES, Position};
use crate::trajectory_task::{MotionOrder, MotionReport, PathItem};

/// Queue entries for the trajectory and the sampler that commands leave free: reserved for a stop and for orders that
/// the operating modes issue by themselves.
const ORDERS_KEPT_FREE: usize = ACTIONS_MAX;

impl Coordinator<'_> {
    /// Checks a configuration, passes it to the other tasks and brings the bus up. Returns the configuration's hash.
    ///
    /// # Errors
    /// Why it was refused; the previous configuration stays in force.
    pub fn configure(&mut self, config: &Config) -> Result<u64, ConfigRefusal> {
        config.check()?;
        config.check_io()?;
        let hash = config.hash().unwrap_or_default();
        if self.config_hash == Some(hash) {
            return Ok(hash);
        }
        if !self.application.may_configure() {
            return Err(ConfigRefusal::NotInMode(self.application.mode()));
        }
        self.admission = Some(Admission::new(&config.motion_settings())?);
        self.pen_heights_mm = config.pen_heights_mm();
        self.homing_check = Some(HomingCheck::new(config));
        self.config_hash = Some(hash);
        self.slaves.clear();
        // An axis without a drive has no place.
        let used = usize::from(config.bus.drives);
        self.places = core::array::from_fn(|axis| if axis < used { axis as u8 } else { u8::MAX });
        self.application
            .configured(config.bus.host_silence_ms, config.has_home_switches());
        self.tell_sampler(SamplerCommand::Configure {
            axes: config.controlled_axes(),
            bus: config.bus.clone(),
        });
        self.configure_io(config);
        self.tell_trajectory(MotionOrder::Configure(config.motion_settings()));
        // The network task empties the queue every millisecond.
        let _ = self.ends.network.enqueue(config.bus.network());
        self.recovery_due = false;
        // There is room, see `instruct_supervisor`.
        let _ = self.ends.bus.commands.enqueue(BusCommand::Start(config.bus_setup()));
        Ok(hash)
    }

    /// Carries out a command.
    ///
    /// # Errors
    /// Why it was refused; nothing has changed.
    pub fn command(&mut self, command: Command) -> Result<(), Refusal> {
        let (orders, demands) = (&self.ends.motion_orders, &self.ends.sampler_commands);
        let room = (orders.capacity() - orders.len()).min(demands.capacity() - demands.len());
        if room < ORDERS_KEPT_FREE && command != Command::Stop {
            return Err(Refusal::Busy);
        }
        if let Command::SetOutput { io, value } = command
            && self.application.may_set_outputs()
        {
            self.io.check(io, value)?;
        }
        if command == Command::Acknowledge && self.brings_terminals_back() {
            self.recovery_due = true;
            return Ok(());
        }
        let command = match (command, self.pen_heights_mm) {
            (Command::Move { position }, Some(heights_mm)) => Command::Move {
                position: up_or_down(position, heights_mm),
            },
            (other, _) => other,
        };
        self.check_side(command)?;
        self.check_target(command)?;
        self.check_homing(command)?;
        self.application.command(command)?;
        if let Command::Draw { .. } = command {
            self.vertices_admitted = 0;
            if let Some(admission) = &mut self.admission {
                admission.restart_at(&self.condition.pose);
            }
            self.motion = MotionReport::default();
        }
        self.carry_out_all();
        if let Command::Draw { .. } = command {
            self.path_orders = self.orders_sent;
        }
        Ok(())
    }

    /// Checks, before power or a motion is taken, that the planner can begin where the robot stands: without power its links can
    /// be pushed where no motion leads.
    fn check_side(&self, command: Command) -> Result<(), Refusal> {
        let begins = match self.application.mode() {
            Mode::DrivesOff => command == Command::Enable,
            Mode::Idle => matches!(
                command,
                Command::Draw { .. } | Command::Move { .. } | Command::Pen { .. } | Command::Jog { .. }
            ),
            _ => false,
        };
        // The pose of a robot that is not referenced is not known.
        let admission = self
            .admission
            .as_ref()
            .filter(|_| begins && self.condition.unreferenced.is_none());
        admission.map_or(Ok(()), |admission| {
            admission
                .check_side(&self.condition.pose)
                .map_err(|side| Refusal::OtherSide {
                    axis: side.joint,
                    angle_rad: side.angle_rad as f32,
                    planned_rad: side.planned_rad as f32,
                })
        })
    }

    /// Checks that a single motion has a target inside the work area, or leads into the area.
    fn check_target(&mut self, command: Command) -> Result<(), Refusal> {
        let moves = matches!(
            command,
            Command::Move { .. } | Command::Pen { .. } | Command::Jog { .. }
        );
        // In every other mode the application refuses the command, and the pose may not be known.
        if !moves || !matches!(self.application.mode(), Mode::Idle | Mode::Moving) {
            return Ok(());
        }
        let admission = self.admission.as_mut().ok_or(Refusal::NotConfigured)?;
        let pose = &self.condition.pose;
        let checked = match command {
            Command::Move { position } => admission.check_move(pose, &position),
            Command::Pen { pen } => admission.check_pen(pose, pen),
            // A jog that has begun slows down by itself before a border.
            Command::Jog { velocity_mm_s }
                if self.condition.standstill && velocity_mm_s.iter().all(|v| v.is_finite()) =>
            {
                admission.check_jog(pose, &velocity_mm_s.map(f64::from))
            }
            _ => Ok(()),
        };
        checked.map_err(Refusal::Target)
    }

    /// Checks that the positions of all axes arrive and, for homing at a known pose, that the pose agrees with them.
    fn check_homing(&self, command: Command) -> Result<(), Refusal> {
        if !matches!(command, Command::Home | Command::HomeAt { .. }) {
            return Ok(());
        }
        let check = self.homing_check.as_ref().ok_or(Refusal::NotConfigured)?;
        let increments = self.report.map_or([None; AXES], |report| report.shown());
        match command {
            Command::HomeAt { pose, position } => check.check(&increments, &pose, position.as_ref()),
            _ => positions_arrive(&increments),
        }
    }

    /// Takes the next vertices of the path, at most as many as there is [room](Self::free) for; `last` if they end it.
    ///
    /// # Errors
    /// The first vertex that is refused; the vertices before it end the path.
    pub fn path(&mut self, vertices: &[PathVertex], last: bool) -> Result<(), motion::Refusal> {
        let Some(admission) = &mut self.admission else {
            return Ok(());
        };
        for wire in vertices {
            let vertex = Vertex {
                position: millimetres(wire.position_um),
                pen: wire.pen,
                stroke: wire.stroke,
            };
            if let Err(refusal) = admission.check(self.vertices_admitted, &vertex) {
                let _ = self.ends.vertices.enqueue(PathItem::End);
                return Err(refusal);
            }
            self.vertices_admitted = self.vertices_admitted.wrapping_add(1);
            // There is room: the caller has passed no more than there was room for.
            let _ = self.ends.vertices.enqueue(PathItem::Vertex(vertex));
        }
        if last {
            let _ = self.ends.vertices.enqueue(PathItem::End);
        }
        Ok(())
    }

    /// Room for vertices; one entry is reserved for the end of the path.
    pub fn free(&self) -> usize {
        (self.ends.vertices.capacity() - self.ends.vertices.len()).saturating_sub(1)
    }

    /// Progress of the path.
    pub fn path_progress(&self) -> PathProgress {
        let motion = self.motion;
        // The trajectory task is ahead of the axes, which may have stopped on its path before its end.
        let may_be_ahead = matches!(self.application.mode(), Mode::Drawing | Mode::Stopping | Mode::Fault);
        let followed = self.report.map_or(0, |report| report.setpoint.vertex);
        PathProgress {
            executed: motion.executed.min(followed),
            free: self.free(),
            finished: motion.finished && motion.orders == self.orders_sent && !may_be_ahead,
        }
    }

    /// Passes request `id` to the supervisor; the answer comes from [`Self::take_bus_answer`].
    ///
    /// # Errors
    /// Why it was refused: the mode forbids changes to the bus, or another request is in progress.
    pub fn ask_bus(&mut self, id: u16, request: ServiceRequest) -> Result<(), ServiceError> {
        if request.changes() && !self.application.may_configure() {
            return Err(ServiceError::NotAllowed(self.application.mode().number()));
        }
        if self.asked.is_some() || self.ends.bus.services.enqueue(request).is_err() {
            return Err(ServiceError::Busy);
        }
        self.asked = Some(Some(id));
        Ok(())
    }

    /// Forgets the number of the bus request in progress: its answer is dropped, because another host has connected.
    pub fn forget_bus_request(&mut self) {
        self.asked = self.asked.map(|_| None);
    }

    /// Answers a request to the measurements.
    pub fn measure(&self, request: MeasurementRequest) -> MeasurementAnswer {
        self.ends.measurements.answer(request)
    }
}

/// A position with the pen up or down: nothing holds it between these heights, mm, and only a move to the lower one lowers it.
fn up_or_down(position: Position, [down_mm, up_mm]: [f64; 2]) -> Position {
    // Not a number is refused later.
    let is_between = position.z_mm > down_mm && position.z_mm < up_mm;
    let z_mm = if is_between { up_mm } else { position.z_mm };
    Position { z_mm, ..position }
}

fn millimetres(position_um: [i32; 3]) -> Position {
    let [x_mm, y_mm, z_mm] = position_um.map(|um| f64::from(um) / 1_000.0);
    Position { x_mm, y_mm, z_mm }
}
