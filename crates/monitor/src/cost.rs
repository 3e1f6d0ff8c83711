//! Cost of a step, printed and not asserted: `cargo test --release -p etherpen-monitor -- --nocapture a_step_costs`.

use crate::moment::{Clocks, Command, Input, Joint, Mode, Moment, Report, WireFrame};
use crate::rig::angles;
use crate::telegram::tests::frame;
use crate::{Cell, Monitor};
use std::time::Instant;

/// Milliseconds of the drawing.
const DRAWING_MS: usize = 4_000;
/// How often the drawing is drawn.
const DRAWINGS: u16 = 50;
/// Legs of one millisecond's way, as in a vectorised photograph.
const LEGS_PER_MS: usize = 1;

/// A dense spiral with small waves, 0.3 mm a millisecond.
fn place(ms: usize) -> [f64; 3] {
    let turn = (ms as f64 * 0.35).sqrt();
    let radius = 2.0 + 0.25 * turn + 0.3 * (turn * 11.0).sin();
    [radius * turn.cos(), radius * turn.sin(), -850.0]
}

#[test]
fn a_step_costs_little() {
    let cell = Cell::default();
    let mut monitor = Monitor::new(cell.clone());
    let way: Vec<[Joint; 4]> = (0..DRAWING_MS)
        .map(|ms| {
            let [a, b, c] = angles(&cell.robot, place(ms));
            [a, b, c, 0.0].map(|angle_rad| Joint {
                angle_rad,
                speed_rad_s: 0.3,
                has_power: true,
                ..Joint::default()
            })
        })
        .collect();
    let (sent, wire) = (frame(&[4, 60, 2, 8]), frame(&[4, 60, 2, 8]));
    let frames = [(true, &sent), (false, &wire), (true, &sent), (false, &wire)].map(|(from_master, bytes)| WireFrame {
        from_master,
        bytes,
        time_ns: 0,
    });
    let (mut time_ms, mut violations) = (0, Vec::new());
    let mut least_ns = u128::MAX;
    for job in 0..DRAWINGS {
        let pose_rad = way[0].map(|joint| joint.angle_rad);
        let begin = [Command::HomeAt { pose_rad }, Command::Enable, Command::Draw { job }];
        let path: Vec<Input> = (0..DRAWING_MS * LEGS_PER_MS)
            .map(|index| Input::PathVertex {
                job,
                index: index as u32,
                position_mm: place(index / LEGS_PER_MS),
                pen_down: true,
            })
            .collect();
        let started = Instant::now();
        for (ms, joints) in way.iter().enumerate() {
            time_ms += 1;
            let orders: Vec<Input> = match ms {
                0 => std::iter::once(Input::Configured)
                    .chain(begin.map(Input::Commanded))
                    .chain(path[..LEGS_PER_MS].iter().copied())
                    .collect(),
                _ => Vec::new(),
            };
            let arriving = path.get(ms * LEGS_PER_MS..(ms + 1) * LEGS_PER_MS).unwrap_or_default();
            let reports: &[Report] = match ms {
                0 => &begin.map(Report::Accepted),
                _ => &[Report::Mode(Mode::Drawing)],
            };
            // The first vertices come with the order.
            let inputs = if ms == 0 { &orders[..] } else { arriving };
            let moment = Moment {
                time_ms,
                joints,
                pen_touches: true,
                inputs,
                reports,
                wire: &frames,
                clocks: Clocks::default(),
            };
            violations.extend(monitor.step(&moment).err());
        }
        least_ns = least_ns.min(started.elapsed().as_nanos() / DRAWING_MS as u128);
    }
    // The leaps from the end of each drawing to the beginning of the next break rules.
    println!(
        "{least_ns} ns a step in the fastest drawing; {} violations",
        violations.len()
    );
}
