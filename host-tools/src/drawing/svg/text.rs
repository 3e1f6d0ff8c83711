//! Fonts for text in an SVG, and warnings about missing fonts.
//!
//! Text becomes the outlines of a font, or the path of the pen along each letter: the single-stroke font included in
//! the program has open lines, which every TrueType reader closes and this module opens again ([`Fonts::are_open`]).
//! Position, size, anchor and spacing always come from usvg.
//!
//! Invariant: a character that no font has is reported and left out; its place stays empty.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use usvg::fontdb::{Database, FaceInfo, Family, Stretch, Style};
use usvg::roxmltree::{Document, Node, ParsingOptions};
use usvg::{FontResolver, Options};

/// Hershey's Simplex Roman, see `assets/hershey/README.md`.
const SINGLE_STROKE: &[u8] = include_bytes!("../../../assets/hershey/single-stroke.ttf");

/// Font for text in vector files.
#[derive(Clone, Debug, Default)]
pub enum TextFont {
    /// Outlines of the installed fonts that the file names, or else of any installed font.
    #[default]
    Installed,
    /// Letters of single lines.
    SingleStroke,
    /// Outlines of one font.
    File(FontFile),
}

/// A font file of the user.
#[derive(Clone, Debug)]
pub struct FontFile {
    database: Arc<Database>,
    path: PathBuf,
}

impl FontFile {
    /// Reads a TrueType or OpenType font.
    ///
    /// # Errors
    /// The file cannot be read, or contains no font.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, String> {
        let path = path.as_ref().to_owned();
        let data = std::fs::read(&path).map_err(|cause| cause.to_string())?;
        let mut database = Database::new();
        database.load_font_data(data);
        if database.is_empty() {
            return Err("this is no TrueType or OpenType font".to_owned());
        }
        Ok(Self {
            database: Arc::new(database),
            path,
        })
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The fonts of a computer without any installed.
    #[cfg(test)]
    pub(super) fn none() -> Self {
        Self {
            database: Arc::default(),
            path: PathBuf::new(),
        }
    }
}

impl Serialize for FontFile {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let face = self.database.faces().next().map(|face| face.id);
        let data = face.and_then(|id| self.database.with_face_data(id, |data, _| data.to_vec()));
        data.unwrap_or_default().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for FontFile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut database = Database::new();
        database.load_font_data(Vec::deserialize(deserializer)?);
        Ok(Self {
            database: Arc::new(database),
            path: PathBuf::new(),
        })
    }
}

/// Fonts for one file.
pub(super) struct Fonts {
    database: Arc<Database>,
    by_name: bool,
    texts: usize,
    /// Whether the letters' lines are open: the closing line is not drawn.
    pub(super) are_open: bool,
}

impl Fonts {
    /// Finds the fonts, if the file has any text.
    pub(super) fn find(document: &Document, font: &TextFont) -> Self {
        let is_text = |node: &Node| node.is_element() && node.tag_name().name() == "text";
        let texts = document.descendants().filter(is_text).count();
        Self {
            database: match font {
                _ if texts == 0 => Arc::default(),
                TextFont::Installed => installed(),
                TextFont::SingleStroke => single_stroke(),
                TextFont::File(file) => file.database.clone(),
            },
            by_name: matches!(font, TextFont::Installed),
            texts,
            are_open: matches!(font, TextFont::SingleStroke),
        }
    }

    /// Sets the fonts in usvg's options.
    pub(super) fn give_to(&self, options: &mut Options<'static>) {
        options.fontdb = self.database.clone();
        let (by_name, named) = (self.by_name, FontResolver::default_font_selector());
        options.font_resolver = FontResolver {
            select_font: Box::new(move |font, database| {
                let named = by_name.then(|| named(font, database)).flatten();
                named.or_else(|| database.faces().next().map(|face| face.id))
            }),
            select_fallback: FontResolver::default_fallback_selector(),
        };
    }

    /// The warning for a file with text for which there is no font.
    pub(super) fn warning(&self) -> Option<String> {
        (self.texts > 0 && self.database.is_empty()).then(|| {
            format!(
                "{} <text> not drawn, for no font is installed: --single-stroke draws text with the pen's own letters, \
                 --font FILE with another font",
                self.texts
            )
        })
    }
}

/// The installed fonts, searched once.
fn installed() -> Arc<Database> {
    static INSTALLED: OnceLock<Arc<Database>> = OnceLock::new();
    let fonts = INSTALLED.get_or_init(|| {
        let mut database = Database::new();
        database.load_system_fonts();
        name_generic_families(&mut database);
        Arc::new(database)
    });
    fonts.clone()
}

fn single_stroke() -> Arc<Database> {
    let mut database = Database::new();
    database.load_font_data(SINGLE_STROKE.to_vec());
    Arc::new(database)
}

/// Common font families for `serif`, `sans-serif` and `monospace`.
const SERIF: [&str; 5] = [
    "Times New Roman",
    "Liberation Serif",
    "DejaVu Serif",
    "Noto Serif",
    "FreeSerif",
];
const SANS_SERIF: [&str; 5] = ["Arial", "Liberation Sans", "DejaVu Sans", "Noto Sans", "FreeSans"];
const MONOSPACE: [&str; 5] = [
    "Courier New",
    "Liberation Mono",
    "DejaVu Sans Mono",
    "Noto Sans Mono",
    "FreeMono",
];

