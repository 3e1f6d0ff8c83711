//! Reads what usvg's tree does not contain from an SVG's text: sizes, layers, elements that cannot be drawn.
//!
//! Invariant: the text inserted for usvg changes no line of the drawing.

use super::{INKSCAPE, Layer, MM_PER_PX, UNNAMED_STROKE, UserSpace, to_mm};
use std::collections::HashMap;
use usvg::roxmltree::{Document, Node as XmlNode, ParsingOptions};

/// Attributes with coordinates and lengths of shapes.
const GEOMETRY: [&str; 15] = [
    "d", "points", "x", "y", "x1", "y1", "x2", "y2", "cx", "cy", "r", "rx", "ry", "width", "height",
];
/// Largest valid number: a kilometre in micrometres.
const NUMBER_MAX: f64 = 1e9;

/// Data from the file's text that usvg's tree does not contain.
pub(super) struct Head {
    pub(super) is_sized: bool,
    pub(super) has_invalid_size: bool,
    pub(super) user_space: UserSpace,
    pub(super) layers: Vec<Layer>,
    /// Layer by the id of its group.
    pub(super) layer_ids: HashMap<String, usize>,
    /// Text to insert, and where.
    insertions: Vec<(usize, String)>,
    pub(super) warnings: Vec<String>,
}

/// The line of the first element with a number out of range; libraries would approximate an arc of that size with a
/// great many pieces.
pub(super) fn out_of_range_line(document: &Document) -> Option<usize> {
    let is_senseless = |node: &XmlNode| {
        let mut largest = 0.0_f64;
        for attribute in GEOMETRY.iter().filter_map(|&name| node.attribute(name)) {
            each_number(attribute, &mut |number| largest = largest.max(number.abs()));
        }
        largest > NUMBER_MAX
    };
    let mut elements = document.descendants().filter(XmlNode::is_element);
    Some(line_of(document, &elements.find(is_senseless)?))
}

/// The line of the element with the largest number in an attribute; `None` in a file without numbers.
pub(super) fn farthest_line(text: &str) -> Option<usize> {
    let options = ParsingOptions {
        allow_dtd: true,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, options).ok()?;
    let largest = |node: &XmlNode| {
        let mut largest = 0.0_f64;
        for attribute in node.attributes() {
            each_number(attribute.value(), &mut |number| largest = largest.max(number.abs()));
        }
        largest
    };
    let elements = document.descendants().filter(XmlNode::is_element);
    let farthest = elements
        .map(|node| (largest(&node), node))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(line_of(&document, &farthest.1))
}

pub(super) fn line_of(document: &Document, node: &XmlNode) -> usize {
    document.text_pos_at(node.range().start).row as usize
}

/// Finds the numbers in a text; a sign or a second decimal point starts the next number.
pub(super) fn each_number(text: &str, found: &mut impl FnMut(f64)) {
    let (mut begin, mut has_point, mut last) = (0, false, ' ');
    let mut take = |word: Option<&str>| {
        if let Some(number) = word.and_then(|word| word.parse::<f64>().ok()) {
            found(number);
        }
    };
    for (at, letter) in text.char_indices() {
        let is_part = matches!(letter, '0'..='9' | '.' | '-' | '+' | 'e' | 'E');
        let is_sign = matches!(letter, '-' | '+') && !matches!(last, 'e' | 'E');
        if !is_part || is_sign || (letter == '.' && has_point) {
            take(text.get(begin..at));
            begin = if is_part { at } else { at + letter.len_utf8() };
            has_point = false;
        }
        has_point |= letter == '.';
        last = letter;
    }
    take(text.get(begin..));
}

impl Head {
    pub(super) fn of(document: &Document) -> Self {
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
            has_invalid_size: has_invalid_size(&root),
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
        let mut left_out: Vec<(&str, usize)> = vec![("image", 0), ("foreignObject", 0)];
        for node in document.descendants().filter(XmlNode::is_element) {
            for (name, count) in &mut left_out {
                *count += usize::from(node.tag_name().name() == *name);
            }
        }
        for (name, count) in left_out.into_iter().filter(|(_, count)| *count > 0) {
            head.warnings.push(format!("{count} <{name}> not drawn"));
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

    /// Inserts text after an element's name.
    fn insert(&mut self, node: &XmlNode, text: &str) {
        let source = node.document().input_text();
        let start = node.range().start + 1;
        let rest = source.get(start..).unwrap_or_default();
        let name = rest
            .find(|c: char| c.is_whitespace() || c == '>' || c == '/')
            .unwrap_or(0);
        self.insertions.push((start + name, text.to_owned()));
    }

    pub(super) fn prepared(&self, text: &str) -> String {
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

/// Whether the root's width or height is present but not a length.
fn has_invalid_size(root: &XmlNode) -> bool {
    let is_length = |text: &str| {
        let text = text.trim();
        let number = text.trim_end_matches(|letter: char| letter.is_ascii_alphabetic() || letter == '%');
        text == "auto" || number.parse::<f64>().is_ok_and(f64::is_finite)
    };
    ["width", "height"]
        .iter()
        .filter_map(|&name| root.attribute(name))
        .any(|text| !is_length(text))
}

/// Relation of the root's own units to millimetres, if its viewBox is not distorted.
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
