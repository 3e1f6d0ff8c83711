//! Requirements of the firmware's end of the link.

use super::*;
use crate::example::{Command, Example, Refusal, Status, check, command, configuration, part};
use crate::frame::{Decoder, encode};
use crate::message::Hello;
use core::cell::Cell;
use proptest::prelude::*;

type DeviceEndpoint = super::DeviceEndpoint<Example>;
type DeviceEvent = super::DeviceEvent<Example>;
type HostMessage = crate::message::HostMessage<Example>;
type DeviceMessage = crate::message::DeviceMessage<Example>;

const IDENTITY: Identity = Identity {
    firmware: "0.1.0",
    board: "simulation",
    capacity: 512,
};

fn endpoint() -> DeviceEndpoint {
    let mut endpoint = DeviceEndpoint::new(IDENTITY);
    assert_eq!(
        say(&mut endpoint, 0, 9, &hello(1)).as_slice(),
        &[DeviceEvent::Connected]
    );
    endpoint
}

fn hello(session: u32) -> HostMessage {
    HostMessage::Hello(Hello {
        protocol: Example::VERSION,
        session,
    })
}

fn path(first: u32, count: usize, last: bool) -> HostMessage {
    HostMessage::Path {
        job: 3,
        first,
        vertices: part(first, count),
        last,
    }
}

fn say(
    endpoint: &mut DeviceEndpoint,
    now_ms: u64,
    free: usize,
    message: &HostMessage,
) -> heapless::Vec<DeviceEvent, 4> {
    let mut frame = [0; FRAME_BYTES_MAX];
    let length = encode(message, &mut frame).unwrap();
    take(
        &mut Decoder::new(),
        endpoint,
        LinkPort::Serial,
        &frame[..length],
        now_ms,
        free,
    )
}

fn take(
    decoder: &mut Decoder,
    endpoint: &mut DeviceEndpoint,
    port: LinkPort,
    bytes: &[u8],
    now_ms: u64,
    free: usize,
) -> heapless::Vec<DeviceEvent, 4> {
    let events = bytes.iter().filter_map(|byte| {
        let payload = decoder.push(*byte)?.ok()?;
        endpoint.receive(port, payload, now_ms, free)
    });
    events.collect()
}

fn hear(endpoint: &mut DeviceEndpoint, now_ms: u64) -> heapless::Vec<DeviceMessage, 16> {
    let mut bytes = [0; 4 * FRAME_BYTES_MAX];
    let length = endpoint.transmit(now_ms, &mut bytes);
    let mut decoder: Decoder = Decoder::new();
    let messages = bytes[..length].iter().filter_map(|byte| {
        let payload = decoder.push(*byte)?.unwrap();
        Some(decode(payload).unwrap())
    });
    messages.collect()
}

fn drawing() -> DeviceEndpoint {
    let mut endpoint = endpoint();
    say(&mut endpoint, 0, 100, &command(1, Command::Draw { job: 3 }));
    endpoint.answer(1, Ok(()));
    hear(&mut endpoint, 0);
    endpoint
}

#[test]
fn a_stop_with_the_number_of_another_request_is_carried_out_once() {
    let mut endpoint = drawing();
    let enable = say(&mut endpoint, 1, 100, &command(7, Command::Enable));
    assert_eq!(enable.len(), 1);
    endpoint.answer(7, Ok(()));
    hear(&mut endpoint, 1);
    let expected = DeviceEvent::Command {
        id: 7,
        command: Command::Stop,
    };
    assert_eq!(
        say(&mut endpoint, 2, 100, &command(7, Command::Stop)).as_slice(),
        &[expected]
    );
    assert!(say(&mut endpoint, 3, 100, &command(7, Command::Stop)).is_empty());
    // The answer is that of the stop: it closes the path.
    endpoint.answer(7, Ok(()));
    assert!(say(&mut endpoint, 4, 100, &path(0, 2, false)).is_empty());
    // A late repetition of the other request is none of a new one.
    assert!(say(&mut endpoint, 5, 100, &command(7, Command::Enable)).is_empty());
}