/// Assigns an installed font to each generic family, upright and of normal weight if there is one: the defaults are
/// fonts that few computers have.
fn name_generic_families(database: &mut Database) {
    let name = |database: &Database, family: &Family, known: &[&str]| {
        let named = database.family_name(family).to_owned();
        let mut names = std::iter::once(named.as_str()).chain(known.iter().copied());
        let there = names.find(|name| {
            database
                .faces()
                .any(|face| is_of(face, name) && face.style == Style::Normal)
        });
        there.map_or_else(|| plainest(database), |name| Some(name.to_owned()))
    };
    if let Some(family) = name(database, &Family::Serif, &SERIF) {
        database.set_serif_family(family);
    }
    if let Some(family) = name(database, &Family::SansSerif, &SANS_SERIF) {
        database.set_sans_serif_family(family);
    }
    if let Some(family) = name(database, &Family::Monospace, &MONOSPACE) {
        database.set_monospace_family(family);
    }
    if let Some(family) = name(database, &Family::Cursive, &SANS_SERIF) {
        database.set_cursive_family(family);
    }
    if let Some(family) = name(database, &Family::Fantasy, &SANS_SERIF) {
        database.set_fantasy_family(family);
    }
}

fn is_of(face: &FaceInfo, family: &str) -> bool {
    face.families.iter().any(|(name, _)| name.eq_ignore_ascii_case(family))
}

/// The family with the font closest to upright, normal width and normal weight.
fn plainest(database: &Database) -> Option<String> {
    let oddity = |face: &&FaceInfo| {
        let is_slanted = face.style != Style::Normal;
        (is_slanted, face.stretch != Stretch::Normal, face.weight.0.abs_diff(400))
    };
    let face = database.faces().min_by_key(oddity)?;
    face.families.first().map(|(name, _)| name.clone())
}

/// The file with characters replaced by spaces, in its text content only.
pub(super) fn without(text: &str, missing: &BTreeSet<char>) -> String {
    let options = ParsingOptions {
        allow_dtd: true,
        ..ParsingOptions::default()
    };
    let Ok(document) = Document::parse_with_options(text, options) else {
        return text.to_owned();
    };
    let in_text = |node: &Node| node.is_text() && node.ancestors().any(|outer| outer.tag_name().name() == "text");
    let (mut result, mut done) = (String::with_capacity(text.len()), 0);
    for range in document.descendants().filter(in_text).map(|node| node.range()) {
        let (Some(before), Some(letters)) = (text.get(done..range.start), text.get(range.clone())) else {
            continue;
        };
        result.push_str(before);
        let mut letters = letters.replace(|letter: char| missing.contains(&letter), " ");
        for letter in missing {
            let number = u32::from(*letter);
            for reference in [
                format!("&#{number};"),
                format!("&#x{number:x};"),
                format!("&#x{number:X};"),
            ] {
                letters = letters.replace(&reference, " ");
            }
        }
        result.push_str(&letters);
        done = range.end;
    }
    result.push_str(text.get(done..).unwrap_or_default());
    result
}

/// The warning about characters that were left out.
pub(super) fn left_out(missing: &BTreeSet<char>) -> Option<String> {
    /// Most characters named.
    const NAMED_MAX: usize = 20;
    let named = missing.iter().take(NAMED_MAX);
    let named: Vec<String> = named
        .map(|letter| format!("{letter} (U+{:04X})", u32::from(*letter)))
        .collect();
    let more = match missing.len().saturating_sub(NAMED_MAX) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    (!named.is_empty()).then(|| {
        format!(
            "no font has these characters of the text, they are left out: {}{more}; --font FILE draws text with another font",
            named.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use usvg::fontdb::{ID, Language, Query, Source, Weight};

    fn face(family: &str, style: Style, weight: u16) -> FaceInfo {
        FaceInfo {
            id: ID::dummy(),
            source: Source::Binary(Arc::new(SINGLE_STROKE)),
            index: 0,
            families: vec![(family.to_owned(), Language::English_UnitedStates)],
            post_script_name: family.to_owned(),
            style,
            weight: Weight(weight),
            stretch: Stretch::Normal,
            monospaced: false,
        }
    }

    /// Style and weight of the face that a generic family leads to.
    fn chosen(faces: &[(&str, Style, u16)], family: Family) -> (String, Style, u16) {
        let mut database = Database::new();
        for (family, style, weight) in faces {
            database.push_face_info(face(family, *style, *weight));
        }
        name_generic_families(&mut database);
        let query = Query {
            families: &[family],
            ..Query::default()
        };
        let face = database.query(&query).and_then(|id| database.face(id)).expect("a face");
        (face.families[0].0.clone(), face.style, face.weight.0)
    }

    #[test]
    fn a_generic_family_is_upright_and_of_normal_weight_whatever_is_installed() {
        let liberation = [
            ("Liberation Sans", Style::Italic, 700),
            ("Liberation Serif", Style::Normal, 400),
            ("Liberation Sans", Style::Normal, 400),
        ];
        let plain = |name: &str| (name.to_owned(), Style::Normal, 400);
        assert_eq!(chosen(&liberation, Family::SansSerif), plain("Liberation Sans"));
        assert_eq!(chosen(&liberation, Family::Serif), plain("Liberation Serif"));
        assert_eq!(chosen(&liberation, Family::Cursive), plain("Liberation Sans"));
        let unknown = [("Foo Black", Style::Italic, 900), ("Bar", Style::Normal, 400)];
        for family in [Family::SansSerif, Family::Serif, Family::Monospace, Family::Fantasy] {
            assert_eq!(chosen(&unknown, family), plain("Bar"));
        }
        assert_eq!(
            chosen(&unknown[..1], Family::SansSerif),
            ("Foo Black".into(), Style::Italic, 900)
        );
    }
}
