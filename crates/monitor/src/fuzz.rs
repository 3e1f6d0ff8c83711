//! Random operators and machines: a robot that stands breaks no rule, and no input panics.

use crate::moment::Clocks;
use crate::rig::JOB;
use crate::{Cell, Command, Count, Input, Joint, Mode, Moment, Monitor, Report, Rule, WireFrame};
use proptest::prelude::*;

fn command() -> impl Strategy<Value = Command> {
    let number = || prop_oneof![9 => -900.0_f64..900.0, 1 => proptest::num::f64::ANY];
    let vector = move || [number(), number(), number()];
    prop_oneof![
        Just(Command::Home),
        proptest::array::uniform4(-1.0_f64..2.0).prop_map(|pose_rad| Command::HomeAt { pose_rad }),
        Just(Command::Enable),
        Just(Command::Disable),
        vector().prop_map(|velocity_mm_s| Command::Jog { velocity_mm_s }),
        vector().prop_map(|position_mm| Command::Move { position_mm }),
        Just(Command::Draw { job: JOB }),
        Just(Command::Hold),
        Just(Command::Resume),
        Just(Command::Cancel),
        any::<u8>().prop_map(|percent| Command::Override { percent }),
        any::<bool>().prop_map(|down| Command::Pen { down }),
        Just(Command::Stop),
        Just(Command::Acknowledge),
    ]
}

fn input() -> impl Strategy<Value = Input> {
    prop_oneof![
        8 => command().prop_map(Input::Commanded),
        1 => Just(Input::Configured),
        1 => any::<bool>().prop_map(Input::StopInput),
        1 => any::<bool>().prop_map(Input::ClockFailed),
        1 => (0_usize..9, any::<bool>()).prop_map(|(axis, disturbed)| Input::Feedback { axis, disturbed }),
        1 => (0_usize..9).prop_map(|axis| Input::Mounted { axis }),
        1 => any::<bool>().prop_map(|disturbed| Input::Machine { disturbed }),
        1 => (0_usize..9, any::<bool>()).prop_map(|(axis, deaf)| Input::Drive { axis, deaf }),
        1 => any::<bool>().prop_map(|cut| Input::Link { cut }),
        1 => Just(Input::Restarted),
        4 => (any::<u8>(), proptest::array::uniform3(-300.0_f64..300.0), any::<bool>()).prop_map(
            |(index, position_mm, pen_down)| Input::PathVertex { job: JOB, index: index.into(), position_mm, pen_down }
        ),
    ]
}

fn mode() -> impl Strategy<Value = Mode> {
    proptest::sample::select(vec![
        Mode::Startup,
        Mode::BusConfiguring,
        Mode::DrivesOff,
        Mode::Unreferenced,
        Mode::Idle,
        Mode::Homing,
        Mode::Moving,
        Mode::Drawing,
        Mode::Holding,
        Mode::Stopping,
        Mode::Fault,
    ])
}

fn report() -> impl Strategy<Value = Report> {
    prop_oneof![
        mode().prop_map(Report::Mode),
        any::<bool>().prop_map(|is_fault| Report::Fault(is_fault.then(|| "a fault".into()))),
        any::<bool>().prop_map(Report::Homed),
        command().prop_map(Report::Accepted),
        command().prop_map(Report::Refused),
        any::<u32>().prop_map(|index| Report::VertexRefused { job: JOB, index }),
        any::<u64>().prop_map(|count| Report::Counters(vec![Count { name: "count", count }])),
    ]
}

/// What crosses the walls in a millisecond, and how many follow without anything.
fn crossing() -> impl Strategy<Value = (Vec<Input>, Vec<Report>, u64)> {
    let quiet = prop_oneof![3 => 0_u64..20, 1 => 0_u64..2_000];
    (
        proptest::collection::vec(input(), 0..3),
        proptest::collection::vec(report(), 0..2),
        quiet,
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn whatever_is_ordered_a_robot_that_stands_without_power_breaks_no_rule(
        crossings in proptest::collection::vec(crossing(), 1..40),
    ) {
        let mut monitor = Monitor::new(Cell::default());
        let joint = Joint { angle_rad: 0.3, ..Joint::default() };
        let mut time_ms = 0;
        for (inputs, reports, quiet_ms) in &crossings {
            for quiet in 0..=*quiet_ms {
                time_ms += 1;
                let crosses = quiet == 0;
                let moment = Moment {
                    time_ms,
                    joints: &[joint; 4],
                    pen_touches: false,
                    inputs: if crosses { inputs } else { &[] },
                    reports: if crosses { reports } else { &[] },
                    wire: &[],
                    clocks: Clocks::default(),
                };
                let found = monitor.step(&moment);
                let is_count = found.as_ref().is_err_and(|violation| violation.rule == Rule::Counters);
                prop_assert!(found.is_ok() || is_count, "{found:?}");
            }
        }
    }

    #[test]
    fn nothing_panics(
        crossings in proptest::collection::vec((crossing(), any::<u64>()), 1..20),
        numbers in proptest::collection::vec(proptest::num::f64::ANY, 16),
        joints in 0_usize..10,
        bytes in proptest::collection::vec(any::<u8>(), 0..100),
    ) {
        let number = |at: usize| numbers[at % numbers.len()];
        let mut cell = Cell {
            tool_speed_mm_s: number(0),
            travel_speed_mm_s: number(1),
            tool_acceleration_mm_s2: number(2),
            tolerance_mm: number(3),
            disturbed_mm: number(4),
            ..Cell::default()
        };
        cell.joints.truncate(joints);
        cell.joints.iter_mut().for_each(|joint| {
            (joint.quick_stop_rad_s2, joint.acceleration_rad_s2, joint.turn_rad) = (number(5), number(6), number(7));
        });
        let mut monitor = Monitor::new(cell);
        for (step, ((inputs, reports, _), time_ms)) in crossings.iter().enumerate() {
            let joint = Joint { angle_rad: number(step), speed_rad_s: number(step + 1), has_power: step % 2 == 0, is_switched_off: step % 3 == 0 };
            let _ = monitor.step(&Moment {
                // Some follow each other, others leap.
                time_ms: match step % 4 {
                    0 => *time_ms,
                    1 => u64::MAX - *time_ms % 3_000,
                    _ => step as u64,
                },
                joints: &vec![joint; joints],
                pen_touches: step % 5 == 0,
                inputs,
                reports,
                wire: &[WireFrame { from_master: true, bytes: &bytes, time_ns: 0 }],
                clocks: Clocks { time_ns: *time_ms, system_ns: &[Some(time_ms.rotate_left(17)), None, Some(1 << 31), Some(0)] },
            });
        }
        let _ = monitor.end();
    }
}
