//! Controls of a running task: hold, resume, cancel, stop.

use super::*;
use crate::random::Random;
use etherpen::application::Fault;
use etherpen::motion::Pen;

#[test]
fn cancel_stops_the_drawing_and_takes_the_power_before_the_job_ends() {
    for cancel_ms in [0, 5, 30, 75, 80, 110, 130, 500, 1_000] {
        let (mut rig, mut job) = (Rig::new(1, 0), job(3_000));
        run(&mut rig, &mut job, 10_000, |now_ms, _, job| {
            if now_ms == cancel_ms {
                job.control(Control::Cancel);
            }
        });
        assert_eq!(
            job.outcome(),
            Some(&Err(JobError::Cancelled)),
            "cancelled at {cancel_ms} ms"
        );
        let without_power = matches!(rig.mode, Mode::Startup | Mode::BusConfiguring | Mode::DrivesOff);
        assert!(without_power, "cancelled at {cancel_ms} ms: {:?}", rig.mode);
        assert!(rig.executed < 1_000);
    }
}

#[test]
fn hold_waits_without_a_limit_and_resume_completes() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(1_000));
    run(&mut rig, &mut job, 60_000, |now_ms, rig, job| match now_ms {
        500 => drop(job.control(Control::Hold)),
        600..40_000 => assert_eq!(rig.mode, Mode::Holding),
        40_000 => drop(job.control(Control::Resume)),
        _ => {}
    });
    assert_eq!(job.outcome(), Some(&Ok(())));
}

#[test]
fn stop_is_a_fault_and_an_operators_refused_command_is_only_told() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(1_000));
    let mut refused = 0;
    run(&mut rig, &mut job, 10_000, |now_ms, _, job| {
        match now_ms {
            // A resume is sent only to a robot that holds; a second hold is refused.
            300 => drop(job.control(Control::Resume)),
            310 => drop(job.control(Control::Hold)),
            400 => drop(job.control(Control::Hold)),
            500 => drop(job.control(Control::Stop)),
            _ => {}
        }
        let told = events(job);
        refused += told
            .iter()
            .filter(|event| matches!(event, JobEvent::Refused(Command::Hold | Command::Resume, _)))
            .count();
    });
    let by_link = Fault::EmergencyStop(etherpen::application::StopSource::Link);
    let expected = JobError::Fault {
        fault: by_link,
        before: false,
    };
    assert_eq!((job.outcome(), refused), (Some(&Err(expected)), 1));
}

#[test]
fn a_hold_before_the_drawing_begins_ends_the_job_without_a_stroke() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(100));
    run(&mut rig, &mut job, 5_000, |now_ms, _, job| {
        if now_ms == 5 {
            job.control(Control::Hold);
        }
    });
    assert_eq!(job.outcome(), Some(&Err(JobError::Cancelled)));
    assert!(rig.vertices.is_empty());
}

#[test]
fn a_hold_at_the_next_pen_up_waits_for_it() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(1_000));
    let mut held = false;
    run(&mut rig, &mut job, 10_000, |now_ms, rig, job| {
        match now_ms {
            300 => drop(job.control(Control::HoldAtPenUp)),
            _ if rig.mode == Mode::Holding => {
                held = true;
                job.control(Control::Resume);
            }
            _ => {}
        };
    });
    assert_eq!((job.outcome(), held), (Some(&Ok(())), true));
}

/// Random vertices within 0.2 mm, like a digitiser's noise: many legs are near each sample.
fn noise(count: usize) -> Vec<PathVertex> {
    let mut random = Random::new(4);
    let mut um = || (random.bits() % 400) as i32 - 200;
    let vertices = (0..count).map(|index| PathVertex {
        position_um: [um(), um(), -850_000],
        pen: if index == 0 { Pen::Up } else { Pen::Down },
        stroke: 0,
    });
    vertices.collect()
}

#[test]
fn a_stop_leaves_at_once_while_a_drawing_that_is_hard_to_verify_runs_and_ends() {
    const STEPS_MAX: u64 = 5;
    let count = 9_000;
    let mut resting_ms = None;
    for stop in [Some(5_000), None, Some(0), Some(20), Some(100)] {
        let (mut rig, mut job) = (
            Rig::new(1, 0),
            Job::draw(Config::default(), noise(count), JobOptions::default()),
        );
        let (mut stopped_ms, mut looks, mut most) = (None, 0, 0);
        run(&mut rig, &mut job, 60_000, |now_ms, rig, job| {
            if job.phase() == Phase::Resting && stop.is_none() {
                resting_ms.get_or_insert(now_ms);
            }
            let now_looks = job.verifier.as_ref().map_or(looks, Verifier::looks);
            most = most.max(now_looks - looks);
            looks = now_looks;
            // In the middle of the drawing, or around its end.
            let at_ms = stop.map(|stop| {
                if stop < 5_000 {
                    resting_ms.unwrap_or_default() + stop
                } else {
                    stop
                }
            });
            if at_ms == Some(now_ms) {
                job.command(Command::Stop);
                stopped_ms = Some(now_ms);
            }
            if let Some(stopped_ms) = stopped_ms.filter(|stopped_ms| now_ms > stopped_ms + STEPS_MAX) {
                assert!(rig.commands.contains(&Command::Stop), "ordered at {stopped_ms} ms");
            }
        });
        println!(
            "stop {stop:?}: {looks} looks, at most {most} in a step, {:?}",
            job.outcome()
        );
        assert_eq!(stopped_ms.is_some(), stop.is_some());
        assert!(most > 1_000 && most <= 2 * LOOKS_PER_STEP, "{most} looks");
    }
}
