//! The firmware image with EtherCAT in UDP at the emulator's own network, against a segment behind a socket.
//!
//! Everything is real except the wire: DHCP, ARP, the IP stack, the Ethernet controller's driver. The emulator runs
//! free, so nothing here is timed; the configuration allows for long delays.

use etherpen::config::{Config, Transport};
use etherpen::ethercat::wire::{UDP_PORT, UdpRepr};
use etherpen_segment::capture::{Capture, Direction};
use host_tools::cell::{AlState, Cell, CellOptions};
use host_tools::emulator::free_running::FreeRunning;
use host_tools::link::port::{Line, Port};
use host_tools::link::session::{Event, Session};
use host_tools::setup;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Wall time that even a very busy machine does not exceed.
const PATIENCE: Duration = Duration::from_secs(300);

fn config() -> Config {
    let mut config = Config::default();
    config.bus.transport = Transport::Udp;
    config.bus.segment = Ipv4Addr::new(10, 0, 2, 2);
    config.bus.watchdog_ms = 500;
    config.bus.blind_max_ms = 8;
    config
}

#[test]
fn the_firmware_finds_its_address_by_dhcp_and_brings_the_drives_to_op_over_udp() {
    setup::ensure_qemu().expect("the emulator is there");
    let image = setup::build_firmware("emulated").expect("the firmware builds");
    let config = config();
    assert_eq!(config.check(), Ok(()));
    let segment = Segment::start(&config);
    let log = |line: &host_tools::emulator::LogLine| println!("{line}");
    let running = FreeRunning::start_on_user_network(&image, Path::new("qemu-system-arm"), 0, log).expect("it starts");
    let name = format!("tcp:127.0.0.1:{}", running.port()).parse().expect("a port");
    let port = loop {
        match Port::open(&name) {
            Ok(port) => break port,
            Err(_) if running.is_running() => std::thread::sleep(Duration::from_millis(50)),
            Err(error) => panic!("{error}"),
        }
    };
    let mut line = Line::start(port);
    let mut session = Session::new(1);
    session.connect();
    session.configure(config.clone());
    let started = Instant::now();
    let operational = loop {
        assert!(running.is_running(), "the emulator ended");
        if started.elapsed() > PATIENCE {
            break false;
        }
        let exchanged = line.exchange(|now_ms, incoming, outgoing, room| {
            session.receive(incoming, now_ms);
            let mut bytes = vec![0; room];
            let length = session.transmit(now_ms, &mut bytes);
            outgoing.extend_from_slice(&bytes[..length]);
        });
        exchanged.expect("the link");
        while let Some(event) = session.next_event() {
            if !matches!(event, Event::Samples { .. } | Event::Status(_)) {
                println!("{event:?}");
            }
        }
        let state = segment.cell.lock().expect("nobody panics with it").state();
        if state.slaves.iter().all(|slave| slave.al_state == AlState::Operational) {
            break true;
        }
    };
    println!("{:?} of wall time", started.elapsed());
    running.stop().expect("it ends");
    let state = segment.cell.lock().expect("nobody panics with it").state();
    assert!(operational, "{:?}", state.slaves);
    let (packets, bytes) = segment.stop();
    println!("{packets} packets");
    assert_dissected(&bytes, packets);
}

/// Looks for EtherCAT in UDP and for anything malformed in a capture, with tshark if there is one.
fn assert_dissected(capture: &[u8], packets: u32) {
    let path = std::env::temp_dir().join(format!("udp-firmware-{}.pcapng", std::process::id()));
    std::fs::write(&path, capture).expect("a temporary file");
    let count = |filter: &str| {
        let output = Command::new("tshark")
            .arg("-r")
            .arg(&path)
            .args(["-Y", filter])
            .output();
        output
            .ok()
            .map(|output| String::from_utf8_lossy(&output.stdout).lines().count())
    };
    let counts = (
        count("_ws.malformed || _ws.expert.severity >= \"Error\""),
        count("udp && ecat"),
    );
    std::fs::remove_file(&path).expect("the file just written");
    let (Some(damaged), Some(frames)) = counts else {
        eprintln!("tshark is not installed: nothing was dissected");
        return;
    };
    println!("tshark: {frames} frames of EtherCAT in UDP, {damaged} damaged");
    assert_eq!(damaged, 0);
    assert!(frames >= packets as usize);
}

/// The cell behind a socket, answered from a thread of its own: the firmware waits for no other.
struct Segment {
    cell: Arc<Mutex<Cell>>,
    ended: Arc<AtomicBool>,
    thread: JoinHandle<(u32, Vec<u8>)>,
}

impl Segment {
    fn start(config: &Config) -> Self {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, UDP_PORT)).expect("EtherCAT's UDP port is free");
        let timeout = Duration::from_millis(5);
        socket.set_read_timeout(Some(timeout)).expect("a socket");
        let cell = Arc::new(Mutex::new(Cell::new(config, CellOptions::default())));
        let ended = Arc::new(AtomicBool::new(false));
        let thread = std::thread::spawn({
            let (cell, ended) = (cell.clone(), ended.clone());
            move || serve(&socket, &cell, &ended)
        });
        Self { cell, ended, thread }
    }

    /// Ends the segment; returns the number of packets, and the capture.
    fn stop(self) -> (u32, Vec<u8>) {
        self.ended.store(true, Ordering::Relaxed);
        self.thread.join().expect("the segment's thread ends well")
    }
}

fn serve(socket: &UdpSocket, cell: &Mutex<Cell>, ended: &AtomicBool) -> (u32, Vec<u8>) {
    let mut capture = Capture::new(Vec::new()).expect("memory");
    let (started, mut packets) = (Instant::now(), 0);
    while !ended.load(Ordering::Relaxed) {
        let mut payload = [0; 1_500];
        let received = socket.recv_from(&mut payload);
        let time_us = started.elapsed().as_micros() as u64;
        let mut cell = cell.lock().expect("nobody panics with it");
        cell.advance_to(time_us);
        if let Ok((length, peer)) = received {
            packets += 1;
            let replies = cell.payload(time_us, &payload[..length]);
            for reply in &replies {
                socket.send_to(reply, peer).expect("the emulator listens");
            }
            record(&mut capture, time_us, peer, &payload[..length], &replies);
        }
    }
    (packets, capture.finish().expect("memory"))
}

/// Writes a packet and its replies as the wire would have carried them.
fn record(capture: &mut Capture<Vec<u8>>, time_us: u64, peer: SocketAddr, request: &[u8], replies: &[Vec<u8>]) {
    let IpAddr::V4(address) = peer.ip() else { return };
    let there = UdpRepr::request([0x10, 0, 0, 0, 0, 1], address, Ipv4Addr::LOCALHOST);
    let back = UdpRepr {
        source: there.destination,
        destination: there.source,
        destination_port: peer.port(),
        ..there
    };
    let sent = core::iter::once((Direction::Sent, there, request));
    let received = replies
        .iter()
        .map(|reply| (Direction::Received, back, reply.as_slice()));
    for (direction, headers, payload) in sent.chain(received) {
        let mut frame = [0; 1_600];
        frame[42..42 + payload.len()].copy_from_slice(payload);
        let length = headers.emit(&mut frame, payload.len()).expect("room");
        capture.record(time_us, direction, &frame[..length]).expect("memory");
    }
}
