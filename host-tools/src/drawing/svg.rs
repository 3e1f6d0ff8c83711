//! Reads the lines of an SVG in millimetres, as a plotter has to draw them.
//!
//! `usvg` resolves styles, references, units, nested pages and transforms; this file prepares its input and reads its
//! tree. Every shape is drawn along its outline, filled or not, because a pen cannot fill; a filled rectangle behind
//! the whole page is paper. Curves become lines within a tolerance, dashes become strokes, clip paths clip, text
//! becomes lines of a font.
//!
//! Invariant: parts are left out only with a warning, and the numbers of elements, points and steps are bounded for
//! every file.

mod dashes;
mod demands;
mod head;
mod messages;
mod text;

use super::artwork::{Artwork, Layer, LayerStroke, UserSpace};
use super::clip::{Region, clip};
use super::length::{MM_PER_PX, to_mm};
use super::line::{self, Point};
use super::plot::PLACE_MAX_MM;
use super::{DrawingError, FilePlace, Stroke};
use dashes::cut_into_dashes;
use head::{Head, farthest_line, out_of_range_line};
use kurbo::{Affine, BezPath, PathEl};
use messages::{Collected, Said};
use std::cell::Cell;
use std::collections::{HashMap, HashSet};
use std::io;
use std::thread;
use text::Fonts;
pub use text::{FontFile, TextFont};
use usvg::roxmltree::{Document, ParsingOptions};
use usvg::tiny_skia_path::{PathSegment, Transform};

/// Largest distance of a line from the curve that it approximates, mm.
const TOLERANCE_MM: f64 = 0.02;
/// Most points of all strokes together.
const POINTS_MAX: usize = 20_000_000;
/// Stack for usvg, bytes: its functions call themselves for every level of a file, see [`demands`].
const STACK_BYTES: usize = 64 << 20;
/// Most dashes of one line; one with more is drawn solid.
const DASHES_MAX: f64 = 100_000.0;
/// Most dashes of all lines together; lines after that are drawn solid.
const ALL_DASHES_MAX: f64 = 2_000_000.0;
/// Most warnings kept; a damaged file has one for each element.
const WARNINGS_MAX: usize = 12;
/// Most elements of a file, the limit of usvg.
const ELEMENTS_MAX: usize = 1_000_000;
/// Stroke colour for elements without one, so that they are not invisible; unlikely to be used in a file.
const UNNAMED_STROKE: [u8; 3] = [1, 2, 3];
/// Least share of the page that a filled rectangle has to cover to count as the paper.
const PAPER_SHARE: f64 = 0.98;
/// Name space of Inkscape's layers.
const INKSCAPE: &str = "http://www.inkscape.org/namespaces/inkscape";

/// Reads an SVG, text as outlines of the installed fonts.
///
/// # Errors
/// As [`read_svg_with`].
pub fn read_svg(text: &str) -> Result<Artwork, DrawingError> {
    read_svg_with(text, &TextFont::default())
}

/// Reads an SVG.
///
/// # Errors
/// [`DrawingError::SvgSyntax`], [`DrawingError::SvgCycle`], [`DrawingError::SvgSize`], [`DrawingError::SvgElements`],
/// [`DrawingError::SvgTooMuch`], [`DrawingError::FarAway`] with the line of the number that is too large, or
/// [`DrawingError::TooManyPoints`].
pub fn read_svg_with(text: &str, font: &TextFont) -> Result<Artwork, DrawingError> {
    let options = ParsingOptions {
        allow_dtd: true,
        ..ParsingOptions::default()
    };
    demands::check_attributes(text)?;
    let document = Document::parse_with_options(text, options).map_err(|error| syntax(&error))?;
    let too_many = DrawingError::SvgElements {
        elements_max: ELEMENTS_MAX,
    };
    if document.descendants().filter(|node| node.is_element()).count() > ELEMENTS_MAX {
        return Err(too_many);
    }
    let head = Head::of(&document);
    if head.has_invalid_size {
        return Err(DrawingError::SvgSize);
    }
    if let Some(line) = out_of_range_line(&document) {
        return Err(DrawingError::FarAway {
            place: FilePlace::Line(line),
        });
    }
    demands::check(&document)?;
    let prepared = head.prepared(text);
    let fonts = Fonts::find(&document, font);
    drop(document);
    let mut options = usvg_options();
    fonts.give_to(&mut options);
    let (mut tree, mut said) = tree(&prepared, &options)?;
    let mut warnings = head.warnings;
    warnings.extend(fonts.warning());
    if !said.missing.is_empty() {
        warnings.extend(text::left_out(&said.missing));
        (tree, said) = self::tree(&text::without(&prepared, &said.missing), &options)?;
    }
    warnings.extend(said.warnings);
    let tree = tree.map_err(|error| match error {
        // The XML itself has already been parsed.
        usvg::Error::ParsingFailed(_) => DrawingError::SvgCycle,
        usvg::Error::ElementsLimitReached => too_many,
        usvg::Error::InvalidSize => DrawingError::SvgSize,
        _ => DrawingError::UnknownContent,
    })?;
    let page_mm = [tree.size().width(), tree.size().height()].map(|px| f64::from(px) * MM_PER_PX);
    let in_place = |error: DrawingError| match error {
        DrawingError::FarAway { .. } => error.at(farthest_line(text).map_or(FilePlace::Somewhere, FilePlace::Line)),
        other => other,
    };
    check_place(page_mm).map_err(in_place)?;
    let mut reader = Reader {
        page_mm,
        layer_ids: head.layer_ids,
        by_label: !head.layers.is_empty(),
        // A label may equal the name of a colour; the first one counts.
        layer_names: (head.layers.iter().enumerate().rev())
            .map(|(number, layer)| (layer.name.clone(), number))
            .collect(),
        drawn_layers: HashSet::new(),
        layers: head.layers,
        strokes: Vec::new(),
        points: 0,
        clips: Vec::new(),
        papers: 0,
        cut_steps: 0,
        dashes: 0.0,
        warnings,
        letters_are_open: fonts.are_open,
        is_open: false,
    };
    reader.group(tree.root(), None).map_err(in_place)?;
    Ok(reader.finish(head.is_sized.then_some(page_mm), head.user_space))
}

