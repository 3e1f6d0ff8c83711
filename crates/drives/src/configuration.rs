//! Configuration of a drive in PREOP: process data of its mode, mode of operation, settings, and the layout.
//!
//! A drive has to take its mode here. It need not show it yet: one whose process data show the mode is watched in each
//! cycle, since some show it only when they have power; any other one has to show it in OP, before it gets power.
//!
//! Invariant: the layout follows the actual lists of the drive; a missing value and a wrong mode are always detected.

use crate::layout::{CHOSEN, LayoutBuilder, MODE_SHOWN, ProcessLayout};
use crate::{
    AxisMode, DriveKind, DriveSettings, INTERPOLATION_PERIOD, ModeDescription, OPERATION_MODE, OPERATION_MODE_DISPLAY,
    POSITION_FIRST, POSITION_LAST, PositionRange, QUICK_STOP_DECELERATION, interpolation_period,
};
use etherpen_ethercat::configure::PreOperational;
use etherpen_ethercat::driver::{Direction, ProcessData, Setting, SlaveFactory};
use etherpen_ethercat::error::BusError;
use etherpen_ethercat::wire::coe::Object;

/// Longest wait in OP for the mode that was set, ms.
const MODE_TIMEOUT_MS: u32 = 500;

/// Chooses a drive's process data, writes its mode and its settings, and makes the layout.
///
/// A drive that accepts the choice, as its twin has, gets the twin's layout; its lists of objects are not read.
///
/// # Errors
/// [`BusError::Range`] when the drive lacks the mode or an object cannot take a value, [`BusError::Mapping`],
/// [`BusError::Alignment`] or [`BusError::ProcessLength`] when its process data cannot be used, [`BusError::SdoAbort`],
/// [`BusError::ReadBack`], [`BusError::PositionRange`] in position mode, or errors of the mailbox.
pub(crate) async fn used<F: SlaveFactory<Layout = ProcessLayout>, const MESSAGE: usize>(
    kind: DriveKind,
    drive: &DriveSettings,
    slave: &mut PreOperational<'_, '_, MESSAGE>,
    twin: Option<&ProcessData<F>>,
) -> Result<ProcessData<F>, BusError> {
    let object = OPERATION_MODE;
    let mode = kind.mode(drive.mode).ok_or(BusError::Range { object })?;
    let object = match interpolation_period(slave.cycle_ns()) {
        None if drive.mode == AxisMode::Position => Object::new(INTERPOLATION_PERIOD, 1),
        _ => QUICK_STOP_DECELERATION,
    };
    let settings = (kind.settings)(drive, slave.cycle_ns()).ok_or(BusError::Range { object })?;

    let outputs_taken = slave.assign(Direction::Outputs, &mode.outputs).await?;
    let inputs_taken = slave.assign(Direction::Inputs, &mode.inputs).await?;
    let is_chosen = outputs_taken && inputs_taken;
    let is_equal =
        |twin: &&ProcessData<F>| is_chosen && twin.layout.has_found(CHOSEN) && twin.layout.mode == drive.mode;
    let mut data = match twin.filter(is_equal) {
        Some(twin) => ProcessData {
            windows: slave.windows(kind.windows).await?,
            ..*twin
        },
        None => lay_out(kind, drive.mode, mode, slave).await?,
    };
    data.layout.note(CHOSEN, is_chosen);
    let operation_mode = Setting::of(OPERATION_MODE, i32::from(mode.operation_mode).cast_unsigned(), 1);
    if data.layout.shows_mode() {
        slave.write(&operation_mode.verified()).await?;
    } else {
        slave.write(&operation_mode).await?;
        // A drive that does not show it yet is asked again in OP.
        let shown = slave.dictionary().read(OPERATION_MODE_DISPLAY, 1).await;
        let expected = u32::from(mode.operation_mode.cast_unsigned());
        data.layout.note(MODE_SHOWN, shown == Ok(expected));
    }
    for setting in &settings {
        slave.write(setting).await?;
    }
    data.layout.range = match drive.mode {
        AxisMode::Position => position_range(drive, slave).await?,
        AxisMode::Velocity | AxisMode::Torque => PositionRange::WHOLE,
    };
    Ok(data)
}

