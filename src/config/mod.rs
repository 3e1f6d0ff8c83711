//! Configuration: every number the controller needs, checked against hard bounds before it is used.
//!
//! The host reads the configuration from `etherpen.toml` and sends it when it connects. The firmware checks every
//! value, answers with a hash, refuses to enable without a configuration, and keeps running on it when the host
//! disconnects.

mod axis;
mod bounds;
mod bus;
mod io;
mod pen_lift;
mod terminal;
mod tool;

pub use axis::{Axis, AxisMode, Encoder, HomeSwitch};
pub use bounds::{ConfigError, Field, QUICK_STOP_MAX_MS};
pub use bus::{AddressError, Bus, HostAddress, NetworkSettings, Transport};
pub use etherpen_motion::settings::{Geometry, InputShaper, MotionLimits, Orientation, Paper, Plane, WorkVolume};
pub use io::{
    IO_MAX, IO_NAME_MAX, IoDirection, IoError, IoName, IoPoint, IoPoints, IoRole, IoType, ObjectName, OnFault,
    SAMPLE_WORD_BYTES_MAX, SAMPLE_WORDS_MAX, sampled_words,
};
pub use terminal::{TERMINALS_MAX, Terminal, Terminals};

pub use pen_lift::{PenLift, PenLiftKind};
pub use tool::{Tool, ToolFollows};

use crate::ethercat::clock::Settling;
use crate::ethercat::cyclic::ExchangeKind;
use crate::ethercat::event::WantedValue;
use crate::ethercat::wire::coe::Object;
use crate::hash::fnv1a;
use crate::robot_bus::{PERIOD_NS, RobotBusSetup};
use crate::robots::{AXES, MAIN_AXES};
use etherpen_motion::Settings;
use heapless::Vec;
use serde::{Deserialize, Serialize};

/// The complete configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Shape of the robot.
    pub geometry: Geometry,
    /// Space the robot may use.
    pub work_area: WorkVolume,
    /// Paper and pen.
    pub paper: Paper,
    /// How the pen is lowered and lifted.
    pub pen: PenLift,
    /// The output of a laser or a dispenser.
    pub tool: Tool,
    /// Limits of motion.
    pub motion: MotionLimits,
    /// The axes: the main axes, then the fourth axis.
    pub axes: [Axis; AXES],
    /// The bus.
    pub bus: Bus,
    /// Named inputs and outputs of terminals.
    pub io: IoPoints,
    /// Terminals whose identity is compared.
    pub terminals: Terminals,
}

/// How much later than in the millisecond of its setpoint a command leaves, ms: 1 with one telegram for both directions.
#[must_use]
pub const fn command_delay_ms(exchange: ExchangeKind) -> f64 {
    match exchange {
        ExchangeKind::Split => 0.0,
        ExchangeKind::Combined => 1.0,
    }
}

/// Joint angle at the synchronisation marks of the default configuration, radians: there the platform is in the
/// upper part of the work area. The mark in public descriptions, -0.78191 rad, lies outside the joint range that they
/// give.
const SYNC_ANGLE_RAD: f64 = 0.3;

impl Default for Config {
    /// The IRB 340 with four AX2006 drives.
    fn default() -> Self {
        let main = Axis {
            sync_angle_rad: SYNC_ANGLE_RAD,
            ..Axis::default()
        };
        let fourth = Axis {
            inertia_kg_m2: 0.079,
            velocity_gain_nm_s: 9.5,
            ..Axis::default()
        };
        Self {
            geometry: Geometry::default(),
            work_area: WorkVolume::default(),
            paper: Paper::default(),
            pen: PenLift::default(),
            tool: Tool::default(),
            motion: MotionLimits::default(),
            axes: [main, main, main, fourth],
            bus: Bus::default(),
            io: IoPoints::new(),
            terminals: Terminals::new(),
        }
    }
}

/// Longest encoded configuration, bytes.
pub const CONFIG_BYTES_MAX: usize = 2084;

impl Config {
    /// Settings of motion.
    #[must_use]
    pub fn motion_settings(&self) -> Settings {
        Settings {
            geometry: self.geometry,
            work_area: self.work_area,
            paper: self.paper,
            motion: self.pen.within(&self.motion, &self.paper),
            dead_man_ms: self.bus.dead_man_ms,
            has_separate_pen: self.pen.kind.is_output(),
        }
    }

