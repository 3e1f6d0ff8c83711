//! Lines that lose, damage or delay messages, or are silent.

use super::*;
use crate::random::Random;

#[test]
fn over_a_bad_line_the_drawing_is_complete_and_the_gaps_are_told() {
    for seed in [3, 0xbad] {
        println!("seed {seed:#x}");
        let (mut rig, mut job) = (Rig::new(seed, 500), job(1_000));
        run(&mut rig, &mut job, 60_000, |_, _, _| {});
        assert_eq!(job.outcome(), Some(&Ok(())), "seed {seed:#x}");
        assert_eq!(rig.vertices, path(1_000), "seed {seed:#x}");
        let missing: u64 = events(&mut job)
            .iter()
            .map(|event| match event {
                JobEvent::SamplesMissing { missing, .. } => u64::from(*missing),
                _ => 0,
            })
            .sum();
        let report = job.into_report();
        assert!(missing > 0 && missing == report.link.samples_missing);
    }
}

#[test]
fn a_configuration_gets_over_a_bad_line_and_where_it_cannot_that_is_told() {
    let prepared = |seed: u64, faults_per_million: u64| {
        println!("seed {seed:#x}");
        let mut rig = Rig::new(seed, faults_per_million);
        let mut job = Job::new(Config::default(), Task::Prepare(Ready::Bus), JobOptions::default());
        run(&mut rig, &mut job, 60_000, |_, _, _| {});
        (job.outcome().copied(), rig)
    };
    // Two bytes in a thousand, of a kilobyte that has to arrive intact.
    for seed in 1..=8 {
        let (outcome, rig) = prepared(seed, 500);
        assert_eq!(
            (outcome, rig.config),
            (Some(Ok(())), Config::default().hash()),
            "seed {seed}"
        );
        assert_eq!(
            rig.lines.iter().filter(|line| line.spoilt > 0).count(),
            2,
            "seed {seed}"
        );
    }
    // One in a hundred: the greeting and the inquiries get through, the configuration has no chance.
    for seed in 1..=3 {
        let (outcome, rig) = prepared(seed, 2_500);
        let Some(Err(JobError::Timeout { phase, waited_ms })) = outcome else {
            panic!("seed {seed}: {outcome:?}");
        };
        assert!(
            matches!(phase, Phase::Inspecting | Phase::Configuring),
            "seed {seed}: {phase}"
        );
        assert!(
            waited_ms < 20_000 && rig.commands.is_empty() && rig.config.is_none(),
            "seed {seed}"
        );
    }
}

#[test]
fn a_silent_port_another_configuration_in_bounds_and_a_busy_robot_are_told() {
    let mut silent = job(1);
    for now_ms in 0..6_000 {
        silent.step(now_ms, &[], &mut Vec::new(), 92);
    }
    assert_eq!(silent.outcome(), Some(&Err(JobError::NoAnswer { waited_ms: 5_001 })));
    let mut config = Config::default();
    config.axes[0].gear = 0.0;
    let (mut rig, mut refused) = (Rig::new(1, 0), Job::draw(config, path(1), JobOptions::default()));
    run(&mut rig, &mut refused, 1_000, |_, _, _| {});
    assert!(matches!(refused.outcome(), Some(Err(JobError::Config(_)))));
    let (mut rig, mut busy) = (Rig::new(1, 0), job(1));
    rig.mode = Mode::Holding;
    run(&mut rig, &mut busy, 1_000, |_, _, _| {});
    assert_eq!(busy.outcome(), Some(&Err(JobError::Busy(Mode::Holding))));
}

#[test]
fn a_lost_link_ends_the_job_and_commands_nothing_more() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(3_000));
    let mut now_ms = 0;
    while job.outcome().is_none() {
        let mut out = Vec::new();
        if now_ms < 1_000 {
            rig.step(now_ms, |arrived, room| {
                job.step(now_ms, arrived, &mut out, room);
                std::mem::take(&mut out)
            });
        } else {
            job.step(now_ms, &[], &mut out, 92);
        }
        now_ms += 1;
    }
    assert!(matches!(job.outcome(), Some(Err(JobError::LinkLost { .. }))));
    assert!((4_000..4_010).contains(&now_ms), "{now_ms}");
}

