//! One case on the host, for callgrind: `callgrind SUBJECT CASE`.
//!
//! Callgrind collects between entry and exit of [`counted_part`], and not inside of [`uncounted_part`] (its option
//! `--toggle-collect`); what it has collected at the end belongs to the counted cycles.

use benchmarks::ethercrab_master::{EthercrabMaster, Storage};
use benchmarks::etherpen_master::EtherpenMaster;
use benchmarks::{CASES, CYCLES, DRIVES, Meter, measure};
use etherpen::robot_bus::RobotBusQueues;
use std::process::ExitCode;

#[inline(never)]
fn counted_part<R>(work: impl FnOnce() -> R) -> R {
    work()
}

#[inline(never)]
fn uncounted_part<R>(work: impl FnOnce() -> R) -> R {
    work()
}

struct Callgrind;

impl Meter for Callgrind {
    fn count<R>(work: impl FnOnce() -> R) -> R {
        counted_part(work)
    }

    fn pause<R>(work: impl FnOnce() -> R) -> R {
        uncounted_part(work)
    }
}

static STORAGE: Storage = Storage::new();

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [subject, name] = arguments.as_slice() else {
        eprintln!("usage: callgrind SUBJECT CASE");
        return ExitCode::from(2);
    };
    let Some(case) = CASES.into_iter().find(|case| case.name == name) else {
        eprintln!("there is no case {name}");
        return ExitCode::from(2);
    };
    match subject.as_str() {
        "etherpen" => measure::<Callgrind>(&mut EtherpenMaster::<DRIVES>::new(&mut RobotBusQueues::new(), case)),
        "ethercrab" => measure::<Callgrind>(&mut EthercrabMaster::new(&STORAGE, case)),
        _ => {
            eprintln!("there is no subject {subject}");
            return ExitCode::from(2);
        }
    }
    println!("{CYCLES}");
    ExitCode::SUCCESS
}
