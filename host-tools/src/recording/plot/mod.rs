//! Signals of a recording as a picture: one panel for each unit, over one time axis.
//!
//! The legend is above a panel, where no curve crosses it. Times without samples are shaded and no line crosses them.
//! Invariant: every scale has its unit.

mod curves;

use super::Playback;
use super::mcap::Source;
use super::signals::Signal;
use crate::plot::{
    Anchor, COLOURS, Colour, Frame, INK, Pen, Picture, Scale, legend_entry, legend_width, marks, number, round_marks,
};
use curves::Curves;
use etherpen::application::Mode;
use std::io;

const WIDTH: f64 = 1_120.0;
const LEFT: f64 = 118.0;
const RIGHT: f64 = 26.0;
const PANEL_WIDTH: f64 = WIDTH - LEFT - RIGHT;
const PANEL_HEIGHT: f64 = 210.0;
/// Height of a line of text.
const LINE: f64 = 20.0;
/// Below a panel, for its time axis.
const FOOT: f64 = 40.0;
/// Width of a curve.
const CURVE: f64 = 1.3;
/// Narrowest gap shown, units of the picture.
const GAP_WIDTH_MIN: f64 = 1.5;

const MISSING: Colour = [250, 214, 208];
/// Form of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Scalable Vector Graphics.
    Svg,
    /// Portable Network Graphics.
    Png,
}

/// Plots signals of the rest of a recording; `None` if there is no sample.
///
/// # Errors
/// The rest of the recording cannot be read, or the picture cannot be encoded.
pub fn plot<R: Source>(playback: &mut Playback<R>, signals: &[Signal], form: Form) -> io::Result<Option<Vec<u8>>> {
    let Some(curves) = Curves::collect(playback, signals)? else {
        return Ok(None);
    };
    let picture = draw(&curves, signals);
    match form {
        Form::Svg => Ok(Some(picture.svg().into_bytes())),
        Form::Png => picture.png().map(Some),
    }
}

/// A panel's signals: their indices in the list.
struct Panel<'a> {
    title: String,
    signals: Vec<(usize, &'a Signal)>,
}

/// Groups signals of one unit into one panel; each state has its own panel.
fn panels(signals: &[Signal]) -> Vec<Panel<'_>> {
    let mut panels: Vec<Panel> = Vec::new();
    for (k, signal) in signals.iter().enumerate() {
        let title = match signal.unit {
            "" => signal.name.clone(),
            "rad" if signal.name.contains("error") => "following error, rad".to_owned(),
            "rad" => "angle, rad".to_owned(),
            "rad/s" => "speed, rad/s".to_owned(),
            "mm" => "position, mm".to_owned(),
            unit => format!("{}, {unit}", signal.name),
        };
        let room = panels
            .iter_mut()
            .find(|panel| panel.title == title && panel.signals.len() < COLOURS.len());
        match room {
            Some(panel) => panel.signals.push((k, signal)),
            None => panels.push(Panel {
                title,
                signals: vec![(k, signal)],
            }),
        }
    }
    panels
}

fn draw(curves: &Curves, signals: &[Signal]) -> Picture {
    let panels = panels(signals);
    let heads: Vec<Vec<Vec<usize>>> = panels.iter().map(legend_rows).collect();
    let head = |rows: &Vec<Vec<usize>>| LINE * (1.4 + rows.len() as f64);
    let height: f64 = heads.iter().map(|rows| head(rows) + PANEL_HEIGHT + FOOT).sum();
    let mut picture = Picture::new(WIDTH, height + 10.0);
    let mut top = 0.0;
    for (panel, rows) in panels.iter().zip(&heads) {
        legend(&mut picture, panel, rows, top);
        top += head(rows);
        draw_panel(&mut picture, curves, panel, top);
        top += PANEL_HEIGHT + FOOT;
    }
    picture
}

/// Indices of the panel's signals in the rows of its legend.
fn legend_rows(panel: &Panel) -> Vec<Vec<usize>> {
    let mut rows: Vec<Vec<usize>> = vec![Vec::new()];
    let mut used = 0.0;
    for (place, (_, signal)) in panel.signals.iter().enumerate() {
        let width = legend_width(&signal.name);
        if used > 0.0 && used + width > PANEL_WIDTH {
            rows.push(Vec::new());
            used = 0.0;
        }
        used += width;
        if let Some(row) = rows.last_mut() {
            row.push(place);
        }
    }
    rows
}

fn pen(place: usize) -> Pen {
    Pen {
        colour: COLOURS.get(place % COLOURS.len()).copied().unwrap_or(INK),
        width: CURVE,
        dashes: &[],
    }
}

