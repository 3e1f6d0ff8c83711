//! The complete cell, driven by hand-made frames.

use super::*;
use crate::random::Random;
use etherpen::control::position::PositionController;
use etherpen::robots::Kinematics;
use etherpen_segment::rig::{Bus, LWR, Rig};

impl Bus for Cell {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.frame(time_us, frame)
    }
}

fn rig(options: CellOptions) -> Rig<Cell> {
    Rig::new(Cell::new(&Config::default(), options))
}

/// Drives the joints down and around, with the pen on the paper for a part of it.
fn draw(mut rig: Rig<Cell>) -> (Vec<InkStroke>, CellState) {
    rig.bring_up();
    for cycle in 0..1500i32 {
        let phase = f64::from(cycle) * 0.01;
        let down = if cycle < 600 { 18_000 } else { 0 };
        let velocity = [0.0, 2.0, 4.0].map(|shift| (9_000.0 * (phase + shift).sin()) as i32 + down);
        rig.cycle([velocity[0], velocity[1], velocity[2], 5_000], 0x0F);
    }
    (rig.bus.ink().to_vec(), rig.bus.state())
}

fn paper_below(options: CellOptions) -> Rig<Cell> {
    let mut config = Config::default();
    config.paper.pen_down_z_mm = -800.0;
    Rig::new(Cell::new(&config, options))
}

#[test]
fn the_same_frames_leave_the_same_ink() {
    let (ink, state) = draw(paper_below(CellOptions::default()));
    assert!(!ink.is_empty(), "{state:?}");
    assert!(ink[0].start_ms > 100, "the pen starts above the paper: {state:?}");
    assert!(
        (ink, state) == draw(paper_below(CellOptions::default())),
        "another picture"
    );
}

#[test]
fn jitter_of_frames_below_half_a_millisecond_changes_nothing() {
    let still = draw(paper_below(CellOptions::default()));
    for seed in 1..=3 {
        let mut rig = paper_below(CellOptions::default());
        rig.bus.advance_to(rig.time_us);
        rig.jitter = Some(Random::new(seed));
        assert!(draw(rig) == still, "seed {seed}");
    }
}

#[test]
fn the_phase_of_the_first_frame_does_not_matter() {
    let lines = |ink: Vec<InkStroke>| ink.into_iter().map(|stroke| stroke.points_mm).collect::<Vec<_>>();
    let still = lines(draw(paper_below(CellOptions::default())).0);
    for phase_us in [130, 480, 510, 730, 990] {
        let mut rig = paper_below(CellOptions::default());
        rig.bus.advance_to(0);
        rig.time_us += phase_us;
        rig.jitter = Some(Random::new(phase_us));
        assert!(lines(draw(rig).0) == still, "phase {phase_us} us");
    }
}

#[test]
fn the_seed_moves_the_starting_pose() {
    let pose = |seed| {
        Cell::new(
            &Config::default(),
            CellOptions {
                seed,
                ..CellOptions::default()
            },
        )
        .state()
        .joints
    };
    assert_eq!(pose(1), pose(1));
    assert_ne!(pose(1), pose(2));
    for (joint, axis) in pose(2).0.iter().zip(Config::default().axes) {
        assert!((joint - axis.sync_angle_rad).abs() <= 0.1);
    }
}

/// References of a circle of 40 mm radius at up to 400 mm/s: from a joint pose to its start, down, and twice around.
fn circle_references(from: [f64; AXES], config: &Config) -> Vec<[f64; AXES]> {
    let kinematics = Kinematics::new(&config.geometry).expect("the default geometry");
    let ease = |share: f64| share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share);
    let joints = |angle: f64, lift_mm: f64| {
        let position = Position {
            x_mm: 40.0 * angle.cos(),
            y_mm: 40.0 * angle.sin(),
            z_mm: config.paper.pen_down_z_mm + lift_mm,
        };
        let [a, b, c] = kinematics.inverse(&position).expect("within reach");
        [a, b, c, from[3]]
    };
    let above = joints(0.0, 3.0);
    let share = |ms: u32, of: f64| ease((f64::from(ms) / of).min(1.0));
    let blend = |s: f64| std::array::from_fn(|axis| from[axis] + s * (above[axis] - from[axis]));
    let approach = (0..1000).map(|ms| blend(share(ms, 1000.0)));
    let down = (0..200).map(|ms| joints(0.0, 3.0 * (1.0 - share(ms, 150.0))));
    let turns = std::f64::consts::TAU * 2.0;
    let around = (0..2400).map(|ms| joints(turns * share(ms, 2356.0), 0.0));
    approach.chain(down).chain(around).collect()
}

