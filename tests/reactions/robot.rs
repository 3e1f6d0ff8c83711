//! A robot in virtual time and an operator at its link, one millisecond at a time.

use crate::again::clocks_are_on;
use crate::true_times::Steps;
use etherpen::application::{Fault, Mode, Refusal};
use etherpen::board::PortState;
use etherpen::config::Config;
use etherpen::control::feedback::COMPARISONS;
use etherpen::ethercat::diagnostics::{ServiceRequest, ServiceResult};
use etherpen::link::frame::{Decoder, FRAME_BYTES_MAX, decode, encode};
use etherpen::link::message::PathAck;
use etherpen::measurement::MeasurementRequest;
use etherpen::messages::{Command, ConfigRefusal, DeviceMessage, HostMessage, PathVertex, Sample, Status};
use etherpen::motion::Pen;
use host_tools::cell::{Cell, CellOptions, CellState, Fault as CellFault, InkStroke};
use host_tools::emulator::{Emulator, Later, Link, Options};
use host_tools::link::session::{Event, Session};
use host_tools::setup;
use host_tools::simulation::{self, Host, Surroundings};
use std::pin::Pin;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll, Waker};

/// Longest wait for anything, ms of virtual time.
const WAIT_MAX_MS: u32 = 60_000;
/// Bytes on the line in a millisecond.
const LINE_BYTES_PER_MS: usize = simulation::LINE_BYTES_PER_MS;

/// First number of commands outside the session, far from the session's own.
const FIRST_BESIDE: u16 = 0x8000;

struct Bridge {
    up: SyncSender<(u32, Vec<u8>)>,
    down: Receiver<Vec<u8>>,
    surroundings: Arc<Mutex<Surroundings>>,
    used: Arc<Mutex<Used>>,
    over: bool,
}

/// Largest part of its limit that each comparison of the position feedback has used.
pub(crate) type Used = [f32; COMPARISONS.len()];

impl Host for Bridge {
    fn hear(&mut self, ms: u32, from_firmware: &[u8]) {
        self.over = self.up.send((ms, from_firmware.to_vec())).is_err();
    }

    fn exchange(&mut self, _: u32, _: &[u8], to_firmware: &mut Vec<u8>, _: usize) {
        match self.down.try_recv() {
            Ok(bytes) => to_firmware.extend(bytes),
            Err(_) => self.over = true,
        }
    }

    fn surroundings(&mut self) -> Surroundings {
        *self.surroundings.lock().unwrap()
    }

    fn feedback_used(&mut self, used: Used) {
        let mut most = self.used.lock().unwrap();
        *most = std::array::from_fn(|comparison| most[comparison].max(used[comparison]));
    }

    fn is_over(&self) -> bool {
        self.over
    }
}

impl Link for Bridge {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        // The operator answers in a thread of its own; once it is gone, nobody does.
        if self.up.send((ms, from_device.to_vec())).is_ok()
            && let Ok(bytes) = self.down.recv()
        {
            to_device.extend(bytes);
        }
    }
}