/// Refuses coordinates out of range.
fn check_place(at: Point) -> Result<(), DrawingError> {
    if at.iter().all(|mm| mm.abs() <= PLACE_MAX_MM) {
        return Ok(());
    }
    Err(DrawingError::FarAway {
        place: FilePlace::Somewhere,
    })
}

/// usvg's tree of a file, and usvg's messages about it; a thread without memory for its stack is an error.
fn tree(text: &str, options: &usvg::Options) -> io::Result<(Result<usvg::Tree, usvg::Error>, Said)> {
    let read = || {
        let collected = Collected::begin();
        let tree = usvg::Tree::from_str(text, options);
        (tree, collected.end())
    };
    thread::scope(|scope| {
        let reading = thread::Builder::new()
            .stack_size(STACK_BYTES)
            .spawn_scoped(scope, read)?;
        Ok(reading.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

fn syntax(error: &usvg::roxmltree::Error) -> DrawingError {
    let place = error.pos();
    DrawingError::SvgSyntax {
        line: place.row,
        column: place.col,
    }
}

/// Embedded images are not drawn, so they are not opened.
fn usvg_options() -> usvg::Options<'static> {
    usvg::Options {
        image_href_resolver: usvg::ImageHrefResolver {
            resolve_data: Box::new(|_, _, _| None),
            resolve_string: Box::new(|_, _| None),
        },
        ..usvg::Options::default()
    }
}

/// A clip path's regions: a point is inside if it is in one region of each.
type Clip = Vec<Region>;

/// Collects strokes while it walks through usvg's tree.
struct Reader {
    page_mm: [f64; 2],
    layer_ids: HashMap<String, usize>,
    by_label: bool,
    layers: Vec<Layer>,
    /// The layer of each label and each colour.
    layer_names: HashMap<String, usize>,
    /// Layers with a stroke.
    drawn_layers: HashSet<usize>,
    strokes: Vec<LayerStroke>,
    points: usize,
    clips: Vec<Clip>,
    papers: usize,
    cut_steps: usize,
    /// Approximate number of dashes of all lines.
    dashes: f64,
    warnings: Vec<String>,
    letters_are_open: bool,
    /// Whether closing lines are left out.
    is_open: bool,
}

impl Reader {
    fn group(&mut self, group: &usvg::Group, layer: Option<usize>) -> Result<(), DrawingError> {
        let layer = self.layer_ids.get(group.id()).copied().or(layer);
        let clips = self.clips.len();
        if let Some(path) = group.clip_path() {
            self.push_clip(path, group.abs_transform())?;
        }
        for (is_there, what) in [
            (group.mask().is_some(), "mask"),
            (!group.filters().is_empty(), "filter"),
        ] {
            if is_there {
                self.warn(|| format!("a {what} is not applied: the lines are drawn as if it were not there"));
            }
        }
        for node in group.children() {
            match node {
                usvg::Node::Group(group) => self.group(group, layer)?,
                usvg::Node::Path(path) if path.is_visible() => self.path(path, layer)?,
                usvg::Node::Text(text) => {
                    self.is_open = self.letters_are_open;
                    self.group(text.flattened(), layer)?;
                    self.is_open = false;
                }
                usvg::Node::Path(_) | usvg::Node::Image(_) => {}
            }
        }
        self.clips.truncate(clips);
        Ok(())
    }

    fn warn(&mut self, text: impl FnOnce() -> String) {
        if self.warnings.len() < WARNINGS_MAX {
            let text = text();
            if !self.warnings.contains(&text) {
                self.warnings.push(text);
            }
        }
    }

    fn push_clip(&mut self, path: &usvg::ClipPath, transform: Transform) -> Result<(), DrawingError> {
        let mut regions = Vec::new();
        let transform = transform.pre_concat(path.transform());
        self.regions(path.root(), transform, &mut regions)?;
        self.clips.push(regions);
        path.clip_path()
            .map_or(Ok(()), |outer| self.push_clip(outer, transform))
    }

    fn regions(&mut self, group: &usvg::Group, at: Transform, out: &mut Clip) -> Result<(), DrawingError> {
        for node in group.children() {
            match node {
                usvg::Node::Group(inner) => self.regions(inner, at.pre_concat(inner.transform()), out)?,
                usvg::Node::Path(path) => {
                    let is_even_odd = path.fill().is_some_and(|fill| fill.rule() == usvg::FillRule::EvenOdd);
                    let lines = self.lines(path.data(), at)?;
                    self.count_points(lines.iter().map(Vec::len).sum())?;
                    out.push(Region::new(lines, is_even_odd));
                }
                usvg::Node::Image(_) | usvg::Node::Text(_) => {}
            }
        }
        Ok(())
    }

    fn path(&mut self, path: &usvg::Path, layer: Option<usize>) -> Result<(), DrawingError> {
        let lines = self.lines(path.data(), path.abs_transform())?;
        let named = path.stroke().and_then(|stroke| colour(stroke.paint()));
        let is_outlined = path.stroke().is_some() && named != Some(UNNAMED_STROKE);
        if !is_outlined && path.fill().is_some() && self.is_paper(&lines) {
            self.papers += 1;
            return Ok(());
        }
        let colour = match named {
            Some(colour) if colour != UNNAMED_STROKE => colour,
            _ => path.fill().and_then(|fill| colour(fill.paint())).unwrap_or_default(),
        };
        let layer = self.layer_of(layer, colour);
        let lines = match path.stroke() {
            Some(stroke) if stroke.dasharray().is_some() => self.dashed(lines, stroke, path.abs_transform()),
            _ => lines,
        };
        for points in self.clipped(lines) {
            self.count_points(points.len())?;
            self.strokes.push(LayerStroke {
                layer,
                stroke: Stroke { points },
            });
        }
        Ok(())
    }

    fn count_points(&mut self, points: usize) -> Result<(), DrawingError> {
        self.points += points;
        if self.points > POINTS_MAX {
            return Err(DrawingError::TooManyPoints { points_max: POINTS_MAX });
        }
        Ok(())
    }

    /// The layer of a stroke: that of its group if the file has layers, otherwise that of its colour.
    fn layer_of(&mut self, layer: Option<usize>, colour: [u8; 3]) -> usize {
        if let Some(layer) = layer {
            if self.drawn_layers.insert(layer)
                && let Some(known) = self.layers.get_mut(layer)
            {
                known.colour = colour;
            }
            return layer;
        }
        let [red, green, blue] = colour;
        let name = if self.by_label {
            String::new()
        } else {
            format!("#{red:02x}{green:02x}{blue:02x}")
        };
        let layers = &mut self.layers;
        *self.layer_names.entry(name.clone()).or_insert_with(|| {
            layers.push(Layer { name, colour });
            layers.len() - 1
        })
    }

    /// Whether the lines form one rectangle around the whole page.
    fn is_paper(&self, lines: &[Vec<Point>]) -> bool {
        let [points] = lines else { return false };
        let [_, _, width, height] = super::artwork::bounds(points.iter());
        points.len() == 5 && width >= PAPER_SHARE * self.page_mm[0] && height >= PAPER_SHARE * self.page_mm[1]
    }

    /// A path as lines in millimetres on the page.
    fn lines(&mut self, path: &usvg::tiny_skia_path::Path, at: Transform) -> Result<Vec<Vec<Point>>, DrawingError> {
        let numbers = [at.sx, at.ky, at.kx, at.sy, at.tx, at.ty].map(|value| f64::from(value) * MM_PER_PX);
        let shape = Affine::new(numbers) * bezier(path);
        for element in shape.elements() {
            let points = match *element {
                PathEl::MoveTo(a) | PathEl::LineTo(a) => [a, a, a],
                PathEl::QuadTo(a, b) => [a, b, b],
                PathEl::CurveTo(a, b, c) => [a, b, c],
                PathEl::ClosePath => continue,
            };
            points.iter().try_for_each(|point| check_place([point.x, point.y]))?;
        }
        let mut lines: Vec<Vec<Point>> = Vec::new();
        let mut points: Vec<Point> = Vec::new();
        let total = Cell::new(0_usize);
        let elements = shape.elements().iter().copied();
        kurbo::flatten(
            elements.take_while(|_| total.get() <= POINTS_MAX),
            TOLERANCE_MM,
            |element| {
                total.set(total.get() + 1);
                match element {
                    PathEl::MoveTo(to) => lines.push(std::mem::replace(&mut points, vec![[to.x, to.y]])),
                    PathEl::LineTo(to) if total.get() <= POINTS_MAX => points.push([to.x, to.y]),
                    PathEl::ClosePath => {
                        if self.is_open {
                            lines.push(std::mem::take(&mut points));
                        } else if let Some(&first) = points.first() {
                            points.push(first);
                            lines.push(std::mem::replace(&mut points, vec![first]));
                        }
                    }
                    _ => {}
                }
            },
        );
        lines.push(points);
        if total.get() > POINTS_MAX {
            return Err(DrawingError::TooManyPoints { points_max: POINTS_MAX });
        }
        let mut kept = Vec::with_capacity(lines.len());
        for mut points in lines {
            points.dedup();
            if points.len() > 1 {
                kept.push(points);
            }
        }
        Ok(kept)
    }

    fn dashed(&mut self, lines: Vec<Vec<Point>>, stroke: &usvg::Stroke, at: Transform) -> Vec<Vec<Point>> {
        let scale = f64::from((at.sx * at.sy - at.kx * at.ky).abs()).sqrt() * MM_PER_PX;
        let dashes: Vec<f64> = (stroke.dasharray().unwrap_or_default().iter())
            .map(|dash| f64::from(*dash) * scale)
            .collect();
        let period: f64 = dashes.iter().sum();
        let mut result = Vec::new();
        for points in lines {
            let count = line::length(&points) / period * dashes.len() as f64;
            self.dashes += count;
            if count <= DASHES_MAX && self.dashes <= ALL_DASHES_MAX && period > 0.0 {
                result.extend(cut_into_dashes(
                    &points,
                    &dashes,
                    f64::from(stroke.dashoffset()) * scale,
                ));
            } else {
                self.warn(|| "a line of too many dashes is drawn solid".to_owned());
                result.push(points);
            }
        }
        result
    }

    fn clipped(&mut self, mut lines: Vec<Vec<Point>>) -> Vec<Vec<Point>> {
        let clips = std::mem::take(&mut self.clips);
        for regions in &clips {
            let mut cut = Vec::new();
            for points in lines {
                match clip(&points, regions, &mut self.cut_steps) {
                    Some(parts) => cut.extend(parts),
                    None => {
                        self.warn(|| "clip paths of too many points: some lines are not clipped".to_owned());
                        cut.push(points);
                    }
                }
            }
            lines = cut;
        }
        self.clips = clips;
        lines
    }

    fn finish(mut self, page_mm: Option<[f64; 2]>, user_space: UserSpace) -> Artwork {
        if self.papers > 0 {
            let papers = self.papers;
            self.warn(|| {
                format!(
                    "{papers} {} behind the whole page taken as paper, not drawn",
                    if papers == 1 {
                        "filled rectangle"
                    } else {
                        "filled rectangles"
                    }
                )
            });
        }
        // Layers without strokes are dropped, and numbers follow the order of drawing.
        let mut order: Vec<usize> = Vec::new();
        let mut numbers = vec![None; self.layers.len()];
        for stroke in &mut self.strokes {
            let number = *numbers[stroke.layer].get_or_insert_with(|| {
                order.push(stroke.layer);
                order.len() - 1
            });
            stroke.layer = number;
        }
        let layers = order
            .iter()
            .filter_map(|&layer| self.layers.get(layer).cloned())
            .collect();
        Artwork {
            page_mm,
            layers,
            strokes: self.strokes,
            user_space,
            warnings: self.warnings,
        }
    }
}

fn bezier(path: &usvg::tiny_skia_path::Path) -> BezPath {
    let point = |p: usvg::tiny_skia_path::Point| kurbo::Point::new(f64::from(p.x), f64::from(p.y));
    let mut result = BezPath::new();
    for segment in path.segments() {
        match segment {
            PathSegment::MoveTo(to) => result.move_to(point(to)),
            PathSegment::LineTo(to) => result.line_to(point(to)),
            PathSegment::QuadTo(a, to) => result.quad_to(point(a), point(to)),
            PathSegment::CubicTo(a, b, to) => result.curve_to(point(a), point(b), point(to)),
            PathSegment::Close => result.close_path(),
        }
    }
    result
}

fn colour(paint: &usvg::Paint) -> Option<[u8; 3]> {
    match paint {
        usvg::Paint::Color(colour) => Some([colour.red, colour.green, colour.blue]),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
