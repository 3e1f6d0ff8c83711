//! Vector files: the lines of an SVG in millimetres, as a plotter has to draw them.
//!
//! `usvg` resolves styles, references, units, nested pages and transforms; this file prepares its input and reads its
//! tree. Whatever has a shape is drawn along its outline, filled or not, because a pen cannot fill; a filled rectangle
//! behind the whole page is paper. Curves become lines within a tolerance, dashes become strokes, clip paths cut.
//!
//! Invariant: nothing is left out without a warning, and no file takes more than a known number of elements, points and
//! steps.

use super::artwork::{Artwork, Layer, LayerStroke, UserSpace};
use super::clip::{Region, clip};
use super::length::{MM_PER_PX, to_mm};
use super::line::{self, Point};
use super::{DrawingError, Stroke};
use kurbo::{Affine, BezPath, PathEl};
use std::cell::RefCell;
use std::collections::HashMap;
use usvg::roxmltree::{Document, Node as XmlNode, ParsingOptions};
use usvg::tiny_skia_path::{PathSegment, Transform};

/// Largest distance of a line from the curve that it stands for, mm.
const TOLERANCE_MM: f64 = 0.02;
/// Most points of all strokes together.
const POINTS_MAX: usize = 20_000_000;
/// Most dashes of one line; one with more is drawn solid.
const DASHES_MAX: f64 = 100_000.0;
/// Most warnings kept; a damaged file has one for each element.
const WARNINGS_MAX: usize = 12;
/// Most elements of a file, as many as usvg takes.
const ELEMENTS_MAX: usize = 1_000_000;
/// Stroke of elements that name none, so that they are not invisible; no file uses this colour by chance.
const UNNAMED_STROKE: [u8; 3] = [1, 2, 3];
/// Share of the page that a filled rectangle covers when it is the paper.
const PAPER_SHARE: f64 = 0.98;
/// Name space of Inkscape's layers.
const INKSCAPE: &str = "http://www.inkscape.org/namespaces/inkscape";

/// Reads an SVG.
///
/// # Errors
/// [`DrawingError::SvgSyntax`], [`DrawingError::SvgCycle`], [`DrawingError::SvgSize`], [`DrawingError::SvgElements`] or
/// [`DrawingError::TooManyPoints`].
pub fn read_svg(text: &str) -> Result<Artwork, DrawingError> {
    let options = ParsingOptions {
        allow_dtd: true,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, options).map_err(|error| syntax(&error))?;
    let too_many = DrawingError::SvgElements {
        elements_max: ELEMENTS_MAX,
    };
    if document.descendants().filter(|node| node.is_element()).count() > ELEMENTS_MAX {
        return Err(too_many);
    }
    let head = Head::of(&document);
    let prepared = head.prepared(text);
    drop(document);
    let collected = Collected::begin();
    let tree = usvg::Tree::from_str(&prepared, &usvg_options());
    let mut warnings = head.warnings;
    warnings.extend(collected.end());
    let tree = tree.map_err(|error| match error {
        // The text itself has been read once before.
        usvg::Error::ParsingFailed(_) => DrawingError::SvgCycle,
        usvg::Error::ElementsLimitReached => too_many,
        usvg::Error::InvalidSize => DrawingError::SvgSize,
        _ => DrawingError::UnknownContent,
    })?;
    let page_mm = [tree.size().width(), tree.size().height()].map(|px| f64::from(px) * MM_PER_PX);
    let mut reader = Reader {
        page_mm,
        layer_ids: head.layer_ids,
        by_label: !head.layers.is_empty(),
        layers: head.layers,
        strokes: Vec::new(),
        points: 0,
        clips: Vec::new(),
        papers: 0,
        cut_steps: 0,
        warnings,
    };
    reader.group(tree.root(), None)?;
    Ok(reader.finish(head.is_sized.then_some(page_mm), head.user_space))
}

fn syntax(error: &usvg::roxmltree::Error) -> DrawingError {
    let place = error.pos();
    DrawingError::SvgSyntax {
        line: place.row,
        column: place.col,
    }
}

