//! A recording as a table: CSV with the columns of `telemetry.csv`, or Parquet.
//!
//! Invariant: one row for each sample that arrived, in order; a missing value is an empty field.

use super::mcap::Source;
use super::parquet;
use super::signals::{Evaluator, Signal, Value, columns};
use super::{Playback, RecordingEntry};
use etherpen::config::Config;
use std::io::{self, Write};

/// Result of an export.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Exported {
    /// Number of rows.
    pub rows: u64,
    /// Number of samples missing between the rows.
    pub missing: u64,
}

/// The columns of a table: the device's time, then the requested signals, or all signals if none were requested.
pub fn table_columns(config: &Config, signals: Option<Vec<Signal>>) -> Vec<Signal> {
    let all = columns(config);
    let Some(chosen) = signals else {
        return all;
    };
    let time = all.into_iter().filter(Signal::is_time);
    time.chain(chosen.into_iter().filter(|signal| !signal.is_time()))
        .collect()
}

/// Writes a table as CSV.
///
/// # Errors
/// The recording cannot be read, or the table cannot be written.
pub fn write_csv<R: Source>(
    playback: &mut Playback<R>,
    columns: &[Signal],
    mut out: impl Write,
) -> Result<Exported, ExportError> {
    let names: Vec<&str> = columns.iter().map(|signal| signal.name.as_str()).collect();
    writeln!(out, "{}", names.join(",")).map_err(ExportError::Write)?;
    let mut line = Vec::new();
    let exported = each_row(playback, columns, |values| {
        line.clear();
        for (k, value) in values.iter().enumerate() {
            if k > 0 {
                line.push(b',');
            }
            match value {
                Value::Whole(value) => write!(line, "{value}")?,
                Value::Mode(mode) => write!(line, "{mode:?}")?,
                Value::Real(value, decimals) => write!(line, "{value:.decimals$}")?,
                Value::Missing => {}
            }
        }
        line.push(b'\n');
        out.write_all(&line)
    })?;
    out.flush().map_err(ExportError::Write)?;
    Ok(exported)
}

/// Writes a table as Parquet.
///
/// # Errors
/// The recording cannot be read, or the table cannot be written.
pub fn write_parquet<R: Source>(
    playback: &mut Playback<R>,
    columns: &[Signal],
    out: impl Write,
) -> Result<Exported, ExportError> {
    let mut table =
        parquet::Writer::new(out, columns.iter().map(parquet_column).collect()).map_err(ExportError::Write)?;
    let exported = each_row(playback, columns, |values| {
        table.row(values.iter().map(|value| match value {
            Value::Whole(value) => parquet::Field::Int(*value),
            Value::Mode(mode) => parquet::Field::Text(format!("{mode:?}")),
            Value::Real(value, _) => parquet::Field::Real(*value),
            Value::Missing => parquet::Field::Real(f64::NAN),
        }))
    })?;
    table.finish().map_err(ExportError::Write)?;
    Ok(exported)
}

fn parquet_column(signal: &Signal) -> (String, parquet::Kind) {
    let kind = match signal {
        signal if signal.is_mode() => parquet::Kind::Text,
        signal if signal.is_whole() => parquet::Kind::Int,
        signal if signal.is_single() => parquet::Kind::Float,
        _ => parquet::Kind::Double,
    };
    (signal.name.clone(), kind)
}

/// Why the table could not be exported.
#[derive(Debug)]
pub enum ExportError {
    /// The recording cannot be read any further.
    Read(io::Error),
    /// The table cannot be written.
    Write(io::Error),
}

/// Passes the values of each sample to `row`.
fn each_row<R: Source>(
    playback: &mut Playback<R>,
    columns: &[Signal],
    mut row: impl FnMut(&[Value]) -> io::Result<()>,
) -> Result<Exported, ExportError> {
    let mut evaluator = Evaluator::new(playback.config().as_ref());
    let mut values = Vec::new();
    let mut exported = Exported::default();
    while let Some((_, entry)) = playback.next_entry().map_err(ExportError::Read)? {
        match entry {
            RecordingEntry::Moment(moment) => {
                evaluator.take(&moment);
                values.clear();
                values.extend(columns.iter().map(|signal| evaluator.value(signal, &moment)));
                row(&values).map_err(ExportError::Write)?;
                exported.rows += 1;
            }
            RecordingEntry::Gap(gap) => {
                evaluator.interrupt();
                exported.missing += u64::from(gap.missing);
            }
            RecordingEntry::State(_) | RecordingEntry::Event(_) => {}
        }
    }
    Ok(exported)
}
