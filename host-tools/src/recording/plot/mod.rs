//! Signals of a recording as a picture: one panel for each unit, over one time axis.
//!
//! The legend is above a panel, where no curve crosses it. Times without samples are shaded and no line crosses them.
//! Invariant: every scale has its unit.

mod curves;
mod picture;

use super::Playback;
use super::mcap::Source;
use super::signals::Signal;
use crate::plot_scale::{marks, number};
use curves::Curves;
use etherpen::application::Mode;
use picture::{Anchor, Colour, LETTER_WIDTH, Picture};
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
/// Length of the line in a legend's entry.
const LEGEND_LINE: f64 = 26.0;
/// Width of a curve.
const CURVE: f64 = 1.3;
/// Narrowest gap shown, units of the picture.
const GAP_WIDTH_MIN: f64 = 1.5;

const INK: Colour = [34, 34, 34];
const FAINT: Colour = [222, 222, 222];
const MISSING: Colour = [250, 214, 208];
/// Colours that differ for most eyes and in grey print (Okabe and Ito, 2008).
const COLOURS: [Colour; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [0, 0, 0],
];

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

fn entry_width(name: &str) -> f64 {
    LEGEND_LINE + (name.len() as f64 + 4.0) * LETTER_WIDTH
}

/// Indices of the panel's signals in the rows of its legend.
fn legend_rows(panel: &Panel) -> Vec<Vec<usize>> {
    let mut rows: Vec<Vec<usize>> = vec![Vec::new()];
    let mut used = 0.0;
    for (place, (_, signal)) in panel.signals.iter().enumerate() {
        let width = entry_width(&signal.name);
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

fn colour(place: usize) -> Colour {
    COLOURS.get(place % COLOURS.len()).copied().unwrap_or(INK)
}

fn legend(picture: &mut Picture, panel: &Panel, rows: &[Vec<usize>], top: f64) {
    let mut y = top + LINE;
    picture.text([LEFT, y], Anchor::Start, &panel.title, INK);
    for row in rows {
        y += LINE;
        let mut x = LEFT;
        for place in row {
            let Some((_, signal)) = panel.signals.get(*place) else {
                continue;
            };
            picture.curve(vec![[x, y - 4.5], [x + LEGEND_LINE, y - 4.5]], 2.5, colour(*place));
            picture.text([x + LEGEND_LINE + LETTER_WIDTH, y], Anchor::Start, &signal.name, INK);
            x += entry_width(&signal.name);
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
    let length = (end - begin).max(1e-3);
    let across = |time_s: f64| LEFT + PANEL_WIDTH * (time_s - begin) / length;
    let down = |value: f64| top + PANEL_HEIGHT * (high - value) / (high - low);
    for gap in &curves.gaps_s {
        let (from, to) = (across(gap[0]), across(gap[1]).min(LEFT + PANEL_WIDTH));
        picture.fill([from, top, (to - from).max(GAP_WIDTH_MIN), PANEL_HEIGHT], MISSING);
    }
    for (value, text) in scale(panel, low, high) {
        picture.fill([LEFT, down(value) - 0.5, PANEL_WIDTH, 1.0], FAINT);
        picture.text([LEFT - LETTER_WIDTH, down(value) + 4.5], Anchor::End, text, INK);
    }
    let bottom = top + PANEL_HEIGHT;
    for time_s in marks(begin, begin + length) {
        picture.fill([across(time_s) - 0.5, top, 1.0, PANEL_HEIGHT], FAINT);
        let text = number(time_s, length);
        picture.text([across(time_s), bottom + 16.0], Anchor::Middle, text, INK);
    }
    let middle = LEFT + 0.5 * PANEL_WIDTH;
    let axis = if curves.gaps_s.is_empty() {
        "time since the recording began, s"
    } else {
        "time since the recording began, s (shaded: samples are missing)"
    };
    picture.text([middle, bottom + 33.0], Anchor::Middle, axis, INK);
    for (place, (k, signal)) in panel.signals.iter().enumerate() {
        for piece in curves.pieces(*k, signal.is_state()) {
            let mut points: Vec<[f64; 2]> = piece.iter().map(|[t, value]| [across(*t), down(*value)]).collect();
            // A single sample is a dot.
            if let [only] = points.as_slice() {
                points.push([only[0] + 0.5, only[1]]);
            }
            picture.curve(points, CURVE, colour(place));
        }
    }
    for [x, y, width, height] in [
        [LEFT, top, PANEL_WIDTH, 1.0],
        [LEFT, bottom, PANEL_WIDTH, 1.0],
        [LEFT, top, 1.0, PANEL_HEIGHT],
        [LEFT + PANEL_WIDTH, top, 1.0, PANEL_HEIGHT],
    ] {
        picture.fill([x - 0.5, y - 0.5, width, height], INK);
    }
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
