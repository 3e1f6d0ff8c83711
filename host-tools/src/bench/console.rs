//! Delay of a stop through a console under hostile load, and the console's memory.
//!
//! The console is a separate process in front of a simulated robot. This process relays all bytes between the two and
//! records the time at which the stop's telegram passes. The loads are threads of this process.

use super::{BenchError, BenchReport, BenchRow, Selection};
use crate::cell::CellOptions;
use crate::console::virtual_cell::{Firmware, VirtualCell};
use crate::link::port::PortName;
use etherpen::config::Config;
use etherpen::link::frame::{Decoder, decode};
use etherpen::messages::{Command as Told, HostMessage};
use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Longest delay of a stop on an idle machine, ms.
const DELAY_MAX_MS: f64 = 100.0;
/// Most memory of the console, MiB.
const MEMORY_MAX_MIB: f64 = 256.0;
/// Connections that each thread of `Load::Connections` keeps open.
const OPEN_AT_ONCE: usize = 300;
/// Time after which a stop counts as lost.
const LOST: Duration = Duration::from_secs(60);
/// Time until a load is fully active, and between two stops.
const UNDER_WAY: Duration = Duration::from_secs(1);
const BETWEEN: Duration = Duration::from_millis(25);
/// Amount of telemetry to record before the loads begin.
const TELEMETRY: Duration = Duration::from_secs(10);

/// Load on the console.
#[derive(Clone, Copy)]
enum Load {
    Idle,
    /// Viewers without the token that request the whole history continuously and read the answers.
    Flood(usize),
    /// Viewers without the token that only watch.
    Viewers(usize),
    /// Requests whose heads never end.
    Halves(usize),
    /// Files without the token, a few bytes at a time.
    Uploads(usize),
    /// Viewers that request the whole history and never read.
    SlowReaders(usize),
    /// Threads that connect as often as they can and send nothing.
    Connections(usize),
}

const LOADS: [(&str, Load); 9] = [
    ("idle", Load::Idle),
    ("flood", Load::Flood(1)),
    ("two_floods", Load::Flood(2)),
    ("eight_floods", Load::Flood(8)),
    ("32_viewers", Load::Viewers(32)),
    ("300_half_requests", Load::Halves(300)),
    ("partial_uploads", Load::Uploads(32)),
    ("slow_readers", Load::SlowReaders(8)),
    ("connections", Load::Connections(2)),
];

fn failed(cause: impl std::fmt::Display) -> BenchError {
    BenchError::Program {
        program: "the console".to_owned(),
        cause: cause.to_string(),
    }
}

/// Measures with the program at `program`: `stops` stops of each kind under each load.
///
/// # Errors
/// The console does not start, or a stop does not come through within a minute.
pub fn run(
    selection: &Selection,
    program: &Path,
    stops: usize,
    progress: impl Fn(&str),
) -> Result<BenchReport, BenchError> {
    let mut bench = Bench::start(program).map_err(failed)?;
    thread::sleep(TELEMETRY);
    let mut rows = Vec::new();
    for (name, load) in LOADS {
        let cases = ["stop_delay_socket", "stop_delay_post", "memory"].map(|figure| format!("{figure}/{name}"));
        if !cases.iter().any(|case| selection.wants(case, "etherpen")) {
            continue;
        }
        progress(&format!("{stops} stops by each way: {name}"));
        let figures = bench.measure(load, stops).map_err(failed)?;
        let units = [("ms", DELAY_MAX_MS), ("ms", DELAY_MAX_MS), ("MiB", MEMORY_MAX_MIB)];
        for ((case, value), (unit, target)) in cases.into_iter().zip(figures).zip(units) {
            if selection.wants(&case, "etherpen") {
                rows.push(BenchRow {
                    case,
                    subject: "etherpen",
                    value,
                    unit,
                    target: Some(target),
                });
            }
        }
    }
    Ok(BenchReport { bench: "console", rows })
}

/// A console, its simulated robot, and an operator.
struct Bench {
    child: Child,
    _cell: VirtualCell,
    place: PathBuf,
    passed: Receiver<Instant>,
    address: String,
    token: String,
    operator: TcpStream,
}

impl Drop for Bench {
    fn drop(&mut self) {
        // A process that has already ended needs no kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = std::fs::remove_file(&self.place);
    }
}

