//! Hard bounds: a table with the lowest and highest value that any configuration may hold.
//!
//! A bound that depends on another value expresses a relation between the two. A refusal names the value by its row.

use super::pen_lift::PEN_BOUNDS;
use super::tool::TOOL_BOUNDS;
use super::{Axis, Bus, Config, Encoder, PenLiftKind, Transport};
use crate::robot_bus::BUS_SLAVES_MAX;
use crate::robots::{AXES, Kind, MAIN_AXES};
use core::f64::consts::TAU;
use etherpen_motion::Settings;
use etherpen_motion::settings::{Bound, Violation, bound, first_violation};
use serde::{Deserialize, Serialize};

/// Identifies a value of the configuration: a row of the table of bounds, and the axis if there is one value for each
/// axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Field {
    /// Row of the table of bounds.
    pub row: u8,
    /// Axis, from 0, for values of [`Axis`].
    pub axis: Option<u8>,
    /// Kind of the configured robot, which names the rows of the dimensions.
    pub kind: Kind,
}

impl Field {
    /// The value's name as used in `etherpen.toml`.
    pub fn name(&self) -> &'static str {
        let config = Config {
            geometry: self.kind.geometry(),
            ..Config::default()
        };
        let scalars = config.scalars();
        let axis = config.axes[0].scalars(0.0, Searched::default(), 0);
        let row = usize::from(self.row);
        match self.axis {
            None => scalars.get(row).map_or("unknown", |bound| bound.name),
            Some(_) => axis.get(row).map_or("unknown", |bound| bound.name),
        }
    }
}

/// A value that was refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConfigError {
    /// The refused value's name.
    pub field: Field,
    /// The refused value.
    pub value: f64,
    /// The lowest value allowed.
    pub low: f64,
    /// The highest value allowed.
    pub high: f64,
}

/// Longest motion without a measurement that any configuration may allow, ms: half a motor turn takes 10 ms.
const BLIND_MAX_MS: f64 = 8.0;

/// Longest time until an axis stands after a quick stop from its highest speed, ms, with that of a drive which hears of it only
/// by its watchdog. The brakes close after `application::STANDSTILL_MAX_MS`, whether the axes are at rest or not.
pub const QUICK_STOP_MAX_MS: u32 = 950;

/// Longest watchdog of the drives, ms; a quick stop has the rest of [`QUICK_STOP_MAX_MS`].
const WATCHDOG_MAX_MS: u16 = 500;

/// Strongest quick stop of any axis, rad/s2.
const QUICK_STOP_HIGHEST_RAD_S2: f64 = 2000.0;

/// Rows of the bus in the table of bounds.
const BUS_BOUNDS: usize = 12;

/// Rows of the values that do not belong to an axis.
const SCALAR_BOUNDS: usize = Settings::BOUNDS + PEN_BOUNDS + TOOL_BOUNDS + BUS_BOUNDS;

/// Rows of an axis in the table of bounds.
const AXIS_BOUNDS: usize = 34;

/// Speeds of an axis in a search.
#[derive(Clone, Copy, Debug, Default)]
struct Searched {
    /// Its highest speed, rad/s; 0 without a switch.
    speed_rad_s: f64,
    /// Highest speed of the search that it may have, rad/s.
    most_rad_s: f64,
}

impl Axis {
    /// Bounds of the identity. An axis that tells its drive by alias, switches or serial number needs one that no other
    /// axis expects: the first of these that is set has no allowed value when `same` expects the same drive.
    fn identity_bounds(&self, same: Option<&Self>) -> [Bound; 6] {
        let same = same.filter(|same| same.identity() == self.identity());
        let mut is_taken = same.is_some();
        let mut own = |name, value: u32, high: u32| {
            let refused = is_taken && value != 0;
            is_taken &= !refused;
            bound(name, value.into(), 0.0, if refused { 0.0 } else { high.into() })
        };
        let [alias, switch, serial] = [
            own("axes.alias", self.alias.into(), u16::MAX.into()),
            own("axes.switch", self.switch.into(), u16::MAX.into()),
            own("axes.serial", self.serial, u32::MAX),
        ];
        let any = |name, value: u32| bound(name, value.into(), 0.0, u32::MAX.into());
        [
            any("axes.vendor", self.vendor),
            any("axes.product", self.product),
            any("axes.revision", self.revision),
            alias,
            switch,
            serial,
        ]
    }

