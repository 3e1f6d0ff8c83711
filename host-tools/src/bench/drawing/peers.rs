//! The other programs that draw photographs, each at the drawing time of this one.
//!
//! None of them takes a drawing time. The spacing of their lines is changed until the firmware's planner computes the
//! wanted time for what they draw; all else has their defaults. Their strokes are joined and ordered as this program's.

use super::failed;
use crate::bench::BenchError;
use crate::drawing::preparation::choose_order::choose_order;
use crate::drawing::{Drawing, OrderOptions, Stroke};
use etherpen::config::Config;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// Draws photographs with the other programs.
const DRAW: &str = include_str!("peers.py");
/// Relative error of the drawing time at which the search ends, and the largest one that counts as equal.
const TIME_NEAR: f64 = 0.03;
pub(super) const TIME_EQUAL: f64 = 0.1;
/// Most drawings of a search.
const TRIES_MAX: usize = 10;
/// Where a program fails it is tried again with the spacing times each of these.
const NUDGES: [f64; 4] = [1.01, 0.99, 1.02, 0.98];

/// Another program.
pub(super) struct Peer {
    /// Its name and, if it has several, its style.
    pub(super) name: &'static str,
    /// Least and largest spacing of its lines, mm.
    spacing_mm: [f64; 2],
}

/// The other programs. plotline's single lines (`line`, `sketch`, `scribble`) show no face at this drawing time.
pub(super) const PEERS: [Peer; 3] = [
    Peer {
        name: "hatched",
        spacing_mm: [0.3, 8.0],
    },
    Peer {
        name: "plotline hatch",
        spacing_mm: [0.3, 8.0],
    },
    Peer {
        name: "plotline contours",
        spacing_mm: [0.19, 12.0],
    },
];

/// What a peer is asked to draw.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Order<'a> {
    /// The picture.
    pub(super) picture: &'a Path,
    /// Left, top, width and height on the sheet, mm.
    pub(super) place_mm: [f64; 4],
    /// Width and height of the sheet, mm.
    pub(super) sheet_mm: [f64; 2],
    /// Line width of the pen, mm.
    pub(super) pen_mm: f64,
}

/// A drawing, or why the program made none.
pub(super) type Attempt<T> = Result<T, String>;

