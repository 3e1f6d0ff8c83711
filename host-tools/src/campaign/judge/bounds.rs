//! The cell of a configuration in the monitor's numbers, and what the drives may add to them.

use super::super::machine::has_height_axis;
use super::super::robot;
use crate::cell::{PEN_SPRING_MM, Product};
use etherpen::config::{Axis, AxisMode, Config, InputShaper, MotionLimits, PenLiftKind, Transport};
use etherpen::robots::MAIN_AXES;
use etherpen_monitor as monitor;

/// How far the tool may be from its setpoint in velocity and in torque mode, mm. Torque keeps 1.0 mm while it draws
/// (`tests/drives.rs`) and 1.2 mm in travel at 1,000 mm/s.
const FOLLOWING_MM: f64 = 0.3;
const FOLLOWING_BY_TORQUE_MM: f64 = 1.3;
/// How far the pen may be beside its line in velocity mode, in addition to the tolerance and to what its acceleration
/// explains, while nothing is disturbed, mm. The most that 50 robot hours have shown was 0.0215 (5 m/s2 without a jerk
/// window, with one telegram for both directions).
const UNDISTURBED_MM: f64 = 0.025;
/// By which part of its speed the tool may exceed it in velocity and in torque mode.
const OVERSHOOT: f64 = 0.05;
const OVERSHOOT_BY_TORQUE: f64 = 0.15;
/// By how much the tool may exceed it in torque mode besides, mm/s: 66 mm/s were seen where 36 were ordered, as a pen
/// left the paper.
const OVERSHOOT_BY_TORQUE_MM_S: f64 = 35.0;
/// How long a joint may creep after a motion in velocity and in torque mode, ms.
const CREEP_MS: u32 = 100;
const CREEP_BY_TORQUE_MS: u32 = 250;
/// Part of the ink that may be missing in torque mode, where the pen's spring does not always reach the paper.
const INK_MISSING_BY_TORQUE: f64 = 0.01;

/// Length of a gap that this leaves in a line, mm.
const INK_MISSING_BY_TORQUE_MM: f64 = 1.0;

/// How far the tool may be astray in torque and position mode while a feedback is not true, mm: a slip need not be noticed
/// there (`docs/faults.md`), so that only the joints' ranges bound it.
const ASTRAY_BY_SLIP_MM: f64 = 600.0;

/// The drive that belongs to an axis.
pub(in super::super) fn product(axis: &Axis) -> Product {
    match axis.mode {
        AxisMode::Velocity | AxisMode::Torque => Product::Ax2000,
        AxisMode::Position => Product::Cia402,
    }
}

fn by_torque(config: &Config) -> bool {
    config.axes.iter().any(|axis| axis.mode == AxisMode::Torque)
}

/// How far the tool may be from its setpoint, mm.
fn following_mm(config: &Config) -> f64 {
    if by_torque(config) {
        FOLLOWING_BY_TORQUE_MM
    } else {
        FOLLOWING_MM
    }
}

/// How far the ink of the test drawing may be from its line, mm. In torque mode the pen may leave the paper for a
/// moment, and the ink ends there.
pub(in super::super) fn ink_limit_mm(config: &Config) -> f64 {
    let missing_mm = if by_torque(config) {
        INK_MISSING_BY_TORQUE_MM
    } else {
        0.0
    };
    config.motion.tolerance_mm + shaper_mm(&config.motion) + following_mm(config) + missing_mm
}

/// Time over which an input shaper spreads each setpoint, ms, with room for the damping that the resonance may have.
fn shaper_ms(motion: &MotionLimits) -> u32 {
    let periods = match motion.input_shaper {
        InputShaper::None => return 0,
        InputShaper::Zv => 0.55,
        InputShaper::Zvd => 2.2,
    };
    (periods * 1e3 / motion.resonance_hz).ceil() as u32 + 2
}

/// How far from its line an input shaper may lead the setpoints of a tool that does not swing, mm: half of the variance of its
/// copies, pi^2 / 8 and pi^2 / 4 over the square of the angular frequency, times the acceleration, and with ZVD what it takes
/// off beforehand. A resonance may be damped, which makes the copies a little farther apart.
fn shaper_mm(motion: &MotionLimits) -> f64 {
    let rate_per_s = core::f64::consts::TAU * motion.resonance_hz;
    let part = match motion.input_shaper {
        InputShaper::None => 0.0,
        InputShaper::Zv => 1.3,
        InputShaper::Zvd => 2.6 + 1.6,
    };
    part * motion.acceleration_mm_s2 / (rate_per_s * rate_per_s)
}

/// Slowest vertical speed of lowering and lifting, mm/s; 0 if only the limits of all motion apply. A lift by an output takes
/// the pen's time, less the part of it that a rounded corner saves.
fn pen_speed_mm_s(config: &Config) -> f64 {
    let (motion, paper, pen) = (&config.motion, &config.paper, &config.pen);
    let slowest_ms = f64::from(pen.down_ms.max(pen.up_ms));
    if !pen.kind.is_output() || slowest_ms == 0.0 {
        return motion.pen_speed_mm_s;
    }
    let lift_mm = (paper.pen_lift_mm - motion.travel_tolerance_mm).max(0.1 * paper.pen_lift_mm);
    let by_pen_mm_s = lift_mm * 1e3 / slowest_ms;
    match motion.pen_speed_mm_s > 0.0 {
        true => by_pen_mm_s.min(motion.pen_speed_mm_s),
        false => by_pen_mm_s,
    }
}

