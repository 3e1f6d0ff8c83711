//! The tables beside `report.json`: intended path and measurements, for checks by other programs.
//!
//! Invariant: one row of `telemetry.csv` for each millisecond that arrived, in order.

use super::{Row, strokes};
use etherpen::motion::{Pen, Vertex};
use etherpen::robots::{AXES, Position};
use std::io::{self, Write};

/// Writes `telemetry.csv`.
///
/// # Errors
/// Errors of the writer.
pub fn write_telemetry(rows: &[Row], mut out: impl Write) -> io::Result<()> {
    write!(out, "t_ms,mode,stroke,pen,x_mm,y_mm,z_mm")?;
    for k in 1..=AXES {
        write!(out, ",q{k}_ref_rad,q{k}_rad,v{k}_ref_rad_s,v{k}_rad_s")?;
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
        for k in 0..AXES {
            let (q_ref, q) = (sample.setpoint_rad[k], sample.measured_rad[k]);
            let (v_ref, v) = (sample.setpoint_rad_s[k], sample.measured_rad_s[k]);
            write!(out, ",{q_ref:.7},{q:.7},{v_ref:.5},{v:.5}")?;
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
