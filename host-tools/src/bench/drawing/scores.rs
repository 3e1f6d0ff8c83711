//! The figures of portraits: what was measured of each drawing, and what the judges say of it.

use super::judge::{self, Verdict, mean_margin};
use super::peers::{PEERS, TIME_EQUAL};
use super::photographs::PHOTOGRAPHS;
use crate::bench::{BenchRow, Selection};
use crate::drawing::Style;

/// Drawing time of every drawing, s: most photographs have more lines at the pen's width.
pub(super) const TIME_S: f64 = 80.0;
/// Most processor time for a megapixel, s; one line through all points ([`Style::Tsp`]) takes longer.
const CPU_PER_MEGAPIXEL_MAX_S: f64 = 1.0;
const WITHOUT_LIMIT: &str = "tsp";
/// Name of the rows over all photographs.
const MEAN: &str = "mean";
const BLANK: &str = "blank sheet";
/// The figures and their units.
const FIGURES: [(&str, &str); 12] = [
    ("tone_subject", "correlation"),
    ("tone_face", "correlation"),
    ("edges", "share"),
    ("face_found_2px", "share"),
    ("face_found_4px", "share"),
    (MARGIN, "margin"),
    ("mesh_found_2px", "share"),
    ("mesh_found_4px", "share"),
    ("mesh_error", "eye distances"),
    ("strokes", "strokes"),
    (DRAWING_S, "s"),
    (CPU, "s/megapixel"),
];
const MARGIN: &str = "identity_margin";
/// Error of the points of a face that is not found, as of one at the limit of being this face.
const MISSED: f64 = 0.5;
const DRAWING_S: &str = "drawing_s";
const CPU: &str = "cpu";

/// Who draws.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Artist {
    /// Style of this program, or name of the other one.
    pub(super) name: &'static str,
    pub(super) is_peer: bool,
}

impl Artist {
    /// The styles, then the other programs.
    pub(super) fn all() -> impl Iterator<Item = Self> {
        let styles = Style::NAMES.into_iter().map(|name| Self { name, is_peer: false });
        styles.chain(PEERS.iter().map(|peer| Self {
            name: peer.name,
            is_peer: true,
        }))
    }

    fn subject(self) -> &'static str {
        if self.is_peer { self.name } else { "etherpen" }
    }

    /// Case of a figure of a photograph; the styles of this program are kinds of it.
    fn case(self, figure: &str, photograph: &str) -> String {
        match self.is_peer {
            true => format!("portrait/{figure}/{photograph}"),
            false => format!("portrait/{figure}/{photograph}/{}", self.name),
        }
    }

    pub(super) fn is_wanted(self, selection: &Selection, photograph: &str) -> bool {
        let wants = |name: &str| {
            FIGURES
                .iter()
                .any(|(figure, _)| selection.wants(&self.case(figure, name), self.subject()))
        };
        wants(photograph) || wants(MEAN)
    }
}

/// What was measured of a drawing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measured {
    pub(super) strokes: usize,
    /// Drawing time by the firmware's planner, s.
    pub(super) planned_s: f64,
    /// Processor time of its program, s.
    pub(super) cpu_s: f64,
    /// Size of the picture that the program got.
    pub(super) megapixels: f64,
    /// Share of the photograph's edges that it covers.
    pub(super) edges: f64,
}

/// Whether a drawing takes the time of all drawings.
pub(super) fn is_equal_time(planned_s: f64) -> bool {
    (planned_s / TIME_S - 1.0).abs() <= TIME_EQUAL
}

/// `None` without values.
fn mean_of(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) = values.fold((0, 0.0), |(count, sum), value| (count + 1, sum + value));
    (count > 0).then(|| sum / f64::from(count))
}

/// Whom a photograph shows.
fn person(name: &str) -> &'static str {
    let found = PHOTOGRAPHS.iter().find(|photograph| photograph.name == name);
    found.map_or("", |photograph| photograph.person)
}

