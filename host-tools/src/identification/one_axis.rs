//! A motion of one axis alone, for a person who watches which drive turns.
//!
//! Drives that are exchanged, or turn the other way, are consistent with themselves: each follows its own commands, and a
//! robot with equal axes hangs the same with two of them exchanged. Only somebody who sees the machine can tell.
//!
//! The path is the way of the tool while one joint turns back and forth, its vertices so close to each other that the other
//! joints stand still within [`OTHERS_RAD`]. Invariant: the axis may as well go the other way, and the drive of any other main axis may get
//! the commands instead: each has room in the work area, above the height of the lifted pen, and goes no farther than is meant.

use super::{middle_mm, test_config};
use crate::axes::{Motion, motion};
use etherpen::application::Mode;
use etherpen::config::{Config, Orientation};
use etherpen::messages::{PathVertex, Sample};
use etherpen::motion::{Pen, WorkArea};
use etherpen::robots::{AXES, JointAngles, Kinematics, LINEAR_MM_PER_RAD, MAIN_AXES, Position};

/// How far a rotary axis turns, rad, and a linear one travels, mm, where there is room; a quarter of it at least.
const TURN_RAD: f64 = 0.08;
const TRAVEL_MM: f64 = 20.0;
/// Least part of it that a person can see.
const PART_MIN: f64 = 0.05;
/// Highest speed and acceleration of the tool, mm/s and mm/s2: slow enough to be followed by eye.
const SPEED_MM_S: f64 = 20.0;
const ACCELERATION_MM_S2: f64 = 200.0;
/// How often the axis goes there and back, and vertices on each way.
const TIMES: usize = 2;
const STEPS: usize = 40;
/// How far a joint turns to either side to find where the tool goes with it, rad, and the least way of the tool for a radian that
/// tells, mm.
const STEP_RAD: f64 = 1e-4;
const LEAST_MM: f64 = 1e-3;
/// How far the other joints may turn, rad: the rounding of the vertices and of the corners between them.
pub const OTHERS_RAD: f64 = 1.5e-3;

/// The motion of one axis.
#[derive(Clone, Debug)]
pub struct OneAxis {
    /// How far the axis goes first, in its unit: rad or mm.
    pub by: f64,
    /// Where the tool goes with it, mm.
    pub tool_mm: [f64; 3],
    /// There and back, twice, with the pen up.
    pub path: Vec<PathVertex>,
    /// Its part of what is meant, at most 1: as much slower it is.
    part: f64,
    /// The joints where it begins, rad.
    from_rad: [f64; MAIN_AXES],
}

impl OneAxis {
    /// The motion of a main axis, from 0, above the sheet's centre.
    ///
    /// # Errors
    /// The machine has no such main axis, or it has no room there.
    pub fn new(config: &Config, axis: usize) -> Result<Self, String> {
        if axis >= MAIN_AXES.min(config.bus.drives.into()) {
            return Err(format!("axis {} does not move the tool", axis + 1));
        }
        let area = WorkArea::new(&config.motion_settings()).map_err(|cause| cause.to_string())?;
        let (from_mm, clearance_mm) = middle_mm(config);
        let lowest_mm = from_mm[2] - clearance_mm;
        let from_rad = area.kinematics().inverse(&Position::from(from_mm));
        let from_rad = from_rad.map_err(|_| "the robot has no pose above the sheet's centre".to_owned())?;
        let mains = 0..MAIN_AXES.min(config.bus.drives.into());
        let way = |axis, by_rad| way(&area, from_rad, axis, by_rad, lowest_mm);
        let mut rooms_rad = Vec::new();
        for axis in mains {
            let meant_rad = meant_rad(config, axis);
            let room_rad = [1.0, 0.5, 0.25].into_iter().map(|share| share * meant_rad);
            let room_rad = room_rad
                .into_iter()
                .find(|room| way(axis, *room).is_some() && way(axis, -room).is_some());
            rooms_rad.push(room_rad.ok_or_else(|| {
                format!(
                    "axis {} has no room above the sheet's centre: it takes some millimetres each way",
                    axis + 1
                )
            })?);
        }
        let by_rad = shortest_rad(config, axis, &rooms_rad);
        let part = by_rad / meant_rad(config, axis);
        if part < PART_MIN {
            let text = "has to move so little that nobody sees it, for the motor of another axis would go too far if both are exchanged";
            return Err(format!("axis {} {text}", axis + 1));
        }
        let way = way(axis, by_rad).ok_or_else(|| format!("axis {} has no room above the sheet's centre", axis + 1))?;
        // Each vertex once: no end is there twice.
        let there_and_back = || way.iter().skip(1).chain(way.iter().rev().skip(1));
        let path = way.iter().take(1).chain((0..TIMES).flat_map(|_| there_and_back()));
        let tool_mm = way.last().map_or([0.0; 3], |end| {
            let um = |k: usize| f64::from(end.position_um[k]) - (1_000.0 * from_mm[k]).round();
            std::array::from_fn(|k| um(k) / 1_000.0)
        });
        Ok(Self {
            by: by_rad * motion(config.geometry.kind(), axis).factor(),
            tool_mm,
            path: path.copied().collect(),
            part,
            from_rad,
        })
    }

