//! What holds for every kind of robot.

use super::joint_ranges::JointRanges;
use super::vector::{add_scaled, cross, length, scale, subtract};
use super::*;
use crate::random::Random;
use crate::settings::Settings;
use proptest::prelude::*;

/// Positions in and around the work volume of a usual machine.
fn positions(settings: &Settings, count: usize) -> impl Iterator<Item = Position> {
    let (volume, mut random) = (settings.work_area, Random::new(11));
    let radius = volume.radius_mm;
    let wider = |[low, high]: [f64; 2]| [low - 0.05 * (high - low), high + 0.05 * (high - low)];
    let [x, y, z] = [
        [volume.x_mm[0].max(-radius), volume.x_mm[1].min(radius)],
        [volume.y_mm[0].max(-radius), volume.y_mm[1].min(radius)],
        [volume.z_low_mm, volume.z_high_mm],
    ]
    .map(wider);
    (0..count).map(move |_| Position {
        x_mm: random.between(x[0], x[1]),
        y_mm: random.between(y[0], y[1]),
        z_mm: random.between(z[0], z[1]),
    })
}

/// The usual machines, both sides on which a joint may stand, and unequal azimuths.
fn machines() -> impl Iterator<Item = (Settings, Kinematics)> {
    let other_side = Geometry::Scara(ScaraGeometry {
        elbow: -1,
        ..ScaraGeometry::default()
    });
    let unequal = Geometry::LinearDelta(LinearDeltaGeometry {
        tower_azimuths_deg: [80.0, 215.0, 333.0],
        ..LinearDeltaGeometry::default()
    });
    Kind::ALL
        .map(Kind::geometry)
        .into_iter()
        .chain([other_side, unequal])
        .map(|geometry| (Settings::usual(geometry), Kinematics::new(&geometry).unwrap()))
}

#[test]
fn forward_undoes_inverse() {
    for (settings, robot) in machines() {
        let (mut reached, mut worst) = (0, 0.0_f64);
        for position in positions(&settings, 20_000) {
            let Ok([a, b, c]) = robot.inverse(&position) else {
                continue;
            };
            reached += 1;
            assert_eq!(robot.angles(&position.into()), [a, b, c]);
            let back = robot.forward(&JointAngles([a, b, c, 1.7])).unwrap();
            let error_mm = length(&subtract(&back.into(), &position.into()));
            // Near a stretched pose a rounding of the angle's cosine moves the angle by its root.
            let ratio = robot.conditioning(&position).ratio.1;
            assert!(
                error_mm < 1.0e-11 / ratio.min(0.01),
                "{position:?} comes back {error_mm} mm away"
            );
            if ratio >= robot.conditioning_min().ratio {
                worst = worst.max(error_mm);
            }
        }
        let kind = settings.geometry.kind();
        assert!(reached > 6_000, "{kind:?}: only {reached} positions were reached");
        assert!(worst < 1.0e-10, "{kind:?}: {worst} mm");
    }
}

/// First and second derivative by differences of fourth order over values `step` apart.
fn differences(values: [f64; 5], step: f64) -> [f64; 2] {
    let [far_before, before, here, after, far_after] = values;
    [
        (8.0 * (after - before) - (far_after - far_before)) / (12.0 * step),
        (16.0 * (after + before) - 30.0 * here - (far_after + far_before)) / (12.0 * step * step),
    ]
}

#[test]
fn derivatives_along_a_path_agree_with_differences() {
    let bend = [0.004, -0.002, 0.003];
    let raw = cross(&bend, &[0.3, 1.0, 0.2]);
    let tangent = scale(&raw, 1.0 / length(&raw));
    for (settings, robot) in machines() {
        let (kind, mut checked) = (settings.geometry.kind(), 0);
        for position in positions(&settings, 5_000) {
            let (point, ratio) = (Vector::from(position), robot.conditioning(&position).ratio.1);
            let step = 0.2 * ratio;
            let at = |steps: f64| {
                let s = steps * step;
                let moved = add_scaled(&add_scaled(&point, &tangent, s), &bend, 0.5 * s * s);
                robot.inverse(&moved.into()).ok()
            };
            let ([Some(a), Some(b), Some(c), Some(d), Some(e)], true) =
                ([-2.0, -1.0, 0.0, 1.0, 2.0].map(at), ratio > 0.2)
            else {
                continue;
            };
            let rows = robot.rows(&point, &tangent, &bend);
            for joint in 0..MAIN_AXES {
                let values = [a, b, c, d, e].map(|angles| angles[joint]);
                let [slope, second] = differences(values, step);
                let size = slope.abs().max(0.01);
                assert!(
                    (rows.slope[joint] - slope).abs() < 1.0e-7 * size,
                    "{kind:?} {position:?}: slope {slope}, {rows:?}"
                );
                assert!(
                    (rows.bend[joint] - second).abs() < 1.0e-5 * size,
                    "{kind:?} {position:?}: bend {second}, {rows:?}"
                );
            }
            checked += 1;
        }
        assert!(checked > 1_000, "{kind:?}: only {checked} positions");
    }
}

