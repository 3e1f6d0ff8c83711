//! Named inputs and outputs of terminals: `[[io]]`.
//!
//! Invariant: a configuration that [`check`] has passed names each point once, gives each output to one point only, and
//! has roles only where the firmware can serve them.

use super::Config;
use crate::ethercat::configure::Direction;
use crate::ethercat::cyclic::{PROCESS_BYTES_MAX, VALUES_MAX};
use crate::ethercat::slave_set::SlaveSet;
use crate::robot_bus::BUS_SLAVES_MAX;
use core::fmt::{self, Write};
use heapless::{String, Vec};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Most named inputs and outputs.
pub const IO_MAX: usize = VALUES_MAX;
/// Longest name, bytes.
pub const IO_NAME_MAX: usize = 16;
/// Most named words whose values are in each sample.
pub const SAMPLE_WORDS_MAX: usize = 4;
/// Most bytes of the named words in a sample together: they fit the serial line beside a drawing.
pub const SAMPLE_WORD_BYTES_MAX: usize = 8;
/// Name of a point: letters, digits, `_` and `-`.
pub type IoName = String<IO_NAME_MAX>;
/// Process data of one direction, bits.
const PROCESS_BITS_MAX: u16 = 8 * PROCESS_BYTES_MAX as u16;

/// Whether a point is read or written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum IoDirection {
    /// The terminal's input: the robot reads it.
    #[default]
    In,
    /// The terminal's output: the robot writes it.
    Out,
}

impl From<IoDirection> for Direction {
    fn from(direction: IoDirection) -> Self {
        match direction {
            IoDirection::In => Self::Inputs,
            IoDirection::Out => Self::Outputs,
        }
    }
}

/// Type of a point's value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum IoType {
    /// A bit.
    #[default]
    Bool,
    /// A byte without a sign.
    U8,
    /// A byte with a sign.
    I8,
    /// Two bytes without a sign.
    U16,
    /// Two bytes with a sign.
    I16,
    /// Four bytes without a sign.
    U32,
    /// Four bytes with a sign.
    I32,
}

impl IoType {
    /// Bits in the process data.
    pub const fn bits(self) -> u8 {
        match self {
            Self::Bool => 1,
            Self::U8 | Self::I8 => 8,
            Self::U16 | Self::I16 => 16,
            Self::U32 | Self::I32 => 32,
        }
    }

    /// Least and greatest value.
    pub const fn range(self) -> (i64, i64) {
        match self {
            Self::Bool => (0, 1),
            Self::U8 => (0, u8::MAX as i64),
            Self::I8 => (i8::MIN as i64, i8::MAX as i64),
            Self::U16 => (0, u16::MAX as i64),
            Self::I16 => (i16::MIN as i64, i16::MAX as i64),
            Self::U32 => (0, u32::MAX as i64),
            Self::I32 => (i32::MIN as i64, i32::MAX as i64),
        }
    }

    /// Greatest value, at most 65535.
    pub const fn most(self) -> u16 {
        let (_, greatest) = self.range();
        if greatest < u16::MAX as i64 {
            greatest as u16
        } else {
            u16::MAX
        }
    }

    /// The value of its bits, in the lowest bits of `raw`.
    pub const fn value(self, raw: u32) -> i64 {
        match self {
            Self::Bool => (raw & 1) as i64,
            Self::U8 => (raw as u8) as i64,
            Self::I8 => (raw as u8).cast_signed() as i64,
            Self::U16 => (raw as u16) as i64,
            Self::I16 => (raw as u16).cast_signed() as i64,
            Self::U32 => raw as i64,
            Self::I32 => raw.cast_signed() as i64,
        }
    }

    /// The bits of a value; `None` outside [`Self::range`].
    pub const fn raw(self, value: i64) -> Option<u32> {
        let (least, greatest) = self.range();
        if value < least || value > greatest {
            return None;
        }
        let mask = u32::MAX >> (32 - self.bits() as u32);
        Some(value as u32 & mask)
    }
}

