use super::*;
use crate::cell::{Cell, CellOptions};
use crate::drawing::preparation::prepare::prepare;
use crate::drawing::{Drawing, Stroke, to_path};
use crate::emulator::Segment;
use crate::job::{Job, JobOptions};
use crate::simulation::{self, Host};
use etherpen::application::Mode;

/// A cell that records the platform's position each millisecond.
struct Watched {
    cell: Cell,
    places: Vec<Position>,
}

impl Segment for Watched {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.cell.frame(time_us, frame)
    }

    fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.cell.frame_at_ns(time_ns, frame)
    }

    fn advance_to(&mut self, time_us: u64) {
        self.cell.advance_to(time_us);
        self.places.push(self.cell.state().platform.unwrap_or_default());
    }
}

/// Records the milliseconds in which a path is executed.
struct Watching {
    job: Job,
    executed: Vec<bool>,
}

impl Host for Watching {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        self.job.step(u64::from(ms), from_firmware, to_firmware, room);
        let mode = self.job.sample().map(|sample| sample.mode);
        self.executed.push(mode == Some(Mode::Drawing));
    }

    fn is_over(&self) -> bool {
        self.job.outcome().is_some()
    }
}

/// Positions of the cell's platform along a border.
fn went(border: &[PathVertex], config: &Config) -> (Cell, Vec<Position>) {
    let mut cell = Watched {
        cell: Cell::new(config, CellOptions::default()),
        places: Vec::new(),
    };
    let mut host = Watching {
        job: Job::draw(config.clone(), border.to_vec(), JobOptions::default()),
        executed: Vec::new(),
    };
    simulation::run(&mut cell, &mut host, 120_000);
    assert_eq!(host.job.outcome(), Some(&Ok(())));
    let Watched { cell, places } = cell;
    let executed = places
        .iter()
        .zip(&host.executed)
        .filter(|(_, is_executed)| **is_executed);
    (cell, executed.map(|(place, _)| *place).collect())
}

#[test]
fn the_pen_goes_around_the_drawing_and_touches_nothing() {
    let config = Config::default();
    let file = crate::setup::workspace().join("samples/strokes.csv");
    let prepared = prepare(&file, &config).expect("the sample");
    let (border, size_mm) = around(&prepared.path, &config).expect("strokes");
    let (cell, places) = went(&border, &config);
    assert!(cell.ink().is_empty(), "{} lines of ink", cell.ink().len());
    let lowest_mm = places.iter().map(|place| place.z_mm).fold(f64::INFINITY, f64::min);
    assert!(
        lowest_mm > config.paper.pen_down_z_mm + 0.8 * config.paper.pen_lift_mm,
        "{lowest_mm}"
    );
    // The rectangle, from the path itself.
    let drawn = || {
        prepared
            .path
            .windows(2)
            .filter(|pair| pair[1].pen == Pen::Down)
            .flatten()
            .map(|vertex| vertex.position)
    };
    let edges = |at: fn(&Position) -> f64| {
        drawn().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], place| {
            [low.min(at(&place)), high.max(at(&place))]
        })
    };
    let ([left, right], [near, far]) = (edges(|place| place.x_mm), edges(|place| place.y_mm));
    assert!((size_mm[0] - (right - left)).abs() < 1e-9 && (size_mm[1] - (far - near)).abs() < 1e-9);
    for [x_mm, y_mm] in [[left, near], [left, far], [right, near], [right, far]] {
        let away_mm = places
            .iter()
            .map(|place| (place.x_mm - x_mm).hypot(place.y_mm - y_mm))
            .fold(f64::INFINITY, f64::min);
        assert!(away_mm < 1.0, "{away_mm} mm from the corner {x_mm}, {y_mm}");
    }
    // Once it has reached the border, it stays on it until it has gone around.
    let off_mm = |place: &Position| {
        let inside = (place.x_mm - left)
            .min(right - place.x_mm)
            .min(place.y_mm - near)
            .min(far - place.y_mm);
        inside.abs()
    };
    let first = places.iter().position(|place| off_mm(place) < 0.2).expect("the border");
    let last = places
        .iter()
        .rposition(|place| off_mm(place) < 0.2)
        .expect("the border");
    let way_mm: f64 = places[first..=last]
        .windows(2)
        .map(|pair| (pair[1].x_mm - pair[0].x_mm).hypot(pair[1].y_mm - pair[0].y_mm))
        .sum();
    assert!(
        (way_mm - 2.0 * (size_mm[0] + size_mm[1])).abs() < 4.0,
        "{way_mm} mm around {size_mm:?}"
    );
    assert!(places[first..=last].iter().all(|place| off_mm(place) < 1.0));
}

#[test]
fn where_a_corner_is_out_of_reach_the_border_is_the_hull() {
    let mut config = Config::default();
    config.paper.size_mm = [600.0, 600.0];
    config.work_area.radius_mm = 150.0;
    let ring = (0..=60).map(|k| f64::from(k) * std::f64::consts::TAU / 60.0);
    let points = ring
        .map(|angle| [300.0 + 140.0 * angle.cos(), 300.0 + 140.0 * angle.sin()])
        .collect();
    let drawing = Drawing {
        sheet_mm: config.paper.size_mm,
        strokes: vec![Stroke { points }],
    };
    let (border, size_mm) = around(&to_path(&drawing, &config.paper), &config).expect("a ring");
    assert!((size_mm[0] - 280.0).abs() < 0.1, "{size_mm:?}");
    assert!(border.len() >= 60, "{}", border.len());
    assert!(border.iter().all(|vertex| vertex.pen == Pen::Up));
}

#[test]
fn a_path_that_draws_nothing_has_no_border() {
    assert!(around(&[], &Config::default()).is_none());
}