/// Highest speed of an axis that is led to its switch, rad/s; 0 without a switch. Axes that move together are led to both
/// switches at once if they have one order.
fn search_rad_s(config: &Config, axis: usize) -> f64 {
    let coupled = config.geometry.kind().coupled_axes();
    let moving = if axis < coupled { 0..coupled } else { axis..axis + 1 };
    let homes = config.axes[moving].iter().map(|axis| axis.home);
    let searched = homes.filter(|home| home.io.is_some());
    let order = config.axes[axis].home.order;
    let at_once = searched.clone().all(|home| home.order == order);
    let speeds_rad_s = searched.map(|home| home.speed_rad_s.abs().max(home.latch_rad_s.abs()));
    match at_once {
        true => speeds_rad_s.sum(),
        false => speeds_rad_s.fold(0.0, f64::max),
    }
}

/// The configuration in the monitor's numbers.
pub(super) fn cell(config: &Config) -> monitor::Cell {
    let usual = monitor::Cell::default();
    let (motion, paper) = (&config.motion, &config.paper);
    let ranges_rad = robot::ranges_rad(&config.geometry);
    // The height of a machine without an axis for it counts as a joint that stands.
    let axes = usize::from(config.bus.drives).max(MAIN_AXES);
    let joints = config
        .axes
        .iter()
        .take(axes)
        .enumerate()
        .map(|(axis, settings)| monitor::JointLimits {
            range_rad: ranges_rad[axis],
            speed_rad_s: motion.joint_speed_rad_s[axis],
            acceleration_rad_s2: motion.joint_acceleration_rad_s2[axis],
            quick_stop_rad_s2: settings.quick_stop_rad_s2,
            brake_rad_s2: crate::cell::BRAKE_RAD_S2,
            feedback_gain_per_s: settings.feedback_gain_per_s,
            following_error_max_rad: settings.following_error_max_rad,
            output_max_rad_s: settings.output_max_rad_s,
            search_rad_s: search_rad_s(config, axis),
            mark_rad: settings.sync_angle_rad,
            // No turn is mistaken where the encoder knows it.
            turn_rad: match settings.knows_turns() {
                true => f64::INFINITY,
                false => core::f64::consts::TAU / settings.gear.abs(),
            },
        });
    monitor::Cell {
        robot: robot::robot(&config.geometry),
        joints: joints.collect(),
        work_area: monitor::WorkArea {
            centre_mm: [0.0; 2],
            radius_mm: config.work_area.radius_mm,
            inner_radius_mm: config.work_area.inner_radius_mm,
            x_mm: config.work_area.x_mm,
            y_mm: config.work_area.y_mm,
            z_low_mm: config.work_area.z_low_mm,
            z_high_mm: config.work_area.z_high_mm,
        },
        paper: monitor::Paper {
            centre_mm: paper.centre_mm,
            size_mm: paper.size_mm,
            pen_down_z_mm: paper.pen_down_z_mm,
            pen_lift_mm: paper.pen_lift_mm,
            pressing_depth_mm: paper.pressing_depth_mm,
            slope: paper.slope,
            pen_spring_mm: PEN_SPRING_MM,
        },
        has_height_axis: has_height_axis(config),
        always_touches: config.pen.kind == PenLiftKind::None,
        tool_speed_mm_s: motion.speed_mm_s,
        travel_speed_mm_s: motion.travel_speed_mm_s,
        tool_acceleration_mm_s2: motion.acceleration_mm_s2,
        pen_speed_mm_s: pen_speed_mm_s(config),
        pen_acceleration_mm_s2: motion.pen_acceleration_mm_s2,
        pen_dwell_ms: shaper_ms(motion).max(motion.pen_dwell_ms.into()),
        tolerance_mm: motion.tolerance_mm + shaper_mm(motion),
        travel_tolerance_mm: motion.travel_tolerance_mm + shaper_mm(motion),
        shaper_ms: shaper_ms(motion),
        dead_man_ms: config.bus.dead_man_ms.into(),
        blind_ms: config.bus.blind_max_ms.into(),
        watchdog_ms: config.bus.watchdog_ms.into(),
        host_silence_ms: config.bus.host_silence_ms.into(),
        following_mm: following_mm(config),
        undisturbed_mm: match config.axes.iter().all(|axis| axis.mode == AxisMode::Velocity) {
            true => UNDISTURBED_MM,
            false => following_mm(config),
        },
        kept_torque_mm_s2: if by_torque(config) {
            motion.acceleration_mm_s2
        } else {
            0.0
        },
        creep_ms: if by_torque(config) {
            CREEP_BY_TORQUE_MS
        } else {
            CREEP_MS
        },
        overshoot_part: if by_torque(config) {
            OVERSHOOT_BY_TORQUE
        } else {
            OVERSHOOT
        },
        overshoot_mm_s: if by_torque(config) {
            OVERSHOOT_BY_TORQUE_MM_S
        } else {
            usual.overshoot_mm_s
        },
        ink_missing_part: if by_torque(config) { INK_MISSING_BY_TORQUE } else { 0.0 },
        disturbed_mm: if config.axes.iter().any(|axis| axis.mode != AxisMode::Velocity) {
            ASTRAY_BY_SLIP_MM
        } else {
            usual.disturbed_mm
        },
        raw_wire: config.bus.transport == Transport::Raw,
        ..usual
    }
}
