//! Marks on a sheet: the drawing that makes them, and the table in which somebody writes where they are.

use crate::hash::fnv1a;
use etherpen::config::{Config, Paper};
use std::fmt::Write;

/// Length of a cross's lines, mm.
const CROSS_MM: f64 = 6.0;
/// Part of the sheet's side that the marks leave free on each side.
const MARGIN_PART: f64 = 0.06;
/// Least distance of two crosses, lengths of a cross.
const APART_MIN: f64 = 1.5;
/// What stands before the number of what a table belongs to.
const ORIGIN: &str = "# drawn with ";
/// The columns of the table.
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
///
/// # Errors
/// The sheet is too small for so many.
pub fn places(paper: &Paper, side: usize) -> Result<Vec<[f64; 2]>, String> {
    let side = side.max(2);
    let reach = paper
        .size_mm
        .map(|size_mm| (0.5 - MARGIN_PART) * size_mm - 0.5 * CROSS_MM);
    let apart_mm = reach.map(|reach_mm| 2.0 * reach_mm / (side - 1) as f64);
    if apart_mm.iter().any(|mm| *mm < APART_MIN * CROSS_MM) {
        let [width, height] = paper.size_mm;
        return Err(format!(
            "{side} by {side} crosses of {CROSS_MM} mm do not fit on a sheet of {width} x {height} mm; write fewer"
        ));
    }
    let rounded = |mm: f64| (mm * 1e3).round() / 1e3 + 0.0;
    let place = |column: usize, row: usize| {
        let [x, y] = [column, row].map(|index| 2.0 * index as f64 / (side - 1) as f64 - 1.0);
        [rounded(x * reach[0]), rounded(y * reach[1])]
    };
    Ok((0..side)
        .flat_map(|row| (0..side).map(move |column| (column, row)))
        .map(|(column, row)| place(column, row))
        .collect())
}

/// What a table belongs to: the dimensions, the marks of the axes and the sheet with which its drawing is made. After any of
/// them has changed, the marks say nothing about the machine any more.
#[must_use]
pub fn origin(config: &Config) -> u64 {
    let axes: Vec<_> = config
        .axes
        .iter()
        .map(|axis| (axis.gear, axis.sync_angle_rad))
        .collect();
    let paper = &config.paper;
    let sheet = (paper.centre_mm, paper.size_mm, paper.pen_down_z_mm, paper.slope);
    fnv1a(format!("{:?} {axes:?} {sheet:?}", config.geometry).into_bytes())
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
pub fn table(places: &[[f64; 2]], origin: u64) -> String {
    let mut text = format!("{ORIGIN}{origin:016x}\n{HEAD}\n");
    for [x, y] in places {
        let _ = writeln!(text, "{x:.3},{y:.3},,");
    }
    text
}

/// A table of marks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// The marks that were measured.
    pub marks: Vec<Mark>,
    /// What it belongs to; `None` in a table that somebody has written without it.
    pub origin: Option<u64>,
}

/// Reads a table. Lines whose measured values are empty are marks that were not measured; other lines that begin with `#` are
/// comments. The columns may be in any order if the first line names them.
///
/// # Errors
/// The line that cannot be read, and why.
pub fn read(text: &str) -> Result<Table, String> {
    let mut table = Table::default();
    let mut columns = [0, 1, 2, 3];
    for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        if let Some(origin) = line.trim().trim_matches('"').strip_prefix(ORIGIN) {
            let digits = origin.split([',', ';', '\t']).next().unwrap_or_default();
            let origin = u64::from_str_radix(digits.trim(), 16);
            table.origin =
                Some(origin.map_err(|_| format!("line {number}: it does not say with what the marks were drawn"))?);
            continue;
        }
        let cells: Vec<&str> = line
            .split([',', ';', '\t'])
            .map(|cell| cell.trim().trim_matches('"'))
            .collect();
        if line.trim_start().starts_with('#') || cells.iter().all(|cell| cell.is_empty()) {
            continue;
        }
        match head(&cells) {
            Some(found) => columns = found.map_err(|missing| format!("line {number}: there is no column {missing}"))?,
            None => table
                .marks
                .extend(mark(&cells, columns).map_err(|cause| format!("line {number}: {cause}"))?),
        }
        if table.marks.len() > MARKS_MAX {
            return Err(format!("there are more than {MARKS_MAX} marks"));
        }
    }
    Ok(table)
}

