use super::*;
use crate::planning::{PlannedSample as Planned, plan};
use crate::random::Lcg;
use etherpen::messages::IoValues;
use etherpen::motion::Vertex;

const LIFT_MM: f64 = 5.0;

/// Strokes of all kinds: serpentines of dense rows, strokes that return along themselves, rings, dots.
fn drawing(random: &mut Lcg, config: &Config) -> Vec<Vertex> {
    let z_mm = config.paper.pen_down_z_mm;
    let mut path = Vec::new();
    for stroke in 0..8 {
        let (x, y) = (random.between(-60.0, 60.0), random.between(-60.0, 60.0));
        let pitch = random.between(0.4, 1.5);
        let points: Vec<[f64; 2]> = match stroke % 4 {
            0 => (0..10)
                .map(|k| [if (k + 1) / 2 % 2 == 0 { 0.0 } else { 15.0 }, f64::from(k / 2) * pitch])
                .collect(),
            1 => vec![[0.0, 0.0], [20.0, 0.0], [5.0, 0.0], [5.0, 10.0], [5.0, 0.0]],
            2 => (0..=48)
                .map(|k| f64::from(k) * std::f64::consts::TAU / 24.0)
                .map(|angle| [6.0 * angle.cos(), 6.0 * angle.sin()])
                .collect(),
            _ => vec![[0.0, 0.0], [0.3, 0.0]],
        };
        let vertex = |[dx, dy]: [f64; 2], z_mm: f64, pen: Pen| Vertex {
            position: Position {
                x_mm: x + dx,
                y_mm: y + dy,
                z_mm,
            },
            pen,
            stroke,
        };
        let (first, last) = (points[0], points[points.len() - 1]);
        path.push(vertex(first, z_mm + LIFT_MM, Pen::Up));
        path.push(vertex(first, z_mm, Pen::Up));
        path.extend(points.iter().skip(1).map(|point| vertex(*point, z_mm, Pen::Down)));
        path.push(vertex(last, z_mm + LIFT_MM, Pen::Up));
    }
    path
}

fn wire(path: &[Vertex]) -> Vec<PathVertex> {
    path.iter().map(crate::drawing::preparation::wire::to_wire).collect()
}

/// Milliseconds at rest after a drawing.
const REST_MS: usize = 40;

/// Telemetry of a robot that follows its references with the configured age, and rests.
fn telemetry(config: &Config, path: &[Vertex]) -> Vec<Sample> {
    let mut planned: Vec<Planned> = Vec::new();
    plan(config, path, |sample, _| planned.push(*sample)).expect("the drawing can be planned");
    let age = config.axes[0].measurement_age_ms.round() as usize;
    (0..planned.len() + REST_MS)
        .map(|index| {
            let now = &planned[index.min(planned.len() - 1)].setpoint;
            let before = &planned[index.saturating_sub(age).min(planned.len() - 1)].setpoint;
            Sample {
                t_ms: 1_000 + index as u32,
                mode: if index < planned.len() + age {
                    Mode::Drawing
                } else {
                    Mode::Idle
                },
                stroke: now.stroke,
                pen: now.pen,
                setpoint_rad: now.position_rad.map(|rad| rad as f32),
                measured_rad: before.position_rad.map(|rad| rad as f32),
                setpoint_rad_s: now.velocity_rad_s.map(|rad_s| rad_s as f32),
                measured_rad_s: before.velocity_rad_s.map(|rad_s| rad_s as f32),
                io: IoValues::default(),
            }
        })
        .collect()
}

/// Verdict on samples that arrive a few at a time.
fn verdict(config: &Config, path: &[Vertex], samples: &[Sample]) -> Verdict {
    let mut verifier = Verifier::new(&wire(path), config, true);
    samples.chunks(9).for_each(|samples| verifier.observe(samples));
    verifier.finish(true).verdict()
}

#[test]
fn a_drawing_that_was_followed_is_complete_to_the_last_millimetre() {
    let config = Config::default();
    for seed in 1..=6 {
        let path = drawing(&mut Lcg::new(seed), &config);
        let verdict = verdict(&config, &path, &telemetry(&config, &path));
        assert_eq!(
            (verdict.missing_mm, verdict.strokes.len()),
            (0.0, 0),
            "seed {seed}: {verdict:?}"
        );
        assert!(verdict.unverified_mm < 1e-6, "seed {seed}: {verdict:?}");
        assert!(
            (verdict.followed_mm - verdict.total_mm).abs() < 1e-6,
            "seed {seed}: {verdict:?}"
        );
        assert_eq!(verdict.error(), None);
    }
}

