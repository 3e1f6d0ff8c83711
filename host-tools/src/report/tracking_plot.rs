//! `tracking.svg`: reference, actual position and their difference for each axis.
//!
//! The picture shows the two seconds around the largest difference, so it shows the worst case. One row for each axis:
//! on the left the reference as a broad band with the actual position on it, on the right the difference between the
//! reference of the measurement's age and the measurement, which is the input of the controller.
//!
//! Invariant: every scale has its unit, and the axes of one column have one scale for the time.

use super::drawn_part;
use crate::plot_scale::{marks, number};
use etherpen::config::Config;
use etherpen::messages::Sample;
use etherpen::robots::{AXES, Words};
use std::fmt::Write as _;
use std::io::{self, Write};

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

const INK: &str = "#222222";
const FAINT: &str = "#d9d9d9";
const REFERENCE: &str = "#9ecae1";
const ACTUAL: &str = "#08306b";
const ERROR: &str = "#b2182b";

/// Values of one panel over the window.
struct Panel<'a> {
    column: usize,
    row: usize,
    title: String,
    /// Low and high end of the scale.
    range: [f64; 2],
    /// Colour, width and points of each line, ms and value.
    lines: Vec<(&'a str, f64, Vec<[f64; 2]>)>,
}

/// Writes the picture; without a drawing its panels are empty.
///
/// # Errors
/// Errors of the writer.
pub fn write_tracking(config: &Config, samples: &[Sample], mut out: impl Write) -> io::Result<()> {
    let drawing: Vec<Sample> = drawn_part(samples).copied().collect();
    let errors: [Vec<f64>; AXES] = std::array::from_fn(|axis| differences(config, &drawing, axis));
    let worst = (0..drawing.len())
        .max_by(|a, b| largest_at(&errors, *a).total_cmp(&largest_at(&errors, *b)))
        .unwrap_or(0);
    let first = worst
        .saturating_sub(WINDOW_MS / 2)
        .min(drawing.len().saturating_sub(WINDOW_MS));
    let last = (first + WINDOW_MS).min(drawing.len());
    let error_span = errors
        .iter()
        .flat_map(|of_axis| &of_axis[first..last])
        .fold(0.0_f64, |most, error| most.max(error.abs()));
    let error_span = if error_span > 0.0 { 1.15 * error_span } else { 1.0 };
    let seconds = |index: usize| [first as f64 / 1_000.0, last as f64 / 1_000.0][index];
    let height = TOP + ROW_HEIGHT * AXES as f64 + BOTTOM;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" height=\"{height}\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"13\" fill=\"{INK}\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"{:.0}\" y=\"30\" font-size=\"18\" font-weight=\"bold\">Tracking of the four axes, {:.2} to {:.2} s of the \
         drawing, around its largest error</text>\n",
        LEFT[0],
        seconds(0),
        seconds(1)
    );
    legend(&mut svg);
    for (axis, errors) in errors.iter().enumerate() {
        let window = &drawing[first..last];
        let at = |k: usize, value: f64| [(first + k) as f64 / 1_000.0, value];
        let positions = |of: &dyn Fn(&Sample) -> f32| -> Vec<[f64; 2]> {
            let points = window.iter().enumerate().step_by(POSITION_EVERY);
            points.map(|(k, sample)| at(k, of(sample).into())).collect()
        };
        let (reference, actual) = (
            positions(&|s| s.setpoint_rad[axis]),
            positions(&|s| s.measured_rad[axis]),
        );
        let name = if axis + 1 == AXES {
            "axis 4".to_owned()
        } else {
            format!("{} {}", Words::default().joint, axis + 1)
        };
        panel(
            &mut svg,
            [seconds(0), seconds(1)],
            &Panel {
                column: 0,
                row: axis,
                title: format!("{name}: position, rad"),
                range: range(&reference),
                lines: vec![(REFERENCE, 5.0, reference), (ACTUAL, 1.4, actual)],
            },
        );
        let points = errors[first..last]
            .iter()
            .enumerate()
            .map(|(k, error)| at(k, *error))
            .collect();
        panel(
            &mut svg,
            [seconds(0), seconds(1)],
            &Panel {
                column: 1,
                row: axis,
                title: format!("{name}: reference minus actual, µrad"),
                range: [-error_span, error_span],
                lines: vec![(ERROR, 1.0, points)],
            },
        );
    }
    for left in LEFT {
        let (x, y) = (left + 0.5 * PANEL_WIDTH, height - 12.0);
        let _ = writeln!(
            svg,
            "<text x=\"{x:.0}\" y=\"{y:.0}\" text-anchor=\"middle\">time since the drawing began, s</text>"
        );
    }
    svg.push_str("</svg>\n");
    out.write_all(svg.as_bytes())
}