/// What runs the firmware.
enum Firmware {
    /// Its tasks, here, a millisecond for each poll.
    Tasks(Pin<Box<dyn Future<Output = u32>>>),
    /// The board's image. The emulator ends when it is dropped.
    Board(#[expect(dead_code, reason = "held for its end")] Emulator),
}

impl Firmware {
    /// Tasks that begin when the cell's clock shows this time, us.
    fn tasks(segment: Arc<Mutex<Cell>>, mut bridge: Bridge, begun_us: u64) -> Self {
        let mut segment = Later { segment, begun_us };
        Self::Tasks(Box::pin(async move {
            simulation::milliseconds(&mut segment, &mut bridge, u32::MAX).await
        }))
    }
}

/// A line that periodically loses the first bytes of a millisecond.
#[derive(Clone, Copy)]
pub(crate) struct Overrun {
    /// Bytes lost in one such millisecond.
    pub(crate) bytes: usize,
    /// Period, ms.
    pub(crate) period_ms: u32,
}

/// The robot and its operator.
pub(crate) struct Robot {
    up: Receiver<(u32, Vec<u8>)>,
    down: SyncSender<Vec<u8>>,
    /// The firmware's next message; it waits for the answer, so the cell stops between two milliseconds.
    next: Option<(u32, Vec<u8>)>,
    cell: Arc<Mutex<Cell>>,
    pub(crate) config: Config,
    surroundings: Arc<Mutex<Surroundings>>,
    used: Arc<Mutex<Used>>,
    session: Session,
    /// Whether the operator's cable is plugged in.
    pub(crate) plugged: bool,
    /// Bytes of the operator that the firmware's serial port loses.
    pub(crate) overrun: Option<Overrun>,
    job: u16,
    /// Number of the last command outside the session, and the bytes of such commands still to be sent.
    beside: u16,
    at_once: Vec<u8>,
    /// The last status that the operator received.
    pub(crate) status: Option<Status>,
    /// The last status that left the board, also while the operator's cable is unplugged.
    pub(crate) reported: Option<Status>,
    /// Finds the frames that leave the board while the operator's cable is unplugged.
    unheard: Box<Decoder>,
    /// The last acknowledgement of the path.
    pub(crate) ack: PathAck,
    /// Faults that the operator was told, in order.
    pub(crate) faults: Vec<Fault>,
    /// Sees the true clocks each millisecond.
    pub(crate) steps: Option<Steps>,
    /// All samples.
    pub(crate) samples: Vec<Sample>,
    /// Answers to configurations.
    pub(crate) configured: Vec<Result<u64, ConfigRefusal>>,
    /// Refused vertices.
    pub(crate) refused: Vec<etherpen::motion::Refusal>,
    answers: Vec<(u16, Result<(), Refusal>)>,
    /// Answers to bus requests.
    pub(crate) bus_answers: Vec<ServiceResult>,
    /// The last field: the emulator ends when nobody answers it.
    firmware: Firmware,
}

impl Robot {
    /// A robot whose firmware's tasks run here, in virtual time, and which waits for its configuration.
    pub(crate) fn new() -> Self {
        Self::of(&Config::default(), CellOptions::default())
    }

    /// A robot in virtual time with this configuration and cell, which waits for its configuration.
    pub(crate) fn of(config: &Config, options: CellOptions) -> Self {
        Self::start(config, options, |cell, bridge| Firmware::tasks(cell, bridge, 0))
    }

    /// The operator presses the board's reset button, and connects again. Drives and robot stay as they are.
    pub(crate) fn reset_board(&mut self) {
        let begun_us = self.cell().time_ms * 1_000;
        let ((up_in, up), (down, down_out)) = (sync_channel(1), sync_channel(1));
        let bridge = Bridge {
            up: up_in,
            down: down_out,
            surroundings: self.surroundings.clone(),
            used: self.used.clone(),
            over: false,
        };
        (self.up, self.down, self.next) = (up, down, None);
        self.firmware = Firmware::tasks(self.cell.clone(), bridge, begun_us);
        self.session = Session::new(7);
        self.session.connect();
        self.answers.clear();
        (self.status, self.reported, self.ack) = (None, None, PathAck::default());
        self.run_until("the board is there again", |robot| robot.status.is_some());
    }

    /// A robot whose firmware is the emulated board's image.
    pub(crate) fn emulated() -> Self {
        setup::ensure_qemu().expect("the emulator can be had");
        let image = setup::build_firmware("emulated").expect("the firmware builds");
        Self::start(&Config::default(), CellOptions::default(), |segment, bridge| {
            let emulator = Emulator::start(&image, &Options::default(), segment, bridge, |_| {});
            Firmware::Board(emulator.expect("the emulator starts"))
        })
    }

