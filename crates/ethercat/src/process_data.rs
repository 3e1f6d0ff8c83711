//! Process data of a slave: its share of the logical memory, and the sync managers and FMMUs that move it.
//!
//! Invariant: the shares of two slaves never overlap.

use crate::acyclic::{AcyclicPort, Request};
use crate::configure::discovery::{self, write_managers};
use crate::configure::own_data::OwnData;
use crate::configure::{Direction, Windows};
use crate::cyclic::{CyclicSlave, SPAN_BYTES_MAX};
use crate::driver::{ProcessData, Role, SlaveFactory};
use crate::error::BusError;
use crate::slave::{Slave, SlaveData};
use crate::wire::register::{self, FMMU_LEN, FmmuRepr, SYNC_MANAGER_LEN, SyncManagerRepr};
use crate::wire::{Address, Command};
use core::ops::Range;

/// Start of the slaves' process data in the logical memory. Each slave has [`SPAN_BYTES_MAX`] bytes: its inputs, and
/// directly behind them its outputs, so that one datagram may carry both. Inputs at the beginning of a datagram are taken
/// fastest.
pub const LOGICAL_START: u32 = 0x0001_0000;

/// FMMUs that any controller has which exchanges outputs and inputs.
const FMMUS_OF_ANY: usize = 2;
/// Watchdog units (100 us) in a millisecond.
const WATCHDOG_UNITS_PER_MS: u16 = 10;
/// Watchdog of the slave's own processor: 100 ms, the slave controllers' default.
const WATCHDOG_PDI_UNITS: u16 = 1_000;

/// A slave's share of the logical memory: empty for slaves that are not configured yet, without a role for slaves that
/// are no members. Outputs of slaves that the application does not use stay 0.
pub fn cyclic_slave<F: SlaveFactory>(slave: &Slave<F>) -> CyclicSlave<F> {
    let (output_length, input_length) = slave.lengths();
    if !slave.data.is_known() {
        return CyclicSlave::default();
    }
    let role = slave.member.zip(slave.device).zip(slave.data.of_driver());
    let start = share(slave).start;
    CyclicSlave {
        input_address: start,
        input_length,
        output_address: start + u32::from(input_length),
        output_length,
        watched: false,
        role: role.map(|((member, device), data)| Role {
            member,
            device,
            layout: data.layout,
        }),
        generation: slave.generation,
    }
}

/// A slave's share of the logical memory, whether it has process data or not.
pub fn share<F: SlaveFactory>(slave: &Slave<F>) -> Range<u32> {
    let start = LOGICAL_START + u32::from(slave.position) * SPAN_BYTES_MAX as u32;
    start..start + SPAN_BYTES_MAX as u32
}

/// Sets up process-data sync managers, FMMUs and watchdogs, in PREOP.
///
/// `watchdog_ms` is the sync managers' watchdog; 0 switches it off.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn set_up<F: SlaveFactory, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &Slave<F>,
    watchdog_ms: u16,
) -> Result<(), BusError> {
    match &slave.data {
        SlaveData::Unknown => Ok(()),
        SlaveData::OfDriver(data) => set_up_of_driver(port, slave, data, watchdog_ms).await,
        SlaveData::Own(data) => set_up_own(port, slave, data, watchdog_ms).await,
    }
}

