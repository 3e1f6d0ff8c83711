//! Calibration against machines with mechanics of their own, and against wrong tables.

mod delta;

use super::*;
use crate::random::Random;
use delta::TrueDelta;

/// Gaussian noise, from twelve even numbers.
fn noise(random: &mut Random) -> f64 {
    (0..12).map(|_| random.unit()).sum::<f64>() - 6.0
}

/// The marks that a machine draws, measured with an error in a frame of their own.
fn drawn(config: &Config, place: impl Fn(JointPose) -> [f64; 3], error_mm: f64, random: &mut Random) -> Vec<Mark> {
    let machine = Machine::new(config).expect("a machine");
    let frame = Rigid::new(2.0 * random.unit() - 1.0, [100.0 * random.unit(), -40.0]);
    marks::places(&config.paper, 5)
        .expect("a large sheet")
        .into_iter()
        .map(|wanted_mm| {
            let [x, y, _] = place(machine.pose_on_sheet(wanted_mm).expect("on the sheet"));
            let measured = frame.of([x, y]);
            Mark {
                wanted_mm,
                measured_mm: measured.map(|mm| mm + error_mm * noise(random)),
            }
        })
        .collect()
}

/// Error of shape all over the sheet, mm rms: places of the pen against where a configuration puts it, the sheet placed best.
fn shape_mm(config: &Config, place: impl Fn(JointPose) -> [f64; 3]) -> f64 {
    let machine = Machine::new(config).expect("a machine");
    let places = marks::places(&config.paper, 13).expect("a large sheet");
    let there: Vec<[f64; 2]> = places
        .iter()
        .map(|wanted| {
            let [x, y, _] = place(machine.pose_on_sheet(*wanted).expect("on the sheet"));
            [x, y]
        })
        .collect();
    Rigid::between(&there, &places).2
}

#[test]
fn a_machine_with_errors_of_half_a_millimetre_is_found_from_25_marks_measured_by_hand() {
    let config = Config::default();
    let (mut befores, mut afters) = (0.0, 0.0_f64);
    for seed in 1..=20 {
        let mut random = Random::new(seed);
        let truth = TrueDelta::new(&config, &mut random);
        let place = |believed| truth.place(believed);
        let marks = drawn(&config, place, 0.03, &mut random);
        let found = calibrate(&config, &marks, &[], 0.03).expect("a machine");
        // The marks of the found configuration are where its axes are homed: its poses differ by what was found.
        let syncs = [0, 1, 2].map(|axis| found.config.axes[axis].sync_angle_rad - config.axes[axis].sync_angle_rad);
        let placed = |mut believed: JointPose| {
            for (joint, sync) in believed.iter_mut().zip(syncs) {
                *joint -= sync;
            }
            truth.place(believed)
        };
        let (before, after) = (shape_mm(&config, place), shape_mm(&found.config, placed));
        println!("seed {seed}: {before:.3} to {after:.3} mm, {:?}", found.predicted);
        assert!(after < 0.034, "seed {seed}: {after}");
        assert!((found.predicted.rms_mm - 0.045).abs() < 0.025, "{:?}", found.predicted);
        befores += before;
        afters = afters.max(after);
        // The pen still meets the sheet, which has not moved.
        let machine = Machine::new(&found.config).expect("a machine");
        let old = Machine::new(&config).expect("a machine");
        for [x, y] in [[0.0, 0.0], [80.0, 80.0], [-80.0, 60.0]] {
            let was = place(old.pose_on_sheet([x, y]).expect("on the sheet"))[2];
            let is = placed(machine.pose_on_sheet([x, y]).expect("on the sheet"))[2];
            assert!((was - is).abs() < 0.05, "seed {seed}: {was} {is}");
        }
    }
    assert!(befores / 20.0 > 0.06 && afters < 0.034, "{befores} {afters}");
}

#[test]
fn each_kind_of_machine_finds_what_it_was_made_with() {
    for machine in &crate::settings::machines::MACHINES {
        let config = machine.load().expect("a bundled machine");
        let mut random = Random::new(7);
        let parameters = of(config.geometry.kind());
        let changes: Vec<f64> = parameters.iter().map(|one| one.usual * (random.unit() - 0.5)).collect();
        let truth = Machine::new(&config).expect("a machine");
        let truth = truth.with(&changes).expect("a machine");
        let place = |believed| truth.place(believed).expect("in reach");
        let marks = drawn(&config, place, 0.01, &mut random);
        let found = calibrate(&config, &marks, &[], 0.01).unwrap_or_else(|cause| panic!("{}: {cause}", machine.name));
        println!(
            "{}: {:?} to {:?}, {:?}",
            machine.name, found.before, found.after, found.predicted
        );
        assert!(
            found.after.rms_mm < 0.02 && found.predicted.rms_mm < 0.03,
            "{}",
            machine.name
        );
        assert!(found.before.rms_mm > 2.0 * found.after.rms_mm, "{}", machine.name);
        let [before, after] = expected_mm(
            &config,
            &marks::places(&config.paper, 5).expect("a large sheet"),
            &[],
            0.01,
        )
        .expect("a sheet");
        assert!(
            after < 0.2 * before && after < 0.02,
            "{}: {before} {after}",
            machine.name
        );
    }
}

