//! Drawings held or left behind since another connection.

use super::*;

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
fn a_drawing_that_ended_early_while_nobody_was_connected_is_told_as_such() {
    let (mut rig, now_ms) = left_behind(1_000, 400);
    // Its next vertex was refused, or somebody at the board has cancelled it.
    rig.mode = Mode::Idle;
    let executed = rig.executed;
    let left = DrawTask {
        held: true,
        ..DrawTask::new(path(1_000))
    };
    let mut second = with_task(Task::Draw(left), 2);
    go_on(&mut rig, &mut second, now_ms);
    let early = JobError::EndedEarly { executed, total: 1_000 };
    assert_eq!(second.outcome(), Some(&Err(early)));
    let draws = rig
        .commands
        .iter()
        .filter(|command| matches!(command, Command::Draw { .. }));
    assert_eq!((draws.count(), rig.mode), (1, Mode::DrivesOff));
}
