//! Configuration: every number the controller needs, checked against hard bounds before it is used.
//!
//! The host reads it from `etherpen.toml` and sends it at connect; the firmware checks every value, answers with a
//! hash, refuses to enable without one, and keeps running on it when the host goes.

use crate::ethercat::cyclic::ExchangeKind;
use crate::network::NetworkSettings;
use crate::robot::AXES;
use core::fmt::{self, Write};
use core::net::Ipv4Addr;
use heapless::String;
use serde::{Deserialize, Serialize};

/// Geometry of a delta robot with three equal arms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Geometry {
    /// Centre of the base to the shoulder axes, mm.
    pub base_radius_mm: f64,
    /// Length of an upper arm, mm.
    pub upper_arm_mm: f64,
    /// Length of a forearm, mm.
    pub forearm_mm: f64,
    /// Centre of the platform to the forearms' joints, mm.
    pub platform_radius_mm: f64,
    /// Azimuths of the arms, degrees.
    pub arm_azimuths_deg: [f64; 3],
    /// Lowest and highest angle of an arm, radians.
    pub arm_range_rad: [f64; 2],
    /// Margin kept from both ends of the arm range, radians.
    pub arm_margin_rad: f64,
}

impl Default for Geometry {
    /// The IRB 340 (design notes, motion, section 3).
    fn default() -> Self {
        Self {
            base_radius_mm: 200.0,
            upper_arm_mm: 350.0,
            forearm_mm: 800.0,
            platform_radius_mm: 45.0,
            arm_azimuths_deg: [0.0, 120.0, 240.0],
            arm_range_rad: [-0.7034, 1.7453],
            arm_margin_rad: 0.01745,
        }
    }
}

/// The space the platform may use: an upright cylinder around the robot's axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorkArea {
    /// Radius of the cylinder, mm.
    pub radius_mm: f64,
    /// Lowest z, mm.
    pub z_low_mm: f64,
    /// Highest z, mm.
    pub z_high_mm: f64,
}

impl Default for WorkArea {
    fn default() -> Self {
        Self {
            radius_mm: 565.0,
            z_low_mm: -960.0,
            z_high_mm: -700.0,
        }
    }
}

/// Where the paper lies and how the pen meets it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Paper {
    /// The sheet's centre in the robot's frame, mm.
    pub centre_mm: [f64; 2],
    /// Width and height of the sheet, mm.
    pub size_mm: [f64; 2],
    /// The platform's z when the pen draws, mm.
    pub pen_down_z_mm: f64,
    /// How far the pen is lifted between strokes, mm.
    pub pen_lift_mm: f64,
}

impl Default for Paper {
    fn default() -> Self {
        Self {
            centre_mm: [0.0, 0.0],
            size_mm: [200.0, 200.0],
            pen_down_z_mm: -850.0,
            pen_lift_mm: 3.0,
        }
    }
}

/// Limits and tolerances of motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Motion {
    /// Path speed with the pen down, mm/s.
    pub speed_mm_s: f64,
    /// Path speed with the pen up, mm/s.
    pub travel_speed_mm_s: f64,
    /// Cartesian acceleration, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Joint speed, rad/s, per axis.
    pub joint_speed_rad_s: [f64; AXES],
    /// Joint acceleration, rad/s2, per axis.
    pub joint_acceleration_rad_s2: [f64; AXES],
    /// Deviation of the reference from the polyline with the pen down, mm.
    pub tolerance_mm: f64,
    /// The same with the pen up, mm.
    pub travel_tolerance_mm: f64,
    /// Length of the moving average that bounds jerk, ms; 0 switches it off.
    pub jerk_window_ms: u16,
    /// Time at rest on the path before the pen is lifted when path data stop coming, ms.
    pub starve_dwell_ms: u16,
}

impl Default for Motion {
    fn default() -> Self {
        Self {
            speed_mm_s: 400.0,
            travel_speed_mm_s: 1000.0,
            acceleration_mm_s2: 10_000.0,
            joint_speed_rad_s: [25.0; AXES],
            joint_acceleration_rad_s2: [250.0; AXES],
            tolerance_mm: 0.05,
            travel_tolerance_mm: 0.5,
            jerk_window_ms: 4,
            starve_dwell_ms: 500,
        }
    }
}