#[test]
fn lost_samples_are_not_verified_and_never_missing() {
    let config = Config::default();
    for seed in 1..=20 {
        let mut random = Lcg::new(seed);
        let path = drawing(&mut random, &config);
        let mut samples = telemetry(&config, &path);
        let total = samples.len();
        for _ in 0..1 + (random.unit() * 8.0) as usize {
            let length = random.between(1.0, 700.0) as usize;
            let from = (random.unit() * samples.len() as f64) as usize;
            samples.drain(from..(from + length).min(samples.len()));
        }
        let verdict = verdict(&config, &path, &samples);
        assert_eq!(
            (verdict.missing_mm, verdict.error()),
            (0.0, None),
            "seed {seed}: {verdict:?}"
        );
        let lost_mm = (total - samples.len()) as f64 * config.motion.speed_mm_s / 1_000.0;
        assert!(
            verdict.unverified_mm <= lost_mm + 16.0,
            "seed {seed}: {lost_mm} mm at most, {verdict:?}"
        );
    }
}

#[test]
fn an_axis_that_stands_still_is_noticed_with_the_length_that_it_takes() {
    let config = Config::default();
    let kinematics = Kinematics::new(&config.geometry).expect("the built-in geometry");
    let place = |rad: [f32; 4]| kinematics.forward(&JointAngles(rad.map(f64::from))).expect("a pose");
    let mut noticed = 0;
    for seed in 1..=24 {
        let mut random = Lcg::new(seed);
        let path = drawing(&mut random, &config);
        let mut samples = telemetry(&config, &path);
        let (axis, from) = (
            (random.unit() * 3.0) as usize,
            (random.unit() * 0.8 * samples.len() as f64) as usize,
        );
        let frozen = samples[from].measured_rad[axis];
        samples
            .iter_mut()
            .skip(from)
            .take(900)
            .for_each(|sample| sample.measured_rad[axis] = frozen);
        // The truth, without strokes or places along them: how far the references went while the pen was elsewhere.
        let age = config.axes[0].measurement_age_ms.round() as usize;
        let mut away_mm = 0.0;
        for pair in (0..samples.len() - age - 1).collect::<Vec<_>>() {
            let (cause, next) = (&samples[pair], &samples[pair + 1]);
            let error_mm =
                crate::matching::distance(&place(cause.setpoint_rad), &place(samples[pair + age].measured_rad));
            if cause.pen == Pen::Down && next.pen == Pen::Down && error_mm > 2.5 {
                away_mm += crate::matching::distance(&place(cause.setpoint_rad), &place(next.setpoint_rad));
            }
        }
        let verdict = verdict(&config, &path, &samples);
        println!(
            "seed {seed}: axis {axis}, {away_mm:.1} mm far away, {:.1} mm missing",
            verdict.missing_mm
        );
        if away_mm > 10.0 {
            noticed += 1;
            assert!(
                verdict.missing_mm > 0.2 * away_mm,
                "seed {seed}: {away_mm} mm, {verdict:?}"
            );
            assert!(verdict.error().is_some());
        }
        assert!(
            (verdict.followed_mm + verdict.missing_mm - verdict.total_mm).abs() < 0.6 * 8.0,
            "seed {seed}: {verdict:?}"
        );
    }
    assert!(noticed >= 10, "{noticed}");
}

#[test]
fn a_stroke_that_was_never_begun_is_missing() {
    let config = Config::default();
    let path = drawing(&mut Lcg::new(5), &config);
    let drawn: Vec<Vertex> = path.iter().filter(|vertex| vertex.stroke != 4).copied().collect();
    let ended: Vec<Vertex> = path.iter().filter(|vertex| vertex.stroke < 6).copied().collect();
    let first_of = |stroke: u32| {
        path.iter()
            .position(|vertex| vertex.stroke == stroke)
            .unwrap_or_default() as u32
    };
    for (drawn, missing, first) in [(drawn, vec![4], 4), (ended, vec![6, 7], 6)] {
        let verdict = verdict(&config, &path, &telemetry(&config, &drawn));
        assert_eq!(verdict.strokes, missing, "{verdict:?}");
        assert_eq!(verdict.complete_vertices, first_of(first));
    }
}