    fn start(config: &Config, options: CellOptions, run: impl FnOnce(Arc<Mutex<Cell>>, Bridge) -> Firmware) -> Self {
        let cell = Arc::new(Mutex::new(Cell::new(config, options)));
        let ((up_in, up), (down, down_out)) = (sync_channel(1), sync_channel(1));
        let surroundings = Arc::new(Mutex::new(Surroundings::default()));
        let used = Arc::default();
        let bridge = Bridge {
            up: up_in,
            down: down_out,
            surroundings: surroundings.clone(),
            used: Arc::clone(&used),
            over: false,
        };
        let firmware = run(cell.clone(), bridge);
        let mut session = Session::new(7);
        session.connect();
        Self {
            up,
            down,
            next: None,
            cell,
            config: config.clone(),
            surroundings,
            used,
            session,
            plugged: true,
            overrun: None,
            job: 0,
            beside: FIRST_BESIDE,
            at_once: Vec::new(),
            status: None,
            reported: None,
            unheard: Box::default(),
            ack: PathAck::default(),
            faults: Vec::new(),
            steps: None,
            samples: Vec::new(),
            configured: Vec::new(),
            refused: Vec::new(),
            answers: Vec::new(),
            bus_answers: Vec::new(),
            firmware,
        }
    }

    /// Referenced, enabled, at rest.
    pub(crate) fn idle() -> Self {
        Self::new().enabled()
    }

    /// In the middle of a drawing.
    pub(crate) fn drawing() -> Self {
        Self::idle().in_a_drawing()
    }

    /// Referenced, enabled, at rest, with another configuration.
    pub(crate) fn idle_with(config: &Config) -> Self {
        Self::of(config, CellOptions::default()).enabled()
    }

    /// Brings it to rest with power, referenced.
    pub(crate) fn enabled(mut self) -> Self {
        let config = self.config.clone();
        self.configure(&config);
        self.wait_for(Mode::DrivesOff);
        self.command(Command::Home).unwrap();
        self.run(100);
        self.command(Command::Enable).unwrap();
        self.wait_for(Mode::Idle);
        self
    }

    /// Begins a drawing and waits until the pen moves.
    pub(crate) fn in_a_drawing(mut self) -> Self {
        self.draw(path());
        self.run_until("the pen moves", |robot| {
            robot.speed_rad_s() > 0.2 && robot.ack.executed > 2
        });
        self
    }

    /// The emulated board in the middle of a drawing.
    pub(crate) fn emulated_drawing() -> Self {
        Self::emulated().enabled().in_a_drawing()
    }

    /// Requests artificial loads from the board: a sum of `etherpen::measurement::disturbance`'s bits.
    pub(crate) fn disturb(&mut self, bits: u8) {
        self.session.measure(MeasurementRequest::Disturb { bits }.into());
    }

    /// Sends a configuration and waits for the answer.
    pub(crate) fn configure(&mut self, config: &Config) {
        let before = self.configured.len();
        let mut config = config.clone();
        config.bus.clocks |= clocks_are_on();
        self.session.configure(config);
        self.run_until("the configuration is answered", |robot| robot.configured.len() > before);
    }

    /// Starts a drawing.
    pub(crate) fn draw(&mut self, path: Vec<PathVertex>) {
        self.job += 1;
        self.command(Command::Draw { job: self.job }).unwrap();
        self.session.start_path(self.job, path.into());
    }

    /// Whether the drawing that was started last was executed to its end.
    pub(crate) fn has_drawn(&self) -> bool {
        self.ack.finished && self.ack.job == self.job && self.mode() == Mode::Idle
    }

    /// Sends a command without waiting; returns the number of the request.
    pub(crate) fn send(&mut self, command: Command) -> u16 {
        self.session.command(command)
    }

    /// Sends a command outside the session, which sends one after the other: all commands of a millisecond arrive at
    /// once. The answer is ignored.
    pub(crate) fn send_at_once(&mut self, command: Command) {
        self.beside = self.beside.wrapping_add(1).max(FIRST_BESIDE);
        let message = HostMessage::Command {
            id: self.beside,
            command,
        };
        let mut frame = [0; FRAME_BYTES_MAX];
        let length = encode(&message, &mut frame).expect("a command fits a frame");
        self.at_once.extend_from_slice(&frame[..length]);
    }

    /// Sends a bus request without waiting.
    pub(crate) fn ask(&mut self, request: ServiceRequest) {
        self.session.bus(request);
    }