/// How an axis is commanded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AxisMode {
    /// The drive closes the velocity loop.
    #[default]
    Velocity,
    /// The firmware closes the velocity loop, the drive follows a torque.
    Torque,
}

/// One axis: its drive's scaling, its reference, its controllers and its supervision.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Axis {
    /// What the drive is told: a velocity or a torque.
    pub mode: AxisMode,
    /// Motor revolutions for one revolution of the joint; negative where the motor turns the other way.
    pub gear: f64,
    /// Encoder increments for one motor revolution.
    pub increments_per_revolution: u32,
    /// Velocity command digits for one motor revolution per minute.
    pub digits_per_rpm: f64,
    /// Joint angle at the synchronisation mark, radians.
    pub sync_angle_rad: f64,
    /// What the single-turn resolver shows at the synchronisation mark, increments.
    pub sync_increments: u32,
    /// Feedback gain Kfb, 1/s.
    pub feedback_gain_per_s: f64,
    /// Feed-forward gain Kff.
    pub feed_forward_gain: f64,
    /// How far the velocity feed-forward is read ahead, ms.
    pub feed_forward_lead_ms: f64,
    /// Age of the measured position when the controller sees it, ms.
    pub measurement_age_ms: f64,
    /// Following error that ends in a fault, radians.
    pub following_error_max_rad: f64,
    /// Largest velocity command, rad/s at the joint.
    pub output_max_rad_s: f64,
    /// Quick-stop deceleration at the joint, rad/s2.
    pub quick_stop_rad_s2: f64,
    /// Torque of the motor for a current, N m/A.
    pub torque_constant_nm_a: f64,
    /// Peak current of the drive, A.
    pub peak_current_a: f64,
    /// Rated torque of the motor, N m.
    pub rated_torque_nm: f64,
    /// Largest torque command, N m at the joint.
    pub torque_max_nm: f64,
    /// Inertia of motor and load, kg m2 at the joint; what the torque feed-forward is made from.
    pub inertia_kg_m2: f64,
    /// How far the torque feed-forward is read ahead, ms.
    pub torque_lead_ms: f64,
    /// Gain of the velocity controller in torque mode, N m for 1 rad/s at the joint.
    pub velocity_gain_nm_s: f64,
    /// Integral gain of the velocity controller for its gain, 1/s.
    pub velocity_integral_per_s: f64,
    /// Time constant of the low-pass on the velocity controller's error, ms; 0 switches it off.
    pub velocity_filter_ms: f64,
}

impl Default for Axis {
    fn default() -> Self {
        Self {
            mode: AxisMode::Velocity,
            gear: 12.0,
            increments_per_revolution: 1 << 20,
            digits_per_rpm: 262_144.0 / 1_875.0,
            sync_angle_rad: 0.0,
            sync_increments: 0,
            feedback_gain_per_s: 80.0,
            feed_forward_gain: 1.0,
            feed_forward_lead_ms: 3.1,
            measurement_age_ms: 1.0,
            following_error_max_rad: 0.05,
            output_max_rad_s: 27.0,
            quick_stop_rad_s2: 100.0,
            torque_constant_nm_a: 0.7,
            peak_current_a: 12.0,
            rated_torque_nm: 2.8,
            torque_max_nm: 100.0,
            inertia_kg_m2: 0.3,
            torque_lead_ms: 1.5,
            velocity_gain_nm_s: 36.0,
            velocity_integral_per_s: 40.0,
            velocity_filter_ms: 0.25,
        }
    }
}

/// How EtherCAT travels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transport {
    /// In Ethernet frames of its own type.
    #[default]
    Raw,
    /// In UDP.
    Udp,
}

/// Longest text of a [`HostAddress`], bytes.
const ADDRESS_TEXT_MAX: usize = 18;

/// The controller's own IPv4 address: `dhcp`, or `a.b.c.d/len`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String<ADDRESS_TEXT_MAX>", into = "String<ADDRESS_TEXT_MAX>")]
pub enum HostAddress {
    /// A server gives it.
    #[default]
    Dhcp,
    /// It is this one.
    Fixed {
        /// The address.
        address: Ipv4Addr,
        /// Bits of the network's part, 1 to 30.
        prefix: u8,
    },
}

