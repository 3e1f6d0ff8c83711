//! A group of drives in memory, for control code without a bus: its tests set the inputs and read the outputs.
//!
//! A trigger returns a frame of one byte, so that a test's port has something to send; a frame equal to
//! [`ARRIVED`](MemoryGroup::ARRIVED) brings the inputs.

use crate::io::{BusState, GroupDrive, IoGroup, IoTrigger};
use crate::{DriveInput, DriveOutput};
use etherpen_ethercat::cyclic::{Arrival, BusCounters, ExchangeKind, Ignored};
use etherpen_ethercat::encapsulation::Encapsulation;

/// Drives whose inputs and outputs are in memory.
#[derive(Clone, Debug)]
pub struct MemoryGroup<const MEMBERS: usize> {
    /// The drives; [`IoGroup::renew`] reports every change.
    pub drives: [Option<GroupDrive>; MEMBERS],
    /// What the drives report in the next cycles; `None` for silence.
    pub inputs: [Option<DriveInput>; MEMBERS],
    /// Last outputs of the drives.
    pub outputs: [DriveOutput; MEMBERS],
    /// State of the bus in the next cycles.
    pub state: BusState,
    arrived: bool,
    known: [Option<GroupDrive>; MEMBERS],
    counters: BusCounters,
}

impl<const MEMBERS: usize> MemoryGroup<MEMBERS> {
    /// The frame that an input trigger sends, and that brings the inputs.
    pub const ARRIVED: [u8; 1] = [1];
    /// The frame that an output trigger sends.
    pub const OUTPUT: [u8; 1] = [2];

    /// A group of drives that have reported nothing.
    pub const fn new(drives: [Option<GroupDrive>; MEMBERS]) -> Self {
        const SILENT: DriveOutput = DriveOutput {
            demand_digits: 0,
            position: 0,
            control: crate::cia402::ControlWord::DISABLE_VOLTAGE,
        };
        Self {
            drives,
            inputs: [None; MEMBERS],
            outputs: [SILENT; MEMBERS],
            state: BusState {
                al_status: None,
                reference_clock: None,
                time_number: 0,
                clock_ns: None,
            },
            arrived: false,
            known: [None; MEMBERS],
            counters: BusCounters {
                frames_sent: 0,
                frames_lost: 0,
                frames_late: 0,
                working_counter_errors: 0,
                ignored: [0; etherpen_ethercat::cyclic::IGNORED_KINDS],
            },
        }
    }
}

impl<const MEMBERS: usize> IoGroup for MemoryGroup<MEMBERS> {
    fn renew(&mut self) -> bool {
        let changed = self.known != self.drives;
        self.known = self.drives;
        changed
    }

    fn drive(&self, member: usize) -> Option<GroupDrive> {
        *self.drives.get(member)?
    }

    fn read(&self, member: usize) -> Option<DriveInput> {
        self.inputs.get(member)?.filter(|_| self.arrived)
    }

    fn write(&mut self, member: usize, output: &DriveOutput) {
        let has_drive = self.drives.get(member).is_some_and(Option::is_some);
        if let Some(place) = self.outputs.get_mut(member).filter(|_| has_drive) {
            *place = *output;
        }
    }
}

impl<const MEMBERS: usize> IoTrigger for MemoryGroup<MEMBERS> {
    fn trigger_input(&mut self) -> &[u8] {
        self.arrived = false;
        self.counters.frames_sent += 1;
        &Self::ARRIVED
    }

    fn trigger_output(&mut self) -> &[u8] {
        self.counters.frames_sent += 1;
        &Self::OUTPUT
    }

    fn arrived(&mut self, frame: &[u8]) -> Arrival {
        if frame == Self::ARRIVED {
            self.arrived = true;
            Arrival::Input
        } else if frame == Self::OUTPUT {
            Arrival::Output
        } else {
            Arrival::Ignored(Ignored::ForeignIndex)
        }
    }

    fn exchange_kind(&self) -> ExchangeKind {
        ExchangeKind::Split
    }

    fn bus_state(&self) -> BusState {
        match self.arrived {
            true => self.state,
            false => BusState {
                reference_clock: self.state.reference_clock,
                time_number: self.state.time_number,
                ..BusState::default()
            },
        }
    }

    fn counters(&self) -> BusCounters {
        self.counters
    }

    fn set_encapsulation(&mut self, _: Encapsulation) {}
}
