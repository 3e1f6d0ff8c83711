//! The stack against a small network: ARP and DHCP answered by hand, in virtual time.

extern crate std;

use super::*;
use crate::config::HostAddress;
use core::future::Future;
use core::net::Ipv4Addr;
use core::pin::pin;
use core::task::{Context, Waker};
use std::boxed::Box;
use std::println;
use std::vec::Vec as StdVec;

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const PEER: [u8; 6] = [2, 3, 4, 5, 6, 7];
const OWN: Ipv4Addr = Ipv4Addr::new(192, 168, 7, 2);
const SEGMENT: Ipv4Addr = Ipv4Addr::new(192, 168, 7, 9);

fn settings() -> NetworkSettings {
    NetworkSettings {
        address: HostAddress::Fixed {
            address: OWN,
            prefix: 24,
        },
        gateway: None,
        segment: SEGMENT,
    }
}

/// Answer of `PEER`, who has `address`, to a request for it.
fn arp_reply(request: &[u8], address: Ipv4Addr) -> Option<StdVec<u8>> {
    let asks = request.get(12..14) == Some(&[8, 6]) && request.get(38..42) == Some(&address.octets());
    asks.then(|| {
        let mut reply = StdVec::new();
        reply.extend(&request[6..12]);
        reply.extend(PEER);
        reply.extend(&request[12..20]);
        reply.extend([0, 2]);
        reply.extend(PEER);
        reply.extend(address.octets());
        reply.extend(&request[22..32]);
        reply
    })
}

/// Runs a task with these settings for some milliseconds; `answer` returns the network's replies to each frame. Returns
/// the changes of the path with their times.
fn run<Answer: IntoIterator<Item = StdVec<u8>>>(
    settings: NetworkSettings,
    limit_ms: u32,
    answer: impl FnMut(u32, &[u8]) -> Answer,
) -> StdVec<(u32, Option<UdpRepr>)> {
    run_with(&[(0, Some(settings))], limit_ms, answer)
}

/// Runs a task whose settings change at these times, ms.
fn run_with<Answer: IntoIterator<Item = StdVec<u8>>>(
    settings: &[(u32, Option<NetworkSettings>)],
    limit_ms: u32,
    mut answer: impl FnMut(u32, &[u8]) -> Answer,
) -> StdVec<(u32, Option<UdpRepr>)> {
    let queues = Box::leak(Box::new(NetworkQueues::new()));
    let (mut end, mut task, mut configure) = queues.split();
    let mut life = pin!(async move { task.run().await });
    let mut news = StdVec::new();
    for ms in 0..limit_ms {
        for (_, settings) in settings.iter().filter(|(at_ms, _)| *at_ms == ms) {
            assert!(configure.enqueue(*settings).is_ok());
        }
        embassy_time::MockDriver::get().advance(embassy_time::Duration::from_millis(1));
        assert!(life.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending());
        let mut replies = StdVec::new();
        end.send_next(|frame| {
            assert!(!is_ethercat(frame), "the probe stays inside");
            replies.extend(answer(ms, frame));
        });
        for reply in replies {
            assert!(end.offer(&reply));
        }
        while let Some(path) = end.next_path() {
            println!("{ms} ms: {path:?}");
            news.push((ms, path));
        }
    }
    news
}

#[test]
fn the_path_is_known_as_soon_as_the_segment_answers_and_lost_when_it_stays_silent() {
    let news = run(settings(), 80_000, |ms, frame| {
        (ms < 2_000).then(|| arp_reply(frame, SEGMENT)).flatten()
    });
    let expected = UdpRepr {
        source_mac: MAC,
        destination_mac: PEER,
        source: OWN,
        destination: SEGMENT,
        source_port: UDP_PORT,
        destination_port: UDP_PORT,
    };
    assert_eq!(news.len(), 2, "{news:?}");
    assert!(news[0].0 < 500 && news[0].1 == Some(expected), "{news:?}");
    assert!(news[1].1.is_none() && news[1].0 < 75_000, "{news:?}");
}