    /// The axes as the 1 ms loop controls them: with one telegram for both directions a command leaves one cycle later, which
    /// every lead allows for.
    #[must_use]
    pub fn controlled_axes(&self) -> [Axis; AXES] {
        self.axes
            .map(|axis| axis.with_later_commands(command_delay_ms(self.bus.exchange)))
    }

    /// Setup for the bring-up of the bus.
    #[must_use]
    pub fn bus_setup(&self) -> RobotBusSetup {
        RobotBusSetup {
            slaves: self.bus.slaves,
            members: self.bus.drives,
            terminals: self.terminal_places(),
            values: self.wanted_values(),
            identities: self.terminals.iter().map(Terminal::place_identity).collect(),
            chosen: &[],
            settings: self.axes.each_ref().map(Axis::drive),
            exchange: self.bus.exchange,
            cycle_ns: PERIOD_NS,
            watchdog_ms: self.bus.watchdog_ms,
            clocks: self.bus.clocks,
            sync_shift_us: self.bus.sync_shift_us,
            settling: Settling {
                difference_ns: self.bus.settle_difference_ns,
                wait_ms: self.bus.settle_max_ms.into(),
            },
        }
    }

    /// Whether an axis is homed by a switch.
    #[must_use]
    pub fn has_home_switches(&self) -> bool {
        let mut used = self.axes.iter().take(self.bus.drives.into());
        used.any(|axis| axis.home.io.is_some())
    }

    /// Checks the named inputs and outputs, the axes' home switches among them, and the terminals.
    ///
    /// # Errors
    /// The first [`IoError`].
    pub fn check_io(&self) -> Result<(), IoError> {
        io::check(&self.io)?;
        for (io, point) in (0..).zip(&self.io) {
            let is_of_an_axis = point.axis.map(|axis| axis < self.bus.drives);
            let expected = (point.role == IoRole::Limit).then_some(true);
            if is_of_an_axis != expected {
                let axes = self.bus.drives;
                return Err(IoError::LimitAxis { io, axes });
            }
        }
        for (number, axis) in (0..).zip(&self.axes) {
            let is_home = |io: u8| {
                self.io
                    .get(usize::from(io))
                    .is_some_and(|point| point.role == IoRole::Home)
            };
            if axis.home.io.is_some_and(|io| !is_home(io)) {
                return Err(IoError::HomeSwitch { axis: number });
            }
        }
        self.check_searches()?;
        if self.pen.kind.is_output() && !self.geometry.kind().has_height_axis() {
            return Err(IoError::PenWithoutHeight);
        }
        let mut pens = (0..).zip(&self.io).filter(|(_, point)| point.role == IoRole::Pen);
        // All pens get the words of the first.
        let first = self.io.iter().find(|point| point.role == IoRole::Pen);
        let common = first.and_then(|point| self.pen.words(point.kind));
        if let Some((io, _)) = pens.find(|(_, point)| {
            let words = self.pen.words(point.kind);
            words.is_none() || words != common
        }) {
            return Err(IoError::PenPositions { io });
        }
        self.check_tool()?;
        terminal::check(self)
    }

    /// The heights of a pen at an output, down and up, mm, on a machine without an axis of the height: it has no others.
    pub fn pen_heights_mm(&self) -> Option<[f64; 2]> {
        let has_height_axis = usize::from(self.bus.drives) >= MAIN_AXES;
        let (down_mm, lift_mm) = (self.paper.pen_down_z_mm, self.paper.pen_lift_mm);
        (self.pen.kind.is_output() && !has_height_axis).then_some([down_mm, down_mm + lift_mm])
    }

    /// Places at which the home switches open, rad, of the slides that are led to them
    /// ([`Kind::slides`](crate::robots::Kind::slides)).
    #[must_use]
    pub fn switch_places_rad(&self) -> [f64; AXES] {
        let joints = self.axes.each_ref().map(|axis| axis.sync_angle_rad);
        self.geometry.kind().slides(joints)
    }

