//! Plot of the fraction of requests not serviced within a time, with logarithmic axes.
//!
//! Two panels: from the release until the reply is served, as in the paper's figures 7 and 8, and the delay of the
//! release itself, where a critical section that masks too much shows first.

use super::{Curve, LatencyReport};
use crate::plot::{Anchor, COLOURS, Frame, INK, Pen, Picture, Scale, legend_entry};

const WIDTH: f64 = 920.0;
const PANEL_HEIGHT: f64 = 500.0;
const LEFT: f64 = 90.0;
const RIGHT: f64 = 24.0;
/// Height of a panel's title, and of each line of the legend below it.
const TITLE: f64 = 62.0;
const LEGEND_LINE: f64 = 22.0;
const BOTTOM: f64 = 64.0;
/// Colour of the lines between two decades.
const FAINTER: [u8; 3] = [240, 240, 240];
/// Curves of different runs may coincide; dashes keep both visible.
const DASHES: [&[f64]; 6] = [
    &[],
    &[9.0, 5.0],
    &[2.0, 4.0],
    &[12.0, 4.0, 2.0, 4.0],
    &[5.0, 3.0],
    &[1.0, 3.0],
];
/// Times below this are drawn at the left edge, ns: a count of the board's timer.
const FLOOR_NS: f64 = 40.0;
const PANELS: [(&str, &str); 2] = [
    ("total_delay", "Release to reply served"),
    ("release_delay", "Release to the first instruction of sample"),
];

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
    let mut picture = Picture::new(WIDTH, PANEL_HEIGHT * PANELS.len() as f64);
    for (index, (quantity, title)) in PANELS.iter().enumerate() {
        let curves = report.curves.iter().filter(|curve| curve.quantity == *quantity);
        panel(
            &mut picture,
            index as f64 * PANEL_HEIGHT,
            title,
            &curves.collect::<Vec<_>>(),
        );
    }
    picture.svg()
}

fn panel(picture: &mut Picture, top: f64, title: &str, curves: &[&Curve]) {
    let points = || curves.iter().flat_map(|curve| curve.points.iter());
    let times = || points().map(|(ns, _)| ns.max(FLOOR_NS).log10());
    // A curve that begins at the edge would coincide with it.
    let from = (times().fold(f64::INFINITY, f64::min) - 0.15).floor();
    let to = times().fold(f64::NEG_INFINITY, f64::max);
    if !from.is_finite() || !to.is_finite() {
        return;
    }
    let fractions = points()
        .map(|(_, fraction)| *fraction)
        .filter(|fraction| *fraction > 0.0);
    let least = fractions.fold(0.1, f64::min).log10().floor() as i32 - 1;
    let from = from as i32;
    let to = (to.floor() as i32 + 1).max(from + 2);
    let head = TITLE + LEGEND_LINE * curves.len() as f64;
    let frame = Frame {
        left: LEFT,
        top: top + head,
        width: WIDTH - LEFT - RIGHT,
        height: PANEL_HEIGHT - head - BOTTOM,
        across: Scale::Logarithmic([decade(from), decade(to)]),
        up: Scale::Logarithmic([decade(least), 1.0]),
    };
    picture.text([LEFT, top + 28.0], Anchor::Start, title, INK);
    let name = "fraction not serviced within t";
    picture.text([LEFT, frame.top - 10.0], Anchor::Start, name, INK);
    for within in (from..to).flat_map(|k| (2..10).map(move |digit| f64::from(digit) * decade(k))) {
        picture.fill([frame.x(within) - 0.5, frame.top, 1.0, frame.height], FAINTER);
    }
    frame.marks_across(picture, (from..=to).map(|k| (decade(k), time(k))));
    frame.marks_up(
        picture,
        (least..=0).map(|k| (decade(k), format!("10{}", superscript(k)))),
    );
    frame.name_across(picture, "time t (virtual, logarithmic)");
    for (index, curve) in curves.iter().enumerate() {
        let pen = Pen {
            colour: COLOURS.get(index % COLOURS.len()).copied().unwrap_or(INK),
            width: 2.5,
            dashes: DASHES.get(index % DASHES.len()).copied().unwrap_or(&[]),
        };
        let y = top + TITLE - 10.0 + LEGEND_LINE * index as f64;
        legend_entry(picture, [LEFT, y], pen, &curve.label);
        frame.curve(picture, &steps(curve, decade(from), decade(least)), pen);
    }
    frame.border(picture);
}

fn decade(exponent: i32) -> f64 {
    10_f64.powi(exponent)
}

/// The curve's steps: the fraction keeps its value until the next time. A fraction below `least` is drawn at it.
fn steps(curve: &Curve, from_ns: f64, least: f64) -> Vec<[f64; 2]> {
    let mut fraction = 1.0;
    let mut steps = vec![[from_ns, fraction]];
    for (ns, next) in &curve.points {
        let ns = ns.max(FLOOR_NS);
        steps.push([ns, fraction]);
        fraction = next.max(least);
        steps.push([ns, fraction]);
    }
    steps
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
        for title in [
            "fraction not serviced within t",
            "time t",
            "idle",
            "serial",
            "100 ns",
            "10⁻⁵",
        ] {
            assert!(text.contains(title), "{title}");
        }
        assert!(!text.contains("NaN") && !text.contains("inf"));
        let curves = text
            .split("points=\"")
            .skip(1)
            .filter_map(|rest| rest.split('"').next());
        let mut heights = [f64::INFINITY, 0.0_f64];
        for point in curves.flat_map(str::split_whitespace) {
            let (x, y) = point.split_once(',').unwrap();
            let (x, y): (f64, f64) = (x.parse().unwrap(), y.parse().unwrap());
            assert!((LEFT..=WIDTH - RIGHT).contains(&x), "{x}");
            heights = [heights[0].min(y), heights[1].max(y)];
        }
        assert!(
            heights[0] > 0.0 && heights[1] > 2.0 * PANEL_HEIGHT - 2.0 * BOTTOM,
            "{heights:?}"
        );
        assert!(heights[1] <= 2.0 * PANEL_HEIGHT - BOTTOM, "{heights:?}");
    }
}