/// What the robot does by itself with a point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IoRole {
    /// Nothing: the host reads or sets it.
    #[default]
    None,
    /// Input, closed (1) in operation. Open or missing, it stops the drives at once, and keeps them stopped.
    EmergencyStop,
    /// Input, closed (1) in operation. Open or missing, it stops drives that have power, and keeps others without it.
    Door,
    /// Input, closed (1) in operation. Open or missing, it holds the drawing on its path.
    Hold,
    /// Input: a change from 0 to 1 switches the drives on, or resumes a held drawing.
    Start,
    /// Output that shows the operating mode.
    Lamp,
    /// Input of a home switch, closed (1) in operation and open where the axis is at its switch. A terminal that fails is a
    /// fault.
    Home,
    /// Input of a limit switch of the point's axis, closed (1) in operation. Outside homing, opening with power stops the
    /// drives: a fault that names the axis. One that is open when power comes is none, so that the axis can be jogged off it.
    Limit,
    /// Output that lowers the pen: on from the start of lowering to the start of lifting, off at every stop; a word has the
    /// positions of a servo instead. A terminal that fails is a fault.
    Pen,
    /// Output of a laser or a dispenser, which follows the path: [`Tool`](super::Tool). 0 outside strokes and at every stop. A
    /// terminal that fails is a fault.
    Tool,
}

impl IoRole {
    /// Whether the drives need this point to have power: of a limit switch only that it arrives, of the pen's and the tool's
    /// output that its terminal confirms it.
    pub const fn stops(self) -> bool {
        matches!(
            self,
            Self::EmergencyStop | Self::Door | Self::Limit | Self::Pen | Self::Tool
        )
    }

    /// Whether the controller sets this output by itself.
    pub const fn is_own(self) -> bool {
        matches!(self, Self::Lamp | Self::Pen | Self::Tool)
    }

    /// Whether the failure of the point's terminal is a fault.
    pub const fn is_needed(self) -> bool {
        self.stops() || matches!(self, Self::Home)
    }

    /// Name as used in `etherpen.toml`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::EmergencyStop => "emergency_stop",
            Self::Door => "door",
            Self::Hold => "hold",
            Self::Start => "start",
            Self::Lamp => "lamp",
            Self::Home => "home",
            Self::Limit => "limit",
            Self::Pen => "pen",
            Self::Tool => "tool",
        }
    }
}

/// What becomes of an output at a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnFault {
    /// It becomes 0, and stays 0 until it is set again.
    #[default]
    Off,
    /// It keeps its value.
    Hold,
}

/// An object in a terminal's process data: in text, `"0x6000:01"`, both numbers hexadecimal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObjectName {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
}

/// Longest text of an [`ObjectName`], bytes.
const OBJECT_TEXT_MAX: usize = 9;

impl fmt::Display for ObjectName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "0x{:04X}:{:02X}", self.index, self.sub)
    }
}

impl ObjectName {
    fn parse(text: &str) -> Option<Self> {
        let (index, sub) = text.strip_prefix("0x")?.split_once(':')?;
        let hexadecimal = |digits: &str, most: usize| {
            (1..=most).contains(&digits.len()) && digits.bytes().all(|digit| digit.is_ascii_hexdigit())
        };
        if !hexadecimal(index, 4) || !hexadecimal(sub, 2) {
            return None;
        }
        Some(Self {
            index: u16::from_str_radix(index, 16).ok()?,
            sub: u8::from_str_radix(sub, 16).ok()?,
        })
    }
}

impl Serialize for ObjectName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            let mut text: String<OBJECT_TEXT_MAX> = String::new();
            // The capacity holds any object.
            let _ = write!(text, "{self}");
            return serializer.serialize_str(&text);
        }
        (self.index, self.sub).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for ObjectName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            let text: String<OBJECT_TEXT_MAX> = String::deserialize(deserializer)?;
            return Self::parse(&text).ok_or_else(|| {
                D::Error::custom("expected an object as index and sub-index in hexadecimal, \"0x6000:01\"")
            });
        }
        let (index, sub) = <(u16, u8)>::deserialize(deserializer)?;
        Ok(Self { index, sub })
    }
}

