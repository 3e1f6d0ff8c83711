//! Checks a configuration file as its owner reads it: what is wrong, what is missing, what is unlikely.
//!
//! An error is a file that no command accepts, or with which the machine cannot draw. A warning is a value that is
//! allowed and that few machines have.
//!
//! Invariant: every finding says what to write; its line is that of the file.

mod homing;

pub(crate) use homing::room_behind_switch_rad;

use super::reading::{self, ReadingError};
use super::shortened;
use crate::axes::{AxisView, Motion, Quantity, axes};
use crate::link::text;
use etherpen::config::{
    Axis, Config, ConfigError, Encoder, IoError, IoRole, IoType, SAMPLE_WORD_BYTES_MAX, SAMPLE_WORDS_MAX, ToolFollows,
};
use etherpen::motion::{WorkArea, effective_jerk_window_ms};
use etherpen::robots::{GeometryError, Kinematics, MAIN_AXES, Position};
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Fastest usual servo motor, revolutions per minute.
const MOTOR_MAX_RPM: f64 = 6_000.0;
/// Longest watchdog of a terminal with a tool that few machines exceed, ms.
const TOOL_WATCHDOG_MAX_MS: u16 = 10;
/// Least share of an axis's acceleration that its quick stop usually has.
const QUICK_STOP_MIN: f64 = 0.3;

/// How grave a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Gravity {
    /// The file cannot be used.
    Error,
    /// The file can be used; the value is unlikely.
    Warning,
}

/// Number of steps along each side of a sheet at which its inside is looked at.
const PLACES_A_SIDE: u8 = 40;

/// One finding.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// How grave it is.
    pub gravity: Gravity,
    /// Line in the file, from 1; absent for what is missing from the file.
    pub line: Option<usize>,
    /// What is wrong, and what to write.
    pub text: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.line {
            Some(line) => write!(f, "line {line}: {}", self.text),
            None => f.write_str(&self.text),
        }
    }
}

/// Which corner of its sheet a machine does not reach, or that it does not reach the middle, why, and what to do; `None` if it
/// reaches all of them.
#[must_use]
pub fn unreached(config: &Config, area: &WorkArea) -> Option<String> {
    let corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (0.0, 0.0)];
    let where_and_why = first_unreached(config, area, &corners)?;
    Some(format!(
        "{where_and_why}; move or shrink [paper], or correct [work_area] and [geometry]"
    ))
}

/// A place inside the sheet that a machine does not reach although it reaches the corners, as at its base, and why.
fn hole(config: &Config, area: &WorkArea) -> Option<String> {
    let steps = || (0..=PLACES_A_SIDE).map(|step| f64::from(step) / f64::from(PLACES_A_SIDE) - 0.5);
    let places: Vec<(f64, f64)> = steps()
        .flat_map(|along| steps().map(move |across| (across, along)))
        .collect();
    let where_and_why = first_unreached(config, area, &places)?;
    Some(format!("{where_and_why}; a drawing that comes there is refused"))
}

/// The first of these places of the sheet, as parts of its sides from its middle, that a machine does not reach, and why.
fn first_unreached(config: &Config, area: &WorkArea, places: &[(f64, f64)]) -> Option<String> {
    let paper = &config.paper;
    let plane = paper.plane();
    let ([x, y], [width, height]) = (paper.centre_mm, paper.size_mm);
    let lifts_mm = [0.0, paper.pen_lift_mm];
    let places = lifts_mm
        .iter()
        .flat_map(|lift_mm| places.iter().map(move |place| (place, *lift_mm)));
    for ((across, along), lift_mm) in places {
        let (x_mm, y_mm) = (x + across * width, y + along * height);
        let z_mm = plane.z_at_mm(x_mm, y_mm) + lift_mm;
        if let Err(why) = area.check(&Position { x_mm, y_mm, z_mm }) {
            let what = if lift_mm > 0.0 { " with the pen lifted" } else { "" };
            return Some(format!(
                "the machine does not reach x {x_mm:.1}, y {y_mm:.1}, z {z_mm:.1} mm of its sheet{what}: {}",
                text::outside(&why)
            ));
        }
    }
    None
}

