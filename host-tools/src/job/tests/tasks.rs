//! Tasks other than drawing: looks, commands, motions, jogs.

use super::*;
use crate::random::Random;
use etherpen::application::Refusal;

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