#[test]
fn the_documented_control_law_draws_a_circle_within_fifty_micrometres() {
    let config = Config::default();
    let mut rig = rig(CellOptions::default());
    rig.bring_up();
    let references = circle_references(rig.bus.state().joints.0, &config);
    let mut controllers = config.axes.map(|axis| PositionController::new(&axis));
    let mut unwrapped: [Option<(i32, i64)>; AXES] = [None; AXES];
    for now in 0..references.len() {
        rig.control(|positions| {
            std::array::from_fn(|axis| {
                let (last, sum) = unwrapped[axis].unwrap_or_else(|| {
                    let near = if positions[axis] > 1 << 19 { 1 << 20 } else { 0 };
                    (positions[axis], i64::from(positions[axis] - near))
                });
                let step = (positions[axis] - last + (1 << 19)).rem_euclid(1 << 20) - (1 << 19);
                unwrapped[axis] = Some((positions[axis], sum + i64::from(step)));
                let turns = (sum + i64::from(step)) as f64 / f64::from(1 << 20);
                let measured =
                    config.axes[axis].sync_angle_rad + turns * std::f64::consts::TAU / config.axes[axis].gear;
                let at = |ms: usize| references[ms.min(references.len() - 1)][axis];
                let ahead = (now..now + 16).map(|ms| (at(ms) - at(ms.max(1) - 1)) * 1000.0);
                let rad_s = controllers[axis].step(at(now), measured, ahead);
                (rad_s * config.axes[axis].gear * 60.0 / std::f64::consts::TAU * config.axes[axis].digits_per_rpm)
                    as i32
            })
        });
    }
    let state = rig.bus.state();
    assert_eq!(rig.bus.ink().len(), 1, "{state:?}");
    let radii = rig.bus.ink()[0]
        .points_mm
        .iter()
        .map(|[x, y]| (x - 100.0).hypot(y - 100.0));
    let worst = radii.map(|radius| (radius - 40.0).abs()).fold(0.0, f64::max);
    assert!(worst < 0.05, "{worst} mm beside the circle");
    assert_eq!(
        (state.contacts_outside, state.unreachable_ms, state.end_stop_ms),
        (0, 0, 0)
    );
}

#[test]
fn drives_of_any_kind_are_the_axes_in_their_order() {
    let slaves = parse_slaves("ek1100,cia402,ax2000*2,ek1100,cia402,ax2000").expect("a list");
    let rig = rig(CellOptions {
        slaves,
        ..CellOptions::default()
    });
    let state = rig.bus.state();
    assert_eq!(state.slaves.len(), 7);
    let default = Cell::new(&Config::default(), CellOptions::default()).state();
    assert_eq!(state.joints, default.joints, "the same pose from the same seed");
    assert!(state.platform.is_some());
}

/// All four drives enabled in digital current mode, with this torque demand of the main axes from then on.
fn main_axes_with_torque(digits: i16, milliseconds: u32) -> CellState {
    main_axes_in(CellOptions::default(), digits, milliseconds)
}

fn main_axes_in(options: CellOptions, digits: i16, milliseconds: u32) -> CellState {
    let mut rig = rig(options);
    rig.addresses();
    rig.mailboxes();
    rig.request(2);
    for station in 0x1001..=0x1004u16 {
        assert_eq!(rig.download(station, 0x6060, 0, &[0xFD]), 0);
        assert_eq!(rig.download(station, 0x1C12, 0, &[0]), 0);
        assert_eq!(rig.download(station, 0x1C12, 1, &[3, 0x17]), 0);
        assert_eq!(rig.download(station, 0x1C12, 0, &[1]), 0);
        rig.write(station, 0x0810, &[0x00, 0x11, 4, 0, 0x64, 0, 1, 0]);
        rig.write(station, 0x0818, &[0x40, 0x11, 6, 0, 0x20, 0, 1, 0]);
        let start = 4 * (station - 0x1001) as u8;
        rig.write(
            station,
            0x0600,
            &[start, 0, 1, 0, 4, 0, 0, 7, 0, 0x11, 0, 2, 1, 0, 0, 0],
        );
    }
    rig.request(4);
    let cycle = |rig: &mut Rig<Cell>, torque: i16, control: u8| {
        let [low, high] = torque.to_le_bytes();
        let main = [low, high, control, 0];
        let outputs: Vec<u8> = [main, main, main, [0, 0, control, 0]].concat();
        assert_eq!(rig.ask(LWR, 0, 1, &outputs).1, 4);
    };
    cycle(&mut rig, 0, 0);
    rig.request(8);
    for control in [0, 6, 7, 15] {
        for _ in 0..4 {
            cycle(&mut rig, digits, control);
        }
    }
    for _ in 0..milliseconds {
        cycle(&mut rig, digits, 15);
    }
    rig.bus.state()
}