    /// Sends a command and waits for the answer.
    pub(crate) fn command(&mut self, command: Command) -> Result<(), Refusal> {
        let id = self.session.command(command);
        self.run_until("the command is answered", |robot| {
            robot.answers.iter().any(|(answered, _)| *answered == id)
        });
        let answer = self.answers.iter().find(|(answered, _)| *answered == id);
        self.session.inquire();
        answer.unwrap().1
    }

    /// Sends a command without waiting for the answer.
    pub(crate) fn say(&mut self, command: Command) {
        self.session.command(command);
    }

    /// Injects a fault into the cell.
    pub(crate) fn inject(&mut self, fault: CellFault) {
        self.cell.lock().unwrap().inject(fault);
    }

    /// Changes the board's surroundings.
    pub(crate) fn surround(&mut self, change: impl FnOnce(&mut Surroundings)) {
        change(&mut self.surroundings.lock().unwrap());
    }

    /// Opens or closes the board's emergency-stop input.
    pub(crate) fn emergency_stop(&mut self, open: bool) {
        self.surround(|around| around.stop_shows_open = open);
    }

    /// Changes the state that the PHY of the board's Ethernet port reports.
    pub(crate) fn port(&mut self, state: PortState) {
        self.surround(|around| around.board.port = state);
    }

    /// Its configuration.
    pub(crate) fn config(&self) -> &Config {
        &self.config
    }

    /// Present state of the cell.
    pub(crate) fn cell(&self) -> CellState {
        self.cell.lock().unwrap().state()
    }

    /// Changes the cell between two milliseconds.
    pub(crate) fn change_cell(&mut self, change: impl FnOnce(&mut Cell)) {
        change(&mut self.cell.lock().unwrap());
    }

    /// Sets the inputs of a terminal, from 1.
    pub(crate) fn set_inputs(&mut self, slave: usize, inputs: u8) {
        self.set_input_bytes(slave, &[inputs]);
    }

    /// Sets the first inputs of a terminal, from 1.
    pub(crate) fn set_input_bytes(&mut self, slave: usize, inputs: &[u8]) {
        self.cell.lock().unwrap().set_inputs(slave, inputs);
    }

    /// The outputs of a terminal, from 1, as they act outside.
    pub(crate) fn outputs(&self, slave: usize) -> u8 {
        self.output_word(slave).to_le_bytes()[0]
    }

    /// First 16 bits of a terminal's outputs.
    pub(crate) fn output_word(&self, slave: usize) -> u16 {
        let [word, _] = self.output_words(slave);
        word
    }

    /// First 32 bits of a terminal's outputs, as they act outside.
    pub(crate) fn output_words(&self, slave: usize) -> [u16; 2] {
        let outputs = self.cell.lock().unwrap().outputs(slave).unwrap_or_default();
        let byte = |at: usize| outputs.get(at).copied().unwrap_or(0);
        [0, 2].map(|at| u16::from_le_bytes([byte(at), byte(at + 1)]))
    }

    /// Largest parts of their limits that the comparisons of the feedback have used since the last call.
    pub(crate) fn take_used(&mut self) -> Used {
        std::mem::take(&mut self.used.lock().unwrap())
    }

    /// The ink on the paper.
    pub(crate) fn ink(&self) -> Vec<InkStroke> {
        self.cell.lock().unwrap().ink().to_vec()
    }

    /// Largest true speed of a joint, rad/s.
    pub(crate) fn speed_rad_s(&self) -> f64 {
        self.cell()
            .velocities
            .0
            .iter()
            .fold(0.0, |most, speed| most.max(speed.abs()))
    }

    /// The mode last reported.
    pub(crate) fn mode(&self) -> Mode {
        self.status.as_ref().map_or(Mode::Startup, |status| status.mode)
    }

    /// The fault last reported.
    pub(crate) fn fault(&self) -> Option<Fault> {
        self.status.as_ref().and_then(|status| status.fault)
    }

