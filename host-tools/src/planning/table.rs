//! The references of a planned path as a table, one row a millisecond.

use super::PlannedSample;
use crate::axes::{AxisView, Motion, axes};
use etherpen::config::Config;
use etherpen::motion::Pen;
use etherpen::robots::AXES;
use std::io::{self, Write};

/// The references as a table, without those at rest at the end.
pub struct Table<W> {
    out: W,
    axes: Vec<AxisView>,
    /// Rows that repeat the last one written.
    waiting: Vec<PlannedSample>,
    last: Option<[f64; AXES]>,
}

impl<W: Write> Table<W> {
    /// Starts a table with the columns of the machine's axes, each in its unit.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn new(config: &Config, mut out: W) -> io::Result<Self> {
        let axes = axes(config);
        let names = axes.iter().map(|axis| axis.columns()).map(|[_, position, ..]| position);
        let speeds = axes.iter().map(|axis| axis.columns()).map(|[.., speed]| speed);
        let heading: String = names.chain(speeds).map(|name| name + ",").collect();
        writeln!(out, "t_ms,x_mm,y_mm,z_mm,{heading}pen")?;
        Ok(Self {
            out,
            axes,
            waiting: Vec::new(),
            last: None,
        })
    }

    /// Takes the next millisecond.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn step(&mut self, sample: &PlannedSample) -> io::Result<()> {
        let position = sample.setpoint.position_rad;
        if self.last.replace(position) == Some(position) {
            self.waiting.push(*sample);
            return Ok(());
        }
        for waiting in self.waiting.drain(..) {
            row(&mut self.out, &self.axes, &waiting)?;
        }
        row(&mut self.out, &self.axes, sample)
    }

    /// The writer, with all rows up to the rest at the end.
    pub fn finish(self) -> W {
        self.out
    }
}

fn row(out: &mut impl Write, axes: &[AxisView], sample: &PlannedSample) -> io::Result<()> {
    let [x, y, z] = sample.point;
    write!(out, "{},{x:.9},{y:.9},{z:.9}", sample.t_ms)?;
    let fewer = |axis: &AxisView| if axis.motion == Motion::Linear { 2 } else { 0 };
    for axis in axes {
        let decimals = 13 - fewer(axis);
        write!(out, ",{:.decimals$}", axis.of(&sample.setpoint.position_rad))?;
    }
    for axis in axes {
        let decimals = 10 - fewer(axis);
        write!(out, ",{:.decimals$}", axis.of(&sample.setpoint.velocity_rad_s))?;
    }
    writeln!(out, ",{}", u8::from(sample.setpoint.pen == Pen::Down))
}
