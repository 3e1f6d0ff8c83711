//! Test rig for both ends of the link: a faulty line and a small firmware around the real endpoint, in virtual time.

use crate::random::Xorshift;
use etherpen::application::{Fault, Mode, Refusal};
use etherpen::black_box::Memory;
use etherpen::board::PortState;
use etherpen::config::Config;
use etherpen::ethercat::diagnostics::{BusInfo, ServiceReply, ServiceRequest};
use etherpen::link::device::{Identity, LINE_BYTES_PER_MS};
use etherpen::link::frame::Decoder;
use etherpen::link::ports::LinkPort;
use etherpen::measurement::Measurements;
use etherpen::messages::{Command, Counters, IoValues, PathVertex, RecordAnswer, RecordRequest, Sample, Status};
use etherpen::messages::{ConfigRefusal, DeviceEndpoint, DeviceEvent};
use etherpen::motion::Pen;
use etherpen::robots::{AXES, Kinematics, Position};
use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

/// One direction of a serial line that damages bytes.
pub(crate) struct FaultyLine {
    random: Xorshift,
    /// Faults of each kind in a million bytes.
    faults_per_million: u64,
    /// Faults so far.
    pub(crate) spoilt: u32,
}

impl FaultyLine {
    pub(crate) fn new(seed: u64, faults_per_million: u64) -> Self {
        Self {
            random: Xorshift::new(seed),
            faults_per_million,
            spoilt: 0,
        }
    }

    /// Carries bytes: each may be lost, damaged, doubled, or followed by a repetition of the eight bytes before it.
    pub(crate) fn carry(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for byte in bytes {
            let kind = self.random.scrambled() % 1_000_000 / self.faults_per_million.max(1);
            self.spoilt += u32::from(self.faults_per_million > 0 && kind < 4);
            match kind {
                _ if self.faults_per_million == 0 => out.push(*byte),
                0 => {}
                1 => out.push(byte ^ (1 << (self.random.scrambled() % 8))),
                2 => out.extend([*byte, *byte]),
                3 => {
                    out.push(*byte);
                    let again = out[out.len().saturating_sub(8)..].to_vec();
                    out.extend(again);
                }
                _ => out.push(*byte),
            }
        }
        out
    }
}

/// A small firmware that carries out commands after a delay: it executes one vertex a millisecond, and its drives
/// follow with the configured age.
pub(crate) struct Rig {
    pub(crate) decoder: Decoder,
    pub(crate) endpoint: DeviceEndpoint,
    pub(crate) mode: Mode,
    pub(crate) fault: Option<Fault>,
    pub(crate) fault_at_vertex: Option<u32>,
    pub(crate) refuse_vertex: Option<u32>,
    pub(crate) referenced: bool,
    pub(crate) increments: [Option<i32>; 4],
    pub(crate) refuse_reference: Option<Refusal>,
    /// How long an acknowledgement waits for a slave that starts up, ms.
    pub(crate) slow_start_ms: u64,
    /// Until when it waits for a slave.
    waits_until_ms: u64,
    pub(crate) config: Option<u64>,
    pub(crate) commands: Vec<Command>,
    pub(crate) asked: Vec<ServiceRequest>,
    pub(crate) measurements: Measurements,
    black_box: Box<Memory>,
    pub(crate) vertices: Vec<PathVertex>,
    pub(crate) executed: u32,
    pub(crate) lines: [FaultyLine; 2],
    kinematics: Kinematics,
    /// References that have not been measured yet.
    following: VecDeque<[f32; AXES]>,
    age_ms: usize,
    complete: bool,
    then: Option<(u64, Mode)>,
    status_due_ms: u64,
    told: Option<Mode>,
    now_ms: u64,
}

pub(crate) const CAPACITY: usize = 200;