/// Appends the figures of a photograph's drawings.
pub(super) fn figures(
    name: &str,
    portraits: impl Iterator<Item = (Artist, Measured)>,
    verdict: &Verdict,
    rows: &mut Vec<BenchRow>,
) {
    for (artist, measured) in portraits {
        let judged = verdict.drawings.get(artist.name);
        let has_face = verdict.blank.is_some();
        let found = |blur: usize| {
            let distances = judged.filter(|_| has_face)?.distances.get(blur)?;
            Some(f64::from(u8::from(distances.is_some())))
        };
        let meshes = verdict.meshes.as_ref().and_then(|meshes| meshes.get(artist.name));
        let has_mesh = |blur: usize| Some(f64::from(u8::from(meshes?.get(blur)?.is_some())));
        let is_limited = !artist.is_peer && artist.name != WITHOUT_LIMIT;
        for (figure, unit) in FIGURES {
            let value = match figure {
                "tone_subject" => judged.map(|judged| judged.tone_subject),
                "tone_face" => judged.and_then(|judged| judged.tone_face),
                "edges" => Some(measured.edges),
                "face_found_2px" => found(0),
                "face_found_4px" => found(1),
                "mesh_found_2px" => has_mesh(0),
                "mesh_found_4px" => has_mesh(1),
                "mesh_error" => meshes.and_then(|errors| mean_of(errors.iter().map(|error| error.unwrap_or(MISSED)))),
                MARGIN => judged.and_then(|judged| mean_margin(name, person, &judged.distances)),
                "strokes" => Some(measured.strokes as f64),
                DRAWING_S => Some(measured.planned_s),
                // The work of a smaller photograph is that of the sheet; all programs are counted alike.
                CPU => Some(measured.cpu_s / measured.megapixels.max(1.0)),
                _ => None,
            };
            let target = (figure == CPU && is_limited).then_some(CPU_PER_MEGAPIXEL_MAX_S);
            rows.extend(value.map(|value| BenchRow {
                case: artist.case(figure, name),
                subject: artist.subject(),
                value,
                unit,
                target,
            }));
        }
    }
    let blank = verdict.blank.as_ref();
    rows.extend(
        blank
            .and_then(|distances| judge::margin(name, person, distances))
            .map(|value| BenchRow {
                case: format!("portrait/{MARGIN}/{name}"),
                subject: BLANK,
                value,
                unit: "margin",
                target: None,
            }),
    );
}

