//! Jobs against a rig that answers as the firmware does.

use super::*;
use crate::link::rig::{Rig, path};
use crate::random::Random;
use etherpen::application::Fault;

fn job(count: usize) -> Job {
    Job::draw(Config::default(), path(count), JobOptions::default())
}

/// Runs until the job ends, with `at` called every millisecond before the job's step.
fn run(rig: &mut Rig, job: &mut Job, limit_ms: u64, mut at: impl FnMut(u64, &mut Rig, &mut Job)) {
    for now_ms in 0..limit_ms {
        at(now_ms, rig, job);
        rig.step(now_ms, |arrived, room| {
            let mut out = Vec::new();
            job.step(now_ms, arrived, &mut out, room);
            out
        });
        if job.outcome().is_some() {
            return;
        }
    }
    panic!("still {} after {limit_ms} ms", job.phase());
}

fn events(job: &mut Job) -> Vec<JobEvent> {
    std::iter::from_fn(|| job.next_event()).collect()
}

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
    // Two bytes in a thousand, of a kilobyte that has to come whole.
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
    // One in a hundred: the greeting and the inquiries get over, the configuration has no chance.
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
fn a_fault_found_at_connect_is_reported_and_nothing_is_commanded() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(10));
    let fault = Fault::Drive {
        axis: 1,
        status_word: 8,
    };
    (rig.mode, rig.fault) = (Mode::Fault, Some(fault));
    run(&mut rig, &mut job, 1_000, |_, _, _| {});
    assert_eq!(job.outcome(), Some(&Err(JobError::Fault { fault, before: true })));
    assert!(rig.commands.is_empty() && rig.config.is_none());
}

#[test]
fn a_fault_from_before_is_acknowledged_when_the_person_says_so() {
    let options = JobOptions {
        acknowledge: true,
        ..JobOptions::default()
    };
    let (mut rig, mut job) = (Rig::new(1, 0), Job::draw(Config::default(), path(10), options));
    (rig.mode, rig.fault) = (Mode::Fault, Some(Fault::SlaveLost { slave: 0 }));
    run(&mut rig, &mut job, 5_000, |_, _, _| {});
    assert_eq!(job.outcome(), Some(&Ok(())));
    let acknowledgements = rig.commands.iter().filter(|command| **command == Command::Acknowledge);
    assert_eq!((acknowledgements.count(), rig.vertices.len()), (1, 10));
}

#[test]
fn a_fault_while_drawing_is_told_at_once_and_ends_the_job_when_the_robot_stands() {
    let (mut rig, mut job) = (Rig::new(1, 0), job(1_000));
    rig.fault_at_vertex = Some(500);
    let mut told_in = None;
    run(&mut rig, &mut job, 10_000, |_, rig, job| {
        if events(job).iter().any(|event| matches!(event, JobEvent::Fault(_))) {
            told_in = Some(rig.mode);
        }
    });
    assert_eq!(told_in, Some(Mode::Stopping));
    let fault = Fault::SlaveLost { slave: 2 };
    assert_eq!(job.outcome(), Some(&Err(JobError::Fault { fault, before: false })));
    assert_eq!(rig.mode, Mode::Fault);
    assert!(
        job.into_report().samples.len() > 500,
        "the telemetry of a failed drawing is kept"
    );
}

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
    assert!(understood > 200, "{understood}");
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
fn a_drawing_left_behind_is_cancelled_when_the_person_says_so() {
    let options = JobOptions {
        acknowledge: true,
        ..JobOptions::default()
    };
    let (mut rig, mut job) = (Rig::new(1, 0), Job::draw(Config::default(), path(10), options));
    (rig.mode, rig.referenced) = (Mode::Holding, true);
    run(&mut rig, &mut job, 10_000, |_, _, _| {});
    assert_eq!(rig.commands.first(), Some(&Command::Cancel));
    assert!(
        !matches!(job.outcome(), Some(Err(JobError::Busy(_)))),
        "{:?}",
        job.outcome()
    );
}

fn with_task(task: Task, session: u32) -> Job {
    let options = JobOptions {
        session,
        ..JobOptions::default()
    };
    Job::new(Config::default(), task, options)
}

/// A rig that was told to draw by a program that has gone after this many milliseconds, and holds by itself since.
fn left_behind(count: usize, gone_ms: u64) -> (Rig, u64) {
    let (mut rig, mut job) = (Rig::new(1, 0), job(count));
    let mut now_ms = 0;
    while rig.mode != Mode::Holding {
        rig.step(now_ms, |arrived, room| {
            let mut out = Vec::new();
            if now_ms < gone_ms {
                job.step(now_ms, arrived, &mut out, room);
            }
            out
        });
        now_ms += 1;
    }
    (rig, now_ms)
}

/// Runs a job with a clock of its own on a rig whose time goes on; how long it took, ms.
fn go_on(rig: &mut Rig, job: &mut Job, since_ms: u64) -> u64 {
    for ms in 0..20_000 {
        rig.step(since_ms + ms, |arrived, room| {
            let mut out = Vec::new();
            job.step(ms, arrived, &mut out, room);
            out
        });
        if job.outcome().is_some() {
            return ms;
        }
    }
    panic!("still {}", job.phase());
}

