use super::*;
use etherpen_ethercat::wire::{Address, Command, FrameBuilder, FrameView, UdpRepr};
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

const WAIT: Duration = Duration::from_secs(10);
const SOURCE: [u8; 6] = [0x10, 0, 0, 0, 0, 1];

/// A path that only one test uses.
struct Place(PathBuf);

impl Place {
    fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        Self(std::env::temp_dir().join(format!("etherpen-way-{}-{number}", std::process::id())))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        // Most tests leave nothing.
        let _ = std::fs::remove_file(&self.0);
    }
}

fn request() -> Vec<u8> {
    let mut frame = [0; FRAME_LEN_MAX];
    let mut builder = FrameBuilder::new(&mut frame, SOURCE).expect("room");
    builder
        .push(Command::Brd, 7, Address::broadcast(0x0130), 2)
        .expect("room");
    let length = builder.finish();
    frame[..length].to_vec()
}

/// Sends a frame to a segment, which echoes it; returns what both received.
fn there_and_back(port: &mut dyn SegmentPort, frame: &[u8]) -> (Vec<u8>, Vec<u8>) {
    let mut transport = open(&port.endpoint()).expect("the segment listens");
    transport.send(frame).expect("it is sent");
    let (master, seen) = port.receive(WAIT).expect("the socket lives").expect("a frame");
    port.send(master, &seen).expect("it is sent");
    let mut reply = [0; FRAME_LEN_MAX];
    let length = transport.receive(&mut reply, WAIT).expect("the socket lives");
    (seen, reply[..length.expect("a reply")].to_vec())
}

#[test]
fn a_unix_socket_carries_a_frame_in_a_message_and_leaves_nothing() {
    let place = Place::new();
    let mut port = listen(&Endpoint::Unix(place.0.clone())).expect("a path of our own");
    let (seen, reply) = there_and_back(&mut *port, &request());
    assert_eq!((&seen, &reply), (&request(), &request()));
    drop(port);
    assert!(!place.0.exists());
}

#[test]
fn several_masters_share_a_unix_socket_and_each_gets_its_own_replies() {
    let place = Place::new();
    let mut port = listen(&Endpoint::Unix(place.0.clone())).expect("a path of our own");
    let mut masters: Vec<_> = (0..3).map(|_| open(&port.endpoint()).expect("room")).collect();
    for (number, master) in masters.iter_mut().enumerate() {
        master.send(&[number as u8; 60]).expect("it is sent");
    }
    for _ in 0..3 {
        let (master, mut frame) = loop {
            if let Some(received) = port.receive(WAIT).expect("the socket lives") {
                break received;
            }
        };
        frame[1] = 0xAA;
        port.send(master, &frame).expect("it is sent");
    }
    for (number, master) in masters.iter_mut().enumerate() {
        let mut frame = [0; FRAME_LEN_MAX];
        let length = master.receive(&mut frame, WAIT).expect("the socket lives");
        assert_eq!((length, frame[0], frame[1]), (Some(60), number as u8, 0xAA));
    }
    drop(masters);
    assert!(port.receive(Duration::ZERO).expect("masters may go").is_none());
}

#[test]
fn a_master_learns_that_the_segment_has_gone() {
    let place = Place::new();
    let port = listen(&Endpoint::Unix(place.0.clone())).expect("a path of our own");
    let mut transport = open(&port.endpoint()).expect("the segment listens");
    drop(port);
    assert!(transport.receive(&mut [0; 64], WAIT).is_err());
}

fn refused(place: &Path) -> TransportError {
    listen(&Endpoint::Unix(place.into())).err().expect("a refusal")
}

#[test]
fn a_socket_left_behind_is_replaced_and_one_in_use_is_not() {
    let place = Place::new();
    drop(UnixListener::bind(&place.0).expect("a path of our own"));
    let port = listen(&Endpoint::Unix(place.0.clone())).expect("nobody listens at the old one");
    assert!(matches!(refused(&place.0), TransportError::PathInUse(path) if path == place.0));
    drop(port);
    let stream = UnixListener::bind(&place.0).expect("a path of our own");
    assert!(
        matches!(refused(&place.0), TransportError::PathInUse(_)),
        "another kind of socket"
    );
    drop(stream);
    std::fs::remove_file(&place.0).expect("the test's own");
    std::fs::write(&place.0, "data").expect("a file");
    assert!(matches!(refused(&place.0), TransportError::NoSocket(_)));
    assert_eq!(std::fs::read(&place.0).expect("it is still there"), b"data");
}

#[test]
fn a_path_where_nobody_listens_is_answered_with_what_to_start() {
    let place = Place::new();
    let error = open(&Endpoint::Unix(place.0.clone())).err().expect("nobody listens");
    let text = error.to_string();
    assert!(
        text.contains("etherpen segment --unix") && text.contains(&*place.0.to_string_lossy()),
        "{text}"
    );
}

#[test]
fn udp_carries_what_follows_the_ethernet_header_and_shows_whole_frames() {
    let any = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0);
    let mut port = listen(&Endpoint::Udp(any)).expect("a free port");
    let frame = request();
    let (seen, reply) = there_and_back(&mut *port, &frame);
    assert!(seen[12..14] == [0x08, 0x00] && seen[23] == 17);
    assert_eq!(seen[36..38], UDP_PORT.to_be_bytes(), "to the standard's port");
    let (_, payload) = UdpRepr::parse(&seen).expect("EtherCAT in UDP");
    assert_eq!(
        seen[payload],
        *ethercat_part(&request()).expect("EtherCAT"),
        "without padding"
    );
    let view = FrameView::new_checked(&reply).expect("a whole frame again");
    assert_eq!(
        (reply.len(), view.source()),
        (60, [0x12, 0, 0, 0, 0, 1]),
        "padded and marked"
    );
    assert_eq!(reply[14..], frame[14..]);
}

#[test]
fn a_taken_udp_port_is_named() {
    let any = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0);
    let port = listen(&Endpoint::Udp(any)).expect("a free port");
    let error = listen(&port.endpoint()).err().expect("it is taken");
    assert!(matches!(error, TransportError::PortInUse(_)), "{error}");
    assert!(error.to_string().contains("taken by another program"));
    let away = SocketAddrV4::new(Ipv4Addr::new(192, 0, 2, 1), 0);
    let error = listen(&Endpoint::Udp(away))
        .err()
        .expect("an address for documentation");
    assert!(matches!(error, TransportError::NotHere(_)), "{error}");
}

#[test]
fn a_missing_interface_lists_those_that_exist() {
    let error = open(&Endpoint::Interface("absent0".into()))
        .err()
        .expect("there is none");
    let text = error.to_string();
    assert!(text.contains("absent0") && text.contains(" lo"), "{text}");
}

#[test]
fn addresses_have_the_standards_port_unless_another_is_given() {
    let local = |port| Ok(SocketAddrV4::new(Ipv4Addr::LOCALHOST, port));
    assert_eq!(udp_address("127.0.0.1"), local(34_980));
    assert_eq!(udp_address("127.0.0.1:7"), local(7));
    assert_eq!(udp_address(":0"), Ok(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0)));
    assert!(udp_address("127.0.0.1:70000").is_err());
    assert!(udp_address("[::1]:7").is_err());
}