/// Pictures inside a file are not drawn, so they are not opened either.
fn usvg_options() -> usvg::Options<'static> {
    usvg::Options {
        image_href_resolver: usvg::ImageHrefResolver {
            resolve_data: Box::new(|_, _, _| None),
            resolve_string: Box::new(|_, _| None),
        },
        ..usvg::Options::default()
    }
}

/// What the file's text says that usvg's tree does not.
struct Head {
    is_sized: bool,
    user_space: UserSpace,
    layers: Vec<Layer>,
    /// Layer by the id of its group.
    layer_ids: HashMap<String, usize>,
    /// What is put into the text, and where.
    insertions: Vec<(usize, String)>,
    warnings: Vec<String>,
}

impl Head {
    fn of(document: &Document) -> Self {
        let root = document.root_element();
        let attribute = |name: &'static str| root.attribute(name).map(|value| (name, value.to_owned()));
        let attributes: Vec<_> = ["width", "height", "viewBox"]
            .into_iter()
            .filter_map(attribute)
            .collect();
        let mut head = Self {
            is_sized: root.attribute("viewBox").is_some()
                || ["width", "height"]
                    .iter()
                    .all(|&name| absolute_mm(&root, name).is_some()),
            user_space: user_space(&root, attributes),
            layers: Vec::new(),
            layer_ids: HashMap::new(),
            insertions: Vec::new(),
            warnings: Vec::new(),
        };
        if absolute_mm(&root, "width").is_none() && absolute_mm(&root, "height").is_none() {
            head.warnings.push(
                "the file names no size: its units are taken as 1/96 inch (older programs meant 1/72 or 1/90); \
                 --size or --fit says how large it becomes"
                    .to_owned(),
            );
        }
        let is_styled = |node: &XmlNode| node.attribute("style").is_some_and(|style| style.contains("stroke:"));
        if root.attribute("stroke").is_none() && !is_styled(&root) {
            let [red, green, blue] = UNNAMED_STROKE;
            head.insert(&root, &format!(" stroke=\"#{red:02x}{green:02x}{blue:02x}\""));
        }
        head.find_layers(document);
        let mut left_out: Vec<(&str, usize)> = vec![("text", 0), ("image", 0), ("foreignObject", 0)];
        for node in document.descendants().filter(XmlNode::is_element) {
            for (name, count) in &mut left_out {
                *count += usize::from(node.tag_name().name() == *name);
            }
        }
        for (name, count) in left_out.into_iter().filter(|(_, count)| *count > 0) {
            let remedy = if name == "text" {
                "; convert text to paths first"
            } else {
                ""
            };
            head.warnings.push(format!("{count} <{name}> not drawn{remedy}"));
        }
        head
    }

    fn find_layers(&mut self, document: &Document) {
        let is_layer =
            |node: &XmlNode| node.tag_name().name() == "g" && node.attribute((INKSCAPE, "groupmode")) == Some("layer");
        for node in document.descendants().filter(is_layer) {
            let number = self.layers.len();
            let name = node
                .attribute((INKSCAPE, "label"))
                .map_or_else(|| (number + 1).to_string(), str::to_owned);
            let id = match node.attribute("id") {
                Some(id) => id.to_owned(),
                None => {
                    let id = format!("etherpen-layer-{number}");
                    self.insert(&node, &format!(" id=\"{id}\""));
                    id
                }
            };
            self.layer_ids.insert(id, number);
            self.layers.push(Layer { name, colour: [0; 3] });
        }
    }

    /// Puts text after an element's name.
    fn insert(&mut self, node: &XmlNode, text: &str) {
        let source = node.document().input_text();
        let start = node.range().start + 1;
        let rest = source.get(start..).unwrap_or_default();
        let name = rest
            .find(|c: char| c.is_whitespace() || c == '>' || c == '/')
            .unwrap_or(0);
        self.insertions.push((start + name, text.to_owned()));
    }

    fn prepared(&self, text: &str) -> String {
        let mut result = String::with_capacity(text.len() + 64 * self.insertions.len());
        let mut from = 0;
        let mut insertions: Vec<_> = self.insertions.iter().collect();
        insertions.sort();
        for (at, inserted) in insertions {
            result.push_str(text.get(from..*at).unwrap_or_default());
            result.push_str(inserted);
            from = *at;
        }
        result.push_str(text.get(from..).unwrap_or_default());
        result
    }
}

