//! Stops on smooth random paths: on the path, within the decelerations, in time.

use super::*;
use heapless::spsc::Queue;
use proptest::prelude::*;
use std::vec::Vec;

/// Joint motions: a constant velocity and a swing of each joint, whose acceleration is a part of the joint's deceleration.
#[derive(Clone, Debug)]
struct Path {
    speeds_rad_s: [f64; AXES],
    swings: [[f64; 3]; AXES],
}

impl Path {
    fn position_rad(&self, ms: f64) -> [f64; AXES] {
        core::array::from_fn(|axis| {
            let [size_rad, rad_s, phase] = self.swings[axis];
            self.speeds_rad_s[axis] * ms * STEP_S + size_rad * libm::sin(rad_s * ms * STEP_S + phase)
        })
    }

    fn setpoint(&self, ms: u32) -> Setpoint {
        let ms = f64::from(ms);
        let (position_rad, before_rad) = (self.position_rad(ms), self.position_rad(ms - 1.0));
        Setpoint {
            position_rad,
            velocity_rad_s: core::array::from_fn(|axis| (position_rad[axis] - before_rad[axis]) / STEP_S),
            ..Setpoint::default()
        }
    }
}

/// Paths whose own accelerations are at most this part of the decelerations, and that swing at least this fast.
fn paths(part: f64, deceleration_rad_s2: f64, slowest_rad_s: f64) -> impl Strategy<Value = Path> {
    let swing = (slowest_rad_s..40.0, 0.0..TAU, 0.0..1.0).prop_map(move |(rad_s, phase, share): (f64, f64, f64)| {
        [share * part * deceleration_rad_s2 / (rad_s * rad_s), rad_s, phase]
    });
    let speeds = prop::array::uniform4(-10.0..10.0);
    (speeds, prop::array::uniform4(swing)).prop_map(|(speeds_rad_s, swings)| Path { speeds_rad_s, swings })
}

fn axes(deceleration_rad_s2: f64) -> [Axis; AXES] {
    [Axis {
        quick_stop_rad_s2: deceleration_rad_s2,
        ..Axis::default()
    }; AXES]
}

struct Stopped {
    /// Setpoints from the last one kept on, and the place of each on the path, ms.
    setpoints: Vec<(f64, Setpoint)>,
    /// Setpoints until the rate is 0, and milliseconds of a quick stop.
    took_ms: [f64; 2],
}

/// Stops on a path; `None` if the ring runs dry or the path cannot be kept.
fn stop(path: &Path, deceleration_rad_s2: f64, ring_ms: u32) -> Option<Stopped> {
    let axes = axes(deceleration_rad_s2);
    let mut queue = Queue::<Queued, 64>::new();
    let (mut producer, mut ring) = queue.split();
    let mut next = 0;
    let mut fill = || {
        while next < ring_ms
            && producer
                .enqueue(Queued {
                    epoch: 1,
                    setpoint: path.setpoint(next),
                })
                .is_ok()
        {
            next += 1;
        }
    };
    let mut window = Window::new();
    let mut stop = PathStop::new();
    fill();
    for _ in 0..2 {
        window.fill(&mut ring, 1);
    }
    let kept = 5;
    let last = *window.get(kept - 1)?;
    if !stop.begin(&mut window, kept, &axes) {
        return None;
    }
    assert_eq!(window.length(), kept);
    let mut place_ms = kept as f64 - 1.0;
    let mut setpoints = std::vec![(place_ms, last)];
    while stop.rate > 0.0 {
        fill();
        let rate = stop.rate;
        let setpoint = stop.step(&mut ring, 1, &axes)?;
        place_ms += (rate + stop.rate) / 2.0;
        setpoints.push((place_ms, setpoint));
        assert!(
            stop.rate <= rate && setpoints.len() < 2_000,
            "{} at {place_ms}",
            stop.rate
        );
    }
    let took_ms = [
        setpoints.len() as f64 - 1.0,
        quick_stop_s(&last.velocity_rad_s, &axes) / STEP_S,
    ];
    assert_eq!(
        stop.step(&mut ring, 1, &axes)?.position_rad,
        setpoints.last()?.1.position_rad
    );
    Some(Stopped { setpoints, took_ms })
}

proptest! {
    #[test]
    fn a_stop_stays_on_the_path_within_the_decelerations_and_takes_little_longer_than_a_quick_stop(
        path in paths(0.4, 100.0, 5.0)
    ) {
        let stopped = stop(&path, 100.0, u32::MAX).expect("it brakes");
        for (place_ms, setpoint) in &stopped.setpoints {
            let expected_rad = path.position_rad(*place_ms);
            for (axis, expected_rad) in expected_rad.into_iter().enumerate() {
                let off_rad = (setpoint.position_rad[axis] - expected_rad).abs();
                prop_assert!(off_rad < 1.0e-6, "joint {axis} is {off_rad} rad off at {place_ms} ms");
            }
        }
        for pair in stopped.setpoints.windows(2) {
            for axis in 0..AXES {
                let [before, after] = [0, 1].map(|index| pair[index].1.velocity_rad_s[axis]);
                let braked = (before.abs() - after.abs()) / STEP_S;
                // The least share, and what the path itself demands of the joint that is braked by it and of this one.
                prop_assert!(braked < 1.02 * (SHARE_MIN + 2.0 * 0.4) * 100.0, "joint {axis} brakes with {braked} rad/s2");
            }
        }
        let [took_ms, quick_ms] = stopped.took_ms;
        prop_assert!(took_ms <= quick_ms / SHARE_MIN + 3.0, "{took_ms} ms for {quick_ms} ms");
    }

    #[test]
    fn a_stop_on_a_straight_joint_motion_takes_as_long_as_the_quick_stop(path in paths(0.0, 100.0, 5.0)) {
        let [took_ms, quick_ms] = stop(&path, 100.0, u32::MAX).expect("it brakes").took_ms;
        prop_assert!((took_ms - quick_ms).abs() <= 2.0, "{took_ms} ms for {quick_ms} ms");
    }

    #[test]
    fn a_stop_on_a_path_that_is_harder_than_the_quick_stop_still_ends_on_it(path in paths(3.0, 100.0, 15.0)) {
        let stopped = stop(&path, 100.0, u32::MAX).expect("it brakes");
        let (place_ms, last) = stopped.setpoints.last().expect("setpoints");
        for (axis, expected_rad) in path.position_rad(*place_ms).into_iter().enumerate() {
            prop_assert!((last.position_rad[axis] - expected_rad).abs() < 5.0e-6);
        }
    }
}

