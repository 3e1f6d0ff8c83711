//! G-code of pen plotters: straight moves, arcs, units, offsets, and the ways in which pens are raised.
//!
//! Words are read one by one (RS-274/NGC). An unknown motion is an error with its line, because leaving it out would
//! change the drawing; an unknown machine function is skipped with a warning. The pen's dialect is determined from the
//! whole file: M300 S, M3 and M5, or the height Z; without any of these, G0 is up and all other motions are drawn.
//!
//! The crate `gcode` is not used: it continues after unreadable input, where this reader has to refuse, and its numbers
//! have single precision, which is a hundredth of a millimetre at a hundred metres (offsets and machine coordinates can
//! be that large).

use super::artwork::Artwork;
use super::length::MM_PER_INCH;
use super::line;
use super::plot::{Plot, arc_angle};
use super::{DrawingError, FilePlace};

/// Largest distance of an arc's ends from one circle: share of its radius, and mm.
const ARC_SHARE: f64 = 0.01;
const ARC_MM: f64 = 0.1;
/// Smallest S with which M300 raises the pen.
const M300_UP_S: f64 = 40.0;
/// Machine functions without meaning for a pen: stops, coolant, fans, motors, temperatures.
const HARMLESS: [u32; 17] = [0, 1, 2, 6, 7, 8, 9, 17, 18, 30, 82, 84, 104, 106, 107, 109, 140];

/// A letter with its number, and its line.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Word {
    letter: char,
    value: f64,
    line: usize,
}

/// How a file raises and lowers the pen.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Dialect {
    /// M300 S30 is down, M300 S50 is up.
    Servo,
    /// M3 or M4 is down, M5 or S0 is up.
    Spindle,
    /// Below this height the pen is down, file units.
    Height(f64),
    /// G0 is up, other motions are down.
    Rapid,
}

/// Reads G-code.
///
/// # Errors
/// [`DrawingError::GcodeWord`], [`DrawingError::GcodeMotion`], [`DrawingError::GcodeArc`], each with its line, and the
/// errors common to all plots.
pub(super) fn read_gcode(text: &str) -> Result<Artwork, DrawingError> {
    let mut blocks = Vec::new();
    for (line, content) in (1..).zip(text.lines()) {
        let words = words(content, line)?;
        if !words.is_empty() {
            blocks.push(words);
        }
    }
    let mut reader = Reader::new(dialect(&blocks));
    if reader.dialect == Dialect::Rapid {
        reader.plot.warn(
            "no pen command (Z, M3 and M5, or M300): G0 is taken as pen up, G1, G2 and G3 as pen down".to_owned(),
        );
    }
    for block in &blocks {
        let place = FilePlace::Line(block.first().map_or(0, |word| word.line));
        reader.block(block).map_err(|error| error.at(place))?;
    }
    Ok(reader.plot.finish())
}

/// The words of a line, without comments.
fn words(content: &str, line: usize) -> Result<Vec<Word>, DrawingError> {
    let mut result = Vec::new();
    let mut rest = content;
    loop {
        rest = rest.trim_start();
        let Some(letter) = rest.chars().next() else {
            return Ok(result);
        };
        let after = rest.get(letter.len_utf8()..).unwrap_or_default();
        match letter {
            ';' | '%' => return Ok(result),
            '(' => {
                rest = after.split_once(')').map_or("", |(_, after)| after);
                continue;
            }
            '/' => {
                rest = after;
                continue;
            }
            _ => {}
        }
        let after = after.trim_start();
        let end = after
            .find(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '-' | '+')))
            .unwrap_or(after.len());
        let (number, next) = after.split_at_checked(end).unwrap_or_default();
        let is_checksum = letter == '*';
        match number.parse::<f64>() {
            Ok(value) if letter.is_ascii_alphabetic() => {
                let letter = letter.to_ascii_uppercase();
                if letter != 'N' {
                    result.push(Word { letter, value, line });
                }
            }
            Ok(_) if is_checksum => {}
            _ => return Err(DrawingError::GcodeWord { line }),
        }
        rest = next;
    }
}

/// The first number behind a letter.
fn value_of(words: &[Word], letter: char) -> Option<f64> {
    words.iter().find(|word| word.letter == letter).map(|word| word.value)
}

fn dialect(blocks: &[Vec<Word>]) -> Dialect {
    let mut words = blocks.iter().flatten();
    if words.any(|word| word.letter == 'M' && word.value == 300.0) {
        return Dialect::Servo;
    }
    let mut words = blocks.iter().flatten();
    if words.any(|word| word.letter == 'M' && [3.0, 4.0, 5.0].contains(&word.value)) {
        return Dialect::Spindle;
    }
    let heights = || {
        blocks
            .iter()
            .flatten()
            .filter(|word| word.letter == 'Z')
            .map(|word| word.value)
    };
    let (low, high) = heights().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| {
        (low.min(z), high.max(z))
    });
    if low > high {
        Dialect::Rapid
    } else if low == high {
        Dialect::Height(0.0)
    } else {
        Dialect::Height(0.5 * (low + high))
    }
}