#[test]
fn another_version_is_answered_with_ours_and_everything_else_refused_until_the_right_greeting() {
    let mut endpoint: DeviceEndpoint = DeviceEndpoint::new(IDENTITY);
    let wrong = HostMessage::Hello(Hello {
        protocol: Example::VERSION + 1,
        session: 5,
    });
    assert!(say(&mut endpoint, 0, 0, &wrong).is_empty());
    let answer = hear(&mut endpoint, 0);
    assert!(matches!(&answer[..], [DeviceMessage::Welcome(welcome)]
        if welcome.protocol == Example::VERSION && welcome.session == 0 && welcome.board == "simulation"));
    assert!(say(&mut endpoint, 1, 0, &command(1, Command::Enable)).is_empty());
    assert_eq!((endpoint.counts().refused, endpoint.silence_ms(9)), (1, None));
    assert_eq!(
        say(&mut endpoint, 2, 0, &hello(5)).as_slice(),
        &[DeviceEvent::Connected]
    );
    assert!(
        say(&mut endpoint, 3, 0, &hello(5)).is_empty(),
        "a repeated greeting is no new connection"
    );
    assert_eq!(endpoint.silence_ms(13), Some(10));
}

#[test]
fn every_greeting_is_answered_with_the_end_of_the_previous_run() {
    let mut endpoint: DeviceEndpoint = DeviceEndpoint::new(IDENTITY);
    for (session, previous) in [(1, Example::NO_PREVIOUS_RUN), (2, 9), (3, 9)] {
        if previous != Example::NO_PREVIOUS_RUN {
            endpoint.set_previous_run(previous);
        }
        say(&mut endpoint, 0, 9, &hello(session));
        let answer = hear(&mut endpoint, 0);
        assert!(
            matches!(&answer[..], [DeviceMessage::Welcome(welcome)] if welcome.previous == previous),
            "{answer:?}"
        );
    }
}

#[test]
fn a_repeated_request_is_answered_again_but_handed_out_once() {
    let mut endpoint = endpoint();
    hear(&mut endpoint, 0);
    let enable = command(7, Command::Enable);
    assert_eq!(say(&mut endpoint, 1, 0, &enable).len(), 1);
    assert!(say(&mut endpoint, 2, 0, &enable).is_empty());
    assert!(hear(&mut endpoint, 2).is_empty(), "no answer before the application's");
    endpoint.answer(7, Err(Refusal::NotReady));
    let answer = DeviceMessage::Answer {
        id: 7,
        result: Err(Refusal::NotReady),
    };
    assert_eq!(&hear(&mut endpoint, 3)[..], core::slice::from_ref(&answer));
    assert!(say(&mut endpoint, 4, 0, &enable).is_empty());
    assert_eq!(&hear(&mut endpoint, 4)[..], &[answer]);
    let configure = HostMessage::Configure {
        id: 8,
        config: configuration(),
    };
    assert_eq!(say(&mut endpoint, 5, 0, &configure).len(), 1);
    endpoint.configured(8, Ok(99));
    assert!(say(&mut endpoint, 6, 0, &configure).is_empty());
    assert_eq!(
        &hear(&mut endpoint, 6)[..],
        &[DeviceMessage::Configured { id: 8, result: Ok(99) }]
    );
}

#[test]
fn on_a_slow_line_the_oldest_samples_are_dropped_counted_and_seen_in_the_sequence() {
    let mut endpoint = endpoint();
    hear(&mut endpoint, 0);
    (0..100).for_each(|t_ms| endpoint.sample([t_ms as f32; 4]));
    assert_eq!(endpoint.counts().samples_dropped, 36);
    let messages = hear(&mut endpoint, 1);
    assert!(matches!(&messages[0], DeviceMessage::Telemetry { sequence: 36, samples } if samples.len() == 4));
}

#[test]
fn nothing_is_chosen_before_there_is_room_so_that_the_most_urgent_goes_first() {
    let mut endpoint = endpoint();
    hear(&mut endpoint, 0);
    endpoint.status(Status::long(1));
    assert_eq!(endpoint.transmit(1, &mut []), 0);
    say(&mut endpoint, 2, 0, &command(2, Command::Stop));
    endpoint.answer(2, Ok(()));
    let messages = hear(&mut endpoint, 2);
    assert!(matches!(
        messages[..],
        [DeviceMessage::Answer { id: 2, .. }, DeviceMessage::Status(_)]
    ));
}

