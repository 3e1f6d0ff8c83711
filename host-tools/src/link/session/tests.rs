//! A session against a rig, over lines that spoil bytes.

use super::*;
use crate::link::rig::{CAPACITY, Rig, path};
use etherpen::application::Mode;
use etherpen::ethercat::diagnostics::ServiceReply;

const SEEDS: [u64; 4] = [1, 2, 0xfeed, 0x5eed_cafe];

fn exchange(rig: &mut Rig, session: &mut Session, now_ms: u64) -> Vec<Event> {
    rig.step(now_ms, |arrived, room| {
        session.receive(arrived, now_ms);
        let mut out = vec![0; room];
        let length = session.transmit(now_ms, &mut out);
        out.truncate(length);
        out
    });
    std::iter::from_fn(|| session.next_event()).collect()
}

/// Connects, enables and draws `count` vertices; returns the time it took and the samples.
fn draw(rig: &mut Rig, session: &mut Session, count: usize, limit_ms: u64) -> (u64, Vec<Sample>) {
    let mut all = Vec::new();
    rig.mode = Mode::Idle;
    session.connect();
    session.command(Command::Override { percent: 90 });
    session.command(Command::Draw { job: 5 });
    session.command(Command::Override { percent: 80 });
    for now_ms in 0..limit_ms {
        for event in exchange(rig, session, now_ms) {
            match event {
                Event::Answered {
                    command: Command::Draw { job },
                    result: Ok(()),
                    ..
                } => session.start_path(job, path(count).into()),
                Event::Ack(ack) if ack.finished => return (now_ms, all),
                Event::Samples { samples, .. } => all.extend(samples),
                _ => {}
            }
        }
        assert!(session.in_flight() <= CAPACITY);
    }
    panic!("not drawn within {limit_ms} ms");
}

#[test]
fn over_a_perfect_line_the_path_arrives_in_time_and_no_sample_is_lost() {
    let (mut rig, mut session) = (Rig::new(1, 0), Session::new(9));
    let (took_ms, _) = draw(&mut rig, &mut session, 5_000, 10_000);
    assert_eq!(rig.vertices, path(5_000));
    assert!(
        took_ms < 5_100,
        "one vertex a millisecond without a pause, took {took_ms} ms"
    );
    let counts = session.counts();
    assert_eq!(
        (counts.samples_missing, counts.path_repeats, counts.requests_repeated),
        (0, 0, 0)
    );
    assert_eq!((counts.frames.bad, rig.decoder.counts().bad), (0, 0));
    assert!(u64::from(rig.endpoint.counts().samples_dropped) == 0 && counts.samples > took_ms - 20);
}

#[test]
fn over_a_line_that_spoils_bytes_the_path_is_complete_and_in_order_and_commands_are_carried_out_once() {
    for (seed, faults_per_million) in SEEDS
        .into_iter()
        .flat_map(|seed| [(seed, 100), (seed, 500), (seed, 2_500)])
    {
        let (mut rig, mut session) = (Rig::new(seed, faults_per_million), Session::new(9));
        let (took_ms, samples) = draw(&mut rig, &mut session, 3_000, 120_000);
        println!("seed {seed:#x}, {faults_per_million} faults of each kind per million bytes: {took_ms} ms");
        assert_eq!(rig.vertices, path(3_000), "seed {seed:#x}");
        let expected = [
            Command::Override { percent: 90 },
            Command::Draw { job: 5 },
            Command::Override { percent: 80 },
        ];
        assert_eq!(rig.commands, expected, "seed {seed:#x}");
        let counts = session.counts();
        assert!(
            counts.frames.bad > 10 && counts.path_repeats > 0,
            "seed {seed:#x}: {counts:?}"
        );
        let [first, last] = [0, samples.len() - 1].map(|place| u64::from(samples[place].t_ms));
        assert_eq!(
            counts.samples + counts.samples_missing,
            last - first + 1,
            "seed {seed:#x}"
        );
        assert!(samples.is_sorted_by(|a, b| a.t_ms < b.t_ms), "seed {seed:#x}");
        assert!(counts.samples_missing > 0);
    }
}