/// A text that is no [`HostAddress`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AddressError;

impl fmt::Display for AddressError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "expected \"dhcp\" or an address with the length of its network's part from 1 to 30, \"192.168.1.2/24\"",
        )
    }
}

impl TryFrom<String<ADDRESS_TEXT_MAX>> for HostAddress {
    type Error = AddressError;

    fn try_from(text: String<ADDRESS_TEXT_MAX>) -> Result<Self, AddressError> {
        if text == "dhcp" {
            return Ok(Self::Dhcp);
        }
        let (address, prefix) = text.split_once('/').ok_or(AddressError)?;
        let address = address.parse().map_err(|_| AddressError)?;
        let prefix = prefix.parse().map_err(|_| AddressError)?;
        match prefix {
            1..=30 => Ok(Self::Fixed { address, prefix }),
            _ => Err(AddressError),
        }
    }
}

impl From<HostAddress> for String<ADDRESS_TEXT_MAX> {
    fn from(address: HostAddress) -> Self {
        let mut text = Self::new();
        // The longest address has as many bytes as there is room for.
        let _ = match address {
            HostAddress::Dhcp => text.write_str("dhcp"),
            HostAddress::Fixed { address, prefix } => write!(text, "{address}/{prefix}"),
        };
        text
    }
}

/// The bus: what is expected on it and how patient the master is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bus {
    /// Number of drives expected, in chain order, one for each axis.
    pub drives: u8,
    /// Inputs and outputs apart, in the same cycle, or together, outputs one cycle later.
    pub exchange: ExchangeKind,
    /// Sync manager watchdog of the drives, ms; longer than `blind_max_ms`.
    pub watchdog_ms: u16,
    /// Longest motion without a valid measurement, ms.
    pub blind_max_ms: u16,
    /// Late cycles within a second that make a fault.
    pub late_max_per_s: u16,
    /// Silence of the host while drawing that leads to Holding, ms.
    pub host_silence_ms: u16,
    /// Longest pause between dead-man messages of a jog, ms.
    pub dead_man_ms: u16,
    /// Whether the slaves' distributed clocks are set up and the sample's timer follows them.
    pub clocks: bool,
    /// When SYNC0 of drives that use it comes after the frame of the input telegram has passed the reference clock, us.
    pub sync_shift_us: u16,
    /// Phase error of the sample against the bus clock that ends in a fault, us.
    pub clock_error_max_us: u16,
    /// How EtherCAT travels.
    pub transport: Transport,
    /// The own address, for UDP.
    pub address: HostAddress,
    /// Where packets for other networks go with an address that no server gave; 0.0.0.0 for nowhere.
    pub gateway: Ipv4Addr,
    /// The segment's address, for UDP; 0.0.0.0 for none.
    pub segment: Ipv4Addr,
    /// Name of the robot, for messages.
    pub name: String<24>,
}

impl Bus {
    /// What the IP stack is to do; `None` when the bus needs none.
    pub fn network(&self) -> Option<NetworkSettings> {
        (self.transport == Transport::Udp).then_some(NetworkSettings {
            address: self.address,
            gateway: (!self.gateway.is_unspecified()).then_some(self.gateway),
            segment: self.segment,
        })
    }
}

impl Default for Bus {
    fn default() -> Self {
        let mut name = String::new();
        // The literal is shorter than the capacity.
        let _ = name.push_str("IRB 340");
        Self {
            drives: AXES as u8,
            exchange: ExchangeKind::Split,
            watchdog_ms: 10,
            blind_max_ms: 5,
            late_max_per_s: 10,
            host_silence_ms: 500,
            dead_man_ms: 100,
            // Drives that ignore SYNC0 keep a time of their own: following the clock of one of them gains nothing.
            clocks: false,
            sync_shift_us: 500,
            clock_error_max_us: 50,
            transport: Transport::Raw,
            address: HostAddress::Dhcp,
            gateway: Ipv4Addr::UNSPECIFIED,
            segment: Ipv4Addr::UNSPECIFIED,
            name,
        }
    }
}

