//! The certifier's kinematics against the planner's, through whole motions, and input that is no motion.

use crate::paths::Random;
use crate::planning::{EXCESS, limits, robot};
use etherpen_certify::{Certificate, Certifier, Kind, Quantity, Stretch};
use etherpen_motion::robots::{Geometry, JointAngles, Kind as RobotKind, Kinematics, Position, ScaraGeometry};
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
    let kinematics = area.kinematics();
    let mut random = Random::new(3);
    for _ in 0..300 {
        let (at, angles) = pose(settings, &area, &mut random);
        let unit = direction(&mut random);
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
    }
}

/// A random place inside the work area, a millimetre from its border at least, with the angles there.
fn pose(settings: &Settings, area: &WorkArea, random: &mut Random) -> ([f64; 3], [f64; 3]) {
    let volume = settings.work_area;
    let reach = |[low, high]: [f64; 2]| [low.max(-volume.radius_mm), high.min(volume.radius_mm)];
    let ([x_low, x_high], [y_low, y_high]) = (reach(volume.x_mm), reach(volume.y_mm));
    loop {
        let at = [
            random.between(x_low, x_high),
            random.between(y_low, y_high),
            random.between(volume.z_low_mm, volume.z_high_mm),
        ];
        let position = Position::from(at);
        if let (Ok(angles), true) = (
            area.kinematics().inverse(&position),
            area.check_around(&position, 1.0).is_ok(),
        ) {
            return (at, angles);
        }
    }
}

fn direction(random: &mut Random) -> [f64; 3] {
    let raw = [0, 1, 2].map(|_| random.between(-1.0, 1.0));
    let length = raw.iter().map(|part| part * part).sum::<f64>().sqrt();
    raw.map(|part| part / length)
}

/// Bound of what the average of `window_ms` angles adds, mm; no limit of the motion counts.
fn bound_mm(settings: &Settings, window_ms: u16, path: &[[f64; 3]], stretches: &[Stretch]) -> f64 {
    let mut free = limits(settings, window_ms, EXCESS);
    free.joint_speed_rad_s = [1.0e9; 4];
    free.joint_acceleration_rad_s2 = [1.0e9; 4];
    (free.speed_mm_s, free.travel_speed_mm_s, free.acceleration_mm_s2) = (1.0e9, 1.0e9, 1.0e9);
    let mut certifier = Certifier::new(robot(settings), free, path.to_vec());
    stretches.iter().for_each(|stretch| certifier.take(stretch));
    certifier.finish().average_mm
}

/// Distance of the tool at these angles of the main axes from a place, mm.
fn apart_mm(kinematics: &Kinematics, [a, b, c]: [f64; 3], from: &[f64; 3]) -> f64 {
    let tool: [f64; 3] = kinematics.forward(&JointAngles([a, b, c, 0.0])).unwrap().into();
    tool.iter()
        .zip(from)
        .map(|(there, here)| (there - here).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Covers the rounding of an angle and back, mm.
const ROUNDING_MM: f64 = 1.0e-9;

/// Where the joints' accelerations move the tool within a window, with all that the second derivatives of the tool's
/// position do: the lengths of `Robot::links_mm` have to cover them.
#[test]
fn the_average_is_bounded_wherever_the_joints_bend_the_way_of_the_tool() {
    const WINDOW_MS: u16 = 32;
    let share = 1.0e-6 * (f64::from(WINDOW_MS).powi(2) - 1.0) / 24.0;
    for kind in RobotKind::ALL {
        let settings = Settings::usual(kind.geometry());
        let area = WorkArea::new(&settings).unwrap();
        let kinematics = area.kinematics();
        let mut random = Random::new(5);
        let mut bounded = 0;
        for _ in 0..1_000 {
            let (at, angles) = pose(&settings, &area, &mut random);
            let unit = direction(&mut random);
            let acceleration = 10.0_f64.powf(random.between(3.0, 6.0));
            let end = [0, 1, 2].map(|axis| at[axis] + unit[axis]);
            let moved = straight(at, unit, 0.0, acceleration, 1.0e-8);
            let bound = bound_mm(&settings, WINDOW_MS, &[at, end], &[moved]);
            if bound.is_infinite() {
                continue;
            }
            bounded += 1;
            let slope = kinematics.rows(&at, &unit, &[0.0; 3]).slope;
            let averaged = [0, 1, 2].map(|axis| angles[axis] + slope[axis] * acceleration * share);
            let apart = apart_mm(kinematics, averaged, &at);
            assert!(
                apart <= bound + ROUNDING_MM,
                "{kind:?} at {at:?} along {unit:?}, {acceleration} mm/s2: {apart} mm, the bound is {bound} mm"
            );
        }
        assert!(bounded > 300, "{kind:?}: {bounded} poses have a bound");
    }
}

/// The tool starts from rest along a line; the angles of every window are averaged as the controller does.
#[test]
fn the_average_of_the_angles_on_a_line_stays_within_its_bound() {
    const PIECE_S: f64 = 4.0e-3;
    for kind in RobotKind::ALL {
        let settings = Settings::usual(kind.geometry());
        let area = WorkArea::new(&settings).unwrap();
        let kinematics = area.kinematics();
        let mut random = Random::new(7);
        let (mut checked, mut closest) = (0, 0.0_f64);
        while checked < 60 {
            let (from, _) = pose(&settings, &area, &mut random);
            let unit = direction(&mut random);
            let acceleration = random.between(1_000.0, 30_000.0);
            let window_ms = [4, 8, 16, 32][random.below(4)];
            let pieces = 8 + random.below(8);
            let way = |time_s: f64| 0.5 * acceleration * time_s.max(0.0).powi(2);
            let place = |time_s: f64| [0, 1, 2].map(|axis: usize| from[axis] + unit[axis] * way(time_s));
            let end_s = PIECE_S * pieces as f64;
            if area.check_around(&place(end_s).into(), 1.0).is_err() {
                continue;
            }
            checked += 1;
            let stretch = |piece: usize| {
                let time_s = PIECE_S * piece as f64;
                let (here, there) = (place(time_s), place(time_s + PIECE_S));
                let leg = [0, 1, 2].map(|axis| there[axis] - here[axis]);
                let mut stretch = straight(here, leg, acceleration * time_s, acceleration, PIECE_S);
                stretch.ends_s = time_s + PIECE_S;
                stretch
            };
            let stretches: Vec<Stretch> = (0..pieces).map(stretch).collect();
            let bound = bound_mm(&settings, window_ms, &[from, place(end_s)], &stretches);
            let half_s = 0.5e-3 * (f64::from(window_ms) - 1.0);
            for millisecond in 0..4 * pieces {
                let middle_s = 1.0e-3 * millisecond as f64;
                if middle_s + half_s > end_s {
                    break;
                }
                let mut sums = [0.0; 3];
                for number in 0..window_ms {
                    let time_s = middle_s - half_s + 1.0e-3 * f64::from(number);
                    let angles = kinematics.inverse(&place(time_s).into()).unwrap();
                    sums = [0, 1, 2].map(|axis| sums[axis] + angles[axis]);
                }
                let averaged = sums.map(|sum| sum / f64::from(window_ms));
                let apart = apart_mm(kinematics, averaged, &place(middle_s));
                assert!(
                    apart <= bound + ROUNDING_MM,
                    "{kind:?} from {from:?} along {unit:?} at {middle_s} s: {apart} mm, the bound is {bound} mm"
                );
                closest = closest.max(apart / bound);
            }
        }
        assert!(
            closest > 0.8,
            "{kind:?}: the average uses {closest} of its bound at most"
        );
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