    /// Bound of the encoder's position at the mark: all of a drive's positions, or those of a motor turn.
    fn mark_bound(&self) -> Bound {
        let increments = f64::from(self.sync_increments);
        let (low, high) = match self.encoder {
            Encoder::SingleTurn => (0.0, f64::from(self.increments_per_revolution) - 1.0),
            Encoder::MultiTurn | Encoder::Incremental => (i32::MIN.into(), i32::MAX.into()),
        };
        bound("axes.sync_increments", increments, low, high)
    }

    /// Bounds of homing by a switch; without a switch every number is allowed.
    fn home_bounds(&self, searched: Searched) -> [Bound; 4] {
        let home = &self.home;
        let within = |name, value: f64, low, high| match home.io {
            Some(_) => bound(name, value, low, high),
            None => bound(name, value, f64::MIN, f64::MAX),
        };
        let speed_rad_s = home.speed_rad_s.abs();
        [
            within("axes.home.speed_rad_s", speed_rad_s, 1.0e-3, searched.most_rad_s),
            within("axes.home.latch_rad_s", home.latch_rad_s, 1.0e-4, speed_rad_s),
            within("axes.home.pull_off_rad", home.pull_off_rad, 1.0e-3, home.travel_max_rad),
            within("axes.home.travel_max_rad", home.travel_max_rad, 1.0e-2, 100.0),
        ]
    }

    /// Weakest quick stop that ends within [`QUICK_STOP_MAX_MS`] if it begins with the drives' watchdog, rad/s2, rounded up to
    /// hundredths. The highest speed of the axis is its speed limit, or its speed in a search if that is higher, plus the
    /// correction that the controller adds before the following error becomes a fault, at most the output limit.
    fn quick_stop_min_rad_s2(&self, joint_speed_rad_s: f64, searched: Searched, watchdog_ms: u16) -> f64 {
        let added = self.feedback_gain_per_s * self.following_error_max_rad;
        let fastest = (joint_speed_rad_s.max(searched.speed_rad_s) + added).min(self.output_max_rad_s);
        let time_ms = QUICK_STOP_MAX_MS - u32::from(watchdog_ms.min(WATCHDOG_MAX_MS));
        let needed = fastest * 1_000.0 / f64::from(time_ms);
        libm::ceil(needed * 100.0) / 100.0
    }

    /// Strongest quick stop that any axis may have, or that its drive can be told: object 0x6085 has 32 bits for increments
    /// per second squared at the motor. rad/s2, rounded down to hundredths.
    fn quick_stop_max_rad_s2(&self) -> f64 {
        let increments_per_rad = self.gear.abs() * f64::from(self.increments_per_revolution) / TAU;
        let told = f64::from(u32::MAX) / increments_per_rad;
        libm::floor(told.min(QUICK_STOP_HIGHEST_RAD_S2) * 100.0) / 100.0
    }