    /// Lets virtual time pass.
    pub(crate) fn run(&mut self, duration_ms: u32) {
        for _ in 0..duration_ms {
            let next = self.next.take().or_else(|| self.next_message());
            let (ms, bytes) = next.expect("the simulation runs");
            let now_ms = u64::from(ms);
            let mut line = [0; LINE_BYTES_PER_MS];
            let mut length = 0;
            if self.plugged {
                self.session.receive(&bytes, now_ms);
                while let Some(event) = self.session.next_event() {
                    self.take(event);
                }
                length = self.session.transmit(now_ms, &mut line);
            } else {
                self.read_unheard(&bytes);
            }
            // Not in the middle of a frame of the session's.
            if length == 0 {
                length = self.at_once.len().min(line.len());
                line[..length].copy_from_slice(&self.at_once[..length]);
                self.at_once.drain(..length);
            }
            let overrun = self.overrun.filter(|overrun| ms % overrun.period_ms == 0);
            let lost = overrun.map_or(0, |overrun| overrun.bytes.min(length));
            self.down
                .send(line[lost..length].to_vec())
                .expect("the simulation runs");
            self.next = self.next_message();
            if let Some(steps) = &mut self.steps {
                let cell = self.cell.lock().unwrap();
                steps.see(cell.true_time_ns(), &cell.system_times_ns());
            }
        }
    }

    /// Runs the firmware until it has said what it says in a millisecond.
    fn next_message(&mut self) -> Option<(u32, Vec<u8>)> {
        match &mut self.firmware {
            Firmware::Tasks(tasks) => match tasks.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
                Poll::Pending => self.up.try_recv().ok(),
                Poll::Ready(_) => None,
            },
            Firmware::Board(_) => self.up.recv().ok(),
        }
    }

    /// Virtual time since the board's start, ms.
    pub(crate) fn now_ms(&self) -> u64 {
        self.next.as_ref().map_or(0, |(ms, _)| u64::from(*ms))
    }

    /// Lets time pass until something holds.
    pub(crate) fn run_until(&mut self, what: &str, holds: impl Fn(&Self) -> bool) {
        for _ in 0..WAIT_MAX_MS {
            if holds(self) {
                return;
            }
            self.run(1);
        }
        panic!("{what}: not within {WAIT_MAX_MS} ms; status {:?}", self.status);
    }

    /// Lets time pass until the firmware reports this mode.
    pub(crate) fn wait_for(&mut self, mode: Mode) {
        self.run_until(&format!("{mode:?}"), |robot| robot.mode() == mode);
    }

    /// Reads the reports in bytes that the operator does not receive.
    fn read_unheard(&mut self, bytes: &[u8]) {
        for byte in bytes {
            if let Some(Ok(payload)) = self.unheard.push(*byte)
                && let Ok(DeviceMessage::Status(status)) = decode::<DeviceMessage>(payload)
            {
                self.reported = Some(status);
            }
        }
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Answered { id, result, .. } => self.answers.push((id, result)),
            Event::Configured(result) => self.configured.push(result),
            Event::Ack(ack) => self.ack = ack,
            Event::VertexRefused(refusal) => self.refused.push(refusal),
            Event::Status(status) => {
                if status.fault != self.fault() {
                    self.faults.extend(status.fault);
                }
                self.reported = Some(status.clone());
                self.status = Some(status);
            }
            Event::Samples { samples, .. } => self.samples.extend(samples),
            Event::Connected(_) | Event::VersionRefused { .. } | Event::Restarted | Event::Measured(_) => {}
            Event::Bus(result) => self.bus_answers.push(result),
        }
    }
}

/// Two strokes of about a second each: zigzags of 60 mm.
pub(crate) fn path() -> Vec<PathVertex> {
    let mut path = Vec::new();
    for stroke in 0..2u32 {
        let y_um = 30_000 * stroke as i32;
        let mut go = |x_um: i32, y_um: i32, z_um: i32, pen: Pen| {
            path.push(PathVertex {
                position_um: [x_um, y_um, z_um],
                pen,
                stroke,
            });
        };
        go(-30_000, y_um, -847_000, Pen::Up);
        go(-30_000, y_um, -850_000, Pen::Up);
        for leg in 1..=8 {
            let x_um = if leg % 2 == 0 { -30_000 } else { 30_000 };
            go(x_um, y_um + 2_500 * leg, -850_000, Pen::Down);
        }
        go(-30_000, y_um + 20_000, -847_000, Pen::Up);
    }
    path
}
