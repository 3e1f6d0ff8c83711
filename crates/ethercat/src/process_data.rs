//! Process data of a slave: its share of the logical memory, and the sync managers and FMMUs that move it.
//!
//! Invariant: the shares of two slaves never overlap.

use crate::acyclic::{AcyclicPort, Request};
use crate::configure::discovery::write_managers;
use crate::configure::own_data::OwnData;
use crate::configure::{Direction, SYNC_MANAGER_OUTPUTS};
use crate::cyclic::{CyclicSlave, SPAN_BYTES_MAX};
use crate::driver::{ProcessData, Role, SlaveFactory};
use crate::error::BusError;
use crate::slave::Slave;
use crate::wire::register::{self, FMMU_LEN, FmmuRepr, SYNC_MANAGER_LEN, SyncManagerRepr};
use crate::wire::{Address, Command};
use core::ops::Range;

/// Start of the slaves' process data in the logical memory. Each slave has [`SPAN_BYTES_MAX`] bytes: its inputs, and
/// directly behind them its outputs, so that one datagram may carry both. Inputs at the beginning of a datagram are taken
/// fastest.
pub const LOGICAL_START: u32 = 0x0001_0000;

/// Watchdog units (100 us) in a millisecond.
const WATCHDOG_UNITS_PER_MS: u16 = 10;
/// Watchdog of the slave's own processor: 100 ms, the slave controllers' default.
const WATCHDOG_PDI_UNITS: u16 = 1_000;

/// A slave's share of the logical memory: empty for slaves that are not configured yet, without a role for slaves that
/// are no members. Outputs of slaves that the application does not use stay 0.
pub fn cyclic_slave<F: SlaveFactory>(slave: &Slave<F>) -> CyclicSlave<F> {
    let (output_length, input_length) = slave.lengths();
    if (slave.process_data, slave.own_data) == (None, None) {
        return CyclicSlave::default();
    }
    let role = slave.member.zip(slave.device).zip(slave.process_data);
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
    if let Some(data) = &slave.own_data {
        return set_up_own(port, slave, data, watchdog_ms).await;
    }
    let Some(data) = slave.process_data else {
        return Ok(());
    };
    let ProcessData { windows, .. } = data;
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
        manager(windows.outputs, outputs, register::CONTROL_OUTPUTS),
        manager(windows.inputs, inputs, register::CONTROL_INPUTS),
    ];
    write_managers(port, station, SYNC_MANAGER_OUTPUTS, &managers).await?;
    let share = cyclic_slave(slave);
    let mappings = [
        FmmuRepr::bytes(share.output_address, outputs, windows.outputs, false),
        FmmuRepr::bytes(share.input_address, inputs, windows.inputs, true),
    ];
    let mut registers = [0; 2 * FMMU_LEN];
    for (mapping, bytes) in mappings.iter().zip(registers.chunks_exact_mut(FMMU_LEN)) {
        // Each part has the length of the structure.
        let _ = mapping.emit(bytes);
    }
    port.write(station, register::FMMU, &registers).await
}

/// Sets up a terminal's sync managers as its SII describes them, an FMMU for each, and the watchdog of its outputs.
async fn set_up_own<F: SlaveFactory, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &Slave<F>,
    data: &OwnData,
    watchdog_ms: u16,
) -> Result<(), BusError> {
    let station = slave.station();
    if data.length(Direction::Outputs) > 0 {
        watchdogs(port, station, watchdog_ms).await?;
    }
    let share = cyclic_slave(slave);
    let (mut outputs, mut inputs) = (share.output_address, share.input_address);
    for (number, manager) in (0..).zip(data.managers()) {
        let mut registers = [0; SYNC_MANAGER_LEN];
        let described = SyncManagerRepr {
            start: manager.start,
            length: manager.length.into(),
            control: manager.control,
            activate: register::SYNC_MANAGER_ENABLE,
            ..SyncManagerRepr::default()
        };
        // The parts have the lengths of the structures.
        let _ = described.emit(&mut registers);
        port.write(station, register::sync_manager(manager.number), &registers)
            .await?;
        let logical = if manager.is_input { &mut inputs } else { &mut outputs };
        let mapping = FmmuRepr::bytes(*logical, manager.length.into(), manager.start, manager.is_input);
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
    use crate::configure::Windows;
    use crate::no_drivers::NoDrivers;
    use crate::wire::write_bytes;
    use core::pin::pin;
    use core::task::{Context, Poll, Waker};
    use heapless::spsc::Queue;
    use std::vec::Vec;

    const WINDOWS: Windows = Windows {
        outputs: 0x1100,
        inputs: 0x1180,
    };

    /// The registers of a slave that was set up for this many bytes of outputs and of inputs.
    fn registers(output_length: u16, input_length: u16) -> Vec<u8> {
        let slave = Slave::<NoDrivers> {
            process_data: Some(ProcessData {
                windows: WINDOWS,
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
        for (outputs, inputs) in (0..=3).flat_map(|outputs| (0..=3).map(move |inputs| (outputs, inputs))) {
            let registers = registers(outputs, inputs);
            let manager = |number| {
                let at = usize::from(register::sync_manager(number));
                let manager = SyncManagerRepr::parse(&registers[at..]).expect("a sync manager");
                (manager.start, manager.length, manager.activate)
            };
            let mapping = |number| {
                let at = usize::from(register::fmmu(number));
                let mapping = FmmuRepr::parse(&registers[at..]).expect("an FMMU");
                (mapping.physical_start, mapping.length, mapping.active)
            };
            let what = std::format!("{outputs} bytes of outputs, {inputs} of inputs");
            assert_eq!(manager(2), (WINDOWS.outputs, outputs, u8::from(outputs > 0)), "{what}");
            assert_eq!(manager(3), (WINDOWS.inputs, inputs, u8::from(inputs > 0)), "{what}");
            assert_eq!(mapping(0), (WINDOWS.outputs, outputs, outputs > 0), "{what}");
            assert_eq!(mapping(1), (WINDOWS.inputs, inputs, inputs > 0), "{what}");
        }
    }
}