#[test]
fn touches_alone_tell_little_and_marks_nearly_all() {
    let config = Config::default();
    let z_mm = config.paper.pen_down_z_mm;
    let touches: Vec<Touch> = marks::places(&config.paper, 5)
        .expect("a large sheet")
        .into_iter()
        .map(|[x, y]| [x, y, z_mm])
        .collect();
    let places = marks::places(&config.paper, 5).expect("a large sheet");
    let [before, by_touches] = expected_mm(&config, &[], &touches, 0.03).expect("a sheet");
    let [_, by_marks] = expected_mm(&config, &places, &[], 0.03).expect("a sheet");
    println!("{before:.3} mm, with touches {by_touches:.3}, with marks {by_marks:.3}");
    assert!(by_touches > 0.5 * before && by_marks < 0.25 * before);
}

#[test]
fn a_wrong_table_is_refused_with_what_is_wrong() {
    let config = Config::default();
    let mut random = Random::new(3);
    let truth = TrueDelta::new(&config, &mut random);
    let marks = drawn(&config, |believed| truth.place(believed), 0.03, &mut random);
    let refused = |change: &dyn Fn(&mut Vec<Mark>), part: &str| {
        let mut marks = marks.clone();
        change(&mut marks);
        let cause = calibrate(&config, &marks, &[], 0.03).expect_err(part);
        assert!(cause.contains(part), "{cause}");
    };
    refused(&|marks| marks.truncate(5), "at least 6");
    refused(&|marks| marks.truncate(0), "at least 6");
    refused(&|marks| marks.retain(|mark| mark.wanted_mm[0] > 30.0), "apart in x");
    refused(
        &|marks| marks.iter_mut().for_each(|mark| mark.measured_mm[1] *= -1.0),
        "mirrored",
    );
    refused(
        &|marks| marks.iter_mut().for_each(|mark| mark.measured_mm.reverse()),
        "mirrored",
    );
    refused(
        &|marks| {
            marks
                .iter_mut()
                .for_each(|mark| mark.measured_mm = mark.measured_mm.map(|mm| 0.1 * mm))
        },
        "millimetres",
    );
    refused(&|marks| marks[7].measured_mm[0] += 1.0, "measure it again");
    refused(
        &|marks| {
            let (one, other) = (marks[3].measured_mm, marks[11].measured_mm);
            (marks[3].measured_mm, marks[11].measured_mm) = (other, one);
        },
        "",
    );
    refused(&|marks| marks[2].measured_mm = [f64::MAX, 0.0], "");
    refused(&|marks| marks[2].measured_mm[1] += 100.0, "typed wrong");
    refused(
        &|marks| {
            marks
                .iter_mut()
                .for_each(|mark| mark.measured_mm = mark.measured_mm.map(|mm| 1.02 * mm))
        },
        "millimetres",
    );
    refused(
        &|marks| {
            marks.retain(|mark| (mark.wanted_mm[0] - mark.wanted_mm[1]).abs() < 1.0);
            marks.extend_from_within(..);
        },
        "on a line",
    );
    let z_mm = config.paper.pen_down_z_mm;
    let touches = [[-80.0, -80.0], [80.0, -80.0], [80.0, 80.0], [-80.0, 80.0], [0.0, 0.0]].map(|[x, y]| [x, y, z_mm]);
    assert!(calibrate(&config, &marks, &touches, 0.03).is_ok());
    let mut wrong = touches;
    wrong[4][2] += 10.0;
    let cause = calibrate(&config, &marks, &wrong, 0.03).expect_err("a touch is wrong");
    assert!(cause.contains("touch"), "{cause}");
}

#[test]
fn marks_that_were_measured_too_coarsely_are_no_better_and_say_so() {
    let config = Config::default();
    let machine = Machine::new(&config).expect("a machine");
    let truth = machine.with(&[0.0; 9]).expect("a machine");
    for seed in 1..=20 {
        let mut random = Random::new(seed);
        let marks = drawn(
            &config,
            |believed| truth.place(believed).expect("in reach"),
            0.2,
            &mut random,
        );
        let found = calibrate(&config, &marks, &[], 0.05).expect("a machine");
        assert!(!found.is_better() && found.left_over > 2.0, "{seed}: {found:?}");
        assert!(found.changes.iter().all(|[_, error]| *error > 0.0));
    }
}