struct Reader {
    plot: Plot,
    dialect: Dialect,
    motion: u32,
    unit_mm: f64,
    is_relative: bool,
    /// Offset by G92 to the file's coordinates, mm.
    offset: [f64; 2],
    height: f64,
    is_down: bool,
}

impl Reader {
    fn new(dialect: Dialect) -> Self {
        Self {
            plot: Plot::default(),
            dialect,
            motion: 0,
            unit_mm: 1.0,
            is_relative: false,
            offset: [0.0; 2],
            height: f64::INFINITY,
            is_down: false,
        }
    }

    fn block(&mut self, words: &[Word]) -> Result<(), DrawingError> {
        // Found once: a line may have millions of words.
        let [x, y, s] = ['X', 'Y', 'S'].map(|letter| value_of(words, letter));
        let mut moves = true;
        for word in words {
            match (word.letter, word.value) {
                ('G', 0.0 | 1.0 | 2.0 | 3.0) => self.motion = word.value as u32,
                ('G', 4.0) => moves = false,
                ('G', 17.0 | 40.0 | 49.0 | 54.0 | 61.0 | 64.0 | 80.0 | 91.1 | 94.0) => {}
                ('G', 20.0) => self.unit_mm = MM_PER_INCH,
                ('G', 21.0) => self.unit_mm = 1.0,
                ('G', 28.0) => {
                    moves = false;
                    self.plot.warn("G28 (home) is not driven".to_owned());
                }
                ('G', 90.0) => self.is_relative = false,
                ('G', 91.0) => self.is_relative = true,
                ('G', 92.0) => {
                    moves = false;
                    for (axis, value) in [x, y].into_iter().enumerate() {
                        if let Some(value) = value {
                            self.offset[axis] = self.plot.at[axis] - value * self.unit_mm;
                        }
                    }
                }
                ('G', _) => {
                    return Err(DrawingError::GcodeMotion {
                        line: word.line,
                        tenths: (word.value * 10.0).round() as u32,
                    });
                }
                ('M', number) => self.function(number, s),
                ('T', number) => self.plot.change(number.max(0.0) as usize),
                ('S', 0.0) if self.dialect == Dialect::Spindle => self.is_down = false,
                ('F' | 'S' | 'P' | 'X' | 'Y' | 'Z' | 'I' | 'J' | 'R' | 'K' | 'E' | 'A' | 'L', _) => {}
                (letter, _) => self.plot.warn(format!("words {letter} are skipped")),
            }
        }
        if moves {
            self.travel(words)?;
        }
        Ok(())
    }

    fn function(&mut self, number: f64, s: Option<f64>) {
        match (self.dialect, number as u32) {
            (Dialect::Servo, 300) => self.is_down = s.is_some_and(|s| s < M300_UP_S),
            (Dialect::Spindle, 3 | 4) => self.is_down = s != Some(0.0),
            (Dialect::Spindle, 5) => self.is_down = false,
            (_, 3..=5) => {}
            (_, number) if HARMLESS.contains(&number) => {}
            (_, number) => self.plot.warn(format!("M{number} is skipped")),
        }
    }

    fn travel(&mut self, words: &[Word]) -> Result<(), DrawingError> {
        let value = |letter: char| value_of(words, letter);
        if let Some(z) = value('Z') {
            self.height = if self.is_relative && self.height.is_finite() {
                self.height + z
            } else {
                z
            };
        }
        self.is_down = match self.dialect {
            Dialect::Height(limit) => self.height <= limit,
            Dialect::Rapid => self.motion != 0,
            Dialect::Servo | Dialect::Spindle => self.is_down,
        };
        self.plot.set_down(self.is_down);
        if value('X').is_none() && value('Y').is_none() && value('I').is_none() && value('J').is_none() {
            return Ok(());
        }
        let from = self.plot.at;
        let mut to = from;
        for (axis, letter) in ['X', 'Y'].into_iter().enumerate() {
            if let Some(value) = value(letter) {
                let base = if self.is_relative {
                    from[axis]
                } else {
                    self.offset[axis]
                };
                to[axis] = base + value * self.unit_mm;
            }
        }
        if self.motion < 2 {
            return self.plot.go(to);
        }
        let line = words.first().map_or(0, |word| word.line);
        let is_clockwise = self.motion == 2;
        let centre = match (value('I'), value('J'), value('R')) {
            (None, None, Some(radius)) => centre_of(from, to, radius * self.unit_mm, is_clockwise),
            (None, None, None) => None,
            (i, j, _) => Some([
                from[0] + i.unwrap_or(0.0) * self.unit_mm,
                from[1] + j.unwrap_or(0.0) * self.unit_mm,
            ]),
        };
        let refused = DrawingError::GcodeArc { line };
        let centre = centre.ok_or(refused)?;
        let (radius, other) = (line::distance(from, centre), line::distance(to, centre));
        if radius <= 0.0 || (radius - other).abs() > (ARC_SHARE * radius).max(ARC_MM) {
            return Err(refused);
        }
        self.plot.turn(centre, arc_angle(from, to, centre, is_clockwise), to)
    }
}

