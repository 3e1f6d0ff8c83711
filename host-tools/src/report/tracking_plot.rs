//! `tracking.svg`: setpoint, actual position and their difference for each axis.
//!
//! The picture shows the two seconds around the largest difference, so it shows the worst case. One row for each axis:
//! on the left the setpoint as a broad band with the actual position on it, on the right the difference between the
//! setpoint of the measurement's age and the measurement, which is the input of the controller.
//!
//! Invariant: every scale has its unit, and the axes of one column have one scale for the time.

use super::drawn_part;
use crate::axes::{AxisView, Motion, Quantity, axes};
use crate::plot::{Anchor, Frame, INK, Pen, Picture, Scale, legend_entry, round_marks};
use etherpen::config::Config;
use etherpen::messages::Sample;
use std::io::{self, Write};

/// Numbers of axes in words.
const NUMBERS: [&str; 5] = ["no", "one", "two", "three", "four"];
/// Length of the window, ms.
const WINDOW_MS: usize = 2_000;
/// Samples between two points of a position.
const POSITION_EVERY: usize = 4;
/// Size of the picture and of its panels, pixels.
const WIDTH: f64 = 1_120.0;
const PANEL_WIDTH: f64 = 440.0;
const PANEL_HEIGHT: f64 = 130.0;
const ROW_HEIGHT: f64 = 172.0;
const TOP: f64 = 92.0;
const BOTTOM: f64 = 14.0;
const LEFT: [f64; 2] = [84.0, 646.0];

const SETPOINT: Pen = Pen {
    colour: [158, 202, 225],
    width: 5.0,
    dashes: &[],
};
const ACTUAL: Pen = Pen {
    colour: [8, 48, 107],
    width: 1.4,
    dashes: &[],
};
const ERROR: Pen = Pen {
    colour: [178, 24, 43],
    width: 1.0,
    dashes: &[],
};

/// Values of one panel over the window.
struct Panel {
    column: usize,
    row: usize,
    /// Whether it is the lowest of its column.
    is_last: bool,
    title: String,
    /// Low and high end of the scale.
    range: [f64; 2],
    /// Each line with its points: time, s, and value.
    lines: Vec<(Pen, Vec<[f64; 2]>)>,
}

/// Writes the picture; without a drawing its panels are empty.
///
/// # Errors
/// Errors of the writer.
pub fn write_tracking(config: &Config, samples: &[Sample], mut out: impl Write) -> io::Result<()> {
    let drawing: Vec<Sample> = drawn_part(samples).copied().collect();
    let axes = axes(config);
    let errors: Vec<Vec<f64>> = axes.iter().map(|axis| differences(config, &drawing, axis)).collect();
    let worst = (0..drawing.len())
        .max_by(|a, b| largest_at(&axes, &errors, *a).total_cmp(&largest_at(&axes, &errors, *b)))
        .unwrap_or(0);
    let first = worst
        .saturating_sub(WINDOW_MS / 2)
        .min(drawing.len().saturating_sub(WINDOW_MS));
    let last = (first + WINDOW_MS).min(drawing.len());
    // The scale of the errors is the same for all axes of one unit.
    let error_span = |motion: Motion| {
        let of_unit = axes.iter().zip(&errors).filter(|(axis, _)| axis.motion == motion);
        let values = of_unit.flat_map(|(_, of_axis)| &of_axis[first..last]);
        let most = values.fold(0.0_f64, |most, error| most.max(error.abs()));
        if most > 0.0 { 1.15 * most } else { 1.0 }
    };
    let window = Window {
        samples: &drawing[first..last],
        first,
        seconds: [first as f64 / 1_000.0, last as f64 / 1_000.0],
    };
    let mut picture = Picture::new(WIDTH, TOP + ROW_HEIGHT * axes.len() as f64 + BOTTOM);
    let title = format!(
        "Tracking of the {} axes, {:.2} to {:.2} s of the drawing, around its largest error",
        NUMBERS.get(axes.len()).unwrap_or(&""),
        window.seconds[0],
        window.seconds[1]
    );
    picture.text([LEFT[0], 30.0], Anchor::Start, title, INK);
    legend(&mut picture);
    for (axis, errors) in axes.iter().zip(&errors) {
        let is_last = axis.index + 1 == axes.len();
        axis_panels(
            &mut picture,
            &window,
            axis,
            &errors[first..last],
            error_span(axis.motion),
            is_last,
        );
    }
    out.write_all(picture.svg().as_bytes())
}

/// The part of a drawing that is shown.
struct Window<'a> {
    samples: &'a [Sample],
    /// Index of its first sample in the drawing, ms.
    first: usize,
    /// Its beginning and end, s since the drawing began.
    seconds: [f64; 2],
}

/// Draws position and error of one axis. `error_span` is the end of the error's scale, in the axis's unit of errors.
fn axis_panels(
    picture: &mut Picture,
    window: &Window,
    axis: &AxisView,
    errors: &[f64],
    error_span: f64,
    is_last: bool,
) {
    let at = |k: usize, value: f64| [(window.first + k) as f64 / 1_000.0, value];
    let positions = |of: &dyn Fn(&Sample) -> f64| -> Vec<[f64; 2]> {
        let points = window.samples.iter().enumerate().step_by(POSITION_EVERY);
        points.map(|(k, sample)| at(k, of(sample))).collect()
    };
    let (setpoint, actual) = (
        positions(&|s| axis.of(&s.setpoint_rad)),
        positions(&|s| axis.of(&s.measured_rad)),
    );
    let (name, motion) = (&axis.name, axis.motion);
    panel(
        picture,
        window.seconds,
        &Panel {
            column: 0,
            row: axis.index,
            is_last,
            title: format!("{name}: position, {}", motion.unit(Quantity::Position)),
            range: range(&setpoint, motion.factor()),
            lines: vec![(SETPOINT, setpoint), (ACTUAL, actual)],
        },
    );
    let points = errors.iter().enumerate().map(|(k, error)| at(k, *error)).collect();
    panel(
        picture,
        window.seconds,
        &Panel {
            column: 1,
            row: axis.index,
            is_last,
            title: format!("{name}: setpoint minus actual, {}", motion.error_unit().0),
            range: [-error_span, error_span],
            lines: vec![(ERROR, points)],
        },
    );
}

