//! The tables beside `report.json`: intended path and measurements, for checks by other programs.
//!
//! Invariant: one row of `telemetry.csv` for each millisecond that arrived, in order.

use super::{Row, strokes};
use crate::axes::{Quantity, axes};
use crate::recording::signals::{IoColumn, io_column};
use etherpen::config::Config;
use etherpen::motion::{Pen, Vertex};
use etherpen::robots::Position;
use std::io::{self, Write};

/// Writes `telemetry.csv`: the columns of every axis that the machine has, in the axis's unit, and of
/// every named input and output: its value, empty while it is missing or not in the samples.
///
/// # Errors
/// Errors of the writer.
pub fn write_telemetry(config: &Config, rows: &[Row], mut out: impl Write) -> io::Result<()> {
    write!(out, "t_ms,mode,stroke,pen,x_mm,y_mm,z_mm")?;
    let (axes, points): (_, Vec<IoColumn>) = (axes(config), IoColumn::all(config).collect());
    for column in axes.iter().flat_map(|axis| axis.columns()) {
        write!(out, ",{column}")?;
    }
    for point in &config.io {
        write!(out, ",{}", io_column(point))?;
    }
    writeln!(out)?;
    for Row {
        sample,
        position,
        stroke,
        pen,
        ..
    } in rows
    {
        let pen = u8::from(*pen == Pen::Down);
        let Position { x_mm, y_mm, z_mm } = position;
        write!(
            out,
            "{},{:?},{stroke},{pen},{x_mm:.4},{y_mm:.4},{z_mm:.4}",
            sample.t_ms, sample.mode
        )?;
        for axis in &axes {
            let (q_ref, q) = (axis.of(&sample.setpoint_rad), axis.of(&sample.measured_rad));
            let (v_ref, v) = (axis.of(&sample.setpoint_rad_s), axis.of(&sample.measured_rad_s));
            let (of_q, of_v) = (
                axis.motion.decimals(Quantity::Position),
                axis.motion.decimals(Quantity::Speed),
            );
            write!(out, ",{q_ref:.of_q$},{q:.of_q$},{v_ref:.of_v$},{v:.of_v$}")?;
        }
        for point in &points {
            match point.value(&sample.io) {
                Some(value) => write!(out, ",{value}")?,
                None => write!(out, ",")?,
            }
        }
        writeln!(out)?;
    }
    out.flush()
}

/// Writes `intended.csv`: the drawn polylines.
///
/// # Errors
/// Errors of the writer.
pub fn write_intended(path: &[Vertex], mut out: impl Write) -> io::Result<()> {
    writeln!(out, "stroke,x_mm,y_mm,z_mm")?;
    for (stroke, points) in strokes(path) {
        for Position { x_mm, y_mm, z_mm } in points {
            writeln!(out, "{stroke},{x_mm:.4},{y_mm:.4},{z_mm:.4}")?;
        }
    }
    out.flush()
}
