//! Layout of a drive's values in its process data.
//!
//! A [`LayoutBuilder`] takes the mapped objects in their order, from any source, and makes a [`ProcessLayout`]: the
//! byte offset of each value of the drive's outputs and inputs. The critical task loads and stores at these offsets and
//! needs nothing else.
//!
//! Invariants: a layout exists only if everything that its mode needs is mapped, with whole bytes at whole bytes, and
//! both directions fit [`PROCESS_BYTES_MAX`]; reading and writing never leave the bytes given.

use super::cia402::StatusWord;
use super::position_range::PositionRange;
use super::{
    AxisMode, CONTROL_WORD, DriveInput, DriveOutput, ModeDescription, OPERATION_MODE, OPERATION_MODE_DISPLAY, POSITION,
    POSITION_INTERNAL, STATUS_WORD, TARGET_POSITION,
};
use etherpen_ethercat::cyclic::PROCESS_BYTES_MAX;
use etherpen_ethercat::driver::Entry;
use etherpen_ethercat::error::BusError;
use etherpen_ethercat::wire::coe::Object;
use etherpen_ethercat::wire::{read_u8, read_u16, read_u32};

/// Offset of a value that is not mapped; beyond any process data.
const ABSENT: u8 = u8::MAX;

const _: () = assert!(PROCESS_BYTES_MAX < ABSENT as usize);

/// The drive has taken the choice of its process data, as equal drives then do.
pub(crate) const CHOSEN: u8 = 1 << 0;
/// The drive has shown its mode already, outside the process data.
pub(crate) const MODE_SHOWN: u8 = 1 << 1;

/// Byte offsets of a drive's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessLayout {
    /// The kind of demand.
    pub mode: AxisMode,
    /// Length of the outputs, bytes.
    pub output_length: u8,
    /// Length of the inputs, bytes.
    pub input_length: u8,
    operation_mode: i8,
    control: u8,
    demand: u8,
    mode_output: u8,
    target_position: u8,
    position: u8,
    status: u8,
    mode_display: u8,
    /// What the set-up has found. One byte: every plan holds a layout for each slave.
    found: u8,
    /// Range of the position; known in position mode only.
    pub(crate) range: PositionRange,
}

impl ProcessLayout {
    /// Whether the drive shows its mode in each cycle.
    pub const fn shows_mode(&self) -> bool {
        self.mode_display != ABSENT
    }

    /// Notes what the set-up has found: [`CHOSEN`] or [`MODE_SHOWN`].
    pub(crate) const fn note(&mut self, what: u8, is_so: bool) {
        self.found = if is_so { self.found | what } else { self.found & !what };
    }

    /// Whether the set-up has found this.
    pub(crate) const fn has_found(&self, what: u8) -> bool {
        self.found & what != 0
    }

    /// Range of the drive's position; known in position mode only.
    pub const fn range(&self) -> PositionRange {
        self.range
    }

    /// Decodes inputs; `None` when there are too few bytes.
    #[inline]
    pub fn decode(&self, inputs: &[u8]) -> Option<DriveInput> {
        if inputs.len() < usize::from(self.input_length) {
            return None;
        }
        let shown = read_u8(inputs, self.mode_display.into()).cast_signed();
        Some(DriveInput {
            position: read_u32(inputs, self.position.into()).cast_signed(),
            status: StatusWord(read_u16(inputs, self.status.into())),
            mode_in_effect: self.mode_display == ABSENT || shown == self.operation_mode,
        })
    }

    /// Encodes outputs; a value that does not fit is left out.
    #[inline]
    pub fn encode(&self, output: &DriveOutput, outputs: &mut [u8]) {
        write(outputs, self.control, output.control.0.to_le_bytes());
        match self.mode {
            AxisMode::Velocity | AxisMode::Position => {
                write(outputs, self.demand, output.demand_digits.to_le_bytes());
            }
            AxisMode::Torque => {
                let digits = output.demand_digits.clamp(i16::MIN.into(), i16::MAX.into()) as i16;
                write(outputs, self.demand, digits.to_le_bytes());
            }
        }
        if self.mode_output != ABSENT {
            write(outputs, self.mode_output, self.operation_mode.to_le_bytes());
        }
        if self.target_position != ABSENT {
            write(outputs, self.target_position, output.position.to_le_bytes());
        }
    }
}