/// A named input or output of a terminal.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IoPoint {
    /// Its name.
    pub name: IoName,
    /// Place of the terminal in the chain, from 0.
    pub slave: u8,
    /// Whether it is read or written.
    pub direction: IoDirection,
    /// Its first bit in the terminal's process data of this direction; instead of `object`.
    pub bit: Option<u16>,
    /// The object of its entry in the terminal's process data; instead of `bit`.
    pub object: Option<ObjectName>,
    /// Its type.
    #[serde(rename = "type")]
    pub kind: IoType,
    /// What the robot does by itself with it.
    pub role: IoRole,
    /// The axis, from 0, of an input with the role `limit`.
    pub axis: Option<u8>,
    /// What becomes of an output at a fault.
    pub on_fault: OnFault,
}

/// All named points, in the order of the file.
pub type IoPoints = Vec<IoPoint, IO_MAX>;

/// Why a point or a terminal cannot be used; points count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum IoError {
    /// The name is empty or has other characters than letters, digits, `_` and `-`.
    Name {
        /// The point.
        io: u8,
    },
    /// Two points have one name.
    SameName {
        /// The first.
        first: u8,
        /// The second.
        second: u8,
    },
    /// The place is beyond the longest chain.
    Slave {
        /// The point.
        io: u8,
        /// Last place that is possible.
        expected: u8,
        /// The place given.
        actual: u8,
    },
    /// Either `bit` or `object` has to be given.
    Place {
        /// The point.
        io: u8,
    },
    /// The value ends beyond the longest process data.
    Bit {
        /// The point.
        io: u8,
        /// Last bit at which this type may begin.
        expected: u16,
        /// The bit given.
        actual: u16,
    },
    /// A limit switch needs one of the machine's axes, and no other point has one.
    LimitAxis {
        /// The point.
        io: u8,
        /// Number of the machine's axes.
        axes: u8,
    },
    /// An axis's home switch is not an input with the role `home`.
    HomeSwitch {
        /// The axis, from 0.
        axis: u8,
    },
    /// Two axes have one home switch.
    SameHomeSwitch {
        /// The first, from 0.
        first: u8,
        /// The second.
        second: u8,
    },
    /// An axis without a home switch moves together with one that has one.
    CoupledAxis {
        /// The axis, from 0.
        axis: u8,
    },
    /// An output is to lower the pen of a machine without an axis of the height.
    PenWithoutHeight,
    /// The type of the pen's output is not that of what lowers the pen, or does not hold its two positions; or 0, which an
    /// output has without the controller, presses the pen down; or two pens need different words.
    PenPositions {
        /// The point.
        io: u8,
    },
    /// The role needs the other direction, or a bit.
    Role {
        /// The point.
        io: u8,
        /// The role.
        role: IoRole,
    },
    /// Two outputs share bits.
    SameOutput {
        /// The first.
        first: u8,
        /// The second.
        second: u8,
    },
    /// The place of a terminal is beyond the longest chain; terminals count from 0.
    TerminalSlave {
        /// The terminal.
        terminal: u8,
        /// Last place that is possible.
        expected: u8,
        /// The place given.
        actual: u8,
    },
    /// Two terminals have one place.
    SameTerminal {
        /// The first.
        first: u8,
        /// The second.
        second: u8,
    },
    /// Two terminals expect the same device.
    SameDevice {
        /// The first.
        first: u8,
        /// The second.
        second: u8,
    },
    /// A terminal expects the device that an axis expects as its drive.
    DeviceOfAxis {
        /// The terminal.
        terminal: u8,
        /// The axis.
        axis: u8,
    },
    /// The tool follows the path, and no output has the role `tool`.
    ToolWithoutOutput,
    /// An output has the role `tool`, and the tool follows nothing.
    ToolFollowsNothing {
        /// The point.
        io: u8,
    },
    /// The values of the tool's output are not in order, or its type does not hold them.
    ToolRange {
        /// The point.
        io: u8,
        /// Greatest value of its type, at most 65535.
        most: u16,
    },
    /// The tool's pulses come too fast for its output.
    ToolPitch {
        /// The point.
        io: u8,
        /// Shortest way for a pulse, um.
        least_um: u32,
    },
}