#[test]
fn a_frame_once_begun_is_finished_before_a_more_urgent_one() {
    let mut endpoint = endpoint();
    hear(&mut endpoint, 0);
    endpoint.status(Status::long(1));
    let mut bytes = [0; FRAME_BYTES_MAX];
    assert_eq!(endpoint.transmit(1, &mut bytes[..10]), 10);
    say(&mut endpoint, 2, 0, &command(2, Command::Stop));
    endpoint.answer(2, Ok(()));
    let length = 10 + endpoint.transmit(2, &mut bytes[10..]);
    let mut decoder: Decoder = Decoder::new();
    let mut kinds = bytes[..length].iter().filter_map(|byte| {
        let payload = decoder.push(*byte)?.unwrap();
        Some(matches!(decode(payload).unwrap(), DeviceMessage::Status(_)))
    });
    assert_eq!((kinds.next(), kinds.next()), (Some(true), Some(false)));
}

#[test]
fn garbage_makes_no_panic_and_no_event() {
    let bytes = prop::collection::vec(prop_oneof![4 => any::<u8>(), 1 => Just(0)], 2_000..4_000);
    check(200, bytes, |bytes| {
        let (mut decoder, mut endpoint) = (Decoder::new(), endpoint());
        for (now_ms, byte) in (0..).zip(bytes) {
            prop_assert!(take(&mut decoder, &mut endpoint, LinkPort::Serial, &[byte], now_ms, 10).is_empty());
        }
        prop_assert!(decoder.counts().bad > 100, "{:?}", decoder.counts());
        Ok(())
    });
}

#[test]
fn nonsense_in_good_frames_makes_no_panic_and_never_more_vertices_than_there_is_room() {
    let content = || prop::collection::vec(small_or_any(), 0..120);
    let of_the_path = content().prop_map(|content| [&[3, 0][..], &content].concat());
    let payload = prop_oneof![2 => (0..8u8, content()), 1 => (Just(PATH), of_the_path)];
    let (events, vertices_taken) = (Cell::new(0), Cell::new(0));
    check(
        300,
        (prop::collection::vec(payload, 1..60), 0..20usize),
        |(payloads, free)| {
            let (mut decoder, mut endpoint) = (Decoder::new(), drawing());
            for (now_ms, (kind, content)) in (0..).zip(payloads) {
                let mut frame = [0; FRAME_BYTES_MAX];
                let length = encode(&Raw(kind, &content), &mut frame).unwrap();
                for event in take(
                    &mut decoder,
                    &mut endpoint,
                    LinkPort::Serial,
                    &frame[..length],
                    now_ms,
                    free,
                ) {
                    events.set(events.get() + 1);
                    match event {
                        DeviceEvent::Command { id, .. } => endpoint.answer(id, Ok(())),
                        DeviceEvent::Path { vertices, .. } => {
                            vertices_taken.set(vertices_taken.get() + vertices.len());
                            prop_assert!(vertices.len() <= free);
                        }
                        _ => {}
                    }
                }
                let mut out = [0; LINE_BYTES_PER_MS];
                endpoint.transmit(now_ms, &mut out);
            }
            Ok(())
        },
    );
    assert!(events.get() > 1_000, "only {} messages were understood", events.get());
    assert!(
        vertices_taken.get() > 50,
        "only {} vertices were taken",
        vertices_taken.get()
    );
}

/// Number of the variant [`HostMessage::Path`]; the job and the first vertex follow.
const PATH: u8 = 4;

/// Mostly small numbers, which valid messages consist of.
fn small_or_any() -> impl Strategy<Value = u8> {
    prop_oneof![9 => 0..5u8, 1 => any::<u8>()]
}

/// Bytes that are encoded as they are, without a length before them: the number of a variant, and its content.
struct Raw<'a>(u8, &'a [u8]);

impl serde::Serialize for Raw<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeTuple;
        let mut tuple = serializer.serialize_tuple(1 + self.1.len())?;
        tuple.serialize_element(&self.0)?;
        self.1.iter().try_for_each(|byte| tuple.serialize_element(byte))?;
        tuple.end()
    }
}

fn say_on(endpoint: &mut DeviceEndpoint, port: LinkPort, now_ms: u64, message: &HostMessage) -> Option<DeviceEvent> {
    let mut frame = [0; FRAME_BYTES_MAX];
    let length = encode(message, &mut frame).unwrap();
    take(&mut Decoder::new(), endpoint, port, &frame[..length], now_ms, 9).pop()
}

#[test]
fn the_link_speaks_on_the_port_of_the_host_that_greeted() {
    for port in LinkPort::ALL {
        let mut endpoint: DeviceEndpoint = DeviceEndpoint::new(IDENTITY);
        assert_eq!(say_on(&mut endpoint, port, 0, &hello(1)), Some(DeviceEvent::Connected));
        assert_eq!(endpoint.port(), port);
        assert!(matches!(&hear(&mut endpoint, 0)[..], [DeviceMessage::Welcome(welcome)] if welcome.session == 1));
    }
}