/// The centre of an arc given by its radius: the shorter arc, or the longer one if the radius is negative.
fn centre_of(from: line::Point, to: line::Point, radius: f64, is_clockwise: bool) -> Option<line::Point> {
    let half = 0.5 * line::distance(from, to);
    if half == 0.0 || radius.abs() + ARC_MM < half {
        return None;
    }
    let away = (radius * radius - half * half).max(0.0).sqrt();
    let along = line::direction(from, to);
    let side = if is_clockwise == (radius > 0.0) { 1.0 } else { -1.0 };
    let middle = line::between(from, to, 0.5);
    Some([middle[0] + side * away * along[1], middle[1] - side * away * along[0]])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(text: &str) -> Vec<Vec<[f64; 2]>> {
        let artwork = read_gcode(text).expect(text);
        artwork.strokes.into_iter().map(|stroke| stroke.stroke.points).collect()
    }

    #[test]
    fn each_dialect_raises_the_pen_in_its_own_way() {
        let expected = [[[0.0, 0.0], [10.0, -0.0]], [[10.0, -5.0], [0.0, -5.0]]];
        for text in [
            "G21 G90\nG0 X0 Y0 Z5\nG1 Z-1 F100\nX10\nG0 Z5\nG0 X10 Y5\nG1 Z-1\nG1 X0\nG0 Z5\n",
            "M300 S50\nG1 X0 Y0\nM300 S30.0\nG4 P150\nG1 X10 Y0\nM300 S50\nG1 Y5\nM300 S30\nG1 X0\nM300 S50",
            "G0 X0Y0\nM3 S1000\nG1X10\nM5\nG0Y5\nM3\nG1X0\nM5 (up) ; done",
            "N10 G0 X0 Y0\nN20 G1 X10 *33\nG0 Y5\nG1 X0",
            "G91\nG0 Z5\nG1 Z-6\nG1 X10\nG0 Z6\nG0 Y5\nG1 Z-6\nX-10\nG0Z6",
        ] {
            assert_eq!(lines(text), expected, "{text}");
        }
    }

    #[test]
    fn arcs_units_and_offsets_are_followed() {
        let circle = &lines("G20\nM3\nG2 X0 Y0 I1 J0\nM5")[0];
        assert!(
            circle.len() > 50
                && circle
                    .iter()
                    .all(|&at| (line::distance(at, [25.4, 0.0]) - 25.4).abs() < 1e-9)
        );
        let quarter = &lines("G0 X10 Y0\nM3\nG3 X0 Y10 R10\nM5")[0];
        assert!(
            quarter
                .iter()
                .all(|&at| (line::distance(at, [0.0, 0.0]) - 10.0).abs() < 1e-9 && at[0] >= -1e-9)
        );
        assert_eq!(
            lines("G0 X5 Y5\nG92 X0 Y0\nM3\nG1 X1\nM5"),
            [[[5.0, -5.0], [6.0, -5.0]]]
        );
    }

    #[test]
    fn what_is_wrong_is_refused_with_its_line() {
        for (text, error) in [
            ("G0 X0\nG1 Xabc", DrawingError::GcodeWord { line: 2 }),
            ("G1 X nan", DrawingError::GcodeWord { line: 1 }),
            ("hello world", DrawingError::GcodeWord { line: 1 }),
            (
                "G0 X0\nG81 X1 Z-3 R1",
                DrawingError::GcodeMotion { line: 2, tenths: 810 },
            ),
            ("M3\nG2 X10 Y0", DrawingError::GcodeArc { line: 2 }),
            ("M3\nG2 X10 Y0 R1", DrawingError::GcodeArc { line: 2 }),
            ("M3\nG3 X10 Y0 I0 J0", DrawingError::GcodeArc { line: 2 }),
            (
                "G1 X99999999",
                DrawingError::FarAway {
                    place: FilePlace::Line(1),
                },
            ),
        ] {
            assert_eq!(read_gcode(text).err(), Some(error), "{text}");
        }
        let artwork = read_gcode("G1 X5\nM117\nM117\nG0 X0\nG1 X2").expect("warnings only");
        assert_eq!(artwork.warnings.len(), 2, "{:?}", artwork.warnings);
        assert!(artwork.warnings[1].contains("(2 times)"));
    }
}