/// Appends the means over the photographs of which a program has a drawing that takes the time of all. The mean margin
/// has to reach those of the other programs and of a blank sheet: there is no target unless all of them were measured.
pub(super) fn means(rows: &mut Vec<BenchRow>) {
    let blank = Artist {
        name: BLANK,
        is_peer: true,
    };
    let artists: Vec<Artist> = Artist::all().chain([blank]).collect();
    for (figure, unit) in FIGURES {
        let mean = |artist: &Artist| {
            let value = |figure: &str, photograph: &str| {
                let case = artist.case(figure, photograph);
                let mut same = rows.iter();
                let row = same.find(|row| row.subject == artist.subject() && row.case == case);
                row.map(|row| row.value)
            };
            let counted = PHOTOGRAPHS.iter().map(|photograph| photograph.name);
            // A blank sheet has no time.
            let counted = counted.filter(|name| value(DRAWING_S, name).is_none_or(is_equal_time));
            mean_of(counted.filter_map(|name| value(figure, name)))
        };
        let means: Vec<(Artist, f64)> = artists
            .iter()
            .filter_map(|artist| Some((*artist, mean(artist)?)))
            .collect();
        let others: Option<Vec<f64>> = artists.iter().filter(|artist| artist.is_peer).map(mean).collect();
        let best = others.and_then(|others| others.into_iter().reduce(f64::max));
        rows.extend(means.into_iter().map(|(artist, value)| BenchRow {
            case: artist.case(figure, MEAN),
            subject: artist.subject(),
            value,
            unit,
            target: best.filter(|_| figure == MARGIN && !artist.is_peer),
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn artist(name: &'static str) -> Artist {
        Artist::all().find(|artist| artist.name == name).expect("an artist")
    }

    fn row(artist: Artist, photograph: &str, value: f64) -> BenchRow {
        BenchRow {
            case: artist.case(MARGIN, photograph),
            subject: artist.subject(),
            value,
            unit: "margin",
            target: None,
        }
    }

    #[test]
    fn styles_are_cases_of_this_program_and_other_programs_are_subjects() {
        let names: Vec<_> = Artist::all()
            .map(|artist| (artist.case("edges", "cat"), artist.subject()))
            .collect();
        let expected = [
            ("portrait/edges/cat/sketch", "etherpen"),
            ("portrait/edges/cat/hatch", "etherpen"),
            ("portrait/edges/cat/flow", "etherpen"),
            ("portrait/edges/cat/tsp", "etherpen"),
            ("portrait/edges/cat/engrave", "etherpen"),
            ("portrait/edges/cat", "hatched"),
            ("portrait/edges/cat", "plotline hatch"),
            ("portrait/edges/cat", "plotline contours"),
        ];
        assert_eq!(names, expected.map(|(case, subject)| (case.to_owned(), subject)));
    }

    #[test]
    fn a_selection_draws_what_it_shows_and_a_mean_draws_all_photographs() {
        let drawn = |case: &str, subject: Option<&str>| {
            let selection = Selection {
                case: Some(case.to_owned()),
                subject: subject.map(str::to_owned),
            };
            let wanted = PHOTOGRAPHS.iter().map(|photograph| {
                Artist::all()
                    .filter(|artist| artist.is_wanted(&selection, photograph.name))
                    .count()
            });
            wanted.sum::<usize>()
        };
        let all = PHOTOGRAPHS.len();
        assert_eq!(drawn("portrait/", None), 8 * all);
        assert_eq!(drawn("/cat/", None), 5);
        assert_eq!(drawn("portrait/edges/cat", None), 8);
        assert_eq!(drawn("portrait/edges/mean", Some("hatched")), all);
        assert_eq!(drawn("lifts/", None), 0);
    }

    #[test]
    fn each_figure_of_a_drawing_is_that_of_its_judge() {
        let verdict = |meshes: Option<Vec<Option<f64>>>| -> Verdict {
            let told = r#"{"blank": {"obama": 0.9, "biden": 0.9}, "drawings": {"sketch": {"tone_subject": 0.7, "tone_face": 0.6,
                "distances": [null, {"obama": 0.5, "biden": 0.8}]}}}"#;
            Verdict {
                meshes: meshes.map(|errors| [("sketch".to_owned(), errors)].into()),
                ..serde_json::from_str(told).expect("a verdict")
            }
        };
        let measured = Measured {
            strokes: 12,
            planned_s: 80.0,
            cpu_s: 3.0,
            megapixels: 2.0,
            edges: 0.4,
        };
        let of = |verdict: &Verdict| {
            let mut rows = Vec::new();
            figures("obama", [(artist("sketch"), measured)].into_iter(), verdict, &mut rows);
            let told = rows.into_iter().filter(|row| row.subject == "etherpen");
            told.map(|row| (row.case.split('/').nth(1).unwrap_or_default().to_owned(), row.value))
                .collect::<Vec<_>>()
        };
        let expected = [
            ("tone_subject", 0.7),
            ("tone_face", 0.6),
            ("edges", 0.4),
            ("face_found_2px", 0.0),
            ("face_found_4px", 1.0),
            ("identity_margin", 0.15),
            ("mesh_found_2px", 1.0),
            ("mesh_found_4px", 0.0),
            ("mesh_error", 0.3),
            ("strokes", 12.0),
            ("drawing_s", 80.0),
            ("cpu", 1.5),
        ];
        let told = of(&verdict(Some(vec![Some(0.1), None])));
        assert_eq!(told.len(), FIGURES.len());
        for ((name, value), (wanted_name, wanted)) in told.iter().zip(expected) {
            assert!(
                name == wanted_name && (value - wanted).abs() < 1e-9,
                "{name}: {value}, not {wanted}"
            );
        }
        let without = of(&verdict(None));
        assert!(without.iter().all(|(name, _)| !name.starts_with("mesh")), "{without:?}");
        assert_eq!(without.len(), FIGURES.len() - 3);
    }

    /// The mean margin of `sketch` after [`means`], with its target.
    fn mean_of_sketch(mut rows: Vec<BenchRow>) -> BenchRow {
        means(&mut rows);
        let is_mean = |row: &BenchRow| row.case == "portrait/identity_margin/mean/sketch";
        rows.into_iter().find(is_mean).expect("a mean")
    }

    fn blank_row(value: f64) -> BenchRow {
        BenchRow {
            subject: BLANK,
            ..row(artist("hatched"), "obama", value)
        }
    }

    #[test]
    fn the_mean_margin_has_to_reach_those_of_other_programs_and_of_a_blank_sheet() {
        let target = |hatched: f64, blank: f64| {
            let mean = mean_of_sketch(vec![
                row(artist("sketch"), "obama", 0.4),
                row(artist("sketch"), "biden", 0.2),
                row(artist("hatched"), "obama", hatched),
                row(artist("plotline hatch"), "obama", 0.0),
                row(artist("plotline contours"), "obama", 0.1),
                blank_row(blank),
            ]);
            assert!((mean.value - 0.3).abs() < 1e-12);
            (mean.target, mean.met())
        };
        assert_eq!(target(0.25, 0.1), (Some(0.25), Some(true)));
        assert_eq!(target(-0.2, 0.35), (Some(0.35), Some(false)));
    }

    #[test]
    fn the_mean_margin_has_no_target_while_another_program_has_no_mean() {
        for missing in PEERS.iter().map(|peer| peer.name) {
            let mut rows = vec![row(artist("sketch"), "obama", 0.4), blank_row(0.01)];
            let others = Artist::all().filter(|artist| artist.is_peer && artist.name != missing);
            rows.extend(others.map(|artist| row(artist, "obama", 0.2)));
            assert_eq!(mean_of_sketch(rows).target, None, "without {missing}");
        }
    }

    #[test]
    fn drawings_that_take_another_time_are_in_no_mean_and_no_target() {
        let time = |artist: Artist, photograph: &str, seconds: f64| BenchRow {
            case: artist.case(DRAWING_S, photograph),
            value: seconds,
            unit: "s",
            ..row(artist, photograph, 0.0)
        };
        let mut rows = vec![blank_row(0.01)];
        let figures = [("obama", 0.1, 79.0), ("biden", 0.9, 49.0), ("speaker", 0.9, f64::NAN)];
        for artist in Artist::all() {
            for (photograph, margin, seconds) in figures {
                rows.push(row(artist, photograph, margin));
                rows.push(time(artist, photograph, seconds));
            }
        }
        let mean = mean_of_sketch(rows);
        assert_eq!((mean.value, mean.target), (0.1, Some(0.1)));
    }
}
