//! The certifier's kinematics against the planner's, through whole motions, and input that is no motion.

use crate::paths::Random;
use crate::planning::{EXCESS, limits, robot};
use etherpen_certify::{Certificate, Certifier, Kind, Quantity, Stretch};
use etherpen_motion::robots::{Geometry, Kind as RobotKind, Position, ScaraGeometry};
use etherpen_motion::{Settings, WorkArea};

/// A straight stretch at one speed.
fn straight(from: [f64; 3], way: [f64; 3], speed_mm_s: f64, acceleration_mm_s2: f64, duration_s: f64) -> Stretch {
    let mut stretch = Stretch {
        parameter: [0.0, 1.0],
        speed_mm_s,
        acceleration_mm_s2,
        time_s: [0.0, duration_s],
        ends_s: duration_s,
        drawn: true,
        vertex: 1,
        ..Stretch::default()
    };
    stretch.coefficients[0] = from;
    stretch.coefficients[1] = way;
    stretch
}

fn certificate(settings: &Settings, path: &[[f64; 3]], stretches: &[Stretch]) -> Certificate {
    let mut certifier = Certifier::new(robot(settings), limits(settings, 0, EXCESS), path.to_vec());
    stretches.iter().for_each(|stretch| certifier.take(stretch));
    certifier.finish()
}

/// Speeds and accelerations of the joints on a short line are those of the planner's kinematics at its place.
#[test]
fn joints_move_as_in_the_planners_kinematics() {
    for kind in RobotKind::ALL {
        joints_move_as_in(&Settings::usual(kind.geometry()));
    }
    let other_side = ScaraGeometry {
        elbow: -1,
        shoulder_range_rad: [0.0, 5.5],
        ..ScaraGeometry::default()
    };
    joints_move_as_in(&Settings::usual(Geometry::Scara(other_side)));
}

fn joints_move_as_in(settings: &Settings) {
    let mut settings = settings.clone();
    settings.paper.pressing_depth_mm = 1000.0;
    let settings = &settings;
    let area = WorkArea::new(settings).unwrap();
    let (kinematics, volume) = (area.kinematics(), settings.work_area);
    let reach = |[low, high]: [f64; 2]| [low.max(-volume.radius_mm), high.min(volume.radius_mm)];
    let ([x_low, x_high], [y_low, y_high]) = (reach(volume.x_mm), reach(volume.y_mm));
    let mut random = Random::new(3);
    let mut checked = 0;
    while checked < 300 {
        let at = [
            random.between(x_low, x_high),
            random.between(y_low, y_high),
            random.between(volume.z_low_mm, volume.z_high_mm),
        ];
        let (Ok(angles), true) = (
            kinematics.inverse(&Position::from(at)),
            area.check_around(&Position::from(at), 1.0).is_ok(),
        ) else {
            continue;
        };
        let direction = [0, 1, 2].map(|_| random.between(-1.0, 1.0));
        let length = direction.iter().map(|part| part * part).sum::<f64>().sqrt();
        let unit = direction.map(|part| part / length);
        let rows = kinematics.rows(&at, &unit, &[0.0; 3]);
        let (speed, acceleration) = (random.between(50.0, 300.0), random.between(-3_000.0, 3_000.0));
        let end = [0, 1, 2].map(|axis| at[axis] + unit[axis]);
        let moved = straight(at, unit, speed, acceleration, 1.0e-8);
        let found = certificate(settings, &[at, end], &[moved]);
        for (axis, angle) in angles.into_iter().enumerate() {
            let number = axis as u8 + 1;
            let close = |quantity, expected: f64| {
                let used = found.uses[&quantity];
                assert!(
                    (used.least - expected).abs() < 1.0e-5,
                    "{quantity} at {at:?}: {used:?} for {expected}"
                );
                assert!(
                    (used.most - expected).abs() < 1.0e-5,
                    "{quantity} at {at:?}: {used:?} for {expected}"
                );
            };
            let [low, high] = settings.geometry.ranges_rad()[axis];
            close(Quantity::Angle(number), (2.0 * angle - low - high).abs() / (high - low));
            let motion = &settings.motion;
            close(
                Quantity::JointSpeed(number),
                rows.slope[axis].abs() * speed / motion.joint_speed_rad_s[axis],
            );
            let value = rows.bend[axis] * speed * speed + rows.slope[axis] * acceleration;
            let limit = motion.joint_acceleration_rad_s2[axis];
            close(Quantity::JointAcceleration(number), value.abs() / limit);
        }
        checked += 1;
    }
}

#[test]
fn jumps_gaps_and_a_curve_off_its_path_are_refused() {
    let settings = Settings::default();
    let (from, to) = ([0.0, 0.0, -850.0], [10.0, 0.0, -850.0]);
    let quantity = |stretches: &[Stretch], quantity: Quantity, kind: Kind| {
        let found = certificate(&settings, &[from, to], stretches);
        let refused = found
            .refusals
            .iter()
            .any(|refusal| (refusal.quantity, refusal.kind) == (quantity, kind));
        assert!(refused, "{quantity}: {:?}", found.refusals);
    };
    // From rest to 100 mm/s at once, and from there to another place.
    let first = straight(from, [1.0, 0.0, 0.0], 100.0, 0.0, 0.01);
    quantity(&[first], Quantity::Jump, Kind::Violated);
    let mut second = straight([1.5, 0.0, -850.0], [1.0, 0.0, 0.0], 100.0, 0.0, 0.01);
    second.ends_s = 0.02;
    quantity(&[first, second], Quantity::Gap, Kind::Violated);
    let aside = straight([0.0, 0.2, -850.0], [1.0, 0.0, 0.0], 100.0, 0.0, 0.01);
    quantity(&[aside], Quantity::Tolerance, Kind::Violated);
}

#[test]
fn what_is_no_motion_is_refused_and_nothing_panics() {
    let settings = Settings::default();
    let path = [[0.0, 0.0, -850.0], [10.0, 0.0, -850.0]];
    let sound = straight(path[0], [1.0, 0.0, 0.0], 100.0, 0.0, 0.01);
    let odd = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        -1.0,
        f64::MAX,
        -f64::MAX,
        1.0e300,
        f64::MIN_POSITIVE,
        0.0,
    ];
    for value in odd {
        let mut all = [sound; 10];
        all[0].coefficients[1][0] = value;
        all[1].coefficients[5][2] = value;
        all[2].parameter[1] = value;
        all[3].start_mm = value;
        all[4].speed_mm_s = value;
        all[5].acceleration_mm_s2 = value;
        all[6].time_s[1] = value;
        all[7].ends_s = value;
        all[8].turn_rad_mm = value;
        all[9].coefficients[0] = [value; 3];
        for stretch in all {
            let found = certificate(&settings, &path, &[sound, stretch, sound]);
            assert!(!found.is_proved(), "{stretch:?}");
            let found = certificate(&settings, &path[..1], &[stretch]);
            assert!(!found.is_proved(), "{stretch:?}");
            assert!(!certificate(&settings, &[], &[stretch]).is_proved());
        }
    }
    let mut broken = limits(&settings, 4, EXCESS);
    broken.speed_mm_s = f64::NAN;
    let mut certifier = Certifier::new(robot(&settings), broken, path.to_vec());
    certifier.take(&sound);
    assert!(!certifier.finish().is_proved());
}