/// Sets up the sync managers and FMMUs of both directions, and the watchdogs.
async fn set_up_of_driver<F: SlaveFactory, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &Slave<F>,
    data: &ProcessData<F>,
    watchdog_ms: u16,
) -> Result<(), BusError> {
    let Windows {
        outputs: to,
        inputs: from,
    } = data.windows;
    let station = slave.station();
    watchdogs(port, station, watchdog_ms).await?;
    let (outputs, inputs) = (data.output_length, data.input_length);
    let manager = |start, length, control| SyncManagerRepr {
        start,
        length,
        control,
        // Slaves refuse SAFEOP for one that is enabled and has no bytes.
        activate: if length > 0 { register::SYNC_MANAGER_ENABLE } else { 0 },
        ..SyncManagerRepr::default()
    };
    let managers = [
        manager(to.start, outputs, register::CONTROL_OUTPUTS),
        manager(from.start, inputs, register::CONTROL_INPUTS),
    ];
    write_managers(port, station, [to.manager, from.manager], &managers).await?;
    let share = cyclic_slave(slave);
    let mappings = [
        FmmuRepr::bytes(share.output_address, outputs, to.start, false),
        FmmuRepr::bytes(share.input_address, inputs, from.start, true),
    ];
    let mut registers = [0; 2 * FMMU_LEN];
    for (mapping, bytes) in mappings.iter().zip(registers.chunks_exact_mut(FMMU_LEN)) {
        // Each part has the length of the structure.
        let _ = mapping.emit(bytes);
    }
    port.write(station, register::FMMU, &registers).await
}

/// Sets up a terminal's sync managers as its SII describes them, an FMMU for each, and the watchdog of its outputs.
///
/// # Errors
/// [`BusError::SyncManagers`] for more than the controller has FMMUs, or as [`AcyclicPort::send_until_counted`].
async fn set_up_own<F: SlaveFactory, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &Slave<F>,
    data: &OwnData,
    watchdog_ms: u16,
) -> Result<(), BusError> {
    let station = slave.station();
    let managers = data.managers().count();
    if managers > FMMUS_OF_ANY {
        let fmmus = discovery::fmmus(port, station).await?;
        if fmmus != 0 && managers > fmmus.into() {
            return Err(BusError::SyncManagers {
                expected: fmmus,
                actual: managers as u8,
            });
        }
    }
    if data.length(Direction::Outputs) > 0 {
        watchdogs(port, station, watchdog_ms).await?;
    }
    let share = cyclic_slave(slave);
    let (mut outputs, mut inputs) = (share.output_address, share.input_address);
    for (number, manager) in (0..).zip(data.managers()) {
        let mut registers = [0; SYNC_MANAGER_LEN];
        let described = SyncManagerRepr {
            start: manager.start(),
            length: manager.length.into(),
            control: manager.control,
            activate: register::SYNC_MANAGER_ENABLE,
            ..SyncManagerRepr::default()
        };
        // The parts have the lengths of the structures.
        let _ = described.emit(&mut registers);
        port.write(station, register::sync_manager(manager.number), &registers)
            .await?;
        let logical = if manager.is_input() { &mut inputs } else { &mut outputs };
        let mapping = FmmuRepr::bytes(*logical, manager.length.into(), manager.start(), manager.is_input());
        *logical += u32::from(manager.length);
        let mut registers = [0; FMMU_LEN];
        let _ = mapping.emit(&mut registers);
        port.write(station, register::fmmu(number), &registers).await?;
    }
    Ok(())
}

