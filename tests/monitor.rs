//! The monitor's kinematics and numbers against the firmware's: two independent ways to the same place.

use etherpen::config::Config;
use etherpen::robots::{JointAngles, Kinematics};
use etherpen_monitor::robot::Dimensions;
use etherpen_monitor::{Cell, Robot};
use host_tools::random::Random;

/// Largest distance between the two positions, mm.
const APART_MAX_MM: f64 = 1.0e-6;

/// The monitor's robot of a configuration.
fn robot(config: &Config) -> Robot {
    Robot::new(&Dimensions {
        base_radius_mm: config.geometry.base_radius_mm,
        upper_arm_mm: config.geometry.upper_arm_mm,
        forearm_mm: config.geometry.forearm_mm,
        platform_radius_mm: config.geometry.platform_radius_mm,
        azimuths_deg: config.geometry.arm_azimuths_deg,
    })
}

#[test]
fn both_kinematics_lead_to_the_same_position() {
    let mut config = Config::default();
    let mut random = Random::new(5);
    let mut compared = 0;
    for case in 0..20_000 {
        if case % 1_000 == 0 {
            // Another robot, whose joints do not stand at equal angles.
            config.geometry.upper_arm_mm = 300.0 + 100.0 * random.unit();
            config.geometry.arm_azimuths_deg = [0.0, 120.0, 240.0].map(|azimuth| azimuth + 20.0 * random.unit());
        }
        let angles = [(); 3].map(|()| -0.7 + 2.4 * random.unit());
        let [first, second, third] = angles;
        let kinematics = Kinematics::new(&config.geometry).expect("a valid robot");
        let theirs = kinematics.forward(&JointAngles([first, second, third, 0.0]));
        let ours = robot(&config).tool(angles);
        let (Ok(theirs), Some([x, y, z])) = (theirs, ours) else {
            assert!(theirs.is_err() && ours.is_none(), "{angles:?}: {theirs:?}, {ours:?}");
            continue;
        };
        let apart_mm = (theirs.x_mm - x).hypot(theirs.y_mm - y).hypot(theirs.z_mm - z);
        assert!(apart_mm < APART_MAX_MM, "{angles:?}: {apart_mm} mm apart");
        compared += 1;
    }
    assert!(compared > 10_000, "only {compared} poses have a position");
}

#[test]
fn the_monitors_default_numbers_are_those_of_the_default_configuration() {
    let (config, cell) = (Config::default(), Cell::default());
    assert_eq!(robot(&config), cell.robot);
    let motion = &config.motion;
    assert_eq!(
        (
            cell.tool_speed_mm_s,
            cell.travel_speed_mm_s,
            cell.tool_acceleration_mm_s2
        ),
        (motion.speed_mm_s, motion.travel_speed_mm_s, motion.acceleration_mm_s2)
    );
    assert_eq!(
        (cell.tolerance_mm, cell.travel_tolerance_mm),
        (motion.tolerance_mm, motion.travel_tolerance_mm)
    );
    for (joint, axis) in cell.joints.iter().zip(&config.axes) {
        assert_eq!(
            (joint.quick_stop_rad_s2, joint.output_max_rad_s, joint.mark_rad),
            (axis.quick_stop_rad_s2, axis.output_max_rad_s, axis.sync_angle_rad)
        );
    }
    assert_eq!(
        (cell.dead_man_ms, cell.watchdog_ms, cell.host_silence_ms, cell.blind_ms),
        (
            config.bus.dead_man_ms.into(),
            config.bus.watchdog_ms.into(),
            config.bus.host_silence_ms.into(),
            config.bus.blind_max_ms.into()
        )
    );
}
