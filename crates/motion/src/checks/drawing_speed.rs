//! Requirements on the speed that goes with each setpoint: a laser or a dispenser follows it.

use super::properties::{varied, varied_path};
use super::*;

/// Relative difference between the average of angles and the angles of an average, for motion over a window.
const BENT: f64 = 0.001;
/// Difference that counts as none, mm/s: the speed of the tool is a difference of rounded places.
const ROUNDED_MM_S: f64 = 0.05;

/// Way of the tool over the paper that leads to each setpoint but the first, mm/s, and the setpoint.
fn ways(run: &Run) -> impl Iterator<Item = (f64, &Setpoint)> {
    let kinematics = Kinematics::new(&run.settings.geometry).unwrap();
    let place = move |setpoint: &Setpoint| -> Vector {
        let joints = JointAngles(setpoint.position_rad);
        kinematics.forward(&joints).unwrap().into()
    };
    run.setpoints.windows(2).map(move |pair| {
        let [x, y, _] = subtract(&place(&pair[1]), &place(&pair[0]));
        (x.hypot(y) / TICK_S, &pair[1])
    })
}

#[test]
fn the_speed_of_a_setpoint_is_that_of_the_tool_and_none_with_the_pen_up() {
    let mut drawn = 0_u32;
    for kind in Kind::ALL {
        let bench = Bench::new(kind);
        let (mut worst, mut fastest) = (0.0_f64, 0.0_f64);
        for seed in 1..=40 {
            let mut random = Random::new(seed);
            let settings = varied(&mut random, &bench);
            let path = bench.fitted(&varied_path(&mut random, &settings));
            let run = Run::new(&settings, &path).whole();
            for (speed_mm_s, setpoint) in ways(&run) {
                let told_mm_s = f64::from(setpoint.drawing_mm_s);
                if setpoint.pen == Pen::Up {
                    assert_eq!(told_mm_s, 0.0, "{kind:?}, seed {seed}");
                    continue;
                }
                drawn += 1;
                let off_mm_s = (told_mm_s - speed_mm_s).abs();
                let allowed_mm_s = ROUNDED_MM_S + BENT * settings.motion.speed_mm_s;
                assert!(
                    off_mm_s < allowed_mm_s,
                    "{kind:?}, seed {seed}: {told_mm_s} instead of {speed_mm_s} mm/s"
                );
                (worst, fastest) = (worst.max(off_mm_s), fastest.max(speed_mm_s));
            }
        }
        println!("{kind:?}: at most {worst:.4} mm/s beside, of at most {fastest:.1} mm/s");
    }
    assert!(drawn > 10_000, "{drawn}");
}

#[test]
fn a_move_with_the_pen_up_has_no_speed() {
    let settings = Settings::default();
    let path = [
        vertex([-60.0, 0.0, -850.0], Pen::Up, 0),
        vertex([60.0, 0.0, -850.0], Pen::Down, 0),
        vertex([60.0, 40.0, -850.0], Pen::Down, 0),
    ];
    let mut run = Run::new(&settings, &path);
    run.command(MotionCommand::Start);
    run.until(MotionState::Idle);
    let fast = |run: &Run| {
        run.setpoints
            .iter()
            .filter(|setpoint| setpoint.drawing_mm_s > 10.0)
            .count()
    };
    let drawn = fast(&run);
    assert!(drawn > 100, "{drawn}");
    run.command(MotionCommand::MoveTo([0.0, 0.0, -840.0].into()));
    run.until(MotionState::Idle);
    assert_eq!(fast(&run), drawn);
}
