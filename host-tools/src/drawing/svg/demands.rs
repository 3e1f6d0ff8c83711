//! What a file demands of the libraries that read SVG: refused where they would take minutes or gigabytes.
//!
//! Some of their steps compare every part of one list with every part of another one, or call themselves for every part
//! of a chain. The limits are far above the files of drawing programs.

use super::DrawingError;
use usvg::roxmltree::{Document, Node};

/// Most attributes of an element, which are compared with each other.
const ATTRIBUTES_MAX: usize = 1_000;
/// Longest list of style properties, bytes.
const STYLE_BYTES_MAX: usize = 32 << 10;
/// Most comparisons of a style rule with an element.
const COMPARISONS_MAX: usize = 50_000_000;
/// Most letters of all texts.
const LETTERS_MAX: usize = 100_000;
/// Longest lists of coordinates in a file with markers, bytes: each corner may have a marker.
const MARKED_BYTES_MAX: usize = 256 << 10;
/// Longest path with arcs, bytes: the parser calls itself for each of a row of arcs without length.
const ARCS_BYTES_MAX: usize = 512 << 10;
/// Largest sum of the numbers of all curves: usvg outlines every curve with its pen, a large one in many pieces. A
/// drawing of 10 MiB whose coordinates are about 1,000 has half of it.
const CURVES_MAX: f64 = 5e9;
/// Most references to patterns, clip paths and the like.
const REFERENCES_MAX: usize = 20_000;
/// Most clip paths that are clipped themselves.
const CLIPPED_CLIPS_MAX: usize = 200;

/// Refuses a text with an element of too many attributes; call it before the XML is parsed.
pub(super) fn check_attributes(text: &str) -> Result<(), DrawingError> {
    let (mut quote, mut is_inside, mut attributes, mut line) = (None, false, 0, 1);
    let following = text.bytes().skip(1).chain([0]);
    for (byte, next) in text.bytes().zip(following) {
        line += usize::from(byte == b'\n');
        match (quote, byte) {
            (Some(open), _) if byte == open => quote = None,
            (Some(_), _) => {}
            // Comments, declarations and instructions have no attributes.
            (None, b'<') => (is_inside, attributes) = (!matches!(next, b'!' | b'?'), 0),
            (None, b'>') => is_inside = false,
            (None, b'"' | b'\'') if is_inside && attributes > 0 => quote = Some(byte),
            (None, b'=') if is_inside => attributes += 1,
            _ => {}
        }
        if attributes > ATTRIBUTES_MAX {
            return too_much("attributes of one element", line, ATTRIBUTES_MAX);
        }
    }
    Ok(())
}

fn too_much(what: &'static str, line: usize, most: usize) -> Result<(), DrawingError> {
    Err(DrawingError::SvgTooMuch { what, line, most })
}

/// Refuses a document that demands too much.
pub(super) fn check(document: &Document) -> Result<(), DrawingError> {
    let mut counts = Counts {
        elements: document.descendants().filter(Node::is_element).count(),
        has_markers: document.descendants().any(|node| node.has_tag_name_of("marker")),
        ..Counts::default()
    };
    for node in document.descendants() {
        counts.count(&node).map_err(|(what, most)| DrawingError::SvgTooMuch {
            what,
            line: super::head::line_of(document, &node),
            most,
        })?;
    }
    Ok(())
}

/// Names without their name spaces.
trait Named {
    fn has_tag_name_of(&self, name: &str) -> bool;
}

impl Named for Node<'_, '_> {
    fn has_tag_name_of(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

/// Demands counted so far.
#[derive(Default)]
struct Counts {
    elements: usize,
    has_markers: bool,
    rules: usize,
    letters: usize,
    marked_bytes: usize,
    curves: f64,
    references: usize,
    clipped_clips: usize,
}

type Exceeded = (&'static str, usize);

impl Counts {
    fn count(&mut self, node: &Node) -> Result<(), Exceeded> {
        if node.is_text() {
            return self.text(node);
        }
        for attribute in node.attributes() {
            let (name, value) = (attribute.name(), attribute.value());
            match name {
                "style" if value.len() > STYLE_BYTES_MAX => return Err(("bytes of style", STYLE_BYTES_MAX)),
                "d" | "points" => self.path(value)?,
                _ => {}
            }
            self.references += value.matches("url(").count();
            let is_clip = name == "clip-path" || name == "style" && value.contains("clip-path");
            self.clipped_clips += usize::from(is_clip && node.has_tag_name_of("clipPath"));
        }
        at_most("references (url)", self.references, REFERENCES_MAX)?;
        at_most("clip paths in a row", self.clipped_clips, CLIPPED_CLIPS_MAX)
    }

    fn path(&mut self, value: &str) -> Result<(), Exceeded> {
        if value.len() > ARCS_BYTES_MAX && value.contains(['a', 'A']) {
            return Err(("bytes of one path with arcs", ARCS_BYTES_MAX));
        }
        if value.contains(['c', 'C', 's', 'S', 'q', 'Q', 't', 'T', 'a', 'A']) {
            super::head::each_number(value, &mut |number| self.curves += number.abs());
        }
        if self.curves > CURVES_MAX {
            return Err(("units of curves", CURVES_MAX as usize));
        }
        self.marked_bytes += usize::from(self.has_markers) * value.len();
        at_most("bytes of paths with markers", self.marked_bytes, MARKED_BYTES_MAX)
    }

    fn text(&mut self, node: &Node) -> Result<(), Exceeded> {
        let text = node.text().unwrap_or_default();
        if node.parent().is_some_and(|parent| parent.has_tag_name_of("style")) {
            if text.split(['{', '}']).any(|part| part.len() > STYLE_BYTES_MAX) {
                return Err(("bytes of one style rule", STYLE_BYTES_MAX));
            }
            self.rules += text.matches('{').count() + text.matches(',').count();
            let comparisons = self.rules.saturating_mul(self.elements);
            return at_most("comparisons of style rules with elements", comparisons, COMPARISONS_MAX);
        }
        if node.ancestors().any(|ancestor| ancestor.has_tag_name_of("text")) {
            self.letters += text.chars().count();
        }
        at_most("letters", self.letters, LETTERS_MAX)
    }
}

fn at_most(what: &'static str, count: usize, most: usize) -> Result<(), Exceeded> {
    if count > most { Err((what, most)) } else { Ok(()) }
}