    /// The configuration for the motion: that of the test motion, slower, and with a turn that stays.
    #[must_use]
    pub fn slow_config(&self, config: &Config) -> Config {
        let mut slow = test_config(config);
        let motion = &mut slow.motion;
        let speed_mm_s = SPEED_MM_S * self.part.min(1.0);
        motion.orientation = Orientation::Constant;
        motion.speed_mm_s = motion.speed_mm_s.min(speed_mm_s);
        motion.travel_speed_mm_s = motion.travel_speed_mm_s.min(speed_mm_s);
        motion.acceleration_mm_s2 = motion.acceleration_mm_s2.min(ACCELERATION_MM_S2);
        slow
    }

    /// How far each main axis was measured to move, from one end to the other, rad, once it was where the motion begins.
    #[must_use]
    pub fn travelled_rad(&self, samples: &[Sample]) -> [f64; MAIN_AXES] {
        let has_come = |sample: &&Sample| {
            let mut joints = self.from_rad.iter().zip(sample.setpoint_rad);
            joints.all(|(from_rad, at_rad)| (from_rad - f64::from(at_rad)).abs() < OTHERS_RAD)
        };
        let drawn = samples.iter().filter(|sample| sample.mode == Mode::Drawing);
        let mut ranges = [None::<[f64; 2]>; MAIN_AXES];
        for sample in drawn.skip_while(|sample| !has_come(sample)) {
            for (range, measured) in ranges.iter_mut().zip(sample.measured_rad) {
                let measured = f64::from(measured);
                let [low, high] = range.unwrap_or([measured; 2]);
                *range = Some([low.min(measured), high.max(measured)]);
            }
        }
        ranges.map(|range| range.map_or(0.0, |[low, high]| high - low))
    }
}

/// A motion of one main axis forwards, while the others stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alone {
    /// Velocity of the tool, mm/s.
    pub velocity_mm_s: [f64; 3],
    /// Speed of the joint, rad/s.
    pub speed_rad_s: f64,
}

/// The motion of one main axis, from 0, at these joints: the tool goes no faster than 20 mm/s, and would not if the drive of any
/// other main axis got the commands. `None` for an axis that does not move the tool, and where the joints are in no pose.
#[must_use]
pub fn alone(config: &Config, joints_rad: &[f64; AXES], axis: usize) -> Option<Alone> {
    let mains = MAIN_AXES.min(config.bus.drives.into());
    let kinematics = Kinematics::new(&config.geometry).ok().filter(|_| axis < mains)?;
    let mut fastest_rad_s = f64::INFINITY;
    for other in 0..mains {
        let lever_mm = length(&lever_mm(&kinematics, joints_rad, other)?);
        // The commands are increments of the encoder.
        let rad_a_rad = increments_a_rad(config, axis) / increments_a_rad(config, other);
        fastest_rad_s = fastest_rad_s.min(SPEED_MM_S / (lever_mm * rad_a_rad));
    }
    let lever_mm = lever_mm(&kinematics, joints_rad, axis)?;
    (length(&lever_mm) > LEAST_MM && fastest_rad_s.is_finite()).then(|| Alone {
        velocity_mm_s: lever_mm.map(|mm| mm * fastest_rad_s),
        speed_rad_s: fastest_rad_s,
    })
}

/// How far the tool goes for a radian of a joint, mm.
fn lever_mm(kinematics: &Kinematics, joints_rad: &[f64; AXES], joint: usize) -> Option<[f64; 3]> {
    let beside_mm = |by_rad: f64| {
        let mut joints_rad = *joints_rad;
        joints_rad[joint] += by_rad;
        let place = kinematics.forward(&JointAngles(joints_rad)).ok()?;
        Some([place.x_mm, place.y_mm, place.z_mm])
    };
    let (back_mm, forth_mm) = (beside_mm(-STEP_RAD)?, beside_mm(STEP_RAD)?);
    Some(std::array::from_fn(|k| (forth_mm[k] - back_mm[k]) / (2.0 * STEP_RAD)))
}