#[test]
fn two_connections_together_have_seen_the_whole_drawing() {
    let config = Config::default();
    let path = drawing(&mut Lcg::new(7), &config);
    let samples = telemetry(&config, &path);
    let (before, after) = samples.split_at(samples.len() / 2);
    let mut first = Verifier::new(&wire(&path), &config, true);
    first.observe(before);
    let mut both = first.finish(false);
    let alone = both.verdict();
    assert!(alone.missing_mm == 0.0 && alone.unverified_mm > 10.0, "{alone:?}");
    let mut second = Verifier::new(&wire(&path), &config, false);
    second.observe(after);
    both.merge(&second.finish(true));
    let verdict = both.verdict();
    assert!(verdict.missing_mm == 0.0 && verdict.unverified_mm < 8.0, "{verdict:?}");
}

/// A stroke of random vertices within a square, followed by a line of 30 mm.
fn noise(random: &mut Lcg, config: &Config, count: usize, half_mm: f64) -> Vec<Vertex> {
    let z_mm = config.paper.pen_down_z_mm;
    let vertex = |x_mm: f64, y_mm: f64, z_mm: f64, pen: Pen| Vertex {
        position: Position { x_mm, y_mm, z_mm },
        pen,
        stroke: 0,
    };
    let mut path = vec![
        vertex(0.0, 0.0, z_mm + LIFT_MM, Pen::Up),
        vertex(0.0, 0.0, z_mm, Pen::Up),
    ];
    for _ in 0..count {
        let (x_mm, y_mm) = (random.between(-half_mm, half_mm), random.between(-half_mm, half_mm));
        path.push(vertex(x_mm, y_mm, z_mm, Pen::Down));
    }
    path.push(vertex(30.0, 0.0, z_mm, Pen::Down));
    path.push(vertex(30.0, 0.0, z_mm + LIFT_MM, Pen::Up));
    path
}

/// Looks of one call of [`Verifier::work`] in the tests.
const LOOKS: usize = 10_000;
/// Looks by which one call may exceed that: those of one row, and one for each row of a piece.
const LOOKS_OVER: usize = PARTS_AT_ONCE + SAMPLES_MAX;

#[test]
fn noise_of_any_size_takes_bounded_work_and_memory_and_is_never_missing() {
    let config = Config::default();
    let sizes = [
        (300, 0.03),
        (3_000, 0.03),
        (20_000, 0.03),
        (3_000, 0.07),
        (3_000, 0.2),
        (3_000, 1.0),
    ];
    for (count, half_mm) in sizes {
        let path = noise(&mut Lcg::new(9), &config, count, half_mm);
        let samples = telemetry(&config, &path);
        let mut verifier = Verifier::new(&wire(&path), &config, true);
        let (mut most, mut parts, mut rows) = (0, 0, 0);
        for samples in samples.chunks(9) {
            verifier.observe(samples);
            for _ in samples {
                let before = verifier.looks();
                verifier.work(LOOKS);
                most = most.max(verifier.looks() - before);
                let reserved = verifier
                    .matching
                    .as_ref()
                    .map(|matching| matching.search.parts_reserved());
                parts = parts.max(reserved.unwrap_or(0));
            }
            let waiting: usize = verifier.pieces.iter().map(|piece| piece.rows.capacity()).sum();
            rows = rows.max(waiting + verifier.rows.capacity());
        }
        assert!(!verifier.is_behind(), "{count} within {half_mm} mm");
        let looks = verifier.looks();
        let verdict = verifier.finish(true).verdict();
        let case = format!(
            "{count} within {half_mm} mm: {} samples, {looks} looks, at most {most} at once, {parts} parts, {rows} rows, {:.1} \
             of {:.1} mm not verified",
            samples.len(),
            verdict.unverified_mm,
            verdict.total_mm
        );
        println!("{case}");
        assert!(most <= LOOKS + LOOKS_OVER, "{case}");
        let legs = LOOKS_PER_LEG * count * samples.len().div_ceil(SAMPLES_MAX);
        assert!(
            looks <= (LOOKS_PER_ROW + PARTS_AT_ONCE) * samples.len() + legs,
            "{case}"
        );
        // A vector that grows reserves up to twice what it keeps.
        assert!(
            parts <= 4 * PARTS_PER_ROW * SAMPLES_MAX && rows <= 4 * SAMPLES_MAX,
            "{case}"
        );
        assert_eq!((verdict.missing_mm, verdict.error()), (0.0, None), "{case}");
        let path_mm = length(
            &path[1..path.len() - 1]
                .iter()
                .map(|vertex| vertex.position)
                .collect::<Vec<_>>(),
        );
        assert!(
            (verdict.total_mm - path_mm).abs() < 0.01 * path_mm,
            "{case}, {path_mm} mm"
        );
        if half_mm < 0.05 {
            assert!(verdict.unverified_mm == 0.0, "{case}");
        }
    }
}