fn legend(picture: &mut Picture, panel: &Panel, rows: &[Vec<usize>], top: f64) {
    let mut y = top + LINE;
    picture.text([LEFT, y], Anchor::Start, &panel.title, INK);
    for row in rows {
        y += LINE;
        let mut x = LEFT;
        for place in row {
            if let Some((_, signal)) = panel.signals.get(*place) {
                x += legend_entry(picture, [x, y], pen(*place), &signal.name);
            }
        }
    }
}

/// The scale of a panel's values.
fn range(curves: &Curves, panel: &Panel) -> [f64; 2] {
    let ranges = panel.signals.iter().filter_map(|(k, _)| curves.range(*k));
    let all = ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    with_room(all.unwrap_or([0.0, 1.0]))
}

/// Adds a margin around the values; a constant needs a scale too, and a value that is almost zero its own scale.
fn with_room([low, high]: [f64; 2]) -> [f64; 2] {
    let (room, tenth) = (0.06 * (high - low), 0.1 * high.abs());
    // A smaller difference is the rounding error of the computation.
    let is_flat = high - low <= 1e-10 * high.abs().max(low.abs()) + 1e-11;
    let room = match (!is_flat, tenth > 1e-4) {
        (true, _) => room,
        (false, true) => tenth,
        (false, false) => 1.0,
    };
    [low - room, high + room]
}

fn draw_panel(picture: &mut Picture, curves: &Curves, panel: &Panel, top: f64) {
    let [low, high] = range(curves, panel);
    let [begin, end] = curves.span_s;
    let times = [begin, end.max(begin + 1e-3)];
    let frame = Frame {
        left: LEFT,
        top,
        width: PANEL_WIDTH,
        height: PANEL_HEIGHT,
        across: Scale::Linear(times),
        up: Scale::Linear([low, high]),
    };
    for gap in &curves.gaps_s {
        let (from, to) = (frame.x(gap[0]), frame.x(gap[1]).min(LEFT + PANEL_WIDTH));
        picture.fill([from, top, (to - from).max(GAP_WIDTH_MIN), PANEL_HEIGHT], MISSING);
    }
    frame.marks_up(picture, scale(panel, low, high));
    frame.marks_across(picture, round_marks(times));
    let name = if curves.gaps_s.is_empty() {
        "time since the recording began, s"
    } else {
        "time since the recording began, s (shaded: samples are missing)"
    };
    frame.name_across(picture, name);
    for (place, (k, signal)) in panel.signals.iter().enumerate() {
        for piece in curves.pieces(*k, signal.is_state()) {
            frame.curve(picture, &piece, pen(place));
        }
    }
    frame.border(picture);
}

/// Marks of a panel's scale and their texts; marks of the mode are names.
fn scale(panel: &Panel, low: f64, high: f64) -> Vec<(f64, String)> {
    if panel.signals.iter().any(|(_, signal)| signal.is_mode()) {
        let named = (0_u8..)
            .zip(Mode::ALL)
            .map(|(k, mode)| (f64::from(k), format!("{mode:?}")));
        return named.filter(|(value, _)| (low..=high).contains(value)).collect();
    }
    let whole = panel.signals.iter().all(|(_, signal)| signal.is_whole());
    let all = marks(low, high).into_iter();
    let shown = all.filter(|value| !whole || value.fract() == 0.0);
    let text = |value: f64| {
        if whole {
            format!("{value:.0}")
        } else {
            number(value, high - low)
        }
    };
    shown.map(|value| (value, text(value))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Lcg;

    #[test]
    fn marks_of_any_range_are_different() {
        let mut random = Lcg::new(20_261_122);
        let mut next = || random.unit();
        for _ in 0..100_000 {
            let middle = (next() - 0.5) * 10_f64.powf(8.0 * next() - 4.0);
            let span = 10_f64.powf(16.0 * next() - 13.0);
            let [low, high] = with_room([middle, middle + span]);
            let marks = marks(low, high);
            let mut texts: Vec<String> = marks.iter().map(|mark| number(*mark, high - low)).collect();
            let count = texts.len();
            texts.dedup();
            assert!(count > 0 && texts.len() == count, "{middle} + {span}: {texts:?}");
        }
    }

    #[test]
    fn what_does_not_change_has_a_scale_with_different_marks() {
        for value in [0.0, -0.0, 1e-9, 0.5967, -620.463_536, 1e6] {
            let [low, high] = with_room([value, value]);
            assert!(low < value && value < high, "{value}");
            let mut texts: Vec<String> = marks(low, high)
                .into_iter()
                .map(|mark| number(mark, high - low))
                .collect();
            let count = texts.len();
            texts.dedup();
            assert!(count > 1 && texts.len() == count, "{value}: {texts:?}");
        }
    }
}