/// The range of a drive's position; [`PositionRange::WHOLE`] for a drive without object 0x607B.
async fn position_range<const MESSAGE: usize>(
    drive: &DriveSettings,
    slave: &mut PreOperational<'_, '_, MESSAGE>,
) -> Result<PositionRange, BusError> {
    let mut ends = [0_i32; 2];
    for (end, object) in ends.iter_mut().zip([POSITION_FIRST, POSITION_LAST]) {
        *end = match slave.dictionary().read(object, 4).await {
            Ok(position) => position.cast_signed(),
            Err(BusError::SdoAbort { .. }) => return Ok(PositionRange::WHOLE),
            Err(error) => return Err(error),
        };
    }
    let [first, last] = ends;
    PositionRange::told(first, last, drive.increments_per_revolution)
}

/// Checks the mode of a drive in OP whose process data do not show it, and which did not show it in PREOP.
///
/// # Errors
/// [`BusError::ReadBack`] when the drive shows another mode for [`MODE_TIMEOUT_MS`], or errors of the mailbox.
pub(crate) async fn confirmed<const MESSAGE: usize>(
    kind: DriveKind,
    layout: &ProcessLayout,
    slave: &mut PreOperational<'_, '_, MESSAGE>,
) -> Result<(), BusError> {
    let is_open = !layout.shows_mode() && !layout.has_found(MODE_SHOWN);
    let Some(mode) = kind.mode(layout.mode).filter(|_| is_open) else {
        return Ok(());
    };
    let expected = u32::from(mode.operation_mode.cast_unsigned());
    slave
        .await_value(OPERATION_MODE_DISPLAY, expected, 1, MODE_TIMEOUT_MS)
        .await
}

/// Chooses the process data of a drive that the application does not use, in its first mode, and makes their layout.
/// Mode and settings of the drive are not written.
///
/// # Errors
/// As [`used`], except errors of mode and settings.
pub(crate) async fn unused<F: SlaveFactory<Layout = ProcessLayout>, const MESSAGE: usize>(
    kind: DriveKind,
    slave: &mut PreOperational<'_, '_, MESSAGE>,
) -> Result<Option<ProcessData<F>>, BusError> {
    let mut modes = [AxisMode::Velocity, AxisMode::Torque, AxisMode::Position].into_iter();
    let Some((axis_mode, mode)) = modes.find_map(|mode| Some((mode, kind.mode(mode)?))) else {
        return Ok(None);
    };
    slave.assign(Direction::Outputs, &mode.outputs).await?;
    slave.assign(Direction::Inputs, &mode.inputs).await?;
    lay_out(kind, axis_mode, mode, slave).await.map(Some)
}

/// Makes the layout from the drive's actual process data.
async fn lay_out<F: SlaveFactory<Layout = ProcessLayout>, const MESSAGE: usize>(
    kind: DriveKind,
    axis_mode: AxisMode,
    mode: &ModeDescription,
    slave: &mut PreOperational<'_, '_, MESSAGE>,
) -> Result<ProcessData<F>, BusError> {
    let mut builder = LayoutBuilder::new(axis_mode, mode);
    let outputs = slave.entries(Direction::Outputs, &mode.outputs, |entry| builder.output(entry));
    outputs.await?;
    let inputs = slave.entries(Direction::Inputs, &mode.inputs, |entry| builder.input(entry));
    inputs.await?;
    let windows = slave.windows(kind.windows).await?;
    let layout = builder.finish()?;
    Ok(ProcessData {
        windows,
        output_length: layout.output_length.into(),
        input_length: layout.input_length.into(),
        layout,
    })
}
