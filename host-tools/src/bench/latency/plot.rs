//! Plot of the fraction of requests not serviced within a time, with logarithmic axes.
//!
//! Two panels: from the release until the reply is served, as in the paper's figures 7 and 8, and the delay of the
//! release itself, where a critical section that masks too much shows first.

use super::{Curve, LatencyReport};
use std::fmt::Write;

const WIDTH: f64 = 920.0;
const PANEL_HEIGHT: f64 = 480.0;
const LEFT: f64 = 90.0;
const RIGHT: f64 = 24.0;
/// Height of a panel's title, and of each line of the legend below it.
const TITLE: f64 = 46.0;
const LEGEND_LINE: f64 = 22.0;
const BOTTOM: f64 = 64.0;
/// Colours that differ for most eyes and in grey print (Okabe and Ito, 2008).
const COLOURS: [&str; 6] = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"];
/// Curves of different runs may coincide; dashes keep both visible.
const DASHES: [&str; 6] = ["", "9 5", "2 4", "12 4 2 4", "5 3", "1 3"];
/// Times below this are drawn at the left edge, ns: a count of the board's timer.
const FLOOR_NS: f64 = 40.0;
const PANELS: [(&str, &str); 2] = [
    ("total_delay", "Release to reply served"),
    ("release_delay", "Release to the first instruction of sample"),
];

struct Axes {
    top: f64,
    /// Height of title and legend.
    head: f64,
    x_decades: (i32, i32),
    y_decades: i32,
}

impl Axes {
    fn x(&self, ns: f64) -> f64 {
        let (from, to) = self.x_decades;
        let share = (ns.max(FLOOR_NS).log10() - f64::from(from)) / f64::from(to - from);
        LEFT + share * (WIDTH - LEFT - RIGHT)
    }

    fn y(&self, fraction: f64) -> f64 {
        let lowest = 10_f64.powi(self.y_decades);
        let share = fraction.max(lowest).log10() / f64::from(self.y_decades);
        self.top + self.head + share * (PANEL_HEIGHT - self.head - BOTTOM)
    }
}

fn time(decade: i32) -> String {
    match decade {
        1 | 2 => format!("{} ns", 10_u32.pow(decade as u32)),
        3..=5 => format!("{} µs", 10_u32.pow(decade as u32 - 3)),
        _ => format!("{} ms", 10_f64.powi(decade - 6)),
    }
}

fn superscript(number: i32) -> String {
    let digits = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let positive = number.unsigned_abs().to_string();
    let mut text: String = if number < 0 { "⁻".to_owned() } else { String::new() };
    text.extend(positive.bytes().filter_map(|byte| digits.get(usize::from(byte - b'0'))));
    text
}

/// Draws the curves of a report.
#[must_use]
pub fn svg(report: &LatencyReport) -> String {
    let height = PANEL_HEIGHT * PANELS.len() as f64;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" viewBox=\"0 0 {WIDTH} {height}\" \
         font-family=\"sans-serif\" font-size=\"14\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (index, (quantity, title)) in PANELS.iter().enumerate() {
        let curves: Vec<&Curve> = report
            .curves
            .iter()
            .filter(|curve| curve.quantity == *quantity)
            .collect();
        panel(&mut text, index as f64 * PANEL_HEIGHT, title, &curves);
    }
    text.push_str("</svg>\n");
    text
}

fn panel(text: &mut String, top: f64, title: &str, curves: &[&Curve]) {
    let points = || curves.iter().flat_map(|curve| curve.points.iter());
    let times = || points().map(|(ns, _)| ns.max(FLOOR_NS).log10());
    // A curve that begins at the edge would coincide with it.
    let from = (times().fold(f64::INFINITY, f64::min) - 0.15).floor();
    let to = times().fold(f64::NEG_INFINITY, f64::max);
    if !from.is_finite() || !to.is_finite() {
        return;
    }
    let least = points()
        .map(|(_, fraction)| *fraction)
        .filter(|fraction| *fraction > 0.0);
    let least = least.fold(0.1, f64::min).log10().floor() as i32;
    let from = from as i32;
    let axes = Axes {
        top,
        head: TITLE + LEGEND_LINE * curves.len() as f64,
        x_decades: (from, (to.floor() as i32 + 1).max(from + 2)),
        y_decades: least - 1,
    };
    // Writing to a string does not fail.
    let _ = frame(text, &axes, title);
    for (index, curve) in curves.iter().enumerate() {
        let _ = line(text, &axes, curve, index);
    }
}