#[test]
fn stop_overtakes_requests_that_have_no_answer() {
    let mut rig = Rig::new(1, 0);
    let mut session = Session::new(3);
    rig.mode = Mode::Idle;
    session.connect();
    (0..20).for_each(|now_ms| drop(exchange(&mut rig, &mut session, now_ms)));
    session.configure(Config::default());
    session.command(Command::Acknowledge);
    session.command(Command::Stop);
    let events = (20..40).flat_map(|now_ms| exchange(&mut rig, &mut session, now_ms));
    let answers = events.filter(|event| matches!(event, Event::Answered { .. })).count();
    assert_eq!((answers, rig.commands.as_slice()), (1, &[Command::Stop][..]));
}

#[test]
fn a_firmware_of_another_version_is_refused_with_both_versions_and_hears_nothing_more() {
    let mut session = Session::new(3);
    session.connect();
    let mut out = [0; FRAME_BYTES_MAX];
    assert!(session.transmit(0, &mut out) > 0);
    // A welcome of a later version whose other fields this program does not know.
    let later = PROTOCOL_VERSION + 1;
    let length = encode(&(0u8, later, 0xffu8, 0xffu8), &mut out).unwrap();
    session.receive(&out[..length], 1);
    let refused = Event::VersionRefused {
        host: PROTOCOL_VERSION,
        firmware: later,
    };
    assert_eq!(session.next_event(), Some(refused));
    assert_eq!(session.transmit(1_000, &mut out), 0);
}

#[test]
fn a_reset_of_the_firmware_is_noticed() {
    let mut session = Session::new(3);
    let mut rig = Rig::new(1, 0);
    session.connect();
    (0..50).for_each(|now_ms| drop(exchange(&mut rig, &mut session, now_ms)));
    assert!(session.connected());
    let mut rig = Rig::new(1, 0);
    let mut events = (50..300).flat_map(|now_ms| exchange(&mut rig, &mut session, now_ms));
    assert!(events.any(|event| event == Event::Restarted));
}

#[test]
fn garbage_makes_no_panic_and_no_event() {
    for seed in SEEDS {
        let mut random = crate::random::Random::new(seed);
        let mut session = Session::new(3);
        session.connect();
        let bytes: Vec<u8> = (0..100_000)
            .map(|_| {
                if random.bits().is_multiple_of(16) {
                    0
                } else {
                    random.bits() as u8
                }
            })
            .collect();
        session.receive(&bytes, 5);
        assert_eq!(session.next_event(), None, "seed {seed:#x}");
        assert!(session.counts().frames.bad > 1_000);
    }
}

#[test]
fn a_question_to_the_bus_is_asked_once_and_answered_once_over_a_line_that_spoils_bytes() {
    for seed in SEEDS {
        println!("seed {seed:#x}");
        let (mut rig, mut session) = (Rig::new(seed, 2_000), Session::new(3));
        session.connect();
        for slave in 0..20 {
            session.bus(ServiceRequest::Slave { slave });
        }
        let mut answers = Vec::new();
        for now_ms in 0..20_000 {
            answers.extend(
                exchange(&mut rig, &mut session, now_ms)
                    .into_iter()
                    .filter_map(|event| match event {
                        Event::Bus(Ok(ServiceReply::Bus(info))) => Some(info.slaves),
                        _ => None,
                    }),
            );
        }
        assert_eq!(answers, (1..=20).collect::<Vec<u8>>());
        assert_eq!(rig.asked.len(), 20);
    }
}

#[test]
fn a_silent_session_sends_heartbeats_that_the_firmware_hears() {
    let (mut rig, mut session) = (Rig::new(1, 0), Session::new(3));
    session.connect();
    for now_ms in 0..2_000 {
        exchange(&mut rig, &mut session, now_ms);
        let silence_ms = rig.endpoint.silence_ms(now_ms).unwrap_or(0);
        assert!(silence_ms <= HEARTBEAT_MS + 2, "{silence_ms} ms");
    }
}
