//! A session against a rig, over lines that damage bytes.

use super::*;
use crate::link::rig::{CAPACITY, Rig, path};
use etherpen::application::Mode;
use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest};
use etherpen::messages::{Command, Sample};

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
