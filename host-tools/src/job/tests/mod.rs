//! Jobs against a rig that answers as the firmware does.

mod controls;
mod drawing;
mod faults;
mod line;
mod resumed;
mod tasks;

use super::*;
use crate::link::rig::{Rig, path};

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

fn with_task(task: Task, session: u32) -> Job {
    let options = JobOptions {
        session,
        ..JobOptions::default()
    };
    Job::new(Config::default(), task, options)
}

/// A rig that holds by itself: the program that ordered the drawing disappeared after this many milliseconds.
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

/// Runs a job with its own clock on a rig whose time continues; returns how long it took, ms.
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
