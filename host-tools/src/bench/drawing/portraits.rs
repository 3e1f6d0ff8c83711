//! Photographs drawn in every style and by other programs, all in the same drawing time, before an independent judge.
//!
//! Every program draws the part of the photograph that this one draws by default: the head of a portrait. Drawing times
//! are those of the firmware's planner at its default limits. Every drawing is judged as the pen leaves it on the paper,
//! 0.5 mm wide. Figures only show when something became worse; which portrait is better has to be seen
//! (`--contact-sheet`).

use super::judge::{self, Judged, Verdict, mean_margin};
use super::peers::{Artists, Attempt, Order, PEERS, TIME_EQUAL};
use super::photographs::{self, PHOTOGRAPHS, Photograph};
use super::{PEN_MM, failed};
use crate::bench::{BenchError, BenchRow, Selection};
use crate::drawing::preparation::compose::from_photograph;
use crate::drawing::preparation::grid::in_rows;
use crate::drawing::preparation::source::SourceArguments;
use crate::drawing::{
    Crop, Drawing, OrderOptions, Style, Subject, Travel, VectorizeOptions, edge_coverage, render_rgb,
};
use crate::output_file::write_bytes;
use crate::setup;
use clap::Parser;
use etherpen::config::Config;
use image::imageops::{self, FilterType};
use image::{GrayImage, Luma, Rgb, RgbImage};
use rustix::time::{ClockId, clock_gettime};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Drawing time of every drawing, s: most photographs have more lines at the pen's width.
const TIME_S: f64 = 80.0;
/// Most processor time for a megapixel, s; one line through all points ([`Style::Tsp`]) takes longer.
const CPU_PER_MEGAPIXEL_MAX_S: f64 = 1.0;
const WITHOUT_LIMIT: &str = "tsp";
/// Scale of the judged drawings, and of the picture that the other programs get.
const JUDGED_PX_PER_MM: f64 = 6.0;
const GIVEN_PX_PER_MM: f64 = 5.0;
/// Largest side of a picture on the contact sheet, pixels.
const CELL_PX: u32 = 440;
/// Name of the rows over all photographs.
const MEAN: &str = "mean";
const BLANK: &str = "blank sheet";
/// The figures and their units.
const FIGURES: [(&str, &str); 9] = [
    ("tone_subject", "correlation"),
    ("tone_face", "correlation"),
    ("edges", "share"),
    ("face_found_2px", "share"),
    ("face_found_4px", "share"),
    (MARGIN, "margin"),
    ("strokes", "strokes"),
    (DRAWING_S, "s"),
    (CPU, "s/megapixel"),
];
const MARGIN: &str = "identity_margin";
const DRAWING_S: &str = "drawing_s";
const CPU: &str = "cpu";

#[derive(Parser)]
#[command(no_binary_name = true)]
struct CommandLine {
    #[command(flatten)]
    source: SourceArguments,
}

/// Who draws.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Artist {
    /// Style of this program, or name of the other one.
    name: &'static str,
    is_peer: bool,
}