    /// Checks that each switch tells the place of one axis, and that axes which move together have one each.
    fn check_searches(&self) -> Result<(), IoError> {
        let used = (0_u8..).zip(&self.axes).take(self.bus.drives.into());
        let mut coupled = used.clone().take(self.geometry.kind().coupled_axes());
        let is_searched = |(_, axis): &(u8, &Axis)| axis.home.io.is_some();
        if coupled.clone().any(|axis| is_searched(&axis))
            && let Some((axis, _)) = coupled.find(|axis| !is_searched(axis))
        {
            return Err(IoError::CoupledAxis { axis });
        }
        for (second, axis) in used.clone().filter(is_searched) {
            let mut before = used.clone().take(second.into());
            if let Some((first, _)) = before.find(|(_, other)| other.home.io == axis.home.io) {
                return Err(IoError::SameHomeSwitch { first, second });
            }
        }
        Ok(())
    }

    /// The values of all points, in their order.
    fn wanted_values(&self) -> Vec<WantedValue, IO_MAX> {
        let wanted = |point: &IoPoint| {
            let (direction, bits) = (point.direction.into(), point.kind.bits());
            match (point.object, point.bit) {
                (Some(object), _) => {
                    WantedValue::new(point.slave, direction, Object::new(object.index, object.sub), bits)
                }
                (None, bit) => WantedValue::at_bit(point.slave, direction, bit.unwrap_or(u16::MAX), bits),
            }
        };
        self.io.iter().map(wanted).collect()
    }

