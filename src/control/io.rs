//! Named inputs and outputs of terminals in the critical task.
//!
//! Each millisecond the inputs are read when the drives' inputs are, and the outputs are written with the drives'
//! outputs. An input that stops the drives is judged here, so that the quick stop leaves in the millisecond in which
//! the input arrived.
//!
//! Invariants: an output whose terminal is not in operation is requested anew before it is written again; at a fault
//! every output that does not keep its value becomes 0 in the same millisecond; without points nothing is done.

use crate::application::{Fault, InputCause};
use crate::board::Interlock;
use crate::config::{IO_MAX, IoDirection, IoPoint, IoRole, OnFault, SAMPLE_WORDS_MAX, sampled_words};
use crate::control::tool::ToolValue;
use crate::drives::io::IoGroup;
use crate::ethercat::place::Place;
use heapless::Vec;

/// A point as the critical task needs it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IoPlace {
    slave: u8,
    direction: IoDirection,
    /// Its first bit; `None` for the bit at which the bus found its object.
    bit: Option<u16>,
    bits: u8,
    role: IoRole,
    /// The axis of a limit switch, from 0.
    axis: u8,
    /// Whether a fault leaves the output as it is.
    is_kept: bool,
}

impl From<&IoPoint> for IoPlace {
    fn from(point: &IoPoint) -> Self {
        Self {
            slave: point.slave,
            direction: point.direction,
            bit: point.bit,
            bits: point.kind.bits(),
            role: point.role,
            axis: point.axis.unwrap_or(u8::MAX),
            // The controller sets a lamp in every mode.
            is_kept: point.on_fault == OnFault::Hold || point.role == IoRole::Lamp,
        }
    }
}

/// All points as the critical task needs them.
pub type IoPlaces = Vec<IoPlace, IO_MAX>;

/// Why an input stops the drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IoStop {
    /// The point, from 0.
    pub io: u8,
    /// Its role.
    pub role: IoRole,
    /// The axis of a limit switch, from 0.
    pub axis: u8,
    /// Whether it is open or missing.
    pub cause: InputCause,
}

impl IoStop {
    /// The fault of this stop.
    pub const fn fault(&self) -> Fault {
        if self.is_limit() {
            return Fault::LimitSwitch {
                axis: self.axis,
                io: self.io,
            };
        }
        Fault::StopInput {
            io: self.io,
            role: self.role,
            cause: self.cause,
        }
    }

    /// Whether a limit switch has opened. It is told in the millisecond in which it opens only.
    pub const fn is_limit(&self) -> bool {
        matches!((self.role, self.cause), (IoRole::Limit, InputCause::Open))
    }

    /// Whether the stop lasts whether the drives have power or not: an emergency stop that is open.
    pub const fn is_interlock(&self) -> bool {
        matches!((self.role, self.cause), (IoRole::EmergencyStop, InputCause::Open))
    }
}

/// The points in one millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IoReport {
    /// Points whose value is not 0, one bit each: inputs as last read, outputs as written.
    pub set: u16,
    /// Points that are exchanged, one bit each; others are missing.
    pub valid: u16,
    /// One of the points that are no bits, and its value; another one each millisecond.
    pub word: Option<(u8, u32)>,
    /// What stops the drives.
    pub stop: Option<IoStop>,
    /// The first input that holds drawings: its point.
    pub hold: Option<u8>,
    /// Whether a start input is closed, and was open since it arrives.
    pub start: bool,
}

/// The named points of the critical task.
#[derive(Debug)]
pub struct Io {
    points: IoPlaces,
    places: [Option<Place<u32>>; IO_MAX],
    /// Number of the plan to which the places belong.
    plan: Option<u32>,
    /// Inputs as last read, outputs as requested.
    values: [u32; IO_MAX],
    /// Milliseconds since an input last arrived, or an output was last confirmed.
    missing_ms: [u16; IO_MAX],
    /// Inputs that were open since they arrive, one bit each.
    was_open: u16,
    word_next: u8,
    /// Points whose values are in each sample.
    words: Vec<u8, SAMPLE_WORDS_MAX>,
    /// Value of the pen's output with the pen up and down.
    pen_words: [u32; 2],
    report: IoReport,
}

const _: () = assert!(IO_MAX <= u16::BITS as usize, "a bit for each point");

impl Default for Io {
    fn default() -> Self {
        Self::new()
    }
}