impl Rig {
    pub(crate) fn new(seed: u64, faults_per_million: u64) -> Self {
        Self {
            decoder: Decoder::new(),
            endpoint: DeviceEndpoint::new(Identity {
                firmware: "0.1.0",
                board: "rig",
                capacity: CAPACITY as u16,
            }),
            mode: Mode::Startup,
            fault: None,
            fault_at_vertex: None,
            refuse_vertex: None,
            referenced: false,
            increments: [Some(0); 4],
            refuse_reference: None,
            slow_start_ms: 0,
            waits_until_ms: 0,
            config: None,
            commands: Vec::new(),
            asked: Vec::new(),
            measurements: Measurements::new(),
            black_box: Box::new(Memory::new()),
            vertices: Vec::new(),
            executed: 0,
            lines: [
                FaultyLine::new(seed, faults_per_million),
                FaultyLine::new(seed + 1, faults_per_million),
            ],
            kinematics: Kinematics::new(&Config::default().geometry).expect("the built-in geometry"),
            following: VecDeque::new(),
            age_ms: Config::default().axes[0].measurement_age_ms.round() as usize,
            complete: false,
            then: None,
            status_due_ms: 0,
            told: None,
            now_ms: 0,
        }
    }

    /// Advances the line in both directions and the firmware by one millisecond; `host` takes the arriving bytes and
    /// the room for bytes, and returns the bytes to send.
    pub(crate) fn step(&mut self, now_ms: u64, mut host: impl FnMut(&[u8], usize) -> Vec<u8>) {
        self.now_ms = now_ms;
        self.run(now_ms);
        let mut out = [0; LINE_BYTES_PER_MS];
        let length = self.endpoint.transmit(now_ms, &mut out);
        let arrived = self.lines[0].carry(&out[..length]);
        let sent = host(&arrived, LINE_BYTES_PER_MS);
        assert!(sent.len() <= LINE_BYTES_PER_MS);
        for byte in self.lines[1].carry(&sent) {
            let free = self.free();
            let Some(Ok(payload)) = self.decoder.push(byte) else {
                continue;
            };
            if let Some(event) = self.endpoint.receive(LinkPort::Serial, payload, now_ms, free) {
                self.take(event, now_ms);
            }
        }
    }

    fn free(&self) -> usize {
        CAPACITY - (self.vertices.len() - self.executed as usize)
    }

    fn take(&mut self, event: DeviceEvent, now_ms: u64) {
        match event {
            DeviceEvent::Connected | DeviceEvent::Inquire => self.status_due_ms = now_ms,
            DeviceEvent::Bus { id, request } => {
                self.asked.push(request);
                let slaves = self.asked.len() as u8;
                let info = BusInfo {
                    slaves,
                    ..BusInfo::default()
                };
                self.endpoint.bus_answered(id, Ok(ServiceReply::Bus(info)));
            }
            DeviceEvent::Measure { id, request } => {
                let answer = match request {
                    RecordRequest::Measurement(request) => RecordAnswer::Measurement(self.measurements.answer(request)),
                    RecordRequest::BlackBox(request) => RecordAnswer::BlackBox(self.black_box.answer(request)),
                };
                self.endpoint.measured(id, answer);
            }
            DeviceEvent::Configure { id, config } => {
                let is_stopped = self.fault.is_some_and(|fault| !fault.is_of_configuration());
                let result = match config.check() {
                    Ok(()) if is_stopped => Err(ConfigRefusal::NotInMode(self.mode)),
                    checked => checked.map(|()| config.hash().unwrap_or(0)).map_err(Into::into),
                };
                if let Ok(hash) = result {
                    (self.config, self.fault) = (Some(hash), None);
                    self.mode = Mode::BusConfiguring;
                    self.then = Some((now_ms + 50, Mode::DrivesOff));
                }
                self.endpoint.configured(id, result);
            }
            DeviceEvent::Command { id, command } => {
                let result = self.command(command, now_ms);
                if result.is_ok() {
                    self.commands.push(command);
                }
                self.endpoint.answer(id, result);
            }
            DeviceEvent::Stop { command } => {
                if self.command(command, now_ms).is_ok() {
                    self.commands.push(command);
                }
            }
            DeviceEvent::Path { vertices, last } => {
                for vertex in vertices {
                    let index = self.vertices.len() as u32;
                    if self.refuse_vertex == Some(index) {
                        let reason = etherpen::motion::RefusalReason::NotFinite;
                        self.endpoint.refuse_vertex(etherpen::motion::Refusal { index, reason });
                        return;
                    }
                    self.vertices.push(vertex);
                }
                assert!(self.vertices.len() - self.executed as usize <= CAPACITY);
                self.complete = last;
            }
        }
    }

