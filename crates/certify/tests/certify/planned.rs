//! Certificates of planned paths: what is proved, and that a check refuses what breaks its limit.
//!
//! The planner keeps the limits of acceleration on differences of its 1 ms setpoints. In continuous time the acceleration
//! has peaks over the limit: `docs/certificates.md` has the figures, and the excesses below are above the largest peaks.
//! All other limits hold in continuous time with the excess that the planner's own tests allow.

use crate::paths::{Random, fitted, hidden, settings, stroke};
use crate::planning::{EXCESS, certify, sample, vertex};
use etherpen_certify::{Certificate, Kind, Limits, Quantity};
use etherpen_motion::robots::Kind as RobotKind;
use etherpen_motion::{Pen, Settings, Vertex};
use std::collections::BTreeMap;

/// Paths of the ordinary test and of the nightly one.
const PATHS: u64 = 60;
const PATHS_OF_THE_NIGHT: u64 = 100_000;
/// Environment variables for the first seed and the number of paths of the nightly test.
const FIRST: &str = "ETHERPEN_CERTIFY_FIRST";
const COUNT: &str = "ETHERPEN_CERTIFY_PATHS";
/// Paths of the samples, in order of their size.
const SAMPLES: [(&str, &str); 5] = [
    ("circle", include_str!("../../../../samples/motion/circle.csv")),
    ("square", include_str!("../../../../samples/motion/square.csv")),
    ("stall", include_str!("../../../../samples/motion/stall.csv")),
    ("text", include_str!("../../../../samples/motion/text.csv")),
    ("tolerance", include_str!("../../../../samples/motion/tolerance.csv")),
];

/// Seeds of paths that lose most of their speed within one interval of the grid as the pen begins to rise, or gain it as the
/// pen has come down.
const SUDDEN: [u64; 4] = [10_564, 17_805, 34_316, 41_750];
/// Seed of a path with a span that turns there and back between parallel outer legs.
const THERE_AND_BACK: u64 = 22_258;

/// Allowed excess of a quantity in continuous time. On 20,000 random paths the largest peaks were 5.4 % (tool), 9.3 %
/// (joints) and 5.6 % (pen) over the limit.
fn excess(quantity: Quantity) -> f64 {
    match quantity {
        Quantity::Acceleration => 0.06,
        Quantity::JointAcceleration(1..=3) => 0.15,
        Quantity::PenAcceleration => 0.08,
        _ => EXCESS,
    }
}

/// Largest parts of the limits over several paths, and how many of the paths are proved, violated and undecided.
#[derive(Default)]
struct Tally {
    uses: BTreeMap<Quantity, (f64, f64)>,
    counts: [u64; 3],
    refused: BTreeMap<String, u64>,
    stretches: usize,
    /// What is not known: a bound or a refusal beyond the excesses.
    unknown: Vec<String>,
}

impl Tally {
    /// Adds a certificate; keeps what it refuses beyond what is known.
    fn add(&mut self, name: &str, certificate: &Certificate) {
        let class = match (certificate.violations, certificate.undecided) {
            (0, 0) => 0,
            (0, _) => 2,
            _ => 1,
        };
        self.counts[class] += 1;
        self.stretches += certificate.stretches;
        for (quantity, used) in &certificate.uses {
            let most = self.uses.entry(*quantity).or_default();
            *most = (most.0.max(used.least), most.1.max(used.most));
            let allowed = 1.0 + excess(*quantity) + 1.0e-3;
            let bound = *quantity != Quantity::AveragedTolerance;
            // Bounds that are no numbers too.
            let is_within = used.most <= allowed;
            if bound && !is_within {
                self.unknown.push(format!("{name}: {quantity} uses {used:?}"));
            }
        }
        let mut kinds: Vec<String> = certificate
            .refusals
            .iter()
            .map(|refusal| format!("{:?} {}", refusal.kind, refusal.quantity))
            .collect();
        kinds.sort();
        kinds.dedup();
        for kind in kinds {
            *self.refused.entry(kind).or_default() += 1;
        }
        for refusal in &certificate.refusals {
            let known = match refusal.kind {
                Kind::Violated => excess(refusal.quantity) > EXCESS,
                Kind::NotProved => refusal.quantity == Quantity::AveragedTolerance,
            };
            if !known {
                self.unknown.push(format!("{name}: {refusal:?}"));
            }
        }
    }