#[test]
fn nonsense_in_good_frames_makes_no_panic() {
    let seed = 0x5eed_0003;
    println!("seed {seed:#x}");
    let mut random = Random::new(seed);
    let mut understood = 0;
    for _ in 0..20 {
        let (mut rig, mut job) = (Rig::new(1, 0), job(1_000));
        for now_ms in 0..800 {
            rig.step(now_ms, |arrived, room| {
                let mut out = Vec::new();
                job.step(now_ms, arrived, &mut out, room);
                out
            });
            let mut payload = [[0u8; 32]; 4];
            for byte in payload.as_flattened_mut() {
                *byte = random.bits() as u8 >> (random.bits() % 8);
            }
            // Any message but a greeting, which ends the connection.
            payload[0][0] = 1 + (random.bits() % 6) as u8;
            let mut frame = [0; etherpen::link::frame::FRAME_BYTES_MAX];
            let length = etherpen::link::frame::encode(&payload, &mut frame).unwrap();
            job.step(now_ms, &frame[..length], &mut Vec::new(), 0);
            understood += events(&mut job).len();
        }
    }
    assert!(understood > 80, "{understood}");
}

/// A job whose line breaks as soon as the firmware has said that the path has ended; it was carried out, or the firmware
/// is wrong.
fn broken_at_the_end(is_carried_out: bool) -> (JobReport, bool) {
    let (mut rig, mut job) = (Rig::new(1, 0), job(100));
    let mut now_ms = 0;
    let mut heard_ms = 0;
    while job.outcome().is_none() {
        let mut out = Vec::new();
        if job.ack.finished {
            heard_ms += 1;
        }
        if heard_ms > 20 {
            job.step(now_ms, &[], &mut out, 92);
        } else {
            rig.step(now_ms, |arrived, room| {
                job.step(now_ms, arrived, &mut out, room);
                std::mem::take(&mut out)
            });
        }
        if !is_carried_out && rig.mode == Mode::Drawing && rig.executed == 50 && rig.vertices.len() == 100 {
            (rig.executed, rig.mode) = (100, Mode::Idle);
        }
        now_ms += 1;
    }
    let finished = job.ack.finished;
    assert!(
        matches!(job.outcome(), Some(Err(JobError::LinkLost { .. }))),
        "{:?}",
        job.outcome()
    );
    (job.into_report(), finished)
}

#[test]
fn a_line_that_breaks_after_the_end_of_the_path_leaves_the_verdict_as_it_is() {
    let (report, finished) = broken_at_the_end(true);
    assert!(finished);
    let verdict = report.verification.verdict();
    assert_eq!((verdict.missing_mm, verdict.error()), (0.0, None), "{verdict:?}");
    let (report, finished) = broken_at_the_end(false);
    assert!(finished);
    let verdict = report.verification.verdict();
    assert_eq!(verdict.strokes, [5, 6, 7, 8, 9], "{verdict:?}");
}

#[test]
fn a_path_that_has_not_ended_lacks_nothing_that_it_has_not_come_to() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(100));
    run(&mut rig, &mut job, 20_000, |_, rig, job| {
        if rig.executed == 50 && rig.mode == Mode::Drawing {
            job.control(Control::Cancel);
        }
    });
    assert_eq!(job.outcome(), Some(&Err(JobError::Cancelled)));
    let report = job.into_report();
    let last = report.samples.last().expect("telemetry");
    assert!(!matches!(last.mode, Mode::Drawing | Mode::Holding), "{last:?}");
    let verdict = report.verification.verdict();
    assert_eq!((verdict.missing_mm, verdict.error()), (0.0, None), "{verdict:?}");
}
