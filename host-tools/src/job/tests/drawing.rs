//! Whole drawings: from the greeting to the report.

use super::*;

#[test]
fn a_whole_drawing_ends_without_power_and_leaves_every_sample() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(2_000));
    let mut executed_mm = 0.0;
    run(&mut rig, &mut job, 10_000, |_, rig, job| {
        let progress = job.progress();
        assert!(progress.vertices <= rig.executed as usize && progress.executed_mm >= executed_mm);
        executed_mm = progress.executed_mm;
    });
    assert_eq!(job.outcome(), Some(&Ok(())));
    assert_eq!((rig.mode, rig.vertices.len()), (Mode::DrivesOff, 2_000));
    let expected = [
        Command::Home,
        Command::Enable,
        Command::Draw {
            job: path_number(path_hash(&path(2_000))),
        },
        Command::Disable,
    ];
    assert_eq!(rig.commands, expected);
    let report = job.into_report();
    let in_order = report.samples.windows(2).all(|pair| pair[1].t_ms == pair[0].t_ms + 1);
    assert!(in_order && report.link.samples_missing == 0 && report.samples.len() > 2_000);
    assert!((2.0..2.2).contains(&report.drawn_s), "{}", report.drawn_s);
    assert_eq!((report.progress.vertices, report.progress.left_s), (2_000, 0.0));
    assert_eq!(
        report.welcome.map(|welcome| welcome.board.as_str().to_owned()),
        Some("rig".into())
    );
}

#[test]
fn two_runs_are_the_same_byte_by_byte() {
    let bytes = || {
        let (mut rig, mut job, mut all) = (Rig::new(5, 200), job(300), Vec::new());
        for now_ms in 0..3_000 {
            rig.step(now_ms, |arrived, room| {
                let mut out = Vec::new();
                job.step(now_ms, arrived, &mut out, room);
                all.extend_from_slice(&out);
                out
            });
        }
        all
    };
    assert_eq!(bytes(), bytes());
}

#[test]
fn a_refused_vertex_ends_the_drawing_with_the_power_off() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(1_000));
    rig.refuse_vertex = Some(300);
    run(&mut rig, &mut job, 10_000, |_, _, _| {});
    assert!(matches!(job.outcome(), Some(Err(JobError::Vertex(refusal))) if refusal.index == 300));
    assert_eq!((rig.mode, rig.vertices.len()), (Mode::DrivesOff, 300));
}

#[test]
fn a_drawing_that_another_program_ended_is_noticed() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(1_000));
    run(&mut rig, &mut job, 10_000, |now_ms, rig, _| {
        if now_ms == 600 {
            rig.mode = Mode::Idle;
        }
    });
    assert!(matches!(
        job.outcome(),
        Some(Err(JobError::EndedEarly { total: 1_000, .. }))
    ));
    assert_eq!(rig.mode, Mode::DrivesOff);
}
