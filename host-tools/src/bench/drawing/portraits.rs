//! Photographs drawn in every style and by other programs, all in the same drawing time, before independent judges.
//!
//! Every program draws the part of the photograph that this one draws by default: the head of a portrait. Drawing times
//! are those of the firmware's planner at its default limits. Every drawing is judged as the pen leaves it on the paper,
//! 0.5 mm wide. Figures only show when something became worse; which portrait is better has to be seen
//! (`--contact-sheet`).

use super::judge::{self, Judged};
use super::peers::{Artists, Attempt, Order, PEERS};
use super::photographs::{self, PHOTOGRAPHS, Photograph};
use super::scores::{self, Artist, Measured, TIME_S, is_equal_time};
use super::{PEN_MM, failed};
use crate::bench::{BenchError, BenchRow, Selection};
use crate::drawing::preparation::compose::from_photograph;
use crate::drawing::preparation::grid::in_rows;
use crate::drawing::preparation::source::SourceArguments;
use crate::drawing::{Crop, Drawing, OrderOptions, Subject, Travel, VectorizeOptions, edge_coverage, render_rgb};
use crate::output_file::write_bytes;
use crate::setup;
use clap::Parser;
use etherpen::config::Config;
use image::imageops::{self, FilterType};
use image::{GrayImage, Luma, Rgb, RgbImage};
use rustix::time::{ClockId, clock_gettime};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Scale of the judged drawings, and of the picture that the other programs get.
const JUDGED_PX_PER_MM: f64 = 6.0;
const GIVEN_PX_PER_MM: f64 = 5.0;
/// Largest side of a picture on the contact sheet, pixels.
const CELL_PX: u32 = 440;

#[derive(Parser)]
#[command(no_binary_name = true)]
struct CommandLine {
    #[command(flatten)]
    source: SourceArguments,
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
    measured: Measured,
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
    progress("portraits: the judges and the other programs, from PyPI");
    let python = setup::ensure_portraits()?;
    let left_out =
        |cause: &dyn std::fmt::Display| progress(&format!("the judge of faces' points is left out: {cause}"));
    let mesh = setup::ensure_mesh().map_err(|cause| left_out(&cause)).ok();
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
            let time_s = portrait.measured.planned_s;
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
    let mut verdicts = judge::verdicts(&python, &folder, &orders)?;
    if let Some(mesh) = &mesh {
        judge::add_meshes(mesh, &folder, &mut verdicts).unwrap_or_else(|cause| left_out(&cause));
    }
    for ((part, portraits), verdict) in parts.iter().zip(&drawn).zip(&verdicts) {
        let measured = portraits.iter().map(|(artist, portrait)| (*artist, portrait.measured));
        scores::figures(part.photograph.name, measured, verdict, rows);
    }
    scores::means(rows);
    if let Some(sheet) = sheet {
        contact_sheet(sheet, &parts, &drawn)?;
    }
    Ok(())
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
    let rendered = rendered(&made.drawing, part.place_mm);
    let measured = Measured {
        strokes: made.drawing.strokes.len(),
        planned_s: made.planned_s.unwrap_or(f64::NAN),
        cpu_s,
        megapixels: megapixels(&part.whole),
        edges: edge_coverage(&part.picture, &rendered),
    };
    Ok(Portrait { measured, rendered })
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
    Ok(drawn.map(|drawn| {
        let rendered = rendered(&drawn.drawing, part.place_mm);
        let measured = Measured {
            strokes: drawn.drawing.strokes.len(),
            planned_s: drawn.planned_s,
            cpu_s: drawn.cpu_s,
            megapixels: megapixels(&picture),
            edges: edge_coverage(&part.picture, &rendered),
        };
        Portrait { measured, rendered }
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
                    let words = format!("{} {:.0} s", artist.name, portrait.measured.planned_s);
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