#[test]
fn a_drawing_that_is_held_since_another_connection_goes_on_exactly_where_it_is() {
    let (mut rig, now_ms) = left_behind(1_000, 400);
    let executed = rig.executed;
    assert!(executed > 50 && rig.vertices.len() < 1_000);
    let held = DrawTask {
        held: true,
        ..DrawTask::new(path(1_000))
    };
    let mut second = with_task(Task::Draw(held), 2);
    go_on(&mut rig, &mut second, now_ms);
    assert_eq!(second.outcome(), Some(&Ok(())));
    assert_eq!(rig.vertices, path(1_000), "every vertex was taken once");
    let count = |wanted: fn(&Command) -> bool| rig.commands.iter().filter(|command| wanted(command)).count();
    assert_eq!(count(|command| matches!(command, Command::Draw { .. })), 1);
    assert_eq!(count(|command| matches!(command, Command::Resume)), 1);
    assert_eq!(rig.mode, Mode::DrivesOff);
    let report = second.into_report();
    assert!(
        report.drawn_s < 1.0,
        "only what this connection drew counts: {}",
        report.drawn_s
    );
}

#[test]
fn another_drawing_than_the_one_that_is_held_is_refused_and_nothing_is_commanded() {
    let (mut rig, now_ms) = left_behind(1_000, 400);
    let commands = rig.commands.clone();
    let other = DrawTask {
        held: true,
        ..DrawTask::new(path(999))
    };
    let mut second = with_task(Task::Draw(other), 2);
    go_on(&mut rig, &mut second, now_ms);
    assert_eq!(second.outcome(), Some(&Err(JobError::NotHeld(Mode::Holding))));
    assert_eq!((&rig.commands, rig.mode), (&commands, Mode::Holding));
}

#[test]
fn a_look_and_a_refused_command_change_nothing() {
    let (mut rig, now_ms) = left_behind(1_000, 400);
    let commands = rig.commands.clone();
    let mut look = with_task(Task::Look, 2);
    go_on(&mut rig, &mut look, now_ms);
    assert_eq!(look.outcome(), Some(&Ok(())));
    assert_eq!(look.status().map(|status| status.mode), Some(Mode::Holding));
    let mut tell = with_task(Task::Tell(Command::Hold), 3);
    go_on(&mut rig, &mut tell, now_ms + 20_000);
    let refused = JobError::Refused(Command::Hold, Refusal::NotInMode(Mode::Holding));
    assert_eq!(tell.outcome(), Some(&Err(refused)));
    assert_eq!((&rig.commands, rig.mode), (&commands, Mode::Holding));
    let mut cancel = with_task(Task::Tell(Command::Cancel), 4);
    go_on(&mut rig, &mut cancel, now_ms + 40_000);
    assert_eq!((cancel.outcome(), rig.mode), (Some(&Ok(())), Mode::Idle));
}

#[test]
fn a_motion_leaves_the_power_as_it_was_found() {
    let position = etherpen::robots::Position::default();
    let mut rig = Rig::new(1, 0);
    let mut first = with_task(Task::Motion(Motion::Move(position)), 1);
    let mut now_ms = go_on(&mut rig, &mut first, 0);
    assert_eq!((first.outcome(), rig.mode), (Some(&Ok(())), Mode::DrivesOff));
    // One connection, one task after the other.
    let mut then = |rig: &mut Rig, task: Task| {
        first.begin(task);
        for ms in 0..20_000 {
            now_ms += 1;
            rig.step(now_ms, |arrived, room| {
                let mut out = Vec::new();
                first.step(now_ms, arrived, &mut out, room);
                out
            });
            if first.outcome().is_some() {
                return ms;
            }
        }
        panic!("still {}", first.phase());
    };
    then(&mut rig, Task::Prepare(Ready::Enabled));
    assert_eq!(rig.mode, Mode::Idle);
    let jog = Motion::Jog {
        velocity_mm_s: [10.0, 0.0, 0.0],
        for_ms: 500,
    };
    let commands = rig.commands.len();
    let took_ms = then(&mut rig, Task::Motion(jog));
    assert_eq!(rig.mode, Mode::Idle);
    assert!((500..1_000).contains(&took_ms), "{took_ms}");
    let jogs = rig.commands.len() - commands;
    assert!((8..20).contains(&jogs), "{jogs} jogs within the dead-man time");
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

#[test]
fn a_jog_is_repeated_only_on_fresh_signs_of_life_and_ends_with_them() {
    for seed in 1..40_u64 {
        let mut random = Random::new(seed);
        let (mut rig, life) = (Rig::new(1, 0), Life::default());
        let task = Task::Motion(Motion::Jog {
            velocity_mm_s: [10.0, 0.0, 0.0],
            for_ms: 20_000,
        });
        let mut job = Job::new(Config::default(), task, JobOptions::default());
        job.live_on(life.clone());
        let (every_ms, until_ms) = (1 + random.bits() % 60, 2_000 + random.bits() % 3_000);
        let is_jog = |command: &&Command| matches!(command, Command::Jog { velocity_mm_s } if velocity_mm_s[0] > 0.0);
        let jogs = |rig: &Rig| rig.commands.iter().filter(is_jog).count();
        let (mut jogs_at_silence, mut last_ms) = (0, 0);
        run(&mut rig, &mut job, 20_000, |now_ms, rig, _| {
            if now_ms < until_ms && now_ms.is_multiple_of(every_ms) {
                life.sign();
            }
            if now_ms == until_ms {
                jogs_at_silence = jogs(rig);
            }
            last_ms = now_ms;
        });
        assert_eq!(job.outcome(), Some(&Err(JobError::Abandoned)), "seed {seed}");
        assert!(jogs_at_silence > 10, "seed {seed}: {jogs_at_silence} jogs");
        let late = jogs(&rig) - jogs_at_silence;
        assert!(late <= 1, "seed {seed}: {late} jogs after the last sign of life");
        assert!(
            last_ms < until_ms + 2_000 && rig.mode != Mode::Moving,
            "seed {seed}: {last_ms} ms"
        );
    }
}

/// Vertices at random within 0.2 mm, as a digitiser's noise: many legs are near each sample.
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
            // After the drawing's middle, at its end.
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