#[test]
fn the_result_does_not_depend_on_how_the_work_is_divided() {
    let config = Config::default();
    let path = drawing(&mut Lcg::new(3), &config);
    let samples = telemetry(&config, &path);
    let whole = verdict(&config, &path, &samples);
    for looks in [1, 1_000] {
        let mut verifier = Verifier::new(&wire(&path), &config, true);
        samples.iter().for_each(|sample| {
            verifier.observe(&[*sample]);
            verifier.work(looks);
        });
        while verifier.is_behind() {
            verifier.work(looks);
        }
        assert_eq!(verifier.finish(true).verdict(), whole, "{looks} looks at once");
    }
}

#[test]
fn samples_that_are_left_out_are_not_verified_and_never_missing() {
    let config = Config::default();
    let path = drawing(&mut Lcg::new(11), &config);
    let samples = telemetry(&config, &path);
    for given_up in [0.2, 0.5, 0.8, 1.0] {
        let mut verifier = Verifier::new(&wire(&path), &config, true);
        let (before, after) = samples.split_at((given_up * samples.len() as f64) as usize);
        verifier.observe(before);
        verifier.close();
        verifier.give_up();
        verifier.observe(after);
        let verdict = verifier.finish(true).verdict();
        assert_eq!(
            (verdict.missing_mm, verdict.error()),
            (0.0, None),
            "{given_up}: {verdict:?}"
        );
        assert!(
            verdict.unverified_mm > 0.1 * given_up * verdict.total_mm,
            "{given_up}: {verdict:?}"
        );
    }
}

#[test]
fn a_stroke_that_was_not_followed_begins_anew_and_after_a_stop_beside_the_path_only_its_end_does() {
    // Ten strokes of ten points in ten millimetres.
    let seen = |followed: &[[f64; 2]], off: &[[f64; 2]]| {
        let mut verification = Verification::of_strokes(0..0, None);
        followed
            .iter()
            .for_each(|part| verification.followed.add(part[0], part[1]));
        off.iter().for_each(|part| verification.off.add(part[0], part[1]));
        verification.complete_vertices()
    };
    assert_eq!(seen(&[[0.0, 100.0]], &[]), None);
    // Six points up to 5.6 mm, a millimetre before the part.
    assert_eq!(seen(&[[0.0, 47.0]], &[[47.0, 49.0]]), Some(46), "a stop");
    assert_eq!(seen(&[[0.0, 42.0]], &[[42.0, 49.0]]), Some(40));
    assert_eq!(
        seen(&[[0.0, 46.0]], &[[46.0, 69.0]]),
        Some(45),
        "a stop over several strokes"
    );
    assert_eq!(seen(&[[0.0, 40.0]], &[[40.0, 100.0]]), Some(40), "to the end");
    assert_eq!(seen(&[[0.0, 96.0]], &[[96.0, 100.0]]), Some(95));
    assert_eq!(
        seen(&[[0.0, 32.0], [34.0, 49.0]], &[[32.0, 34.0]]),
        Some(30),
        "the pen went on"
    );
    assert_eq!(
        seen(&[[0.0, 32.0], [34.0, 47.0]], &[[32.0, 34.0], [47.0, 49.0]]),
        Some(30)
    );
    assert_eq!(seen(&[[0.0, 32.0], [32.3, 47.0]], &[[32.0, 32.3]]), None, "a dot");
    assert_eq!(
        seen(&[[0.0, 33.0], [33.3, 37.8]], &[[33.0, 33.3], [37.8, 38.1]]),
        Some(32),
        "a dot and a stop that count together: two points up to 2 mm, a millimetre before the dot"
    );
    assert_eq!(
        seen(&[[0.0, 33.0], [33.0, 37.4]], &[[32.0, 32.3], [37.4, 38.1]]),
        Some(36),
        "a dot that another connection has drawn does not count"
    );
    assert_eq!(
        seen(&[[0.0, 49.0]], &[[32.0, 34.0]]),
        None,
        "drawn by another connection"
    );
    assert_eq!(seen(&[[40.0, 49.0]], &[[0.0, 40.0]]), Some(0));
    // Two dots in one stroke, and two in two strokes.
    assert_eq!(
        seen(
            &[[0.0, 31.0], [31.3, 32.0], [32.3, 49.0]],
            &[[31.0, 31.3], [32.0, 32.3]]
        ),
        Some(30)
    );
    assert_eq!(
        seen(
            &[[0.0, 29.0], [29.3, 32.0], [32.3, 49.0]],
            &[[29.0, 29.3], [32.0, 32.3]]
        ),
        None
    );
}