#[test]
fn other_settings_end_the_path_at_once_and_lead_to_another_one() {
    let other = Ipv4Addr::new(192, 168, 7, 33);
    let elsewhere = NetworkSettings {
        segment: other,
        ..settings()
    };
    let changes = [(0, Some(settings())), (1_000, None), (1_500, Some(elsewhere))];
    let news = run_with(&changes, 2_500, |_, frame| {
        arp_reply(frame, SEGMENT).or_else(|| arp_reply(frame, other))
    });
    let destinations: StdVec<_> = news
        .iter()
        .map(|(_, path)| path.as_ref().map(|path| path.destination))
        .collect();
    assert_eq!(destinations, [Some(SEGMENT), None, Some(other)], "{news:?}");
    assert!(news[1].0 < 1_010 && news[2].0 < 2_000, "{news:?}");
}

#[test]
fn nothing_is_reported_while_nobody_answers() {
    assert!(run(settings(), 3_000, |_, _| None::<StdVec<u8>>).is_empty());
}

#[test]
fn a_segment_on_another_network_is_reached_through_the_gateway() {
    let gateway = Ipv4Addr::new(192, 168, 7, 1);
    let far = NetworkSettings {
        gateway: Some(gateway),
        segment: Ipv4Addr::new(10, 9, 8, 7),
        ..settings()
    };
    let news = run(far, 1_000, |_, frame| arp_reply(frame, gateway));
    assert!(
        matches!(news[..], [(_, Some(path))] if path.destination_mac == PEER && path.destination == far.segment),
        "{news:?}"
    );
}

/// An echo request of `PEER` in an IP packet of this length.
fn echo_request(length: u16) -> StdVec<u8> {
    let checksum = |bytes: &[u8]| {
        let words = bytes.chunks(2);
        let sum: u32 = words
            .map(|word| u32::from(word[0]) << 8 | word.get(1).map_or(0, |low| u32::from(*low)))
            .sum();
        (!((sum & 0xFFFF) + (sum >> 16)) as u16).to_be_bytes()
    };
    let [high, low] = length.to_be_bytes();
    let mut packet = StdVec::from([0x45, 0, high, low, 0, 0, 0, 0, 64, 1, 0, 0]);
    packet.extend(SEGMENT.octets());
    packet.extend(OWN.octets());
    let sum = checksum(&packet);
    packet[10..12].copy_from_slice(&sum);
    packet.extend([8, 0, 0, 0, 0x12, 0x34, 0, 1]);
    packet.extend((28..length).map(|at| at as u8));
    let sum = checksum(&packet[20..]);
    packet[22..24].copy_from_slice(&sum);
    [&MAC[..], &PEER, &[8, 0], &packet].concat()
}

#[test]
fn an_echo_request_of_any_length_up_to_the_longest_packet_is_answered_whole() {
    for length in [28, 29, 100, PACKET_BYTES_MAX - 1, PACKET_BYTES_MAX] {
        let request = echo_request(length as u16);
        let mut answers = StdVec::new();
        run(settings(), 600, |_, frame| {
            if frame.get(12..14) == Some(&[8, 0]) {
                answers.push(frame.to_vec());
            }
            // As soon as the stack knows whom to answer.
            let known = arp_reply(frame, SEGMENT);
            known
                .into_iter()
                .flat_map(|known| [known, request.clone()])
                .collect::<StdVec<_>>()
        });
        let [answer] = &answers[..] else {
            panic!("{length} bytes: {answers:?}");
        };
        let ends = [&PEER[..], &MAC].concat();
        assert_eq!((answer.len(), &answer[..12]), (14 + length, &ends[..]));
        // An answer with the number and the data of the request.
        assert_eq!((answer[34], &answer[38..]), (0, &request[38..]), "{length} bytes");
    }
}

#[test]
fn ethercat_stays_with_the_exchange_and_everything_else_goes_to_the_stack_as_far_as_there_is_room() {
    let queues = Box::leak(Box::new(NetworkQueues::new()));
    let (mut end, _task, _configure) = queues.split();
    let mut raw = [0; 60];
    raw[12..14].copy_from_slice(&[0x88, 0xA4]);
    assert!(!end.offer(&raw));
    let mut udp = [0; 80];
    UdpRepr::request(MAC, OWN, SEGMENT).emit(&mut udp, 20).unwrap();
    assert!(!end.offer(&udp[..62]));
    udp[34..38].copy_from_slice(&[0, 68, 0, 67]);
    for number in 0..10 {
        assert!(end.offer(&udp), "{number}");
    }
    assert_eq!(end.dropped() as usize, 10 - (RECEIVED_PLACES - 1));
    for short in 0..60 {
        end.offer(&raw[..short]);
    }
    assert!(end.offer(&[0; 1514]));
}
