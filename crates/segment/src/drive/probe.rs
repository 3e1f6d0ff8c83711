//! Touch probes of a drive: positions stored at edges of the home switch and at index pulses.
//!
//! Objects 0x60B8 to 0x60BD. Both probes have the home switch as their input. The falling edge of an index pulse is where
//! the motor leaves it again, which is the same place here.

use super::homing::{Marks, Switch};

const ENABLE: u16 = 1 << 0;
const CONTINUOUS: u16 = 1 << 1;
const INDEX: u16 = 1 << 2;
const EDGES: [u16; 2] = [1 << 4, 1 << 5];
const STORED: [u16; 2] = [1 << 1, 1 << 2];

/// Both probes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Probes {
    /// Object 0x60B8.
    pub(crate) function: u16,
    before: u16,
    /// Object 0x60B9.
    pub(crate) status: u16,
    /// Positions since the motor's mark at rising and falling edges of probe 1 and 2, increments.
    pub(crate) stored: [f64; 4],
    last: f64,
}

impl Probes {
    /// Advances by one millisecond in which the motor has come to this place, increments since its mark.
    pub(crate) fn step(&mut self, at: f64, marks: &Marks) {
        let from = core::mem::replace(&mut self.last, at);
        let before = core::mem::replace(&mut self.before, self.function);
        for probe in 0..2 {
            let shift = 8 * probe as u32;
            let (function, old) = (self.function >> shift, before >> shift);
            let mut status = self.status >> shift & 0xFF;
            if function & ENABLE == 0 {
                status = 0;
            } else if old & ENABLE == 0 {
                status = ENABLE;
            } else {
                for edge in 0..2 {
                    let is_free = function & CONTINUOUS != 0 || status & STORED[edge] == 0;
                    let passed = Self::passed(function, edge, from, at, marks);
                    if let Some(place) = passed.filter(|_| is_free && function & EDGES[edge] != 0) {
                        status |= STORED[edge];
                        self.stored[2 * probe + edge] = place;
                    }
                }
            }
            self.status = self.status & !(0xFF << shift) | status << shift;
        }
    }

    fn passed(function: u16, edge: usize, from: f64, at: f64, marks: &Marks) -> Option<f64> {
        if function & INDEX != 0 {
            return marks.index(from, at);
        }
        let [was, is] = [from, at].map(|place| marks.is_active(Switch::Home, place));
        let wanted = [(false, true), (true, false)][edge];
        ((was, is) == wanted).then(|| marks.edge(Switch::Home, from, at))
    }
}

#[cfg(test)]
mod tests {
    use super::super::homing::Switches;
    use super::*;

    #[test]
    fn edges_are_stored_where_they_are_once_or_each_time() {
        let marks = Marks {
            per_rad: 1.0,
            turn: 1_000.0,
            switches: Switches {
                home_rad: [2_100.0, 4_700.0],
                ..Switches::default()
            },
        };
        let mut probes = Probes::default();
        let to = |probes: &mut Probes, place: f64| probes.step(place, &marks);
        to(&mut probes, 2_050.0);
        // Probe 1: both edges of the input once; probe 2: each index pulse.
        probes.function = 0x1731;
        to(&mut probes, 2_060.0);
        assert_eq!(probes.status, 0x0101);
        to(&mut probes, 2_200.0);
        assert_eq!((probes.status, probes.stored[0]), (0x0103, 2_100.0));
        to(&mut probes, 2_990.0);
        to(&mut probes, 3_010.0);
        assert_eq!((probes.status, probes.stored[2]), (0x0303, 3_000.0));
        to(&mut probes, 4_800.0);
        assert_eq!((probes.status, probes.stored[1]), (0x0307, 4_700.0));
        to(&mut probes, 4_600.0);
        to(&mut probes, 2_000.5);
        to(&mut probes, 2_200.0);
        assert_eq!(probes.stored[0], 2_100.0, "the first edge stays");
        probes.function = 0x1730;
        to(&mut probes, 2_300.0);
        assert_eq!(probes.status, 0x0300);
        probes.function = 0x1731;
        to(&mut probes, 2_300.0);
        assert_eq!(probes.status, 0x0301);
    }
}