/// Writes a value of known length in a single store; writes nothing if it does not fit.
#[inline(always)]
fn write<const LENGTH: usize>(outputs: &mut [u8], offset: u8, value: [u8; LENGTH]) {
    if let Some(place) = outputs.get_mut(offset.into()..).and_then(<[u8]>::first_chunk_mut) {
        *place = value;
    }
}

/// One value to find.
#[derive(Clone, Copy, Debug)]
struct Wanted {
    object: Object,
    bits: u8,
    offset: u8,
}

impl Wanted {
    const fn new(object: Object, bits: u8) -> Self {
        Self {
            object,
            bits,
            offset: ABSENT,
        }
    }

    /// Takes an entry that begins at bit `at`, if it is the wanted one.
    fn take(&mut self, entry: Entry, at: u16) -> Result<(), BusError> {
        if entry.object != self.object || self.offset != ABSENT {
            return Ok(());
        }
        if entry.bits != self.bits {
            return Err(self.mismatch(entry.bits));
        }
        if !at.is_multiple_of(8) {
            return Err(BusError::Alignment {
                object: self.object,
                bit: at,
            });
        }
        // `finish` refuses process data that are long enough for an offset above 255.
        self.offset = u8::try_from(at / 8).unwrap_or(ABSENT);
        Ok(())
    }

    fn mismatch(&self, actual: u8) -> BusError {
        BusError::Mapping {
            object: self.object,
            expected: self.bits,
            actual,
        }
    }

    fn required(&self) -> Result<u8, BusError> {
        if self.offset == ABSENT {
            Err(self.mismatch(0))
        } else {
            Ok(self.offset)
        }
    }
}

/// Finds the values of one mode among the mapped objects.
#[derive(Clone, Debug)]
pub struct LayoutBuilder {
    mode: AxisMode,
    operation_mode: i8,
    output_bits: u16,
    input_bits: u16,
    /// Control word, demand, mode, target position.
    outputs: [Wanted; 4],
    /// Status word, position, its substitute, mode in effect.
    inputs: [Wanted; 4],
}

impl LayoutBuilder {
    /// A builder for a mode of a drive.
    pub const fn new(mode: AxisMode, description: &ModeDescription) -> Self {
        let demand_bits = match mode {
            AxisMode::Velocity | AxisMode::Position => 32,
            AxisMode::Torque => 16,
        };
        Self {
            mode,
            operation_mode: description.operation_mode,
            output_bits: 0,
            input_bits: 0,
            outputs: [
                Wanted::new(CONTROL_WORD, 16),
                Wanted::new(description.demand, demand_bits),
                Wanted::new(OPERATION_MODE, 8),
                Wanted::new(TARGET_POSITION, 32),
            ],
            inputs: [
                Wanted::new(STATUS_WORD, 16),
                Wanted::new(POSITION, 32),
                Wanted::new(POSITION_INTERNAL, 32),
                Wanted::new(OPERATION_MODE_DISPLAY, 8),
            ],
        }
    }

    /// Takes the next entry of the outputs.
    ///
    /// # Errors
    /// [`BusError::Mapping`] for a value whose length is wrong, [`BusError::Alignment`] for one that does not begin
    /// with a byte.
    pub fn output(&mut self, entry: Entry) -> Result<(), BusError> {
        let at = self.output_bits;
        self.output_bits = at.saturating_add(entry.bits.into());
        self.outputs.iter_mut().try_for_each(|wanted| wanted.take(entry, at))
    }