impl IoPoint {
    fn check(&self, io: u8) -> Result<(), IoError> {
        let is_valid = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-');
        if self.name.is_empty() || !self.name.bytes().all(is_valid) {
            return Err(IoError::Name { io });
        }
        if usize::from(self.slave) >= BUS_SLAVES_MAX {
            return Err(IoError::Slave {
                io,
                expected: BUS_SLAVES_MAX as u8 - 1,
                actual: self.slave,
            });
        }
        if self.bit.is_some() == self.object.is_some() {
            return Err(IoError::Place { io });
        }
        let expected = PROCESS_BITS_MAX - u16::from(self.kind.bits());
        if let Some(actual) = self.bit.filter(|bit| *bit > expected) {
            return Err(IoError::Bit { io, expected, actual });
        }
        let serves = match self.role {
            IoRole::None => true,
            IoRole::Lamp => self.direction == IoDirection::Out && self.kind == IoType::Bool,
            // Its type follows from what lowers the pen.
            IoRole::Pen => self.direction == IoDirection::Out,
            // It is off at every fault.
            IoRole::Tool => self.direction == IoDirection::Out && self.on_fault == OnFault::Off,
            _ => self.direction == IoDirection::In && self.kind == IoType::Bool,
        };
        match serves {
            true => Ok(()),
            false => Err(IoError::Role { io, role: self.role }),
        }
    }

    /// Whether this and another point write to the same bits.
    fn overlaps(&self, other: &Self) -> bool {
        let are_outputs = self.direction == IoDirection::Out && other.direction == IoDirection::Out;
        let range = |point: &Self| point.bit.map(|bit| bit..bit + u16::from(point.kind.bits()));
        let same_bits = match (range(self), range(other)) {
            (Some(one), Some(two)) => one.start < two.end && two.start < one.end,
            _ => self.object.is_some() && self.object == other.object,
        };
        are_outputs && self.slave == other.slave && same_bits
    }
}

/// Checks all points.
///
/// # Errors
/// The first [`IoError`].
pub(super) fn check(points: &IoPoints) -> Result<(), IoError> {
    for (io, point) in (0_u8..).zip(points) {
        point.check(io)?;
        for (first, before) in (0..io).zip(points) {
            let second = io;
            if before.name == point.name {
                return Err(IoError::SameName { first, second });
            }
            if before.overlaps(point) {
                return Err(IoError::SameOutput { first, second });
            }
        }
    }
    Ok(())
}

/// The points, from 0, whose values are in each sample: those of more than one bit, in the order of the configuration, up
/// to [`SAMPLE_WORDS_MAX`] and [`SAMPLE_WORD_BYTES_MAX`]; one that does not fit any more is left out. Takes the bits of each
/// point.
pub fn sampled_words(bits: impl Iterator<Item = u8>) -> Vec<u8, SAMPLE_WORDS_MAX> {
    let (mut words, mut used) = (Vec::new(), 0);
    for (io, bits) in (0_u8..).zip(bits).filter(|(_, bits)| *bits > 1) {
        let with_it = used + usize::from(bits);
        if with_it <= 8 * SAMPLE_WORD_BYTES_MAX && words.push(io).is_ok() {
            used = with_it;
        }
    }
    words
}

impl Config {
    /// The points, from 0, whose values are in each sample; see [`sampled_words`].
    #[must_use]
    pub fn sampled_words(&self) -> Vec<u8, SAMPLE_WORDS_MAX> {
        sampled_words(self.io.iter().map(|point| point.kind.bits()))
    }