impl Io {
    /// No points.
    pub const fn new() -> Self {
        Self {
            points: Vec::new(),
            places: [None; IO_MAX],
            plan: None,
            values: [0; IO_MAX],
            missing_ms: [u16::MAX; IO_MAX],
            was_open: 0,
            word_next: 0,
            words: Vec::new(),
            pen_words: [0; 2],
            report: IoReport {
                set: 0,
                valid: 0,
                word: None,
                stop: None,
                hold: None,
                start: false,
            },
        }
    }

    /// Replaces the points; all outputs become 0, and no input has arrived. `pen_words` is the value of the pen's output with
    /// the pen up and down.
    #[cold]
    pub fn configure(&mut self, points: IoPlaces, pen_words: [u32; 2]) {
        *self = Self::new();
        self.words = sampled_words(points.iter().map(|point| point.bits));
        (self.points, self.pen_words) = (points, pen_words);
    }

    /// Requests the value of an output for the following milliseconds.
    #[cold]
    pub fn request(&mut self, io: u8, value: u32) {
        let io = usize::from(io);
        let is_output = self
            .points
            .get(io)
            .is_some_and(|point| point.direction == IoDirection::Out);
        if let Some(requested) = self.values.get_mut(io).filter(|_| is_output) {
            *requested = value;
        }
    }

    /// Switches off the outputs that do not keep their values at a fault.
    #[cold]
    pub fn switch_off(&mut self) {
        for (point, value) in self.points.iter().zip(&mut self.values) {
            if point.direction == IoDirection::Out && !point.is_kept {
                *value = 0;
            }
        }
    }

    /// The points in this millisecond.
    #[inline]
    pub const fn report(&self) -> &IoReport {
        &self.report
    }

    /// Copies the values of the words that are in each sample; the rest of `to` is left as it is.
    #[inline]
    pub fn copy_words(&self, to: &mut [u32; SAMPLE_WORDS_MAX]) {
        for (io, to) in self.words.iter().zip(to) {
            *to = self.values.get(usize::from(*io)).copied().unwrap_or(0);
        }
    }

    /// Whether an input is open; `None` while it does not arrive.
    pub(super) fn is_open(&self, io: u8) -> Option<bool> {
        let bit = 1_u16.checked_shl(io.into())?;
        (self.report.valid & bit != 0).then_some(self.report.set & bit == 0)
    }

    /// The emergency stop that is open.
    #[inline]
    pub fn interlock(&self) -> Option<Interlock> {
        let stop = self.report.stop.filter(IoStop::is_interlock);
        stop.map(|stop| Interlock::Input { io: stop.io })
    }

    /// Whether the bus has terminals whose failure is no fault.
    #[inline]
    pub fn spares_terminals(&self) -> bool {
        let spares = |point: &IoPlace| {
            let here = |other: &IoPlace| other.slave == point.slave && other.role.is_needed();
            !self.points.iter().any(here)
        };
        self.points.iter().any(spares)
    }

    /// Takes this millisecond's inputs. An input counts as missing after `missing_max_ms` without it, an output after as long
    /// without its terminal's confirmation.
    #[inline]
    pub fn read(&mut self, group: &impl IoGroup, missing_max_ms: u16) {
        if !self.points.is_empty() {
            self.read_points(group, missing_max_ms);
        }
    }

    #[inline(never)]
    fn read_points(&mut self, group: &impl IoGroup, missing_max_ms: u16) {
        if self.plan != Some(group.terminal_plan()) {
            self.find(group);
        }
        let mut report = IoReport {
            word: self.next_word(),
            ..IoReport::default()
        };
        let states = self.values.iter_mut().zip(&mut self.missing_ms);
        let points = self.points.iter().zip(&self.places).zip(states);
        for (io, ((point, place), (value, missing_ms))) in (0_u8..).zip(points) {
            let bit = 1_u16 << (io & 15);
            let Some(place) = place else {
                // A terminal that is not in operation is missing at once.
                report.miss(io, point, InputCause::Missing);
                continue;
            };
            if point.direction == IoDirection::Out {
                *missing_ms = match group.terminal_confirms(point.slave.into()) {
                    true => 0,
                    false => missing_ms.saturating_add(1),
                };
                // One lost telegram is never a fault.
                if *missing_ms > missing_max_ms.max(1) {
                    report.miss(io, point, InputCause::Missing);
                    continue;
                }
                report.valid |= bit;
                report.set |= if *value != 0 { bit } else { 0 };
                continue;
            }
            match group.terminal_value(place) {
                Some(arrived) => (*value, *missing_ms) = (arrived, 0),
                None => *missing_ms = missing_ms.saturating_add(1),
            }
            if *missing_ms > missing_max_ms {
                report.miss(io, point, InputCause::Missing);
                self.was_open &= !bit;
                continue;
            }
            report.valid |= bit;
            match *value {
                0 => {
                    if point.role != IoRole::Limit || self.was_open & bit == 0 {
                        report.miss(io, point, InputCause::Open);
                    }
                    self.was_open |= bit;
                }
                _ => {
                    report.set |= bit;
                    report.start |= point.role == IoRole::Start && self.was_open & bit != 0;
                    if point.role == IoRole::Limit {
                        self.was_open &= !bit;
                    }
                }
            }
        }
        self.report = report;
    }