/// The places of the columns in a line that names them, or the one that is missing; `None` for any other line.
fn head(cells: &[&str]) -> Option<Result<[usize; 4], &'static str>> {
    let names: Vec<String> = cells.iter().map(|cell| cell.to_lowercase()).collect();
    names.iter().find(|name| name.ends_with("_mm"))?;
    let mut places = [0; 4];
    for (place, wanted) in places.iter_mut().zip(HEAD.split(',')) {
        match names.iter().position(|name| name == wanted) {
            Some(found) => *place = found,
            None => return Some(Err(wanted)),
        }
    }
    Some(Ok(places))
}

/// The mark of a line; `None` if it was not measured.
fn mark(cells: &[&str], columns: [usize; 4]) -> Result<Option<Mark>, String> {
    if cells.iter().skip(HEAD.split(',').count()).any(|cell| !cell.is_empty()) {
        return Err(format!(
            "{HEAD} are needed, a point as decimal mark and a comma between the values"
        ));
    }
    let cell = |column: usize| cells.get(column).copied().unwrap_or_default();
    let number = |text: &str| {
        let read: Option<f64> = text.parse().ok().filter(|value: &f64| value.is_finite());
        read.ok_or_else(|| format!("\"{text}\" is no number of millimetres"))
    };
    let [x, y, measured_x, measured_y] = columns.map(cell);
    // It has to be a mark even where it was not measured.
    let wanted_mm = [number(x)?, number(y)?];
    let is_empty = |text: &str| text.is_empty() || text == "-";
    if is_empty(measured_x) && is_empty(measured_y) {
        return Ok(None);
    }
    Ok(Some(Mark {
        wanted_mm,
        measured_mm: [number(measured_x)?, number(measured_y)?],
    }))
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
        let places = places(&paper, 5).expect("a large sheet");
        assert_eq!(places.len(), 25);
        for axis in 0..2 {
            let sum: f64 = places.iter().map(|place| place[axis]).sum();
            let most = places.iter().map(|place| place[axis].abs()).fold(0.0, f64::max);
            assert!(sum.abs() < 1e-9 && most + 0.5 * CROSS_MM < 0.5 * paper.size_mm[axis]);
            assert!(most > 0.4 * paper.size_mm[axis]);
        }
        assert_eq!(svg(&paper, &places).matches("<path").count(), 25);
        let text = table(&places, 0x12AB);
        let empty = Table {
            marks: Vec::new(),
            origin: Some(0x12AB),
        };
        assert_eq!(read(&text), Ok(empty));
        let filled = text.replacen(",,\n", ",1.5,-2\n", 1).replacen(",,\n", "; 3 ;4\r\n", 1);
        let marks = read(&format!("\u{feff}# by hand\n{filled}\n"))
            .expect("two marks")
            .marks;
        assert_eq!(marks.len(), 2);
        assert_eq!((marks[0].wanted_mm, marks[0].measured_mm), (places[0], [1.5, -2.0]));
        assert_eq!(marks[1].measured_mm, [3.0, 4.0]);
    }

    #[test]
    fn tables_of_spreadsheets_are_read_by_the_names_of_their_columns() {
        let wanted = Mark {
            wanted_mm: [1.0, 2.0],
            measured_mm: [3.0, 4.0],
        };
        for text in [
            "1,2,3,4\n",
            "\"x_mm\",\"y_mm\",\"measured_x_mm\",\"measured_y_mm\"\r\n1,2,3,4\r\n,,,\r\n",
            "X_MM;Y_MM;MEASURED_X_MM;MEASURED_Y_MM;\n\"1\";2;3;4;\n",
            "measured_y_mm,measured_x_mm,y_mm,x_mm\n4,3,2,1\n",
        ] {
            assert_eq!(read(text).expect(text).marks, [wanted], "{text}");
        }
        let refused = read("x_mm,y_mm,measured_x_mm\n1,2,3\n").expect_err("a column is missing");
        assert!(refused.contains("measured_y_mm"), "{refused}");
    }

    #[test]
    fn a_sheet_that_is_too_small_for_the_pattern_is_refused() {
        for (size_mm, side) in [([5.0, 5.0], 3), ([200.0, 10.0], 3), ([200.0, 200.0], 40)] {
            let paper = Paper {
                size_mm,
                ..Paper::default()
            };
            assert!(places(&paper, side).is_err(), "{size_mm:?} {side}");
        }
    }

    #[test]
    fn what_is_no_table_is_refused_with_its_line() {
        for (text, part) in [
            ("1,2,3,4\nx,2,3,4\n", "line 2: \"x\""),
            ("1,2,3\n", "line 1"),
            ("# drawn with x\n", "line 1"),
            ("1\n", "line 1"),
            ("\n\n1,2,3,inf\n", "line 3"),
            ("1,2,3,4,5\n", "decimal mark"),
        ] {
            let refused = read(text).expect_err(text);
            assert!(refused.contains(part), "{refused}");
        }
    }
}