/// The places of values in a file.
struct Places<'a> {
    text: &'a str,
    table: Option<Spanned<DeTable<'a>>>,
}

impl<'a> Places<'a> {
    fn new(text: &'a str) -> Self {
        Self {
            text,
            table: DeTable::parse(text).ok(),
        }
    }

    fn line(&self, place: usize) -> usize {
        let before = self.text.get(..place).unwrap_or(self.text);
        before.matches('\n').count() + 1
    }

    fn table(&self, name: &str) -> Option<&DeTable<'a>> {
        self.table.as_ref()?.get_ref().get(name)?.get_ref().as_table()
    }

    /// Whether a table or list of this name is written.
    fn has(&self, name: &str) -> bool {
        self.table
            .as_ref()
            .is_some_and(|table| table.get_ref().contains_key(name))
    }

    /// The line of the first of these values of a table, or else of the table.
    fn of(&self, table: &str, keys: &[&str]) -> Option<usize> {
        let key = self.table(table).and_then(|values| key_line(self, values, keys));
        let header = || self.table.as_ref()?.get_ref().get_key_value(table);
        key.or_else(|| header().map(|(name, _)| self.line(name.span().start)))
    }

    /// The line of the first of these values of an axis, from 0, or of the value that the axes share, or of the axis.
    fn of_axis(&self, axis: usize, keys: &[&str]) -> Option<usize> {
        let axes = self.table.as_ref()?.get_ref().get("axes");
        let written = axes.and_then(|axes| axes.get_ref().as_array()?.get(axis));
        let own = written.and_then(|written| key_line(self, written.get_ref().as_table()?, keys));
        own.or_else(|| key_line(self, self.table("axis_defaults")?, keys))
            .or_else(|| written.map(|written| self.line(written.span().start)))
    }

    /// The line of a named input or output, from 0.
    fn of_io(&self, io: u8) -> Option<usize> {
        self.of_entry("io", io)
    }

    /// The line of an entry of a list of tables, from 0.
    fn of_entry(&self, list: &str, entry: u8) -> Option<usize> {
        let entries = self.table.as_ref()?.get_ref().get(list)?.get_ref().as_array()?;
        entries
            .get(usize::from(entry))
            .map(|entry| self.line(entry.span().start))
    }
}