    /// Hash of the configuration's postcard encoding: FNV-1a, 64 bits.
    ///
    /// `None` when the encoding is longer than [`CONFIG_BYTES_MAX`].
    pub fn hash(&self) -> Option<u64> {
        let mut buffer = [0u8; CONFIG_BYTES_MAX];
        let bytes = postcard::to_slice(self, &mut buffer).ok()?;
        Some(fnv1a(bytes.iter().copied()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot_bus::BUS_SLAVES_MAX;
    use crate::robots::{Kind, ScaraGeometry};
    use core::net::Ipv4Addr;

    #[test]
    fn the_default_configuration_is_within_its_bounds_and_fits_a_message() {
        let config = Config::default();
        assert_eq!(config.check(), Ok(()));
        assert!(config.hash().is_some());
    }

    #[test]
    fn a_value_out_of_bounds_is_named_with_its_bounds() {
        let mut config = Config::default();
        config.axes[2].feedback_gain_per_s = 501.0;
        let error = config.check().unwrap_err();
        assert_eq!(
            (error.field.name(), error.field.axis),
            ("axes.feedback_gain_per_s", Some(2))
        );
        assert_eq!((error.value, error.high), (501.0, 500.0));
    }

    #[test]
    fn a_quick_stop_that_does_not_end_before_the_brakes_close_is_refused_with_the_value_needed() {
        let mut config = Config::default();
        config.axes[1].quick_stop_rad_s2 = 1.0;
        let error = config.check().unwrap_err();
        assert_eq!(
            (error.field.name(), error.field.axis),
            ("axes.quick_stop_rad_s2", Some(1))
        );
        // The output limit's 27 rad/s in 0.95 s less the watchdog's 10 ms.
        assert!(error.low >= 27.0 / 0.94 && error.low < 29.0, "{error:?}");
        config.axes[1].quick_stop_rad_s2 = error.low;
        assert_eq!(config.check(), Ok(()), "the value that it names is enough");
        // A slow axis needs less: its own speed, and what its controller adds before the following error is a fault.
        config.motion.joint_speed_rad_s[1] = 0.5;
        config.axes[1].quick_stop_rad_s2 = 1.0;
        let error = config.check().unwrap_err();
        assert!((error.low - 4.5 / 0.94).abs() < 0.01, "{error:?}");
        config.axes[1].following_error_max_rad = 0.001;
        config.axes[1].feedback_gain_per_s = 10.0;
        assert_eq!(config.check(), Ok(()));
        // However slow the axis is.
        config.axes[1].quick_stop_rad_s2 = 0.99;
        assert_eq!(config.check().unwrap_err().low, 1.0);
    }

    #[test]
    fn a_quick_stop_that_no_drive_can_be_told_is_refused_with_the_strongest_one() {
        let mut config = Config::default();
        (config.axes[2].gear, config.axes[2].increments_per_revolution) = (-18.658_079, 1 << 24);
        let error = config.check().unwrap_err();
        assert_eq!(
            (error.field.name(), error.field.axis),
            ("axes.quick_stop_rad_s2", Some(2))
        );
        let told = |config: &Config| crate::drives::quick_stop_increments_s2(&config.axes[2].drive());
        assert_eq!(told(&config), None);
        config.axes[2].quick_stop_rad_s2 = error.high;
        assert_eq!(config.check(), Ok(()), "the value that it names is enough");
        assert!(told(&config).is_some_and(|increments_s2| increments_s2 > 4_290_000_000));
    }

    #[test]
    fn with_one_telegram_for_both_directions_every_lead_is_a_millisecond_longer_than_configured() {
        let mut config = Config::default();
        let leads = |axis: &Axis| [axis.feed_forward_lead_ms, axis.position_lead_ms, axis.torque_lead_ms];
        config.bus.exchange = ExchangeKind::Split;
        assert_eq!(
            config.controlled_axes().each_ref().map(leads),
            config.axes.each_ref().map(leads)
        );
        config.bus.exchange = ExchangeKind::Combined;
        for (controlled, configured) in config.controlled_axes().iter().zip(&config.axes) {
            assert_eq!(leads(controlled), leads(configured).map(|lead_ms| lead_ms + 1.0));
            assert_eq!(controlled.measurement_age_ms, configured.measurement_age_ms);
        }
    }

    #[test]
    fn two_outputs_that_lower_the_pen_get_the_same_word_or_are_refused() {
        let pen = |name: &str, slave, kind| IoPoint {
            name: IoName::try_from(name).expect("a short name"),
            slave,
            direction: IoDirection::Out,
            bit: Some(0),
            kind,
            role: IoRole::Pen,
            ..IoPoint::default()
        };
        let check = |second| {
            let mut config = Config {
                geometry: Geometry::Scara(ScaraGeometry::default()),
                ..Config::default()
            };
            config.pen = PenLift {
                kind: PenLiftKind::Servo,
                down: -5,
                up: 7,
                ..PenLift::default()
            };
            config.io.push(pen("pen", 4, IoType::I16)).expect("room");
            config.io.push(pen("second", 5, second)).expect("room");
            config.check_io()
        };
        assert_eq!(check(IoType::I16), Ok(()));
        // The sign of a longer word fills more of it.
        assert_eq!(check(IoType::I32), Err(IoError::PenPositions { io: 1 }));
    }

    #[test]
    fn the_longest_identities_fit_a_message_and_two_axes_never_expect_the_same_drive() {
        let mut config = Config::default();
        for (number, axis) in (0_u32..).zip(&mut config.axes) {
            (axis.vendor, axis.product, axis.revision) = (u32::MAX, u32::MAX, u32::MAX);
            (axis.alias, axis.switch, axis.serial) = (u16::MAX, u16::MAX, u32::MAX - number);
        }
        assert_eq!(config.check(), Ok(()));
        assert!(config.hash().is_some());
        config.axes[3].serial = config.axes[1].serial;
        let error = config.check().unwrap_err();
        assert_eq!((error.field.name(), error.field.axis), ("axes.alias", Some(3)));
        (config.axes[1].alias, config.axes[3].alias) = (0, 0);
        (config.axes[1].switch, config.axes[3].switch) = (0, 0);
        let error = config.check().unwrap_err();
        assert_eq!((error.field.name(), error.field.axis), ("axes.serial", Some(3)));
        assert_eq!((error.low, error.high), (0.0, 0.0));
        (config.axes[1].serial, config.axes[3].serial) = (0, 0);
        assert_eq!(config.check(), Ok(()), "a product alone does not tell two drives apart");
    }

    #[test]
    fn values_that_are_not_numbers_are_refused_wherever_they_stand() {
        let mut config = Config::default();
        config.motion.joint_speed_rad_s[3] = f64::NAN;
        assert_eq!(config.check().unwrap_err().field.name(), "motion.joint_speed_rad_s");
        let mut config = Config::default();
        config.work_area.z_low_mm = f64::NAN;
        assert!(config.check().is_err());
    }

    #[test]
    fn each_switch_tells_the_place_of_one_axis_that_moves_alone_and_only_a_height_is_lowered_by_an_output() {
        let mut config = Config {
            geometry: Kind::Gantry.geometry(),
            ..Config::default()
        };
        for number in 0..2_u8 {
            let point = IoPoint {
                name: if number == 0 { "x_home" } else { "y_home" }.try_into().unwrap(),
                slave: 1,
                bit: Some(number.into()),
                role: IoRole::Home,
                ..IoPoint::default()
            };
            assert_eq!(config.io.push(point), Ok(()));
            config.axes[usize::from(number)].home.io = Some(number);
        }
        assert_eq!(config.check_io(), Ok(()));
        config.axes[1].home.io = Some(0);
        assert_eq!(config.check_io(), Err(IoError::SameHomeSwitch { first: 0, second: 1 }));
        config.axes[1].home.io = Some(1);
        config.geometry = Kind::CoreXy.geometry();
        assert_eq!(config.check_io(), Ok(()));
        config.axes[0].home.io = None;
        assert_eq!(config.check_io(), Err(IoError::CoupledAxis { axis: 0 }));
        config.axes.iter_mut().for_each(|axis| axis.home.io = None);
        for kind in [PenLiftKind::Output, PenLiftKind::Servo] {
            config.pen.kind = kind;
            assert_eq!(config.check_io(), Ok(()));
        }
        for kind in [Kind::Delta, Kind::LinearDelta] {
            config.geometry = kind.geometry();
            assert_eq!(config.check_io(), Err(IoError::PenWithoutHeight));
        }
    }

    #[test]
    fn the_quick_stop_is_as_strong_as_the_search_needs() {
        let mut config = Config::default();
        config.axes[0].home.io = Some(0);
        config.axes[0].home.speed_rad_s = -20.0;
        config.motion.joint_speed_rad_s[0] = 1.0;
        config.axes[0].feedback_gain_per_s = 0.0;
        config.axes[0].quick_stop_rad_s2 = 20.0;
        let error = config.check().unwrap_err();
        assert_eq!(error.field.name(), "axes.quick_stop_rad_s2");
        assert!((error.low - 20.0 / 0.94).abs() < 0.02, "{error:?}");
    }

    #[test]
    fn the_watchdog_is_longer_than_the_blind_limit_and_leaves_time_for_the_quick_stop_behind_it() {
        let mut config = Config::default();
        config.bus.watchdog_ms = config.bus.blind_max_ms;
        assert_eq!(config.check().unwrap_err().field.name(), "bus.watchdog_ms");
        config.bus.watchdog_ms = 501;
        assert_eq!(config.check().unwrap_err().field.name(), "bus.watchdog_ms");
        config.bus.watchdog_ms = 500;
        config.axes[1].quick_stop_rad_s2 = 1.0;
        let error = config.check().unwrap_err();
        assert!(error.low >= 27.0 / 0.45 && error.low < 27.0 / 0.45 + 0.02, "{error:?}");
        config.axes[1].quick_stop_rad_s2 = error.low;
        assert_eq!(config.check(), Ok(()), "the value that it names is enough");
    }

    #[test]
    fn udp_needs_a_segment_to_talk_to() {
        let mut config = Config::default();
        config.bus.transport = Transport::Udp;
        assert_eq!(config.check().unwrap_err().field.name(), "bus.segment");
        config.bus.segment = Ipv4Addr::new(10, 0, 2, 2);
        assert_eq!(config.check(), Ok(()));
        assert!(config.hash().is_some());
    }

    #[test]
    fn a_configuration_with_as_many_points_and_terminals_as_possible_fits_a_message() {
        let mut config = Config::default();
        for number in 0..TERMINALS_MAX as u8 {
            let terminal = Terminal {
                slave: BUS_SLAVES_MAX as u8 - 1 - number,
                alias: u16::MAX - 4 - u16::from(number),
                switch: u16::MAX,
                serial: u32::MAX,
                vendor: u32::MAX,
                product: u32::MAX,
                revision: u32::MAX,
            };
            assert_eq!(config.terminals.push(terminal), Ok(()));
        }
        for (number, axis) in (0_u16..).zip(&mut config.axes) {
            (axis.vendor, axis.product, axis.revision) = (u32::MAX, u32::MAX, u32::MAX);
            (axis.alias, axis.switch, axis.serial) = (u16::MAX - number, u16::MAX, u32::MAX);
        }
        config.pen = PenLift {
            kind: PenLiftKind::Axis,
            down_ms: 1_000,
            up_ms: 1_000,
            down: u16::MAX.into(),
            up: -i32::from(u16::MAX),
        };
        config.tool = Tool {
            follows: ToolFollows::Distance,
            nominal_mm_s: 10_000.0,
            minimum: u16::MAX,
            maximum: u16::MAX,
            pitch_um: u16::MAX,
            lead_ms: 8,
            off_at_hold: true,
        };
        config.bus.settle_difference_ns = 100_000;
        config.bus.host_silence_ms = 10_000;
        while config.bus.name.push('n').is_ok() {}
        for number in 0..IO_MAX {
            let mut name = IoName::new();
            while name.push(char::from(b'a' + number as u8)).is_ok() {}
            let point = IoPoint {
                name,
                slave: 15,
                direction: IoDirection::In,
                bit: None,
                object: Some(ObjectName {
                    index: u16::MAX,
                    sub: u8::MAX,
                }),
                kind: IoType::Bool,
                role: IoRole::Limit,
                axis: Some(3),
                on_fault: OnFault::Hold,
            };
            assert_eq!(config.io.push(point), Ok(()));
        }
        if let Some(point) = config.io.last_mut() {
            (point.direction, point.kind, point.role) = (IoDirection::Out, IoType::U16, IoRole::Tool);
            (point.axis, point.on_fault) = (None, OnFault::Off);
        }
        for axis in &mut config.axes {
            axis.increments_per_revolution = 16_777_216;
            (axis.encoder, axis.sync_increments) = (Encoder::MultiTurn, i32::MIN);
        }
        config.bus.segment = Ipv4Addr::new(223, 255, 255, 255);
        assert_eq!((config.check(), config.check_io()), (Ok(()), Ok(())));
        let mut buffer = [0; 4096];
        for kind in Kind::ALL {
            config.geometry = kind.geometry();
            let bytes = postcard::to_slice(&config, &mut buffer).unwrap().len();
            std::println!("{kind:?}: {bytes} of {CONFIG_BYTES_MAX} bytes");
            assert!(config.hash().is_some(), "{kind:?}: {bytes} bytes");
        }
        assert!(config.io.push(IoPoint::default()).is_err());
        assert!(config.terminals.push(Terminal::default()).is_err());
    }

    #[test]
    fn a_message_carries_the_dimensions_of_every_kind() {
        for kind in Kind::ALL {
            let mut config = Config {
                geometry: kind.geometry(),
                ..Config::default()
            };
            config.work_area = config.geometry.work_volume();
            let mut buffer = [0; CONFIG_BYTES_MAX];
            let bytes = postcard::to_slice(&config, &mut buffer).unwrap();
            assert_eq!(postcard::from_bytes::<Config>(bytes), Ok(config), "{kind:?}");
        }
        let mut buffer = [0xFF; 128];
        postcard::to_slice(&Kind::Delta.geometry(), &mut buffer).unwrap();
        assert_eq!(buffer[0], 0, "the number of the first kind");
    }

    #[test]
    fn a_slope_at_its_bounds_stays_within_them_in_a_message() {
        let mut config = Config::default();
        config.paper.slope = [0.0071, -Paper::SLOPE_MAX];
        let mut buffer = [0; CONFIG_BYTES_MAX];
        let bytes = postcard::to_slice(&config, &mut buffer).unwrap();
        let received: Config = postcard::from_bytes(bytes).unwrap();
        assert_eq!((received.check(), received.hash()), (Ok(()), config.hash()));
        assert!((received.paper.slope[0] - 0.0071).abs() < 1.0e-9);
        config.pen.kind = PenLiftKind::Output;
        assert_eq!(config.check().unwrap_err().field.name(), "paper.slope[0]");
    }

    #[test]
    fn a_bound_of_another_kind_is_named_as_that_kind_names_it() {
        let mut config = Config {
            geometry: Geometry::Scara(ScaraGeometry {
                outer_link_mm: 5.0,
                ..ScaraGeometry::default()
            }),
            ..Config::default()
        };
        let error = config.check().unwrap_err();
        assert_eq!((error.field.name(), error.low), ("geometry.outer_link_mm", 10.0));
        config.geometry = Kind::Gantry.geometry();
        config.work_area = config.geometry.work_volume();
        config.work_area.z_low_mm = -100.0;
        let error = config.check().unwrap_err();
        assert_eq!((error.field.name(), error.low), ("work_area.z_low_mm", -60.0));
    }

    #[test]
    fn any_changed_value_changes_the_hash() {
        let mut config = Config::default();
        let before = config.hash();
        config.axes[3].gear = 12.000001;
        assert_ne!(config.hash(), before);
        let before = config.hash();
        config.io.push(IoPoint::default()).unwrap();
        assert_ne!(config.hash(), before);
        let before = config.hash();
        config.io[0].role = IoRole::Door;
        assert_ne!(config.hash(), before);
    }
}