impl Bench {
    fn start(program: &Path) -> io::Result<Self> {
        let config = Config::default();
        let cell = VirtualCell::start(&config, CellOptions::default(), Firmware::Simulated)?;
        let PortName::Unix(robot) = cell.port() else {
            return Err(io::ErrorKind::Unsupported.into());
        };
        let place = std::env::temp_dir().join(format!("etherpen-tap-{}.sock", std::process::id()));
        let _ = std::fs::remove_file(&place);
        let listener = UnixListener::bind(&place)?;
        let (tell, passed) = mpsc::channel();
        thread::spawn(move || tap(&listener, &robot, &tell));
        let mut child = Command::new(program)
            .args(["console", "--listen", "127.0.0.1:0", "--port"])
            .arg(format!("unix:{}", place.display()))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let mut line = String::new();
        let stdout = child.stdout.take().ok_or(io::ErrorKind::BrokenPipe)?;
        BufReader::new(stdout).read_line(&mut line)?;
        let url = line
            .trim()
            .strip_prefix("http://")
            .and_then(|url| url.split_once("/#token="));
        let (address, token) = url.ok_or_else(|| io::Error::other(format!("it printed no address: {line}")))?;
        let mut operator = viewer(address)?;
        say(
            &mut operator,
            &format!(r#"{{"type":"hello","token":"{token}","page":"bench"}}"#),
        )?;
        let mut reader = operator.try_clone()?;
        thread::spawn(move || drain(&mut reader));
        Ok(Self {
            child,
            _cell: cell,
            place,
            passed,
            address: address.to_owned(),
            token: token.to_owned(),
            operator,
        })
    }

    /// Longest delay by socket and by request, ms, and most memory, MiB.
    fn measure(&mut self, load: Load, stops: usize) -> io::Result<[f64; 3]> {
        let ended = Arc::new(AtomicBool::new(false));
        let threads = begin(load, &self.address, &ended)?;
        thread::sleep(UNDER_WAY);
        let measured = self.stop_often(stops);
        ended.store(true, Ordering::Relaxed);
        for (stream, thread) in threads {
            let _ = stream.map(|stream| stream.shutdown(Shutdown::Both));
            let _ = thread.map(JoinHandle::join);
        }
        measured
    }

    fn stop_often(&mut self, stops: usize) -> io::Result<[f64; 3]> {
        let [mut by_socket, mut by_request, mut memory] = [0.0_f64; 3];
        for _ in 0..stops {
            let sent = Instant::now();
            say(&mut self.operator, r#"{"type":"stop"}"#)?;
            by_socket = by_socket.max(self.delay_ms(sent)?);
            thread::sleep(BETWEEN);
            let sent = Instant::now();
            let mut request = TcpStream::connect(&self.address)?;
            write!(
                request,
                "POST /stop HTTP/1.1\r\nHost: {}\r\nx-etherpen-token: {}\r\nContent-Length: 0\r\n\r\n",
                self.address, self.token
            )?;
            by_request = by_request.max(self.delay_ms(sent)?);
            thread::sleep(BETWEEN);
            memory = memory.max(memory_mib(self.child.id()));
        }
        Ok([by_socket, by_request, memory])
    }

    fn delay_ms(&self, sent: Instant) -> io::Result<f64> {
        loop {
            let passed = self.passed.recv_timeout(LOST);
            let passed = passed.map_err(|_| io::Error::other("a stop did not come through within a minute"))?;
            // A repetition of the previous stop does not count.
            if let Some(delay) = passed.checked_duration_since(sent) {
                return Ok(delay.as_secs_f64() * 1_000.0);
            }
        }
    }
}

/// Resident memory of a process, MiB; NaN if there is no /proc.
fn memory_mib(process: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok());
    kilobytes.map_or(f64::NAN, |kilobytes| kilobytes / 1_024.0)
}

/// Relays the bytes between console and robot, and reports when a stop passes.
fn tap(listener: &UnixListener, robot: &Path, tell: &Sender<Instant>) {
    for console in listener.incoming().flatten() {
        let Ok(robot) = UnixStream::connect(robot) else { return };
        let (Ok(mut from_robot), Ok(mut to_console)) = (robot.try_clone(), console.try_clone()) else {
            return;
        };
        thread::spawn(move || io::copy(&mut from_robot, &mut to_console));
        let (mut console, mut robot) = (console, robot);
        let mut decoder: Box<Decoder> = Box::default();
        let mut block = [0; 4096];
        while let Ok(length @ 1..) = console.read(&mut block) {
            let bytes = block.get(..length).unwrap_or_default();
            for byte in bytes {
                let Some(Ok(payload)) = decoder.push(*byte) else {
                    continue;
                };
                if let Ok(HostMessage::Command {
                    command: Told::Stop, ..
                }) = decode::<HostMessage>(payload)
                {
                    // The receiver is gone once the measurement has ended.
                    let _ = tell.send(Instant::now());
                }
            }
            if robot.write_all(bytes).is_err() {
                break;
            }
        }
    }
}

/// A viewer's socket.
fn viewer(address: &str) -> io::Result<TcpStream> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_nodelay(true)?;
    write!(
        stream,
        "GET /socket HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )?;
    let mut head = Vec::new();
    let mut byte = [0];
    while !head.ends_with(b"\r\n\r\n") {
        stream.read_exact(&mut byte)?;
        head.extend(byte);
    }
    match head.starts_with(b"HTTP/1.1 101") {
        true => Ok(stream),
        false => Err(io::Error::other(String::from_utf8_lossy(&head).into_owned())),
    }
}

/// Sends a text message, masked with zeros (RFC 6455, section 5.2).
fn say(stream: &mut TcpStream, text: &str) -> io::Result<()> {
    let mut frame = vec![0x81];
    match u8::try_from(text.len()) {
        Ok(length @ ..=125) => frame.push(0x80 | length),
        _ => {
            frame.push(0x80 | 126);
            frame.extend((text.len() as u16).to_be_bytes());
        }
    }
    frame.extend([0; 4]);
    frame.extend(text.as_bytes());
    stream.write_all(&frame)
}

fn drain(stream: &mut TcpStream) {
    let mut block = [0; 65_536];
    while stream.read(&mut block).is_ok_and(|length| length > 0) {}
}

const ALL_OF_IT: &str = r#"{"type":"range","id":1,"signals":[0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17,18,19,20,21,22,23,24,25,26,27],"from_ms":0,"to_ms":60000,"columns":0}"#;

type Burden = (Option<TcpStream>, Option<JoinHandle<()>>);

/// Connects repeatedly until told to end.
fn connect_often(address: &str, ended: &AtomicBool) {
    let mut open = VecDeque::new();
    while !ended.load(Ordering::Relaxed) {
        open.extend(TcpStream::connect(address));
        if open.len() > OPEN_AT_ONCE {
            open.pop_front();
        }
    }
}

/// Starts a load; it ends with its flag and its connections.
fn begin(load: Load, address: &str, ended: &Arc<AtomicBool>) -> io::Result<Vec<Burden>> {
    let idle = |stream: TcpStream| (Some(stream), None);
    let reading = |stream: TcpStream| -> io::Result<Burden> {
        let mut reader = stream.try_clone()?;
        Ok((Some(stream), Some(thread::spawn(move || drain(&mut reader)))))
    };
    let asking = |stream: TcpStream| -> io::Result<Burden> {
        let (mut writer, ended) = (stream.try_clone()?, ended.clone());
        let ask = move || while !ended.load(Ordering::Relaxed) && say(&mut writer, ALL_OF_IT).is_ok() {};
        Ok((Some(stream), Some(thread::spawn(ask))))
    };
    let mut burdens = Vec::new();
    match load {
        Load::Idle => {}
        Load::Flood(count) => {
            for _ in 0..count {
                let stream = viewer(address)?;
                burdens.push(reading(stream.try_clone()?)?);
                burdens.push(asking(stream)?);
            }
        }
        Load::Viewers(count) => {
            for _ in 0..count {
                burdens.push(reading(viewer(address)?)?);
            }
        }
        Load::Halves(count) => {
            for _ in 0..count {
                let mut stream = TcpStream::connect(address)?;
                // A connection that is already closed is part of the measurement.
                let _ = write!(stream, "GET / HTTP/1.1\r\nHost: {address}\r\nX-Half: ");
                burdens.push(idle(stream));
            }
        }
        Load::Uploads(count) => {
            for _ in 0..count {
                let mut stream = TcpStream::connect(address)?;
                let _ = write!(
                    stream,
                    "POST /file HTTP/1.1\r\nHost: {address}\r\nx-etherpen-token: guess\r\nContent-Length: 33554432\r\n\r\nabc"
                );
                burdens.push(idle(stream));
            }
        }
        Load::SlowReaders(count) => {
            for _ in 0..count {
                burdens.push(asking(viewer(address)?)?);
            }
        }
        Load::Connections(count) => {
            for _ in 0..count {
                let (address, ended) = (address.to_owned(), ended.clone());
                let connecting = thread::spawn(move || connect_often(&address, &ended));
                burdens.push((None, Some(connecting)));
            }
        }
    }
    Ok(burdens)
}