fn key_line(places: &Places<'_>, table: &DeTable<'_>, keys: &[&str]) -> Option<usize> {
    let written = keys.iter().find_map(|key| table.get_key_value(*key));
    written.map(|(key, _): (&Spanned<_>, &Spanned<DeValue<'_>>)| places.line(key.span().start))
}

/// Why a text is no valid configuration: its first error, with its line.
#[must_use]
pub fn first_error(text: &str) -> Option<Finding> {
    let mut findings = errors(text).1;
    (!findings.is_empty()).then(|| findings.swap_remove(0))
}

/// The configuration of a text, as far as it can be read, and the errors that every command reports.
fn errors(text: &str) -> (Option<Config>, Vec<Finding>) {
    let error = |line, text: String| Finding {
        gravity: Gravity::Error,
        line,
        text,
    };
    let config = match reading::configuration(text) {
        Ok(config) => config,
        Err(ReadingError::Machine { line, text }) => return (None, vec![error(Some(line), text)]),
        Err(ReadingError::Toml(cause)) => {
            // The text of such an error shows its line already.
            return (None, vec![error(None, shortened(&cause).trim_end().to_owned())]);
        }
    };
    let places = Places::new(text);
    let mut found = Vec::new();
    if let Err(cause) = config.check() {
        found.push(error(bounds_line(&places, &cause), bounds_text(&config, &cause)));
    }
    if found.is_empty() {
        found.extend(marks_outside(&places, &config));
        found.extend(wrapping(&places, &config));
    }
    if let Err(cause) = config.check_io() {
        found.push(error(
            io_line(&places, &cause),
            format!("{}; correct it", text::io_error(&cause)),
        ));
    }
    (Some(config), found)
}

/// Axes whose place at the switch is outside their range, or whose mark is farther outside than half a motor turn.
fn marks_outside(places: &Places<'_>, config: &Config) -> Vec<Finding> {
    let outside = |axis: AxisView| {
        let settings = config.axes.get(axis.index)?;
        let ([low_rad, high_rad], place_rad, room_rad) = match settings.home.io {
            Some(_) => {
                let switches_rad = config.switch_places_rad();
                (searched_rad(config, axis.index), *switches_rad.get(axis.index)?, 0.0)
            }
            None => {
                let room_rad = PI / settings.gear.abs();
                (range_rad(config, axis.index), settings.sync_angle_rad, room_rad)
            }
        };
        let away_rad = (low_rad - place_rad).max(place_rad - high_rad);
        if away_rad <= room_rad + 1.0e-9 {
            return None;
        }
        let [sync, low, high] = [place_rad, low_rad, high_rad].map(|rad| round(rad * axis.motion.factor()));
        let (key, unit) = (sync_key(axis.motion), axis.motion.unit(Quantity::Position));
        Some(Finding {
            gravity: Gravity::Error,
            line: places.of_axis(axis.index, &[key]),
            text: match settings.home.io {
                Some(_) => format!(
                    "{} would be at {sync} {unit} at its switch, and its range is {low} to {high} {unit}; correct {} or [geometry]",
                    led(config, &axis),
                    sync_keys(config, &axis)
                ),
                None => format!(
                    "axis {} ({}) would be at {sync} {unit} at its mark, and its range is {low} to {high} {unit}; correct {key} or \
                     [geometry]",
                    axis.index + 1,
                    axis.name
                ),
            },
        })
    };
    axes(config).into_iter().filter_map(outside).collect()
}

/// Lowest and highest position of an axis, from 0, rad.
fn range_rad(config: &Config, axis: usize) -> [f64; 2] {
    let main = config.geometry.ranges_rad();
    main.get(axis)
        .copied()
        .unwrap_or_else(|| config.geometry.turn_range_rad())
}

/// Lowest and highest position of what is led to the switch of an axis, from 0, rad.
fn searched_rad(config: &Config, axis: usize) -> [f64; 2] {
    let main = config.geometry.slide_ranges_rad();
    main.get(axis).copied().unwrap_or_else(|| range_rad(config, axis))
}

/// What is led to the switch of an axis, in words.
fn led(config: &Config, axis: &AxisView) -> String {
    let coupled = config.geometry.kind().coupled_axes();
    match ["x", "y"].iter().take(coupled).nth(axis.index) {
        Some(slide) => format!("{slide} (moved by axes 1 and 2)"),
        None => format!("axis {} ({})", axis.index + 1, axis.name),
    }
}

/// The values that say where what is led to the switch of an axis is there.
fn sync_keys(config: &Config, axis: &AxisView) -> String {
    let key = sync_key(axis.motion);
    match axis.index < config.geometry.kind().coupled_axes() {
        true => format!("{key} of both axes, x + y and x - y at the switches,"),
        false => key.to_owned(),
    }
}

/// The value of an axis with its place at mark or switch.
fn sync_key(motion: Motion) -> &'static str {
    match motion {
        Motion::Rotary => "sync_angle_rad",
        Motion::Linear => "sync_mm",
    }
}

/// The line of a value outside its bounds.
fn bounds_line(places: &Places<'_>, cause: &ConfigError) -> Option<usize> {
    let name = cause.field.name();
    let (table, key) = name.split_once('.')?;
    let key = key.split('[').next().unwrap_or(key);
    match cause.field.axis {
        Some(axis) => {
            let (written, _) = crate::axes::as_written(cause.field.kind, axis.into(), key).unwrap_or((key, 1.0));
            places.of_axis(axis.into(), &[written, key])
        }
        None if name == "bus.drives" => places.of_axis(0, &[]).or_else(|| places.of("bus", &["drives"])),
        None => {
            let in_units = key.trim_end_matches("_rad_s2").trim_end_matches("_rad_s");
            places.of(table, &[in_units, key])
        }
    }
}

/// A value outside its bounds, and what to write.
fn bounds_text(config: &Config, cause: &ConfigError) -> String {
    if cause.field.name() == "bus.drives" {
        return format!(
            "a {} has {} to {} axes, and there are {}; write one [[axes]] for each drive{}",
            config.geometry.kind().name(),
            cause.low,
            cause.high,
            cause.value,
            match config.geometry.kind() {
                kind if kind.has_height_axis() && cause.value < MAIN_AXES as f64 =>
                    ", or let an output lower the pen: kind = \"output\" in [pen]",
                _ => "",
            }
        );
    }
    // The caller names the file.
    text::config_error(cause).replace(" in etherpen.toml", "")
}

fn io_line(places: &Places<'_>, cause: &IoError) -> Option<usize> {
    match *cause {
        IoError::SameName { second, .. } | IoError::SameOutput { second, .. } => places.of_io(second),
        IoError::Name { io }
        | IoError::Slave { io, .. }
        | IoError::Place { io }
        | IoError::LimitAxis { io, .. }
        | IoError::PenPositions { io }
        | IoError::ToolFollowsNothing { io }
        | IoError::Bit { io, .. }
        | IoError::Role { io, .. } => places.of_io(io),
        IoError::HomeSwitch { axis } | IoError::CoupledAxis { axis } | IoError::SameHomeSwitch { second: axis, .. } => {
            places.of_axis(axis.into(), &["home"])
        }
        IoError::PenWithoutHeight => places.of("pen", &["kind"]),
        IoError::ToolWithoutOutput => places.of("tool", &["follows"]),
        IoError::ToolRange { io, .. } => places.of("tool", &["maximum"]).or_else(|| places.of_io(io)),
        IoError::ToolPitch { io, .. } => places.of("tool", &["pitch_um"]).or_else(|| places.of_io(io)),
        IoError::TerminalSlave { terminal, .. } | IoError::DeviceOfAxis { terminal, .. } => {
            places.of_entry("terminals", terminal)
        }
        IoError::SameTerminal { second, .. } | IoError::SameDevice { second, .. } => {
            places.of_entry("terminals", second)
        }
    }
}

/// All findings about a configuration file's text, errors first.
#[must_use]
pub fn check(text: &str) -> Vec<Finding> {
    let (config, mut found) = errors(text);
    let Some(config) = config else { return found };
    let checks = Checks {
        places: Places::new(text),
        config: &config,
    };
    if found.is_empty() {
        match Kinematics::new(&config.geometry) {
            Err(cause) => found.push(checks.geometry(&cause)),
            Ok(_) => checks.reach(&mut found),
        }
        checks.pen(&mut found);
        checks.tool(&mut found);
        checks.words(&mut found);
        checks.jerk_window(&mut found);
        checks.axes(&mut found);
        homing::check(&checks, &mut found);
    }
    checks.missing(&mut found);
    found.sort_by_key(|finding| finding.gravity == Gravity::Warning);
    found
}

struct Checks<'a> {
    places: Places<'a>,
    config: &'a Config,
}