impl Artist {
    /// The styles, then the other programs.
    fn all() -> impl Iterator<Item = Self> {
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

    fn is_wanted(self, selection: &Selection, photograph: &str) -> bool {
        let wants = |name: &str| {
            FIGURES
                .iter()
                .any(|(figure, _)| selection.wants(&self.case(figure, name), self.subject()))
        };
        wants(photograph) || wants(MEAN)
    }
}

/// The part of a photograph that is drawn.
struct Part {
    photograph: &'static Photograph,
    whole: RgbImage,
    picture: RgbImage,
    subject: Subject,
    /// Left, top, width and height on the sheet, mm.
    place_mm: [f64; 4],
}

/// A finished drawing.
struct Portrait {
    strokes: usize,
    planned_s: f64,
    cpu_s: f64,
    /// Size of the picture that the program got.
    megapixels: f64,
    /// The drawing's place on the sheet.
    rendered: RgbImage,
}

type Portraits = Vec<(Artist, Portrait)>;

/// Appends the figures of the selected portraits; `sheet` is the PNG with all of them.
pub(super) fn run(
    selection: &Selection,
    sheet: Option<&Path>,
    progress: &impl Fn(&str),
    rows: &mut Vec<BenchRow>,
) -> Result<(), BenchError> {
    let wanted = |photograph: &Photograph| -> Vec<Artist> {
        Artist::all()
            .filter(|artist| artist.is_wanted(selection, photograph.name))
            .collect()
    };
    if PHOTOGRAPHS.iter().all(|photograph| wanted(photograph).is_empty()) {
        return Ok(());
    }
    if let Some(folder) = sheet.and_then(Path::parent)
        && !folder.as_os_str().is_empty()
        && !folder.is_dir()
    {
        return Err(failed(
            "--contact-sheet",
            format_args!("{} is no folder", folder.display()),
        ));
    }
    progress("portraits: the judge and the other programs, from PyPI");
    let python = setup::ensure_portraits()?;
    let folder = setup::target_dir().join("portraits/pictures");
    std::fs::create_dir_all(&folder).map_err(|cause| failed("portraits", cause))?;
    let config = Config::default();
    let parts = parts(&photographs::pictures(&python, &folder)?, &config)?;
    let mut artists = Artists::start(&python)?;
    let (mut drawn, mut orders) = (Vec::new(), Vec::new());
    for part in &parts {
        let name = part.photograph.name;
        let file = |what: &str| folder.join(format!("{name}-{what}.png"));
        save(&part.picture, &file("photograph"))?;
        let mut portraits = Portraits::new();
        for artist in wanted(part.photograph) {
            progress(&format!("portrait of {name}: {}", artist.name));
            let portrait = match artist.is_peer {
                false => Ok(own(artist.name, part, &config)?),
                true => peers(&mut artists, artist.name, part, &file("given"), &config)?,
            };
            match portrait {
                Ok(portrait) => portraits.push((artist, portrait)),
                Err(cause) => progress(&format!(
                    "{} fails on {name}, which is left out of its means: {cause}",
                    artist.name
                )),
            }
        }
        for (artist, portrait) in &portraits {
            let time_s = portrait.planned_s;
            if !is_equal_time(time_s) {
                progress(&format!(
                    "{name} by {} takes {time_s:.0} s, not {TIME_S}, and is left out of its means",
                    artist.name
                ));
            }
        }
        orders.push(order(part, &portraits, &file)?);
        drawn.push(portraits);
    }
    progress("judging the portraits");
    let verdicts = judge::verdicts(&python, &folder, &orders)?;
    for ((part, portraits), verdict) in parts.iter().zip(&drawn).zip(&verdicts) {
        figures(part, portraits, verdict, rows);
    }
    means(rows);
    if let Some(sheet) = sheet {
        contact_sheet(sheet, &parts, &drawn)?;
    }
    Ok(())
}

/// Whether a drawing takes the time of all drawings.
fn is_equal_time(planned_s: f64) -> bool {
    (planned_s / TIME_S - 1.0).abs() <= TIME_EQUAL
}

fn megapixels(picture: &RgbImage) -> f64 {
    f64::from(picture.width()) * f64::from(picture.height()) / 1e6
}

/// The default part of each photograph and its place on the sheet.
fn parts(pictures: &[RgbImage], config: &Config) -> Result<Vec<Part>, BenchError> {
    let options = VectorizeOptions {
        sheet_mm: config.paper.size_mm,
        ..VectorizeOptions::default()
    };
    let part = |(photograph, whole): (&'static Photograph, &RgbImage)| {
        let found = Subject::of(whole, None);
        let window = found.window(
            [whole.width(), whole.height()],
            Crop::Auto,
            options.room_mm(),
            options.pen_width_mm,
        );
        let (picture, subject) = match window {
            Some(window) => found.cut(whole, window),
            None => (whole.clone(), found),
        };
        let place_mm = options.picture_mm(picture.width(), picture.height());
        Ok(Part {
            photograph,
            whole: whole.clone(),
            place_mm: place_mm.map_err(|cause| failed(photograph.name, cause))?,
            picture,
            subject,
        })
    };
    PHOTOGRAPHS.iter().zip(pictures).map(part).collect()
}

/// A drawing in one of the styles.
fn own(style: &str, part: &Part, config: &Config) -> Result<Portrait, BenchError> {
    let time = format!("{TIME_S}s");
    let of = |words: &[&str]| -> Result<_, BenchError> {
        let line = CommandLine::try_parse_from(words).map_err(|cause| failed(style, cause))?;
        let begun_s = processor_s();
        let made = from_photograph(part.whole.clone(), config, &line.source);
        let made = made.map_err(|cause| failed(part.photograph.name, cause))?;
        Ok((made, processor_s() - begun_s))
    };
    // As many people draw it, without a search for the drawing time.
    let (_, cpu_s) = of(&["--style", style])?;
    let (made, _) = of(&["--style", style, "--max-time", &time])?;
    Ok(Portrait {
        strokes: made.drawing.strokes.len(),
        planned_s: made.planned_s.unwrap_or(f64::NAN),
        cpu_s,
        megapixels: megapixels(&part.whole),
        rendered: rendered(&made.drawing, part.place_mm),
    })
}

/// Processor time of this process so far, s.
fn processor_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// A drawing of another program, or why there is none; `given` takes the picture that it gets.
fn peers(
    artists: &mut Artists,
    name: &str,
    part: &Part,
    given: &Path,
    config: &Config,
) -> Result<Attempt<Portrait>, BenchError> {
    let Some(peer) = PEERS.iter().find(|peer| peer.name == name) else {
        return Ok(Err("it is unknown".to_owned()));
    };
    let [_, _, width, height] = part.place_mm.map(|mm| (mm * GIVEN_PX_PER_MM).round() as u32);
    let picture = imageops::resize(&part.picture, width, height, FilterType::Triangle);
    save(&picture, given)?;
    let order = Order {
        picture: given,
        place_mm: part.place_mm,
        sheet_mm: config.paper.size_mm,
        pen_mm: PEN_MM,
    };
    let options = OrderOptions {
        join_gap_mm: PEN_MM,
        keep_order: false,
        travel: Travel::of(config),
    };
    let drawn = artists.draw(peer, &order, TIME_S, config, &options)?;
    Ok(drawn.map(|drawn| Portrait {
        strokes: drawn.drawing.strokes.len(),
        planned_s: drawn.planned_s,
        cpu_s: drawn.cpu_s,
        megapixels: megapixels(&picture),
        rendered: rendered(&drawn.drawing, part.place_mm),
    }))
}

/// The drawing as an image of its place on the sheet.
fn rendered(drawing: &Drawing, place_mm: [f64; 4]) -> RgbImage {
    let whole = render_rgb(&drawing.strokes, drawing.sheet_mm, PEN_MM, JUDGED_PX_PER_MM);
    let [left, top, width, height] = place_mm.map(|mm| (mm * JUDGED_PX_PER_MM).round() as u32);
    imageops::crop_imm(&whole, left, top, width, height).to_image()
}

fn save(picture: &RgbImage, path: &Path) -> Result<(), BenchError> {
    picture.save(path).map_err(|cause| failed("portraits", cause))
}

/// Writes a photograph's drawings and mask for the judge.
fn order(part: &Part, portraits: &Portraits, file: &impl Fn(&str) -> PathBuf) -> Result<Judged, BenchError> {
    let mut drawings = BTreeMap::new();
    for (artist, portrait) in portraits {
        let path = file(artist.name);
        save(&portrait.rendered, &path)?;
        drawings.insert(artist.name, path);
    }
    let mut subject = None;
    if let Some(mask) = &part.subject.mask {
        let path = file("subject");
        let picture = GrayImage::from_fn(mask.width() as u32, mask.height() as u32, |x, y| {
            Luma([(255.0 * mask.at(x as isize, y as isize)).round().clamp(0.0, 255.0) as u8])
        });
        picture.save(&path).map_err(|cause| failed("portraits", cause))?;
        subject = Some(path);
    }
    Ok(Judged {
        name: part.photograph.name,
        picture: file("photograph"),
        subject,
        drawings,
    })
}

/// Whom a photograph shows.
fn person(name: &str) -> &'static str {
    let found = PHOTOGRAPHS.iter().find(|photograph| photograph.name == name);
    found.map_or("", |photograph| photograph.person)
}