    fn command(&mut self, command: Command, now_ms: u64) -> Result<(), Refusal> {
        let require = |mode: Mode, now: Mode| {
            if mode == now {
                Ok(())
            } else {
                Err(Refusal::NotInMode(now))
            }
        };
        match command {
            Command::Home | Command::HomeAt { .. } => match self.refuse_reference {
                Some(refusal) => return Err(refusal),
                None => self.referenced = true,
            },
            Command::Enable => {
                require(Mode::DrivesOff, self.mode)?;
                self.then = Some((now_ms + 30, Mode::Idle));
            }
            Command::Disable if self.mode == Mode::DrivesOff && self.then.is_some() => return Err(Refusal::Moving),
            Command::Disable if self.mode == Mode::DrivesOff => {}
            Command::Disable => {
                require(Mode::Idle, self.mode)?;
                self.mode = Mode::Stopping;
                self.then = Some((now_ms + 100, Mode::DrivesOff));
            }
            Command::Draw { .. } => {
                require(Mode::Idle, self.mode)?;
                self.mode = Mode::Drawing;
            }
            Command::Hold => {
                require(Mode::Drawing, self.mode)?;
                self.mode = Mode::Holding;
            }
            Command::Resume => {
                require(Mode::Holding, self.mode)?;
                self.mode = Mode::Drawing;
            }
            Command::Cancel => {
                self.mode = Mode::Stopping;
                self.then = Some((now_ms + 20, Mode::Idle));
            }
            Command::Move { .. } | Command::Pen { .. } => {
                require(Mode::Idle, self.mode)?;
                self.mode = Mode::Moving;
                self.then = Some((now_ms + 60, Mode::Idle));
            }
            Command::Jog { .. } => {
                if self.mode != Mode::Moving {
                    require(Mode::Idle, self.mode)?;
                }
                self.mode = Mode::Moving;
                self.then = Some((now_ms + 100, Mode::Idle));
            }
            Command::Acknowledge => {
                require(Mode::Fault, self.mode)?;
                self.waits_until_ms = now_ms + self.slow_start_ms;
                self.then = Some((self.waits_until_ms + 40, Mode::DrivesOff));
            }
            Command::Stop => self.stop(Fault::EmergencyStop(etherpen::application::StopSource::Link), now_ms),
            _ => {}
        }
        Ok(())
    }

    fn stop(&mut self, fault: Fault, now_ms: u64) {
        self.fault = Some(fault);
        self.mode = Mode::Stopping;
        self.then = Some((now_ms + 100, Mode::Fault));
    }