impl Checks<'_> {
    fn geometry(&self, cause: &GeometryError) -> Finding {
        Finding {
            gravity: Gravity::Error,
            line: self.places.of("geometry", &[]),
            text: format!("the dimensions do not form a valid machine: {cause}; correct [geometry]"),
        }
    }

    /// Whether the machine reaches its sheet and its work area.
    fn reach(&self, found: &mut Vec<Finding>) {
        let Ok(area) = WorkArea::new(&self.config.motion_settings()) else {
            return;
        };
        if let Some(text) = unreached(self.config, &area) {
            found.push(Finding {
                gravity: Gravity::Error,
                line: self.places.of("paper", &["centre_mm", "size_mm"]),
                text,
            });
            return;
        }
        if let Some(text) = hole(self.config, &area) {
            found.push(Finding {
                gravity: Gravity::Warning,
                line: self.places.of("paper", &["centre_mm", "size_mm"]),
                text,
            });
        }
        let volume = &self.config.work_area;
        let [[left, right], [front, back]] = [volume.x_mm, volume.y_mm];
        let is_box = [-left, right, -front, back].iter().all(|edge| *edge < volume.radius_mm);
        self.box_reach(&area, is_box, found);
    }

    /// Whether the corners of a rectangular work area are reached.
    fn box_reach(&self, area: &WorkArea, is_box: bool, found: &mut Vec<Finding>) {
        let volume = &self.config.work_area;
        let corners = volume.x_mm.into_iter().flat_map(|x| volume.y_mm.map(|y| (x, y)));
        let heights = [volume.z_low_mm, volume.z_high_mm];
        let corners = corners.flat_map(|(x_mm, y_mm)| heights.map(|z_mm| Position { x_mm, y_mm, z_mm }));
        for position in corners.filter(|_| is_box) {
            // The pen may not go deeper than the sheet allows; that is no question of reach.
            let settings = self.config.motion_settings();
            let lowest = settings.paper.plane().raised(-settings.paper.pressing_depth_mm);
            let lowest_mm = lowest.z_at_mm(position.x_mm, position.y_mm);
            let position = Position {
                z_mm: position.z_mm.max(lowest_mm),
                ..position
            };
            if let Err(why) = area.check(&position) {
                found.push(Finding {
                    gravity: Gravity::Warning,
                    line: self.places.of("work_area", &["x_mm", "y_mm"]),
                    text: format!(
                        "the machine does not reach the corner x {:.1}, y {:.1}, z {:.1} mm of its work area: {}; make \
                         [work_area] smaller",
                        position.x_mm,
                        position.y_mm,
                        position.z_mm,
                        text::outside(&why)
                    ),
                });
                return;
            }
        }
    }

    /// Whether something lowers the pen.
    fn pen(&self, found: &mut Vec<Finding>) {
        let has_output = self.config.io.iter().any(|point| point.role == IoRole::Pen);
        if self.config.pen.kind.is_output() && !has_output {
            found.push(Finding {
                gravity: Gravity::Error,
                line: self.places.of("pen", &["kind"]),
                text: "an output lowers the pen, and no output does: write an [[io]] with direction = \"out\" and \
                       role = \"pen\", or kind = \"axis\" in [pen]"
                    .into(),
            });
        }
    }

    /// How long the tool stays on where nobody can switch it off.
    fn tool(&self, found: &mut Vec<Finding>) {
        let (watchdog_ms, blind_max_ms) = (self.config.bus.watchdog_ms, self.config.bus.blind_max_ms);
        if self.config.tool.follows != ToolFollows::Nothing && watchdog_ms > TOOL_WATCHDOG_MAX_MS {
            found.push(Finding {
                gravity: Gravity::Warning,
                line: self.places.of("bus", &["watchdog_ms"]),
                text: format!(
                    "behind a cable that breaks the tool keeps its value until its terminal's own watchdog ends: {watchdog_ms} \
                     ms; write watchdog_ms = {} to {TOOL_WATCHDOG_MAX_MS}",
                    blind_max_ms + 1
                ),
            });
        }
    }

    /// Which words are not in the samples.
    fn words(&self, found: &mut Vec<Finding>) {
        let sampled = self.config.sampled_words();
        let points = (0_u8..).zip(&self.config.io);
        for (io, point) in points.filter(|(io, point)| point.kind != IoType::Bool && !sampled.contains(io)) {
            found.push(Finding {
                gravity: Gravity::Warning,
                line: self.places.of_io(io),
                text: format!(
                    "the value of {} is not in telemetry and recordings each millisecond, only in the status: there is room \
                     for the first {SAMPLE_WORDS_MAX} words of [[io]] that fit {SAMPLE_WORD_BYTES_MAX} bytes together; write \
                     those that matter first",
                    point.name
                ),
            });
        }
    }

    /// Whether the planner uses the moving average as it is configured.
    fn jerk_window(&self, found: &mut Vec<Finding>) {
        let motion = &self.config.motion;
        let longest_ms = effective_jerk_window_ms(&self.config.motion_settings());
        if longest_ms < motion.jerk_window_ms {
            found.push(Finding {
                gravity: Gravity::Warning,
                line: self.places.of("motion", &["jerk_window_ms"]),
                text: format!(
                    "the planner averages over {longest_ms} ms only: at {} mm/s2 a jerk window of {} ms takes more than \
                     half of the tolerance of {} mm; write jerk_window_ms = {longest_ms}, a larger tolerance_mm or a \
                     lower acceleration_mm_s2",
                    motion.acceleration_mm_s2, motion.jerk_window_ms, motion.tolerance_mm
                ),
            });
        }
    }

    fn axes(&self, found: &mut Vec<Finding>) {
        for axis in axes(self.config) {
            self.axis(&axis, found);
        }
    }

    /// What is unlikely about an axis.
    fn axis(&self, axis: &AxisView, found: &mut Vec<Finding>) {
        let (motion, settings) = (&self.config.motion, self.config.axes.get(axis.index));
        let Some(settings) = settings else { return };
        let [speed_rad_s, acceleration_rad_s2] = [
            motion.joint_speed_rad_s.get(axis.index).copied().unwrap_or(0.0),
            motion.joint_acceleration_rad_s2.get(axis.index).copied().unwrap_or(0.0),
        ];
        let (number, factor) = (axis.index + 1, axis.motion.factor());
        let (speed_unit, acceleration_unit) = (
            axis.motion.unit(Quantity::Speed),
            axis.motion.unit(Quantity::Acceleration),
        );
        let mut warn = |line, text| {
            found.push(Finding {
                gravity: Gravity::Warning,
                line,
                text,
            });
        };
        if let Some(text) = encoder_text(axis, settings) {
            warn(self.places.of_axis(axis.index, &["encoder"]), text);
        }
        if settings.output_max_rad_s < speed_rad_s {
            let key = if axis.motion == Motion::Linear {
                "output_max_mm_s"
            } else {
                "output_max_rad_s"
            };
            warn(
                self.places.of_axis(axis.index, &[key]),
                format!(
                    "axis {number} ({}) may be planned with {} {speed_unit}, and its command ends at {} {speed_unit}: a fast \
                     motion ends with a fault; make {key} greater, or joint_speed smaller",
                    axis.name,
                    round(speed_rad_s * factor),
                    round(settings.output_max_rad_s * factor)
                ),
            );
        }
        let motor_rpm = speed_rad_s * settings.gear.abs() * 60.0 / TAU;
        if motor_rpm > MOTOR_MAX_RPM {
            warn(
                self.places.of("motion", &["joint_speed", "joint_speed_rad_s"]),
                format!(
                    "at its highest speed the motor of axis {number} ({}) turns at {motor_rpm:.0} revolutions a minute, more \
                     than servo motors do; make joint_speed smaller, or correct gear and pitch",
                    axis.name
                ),
            );
        }
        if settings.quick_stop_rad_s2 < QUICK_STOP_MIN * acceleration_rad_s2 {
            let key = if axis.motion == Motion::Linear {
                "quick_stop_mm_s2"
            } else {
                "quick_stop_rad_s2"
            };
            warn(
                self.places.of_axis(axis.index, &[key]),
                format!(
                    "the quick stop of axis {number} ({}) is {} {acceleration_unit}, far weaker than its acceleration of {} \
                     {acceleration_unit}; make {key} greater",
                    axis.name,
                    round(settings.quick_stop_rad_s2 * factor),
                    round(acceleration_rad_s2 * factor)
                ),
            );
        }
    }

    /// What the file does not say, and is taken from the built-in machine.
    fn missing(&self, found: &mut Vec<Finding>) {
        for (table, what) in [
            ("geometry", "the machine's dimensions"),
            ("work_area", "where the pen may go"),
            ("paper", "where the sheet lies"),
            ("motion", "speeds and accelerations"),
            ("axes", "the drives and their axes"),
        ] {
            let is_shared = table == "axes" && self.places.has("axis_defaults");
            if !(self.places.has(table) || is_shared) {
                let name = if table == "axes" {
                    "[[axes]]"
                } else {
                    &format!("[{table}]")
                };
                found.push(Finding {
                    gravity: Gravity::Warning,
                    line: None,
                    text: format!("{name} is missing: {what}; the built-in machine's values are used"),
                });
            }
        }
    }
}