    /// Hard bounds of an axis's values.
    fn scalars(&self, joint_speed_rad_s: f64, searched: Searched, watchdog_ms: u16) -> [Bound; AXIS_BOUNDS] {
        let [vendor, product, revision, alias, switch, serial] = self.identity_bounds(None);
        let [home_speed, home_latch, home_pull_off, home_travel] = self.home_bounds(searched);
        [
            vendor,
            product,
            revision,
            alias,
            switch,
            serial,
            bound("axes.gear", self.gear.abs(), 0.1, 1000.0),
            bound(
                "axes.increments_per_revolution",
                f64::from(self.increments_per_revolution),
                256.0,
                16_777_216.0,
            ),
            bound("axes.digits_per_rpm", self.digits_per_rpm, 0.001, 1.0e6),
            bound("axes.sync_angle_rad", self.sync_angle_rad, -6300.0, 6300.0),
            self.mark_bound(),
            bound("axes.feedback_gain_per_s", self.feedback_gain_per_s, 0.0, 500.0),
            bound("axes.feed_forward_gain", self.feed_forward_gain, 0.0, 2.0),
            bound("axes.feed_forward_lead_ms", self.feed_forward_lead_ms, 0.0, 10.0),
            bound("axes.position_lead_ms", self.position_lead_ms, 0.0, 10.0),
            bound("axes.measurement_age_ms", self.measurement_age_ms, 0.0, 10.0),
            bound(
                "axes.following_error_max_rad",
                self.following_error_max_rad,
                1.0e-4,
                1.0,
            ),
            bound(
                "axes.feedback_deviation_max_rad",
                self.feedback_deviation_max_rad,
                1.0e-3,
                0.1,
            ),
            bound(
                "axes.feedback_acceleration_max_rad_s2",
                self.feedback_acceleration_max_rad_s2,
                100.0,
                10_000.0,
            ),
            bound("axes.output_max_rad_s", self.output_max_rad_s, 0.01, 100.0),
            bound(
                "axes.quick_stop_rad_s2",
                self.quick_stop_rad_s2,
                self.quick_stop_min_rad_s2(joint_speed_rad_s, searched, watchdog_ms)
                    .max(1.0),
                self.quick_stop_max_rad_s2(),
            ),
            bound("axes.torque_constant_nm_a", self.torque_constant_nm_a, 0.001, 100.0),
            bound("axes.peak_current_a", self.peak_current_a, 0.01, 1000.0),
            bound("axes.rated_torque_nm", self.rated_torque_nm, 0.001, 1000.0),
            bound("axes.torque_max_nm", self.torque_max_nm, 0.001, 5000.0),
            bound("axes.inertia_kg_m2", self.inertia_kg_m2, 0.0, 100.0),
            bound("axes.torque_lead_ms", self.torque_lead_ms, 0.0, 10.0),
            bound("axes.velocity_gain_nm_s", self.velocity_gain_nm_s, 0.0, 10_000.0),
            bound(
                "axes.velocity_integral_per_s",
                self.velocity_integral_per_s,
                0.0,
                1000.0,
            ),
            bound("axes.velocity_filter_ms", self.velocity_filter_ms, 0.0, 10.0),
            home_speed,
            home_latch,
            home_pull_off,
            home_travel,
        ]
    }
}

impl Config {
    /// Hard bounds of every value that does not belong to an axis. A bound that depends on another value expresses a
    /// relation.
    fn scalars(&self) -> [Bound; SCALAR_BOUNDS] {
        let mut rows = [bound("", 0.0, 0.0, 0.0); SCALAR_BOUNDS];
        let (motion, others) = rows.split_at_mut(Settings::BOUNDS);
        let (pen, others) = others.split_at_mut(PEN_BOUNDS);
        let (tool, bus) = others.split_at_mut(TOOL_BOUNDS);
        motion.copy_from_slice(&self.motion_settings().bounds());
        pen.copy_from_slice(&self.pen.bounds(&self.paper));
        tool.copy_from_slice(&self.tool.bounds());
        bus.copy_from_slice(&self.bus.bounds(self.drives_min()));
        rows
    }

    /// Fewest drives that the machine can have. The fourth axis may be missing; the third may be missing too where it is the
    /// height and does not lift the pen.
    fn drives_min(&self) -> usize {
        let lifts_by_axis = self.pen.kind == PenLiftKind::Axis;
        match self.geometry.kind().has_height_axis() && !lifts_by_axis {
            true => MAIN_AXES - 1,
            false => MAIN_AXES,
        }
    }

