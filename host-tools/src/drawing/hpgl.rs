//! HPGL of pen plotters: pens, moves, circles, arcs, rectangles.
//!
//! Instructions are two letters and numbers, 40 units per millimetre (Hewlett-Packard, *The HP-GL/2 and HP RTL
//! Reference Guide*). Plotter-specific settings are skipped; an unknown instruction that would draw causes a warning.

use super::artwork::Artwork;
use super::line::Point;
use super::plot::Plot;
use super::{DrawingError, FilePlace};

/// Millimetres per plotter unit.
const MM_PER_UNIT: f64 = 0.025;
/// End of a label.
const LABEL_END: char = '\u{3}';
/// Instructions that draw nothing by themselves.
const SETTINGS: [&str; 24] = [
    "IN", "DF", "VS", "FS", "PW", "LT", "IP", "IW", "RO", "PS", "PT", "FT", "CA", "CS", "SI", "SR", "DI", "DR", "SS",
    "SA", "AS", "PG", "NP", "BP",
];

/// Reads HPGL.
///
/// # Errors
/// [`DrawingError::HpglNumber`] with the number of the instruction, and the errors common to all plots.
pub(super) fn read_hpgl(text: &str) -> Result<Artwork, DrawingError> {
    let mut plot = Plot::default();
    let mut is_relative = false;
    let mut rest = text;
    for number in 1.. {
        rest = rest.trim_start_matches(|c: char| !c.is_ascii_alphabetic());
        let Some((name, after)) = rest.split_at_checked(2) else {
            break;
        };
        let name = name.to_ascii_uppercase();
        let stop = match name.as_str() {
            "LB" => after.find(LABEL_END),
            _ => after.find(|c: char| c == ';' || c.is_ascii_alphabetic() || c.is_control() && !c.is_whitespace()),
        };
        let (parameters, next) = after.split_at_checked(stop.unwrap_or(after.len())).unwrap_or_default();
        rest = next;
        let is_text = matches!(name.as_str(), "LB" | "DT" | "CO");
        let values = if is_text {
            Vec::new()
        } else {
            numbers(parameters, number)?
        };
        let refused = DrawingError::HpglNumber { instruction: number };
        let in_place = |error: DrawingError| error.at(FilePlace::Instruction(number));
        match name.as_str() {
            "PA" | "PR" => {
                is_relative = name == "PR";
                go_all(&mut plot, &values, is_relative, refused).map_err(in_place)?;
            }
            "PU" | "PD" => {
                plot.set_down(name == "PD");
                go_all(&mut plot, &values, is_relative, refused).map_err(in_place)?;
            }
            "SP" => plot.change(values.first().map_or(0, |pen| pen.max(0.0) as usize)),
            "CI" | "AA" | "AR" | "EA" | "ER" => shape(&mut plot, &name, &values, refused).map_err(in_place)?,
            "LB" => plot.warn("labels (LB) are not drawn".to_owned()),
            "SC" if values.is_empty() => {}
            name if SETTINGS.contains(&name) || is_text => {}
            name => plot.warn(format!("instruction {name} is skipped")),
        }
    }
    Ok(plot.finish())
}

fn numbers(text: &str, instruction: usize) -> Result<Vec<f64>, DrawingError> {
    let parts = text
        .split(|c: char| c == ',' || c.is_whitespace())
        .filter(|part| !part.is_empty());
    let read = |part: &str| part.parse().ok().filter(|value: &f64| value.is_finite());
    parts
        .map(|part| read(part).ok_or(DrawingError::HpglNumber { instruction }))
        .collect()
}

fn go_all(plot: &mut Plot, values: &[f64], is_relative: bool, refused: DrawingError) -> Result<(), DrawingError> {
    for pair in values.chunks(2) {
        let &[x, y] = pair else { return Err(refused) };
        let base = if is_relative { plot.at } else { [0.0; 2] };
        plot.go([base[0] + x * MM_PER_UNIT, base[1] + y * MM_PER_UNIT])?;
    }
    Ok(())
}

/// Circles, arcs and rectangles; each draws its own line whether the pen is down or not, except arcs.
fn shape(plot: &mut Plot, name: &str, values: &[f64], refused: DrawingError) -> Result<(), DrawingError> {
    let start = plot.at;
    let first = values.first().copied().ok_or(refused)? * MM_PER_UNIT;
    let second = values.get(1).copied().map(|value| value * MM_PER_UNIT);
    let from = |base: Point| second.map(|second| [base[0] + first, base[1] + second]).ok_or(refused);
    match name {
        "CI" => {
            plot.set_down(false);
            plot.go([start[0] + first, start[1]])?;
            plot.set_down(true);
            plot.turn(start, std::f64::consts::TAU, [start[0] + first, start[1]])?;
            plot.set_down(false);
            plot.go(start)
        }
        "AA" | "AR" => {
            let centre = from(if name == "AR" { start } else { [0.0; 2] })?;
            let angle = values.get(2).copied().ok_or(refused)?.clamp(-360.0, 360.0).to_radians();
            let (sine, cosine) = angle.sin_cos();
            let (x, y) = (start[0] - centre[0], start[1] - centre[1]);
            plot.turn(
                centre,
                angle,
                [centre[0] + x * cosine - y * sine, centre[1] + x * sine + y * cosine],
            )
        }
        _ => {
            let corner = from(if name == "ER" { start } else { [0.0; 2] })?;
            plot.set_down(true);
            for to in [[corner[0], start[1]], corner, [start[0], corner[1]], start] {
                plot.go(to)?;
            }
            plot.set_down(false);
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pens_moves_and_shapes_become_strokes_in_millimetres() {
        let text =
            "IN;SP1;PU400,0;PD800,0,800,400;PU;SP2;PA0 0;PD;PR40,0;PR0,40;PU;PA0,0;CI400;EA80,80;VS10;LBhi;\u{3}PU;";
        let artwork = read_hpgl(text).expect(text);
        let names: Vec<_> = artwork.layers.iter().map(|layer| layer.name.as_str()).collect();
        assert_eq!(names, ["pen 1", "pen 2"]);
        let points = |k: usize| &artwork.strokes[k].stroke.points;
        assert_eq!(*points(0), [[10.0, 0.0], [20.0, 0.0], [20.0, -10.0]]);
        assert_eq!(*points(1), [[0.0, 0.0], [1.0, 0.0], [1.0, -1.0]]);
        assert!(points(2).iter().all(|[x, y]| (x.hypot(*y) - 10.0).abs() < 1e-9));
        assert_eq!((points(3).len(), artwork.strokes.len()), (5, 4));
        assert_eq!(artwork.warnings, ["labels (LB) are not drawn"]);
    }

    #[test]
    fn what_is_no_number_is_refused_and_what_is_not_known_is_told() {
        assert_eq!(
            read_hpgl("IN;PA1").err(),
            Some(DrawingError::HpglNumber { instruction: 2 })
        );
        assert_eq!(
            read_hpgl("PD--3,4").err(),
            Some(DrawingError::HpglNumber { instruction: 1 })
        );
        assert_eq!(
            read_hpgl("PD9e9,4").err(),
            Some(DrawingError::HpglNumber { instruction: 1 })
        );
        let artwork = read_hpgl("PEabc;PD40,40;").expect("a line");
        assert_eq!(artwork.strokes.len(), 1);
        assert!(!artwork.warnings.is_empty());
    }
}