/// Increments of a multi-turn encoder from the mark in which a drive's position of 32 bits is that of one place only.
const POSITIONS: f64 = 2_147_483_648.0;

/// The multi-turn encoders that show a position of 32 bits at several places of their axis.
fn wrapping(places: &Places<'_>, config: &Config) -> Vec<Finding> {
    let wraps = |axis: &AxisView| {
        let settings = config.axes.get(axis.index).filter(|axis| axis.home.io.is_none())?;
        // A turning tool may have a range that it never uses.
        let range_rad = config.geometry.ranges_rad().get(axis.index).copied()?;
        let farthest_rad = range_rad.map(|end_rad| (end_rad - settings.sync_angle_rad).abs());
        let increments_per_rad = settings.gear.abs() * f64::from(settings.increments_per_revolution) / TAU;
        let farthest = farthest_rad.into_iter().fold(0.0, f64::max) * increments_per_rad;
        (settings.encoder == Encoder::MultiTurn && farthest >= POSITIONS).then(|| Finding {
            gravity: Gravity::Error,
            line: places.of_axis(axis.index, &["encoder", "increments_per_revolution"]),
            text: format!(
                "axis {} ({}) moves up to {farthest:.0} increments from its mark, and the drive's position of 32 bits repeats after \
                 4294967296: let its drive count fewer increments for a turn, move the mark to the middle of its range, or make that narrower",
                axis.index + 1,
                axis.name
            ),
        })
    };
    axes(config).iter().filter_map(wraps).collect()
}