/// The whole configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Shape of the robot.
    pub geometry: Geometry,
    /// Space the robot may use.
    pub work_area: WorkArea,
    /// Paper and pen.
    pub paper: Paper,
    /// Limits of motion.
    pub motion: Motion,
    /// The axes: three arms, then the fourth axis.
    pub axes: [Axis; AXES],
    /// The bus.
    pub bus: Bus,
}

/// Arm angle at the synchronisation marks of the default configuration, radians: the platform hangs in the work area's
/// upper part. The mark that public descriptions give, -0.78191 rad, lies outside the arm range they give.
const ARM_SYNC_ANGLE_RAD: f64 = 0.3;

impl Default for Config {
    /// The IRB 340 with four AX2006 drives.
    fn default() -> Self {
        let arm = Axis {
            sync_angle_rad: ARM_SYNC_ANGLE_RAD,
            ..Axis::default()
        };
        let fourth = Axis {
            inertia_kg_m2: 0.079,
            velocity_gain_nm_s: 9.5,
            ..Axis::default()
        };
        Self {
            geometry: Geometry::default(),
            work_area: WorkArea::default(),
            paper: Paper::default(),
            motion: Motion::default(),
            axes: [arm, arm, arm, fourth],
            bus: Bus::default(),
        }
    }
}

/// Longest encoded configuration, bytes.
pub const CONFIG_BYTES_MAX: usize = 1024;

/// Names a value of the configuration: an index into the table of bounds, and the axis where there are several.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Field {
    /// Row of the table of bounds.
    pub row: u8,
    /// Which axis, from 0, for values of [`Axis`].
    pub axis: Option<u8>,
}

impl Field {
    /// The value's name as it stands in `etherpen.toml`.
    pub fn name(&self) -> &'static str {
        let config = Config::default();
        let scalars = config.scalars();
        let axis = config.axes[0].scalars();
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
    /// Which value.
    pub field: Field,
    /// What it is.
    pub value: f64,
    /// The lowest value allowed.
    pub low: f64,
    /// The highest value allowed.
    pub high: f64,
}

/// Longest motion without a measurement that any configuration may allow, ms: half a motor turn takes 10 ms.
const BLIND_MAX_MS: f64 = 8.0;

struct Bound {
    name: &'static str,
    value: f64,
    low: f64,
    high: f64,
}

const fn bound(name: &'static str, value: f64, low: f64, high: f64) -> Bound {
    Bound { name, value, low, high }
}

impl Axis {
    fn scalars(&self) -> [Bound; 21] {
        [
            bound("axes.gear", self.gear.abs(), 0.1, 1000.0),
            bound(
                "axes.increments_per_revolution",
                f64::from(self.increments_per_revolution),
                256.0,
                16_777_216.0,
            ),
            bound("axes.digits_per_rpm", self.digits_per_rpm, 0.001, 1.0e6),
            bound("axes.sync_angle_rad", self.sync_angle_rad, -6300.0, 6300.0),
            bound(
                "axes.sync_increments",
                f64::from(self.sync_increments),
                0.0,
                f64::from(self.increments_per_revolution) - 1.0,
            ),
            bound("axes.feedback_gain_per_s", self.feedback_gain_per_s, 0.0, 500.0),
            bound("axes.feed_forward_gain", self.feed_forward_gain, 0.0, 2.0),
            bound("axes.feed_forward_lead_ms", self.feed_forward_lead_ms, 0.0, 10.0),
            bound("axes.measurement_age_ms", self.measurement_age_ms, 0.0, 10.0),
            bound(
                "axes.following_error_max_rad",
                self.following_error_max_rad,
                1.0e-4,
                1.0,
            ),
            bound("axes.output_max_rad_s", self.output_max_rad_s, 0.01, 100.0),
            bound("axes.quick_stop_rad_s2", self.quick_stop_rad_s2, 1.0, 2000.0),
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
        ]
    }
}