    /// The next point that is no bit, and its value.
    fn next_word(&mut self) -> Option<(u8, u32)> {
        let from = self.word_next;
        let points = || (0_u8..).zip(self.points.iter().zip(&self.values));
        let is_word = |(_, (point, _)): &(u8, (&IoPlace, &u32))| point.bits > 1;
        let after = points().find(|next| next.0 >= from && is_word(next));
        let (io, (_, value)) = after.or_else(|| points().find(is_word))?;
        let word = (io, *value);
        self.word_next = io.wrapping_add(1);
        Some(word)
    }

    /// Finds the places of a new plan. An output that has none becomes 0.
    #[cold]
    fn find(&mut self, group: &impl IoGroup) {
        self.plan = Some(group.terminal_plan());
        let states = self.values.iter_mut().zip(&mut self.missing_ms);
        let points = self.points.iter().zip(&mut self.places).zip(states);
        for (io, ((point, place), (value, missing_ms))) in (0_u8..).zip(points) {
            let (slave, direction) = (point.slave.into(), point.direction.into());
            let found = match point.bit {
                Some(bit) => group.terminal_bits(slave, direction, bit, point.bits),
                None => group.terminal_object(slave, direction, io.into(), point.bits),
            };
            if found.is_none() {
                *missing_ms = u16::MAX;
                self.was_open &= !(1 << (io & 15));
                if point.direction == IoDirection::Out && point.role != IoRole::Lamp {
                    *value = 0;
                }
            }
            *place = found;
        }
    }

    /// Writes the outputs; with `has_fault`, those that do not keep their values become 0, and the pen is up. `pen` is whether
    /// the pen is lowered, `tool` the value of the tool.
    #[inline]
    pub fn write(&mut self, group: &mut impl IoGroup, has_fault: bool, pen: bool, tool: ToolValue) {
        if !self.points.is_empty() {
            self.write_points(group, has_fault, pen, tool);
        }
    }

    #[inline(never)]
    fn write_points(&mut self, group: &mut impl IoGroup, has_fault: bool, pen: bool, tool: ToolValue) {
        let [up, down] = self.pen_words;
        let pen = if pen && !has_fault { down } else { up };
        let points = self.points.iter().zip(&self.places).zip(&mut self.values);
        for (io, ((point, place), value)) in (0_u8..).zip(points) {
            if point.direction == IoDirection::In {
                continue;
            }
            if point.role == IoRole::Pen {
                *value = pen;
            } else if point.role == IoRole::Tool {
                *value = if point.bits == 1 { tool.bit } else { tool.word };
            } else if has_fault && !point.is_kept {
                *value = 0;
            }
            if let Some(place) = place {
                group.set_terminal_value(place, *value);
                let bit = 1 << (io & 15);
                self.report.set = self.report.set & !bit | if *value != 0 { bit } else { 0 };
            }
        }
    }
}

impl IoReport {
    /// Notes an input that is open or missing.
    #[inline]
    fn miss(&mut self, io: u8, point: &IoPlace, cause: InputCause) {
        let role = point.role;
        if role.stops() {
            let axis = point.axis;
            let stop = IoStop { io, role, axis, cause };
            // An open emergency stop comes before all others: it lasts without power too. A limit switch comes last: in a
            // search it is none.
            if self
                .stop
                .is_none_or(|known| stop.is_interlock() && !known.is_interlock() || known.is_limit())
            {
                self.stop = Some(stop);
            }
        } else if role == IoRole::Hold {
            self.hold.get_or_insert(io);
        }
    }
}