/// A length of the root that does not depend on a window's size, mm.
fn absolute_mm(root: &XmlNode, name: &str) -> Option<f64> {
    to_mm(root.attribute(name)?, MM_PER_PX).filter(|mm| *mm > 0.0)
}

/// How the root's own units follow from millimetres, where its box is not squeezed.
fn user_space(root: &XmlNode, attributes: Vec<(&'static str, String)>) -> UserSpace {
    let numbers: Option<Vec<f64>> = root.attribute("viewBox").and_then(|text| {
        let parts = text.split([' ', ',', '\t', '\n', '\r']).filter(|part| !part.is_empty());
        parts.map(|part| part.parse().ok()).collect()
    });
    let plain = UserSpace {
        attributes,
        units_per_mm: [1.0 / MM_PER_PX; 2],
        origin: [0.0; 2],
    };
    let Some(&[left, top, width, height]) = numbers.as_deref() else {
        return plain;
    };
    if !(width > 0.0 && height > 0.0 && (left + top + width + height).is_finite()) {
        return plain;
    }
    let (page_width, page_height) = match (absolute_mm(root, "width"), absolute_mm(root, "height")) {
        (Some(page_width), Some(page_height)) => (page_width, page_height),
        (Some(page_width), None) => (page_width, page_width * height / width),
        (None, Some(page_height)) => (page_height * width / height, page_height),
        (None, None) => (width * MM_PER_PX, height * MM_PER_PX),
    };
    let across = [width / page_width, height / page_height];
    let aspect = root.attribute("preserveAspectRatio").unwrap_or_default();
    if aspect.starts_with("none") {
        return UserSpace {
            units_per_mm: across,
            origin: [left, top],
            ..plain
        };
    }
    let units = if aspect.contains("slice") {
        across[0].min(across[1])
    } else {
        across[0].max(across[1])
    };
    let align = |low: &str, high: &str| {
        if aspect.contains(low) {
            0.0
        } else if aspect.contains(high) {
            1.0
        } else {
            0.5
        }
    };
    UserSpace {
        units_per_mm: [units; 2],
        origin: [
            left - align("xMin", "xMax") * (page_width * units - width),
            top - align("YMin", "YMax") * (page_height * units - height),
        ],
        ..plain
    }
}

/// A clip path's regions: a point is inside when it is in one of each.
type Clip = Vec<Region>;

/// Collects strokes while it walks through usvg's tree.
struct Reader {
    page_mm: [f64; 2],
    layer_ids: HashMap<String, usize>,
    by_label: bool,
    layers: Vec<Layer>,
    strokes: Vec<LayerStroke>,
    points: usize,
    clips: Vec<Clip>,
    papers: usize,
    cut_steps: usize,
    warnings: Vec<String>,
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
                usvg::Node::Path(_) | usvg::Node::Image(_) | usvg::Node::Text(_) => {}
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
            self.points += points.len();
            if self.points > POINTS_MAX {
                return Err(DrawingError::TooManyPoints { points_max: POINTS_MAX });
            }
            self.strokes.push(LayerStroke {
                layer,
                stroke: Stroke { points },
            });
        }
        Ok(())
    }

    /// The layer of a stroke: its group's where the file has layers, its colour's where it has none.
    fn layer_of(&mut self, layer: Option<usize>, colour: [u8; 3]) -> usize {
        if let Some(layer) = layer {
            if !self.strokes.iter().rev().take(1).any(|last| last.layer == layer)
                && !self.strokes.iter().any(|stroke| stroke.layer == layer)
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
        let known = self.layers.iter().position(|layer| layer.name == name);
        known.unwrap_or_else(|| {
            self.layers.push(Layer { name, colour });
            self.layers.len() - 1
        })
    }

    /// Whether lines are one rectangle around the whole page.
    fn is_paper(&self, lines: &[Vec<Point>]) -> bool {
        let [points] = lines else { return false };
        let [_, _, width, height] = super::artwork::bounds(points.iter());
        points.len() == 5 && width >= PAPER_SHARE * self.page_mm[0] && height >= PAPER_SHARE * self.page_mm[1]
    }

    /// A path as lines in millimetres on the page.
    fn lines(&mut self, path: &usvg::tiny_skia_path::Path, at: Transform) -> Result<Vec<Vec<Point>>, DrawingError> {
        let numbers = [at.sx, at.ky, at.kx, at.sy, at.tx, at.ty].map(|value| f64::from(value) * MM_PER_PX);
        let shape = Affine::new(numbers) * bezier(path);
        let mut lines: Vec<Vec<Point>> = Vec::new();
        let mut points: Vec<Point> = Vec::new();
        let mut total = 0_usize;
        kurbo::flatten(&shape, TOLERANCE_MM, |element| {
            total += 1;
            match element {
                PathEl::MoveTo(to) => lines.push(std::mem::replace(&mut points, vec![[to.x, to.y]])),
                PathEl::LineTo(to) if total <= POINTS_MAX => points.push([to.x, to.y]),
                PathEl::ClosePath => {
                    if let Some(&first) = points.first() {
                        points.push(first);
                        lines.push(std::mem::replace(&mut points, vec![first]));
                    }
                }
                _ => {}
            }
        });
        lines.push(points);
        if total > POINTS_MAX {
            return Err(DrawingError::TooManyPoints { points_max: POINTS_MAX });
        }
        let is_finite = |points: &Vec<Point>| points.iter().flatten().all(|value| value.is_finite());
        let mut kept = Vec::with_capacity(lines.len());
        for mut points in lines {
            points.dedup();
            if points.len() < 2 {
                continue;
            }
            if is_finite(&points) {
                kept.push(points);
            } else {
                self.warn(|| "a line with a coordinate that is no finite number is not drawn".to_owned());
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
            if count <= DASHES_MAX && period > 0.0 {
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
            self.warn(|| format!("{papers} filled rectangle(s) behind the whole page taken as paper, not drawn"));
        }
        // Layers without strokes are none, and numbers follow the order of drawing.
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

/// The drawn parts of a dashed line; `dashes` are drawn and not drawn lengths by turns.
fn cut_into_dashes(points: &[Point], dashes: &[f64], offset: f64) -> Vec<Vec<Point>> {
    let period: f64 = dashes.iter().sum();
    let (mut index, mut left) = (0, offset.rem_euclid(period));
    while left >= dashes[index] && index + 1 < dashes.len() {
        left -= dashes[index];
        index += 1;
    }
    let mut left = (dashes[index] - left).max(0.0);
    let mut result = Vec::new();
    let mut dash: Vec<Point> = points.iter().take(1).copied().collect();
    for pair in points.windows(2) {
        let piece = line::distance(pair[0], pair[1]);
        let mut done = 0.0;
        while piece - done > left {
            done += left;
            let at = line::between(pair[0], pair[1], done / piece);
            if index.is_multiple_of(2) {
                dash.push(at);
                result.push(std::mem::take(&mut dash));
            }
            index = (index + 1) % dashes.len();
            left = dashes[index];
            dash = vec![at];
        }
        left -= piece - done;
        dash.push(pair[1]);
    }
    if index.is_multiple_of(2) {
        result.push(dash);
    }
    for dash in &mut result {
        dash.dedup();
    }
    result.retain(|dash| dash.len() > 1);
    result
}

thread_local! {
    static MESSAGES: RefCell<Option<Vec<String>>> = const { RefCell::new(None) };
}

/// What usvg says about a file on this thread, kept as warnings.
struct Collected;

struct Collector;

impl log::Log for Collector {
    fn enabled(&self, metadata: &log::Metadata) -> bool {
        metadata.level() <= log::Level::Warn
    }

    fn log(&self, record: &log::Record) {
        MESSAGES.with_borrow_mut(|messages| {
            if let Some(messages) = messages
                && messages.len() < WARNINGS_MAX
            {
                messages.push(record.args().to_string());
            }
        });
    }

    fn flush(&self) {}
}

impl Collected {
    fn begin() -> Self {
        // Another logger that is installed already keeps the messages; a file is read all the same.
        if log::set_logger(&Collector).is_ok() {
            log::set_max_level(log::LevelFilter::Warn);
        }
        MESSAGES.set(Some(Vec::new()));
        Self
    }

    fn end(self) -> Vec<String> {
        let mut messages = MESSAGES.take().unwrap_or_default();
        messages.dedup();
        messages
    }
}

#[cfg(test)]
mod tests;