#[test]
fn nothing_changes_faster_over_a_displacement_than_its_bound() {
    const STEP_MM: f64 = 0.05;
    // For the change of the bounds themselves over the step.
    const ROOM: f64 = 1.02;
    let directions = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, -0.64, 0.48]];
    for (settings, robot) in machines() {
        let (kind, mut checked) = (settings.geometry.kind(), 0);
        for position in positions(&settings, 5_000) {
            let (here, angles) = (robot.conditioning(&position), robot.inverse(&position));
            let (Ok(angles), true) = (angles, here.ratio.1 > 0.1) else {
                continue;
            };
            for direction in directions {
                let ahead = |by| Position::from(add_scaled(&position.into(), &direction, by));
                let (there, ends) = (
                    robot.conditioning(&ahead(STEP_MM)),
                    [STEP_MM, 2.0 * STEP_MM].map(|by| robot.inverse(&ahead(by))),
                );
                let [Ok(next), Ok(last)] = ends else { continue };
                let bound = |change: f64| ROOM * STEP_MM * change;
                for (joint, change) in here.change.angles.iter().enumerate() {
                    let (first, second) = (next[joint] - angles[joint], last[joint] - next[joint]);
                    if *change == 0.0 {
                        let part = (second - first).abs() / first.abs().max(1.0e-3);
                        assert!(part < 1.0e-9, "{kind:?}: joint {joint} is not in proportion: {part}");
                    } else {
                        assert!(first.abs() <= bound(*change), "{kind:?}: joint {joint} at {position:?}");
                    }
                }
                let ratio = (there.ratio.1 - here.ratio.1).abs();
                assert!(ratio <= bound(here.change.ratio), "{kind:?}: ratio at {position:?}");
                let determinant = (there.determinant - here.determinant).abs();
                assert!(
                    determinant <= bound(here.change.determinant),
                    "{kind:?}: determinant at {position:?}"
                );
                checked += 1;
            }
        }
        assert!(checked > 5_000, "{kind:?}: only {checked} displacements");
    }
}

#[test]
fn what_clears_is_in_range_and_far_from_the_singularities() {
    for (settings, robot) in machines() {
        let kind = settings.geometry.kind();
        let ranges = JointRanges::new(settings.geometry.ranges_with_margin_rad());
        let (mut inside, mut outside) = (0, 0);
        for position in positions(&settings, 20_000) {
            let (conditioning, min) = (robot.conditioning(&position), robot.conditioning_min());
            let in_range = robot.inverse(&position).is_ok_and(|angles| {
                angles
                    .iter()
                    .zip(&ranges.rad)
                    .all(|(angle, [low, high])| angle >= low && angle <= high)
            });
            let clear = in_range && conditioning.ratio.1 >= min.ratio && conditioning.determinant >= min.determinant;
            assert_eq!(robot.clears(&position.into(), &ranges), clear, "{kind:?}: {position:?}");
            *(if clear { &mut inside } else { &mut outside }) += 1;
        }
        assert!(
            inside > 5_000 && outside > 1_000,
            "{kind:?}: {inside} inside, {outside} outside"
        );
    }
}

proptest! {
    #[test]
    fn no_input_panics_and_every_result_is_finite(
        point in proptest::array::uniform3(proptest::num::f64::ANY),
        joints in proptest::array::uniform4(proptest::num::f64::ANY),
        scaled in -400.0_f64..400.0,
    ) {
        for (settings, robot) in machines() {
            let ranges = JointRanges::new(settings.geometry.ranges_rad());
            for at in [point, [scaled, point[1], scaled], [scaled, 0.5 * scaled, point[2]], [scaled; 3]] {
                let position = Position::from(at);
                if let Ok(angles) = robot.inverse(&position) {
                    prop_assert!(angles.iter().all(|angle| angle.is_finite()));
                    let rows = robot.rows(&at, &[0.6, 0.0, 0.8], &[0.0, 0.01, 0.0]);
                    prop_assert!(rows.slope.iter().chain(&rows.bend).all(|value| value.is_finite()));
                }
                let _ = (robot.angles(&at), robot.rows(&at, &at, &at), robot.conditioning(&position));
                let cleared = robot.clears(&at, &ranges);
                prop_assert!(!cleared || at.iter().all(|value| value.is_finite()));
            }
            if let Ok(position) = robot.forward(&JointAngles(joints)) {
                prop_assert!(Vector::from(position).iter().all(|value| value.is_finite()));
            }
        }
    }

    #[test]
    fn no_dimensions_panic(values in proptest::array::uniform8(proptest::num::f64::ANY), side in proptest::num::i8::ANY) {
        let [a, b, c, d, e, f, g, h] = values;
        let geometries = [
            Geometry::Gantry(GantryGeometry {
                x_range_mm: [a, b], y_range_mm: [c, d], z_range_mm: [e, f], margin_mm: g,
                ..GantryGeometry::default()
            }),
            Geometry::CoreXy(CoreXyGeometry {
                x_range_mm: [a, b], y_range_mm: [c, d], z_range_mm: [e, f], margin_mm: g,
                ..CoreXyGeometry::default()
            }),
            Geometry::Scara(ScaraGeometry {
                inner_link_mm: a, outer_link_mm: b, elbow: side, shoulder_range_rad: [c, d], elbow_range_rad: [e, f],
                z_margin_mm: g, margin_rad: h, ..ScaraGeometry::default()
            }),
            Geometry::LinearDelta(LinearDeltaGeometry {
                radius_mm: a, rod_mm: b, tower_azimuths_deg: [c, d, e], carriage_range_mm: [f, g], margin_mm: h,
                ..LinearDeltaGeometry::default()
            }),
        ];
        for geometry in geometries {
            let settings = Settings::usual(geometry);
            let _ = (settings.check(), crate::WorkArea::new(&settings).map(|area| area.check(&Position::default())));
        }
    }
}
