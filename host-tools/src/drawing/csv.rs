//! Lists of coordinates: strokes on a sheet, or a path in the robot's frame.
//!
//! The heading distinguishes the two. A pen of 1 means that the leg to the point is drawn. If the first point is drawn,
//! the stroke starts there, so a list of drawn points alone is one stroke. Errors contain the line.

use super::plot::PLACE_MAX_MM;
use super::{Drawing, DrawingError, FilePlace, Stroke};
use etherpen::motion::{Pen, Vertex};
use etherpen::robots::Position;

/// Heading of strokes on a sheet.
const SHEET_HEADING: [&str; 3] = ["x_mm", "y_mm", "pen"];
/// Heading of a path in the robot's frame.
const ROBOT_HEADING: [&str; 4] = ["x_mm", "y_mm", "z_mm", "pen"];
/// Default width and height of the sheet for a list of coordinates, mm.
const SHEET_MM: [f64; 2] = [200.0, 200.0];

/// A path in the robot's frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path3d {
    /// Vertices of the path, in order.
    pub vertices: Vec<Vertex>,
    /// Line of the file for each vertex, from 1.
    pub lines: Vec<usize>,
}

/// Content of a list of coordinates.
#[derive(Clone, Debug)]
pub enum Coordinates {
    /// Strokes on a sheet.
    Sheet(Drawing),
    /// A path in the robot's frame.
    Robot(Path3d),
}

/// Reads `x_mm,y_mm,pen` (sheet; the sheet is 200 mm x 200 mm) or `x_mm,y_mm,z_mm,pen` (robot). A robot path may have
/// any number of vertices, and none of them need be drawn.
///
/// # Errors
///
/// The `Csv...` variants of [`DrawingError`], with the line.
pub fn read_csv(text: &str) -> Result<Coordinates, DrawingError> {
    let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate();
    let heading: Vec<&str> = lines
        .next()
        .map(|(_, line)| line.split(',').map(str::trim).collect())
        .unwrap_or_default();
    let columns = if heading == SHEET_HEADING || heading == ROBOT_HEADING {
        heading.len()
    } else {
        return Err(DrawingError::CsvHeading);
    };
    let mut rows = Vec::new();
    for (number, line) in lines {
        if !line.trim().is_empty() {
            rows.push(read_row(line, number + 1, columns)?);
        }
    }
    if columns == ROBOT_HEADING.len() {
        return Ok(Coordinates::Robot(Path3d {
            vertices: vertices(&rows),
            lines: rows.iter().map(|row| row.line).collect(),
        }));
    }
    strokes(&rows).map(Coordinates::Sheet)
}

struct CsvRow {
    line: usize,
    position_mm: [f64; 3],
    pen_down: bool,
}

fn read_row(line: &str, number: usize, columns: usize) -> Result<CsvRow, DrawingError> {
    let fields: Vec<&str> = line.split(',').map(str::trim).collect();
    if fields.len() != columns {
        return Err(DrawingError::CsvColumns {
            line: number,
            expected: columns,
            actual: fields.len(),
        });
    }
    let (pen, coordinates) = fields.split_last().ok_or(DrawingError::CsvPen { line: number })?;
    let mut position_mm = [0.0; 3];
    for (k, (field, value)) in coordinates.iter().zip(&mut position_mm).enumerate() {
        *value = (field.parse().ok().filter(|value: &f64| value.is_finite())).ok_or(DrawingError::CsvNumber {
            line: number,
            column: k + 1,
        })?;
        if value.abs() > PLACE_MAX_MM {
            return Err(DrawingError::FarAway {
                place: FilePlace::Line(number),
            });
        }
    }
    let pen_down = match *pen {
        "1" => true,
        "0" => false,
        _ => return Err(DrawingError::CsvPen { line: number }),
    };
    Ok(CsvRow {
        line: number,
        position_mm,
        pen_down,
    })
}

/// A pen raised after a drawn leg ends a stroke.
fn vertices(rows: &[CsvRow]) -> Vec<Vertex> {
    let (mut stroke, mut was_down) = (0, false);
    let mut result = Vec::with_capacity(rows.len());
    for row in rows {
        let [x_mm, y_mm, z_mm] = row.position_mm;
        let pen = if row.pen_down { Pen::Down } else { Pen::Up };
        result.push(Vertex {
            position: Position { x_mm, y_mm, z_mm },
            pen,
            stroke,
        });
        stroke += u32::from(was_down && !row.pen_down);
        was_down = row.pen_down;
    }
    result
}

