//! The monitor's kinematics and numbers against the firmware's: two independent ways to the same place.

use etherpen::config::Config;
use etherpen::motion::{Settings, WorkArea};
use etherpen::robots::{DeltaGeometry, Geometry, JointAngles, Kind, Kinematics, LinearDeltaGeometry, Position};
use etherpen_monitor::Cell;
use host_tools::campaign::monitored;
use host_tools::random::Random;

/// Largest distance between the two positions, mm.
const APART_MAX_MM: f64 = 1.0e-6;

/// A robot of this kind whose joints do not stand at equal angles.
fn changed(kind: Kind, random: &mut Random) -> Geometry {
    let azimuths = |azimuths: [f64; 3], random: &mut Random| azimuths.map(|azimuth| azimuth + 20.0 * random.unit());
    match kind.geometry() {
        Geometry::Delta(geometry) => Geometry::Delta(DeltaGeometry {
            upper_arm_mm: 300.0 + 100.0 * random.unit(),
            arm_azimuths_deg: azimuths(geometry.arm_azimuths_deg, random),
            ..geometry
        }),
        Geometry::LinearDelta(geometry) => Geometry::LinearDelta(LinearDeltaGeometry {
            radius_mm: 100.0 + 50.0 * random.unit(),
            tower_azimuths_deg: azimuths(geometry.tower_azimuths_deg, random),
            ..geometry
        }),
        other => other,
    }
}

#[test]
fn both_kinematics_lead_to_the_same_position() {
    let mut random = Random::new(5);
    for kind in Kind::ALL {
        let mut compared = 0;
        for _ in 0..20 {
            let geometry = changed(kind, &mut random);
            let kinematics = Kinematics::new(&geometry).expect("a valid robot");
            let (robot, ranges_rad) = (monitored(&geometry), geometry.ranges_rad());
            for _ in 0..1_000 {
                let angles = ranges_rad.map(|[low, high]| low + (high - low) * random.unit());
                let [first, second, third] = angles;
                let theirs = kinematics.forward(&JointAngles([first, second, third, 0.0]));
                let ours = robot.tool(angles);
                let (Ok(theirs), Some([x, y, z])) = (theirs, ours) else {
                    assert!(theirs.is_err() && ours.is_none(), "{angles:?}: {theirs:?}, {ours:?}");
                    continue;
                };
                let apart_mm = (theirs.x_mm - x).hypot(theirs.y_mm - y).hypot(theirs.z_mm - z);
                assert!(apart_mm < APART_MAX_MM, "{kind:?} {angles:?}: {apart_mm} mm apart");
                compared += 1;
            }
        }
        assert!(compared > 5_000, "{kind:?}: only {compared} poses have a position");
    }
}

#[test]
fn the_monitors_steepest_change_holds_over_each_work_area() {
    let mut random = Random::new(6);
    for kind in Kind::ALL {
        let settings = Settings::usual(kind.geometry());
        let area = WorkArea::new(&settings).expect("a valid robot");
        let most = monitored(&settings.geometry).slope_max_rad_mm();
        let (volume, mut steepest) = (settings.work_area, 0.0_f64);
        for _ in 0..20_000 {
            let mut within = |[low, high]: [f64; 2]| low + (high - low) * random.unit();
            let round = [-volume.radius_mm, volume.radius_mm];
            let position = Position {
                x_mm: within(round),
                y_mm: within(round),
                z_mm: within([volume.z_low_mm, volume.z_high_mm]),
            };
            if !area.contains(&position) {
                continue;
            }
            for axis in 0..3 {
                let mut tangent = [0.0; 3];
                tangent[axis] = 1.0;
                let rows = area.kinematics().rows(&position.into(), &tangent, &[0.0; 3]);
                steepest = rows.slope.iter().fold(steepest, |most, slope| most.max(slope.abs()));
            }
        }
        assert!(
            steepest > 0.2 * most && steepest <= most,
            "{kind:?}: {steepest} of {most} rad/mm"
        );
    }
}

#[test]
fn the_monitors_default_numbers_are_those_of_the_default_configuration() {
    let (config, cell) = (Config::default(), Cell::default());
    assert_eq!(monitored(&config.geometry), cell.robot);
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