#[test]
fn a_drawing_that_has_ended_lacks_what_its_verdict_says() {
    let mut random = crate::random::Lcg::new(5);
    for _ in 0..2_000 {
        let mut verification = Verification::of_strokes(0..10, None);
        verification.followed = Default::default();
        for _ in 0..random.below(12) {
            let from_mm = random.below(1_000) as f64 / 10.0;
            let to_mm = (from_mm + random.below(120) as f64 / 10.0).min(99.0);
            match random.below(2) {
                0 => verification.followed.add(from_mm, to_mm),
                _ => verification.off.add(from_mm, to_mm),
            }
        }
        // The pen has come to the end.
        verification.followed.add(99.0, 100.0);
        let verdict = verification.verdict();
        let complete = verdict.error().map(|_| verdict.complete_vertices as usize);
        assert_eq!(verification.complete_vertices(), complete, "{verification:?}");
    }
}

/// Length of each half of [`uneven`], mm.
const HALF_MM: f64 = 60.0;

/// A short stroke, and one of two halves along x: one is straight in steps of 0.5 mm, the other has steps of `step_mm` with
/// points up to `jitter_mm` beside the straight line. Points farther along have a larger x.
fn uneven(random: &mut Lcg, config: &Config, step_mm: f64, jitter_mm: f64, is_noise_first: bool) -> Vec<Vertex> {
    let z_mm = config.paper.pen_down_z_mm;
    let vertex = |x_mm: f64, y_mm: f64, z_mm: f64, pen: Pen, stroke: u32| Vertex {
        position: Position { x_mm, y_mm, z_mm },
        pen,
        stroke,
    };
    let mut path = vec![
        vertex(-HALF_MM, 20.0, z_mm + LIFT_MM, Pen::Up, 0),
        vertex(-HALF_MM, 20.0, z_mm, Pen::Up, 0),
        vertex(-HALF_MM + 3.0, 20.0, z_mm, Pen::Down, 0),
        vertex(-HALF_MM + 9.0, 20.0, z_mm, Pen::Down, 0),
        vertex(-HALF_MM + 9.0, 20.0, z_mm + LIFT_MM, Pen::Up, 0),
        vertex(-HALF_MM, 0.0, z_mm + LIFT_MM, Pen::Up, 1),
        vertex(-HALF_MM, 0.0, z_mm, Pen::Up, 1),
    ];
    for half in 0..2 {
        let is_noise = is_noise_first == (half == 0);
        let (step_mm, jitter_mm) = if is_noise { (step_mm, jitter_mm) } else { (0.5, 0.0) };
        let begin_mm = -HALF_MM + f64::from(half) * HALF_MM;
        for step in 1..=(HALF_MM / step_mm).round() as u32 {
            let y_mm = random.between(-1.0, 1.0) * jitter_mm;
            path.push(vertex(begin_mm + f64::from(step) * step_mm, y_mm, z_mm, Pen::Down, 1));
        }
    }
    path.push(vertex(HALF_MM, 0.0, z_mm + LIFT_MM, Pen::Up, 1));
    path
}

/// Steps and jitter of [`uneven`], mm.
const NOISE_MM: [[f64; 2]; 6] = [
    [0.02, 0.01],
    [0.02, 0.04],
    [0.02, 0.15],
    [0.05, 0.05],
    [0.05, 0.09],
    [0.1, 0.2],
];

/// Seeds of each of them.
const SEEDS: u64 = 4;