/// A peer's drawing.
#[derive(Clone, Debug)]
pub(super) struct PeerDrawing {
    /// The strokes in the order of drawing.
    pub(super) drawing: Drawing,
    /// Planned drawing time, s.
    pub(super) planned_s: f64,
    /// Processor time of the program, s.
    pub(super) cpu_s: f64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Answer {
    strokes: Vec<Vec<[f64; 2]>>,
    cpu_s: f64,
    error: Option<String>,
}

/// The Python process in which the peers run.
pub(super) struct Artists {
    child: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Artists {
    /// Starts the process.
    ///
    /// # Errors
    /// It does not start.
    pub(super) fn start(python: &Path) -> Result<Self, BenchError> {
        let mut command = Command::new(python);
        command.args(["-c", DRAW]).stdin(Stdio::piped()).stdout(Stdio::piped());
        // Libraries warn there of colour profiles; errors are answers.
        let mut child = command
            .stderr(Stdio::null())
            .spawn()
            .map_err(|cause| failed("peers", cause))?;
        let (orders, answers) = (child.stdin.take(), child.stdout.take());
        let (Some(orders), Some(answers)) = (orders, answers.map(BufReader::new)) else {
            return Err(failed("peers", "the process has no pipes"));
        };
        Ok(Self { child, orders, answers })
    }

    /// The peer's drawing with the time nearest to `aim_s`, or why there is none.
    ///
    /// # Errors
    /// The process of the peers ended.
    pub(super) fn draw(
        &mut self,
        peer: &Peer,
        order: &Order,
        aim_s: f64,
        config: &Config,
        options: &OrderOptions,
    ) -> Result<Attempt<PeerDrawing>, BenchError> {
        let matched = matched(aim_s, peer.spacing_mm, |spacing_mm| {
            let drawn = self.once(peer, order, spacing_mm, config, options)?;
            Ok(drawn.map(|drawn| {
                let planned_s = drawn.planned_s;
                (drawn, planned_s)
            }))
        })?;
        Ok(matched.map(|(drawn, _)| drawn))
    }

    fn once(
        &mut self,
        peer: &Peer,
        order: &Order,
        spacing_mm: f64,
        config: &Config,
        options: &OrderOptions,
    ) -> Result<Attempt<PeerDrawing>, BenchError> {
        let [left, top, width, height] = order.place_mm;
        let asked = serde_json::json!({
            "peer": peer.name, "picture": order.picture, "size_mm": [width, height], "pen_mm": order.pen_mm,
            "spacing": spacing_mm,
        });
        let mut said = String::new();
        let exchange = writeln!(self.orders, "{asked}").and_then(|()| self.answers.read_line(&mut said));
        exchange.map_err(|cause| failed(peer.name, cause))?;
        let answer: Answer = serde_json::from_str(&said)
            .map_err(|cause| failed(peer.name, format_args!("{cause}; the process ended")))?;
        if let Some(error) = answer.error {
            return Ok(Err(error));
        }
        let inside = |[x, y]: [f64; 2]| [left + x.clamp(0.0, width), top + y.clamp(0.0, height)];
        let strokes = answer.strokes.into_iter().filter(|points| points.len() > 1);
        let strokes = strokes.map(|points| Stroke {
            points: points.into_iter().map(inside).collect(),
        });
        let given = Drawing {
            sheet_mm: order.sheet_mm,
            strokes: strokes.collect(),
        };
        if given.strokes.is_empty() {
            return Ok(Ok(PeerDrawing {
                drawing: given,
                planned_s: 0.0,
                cpu_s: answer.cpu_s,
            }));
        }
        let chosen = choose_order(std::slice::from_ref(&given), &given, options, config);
        Ok(Ok(PeerDrawing {
            drawing: chosen.layers.and_then(|mut layers| layers.pop()).unwrap_or(given),
            planned_s: chosen.chosen_s.unwrap_or(f64::INFINITY),
            cpu_s: answer.cpu_s,
        }))
    }
}

impl Drop for Artists {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The drawing whose time is nearest to `aim_s`, and its time: a search over the spacing of lines, which more of takes
/// less time. A failure says nothing of the time: the search goes on with a spacing beside it, and ends where all of
/// them fail.
fn matched<T>(
    aim_s: f64,
    [mut low, mut high]: [f64; 2],
    mut draw: impl FnMut(f64) -> Result<Attempt<(T, f64)>, BenchError>,
) -> Result<Attempt<(T, f64)>, BenchError> {
    let off = |seconds: f64| (seconds / aim_s).ln().abs();
    let mut best: Option<(T, f64)> = None;
    let mut cause = "it draws nothing".to_owned();
    for _ in 0..TRIES_MAX {
        let spacing = (low * high).sqrt();
        let mut attempt = draw(spacing)?;
        for nudge in NUDGES {
            if attempt.is_err() {
                attempt = draw(spacing * nudge)?;
            }
        }
        let (drawn, seconds) = match attempt {
            Ok(drawn) => drawn,
            Err(error) => {
                cause = error;
                break;
            }
        };
        if best.as_ref().is_none_or(|(_, known)| off(seconds) < off(*known)) {
            best = Some((drawn, seconds));
        }
        if off(seconds) <= TIME_NEAR.ln_1p() {
            break;
        }
        if seconds > aim_s {
            low = spacing;
        } else {
            high = spacing;
        }
    }
    let best = best.filter(|(_, seconds)| *seconds > 0.0 && seconds.is_finite());
    Ok(best.ok_or(cause))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spacing_is_found_at_which_a_drawing_takes_the_wanted_time() {
        for (aim_s, power) in [(30.0, 1.0), (110.0, 1.0), (110.0, 2.0), (400.0, 1.3)] {
            let found = matched(aim_s, [0.3, 8.0], |spacing: f64| {
                Ok(Ok((spacing, 200.0 * spacing.powf(-power))))
            });
            let (spacing, seconds) = found.expect("drawn").expect("a drawing");
            assert!(
                (seconds / aim_s - 1.0).abs() <= TIME_NEAR,
                "{aim_s}: {seconds} at {spacing}"
            );
        }
    }

    #[test]
    fn a_program_with_few_densities_gets_the_nearest_and_one_that_draws_nothing_none() {
        let steps = |spacing: f64| Ok(Ok(((), 40.0 * (12.0 / spacing).round().max(1.0))));
        let (_, seconds) = matched(110.0, [0.19, 12.0], steps).expect("drawn").expect("a drawing");
        assert_eq!(seconds, 120.0);
        let short = matched(110.0, [0.3, 8.0], |spacing| Ok(Ok((spacing, 5.0 / spacing))));
        assert!(short.expect("drawn").is_ok_and(|(spacing, _)| spacing < 0.31));
        for nothing in [0.0, f64::INFINITY] {
            let found = matched(110.0, [0.3, 8.0], |_| Ok(Ok(((), nothing))));
            assert_eq!(found.expect("drawn"), Err("it draws nothing".to_owned()));
        }
    }

    #[test]
    fn a_program_that_fails_at_some_spacings_gets_the_wanted_time_beside_them() {
        // Fails in bands of 1 per mille around every spacing that a search without failures tries.
        let mut tried = Vec::new();
        let seconds = |spacing: f64| 200.0 / spacing;
        matched(110.0, [0.3, 8.0], |spacing| {
            tried.push(spacing);
            Ok(Ok(((), seconds(spacing))))
        })
        .expect("drawn")
        .expect("a drawing");
        let found = matched(110.0, [0.3, 8.0], |spacing| {
            let is_failing = tried.iter().any(|known| (spacing / known - 1.0).abs() < 0.001);
            Ok(match is_failing {
                true => Err("no lines".to_owned()),
                false => Ok(((), seconds(spacing))),
            })
        });
        let (_, seconds) = found.expect("drawn").expect("a drawing");
        assert!((seconds / 110.0 - 1.0).abs() <= 2.0 * TIME_NEAR, "{seconds}");
    }

    #[test]
    fn a_program_that_always_fails_says_why_and_is_not_asked_for_ever() {
        let mut tries = 0;
        let found: Attempt<((), f64)> = matched(110.0, [0.3, 8.0], |_| {
            tries += 1;
            Ok(Err("no mask".to_owned()))
        })
        .expect("asked");
        assert_eq!((found, tries), (Err("no mask".to_owned()), 1 + NUDGES.len()));
    }
}
