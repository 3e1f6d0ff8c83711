//! Marks on a sheet: the drawing that makes them, and the table in which somebody writes where they are.

use etherpen::config::Paper;
use std::fmt::Write;

/// Length of a cross's lines, mm.
const CROSS_MM: f64 = 6.0;
/// Part of the sheet's side that the marks leave free on each side.
const MARGIN_PART: f64 = 0.06;
/// First line of the table.
const HEAD: &str = "x_mm,y_mm,measured_x_mm,measured_y_mm";
/// Most marks of a table.
const MARKS_MAX: usize = 2_500;

/// A mark: where it should be, from the middle of the sheet, and where it was measured in any frame on the sheet; x to the
/// right, y up, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Where it should be.
    pub wanted_mm: [f64; 2],
    /// Where it is.
    pub measured_mm: [f64; 2],
}

/// Where the marks of a pattern should be, from the middle of the sheet: `side` by `side` of them, row by row from the
/// lower left one.
#[must_use]
pub fn places(paper: &Paper, side: usize) -> Vec<[f64; 2]> {
    let reach = paper
        .size_mm
        .map(|size_mm| (0.5 - MARGIN_PART) * size_mm - 0.5 * CROSS_MM);
    let part = |index: usize| 2.0 * index as f64 / (side.max(2) - 1) as f64 - 1.0;
    let rows = (0..side).flat_map(|row| (0..side).map(move |column| [column, row]));
    let rounded = |mm: f64| (mm * 1e3).round() / 1e3;
    rows.map(|[column, row]| [rounded(part(column) * reach[0]), rounded(part(row) * reach[1])])
        .collect()
}

/// The drawing: a cross at each place, as SVG of the sheet's size.
#[must_use]
pub fn svg(paper: &Paper, places: &[[f64; 2]]) -> String {
    let [width, height] = paper.size_mm;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\" \
         fill=\"none\" stroke=\"black\" stroke-width=\"0.2\">\n"
    );
    let half = 0.5 * CROSS_MM;
    for [x, y] in places {
        // Its y goes down.
        let (x, y) = (0.5 * width + x, 0.5 * height - y);
        // A String takes everything.
        let _ = writeln!(
            text,
            "<path d=\"M{:.3} {y:.3}H{:.3}M{x:.3} {:.3}V{:.3}\"/>",
            x - half,
            x + half,
            y - half,
            y + half
        );
    }
    text + "</svg>\n"
}

/// The table to be filled in.
#[must_use]
pub fn table(places: &[[f64; 2]]) -> String {
    let mut text = format!("{HEAD}\n");
    for [x, y] in places {
        let _ = writeln!(text, "{x:.3},{y:.3},,");
    }
    text
}

/// Reads a table. Lines whose measured values are empty are marks that were not measured; lines that begin with `#` are
/// comments.
///
/// # Errors
/// The line that cannot be read, and why.
pub fn read(text: &str) -> Result<Vec<Mark>, String> {
    let mut marks = Vec::new();
    for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') || line.starts_with("x_mm") {
            continue;
        }
        let cells: Vec<&str> = line.split([',', ';', '\t']).map(str::trim).collect();
        let [x, y, measured @ ..] = cells.as_slice() else {
            return Err(format!("line {number}: {HEAD} are needed"));
        };
        let number_of = |cell: &str| {
            let read: Option<f64> = cell.parse().ok().filter(|value: &f64| value.is_finite());
            read.ok_or_else(|| format!("line {number}: \"{cell}\" is no number of millimetres"))
        };
        match measured {
            [] | ["" | "-"] | ["" | "-", "" | "-"] => {
                // It has to be a mark even so.
                number_of(x)?;
                number_of(y)?;
            }
            [measured_x, measured_y] => marks.push(Mark {
                wanted_mm: [number_of(x)?, number_of(y)?],
                measured_mm: [number_of(measured_x)?, number_of(measured_y)?],
            }),
            _ => {
                return Err(format!(
                    "line {number}: {HEAD} are needed, a point as decimal mark and a comma between the values"
                ));
            }
        }
        if marks.len() > MARKS_MAX {
            return Err(format!("there are more than {MARKS_MAX} marks"));
        }
    }
    Ok(marks)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_is_on_the_sheet_around_its_middle_and_its_table_is_read() {
        let paper = Paper {
            size_mm: [300.0, 200.0],
            ..Paper::default()
        };
        let places = places(&paper, 5);
        assert_eq!(places.len(), 25);
        for axis in 0..2 {
            let sum: f64 = places.iter().map(|place| place[axis]).sum();
            let most = places.iter().map(|place| place[axis].abs()).fold(0.0, f64::max);
            assert!(sum.abs() < 1e-9 && most + 0.5 * CROSS_MM < 0.5 * paper.size_mm[axis]);
            assert!(most > 0.4 * paper.size_mm[axis]);
        }
        assert_eq!(svg(&paper, &places).matches("<path").count(), 25);
        let text = table(&places);
        assert_eq!(read(&text), Ok(Vec::new()));
        let filled = text.replacen(",,\n", ",1.5,-2\n", 1).replacen(",,\n", "; 3 ;4\r\n", 1);
        let marks = read(&format!("\u{feff}# by hand\n{filled}\n")).expect("two marks");
        assert_eq!(marks.len(), 2);
        assert_eq!((marks[0].wanted_mm, marks[0].measured_mm), (places[0], [1.5, -2.0]));
        assert_eq!(marks[1].measured_mm, [3.0, 4.0]);
    }

    #[test]
    fn what_is_no_table_is_refused_with_its_line() {
        for (text, part) in [
            ("1,2,3,4\nx,2,3,4\n", "line 2: \"x\""),
            ("1,2,3\n", "line 1"),
            ("1\n", "line 1"),
            ("\n\n1,2,3,inf\n", "line 3"),
            ("1,2,3,4,5\n", "decimal mark"),
        ] {
            let refused = read(text).expect_err(text);
            assert!(refused.contains(part), "{refused}");
        }
    }
}