#[test]
fn every_vertex_has_its_own_place_along_its_line() {
    let config = Config::default();
    for (seed, [step_mm, jitter_mm]) in (1..).zip(NOISE_MM) {
        for is_noise_first in [false, true] {
            let path = wire(&uneven(
                &mut Lcg::new(seed),
                &config,
                step_mm,
                jitter_mm,
                is_noise_first,
            ));
            let verifier = Verifier::new(&path, &config, true);
            let case = format!("{step_mm} mm, {jitter_mm} mm, noise first: {is_noise_first}");
            let strokes = &verifier.result.strokes;
            let found: Vec<_> = strokes
                .iter()
                .map(|stroke| (stroke.number, stroke.vertex, stroke.first_point))
                .collect();
            assert_eq!(found, [(0, 0, 1), (1, 5, 6)], "{case}");
            for ((stroke, line), points) in strokes.iter().zip(&verifier.lines).zip(lines(&path)) {
                assert_eq!(points.points.len(), stroke.points_mm.len(), "{case}");
                let drawn = path[stroke.first_point as usize + 1..].iter();
                let legs = drawn.take_while(|vertex| vertex.pen == Pen::Down).count();
                assert_eq!(legs + 1, stroke.points_mm.len(), "{case}");
                assert!(stroke.points_mm.is_sorted(), "{case}");
                for (point, mm) in points.points.iter().zip(&stroke.points_mm) {
                    let away_mm = line.distance_between(point, f64::from(*mm), f64::from(*mm));
                    assert!(away_mm <= THINNED_MM + 1e-4, "{case}: {away_mm} mm from {mm} mm");
                }
            }
        }
    }
}

#[test]
fn after_a_stop_beside_an_uneven_stroke_nothing_that_is_missing_is_left_out() {
    let config = Config::default();
    let kinematics = Kinematics::new(&config.geometry).expect("the built-in geometry");
    let age = config.axes[0].measurement_age_ms.round() as usize;
    let lift_um = (1_000.0 * config.paper.pen_lift_mm) as i32;
    let place = |rad: [f32; 4]| kinematics.forward(&JointAngles(rad.map(f64::from))).expect("a pose");
    let mut judged = 0;
    let cases = (1..=SEEDS).flat_map(|seed| NOISE_MM.map(|noise_mm| (seed, noise_mm)));
    for (seed, [step_mm, jitter_mm]) in cases {
        for is_noise_first in [false, true] {
            let mut random = Lcg::new(seed);
            let path = uneven(&mut random, &config, step_mm, jitter_mm, is_noise_first);
            let (wired, samples) = (wire(&path), telemetry(&config, &path));
            let drawn = samples
                .iter()
                .filter(|sample| sample.stroke == 1 && sample.pen == Pen::Down);
            let drawn_ms: Vec<usize> = drawn.map(|sample| (sample.t_ms - samples[0].t_ms) as usize).collect();
            for _ in 0..6 {
                // The pen is beside the path from this millisecond on.
                let left = drawn_ms[(random.between(0.05, 0.9) * drawn_ms.len() as f64) as usize];
                let mut seen = samples[..(left + 400).min(samples.len())].to_vec();
                for sample in &mut seen[left + age..] {
                    sample.measured_rad[..3].iter_mut().for_each(|rad| *rad += 0.03);
                }
                let left_mm = place(samples[left - 1].setpoint_rad).x_mm;
                let mut verifier = Verifier::new(&wired, &config, true);
                seen.chunks(9).for_each(|samples| verifier.observe(samples));
                let complete = verifier.finish(false).complete_vertices();
                let case = format!(
                    "seed {seed}, {step_mm} mm, {jitter_mm} mm, noise first: {is_noise_first}, left at {left_mm} mm: \
                     {complete:?}"
                );
                let complete = complete.unwrap_or_else(|| panic!("{case}"));
                let last_mm = path[complete.saturating_sub(1).max(6)].position.x_mm;
                assert!(last_mm <= left_mm, "{case}: {last_mm} mm counts as drawn");
                assert!(last_mm > left_mm - 2.5, "{case}: only {last_mm} mm count as drawn");
                // It goes on there.
                let rest =
                    crate::job::remainder::Remainder::new(&wired, complete, crate::job::remainder::OVERLAP_UM, lift_um);
                let begin_mm = f64::from(rest.vertices[1].position_um[0]) / 1_000.0;
                assert!(begin_mm <= left_mm, "{case}: goes on at {begin_mm} mm");
                judged += 1;
            }
        }
    }
    assert_eq!(judged, SEEDS * 72);
}

