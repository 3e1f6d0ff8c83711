//! A console with a simulated robot, and a test as viewer.

use etherpen::config::Config;
use etherpen::robots::Position;
use host_tools::cell::CellOptions;
use host_tools::console::Console;
use host_tools::console::hub::Level;
use host_tools::console::server::Server;
use host_tools::console::virtual_cell::{CellView, Firmware, VirtualCell};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// Longest wait for anything; a busy machine is slow, not wrong.
pub(crate) const PATIENCE: Duration = Duration::from_secs(600);
/// The token of all consoles here.
pub(crate) const TOKEN: &str = "0123456789abcdef";

/// A console in front of a simulated robot.
pub(crate) struct Rig {
    server: Server,
    console: Arc<Console>,
    /// The true state of drives and robot.
    pub(crate) cell: CellView,
}

impl Rig {
    pub(crate) fn start() -> Self {
        Self::in_cell(CellOptions::default())
    }

    pub(crate) fn in_cell(options: CellOptions) -> Self {
        Self::with_pen_change(options, None)
    }

    /// A console whose robot goes to this place for a change of the pen.
    pub(crate) fn with_pen_change(options: CellOptions, place: Option<Position>) -> Self {
        Self::with(Config::default(), options, place)
    }

    /// A console of a robot with this configuration.
    pub(crate) fn with(config: Config, options: CellOptions, place: Option<Position>) -> Self {
        let cell = VirtualCell::start(&config, options, Firmware::Simulated).unwrap();
        let (port, view) = (cell.port(), cell.view());
        let console = Console::start(config, TOKEN.to_owned(), port, Some((cell, "simulated")), place).unwrap();
        let server = Server::start(console.clone(), "127.0.0.1:0".parse().unwrap()).unwrap();
        Self {
            server,
            console,
            cell: view,
        }
    }

    pub(crate) fn console(&self) -> &Console {
        &self.console
    }

    pub(crate) fn cell(&self) -> &VirtualCell {
        self.console.cell().expect("the robot is simulated")
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.server.address()
    }

    pub(crate) fn url(&self) -> String {
        format!("http://{}/#token={TOKEN}", self.address())
    }