#[test]
fn main_axes_fall_without_torque_and_rise_with_more_than_their_weight() {
    let fallen = main_axes_with_torque(0, 60);
    assert!(fallen.velocities.0[..3].iter().all(|rad_s| *rad_s > 0.5), "{fallen:?}");
    assert!(fallen.velocities.0[3].abs() < 0.01);
    let risen = main_axes_with_torque(-800, 20);
    assert!(risen.velocities.0[..3].iter().all(|rad_s| *rad_s < -0.5), "{risen:?}");
}

fn physics(physics: Physics, seed: u64) -> CellOptions {
    CellOptions {
        physics,
        seed,
        ..CellOptions::default()
    }
}

#[test]
fn a_pessimistic_cell_repeats_itself_by_its_seed_and_differs_from_the_nominal_one() {
    let pessimistic = |seed| draw(paper_below(physics(Physics::PESSIMISTIC, seed)));
    let (ink, state) = pessimistic(1);
    assert!(!ink.is_empty(), "{state:?}");
    assert!((ink.clone(), state.clone()) == pessimistic(1), "another picture");
    assert!((ink.clone(), state.clone()) != pessimistic(2), "the same picture");
    assert!(
        (ink, state) != draw(paper_below(CellOptions::default())),
        "the nominal picture"
    );
}

#[test]
fn every_phenomenon_alone_changes_what_the_robot_does() {
    let still = draw(paper_below(CellOptions::default()));
    let Physics {
        velocity_loop,
        dead_time,
        resolver,
        backlash,
        structural_mode,
        calibration,
        ..
    } = Physics::PESSIMISTIC;
    let nominal = Physics::NOMINAL;
    for (name, options) in [
        (
            "velocity loop",
            Physics {
                velocity_loop,
                ..nominal
            },
        ),
        ("dead time", Physics { dead_time, ..nominal }),
        ("backlash", Physics { backlash, ..nominal }),
        (
            "structural mode",
            Physics {
                structural_mode,
                ..nominal
            },
        ),
        ("calibration", Physics { calibration, ..nominal }),
    ] {
        assert!(draw(paper_below(physics(options, 1))) != still, "{name}");
    }
    // Nothing in these frames depends on the measured position.
    assert!(draw(paper_below(physics(Physics { resolver, ..nominal }, 1))) == still);
}

#[test]
fn under_a_pi_loop_the_joints_reach_their_speed_and_the_brakes_hold_them() {
    let mut rig = Rig::new(Cell::new(&Config::default(), physics(Physics::PESSIMISTIC, 1)));
    rig.bring_up();
    (0..300).for_each(|_| {
        rig.cycle([0; 4], 0x0F);
    });
    let resting = rig.bus.state();
    assert!(
        resting.velocities.0.iter().all(|rad_s| rad_s.abs() < 1e-3),
        "{resting:?}"
    );
    // 0.5 rad/s at the joint; the resolvers' error makes 0.3 % of ripple, for the speed that the loop measures.
    let axis = Config::default().axes[0];
    let digits = (0.5 * axis.gear * 60.0 / std::f64::consts::TAU * axis.digits_per_rpm) as i32;
    (0..400).for_each(|_| {
        rig.cycle([digits; 4], 0x0F);
    });
    let moving = rig.bus.state();
    assert!(
        moving.velocities.0.iter().all(|rad_s| (rad_s - 0.5).abs() < 0.01),
        "{moving:?}"
    );
    (0..200).for_each(|_| {
        rig.cycle([0; 4], 0x02);
    });
    let stopped = rig.bus.state();
    assert!(
        stopped.velocities.0.iter().all(|rad_s| rad_s.abs() < 1e-9),
        "{stopped:?}"
    );
    assert_eq!(stopped.slaves[0].drive, DriveState::SwitchOnDisabled);
    (0..200).for_each(|_| {
        rig.cycle([0; 4], 0x00);
    });
    let held = rig.bus.state().joints;
    for (held, stopped) in held.0.iter().zip(stopped.joints.0) {
        assert!((held - stopped).abs() < 1e-4, "{held} {stopped}");
    }
}

#[test]
fn a_payload_lets_main_axes_in_torque_mode_fall_by_their_weight() {
    // Main axes that carry 1.6 kg instead of 0.6 kg need more torque: what just holds the empty platform is too little.
    let loaded = Physics {
        payload: Payload { mass_kg: 1.0 },
        ..Physics::NOMINAL
    };
    let held = |options| main_axes_in(options, -160, 100).velocities.0[..3].to_vec();
    let (empty, loaded) = (held(CellOptions::default()), held(physics(loaded, 1)));
    for (empty, loaded) in empty.iter().zip(&loaded) {
        assert!(*loaded > empty + 0.1, "{empty} {loaded}");
    }
}