/// How much faster than planned the machine of [`cut_off`] is: it is fast until shortly before its end.
const FASTER: usize = 4;

/// A verifier of a drawing whose last stroke ends with the pen down, with telemetry so many milliseconds beyond its end.
/// The machine draws all of it or ends two strokes early.
fn cut_off(age_ms: u32, beyond_ms: usize, is_whole: bool) -> Verifier {
    let mut config = Config::default();
    let set_age = |config: &mut Config, age_ms: u32| {
        let axes = config.axes.iter_mut();
        axes.for_each(|axis| axis.measurement_age_ms = f64::from(age_ms));
    };
    let until = |path: &[Vertex], stroke: u32| {
        let lifted = path.iter().rposition(|vertex| vertex.stroke == stroke);
        path[..lifted.expect("a stroke ends with a lift")].to_vec()
    };
    let path = until(&drawing(&mut Lcg::new(5), &config), 6);
    let drawn = if is_whole { path.clone() } else { until(&path, 4) };
    set_age(&mut config, FASTER as u32 * age_ms);
    let slow = telemetry(&config, &drawn);
    let end = (slow.len() - REST_MS).div_ceil(FASTER);
    set_age(&mut config, age_ms);
    let mut verifier = Verifier::new(&wire(&path), &config, true);
    let samples = slow
        .iter()
        .step_by(FASTER)
        .chain(std::iter::repeat(&slow[slow.len() - 1]));
    for (index, sample) in samples.enumerate().take(end + beyond_ms) {
        // The board ends the drawing with its last reference, before the drives have come there.
        let mode = if index < end { Mode::Drawing } else { Mode::Idle };
        let t_ms = 1_000 + index as u32;
        verifier.observe(&[Sample { t_ms, mode, ..*sample }]);
    }
    verifier
}

#[test]
fn a_line_that_breaks_at_the_end_loses_what_was_not_measured_and_nothing_is_missing() {
    for age_ms in [0, 1, 4, 10] {
        for beyond_ms in 0..=age_ms as usize + 2 {
            for is_over in [false, true] {
                let verdict = cut_off(age_ms, beyond_ms, true)
                    .finish_within(usize::MAX, is_over)
                    .verdict();
                let case = format!("{age_ms} ms old, {beyond_ms} ms after the end, {is_over}: {verdict:?}");
                assert_eq!((verdict.missing_mm, verdict.error()), (0.0, None), "{case}");
                if beyond_ms >= age_ms as usize {
                    assert_eq!(verdict.unverified_mm, 0.0, "{case}");
                }
            }
        }
    }
}

#[test]
fn what_a_finished_drawing_never_reached_is_missing_once_all_was_measured_and_one_that_is_not_over_lacks_nothing() {
    for age_ms in [0, 1, 4, 10] {
        for beyond_ms in 0..=age_ms as usize + 2 {
            for is_over in [false, true] {
                let verdict = cut_off(age_ms, beyond_ms, false)
                    .finish_within(usize::MAX, is_over)
                    .verdict();
                let case = format!("{age_ms} ms old, {beyond_ms} ms after the end, {is_over}: {verdict:?}");
                let is_measured = beyond_ms >= age_ms.max(1) as usize;
                let missing = if is_over && is_measured { vec![5, 6] } else { vec![] };
                assert_eq!(verdict.strokes, missing, "{case}");
            }
        }
    }
}

#[test]
fn a_gap_is_noticed_whatever_the_age_of_a_measurement_is() {
    for age_ms in [0.0, 0.4, 1.0, 3.0] {
        let mut config = Config::default();
        config.axes.iter_mut().for_each(|axis| axis.measurement_age_ms = age_ms);
        let path = drawing(&mut Lcg::new(3), &config);
        let mut samples = telemetry(&config, &path);
        samples.drain(samples.len() / 3..samples.len() / 3 + 500);
        let verdict = verdict(&config, &path, &samples);
        assert_eq!(
            (verdict.missing_mm, verdict.error()),
            (0.0, None),
            "{age_ms} ms: {verdict:?}"
        );
        assert!(verdict.unverified_mm > 0.0, "{age_ms} ms: {verdict:?}");
    }
}

