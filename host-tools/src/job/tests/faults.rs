//! Faults: latched from before, and while drawing.

use super::*;
use etherpen::application::Fault;
use etherpen::config::Encoder;
use etherpen::ethercat::error::IdentityProperty;

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
fn an_earlier_fault_is_acknowledged_on_request() {
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
fn an_acknowledgement_waits_as_long_as_the_firmware_waits_for_a_slave_that_starts_up() {
    let drawing = || {
        let options = JobOptions {
            acknowledge: true,
            ..JobOptions::default()
        };
        Job::draw(Config::default(), path(10), options)
    };
    for mut job in [with_task(Task::Tell(Command::Acknowledge), 1), drawing()] {
        // A drive takes 20 s to each state.
        let mut rig = Rig::new(1, 0);
        rig.slow_start_ms = 40_000;
        (rig.mode, rig.fault) = (Mode::Fault, Some(Fault::SlaveLost { slave: 2 }));
        run(&mut rig, &mut job, 60_000, |_, _, _| {});
        assert_eq!(job.outcome(), Some(&Ok(())));
        let acknowledgements = rig.commands.iter().filter(|command| **command == Command::Acknowledge);
        assert_eq!(acknowledgements.count(), 1);
    }
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

/// A machine whose bus is not the one that another configuration expects.
fn of_another_configuration() -> Rig {
    let mut rig = Rig::new(1, 0);
    let fault = Fault::WrongSlave {
        slave: 1,
        property: IdentityProperty::Serial,
        expected: 99,
        found: 4,
        other: None,
    };
    (rig.mode, rig.fault, rig.config) = (Mode::Fault, Some(fault), Some(1));
    rig
}

#[test]
fn a_fault_of_another_configuration_ends_with_the_one_that_fits_without_an_acknowledgement() {
    for acknowledge in [false, true] {
        let mut rig = of_another_configuration();
        let options = JobOptions {
            acknowledge,
            ..JobOptions::default()
        };
        let mut job = Job::draw(Config::default(), path(10), options);
        run(&mut rig, &mut job, 20_000, |_, _, _| {});
        assert_eq!(job.outcome(), Some(&Ok(())));
        assert!(!rig.commands.contains(&Command::Acknowledge), "{:?}", rig.commands);
    }
}

#[test]
fn a_fault_of_the_same_configuration_and_any_other_fault_are_told_as_before() {
    let mut rig = of_another_configuration();
    rig.config = Config::default().hash();
    let fault = rig.fault.expect("a fault");
    let mut drawing = job(10);
    run(&mut rig, &mut drawing, 1_000, |_, _, _| {});
    assert_eq!(drawing.outcome(), Some(&Err(JobError::Fault { fault, before: true })));
    let mut rig = of_another_configuration();
    let fault = Fault::SlaveLost { slave: 2 };
    rig.fault = Some(fault);
    let mut drawing = job(10);
    run(&mut rig, &mut drawing, 1_000, |_, _, _| {});
    assert_eq!(drawing.outcome(), Some(&Err(JobError::Fault { fault, before: true })));
    assert_eq!((rig.config, rig.commands.len()), (Some(1), 0));
}

#[test]
fn a_bus_that_could_not_be_configured_is_acknowledged_first_and_a_machine_that_still_stops_is_waited_for() {
    let step = Fault::BusConfiguration {
        slave: 1,
        step: 4,
        code: 0,
    };
    for (acknowledge, is_drawn) in [(false, false), (true, true)] {
        let mut rig = of_another_configuration();
        rig.fault = Some(step);
        let options = JobOptions {
            acknowledge,
            ..JobOptions::default()
        };
        let mut job = Job::draw(Config::default(), path(10), options);
        run(&mut rig, &mut job, 20_000, |_, _, _| {});
        assert_eq!(
            job.outcome().is_some_and(Result::is_ok),
            is_drawn,
            "{:?}",
            job.outcome()
        );
        assert_eq!(rig.config == Some(1), !is_drawn);
    }
}

#[test]
fn an_axis_of_which_only_a_person_knows_where_it_is_is_not_homed_by_a_job() {
    let mut blind = Config::default();
    blind.axes[2].encoder = Encoder::Incremental;
    let mut uncalibrated = Config::default();
    (uncalibrated.axes[1].encoder, uncalibrated.axes[1].serial) = (Encoder::MultiTurn, 77);
    let mut calibrated = uncalibrated.clone();
    calibrated.axes[1].sync_increments = -5;
    for (config, at_marks, is_homed) in [
        (&blind, false, false),
        (&blind, true, true),
        (&uncalibrated, false, false),
        (&uncalibrated, true, true),
        (&calibrated, false, true),
    ] {
        for task in [Task::Draw(DrawTask::new(path(10))), Task::Prepare(Ready::Enabled)] {
            let mut rig = Rig::new(1, 0);
            let options = JobOptions {
                at_marks,
                ..JobOptions::default()
            };
            let mut job = Job::new(config.clone(), task, options);
            run(&mut rig, &mut job, 20_000, |_, _, _| {});
            let expected = if is_homed { Ok(()) } else { Err(JobError::NotReferenced) };
            assert_eq!(job.outcome(), Some(&expected));
            assert_eq!(rig.commands.contains(&Command::Home), is_homed);
            assert_eq!(rig.referenced, is_homed);
        }
        // The bus is brought up all the same, and a machine that somebody has homed draws.
        let mut rig = Rig::new(1, 0);
        (rig.referenced, rig.mode, rig.config) = (true, Mode::DrivesOff, config.hash());
        let mut job = Job::new(
            config.clone(),
            Task::Draw(DrawTask::new(path(10))),
            JobOptions::default(),
        );
        run(&mut rig, &mut job, 20_000, |_, _, _| {});
        assert_eq!(job.outcome(), Some(&Ok(())));
    }
}