fn strokes(rows: &[CsvRow]) -> Result<Drawing, DrawingError> {
    let mut drawing = Drawing {
        sheet_mm: SHEET_MM,
        strokes: Vec::new(),
    };
    let mut points = Vec::new();
    for row in rows {
        let [x, y, _] = row.position_mm;
        if !row.pen_down {
            drawing.strokes.push(Stroke {
                points: std::mem::take(&mut points),
            });
        }
        points.push([x, y]);
    }
    drawing.strokes.push(Stroke { points });
    drawing.strokes.retain(|stroke| stroke.points.len() > 1);
    if drawing.strokes.is_empty() {
        Err(DrawingError::CsvNothingDrawn)
    } else {
        Ok(drawing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pen_column_separates_strokes() {
        let text = "x_mm,y_mm,pen\n1,1,0\n2,1,1\n3,1,1\n\n5,5,0\n9,9,0\n9,8,1\n";
        let Ok(Coordinates::Sheet(drawing)) = read_csv(text) else {
            panic!("refused")
        };
        let points: Vec<_> = drawing.strokes.iter().map(|stroke| stroke.points.clone()).collect();
        assert_eq!(
            points,
            [vec![[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]], vec![[9.0, 9.0], [9.0, 8.0]]]
        );
    }

    #[test]
    fn points_that_are_all_drawn_are_one_stroke() {
        let Ok(Coordinates::Sheet(drawing)) = read_csv("x_mm, y_mm, pen\r\n1,2,1\r\n3,4,1\r\n") else {
            panic!("refused")
        };
        assert_eq!(
            drawing.strokes,
            [Stroke {
                points: vec![[1.0, 2.0], [3.0, 4.0]]
            }]
        );
    }

    #[test]
    fn a_fourth_column_makes_it_a_path_of_the_robot() {
        let Ok(Coordinates::Robot(path)) = read_csv("x_mm,y_mm,z_mm,pen\n0,0,-847,0\n0,0,-850,0\n9.5,0,-850,1\n")
        else {
            panic!("refused")
        };
        assert_eq!((path.vertices.len(), path.lines), (3, vec![2, 3, 4]));
        let position = Position {
            x_mm: 9.5,
            y_mm: 0.0,
            z_mm: -850.0,
        };
        assert_eq!(
            path.vertices[2],
            Vertex {
                position,
                pen: Pen::Down,
                stroke: 0
            }
        );
    }

    #[test]
    fn errors_name_the_line() {
        let failure = |text: &str| read_csv(text).err();
        assert_eq!(failure(""), Some(DrawingError::CsvHeading));
        assert_eq!(failure("x,y,pen\n1,1,1\n"), Some(DrawingError::CsvHeading));
        assert_eq!(
            failure("x_mm,y_mm,pen\n1,1,1\n1,1\n"),
            Some(DrawingError::CsvColumns {
                line: 3,
                expected: 3,
                actual: 2
            })
        );
        assert_eq!(
            failure("x_mm,y_mm,pen\n1,one,1\n"),
            Some(DrawingError::CsvNumber { line: 2, column: 2 })
        );
        assert_eq!(
            failure("x_mm,y_mm,pen\nNaN,1,1\n"),
            Some(DrawingError::CsvNumber { line: 2, column: 1 })
        );
        assert_eq!(
            failure("x_mm,y_mm,pen\n1,1,1\n1,1e999,1\n"),
            Some(DrawingError::CsvNumber { line: 3, column: 2 })
        );
        assert_eq!(
            failure("x_mm,y_mm,pen\n1,1,1\n1,1e300,1\n"),
            Some(DrawingError::FarAway {
                place: FilePlace::Line(3)
            })
        );
        assert_eq!(
            failure("x_mm,y_mm,pen\n1,1,down\n"),
            Some(DrawingError::CsvPen { line: 2 })
        );
        assert_eq!(
            failure("x_mm,y_mm,pen\n1,1,0\n2,2,0\n"),
            Some(DrawingError::CsvNothingDrawn)
        );
    }
}
