//! A drawing whose vertices are denser than the link carries at the drawing's speed.
//!
//! The truth is the ink, and the tool's speed while it draws.

use crate::robot::Robot;
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use etherpen::motion::Pen;
use std::f64::consts::TAU;

/// Radius of the circle, um.
const RADIUS_UM: f64 = 64_000.0;
/// Distance of its vertices, um.
const STEP_UM: f64 = 8.0;
/// Most stops of the lowered pen: the queue holds a large part of the circle.
const STOPS_MAX: u32 = 4;

fn circle() -> Vec<PathVertex> {
    let vertex = |position_um, pen| PathVertex {
        position_um,
        pen,
        stroke: 0,
    };
    let count = (TAU * RADIUS_UM / STEP_UM) as u32;
    let at = |number: u32, z_um: i32| {
        let angle = TAU * f64::from(number) / f64::from(count);
        [
            (RADIUS_UM * angle.cos()).round() as i32,
            (RADIUS_UM * angle.sin()).round() as i32,
            z_um,
        ]
    };
    let ends = [vertex(at(0, -847_000), Pen::Up), vertex(at(0, -850_000), Pen::Up)];
    let line = (1..=count).map(|number| vertex(at(number, -850_000), Pen::Down));
    ends.into_iter()
        .chain(line)
        .chain([vertex(at(0, -847_000), Pen::Up)])
        .collect()
}

#[test]
fn a_path_denser_than_the_link_carries_stops_seldom_and_is_one_line() {
    for starve_dwell_ms in [500, 0] {
        let mut config = Config::default();
        config.motion.speed_mm_s = 250.0;
        config.motion.starve_dwell_ms = starve_dwell_ms;
        let mut robot = Robot::idle_with(&config);
        robot.draw(circle());
        robot.run_until("the circle is drawn", |robot| {
            robot.has_drawn() && robot.mode() == Mode::Idle
        });
        let starved = robot
            .status
            .as_ref()
            .map_or(0, |status| status.counters.path_starvations);
        let ink = robot.ink();
        let length_mm: f64 = ink.iter().map(|stroke| stroke.length_mm()).sum();
        println!(
            "dwell {starve_dwell_ms} ms: {starved} stops, {} lines, {length_mm:.1} mm",
            ink.len()
        );
        assert!(starved <= STOPS_MAX, "{starved} stops");
        assert!(ink.len() as u32 <= 1 + starved, "{} lines", ink.len());
        assert!((length_mm - TAU * RADIUS_UM / 1_000.0).abs() < 1.0, "{length_mm} mm");
    }
}