fn frame(text: &mut String, axes: &Axes, title: &str) -> std::fmt::Result {
    let (left, right) = (LEFT, WIDTH - RIGHT);
    let (top, bottom) = (axes.y(1.0), axes.y(0.0));
    writeln!(
        text,
        "<text x=\"{left}\" y=\"{}\" font-size=\"17\">{title}</text>",
        axes.top + 28.0
    )?;
    for decade in axes.x_decades.0..=axes.x_decades.1 {
        let x = axes.x(10_f64.powi(decade));
        writeln!(text, "<path d=\"M{x:.1} {top:.1}V{bottom:.1}\" stroke=\"#bbb\"/>")?;
        let (y, label) = (bottom + 20.0, time(decade));
        writeln!(
            text,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{label}</text>"
        )?;
        for within in (2..10).filter(|_| decade < axes.x_decades.1) {
            let x = axes.x(f64::from(within) * 10_f64.powi(decade));
            writeln!(text, "<path d=\"M{x:.1} {top:.1}V{bottom:.1}\" stroke=\"#eee\"/>")?;
        }
    }
    for decade in axes.y_decades..=0 {
        let y = axes.y(10_f64.powi(decade));
        writeln!(text, "<path d=\"M{left} {y:.1}H{right}\" stroke=\"#ddd\"/>")?;
        let (x, y, label) = (left - 8.0, y + 5.0, superscript(decade));
        writeln!(
            text,
            "<text x=\"{x}\" y=\"{y:.1}\" text-anchor=\"end\">10{label}</text>"
        )?;
    }
    writeln!(
        text,
        "<rect x=\"{left}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" stroke=\"black\"/>",
        right - left,
        bottom - top
    )?;
    let (x, y) = (0.5 * (left + right), bottom + 46.0);
    writeln!(
        text,
        "<text x=\"{x}\" y=\"{y:.1}\" text-anchor=\"middle\">time t (virtual, logarithmic)</text>"
    )?;
    let y = 0.5 * (top + bottom);
    writeln!(
        text,
        "<text transform=\"translate(24 {y:.1}) rotate(-90)\" text-anchor=\"middle\">fraction not serviced within t</text>"
    )
}

fn line(text: &mut String, axes: &Axes, curve: &Curve, index: usize) -> std::fmt::Result {
    let colour = COLOURS[index % COLOURS.len()];
    let dashes = DASHES[index % DASHES.len()];
    let mut path = format!("M{LEFT} {:.1}", axes.y(1.0));
    for (ns, fraction) in &curve.points {
        write!(path, "H{:.1}V{:.1}", axes.x(*ns), axes.y(*fraction))?;
    }
    writeln!(
        text,
        "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2.5\" stroke-dasharray=\"{dashes}\"/>"
    )?;
    let y = axes.top + TITLE + LEGEND_LINE * index as f64;
    let (from, to) = (LEFT, LEFT + 50.0);
    writeln!(
        text,
        "<path d=\"M{from} {y:.1}H{to}\" stroke=\"{colour}\" stroke-width=\"2.5\" stroke-dasharray=\"{dashes}\"/>"
    )?;
    let label = &curve.label;
    writeln!(text, "<text x=\"{}\" y=\"{:.1}\">{label}</text>", to + 10.0, y + 5.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report() -> LatencyReport {
        let curve = |label: &str, quantity, scale: f64| Curve {
            label: label.to_owned(),
            quantity,
            points: vec![(40.0 * scale, 0.1), (400.0 * scale, 1e-5), (5_000.0 * scale, 0.0)],
        };
        LatencyReport {
            bench: "latency",
            rows: Vec::new(),
            instructions_per_us: 125.0,
            passed: true,
            curves: vec![
                curve("idle", "total_delay", 10.0),
                curve("serial", "total_delay", 20.0),
                curve("idle", "release_delay", 1.0),
            ],
        }
    }

    #[test]
    fn every_curve_is_drawn_inside_the_frame_with_its_name_and_both_axes_have_titles() {
        let text = svg(&report());
        assert_eq!(
            text.matches("stroke-width=\"2.5\"").count(),
            2 * 3,
            "line and legend of each"
        );
        for title in ["fraction not serviced within t", "time t", "serial", "100 ns", "10⁻⁵"] {
            assert!(text.contains(title), "{title}");
        }
        assert!(!text.contains("NaN") && !text.contains("inf"));
        let places = text.split('H').skip(1).filter_map(|rest| rest.split(['V', '"']).next());
        for x in places.filter_map(|x| x.parse::<f64>().ok()) {
            assert!((LEFT..=WIDTH - RIGHT).contains(&x), "{x}");
        }
    }
}
