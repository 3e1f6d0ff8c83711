//! Speed and acceleration of the platform, from the references in the telemetry.
//!
//! Telemetry has single precision. An angle near 1 rad is rounded by up to 6e-8 rad, and the second difference of three
//! such angles over 1 ms is wrong by up to 0.2 rad/s2, which is 0.1 m/s2 at the platform. Speeds are the exact
//! differences of the references, rounded by only 6e-8 of their value. The positions a millisecond before and after a
//! reference are therefore computed from its angle and the two speeds: the rounding of the angle moves all three
//! positions alike, and the acceleration is wrong by less than 1 mm/s2.

use super::PlatformLimits;
use etherpen::config::Config;
use etherpen::messages::Sample;
use etherpen::robots::vector::{Vector, length, subtract};
use etherpen::robots::{AXES, JointAngles, Kinematics};

/// One millisecond, s.
const TICK_S: f64 = 1.0e-3;

/// The largest values with their limits.
pub(super) fn platform_limits(config: &Config, samples: &[Sample]) -> PlatformLimits {
    let (mut speed, mut acceleration) = (0.0_f64, 0.0_f64);
    if let Ok(kinematics) = Kinematics::new(&config.geometry) {
        for pair in samples.windows(2) {
            if let Some((speed_here, change)) = motion(&kinematics, pair) {
                speed = speed.max(length(&speed_here));
                acceleration = acceleration.max(length(&change));
            }
        }
    }
    PlatformLimits {
        speed_mm_s: speed,
        speed_limit_mm_s: config.motion.speed_mm_s,
        travel_speed_limit_mm_s: config.motion.travel_speed_mm_s,
        acceleration_mm_s2: acceleration,
        acceleration_limit_mm_s2: config.motion.acceleration_mm_s2,
    }
}

/// Speed after a reference, mm/s, and its change, mm/s2; `None` across a gap in the telemetry.
fn motion(kinematics: &Kinematics, pair: &[Sample]) -> Option<(Vector, Vector)> {
    let [here, next] = pair else { return None };
    if next.t_ms != here.t_ms.wrapping_add(1) {
        return None;
    }
    let place = |speeds: [f32; AXES], ticks: f64| -> Option<Vector> {
        let joints: [f64; AXES] =
            std::array::from_fn(|axis| f64::from(here.setpoint_rad[axis]) + ticks * f64::from(speeds[axis]));
        Some(kinematics.forward(&JointAngles(joints)).ok()?.into())
    };
    let before = place(here.setpoint_rad_s, -TICK_S)?;
    let at = place([0.0; AXES], 0.0)?;
    let after = place(next.setpoint_rad_s, TICK_S)?;
    let [arrival, departure] = [subtract(&at, &before), subtract(&after, &at)].map(|way| way.map(|mm| mm / TICK_S));
    let change = subtract(&departure, &arrival).map(|change| change / TICK_S);
    Some((departure, change))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planning::plan;
    use etherpen::application::Mode;
    use etherpen::messages::IoValues;
    use etherpen::motion::{Pen, Vertex};

    /// A path's references as telemetry carries them, and the largest acceleration of the references themselves.
    fn telemetry(config: &Config) -> (Vec<Sample>, f64) {
        let corner = |[x, y]: [f64; 2]| Vertex {
            position: [x, y, -850.0].into(),
            pen: Pen::Down,
            stroke: 0,
        };
        let corners = [
            [-60.0, -20.0],
            [70.0, 10.0],
            [20.0, 80.0],
            [-50.0, -70.0],
            [65.0, -45.0],
        ];
        let mut places: Vec<Vector> = Vec::new();
        let mut samples = Vec::new();
        plan(config, &corners.map(corner), |sample, _| {
            places.push(sample.point);
            samples.push(Sample {
                t_ms: sample.t_ms as u32,
                mode: Mode::Drawing,
                stroke: 0,
                pen: Pen::Down,
                setpoint_rad: sample.setpoint.position_rad.map(|angle| angle as f32),
                measured_rad: [0.0; AXES],
                setpoint_rad_s: sample.setpoint.velocity_rad_s.map(|speed| speed as f32),
                measured_rad_s: [0.0; AXES],
                io: IoValues::default(),
            });
        })
        .unwrap();
        (samples, second_difference(&places))
    }

    fn second_difference(places: &[Vector]) -> f64 {
        let ways: Vec<Vector> = places.windows(2).map(|pair| subtract(&pair[1], &pair[0])).collect();
        let changes = ways.windows(2).map(|pair| length(&subtract(&pair[1], &pair[0])));
        changes.fold(0.0, f64::max) / (TICK_S * TICK_S)
    }

    #[test]
    fn the_acceleration_is_that_of_the_references_and_not_of_their_rounding() {
        let config = Config::default();
        let (samples, exact) = telemetry(&config);
        let found = platform_limits(&config, &samples).acceleration_mm_s2;
        let kinematics = Kinematics::new(&config.geometry).unwrap();
        let rounded: Vec<Vector> = samples
            .iter()
            .map(|sample| {
                kinematics
                    .forward(&JointAngles(sample.setpoint_rad.map(f64::from)))
                    .unwrap()
                    .into()
            })
            .collect();
        let of_rounded = second_difference(&rounded);
        println!("references {exact} mm/s2, found {found}, differences of rounded angles {of_rounded}");
        assert!(exact < 10_000.0 && (found - exact).abs() < 1.0);
        assert!(of_rounded > exact + 20.0, "rounding alone makes {of_rounded} mm/s2");
    }

    #[test]
    fn a_gap_in_the_telemetry_is_no_motion() {
        let config = Config::default();
        let (mut samples, _) = telemetry(&config);
        let whole = platform_limits(&config, &samples);
        samples.drain(40..70);
        let gap = platform_limits(&config, &samples);
        assert!(gap.acceleration_mm_s2 <= whole.acceleration_mm_s2 && gap.speed_mm_s <= whole.speed_mm_s);
    }
}