async fn watchdogs<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    watchdog_ms: u16,
) -> Result<(), BusError> {
    let units = watchdog_ms.saturating_mul(WATCHDOG_UNITS_PER_MS);
    let requests = [
        (register::WATCHDOG_DIVIDER, register::WATCHDOG_DIVIDER_100_US),
        (register::WATCHDOG_PDI, WATCHDOG_PDI_UNITS),
        (register::WATCHDOG_SYNC_MANAGER, units),
    ]
    .map(|(at, value)| Request::write(Command::Fpwr, Address::station(station, at), &value.to_le_bytes()));
    port.send_all_until_counted(&requests, 1, |_, _| {}).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acyclic::{IN_FLIGHT_MAX, Lane, Outcome, Reply};
    use crate::configure::objects::Window;
    use crate::no_drivers::NoDrivers;
    use crate::wire::write_bytes;
    use core::pin::pin;
    use core::task::{Context, Poll, Waker};
    use heapless::spsc::Queue;
    use std::vec::Vec;

    const OUTPUTS: u16 = 0x1100;
    const INPUTS: u16 = 0x1180;

    /// The registers of a slave that was set up for this many bytes of outputs and of inputs in these sync managers.
    fn registers(windows: Windows, output_length: u16, input_length: u16) -> Vec<u8> {
        let slave = Slave::<NoDrivers> {
            data: SlaveData::OfDriver(ProcessData {
                windows,
                output_length,
                input_length,
                layout: (),
            }),
            ..Slave::at(0)
        };
        let mut registers = std::vec![0xFF; 0x1000];
        let mut requests = Queue::<Request, { IN_FLIGHT_MAX + 1 }>::new();
        let mut replies = Queue::<Reply, { IN_FLIGHT_MAX + 1 }>::new();
        let (mut messages, mut answers) = (Queue::<Request<32>, 2>::new(), Queue::<Reply<32>, 2>::new());
        let (ask, mut asked) = requests.split();
        let (mut give, given) = replies.split();
        let message_lane = Lane::new(messages.split().0, answers.split().1);
        let mut port = AcyclicPort::new(Lane::new(ask, given), message_lane);
        let mut work = pin!(set_up(&mut port, &slave, 100));
        let result = (0..100).find_map(|_| {
            let poll = work.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            while let Some(Request { address, data, .. }) = asked.dequeue() {
                write_bytes(&mut registers, address.register().into(), &data);
                let outcome = Outcome::Processed { working_counter: 1 };
                assert!(give.enqueue(Reply { data, outcome }).is_ok());
            }
            match poll {
                Poll::Ready(result) => Some(result),
                Poll::Pending => None,
            }
        });
        assert_eq!(result, Some(Ok(())));
        registers
    }

    #[test]
    fn a_slave_gets_sync_managers_and_mappings_that_are_on_only_where_it_has_bytes() {
        let pairs = |values: Range<u16>| {
            values
                .clone()
                .flat_map(move |one| values.clone().map(move |other| (one, other)))
        };
        let numbers = pairs(2..8).filter(|(to, from)| to != from);
        let cases = numbers.flat_map(|numbers| pairs(0..4).map(move |lengths| (numbers, lengths)));
        for ((to, from), (outputs, inputs)) in cases {
            let window = |number, start| Window {
                manager: number as u8,
                start,
            };
            let windows = Windows {
                outputs: window(to, OUTPUTS),
                inputs: window(from, INPUTS),
            };
            let registers = registers(windows, outputs, inputs);
            let manager = |number: u16| {
                let at = usize::from(register::sync_manager(number as u8));
                let manager = SyncManagerRepr::parse(&registers[at..]).expect("a sync manager");
                (manager.start, manager.length, manager.activate)
            };
            let mapping = |number| {
                let at = usize::from(register::fmmu(number));
                let mapping = FmmuRepr::parse(&registers[at..]).expect("an FMMU");
                (mapping.physical_start, mapping.length, mapping.active)
            };
            let what = std::format!("{outputs} bytes of outputs in {to}, {inputs} of inputs in {from}");
            assert_eq!(manager(to), (OUTPUTS, outputs, u8::from(outputs > 0)), "{what}");
            assert_eq!(manager(from), (INPUTS, inputs, u8::from(inputs > 0)), "{what}");
            assert_eq!(mapping(0), (OUTPUTS, outputs, outputs > 0), "{what}");
            assert_eq!(mapping(1), (INPUTS, inputs, inputs > 0), "{what}");
            // No other sync manager was written.
            let others = (0..8).filter(|number| ![to, from].contains(number));
            for number in others {
                let at = usize::from(register::sync_manager(number as u8));
                assert_eq!(
                    registers[at..at + SYNC_MANAGER_LEN],
                    [0xFF; SYNC_MANAGER_LEN],
                    "{what}: {number}"
                );
            }
        }
    }
}