#[test]
fn a_second_host_at_the_other_port_changes_nothing_while_the_first_one_speaks() {
    let mut endpoint = drawing();
    for now_ms in (0..5_000).step_by(100) {
        say_on(&mut endpoint, LinkPort::Serial, now_ms, &HostMessage::Heartbeat);
        for message in [hello(2), command(77, Command::Cancel), path(0, 3, true)] {
            assert_eq!(say_on(&mut endpoint, LinkPort::Usb, now_ms + 50, &message), None);
        }
        assert_eq!(endpoint.port(), LinkPort::Serial);
        assert!(
            !hear(&mut endpoint, now_ms)
                .iter()
                .any(|message| matches!(message, DeviceMessage::Welcome(_) | DeviceMessage::Answer { .. }))
        );
    }
    assert_eq!(
        (endpoint.silence_ms(5_000), endpoint.counts().other_port),
        (Some(100), 150)
    );
}

#[test]
fn a_stop_is_carried_out_whoever_orders_it_and_changes_no_session() {
    let stop = DeviceEvent::Stop { command: Command::Stop };
    // Before any greeting.
    let mut endpoint: DeviceEndpoint = DeviceEndpoint::new(IDENTITY);
    assert_eq!(
        say_on(&mut endpoint, LinkPort::Serial, 0, &command(1, Command::Stop)),
        Some(stop.clone())
    );
    assert!(!endpoint.connected());
    // At the port of nobody's link, with the number of a command that waits for its answer.
    let mut endpoint = drawing();
    say(&mut endpoint, 1, 9, &command(7, Command::Enable));
    assert_eq!(
        say_on(&mut endpoint, LinkPort::Usb, 2, &command(7, Command::Stop)),
        Some(stop)
    );
    assert_eq!((endpoint.port(), endpoint.connected()), (LinkPort::Serial, true));
    let answered = |message: &DeviceMessage| matches!(message, DeviceMessage::Answer { .. });
    assert!(
        !hear(&mut endpoint, 3).iter().any(answered),
        "nobody asked for an answer"
    );
}

#[test]
fn a_host_at_the_other_port_takes_over_when_the_cable_of_the_first_one_has_gone() {
    let mut endpoint = drawing();
    let gone_ms = crate::ports::HELD_MS;
    // A frame that was started on the old port is not continued on the new one.
    endpoint.answer(1, Ok(()));
    let mut begun = [0; 3];
    assert_eq!(endpoint.transmit(0, &mut begun), 3);
    assert_eq!(
        say_on(&mut endpoint, LinkPort::Usb, gone_ms, &hello(2)),
        Some(DeviceEvent::Connected)
    );
    assert_eq!(
        (endpoint.port(), endpoint.silence_ms(gone_ms)),
        (LinkPort::Usb, Some(0))
    );
    let mut out = [0; 2 * FRAME_BYTES_MAX];
    let length = endpoint.transmit(gone_ms, &mut out);
    // The start of the cut frame, still in the line, does not damage the frames behind it.
    let mut decoder: Decoder = Decoder::new();
    let heard = begun.iter().chain(&out[..length]).filter_map(|byte| {
        let payload = decoder.push(*byte)?.ok()?;
        decode::<DeviceMessage>(payload).ok()
    });
    let heard: heapless::Vec<DeviceMessage, 16> = heard.collect();
    assert!(matches!(&heard[..], [DeviceMessage::Welcome(welcome), ..] if welcome.session == 2));
    assert_eq!(out.first(), Some(&0));
}

#[test]
fn a_host_that_takes_over_without_a_greeting_has_no_part_in_the_session_of_another() {
    let mut endpoint = endpoint();
    hear(&mut endpoint, 0);
    let later_ms = crate::ports::HELD_MS;
    assert_eq!(
        say_on(&mut endpoint, LinkPort::Usb, later_ms, &command(5, Command::Enable)),
        None
    );
    assert_eq!((endpoint.counts().refused, endpoint.silence_ms(later_ms)), (1, None));
    assert!(
        matches!(&hear(&mut endpoint, later_ms)[..], [DeviceMessage::Welcome(welcome)] if welcome.session == 0),
        "it is told to greet"
    );
}
