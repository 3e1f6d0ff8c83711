//! Plots: panels with scales, curves and legends, as SVG or PNG.
//!
//! The plots of recordings, of the tracking of a drawing and of latencies are made of these parts.

mod picture;
mod scale;

pub use picture::{Anchor, Colour, LETTER_WIDTH, Picture};
pub use scale::{Scale, marks, number};

/// Text and borders.
pub const INK: Colour = [34, 34, 34];
/// Lines at the marks of a scale.
pub const FAINT: Colour = [222, 222, 222];
/// Colours that differ for most eyes and in grey print (Okabe and Ito, 2008).
pub const COLOURS: [Colour; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [0, 0, 0],
];
/// Length of the line in a legend's entry, units of the picture.
const LEGEND_LINE: f64 = 26.0;

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pen {
    /// Colour.
    pub colour: Colour,
    /// Width, units of the picture.
    pub width: f64,
    /// Lengths of dashes and gaps in turn; none for an unbroken line.
    pub dashes: &'static [f64],
}

/// The frame of a panel and its scales; units are those of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Left edge.
    pub left: f64,
    /// Upper edge.
    pub top: f64,
    /// Width.
    pub width: f64,
    /// Height.
    pub height: f64,
    /// Scale from left to right.
    pub across: Scale,
    /// Scale from bottom to top.
    pub up: Scale,
}

impl Frame {
    /// Distance from the picture's left edge.
    #[must_use]
    pub fn x(&self, value: f64) -> f64 {
        self.left + self.width * self.across.share(value)
    }

    /// Distance from the picture's upper edge.
    #[must_use]
    pub fn y(&self, value: f64) -> f64 {
        self.top + self.height * (1.0 - self.up.share(value))
    }

    /// Lower edge.
    #[must_use]
    pub fn bottom(&self) -> f64 {
        self.top + self.height
    }

    /// Draws a line and a text at each mark of the vertical scale.
    pub fn marks_up(&self, picture: &mut Picture, marks: impl IntoIterator<Item = (f64, String)>) {
        for (value, text) in marks {
            let y = self.y(value);
            picture.fill([self.left, y - 0.5, self.width, 1.0], FAINT);
            picture.text([self.left - LETTER_WIDTH, y + 4.5], Anchor::End, text, INK);
        }
    }

    /// Draws a line and a text at each mark of the horizontal scale.
    pub fn marks_across(&self, picture: &mut Picture, marks: impl IntoIterator<Item = (f64, String)>) {
        for (value, text) in marks {
            let x = self.x(value);
            picture.fill([x - 0.5, self.top, 1.0, self.height], FAINT);
            picture.text([x, self.bottom() + 16.0], Anchor::Middle, text, INK);
        }
    }

    /// Writes the name of the horizontal scale below its marks.
    pub fn name_across(&self, picture: &mut Picture, name: &str) {
        let middle = self.left + 0.5 * self.width;
        picture.text([middle, self.bottom() + 33.0], Anchor::Middle, name, INK);
    }

    /// Draws a curve along points in the units of the scales. A single point is drawn as a dot.
    pub fn curve(&self, picture: &mut Picture, points: &[[f64; 2]], pen: Pen) {
        let mut points: Vec<[f64; 2]> = points.iter().map(|[x, y]| [self.x(*x), self.y(*y)]).collect();
        if let [only] = points.as_slice() {
            points.push([only[0] + 0.5, only[1]]);
        }
        picture.dashed(points, pen.width, pen.colour, pen.dashes);
    }

    /// Draws the frame's edges.
    pub fn border(&self, picture: &mut Picture) {
        for [x, y, width, height] in [
            [self.left, self.top, self.width, 1.0],
            [self.left, self.bottom(), self.width, 1.0],
            [self.left, self.top, 1.0, self.height],
            [self.left + self.width, self.top, 1.0, self.height],
        ] {
            picture.fill([x - 0.5, y - 0.5, width, height], INK);
        }
    }
}

/// Round marks of a linear scale with their texts.
#[must_use]
pub fn round_marks([low, high]: [f64; 2]) -> Vec<(f64, String)> {
    let text = |value: f64| (value, number(value, high - low));
    marks(low, high).into_iter().map(text).collect()
}

/// Draws an entry of a legend; `place` is the left end of its baseline. Returns its width.
pub fn legend_entry(picture: &mut Picture, [x, y]: [f64; 2], pen: Pen, name: &str) -> f64 {
    let line = vec![[x, y - 4.5], [x + LEGEND_LINE, y - 4.5]];
    picture.dashed(line, pen.width.max(2.5), pen.colour, pen.dashes);
    picture.text([x + LEGEND_LINE + LETTER_WIDTH, y], Anchor::Start, name, INK);
    legend_width(name)
}

/// Width of a legend's entry with the space behind it.
#[must_use]
pub fn legend_width(name: &str) -> f64 {
    LEGEND_LINE + (name.chars().count() as f64 + 4.0) * LETTER_WIDTH
}