    /// Checks that nothing was refused but what is known.
    fn assert_known(&self) {
        assert!(self.unknown.is_empty(), "{:#?}", self.unknown);
    }

    fn show(&self, name: &str) {
        let [proved, violated, undecided] = self.counts;
        println!(
            "{name}: {proved} proved, {violated} violated, {undecided} undecided; {} stretches; paths by refusal {:?}",
            self.stretches, self.refused
        );
        for (quantity, (least, most)) in &self.uses {
            println!("  {quantity}: {least:.5} to {most:.5}");
        }
    }
}

#[test]
fn the_samples_keep_their_limits_but_for_peaks_of_the_acceleration() {
    let mut tally = Tally::default();
    for (name, text) in &SAMPLES[..3] {
        let certificate = certify(&Settings::default(), &sample(text), EXCESS, |_| ());
        assert_eq!(certificate.undecided, 0, "{name}");
        tally.add(name, &certificate);
    }
    tally.show("small samples");
    tally.assert_known();
    let circle = certify(&Settings::default(), &sample(SAMPLES[0].1), EXCESS, |_| ());
    assert!(circle.is_proved());
}

#[test]
#[ignore = "takes minutes: run it every night"]
fn the_large_samples_keep_their_limits_but_for_peaks_of_the_acceleration() {
    for (name, text) in &SAMPLES[3..] {
        let certificate = certify(&Settings::default(), &sample(text), EXCESS, |_| ());
        assert_eq!(certificate.undecided, 0, "{name}");
        let mut tally = Tally::default();
        tally.add(name, &certificate);
        tally.show(name);
        tally.assert_known();
    }
}

#[test]
fn limits_hidden_between_the_points_of_the_grid_are_found() {
    for kind in RobotKind::ALL {
        hidden_limits(kind);
    }
}

#[test]
fn random_paths_of_other_machines_keep_every_limit_but_for_peaks_of_the_acceleration() {
    for kind in &RobotKind::ALL[1..] {
        random_paths(*kind, 1..PATHS / 3 + 1);
    }
}

fn hidden_limits(kind: RobotKind) {
    let mut tally = Tally::default();
    let mut found = 0;
    for (seed, acceleration) in (1..).zip([10.0, 100.0, 1_000.0, 4_000.0, 30_000.0]) {
        for window_ms in [0, 4] {
            let mut settings = Settings::usual(kind.geometry());
            settings.motion.acceleration_mm_s2 = acceleration;
            settings.motion.jerk_window_ms = window_ms;
            for (number, path) in hidden(seed).iter().enumerate() {
                let name = format!("{kind:?}, seed {seed}, {acceleration} mm/s2, window {window_ms}, path {number}");
                let path = fitted(path, &settings);
                let certificate = certify(&settings, &path, EXCESS, |_| ());
                tally.add(&name, &certificate);
                found += certificate.violations;
            }
        }
    }
    tally.show("hidden limits");
    tally.assert_known();
    assert!(found > 0);
}

fn random_paths(kind: RobotKind, seeds: std::ops::Range<u64>) {
    println!("{kind:?}, seeds {seeds:?}");
    let count = seeds.end - seeds.start;
    let mut tally = Tally::default();
    for seed in seeds {
        let mut random = Random::new(seed);
        let settings = settings(&mut random, kind);
        let path = fitted(&stroke(&mut random, &settings), &settings);
        tally.add(
            &format!("{kind:?}, seed {seed}"),
            &certify(&settings, &path, EXCESS, |_| ()),
        );
        if seed % 1_000 == 0 {
            tally.show(&format!("up to seed {seed}"));
        }
    }
    tally.show("random paths");
    tally.assert_known();
    let [proved, _, undecided] = tally.counts;
    // The bound of what the average adds is coarser on short links.
    let (most_undecided, least_proved) = if kind == RobotKind::Delta {
        (count / 20, count / 2)
    } else {
        (count / 3, count / 3)
    };
    assert!(undecided <= most_undecided && proved >= least_proved, "{kind:?}");
}

