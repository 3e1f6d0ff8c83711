//! A whole session of a controller that is right: no rule is broken.

use crate::moment::{Command, Count, Input, Mode, Report};
use crate::rig::Rig;
use crate::telegram::tests::frame;

/// Moves the tool as ordered, and reports as a controller does: the mode in each millisecond's telemetry.
fn go(rig: &mut Rig, mode: Mode, target: [f64; 3], ms: u32) {
    tell(rig, mode);
    assert_eq!(rig.go_to(target, ms), Ok(()), "to {target:?}");
}

fn tell(rig: &mut Rig, mode: Mode) {
    rig.report(Report::Mode(mode));
    rig.frame(true, &frame(&[4, 32]));
    rig.frame(true, &frame(&[32]));
}

/// Rests after a motion, with the reports of that.
fn rest(rig: &mut Rig, ms: u32) {
    for _ in 0..ms {
        tell(rig, Mode::Idle);
        assert_eq!(rig.step(), Ok(()));
    }
}

fn draw(rig: &mut Rig, job: u16, vertices: &[([f64; 3], bool)]) {
    rig.command(Command::Draw { job });
    tell(rig, Mode::Drawing);
    assert_eq!(rig.run(5), Ok(()));
    for (index, (position_mm, pen_down)) in (0..).zip(vertices) {
        rig.input(Input::PathVertex {
            job,
            index,
            position_mm: *position_mm,
            pen_down: *pen_down,
        });
    }
    assert_eq!(rig.run(30), Ok(()));
}

/// Two strokes.
const STROKES: [([f64; 3], bool); 8] = [
    ([10.0, 0.0, -847.0], false),
    ([10.0, 0.0, -850.0], false),
    ([40.0, 0.0, -850.0], true),
    ([40.0, 20.0, -850.0], true),
    ([40.0, 20.0, -847.0], false),
    ([0.0, 20.0, -847.0], false),
    ([0.0, 20.0, -850.0], false),
    ([0.0, -20.0, -850.0], true),
];

#[test]
fn a_whole_session_breaks_no_rule() {
    let mut rig = Rig::idle_at([0.0, 0.0, -800.0]);
    for step in 1..=5 {
        rig.command(Command::Jog {
            velocity_mm_s: [0.0, 0.0, -40.0],
        });
        go(&mut rig, Mode::Moving, [0.0, 0.0, -800.0 - 2.0 * f64::from(step)], 50);
    }
    rest(&mut rig, 400);
    let target = [10.0, 0.0, -845.0];
    rig.command(Command::Move { position_mm: target });
    go(&mut rig, Mode::Moving, target, 120);
    rest(&mut rig, 300);

    draw(&mut rig, 1, &STROKES);
    for ((position_mm, _), ms) in STROKES.iter().zip([30, 40, 130, 100]) {
        go(&mut rig, Mode::Drawing, *position_mm, ms);
    }
    rig.command(Command::Hold);
    go(&mut rig, Mode::Holding, [40.0, 20.0, -847.0], 50);
    assert_eq!(rig.run(3_000), Ok(()), "held");
    rig.command(Command::Resume);
    go(&mut rig, Mode::Drawing, [40.0, 20.0, -850.0], 50);
    rig.command(Command::Override { percent: 150 });
    for ((position_mm, _), ms) in STROKES.iter().skip(4).zip([50, 130, 50, 150]) {
        go(&mut rig, Mode::Drawing, *position_mm, ms);
    }
    rig.report(Report::Finished { job: 1 });
    rig.report(Report::Counters(vec![Count {
        name: "frames_lost",
        count: 1,
    }]));
    rest(&mut rig, 300);
    rig.command(Command::Pen { down: false });
    go(&mut rig, Mode::Moving, [0.0, -20.0, -847.0], 50);
    rest(&mut rig, 300);

    rig.command(Command::Disable);
    tell(&mut rig, Mode::Stopping);
    assert_eq!(rig.run(130), Ok(()));
    rig.power(false);
    tell(&mut rig, Mode::DrivesOff);
    assert_eq!(rig.run(2_000), Ok(()));
    rig.input(Input::Expected {
        name: "frames_lost",
        count: 1,
    });
    assert_eq!(rig.step(), Ok(()));
    assert_eq!(rig.end(), Ok(()));
}

#[test]
fn a_stop_in_a_drawing_and_the_recovery_from_it_break_no_rule() {
    let mut rig = Rig::drawing_on_paper();
    go(&mut rig, Mode::Drawing, [15.0, 0.0, -850.0], 80);
    rig.accelerate_to(0.4);
    assert_eq!(rig.run(3), Ok(()));
    rig.command(Command::Stop);
    assert_eq!(rig.run(6), Ok(()));
    rig.brake(100.0);
    rig.report(Report::Fault(Some("stopped".into())));
    tell(&mut rig, Mode::Stopping);
    assert_eq!(rig.run(140), Ok(()));
    rig.power(false);
    tell(&mut rig, Mode::Fault);
    assert_eq!(rig.run(2_000), Ok(()), "the pen stands on the paper");
    rig.command(Command::Acknowledge);
    rig.report(Report::Fault(None));
    tell(&mut rig, Mode::DrivesOff);
    assert_eq!(rig.run(40), Ok(()));
    rig.command(Command::Enable);
    assert_eq!(rig.run(20), Ok(()));
    rig.power(true);
    assert_eq!(rig.run(20), Ok(()));
    rest(&mut rig, 700);
    draw(&mut rig, 2, &STROKES);
    for ((position_mm, _), ms) in STROKES.iter().zip([60, 40, 130, 100, 50, 150, 50, 150]) {
        go(&mut rig, Mode::Drawing, *position_mm, ms);
    }
    rig.report(Report::Finished { job: 2 });
    rest(&mut rig, 300);
}