    /// Takes the next entry of the inputs.
    ///
    /// # Errors
    /// As [`Self::output`].
    pub fn input(&mut self, entry: Entry) -> Result<(), BusError> {
        let at = self.input_bits;
        self.input_bits = at.saturating_add(entry.bits.into());
        self.inputs.iter_mut().try_for_each(|wanted| wanted.take(entry, at))
    }

    /// Makes the layout after all entries.
    ///
    /// # Errors
    /// [`BusError::ProcessLength`] when a direction is longer than [`PROCESS_BYTES_MAX`], [`BusError::Mapping`] when a
    /// value that the mode needs is not mapped.
    pub fn finish(&self) -> Result<ProcessLayout, BusError> {
        let length = |bits: u16| match bits.div_ceil(8) {
            actual if usize::from(actual) > PROCESS_BYTES_MAX => Err(BusError::ProcessLength {
                expected: PROCESS_BYTES_MAX as u16,
                actual,
            }),
            bytes => Ok(bytes as u8),
        };
        let [control, demand, mode_output, target_position] = self.outputs;
        let [status, position, internal, mode_display] = self.inputs;
        Ok(ProcessLayout {
            mode: self.mode,
            output_length: length(self.output_bits)?,
            input_length: length(self.input_bits)?,
            operation_mode: self.operation_mode,
            control: control.required()?,
            demand: match self.mode {
                AxisMode::Velocity | AxisMode::Torque => demand.required()?,
                // The velocity offset only makes the drive follow more closely.
                AxisMode::Position => demand.offset,
            },
            mode_output: mode_output.offset,
            target_position: match self.mode {
                AxisMode::Velocity | AxisMode::Torque => target_position.offset,
                AxisMode::Position => target_position.required()?,
            },
            position: position
                .required()
                .or_else(|error| internal.required().map_err(|_| error))?,
            status: status.required()?,
            mode_display: mode_display.offset,
            found: 0,
            range: PositionRange::WHOLE,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cia402::ControlWord;
    use crate::{DriveDescription, akd, ax2000, generic};

    fn layout(drive: &DriveDescription, mode: AxisMode) -> Result<ProcessLayout, BusError> {
        let description = drive.mode(mode).unwrap();
        let mut builder = LayoutBuilder::new(mode, description);
        for entry in description.outputs.entries {
            builder.output(*entry)?;
        }
        for entry in description.inputs.entries {
            builder.input(*entry)?;
        }
        builder.finish()
    }

    const ENABLED: DriveOutput = DriveOutput {
        demand_digits: -2,
        position: 0,
        control: ControlWord(0x000F),
    };

    fn encoded(layout: &ProcessLayout, output: &DriveOutput) -> std::vec::Vec<u8> {
        let mut bytes = std::vec![0; layout.output_length.into()];
        layout.encode(output, &mut bytes);
        bytes
    }

    #[test]
    fn the_ax2000_in_digital_speed_has_six_bytes_each_way() {
        let layout = layout(&ax2000::AX2000, AxisMode::Velocity).unwrap();
        assert_eq!(encoded(&layout, &ENABLED), [0xFE, 0xFF, 0xFF, 0xFF, 0x0F, 0x00]);
        let input = layout.decode(&[0x00, 0x00, 0x10, 0x00, 0x37, 0x06]).unwrap();
        assert_eq!((input.position, input.status), (1 << 20, StatusWord(0x0637)));
        assert!(input.mode_in_effect);
        assert_eq!(layout.decode(&[0; 5]), None);
    }

    #[test]
    fn the_ax2000_in_digital_current_has_four_bytes_out_and_eight_in() {
        let layout = layout(&ax2000::AX2000, AxisMode::Torque).unwrap();
        assert_eq!(encoded(&layout, &ENABLED), [0xFE, 0xFF, 0x0F, 0x00]);
        let input = layout.decode(&[0x00, 0x00, 0x10, 0x00, 1, 2, 0x37, 0x06]).unwrap();
        assert_eq!((input.position, input.status), (1 << 20, StatusWord(0x0637)));
        let far = DriveOutput {
            demand_digits: 40_000,
            ..ENABLED
        };
        assert_eq!(encoded(&layout, &far), [0xFF, 0x7F, 0x0F, 0x00]);
    }

    #[test]
    fn every_description_maps_what_its_modes_need() {
        for drive in [&ax2000::AX2000, &akd::AKD, &generic::GENERIC] {
            for mode in [AxisMode::Velocity, AxisMode::Torque, AxisMode::Position] {
                if drive.mode(mode).is_some() {
                    layout(drive, mode).unwrap();
                }
            }
        }
    }

    /// The long objects of a drive with several modes in its process data, behind a gap.
    fn all_modes() -> LayoutBuilder {
        let mut builder = LayoutBuilder::new(AxisMode::Velocity, generic::GENERIC.velocity.as_ref().unwrap());
        for value in [0x6040_0010, 0x607A_0020, 0x0000_0008, 0x60FF_0020, 0x6060_0008] {
            builder.output(Entry::from_mapping(value)).unwrap();
        }
        for value in [0x6041_0010, 0x6064_0020, 0x606C_0020, 0x6061_0008] {
            builder.input(Entry::from_mapping(value)).unwrap();
        }
        builder
    }

    #[test]
    fn a_mapped_mode_is_told_each_cycle_and_a_mapped_target_position_is_where_the_drive_is() {
        let layout = all_modes().finish().unwrap();
        let output = DriveOutput {
            demand_digits: 1,
            position: 0x0403_0201,
            control: ControlWord(0x0006),
        };
        assert_eq!(encoded(&layout, &output), [6, 0, 1, 2, 3, 4, 0, 1, 0, 0, 0, 9]);
        let mut inputs = [0; 11];
        assert!(!layout.decode(&inputs).unwrap().mode_in_effect);
        inputs[10] = 9;
        assert!(layout.decode(&inputs).unwrap().mode_in_effect);
    }

    #[test]
    fn what_is_missing_too_short_or_off_the_byte_is_named() {
        let mut builder = LayoutBuilder::new(AxisMode::Torque, generic::GENERIC.torque.as_ref().unwrap());
        builder.output(Entry::new(CONTROL_WORD, 16)).unwrap();
        let missing = BusError::Mapping {
            object: generic::TARGET_TORQUE,
            expected: 16,
            actual: 0,
        };
        assert_eq!(builder.finish(), Err(missing));
        let short = BusError::Mapping {
            object: generic::TARGET_TORQUE,
            expected: 16,
            actual: 8,
        };
        let mut with_short = builder.clone();
        assert_eq!(with_short.output(Entry::new(generic::TARGET_TORQUE, 8)), Err(short));
        builder.output(Entry::new(Object::new(0, 0), 3)).unwrap();
        let odd = BusError::Alignment {
            object: generic::TARGET_TORQUE,
            bit: 19,
        };
        assert_eq!(builder.output(Entry::new(generic::TARGET_TORQUE, 16)), Err(odd));
    }

    #[test]
    fn more_process_data_than_there_is_room_for_are_refused() {
        let mut builder = all_modes();
        for _ in 0..1_000 {
            builder.input(Entry::new(Object::new(0x2000, 0), 255)).unwrap();
        }
        assert_eq!(
            builder.finish(),
            Err(BusError::ProcessLength {
                expected: 32,
                actual: u16::MAX.div_ceil(8)
            })
        );
    }

    #[test]
    fn foreign_lengths_of_bytes_are_read_and_written_within_their_bounds() {
        let layout = all_modes().finish().unwrap();
        for length in 0..16 {
            let mut bytes = std::vec![0; length];
            layout.encode(&ENABLED, &mut bytes);
            assert_eq!(layout.decode(&bytes).is_some(), length >= 11);
        }
    }
}