#[test]
fn random_paths_keep_every_limit_but_for_peaks_of_the_acceleration() {
    random_paths(RobotKind::Delta, 1..PATHS + 1);
}

#[test]
fn a_pen_that_begins_to_rise_as_the_path_slows_down_keeps_its_limit_but_for_small_peaks() {
    let mut tally = Tally::default();
    for seed in SUDDEN {
        let mut random = Random::new(seed);
        let settings = settings(&mut random, RobotKind::Delta);
        let path = fitted(&stroke(&mut random, &settings), &settings);
        tally.add(&format!("seed {seed}"), &certify(&settings, &path, EXCESS, |_| ()));
    }
    tally.show("sudden paths");
    tally.assert_known();
}

#[test]
fn a_span_that_turns_there_and_back_joins_its_neighbours_at_their_speed() {
    let (mut random, mut tally) = (Random::new(THERE_AND_BACK), Tally::default());
    let settings = settings(&mut random, RobotKind::Delta);
    let path = fitted(&stroke(&mut random, &settings), &settings);
    tally.add("there and back", &certify(&settings, &path, EXCESS, |_| ()));
    tally.show("there and back");
    tally.assert_known();
}

#[test]
#[ignore = "takes half an hour and more: run it every night"]
fn a_hundred_thousand_random_paths_keep_every_limit_but_for_peaks_of_the_acceleration() {
    let number = |name, or| {
        std::env::var(name)
            .ok()
            .and_then(|text| text.parse().ok())
            .unwrap_or(or)
    };
    let first = number(FIRST, 1);
    random_paths(RobotKind::Delta, first..first + number(COUNT, PATHS_OF_THE_NIGHT));
}

/// A path that uses the limits of the tool and of the pen.
fn busy() -> (Settings, Vec<Vertex>) {
    let mut settings = Settings::default();
    settings.motion.acceleration_mm_s2 = 5_000.0;
    settings.motion.pen_speed_mm_s = 60.0;
    settings.motion.pen_acceleration_mm_s2 = 2_000.0;
    settings.motion.jerk_window_ms = 0;
    settings.motion.orientation = etherpen_motion::settings::Orientation::Path;
    let at = |point, pen| vertex(point, pen);
    let path = vec![
        at([-60.0, 0.0, -840.0], Pen::Up),
        at([-60.0, 0.0, -850.0], Pen::Up),
        at([60.0, 0.0, -850.0], Pen::Down),
        at([60.0, 40.0, -850.0], Pen::Down),
        at([60.0, 40.0, -840.0], Pen::Up),
    ];
    (settings, path)
}

/// A path that uses the limits of the joints.
fn fast() -> (Settings, Vec<Vertex>) {
    let mut settings = Settings::default();
    settings.motion.speed_mm_s = 9_000.0;
    settings.motion.travel_speed_mm_s = 9_000.0;
    settings.motion.acceleration_mm_s2 = 150_000.0;
    settings.motion.joint_speed_rad_s = [3.0; 4];
    settings.motion.joint_acceleration_rad_s2 = [60.0; 4];
    settings.motion.jerk_window_ms = 0;
    let at = |x, y| vertex([x, y, -850.0], Pen::Down);
    (
        settings,
        vec![
            at(-250.0, -60.0),
            at(250.0, 60.0),
            at(-100.0, 250.0),
            at(-100.0, -250.0),
        ],
    )
}