impl Config {
    /// Every value but the axes' with its hard bounds. Bounds that depend on another value state a relation.
    fn scalars(&self) -> [Bound; 39] {
        let (geometry, area, paper, motion, bus) =
            (&self.geometry, &self.work_area, &self.paper, &self.motion, &self.bus);
        let reach = geometry.upper_arm_mm + geometry.forearm_mm;
        [
            bound("geometry.base_radius_mm", geometry.base_radius_mm, 10.0, 2000.0),
            bound("geometry.upper_arm_mm", geometry.upper_arm_mm, 10.0, 2000.0),
            bound(
                "geometry.forearm_mm",
                geometry.forearm_mm,
                geometry.upper_arm_mm,
                4000.0,
            ),
            bound(
                "geometry.platform_radius_mm",
                geometry.platform_radius_mm,
                0.0,
                geometry.base_radius_mm,
            ),
            bound(
                "geometry.arm_azimuths_deg[0]",
                geometry.arm_azimuths_deg[0],
                -360.0,
                360.0,
            ),
            bound(
                "geometry.arm_azimuths_deg[1]",
                geometry.arm_azimuths_deg[1],
                -360.0,
                360.0,
            ),
            bound(
                "geometry.arm_azimuths_deg[2]",
                geometry.arm_azimuths_deg[2],
                -360.0,
                360.0,
            ),
            bound("geometry.arm_range_rad[0]", geometry.arm_range_rad[0], -1.6, 0.0),
            bound("geometry.arm_range_rad[1]", geometry.arm_range_rad[1], 0.1, 1.8),
            bound("geometry.arm_margin_rad", geometry.arm_margin_rad, 0.0, 0.2),
            bound("work_area.radius_mm", area.radius_mm, 1.0, reach),
            bound("work_area.z_low_mm", area.z_low_mm, -reach, area.z_high_mm),
            bound("work_area.z_high_mm", area.z_high_mm, area.z_low_mm, 0.0),
            bound(
                "paper.centre_mm[0]",
                paper.centre_mm[0],
                -area.radius_mm,
                area.radius_mm,
            ),
            bound(
                "paper.centre_mm[1]",
                paper.centre_mm[1],
                -area.radius_mm,
                area.radius_mm,
            ),
            bound("paper.size_mm[0]", paper.size_mm[0], 1.0, 2.0 * area.radius_mm),
            bound("paper.size_mm[1]", paper.size_mm[1], 1.0, 2.0 * area.radius_mm),
            bound(
                "paper.pen_down_z_mm",
                paper.pen_down_z_mm,
                area.z_low_mm,
                area.z_high_mm,
            ),
            bound(
                "paper.pen_lift_mm",
                paper.pen_lift_mm,
                0.5,
                area.z_high_mm - paper.pen_down_z_mm,
            ),
            bound("motion.speed_mm_s", motion.speed_mm_s, 1.0, 10_000.0),
            bound("motion.travel_speed_mm_s", motion.travel_speed_mm_s, 1.0, 10_000.0),
            bound("motion.acceleration_mm_s2", motion.acceleration_mm_s2, 10.0, 150_000.0),
            bound(
                "motion.joint_speed_rad_s",
                largest(&motion.joint_speed_rad_s),
                0.01,
                50.0,
            ),
            bound(
                "motion.joint_speed_rad_s",
                smallest(&motion.joint_speed_rad_s),
                0.01,
                50.0,
            ),
            bound(
                "motion.joint_acceleration_rad_s2",
                largest(&motion.joint_acceleration_rad_s2),
                0.1,
                2000.0,
            ),
            bound(
                "motion.joint_acceleration_rad_s2",
                smallest(&motion.joint_acceleration_rad_s2),
                0.1,
                2000.0,
            ),
            bound("motion.tolerance_mm", motion.tolerance_mm, 0.005, 5.0),
            bound(
                "motion.travel_tolerance_mm",
                motion.travel_tolerance_mm,
                motion.tolerance_mm,
                10.0,
            ),
            bound("motion.jerk_window_ms", f64::from(motion.jerk_window_ms), 0.0, 32.0),
            bound(
                "motion.starve_dwell_ms",
                f64::from(motion.starve_dwell_ms),
                0.0,
                60_000.0,
            ),
            bound("bus.drives", f64::from(bus.drives), AXES as f64, AXES as f64),
            bound("bus.blind_max_ms", f64::from(bus.blind_max_ms), 1.0, BLIND_MAX_MS),
            bound("bus.late_max_per_s", f64::from(bus.late_max_per_s), 0.0, 1_000.0),
            bound("bus.host_silence_ms", f64::from(bus.host_silence_ms), 100.0, 10_000.0),
            bound("bus.dead_man_ms", f64::from(bus.dead_man_ms), 20.0, 500.0),
            bound(
                "bus.segment",
                f64::from(u32::from(bus.segment)),
                // UDP needs a peer; addresses from 224.0.0.0 on are no hosts'.
                f64::from(u8::from(bus.transport == Transport::Udp)),
                f64::from(0xDFFF_FFFF_u32),
            ),
            bound("bus.sync_shift_us", f64::from(bus.sync_shift_us), 0.0, 999.0),
            bound("bus.clock_error_max_us", f64::from(bus.clock_error_max_us), 10.0, 500.0),
            bound(
                "bus.watchdog_ms",
                f64::from(bus.watchdog_ms),
                f64::from(bus.blind_max_ms) + 1.0,
                1000.0,
            ),
        ]
    }