    /// Waits until the console's state fulfils a condition.
    pub(crate) fn until(&self, what: &str, mut is: impl FnMut(&Console) -> bool) {
        let begun = Instant::now();
        while !is(&self.console) {
            assert!(begun.elapsed() < PATIENCE, "waited for {what}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Writes a line into the log.
    pub(crate) fn note(&self, text: &str) {
        self.console.change(|hub| hub.note(Level::Info, text));
    }

    /// Milliseconds of telemetry so far.
    pub(crate) fn rows(&self) -> u64 {
        self.console.hub().history().next()
    }

    /// A viewer with the token.
    pub(crate) fn viewer(&self, page: &str) -> Client {
        let mut client = Client::connect(self.address());
        client.send(&json!({"type": "hello", "token": TOKEN, "page": page}));
        client.until("you", |_| true);
        client
    }

    /// One hand-made request; returns the complete answer.
    pub(crate) fn http(&self, head: &str, body: &[u8]) -> String {
        let mut stream = TcpStream::connect(self.address()).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let length = format!("Content-Length: {}\r\nConnection: close\r\n\r\n", body.len());
        stream.write_all(format!("{head}\r\n{length}").as_bytes()).unwrap();
        let mut answer = Vec::new();
        // A refused body may end the connection before everything was written and read.
        let _ = stream.write_all(body);
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }
}

/// One viewer.
pub(crate) struct Client {
    socket: WebSocket<TcpStream>,
    /// Last data of each section.
    pub(crate) sections: BTreeMap<String, Value>,
    /// Binary messages since they were last taken.
    pub(crate) binary: Vec<Vec<u8>>,
    /// All lines of the log.
    pub(crate) log: Vec<String>,
}

impl Client {
    pub(crate) fn connect(address: SocketAddr) -> Self {
        Self::try_connect(address, &format!("http://{address}")).unwrap()
    }

    /// Connects as a page of this origin.
    pub(crate) fn try_connect(address: SocketAddr, origin: &str) -> Result<Self, String> {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut request = format!("ws://{address}/socket").into_client_request().unwrap();
        request.headers_mut().insert("Origin", origin.parse().unwrap());
        let (socket, _) = tungstenite::client(request, stream).map_err(|error| error.to_string())?;
        Ok(Self {
            socket,
            sections: BTreeMap::new(),
            binary: Vec::new(),
            log: Vec::new(),
        })
    }

    pub(crate) fn send(&mut self, request: &Value) {
        self.send_text(&request.to_string());
    }

    pub(crate) fn send_text(&mut self, text: &str) {
        // A console that disconnects this viewer closes the line.
        let _ = self.socket.send(Message::text(text));
    }

    /// Takes the next message; returns its section, or `None` when the connection has ended.
    pub(crate) fn take(&mut self) -> Option<String> {
        loop {
            match self.socket.read().ok()? {
                Message::Text(text) => {
                    let mut message: Value = serde_json::from_str(&text).unwrap();
                    let section = message["section"].as_str().unwrap().to_owned();
                    let data = message["data"].take();
                    if section == "log" {
                        let lines = data.as_array().unwrap().iter();
                        self.log
                            .extend(lines.map(|line| line["text"].as_str().unwrap().to_owned()));
                    }
                    self.sections.insert(section.clone(), data);
                    return Some(section);
                }
                Message::Binary(bytes) => {
                    self.binary.push(bytes.to_vec());
                    return Some("binary".to_owned());
                }
                Message::Close(_) => return None,
                _ => {}
            }
        }
    }

    /// Takes all messages that have come.
    pub(crate) fn catch_up(&mut self) {
        let patience = |client: &Self, time| client.socket.get_ref().set_read_timeout(Some(time)).unwrap();
        patience(self, Duration::from_millis(1));
        while self.take().is_some() {}
        patience(self, PATIENCE);
    }

    /// Takes messages until a section sent from now on fulfils a condition.
    pub(crate) fn until(&mut self, section: &str, is: impl Fn(&Value) -> bool) -> Value {
        let begun = Instant::now();
        loop {
            assert!(
                begun.elapsed() < PATIENCE,
                "waited for {section}: {:?}",
                self.sections.get(section)
            );
            let taken = self.take().expect("the connection stands");
            let data = self.sections.get(section).unwrap_or(&Value::Null);
            if taken == section && is(data) {
                return data.clone();
            }
        }
    }

    /// Takes messages until a section fulfils a condition; data received earlier count too.
    pub(crate) fn state(&mut self, section: &str, is: impl Fn(&Value) -> bool) -> Value {
        match self.sections.get(section) {
            Some(data) if is(data) => data.clone(),
            _ => self.until(section, is),
        }
    }

    pub(crate) fn mode(&mut self, wanted: &str) {
        self.state("status", |status| status["mode"] == wanted);
    }

    pub(crate) fn command(&mut self, action: Value) {
        self.send(&json!({"type": "command", "action": action}));
    }

    /// Takes control, even from another viewer, and brings the robot from any fault to rest with power.
    pub(crate) fn recover(&mut self) {
        self.send(&json!({"type": "take", "force": true}));
        let begun = Instant::now();
        loop {
            assert!(begun.elapsed() < PATIENCE, "the fault stays: {:?}", self.log);
            match self.until("status", |_| true)["mode"].as_str() {
                Some("Fault") => self.command(json!({"do": "acknowledge"})),
                Some("DrivesOff") => return self.enable(),
                Some("Idle") => return,
                _ => {}
            }
        }
    }

    /// Takes control and brings the robot to rest with power.
    pub(crate) fn enable(&mut self) {
        self.send(&json!({"type": "take"}));
        let you = self.sections["you"]["id"].clone();
        self.state("control", |control| control["holder"] == you);
        self.mode("DrivesOff");
        if self.sections["status"]["referenced"] == false {
            self.command(json!({"do": "reference"}));
            self.state("status", |status| status["referenced"] == true);
        }
        // Enabling is repeated until the reference has settled.
        let begun = Instant::now();
        loop {
            self.command(json!({"do": "enable"}));
            if self.until("status", |_| true)["mode"] == "Idle" {
                return;
            }
            assert!(begun.elapsed() < PATIENCE, "the drives are not enabled: {:?}", self.log);
        }
    }

    /// Takes messages for a while; state comes many times a second.
    pub(crate) fn listen(&mut self, time: Duration) {
        let begun = Instant::now();
        while begun.elapsed() < time && self.take().is_some() {}
    }

    /// Takes messages until the log has a line with this text.
    pub(crate) fn until_told(&mut self, text: &str) {
        while !self.log.iter().any(|line| line.contains(text)) {
            self.until("log", |_| true);
        }
    }
}