/// Appends the figures of a photograph's drawings.
fn figures(part: &Part, portraits: &Portraits, verdict: &Verdict, rows: &mut Vec<BenchRow>) {
    let name = part.photograph.name;
    for (artist, portrait) in portraits {
        let judged = verdict.drawings.get(artist.name);
        let has_face = verdict.blank.is_some();
        let found = |blur: usize| {
            let distances = judged.filter(|_| has_face)?.distances.get(blur)?;
            Some(f64::from(u8::from(distances.is_some())))
        };
        let is_limited = !artist.is_peer && artist.name != WITHOUT_LIMIT;
        for (figure, unit) in FIGURES {
            let value = match figure {
                "tone_subject" => judged.map(|judged| judged.tone_subject),
                "tone_face" => judged.and_then(|judged| judged.tone_face),
                "edges" => Some(edge_coverage(&part.picture, &portrait.rendered)),
                "face_found_2px" => found(0),
                "face_found_4px" => found(1),
                MARGIN => judged.and_then(|judged| mean_margin(name, person, &judged.distances)),
                "strokes" => Some(portrait.strokes as f64),
                DRAWING_S => Some(portrait.planned_s),
                // The work of a smaller photograph is that of the sheet; all programs are counted alike.
                _ => Some(portrait.cpu_s / portrait.megapixels.max(1.0)),
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
fn means(rows: &mut Vec<BenchRow>) {
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
            let values: Vec<f64> = counted.filter_map(|name| value(figure, name)).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
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

/// Writes all portraits side by side, a row for each photograph.
fn contact_sheet(path: &Path, parts: &[Part], drawn: &[Portraits]) -> Result<(), BenchError> {
    let artists: Vec<Artist> = Artist::all()
        .filter(|artist| drawn.iter().flatten().any(|(known, _)| known == artist))
        .collect();
    let rows = parts.iter().zip(drawn).filter(|(_, portraits)| !portraits.is_empty());
    let mut cells = Vec::new();
    for (part, portraits) in rows {
        let Photograph { name, credit, .. } = part.photograph;
        let words = [*name, *credit].join(" ");
        cells.push((part.picture.clone(), words.trim_end().to_owned()));
        for artist in &artists {
            let portrait = portraits.iter().find(|(known, _)| known == artist);
            cells.push(match portrait {
                Some((_, portrait)) => {
                    let words = format!("{} {:.0} s", artist.name, portrait.planned_s);
                    (portrait.rendered.clone(), words)
                }
                None => (RgbImage::from_pixel(1, 1, Rgb([255; 3])), String::new()),
            });
        }
    }
    let columns = 1 + artists.len() as u32;
    let bytes =
        in_rows(cells.len(), columns, CELL_PX, cells.into_iter()).map_err(|cause| failed("portraits", cause))?;
    write_bytes(path, &bytes).map_err(|cause| failed("--contact-sheet", cause.message))
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