/// What has to be done for an axis's encoder.
fn encoder_text(axis: &AxisView, settings: &Axis) -> Option<String> {
    let (number, name) = (axis.index + 1, &axis.name);
    match settings.encoder {
        _ if settings.home.io.is_some() => None,
        Encoder::MultiTurn if !settings.knows_turns() => Some(format!(
            "the multi-turn encoder of axis {number} ({name}) was never calibrated, so it knows nothing: bring the axis to its mark and \
             say etherpen home --calibrate --store"
        )),
        Encoder::MultiTurn if settings.serial == 0 => Some(format!(
            "the multi-turn encoder of axis {number} ({name}) belongs to one drive, and serial does not say to which: another \
             drive would go unnoticed; if it is the one that was calibrated, etherpen home --store writes it, else etherpen home \
             --calibrate --store"
        )),
        Encoder::Incremental => Some(format!(
            "axis {number} ({name}) has an incremental encoder and no home switch: bring it to its mark by hand and say etherpen \
             home whenever it was switched on, or give it a home switch"
        )),
        Encoder::SingleTurn | Encoder::MultiTurn => None,
    }
}

/// A value without the remainder of a conversion.
fn round(value: f64) -> f64 {
    (value * 1.0e6).round() / 1.0e6
}

#[cfg(test)]
mod tests;