fn length(mm: &[f64; 3]) -> f64 {
    mm.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Increments of an axis's encoder for a radian of its joint.
fn increments_a_rad(config: &Config, axis: usize) -> f64 {
    let axis = &config.axes[axis];
    axis.gear.abs() * f64::from(axis.increments_per_revolution)
}

/// How far an axis may go at once while nobody knows whether it is the right one, rad, so that no other main axis goes farther than
/// is meant for it if its drive gets the commands instead.
#[must_use]
pub fn way_max_rad(config: &Config, axis: usize) -> f64 {
    let mains = MAIN_AXES.min(config.bus.drives.into());
    let meant_rad: Vec<f64> = (0..mains).map(|axis| meant_rad(config, axis)).collect();
    shortest_rad(config, axis, &meant_rad)
}

/// How far an axis is to go, rad.
fn meant_rad(config: &Config, axis: usize) -> f64 {
    match motion(config.geometry.kind(), axis) {
        Motion::Rotary => TURN_RAD,
        Motion::Linear => TRAVEL_MM / LINEAR_MM_PER_RAD,
    }
}

/// How far an axis goes, rad, so that no main axis leaves its room if its drive gets the commands instead: they are increments of the
/// encoder.
fn shortest_rad(config: &Config, axis: usize, rooms_rad: &[f64]) -> f64 {
    let other =
        |(other, room_rad): (usize, &f64)| room_rad * increments_a_rad(config, other) / increments_a_rad(config, axis);
    rooms_rad.iter().enumerate().map(other).fold(f64::INFINITY, f64::min)
}

/// The vertices while a joint turns by `by_rad`; `None` if one of them is outside the work area or lower than `lowest_mm`.
fn way(
    area: &WorkArea,
    from_rad: [f64; MAIN_AXES],
    axis: usize,
    by_rad: f64,
    lowest_mm: f64,
) -> Option<Vec<PathVertex>> {
    (0..=STEPS)
        .map(|step| {
            let mut joints_rad = [0.0; AXES];
            joints_rad[..MAIN_AXES].copy_from_slice(&from_rad);
            joints_rad[axis] += by_rad * step as f64 / STEPS as f64;
            let at = area.kinematics().forward(&JointAngles(joints_rad)).ok()?;
            let um = [at.x_mm, at.y_mm, at.z_mm].map(|mm| (mm * 1_000.0).round());
            let rounded = Position::from(um.map(|um| um / 1_000.0));
            let is_inside = area.contains(&rounded) && rounded.z_mm >= lowest_mm;
            is_inside.then_some(PathVertex {
                position_um: um.map(|um| um as i32),
                pen: Pen::Up,
                stroke: 0,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::machines::MACHINES;

    #[test]
    fn one_joint_turns_and_the_others_stand_still() {
        for machine in &MACHINES {
            let config = machine.load().expect("a configuration");
            let area = WorkArea::new(&config.motion_settings()).expect("a robot");
            for axis in 0..MAIN_AXES.min(config.bus.drives.into()) {
                let motion = OneAxis::new(&config, axis).expect("room");
                let joints = motion.path.iter().map(|vertex| {
                    let at_mm = vertex.position_um.map(|um| f64::from(um) / 1_000.0);
                    area.check(&Position::from(at_mm)).expect("inside")
                });
                let joints: Vec<_> = joints.collect();
                for other in 0..MAIN_AXES {
                    let angles = joints.iter().map(|joints| joints[other]);
                    let span_rad = angles.clone().fold(f64::MIN, f64::max) - angles.fold(f64::MAX, f64::min);
                    match other == axis {
                        true => assert!(span_rad > 2.0 * OTHERS_RAD, "{axis}: {span_rad}"),
                        false => assert!(span_rad < 1e-4, "{axis}, {other}: {span_rad}"),
                    }
                }
                let lifted_mm = config.paper.pen_down_z_mm + config.paper.pen_lift_mm;
                let heights_mm = motion
                    .path
                    .iter()
                    .map(|vertex| f64::from(vertex.position_um[2]) / 1_000.0);
                assert!(heights_mm.into_iter().all(|z_mm| z_mm >= lifted_mm - 0.001));
                assert!(motion.path.iter().all(|vertex| vertex.pen == Pen::Up));
                assert!(motion.path.windows(2).all(|pair| pair[0] != pair[1]));
                assert_eq!(joints.first(), joints.last());
            }
            let none = OneAxis::new(&config, MAIN_AXES).expect_err("no axis that moves the tool");
            assert_eq!(none, "axis 4 does not move the tool");
        }
    }

    #[test]
    fn the_tool_s_velocity_moves_one_joint_alone() {
        for machine in &MACHINES {
            let config = machine.load().expect("a configuration");
            let kinematics = Kinematics::new(&config.geometry).expect("a robot");
            let mains = MAIN_AXES.min(config.bus.drives.into());
            for axis in 0..mains {
                let start = OneAxis::new(&config, axis).expect("room");
                let mut joints_rad = [0.0; AXES];
                joints_rad[..MAIN_AXES].copy_from_slice(&start.from_rad);
                let velocity_mm_s = alone(&config, &joints_rad, axis).expect("a motion").velocity_mm_s;
                let speed_mm_s = velocity_mm_s.iter().map(|speed| speed * speed).sum::<f64>().sqrt();
                assert!(speed_mm_s > 1.0, "{speed_mm_s}");
                // If the drive of another axis gets the commands, the tool goes no faster.
                let own_mm = length(&lever_mm(&kinematics, &joints_rad, axis).expect("a lever"));
                for other in 0..mains {
                    let lever_mm = length(&lever_mm(&kinematics, &joints_rad, other).expect("a lever"));
                    let (count, others) = (increments_a_rad(&config, axis), increments_a_rad(&config, other));
                    let exchanged_mm_s = speed_mm_s / own_mm * count / others * lever_mm;
                    assert!(
                        exchanged_mm_s <= SPEED_MM_S + 1e-9,
                        "{axis}, {other}: {exchanged_mm_s} mm/s"
                    );
                }
                // A millimetre that way.
                let from = kinematics.forward(&JointAngles(joints_rad)).expect("a pose");
                let share = 1.0 / speed_mm_s;
                let to = Position::from([
                    from.x_mm + share * velocity_mm_s[0],
                    from.y_mm + share * velocity_mm_s[1],
                    from.z_mm + share * velocity_mm_s[2],
                ]);
                let joints = kinematics.inverse(&to).expect("a pose");
                for other in 0..mains {
                    let turned_rad = joints[other] - joints_rad[other];
                    match other == axis {
                        true => assert!(turned_rad > 1e-3, "{axis}: {turned_rad}"),
                        false => assert!(turned_rad.abs() < 3e-5, "{axis}, {other}: {turned_rad}"),
                    }
                }
            }
            assert_eq!(alone(&config, &[0.0; AXES], MAIN_AXES), None);
        }
    }

    #[test]
    fn a_low_ceiling_or_a_quicker_gear_elsewhere_makes_the_motion_smaller_or_refuses_it() {
        let mut config = MACHINES[1].load().expect("a configuration");
        let by_mm = |config: &Config| OneAxis::new(config, 2).map(|motion| motion.by);
        let usual_mm = by_mm(&config).expect("room");
        let speed_mm_s = |config: &Config, axis| {
            let motion = OneAxis::new(config, axis).expect("room");
            motion.slow_config(config).motion.travel_speed_mm_s
        };
        // The height's motor turns four times as often for a millimetre, or its encoder counts four times as much.
        for quicker in [true, false] {
            let mut other = config.clone();
            match quicker {
                true => other.axes[2].gear *= 4.0,
                false => other.axes[2].increments_per_revolution *= 4,
            }
            let slower_mm = by_mm(&other).expect("room");
            assert!(slower_mm < 0.6 * usual_mm, "{slower_mm} of {usual_mm} mm");
            assert!(speed_mm_s(&other, 2) < 0.6 * speed_mm_s(&config, 2));
        }
        config.axes[2].gear *= 0.01;
        let unseen = OneAxis::new(&config, 0).expect_err("no motion that anybody sees");
        assert!(unseen.starts_with("axis 1 has to move so little"), "{unseen}");
        config.axes[2].gear *= 100.0;
        // x may be the height's motor: it has no more room than the height.
        let lifted_mm = config.paper.pen_down_z_mm + config.paper.pen_lift_mm;
        config.work_area.z_high_mm = lifted_mm + 1.0;
        for axis in [0, 2] {
            let refused = OneAxis::new(&config, axis).expect_err("no room");
            assert!(refused.starts_with("axis 3 has no room"), "{refused}");
        }
    }
}