/// Differences between the reference of the measurement's age and the measurement, micro-radians.
fn differences(config: &Config, samples: &[Sample], axis: usize) -> Vec<f64> {
    let age = config.axes[axis].measurement_age_ms.round() as usize;
    let before = |index: usize| samples.get(index.saturating_sub(age));
    let difference = |(index, sample): (usize, &Sample)| {
        let reference = before(index).map_or(0.0, |cause| f64::from(cause.setpoint_rad[axis]));
        (reference - f64::from(sample.measured_rad[axis])) * 1e6
    };
    samples.iter().enumerate().map(difference).collect()
}

fn largest_at(errors: &[Vec<f64>; AXES], index: usize) -> f64 {
    errors
        .iter()
        .filter_map(|of_axis| of_axis.get(index))
        .fold(0.0, |most, error| most.max(error.abs()))
}

/// A scale with a margin around the values, and at least a milliradian high.
fn range(points: &[[f64; 2]]) -> [f64; 2] {
    let low = points.iter().fold(f64::INFINITY, |low, point| low.min(point[1]));
    let high = points.iter().fold(f64::NEG_INFINITY, |high, point| high.max(point[1]));
    if low > high {
        return [-1.0, 1.0];
    }
    let room = (0.1 * (high - low)).max(5e-4);
    [low - room, high + room]
}

fn legend(svg: &mut String) {
    let mut entry = |x: f64, colour: &str, width: f64, text: &str| {
        let (end, label) = (x + 34.0, x + 42.0);
        let _ = writeln!(
            svg,
            "<line x1=\"{x}\" y1=\"52\" x2=\"{end}\" y2=\"52\" stroke=\"{colour}\" stroke-width=\"{width}\"/>\
             <text x=\"{label}\" y=\"57\">{text}</text>"
        );
    };
    entry(LEFT[0], REFERENCE, 5.0, "reference");
    entry(LEFT[0] + 130.0, ACTUAL, 1.4, "actual position");
    entry(
        LEFT[1],
        ERROR,
        1.0,
        "error, with the reference as old as the measurement",
    );
}

fn panel(svg: &mut String, [begin, end]: [f64; 2], panel: &Panel) {
    let (left, top) = (LEFT[panel.column], TOP + ROW_HEIGHT * panel.row as f64);
    let [low, high] = panel.range;
    let across = |t: f64| left + PANEL_WIDTH * (t - begin) / (end - begin).max(1e-9);
    let down = |value: f64| top + PANEL_HEIGHT * (high - value) / (high - low);
    let (right, bottom) = (left + PANEL_WIDTH, top + PANEL_HEIGHT);
    let _ = writeln!(
        svg,
        "<text x=\"{left}\" y=\"{:.1}\" font-weight=\"bold\">{}</text>",
        top - 8.0,
        panel.title
    );
    for value in marks(low, high) {
        let (y, x) = (down(value), left - 8.0);
        let _ = writeln!(
            svg,
            "<line x1=\"{left}\" y1=\"{y:.1}\" x2=\"{right}\" y2=\"{y:.1}\" stroke=\"{FAINT}\"/>\
             <text x=\"{x}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            y + 4.5,
            number(value, high - low)
        );
    }
    for t in marks(begin, end) {
        let x = across(t);
        let _ = writeln!(
            svg,
            "<line x1=\"{x:.1}\" y1=\"{top}\" x2=\"{x:.1}\" y2=\"{bottom}\" stroke=\"{FAINT}\"/>\
             <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            bottom + 17.0,
            number(t, end - begin)
        );
    }
    for (colour, width, points) in &panel.lines {
        let _ = write!(
            svg,
            "<polyline fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-linejoin=\"round\" points=\""
        );
        for [t, value] in points {
            let _ = write!(svg, "{:.1},{:.1} ", across(*t), down(*value));
        }
        svg.push_str("\"/>\n");
    }
    let _ = writeln!(
        svg,
        "<rect x=\"{left}\" y=\"{top}\" width=\"{PANEL_WIDTH}\" height=\"{PANEL_HEIGHT}\" fill=\"none\" stroke=\"{INK}\"/>"
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::application::Mode;
    use etherpen::motion::Pen;

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
        assert_eq!(text.matches("reference minus actual, µrad").count(), AXES);
        assert!(!text.contains("NaN") && !text.contains("inf"));
    }

    #[test]
    fn a_drawing_that_never_began_gives_a_picture_too() {
        let mut svg = Vec::new();
        write_tracking(&Config::default(), &[], &mut svg).unwrap();
        assert!(!String::from_utf8(svg).unwrap().contains("NaN"));
    }
}