    /// Checks every value against its hard bounds.
    ///
    /// # Errors
    /// The first value that is not finite or outside its bounds, with the bounds.
    pub fn check(&self) -> Result<(), ConfigError> {
        check_rows(&self.scalars(), None)?;
        for (axis, values) in (0u8..).zip(&self.axes) {
            check_rows(&values.scalars(), Some(axis))?;
        }
        Ok(())
    }

    /// Hash of the configuration as it travels: FNV-1a, 64 bits, over its postcard encoding.
    ///
    /// `None` when the encoding is longer than [`CONFIG_BYTES_MAX`].
    pub fn hash(&self) -> Option<u64> {
        let mut buffer = [0u8; CONFIG_BYTES_MAX];
        let bytes = postcard::to_slice(self, &mut buffer).ok()?;
        Some(bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
            (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
        }))
    }
}

fn largest(values: &[f64]) -> f64 {
    values
        .iter()
        .fold(f64::NEG_INFINITY, |a, b| if b.is_nan() || *b > a { *b } else { a })
}

fn smallest(values: &[f64]) -> f64 {
    values
        .iter()
        .fold(f64::INFINITY, |a, b| if b.is_nan() || *b < a { *b } else { a })
}

fn check_rows(rows: &[Bound], axis: Option<u8>) -> Result<(), ConfigError> {
    for (row, bound) in (0u8..).zip(rows) {
        if !(bound.value.is_finite() && bound.value >= bound.low && bound.value <= bound.high) {
            return Err(ConfigError {
                field: Field { row, axis },
                value: bound.value,
                low: bound.low,
                high: bound.high,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn values_that_are_not_numbers_are_refused_wherever_they_stand() {
        let mut config = Config::default();
        config.motion.joint_speed_rad_s[3] = f64::NAN;
        assert_eq!(config.check().unwrap_err().field.name(), "motion.joint_speed_rad_s");
        let mut config = Config::default();
        config.work_area.z_low_mm = f64::NAN;
        assert!(config.check().is_err());
    }

    #[test]
    fn the_watchdog_is_longer_than_the_blind_limit() {
        let mut config = Config::default();
        config.bus.watchdog_ms = config.bus.blind_max_ms;
        assert_eq!(config.check().unwrap_err().field.name(), "bus.watchdog_ms");
    }

    #[test]
    fn addresses_are_dhcp_or_an_address_with_its_network_and_nothing_else() {
        let parse = |text: &str| HostAddress::try_from(String::try_from(text).unwrap());
        assert_eq!(parse("dhcp"), Ok(HostAddress::Dhcp));
        let fixed = HostAddress::Fixed {
            address: Ipv4Addr::new(192, 168, 100, 200),
            prefix: 24,
        };
        assert_eq!(parse("192.168.100.200/24"), Ok(fixed));
        assert_eq!(String::from(fixed), "192.168.100.200/24");
        for wrong in [
            "",
            "DHCP",
            "1.2.3.4",
            "1.2.3.4/0",
            "1.2.3.4/31",
            "1.2.3/8",
            "1.2.3.4/x",
            "1.2.3.4/24/",
        ] {
            assert_eq!(parse(wrong), Err(AddressError), "{wrong}");
        }
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
    fn any_changed_value_changes_the_hash() {
        let mut config = Config::default();
        let before = config.hash();
        config.axes[3].gear = 12.000001;
        assert_ne!(config.hash(), before);
    }
}
