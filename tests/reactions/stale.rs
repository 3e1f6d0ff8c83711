//! A drive whose processor stops while its slave controller continues to answer: stale inputs.
//!
//! The drive's inputs then stay unchanged. Every such stop either causes a specific fault or is too short to leave a
//! trace in the ink.

use super::feedback::apart_mm;
use super::robot::{Robot, path};
use etherpen::application::{Fault, Mode};
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use host_tools::cell::{Fault as CellFault, InkStroke};

/// How long the processor is stopped, ms.
const STALLS_MS: [u64; 5] = [5, 20, 50, 100, 900];
/// Stops up to this duration have no effect, ms: the drive's power stage does not notice them either.
const HARMLESS_MS: u64 = 5;
/// How far the ink may be from that of an undisturbed robot without a fault, mm.
const INK_APART_MAX_MM: f64 = 0.2;
/// The drive, from 1.
const DRIVE: usize = 2;

fn config(clocks: bool, speed_mm_s: f64) -> Config {
    let mut config = Config::default();
    config.bus.clocks = clocks;
    config.motion.speed_mm_s = speed_mm_s;
    config
}

/// The first stroke of the drawing.
fn stroke() -> Vec<PathVertex> {
    let mut path = path();
    path.retain(|vertex| vertex.stroke == 0);
    path
}

fn is_named(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::ProcessorStopped { .. }
            | Fault::Drive { .. }
            | Fault::FeedbackDeviation { .. }
            | Fault::FollowingError { .. }
            | Fault::OutputLimit { .. }
            | Fault::SlaveState { .. }
    )
}

fn drawn(robot: &mut Robot) -> Vec<InkStroke> {
    let before = robot.ink().len();
    robot.draw(stroke());
    robot.run_until("the path is executed or a fault is told", |robot| {
        robot.fault().is_some() || robot.ack.finished && robot.mode() == Mode::Idle
    });
    robot.ink().split_off(before)
}

/// Draws while the processor is stopped; returns the fault, or else how far the ink is from the undisturbed ink.
fn stalled(config: &Config, stall_ms: u64, expected: &[InkStroke]) -> Result<f64, Fault> {
    let mut robot = Robot::idle_with(config);
    robot.draw(stroke());
    robot.run_until("the pen draws", |robot| robot.ack.executed > 4);
    robot.inject(CellFault::Processor(DRIVE, stall_ms));
    robot.run_until("the path is executed or a fault is told", |robot| {
        robot.fault().is_some() || robot.ack.finished && robot.mode() == Mode::Idle
    });
    match robot.fault() {
        Some(fault) => Err(fault),
        None => Ok(apart_mm(&robot.ink(), expected)),
    }
}

#[test]
fn a_processor_that_stands_still_in_a_drawing_is_a_fault_or_leaves_no_trace() {
    for clocks in [false, true] {
        for speed_mm_s in [60.0, 400.0] {
            let config = config(clocks, speed_mm_s);
            let expected = drawn(&mut Robot::idle_with(&config));
            for stall_ms in STALLS_MS {
                let outcome = stalled(&config, stall_ms, &expected);
                println!("clocks {clocks}, {speed_mm_s} mm/s, {stall_ms} ms: {outcome:?}");
                match outcome {
                    Ok(apart_mm) => {
                        assert!(stall_ms < 100, "{stall_ms} ms went unnoticed");
                        assert!(apart_mm <= INK_APART_MAX_MM, "{apart_mm} mm after {stall_ms} ms");
                    }
                    Err(fault) => {
                        assert!(stall_ms > HARMLESS_MS, "{fault:?} after {stall_ms} ms");
                        assert!(is_named(&fault), "{fault:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_processor_that_stands_still_at_rest_is_a_fault_or_the_next_drawing_is_right() {
    for clocks in [false, true] {
        let config = config(clocks, 200.0);
        let expected = drawn(&mut Robot::idle_with(&config));
        for stall_ms in STALLS_MS {
            let mut robot = Robot::idle_with(&config);
            robot.inject(CellFault::Processor(DRIVE, stall_ms));
            robot.run(2_000);
            let fault = robot.fault();
            println!("clocks {clocks}, at rest, {stall_ms} ms: {fault:?}");
            match fault {
                Some(fault) => assert!(stall_ms > HARMLESS_MS && is_named(&fault), "{fault:?}"),
                None => {
                    assert!(stall_ms < 100, "{stall_ms} ms went unnoticed");
                    let apart_mm = apart_mm(&drawn(&mut robot), &expected);
                    assert!(apart_mm <= INK_APART_MAX_MM, "{apart_mm} mm after {stall_ms} ms");
                }
            }
        }
    }
}