/// Differences between the setpoint of the measurement's age and the measurement, in the axis's unit of errors.
fn differences(config: &Config, samples: &[Sample], axis: &AxisView) -> Vec<f64> {
    let (_, factor) = axis.motion.error_unit();
    let axis = axis.index;
    let age = config.axes[axis].measurement_age_ms.round() as usize;
    let before = |index: usize| samples.get(index.saturating_sub(age));
    let difference = |(index, sample): (usize, &Sample)| {
        let setpoint = before(index).map_or(0.0, |cause| f64::from(cause.setpoint_rad[axis]));
        (setpoint - f64::from(sample.measured_rad[axis])) * factor
    };
    samples.iter().enumerate().map(difference).collect()
}

/// Largest error of a millisecond, controller's value.
fn largest_at(axes: &[AxisView], errors: &[Vec<f64>], index: usize) -> f64 {
    let errors = axes.iter().zip(errors);
    let at = errors.filter_map(|(axis, of_axis)| Some(of_axis.get(index)? / axis.motion.error_unit().1));
    at.fold(0.0, |most, error| most.max(error.abs()))
}

/// A scale with a margin around the values, and at least a thousandth of `unit` high.
fn range(points: &[[f64; 2]], unit: f64) -> [f64; 2] {
    let low = points.iter().fold(f64::INFINITY, |low, point| low.min(point[1]));
    let high = points.iter().fold(f64::NEG_INFINITY, |high, point| high.max(point[1]));
    if low > high {
        return [-1.0, 1.0];
    }
    let room = (0.1 * (high - low)).max(5e-4 * unit);
    [low - room, high + room]
}

fn legend(picture: &mut Picture) {
    let y = 54.0;
    let width = legend_entry(picture, [LEFT[0], y], SETPOINT, "setpoint");
    legend_entry(picture, [LEFT[0] + width, y], ACTUAL, "actual position");
    legend_entry(picture, [LEFT[1], y], ERROR, "error against the setpoint of that time");
}

fn panel(picture: &mut Picture, times: [f64; 2], panel: &Panel) {
    // Without a drawing the window is empty.
    let times = [times[0], times[1].max(times[0] + 1e-3)];
    let frame = Frame {
        left: LEFT[panel.column],
        top: TOP + ROW_HEIGHT * panel.row as f64,
        width: PANEL_WIDTH,
        height: PANEL_HEIGHT,
        across: Scale::Linear(times),
        up: Scale::Linear(panel.range),
    };
    picture.text([frame.left, frame.top - 8.0], Anchor::Start, &panel.title, INK);
    frame.marks_up(picture, round_marks(panel.range));
    frame.marks_across(picture, round_marks(times));
    if panel.is_last {
        frame.name_across(picture, "time since the drawing began, s");
    }
    for (pen, points) in &panel.lines {
        frame.curve(picture, points, *pen);
    }
    frame.border(picture);
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::application::Mode;
    use etherpen::messages::IoValues;
    use etherpen::motion::Pen;
    use etherpen::robots::{AXES, Kind};

    fn sample(ms: u32) -> Sample {
        let angle = 0.3 + 0.1 * (ms as f32 / 300.0).sin();
        Sample {
            t_ms: ms,
            mode: Mode::Drawing,
            stroke: 0,
            pen: Pen::Down,
            setpoint_rad: [angle; AXES],
            measured_rad: [angle + if ms == 3_000 { 1e-3 } else { 1e-5 }; AXES],
            setpoint_rad_s: [0.0; AXES],
            measured_rad_s: [0.0; AXES],
            io: IoValues::default(),
        }
    }

    #[test]
    fn the_window_holds_the_largest_error_and_every_axis_has_two_panels() {
        let samples: Vec<Sample> = (0..8_000).map(sample).collect();
        let mut svg = Vec::new();
        write_tracking(&Config::default(), &samples, &mut svg).unwrap();
        let text = String::from_utf8(svg).unwrap();
        assert!(text.contains("2.00 to 4.00 s"), "{}", &text[..600]);
        assert_eq!(text.matches("position, rad").count(), AXES);
        assert_eq!(text.matches("setpoint minus actual, µrad").count(), AXES);
        assert!(!text.contains("NaN") && !text.contains("inf"));
    }

    #[test]
    fn a_machine_with_two_linear_axes_has_two_rows_in_millimetres() {
        let mut config = Config {
            geometry: Kind::CoreXy.geometry(),
            ..Config::default()
        };
        config.bus.drives = 2;
        let samples: Vec<Sample> = (0..3_000).map(sample).collect();
        let mut svg = Vec::new();
        write_tracking(&config, &samples, &mut svg).unwrap();
        let text = String::from_utf8(svg).unwrap();
        assert!(text.contains("Tracking of the two axes") && text.contains("b: setpoint minus actual, µm"));
        assert_eq!(text.matches("position, mm").count(), 2);
        assert!(!text.contains("rad<"), "no angle");
    }

    #[test]
    fn a_drawing_that_never_began_gives_a_picture_too() {
        let mut svg = Vec::new();
        write_tracking(&Config::default(), &[], &mut svg).unwrap();
        assert!(!String::from_utf8(svg).unwrap().contains("NaN"));
    }
}