    /// Speeds of an axis in a search. Two axes that move together turn with the sum of both speeds if they are led to their
    /// switches at once, and each with both speeds if one behind the other.
    fn searched(&self, axis: usize) -> Searched {
        let Some(values) = self.axes.get(axis) else {
            return Searched::default();
        };
        let speed_of = |axis: &Axis| axis.home.io.map_or(0.0, |_| axis.home.speed_rad_s.abs());
        let own_rad_s = speed_of(values);
        let other = match self.geometry.kind().coupled_axes() {
            coupled if axis >= coupled => None,
            _ => self.axes.get(usize::from(axis == 0)),
        };
        let Some(other) = other else {
            return Searched {
                speed_rad_s: own_rad_s,
                most_rad_s: values.output_max_rad_s.abs(),
            };
        };
        let most_rad_s = values.output_max_rad_s.abs().min(other.output_max_rad_s.abs());
        match values.home.order == other.home.order {
            true => {
                let left_rad_s = most_rad_s - speed_of(other);
                Searched {
                    speed_rad_s: own_rad_s + speed_of(other),
                    // Where nothing is left, the other one is refused.
                    most_rad_s: if left_rad_s > 0.0 { left_rad_s } else { most_rad_s },
                }
            }
            false => Searched {
                speed_rad_s: own_rad_s.max(speed_of(other)),
                most_rad_s,
            },
        }
    }

    /// Checks every value against its hard bounds.
    ///
    /// # Errors
    /// The first value that is not finite or outside its bounds, with the bounds.
    pub fn check(&self) -> Result<(), ConfigError> {
        let kind = self.geometry.kind();
        check_rows(&self.scalars(), None, kind)?;
        for (axis, (values, speed_rad_s)) in (0u8..).zip(self.axes.iter().zip(self.motion.joint_speed_rad_s)) {
            let searched = self.searched(axis.into());
            let rows = values.scalars(speed_rad_s, searched, self.bus.watchdog_ms);
            check_rows(&rows, Some(axis), kind)?;
            for other in self.axes.iter().take(axis.into()) {
                check_rows(&values.identity_bounds(Some(other)), Some(axis), kind)?;
            }
        }
        Ok(())
    }
}

impl Bus {
    /// Hard bounds of the bus's values; `drives_min` is the fewest drives that the machine can have.
    fn bounds(&self, drives_min: usize) -> [Bound; BUS_BOUNDS] {
        let bus = self;
        [
            bound("bus.drives", f64::from(bus.drives), drives_min as f64, AXES as f64),
            bound("bus.slaves", f64::from(bus.slaves), 0.0, BUS_SLAVES_MAX as f64),
            bound("bus.blind_max_ms", f64::from(bus.blind_max_ms), 1.0, BLIND_MAX_MS),
            bound("bus.late_max_per_s", f64::from(bus.late_max_per_s), 0.0, 1_000.0),
            bound("bus.host_silence_ms", f64::from(bus.host_silence_ms), 100.0, 10_000.0),
            bound("bus.dead_man_ms", f64::from(bus.dead_man_ms), 20.0, 500.0),
            bound(
                "bus.segment",
                f64::from(u32::from(bus.segment)),
                // UDP needs a peer; addresses from 224.0.0.0 on do not belong to hosts.
                f64::from(u8::from(bus.transport == Transport::Udp)),
                f64::from(0xDFFF_FFFF_u32),
            ),
            bound("bus.sync_shift_us", f64::from(bus.sync_shift_us), 0.0, 999.0),
            bound(
                "bus.settle_difference_ns",
                f64::from(bus.settle_difference_ns),
                50.0,
                100_000.0,
            ),
            bound("bus.settle_max_ms", f64::from(bus.settle_max_ms), 100.0, 60_000.0),
            bound("bus.clock_error_max_us", f64::from(bus.clock_error_max_us), 10.0, 500.0),
            bound(
                "bus.watchdog_ms",
                f64::from(bus.watchdog_ms),
                f64::from(bus.blind_max_ms) + 1.0,
                f64::from(WATCHDOG_MAX_MS),
            ),
        ]
    }
}

fn check_rows(rows: &[Bound], axis: Option<u8>, kind: Kind) -> Result<(), ConfigError> {
    first_violation(rows).map_err(|Violation { row, bound }| ConfigError {
        field: Field { row, axis, kind },
        value: bound.value,
        low: bound.low,
        high: bound.high,
    })
}
