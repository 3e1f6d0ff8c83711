//! Outputs that do not reach the drives while their inputs still come: lost telegrams, or one drive that takes none.

use crate::STILL_RAD_S;
use crate::liveness::come_back;
use crate::robot::Robot;
use etherpen::application::{Fault, Mode};
use etherpen::config::Config;
use host_tools::cell::{CellOptions, DriveState, Fault as CellFault};

/// Pen speeds, mm/s: low and full.
const SPEEDS_MM_S: [f64; 2] = [50.0, 500.0];
/// The drive that takes nothing, from 1.
const DEAF: usize = 2;

fn drawing(speed_mm_s: f64, clocks: bool) -> Robot {
    let mut config = Config::default();
    config.motion.speed_mm_s = speed_mm_s;
    config.bus.clocks = clocks;
    Robot::of(&config, CellOptions::default()).enabled().in_a_drawing()
}

fn blind_max_ms() -> u32 {
    Config::default().bus.blind_max_ms.into()
}

/// Milliseconds until every drive but those of `except` has begun to brake by the controller's quick stop.
fn quick_stop_after_ms(robot: &mut Robot, except: &[usize]) -> Option<u32> {
    let mut has_braked = [false; 4];
    except.iter().for_each(|number| has_braked[number - 1] = true);
    (1..=200).find(|_| {
        robot.run(1);
        for (braked, slave) in has_braked.iter_mut().zip(robot.cell().slaves) {
            // A motor at rest ends its quick stop at once; a watchdog leads to a fault instead.
            *braked |= matches!(slave.drive, DriveState::QuickStopActive | DriveState::SwitchOnDisabled);
        }
        has_braked == [true; 4]
    })
}

/// How long the drives themselves take from an event in the firmware to a quick stop, ms: the emergency-stop input acts in
/// the same millisecond.
fn drives_own_ms(speed_mm_s: f64, clocks: bool) -> u32 {
    let mut robot = drawing(speed_mm_s, clocks);
    robot.emergency_stop(true);
    quick_stop_after_ms(&mut robot, &[]).expect("a quick stop")
}

fn assert_stands(robot: &mut Robot) {
    robot.run(200);
    assert!(robot.speed_rad_s() < STILL_RAD_S, "{} rad/s", robot.speed_rad_s());
    robot.wait_for(Mode::Fault);
}

#[test]
fn a_drive_that_takes_no_outputs_stops_the_others_within_the_blind_limit() {
    for speed_mm_s in SPEEDS_MM_S {
        for (clocks, deaf_ms) in [(false, 300), (true, 300), (false, 8), (true, 8)] {
            let mut robot = drawing(speed_mm_s, clocks);
            robot.inject(CellFault::Deaf(DEAF, deaf_ms));
            let stopped_ms = quick_stop_after_ms(&mut robot, &[DEAF]);
            println!("{speed_mm_s} mm/s, clocks {clocks}, {deaf_ms} ms: the others brake after {stopped_ms:?} ms");
            let own_ms = drives_own_ms(speed_mm_s, clocks);
            assert!(
                stopped_ms.is_some_and(|ms| ms <= blind_max_ms() + 1 + own_ms),
                "{stopped_ms:?}, {:?} {:?}",
                robot.fault(),
                robot.cell()
            );
            assert_stands(&mut robot);
            let fault = robot.fault();
            let is_named = match fault {
                Some(Fault::OutputsLost { axis, .. }) => axis == Some(DEAF as u8 - 1),
                // The drive's own watchdog has expired meanwhile.
                Some(Fault::SlaveState { slave, .. }) => deaf_ms > 10 && slave == DEAF as u8 - 1,
                _ => false,
            };
            assert!(is_named, "{fault:?}");
            robot.run(500);
            assert_eq!(come_back(&mut robot, 1), 1);
        }
    }
}

#[test]
fn lost_output_telegrams_end_in_a_quick_stop_as_soon_as_it_can_arrive() {
    for speed_mm_s in SPEEDS_MM_S {
        for clocks in [false, true] {
            // Shorter than the drives' watchdog of 10 ms: the controller's quick stop arrives.
            let mut robot = drawing(speed_mm_s, clocks);
            robot.inject(CellFault::Mute(8));
            let stopped_ms = quick_stop_after_ms(&mut robot, &[]);
            println!("{speed_mm_s} mm/s, clocks {clocks}: brakes after {stopped_ms:?} ms");
            assert!(
                stopped_ms.is_some_and(|ms| ms <= 8 + 1 + drives_own_ms(speed_mm_s, clocks)),
                "{stopped_ms:?}, {:?} {:?}",
                robot.fault(),
                robot.cell()
            );
            assert_stands(&mut robot);
            assert!(
                matches!(robot.fault(), Some(Fault::OutputsLost { axis: None, lost_ms, limit_ms })
                    if u32::from(limit_ms) == blind_max_ms() && lost_ms == limit_ms),
                "{:?}",
                robot.fault()
            );
            assert_eq!(come_back(&mut robot, 1), 1);
            // Longer: the drives' own watchdogs stop the motors.
            let mut robot = drawing(speed_mm_s, clocks);
            robot.inject(CellFault::Mute(300));
            robot.run(150);
            assert!(robot.speed_rad_s() < STILL_RAD_S, "{} rad/s", robot.speed_rad_s());
            robot.run(400);
            robot.wait_for(Mode::Fault);
            assert_eq!(come_back(&mut robot, 1), 1);
        }
    }
}

#[test]
fn outputs_that_are_lost_for_less_than_the_blind_limit_cost_nothing() {
    for speed_mm_s in SPEEDS_MM_S {
        for fault in [CellFault::Mute, |ms| CellFault::Deaf(DEAF, ms)] {
            for (lost_ms, every_ms) in [(1, 2), (1, 7), (u64::from(blind_max_ms()) - 2, 11)] {
                let mut robot = drawing(speed_mm_s, false);
                for _ in 0..100 {
                    robot.inject(fault(lost_ms));
                    robot.run(every_ms);
                }
                assert_eq!(robot.fault(), None, "{lost_ms} of {every_ms} ms");
                assert_eq!(come_back_from_drawing(&mut robot), None);
            }
        }
    }
}

/// Lets the drawing end; returns the fault that ended it instead.
fn come_back_from_drawing(robot: &mut Robot) -> Option<Fault> {
    for _ in 0..60_000 {
        if robot.has_drawn() || robot.fault().is_some() {
            break;
        }
        robot.run(1);
    }
    assert!(robot.has_drawn() || robot.fault().is_some(), "{:?}", robot.status);
    robot.fault()
}