/// Certifies with one limit as a part of what the motion uses of it; returns the refusals of that quantity.
fn lowered(
    (settings, path): &(Settings, Vec<Vertex>),
    quantity: Quantity,
    change: impl Fn(&mut Limits, f64),
) -> (bool, Vec<Kind>) {
    let used = certify(settings, path, 0.0, |_| ()).uses[&quantity];
    let run = |part: f64| {
        let certificate = certify(settings, path, 0.0, |limits| change(limits, part));
        let of_it = certificate
            .refusals
            .iter()
            .filter(|refusal| refusal.quantity == quantity);
        for refusal in of_it.clone() {
            let [low, high] = refusal.value;
            assert!(low <= high && refusal.limit.is_finite(), "{refusal:?}");
            assert!((0.0..=certificate.duration_s).contains(&refusal.time_s), "{refusal:?}");
        }
        of_it.map(|refusal| refusal.kind).collect::<Vec<_>>()
    };
    (run(used.most * 1.001).is_empty(), run(used.least * 0.99))
}

#[test]
fn a_limit_that_is_one_percent_too_low_is_violated_with_a_witness() {
    let set = |value: &mut f64, part: f64| *value *= part;
    let (busy, fast) = (busy(), fast());
    let mut cases = vec![
        (
            Quantity::Speed,
            lowered(&busy, Quantity::Speed, |l, p| set(&mut l.speed_mm_s, p)),
        ),
        (
            Quantity::Acceleration,
            lowered(&busy, Quantity::Acceleration, |l, p| set(&mut l.acceleration_mm_s2, p)),
        ),
        (
            Quantity::PenSpeed,
            lowered(&busy, Quantity::PenSpeed, |l, p| set(&mut l.pen_speed_mm_s, p)),
        ),
        (
            Quantity::PenAcceleration,
            lowered(&busy, Quantity::PenAcceleration, |l, p| {
                set(&mut l.pen_acceleration_mm_s2, p)
            }),
        ),
    ];
    for axis in 0..4 {
        let of = if axis == 3 { &busy } else { &fast };
        let number = axis as u8 + 1;
        let speed = lowered(of, Quantity::JointSpeed(number), |l, p| {
            set(&mut l.joint_speed_rad_s[axis], p)
        });
        cases.push((Quantity::JointSpeed(number), speed));
        let quantity = Quantity::JointAcceleration(number);
        let acceleration = lowered(of, quantity, |l, p| set(&mut l.joint_acceleration_rad_s2[axis], p));
        cases.push((quantity, acceleration));
        let angle = lowered(of, Quantity::Angle(number), |l, p| {
            let [low, high] = l.range_rad[axis];
            let (middle, half) = (0.5 * (low + high), 0.5 * (high - low) * p);
            l.range_rad[axis] = [middle - half, middle + half];
        });
        cases.push((Quantity::Angle(number), angle));
    }
    for (quantity, (kept, violated)) in cases {
        assert!(kept, "{quantity}: what is a thousandth above the use is not proved");
        assert!(violated.contains(&Kind::Violated), "{quantity}: {violated:?}");
    }
}

#[test]
fn a_tolerance_that_is_one_percent_too_low_is_violated_or_cannot_be_proved_after_the_average() {
    let mut case = busy();
    let (kept, violated) = lowered(&case, Quantity::Tolerance, |l, p| l.tolerance_mm *= p);
    assert!(kept && violated.contains(&Kind::Violated), "{violated:?}");
    case.0.motion.jerk_window_ms = 4;
    let (kept, refused) = lowered(&case, Quantity::AveragedTolerance, |l, p| {
        l.tolerance_mm *= p;
        l.travel_tolerance_mm *= p;
    });
    assert!(kept && refused.contains(&Kind::NotProved), "{refused:?}");
}

/// The certificate of some settings for the same motion that others have.
#[test]
fn a_certificate_depends_on_nothing_but_its_input() {
    let (settings, path) = fast();
    let one = certify(&settings, &path, EXCESS, |_| ());
    assert_eq!(one, certify(&settings, &path, EXCESS, |_| ()));
    assert!(one.boxes > one.stretches && one.duration_s > 0.1);
}
