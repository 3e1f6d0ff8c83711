//! The references of a planned path as a table, one row a millisecond.

use super::PlannedSample;
use etherpen::motion::Pen;
use etherpen::robots::AXES;
use std::io::{self, Write};

/// The references as a table, without those at rest at the end.
pub struct Table<W> {
    out: W,
    /// Rows that repeat the last one written.
    waiting: Vec<PlannedSample>,
    last: Option<[f64; AXES]>,
}

impl<W: Write> Table<W> {
    /// Starts a table.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn new(mut out: W) -> io::Result<Self> {
        let names = (1..=AXES).map(|axis| format!("q{axis}_rad,"));
        let speeds = (1..=AXES).map(|axis| format!("v{axis}_rad_s,"));
        let heading: String = names.chain(speeds).collect();
        writeln!(out, "t_ms,x_mm,y_mm,z_mm,{heading}pen")?;
        Ok(Self {
            out,
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
            row(&mut self.out, &waiting)?;
        }
        row(&mut self.out, sample)
    }

    /// The writer, with all rows up to the rest at the end.
    pub fn finish(self) -> W {
        self.out
    }
}

fn row(out: &mut impl Write, sample: &PlannedSample) -> io::Result<()> {
    let [x, y, z] = sample.point;
    write!(out, "{},{x:.9},{y:.9},{z:.9}", sample.t_ms)?;
    for angle in sample.setpoint.position_rad {
        write!(out, ",{angle:.13}")?;
    }
    for speed in sample.setpoint.velocity_rad_s {
        write!(out, ",{speed:.10}")?;
    }
    writeln!(out, ",{}", u8::from(sample.setpoint.pen == Pen::Down))
}