    /// Places of the terminals: those that the named points need, and those that are listed.
    #[must_use]
    pub fn terminal_places(&self) -> SlaveSet {
        let needed = self.io.iter().map(|point| point.slave);
        let listed = self.terminals.iter().map(|terminal| terminal.slave);
        needed.chain(listed).map(usize::from).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(name: &str, slave: u8, direction: IoDirection, bit: u16) -> IoPoint {
        IoPoint {
            name: name.try_into().unwrap(),
            slave,
            direction,
            bit: Some(bit),
            ..IoPoint::default()
        }
    }

    #[test]
    fn a_word_that_does_not_fit_a_sample_leaves_room_for_shorter_ones_behind_it() {
        for (bits, words) in [
            (&[16, 1, 32, 32, 8, 8][..], &[0, 2, 4, 5][..]),
            (&[32, 16, 32, 16], &[0, 1, 3]),
            (&[8, 8, 8, 8, 8], &[0, 1, 2, 3]),
            (&[1, 1], &[]),
        ] {
            assert_eq!(sampled_words(bits.iter().copied()), words, "{bits:?}");
        }
    }

    #[test]
    fn each_mistake_is_named_with_its_point() {
        let good = [
            point("door", 1, IoDirection::In, 0),
            point("lamp", 2, IoDirection::Out, 3),
        ];
        let checked = |change: fn(&mut [IoPoint; 2])| {
            let mut points = good.clone();
            change(&mut points);
            check(&points.into_iter().collect())
        };
        assert_eq!(checked(|_| {}), Ok(()));
        let io = 1;
        assert_eq!(checked(|points| points[1].name.clear()), Err(IoError::Name { io }));
        assert_eq!(
            checked(|points| points[1].name.push(' ').unwrap()),
            Err(IoError::Name { io })
        );
        let (first, second) = (0, 1);
        let same = checked(|points| points[1].name = points[0].name.clone());
        assert_eq!(same, Err(IoError::SameName { first, second }));
        let far = checked(|points| points[1].slave = 16);
        let (expected, actual) = (15, 16);
        assert_eq!(far, Err(IoError::Slave { io, expected, actual }));
        assert_eq!(checked(|points| points[1].bit = None), Err(IoError::Place { io }));
        let both = checked(|points| points[1].object = Some(ObjectName { index: 0x7000, sub: 1 }));
        assert_eq!(both, Err(IoError::Place { io }));
        let long = checked(|points| (points[1].kind, points[1].bit) = (IoType::I32, Some(225)));
        let (expected, actual) = (224, 225);
        assert_eq!(long, Err(IoError::Bit { io, expected, actual }));
        for (role, kind, direction) in [
            (IoRole::Lamp, IoType::Bool, IoDirection::In),
            (IoRole::Lamp, IoType::U8, IoDirection::Out),
            (IoRole::Door, IoType::Bool, IoDirection::Out),
            (IoRole::EmergencyStop, IoType::U8, IoDirection::In),
        ] {
            let mut points = good.clone();
            (points[1].role, points[1].kind, points[1].direction) = (role, kind, direction);
            assert_eq!(check(&points.into_iter().collect()), Err(IoError::Role { io, role }));
        }
        let shared = checked(|points| {
            (points[0].slave, points[0].direction) = (2, IoDirection::Out);
            (points[0].kind, points[0].bit) = (IoType::U16, Some(0));
        });
        assert_eq!(shared, Err(IoError::SameOutput { first, second }));
    }

    #[test]
    fn values_of_every_type_survive_their_bits_and_others_are_refused() {
        use IoType::{Bool, I8, I16, I32, U8, U16, U32};
        for kind in [Bool, U8, I8, U16, I16, U32, I32] {
            let (least, greatest) = kind.range();
            for value in [least, least / 2, 0, 1, greatest / 3, greatest] {
                let raw = kind.raw(value).unwrap();
                assert_eq!(kind.value(raw), value, "{kind:?}");
                assert_eq!(u64::from(raw) >> kind.bits(), 0, "{kind:?}");
            }
            assert_eq!((kind.raw(least - 1), kind.raw(greatest + 1)), (None, None), "{kind:?}");
        }
    }

    #[test]
    fn objects_are_read_as_they_are_written() {
        let object = ObjectName {
            index: 0x6010,
            sub: 0x0A,
        };
        assert_eq!(ObjectName::parse("0x6010:0A"), Some(object));
        assert_eq!(ObjectName::parse("0x6010:a"), Some(object));
        for wrong in [
            "",
            "6010:01",
            "0x:1",
            "0x6010",
            "0x60100:1",
            "0x6010:100",
            "0x6010:-1",
            "0x+601:1",
        ] {
            assert_eq!(ObjectName::parse(wrong), None, "{wrong}");
        }
    }
}