    fn run(&mut self, now_ms: u64) {
        if let Some((_, mode)) = self.then.take_if(|(at_ms, _)| now_ms >= *at_ms) {
            self.mode = mode;
            if mode != Mode::Fault {
                self.fault = None;
            }
        }
        if self.mode == Mode::Drawing && self.endpoint.silence_ms(now_ms).is_some_and(|ms| ms > 500) {
            self.mode = Mode::Holding;
        }
        if self.mode == Mode::Drawing {
            self.executed = (self.executed + 1).min(self.vertices.len() as u32);
            if self.fault_at_vertex.is_some_and(|vertex| self.executed >= vertex) {
                self.stop(Fault::SlaveLost { slave: 2 }, now_ms);
            }
        }
        let finished = self.complete && self.executed as usize == self.vertices.len();
        if finished && self.mode == Mode::Drawing {
            self.mode = Mode::Idle;
        }
        self.endpoint.acknowledge(self.executed, self.free(), finished);
        let sample = self.sample(now_ms);
        self.endpoint.sample(sample);
        if now_ms >= self.status_due_ms || self.told != Some(self.mode) {
            self.told = Some(self.mode);
            self.status_due_ms = now_ms + 500;
            let waits = now_ms < self.waits_until_ms;
            self.endpoint.status(Status {
                mode: self.mode,
                fault: self.fault,
                recovering: waits,
                interlock: None,
                port: PortState::Unknown,
                waiting_for: waits.then_some(2),
                referenced: self.referenced,
                reference_lost: false,
                increments: self.increments,
                config: self.config,
                override_percent: 100,
                counters: Counters::default(),
                slaves: four_slaves(),
                io: Default::default(),
            });
        }
    }

    fn sample(&mut self, now_ms: u64) -> Sample {
        let vertex = self.vertices.get((self.executed as usize).wrapping_sub(1));
        let setpoint_rad = vertex.map_or([0.0; AXES], |vertex| {
            let [x_mm, y_mm, z_mm] = vertex.position_um.map(|um| f64::from(um) / 1_000.0);
            let pose = self.kinematics.inverse(&Position { x_mm, y_mm, z_mm });
            let [a, b, c] = pose.unwrap_or_default().map(|rad| rad as f32);
            [a, b, c, 0.0]
        });
        self.following.push_back(setpoint_rad);
        let measured_rad = match self.following.len() > self.age_ms {
            true => self.following.pop_front().unwrap_or_default(),
            false => setpoint_rad,
        };
        Sample {
            t_ms: now_ms as u32,
            mode: self.mode,
            stroke: vertex.map_or(0, |vertex| vertex.stroke),
            pen: vertex.map_or(Pen::Up, |vertex| vertex.pen),
            setpoint_rad,
            measured_rad,
            setpoint_rad_s: [0.0; AXES],
            measured_rad_s: [0.0; AXES],
            io: IoValues::default(),
        }
    }
}

/// Serves a stream in real time until it is closed; the rig's own time continues with the next stream.
pub(crate) fn serve(rig: &mut Rig, mut stream: &UnixStream) {
    let begun = Instant::now();
    stream
        .set_read_timeout(Some(Duration::from_millis(1)))
        .expect("a socket has a timeout");
    let mut waiting = Vec::new();
    for passed_ms in 0.. {
        let mut block = [0; 1024];
        match stream.read(&mut block) {
            Ok(0) => break,
            Ok(length) => waiting.extend_from_slice(&block[..length]),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            // The other side has closed with bytes unread.
            Err(_) => break,
        }
        let mut written = Ok(());
        rig.step(rig.now_ms + 1, |bytes, room| {
            written = stream.write_all(bytes);
            waiting.drain(..waiting.len().min(room)).collect()
        });
        if written.is_err() {
            break;
        }
        std::thread::sleep(Duration::from_millis(passed_ms).saturating_sub(begun.elapsed()));
    }
}

fn four_slaves() -> heapless::Vec<etherpen::messages::SlaveStatus, { etherpen::messages::SLAVES_REPORTED }> {
    let slave = etherpen::messages::SlaveStatus {
        vendor: 2,
        product: 0x07d0_6014,
        al_state: 8,
        al_code: 0,
        status_word: 0x1237,
    };
    std::iter::repeat_n(slave, 4).collect()
}

/// A path of `count` vertices, all different.
pub(crate) fn path(count: usize) -> Vec<PathVertex> {
    let vertices = (0..count as i32).map(|index| PathVertex {
        position_um: [index * 37 % 100_000, index * 100, -850_000],
        pen: if index % 10 == 0 { Pen::Up } else { Pen::Down },
        stroke: index as u32 / 10,
    });
    vertices.collect()
}