#[test]
fn without_setpoints_there_is_no_stop_on_the_path() {
    let path = Path {
        speeds_rad_s: [10.0; AXES],
        swings: [[0.0; 3]; AXES],
    };
    assert!(stop(&path, 100.0, 12).is_none(), "the ring runs dry");
    assert!(stop(&path, 100.0, 3).is_none(), "nothing is ahead");
    assert!(stop(&path, 10.0, u32::MAX).is_none(), "a quick stop of a second");
    assert!(!PathStop::new().begin(&mut Window::new(), 5, &axes(100.0)));
    assert_eq!(quick_stop_s(&[1.0, f64::NAN, 2.0, 0.0], &axes(100.0)), f64::INFINITY);
}

/// An envelope of a stop from 5 rad/s with 100 rad/s2, and the planned speed of each millisecond.
fn envelope() -> (Envelope, impl Fn(u32) -> f64) {
    let planned = |ms: u32| (5.0 - 0.1 * f64::from(ms)).max(0.0);
    (Envelope::new(0.05, 5, &axes(100.0)), planned)
}

#[test]
fn a_joint_that_brakes_as_planned_or_a_little_later_is_within_the_envelope() {
    for late_ms in [0, 3] {
        let (mut envelope, planned) = envelope();
        for ms in 0..90 {
            let measured = [planned(ms.max(late_ms) - late_ms); AXES];
            assert!(
                envelope.step(&measured, &[planned(ms); AXES]).is_ok(),
                "{ms} ms, {late_ms} ms late"
            );
        }
    }
}

#[test]
fn a_joint_that_does_not_brake_or_brakes_softly_or_never_ends_leaves_the_envelope_and_is_named() {
    for (share, longest_ms) in [(0.0, 11), (0.5, 27)] {
        let (mut envelope, planned) = envelope();
        let left = (0..90).find_map(|ms| {
            let planned = planned(ms);
            let measured = [planned, planned, -5.0 + share * (5.0 - planned), planned];
            let failure = envelope.step(&measured, &[planned, planned, -planned, planned]).err()?;
            Some((ms, failure))
        });
        let (ms, failure) = left.expect("it leaves");
        assert!(ms <= longest_ms, "share {share}: {ms}");
        assert!(
            matches!(failure, PathStopFailure::Speed { axis: 2, measured_rad_s, .. } if measured_rad_s < -2.0),
            "{failure:?}"
        );
    }
    // A feedback that is frozen shows a joint that stands.
    let (mut envelope, planned) = envelope();
    let left = (0..90).find_map(|ms| {
        let speeds = [planned(ms), 0.0, planned(ms), planned(ms)];
        Some((ms, envelope.step(&speeds, &[planned(ms); AXES]).err()?))
    });
    let expected = PathStopFailure::Speed {
        axis: 1,
        measured_rad_s: 0.0,
        planned_rad_s: 4.8,
    };
    assert_eq!(left, Some((2, expected)));
    let mut envelope = Envelope::new(0.05, 5, &axes(100.0));
    let over = (0..500).find_map(|ms| {
        let creeps = [0.0, 0.0, 0.1, -0.2];
        Some((ms, envelope.step(&creeps, &[0.0; AXES]).err()?))
    });
    // 1.2 times 83 ms and what was kept, and 10 ms.
    let expected = PathStopFailure::Time {
        axis: 3,
        measured_rad_s: -0.2,
        passed_ms: 117,
    };
    assert_eq!(over, Some((116, expected)));
    // Controllers that still take the last error away are no joints in motion.
    let mut envelope = Envelope::new(0.05, 5, &axes(100.0));
    let over = (0..500).find(|_| envelope.step(&[0.0, 0.0, 0.05, -0.1], &[0.0; AXES]) == Ok(true));
    assert_eq!(over, Some(116));
    let mut envelope = envelope_of_nothing();
    for is_within in [true, true, false] {
        let judged = envelope.step(&[0.0, f64::NAN, 0.0, 0.0], &[0.0; AXES]);
        assert_eq!(judged.is_ok(), is_within);
        if let Err(failure) = judged {
            assert!(matches!(failure, PathStopFailure::Speed { axis: 1, .. }), "{failure:?}");
        }
    }
}

fn envelope_of_nothing() -> Envelope {
    Envelope::new(0.0, 1, &axes(100.0))
}

#[test]
fn a_position_that_is_reported_twice_does_not_end_the_stop() {
    let (mut envelope, planned) = envelope();
    for ms in 0..60 {
        let factor = match ms % 5 {
            0 => 0.0,
            1 => 2.0,
            _ => 1.0,
        };
        assert!(
            envelope
                .step(&[factor * planned(ms); AXES], &[planned(ms); AXES])
                .is_ok(),
            "{ms} ms"
        );
    }
}