/// Strokes of these lengths, each to its end and halfway back.
fn dots(config: &Config, lengths_mm: &[f64]) -> Vec<Vertex> {
    let (z_mm, lift_mm) = (config.paper.pen_down_z_mm, config.paper.pen_lift_mm);
    let mut path = Vec::new();
    for (stroke, length_mm) in (0..).zip(lengths_mm) {
        for (along_mm, z_mm, pen) in [
            (0.0, z_mm + lift_mm, Pen::Up),
            (0.0, z_mm, Pen::Up),
            (*length_mm, z_mm, Pen::Down),
            (0.5 * length_mm, z_mm, Pen::Down),
            (0.5 * length_mm, z_mm + lift_mm, Pen::Up),
        ] {
            let position = Position {
                x_mm: 5.0 * f64::from(stroke) + along_mm,
                y_mm: 0.0,
                z_mm,
            };
            path.push(Vertex { position, pen, stroke });
        }
    }
    path
}

#[test]
fn a_dot_of_any_size_is_followed_and_one_above_the_paper_is_missing() {
    let mut random = Lcg::new(1);
    for round in 0..30 {
        let mut config = Config::default();
        config.motion.pen_dwell_ms = (random.unit() * 30.0) as u16;
        config.motion.speed_mm_s = 300.0 * 0.05_f64.powf(random.unit());
        config.paper.pen_lift_mm = random.between(2.0, 6.0);
        let lengths_mm: Vec<f64> = (0..1 + round % 3)
            .map(|_| 0.001 * 1_000_f64.powf(random.unit()))
            .collect();
        let path = dots(&config, &lengths_mm);
        let mut samples = telemetry(&config, &path);
        // What takes less than a millisecond may have no sample with the pen down.
        let passes = |sample: &&mut Sample| 1e3 * lengths_mm[sample.stroke as usize] < config.motion.speed_mm_s;
        samples
            .iter_mut()
            .filter(passes)
            .for_each(|sample| sample.pen = Pen::Up);
        let followed = verdict(&config, &path, &samples);
        assert_eq!(followed.error(), None, "{lengths_mm:?}: {followed:?}");
        assert!(followed.unverified_mm < 1e-6, "{lengths_mm:?}: {followed:?}");
        // The pen follows 1 mm above.
        let raised = path.iter().map(|vertex| {
            let z_mm = vertex.position.z_mm + 1.0;
            Vertex {
                position: Position {
                    z_mm,
                    ..vertex.position
                },
                ..*vertex
            }
        });
        let above: Vec<Sample> = samples
            .iter()
            .zip(telemetry(&config, &raised.collect::<Vec<_>>()))
            .map(|(sample, above)| Sample {
                measured_rad: above.measured_rad,
                ..*sample
            })
            .collect();
        let missing = verdict(&config, &path, &above);
        assert_eq!(missing.strokes.len(), lengths_mm.len(), "{lengths_mm:?}: {missing:?}");
    }
}

#[test]
fn a_long_stroke_is_followed_at_every_speed() {
    for speed_mm_s in [100.0, 500.0, 530.0, 1_000.0] {
        let mut config = Config::default();
        config.motion.speed_mm_s = speed_mm_s;
        let z_mm = config.paper.pen_down_z_mm;
        // Rings that take longer than the samples that are matched at once.
        let turns = 4.0 + speed_mm_s / 50.0;
        let point = |step: f64| {
            let (angle, radius_mm) = (step * std::f64::consts::TAU / 90.0, 30.0 + step / 90.0);
            [radius_mm * angle.cos(), radius_mm * angle.sin()]
        };
        let vertex = |[x_mm, y_mm]: [f64; 2], z_mm: f64, pen: Pen| Vertex {
            position: Position { x_mm, y_mm, z_mm },
            pen,
            stroke: 0,
        };
        let mut path = vec![
            vertex(point(0.0), z_mm + LIFT_MM, Pen::Up),
            vertex(point(0.0), z_mm, Pen::Up),
        ];
        path.extend((1..(90.0 * turns) as u32).map(|step| vertex(point(step.into()), z_mm, Pen::Down)));
        let samples = telemetry(&config, &path);
        assert!(samples.len() > SAMPLES_MAX, "{} samples", samples.len());
        let verdict = verdict(&config, &path, &samples);
        assert_eq!(verdict.error(), None, "{speed_mm_s} mm/s: {verdict:?}");
        assert!(
            verdict.missing_mm + verdict.unverified_mm < 1e-6,
            "{speed_mm_s} mm/s: {verdict:?}"
        );
    }
}
